//! Against numbers of 400 bits, and the corners by name.

use super::*;

/// `reference.py` makes it: a name, arguments, and the result in two numbers. The variable
/// `ELEMENTARY_REFERENCE` names a longer one.
const REFERENCE: &str = include_str!("reference.txt");

/// The distance from head + tail in units of the last place of head.
fn ulps(got: f64, head: f64, tail: f64) -> f64 {
    let ulp = f64::from_bits(head.abs().to_bits() + 1) - head.abs();
    ((got - head) - tail).abs() / ulp
}

fn call(name: &str, a: &[f64]) -> f64 {
    match name {
        "sin" => sin_cos(a[0]).0,
        "cos" => sin_cos(a[0]).1,
        "atan2" => atan2(a[0], a[1]),
        "exp" => exp(a[0]),
        "exp_m1" => exp_m1(a[0]),
        "ln" => ln(a[0]),
        _ => pow(a[0], a[1]),
    }
}

#[test]
fn every_function_is_within_its_error() {
    let limits = [
        ("sin", 1.0),
        ("cos", 1.0),
        ("atan2", 1.0),
        ("exp", 1.0),
        ("exp_m1", 3.0),
        ("ln", 1.0),
        ("pow", 1.0),
    ];
    let text =
        std::env::var("ELEMENTARY_REFERENCE").map(|path| std::fs::read_to_string(path).unwrap());
    let text = text.unwrap_or(REFERENCE.to_string());
    for (name, limit) in limits {
        let (mut most, mut at) = (0.0, String::new());
        let own = |line: &&str| line.split(' ').next() == Some(name);
        for line in text.lines().filter(own) {
            let number = |word| f64::from_bits(u64::from_str_radix(word, 16).unwrap());
            let numbers: Vec<f64> = line.split(' ').skip(1).map(number).collect();
            let (arguments, result) = numbers.split_at(numbers.len() - 2);
            let off = ulps(call(name, arguments), result[0], result[1]);
            if off.is_nan() || off > most {
                (most, at) = (off, format!("{arguments:?}"));
            }
        }
        println!("{name} {most} {at}");
        assert!(most > 0.0 && most < limit, "{name}{at}: {most} ulp, more than {limit}");
    }
}

/// As the C library has them, which is exact in these.
#[test]
fn corners_are_those_of_ieee_754() {
    let same = |name: &str, got: f64, want: f64| {
        assert!(
            got.to_bits() == want.to_bits() || got.is_nan() && want.is_nan(),
            "{name}: {got}, {want}"
        );
    };
    let inf = f64::INFINITY;
    let tiny = f64::from_bits(1);
    let all = [0.0, tiny, 1e-300, 0.5, 1.0, 2.0, 3.0, 1e300, f64::MAX, inf, f64::NAN];
    let all = || all.into_iter().flat_map(|x| [x, -x]);
    for x in [0.0, -0.0, tiny, -tiny, 1e-300, inf, -inf, f64::NAN] {
        same("sin", sin_cos(x).0, x.sin());
        same("cos", sin_cos(x).1, x.cos());
        same("exp", exp(x), x.exp());
        same("exp_m1", exp_m1(x), x.exp_m1());
    }
    for x in [0.0, -0.0, 1.0, -1.0, inf, -inf, f64::NAN] {
        same("ln", ln(x), x.ln());
    }
    for x in [710.0, 1e300, -746.0, -1e300] {
        same("exp", exp(x), x.exp());
    }
    for y in all() {
        for x in all() {
            let (angle, power) = (y.atan2(x), x.powf(y));
            if angle.abs() < 1e-290 || angle.abs() > 1e-3 {
                let off = (atan2(y, x) - angle).abs();
                assert!(off <= f64::EPSILON * angle.abs() || angle.is_nan(), "atan2({y}, {x})");
                assert_eq!(atan2(y, x).is_nan(), angle.is_nan());
                let sign = |x: f64| !x.is_nan() && x.is_sign_negative();
                assert_eq!(sign(atan2(y, x)), sign(angle));
            }
            if power == 0.0 || power.is_infinite() || power.is_nan() || power.abs() == 1.0 {
                same(&format!("{x}^{y}"), pow(x, y), power);
            }
        }
    }
}

/// A lane is a scalar, in every place and beside every neighbour.
#[test]
fn lanes_are_scalars() {
    let mut numbers = vec![0.0, -0.0, 1.0, 1e9, -1e300, f64::INFINITY, f64::NAN, 1e-320];
    numbers.extend((0..200).map(|i| 0.37 * f64::from(i) - 20.0));
    for k in 0..numbers.len() {
        let pick =
            |step: usize| crate::real::array::from_fn(|i| numbers[(k + step * i) % numbers.len()]);
        let (x, y): ([f64; 8], [f64; 8]) = (pick(1), pick(17));
        let ((sin, cos), angle, power) = (sin_cos_each(&x), atan2_each(&y, &x), pow_each(&x, &y));
        for i in 0..8 {
            let bits = |x: f64| x.to_bits();
            let (s, c) = sin_cos(x[i]);
            assert_eq!([sin[i], cos[i]].map(bits), [s, c].map(bits));
            assert_eq!(bits(angle[i]), bits(atan2(y[i], x[i])));
            assert_eq!(bits(power[i]), bits(pow(x[i], y[i])));
        }
    }
}

/// Operations on any numbers give the bits of those on `f64`.
#[test]
fn sines_are_the_same_by_the_operations_of_any_number() {
    let mut bits = 0x9E37_79B9_7F4A_7C15_u64;
    for turn in 0..200_000 {
        bits ^= bits << 13;
        bits ^= bits >> 7;
        bits ^= bits << 17;
        let unit = (bits >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
        let quarter = core::f64::consts::FRAC_PI_2 * (turn % 64 - 32) as f64;
        let size = [1e-9, 1e-3, 1.0, 10.0, 1e3, 3e6][turn as usize % 6];
        for x in [unit * size, quarter, quarter + 1e-12 * unit, 0.0, -0.0, f64::NAN] {
            let (sin, cos, near) = near_of(x);
            assert_eq!(near, x.abs() <= 1_647_099.0);
            let (s, c) = sin_cos(x);
            if near {
                assert_eq!((sin.to_bits(), cos.to_bits()), (s.to_bits(), c.to_bits()), "{x}");
            }
        }
    }
}
