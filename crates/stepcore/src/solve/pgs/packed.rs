//! Contacts between free bodies of a heap, packed: all that an update reads of one stands together.
//!
//! A contact has three directions, the normal n and two tangents, in which y = L⁻ᵀJᵀ are two
//! vectors of six. Of a pyramid they are taken from its edges, y_n ± μ y_t: three products with u
//! instead of four, and what the edges do to each other follows from their own matrix, so that u
//! is read once before and written once after. Impulses stand here while sweeps go on, and are
//! copied back where somebody else reads the rows.

use super::super::cone::InCone;
use super::super::free::{products, total, Free, SIX};
use super::super::rows::{Block, Row, Rows, Set, NARROW};
use super::cones::{Narrow, Tie};
use crate::real::{Mask, Real};
use core::array::from_fn;

/// Rows of a pyramid.
pub(super) const EDGES: usize = 4;
/// Edges are a pyramid's when what is left of their differences is so many roundings.
const ROUNDINGS: f64 = 8.0;

/// By body and direction.
type Ways<R> = [[[R; SIX]; NARROW]; 2];

/// One contact; lists of four hold edges, or three directions and nothing.
pub(super) struct Packed<R: Real> {
    /// y by body and direction.
    pub(super) y: Ways<R>,
    /// y D⁻¹ yᵀ of edges, or of directions with c on the diagonal; rows of the lower triangle:
    /// of edges without the diagonal.
    pub(super) between: [R; 6],
    pub(super) t: [R; EDGES],
    pub(super) c: [R; EDGES],
    pub(super) inv_s: [R; EDGES],
    pub(super) impulse: [R; EDGES],
    /// √(A/m).
    pub(super) weight: [R; EDGES],
    mu: R,
    pub mask: R::Mask,
    pub(super) free: Free,
    pub tie: Tie,
}

/// What an update changes.
pub(super) struct Target<'a, R: Real> {
    pub inv_d: &'a [R],
    pub u: &'a mut [R],
    pub mask: R::Mask,
}

/// Of one update.
pub(super) struct Updated<R> {
    /// The largest change of an impulse [m/s].
    pub change: R,
    /// With GAIN: the change of what convex rows minimise.
    pub gain: R,
}

