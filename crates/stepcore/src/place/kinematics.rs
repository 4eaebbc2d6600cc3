//! Forward kinematics: joint positions to poses, and the motion of each dof.

use super::Placed;
use crate::model::{Joint, Model, NONE};
use crate::plan::places::{Part, Way};
use crate::real::{Constant, Real};
use crate::scene::JointType;
use crate::spatial::{principal, rotate, splat, Motion, Quat, M3, V3};
use nalgebra::Vector3;

/// A frame that is aligned with its parent's.
const IDENTITY: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// Turns a body's frame about a joint's anchor, which is returned.
#[inline(always)]
fn turn_about<R: Real>(
    joint: &Joint<R::Value>,
    pos: &mut V3<R>,
    quat: &mut Quat<R>,
    turned: impl Fn(&Quat<R>) -> Quat<R>,
) -> V3<R> {
    if joint.pos.iter().all(Constant::vanishes) {
        *quat = turned(quat);
        return *pos;
    }
    let anchor = *pos + quat.rotate(&splat(&joint.pos));
    *quat = turned(quat);
    *pos = anchor - quat.rotate(&splat(&joint.pos));
    anchor
}

/// Returns a direction of a body's frame in world axes.
#[inline(always)]
fn turned<R: Real>(rot: &M3<R>, direction: &Vector3<f64>) -> V3<R> {
    match principal(direction) {
        Some((k, sign)) if sign > 0.0 => V3::new(rot[(0, k)], rot[(1, k)], rot[(2, k)]),
        Some((k, _)) => V3::new(-rot[(0, k)], -rot[(1, k)], -rot[(2, k)]),
        None => rotate(rot, &splat(direction)),
    }
}

impl<R: Real> Placed<R> {
    /// Places a body on its parent and moves it through its joints in order.
    pub(super) fn place_body(&mut self, model: &Model<R::Value>, qpos: &[R], index: usize) {
        if let Some(at) = model.bodies[index].mocap {
            let (pos, quat) = self.mocap[at];
            (self.xpos[index], self.xquat[index], self.xmat[index]) = (pos, quat, quat.matrix());
            return;
        }
        match model.way(index) {
            Way::Sliding | Way::Planar if !self.placed => {
                self.place_by(model, qpos, index, Way::Jointed);
            }
            way => self.place_by(model, qpos, index, way),
        }
    }

    /// Places a body in this way.
    #[inline(always)]
    pub(super) fn place_by(&mut self, model: &Model<R::Value>, qpos: &[R], index: usize, way: Way) {
        match way {
            Way::Free { qpos: at, dof } => self.free_body(model, &qpos[at..at + 7], index, dof),
            Way::Sliding => self.slide_body(model, qpos, index),
            Way::Planar => self.place_body_in_plane(model, qpos, index),
            Way::Jointed => self.joint_body(model, qpos, index),
        }
    }

    fn free_body(&mut self, model: &Model<R::Value>, q: &[R], index: usize, dof: usize) {
        self.xpos[index] = V3::new(q[0], q[1], q[2]);
        self.xquat[index] = Quat::of(&q[3..7]).normalized();
        self.xmat[index] = self.xquat[index].matrix();
        self.origin[model.bodies[index].tree] = self.xpos[index];
        self.free_motion(index, dof);
    }

    fn joint_body(&mut self, model: &Model<R::Value>, qpos: &[R], index: usize) {
        let body = &model.bodies[index];
        let (parent, joints) = (body.parent, body.joints.of(&model.joints));
        let offset = rotate(&self.xmat[parent], &splat(&body.pos));
        self.offset[index] = offset;
        let mut pos = self.xpos[parent] + offset;
        let mut quat = self.xquat[parent];
        if body.quat != IDENTITY {
            quat = quat.mul(&Quat::splat(&body.quat));
        }
        let last = joints.len().saturating_sub(1);
        for (at, joint) in joints.iter().enumerate() {
            let q = qpos[joint.qpos];
            match joint.kind {
                JointType::Slide => {
                    let axis = quat.rotate(&splat(&joint.axis));
                    let along = q - R::of(joint.reference);
                    pos += V3::new(axis.x * along, axis.y * along, axis.z * along);
                    self.motion[joint.dof] = Motion { ang: V3::zeros(), lin: axis };
                }
                JointType::Hinge => {
                    let angle = q - R::of(joint.reference);
                    // The last one's axis is read from the body's matrix.
                    let before = at < last;
                    let axis = if before { quat.rotate(&splat(&joint.axis)) } else { V3::zeros() };
                    let turned = |quat: &Quat<R>| quat.turned(&joint.axis, angle);
                    let anchor = turn_about(joint, &mut pos, &mut quat, turned);
                    // `lin` holds the anchor until the tree's origin is computed.
                    self.motion[joint.dof] = Motion { ang: axis, lin: anchor };
                }
                JointType::Ball => {
                    let turn = Quat::of(&qpos[joint.qpos..joint.qpos + 4]).normalized();
                    let anchor = turn_about(joint, &mut pos, &mut quat, |quat| quat.mul(&turn));
                    let m = quat.matrix();
                    for k in 0..3 {
                        let axis = V3::new(m[(0, k)], m[(1, k)], m[(2, k)]);
                        self.motion[joint.dof + k] = Motion { ang: axis, lin: anchor };
                    }
                }
                // The builder allows a free joint only alone: the branch above.
                JointType::Free => {}
            }
        }
        self.xpos[index] = pos;
        self.xquat[index] = quat;
        self.xmat[index] = quat.matrix();
        if let Some(Joint { kind: JointType::Hinge, dof, axis, .. }) = joints.last() {
            self.motion[*dof].ang = turned(&self.xmat[index], axis);
        }
        if body.tree != NONE {
            if model.trees[body.tree].bodies.start == index {
                self.origin[body.tree] = pos;
            }
            self.about_origin(model, index);
        }
    }

