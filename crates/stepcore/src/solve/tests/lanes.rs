//! A lane equals, bit for bit, the world that it holds.

use super::active_set::intervals;
use super::newton::mixed;
use super::proximal::stack;
use super::wide_cones::wide_contacts;
use super::{by_sweeps, contacts, pack, Problem, Random, EVERY, INF};
use crate::model::Span;
use crate::real::{Lanes, Mask, Real, WIDTH};
use crate::solve::limits::{Limits, Report};
use crate::solve::newton::Newton;
use crate::solve::pgs::Pgs;
use crate::solve::rows::{Rows, Set};
use crate::solve::solver::{Solvers, Unconstrained};

/// The solver: PGS with these limits, PGS with fallback, or Newton.
#[derive(Clone, Copy)]
enum By {
    Pgs(Limits),
    Auto(Limits),
    Newton(Limits),
}

fn solve<R: Real>(by: By, lists: &[usize], inv_d: &[f64], rows: &mut Rows<R>) -> Report<R> {
    let inv_d: Vec<R> = inv_d.iter().map(|x| R::of(*x)).collect();
    match by {
        By::Pgs(limits) => by_sweeps(&mut Pgs::new(), lists, &inv_d, rows, limits),
        By::Auto(limits) => {
            let guess = rows.u.clone();
            let free = Unconstrained { dof_lists: lists, inv_d: &inv_d, guess: &guess };
            Solvers::new().solve_for_sure(limits, free, rows)
        }
        By::Newton(limits) => {
            let guess = rows.u.clone();
            let free = Unconstrained { dof_lists: lists, inv_d: &inv_d, guess: &guess };
            Newton::new().solve(free, rows, limits).unwrap()
        }
    }
}

/// Limit block b to the dofs `keep(b)`.
fn thin<R: Real>(
    rows: &mut Rows<R>,
    inv_d: &[f64],
    keep: impl Fn(usize) -> Vec<usize>,
) -> Vec<usize> {
    let mut lists = Vec::new();
    let all = std::mem::take(&mut rows.y);
    for (b, block) in rows.blocks.iter().enumerate() {
        let dofs = keep(b);
        let span = Span { start: lists.len(), len: dofs.len() };
        for row in &mut rows.rows[block.rows.range()] {
            row.dofs = span;
            row.a = R::zero();
            let from = std::mem::replace(&mut row.y, rows.y.len());
            for (at, k) in dofs.iter().enumerate() {
                let y = all[from + at];
                rows.y.push(y);
                row.a += y * y * R::of(inv_d[*k]);
            }
            row.inv_s = (row.a + row.c).recip_or_zero();
        }
        lists.extend(dofs);
    }
    lists
}

/// Solves perturbed copies of a problem in lanes and alone; `has(block, lane)` is true for the lanes
/// in which a block exists.
fn compare(base: &Problem, by: By, random: &mut Random, has: impl Fn(usize, usize) -> bool) {
    for heap in [false, true] {
        compare_as(heap, base, by, random, &has);
    }
}

fn compare_as(
    heap: bool,
    base: &Problem,
    by: By,
    random: &mut Random,
    has: impl Fn(usize, usize) -> bool,
) {
    let worlds: Vec<Problem> = (0..WIDTH).map(|_| base.shaken(random)).collect();
    let nv = base.inv_d.len();
    // Block b touches dofs b.., so that a lane without it has a smaller pattern.
    let keep =
        |b: usize| (0..nv).filter(|k| !(k + b).is_multiple_of(3) || b == 0).collect::<Vec<_>>();
    let mut packed = pack::<Lanes>(&worlds);
    packed.heap = heap;
    let lists = thin(&mut packed, &base.inv_d, keep);
    for (b, block) in packed.blocks.iter_mut().enumerate() {
        block.mask = Mask::from_lanes(|lane| has(b, lane));
    }
    let report = solve(by, &lists, &base.inv_d, &mut packed);
    for (lane, world) in worlds.iter().enumerate() {
        let mut rows = world.rows::<f64>();
        rows.heap = heap;
        let lists = thin(&mut rows, &base.inv_d, keep);
        // Alone, a missing block is absent.
        let mut at = 0;
        rows.blocks.retain(|_| {
            at += 1;
            has(at - 1, lane)
        });
        let alone = solve(by, &lists, &world.inv_d, &mut rows);
        assert_eq!(alone.sweeps.lane(0), report.sweeps.lane(lane));
        assert_eq!(alone.updates.lane(0), report.updates.lane(lane));
        assert_eq!(alone.decrement.to_bits(), report.decrement.lane(lane).to_bits());
        for k in 0..nv {
            assert_eq!(rows.u[k].to_bits(), packed.u[k].lane(lane).to_bits(), "u[{k}] of {lane}");
        }
        for block in &rows.blocks {
            for at in block.rows.range() {
                let (a, b) = (rows.rows[at].impulse, packed.rows[at].impulse.lane(lane));
                assert_eq!(a.to_bits(), b.to_bits(), "row {at} of {lane}");
            }
        }
    }
}

