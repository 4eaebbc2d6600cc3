//! `Counted`: an `f64` that counts its operations, by stage of the step.
//!
//! An operation +, −, ×, ÷ or √ counts 1; sine and cosine together, an arctangent and a power count
//! `FUNCTION`. Comparisons, signs and copies do not count. The count covers the method, not the
//! compiled code: it is the same on every machine. Numbers equal the ones of `f64`, bit for bit.
//! Operations are calls: few steps are counted, and inlined counting would be much machine code.

use core::cell::Cell;
use core::ops::{Add, Div, Mul, Neg, Sub};

use super::{Real, Stage};

/// The count of a sine with its cosine, an arctangent or a power.
pub const FUNCTION: u64 = 20;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Counted(pub f64);

/// Operations by stage, and the current stage.
struct Tally {
    at: Cell<usize>,
    counts: [Cell<u64>; Stage::ALL.len()],
}

thread_local! {
    static TALLY: Tally =
        const { Tally { at: Cell::new(0), counts: [const { Cell::new(0) }; Stage::ALL.len()] } };
}

#[inline(always)]
fn note(operations: u64) {
    TALLY.with(|tally| {
        let count = &tally.counts[tally.at.get()];
        count.set(count.get() + operations);
    });
}

impl Counted {
    /// Returns this thread's counts since the last call, in the order of `Stage::ALL`.
    pub fn take() -> [u64; Stage::ALL.len()] {
        TALLY.with(|tally| crate::real::array::from_fn(|stage| tally.counts[stage].take()))
    }
}

macro_rules! operator {
    ($op:ident, $f:ident, $sign:tt) => {
        impl $op for Counted {
            type Output = Self;
            #[inline(never)]
            fn $f(self, other: Self) -> Self {
                note(1);
                Self(self.0 $sign other.0)
            }
        }
    };
}
operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);
operator!(Div, div, /);
derived!(Counted);

impl Neg for Counted {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl Real for Counted {
    scalar!(f64, f64);
    const FILLS: bool = false;
    #[inline(always)]
    fn of(value: f64) -> Self {
        Self(value)
    }
    #[inline(always)]
    fn lane(&self, _: usize) -> f64 {
        self.0
    }
    #[inline(always)]
    fn set_lane(&mut self, _: usize, value: f64) {
        self.0 = value;
    }
    #[inline(always)]
    fn lt(self, other: Self) -> bool {
        self.0 < other.0
    }
    #[inline(always)]
    fn le(self, other: Self) -> bool {
        self.0 <= other.0
    }
    #[inline(always)]
    fn is_finite(self) -> bool {
        self.0.is_finite()
    }
    fn sqrt(self) -> Self {
        note(1);
        Self(self.0.sqrt())
    }
    fn sin_cos(self) -> (Self, Self) {
        note(FUNCTION);
        let (sin, cos) = Real::sin_cos(self.0);
        (Self(sin), Self(cos))
    }
    fn atan2(self, x: Self) -> Self {
        note(FUNCTION);
        Self(Real::atan2(self.0, x.0))
    }
    fn powf(self, power: Self) -> Self {
        note(FUNCTION);
        Self(Real::powf(self.0, power.0))
    }
    fn enter(stage: Stage) {
        TALLY.with(|tally| tally.at.set(stage as usize));
    }
}
