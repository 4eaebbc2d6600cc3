//! Acceleration of Gauss-Seidel for convex rows: momentum, with its coefficients
//! chosen by exact minimisation instead of a formula.
//!
//! The rows minimise f(λ) = ½ λᵀ(A + C)λ + λ·(J v̂ − t) over their sets. After a
//! sweep has moved λ by p₀, with p₁ … p₃ the whole moves of the last sweeps, take
//! λ + Σ τₐpₐ with the τ that minimise f: a system of four unknowns, whose matrix
//! pₐᵀ(A + C)p_b = Σ D δuₐδu_b + Σ c pₐp_b needs only vectors. Where the active rows
//! stay the same this comes close to conjugate gradients with a sweep as their
//! preconditioner. A step that leaves the sets is projected, and kept only if f falls.
//!
//! Blocks are visited in a pseudo-random order that changes from sweep to sweep.
//! Two blocks' order follows from their slots alone, so that a lane's does not
//! depend on which other blocks its neighbours have.

use super::cone::project_round;
use super::rows::{Rows, Set};
use crate::real::{Mask, Real};

/// Directions of a step: this sweep's move and the moves before it.
const DEPTH: usize = 4;
/// Blocks are dealt into 2^BITS heaps by their slots' hashes.
const BITS: u32 = 4;

/// Impulses by row of the island, and u by dof of the island.
struct Point<R> {
    impulse: Vec<R>,
    u: Vec<R>,
}

/// The last moves, newest first, in the same layout; zero where there is none yet.
type Moves<R> = Point<[R; DEPTH]>;

/// The method's memory for the island at hand.
pub(super) struct Momentum<R: Real> {
    moves: Moves<R>,
    /// Before the sweep; while a step is made, the proposed impulses.
    before: Point<R>,
    /// After the sweep.
    after: Point<R>,
    /// w of every row after the sweep.
    w: Vec<R>,
    /// Row indices and dofs of the island, and D of each dof.
    rows: Vec<usize>,
    dofs: Vec<usize>,
    d: Vec<R>,
    /// By dof: already in `dofs`.
    seen: Vec<bool>,
    /// Blocks by hash, in heaps of (hash, first, one past the last).
    hashed: Vec<(u64, usize)>,
    heaps: Vec<(u64, usize, usize)>,
    /// The order of one sweep.
    visit: Vec<usize>,
}

impl<R> Point<R> {
    fn new() -> Self {
        Self { impulse: Vec::new(), u: Vec::new() }
    }
}

impl<R: Real> Point<R> {
    fn take(&mut self, rows: &Rows<R>, list: &[usize], dofs: &[usize]) {
        self.impulse.clear();
        self.impulse.extend(list.iter().map(|r| rows.rows[*r].impulse));
        self.u.clear();
        self.u.extend(dofs.iter().map(|k| rows.u[*k]));
    }
}

impl<R: Real> Momentum<R> {
    pub fn new() -> Self {
        Self {
            moves: Point::new(),
            before: Point::new(),
            after: Point::new(),
            w: Vec::new(),
            rows: Vec::new(),
            dofs: Vec::new(),
            d: Vec::new(),
            seen: Vec::new(),
            hashed: Vec::new(),
            heaps: Vec::new(),
            visit: Vec::new(),
        }
    }

