//! Motors, servos and muscles: a force gain·u + bias along a transmission, u the control or the
//! activation, everything within its bounds. Gain and bias are g₀ + g₁·length + g₂·velocity each, or a
//! muscle's.
//!
//! Drives, and springs that store energy: a position servo (bias₁ < 0) with constant control is a
//! passive spring about l* = (gain·u + bias₀)/k, k = −bias₁, and a damper, so it puts no energy in.
//! With the bounds [lo, hi] of its force the spring yields: V = ½ k e² within them, F |e| − F²/2k
//! beyond. The control puts in the change of V when it moves, and so does an activation. A velocity
//! servo is a motor of force gain·u + bias₀ and a damper. Everything else is a motor, and all of its
//! work counts as put in, as does all the work of a controller (`controller.rs`).

use super::activation::signal;
use super::controller::work;
use super::delay::{nearest, Activations};
use super::force::{Forces, Group, Moment};
use super::gravcomp::asked_of_drives;
use super::orientation::turn;
use super::Kind;
use crate::model::transmission::Pulls;
use crate::model::Model;
use crate::plan::acting::{Acts, ActuatorAt, Drive, Why};
use crate::real::array::map;
use crate::real::{value, Constant, Mask, Real, Value, ROUNDED};
use crate::scene::{self, Target};
use crate::state::Inputs;

pub(super) struct Actuator;

/// Part of a bound, MuJoCo's: tensions that a tendon's bound has scaled equal it except for rounding.
const AT_BOUND: f64 = 1e-10;

impl<N: Constant> scene::Actuator<N> {
    /// Returns a control within its bounds, if these are obeyed.
    #[inline(always)]
    pub(crate) fn held<R: Real<Value = N>>(&self, model: &Model<N>, ctrl: R) -> R
    where
        N: Value<R>,
    {
        match &self.ctrlrange {
            Some([lo, hi]) if model.features.clampctrl => ctrl.clamp(lo.get(), hi.get()),
            _ => ctrl,
        }
    }
}

/// Returns the data of an actuator that steps need.
pub(crate) fn drive(model: &Model, own: &scene::Actuator) -> ActuatorAt {
    let gain_varies = own.gain[1] != 0.0 || own.gain[2] != 0.0 || own.muscle_gain.is_some();
    let elsewhere = own.controller.is_some() || own.orientation.is_some();
    let both_ways = own.forcerange.is_none_or(|[lo, hi]| lo < 0.0 && hi > 0.0);
    let plain = !gain_varies && own.muscle_bias.is_none() && !elsewhere && both_ways;
    let [_, length, velocity] = own.bias;
    ActuatorAt {
        drive: match plain && length <= 0.0 && velocity <= 0.0 {
            true if length < 0.0 => Drive::Spring,
            true if velocity < 0.0 => Drive::Damped,
            _ => Drive::Motor,
        },
        feeds_back: own.feeds_back(),
        gain_varies,
        biased: own.bias != [0.0; 3] || own.muscle_bias.is_some(),
        elsewhere,
        ctrlrange: own.ctrlrange.filter(|_| model.features.clampctrl),
        // A motor's bounds limit its current, and its controller keeps them. The bounds of a servo of
        // orientations limit the length of its torque.
        bounds: own.forcerange.filter(|_| !own.drives_motor() && own.orientation.is_none()),
    }
}

fn within<R: Real>(x: R, bounds: &Option<[R::Value; 2]>) -> R {
    bounds.as_ref().map_or(x, |[lo, hi]| x.clamp(lo.get(), hi.get()))
}

/// The length that an actuator reads and its rate; zeros where nothing depends on them.
#[derive(Clone, Copy)]
struct Along<R: Real> {
    length: R,
    velocity: R,
}

impl<R: Real> Along<R> {
    #[inline(always)]
    fn of(model: &Model<R::Value>, index: usize, qpos: &[R], qvel: &[R], pulls: Pulls<R>) -> Self {
        if !model.drives[index].feeds_back {
            return Self { length: R::zero(), velocity: R::zero() };
        }
        let along = model.along[index];
        Self {
            length: along.length(model, qpos, pulls),
            velocity: along.velocity(model, qpos, qvel, pulls),
        }
    }
}

