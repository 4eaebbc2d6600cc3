//! The damper in a joint: a force −b·v on each of its dofs, whose damping b may grow with v.

use super::force::{Forces, Group, Moment, Sum};
use super::Kind;
use crate::model::Model;
use crate::plan::acting::{Acts, DamperAt, Why};
use crate::real::{Constant, Real, Value};
use crate::scene::{Coefficients, NONE};

pub(super) struct Damper;

/// −(a + b |v| + c v²) v: MuJoCo's polynomial, odd in v (documentation, "Polynomial forces").
#[inline(always)]
pub(super) fn pull<R: Real>([a, b, c]: &Coefficients<R::Value>, velocity: R) -> R {
    let mut damping = a.get();
    if !(b.vanishes() && c.vanishes()) {
        damping += b.get() * velocity.abs() + c.get() * velocity * velocity;
    }
    -(damping * velocity)
}

/// Minus the derivative of `pull`: a + 2 b |v| + 3 c v².
#[inline(always)]
pub(super) fn slope<R: Real>([a, b, c]: &Coefficients<R::Value>, velocity: R) -> R {
    let mut damping = a.get();
    if !(b.vanishes() && c.vanishes()) {
        damping += b.times(2.0) * velocity.abs() + c.times(3.0) * velocity * velocity;
    }
    damping
}

impl Forces for Damper {
    const KIND: Kind = Kind::Damper;
    const GROUP: Group = Group::Passive;
    const IN_JOINTS: bool = true;
    type At<N: Constant> = DamperAt<N>;

    fn at(model: &Model, joint: usize) -> Result<DamperAt, Why> {
        let joint = &model.joints[joint];
        match joint.damping {
            _ if !model.features.damper => Err(Why::Off("damper")),
            NONE => Err(Why::Zero("damping")),
            law => Ok(DamperAt { first: joint.dof, count: joint.dofs(), law }),
        }
    }

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, at: &DamperAt<R::Value>, add: &mut impl FnMut(usize, R)) {
        for k in at.first..at.first + at.count {
            add(k, pull(&at.law, now.qvel[k]));
        }
    }

    /// The sum of passive forces starts with dampers.
    #[inline(always)]
    fn push<R: Real>(now: &Moment<R>, list: &[Acts<DamperAt<R::Value>>], sum: &mut Sum<R>) {
        sum.force.fill(R::zero());
        for Acts { at, .. } in list {
            Self::force(now, at, &mut |dof, force| sum.force[dof] = force);
        }
    }

    #[inline(always)]
    fn slopes<R: Real>(
        now: &Moment<R>,
        at: &DamperAt<R::Value>,
        add: &mut dyn FnMut(usize, usize, [R; 2]),
    ) {
        for k in at.first..at.first + at.count {
            add(k, k, [R::zero(), slope(&at.law, now.qvel[k])]);
        }
    }

    fn sloped<N: Constant>(_: &Model<N>, at: &DamperAt<N>, each: &mut impl FnMut(usize)) {
        (at.first..at.first + at.count).for_each(each);
    }

    fn damps<N: Constant>(_: &Model<N>, _: &DamperAt<N>) -> bool {
        true
    }
}
