//! `Traced`: a number that writes down what is done with it.
//!
//! A step of traced numbers leaves the list of operations that a step executes for its model
//! (`program/`). Numbers that are known, those of the model and of the settings, are computed at once;
//! the others, the state and what follows from it, are entries of the list. A traced number stands
//! for a register of worlds that differ: asked whether a mask holds anywhere it says yes, and
//! whether it holds everywhere no, so that both sides of every choice are written down, and a
//! `select` between them. That is right wherever lanes are right, because a world in lanes does not
//! depend on its neighbours.
//!
//! What a list cannot hold, a choice that goes by one lane's number, makes the trace useless: it
//! says so, and the step goes on with nonsense; no mask holds any more then, so that sweeps end.

mod facts;
mod recorder;
mod rules;

pub(crate) use recorder::{Arg, Node, Op, Recorder};

use core::fmt::Debug;
use core::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};
use num_traits::{One, Zero};

use super::lanes::Number;
use super::{Mask, Real};

/// A number of type `T`, or the entry of the list that computes one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Traced<T> {
    Known(T),
    Node(u32),
}

/// A truth value, or the entry of the list that computes one for each lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TracedMask {
    Known(bool),
    Node(u32),
}

impl<T: Number> Traced<T> {
    pub(crate) fn arg(self) -> Arg {
        match self {
            Self::Known(value) => Arg::Known(value.into()),
            Self::Node(node) => Arg::Node(node),
        }
    }

    pub(crate) fn of_arg(arg: Arg) -> Self {
        match arg {
            Arg::Known(value) => Self::Known(T::of(value)),
            Arg::Node(node) => Self::Node(node),
        }
    }

    fn one_of(self, op: Op, known: impl Fn(T) -> T) -> Self {
        match self {
            Self::Known(x) => Self::Known(known(x)),
            Self::Node(_) => Self::of_arg(Recorder::note(op, &[self.arg()])),
        }
    }

    fn of_two(self, other: Self, op: Op, known: impl Fn(T, T) -> T) -> Self {
        match (self, other) {
            (Self::Known(a), Self::Known(b)) => Self::Known(known(a, b)),
            _ => Self::of_arg(Recorder::note(op, &[self.arg(), other.arg()])),
        }
    }

    fn compared(self, other: Self, op: Op, known: impl Fn(&T, &T) -> bool) -> TracedMask {
        match (self, other) {
            (Self::Known(a), Self::Known(b)) => TracedMask::Known(known(&a, &b)),
            _ => TracedMask::of_arg(Recorder::note(op, &[self.arg(), other.arg()])),
        }
    }
}

impl TracedMask {
    pub(crate) fn arg(self) -> Arg {
        match self {
            Self::Known(value) => Arg::truth(value),
            Self::Node(node) => Arg::Node(node),
        }
    }

    fn of_arg(arg: Arg) -> Self {
        match arg {
            Arg::Known(value) => Self::Known(value != 0.0),
            Arg::Node(node) => Self::Node(node),
        }
    }
}

impl Mask for TracedMask {
    const LANES: usize = 2;

    fn of(value: bool) -> Self {
        Self::Known(value)
    }
    fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::Known(a), b) | (b, Self::Known(a)) => {
                if a {
                    b
                } else {
                    Self::Known(false)
                }
            }
            _ => Self::of_arg(Recorder::note(Op::And, &[self.arg(), other.arg()])),
        }
    }
    fn or(self, other: Self) -> Self {
        match (self, other) {
            (Self::Known(a), b) | (b, Self::Known(a)) => {
                if a {
                    Self::Known(true)
                } else {
                    b
                }
            }
            _ => Self::of_arg(Recorder::note(Op::Or, &[self.arg(), other.arg()])),
        }
    }
    fn not(self) -> Self {
        match self {
            Self::Known(value) => Self::Known(!value),
            Self::Node(_) => Self::of_arg(Recorder::note(Op::Not, &[self.arg()])),
        }
    }
    fn any(self) -> bool {
        self != Self::Known(false) && !Recorder::has_given_up()
    }
    /// The list assumes that it does not, and its steps are taken only where that is so.
    fn seldom(self) -> bool {
        match self {
            Self::Known(value) => value,
            Self::Node(node) => {
                Recorder::assume_none(node);
                false
            }
        }
    }
    /// Only counts ask, which are none of the state.
    fn lane(self, _: usize) -> bool {
        self.any()
    }
    fn from_lanes(value: impl Fn(usize) -> bool) -> Self {
        Recorder::give_up();
        Self::Known(value(0))
    }
}

