//! What the next steps cost, in operations and in bytes.

use super::watched::explained;
use crate::arrays::Plain;
use crate::error::Result;
use crate::real::{Counted, Real, Stage};
use crate::sim::Sim;

/// Steps of a copy whose operations are counted.
pub struct Counter {
    sim: Sim<Counted>,
    /// Operations so far, in the order of `Stage::ALL`.
    pub counts: [u64; Stage::ALL.len()],
}

impl Counter {
    /// From the present state and inputs of a world, with its settings, computed in `f64`.
    pub fn new<R: Real>(from: &Sim<R>) -> Result<Self> {
        Self::of(&from.plain())
    }

    fn of(from: &Plain) -> Result<Self> {
        Ok(Self { sim: from.sim()?, counts: [0; Stage::ALL.len()] })
    }

    /// Takes `n` steps on this thread, and counts them.
    #[inline] // A failure is explained in plain numbers, whose step is compiled where this is called.
    pub fn advance(&mut self, n: u64) -> Result<()> {
        self.count(n).map_err(|error| explained(&self.sim, error))
    }

    fn count(&mut self, n: u64) -> Result<()> {
        Counted::take();
        let outcome = self.sim.step(n);
        for (count, more) in self.counts.iter_mut().zip(Counted::take()) {
            *count += more;
        }
        outcome
    }
}
