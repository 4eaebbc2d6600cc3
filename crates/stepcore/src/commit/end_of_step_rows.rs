//! Rows after a smooth motion from (q, v) to (q ⊕ dt·v̄, v₁), with v̄ = `next.mean`.
//!
//! Laws on velocities apply to v̄, because v̄ moves positions: q⁺ = q ⊕ dt (v̄ + Δ₁). A force that
//! lasts through the step, such as a resting contact, changes the last velocity by twice as much as
//! the mean; an impact at its start, by as much. So both get Δ₁, and a second solve of the same
//! rows adds the rest to the last velocity alone: v⁺ = v₁ + Δ₁ + Δ₂. A body at rest stays at rest,
//! v⁺ = 0; a sliding one loses μ g dt, and μ g dt²/2 of its path. Rows that do not act on the mean
//! do not act on the last velocity.
//!
//! An impact is at the start of the step, before the smooth motion. A row that bounces requires v̄
//! to be −e·v_n + J (v̄ − v), and v⁺ to be −e·v_n + J (v₁ − v): with e = 1 a bounce conserves
//! energy, to rounding.
//!
//! `solref` is a law on accelerations: it applies to v₁, and its force acts through the step, v̄ + Δ/2.

use super::advance;
use crate::clock::Clock;
use crate::elements::Role;
use crate::error::Result;
use crate::integrator::Inside;
use crate::observer::Observer;
use crate::real::{Mask, Real, Stage};
use crate::settings::Law;
use crate::sim::{At, Sim};
use crate::solve::Part;

impl<R: Real> Sim<R> {
    pub(super) fn rows_at_the_end(&mut self, observer: &mut dyn Observer<R>) -> Result<()> {
        let model = self.model.clone();
        let Clock { dt, rate, .. } = self.clock;
        let (qpos, qvel) = At::Start.of(&self.state, &self.next);
        let act = self.state.activations(self.clock);
        self.placed.place(&model, qpos, qvel, act, &self.inputs, dt);
        let on_guess = self.settings.law.on_guess();
        let judged = if on_guess { &self.next.mean } else { &self.next.qvel };
        self.placed.metric.to_factored(judged, &mut self.placed.guess);
        self.detect(At::Start)?;
        if self.model.adheres {
            self.adhere(dt);
        }
        self.make_rows(At::Start, Part::End);
        if !self.rows.pushes.is_empty() {
            self.changed();
            self.add_change(1.0, 0.5);
            self.take_pushes();
        }
        R::enter(Stage::Impulses);
        // Equalities that the stages held respond only to other rows.
        let answers = self.plan.inside == Inside::Equalities;
        let alone = self.rows.blocks.iter().all(|block| answers && block.role == Role::Equality);
        if alone || !self.rows.any() {
            self.effort.rest();
            self.velocity.fill(R::zero());
        } else {
            self.warm_start(answers);
            self.rows.begin_first();
            self.solve()?;
            observer.solved(self, At::Start, 1.0);
            self.changed();
        }
        self.add_change(1.0, if on_guess { 1.0 } else { 0.5 });
        if on_guess && !alone && self.rows.any() {
            self.second(answers, observer)?;
        }
        for (row, held) in self.rows.rows.iter_mut().zip(&self.next.held) {
            row.beside += *held;
        }
        if self.plan.keeps {
            self.rows.store_warm(&mut self.next.warm, answers);
        }
        R::enter(Stage::Commit);
        for k in 0..model.nv {
            self.qacc[k] = (self.next.qvel[k] - self.state.qvel[k]) * rate;
        }
        advance(&model, &self.state.qpos, &self.next.mean, dt, &mut self.next.qpos);
        self.velocity.copy_from_slice(&self.next.qvel);
        Ok(())
    }

