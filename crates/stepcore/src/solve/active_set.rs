//! Islands of few rows, solved exactly in the impulses instead of the velocities.
//!
//! Newton's method for (A + C)λ − b = w with each λ in its interval: guess which rows
//! are free, solve for them with the others at their bounds, and guess again from
//! λ − w/s (Hintermüller, Ito & Kunisch 2002: the primal-dual active set method is a
//! semismooth Newton method). Where the guess repeats, λ is the solution. With fewer
//! rows than dofs the matrix is smaller than the Hessian, and usually one guess does.
//! Guesses can go round in a circle: lanes that a few did not solve are left to the
//! primal method, whose line search cannot.

mod gather;
mod table;

use super::islands::intervals_at_most;
use super::limits::Report;
use super::rows::Rows;
use crate::real::Real;
use gather::Gathered;
use table::Table;

/// An island of so many rows has few; for the half of them, a table that is filled is half as wide.
/// Were all islands Newton's, half_cheetah, hopper and ant would take a quarter longer.
const MOST: usize = 16;
const HALF: usize = MOST / 2;
/// A pivot this small beside its diagonal would cost too many digits: rows that are nearly
/// copies with a tiny regulariser go to the primal method, which sees each by itself.
const PIVOT: f64 = 1e-5;
/// Guesses after which the island is left to the primal method.
const GUESSES: u32 = 10;

/// The method's memory.
pub(super) struct ActiveSet<R: Real> {
    gathered: Gathered<R>,
    half: Box<Table<R, HALF>>,
    whole: Box<Table<R, MOST>>,
}

room!(ActiveSet<R>: gathered, half, whole);

/// What one solve reads.
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

    /// Lanes in which all rows of these blocks are intervals, and few.
    pub fn fits(rows: &Rows<R>, blocks: &[usize]) -> R::Mask {
        intervals_at_most(rows, blocks, MOST as u64)
    }

    /// Solves an island from û in the lanes `mine`; writes impulses, and u with their effect. Returns the
    /// lanes that it left unsolved.
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
