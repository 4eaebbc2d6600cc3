//! The gyroscopic torque of a body, (I ω) × ω in world axes with I about its centre of mass: the part
//! of the bias forces that makes a spinning body precess and nutate. The bias pushes it; this file has
//! it by itself, so that its stiffness can be computed.

use super::applied::on_dofs;
use super::force::Moment;
use crate::model::{Body, NONE};
use crate::real::{value, Constant, Real};
use crate::spatial::{rotate, rotate_back, V3};

/// Differences of principal moments of inertia below this part of their mean are rounding.
const ISOTROPIC: f64 = 1e-12;

/// Calls `add(dof, force)` for the gyroscopic torque of one body.
pub(crate) fn force<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(usize, R)) {
    let body = &now.model.bodies[index];
    if body.tree == NONE || isotropic(body) {
        return;
    }
    let mut omega = V3::zeros();
    for &k in body.chain.of(&now.model.dof_lists) {
        omega += now.frames.motion[k].ang * now.qvel[k];
    }
    let turn = &now.frames.xmat[index];
    let own = rotate_back(turn, &omega);
    let moment = rotate(turn, &(value::matrix(&body.inertia) * own)).cross(&omega);
    on_dofs(now, index, &V3::zeros(), &moment, add);
}

/// Checks for a body that turns freely about any axis.
pub(crate) fn isotropic<N: Constant>(body: &Body<N>) -> bool {
    let inertia = body.inertia.map(|x| x.lane(0));
    let mean = inertia.trace() / 3.0;
    let apart = inertia - nalgebra::Matrix3::from_diagonal_element(mean);
    apart.iter().all(|x| x.abs() <= ISOTROPIC * mean)
}
