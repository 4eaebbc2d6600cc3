//! Many worlds of either precision, in lanes or one by one, behind one interface: the content of
//! `Batch` in Python.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;

use stepcore::arrays::{lists, Array, Given, Givens};
use stepcore::batch::{fills_lanes, gains_by_lanes, kinds, Batch, Failed, Last, Motion};
use stepcore::error::{Error, Result};
use stepcore::model::Model;
use stepcore::real::Real;
use stepcore::settings::{Precision, Settings};
use stepcore::warm::Sleep;
use stepcore::watch::WorldPast;

use crate::auto::{Auto, Make};
use crate::memo::{put_memos, Lists, Memo, Solve};
use crate::world::World;

// Worlds in lanes, if the module has lanes.
#[cfg(not(feature = "single"))]
pub use stepcore::real::{Lanes as Wide, LanesF32 as WideF32};
#[cfg(feature = "single")]
pub type Wide = f64;
#[cfg(feature = "single")]
pub type WideF32 = f32;

pub trait Worlds: Send + Sync {
    fn check(&self, world: usize, given: &Given) -> Result<()>;
    fn put(&mut self, world: usize, given: &Given);
    /// Checks the arrays of all worlds, then puts them.
    fn load(&mut self, given: &Givens) -> Result<()>;
    /// Copies out an array that a step changes, for all worlds.
    fn store(&self, array: Array, numbers: &mut [f64]);
    fn step(&mut self, n: u64) -> Result<()>;
    fn forward(&mut self) -> Result<()>;
    fn go_to_last_stage(&mut self) -> Result<()>;
    fn follow(&mut self, motion: &mut Motion, from: usize, n: usize) -> Result<()>;
    /// The error of a world that failed while the others continued.
    fn failed(&self, world: usize) -> Option<&Error>;
    fn time(&self) -> f64;
    fn qacc(&self) -> Vec<f64>;
    /// The actuators' forces in the last solves, if they were kept.
    fn actuator_forces(&self) -> Option<Vec<f64>>;
    /// The worlds that failed while the others continued; and the failures of a replaced batch.
    fn failures(&self) -> Vec<Option<Failed>>;
    fn set_failures(&mut self, failed: Vec<Option<Failed>>);
    /// The last states of a world, and of another batch's world that continues here.
    fn past(&self, world: usize) -> WorldPast;
    fn take_past(&mut self, world: usize, past: &WorldPast);
    /// A world's arrays as they are here.
    fn lists(&self, world: usize) -> Lists;
    /// Repeats a world's last solve in `into`, which then has its rows and contacts.
    fn again(&self, world: usize, into: &mut dyn World) -> Result<()>;
    /// Puts `into` at the start of a world's last solve, for readings that solve there.
    fn before(&self, world: usize, into: &mut dyn World) -> Result<()>;
    fn memo(&self, world: usize) -> Memo;
    fn memos(&self) -> Vec<Memo> {
        (0..self.by_model().len()).map(|world| self.memo(world)).collect()
    }
    fn set_memos(&mut self, memos: &[Memo]);
    /// The initial state and inputs of a world's last solve.
    fn last_of(&self, world: usize) -> Option<Solve>;
    /// Sets the starts of the last solves.
    fn set_lasts(&mut self, lasts: &[Option<Solve>]);
    /// Sets time and steps of all worlds, and removes impulses.
    fn restart(&mut self, start: f64);
    /// Records that the present states did not come from a solve.
    fn unsolved(&mut self);
    /// Restarts some worlds; see `Batch::forget`.
    fn forget(&mut self, worlds: &[usize]);
    /// A warning about a world's energies, given once; see `unwatch`.
    fn take_warning(&mut self) -> Option<String>;
    /// The reason why adaptive steps are slow.
    fn slow(&self) -> Option<String>;
    /// Balances accounts of energy where they end: before worlds continue elsewhere.
    fn balance(&mut self) -> Result<()>;
    /// Stops checking energies, except in the ledger of the settings.
    fn unwatch(&mut self);
    /// Whether worlds are in lanes now.
    fn in_lanes(&self) -> bool;
    /// For tests: changes the way at every step, whichever takes less time.
    fn turn_at_every_step(&mut self) {}
    /// Memory [bytes]; models are not in it.
    fn bytes(&self) -> usize;
    fn model(&self, world: usize) -> &Arc<Model>;
    /// Gives the worlds models that differ in numbers from their present ones; false: that is
    /// impossible here, and nothing has changed.
    fn set_models(&mut self, how: &How, models: &[Arc<Model>], model_of: &[usize]) -> bool;
    /// All worlds, grouped by model.
    fn by_model(&self) -> &[usize];
}

