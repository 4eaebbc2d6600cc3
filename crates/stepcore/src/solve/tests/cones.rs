//! Cones against brute force.

use super::{close, Random};
use crate::solve::cone::{project_box, project_round};
use crate::solve::exact::{Convex, TangentBox, Tangents};

/// min ½xᵀQx + b·x over a convex set, by accelerated projected gradients with restart.
fn brute(q: &[[f64; 3]; 3], b: [f64; 3], project: impl Fn([f64; 3]) -> [f64; 3]) -> [f64; 3] {
    let step = 1.0 / (q[0][0] + q[1][1] + q[2][2]);
    let gradient = |x: [f64; 3]| -> [f64; 3] {
        core::array::from_fn(|i| b[i] + (0..3).map(|j| q[i][j] * x[j]).sum::<f64>())
    };
    let (mut x, mut p, mut k) = ([0.0; 3], [0.0; 3], 0.0);
    for _ in 0..40_000 {
        let g = gradient(p);
        let new = project(core::array::from_fn(|i| p[i] - step * g[i]));
        let uphill: f64 = (0..3).map(|i| (p[i] - new[i]) * (new[i] - x[i])).sum();
        k = if uphill > 0.0 { 0.0 } else { k + 1.0 };
        p = core::array::from_fn(|i| new[i] + k / (k + 3.0) * (new[i] - x[i]));
        x = new;
    }
    x
}

fn random_spd(random: &mut Random, floor: f64) -> [[f64; 3]; 3] {
    let r: [[f64; 3]; 3] = core::array::from_fn(|_| core::array::from_fn(|_| random.next()));
    core::array::from_fn(|i| {
        core::array::from_fn(|j| {
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
        let lower = [q[0][0], q[1][0], q[1][1], q[2][0], q[2][1], q[2][2]];
        let got = Convex::new(lower, mu).solve(b, true);
        let want = brute(&q, b, |x| project_round(mu, x));
        for i in 0..3 {
            close(got[i], want[i], 1e-8);
        }
        // The same to rounding: the natural map.
        let w: [f64; 3] =
            core::array::from_fn(|i| b[i] + (0..3).map(|j| q[i][j] * got[j]).sum::<f64>());
        let back: [f64; 3] = project_round(mu, core::array::from_fn(|i| got[i] - w[i]));
        for i in 0..3 {
            close(got[i], back[i], 1e-13 * (1.0 + got[0]));
        }
    }
}

#[test]
fn a_convex_block_at_the_seams() {
    // ξ₀ = 0, the axis of the cone, its surface, nearly singular, flat and steep cones.
    for mu in [1e-5, 0.3, 1.0, 50.0] {
        let convex = Convex::new([1.0, 0.0, 1e-3, 0.0, 0.0, 1e-3], mu);
        for b in [
            [0.0, 1.0, 0.0],
            [-1.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0; 3],
            [-1.0, mu, 0.0],
            [mu, 1.0, 0.0],
        ] {
            let x = convex.solve(b, true);
            let w = [b[0] + x[0], b[1] + 1e-3 * x[1], b[2] + 1e-3 * x[2]];
            let back: [f64; 3] = project_round(mu, core::array::from_fn(|i| x[i] - w[i]));
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
        let tangents = Tangents::new(q[1][1], q[1][2], q[2][2]);
        let square = TangentBox::new([q[1][1], q[1][2], q[2][2]]);
        let ball = |x: [f64; 3]| {
            let k = (bound / (x[1] * x[1] + x[2] * x[2]).sqrt()).min(1.0);
            [0.0, k * x[1], k * x[2]]
        };
        let edge = |x: [f64; 3]| [0.0, x[1].clamp(-bound, bound), x[2].clamp(-bound, bound)];
        let (disc, square) = (tangents.disc(g, bound, true), square.minimiser(g, bound));
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
    let one = Tangents::new(2.0, 0.0, 0.0);
    assert_eq!(one.disc([1.0, 0.0], 9.0, true), [-0.5, 0.0]);
    assert_eq!(TangentBox::new([2.0, 0.0, 0.0]).minimiser([1.0, 0.0], 0.25), [-0.25, 0.0]);
    assert_eq!(one.disc([1.0, 0.0], 0.25, true), [-0.25, 0.0]);
    assert_eq!(one.disc([1.0, 0.0], 0.0, true), [0.0, 0.0]);
    assert_eq!(Tangents::new(0.0, 0.0, 0.0).disc([0.0, 0.0], 1.0, true), [0.0, 0.0]);
    // Two copies of one direction share it.
    let twin = Tangents::new(1.0, 1.0, 1.0);
    let x = twin.disc([1.0, 1.0], 9.0, true);
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
