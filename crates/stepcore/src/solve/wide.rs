//! The exact solution of a block with more than two ways of friction: torsion and rolling.
//!
//! Q is made diagonal once a solve. For a convex cone in the unit measure (tangents over μ, so
//! that the cone is |x_t| ≤ x_n) by a basis V that keeps the cone: VᵀSV = S = diag(1, −1, …),
//! VᵀQV = diag(d). V is a product of rotations among the ways and hyperbolic rotations of the
//! normal with one of them, Jacobi's method for a definite pair (Veselić 1993), which exists
//! because Q is positive definite. On the surface (Q − κS)x = −b with κ ≥ 0, in that basis
//! yₙ = ξₙ/(dₙ − κ), yᵢ = ξᵢ/(dᵢ + κ), ξ = −Vᵀb: one equation for κ, as in `exact.rs`.
//! For a Coulomb cone only the ways are rotated.

use super::cone::across;
use super::exact::{rotation, STEPS};
use super::rows::CONE;
use super::square::Square;
use crate::real::{Mask, Real};

/// Rounds of rotations; five to eight are usual.
const ROUNDS: usize = 16;

type Vector<R> = [R; CONE];
pub(super) type Square6<R> = [[R; CONE]; CONE];

#[derive(Clone, Copy, Debug)]
pub(super) struct Wide<R: Real> {
    /// Of the rows as they are; beyond their number zeros.
    pub q: Square6<R>,
    mu: R,
    v: Square6<R>,
    d: Vector<R>,
}

fn select<R: Real>(mask: R::Mask, yes: Vector<R>, no: Vector<R>) -> Vector<R> {
    core::array::from_fn(|i| R::select(mask, yes[i], no[i]))
}

fn times<R: Real>(m: &Square6<R>, x: &Vector<R>) -> Vector<R> {
    m.map(|row| sum(|k| row[k] * x[k]))
}

/// mᵀx.
fn back<R: Real>(m: &Square6<R>, x: &Vector<R>) -> Vector<R> {
    core::array::from_fn(|i| sum(|k| m[k][i] * x[k]))
}

#[inline(always)]
fn sum<R: Real>(term: impl Fn(usize) -> R) -> R {
    let mut sum = term(0);
    for k in 1..CONE {
        sum += term(k);
    }
    sum
}

impl<R: Real> Wide<R> {
    /// For a convex cone.
    pub fn convex(q: Square6<R>, mu: R) -> Self {
        let q = symmetric(q);
        let scale = |i: usize| if i == 0 { R::one() } else { mu };
        let unit =
            core::array::from_fn(|i| core::array::from_fn(|j| q[i][j] * (scale(i) * scale(j))));
        let (v, d) = diagonal(unit, 0);
        Self { q, mu, v, d }
    }

    /// For a Coulomb cone, whose normal is solved by itself.
    pub fn coulomb(q: Square6<R>, mu: R) -> Self {
        let q = symmetric(q);
        let (v, mut d) = diagonal(q, 1);
        // What rounding leaves of a zero eigenvalue is a direction that nothing moves.
        let most = d[1..].iter().fold(R::zero(), |most, d| most.max(*d));
        let floor = R::of(16.0 * R::epsilon()) * most;
        d[0] = R::zero();
        d = d.map(|d| R::select(d.gt(floor), d, R::zero()));
        Self { q, mu, v, d }
    }

    fn in_unit(&self, x: &Vector<R>) -> Vector<R> {
        core::array::from_fn(|i| if i == 0 { x[0] } else { self.mu * x[i] })
    }

    /// The minimiser of ½ λᵀQλ + b·λ over |λ_t| ≤ μ λ_n.
    pub fn solve(&self, b: Vector<R>, mask: R::Mask) -> Vector<R> {
        R::implicit(self.minimiser(&b, mask), |x| self.on_cone(&b, &x))
    }

    fn minimiser(&self, b: &Vector<R>, mask: R::Mask) -> Vector<R> {
        let zero = R::zero();
        let b = self.in_unit(b);
        let apart = across(&b).le(b[0]);
        let xi = back(&self.v, &b).map(|x| -x);
        let d = &self.d;
        let free = times(&self.v, &core::array::from_fn(|i| xi[i] * d[i].recip_or_zero()));
        let inside = across(&free).le(free[0]);
        let live = mask.and(apart.or(inside).not());
        let closed = select::<R>(apart, [zero; CONE], free);
        let out = if live.none() {
            closed
        } else {
            select::<R>(apart.or(inside), closed, self.surface(&xi, live))
        };
        self.in_unit(&out)
    }

