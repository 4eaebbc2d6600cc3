//! Friction loss: dry friction in a dof, an impulse of at most dt · loss.

use super::constraint::{Constraint, Makings};
use super::{Element, Kind};
use crate::model::Model;
use crate::real::{Mask, Real};
use crate::settings::Law;
use crate::solve::law::{least_softness, OnGuess, SolRef};
use crate::solve::{Rows, Set};
use std::slice;

pub(super) struct FrictionLoss;

impl Constraint for FrictionLoss {
    const MOST_ROWS: usize = 1;

    fn any(model: &Model) -> bool {
        !model.rubbing.is_empty()
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        let (model, settings) = (now.model, now.settings);
        if !model.features.frictionloss {
            return;
        }
        let dt = settings.dt;
        // Half a step's for the mean velocity, and half for the last: see `commit/halves.rs`.
        let most = if now.halves() { 0.5 * dt } else { dt };
        for &k in &model.rubbing {
            let dof = &model.dofs[k];
            if now.rests(dof.tree) {
                continue;
            }
            let dofs = model.chain_of_dof(k);
            rows.clear_scratch(dofs.of(&model.dof_lists));
            rows.scratch[k] = R::one();
            let mass = model.trees[dof.tree].mass;
            let first = rows.rows.len();
            let row = rows.push_scratch(now, dofs);
            row.lo = R::of(-most * dof.frictionloss);
            row.hi = R::of(most * dof.frictionloss);
            if settings.law == Law::SolRef {
                let law =
                    SolRef::at(&dof.friction, R::zero(), dt, settings.refsafe).without_position();
                let least = least_softness(slice::from_ref(row), mass);
                law.fill(row, R::zero(), R::of(dof.invweight), least, R::of(dt));
            } else {
                OnGuess::new(now).friction(row);
            }
            let part = k - model.joints[dof.joint].dof;
            let element = Element::part(Kind::FrictionLoss, dof.joint, part);
            rows.push_block(first, Set::Interval, R::Mask::of(true), now, element, mass);
        }
    }
}
