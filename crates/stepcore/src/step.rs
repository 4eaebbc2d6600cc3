//! The loop: place → detect → solve → commit.
//!
//! The integrator says how often a step runs the first three; `integrate` is in
//! `commit/`. What is written here is the whole of a step.

use crate::error::Result;
use crate::real::{Mask, Real, Stage};
use crate::sim::Sim;
use crate::solve::Situation;

impl<R: Real> Sim<R> {
    /// Advances by `n` steps, or to the last finite state before an error.
    pub fn step(&mut self, n: u64) -> Result<()> {
        if self.ledger.is_none() || !R::INVESTIGATED {
            return self.advance(n, false);
        }
        self.step_in_ledger(n)
    }

    /// `driven`: something from outside does work, and the ledger wants to know.
    pub(crate) fn advance(&mut self, n: u64, driven: bool) -> Result<()> {
        for _ in 0..n {
            R::enter(Stage::Commit);
            self.integrate()?;
            self.check_finite()?;
            if driven {
                self.pay();
            }
            // past ← state ← next ← (room of the oldest past)
            std::mem::swap(&mut self.state.qpos, &mut self.next.qpos);
            std::mem::swap(&mut self.state.qvel, &mut self.next.qvel);
            self.past.keep(&mut self.next.qpos, &mut self.next.qvel);
            std::mem::swap(&mut self.state.warm, &mut self.next.warm);
            self.state.steps += 1;
        }
        Ok(())
    }

    /// Place, detect and solve at the present state. Nothing is committed.
    pub fn forward(&mut self) -> Result<()> {
        self.place_detect_solve()?;
        let bad = all_finite(&self.qacc).not();
        if bad.any() {
            let quantity = self.first_not_finite(bad, "acceleration", &self.qacc);
            return Err(self.diverged(bad, quantity));
        }
        Ok(())
    }

    pub(crate) fn place_detect_solve(&mut self) -> Result<()> {
        let dt = R::of(self.settings.dt);
        self.placed.place(&self.model, &self.state, &self.inputs, dt);
        self.detect_and_solve()
    }

    pub(crate) fn detect_and_solve(&mut self) -> Result<()> {
        R::enter(Stage::Detect);
        self.detected.detect(&self.model, &self.placed, &self.settings, &self.state.qpos);
        let now = Situation {
            model: &self.model,
            placed: &self.placed,
            settings: &self.settings,
            qpos: &self.state.qpos,
        };
        R::enter(Stage::Rows);
        self.rows.make(&now, &mut self.detected);
        R::enter(Stage::Impulses);
        if self.rows.any() {
            self.solve()?;
        } else {
            self.effort.rest();
        }
        if self.settings.warm_start {
            self.rows.store_warm(&mut self.next.warm);
        }
        self.placed.metric.from_factored(&self.rows.u, &mut self.velocity);
        let rate = R::of(1.0 / self.settings.dt);
        for k in 0..self.model.nv {
            self.qacc[k] = (self.velocity[k] - self.state.qvel[k]) * rate;
        }
        R::enter(Stage::Commit);
        Ok(())
    }

    /// The acceleration that the smooth forces alone give.
    pub(crate) fn smooth(&mut self) {
        self.placed.positions_in_step(&self.model, &self.state.qpos);
        self.placed.dynamics(&self.model, &self.state.qpos, &self.state.qvel, &self.inputs);
        R::enter(Stage::Guess);
        self.qacc.copy_from_slice(&self.placed.force);
        self.placed.metric.solve(&mut self.qacc);
        R::enter(Stage::Commit);
    }

    fn check_finite(&mut self) -> Result<()> {
        let bad = all_finite(&self.next.qvel).and(all_finite(&self.next.qpos)).not();
        if bad.any() {
            let quantity = self.first_not_finite(bad, "velocity", &self.next.qvel);
            return Err(self.diverged(bad, quantity));
        }
        Ok(())
    }
}

/// Lanes in which every number is finite.
fn all_finite<R: Real>(numbers: &[R]) -> R::Mask {
    numbers.iter().fold(R::Mask::of(true), |finite, x| finite.and(x.is_finite()))
}
