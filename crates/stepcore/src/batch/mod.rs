//! Many worlds of one model, in groups of as many as a number has lanes, over threads.
//!
//! A group is a state and its inputs; the working space belongs to the threads, one
//! `Watched` each, which take the next group when they are done with one. What a group
//! computes depends on nothing else, so results are the same bits at any number of
//! threads, and, because a lane is a world, in lanes or one by one.

mod compiled_steps;
mod failed;
mod group;
mod lane_layout;
mod rollout;
mod transfer;
mod workers;

pub use failed::Failed;
pub use group::Last;
pub use rollout::Rollout;

use std::sync::{Arc, Mutex};

use compiled_steps::{each, step_listed};
use group::{in_batch, Group};
use lane_layout::{registers, LaneLayout};
use rollout::Part;
use workers::{Workers, Workspace};

use crate::arrays::{Array, Given};
use crate::error::{Error, Result};
use crate::model::Model;
use crate::pool::{check_threads, lock};
use crate::program::{Blocks, Program};
use crate::real::Real;
use crate::room::{can_be_had, Room};
use crate::settings::{Settings, Solver};
use crate::solve::dofs::any_heap;
use crate::state::{Inputs, State};
use crate::watch::{Care, Watched};

/// Without `Settings::ledger`, of about so many worlds the energies are looked at, evenly spread: each keeps
/// some of its states and of its inputs.
const WATCHED: usize = 32;

pub struct Batch<R: Real> {
    pub worlds: usize,
    /// Each different one of the worlds' models.
    models: Vec<Arc<Model>>,
    dt: f64,
    layout: LaneLayout,
    groups: Vec<Group<R>>,
    workers: Workers<R>,
    /// What makes the steps of small models.
    list: Option<Blocks<R>>,
    /// A world that fails stands still, and the others go on; else all stop with it.
    pub goes_on: bool,
}

/// Whether worlds of a model can be stepped side by side, and gain by it. The pairs of a heap are
/// found one world at a time, so are those who sleep; and Newton's method solves a heap so too.
pub fn gains_by_lanes(model: &Model, settings: &Settings) -> bool {
    let by_lane = settings.solver == Solver::Newton && any_heap(&model.islands());
    model.dynamic_pairs.is_none() && !settings.sleep && !by_lane
}

/// Whether worlds of several models fill lanes well enough: those of a model share a register, and
/// a register costs about as much as three worlds alone.
pub fn fills_lanes(model_of: &[usize], lanes: usize) -> bool {
    3 * registers(lanes, model_of) <= model_of.len() || model_of.iter().all(|model| *model == 0)
}

/// The list of what a step executes, for worlds of one model that has one.
pub fn program_of<R: Real>(models: &[Arc<Model>], settings: &Settings) -> Option<Program> {
    match models {
        [model] => Program::of::<R>(model, settings),
        _ => None,
    }
}

/// The index of the model of each world, if there is but one; refuses more worlds than the memory
/// can hold.
pub fn of_one_model(model: &Model, worlds: usize) -> Result<Vec<usize>> {
    let bytes = worlds.checked_mul(bytes_a_world(model));
    if !bytes.is_some_and(can_be_had) {
        return Err(Error::value("n", worlds, "a number of worlds that the memory can hold"));
    }
    Ok(vec![0; worlds])
}

/// A little more than a world's numbers take here and in its user's arrays.
fn bytes_a_world(model: &Model) -> usize {
    let counts = Array::counts(model);
    let all = counts.iter().sum::<usize>() + 2 * counts[..Array::CHANGED].iter().sum::<usize>();
    1024 + 8 * (2 * all + model.nv)
}

impl<R: Real> Batch<R> {
    /// Worlds of one model.
    pub fn new(
        model: Arc<Model>,
        settings: &Settings,
        worlds: usize,
        threads: usize,
    ) -> Result<Self> {
        let model_of = of_one_model(&model, worlds)?;
        Self::of_models(vec![model], &model_of, settings, threads)
    }

    /// Worlds of models that differ in numbers: `model_of` has the index of each world's.
    pub fn of_models(
        models: Vec<Arc<Model>>,
        model_of: &[usize],
        settings: &Settings,
        threads: usize,
    ) -> Result<Self> {
        settings.check()?;
        let list = program_of::<R>(&models, settings);
        Self::with_list(models, model_of, settings, threads, list.as_ref())
    }

