//! Cones with torsion and rolling against brute force, and as blocks of every solver.

use super::{by_sweeps, close, Problem, Random, EVERY, INF};
use crate::real::{Dual, Real};
use crate::solve::cone::{across, project_box, project_round, InBall, InCone};
use crate::solve::limits::Limits;
use crate::solve::newton::Newton;
use crate::solve::pgs::Pgs;
use crate::solve::rows::{Set, CONE};
use crate::solve::solver::Unconstrained;
use crate::solve::square::Square;

/// Ways of friction.
const WAYS: usize = CONE - 1;
type Vector = [f64; CONE];
type Matrix = [[f64; CONE]; CONE];

/// Positive definite on the first `len`; the others scaled as differently as coefficients are.
fn random_spd(random: &mut Random, len: usize, floor: f64, grade: f64) -> Matrix {
    let r: Matrix = crate::real::array::from_fn(|_| crate::real::array::from_fn(|_| random.next()));
    let size: Vector = crate::real::array::from_fn(|i| if i < 3 { 1.0 } else { grade });
    crate::real::array::from_fn(|i| {
        crate::real::array::from_fn(|j| {
            if i >= len || j >= len {
                return if i == j { 1.0 } else { 0.0 };
            }
            let sum: f64 = (0..CONE).map(|k| r[i][k] * r[j][k]).sum();
            (sum + if i == j { floor } else { 0.0 }) * size[i] * size[j]
        })
    })
}

fn slope(q: &Matrix, b: &Vector, x: &Vector) -> Vector {
    crate::real::array::from_fn(|i| b[i] + (0..CONE).map(|j| q[i][j] * x[j]).sum::<f64>())
}

/// The ways alone, and the inverse.
fn tail<R: Real>(q: [[R; CONE]; CONE]) -> [[R; WAYS]; WAYS] {
    crate::real::array::from_fn(|i| part(q[i + 1]))
}

fn part<R: Real>(x: [R; CONE]) -> [R; WAYS] {
    crate::real::array::from_fn(|i| x[i + 1])
}

fn joined<R: Real>(x: [R; WAYS]) -> [R; CONE] {
    crate::real::array::from_fn(|i| if i == 0 { R::zero() } else { x[i - 1] })
}

/// A wide cone's solution meets its conditions: x in the cone, w in its dual, and x·w = 0.
#[test]
fn a_convex_block_is_the_minimum() {
    let mut random = Random::new(71);
    let mut zones = [0; 3];
    for case in 0..3000 {
        let len = 4 + case % 3;
        let grade = [1.0, 0.01, 1e-4][case % 4 % 3];
        let q = random_spd(&mut random, len, [1.0, 1e-2, 1e-6][case % 5 % 3], grade);
        let b: Vector = crate::real::array::from_fn(|i| {
            let size = if i < 3 { 1.0 } else { grade };
            if i < len {
                random.next() * size
            } else {
                0.0
            }
        });
        let mu = [0.1, 0.6, 2.0, 1e-5][case % 7 % 4];
        let x = InCone::new(q, mu).least(&b, true);
        let w = slope(&q, &b, &x);
        let size = b.iter().fold(0.0f64, |most, b| most.max(b.abs()));
        let (out, steep) = (across(&x) - mu * x[0], mu * across(&w) - w[0]);
        let work: f64 = x.iter().zip(&w).map(|(x, w)| x * w).sum();
        assert!(out <= 1e-15 * x[0], "{case}: {out:e}");
        assert!(steep <= 1e-11 * size, "{case}: {steep:e} of {size}");
        assert!(work.abs() <= 1e-11 * size * x[0], "{case}: {work:e}");
        assert_eq!(x[len..], [0.0; CONE][len..]);
        zones[if x[0] == 0.0 {
            0
        } else if out < -1e-9 * mu * x[0] {
            1
        } else {
            2
        }] += 1;
    }
    assert!(zones.iter().all(|count| *count > 50), "{zones:?}");
}

