//! Cones against brute force.

use super::{close, Random};
use crate::real::{Dual, Real};
use crate::solve::cone::{project_box, project_round, InBall, InCone};
use crate::solve::square::Square;

/// Minimises ½xᵀQx + b·x over a convex set, by accelerated projected gradients with restart.
fn brute(q: &[[f64; 3]; 3], b: [f64; 3], project: impl Fn([f64; 3]) -> [f64; 3]) -> [f64; 3] {
    let step = 1.0 / (q[0][0] + q[1][1] + q[2][2]);
    let gradient = |x: [f64; 3]| -> [f64; 3] {
        crate::real::array::from_fn(|i| b[i] + (0..3).map(|j| q[i][j] * x[j]).sum::<f64>())
    };
    let (mut x, mut p, mut k) = ([0.0; 3], [0.0; 3], 0.0);
    for _ in 0..40_000 {
        let g = gradient(p);
        let new = project(crate::real::array::from_fn(|i| p[i] - step * g[i]));
        let uphill: f64 = (0..3).map(|i| (p[i] - new[i]) * (new[i] - x[i])).sum();
        k = if uphill > 0.0 { 0.0 } else { k + 1.0 };
        p = crate::real::array::from_fn(|i| new[i] + k / (k + 3.0) * (new[i] - x[i]));
        x = new;
    }
    x
}

fn random_spd(random: &mut Random, floor: f64) -> [[f64; 3]; 3] {
    let r: [[f64; 3]; 3] =
        crate::real::array::from_fn(|_| crate::real::array::from_fn(|_| random.next()));
    crate::real::array::from_fn(|i| {
        crate::real::array::from_fn(|j| {
            (0..3).map(|k| r[i][k] * r[j][k]).sum::<f64>() + if i == j { floor } else { 0.0 }
        })
    })
}

#[test]
fn a_convex_block_is_the_minimum() {
    let mut random = Random::new(7);
    for case in 0..300 {
        let q = random_spd(&mut random, 0.02);
        let b = [0; 3].map(|_| random.next());
        let mu = [0.1, 0.6, 2.0][case % 3];
        let got = InCone::new(q, mu).least(&b, true);
        let want = brute(&q, b, |x| project_round(mu, x));
        for i in 0..3 {
            close(got[i], want[i], 1e-8);
        }
        // The natural map confirms the solution to rounding.
        let w: [f64; 3] =
            crate::real::array::from_fn(|i| b[i] + (0..3).map(|j| q[i][j] * got[j]).sum::<f64>());
        let back: [f64; 3] = project_round(mu, crate::real::array::from_fn(|i| got[i] - w[i]));
        for i in 0..3 {
            close(got[i], back[i], 1e-13 * (1.0 + got[0]));
        }
    }
}

#[test]
fn a_convex_block_at_the_seams() {
    // ξ₀ = 0, the axis of the cone, its surface, nearly singular, flat and steep cones.
    for mu in [1e-5, 0.3, 1.0, 50.0] {
        let q = [[1.0, 0.0, 0.0], [0.0, 1e-3, 0.0], [0.0, 0.0, 1e-3]];
        let mut convex = InCone::new(q, mu);
        for b in [
            [0.0, 1.0, 0.0],
            [-1.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0; 3],
            [-1.0, mu, 0.0],
            [mu, 1.0, 0.0],
        ] {
            let x = convex.least(&b, true);
            let w = [b[0] + x[0], b[1] + 1e-3 * x[1], b[2] + 1e-3 * x[2]];
            let back: [f64; 3] = project_round(mu, crate::real::array::from_fn(|i| x[i] - w[i]));
            for i in 0..3 {
                close(x[i], back[i], 1e-12 * (1.0 + mu));
            }
        }
    }
}

#[test]
fn coulomb_tangents_are_the_minimum() {
    let mut random = Random::new(8);
    for case in 0..300 {
        let q = random_spd(&mut random, if case % 5 == 0 { 1e-9 } else { 0.05 });
        let g = [random.next(), random.next()];
        let bound = [0.05, 0.4, 3.0][case % 3];
        let ways = [[q[1][1], q[1][2]], [q[2][1], q[2][2]]];
        let (mut round, square) = (InBall::new(ways), Square::new(ways));
        let ball = |x: [f64; 3]| {
            let k = (bound / (x[1] * x[1] + x[2] * x[2]).sqrt()).min(1.0);
            [0.0, k * x[1], k * x[2]]
        };
        let edge = |x: [f64; 3]| [0.0, x[1].clamp(-bound, bound), x[2].clamp(-bound, bound)];
        let (disc, square) =
            (round.least(&g, bound, true), square.least(&g, bound, &[0.0; 2], true));
        let b = [0.0, g[0], g[1]];
        let (want_disc, want_square) = (brute(&q, b, ball), brute(&q, b, edge));
        for i in 0..2 {
            close(disc[i], want_disc[i + 1], 1e-7);
            close(square[i], want_square[i + 1], 1e-7);
        }
    }
}

