//! Forward kinematics of trees that move in a plane: see `kinematics.rs` and `in_plane.rs`. Components
//! along the plane's normal stay as they were placed first.

use super::in_plane::{plus_turned, V2};
use super::Placed;
use crate::model::{FlatGeom, Model, Plane};
use crate::real::{value, Real, Value};
use crate::scene::JointType;
use crate::spatial::{Quat, M3, V3};
use nalgebra::Matrix3;

/// cos and sin of an angle.
pub(super) type Turn<R> = [R; 2];

/// Returns the turn by the sum of both angles.
#[inline(always)]
fn sum<R: Real>([c, s]: Turn<R>, [d, t]: Turn<R>) -> Turn<R> {
    [c * d - s * t, s * d + c * t]
}

/// A constant vector, turned.
#[inline(always)]
pub(super) fn turned<R: Real, N: Value<R>>(turn: Turn<R>, v: &[N; 2]) -> V2<R> {
    sum(turn, value::get(v))
}

/// The turn by this angle about one of the world's axes, and then `to`.
#[inline(always)]
fn turned_quat<R: Real>([c, s]: Turn<R>, to: &Quat<f64>, plane: &Plane<R::Value>) -> Quat<R> {
    let ([x, y], z) = (plane.axes(), plane.normal);
    let (w, along) = (R::of(to.w), R::of(to.v[z]));
    let [across, up] = turned([c, s], &[to.v[x], to.v[y]]);
    let mut v = V3::zeros();
    (v[x], v[y], v[z]) = (across, up, c * along + s * w);
    Quat { w: c * w - s * along, v }
}

/// A constant orientation, turned; its rows along the normal stay.
#[inline(always)]
fn turn_axes<R: Real>(to: &mut M3<R>, turn: Turn<R>, rot: &Matrix3<f64>, [x, y]: [usize; 2]) {
    for k in 0..3 {
        [to[(x, k)], to[(y, k)]] = turned(turn, &[rot[(x, k)], rot[(y, k)]]);
    }
}

impl<R: Real> Placed<R> {
    /// See `place_body`.
    pub(super) fn place_body_in_plane(
        &mut self,
        model: &Model<R::Value>,
        qpos: &[R],
        index: usize,
    ) {
        let body = &model.bodies[index];
        let Some(plane) = &model.trees[body.tree].plane else { return };
        let first = model.trees[body.tree].bodies.start;
        let flat = &plane.bodies[index - first];
        let [x, y] = plane.axes();
        let (mut half, mut turn) = self.in_plane[body.parent].turn;
        let (parent, offset) = (&self.xpos[body.parent], turned(turn, &flat.pos));
        let mut pos = [parent[x] + offset[0], parent[y] + offset[1]];
        let joints = || body.joints.of(&model.joints).iter().zip(plane.joints_of(body));
        for (joint, flat) in joints() {
            let along = qpos[joint.qpos] - R::of(joint.reference);
            let lin = &mut self.motion[joint.dof].lin;
            if joint.kind == JointType::Slide {
                let axis = turned(turn, &flat.axis);
                pos = [pos[0] + along * axis[0], pos[1] + along * axis[1]];
                [lin[x], lin[y]] = axis;
                continue;
            }
            let apart = !value::none(&flat.anchor);
            if apart {
                let arm = turned(turn, &flat.anchor);
                pos = [pos[0] + arm[0], pos[1] + arm[1]];
            }
            // The anchor, until the tree's origin is computed.
            [lin[x], lin[y]] = pos;
            let (s, c) = (along * R::of(0.5 * flat.turns)).sin_cos();
            half = sum(half, [c, s]);
            turn = sum(half, half);
            if apart {
                let arm = turned(turn, &flat.anchor);
                pos = [pos[0] - arm[0], pos[1] - arm[1]];
            }
        }
        self.in_plane[index].turn = (half, turn);
        [self.xpos[index][x], self.xpos[index][y]] = pos;
        self.xquat[index] = turned_quat(half, &flat.quat, plane);
        turn_axes(&mut self.xmat[index], turn, &flat.rot, [x, y]);
        if index == first {
            self.origin[body.tree] = self.xpos[index];
        }
        let origin = &self.origin[body.tree];
        for (joint, flat) in joints().filter(|(joint, _)| joint.kind == JointType::Hinge) {
            let lin = &mut self.motion[joint.dof].lin;
            let arm = [origin[x] - lin[x], origin[y] - lin[y]];
            [lin[x], lin[y]] = plus_turned([R::zero(); 2], R::of(flat.turns), arm);
        }
    }

    /// See `place_geom_centre`.
    pub(super) fn move_geom_in_plane(
        &mut self,
        flat: &FlatGeom<R::Value>,
        body: usize,
        index: usize,
    ) {
        let (at, arm) = (&self.xpos[body], turned(self.in_plane[body].turn.1, &flat.pos));
        for (k, arm) in flat.axes.into_iter().zip(arm) {
            self.geom[index].pos[k] = at[k] + arm;
        }
    }

    /// See `place_geom`.
    pub(super) fn turn_geom_in_plane(
        &mut self,
        flat: &FlatGeom<R::Value>,
        body: usize,
        index: usize,
    ) {
        let (rot, turn) = (&mut self.geom[index].rot, self.in_plane[body].turn.1);
        turn_axes(rot, turn, &flat.rot, flat.axes);
    }
}
