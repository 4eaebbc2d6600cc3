//! A tendon's spring and damper: forces along its length.

use super::force::{Forces, Group, Moment};
use super::{damper, spring, Kind};
use crate::model::transmission::Transmission;
use crate::model::Model;
use crate::plan::acting::{TendonAt, Why};
use crate::real::array::map;
use crate::real::value::{self, none};
use crate::real::{Constant, Mask, Real};
use crate::scene::NONE;

pub(super) struct TendonSpring;
pub(super) struct TendonDamper;

/// Returns the distance of the length from the range within which the spring is slack, negative below
/// the range [m]. For a spring with one rest length it is differentiable there.
#[inline(always)]
fn stretch<R: Real>(now: &Moment<R>, index: usize) -> R {
    let (length, [lo, hi]) =
        (now.frames.pulls.length[index], value::get(&now.model.tendons[index].springlength));
    let (below, above) = (length - lo, length - hi);
    let slack = R::zero();
    let stretch = R::select(below.lt(slack), below, R::select(above.gt(slack), above, slack));
    stretch.with_slopes_of(lo.ge(hi), || below)
}

fn along<R: Real>(now: &Moment<R>, index: usize, mut each: impl FnMut(usize, R)) {
    Transmission::Tendon(index, None).arms(now.model, now.qpos, now.frames.pulls, &mut each);
}

/// Calls `add` with a slope along a tendon as entries of its dofs.
fn spread<R: Real>(
    now: &Moment<R>,
    index: usize,
    slopes: [R; 2],
    add: &mut dyn FnMut(usize, usize, [R; 2]),
) {
    let tendon = Transmission::Tendon(index, None);
    tendon.pairs(now.model, now.qpos, now.frames.pulls, |i, j, product: R| {
        add(i, j, map(slopes, |slope| product * slope));
    });
}

fn dofs<N: Constant>(model: &Model<N>, index: usize, each: &mut impl FnMut(usize)) {
    model.tendons[index].dofs.of(&model.dof_lists).iter().for_each(|dof| each(*dof));
}

fn rate<R: Real>(now: &Moment<R>, index: usize) -> R {
    Transmission::Tendon(index, None).velocity(now.model, now.qpos, now.qvel, now.frames.pulls)
}

/// Returns the force of springs and dampers along a tendon, positive if it lengthens it [N].
pub(crate) fn tendon_force<R: Real>(now: &Moment<R>, index: usize) -> R {
    let (tendon, mut sum) = (&now.model.tendons[index], R::zero());
    if !none(&tendon.stiffness) {
        spring::pull(&tendon.stiffness, &[stretch(now, index)], |_, force| sum += force);
    }
    if !none(&tendon.damping) {
        sum += damper::pull(&tendon.damping, rate(now, index));
    }
    sum
}

impl Forces for TendonSpring {
    const KIND: Kind = Kind::TendonSpring;
    const GROUP: Group = Group::Passive;
    type At<N: Constant> = TendonAt<N>;

    fn at(model: &Model, tendon: usize) -> Result<TendonAt, Why> {
        match model.tendons[tendon].stiffness {
            _ if !model.features.spring => Err(Why::Off("spring")),
            NONE => Err(Why::Zero("stiffness")),
            law => Ok(TendonAt { tendon, law }),
        }
    }

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, at: &TendonAt<R::Value>, add: &mut impl FnMut(usize, R)) {
        let mut pull = R::zero();
        spring::pull(&at.law, &[stretch(now, at.tendon)], |_, force| pull = force);
        along(now, at.tendon, |dof, arm| add(dof, arm * pull));
    }

    /// A slack spring has none.
    #[inline(never)]
    fn slopes<R: Real>(
        now: &Moment<R>,
        at: &TendonAt<R::Value>,
        add: &mut dyn FnMut(usize, usize, [R; 2]),
    ) {
        let (zero, by) = (R::zero(), stretch(now, at.tendon));
        let [lo, hi] = value::get::<R, _, 2>(&now.model.tendons[at.tendon].springlength);
        let slack = by.le(zero).and(by.ge(zero)).and(lo.lt(hi));
        let slope = R::select(slack, zero, spring::slope(&at.law, &[by]));
        spread(now, at.tendon, [slope, zero], add);
    }

    fn sloped<N: Constant>(model: &Model<N>, at: &TendonAt<N>, each: &mut impl FnMut(usize)) {
        dofs(model, at.tendon, each);
    }

    #[inline(always)]
    fn stored<R: Real>(now: &Moment<R>, at: &TendonAt<R::Value>, add: &mut impl FnMut(R)) {
        spring::energy(&at.law, &[stretch(now, at.tendon)], &mut *add);
    }
}

impl Forces for TendonDamper {
    const KIND: Kind = Kind::TendonDamper;
    const GROUP: Group = Group::Passive;
    type At<N: Constant> = TendonAt<N>;

    fn at(model: &Model, tendon: usize) -> Result<TendonAt, Why> {
        match model.tendons[tendon].damping {
            _ if !model.features.damper => Err(Why::Off("damper")),
            NONE => Err(Why::Zero("damping")),
            law => Ok(TendonAt { tendon, law }),
        }
    }

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, at: &TendonAt<R::Value>, add: &mut impl FnMut(usize, R)) {
        let pull = damper::pull(&at.law, rate(now, at.tendon));
        along(now, at.tendon, |dof, arm| add(dof, arm * pull));
    }

    #[inline(never)]
    fn slopes<R: Real>(
        now: &Moment<R>,
        at: &TendonAt<R::Value>,
        add: &mut dyn FnMut(usize, usize, [R; 2]),
    ) {
        let slope = damper::slope(&at.law, rate(now, at.tendon));
        spread(now, at.tendon, [R::zero(), slope], add);
    }

    fn sloped<N: Constant>(model: &Model<N>, at: &TendonAt<N>, each: &mut impl FnMut(usize)) {
        dofs(model, at.tendon, each);
    }

    fn damps<N: Constant>(_: &Model<N>, _: &TendonAt<N>) -> bool {
        true
    }
}
