//! Contacts between free bodies of a pile, packed: all data of one update are adjacent in memory.
//!
//! A contact has three directions, the normal n and two tangents, in which y = L⁻ᵀJᵀ are two
//! vectors of six. For a pyramid they are computed from its edges, y_n ± μ y_t: three products with
//! u instead of four, and the edges' effects on each other follow from their matrix, so that u is
//! read once before and written once after. Impulses are stored here during sweeps, and are copied
//! back when other code reads the rows.

use super::super::cone::InCone;
use super::super::free_bodies::{six, FreeBodies, SIX};
use super::super::rows::{Block, Row, Rows, Set, NARROW};
use super::cones::{Narrow, Tie};
use super::point::{along, gain, gain_in_cone, Point, EDGES};
use crate::real::array::from_fn;
use crate::real::{Mask, Real};

/// Edges form a pyramid if their differences agree to this many roundings.
const ROUNDINGS: f64 = 8.0;

/// Per body and direction.
type Ways<R> = [[[R; SIX]; NARROW]; 2];

/// One contact.
pub(super) struct Packed<R: Real> {
    pub point: Point<R>,
    mu: R,
    pub mask: R::Mask,
    pub(super) free: FreeBodies,
    pub tie: Tie,
}

/// The data that an update changes.
pub(super) struct Target<'a, R: Real> {
    pub inv_d: &'a [R],
    pub u: &'a mut [R],
    pub mask: R::Mask,
}

/// The result of one update.
pub(super) struct Updated<R> {
    /// The largest change of an impulse [m/s].
    pub change: R,
    /// With GAIN: the change of the objective of convex rows.
    pub gain: R,
}

impl<R: Real> Packed<R> {
    /// Pack a block of a pile, if it is a contact of three directions between free bodies.
    pub fn of(
        dof_lists: &[usize],
        inv_d: &[R],
        rows: &Rows<R>,
        block: &Block<R>,
        weight: &[R],
        cones: &mut Narrow<R>,
    ) -> Option<Self> {
        let own = &rows.rows[block.rows.range()];
        let edges = block.set == Set::Interval;
        if !rows.heap || own.len() != if edges { EDGES } else { NARROW } {
            return None;
        }
        let free = FreeBodies::of(own[0].dofs.of(dof_lists))?;
        let len = free.len();
        if own.iter().enumerate().any(|(at, row)| row.y != own[0].y + at * len) {
            return None;
        }
        let given = &rows.y[own[0].y..][..own.len() * len];
        let y = if edges { of_edges(own, given, len)? } else { by_body(given, len) };
        let zero = R::zero();
        let list = |of: fn(&Row<R>) -> R| from_fn(|at| own.get(at).map_or(zero, of));
        let point = Point {
            y,
            between: [zero; 6],
            t: list(|row| row.t),
            c: list(|row| row.c),
            inv_s: list(|row| row.inv_s),
            impulse: list(|row| row.impulse),
            weight: from_fn(|at| weight.get(at).copied().unwrap_or(zero)),
        };
        let mut packed = Self { point, mu: block.mu, mask: block.mask, free, tie: Tie::Bounds };
        let q = packed.products(inv_d);
        if edges {
            packed.point.between = of_pyramid(&q);
        } else {
            let [c0, c1, c2, _] = packed.point.c;
            packed.point.between = [q[0] + c0, q[1], q[2] + c1, q[3], q[4], q[5] + c2];
            packed.tie = cones.tie(block.set, block.mu, packed.whole());
        }
        Some(packed)
    }

    /// Returns y D⁻¹ yᵀ of the directions, rows of the lower triangle.
    fn products(&self, inv_d: &[R]) -> [R; 6] {
        let mut q = [R::zero(); 6];
        for which in 0..self.free.count() {
            let inv_d = &inv_d[self.free.body(which)];
            let [n, a, b] = &self.point.y[which];
            for (sum, (x, y)) in q.iter_mut().zip([(n, n), (a, n), (a, a), (b, n), (b, a), (b, b)])
            {
                for k in 0..SIX {
                    *sum += x[k] * inv_d[k] * y[k];
                }
            }
        }
        q
    }

