//! `Lanes`: eight worlds of `f64` side by side.

use core::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};
use num_traits::{One, Zero};

use super::{elementary, Mask, Real};

/// How many worlds a lane register holds.
pub const WIDTH: usize = 8;

/// Eight `f64` worlds side by side.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Lanes(pub [f64; WIDTH]);

/// One truth value for each of the eight worlds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaneMask(pub [bool; WIDTH]);

impl LaneMask {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(bool, bool) -> bool) -> Self {
        Self(core::array::from_fn(|i| f(self.0[i], other.0[i])))
    }
}

impl Mask for LaneMask {
    const LANES: usize = WIDTH;

    fn of(value: bool) -> Self {
        Self([value; WIDTH])
    }
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self.zip(other, |a, b| a & b)
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        self.zip(other, |a, b| a | b)
    }
    #[inline(always)]
    fn not(self) -> Self {
        Self(self.0.map(|a| !a))
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.0.iter().any(|a| *a)
    }
    #[inline(always)]
    fn lane(self, lane: usize) -> bool {
        self.0[lane]
    }
    #[inline(always)]
    fn from_lanes(value: impl Fn(usize) -> bool) -> Self {
        Self(core::array::from_fn(value))
    }
}

impl Lanes {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        Self(core::array::from_fn(|i| f(self.0[i], other.0[i])))
    }
    #[inline(always)]
    fn compare(self, other: Self, f: impl Fn(f64, f64) -> bool) -> LaneMask {
        LaneMask(core::array::from_fn(|i| f(self.0[i], other.0[i])))
    }
}

macro_rules! lane_operator {
    ($op:ident, $f:ident, $assign:ident, $g:ident, $sign:tt) => {
        impl $op for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $f(self, other: Self) -> Self {
                self.zip(other, |a, b| a $sign b)
            }
        }
        impl $assign for Lanes {
            #[inline(always)]
            fn $g(&mut self, other: Self) {
                *self = *self $sign other;
            }
        }
    };
}
lane_operator!(Add, add, AddAssign, add_assign, +);
lane_operator!(Sub, sub, SubAssign, sub_assign, -);
lane_operator!(Mul, mul, MulAssign, mul_assign, *);
lane_operator!(Div, div, DivAssign, div_assign, /);

impl Neg for Lanes {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.0.map(|a| -a))
    }
}

impl Zero for Lanes {
    #[inline(always)]
    fn zero() -> Self {
        Self([0.0; WIDTH])
    }
    fn is_zero(&self) -> bool {
        *self == Self::zero()
    }
}

impl One for Lanes {
    #[inline(always)]
    fn one() -> Self {
        Self([1.0; WIDTH])
    }
}

impl Real for Lanes {
    type Mask = LaneMask;
    const LANES: usize = WIDTH;
    const EPSILON: f64 = f64::EPSILON;

    #[inline(always)]
    fn of(value: f64) -> Self {
        Self([value; WIDTH])
    }
    #[inline(always)]
    fn lane(self, lane: usize) -> f64 {
        self.0[lane]
    }
    #[inline(always)]
    fn set_lane(&mut self, lane: usize, value: f64) {
        self.0[lane] = value;
    }
    #[inline(always)]
    fn select(mask: LaneMask, yes: Self, no: Self) -> Self {
        Self(core::array::from_fn(|i| if mask.0[i] { yes.0[i] } else { no.0[i] }))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> LaneMask {
        self.compare(other, |a, b| a < b)
    }
    #[inline(always)]
    fn le(self, other: Self) -> LaneMask {
        self.compare(other, |a, b| a <= b)
    }
    fn is_finite(self) -> LaneMask {
        LaneMask(self.0.map(f64::is_finite))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(f64::sqrt))
    }
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = elementary::sin_cos_each(&self.0);
        (Self(sin), Self(cos))
    }
    fn atan2(self, x: Self) -> Self {
        Self(elementary::atan2_each(&self.0, &x.0))
    }
    fn powf(self, power: Self) -> Self {
        Self(elementary::pow_each(&self.0, &power.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lane_is_a_scalar() {
        let mut x = Lanes::of(0.0);
        for i in 0..WIDTH {
            x.set_lane(i, 0.3 * i as f64 - 1.0);
        }
        let (s, c) = x.sin_cos();
        let y = Lanes::select(x.lt(Lanes::zero()), s * c, x.abs().sqrt());
        for i in 0..WIDTH {
            let a = 0.3 * i as f64 - 1.0;
            let one = if a < 0.0 { Real::sin_cos(a).0 * Real::sin_cos(a).1 } else { a.sqrt() };
            assert_eq!(y.lane(i).to_bits(), one.to_bits());
        }
    }
}
