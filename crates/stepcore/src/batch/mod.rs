//! Many worlds of one model, in groups of as many as a number has lanes, over threads.
//!
//! A group is a state and its inputs; the working space belongs to the threads, one `Watched` each,
//! which take the next group when they are done with one. A group's computation depends on nothing
//! else, so results are the same bits at any number of threads, and, because a lane is a world, in
//! lanes or one by one.

mod failed;
mod group;
mod lane_layout;
mod motion;
mod transfer;
mod workers;

pub use failed::Failed;
pub use group::Last;
pub use motion::{Motion, Record, Sampled};

use std::sync::{Arc, Mutex};

use group::{in_batch, Group};
use lane_layout::LaneLayout;
pub use lane_layout::{fills_lanes, gains_by_lanes, kinds};
use motion::Part;
use workers::{Workers, Workspace};

use crate::arrays::{Array, Given as Arrays};
use crate::error::{Error, Result};
use crate::model::{differ_in_numbers, Model, SideBySide};
use crate::pool::{check_threads, lock};
use crate::real::{Constant, Real};
use crate::room::{can_be_had, listed, Room};
use crate::settings::Settings;
use crate::state::{Inputs, State};
use crate::watch::{Care, Watched, WorldPast};

/// Without `Settings::ledger`, the number of evenly spread worlds whose energies are checked: each
/// keeps some of its states and of its inputs.
const WATCHED: usize = 32;

pub struct Batch<R: Real> {
    pub worlds: usize,
    /// Each different one of the worlds' models.
    models: Vec<Arc<Model>>,
    /// One entry for each world.
    model_of: Vec<usize>,
    dt: f64,
    accuracy: Option<f64>,
    layout: LaneLayout,
    groups: Vec<Group<R>>,
    workers: Workers<R>,
    /// Whether a failed world stops alone, and the others continue; else all stop with it.
    pub goes_on: bool,
}

/// The index of the model of each world, if there is one; refuses more worlds than fit in memory.
pub fn of_one_model<N: Constant>(model: &Model<N>, worlds: usize) -> Result<Vec<usize>> {
    let bytes = worlds.checked_mul(bytes_a_world(model));
    if !bytes.is_some_and(can_be_had) {
        return Err(Error::value("n", worlds, "a number of worlds that the memory can hold"));
    }
    Ok(vec![0; worlds])
}

