//! Classical Runge-Kutta of fourth order, for rotations on the group: Munthe-Kaas
//! (1998), with the closed form of the inverse differential of the exponential,
//! dexp⁻¹(u) ω = ω + ½ u×ω + g u×(u×ω), g = (1 − (θ/2) cot(θ/2))/θ², θ = |u|.

use super::{advance, Next};
use crate::elements::activation;
use crate::error::Result;
use crate::integrator::{Inside, Stages};
use crate::model::Model;
use crate::observer::Observer;
use crate::real::{Mask, Real};
use crate::scene::JointType;
use crate::sim::{At, Sim};
use crate::solve::Choice;
use crate::spatial::{Quat, V3};
use crate::step::all_finite;

const A: [f64; 4] = [0.0, 0.5, 0.5, 1.0];
const B: [f64; 4] = [1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0];

impl<R: Real> Sim<R> {
    /// Run four stages from `next.start` into `next`.
    pub(super) fn rk4(&mut self, inside: Inside, observer: &mut dyn Observer<R>) -> Result<()> {
        let outcome = self.stages(inside, observer);
        self.next.stage = 0;
        outcome
    }

    /// Sets the state to the point where a step from here evaluates its forces last: under `rk4` its
    /// fourth stage, in lanes in which that is finite.
    #[inline(never)]
    pub(crate) fn go_to_last_stage(&mut self) -> Result<()> {
        if self.plan.scheme.stages != Stages::Four {
            return Ok(());
        }
        self.wake_where_off();
        self.set_dt(self.period);
        self.after_stages(Self::rk4, &mut ())?;
        let (state, trial) = (&mut self.state, &self.next.trial);
        let finite = all_finite(&trial.qpos).and(all_finite(&trial.qvel));
        let each = state.qpos.iter_mut().chain(&mut state.qvel);
        for (own, trial) in each.zip(trial.qpos.iter().chain(&trial.qvel)) {
            *own = R::select(finite, *trial, *own);
        }
        Ok(())
    }

    fn stages(&mut self, inside: Inside, observer: &mut dyn Observer<R>) -> Result<()> {
        let model = self.model.clone();
        let dt = self.clock.dt;
        let zero = R::zero();
        self.next.sums.turned.fill(zero);
        self.next.sums.moved.fill(zero);
        self.next.sums.gained.fill(zero);
        self.next.sums.act_rate.fill(zero);
        for stage in 0..4 {
            (self.next.stage, self.next.ahead) = (stage, A[stage]);
            let at = if stage == 0 { At::Start } else { At::Stage };
            if stage > 0 {
                let Next { start, sums, trial, .. } = &mut self.next;
                let reach = dt * R::of(A[stage]);
                advance(&model, &self.state.qpos, &sums.rate, reach, &mut trial.qpos);
                for k in 0..model.nv {
                    sums.turned[k] = reach * sums.rate[k];
                    trial.qvel[k] = start[k] + reach * self.qacc[k];
                }
                for (k, rate) in self.placed.act_rate.iter().enumerate() {
                    trial.act[k] = self.state.act[k] + reach * *rate;
                }
            }
            self.accelerate(at, inside, B[stage], Choice::Now)?;
            if stage == 0 {
                let (pulls, centres) = (self.placed.pulls(), &mut self.next.centres);
                activation::centres(&model, &self.state.qpos, pulls, centres);
                let [rates, fading] = self.placed.act_rates();
                self.next.sums.act_first.copy_from_slice(rates);
                self.next.sums.act_fading.copy_from_slice(fading);
            }
            observer.placed(self, at, B[stage]);
            if inside != Inside::Nothing {
                observer.solved(self, at, B[stage]);
            }
            let Next { start, trial, sums, .. } = &mut self.next;
            sums.rate.copy_from_slice(if stage == 0 { start } else { &trial.qvel });
            rates_on_the_group(&model, &sums.turned, &mut sums.rate);
            let weight = R::of(B[stage]);
            for k in 0..model.nv {
                sums.moved[k] += weight * sums.rate[k];
                sums.gained[k] += weight * self.qacc[k];
            }
            for (sum, rate) in sums.act_rate.iter_mut().zip(&self.placed.act_rate) {
                *sum += weight * *rate;
            }
        }
        let sums = &mut self.next.sums;
        activation::hold_bristles(&model, &sums.act_first, &mut sums.act_rate);
        self.next.mean.copy_from_slice(&sums.moved);
        advance(&model, &self.state.qpos, &sums.moved, dt, &mut self.next.qpos);
        let seconds = self.clock.seconds;
        let rates = [&sums.act_rate[..], &sums.act_fading];
        activation::advance(&model, &self.state.act, rates, seconds, &mut self.next.act);
        activation::unwind(&model, &self.next.centres, &mut self.next.act);
        for k in 0..model.nv {
            self.next.qvel[k] = self.next.start[k] + dt * sums.gained[k];
        }
        self.velocity.copy_from_slice(&self.next.qvel);
        Ok(())
    }
}

/// Converts angular rates of balls and free joints to rates of the rotation vector `turned`.
fn rates_on_the_group<R: Real>(model: &Model<R::Value>, turned: &[R], rate: &mut [R]) {
    for joint in &model.joints {
        let first = match joint.kind {
            JointType::Ball => joint.dof,
            JointType::Free => joint.dof + 3,
            _ => continue,
        };
        let vector = |x: &[R]| V3::new(x[first], x[first + 1], x[first + 2]);
        let rotation = Quat::exp(&vector(turned)).log();
        let new = dexp_inverse(&rotation, &vector(rate));
        rate[first..first + 3].copy_from_slice(new.as_slice());
    }
}

fn dexp_inverse<R: Real>(u: &V3<R>, w: &V3<R>) -> V3<R> {
    let half = R::of(0.5);
    let square = u.dot(u);
    let angle = square.sqrt();
    // Below this angle the series is exact to rounding: 1/12 + θ²/720.
    let small = square.lt(R::of(1e-4));
    let (sin, cos) = (half * angle).sin_cos();
    let one = R::one();
    let safe = R::select(small, one, sin);
    let closed = (one - half * angle * cos / safe) / R::select(small, one, square);
    let series = R::of(1.0 / 12.0) + square * (R::of(1.0 / 720.0) + square * R::of(1.0 / 30240.0));
    let g = R::select(small, series, closed);
    let first = u.cross(w);
    let second = u.cross(&first);
    V3::new(
        w.x + half * first.x + g * second.x,
        w.y + half * first.y + g * second.y,
        w.z + half * first.z + g * second.z,
    )
}
