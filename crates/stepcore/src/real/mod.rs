//! `Real`: the number the engine computes with, and its masks.
//!
//! Every stage is written once against this trait. `f64` and `f32` are one world; `Lanes` is eight
//! worlds in parallel, or sixteen of `f32`; `Dual` is one world whose numbers carry derivatives,
//! `Counted` one that counts its operations. A comparison gives a mask and `select` chooses where
//! lanes may differ. With a scalar a mask is a `bool`, so `if mask.none() { continue }` is an
//! ordinary branch.
//!
//! Rules that keep a lane equal, bit for bit, to the same world run alone: a
//! masked update is `select(mask, new, old)`; no fused multiply-add; no sum in
//! another order; one sine, cosine and power for all.

use core::fmt::Debug;
use core::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};
use nalgebra::Scalar;
use num_traits::{One, Zero};

/// Implementations from a number's four operations and `Real::of`: assignments, zero and one.
macro_rules! derived {
    ($type:ty: $($op:ident, $f:ident, $sign:tt;)*) => {
        $(impl core::ops::$op for $type {
            #[inline(always)]
            fn $f(&mut self, other: Self) {
                *self = *self $sign other;
            }
        })*
    };
    ($type:ty) => {
        derived!($type: AddAssign, add_assign, +; SubAssign, sub_assign, -;
            MulAssign, mul_assign, *; DivAssign, div_assign, /;);

        impl num_traits::Zero for $type {
            #[inline(always)]
            fn zero() -> Self {
                <Self as $crate::real::Real>::of(0.0)
            }
            fn is_zero(&self) -> bool {
                $crate::real::Real::lane(self, 0) == 0.0
            }
        }

        impl num_traits::One for $type {
            #[inline(always)]
            fn one() -> Self {
                <Self as $crate::real::Real>::of(1.0)
            }
        }
    };
}

/// A `Real` with one world.
macro_rules! scalar {
    ($one:ty, $value:ty) => {
        type Mask = bool;
        type One = $one;
        type Value = $value;
        const LANES: usize = 1;

        #[inline(always)]
        fn epsilon() -> f64 {
            <$one>::EPSILON.into()
        }
        #[inline(always)]
        fn select(mask: bool, yes: Self, no: Self) -> Self {
            if mask {
                yes
            } else {
                no
            }
        }
    };
}

pub mod array;
mod count;
mod counted;
mod dual;
pub mod elementary;
mod lanes;
mod stage;
pub(crate) mod value;

pub use count::Count;
pub use counted::{Counted, FUNCTION};
pub use dual::{Dual, Sampled, AROUND, WAYS};
pub use lanes::{ByWorld, LaneMask, Lanes, LanesF32, WIDEST, WIDTH};
pub use stage::Stage;

/// The number of roundings allowed between numbers that should be equal.
pub const ROUNDED: f64 = 16.0;

/// Returns whether two numbers are equal up to rounding.
pub(crate) fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= ROUNDED * f64::EPSILON * a.abs().max(b.abs())
}

