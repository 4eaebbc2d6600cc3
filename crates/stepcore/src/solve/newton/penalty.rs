//! The cost of a block in the primal problem, and its derivatives.
//!
//! With w = y·u − t the impulse minimises ½ λᵀCλ + λ·w over the set; the penalty is
//! s(w) = −min, its slope −λ, its curvature s″ = −∂λ/∂w.
//!
//! A cone has c_t = (c_n/k²) for some k. In q = c_n λ_n, (c_n/k) λ_t the matrix C is a
//! number, so that q is the projection of (−w_n, −k w_t) on the cone of slope μ/k
//! (which is MuJoCo's μ/√impratio): inside, outside, or between, where s is smooth
//! but not quadratic.

use crate::real::{Mask, Real};
use crate::solve::cone::{across, project_round};
use crate::solve::rows::Row;

/// Returns −w/c within the bounds, and its curvature.
#[inline(always)]
pub(super) fn interval<R: Real>([lo, hi]: [R; 2], inv_c: R, w: R) -> (R, R) {
    let free = -w * inv_c;
    let active = free.gt(lo).and(free.lt(hi));
    (free.clamp(lo, hi), R::select(active, inv_c, R::zero()))
}

/// The constants of a convex cone.
#[derive(Clone, Copy)]
pub(super) struct Cone<R> {
    pub mu: R,
    inv_c: R,
    k: R,
    slope: R,
}

impl<R: Real> Cone<R> {
    /// From the rows of a block: the normal, then tangents of one regulariser.
    pub fn new(rows: &[Row<R>], mu: R) -> Self {
        let c = rows.first().map_or(R::zero(), |row| row.c);
        let tangent = rows.get(1).map_or(c, |row| row.c);
        let k = (c * tangent.recip_or_zero()).sqrt();
        Self { mu, inv_c: c.recip_or_zero(), k, slope: mu * k.recip_or_zero() }
    }

    /// Returns λ, and the derivative of λ with respect to −w.
    #[inline(always)]
    pub fn law<const N: usize>(&self, w: [R; N]) -> ([R; N], [[R; N]; N]) {
        let (zero, one) = (R::zero(), R::one());
        let m = self.slope;
        let a: [R; N] =
            crate::real::array::from_fn(|i| if i == 0 { -w[0] } else { -self.k * w[i] });
        let length = across(&a);
        let q = project_round(m, a);
        let inside = length.le(m * a[0]);
        let outside = (m * length).le(-a[0]).and(inside.not());
        let mut scale = [self.k; N];
        scale[0] = one;
        let impulse = crate::real::array::from_fn(|i| q[i] * scale[i] * self.inv_c);
        let mut b = [[zero; N]; N];
        if outside.all() {
            return (impulse, b);
        }
        if inside.all() {
            for i in 0..N {
                b[i][i] = scale[i] * scale[i] * self.inv_c;
            }
            return (impulse, b);
        }
        // Between: q_n = (a_n + m|a_t|)/(1 + m²), q_t = m q_n e.
        let inv = length.recip_or_zero();
        let e: [R; N] = a.map(|a| a * inv);
        let first = one / (one + m * m);
        let turn = m * q[0] * inv;
        b[0][0] = first;
        for i in 1..N {
            b[0][i] = first * m * e[i];
            b[i][0] = b[0][i];
            for j in 1..N {
                let own = first * m * m * e[i] * e[j];
                let across = if i == j { turn - turn * e[i] * e[j] } else { -turn * e[i] * e[j] };
                b[i][j] = own + across;
            }
        }
        for i in 0..N {
            for j in 0..N {
                let unit = if i == j { one } else { zero };
                let curve = R::select(inside, unit, R::select(outside, zero, b[i][j]));
                b[i][j] = curve * scale[i] * scale[j] * self.inv_c;
            }
        }
        (impulse, b)
    }
}

/// A cone's penalty along a line, w + α v: the part that does not depend on α.
#[derive(Clone, Copy)]
pub(super) struct Line<R> {
    m: R,
    first: R,
    inv_c: R,
    /// a = −(w_n, k w_t): its normal part, and its rate; |a_t|² by powers of α.
    normal: [R; 2],
    square: [R; 3],
}