    /// Starts on an island.
    pub fn begin(&mut self, dof_lists: &[usize], inv_d: &[R], rows: &Rows<R>, blocks: &[usize]) {
        self.rows.clear();
        self.dofs.clear();
        self.hashed.clear();
        self.seen.resize(rows.u.len(), false);
        for at in blocks {
            let block = &rows.blocks[*at];
            self.hashed.push((hash(u64::from(block.slot)), *at));
            self.rows.extend(block.rows.range());
            for row in &rows.rows[block.rows.range()] {
                for k in row.dofs.of(dof_lists) {
                    if !self.seen[*k] {
                        self.seen[*k] = true;
                        self.dofs.push(*k);
                    }
                }
            }
        }
        // A sum's order must not depend on the blocks that other lanes have.
        self.dofs.sort_unstable();
        self.d.clear();
        for k in &self.dofs {
            self.seen[*k] = false;
            self.d.push(R::one() / inv_d[*k]);
        }
        self.hashed.sort_unstable();
        self.heaps.clear();
        let mut start = 0;
        while start < self.hashed.len() {
            let heap = self.hashed[start].0 >> (64 - BITS);
            let len =
                self.hashed[start..].iter().take_while(|h| h.0 >> (64 - BITS) == heap).count();
            self.heaps.push((heap, start, start + len));
            start += len;
        }
        for (moves, len) in
            [(&mut self.moves.impulse, self.rows.len()), (&mut self.moves.u, self.dofs.len())]
        {
            moves.clear();
            moves.resize(len, [R::zero(); DEPTH]);
        }
        self.before.take(rows, &self.rows, &self.dofs);
    }

    /// The order of a sweep: the heaps in a new order, each forwards or backwards.
    pub fn order(&mut self, sweep: u32) -> &[usize] {
        let key = |heap: u64| hash(heap << 32 | u64::from(sweep));
        self.heaps.sort_unstable_by_key(|heap| key(heap.0));
        self.visit.clear();
        for (heap, start, end) in &self.heaps {
            let blocks = self.hashed[*start..*end].iter().map(|h| h.1);
            if key(*heap) & 1 == 0 {
                self.visit.extend(blocks);
            } else {
                self.visit.extend(blocks.rev());
            }
        }
        &self.visit
    }