    /// Returns y·u by direction.
    #[inline(always)]
    fn velocity(&self, u: &[R]) -> [R; NARROW] {
        let six = |which: usize| six(&u[self.free.body(which)]);
        let two = (self.free.count() == 2).then(|| six(1));
        self.point.velocity(&six(0), two.as_ref())
    }

    /// u += D⁻¹ Σ y f over the directions.
    #[inline(always)]
    fn kick(&self, f: &[R; NARROW], to: &mut Target<R>, mask: R::Mask) {
        for which in 0..self.free.count() {
            let body = self.free.body(which);
            let inv_d = &to.inv_d[body.clone()][..SIX];
            let own = &mut to.u[body][..SIX];
            for k in 0..SIX {
                let new = own[k] + inv_d[k] * self.point.push(which, k, f);
                own[k] = R::select(mask, new, own[k]);
            }
        }
    }

    /// Updates the impulses, and u with their effect. With GAIN, `rows` holds the impulses.
    #[inline(always)]
    pub fn update<const GAIN: bool>(
        &mut self,
        rows: &mut [Row<R>],
        cones: &mut Narrow<R>,
        to: &mut Target<R>,
    ) -> Updated<R> {
        if GAIN {
            self.load(rows);
        }
        let updated = match self.tie {
            Tie::Bounds => self.edges::<GAIN>(rows, to),
            Tie::Convex(at) => self.convex::<GAIN>(&mut cones.convex[at as usize], to),
            Tie::Disc(_) | Tie::Square(_) => self.coulomb(cones, to),
        };
        if GAIN {
            self.store(rows);
        }
        updated
    }

    pub fn load(&mut self, rows: &[Row<R>]) {
        for (own, row) in self.point.impulse.iter_mut().zip(rows) {
            *own = row.impulse;
        }
    }

    pub fn store(&self, rows: &mut [Row<R>]) {
        for (own, row) in self.point.impulse.iter().zip(rows) {
            row.impulse = *own;
        }
    }

    /// Updates every edge in sequence.
    #[inline(always)]
    fn edges<const GAIN: bool>(&mut self, rows: &[Row<R>], to: &mut Target<R>) -> Updated<R> {
        let (zero, mut sum) = (R::zero(), R::zero());
        let keep = |change: R| R::select(to.mask, change, zero);
        let change = self.point.edges(self.velocity(to.u), keep, |i, change, short| {
            if GAIN {
                sum += gain(rows[i].a + rows[i].c, change, short);
            }
        });
        self.finish(change, along(&change), sum, to)
    }

    /// Solves the block's minimum in one piece.
    #[inline(always)]
    fn convex<const GAIN: bool>(
        &mut self,
        cone: &mut InCone<R, NARROW>,
        to: &mut Target<R>,
    ) -> Updated<R> {
        let (zero, q) = (R::zero(), self.whole());
        let velocity = self.velocity(to.u);
        let w: [R; NARROW] = from_fn(|i| -self.point.short(i, velocity[i]));
        // The gradient at zero impulse of this block: w − Qλ.
        let b = from_fn(|i| w[i] - times(&q[i], &self.point.impulse));
        let solution = cone.least(&b, to.mask);
        let mut change = [zero; EDGES];
        for i in 0..NARROW {
            change[i] = R::select(to.mask, solution[i] - self.point.impulse[i], zero);
        }
        let f = [change[0], change[1], change[2]];
        let curved = |q: &[R; NARROW]| times(q, &change);
        let gain = if GAIN { gain_in_cone(zero, &f, &w, &q.each_ref().map(curved)) } else { zero };
        self.finish(change, f, gain, to)
    }

