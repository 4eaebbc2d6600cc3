//! Newton's method on the primal problem, island by island, in factored coordinates.
//!
//! Minimises ½ (u − û)ᵀD(u − û) + Σ s(y·u − t): each block's law as a penalty s
//! (`newton/penalty.rs`), possible because every row has a regulariser c > 0. The
//! gradient is D(u − û) − Σ yλ; the Hessian D + Σ y s″ yᵀ is factored sparsely; the
//! line search is exact. Where no row changes its zone in a full step the problem
//! was quadratic along it, and the step was the last.

mod bundles;
mod by_lane;
mod columns;
mod hessian;
mod inverse;
mod minimise;
mod nodes;
mod order;
mod penalty;
mod refine;
mod system;
#[cfg(test)]
mod tests;

use super::few::{Few, Island};
use super::islands::{alive, row_count, Islands};
use super::limits::{Limits, Report};
use super::rows::{Rows, Set};
use super::solver::Unconstrained;
use crate::error::{Error, Result};
use crate::real::{Count, Mask, Real};
use crate::room::room;
use bundles::{Bundles, Problem};
use by_lane::ByLane;
use hessian::Pattern;
use nodes::NOWHERE;
use system::System;

/// The method's memory; one a world or pack of lanes.
pub struct Newton<R: Real> {
    islands: Islands,
    /// By island.
    patterns: Vec<Pattern>,
    present: Vec<usize>,
    /// Scratch of patterns, by dof.
    class: Vec<usize>,
    /// Of the island at hand.
    bundles: Bundles<R>,
    system: System<R>,
    few: Few<R>,
    /// Of heaps in lanes.
    by_lane: Option<Box<ByLane>>,
}

room!(Newton<R>: present, class; islands, patterns, bundles, system, few, by_lane);

impl<R: Real> Default for Newton<R> {
    fn default() -> Self {
        Self::new()
    }
}

impl<R: Real> Newton<R> {
    pub fn new() -> Self {
        Self {
            islands: Islands::default(),
            patterns: Vec::new(),
            present: Vec::new(),
            class: Vec::new(),
            bundles: Bundles::new(),
            system: System::new(),
            few: Few::new(),
            by_lane: None,
        }
    }

    /// Solves `rows`, starting from their impulses where that is better than none;
    /// `rows.u` must hold û (`guess`) and their effect, and does so again afterwards.
    ///
    /// Ends at rounding, or with a tolerance once the residual is certainly within
    /// it, or after `limits.sweeps` iterations. Changes nothing when it refuses.
    pub fn solve(
        &mut self,
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
        limits: Limits,
    ) -> Result<Report<R>> {
        check(rows)?;
        let Unconstrained { dof_lists, inv_d, guess } = free;
        if rows.heap && R::LANES > 1 {
            let by_lane = self.by_lane.get_or_insert_with(|| Box::new(ByLane::new()));
            return by_lane.solve(free, rows, limits);
        }
        let mut report: Report<R> = Report::new();
        self.islands.sort(&rows.blocks);
        self.class.resize(rows.u.len(), NOWHERE);
        if self.patterns.len() < self.islands.count() {
            self.patterns.resize_with(self.islands.count(), Pattern::default);
        }
        for island in 0..self.islands.count() {
            self.present.clear();
            let blocks = self.islands.of(island).iter();
            self.present.extend(blocks.copied().filter(|b| {
                let block = &rows.blocks[*b];
                block.rows.len > 0 && block.mask.any()
            }));
            if self.present.is_empty() {
                continue;
            }
            let present = alive(rows, &self.present);
            let alone = rows.alone(&self.present);
            if alone.any() {
                rows.solve_alone(dof_lists, inv_d, &self.present, alone);
                let mine = alone.and(present);
                let mut once = Count::ZERO;
                once.add(mine, 1);
                report.sweeps.raise(&once);
                report.updates.add(mine, 1);
                if present.and(alone.not()).none() {
                    continue;
                }
            }
            let few = Few::fits(rows, &self.present).and(alone.not());
            let mut poor = R::Mask::of(false);
            if few.any() {
                let island = Island { dof_lists, inv_d, guess, blocks: &self.present };
                poor = self.few.solve(island, rows, few, &mut report);
            }
            let live = present.and(alone.not()).and(few.not().or(poor));
            if live.none() {
                continue;
            }
            let open = self.solve_island(island, free, rows, live, limits, &mut report);
            report.open = report.open.or(open);
            report.decrement =
                report.decrement.max(R::select(live, self.system.decrement, R::zero()));
        }
        Ok(report)
    }

    /// The primal method on the blocks `present`; lanes that it left unfinished.
    fn solve_island(
        &mut self,
        island: usize,
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
        live: R::Mask,
        limits: Limits,
        report: &mut Report<R>,
    ) -> R::Mask {
        let Self { patterns, present, class, bundles, system, .. } = self;
        let pattern = &mut patterns[island];
        bundles.take(present, rows);
        pattern.fit(free.dof_lists, rows.heap, &bundles.list, class);
        let problem = Problem { pattern, bundles, y: &rows.y };
        system.start(problem, free.inv_d, free.guess, &rows.u);
        let scale = (lightest(present, rows), row_count(rows, present));
        let open = system.minimise(problem, live, limits, scale, report);
        system.settle(problem, limits);
        let mut impulses = system.impulse.iter();
        for block in present.iter().map(|b| &rows.blocks[*b]) {
            for (row, new) in rows.rows[block.rows.range()].iter_mut().zip(impulses.by_ref()) {
                row.impulse = R::select(block.mask.and(live), *new, row.impulse);
            }
        }
        for (k, u) in pattern.dofs().iter().zip(&system.u) {
            rows.u[*k] = R::select(live, *u, rows.u[*k]);
        }
        open
    }
}

/// The least mass of a block.
fn lightest<R: Real>(blocks: &[usize], rows: &Rows<R>) -> R {
    let mut mass = R::of(f64::INFINITY);
    for block in blocks.iter().map(|b| &rows.blocks[*b]) {
        mass = R::select(block.mask, mass.min(R::of(block.mass)), mass);
    }
    mass
}

/// Every block has a penalty: it is convex, and what can move it has a regulariser.
fn check<R: Real>(rows: &Rows<R>) -> Result<()> {
    for block in &rows.blocks {
        if matches!(block.set, Set::CoulombRound | Set::CoulombBox) {
            return Err(Error::value(
                "solver",
                "'newton' with a Coulomb cone",
                "'pgs' under a Coulomb law (it has nothing to minimise)",
            ));
        }
        for row in &rows.rows[block.rows.range()] {
            if block.mask.and(row.c.le(R::zero())).and(row.a.gt(R::zero())).any() {
                return Err(Error::value(
                    "solver",
                    "'newton' with a row of zero softness",
                    "'pgs' where a row has c = 0 (Newton minimises a penalty λ²c/2)",
                ));
            }
        }
    }
    Ok(())
}
