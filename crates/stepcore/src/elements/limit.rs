//! Joint limits: a length goes no further than its range. One row a bound.

use super::constraint::{Constraint, Makings};
use super::{Element, Kind};
use crate::model::transmission::{Reach, Transmission};
use crate::model::{Model, Span, NEAR};
use crate::real::{Mask, Real};
use crate::scene::{JointType, Softness};
use crate::solve::law::{least_softness, Near, OnGuess, SolRef};
use crate::solve::{Guessed, Rows, Set, Situation};
use std::slice;

pub(super) struct Limit;

impl Constraint for Limit {
    const MOST_ROWS: usize = 1;

    fn any(model: &Model) -> bool {
        model.features.limit && !model.limited.is_empty()
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        let by_position = !now.settings.law.on_guess();
        for &index in &now.model.limited {
            let joint = &now.model.joints[index];
            let Some([lo, hi]) = joint.range else { continue };
            if now.rests(now.model.dofs[joint.dof].tree) {
                continue;
            }
            let reach = Reach::of(now.model, index, now.qpos);
            let [below, above] = [reach.length - R::of(lo), R::of(hi) - reach.length];
            let margin = R::of(joint.margin);
            if by_position && below.lt(margin).none() && above.lt(margin).none() {
                continue;
            }
            let bound = |side: usize, phi: R| Bound {
                element: Element::part(Kind::Limit, index, side),
                phi,
                range: [lo, hi],
                margin: joint.margin,
                soft: &joint.limit,
                dofs: Transmission::Joint(index).dofs(now.model),
                invweight: now.model.dofs[joint.dof].invweight,
                mass: now.model.trees[now.model.dofs[joint.dof].tree].mass,
            };
            // The angle of a ball has no lower bound but zero.
            if joint.kind != JointType::Ball {
                let lower = bound(0, below);
                rows.limit(now, &lower, |rows| rows.joint_arms(&reach, false));
            }
            let upper = bound(1, above);
            rows.limit(now, &upper, |rows| rows.joint_arms(&reach, true));
        }
    }
}

/// One bound of a length, and the row that it becomes.
pub(super) struct Bound<'a, R: Real> {
    /// Part 0: the lower bound, from which φ grows with the length; 1: the upper one.
    pub element: Element,
    /// How far the length is from it.
    pub phi: R,
    pub range: [f64; 2],
    pub margin: f64,
    pub soft: &'a Softness,
    /// Into `Model::dof_lists`.
    pub dofs: Span,
    pub invweight: f64,
    pub mass: f64,
}

impl<R: Real> Rows<R> {
    /// ∂φ/∂dof of a bound of a joint.
    fn joint_arms(&mut self, reach: &Reach<R>, upper: bool) {
        for (dof, arm) in reach.arms() {
            self.scratch[dof] = if upper { -arm } else { arm };
        }
    }

    /// The row of a bound; `arms` puts ∂φ/∂dof into `scratch`.
    pub(super) fn limit(
        &mut self,
        now: &Situation<R>,
        bound: &Bound<R>,
        arms: impl FnOnce(&mut Self),
    ) {
        let (model, settings, phi) = (now.model, now.settings, bound.phi);
        let near = phi.lt(R::of(bound.margin));
        // `penalty` is a law of contacts alone: limits stay MuJoCo's.
        let by_position = !settings.law.on_guess();
        if by_position && near.none() {
            return;
        }
        self.clear_scratch(bound.dofs.of(&model.dof_lists));
        arms(self);
        let first = self.rows.len();
        let row = self.push_scratch(now, bound.dofs);
        let mask = if by_position {
            let r = phi - R::of(bound.margin);
            let law = SolRef::at(bound.soft, r, settings.dt, settings.refsafe);
            let least = least_softness(slice::from_ref(row), bound.mass);
            law.fill(row, r, R::of(bound.invweight), least, R::of(settings.dt));
            near
        } else {
            let Guessed { closing, gained } = self.guessed(now, first, phi);
            let (arrives, far) = (R::Mask::of(true), R::Mask::of(false));
            let near = Near { phi, closing, gained, arrives, far };
            let law = OnGuess::new(now);
            law.distance(&mut self.rows[first], &near, 0.0, law.push(phi));
            let [lo, hi] = bound.range;
            closing.or(phi.le(R::of(NEAR * (hi - lo))))
        };
        // A length that no joint changes has no row, as in MuJoCo: any impulse would do nothing.
        let mask = mask.and(self.rows[first].a.gt(R::zero()));
        if mask.none() {
            self.pop_row();
            return;
        }
        self.push_block(first, Set::Interval, mask, now, bound.element, bound.mass);
    }
}
