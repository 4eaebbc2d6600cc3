//! The smooth forces on the dofs: everything in `elements/` that pushes without rows.

use super::{Frames, Placed, Pulls};
use crate::elements::activation::{rates, Activations};
use crate::elements::actuator::tensions;
use crate::elements::force::{Group, Moment, Sum};
use crate::elements::forces::push;
use crate::model::Model;
use crate::real::Real;
use crate::state::Inputs;

impl<R: Real> Placed<R> {
    pub(super) fn smooth_force(
        &mut self,
        model: &Model,
        qpos: &[R],
        qvel: &[R],
        act: Activations<R>,
        inputs: &Inputs<R>,
    ) {
        rates(model, act.act, inputs, &mut self.act_rate);
        let Self { xpos, xmat, origin, motion, actuator, passive, bias, force, wrench, .. } = self;
        let pulls = Pulls { length: &self.tendon_length, arms: &self.tendon_arms };
        tensions(model, qpos, qvel, act, inputs, pulls, actuator);
        let frames = Frames { xpos, xmat, origin, motion, tension: actuator, pulls };
        let now = Moment { model, frames, qpos, qvel, act, inputs };
        push(&now, Group::Passive, &mut Sum { force: passive, wrench });
        for k in 0..model.nv {
            force[k] = passive[k] - bias[k];
        }
        push(&now, Group::Driven, &mut Sum { force, wrench });
    }
}