/// Returns the effective control: within its bounds, or the activation; for a servo on a circle the
/// nearest equivalent one.
#[inline(always)]
fn input<R: Real>(
    model: &Model<R::Value>,
    index: usize,
    act: Activations<R>,
    ctrl: R,
    length: R,
) -> R {
    let u = signal(model, index, act, || within(ctrl, &model.drives[index].ctrlrange));
    nearest(u, length, model.circles[index])
}

/// gain·u.
#[inline(always)]
fn asked<R: Real>(model: &Model<R::Value>, index: usize, at: Along<R>, u: R) -> R {
    let actuator = &model.actuators[index];
    if let Some(muscle) = &actuator.muscle_gain {
        return muscle.gain(at.length, at.velocity, value::get(&actuator.lengthrange))[0] * u;
    }
    let [constant, length, velocity] = value::get(&actuator.gain);
    if !model.drives[index].gain_varies {
        return constant * u;
    }
    (constant + length * at.length + velocity * at.velocity) * u
}

/// Returns the rest of the force, without gain·u.
#[inline(always)]
fn bias<R: Real>(actuator: &scene::Actuator<R::Value>, at: Along<R>) -> R {
    if let Some(muscle) = &actuator.muscle_bias {
        return muscle.bias(at.length, value::get(&actuator.lengthrange));
    }
    let [constant, length, velocity] = value::get(&actuator.bias);
    if actuator.bias[1].vanishes() && actuator.bias[2].vanishes() {
        return constant;
    }
    constant + length * at.length + velocity * at.velocity
}

/// Computes the force of every actuator before its gear and its bounds, by actuator.
pub(crate) fn tensions<R: Real>(
    model: &Model<R::Value>,
    qpos: &[R],
    qvel: &[R],
    act: Activations<R>,
    inputs: &Inputs<R>,
    pulls: Pulls<R>,
    tensions: &mut [R],
) {
    for &Acts { index, .. } in &model.acting.actuator {
        let own = &model.drives[index];
        if own.elsewhere {
            let at = (qpos, qvel);
            if let Some(work) = work(model, index, at, act, inputs, pulls) {
                let motor = model.actuators[index].drives_motor();
                let bounded = motor && on_bounded_tendon(model, index);
                tensions[index] = if bounded { work.driven } else { work.force };
            } else if let Some(turn) = turn(model, index, at, act, inputs) {
                tensions[index] = turn.force;
            }
            continue;
        }
        let at = Along::of(model, index, qpos, qvel, pulls);
        let u = input(model, index, act, act.ctrl(model, index, inputs), at.length);
        let mut force = asked(model, index, at, u);
        if own.biased {
            force += bias(&model.actuators[index], at);
        }
        tensions[index] = force;
    }
}

/// Bounds every force by its actuator's range; the bounds of tendons come first.
pub(crate) fn bound<R: Real>(model: &Model<R::Value>, tensions: &mut [R]) {
    for &Acts { index, .. } in &model.acting.actuator {
        tensions[index] = within(tensions[index], &model.drives[index].bounds);
    }
}

/// Checks that an actuator pulls at a tendon that bounds the sum of its actuators.
fn on_bounded_tendon<N: Constant>(model: &Model<N>, index: usize) -> bool {
    let bounds = |tendon: usize| model.tendons[tendon].actuatorfrcrange.is_some();
    matches!(model.actuators[index].target, Target::Tendon(tendon) if bounds(tendon))
}

/// Motors at tendons that bound the force of their currents.
fn bounded_motors<N: Constant>(model: &Model<N>) -> impl Iterator<Item = usize> + '_ {
    let runs = |actuator: &scene::Actuator<N>| {
        model.features.actuation && actuator.enabled && actuator.drives_motor()
    };
    let motors = model.actuators.iter().enumerate().filter(move |(_, actuator)| runs(actuator));
    motors.map(|(index, _)| index).filter(|index| on_bounded_tendon(model, *index))
}

/// Bounds the motors' current forces by each motor's range, which comes after the tendon's.
pub(crate) fn bound_motors<R: Real>(model: &Model<R::Value>, tensions: &mut [R]) {
    for index in bounded_motors(model) {
        if let Some([lo, hi]) = &model.actuators[index].forcerange {
            tensions[index] = tensions[index].clamp(lo.get(), hi.get());
        }
    }
}