    /// Places a body that never turns: its orientation, its axes and its offset stay.
    fn slide_body(&mut self, model: &Model<R::Value>, qpos: &[R], index: usize) {
        let body = &model.bodies[index];
        let mut pos = self.xpos[body.parent] + self.offset[index];
        for joint in body.joints.of(&model.joints) {
            let along = qpos[joint.qpos] - R::of(joint.reference);
            let axis = &self.motion[joint.dof].lin;
            pos += V3::new(axis.x * along, axis.y * along, axis.z * along);
        }
        self.xpos[index] = pos;
        if model.trees[body.tree].bodies.start == index {
            self.origin[body.tree] = pos;
        }
    }

    /// Turns (axis, anchor) of hinges and balls into motions about the tree's origin.
    fn about_origin(&mut self, model: &Model<R::Value>, index: usize) {
        let body = &model.bodies[index];
        let origin = self.origin[body.tree];
        for joint in body.joints.of(&model.joints) {
            let count = match joint.kind {
                JointType::Hinge => 1,
                JointType::Ball => 3,
                _ => 0,
            };
            for motion in &mut self.motion[joint.dof..joint.dof + count] {
                motion.lin = motion.ang.cross(&(origin - motion.lin));
            }
        }
    }

    /// Linear velocity in world axes, angular velocity in body axes.
    fn free_motion(&mut self, index: usize, dof: usize) {
        let m = self.xmat[index];
        for k in 0..3 {
            if !self.placed {
                let mut unit = V3::zeros();
                unit[k] = R::one();
                self.motion[dof + k] = Motion { ang: V3::zeros(), lin: unit };
            }
            self.motion[dof + 3 + k].ang = V3::new(m[(0, k)], m[(1, k)], m[(2, k)]);
        }
    }

    /// Places a geom completely.
    pub fn place_geom(&mut self, model: &Model<R::Value>, index: usize) {
        let geom = &model.geoms[index];
        self.place_geom_centre(model, index);
        match &geom.in_plane {
            Some(flat) if self.placed => self.turn_geom_in_plane(flat, geom.body, index),
            _ if geom.quat == IDENTITY => self.geom[index].rot = self.xmat[geom.body],
            _ => {
                let quat = self.xquat[geom.body].mul(&Quat::splat(&geom.quat));
                self.geom[index].rot = quat.matrix();
            }
        }
    }

    fn place_geom_centre(&mut self, model: &Model<R::Value>, index: usize) {
        let geom = &model.geoms[index];
        let body = geom.body;
        match &geom.in_plane {
            Some(flat) if self.placed => self.move_geom_in_plane(flat, body, index),
            _ => {
                let arm = rotate(&self.xmat[body], &splat(&geom.pos));
                self.geom[index].pos = self.xpos[body] + arm;
            }
        }
    }

    /// Places only the part of a colliding geom's pose that its contacts need.
    #[inline(always)]
    pub(super) fn place_part(&mut self, model: &Model<R::Value>, index: usize, part: Part) {
        match part {
            Part::Centre => self.place_geom_centre(model, index),
            Part::Axis => {
                let geom = &model.geoms[index];
                self.place_geom_centre(model, index);
                let axis = turned(&self.xmat[geom.body], &geom.axis);
                self.geom[index].rot.set_column(2, &axis);
            }
            Part::Whole => self.place_geom(model, index),
        }
    }
}
