//! `Sampled`: a number of a model as `Dual` reads it, with its derivatives by parameters.
//!
//! What follows of a parameter when a model is compiled (inertias, weights of contacts, reaches) has no
//! formula here. So the model is compiled at eight values around each parameter, evenly apart, and a
//! derivative is that of the polynomial through them: exact for polynomials of degree eight, and to the
//! eighth power of the distance for others.

use super::dual::{Dual, WAYS};
use super::{Constant, Value};

/// Models around that of a parameter's own value: at −4, −3, −2, −1, 1, 2, 3, 4 distances.
pub const AROUND: usize = 8;
/// Of central differences, by distance (Fornberg 1988).
const WEIGHTS: [f64; AROUND / 2] = [4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0];

#[derive(Clone, Debug, PartialEq)]
pub enum Sampled {
    One(f64),
    /// At the parameters' values, then around those of each way's parameter.
    Many(Box<[f64; 1 + AROUND * WAYS]>),
}

/// The derivative by the parameter of a way, over its distance.
fn slope(samples: &[f64; 1 + AROUND * WAYS], way: usize) -> f64 {
    let around = &samples[1 + way * AROUND..][..AROUND];
    let half = AROUND / 2;
    (0..half).map(|k| WEIGHTS[k] * (around[half + k] - around[half - 1 - k])).sum()
}

fn dual(samples: &[f64; 1 + AROUND * WAYS]) -> Dual {
    Dual { value: samples[0], slopes: core::array::from_fn(|way| slope(samples, way)) }
}

impl Constant for Sampled {
    fn by_lane(numbers: &[f64]) -> Self {
        match numbers {
            [one] => Self::One(*one),
            many => Self::Many(Box::new(core::array::from_fn(|k| many[k]))),
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
        let at = |k: usize| f(of.map(|number| number.lane(k)));
        if of.iter().all(|number| matches!(number, Self::One(_))) {
            return Dual { value: at(0), slopes: [0.0; WAYS] };
        }
        dual(&core::array::from_fn(at))
    }
}
