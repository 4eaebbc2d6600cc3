//! One step of an integrator, into `Next`.

use super::advance;
use super::damped::Solved;
use crate::clock::Clock;
use crate::elements::force::Moment;
use crate::error::Result;
use crate::observer::Observer;
use crate::real::Real;
use crate::settings::{Integrator, Law};
use crate::sim::{At, Sim};

impl<R: Real> Sim<R> {
    /// One step of the integrator, into `next`.
    pub(crate) fn integrate<O: Observer<R>>(&mut self, observer: &mut O) -> Result<()> {
        match self.settings.integrator {
            Integrator::Rk4 if self.settings.law.on_guess() => {
                self.rk4(false, observer)?;
                self.rows_at_the_end(observer)
            }
            Integrator::Rk4 => self.rk4(true, observer),
            // A spring under the surface is a smooth force, and has no rows.
            Integrator::Midpoint if self.settings.law == Law::Penalty => {
                self.midpoint(true, observer)
            }
            Integrator::Midpoint => {
                self.midpoint(false, observer)?;
                self.rows_at_the_end(observer)
            }
            _ => {
                self.place_detect_solve(At::State)?;
                observer.placed(self, At::State, 1.0);
                observer.solved(self, At::State, 1.0);
                self.commit();
                Ok(())
            }
        }
    }

    /// From u⁺ to the next state, for integrators of one stage.
    fn commit(&mut self) {
        self.next.qvel.copy_from_slice(&self.velocity);
        match self.settings.integrator {
            Integrator::Euler if self.model.features.eulerdamp => self.damp(false),
            Integrator::ImplicitFast => self.damp(true),
            _ => {}
        }
        let moving = match self.settings.integrator {
            Integrator::Explicit => &self.state.qvel,
            _ => &self.next.qvel,
        };
        advance(&self.model, &self.state.qpos, moving, self.clock.dt, &mut self.next.qpos);
    }

    /// Damping implicitly: see `damped.rs`.
    fn damp(&mut self, fast: bool) {
        let now = Moment {
            model: &self.model,
            frames: self.placed.frames(),
            qpos: &self.state.qpos,
            qvel: &self.state.qvel,
            inputs: &self.inputs,
        };
        let (placed, u) = (&self.placed, &self.rows.u);
        let solved = Solved { now, placed, u, dt: self.clock.dt };
        self.next.damped.damp(&solved, fast, &mut self.next.qvel);
    }

    /// Rows after a smooth motion from (q, v) to (q ⊕ dt·v̄, v₁), v̄ being `next.mean`.
    ///
    /// Laws on velocities judge v̄, because v̄ is what moves positions: a resting contact
    /// then rests where the law says, under every integrator. What the rows change, they
    /// change in both: q⁺ = q ⊕ dt (v̄ + Δv), v⁺ = v₁ + Δv. `solref` is a law on
    /// accelerations: it judges v₁, and its force acts through the step, v̄ + Δv/2.
    fn rows_at_the_end<O: Observer<R>>(&mut self, observer: &mut O) -> Result<()> {
        let model = self.model.clone();
        let Clock { dt, rate, .. } = self.clock;
        let (qpos, qvel) = At::State.of(&self.state, &self.next);
        self.placed.place(&model, qpos, qvel, &self.inputs, dt);
        let on_guess = self.settings.law.on_guess();
        let judged = if on_guess { &self.next.mean } else { &self.next.qvel };
        self.placed.metric.to_factored(judged, &mut self.placed.guess);
        self.detect_and_solve(At::State)?;
        observer.solved(self, At::State, 1.0);
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
