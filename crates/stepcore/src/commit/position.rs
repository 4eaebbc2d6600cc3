//! q ⊕ dt·v: positions advance by a velocity; quaternions by the exponential map.

use crate::model::Model;
use crate::real::Real;
use crate::scene::JointType;
use crate::spatial::{Quat, V3};

/// out ← qpos ⊕ dt·qvel. A free joint moves in world axes and turns in body axes.
pub fn advance<R: Real>(model: &Model<R::Value>, qpos: &[R], qvel: &[R], dt: R, out: &mut [R]) {
    for joint in &model.joints {
        let (q, v) = (joint.qpos, joint.dof);
        match joint.kind {
            JointType::Slide | JointType::Hinge => out[q] = qpos[q] + dt * qvel[v],
            JointType::Ball => rotate(&qpos[q..q + 4], &qvel[v..v + 3], dt, &mut out[q..q + 4]),
            JointType::Free => {
                for k in 0..3 {
                    out[q + k] = qpos[q + k] + dt * qvel[v + k];
                }
                rotate(&qpos[q + 3..q + 7], &qvel[v + 3..v + 6], dt, &mut out[q + 3..q + 7]);
            }
        }
    }
}

fn rotate<R: Real>(quat: &[R], rate: &[R], dt: R, out: &mut [R]) {
    let vector = V3::new(rate[0] * dt, rate[1] * dt, rate[2] * dt);
    let still = vector.dot(&vector).le(R::zero());
    let turned = Quat::of(quat).mul(&Quat::exp(&vector));
    turned.normalized().store(out);
    // A joint that does not turn keeps its bits: scaling to unit length may change the last one.
    let mut product = [R::zero(); 4];
    turned.store(&mut product);
    for ((new, old), product) in out.iter_mut().zip(quat).zip(product) {
        *new = R::select(still, *old, *new).with_slopes_of(still, || product);
    }
}
