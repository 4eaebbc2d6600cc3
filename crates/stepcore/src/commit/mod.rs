//! Stage 4, commit: velocities and positions after the step.
//!
//! Integrators that run the first three stages once read the solved u⁺ and commit
//! here; `rk4` and `midpoint` run them several times and have files of their own.
//! Everything is written to `Next` first: a state that is not finite is never committed.

mod damped;
mod midpoint;
mod position;
mod rk4;

pub use position::advance;

use crate::error::Result;
use crate::model::Model;
use crate::real::Real;
use crate::settings::Integrator;
use crate::sim::Sim;
use crate::state::Warm;

/// The state that a step proposes, and the working space of the integrators.
pub struct Next<R: Real> {
    pub qpos: Vec<R>,
    pub qvel: Vec<R>,
    /// Impulses for the next step's start.
    pub warm: Vec<Warm<R>>,
    damped: damped::Damped<R>,
    stages: rk4::Stages<R>,
}

impl<R: Real> Next<R> {
    pub fn new(model: &Model) -> Self {
        Self {
            qpos: vec![R::zero(); model.nq],
            qvel: vec![R::zero(); model.nv],
            warm: Vec::new(),
            damped: damped::Damped::new(model),
            stages: rk4::Stages::new(model),
        }
    }
}

impl<R: Real> Sim<R> {
    /// One step of the integrator, into `next`.
    pub(crate) fn integrate(&mut self) -> Result<()> {
        let on_guess = self.on_guess();
        match self.settings.integrator {
            Integrator::Rk4 if on_guess => {
                self.rk4(false)?;
                self.rows_at_the_end()
            }
            Integrator::Midpoint if on_guess => {
                self.midpoint(false)?;
                self.rows_at_the_end()
            }
            Integrator::Rk4 => self.rk4(true),
            Integrator::Midpoint => self.midpoint(true),
            _ => {
                self.forward()?;
                self.commit();
                Ok(())
            }
        }
    }

    /// From u⁺ to the next state, for integrators of one stage.
    fn commit(&mut self) {
        let model = &*self.model;
        self.next.qvel.copy_from_slice(&self.velocity);
        match self.settings.integrator {
            Integrator::Euler if model.features.eulerdamp => self.damp(false),
            Integrator::ImplicitFast => self.damp(true),
            _ => {}
        }
        let moving = match self.settings.integrator {
            Integrator::Explicit => &self.state.qvel,
            _ => &self.next.qvel,
        };
        let dt = R::of(self.settings.dt);
        advance(&self.model, &self.state.qpos, moving, dt, &mut self.next.qpos);
    }

    /// Laws on velocities under `rk4` and `midpoint`: the smooth motion went from (q, v)
    /// to (q₁, v₁); the rows are solved once, with v₁ as the guess, and what they
    /// change moves on for the whole step: q⁺ = q₁ ⊕ dt (v⁺ − v₁).
    fn rows_at_the_end(&mut self) -> Result<()> {
        let model = self.model.clone();
        let dt = R::of(self.settings.dt);
        self.placed.place(&model, &self.state, &self.inputs, dt);
        self.placed.guess.copy_from_slice(&self.next.qvel);
        self.placed.metric.to_factored(&mut self.placed.guess);
        self.detect_and_solve()?;
        if self.rows.any() {
            for k in 0..model.nv {
                let change = self.velocity[k] - self.next.qvel[k];
                self.next.qvel[k] = self.velocity[k];
                self.velocity[k] = change;
            }
            let smooth = self.next.qpos.clone();
            advance(&model, &smooth, &self.velocity, dt, &mut self.next.qpos);
            self.velocity.copy_from_slice(&self.next.qvel);
        }
        Ok(())
    }
}
