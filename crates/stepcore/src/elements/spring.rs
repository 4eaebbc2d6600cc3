//! The spring in a joint: a force −k·s on each of its dofs, s the displacement of the joint from the
//! spring's rest; for the turn of a ball or a free joint, a rotation vector. Its stiffness k may grow
//! with the length of s.

use super::force::{Forces, Group, Moment};
use super::Kind;
use crate::model::Model;
use crate::plan::acting::{SpringAt, Why};
use crate::real::{value, Constant, Real, Value};
use crate::scene::{Coefficients, JointType, NONE};
use crate::spatial::Quat;

pub(super) struct Spring;

/// Calls `add(part, force)` with −(a + b x + c x²) s for every part of a stretch s, x being its
/// length: MuJoCo's polynomial (documentation, "Polynomial forces").
#[inline(always)]
pub(super) fn pull<R: Real>(
    law: &Coefficients<R::Value>,
    stretch: &[R],
    mut add: impl FnMut(usize, R),
) {
    let [mut k, b, c] = value::get(law);
    if !linear(law) {
        let x = length(stretch);
        k += b * x + c * x * x;
    }
    for (at, s) in stretch.iter().enumerate() {
        add(at, -(k * *s));
    }
}

/// Minus the derivative of `pull` along the stretch: a + 2 b x + 3 c x².
#[inline(always)]
pub(super) fn slope<R: Real>(law: &Coefficients<R::Value>, stretch: &[R]) -> R {
    let ([a, b, c], x) = (value::get(law), length(stretch));
    a + R::of(2.0) * b * x + R::of(3.0) * c * x * x
}

/// a x²/2 + b x³/3 + c x⁴/4, the first part by part.
#[inline(always)]
pub(super) fn energy<R: Real>(law: &Coefficients<R::Value>, stretch: &[R], mut add: impl FnMut(R)) {
    let [a, b, c] = law;
    for s in stretch {
        add(a.times(0.5) * *s * *s);
    }
    if !linear(law) {
        let x = length(stretch);
        add((Value::calc([b], |[b]| b / 3.0) + c.times(0.25) * x) * x * x * x);
    }
}

fn linear<N: Constant>([_, b, c]: &Coefficients<N>) -> bool {
    b.vanishes() && c.vanishes()
}

/// Returns the length of a stretch; one number keeps its sign.
#[inline(always)]
fn length<R: Real>(stretch: &[R]) -> R {
    match stretch {
        [x] => *x,
        _ => stretch.iter().fold(R::zero(), |sum, s| sum + *s * *s).sqrt(),
    }
}

impl Forces for Spring {
    const KIND: Kind = Kind::Spring;
    const GROUP: Group = Group::Passive;
    const IN_JOINTS: bool = true;
    type At<N: Constant> = SpringAt<N>;

    fn at(model: &Model, joint: usize) -> Result<SpringAt, Why> {
        let joint = &model.joints[joint];
        match joint.stiffness {
            _ if !model.features.spring => Err(Why::Off("spring")),
            NONE => Err(Why::Zero("stiffness")),
            law => Ok(SpringAt { kind: joint.kind, qpos: joint.qpos, dof: joint.dof, law }),
        }
    }

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, at: &SpringAt<R::Value>, add: &mut impl FnMut(usize, R)) {
        stretches(now.model, at, now.qpos, |first, stretch| {
            pull(&at.law, stretch, |k, force| add(first + k, force));
        });
    }

    #[inline(always)]
    fn slopes<R: Real>(
        now: &Moment<R>,
        at: &SpringAt<R::Value>,
        add: &mut dyn FnMut(usize, usize, [R; 2]),
    ) {
        if linear(&at.law) {
            // The slope is the same at every position.
            let slope = at.law[0].get();
            (at.dof..at.dof + at.kind.dofs()).for_each(|k| add(k, k, [slope, R::zero()]));
            return;
        }
        stretches(now.model, at, now.qpos, |first, stretch| {
            let slope = slope(&at.law, stretch);
            for k in first..first + stretch.len() {
                add(k, k, [slope, R::zero()]);
            }
        });
    }

    fn sloped<N: Constant>(_: &Model<N>, at: &SpringAt<N>, each: &mut impl FnMut(usize)) {
        (at.dof..at.dof + at.kind.dofs()).for_each(each);
    }

    #[inline(always)]
    fn stored<R: Real>(now: &Moment<R>, at: &SpringAt<R::Value>, add: &mut impl FnMut(R)) {
        stretches(now.model, at, now.qpos, |_, stretch| energy(&at.law, stretch, &mut *add));
    }
}

/// Calls `each(first dof, stretch)` with the displacement of a joint from its spring's rest [m or rad],
/// separately for a free joint's way and its turn.
#[inline(always)]
fn stretches<R: Real>(
    model: &Model<R::Value>,
    joint: &SpringAt<R::Value>,
    qpos: &[R],
    mut each: impl FnMut(usize, &[R]),
) {
    let rest = |k: usize| model.qpos_spring[joint.qpos + k].get();
    let turn = |at: usize| {
        let q = Quat::of(&qpos[joint.qpos + at..joint.qpos + at + 4]).normalized();
        let zero = Quat::of(&[rest(at), rest(at + 1), rest(at + 2), rest(at + 3)]);
        zero.conjugate().mul(&q).log()
    };
    let way = |k: usize| qpos[joint.qpos + k] - rest(k);
    match joint.kind {
        JointType::Slide | JointType::Hinge => each(joint.dof, &[way(0)]),
        JointType::Ball => each(joint.dof, turn(0).as_slice()),
        JointType::Free => {
            each(joint.dof, &[way(0), way(1), way(2)]);
            each(joint.dof + 3, turn(3).as_slice());
        }
    }
}
