//! Slopes of solved rows against central differences of the solution, degenerate rows included.

use super::wide_cones::wide_contacts;
use super::{contacts, Problem, Random, INF};
use crate::real::{Dual, Mask, Real};
use crate::settings::{Acceleration, Law, Settings, Solver, Sweeps};
use crate::solve::derivative::Differentiated;
use crate::solve::rows::{Rows, Set};
use crate::solve::solver::{Solve, Solvers, Unconstrained};

/// Returns every number of a problem, in one order: û, 1/D, then t and y by row.
fn numbers(problem: &mut Problem) -> Vec<&mut f64> {
    let Problem { inv_d, guess, blocks } = problem;
    let rows = blocks.iter_mut().flat_map(|block| &mut block.2);
    let rows = rows.flat_map(|(y, t, ..)| [t].into_iter().chain(y));
    guess.iter_mut().chain(inv_d).chain(rows).collect()
}

fn moved(problem: &Problem, way: &[f64], h: f64) -> Problem {
    let mut problem = problem.clone();
    numbers(&mut problem).into_iter().zip(way).for_each(|(x, way)| *x += h * way);
    problem
}

/// Returns false if sweeps did not reach a solution.
fn solve<R: Real>(
    solver: &mut dyn Solve<R>,
    settings: &Settings,
    [inv_d, guess]: [&[R]; 2],
    rows: &mut Rows<R>,
) -> bool {
    let dof_lists: Vec<usize> = (0..guess.len()).collect();
    let free = Unconstrained { dof_lists: &dof_lists, inv_d, guess };
    solver.solve(settings, free, rows).unwrap().open.none()
}

/// Returns u of the solution.
fn solution(problem: &Problem, settings: &Settings) -> Option<Vec<f64>> {
    let mut rows = problem.rows::<f64>();
    let given = [&*problem.inv_d, &*problem.guess];
    solve(&mut Solvers::new(), settings, given, &mut rows).then_some(rows.u)
}

/// Returns u's slopes along `way`, and the blocks at which they are one-sided.
fn slopes(problem: &Problem, way: &[f64], settings: &Settings) -> Option<(Vec<f64>, Vec<u32>)> {
    let mut tangent = problem.clone();
    numbers(&mut tangent).into_iter().zip(way).for_each(|(x, way)| *x = *way);
    let join = |values: &[f64], ways: &[f64]| -> Vec<Dual> {
        let with = |(x, d): (&f64, &f64)| {
            let mut x = Dual::of(*x);
            x.slopes[1] = *d;
            x
        };
        values.iter().zip(ways).map(with).collect()
    };
    let inv_d = join(&problem.inv_d, &tangent.inv_d);
    let guess = join(&problem.guess, &tangent.guess);
    let (mut rows, ways) = (problem.rows::<Dual>(), tangent.rows::<f64>());
    let values: Vec<f64> = rows.y.iter().map(|y| y.value).collect();
    rows.y = join(&values, &ways.y);
    rows.u.copy_from_slice(&guess);
    for (row, way) in rows.rows.iter_mut().zip(&ways.rows) {
        row.t.slopes[1] = way.t;
        let y = rows.y[row.y..].iter().zip(&inv_d);
        row.a = y.fold(Dual::of(0.0), |a, (y, inv)| a + *y * *y * *inv);
        row.inv_s = (row.a + row.c).recip_or_zero();
    }
    let plain = solution(problem, settings)?;
    let mut solver = Differentiated::new();
    assert!(solve(&mut solver, settings, [&inv_d, &guess], &mut rows));
    for (u, plain) in rows.u.iter().zip(plain) {
        assert_eq!(u.value.to_bits(), plain.to_bits());
        assert_eq!(u.slopes[0], 0.0);
    }
    let degenerate = solver.take_degenerate().iter().map(|element| element.index as u32).collect();
    Some((rows.u.iter().map(|u| u.slopes[1]).collect(), degenerate))
}

