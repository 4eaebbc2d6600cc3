//! The damper in a joint: a force −b·v on each of its dofs, whose damping b may grow with v.

use super::force::{Forces, Group, Moment, Sum};
use super::Kind;
use crate::model::Model;
use crate::real::Real;
use crate::scene::{Coefficients, NONE};

pub(super) struct Damper;

/// −(a + b |v| + c v²) v: MuJoCo's polynomial, odd in v (documentation, "Polynomial forces").
#[inline(always)]
pub(super) fn pull<R: Real>(&[a, b, c]: &Coefficients, velocity: R) -> R {
    let mut damping = R::of(a);
    if b != 0.0 || c != 0.0 {
        damping += R::of(b) * velocity.abs() + R::of(c) * velocity * velocity;
    }
    -(damping * velocity)
}

/// Minus the derivative of that: a + 2 b |v| + 3 c v².
#[inline(always)]
pub(super) fn slope<R: Real>(&[a, b, c]: &Coefficients, velocity: R) -> R {
    let mut damping = R::of(a);
    if b != 0.0 || c != 0.0 {
        damping += R::of(2.0 * b) * velocity.abs() + R::of(3.0 * c) * velocity * velocity;
    }
    damping
}

impl Forces for Damper {
    const KIND: Kind = Kind::Damper;
    const GROUP: Group = Group::Passive;
    const IN_JOINTS: bool = true;

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, joint: usize, add: &mut impl FnMut(usize, R)) {
        let joint = &now.model.joints[joint];
        for k in joint.dof..joint.dof + joint.dofs() {
            add(k, pull(&joint.damping, now.qvel[k]));
        }
    }

    /// The sum of passive forces starts with dampers: every dof has one, if only of zero.
    #[inline(always)]
    fn push<R: Real>(now: &Moment<R>, sum: &mut Sum<R>) {
        for joint in &now.model.joints {
            for k in joint.dof..joint.dof + joint.dofs() {
                sum.force[k] = pull(&joint.damping, now.qvel[k]);
            }
        }
    }

    #[inline(always)]
    fn slopes<R: Real>(now: &Moment<R>, joint: usize, add: &mut impl FnMut(usize, usize, [R; 2])) {
        let joint = &now.model.joints[joint];
        for k in joint.dof..joint.dof + joint.dofs() {
            add(k, k, [R::zero(), slope(&joint.damping, now.qvel[k])]);
        }
    }

    /// Of every dof, also one that its joint does not damp.
    #[inline(always)]
    fn damping<R: Real>(now: &Moment<R>, joint: usize, add: &mut impl FnMut(usize, usize, R)) {
        Self::slopes(now, joint, &mut |i, j, [_, damping]| add(i, j, damping));
    }

    fn sloped(model: &Model, joint: usize, each: &mut impl FnMut(usize)) {
        let joint = &model.joints[joint];
        if joint.damping != NONE {
            (joint.dof..joint.dof + joint.dofs()).for_each(each);
        }
    }

    fn damps(model: &Model, joint: usize) -> bool {
        model.joints[joint].damping != NONE
    }
}