/// Adds the motors' cogging and friction, which no bound limits.
pub(crate) fn finish_motors<R: Real>(
    model: &Model<R::Value>,
    at: (&[R], &[R]),
    act: Activations<R>,
    inputs: &Inputs<R>,
    pulls: Pulls<R>,
    tensions: &mut [R],
) {
    for index in bounded_motors(model) {
        if let Some(work) = work(model, index, at, act, inputs, pulls) {
            tensions[index] += work.beside;
        }
    }
}

/// The actuators of a tendon.
fn on_tendon<N: Constant>(model: &Model<N>, tendon: usize) -> impl Iterator<Item = usize> + '_ {
    let pulls = move |index: &usize| model.actuators[*index].target == Target::Tendon(tendon);
    (0..model.actuators.len()).filter(pulls)
}

pub(crate) fn tension_of<R: Real>(model: &Model<R::Value>, tendon: usize, tensions: &[R]) -> R {
    on_tendon(model, tendon).fold(R::zero(), |sum, index| sum + tensions[index])
}

/// Scales the actuators of a tendon so that their sum stays within its `actuatorfrcrange`.
pub(crate) fn clamp_tendons<R: Real>(model: &Model<R::Value>, tensions: &mut [R]) {
    for (tendon, limits) in model.tendons.iter().enumerate() {
        let Some(range) = &limits.actuatorfrcrange else { continue };
        let share = share(tension_of(model, tendon, tensions), value::get(range));
        for index in on_tendon(model, tendon) {
            tensions[index] *= share;
        }
    }
}

/// Writes, by tendon, 1 if the sum of its actuators is within its `actuatorfrcrange` once each is
/// within its range, else 0: MuJoCo's rule for where actuators have slopes, with its tolerance.
pub(crate) fn free_tendons<R: Real>(model: &Model<R::Value>, tensions: &[R], free: &mut [R]) {
    free.fill(R::one());
    let near = R::of(AT_BOUND.max(ROUNDED * R::epsilon()));
    for (tendon, limits) in model.tendons.iter().enumerate() {
        let Some(range) = &limits.actuatorfrcrange else { continue };
        let [lo, hi] = value::get(range);
        let total = tension_of(model, tendon, tensions);
        let above = total.gt(lo + near * lo.abs());
        let below = total.lt(hi - near * hi.abs());
        free[tendon] = R::select(above.and(below), R::one(), R::zero());
    }
}

/// Returns the part of a sum that its bounds let through.
fn share<R: Real>(total: R, [lo, hi]: [R; 2]) -> R {
    let one = R::one();
    let beyond = total.lt(lo).or(total.gt(hi));
    let whole = R::select(beyond.and(total.abs().gt(R::zero())), total, one);
    R::select(beyond, total.clamp(lo, hi) / whole, one)
}

/// Sums the forces of all actuators, by dof, before joints bound the sum.
pub(crate) fn ask_of_joints<R: Real>(now: &Moment<R>, sums: &mut [R]) {
    sums.fill(R::zero());
    for (along, tension) in now.model.along.iter().zip(now.frames.tension) {
        let pulls = now.frames.pulls;
        along.arms(now.model, now.qpos, pulls, |dof, arm: R| sums[dof] += arm * *tension);
    }
    asked_of_drives(now, |dof, force| sums[dof] += force);
}

/// Computes the part of their actuators' forces that joints let through, by dof, and 1 if the sum is
/// strictly within the bounds, else 0. Gravity compensation through joints is one of these forces.
pub(crate) fn clamp_joints<R: Real>(now: &Moment<R>, shares: &mut [R], free: &mut [R]) {
    ask_of_joints(now, shares);
    let mut clamps = now.model.clamps.iter().peekable();
    for (dof, (share_of, free)) in shares.iter_mut().zip(free).enumerate() {
        let own = |(joint, _): &&(usize, [R::Value; 2])| now.model.joints[*joint].dof == dof;
        [*share_of, *free] = match clamps.next_if(own) {
            Some((_, range)) => let_through(*share_of, value::get(range)),
            None => [R::one(); 2],
        };
    }
}

/// Returns the part of a sum that the bounds of a joint let through, and 1 if it is within them, else 0.
pub(crate) fn let_through<R: Real>(total: R, range: [R; 2]) -> [R; 2] {
    let within = total.gt(range[0]).and(total.lt(range[1]));
    [share(total, range), R::select(within, R::one(), R::zero())]
}

