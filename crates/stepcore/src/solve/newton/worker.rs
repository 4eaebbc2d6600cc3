//! Workers that solve islands one by one by the primal method, and share them among threads.

use super::bundles::{Bundles, Problem};
use super::minimise::Scale;
use super::nodes::NOWHERE;
use super::pattern::Pattern;
use super::system::System;
use crate::model::Span;
use crate::pool::{inside, lock, Pool};
use crate::real::{Mask, Real};
use crate::solve::free_bodies::SIX;
use crate::solve::islands::{row_count, Islands};
use crate::solve::limits::{Limits, Report};
use crate::solve::rows::Rows;
use crate::solve::solver::Unconstrained;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::Mutex;

/// The memory of one thread.
pub(super) struct Worker<R: Real> {
    /// Blocks of the current island that exist in some lane.
    pub present: Vec<usize>,
    /// Scratch: by dof, for patterns, and the dofs that have a number there; for the order of blocks.
    class: Vec<usize>,
    touched: Vec<usize>,
    order: Vec<[usize; 4]>,
    bundles: Bundles<R>,
    pub system: System<R>,
    solved: Solved<R>,
}

room!(Worker<R>: present, class, touched, order, bundles, system, solved);

/// Results of islands, one after another, until the rows may be written.
struct Solved<R: Real> {
    blocks: Vec<usize>,
    impulses: Vec<R>,
    dofs: Vec<usize>,
    u: Vec<R>,
    report: Report<R>,
}

room!(Solved<R>: blocks, impulses, dofs, u, report);

/// The problem and its limits.
#[derive(Clone, Copy)]
pub(super) struct Task<'a, R: Real> {
    pub free: Unconstrained<'a, R>,
    pub limits: Limits,
    pub islands: &'a Islands,
}

impl<R: Real> Worker<R> {
    pub fn new() -> Self {
        Self {
            present: Vec::new(),
            class: Vec::new(),
            touched: Vec::new(),
            order: Vec::new(),
            bundles: Bundles::new(),
            system: System::new(),
            solved: Solved {
                blocks: Vec::new(),
                impulses: Vec::new(),
                dofs: Vec::new(),
                u: Vec::new(),
                report: Report::new(),
            },
        }
    }

    /// Takes an island's blocks.
    pub fn take(&mut self, blocks: &[usize], rows: &Rows<R>) {
        self.present.clear();
        self.present.extend(blocks.iter().copied().filter(|b| {
            let block = &rows.blocks[*b];
            block.rows.len > 0 && block.mask.any()
        }));
    }

    /// Drop blocks that no lane of `todo` has: the other lanes are solved already.
    pub fn keep_where(&mut self, todo: R::Mask, rows: &Rows<R>) {
        if !R::ALONE {
            self.present.retain(|b| rows.blocks[*b].mask.and(todo).any());
        }
    }

    /// Sorts blocks so that those on one chain of dofs are adjacent: by their last dof, then by the
    /// number of dofs. The dofs of a world's rows decide alone, so that a lane has its world's order.
    fn order(&mut self, rows: &Rows<R>, dof_lists: &[usize]) {
        let key = |b: &usize| {
            let dofs = rows.rows[rows.blocks[*b].rows.start].dofs;
            let last = dofs.of(dof_lists).last().copied().unwrap_or(0);
            [last, dofs.len, dofs.start, *b]
        };
        self.order.clear();
        self.order.extend(self.present.iter().map(key));
        if !self.order.is_sorted() {
            self.order.sort_unstable();
            self.present.iter_mut().zip(&self.order).for_each(|(b, [.., next])| *b = *next);
        }
    }

    /// Returns whether the nodes of a pile pay: blocks on chains cost more there, free bodies
    /// elsewhere. Counted by `benches/anatomy.py`, thousand instructions per step by nodes and
    /// along chains: Go2 among ten loose boxes 1525 and 805, unitree's A2 on a terrain 457 and 300,
    /// a Panda without friction among ten and forty loose boxes 364 and 412, 1695 and 2167.
    fn is_heap(&mut self, rows: &Rows<R>, dof_lists: &[usize]) -> bool {
        let Self { present, class, touched, .. } = self;
        touched.clear();
        let (mut chained, mut last) = (0, Span::default());
        for b in present {
            let span = rows.rows[rows.blocks[*b].rows.start].dofs;
            chained += usize::from(!span.len.is_multiple_of(SIX));
            if std::mem::replace(&mut last, span) == span {
                continue;
            }
            for k in span.of(dof_lists) {
                if std::mem::replace(&mut class[*k], 0) == NOWHERE {
                    touched.push(*k);
                }
            }
        }
        touched.iter().for_each(|k| class[*k] = NOWHERE);
        SIX * chained < touched.len()
    }

