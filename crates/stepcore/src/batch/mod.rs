//! Many worlds of one model, in groups of as many as a number has lanes, over threads.
//!
//! A group is a state and its inputs; the working space belongs to the threads, one
//! `Watched` each, which take the next group when they are done with one. What a group
//! computes depends on nothing else, so results are the same bits at any number of
//! threads, and, because a lane is a world, in lanes or one by one.

mod failed;
mod group;
mod play;

pub use failed::Failed;
pub use group::Last;
pub use play::Play;

use std::sync::{Arc, Mutex, PoisonError};

use group::{in_batch, Group};
use play::Part;

use crate::arrays::{Array, Given};
use crate::error::{Error, Result};
use crate::model::Model;
use crate::pool::check_threads;
use crate::real::Real;
use crate::settings::{Settings, Solver};
use crate::solve::rows::any_heap;
use crate::state::{Inputs, State};
use crate::watch::Watched;

pub struct Batch<R: Real> {
    pub worlds: usize,
    model: Arc<Model>,
    dt: f64,
    groups: Vec<Group<R>>,
    /// One a thread.
    workers: Vec<Watched<R>>,
    /// A world that fails stands still, and the others go on; else all stop with it.
    pub goes_on: bool,
}

/// Whether worlds of a model can be stepped side by side, and gain by it. The pairs of a heap are
/// found one world at a time, so are those who sleep; and Newton's method solves a heap so too.
pub fn gains_by_lanes(model: &Model, settings: &Settings) -> bool {
    let by_lane = settings.solver == Solver::Newton && any_heap(&model.islands());
    model.heap.is_none() && !settings.sleep && !by_lane
}

impl<R: Real> Batch<R> {
    pub fn new(
        model: Arc<Model>,
        settings: &Settings,
        worlds: usize,
        threads: usize,
    ) -> Result<Self> {
        settings.check()?;
        if worlds == 0 {
            return Err(Error::value("n", worlds, "at least 1 world"));
        }
        check_threads(threads)?;
        let count = worlds.div_ceil(R::LANES);
        let bytes = worlds.checked_mul(Self::bytes_a_world(&model));
        if bytes.is_none_or(|bytes| Vec::<u8>::new().try_reserve_exact(bytes).is_err()) {
            return Err(Error::value("n", worlds, "a number of worlds that the memory can hold"));
        }
        let group = |index: usize| {
            let own = (worlds - index * R::LANES).min(R::LANES);
            Group::new(&model, own, settings.ledger)
        };
        let worker = |_| Ok(Watched::new(model.clone(), settings.clone())?.among(worlds));
        Ok(Self {
            worlds,
            dt: settings.dt,
            groups: (0..count).map(group).collect(),
            workers: (0..threads.min(count)).map(worker).collect::<Result<_>>()?,
            goes_on: false,
            model,
        })
    }

    /// A little more than a world's numbers take here and in its user's arrays.
    fn bytes_a_world(model: &Model) -> usize {
        let counts = Array::counts(model);
        let all = counts.iter().sum::<usize>() + 2 * counts[..Array::CHANGED].iter().sum::<usize>();
        1024 + 8 * (2 * all + model.nv)
    }

    pub fn time(&self) -> f64 {
        self.groups[0].state.time(self.dt)
    }

    /// Refuses arrays of a world that cannot be stepped.
    pub fn check(&self, world: usize, given: &Given) -> Result<()> {
        given.check::<R>(&self.model, Some(world))
    }

    /// Takes a world's arrays, which were checked. Worlds come in order; lanes without a
    /// world of their own repeat the last one.
    pub fn put(&mut self, world: usize, given: &Given) {
        let group = &mut self.groups[world / R::LANES];
        if let Some(failed) = &group.standing.lanes[world % R::LANES] {
            if failed.stands(given) {
                return;
            }
            group.standing.lanes[world % R::LANES] = None;
            // Its lane repeated another, whose impulses are none of its own.
            group.state.forget_impulses(world % R::LANES);
        }
        let last = if world + 1 == self.worlds { R::LANES } else { world % R::LANES + 1 };
        for lane in world % R::LANES..last {
            if group.state.put(lane, given) {
                if std::mem::take(&mut group.ended[lane]) {
                    group.state.forget_impulses(lane);
                }
                group.ledger.iter_mut().for_each(|ledger| ledger.forget());
            }
            group.inputs.put(lane, given);
        }
    }

    /// Gives a world's part of an array that a step changes.
    pub fn take(&self, world: usize, array: Array, out: &mut [f64]) {
        let group = &self.groups[world / R::LANES];
        match &group.standing.lanes[world % R::LANES] {
            None => group.state.take(world % R::LANES, array, out),
            Some(failed) => out.copy_from_slice(&failed.state[array as usize]),
        }
    }

    /// A world that failed while the others went on.
    pub fn failed(&self, world: usize) -> Option<&Failed> {
        self.groups[world / R::LANES].standing.lanes[world % R::LANES].as_ref()
    }

    /// The states at hand did not come from a solve.
    pub fn unsolved(&mut self) {
        for group in &mut self.groups {
            group.state.copy_to(&mut group.before);
            group.last = Last::Nothing;
        }
    }

