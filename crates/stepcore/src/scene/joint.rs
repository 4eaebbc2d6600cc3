//! Joints.

use super::Softness;

/// The motion that a joint allows its body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointType {
    Free,
    Ball,
    Slide,
    Hinge,
}

impl JointType {
    /// Entries of qpos.
    pub fn positions(self) -> usize {
        match self {
            Self::Free => 7,
            Self::Ball => 4,
            Self::Slide | Self::Hinge => 1,
        }
    }
    /// Entries of qvel.
    pub fn dofs(self) -> usize {
        match self {
            Self::Free => 6,
            Self::Ball => 3,
            Self::Slide | Self::Hinge => 1,
        }
    }
    /// Whether it changes the orientation of its body.
    pub fn turns(self) -> bool {
        self != Self::Slide
    }
}

/// Coefficients a, b, c of a polynomial force by the powers of its variable, the first power first:
/// MuJoCo's, see `elements/spring.rs` and `elements/damper.rs`.
pub type Coefficients<N = f64> = [N; 3];

/// No force.
pub const NONE: Coefficients = [0.0; 3];

/// Dofs between a body and its parent. Lengths in m, angles in rad; forces in N or N·m by
/// the kind of joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    pub name: String,
    pub body: usize,
    pub kind: JointType,
    /// Anchor and axis in the body's frame.
    pub pos: [f64; 3],
    pub axis: [f64; 3],
    /// Lower and upper bound; a ball joint uses the upper one. None: no limit.
    pub range: Option<[f64; 2]>,
    /// A limit is a row from this distance on.
    pub margin: f64,
    /// qpos at the initial configuration, and at the rest position of the spring.
    pub reference: f64,
    pub springref: f64,
    pub stiffness: Coefficients,
    pub damping: Coefficients,
    /// Time constant [s] and damping ratio that replace both if both are > 0.
    pub springdamper: [f64; 2],
    /// Whether its share of gravity compensation counts as its actuators' force.
    pub actuatorgravcomp: bool,
    /// Inertia added to the dof itself [kg or kg·m²].
    pub armature: f64,
    /// Bounds of the total force of all actuators on a hinge or a slide. None: none.
    pub actuatorfrcrange: Option<[f64; 2]>,
    /// Dry friction: the largest force.
    pub frictionloss: f64,
    /// Softness of the limit's rows, and of the friction loss.
    pub limit: Softness,
    pub friction: Softness,
}

impl Default for Joint {
    fn default() -> Self {
        Self {
            name: String::new(),
            body: 0,
            kind: JointType::Hinge,
            pos: [0.0; 3],
            axis: [0.0, 0.0, 1.0],
            range: None,
            margin: 0.0,
            reference: 0.0,
            springref: 0.0,
            stiffness: NONE,
            damping: NONE,
            springdamper: [0.0; 2],
            actuatorgravcomp: false,
            armature: 0.0,
            actuatorfrcrange: None,
            frictionloss: 0.0,
            limit: Softness::default(),
            friction: Softness::default(),
        }
    }
}
