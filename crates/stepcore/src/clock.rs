//! The time step, in every form in which the stages need it.

use crate::real::Real;

/// Made once from the settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock<R: Real> {
    /// Time step [s], as it was set.
    pub seconds: f64,
    /// The time between two samples of a control [s]: a step, unless it is made of shorter ones.
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
