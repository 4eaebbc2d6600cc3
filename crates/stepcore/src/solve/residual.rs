//! The distance of impulses from a solution of the rows: the natural map.
//!
//! δ = λ − proj(λ − w̃/s), computed from the problem and not from a solver's bookkeeping;
//! s = A + c, one per cone (its largest). δ vanishes exactly at a solution. The scalar is max
//! |δ|√(A/m), a speed for linear and angular rows.

use super::cone::{across, project_box, project_round};
use super::dot::dot;
use super::rows::{Block, Row, Rows, Set, CONE, NARROW};
use crate::real::{Mask, Real};

impl<R: Real> Rows<R> {
    /// Returns w = J v + cλ − t of a row at the current impulses and u.
    pub fn slack(&self, dof_lists: &[usize], row: &Row<R>) -> R {
        let dofs = row.dofs.of(dof_lists);
        dot(dofs, &self.y[row.y..row.y + dofs.len()], &self.u) + row.c * row.impulse - row.t
    }

    /// Calls `each(row, δ, s)` for every row of a block.
    pub fn natural_map(
        &self,
        dof_lists: &[usize],
        block: &Block<R>,
        mut each: impl FnMut(usize, R, R),
    ) {
        let range = block.rows.range();
        let rows = &self.rows[range.clone()];
        if block.set == Set::Interval {
            for (at, row) in range.zip(rows) {
                let s = row.a + row.c;
                let moved = row.impulse - self.slack(dof_lists, row) * s.recip_or_zero();
                each(at, row.impulse - moved.clamp(row.lo, row.hi), s);
            }
            return;
        }
        if block.rows.len <= NARROW {
            self.cone_map::<NARROW>(dof_lists, block, each);
        } else {
            self.cone_map::<CONE>(dof_lists, block, each);
        }
    }

    fn cone_map<const N: usize>(
        &self,
        dof_lists: &[usize],
        block: &Block<R>,
        mut each: impl FnMut(usize, R, R),
    ) {
        let range = block.rows.range();
        let rows = &self.rows[range.clone()];
        let (mut w, mut impulse, mut s) = ([R::zero(); N], [R::zero(); N], R::zero());
        for (i, row) in rows.iter().enumerate() {
            w[i] = self.slack(dof_lists, row);
            impulse[i] = row.impulse;
            s = s.max(row.a + row.c);
        }
        w[0] += match block.set {
            Set::CoulombRound => block.mu * across(&w),
            Set::CoulombBox => block.mu * w[1..].iter().fold(R::zero(), |sum, w| sum + w.abs()),
            Set::Convex | Set::Interval => R::zero(),
        };
        let inv = s.recip_or_zero();
        let moved: [R; N] = crate::real::array::from_fn(|i| impulse[i] - w[i] * inv);
        let nearest = match block.set {
            Set::CoulombBox => project_box(block.mu, moved),
            _ => project_round(block.mu, moved),
        };
        for (i, at) in range.enumerate() {
            each(at, impulse[i] - nearest[i], s);
        }
    }

    /// Returns the scalar residual of one block [m/s]; 0 in lanes without it.
    pub fn block_residual(&self, dof_lists: &[usize], block: &Block<R>) -> R {
        let per_mass = R::one() / block.mass;
        let mut worst = R::zero();
        self.natural_map(dof_lists, block, |at, delta, _| {
            worst = worst.max(delta.abs() * (self.rows[at].a * per_mass).sqrt());
        });
        R::select(block.mask, worst, R::zero())
    }

    /// Returns the scalar residual of the listed blocks [m/s].
    pub fn residual_of(&self, dof_lists: &[usize], blocks: &[usize]) -> R {
        let mut worst = R::zero();
        for block in blocks.iter().map(|b| &self.blocks[*b]) {
            if block.mask.any() {
                worst = worst.max(self.block_residual(dof_lists, block));
            }
        }
        worst
    }

    /// Returns the scalar residual of all rows [m/s].
    pub fn residual(&self, dof_lists: &[usize]) -> R {
        let mut worst = R::zero();
        for block in &self.blocks {
            if block.mask.any() {
                worst = worst.max(self.block_residual(dof_lists, block));
            }
        }
        worst
    }
}
