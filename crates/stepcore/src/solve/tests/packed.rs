//! Contacts packed for sweeps, against the same rows one by one.

use super::{by_sweeps, close, contacts, pack, Problem, Random, EVERY, INF};
use crate::model::Span;
use crate::real::{Lanes, Real, WIDTH};
use crate::solve::limits::Limits;
use crate::solve::pgs::Pgs;
use crate::solve::rows::{Rows, Set};
use crate::solve::ContactIslands;

/// Contacts between two free bodies; with `Set::Interval` they are pyramids.
fn between_two(set: Set, random: &mut Random) -> Problem {
    let [one, two] = [(); 2].map(|()| contacts(set, 4, 0.05, random));
    let join = |a: &[f64], b: &[f64]| [a, b].concat();
    let mut both = Problem::new(&join(&one.inv_d, &two.inv_d), &join(&one.guess, &two.guess));
    for ((set, mu, list), (_, _, more)) in one.blocks.into_iter().zip(two.blocks) {
        let rows: Vec<_> = (list.into_iter().zip(more))
            .map(|((y, t, c, lo, hi), more)| (join(&y, &more.0), t, c, lo, hi))
            .collect();
        let edge = |way: usize, mu: f64| {
            let y = rows[0].0.iter().zip(&rows[way].0).map(|(n, t)| n + mu * t).collect();
            (y, rows[0].1 + mu * rows[way].1, 0.05, 0.0, INF)
        };
        let edges = || vec![edge(1, mu), edge(1, -mu), edge(2, mu), edge(2, -mu)];
        let rows = if set == Set::Interval { edges() } else { rows };
        both.blocks.push((set, mu, rows));
    }
    both
}

const SETS: [Set; 4] = [Set::Interval, Set::Convex, Set::CoulombRound, Set::CoulombBox];

/// Nine sweeps; if rows allow it, with momentum too.
fn each_way(set: Set) -> impl Iterator<Item = Limits> {
    let convex = matches!(set, Set::Interval | Set::Convex);
    let way = |momentum| Limits { sweeps: 9, tolerance: 1e-9, momentum, ..EVERY };
    [false, true].into_iter().filter(move |momentum| convex || !momentum).map(way)
}

fn swept<R: Real>(problem: &Problem, mut rows: Rows<R>, heap: bool, limits: Limits) -> Rows<R> {
    rows.heap = heap;
    let inv_d: Vec<R> = problem.inv_d.iter().map(|x| R::of(*x)).collect();
    by_sweeps(&mut Pgs::new(), &problem.dof_lists(), &inv_d, &mut rows, limits);
    rows
}

#[test]
fn packed_contacts_are_swept_as_their_rows_are() {
    let mut random = Random::new(3);
    for set in SETS {
        let problem = between_two(set, &mut random);
        for limits in each_way(set) {
            let [plain, packed] =
                [false, true].map(|heap| swept(&problem, problem.rows::<f64>(), heap, limits));
            assert!(packed.rows.iter().any(|row| row.impulse > 0.0));
            for (one, other) in plain.rows.iter().zip(&packed.rows) {
                close(one.impulse, other.impulse, 1e-11);
            }
            for (one, other) in plain.u.iter().zip(&packed.u) {
                close(*one, *other, 1e-11);
            }
        }
    }
}

#[test]
fn packed_lanes_are_their_worlds() {
    let mut random = Random::new(4);
    for set in SETS {
        let first = between_two(set, &mut random);
        let worlds: Vec<Problem> = (0..WIDTH)
            .map(|_| Problem { inv_d: first.inv_d.clone(), ..between_two(set, &mut random) })
            .collect();
        for limits in each_way(set) {
            let lanes = swept(&first, pack::<Lanes>(&worlds), true, limits);
            for (lane, world) in worlds.iter().enumerate() {
                let alone = swept(world, world.rows::<f64>(), true, limits);
                for (one, lanes) in alone.rows.iter().zip(&lanes.rows) {
                    assert_eq!(one.impulse.to_bits(), lanes.impulse.lane(lane).to_bits());
                }
                for (one, lanes) in alone.u.iter().zip(&lanes.u) {
                    assert_eq!(one.to_bits(), lanes.lane(lane).to_bits());
                }
            }
        }
    }
}

/// A ring of bodies, each in contact with the next and every third with the ground; and the dof
/// lists of the rows' spans.
fn ring<R: Real>(worlds: &[Problem], bodies: usize) -> (Rows<R>, Vec<usize>) {
    let (mut rows, mut lists, mut y) = (pack::<R>(worlds), vec![], vec![]);
    for block in &rows.blocks {
        let at = block.slot as usize;
        let own: Vec<usize> = if at < bodies {
            // Not one after another, so that some are side by side.
            let (this, next) = (7 * at % bodies, (7 * at + 1) % bodies);
            let (one, two) = (this.min(next), this.max(next));
            (6 * one..6 * one + 6).chain(6 * two..6 * two + 6).collect()
        } else {
            (18 * (at - bodies)..).take(6).collect()
        };
        for row in &mut rows.rows[block.rows.range()] {
            row.dofs = Span { start: lists.len(), len: own.len() };
            let given = std::mem::replace(&mut row.y, y.len());
            y.extend(own.iter().map(|k| rows.y[given + k]));
        }
        lists.extend(own);
    }
    rows.y = y;
    (rows, lists)
}

