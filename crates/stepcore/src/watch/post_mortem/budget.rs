//! The cost limit for examining a failure: an amount of work, counted and not timed, so that the
//! result is the same on every machine.

use std::cell::Cell;

use crate::real::Real;
use crate::sim::{Effort, Sim};

/// Work in units of about a nanosecond.
pub(super) struct Budget {
    left: Cell<u64>,
}

/// The cost limit for explaining one failure, and for examining one suspicion.
const WHOLE: u64 = 80_000_000;
/// The search of a distance, with the contacts that are made of it.
const SEPARATION: u64 = 3_000;
/// The cost limit for finding the element that caused a failure: the same in a `Sim` and in a batch
/// of any size, so that they name the same one.
const CAUSE: u64 = 20_000_000;
/// The least cost limit for explaining the rest of a batch's failure.
const LEAST: u64 = 500_000;

impl Budget {
    pub fn whole() -> Self {
        Self { left: Cell::new(WHOLE) }
    }

    pub fn of_cause() -> Self {
        Self { left: Cell::new(CAUSE) }
    }

    /// The share of one of this many worlds, which may all fail.
    pub fn shared(worlds: usize) -> Self {
        let share = WHOLE / worlds.max(1) as u64;
        Self { left: Cell::new(share.max(LEAST)) }
    }

    pub fn left(&self) -> u64 {
        self.left.get()
    }

    /// Takes this much; returns false, and takes nothing, if it is not left.
    pub fn take(&self, work: u64) -> bool {
        let left = self.left.get().checked_sub(work);
        self.left.set(left.unwrap_or(self.left.get()));
        left.is_some()
    }

    /// Takes `count` products of two n × n matrices.
    pub fn product(&self, n: usize, count: u32) -> bool {
        let n = n as u64;
        self.take(u64::from(count) * (n * n * n / 2 + 4 * n * n + 200))
    }

    /// The number of affordable pieces of work, at most `most`.
    pub fn count(&self, work: u64, most: usize) -> usize {
        usize::try_from(self.left.get() / work.max(1)).map_or(most, |count| count.min(most))
    }
}

impl<R: Real> Sim<R> {
    /// Work of one evaluation of place, detect and solve, without the solver's updates.
    fn evaluation(&self) -> u64 {
        let model = &self.model;
        let sizes = 50 * model.nv + 4 * model.row_dofs.len() + 50 * model.bodies.len();
        let rows = 60 * self.rows.rows.len() + 6 * self.rows.y.len();
        (100 + sizes + 8 * (model.pairs.len() + self.detected.contacts.len()) + rows) as u64
    }

    /// Work of the steps since `before`.
    pub(super) fn work_since(&self, before: &Effort) -> u64 {
        let evaluations = self.effort.evaluations - before.evaluations;
        // In lanes, all of which are this world.
        let updates = (self.effort.row_updates - before.row_updates) / R::LANES as u64;
        // A row touches the dofs of its chain.
        let chain = self.rows.y.len() / self.rows.rows.len().max(1);
        let separations = (self.effort.separations - before.separations) / R::LANES as u64;
        evaluations * self.evaluation()
            + updates * (8 + 4 * chain as u64)
            + separations * SEPARATION
    }

    /// The least work of a step.
    pub(super) fn least_step(&self) -> u64 {
        self.evaluation()
    }

    /// Work of recording a step: its energies before and after, and every element's impulse.
    pub(super) fn tape(&self) -> u64 {
        let elements =
            self.model.joints.len() + self.model.actuators.len() + self.rows.blocks.len();
        2000 + 4 * self.evaluation() + (elements * (200 + 10 * self.model.nv)) as u64
    }
}
