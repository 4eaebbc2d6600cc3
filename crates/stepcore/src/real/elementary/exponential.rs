//! Exponential, logarithm and power.
//!
//! The reductions and polynomials are from fdlibm (Sun Microsystems 1993, `e_exp.c`, `e_log.c`,
//! `e_pow.c`), without its branches. A power keeps the logarithm in two numbers, the first of which
//! is short enough for exact products.

use super::INTEGER;

const SQRT_HALF: u64 = 0x3FE6_A09E_0000_0000;
const HALF_SQRT_3: u64 = 0x3FEB_B67A_0000_0000;
const SUBNORMAL: f64 = 18_014_398_509_481_984.0; // 2⁵⁴
/// ln 2, the first part with trailing zeros.
const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
const EXP: [f64; 5] = [
    1.666_666_666_666_660_2e-1,
    -2.777_777_777_701_559_3e-3,
    6.613_756_321_437_934e-5,
    -1.653_390_220_546_525_2e-6,
    4.138_136_797_057_238_5e-8,
];
const LN: [f64; 7] = [
    6.666_666_666_666_735e-1,
    3.999_999_999_940_942e-1,
    2.857_142_874_366_239e-1,
    2.222_219_843_214_978_4e-1,
    1.818_357_216_161_805e-1,
    1.531_383_769_920_937_3e-1,
    1.479_819_860_511_658_6e-1,
];
/// Coefficients of the logarithm in a power.
const LOG: [f64; 6] = [
    5.999_999_999_999_946e-1,
    4.285_714_285_785_502e-1,
    3.333_333_298_183_774_3e-1,
    2.727_281_238_085_34e-1,
    2.306_607_457_755_617_5e-1,
    2.069_750_178_003_384_2e-1,
];
/// log₂ 1.5, in two numbers.
const LOG2_1_5: [f64; 2] = [5.849_624_872_207_642e-1, 1.350_039_202_129_749e-8];
/// 2/(3 ln 2), also in two numbers.
const RATE: f64 = 9.617_966_939_259_756e-1;
const RATE_PARTS: [f64; 2] = [9.617_967_009_544_373e-1, -7.028_461_650_952_758e-9];
/// ln 2 in two numbers, the first of 24 bits.
const LN_2_SHORT: [f64; 2] = [6.931_471_824_645_996e-1, -1.904_654_299_957_768e-9];

/// eˣ.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    // Beyond, the result is 0 or ∞; NaN stays NaN.
    let inside = if x > 720.0 { 720.0 } else { x };
    let inside = if inside < -760.0 { -760.0 } else { inside };
    let n = (inside * core::f64::consts::LOG2_E + INTEGER) - INTEGER;
    let (high, low) = (inside - n * LN_2[0], n * LN_2[1]);
    let r = high - low;
    let t = r * r;
    let c = r - t * (EXP[0] + t * (EXP[1] + t * (EXP[2] + t * (EXP[3] + t * EXP[4]))));
    scaled(1.0 - ((low - (r * c) / (2.0 - c)) - high), n)
}

/// eˣ − 1, within 3 ulp (Kahan's quotient, in which the errors of both cancel).
pub fn exp_m1(x: f64) -> f64 {
    let power = exp(x);
    let less = power - 1.0;
    if power == 1.0 {
        x
    } else if less == -1.0 || !power.is_finite() {
        less
    } else {
        less * x / ln(power)
    }
}

/// The natural logarithm.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    let (m, n) = split(x, SQRT_HALF);
    let f = m - 1.0;
    let half = 0.5 * f * f;
    let s = f / (2.0 + f);
    let z = s * s;
    let w = z * z;
    let odd = w * (LN[1] + w * (LN[3] + w * LN[5]));
    let even = z * (LN[0] + w * (LN[2] + w * (LN[4] + w * LN[6])));
    let inside = n * LN_2[0] - ((half - (s * (half + odd + even) + n * LN_2[1])) - f);
    let inside = if x == 0.0 { f64::NEG_INFINITY } else { inside };
    let inside = if x == f64::INFINITY { x } else { inside };
    if (x < 0.0) | x.is_nan() {
        f64::NAN
    } else {
        inside
    }
}

/// x to the power y, for every pair of numbers as in C.
#[inline]
pub fn pow(x: f64, y: f64) -> f64 {
    if is_plain(x, y) {
        plain(x, y)
    } else {
        special(x, y)
    }
}

/// Returns whether `plain` is valid.
#[inline(always)]
pub fn is_plain(x: f64, y: f64) -> bool {
    (x > 0.0) & (x < f64::INFINITY) & (y.abs() < f64::INFINITY)
}