macro_rules! operator {
    ($op:ident, $f:ident, $assign:ident, $g:ident, $sign:tt) => {
        impl<T: Number> $op for Traced<T> {
            type Output = Self;
            fn $f(self, other: Self) -> Self {
                self.of_two(other, Op::$op, |a, b| a $sign b)
            }
        }
        impl<T: Number> $assign for Traced<T> {
            fn $g(&mut self, other: Self) {
                *self = *self $sign other;
            }
        }
    };
}
operator!(Add, add, AddAssign, add_assign, +);
operator!(Sub, sub, SubAssign, sub_assign, -);
operator!(Mul, mul, MulAssign, mul_assign, *);
operator!(Div, div, DivAssign, div_assign, /);

impl<T: Number> Neg for Traced<T> {
    type Output = Self;
    fn neg(self) -> Self {
        self.one_of(Op::Neg, |x| -x)
    }
}

impl<T: Number> Zero for Traced<T> {
    fn zero() -> Self {
        Self::Known(T::zero())
    }
    fn is_zero(&self) -> bool {
        match self {
            Self::Known(value) => value.is_zero(),
            Self::Node(_) => {
                Recorder::give_up();
                false
            }
        }
    }
}

impl<T: Number> One for Traced<T> {
    fn one() -> Self {
        Self::Known(T::one())
    }
}

impl<T: Number> Real for Traced<T> {
    type Mask = TracedMask;
    const LANES: usize = 2;
    const EPSILON: f64 = T::EPSILON;

    fn of(value: f64) -> Self {
        Self::Known(T::of(value))
    }
    fn lane(self, _: usize) -> f64 {
        match self {
            Self::Known(value) => value.into(),
            Self::Node(_) => {
                Recorder::give_up();
                0.0
            }
        }
    }
    fn set_lane(&mut self, _: usize, value: f64) {
        *self = Self::of(value);
    }
    fn select(mask: TracedMask, yes: Self, no: Self) -> Self {
        match mask {
            TracedMask::Known(true) => yes,
            TracedMask::Known(false) => no,
            TracedMask::Node(_) => {
                Self::of_arg(Recorder::note(Op::Select, &[mask.arg(), yes.arg(), no.arg()]))
            }
        }
    }
    fn lt(self, other: Self) -> TracedMask {
        self.compared(other, Op::Lt, |a, b| a < b)
    }
    fn le(self, other: Self) -> TracedMask {
        self.compared(other, Op::Le, |a, b| a <= b)
    }
    fn is_finite(self) -> TracedMask {
        match self {
            Self::Known(value) => TracedMask::Known(value.is_finite()),
            Self::Node(_) => TracedMask::of_arg(Recorder::note(Op::Finite, &[self.arg()])),
        }
    }
    fn sqrt(self) -> Self {
        self.one_of(Op::Sqrt, |x| x.sqrt())
    }
    fn sin_cos(self) -> (Self, Self) {
        (self.one_of(Op::Sin, |x| x.sin_cos().0), self.one_of(Op::Cos, |x| x.sin_cos().1))
    }
    fn atan2(self, x: Self) -> Self {
        self.of_two(x, Op::Atan2, |y, x| y.atan2(x))
    }
    fn powf(self, power: Self) -> Self {
        self.of_two(power, Op::Pow, |x, power| x.powf(power))
    }
}
