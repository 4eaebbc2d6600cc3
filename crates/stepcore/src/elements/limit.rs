//! Limits keep the length of a joint or of a tendon within its range. One row a bound.

use super::constraint::{Constraint, Makings};
use super::{Element, Kind};
use crate::model::transmission::{Limited, Transmission};
use crate::model::{Model, Span, NEAR};
use crate::real::{Mask, Real, Value};
use crate::scene::JointType;
use crate::solve::law::{least_softness, Near, OnGuess, SolRef};
use crate::solve::{Guessed, Rows, Set, Situation};
use std::slice;

pub(super) struct Limit;

impl Constraint for Limit {
    const MOST_ROWS: usize = 1;

    fn any(model: &Model) -> bool {
        !model.limited.is_empty()
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        let by_position = !now.settings.law.on_guess();
        for bound in now.model.limited.iter().filter(|bound| !now.all_rest(bound.along)) {
            let length = bound.along.length(now.model, now.qpos, now.placed.pulls());
            let [lo, hi] = &bound.range;
            let both = [length - lo.get(), hi.get() - length];
            let margin = bound.margin.get();
            if by_position && both.iter().all(|phi| phi.lt(margin).none()) {
                continue;
            }
            for side in bound.sides.clone() {
                rows.limit(now, bound, side, both[side]);
            }
        }
    }
}

/// Lists everything with a range that moves, joints before tendons.
pub(crate) fn limited(model: &Model) -> Vec<Limited> {
    if !model.features.limit {
        return vec![];
    }
    let joints = model.joints.iter().enumerate().filter_map(|(index, joint)| {
        let (along, dof) = (Transmission::Joint(index), &model.dofs[joint.dof]);
        // The angle of a ball has no lower bound but zero.
        let sides = usize::from(joint.kind == JointType::Ball)..2;
        Some(Limited {
            along,
            kind: Kind::Limit,
            index,
            range: joint.range?,
            sides,
            margin: joint.margin,
            soft: joint.limit.clone(),
            dofs: along.dofs(model),
            invweight: dof.invweight,
            mass: model.trees[dof.tree].mass,
        })
    });
    let tendons = model.tendons.iter().enumerate().filter_map(|(index, tendon)| {
        Some(Limited {
            along: Transmission::Tendon(index, None),
            kind: Kind::TendonLimit,
            index,
            range: tendon.range?,
            sides: 0..2,
            margin: tendon.margin,
            soft: tendon.limit.clone(),
            dofs: tendon.closed,
            invweight: tendon.invweight,
            mass: tendon.mass,
        })
    });
    joints.chain(tendons).filter(|bound| bound.dofs.len > 0).collect()
}

impl<R: Real> Situation<'_, R> {
    /// Checks that everything that moves a length sleeps.
    #[inline(always)]
    pub(super) fn all_rest(&self, along: Transmission) -> bool {
        if self.asleep.is_empty() {
            return false;
        }
        let mut all = true;
        along.movers(self.model, |dof| all &= self.rests(self.model.dofs[dof].tree));
        all
    }
}

impl<R: Real> Rows<R> {
    /// Writes the arms of a length, or their opposite, into `scratch`, which is cleared on these dofs.
    pub(super) fn scratch_along(
        &mut self,
        now: &Situation<R>,
        along: Transmission,
        dofs: Span,
        opposite: bool,
    ) {
        self.clear_scratch(dofs.of(&now.model.dof_lists));
        along.arms(now.model, now.qpos, now.placed.pulls(), |dof, arm| {
            self.scratch[dof] = if opposite { -arm } else { arm };
        });
    }

    /// Makes the row of a bound at this distance φ: of the lower one, from which φ grows with the
    /// length, or of the upper one.
    fn limit(&mut self, now: &Situation<R>, bound: &Limited<R::Value>, side: usize, phi: R) {
        let settings = now.settings;
        let near = phi.lt(bound.margin.get());
        // `penalty` is a law of contacts alone: limits stay MuJoCo's.
        let by_position = !settings.law.on_guess();
        if by_position && near.none() {
            return;
        }
        self.scratch_along(now, bound.along, bound.dofs, side == 1);
        let first = self.rows.len();
        let row = self.push_scratch(now, bound.dofs);
        let mask = if by_position {
            let r = phi - bound.margin.get();
            let law = SolRef::at(&bound.soft, r, settings.dt, settings.refsafe);
            let least = least_softness(slice::from_ref(row), bound.mass.get());
            law.fill(row, r, bound.invweight.get(), least, R::of(settings.dt));
            near
        } else {
            let Guessed { closing, gained } = self.guessed(now, first, phi);
            let (arrives, far) = (R::Mask::of(true), R::Mask::of(false));
            let near = Near { phi, closing, gained, arrives, far };
            let law = OnGuess::new(now);
            law.distance(&mut self.rows[first], &near, 0.0, law.push(phi));
            let [lo, hi] = bound.range.each_ref();
            closing.or(phi.le(Value::calc([lo, hi], |[lo, hi]| NEAR * (hi - lo))))
        };
        let element = Element::part(bound.kind, bound.index, side);
        // A length that no joint changes has no row, as in MuJoCo: any impulse would do nothing.
        let mask = mask.and(self.rows[first].a.gt(R::zero()));
        if mask.none() {
            self.pop_row();
            return;
        }
        self.push_block(first, Set::Interval, mask, now, element, bound.mass.get());
    }
}
