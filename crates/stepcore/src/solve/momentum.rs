//! Acceleration of Gauss-Seidel for convex rows: momentum, with its coefficients
//! chosen by exact minimisation instead of a formula.
//!
//! The rows minimise f(λ) = ½ λᵀ(A + C)λ + λ·(J v̂ − t) over their sets. After a sweep has moved λ
//! by p₀, with p₁ … p₃ the whole moves of the last sweeps, take λ + Σ τₐpₐ with the τ that minimise
//! f. While the active rows stay the same, this is close to conjugate gradients with a sweep as the
//! preconditioner. A step that leaves the sets is projected, and kept only if f falls.
//!
//! That needs no pass over the rows' J. A move p changes u by δu = D⁻¹Yᵀp, which is stored with it,
//! so that pᵀ(A + C)q = Σ D δu_p δu_q + Σ c p q; u follows λ by Σ τₐδuₐ, and only rows that the
//! projection changed are kicked. The slope of f along the sweep's move follows from the sweep:
//! with Δf, the gain of the sweep, it is Δf + ½ p₀ᵀ(A + C)p₀. Along older moves it is updated: a
//! move e changes it by pᵀ(A + C)e. (∇f·p = Σ D δu_p u + … would need no update, but δu has errors
//! as large as the rounding of u, however small the move.)
//!
//! So each u-move contains a few rounding errors of u, and a combination of moves inherits them.
//! They are counted, and a step with too many kicks every row.
//!
//! Blocks are visited in a pseudo-random order that changes from sweep to sweep. The order of two
//! blocks follows from their ranks alone, so that a lane does not depend on which other blocks its
//! neighbours have.

use super::cone::project_some;
use super::dot::dot;
use super::rows::{Row, Rows, Set, CONE};
use crate::real::{Mask, Real};
use crate::room::{listed, Room};

/// Directions of a step: the last sweep's move and the moves before it.
const DEPTH: usize = 4;
/// A move counts if it exceeds this many times the rounding of its coordinates.
const NOISE: f64 = 16.0;
/// Rounding errors of u that a step may add.
const ERRORS: f64 = 16.0;
/// Blocks are distributed over 2^BITS buckets by the hashes of their ranks.
const BITS: u32 = 4;

/// Impulses by row of the island, and u by dof of the island.
struct Point<R> {
    impulse: Vec<R>,
    u: Vec<R>,
}

impl<R> Room for Point<R> {
    fn room(&self) -> usize {
        listed(&self.impulse) + listed(&self.u)
    }
}

/// The last moves, newest first, in the same layout; zero where there is none yet. A row's moves
/// are adjacent: sums over rows keep their order, so that a lane equals its world, and sum all
/// moves at once.
type Moves<R> = Point<[R; DEPTH]>;

/// Blocks of neighbouring hashes, visited together.
struct Bucket {
    hash: u64,
    /// Its position in this sweep.
    key: u64,
    /// Into `Momentum::hashed`.
    start: usize,
    end: usize,
}

/// The method's memory for the current island.
pub(super) struct Momentum<R: Real> {
    moves: Moves<R>,
    /// pₐᵀ(A + C)p_b of the moves at the last step, b ≤ a.
    gram: [[R; DEPTH]; DEPTH],
    /// ∇f·pₐ at the current λ.
    slopes: [R; DEPTH],
    /// Rounding errors of u in each move.
    errors: [R; DEPTH],
    /// Impulses before the sweep; during a step, the proposed impulses.
    before: Point<R>,
    /// After the sweep.
    after: Point<R>,
    /// Row indices and dofs of the island, and D of each dof.
    rows: Vec<usize>,
    dofs: Vec<usize>,
    d: Vec<R>,
    /// Per dof: whether it is in `dofs`.
    seen: Vec<bool>,
    /// Blocks with their ranks, and the same by hash.
    ranked: Vec<(u32, usize)>,
    hashed: Vec<(u64, usize)>,
    buckets: Vec<Bucket>,
    /// The order of one sweep.
    visit: Vec<usize>,
}

room!(Momentum<R>: moves, gram, slopes, errors, before, after, rows, dofs, d, seen, ranked, hashed,
    buckets, visit);

impl<R> Point<R> {
    fn new() -> Self {
        Self { impulse: Vec::new(), u: Vec::new() }
    }
}

/// A step along the moves.
struct Step<R: Real> {
    tau: [R; DEPTH],
    /// Lanes in which u follows the moves; in others every row is kicked.
    linear: R::Mask,
}

/// Sums of weight · x · pₐ.
struct Products<R>([R; DEPTH]);

impl<R: Real> Products<R> {
    fn new() -> Self {
        Self([R::zero(); DEPTH])
    }

    #[inline(always)]
    fn add(&mut self, weighted: R, p: &[R; DEPTH]) {
        for (sum, p) in self.0.iter_mut().zip(p) {
            *sum += weighted * *p;
        }
    }
}

