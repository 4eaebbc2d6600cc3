//! The impulses that belong to a velocity: the inverse of each block's law.

use super::penalty::{interval, Cone};
use crate::real::{Mask, Real};
use crate::solve::rows::{Rows, Set, CONE, NARROW};

impl<R: Real> Rows<R> {
    /// Returns, by row, the impulse at the velocity u (factored). None if a law has no inverse: a
    /// Coulomb cone, or a row without a regulariser that something can move.
    pub(crate) fn impulses_at(&self, lists: &[usize], u: &[R]) -> Option<Vec<R>> {
        let mut impulses = vec![R::zero(); self.rows.len()];
        for block in self.blocks.iter().filter(|block| block.mask.any()) {
            let rows = &self.rows[block.rows.range()];
            let w: Vec<R> = rows.iter().map(|row| self.dot(lists, row, u) - row.t).collect();
            let own = &mut impulses[block.rows.range()];
            if rows.iter().any(|row| row.c.is_zero() && !row.a.is_zero()) {
                return None;
            }
            match block.set {
                Set::Interval => {
                    for ((impulse, row), w) in own.iter_mut().zip(rows).zip(w) {
                        *impulse = interval([row.lo, row.hi], row.c.recip_or_zero(), w).0;
                    }
                }
                Set::Convex if rows.len() <= NARROW => {
                    let all = padded::<R, NARROW>(&w);
                    own.copy_from_slice(&Cone::new(rows, block.mu).law(all).0[..rows.len()]);
                }
                Set::Convex => {
                    let all = padded::<R, CONE>(&w);
                    own.copy_from_slice(&Cone::new(rows, block.mu).law(all).0[..rows.len()]);
                }
                Set::CoulombRound | Set::CoulombBox => return None,
            }
        }
        Some(impulses)
    }
}

fn padded<R: Real, const N: usize>(w: &[R]) -> [R; N] {
    crate::real::array::from_fn(|i| w.get(i).copied().unwrap_or(R::zero()))
}
