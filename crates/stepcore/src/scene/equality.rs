//! Equalities: what ties bodies, joints or tendons together.

use super::Softness;

/// What an equality holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EqualityType {
    /// Two bodies share one point.
    Connect,
    /// Two bodies share one frame.
    Weld,
    /// A joint follows a polynomial of another, or is held where it is.
    Joint,
    /// A tendon's length does.
    Tendon,
}

/// A place on a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// In the body's frame [m].
    pub pos: [f64; 3],
    /// w x y z, of any length.
    pub quat: [f64; 4],
}

/// An equality. MuJoCo documentation, "Equality constraints".
#[derive(Clone, Debug, PartialEq)]
pub struct Equality {
    pub name: String,
    pub kind: EqualityType,
    /// What it ties: bodies (of `Connect` and `Weld`), joints or tendons, by index.
    pub first: usize,
    /// None: one joint or tendon alone.
    pub second: Option<usize>,
    /// What becomes one on the two bodies. None: what the other is on at the initial
    /// configuration; one of the two is given.
    pub frame1: Option<Frame>,
    pub frame2: Option<Frame>,
    /// Of a weld: by what its turns are multiplied, MuJoCo's `torquescale`.
    pub torquescale: f64,
    /// Of joints and tendons: q₁ − q₁⁰ is this polynomial of q₂ − q₂⁰ (a constant without a second).
    pub polycoef: [f64; 5],
    pub active: bool,
    pub soft: Softness,
}
