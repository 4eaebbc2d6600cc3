//! The system of an island with few rows, (A + C)λ − b = w, in arrays of N slots.
//!
//! The loops of a single world run over all N, which the compiler recognises as whole registers.
//! Lanes, whose numbers are registers already, loop over the slots in use.

use super::gather::{each_slot, Gathered};
use super::{Island, GUESSES, PIVOT};
use crate::real::array::{from_fn, map};
use crate::real::{Count, Mask, Real, WIDEST};
use crate::solve::limits::Report;
use crate::solve::rows::Rows;
use crate::spatial::WIDE;
use std::ops::Range;

/// The rows of an island, and the data for their solution.
pub(super) struct Table<R: Real, const N: usize> {
    /// Slots in use, and the lanes with a row there.
    n: usize,
    masks: [R::Mask; N],
    /// Per row: the bounds of the impulse, and the inverse of the denominator.
    lo: [R; N],
    hi: [R; N],
    inv_s: [R; N],
    /// Per place.
    dofs: Vec<Dof<R, N>>,
    /// A + C, and t − J û.
    a: [[R; N]; N],
    b: [R; N],
    impulse: [R; N],
    w: [R; N],
    /// Free rows, and rows at their upper bound; all others are at their lower bound.
    free: [R::Mask; N],
    high: [R::Mask; N],
    /// The lines of free rows: first the upper half of their system, then DLᵀ; other entries are
    /// meaningless. 1/D, and the impulses of free rows.
    m: [[R; N]; N],
    inv: [R; N],
    x: [R; N],
    /// One row of Lᵀ.
    l: [R; N],
}

/// A dof: y of all slots, D⁻¹, and u, which starts as û.
#[derive(Clone, Copy)]
struct Dof<R: Real, const N: usize> {
    y: [R; N],
    inv_d: R,
    u: R,
}

room!(Table<R, N>: dofs; n, masks, lo, hi, inv_s, a, b, impulse, w, free, high, m, inv, x, l);

/// Returns the lanes in which a number changes a sum, even if only by its slope.
fn adds<R: Real>(x: R) -> R::Mask {
    let zero = x.le(R::zero()).and(x.ge(R::zero()));
    zero.not().or(R::Mask::of(x.steepness() != 0.0))
}

/// own += by · x in the slots `at` and lanes `mask`; in a single world with a true mask, in all.
#[inline(always)]
fn add_scaled<R: Real, const N: usize>(
    own: &mut [R; N],
    by: R,
    x: &[R; N],
    (at, mask): (Range<usize>, R::Mask),
) {
    if R::FILLS {
        for j in 0..N {
            own[j] += by * x[j];
        }
    } else if mask.all() {
        for j in at {
            own[j] += by * x[j];
        }
    } else {
        for j in at {
            own[j] = R::select(mask, own[j] + by * x[j], own[j]);
        }
    }
}

impl<R: Real, const N: usize> Table<R, N> {
    pub fn new() -> Self {
        let (zero, none) = ([R::zero(); N], [R::Mask::of(false); N]);
        Self {
            n: 0,
            masks: none,
            lo: zero,
            hi: zero,
            inv_s: zero,
            dofs: Vec::new(),
            a: [zero; N],
            b: zero,
            impulse: zero,
            w: zero,
            free: none,
            high: none,
            m: [zero; N],
            inv: zero,
            x: zero,
            l: zero,
        }
    }

    /// Solves the gathered rows in the lanes `mine`; returns the unsolved lanes.
    #[inline(never)]
    pub fn solve(
        &mut self,
        (island, own): (Island<R>, &Gathered<R>),
        rows: &mut Rows<R>,
        mine: R::Mask,
        report: &mut Report<R>,
    ) -> R::Mask {
        self.take(island, own, rows);
        let (mut todo, mut count) = (R::Mask::of(false), Count::ZERO);
        for mask in &self.masks[..self.n] {
            todo = todo.or(*mask);
            count.add(*mask, 1);
        }
        let (mut done, mut unsolved) = (Count::ZERO, R::Mask::of(false));
        self.slacks();
        self.classify(todo);
        for _ in 0..GUESSES {
            if todo.none() {
                break;
            }
            done.add(todo, 1);
            report.updates.add_each(todo, &count);
            let (moved, poor) = self.step(todo);
            unsolved = unsolved.or(poor);
            todo = todo.and(poor.not());
            self.slacks();
            let changed = self.classify(todo);
            todo = todo.and(changed).and(moved);
        }
        report.sweeps.raise(&done);
        let unsolved = unsolved.or(todo);
        self.give(own, rows, mine.and(unsolved.not()));
        unsolved
    }