fn apart(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Checks problems from `make`, moved in every number at once. A problem is skipped if its one-sided
/// differences disagree, because its active rows changed in between, or if sweeps do not solve it.
fn check(settings: &Settings, mut make: impl FnMut(usize, &mut Random) -> Problem) {
    let (mut random, mut checked) = (Random::new(41), 0);
    for case in 0..120 {
        let mut problem = make(case, &mut random);
        let way: Vec<f64> = numbers(&mut problem).iter().map(|_| random.next()).collect();
        let way = repeated(&problem, way);
        let Some((got, one_sided)) = slopes(&problem, &way, settings) else { continue };
        // Rigid copies share an impulse arbitrarily, and one of them may end at a corner.
        let shared = settings.law == Law::Rigid && case % 2 == 1;
        assert!(one_sided.is_empty() || shared, "case {case}: {one_sided:?}");
        let h = 1e-6;
        let at = |s: f64| solution(&moved(&problem, &way, s * h), settings);
        let (Some(up), Some(here), Some(down)) = (at(1.0), at(0.0), at(-1.0)) else { continue };
        let side = |a: &[f64], b: &[f64]| -> Vec<f64> {
            a.iter().zip(b).map(|(a, b)| (a - b) / h).collect()
        };
        let scale = got.iter().fold(1.0f64, |most, x| most.max(x.abs()));
        if apart(&side(&up, &here), &side(&here, &down)) > 1e-3 * scale {
            continue;
        }
        let middle: Vec<f64> = side(&up, &down).iter().map(|x| 0.5 * x).collect();
        let error = apart(&got, &middle) / scale;
        assert!(error < 1e-5, "case {case}: {error:e}, {got:?} against {middle:?}");
        checked += 1;
    }
    assert!(checked > 80, "{checked}");
}

/// Move rows that repeat others like the originals.
fn repeated(problem: &Problem, way: Vec<f64>) -> Vec<f64> {
    let mut tangent = problem.clone();
    numbers(&mut tangent).into_iter().zip(&way).for_each(|(x, way)| *x = *way);
    for b in 0..problem.blocks.len() {
        let Some(first) = (0..b).find(|a| problem.blocks[*a] == problem.blocks[b]) else {
            continue;
        };
        tangent.blocks[b] = tangent.blocks[first].clone();
    }
    // Nothing moves a row of zeros.
    for (block, way) in problem.blocks.iter().zip(&mut tangent.blocks) {
        for (row, way) in block.2.iter().zip(&mut way.2) {
            if row.0.iter().all(|y| *y == 0.0) {
                way.0.fill(0.0);
            }
        }
    }
    numbers(&mut tangent).into_iter().map(|x| *x).collect()
}

/// Cones and intervals; then copies of some, a block that nothing moves, and one without friction.
fn degenerate(set: Set, c: f64, case: usize, random: &mut Random) -> Problem {
    let mut problem = contacts(set, 1 + case % 3, c, random);
    let mut y = || (0..6).map(|_| random.next()).collect::<Vec<f64>>();
    problem.limit(&y(), 0.2, c);
    let bounded = vec![(y(), 0.1, c, -0.05, 0.05), (y(), -0.2, c, -INF, INF)];
    problem.blocks.push((Set::Interval, 0.0, bounded));
    if case % 2 == 1 {
        let copies = [problem.blocks[0].clone(), problem.blocks[problem.blocks.len() - 1].clone()];
        problem.blocks.extend(copies);
        problem.blocks.push((set, 0.5, vec![(vec![0.0; 6], 0.1, c, 0.0, INF)]));
        let mut slick = contacts(set, 1, c, random).blocks.remove(0);
        slick.1 = 0.0;
        problem.blocks.push(slick);
    }
    problem
}

fn settings(solver: Solver, law: Law) -> Settings {
    Settings {
        solver,
        law,
        sweeps: Sweeps::Auto,
        tolerance: 1e-14,
        acceleration: Acceleration::Momentum,
        ..Settings::default()
    }
}

#[test]
fn newton_and_convex_cones() {
    let settings = settings(Solver::Newton, Law::SolRef);
    check(&settings, |case, random| degenerate(Set::Convex, 0.03, case, random));
}

#[test]
fn sweeps_and_convex_cones() {
    let settings = settings(Solver::Pgs, Law::SolRef);
    check(&settings, |case, random| degenerate(Set::Convex, 0.03, case, random));
}

/// Torsion and rolling: a surface has more tangent directions.
#[test]
fn wide_cones() {
    for (solver, law, set) in [
        (Solver::Newton, Law::SolRef, Set::Convex),
        (Solver::Pgs, Law::SolRef, Set::Convex),
        (Solver::Pgs, Law::Lesson, Set::CoulombRound),
        (Solver::Pgs, Law::Lesson, Set::CoulombBox),
    ] {
        let settings = settings(solver, law);
        check(&settings, |case, random| wide_contacts(set, 1 + case % 3, 0.03, random));
    }
}

/// Coulomb's laws, whose friction pushes no row out of its block here: solutions need not be
/// unique.
#[test]
fn sweeps_and_coulomb_cones() {
    let settings = settings(Solver::Pgs, Law::Lesson);
    for set in [Set::CoulombRound, Set::CoulombBox] {
        check(&settings, |case, random| degenerate(set, 0.05, case, random));
    }
}

/// Without softness, impulses are ambiguous only for redundant rows; u is unique.
#[test]
fn sweeps_without_softness() {
    let settings = settings(Solver::Pgs, Law::Rigid);
    for set in [Set::CoulombRound, Set::CoulombBox] {
        check(&settings, |case, random| {
            let mut problem = contacts(set, 1, 0.0, random);
            let y: Vec<f64> = (0..6).map(|_| random.next()).collect();
            problem.limit(&y, 0.3, 0.0);
            if case % 2 == 1 {
                let copy = problem.blocks[case / 2 % 2].clone();
                problem.blocks.push(copy);
            }
            problem
        });
    }
}

/// The bound of an interval, and the apex and surface of each cone: one-sided exactly there.
#[test]
fn corners_are_told() {
    let settings = settings(Solver::Pgs, Law::Rigid);
    let one_sided = |set, guess: [f64; 3], copies: usize| -> Vec<u32> {
        let mut problem = Problem::new(&[3.0, 1.0, 1.0], &guess);
        let unit = |k: usize| (0..3).map(|i| f64::from(u8::from(i == k))).collect::<Vec<_>>();
        let (count, lo) = if set == Set::Interval { (1, -0.7) } else { (3, 0.0) };
        let hi = if set == Set::Interval { 0.7 } else { INF };
        let list: Vec<_> = (0..count).map(|k| (unit(k), 0.0, 0.0, lo, hi)).collect();
        problem.blocks = vec![(set, 0.7, list); copies];
        let mut way: Vec<f64> = numbers(&mut problem).iter().map(|_| 0.0).collect();
        way[..3].copy_from_slice(&[0.3, -0.2, 0.1]);
        slopes(&problem, &way, &settings).unwrap().1
    };
    for (push, want) in [(2.1, vec![0]), (-2.1, vec![0]), (2.1001, vec![]), (2.0, vec![])] {
        assert_eq!(one_sided(Set::Interval, [push, 0.0, 0.0], 1), want, "{push}");
    }
    for set in [Set::Convex, Set::CoulombRound, Set::CoulombBox] {
        // An impulse of 1, and in the tangent the limit of the cone, less, or more.
        for (push, want) in [(0.7, vec![0]), (0.69, vec![]), (0.71, vec![])] {
            assert_eq!(one_sided(set, [-3.0, push, 0.0], 1), want, "{set:?} {push}");
        }
        assert_eq!(one_sided(set, [0.0; 3], 1), [0], "{set:?}");
        assert_eq!(one_sided(set, [0.1, 0.0, 0.0], 1), [0; 0], "{set:?}");
    }
    // The second only repeats the first, which leaves it zero impulse and zero slack.
    let limits = |guess: f64| {
        let mut problem = Problem::new(&[1.0], &[guess]);
        (0..2).for_each(|_| problem.limit(&[1.0], 0.0, 0.0));
        slopes(&problem, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], &settings).unwrap().1
    };
    assert_eq!((limits(-1.0), limits(0.0)), (vec![], vec![0, 1]));
}