    /// The same, the list of their steps at hand: that of `program_of`.
    pub fn with_list(
        models: Vec<Arc<Model>>,
        model_of: &[usize],
        settings: &Settings,
        threads: usize,
        list: Option<&Program>,
    ) -> Result<Self> {
        settings.check()?;
        let worlds = model_of.len();
        if worlds == 0 {
            return Err(Error::value("n", worlds, "at least 1 world"));
        }
        check_threads(threads)?;
        let layout = LaneLayout::new(R::LANES, model_of);
        let workers = Workers::new(&models, settings, &layout, worlds, threads)?;
        let group = |index: usize| {
            let (own, worlds) = (layout.model(index), layout.worlds(index).len());
            let watched =
                index.is_multiple_of(layout.groups().div_ceil(WATCHED.div_ceil(R::LANES)));
            let least = watched.then_some(Care::Least);
            let care = if settings.ledger { Some(Care::Full) } else { least };
            Group::new(&models[own], workers.initial_sleep(own), worlds, care)
        };
        let groups = (0..layout.groups()).map(group).collect();
        Ok(Self {
            worlds,
            list: list.map(|list| Blocks::new(list, workers.threads)),
            dt: settings.dt,
            groups,
            workers,
            goes_on: false,
            models,
            layout,
        })
    }

    /// Memory of all worlds and of the threads' working spaces [bytes]; models are not in it.
    pub fn bytes(&self) -> usize {
        let list = self.list.as_ref().map_or(0, Blocks::bytes);
        size_of::<Self>() + self.layout.bytes() + self.groups.room() + self.workers.bytes() + list
    }

    pub fn time(&self) -> f64 {
        self.groups[0].state.time(self.dt)
    }

    /// Refuses arrays of a world that cannot be stepped.
    pub fn check(&self, world: usize, given: &Given) -> Result<()> {
        given.check::<R>(self.model(world), Some(world))
    }

    /// The model of a world.
    pub fn model(&self, world: usize) -> &Arc<Model> {
        &self.models[self.layout.model(self.layout.of(world).0)]
    }

    /// All worlds, those of one model beside each other.
    pub fn by_model(&self) -> &[usize] {
        self.layout.all()
    }

    /// Takes a world's arrays, which were checked. Worlds come in order; lanes without a
    /// world of their own repeat the last one.
    pub fn put(&mut self, world: usize, given: &Given) {
        let (index, own) = self.layout.of(world);
        self.groups[index].put(own, self.layout.worlds(index).len(), given);
    }

    /// Gives a world's part of an array that a step changes.
    pub fn take(&self, world: usize, array: Array, out: &mut [f64]) {
        let (index, lane) = self.layout.of(world);
        let group = &self.groups[index];
        match &group.standing.lanes[lane] {
            None => group.state.take(lane, array, out),
            Some(failed) => out.copy_from_slice(&failed.state[array as usize]),
        }
    }

    /// A world that failed while the others went on.
    pub fn failed(&self, world: usize) -> Option<&Failed> {
        let (group, lane) = self.layout.of(world);
        self.groups[group].standing.lanes[lane].as_deref()
    }

    /// Some worlds begin anew, wherever their arrays put them: they have no impulses to start from,
    /// have not failed, and nothing was solved there yet. The others are as they were.
    pub fn forget(&mut self, worlds: &[usize]) {
        for world in worlds {
            let (index, own) = self.layout.of(*world);
            let last = if own + 1 == self.layout.worlds(index).len() { R::LANES } else { own + 1 };
            (own..last).for_each(|lane| self.groups[index].forget(lane));
        }
    }

    /// All worlds begin anew at a time, wherever their arrays put them: without impulses.
    pub fn restart(&mut self, start: f64) {
        for (state, _) in self.states_mut() {
            (state.start, state.steps) = (start, 0);
            state.warm.clear();
        }
        self.groups.iter_mut().for_each(Group::put_to_sleep);
    }

    /// The states at hand did not come from a solve.
    pub fn unsolved(&mut self) {
        for group in &mut self.groups {
            group.state.copy_to(&mut group.before);
            group.last.fill(Last::Nothing);
        }
    }

