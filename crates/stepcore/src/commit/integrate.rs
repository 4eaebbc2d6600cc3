//! One step of an integrator, into `Next`.

use super::damped::Solved;
use super::{advance, Next};
use crate::clock::Clock;
use crate::elements::activation;
use crate::elements::force::Moment;
use crate::error::Result;
use crate::integrator::Stages;
use crate::model::Model;
use crate::observer::Observer;
use crate::place::Placed;
use crate::plan::Commit;
use crate::real::Real;
use crate::sim::{At, Sim};
use crate::state::{Inputs, State};

impl<R: Real> Sim<R> {
    /// Makes one step of the integrator, into `next`.
    #[inline(always)]
    pub(crate) fn integrate(&mut self, observer: &mut dyn Observer<R>) -> Result<()> {
        match self.plan.scheme.stages {
            Stages::Start => {
                self.place_detect_solve(At::State)?;
                observer.placed(self, At::State, 1.0);
                observer.solved(self, At::State, 1.0);
                self.next.qvel.copy_from_slice(&self.velocity);
            }
            Stages::Middle => self.after_stages(Self::midpoint, observer)?,
            Stages::Four => self.after_stages(Self::rk4, observer)?,
        }
        for nth in 0..self.plan.commit.len() {
            self.commit(self.plan.commit[nth]);
        }
        Ok(())
    }

    fn commit(&mut self, commit: Commit) {
        let Self { model, state, inputs, placed, next, .. } = self;
        match commit {
            Commit::Damped | Commit::Turning => self.damp(),
            Commit::Spinning => {
                self.spin();
                self.next.qvel.copy_from_slice(&self.velocity);
            }
            Commit::Positions { first } => {
                let moving = if first { &state.qvel } else { &next.qvel };
                advance(model, &state.qpos, moving, self.clock.dt, &mut next.qpos);
            }
            Commit::Activations => {
                let (rates, seconds) = (placed.act_rates(), self.clock.seconds);
                activation::advance(model, &state.act, rates, seconds, &mut next.act);
                activation::centres(model, &state.qpos, placed.pulls(), &mut next.centres);
                activation::unwind(model, &next.centres, &mut next.act);
            }
            Commit::History => {
                let history = &mut next.ctrl_history;
                activation::remember(model, &state.ctrl_history, &inputs.ctrl, history);
            }
            Commit::Sleep if R::ALONE => self.settle(),
            Commit::Sleep => {}
        }
    }

    /// The implicit part apart from the rows: see `damped.rs`, `implicit.rs`.
    fn damp(&mut self) {
        let Self { model, state, inputs, placed, rows, plan, clock, next, .. } = self;
        let solved = solved(model, state, inputs, placed, &rows.u, *clock);
        let Next { damped, implicit, qvel, .. } = next;
        if let Some(implicit) = implicit {
            implicit.damp(&solved, &plan.late.damped, qvel);
        } else if let Some(damped) = damped {
            damped.damp(&solved, &plan.late, qvel);
        }
    }

    /// Adds the gyroscopic forces of free bodies under `discrete`, whose acceleration covers the
    /// whole step, as in MuJoCo.
    pub(crate) fn spin(&mut self) {
        let Self { model, state, inputs, placed, rows, plan, clock, next, velocity, qacc, .. } =
            self;
        let solved = solved(model, state, inputs, placed, &rows.u, *clock);
        if let Some(damped) = &mut next.damped {
            damped.spin_all(&solved, &plan.late, velocity);
        }
        for (qacc, (new, old)) in qacc.iter_mut().zip(velocity.iter().zip(&state.qvel)) {
            *qacc = (*new - *old) * clock.rate;
        }
    }
}

/// The solve at the start of a step.
fn solved<'a, R: Real>(
    model: &'a Model<R::Value>,
    state: &'a State<R>,
    inputs: &'a Inputs<R>,
    placed: &'a Placed<R>,
    u: &'a [R],
    clock: Clock<R>,
) -> Solved<'a, R> {
    let (frames, act) = (placed.frames(), state.activations(clock));
    let now = Moment { model, frames, qpos: &state.qpos, qvel: &state.qvel, act, inputs };
    Solved { now, placed, u, dt: clock.dt }
}