impl<R: Real> Packed<R> {
    /// A block of a heap, if it is a contact of three directions between free bodies.
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
        let free = Free::of(own[0].dofs.of(dof_lists))?;
        let len = free.len();
        if own.iter().enumerate().any(|(at, row)| row.y != own[0].y + at * len) {
            return None;
        }
        let given = &rows.y[own[0].y..][..own.len() * len];
        let y = if edges { of_edges(own, given, len)? } else { by_body(given, len) };
        let zero = R::zero();
        let list = |of: fn(&Row<R>) -> R| from_fn(|at| own.get(at).map_or(zero, of));
        let mut packed = Self {
            y,
            between: [zero; 6],
            t: list(|row| row.t),
            c: list(|row| row.c),
            inv_s: list(|row| row.inv_s),
            impulse: list(|row| row.impulse),
            weight: from_fn(|at| weight.get(at).copied().unwrap_or(zero)),
            mu: block.mu,
            mask: block.mask,
            free,
            tie: Tie::Bounds,
        };
        let q = packed.products(inv_d);
        if edges {
            packed.between = of_pyramid(&q);
        } else {
            let [c0, c1, c2, _] = packed.c;
            packed.between = [q[0] + c0, q[1], q[2] + c1, q[3], q[4], q[5] + c2];
            packed.tie = cones.tie(block.set, block.mu, packed.whole());
        }
        Some(packed)
    }

    /// y D⁻¹ yᵀ of the directions, rows of the lower triangle.
    fn products(&self, inv_d: &[R]) -> [R; 6] {
        let mut q = [R::zero(); 6];
        for which in 0..self.free.count() {
            let inv_d = &inv_d[self.free.body(which)];
            let [n, a, b] = &self.y[which];
            for (sum, (x, y)) in q.iter_mut().zip([(n, n), (a, n), (a, a), (b, n), (b, a), (b, b)])
            {
                for k in 0..SIX {
                    *sum += x[k] * inv_d[k] * y[k];
                }
            }
        }
        q
    }

    /// y·u by direction.
    #[inline(always)]
    fn velocity(&self, u: &[R]) -> [R; NARROW] {
        let one: &[R] = &u[self.free.body(0)];
        let [n, a, b] = &self.y[0];
        let [mut n, mut a, mut b] = [products(n, one), products(a, one), products(b, one)];
        if self.free.count() == 2 {
            let two: &[R] = &u[self.free.body(1)];
            for (sum, y) in [&mut n, &mut a, &mut b].into_iter().zip(&self.y[1]) {
                let more = products(y, two);
                for k in 0..SIX {
                    sum[k] += more[k];
                }
            }
        }
        [total(n), total(a), total(b)]
    }

    /// u += D⁻¹ Σ y f over the directions.
    #[inline(always)]
    fn kick(&self, f: &[R; NARROW], to: &mut Target<R>, mask: R::Mask) {
        for which in 0..self.free.count() {
            let body = self.free.body(which);
            let inv_d = &to.inv_d[body.clone()][..SIX];
            let own = &mut to.u[body][..SIX];
            let [n, a, b] = &self.y[which];
            for k in 0..SIX {
                let push = (n[k] * f[0] + a[k] * f[1]) + b[k] * f[2];
                own[k] = R::select(mask, own[k] + inv_d[k] * push, own[k]);
            }
        }
    }

    /// New impulses, and u with their effect. With GAIN they are those of `rows`.
    #[inline(always)]
    pub fn update<const GAIN: bool>(
        &mut self,
        rows: &mut [Row<R>],
        cones: &Narrow<R>,
        to: &mut Target<R>,
    ) -> Updated<R> {
        if GAIN {
            self.load(rows);
        }
        let updated = match self.tie {
            Tie::Bounds => self.edges::<GAIN>(rows, to),
            Tie::Convex(at) => self.convex::<GAIN>(&cones.convex[at as usize], to),
            Tie::Disc(_) | Tie::Square(_) => self.coulomb(cones, to),
        };
        if GAIN {
            self.store(rows);
        }
        updated
    }

    pub fn load(&mut self, rows: &[Row<R>]) {
        for (own, row) in self.impulse.iter_mut().zip(rows) {
            *own = row.impulse;
        }
    }

    pub fn store(&self, rows: &mut [Row<R>]) {
        for (own, row) in self.impulse.iter().zip(rows) {
            row.impulse = *own;
        }
    }

    /// Every edge in turn: λ ← max(λ + (t − Jv − cλ)/s, 0).
    #[inline(always)]
    fn edges<const GAIN: bool>(&mut self, rows: &[Row<R>], to: &mut Target<R>) -> Updated<R> {
        let zero = R::zero();
        let [n, a, b] = self.velocity(to.u);
        let velocity = [n + a, n - a, n + b, n - b];
        let mut short: [R; EDGES] =
            from_fn(|i| self.t[i] - velocity[i] - self.c[i] * self.impulse[i]);
        let (mut change, mut gain) = ([zero; EDGES], zero);
        for i in 0..EDGES {
            let new = (short[i] * self.inv_s[i]).max(-self.impulse[i]);
            change[i] = R::select(to.mask, new, zero);
            if GAIN {
                let s = rows[i].a + rows[i].c;
                gain += change[i] * (R::of(0.5) * s * change[i] - short[i]);
            }
            for j in i + 1..EDGES {
                short[j] -= self.between[j * (j - 1) / 2 + i] * change[i];
            }
        }
        let f = [
            (change[0] + change[1]) + (change[2] + change[3]),
            change[0] - change[1],
            change[2] - change[3],
        ];
        self.finish(change, f, gain, to)
    }

    /// The block's own minimum, in one piece.
    #[inline(always)]
    fn convex<const GAIN: bool>(
        &mut self,
        cone: &InCone<R, NARROW>,
        to: &mut Target<R>,
    ) -> Updated<R> {
        let (zero, q) = (R::zero(), self.whole());
        let velocity = self.velocity(to.u);
        let w: [R; NARROW] = from_fn(|i| velocity[i] + self.c[i] * self.impulse[i] - self.t[i]);
        // The gradient at zero impulse of this block: w − Qλ.
        let b = from_fn(|i| w[i] - times(&q[i], &self.impulse));
        let solution = cone.least(&b, to.mask);
        let mut change = [zero; EDGES];
        for i in 0..NARROW {
            change[i] = R::select(to.mask, solution[i] - self.impulse[i], zero);
        }
        let mut gain = zero;
        if GAIN {
            for i in 0..NARROW {
                gain += change[i] * (w[i] + R::of(0.5) * times(&q[i], &change));
            }
        }
        self.finish(change, [change[0], change[1], change[2]], gain, to)
    }

    /// The normal as an interval, then the tangents within its friction bound.
    #[inline(always)]
    fn coulomb(&mut self, cones: &Narrow<R>, to: &mut Target<R>) -> Updated<R> {
        let (zero, q, x) = (R::zero(), self.whole(), self.impulse);
        let velocity = self.velocity(to.u);
        let short: [R; NARROW] = from_fn(|i| self.t[i] - velocity[i] - self.c[i] * x[i]);
        let new = (short[0] * self.inv_s[0]).max(-x[0]);
        let normal = R::select(to.mask, new, zero);
        let slope = [1, 2].map(|i| q[i][0] * normal - short[i]);
        let bound = self.mu * (x[0] + normal);
        let [one, two] = cones.friction(self.tie, slope, &[x[1], x[2]], bound, to.mask);
        let friction = |new: R, old: R| R::select(to.mask, new - old, zero);
        let f = [normal, friction(one, x[1]), friction(two, x[2])];
        self.finish([f[0], f[1], f[2], zero], f, zero, to)
    }

    /// Impulses and u get their changes: those of the rows, and along the directions.
    #[inline(always)]
    fn finish(
        &mut self,
        change: [R; EDGES],
        f: [R; NARROW],
        gain: R,
        to: &mut Target<R>,
    ) -> Updated<R> {
        let mut largest = R::zero();
        for i in 0..EDGES {
            self.impulse[i] += change[i];
            largest = largest.max(change[i].abs() * self.weight[i]);
        }
        let moved = moves(&change);
        if moved.any() {
            self.kick(&f, to, moved);
        }
        Updated { change: largest, gain }
    }

    /// `between` of directions, in full.
    #[inline(always)]
    fn whole(&self) -> [[R; NARROW]; NARROW] {
        let [q00, q10, q11, q20, q21, q22] = self.between;
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

/// The directions n, a and b of edges n ± a and n ± b, if that is what they are.
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

/// y D⁻¹ yᵀ between the edges n ± a and n ± b, rows below the diagonal.
fn of_pyramid<R: Real>([nn, an, aa, bn, ba, bb]: &[R; 6]) -> [R; 6] {
    let (sum, difference) = (*nn + *bn, *nn - *bn);
    let (plus, minus) = (*an + *ba, *an - *ba);
    [*nn - *aa, sum + plus, sum - plus, difference + minus, difference - minus, *nn - *bb]
}

/// Lanes in which some change is one, or no number.
#[inline(always)]
fn moves<R: Real, const N: usize>(change: &[R; N]) -> R::Mask {
    let zero = R::zero();
    change.iter().fold(R::Mask::of(false), |mask, x| mask.or(x.le(zero).and(x.ge(zero)).not()))
}
