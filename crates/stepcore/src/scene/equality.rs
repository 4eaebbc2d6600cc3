//! Equalities: ties between bodies, joints or tendons.

use super::Softness;

/// The kind of a tie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EqualityType {
    /// Two bodies share one point.
    Connect,
    /// Two bodies share one frame.
    Weld,
    /// A joint follows a polynomial of another, or is fixed.
    Joint,
    /// A tendon's length follows one, or is fixed.
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
    /// The tied elements: bodies (of `Connect` and `Weld`), joints or tendons, by index.
    pub first: usize,
    /// None: one joint or tendon alone.
    pub second: Option<usize>,
    /// The frames on the two bodies that coincide. None: the other one's place at the initial
    /// configuration; one of the two is given.
    pub frame1: Option<Frame>,
    pub frame2: Option<Frame>,
    /// The factor of a weld's rotations, MuJoCo's `torquescale`.
    pub torquescale: f64,
    /// For joints, tendons: q₁ − q₁⁰ is this polynomial of q₂ − q₂⁰ (a constant without a second).
    pub polycoef: [f64; 5],
    pub active: bool,
    pub soft: Softness,
}
