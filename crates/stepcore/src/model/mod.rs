//! `Model`: a compiled scene, constant during a step.
//!
//! Numbers are `f64` in SI units; a stage turns them into its number type with `Real::of`. Fields
//! that a `Scene` has too have the same meaning there.

mod at_qpos0;
mod body_pairs;
mod build;
mod by_world;
mod check;
mod coupling;
mod dynamic_pairs;
mod equalities;
mod fixed_tangents;
pub(crate) mod fluid;
mod inertia;
mod invweight;
mod lengths;
mod linkages;
mod lru;
mod material;
pub(crate) mod memory;
mod meshes;
mod pair_counts;
mod pairs;
mod parts;
mod places;
mod plane;
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

use crate::real::Constant;
pub(crate) use by_world::differ_in_numbers;
pub(crate) use by_world::ByLane;
pub use by_world::SideBySide;
pub(crate) use dynamic_pairs::MANY as MANY_TREES;
pub use lengths::{
    Coupling, Course, Ends, Equality, Linkage, Moved, Movers, Point, Round, Stretch, Tendon, Tie,
    Transmission,
};
use lengths::{Limited, Rubbing};
pub use material::Material;
pub use pair_counts::Tally;
pub use pairs::Never;
use parts::Slots;
pub use parts::{
    Body, BodyPair, Dof, DynamicPairs, FlatGeom, Geom, Guard, Joint, Pair, Plane, Site, Span,
    Spheres, Tree, NONE,
};
pub(crate) use union::Union;

use crate::plan::acting::{Acting, ActuatorAt};
use crate::plan::makers::Maker;
use crate::plan::places::Places;
use crate::scene::{Actuator, Features, JointType, Key, Sensor};
use fluid::Fluid;
use nalgebra::{Scalar, Vector3};
use std::collections::HashSet;

/// Empties the caches of meshes and pairs of earlier models.
pub fn empty_caches() {
    meshes::forget();
    proofs::forget();
}

/// A scene, compiled.
#[derive(Clone, Debug, Default)]
pub struct Model<N: Scalar = f64> {
    pub name: String,
    /// Entries of qpos, and of qvel.
    pub nq: usize,
    pub nv: usize,
    /// Entries of act, and the entries of each actuator.
    pub na: usize,
    pub activations: Vec<Span>,
    /// Stored past controls, and the entries of each actuator.
    pub nhistory: usize,
    pub histories: Vec<Span>,
    /// For each actuator: the length along which it pulls, and the length after which its servo's
    /// target is the same again (0: never).
    pub along: Vec<Transmission>,
    pub circles: Vec<f64>,
    /// The gears that transmissions point into.
    pub gears: Vec<N>,
    /// For each actuator and input of its controller: the element whose control that is.
    pub feeders: Vec<[Option<usize>; 4]>,
    pub linkages: Vec<Linkage>,
    /// Whether some actuators are adhesions of contacts, which are found after the smooth forces.
    pub adheres: bool,
    /// Whether some geoms or pairs adhere: their contacts can pull. See `pulls_beside_rows`.
    pub sticks: bool,
    /// Joints with a bound on the sum of their actuators, and the bounds.
    pub clamps: Vec<(usize, [N; 2])>,
    pub gravity: Vector3<N>,
    pub magnetic: Vector3<f64>,
    pub features: Features,
    pub bodies: Vec<Body<N>>,
    /// Bodies whose poses are inputs; and the bodies without a dof that they carry, in order.
    pub mocaps: Vec<usize>,
    pub carried: Vec<usize>,
    pub joints: Vec<Joint<N>>,
    pub dofs: Vec<Dof<N>>,
    pub trees: Vec<Tree<N>>,
    pub geoms: Vec<Geom<N>>,
    pub sites: Vec<Site>,
    pub tendons: Vec<Tendon<N>>,
    /// Whether some body's weight is compensated.
    pub compensates: bool,
    /// The shapes that resist motion through a fluid.
    pub fluid: Fluid,
    pub sensors: Vec<Sensor>,
    /// Empty in a pile.
    pub pairs: Vec<Pair<N>>,
    /// For each pair, and by two bodies: the first tests of a step.
    pub spheres: Vec<Spheres>,
    pub body_pairs: Vec<BodyPair>,
    /// Set if there are too many possible pairs for a list of them.
    pub dynamic_pairs: Option<DynamicPairs>,
    pub materials: Vec<Material<N>>,
    /// Geoms of explicit pairs, the smaller index first: they are no candidates otherwise.
    pub explicit: HashSet<(usize, usize)>,
    /// Pairs of bodies whose geoms never meet, the smaller index first.
    pub excludes: HashSet<(usize, usize)>,
    /// The joint bounds that separated pairs rely on.
    pub guards: Vec<Guard>,
    pub equalities: Vec<Equality<N>>,
    pub actuators: Vec<Actuator<N>>,
    pub keys: Vec<Key>,
    pub qpos0: Vec<f64>,
    /// The rest position of each joint's spring (MuJoCo's `qpos_spring`).
    pub qpos_spring: Vec<N>,
    /// Lists of dofs that spans point into.
    pub dof_lists: Vec<usize>,
    /// The mass matrix's pattern: see `Dof::row`.
    pub row_dofs: Vec<usize>,
    /// Whether an element couples dofs of different branches or trees: see `model/coupling.rs`.
    pub couples: bool,
    /// Elements with a range, and elements with friction loss.
    pub(crate) limited: Vec<Limited<N>>,
    pub(crate) rubbing: Vec<Rubbing<N>>,
    slots: Slots,
    /// The things that a step places, that make rows, and that push.
    pub(crate) makers: Vec<Maker>,
    pub(crate) places: Places,
    pub(crate) acting: Acting<N>,
    /// One entry for each actuator.
    pub(crate) drives: Vec<ActuatorAt<N>>,
}

