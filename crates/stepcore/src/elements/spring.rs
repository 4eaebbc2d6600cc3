//! The spring in a joint: a force −k·s on each of its dofs, s being how far the joint is from
//! the spring's rest; of a ball or a free joint's turn, a rotation vector.

use super::force::{Forces, Group, Moment};
use super::Kind;
use crate::model::{Joint, Model};
use crate::real::Real;
use crate::scene::JointType;
use crate::spatial::Quat;

pub(super) struct Spring;

impl Forces for Spring {
    const KIND: Kind = Kind::Spring;
    const GROUP: Group = Group::Passive;

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, joint: usize, add: &mut impl FnMut(usize, R)) {
        let joint = &now.model.joints[joint];
        if joint.stiffness == 0.0 {
            return;
        }
        let k = R::of(joint.stiffness);
        let (stretch, count) = stretch(now.model, joint, now.qpos);
        for (at, s) in stretch[..count].iter().enumerate() {
            add(joint.dof + at, -(k * *s));
        }
    }

    #[inline(always)]
    fn slopes<R: Real>(now: &Moment<R>, joint: usize, add: &mut impl FnMut(usize, [R; 2])) {
        let joint = &now.model.joints[joint];
        if joint.stiffness == 0.0 {
            return;
        }
        for k in joint.dof..joint.dof + joint.dofs() {
            add(k, [R::of(joint.stiffness), R::zero()]);
        }
    }

    /// ½ k s².
    #[inline(always)]
    fn stored<R: Real>(now: &Moment<R>, joint: usize, add: &mut impl FnMut(R)) {
        let joint = &now.model.joints[joint];
        if joint.stiffness == 0.0 {
            return;
        }
        let (stretch, count) = stretch(now.model, joint, now.qpos);
        for s in &stretch[..count] {
            add(R::of(0.5 * joint.stiffness) * *s * *s);
        }
    }
}

/// How far a joint is from its spring's rest, by dof of the joint [m or rad].
fn stretch<R: Real>(model: &Model, joint: &Joint, qpos: &[R]) -> ([R; 6], usize) {
    let mut out = [R::zero(); 6];
    let rest = |k: usize| R::of(model.qpos_spring[joint.qpos + k]);
    let turn = |at: usize| {
        let q = Quat::of(&qpos[joint.qpos + at..joint.qpos + at + 4]).normalized();
        let zero = Quat::of(&[rest(at), rest(at + 1), rest(at + 2), rest(at + 3)]);
        zero.conjugate().mul(&q).log()
    };
    match joint.kind {
        JointType::Slide | JointType::Hinge => out[0] = qpos[joint.qpos] - rest(0),
        JointType::Ball => out[..3].copy_from_slice(turn(0).as_slice()),
        JointType::Free => {
            for k in 0..3 {
                out[k] = qpos[joint.qpos + k] - rest(k);
            }
            out[3..].copy_from_slice(turn(3).as_slice());
        }
    }
    (out, joint.dofs())
}
