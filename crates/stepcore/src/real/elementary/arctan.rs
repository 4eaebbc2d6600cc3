//! The angle of a point: atan2.
//!
//! One division gives the tangent t of the angle's difference from the nearest of 0, atan ½ and π/4
//! in the first octant; its rounding error is computed and included. The polynomial is fdlibm's
//! (Sun Microsystems 1993, `s_atan.c`), accurate for |t| < 7/16.

const ATAN: [f64; 11] = [
    3.333_333_333_333_293e-1,
    -1.999_999_999_987_648_3e-1,
    1.428_571_427_250_346_6e-1,
    -1.111_111_040_546_235_6e-1,
    9.090_887_133_436_507e-2,
    -7.691_876_205_044_83e-2,
    6.661_073_137_387_531e-2,
    -5.833_570_133_790_573_5e-2,
    4.976_877_994_615_932_4e-2,
    -3.653_157_274_421_691_6e-2,
    1.628_582_011_536_578_2e-2,
];
/// Angles as the sum of two numbers.
const ATAN_HALF: [f64; 2] = [4.636_476_090_008_061e-1, 2.269_877_745_296_168_7e-17];
const QUARTER_PI: [f64; 2] = [core::f64::consts::FRAC_PI_4, 3.061_616_997_868_383e-17];
const HALF_PI: [f64; 2] = [core::f64::consts::FRAC_PI_2, 6.123_233_995_736_766e-17];
const PI: [f64; 2] = [core::f64::consts::PI, 1.224_646_799_147_353_2e-16];
/// Beyond 2^±500 both coordinates are scaled, so that no reciprocal overflows.
const LARGE: f64 = 3.273_390_607_896_142e150;
const SMALL: f64 = 1.0 / LARGE;
const SCALE: f64 = 4.149_515_568_880_993e180; // 2⁶⁰⁰

/// Zeros, infinities and NaN give the results of IEEE 754.
#[inline(always)]
pub fn atan2(y: f64, x: f64) -> f64 {
    let (a, b) = (y.abs(), x.abs());
    let steep = a > b;
    let (less, more) = if steep { (b, a) } else { (a, b) };
    let scale = if more > LARGE { 1.0 / SCALE } else { 1.0 };
    let scale = if more < SMALL { SCALE } else { scale };
    // Two infinities are a diagonal, one is an axis, and so is the origin.
    let diagonal = less == f64::INFINITY;
    let axis = (more == 0.0) | (more == f64::INFINITY);
    let (less, more) = (less * scale, more * scale);
    let (less, more) = if axis { (0.0, 1.0) } else { (less, more) };
    let (less, more) = if diagonal { (1.0, 1.0) } else { (less, more) };

    let (above, below) = (less > 0.6875 * more, less < 0.4375 * more);
    let middle = if above { 1.0 } else { 0.5 };
    let middle = if below { 0.0 } else { middle };
    let over = less - middle * more;
    let under = more + middle * less;
    let inverse = 1.0 / under;
    let t = over * inverse;
    let rest = remainder(over, t, under) * inverse;
    let z = t * t;
    let w = z * z;
    let odd = w * (ATAN[1] + w * (ATAN[3] + w * (ATAN[5] + w * (ATAN[7] + w * ATAN[9]))));
    let even = z
        * (ATAN[0] + w * (ATAN[2] + w * (ATAN[4] + w * (ATAN[6] + w * (ATAN[8] + w * ATAN[10])))));
    // d atan t = dt/(1 + t²), of which two terms suffice for a rounding error.
    let beyond = t - (t * (even + odd) - rest * (1.0 - z));

    // The octant: ± the angle from a multiple of π/2.
    let back = x.is_sign_negative();
    let turn = if steep { HALF_PI } else { [0.0, 0.0] };
    let turn = if back & !steep { PI } else { turn };
    let start = if above { QUARTER_PI } else { ATAN_HALF };
    let start = if below { [0.0, 0.0] } else { start };
    let sign = if steep != back { -1.0 } else { 1.0 };
    let head = turn[0] + sign * start[0];
    // Exact, as the turn is 0 or the larger one.
    let error = if steep | back { (turn[0] - head) + sign * start[0] } else { 0.0 };
    let angle = head + (error + (turn[1] + sign * start[1]) + sign * beyond);
    let angle = f64::from_bits(angle.to_bits() | y.to_bits() & 1 << 63);
    if x.is_nan() | y.is_nan() {
        f64::NAN
    } else {
        angle
    }
}

/// Returns over − t·under, with products of halves that are exact.
#[inline(always)]
fn remainder(over: f64, t: f64, under: f64) -> f64 {
    let high = |x: f64| f64::from_bits(x.to_bits() & !((1 << 27) - 1));
    let (t_high, under_high) = (high(t), high(under));
    let (t_low, under_low) = (t - t_high, under - under_high);
    (((over - t_high * under_high) - t_high * under_low) - t_low * under_high) - t_low * under_low
}
