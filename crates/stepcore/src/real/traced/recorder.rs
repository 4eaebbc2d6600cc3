//! The list under way: one a thread.

use core::cell::RefCell;
use std::collections::HashMap;

use super::facts::{Arg, Entries, Facts, Node, Op};
use super::rules::{simpler, Simpler};

/// How many operations choices are looked for below a choice.
const DEEP: usize = 8;

type Key = (Op, Vec<(bool, u64)>);

/// A list under way.
#[derive(Default)]
pub(crate) struct Recorder {
    pub entries: Entries,
    known: HashMap<Key, u32>,
    /// Masks that the list assumes to hold nowhere.
    pub assumed: Vec<u32>,
    /// The list is of no use.
    pub given_up: bool,
    /// Entries after which it gives up.
    pub most: usize,
}

thread_local! {
    static AT_HAND: RefCell<Recorder> = RefCell::default();
}

impl Recorder {
    /// A new list of at most so many entries begins.
    pub fn begin(largest: f64, most: usize) {
        let new = Self { entries: Entries { nodes: vec![], largest }, most, ..Self::default() };
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
            let Node { op, args, .. } = &list.entries.nodes[mask as usize];
            let (Op::Le | Op::Lt, &[Arg::Node(low), Arg::Known(value)]) = (*op, &args[..]) else {
                return;
            };
            // Comparisons with what is no number do not hold either.
            if list.entries.finite(Arg::Node(low)) {
                let facts = &mut list.entries.nodes[low as usize].facts;
                *facts = facts.above(value);
            }
        });
    }

    /// Writes an operation down, if nothing simpler gives the same number.
    pub fn note(op: Op, args: &[Arg]) -> Arg {
        AT_HAND.with(|list| list.borrow_mut().add(op, args))
    }

    pub fn add(&mut self, op: Op, args: &[Arg]) -> Arg {
        if self.given_up || self.entries.nodes.len() >= self.most {
            self.given_up = true;
            return Arg::Node(0);
        }
        if let (Op::Select, &[mask, yes, no]) = (op, args) {
            let sides = [self.under(mask, true, yes, DEEP), self.under(mask, false, no, DEEP)];
            if sides != [yes, no] {
                return self.add(op, &[mask, sides[0], sides[1]]);
            }
        }
        match simpler(&self.entries, op, args) {
            Simpler::Is(arg) => arg,
            Simpler::By(op, args) => self.add(op, &args),
            Simpler::Not => {
                let key = (op, args.iter().map(|arg| arg.key()).collect());
                if let Some(node) = self.known.get(&key) {
                    return Arg::Node(*node);
                }
                let facts = Facts::of(&self.entries, op, args);
                let node = self.push(op, args.to_vec(), facts);
                self.known.insert(key, node);
                Arg::Node(node)
            }
        }
    }

    /// The number that stands for this one where a mask holds, or where it does not: choices by the
    /// same mask are made there.
    fn under(&mut self, mask: Arg, holds: bool, arg: Arg, deep: usize) -> Arg {
        let Some((op, args)) = self.entries.made(arg) else { return arg };
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
        self.entries.nodes.push(Node { op, args, facts });
        self.entries.nodes.len() as u32 - 1
    }
}
