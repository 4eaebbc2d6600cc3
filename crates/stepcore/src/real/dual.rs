//! `Dual`: one `f64` world whose numbers carry derivatives along a few directions.
//!
//! x + Σ dᵢεᵢ with εᵢεⱼ = 0 (Clifford 1873; forward differentiation: Wengert 1964). The values
//! equal the ones of `f64`, bit for bit, and alone decide every comparison; `select` takes a number
//! with its derivatives. If a formula has a value but no derivative, such as √0, derivatives are 0
//! there: the mean of both sides; stages that need better use `Real::with_slopes_of`.

use core::ops::{Add, Div, Mul, Neg, Sub};

use super::{array, elementary, Constant, Real, Value};

/// The number of simultaneous directions.
pub const WAYS: usize = 8;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual {
    pub value: f64,
    pub slopes: [f64; WAYS],
}

impl Dual {
    #[inline(always)]
    fn with(value: f64, slope: impl Fn(usize) -> f64) -> Self {
        Self { value, slopes: crate::real::array::from_fn(slope) }
    }
    /// Returns a function's value, and its derivative times this number's.
    #[inline(always)]
    fn chain(self, value: f64, rate: f64) -> Self {
        Self::with(value, |i| rate * self.slopes[i])
    }
}

impl Add for Dual {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self::with(self.value + o.value, |i| self.slopes[i] + o.slopes[i])
    }
}

impl Sub for Dual {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self::with(self.value - o.value, |i| self.slopes[i] - o.slopes[i])
    }
}

impl Mul for Dual {
    type Output = Self;
    #[inline(always)]
    #[allow(clippy::suspicious_arithmetic_impl)] // The product rule.
    fn mul(self, o: Self) -> Self {
        Self::with(self.value * o.value, |i| self.slopes[i] * o.value + self.value * o.slopes[i])
    }
}

impl Div for Dual {
    type Output = Self;
    #[inline(always)]
    #[allow(clippy::suspicious_arithmetic_impl)] // The quotient rule.
    fn div(self, o: Self) -> Self {
        let (value, inverse) = (self.value / o.value, 1.0 / o.value);
        Self::with(value, |i| (self.slopes[i] - value * o.slopes[i]) * inverse)
    }
}

impl Neg for Dual {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self::with(-self.value, |i| -self.slopes[i])
    }
}

derived!(Dual);

