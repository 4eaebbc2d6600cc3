//! Interval rows that are alone in their island: one update is the whole solution.

use super::dot::dot;
use super::pgs::Report;
use super::rows::{Rows, Set};
use crate::real::{Mask, Real};

impl<R: Real> Rows<R> {
    /// Lanes in which the blocks are one interval row.
    pub(super) fn alone(&self, blocks: &[usize]) -> R::Mask {
        let (mut count, mut interval) = (R::zero(), R::Mask::of(true));
        for block in blocks.iter().map(|b| &self.blocks[*b]) {
            count = R::select(block.mask, count + R::of(block.rows.len as f64), count);
            interval = interval.and(block.mask.not().or(R::Mask::of(block.set == Set::Interval)));
        }
        interval.and(count.le(R::one()))
    }

    /// Solves rows that are `alone`, each by its one update.
    pub(super) fn solve_alone(
        &mut self,
        dof_lists: &[usize],
        inv_d: &[R],
        blocks: &[usize],
        alone: R::Mask,
    ) {
        for b in blocks {
            let block = &self.blocks[*b];
            let mask = block.mask.and(alone);
            if mask.none() {
                continue;
            }
            let row = &mut self.rows[block.rows.start];
            let dofs = row.dofs.of(dof_lists);
            let y = &self.y[row.y..row.y + dofs.len()];
            let short = row.t - dot(dofs, y, &self.u) - row.c * row.impulse;
            let impulse = (row.impulse + short * row.inv_s).clamp(row.lo, row.hi);
            let change = impulse - row.impulse;
            row.impulse = R::select(mask, impulse, row.impulse);
            Self::kick(&mut self.u, inv_d, dofs, y, change, mask);
        }
    }

    /// The same where the whole system is one interval row. `exact`: one update solves it.
    pub fn solve_single(
        &mut self,
        dof_lists: &[usize],
        inv_d: &[R],
        exact: bool,
    ) -> Option<Report<R>> {
        let ([block], [_]) = (self.blocks.as_slice(), self.rows.as_slice()) else { return None };
        if block.set != Set::Interval {
            return None;
        }
        let mask = block.mask;
        self.solve_alone(dof_lists, inv_d, &[0], mask);
        let mut report = Report::new();
        report.sweeps = R::select(mask, R::one(), R::zero());
        report.updates = report.sweeps;
        report.open = R::Mask::of(!exact).and(mask);
        Some(report)
    }
}
