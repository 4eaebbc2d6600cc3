//! Limits of a solver's run, and its report.

use crate::real::{Count, Mask, Real};
use crate::settings::{Acceleration, Law, Settings, Sweeps};

/// When to stop sweeping.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub sweeps: u32,
    /// On the scalar residual [m/s]; 0 runs every sweep.
    pub tolerance: f64,
    /// A solve ends with the sweep or the Newton step that lowers the rows' objective by less than
    /// this share of `Rows::inertia` [m²/s²]; 0: never. For laws whose rows are all convex.
    pub cost: f64,
    /// Accelerate: see `momentum.rs`. For laws whose rows are all convex; an island with a Coulomb
    /// block runs without.
    pub momentum: bool,
    /// Whether one update solves a row that is alone.
    pub solves_one: bool,
    /// Whether it does, and a solve may end there because a tolerance is set.
    pub exact: bool,
    /// Whether a tolerance below the rounding error of a residual is raised to that error.
    pub rounding: bool,
}

impl Limits {
    pub fn of(settings: &Settings) -> Self {
        let sweeps = settings.sweeps.limit();
        Self {
            sweeps,
            tolerance: settings.tolerance,
            cost: match settings.sweeps {
                Sweeps::AtMost(_) => settings.cost_floor(settings.cost_tolerance),
                Sweeps::Auto => 0.0,
            },
            // Decided by the law and not by the current rows, so that a lane equals its world alone.
            momentum: settings.acceleration == Acceleration::Momentum && !settings.law.on_guess(),
            solves_one: settings.law != Law::Relaxed,
            exact: sweeps > 0 && settings.tolerance > 0.0 && settings.law != Law::Relaxed,
            rounding: settings.sweeps == Sweeps::Auto,
        }
    }
}

/// The report of a solve, lane by lane.
#[derive(Clone, Copy, Debug)]
pub struct Report<R: Real> {
    /// Sweeps or iterations of the island that took the most.
    pub sweeps: Count,
    /// Row updates: rows × sweeps, summed over islands.
    pub updates: Count,
    /// Newton's decrement at the end, √(gᵀH⁻¹g) relative to the motion; 0 under PGS.
    pub decrement: R,
    /// Lanes in which some island used up its sweeps or iterations.
    pub open: R::Mask,
}

impl<R: Real> Report<R> {
    pub fn new() -> Self {
        Self {
            sweeps: Count::ZERO,
            updates: Count::ZERO,
            decrement: R::zero(),
            open: R::Mask::of(false),
        }
    }

    /// Adds the report of other islands.
    pub fn join(&mut self, other: &Self) {
        self.sweeps.raise(&other.sweeps);
        self.updates.add_each(R::Mask::of(true), &other.updates);
        self.decrement = self.decrement.max(other.decrement);
        self.open = self.open.or(other.open);
    }
}

impl Report<f64> {
    /// Converts to numbers that carry slopes.
    pub fn in_numbers<R: Real<Mask = bool>>(self) -> Report<R> {
        let Self { sweeps, updates, decrement, open } = self;
        Report { sweeps, updates, decrement: R::of(decrement), open }
    }
}
