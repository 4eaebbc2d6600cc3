//! Controllers with targets, and the motors that they drive: MuJoCo's `pid` and `dcmotor`.
//!
//! With the inputs p, v, f (missing ones are 0), the length l and its rate ω, the controller requests
//! kp (s − l) + kv (v − ω) + ki x + f. Its activations, if it has them:
//!
//! ```text
//! s   follows p no faster than slewmax (or the first input, if there is no p); without slewmax s = p
//! x   ẋ = s − l, which stops beyond ±imax
//! ```
//!
//! For a motor of constant K, resistance R₀ and voltage u, they are also the temperature T above the
//! surroundings, the deflection z of its bristles, and the current i:
//!
//! ```text
//! R = R₀ (1 + α (T + ambient − reference))      V = R₀/K asked + K ω within ±vmax, + u
//! C Ṫ = R i² − T/Rθ                             ż = ω − σ₀ |ω| z / g(ω)
//! i̇ = (V − K ω − R i)/(τ R), τ = L/R₀           g = F_c + (F_s − F_c) exp(−(ω/ω_s)²)
//! force = K i within forcerange, + A sin(n l + φ) − σ₀ z − σ₁ ż
//! ```
//!
//! MuJoCo documentation, XML reference, "actuator/pid" and "actuator/dcmotor"; LuGre is the model of
//! Canudas de Wit et al. (1995). As in MuJoCo, a step takes s and i at its end, moves z and i by the
//! exact solution of their equations, which are linear in them, and the slopes leave out all of the
//! bristles but σ₁.

use super::delay::{nearest, Activations};
use crate::model::transmission::Pulls;
use crate::model::Model;
use crate::real::{value, Constant, Mask, Real, Value};
use crate::scene::{self, Controller, Input, Motor};
use crate::state::Inputs;

/// The activations in the order of `Controller::remembers`.
const SLEW: usize = 0;
const INTEGRAL: usize = 1;
const HEAT: usize = 2;
pub(super) const BRISTLE: usize = 3;
const CURRENT: usize = 4;
const KINDS: usize = 5;

/// Divisors are no smaller: MuJoCo's `mjMINVAL`.
const SMALLEST: f64 = 1e-15;

/// A controller at work.
#[derive(Clone, Copy)]
pub(super) struct Work<R: Real> {
    pub force: R,
    /// For a motor: the force of its current before any bound, and the rest, cogging and friction.
    pub driven: R,
    pub beside: R,
    /// Minus the derivatives by length and velocity: of the part that bounds of a tendon or a joint
    /// limit, and of the rest.
    pub slopes: [R; 2],
    pub slopes_beside: [R; 2],
    /// By kind of activation: its rate, and how fast the rate fades as the activation moves.
    rates: [R; KINDS],
    fading: [R; KINDS],
}

/// Returns the kinds of an actuator's activations, with their places in act.
pub(super) fn places<N: Constant>(
    model: &Model<N>,
    index: usize,
) -> impl Iterator<Item = (usize, usize)> + '_ {
    let own = model.actuators[index].controller.as_ref();
    let kinds = own.map_or([false; KINDS], Controller::remembers);
    (0..KINDS).filter(move |kind| kinds[*kind]).zip(model.activations[index].range())
}

/// e^x.
fn exp<R: Real>(x: R) -> R {
    R::of(std::f64::consts::E).powf(x)
}

/// Returns the time for which a fading rate acts in this many seconds [s]: (1 − exp(−a t))/a.
pub(super) fn span<R: Real>(fading: R, seconds: f64) -> R {
    let x = fading * R::of(seconds);
    // Below this x the series is exact to rounding.
    let small = x.lt(R::of(1e-4));
    let (one, half) = (R::one(), R::of(0.5));
    let series = one - x * (half - x * (R::of(1.0 / 6.0) - x * R::of(1.0 / 24.0)));
    let safe = R::select(small, one, x);
    R::of(seconds) * R::select(small, series, (one - exp(-safe)) / safe)
}

/// Returns the present output of an actuator's controller; None if it has none.
#[inline(always)]
pub(super) fn work<R: Real>(
    model: &Model<R::Value>,
    index: usize,
    at: (&[R], &[R]),
    now: Activations<R>,
    inputs: &Inputs<R>,
    pulls: Pulls<R>,
) -> Option<Work<R>> {
    let own = model.actuators[index].controller.as_ref()?;
    Some(work_of(own, model, index, at, now, inputs, pulls))
}

