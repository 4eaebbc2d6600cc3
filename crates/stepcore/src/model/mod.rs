//! `Model`: a scene once compiled, constant during a step.
//!
//! Numbers are `f64` in SI units; a stage turns them into its own number with `Real::of`.
//! Fields that a `Scene` has too mean here what they mean there.

mod at_qpos0;
mod auto_spring;
mod body_pairs;
mod build;
mod check;
mod coupling;
mod dynamic_pairs;
mod equalities;
mod fixed_tangents;
pub(crate) mod fluid;
mod inertia;
mod invweight;
mod linkages;
mod lru;
mod material;
pub(crate) mod memory;
mod mesh_cache;
mod meshes;
mod pair_counts;
mod pairs;
mod places;
mod plane;
mod pose;
mod principal;
mod proofs;
mod range_separation;
mod shape;
mod slots;
mod solid;
mod tendons;
#[cfg(test)]
mod tests;
pub mod transmission;
mod tree;
mod union;

pub use body_pairs::{BodyPair, Spheres};
pub use dynamic_pairs::DynamicPairs;
pub(crate) use dynamic_pairs::MANY as MANY_TREES;
pub use equalities::{Coupling, Ends, Equality, Tie};
pub use linkages::{Linkage, Moved};
pub use material::Material;
pub use pair_counts::Tally;
pub use pairs::Never;
pub use plane::{FlatGeom, Plane};
pub(crate) use pose::rotation;
pub use tendons::{Course, Mover, Point, Round, Stretch, Tendon};
use transmission::{Limited, Rubbing, Transmission};
pub(crate) use union::Union;

use crate::plan::acting::{Acting, ActuatorAt};
use crate::plan::makers::Maker;
use crate::plan::places::Places;
use crate::real::Real;
use crate::scene::{
    Actuator, Coefficients, Features, GeomType, JointType, Key, Sensor, SleepPolicy, Softness,
};
use crate::shapes::height_field::HeightField;
use crate::shapes::hull::Hull;
use crate::shapes::ray::Surface;
use crate::shapes::{Shape, ShapeTest};
use crate::spatial::Pose;
use nalgebra::{Matrix3, Vector3};
use std::collections::HashSet;
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

/// A body with its place in the tree, and its mass put together.
#[derive(Clone, Debug)]
pub struct Body {
    pub name: String,
    pub parent: usize,
    /// The nearest ancestor-or-self with a joint or a mocap pose; 0 (the world) for a fixed body.
    pub weld: usize,
    /// `NONE` for a fixed body.
    pub tree: usize,
    pub pos: Vector3<f64>,
    /// w x y z.
    pub quat: [f64; 4],
    pub joints: Span,
    /// This body's own dofs.
    pub dofs: Span,
    /// Into `Model::dof_lists`: every dof that moves this body, ascending.
    pub chain: Span,
    /// The same, with the dofs that the metric of `discrete` couples to these: `model/coupling.rs`.
    pub closed: Span,
    /// [kg]
    pub mass: f64,
    /// Centre of mass in body axes [m].
    pub ipos: Vector3<f64>,
    /// Orientation of its principal axes in body axes, w x y z; only sensors read it.
    pub iquat: [f64; 4],
    /// About the centre of mass, in body axes [kg·m²].
    pub inertia: Matrix3<f64>,
    /// Mean inverse mass and inverse inertia at qpos0: MuJoCo's `body_invweight0`.
    pub invweight: [f64; 2],
    /// The share of its weight that holds it up.
    pub gravcomp: f64,
    /// Its place among `Model::mocaps`.
    pub mocap: Option<usize>,
    /// It is a mocap body, or hangs on one.
    pub carried: bool,
    /// Some dof rotates this body, or it is carried; else its orientation is constant.
    pub turns: bool,
}

/// A joint with its places in qpos and qvel.
#[derive(Clone, Debug)]
pub struct Joint {
    pub name: String,
    pub kind: JointType,
    pub body: usize,
    /// Its first entry of qpos, and its first dof.
    pub qpos: usize,
    pub dof: usize,
    pub pos: Vector3<f64>,
    /// Unit length.
    pub axis: Vector3<f64>,
    pub range: Option<[f64; 2]>,
    pub margin: f64,
    pub reference: f64,
    /// Zero where MJCF's flags switch springs and dampers off.
    pub stiffness: Coefficients,
    pub damping: Coefficients,
    pub actuatorfrcrange: Option<[f64; 2]>,
    pub limit: Softness,
    /// Its share of what holds bodies up against gravity counts as its actuators' force.
    pub actuatorgravcomp: bool,
}