impl Real for Dual {
    scalar!(f64, Sampled);
    const FILLS: bool = false;
    #[inline(always)]
    fn of(value: f64) -> Self {
        Self { value, slopes: [0.0; WAYS] }
    }
    #[inline(always)]
    fn lane(&self, _: usize) -> f64 {
        self.value
    }
    #[inline(always)]
    fn set_lane(&mut self, _: usize, value: f64) {
        *self = Self::of(value);
    }
    #[inline(always)]
    fn lt(self, other: Self) -> bool {
        self.value < other.value
    }
    #[inline(always)]
    fn le(self, other: Self) -> bool {
        self.value <= other.value
    }
    /// Checks the value only: a derivative that is not finite is found when it is read.
    #[inline(always)]
    fn is_finite(self) -> bool {
        self.value.is_finite()
    }
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, if root > 0.0 { 0.5 / root } else { 0.0 })
    }
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = elementary::sin_cos(self.value);
        (self.chain(sin, cos), self.chain(cos, -sin))
    }
    /// d atan2(y, x) = (x dy − y dx)/(x² + y²).
    fn atan2(self, x: Self) -> Self {
        let square = self.value * self.value + x.value * x.value;
        let inverse = if square > 0.0 { 1.0 / square } else { 0.0 };
        let (along, across) = (x.value * inverse, self.value * inverse);
        Self::with(elementary::atan2(self.value, x.value), |i| {
            along * self.slopes[i] - across * x.slopes[i]
        })
    }
    fn powf(self, power: Self) -> Self {
        let value = elementary::pow(self.value, power.value);
        let base = power.value * elementary::pow(self.value, power.value - 1.0);
        let rise = elementary::ln(self.value);
        // 0 · ∞ is 0 here: a constant adds nothing.
        let part = |rate: f64, slope: f64| if slope == 0.0 { 0.0 } else { rate * slope };
        let power = |i| if value == 0.0 { 0.0 } else { part(value * rise, power.slopes[i]) };
        Self::with(value, |i| part(base, self.slopes[i]) + power(i))
    }
    #[inline(always)]
    fn with_slopes_of(self, mask: bool, formula: impl FnOnce() -> Self) -> Self {
        if mask {
            Self { value: self.value, slopes: formula().slopes }
        } else {
            self
        }
    }
    fn implicit<const N: usize>(
        x: [Self; N],
        newton: impl FnOnce([Self; N]) -> [Self; N],
    ) -> [Self; N] {
        let step = newton(x.map(|x| Self::of(x.value)));
        crate::real::array::from_fn(|i| Self { value: x[i].value, slopes: step[i].slopes })
    }
    #[inline(always)]
    fn steepness(self) -> f64 {
        self.slopes.iter().fold(0.0, |most, slope| most.max(slope.abs()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_traits::{One, Zero};

    fn seeded(value: f64, slope: f64) -> Dual {
        let mut x = Dual::of(value);
        x.slopes[WAYS - 1] = slope;
        x
    }

    /// Every operation against central differences, at numbers away from its corners.
    #[test]
    fn derivatives_are_those_of_the_formulas() {
        type Formula = (fn(Dual, Dual) -> Dual, fn(f64, f64) -> f64);
        let formulas: [Formula; 10] = [
            (|x, y| x + y * x, |x, y| x + y * x),
            (|x, y| x - y, |x, y| x - y),
            (|x, y| x / y, |x, y| x / y),
            (|x, y| (x * y).sqrt(), |x, y| (x * y).sqrt()),
            (|x, y| (x * y).sin_cos().0, |x, y| elementary::sin_cos(x * y).0),
            (|x, y| (x * y).sin_cos().1, |x, y| elementary::sin_cos(x * y).1),
            (|x, y| (-x).atan2(-y), |x, y| elementary::atan2(-x, -y)),
            (|x, y| x.powf(y), elementary::pow),
            (|x, y| (x - y).abs().max(y), |x, y| (x - y).abs().max(y)),
            (|x, y| (x - y).recip_or_zero().clamp(-x, x), |x, y| (1.0 / (x - y)).min(x)),
        ];
        for (dual, plain) in formulas {
            let (x, y, dx, dy) = (1.7, 0.6, 0.3, -1.1);
            let got = dual(seeded(x, dx), seeded(y, dy));
            assert_eq!(got.value.to_bits(), plain(x, y).to_bits());
            let h = 1e-6;
            let want = (plain(x + h * dx, y + h * dy) - plain(x - h * dx, y - h * dy)) / (2.0 * h);
            assert!((got.slopes[WAYS - 1] - want).abs() < 1e-9, "{got:?} {want}");
            assert_eq!(got.slopes[0], 0.0);
        }
    }

    #[test]
    fn corners_stay_finite() {
        let zero = seeded(0.0, 1.0);
        let all = [
            zero.sqrt(),
            (zero * zero).sqrt(),
            zero.atan2(zero),
            zero.atan2(seeded(-1.0, 0.0)),
            zero.powf(Dual::of(1.5)),
            zero.powf(Dual::of(1.0)),
            zero.powf(seeded(2.0, 1.0)),
            zero.recip_or_zero(),
            Dual::select(zero.gt(Dual::of(0.0)), Dual::one() / zero, Dual::zero()),
        ];
        for x in all {
            assert!(x.slopes.iter().all(|slope| slope.is_finite()), "{x:?}");
        }
    }
}

/// Models around a parameter's value: at −2, −1, 1 and 2 distances.
pub const AROUND: usize = 4;
/// Weights of central differences, by distance (Fornberg 1988).
const WEIGHTS: [f64; AROUND / 2] = [2.0 / 3.0, -1.0 / 12.0];

/// A number of a model for `Dual`, with its derivatives by parameters.
///
/// Numbers that follow from a parameter when a model is compiled (inertias, weights of contacts,
/// reaches) have no formula here. So the model is compiled at four equidistant values around each
/// parameter, and a derivative is the one of the polynomial through them: exact for polynomials of
/// degree four, and to the fourth power of the distance for others.
#[derive(Clone, Debug, PartialEq)]
pub enum Sampled {
    One(f64),
    /// At the parameters' values, then around the parameter of each way.
    Many(Box<[f64; 1 + AROUND * WAYS]>),
}

/// Returns the derivative by the parameter of a way, times its distance.
fn slope(samples: &[f64; 1 + AROUND * WAYS], way: usize) -> f64 {
    let around = &samples[1 + way * AROUND..][..AROUND];
    let half = AROUND / 2;
    (0..half).map(|k| WEIGHTS[k] * (around[half + k] - around[half - 1 - k])).sum()
}

fn dual(samples: &[f64; 1 + AROUND * WAYS]) -> Dual {
    Dual { value: samples[0], slopes: crate::real::array::from_fn(|way| slope(samples, way)) }
}

impl Constant for Sampled {
    fn by_lane(numbers: &[f64]) -> Self {
        match numbers {
            [one] => Self::One(*one),
            many => Self::Many(Box::new(crate::real::array::from_fn(|k| many[k]))),
        }
    }
    #[inline(always)]
    fn lane(&self, lane: usize) -> f64 {
        match self {
            Self::One(number) => *number,
            Self::Many(samples) => samples[lane],
        }
    }
}

impl Value<Dual> for Sampled {
    #[inline(always)]
    fn get(&self) -> Dual {
        match self {
            Self::One(number) => Dual { value: *number, slopes: [0.0; WAYS] },
            Self::Many(samples) => dual(samples),
        }
    }
    #[inline(always)]
    fn calc<const N: usize>(of: [&Self; N], f: impl Fn([f64; N]) -> f64) -> Dual {
        let at = |k: usize| f(array::map(of, |number| number.lane(k)));
        if of.iter().all(|number| matches!(number, Self::One(_))) {
            return Dual { value: at(0), slopes: [0.0; WAYS] };
        }
        dual(&crate::real::array::from_fn(at))
    }
}
