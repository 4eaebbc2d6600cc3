//! Interval rows that are alone in their island: one update is the whole solution.

use super::islands::row_count;
use super::limits::Report;
use super::rows::{Rows, Set};
use super::solver::Unconstrained;
use crate::real::{Count, Mask, Real};

/// An impulse that changes by so many times what is left of it, and a velocity by so many times what is
/// asked of it, lose digits.
const LOSES_DIGITS: f64 = 1024.0;

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
    pub(super) fn solve_alone(&mut self, free: Unconstrained<R>, blocks: &[usize], alone: R::Mask) {
        for b in blocks {
            let mask = self.blocks[*b].mask.and(alone);
            if mask.none() {
                continue;
            }
            let (mut impulse, mut lost) = self.update_alone(free, *b);
            lost = mask.and(lost);
            if lost.any() {
                self.begin_afresh(free, *b, lost);
                (impulse, _) = self.update_alone(free, *b);
            }
            let row = &mut self.rows[self.blocks[*b].rows.start];
            let change = impulse - row.impulse;
            row.impulse = R::select(mask, impulse, row.impulse);
            let dofs = row.dofs.of(free.dof_lists);
            let y = &self.y[row.y..row.y + dofs.len()];
            Self::kick(&mut self.u, free.inv_d, dofs, y, change, mask);
        }
    }

    /// The impulse of the row of a block after an update, and where so much of the last one is taken
    /// away that u keeps nothing but its rounding, as that of a motion which was broken off.
    fn update_alone(
        &self,
        Unconstrained { dof_lists, .. }: Unconstrained<R>,
        block: usize,
    ) -> (R, R::Mask) {
        let row = &self.rows[self.blocks[block].rows.start];
        let impulse = row.updated(row.short(dof_lists, &self.y, &self.u));
        let (old, zero) = (row.impulse, R::zero());
        if old.lt(zero).or(zero.lt(old)).none() {
            // There is nothing to take away, which the list of a step knows.
            return (impulse, R::Mask::of(false));
        }
        let change = (impulse - row.impulse).abs();
        let small = |x: R| (x * R::of(LOSES_DIGITS)).lt(change);
        let asked = (row.velocity.abs() + row.t.abs()) * row.inv_s;
        (impulse, small(impulse.abs()).and(small(asked)))
    }

    /// Takes the impulse of a row that is alone away, in some lanes.
    fn begin_afresh(&mut self, free: Unconstrained<R>, block: usize, lost: R::Mask) {
        let row = &mut self.rows[self.blocks[block].rows.start];
        for k in row.dofs.of(free.dof_lists) {
            self.u[*k] = R::select(lost, free.guess[*k], self.u[*k]);
        }
        row.impulse = R::select(lost, R::zero(), row.impulse);
    }

    /// Sweeps are to leave lanes in which the whole system is one interval row as `solve_single`
    /// leaves these worlds alone.
    pub(super) fn begin_singles_afresh(&mut self, free: Unconstrained<R>) {
        let single = self.single();
        for b in 0..self.blocks.len() {
            let mask = self.blocks[b].mask.and(single);
            if mask.none() {
                continue;
            }
            let lost = mask.and(self.update_alone(free, b).1);
            if lost.any() {
                self.begin_afresh(free, b, lost);
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
        self.solve_alone(free, &[0], mask);
        let mut report = Report::new();
        report.sweeps.add(mask, 1);
        report.updates.add(mask, 1);
        report.open = R::Mask::of(!exact).and(mask);
        Some(report)
    }
}
