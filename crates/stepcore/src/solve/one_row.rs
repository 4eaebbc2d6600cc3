//! Interval rows that are alone in their island: one update is the whole solution.

use super::islands::{alive, intervals_at_most};
use super::limits::Report;
use super::rows::Rows;
use super::solver::Unconstrained;
use crate::real::{Count, Mask, Real};

impl<R: Real> Rows<R> {
    /// Solves the blocks of an island with one update in lanes in which they are one interval row.
    /// If that is `exact`, start from zero impulse and û: no previous impulse is subtracted, which
    /// would leave rounding. Returns these lanes.
    pub(super) fn solve_one_row(
        &mut self,
        free: Unconstrained<R>,
        blocks: &[usize],
        exact: bool,
        report: &mut Report<R>,
    ) -> R::Mask {
        let single = intervals_at_most(self, blocks, 1);
        if single.none() {
            return single;
        }
        for b in blocks {
            let mask = self.blocks[*b].mask.and(single);
            if mask.none() {
                continue;
            }
            let row = &mut self.rows[self.blocks[*b].rows.start];
            let dofs = row.dofs.of(free.dof_lists);
            if exact {
                row.impulse = R::select(mask, R::zero(), row.impulse);
                dofs.iter().for_each(|k| self.u[*k] = R::select(mask, free.guess[*k], self.u[*k]));
            }
            let impulse = row.updated(row.short(free.dof_lists, &self.y, &self.u));
            let change = impulse - row.impulse;
            row.impulse = R::select(mask, impulse, row.impulse);
            let y = &self.y[row.y..row.y + dofs.len()];
            Self::kick(&mut self.u, free.inv_d, dofs, y, change, mask);
        }
        let (mine, mut once) = (single.and(alive(self, blocks)), Count::ZERO);
        once.add(mine, 1);
        report.sweeps.raise(&once);
        report.updates.add(mine, 1);
        single
    }
}
