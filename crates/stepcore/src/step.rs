//! The loop: place → detect → solve → commit.
//!
//! The integrator determines how often a step runs the first three; `integrate` is in `commit/`.
//! This file contains the whole step.

use crate::commit::Next;
use crate::detect::Detected;
use crate::elements::force::Moment;
use crate::error::{Error, Result};
use crate::integrator::Stages;
use crate::interrupt::{caught, unasked};
use crate::observer::Observer;
use crate::plan::Commit;
use crate::real::{Mask, Real, Stage};
use crate::shapes::searched;
use crate::sim::{At, Sim};
use crate::solve::{Choice, Part, Situation};

impl<R: Real> Sim<R> {
    /// Runs `work`; if it is interrupted, state and inputs stay at the last whole step.
    pub(crate) fn whole<T>(&mut self, work: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        let outcome = caught(|| work(self));
        if matches!(outcome, Err(Error::Interrupted)) {
            unasked(|| self.renew());
        }
        outcome
    }

    /// Advances by `n` steps, or to the last finite state before an error.
    pub fn step(&mut self, n: u64) -> Result<()> {
        self.step_watched(n, &mut ())
    }

    /// The same with an `observer`.
    pub fn step_watched(&mut self, n: u64, observer: &mut dyn Observer<R>) -> Result<()> {
        self.wake_where_off();
        for _ in 0..n {
            R::enter(Stage::Commit);
            match self.settings.accuracy.0 {
                Some(asked) if R::ALONE => self.integrate_within(asked)?,
                _ => self.integrate(observer)?,
            }
            self.check_next()?;
            observer.committing(self);
            self.swap_states();
            self.state.steps += 1;
        }
        Ok(())
    }

    /// Swaps the state and the next one.
    #[inline(always)]
    pub(crate) fn swap_states(&mut self) {
        let (state, next) = (&mut self.state, &mut self.next);
        std::mem::swap(&mut state.qpos, &mut next.qpos);
        std::mem::swap(&mut state.qvel, &mut next.qvel);
        if self.model.na > 0 {
            std::mem::swap(&mut state.act, &mut next.act);
        }
        if self.model.nhistory > 0 {
            std::mem::swap(&mut state.ctrl_history, &mut next.ctrl_history);
        }
        // A restored state may hold impulses that these settings do not store.
        std::mem::swap(&mut state.warm, &mut next.warm);
        if R::ALONE && self.plan.sleeps {
            std::mem::swap(&mut state.sleep, &mut next.sleep);
        }
    }

    /// Place, detect and solve at the present state. Nothing is committed.
    pub fn forward(&mut self) -> Result<()> {
        self.wake_where_off();
        self.set_dt(self.period);
        self.place_detect_solve(At::State)?;
        if self.plan.commit.contains(&Commit::Spinning) {
            self.spin();
        }
        let bad = all_finite(&self.qacc).not();
        if bad.any() {
            return Err(
                self.diverged(bad, |lane| self.not_finite(lane, "acceleration", &self.qacc))
            );
        }
        Ok(())
    }

