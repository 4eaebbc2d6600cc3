//! Interval rows that are alone in their island: one update is the whole solution.

use super::dot::dot;
use super::islands::row_count;
use super::limits::Report;
use super::rows::{Rows, Set};
use crate::real::{Mask, Real};

impl<R: Real> Rows<R> {
    /// Lanes in which the blocks are one interval row.
    pub(super) fn alone(&self, blocks: &[usize]) -> R::Mask {
        let mut interval = R::Mask::of(true);
        for block in blocks.iter().map(|b| &self.blocks[*b]) {
            interval = interval.and(block.mask.not().or(R::Mask::of(block.set == Set::Interval)));
        }
        interval.and(row_count(self, blocks).at_most(1))
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
        report.sweeps.add(mask, 1);
        report.updates.add(mask, 1);
        report.open = R::Mask::of(!exact).and(mask);
        Some(report)
    }
}
