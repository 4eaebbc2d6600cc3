//! Poses and velocities of frames: frame*, subtree*.

use super::{index, Reading};
use crate::model::Model;
use crate::real::Real;
use crate::scene::{Sensor, SensorObject, SensorType};
use crate::spatial::{rotate_back, Motion, Quat, V3};
use crate::watch::Bodies;

impl<R: Real> Reading<'_, R> {
    /// Position, or an axis, in the frame of reference.
    pub(super) fn place(&self, sensor: &Sensor) -> V3<f64> {
        let (own, reference) = (self.pose(sensor.object), self.pose(sensor.reference));
        reference.to_local(&match sensor.kind {
            SensorType::FrameXAxis => own.axis(0),
            SensorType::FrameYAxis => own.axis(1),
            SensorType::FrameZAxis => own.axis(2),
            _ => own.pos - reference.pos,
        })
    }

    pub(super) fn turn(&self, sensor: &Sensor, out: &mut Vec<f64>) {
        let quat = |object: SensorObject| {
            let (body, _, quat) = self.mount(object);
            self.bodies.xquat[body].mul(&Quat::splat(&quat))
        };
        let own = sensor.object.map_or(Quat::identity(), quat);
        let seen = match sensor.reference {
            Some(reference) => quat(reference).conjugate().mul(&own),
            None => own,
        };
        out.extend([seen.w, seen.v.x, seen.v.y, seen.v.z]);
    }

    /// Velocity of an object's origin, and its angular velocity, in world axes.
    pub(super) fn motion(&self, object: Option<SensorObject>) -> Motion<f64> {
        let Some(object) = object else { return Motion::zero() };
        self.bodies.velocity_at(self.body_of(object), &self.pose(Some(object)).pos)
    }

    /// Velocity in the frame of reference, as seen by an observer that moves and turns with it.
    pub(super) fn speed(&self, sensor: &Sensor) -> V3<f64> {
        let (own, reference) = (self.pose(sensor.object), self.pose(sensor.reference));
        let (mine, other) = (self.motion(sensor.object), self.motion(sensor.reference));
        reference.to_local(&match sensor.kind {
            SensorType::FrameAngVel => mine.ang - other.ang,
            _ => mine.lin - other.at(&(own.pos - reference.pos)),
        })
    }

    /// Acceleration of an object's origin, with gravity as an upward acceleration, and its angular
    /// acceleration, in world axes.
    ///
    /// The rate of a spatial velocity lacks ω × v compared with a point that moves along.
    pub(super) fn point_acceleration(&mut self, object: SensorObject) -> Motion<f64> {
        let (body, at) = (self.body_of(object), self.pose(Some(object)).pos);
        let arm = at - self.bodies.about(body);
        let spatial = self.forces().cacc[body];
        let velocity = self.bodies.velocity_at(body, &at);
        let lin = spatial.at(&arm) + velocity.ang.cross(&velocity.lin);
        Motion { ang: spatial.ang, lin }
    }

    pub(super) fn acceleration(&mut self, sensor: &Sensor) -> V3<f64> {
        let Some(object) = sensor.object else { return V3::zeros() };
        let all = self.point_acceleration(object);
        if sensor.kind == SensorType::FrameAngAcc {
            all.ang
        } else {
            all.lin
        }
    }
}

impl Bodies {
    /// For a body and all that hangs on it: angular momentum about their centre of mass, and the
    /// velocity of that centre.
    pub(super) fn subtree_momentum(&self, model: &Model, sensor: &Sensor) -> (V3<f64>, V3<f64>) {
        let top = index(sensor);
        let centre = self.subtree_com[top];
        let (mut angular, mut linear) = (V3::zeros(), V3::zeros());
        for (index, body) in model.bodies.iter().enumerate().skip(top) {
            if !model.hangs_on(index, top) {
                continue;
            }
            let motion = self.velocity_at(index, &self.centre[index]);
            let momentum = motion.lin * body.mass;
            let turn = self.xmat[index];
            angular += turn * (body.inertia * rotate_back(&turn, &motion.ang));
            angular += (self.centre[index] - centre).cross(&momentum);
            linear += momentum;
        }
        // A subtree without a mass does not move.
        (angular, linear / self.subtree_mass[top].max(f64::MIN_POSITIVE))
    }
}
