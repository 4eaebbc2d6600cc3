//! Joint limits: a length goes no further than its range. One row a bound.

use super::constraint::{Constraint, Makings};
use super::{Element, Kind};
use crate::model::Model;
use crate::real::{Mask, Real};
use crate::scene::JointType;
use crate::solve::law::{least_softness, Near, OnGuess, SolRef, NEAR};
use crate::solve::{Guessed, Rows, Set, Situation};
use crate::transmission::{Reach, Transmission};
use std::slice;

pub(super) struct Limit;

impl Constraint for Limit {
    const MOST_ROWS: usize = 1;

    fn any(model: &Model) -> bool {
        !model.limited.is_empty()
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        if !now.model.features.limit {
            return;
        }
        for &index in &now.model.limited {
            let joint = &now.model.joints[index];
            let Some([lo, hi]) = joint.range else { continue };
            if now.rests(now.model.dofs[joint.dof].tree) {
                continue;
            }
            let reach = Transmission::Joint(index).reach(now.model, now.qpos);
            // The angle of a ball has no lower bound but zero.
            if joint.kind != JointType::Ball {
                rows.limit(now, index, 0, reach.length - R::of(lo), &reach);
            }
            rows.limit(now, index, 1, R::of(hi) - reach.length, &reach);
        }
    }
}

impl<R: Real> Rows<R> {
    /// One bound at distance φ: the lower one (side 0) grows with the length, the upper one
    /// (side 1) falls.
    fn limit(&mut self, now: &Situation<R>, index: usize, side: usize, phi: R, reach: &Reach<R>) {
        let (model, settings) = (now.model, now.settings);
        let joint = &model.joints[index];
        let near = phi.lt(R::of(joint.margin));
        // `penalty` is a law of contacts alone: limits stay MuJoCo's.
        let by_position = !settings.law.on_guess();
        if by_position && near.none() {
            return;
        }
        let dofs = Transmission::Joint(index).dofs(model);
        self.clear_scratch(dofs.of(&model.dof_lists));
        for (dof, arm) in reach.arms() {
            self.scratch[dof] = if side == 0 { arm } else { -arm };
        }
        let first = self.rows.len();
        let mass = model.trees[model.dofs[joint.dof].tree].mass;
        let row = self.push_scratch(now, dofs);
        let mask = if by_position {
            let dof = &model.dofs[joint.dof];
            let r = phi - R::of(joint.margin);
            let law = SolRef::at(&joint.limit, r, settings.dt, settings.refsafe);
            let least = least_softness(slice::from_ref(row), mass);
            law.fill(row, r, R::of(dof.invweight), least, R::of(settings.dt));
            near
        } else {
            let Guessed { closing, gained } = self.guessed(now, first, phi);
            let (arrives, far) = (R::Mask::of(true), R::Mask::of(false));
            let near = Near { phi, closing, gained, arrives, far };
            let law = OnGuess::new(now);
            law.distance(&mut self.rows[first], &near, 0.0, law.push(phi));
            let [lo, hi] = joint.range.unwrap_or_default();
            closing.or(phi.le(R::of(NEAR * (hi - lo))))
        };
        if mask.none() {
            self.pop_row();
            return;
        }
        let element = Element::part(Kind::Limit, index, side);
        self.push_block(first, Set::Interval, mask, now, element, mass);
    }
}
