//! Which solver the settings ask for.

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

/// Finds the impulses of rows. A `Sim` holds one: `Solvers`, or in numbers that carry slopes
/// `Differentiated`.
pub(crate) trait Solve<R: Real>: Room + Send + Sync {
    /// Starts from the impulses that `rows` hold. `rows.u` must hold û and their effect, or where
    /// `rows.start` says where to begin û alone; afterwards it holds û and the effect of the new ones.
    fn solve(
        &mut self,
        settings: &Settings,
        free: Unconstrained<R>,
        rows: &mut Rows<R>,
    ) -> Result<Report<R>>;

    /// Makes its memory anew, which an interrupted solve has left half made.
    fn renew(&mut self);

    /// Elements at which the slopes were those of one side since this was last asked; ascending.
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
    /// By sweeps, and what these leave open by `proximal.rs`. Whoever asks for a number of sweeps
    /// has that many, and under `solref` Newton's method is there to be asked for.
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
