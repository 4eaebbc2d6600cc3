//! `Traced`: a number that writes down what is done with it.
//!
//! A step of traced numbers leaves the list of operations that a step executes for its model, of which
//! `compile/` makes machine code. Numbers that are known, those of the model and of the settings, are computed at once;
//! the others, the state and what follows from it, are entries of the list. A traced number stands
//! for a register of worlds that differ: asked whether a mask holds anywhere it says yes, and
//! whether it holds everywhere no, so that both sides of every choice are written down, and a
//! `select` between them. That is right wherever lanes are right, because a world in lanes does not
//! depend on its neighbours.
//!
//! A known number is an `f64`, and where the list is one of `f32` it is rounded to that after every
//! operation, which gives the bits of `f32`: sums, products, quotients and roots that were rounded to
//! twice the digits round no differently (Figueroa, SIGNUM Newsletter 30, 1995), and functions of an
//! `f32` are rounded from `f64` everywhere. So one copy of the stages writes both. It runs once for a
//! model, and its operations are calls: what they do in place would be much machine code.
//!
//! What a list cannot hold, a choice that goes by one lane's number, makes the trace useless: it
//! says so, and the step goes on with nonsense; no mask holds any more then, so that sweeps end.

mod facts;
mod parameter;
mod recorder;
mod rules;

#[cfg(test)]
pub(crate) use facts::Facts;
pub(crate) use facts::{Arg, Node, Op};
pub(crate) use parameter::Parameter;
pub(crate) use recorder::{Loop, Recorder, HANDED};

use core::cell::Cell;
use core::fmt::Debug;
use core::ops::{Add, Div, Mul, Neg, Sub};
use num_traits::{One, Zero};

use super::elementary::near_of;
use super::{Constant, Mask, Real, Turns, Value};

/// A number, or the entry of the list that computes one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Traced {
    Known(f64),
    Node(u32),
}

/// A truth value, or the entry of the list that computes one for each lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TracedMask {
    Known(bool),
    Node(u32),
}

thread_local! {
    /// Unit roundoff of the numbers of this thread's list.
    static EPSILON: Cell<f64> = const { Cell::new(f64::EPSILON) };
}

/// A known number in the precision of the list.
fn rounded(value: f64) -> f64 {
    if EPSILON.get() > f64::EPSILON {
        f64::from(value as f32)
    } else {
        value
    }
}

impl Traced {
    /// From here on, lists of this thread are for numbers of this unit roundoff.
    pub(crate) fn round_as(epsilon: f64) {
        EPSILON.set(epsilon);
    }

    /// Hands it over to who reads it where a mask holds: it stands for its place then.
    pub(crate) fn handed(self, mask: TracedMask) -> Self {
        match self {
            Self::Node(node) => Self::Node(Recorder::put(node, mask.arg())),
            known => known,
        }
    }

    /// A place from `before` on is one from `first` on.
    pub(crate) fn begins_at(&mut self, before: u32, first: u32) {
        match self {
            Self::Node(place) if *place >= before => *place = *place - before + first,
            _ => {}
        }
    }

    #[inline(always)]
    pub(crate) fn arg(self) -> Arg {
        match self {
            Self::Known(value) => Arg::Known(value),
            Self::Node(node) => Arg::Node(node),
        }
    }

    fn of_arg(arg: Arg) -> Self {
        match arg {
            Arg::Known(value) => Self::Known(value),
            Arg::Node(node) => Self::Node(node),
        }
    }

    #[inline(never)]
    fn one_of(self, op: Op) -> Self {
        let Self::Known(x) = self else {
            return Self::of_arg(Recorder::note(op, &[self.arg()]));
        };
        Self::Known(rounded(match op {
            Op::Neg => -x,
            Op::Sqrt => x.sqrt(),
            Op::Sin => Real::sin_cos(x).0,
            Op::Cos => Real::sin_cos(x).1,
            _ => unreachable!("{op:?} is not of one number"),
        }))
    }

    #[inline(never)]
    fn of_two(self, other: Self, op: Op) -> Self {
        let (Self::Known(a), Self::Known(b)) = (self, other) else {
            return Self::of_arg(Recorder::note(op, &[self.arg(), other.arg()]));
        };
        Self::Known(rounded(match op {
            Op::Add => a + b,
            Op::Sub => a - b,
            Op::Mul => a * b,
            Op::Div => a / b,
            Op::Atan2 => Real::atan2(a, b),
            Op::Pow => Real::powf(a, b),
            _ => unreachable!("{op:?} is not of two numbers"),
        }))
    }