/// The same for a ball and for a box, by the signs of the residual.
#[test]
fn coulomb_ways_are_the_minimum() {
    let mut random = Random::new(72);
    for case in 0..3000 {
        let len = 4 + case % 3;
        let grade = [1.0, 0.01, 1e-4][case % 4 % 3];
        let mut q = random_spd(&mut random, len, [1.0, 1e-3, 0.0][case % 5 % 3], grade);
        for i in 0..CONE {
            (q[0][i], q[i][0]) = (0.0, 0.0);
            if i >= len {
                q[i][i] = 0.0;
            }
        }
        let mut g: Vector =
            crate::real::array::from_fn(|i| if i < len { random.next() } else { 0.0 });
        (3..CONE).for_each(|i| g[i] *= grade);
        g[0] = 0.0;
        let bound = [0.05, 0.4, 3.0, 100.0][case % 7 % 4];
        let (ways, slopes) = (tail(q), part(g));
        let x = joined(InBall::new(ways).least(&slopes, bound, true));
        let w = slope(&q, &g, &x);
        let size = 1.0 + bound * q[1][1];
        assert!(across(&x) <= bound * (1.0 + 1e-14));
        let inside = across(&x) < bound * (1.0 - 1e-9);
        let towards: f64 = (1..CONE).map(|i| w[i] * x[i]).sum::<f64>() / bound;
        assert!(towards <= 1e-10 * size, "{case}: {towards:e}");
        for i in 1..CONE {
            let left = if inside { w[i] } else { w[i] - towards * x[i] / bound };
            assert!(left.abs() <= 1e-9 * size, "{case}: {i} {left:e} {inside}");
        }
        let start: Vector =
            crate::real::array::from_fn(|i| if i < len { random.next() } else { 0.0 });
        let x = joined(Square::new(ways).least(&slopes, bound, &part(start), true));
        let w = slope(&q, &g, &x);
        for i in 1..len {
            let left = if x[i] >= bound {
                w[i].max(0.0)
            } else if x[i] <= -bound {
                w[i].min(0.0)
            } else {
                w[i]
            };
            assert!(x[i].abs() <= bound && left.abs() <= 1e-9 * size, "{case}: {i} {left:e}");
        }
    }
}

#[test]
fn projections_are_nearest() {
    let mut random = Random::new(73);
    for _ in 0..3000 {
        let x: Vector = [0; CONE].map(|_| 2.0 * random.next());
        let mu = 1.0 + 0.9 * random.next();
        let far = |p: Vector| (0..CONE).map(|i| (p[i] - x[i]).powi(2)).sum::<f64>();
        let (round, square) = (project_round(mu, x), project_box(mu, x));
        for _ in 0..40 {
            let n = (2.0 * random.next()).max(0.0);
            let mut p: Vector = [0; CONE].map(|_| mu * n * random.next());
            p[0] = n;
            assert!(far(p) >= far(square) - 1e-12);
            let k = (mu * n / across(&p)).min(1.0);
            p.iter_mut().skip(1).for_each(|p| *p *= k);
            assert!(far(p) >= far(round) - 1e-12 || n == 0.0);
        }
        // A projection is a fixed point of the projection.
        for (p, again) in [(round, project_round(mu, round)), (square, project_box(mu, square))] {
            (0..CONE).for_each(|i| close(p[i], again[i], 1e-14 * (1.0 + mu)));
        }
    }
}

/// Contacts of 4 and 6 rows in front of a random body, next to narrow ones and limits.
pub(super) fn wide_contacts(set: Set, count: usize, c: f64, random: &mut Random) -> Problem {
    let nv = 8;
    let inv_d: Vec<f64> = (0..nv).map(|_| (2.0 * random.next()).exp()).collect();
    let guess: Vec<f64> = (0..nv).map(|_| random.next()).collect();
    let mut problem = Problem::new(&inv_d, &guess);
    for block in 0..count {
        let grade = [1.0, 0.1, 0.01][block % 3];
        let mut row = |i: usize, c: f64| {
            let size = if i < 3 { 1.0 } else { grade };
            let y = (0..nv).map(|_| size * random.next()).collect();
            (y, 0.3 * size * random.next(), c, 0.0, INF)
        };
        let len = [4, 6, 3, 6, 5][block % 5];
        let list = (0..len).map(|i| row(i, if i == 0 { c } else { c / 2.0 })).collect();
        problem.blocks.push((set, 0.7, list));
    }
    let y: Vec<f64> = (0..nv).map(|_| random.next()).collect();
    problem.limit(&y, 0.3 * random.next(), c);
    problem
}

#[test]
fn sweeps_and_newton_agree() {
    let mut random = Random::new(74);
    for case in 0..200 {
        let problem = wide_contacts(Set::Convex, 1 + case % 5, 0.05, &mut random);
        let lists = problem.dof_lists();
        let mut found = Vec::new();
        for momentum in [false, true] {
            let mut rows = problem.rows::<f64>();
            let limits = Limits { momentum, tolerance: 1e-15, ..EVERY };
            by_sweeps(&mut Pgs::new(), &lists, &problem.inv_d, &mut rows, limits);
            assert!(rows.residual(&lists) < 1e-13, "{case}: {:e}", rows.residual(&lists));
            found.push(rows);
        }
        let mut rows = problem.rows::<f64>();
        let limits = Limits { sweeps: 60, tolerance: 0.0, ..EVERY };
        let guess = &problem.guess;
        let report = Newton::new()
            .solve(Unconstrained { guess, ..problem.free(&lists) }, &mut rows, limits)
            .unwrap();
        assert!(report.sweeps.lane(0) < 20, "{}", report.sweeps.lane(0));
        assert!(rows.residual(&lists) < 1e-13, "{case}: {:e}", rows.residual(&lists));
        for other in &found {
            for (a, b) in rows.u.iter().zip(&other.u) {
                close(*a, *b, 1e-10);
            }
        }
    }
}