    /// A world's acceleration in its last solve.
    pub fn qacc(&self, world: usize) -> impl Iterator<Item = f64> + '_ {
        self.groups[world / R::LANES].qacc.iter().map(move |a| a.lane(world % R::LANES))
    }

    /// The group of a world: the state in which its last solve began, the inputs, and what
    /// it belonged to.
    pub fn last(&self, world: usize) -> (&State<R>, &Inputs<R>, Last) {
        let group = &self.groups[world / R::LANES];
        (&group.before, &group.inputs, group.last)
    }

    /// The states of all groups, `R::LANES` worlds each.
    pub fn states(&self) -> impl Iterator<Item = &State<R>> {
        self.groups.iter().map(|group| &group.state)
    }

    pub fn states_mut(&mut self) -> impl Iterator<Item = &mut State<R>> {
        self.groups.iter_mut().map(|group| {
            // Whoever writes a state starts anew.
            group.ledger.iter_mut().for_each(|ledger| ledger.forget());
            group.standing.lanes.fill(None);
            group.ended.fill(false);
            &mut group.state
        })
    }

    /// Advances every world by `n` steps. If one leaves the finite numbers, all stand
    /// before the first step in which one did.
    pub fn step(&mut self, n: u64) -> Result<()> {
        self.advance(n, |_, _, watched| watched.step(1))
    }

    /// Place, detect and solve in every world. Nothing is committed.
    pub fn forward(&mut self) -> Result<()> {
        let forward = |_, _, watched: &mut Watched<R>| watched.forward();
        let goes_on = self.goes_on;
        share(&mut self.workers, &mut self.groups, |watched, index, group| {
            group.run(watched, index, 1, Last::Forward, goes_on, &forward)
        });
        self.first_failure().map_or(Ok(()), |(_, error)| Err(error))
    }

    /// Steps `from..from + n` of a play.
    pub fn play(&mut self, play: &mut Play, from: usize, n: usize) -> Result<()> {
        let parts = play.parts(self.worlds, R::LANES, Array::counts(&self.model));
        let parts: Vec<Mutex<Part>> = parts.into_iter().map(Mutex::new).collect();
        self.advance(n as u64, |index, k, watched| {
            let mut part = parts[index].lock().unwrap_or_else(PoisonError::into_inner);
            let step = from + k as usize;
            part.control(step, watched);
            watched.step(1)?;
            part.record(step, &watched.sim.state);
            Ok(())
        })?;
        drop(parts);
        self.stand(play, from, n);
        Ok(())
    }

    /// In a play's states, worlds that failed stand where they failed.
    fn stand(&self, play: &mut Play, from: usize, n: usize) {
        for world in 0..self.worlds {
            let Some(failed) = self.failed(world) else { continue };
            for step in from + failed.done as usize..from + n {
                let at = world * play.steps + step;
                for (list, own) in play.states.iter_mut().zip(&failed.state) {
                    list[at * own.len()..(at + 1) * own.len()].copy_from_slice(own);
                }
            }
        }
    }

    /// Does `n` times `one`, a step, in every world.
    fn advance(
        &mut self,
        n: u64,
        one: impl Fn(usize, u64, &mut Watched<R>) -> Result<()> + Sync,
    ) -> Result<()> {
        let goes_on = self.goes_on;
        share(&mut self.workers, &mut self.groups, |watched, index, group| {
            group.state.copy_to(&mut group.start);
            group.run(watched, index, n, Last::Step, goes_on, &one);
        });
        let Some((done, error)) = self.first_failure() else { return Ok(()) };
        // All worlds go back, and then on to where this one was still well.
        share(&mut self.workers, &mut self.groups, |watched, index, group| {
            group.start.copy_to(&mut group.state);
            group.start.copy_to(&mut group.before);
            group.last = Last::Forward;
            group.ledger.iter_mut().for_each(|ledger| ledger.forget());
            group.run(watched, index, done, Last::Step, goes_on, &one);
        });
        if let Error::Diverged(divergence) = &error {
            let (group, lane) = (divergence.world / R::LANES, divergence.world % R::LANES);
            self.groups[group].ended[lane] = true;
        }
        Err(error)
    }

    /// The failure after the fewest steps, with its world's place in the batch.
    fn first_failure(&mut self) -> Option<(u64, Error)> {
        let failures = self.groups.iter_mut().enumerate().filter_map(|(index, group)| {
            let (done, mut error) = group.failed.take()?;
            in_batch::<R>(&mut error, index);
            Some((done, error))
        });
        failures.min_by_key(|(done, _)| *done)
    }
}

/// Lets every worker take the next group until none is left.
fn share<R: Real>(
    workers: &mut [Watched<R>],
    groups: &mut [Group<R>],
    work: impl Fn(&mut Watched<R>, usize, &mut Group<R>) + Sync,
) {
    if let [only] = workers {
        return groups.iter_mut().enumerate().for_each(|(index, group)| work(only, index, group));
    }
    let left = Mutex::new(groups.iter_mut().enumerate());
    let next = || left.lock().unwrap_or_else(PoisonError::into_inner).next();
    let (next, work) = (&next, &work);
    std::thread::scope(|scope| {
        for watched in workers {
            scope.spawn(move || {
                while let Some((index, group)) = next() {
                    work(watched, index, group);
                }
            });
        }
    });
}
