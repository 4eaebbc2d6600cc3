//! Quantities of tendons, at the positions that were placed last.

use super::zeros;
use crate::elements::tendon_spring::tendon_force;
use crate::elements::Kind;
use crate::error::Result;
use crate::model::transmission::Transmission;
use crate::model::Tie;
use crate::real::{Constant, Mask, Real, Value};
use crate::scene::Target;
use crate::sim::{At, Sim};

impl<R: Real> Sim<R> {
    /// Rate of each tendon's length.
    pub fn tendon_velocity(&self) -> Vec<R> {
        let rate = |index| {
            let along = Transmission::Tendon(index, None);
            along.velocity(&self.model, &self.state.qpos, &self.state.qvel, self.placed.pulls())
        };
        (0..self.model.tendons.len()).map(rate).collect()
    }

    /// Arms of each tendon by dof, in a lane: tendons × nv. Refuses them without enough memory.
    pub fn tendon_jacobian(&self, lane: usize) -> Result<Vec<f64>> {
        let mut all = zeros("ten_J", self.model.tendons.len(), self.model.nv)?;
        for (row, tendon) in all.chunks_mut(self.model.nv.max(1)).zip(&self.model.tendons) {
            let arms = tendon.arms.of(&self.placed.tendon_arms);
            for (dof, arm) in tendon.dofs.of(&self.model.dof_lists).iter().zip(arms) {
                row[*dof] = arm.lane(lane);
            }
        }
        Ok(all)
    }

    /// Force of each tendon's spring and damper, positive where it lengthens it [N].
    pub fn tendon_force(&self) -> Vec<R> {
        let now = self.moment(At::State);
        (0..self.model.tendons.len()).map(|index| tendon_force(&now, index)).collect()
    }

    /// All forces along each spatial tendon in the last solve, in a lane, positive where they
    /// lengthen it [N]: of its spring and damper, actuators, limit, friction loss, equalities and
    /// armature. 0 for fixed tendons, which pull at no point.
    pub(crate) fn tension_of_tendons(&self, lane: usize) -> Vec<f64> {
        let (model, placed) = (&*self.model, &self.placed);
        let now = self.moment(At::State);
        let own = |index: usize| {
            let tendon = &model.tendons[index];
            let mut sum = tendon_force(&now, index);
            if !tendon.armature.vanishes() {
                let dofs = tendon.dofs.of(&model.dof_lists).iter();
                let arms = dofs.zip(tendon.arms.of(&placed.tendon_arms));
                let free = placed.free_acceleration_along(model, tendon);
                let all = arms.fold(free, |sum, (dof, arm)| sum + *arm * self.qacc[*dof]);
                sum -= tendon.armature.get() * all;
            }
            sum.lane(lane)
        };
        let spatial = |index: usize| model.tendons[index].spatial();
        let each = 0..model.tendons.len();
        let mut sums: Vec<f64> = each.map(|at| if spatial(at) { own(at) } else { 0.0 }).collect();
        for (actuator, force) in model.actuators.iter().zip(&placed.actuator) {
            if let Target::Tendon(tendon) = actuator.target {
                sums[tendon] += actuator.gear[0].lane(lane) * force.lane(lane);
            }
        }
        self.tension_of_rows(lane, |tendon, force| sums[tendon] += force);
        (0..sums.len()).filter(|at| !spatial(*at)).for_each(|at| sums[at] = 0.0);
        sums
    }

    /// Calls `add(tendon, force)` for the forces that the rows of tendons exert along them.
    fn tension_of_rows(&self, lane: usize, mut add: impl FnMut(usize, f64)) {
        let model = &*self.model;
        for block in self.rows.blocks.iter().filter(|block| block.mask.lane(lane)) {
            let (element, index) = (block.element, block.element.index as usize);
            let force = || self.rows.rows[block.rows.start].total().lane(lane) / self.clock.seconds;
            match element.kind {
                Kind::TendonLimit => add(index, if element.part == 1 { -force() } else { force() }),
                Kind::TendonFriction => add(index, force()),
                Kind::TendonEquality => {
                    let Tie::Lengths(tie) = &model.equalities[index].tie else { continue };
                    let slope: R = tie.slope(model, &self.state.qpos, self.placed.pulls());
                    let ends = [(Some(tie.first), 1.0), (tie.second, -slope.lane(lane))];
                    for (end, share) in ends {
                        if let Some(Transmission::Tendon(tendon, _)) = end {
                            add(tendon, share * force());
                        }
                    }
                }
                _ => {}
            }
        }
    }
}
