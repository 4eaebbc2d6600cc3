//! The parts of a compiled model: bodies, joints and geoms, and the pairs that can meet. Elements
//! with a length are in `lengths.rs`.

use crate::real::{Constant, Real, Value};
use crate::scene::{Coefficients, GeomType, JointType, SleepPolicy, Softness};
use crate::shapes::height_field::HeightField;
use crate::shapes::hull::Hull;
use crate::shapes::ray::Surface;
use crate::shapes::{Shape, ShapeTest};
use crate::spatial::{Pose, Quat};
use nalgebra::{Matrix3, Vector3};
use std::collections::HashMap;
use std::sync::Arc;

/// Index of something absent: the parent of a root dof, the tree of a fixed body.
pub const NONE: usize = usize::MAX;

/// A slice of one of the model's lists.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    pub start: usize,
    pub len: usize,
}

impl Span {
    #[inline(always)]
    pub fn range(self) -> std::ops::Range<usize> {
        self.start..self.start + self.len
    }
    #[inline(always)]
    pub fn of<T>(self, list: &[T]) -> &[T] {
        &list[self.range()]
    }
}

/// A body with its place in the tree and its compiled mass.
#[derive(Clone, Debug)]
pub struct Body<N = f64> {
    pub name: String,
    pub parent: usize,
    /// The nearest ancestor-or-self with a joint or a mocap pose; 0 (the world) for a fixed body.
    pub weld: usize,
    /// `NONE` for a fixed body.
    pub tree: usize,
    pub pos: Vector3<N>,
    /// w x y z.
    pub quat: [f64; 4],
    pub joints: Span,
    /// The dofs of this body.
    pub dofs: Span,
    /// Into `Model::dof_lists`: every dof that moves this body, ascending.
    pub chain: Span,
    /// The same, with the dofs that the metric of `discrete` couples to these: `model/coupling.rs`.
    pub closed: Span,
    /// [kg]
    pub mass: N,
    /// Centre of mass in body axes [m].
    pub ipos: Vector3<N>,
    /// Orientation of its principal axes in body axes, w x y z; only sensors read it.
    pub iquat: [N; 4],
    /// About the centre of mass, in body axes [kg·m²].
    pub inertia: Matrix3<N>,
    /// Mean inverse mass and inverse inertia at qpos0: MuJoCo's `body_invweight0`.
    pub invweight: [N; 2],
    /// The share of its weight that gravity compensation carries.
    pub gravcomp: f64,
    /// Its place among `Model::mocaps`.
    pub mocap: Option<usize>,
    /// Whether it is a mocap body, or hangs on one.
    pub carried: bool,
    /// Whether some dof rotates this body, or it is carried; else its orientation is constant.
    pub turns: bool,
}

/// A joint with its places in qpos and qvel.
#[derive(Clone, Debug)]
pub struct Joint<N = f64> {
    pub name: String,
    pub kind: JointType,
    pub body: usize,
    /// Its first entry of qpos, and its first dof.
    pub qpos: usize,
    pub dof: usize,
    pub pos: Vector3<N>,
    /// Unit length.
    pub axis: Vector3<f64>,
    pub range: Option<[N; 2]>,
    pub margin: f64,
    pub reference: f64,
    /// Zero if MJCF's flags switch springs and dampers off.
    pub stiffness: Coefficients<N>,
    pub damping: Coefficients<N>,
    pub actuatorfrcrange: Option<[N; 2]>,
    pub limit: Softness<N>,
    /// Whether its gravity compensation counts as the force of its actuators.
    pub actuatorgravcomp: bool,
}

impl<N> Joint<N> {
    /// Number of dofs.
    pub fn dofs(&self) -> usize {
        self.kind.dofs()
    }
}

/// One entry of qvel.
#[derive(Clone, Debug)]
pub struct Dof<N = f64> {
    pub joint: usize,
    pub body: usize,
    pub tree: usize,
    /// The dof before this one on the chain to the root, or `NONE`.
    pub parent: usize,
    /// Into `Model::dof_lists`: this dof and its ancestors, ascending, and the dofs that the metric
    /// of `discrete` couples to these.
    pub closed: Span,
    /// Row of the mass matrix, in `Model::row_dofs` and every array laid out like
    /// it: this dof, then its ancestors, nearest first.
    pub row: Span,
    pub armature: N,
    pub frictionloss: N,
    pub friction: Softness<N>,
    /// MuJoCo's `dof_invweight0`.
    pub invweight: N,
}

