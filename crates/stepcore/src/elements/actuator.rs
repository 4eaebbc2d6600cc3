//! Motors, servos and muscles: a force gain·u + bias along a transmission, u the control or the
//! activation, everything within its bounds. Gain and bias are g₀ + g₁·length + g₂·velocity each, or a
//! muscle's.
//!
//! What of it drives from outside, and what is a spring that stores: a position servo
//! (bias₁ < 0) with its control held is a passive spring about l* = (gain·u + bias₀)/k,
//! k = −bias₁, and a damper: an energy that it gains on its own is none. With the bounds
//! [lo, hi] of its force the spring yields: V = ½ k e² within them, F |e| − F²/2k beyond. What
//! the control puts in is the change of V when it moves, and what an activation puts in that when it
//! moves. A velocity servo is a motor of force gain·u + bias₀ and a damper. Everything else is a
//! motor, and all of its work counts as put in. So does that of a controller (`controller.rs`).

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

/// A part of a bound, MuJoCo's: tensions that a tendon's bound has scaled add up to it but for rounding.
const AT_BOUND: f64 = 1e-10;

impl<N: Constant> scene::Actuator<N> {
    /// A control within its bounds, where these are obeyed.
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

/// What steps ask of an actuator.
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
        // A motor's bounds are those of its current, which its controller keeps; those of a servo of
        // orientations bound the length of its torque.
        bounds: own.forcerange.filter(|_| !own.drives_motor() && own.orientation.is_none()),
    }
}

fn within<R: Real>(x: R, bounds: &Option<[R::Value; 2]>) -> R {
    bounds.as_ref().map_or(x, |[lo, hi]| x.clamp(lo.get(), hi.get()))
}

/// What an actuator reads: its length and the rate of that; zeros where nothing depends on them.
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

/// What stands for the control: within its bounds, or the activation; of a servo on a circle the one
/// of those that are the same which is nearest.
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

/// What the force has beside that.
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

/// The force of every actuator before its gear and its bounds, by actuator.
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

/// Every force within the bounds of its own actuator; those of a tendon come first.
pub(crate) fn bound<R: Real>(model: &Model<R::Value>, tensions: &mut [R]) {
    for &Acts { index, .. } in &model.acting.actuator {
        tensions[index] = within(tensions[index], &model.drives[index].bounds);
    }
}

/// It pulls at a tendon that bounds the sum of its actuators.
fn on_bounded_tendon<N: Constant>(model: &Model<N>, index: usize) -> bool {
    let bounds = |tendon: usize| model.tendons[tendon].actuatorfrcrange.is_some();
    matches!(model.actuators[index].target, Target::Tendon(tendon) if bounds(tendon))
}

/// Motors at tendons that bound what their currents do.
fn bounded_motors<N: Constant>(model: &Model<N>) -> impl Iterator<Item = usize> + '_ {
    let runs = |actuator: &scene::Actuator<N>| {
        model.features.actuation && actuator.enabled && actuator.drives_motor()
    };
    let motors = model.actuators.iter().enumerate().filter(move |(_, actuator)| runs(actuator));
    motors.map(|(index, _)| index).filter(|index| on_bounded_tendon(model, *index))
}

/// What their currents do, within each motor's own bounds, which come after those of the tendon.
pub(crate) fn bound_motors<R: Real>(model: &Model<R::Value>, tensions: &mut [R]) {
    for index in bounded_motors(model) {
        if let Some([lo, hi]) = &model.actuators[index].forcerange {
            tensions[index] = tensions[index].clamp(lo.get(), hi.get());
        }
    }
}

/// Their cogging and friction, which no bound holds.
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

/// The actuators of a tendon together stay within its `actuatorfrcrange`.
pub(crate) fn clamp_tendons<R: Real>(model: &Model<R::Value>, tensions: &mut [R]) {
    for (tendon, limits) in model.tendons.iter().enumerate() {
        let Some(range) = &limits.actuatorfrcrange else { continue };
        let share = share(tension_of(model, tendon, tensions), value::get(range));
        for index in on_tendon(model, tendon) {
            tensions[index] *= share;
        }
    }
}

/// By tendon, 1 where its actuators together are within its `actuatorfrcrange` once each of them is
/// within its own bounds, 0 where they are at a bound: MuJoCo's rule, with its tolerance, of where they
/// have slopes.
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

/// The part of a sum that its bounds let through.
fn share<R: Real>(total: R, [lo, hi]: [R; 2]) -> R {
    let one = R::one();
    let beyond = total.lt(lo).or(total.gt(hi));
    let whole = R::select(beyond.and(total.abs().gt(R::zero())), total, one);
    R::select(beyond, total.clamp(lo, hi) / whole, one)
}

/// The force of all actuators together, by dof, before joints bound it.
pub(crate) fn ask_of_joints<R: Real>(now: &Moment<R>, sums: &mut [R]) {
    sums.fill(R::zero());
    for (along, tension) in now.model.along.iter().zip(now.frames.tension) {
        let pulls = now.frames.pulls;
        along.arms(now.model, now.qpos, pulls, |dof, arm: R| sums[dof] += arm * *tension);
    }
    asked_of_drives(now, |dof, force| sums[dof] += force);
}

/// What joints let through of the forces of their actuators, by dof, and by dof whether they let through
/// all of it and more: then 1, else 0. What holds up weight through them is one of these.
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

/// The part of a sum that the bounds of a joint let through, and 1 where it is within them, else 0.
pub(crate) fn let_through<R: Real>(total: R, range: [R; 2]) -> [R; 2] {
    let within = total.gt(range[0]).and(total.lt(range[1]));
    [share(total, range), R::select(within, R::one(), R::zero())]
}

/// It is a position servo, which stores energy.
pub(crate) fn stores<N: Constant>(model: &Model<N>, index: usize) -> bool {
    model.acts(index) && model.drives[index].drive == Drive::Spring
}

/// What a position servo stores under a control [J]; 0 of other actuators.
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
    /// Servos whose force is bounded. Where it reaches its bound they do not damp, and swing about
    /// their target with all the energy that the bound gives.
    pub(crate) fn bounded_servos(&self) -> impl Iterator<Item = usize> + '_ {
        let bounded = |own: &ActuatorAt<N>| own.feeds_back && own.bounds.is_some();
        let all = self.drives.iter().enumerate();
        all.filter(move |(_, own)| bounded(own)).map(|(index, _)| index)
    }
}

/// Where no bound holds the force of an actuator; None: it has no bound.
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

/// The force of a servo is at its bound.
pub(crate) fn saturated<R: Real>(now: &Moment<R>, index: usize) -> R::Mask {
    let tension = now.frames.tension[index];
    let range = now.model.drives[index].bounds.as_ref();
    range.map_or(R::Mask::of(false), |[lo, hi]| tension.le(lo.get()).or(hi.get().le(tension)))
}

/// What a servo may put in beyond its `power`, for all of its force to count as driving [W]. What stores
/// has no power of its own.
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

    /// Its place among the model's.
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

    /// Zero at the bounds of `forcerange`, and where the own joint or tendon bounds the sum, as in
    /// MuJoCo.
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