    #[inline(never)]
    fn compared(self, other: Self, op: Op) -> TracedMask {
        match (self, other) {
            (Self::Known(a), Self::Known(b)) => {
                TracedMask::Known(if op == Op::Lt { a < b } else { a <= b })
            }
            _ => TracedMask::of_arg(Recorder::note(op, &[self.arg(), other.arg()])),
        }
    }
}

impl TracedMask {
    /// Hands it over, as 1 or 0.
    pub(crate) fn handed(self) -> Self {
        let number = Traced::select(self, Traced::of(1.0), Traced::of(0.0));
        match number.handed(Self::Known(true)) {
            Traced::Known(value) => Self::Known(value != 0.0),
            Traced::Node(place) => Self::Node(place),
        }
    }

    /// As of a number.
    pub(crate) fn begins_at(&mut self, before: u32, first: u32) {
        if let Self::Node(place) = *self {
            let mut number = Traced::Node(place);
            number.begins_at(before, first);
            if let Traced::Node(place) = number {
                *self = Self::Node(place);
            }
        }
    }

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

    #[inline(always)]
    fn of(value: bool) -> Self {
        Self::Known(value)
    }
    #[inline(never)]
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
    #[inline(never)]
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
    #[inline(never)]
    fn not(self) -> Self {
        match self {
            Self::Known(value) => Self::Known(!value),
            Self::Node(_) => Self::of_arg(Recorder::note(Op::Not, &[self.arg()])),
        }
    }
    #[inline(never)]
    fn any(self) -> bool {
        self != Self::Known(false) && !Recorder::has_given_up()
    }
    /// The list assumes that it does not, and its steps are taken only where that is so.
    #[inline(never)]
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
    fn lane(&self, _: usize) -> bool {
        self.any()
    }
    fn from_lanes(value: impl Fn(usize) -> bool) -> Self {
        Recorder::give_up();
        Self::Known(value(0))
    }
}

macro_rules! operator {
    ($op:ident, $f:ident) => {
        impl $op for Traced {
            type Output = Self;
            #[inline(always)]
            fn $f(self, other: Self) -> Self {
                self.of_two(other, Op::$op)
            }
        }
    };
}
operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);
derived!(Traced);

impl Neg for Traced {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.one_of(Op::Neg)
    }
}

impl Value<Traced> for Parameter {
    fn get(&self) -> Traced {
        match self {
            Self::Same(x) => Traced::of(*x),
            Self::Each(index) => Traced::Node(Recorder::parameter(*index, Self::most(*index))),
        }
    }
    fn calc<const N: usize>(of: [&Self; N], f: impl Fn([f64; N]) -> f64) -> Traced {
        let number = |lane: usize| f(of.map(|x| x.lane(lane)));
        if of.iter().all(|x| matches!(x, Self::Same(_))) {
            return Traced::of(number(0));
        }
        let column: Vec<f64> = (0..Self::models()).map(|lane| rounded(number(lane))).collect();
        Self::by_lane(&column).get()
    }
}

impl Real for Traced {
    type Mask = TracedMask;
    type One = f64;
    type Value = Parameter;
    const LANES: usize = 2;

