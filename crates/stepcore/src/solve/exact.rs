//! The exact solution of one block: a cone's impulses while all other rows hold theirs.
//!
//! A block is solved by iteration or through the axes of a matrix, and differentiated
//! through the conditions that its solution meets: see `implicit.rs`.

use super::cone::{norm, select2, select3};
use super::implicit::{in_disc, on_cone};
use crate::real::{Mask, Real};

/// A symmetric 2 × 2 matrix as rotation and eigenvalues: what the tangents of a
/// Coulomb contact can do.
#[derive(Clone, Copy, Debug)]
pub struct Tangents<R: Real> {
    /// q₁₁, q₁₂, q₂₂.
    pub(super) q: [R; 3],
    cos: R,
    sin: R,
    d: [R; 2],
}

impl<R: Real> Tangents<R> {
    /// From q₁₁, q₁₂, q₂₂; positive semi-definite.
    pub fn new(q11: R, q12: R, q22: R) -> Self {
        let (c, s, t) = rotation(q11, q12, q22);
        let (d1, d2) = (q11 - t * q12, q22 + t * q12);
        // What rounding leaves of a zero eigenvalue is a direction that nothing moves.
        let floor = R::of(4.0 * R::epsilon()) * d1.max(d2);
        let clean = |d: R| R::select(d.gt(floor), d, R::zero());
        Self { q: [q11, q12, q22], cos: c, sin: s, d: [clean(d1), clean(d2)] }
    }

    /// The minimiser of ½ xᵀQx + g·x over the disc |x| ≤ bound.
    ///
    /// Inside: −Q⁻¹g. Else −(Q + m)⁻¹g with the m ≥ 0 that brings it to the rim:
    /// 1/|x(m)| is increasing and concave, so Newton from the left never overshoots.
    pub fn disc(&self, g: [R; 2], bound: R, mask: R::Mask) -> [R; 2] {
        R::implicit(self.minimiser(g, bound, mask), |x| in_disc(&self.q, bound, &g, x))
    }

    fn minimiser(&self, g: [R; 2], bound: R, mask: R::Mask) -> [R; 2] {
        let zero = R::zero();
        let clean = |d: R, g: R| R::select(d.gt(zero), g, zero);
        let g1 = clean(self.d[0], self.cos * g[0] - self.sin * g[1]);
        let g2 = clean(self.d[1], self.sin * g[0] + self.cos * g[1]);
        let back = |a: R, b: R| [self.cos * a + self.sin * b, self.cos * b - self.sin * a];
        let (x1, x2) = (-g1 * self.d[0].recip_or_zero(), -g2 * self.d[1].recip_or_zero());
        let inside = norm(x1, x2).le(bound);
        let free = back(x1, x2);
        let none = bound.le(zero);
        let mut live = mask.and(inside.or(none).not());
        if live.none() {
            return select2(none, [zero; 2], free);
        }
        let at = |m: R| ((self.d[0] + m).recip_or_zero(), (self.d[1] + m).recip_or_zero());
        // |x| ≥ |g| / (d_max + m) bounds m from below.
        let mut m = (norm(g1, g2) / bound - self.d[0].max(self.d[1])).max(zero);
        for _ in 0..STEPS {
            let (i1, i2) = at(m);
            let (p1, p2) = (g1 * i1, g2 * i2);
            let length2 = p1 * p1 + p2 * p2;
            let slope = p1 * p1 * i1 + p2 * p2 * i2;
            let step = (length2.sqrt() / bound - R::one()) * length2 * slope.recip_or_zero();
            let next = m + step;
            live = live.and(next.gt(m));
            if live.none() {
                break;
            }
            m = R::select(live, next, m);
        }
        let (i1, i2) = at(m);
        let (p1, p2) = (-g1 * i1, -g2 * i2);
        // On the rim exactly.
        let k = bound * norm(p1, p2).recip_or_zero();
        select2(none, [zero; 2], select2(inside, free, back(k * p1, k * p2)))
    }
}

/// A symmetric 2 × 2 matrix with the inverses that its minima over a box need.
#[derive(Clone, Copy, Debug)]
pub struct TangentBox<R: Real> {
    pub(super) q: [R; 3],
    /// Of q₁₁, q₂₂, and of q₁₁ with x₂ at its best.
    inv: [R; 3],
}

impl<R: Real> TangentBox<R> {
    /// From q₁₁, q₁₂, q₂₂; positive semi-definite.
    pub fn new(q: [R; 3]) -> Self {
        let [q11, q12, q22] = q;
        let (i1, i2) = (q11.recip_or_zero(), q22.recip_or_zero());
        let schur = q11 - q12 * q12 * i2;
        let schur = R::select(schur.gt(R::of(4.0 * R::epsilon()) * q11), schur, R::zero());
        Self { q, inv: [i1, i2, schur.recip_or_zero()] }
    }

