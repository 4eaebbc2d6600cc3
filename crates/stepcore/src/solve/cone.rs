//! Round friction cones: projections, and the exact solution of one block (a cone's impulses while
//! all other rows keep theirs).
//!
//! Vectors are (normal, ways of friction): two tangents, or up to five ways with torsion and
//! rolling, each scaled so that all have the first way's bound (`elements/friction.rs`). A block
//! with fewer is padded with zeros, which every function here leaves at zero.
//!
//! A contact that sticks is solved with a factor of Q. When it first slides in a solve, Q is made
//! diagonal: for a convex cone in unit scale (ways over μ, so that the cone is |x_t| ≤ x_n) by a
//! basis V that keeps the cone: VᵀSV = S = diag(1, −1, …), VᵀQV = diag(d). V is a product of
//! rotations among the ways and hyperbolic rotations of the normal with one of them, Jacobi's
//! method for a definite pair (Veselić 1993), which exists because Q is positive definite. On the
//! surface (Q − κS)x = −b with κ ≥ 0, in that basis yₙ = ξₙ/(dₙ − κ), yᵢ = ξᵢ/(dᵢ + κ), ξ = −Vᵀb:
//! one equation for κ. For a Coulomb cone, whose normal is solved by itself, the ways alone are
//! rotated.
//!
//! A block is solved by iteration and through the axes of a matrix. It is differentiated through
//! the conditions that its solution meets, by one Newton step on them (`Real::implicit`): an
//! iteration stops when its values converge, and their derivatives converge later, or never.

use super::rows::{CONE, NARROW};
use crate::real::array::{from_fn, map};
use crate::real::{Mask, Real};

/// Rounds of rotations; five to eight are usual.
const ROUNDS: usize = 16;
/// Newton's limit for the two scalar equations here; four or five are usual.
const STEPS: usize = 40;
/// A length within this many roundings of its bound is on it.
const ROUNDINGS: f64 = 16.0;

pub(super) type Matrix<R, const N: usize> = [[R; N]; N];

/// Returns the nearest point of the round cone |x_t| ≤ μ x_n.
pub fn project_round<R: Real, const N: usize>(mu: R, x: [R; N]) -> [R; N] {
    let a = across(&x);
    let inside = a.le(mu * x[0]);
    let n = ((x[0] + mu * a) / (R::one() + mu * mu)).max(R::zero());
    let k = mu * n * a.recip_or_zero();
    from_fn(|i| R::select(inside, x[i], if i == 0 { n } else { k * x[i] }))
}

/// Returns the nearest point of the box cone |x_i| ≤ μ x_n.
///
/// n is the root of the increasing function n − x_n − μ Σ (|x_i| − μ n)₊. If the m largest ways are
/// at their bound, the root is (x_n + μ Σ |x_i|)/(1 + m μ²); n is the largest of these, because the
/// function is concave in m.
pub fn project_box<R: Real, const N: usize>(mu: R, x: [R; N]) -> [R; N] {
    let mut size: [R; N] = x.map(R::abs);
    // Sort in descending order by exchanges.
    for end in (2..N).rev() {
        for i in 1..end {
            (size[i], size[i + 1]) = (size[i].max(size[i + 1]), size[i].min(size[i + 1]));
        }
    }
    let (mut n, mut sum, mut count) = (x[0], x[0], R::one());
    for size in &size[1..] {
        sum += mu * *size;
        count += mu * mu;
        n = R::select(size.gt(mu * n), sum / count, n);
    }
    let n = n.max(R::zero());
    let bound = mu * n;
    from_fn(|i| if i == 0 { n } else { x[i].clamp(-bound, bound) })
}

/// Returns the nearest point of the round cone for vectors with `len` entries.
#[inline(always)]
pub(super) fn project_some<R: Real>(mu: R, x: [R; CONE], len: usize) -> [R; CONE] {
    if len > NARROW {
        return project_round(mu, x);
    }
    let near = project_round::<R, NARROW>(mu, from_fn(|i| x[i]));
    from_fn(|i| if i < NARROW { near[i] } else { x[i] })
}

