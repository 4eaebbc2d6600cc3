//! One step of an integrator, into `Next`.

use super::damped::Solved;
use super::{advance, Next};
use crate::elements::activation;
use crate::elements::force::Moment;
use crate::error::Result;
use crate::integrator::{Late, Stages};
use crate::observer::Observer;
use crate::real::Real;
use crate::sim::{At, Sim};

impl<R: Real> Sim<R> {
    /// One step of the integrator, into `next`.
    pub(crate) fn integrate<O: Observer<R>>(&mut self, observer: &mut O) -> Result<()> {
        match self.settings.integrator.scheme().stages {
            Stages::Start => self.in_one_stage(observer),
            Stages::Middle => self.after_stages(Self::midpoint, observer),
            Stages::Four => self.after_stages(Self::rk4, observer),
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
        let scheme = self.settings.integrator.scheme();
        if let Some(late) = scheme.late(self.model.features.eulerdamp) {
            self.damp(late, scheme.stiffness);
        }
        let moving = if scheme.moves_first { &self.state.qvel } else { &self.next.qvel };
        advance(&self.model, &self.state.qpos, moving, self.clock.dt, &mut self.next.qpos);
        let (rates, seconds) = (self.placed.act_rates(), self.clock.seconds);
        activation::advance(&self.model, &self.state.act, rates, seconds, &mut self.next.act);
        let (pulls, centres) = (self.placed.pulls(), &mut self.next.centres);
        activation::centres(&self.model, &self.state.qpos, pulls, centres);
        activation::unwind(&self.model, centres, &mut self.next.act);
    }

    /// What is implicit beside the rows: see `damped.rs`, `implicit.rs`.
    fn damp(&mut self, late: Late, in_metric: bool) {
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
        match implicit {
            Some(implicit) => implicit.damp(&solved, qvel),
            None if in_metric => damped.spin_all(&solved, qvel),
            None => damped.damp(&solved, late == Late::All, qvel),
        }
    }
}
