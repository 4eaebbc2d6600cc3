//! The solvers against closed forms, enumeration and brute force, on hand-made matrices.

mod active_set;
mod cones;
mod derivative;
mod lanes;
mod nearly_unmoved;
mod newton;
mod packed;
mod proximal;
mod wide;
mod wide_cones;

use super::limits::{Limits, Report};
use super::pgs::Pgs;
use super::rows::{Block, Row, Rows, Set};
use super::solver::Unconstrained;
use crate::elements::{Element, Kind, Role};
use crate::model::Span;
use crate::real::{Mask, Real};

/// Reproducible numbers in [−1, 1).
pub(super) struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
    pub fn below(&mut self, n: usize) -> usize {
        ((self.next() + 1.0) * 0.5 * n as f64) as usize
    }
}

/// y, t, c, lo, hi of a row.
pub(super) type Line = (Vec<f64>, f64, f64, f64, f64);

/// A system on hand-made y: every row acts on all dofs.
#[derive(Clone)]
pub(super) struct Problem {
    pub inv_d: Vec<f64>,
    pub guess: Vec<f64>,
    /// Per block: set, μ, rows.
    pub blocks: Vec<(Set, f64, Vec<Line>)>,
}

const INF: f64 = f64::INFINITY;

/// Sweep from û, which `rows.u` holds.
pub fn by_sweeps<R: Real>(
    pgs: &mut Pgs<R>,
    dof_lists: &[usize],
    inv_d: &[R],
    rows: &mut Rows<R>,
    limits: Limits,
) -> Report<R> {
    let guess = rows.u.clone();
    pgs.solve(Unconstrained { dof_lists, inv_d, guess: &guess }, rows, limits)
}

impl Problem {
    pub fn new(inv_d: &[f64], guess: &[f64]) -> Self {
        Self { inv_d: inv_d.to_vec(), guess: guess.to_vec(), blocks: Vec::new() }
    }
    pub fn limit(&mut self, y: &[f64], t: f64, c: f64) {
        self.blocks.push((Set::Interval, 0.0, vec![(y.to_vec(), t, c, 0.0, INF)]));
    }
    pub fn dof_lists(&self) -> Vec<usize> {
        (0..self.inv_d.len()).collect()
    }
    /// The motion without rows; `dof_lists`: as `Problem::dof_lists`.
    pub fn free<'a>(&'a self, dof_lists: &'a [usize]) -> Unconstrained<'a, f64> {
        Unconstrained { dof_lists, inv_d: &self.inv_d, guess: &self.guess }
    }
    /// Returns the same problem with random changes of guess, target and y.
    pub fn shaken(&self, random: &mut Random) -> Self {
        let mut new = self.clone();
        new.guess.iter_mut().for_each(|g| *g += 0.3 * random.next());
        for row in new.blocks.iter_mut().flat_map(|b| &mut b.2) {
            row.1 += 0.1 * random.next();
            row.0.iter_mut().for_each(|y| *y += 0.1 * random.next() * *y);
        }
        new
    }
    pub fn rows<R: Real>(&self) -> Rows<R> {
        pack(std::slice::from_ref(self))
    }
}

/// Pack problems of one shape, one per lane (the last repeats).
pub(super) fn pack<R: Real>(worlds: &[Problem]) -> Rows<R> {
    let first = &worlds[0];
    let of = |get: &dyn Fn(&Problem) -> f64| {
        let mut x = R::of(get(&worlds[0]));
        for lane in 0..R::LANES {
            x.set_lane(lane, get(&worlds[lane.min(worlds.len() - 1)]));
        }
        x
    };
    let nv = first.inv_d.len();
    let mut rows = Rows::bare(nv);
    for (b, (set, mu, list)) in first.blocks.iter().enumerate() {
        let start = rows.rows.len();
        for (r, (_, _, c, lo, hi)) in list.iter().enumerate() {
            let at = rows.y.len();
            let mut a = R::zero();
            for k in 0..nv {
                let y = of(&|p| p.blocks[b].2[r].0[k]);
                a += y * y * of(&|p| p.inv_d[k]);
                rows.y.push(y);
            }
            rows.rows.push(Row {
                dofs: Span { start: 0, len: nv },
                y: at,
                t: of(&|p| p.blocks[b].2[r].1),
                c: R::of(*c),
                a,
                inv_s: (a + R::of(*c)).recip_or_zero(),
                lo: R::of(*lo),
                hi: R::of(*hi),
                impulse: R::zero(),
                beside: R::zero(),
                velocity: R::zero(),
                gap: R::zero(),
            });
        }
        rows.blocks.push(Block {
            rows: Span { start, len: list.len() },
            set: *set,
            mask: R::Mask::of(true),
            mu: R::of(*mu),
            mass: R::one(),
            role: Role::Limit,
            element: Element::part(Kind::Contact, b, 0),
            slot: b as u64,
            kin: b as u64..b as u64 + 1,
            feature: R::zero(),
            island: 0,
            rank: b as u32,
        });
    }
    for k in 0..nv {
        rows.u[k] = of(&|p| p.guess[k]);
    }
    rows.inertia.push(R::one());
    rows
}

