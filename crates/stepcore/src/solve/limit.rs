//! Joint limits: a joint goes no further than its range. One row a bound.

use super::law::{OnGuess, SolRef};
use super::rows::{Rows, Set, Situation};
use crate::elements::{Element, Kind};
use crate::model::Joint;
use crate::real::{Mask, Real};
use crate::scene::JointType;
use crate::spatial::{Quat, V3};

impl<R: Real> Rows<R> {
    pub(super) fn limits(&mut self, now: &Situation<R>) {
        if !now.model.features.limit {
            return;
        }
        for (index, joint) in now.model.joints.iter().enumerate() {
            let Some([lo, hi]) = joint.range else { continue };
            if joint.kind == JointType::Ball {
                let q = Quat::of(&now.qpos[joint.qpos..joint.qpos + 4]).normalized();
                let (axis, angle) = q.axis_angle();
                let away = R::select(angle.lt(R::zero()), R::one(), -R::one());
                let direction = V3::new(axis.x * away, axis.y * away, axis.z * away);
                self.limit(now, index, 1, R::of(hi) - angle.abs(), direction.as_slice());
            } else {
                let q = now.qpos[joint.qpos];
                self.limit(now, index, 0, q - R::of(lo), &[R::one()]);
                self.limit(now, index, 1, R::of(hi) - q, &[-R::one()]);
            }
        }
    }

    /// One bound at distance φ; `direction` is its gradient on the joint's dofs.
    fn limit(&mut self, now: &Situation<R>, index: usize, side: usize, phi: R, direction: &[R]) {
        let (model, settings) = (now.model, now.settings);
        let joint: &Joint = &model.joints[index];
        let near = phi.lt(R::of(joint.margin));
        // `penalty` is a law of contacts alone: limits stay MuJoCo's.
        let by_position = !settings.law.on_guess();
        if by_position && near.none() {
            return;
        }
        let dofs = model.chain_of_dof(joint.dof + direction.len() - 1);
        for &k in dofs.of(&model.dof_lists) {
            self.scratch[k] = R::zero();
        }
        self.scratch[joint.dof..joint.dof + direction.len()].copy_from_slice(direction);
        let first = self.rows.len();
        let row = self.push_scratch(now, dofs);
        let mask = if by_position {
            let dof = &model.dofs[joint.dof];
            let r = phi - R::of(joint.margin);
            let law = SolRef::at(&joint.limit, r, settings.dt, settings.refsafe);
            law.fill(row, r, R::of(dof.invweight), R::of(settings.dt));
            near
        } else {
            OnGuess::new(settings).distance(row, phi, 0.0);
            self.violated_by_guess(now, first, phi)
        };
        if mask.none() {
            self.pop_row();
            return;
        }
        let element = Element::part(Kind::Limit, index, side);
        let block = self.push_block(first, Set::Interval, mask, now, element);
        block.mass = model.trees[model.dofs[joint.dof].tree].mass;
    }

    /// φ + dt·J v̂ < 0: the guess goes where it may not.
    pub(super) fn violated_by_guess(&self, now: &Situation<R>, row: usize, phi: R) -> R::Mask {
        let velocity = self.dot(now.model, &self.rows[row], &now.placed.guess);
        (phi + R::of(now.settings.dt) * velocity).lt(R::zero())
    }

    /// Takes back the row pushed last.
    pub(super) fn pop_row(&mut self) {
        if let Some(row) = self.rows.pop() {
            self.y.truncate(row.y);
        }
    }
}