/// A body that moves against the world, and all bodies that hang on it.
#[derive(Clone, Debug)]
pub struct Tree<N = f64> {
    pub bodies: Span,
    pub dofs: Span,
    pub mass: N,
    /// Only slide joints.
    pub slides_only: bool,
    /// Whether the mass matrix, its factors and the bias force never change: the tree only slides,
    /// or it is a free ball about its centre that nothing ties.
    pub constant: bool,
    /// Whether a step needs its poses: something turns, collides or is tied.
    pub seen: bool,
    /// Its plane, if it moves in one and nothing needs more of it than that.
    pub plane: Option<Plane<N>>,
    pub sleep: SleepPolicy,
}

/// A shape on a body.
#[derive(Clone, Debug)]
pub struct Geom<N = f64> {
    pub name: String,
    pub body: usize,
    pub kind: GeomType,
    pub size: [N; 3],
    pub pos: Vector3<N>,
    pub quat: [f64; 4],
    /// Its z in the body's frame: the axis of a capsule.
    pub axis: Vector3<f64>,
    /// Radius of the sphere about `pos` that holds the shape; infinite for a plane.
    pub reach: N,
    /// Half sizes of the box about its frame that holds it [m]; infinite for a plane.
    pub half: [N; 3],
    /// As in the scene.
    pub contype: u32,
    pub conaffinity: u32,
    /// The hull of a mesh that can collide, in the geom's frame.
    pub hull: Option<Arc<Hull>>,
    /// The surface of a height field.
    pub field: Option<Arc<HeightField>>,
    /// The triangles of a mesh, for rays.
    pub surface: Option<Arc<Surface>>,
    pub group: i32,
    /// Whether rays pass through it.
    pub hidden: bool,
    /// Whether it takes part in some pair, so that its pose is needed.
    pub collides: bool,
    /// A capsule whose contacts need only its axis, not its full orientation.
    pub by_axis: bool,
    /// The velocity and angular velocity of its moving surface, in its frame.
    pub belt: Option<[Vector3<f64>; 2]>,
    /// The pose in two dimensions, for a geom on a tree that moves in a plane.
    pub in_plane: Option<Box<FlatGeom<N>>>,
}

impl<N> Geom<N> {
    /// The geom's shape at a pose.
    #[inline(always)]
    pub fn shape<'a, R: Real<Value = N>>(&'a self, pose: &'a Pose<R>) -> Shape<'a, R> {
        Shape { pose, size: &self.size, hull: self.hull.as_deref(), field: self.field.as_deref() }
    }
}

/// A named frame on a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    pub name: String,
    pub body: usize,
    pub pos: Vector3<f64>,
    pub quat: [f64; 4],
    /// The volume that sensors use.
    pub kind: GeomType,
    pub size: [f64; 3],
}

/// Two geoms that can meet, with everything their contacts share.
/// Ordered as MuJoCo orders them: by geom type first, so `geom1`'s type ≤ `geom2`'s.
#[derive(Clone, Copy, Debug)]
pub struct Pair<N = f64> {
    pub geom1: usize,
    pub geom2: usize,
    pub test: ShapeTest,
    /// Into `Model::materials`.
    pub material: usize,
    /// Its place in `Model::pairs`; in a pile its number.
    pub index: usize,
    /// The first of its slots among the contacts' slots: as many as its test has touches.
    pub slot: usize,
    /// Sum of both bodies' translational invweight.
    pub invweight: N,
    /// Into `Model::dof_lists`: union of both chains, ascending. In a pile: see `DynamicPairs`.
    pub dofs: Span,
    /// Mass of the trees that the contact touches, for residuals.
    pub mass: N,
    /// Tangents along which nothing can ever move (see `model/fixed_tangents.rs`).
    pub still: [bool; 2],
    /// The ranges of joints keep the two apart: the pair is tested only while a joint is outside
    /// its `Model::guards` (see `model/range_separation.rs`).
    pub apart: bool,
}

impl<N: Constant> Pair<N> {
    /// The pair of one lane.
    pub fn lane(&self, lane: usize) -> Pair {
        self.with(|x| x.lane(lane))
    }

    /// The pair in a step's number type.
    #[inline(always)]
    pub fn get<R: Real>(&self) -> Pair<R>
    where
        N: Value<R>,
    {
        self.with(Value::get)
    }

    #[inline(always)]
    fn with<M>(&self, of: impl Fn(&N) -> M) -> Pair<M> {
        let Self { geom1, geom2, test, material, index, slot, dofs, still, apart, .. } = *self;
        let (invweight, mass) = (of(&self.invweight), of(&self.mass));
        Pair { geom1, geom2, test, material, index, slot, invweight, dofs, mass, still, apart }
    }
}

