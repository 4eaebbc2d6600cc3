//! Friction loss: dry friction in a dof, an impulse of at most dt · loss.

use super::law::{OnGuess, SolRef};
use super::rows::{Rows, Set, Situation};
use crate::elements::{Element, Kind};
use crate::real::{Mask, Real};
use crate::settings::Law;

impl<R: Real> Rows<R> {
    pub(super) fn losses(&mut self, now: &Situation<R>) {
        if !now.model.features.frictionloss {
            return;
        }
        let (model, settings) = (now.model, now.settings);
        let dt = settings.dt;
        for (k, dof) in model.dofs.iter().enumerate() {
            if dof.frictionloss <= 0.0 {
                continue;
            }
            let dofs = model.chain_of_dof(k);
            for &j in dofs.of(&model.dof_lists) {
                self.scratch[j] = R::zero();
            }
            self.scratch[k] = R::one();
            let first = self.rows.len();
            let row = self.push_scratch(now, dofs);
            row.lo = R::of(-dt * dof.frictionloss);
            row.hi = R::of(dt * dof.frictionloss);
            if settings.law == Law::SolRef {
                let law =
                    SolRef::at(&dof.friction, R::zero(), dt, settings.refsafe).without_position();
                law.fill(row, R::zero(), R::of(dof.invweight), R::of(dt));
            } else {
                OnGuess::new(settings).friction(row);
            }
            let part = k - model.joints[dof.joint].dof;
            let element = Element::part(Kind::FrictionLoss, dof.joint, part);
            let block = self.push_block(first, Set::Interval, R::Mask::of(true), now, element);
            block.mass = model.trees[dof.tree].mass;
        }
    }
}