impl<R: Real> Line<R> {
    /// From the rows of a cone.
    pub fn new(cone: &Cone<R>, w: &[R], v: &[R]) -> Self {
        let (zero, one, m) = (R::zero(), R::one(), cone.slope);
        let mut square = [zero; 3];
        for (w, v) in w.iter().zip(v).skip(1) {
            let (w, v) = (cone.k * *w, cone.k * *v);
            square[0] += w * w;
            square[1] += w * v;
            square[2] += v * v;
        }
        let at = |x: &[R]| x.first().map_or(zero, |x| -*x);
        let first = one / (one + m * m);
        Self { m, first, inv_c: cone.inv_c, normal: [at(w), at(v)], square }
    }

    /// Returns the penalty's slope and curvature at α.
    #[inline(always)]
    pub fn at(&self, alpha: R) -> (R, R) {
        let Self { m, first, inv_c, normal: [start, speed], square: [a, b, c] } = *self;
        let normal = start + alpha * speed;
        let turn = b + alpha * c;
        let length = (a + alpha * (b + turn)).max(R::zero()).sqrt();
        let inside = length.le(m * normal);
        let outside = (m * length).le(-normal).and(inside.not());
        // Between: ½ f²/(1 + m²) with f = a_n + m |a_t|.
        let inv = length.recip_or_zero();
        let lengthens = turn * inv;
        let (f, rate) = (normal + m * length, speed + m * lengthens);
        let turning = m * (c - lengthens * lengthens) * inv;
        let slope = R::select(inside, normal * speed + turn, first * f * rate);
        let curve = R::select(inside, speed * speed + c, first * (rate * rate + f * turning));
        let none = |x: R| R::select(outside, R::zero(), x * inv_c);
        (none(slope), none(curve))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Span;
    use crate::solve::tests::{close, Random};

    fn row(c: f64) -> Row<f64> {
        Row {
            dofs: Span::default(),
            y: 0,
            t: 0.0,
            c,
            a: 0.0,
            inv_s: 0.0,
            lo: 0.0,
            hi: f64::INFINITY,
            impulse: 0.0,
            beside: 0.0,
            velocity: 0.0,
            gap: 0.0,
        }
    }

    /// The elliptic cost of MuJoCo's documentation, with mu = μ/√impratio and R_t = R_n/impratio.
    #[test]
    fn the_three_zones_are_mujocos() {
        let mut random = Random::new(1);
        for _ in 0..300 {
            let (r, mu, ratio) = (0.3, 0.6, 10.0f64);
            let cone = Cone::new(&[row(r), row(r / ratio), row(r / ratio)], mu);
            let w = [0; 3].map(|_| random.next());
            let soft = mu / ratio.sqrt();
            let (n, t) = (soft * w[0], f64::hypot(mu * w[1], mu * w[2]));
            let want = if n >= soft * t {
                [0.0; 3]
            } else if soft * n + t <= 0.0 {
                [-w[0] / r, -w[1] * ratio / r, -w[2] * ratio / r]
            } else {
                let f = (soft * t - n) / (r * soft * soft * (1.0 + soft * soft));
                [f * soft, -f * soft * mu * mu * w[1] / t, -f * soft * mu * mu * w[2] / t]
            };
            let (got, b) = cone.law(w);
            // The same along a line.
            let v = [0; 3].map(|_| random.next());
            let (slope, curve) = Line::new(&cone, &w, &v).at(0.0);
            let along: f64 = (0..3).map(|i| -got[i] * v[i]).sum();
            let bend: f64 = (0..9).map(|at| v[at / 3] * b[at / 3][at % 3] * v[at % 3]).sum();
            close(slope, along, 1e-12 * (1.0 + along.abs()));
            close(curve, bend, 1e-12 * (1.0 + bend.abs()));
            for i in 0..3 {
                close(got[i], want[i], 1e-14 * (1.0 + want[0]));
                // Compare the curvature with central differences.
                let h = 1e-6;
                let at = |s: f64| {
                    let mut w = w;
                    w[i] += s * h;
                    cone.law(w).0
                };
                let (up, down) = (at(1.0), at(-1.0));
                for j in 0..3 {
                    let slope = (down[j] - up[j]) / (2.0 * h);
                    close(b[i][j], slope, 1e-4 * (1.0 + slope.abs()));
                }
            }
        }
    }
}
