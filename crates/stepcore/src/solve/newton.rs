//! Newton's method on the primal problem, island by island, in factored coordinates.
//!
//! Minimises ½ (u − û)ᵀD(u − û) + Σ s(y·u − t): each block's law as a penalty s
//! (`newton/penalty.rs`), possible because every row has a regulariser c > 0. The gradient is
//! D(u − û) − Σ yλ; the Hessian D + Σ y s″ yᵀ is factored sparsely; the line search is exact. If no
//! row changes its zone in a full step, the cost was quadratic along it, and the step was the last.
//! The method starts from the last acceleration if that costs less than û, and the first step uses
//! the zones of the step before (`newton/last_zones.rs`).

/// Calls `$of` with the number of registers per row that `$stride` has, as a compile-time constant;
/// call `$other` if there are more, or if a row is not a whole number of registers.
macro_rules! by_registers {
    ($stride:expr, $of:ident $arguments:tt, $other:expr) => {
        match $stride {
            4 => $of::<R, 1> $arguments,
            8 => $of::<R, 2> $arguments,
            12 => $of::<R, 3> $arguments,
            16 => $of::<R, 4> $arguments,
            20 => $of::<R, 5> $arguments,
            24 => $of::<R, 6> $arguments,
            28 => $of::<R, 7> $arguments,
            32 => $of::<R, 8> $arguments,
            _ => $other,
        }
    };
}

mod bundles;
mod by_lane;
mod columns;
mod free_blocks;
mod hessian;
mod inverse;
mod last_zones;
mod minimise;
mod nodes;
mod order;
mod pattern;
mod penalty;
mod refine;
mod system;
#[cfg(test)]
mod tests;
mod worker;

use super::active_set::{ActiveSet, Island};
use super::islands::{alive, Islands};
use super::limits::{Limits, Report};
use super::rows::{Rows, Set};
use super::solver::Unconstrained;
use crate::error::{Error, Result};
use crate::pool::{inside, ROWS_WORTH_SHARING};
use crate::real::{Mask, Real};
use by_lane::ByLane;
use pattern::Pattern;
use std::sync::Mutex;
use worker::{share, Task, Worker};

/// The method's memory; one per world or pack of lanes.
pub struct Newton<R: Real> {
    islands: Islands,
    /// Per island.
    patterns: Vec<Mutex<Pattern>>,
    /// The worker of the caller's thread, and one per thread when threads share the islands.
    own: Worker<R>,
    workers: Vec<Mutex<Worker<R>>>,
    /// Islands to be shared by threads.
    queue: Vec<usize>,
    active_set: ActiveSet<R>,
    /// For piles in lanes, and for few lanes.
    by_lane: Option<Box<ByLane<R>>>,
}

/// The primal method's part of an island: its blocks, lanes and limits.
#[derive(Clone, Copy)]
struct Primal<'a, R: Real> {
    free: Unconstrained<'a, R>,
    limits: Limits,
    todo: R::Mask,
}

room!(Newton<R>: islands, patterns, own, workers, queue, active_set, by_lane);

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
            own: Worker::new(),
            workers: Vec::new(),
            queue: Vec::new(),
            active_set: ActiveSet::new(),
            by_lane: if R::ALONE { None } else { Some(Box::new(ByLane::new())) },
        }
    }

    /// Solves `rows`, starting at `rows.start`, or else `rows.u`, if that is better than û
    /// (`guess`); afterwards `rows.u` holds û plus the effect of the impulses.
    ///
    /// Stop at rounding, or with a tolerance once the residual is certainly within it, or after
    /// `limits.sweeps` iterations. On an error nothing is changed.
    pub fn solve(
        &mut self,
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
        limits: Limits,
    ) -> Result<Report<R>> {
        check(rows)?;
        let Unconstrained { dof_lists, inv_d, guess } = free;
        if !R::ALONE && rows.heap {
            if let Some(by_lane) = &mut self.by_lane {
                return by_lane.solve(free, rows, limits);
            }
        }
        let mut report: Report<R> = Report::new();
        self.islands.sort(&rows.blocks);
        if self.patterns.len() < self.islands.count() {
            self.patterns.resize_with(self.islands.count(), Mutex::default);
        }
        let shared = R::ALONE && rows.rows.len() >= ROWS_WORTH_SHARING;
        let pool = rows.pool.clone().filter(|_| shared && self.islands.count() > 1);
        let Self { islands, patterns, own, workers, queue, active_set, by_lane } = self;
        let task = Task { free, limits, islands };
        queue.clear();
        for island in 0..islands.count() {
            own.take(islands.of(island), rows);
            if own.present.is_empty() {
                continue;
            }
            let single = rows.solve_one_row(free, &own.present, true, &mut report);
            let present = alive(rows, &own.present).and(single.not());
            if present.none() {
                continue;
            }
            let fits = ActiveSet::fits(rows, &own.present).and(single.not());
            let mut poor = R::Mask::of(false);
            if fits.any() {
                let island = Island { dof_lists, inv_d, guess, blocks: &own.present };
                poor = active_set.solve(island, rows, fits, &mut report);
            }
            let todo = present.and(fits.not().or(poor));
            if todo.none() {
                continue;
            }
            own.keep_where(todo, rows);
            if pool.is_some() {
                queue.push(island);
                continue;
            }
            if !R::ALONE && by_lane::so_few(todo) {
                if let Some(by_lane) = by_lane {
                    let left = Primal { free, limits, todo };
                    by_lane.solve_island(left, (island, &own.present), rows, &mut report);
                    continue;
                }
            }
            let pattern = inside(&mut patterns[island]);
            own.solve(task, (island, pattern), rows, todo, &mut report);
            own.write(pattern, rows, todo);
        }
        if R::ALONE {
            if let Some(pool) = pool {
                share(&pool, task, (queue, patterns), workers, rows, &mut report);
            }
        }
        Ok(report)
    }
}

impl<R: Real> Newton<R> {
    /// Solves rows that all belong to one island, by the primal method.
    fn primal(
        &mut self,
        Primal { free, limits, todo }: Primal<R>,
        island: usize,
        rows: &mut Rows<R>,
        report: &mut Report<R>,
    ) {
        if self.patterns.len() <= island {
            self.patterns.resize_with(island + 1, Mutex::default);
        }
        let Self { islands, patterns, own, .. } = self;
        own.present.clear();
        own.present.extend(0..rows.blocks.len());
        let pattern = inside(&mut patterns[island]);
        own.solve(Task { free, limits, islands }, (island, pattern), rows, todo, report);
        own.write(pattern, rows, todo);
    }
}

/// Checks that every block has a penalty: it is convex, and has a regulariser if it can move.
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
