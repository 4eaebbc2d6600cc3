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

    pub fn assume_none(mask: u32) {
        AT_HAND.with(|list| list.borrow_mut().assumed.push(mask));
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
        self.facts(arg).most <= self.largest
    }
}