    fn epsilon() -> f64 {
        EPSILON.get()
    }
    #[inline(never)]
    fn of(value: f64) -> Self {
        Self::Known(rounded(value))
    }
    #[inline(never)]
    fn lane(&self, _: usize) -> f64 {
        match self {
            Self::Known(value) => *value,
            Self::Node(_) => {
                Recorder::give_up();
                f64::NAN
            }
        }
    }
    #[inline(never)]
    fn set_lane(&mut self, _: usize, value: f64) {
        *self = Self::of(value);
    }
    #[inline(never)]
    fn select(mask: TracedMask, yes: Self, no: Self) -> Self {
        match mask {
            TracedMask::Known(true) => yes,
            TracedMask::Known(false) => no,
            TracedMask::Node(_) => {
                Self::of_arg(Recorder::note(Op::Select, &[mask.arg(), yes.arg(), no.arg()]))
            }
        }
    }
    #[inline(always)]
    fn lt(self, other: Self) -> TracedMask {
        self.compared(other, Op::Lt)
    }
    #[inline(always)]
    fn le(self, other: Self) -> TracedMask {
        self.compared(other, Op::Le)
    }
    #[inline(never)]
    fn is_finite(self) -> TracedMask {
        match self {
            Self::Known(value) => TracedMask::Known(value.is_finite()),
            Self::Node(_) => TracedMask::of_arg(Recorder::note(Op::Finite, &[self.arg()])),
        }
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.one_of(Op::Sqrt)
    }
    /// In double precision by its operations, of angles that are near.
    fn sin_cos(self) -> (Self, Self) {
        if let (Self::Node(_), f64::EPSILON) = (self, EPSILON.get()) {
            let (sin, cos, near) = near_of(self);
            near.not().seldom();
            return (sin, cos);
        }
        (self.one_of(Op::Sin), self.one_of(Op::Cos))
    }
    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        self.of_two(x, Op::Atan2)
    }
    fn largest(self) -> f64 {
        0.0
    }
    /// One turn is written down, of numbers that any turn may begin with.
    fn repeat_while<T: Turns<Self>>(most: u32, it: &mut T, mut turn: impl FnMut(&mut T)) {
        if it.live() == TracedMask::Known(false) || most == 0 {
            return;
        }
        let own = Recorder::loops();
        Recorder::begin_loop(most);
        let mut live = 0;
        it.numbers(&mut |x| {
            live += 1;
            *x = Self::Node(Recorder::enter_loop(Op::Enter, x.arg()));
        });
        it.masks(&mut |mask| {
            *mask = TracedMask::Node(Recorder::enter_loop(Op::EnterMask, mask.arg()));
        });
        turn(it);
        Recorder::end_turn(live);
        let mut index = 0;
        let mut next = || {
            index += 1;
            index - 1
        };
        it.numbers(&mut |x| {
            *x = Self::Node(Recorder::leave_loop(own, next(), Op::Leave, x.arg()));
        });
        it.masks(&mut |mask| {
            *mask = TracedMask::Node(Recorder::leave_loop(own, next(), Op::LeaveMask, mask.arg()));
        });
    }
    #[inline(always)]
    fn powf(self, power: Self) -> Self {
        self.of_two(power, Op::Pow)
    }
    #[inline(never)]
    fn abs(self) -> Self {
        Self::select(self.lt(Self::zero()), -self, self)
    }
    #[inline(never)]
    fn min(self, other: Self) -> Self {
        Self::select(other.lt(self), other, self)
    }
    #[inline(never)]
    fn max(self, other: Self) -> Self {
        Self::select(self.lt(other), other, self)
    }
    #[inline(never)]
    fn recip_or_zero(self) -> Self {
        Self::select(self.gt(Self::zero()), Self::one() / self, Self::zero())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of all sizes, zeros, subnormal ones, infinities and no number.
    fn numbers() -> Vec<f32> {
        let mut bits = 0x2545_F491_u32;
        let mut next = || {
            bits ^= bits << 13;
            bits ^= bits >> 17;
            bits ^= bits << 5;
            f32::from_bits(bits)
        };
        let corners = [0.0, -0.0, 1.0, f32::MIN_POSITIVE, 3e-45, f32::MAX, f32::INFINITY, f32::NAN];
        corners.into_iter().chain((0..300).map(|_| next())).collect()
    }

    /// What is computed in doubles and rounded has the bits of single precision.
    #[test]
    fn known_numbers_are_those_of_f32() {
        type Two = (fn(Traced, Traced) -> Traced, fn(f32, f32) -> f32);
        type One = (fn(Traced) -> Traced, fn(f32) -> f32);
        let two: [Two; 6] = [
            (|a, b| a + b, |a, b| a + b),
            (|a, b| a - b, |a, b| a - b),
            (|a, b| a * b, |a, b| a * b),
            (|a, b| a / b, |a, b| a / b),
            (Real::atan2, Real::atan2),
            (Real::powf, Real::powf),
        ];
        let one: [One; 4] = [
            (|a| -a, |a| -a),
            (Real::sqrt, Real::sqrt),
            (|a| a.sin_cos().0, |a| Real::sin_cos(a).0),
            (|a| a.sin_cos().1, |a| Real::sin_cos(a).1),
        ];
        let same = |got: Traced, want: f32, of: [f32; 2]| {
            let got = got.lane(0);
            let equal = got.to_bits() == f64::from(want).to_bits();
            assert!(equal || got.is_nan() && want.is_nan(), "{got} {want} of {of:?}");
        };
        Traced::round_as(f32::EPSILON.into());
        let numbers = numbers();
        for a in &numbers {
            let traced = Traced::of((*a).into());
            one.iter().for_each(|(f, g)| same(f(traced), g(*a), [*a, 0.0]));
            for b in &numbers {
                let other = Traced::of((*b).into());
                two.iter().for_each(|(f, g)| same(f(traced, other), g(*a, *b), [*a, *b]));
            }
        }
        Traced::round_as(f64::EPSILON);
    }
}
