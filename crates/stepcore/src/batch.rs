//! Many worlds of one model, in groups of as many as a number has lanes, over threads.
//!
//! A group is a state and its inputs; the working space belongs to the threads, one
//! `Watched` each, which take the next group when they are done with one. What a group
//! computes depends on nothing else, so results are the same bits at any number of
//! threads, and, because a lane is a world, in lanes or one by one.

use std::sync::{Arc, Mutex, PoisonError};

use crate::arrays::Given;
use crate::error::{Error, Result};
use crate::failed::{Failed, Standing};
use crate::model::Model;
use crate::real::Real;
use crate::settings::Settings;
use crate::state::{Inputs, State};
use crate::watch::{Ledger, Watched};

/// The most threads that a batch may ask for.
const MOST_THREADS: usize = 1024;

/// What the last solve of the worlds belonged to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Last {
    Nothing,
    Forward,
    Step,
}

/// As many worlds as a number has lanes.
struct Group<R: Real> {
    state: State<R>,
    inputs: Inputs<R>,
    /// Acceleration of the last solve.
    qacc: Vec<R>,
    /// The state when the call began.
    start: State<R>,
    /// The state when the last solve began, from which it can be done again: its rows
    /// are in the working space of a thread, and gone with the next group.
    before: State<R>,
    last: Last,
    /// Steps done in this call before one failed, and why it did.
    failed: Option<(u64, Error)>,
    /// Worlds that failed while the others went on.
    standing: Standing,
    ledger: Option<Box<Ledger<R>>>,
}

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

/// Controls for every world and step, and room for the states after each step: world,
/// then step, then entry.
pub struct Play<'a> {
    pub steps: usize,
    pub ctrl: &'a [f64],
    pub qpos: &'a mut [f64],
    pub qvel: &'a mut [f64],
}