    /// After a sweep: the best step along the remembered moves, in lanes of `live`.
    pub fn step(
        &mut self,
        dof_lists: &[usize],
        z: &[R],
        rows: &mut Rows<R>,
        blocks: &[usize],
        live: R::Mask,
    ) {
        self.after.take(rows, &self.rows, &self.dofs);
        self.remember();
        self.w.clear();
        let mut held = R::zero();
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            for row in &rows.rows[block.rows.range()] {
                self.w.push(R::select(block.mask, rows.slack(dof_lists, row), R::zero()));
                let energy = held + row.impulse * row.impulse * (row.a + row.c);
                held = R::select(block.mask, energy, held);
            }
        }
        let tau = self.coefficients(rows, held);
        self.propose(rows, blocks, &tau);
        let keep = live.and(self.falls(dof_lists, z, rows, blocks));
        // The whole move, sweep and step, is what the next sweeps remember.
        for (at, r) in self.rows.iter().enumerate() {
            let old = self.after.impulse[at];
            let new = R::select(keep, self.before.impulse[at], old);
            rows.rows[*r].impulse = new;
            self.moves.impulse[at][0] += new - old;
        }
        for (at, k) in self.dofs.iter().enumerate() {
            let old = self.after.u[at];
            rows.u[*k] = R::select(keep, rows.u[*k], old);
            self.moves.u[at][0] += rows.u[*k] - old;
        }
        self.before.take(rows, &self.rows, &self.dofs);
    }

    /// Makes the sweep's own move the newest one.
    fn remember(&mut self) {
        let (before, after) = (&self.before, &self.after);
        let shift = |moves: &mut [[R; DEPTH]], before: &[R], after: &[R]| {
            for ((p, old), new) in moves.iter_mut().zip(before).zip(after) {
                p.rotate_right(1);
                p[0] = *new - *old;
            }
        };
        shift(&mut self.moves.impulse, &before.impulse, &after.impulse);
        shift(&mut self.moves.u, &before.u, &after.u);
    }

    /// The τ that minimise f, by LDLᵀ; a move that depends on newer ones gets 0.
    /// `held`, the energy of the impulses, says what is rounding.
    fn coefficients(&self, rows: &Rows<R>, held: R) -> [R; DEPTH] {
        let zero = R::zero();
        let (mut h, mut rhs) = ([[zero; DEPTH]; DEPTH], [zero; DEPTH]);
        let mut add = |p: &[R; DEPTH], k: R| {
            for a in 0..DEPTH {
                let scaled = k * p[a];
                for b in 0..=a {
                    h[a][b] += scaled * p[b];
                }
            }
        };
        for (p, d) in self.moves.u.iter().zip(&self.d) {
            add(p, *d);
        }
        for ((p, r), w) in self.moves.impulse.iter().zip(&self.rows).zip(&self.w) {
            add(p, rows.rows[*r].c);
            for a in 0..DEPTH {
                rhs[a] -= p[a] * *w;
            }
        }
        // A sweep's move at rounding has no direction.
        let real = h[0][0].gt(R::of(4.0 * R::EPSILON * R::EPSILON) * held);
        // Below the diagonal h becomes L D, above it L.
        let mut inv = [zero; DEPTH];
        for a in 0..DEPTH {
            let own = h[a][a];
            for b in 0..a {
                for k in 0..b {
                    h[a][b] -= h[a][k] * h[k][b];
                }
                h[b][a] = h[a][b] * inv[b];
                h[a][a] -= h[a][b] * h[b][a];
                rhs[a] -= h[b][a] * rhs[b];
            }
            inv[a] =
                R::select(real.and(h[a][a].gt(R::of(1e-8) * own)), h[a][a].recip_or_zero(), zero);
        }
        let mut tau = [zero; DEPTH];
        for a in (0..DEPTH).rev() {
            let mut x = rhs[a] * inv[a];
            for b in a + 1..DEPTH {
                x -= h[a][b] * tau[b];
            }
            tau[a] = R::select(inv[a].gt(zero), x, zero);
        }
        tau
    }

    /// Sets `before.impulse` to the projection of λ + Σ τ p.
    fn propose(&mut self, rows: &Rows<R>, blocks: &[usize], tau: &[R; DEPTH]) {
        let out = &mut self.before.impulse;
        for ((x, old), p) in out.iter_mut().zip(&self.after.impulse).zip(&self.moves.impulse) {
            *x = *old + (tau[0] * p[0] + tau[1] * p[1] + tau[2] * p[2] + tau[3] * p[3]);
        }
        let mut at = 0;
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            let own = &mut out[at..at + block.rows.len];
            at += block.rows.len;
            if block.set == Set::Interval {
                for (x, row) in own.iter_mut().zip(&rows.rows[block.rows.range()]) {
                    *x = x.clamp(row.lo, row.hi);
                }
                continue;
            }
            let mut x = [R::zero(); 3];
            x.iter_mut().zip(own.iter()).for_each(|(x, own)| *x = *own);
            let x = project_round(block.mu, x);
            own.iter_mut().zip(x).for_each(|(own, x)| *own = x);
        }
    }

    /// Gives u the proposal's effect; lanes in which f falls:
    /// Δf = Σ e(w + ½ c e) + ½ Σ D δu², e the change from after the sweep.
    fn falls(&self, dof_lists: &[usize], z: &[R], rows: &mut Rows<R>, blocks: &[usize]) -> R::Mask {
        let half = R::of(0.5);
        let Rows { rows, blocks: all, u, .. } = rows;
        let (mut at, mut change) = (0, R::zero());
        for block in blocks.iter().map(|b| &all[*b]) {
            for row in &rows[block.rows.range()] {
                let e = self.before.impulse[at] - self.after.impulse[at];
                let e = R::select(block.mask, e, R::zero());
                change += e * (self.w[at] + half * row.c * e);
                let dofs = row.dofs.of(dof_lists);
                for (k, z) in dofs.iter().zip(&z[row.y..row.y + dofs.len()]) {
                    let new = u[*k] + *z * e;
                    u[*k] = R::select(block.mask, new, u[*k]);
                }
                at += 1;
            }
        }
        for ((k, old), d) in self.dofs.iter().zip(&self.after.u).zip(&self.d) {
            let e = u[*k] - *old;
            change += half * e * e * *d;
        }
        change.le(R::zero())
    }
}

/// SplitMix64's mixing of one number.
fn hash(x: u64) -> u64 {
    let z = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}
