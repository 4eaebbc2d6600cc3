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
use crate::room::room;
use crate::settings::{Integrator, Law};
use crate::sim::Sim;
use crate::state::Warm;

/// The state that a step proposes, and the working space of the integrators.
pub struct Next<R: Real> {
    pub qpos: Vec<R>,
    pub qvel: Vec<R>,
    /// The constant velocity that would have moved the positions as far, under `rk4` and `midpoint`.
    mean: Vec<R>,
    /// Impulses for the next step's start.
    pub warm: Vec<Warm<R>>,
    /// Which stage of `rk4` runs: after the first, rows start from the stage before.
    pub stage: usize,
    damped: damped::Damped<R>,
    stages: rk4::Stages<R>,
}

room!(Next<R>: qpos, qvel, mean, warm; damped, stages);

impl<R: Real> Next<R> {
    pub fn new(model: &Model) -> Self {
        Self {
            qpos: vec![R::zero(); model.nq],
            qvel: vec![R::zero(); model.nv],
            mean: vec![R::zero(); model.nv],
            warm: Vec::new(),
            stage: 0,
            damped: damped::Damped::new(model),
            stages: rk4::Stages::new(model),
        }
    }
}

impl<R: Real> Sim<R> {
    /// One step of the integrator, into `next`.
    pub(crate) fn integrate(&mut self) -> Result<()> {
        match self.settings.integrator {
            Integrator::Rk4 if self.settings.law.on_guess() => {
                self.rk4(false)?;
                self.rows_at_the_end()
            }
            Integrator::Rk4 => self.rk4(true),
            // A spring under the surface is a smooth force, and has no rows.
            Integrator::Midpoint if self.settings.law == Law::Penalty => self.midpoint(true),
            Integrator::Midpoint => {
                self.midpoint(false)?;
                self.rows_at_the_end()
            }
            _ => {
                self.place_detect_solve()?;
                self.tape_stage(1.0, true);
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

    /// Rows after a smooth motion from (q, v) to (q ⊕ dt·v̄, v₁), v̄ being `next.mean`.
    ///
    /// Laws on velocities judge v̄, because v̄ is what moves positions: a resting contact
    /// then rests where the law says, under every integrator. What the rows change, they
    /// change in both: q⁺ = q ⊕ dt (v̄ + Δv), v⁺ = v₁ + Δv. `solref` is a law on
    /// accelerations: it judges v₁, and its force acts through the step, v̄ + Δv/2.
    fn rows_at_the_end(&mut self) -> Result<()> {
        let model = self.model.clone();
        let dt = R::of(self.settings.dt);
        self.placed.place(&model, &self.state, &self.inputs, dt);
        let on_guess = self.settings.law.on_guess();
        let judged = if on_guess { &self.next.mean } else { &self.next.qvel };
        self.placed.metric.to_factored(judged, &mut self.placed.guess);
        self.detect_and_solve()?;
        self.tape_solve();
        // Δv from Δu, which is exactly zero in a tree without rows.
        let change = &mut self.next.damped.change;
        for k in 0..model.nv {
            change[k] = self.rows.u[k] - self.placed.guess[k];
        }
        self.placed.metric.from_factored(change, &mut self.velocity);
        // What the rows do not change keeps its bits, the sign of a zero too.
        let add = |x: &mut R, change: R| {
            let none = change.abs().le(R::zero());
            *x = R::select(none, *x, *x + change).with_slopes_of(none, || *x + change);
        };
        let rate = R::of(1.0 / self.settings.dt);
        let share = R::of(if on_guess { 1.0 } else { 0.5 });
        for k in 0..model.nv {
            add(&mut self.next.qvel[k], self.velocity[k]);
            add(&mut self.next.mean[k], share * self.velocity[k]);
            self.qacc[k] = (self.next.qvel[k] - self.state.qvel[k]) * rate;
        }
        advance(&model, &self.state.qpos, &self.next.mean, dt, &mut self.next.qpos);
        self.velocity.copy_from_slice(&self.next.qvel);
        Ok(())
    }
}