    /// Fill in A, b and the initial impulses.
    fn take(&mut self, island: Island<R>, own: &Gathered<R>, rows: &Rows<R>) {
        let (zero, none) = ([R::zero(); N], R::Mask::of(false));
        self.n = own.slots.len().min(N);
        self.masks = from_fn(|i| own.slots.get(i).copied().unwrap_or(none));
        (self.free, self.high) = ([none; N], [none; N]);
        self.dofs.clear();
        let dof = |k: &usize| Dof { y: zero, inv_d: island.inv_d[*k], u: island.guess[*k] };
        self.dofs.extend(own.dofs.iter().map(dof));
        if own.moved {
            self.take_lanes(island, own, rows);
        } else {
            self.take_rows(own, rows);
        }
        for i in 0..self.n.min(N) {
            let softened = self.a[i][i];
            // A single world's products fill registers side by side; lanes fill them by themselves.
            if R::FILLS {
                self.a[i] = self.products(own, i, 0);
            } else {
                let whole = i - i % WIDE;
                for from in (0..whole).step_by(WIDE) {
                    let some = self.products::<WIDE>(own, i, from);
                    self.a[i][from..from + WIDE].copy_from_slice(&some);
                }
                for j in whole..i {
                    [self.a[i][j]] = self.products(own, i, j);
                }
            }
            self.a[i][i] = softened;
            for j in 0..i {
                self.a[j][i] = self.a[i][j];
            }
        }
    }

    /// Returns A between slot i and M slots from `from` on: each a sum in the order of the dofs.
    #[inline(always)]
    fn products<const M: usize>(&self, own: &Gathered<R>, i: usize, from: usize) -> [R; M] {
        let mut sums = [R::zero(); M];
        for p in own.places(i) {
            let dof = &self.dofs[*p];
            let (y, z) = (&dof.y[from..from + M], dof.inv_d * dof.y[i]);
            for j in 0..M {
                sums[j] += y[j] * z;
            }
        }
        sums
    }

    /// Fill in each row, one slot per row.
    fn take_rows(&mut self, own: &Gathered<R>, rows: &Rows<R>) {
        for (i, r) in own.rows.iter().enumerate().take(N) {
            let row = &rows.rows[*r];
            (self.lo[i], self.hi[i], self.inv_s[i]) = (row.lo, row.hi, row.inv_s);
            self.impulse[i] = R::select(self.masks[i], row.impulse, R::zero());
            self.a[i][i] = row.a + row.c;
            let mut along = R::zero();
            for (p, y) in own.places(i).iter().zip(&rows.y[row.y..]) {
                let dof = &mut self.dofs[*p];
                dof.y[i] = *y;
                along += *y * dof.u;
            }
            self.b[i] = row.t - along;
        }
    }

    /// Fill in the rows of lanes whose rows are moved.
    fn take_lanes(&mut self, island: Island<R>, own: &Gathered<R>, rows: &Rows<R>) {
        let zero = [R::zero(); N];
        // Lanes without a row in a slot.
        (self.lo, self.hi, self.inv_s, self.impulse, self.b) = (zero, zero, zero, zero, zero);
        (0..N).for_each(|i| self.a[i][i] = R::zero());
        each_slot(&own.masks, |i, lane, slot| {
            let row = &rows.rows[own.rows[i]];
            self.lo[slot].set_lane(lane, row.lo.lane(lane));
            self.hi[slot].set_lane(lane, row.hi.lane(lane));
            self.inv_s[slot].set_lane(lane, row.inv_s.lane(lane));
            self.impulse[slot].set_lane(lane, row.impulse.lane(lane));
            self.b[slot].set_lane(lane, row.t.lane(lane));
            self.a[slot][slot].set_lane(lane, (row.a + row.c).lane(lane));
            for (k, y) in row.dofs.of(island.dof_lists).iter().zip(&rows.y[row.y..]) {
                self.dofs[own.place(*k)].y[slot].set_lane(lane, y.lane(lane));
            }
        });
        let mut along = zero;
        for dof in &self.dofs {
            (0..self.n.min(N)).for_each(|i| along[i] += dof.y[i] * dof.u);
        }
        (0..self.n.min(N)).for_each(|i| self.b[i] -= along[i]);
    }

    /// w = (A + C)λ − b.
    fn slacks(&mut self) {
        let mut w = map(self.b, |b| -b);
        for i in 0..self.n.min(N) {
            let (x, mask) = (self.impulse[i], self.masks[i]);
            // Only the order of w relative to other numbers matters, not the sign of a zero.
            if adds(x).and(mask).any() {
                add_scaled(&mut w, x, &self.a[i], (0..self.n, mask));
            }
        }
        self.w = w;
    }

    /// Finds the free rows from λ − w/s; returns the lanes in which they changed.
    fn classify(&mut self, todo: R::Mask) -> R::Mask {
        let mut changed = R::Mask::of(false);
        for i in 0..self.n.min(N) {
            let mask = self.masks[i].and(todo);
            // A free row's w is rounding: only its impulse decides where it belongs.
            let pull = R::select(self.free[i], R::zero(), self.w[i] * self.inv_s[i]);
            let aim = self.impulse[i] - pull;
            let free = aim.gt(self.lo[i]).and(aim.lt(self.hi[i])).and(self.masks[i]);
            let high = aim.ge(self.hi[i]);
            let differ = |a: R::Mask, b: R::Mask| a.and(b.not()).or(b.and(a.not()));
            let new = differ(free, self.free[i]).or(free.not().and(differ(high, self.high[i])));
            changed = changed.or(mask.and(new));
            self.free[i] = mask.and(free).or(mask.not().and(self.free[i]));
            self.high[i] = mask.and(high).or(mask.not().and(self.high[i]));
        }
        changed
    }

