//! Slopes of impulses: the rows are solved in `f64`, then the solution is differentiated once.
//!
//! A solution (λ, u) meets F(λ, u, p) = 0: u = û + D⁻¹ Σ yλ, and the law of every row with the
//! slack w = y·u + cλ − t. Along a change of p the impulses move as the active rows permit
//! (`active.rs`): dλ = P a, with one number aᵢ per free direction. In each direction the law
//! remains met, Sᵀdw + B a = 0. With ẇ the part of dw at constant λ,
//!
//! ```text
//! (Sᵀ(A + C)P + B) a = −Sᵀẇ        du = (du at constant λ) + D⁻¹ Σ y dλ
//! ```
//!
//! That is the implicit function theorem, and the same for every solver that reached a solution.
//! Sweeps that did not reach one are differentiated as an algorithm: in numbers that carry their
//! slopes. If a change of p may or may not change the active rows (`corners.rs`), these are
//! one-sided derivatives, and `degenerate` lists the elements.

mod active;
mod corners;
mod factor;

use super::cone::across;
use super::islands::Islands;
use super::limits::Report;
use super::rows::{Block, Row, Rows, Set, CONE};
use super::solver::{Solve, Solvers, Unconstrained};
use crate::elements::Element;
use crate::error::Result;
use crate::real::{Dual, WAYS};
use crate::room::{listed, Room};
use crate::settings::{Settings, Solver};
use active::{on_surface, Direction, Matrix};
use corners::{corners, Corner};
use factor::Factors;
use num_traits::Zero;

/// The number of remembered solutions: a step is repeated for other directions, and solves the same
/// rows each time.
const MOST_REMEMBERED: usize = 16;

/// Solves in `f64` and adds the slopes of the solution.
pub(crate) struct Differentiated {
    plain: Solvers<f64>,
    given: Given,
    solutions: Vec<Solution>,
    /// The place of the next solution.
    next: usize,
    /// For sweeps that reach no solution.
    carried: Solvers<Dual>,
    /// Per dof.
    force: Vec<Dual>,
    /// Per direction.
    rhs: Vec<[f64; WAYS]>,
    /// Elements whose rows had one-sided derivatives; ascending.
    degenerate: Vec<Element>,
}

/// The problem, without slopes.
#[derive(Clone, PartialEq)]
struct Given {
    inv_d: Vec<f64>,
    guess: Vec<f64>,
    rows: Vec<Row<f64>>,
    blocks: Vec<Block<f64>>,
    y: Vec<f64>,
    u: Vec<f64>,
    start: Vec<f64>,
    heap: bool,
}

/// A problem, its solution, and the directions in which its impulses may move.
struct Solution {
    given: Given,
    report: Report<f64>,
    impulse: Vec<f64>,
    u: Vec<f64>,
    islands: Vec<(Vec<Direction>, Factors)>,
    corners: Vec<Corner>,
}

room!(Differentiated: plain, given, solutions, next, carried, force, rhs, degenerate);

room!(Given: inv_d, guess, rows, blocks, y, u, start, heap);

impl Room for (Vec<Direction>, Factors) {
    fn room(&self) -> usize {
        listed(&self.0) + self.1.room()
    }
}

room!(Solution: given, report, impulse, u, islands, corners);

impl Solve<Dual> for Differentiated {
    fn solve(
        &mut self,
        settings: &Settings,
        free: Unconstrained<Dual>,
        rows: &mut Rows<Dual>,
    ) -> Result<Report<Dual>> {
        if settings.solver == Solver::Newton || settings.tolerance > 0.0 {
            self.given.take(free, rows);
            let known = self.solutions.iter().position(|solution| solution.given == self.given);
            let at = match known {
                Some(at) => at,
                None => self.remember(settings, free.dof_lists)?,
            };
            let report = self.solutions[at].report;
            if !report.open {
                self.differentiate(at, free, rows);
                return Ok(report.in_numbers());
            }
        }
        self.carried.solve(settings, free, rows)
    }

    fn renew(&mut self) {
        *self = Self::new();
    }

