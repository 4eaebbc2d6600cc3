//! Sine and cosine together: an angle minus quarter turns, and a polynomial each.
//!
//! The reduction in three parts of π/2 and the polynomials are from fdlibm (Sun Microsystems 1993,
//! `e_rem_pio2.c`, `k_sin.c`, `k_cos.c`), without its branches: every angle takes all three parts.

use super::reduce::quarters;
use super::INTEGER;
use crate::real::{Mask, Real};

/// Up to here the three parts of π/2 suffice: 2²⁰ quarter turns.
const NEAR: f64 = 1_647_099.0;
/// Below this, sin x is x.
const TINY: f64 = 7.450_580_596_923_828e-9; // 2⁻²⁷
const QUARTERS: f64 = core::f64::consts::FRAC_2_PI;
/// π/2 in parts of 33 bits, and the rest after the third.
const PARTS: [f64; 3] =
    [1.570_796_326_734_125_6, 6.077_100_506_303_966e-11, 2.022_266_248_711_166_5e-21];
const REST: f64 = 8.478_427_660_368_9e-32;
const SIN: [f64; 6] = [
    -1.666_666_666_666_663_2e-1,
    8.333_333_333_322_49e-3,
    -1.984_126_982_985_795e-4,
    2.755_731_370_707_006_8e-6,
    -2.505_076_025_340_686_3e-8,
    1.589_690_995_211_55e-10,
];
const COS: [f64; 6] = [
    4.166_666_666_666_66e-2,
    -1.388_888_888_887_411e-3,
    2.480_158_728_947_673e-5,
    -2.755_731_435_139_066_3e-7,
    2.087_572_321_298_175e-9,
    -1.135_964_755_778_819_5e-11,
];

/// Returns whether `near` is valid for this angle.
#[inline(always)]
pub fn is_near(x: f64) -> bool {
    x.abs() <= NEAR
}

/// Sine and cosine of an angle with |x| ≤ `NEAR`.
#[inline(always)]
pub fn near(x: f64) -> (f64, f64) {
    let shifted = x * QUARTERS + INTEGER;
    let n = shifted - INTEGER;
    // Each product is exact; the error of each difference is computed.
    let first = x - n * PARTS[0];
    let second = n * PARTS[1];
    let left = first - second;
    let error = (first - left) - second;
    let third = n * PARTS[2];
    let rest = left - third;
    let tail = n * REST - ((left - rest) - third) - error;
    let angle = rest - tail;
    let (sin, cos) = turned(angle, (rest - angle) - tail, shifted.to_bits());
    // A zero keeps its sign.
    (if x.abs() < TINY { x } else { sin }, cos)
}

/// The same operations for other double-precision numbers; and the lanes in which it is valid.
pub fn near_of<R: Real>(x: R) -> (R, R, R::Mask) {
    let (known, zero) = (R::of, R::zero());
    let whole = |x: R| (x + known(INTEGER)) - known(INTEGER);
    let n = (x * known(QUARTERS) + known(INTEGER)) - known(INTEGER);
    let first = x - n * known(PARTS[0]);
    let second = n * known(PARTS[1]);
    let left = first - second;
    let error = (first - left) - second;
    let third = n * known(PARTS[2]);
    let rest = left - third;
    let tail = n * known(REST) - ((left - rest) - third) - error;
    let angle = rest - tail;
    let tail = (rest - angle) - tail;
    let z = angle * angle;
    let w = z * z;
    let [s, c] = [SIN, COS].map(|list| list.map(known));
    let r = s[1] + z * (s[2] + z * s[3]) + z * w * (s[4] + z * s[5]);
    let (v, half) = (z * angle, known(0.5) * z);
    let sin = angle - ((z * (known(0.5) * tail - v * r) - tail) - v * s[0]);
    let r = z * (c[0] + z * (c[1] + z * c[2])) + w * w * (c[3] + z * (c[4] + z * c[5]));
    let head = R::one() - half;
    let cos = head + (((R::one() - head) - half) + (z * r - angle * tail));
    // The last two bits of n: whether n is odd, and whether half of its even part is odd.
    let is_odd = |half: R| {
        let off = half - whole(half);
        off.lt(zero).or(zero.lt(off))
    };
    let half = n * known(0.5);
    let odd = is_odd(half);
    let back = is_odd(R::select(odd, half - known(0.5), half) * known(0.5));
    let across = back.and(odd.not()).or(odd.and(back.not()));
    let (s, c) = (R::select(odd, cos, sin), R::select(odd, sin, cos));
    let (s, c) = (R::select(back, -s, s), R::select(across, -c, c));
    let size = x.abs();
    (R::select(size.lt(known(TINY)), x, s), c, size.le(known(NEAR)))
}

/// Sine and cosine of any angle; NaN for arguments that are not finite.
#[inline]
pub fn sin_cos(x: f64) -> (f64, f64) {
    if is_near(x) {
        near(x)
    } else {
        far(x)
    }
}

#[cold]
pub fn far(x: f64) -> (f64, f64) {
    if !x.is_finite() {
        return (f64::NAN, f64::NAN);
    }
    let (n, angle, tail) = quarters(x.abs());
    let (sin, cos) = turned(angle, tail, n);
    (if x < 0.0 { -sin } else { sin }, cos)
}

/// Sine and cosine of an angle + tail within ±π/4, after n quarter turns.
#[inline(always)]
fn turned(angle: f64, tail: f64, n: u64) -> (f64, f64) {
    let (sin, cos) = (sine(angle, tail), cosine(angle, tail));
    let odd = n & 1 != 0;
    let (s, c) = if odd { (cos, sin) } else { (sin, cos) };
    let negative = |n: u64| (n & 2) << 62;
    let sign = |x: f64, bit: u64| f64::from_bits(x.to_bits() ^ bit);
    (sign(s, negative(n)), sign(c, negative(n.wrapping_add(1))))
}

#[inline(always)]
fn sine(x: f64, tail: f64) -> f64 {
    let z = x * x;
    let w = z * z;
    let r = SIN[1] + z * (SIN[2] + z * SIN[3]) + z * w * (SIN[4] + z * SIN[5]);
    let v = z * x;
    x - ((z * (0.5 * tail - v * r) - tail) - v * SIN[0])
}

#[inline(always)]
fn cosine(x: f64, tail: f64) -> f64 {
    let z = x * x;
    let w = z * z;
    let r = z * (COS[0] + z * (COS[1] + z * COS[2])) + w * w * (COS[3] + z * (COS[4] + z * COS[5]));
    let half = 0.5 * z;
    let head = 1.0 - half;
    head + (((1.0 - head) - half) + (z * r - x * tail))
}
