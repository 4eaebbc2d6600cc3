//! `Lanes`: several worlds in parallel.
//!
//! A mask is one word per lane, as wide as its number, all ones or all zeros: the result of a
//! vector comparison and the input of a vector selection. Each operation names its vectors
//! explicitly: from single lanes, a compiler would take eight numbers of single precision apart and
//! put them together again. The crate `wide` handles the vectors of each processor.

use bytemuck::cast;
use core::fmt::Debug;
use core::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};
use num_traits::{One, Zero};
use wide::{f32x8, f64x4, CmpLe, CmpLt};

use super::{array, elementary, Constant, Mask, Real, Value};

/// The number of parallel worlds of `f64`: with fewer, a register would have as many branches for
/// less work; with more, it would build the rows of more worlds that touch in other places.
pub const WIDTH: usize = 8;
/// The number for `f32`, in as many vectors; the largest.
pub const WIDEST: usize = 2 * WIDTH;

/// Parallel worlds: eight of `f64` by default.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(32))]
pub struct Lanes<T = f64, const W: usize = WIDTH>(pub [T; W]);

/// Sixteen worlds of `f32`.
pub type LanesF32 = Lanes<f32, WIDEST>;

/// One truth value per world: all ones or all zeros.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(32))]
pub struct LaneMask<B = u64, const W: usize = WIDTH>([B; W]);

/// The bits of a number, and operations on the bits of all lanes.
pub trait Word<const W: usize>: Copy + Debug + PartialEq + Send + Sync + 'static {
    const NONE: Self;
    const ALL: Self;
    fn both(a: [Self; W], b: [Self; W]) -> [Self; W];
    fn either(a: [Self; W], b: [Self; W]) -> [Self; W];
    fn other(a: [Self; W]) -> [Self; W];
    fn any(a: [Self; W]) -> bool;
    fn all(a: [Self; W]) -> bool;
}

/// A number type of lanes, and operations on all of them.
pub trait Number<const W: usize>:
    Real<Mask = bool, One = Self, Value = f64> + PartialOrd + Into<f64>
{
    type Bits: Word<W>;
    fn repeat(x: Self) -> [Self; W];
    fn plus(a: [Self; W], b: [Self; W]) -> [Self; W];
    fn subtract(a: [Self; W], b: [Self; W]) -> [Self; W];
    fn multiply(a: [Self; W], b: [Self; W]) -> [Self; W];
    fn divide(a: [Self; W], b: [Self; W]) -> [Self; W];
    fn negative(a: [Self; W]) -> [Self; W];
    fn root(a: [Self; W]) -> [Self; W];
    fn less(a: [Self; W], b: [Self; W]) -> [Self::Bits; W];
    fn at_most(a: [Self; W], b: [Self; W]) -> [Self::Bits; W];
    fn choose(mask: [Self::Bits; W], yes: [Self; W], no: [Self; W]) -> [Self; W];
}

