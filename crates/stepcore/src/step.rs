//! The loop: place → detect → solve → commit.
//!
//! The integrator says how often a step runs the first three; `integrate` is in
//! `commit/`. What is written here is the whole of a step.

use crate::elements::force::Moment;
use crate::error::Result;
use crate::observer::Observer;
use crate::real::{Mask, Real, Stage};
use crate::sim::{At, Sim};
use crate::solve::Situation;

impl<R: Real> Sim<R> {
    /// Advances by `n` steps, or to the last finite state before an error.
    pub fn step(&mut self, n: u64) -> Result<()> {
        self.step_watched(n, &mut ())
    }

    /// The same while `observer` watches.
    pub fn step_watched<O: Observer<R>>(&mut self, n: u64, observer: &mut O) -> Result<()> {
        for _ in 0..n {
            R::enter(Stage::Commit);
            self.integrate(observer)?;
            self.check_next()?;
            observer.committing(self);
            std::mem::swap(&mut self.state.qpos, &mut self.next.qpos);
            std::mem::swap(&mut self.state.qvel, &mut self.next.qvel);
            std::mem::swap(&mut self.state.warm, &mut self.next.warm);
            self.state.steps += 1;
        }
        Ok(())
    }

    /// Place, detect and solve at the present state. Nothing is committed.
    pub fn forward(&mut self) -> Result<()> {
        self.place_detect_solve(At::State)?;
        let bad = all_finite(&self.qacc).not();
        if bad.any() {
            return Err(
                self.diverged(bad, |lane| self.not_finite(lane, "acceleration", &self.qacc))
            );
        }
        Ok(())
    }

    /// What forces depend on, with the placement at hand.
    pub(crate) fn moment(&self, at: At) -> Moment<'_, R> {
        let (qpos, qvel) = at.of(&self.state, &self.next);
        let frames = self.placed.frames();
        Moment { model: &self.model, frames, qpos, qvel, inputs: &self.inputs }
    }

    pub(crate) fn place_detect_solve(&mut self, at: At) -> Result<()> {
        let (qpos, qvel) = at.of(&self.state, &self.next);
        self.placed.place(&self.model, qpos, qvel, &self.inputs, self.clock.dt);
        self.detect_and_solve(at)
    }

    pub(crate) fn detect_and_solve(&mut self, at: At) -> Result<()> {
        R::enter(Stage::Detect);
        self.effort.evaluations += 1;
        let (qpos, _) = at.of(&self.state, &self.next);
        self.detected.detect(&self.model, &self.placed, &self.settings, qpos);
        let now = Situation {
            model: &self.model,
            placed: &self.placed,
            settings: &self.settings,
            clock: self.clock,
            qpos,
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
        let (_, qvel) = at.of(&self.state, &self.next);
        for k in 0..self.model.nv {
            self.qacc[k] = (self.velocity[k] - qvel[k]) * self.clock.rate;
        }
        R::enter(Stage::Commit);
        Ok(())
    }

    /// The acceleration that the smooth forces alone give.
    pub(crate) fn smooth(&mut self, at: At) {
        self.effort.evaluations += 1;
        let (qpos, qvel) = at.of(&self.state, &self.next);
        self.placed.positions_in_step(&self.model, qpos);
        self.placed.dynamics(&self.model, qpos, qvel, &self.inputs);
        R::enter(Stage::Guess);
        self.qacc.copy_from_slice(&self.placed.force);
        self.placed.metric.solve(&mut self.qacc);
        R::enter(Stage::Commit);
    }

    /// A state that is not finite is never committed.
    fn check_next(&self) -> Result<()> {
        let bad = all_finite(&self.next.qvel).and(all_finite(&self.next.qpos)).not();
        if bad.any() {
            return Err(
                self.diverged(bad, |lane| self.not_finite(lane, "velocity", &self.next.qvel))
            );
        }
        Ok(())
    }
}

/// Lanes in which every number is finite.
fn all_finite<R: Real>(numbers: &[R]) -> R::Mask {
    numbers.iter().fold(R::Mask::of(true), |finite, x| finite.and(x.is_finite()))
}
