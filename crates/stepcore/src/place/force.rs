//! The smooth forces on the dofs: everything in `elements/` that pushes without rows.

use super::Placed;
use crate::elements::activation::{rates, Activations};
use crate::elements::actuator::{
    bound, bound_motors, clamp_joints, clamp_tendons, finish_motors, free_tendons, tensions,
};
use crate::elements::force::Frames;
use crate::elements::force::{Group, Moment, Sum};
use crate::elements::forces::push;
use crate::model::transmission::Pulls;
use crate::model::Model;
use crate::real::Real;
use crate::state::Inputs;

impl<R: Real> Placed<R> {
    /// Returns the rates of activations: `act_rate`, and `act_fading`.
    pub(crate) fn act_rates(&self) -> [&[R]; 2] {
        [&self.act_rate, &self.act_fading]
    }

    /// Computes the forces of actuators, and the parts of them that joints let through.
    pub(crate) fn tensions(
        &mut self,
        model: &Model<R::Value>,
        qpos: &[R],
        qvel: &[R],
        act: Activations<R>,
        inputs: &Inputs<R>,
    ) {
        if model.actuators.is_empty() && self.shares.is_empty() {
            return;
        }
        let pulls = Pulls { length: &self.tendon_length, arms: &self.tendon_arms };
        tensions(model, qpos, qvel, act, inputs, pulls, &mut self.actuator);
        if self.shares.is_empty() {
            bound(model, &mut self.actuator);
        } else {
            let (joints, within) = self.shares.split_at_mut(model.nv);
            let (tendons, free) = within.split_at_mut(model.tendons.len());
            clamp_tendons(model, &mut self.actuator);
            bound(model, &mut self.actuator);
            bound_motors(model, &mut self.actuator);
            free_tendons(model, &self.actuator, tendons);
            finish_motors(model, (qpos, qvel), act, inputs, pulls, &mut self.actuator);
            let Self { xpos, xmat, origin, motion, actuator, .. } = self;
            let frames =
                Frames { xpos, xmat, origin, motion, tension: actuator, shares: &[], pulls };
            clamp_joints(&Moment { model, frames, qpos, qvel, act, inputs }, joints, free);
        }
    }

    pub(super) fn smooth_force(
        &mut self,
        model: &Model<R::Value>,
        qpos: &[R],
        qvel: &[R],
        act: Activations<R>,
        inputs: &Inputs<R>,
    ) {
        let pulls = Pulls { length: &self.tendon_length, arms: &self.tendon_arms };
        if model.na > 0 {
            let changes = [&mut self.act_rate[..], &mut self.act_fading];
            rates(model, (qpos, qvel), act, inputs, pulls, changes);
        }
        self.tensions(model, qpos, qvel, act, inputs);
        let Self { xpos, xmat, origin, motion, actuator, passive, bias, force, wrench, .. } = self;
        let pulls = Pulls { length: &self.tendon_length, arms: &self.tendon_arms };
        let shares = &self.shares;
        let frames = Frames { xpos, xmat, origin, motion, tension: actuator, shares, pulls };
        let now = Moment { model, frames, qpos, qvel, act, inputs };
        // The pull of adhesion is added to the passive forces later, for their readers.
        if model.acting.passive || model.sticks {
            push(&now, Group::Passive, &mut Sum { force: passive, wrench });
        }
        for (force, (passive, bias)) in force.iter_mut().zip(passive.iter().zip(&*bias)) {
            *force = *passive - *bias;
        }
        if model.acting.driven || inputs.applied() {
            push(&now, Group::Driven, &mut Sum { force, wrench });
        }
    }
}
