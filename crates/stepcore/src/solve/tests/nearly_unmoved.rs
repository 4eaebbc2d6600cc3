//! Opposed rows with loads far larger than the force that moves the dof, such as the edges of a
//! pyramid under a wheel whose axle is nearly through its centre.

use super::{pack, Problem, EVERY};
use crate::real::{Lanes, Real};
use crate::solve::limits::Limits;
use crate::solve::newton::Newton;
use crate::solve::solver::Unconstrained;

/// An edge: y, t, c, with y = ±k + `off` and t = 0.005 ± 0.1 k.
type Edge = (f64, f64, f64);

const K: [f64; 4] = [0.0941, -0.0941, 0.0322, -0.0322];
const INERTIA: f64 = 0.004;
const GUESS: f64 = 1.8;

fn edges(off: f64, c: f64) -> Vec<Edge> {
    K.map(|k| (k + off, 0.005 + k * 0.1, c)).to_vec()
}

/// All edges press: D(u − û) + Σ y (y u − t)/c = 0.
fn exact(edges: &[Edge]) -> f64 {
    let (mut pull, mut stiff) = (INERTIA * GUESS, INERTIA);
    for (y, t, c) in edges {
        pull += y * t / c;
        stiff += y * y / c;
    }
    pull / stiff
}

fn problem(edges: &[Edge]) -> Problem {
    let mut problem = Problem::new(&[1.0 / INERTIA], &[GUESS]);
    edges.iter().for_each(|(y, t, c)| problem.limit(&[*y], *t, *c));
    problem
}

fn solved<R: Real>(worlds: &[Vec<Edge>]) -> R {
    let problems: Vec<Problem> = worlds.iter().map(|edges| problem(edges)).collect();
    let mut rows = pack::<R>(&problems);
    // Scalar numbers are passed unchanged.
    for (row, (_, _, c)) in rows.rows.iter_mut().zip(&worlds[0]) {
        row.c = R::of(*c);
    }
    let limits = Limits { sweeps: 50, tolerance: 0.0, ..EVERY };
    let (inv_d, guess) = ([R::of(1.0 / INERTIA)], [R::of(GUESS)]);
    let free = Unconstrained { dof_lists: &[0], inv_d: &inv_d, guess: &guess };
    Newton::new().solve(free, &mut rows, limits).unwrap();
    rows.u[0]
}

fn apart(found: f64, want: f64) -> f64 {
    (found / want - 1.0).abs()
}

#[test]
fn opposed_loads_leave_the_velocity_its_digits() {
    for off in [0.0, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3] {
        for c in [1e-15, 1e-13, 1e-11, 1e-9, 1e-7, 1e-5] {
            let edges = edges(off, c);
            let found = apart(solved::<f64>(std::slice::from_ref(&edges)), exact(&edges));
            assert!(found < 1e-12, "off {off}, c {c}: {found:e}");
        }
    }
}

#[test]
fn in_single_precision_too() {
    for c in [1e-10, 1e-8, 1e-6, 1e-4] {
        let edges = edges(1e-3, c);
        let found = apart(f64::from(solved::<f32>(std::slice::from_ref(&edges))), exact(&edges));
        assert!(found < 3e-4, "c {c}: {found:e}");
    }
}

#[test]
fn lanes_are_single_worlds() {
    // Loads that cancel in one lane, and do not in another.
    let (small, wide) = (edges(1e-7, 1e-9), edges(0.05, 1e-9));
    let lanes = solved::<Lanes>(&[small.clone(), wide.clone()]);
    for (lane, edges) in [small, wide].into_iter().enumerate() {
        assert_eq!(lanes.lane(lane), solved::<f64>(&[edges]));
    }
}
