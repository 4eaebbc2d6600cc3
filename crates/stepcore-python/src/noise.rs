//! Random numbers of many worlds: `stepcore.engine.noise` defines them.
//!
//! Only +, −, ×, ÷ and √: the same bits on every machine.

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

const GOLDEN: u64 = 0x9E37_79B9_7F4A_7C15;
const HALF_SQRT: f64 = std::f64::consts::FRAC_1_SQRT_2;
const LOG_2: f64 = std::f64::consts::LN_2;
/// The number of bits of a uniform number.
const BITS: i32 = 52;
/// Numbers at a time, whose loops the compiler can vectorise.
const PORTION: usize = 64;

/// AS 241: numerator and denominator, the highest power first.
struct Ratio([f64; 8], [f64; 8]);

/// For the middle.
const MIDDLE: Ratio = Ratio(
    [
        2_509.080_928_730_122_7,
        33_430.575_583_588_13,
        67_265.770_927_008_7,
        45_921.953_931_549_87,
        13_731.693_765_509_46,
        1_971.590_950_306_551_3,
        133.141_667_891_784_38,
        3.387_132_872_796_366_5,
    ],
    [
        5_226.495_278_852_854,
        28_729.085_735_721_943,
        39_307.895_800_092_71,
        21_213.794_301_586_597,
        5_394.196_021_424_751,
        687.187_007_492_057_9,
        42.313_330_701_600_91,
        1.0,
    ],
);
/// For the tails.
const NEAR: Ratio = Ratio(
    [
        0.000_774_545_014_278_341_4,
        0.022_723_844_989_269_184,
        0.241_780_725_177_450_6,
        1.270_458_252_452_368_4,
        3.647_848_324_763_204_5,
        5.769_497_221_460_691,
        4.630_337_846_156_546,
        1.423_437_110_749_683_5,
    ],
    [
        1.050_750_071_644_416_9e-9,
        0.000_547_593_808_499_534_5,
        0.015_198_666_563_616_457,
        0.148_103_976_427_480_08,
        0.689_767_334_985_1,
        1.676_384_830_183_803_8,
        2.053_191_626_637_759,
        1.0,
    ],
);
/// For the far tails.
const FAR: Ratio = Ratio(
    [
        2.010_334_399_292_288_1e-7,
        2.711_555_568_743_487_6e-5,
        0.001_242_660_947_388_078_4,
        0.026_532_189_526_576_124,
        0.296_560_571_828_504_87,
        1.784_826_539_917_291_3,
        5.463_784_911_164_114,
        6.657_904_643_501_103,
    ],
    [
        2.044_263_103_389_939_7e-15,
        1.421_511_758_316_446e-7,
        1.846_318_317_510_054_8e-5,
        0.000_786_869_131_145_613_3,
        0.014_875_361_290_850_615,
        0.136_929_880_922_735_8,
        0.599_832_206_555_888,
        1.0,
    ],
);

/// Half the width of the range of `MIDDLE`.
const REACH: f64 = 0.425;

impl Ratio {
    #[inline(always)]
    fn at(&self, x: f64) -> f64 {
        let polynomial = |c: &[f64; 8]| c[1..].iter().fold(c[0], |sum, c| sum * x + c);
        polynomial(&self.0) / polynomial(&self.1)
    }
}

/// SplitMix64's next number, with a word as the state.
#[inline(always)]
fn mixed(word: u64) -> u64 {
    let z = word.wrapping_add(GOLDEN);
    let z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ z >> 31
}

/// The number at a place of a stream, between 0 and 1.
#[inline(always)]
fn share(key: u64, place: u64) -> f64 {
    ((mixed(key ^ mixed(place)) >> (64 - BITS)) as f64 + 0.5) * 0.5f64.powi(BITS)
}

/// Replaces shares between 0 and 1 by quantiles of the normal distribution.
fn quantiles(shares: &mut [f64]) {
    for shares in shares.chunks_mut(PORTION) {
        let mut middle = [0.0; PORTION];
        for (middle, share) in middle.iter_mut().zip(&*shares) {
            let q = share - 0.5;
            *middle = q * MIDDLE.at(0.180625 - q * q);
        }
        for (share, middle) in shares.iter_mut().zip(middle) {
            let outside = (*share - 0.5).abs() > REACH;
            *share = if outside { tail(*share) } else { middle };
        }
    }
}

fn tail(share: f64) -> f64 {
    let root = (-log(share.min(1.0 - share))).sqrt();
    let tail = if root <= 5.0 { NEAR.at(root - 1.6) } else { FAR.at(root - 5.0) };
    if share < 0.5 {
        -tail
    } else {
        tail
    }
}

/// The natural logarithm of a positive normal number: 2 artanh((m − 1) / (m + 1)), mantissa m.
fn log(x: f64) -> f64 {
    let bits = x.to_bits();
    let exponent = (bits >> 52) as i32 - 1022;
    let half = f64::from_bits(bits & !(0x7ff << 52) | 1022 << 52);
    let low = half < HALF_SQRT;
    let (mantissa, exponent) = if low { (2.0 * half, exponent - 1) } else { (half, exponent) };
    let z = (mantissa - 1.0) / (mantissa + 1.0);
    let square = z * z;
    let powers = (1..=23).rev().step_by(2);
    let series = powers.fold(0.0, |series, power| series * square + 1.0 / f64::from(power));
    f64::from(exponent) * LOG_2 + 2.0 * z * series
}

/// Return the next `width` numbers of each stream, one stream after the other: of the normal
/// distribution, or evenly between 0 and 1.
#[pyfunction]
pub fn noise<'py>(
    py: Python<'py>,
    keys: PyReadonlyArray1<'py, u64>,
    drawn: PyReadonlyArray1<'py, u64>,
    width: usize,
    normal: bool,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (keys, drawn) = (keys.as_slice()?, drawn.as_slice()?);
    let refuse = || PyValueError::new_err("keys, drawn, width: more numbers than memory holds");
    let count = keys.len().min(drawn.len()).checked_mul(width).ok_or_else(refuse)?;
    let mut numbers = Vec::new();
    numbers.try_reserve_exact(count).map_err(|_| refuse())?;
    for (key, drawn) in keys.iter().zip(drawn) {
        numbers.extend((0..width as u64).map(|k| share(*key, drawn.wrapping_add(k))));
    }
    if normal {
        quantiles(&mut numbers);
    }
    Ok(PyArray1::from_vec(py, numbers))
}

/// Return the quantiles of the standard normal distribution of shares between 0 and 1.
#[pyfunction]
pub fn quantile<'py>(
    py: Python<'py>,
    shares: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let mut numbers = shares.as_slice()?.to_vec();
    quantiles(&mut numbers);
    Ok(PyArray1::from_vec(py, numbers))
}

#[cfg(test)]
mod tests {
    use super::log;

    #[test]
    fn the_logarithm_is_exact() {
        for k in 1..4000 {
            let x = 0.5 * (f64::from(k) / 4000.0).powi(1 + k % 9);
            let wanted = x.ln();
            assert!((log(x) - wanted).abs() <= 4e-16 * wanted.abs().max(1.0), "{x}");
        }
    }
}
