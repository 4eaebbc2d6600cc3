//! The present energies of every lane.

use super::account::Level;
use super::drive::Work;
use crate::elements::force::Group;
use crate::elements::forces::stored;
use crate::elements::penalty;
use crate::real::{Mask, Real};
use crate::settings::Law;
use crate::sim::{At, Sim};
use crate::solve::Block;

impl<R: Real> Sim<R> {
    /// Whether the solve of an audit can be the next step's: it has one solve, and summing up
    /// energies, which places all bodies anew, keeps the arms of elements that pull at contacts.
    pub(super) fn audit_stands(&self) -> bool {
        self.plan.solves_once && !self.model.adheres
    }

    /// Places, detects and solves at the present state, as the next step will, and sums up. False
    /// if that failed: the step will report why.
    pub(super) fn audit(&mut self, levels: &mut [Level], work: &Work<R>) -> bool {
        self.wake_where_off();
        if self.place_detect_solve(At::State).is_err() {
            return false;
        }
        let model = self.model.clone();
        self.placed.carry(&self.inputs);
        self.placed.positions(&model, &self.state.qpos);
        let (half, zero) = (R::of(0.5), R::zero());
        let mut kinetic = zero;
        if self.placed.effective.is_some() {
            kinetic = self.kinetic();
        } else {
            for k in 0..model.nv {
                // ½ vᵀMv = ½ Σ u²D
                kinetic += half * self.placed.u[k] * self.placed.u[k] / self.placed.metric.inv_d[k];
            }
        }
        let now = self.moment(At::State);
        let mut moving = kinetic;
        for group in [Group::Passive, Group::Driven] {
            stored(&now, group, &mut |element, energy| {
                if !work.drives(element) {
                    moving += energy;
                }
            });
        }
        if self.settings.law == Law::Penalty {
            for contact in &self.detected.contacts {
                moving += penalty::stored(&self.settings, contact);
            }
        }
        let (mut gravity, mut size) = (zero, zero);
        stored(&now, Group::Weight, &mut |element, energy| {
            if model.moves(element) {
                gravity += energy;
                size += energy.abs();
            }
        });
        for (lane, level) in levels.iter_mut().enumerate() {
            let blocks = || self.rows.blocks.iter().filter(|block| block.mask.lane(lane));
            let pushed: f64 = blocks().map(|block| self.pushed(block, lane)).sum();
            *level = Level {
                moving: moving.lane(lane),
                gravity: gravity.lane(lane),
                held: blocks().map(|block| self.given_back(block, lane)).sum(),
                size: moving.lane(lane) + size.lane(lane),
                unsolved: pushed * self.settings.tolerance,
            };
        }
        true
    }

    /// The sum of the impulses of a block's rows, whatever their direction.
    fn pushed(&self, block: &Block<R>, lane: usize) -> f64 {
        let rows = self.rows.rows[block.rows.range()].iter();
        rows.map(|row| row.impulse.lane(lane).abs()).sum()
    }

    /// The most that a block's rows give back: their force through the whole violation [J]. A row
    /// that nothing moves gives nothing, whatever its load.
    fn given_back(&self, block: &Block<R>, lane: usize) -> f64 {
        let rows = self.rows.rows[block.rows.range()].iter();
        let held = rows.filter(|row| row.a.lane(lane) > 0.0).map(|row| {
            let gap = row.gap.lane(lane);
            let both_ways = row.lo.lane(lane) < 0.0;
            let depth = if both_ways { gap.abs() } else { (-gap).max(0.0) };
            depth * row.impulse.lane(lane).abs()
        });
        held.sum::<f64>() / self.clock.seconds
    }
}
