//! Activations: the state that an actuator has between its control and its force.
//!
//! MuJoCo documentation, "Actuation model": ẇ = u for an integrator, ẇ = (u − w)/τ for a filter;
//! `muscle.rs` has the equation of a muscle. A step takes w + dt·ẇ, and for `filterexact` the exact
//! change in dt under a constant control, w + (1 − exp(−dt/τ)) τ ẇ; then bounds. For a servo on a
//! circle (`Model::circles`) a filter goes the shorter way round: u is the equivalent control nearest
//! to w. At the end of a step w is replaced by the equivalent one nearest to the length at the start of
//! the step (`midpoint`: in its middle), even if that is out of bounds.

use super::controller::{self, BRISTLE};
use super::delay::nearest;
pub(crate) use super::delay::Activations;
use super::muscle;
use crate::clock::Clock;
use crate::model::transmission::Pulls;
use crate::model::{Model, Span};
use crate::real::{elementary, same, Constant, Real, Value};
use crate::scene::{self, Dynamics};
use crate::state::{Inputs, State};

/// The shortest time constant that counts [s]: MuJoCo's `mjMINVAL`.
const SHORTEST: f64 = 1e-15;

impl<R: Real> State<R> {
    /// Returns the activations of the state, in steps of `clock`.
    pub(crate) fn activations(&self, clock: Clock<R>) -> Activations<'_, R> {
        let Self { act, ctrl_history: history, .. } = self;
        let Clock { seconds, period, .. } = clock;
        Activations { act, history, seconds, period, ahead: 0.0, middle: false }
    }
}

/// Shifts the present controls into the past ones, after a step.
#[inline]
pub(crate) fn remember<R: Real>(model: &Model<R::Value>, history: &[R], ctrl: &[R], out: &mut [R]) {
    if out.is_empty() {
        return;
    }
    for (span, ctrl) in model.histories.iter().zip(ctrl).filter(|(span, _)| span.len > 0) {
        let (first, last) = (span.start, span.start + span.len - 1);
        out[first] = *ctrl;
        out[first + 1..=last].copy_from_slice(&history[first..last]);
    }
}

impl<N: Constant> scene::Actuator<N> {
    /// Evaluates a function of the time constant of a filter [s].
    fn of_time_constant<R: Real>(&self, f: impl Fn(f64) -> f64) -> R
    where
        N: Value<R>,
    {
        N::calc([&self.dynprm[0]], |[tau]| f(tau.max(SHORTEST)))
    }

    /// Returns ẇ under a control. circle: the length after which controls are equivalent (0: none).
    fn rate<R: Real>(&self, act: R, ctrl: R, circle: f64) -> R
    where
        N: Value<R>,
    {
        match self.dynamics {
            Dynamics::None => R::zero(),
            Dynamics::Integrator => ctrl,
            Dynamics::Filter | Dynamics::FilterExact => {
                (nearest(ctrl, act, circle) - act) / self.of_time_constant(|tau| tau)
            }
            Dynamics::Muscle => muscle::rate(act, ctrl, &self.dynprm),
        }
    }

    /// Returns the time for which ẇ acts in this many seconds [s].
    fn span<R: Real>(&self, seconds: f64) -> R
    where
        N: Value<R>,
    {
        match self.dynamics {
            Dynamics::FilterExact => {
                self.of_time_constant(|tau| -tau * elementary::exp_m1(-seconds / tau))
            }
            _ => R::of(seconds),
        }
    }

    /// Returns an activation after a step in which it changes at a rate.
    fn next<R: Real>(&self, act: R, rate: R, seconds: f64) -> R
    where
        N: Value<R>,
    {
        self.within(act + rate * self.span::<R>(seconds))
    }

