//! Friction loss: dry friction in a dof or along a tendon, an impulse of at most dt · loss.

use super::constraint::{Constraint, Makings};
use super::{Element, Kind};
use crate::model::transmission::{Rubbing, Transmission};
use crate::model::Model;
use crate::real::{Mask, Real, Value};
use crate::settings::Law;
use crate::solve::law::{least_softness, OnGuess, SolRef};
use crate::solve::{Rows, Set, Situation};
use std::slice;

pub(super) struct FrictionLoss;

impl Constraint for FrictionLoss {
    const MOST_ROWS: usize = 1;

    fn any(model: &Model) -> bool {
        !model.rubbing.is_empty()
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        for loss in now.model.rubbing.iter().filter(|loss| !now.all_rest(loss.along)) {
            rows.friction_loss(now, loss);
        }
    }
}

/// What has friction loss and moves, dofs before tendons.
pub(crate) fn rubbing(model: &Model) -> Vec<Rubbing> {
    if !model.features.frictionloss {
        return vec![];
    }
    let dofs = model.dofs.iter().enumerate().map(|(k, dof)| {
        let part = k - model.joints[dof.joint].dof;
        Rubbing {
            along: Transmission::Dof(k),
            element: Element::part(Kind::FrictionLoss, dof.joint, part),
            most: dof.frictionloss,
            soft: dof.friction.clone(),
            dofs: model.chain_of_dof(k),
            invweight: dof.invweight,
            mass: model.trees[dof.tree].mass,
        }
    });
    let tendons = model.tendons.iter().enumerate().map(|(index, tendon)| Rubbing {
        along: Transmission::Tendon(index, None),
        element: Element::whole(Kind::TendonFriction, index),
        most: tendon.frictionloss,
        soft: tendon.friction.clone(),
        dofs: tendon.closed,
        invweight: tendon.invweight,
        mass: tendon.mass,
    });
    dofs.chain(tendons).filter(|loss| loss.most > 0.0 && loss.dofs.len > 0).collect()
}

impl<R: Real> Rows<R> {
    fn friction_loss(&mut self, now: &Situation<R>, loss: &Rubbing<R::Value>) {
        let (settings, dt) = (now.settings, now.settings.dt);
        // Half a step's for the mean velocity, and half for the last: see `commit/end_of_step_rows.rs`.
        let most = if now.halves() { 0.5 * dt } else { dt };
        self.scratch_along(now, loss.along, loss.dofs, false);
        let first = self.rows.len();
        let row = self.push_scratch(now, loss.dofs);
        row.lo = loss.most.times(-most);
        row.hi = loss.most.times(most);
        if settings.law == Law::SolRef {
            let law = SolRef::at(&loss.soft, R::zero(), dt, settings.refsafe).without_position();
            let least = least_softness(slice::from_ref(row), loss.mass.get());
            law.fill(row, R::zero(), loss.invweight.get(), least, R::of(dt));
        } else {
            OnGuess::new(now).friction(row);
        }
        self.push_block(
            first,
            Set::Interval,
            R::Mask::of(true),
            now,
            loss.element,
            loss.mass.get(),
        );
    }
}