/// Σ τₐpₐ.
#[inline(always)]
fn along<R: Real>(tau: &[R; DEPTH], p: &[R; DEPTH]) -> R {
    (tau[0] * p[0] + tau[1] * p[1]) + (tau[2] * p[2] + tau[3] * p[3])
}

#[inline(always)]
fn nonzero<R: Real>(x: R) -> R::Mask {
    x.lt(R::zero()).or(x.gt(R::zero()))
}

/// Inserts the newest value at the front and drop the oldest.
#[inline(always)]
fn remember<R: Real>(p: &mut [R; DEPTH], newest: R) {
    *p = [newest, p[0], p[1], p[2]];
}

impl<R: Real> Momentum<R> {
    pub fn new() -> Self {
        Self {
            moves: Point::new(),
            gram: [[R::zero(); DEPTH]; DEPTH],
            slopes: [R::zero(); DEPTH],
            errors: [R::zero(); DEPTH],
            before: Point::new(),
            after: Point::new(),
            rows: Vec::new(),
            dofs: Vec::new(),
            d: Vec::new(),
            seen: Vec::new(),
            ranked: Vec::new(),
            hashed: Vec::new(),
            buckets: Vec::new(),
            visit: Vec::new(),
        }
    }

    /// Starts an island.
    pub fn begin(&mut self, dof_lists: &[usize], inv_d: &[R], rows: &Rows<R>, blocks: &[usize]) {
        self.rows.clear();
        self.dofs.clear();
        self.seen.resize(rows.u.len(), false);
        for at in blocks {
            let block = &rows.blocks[*at];
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
        // A sum's order must not depend on the blocks of other lanes.
        self.dofs.sort_unstable();
        self.d.clear();
        for k in &self.dofs {
            self.seen[*k] = false;
            self.d.push(R::one() / inv_d[*k]);
        }
        self.deal(blocks.iter().map(|at| (rows.blocks[*at].rank, *at)));
        self.gram = [[R::zero(); DEPTH]; DEPTH];
        self.slopes = [R::zero(); DEPTH];
        self.errors = [R::zero(); DEPTH];
        let (rows_len, dofs_len) = (self.rows.len(), self.dofs.len());
        for (moves, len) in [(&mut self.moves.impulse, rows_len), (&mut self.moves.u, dofs_len)] {
            moves.clear();
            moves.resize(len, [R::zero(); DEPTH]);
        }
        self.before.impulse.clear();
        self.before.impulse.extend(self.rows.iter().map(|r| rows.rows[*r].impulse));
        self.before.u.clear();
        self.before.u.extend(self.dofs.iter().map(|k| rows.u[*k]));
        self.after.impulse.resize(rows_len, R::zero());
        self.after.u.resize(dofs_len, R::zero());
    }

    /// Distribute blocks, given with their ranks, over buckets, unless they are unchanged.
    fn deal(&mut self, ranked: impl Iterator<Item = (u32, usize)> + Clone) {
        if ranked.clone().eq(self.ranked.iter().copied()) {
            return;
        }
        self.ranked.clear();
        self.ranked.extend(ranked);
        self.hashed.clear();
        let hashes = self.ranked.iter().map(|(rank, at)| (hash(u64::from(*rank)), *at));
        self.hashed.extend(hashes);
        self.hashed.sort_unstable();
        self.buckets.clear();
        for (at, (hash, _)) in self.hashed.iter().enumerate() {
            let hash = hash >> (64 - BITS);
            match self.buckets.last_mut() {
                Some(bucket) if bucket.hash == hash => bucket.end = at + 1,
                _ => self.buckets.push(Bucket { hash, key: 0, start: at, end: at + 1 }),
            }
        }
    }

    /// Returns the order of a sweep: the buckets in a new order, each forwards or backwards.
    pub fn order(&mut self, sweep: u32) -> &[usize] {
        for bucket in &mut self.buckets {
            bucket.key = hash(bucket.hash << 32 | u64::from(sweep));
        }
        self.buckets.sort_unstable_by_key(|bucket| bucket.key);
        self.visit.clear();
        for bucket in &self.buckets {
            let blocks = self.hashed[bucket.start..bucket.end].iter().map(|h| h.1);
            if bucket.key & 1 == 0 {
                self.visit.extend(blocks);
            } else {
                self.visit.extend(blocks.rev());
            }
        }
        &self.visit
    }

    /// After a sweep that made f fall by −`gain`, take the best step along the stored moves, in
    /// lanes of `todo`.
    pub fn step(
        &mut self,
        dof_lists: &[usize],
        inv_d: &[R],
        rows: &mut Rows<R>,
        blocks: &[usize],
        gain: R,
        todo: R::Mask,
    ) {
        let noise = self.measure(rows, blocks, gain);
        let step = self.best(noise);
        let change = self.propose(dof_lists, inv_d, rows, blocks, &step, todo);
        let keep = todo.and(change.le(R::zero()));
        let zero = R::zero();
        let own = self.commit(rows, blocks, keep);
        // ∇f·e at the end of e is Δf + ½ eᵀ(A + C)e.
        self.slopes[0] += R::select(keep, change, zero) + R::of(0.5) * own;
        let errors = R::select(step.linear, along(&step.tau.map(R::abs), &self.errors), R::one());
        self.errors[0] += R::select(keep, errors, zero);
    }

    /// Adds the sweep's move: products, slopes and errors of all moves at the current λ. Returns the
    /// energy of a move that is only rounding.
    fn measure(&mut self, rows: &Rows<R>, blocks: &[usize], gain: R) -> R {
        let (mut newest, mut second) = (Products::new(), Products::new());
        let (zero, mut energy) = (R::zero(), R::zero());
        let points = self.before.u.iter().zip(&mut self.after.u);
        for (((p, k), d), (old, new)) in
            self.moves.u.iter_mut().zip(&self.dofs).zip(&self.d).zip(points)
        {
            *new = rows.u[*k];
            remember(p, *new - *old);
            newest.add(*d * p[0], p);
            second.add(*d * p[1], p);
            energy = R::select(nonzero(p[0]), energy + *d * *new * *new, energy);
        }
        let mut start = 0;
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            let own = start..start + block.rows.len;
            start = own.end;
            let points = self.before.impulse[own.clone()].iter();
            let points = points.zip(&mut self.after.impulse[own.clone()]);
            let moves = self.moves.impulse[own].iter_mut();
            for ((p, row), (old, new)) in moves.zip(&rows.rows[block.rows.range()]).zip(points) {
                *new = row.impulse;
                remember(p, *new - *old);
                let c = R::select(block.mask, row.c, zero);
                newest.add(c * p[0], p);
                second.add(c * p[1], p);
                let more = energy + *new * *new * (row.a + row.c);
                energy = R::select(block.mask, more, energy);
            }
        }
        let (newest, second, last) = (newest.0, second.0, &self.gram);
        // The older moves' products come from the last step, shifted by one move.
        self.gram = [
            [newest[0], zero, zero, zero],
            [newest[1], second[1], zero, zero],
            [newest[2], second[2], last[1][1], zero],
            [newest[3], second[3], last[2][1], last[2][2]],
        ];
        remember(&mut self.slopes, gain - R::of(0.5) * newest[0]);
        for (slope, product) in self.slopes.iter_mut().zip(newest) {
            *slope += product;
        }
        remember(&mut self.errors, R::one());
        R::of((NOISE * R::epsilon()).powi(2)) * energy
    }