    fn take_degenerate(&mut self) -> Vec<Element> {
        std::mem::take(&mut self.degenerate)
    }
}

impl Differentiated {
    pub fn new() -> Self {
        Self {
            plain: Solvers::new(),
            given: Given::new(),
            solutions: Vec::new(),
            next: 0,
            carried: Solvers::new(),
            force: Vec::new(),
            rhs: Vec::new(),
            degenerate: Vec::new(),
        }
    }

    /// Solves the problem at hand; returns the place of its solution.
    fn remember(&mut self, settings: &Settings, dof_lists: &[usize]) -> Result<usize> {
        let solution = self.given.solved(&mut self.plain, settings, dof_lists)?;
        let at = self.next;
        self.next = (at + 1) % MOST_REMEMBERED;
        if at < self.solutions.len() {
            self.solutions[at] = solution;
        } else {
            self.solutions.push(solution);
        }
        Ok(at)
    }

    /// Writes the impulses and u of a solution, with their slopes.
    fn differentiate(&mut self, at: usize, free: Unconstrained<Dual>, rows: &mut Rows<Dual>) {
        let Self { solutions, force, rhs, degenerate, .. } = self;
        let solution = &solutions[at];
        let Given { inv_d, y, .. } = &solution.given;
        hold(&solution.impulse, free, rows, force);
        for (directions, factors) in &solution.islands {
            rhs.clear();
            rhs.extend(directions.iter().map(|direction| {
                let slack = direction.slack(rows, free.dof_lists);
                slack.map(|slope| -slope * direction.size)
            }));
            factors.solve(rhs);
            for (direction, a) in directions.iter().zip(rhs.iter()) {
                for (at, push) in direction.rows().zip(direction.push) {
                    let row = &mut rows.rows[at];
                    let slopes = a.map(|a| push * direction.size * a);
                    let list = row.dofs.of(free.dof_lists);
                    for (k, y) in list.iter().zip(&y[row.y..]) {
                        for (u, slope) in rows.u[*k].slopes.iter_mut().zip(slopes) {
                            *u += inv_d[*k] * y * slope;
                        }
                    }
                    for (own, slope) in row.impulse.slopes.iter_mut().zip(slopes) {
                        *own += slope;
                    }
                }
            }
        }
        for (u, solved) in rows.u.iter_mut().zip(&solution.u) {
            u.value = *solved;
        }
        for corner in &solution.corners {
            let Err(at) = degenerate.binary_search(&corner.element) else { continue };
            if corner.leaves(rows, free.dof_lists, free.guess) {
                degenerate.insert(at, corner.element);
            }
        }
    }
}

/// Sets these impulses, which move only with their bounds, and the effect on u.
fn hold(impulses: &[f64], free: Unconstrained<Dual>, rows: &mut Rows<Dual>, force: &mut Vec<Dual>) {
    force.clear();
    force.resize(rows.u.len(), Dual::zero());
    for block in rows.blocks.iter().filter(|block| block.mask) {
        let friction = friction_slopes(block, &impulses[block.rows.range()]);
        for (k, at) in block.rows.range().enumerate() {
            let row = &mut rows.rows[at];
            let slopes = match block.set {
                Set::Interval => bound_slopes(row, impulses[at]),
                _ => friction[k],
            };
            row.impulse = Dual { value: impulses[at], slopes };
            for (k, y) in row.dofs.of(free.dof_lists).iter().zip(&rows.y[row.y..]) {
                force[*k] += *y * row.impulse;
            }
        }
    }
    for (((u, guess), inv_d), force) in rows.u.iter_mut().zip(free.guess).zip(free.inv_d).zip(force)
    {
        *u = *guess + *inv_d * *force;
    }
}

/// The slopes of the impulse of a row at a bound, which moves with the bound.
fn bound_slopes(row: &Row<Dual>, impulse: f64) -> [f64; WAYS] {
    match impulse {
        x if x <= row.lo.value => row.lo.slopes,
        x if x >= row.hi.value => row.hi.slopes,
        _ => [0.0; WAYS],
    }
}