pub(super) const EVERY: Limits = Limits {
    sweeps: 20_000,
    tolerance: 1e-14,
    momentum: false,
    cost: 0.0,
    solves_one: true,
    exact: false,
    rounding: false,
};

/// Converged PGS: impulses by row.
pub(super) fn converged(problem: &Problem) -> Vec<f64> {
    let mut rows = problem.rows::<f64>();
    by_sweeps(&mut Pgs::new(), &problem.dof_lists(), &problem.inv_d, &mut rows, EVERY);
    assert!(rows.residual(&problem.dof_lists()) < 1e-12);
    rows.rows.iter().map(|row| row.impulse).collect()
}

pub(super) fn close(a: f64, b: f64, tolerance: f64) {
    assert!((a - b).abs() <= tolerance, "{a} against {b}");
}

/// Makes a round cone contact with random y in front of a random body.
pub(super) fn contacts(set: Set, count: usize, c: f64, random: &mut Random) -> Problem {
    let nv = 6;
    let inv_d: Vec<f64> = (0..nv).map(|_| (2.0 * random.next()).exp()).collect();
    let guess: Vec<f64> = (0..nv).map(|_| random.next()).collect();
    let mut problem = Problem::new(&inv_d, &guess);
    for _ in 0..count {
        let mut row = |c: f64| {
            let y = (0..nv).map(|_| random.next()).collect();
            (y, 0.3 * random.next(), c, 0.0, INF)
        };
        let list = vec![row(c), row(c / 2.0), row(c / 2.0)];
        problem.blocks.push((set, 0.7, list));
    }
    problem
}

#[test]
fn s1_one_contact_in_closed_form() {
    for set in [Set::CoulombRound, Set::CoulombBox] {
        for (mu, want) in [(1000.0, [1.0 / 3.0, 1.0 / 12.0, 0.25]), (0.0, [1.0 / 3.0, 0.0, 0.0])] {
            let mut problem = Problem::new(&[3.0, 12.0, 4.0], &[-1.0; 3]);
            let unit = |k: usize| (0..3).map(|i| f64::from(u8::from(i == k))).collect::<Vec<_>>();
            let list = (0..3).map(|k| (unit(k), 0.0, 0.0, 0.0, INF)).collect();
            problem.blocks.push((set, mu, list));
            let mut rows = problem.rows::<f64>();
            let limits = Limits { sweeps: 50, tolerance: 1e-14, ..EVERY };
            let report =
                by_sweeps(&mut Pgs::new(), &problem.dof_lists(), &problem.inv_d, &mut rows, limits);
            assert!(report.sweeps.lane(0) <= 3);
            for k in 0..3 {
                close(rows.rows[k].impulse, want[k], 1e-15);
                close(rows.u[k], if mu > 0.0 || k == 0 { 0.0 } else { -1.0 }, 1e-15);
            }
        }
    }
}

#[test]
fn no_rows_no_sweeps() {
    let problem = Problem::new(&[1.0], &[-1.0]);
    let mut rows = problem.rows::<f64>();
    let report = by_sweeps(&mut Pgs::new(), &[0], &problem.inv_d, &mut rows, EVERY);
    assert_eq!((report.sweeps.lane(0), report.updates.lane(0), rows.u[0]), (0, 0, -1.0));
}

