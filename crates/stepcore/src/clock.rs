//! The time step, in every form that the stages need.

use crate::real::Real;

/// The time step; computed once from the settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock<R: Real> {
    /// Time step [s], as set by the user.
    pub seconds: f64,
    /// The time between two samples of a control [s]: one step, or the whole of an adaptive step.
    pub period: f64,
    /// The same in the engine's number type [s], and its inverse [1/s].
    pub dt: R,
    pub rate: R,
}

impl<R: Real> Clock<R> {
    pub fn new(seconds: f64) -> Self {
        Self { seconds, period: seconds, dt: R::of(seconds), rate: R::of(1.0 / seconds) }
    }
}
