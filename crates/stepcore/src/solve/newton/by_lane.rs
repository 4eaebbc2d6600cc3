//! Heaps in lanes, one world after another.
//!
//! The order of elimination follows from the contacts at hand, and a lane may not depend on its
//! neighbours' contacts. So each lane of a heap is solved as the world that it is.

use super::Newton;
use crate::error::Result;
use crate::real::{Mask, Real};
use crate::room::room;
use crate::solve::limits::{Limits, Report};
use crate::solve::rows::Rows;
use crate::solve::solver::Unconstrained;

/// One world's problem, and who solves it.
pub(super) struct ByLane {
    newton: Newton<f64>,
    rows: Rows<f64>,
    inv_d: Vec<f64>,
    guess: Vec<f64>,
    /// By block of the world: the block of the lanes.
    blocks: Vec<usize>,
}

room!(ByLane: inv_d, guess, blocks; newton, rows);

impl ByLane {
    pub fn new() -> Self {
        Self {
            newton: Newton::new(),
            rows: Rows::bare(0),
            inv_d: Vec::new(),
            guess: Vec::new(),
            blocks: Vec::new(),
        }
    }

    /// Solves every lane by itself.
    pub fn solve<R: Real>(
        &mut self,
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
        limits: Limits,
    ) -> Result<Report<R>> {
        let dof_lists = free.dof_lists;
        let mut report: Report<R> = Report::new();
        for lane in 0..R::LANES {
            let mine = R::Mask::from_lanes(|other| other == lane);
            self.take(lane, free, rows);
            let Self { newton, rows: own, inv_d, guess, .. } = self;
            let world = Unconstrained { dof_lists, inv_d, guess };
            let done = newton.solve(world, own, limits)?;
            self.give(lane, rows);
            report.sweeps.add(mine, done.sweeps.lane(0));
            report.updates.add(mine, done.updates.lane(0));
            report.decrement.set_lane(lane, done.decrement);
            report.open = report.open.or(mine.and(R::Mask::of(done.open)));
        }
        Ok(report)
    }

    fn take<R: Real>(&mut self, lane: usize, free: Unconstrained<R>, rows: &Rows<R>) {
        let fill = |to: &mut Vec<f64>, from: &[R]| {
            to.clear();
            to.extend(from.iter().map(|x| x.lane(lane)));
        };
        fill(&mut self.inv_d, free.inv_d);
        fill(&mut self.guess, free.guess);
        let own = &mut self.rows;
        own.clear();
        own.heap = rows.heap;
        fill(&mut own.u, &rows.u);
        fill(&mut own.y, &rows.y);
        self.blocks.clear();
        for (at, block) in rows.blocks.iter().enumerate().filter(|(_, b)| b.mask.lane(lane)) {
            let mut one = block.at_lane(lane);
            one.rows.start = own.rows.len();
            own.rows.extend(rows.rows[block.rows.range()].iter().map(|row| row.at_lane(lane)));
            own.blocks.push(one);
            self.blocks.push(at);
        }
    }

    fn give<R: Real>(&self, lane: usize, rows: &mut Rows<R>) {
        for (to, from) in rows.u.iter_mut().zip(&self.rows.u) {
            to.set_lane(lane, *from);
        }
        for (at, block) in self.blocks.iter().zip(&self.rows.blocks) {
            let to = rows.blocks[*at].rows.range();
            for (to, from) in rows.rows[to].iter_mut().zip(&self.rows.rows[block.rows.range()]) {
                to.impulse.set_lane(lane, from.impulse);
            }
        }
    }
}
