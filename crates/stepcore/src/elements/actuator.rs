//! Motors and servos: a force gain·ctrl + bias₀ + bias₁·length + bias₂·velocity along a
//! transmission, control and force within their bounds.
//!
//! What of it drives from outside, and what is a spring that stores: a position servo
//! (bias₁ < 0) with its control held is a passive spring about l* = (gain·ctrl + bias₀)/k,
//! k = −bias₁, and a damper: an energy that it gains on its own is none. With the bounds
//! [lo, hi] of its force the spring yields: V = ½ k e² within them, F |e| − F²/2k beyond. What
//! the control puts in is the change of V when it moves. A velocity servo is a motor of force
//! gain·ctrl + bias₀ and a damper. Everything else is a motor, and all of its work counts as
//! put in.

use super::activation::{signal, Activations};
use super::force::{Forces, Group, Moment};
use super::Kind;
use crate::model::Model;
use crate::place::Pulls;
use crate::real::{Mask, Real};
use crate::scene;
use crate::state::Inputs;
use crate::transmission::Transmission;

pub(super) struct Actuator;

impl scene::Actuator {
    /// Along what it pulls.
    pub(crate) fn transmission(&self) -> Transmission {
        Transmission::Geared(self.joint, self.gear)
    }

    /// A control within its bounds, where these are obeyed.
    #[inline(always)]
    pub(super) fn held<R: Real>(&self, model: &Model, ctrl: R) -> R {
        match self.ctrlrange {
            Some([lo, hi]) if model.features.clampctrl => ctrl.clamp(R::of(lo), R::of(hi)),
            _ => ctrl,
        }
    }

    fn bounded<R: Real>(&self, force: R) -> R {
        self.forcerange.map_or(force, |[lo, hi]| force.clamp(R::of(lo), R::of(hi)))
    }

    fn drive(&self) -> Drive {
        let [_, length, velocity] = self.bias;
        let pulls_both_ways = self.forcerange.is_none_or(|[lo, hi]| lo < 0.0 && hi > 0.0);
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
}

/// What an actuator is to an account of energy.
#[derive(Clone, Copy, PartialEq)]
enum Drive {
    Motor,
    Spring,
    Damped,
}

/// gain·u, u the control within its bounds or the activation.
#[inline(always)]
fn asked<R: Real>(model: &Model, index: usize, act: Activations<R>, ctrl: R) -> R {
    let actuator = &model.actuators[index];
    R::of(actuator.gain) * signal(model, index, act, || actuator.held(model, ctrl))
}

/// The force of every actuator before its gear, by actuator.
pub(crate) fn tensions<R: Real>(
    model: &Model,
    qpos: &[R],
    qvel: &[R],
    act: Activations<R>,
    inputs: &Inputs<R>,
    pulls: Pulls<R>,
    tensions: &mut [R],
) {
    if !model.features.actuation {
        return;
    }
    for (index, actuator) in model.actuators.iter().enumerate() {
        let mut force = asked(model, index, act, inputs.ctrl[index]);
        if actuator.bias != [0.0; 3] {
            force += bias(model, actuator, qpos, qvel, pulls);
        }
        tensions[index] = actuator.bounded(force);
    }
}

/// What the force has beside the control: bias₀ + bias₁·length + bias₂·velocity.
fn bias<R: Real>(
    model: &Model,
    actuator: &scene::Actuator,
    qpos: &[R],
    qvel: &[R],
    pulls: Pulls<R>,
) -> R {
    let [constant, length, velocity] = actuator.bias.map(R::of);
    if !actuator.feeds_back() {
        return constant;
    }
    let along = actuator.transmission();
    let (at, rate) = (along.length(model, qpos, pulls), along.velocity(model, qvel, pulls));
    constant + length * at + velocity * rate
}

/// What a position servo stores under a control [J]; 0 of other actuators.
pub(crate) fn stored_under<R: Real>(
    model: &Model,
    index: usize,
    qpos: &[R],
    pulls: Pulls<R>,
    act: Activations<R>,
    ctrl: R,
) -> R {
    let actuator = &model.actuators[index];
    if !model.features.actuation || actuator.drive() != Drive::Spring {
        return R::zero();
    }
    let (k, half) = (R::of(-actuator.bias[1]), R::of(0.5));
    let length = actuator.transmission().length(model, qpos, pulls);
    let force = asked(model, index, act, ctrl) + R::of(actuator.bias[0]) - k * length;
    let within = half * force * force / k;
    let Some([lo, hi]) = actuator.forcerange else { return within };
    let beyond = |bound: f64| R::of(bound) * (force - half * R::of(bound)) / k;
    let high = R::select(force.gt(R::of(hi)), beyond(hi), within);
    R::select(force.lt(R::of(lo)), beyond(lo), high)
}

impl Model {
    /// Servos whose force is bounded. Where it reaches its bound they do not damp, and swing about
    /// their target with all the energy that the bound gives.
    pub(crate) fn bounded_servos(&self) -> impl Iterator<Item = usize> + '_ {
        let bounded = |a: &scene::Actuator| a.feeds_back() && a.forcerange.is_some();
        let all = self.actuators.iter().enumerate();
        all.filter(move |(_, actuator)| bounded(actuator)).map(|(index, _)| index)
    }
}