/// |x_t|.
#[inline(always)]
pub(super) fn across<R: Real, const N: usize>(x: &[R; N]) -> R {
    length(&x[1..])
}

#[inline(always)]
pub(super) fn length<R: Real>(x: &[R]) -> R {
    let mut sum = x[0] * x[0];
    for x in &x[1..] {
        sum += *x * *x;
    }
    sum.sqrt()
}

/// The quadratic ½ λᵀQλ on a round cone, prepared for many right-hand sides.
#[derive(Clone, Copy, Debug)]
pub(super) struct InCone<R: Real, const N: usize> {
    pub q: Matrix<R, N>,
    mu: R,
    /// In unit scale.
    factor: Factor<R, N>,
    /// In unit scale; computed when a minimiser lies on the surface, or when Q has no sound factor.
    axes: Option<Axes<R, N>>,
}

impl<R: Real, const N: usize> InCone<R, N> {
    /// Prepares a positive definite Q, read from its lower half.
    pub fn new(q: Matrix<R, N>, mu: R) -> Self {
        let q = symmetric(&q);
        Self { factor: Factor::of(&unit_measure(&q, mu)), q, mu, axes: None }
    }

    fn axes(&mut self) -> &Axes<R, N> {
        let Self { q, mu, axes, .. } = self;
        axes.get_or_insert_with(|| Axes::of_cone(unit_measure(q, *mu)))
    }

    #[inline(always)]
    fn in_unit(&self, x: &[R; N]) -> [R; N] {
        from_fn(|i| if i == 0 { x[0] } else { self.mu * x[i] })
    }

    /// Returns the minimiser of ½ λᵀQλ + b·λ over |λ_t| ≤ μ λ_n.
    pub fn least(&mut self, b: &[R; N], mask: R::Mask) -> [R; N] {
        let x = self.minimiser(b, mask);
        R::implicit(x, |x| self.newton_step(b, &x))
    }

    fn minimiser(&mut self, b: &[R; N], mask: R::Mask) -> [R; N] {
        let b = self.in_unit(b);
        let apart = across(&b).le(b[0]);
        let free = self.factor.minimiser(&b);
        let closed = apart.or(self.factor.sound.and(across(&free).le(free[0])));
        let mut out = select::<R, N>(apart, [R::zero(); N], free);
        let open = mask.and(closed.not());
        if open.any() {
            out = select::<R, N>(closed, out, self.along_axes(&b, open));
        }
        self.in_unit(&out)
    }

    /// Returns the minimiser in unit scale, in lanes in which it is not at the tip.
    #[inline(never)] // For sliding contacts: copies in each caller would only be large.
    fn along_axes(&mut self, b: &[R; N], open: R::Mask) -> [R; N] {
        let axes = self.axes();
        let along = back(&axes.v, b);
        let xi: [R; N] = from_fn(|i| -along[i]);
        let free = times(&axes.v, &from_fn(|i| xi[i] * axes.inv_d[i]));
        let inside = across(&free).le(free[0]);
        let todo = open.and(inside.not());
        if todo.none() {
            return free;
        }
        select::<R, N>(inside, free, Self::surface(axes, &xi, todo))
    }

    /// The minimiser on the surface, with N = |y_t|: for ξₙ ≥ 0, solve κ − dₙ + ξₙ/N(κ) = 0 for κ;
    /// for ξₙ < 0, solve the same equation over κ for 1/κ. Both are increasing and concave in the
    /// unknown, and negative at 0, so Newton from there never overshoots.
    #[inline(always)]
    fn surface(axes: &Axes<R, N>, xi: &[R; N], mut todo: R::Mask) -> [R; N] {
        let (zero, one, d) = (R::zero(), R::one(), &axes.d);
        let up = xi[0].ge(zero);
        let r = xi[0].abs();
        let pick = |yes: R, no: R| R::select(up, yes, no);
        let (a, rest) = (pick(one, d[0]), pick(d[0], one));
        // yᵢ = ξᵢ/(f + g x), times x where x is 1/κ.
        let f: [R; N] = from_fn(|i| pick(d[i], one));
        let g: [R; N] = from_fn(|i| pick(one, d[i]));
        let mut x = zero;
        for _ in 0..STEPS {
            let (mut length2, mut bend) = (zero, zero);
            for i in 1..N {
                let inv = (f[i] + g[i] * x).recip_or_zero();
                let p = xi[i] * xi[i] * inv * inv;
                length2 += p;
                bend += p * g[i] * inv;
            }
            let inv = length2.sqrt().recip_or_zero();
            let value = a * x - rest + r * inv;
            let slope = a + r * inv * inv * inv * bend;
            let next = x - value / slope;
            todo = todo.and(next.gt(x));
            if todo.none() {
                break;
            }
            x = R::select(todo, next, x);
        }
        let k = pick(one, x);
        let mut y: [R; N] = from_fn(|i| k * xi[i] * (f[i] + g[i] * x).recip_or_zero());
        y[0] = across(&y);
        let out = times(&axes.v, &y);
        let n = out[0].max(zero);
        let fit = n * across(&out).recip_or_zero();
        from_fn(|i| if i == 0 { n } else { fit * out[i] })
    }

