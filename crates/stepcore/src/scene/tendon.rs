//! Tendons: lengths that run over joints, or over points of bodies.

use super::{Coefficients, Softness, NONE};

/// A stop on the path of a tendon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stop {
    /// For a fixed tendon: its length has coef × position of a hinge or a slide.
    Joint { joint: usize, coef: f64 },
    /// For a spatial tendon: a point that it passes through.
    Site { site: usize },
    /// A sphere or a cylinder that it goes round if it is in the way; `side`: the site past which
    /// it goes, or, if that is inside, through the geom.
    Geom { geom: usize, side: Option<usize> },
    /// Starts a branch, whose length is divided.
    Pulley { divisor: f64 },
}

/// A length with the elements that hold and pull it. Over joints alone (fixed): a sum of their
/// positions; else (spatial) the shortest path through its stops [m].
#[derive(Clone, Debug, PartialEq)]
pub struct Tendon {
    pub name: String,
    pub path: Vec<Stop>,
    /// Lower and upper bound of the length. None: no limit.
    pub range: Option<[f64; 2]>,
    /// A limit is a row from this distance on.
    pub margin: f64,
    /// Between these lengths its spring is slack; both −1: the length at the rest positions of the
    /// joints' springs.
    pub springlength: [f64; 2],
    pub stiffness: Coefficients,
    pub damping: Coefficients,
    /// Inertia of a change of its length [kg].
    pub armature: f64,
    /// Dry friction: the largest force [N].
    pub frictionloss: f64,
    /// Bounds of the sum of its actuators' forces [N]. None: none.
    pub actuatorfrcrange: Option<[f64; 2]>,
    /// Softness of the limit's rows, and of the friction loss.
    pub limit: Softness,
    pub friction: Softness,
}

/// MuJoCo's value for a rest length that is computed.
pub const AUTOMATIC: [f64; 2] = [-1.0, -1.0];

impl Default for Tendon {
    fn default() -> Self {
        Self {
            name: String::new(),
            path: vec![],
            range: None,
            margin: 0.0,
            springlength: AUTOMATIC,
            stiffness: NONE,
            damping: NONE,
            armature: 0.0,
            frictionloss: 0.0,
            actuatorfrcrange: None,
            limit: Softness::default(),
            friction: Softness::default(),
        }
    }
}