/// A group's part of a `Play`.
struct Part<'a> {
    worlds: usize,
    steps: usize,
    /// nu, nq, nv.
    sizes: [usize; 3],
    ctrl: &'a [f64],
    qpos: &'a mut [f64],
    qvel: &'a mut [f64],
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
        if !(1..=MOST_THREADS).contains(&threads) {
            return Err(Error::value("threads", threads, format!("from 1 to {MOST_THREADS}")));
        }
        let count = worlds.div_ceil(R::LANES);
        let bytes = worlds.checked_mul(Self::bytes_a_world(&model));
        if bytes.is_none_or(|bytes| Vec::<u8>::new().try_reserve_exact(bytes).is_err()) {
            return Err(Error::value("n", worlds, "a number of worlds that the memory can hold"));
        }
        let group = |index: usize| Group {
            state: State::new(&model),
            inputs: Inputs::new(&model),
            qacc: vec![R::zero(); model.nv],
            start: State::new(&model),
            before: State::new(&model),
            last: Last::Nothing,
            failed: None,
            standing: Standing::new((worlds - index * R::LANES).min(R::LANES)),
            ledger: settings.ledger.then(|| Box::new(Ledger::new(&model))),
        };
        let workers =
            (0..threads.min(count)).map(|_| Watched::new(model.clone(), settings.clone()));
        Ok(Self {
            worlds,
            dt: settings.dt,
            groups: (0..count).map(group).collect(),
            workers: workers.collect::<Result<_>>()?,
            goes_on: false,
            model,
        })
    }

    /// A little more than a world's numbers take here and in its user's arrays.
    fn bytes_a_world(model: &Model) -> usize {
        let (nq, nv) = (model.nq, model.nv);
        let state = 3 * (nq + nv) + model.actuators.len() + nv + 6 * model.bodies.len();
        1024 + 8 * (2 * state + nv)
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
        }
        let last = if world + 1 == self.worlds { R::LANES } else { world % R::LANES + 1 };
        for lane in world % R::LANES..last {
            if group.state.put(lane, given) {
                group.ledger.iter_mut().for_each(|ledger| ledger.forget());
            }
            group.inputs.put(lane, given);
        }
    }

    /// Gives a world's positions and velocities.
    pub fn take(&self, world: usize, qpos: &mut [f64], qvel: &mut [f64]) {
        let group = &self.groups[world / R::LANES];
        match &group.standing.lanes[world % R::LANES] {
            None => group.state.take(world % R::LANES, qpos, qvel),
            Some(failed) => {
                qpos.copy_from_slice(&failed.qpos);
                qvel.copy_from_slice(&failed.qvel);
            }
        }
    }

    /// A world that failed while the others went on.
    pub fn failed(&self, world: usize) -> Option<&Failed> {
        self.groups[world / R::LANES].standing.lanes[world % R::LANES].as_ref()
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
        let (worlds, steps) = (self.worlds, play.steps);
        let sizes = [self.model.actuators.len(), self.model.nq, self.model.nv];
        let [nu, nq, nv] = sizes.map(|size| size * steps * R::LANES);
        let (mut ctrl, mut qpos, mut qvel) = (play.ctrl, &mut *play.qpos, &mut *play.qvel);
        let parts: Vec<Mutex<Part>> = (0..self.groups.len())
            .map(|index| {
                let worlds = (worlds - index * R::LANES).min(R::LANES);
                let (ctrl, qpos, qvel) =
                    (cut(&mut ctrl, nu), cut_mut(&mut qpos, nq), cut_mut(&mut qvel, nv));
                Mutex::new(Part { worlds, steps, sizes, ctrl, qpos, qvel })
            })
            .collect();
        self.advance(n as u64, |index, k, watched| {
            let mut part = parts[index].lock().unwrap_or_else(PoisonError::into_inner);
            let step = from + k as usize;
            part.control(step, watched);
            watched.step(1)?;
            part.record(step, &watched.sim.state);
            Ok(())
        })?;
        self.stand(play, from, n);
        Ok(())
    }

    /// In a play's states, worlds that failed stand where they failed.
    fn stand(&self, play: &mut Play, from: usize, n: usize) {
        let (nq, nv) = (self.model.nq, self.model.nv);
        for world in 0..self.worlds {
            let Some(failed) = self.failed(world) else { continue };
            for step in from + failed.done as usize..from + n {
                let at = world * play.steps + step;
                play.qpos[at * nq..(at + 1) * nq].copy_from_slice(&failed.qpos);
                play.qvel[at * nv..(at + 1) * nv].copy_from_slice(&failed.qvel);
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

impl<R: Real> Group<R> {
    /// Runs `one` up to `n` times on this group's state in a thread's working space.
    fn run(
        &mut self,
        watched: &mut Watched<R>,
        index: usize,
        n: u64,
        last: Last,
        goes_on: bool,
        one: &impl Fn(usize, u64, &mut Watched<R>) -> Result<()>,
    ) {
        let Self { state, inputs, ledger, standing, before, qacc, .. } = self;
        standing.lanes.iter_mut().flatten().for_each(|failed| failed.done = 0);
        if standing.any() && !standing.mirror(state, inputs) {
            // Nobody is left; time goes on.
            state.steps += if last == Last::Step { n } else { 0 };
            return;
        }
        let copies = standing.mask::<R>();
        let guest = Guest::new(watched, state, inputs, ledger, copies);
        self.failed = (0..n).find_map(|k| {
            if k + 1 == n {
                guest.watched.sim.state.copy_to(before);
            }
            loop {
                let error = one(index, k, guest.watched).err()?;
                if !(goes_on && set_aside(standing, guest.watched, index, k, &error)) {
                    return Some((k, error));
                }
                if standing.healthy().is_none() {
                    guest.watched.sim.state.steps += if last == Last::Step { n - k } else { 0 };
                    return Some((u64::MAX, error));
                }
            }
        });
        self.failed = self.failed.take().filter(|(k, _)| *k != u64::MAX);
        if n > 0 {
            self.last = last;
            qacc.copy_from_slice(&guest.watched.sim.qacc);
        }
    }
}

/// A group's worlds in the working space of a thread. They go back when this is dropped, after
/// a panic too.
struct Guest<'a, R: Real> {
    watched: &'a mut Watched<R>,
    state: &'a mut State<R>,
    inputs: &'a mut Inputs<R>,
    ledger: &'a mut Option<Box<Ledger<R>>>,
}

impl<'a, R: Real> Guest<'a, R> {
    fn new(
        watched: &'a mut Watched<R>,
        state: &'a mut State<R>,
        inputs: &'a mut Inputs<R>,
        ledger: &'a mut Option<Box<Ledger<R>>>,
        copies: u64,
    ) -> Self {
        let mut guest = Self { watched, state, inputs, ledger };
        guest.swap(copies);
        guest
    }

    fn swap(&mut self, copies: u64) {
        self.watched.swap(self.ledger, copies);
        std::mem::swap(&mut self.watched.sim.state, self.state);
        std::mem::swap(&mut self.watched.sim.inputs, self.inputs);
    }
}

impl<R: Real> Drop for Guest<'_, R> {
    fn drop(&mut self) {
        self.swap(0);
    }
}

/// Takes the world that failed out of the run, if one did; false for other errors.
fn set_aside<R: Real>(
    standing: &mut Standing,
    watched: &mut Watched<R>,
    index: usize,
    done: u64,
    error: &Error,
) -> bool {
    let Error::Diverged(divergence) = error else { return false };
    let (lane, mut error) = (divergence.world, error.clone());
    in_batch::<R>(&mut error, index);
    standing.take(&watched.sim.state, lane, done, error);
    standing.mirror_in(watched);
    true
}

/// A lane's failure becomes that of a world of the batch.
fn in_batch<R: Real>(error: &mut Error, index: usize) {
    if let Error::Diverged(divergence) = error {
        divergence.world += index * R::LANES;
        divergence.batch = true;
    }
}

impl Part<'_> {
    /// Puts the controls of a step in; lanes without a world repeat the last one.
    fn control<R: Real>(&self, step: usize, watched: &mut Watched<R>) {
        let nu = self.sizes[0];
        let own = (0..R::LANES).find(|lane| watched.is_world(*lane)).unwrap_or(0);
        for lane in 0..R::LANES {
            let world = if watched.is_world(lane) { lane.min(self.worlds - 1) } else { own };
            let start = (world * self.steps + step) * nu;
            for (to, from) in watched.sim.inputs.ctrl.iter_mut().zip(&self.ctrl[start..start + nu])
            {
                to.set_lane(lane, *from);
            }
        }
    }

    /// Keeps the state after a step.
    fn record<R: Real>(&mut self, step: usize, state: &State<R>) {
        let [_, nq, nv] = self.sizes;
        for lane in 0..self.worlds {
            let at = lane * self.steps + step;
            state.take(
                lane,
                &mut self.qpos[at * nq..(at + 1) * nq],
                &mut self.qvel[at * nv..(at + 1) * nv],
            );
        }
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

/// Takes up to `count` entries off the front.
fn cut<'a>(all: &mut &'a [f64], count: usize) -> &'a [f64] {
    let (head, tail) = all.split_at(count.min(all.len()));
    *all = tail;
    head
}

fn cut_mut<'a>(all: &mut &'a mut [f64], count: usize) -> &'a mut [f64] {
    let whole = std::mem::take(all);
    let (head, tail) = whole.split_at_mut(count.min(whole.len()));
    *all = tail;
    head
}
