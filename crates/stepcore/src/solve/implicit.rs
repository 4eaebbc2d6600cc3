//! One Newton step on the conditions that a block's solution meets: what `Real::implicit`
//! takes the derivatives of the solution from.
//!
//! An iteration stops when its numbers stand still; their derivatives follow later, or,
//! through the axes of a matrix that has none of its own, never.

use super::cone::norm;
use crate::real::Real;

/// From x, the minimiser of ½ λᵀQλ + b·λ over |λ_t| ≤ μ λ_n. `q` is Q's lower triangle, rows
/// first. Outside: 0. Inside: Q λ + b = 0. On the surface, with λ = n (1, μ e) and e at the
/// angle θ, the derivatives along n and θ vanish.
pub(super) fn on_cone<R: Real>(q: &[R; 6], mu: R, b: &[R; 3], x: [R; 3]) -> [R; 3] {
    let zero = R::zero();
    let full = [[q[0], q[1], q[3]], [q[1], q[2], q[4]], [q[3], q[4], q[5]]];
    let times = |v: &[R; 3]| full.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
    let turned = times(&x);
    let w = [turned[0] + b[0], turned[1] + b[1], turned[2] + b[2]];
    let length = norm(x[1], x[2]);
    let some = x[0].gt(zero);
    // The surface is met up to rounding.
    let inside = length.lt(mu * x[0] * R::of(1.0 - 8.0 * R::epsilon()));
    let free = minus_solved(&full, &w);
    let e = unit(x[1], x[2], length);
    let (out, round) = ([R::one(), mu * e[0], mu * e[1]], [zero, -mu * e[1], mu * e[0]]);
    let back = [zero, -mu * e[0], -mu * e[1]];
    let (q_out, q_round) = (times(&out), times(&round));
    let n = x[0];
    let cross = n * dot(&round, &q_out);
    let bend = n * (dot(&back, &w) + n * dot(&round, &q_round));
    let [along, turn] =
        solved_two([dot(&out, &q_out), cross, bend], [-dot(&out, &w), -(n * dot(&round, &w))]);
    core::array::from_fn(|i| {
        let rim = x[i] + along * out[i] + turn * n * round[i];
        R::select(some, R::select(inside, x[i] + free[i], rim), zero)
    })
}

/// From x, the minimiser of ½ xᵀQx + g·x over |x| ≤ bound. `q` is q₁₁, q₁₂, q₂₂. Inside:
/// Q x + g = 0. On the rim, at the angle θ, the derivative along θ vanishes, and x grows with
/// the bound.
pub(super) fn in_disc<R: Real>(q: &[R; 3], bound: R, g: &[R; 2], x: [R; 2]) -> [R; 2] {
    let zero = R::zero();
    let w = [q[0] * x[0] + q[1] * x[1] + g[0], q[1] * x[0] + q[2] * x[1] + g[1]];
    let length = norm(x[0], x[1]);
    let inside = length.lt(bound * R::of(1.0 - 8.0 * R::epsilon()));
    let free = solved_two(*q, [-w[0], -w[1]]);
    let e = unit(x[0], x[1], length);
    // On the rim x = bound · e: its own derivatives count in w.
    let rim = [bound * e[0], bound * e[1]];
    let at_rim = [q[0] * rim[0] + q[1] * rim[1] + g[0], q[1] * rim[0] + q[2] * rim[1] + g[1]];
    let around = q[0] * e[1] * e[1] - (q[1] + q[1]) * e[0] * e[1] + q[2] * e[0] * e[0];
    let bend = bound * around - (e[0] * at_rim[0] + e[1] * at_rim[1]);
    let turn = -(e[0] * at_rim[1] - e[1] * at_rim[0]) * bend.recip_or_zero();
    let rim = [rim[0] - bound * turn * e[1], rim[1] + bound * turn * e[0]];
    core::array::from_fn(|i| {
        R::select(bound.gt(zero), R::select(inside, x[i] + free[i], rim[i]), zero)
    })
}