/// How worlds are stepped.
#[derive(Clone)]
pub struct How {
    pub settings: Settings,
    pub threads: usize,
    /// In lanes if possible; None: if it takes less time.
    pub lanes: Option<bool>,
    /// Whether a failed world stops alone, and the others continue.
    pub goes_on: bool,
    /// Whether checking energies was stopped, in all worlds that are made.
    pub unwatched: Arc<AtomicBool>,
}

impl How {
    /// Worlds in the precision of the settings; `model_of`: the model of each.
    pub fn worlds(&self, models: Vec<Arc<Model>>, model_of: &[usize]) -> Result<Box<dyn Worlds>> {
        let width = if self.single() { <WideF32>::LANES } else { <Wide>::LANES };
        let gains = models.iter().all(|model| gains_by_lanes(model, &self.settings));
        self.settings.check()?;
        let kinds = kinds(&models);
        let can = width > 1 && gains && fills_lanes(&kinds, model_of, width);
        // An account of energies stays with its worlds, and one world has no neighbours.
        if self.lanes.is_some() || !can || self.settings.ledger || model_of.len() == 1 {
            let alone = self.lanes.is_none() && model_of.len() == 1;
            let lanes = can && !alone && self.lanes != Some(false);
            return self.made(lanes, models, model_of, kinds);
        }
        let by_world = model_of.iter().map(|model| kinds[*model]).collect();
        Ok(Box::new(Auto::new(by_world, self.make(models, model_of, kinds))?))
    }

    /// Makes these worlds, or some of them, in lanes or one by one.
    pub fn make(
        &self,
        models: Vec<Arc<Model>>,
        model_of: &[usize],
        kinds: Vec<usize>,
    ) -> Box<Make> {
        let (how, own) = (self.clone(), model_of.to_vec());
        Box::new(move |lanes, some: Option<&[usize]>| match some {
            None => how.made(lanes, models.clone(), &own, kinds.clone()),
            Some(some) => {
                let own: Vec<usize> = some.iter().map(|world| own[*world]).collect();
                how.made(lanes, models.clone(), &own, kinds.clone())
            }
        })
    }

    fn single(&self) -> bool {
        self.settings.precision == Precision::F32
    }

    fn made(
        &self,
        lanes: bool,
        models: Vec<Arc<Model>>,
        model_of: &[usize],
        kinds: Vec<usize>,
    ) -> Result<Box<dyn Worlds>> {
        match (self.single(), lanes) {
            (false, true) => self.made_of::<Wide>(models, model_of, kinds),
            (false, false) => self.made_of::<f64>(models, model_of, kinds),
            (true, true) => self.made_of::<WideF32>(models, model_of, kinds),
            (true, false) => self.made_of::<f32>(models, model_of, kinds),
        }
    }

    fn made_of<R: Real>(
        &self,
        models: Vec<Arc<Model>>,
        model_of: &[usize],
        kinds: Vec<usize>,
    ) -> Result<Box<dyn Worlds>> {
        let Self { settings, threads, .. } = self;
        let mut batch = Batch::<R>::of_kinds(models, model_of, settings, *threads, kinds)?;
        batch.goes_on = self.goes_on;
        if self.unwatched.load(Ordering::Relaxed) {
            batch.unwatch();
        }
        Ok(Box::new(batch))
    }
}

impl<R: Real> Worlds for Batch<R> {
    fn set_models(&mut self, _: &How, models: &[Arc<Model>], model_of: &[usize]) -> bool {
        self.set_models(models, model_of)
    }
    fn check(&self, world: usize, given: &Given) -> Result<()> {
        Batch::check(self, world, given)
    }
    fn put(&mut self, world: usize, given: &Given) {
        Batch::put(self, world, given);
    }
    fn load(&mut self, given: &Givens) -> Result<()> {
        Batch::load(self, given)
    }
    fn store(&self, array: Array, numbers: &mut [f64]) {
        Batch::store(self, array, numbers);
    }
    fn step(&mut self, n: u64) -> Result<()> {
        Batch::step(self, n)
    }
    fn forward(&mut self) -> Result<()> {
        Batch::forward(self)
    }
    fn go_to_last_stage(&mut self) -> Result<()> {
        Batch::go_to_last_stage(self)
    }
    fn follow(&mut self, motion: &mut Motion, from: usize, n: usize) -> Result<()> {
        Batch::follow(self, motion, from, n)
    }
    fn failed(&self, world: usize) -> Option<&Error> {
        Batch::failed(self, world).map(|failed| &failed.error)
    }
    fn failures(&self) -> Vec<Option<Failed>> {
        (0..self.worlds).map(|world| Batch::failed(self, world).cloned()).collect()
    }
    fn set_failures(&mut self, failed: Vec<Option<Failed>>) {
        Batch::set_failed(self, failed);
    }
    fn past(&self, world: usize) -> WorldPast {
        Batch::past(self, world)
    }
    fn take_past(&mut self, world: usize, past: &WorldPast) {
        Batch::take_past(self, world, past);
    }
    fn time(&self) -> f64 {
        Batch::time(self)
    }
    fn qacc(&self) -> Vec<f64> {
        (0..self.worlds).flat_map(|world| Batch::qacc(self, world)).collect()
    }