    /// Returns the inputs of forces, with the current placement.
    pub(crate) fn moment(&self, at: At) -> Moment<'_, R> {
        let (qpos, qvel) = at.of(&self.state, &self.next);
        let frames = self.placed.frames();
        let act = at.activations(&self.state, &self.next, self.clock);
        Moment { model: &self.model, frames, qpos, qvel, act, inputs: &self.inputs }
    }

    /// Mark that the next step starts at the positions of the last one, with their derivatives, and
    /// the same models and inputs: everything that follows from these alone is reused.
    pub(crate) fn hold_positions(&mut self) {
        // Other integrators have placed other positions since.
        self.placed.held = self.plan.scheme.stages == Stages::Start;
    }

    #[inline(always)]
    pub(crate) fn place_detect_solve(&mut self, at: At) -> Result<()> {
        if std::mem::take(&mut self.stands) {
            return Ok(());
        }
        if R::ALONE && self.plan.sleeps {
            return self.solve_with_sleepers(at);
        }
        self.place_and_make_rows(at)?;
        self.solve_placed(at)
    }

    #[inline(never)]
    fn solve_with_sleepers(&mut self, at: At) -> Result<()> {
        self.begin_sleep();
        loop {
            self.place_and_make_rows(at)?;
            if !self.wake_touched() {
                return self.solve_placed(at);
            }
        }
    }

    pub(crate) fn place_and_make_rows(&mut self, at: At) -> Result<()> {
        if R::ALONE && self.plan.sleeps {
            self.rest_asleep(at);
        }
        let (qpos, qvel) = at.of(&self.state, &self.next);
        let act = at.activations(&self.state, &self.next, self.clock);
        let held = self.placed.held;
        self.placed.place(&self.model, qpos, qvel, act, &self.inputs, self.clock.dt);
        if R::ALONE && self.plan.sleeps {
            self.hold_asleep();
        }
        let before = searched();
        // Contacts ahead depend on velocities too.
        if !held || self.settings.ahead().is_some() {
            self.detect(at)?;
        }
        if self.model.adheres {
            let act = at.activations(&self.state, &self.next, self.clock);
            let (at, contacts) = (at.of(&self.state, &self.next), &self.detected.contacts);
            self.placed.place_adhesion(&self.model, at, act, &self.inputs, contacts);
            self.placed.make_guess(self.clock.dt);
        }
        self.make_rows(at, Part::Whole);
        self.effort.separations += searched() - before;
        self.take_pushes();
        Ok(())
    }

    /// Adds impulses of contacts without rows to the start of the rows.
    pub(crate) fn take_pushes(&mut self) {
        if !self.rows.pushes.is_empty() {
            self.next.smooth.copy_from_slice(&self.placed.guess);
            self.placed.guess.copy_from_slice(&self.rows.u);
        }
    }

    pub(crate) fn detect(&mut self, at: At) -> Result<()> {
        R::enter(Stage::Detect);
        self.effort.evaluations += 1;
        if !self.model.meets() {
            self.detected.contacts.clear();
            return Ok(());
        }
        let (qpos, _) = at.of(&self.state, &self.next);
        self.detected.detect(&self.model, &self.placed, self.settings.ahead(), qpos)
    }

    /// Builds the rows of the current contacts.
    pub(crate) fn make_rows(&mut self, at: At, part: Part) {
        R::enter(Stage::Rows);
        if !self.model.makes_rows(self.detected.contacts.len()) {
            return self.rows.begin(&self.placed.guess);
        }
        let (qpos, qvel) = at.of(&self.state, &self.next);
        let now = Situation {
            model: &self.model,
            placed: &self.placed,
            dof_lists: self.detected.lists.of(&self.model),
            settings: &self.settings,
            clock: self.clock,
            qpos,
            qvel,
            inputs: &self.inputs,
            part,
            warm: self.next.last_impulses(&self.state),
            asleep: &self.detected.asleep,
            first_stage: self.next.stage == 0,
        };
        self.rows.make(&now, &mut self.detected.contacts);
    }

    /// Returns the contacts of the current placement, for reading: the last solve's contacts remain.
    pub(crate) fn detect_again(&self) -> Detected<R> {
        let mut detected = Detected::new(&self.model, 0);
        // If a step had room there is room again; else it has failed already.
        let _ = detected.detect(&self.model, &self.placed, self.settings.ahead(), &self.state.qpos);
        detected
    }

    fn solve_placed(&mut self, at: At) -> Result<()> {
        R::enter(Stage::Impulses);
        if self.rows.any() {
            self.warm_start(false);
            if self.plan.resumes {
                let last = self.next.last_impulses(&self.state);
                self.rows.start_along(last, &self.placed.u, self.clock.dt);
            }
            self.solve()?;
        } else {
            self.effort.rest();
        }
        if self.plan.keeps {
            self.rows.store_warm(&mut self.next.warm, false);
        }
        if self.plan.resumes {
            let (before, rate) = (&self.placed.u, self.clock.rate);
            self.rows.store_accelerations(&mut self.next.warm, before, rate);
        }
        self.placed.metric.from_factored(&self.rows.u, &mut self.velocity);
        let (_, qvel) = at.of(&self.state, &self.next);
        for (qacc, (new, old)) in self.qacc.iter_mut().zip(self.velocity.iter().zip(qvel)) {
            *qacc = (*new - *old) * self.clock.rate;
        }
        R::enter(Stage::Commit);
        Ok(())
    }

    /// Computes the acceleration from the smooth forces and equalities alone; the model has some.
    pub(crate) fn smooth_and_connected(
        &mut self,
        at: At,
        share: f64,
        choice: Choice,
    ) -> Result<()> {
        self.smooth(at);
        R::enter(Stage::Guess);
        let (_, qvel) = at.of(&self.state, &self.next);
        self.placed.metric.to_factored(qvel, &mut self.placed.u);
        self.placed.metric.to_factored(&self.qacc, &mut self.placed.guess);
        for k in 0..self.model.nv {
            self.placed.guess[k] = self.placed.u[k] + self.clock.dt * self.placed.guess[k];
        }
        self.connect(at, Part::Stage, share, choice)?;
        for k in 0..self.model.nv {
            self.qacc[k] += self.velocity[k] * self.clock.rate;
        }
        R::enter(Stage::Commit);
        Ok(())
    }

    /// Solves the equalities alone from the current guess; `velocity` gets their change. Their
    /// impulses act for a share of the step.
    pub(crate) fn connect(&mut self, at: At, part: Part, share: f64, choice: Choice) -> Result<()> {
        self.make_rows(at, part);
        R::enter(Stage::Impulses);
        let lists = self.detected.dof_lists(&self.model);
        if !self.rows.solve_direct(lists, &self.placed.metric.inv_d, choice) {
            self.warm_start(false);
            self.solve()?;
        }
        self.effort.most_rows = self.effort.most_rows.max(self.rows.rows.len());
        for (sum, row) in self.next.held.iter_mut().zip(&self.rows.rows) {
            *sum += R::of(share) * row.impulse;
        }
        let change = &mut self.next.change;
        for k in 0..self.model.nv {
            change[k] = self.rows.u[k] - self.placed.guess[k];
        }
        self.placed.metric.from_factored(change, &mut self.velocity);
        Ok(())
    }

    /// Computes the acceleration from the smooth forces alone.
    pub(crate) fn smooth(&mut self, at: At) {
        self.effort.evaluations += 1;
        let (qpos, qvel) = at.of(&self.state, &self.next);
        self.placed.place_all();
        self.placed.carry(&self.inputs);
        self.placed.positions_in_step(&self.model, qpos);
        let act = at.activations(&self.state, &self.next, self.clock);
        self.placed.dynamics(&self.model, qpos, qvel, act, &self.inputs);
        R::enter(Stage::Guess);
        self.qacc.copy_from_slice(&self.placed.force);
        self.placed.metric.solve(&mut self.qacc);
        R::enter(Stage::Commit);
    }

    /// Checks that the next state is finite: others are never committed.
    pub(crate) fn check_next(&self) -> Result<()> {
        let Next { qpos, qvel, act, .. } = &self.next;
        let bad = all_finite(qvel).and(all_finite(qpos)).not();
        if bad.any() {
            return Err(
                self.diverged(bad, |lane| self.not_finite(lane, "velocity", &self.next.qvel))
            );
        }
        if act.is_empty() {
            return Ok(());
        }
        let bad = all_finite(act).not();
        if bad.any() {
            return Err(self.diverged(bad, |lane| self.act_not_finite(lane)));
        }
        Ok(())
    }
}

/// Returns the lanes in which every number is finite.
pub(crate) fn all_finite<R: Real>(numbers: &[R]) -> R::Mask {
    numbers.iter().fold(R::Mask::of(true), |finite, x| finite.and(x.is_finite()))
}
