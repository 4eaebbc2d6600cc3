//! Derivatives of the minimiser: of D(u − û) = Σ yλ(y·u − t), see `solve/implicit.rs`.

use super::hessian::Pattern;
use super::system::System;
use crate::real::{Mask, Real};
use crate::solve::rows::{Rows, Set};

/// Newton steps of the derivatives: the first is exact but for the factors' rounding.
const STEPS: usize = 2;

impl<R: Real> System<R> {
    /// Gives u of a solution its derivatives; the numbers stay.
    pub fn settle(&mut self, pattern: &Pattern, blocks: &[usize], rows: &mut Rows<R>) {
        for u in &mut self.u {
            *u = u.constant();
        }
        for _ in 0..STEPS {
            self.laws(pattern, blocks, rows, R::Mask::of(true));
            self.zones(blocks, rows);
            self.slope(pattern, blocks, rows);
            self.direction(pattern, blocks, rows);
            for (u, step) in self.u.iter_mut().zip(&self.step) {
                *u = u.smooth(R::Mask::of(true), || *u + *step);
            }
        }
        for (k, u) in pattern.dofs.iter().zip(&self.u) {
            rows.u[*k] = *u;
        }
    }

    /// Which intervals are active, by the impulses that were found: −w/c is no match for
    /// them where c is tiny.
    fn zones(&mut self, blocks: &[usize], rows: &Rows<R>) {
        let mut at = 0;
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            for row in &rows.rows[block.rows.range()] {
                if block.set == Set::Interval {
                    let active = row.impulse.gt(row.lo).and(row.impulse.lt(row.hi));
                    let (free, inv_c) = (-self.w[at] * self.inv_c[at], self.inv_c[at]);
                    let bound = row.impulse.constant();
                    self.impulse[at] = R::select(active, free, bound);
                    self.curve[at][0] = R::select(active, inv_c, R::zero());
                }
                at += 1;
            }
        }
    }
}
