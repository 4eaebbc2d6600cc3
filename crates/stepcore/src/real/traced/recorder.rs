//! The list under way: one a thread.

use core::cell::RefCell;
use core::ops::Range;
use std::collections::HashMap;

use super::facts::{Arg, Entries, Facts, Node, Op};
use super::rules::{simpler, Simpler};

/// How many operations choices are looked for below a choice.
const DEEP: usize = 8;

type Key = (Op, Vec<(bool, u64)>);

/// The first place of what is handed over, until it is known how many there are for other numbers.
pub(crate) const HANDED: u32 = 1 << 30;

/// Entries that are executed again and again, while a mask holds somewhere.
#[derive(Clone, Debug, Default)]
pub(crate) struct Loop {
    /// Its entries, those inside of it included.
    pub entries: Range<usize>,
    /// The most turns.
    pub most: u32,
    /// What turns change: the entries where a turn begins, and those after the last one.
    pub changed: Vec<(u32, u32)>,
    /// Of `changed` the mask that says in which lanes there is another turn.
    pub live: usize,
}

/// A list under way.
#[derive(Default)]
pub(crate) struct Recorder {
    pub entries: Entries,
    known: HashMap<Key, u32>,
    /// Masks that the list assumes to hold nowhere.
    pub assumed: Vec<u32>,
    /// In the order in which they begin.
    pub loops: Vec<Loop>,
    /// By column: the entry that reads it.
    parameters: HashMap<u32, u32>,
    /// By entry that hands a number over: the masks without all of which nobody reads it.
    pub puts: HashMap<u32, Vec<u32>>,
    /// Numbers that are handed over already: their places.
    handed: HashMap<(u32, (bool, u64)), u32>,
    /// Entries before which somebody else works: of the part of the step that begins there the first.
    pub cuts: Vec<usize>,
    /// Places of the state for what is handed over, from `HANDED` on.
    pub places: u32,
    /// Those that have begun and not ended.
    open: Vec<usize>,
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

    /// A loop begins.
    pub fn begin_loop(most: u32) {
        AT_HAND.with(|list| {
            let list = &mut *list.borrow_mut();
            let from = list.entries.nodes.len();
            list.open.push(list.loops.len());
            list.loops.push(Loop { entries: from..from, most, ..Loop::default() });
        });
    }

    /// The loop at hand changes a number or a mask: the entry that stands for it where a turn begins.
    pub fn enter_loop(op: Op, before: Arg) -> u32 {
        AT_HAND.with(|list| {
            let list = &mut *list.borrow_mut();
            let entry = list.push(op, vec![before], Facts::NOTHING);
            let Some(own) = list.open.last() else { return entry };
            list.loops[*own].changed.push((entry, entry));
            entry
        })
    }

    /// The turn of the loop at hand ends: `live` of what it changes says where another one follows.
    pub fn end_turn(live: usize) {
        AT_HAND.with(|list| {
            let list = &mut *list.borrow_mut();
            let end = list.entries.nodes.len();
            let Some(own) = list.open.pop() else { return };
            list.loops[own].entries.end = end;
            list.loops[own].live = live;
            // What a turn computes is not known outside.
            let from = list.loops[own].entries.start as u32;
            list.known.retain(|_, entry| *entry < from);
        });
    }

    /// After loop `own`: what it made of the number or mask `index`, which was this at the end of a turn.
    pub fn leave_loop(own: usize, index: usize, op: Op, after: Arg) -> u32 {
        AT_HAND.with(|list| {
            let list = &mut *list.borrow_mut();
            let entry = list.push(op, vec![after], Facts::NOTHING);
            if let Some(changed) = list.loops[own].changed.get_mut(index) {
                changed.1 = entry;
            }
            entry
        })
    }

    /// How many loops have begun so far.
    pub fn loops() -> usize {
        AT_HAND.with(|list| list.borrow().loops.len())
    }

    /// A number of the model that differs by world: its column. Of these none is an infinity.
    pub fn parameter(index: u32, most: f64) -> u32 {
        AT_HAND.with(|list| {
            let list = &mut *list.borrow_mut();
            if let Some(entry) = list.parameters.get(&index) {
                return *entry;
            }
            let entry = list.push(Op::Parameter(index), vec![], Facts::within(most));
            list.parameters.insert(index, entry);
            entry
        })
    }

    /// Hands a number over that is read where a mask holds: its place.
    pub fn put(x: u32, mask: Arg) -> u32 {
        AT_HAND.with(|list| {
            let list = &mut *list.borrow_mut();
            if let Op::Input(place) = list.entries.nodes[x as usize].op {
                return place;
            }
            if let Some(place) = list.handed.get(&(x, mask.key())) {
                return *place;
            }
            let place = HANDED + list.places;
            list.places += 1;
            let entry = list.push(Op::Put(place), vec![Arg::Node(x)], Facts::NOTHING);
            list.puts.insert(entry, mask.node().into_iter().collect());
            list.handed.insert((x, mask.key()), place);
            place
        })
    }

    /// Somebody else works here, with what was handed over.
    pub fn cut() {
        AT_HAND.with(|list| {
            let list = &mut *list.borrow_mut();
            list.given_up |= !list.open.is_empty();
            list.cuts.push(list.entries.nodes.len());
        });
    }

    /// A number that they made: its entry and its place.
    pub fn made() -> (u32, u32) {
        AT_HAND.with(|list| {
            let list = &mut *list.borrow_mut();
            let place = HANDED + list.places;
            list.places += 1;
            (list.push(Op::Input(place), vec![], Facts::within(f64::INFINITY)), place)
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
