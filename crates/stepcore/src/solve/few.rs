//! Islands of few rows, solved exactly in the impulses instead of the velocities.
//!
//! Newton's method for (A + C)λ − b = w with each λ in its interval: guess which rows
//! are free, solve for them with the others at their bounds, and guess again from
//! λ − w/s (Hintermüller, Ito & Kunisch 2002: the primal-dual active set method is a
//! semismooth Newton method). Where the guess repeats, λ is the solution. With fewer
//! rows than dofs the matrix is smaller than the Hessian, and usually one guess does.
//! Guesses can go round in a circle: lanes that a few did not solve are left to the
//! primal method, whose line search cannot.

use super::dot::{dot, dots};
use super::islands::row_count;
use super::limits::Report;
use super::rows::{Rows, Set};
use crate::real::{Count, Mask, Real};
use crate::room::room;
use crate::spatial::subtract_scaled;

/// An island of so many rows has few, and one of up to `SHARE` a dof of its own.
const MOST: usize = 16;
const SHARE: f64 = 0.5;
/// A pivot this small beside its diagonal would cost too many digits: rows that are nearly
/// copies with a tiny regulariser go to the primal method, which sees each by itself.
const PIVOT: f64 = 1e-5;
/// Guesses after which the island is left to the primal method.
const GUESSES: u32 = 10;
/// Rows of a block whose products are taken side by side.
const WIDE: usize = 4;
/// From so many free rows on, vectors pay in their elimination.
const LONG: usize = 12;

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
    /// What the free rows are to reach with the others at their bounds.
    rest: Vec<R>,
    /// Rows that are free in some lane, and their system: its upper half, then DLᵀ.
    some: Vec<usize>,
    m: Vec<R>,
    inv: Vec<R>,
    x: Vec<R>,
    /// One row of Lᵀ.
    l: Vec<R>,
    /// D⁻¹ y of one row, by dof.
    z: Vec<R>,
}

