//! Noslip: friction solved again without a regulariser, after the main solve.
//!
//! MuJoCo's post-processing (documentation, "Algorithms", NoSlip): sweeps over the friction rows
//! alone with c = 0, while what carries load holds its impulse. A cone keeps its normal impulse and
//! has friction within μ times that; of a pyramid each pair of opposite edges keeps its sum; a
//! friction loss keeps its bounds. What comes out solves no one problem, and normals feel what
//! friction has changed only in the next step.

use super::cone::{times, InBall};
use super::dot::dot;
use super::rows::{Block, Row, Rows, Set, CONE, NARROW};
use crate::elements::Role;
use crate::error::{Error, Result};
use crate::interrupt::ends_after;
use crate::real::{Mask, Real};
use core::array::from_fn;

/// What friction rows hold beside others.
#[derive(Clone, Copy, PartialEq)]
enum Friction {
    None,
    /// Every row by itself.
    Loss,
    /// Rows 2k and 2k + 1 are opposite edges; what is left over is no friction.
    Edges,
    /// Row 0 is the normal.
    Cone,
}

fn friction<R: Real>(block: &Block<R>) -> Friction {
    match (block.set, block.role) {
        (Set::Convex, _) => Friction::Cone,
        (Set::Interval, Role::Loss) => Friction::Loss,
        (Set::Interval, Role::Contact) if block.rows.len > 1 => Friction::Edges,
        _ => Friction::None,
    }
}

impl<R: Real> Rows<R> {
    /// Sweeps over the friction rows, from the impulses that the rows hold; `u` must hold their
    /// effect, and does so again afterwards. What the main solve gave is kept for the next start.
    pub fn noslip(&mut self, dof_lists: &[usize], inv_d: &[R], sweeps: u32) -> Result<()> {
        self.main.clear();
        self.main.extend(self.rows.iter().map(|row| row.impulse));
        let Self { rows, blocks, y, u, .. } = self;
        for sweep in 0..sweeps {
            if ends_after(sweep) {
                return Err(Error::Interrupted);
            }
            for block in blocks.iter().filter(|block| block.mask.any()) {
                let kind = friction(block);
                let mut sweep = Hard { dof_lists, inv_d, y, u, mask: block.mask };
                let own = &mut rows[block.rows.range()];
                match kind {
                    Friction::None => {}
                    Friction::Loss => own.iter_mut().for_each(|row| sweep.loss(row)),
                    Friction::Edges => {
                        for pair in own.chunks_exact_mut(2) {
                            let [one, other] = pair else { continue };
                            sweep.edges(one, other);
                        }
                    }
                    Friction::Cone if own.len() > NARROW => {
                        sweep.cone::<{ CONE - 1 }>(own, block.mu)
                    }
                    Friction::Cone => sweep.cone::<{ NARROW - 1 }>(own, block.mu),
                }
            }
        }
        Ok(())
    }
}

/// What an update reads and writes.
struct Hard<'a, R: Real> {
    dof_lists: &'a [usize],
    inv_d: &'a [R],
    y: &'a [R],
    u: &'a mut [R],
    mask: R::Mask,
}

impl<R: Real> Hard<'_, R> {
    fn y_of(&self, row: &Row<R>) -> &[R] {
        &self.y[row.y..row.y + row.dofs.len]
    }

    /// J v − t.
    fn miss(&self, row: &Row<R>) -> R {
        dot(row.dofs.of(self.dof_lists), self.y_of(row), self.u) - row.t
    }

    /// J H⁻¹ Jᵀ between two rows of one block.
    fn between(&self, one: &Row<R>, other: &Row<R>) -> R {
        let dofs = one.dofs.of(self.dof_lists).iter();
        let both = dofs.zip(self.y_of(one).iter().zip(self.y_of(other)));
        both.fold(R::zero(), |sum, (k, (p, q))| sum + *p * self.inv_d[*k] * *q)
    }

    fn set(&mut self, row: &mut Row<R>, impulse: R) {
        let change = impulse - row.impulse;
        row.impulse = R::select(self.mask, impulse, row.impulse);
        let y = &self.y[row.y..row.y + row.dofs.len];
        Rows::kick(self.u, self.inv_d, row.dofs.of(self.dof_lists), y, change, self.mask);
    }

    fn loss(&mut self, row: &mut Row<R>) {
        let impulse = row.impulse - self.miss(row) * row.a.recip_or_zero();
        self.set(row, impulse.clamp(row.lo, row.hi));
    }

    /// The sum of both edges is load, and stays; an edge that nothing opposes is half of it.
    fn edges(&mut self, one: &mut Row<R>, other: &mut Row<R>) {
        // Unfolded: the first is a tangent by itself, the second its load (`elements/contact.rs`).
        let alone = one.lo.lt(R::zero());
        let bend = one.a + other.a - (self.between(one, other) + self.between(one, other));
        let apart = self.miss(one) - self.miss(other);
        let sum = one.impulse + other.impulse;
        let still = bend.le(R::zero());
        let half = R::of(0.5) * sum;
        let moved = (one.impulse - apart * bend.recip_or_zero()).clamp(R::zero(), sum);
        let first = R::select(still, half, moved);
        let tangent = one.impulse - self.miss(one) * one.a.recip_or_zero();
        let second = R::select(alone, other.impulse, sum - first);
        self.set(one, R::select(alone, tangent, first));
        self.set(other, second);
    }

    /// The least ½ xᵀA x + g·x with |x| ≤ μ λ_n.
    fn cone<const N: usize>(&mut self, own: &mut [Row<R>], mu: R) {
        let Some((normal, ways)) = own.split_first_mut() else { return };
        let bound = mu * normal.impulse;
        let zero = R::zero();
        let (mut q, mut g, mut x) = ([[zero; N]; N], [zero; N], [zero; N]);
        for (i, row) in ways.iter().enumerate() {
            for (j, other) in ways[..=i].iter().enumerate() {
                q[i][j] = self.between(row, other);
                q[j][i] = q[i][j];
            }
            (g[i], x[i]) = (self.miss(row), row.impulse);
        }
        let held = times(&q, &x);
        let solved = InBall::new(q).least(&from_fn(|i| g[i] - held[i]), bound, self.mask);
        for (row, x) in ways.iter_mut().zip(solved) {
            self.set(row, x);
        }
    }
}