    /// The minimiser of ½ xᵀQx + g·x over the box |x_i| ≤ bound.
    ///
    /// With x₂ at its best for a given x₁ the cost is convex in x₁ with three
    /// quadratic pieces (x₂ free, at one bound, at the other); x₂ at the root of the
    /// free piece tells which piece holds the minimum.
    pub fn minimiser(&self, g: [R; 2], bound: R) -> [R; 2] {
        let ([_, q12, _], [i1, i2, inv]) = (self.q, self.inv);
        let second = |x1: R| -(g[1] + q12 * x1) * i2;
        let free = -(g[0] - q12 * g[1] * i2) * inv;
        let x2 = second(free);
        let held = -(g[0] + q12 * x2.clamp(-bound, bound)) * i1;
        let x1 = R::select(x2.abs().le(bound), free, held).clamp(-bound, bound);
        [x1, second(x1).clamp(-bound, bound)]
    }
}

/// Newton's limit for the two scalar equations here; four or five are usual.
pub(super) const STEPS: usize = 40;

/// The quadratic ½ λᵀQλ on a round cone, prepared for many right-hand sides.
///
/// Let S = diag(μ², −1, −1), so that the cone's surface is λᵀSλ = 0, and V the
/// basis with VᵀQV = 1 and VᵀSV = diag(σ₀, −σ₁, −σ₂). On the surface
/// (Q − κS)λ = −b with κ ≥ 0, so in that basis λ has the coordinates
/// ξ₀/(1 − κσ₀), ξ₁/(1 + κσ₁), ξ₂/(1 + κσ₂), where ξ = −Vᵀb.
#[derive(Clone, Copy, Debug)]
pub struct Convex<R: Real> {
    /// Q's lower triangle, rows first: q₀₀, q₁₀, q₁₁, q₂₀, q₂₁, q₂₂.
    pub(super) q: [R; 6],
    mu: R,
    /// 1/Q₀₀: everything below belongs to Q/Q₀₀, which has no unit.
    scale: R,
    v: [[R; 3]; 3],
    sigma: [R; 3],
}

impl<R: Real> Convex<R> {
    /// From Q's lower triangle, rows first.
    pub fn new(given: [R; 6], mu: R) -> Self {
        let (zero, one) = (R::zero(), R::one());
        let scale = given[0].recip_or_zero();
        let q = given.map(|x| x * scale);
        // Q = L D Lᵀ, W = L⁻ᵀ D^-½, so WᵀQW = 1.
        let (l10, l20) = (q[1], q[3]);
        let d1 = q[2] - l10 * q[1];
        let l21 = (q[4] - l20 * q[1]) * d1.recip_or_zero();
        let d2 = q[5] - l20 * q[3] - l21 * l21 * d1;
        let (r1, r2) = (d1.recip_or_zero().sqrt(), d2.recip_or_zero().sqrt());
        let mut v =
            [[one, -l10 * r1, (l10 * l21 - l20) * r2], [zero, r1, -l21 * r2], [zero, zero, r2]];
        let s = [mu * mu, -one, -one];
        let mut b = [[zero; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                for k in 0..3 {
                    b[i][j] += v[k][i] * s[k] * v[k][j];
                }
            }
        }
        // Jacobi: quadratic, and done to rounding after at most five rounds.
        for _ in 0..5 {
            for (p, q) in [(0, 1), (0, 2), (1, 2)] {
                rotate(&mut b, &mut v, p, q);
            }
        }
        // The one positive eigenvalue first; its vector points into the cone.
        for i in 1..3 {
            let swap = b[i][i].gt(b[0][0]);
            (b[0][0], b[i][i]) =
                (R::select(swap, b[i][i], b[0][0]), R::select(swap, b[0][0], b[i][i]));
            for row in &mut v {
                (row[0], row[i]) =
                    (R::select(swap, row[i], row[0]), R::select(swap, row[0], row[i]));
            }
        }
        let down = v[0][0].lt(zero);
        for row in &mut v {
            row[0] = R::select(down, -row[0], row[0]);
        }
        Self { q: given, mu, scale, v, sigma: [b[0][0], -b[1][1], -b[2][2]] }
    }

    /// The minimiser of ½ λᵀQλ + b·λ over |λ_t| ≤ μ λ_n.
    pub fn solve(&self, b: [R; 3], mask: R::Mask) -> [R; 3] {
        R::implicit(self.minimiser(b, mask), |x| on_cone(&self.q, self.mu, &b, x))
    }