/// The joint positions for which pairs are proved apart: the joint's range, widened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guard {
    pub joint: usize,
    /// Into qpos.
    pub at: usize,
    pub low: f64,
    pub high: f64,
}

/// Two spheres about the centres of two geoms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spheres {
    pub geoms: [u32; 2],
    /// Square of the distance above which their pairs list nothing [m²]; infinite with a plane.
    pub square: f64,
    /// The ranges of joints keep all their pairs apart: see `Pair::apart`.
    pub apart: bool,
}

/// Consecutive pairs of the same two bodies, or the part of them that shares its first geom, with
/// one sphere on each body that contains that body's geoms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyPair {
    pub spheres: Spheres,
    /// Into `Model::pairs`; empty if the pairs are in the body_pairs that follow.
    pub pairs: Span,
    /// The place of the next entry that is not part of this one.
    pub next: usize,
}

/// The plane in which a tree moves, and the numbers that a step needs of the tree, all at qpos0;
/// they turn with the body from there on.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane<N = f64> {
    /// The index of the world axis that is its normal.
    pub normal: usize,
    /// One entry for each body of the tree.
    pub bodies: Vec<FlatBody<N>>,
    /// One entry for each joint of the tree.
    pub joints: Vec<FlatJoint<N>>,
    pub(super) first_joint: usize,
}

/// Vectors of two entries are along the plane's axes.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatBody<N = f64> {
    /// Moment of inertia about the normal through the centre of mass [kg·m²].
    pub moment: N,
    /// Orientation.
    pub rot: Matrix3<f64>,
    pub quat: Quat<f64>,
    /// From the parent's origin, as the parent turns [m].
    pub pos: [N; 2],
    /// From the body's origin to its centre of mass [m].
    pub centre: [N; 2],
}

/// The pose of a geom on a body of such a tree, from the body's origin.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatGeom<N = f64> {
    /// The plane's axes.
    pub axes: [usize; 2],
    pub pos: [N; 2],
    pub rot: Matrix3<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct FlatJoint<N = f64> {
    /// ±1 along the normal for a hinge; 0 for a slide.
    pub turns: f64,
    /// The anchor of a hinge, from the body's origin [m].
    pub anchor: [N; 2],
    /// The axis of a slide.
    pub axis: [f64; 2],
}

impl<N> Plane<N> {
    /// The world's axes in the plane; with the normal before them they are right-handed.
    #[inline(always)]
    pub fn axes(&self) -> [usize; 2] {
        across(self.normal)
    }

    /// The joints of a body of this tree.
    #[inline(always)]
    pub fn joints_of(&self, body: &Body<N>) -> &[FlatJoint<N>] {
        let first = body.joints.start - self.first_joint;
        &self.joints[first..first + body.joints.len]
    }
}

#[inline(always)]
pub(super) fn across(normal: usize) -> [usize; 2] {
    [(normal + 1) % 3, (normal + 2) % 3]
}

/// Kinds of geoms.
pub(super) const KINDS: usize = 8;

/// The data that all possible pairs share.
#[derive(Clone, Debug, PartialEq)]
pub struct DynamicPairs {
    /// Geoms that may meet another one: ascending, first the movable ones, then the fixed ones.
    pub solid: Vec<usize>,
    /// How many of them can move.
    pub moving: usize,
    /// For each geom: its part of the distance below which contacts are listed [m].
    pub listed: Vec<f64>,
    /// For each geom: its class; and by two classes their material.
    pub(super) class: Vec<u32>,
    pub(super) classes: usize,
    pub(super) mixed: Vec<u32>,
    /// The tests for two kinds of geoms.
    pub(super) tests: [[Option<ShapeTest>; KINDS]; KINDS],
    /// For each body: its first geom. The most geoms of any body.
    pub(super) first: Vec<usize>,
    pub(super) most: usize,
    /// Pairs with tangents along which nothing can move.
    pub(super) still: HashMap<(usize, usize), [bool; 2]>,
    /// Materials of explicit pairs, by their geoms, the smaller index first.
    pub(super) explicit: HashMap<(usize, usize), usize>,
}

/// Bounds of a joint or a tendon.
pub const SIDES: usize = 2;

/// The first slot of each kind: equalities, then the friction losses of dofs and of tendons, the
/// limits of joints and of tendons, the contacts of pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Slots {
    pub(super) losses: usize,
    pub(super) tendon_losses: usize,
    pub(super) limits: usize,
    pub(super) tendon_limits: usize,
    pub(super) contacts: usize,
}
