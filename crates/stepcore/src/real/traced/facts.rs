//! What is known of a number that is not known.

use super::recorder::{Arg, Op, Recorder};

/// More than what rounding adds to a bound.
const SURE: f64 = 1.0 + 1e-6;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Facts {
    /// Its size is no more; infinite: it may be anything, and no number.
    pub most: f64,
    /// It is 0 or −0.
    pub zero: bool,
    /// It is not −0.
    pub plus: bool,
}

impl Facts {
    pub fn within(most: f64) -> Self {
        Self { most, zero: false, plus: false }
    }

    pub fn exact(value: f64) -> Self {
        let most = if value.is_nan() { f64::INFINITY } else { value.abs() };
        let negative_zero = value == 0.0 && value.is_sign_negative();
        Self { most, zero: value == 0.0, plus: !negative_zero }
    }

    /// Of what an operation computes.
    pub fn of(list: &Recorder, op: Op, args: &[Arg]) -> Self {
        let of = |at: usize| list.facts(args[at]);
        let finite = |at: usize| list.finite(args[at]);
        let mut facts = Self::within(f64::INFINITY);
        match op {
            Op::Add | Op::Sub => {
                let (a, b) = (of(0), of(1));
                facts.most = (a.most + b.most) * SURE;
                facts.zero = a.zero && b.zero;
                // −0 + −0 and −0 − 0 alone are −0.
                facts.plus = a.plus || (op == Op::Add && b.plus);
                if let (Op::Sub, Arg::Known(value)) = (op, args[1]) {
                    facts.plus |= value != 0.0;
                }
            }
            Op::Mul => {
                let (a, b) = (of(0), of(1));
                facts.zero = (a.zero && finite(1)) || (b.zero && finite(0));
                facts.most = if facts.zero { 0.0 } else { a.most * b.most * SURE };
                facts.plus = args[0] == args[1];
            }
            Op::Div => {
                if let Arg::Known(value) = args[1] {
                    facts.most = of(0).most / value.abs() * SURE;
                }
            }
            Op::Neg => facts = Self { plus: false, ..of(0) },
            Op::Sin | Op::Cos => facts.most = SURE,
            Op::Atan2 => facts.most = 4.0,
            Op::Select => {
                let (a, b) = (of(1), of(2));
                facts = Self {
                    most: a.most.max(b.most),
                    zero: a.zero && b.zero,
                    plus: a.plus && b.plus,
                };
            }
            Op::Max | Op::Min => {
                let (a, b) = (of(0), of(1));
                facts.most = a.most.max(b.most);
                facts.plus = a.plus && b.plus;
            }
            _ => {}
        }
        if facts.most.is_nan() {
            facts.most = f64::INFINITY;
        }
        facts
    }
}