    /// One Newton step from x on the conditions of the solution. Outside: 0. Inside: Qx + b = 0. On
    /// the surface, with r = Qx + b − κSx, which is 0: (Q − κS)dx − Sx dκ = −r and Sx·dx = 0, which
    /// is diagonal in y except for dκ.
    fn newton_step(&mut self, b: &[R; N], x: &[R; N]) -> [R; N] {
        let (zero, Axes { v, d, inv_d }) = (R::zero(), *self.axes());
        let w = times(&self.q, x);
        let w = self.in_unit(&from_fn(|i| w[i] + b[i]));
        let per_mu = self.mu.recip_or_zero();
        let z: [R; N] = from_fn(|i| if i == 0 { x[0] } else { x[i] * per_mu });
        let some = z[0].gt(zero);
        let inside = across(&z).lt(z[0] * R::of(1.0 - ROUNDINGS * R::epsilon()));
        let signed = |x: &[R; N]| -> [R; N] { from_fn(|i| if i == 0 { x[0] } else { -x[i] }) };
        let free = back(&v, &w);
        let free = times(&v, &from_fn(|i| -free[i] * inv_d[i]));
        // On the surface, in y: V⁻¹ = SVᵀS.
        let y = signed(&back(&v, &signed(&z)));
        let kappa = w[0] * z[0].recip_or_zero();
        let bent = signed(&z);
        let rho = back(&v, &from_fn(|i| w[i] - kappa * bent[i]));
        let inv: [R; N] = from_fn(|i| (d[i] + kappa).recip_or_zero());
        let per_y = y[0].recip_or_zero();
        let (pull, give) = reach(&y, &rho, &inv, 1);
        let stiff = d[0] - kappa;
        let turn = (-pull - give * rho[0] * per_y) / (R::one() + give * stiff * per_y * per_y);
        let first = turn * per_y;
        let change = (stiff * first + rho[0]) * per_y;
        let rim = |i: usize| if i == 0 { first } else { -(rho[i] + y[i] * change) * inv[i] };
        let rim = times(&v, &from_fn(rim));
        let step = self.in_unit(&select::<R, N>(inside, free, rim));
        from_fn(|i| R::select(some, x[i] + step[i], zero))
    }
}

/// The quadratic ½ xᵀQx on a ball, prepared for many right-hand sides: the friction of a Coulomb
/// contact.
#[derive(Clone, Copy, Debug)]
pub(super) struct InBall<R: Real, const N: usize> {
    pub q: Matrix<R, N>,
    factor: Factor<R, N>,
    /// Computed when a minimiser lies on the rim, or when Q has no sound factor.
    axes: Option<Axes<R, N>>,
}

/// Q = LDLᵀ.
#[derive(Clone, Copy, Debug)]
struct Factor<R: Real, const N: usize> {
    l: Matrix<R, N>,
    inv_d: [R; N],
    /// Lanes in which no pivot is rounding; missing ways are ignored.
    sound: R::Mask,
}

/// VᵀQV = diag(d).
#[derive(Clone, Copy, Debug)]
struct Axes<R: Real, const N: usize> {
    v: Matrix<R, N>,
    d: [R; N],
    inv_d: [R; N],
}

