//! Friction loss: dry friction in a dof or along a tendon, an impulse of at most dt · loss.

use super::constraint::{Constraint, Makings};
use super::{Element, Kind};
use crate::model::transmission::{Rubbing, Transmission};
use crate::model::Model;
use crate::real::{Mask, Real, Value};
use crate::settings::Law;
use crate::solve::law::{least_softness, OnGuess, Spring};
use crate::solve::{Rows, Set, Situation};
use crate::spatial::WIDE;
use std::slice;

pub(super) struct FrictionLoss;

impl Constraint for FrictionLoss {
    const MOST_ROWS: usize = 1;

    fn any(model: &Model) -> bool {
        !model.rubbing.is_empty()
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        rows.friction_losses(makings.now);
    }
}

/// Lists everything with friction loss that moves, dofs before tendons.
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
    /// The rows of consecutive dofs on a path are lifted together.
    fn friction_losses(&mut self, now: &Situation<R>) {
        let metric = &now.placed.metric;
        let next = |one: &Rubbing<R::Value>, two: &Rubbing<R::Value>| match (one.along, two.along) {
            (Transmission::Dof(a), Transmission::Dof(b)) => a + 1 == b && metric.chained(b) > 1,
            _ => false,
        };
        for own in now.model.rubbing.chunk_by(next).flat_map(|chain| chain.chunks(WIDE)) {
            let last = &own[own.len() - 1];
            let path = last.dofs.of(now.dof_lists);
            let single = R::FILLS && matches!(last.along, Transmission::Dof(_));
            let single = single && metric.is_path(path);
            if single {
                self.lift_last(now, path, own.len());
            }
            for (which, loss) in own.iter().enumerate().filter(|(_, own)| !now.all_rest(own.along))
            {
                let first = self.rows.len();
                if single {
                    self.push_last(now, loss.dofs, which);
                } else {
                    self.scratch_along(now, loss.along, loss.dofs, false);
                    self.push_scratch(now, loss.dofs);
                }
                self.friction_loss(now, loss, first);
            }
        }
    }

    /// Fills in the row `first`, and closes it into a block.
    fn friction_loss(&mut self, now: &Situation<R>, loss: &Rubbing<R::Value>, first: usize) {
        let (settings, dt) = (now.settings, now.settings.dt);
        // Half a step's for the mean velocity, and half for the last: see `commit/end_of_step_rows.rs`.
        let most = if now.halves() { 0.5 * dt } else { dt };
        let row = &mut self.rows[first];
        row.lo = loss.most.times(-most);
        row.hi = loss.most.times(most);
        if settings.law == Law::SolRef {
            let law = Spring::new(&loss.soft, dt, settings.refsafe).at_rest();
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