impl Joint {
    /// Number of dofs.
    pub fn dofs(&self) -> usize {
        self.kind.dofs()
    }
}

/// One entry of qvel.
#[derive(Clone, Debug)]
pub struct Dof {
    pub joint: usize,
    pub body: usize,
    pub tree: usize,
    /// The dof before this one on the chain to the root, or `NONE`.
    pub parent: usize,
    /// Into `Model::dof_lists`: it and its ancestors, ascending, and what the metric of `discrete`
    /// couples to these.
    pub closed: Span,
    /// Row of the mass matrix, in `Model::row_dofs` and every array laid out like
    /// it: this dof, then its ancestors, nearest first.
    pub row: Span,
    pub armature: f64,
    pub frictionloss: f64,
    pub friction: Softness,
    /// MuJoCo's `dof_invweight0`.
    pub invweight: f64,
}

/// A body that moves against the world, and all that hangs on it.
#[derive(Clone, Debug)]
pub struct Tree {
    pub bodies: Span,
    pub dofs: Span,
    pub mass: f64,
    /// Only slide joints.
    pub slides_only: bool,
    /// The mass matrix, its factors and the bias force never change: it only slides, or it
    /// is a free ball about its own centre, which nothing ties.
    pub constant: bool,
    /// Its poses enter a step: something turns, collides or is tied.
    pub seen: bool,
    /// It moves in a plane, and nothing else of it is asked for.
    pub plane: Option<Plane>,
    pub sleep: SleepPolicy,
}

/// A shape on a body.
#[derive(Clone, Debug)]
pub struct Geom {
    pub name: String,
    pub body: usize,
    pub kind: GeomType,
    pub size: [f64; 3],
    pub pos: Vector3<f64>,
    pub quat: [f64; 4],
    /// Its z in the body's frame: the axis of a capsule.
    pub axis: Vector3<f64>,
    /// Radius of the sphere about `pos` that holds the shape; infinite for a plane.
    pub reach: f64,
    /// Half sizes of the box about its frame that holds it [m]; infinite for a plane.
    pub half: [f64; 3],
    /// As in the scene.
    pub contype: u32,
    pub conaffinity: u32,
    /// Of a mesh that can collide, in the geom's frame.
    pub hull: Option<Arc<Hull>>,
    /// Of a height field.
    pub field: Option<Arc<HeightField>>,
    /// Of a mesh: its triangles, for rays.
    pub surface: Option<Arc<Surface>>,
    pub group: i32,
    /// Rays pass through it.
    pub hidden: bool,
    /// Takes part in some pair, so that its pose is needed.
    pub collides: bool,
    /// A capsule whose contacts ask for its axis alone, of all that says how it lies.
    pub by_axis: bool,
    /// Its surface moves, by a velocity and an angular velocity in its frame.
    pub belt: Option<[Vector3<f64>; 2]>,
    /// Of a geom on a tree that moves in a plane.
    pub in_plane: Option<Box<FlatGeom>>,
}

impl Geom {
    /// The shape that it is, at a pose.
    #[inline(always)]
    pub fn shape<'a, R: Real>(&'a self, pose: &'a Pose<R>) -> Shape<'a, R> {
        Shape { pose, size: &self.size, hull: self.hull.as_deref(), field: self.field.as_deref() }
    }
}

/// A named frame on a body.
#[derive(Clone, Debug)]
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
pub struct Pair {
    pub geom1: usize,
    pub geom2: usize,
    pub test: ShapeTest,
    /// Into `Model::materials`.
    pub material: usize,
    /// Its place in `Model::pairs`; in a heap its number.
    pub index: usize,
    /// The first of its slots among those of contacts: as many as its test has touches.
    pub slot: usize,
    /// Sum of both bodies' translational invweight.
    pub invweight: f64,
    /// Into `Model::dof_lists`: union of both bodies' chains, ascending. In a heap: see `DynamicPairs`.
    pub dofs: Span,
    /// Mass of the trees that the contact touches, for residuals.
    pub mass: f64,
    /// Tangents along which nothing can move, known when compiled (see `model/fixed_tangents.rs`).
    pub still: [bool; 2],
    /// The ranges of joints keep the two apart: it is tested only while one of `Model::guards`
    /// is left (see `model/range_separation.rs`).
    pub apart: bool,
}

