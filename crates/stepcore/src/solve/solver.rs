//! The choice of the solver by the settings.

use super::limits::{Limits, Report};
use super::newton::Newton;
use super::pgs::Pgs;
use super::proximal::Proximal;
use super::rows::Rows;
use crate::elements::Element;
use crate::error::Result;
use crate::real::{Mask, Real};
use crate::room::Room;
use crate::settings::{Settings, Solver, Sweeps};

/// The motion without rows, in factored coordinates.
#[derive(Clone, Copy)]
pub(crate) struct Unconstrained<'a, R: Real> {
    pub dof_lists: &'a [usize],
    /// 1/D, by dof.
    pub inv_d: &'a [R],
    /// û = L v̂, by dof.
    pub guess: &'a [R],
}

/// A method that finds the impulses of rows. A `Sim` holds one: `Solvers`, or in numbers that carry
/// slopes `Differentiated`.
pub(crate) trait Solve<R: Real>: Room + Send + Sync {
    /// Solves from the impulses of `rows`. `rows.u` must hold û and their effect, or only û if
    /// `rows.start` gives the start; afterwards it holds û and the effect of the new impulses.
    fn solve(
        &mut self,
        settings: &Settings,
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
    ) -> Result<Report<R>>;

    /// Resets the memory that an interrupted solve has left inconsistent.
    fn renew(&mut self);

    /// Returns the elements with one-sided slopes since the last call; ascending.
    fn take_degenerate(&mut self) -> Vec<Element> {
        Vec::new()
    }
}

/// Every solver's memory.
pub(crate) struct Solvers<R: Real> {
    pgs: Pgs<R>,
    newton: Newton<R>,
    proximal: Proximal<R>,
}

room!(Solvers<R>: pgs, newton, proximal);

impl<R: Real> Solvers<R> {
    pub fn new() -> Self {
        Self { pgs: Pgs::new(), newton: Newton::new(), proximal: Proximal::new() }
    }
}

impl<R: Real> Default for Solvers<R> {
    fn default() -> Self {
        Self::new()
    }
}

impl<R: Real> Solve<R> for Solvers<R> {
    fn renew(&mut self) {
        *self = Self::new();
    }

    fn solve(
        &mut self,
        settings: &Settings,
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
    ) -> Result<Report<R>> {
        let limits = Limits::of(settings);
        if settings.solver == Solver::Newton {
            return self.newton.solve(free, rows, limits);
        }
        if settings.sweeps == Sweeps::Auto && settings.law.on_guess() {
            return Ok(self.solve_for_sure(limits, free, rows));
        }
        Ok(self.pgs.solve(free, rows, limits))
    }
}

impl<R: Real> Solvers<R> {
    /// Solves by sweeps, then by `proximal.rs` if unsolved. For `auto` sweeps: a requested number
    /// stays fixed, and under `solref` Newton's method is available.
    pub(super) fn solve_for_sure(
        &mut self,
        limits: Limits,
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
    ) -> Report<R> {
        let mut report = self.pgs.solve(free, rows, limits);
        if report.open.none() {
            return report;
        }
        let Self { pgs, newton, proximal } = self;
        let mut left = R::Mask::of(false);
        for (island, todo) in &pgs.open {
            let island = (pgs.blocks_of(*island), pgs.weight());
            let by = (&mut *newton, limits);
            left = left.or(proximal.solve(by, free, rows, island, *todo, &mut report));
        }
        report.open = left;
        report
    }
}
