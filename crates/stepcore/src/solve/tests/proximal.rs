//! Problems beyond sweeps are solved, in closed form and bit for bit in lanes.

use super::{close, Line, Problem, EVERY, INF};
use crate::solve::limits::Limits;
use crate::solve::rows::Set;
use crate::solve::solver::Solvers;

/// Gravity per step [m/s].
const FALL: f64 = 0.02;
const LIMITS: Limits =
    Limits { sweeps: 50, tolerance: 1e-10, exact: true, rounding: true, ..EVERY };

/// Bodies of these masses that may slide and fall on each other, the first on a floor; `count`
/// contacts in each place.
pub(in crate::solve) fn stack(set: Set, masses: &[f64], slide: f64, count: usize) -> Problem {
    let nv = 3 * masses.len();
    let inv_d: Vec<f64> = (0..nv).map(|k| 1.0 / masses[k / 3]).collect();
    let guess: Vec<f64> = (0..nv).map(|k| [slide, 0.0, -FALL][k % 3]).collect();
    let mut problem = Problem::new(&inv_d, &guess);
    for body in 0..masses.len() {
        for _ in 0..count {
            let row = |way: usize| -> Line {
                let mut y = vec![0.0; nv];
                y[3 * body + way] = 1.0;
                if body > 0 {
                    y[3 * (body - 1) + way] = -1.0;
                }
                (y, 0.0, 0.0, if way == 2 { 0.0 } else { -INF }, INF)
            };
            let rows =
                if set == Set::Interval { vec![row(2)] } else { vec![row(2), row(0), row(1)] };
            problem.blocks.push((set, 0.5, rows));
        }
    }
    problem
}

/// Solves it; returns the impulses of the normals, place by place.
fn normals(problem: &Problem, count: usize) -> Vec<f64> {
    let (lists, mut rows) = (problem.dof_lists(), problem.rows::<f64>());
    let report = Solvers::new().solve_for_sure(LIMITS, problem.free(&lists), &mut rows);
    assert!(!report.open);
    assert!(rows.residual(&lists) < 1e-10, "{}", rows.residual(&lists));
    let blocks = rows.blocks.chunks(count);
    blocks.map(|own| own.iter().map(|block| rows.rows[block.rows.start].impulse).sum()).collect()
}

#[test]
fn a_gram_under_a_ton() {
    for set in [Set::Interval, Set::CoulombRound, Set::CoulombBox] {
        for masses in [&[1e-3, 1e3][..], &[1e-3, 1e3, 1e-3], &[1e3, 1e-3]] {
            for count in [1, 4] {
                let found = normals(&stack(set, masses, 0.0, count), count);
                for (at, impulse) in found.into_iter().enumerate() {
                    let weight = FALL * masses[at..].iter().sum::<f64>();
                    // 1e-10 m/s of a body that moves a million times as easily.
                    close(impulse, weight, 1e-5 * weight);
                }
            }
        }
    }
}

/// The whole stack slides at 1 m/s, and the friction at the floor slows all of it: μ g dt.
#[test]
fn a_gram_that_slides_under_a_ton() {
    for set in [Set::CoulombRound, Set::CoulombBox] {
        let masses = [1e-3, 1e3];
        let problem = stack(set, &masses, 1.0, 1);
        let (lists, mut rows) = (problem.dof_lists(), problem.rows::<f64>());
        Solvers::new().solve_for_sure(LIMITS, problem.free(&lists), &mut rows);
        assert!(rows.residual(&lists) < 1e-10, "{}", rows.residual(&lists));
        for (k, want) in [(2, 0.0), (5, 0.0), (3, 1.0 - 0.5 * FALL)] {
            close(rows.u[k], want, 1e-7);
        }
    }
}