/// Solves A x = b by Gauss-Jordan with pivoting; None when singular.
fn dense_solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Option<Vec<f64>> {
    let n = b.len();
    for i in 0..n {
        let p = (i..n).max_by(|p, q| a[*p][i].abs().total_cmp(&a[*q][i].abs()))?;
        a.swap(i, p);
        b.swap(i, p);
        if a[i][i].abs() < 1e-13 {
            return None;
        }
        for r in 0..n {
            if r != i {
                let f = a[r][i] / a[i][i];
                for c in i..n {
                    a[r][c] -= f * a[i][c];
                }
                b[r] -= f * b[i];
            }
        }
    }
    Some((0..n).map(|i| b[i] / a[i][i]).collect())
}

/// Solves 0 ≤ λ ⟂ Kλ + q ≥ 0 by trying every active set.
fn enumerate(k: &[Vec<f64>], q: &[f64]) -> Option<Vec<f64>> {
    let n = q.len();
    (0..1usize << n).find_map(|set| {
        let on: Vec<usize> = (0..n).filter(|i| set >> i & 1 == 1).collect();
        let a = on.iter().map(|i| on.iter().map(|j| k[*i][*j]).collect()).collect();
        let x = dense_solve(a, on.iter().map(|i| -q[*i]).collect())?;
        let mut full = vec![0.0; n];
        on.iter().zip(&x).for_each(|(i, x)| full[*i] = *x);
        let w = |i: usize| q[i] + (0..n).map(|j| k[i][j] * full[j]).sum::<f64>();
        (x.iter().all(|x| *x >= -1e-12) && (0..n).all(|i| w(i) >= -1e-11)).then_some(full)
    })
}

#[test]
fn s4_random_lcp_equals_enumeration() {
    let mut random = Random::new(4);
    for _ in 0..500 {
        let n = 1 + random.below(8);
        let nv = 1 + random.below(8);
        let inv_d: Vec<f64> = (0..nv).map(|_| (3.0 * random.next()).exp()).collect();
        let guess: Vec<f64> = (0..nv).map(|_| random.next()).collect();
        let mut problem = Problem::new(&inv_d, &guess);
        let c = 0.05;
        for _ in 0..n {
            let y: Vec<f64> = (0..nv).map(|_| random.next()).collect();
            problem.limit(&y, 0.5 * random.next(), c);
        }
        let list: Vec<_> = problem.blocks.iter().map(|b| b.2[0].clone()).collect();
        let a = |i: usize, j: usize| {
            (0..nv).map(|k| list[i].0[k] * inv_d[k] * list[j].0[k]).sum::<f64>()
        };
        let k: Vec<Vec<f64>> = (0..n)
            .map(|i| (0..n).map(|j| a(i, j) + if i == j { c } else { 0.0 }).collect())
            .collect();
        let q: Vec<f64> = list
            .iter()
            .map(|r| r.0.iter().zip(&guess).map(|(y, u)| y * u).sum::<f64>() - r.1)
            .collect();
        let Some(exact) = enumerate(&k, &q) else { panic!("no active set fits") };
        for (got, want) in converged(&problem).iter().zip(&exact) {
            close(*got, *want, 1e-10);
        }
    }
}

/// Balls of these masses, each on the one before it, the first on the floor.
fn stack(masses: &[f64]) -> Problem {
    let inv_d: Vec<f64> = masses.iter().map(|m| 1.0 / m).collect();
    let mut problem = Problem::new(&inv_d, &vec![-0.02; masses.len()]);
    for i in 0..masses.len() {
        let mut y = vec![0.0; masses.len()];
        y[i] = 1.0;
        if i > 0 {
            y[i - 1] = -1.0;
        }
        problem.limit(&y, 0.0, 0.0);
    }
    problem
}