/// Checks for a position servo, which stores energy.
pub(crate) fn stores<N: Constant>(model: &Model<N>, index: usize) -> bool {
    model.acts(index) && model.drives[index].drive == Drive::Spring
}

/// Returns the energy that a position servo stores under a control [J]; 0 for other actuators.
pub(crate) fn stored_under<R: Real>(
    model: &Model<R::Value>,
    index: usize,
    qpos: &[R],
    pulls: Pulls<R>,
    act: Activations<R>,
    ctrl: R,
) -> R {
    let actuator = &model.actuators[index];
    if !stores(model, index) {
        return R::zero();
    }
    let (k, half) = (actuator.bias[1].times(-1.0), R::of(0.5));
    let length = model.along[index].length(model, qpos, pulls);
    let u = input(model, index, act, ctrl, length);
    let at = Along { length, velocity: R::zero() };
    let force = asked(model, index, at, u) + actuator.bias[0].get() - k * length;
    let within = half * force * force / k;
    let Some(range) = &actuator.forcerange else { return within };
    let [lo, hi] = value::get(range);
    let beyond = |bound: R| bound * (force - half * bound) / k;
    let high = R::select(force.gt(hi), beyond(hi), within);
    R::select(force.lt(lo), beyond(lo), high)
}

impl<N: Constant> Model<N> {
    /// Servos whose force is bounded. At the bound they do not damp, and swing about their target with
    /// all the energy that the bound gives.
    pub(crate) fn bounded_servos(&self) -> impl Iterator<Item = usize> + '_ {
        let bounded = |own: &ActuatorAt<N>| own.feeds_back && own.bounds.is_some();
        let all = self.drives.iter().enumerate();
        all.filter(move |(_, own)| bounded(own)).map(|(index, _)| index)
    }
}

/// Returns the lanes where the force of an actuator is within its bound; None: it has no bound.
fn free<R: Real>(now: &Moment<R>, index: usize) -> Option<R::Mask> {
    let (model, actuator) = (now.model, &now.model.actuators[index]);
    let own = model.drives[index].bounds.as_ref().map(|[lo, hi]| {
        let force = now.frames.tension[index];
        force.gt(lo.get()).and(force.lt(hi.get()))
    });
    let own = match actuator.orientation {
        None => own,
        Some(_) => turn(model, index, (now.qpos, now.qvel), now.act, now.inputs)
            .map_or(own, |turn| Some(turn.free)),
    };
    let within = match actuator.target {
        _ if now.frames.shares.is_empty() => return own,
        Target::Joint(joint) | Target::InParent(joint) => {
            model.nv + model.tendons.len() + model.joints[joint].dof
        }
        Target::Tendon(tendon) => model.nv + tendon,
        Target::Site { .. } | Target::Crank { .. } | Target::Body(_) => return own,
    };
    let within = now.frames.shares[within].gt(R::zero());
    Some(own.map_or(within, |own| own.and(within)))
}

/// Returns the lanes in which the force of a servo is at its bound.
pub(crate) fn saturated<R: Real>(now: &Moment<R>, index: usize) -> R::Mask {
    let tension = now.frames.tension[index];
    let range = now.model.drives[index].bounds.as_ref();
    range.map_or(R::Mask::of(false), |[lo, hi]| tension.le(lo.get()).or(hi.get().le(tension)))
}

/// Returns the power that a servo may put in beyond its `power`, if all of its force counts as driving
/// [W]. For those that store energy, `power` counts as 0.
pub(crate) fn power_beyond<R: Real>(
    now: &Moment<R>,
    index: usize,
    stores: bool,
    velocity: &[R],
) -> R {
    let mut usual = R::zero();
    if !stores {
        Actuator::power(now, &index, velocity, &mut |part| usual += part);
    }
    let (along, pulls) = (now.model.along[index], now.frames.pulls);
    let rate = along.velocity(now.model, now.qpos, velocity, pulls);
    let whole = now.frames.tension[index] * rate;
    whole.max(R::zero()) + (-usual).max(R::zero())
}

impl Forces for Actuator {
    const KIND: Kind = Kind::Actuator;
    const GROUP: Group = Group::Driven;

    /// The index of the actuator in the model.
    type At<N: Constant> = usize;

