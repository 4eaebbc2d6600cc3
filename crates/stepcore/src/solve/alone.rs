//! Interval rows that are alone in their island: one update is the whole solution.

use super::islands::row_count;
use super::limits::Report;
use super::rows::{Rows, Set};
use super::solver::Unconstrained;
use crate::real::{Count, Mask, Real};

impl<R: Real> Rows<R> {
    /// Lanes in which the blocks are one interval row.
    pub(super) fn alone(&self, blocks: &[usize]) -> R::Mask {
        let mut interval = R::Mask::of(true);
        for block in blocks.iter().map(|b| &self.blocks[*b]) {
            interval = interval.and(block.mask.not().or(R::Mask::of(block.set == Set::Interval)));
        }
        interval.and(row_count(self, blocks).at_most(1))
    }

    /// Solves rows that are `alone`, each by one update from no impulse and û: nothing of the last
    /// one is taken away again, whose rounding would stay.
    pub(super) fn solve_alone(&mut self, free: Unconstrained<R>, blocks: &[usize], alone: R::Mask) {
        for b in blocks {
            let mask = self.blocks[*b].mask.and(alone);
            if mask.any() {
                self.begin_afresh(free, *b, mask);
                self.update_alone(free, *b, mask);
            }
        }
    }

    /// One update of the row of a block.
    fn update_alone(&mut self, free: Unconstrained<R>, block: usize, mask: R::Mask) {
        let row = &mut self.rows[self.blocks[block].rows.start];
        let impulse = row.updated(row.short(free.dof_lists, &self.y, &self.u));
        let change = impulse - row.impulse;
        row.impulse = R::select(mask, impulse, row.impulse);
        let dofs = row.dofs.of(free.dof_lists);
        let y = &self.y[row.y..row.y + dofs.len()];
        Self::kick(&mut self.u, free.inv_d, dofs, y, change, mask);
    }

    /// Takes the impulse of a row that is alone away, in some lanes.
    fn begin_afresh(&mut self, free: Unconstrained<R>, block: usize, mask: R::Mask) {
        let row = &mut self.rows[self.blocks[block].rows.start];
        for k in row.dofs.of(free.dof_lists) {
            self.u[*k] = R::select(mask, free.guess[*k], self.u[*k]);
        }
        row.impulse = R::select(mask, R::zero(), row.impulse);
    }

    /// Sweeps that are exact are to leave lanes in which the whole system is one interval row as
    /// `solve_single` leaves these worlds alone.
    pub(super) fn begin_singles_afresh(&mut self, free: Unconstrained<R>) {
        let single = self.single();
        for b in 0..self.blocks.len() {
            let mask = self.blocks[b].mask.and(single);
            if mask.any() {
                self.begin_afresh(free, b, mask);
            }
        }
    }

    /// Lanes in which all blocks are one interval row.
    fn single(&self) -> R::Mask {
        let (mut interval, mut count) = (R::Mask::of(true), Count::ZERO);
        for block in &self.blocks {
            count.add(block.mask, block.rows.len as u64);
            if block.set != Set::Interval {
                interval = interval.and(block.mask.not());
            }
        }
        interval.and(count.at_most(1))
    }

    /// The same where the whole system is one interval row. `exact`: one update solves it.
    pub(super) fn solve_single(
        &mut self,
        free: Unconstrained<R>,
        exact: bool,
    ) -> Option<Report<R>> {
        let ([block], [_]) = (self.blocks.as_slice(), self.rows.as_slice()) else { return None };
        if block.set != Set::Interval {
            return None;
        }
        let mask = block.mask;
        if exact {
            self.solve_alone(free, &[0], mask);
        } else {
            self.update_alone(free, 0, mask);
        }
        let mut report = Report::new();
        report.sweeps.add(mask, 1);
        report.updates.add(mask, 1);
        report.open = R::Mask::of(!exact).and(mask);
        Some(report)
    }
}