/// The input of `ring`: rows over all dofs.
fn ring_problem(bodies: usize, inv_d: &[f64], random: &mut Random) -> Problem {
    let guess: Vec<f64> = inv_d.iter().map(|_| random.next()).collect();
    let mut problem = Problem::new(inv_d, &guess);
    for _ in 0..bodies + bodies / 3 {
        let given = contacts(Set::Interval, 1, 0.05, random).blocks.remove(0).2;
        let ways: Vec<Vec<f64>> =
            given.iter().map(|_| inv_d.iter().map(|_| random.next()).collect()).collect();
        let edge = |way: usize, mu: f64| {
            let y = ways[0].iter().zip(&ways[way]).map(|(n, t)| n + mu * t).collect();
            (y, given[0].1 + mu * given[way].1, 0.05, 0.0, INF)
        };
        let edges = vec![edge(1, 0.7), edge(1, -0.7), edge(2, 0.7), edge(2, -0.7)];
        problem.blocks.push((Set::Interval, 0.7, edges));
    }
    problem
}

/// Against rows one by one, and against lanes, which are never side by side, to the last bit.
#[test]
fn side_by_side_is_one_after_another() {
    const BODIES: usize = 24;
    let mut random = Random::new(5);
    let inv_d: Vec<f64> = (0..6 * BODIES).map(|_| random.next().exp()).collect();
    let worlds: Vec<Problem> =
        (0..WIDTH).map(|_| ring_problem(BODIES, &inv_d, &mut random)).collect();
    for tolerance in [0.0, 1e-3] {
        let limits = Limits { sweeps: 9, tolerance, ..EVERY };
        let (mut lanes, lists) = ring::<Lanes>(&worlds, BODIES);
        lanes.heap = true;
        let inverse: Vec<Lanes> = inv_d.iter().map(|x| Lanes::of(*x)).collect();
        by_sweeps(&mut Pgs::new(), &lists, &inverse, &mut lanes, limits);
        for (lane, world) in worlds.iter().enumerate() {
            let [plain, side] = [false, true].map(|heap| {
                let (mut rows, _) = ring::<f64>(std::slice::from_ref(world), BODIES);
                rows.heap = heap;
                let mut pgs = Pgs::new();
                by_sweeps(&mut pgs, &lists, &inv_d, &mut rows, limits);
                assert_eq!(pgs.side_by_side(), heap);
                rows
            });
            assert!(side.rows.iter().any(|row| row.impulse > 0.0));
            for (k, (one, other)) in plain.rows.iter().zip(&side.rows).enumerate() {
                close(one.impulse, other.impulse, 1e-11);
                assert_eq!(other.impulse.to_bits(), lanes.rows[k].impulse.lane(lane).to_bits());
            }
            for (k, u) in side.u.iter().enumerate() {
                close(*u, plain.u[k], 1e-11);
                assert_eq!(u.to_bits(), lanes.u[k].lane(lane).to_bits());
            }
        }
    }
}

/// With momentum, contacts side by side converge to the same solution in fewer sweeps. Wherever
/// sweeps stop, impulses are within their sets, and u is their effect.
#[test]
fn momentum_side_by_side() {
    const BODIES: usize = 24;
    let mut random = Random::new(6);
    let inv_d: Vec<f64> = (0..6 * BODIES).map(|_| random.next().exp()).collect();
    for _ in 0..5 {
        let world = ring_problem(BODIES, &inv_d, &mut random);
        let solve = |momentum: bool, sweeps: u32, tolerance: f64| {
            let (mut rows, lists) = ring::<f64>(std::slice::from_ref(&world), BODIES);
            rows.heap = true;
            rows.contact_islands = Some(ContactIslands::default());
            let limits = Limits { sweeps, tolerance, momentum, ..EVERY };
            let mut pgs = Pgs::new();
            let report = by_sweeps(&mut pgs, &lists, &inv_d, &mut rows, limits);
            assert!(pgs.side_by_side());
            (rows, lists, report.sweeps.lane(0))
        };
        let [(plain, _, many), (fast, lists, few)] =
            [false, true].map(|momentum| solve(momentum, 100_000, 1e-10));
        assert!(5 * few < many && many < 100_000, "{few} {many}");
        for (one, other) in plain.rows.iter().zip(&fast.rows) {
            close(one.impulse, other.impulse, 1e-7);
        }
        for (one, other) in plain.u.iter().zip(&fast.u) {
            close(*one, *other, 1e-7);
        }
        for sweeps in [1, 2, 5, 50] {
            let (rows, _, _) = solve(true, sweeps, 0.0);
            let mut u = ring::<f64>(std::slice::from_ref(&world), BODIES).0.u;
            for row in &rows.rows {
                assert!(row.impulse >= 0.0);
                for (k, y) in row.dofs.of(&lists).iter().zip(&rows.y[row.y..]) {
                    u[*k] += inv_d[*k] * y * row.impulse;
                }
            }
            for (one, other) in u.iter().zip(&rows.u) {
                close(*one, *other, 1e-11);
            }
        }
    }
}
