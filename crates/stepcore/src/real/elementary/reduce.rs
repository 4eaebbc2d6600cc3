//! A large angle minus its quarter turns, exactly (Payne and Hanek 1983).
//!
//! For x = m·2ᵉ, x·2/π needs only the bits of 2/π that give the last two bits of the integer part
//! and enough of the fraction: bits of more weight give multiples of four quarter turns.

/// The bits of 2/π behind the point, after a word of zeros.
const TWO_OVER_PI: [u64; 21] = [
    0,
    0xA2F9_836E_4E44_1529,
    0xFC27_57D1_F534_DDC0,
    0xDB62_9599_3C43_9041,
    0xFE51_63AB_DEBB_C561,
    0xB724_6E3A_424D_D2E0,
    0x0649_2EEA_09D1_921C,
    0xFE1D_EB1C_B129_A73E,
    0xE882_35F5_2EBB_4484,
    0xE99C_7026_B45F_7E41,
    0x3991_D639_8353_39F4,
    0x9C84_5F8B_BDF9_283B,
    0x1FF8_97FF_DE05_980F,
    0xEF2F_118B_5A0A_6D1F,
    0x6D36_7ECF_27CB_09B7,
    0x4F46_3F66_9E5F_EA2D,
    0x7527_BAC7_EBE5_F17B,
    0x3D07_39F7_8A52_92EA,
    0x6BFB_5FB1_1F8D_5D08,
    0x5603_3046_FC7B_6BAB,
    0xF0CF_BC20_9AF4_361D,
];
/// π/2 as the sum of two numbers.
const HALF_PI: [f64; 2] = [core::f64::consts::FRAC_PI_2, 6.123_233_995_736_766e-17];

/// Returns the quarter turns, of which the last two bits count, and the rest of x > 2²⁰ in two numbers.
pub fn quarters(x: f64) -> (u64, f64, f64) {
    let bits = x.to_bits();
    let mantissa = u128::from(bits & ((1 << 52) - 1) | 1 << 52);
    let exponent = (bits >> 52) as i64 - 1075;
    // 192 bits, of which the first has the weight 2^(1 − exponent).
    let at = (exponent + 62) as usize;
    let word = |k: usize| {
        let (k, shift) = (at / 64 + k, at % 64);
        let next = TWO_OVER_PI.get(k + 1).copied().unwrap_or(0);
        let both = u128::from(TWO_OVER_PI[k]) << 64 | u128::from(next);
        (both >> (64 - shift)) as u64
    };
    // Their product with the mantissa in units of 2⁻¹⁹⁰ quarter turns, minus multiples of four.
    let low = mantissa * u128::from(word(2));
    let middle = mantissa * u128::from(word(1)) + (low >> 64);
    let high = (mantissa * u128::from(word(0)) + (middle >> 64)) as u64;
    let whole = u128::from(high) << 64 | u128::from(middle as u64);
    let last = low as u64;
    // To the nearest quarter turn; the rest has a sign.
    let n = (high >> 62) + (high >> 61 & 1);
    let (whole, last) = (whole << 2 | u128::from(last >> 62), last << 2);
    let negative = whole >> 127 == 1;
    let (whole, last) = if negative {
        let (last, carry) = (!last).overflowing_add(1);
        ((!whole).wrapping_add(u128::from(carry)), last)
    } else {
        (whole, last)
    };
    // No number comes closer to a quarter turn than 2⁻⁶².
    let zeros = whole.leading_zeros().clamp(1, 63);
    let digits = whole << zeros | u128::from(last) >> (64 - zeros);
    let head = (digits >> 75) as f64;
    let tail = ((digits >> 22) as u64 & ((1 << 53) - 1)) as f64;
    let scale = power_of_two(-53 - zeros as i32);
    let (head, tail) = (head * scale, tail * scale * power_of_two(-53));
    // Times π/2: the product of the heads in two numbers, by halves of 26 bits.
    let halves = |x: f64| {
        let high = f64::from_bits(x.to_bits() & !((1 << 27) - 1));
        (high, x - high)
    };
    let ((a, b), (c, d)) = (halves(head), halves(HALF_PI[0]));
    let product = head * HALF_PI[0];
    let error = ((a * c - product) + a * d + b * c) + b * d;
    let rest = error + (head * HALF_PI[1] + tail * HALF_PI[0]);
    let angle = product + rest;
    let rest = (product - angle) + rest;
    if negative {
        (n, -angle, -rest)
    } else {
        (n, angle, rest)
    }
}

fn power_of_two(exponent: i32) -> f64 {
    f64::from_bits(((1023 + exponent) as u64) << 52)
}
