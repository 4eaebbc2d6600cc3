//! Equalities: what ties bodies together.

use super::Softness;

/// Two bodies share one point: MuJoCo's `connect`.
#[derive(Clone, Debug, PartialEq)]
pub struct Equality {
    pub name: String,
    pub body1: usize,
    pub body2: usize,
    /// The point [m], in the frame of `body1`, at the initial configuration.
    pub anchor: [f64; 3],
    pub active: bool,
    pub soft: Softness,
}