    /// Checks for a corner in the change of an activation: a corner of a muscle's rate, or a step that
    /// ends exactly at a bound.
    pub(crate) fn turns<R: Real>(&self, act: R, ctrl: R, circle: f64, seconds: f64) -> bool
    where
        N: Value<R>,
    {
        let after = act + self.rate(act, ctrl, circle) * self.span::<R>(seconds);
        let bound = self.actrange.iter().flatten().any(|bound| same(bound.lane(0), after.lane(0)));
        let muscle = matches!(self.dynamics, Dynamics::Muscle);
        bound || muscle && muscle::turns(act.lane(0), ctrl.lane(0), &self.dynprm)
    }

    fn within<R: Real>(&self, act: R) -> R
    where
        N: Value<R>,
    {
        self.actrange.as_ref().map_or(act, |[lo, hi]| act.clamp(lo.get(), hi.get()))
    }
}

/// Returns the effective control of an actuator: with an activation, that activation, or its value at
/// the end of the step.
#[inline(always)]
pub(crate) fn signal<R: Real>(
    model: &Model<R::Value>,
    index: usize,
    now: Activations<R>,
    ctrl: impl FnOnce() -> R,
) -> R {
    let span = model.activations[index];
    if span.len == 0 {
        return ctrl();
    }
    let (actuator, act) = (&model.actuators[index], now.act[span.start]);
    if !actuator.actearly {
        return act;
    }
    actuator.next(act, actuator.rate(act, ctrl(), model.circles[index]), now.seconds)
}

/// Computes the rates of all activations, and how fast the rates of controllers fade.
pub(crate) fn rates<R: Real>(
    model: &Model<R::Value>,
    at: (&[R], &[R]),
    now: Activations<R>,
    inputs: &Inputs<R>,
    pulls: Pulls<R>,
    [rates, fading]: [&mut [R]; 2],
) {
    if rates.is_empty() || !model.features.actuation {
        return;
    }
    for (index, places) in model.controlled() {
        let Some(work) = controller::work(model, index, at, now, inputs, pulls) else { continue };
        for (kind, k) in places {
            [rates[k], fading[k]] = work.rate(kind);
        }
    }
    for (index, k) in model.active() {
        let actuator = &model.actuators[index];
        let ctrl = actuator.held(model, now.ctrl(model, index, inputs));
        rates[k] = actuator.rate(now.act[k], ctrl, model.circles[index]);
    }
}

/// Advances all activations by a step with these rates, which fade as they move.
#[inline]
pub(crate) fn advance<R: Real>(
    model: &Model<R::Value>,
    act: &[R],
    [rates, fading]: [&[R]; 2],
    seconds: f64,
    out: &mut [R],
) {
    if act.is_empty() {
        return;
    }
    out.copy_from_slice(act);
    if !model.features.actuation {
        return;
    }
    for (index, places) in model.controlled() {
        let Some(own) = &model.actuators[index].controller else { continue };
        for (kind, k) in places {
            let moved = act[k] + rates[k] * controller::span(fading[k], seconds);
            out[k] = controller::bounded(own, kind, moved);
        }
    }
    for (index, k) in model.active() {
        out[k] = model.actuators[index].next(act[k], rates[k], seconds);
    }
    // The activations of disabled actuators rest, within their bounds.
    for (index, k) in (0..model.actuators.len()).filter_map(|index| model.place(index, false)) {
        out[k] = model.actuators[index].within(act[k]);
    }
}

/// Replaces the rates of bristles by the ones at the start of a step of `rk4`, as in MuJoCo.
pub(crate) fn hold_bristles<R: Real>(model: &Model<R::Value>, first: &[R], rates: &mut [R]) {
    for (_, k) in
        model.controlled().flat_map(|(_, places)| places).filter(|(kind, _)| *kind == BRISTLE)
    {
        rates[k] = first[k];
    }
}

