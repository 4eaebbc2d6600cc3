//! Observers of a `Sim`'s steps: the engine calls these hooks, independent of their implementation.

use crate::real::Real;
use crate::sim::{At, Sim};

/// The hooks of one step, in the order of its stages. By default each does nothing. The calls of a
/// step are few and dynamic, so that the step is compiled once for all observers. A Python `Sim` has
/// one: its steps pay for the states of `watch/past.rs`, and for the work of `watch/ledger/drive.rs`.
pub trait Observer<R: Real> {
    /// The smooth forces of `sim.placed`, at these positions and velocities, act for `share` of the step.
    fn placed(&mut self, _sim: &Sim<R>, _at: At, _share: f64) {}

    /// The rows of `sim.rows`, and under law `penalty` the contacts of `sim.detected`, act with
    /// their solution for `share` of the step.
    fn solved(&mut self, _sim: &Sim<R>, _at: At, _share: f64) {}

    /// Returns whether it reads more than the states of steps: the output of stages.
    fn looks_inside(&self) -> bool {
        true
    }

    /// `sim.next` is finite and is about to become the state.
    fn committing(&mut self, _sim: &Sim<R>) {}
}

/// No observer.
impl<R: Real> Observer<R> for () {
    fn looks_inside(&self) -> bool {
        false
    }
}

/// Two observers.
impl<R: Real, A: Observer<R>, B: Observer<R>> Observer<R> for (&mut A, &mut B) {
    #[inline]
    fn placed(&mut self, sim: &Sim<R>, at: At, share: f64) {
        self.0.placed(sim, at, share);
        self.1.placed(sim, at, share);
    }
    #[inline]
    fn solved(&mut self, sim: &Sim<R>, at: At, share: f64) {
        self.0.solved(sim, at, share);
        self.1.solved(sim, at, share);
    }
    #[inline]
    fn looks_inside(&self) -> bool {
        self.0.looks_inside() || self.1.looks_inside()
    }
    #[inline]
    fn committing(&mut self, sim: &Sim<R>) {
        self.0.committing(sim);
        self.1.committing(sim);
    }
}