    /// Solves `island`, whose blocks were taken; returns the unfinished lanes. Impulses agree with
    /// the velocities to rounding, unless the cost or the iteration limit ends the solve.
    pub fn solve(
        &mut self,
        task: Task<R>,
        (island, pattern): (usize, &mut Pattern),
        rows: &Rows<R>,
        todo: R::Mask,
        report: &mut Report<R>,
    ) -> R::Mask {
        let Task { free, limits, .. } = task;
        self.class.resize(rows.u.len(), NOWHERE);
        let heap = rows.heap && self.is_heap(rows, free.dof_lists);
        if !heap {
            self.order(rows, free.dof_lists);
        }
        let inertia = rows.inertia.get(island).copied().unwrap_or_else(R::zero);
        let Self { present, class, bundles, system, .. } = self;
        bundles.take(present, rows, (!heap).then_some(free.dof_lists));
        pattern.fit(free.dof_lists, heap, bundles.dofs(), class);
        let problem = Problem { pattern, bundles, rows, blocks: present };
        let first = if rows.start.is_empty() { &rows.u } else { &rows.start };
        let begun = system.start(problem, (free.inv_d, free.guess, first), todo);
        let scale = Scale {
            lightest: lightest(present, rows),
            least_gain: R::of(limits.cost) * inertia,
            rows: row_count(rows, present),
        };
        let open = system.minimise(problem, (todo, begun), limits, scale, report);
        if limits.cost > 0.0 {
            system.follow_laws(problem.bundles);
        } else {
            system.polish(problem, open, limits);
        }
        report.open = report.open.or(open);
        report.decrement = report.decrement.max(R::select(todo, system.decrement, R::zero()));
        open
    }

    /// Writes the island's impulses and velocities to the rows.
    pub fn write(&self, pattern: &Pattern, rows: &mut Rows<R>, todo: R::Mask) {
        write(rows, todo, (&self.present, &self.system.impulse), (pattern.dofs(), &self.system.u));
    }

    /// Stores them for later.
    fn keep(&mut self, pattern: &Pattern) {
        self.solved.blocks.extend_from_slice(&self.present);
        self.solved.impulses.extend_from_slice(&self.system.impulse);
        self.solved.dofs.extend_from_slice(pattern.dofs());
        self.solved.u.extend_from_slice(&self.system.u);
    }
}

fn write<R: Real>(
    rows: &mut Rows<R>,
    todo: R::Mask,
    (blocks, impulses): (&[usize], &[R]),
    (dofs, u): (&[usize], &[R]),
) {
    let mut impulses = impulses.iter();
    for block in blocks.iter().map(|b| &rows.blocks[*b]) {
        for (row, new) in rows.rows[block.rows.range()].iter_mut().zip(impulses.by_ref()) {
            row.impulse = R::select(block.mask.and(todo), *new, row.impulse);
        }
    }
    for (k, u) in dofs.iter().zip(u) {
        rows.u[*k] = R::select(todo, *u, rows.u[*k]);
    }
}

/// Returns the least mass of a block.
fn lightest<R: Real>(blocks: &[usize], rows: &Rows<R>) -> R {
    let mut mass = R::of(f64::INFINITY);
    for block in blocks.iter().map(|b| &rows.blocks[*b]) {
        mass = R::select(block.mask, mass.min(block.mass), mass);
    }
    mass
}

/// Solves the islands of `queue`, in all of which a scalar world lives. An island neither reads nor
/// changes anything of another, and reports are sums of integers and extremes: the result does not
/// depend on which thread solves which island.
pub(super) fn share<R: Real>(
    pool: &Pool,
    task: Task<R>,
    (queue, patterns): (&[usize], &[Mutex<Pattern>]),
    workers: &mut Vec<Mutex<Worker<R>>>,
    rows: &mut Rows<R>,
    report: &mut Report<R>,
) {
    let todo = R::Mask::of(true);
    workers.resize_with(pool.threads(), || Mutex::new(Worker::new()));
    let next = AtomicUsize::new(0);
    let (shared, places) = (&*rows, &*workers);
    pool.share(places.len(), &|part| {
        let worker = &mut *lock(&places[part]);
        let mut own = Report::new();
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(island) = queue.get(at) else { break };
            let pattern = &mut *lock(&patterns[*island]);
            worker.take(task.islands.of(*island), shared);
            worker.solve(task, (*island, pattern), shared, todo, &mut own);
            worker.keep(pattern);
        }
        worker.solved.report = own;
    });
    for worker in workers {
        let Solved { blocks, impulses, dofs, u, report: own } = &mut inside(worker).solved;
        write(rows, todo, (blocks, impulses), (dofs, u));
        report.join(own);
        blocks.clear();
        impulses.clear();
        dofs.clear();
        u.clear();
    }
}