fn dot<R: Real>(a: &[R; 3], b: &[R; 3]) -> R {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A direction; the first axis where there is none.
fn unit<R: Real>(x: R, y: R, length: R) -> [R; 2] {
    let (some, inverse) = (length.gt(R::zero()), length.recip_or_zero());
    [R::select(some, x * inverse, R::one()), y * inverse]
}

/// M⁻¹ r of a symmetric, semi-definite M = (m₁₁, m₁₂, m₂₂); a direction that nothing moves
/// stays at zero.
fn solved_two<R: Real>(m: [R; 3], r: [R; 2]) -> [R; 2] {
    let swap = m[2].gt(m[0]);
    let pick = |a: R, b: R| R::select(swap, a, b);
    let (large, small) = (pick(m[2], m[0]), pick(m[0], m[2]));
    let (first, second) = (pick(r[1], r[0]), pick(r[0], r[1]));
    let inverse = large.recip_or_zero();
    let schur = small - m[1] * m[1] * inverse;
    let moves = schur.gt(R::of(16.0 * R::epsilon()) * small);
    let rest = (second - m[1] * first * inverse) * schur.recip_or_zero();
    let rest = R::select(moves, rest, R::zero());
    let first = (first - m[1] * rest) * inverse;
    [pick(rest, first), pick(first, rest)]
}

/// −M⁻¹ w of a symmetric, positive definite M.
fn minus_solved<R: Real>(m: &[[R; 3]; 3], w: &[R; 3]) -> [R; 3] {
    let inverse = m[0][0].recip_or_zero();
    let (a, b) = (m[1][0] * inverse, m[2][0] * inverse);
    let rest = solved_two(
        [m[1][1] - a * m[1][0], m[2][1] - a * m[2][0], m[2][2] - b * m[2][0]],
        [a * w[0] - w[1], b * w[0] - w[2]],
    );
    [-(w[0] * inverse) - a * rest[0] - b * rest[1], rest[0], rest[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::Dual;
    use crate::solve::exact::{Convex, Tangents};
    use crate::solve::tests::Random;

    /// A number and its derivative along the first way.
    fn dual(pair: (f64, f64)) -> Dual {
        let mut x = Dual::of(pair.0);
        x.slopes[0] = pair.1;
        x
    }

    fn moved(pairs: &[(f64, f64)], h: f64) -> Vec<f64> {
        pairs.iter().map(|(x, d)| x + h * d).collect()
    }

    /// Central differences of a function of numbers that all move at once.
    fn slope<const N: usize>(f: impl Fn(&[f64]) -> [f64; N], at: &[(f64, f64)]) -> [f64; N] {
        let h = 1e-6;
        let (up, down) = (f(&moved(at, h)), f(&moved(at, -h)));
        core::array::from_fn(|i| (up[i] - down[i]) / (2.0 * h))
    }

    /// A positive definite lower triangle: isotropic in every third case.
    fn matrix(random: &mut Random, case: usize) -> [f64; 6] {
        let [a, b, c] = [0; 3].map(|_| 0.4 * random.next());
        let (a, b, c) = if case.is_multiple_of(3) { (0.0, 0.0, 0.0) } else { (a, b, c) };
        let tail = if case.is_multiple_of(3) { 1.5 } else { 1.2 + 0.3 * random.next() };
        [2.0, a, 1.5, b, c, tail]
    }

    #[test]
    fn on_a_cone() {
        let (mut random, mut zones) = (Random::new(5), [0; 3]);
        for case in 0..300 {
            let q = matrix(&mut random, case);
            let side = if case.is_multiple_of(2) { 0.3 } else { 2.0 };
            let b = [2.0 * random.next(), side * random.next(), side * random.next()];
            let at: Vec<_> = q.iter().chain(&b).map(|x| (*x, random.next())).collect();
            let mu = 0.7;
            let solve = |x: &[f64]| {
                let q = core::array::from_fn(|i| x[i]);
                Convex::new(q, mu).solve([x[6], x[7], x[8]], true)
            };
            let q = core::array::from_fn(|i| dual(at[i]));
            let b = core::array::from_fn(|i| dual(at[6 + i]));
            let mu = Dual::of(mu);
            let impulse = Convex::new(q, mu).solve(b, true);
            let length = norm(impulse[1].value, impulse[2].value);
            let zone = if impulse[0].value == 0.0 {
                0
            } else if length < 0.7 * impulse[0].value * (1.0 - 1e-9) {
                1
            } else {
                2
            };
            zones[zone] += 1;
            for (x, want) in impulse.iter().zip(slope(solve, &at)) {
                assert!((x.slopes[0] - want).abs() < 1e-7, "{case}: {impulse:?} {want}");
            }
        }
        assert!(zones.iter().all(|count| *count > 20), "{zones:?}");
    }

    #[test]
    fn in_a_disc() {
        let (mut random, mut inside) = (Random::new(6), 0);
        for case in 0..300 {
            let full = matrix(&mut random, case);
            let q = [full[2], full[4], full[5]];
            let g = [0; 2].map(|_| 2.0 * random.next());
            let bound = 0.7 + 0.5 * random.next();
            let numbers = [q[0], q[1], q[2], g[0], g[1], bound];
            let at = numbers.map(|x| (x, random.next()));
            let solve = |x: &[f64]| Tangents::new(x[0], x[1], x[2]).disc([x[3], x[4]], x[5], true);
            let [q11, q12, q22, g1, g2, bound] = at.map(dual);
            let x = Tangents::new(q11, q12, q22).disc([g1, g2], bound, true);
            inside += usize::from(norm(x[0].value, x[1].value) < bound.value * (1.0 - 1e-9));
            for (x, want) in x.iter().zip(slope(solve, &at)) {
                assert!((x.slopes[0] - want).abs() < 1e-7, "{case}: {x:?} {want}");
            }
        }
        assert!((20..280).contains(&inside), "{inside}");
    }
}