room!(Few<R>: rows, masks, a, b, impulse, w, free, high, rest, some, m, inv, x, l, z;);

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
            rest: Vec::new(),
            some: Vec::new(),
            m: Vec::new(),
            inv: Vec::new(),
            x: Vec::new(),
            l: Vec::new(),
            z: Vec::new(),
        }
    }

    /// Lanes in which all rows of these blocks are intervals, and few. A lane's own rows
    /// decide, whatever its neighbours have.
    pub fn fits(rows: &Rows<R>, blocks: &[usize]) -> R::Mask {
        let island = blocks.first().map(|block| rows.blocks[*block].island);
        let dofs = island.and_then(|island| rows.island_dofs.get(island));
        let share = SHARE * dofs.copied().unwrap_or(0) as f64;
        let most = MOST.max(share as usize) as u64;
        let mut fits = R::Mask::of(true);
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            if block.set != Set::Interval {
                fits = fits.and(block.mask.not());
            }
        }
        fits.and(row_count(rows, blocks).at_most(most))
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
            (&mut self.rest, n),
            (&mut self.inv, n),
            (&mut self.x, n),
            (&mut self.l, n),
        ] {
            list.resize(len, zero);
        }
        self.z.resize(inv_d.len(), zero);
        self.some.clear();
        self.some.reserve(n);
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
            self.products(dof_lists, rows, i);
            self.a[i * n + i] = row.a + row.c;
            for k in own {
                self.z[*k] = zero;
            }
            self.b.push(row.t - dot(own, y, guess));
            self.impulse.push(R::select(self.masks[i], row.impulse, zero));
        }
    }

    /// A of row i, whose D⁻¹ y is in `z`, and the rows before it.
    fn products(&mut self, dof_lists: &[usize], rows: &Rows<R>, i: usize) {
        let (n, mut j) = (self.rows.len(), 0);
        while j < i {
            let first = &rows.rows[self.rows[j]];
            let list = first.dofs.of(dof_lists);
            let beside = |(at, r): (usize, &usize)| {
                let row = &rows.rows[*r];
                row.dofs == first.dofs && row.y == first.y + at * list.len()
            };
            let wide = j + WIDE <= i && self.rows[j..j + WIDE].iter().enumerate().all(beside);
            if wide {
                let sums = dots::<R, WIDE>(list, &rows.y[first.y..], &self.z);
                self.a[i * n + j..i * n + j + WIDE].copy_from_slice(&sums);
            } else {
                let y = &rows.y[first.y..first.y + list.len()];
                self.a[i * n + j] = dot(list, y, &self.z);
            }
            j += if wide { WIDE } else { 1 };
        }
        for j in 0..i {
            self.a[j * n + i] = self.a[i * n + j];
        }
    }

    /// w = (A + C)λ − b.
    fn slacks(&mut self) {
        let Self { a, b, w, impulse, masks, .. } = self;
        for (w, b) in w.iter_mut().zip(&*b) {
            *w = -*b;
        }
        for ((column, x), mask) in a.chunks_exact(b.len().max(1)).zip(&*impulse).zip(&*masks) {
            if mask.all() {
                for (w, a) in w.iter_mut().zip(column) {
                    *w += *a * *x;
                }
            } else {
                for (w, a) in w.iter_mut().zip(column) {
                    *w = R::select(*mask, *w + *a * *x, *w);
                }
            }
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
        let poor = self.pose(rows).eliminate().and(live);
        let zero = R::zero();
        let (mut most, mut moved) = (zero, zero);
        let mut some = self.some.iter().enumerate().peekable();
        for (i, r) in self.rows.iter().enumerate() {
            let row = &rows.rows[*r];
            let bound = R::select(self.high[i], row.hi, row.lo);
            let mut x = R::select(self.free[i].or(self.masks[i].not()), zero, bound);
            if let Some((at, _)) = some.next_if(|(_, some)| **some == i) {
                x = R::select(self.free[i], self.x[at], x);
            }
            let mask = live.and(self.masks[i]).and(poor.not());
            let change = (x - self.impulse[i]).abs();
            moved = R::select(mask, moved.max(change), moved);
            most = R::select(mask, most.max(x.abs()), most);
            self.impulse[i] = R::select(mask, x, self.impulse[i]);
        }
        (moved.gt(R::of(8.0 * R::epsilon()) * most), poor)
    }

    /// The system of the free rows.
    fn pose(&mut self, rows: &Rows<R>) -> &mut Self {
        let Self { a, b, free, high, masks, rest, some, m, x, .. } = self;
        let n = b.len();
        some.clear();
        some.extend((0..n).filter(|i| free[*i].any()));
        rest.copy_from_slice(b);
        for (j, r) in self.rows.iter().enumerate() {
            let held = free[j].or(masks[j].not()).not();
            if held.none() {
                continue;
            }
            let bound = R::select(high[j], rows.rows[*r].hi, rows.rows[*r].lo);
            for (rest, a) in rest.iter_mut().zip(&a[j * n..(j + 1) * n]) {
                *rest = R::select(held, *rest - *a * bound, *rest);
            }
        }
        let size = some.len();
        for (at, i) in some.iter().enumerate() {
            x[at] = rest[*i];
            let own = &a[i * n..(i + 1) * n];
            for (m, j) in m[at * size + at..(at + 1) * size].iter_mut().zip(&some[at..]) {
                *m = own[*j];
            }
        }
        self
    }

    /// x ← M⁻¹ x on the free rows, M = LDLᵀ; lanes with a pivot that is too small.
    fn eliminate(&mut self) -> R::Mask {
        let Self { m, x, inv, l, free, a, some, .. } = self;
        let (size, n) = (some.len(), free.len());
        let whole = some.iter().all(|i| free[*i].all());
        let mut poor = R::Mask::of(false);
        for k in 0..size {
            let (own, later) = m.split_at_mut((k + 1) * size);
            let own = &own[k * size..];
            let mine = free[some[k]];
            let small = own[k].gt(R::of(PIVOT) * a[some[k] * n + some[k]]).not();
            poor = poor.or(mine.and(small));
            let pivot = R::one() / own[k];
            inv[k] = pivot;
            for (l, own) in l[k + 1..size].iter_mut().zip(&own[k + 1..]) {
                *l = *own * pivot;
            }
            for (i, row) in (k + 1..size).zip(later.chunks_exact_mut(size)) {
                let both = mine.and(free[some[i]]);
                if whole && size < LONG {
                    subtract_scaled(&mut row[i..], own[i], &l[i..size]);
                } else if whole {
                    for (m, l) in row[i..].iter_mut().zip(&l[i..size]) {
                        *m -= own[i] * *l;
                    }
                } else {
                    for ((m, l), j) in row[i..].iter_mut().zip(&l[i..size]).zip(&some[i..]) {
                        *m = R::select(both.and(free[*j]), *m - *l * own[i], *m);
                    }
                }
                x[i] = R::select(both, x[i] - l[i] * x[k], x[i]);
            }
        }
        for k in (0..size).rev() {
            let own = &m[k * size..(k + 1) * size];
            let mut sum = x[k];
            for i in k + 1..size {
                sum = R::select(free[some[i]], sum - own[i] * x[i], sum);
            }
            x[k] = sum * inv[k];
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