    /// The minimiser on the surface: with N = |y_t|, for ξₙ ≥ 0 solved for κ in
    /// κ − dₙ + ξₙ/N(κ) = 0, for ξₙ < 0 for 1/κ in the same equation over κ. Both are increasing
    /// and concave in their unknown, and negative at 0, so Newton from there never overshoots.
    fn surface(&self, xi: &Vector<R>, mut live: R::Mask) -> Vector<R> {
        let (zero, one) = (R::zero(), R::one());
        let up = xi[0].ge(zero);
        let r = xi[0].abs();
        let pick = |yes: R, no: R| R::select(up, yes, no);
        let (a, rest) = (pick(one, self.d[0]), pick(self.d[0], one));
        // yᵢ = ξᵢ/(f + g x), times x where x is 1/κ.
        let f: Vector<R> = core::array::from_fn(|i| pick(self.d[i], one));
        let g: Vector<R> = core::array::from_fn(|i| pick(one, self.d[i]));
        let mut x = zero;
        for _ in 0..STEPS {
            let (mut length2, mut bend) = (zero, zero);
            for i in 1..CONE {
                let inv = (f[i] + g[i] * x).recip_or_zero();
                let p = xi[i] * xi[i] * inv * inv;
                length2 += p;
                bend += p * g[i] * inv;
            }
            let inv = length2.sqrt().recip_or_zero();
            let value = a * x - rest + r * inv;
            let slope = a + r * inv * inv * inv * bend;
            let next = x - value / slope;
            live = live.and(next.gt(x));
            if live.none() {
                break;
            }
            x = R::select(live, next, x);
        }
        let k = pick(one, x);
        let mut y: Vector<R> =
            core::array::from_fn(|i| k * xi[i] * (f[i] + g[i] * x).recip_or_zero());
        y[0] = across(&y);
        let out = times(&self.v, &y);
        let n = out[0].max(zero);
        let fit = n * across(&out).recip_or_zero();
        core::array::from_fn(|i| if i == 0 { n } else { fit * out[i] })
    }

    /// One Newton step from x on the conditions that it meets (`Real::implicit`). Outside: 0.
    /// Inside: Qx + b = 0. On the surface, with r = Qx + b − κSx, which is 0:
    /// (Q − κS)dx − Sx dκ = −r and Sx·dx = 0, which is diagonal in y but for dκ.
    fn on_cone(&self, b: &Vector<R>, x: &Vector<R>) -> Vector<R> {
        let (zero, d) = (R::zero(), &self.d);
        let w = times(&self.q, x);
        let w = self.in_unit(&core::array::from_fn(|i| w[i] + b[i]));
        let per_mu = self.mu.recip_or_zero();
        let z: Vector<R> = core::array::from_fn(|i| if i == 0 { x[0] } else { x[i] * per_mu });
        let some = z[0].gt(zero);
        let inside = across(&z).lt(z[0] * R::of(1.0 - 16.0 * R::epsilon()));
        let signed = |x: &Vector<R>| -> Vector<R> {
            core::array::from_fn(|i| if i == 0 { x[0] } else { -x[i] })
        };
        let free = back(&self.v, &w);
        let free = times(&self.v, &core::array::from_fn(|i| -free[i] * d[i].recip_or_zero()));
        // On the surface, in y: V⁻¹ = SVᵀS.
        let y = signed(&back(&self.v, &signed(&z)));
        let kappa = w[0] * z[0].recip_or_zero();
        let bent = signed(&z);
        let rho = back(&self.v, &core::array::from_fn(|i| w[i] - kappa * bent[i]));
        let inv: Vector<R> = core::array::from_fn(|i| (d[i] + kappa).recip_or_zero());
        let per_y = y[0].recip_or_zero();
        let (mut pull, mut give) = (zero, zero);
        for i in 1..CONE {
            pull += y[i] * rho[i] * inv[i];
            give += y[i] * y[i] * inv[i];
        }
        let stiff = d[0] - kappa;
        let turn = (-pull - give * rho[0] * per_y) / (R::one() + give * stiff * per_y * per_y);
        let first = turn * per_y;
        let change = (stiff * first + rho[0]) * per_y;
        let rim =
            times(
                &self.v,
                &core::array::from_fn(|i| {
                    if i == 0 {
                        first
                    } else {
                        -(rho[i] + y[i] * change) * inv[i]
                    }
                }),
            );
        let step = self.in_unit(&select::<R>(inside, free, rim));
        core::array::from_fn(|i| R::select(some, x[i] + step[i], zero))
    }

    /// The minimiser of ½ xᵀQx + g·x over the ball |x| ≤ bound; entry 0 is not part of it.
    ///
    /// As `Tangents::disc`, with as many axes as there are ways.
    pub fn ball(&self, g: Vector<R>, bound: R, mask: R::Mask) -> Vector<R> {
        R::implicit(self.in_ball(&g, bound, mask), |x| self.at_ball(&g, bound, &x))
    }

