//! Islands of few rows, solved exactly in the impulses instead of the velocities.
//!
//! Newton's method for (A + C)λ − b = w with each λ in its interval: guess which rows
//! are free, solve for them with the others at their bounds, and guess again from
//! λ − w/s (Hintermüller, Ito & Kunisch 2002: the primal-dual active set method is a
//! semismooth Newton method). Where the guess repeats, λ is the solution. With fewer
//! rows than dofs the matrix is smaller than the Hessian, and usually one guess does.
//! Guesses can go round in a circle: lanes that a few did not solve are left to the
//! primal method, whose line search cannot.

use super::dot::dot;
use super::islands::row_count;
use super::limits::Report;
use super::rows::{Rows, Set};
use crate::real::{Count, Mask, Real};
use crate::room::room;

/// An island of more rows is not few.
const MOST: u64 = 16;
/// A pivot this small beside its diagonal would cost too many digits: rows that are nearly
/// copies with a tiny regulariser go to the primal method, which sees each by itself.
const PIVOT: f64 = 1e-5;
/// Guesses after which the island is left to the primal method.
const GUESSES: u32 = 6;

/// The method's memory. Lists are by row of the island, matrices row by row.
pub(super) struct Few<R: Real> {
    rows: Vec<usize>,
    masks: Vec<R::Mask>,
    /// A + C, and t − J û.
    a: Vec<R>,
    b: Vec<R>,
    impulse: Vec<R>,
    w: Vec<R>,
    /// Free rows, and rows at their upper bound; the others are at their lower one.
    free: Vec<R::Mask>,
    high: Vec<R::Mask>,
    /// The system of the free rows, then its factors.
    m: Vec<R>,
    inv: Vec<R>,
    x: Vec<R>,
    /// D⁻¹ y of one row, by dof.
    z: Vec<R>,
}

room!(Few<R>: rows, masks, a, b, impulse, w, free, high, m, inv, x, z;);

/// What one solve reads.
#[derive(Clone, Copy)]
pub(super) struct Island<'a, R: Real> {
    pub dof_lists: &'a [usize],
    pub inv_d: &'a [R],
    /// û.
    pub guess: &'a [R],
    pub blocks: &'a [usize],
}

impl<R: Real> Few<R> {
    pub fn new() -> Self {
        Self {
            rows: Vec::new(),
            masks: Vec::new(),
            a: Vec::new(),
            b: Vec::new(),
            impulse: Vec::new(),
            w: Vec::new(),
            free: Vec::new(),
            high: Vec::new(),
            m: Vec::new(),
            inv: Vec::new(),
            x: Vec::new(),
            z: Vec::new(),
        }
    }

