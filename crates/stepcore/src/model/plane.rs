//! Trees that move in a plane: every hinge turns about one world axis, and every slide lies across
//! it. What they do in a step is worked out in two dimensions: see `place/in_plane.rs`.

use super::pose::{rotation, Pose};
use super::{Body, Geom, Joint, Model, Tree};
use crate::scene::JointType;
use crate::spatial::Quat;
use nalgebra::{Matrix3, Vector3};

/// How far from a world axis an axis may point that was turned there: roundings of poses.
const TURNED: f64 = 8.0 * f64::EPSILON;

/// The plane in which a tree moves, and what it needs of the tree: all as at qpos0, and turned with
/// the body from there on.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    /// Which of the world's axes is its normal.
    pub normal: usize,
    /// By body of the tree.
    pub bodies: Vec<FlatBody>,
    /// By joint of the tree.
    pub joints: Vec<FlatJoint>,
    first_joint: usize,
}

/// Vectors of two entries are along the plane's axes.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatBody {
    /// Moment of inertia about the normal through the centre of mass [kg·m²].
    pub moment: f64,
    /// Orientation.
    pub rot: Matrix3<f64>,
    pub quat: Quat<f64>,
    /// From the parent's origin, as the parent turns [m].
    pub pos: [f64; 2],
    /// From its own origin to its centre of mass [m].
    pub centre: [f64; 2],
}

/// The pose of a geom on a body of such a tree, from the body's origin.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatGeom {
    /// The plane's axes.
    pub axes: [usize; 2],
    pub pos: [f64; 2],
    pub rot: Matrix3<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct FlatJoint {
    /// Of a hinge: ±1, along the normal; 0 of a slide.
    pub turns: f64,
    /// Of a hinge, from the body's origin [m].
    pub anchor: [f64; 2],
    /// Of a slide.
    pub axis: [f64; 2],
}

impl Plane {
    /// The world's axes in the plane; with the normal before them they are right-handed.
    #[inline(always)]
    pub fn axes(&self) -> [usize; 2] {
        across(self.normal)
    }

    /// Of a joint of this tree.
    #[inline(always)]
    pub fn joints_of(&self, body: &Body) -> &[FlatJoint] {
        let first = body.joints.start - self.first_joint;
        &self.joints[first..first + body.joints.len]
    }
}

#[inline(always)]
fn across(normal: usize) -> [usize; 2] {
    [(normal + 1) % 3, (normal + 2) % 3]
}

/// Fills `Tree::plane` and `Geom::in_plane`. Equalities, and tendons that have a mass, read the motion of bodies in space.
pub(super) fn fill(model: &mut Model, poses: &[Pose]) {
    let weighted = model.weighted_by_tendons();
    let quats = quats_at_qpos0(&model.bodies);
    for (index, weighted) in weighted.into_iter().enumerate() {
        let in_space = weighted || !model.equalities.is_empty() || model.trees[index].constant;
        let tree = &model.trees[index];
        let normal = if in_space { None } else { normal_of(model, tree, poses) };
        model.trees[index].plane =
            normal.map(|normal| plane_of(model, tree, normal, poses, &quats));
    }
    for index in 0..model.geoms.len() {
        model.geoms[index].in_plane = flat_geom(model, &model.geoms[index], poses);
    }
}

fn flat_geom(model: &Model, geom: &Geom, poses: &[Pose]) -> Option<Box<FlatGeom>> {
    let tree = model.trees.get(model.bodies[geom.body].tree)?;
    let [x, y] = tree.plane.as_ref()?.axes();
    let rot = poses[geom.body].rot;
    let pos = rot * geom.pos;
    Some(Box::new(FlatGeom { axes: [x, y], pos: [pos[x], pos[y]], rot: rot * rotation(geom.quat) }))
}

fn quats_at_qpos0(bodies: &[Body]) -> Vec<Quat<f64>> {
    let mut quats: Vec<Quat<f64>> = Vec::with_capacity(bodies.len());
    for (i, body) in bodies.iter().enumerate() {
        let own = Quat::of(&body.quat);
        quats.push(if i == 0 { own } else { quats[body.parent].mul(&own) });
    }
    quats
}

fn normal_of(model: &Model, tree: &Tree, poses: &[Pose]) -> Option<usize> {
    let bodies = tree.bodies.of(&model.bodies);
    if bodies.iter().any(|body| body.carried) {
        return None;
    }
    let joints = || bodies.iter().flat_map(|body| body.joints.of(&model.joints));
    (0..3).find(|n| {
        joints().all(|joint| {
            let axis = poses[joint.body].rot * joint.axis;
            match joint.kind {
                JointType::Hinge => (0..3).all(|k| k == *n || axis[k].abs() <= TURNED),
                JointType::Slide => axis[*n].abs() <= TURNED,
                JointType::Ball | JointType::Free => false,
            }
        })
    })
}

fn plane_of(
    model: &Model,
    tree: &Tree,
    normal: usize,
    poses: &[Pose],
    quats: &[Quat<f64>],
) -> Plane {
    let [x, y] = across(normal);
    let flat = |v: Vector3<f64>| [v[x], v[y]];
    let body = |index: usize| {
        let (body, rot) = (&model.bodies[index], poses[index].rot);
        let across = rot.transpose() * Vector3::ith(normal, 1.0);
        FlatBody {
            moment: across.dot(&(body.inertia * across)),
            rot,
            quat: quats[index],
            pos: flat(poses[body.parent].rot * body.pos),
            centre: flat(rot * body.ipos),
        }
    };
    let joint = |joint: &Joint| {
        let rot = poses[joint.body].rot;
        let axis = rot * joint.axis;
        let turns = if joint.kind == JointType::Hinge { axis[normal].signum() } else { 0.0 };
        FlatJoint { turns, anchor: flat(rot * joint.pos), axis: flat(axis) }
    };
    let bodies = tree.bodies.of(&model.bodies);
    let joints = bodies.iter().flat_map(|body| body.joints.of(&model.joints));
    Plane {
        normal,
        first_joint: bodies[0].joints.start,
        bodies: tree.bodies.range().map(body).collect(),
        joints: joints.map(joint).collect(),
    }
}
