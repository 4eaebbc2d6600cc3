//! The present energies of every lane.

use super::account::Level;
use crate::model::NONE;
use crate::place::spring_energy;
use crate::real::{Mask, Real};
use crate::scene::JointType;
use crate::settings::Law;
use crate::sim::Sim;
use crate::solve::{Block, Set, Source};
use crate::spatial::{rotate, splat, Quat, V3};

impl<R: Real> Sim<R> {
    /// Places, detects and solves at the present state, as the next step will, and sums up.
    /// False if that failed: the step will say why.
    pub(super) fn audit(&mut self, levels: &mut [Level]) -> bool {
        let updates = self.effort.row_updates;
        let solved = self.place_detect_solve().is_ok();
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

    /// What a block's rows give back at most: the force through the whole violation [J].
    fn bent(&self, block: &Block<R>, lane: usize) -> f64 {
        let rows = &self.rows.rows[block.rows.range()];
        let impulse = |at: usize| rows[at].impulse.lane(lane).abs();
        let rate = 1.0 / self.settings.dt;
        let law = self.settings.law;
        match block.source {
            Source::FrictionLoss(_) => 0.0,
            Source::Contact(index) => {
                let contact = &self.detected.contacts[index];
                let pair = &self.model.pairs[contact.pair];
                let margin = if law.on_guess() { 0.0 } else { pair.margin };
                let depth = (margin - contact.dist.lane(lane)).max(0.0);
                let edges = block.set == Set::Interval;
                let normal: f64 =
                    if edges { (0..rows.len()).map(impulse).sum() } else { impulse(0) };
                depth * normal * rate
            }
            Source::Limit(joint, side) => {
                let margin = if law.on_guess() { 0.0 } else { self.model.joints[joint].margin };
                (margin - self.to_limit(joint, side, lane)).max(0.0) * impulse(0) * rate
            }
            Source::Equality(index) => {
                let apart = self.apart(index);
                (0..rows.len().min(3)).map(|k| apart[k].lane(lane).abs() * impulse(k) * rate).sum()
            }
        }
    }

    /// How far a joint is from its bound; negative beyond.
    fn to_limit(&self, joint: usize, side: usize, lane: usize) -> f64 {
        let joint = &self.model.joints[joint];
        let Some([lo, hi]) = joint.range else { return 0.0 };
        if joint.kind == JointType::Ball {
            let q = Quat::of(&self.state.qpos[joint.qpos..joint.qpos + 4]);
            let turned = q.normalized().log();
            return hi - turned.dot(&turned).sqrt().lane(lane);
        }
        let q = self.state.qpos[joint.qpos].lane(lane);
        if side == 0 {
            q - lo
        } else {
            hi - q
        }
    }

    fn apart(&self, index: usize) -> V3<R> {
        let equality = &self.model.equalities[index];
        let point = |body: usize, anchor| {
            self.placed.xpos[body] + rotate(&self.placed.xmat[body], &splat(anchor))
        };
        point(equality.body1, &equality.anchor1) - point(equality.body2, &equality.anchor2)
    }
}
