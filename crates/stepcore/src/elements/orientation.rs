//! Servos that turn a ball joint to an orientation along the shortest way: MuJoCo's `orientation`.
//!
//! With q the orientation of the ball and p the orientation that its controls request, as a rotation
//! vector or as a quaternion of any length, the torque in the axes of the body is kp log(q⁻¹ p) − kv ω.
//! If it is longer than the bound of its force it keeps its direction (MuJoCo documentation, XML
//! reference, "actuator/orientation"). Each of the three axes is an actuator, and so is a fourth
//! control. Slopes are kp and kv in each axis, as in MuJoCo, and none at the bound.

use super::activation::Activations;
use crate::model::Model;
use crate::real::array::{from_fn, map};
use crate::real::{Mask, Real, Value};
use crate::scene::Target;
use crate::spatial::{Quat, V3};
use crate::state::Inputs;

/// The torque about the axis of one of its actuators, and whether it is within the bound.
pub(super) struct Turn<R: Real> {
    pub force: R,
    pub free: R::Mask,
}

pub(super) fn turn<R: Real>(
    model: &Model<R::Value>,
    index: usize,
    (qpos, qvel): (&[R], &[R]),
    act: Activations<R>,
    inputs: &Inputs<R>,
) -> Option<Turn<R>> {
    let actuator = &model.actuators[index];
    let own = actuator.orientation?;
    let Target::Joint(joint) = actuator.target else { return None };
    let joint = &model.joints[joint];
    let ctrl = model.feeders[actuator.feeds.unwrap_or(index)].map(|feeder| {
        feeder.map_or(R::zero(), |k| model.actuators[k].held(model, act.ctrl(model, k, inputs)))
    });
    let vector = V3::new(ctrl[0], ctrl[1], ctrl[2]);
    let target =
        if own.quat { Quat { w: ctrl[3], v: vector }.normalized() } else { Quat::exp(&vector) };
    let here = Quat::of(&qpos[joint.qpos..]).normalized();
    let way = here.conjugate().mul(&target).log();
    let [_, kp, kv] = from_fn(|k| Value::calc([&actuator.bias[k]], |[x]| 0.0 - x));
    let torque = map([way.x, way.y, way.z], |x| kp * x);
    let torque: [R; 3] = crate::real::array::from_fn(|k| torque[k] - kv * qvel[joint.dof + k]);
    let Some([_, most]) = &actuator.forcerange else {
        return Some(Turn { force: torque[own.axis], free: R::Mask::of(true) });
    };
    let square = torque[0] * torque[0] + torque[1] * torque[1] + torque[2] * torque[2];
    let (norm, most) = (square.sqrt(), most.get());
    let free = norm.lt(most);
    let share = R::select(free, R::one(), most * norm.recip_or_zero());
    Some(Turn { force: torque[own.axis] * share, free })
}
