//! Worlds in lanes or one by one, whichever takes less time: it is measured while they run.
//!
//! If neighbours touch different things a register does the work of all of them, and can take
//! longer than its worlds alone. Both ways give the same bits, so a batch may change between them
//! at any step: now and then it takes one step the other way, and stays with the faster one.

use std::sync::Arc;
use std::time::{Duration, Instant};

use stepcore::arrays::{Array, Given, Givens};
use stepcore::batch::{Failed, Motion};
use stepcore::error::{Error, Result};
use stepcore::model::Model;
use stepcore::real::WIDEST;
use stepcore::watch::WorldPast;

use crate::memo::{Lists, Memo, Solve};
use crate::world::World;
use crate::worlds::{How, Worlds};

/// The steps after which the other way is tried first; and from one trial to the next, at least and
/// at most, doubling in between.
const FIRST: u64 = 2;
const LEAST: u64 = 8;
const MOST: u64 = 512;
/// The last trials decide by their median: a single one may have been disturbed.
const VOTES: usize = 3;
/// Up to `KEPT` worlds both ways are kept. For more, both would need too much memory: `SAMPLE` of
/// them are tried both ways, neighbours that share a register, from evenly spread registers.
const KEPT: usize = 1 << 16;
const SAMPLE: usize = 1 << 11;

/// Worlds in lanes or one by one: all of them, or some.
pub type Make = dyn Fn(bool, Option<&[usize]>) -> Result<Box<dyn Worlds>> + Send + Sync;

pub struct Auto {
    worlds: usize,
    /// For each world the kind of its models, which stays whatever their numbers are.
    kinds: Vec<usize>,
    now: Box<dyn Worlds>,
    /// The other way, once it was tried.
    other: Option<Box<dyn Worlds>>,
    make: Box<Make>,
    in_lanes: bool,
    /// The duration of a step in the last portion.
    cost: Duration,
    /// Time of a step in lanes over the time one by one, in the last trials.
    ratios: Vec<f64>,
    steps: u64,
    /// The steps at the last turn.
    turned: u64,
    next: u64,
    gap: u64,
    /// Whether the next step is to be taken the other way.
    change: bool,
    /// Whether a world failed: only the present way has its state.
    fixed: bool,
    /// Whether every step is a trial.
    always: bool,
}

impl Auto {
    /// `kinds`: by world; `make(lanes, some)`: the same worlds, or some, in lanes or one by one.
    pub fn new(kinds: Vec<usize>, make: Box<Make>) -> Result<Self> {
        Ok(Self {
            worlds: kinds.len(),
            kinds,
            now: make(true, None)?,
            other: None,
            make,
            in_lanes: true,
            cost: Duration::ZERO,
            ratios: Vec::with_capacity(VOTES + 1),
            steps: 0,
            turned: 0,
            next: FIRST,
            gap: LEAST,
            change: false,
            fixed: false,
            always: false,
        })
    }

    /// Does `n` steps, in portions of one way each.
    fn advance(
        &mut self,
        n: u64,
        mut step: impl FnMut(&mut dyn Worlds, u64) -> Result<()>,
    ) -> Result<()> {
        let mut left = n;
        while left > 0 {
            let due = (self.always || self.steps >= self.next) && self.may_change();
            let trial = due && self.worlds <= KEPT;
            if due && !trial {
                self.try_sample()?;
            }
            if trial || std::mem::take(&mut self.change) && self.may_change() {
                self.turn()?;
            }
            let until = self.next.saturating_sub(self.steps);
            // A trial is of one step, as is the one before it, with which it is compared.
            let portion = match until {
                _ if trial => 1,
                0 => left,
                1 => 1,
                until => left.min(until - 1),
            };
            let started = Instant::now();
            let outcome = step(&mut *self.now, portion);
            let took = started.elapsed() / portion.min(u32::MAX.into()) as u32;
            let before = std::mem::replace(&mut self.cost, took);
            if let Err(error) = outcome {
                // The other way has checked only a part of the steps.
                (self.fixed, self.other) = (true, None);
                return Err(error);
            }
            (self.steps, left) = (self.steps + portion, left - portion);
            if trial {
                self.tried();
                let (lanes, alone) = if self.in_lanes { (took, before) } else { (before, took) };
                self.change = self.lanes_win(lanes, alone) != self.in_lanes;
            }
        }
        Ok(())
    }