/// One truth value per lane.
pub trait Mask: Copy + Debug + Send + Sync + 'static {
    const LANES: usize;

    /// The same truth value in every lane.
    fn of(value: bool) -> Self;
    fn and(self, other: Self) -> Self;
    fn or(self, other: Self) -> Self;
    fn not(self) -> Self;
    fn any(self) -> bool;
    #[inline(always)]
    fn none(self) -> bool {
        !self.any()
    }
    #[inline(always)]
    fn all(self) -> bool {
        self.not().none()
    }
    fn lane(&self, lane: usize) -> bool;
    fn from_lanes(value: impl Fn(usize) -> bool) -> Self;
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
    /// The number of one lane, with the same precision.
    type One: Real<Mask = bool, One = Self::One, Value = f64>;
    /// A number of the model, which may differ by world.
    type Value: Value<Self>;
    /// The number of worlds in one value.
    const LANES: usize;
    /// Whether that is one. Lanes do not compile code under `if R::ALONE`: piles, sleep, adaptive
    /// steps.
    const ALONE: bool = Self::LANES == 1;
    /// Whether several numbers of one world fill a register, so that sums run over padded places in
    /// functions of constant length. False where operations are counted, as these are not real
    /// ones, and for derivatives, whose functions would be large.
    const FILLS: bool = Self::ALONE;

    /// Unit roundoff of one lane, as an `f64`.
    fn epsilon() -> f64;
    /// The same number in every lane.
    fn of(value: f64) -> Self;
    fn lane(&self, lane: usize) -> f64;
    fn set_lane(&mut self, lane: usize, value: f64);
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    fn lt(self, other: Self) -> Self::Mask;
    fn le(self, other: Self) -> Self::Mask;
    #[inline(always)]
    fn gt(self, other: Self) -> Self::Mask {
        other.lt(self)
    }
    #[inline(always)]
    fn ge(self, other: Self) -> Self::Mask {
        other.le(self)
    }
    fn is_finite(self) -> Self::Mask;
    fn sqrt(self) -> Self;
    fn sin_cos(self) -> (Self, Self);
    fn atan2(self, x: Self) -> Self;
    fn powf(self, power: Self) -> Self;
    /// Returns this number; where the mask is true, with the slopes of `formula`, which gives the
    /// same number in a way that is differentiable there.
    #[inline(always)]
    fn with_slopes_of(self, _mask: Self::Mask, _formula: impl FnOnce() -> Self) -> Self {
        self
    }
    /// A solution x of F(x, p) = 0 found by iteration. Numbers with slopes get the slopes of
    /// `newton`, one Newton step from x taken as constant: x − F_x⁻¹F(x, p) has the value x and the
    /// slopes −F_x⁻¹F_p.
    #[inline(always)]
    fn implicit<const N: usize>(
        x: [Self; N],
        _newton: impl FnOnce([Self; N]) -> [Self; N],
    ) -> [Self; N] {
        x
    }
    /// Returns the largest slope, without its sign; 0 for numbers without slopes.
    #[inline(always)]
    fn steepness(self) -> f64 {
        0.0
    }
    /// Returns the largest of all lanes, for reports: no computation uses it.
    #[inline(always)]
    fn largest(self) -> f64 {
        (0..Self::LANES).map(|lane| self.lane(lane)).fold(f64::NEG_INFINITY, f64::max)
    }
    /// Marks the start of a stage: only numbers that count operations use it.
    #[inline(always)]
    fn enter(_: Stage) {}
    #[inline(always)]
    fn abs(self) -> Self {
        Self::select(self.lt(Self::zero()), -self, self)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::select(other.lt(self), other, self)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::select(self.lt(other), other, self)
    }
    #[inline(always)]
    fn clamp(self, lo: Self, hi: Self) -> Self {
        self.max(lo).min(hi)
    }
    /// Returns 1 / x, or 0 where x is not positive: a row that nothing can move.
    #[inline(always)]
    fn recip_or_zero(self) -> Self {
        Self::select(self.gt(Self::zero()), Self::one() / self, Self::zero())
    }
}

/// A number of a model.
pub trait Constant: Clone + Debug + PartialEq + Send + Sync + 'static {
    /// From numbers by lane: in all lanes zero or in none, infinite or not.
    fn by_lane(numbers: &[f64]) -> Self;
    /// Returns the number of one lane.
    fn lane(&self, lane: usize) -> f64;

    /// Whether it is zero, in every lane or in none.
    #[inline(always)]
    fn vanishes(&self) -> bool {
        self.lane(0) == 0.0
    }
    #[inline(always)]
    fn is_positive(&self) -> bool {
        self.lane(0) > 0.0
    }
    /// Whether it is infinite, in every lane or in none.
    #[inline(always)]
    fn is_infinite(&self) -> bool {
        self.lane(0).is_infinite()
    }
}

/// A number of a model, as steps of this `Real` read it.
pub trait Value<R: Real>: Constant {
    fn get(&self) -> R;
    /// Computes from several, in each lane in double precision, then round.
    fn calc<const N: usize>(of: [&Self; N], f: impl Fn([f64; N]) -> f64) -> R;
    #[inline(always)]
    fn times(&self, by: f64) -> R {
        Self::calc([self], |[x]| x * by)
    }
}

impl Constant for f64 {
    fn by_lane(numbers: &[f64]) -> Self {
        numbers[0]
    }
    #[inline(always)]
    fn lane(&self, _: usize) -> f64 {
        *self
    }
}

impl<R: Real> Value<R> for f64 {
    #[inline(always)]
    fn get(&self) -> R {
        R::of(*self)
    }
    #[inline(always)]
    fn calc<const N: usize>(of: [&Self; N], f: impl Fn([f64; N]) -> f64) -> R {
        R::of(f(array::map(of, |x| *x)))
    }
}

impl Mask for bool {
    const LANES: usize = 1;

    #[inline(always)]
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
    #[inline(always)]
    fn lane(&self, _: usize) -> bool {
        *self
    }
    #[inline(always)]
    fn from_lanes(value: impl Fn(usize) -> bool) -> Self {
        value(0)
    }
}

macro_rules! scalar_real {
    ($t:ty) => {
        impl Real for $t {
            scalar!($t, f64);
            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $t
            }
            #[inline(always)]
            fn lane(&self, _: usize) -> f64 {
                f64::from(*self)
            }
            #[inline(always)]
            fn set_lane(&mut self, _: usize, value: f64) {
                *self = value as $t;
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
                let (sin, cos) = elementary::sin_cos(f64::from(self));
                (sin as $t, cos as $t)
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                elementary::atan2(f64::from(self), f64::from(x)) as $t
            }
            #[inline(always)]
            fn powf(self, power: Self) -> Self {
                elementary::pow(f64::from(self), f64::from(power)) as $t
            }
        }
    };
}
scalar_real!(f64);
scalar_real!(f32);