    /// A world's acceleration in its last solve.
    pub fn qacc(&self, world: usize) -> impl Iterator<Item = f64> + '_ {
        let (group, lane) = self.layout.of(world);
        self.groups[group].qacc.iter().map(move |a| a.lane(lane))
    }

    /// Of a world: the state in which its last solve began, its inputs, the lane where it is in
    /// these, and what the solve belonged to.
    pub fn last(&self, world: usize) -> (&State<R>, &Inputs<R>, usize, Last) {
        let (index, lane) = self.layout.of(world);
        let group = &self.groups[index];
        (&group.before, &group.inputs, lane, group.last[lane])
    }

    /// The state that holds a world, and the lane where it is.
    pub fn state(&self, world: usize) -> (&State<R>, usize) {
        let (group, lane) = self.layout.of(world);
        (&self.groups[group].state, lane)
    }

    /// The states of all groups, with the worlds in their lanes.
    pub fn states_mut(&mut self) -> impl Iterator<Item = (&mut State<R>, &[usize])> {
        let Self { groups, layout, .. } = self;
        groups.iter_mut().enumerate().map(|(index, group)| {
            // Whoever writes a state starts anew.
            group.ledger.iter_mut().for_each(|ledger| ledger.forget());
            group.standing.lanes.fill(None);
            group.ended.fill(false);
            (&mut group.state, layout.worlds(index))
        })
    }

    /// Advances every world by `n` steps. If one leaves the finite numbers, all stand
    /// before the first step in which one did.
    pub fn step(&mut self, n: u64) -> Result<()> {
        self.advance(n, true, |_, _, watched| watched.step(1))
    }

    /// Without `Settings::ledger`: that a world gained more energy than can be, and where from. It is
    /// said once, and nothing is looked for after that.
    pub fn take_warning(&mut self) -> Option<String> {
        let Self { groups, layout, .. } = self;
        let said = groups.iter_mut().enumerate().find_map(|(index, group)| {
            let said = group.take_said()?;
            let worlds = layout.worlds(index);
            Some(format!("world {}: {}", worlds[said.world.min(worlds.len() - 1)], said.warning()))
        })?;
        self.unwatch();
        Some(said)
    }

    /// Without `Settings::ledger`, energies are not looked at any more.
    pub fn unwatch(&mut self) {
        self.groups.iter_mut().for_each(Group::unwatch);
    }

    /// Place, detect and solve in every world. Nothing is committed.
    pub fn forward(&mut self) -> Result<()> {
        let Self { workers, groups, layout, goes_on, .. } = self;
        workers.share(groups, 1, |workspace, index, group| {
            let forward = |_, watched: &mut Watched<R>| watched.forward();
            let watched = workspace.space(layout.model(index));
            group.run(watched, layout.worlds(index), 1, Last::Forward, *goes_on, forward)
        });
        first_failure(groups, layout).map_or(Ok(()), |(_, error)| Err(error))
    }

    /// Steps `from..from + n` of a play.
    pub fn play(&mut self, play: &mut Rollout, from: usize, n: usize) -> Result<()> {
        let parts = play.parts(&self.layout, Array::counts(&self.models[0]));
        let parts: Vec<Mutex<Part>> = parts.into_iter().map(Mutex::new).collect();
        self.advance(n as u64, false, |index, k, watched| {
            let mut part = lock(&parts[index]);
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
    fn stand(&self, play: &mut Rollout, from: usize, n: usize) {
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

    /// Does `n` times `one`, a step, in every world. plain: it is no more than that, so that a list
    /// may do it.
    fn advance(
        &mut self,
        n: u64,
        plain: bool,
        one: impl Fn(usize, u64, &mut Watched<R>) -> Result<()> + Sync,
    ) -> Result<()> {
        let Self { workers, groups, layout, goes_on, list, .. } = self;
        let run = |workspace: &mut Workspace<R>, index, group: &mut Group<R>, n| {
            let one = |k, watched: &mut Watched<R>| one(index, k, watched);
            let watched = workspace.space(layout.model(index));
            group.run(watched, layout.worlds(index), n, Last::Step, *goes_on, one);
        };
        let list = list.as_ref().filter(|_| plain && n > 0);
        workers.share_portions(groups, n, list.is_some(), |workspace, first, groups| {
            groups.iter_mut().for_each(|group| group.state.copy_to(&mut group.start));
            let run = |index, group: &mut Group<R>, n| run(workspace, first + index, group, n);
            match list {
                Some(list) => step_listed(list, groups, n, run),
                None => each(groups, n, run),
            }
        });
        let Some((done, error)) = first_failure(groups, layout) else { return Ok(()) };
        groups.iter_mut().for_each(|group| drop(group.take_said()));
        // All worlds go back, and then on to where this one was still well.
        workers.share(groups, done, |workspace, index, group| {
            group.start.copy_to(&mut group.state);
            group.start.copy_to(&mut group.before);
            group.last.fill(Last::Forward);
            group.ledger.iter_mut().for_each(|ledger| ledger.forget());
            run(workspace, index, group, done);
        });
        if let Error::Diverged(divergence) = &error {
            let (group, lane) = self.layout.of(divergence.world);
            self.groups[group].ended[lane] = true;
        }
        Err(error)
    }
}

/// The failure after the fewest steps, with its world's place in the batch.
fn first_failure<R: Real>(groups: &mut [Group<R>], layout: &LaneLayout) -> Option<(u64, Error)> {
    let failures = groups.iter_mut().enumerate().filter_map(|(index, group)| {
        let (done, mut error) = group.failed.take()?;
        in_batch(&mut error, layout.worlds(index));
        Some((done, error))
    });
    let world = |error: &Error| match error {
        Error::Diverged(divergence) => divergence.world,
        _ => 0,
    };
    failures.min_by_key(|(done, error)| (*done, world(error)))
}
