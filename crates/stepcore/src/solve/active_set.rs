//! Islands of few rows, solved exactly in the impulses instead of the velocities.
//!
//! Newton's method for (A + C)λ − b = w with each λ in its interval: guess which rows are free,
//! solve for them with the others at their bounds, and guess again from λ − w/s (Hintermüller, Ito
//! & Kunisch 2002: the primal-dual active set method is a semismooth Newton method). λ is the
//! solution when the guess repeats. With fewer rows than dofs the matrix is smaller than the
//! Hessian, and one guess usually suffices. Guesses can cycle: lanes that are unsolved after a few
//! go to the primal method, whose line search prevents cycles.

mod gather;
mod table;

use super::islands::intervals_at_most;
use super::limits::Report;
use super::rows::Rows;
use crate::real::Real;
use gather::Gathered;
use table::Table;

/// The most rows of an island with few rows; up to half as many, a table of half the width is filled.
/// If Newton's method solved all islands, half_cheetah, hopper and ant would take a quarter longer.
const MOST: usize = 16;
const HALF: usize = MOST / 2;
/// A smaller pivot relative to its diagonal would cost too many digits. Rows that are nearly copies
/// with a tiny regulariser go to the primal method, which treats each by itself.
const PIVOT: f64 = 1e-5;
/// The number of guesses after which the island is left to the primal method.
const GUESSES: u32 = 10;

/// The method's memory.
pub(super) struct ActiveSet<R: Real> {
    gathered: Gathered<R>,
    half: Box<Table<R, HALF>>,
    whole: Box<Table<R, MOST>>,
}

room!(ActiveSet<R>: gathered, half, whole);

/// The input of one solve.
#[derive(Clone, Copy)]
pub(super) struct Island<'a, R: Real> {
    pub dof_lists: &'a [usize],
    pub inv_d: &'a [R],
    /// û.
    pub guess: &'a [R],
    pub blocks: &'a [usize],
}

impl<R: Real> ActiveSet<R> {
    pub fn new() -> Self {
        Self {
            gathered: Gathered::new(),
            half: Box::new(Table::new()),
            whole: Box::new(Table::new()),
        }
    }

    /// Returns the lanes in which all rows of these blocks are intervals, and few.
    pub fn fits(rows: &Rows<R>, blocks: &[usize]) -> R::Mask {
        intervals_at_most(rows, blocks, MOST as u64)
    }

    /// Solves an island from û in the lanes `mine`: writes impulses, and u with their effect. Returns
    /// the unsolved lanes.
    pub fn solve(
        &mut self,
        island: Island<R>,
        rows: &mut Rows<R>,
        mine: R::Mask,
        report: &mut Report<R>,
    ) -> R::Mask {
        let Self { gathered, half, whole } = self;
        gathered.take(island, rows, mine);
        if R::FILLS && gathered.slots.len() <= HALF {
            return half.solve((island, gathered), rows, mine, report);
        }
        whole.solve((island, gathered), rows, mine, report)
    }
}
