//! Operations that something simpler stands for, with the same bits: signs of zeros included.
//!
//! What is left out is only what cannot show: a product with one, a sum with a zero whose sign is
//! lost in it, a choice between two that are the same. Sums are never put in another order.

use super::facts::{Arg, Entries, Op};

/// What gives the same number.
pub(super) enum Simpler {
    /// This one.
    Is(Arg),
    /// That operation.
    By(Op, Vec<Arg>),
    /// Nothing is simpler.
    Not,
}

use Simpler::{By, Is, Not};

pub(super) fn simpler(list: &Entries, op: Op, args: &[Arg]) -> Simpler {
    match (op, args) {
        (Op::Add, &[a, b]) => sum(list, a, b),
        (Op::Sub, &[a, b]) => difference(list, a, b),
        (Op::Mul, &[a, b]) => product(list, a, b),
        (Op::Div, &[a, Arg::Known(value)]) => quotient(a, value),
        (Op::Neg, &[a]) => negative(list, a),
        (Op::Select, &[mask, yes, no]) => choice(list, mask, yes, no),
        (Op::Max | Op::Min, &[a, b]) if a == b => Is(a),
        (Op::Lt | Op::Le, &[a, b]) => comparison(list, op, a, b),
        (Op::Finite, &[a]) if list.finite(a) => Is(Arg::truth(true)),
        (Op::And | Op::Or, &[a, b]) if a == b => Is(a),
        (Op::And, &[a, b]) if follows(list, a, b) => Is(a),
        (Op::And, &[a, b]) if follows(list, b, a) => Is(b),
        (Op::Not, &[a]) => match list.made(a) {
            Some((Op::Not, inner)) => Is(inner[0]),
            _ => Not,
        },
        _ => Not,
    }
}

/// Where a mask holds the other does: it is one of those of which the other is made.
fn follows(list: &Entries, mask: Arg, other: Arg) -> bool {
    match list.made(other) {
        Some((Op::Or, &[a, b])) => {
            [a, b].into_iter().any(|part| part == mask || follows(list, mask, part))
        }
        _ => false,
    }
}

fn is_positive_zero(value: f64) -> bool {
    value == 0.0 && value.is_sign_positive()
}

/// x, if this is −x.
fn negated(list: &Entries, arg: Arg) -> Option<Arg> {
    match list.made(arg)? {
        (Op::Neg, inner) => Some(inner[0]),
        _ => None,
    }
}

fn sum(list: &Entries, a: Arg, b: Arg) -> Simpler {
    // What is known stands second; of two others the older first.
    if let (Arg::Known(_), Arg::Node(_)) = (a, b) {
        return By(Op::Add, vec![b, a]);
    }
    let (left, right) = (list.facts(a), list.facts(b));
    if let Arg::Known(value) = b {
        if !right.plus || (value == 0.0 && left.plus) {
            return Is(a);
        }
        return if left.zero { Is(b) } else { Not };
    }
    if left.zero && right.plus {
        return Is(b);
    }
    if right.zero && left.plus {
        return Is(a);
    }
    if let Some(inner) = negated(list, b) {
        return By(Op::Sub, vec![a, inner]);
    }
    if let Some(inner) = negated(list, a) {
        return By(Op::Sub, vec![b, inner]);
    }
    if a.node() > b.node() {
        return By(Op::Add, vec![b, a]);
    }
    Not
}

fn difference(list: &Entries, a: Arg, b: Arg) -> Simpler {
    let (left, right) = (list.facts(a), list.facts(b));
    if let Arg::Known(value) = b {
        return if is_positive_zero(value) {
            Is(a)
        } else {
            By(Op::Add, vec![a, Arg::Known(-value)])
        };
    }
    if right.zero && left.plus {
        return Is(a);
    }
    if a == b && list.finite(a) {
        return Is(Arg::Known(0.0));
    }
    if let Some(inner) = negated(list, b) {
        return By(Op::Add, vec![a, inner]);
    }
    Not
}

fn product(list: &Entries, a: Arg, b: Arg) -> Simpler {
    if let (Arg::Known(_), Arg::Node(_)) = (a, b) {
        return By(Op::Mul, vec![b, a]);
    }
    if let Arg::Known(value) = b {
        if value == 1.0 {
            return Is(a);
        }
        if value == -1.0 {
            return By(Op::Neg, vec![a]);
        }
        return match negated(list, a) {
            Some(inner) => By(Op::Mul, vec![inner, Arg::Known(-value)]),
            None => Not,
        };
    }
    match (negated(list, a), negated(list, b)) {
        (Some(a), Some(b)) => By(Op::Mul, vec![a, b]),
        _ if a.node() > b.node() => By(Op::Mul, vec![b, a]),
        _ => Not,
    }
}

fn quotient(a: Arg, value: f64) -> Simpler {
    if value == 1.0 {
        Is(a)
    } else if value == -1.0 {
        By(Op::Neg, vec![a])
    } else {
        Not
    }
}

fn negative(list: &Entries, a: Arg) -> Simpler {
    match list.made(a) {
        Some((Op::Neg, inner)) => Is(inner[0]),
        Some((Op::Mul, &[x, Arg::Known(value)])) => By(Op::Mul, vec![x, Arg::Known(-value)]),
        _ => Not,
    }
}

fn choice(list: &Entries, mask: Arg, yes: Arg, no: Arg) -> Simpler {
    if yes == no {
        return Is(yes);
    }
    match list.made(mask) {
        Some((Op::Not, inner)) => By(Op::Select, vec![inner[0], no, yes]),
        Some((Op::Lt, &[a, b])) if [a, b] == [no, yes].map(|x| without_sign(list, x)) => {
            By(Op::Max, vec![no, yes])
        }
        Some((Op::Lt, &[a, b])) if [a, b] == [yes, no].map(|x| without_sign(list, x)) => {
            By(Op::Min, vec![no, yes])
        }
        _ => Not,
    }
}

/// x, if this is x + 0: in a comparison the two are the same.
fn without_sign(list: &Entries, arg: Arg) -> Arg {
    match list.made(arg) {
        Some((Op::Add, &[x, Arg::Known(value)])) if is_positive_zero(value) => x,
        _ => arg,
    }
}

fn comparison(list: &Entries, op: Op, a: Arg, b: Arg) -> Simpler {
    let bare = [a, b].map(|arg| without_sign(list, arg));
    if bare != [a, b] {
        return By(op, bare.to_vec());
    }
    let truth = |value: bool| Is(Arg::truth(value));
    match (a, b) {
        (Arg::Known(value), _) if op == Op::Lt && value == f64::INFINITY => return truth(false),
        (_, Arg::Known(value)) if op == Op::Lt && value == f64::NEG_INFINITY => {
            return truth(false)
        }
        _ if op == Op::Lt && a == b => return truth(false),
        _ => {}
    }
    if !(list.finite(a) && list.finite(b) || within(list, a, b)) {
        return Not;
    }
    let (left, right) = (list.facts(a), list.facts(b));
    if left.high < right.low {
        return truth(true);
    }
    if right.high < left.low || (op == Op::Lt && right.high <= left.low) {
        return truth(false);
    }
    Not
}

/// One of the two is known and infinite, the other finite.
fn within(list: &Entries, a: Arg, b: Arg) -> bool {
    let infinite = |arg| matches!(arg, Arg::Known(value) if f64::is_infinite(value));
    (infinite(a) && list.finite(b)) || (infinite(b) && list.finite(a))
}
