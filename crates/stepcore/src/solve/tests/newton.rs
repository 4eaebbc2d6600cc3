//! Newton against converged PGS.

use super::{by_sweeps, close, contacts, Problem, Random, EVERY, INF};
use crate::solve::limits::Limits;
use crate::solve::newton::Newton;
use crate::solve::pgs::Pgs;
use crate::solve::rows::Set;

/// Every kind of convex row at once.
pub(super) fn mixed(random: &mut Random) -> Problem {
    let mut problem = contacts(Set::Convex, 2, 0.05, random);
    for _ in 0..3 {
        let y: Vec<f64> = (0..6).map(|_| random.next()).collect();
        problem.limit(&y, 0.3 * random.next(), 0.02);
    }
    let mut y = || (0..6).map(|_| random.next()).collect::<Vec<f64>>();
    problem.blocks.push((
        Set::Interval,
        0.0,
        vec![(y(), 0.0, 0.01, -0.05, 0.05), (y(), 0.2, 0.03, -INF, INF)],
    ));
    problem
}

#[test]
fn newton_equals_converged_pgs() {
    let mut random = Random::new(21);
    for case in 0..200 {
        let problem = mixed(&mut random);
        let lists = problem.dof_lists();
        let want = {
            let mut rows = problem.rows::<f64>();
            let limits = Limits { momentum: true, tolerance: 1e-15, ..EVERY };
            by_sweeps(&mut Pgs::new(), &lists, &problem.inv_d, &mut rows, limits);
            rows
        };
        let mut rows = problem.rows::<f64>();
        if case % 2 == 1 {
            // From a wrong warm start.
            for row in &mut rows.rows {
                row.impulse = 0.1;
                for k in 0..6 {
                    rows.u[k] += problem.inv_d[k] * rows.y[row.y + k] * row.impulse;
                }
            }
        }
        let limits = Limits { sweeps: 50, tolerance: 0.0, ..EVERY };
        let report = Newton::new().solve(problem.free(&lists), &mut rows, limits).unwrap();
        assert!(report.sweeps.lane(0) < 15);
        assert!(rows.residual(&lists) < 1e-14, "{}", rows.residual(&lists));
        for (a, b) in rows.rows.iter().zip(&want.rows) {
            close(a.impulse, b.impulse, 1e-10);
        }
        for (a, b) in rows.u.iter().zip(&want.u) {
            close(*a, *b, 1e-10);
        }
    }
}

#[test]
fn newton_stops_at_its_tolerance() {
    let mut random = Random::new(23);
    for _ in 0..50 {
        let problem = mixed(&mut random);
        let lists = problem.dof_lists();
        for tolerance in [1e-2, 1e-5, 1e-9] {
            let mut rows = problem.rows::<f64>();
            let limits = Limits { sweeps: 50, tolerance, ..EVERY };
            Newton::new().solve(problem.free(&lists), &mut rows, limits).unwrap();
            assert!(rows.residual(&lists) <= tolerance);
        }
    }
}

#[test]
fn newton_needs_softness() {
    let mut problem = Problem::new(&[1.0], &[-1.0]);
    problem.limit(&[1.0], 0.0, 0.0);
    let mut rows = problem.rows::<f64>();
    assert!(Newton::new().solve(problem.free(&[0]), &mut rows, EVERY).is_err());
    assert_eq!((rows.u[0], rows.rows[0].impulse), (-1.0, 0.0));
    // A row that nothing moves needs no regulariser.
    problem.blocks[0].2[0] = (vec![0.0], 0.5, 0.0, 0.0, INF);
    let mut rows = problem.rows::<f64>();
    assert!(Newton::new().solve(problem.free(&[0]), &mut rows, EVERY).is_ok());
    assert_eq!((rows.u[0], rows.rows[0].impulse), (-1.0, 0.0));
}

/// Last step's impulses show which rows press, even if c is so small that the velocities from these
/// impulses do not.
#[test]
fn the_first_step_goes_by_the_zones_of_the_last() {
    const DOFS: usize = 30;
    let mut random = Random::new(29);
    let limits = Limits { sweeps: 500, tolerance: 0.0, ..EVERY };
    let (mut cold, mut warm) = (0, 0);
    for _ in 0..40 {
        let guess: Vec<f64> = (0..DOFS).map(|_| random.next()).collect();
        let mut problem = Problem::new(&[1.0; DOFS], &guess);
        for _ in 0..15 {
            let mut line = || {
                let y: Vec<f64> = (0..DOFS).map(|_| random.next()).collect();
                (y, 0.3 * random.next(), 1e-4, 0.0, INF)
            };
            problem.blocks.push((Set::Interval, 0.0, (0..4).map(|_| line()).collect()));
        }
        let lists = problem.dof_lists();
        let mut last = problem.rows::<f64>();
        Newton::new().solve(problem.free(&lists), &mut last, limits).unwrap();
        for (_, _, rows) in &mut problem.blocks {
            rows.iter_mut().for_each(|row| row.1 += 0.002 * random.next());
        }
        let mut results = [false, true].map(|starts| {
            let mut rows = problem.rows::<f64>();
            for (row, last) in rows.rows.iter_mut().zip(&last.rows).filter(|_| starts) {
                row.impulse = last.impulse;
                for k in 0..DOFS {
                    rows.u[k] += rows.y[row.y + k] * row.impulse;
                }
            }
            let report = Newton::new().solve(problem.free(&lists), &mut rows, limits).unwrap();
            assert!(rows.residual(&lists) < 1e-11, "{}", rows.residual(&lists));
            (rows, report.sweeps.lane(0))
        });
        (cold, warm) = (cold + results[0].1, warm + results[1].1);
        let [(one, _), (other, _)] = &mut results;
        for (a, b) in one.u.iter().zip(&other.u) {
            close(*a, *b, 1e-10);
        }
    }
    assert!(5 * warm < 2 * cold, "{warm} {cold}");
}
