//! Contacts that are packed for sweeps, against the same rows one by one.

use super::{close, contacts, pack, Problem, Random, INF};
use crate::real::{Lanes, Real, WIDTH};
use crate::solve::limits::Limits;
use crate::solve::pgs::Pgs;
use crate::solve::rows::{Rows, Set};

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

/// Nine sweeps; where rows allow it, with momentum too.
fn each_way(set: Set) -> impl Iterator<Item = Limits> {
    let convex = matches!(set, Set::Interval | Set::Convex);
    let way =
        |momentum| Limits { sweeps: 9, tolerance: 1e-9, momentum, exact: false, rounding: false };
    [false, true].into_iter().filter(move |momentum| convex || !momentum).map(way)
}

fn swept<R: Real>(problem: &Problem, mut rows: Rows<R>, heap: bool, limits: Limits) -> Rows<R> {
    rows.heap = heap;
    let inv_d: Vec<R> = problem.inv_d.iter().map(|x| R::of(*x)).collect();
    Pgs::new().solve(&problem.dof_lists(), &inv_d, &mut rows, limits);
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