/// The slopes of friction impulses at their bound (μ times the normal impulse) as μ changes.
fn friction_slopes(block: &Block<Dual>, impulses: &[f64]) -> [[f64; WAYS]; CONE] {
    let mut slopes = [[0.0; WAYS]; CONE];
    let mu = block.mu;
    if block.set == Set::Interval || mu.slopes == [0.0; WAYS] || mu.value <= 0.0 {
        return slopes;
    }
    let mut all = [0.0; CONE];
    all[..impulses.len()].copy_from_slice(impulses);
    let bound = mu.value * all[0];
    let whole = match block.set {
        Set::CoulombBox => None,
        _ => Some(on_surface(across(&all), bound)),
    };
    for k in 1..impulses.len() {
        if whole.unwrap_or(all[k].abs() >= bound) {
            slopes[k] = mu.slopes.map(|slope| slope * all[k] / mu.value);
        }
    }
    slopes
}

impl Given {
    fn new() -> Self {
        Self {
            inv_d: Vec::new(),
            guess: Vec::new(),
            rows: Vec::new(),
            blocks: Vec::new(),
            y: Vec::new(),
            u: Vec::new(),
            start: Vec::new(),
            heap: false,
        }
    }

    fn take(&mut self, free: Unconstrained<Dual>, rows: &Rows<Dual>) {
        fn refill<T>(list: &mut Vec<T>, with: impl Iterator<Item = T>) {
            list.clear();
            list.extend(with);
        }
        let value = |x: &Dual| x.value;
        refill(&mut self.inv_d, free.inv_d.iter().map(value));
        refill(&mut self.guess, free.guess.iter().map(value));
        refill(&mut self.rows, rows.rows.iter().map(|row| row.at_lane(0)));
        refill(&mut self.blocks, rows.blocks.iter().map(|block| block.at_lane(0)));
        refill(&mut self.y, rows.y.iter().map(value));
        refill(&mut self.u, rows.u.iter().map(value));
        refill(&mut self.start, rows.start.iter().map(value));
        self.heap = rows.heap;
    }

    fn solved(
        &self,
        solvers: &mut Solvers<f64>,
        settings: &Settings,
        dof_lists: &[usize],
    ) -> Result<Solution> {
        let (Self { inv_d, guess, .. }, given) = (self, self.clone());
        let mut rows = Rows::bare(0);
        (rows.rows, rows.blocks, rows.y, rows.u) = (given.rows, given.blocks, given.y, given.u);
        (rows.start, rows.heap) = (given.start, given.heap);
        let free = Unconstrained { dof_lists, inv_d, guess };
        // Newton's converged solution is differentiated, not the one at which a step may stop early.
        let exact = Settings { cost_tolerance: 0.0, ..settings.clone() };
        let newton = settings.solver == Solver::Newton;
        let report = solvers.solve(if newton { &exact } else { settings }, free, &mut rows)?;
        let (mut islands, mut at_corners) = (Vec::new(), Vec::new());
        if !report.open {
            let mut order = Islands::default();
            order.sort(&rows.blocks);
            at_corners = corners(&rows, dof_lists, inv_d, guess);
            let mut matrix = Matrix::new(&rows, dof_lists, inv_d);
            for island in 0..order.count() {
                let blocks = order.of(island).iter();
                let blocks = blocks.map(|at| &rows.blocks[*at]).filter(|block| block.mask);
                let directions = matrix.directions(blocks.clone());
                let factors = Factors::of(matrix.of(&directions), directions.len());
                for corner in &mut at_corners {
                    let others = blocks.clone().filter(|block| block.rows.start != corner.block);
                    let others = matrix.directions(others);
                    if others.len() < directions.len() {
                        let rank = Factors::of(matrix.of(&others), others.len()).rank();
                        corner.repeats = rank == factors.rank();
                    }
                }
                islands.push((directions, factors));
            }
        }
        let impulse = rows.rows.iter().map(|row| row.impulse).collect();
        let (given, u, corners) = (self.clone(), rows.u, at_corners);
        Ok(Solution { given, report, impulse, u, islands, corners })
    }
}