/// A number and its bits, `$w` of them in vectors of `$vector`: this many vectors, by index.
macro_rules! number {
    ($number:ty, $bits:ty, $w:ident, $vector:ty, [$($at:literal),*]) => {
        const _: () = {
            type Vectors = [$vector; [$($at),*].len()];

            impl Word<$w> for $bits {
                const NONE: Self = 0;
                const ALL: Self = !0;
                #[inline(always)]
                fn both(a: [Self; $w], b: [Self; $w]) -> [Self; $w] {
                    let (a, b): (Vectors, Vectors) = (cast(a), cast(b));
                    cast([$(a[$at] & b[$at]),*])
                }
                #[inline(always)]
                fn either(a: [Self; $w], b: [Self; $w]) -> [Self; $w] {
                    let (a, b): (Vectors, Vectors) = (cast(a), cast(b));
                    cast([$(a[$at] | b[$at]),*])
                }
                #[inline(always)]
                fn other(a: [Self; $w]) -> [Self; $w] {
                    let a: Vectors = cast(a);
                    cast([$(!a[$at]),*])
                }
                #[inline(always)]
                fn any(a: [Self; $w]) -> bool {
                    let a: Vectors = cast(a);
                    false $(|| a[$at].any())*
                }
                #[inline(always)]
                fn all(a: [Self; $w]) -> bool {
                    let a: Vectors = cast(a);
                    true $(&& a[$at].all())*
                }
            }

            impl Number<$w> for $number {
                type Bits = $bits;
                #[inline(always)]
                fn repeat(x: Self) -> [Self; $w] {
                    cast([$({ let _ = $at; <$vector>::splat(x) }),*])
                }
                #[inline(always)]
                fn plus(a: [Self; $w], b: [Self; $w]) -> [Self; $w] {
                    let (a, b): (Vectors, Vectors) = (cast(a), cast(b));
                    cast([$(a[$at] + b[$at]),*])
                }
                #[inline(always)]
                fn subtract(a: [Self; $w], b: [Self; $w]) -> [Self; $w] {
                    let (a, b): (Vectors, Vectors) = (cast(a), cast(b));
                    cast([$(a[$at] - b[$at]),*])
                }
                #[inline(always)]
                fn multiply(a: [Self; $w], b: [Self; $w]) -> [Self; $w] {
                    let (a, b): (Vectors, Vectors) = (cast(a), cast(b));
                    cast([$(a[$at] * b[$at]),*])
                }
                #[inline(always)]
                fn divide(a: [Self; $w], b: [Self; $w]) -> [Self; $w] {
                    let (a, b): (Vectors, Vectors) = (cast(a), cast(b));
                    cast([$(a[$at] / b[$at]),*])
                }
                #[inline(always)]
                fn negative(a: [Self; $w]) -> [Self; $w] {
                    // Flip the sign bit: 0 − a would turn 0 into 0, not −0.
                    let (a, sign): (Vectors, _) = (cast(a), <$vector>::splat(-0.0));
                    cast([$(a[$at] ^ sign),*])
                }
                #[inline(always)]
                fn root(a: [Self; $w]) -> [Self; $w] {
                    let a: Vectors = cast(a);
                    cast([$(a[$at].sqrt()),*])
                }
                #[inline(always)]
                fn less(a: [Self; $w], b: [Self; $w]) -> [$bits; $w] {
                    let (a, b): (Vectors, Vectors) = (cast(a), cast(b));
                    cast([$(a[$at].cmp_lt(b[$at])),*])
                }
                #[inline(always)]
                fn at_most(a: [Self; $w], b: [Self; $w]) -> [$bits; $w] {
                    let (a, b): (Vectors, Vectors) = (cast(a), cast(b));
                    cast([$(a[$at].cmp_le(b[$at])),*])
                }
                #[inline(always)]
                fn choose(
                    mask: [$bits; $w],
                    yes: [Self; $w],
                    no: [Self; $w],
                ) -> [Self; $w] {
                    // A blend stored to its source would become a masked store, which on some
                    // processors takes twenty times as long as a plain one.
                    let (yes, no): (Vectors, Vectors) = (cast(yes), cast(no));
                    let mask: Vectors = cast(mask);
                    cast([$((yes[$at] & mask[$at]) | (no[$at] & !mask[$at])),*])
                }
            }
        };
    };
}
number!(f64, u64, WIDTH, f64x4, [0, 1]);
number!(f32, u32, WIDEST, f32x8, [0, 1]);

#[inline(always)]
fn word<B: Word<W>, const W: usize>(value: bool) -> B {
    if value {
        B::ALL
    } else {
        B::NONE
    }
}

impl<B: Word<W>, const W: usize> Mask for LaneMask<B, W> {
    const LANES: usize = W;

    #[inline(always)]
    fn of(value: bool) -> Self {
        Self([word(value); W])
    }
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        Self(B::both(self.0, other.0))
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        Self(B::either(self.0, other.0))
    }
    #[inline(always)]
    fn not(self) -> Self {
        Self(B::other(self.0))
    }
    #[inline(always)]
    fn any(self) -> bool {
        B::any(self.0)
    }
    #[inline(always)]
    fn all(self) -> bool {
        B::all(self.0)
    }
    #[inline(always)]
    fn lane(&self, lane: usize) -> bool {
        self.0[lane] != B::NONE
    }
    #[inline(always)]
    fn from_lanes(value: impl Fn(usize) -> bool) -> Self {
        Self(crate::real::array::from_fn(|i| word(value(i))))
    }
}

impl<T: Number<W>, const W: usize> Lanes<T, W> {
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
    ($op:ident, $f:ident, $assign:ident, $g:ident, $sign:tt, $lanes:ident) => {
        impl<T: Number<W>, const W: usize> $op for Lanes<T, W> {
            type Output = Self;
            #[inline(always)]
            fn $f(self, other: Self) -> Self {
                Self(T::$lanes(self.0, other.0))
            }
        }
        impl<T: Number<W>, const W: usize> $assign for Lanes<T, W> {
            #[inline(always)]
            fn $g(&mut self, other: Self) {
                *self = *self $sign other;
            }
        }
    };
}
lane_operator!(Add, add, AddAssign, add_assign, +, plus);
lane_operator!(Sub, sub, SubAssign, sub_assign, -, subtract);
lane_operator!(Mul, mul, MulAssign, mul_assign, *, multiply);
lane_operator!(Div, div, DivAssign, div_assign, /, divide);

impl<T: Number<W>, const W: usize> Neg for Lanes<T, W> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(T::negative(self.0))
    }
}

impl<T: Number<W>, const W: usize> Zero for Lanes<T, W> {
    #[inline(always)]
    fn zero() -> Self {
        Self(T::repeat(T::zero()))
    }
    fn is_zero(&self) -> bool {
        *self == Self::zero()
    }
}

impl<T: Number<W>, const W: usize> One for Lanes<T, W> {
    #[inline(always)]
    fn one() -> Self {
        Self(T::repeat(T::one()))
    }
}