/// The positions of a joint within which pairs are apart: its range, widened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guard {
    pub joint: usize,
    /// Into qpos.
    pub at: usize,
    pub low: f64,
    pub high: f64,
}

/// A scene, compiled.
#[derive(Clone, Debug)]
pub struct Model {
    pub name: String,
    /// Entries of qpos, and of qvel.
    pub nq: usize,
    pub nv: usize,
    /// Entries of act, and by actuator those that are its own.
    pub na: usize,
    pub activations: Vec<Span>,
    /// Past controls that are kept, and by actuator those that are its own.
    pub nhistory: usize,
    pub histories: Vec<Span>,
    /// By actuator: along what it pulls, and after which length the target of its servo is the same
    /// again (0: never).
    pub along: Vec<Transmission>,
    pub circles: Vec<f64>,
    /// By actuator, and by input of its controller: whose control that is.
    pub feeders: Vec<[Option<usize>; 4]>,
    pub linkages: Vec<Linkage>,
    /// Some of them are those of contacts, which are found after the smooth forces.
    pub adheres: bool,
    /// Some geoms or pairs adhere: their contacts can pull. See `pulls_beside_rows`.
    pub sticks: bool,
    /// Joints whose actuators together are bounded, and the bounds.
    pub clamps: Vec<(usize, [f64; 2])>,
    pub gravity: Vector3<f64>,
    pub magnetic: Vector3<f64>,
    pub features: Features,
    pub bodies: Vec<Body>,
    /// Bodies whose poses are inputs; and of what they carry the bodies without a dof, in order.
    pub mocaps: Vec<usize>,
    pub carried: Vec<usize>,
    pub joints: Vec<Joint>,
    pub dofs: Vec<Dof>,
    pub trees: Vec<Tree>,
    pub geoms: Vec<Geom>,
    pub sites: Vec<Site>,
    pub tendons: Vec<Tendon>,
    /// Some body is held up against gravity.
    pub compensates: bool,
    /// What resists where the bodies move through a fluid.
    pub fluid: fluid::Fluid,
    pub sensors: Vec<Sensor>,
    /// Empty in a heap.
    pub pairs: Vec<Pair>,
    /// By pair, and by two bodies: what a step asks of them first.
    pub spheres: Vec<Spheres>,
    pub body_pairs: Vec<BodyPair>,
    /// There are too many pairs that could meet for a list of them.
    pub dynamic_pairs: Option<DynamicPairs>,
    pub materials: Vec<Material>,
    /// Geoms of explicit pairs, the smaller index first: they are no candidates beside that.
    pub explicit: HashSet<(usize, usize)>,
    /// Pairs of bodies whose geoms never meet, the smaller index first.
    pub excludes: HashSet<(usize, usize)>,
    /// What pairs that are apart rely on.
    pub guards: Vec<Guard>,
    pub equalities: Vec<Equality>,
    pub actuators: Vec<Actuator>,
    pub keys: Vec<Key>,
    pub qpos0: Vec<f64>,
    /// Where each joint's spring is at rest (MuJoCo's `qpos_spring`).
    pub qpos_spring: Vec<f64>,
    /// Lists of dofs that spans point into.
    pub dof_lists: Vec<usize>,
    /// The mass matrix's pattern: see `Dof::row`.
    pub row_dofs: Vec<usize>,
    /// An element couples dofs of different branches or trees: see `model/coupling.rs`.
    pub couples: bool,
    /// What has a range, and what has friction loss.
    pub(crate) limited: Vec<Limited>,
    pub(crate) rubbing: Vec<Rubbing>,
    slots: slots::Slots,
    /// What a step places, what makes rows, and what pushes.
    pub(crate) makers: Vec<Maker>,
    pub(crate) places: Places,
    pub(crate) acting: Acting,
    /// By actuator.
    pub(crate) drives: Vec<ActuatorAt>,
}

