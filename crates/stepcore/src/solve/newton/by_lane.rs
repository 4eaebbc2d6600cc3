//! Lanes solved one world after another.
//!
//! In a pile, all lanes: the order of elimination follows from the current contacts, and a lane
//! must not depend on its neighbours' contacts. In other islands, the remaining lanes, if they are
//! so few that a register of lanes takes longer. A lane is then solved as a single world.

use super::{Newton, Primal};
use crate::error::Result;
use crate::real::{Mask, Real};
use crate::solve::limits::{Limits, Report};
use crate::solve::rows::Rows;
use crate::solve::solver::Unconstrained;

/// A register of lanes takes about as long as this many single worlds.
const AS_LONG: usize = 3;

/// One world's problem, and its solver.
pub(super) struct ByLane<R: Real> {
    newton: Newton<R::One>,
    rows: Rows<R::One>,
    inv_d: Vec<R::One>,
    guess: Vec<R::One>,
    /// Per block of the world: the block of the lanes.
    blocks: Vec<usize>,
}

room!(ByLane<R>: newton, rows, inv_d, guess, blocks);

/// Returns whether there are so few lanes that each is solved by itself.
pub(super) fn so_few<M: Mask>(todo: M) -> bool {
    (0..M::LANES).filter(|lane| todo.lane(*lane)).count() < AS_LONG
}

impl<R: Real> ByLane<R> {
    pub fn new() -> Self {
        Self {
            newton: Newton::new(),
            rows: Rows::bare(0),
            inv_d: Vec::new(),
            guess: Vec::new(),
            blocks: Vec::new(),
        }
    }

    /// Solves every lane of a pile by itself.
    pub fn solve(
        &mut self,
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
        limits: Limits,
    ) -> Result<Report<R>> {
        let dof_lists = free.dof_lists;
        let mut report: Report<R> = Report::new();
        for lane in 0..R::LANES {
            self.take(lane, free, rows, 0..rows.blocks.len());
            let Self { newton, rows: own, inv_d, guess, .. } = self;
            let world = Unconstrained { dof_lists, inv_d, guess };
            let done = newton.solve(world, own, limits)?;
            self.give(lane, rows);
            note(&mut report, lane, &done);
        }
        Ok(report)
    }

    /// Solves an island of these blocks in the lanes `todo`.
    pub fn solve_island(
        &mut self,
        Primal { free, limits, todo }: Primal<R>,
        (island, blocks): (usize, &[usize]),
        rows: &mut Rows<R>,
        report: &mut Report<R>,
    ) {
        let dof_lists = free.dof_lists;
        for lane in (0..R::LANES).filter(|lane| todo.lane(*lane)) {
            self.take(lane, free, rows, blocks.iter().copied());
            let Self { newton, rows: own, inv_d, guess, .. } = self;
            let free = Unconstrained { dof_lists, inv_d, guess };
            let mut done = Report::new();
            newton.primal(Primal { free, limits, todo: true }, island, own, &mut done);
            self.give(lane, rows);
            note(report, lane, &done);
        }
    }

    /// Copies the given blocks that a lane has.
    fn take(
        &mut self,
        lane: usize,
        free: Unconstrained<R>,
        rows: &Rows<R>,
        blocks: impl Iterator<Item = usize>,
    ) {
        let fill = |to: &mut Vec<R::One>, from: &[R]| {
            to.clear();
            to.extend(from.iter().map(|x| R::One::of(x.lane(lane))));
        };
        fill(&mut self.inv_d, free.inv_d);
        fill(&mut self.guess, free.guess);
        let own = &mut self.rows;
        own.clear();
        own.heap = rows.heap;
        fill(&mut own.u, &rows.u);
        fill(&mut own.start, &rows.start);
        fill(&mut own.y, &rows.y);
        fill(&mut own.inertia, &rows.inertia);
        self.blocks.clear();
        for at in blocks {
            let block = &rows.blocks[at];
            if !block.mask.lane(lane) {
                continue;
            }
            let mut one = block.at_lane(lane);
            one.rows.start = own.rows.len();
            own.rows.extend(rows.rows[block.rows.range()].iter().map(|row| row.at_lane(lane)));
            own.blocks.push(one);
            self.blocks.push(at);
        }
    }

    fn give(&self, lane: usize, rows: &mut Rows<R>) {
        for (to, from) in rows.u.iter_mut().zip(&self.rows.u) {
            to.set_lane(lane, from.lane(0));
        }
        for (at, block) in self.blocks.iter().zip(&self.rows.blocks) {
            let to = rows.blocks[*at].rows.range();
            for (to, from) in rows.rows[to].iter_mut().zip(&self.rows.rows[block.rows.range()]) {
                to.impulse.set_lane(lane, from.impulse.lane(0));
            }
        }
    }
}

/// Reports the work in a lane.
fn note<R: Real>(report: &mut Report<R>, lane: usize, done: &Report<R::One>) {
    let mine = R::Mask::from_lanes(|other| other == lane);
    report.sweeps.raise_in(mine, done.sweeps.lane(0));
    report.updates.add(mine, done.updates.lane(0));
    let decrement = report.decrement.lane(lane).max(done.decrement.lane(0));
    report.decrement.set_lane(lane, decrement);
    report.open = report.open.or(mine.and(R::Mask::of(done.open)));
}
