//! Elements with a length: the transmissions of actuators, tendons, linkages; and equalities, which
//! tie lengths, points and frames.

use super::parts::Span;
use crate::elements::{Element, Kind};
use crate::real::{value::none, Constant};
use crate::scene::{Coefficients, Softness, Target};
use nalgebra::Vector3;
use std::ops::Range;

/// The length that is transmitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Transmission {
    /// The position of a hinge or a slide; the angle of rotation of a ball, never negative.
    Joint(usize),
    /// A joint behind a gear, with one entry for each dof, from this place of `Model::gears` on. A
    /// ball's length is the part of its rotation vector along the gear; a free joint has none.
    Geared(usize, usize),
    /// A ball or a free joint whose axes of rotation are the axes of its parent frame.
    InParent(usize, usize),
    /// A tendon, and the place of a gear by which its length is multiplied; None: 1.
    Tendon(usize, Option<usize>),
    /// A linkage, whose arms hold its gear.
    Linkage(usize),
    /// One dof, of which only the rate is used.
    Dof(usize),
}

/// A length with a range.
#[derive(Clone, Debug)]
pub(crate) struct Limited<N = f64> {
    pub along: Transmission,
    pub kind: Kind,
    pub index: usize,
    pub range: [N; 2],
    /// 0: there is a lower bound, 1: an upper one.
    pub sides: Range<usize>,
    pub margin: N,
    pub soft: Softness<N>,
    /// Into `Model::dof_lists`.
    pub dofs: Span,
    pub invweight: N,
    pub mass: N,
}

/// A length with dry friction.
#[derive(Clone, Debug)]
pub(crate) struct Rubbing<N = f64> {
    pub along: Transmission,
    pub element: Element,
    /// The largest force.
    pub most: N,
    pub soft: Softness<N>,
    /// Into `Model::dof_lists`.
    pub dofs: Span,
    pub invweight: N,
    pub mass: N,
}

/// A point of a body, in its frame [m].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    pub body: usize,
    pub pos: Vector3<f64>,
}

/// The geom around which a stretch of a tendon goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Round {
    pub geom: usize,
    /// A sphere, else a cylinder without ends.
    pub sphere: bool,
    pub radius: f64,
    pub side: Option<Point>,
}

/// The dofs of a tree that move the ends of a stretch and its geom relative to each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Movers {
    pub tree: usize,
    /// Whether they move the first end, the geom, the second end.
    pub moves: [bool; 3],
    /// Each dof, and its place among the tendon's.
    pub dofs: Vec<(usize, usize)>,
}

/// The path between two sites that follow each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Stretch {
    pub ends: [Point; 2],
    pub round: Option<Round>,
    /// One over the divisor of its branch.
    pub share: f64,
    pub movers: Vec<Movers>,
}

/// The definition of its length.
#[derive(Clone, Debug, PartialEq)]
pub enum Course {
    /// (joint, coefficient)
    Fixed(Vec<(usize, f64)>),
    Spatial(Vec<Stretch>),
}

/// A tendon, compiled.
#[derive(Clone, Debug)]
pub struct Tendon<N = f64> {
    pub name: String,
    pub course: Course,
    /// Into `Model::dof_lists`: the dofs that can change its length, ascending.
    pub dofs: Span,
    /// Every dof that moves a body it passes, with all ancestors and those that the metric of
    /// `discrete` couples to these: the dofs of its rows.
    pub closed: Span,
    /// Into `Placed::tendon_arms`: one entry for each of `dofs`.
    pub arms: Span,
    /// Whether something reads its length in a step.
    pub used: bool,
    pub range: Option<[N; 2]>,
    pub margin: N,
    /// As computed, if the scene leaves it to be computed.
    pub springlength: [N; 2],
    /// Zero if MJCF's flags switch springs and dampers off.
    pub stiffness: Coefficients<N>,
    pub damping: Coefficients<N>,
    pub armature: N,
    pub frictionloss: N,
    pub actuatorfrcrange: Option<[N; 2]>,
    pub limit: Softness<N>,
    pub friction: Softness<N>,
    /// Length and arms J at qpos0, and J M⁻¹ Jᵀ there: MuJoCo's `tendon_length0` and
    /// `tendon_invweight0`.
    pub length0: N,
    pub arms0: Vec<N>,
    pub invweight: N,
    /// Mass of the trees that it touches, for residuals.
    pub mass: N,
}