    fn in_ball(&self, g: &Vector<R>, bound: R, mask: R::Mask) -> Vector<R> {
        let (zero, d) = (R::zero(), &self.d);
        let along = back(&self.v, g);
        let g: Vector<R> = core::array::from_fn(|i| R::select(d[i].gt(zero), along[i], zero));
        let y: Vector<R> = core::array::from_fn(|i| -g[i] * d[i].recip_or_zero());
        let inside = across(&y).le(bound);
        let none = bound.le(zero);
        let free = times(&self.v, &y);
        let mut live = mask.and(inside.or(none).not());
        if live.none() {
            return select::<R>(none, [zero; CONE], free);
        }
        let most = d[1..].iter().fold(zero, |most, d| most.max(*d));
        let mut m = (across(&g) / bound - most).max(zero);
        for _ in 0..STEPS {
            let (mut length2, mut slope) = (zero, zero);
            for i in 1..CONE {
                let inv = (d[i] + m).recip_or_zero();
                let p = g[i] * inv;
                length2 += p * p;
                slope += p * p * inv;
            }
            let step = (length2.sqrt() / bound - R::one()) * length2 * slope.recip_or_zero();
            let next = m + step;
            live = live.and(next.gt(m));
            if live.none() {
                break;
            }
            m = R::select(live, next, m);
        }
        let p: Vector<R> = core::array::from_fn(|i| -g[i] * (d[i] + m).recip_or_zero());
        let k = bound * across(&p).recip_or_zero();
        let rim = times(&self.v, &p.map(|p| k * p));
        select::<R>(none, [zero; CONE], select::<R>(inside, free, rim))
    }

    /// One Newton step from x: inside Qx + g = 0; on the rim (Q + m)x + g = 0 and |x| = bound.
    fn at_ball(&self, g: &Vector<R>, bound: R, x: &Vector<R>) -> Vector<R> {
        let (zero, d) = (R::zero(), &self.d);
        let turned = times(&self.q, x);
        let w: Vector<R> = core::array::from_fn(|i| if i == 0 { zero } else { turned[i] + g[i] });
        let inside = across(x).lt(bound * R::of(1.0 - 16.0 * R::epsilon()));
        let along = back(&self.v, &w);
        let y = back(&self.v, x);
        let (mut m, mut length2) = (zero, zero);
        for i in 1..CONE {
            m -= along[i] * y[i];
            length2 += y[i] * y[i];
        }
        let m = (m * length2.recip_or_zero()).max(zero);
        let (mut pull, mut give) = (zero, zero);
        let inv: Vector<R> = core::array::from_fn(|i| (d[i] + m).recip_or_zero());
        let rho: Vector<R> = core::array::from_fn(|i| along[i] + m * y[i]);
        for i in 1..CONE {
            pull += y[i] * rho[i] * inv[i];
            give += y[i] * y[i] * inv[i];
        }
        let out = R::of(0.5) * (bound * bound - length2);
        let change = -(out + pull) * give.recip_or_zero();
        let step: Vector<R> = core::array::from_fn(|i| {
            let free = -along[i] * d[i].recip_or_zero();
            R::select(inside, free, -(rho[i] + y[i] * change) * inv[i])
        });
        let step = times(&self.v, &step);
        core::array::from_fn(|i| R::select(bound.gt(zero), x[i] + step[i], zero))
    }

    /// The minimiser of ½ xᵀQx + g·x over the box |x_i| ≤ bound, looked for from x.
    pub fn square(&self, g: &Vector<R>, bound: R, x: &Vector<R>, mask: R::Mask) -> Vector<R> {
        Square { q: &self.q, g, bound }.minimiser(x, mask)
    }
}

/// The lower half for both: the other one differs by rounding.
fn symmetric<R: Real>(q: Square6<R>) -> Square6<R> {
    core::array::from_fn(|i| core::array::from_fn(|j| q[i.max(j)][i.min(j)]))
}

/// V and d with VᵀQV = diag(d) and VᵀSV = S; the entries before `first` stay as they are.
fn diagonal<R: Real>(mut q: Square6<R>, first: usize) -> (Square6<R>, Vector<R>) {
    let unit = |i: usize, j: usize| if i == j { R::one() } else { R::zero() };
    let mut v: Square6<R> = core::array::from_fn(|i| core::array::from_fn(|j| unit(i, j)));
    for _ in 0..ROUNDS {
        let mut turned = false;
        for i in first..CONE {
            for j in i + 1..CONE {
                turned |= turn(&mut q, &mut v, i, j);
            }
        }
        if !turned {
            break;
        }
    }
    (v, core::array::from_fn(|i| q[i][i]))
}

/// Takes q_ij away where it is more than rounding; whether that was so in some lane.
fn turn<R: Real>(q: &mut Square6<R>, v: &mut Square6<R>, i: usize, j: usize) -> bool {
    let (a, b, o) = (q[i][i], q[j][j], q[i][j]);
    let rounding = R::of(R::epsilon() * R::epsilon());
    let large = (o * o).gt(rounding * (a * b));
    if large.none() {
        return false;
    }
    let hyperbolic = i == 0;
    // New columns: c vᵢ − s vⱼ and s' vᵢ + c vⱼ.
    let (c, s, t) = if hyperbolic { boost(a, o, b) } else { rotation(a, o, b) };
    let other = if hyperbolic { -s } else { s };
    let change = t * o;
    q[i][i] = R::select(large, a - change, a);
    q[j][j] = R::select(large, if hyperbolic { b - change } else { b + change }, b);
    q[i][j] = R::select(large, R::zero(), o);
    q[j][i] = q[i][j];
    for k in 0..CONE {
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
