//! The same functions of several numbers, in loops that compilers vectorise.

use super::{arctan, exponential, trig};

pub fn sin_cos_each<const W: usize>(x: &[f64; W]) -> ([f64; W], [f64; W]) {
    let (mut sin, mut cos) = ([0.0; W], [0.0; W]);
    for i in 0..W {
        (sin[i], cos[i]) = trig::near(x[i]);
    }
    if !x.iter().all(|x| trig::is_near(*x)) {
        for i in (0..W).filter(|i| !trig::is_near(x[*i])) {
            (sin[i], cos[i]) = trig::far(x[i]);
        }
    }
    (sin, cos)
}

pub fn atan2_each<const W: usize>(y: &[f64; W], x: &[f64; W]) -> [f64; W] {
    let mut angle = [0.0; W];
    for i in 0..W {
        angle[i] = arctan::atan2(y[i], x[i]);
    }
    angle
}

pub fn pow_each<const W: usize>(x: &[f64; W], y: &[f64; W]) -> [f64; W] {
    let mut power = [0.0; W];
    for i in 0..W {
        power[i] = exponential::plain(x[i], y[i]);
    }
    for i in (0..W).filter(|i| !exponential::is_plain(x[*i], y[*i])) {
        power[i] = exponential::special(x[i], y[i]);
    }
    power
}
