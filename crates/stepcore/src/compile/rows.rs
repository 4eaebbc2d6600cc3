//! Rows that are made in one place and solved in another: in machine code (`compile/`), and by the stages.
//!
//! A step that is written down knows every row that there may be, and of what entries its numbers are. Who
//! solves it takes the numbers of those that some lane has.

use super::handed::{numbers, Handed, HandedList, HandedRows};
use super::memory::Aligned;
use crate::error::Result;
use crate::pool::lock;
use crate::real::traced::{Recorder, Traced, TracedMask};
use crate::real::{Mask, Real};
use crate::settings::{Settings, Solver, Sweeps};
use crate::solve::{Limits, Report, Row, Rows, Solve, Solvers, Unconstrained};

impl HandedRows {
    /// Hands rows over. Their impulses and u are numbers that somebody else makes.
    fn of(free: Unconstrained<Traced>, rows: &mut Rows<Traced>) -> Self {
        let always = TracedMask::Known(true);
        let all = |list: &[Traced]| {
            let mut list = list.to_vec();
            list.iter_mut().for_each(|x| *x = x.handed(always));
            list
        };
        let mut own = Rows::like(rows);
        own.u = all(&rows.u);
        own.inertia = all(&rows.inertia);
        let mut shared = vec![false; rows.y.len()];
        for block in &mut own.blocks {
            let mask = block.mask;
            block.mask = mask.handed();
            let put = |x: &mut Traced| *x = x.handed(mask);
            put(&mut block.mu);
            put(&mut block.mass);
            for row in &mut own.rows[block.rows.range()] {
                numbers(row).into_iter().for_each(put);
                for at in row.y..row.y + row.dofs.len {
                    // Rows of several blocks may share theirs.
                    let other = std::mem::replace(&mut shared[at], true);
                    let mask = if other { always } else { mask };
                    own.y[at] = rows.y[at].handed(mask);
                }
            }
        }
        let (inv_d, guess) = (all(free.inv_d), all(free.guess));
        Recorder::cut();
        let mut new = |x: &mut Traced| {
            let (entry, place) = Recorder::made();
            *x = Traced::Node(entry);
            place
        };
        let u = rows.u.iter_mut().map(&mut new).collect();
        let impulses = rows.rows.iter_mut().map(|row| new(&mut row.impulse)).collect();
        let dof_lists = free.dof_lists.to_vec();
        Self { rows: own, dof_lists, inv_d, guess, u, impulses }
    }
}

/// A step that is written down solves what can be written down, and hands over the rest.
pub(crate) struct HandsOver {
    own: Solvers<Traced>,
    /// It hands over every solve.
    all: bool,
    handed: HandedList,
}

impl HandsOver {
    pub fn new(all: bool, handed: HandedList) -> Self {
        Self { own: Solvers::new(), all, handed }
    }
}

impl crate::room::Room for HandsOver {
    fn room(&self) -> usize {
        self.own.room()
    }
}

/// A solver that goes by what single lanes have, or in an order of its own.
pub(crate) fn goes_by_lane(settings: &Settings) -> bool {
    let for_sure = settings.sweeps == Sweeps::Auto && settings.law.on_guess();
    settings.solver == Solver::Newton || for_sure || Limits::of(settings).momentum
}

impl Solve<Traced> for HandsOver {
    fn solve(
        &mut self,
        settings: &Settings,
        free: Unconstrained<Traced>,
        rows: &mut Rows<Traced>,
    ) -> Result<Report<Traced>> {
        if rows.blocks.is_empty() || !(self.all || goes_by_lane(settings)) {
            return self.own.solve(settings, free, rows);
        }
        // Where the order of elimination matters each lane has its own.
        if rows.heap && settings.solver == Solver::Newton {
            Recorder::give_up();
        }
        let handed = HandedRows::of(free, rows);
        lock(&self.handed).push(Handed::Rows(Box::new(handed)));
        Ok(Report::new())
    }
}

/// Solves what was handed over.
pub(crate) struct Solving<R: Real> {
    solvers: Solvers<R>,
    rows: Rows<R>,
    inv_d: Vec<R>,
    guess: Vec<R>,
}

room!(Solving<R>: solvers, rows, inv_d, guess);

impl<R: Real> Solving<R> {
    pub fn new(handed: &HandedRows) -> Self {
        let known = |x: &Traced| match x {
            Traced::Known(value) => R::of(*value),
            Traced::Node(_) => R::zero(),
        };
        let all = |list: &[Traced]| list.iter().map(known).collect();
        let lanes = |mask: &TracedMask| R::Mask::of(*mask == TracedMask::Known(true));
        let mut rows = Rows::bare(handed.u.len());
        rows.blocks =
            handed.rows.blocks.iter().map(|block| block.in_numbers(lanes, known)).collect();
        rows.rows = handed.rows.rows.iter().map(|row| row.in_numbers(known)).collect();
        rows.y = all(&handed.rows.y);
        rows.u = all(&handed.rows.u);
        rows.inertia = all(&handed.rows.inertia);
        rows.heap = handed.rows.heap;
        rows.island_dofs.clone_from(&handed.rows.island_dofs);
        let (inv_d, guess) = (all(&handed.inv_d), all(&handed.guess));
        Self { solvers: Solvers::new(), rows, inv_d, guess }
    }

    /// Reads, solves, and leaves what it finds. False: it did not.
    pub fn solve(
        &mut self,
        handed: &HandedRows,
        settings: &Settings,
        memory: &mut Aligned,
    ) -> bool {
        let Self { solvers, rows, inv_d, guess } = self;
        let all = |from: &[Traced], to: &mut [R]| {
            from.iter().zip(to).for_each(|(from, to)| memory.read(*from, to));
        };
        let from = &handed.rows;
        let mut some = false;
        for (block, own) in from.blocks.iter().zip(&mut rows.blocks) {
            own.mask = memory.lanes::<R>(block.mask);
            if own.mask.none() {
                continue;
            }
            some = true;
            memory.read(block.mu, &mut own.mu);
            memory.read(block.mass, &mut own.mass);
            for at in block.rows.range() {
                let row = &from.rows[at];
                let Row { t, c, a, inv_s, lo, hi, impulse, velocity, .. } = row;
                let given = [t, c, a, inv_s, lo, hi, impulse, velocity];
                let own = numbers(&mut rows.rows[at]);
                given.into_iter().zip(own).for_each(|(x, to)| memory.read(*x, to));
                let y = row.y..row.y + row.dofs.len;
                all(&from.y[y.clone()], &mut rows.y[y]);
            }
        }
        all(&from.u, &mut rows.u);
        if some {
            all(&from.inertia, &mut rows.inertia);
            all(&handed.inv_d, inv_d);
            all(&handed.guess, guess);
            let free = Unconstrained { dof_lists: &handed.dof_lists, inv_d, guess };
            match solvers.solve(settings, free, rows) {
                Ok(report) if !report.interrupted => {}
                _ => return false,
            }
        }
        handed.u.iter().zip(&rows.u).for_each(|(place, u)| memory.write(*place, u));
        for block in rows.blocks.iter().filter(|block| block.mask.any()) {
            let range = block.rows.range();
            let own = handed.impulses[range.clone()].iter().zip(&rows.rows[range]);
            own.for_each(|(place, row)| memory.write(*place, &row.impulse));
        }
        true
    }
}