/// A little more than the memory of a world's numbers here and in the user's arrays.
fn bytes_a_world<N: Constant>(model: &Model<N>) -> usize {
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
        let kinds = kinds(&models);
        Self::of_kinds(models, model_of, settings, threads, kinds)
    }

    /// The same for models whose kinds are known.
    pub fn of_kinds(
        models: Vec<Arc<Model>>,
        model_of: &[usize],
        settings: &Settings,
        threads: usize,
        kinds: Vec<usize>,
    ) -> Result<Self> {
        settings.check()?;
        let worlds = model_of.len();
        if worlds == 0 {
            return Err(Error::value("n", worlds, "at least 1 world"));
        }
        check_threads(threads)?;
        let kinds = match R::LANES {
            1 => (0..models.len()).collect(),
            _ => kinds,
        };
        let layout = LaneLayout::new(R::LANES, &kinds, model_of);
        let side_by_side = |index: usize| {
            let own = layout.worlds(index).iter().map(|world| models[model_of[*world]].clone());
            SideBySide::new(own.collect())
        };
        let mut all: Vec<SideBySide<R>> = vec![];
        for index in 0..layout.groups() {
            let known = all.last().filter(|last| {
                layout.worlds(index).iter().all(|world| last.all_are(&models[model_of[*world]]))
            });
            let own = known.cloned().map_or_else(|| side_by_side(index), Ok)?;
            all.push(own);
        }
        let workers = Workers::new(&all, settings, &layout, worlds, threads)?;
        // As in `Watched`: adaptive steps do their own checks.
        let fixed = settings.accuracy.0.is_none();
        let group = |index: usize| {
            let (own, worlds) = (layout.kind(index), layout.worlds(index).len());
            let every = layout.groups().div_ceil(WATCHED.div_ceil(R::LANES));
            let watched = fixed && index.is_multiple_of(every);
            let least = watched.then_some(Care::Least);
            let care = if settings.ledger { Some(Care::Full) } else { least };
            Group::new(all[index].clone(), workers.initial_sleep(own), worlds, care)
        };
        let groups = (0..layout.groups()).map(group).collect();

        Ok(Self {
            worlds,
            dt: settings.dt,
            accuracy: settings.accuracy.0,
            groups,
            workers,
            goes_on: false,
            models,
            model_of: model_of.to_vec(),
            layout,
        })
    }

    /// Memory of all worlds and of the threads' working spaces [bytes]; without the models, except
    /// the parts that lanes have of them.
    pub fn bytes(&self) -> usize {
        let models = self.groups.chunk_by(|a, b| Arc::ptr_eq(&a.models.model, &b.models.model));
        let models = match R::LANES {
            1 => 0,
            _ => models.map(|same| same[0].models.model.bytes()).sum(),
        };
        size_of::<Self>()
            + self.layout.bytes()
            + listed(&self.model_of)
            + self.groups.room()
            + self.workers.bytes()
            + models
    }

    pub fn time(&self) -> f64 {
        self.groups[0].state.time(self.dt)
    }

    /// Refuses arrays of a world that cannot be stepped.
    pub fn check(&self, world: usize, given: &Arrays) -> Result<()> {
        given.check::<R>(self.model(world), Some(world))
    }

    /// The model of a world.
    pub fn model(&self, world: usize) -> &Arc<Model> {
        &self.models[self.model_of[world]]
    }

    /// Gives the worlds models that differ in numbers from their present ones, `model_of` as in
    /// `of_models`: registers of worlds whose models stay the same are left unchanged. False: this
    /// is impossible, and nothing has changed.
    pub fn set_models(&mut self, models: &[Arc<Model>], model_of: &[usize]) -> bool {
        let Self { groups, layout, workers, .. } = self;
        if groups.iter().any(|group| group.standing.any()) {
            return false;
        }
        let new = |world: usize| &models[model_of[world]];
        let mut made = vec![];
        for index in 0..layout.groups() {
            let (own, worlds) = (&groups[index].models, layout.worlds(index));
            let changed =
                |(lane, world): &(usize, &usize)| !Arc::ptr_eq(own.of(*lane), new(**world));
            let fits = |(lane, world): (usize, &usize)| {
                differ_in_numbers(own.of(lane), new(*world)) && workers.takes(new(*world))
            };
            let changed: Vec<_> = worlds.iter().enumerate().filter(changed).collect();
            if changed.is_empty() {
                continue;
            }
            let models = || worlds.iter().map(|world| new(*world).clone()).collect();
            match changed.into_iter().all(fits).then(|| SideBySide::new(models())) {
                Some(Ok(models)) => made.push((index, models)),
                _ => return false,
            }
        }
        for (index, models) in made {
            groups[index].take_models(models);
        }
        (self.models, self.model_of) = (models.to_vec(), model_of.to_vec());
        true
    }

    /// All worlds, grouped by model.
    pub fn by_model(&self) -> &[usize] {
        self.layout.all()
    }

    /// Copies a world's checked arrays in. Worlds come in order; lanes without a world repeat the
    /// last one.
    pub fn put(&mut self, world: usize, given: &Arrays) {
        let (index, own) = self.layout.of(world);
        self.groups[index].put(own, self.layout.worlds(index).len(), given);
    }

    /// Copies a world's part of an array that a step changes into `out`.
    pub fn take(&self, world: usize, array: Array, out: &mut [f64]) {
        let (index, lane) = self.layout.of(world);
        let group = &self.groups[index];
        match &group.standing.lanes[lane] {
            None => group.state.take(lane, array, out),
            Some(failed) => out.copy_from_slice(&failed.state[array as usize]),
        }
    }

    /// A world that failed while the others continued.
    pub fn failed(&self, world: usize) -> Option<&Failed> {
        let (group, lane) = self.layout.of(world);
        self.groups[group].standing.lanes[lane].as_deref()
    }

    /// Marks these worlds as failed, as they were in a batch that this one replaces.
    pub fn set_failed(&mut self, failed: Vec<Option<Failed>>) {
        for (world, failed) in failed.into_iter().enumerate() {
            let (group, lane) = self.layout.of(world);
            self.groups[group].standing.lanes[lane] = failed.map(Box::new);
        }
    }

    /// The last states of a world, with which another batch continues.
    pub fn past(&self, world: usize) -> WorldPast {
        let (group, lane) = self.layout.of(world);
        self.groups[group].past.of(lane)
    }

    /// Continues a world of another batch; see `past`.
    pub fn take_past(&mut self, world: usize, past: &WorldPast) {
        let (group, lane) = self.layout.of(world);
        self.groups[group].past.take(lane, past);
    }

    /// Restarts some worlds, wherever their arrays put them: they have no impulses to start from,
    /// have not failed, and nothing was solved there yet. The others are as they were.
    pub fn forget(&mut self, worlds: &[usize]) {
        for world in worlds {
            let (index, own) = self.layout.of(*world);
            let last = if own + 1 == self.layout.worlds(index).len() { R::LANES } else { own + 1 };
            (own..last).for_each(|lane| self.groups[index].forget(lane));
        }
    }

    /// Restarts all worlds at a time, wherever their arrays put them: without impulses.
    pub fn restart(&mut self, start: f64) {
        for (state, _) in self.states_mut() {
            (state.start, state.steps) = (start, 0);
            state.warm.clear();
        }
        self.groups.iter_mut().for_each(Group::put_to_sleep);
    }

    /// Records that the present states did not come from a solve.
    pub fn unsolved(&mut self) {
        self.groups.iter_mut().for_each(Group::unsolved);
    }

    /// Records that a world's last solve started with these arrays, and gave this acceleration.
    pub fn begin(&mut self, world: usize, given: &Arrays, of: Last, qacc: &[f64]) {
        let (index, own) = self.layout.of(world);
        self.groups[index].begin(own, self.layout.worlds(index).len(), given, of, qacc);
    }

    /// The states at the start of the last solves of all groups, with the worlds in their lanes.
    pub fn begun_mut(&mut self) -> impl Iterator<Item = (&mut State<R>, &[usize])> {
        let Self { groups, layout, .. } = self;
        let groups = groups.iter_mut().enumerate();
        groups.map(|(index, group)| (&mut group.before, layout.worlds(index)))
    }

    /// A world's acceleration in its last solve.
    pub fn qacc(&self, world: usize) -> impl Iterator<Item = f64> + '_ {
        let (group, lane) = self.layout.of(world);
        self.groups[group].qacc.iter().map(move |a| a.lane(lane))
    }

    /// The actuators' forces in the last solves, one world after the other, if they were kept.
    pub fn actuator_forces(&self) -> Option<Vec<f64>> {
        let mut forces = Vec::new();
        for world in 0..self.worlds {
            let (group, lane) = self.layout.of(world);
            forces.extend(self.groups[group].actuator()?.iter().map(|force| force.lane(lane)));
        }
        Some(forces)
    }

    /// For a world: the state at the start of its last solve, its inputs, its lane in these, and
    /// the call to which the solve belonged.
    pub fn last(&self, world: usize) -> (&State<R>, &Inputs<R>, usize, Last) {
        let (index, lane) = self.layout.of(world);
        let group = &self.groups[index];
        (&group.before, &group.inputs, lane, group.last[lane])
    }

    /// The state that holds a world, and its lane there.
    pub fn state(&self, world: usize) -> (&State<R>, usize) {
        let (group, lane) = self.layout.of(world);
        (&self.groups[group].state, lane)
    }

    /// The states of all groups, with the worlds in their lanes.
    pub fn states_mut(&mut self) -> impl Iterator<Item = (&mut State<R>, &[usize])> {
        let Self { groups, layout, .. } = self;
        groups.iter_mut().enumerate().map(|(index, group)| {
            // A caller that writes a state starts anew.
            group.ledger.iter_mut().for_each(|ledger| ledger.forget());
            group.standing.lanes.fill(None);
            group.ended.fill(false);
            (&mut group.state, layout.worlds(index))
        })
    }

    /// Advances every world by `n` steps. If one leaves the finite numbers, all stop before the
    /// first step in which one did.
    pub fn step(&mut self, n: u64) -> Result<()> {
        self.advance(n, None)
    }

    /// Without `Settings::ledger`: the warning that a world gained more energy than possible, and
    /// its source. It is given once, and nothing is checked after that.
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

    /// The world that makes adaptive steps slow, and the reason: the one with the shortest part.
    pub fn slow(&self) -> Option<String> {
        let slow =
            self.groups.iter().enumerate().filter(|(_, own)| own.stretches.refused.is_some());
        let shortest = |own: &Group<R>| own.stretches.shortest;
        let (index, group) = slow.min_by(|a, b| shortest(a.1).total_cmp(&shortest(b.1)))?;
        let world = self.layout.worlds(index)[0];
        let why = group.stretches.slow(self.dt, self.accuracy, self.model(world))?;
        Some(format!("world {world}: {why}"))
    }

    /// Ends and balances the accounts of energy: the worlds continue elsewhere.
    pub fn balance(&mut self) -> Result<()> {
        self.advance(0, None)
    }

    /// Without `Settings::ledger`, stops checking energies.
    pub fn unwatch(&mut self) {
        self.groups.iter_mut().for_each(Group::unwatch);
    }

    /// Runs place, detect and solve in every world. Nothing is committed.
    pub fn forward(&mut self) -> Result<()> {
        self.evaluate(Last::Forward, Watched::forward)
    }

    /// Puts every world where its step evaluates its forces last.
    pub fn go_to_last_stage(&mut self) -> Result<()> {
        let outcome = self.evaluate(Last::Nothing, Watched::go_to_last_stage);
        self.unsolved();
        outcome
    }

    fn evaluate(
        &mut self,
        last: Last,
        evaluate: impl Fn(&mut Watched<R>) -> Result<()> + Sync,
    ) -> Result<()> {
        let Self { workers, groups, layout, goes_on, .. } = self;
        groups.iter_mut().for_each(|group| group.begun = false);
        workers.share(groups, 1, |workspace, index, group| {
            let one = |_, watched: &mut Watched<R>| evaluate(watched);
            let none = |_, _: &mut Watched<R>| Ok(());
            group.begin_call();
            group.attempt(workspace.space(layout.kind(index)), |group, watched| {
                group.run(watched, layout.worlds(index), 1, last, *goes_on, one, none);
            });
        });
        undo_if_interrupted(groups)?;
        first_failure(groups, layout).map_or(Ok(()), |(_, error)| Err(error))
    }

    /// Steps `from..from + n` of a motion.
    pub fn follow(&mut self, motion: &mut Motion, from: usize, n: usize) -> Result<()> {
        let begins = from == 0 && motion.first;
        let parts = motion.parts(&self.layout, &self.models[0]);
        let parts: Vec<Mutex<Part>> = parts.into_iter().map(Mutex::new).collect();
        if begins {
            self.begin_motion(&parts)?;
        }
        self.advance(n as u64, Some((&parts, from)))?;
        drop(parts);
        for world in 0..self.worlds {
            if let Some(failed) = self.failed(world) {
                motion.stand(world, &failed.state, from + failed.done as usize, from + n);
            }
        }
        Ok(())
    }

    /// Samples the start.
    fn begin_motion(&mut self, parts: &[Mutex<Part>]) -> Result<()> {
        let Self { workers, groups, layout, .. } = self;
        let refused = Mutex::new(None);
        workers.share(groups, 1, |workspace, index, group| {
            let watched = workspace.space(layout.kind(index));
            let outcome = group.look(watched, |watched| lock(&parts[index]).begin(watched));
            if let Err(error) = outcome {
                *lock(&refused) = Some(error);
            }
        });
        let refused = lock(&refused).take();
        refused.map_or(Ok(()), Err)
    }

    /// Does `n` steps in every world; steps of a motion from this one on.
    fn advance(&mut self, n: u64, motion: Option<(&[Mutex<Part>], usize)>) -> Result<()> {
        let Self { workers, groups, layout, goes_on, .. } = self;
        let run = |workspace: &mut Workspace<R>, index: usize, group: &mut Group<R>, n| {
            let part = motion.map(|(parts, start)| (&parts[index], start));
            let one = |k: u64, watched: &mut Watched<R>| match part {
                None => watched.step(1),
                Some((part, start)) => lock(part).step(start + k as usize, k == 0, watched),
            };
            let check = |k: u64, watched: &mut Watched<R>| match part {
                None => Ok(()),
                Some((part, start)) => lock(part).check(start + k as usize, watched),
            };
            group.attempt(workspace.space(layout.kind(index)), |group, watched| {
                group.run(watched, layout.worlds(index), n, Last::Step, *goes_on, one, check);
            });
        };
        groups.iter_mut().for_each(|group| group.begun = false);
        workers.share(groups, n, |workspace, index, group| {
            group.begin_call();
            run(workspace, index, group, n);
        });
        undo_if_interrupted(groups)?;
        let Some((done, error)) = first_failure(groups, layout) else { return Ok(()) };
        let failed = match &error {
            Error::Diverged(divergence) => Some(layout.of(divergence.world)),
            _ => None,
        };
        // All worlds go back, and then forward to where this one was still healthy.
        workers.share(groups, done, |workspace, index, group| {
            group.go_back(done);
            run(workspace, index, group, done);
            let lane = failed.filter(|(group, _)| *group == index).map(|(_, lane)| lane);
            if group.failed.is_none() {
                group.attempt(workspace.space(layout.kind(index)), |group, watched| {
                    group.stop(watched, lane);
                });
            }
        });
        undo_if_interrupted(groups)?;
        Err(error)
    }
}

/// Puts all worlds back to the start of the call, if it was interrupted.
fn undo_if_interrupted<R: Real>(groups: &mut [Group<R>]) -> Result<()> {
    if !groups.iter().any(|group| matches!(group.failed, Some((_, Error::Interrupted)))) {
        return Ok(());
    }
    for group in groups {
        if group.begun {
            drop(group.take_said());
            group.failed = None;
            group.go_back(0);
        }
        group.unsolved();
    }
    Err(Error::Interrupted)
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