/// Nearer than this share of the size of what meets, a row stays: whether the guess of bodies
/// at rest on each other overlaps is rounding.
pub const NEAR: f64 = 1.0 / 1024.0;

impl Model {
    /// What a pair's contacts are made of.
    #[inline(always)]
    pub fn material(&self, pair: &Pair) -> &Material {
        &self.materials[pair.material]
    }

    /// A body that stands where its user puts it: it is awake.
    pub(crate) fn is_mocap(&self, body: usize) -> bool {
        let body = &self.bodies[body];
        body.tree == NONE && body.carried
    }

    /// It can make rows, with so many contacts.
    #[inline(always)]
    pub(crate) fn makes_rows(&self, contacts: usize) -> bool {
        self.makers.iter().any(|maker| *maker != Maker::Contacts || contacts > 0)
    }

    /// Some of its geoms can meet.
    #[inline(always)]
    pub(crate) fn meets(&self) -> bool {
        self.dynamic_pairs.is_some() || !self.pairs.is_empty()
    }

    /// One free joint and nothing jointed on it, the mass a ball's about the joint's own
    /// centre: it has no gyroscopic force, and its mass matrix is diagonal.
    pub fn free_ball(&self, tree: &Tree) -> bool {
        let body = &self.bodies[tree.bodies.start];
        let i = &body.inertia;
        let isotropic =
            i.m11 == i.m22 && i.m22 == i.m33 && i.m12 == 0.0 && i.m13 == 0.0 && i.m23 == 0.0;
        let alone = tree.bodies.len == 1 && self.free_alone(tree);
        alone && isotropic && body.ipos == Vector3::zeros()
    }

    /// A single free body, whatever is fixed to it.
    pub fn free_alone(&self, tree: &Tree) -> bool {
        let joints = self.bodies[tree.bodies.start].joints.of(&self.joints);
        tree.dofs.len == 6 && joints[0].kind == JointType::Free
    }

    /// Single free bodies whose bias force has a derivative that `implicitfast` takes.
    pub fn gyroscopic(&self, tree: &Tree) -> bool {
        self.features.coriolis && self.free_alone(tree) && !self.free_ball(tree)
    }

    /// Trees whose bias force changes with velocities.
    pub fn turns(&self, tree: &Tree) -> bool {
        self.features.coriolis && !tree.slides_only && !self.free_ball(tree)
    }

    /// A dof and its ancestors, ascending, closed as `Dof::closed`.
    pub fn chain_of_dof(&self, k: usize) -> Span {
        self.dofs[k].closed
    }

    /// Where the mass matrix has the entry of two dofs, in arrays laid out like `row_dofs`; None
    /// where neither moves the other.
    #[inline(always)]
    pub fn entry(&self, i: usize, j: usize) -> Option<usize> {
        let row = self.dofs[i.max(j)].row;
        if i == j {
            return Some(row.start);
        }
        let at = row.of(&self.row_dofs).iter().position(|dof| *dof == i.min(j))?;
        Some(row.start + at)
    }

    /// The island of each tree, by its lowest tree: trees that some pair, equality or tendon
    /// can connect share one. In a heap pairs connect trees only while they touch: see `solve/live.rs`.
    pub fn islands(&self) -> Vec<usize> {
        let mut island = Union::new(self.trees.len());
        let meets = self.pairs.iter().map(|p| [self.geoms[p.geom1].body, self.geoms[p.geom2].body]);
        for bodies in meets {
            let [a, b] = bodies.map(|body| self.bodies[body].tree);
            if a != NONE && b != NONE {
                island.join(a, b);
            }
        }
        let tendons = self.tendons.iter().filter(|tendon| tendon.used).map(|tendon| tendon.dofs);
        for dofs in self.equalities.iter().map(|equality| equality.dofs).chain(tendons) {
            for two in dofs.of(&self.dof_lists).windows(2) {
                island.join(self.dofs[two[0]].tree, self.dofs[two[1]].tree);
            }
        }
        self.join_coupled(&mut island);
        (0..self.trees.len()).map(|tree| island.of(tree)).collect()
    }
}