    /// Adds adhesion through the step: the last velocity changes by twice as much as the mean.
    fn adhere(&mut self, dt: R) {
        let model = self.model.clone();
        self.next.change.copy_from_slice(&self.placed.force);
        let at = At::Start.of(&self.state, &self.next);
        let act = self.state.activations(self.clock);
        self.placed.place_adhesion(&model, at, act, &self.inputs, &self.detected.contacts);
        for k in 0..model.nv {
            self.next.change[k] = dt * (self.placed.force[k] - self.next.change[k]);
        }
        self.placed.metric.solve(&mut self.next.change);
        for k in 0..model.nv {
            self.next.qvel[k] += self.next.change[k];
            self.next.mean[k] += R::of(0.5) * self.next.change[k];
        }
        let judged = if self.settings.law.on_guess() { &self.next.mean } else { &self.next.qvel };
        self.placed.metric.to_factored(judged, &mut self.placed.guess);
    }

    /// Sets `velocity` to the rows' change since the guess: exactly zero in a tree without rows.
    fn changed(&mut self) {
        let change = &mut self.next.change;
        for k in 0..self.model.nv {
            change[k] = self.rows.u[k] - self.placed.guess[k];
        }
        self.placed.metric.from_factored(change, &mut self.velocity);
    }

    /// Adds multiples of `velocity` to the last velocity and to the mean.
    fn add_change(&mut self, last: f64, mean: f64) {
        // Velocities that the rows do not change keep their bits, even the sign of a zero.
        let add = |x: &mut R, change: R| {
            let none = change.abs().le(R::zero());
            *x = R::select(none, *x, *x + change).with_slopes_of(none, || *x + change);
        };
        for k in 0..self.model.nv {
            add(&mut self.next.qvel[k], R::of(last) * self.velocity[k]);
            if mean > 0.0 {
                add(&mut self.next.mean[k], R::of(mean) * self.velocity[k]);
            }
        }
    }

    /// The second solve: adds the rest to the last velocity.
    fn second(&mut self, answers: bool, observer: &mut dyn Observer<R>) -> Result<()> {
        let nv = self.model.nv;
        // v₁ − v̄, unaffected by the first solve.
        for k in 0..nv {
            self.next.change[k] = self.next.qvel[k] - self.next.mean[k];
        }
        self.placed.metric.to_factored(&self.next.change, &mut self.next.gained);
        self.placed.metric.to_factored(&self.next.qvel, &mut self.placed.guess);
        let lists = self.detected.dof_lists(&self.model);
        self.rows.begin_second(lists, &self.placed.metric.inv_d, &self.placed.guess);
        self.targets_of_the_second(answers);
        R::enter(Stage::Impulses);
        self.solve()?;
        observer.solved(self, At::Start, 1.0);
        self.changed();
        self.add_change(1.0, 0.0);
        self.rows.end_second();
        Ok(())
    }

    fn targets_of_the_second(&mut self, answers: bool) {
        let (settings, rows) = (&self.settings, &mut self.rows);
        let lists = self.detected.dof_lists(&self.model);
        let bounces = settings.law == Law::Rigid && settings.restitution > 0.0;
        let (push, slop) = (R::of(-settings.beta / settings.dt), R::of(settings.slop));
        for b in 0..rows.blocks.len() {
            let (role, first) = (rows.blocks[b].role, rows.blocks[b].rows.start);
            if answers && role == Role::Equality {
                for at in rows.blocks[b].rows.range() {
                    rows.rows[at].t = rows.dot(lists, &rows.rows[at], &self.placed.guess);
                }
                continue;
            }
            let pushes = matches!(role, Role::Contact | Role::Limit);
            if pushes {
                let gave = rows.first_impulse(first).gt(R::zero());
                rows.blocks[b].mask = rows.blocks[b].mask.and(gave);
            }
            if pushes && bounces && role == Role::Contact {
                let gained = rows.dot(lists, &rows.rows[first], &self.next.gained);
                let row = &mut rows.rows[first];
                let hold = (push * (row.gap + slop).min(R::zero())).min(row.t);
                row.t = hold.max(row.t + gained);
            }
            let holds = if pushes { first..first + 1 } else { rows.blocks[b].rows.range() };
            for at in holds {
                rows.soften_second(at);
            }
        }
    }
}
