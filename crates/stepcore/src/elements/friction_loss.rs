//! Friction loss: dry friction in a dof, an impulse of at most dt · loss.

use super::constraint::{Constraint, Makings};
use super::{Element, Kind};
use crate::model::{Model, Span};
use crate::real::{Mask, Real};
use crate::scene::Softness;
use crate::settings::Law;
use crate::solve::law::{least_softness, OnGuess, SolRef};
use crate::solve::{Rows, Set, Situation};
use std::slice;

pub(super) struct FrictionLoss;

impl Constraint for FrictionLoss {
    const MOST_ROWS: usize = 1;

    fn any(model: &Model) -> bool {
        model.features.frictionloss && !model.rubbing.is_empty()
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        let model = now.model;
        for &k in &model.rubbing {
            let dof = &model.dofs[k];
            if now.rests(dof.tree) {
                continue;
            }
            let loss = Loss {
                element: Element::part(
                    Kind::FrictionLoss,
                    dof.joint,
                    k - model.joints[dof.joint].dof,
                ),
                most: dof.frictionloss,
                soft: &dof.friction,
                dofs: model.chain_of_dof(k),
                invweight: dof.invweight,
                mass: model.trees[dof.tree].mass,
            };
            rows.friction_loss(now, &loss, |rows| rows.scratch[k] = R::one());
        }
    }
}

/// Dry friction along a length, and the row that it becomes.
pub(super) struct Loss<'a> {
    pub element: Element,
    /// The largest force.
    pub most: f64,
    pub soft: &'a Softness,
    /// Into `Model::dof_lists`.
    pub dofs: Span,
    pub invweight: f64,
    pub mass: f64,
}

impl<R: Real> Rows<R> {
    /// The row of a friction loss; `arms` puts ∂length/∂dof into `scratch`.
    pub(super) fn friction_loss(
        &mut self,
        now: &Situation<R>,
        loss: &Loss,
        arms: impl FnOnce(&mut Self),
    ) {
        let (settings, dt) = (now.settings, now.settings.dt);
        // Half a step's for the mean velocity, and half for the last: see `commit/end_of_step_rows.rs`.
        let most = if now.halves() { 0.5 * dt } else { dt };
        self.clear_scratch(loss.dofs.of(&now.model.dof_lists));
        arms(self);
        let first = self.rows.len();
        let row = self.push_scratch(now, loss.dofs);
        row.lo = R::of(-most * loss.most);
        row.hi = R::of(most * loss.most);
        if settings.law == Law::SolRef {
            let law = SolRef::at(loss.soft, R::zero(), dt, settings.refsafe).without_position();
            let least = least_softness(slice::from_ref(row), loss.mass);
            law.fill(row, R::zero(), R::of(loss.invweight), least, R::of(dt));
        } else {
            OnGuess::new(now).friction(row);
        }
        self.push_block(first, Set::Interval, R::Mask::of(true), now, loss.element, loss.mass);
    }
}
