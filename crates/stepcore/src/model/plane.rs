//! Trees that move in a plane: every hinge turns about one world axis, and every slide is across
//! it. Their steps are computed in two dimensions: see `place/in_plane.rs`.

use super::parts::{across, FlatBody, FlatJoint};
use super::{Body, FlatGeom, Geom, Joint, Model, Plane, Tree};
use crate::scene::JointType;
use crate::spatial::{rotation, Pose, Quat};
use nalgebra::Vector3;

/// The largest deviation of a rotated axis from a world axis: rounding of poses.
const TURNED: f64 = 8.0 * f64::EPSILON;

/// Fills `Tree::plane` and `Geom::in_plane`. Equalities and tendons with mass read the motion of
/// bodies in space.
pub(super) fn find(model: &mut Model, poses: &[Pose<f64>]) {
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

fn flat_geom(model: &Model, geom: &Geom, poses: &[Pose<f64>]) -> Option<Box<FlatGeom>> {
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

fn normal_of(model: &Model, tree: &Tree, poses: &[Pose<f64>]) -> Option<usize> {
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
    poses: &[Pose<f64>],
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