impl<R: Real, const N: usize> Factor<R, N> {
    #[inline(always)]
    fn of(q: &Matrix<R, N>) -> Self {
        let zero = R::zero();
        let floor = R::of(ROUNDINGS * R::epsilon()) * largest(&from_fn::<R, N>(|i| q[i][i]));
        let mut l = [[zero; N]; N];
        let (mut d, mut inv_d, mut sound) = ([zero; N], [zero; N], R::Mask::of(true));
        for i in 0..N {
            for j in 0..i {
                l[i][j] = (0..j).fold(q[i][j], |x, k| x - l[i][k] * l[j][k] * d[k]) * inv_d[j];
            }
            d[i] = (0..i).fold(q[i][i], |x, k| x - l[i][k] * l[i][k] * d[k]);
            inv_d[i] = d[i].recip_or_zero();
            sound = sound.and(d[i].gt(floor).or(q[i][i].le(zero)));
        }
        Self { l, inv_d, sound }
    }

    /// −Q⁻¹g.
    #[inline(always)]
    fn minimiser(&self, g: &[R; N]) -> [R; N] {
        let mut x = map(*g, |g| -g);
        for i in 0..N {
            x[i] = (0..i).fold(x[i], |sum, k| sum - self.l[i][k] * x[k]);
        }
        for i in (0..N).rev() {
            x[i] = (i + 1..N).fold(x[i] * self.inv_d[i], |sum, k| sum - self.l[k][i] * x[k]);
        }
        x
    }
}

impl<R: Real, const N: usize> Axes<R, N> {
    /// With a V that keeps the unit cone.
    #[inline(never)] // At most once per cone and solve.
    fn of_cone(q: Matrix<R, N>) -> Self {
        let (v, d) = diagonal(q, true);
        Self { v, d, inv_d: map(d, R::recip_or_zero) }
    }

    /// With rotations.
    #[inline(never)]
    fn of(q: Matrix<R, N>) -> Self {
        let (v, d) = diagonal(q, false);
        // If an eigenvalue is zero up to rounding, nothing moves along its direction.
        let floor = R::of(ROUNDINGS * R::epsilon()) * largest(&d);
        let d = d.map(|d| R::select(d.gt(floor), d, R::zero()));
        Self { v, d, inv_d: d.map(R::recip_or_zero) }
    }
}

impl<R: Real, const N: usize> InBall<R, N> {
    /// Prepares a positive semi-definite Q, read from its lower half.
    pub fn new(q: Matrix<R, N>) -> Self {
        let q = symmetric(&q);
        Self { factor: Factor::of(&q), q, axes: None }
    }

    fn axes(&mut self) -> Axes<R, N> {
        *self.axes.get_or_insert_with(|| Axes::of(self.q))
    }

    /// Returns the minimiser of ½ xᵀQx + g·x over the ball |x| ≤ bound.
    pub fn least(&mut self, g: &[R; N], bound: R, mask: R::Mask) -> [R; N] {
        let mut x = self.factor.minimiser(g);
        let inside = self.factor.sound.and(length(&x).le(bound));
        let none = bound.le(R::zero());
        let open = mask.and(inside.or(none).not());
        if open.any() {
            x = select::<R, N>(inside, x, self.along_axes(g, bound, open));
        }
        x = select::<R, N>(none, [R::zero(); N], x);
        R::implicit(x, |x| self.newton_step(g, bound, &x))
    }