#[test]
fn tangents_that_nothing_moves_stay_zero() {
    let q = [[2.0, 0.0], [0.0, 0.0]];
    let mut one = InBall::new(q);
    assert_eq!(one.least(&[1.0, 0.0], 9.0, true), [-0.5, 0.0]);
    assert_eq!(Square::new(q).least(&[1.0, 0.0], 0.25, &[0.0; 2], true), [-0.25, 0.0]);
    assert_eq!(one.least(&[1.0, 0.0], 0.25, true), [-0.25, 0.0]);
    assert_eq!(one.least(&[1.0, 0.0], 0.0, true), [0.0, 0.0]);
    assert_eq!(InBall::new([[0.0; 2]; 2]).least(&[0.0; 2], 1.0, true), [0.0, 0.0]);
    // Two copies of one direction share it.
    let mut twin = InBall::new([[1.0; 2]; 2]);
    let x = twin.least(&[1.0, 1.0], 9.0, true);
    close(x[0] + x[1], -1.0, 1e-15);
}

#[test]
fn projections_are_nearest() {
    let mut random = Random::new(9);
    for _ in 0..2000 {
        let x = [0; 3].map(|_| 2.0 * random.next());
        let mu = 1.0 + 0.9 * random.next();
        let far = |p: [f64; 3]| (0..3).map(|i| (p[i] - x[i]).powi(2)).sum::<f64>();
        let (round, square) = (project_round(mu, x), project_box(mu, x));
        for _ in 0..20 {
            let n = (2.0 * random.next()).max(0.0);
            let p = [n, mu * n * random.next(), mu * n * random.next()];
            assert!(far(p) >= far(square) - 1e-12);
            let k = (mu * n / (p[1] * p[1] + p[2] * p[2]).sqrt()).min(1.0);
            assert!(far([n, k * p[1], k * p[2]]) >= far(round) - 1e-12 || n == 0.0);
        }
    }
}

/// A number with its derivative along the first way.
fn dual(pair: (f64, f64)) -> Dual {
    let mut x = Dual::of(pair.0);
    x.slopes[0] = pair.1;
    x
}

fn moved(pairs: &[(f64, f64)], h: f64) -> Vec<f64> {
    pairs.iter().map(|(x, d)| x + h * d).collect()
}

/// Central differences of a function whose inputs all move at once.
fn slope<const N: usize>(f: impl Fn(&[f64]) -> [f64; N], at: &[(f64, f64)]) -> [f64; N] {
    let h = 1e-6;
    let (up, down) = (f(&moved(at, h)), f(&moved(at, -h)));
    crate::real::array::from_fn(|i| (up[i] - down[i]) / (2.0 * h))
}

/// Returns a positive definite lower triangle: isotropic in every third case.
fn matrix(random: &mut Random, case: usize) -> [f64; 6] {
    let [a, b, c] = [0; 3].map(|_| 0.4 * random.next());
    let (a, b, c) = if case.is_multiple_of(3) { (0.0, 0.0, 0.0) } else { (a, b, c) };
    let tail = if case.is_multiple_of(3) { 1.5 } else { 1.2 + 0.3 * random.next() };
    [2.0, a, 1.5, b, c, tail]
}

fn full<R: Real>(q: [R; 6]) -> [[R; 3]; 3] {
    [[q[0], q[1], q[3]], [q[1], q[2], q[4]], [q[3], q[4], q[5]]]
}

#[test]
fn a_cones_solution_has_its_slopes() {
    let (mut random, mut zones) = (Random::new(5), [0; 3]);
    for case in 0..300 {
        let q = matrix(&mut random, case);
        let side = if case.is_multiple_of(2) { 0.3 } else { 2.0 };
        let b = [2.0 * random.next(), side * random.next(), side * random.next()];
        let at: Vec<_> = q.iter().chain(&b).map(|x| (*x, random.next())).collect();
        let mu = 0.7;
        let solve = |x: &[f64]| {
            let q = crate::real::array::from_fn(|i| x[i]);
            InCone::new(full(q), mu).least(&[x[6], x[7], x[8]], true)
        };
        let q = crate::real::array::from_fn(|i| dual(at[i]));
        let b = crate::real::array::from_fn(|i| dual(at[6 + i]));
        let mu = Dual::of(mu);
        let impulse = InCone::new(full(q), mu).least(&b, true);
        let length = impulse[1].value.hypot(impulse[2].value);
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
fn a_discs_solution_has_its_slopes() {
    let (mut random, mut inside) = (Random::new(6), 0);
    for case in 0..300 {
        let full = matrix(&mut random, case);
        let q = [full[2], full[4], full[5]];
        let g = [0; 2].map(|_| 2.0 * random.next());
        let bound = 0.7 + 0.5 * random.next();
        let numbers = [q[0], q[1], q[2], g[0], g[1], bound];
        let at = numbers.map(|x| (x, random.next()));
        let solve =
            |x: &[f64]| InBall::new([[x[0], x[1]], [x[1], x[2]]]).least(&[x[3], x[4]], x[5], true);
        let [q11, q12, q22, g1, g2, bound] = at.map(dual);
        let x = InBall::new([[q11, q12], [q12, q22]]).least(&[g1, g2], bound, true);
        inside += usize::from(x[0].value.hypot(x[1].value) < bound.value * (1.0 - 1e-9));
        for (x, want) in x.iter().zip(slope(solve, &at)) {
            assert!((x.slopes[0] - want).abs() < 1e-7, "{case}: {x:?} {want}");
        }
    }
    assert!((20..280).contains(&inside), "{inside}");
}