#[cold]
pub fn special(x: f64, y: f64) -> f64 {
    if y == 0.0 || x == 1.0 {
        return 1.0;
    }
    if x.is_nan() || y.is_nan() {
        return f64::NAN;
    }
    let whole = y.is_infinite() || y.trunc() == y;
    let odd = y.abs() < 9_007_199_254_740_992.0 && whole && (0.5 * y).trunc() != 0.5 * y;
    let a = x.abs();
    let size = if y.is_infinite() {
        if a == 1.0 {
            1.0
        } else if (a > 1.0) == (y > 0.0) {
            f64::INFINITY
        } else {
            0.0
        }
    } else if a == 0.0 || a.is_infinite() {
        if (a > 0.0) == (y > 0.0) {
            f64::INFINITY
        } else {
            0.0
        }
    } else if x < 0.0 && !whole {
        f64::NAN
    } else {
        plain(a, y)
    };
    if odd && x.is_sign_negative() {
        -size
    } else {
        size
    }
}

/// x to the power y, x positive and both finite.
#[inline(always)]
pub fn plain(x: f64, y: f64) -> f64 {
    // Beyond, the power is 0 or ∞ unless x is 1.
    let y = if y > 1e20 { 1e20 } else { y };
    let y = if y < -1e20 { -1e20 } else { y };
    let (log, rest) = log2(x);
    let y_short = short(y);
    let low = (y - y_short) * log + y * rest;
    let high = y_short * log;
    let z = low + high;
    let n = (z + INTEGER) - INTEGER;
    // A value far beyond must not spoil the number that is selected instead.
    let inside = z.abs() < 1100.0;
    let n = if inside { n } else { 0.0 };
    let (high, low) = if inside { (high - n, low) } else { (0.0, 0.0) };
    let power = scaled(exp2(high, low), n);
    let power = if z >= 1100.0 { f64::INFINITY } else { power };
    if z <= -1100.0 {
        0.0
    } else {
        power
    }
}

/// log₂ x in two numbers, the first short.
#[inline(always)]
fn log2(x: f64) -> (f64, f64) {
    let (m, n) = split(x, HALF_SQRT_3);
    // m = 1 or 1.5 times e^(2 atanh s).
    let upper = m >= 1.224_744_871_391_589;
    let middle = if upper { 1.5 } else { 1.0 };
    let (log_high, log_low) = if upper { (LOG2_1_5[0], LOG2_1_5[1]) } else { (0.0, 0.0) };
    let (u, v) = (m - middle, 1.0 / (m + middle));
    let s = u * v;
    let s_high = short(s);
    let sum_high = short(m + middle);
    let sum_low = m - (sum_high - middle);
    let s_low = v * ((u - s_high * sum_high) - s_high * sum_low);
    let z = s * s;
    let r =
        z * z * (LOG[0] + z * (LOG[1] + z * (LOG[2] + z * (LOG[3] + z * (LOG[4] + z * LOG[5])))));
    let r = r + s_low * (s_high + s);
    let square = s_high * s_high;
    let t_high = short(3.0 + square + r);
    let t_low = r - ((t_high - 3.0) - square);
    let (u, v) = (s_high * t_high, s_low * t_high + t_low * s);
    let high = short(u + v);
    let low = v - (high - u);
    let z_high = RATE_PARTS[0] * high;
    let z_low = RATE_PARTS[1] * high + low * RATE + log_low;
    let log = short(((z_high + z_low) + log_high) + n);
    (log, z_low - (((log - n) - log_high) - z_high))
}

/// 2^(high + low), the sum within ±½.
#[inline(always)]
fn exp2(high: f64, low: f64) -> f64 {
    let t = short(low + high);
    let u = t * LN_2_SHORT[0];
    let v = (low - (t - high)) * core::f64::consts::LN_2 + t * LN_2_SHORT[1];
    let z = u + v;
    let w = v - (z - u);
    let t = z * z;
    let c = z - t * (EXP[0] + t * (EXP[1] + t * (EXP[2] + t * (EXP[3] + t * EXP[4]))));
    1.0 - (((z * c) / (c - 2.0) - (w + z * w)) - z)
}

/// The first 21 bits of a number.
#[inline(always)]
fn short(x: f64) -> f64 {
    f64::from_bits(x.to_bits() & !0xFFFF_FFFF)
}

/// m·2ⁿ = x > 0, m at least the number with these bits and less than twice that.
#[inline(always)]
fn split(x: f64, least: u64) -> (f64, f64) {
    const ONE: u64 = 1023 << 52;
    let small = x < f64::MIN_POSITIVE;
    let x = if small { x * SUBNORMAL } else { x };
    let bits = x.to_bits();
    let exponent = bits.wrapping_add(ONE - least) >> 52;
    let m = f64::from_bits(bits.wrapping_sub(exponent << 52).wrapping_add(ONE));
    // The exponent as a number: in the last bits of one of 2⁵².
    let n = f64::from_bits(exponent | 1075 << 52) - (4_503_599_627_370_496.0 + 1023.0);
    (m, if small { n - 54.0 } else { n })
}

/// x·2ⁿ for an integer n within ±1100, rounded once.
#[inline(always)]
fn scaled(x: f64, n: f64) -> f64 {
    let half = (0.5 * n + INTEGER) - INTEGER;
    let power = |n: f64| f64::from_bits((n + INTEGER).to_bits().wrapping_add(1023) << 52);
    x * power(half) * power(n - half)
}
