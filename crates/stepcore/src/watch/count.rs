//! The cost of the next steps, in operations and in bytes.

use super::watched::{explained, Explain};
use crate::arrays::Plain;
use crate::error::Result;
use crate::real::{Counted, Real, Stage};
use crate::sim::Sim;

/// Steps of a copy whose operations are counted.
pub struct Counter {
    sim: Sim<Counted>,
    /// Operations until now, in the order of `Stage::ALL`.
    pub counts: [u64; Stage::ALL.len()],
    explain: Explain,
}

impl Counter {
    /// Starts at the present state and inputs of a world, with its settings, computed in `f64`.
    pub fn new<R: Real>(from: &Sim<R>) -> Result<Self> {
        Self::of(&from.plain(), explained::<R::One>)
    }

    fn of(from: &Plain, explain: Explain) -> Result<Self> {
        Ok(Self { sim: from.sim()?, counts: [0; Stage::ALL.len()], explain })
    }

    /// Takes `n` steps on this thread, and counts them.
    pub fn advance(&mut self, n: u64) -> Result<()> {
        self.count(n).map_err(|error| (self.explain)(&self.sim.plain(), error))
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