#[test]
fn under_pgs() {
    let mut random = Random::new(11);
    for set in [Set::Interval, Set::Convex, Set::CoulombRound, Set::CoulombBox] {
        let mut base = contacts(set, 3, 0.1, &mut random);
        base.limit(&[1.0, 0.0, 0.5, 0.0, 0.0, -0.25], 0.1, 0.01);
        base.blocks.push((Set::Interval, 0.0, vec![(vec![0.3; 6], 0.0, 0.02, -0.1, 0.1)]));
        base.blocks.push((Set::Interval, 0.0, vec![(vec![0.2; 6], 0.0, 0.0, -INF, INF)]));
        let cases = [
            (300, 1e-6, false, 0.0),
            (3, 0.0, false, 0.0),
            (300, 0.0, false, 1e-3),
            (300, 1e-6, true, 0.0),
            (9, 0.0, true, 0.0),
            (300, 0.0, true, 1e-4),
        ];
        let convex = matches!(set, Set::Interval | Set::Convex);
        let fit = |case: &(u32, f64, bool, f64)| convex || !case.2 && case.3 <= 0.0;
        for (sweeps, tolerance, momentum, cost) in cases.into_iter().filter(fit) {
            let by = By::Pgs(Limits { sweeps, tolerance, momentum, cost, ..EVERY });
            compare(&base, by, &mut random, |_, _| true);
            compare(&base, by, &mut random, |b, lane| (b + lane) % 4 != 1);
            compare(&base, by, &mut random, |b, lane| b == lane);
        }
    }
}

/// Contacts under masses of 1 to 10⁶ that three sweeps leave unsolved.
#[test]
fn beyond_sweeps() {
    let mut random = Random::new(44);
    let limits = Limits { sweeps: 3, tolerance: 1e-10, exact: true, rounding: true, ..EVERY };
    for set in [Set::Interval, Set::CoulombRound, Set::CoulombBox] {
        for masses in [[1e-3, 1e3], [1.0, 0.5]] {
            let base = stack(set, &masses, 0.3, 2);
            compare(&base, By::Auto(limits), &mut random, |_, _| true);
            compare(&base, By::Auto(limits), &mut random, |b, lane| (b + lane) % 4 != 1);
        }
        let wide = wide_contacts(
            if set == Set::Interval { Set::Convex } else { set },
            2,
            0.0,
            &mut random,
        );
        compare(&wide, By::Auto(limits), &mut random, |b, lane| b == 0 || lane % 2 == 0);
    }
}

#[test]
fn with_torsion_and_rolling() {
    let mut random = Random::new(12);
    for set in [Set::Convex, Set::CoulombRound, Set::CoulombBox] {
        let base = wide_contacts(set, 3, 0.1, &mut random);
        let cases = [(300, 1e-6, false), (3, 0.0, false), (300, 1e-6, true), (9, 0.0, true)];
        let convex = set == Set::Convex;
        for (sweeps, tolerance, momentum) in cases.into_iter().filter(|c| convex || !c.2) {
            let limits = Limits { sweeps, tolerance, momentum, ..EVERY };
            for by in [By::Pgs(limits), By::Newton(limits)] {
                if matches!(by, By::Pgs(_)) || convex && !momentum {
                    compare(&base, by, &mut random, |_, _| true);
                    compare(&base, by, &mut random, |b, lane| (b + lane) % 4 != 1);
                    compare(&base, by, &mut random, |b, lane| b == lane);
                }
            }
        }
    }
}

#[test]
fn under_newton() {
    let mut random = Random::new(22);
    for _ in 0..20 {
        for tolerance in [0.0, 1e-6] {
            let base = mixed(&mut random);
            let by = By::Newton(Limits { sweeps: 50, tolerance, ..EVERY });
            compare(&base, by, &mut random, |_, _| true);
            compare(&base, by, &mut random, |b, lane| (b + lane) % 4 != 1);
            compare(&base, by, &mut random, |b, lane| b == lane);
        }
    }
}

/// Lanes with one row, with few and with many, in parallel.
#[test]
fn under_newton_with_few_rows() {
    let mut random = Random::new(33);
    for count in [1, 2, 5, 16, 20] {
        for tolerance in [0.0, 1e-6] {
            let base = intervals(count, &mut random);
            let by = By::Newton(Limits { sweeps: 50, tolerance, exact: true, ..EVERY });
            compare(&base, by, &mut random, |_, _| true);
            compare(&base, by, &mut random, |b, lane| (b + lane) % 4 != 1);
            compare(&base, by, &mut random, |b, lane| b <= 3 * lane);
        }
    }
}