    fn actuator_forces(&self) -> Option<Vec<f64>> {
        Batch::actuator_forces(self)
    }

    fn lists(&self, world: usize) -> Lists {
        let (state, lane) = self.state(world);
        let (_, inputs, ..) = self.last(world);
        lists(state, inputs, lane)
    }

    fn again(&self, world: usize, into: &mut dyn World) -> Result<()> {
        self.before(world, into)?;
        let (.., last) = self.last(world);
        match last {
            // If it fails, as where the world failed, there is nothing to read.
            _ if last == Last::Forward || Batch::failed(self, world).is_some() => {
                match into.forward() {
                    Err(Error::Diverged(_)) => Ok(()),
                    outcome => outcome,
                }
            }
            Last::Nothing | Last::Forward => Ok(()),
            Last::Step => into.step(1),
        }
    }

    fn before(&self, world: usize, into: &mut dyn World) -> Result<()> {
        match self.last_of(world) {
            Some(Solve { lists, memo, .. }) => {
                into.put(&Given::new(|array| &lists[array as usize]));
                into.set_memo(&memo);
                into.stayed();
            }
            None => into.unsolved(),
        }
        Ok(())
    }

    fn last_of(&self, world: usize) -> Option<Solve> {
        let (state, inputs, lane, of) = self.last(world);
        let failed = Batch::failed(self, world);
        if of == Last::Nothing && failed.is_none() {
            return None;
        }
        let qacc: Vec<f64> = Batch::qacc(self, world).collect();
        let (mut lists, mut memo) = (lists(state, inputs, lane), Memo::of(state, lane));
        let Some(failed) = failed else { return Some(Solve { of, qacc, lists, memo }) };
        // Its last solve led nowhere: readings are for its present state. Its lane has other
        // impulses.
        lists[..Array::CHANGED].clone_from_slice(&failed.state);
        memo.forget();
        let now = self.state(world).0;
        (memo.start, memo.steps) = (now.start, now.steps);
        let qacc = vec![0.0; qacc.len()];
        Some(Solve { of: Last::Forward, qacc, lists, memo })
    }

    fn set_lasts(&mut self, lasts: &[Option<Solve>]) {
        self.unsolved();
        for (world, last) in lasts.iter().enumerate() {
            if let Some(last) = last {
                self.begin(world, &last.given(), last.of, &last.qacc);
            }
        }
        let none = Memo { start: 0.0, steps: 0, warm: Vec::new(), sleep: Sleep::new() };
        let memos = lasts.iter().map(|last| last.as_ref().map_or(&none, |last| &last.memo));
        let memos: Vec<&Memo> = memos.collect();
        for (state, worlds) in self.begun_mut() {
            put_memos(state, worlds.iter().map(|world| memos[*world]).collect());
        }
    }

    fn memo(&self, world: usize) -> Memo {
        let (state, lane) = self.state(world);
        let mut memo = Memo::of(state, lane);
        // A failed world's lane holds another's impulses.
        if Batch::failed(self, world).is_some() {
            memo.forget();
        }
        memo
    }

    fn set_memos(&mut self, memos: &[Memo]) {
        for (state, worlds) in self.states_mut() {
            put_memos(state, worlds.iter().map(|world| &memos[*world]).collect());
        }
    }

    fn unsolved(&mut self) {
        Batch::unsolved(self);
    }
    fn forget(&mut self, worlds: &[usize]) {
        Batch::forget(self, worlds);
    }
    fn take_warning(&mut self) -> Option<String> {
        Batch::take_warning(self)
    }
    fn slow(&self) -> Option<String> {
        Batch::slow(self)
    }
    fn balance(&mut self) -> Result<()> {
        Batch::balance(self)
    }
    fn unwatch(&mut self) {
        Batch::unwatch(self);
    }
    fn in_lanes(&self) -> bool {
        R::LANES > 1
    }
    fn bytes(&self) -> usize {
        Batch::bytes(self)
    }
    fn model(&self, world: usize) -> &Arc<Model> {
        Batch::model(self, world)
    }
    fn by_model(&self) -> &[usize] {
        Batch::by_model(self)
    }

    fn restart(&mut self, start: f64) {
        Batch::restart(self, start);
    }
}