    /// Schedules the next trial.
    fn tried(&mut self) {
        (self.next, self.gap) = (self.steps + self.gap, (2 * self.gap).min(MOST));
    }

    /// Steps some of the worlds both ways in copies; all worlds change if that is faster.
    fn try_sample(&mut self) -> Result<()> {
        self.tried();
        let order = self.now.by_model();
        let spread = order.chunks_exact(WIDEST).step_by(self.worlds / SAMPLE);
        let some: Vec<usize> = spread.take(SAMPLE / WIDEST).flatten().copied().collect();
        let memos: Vec<Memo> = some.iter().map(|world| self.now.memo(*world)).collect();
        let mut times = [Duration::ZERO; 2];
        for (lanes, time) in [true, false].into_iter().zip(&mut times) {
            let mut made = (self.make)(lanes, Some(&some))?;
            made.set_memos(&memos);
            for (place, world) in some.iter().enumerate() {
                let lists = self.now.lists(*world);
                made.put(place, &Given::new(|array| &lists[array as usize]));
            }
            // The first step allocates memory.
            let started = if made.step(1).is_ok() { Instant::now() } else { return Ok(()) };
            if made.step(1).is_err() {
                return Ok(());
            }
            *time = started.elapsed();
        }
        self.change = self.lanes_win(times[0], times[1]) != self.in_lanes;
        Ok(())
    }

    /// Whether lanes take less time than worlds alone, which took this long in a trial.
    fn lanes_win(&mut self, lanes: Duration, alone: Duration) -> bool {
        self.ratios.push(lanes.as_secs_f64() / alone.as_secs_f64().max(1e-9));
        if self.ratios.len() > VOTES {
            self.ratios.remove(0);
        }
        let mut sorted = self.ratios.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2] < 1.0
    }

    fn may_change(&mut self) -> bool {
        self.fixed = self.fixed || (0..self.worlds).any(|world| self.now.failed(world).is_some());
        !self.fixed
    }

    /// Continues the other way.
    fn turn(&mut self) -> Result<()> {
        if self.steps - std::mem::replace(&mut self.turned, self.steps) >= LEAST {
            self.now.balance()?;
        }
        let mut other = match self.other.take() {
            Some(other) => other,
            None => (self.make)(!self.in_lanes, None)?,
        };
        other.set_memos(&self.now.memos());
        for world in 0..self.worlds {
            let lists = self.now.lists(world);
            other.put(world, &Given::new(|array| &lists[array as usize]));
            other.take_past(world, &self.now.past(world));
        }
        let before = std::mem::replace(&mut self.now, other);
        self.other = (self.worlds <= KEPT).then_some(before);
        self.in_lanes = !self.in_lanes;
        Ok(())
    }

    /// Restarts the trials: all worlds start anew.
    fn anew(&mut self) {
        (self.fixed, self.change) = (false, false);
    }
}

