//! One step of an integrator, into `Next`.

use super::damped::Solved;
use super::{advance, Next};
use crate::elements::activation;
use crate::elements::force::Moment;
use crate::error::Result;
use crate::observer::Observer;
use crate::real::Real;
use crate::settings::Integrator;
use crate::sim::{At, Sim};

impl<R: Real> Sim<R> {
    /// One step of the integrator, into `next`.
    pub(crate) fn integrate<O: Observer<R>>(&mut self, observer: &mut O) -> Result<()> {
        match self.settings.integrator {
            Integrator::Rk4 => self.after_stages(Self::rk4, observer),
            Integrator::Midpoint => self.after_stages(Self::midpoint, observer),
            _ => self.in_one_stage(observer),
        }
    }

    /// The same of integrators that evaluate forces once.
    pub(crate) fn in_one_stage<O: Observer<R>>(&mut self, observer: &mut O) -> Result<()> {
        self.place_detect_solve(At::State)?;
        observer.placed(self, At::State, 1.0);
        observer.solved(self, At::State, 1.0);
        self.commit();
        Ok(())
    }

    /// From u⁺ to the next state, for integrators of one stage.
    fn commit(&mut self) {
        self.next.qvel.copy_from_slice(&self.velocity);
        match self.settings.integrator {
            Integrator::Euler if !self.model.features.eulerdamp => {}
            Integrator::Euler
            | Integrator::ImplicitFast
            | Integrator::Implicit
            | Integrator::Discrete => self.damp(),
            _ => {}
        }
        let moving = match self.settings.integrator {
            Integrator::Explicit => &self.state.qvel,
            _ => &self.next.qvel,
        };
        advance(&self.model, &self.state.qpos, moving, self.clock.dt, &mut self.next.qpos);
        let (rates, seconds) = (self.placed.act_rates(), self.clock.seconds);
        activation::advance(&self.model, &self.state.act, rates, seconds, &mut self.next.act);
        let (pulls, centres) = (self.placed.pulls(), &mut self.next.centres);
        activation::centres(&self.model, &self.state.qpos, pulls, centres);
        activation::unwind(&self.model, centres, &mut self.next.act);
    }

    /// What is implicit beside the rows: see `damped.rs`, `implicit.rs`.
    fn damp(&mut self) {
        let now = Moment {
            model: &self.model,
            frames: self.placed.frames(),
            qpos: &self.state.qpos,
            qvel: &self.state.qvel,
            act: self.state.activations(self.clock),
            inputs: &self.inputs,
        };
        let (placed, u) = (&self.placed, &self.rows.u);
        let solved = Solved { now, placed, u, dt: self.clock.dt };
        let Next { damped, implicit, qvel, .. } = &mut self.next;
        match (self.settings.integrator, implicit) {
            (Integrator::Implicit, Some(implicit)) => implicit.damp(&solved, qvel),
            (Integrator::Discrete, _) => damped.spin_all(&solved, qvel),
            (integrator, _) => damped.damp(&solved, integrator != Integrator::Euler, qvel),
        }
    }
}