/// cases.md C6: a stack of N equal balls on the floor loses cos²(π/2N) per sweep, two balls
/// m_top/(m_top + m_bottom).
#[test]
fn c6_contraction_of_a_stack() {
    let law = |n: f64| (std::f64::consts::PI / (2.0 * n)).cos().powi(2);
    let cases: [(&[f64], f64); 4] = [
        (&[1.0, 1.0], 0.5),
        (&[1.0, 10.0], 10.0 / 11.0),
        (&[1.0; 10], law(10.0)),
        (&[1.0; 4], law(4.0)),
    ];
    for (masses, want) in cases {
        let problem = stack(masses);
        let mut rows = problem.rows::<f64>();
        let (mut pgs, lists) = (Pgs::new(), problem.dof_lists());
        let mut after = |rows: &mut Rows<f64>, sweeps| {
            let limits = Limits { sweeps, tolerance: 0.0, ..EVERY };
            by_sweeps(&mut pgs, &lists, &problem.inv_d, rows, limits);
            rows.residual(&lists)
        };
        let start = after(&mut rows, (6.0 / (1.0 - want)) as u32 / 4);
        let end = after(&mut rows, 10);
        close((end / start).powf(0.1) / want, 1.0, 0.01);
    }
}

/// On ten balls plain sweeps lose cos²(π/20) each: a factor of two in 25. Momentum, close to
/// conjugate gradients with four stored moves, loses a thousand times more.
#[test]
fn momentum_beats_the_contraction_of_a_stack() {
    let problem = stack(&[1.0; 10]);
    let mut residual = [0.0; 2];
    for (at, momentum) in [false, true].into_iter().enumerate() {
        let mut rows = problem.rows::<f64>();
        let limits = Limits { sweeps: 25, tolerance: 0.0, momentum, ..EVERY };
        by_sweeps(&mut Pgs::new(), &problem.dof_lists(), &problem.inv_d, &mut rows, limits);
        residual[at] = rows.residual(&problem.dof_lists());
    }
    assert!(residual[1] < 1e-3 * residual[0], "{residual:?}");
}

#[test]
fn degenerate_rows_change_nothing() {
    let mut random = Random::new(5);
    let mut problem = contacts(Set::CoulombRound, 2, 0.0, &mut random);
    let y: Vec<f64> = (0..6).map(|_| random.next()).collect();
    problem.limit(&y, 0.4, 0.0);
    let clean = {
        let mut rows = problem.rows::<f64>();
        by_sweeps(&mut Pgs::new(), &problem.dof_lists(), &problem.inv_d, &mut rows, EVERY);
        rows.u
    };
    problem.limit(&[0.0; 6], 0.7, 0.0);
    problem.limit(&y, 0.4, 0.0);
    problem.blocks.push((Set::CoulombRound, 0.5, vec![(vec![0.0; 6], 0.1, 0.0, 0.0, INF)]));
    let mut rows = problem.rows::<f64>();
    by_sweeps(&mut Pgs::new(), &problem.dof_lists(), &problem.inv_d, &mut rows, EVERY);
    assert!(rows.residual(&problem.dof_lists()) < 1e-12);
    for (a, b) in rows.u.iter().zip(&clean) {
        close(*a, *b, 1e-10);
    }
}

/// Momentum moves u along stored moves instead of row by row: u must not drift away from the effect
/// of the impulses, however many sweeps follow convergence.
#[test]
fn momentum_keeps_u_and_impulses_together() {
    let mut random = Random::new(6);
    for case in 0..60 {
        let mut problem = contacts(Set::Convex, 1 + case % 4, 0.05, &mut random);
        for _ in 0..case % 7 {
            let y: Vec<f64> = (0..6).map(|_| random.next()).collect();
            problem.limit(&y, 0.3 * random.next(), if case % 2 == 0 { 0.02 } else { 0.0 });
        }
        for sweeps in [10, 100, 3000] {
            let mut rows = problem.rows::<f64>();
            let limits = Limits { sweeps, tolerance: 0.0, momentum: true, ..EVERY };
            by_sweeps(&mut Pgs::new(), &problem.dof_lists(), &problem.inv_d, &mut rows, limits);
            for (k, guess) in problem.guess.iter().enumerate() {
                let kicks = rows.rows.iter().map(|row| rows.y[row.y + k] * row.impulse);
                let want = guess + problem.inv_d[k] * kicks.sum::<f64>();
                close(rows.u[k], want, 1e-12);
            }
        }
    }
}
