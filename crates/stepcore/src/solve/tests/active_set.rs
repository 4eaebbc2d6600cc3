//! Islands with few rows under Newton: the active set method against converged PGS.

use super::{by_sweeps, close, Problem, Random, EVERY, INF};
use crate::solve::limits::Limits;
use crate::solve::newton::Newton;
use crate::solve::pgs::Pgs;
use crate::solve::rows::Set;

/// `count` intervals of every kind on six dofs, softness 10^-4 … 10^-1.
pub(super) fn intervals(count: usize, random: &mut Random) -> Problem {
    let inv_d: Vec<f64> = (0..6).map(|_| (2.0 * random.next()).exp()).collect();
    let guess: Vec<f64> = (0..6).map(|_| random.next()).collect();
    let mut problem = Problem::new(&inv_d, &guess);
    for _ in 0..count {
        let y: Vec<f64> = (0..6).map(|_| random.next()).collect();
        let (t, c) = (0.5 * random.next(), 10f64.powf(-2.5 + 1.5 * random.next()));
        let (lo, hi) = [(0.0, INF), (0.0, INF), (-0.05, 0.05), (-INF, INF)][random.below(4)];
        problem.blocks.push((Set::Interval, 0.0, vec![(y, t, c, lo, hi)]));
    }
    problem
}

#[test]
fn few_rows_equal_converged_pgs() {
    let mut random = Random::new(31);
    for case in 0..600 {
        let problem = intervals(1 + case % 16, &mut random);
        let lists = problem.dof_lists();
        let mut want = problem.rows::<f64>();
        let limits = Limits { momentum: true, tolerance: 1e-15, ..EVERY };
        by_sweeps(&mut Pgs::new(), &lists, &problem.inv_d, &mut want, limits);
        let mut rows = problem.rows::<f64>();
        if case % 2 == 1 {
            // From a wrong warm start.
            for row in &mut rows.rows {
                row.impulse = 0.04;
                for k in 0..6 {
                    rows.u[k] += problem.inv_d[k] * rows.y[row.y + k] * row.impulse;
                }
            }
        }
        let limits = Limits { sweeps: 50, tolerance: 0.0, exact: true, ..EVERY };
        let report = Newton::new().solve(problem.free(&lists), &mut rows, limits).unwrap();
        assert!(report.sweeps.lane(0) < 25, "{:?} guesses in case {case}", report.sweeps);
        assert!(rows.residual(&lists) < 1e-12, "{} in case {case}", rows.residual(&lists));
        for (a, b) in rows.rows.iter().zip(&want.rows) {
            close(a.impulse, b.impulse, 1e-8);
        }
        for (a, b) in rows.u.iter().zip(&want.u) {
            close(*a, *b, 1e-10);
        }
    }
}

/// A row that nothing moves stays out of the matrix; its impulse does not change.
#[test]
fn a_row_that_nothing_moves() {
    let mut problem = Problem::new(&[1.0, 2.0], &[-1.0, -1.0]);
    problem.limit(&[1.0, 0.0], 0.0, 0.1);
    problem.limit(&[0.0, 0.0], 0.5, 0.0);
    problem.limit(&[0.0, 1.0], 0.0, 0.1);
    let mut rows = problem.rows::<f64>();
    Newton::new().solve(problem.free(&[0, 1]), &mut rows, EVERY).unwrap();
    let impulses: Vec<f64> = rows.rows.iter().map(|row| row.impulse).collect();
    close(impulses[0], 1.0 / 1.1, 1e-15);
    assert_eq!(impulses[1], 0.0);
    close(impulses[2], 1.0 / 2.1, 1e-15);
}
