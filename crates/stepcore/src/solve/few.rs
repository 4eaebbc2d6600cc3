//! Islands of few rows, solved exactly in the impulses instead of the velocities.
//!
//! Newton's method for (A + C)λ − b = w with each λ in its interval: guess which rows
//! are free, solve for them with the others at their bounds, and guess again from
//! λ − w/s (Hintermüller, Ito & Kunisch 2002: the primal-dual active set method is a
//! semismooth Newton method). Where the guess repeats, λ is the solution. With fewer
//! rows than dofs the matrix is smaller than the Hessian, and usually one guess does.
//! Guesses can go round in a circle: lanes that a few did not solve are left to the
//! primal method, whose line search cannot.

mod gather;

use super::islands::row_count;
use super::limits::Report;
use super::rows::{Rows, Set};
use crate::real::{Count, Mask, Real};
use crate::spatial::subtract_scaled;
use gather::Gathered;

/// An island of so many rows has few, and one of up to `SHARE` a dof of its own. With half of `MOST` ant and
/// walker take up to a tenth longer; without `SHARE` humanoid_CMU in lanes a fifth, alone as long.
const MOST: usize = 16;
const SHARE: f64 = 0.5;
/// A pivot this small beside its diagonal would cost too many digits: rows that are nearly
/// copies with a tiny regulariser go to the primal method, which sees each by itself.
const PIVOT: f64 = 1e-5;
/// Guesses after which the island is left to the primal method.
const GUESSES: u32 = 10;
/// From so many free rows on, vectors pay in their elimination.
const LONG: usize = 12;

/// The method's memory. Lists are by slot, each of which holds one row of every lane that has so many
/// (`gather.rs`); matrices slot by slot.
pub(super) struct Few<R: Real> {
    gathered: Gathered<R>,
    /// Lanes with a row in the slot.
    masks: Vec<R::Mask>,
    /// Of the row: between which impulses, and the inverse of its denominator.
    lo: Vec<R>,
    hi: Vec<R>,
    inv_s: Vec<R>,
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
}

room!(Few<R>: gathered, masks, lo, hi, inv_s, a, b, impulse, w, free, high, rest, some, m, inv, x,
    l);

/// What one solve reads.
#[derive(Clone, Copy)]
pub(super) struct Island<'a, R: Real> {
    pub dof_lists: &'a [usize],
    pub inv_d: &'a [R],
    /// û.
    pub guess: &'a [R],
    pub blocks: &'a [usize],
}

/// Where a number adds anything to a sum, be it but a slope.
fn adds<R: Real>(x: R) -> R::Mask {
    let zero = x.le(R::zero()).and(x.ge(R::zero()));
    zero.not().or(R::Mask::of(x.steepness() != 0.0))
}

impl<R: Real> Few<R> {
    pub fn new() -> Self {
        Self {
            gathered: Gathered::new(),
            masks: Vec::new(),
            lo: Vec::new(),
            hi: Vec::new(),
            inv_s: Vec::new(),
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
        self.classify(live);
        for _ in 0..GUESSES {
            if live.none() {
                break;
            }
            done.add(live, 1);
            report.updates.add_each(live, &count);
            let (moved, poor) = self.step(live);
            unsolved = unsolved.or(poor);
            live = live.and(poor.not());
            self.slacks();
            let changed = self.classify(live);
            live = live.and(changed).and(moved);
        }
        report.sweeps.raise(&done);
        let unsolved = unsolved.or(live);
        self.give(island, rows, mine.and(unsolved.not()));
        unsolved
    }

    /// w = (A + C)λ − b.
    fn slacks(&mut self) {
        let Self { a, b, w, impulse, masks, .. } = self;
        for (w, b) in w.iter_mut().zip(&*b) {
            *w = -*b;
        }
        for ((column, x), mask) in a.chunks_exact(b.len().max(1)).zip(&*impulse).zip(&*masks) {
            if adds(*x).and(*mask).none() {
                // Of w only the order among other numbers counts, not the sign of a zero.
                continue;
            }
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
    fn classify(&mut self, live: R::Mask) -> R::Mask {
        let mut changed = R::Mask::of(false);
        for i in 0..self.b.len() {
            let mask = self.masks[i].and(live);
            // A free row's w is rounding: its impulse alone says where it belongs.
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

    /// Solves for the free rows, the others at their bounds; lanes in which λ moved
    /// by more than rounding, and lanes in which the system was too poor to solve.
    fn step(&mut self, live: R::Mask) -> (R::Mask, R::Mask) {
        let poor = self.pose().eliminate().and(live);
        let zero = R::zero();
        let (mut most, mut moved) = (zero, zero);
        let mut some = self.some.iter().enumerate().peekable();
        for i in 0..self.b.len() {
            let bound = R::select(self.high[i], self.hi[i], self.lo[i]);
            let mut x = R::select(self.free[i].or(self.masks[i].not()), zero, bound);
            if let Some((at, _)) = some.next_if(|(_, some)| **some == i) {
                x = R::select(self.free[i], self.x[at], x);
            }
            let mask = live.and(self.masks[i]).and(poor.not());
            // By what it does to the velocity along its row: of one that next to nothing moves an
            // impulse may be 1e14 times that of the others.
            let effect = self.a[i * self.b.len() + i];
            moved = R::select(mask, moved.max((x - self.impulse[i]).abs() * effect), moved);
            most = R::select(mask, most.max(x.abs() * effect), most);
            self.impulse[i] = R::select(mask, x, self.impulse[i]);
        }
        (moved.gt(R::of(8.0 * R::epsilon()) * most), poor)
    }

    /// The system of the free rows.
    fn pose(&mut self) -> &mut Self {
        let Self { a, b, lo, hi, free, high, masks, rest, some, m, x, .. } = self;
        let n = b.len();
        some.clear();
        some.extend((0..n).filter(|i| free[*i].any()));
        rest.copy_from_slice(b);
        for j in 0..n {
            let bound = R::select(high[j], hi[j], lo[j]);
            let held = free[j].or(masks[j].not()).not().and(adds(bound));
            if held.none() {
                continue;
            }
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
                if both.none() {
                    continue;
                }
                // Of a row that is not free here nothing reads what it gets.
                if !both.all() {
                    for (m, l) in row[i..].iter_mut().zip(&l[i..size]) {
                        *m = R::select(both, *m - own[i] * *l, *m);
                    }
                } else if size < LONG {
                    subtract_scaled(&mut row[i..], own[i], &l[i..size]);
                } else {
                    for (m, l) in row[i..].iter_mut().zip(&l[i..size]) {
                        *m -= own[i] * *l;
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
}
