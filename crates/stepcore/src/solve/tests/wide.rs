//! Blocks with more interval rows than a cone has: a ten-edge pyramid.

use super::active_set::intervals;
use super::{by_sweeps, close, Problem, Random, EVERY};
use crate::solve::limits::Limits;
use crate::solve::newton::Newton;
use crate::solve::pgs::Pgs;
use crate::solve::rows::{Rows, Set};
use crate::solve::solver::Unconstrained;

/// Group the same rows, ten per block.
fn in_tens(problem: &Problem) -> Problem {
    let lines: Vec<_> = problem.blocks.iter().flat_map(|block| block.2.clone()).collect();
    let blocks = lines.chunks(10).map(|ten| (Set::Interval, 0.0, ten.to_vec()));
    Problem { blocks: blocks.collect(), ..problem.clone() }
}

type Solve = fn(&Problem, &mut Rows<f64>);

fn sweep(problem: &Problem, rows: &mut Rows<f64>) {
    by_sweeps(&mut Pgs::new(), &problem.dof_lists(), &problem.inv_d, rows, EVERY);
}

fn accelerated(problem: &Problem, rows: &mut Rows<f64>) {
    let limits = Limits { momentum: true, ..EVERY };
    by_sweeps(&mut Pgs::new(), &problem.dof_lists(), &problem.inv_d, rows, limits);
}

fn newton(problem: &Problem, rows: &mut Rows<f64>) {
    let limits = Limits { sweeps: 50, tolerance: 0.0, ..EVERY };
    let (lists, guess) = (problem.dof_lists(), &problem.guess);
    let free = Unconstrained { guess, ..problem.free(&lists) };
    Newton::new().solve(free, rows, limits).unwrap();
}

/// Ten rows are few, thirty are not: both of Newton's methods.
#[test]
fn rows_in_tens_are_the_same_rows() {
    let mut random = Random::new(51);
    for case in 0..40 {
        let single = intervals(if case % 2 == 0 { 10 } else { 30 }, &mut random);
        let tens = in_tens(&single);
        for solve in [accelerated, newton] as [Solve; 2] {
            let (mut one, mut ten) = (single.rows::<f64>(), tens.rows::<f64>());
            solve(&single, &mut one);
            solve(&tens, &mut ten);
            assert!(ten.residual(&tens.dof_lists()) < 1e-12);
            for (one, ten) in one.u.iter().zip(&ten.u) {
                close(*one, *ten, 1e-10);
            }
            // A solver that starts from its solution stays there.
            let found: Vec<f64> = ten.rows.iter().map(|row| row.impulse).collect();
            solve(&tens, &mut ten);
            for (row, found) in ten.rows.iter().zip(found) {
                close(row.impulse, found, 1e-8);
            }
        }
        // Plain sweeps visit them in the same order.
        let (mut one, mut ten) = (single.rows::<f64>(), tens.rows::<f64>());
        sweep(&single, &mut one);
        sweep(&tens, &mut ten);
        assert_eq!(one.u, ten.u);
    }
}