    /// Returns the τ that minimise f, by LDLᵀ; a move that depends on newer ones, or of which only
    /// rounding remains, gets 0.
    fn best(&self, noise: R) -> Step<R> {
        let zero = R::zero();
        let (mut h, mut rhs) = (self.gram, self.slopes.map(|slope| -slope));
        let real = h[0][0].gt(noise);
        // Below the diagonal h becomes L D, above it L.
        let mut inv = [zero; DEPTH];
        for a in 0..DEPTH {
            let own = noise.max(R::of(1e-8) * h[a][a]);
            for b in 0..a {
                for k in 0..b {
                    h[a][b] -= h[a][k] * h[k][b];
                }
                h[b][a] = h[a][b] * inv[b];
                h[a][a] -= h[a][b] * h[b][a];
                rhs[a] -= h[b][a] * rhs[b];
            }
            inv[a] = R::select(real.and(h[a][a].gt(own)), h[a][a].recip_or_zero(), zero);
        }
        let mut tau = [zero; DEPTH];
        for a in (0..DEPTH).rev() {
            let mut x = rhs[a] * inv[a];
            for b in a + 1..DEPTH {
                x -= h[a][b] * tau[b];
            }
            // The inverse of a subnormal product is not finite.
            tau[a] = R::select(inv[a].gt(zero).and(x.is_finite()), x, zero);
        }
        let linear = along(&tau.map(R::abs), &self.errors).le(R::of(ERRORS));
        Step { tau, linear }
    }

