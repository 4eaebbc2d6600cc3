//! What drives from outside, and what of a servo is a spring that stores.
//!
//! A position servo (bias₁ < 0) with its control held is a passive spring about
//! l* = (gain·ctrl + bias₀)/k, k = −bias₁, and a damper: an energy that it gains on its own
//! is none. With the bounds [lo, hi] of its force the spring yields: V = ½ k e² within them,
//! F |e| − F²/2k beyond. What the control puts in is the change of V when it moves. A
//! velocity servo is a motor of force gain·ctrl + bias₀ and a damper. Everything else is a
//! motor, and all of its work counts as put in.

use crate::model::NONE;
use crate::observer::Observer;
use crate::real::Real;
use crate::scene::Actuator;
use crate::sim::Sim;
use crate::spatial::V3;
use crate::state::Inputs;

/// What an actuator is to the account.
#[derive(Clone, Copy, PartialEq)]
enum Drive {
    Motor,
    Spring,
    Damped,
}

fn drive(actuator: &Actuator) -> Drive {
    let [_, length, velocity] = actuator.bias;
    let pulls_both_ways = actuator.forcerange.is_none_or(|[lo, hi]| lo < 0.0 && hi > 0.0);
    if velocity > 0.0 || length > 0.0 || !pulls_both_ways {
        Drive::Motor
    } else if length < 0.0 {
        Drive::Spring
    } else if velocity < 0.0 {
        Drive::Damped
    } else {
        Drive::Motor
    }
}

/// gain·ctrl + bias₀, the control within its bounds.
fn asked<R: Real>(actuator: &Actuator, clamps: bool, ctrl: R) -> R {
    let ctrl = match actuator.ctrlrange {
        Some([lo, hi]) if clamps => ctrl.clamp(R::of(lo), R::of(hi)),
        _ => ctrl,
    };
    R::of(actuator.gain) * ctrl + R::of(actuator.bias[0])
}

/// Work of motors and applied forces [J], by lane.
pub(super) struct Work<R: Real> {
    pub done: R,
    /// Something can do work at all.
    pub counts: bool,
}

impl<R: Real> Default for Work<R> {
    fn default() -> Self {
        Self { done: R::zero(), counts: false }
    }
}

impl<R: Real> Observer<R> for Work<R> {
    fn committing(&mut self, sim: &Sim<R>) {
        if self.counts {
            self.done += sim.driven();
        }
    }
}

impl<R: Real> Sim<R> {
    /// What a position servo stores at the present positions [J]; 0 of other actuators.
    pub(in crate::watch) fn stored_in_servo(&self, index: usize, ctrl: R) -> R {
        let actuator = &self.model.actuators[index];
        if drive(actuator) != Drive::Spring {
            return R::zero();
        }
        let (k, half) = (R::of(-actuator.bias[1]), R::of(0.5));
        let joint = &self.model.joints[actuator.joint];
        let length = R::of(actuator.gear[0]) * self.state.qpos[joint.qpos];
        let force = asked(actuator, self.model.features.clampctrl, ctrl) - k * length;
        let within = half * force * force / k;
        let Some([lo, hi]) = actuator.forcerange else { return within };
        let beyond = |bound: f64| R::of(bound) * (force - half * R::of(bound)) / k;
        let high = R::select(force.gt(R::of(hi)), beyond(hi), within);
        R::select(force.lt(R::of(lo)), beyond(lo), high)
    }

    /// What all servos store.
    pub(super) fn stored_in_servos(&self, inputs: &Inputs<R>) -> R {
        let mut sum = R::zero();
        if self.model.features.actuation {
            for index in 0..self.model.actuators.len() {
                sum += self.stored_in_servo(index, inputs.ctrl[index]);
            }
        }
        sum
    }

    /// Work of motors and applied forces in the step from `state` to `next`: what they did on
    /// the mean of both velocities.
    fn driven(&self) -> R {
        let model = &*self.model;
        let (half, dt) = (R::of(0.5), self.clock.dt);
        let mean = |k: usize| half * (self.state.qvel[k] + self.next.qvel[k]);
        let mut power = R::zero();
        for (index, actuator) in model.actuators.iter().enumerate() {
            let joint = &model.joints[actuator.joint];
            let force = match drive(actuator) {
                _ if !model.features.actuation => continue,
                Drive::Spring => continue,
                Drive::Motor => self.placed.actuator[index],
                Drive::Damped => {
                    let clamps = model.features.clampctrl;
                    let force = asked(actuator, clamps, self.inputs.ctrl[index]);
                    let bounds = actuator.forcerange;
                    bounds.map_or(force, |[lo, hi]| force.clamp(R::of(lo), R::of(hi)))
                }
            };
            for k in 0..joint.dofs() {
                power += force * (R::of(actuator.gear[k]) * mean(joint.dof + k));
            }
        }
        if self.inputs.applied() {
            power += self.applied_power(&mean);
        }
        dt * power
    }

    fn applied_power(&self, mean: &impl Fn(usize) -> R) -> R {
        let model = &*self.model;
        let mut power = R::zero();
        for k in 0..model.nv {
            power += self.inputs.qfrc_applied()[k] * mean(k);
        }
        for (index, body) in model.bodies.iter().enumerate().filter(|(_, b)| b.tree != NONE) {
            let given = &self.inputs.xfrc_applied()[6 * index..6 * index + 6];
            if given.iter().all(|x| x.is_zero()) {
                continue;
            }
            let force = V3::new(given[0], given[1], given[2]);
            let moment = V3::new(given[3], given[4], given[5]);
            let arm = self.centre(index) - self.placed.origin[body.tree];
            for &k in body.chain.of(&model.dof_lists) {
                let motion = &self.placed.motion[k];
                let along = force.dot(&(motion.lin + motion.ang.cross(&arm)));
                power += (along + moment.dot(&motion.ang)) * mean(k);
            }
        }
        power
    }
}