    /// Solves for the free rows with the others at their bounds. Returns the lanes in which λ moved
    /// by more than rounding, and the lanes in which the system was too ill-conditioned.
    fn step(&mut self, todo: R::Mask) -> (R::Mask, R::Mask) {
        self.pose();
        let poor = self.eliminate().and(todo);
        let zero = R::zero();
        let (mut most, mut moved) = (zero, zero);
        for i in 0..self.n.min(N) {
            let bound = R::select(self.masks[i], self.bound(i), zero);
            let x = R::select(self.free[i], self.x[i], bound);
            let mask = todo.and(self.masks[i]).and(poor.not());
            // Measured by the effect on the velocity along its row: the impulse of a row that
            // almost nothing moves may be 1e14 times larger than the others.
            let effect = self.a[i][i];
            moved = R::select(mask, moved.max((x - self.impulse[i]).abs() * effect), moved);
            most = R::select(mask, most.max(x.abs() * effect), most);
            self.impulse[i] = R::select(mask, x, self.impulse[i]);
        }
        (moved.gt(R::of(8.0 * R::epsilon()) * most), poor)
    }

    /// Returns the bound at which a row is that is not free.
    #[inline(always)]
    fn bound(&self, i: usize) -> R {
        R::select(self.high[i], self.hi[i], self.lo[i])
    }

    /// Assembles the system of the free rows.
    fn pose(&mut self) {
        let mut rest = self.b;
        for i in 0..self.n.min(N) {
            let bound = self.bound(i);
            let held = self.masks[i].and(self.free[i].not()).and(adds(bound));
            if held.any() {
                add_scaled(&mut rest, -bound, &self.a[i], (0..self.n, held));
            }
            if self.free[i].any() {
                self.m[i] = self.a[i];
            }
        }
        self.x = rest;
    }

    /// x ← M⁻¹ x on the free rows, M = LDLᵀ; returns the lanes with too small a pivot.
    fn eliminate(&mut self) -> R::Mask {
        let (n, mut poor) = (self.n.min(N), R::Mask::of(false));
        for k in 0..n {
            let mine = self.free[k];
            if mine.none() {
                continue;
            }
            let (pivot, whole) = (self.m[k][k], self.a[k][k]);
            poor = poor.or(mine.and(pivot.gt(R::of(PIVOT) * whole).not()));
            self.inv[k] = R::one() / pivot;
            for j in if R::FILLS { 0..N } else { k + 1..n } {
                self.l[j] = self.m[k][j] * self.inv[k];
            }
            for i in k + 1..n {
                let both = mine.and(self.free[i]);
                if both.none() {
                    continue;
                }
                // If a row is not free here, nothing reads its result.
                let by = -self.m[k][i];
                add_scaled(&mut self.m[i], by, &self.l, (i..n, both));
                let taken = self.x[i] - self.l[i] * self.x[k];
                self.x[i] = R::select(both, taken, self.x[i]);
            }
        }
        for k in (0..n).rev() {
            let mut sum = self.x[k];
            for i in k + 1..n {
                sum = R::select(self.free[i], sum - self.m[k][i] * self.x[i], sum);
            }
            self.x[k] = sum * self.inv[k];
        }
        poor
    }

    /// Writes impulses within their bounds, and u = û + D⁻¹ Σ yλ.
    fn give(&mut self, own: &Gathered<R>, rows: &mut Rows<R>, mine: R::Mask) {
        for i in 0..self.n.min(N) {
            let mask = self.masks[i].and(mine);
            self.impulse[i] = self.impulse[i].clamp(self.lo[i], self.hi[i]);
            for p in own.places(i) {
                let dof = &mut self.dofs[*p];
                let kick = dof.inv_d * dof.y[i] * self.impulse[i];
                dof.u = R::select(mask, dof.u + kick, dof.u);
            }
        }
        for (k, dof) in own.dofs.iter().zip(&self.dofs) {
            rows.u[*k] = R::select(mine, dof.u, rows.u[*k]);
        }
        let mut next = [0; WIDEST];
        for (i, (r, mask)) in own.rows.iter().zip(&own.masks).enumerate() {
            let row = &mut rows.rows[*r];
            if !own.moved {
                row.impulse = R::select(mask.and(mine), self.impulse[i], row.impulse);
                continue;
            }
            for (lane, slot) in next[..R::LANES].iter_mut().enumerate() {
                if mask.lane(lane) {
                    if mine.lane(lane) {
                        row.impulse.set_lane(lane, self.impulse[*slot].lane(lane));
                    }
                    *slot += 1;
                }
            }
        }
    }
}