    fn minimiser(&self, b: [R; 3], mask: R::Mask) -> [R; 3] {
        let zero = R::zero();
        let apart = (self.mu * norm(b[1], b[2])).le(b[0]);
        let b = b.map(|x| x * self.scale);
        let mut xi = [zero; 3];
        for i in 0..3 {
            for k in 0..3 {
                xi[i] -= self.v[k][i] * b[k];
            }
        }
        let free = self.combine(xi);
        let inside = norm(free[1], free[2]).le(self.mu * free[0]);
        let live = mask.and(apart.or(inside).not());
        let closed = select3(apart, [zero; 3], free);
        if live.none() {
            return closed;
        }
        select3(apart.or(inside), closed, self.surface(xi, live))
    }

    fn combine(&self, c: [R; 3]) -> [R; 3] {
        self.v.map(|row| row[0] * c[0] + row[1] * c[1] + row[2] * c[2])
    }

    /// The minimiser on the surface. λᵀSλ = 0 is √σ₀ ξ₀/(1 − κσ₀) = N(κ), with
    /// N² = Σ σᵢξᵢ²/(1 + κσᵢ)²: for ξ₀ ≥ 0 solved for κ in κσ₀ − 1 + √σ₀ξ₀/N = 0, for
    /// ξ₀ < 0 for 1/κ in the same equation over κ. Both are increasing and concave
    /// in their unknown, and negative at 0, so Newton from there never overshoots.
    fn surface(&self, xi: [R; 3], mut live: R::Mask) -> [R; 3] {
        let (zero, one) = (R::zero(), R::one());
        let [s0, s1, s2] = self.sigma;
        let up = xi[0].ge(zero);
        let root = s0.max(zero).sqrt();
        let r = root * xi[0].abs();
        let (a, rest) = (R::select(up, s0, one), R::select(up, one, s0));
        let (f1, g1) = (R::select(up, one, s1), R::select(up, s1, one));
        let (f2, g2) = (R::select(up, one, s2), R::select(up, s2, one));
        let (e1, e2) = (s1 * xi[1] * xi[1], s2 * xi[2] * xi[2]);
        let mut x = zero;
        for _ in 0..STEPS {
            let (i1, i2) = ((f1 + g1 * x).recip_or_zero(), (f2 + g2 * x).recip_or_zero());
            let (p1, p2) = (e1 * i1 * i1, e2 * i2 * i2);
            let inv = (p1 + p2).sqrt().recip_or_zero();
            let value = a * x - rest + r * inv;
            let slope = a + r * inv * inv * inv * (p1 * g1 * i1 + p2 * g2 * i2);
            let next = x - value / slope;
            live = live.and(next.gt(x));
            if live.none() {
                break;
            }
            x = R::select(live, next, x);
        }
        // Coordinates with κ = x, or with κ = 1/x multiplied through by x.
        let (i1, i2) = ((f1 + g1 * x).recip_or_zero(), (f2 + g2 * x).recip_or_zero());
        let k = R::select(up, one, x);
        let (c1, c2) = (k * xi[1] * i1, k * xi[2] * i2);
        let c0 = (s1 * c1 * c1 + s2 * c2 * c2).sqrt() * root.recip_or_zero();
        let out = self.combine([c0, c1, c2]);
        let n = out[0].max(zero);
        let fit = self.mu * n * norm(out[1], out[2]).recip_or_zero();
        [n, fit * out[1], fit * out[2]]
    }
}

/// Cosine, sine and tangent of the rotation that makes [[p, o], [o, q]] diagonal.
pub(super) fn rotation<R: Real>(p: R, o: R, q: R) -> (R, R, R) {
    let zero = R::zero();
    let theta = (q - p) / (o + o);
    let t = R::one() / (theta.abs() + (R::one() + theta * theta).sqrt());
    let t = R::select(theta.lt(zero), -t, t);
    let t = R::select(o.abs().gt(zero), t, zero);
    let c = R::one() / (R::one() + t * t).sqrt();
    (c, t * c, t)
}

/// One Jacobi rotation of b in the plane (p, q), and of the basis v with it.
fn rotate<R: Real>(b: &mut [[R; 3]; 3], v: &mut [[R; 3]; 3], p: usize, q: usize) {
    let (c, s, t) = rotation(b[p][p], b[p][q], b[q][q]);
    let other = 3 - p - q;
    let change = t * b[p][q];
    b[p][p] -= change;
    b[q][q] += change;
    b[p][q] = R::zero();
    b[q][p] = R::zero();
    let (bp, bq) = (b[other][p], b[other][q]);
    (b[other][p], b[other][q]) = (c * bp - s * bq, s * bp + c * bq);
    (b[p][other], b[q][other]) = (b[other][p], b[other][q]);
    for row in v {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
}
