//! `Real`: the number the engine computes with, and its masks.
//!
//! Every stage is written once against this trait. `f64` and `f32` are one
//! world; `Lanes` is eight worlds side by side. A comparison gives a mask and
//! `select` chooses where lanes may differ. With a scalar a mask is a `bool`, so
//! `if mask.none() { continue }` is an ordinary branch.
//!
//! Rules that keep a lane equal, bit for bit, to the same world run alone: a
//! masked update is `select(mask, new, old)`; no fused multiply-add; no sum in
//! another order; one sine, cosine and power for all.

use core::fmt::Debug;
use core::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};
use nalgebra::Scalar;
use num_traits::{One, Zero};

/// One truth value a lane.
pub trait Mask: Copy + Debug + Send + Sync + 'static {
    /// The same truth value in every lane.
    fn of(value: bool) -> Self;
    fn and(self, other: Self) -> Self;
    fn or(self, other: Self) -> Self;
    fn not(self) -> Self;
    fn any(self) -> bool;
    fn none(self) -> bool {
        !self.any()
    }
    fn all(self) -> bool {
        self.not().none()
    }
    fn lane(self, lane: usize) -> bool;
}

/// The closed set of operations a stage may use.
pub trait Real:
    Scalar
    + Copy
    + Zero
    + One
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + DivAssign
    + Send
    + Sync
{
    type Mask: Mask;
    /// How many worlds one value holds.
    const LANES: usize;
    /// Unit roundoff of one lane, as an `f64`.
    const EPSILON: f64;

    /// The same number in every lane.
    fn of(value: f64) -> Self;
    fn lane(self, lane: usize) -> f64;
    fn set_lane(&mut self, lane: usize, value: f64);
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    fn lt(self, other: Self) -> Self::Mask;
    fn le(self, other: Self) -> Self::Mask;
    fn gt(self, other: Self) -> Self::Mask {
        other.lt(self)
    }
    fn ge(self, other: Self) -> Self::Mask {
        other.le(self)
    }
    fn is_finite(self) -> Self::Mask;
    fn sqrt(self) -> Self;
    fn sin_cos(self) -> (Self, Self);
    fn atan2(self, x: Self) -> Self;
    fn powf(self, power: Self) -> Self;
    fn abs(self) -> Self {
        Self::select(self.lt(Self::zero()), -self, self)
    }
    fn min(self, other: Self) -> Self {
        Self::select(other.lt(self), other, self)
    }
    fn max(self, other: Self) -> Self {
        Self::select(self.lt(other), other, self)
    }
    fn clamp(self, lo: Self, hi: Self) -> Self {
        self.max(lo).min(hi)
    }
    /// 1 / x, and 0 where x is not positive: a row that nothing can move.
    fn recip_or_zero(self) -> Self {
        Self::select(self.gt(Self::zero()), Self::one() / self, Self::zero())
    }
}

impl Mask for bool {
    fn of(value: bool) -> Self {
        value
    }
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self && other
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        self || other
    }
    #[inline(always)]
    fn not(self) -> Self {
        !self
    }
    #[inline(always)]
    fn any(self) -> bool {
        self
    }
    #[inline(always)]
    fn all(self) -> bool {
        self
    }
    fn lane(self, _: usize) -> bool {
        self
    }
}

macro_rules! scalar_real {
    ($t:ty) => {
        impl Real for $t {
            type Mask = bool;
            const LANES: usize = 1;
            const EPSILON: f64 = <$t>::EPSILON as f64;

            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $t
            }
            #[inline(always)]
            fn lane(self, _: usize) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn set_lane(&mut self, _: usize, value: f64) {
                *self = value as $t;
            }
            #[inline(always)]
            fn select(mask: bool, yes: Self, no: Self) -> Self {
                if mask {
                    yes
                } else {
                    no
                }
            }
            #[inline(always)]
            fn lt(self, other: Self) -> bool {
                self < other
            }
            #[inline(always)]
            fn le(self, other: Self) -> bool {
                self <= other
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                <$t>::is_finite(self)
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                <$t>::sqrt(self)
            }
            #[inline(always)]
            fn sin_cos(self) -> (Self, Self) {
                <$t>::sin_cos(self)
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                <$t>::atan2(self, x)
            }
            #[inline(always)]
            fn powf(self, power: Self) -> Self {
                <$t>::powf(self, power)
            }
        }
    };
}
scalar_real!(f64);
scalar_real!(f32);

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
    fn lane(self, lane: usize) -> bool {
        self.0[lane]
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
        let both = self.0.map(f64::sin_cos);
        (Self(both.map(|p| p.0)), Self(both.map(|p| p.1)))
    }
    fn atan2(self, x: Self) -> Self {
        self.zip(x, f64::atan2)
    }
    fn powf(self, power: Self) -> Self {
        self.zip(power, f64::powf)
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
            let one = if a < 0.0 { a.sin() * a.cos() } else { a.sqrt() };
            assert_eq!(y.lane(i).to_bits(), one.to_bits());
        }
    }
}