    fn at(model: &Model, index: usize) -> Result<usize, Why> {
        match model.acts(index) {
            true => Ok(index),
            false => Err(Why::Off("actuation")),
        }
    }

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, &index: &usize, add: &mut impl FnMut(usize, R)) {
        let (tension, shares) = (now.frames.tension[index], now.frames.shares);
        let (along, pulls) = (now.model.along[index], now.frames.pulls);
        along.arms(now.model, now.qpos, pulls, |dof, arm: R| {
            let force = arm * tension;
            add(dof, if shares.is_empty() { force } else { force * shares[dof] });
        });
    }

    /// Zero at the bounds of `forcerange`, and where the actuator's joint or tendon bounds the sum, as
    /// in MuJoCo.
    #[inline(never)]
    fn slopes<R: Real>(now: &Moment<R>, &index: &usize, add: &mut dyn FnMut(usize, usize, [R; 2])) {
        let (model, actuator) = (now.model, &now.model.actuators[index]);
        let own = &model.drives[index];
        if !own.feeds_back {
            return;
        }
        let (along, pulls) = (model.along[index], now.frames.pulls);
        let mut by = [actuator.bias[1].get(), actuator.bias[2].get()];
        let mut beside = [R::zero(); 2];
        let at = (now.qpos, now.qvel);
        if let Some(work) = work(model, index, at, now.act, now.inputs, pulls) {
            by = map(work.slopes, |slope| -slope);
            beside = map(work.slopes_beside, |slope| -slope);
        } else if own.gain_varies {
            let at = Along::of(model, index, now.qpos, now.qvel, pulls);
            let ctrl = now.act.ctrl(model, index, now.inputs);
            let u = input(model, index, now.act, ctrl, at.length);
            let slopes = actuator.muscle_gain.as_ref().map_or_else(
                || [actuator.gain[1].get(), actuator.gain[2].get()],
                |muscle| {
                    [
                        R::zero(),
                        muscle.gain(at.length, at.velocity, value::get(&actuator.lengthrange))[1],
                    ]
                },
            );
            by = [by[0] + slopes[0] * u, by[1] + slopes[1] * u];
        }
        if let Some(free) = free(now, index) {
            let held = |slope: R| R::select(free, slope, R::zero());
            by = map(by, held);
            // A joint bounds cogging and friction too, a tendon does not.
            if !matches!(actuator.target, Target::Tendon(_)) {
                beside = map(beside, held);
            }
        }
        let by = [by[0] + beside[0], by[1] + beside[1]];
        along.pairs(model, now.qpos, pulls, |i, j, product: R| {
            add(i, j, map(by, |slope| -(product * slope)));
        });
    }

    #[inline(always)]
    fn sloped<N: Constant>(model: &Model<N>, &index: &usize, each: &mut impl FnMut(usize)) {
        if model.drives[index].feeds_back {
            model.along[index].movers(model, each);
        }
    }

    #[inline(always)]
    fn damps<N: Constant>(model: &Model<N>, &index: &usize) -> bool {
        let actuator = &model.actuators[index];
        let varies = !actuator.gain[2].vanishes() || actuator.muscle_gain.is_some();
        !actuator.bias[2].vanishes() || varies || actuator.drives_motor()
    }

    fn stored<R: Real>(now: &Moment<R>, &index: &usize, add: &mut impl FnMut(R)) {
        let (ctrl, pulls) = (now.act.ctrl(now.model, index, now.inputs), now.frames.pulls);
        add(stored_under(now.model, index, now.qpos, pulls, now.act, ctrl));
    }

    fn power<R: Real>(now: &Moment<R>, &index: &usize, velocity: &[R], add: &mut impl FnMut(R)) {
        let (model, actuator) = (now.model, &now.model.actuators[index]);
        let own = &model.drives[index];
        let force = match own.drive {
            _ if !model.acts(index) => return,
            Drive::Spring => return,
            Drive::Motor => now.frames.tension[index],
            Drive::Damped => {
                let none = Along { length: R::zero(), velocity: R::zero() };
                let ctrl = now.act.ctrl(model, index, now.inputs);
                let u = input(model, index, now.act, ctrl, R::zero());
                within(asked(model, index, none, u) + actuator.bias[0].get(), &own.bounds)
            }
        };
        add(force * model.along[index].velocity(model, now.qpos, velocity, now.frames.pulls));
    }
}