/// In the middle of a step (`Activations::middle`) the activations are still from its start, and are
/// moved by half a step first.
fn work_of<R: Real>(
    own: &Controller,
    model: &Model<R::Value>,
    index: usize,
    (qpos, qvel): (&[R], &[R]),
    now: Activations<R>,
    inputs: &Inputs<R>,
    pulls: Pulls<R>,
) -> Work<R> {
    let actuator = &model.actuators[index];
    let along = model.along[index];
    let along = [along.length(model, qpos, pulls), along.velocity(model, qpos, qvel, pulls)];
    let mut states = [R::zero(); KINDS];
    for (kind, k) in places(model, index) {
        states[kind] = now.act[k];
    }
    let ctrl = model.feeders[index]
        .map(|feeder| feeder.map(|k| model.actuators[k].held(model, now.ctrl(model, k, inputs))));
    let at = Along { actuator, own, circle: model.circles[index], ctrl, along };
    let seconds = now.seconds;
    if !now.middle {
        return at.work(&states, seconds, seconds);
    }
    let first = at.work(&states, seconds, 0.0);
    let start = states;
    for kind in 0..KINDS {
        states[kind] += first.rates[kind] * span(first.fading[kind], 0.5 * seconds);
    }
    let mut work = at.work(&states, seconds, 0.0);
    for kind in 0..KINDS {
        // A fading activation keeps the rate at the start: `advance` lets it fade.
        work.rates[kind] += work.fading[kind] * (states[kind] - start[kind]);
    }
    work
}

impl<R: Real> Work<R> {
    /// Returns the rate of an activation of some kind, and how fast it fades.
    pub fn rate(&self, kind: usize) -> [R; 2] {
        [self.rates[kind], self.fading[kind]]
    }
}

/// Returns an activation after a step: a motor's integral is bounded.
pub(super) fn bounded<R: Real>(own: &Controller, kind: usize, act: R) -> R {
    if kind != INTEGRAL || own.motor.is_none() || own.imax == 0.0 {
        return act;
    }
    act.clamp(R::of(-own.imax), R::of(own.imax))
}

/// A controller with its controls, at a length and its rate.
struct Along<'a, R: Real> {
    actuator: &'a scene::Actuator<R::Value>,
    own: &'a Controller,
    circle: f64,
    ctrl: [Option<R>; 4],
    along: [R; 2],
}

