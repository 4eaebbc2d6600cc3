//! The forces in a model: one list for each kind, with each element as constant numbers. The
//! formulas are in `elements/`, whose `forces.rs` fills these lists.

use crate::elements::Element;
use crate::scene::{Coefficients, JointType};

/// The reason why an element of a model's lists never acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// This quantity of it is zero.
    Zero(&'static str),
    /// This flag of the scene switches its kind off.
    Off(&'static str),
    /// Another entry reports it.
    Unsaid,
}

/// One element that acts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Acts<A> {
    /// Its place in the list that its kind belongs to.
    pub index: usize,
    pub at: A,
}

/// The damper of a joint: its dofs, and the polynomial.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DamperAt<N = f64> {
    pub first: usize,
    pub count: usize,
    pub law: Coefficients<N>,
}

/// The spring of a joint: its kind, its first places in qpos and qvel, and the polynomial.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpringAt<N = f64> {
    pub kind: JointType,
    pub qpos: usize,
    pub dof: usize,
    pub law: Coefficients<N>,
}

/// A spring or a damper of a tendon.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TendonAt<N = f64> {
    pub tendon: usize,
    pub law: Coefficients<N>,
}

/// A mass that is pulled at, or held [kg].
#[derive(Clone, Copy, Debug)]
pub(crate) struct MassAt<N = f64> {
    pub body: usize,
    pub mass: N,
}

/// The role of an actuator in an account of energy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Drive {
    Motor,
    Spring,
    Damped,
}

/// The parts of an actuator's formula that are present.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ActuatorAt<N = f64> {
    pub drive: Drive,
    /// Its force depends on its length or the length's rate; and its gain does.
    pub feeds_back: bool,
    pub gain_varies: bool,
    /// Whether it has a force besides gain·u.
    pub biased: bool,
    /// Whether a controller, or a servo of orientations, computes its force.
    pub elsewhere: bool,
    /// Bounds of its control, and of its force.
    pub ctrlrange: Option<[N; 2]>,
    pub bounds: Option<[N; 2]>,
}

/// The elements that act in a model, one list for each kind; and those that never do.
#[derive(Clone, Debug, Default)]
pub(crate) struct Acting<N = f64> {
    pub damper: Vec<Acts<DamperAt<N>>>,
    pub spring: Vec<Acts<SpringAt<N>>>,
    pub tendon_spring: Vec<Acts<TendonAt<N>>>,
    pub tendon_damper: Vec<Acts<TendonAt<N>>>,
    pub compensation: Vec<Acts<MassAt<N>>>,
    /// One entry for each body.
    pub fluid: Vec<Acts<usize>>,
    /// One entry for each actuator.
    pub actuator: Vec<Acts<usize>>,
    pub driven_compensation: Vec<Acts<MassAt<N>>>,
    /// The first dof of a joint, and their number.
    pub joint_force: Vec<Acts<(usize, usize)>>,
    /// One entry for each body.
    pub body_force: Vec<Acts<usize>>,
    pub gravity: Vec<Acts<MassAt<N>>>,
    pub held: Vec<Acts<MassAt<N>>>,
    pub left_out: Vec<(Element, Why)>,
    /// Whether a passive force acts; and whether a driven one does.
    pub passive: bool,
    pub driven: bool,
}
