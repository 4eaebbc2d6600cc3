//! One step of an integrator, into `Next`.

use super::damped::Solved;
use super::{advance, Next};
use crate::elements::activation;
use crate::elements::force::Moment;
use crate::error::Result;
use crate::integrator::Stages;
use crate::observer::Observer;
use crate::plan::Commit;
use crate::real::Real;
use crate::sim::{At, Sim};

impl<R: Real> Sim<R> {
    /// One step of the integrator, into `next`.
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
            Commit::Damped | Commit::Spinning | Commit::Turning => self.damp(commit),
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

    /// What is implicit beside the rows: see `damped.rs`, `implicit.rs`.
    fn damp(&mut self, commit: Commit) {
        let (placed, u, late) = (&self.placed, &self.rows.u, &self.plan.late);
        let now = Moment {
            model: &self.model,
            frames: placed.frames(),
            qpos: &self.state.qpos,
            qvel: &self.state.qvel,
            act: self.state.activations(self.clock),
            inputs: &self.inputs,
        };
        let solved = Solved { now, placed, u, dt: self.clock.dt };
        let Next { damped, implicit, qvel, .. } = &mut self.next;
        if let Some(implicit) = implicit {
            implicit.damp(&solved, &late.damped, qvel);
        } else if let Some(damped) = damped {
            match commit {
                Commit::Spinning => damped.spin_all(&solved, late, qvel),
                _ => damped.damp(&solved, late, qvel),
            }
        }
    }
}