    /// Lanes in which all rows of these blocks are intervals, and few. A lane's own rows
    /// decide, whatever its neighbours have.
    pub fn fits(rows: &Rows<R>, blocks: &[usize]) -> R::Mask {
        let mut fits = R::Mask::of(true);
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            if block.set != Set::Interval {
                fits = fits.and(block.mask.not());
            }
        }
        fits.and(row_count(rows, blocks).at_most(MOST))
    }

    /// Solves an island in the lanes `mine`; `rows.u` and the impulses as for the other
    /// solvers. Returns the lanes that it left unsolved.
    pub fn solve(
        &mut self,
        island: Island<R>,
        rows: &mut Rows<R>,
        mine: R::Mask,
        report: &mut Report<R>,
    ) -> R::Mask {
        self.take(island, rows, mine);
        let (mut live, mut count) = (R::Mask::of(false), Count::ZERO);
        for mask in &self.masks {
            live = live.or(*mask);
            count.add(*mask, 1);
        }
        let (mut done, mut unsolved) = (Count::ZERO, R::Mask::of(false));
        self.slacks();
        self.classify(rows, live);
        for _ in 0..GUESSES {
            if live.none() {
                break;
            }
            done.add(live, 1);
            report.updates.add_each(live, &count);
            let (moved, poor) = self.step(rows, live);
            unsolved = unsolved.or(poor);
            live = live.and(poor.not());
            self.slacks();
            let changed = self.classify(rows, live);
            live = live.and(changed).and(moved);
        }
        report.sweeps.raise(&done);
        let unsolved = unsolved.or(live);
        self.give(island, rows, mine.and(unsolved.not()));
        unsolved
    }

    /// A, b and the impulses to start from.
    fn take(&mut self, island: Island<R>, rows: &Rows<R>, mine: R::Mask) {
        let Island { dof_lists, inv_d, guess, blocks } = island;
        let zero = R::zero();
        self.rows.clear();
        self.masks.clear();
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            self.rows.extend(block.rows.range());
            self.masks.extend(block.rows.range().map(|_| block.mask.and(mine)));
        }
        let n = self.rows.len();
        for (list, len) in [
            (&mut self.a, n * n),
            (&mut self.m, n * n),
            (&mut self.w, n),
            (&mut self.inv, n),
            (&mut self.x, n),
        ] {
            list.resize(len, zero);
        }
        self.z.resize(inv_d.len(), zero);
        self.free.clear();
        self.free.resize(n, R::Mask::of(false));
        self.high.clear();
        self.high.resize(n, R::Mask::of(false));
        self.b.clear();
        self.impulse.clear();
        for i in 0..n {
            let row = &rows.rows[self.rows[i]];
            let own = row.dofs.of(dof_lists);
            let y = &rows.y[row.y..row.y + own.len()];
            for (k, y) in own.iter().zip(y) {
                self.z[*k] = inv_d[*k] * *y;
            }
            for j in 0..i {
                let other = &rows.rows[self.rows[j]];
                let list = other.dofs.of(dof_lists);
                let sum = dot(list, &rows.y[other.y..other.y + list.len()], &self.z);
                self.a[i * n + j] = sum;
                self.a[j * n + i] = sum;
            }
            self.a[i * n + i] = row.a + row.c;
            for k in own {
                self.z[*k] = zero;
            }
            self.b.push(row.t - dot(own, y, guess));
            self.impulse.push(R::select(self.masks[i], row.impulse, zero));
        }
    }

    /// w = (A + C)λ − b.
    fn slacks(&mut self) {
        let n = self.rows.len();
        for i in 0..n {
            let row = &self.a[i * n..(i + 1) * n];
            let mut sum = -self.b[i];
            for ((a, x), mask) in row.iter().zip(&self.impulse).zip(&self.masks) {
                sum = R::select(*mask, sum + *a * *x, sum);
            }
            self.w[i] = sum;
        }
    }

    /// Which rows are free, from λ − w/s; lanes in which that is new.
    fn classify(&mut self, rows: &Rows<R>, live: R::Mask) -> R::Mask {
        let mut changed = R::Mask::of(false);
        for (i, r) in self.rows.iter().enumerate() {
            let row = &rows.rows[*r];
            let mask = self.masks[i].and(live);
            // A free row's w is rounding: its impulse alone says where it belongs.
            let pull = R::select(self.free[i], R::zero(), self.w[i] * row.inv_s);
            let aim = self.impulse[i] - pull;
            let free = aim.gt(row.lo).and(aim.lt(row.hi)).and(self.masks[i]);
            let high = aim.ge(row.hi);
            let differ = |a: R::Mask, b: R::Mask| a.and(b.not()).or(b.and(a.not()));
            let new = differ(free, self.free[i]).or(free.not().and(differ(high, self.high[i])));
            changed = changed.or(mask.and(new));
            self.free[i] = mask.and(free).or(mask.not().and(self.free[i]));
            self.high[i] = mask.and(high).or(mask.not().and(self.high[i]));
        }
        changed
    }

    /// Solves for the free rows, the others at their bounds; lanes in which λ moved
    /// by more than rounding, and lanes in which the system was too poor to solve.
    fn step(&mut self, rows: &Rows<R>, live: R::Mask) -> (R::Mask, R::Mask) {
        let n = self.rows.len();
        let zero = R::zero();
        for (i, r) in self.rows.iter().enumerate() {
            let row = &rows.rows[*r];
            let bound = R::select(self.high[i], row.hi, row.lo);
            self.x[i] = R::select(self.free[i].or(self.masks[i].not()), zero, bound);
        }
        for i in 0..n {
            if self.free[i].none() {
                continue;
            }
            let row = &self.a[i * n..(i + 1) * n];
            let mut sum = self.b[i];
            for j in 0..n {
                let taken = sum - row[j] * self.x[j];
                sum = R::select(self.free[j].or(self.masks[j].not()), sum, taken);
            }
            self.m[i * n..=i * n + i].copy_from_slice(&row[..=i]);
            self.inv[i] = sum;
        }
        for i in 0..n {
            self.x[i] = R::select(self.free[i], self.inv[i], self.x[i]);
        }
        let poor = self.eliminate().and(live);
        let (mut most, mut moved) = (zero, zero);
        for i in 0..n {
            let mask = live.and(self.masks[i]).and(poor.not());
            let change = (self.x[i] - self.impulse[i]).abs();
            moved = R::select(mask, moved.max(change), moved);
            most = R::select(mask, most.max(self.x[i].abs()), most);
            self.impulse[i] = R::select(mask, self.x[i], self.impulse[i]);
        }
        (moved.gt(R::of(8.0 * R::EPSILON) * most), poor)
    }

    /// x ← M⁻¹ x on the free rows, M = LDLᵀ; lanes with a pivot that is too small.
    fn eliminate(&mut self) -> R::Mask {
        let n = self.rows.len();
        let mut poor = R::Mask::of(false);
        let Self { m, x, inv, free, a, .. } = self;
        for k in 0..n {
            if free[k].none() {
                continue;
            }
            let small = m[k * n + k].gt(R::of(PIVOT) * a[k * n + k]).not();
            poor = poor.or(free[k].and(small));
            let pivot = R::one() / m[k * n + k];
            inv[k] = pivot;
            for i in k + 1..n {
                let both = free[k].and(free[i]);
                if both.none() {
                    continue;
                }
                let own = m[i * n + k];
                let l = own * pivot;
                for j in k + 1..=i {
                    let new = m[i * n + j] - l * m[j * n + k];
                    m[i * n + j] = R::select(both.and(free[j]), new, m[i * n + j]);
                }
                x[i] = R::select(both, x[i] - l * x[k], x[i]);
            }
        }
        for k in (0..n).rev() {
            if free[k].none() {
                continue;
            }
            let mut sum = x[k];
            for i in k + 1..n {
                let both = free[k].and(free[i]);
                sum = R::select(both, sum - m[i * n + k] * x[i], sum);
            }
            x[k] = R::select(free[k], sum * inv[k], x[k]);
        }
        poor
    }

    /// Impulses within their bounds, and u = û + D⁻¹ Σ yλ.
    fn give(&self, island: Island<R>, rows: &mut Rows<R>, mine: R::Mask) {
        let Island { dof_lists, inv_d, guess, .. } = island;
        let Rows { rows, y, u, .. } = rows;
        for r in &self.rows {
            for k in rows[*r].dofs.of(dof_lists) {
                u[*k] = R::select(mine, guess[*k], u[*k]);
            }
        }
        for (i, r) in self.rows.iter().enumerate() {
            let row = &mut rows[*r];
            let mask = self.masks[i].and(mine);
            let impulse = self.impulse[i].clamp(row.lo, row.hi);
            row.impulse = R::select(mask, impulse, row.impulse);
            let dofs = row.dofs.of(dof_lists);
            Rows::kick(u, inv_d, dofs, &y[row.y..row.y + dofs.len()], row.impulse, mask);
        }
    }
}