    /// Inside: −Q⁻¹g. Else −(Q + m)⁻¹g with the m ≥ 0 that brings it to the rim: 1/|x(m)| is
    /// increasing and concave, so Newton from the left never overshoots.
    fn along_axes(&mut self, g: &[R; N], bound: R, mask: R::Mask) -> [R; N] {
        let (zero, Axes { ref v, d, inv_d }) = (R::zero(), self.axes());
        let along = back(v, g);
        let g: [R; N] = from_fn(|i| R::select(d[i].gt(zero), along[i], zero));
        let y: [R; N] = from_fn(|i| -g[i] * inv_d[i]);
        let inside = length(&y).le(bound);
        let free = times(v, &y);
        let mut todo = mask.and(inside.not());
        if todo.none() {
            return free;
        }
        // |x| ≥ |g| / (d_max + m) bounds m from below.
        let mut m = (length(&g) / bound - largest(&d)).max(zero);
        for _ in 0..STEPS {
            let (mut length2, mut slope) = (zero, zero);
            for i in 0..N {
                let inv = (d[i] + m).recip_or_zero();
                let p = g[i] * inv;
                length2 += p * p;
                slope += p * p * inv;
            }
            let step = (length2.sqrt() / bound - R::one()) * length2 * slope.recip_or_zero();
            let next = m + step;
            todo = todo.and(next.gt(m));
            if todo.none() {
                break;
            }
            m = R::select(todo, next, m);
        }
        let p: [R; N] = from_fn(|i| -g[i] * (d[i] + m).recip_or_zero());
        // Exactly on the rim.
        let k = bound * length(&p).recip_or_zero();
        let rim = times(v, &p.map(|p| k * p));
        select::<R, N>(inside, free, rim)
    }

    /// Makes one Newton step from x: inside Qx + g = 0; on the rim (Q + m)x + g = 0 and |x| = bound.
    fn newton_step(&mut self, g: &[R; N], bound: R, x: &[R; N]) -> [R; N] {
        let (zero, Axes { ref v, d, inv_d }) = (R::zero(), self.axes());
        let turned = times(&self.q, x);
        let inside = length(x).lt(bound * R::of(1.0 - ROUNDINGS * R::epsilon()));
        let along = back(v, &from_fn(|i| turned[i] + g[i]));
        let y = back(v, x);
        let length2 = sum::<R, N>(|i| y[i] * y[i]);
        let m = -sum::<R, N>(|i| along[i] * y[i]) * length2.recip_or_zero();
        let m = m.max(zero);
        let inv: [R; N] = from_fn(|i| (d[i] + m).recip_or_zero());
        let rho: [R; N] = from_fn(|i| along[i] + m * y[i]);
        let (pull, give) = reach(&y, &rho, &inv, 0);
        let out = R::of(0.5) * (bound * bound - length2);
        let change = -(out + pull) * give.recip_or_zero();
        let step = times(
            v,
            &from_fn(|i| {
                let free = -along[i] * inv_d[i];
                R::select(inside, free, -(rho[i] + y[i] * change) * inv[i])
            }),
        );
        from_fn(|i| R::select(bound.gt(zero), x[i] + step[i], zero))
    }
}

#[inline(always)]
fn select<R: Real, const N: usize>(mask: R::Mask, yes: [R; N], no: [R; N]) -> [R; N] {
    from_fn(|i| R::select(mask, yes[i], no[i]))
}

/// Mx.
#[inline(always)]
pub(super) fn times<R: Real, const N: usize>(m: &Matrix<R, N>, x: &[R; N]) -> [R; N] {
    from_fn(|i| sum::<R, N>(|k| m[i][k] * x[k]))
}

/// Mᵀx.
#[inline(always)]
fn back<R: Real, const N: usize>(m: &Matrix<R, N>, x: &[R; N]) -> [R; N] {
    from_fn(|i| sum::<R, N>(|k| m[k][i] * x[k]))
}

/// Returns Σ y ρ / e and Σ y² / e from an entry on.
fn reach<R: Real, const N: usize>(y: &[R; N], rho: &[R; N], inv: &[R; N], first: usize) -> (R, R) {
    let (mut pull, mut give) = (R::zero(), R::zero());
    for i in first..N {
        pull += y[i] * rho[i] * inv[i];
        give += y[i] * y[i] * inv[i];
    }
    (pull, give)
}

#[inline(always)]
fn sum<R: Real, const N: usize>(term: impl Fn(usize) -> R) -> R {
    let mut sum = term(0);
    for k in 1..N {
        sum += term(k);
    }
    sum
}

fn largest<R: Real>(x: &[R]) -> R {
    x.iter().fold(R::zero(), |most, x| most.max(*x))
}

