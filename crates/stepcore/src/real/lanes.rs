//! `Lanes`: several worlds side by side.
//!
//! A mask is a word a lane, as wide as its number, all ones or all zeros: what a vector
//! comparison gives and a vector choice takes. No instruction is named here. Each operation is a
//! loop over the lanes that a compiler makes vectors of, whatever it compiles for.

use core::fmt::Debug;
use core::ops::{Add, AddAssign, BitAnd, BitOr, Div, DivAssign, Mul, MulAssign, Neg, Not};
use core::ops::{Sub, SubAssign};
use num_traits::{One, Zero};

use super::{elementary, Mask, Real};

/// How many `f64` worlds stand side by side.
pub const WIDTH: usize = 8;

/// How many worlds any kind of lanes holds at most.
pub(crate) const MOST: usize = 16;

/// Eight worlds of `f64`, if nothing else is said.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Lanes<T = f64, const W: usize = WIDTH>(pub [T; W]);

/// Sixteen worlds of `f32`.
pub type LanesF32 = Lanes<f32, 16>;

/// One truth value for each world: all ones or all zeros.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct LaneMask<B = u64, const W: usize = WIDTH>([B; W]);

/// The bits of a number.
pub trait Word:
    Copy
    + Debug
    + PartialEq
    + BitAnd<Output = Self>
    + BitOr<Output = Self>
    + Not<Output = Self>
    + Send
    + Sync
    + 'static
{
    const NONE: Self;
    const ALL: Self;
}

/// A number of which lanes are made.
pub trait Number: Real<Mask = bool, One = Self> + PartialOrd + Into<f64> {
    type Bits: Word;
    fn bits(self) -> Self::Bits;
    fn of_bits(bits: Self::Bits) -> Self;
}

macro_rules! number {
    ($number:ty, $bits:ty) => {
        impl Word for $bits {
            const NONE: Self = 0;
            const ALL: Self = !0;
        }
        impl Number for $number {
            type Bits = $bits;
            #[inline(always)]
            fn bits(self) -> $bits {
                self.to_bits()
            }
            #[inline(always)]
            fn of_bits(bits: $bits) -> Self {
                Self::from_bits(bits)
            }
        }
    };
}
number!(f64, u64);
number!(f32, u32);

#[inline(always)]
fn word<B: Word>(value: bool) -> B {
    if value {
        B::ALL
    } else {
        B::NONE
    }
}

impl<B: Word, const W: usize> Mask for LaneMask<B, W> {
    const LANES: usize = W;

    #[inline(always)]
    fn of(value: bool) -> Self {
        Self([word(value); W])
    }
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        Self(core::array::from_fn(|i| self.0[i] & other.0[i]))
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        Self(core::array::from_fn(|i| self.0[i] | other.0[i]))
    }
    #[inline(always)]
    fn not(self) -> Self {
        Self(self.0.map(|a| !a))
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.0.into_iter().fold(B::NONE, |all, a| all | a) != B::NONE
    }
    #[inline(always)]
    fn lane(&self, lane: usize) -> bool {
        self.0[lane] != B::NONE
    }
    #[inline(always)]
    fn from_lanes(value: impl Fn(usize) -> bool) -> Self {
        Self(core::array::from_fn(|i| word(value(i))))
    }
}

impl<T: Number, const W: usize> Lanes<T, W> {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(T, T) -> T) -> Self {
        Self(core::array::from_fn(|i| f(self.0[i], other.0[i])))
    }
    #[inline(always)]
    fn compare(self, other: Self, f: impl Fn(T, T) -> bool) -> LaneMask<T::Bits, W> {
        LaneMask(core::array::from_fn(|i| word(f(self.0[i], other.0[i]))))
    }
    #[inline(always)]
    fn wide(self) -> [f64; W] {
        self.0.map(Into::into)
    }
    #[inline(always)]
    fn narrow(wide: [f64; W]) -> Self {
        Self(wide.map(T::of))
    }
}

macro_rules! lane_operator {
    ($op:ident, $f:ident, $assign:ident, $g:ident, $sign:tt) => {
        impl<T: Number, const W: usize> $op for Lanes<T, W> {
            type Output = Self;
            #[inline(always)]
            fn $f(self, other: Self) -> Self {
                self.zip(other, |a, b| a $sign b)
            }
        }
        impl<T: Number, const W: usize> $assign for Lanes<T, W> {
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

impl<T: Number, const W: usize> Neg for Lanes<T, W> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.0.map(|a| -a))
    }
}

impl<T: Number, const W: usize> Zero for Lanes<T, W> {
    #[inline(always)]
    fn zero() -> Self {
        Self([T::zero(); W])
    }
    fn is_zero(&self) -> bool {
        *self == Self::zero()
    }
}

impl<T: Number, const W: usize> One for Lanes<T, W> {
    #[inline(always)]
    fn one() -> Self {
        Self([T::one(); W])
    }
}

impl<T: Number, const W: usize> Real for Lanes<T, W> {
    type Mask = LaneMask<T::Bits, W>;
    type One = T;
    const LANES: usize = W;

    #[inline(always)]
    fn epsilon() -> f64 {
        T::epsilon()
    }
    #[inline(always)]
    fn of(value: f64) -> Self {
        Self([T::of(value); W])
    }
    #[inline(always)]
    fn lane(&self, lane: usize) -> f64 {
        self.0[lane].into()
    }
    #[inline(always)]
    fn set_lane(&mut self, lane: usize, value: f64) {
        self.0[lane] = T::of(value);
    }
    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        Self(core::array::from_fn(|i| {
            let mask = mask.0[i];
            T::of_bits(yes.0[i].bits() & mask | no.0[i].bits() & !mask)
        }))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self::Mask {
        self.compare(other, |a, b| a < b)
    }
    #[inline(always)]
    fn le(self, other: Self) -> Self::Mask {
        self.compare(other, |a, b| a <= b)
    }
    #[inline(always)]
    fn is_finite(self) -> Self::Mask {
        LaneMask(self.0.map(|a| word(a.is_finite())))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(T::sqrt))
    }
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = elementary::sin_cos_each(&self.wide());
        (Self::narrow(sin), Self::narrow(cos))
    }
    fn atan2(self, x: Self) -> Self {
        Self::narrow(elementary::atan2_each(&self.wide(), &x.wide()))
    }
    fn powf(self, power: Self) -> Self {
        Self::narrow(elementary::pow_each(&self.wide(), &power.wide()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn a_lane_is_a_scalar<T: Number, const W: usize>() {
        let number = |i: usize| T::of(0.3 * i as f64 - 1.0);
        let x = Lanes::<T, W>(core::array::from_fn(number));
        let (s, c) = x.sin_cos();
        let y = Lanes::select(x.lt(Lanes::zero()), s * c, x.abs().sqrt());
        for i in 0..W {
            let a = number(i);
            let (s, c) = a.sin_cos();
            let one = if a < T::zero() { s * c } else { a.sqrt() };
            assert_eq!(y.0[i].bits(), one.bits());
            assert_eq!(x.le(Lanes::zero()).lane(i), a <= T::zero());
        }
    }

    #[test]
    fn lanes_are_scalars() {
        a_lane_is_a_scalar::<f64, 8>();
        a_lane_is_a_scalar::<f32, 16>();
    }
}