impl Worlds for Auto {
    fn set_models(&mut self, how: &How, models: &[Arc<Model>], model_of: &[usize]) -> bool {
        let taken = self.now.set_models(how, models, model_of);
        if taken {
            self.other.take_if(|other| !other.set_models(how, models, model_of));
            let mut kinds = vec![0; models.len()];
            model_of.iter().zip(&self.kinds).for_each(|(model, kind)| kinds[*model] = *kind);
            self.make = how.make(models.to_vec(), model_of, kinds);
        }
        taken
    }
    fn check(&self, world: usize, given: &Given) -> Result<()> {
        self.now.check(world, given)
    }
    fn put(&mut self, world: usize, given: &Given) {
        self.now.put(world, given);
    }
    fn load(&mut self, given: &Givens) -> Result<()> {
        self.now.load(given)
    }
    fn store(&self, array: Array, numbers: &mut [f64]) {
        self.now.store(array, numbers);
    }
    fn step(&mut self, n: u64) -> Result<()> {
        self.advance(n, |worlds, n| worlds.step(n))
    }
    fn forward(&mut self) -> Result<()> {
        let outcome = self.now.forward();
        self.fixed = self.fixed || outcome.is_err();
        outcome
    }
    fn go_to_last_stage(&mut self) -> Result<()> {
        let outcome = self.now.go_to_last_stage();
        self.fixed = self.fixed || outcome.is_err();
        outcome
    }
    fn follow(&mut self, motion: &mut Motion, from: usize, n: usize) -> Result<()> {
        let mut from = from;
        self.advance(n as u64, |worlds, n| {
            worlds.follow(motion, from, n as usize)?;
            from += n as usize;
            Ok(())
        })
    }
    fn failed(&self, world: usize) -> Option<&Error> {
        self.now.failed(world)
    }
    fn failures(&self) -> Vec<Option<Failed>> {
        self.now.failures()
    }
    fn set_failures(&mut self, failed: Vec<Option<Failed>>) {
        self.now.set_failures(failed);
    }
    fn past(&self, world: usize) -> WorldPast {
        self.now.past(world)
    }
    fn take_past(&mut self, world: usize, past: &WorldPast) {
        self.now.take_past(world, past);
    }
    fn time(&self) -> f64 {
        self.now.time()
    }
    fn qacc(&self) -> Vec<f64> {
        self.now.qacc()
    }
    fn actuator_forces(&self) -> Option<Vec<f64>> {
        self.now.actuator_forces()
    }
    fn lists(&self, world: usize) -> Lists {
        self.now.lists(world)
    }
    fn again(&self, world: usize, into: &mut dyn World) -> Result<()> {
        self.now.again(world, into)
    }
    fn before(&self, world: usize, into: &mut dyn World) -> Result<()> {
        self.now.before(world, into)
    }
    fn memo(&self, world: usize) -> Memo {
        self.now.memo(world)
    }
    fn set_memos(&mut self, memos: &[Memo]) {
        self.anew();
        self.now.set_memos(memos);
    }
    fn last_of(&self, world: usize) -> Option<Solve> {
        self.now.last_of(world)
    }
    fn set_lasts(&mut self, lasts: &[Option<Solve>]) {
        self.now.set_lasts(lasts);
    }
    fn restart(&mut self, start: f64) {
        self.anew();
        self.now.restart(start);
    }
    fn unsolved(&mut self) {
        self.now.unsolved();
    }
    fn forget(&mut self, worlds: &[usize]) {
        self.now.forget(worlds);
    }
    fn take_warning(&mut self) -> Option<String> {
        let other = || self.other.as_mut().and_then(|other| other.take_warning());
        let said = self.now.take_warning().or_else(other)?;
        self.now.unwatch();
        self.other.iter_mut().for_each(|other| other.unwatch());
        Some(said)
    }
    fn slow(&self) -> Option<String> {
        self.now.slow()
    }
    fn balance(&mut self) -> Result<()> {
        self.now.balance()
    }
    fn unwatch(&mut self) {
        self.now.unwatch();
        self.other.iter_mut().for_each(|other| other.unwatch());
    }
    fn in_lanes(&self) -> bool {
        self.in_lanes
    }
    fn turn_at_every_step(&mut self) {
        self.always = true;
    }
    fn bytes(&self) -> usize {
        self.now.bytes() + self.other.as_ref().map_or(0, |other| other.bytes())
    }
    fn model(&self, world: usize) -> &Arc<Model> {
        self.now.model(world)
    }
    fn by_model(&self) -> &[usize] {
        self.now.by_model()
    }
}