/// Under Coulomb's laws sweeps reach rounding too, even with c = 0, unless normal and friction
/// affect each other so much that sweeps cycle.
#[test]
fn sweeps_solve_coulomb_blocks() {
    let mut random = Random::new(75);
    for set in [Set::CoulombRound, Set::CoulombBox] {
        let mut solved = 0;
        for case in 0..100 {
            let c = if case % 2 == 0 { 0.05 } else { 0.0 };
            let problem = wide_contacts(set, 1, c, &mut random);
            let lists = problem.dof_lists();
            let mut rows = problem.rows::<f64>();
            let report = by_sweeps(&mut Pgs::new(), &lists, &problem.inv_d, &mut rows, EVERY);
            if !report.open {
                assert!(rows.residual(&lists) < 1e-13, "{case}: {:e}", rows.residual(&lists));
                solved += 1;
            }
        }
        assert!(solved > 80, "{set:?}: {solved}");
    }
}

fn solve<R: Real<Mask = bool>>(
    kind: usize,
    q: [[R; CONE]; CONE],
    b: [R; CONE],
    bound: R,
    mu: f64,
) -> [R; CONE] {
    let mu = R::of(mu);
    match kind {
        0 => InCone::new(q, mu).least(&b, true),
        1 => joined(InBall::new(tail(q)).least(&part(b), bound, true)),
        _ => joined(Square::new(tail(q)).least(&part(b), bound, &[R::zero(); WAYS], true)),
    }
}

/// Slopes carried through sweeps without convergence: a block's solution against central
/// differences, moved in every number at once.
#[test]
fn blocks_have_their_slopes() {
    let mut random = Random::new(76);
    for kind in 0..3 {
        let mut checked = 0;
        for _ in 0..300 {
            let q = random_spd(&mut random, CONE, 0.3, 0.1);
            let dq = random_spd(&mut random, CONE, 0.0, 0.1);
            let mut b: Vector = crate::real::array::from_fn(|i| random.next() * [1.0, 0.1][i / 3]);
            let mut db: Vector = crate::real::array::from_fn(|i| random.next() * [1.0, 0.1][i / 3]);
            let (bound, mu) = (0.8 + 0.5 * random.next(), 0.7);
            if kind > 0 {
                (b[0], db[0]) = (0.0, 0.0);
            }
            let strip = |mut q: Matrix| {
                if kind > 0 {
                    (0..CONE).for_each(|i| (q[0][i], q[i][0]) = (0.0, 0.0));
                }
                q
            };
            let (q, dq) = (strip(q), strip(dq));
            let at = |h: f64| {
                let q = crate::real::array::from_fn(|i| {
                    crate::real::array::from_fn(|j| q[i][j] + h * dq[i][j])
                });
                let b = crate::real::array::from_fn(|i| b[i] + h * db[i]);
                solve(kind, q, b, bound + 0.3 * h, mu)
            };
            let join = |x: f64, slope: f64| {
                let mut x = Dual::of(x);
                x.slopes[1] = slope;
                x
            };
            let got = solve(
                kind,
                crate::real::array::from_fn(|i| {
                    crate::real::array::from_fn(|j| join(q[i][j], dq[i][j]))
                }),
                crate::real::array::from_fn(|i| join(b[i], db[i])),
                join(bound, 0.3),
                mu,
            );
            let h = 1e-6;
            let (up, here, down) = (at(h), at(0.0), at(-h));
            let sides = |i: usize| ((up[i] - here[i]) / h, (here[i] - down[i]) / h);
            let size = (0..CONE).fold(1.0f64, |most, i| most.max(sides(i).0.abs()));
            if (0..CONE).any(|i| (sides(i).0 - sides(i).1).abs() > 1e-3 * size) {
                continue;
            }
            for i in 0..CONE {
                assert_eq!(got[i].value.to_bits(), here[i].to_bits());
                close(got[i].slopes[1], 0.5 * (sides(i).0 + sides(i).1), 1e-5 * size);
            }
            checked += 1;
        }
        assert!(checked > 200, "{kind}: {checked}");
    }
}
