//! What can be read of tendons, at the positions that were last placed.

use crate::elements::tendon_spring::tendon_force;
use crate::real::Real;
use crate::sim::{At, Sim};
use crate::transmission::Transmission;

impl<R: Real> Sim<R> {
    /// Rate of each tendon's length.
    pub fn tendon_velocity(&self) -> Vec<R> {
        let rate = |index| {
            let along = Transmission::Tendon(index, 1.0);
            along.velocity(&self.model, &self.state.qpos, &self.state.qvel, self.placed.pulls())
        };
        (0..self.model.tendons.len()).map(rate).collect()
    }

    /// Arms of each tendon by dof, in a lane: tendons × nv.
    pub fn tendon_jacobian(&self, lane: usize) -> Vec<f64> {
        let mut all = vec![0.0; self.model.tendons.len() * self.model.nv];
        for (row, tendon) in all.chunks_mut(self.model.nv).zip(&self.model.tendons) {
            let arms = tendon.arms.of(&self.placed.tendon_arms);
            for (dof, arm) in tendon.dofs.of(&self.model.dof_lists).iter().zip(arms) {
                row[*dof] = arm.lane(lane);
            }
        }
        all
    }

    /// Force of each tendon's spring and damper, positive where it lengthens it [N].
    pub fn tendon_force(&self) -> Vec<R> {
        let now = self.moment(At::State);
        (0..self.model.tendons.len()).map(|index| tendon_force(&now, index)).collect()
    }
}