/// Q with ways divided by μ.
#[inline(always)]
fn unit_measure<R: Real, const N: usize>(q: &Matrix<R, N>, mu: R) -> Matrix<R, N> {
    let scale = |i: usize| if i == 0 { R::one() } else { mu };
    from_fn(|i| from_fn(|j| q[i][j] * (scale(i) * scale(j))))
}

/// Uses the lower half for both halves: the upper one differs by rounding.
fn symmetric<R: Real, const N: usize>(q: &Matrix<R, N>) -> Matrix<R, N> {
    from_fn(|i| from_fn(|j| q[i.max(j)][i.min(j)]))
}

/// V and d with VᵀQV = diag(d) and VᵀSV = S, where S is diag(1, −1, …) for a `cone`, and else 1.
fn diagonal<R: Real, const N: usize>(mut q: Matrix<R, N>, cone: bool) -> (Matrix<R, N>, [R; N]) {
    let unit = |i: usize, j: usize| if i == j { R::one() } else { R::zero() };
    let mut v: Matrix<R, N> = from_fn(|i| from_fn(|j| unit(i, j)));
    for _ in 0..ROUNDS {
        let mut turned = false;
        for i in 0..N {
            for j in i + 1..N {
                turned |= turn(&mut q, &mut v, i, j, cone && i == 0);
            }
        }
        if !turned {
            break;
        }
    }
    (v, from_fn(|i| q[i][i]))
}

/// Eliminates q_ij where it is more than rounding; returns whether some lane did.
fn turn<R: Real, const N: usize>(
    q: &mut Matrix<R, N>,
    v: &mut Matrix<R, N>,
    i: usize,
    j: usize,
    hyperbolic: bool,
) -> bool {
    let (a, b, o) = (q[i][i], q[j][j], q[i][j]);
    let rounding = R::of(R::epsilon() * R::epsilon());
    let large = (o * o).gt(rounding * (a * b));
    if large.none() {
        return false;
    }
    // New columns: c vᵢ − s vⱼ and s' vᵢ + c vⱼ.
    let (c, s, t) = if hyperbolic { boost(a, o, b) } else { rotation(a, o, b) };
    let other = if hyperbolic { -s } else { s };
    let change = t * o;
    q[i][i] = R::select(large, a - change, a);
    q[j][j] = R::select(large, if hyperbolic { b - change } else { b + change }, b);
    q[i][j] = R::select(large, R::zero(), o);
    q[j][i] = q[i][j];
    for k in 0..N {
        if k != i && k != j {
            let (p, r) = (q[k][i], q[k][j]);
            q[k][i] = R::select(large, c * p - s * r, p);
            q[k][j] = R::select(large, other * p + c * r, r);
            (q[i][k], q[j][k]) = (q[k][i], q[k][j]);
        }
        let (p, r) = (v[k][i], v[k][j]);
        v[k][i] = R::select(large, c * p - s * r, p);
        v[k][j] = R::select(large, other * p + c * r, r);
    }
    true
}

/// Cosine, sine and tangent of the rotation that makes [[p, o], [o, q]] diagonal.
fn rotation<R: Real>(p: R, o: R, q: R) -> (R, R, R) {
    let zero = R::zero();
    let theta = (q - p) / (o + o);
    let t = R::one() / (theta.abs() + (R::one() + theta * theta).sqrt());
    let t = R::select(theta.lt(zero), -t, t);
    let t = R::select(o.abs().gt(zero), t, zero);
    let c = R::one() / (R::one() + t * t).sqrt();
    (c, t * c, t)
}

/// Cosh, sinh and tanh of the hyperbolic rotation that makes [[p, o], [o, q]] diagonal.
fn boost<R: Real>(p: R, o: R, q: R) -> (R, R, R) {
    let (zero, one) = (R::zero(), R::one());
    let zeta = (p + q) / (o + o);
    let size = zeta.abs();
    let t = one / (size + ((size - one) * (size + one)).max(zero).sqrt());
    let t = t.min(R::of(1.0 - 4.0 * R::epsilon()));
    let t = R::select(zeta.lt(zero), -t, t);
    let t = R::select(o.abs().gt(zero), t, zero);
    let c = one / ((one - t) * (one + t)).sqrt();
    (c, t * c, t)
}
