//! Interval rows that are alone in their island: one update is the whole solution.

use super::dot::dot;
use super::islands::row_count;
use super::limits::Report;
use super::rows::{Rows, Set};
use super::solver::Unconstrained;
use crate::real::{Mask, Real};

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

    /// Solves rows that are `alone`, each by its one update. `afresh`: from no impulse, where the one
    /// at hand has lost the digits.
    pub(super) fn solve_alone(
        &mut self,
        free: Unconstrained<R>,
        blocks: &[usize],
        (alone, afresh): (R::Mask, bool),
    ) {
        let Unconstrained { dof_lists, inv_d, guess } = free;
        for b in blocks {
            let block = &self.blocks[*b];
            let mask = block.mask.and(alone);
            if mask.none() {
                continue;
            }
            let row = &mut self.rows[block.rows.start];
            let dofs = row.dofs.of(dof_lists);
            let y = &self.y[row.y..row.y + dofs.len()];
            let update = |u: &[R], impulse: R| {
                let short = row.t - dot(dofs, y, u) - row.c * impulse;
                (impulse + short * row.inv_s).clamp(row.lo, row.hi)
            };
            let mut impulse = update(&self.u, row.impulse);
            let mut change = impulse - row.impulse;
            // The impulse of a motion that was broken off may be so large that u keeps nothing but
            // its rounding.
            let small = |x: R| (x * R::of(LOSES_DIGITS)).lt(change.abs());
            let asked = (row.velocity.abs() + row.t.abs()) * row.inv_s;
            let lost = mask.and(small(impulse.abs())).and(small(asked));
            if afresh && lost.seldom() {
                for k in dofs {
                    self.u[*k] = R::select(lost, guess[*k], self.u[*k]);
                }
                let afresh = update(guess, R::zero());
                (impulse, change) =
                    (R::select(lost, afresh, impulse), R::select(lost, afresh, change));
            }
            row.impulse = R::select(mask, impulse, row.impulse);
            Self::kick(&mut self.u, inv_d, dofs, y, change, mask);
        }
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
        // As a sweep would, which is made where another lane has more rows.
        self.solve_alone(free, &[0], (mask, false));
        let mut report = Report::new();
        report.sweeps.add(mask, 1);
        report.updates.add(mask, 1);
        report.open = R::Mask::of(!exact).and(mask);
        Some(report)
    }
}