/// The same number in all lanes, or one per lane.
#[derive(Clone, Debug, PartialEq)]
pub enum ByWorld<R, const W: usize> {
    Same(f64),
    Each(Box<Each<R, W>>),
}

/// The numbers of all lanes, rounded and exact.
#[derive(Clone, Debug, PartialEq)]
pub struct Each<R, const W: usize> {
    rounded: R,
    given: [f64; W],
}

impl<T: Number<W>, const W: usize> Constant for ByWorld<Lanes<T, W>, W> {
    /// The last lanes repeat the last number.
    fn by_lane(numbers: &[f64]) -> Self {
        let (first, last) = (numbers[0], numbers.len() - 1);
        if numbers.iter().all(|x| x.to_bits() == first.to_bits()) {
            return Self::Same(first);
        }
        let given = crate::real::array::from_fn(|lane| numbers[lane.min(last)]);
        Self::Each(Box::new(Each { rounded: Lanes(array::map(given, T::of)), given }))
    }
    #[inline(always)]
    fn lane(&self, lane: usize) -> f64 {
        match self {
            Self::Same(x) => *x,
            Self::Each(each) => each.given[lane],
        }
    }
}

impl<T: Number<W>, const W: usize> Value<Lanes<T, W>> for ByWorld<Lanes<T, W>, W> {
    #[inline(always)]
    fn get(&self) -> Lanes<T, W> {
        match self {
            Self::Same(x) => Lanes::of(*x),
            Self::Each(each) => each.rounded,
        }
    }
    #[inline(always)]
    fn calc<const N: usize>(of: [&Self; N], f: impl Fn([f64; N]) -> f64) -> Lanes<T, W> {
        if of.iter().all(|x| matches!(x, Self::Same(_))) {
            return Lanes::of(f(array::map(of, |x| x.lane(0))));
        }
        Lanes(crate::real::array::from_fn(|lane| T::of(f(array::map(of, |x| x.lane(lane))))))
    }
}

impl<T: Number<W>, const W: usize> Real for Lanes<T, W> {
    type Mask = LaneMask<T::Bits, W>;
    type One = T;
    type Value = ByWorld<Self, W>;
    const LANES: usize = W;

    #[inline(always)]
    fn epsilon() -> f64 {
        T::epsilon()
    }
    #[inline(always)]
    fn of(value: f64) -> Self {
        Self(T::repeat(T::of(value)))
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
        Self(T::choose(mask.0, yes.0, no.0))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self::Mask {
        LaneMask(T::less(self.0, other.0))
    }
    #[inline(always)]
    fn le(self, other: Self) -> Self::Mask {
        LaneMask(T::at_most(self.0, other.0))
    }
    #[inline(always)]
    fn is_finite(self) -> Self::Mask {
        // A number that is not finite times 0 is not a number.
        let zero = self * Self::zero();
        zero.le(zero)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(T::root(self.0))
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

    fn a_lane_is_a_scalar<T: Number<W>, const W: usize>() {
        let ends = [0.0, -0.0, f64::INFINITY, -f64::INFINITY, f64::NAN, 1e-300, -2.5, 0.3];
        let bits = |x: T| Into::<f64>::into(x).to_bits();
        for turn in 0..W {
            let number = |i: usize| T::of(ends[(i * 3 + turn) % ends.len()]);
            let other = |i: usize| T::of(ends[(i + 2 * turn) % ends.len()]);
            let (x, y) = (
                Lanes(crate::real::array::from_fn(number)),
                Lanes(crate::real::array::from_fn(other)),
            );
            let chosen = Lanes::select(x.lt(y).or(y.le(x).not()), x, y);
            for i in 0..W {
                let (a, b) = (number(i), other(i));
                let same = |lanes: Lanes<T, W>, one: T| {
                    assert!(
                        bits(lanes.0[i]) == bits(one) || one.into().is_nan(),
                        "{a:?} and {b:?}"
                    );
                };
                same(x + y, a + b);
                same(x - y, a - b);
                same(x * y, a * b);
                same(x / y, a / b);
                same(-x, -a);
                same(x.abs(), Real::abs(a));
                same(x.min(y).max(-y), Real::max(Real::min(a, b), -b));
                same(x.sqrt(), Real::sqrt(a));
                same(x.sin_cos().0, Real::sin_cos(a).0);
                same(
                    chosen,
                    if b.partial_cmp(&a).is_none_or(|order| order.is_gt()) { a } else { b },
                );
                assert_eq!(x.le(y).lane(i), a <= b);
                assert_eq!(x.is_finite().lane(i), a.into().is_finite());
                assert_eq!(x.lt(y).and(y.lt(x).not()).lane(i), a < b);
            }
            let masks = (0..W).map(|i| number(i) < other(i));
            assert_eq!(x.lt(y).any(), masks.clone().any(|mask| mask));
            assert_eq!(x.lt(y).all(), masks.clone().all(|mask| mask));
        }
    }

    #[test]
    fn lanes_are_scalars() {
        a_lane_is_a_scalar::<f64, WIDTH>();
        a_lane_is_a_scalar::<f32, WIDEST>();
    }
}
