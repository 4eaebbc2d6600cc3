//! The present energies of every lane.

use super::account::Level;
use crate::model::NONE;
use crate::place::spring_energy;
use crate::real::{Mask, Real};
use crate::settings::Law;
use crate::sim::{At, Sim};
use crate::solve::Block;
use crate::spatial::splat;

impl<R: Real> Sim<R> {
    /// Places, detects and solves at the present state, as the next step will, and sums up.
    /// False if that failed: the step will say why.
    pub(super) fn audit(&mut self, levels: &mut [Level]) -> bool {
        let updates = self.effort.row_updates;
        let solved = self.place_detect_solve(At::State).is_ok();
        self.effort.row_updates = updates;
        if !solved {
            return false;
        }
        let model = self.model.clone();
        self.placed.positions(&model, &self.state.qpos);
        let (half, zero) = (R::of(0.5), R::zero());
        let mut kinetic = zero;
        for k in 0..model.nv {
            // ½ vᵀMv = ½ Σ u²D
            kinetic += half * self.placed.u[k] * self.placed.u[k] / self.placed.metric.inv_d[k];
        }
        let mut moving = kinetic + spring_energy(&model, &self.state.qpos);
        moving += self.stored_in_servos(&self.inputs);
        if self.settings.law == Law::Penalty {
            let stiffness = R::of(0.5 * self.settings.penalty_stiffness);
            for contact in &self.detected.contacts {
                let depth = contact.dist.min(zero);
                moving += R::select(contact.mask, stiffness * depth * depth, zero);
            }
        }
        let (mut gravity, mut size) = (zero, zero);
        if model.features.gravity {
            let down = splat::<R>(&model.gravity);
            for (index, body) in model.bodies.iter().enumerate() {
                if body.tree != NONE && body.mass > 0.0 {
                    let part = R::of(body.mass) * down.dot(&self.centre(index));
                    gravity += -part;
                    size += part.abs();
                }
            }
        }
        for (lane, level) in levels.iter_mut().enumerate() {
            let bent = self.rows.blocks.iter().filter(|block| block.mask.lane(lane));
            *level = Level {
                moving: moving.lane(lane),
                gravity: gravity.lane(lane),
                bent: bent.map(|block| self.bent(block, lane)).sum(),
                size: moving.lane(lane) + size.lane(lane),
            };
        }
        true
    }

    /// What a block's rows give back at most: their force through the whole violation [J].
    fn bent(&self, block: &Block<R>, lane: usize) -> f64 {
        let rows = self.rows.rows[block.rows.range()].iter();
        let held = rows.map(|row| {
            let gap = row.gap.lane(lane);
            let both_ways = row.lo.lane(lane) < 0.0;
            let depth = if both_ways { gap.abs() } else { (-gap).max(0.0) };
            depth * row.impulse.lane(lane).abs()
        });
        held.sum::<f64>() / self.clock.seconds
    }
}