/// The force of a servo is at its bound.
pub(crate) fn saturated<R: Real>(now: &Moment<R>, index: usize) -> R::Mask {
    let tension = now.frames.tension[index];
    let range = now.model.actuators[index].forcerange;
    range.map_or(R::Mask::of(false), |[lo, hi]| tension.le(R::of(lo)).or(R::of(hi).le(tension)))
}

/// What a servo may put in beyond its `power`, for all of its force to count as driving [W].
pub(crate) fn power_beyond<R: Real>(
    now: &Moment<R>,
    index: usize,
    velocity: &impl Fn(usize) -> R,
) -> R {
    let (mut usual, mut whole) = (R::zero(), R::zero());
    Actuator::power(now, index, velocity, &mut |part| usual += part);
    let tension = now.frames.tension[index];
    let along = now.model.actuators[index].transmission();
    let pulls = now.frames.pulls;
    along.arms(now.model, now.qpos, pulls, |dof, arm: R| whole += tension * (arm * velocity(dof)));
    whole.max(R::zero()) + (-usual).max(R::zero())
}

impl Forces for Actuator {
    const KIND: Kind = Kind::Actuator;
    const GROUP: Group = Group::Driven;

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(usize, R)) {
        if now.model.features.actuation {
            let tension = now.frames.tension[index];
            let along = now.model.actuators[index].transmission();
            along
                .arms(now.model, now.qpos, now.frames.pulls, |dof, arm: R| add(dof, arm * tension));
        }
    }

    /// Zero at the bounds of `forcerange`, as in MuJoCo.
    #[inline(always)]
    fn slopes<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(usize, usize, [R; 2])) {
        let actuator = &now.model.actuators[index];
        if !(now.model.features.actuation && actuator.feeds_back()) {
            return;
        }
        actuator.transmission().pairs(now.model, now.qpos, now.frames.pulls, |i, j, product: R| {
            let slopes = [1, 2].map(|n| -(product * R::of(actuator.bias[n])));
            let Some([lo, hi]) = actuator.forcerange else { return add(i, j, slopes) };
            let force = now.frames.tension[index];
            let free = force.gt(R::of(lo)).and(force.lt(R::of(hi)));
            add(i, j, slopes.map(|slope| R::select(free, slope, R::zero())));
        });
    }

    #[inline(always)]
    fn sloped(model: &Model, index: usize, each: &mut impl FnMut(usize)) {
        let actuator = &model.actuators[index];
        if model.features.actuation && actuator.feeds_back() {
            let dofs = actuator.transmission().dofs(model);
            dofs.of(&model.dof_lists).iter().for_each(|dof| each(*dof));
        }
    }

    #[inline(always)]
    fn damps(model: &Model, index: usize) -> bool {
        model.features.actuation && model.actuators[index].bias[2] != 0.0
    }

    fn stored<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(R)) {
        let (ctrl, pulls) = (now.inputs.ctrl[index], now.frames.pulls);
        add(stored_under(now.model, index, now.qpos, pulls, now.act, ctrl));
    }

    fn power<R: Real>(
        now: &Moment<R>,
        index: usize,
        velocity: &impl Fn(usize) -> R,
        add: &mut impl FnMut(R),
    ) {
        let (model, actuator) = (now.model, &now.model.actuators[index]);
        let force = match actuator.drive() {
            _ if !model.features.actuation => return,
            Drive::Spring => return,
            Drive::Motor => now.frames.tension[index],
            Drive::Damped => {
                let asked = asked(model, index, now.act, now.inputs.ctrl[index]);
                actuator.bounded(asked + R::of(actuator.bias[0]))
            }
        };
        let mut work = |dof, arm: R| add(force * (arm * velocity(dof)));
        actuator.transmission().arms(model, now.qpos, now.frames.pulls, &mut work);
    }
}