    /// Sets `before.impulse` to the projection of λ + Σ τ p, and u to its effect; returns the change
    /// of f.
    fn propose(
        &mut self,
        dof_lists: &[usize],
        inv_d: &[R],
        rows: &mut Rows<R>,
        blocks: &[usize],
        step: &Step<R>,
        todo: R::Mask,
    ) -> R {
        let (Rows { rows, blocks: all, y, u, .. }, tau) = (rows, &step.tau);
        for ((k, old), p) in self.dofs.iter().zip(&self.after.u).zip(&self.moves.u) {
            let way = along(tau, p);
            // A lane without rows on this dof keeps its value, even the sign of a zero.
            u[*k] = R::select(step.linear.and(nonzero(way)), *old + way, *old);
        }
        // Along the moves f, a quadratic, falls by half its slope.
        let fall = R::of(0.5) * along(tau, &self.slopes);
        let change = R::select(step.linear, fall, R::zero());
        let mask = todo;
        let mut landing = Landing { dof_lists, inv_d, y, u, linear: step.linear, mask, change };
        let mut start = 0;
        for block in blocks.iter().map(|b| &all[*b]) {
            let own = start..start + block.rows.len;
            start = own.end;
            landing.mask = block.mask.and(todo);
            let rows = rows[block.rows.range()].iter();
            let old = self.after.impulse[own.clone()].iter();
            let old = old.zip(&self.moves.impulse[own.clone()]);
            let out = self.before.impulse[own].iter_mut();
            if block.set == Set::Interval {
                for ((row, x), (old, p)) in rows.zip(out).zip(old) {
                    let free = *old + along(tau, p);
                    *x = landing.at(row, *old, free, free.clamp(row.lo, row.hi));
                }
                continue;
            }
            let mut free = [R::zero(); CONE];
            for (i, (old, p)) in old.clone().enumerate() {
                free[i] = *old + along(tau, p);
            }
            let ends = free.into_iter().zip(project_some(block.mu, free, block.rows.len));
            for (((row, x), (old, _)), (free, new)) in rows.zip(out).zip(old).zip(ends) {
                *x = landing.at(row, *old, free, new);
            }
        }
        landing.change
    }

    /// Move lanes of `keep` to the proposal, others back to the end of the sweep. Store the whole
    /// move, sweep and step, for the next sweeps. Returns eᵀ(A + C)e of the step e.
    fn commit(&mut self, rows: &mut Rows<R>, blocks: &[usize], keep: R::Mask) -> R {
        let (mut products, mut own) = (Products::new(), R::zero());
        let mut start = 0;
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            let range = start..start + block.rows.len;
            start = range.end;
            let points = self.before.impulse[range.clone()].iter_mut();
            let points = points.zip(&self.after.impulse[range.clone()]);
            let moves = self.moves.impulse[range].iter_mut();
            let rows = rows.rows[block.rows.range()].iter_mut();
            for ((p, row), (new, old)) in moves.zip(rows).zip(points) {
                *new = R::select(keep, *new, *old);
                row.impulse = *new;
                let e = *new - *old;
                let weighted = R::select(block.mask, row.c, R::zero()) * e;
                products.add(weighted, p);
                own += weighted * e;
                p[0] += e;
            }
        }
        let points = self.before.u.iter_mut().zip(&self.after.u);
        let moves = self.moves.u.iter_mut().zip(&self.dofs).zip(&self.d);
        for (((p, k), d), (new, old)) in moves.zip(points) {
            *new = R::select(keep, rows.u[*k], *old);
            rows.u[*k] = *new;
            let e = *new - *old;
            let weighted = *d * e;
            products.add(weighted, p);
            own += weighted * e;
            p[0] += e;
        }
        for (slope, product) in self.slopes.iter_mut().zip(products.0) {
            *slope += product;
        }
        own
    }
}

/// The final impulses of rows.
struct Landing<'a, R: Real> {
    dof_lists: &'a [usize],
    inv_d: &'a [R],
    y: &'a [R],
    u: &'a mut [R],
    linear: R::Mask,
    mask: R::Mask,
    /// Accumulated change of f.
    change: R,
}

impl<R: Real> Landing<'_, R> {
    /// Moves an impulse from `old` to `new`; u contains the effect of moving to `free` where the
    /// step is linear, and the remaining effect is added. Returns the impulse, `old` in lanes
    /// without the row.
    #[inline(always)]
    fn at(&mut self, row: &Row<R>, old: R, free: R, new: R) -> R {
        let from = R::select(self.linear, free, old);
        let rest = new - from;
        let off = self.mask.and(nonzero(rest));
        if off.any() {
            self.kick(row, from, rest, off);
        }
        R::select(self.mask, new, old)
    }

    fn kick(&mut self, row: &Row<R>, from: R, rest: R, mask: R::Mask) {
        let dofs = row.dofs.of(self.dof_lists);
        let w = dot(dofs, &self.y[row.y..row.y + dofs.len()], self.u) + row.c * from - row.t;
        let change = self.change + rest * (w + R::of(0.5) * (row.a + row.c) * rest);
        self.change = R::select(mask, change, self.change);
        Rows::kick(self.u, self.inv_d, dofs, &self.y[row.y..row.y + dofs.len()], rest, mask);
    }
}

/// The SplitMix64 mixing function.
fn hash(x: u64) -> u64 {
    let z = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}
