//! Islands that the sweeps of `auto` leave unsolved: a proximal method on their impulses.
//!
//! If a light body is under one a million times heavier, each sweep corrects only a millionth of
//! its missing impulse. Each round here solves a problem that Newton's method (`newton.rs`) is
//! certain to solve; the next round removes the terms that make it so:
//!
//! ```text
//! w = J v + cλ + r(λ − λₖ) + (μ|w_t|ₖ, 0, 0) − t,      λ ∈ K,  w ∈ K*,  λ·w = 0
//! ```
//!
//! - r, a share of A, replaces the regulariser that rows of `rigid` lack. λₖ are the impulses of
//!   the round before, so r has no effect at a solution (Rockafellar 1976). Redundant impulses,
//!   such as with four contacts where three suffice, stay as the sweeps left them.
//! - μ|w_t|ₖ is the sliding of the round before. It makes a Coulomb cone convex, with the same
//!   solution (De Saxcé & Feng 1998).
//! - The box |λ_i| ≤ μ λ_n is the cone of its corners: rows J_n ± μ J_1 ± μ J_2 of impulses ≥ 0.
//!
//! The round with the least residual is kept, if that is less than the residual of the sweeps.

use super::cone::across;
use super::islands::row_count;
use super::limits::{Limits, Report};
use super::newton::Newton;
use super::pgs::reachable;
use super::rows::{Block, Row, Rows, Set, CONE};
use super::solver::Unconstrained;
use crate::model::Span;
use crate::real::{Mask, Real};

/// r relative to A: 2⁻²³, and 2⁻¹¹ in f32. A smaller one converges in fewer rounds, each of which
/// loses more digits: among r = 1e-5, 1e-7 and 1e-8 the second solved most stacks of 1 g under 1 t.
const SHARE: f64 = 1.0 / (1u64 << 23) as f64;
const SHARE_F32: f64 = 1.0 / (1u64 << 11) as f64;
/// The most rounds, and the most that may bring no progress.
const ROUNDS: usize = 64;
const IDLE: f64 = 12.0;
/// Newton's iterations per round; most rounds take less than ten.
const ITERATIONS: u32 = 50;
/// Larger islands are left as they are: their rounds would take a hundred times as long as the
/// sweeps.
const MOST: u64 = 512;

/// The method's memory.
pub(super) struct Proximal<R: Real> {
    /// The convex problem.
    convex: Rows<R>,
    /// Per block of the convex problem: the original block.
    of: Vec<usize>,
    /// Per row of the island: the impulses of the best round.
    best: Vec<R>,
}

room!(Proximal<R>: convex, of, best);

impl<R: Real> Proximal<R> {
    pub fn new() -> Self {
        Self { convex: Rows::bare(0), of: Vec::new(), best: Vec::new() }
    }

    /// Solves the blocks of one island in the lanes `mine`; returns the unsolved lanes.
    pub fn solve(
        &mut self,
        (newton, limits): (&mut Newton<R>, Limits),
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
        (blocks, weight): (&[usize], &[R]),
        mine: R::Mask,
        report: &mut Report<R>,
    ) -> R::Mask {
        let small: R::Mask = row_count(rows, blocks).at_most(MOST);
        let (mut todo, large) = (mine.and(small), mine.and(small.not()));
        if todo.none() {
            return mine;
        }
        self.take(free, rows, blocks, todo);
        let mut least = rows.residual_of(free.dof_lists, blocks);
        self.keep(rows, blocks, R::Mask::of(true));
        let (zero, mut idle) = (R::zero(), R::zero());
        let within = Limits { sweeps: ITERATIONS, tolerance: 0.0, ..limits };
        for _ in 0..ROUNDS {
            self.pose(free, rows, todo);
            let Ok(done) = newton.solve(free, &mut self.convex, within) else { break };
            report.updates.add_each(todo, &done.updates);
            self.give(rows, todo);
            follow(free, rows, blocks, todo);
            let residual = rows.residual_of(free.dof_lists, blocks);
            let better = todo.and(residual.lt(least));
            self.keep(rows, blocks, better);
            least = R::select(better, residual, least);
            idle = R::select(better, zero, idle + R::one());
            let enough = reachable(free.dof_lists, rows, weight, blocks, limits);
            todo = todo.and(least.le(enough).not()).and(idle.lt(R::of(IDLE)));
            if todo.none() {
                break;
            }
        }
        self.restore(rows, blocks, mine.and(small));
        follow(free, rows, blocks, mine.and(small));
        let enough = reachable(free.dof_lists, rows, weight, blocks, limits);
        large.or(mine.and(small).and(least.le(enough).not()))
    }