impl<N: Constant> Tendon<N> {
    /// Whether its poses are needed: it runs over points of bodies.
    pub fn spatial(&self) -> bool {
        matches!(self.course, Course::Spatial(_))
    }

    /// Whether it has a spring or a damper.
    pub fn pulls(&self) -> bool {
        !(none(&self.stiffness) && none(&self.damping))
    }

    /// Whether it has a force, an inertia or a row.
    pub(super) fn acts(&self) -> bool {
        self.pulls()
            || !(self.armature.vanishes() && self.frictionloss.vanishes())
            || self.range.is_some()
    }
}

/// The length of an actuator that is neither a joint's nor a tendon's.
#[derive(Clone, Debug, PartialEq)]
pub struct Linkage {
    pub course: Target,
    pub gear: [f64; 6],
    /// Its place in `Placed::tendon_length`, after the tendons.
    pub length: usize,
    /// As the dofs of a tendon.
    pub dofs: Span,
    pub arms: Span,
    pub movers: Vec<Moved>,
}

/// A dof that moves one of the ends of a linkage, but not both equally.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moved {
    pub dof: usize,
    /// Its place among the linkage's dofs.
    pub at: usize,
    pub ends: [bool; 2],
}

/// An equality, with the data that its rows share.
#[derive(Clone, Debug)]
pub struct Equality<N = f64> {
    pub name: String,
    pub tie: Tie<N>,
    pub active: bool,
    pub soft: Softness<N>,
    /// As the dofs of a `Pair`. Empty: nothing that it ties can move, and it has no rows.
    pub dofs: Span,
    pub mass: N,
}

/// The constraint of an equality.
#[derive(Clone, Debug)]
pub enum Tie<N = f64> {
    /// Two points coincide.
    Connect(Ends<N>),
    /// Two frames coincide; their rotation is multiplied by `torquescale`.
    Weld { ends: Ends<N>, torquescale: f64 },
    /// A length follows another.
    Lengths(Coupling<N>),
}

/// A frame on each of two bodies.
#[derive(Clone, Debug)]
pub struct Ends<N = f64> {
    pub bodies: [usize; 2],
    /// In the frames of the bodies [m].
    pub pos: [Vector3<N>; 2],
    /// w x y z.
    pub quat: [[f64; 4]; 2],
    /// Sums of both bodies' invweight: translation and rotation.
    pub invweight: [N; 2],
}

/// L₁ − L₁⁰ is a polynomial of L₂ − L₂⁰, the lengths of joints or of tendons.
#[derive(Clone, Debug)]
pub struct Coupling<N = f64> {
    pub first: Transmission,
    pub second: Option<Transmission>,
    /// The lengths at the initial configuration.
    pub rest: [N; 2],
    pub polycoef: [N; 5],
    /// Sum of both invweights.
    pub invweight: N,
}

impl<N: Constant> Equality<N> {
    /// How many rows it has.
    pub fn rows(&self) -> usize {
        match self.tie {
            Tie::Connect(_) => 3,
            Tie::Weld { .. } => 6,
            Tie::Lengths(_) => 1,
        }
    }

    /// The kind of its rows.
    pub fn kind(&self) -> Kind {
        match self.tie {
            Tie::Connect(_) => Kind::Connect,
            Tie::Weld { .. } => Kind::Weld,
            Tie::Lengths(Coupling { first: Transmission::Tendon(..), .. }) => Kind::TendonEquality,
            Tie::Lengths(_) => Kind::JointEquality,
        }
    }

    /// The bodies whose poses it reads.
    pub(super) fn placed(&self) -> Vec<usize> {
        match &self.tie {
            Tie::Connect(ends) | Tie::Weld { ends, .. } => ends.bodies.to_vec(),
            Tie::Lengths(_) => vec![],
        }
    }
}