/// A row is kept if it is nearer than this share of the size of the two bodies: for bodies at rest
/// on each other, only rounding decides whether the guess overlaps.
pub const NEAR: f64 = 1.0 / 1024.0;

impl Model {
    /// The place of a material in the list; it is added if it is new.
    pub(super) fn material_index(&mut self, material: Material) -> usize {
        // Neighbours mostly have equal materials.
        let known = self.materials.iter().rposition(|known| *known == material);
        known.unwrap_or_else(|| {
            self.materials.push(material);
            self.materials.len() - 1
        })
    }
}

impl<N: Constant> Model<N> {
    /// The contact parameters of a pair.
    #[inline(always)]
    pub fn material<P>(&self, pair: &Pair<P>) -> &Material<N> {
        &self.materials[pair.material]
    }

    /// Whether a body's pose is set by the user: it is awake.
    pub(crate) fn is_mocap(&self, body: usize) -> bool {
        let body = &self.bodies[body];
        body.tree == NONE && body.carried
    }

    /// Whether it can make rows, with this many contacts.
    #[inline(always)]
    pub(crate) fn makes_rows(&self, contacts: usize) -> bool {
        self.makers.iter().any(|maker| *maker != Maker::Contacts || contacts > 0)
    }

    /// Whether some of its geoms can meet.
    #[inline(always)]
    pub(crate) fn meets(&self) -> bool {
        self.dynamic_pairs.is_some() || !self.pairs.is_empty()
    }

    /// A tree of one free joint and no other, with the mass of a ball about the joint's centre: it
    /// has no gyroscopic force, and its mass matrix is diagonal.
    pub fn free_ball(&self, tree: &Tree<N>) -> bool {
        let body = &self.bodies[tree.bodies.start];
        let i = &body.inertia;
        let zero = [&i.m12, &i.m13, &i.m23, &body.ipos.x, &body.ipos.y, &body.ipos.z];
        let [a, b, c] = [&i.m11, &i.m22, &i.m33].map(|i| i.lane(0));
        let isotropic = a == b && b == c && zero.into_iter().all(Constant::vanishes);
        tree.bodies.len == 1 && self.free_alone(tree) && isotropic
    }

    /// A single free body, with all that is fixed to it.
    pub fn free_alone(&self, tree: &Tree<N>) -> bool {
        let joints = self.bodies[tree.bodies.start].joints.of(&self.joints);
        tree.dofs.len == 6 && joints[0].kind == JointType::Free
    }

    /// Single free bodies whose bias force has a derivative that `implicitfast` takes.
    pub fn gyroscopic(&self, tree: &Tree<N>) -> bool {
        self.features.coriolis && self.free_alone(tree) && !self.free_ball(tree)
    }

    /// Trees whose bias force changes with velocities.
    pub fn turns(&self, tree: &Tree<N>) -> bool {
        self.features.coriolis && !tree.slides_only && !self.free_ball(tree)
    }

    /// A dof and its ancestors, ascending, closed as `Dof::closed`.
    pub fn chain_of_dof(&self, k: usize) -> Span {
        self.dofs[k].closed
    }

    /// The place of the mass matrix's entry of two dofs, in arrays laid out like `row_dofs`; None
    /// if neither moves the other.
    #[inline(always)]
    pub fn entry(&self, i: usize, j: usize) -> Option<usize> {
        let row = self.dofs[i.max(j)].row;
        if i == j {
            return Some(row.start);
        }
        let at = row.of(&self.row_dofs).iter().position(|dof| *dof == i.min(j))?;
        Some(row.start + at)
    }

    /// The island of each tree, by its lowest tree: trees that some pair, equality or tendon can
    /// connect share one. In a pile only touching pairs connect trees: see
    /// `solve/contact_islands.rs`.
    pub fn islands(&self) -> Vec<usize> {
        let mut island = Union::new(self.trees.len());
        let meets = self.pairs.iter().map(|p| [self.geoms[p.geom1].body, self.geoms[p.geom2].body]);
        for bodies in meets {
            let [a, b] = bodies.map(|body| self.bodies[body].tree);
            if a != NONE && b != NONE {
                island.join(a, b);
            }
        }
        let tendons = self.tendons.iter().filter(|tendon| tendon.used).map(|tendon| tendon.closed);
        for dofs in self.equalities.iter().map(|equality| equality.dofs).chain(tendons) {
            for two in dofs.of(&self.dof_lists).windows(2) {
                island.join(self.dofs[two[0]].tree, self.dofs[two[1]].tree);
            }
        }
        self.join_coupled(&mut island);
        (0..self.trees.len()).map(|tree| island.of(tree)).collect()
    }
}