    /// Builds the convex problem's rows: their y, and the initial impulses.
    fn take(&mut self, free: Unconstrained<R>, rows: &Rows<R>, blocks: &[usize], mine: R::Mask) {
        let convex = &mut self.convex;
        convex.clear();
        convex.u.clear();
        convex.u.extend_from_slice(&rows.u);
        self.of.clear();
        for at in blocks {
            let block = &rows.blocks[*at];
            let mask = block.mask.and(mine);
            if mask.none() {
                continue;
            }
            self.of.push(*at);
            let own = &rows.rows[block.rows.range()];
            let start = convex.rows.len();
            if block.set == Set::CoulombBox {
                corners(free, convex, rows, block);
            } else {
                for row in own {
                    let y = convex.y.len();
                    convex.y.extend_from_slice(&rows.y[row.y..][..row.dofs.len]);
                    convex.rows.push(Row { y, ..row.clone() });
                }
            }
            let set = match block.set {
                Set::CoulombRound | Set::Convex => Set::Convex,
                Set::CoulombBox | Set::Interval => Set::Interval,
            };
            let rows = Span { start, len: convex.rows.len() - start };
            convex.blocks.push(Block { rows, set, mask, island: 0, ..block.clone() });
        }
    }

    /// Set targets and regularisers of a round.
    fn pose(&mut self, free: Unconstrained<R>, rows: &Rows<R>, todo: R::Mask) {
        let share = R::of(if R::epsilon() < 1e-10 { SHARE } else { SHARE_F32 });
        let Self { convex, of, .. } = self;
        convex.u.copy_from_slice(&rows.u);
        for (block, at) in convex.blocks.iter_mut().zip(of) {
            block.mask = block.mask.and(todo);
            let source = &rows.blocks[*at];
            let own = &rows.rows[source.rows.range()];
            let posed = &mut convex.rows[block.rows.range()];
            if source.set == Set::Interval {
                for (row, own) in posed.iter_mut().zip(own) {
                    let r = share * own.a;
                    row.c = own.c + r;
                    row.t = own.t + r * own.impulse;
                    row.inv_s = (row.a + row.c).recip_or_zero();
                    row.impulse = own.impulse;
                }
                continue;
            }
            let (mut w, mut t) = ([R::zero(); CONE], [R::zero(); CONE]);
            let (mut a, mut c) = (R::zero(), R::zero());
            for (i, own) in own.iter().enumerate() {
                (w[i], t[i]) = (rows.slack(free.dof_lists, own), own.t);
                (a, c) = (a.max(own.a), c.max(own.c));
            }
            t[0] -= match source.set {
                Set::CoulombRound => source.mu * across(&w),
                Set::CoulombBox => source.mu * sum(&w[1..]),
                Set::Convex | Set::Interval => R::zero(),
            };
            if source.set == Set::CoulombBox {
                // Corners with equal impulses have Σ cf = c of the normal.
                let c = share * a + R::of(posed.len() as f64) * c;
                for (corner, row) in posed.iter_mut().enumerate() {
                    let along = |x: &dyn Fn(usize) -> R| {
                        let ways = (1..own.len()).map(|i| sign::<R>(corner, i) * x(i));
                        ways.fold(R::zero(), |sum, x| sum + x)
                    };
                    let held = own[0].c * own[0].impulse
                        + source.mu * along(&|i| own[i].c * own[i].impulse);
                    row.t = t[0] + source.mu * along(&|i| t[i]) + c * row.impulse - held;
                    row.c = c;
                    row.inv_s = (row.a + c).recip_or_zero();
                }
            } else {
                let c = share * a + c;
                for (i, (row, own)) in posed.iter_mut().zip(own).enumerate() {
                    row.t = t[i] + c * own.impulse - own.c * own.impulse;
                    row.c = c;
                    row.inv_s = (row.a + c).recip_or_zero();
                    row.impulse = own.impulse;
                }
            }
        }
    }

