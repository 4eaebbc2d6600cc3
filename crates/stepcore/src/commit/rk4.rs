//! Classical Runge-Kutta of fourth order, for rotations on the group: Munthe-Kaas
//! (1998), with the closed form of the inverse differential of the exponential,
//! dexp⁻¹(u) ω = ω + ½ u×ω + g u×(u×ω), g = (1 − (θ/2) cot(θ/2))/θ², θ = |u|.

use super::advance;
use crate::error::Result;
use crate::model::Model;
use crate::real::Real;
use crate::room::room;
use crate::scene::JointType;
use crate::sim::Sim;
use crate::spatial::{Quat, V3};

const A: [f64; 4] = [0.0, 0.5, 0.5, 1.0];
const B: [f64; 4] = [1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0];

/// Where the step started, and the weighted sums of its stages.
pub struct Stages<R: Real> {
    pub(super) qpos: Vec<R>,
    pub(super) qvel: Vec<R>,
    rate: Vec<R>,
    /// The rotation vector by which this stage is away from the start.
    turned: Vec<R>,
    moved: Vec<R>,
    gained: Vec<R>,
}

room!(Stages<R>: qpos, qvel, rate, turned, moved, gained;);

impl<R: Real> Stages<R> {
    pub fn new(model: &Model) -> Self {
        let zeros = |n| vec![R::zero(); n];
        Self {
            qpos: zeros(model.nq),
            qvel: zeros(model.nv),
            rate: zeros(model.nv),
            turned: zeros(model.nv),
            moved: zeros(model.nv),
            gained: zeros(model.nv),
        }
    }
}

impl<R: Real> Sim<R> {
    /// Four stages into `next`; `rows`: each with its rows, else the smooth motion alone.
    pub(super) fn rk4(&mut self, rows: bool) -> Result<()> {
        self.next.stages.qpos.copy_from_slice(&self.state.qpos);
        self.next.stages.qvel.copy_from_slice(&self.state.qvel);
        let outcome = self.stages(rows);
        self.next.stage = 0;
        // The stages ran on the state itself; it goes back whatever happened.
        self.state.qpos.copy_from_slice(&self.next.stages.qpos);
        self.state.qvel.copy_from_slice(&self.next.stages.qvel);
        outcome
    }

    fn stages(&mut self, rows: bool) -> Result<()> {
        let model = self.model.clone();
        let dt = R::of(self.settings.dt);
        let zero = R::zero();
        self.next.stages.turned.fill(zero);
        self.next.stages.moved.fill(zero);
        self.next.stages.gained.fill(zero);
        for stage in 0..4 {
            self.next.stage = stage;
            let s = &mut self.next.stages;
            if stage > 0 {
                let reach = dt * R::of(A[stage]);
                advance(&model, &s.qpos, &s.rate, reach, &mut self.state.qpos);
                for k in 0..model.nv {
                    s.turned[k] = reach * s.rate[k];
                    self.state.qvel[k] = s.qvel[k] + reach * self.qacc[k];
                }
            }
            if rows {
                self.place_detect_solve()?;
            } else {
                self.smooth();
            }
            self.tape_stage(B[stage], rows);
            let s = &mut self.next.stages;
            s.rate.copy_from_slice(&self.state.qvel);
            rates_on_the_group(&model, &s.turned, &mut s.rate);
            let weight = R::of(B[stage]);
            for k in 0..model.nv {
                s.moved[k] += weight * s.rate[k];
                s.gained[k] += weight * self.qacc[k];
            }
        }
        let s = &self.next.stages;
        self.next.mean.copy_from_slice(&s.moved);
        advance(&model, &s.qpos, &s.moved, dt, &mut self.next.qpos);
        for k in 0..model.nv {
            self.next.qvel[k] = s.qvel[k] + dt * s.gained[k];
        }
        self.velocity.copy_from_slice(&self.next.qvel);
        Ok(())
    }
}

/// Angular rates of balls and free joints become rates of the rotation vector `turned`.
fn rates_on_the_group<R: Real>(model: &Model, turned: &[R], rate: &mut [R]) {
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