/// Computes all activations in the middle of a step: an exact filter moves exactly by half a step,
/// others by the implicit midpoint rule, w_m = w + dt/2·ẇ(w_m).
pub(crate) fn middle<R: Real>(
    model: &Model<R::Value>,
    now: Activations<R>,
    inputs: &Inputs<R>,
    out: &mut [R],
) {
    let half = 0.5 * now.seconds;
    out.copy_from_slice(now.act);
    if !model.features.actuation {
        return;
    }
    for (index, k) in model.active() {
        let actuator = &model.actuators[index];
        let ctrl = actuator.held(model, now.ctrl(model, index, inputs));
        let rate = actuator.rate(now.act[k], ctrl, model.circles[index]);
        let span = match actuator.dynamics {
            Dynamics::Filter => actuator.of_time_constant(|tau| half / (1.0 + half / tau)),
            _ => actuator.span(half),
        };
        out[k] = now.act[k] + rate * span;
    }
}

/// Advances all activations by a step, with their rates in its middle.
pub(crate) fn through_middle<R: Real>(
    model: &Model<R::Value>,
    now: Activations<R>,
    inputs: &Inputs<R>,
    [rates, fading]: [&[R]; 2],
    out: &mut [R],
) {
    advance(model, now.act, [rates, fading], now.seconds, out);
    if !model.features.actuation {
        return;
    }
    for (index, k) in model.active() {
        let actuator = &model.actuators[index];
        if actuator.dynamics == Dynamics::FilterExact {
            let ctrl = actuator.held(model, now.ctrl(model, index, inputs));
            let rate = actuator.rate(now.act[k], ctrl, model.circles[index]);
            out[k] = actuator.next(now.act[k], rate, now.seconds);
        }
    }
}

/// Writes the lengths of servos on circles, by activation; other entries are left alone.
#[inline]
pub(crate) fn centres<R: Real>(
    model: &Model<R::Value>,
    qpos: &[R],
    pulls: Pulls<R>,
    out: &mut [R],
) {
    if out.is_empty() {
        return;
    }
    for (index, k) in model.on_circles() {
        out[k] = model.along[index].length(model, qpos, pulls);
    }
}

/// Takes whole turns off activations that are more than half a turn away from these lengths.
#[inline]
pub(crate) fn unwind<R: Real>(model: &Model<R::Value>, centres: &[R], act: &mut [R]) {
    if act.is_empty() {
        return;
    }
    for (index, k) in model.on_circles() {
        act[k] = nearest(act[k], centres[k], model.circles[index]);
    }
}

impl<N: Constant> Model<N> {
    /// Activations of servos on circles.
    fn on_circles(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let circles = self.circles.iter().enumerate().filter(|(_, circle)| **circle != 0.0);
        let acting = circles.filter(|_| self.features.actuation);
        acting.filter_map(|(index, _)| self.place(index, true))
    }

    /// Actuators with one activation, and its place; controllers are left out.
    fn active(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        (0..self.actuators.len()).filter_map(|index| self.place(index, true))
    }

    /// Returns the one activation of an actuator that is `enabled` or is not; None for a controller.
    fn place(&self, index: usize, enabled: bool) -> Option<(usize, usize)> {
        let (span, actuator) = (self.activations[index], &self.actuators[index]);
        let plain = actuator.enabled == enabled && actuator.controller.is_none();
        (span.len > 0 && plain).then_some((index, span.start))
    }

    /// Actuators with a controller that has activations: the kinds and places of the activations that
    /// change. In MuJoCo only the bristles of a disabled actuator keep moving.
    fn controlled(
        &self,
    ) -> impl Iterator<Item = (usize, impl Iterator<Item = (usize, usize)> + '_)> {
        let all = self.actuators.iter().zip(&self.activations).enumerate();
        let own = |(_, (actuator, span)): &(usize, (&scene::Actuator<N>, &Span))| {
            actuator.controller.is_some() && span.len > 0
        };
        all.filter(own).map(|(index, (actuator, _))| {
            let changes = |(kind, _): &(usize, usize)| actuator.enabled || *kind == BRISTLE;
            (index, controller::places(self, index).filter(changes))
        })
    }
}
