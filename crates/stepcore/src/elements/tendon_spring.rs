//! A tendon's spring and damper: forces along its length.

use super::force::{Forces, Group, Moment};
use super::{damper, spring, Kind};
use crate::model::transmission::Transmission;
use crate::model::Model;
use crate::real::{Mask, Real};
use crate::scene::NONE;

pub(super) struct TendonSpring;
pub(super) struct TendonDamper;

/// How far the length is from the range within which the spring is slack: below it negative [m].
#[inline(always)]
fn stretch<R: Real>(now: &Moment<R>, index: usize) -> R {
    let (length, [lo, hi]) =
        (now.frames.pulls.length[index], now.model.tendons[index].springlength);
    let (below, above) = (length - R::of(lo), length - R::of(hi));
    if lo == hi {
        return below;
    }
    let slack = R::zero();
    R::select(below.lt(slack), below, R::select(above.gt(slack), above, slack))
}

fn along<R: Real>(now: &Moment<R>, index: usize, mut each: impl FnMut(usize, R)) {
    Transmission::Tendon(index, 1.0).arms(now.model, now.qpos, now.frames.pulls, &mut each);
}

/// A slope along a tendon as entries of its dofs.
fn spread<R: Real>(
    now: &Moment<R>,
    index: usize,
    slopes: [R; 2],
    add: &mut impl FnMut(usize, usize, [R; 2]),
) {
    let tendon = Transmission::Tendon(index, 1.0);
    tendon.pairs(now.model, now.qpos, now.frames.pulls, |i, j, product: R| {
        add(i, j, slopes.map(|slope| product * slope));
    });
}

fn dofs(model: &Model, index: usize, each: &mut impl FnMut(usize)) {
    model.tendons[index].dofs.of(&model.dof_lists).iter().for_each(|dof| each(*dof));
}

fn rate<R: Real>(now: &Moment<R>, index: usize) -> R {
    Transmission::Tendon(index, 1.0).velocity(now.model, now.qpos, now.qvel, now.frames.pulls)
}

/// The force of springs and dampers along a tendon, positive where it lengthens it [N].
pub(crate) fn tendon_force<R: Real>(now: &Moment<R>, index: usize) -> R {
    let (tendon, mut sum) = (&now.model.tendons[index], R::zero());
    if tendon.stiffness != NONE {
        spring::pull(&tendon.stiffness, &[stretch(now, index)], |_, force| sum += force);
    }
    if tendon.damping != NONE {
        sum += damper::pull(&tendon.damping, rate(now, index));
    }
    sum
}

impl Forces for TendonSpring {
    const KIND: Kind = Kind::TendonSpring;
    const GROUP: Group = Group::Passive;

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(usize, R)) {
        let law = &now.model.tendons[index].stiffness;
        if *law != NONE {
            let mut pull = R::zero();
            spring::pull(law, &[stretch(now, index)], |_, force| pull = force);
            along(now, index, |dof, arm| add(dof, arm * pull));
        }
    }

    /// Slack, it has none.
    #[inline(always)]
    fn slopes<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(usize, usize, [R; 2])) {
        let law = &now.model.tendons[index].stiffness;
        if *law != NONE {
            let (zero, by) = (R::zero(), stretch(now, index));
            let [lo, hi] = now.model.tendons[index].springlength;
            let slack = by.le(zero).and(by.ge(zero)).and(R::Mask::of(lo < hi));
            let slope = R::select(slack, zero, spring::slope(law, &[by]));
            spread(now, index, [slope, zero], add);
        }
    }

    fn sloped(model: &Model, index: usize, each: &mut impl FnMut(usize)) {
        if model.tendons[index].stiffness != NONE {
            dofs(model, index, each);
        }
    }

    #[inline(always)]
    fn stored<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(R)) {
        let law = &now.model.tendons[index].stiffness;
        if *law != NONE {
            spring::energy(law, &[stretch(now, index)], &mut *add);
        }
    }
}

impl Forces for TendonDamper {
    const KIND: Kind = Kind::TendonDamper;
    const GROUP: Group = Group::Passive;

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(usize, R)) {
        let law = &now.model.tendons[index].damping;
        if *law != NONE {
            let pull = damper::pull(law, rate(now, index));
            along(now, index, |dof, arm| add(dof, arm * pull));
        }
    }

    #[inline(always)]
    fn slopes<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(usize, usize, [R; 2])) {
        let law = &now.model.tendons[index].damping;
        if *law != NONE {
            spread(now, index, [R::zero(), damper::slope(law, rate(now, index))], add);
        }
    }

    fn sloped(model: &Model, index: usize, each: &mut impl FnMut(usize)) {
        if Self::damps(model, index) {
            dofs(model, index, each);
        }
    }

    fn damps(model: &Model, index: usize) -> bool {
        model.tendons[index].damping != NONE
    }
}