    /// Updates the normal as an interval, then the tangents within its friction bound.
    #[inline(always)]
    fn coulomb(&mut self, cones: &mut Narrow<R>, to: &mut Target<R>) -> Updated<R> {
        let (zero, q, x) = (R::zero(), self.whole(), self.point.impulse);
        let velocity = self.velocity(to.u);
        let short: [R; NARROW] = from_fn(|i| self.point.short(i, velocity[i]));
        let normal = R::select(to.mask, self.point.change(0, short[0]), zero);
        let slope = [1, 2].map(|i| q[i][0] * normal - short[i]);
        let bound = self.mu * (x[0] + normal);
        let [one, two] = cones.friction(self.tie, slope, &[x[1], x[2]], bound, to.mask);
        let friction = |new: R, old: R| R::select(to.mask, new - old, zero);
        let f = [normal, friction(one, x[1]), friction(two, x[2])];
        self.finish([f[0], f[1], f[2], zero], f, zero, to)
    }

    /// Applies the changes, by row and along the directions, to impulses and u.
    #[inline(always)]
    fn finish(
        &mut self,
        change: [R; EDGES],
        f: [R; NARROW],
        gain: R,
        to: &mut Target<R>,
    ) -> Updated<R> {
        let largest = self.point.add(&change, R::zero());
        let moved = moves(&change);
        if moved.any() {
            self.kick(&f, to, moved);
        }
        Updated { change: largest, gain }
    }

    /// Returns `between` of directions, as a full matrix.
    #[inline(always)]
    fn whole(&self) -> [[R; NARROW]; NARROW] {
        let [q00, q10, q11, q20, q21, q22] = self.point.between;
        [[q00, q10, q20], [q10, q11, q21], [q20, q21, q22]]
    }
}

#[inline(always)]
fn times<R: Real>(q: &[R; NARROW], x: &[R; EDGES]) -> R {
    (q[0] * x[0] + q[1] * x[1]) + q[2] * x[2]
}

/// Rows one after another, each over both bodies.
fn by_body<R: Real>(y: &[R], len: usize) -> Ways<R> {
    let entry = |body: usize, way: usize, k: usize| match y[way * len..][..len].get(body * SIX + k)
    {
        Some(y) => *y,
        None => R::zero(),
    };
    from_fn(|body| from_fn(|way| from_fn(|k| entry(body, way, k))))
}

/// Returns the directions n, a and b of edges n ± a and n ± b, if the rows are such edges.
fn of_edges<R: Real>(rows: &[Row<R>], y: &[R], len: usize) -> Option<Ways<R>> {
    let (zero, half) = (R::zero(), R::of(0.5));
    let bounded = |row: &Row<R>| row.lo.le(zero).and(row.lo.ge(zero)).and(row.hi.is_finite().not());
    let mut good = rows.iter().fold(R::Mask::of(true), |good, row| good.and(bounded(row)));
    let edge = |row: usize, k: usize| y[row * len + k];
    let mut ways = [[[zero; SIX]; NARROW]; 2];
    for k in 0..len {
        let [p, q, r, s] = from_fn(|row| edge(row, k));
        let (n, rest) = (half * (p + q), half * (r + s));
        let size = p.abs().max(q.abs()).max(r.abs().max(s.abs()));
        good = good.and((n - rest).abs().le(R::of(ROUNDINGS * R::epsilon()) * size));
        let own = &mut ways[k / SIX];
        (own[0][k % SIX], own[1][k % SIX], own[2][k % SIX]) = (n, half * (p - q), half * (r - s));
    }
    good.all().then_some(ways)
}

/// Returns y D⁻¹ yᵀ between the edges n ± a and n ± b, rows below the diagonal.
fn of_pyramid<R: Real>([nn, an, aa, bn, ba, bb]: &[R; 6]) -> [R; 6] {
    let (sum, difference) = (*nn + *bn, *nn - *bn);
    let (plus, minus) = (*an + *ba, *an - *ba);
    [*nn - *aa, sum + plus, sum - plus, difference + minus, difference - minus, *nn - *bb]
}

/// Returns lanes in which some change is nonzero, or not a number.
#[inline(always)]
fn moves<R: Real, const N: usize>(change: &[R; N]) -> R::Mask {
    let zero = R::zero();
    change.iter().fold(R::Mask::of(false), |mask, x| mask.or(x.le(zero).and(x.ge(zero)).not()))
}
