//! The list under way: one a thread.

use core::cell::RefCell;
use std::collections::HashMap;

use super::facts::Facts;
use super::rules::{simpler, Simpler};

/// What an entry does. Masks are all ones or all zeros a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Op {
    /// A number of the state: its place there.
    Input(u32),
    Add,
    Sub,
    Mul,
    Div,
    Neg,
    Sqrt,
    Sin,
    Cos,
    Atan2,
    Pow,
    /// Of a mask and two numbers.
    Select,
    /// a < b ? b : a, and b < a ? b : a.
    Max,
    Min,
    Lt,
    Le,
    Finite,
    And,
    Or,
    Not,
}

impl Op {
    /// It computes a mask.
    pub fn is_mask(self) -> bool {
        matches!(self, Self::Lt | Self::Le | Self::Finite | Self::And | Self::Or | Self::Not)
    }
}

/// What an entry reads: a number, exact in the precision at hand, or another entry.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Arg {
    Known(f64),
    Node(u32),
}

impl Arg {
    /// Of a mask.
    pub fn truth(value: bool) -> Self {
        Self::Known(if value { 1.0 } else { 0.0 })
    }

    pub fn node(self) -> Option<u32> {
        match self {
            Self::Node(node) => Some(node),
            Self::Known(_) => None,
        }
    }

    fn key(self) -> (bool, u64) {
        match self {
            Self::Known(value) => (true, value.to_bits()),
            Self::Node(node) => (false, node.into()),
        }
    }
}

/// To the bit.
impl PartialEq for Arg {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

/// An entry: what it does, what it reads (as many as `args` says), and what is known of its number.
#[derive(Clone, Debug)]
pub(crate) struct Node {
    pub op: Op,
    pub args: Vec<Arg>,
    pub facts: Facts,
}

/// How many operations choices are looked for below a choice.
const DEEP: usize = 8;

type Key = (Op, Vec<(bool, u64)>);

/// A list under way.
#[derive(Default)]
pub(crate) struct Recorder {
    pub nodes: Vec<Node>,
    known: HashMap<Key, u32>,
    /// Masks that the list assumes to hold nowhere.
    pub assumed: Vec<u32>,
    /// The list is of no use.
    pub given_up: bool,
    /// What no finite number exceeds.
    pub largest: f64,
    /// Entries after which it gives up.
    pub most: usize,
}

thread_local! {
    static AT_HAND: RefCell<Recorder> = RefCell::default();
}

impl Recorder {
    /// A new list of at most so many entries begins.
    pub fn begin(largest: f64, most: usize) {
        let new = Self { largest, most, ..Self::default() };
        AT_HAND.with(|list| *list.borrow_mut() = new);
    }

    /// The list that was begun.
    pub fn end() -> Self {
        AT_HAND.with(RefCell::take)
    }

    /// A number of the state, whose size is at most `most`.
    pub fn input(place: usize, most: f64) -> u32 {
        AT_HAND.with(|list| {
            list.borrow_mut().push(Op::Input(place as u32), vec![], Facts::within(most))
        })
    }

    pub fn give_up() {
        AT_HAND.with(|list| list.borrow_mut().given_up = true);
    }

    pub fn has_given_up() -> bool {
        AT_HAND.with(|list| list.borrow().given_up)
    }

    /// The list holds only where this mask does not: what is not below a number is above it.
    pub fn assume_none(mask: u32) {
        AT_HAND.with(|list| {
            let list = &mut *list.borrow_mut();
            list.assumed.push(mask);
            let Node { op, args, .. } = &list.nodes[mask as usize];
            let (Op::Le | Op::Lt, &[Arg::Node(low), Arg::Known(value)]) = (*op, &args[..]) else {
                return;
            };
            // Comparisons with what is no number do not hold either.
            if list.finite(Arg::Node(low)) {
                let facts = &mut list.nodes[low as usize].facts;
                *facts = facts.above(value);
            }
        });
    }

    /// Writes an operation down, if nothing simpler gives the same number.
    pub fn note(op: Op, args: &[Arg]) -> Arg {
        AT_HAND.with(|list| list.borrow_mut().add(op, args))
    }

    pub fn add(&mut self, op: Op, args: &[Arg]) -> Arg {
        if self.given_up || self.nodes.len() >= self.most {
            self.given_up = true;
            return Arg::Node(0);
        }
        if let (Op::Select, &[mask, yes, no]) = (op, args) {
            let sides = [self.under(mask, true, yes, DEEP), self.under(mask, false, no, DEEP)];
            if sides != [yes, no] {
                return self.add(op, &[mask, sides[0], sides[1]]);
            }
        }
        match simpler(self, op, args) {
            Simpler::Is(arg) => arg,
            Simpler::By(op, args) => self.add(op, &args),
            Simpler::Not => {
                let key = (op, args.iter().map(|arg| arg.key()).collect());
                if let Some(node) = self.known.get(&key) {
                    return Arg::Node(*node);
                }
                let facts = Facts::of(self, op, args);
                let node = self.push(op, args.to_vec(), facts);
                self.known.insert(key, node);
                Arg::Node(node)
            }
        }
    }

    /// The number that stands for this one where a mask holds, or where it does not: choices by the
    /// same mask are made there.
    fn under(&mut self, mask: Arg, holds: bool, arg: Arg, deep: usize) -> Arg {
        let Some((op, args)) = self.made(arg) else { return arg };
        match (op, args) {
            (Op::Select, &[own, yes, no]) if own == mask => {
                self.under(mask, holds, if holds { yes } else { no }, deep)
            }
            (Op::Add | Op::Sub | Op::Mul | Op::Neg | Op::Max | Op::Min, args) if deep > 0 => {
                let old = args.to_vec();
                let new: Vec<Arg> =
                    old.iter().map(|arg| self.under(mask, holds, *arg, deep - 1)).collect();
                if new == old {
                    arg
                } else {
                    self.add(op, &new)
                }
            }
            _ => arg,
        }
    }

    fn push(&mut self, op: Op, args: Vec<Arg>, facts: Facts) -> u32 {
        self.nodes.push(Node { op, args, facts });
        self.nodes.len() as u32 - 1
    }

    /// What is known of a number.
    pub fn facts(&self, arg: Arg) -> Facts {
        match arg {
            Arg::Known(value) => Facts::exact(value),
            Arg::Node(node) => self.nodes[node as usize].facts,
        }
    }

    /// The operation of an entry, and what it reads.
    pub fn made(&self, arg: Arg) -> Option<(Op, &[Arg])> {
        let node = &self.nodes[arg.node()? as usize];
        Some((node.op, &node.args))
    }

    /// It is no infinity, and a number.
    pub fn finite(&self, arg: Arg) -> bool {
        let Facts { low, high, .. } = self.facts(arg);
        -self.largest <= low && high <= self.largest
    }
}
