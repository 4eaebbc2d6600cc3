//! Projected Gauss-Seidel in factored coordinates.
//!
//! Plain: the rows of an island in order, sweep after sweep. An interval row moves
//! its impulse by (t − Jv − cλ)/s and clamps it; a cone is solved exactly as one
//! block. A sweep touches y and u only, never a matrix of rows.

mod cones;
mod noslip;
mod packed;
mod point;
mod side_by_side;
mod sweep;
mod sweep_momentum;

use super::islands::{alive, row_count, Islands};
use super::limits::{Limits, Report};
use super::momentum::Momentum;
use super::rows::{Rows, Set};
use super::solver::Unconstrained;
use crate::interrupt::{Meter, ROW};
use crate::real::{Count, Mask, Real};
pub(crate) use noslip::Noslip;
use sweep::Sweeps;

/// The rounding error of a residual, in units in the last place of its terms.
const UNITS: f64 = 32.0;

/// The method's memory; one per world or pack of lanes.
pub struct Pgs<R: Real> {
    islands: Islands,
    sweeps: Sweeps<R>,
    momentum: Momentum<R>,
    /// Islands that used up their sweeps, and in which lanes.
    pub(super) open: Vec<(usize, R::Mask)>,
}

room!(Pgs<R>: islands, sweeps, momentum, open);

impl<R: Real> Default for Pgs<R> {
    fn default() -> Self {
        Self::new()
    }
}

impl<R: Real> Pgs<R> {
    pub fn new() -> Self {
        Self {
            islands: Islands::default(),
            sweeps: Sweeps::new(),
            momentum: Momentum::new(),
            open: Vec::new(),
        }
    }

    /// Returns the blocks of an island of the last solved rows.
    pub(super) fn blocks_of(&self, island: usize) -> &[usize] {
        self.islands.of(island)
    }

    /// Returns √(A/m) of these rows.
    pub(super) fn weight(&self) -> &[R] {
        &self.sweeps.weight
    }

    /// Returns whether the last island's contacts were side by side.
    #[cfg(test)]
    pub(super) fn side_by_side(&self) -> bool {
        self.sweeps.joined
    }

    /// Sweep over `rows` from their impulses; `rows.u` must hold û and the effect of these
    /// impulses, and does so again afterwards.
    ///
    /// With a tolerance an island stops, lane by lane, after the first sweep whose residual is
    /// within it. The residual costs as much as a sweep, so it is computed only if the largest
    /// change of the sweep is already within the tolerance.
    pub fn solve(
        &mut self,
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
        limits: Limits,
    ) -> Report<R> {
        let Self { islands, sweeps, momentum, open } = self;
        let Unconstrained { dof_lists, inv_d, .. } = free;
        open.clear();
        islands.sort(&rows.blocks);
        let (mut report, mut prepared): (Report<R>, bool) = (Report::new(), false);
        for island in 0..islands.count() {
            let blocks = islands.of(island);
            let mut todo = alive(rows, blocks);
            // Cases in which one update is requested, or suffices.
            if limits.exact || limits.sweeps == 1 {
                let single = rows.solve_one_row(free, blocks, limits.solves_one, &mut report);
                report.open = report.open.or(todo.and(single).and(R::Mask::of(!limits.exact)));
                todo = todo.and(single.not());
            }
            if todo.none() {
                continue;
            }
            if !std::mem::replace(&mut prepared, true) {
                sweeps.prepare(dof_lists, inv_d, rows, limits.tolerance > 0.0);
            }
            let convex = |b: &usize| matches!(rows.blocks[*b].set, Set::Interval | Set::Convex);
            let accelerated = limits.momentum && blocks.iter().all(convex);
            // Lanes are not joined, and must match single worlds: piles with found pairs are not
            // either.
            sweeps.join(inv_d, rows, blocks, !accelerated || rows.contact_islands.is_some());
            // The first sweep that lowers f by less is the last.
            let inertia = rows.inertia.get(island).filter(|_| limits.cost > 0.0);
            let floor = inertia.map(|inertia| R::of(limits.cost) * *inertia);
            let measured = accelerated || floor.is_some();
            let mut momentum = (accelerated && !sweeps.joined).then_some(&mut *momentum);
            if let Some(momentum) = &mut momentum {
                momentum.begin(dof_lists, inv_d, rows, blocks);
            } else if measured {
                sweeps.measure(inv_d, accelerated);
            }
            let tolerance = reachable(dof_lists, rows, &sweeps.weight, blocks, limits);
            let judged = R::zero().lt(tolerance);
            let (count, mut done) = (row_count(rows, blocks), Count::ZERO);
            let plain = momentum.is_none();
            let (mut meter, work) = (Meter::default(), ROW * blocks.len());
            for sweep in 0..limits.sweeps {
                if todo.none() {
                    break;
                }
                let order = momentum.as_mut().map_or(blocks, |momentum| momentum.order(sweep));
                let swept = if measured {
                    sweeps.sweep::<true>(dof_lists, inv_d, rows, order, todo)
                } else {
                    sweeps.sweep::<false>(dof_lists, inv_d, rows, order, todo)
                };
                done.add(todo, 1);
                report.updates.add_each(todo, &count);
                if let Some(floor) = floor {
                    todo = todo.and(swept.gain.abs().lt(floor).not());
                }
                if todo.none() {
                    break;
                }
                if let Some(momentum) = &mut momentum {
                    momentum.step(dof_lists, inv_d, rows, blocks, swept.gain, todo);
                }
                let close = todo.and(swept.change.le(tolerance)).and(judged);
                if close.any() {
                    if plain {
                        sweeps.store(rows, blocks);
                    }
                    let residual = rows.residual_of(dof_lists, blocks);
                    todo = todo.and(close.and(residual.le(tolerance)).not());
                }
                meter.count(work);
                // The last sweep, whichever it is, ends within the sets.
                if todo.any() && sweep + 1 < limits.sweeps {
                    sweeps.go_on();
                }
            }
            if plain {
                sweeps.store(rows, blocks);
            }
            report.sweeps.raise(&done);
            report.open = report.open.or(todo);
            if todo.any() {
                open.push((island, todo));
            }
        }
        report
    }
}

/// Returns the tolerance, raised to the rounding error of any row.
pub(super) fn reachable<R: Real>(
    dof_lists: &[usize],
    rows: &Rows<R>,
    weight: &[R],
    blocks: &[usize],
    limits: Limits,
) -> R {
    let mut tolerance = R::of(limits.tolerance);
    if !limits.rounding {
        return tolerance;
    }
    for block in blocks.iter().map(|b| &rows.blocks[*b]) {
        for at in block.rows.range() {
            let row = &rows.rows[at];
            let dofs = row.dofs.of(dof_lists);
            let mut terms = row.t.abs() + (row.c * row.impulse).abs();
            for (k, y) in dofs.iter().zip(&rows.y[row.y..]) {
                terms += (*y * rows.u[*k]).abs();
            }
            let least = R::of(UNITS * R::epsilon()) * terms * row.inv_s * weight[at];
            tolerance = R::select(block.mask, tolerance.max(least), tolerance);
        }
    }
    tolerance
}
