//! The list of what a step executes, for models so small that asking costs more than computing.
//!
//! A step asks every element whether it is there, computes constants like everything else, and goes
//! from stage to stage through lists. For a mass on a spring that is a hundred times the work of its
//! two products and two sums. Here the step is written down once, as the operations on numbers that it
//! is for a model and its settings (`trace.rs`, `real/traced/`): what is known is computed then, what
//! the next state does not need is left out (`order.rs`), and the rest is executed for a block of
//! worlds, operation by operation (`run.rs`). The formulas are those of the stages, written nowhere
//! else, and so are the bits.
//!
//! A list is right where numbers stay below a limit and where what it assumes to be seldom does not
//! happen; it says where it was not, and such a step is made by the stages. So is the last step of a
//! call in a `Sim`, after which everything that a step leaves can be read.

mod block;
mod order;
mod run;
mod single;
mod text;
mod trace;

use std::sync::Arc;

use crate::model::Model;
use crate::real::Real;
use crate::settings::{Settings, Solver};
use order::{order, Ordered};
use trace::{trace, Trace};

pub(crate) use block::{Blocks, Holds, Place};
pub(crate) use single::Listed;

/// Entries of a list that is still of use for blocks of worlds.
const MOST: usize = 4096;
/// Operations up to which a list is quicker than the stages for one register of worlds by itself, by
/// measurement: each is asked what it is.
const ALONE: usize = 200;

/// What a step computes, for a model and its settings.
pub struct Program {
    trace: Trace,
    /// Row updates for each row.
    sweeps: u64,
    limits: Limits,
}

/// The sizes of positions and velocities [m or rad, 1/s] up to which a list is right.
#[derive(Clone, Copy)]
struct Limits {
    qpos: f64,
    qvel: f64,
}

impl Program {
    /// That of a model in numbers of type R, if it has one.
    pub fn of<R: Real>(model: &Arc<Model>, settings: &Settings) -> Option<Self> {
        Self::within::<R>(model, settings, MOST)
    }

    /// The same, if it has one of at most so many entries.
    fn within<R: Real>(model: &Arc<Model>, settings: &Settings, most: usize) -> Option<Self> {
        let trace = trace(model, settings, R::epsilon(), most)?;
        let sweeps = match settings.solver {
            Solver::Pgs => settings.sweeps.limit().into(),
            Solver::Newton => 0,
        };
        let limits = Limits { qpos: trace.limit, qvel: trace.fastest };
        Some(Self { sweeps, limits, trace })
    }

    /// The list of a step.
    fn steps(&self) -> Ordered {
        order(&self.trace, &[])
    }

    /// That of a step which leaves its acceleration.
    fn last(&self) -> Ordered {
        order(&self.trace, &self.trace.qacc)
    }

    /// That of a step which counts its rows.
    fn counted(&self) -> Ordered {
        order(&self.trace, &[self.trace.rows])
    }

    /// How many operations a step is.
    pub fn operations(&self) -> usize {
        self.steps().steps.len()
    }

    /// One world by itself is quicker by the list than by the stages.
    pub fn serves_one(&self) -> bool {
        self.operations() <= ALONE
    }

    /// So many registers of worlds are.
    pub fn serves(&self, registers: usize) -> bool {
        registers >= block::WORTH || self.serves_one()
    }
}