impl<R: Real> Along<'_, R> {
    /// Returns zero, kp and kv.
    fn gains(&self) -> [R; 3] {
        self.actuator.bias.each_ref().map(|x| Value::calc([x], |[x]| 0.0 - x))
    }

    fn given(&self, input: Input) -> R {
        self.ctrl[input.slot()].unwrap_or(R::zero())
    }

    /// `reach`: the time by which early activations have moved already.
    fn work(&self, states: &[R; KINDS], seconds: f64, reach: f64) -> Work<R> {
        let zero = R::zero();
        let mut out = Work {
            force: zero,
            driven: zero,
            beside: zero,
            slopes: [zero; 2],
            slopes_beside: [zero; 2],
            rates: [zero; KINDS],
            fading: [zero; KINDS],
        };
        let asked = self.asked(states, seconds, reach, &mut out);
        let [_, kp, kv] = self.gains();
        match &self.own.motor {
            None => (out.force, out.slopes) = (asked, [kp, kv]),
            Some(motor) => self.drive(motor, asked, states, reach, &mut out),
        }
        out
    }

    /// Returns the force that the controller requests.
    fn asked(&self, states: &[R; KINDS], seconds: f64, reach: f64, out: &mut Work<R>) -> R {
        let zero = R::zero();
        let [length, velocity] = self.along;
        let mut targets = [Input::Pos, Input::Vel, Input::Ff].map(|input| self.given(input));
        if self.own.slewmax > 0.0 {
            let first = (0..2).find(|k| self.ctrl[*k].is_some()).unwrap_or(2);
            let most = R::of(self.own.slewmax);
            let rate = ((targets[first] - states[SLEW]) / R::of(seconds)).clamp(-most, most);
            out.rates[SLEW] = rate;
            targets[first] = states[SLEW] + rate * R::of(reach);
        }
        let target = nearest(targets[0], length, self.circle);
        let [_, kp, kv] = self.gains();
        let mut force = kp * (target - length) + kv * (targets[1] - velocity) + targets[2];
        if self.own.ki != 0.0 {
            let (x, error) = (states[INTEGRAL], target - length);
            let bound = R::of(if self.own.imax > 0.0 { self.own.imax } else { f64::INFINITY });
            let above = x.ge(bound).and(error.gt(zero));
            let below = x.le(-bound).and(error.lt(zero));
            out.rates[INTEGRAL] = R::select(above.or(below), zero, error);
            force += R::of(self.own.ki) * x;
        }
        force
    }

    /// Computes the motor's response to the requested force.
    fn drive(&self, motor: &Motor, asked: R, states: &[R; KINDS], reach: f64, out: &mut Work<R>) {
        let (zero, one) = (R::zero(), R::one());
        let [length, velocity] = self.along;
        let (constant, cold) = (R::of(motor.constant), R::of(motor.resistance));
        let resistance = motor.thermal.map_or(cold, |[_, _, more, from, ambient]| {
            cold * (one + R::of(more) * (states[HEAT] + R::of(ambient - from)))
        });
        let controlled = self.ctrl[..3].iter().any(Option::is_some);
        let (mut voltage, mut free) = (zero, R::Mask::of(controlled));
        if controlled {
            voltage = cold / constant * asked + constant * velocity;
            if motor.vmax > 0.0 {
                let most = R::of(motor.vmax);
                free = voltage.abs().lt(most);
                voltage = voltage.clamp(-most, most);
            }
        }
        voltage += self.given(Input::Voltage);
        // Current by voltage; and the current without inductance.
        let (mut by_voltage, drop) = (one / resistance, voltage - constant * velocity);
        let mut current = drop / resistance;
        let mut heats = current;
        if motor.inductance > 0.0 {
            let fading = R::of(motor.resistance / motor.inductance);
            let mut rate = (drop - resistance * states[CURRENT]) * fading / resistance;
            let acts = span(fading, reach);
            by_voltage *= fading * acts;
            if motor.current_rate > 0.0 {
                let most = R::of(motor.current_rate);
                by_voltage = R::select(rate.abs().lt(most), by_voltage, zero);
                rate = rate.clamp(-most, most);
            }
            (out.rates[CURRENT], out.fading[CURRENT]) = (rate, fading);
            heats = states[CURRENT];
            current = heats + rate * acts;
        }
        if let Some([path, capacity, ..]) = motor.thermal {
            let flows = resistance * heats * heats - states[HEAT] / R::of(path);
            out.rates[HEAT] = flows / R::of(capacity);
        }
        let [_, kp, kv] = self.gains();
        // Unbounded: the controller makes up for the velocity, and only its gains remain.
        let gains = cold * by_voltage;
        let braked = constant * constant * by_voltage;
        out.slopes = [R::select(free, gains * kp, zero), R::select(free, gains * kv, braked)];
        (out.driven, out.force) = (constant * current, constant * current);
        if let Some(range) = &self.actuator.forcerange {
            let [lo, hi] = value::get(range);
            let within = out.force.gt(lo).and(out.force.lt(hi));
            out.slopes = out.slopes.map(|slope| R::select(within, slope, zero));
            out.force = out.force.clamp(lo, hi);
        }
        let [amplitude, periods, phase] = motor.cogging;
        if amplitude != 0.0 {
            let (sin, cos) = (R::of(periods) * length + R::of(phase)).sin_cos();
            out.force += R::of(amplitude) * sin;
            out.beside = R::of(amplitude) * sin;
            out.slopes_beside[0] -= R::of(amplitude * periods) * cos;
        }
        if let Some(lugre) = motor.lugre {
            rub(lugre, velocity, states[BRISTLE], out);
        }
    }
}

/// The friction of bristles.
fn rub<R: Real>(lugre: [f64; 5], velocity: R, z: R, out: &mut Work<R>) {
    let [stiffness, damping, coulomb, still, stribeck] = lugre.map(R::of);
    let share = velocity / stribeck.max(R::of(SMALLEST));
    let most = coulomb + (still - coulomb) * exp(-(share * share));
    let fading = stiffness * velocity.abs() / most.max(R::of(SMALLEST));
    let rate = velocity - fading * z;
    (out.rates[BRISTLE], out.fading[BRISTLE]) = (rate, fading);
    let friction = stiffness * z + damping * rate;
    out.force -= friction;
    out.beside -= friction;
    out.slopes_beside[1] += damping;
}
