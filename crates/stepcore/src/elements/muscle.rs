//! Muscles: force by length and velocity, and the activation.
//!
//! MuJoCo documentation, "Muscle actuators"; the curves are those in its `mju_muscleGain`,
//! `mju_muscleBias` and `mju_muscleDynamics`. With L the length over its optimum and V the velocity
//! over its maximum, both scaled to the muscle's ranges,
//!
//! ```text
//! gain = −F FL(L) FV(V)      bias = −F FP(L)
//! ```
//!
//! FL is 1 at L = 1 and 0 at lmin and lmax, made of four parabolas; FV is 0 at V = −1, 1 at 0 and fvmax
//! from fvmax − 1 on; FP is 0 up to L = 1, then a parabola, then its tangent.

use crate::real::{same, Constant, Mask, Real, Value};
use crate::scene::Muscle;

/// MuJoCo's `mjMINVAL`: divisors are no smaller.
const SMALLEST: f64 = 1e-15;

/// A length and its rate, in the units of the curves.
struct Stretch<R: Real> {
    length: R,
    velocity: R,
    /// ∂velocity/∂(rate of the length).
    by_rate: R,
}

impl<N: Constant> Muscle<N> {
    fn stretch<R: Real>(&self, length: R, velocity: R, span: [R; 2]) -> Stretch<R> {
        let least = R::of(SMALLEST);
        let range = (self.range[1] - self.range[0]).max(SMALLEST);
        let optimum = (span[1] - span[0]) / R::of(range);
        let by_rate = R::one() / (optimum * R::of(self.vmax)).max(least);
        let from = (length - span[0]) / optimum.max(least);
        let length = R::of(self.range[0]) + from;
        Stretch { length, velocity: velocity * by_rate, by_rate }
    }

    /// Returns the force at full activation, and its derivative by the velocity.
    #[inline(never)]
    pub(super) fn gain<R: Real>(&self, length: R, velocity: R, span: [R; 2]) -> [R; 2]
    where
        N: Value<R>,
    {
        let at = self.stretch(length, velocity, span);
        let [fast, slope] = self.by_velocity(at.velocity);
        let most = -self.force.get() * self.by_length(at.length);
        [most * fast, most * slope * at.by_rate]
    }

    /// Returns the passive force.
    #[inline(never)]
    pub(super) fn bias<R: Real>(&self, length: R, span: [R; 2]) -> R
    where
        N: Value<R>,
    {
        let length = self.stretch(length, R::zero(), span).length;
        let (one, half) = (R::one(), R::of(0.5));
        let b = 0.5 * (1.0 + self.lmax);
        let width = R::of((b - 1.0).max(SMALLEST));
        let within = (length - one) / width;
        let beyond = half + (length - R::of(b)) / width;
        let curve = R::select(length.le(R::of(b)), half * within * within, beyond);
        let share = R::select(length.le(one), R::zero(), curve);
        -self.force.get() * R::of(self.fpmax) * share
    }

    /// FL.
    fn by_length<R: Real>(&self, length: R) -> R {
        let (one, half) = (R::one(), R::of(0.5));
        let (a, b) = (0.5 * (self.lmin + 1.0), 0.5 * (1.0 + self.lmax));
        let part = |from: R, width: f64| {
            let x = from / R::of(width.max(SMALLEST));
            half * x * x
        };
        let rising = part(length - R::of(self.lmin), a - self.lmin);
        let before = one - part(one - length, 1.0 - a);
        let after = one - part(length - one, b - 1.0);
        let falling = part(R::of(self.lmax) - length, self.lmax - b);
        let upper = R::select(length.le(R::of(b)), after, falling);
        let lower = R::select(length.le(R::of(a)), rising, before);
        let curve = R::select(length.le(one), lower, upper);
        let inside = length.ge(R::of(self.lmin)).and(length.le(R::of(self.lmax)));
        R::select(inside, curve, R::zero())
    }

    /// FV and its derivative.
    fn by_velocity<R: Real>(&self, velocity: R) -> [R; 2] {
        let (zero, one, two) = (R::zero(), R::one(), R::of(2.0));
        let y = self.fvmax - 1.0;
        let width = R::of(y.max(SMALLEST));
        let (slower, left) = (velocity + one, R::of(y) - velocity);
        let lengthens = R::of(self.fvmax) - left * left / width;
        let pick = |low: R, shortening: R, lengthening: R, high: R| {
            let fast = R::select(velocity.le(R::of(y)), lengthening, high);
            let slow = R::select(velocity.le(zero), shortening, fast);
            R::select(velocity.le(-one), low, slow)
        };
        [
            pick(zero, slower * slower, lengthens, R::of(self.fvmax)),
            pick(zero, two * slower, two * left / width, zero),
        ]
    }
}

/// Checks for a corner of ẇ: the muscle turns from rising to relaxing, or its control is at a bound.
pub(super) fn turns<N: Constant>(act: f64, ctrl: f64, dynprm: &[N; 3]) -> bool {
    let abrupt = dynprm[2].lane(0) < SMALLEST;
    ctrl == 0.0 || same(ctrl, 1.0) || (abrupt && same(ctrl.clamp(0.0, 1.0), act))
}

/// ẇ: a filter that is slower if the muscle is active, and has another time constant when it relaxes.
pub(super) fn rate<R: Real, N: Value<R>>(act: R, ctrl: R, [rise, fall, width]: &[N; 3]) -> R {
    let (zero, one) = (R::zero(), R::one());
    let slow = R::of(0.5) + R::of(1.5) * act.clamp(zero, one);
    let (rise, fall) = (rise.get() * slow, fall.get() / slow);
    let left = ctrl.clamp(zero, one) - act;
    let tau = if width.lane(0) < SMALLEST {
        R::select(left.ge(zero), rise, fall)
    } else {
        // A step of fifth order from 0 to 1.
        let x = (left / width.get() + R::of(0.5)).clamp(zero, one);
        let step = x * x * x * (R::of(3.0) * x * (R::of(2.0) * x - R::of(5.0)) + R::of(10.0));
        fall + (rise - fall) * step
    };
    left / tau.max(R::of(SMALLEST))
}
