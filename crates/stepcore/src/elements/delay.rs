//! The control that an actuator reads, which may arrive late: from the samples that are kept.
//!
//! MuJoCo documentation, "Delays": each step keeps its control, and the forces of an actuator with a
//! delay read the control of `delay` ago. Samples are counted in steps back from the present one. The
//! newest is one step old, and a shorter delay reads it; a delay longer than the list reads the oldest.
//! Between samples the control is the earlier one, on a line, or on a cubic through both, whose slope
//! at each is the slope between its neighbours (Catmull-Rom), or 0 at the ends of the list.

use crate::model::Model;
use crate::real::Real;
use crate::scene::Interp;
use crate::state::Inputs;

/// A delay this near to a sample [steps] reads the sample.
const SAME: f64 = 1e-9;

/// Activations and past controls of actuators, and the step that they are advanced by.
#[derive(Clone, Copy)]
pub(crate) struct Activations<'a, R: Real> {
    pub act: &'a [R],
    /// `State::ctrl_history`; empty: controls are not late.
    pub history: &'a [R],
    /// Time step, and the time between two samples [s].
    pub seconds: f64,
    pub period: f64,
    /// The elapsed part of the step.
    pub ahead: f64,
    /// This is the middle of a step, and the activations of controllers are still from its start.
    pub middle: bool,
}

impl<R: Real> Activations<'_, R> {
    /// Returns the control of an actuator: the present one, or the one of its delay ago.
    #[inline(always)]
    pub fn ctrl(&self, model: &Model<R::Value>, index: usize, inputs: &Inputs<R>) -> R {
        let span = model.histories[index];
        if span.len == 0 || self.history.is_empty() {
            return inputs.ctrl[index];
        }
        let actuator = &model.actuators[index];
        let steps = actuator.delay / self.period - self.ahead;
        read(&self.history[span.range()], steps, actuator.interp)
    }
}

/// Returns the equivalent of a control that is nearest to a length or an activation: equivalent
/// controls are a circle apart (0: there is only the control itself).
#[inline(always)]
pub(super) fn nearest<R: Real>(ctrl: R, about: R, circle: f64) -> R {
    if circle == 0.0 {
        return ctrl;
    }
    let scale = R::of(std::f64::consts::TAU / circle);
    let far = (ctrl - about).abs().gt(R::of(0.5 * circle));
    let (sin, cos) = ((ctrl - about) * scale).sin_cos();
    R::select(far, about + sin.atan2(cos) / scale, ctrl)
}

/// Returns the control of this many steps ago; samples: the newest first, one step old.
fn read<R: Real>(samples: &[R], steps: f64, interp: Interp) -> R {
    let at = (steps - 1.0).clamp(0.0, (samples.len() - 1) as f64);
    let near = at.round();
    if (at - near).abs() <= SAME {
        return samples[near as usize];
    }
    // `later` is the sample after that time, and `earlier` the one before.
    let (first, share) = (at.floor() as usize, R::of(at.ceil() - at));
    let (later, earlier) = (samples[first], samples[first + 1]);
    match interp {
        Interp::Hold => earlier,
        Interp::Linear => earlier + share * (later - earlier),
        Interp::Cubic => {
            let slope = |k: usize| match (k.checked_sub(1), samples.get(k + 1)) {
                (Some(after), Some(before)) => R::of(0.5) * (samples[after] - *before),
                _ => R::zero(),
            };
            hermite([earlier, later], [slope(first + 1), slope(first)], share)
        }
    }
}

/// Evaluates the cubic from 0 to 1 with these values and slopes at both ends.
fn hermite<R: Real>(values: [R; 2], slopes: [R; 2], x: R) -> R {
    let rise = values[1] - values[0];
    let bend = slopes[0] + slopes[1] - rise - rise;
    let curve = rise - slopes[0] - bend;
    values[0] + x * (slopes[0] + x * (curve + x * bend))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// MuJoCo 4.0.0's `mj_readCtrl` of the samples 1, 3, −2, 7, the last one step old.
    #[test]
    fn delays_read_as_mujoco_does() {
        let samples = [7.0, -2.0, 3.0, 1.0];
        for (steps, hold, linear, cubic) in [
            (0.2, 7.0, 7.0, 7.0),
            (1.0, 7.0, 7.0, 7.0),
            (1.25, -2.0, 4.75, 5.6875),
            (1.5, -2.0, 2.5, 2.75),
            (2.0, -2.0, -2.0, -2.0),
            (2.3, 3.0, -0.5, -1.3085),
            (2.5, 3.0, 0.5, 0.0625),
            (3.5, 1.0, 2.0, 2.1875),
            (3.75, 1.0, 1.5, 1.3828125),
            (6.0, 1.0, 1.0, 1.0),
        ] {
            let all = [Interp::Hold, Interp::Linear, Interp::Cubic];
            for (interp, want) in all.into_iter().zip([hold, linear, cubic]) {
                let got: f64 = read(&samples, steps, interp);
                assert!((got - want).abs() < 1e-12, "{steps} {interp:?}: {got} {want}");
            }
        }
    }
}