    /// Converts a round's impulses to the original rows.
    fn give(&self, rows: &mut Rows<R>, todo: R::Mask) {
        let Self { convex, of, .. } = self;
        for (block, at) in convex.blocks.iter().zip(of) {
            let source = &rows.blocks[*at];
            let (mu, mask, corners) = (source.mu, block.mask.and(todo), source.set);
            let solved = &convex.rows[block.rows.range()];
            for (i, row) in rows.rows[source.rows.range()].iter_mut().enumerate() {
                let new = if corners == Set::CoulombBox {
                    let weight = |corner| if i == 0 { R::one() } else { mu * sign::<R>(corner, i) };
                    let parts = solved.iter().enumerate();
                    parts.fold(R::zero(), |sum, (at, part)| sum + weight(at) * part.impulse)
                } else {
                    solved[i].impulse
                };
                row.impulse = R::select(mask, new, row.impulse);
            }
        }
    }

    /// Stores the current impulses as the best, in some lanes.
    fn keep(&mut self, rows: &Rows<R>, blocks: &[usize], better: R::Mask) {
        let all = blocks.iter().flat_map(|at| rows.blocks[*at].rows.range());
        let count = all.clone().count();
        self.best.resize(count, R::zero());
        for (best, at) in self.best.iter_mut().zip(all) {
            *best = R::select(better, rows.rows[at].impulse, *best);
        }
    }

    fn restore(&self, rows: &mut Rows<R>, blocks: &[usize], mine: R::Mask) {
        let mut best = self.best.iter();
        for block in blocks.iter().map(|at| &rows.blocks[*at]) {
            let mask = block.mask.and(mine);
            for (row, best) in rows.rows[block.rows.range()].iter_mut().zip(best.by_ref()) {
                row.impulse = R::select(mask, *best, row.impulse);
            }
        }
    }
}

/// ±1: the way `i` ≥ 1 of friction at a corner of the box.
fn sign<R: Real>(corner: usize, i: usize) -> R {
    R::of(if corner >> (i - 1) & 1 == 0 { 1.0 } else { -1.0 })
}

fn sum<R: Real>(w: &[R]) -> R {
    w.iter().fold(R::zero(), |sum, w| sum + w.abs())
}

/// Returns the corners of a box, each with its share of the impulses: a way within ±1 of its bound
/// is divided between two weights.
fn corners<R: Real>(
    free: Unconstrained<R>,
    convex: &mut Rows<R>,
    rows: &Rows<R>,
    block: &Block<R>,
) {
    let own = &rows.rows[block.rows.range()];
    let (normal, ways) = (&own[0], own.len() - 1);
    let bound = (block.mu * normal.impulse).recip_or_zero();
    let half = R::of(0.5);
    for corner in 0..1usize << ways {
        let y = convex.y.len();
        convex.y.extend_from_slice(&rows.y[normal.y..][..normal.dofs.len]);
        let mut impulse = normal.impulse;
        for i in 1..=ways {
            let sign = sign::<R>(corner, i);
            impulse *= half + half * sign * own[i].impulse * bound;
            for (sum, y) in convex.y[y..].iter_mut().zip(&rows.y[own[i].y..]) {
                *sum += block.mu * sign * *y;
            }
        }
        let impulse = impulse.max(R::zero());
        let list = normal.dofs.of(free.dof_lists).iter().zip(&convex.y[y..]);
        let a = list.fold(R::zero(), |sum, (k, y)| sum + *y * *y * free.inv_d[*k]);
        convex.rows.push(Row { y, a, impulse, ..normal.clone() });
    }
}

/// Set u to û plus the effect of an island's impulses in some lanes.
fn follow<R: Real>(free: Unconstrained<R>, rows: &mut Rows<R>, blocks: &[usize], mine: R::Mask) {
    let Unconstrained { dof_lists, inv_d, guess } = free;
    let Rows { rows, blocks: all, y, u, .. } = rows;
    for block in blocks.iter().map(|at| &all[*at]) {
        let mask = block.mask.and(mine);
        for k in rows[block.rows.range()].iter().flat_map(|row| row.dofs.of(dof_lists)) {
            u[*k] = R::select(mask, guess[*k], u[*k]);
        }
    }
    for block in blocks.iter().map(|at| &all[*at]) {
        let mask = block.mask.and(mine);
        for row in &rows[block.rows.range()] {
            let dofs = row.dofs.of(dof_lists);
            let own = &y[row.y..row.y + dofs.len()];
            Rows::kick(u, inv_d, dofs, own, row.impulse, mask);
        }
    }
}
