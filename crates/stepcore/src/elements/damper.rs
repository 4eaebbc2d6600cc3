//! The damper in a joint: a force −b·v on each of its dofs.

use super::force::{Forces, Group, Moment, Sum};
use super::Kind;
use crate::model::Model;
use crate::real::Real;

pub(super) struct Damper;

impl Forces for Damper {
    const KIND: Kind = Kind::Damper;
    const GROUP: Group = Group::Passive;

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, joint: usize, add: &mut impl FnMut(usize, R)) {
        let joint = &now.model.joints[joint];
        for k in joint.dof..joint.dof + joint.dofs() {
            add(k, damping_force(now, k));
        }
    }

    /// The sum of passive forces starts with dampers: every dof has one, if only of zero.
    #[inline(always)]
    fn push<R: Real>(now: &Moment<R>, sum: &mut Sum<R>) {
        for k in 0..now.model.nv {
            sum.force[k] = damping_force(now, k);
        }
    }

    #[inline(always)]
    fn slopes<R: Real>(now: &Moment<R>, joint: usize, add: &mut impl FnMut(usize, [R; 2])) {
        let joint = &now.model.joints[joint];
        for k in joint.dof..joint.dof + joint.dofs() {
            add(k, [R::zero(), R::of(now.model.dofs[k].damping)]);
        }
    }

    /// Of every dof, also one that its joint does not damp.
    #[inline(always)]
    fn damping<R: Real>(now: &Moment<R>, joint: usize, add: &mut impl FnMut(usize, R)) {
        Self::slopes(now, joint, &mut |dof, [_, damping]| add(dof, damping));
    }

    fn damps(model: &Model, joint: usize) -> Option<usize> {
        let dof = model.joints[joint].dof;
        (model.dofs[dof].damping != 0.0).then_some(dof)
    }
}

#[inline(always)]
fn damping_force<R: Real>(now: &Moment<R>, dof: usize) -> R {
    -(R::of(now.model.dofs[dof].damping) * now.qvel[dof])
}
