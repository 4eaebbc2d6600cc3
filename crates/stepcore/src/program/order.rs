//! From entries to what is executed: what the state after the step needs, in order, with a register
//! for each number.
//!
//! A product that is used once is made together with the sum that uses it; it is rounded before it is
//! added, as it would be alone. A register is free again after the last operation that reads it, and
//! a number of the next state takes the place of that of the state, if nothing reads that any more.

use std::collections::HashMap;

use super::trace::Trace;
use crate::real::traced::{Arg, Node, Op};

/// What one operation does with registers; k stands for a known number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Do {
    Add,
    AddKnown,
    Sub,
    /// k − a.
    SubFrom,
    Mul,
    MulKnown,
    /// c + a b, and c + a k.
    MulAdd,
    MulKnownAdd,
    Div,
    Neg,
    Sqrt,
    Sin,
    Cos,
    Atan2,
    Pow,
    /// Of mask c: a or b.
    Select,
    Max,
    MaxKnown,
    Min,
    MinKnown,
    Lt,
    Le,
    Finite,
    And,
    Or,
    Not,
    Copy,
    /// Register d gets a known number.
    Known,
    /// The list is right only where |a| is no more than the limit, and where mask a does not hold.
    Within,
    Never,
    /// The same of masks a and b together.
    NeverBoth,
}

/// An operation: into register d, from registers a, b and c. Masks have registers of their own; a
/// known number is place b of `Ordered::known`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub what: Do,
    pub d: u16,
    pub a: u16,
    pub b: u16,
    pub c: u16,
}

/// What is executed, and what it needs.
#[derive(Clone, Debug, Default)]
pub(super) struct Ordered {
    pub steps: Vec<Step>,
    pub known: Vec<f64>,
    /// Registers that hold a known number throughout, by its place.
    pub fixed: Vec<(u16, u16)>,
    /// Registers of numbers, of which the first hold the state, and of masks.
    pub numbers: usize,
    pub masks: usize,
}

/// Registers that are free, and how many there are.
#[derive(Default)]
struct Registers {
    free: Vec<u16>,
    count: u16,
}

impl Registers {
    fn take(&mut self) -> u16 {
        self.free.pop().unwrap_or_else(|| self.new_one())
    }

    fn new_one(&mut self) -> u16 {
        self.count += 1;
        self.count - 1
    }
}

struct Work<'a> {
    nodes: &'a [Node],
    wanted: &'a [Arg],
    assumed: &'a [u32],
    /// By entry: how often others read it, what is wanted counting twice; the last entry that does;
    /// whether it is a product that is made with the sum that reads it; where it is.
    uses: Vec<usize>,
    last: Vec<usize>,
    fused: Vec<bool>,
    place: Vec<Option<u16>>,
    numbers: Registers,
    masks: Registers,
    known: HashMap<u64, u16>,
    fixed: HashMap<u64, u16>,
    done: Ordered,
}

/// The list that leaves the next state in the registers of the state, which come first, and
/// `beside` in the registers after these.
pub(super) fn order(trace: &Trace, beside: &[Arg]) -> Ordered {
    let wanted: Vec<Arg> = trace.qpos.iter().chain(&trace.qvel).chain(beside).copied().collect();
    let mut work = Work::new(&trace.nodes, &wanted, &trace.assumed);
    work.mark();
    for at in 0..trace.nodes.len() {
        work.entry(at);
        let this = Arg::Node(at as u32);
        if trace.assumed.contains(&(at as u32)) && !work.guards(at) {
            let mask = work.placed(this);
            work.push(Do::Never, [0, mask, 0, 0]);
        }
        if trace.qpos.contains(&this) {
            let number = work.placed(this);
            work.push(Do::Within, [0, number, 0, 0]);
        }
        work.release(at);
    }
    work.deliver();
    work.done.numbers = work.numbers.count.into();
    work.done.masks = work.masks.count.into();
    work.done
}

impl<'a> Work<'a> {
    fn new(nodes: &'a [Node], wanted: &'a [Arg], assumed: &'a [u32]) -> Self {
        let n = nodes.len();
        Self {
            nodes,
            wanted,
            assumed,
            uses: vec![0; n],
            last: vec![0; n],
            fused: vec![false; n],
            place: vec![None; n],
            numbers: Registers { free: vec![], count: wanted.len() as u16 },
            masks: Registers::default(),
            known: HashMap::new(),
            fixed: HashMap::new(),
            done: Ordered::default(),
        }
    }

    /// Finds out who reads what.
    fn mark(&mut self) {
        let end = self.nodes.len();
        let assumed = self.assumed;
        for node in self.wanted.iter().filter_map(|arg| arg.node()).chain(assumed.iter().copied()) {
            self.uses[node as usize] += 2;
            self.last[node as usize] = end;
        }
        // An entry reads older ones.
        for at in (0..end).rev() {
            if self.uses[at] > 0 {
                for node in self.nodes[at].args.iter().filter_map(|arg| arg.node()) {
                    self.uses[node as usize] += 1;
                }
            }
        }
        for at in 0..end {
            if self.uses[at] > 0 && self.nodes[at].op == Op::Add {
                if let Some(product) = self.product_of(at) {
                    self.fused[product] = true;
                }
            }
        }
        for at in 0..end {
            let Some(reader) = self.reader(at) else { continue };
            for node in self.nodes[at].args.iter().filter_map(|arg| arg.node()) {
                let last = &mut self.last[node as usize];
                *last = (*last).max(reader);
            }
        }
    }

    /// Of a sum of two entries: a product that nothing else reads.
    fn product_of(&self, at: usize) -> Option<usize> {
        let args: Vec<usize> =
            self.nodes[at].args.iter().filter_map(|arg| Some(arg.node()? as usize)).collect();
        let [a, b] = args[..] else { return None };
        let alone = |x: &usize| self.nodes[*x].op == Op::Mul && self.uses[*x] == 1;
        [b, a].into_iter().find(alone)
    }

    /// At which entry what this one reads is read.
    fn reader(&self, at: usize) -> Option<usize> {
        if self.uses[at] == 0 {
            return None;
        }
        if !self.fused[at] {
            return Some(at);
        }
        let reads = |entry: &usize| self.nodes[*entry].args.contains(&Arg::Node(at as u32));
        (at + 1..self.nodes.len()).filter(|entry| self.uses[*entry] > 0).find(reads)
    }

    fn push(&mut self, what: Do, [d, a, b, c]: [u16; 4]) {
        self.done.steps.push(Step { what, d, a, b, c });
    }

    /// The place of a known number.
    fn known(&mut self, value: f64) -> u16 {
        let list = &mut self.done.known;
        *self.known.entry(value.to_bits()).or_insert_with(|| {
            list.push(value);
            list.len() as u16 - 1
        })
    }

    /// The register in which a number or a mask is.
    fn placed(&mut self, arg: Arg) -> u16 {
        match arg {
            Arg::Node(node) => self.place[node as usize].unwrap_or_default(),
            Arg::Known(value) => {
                if let Some(register) = self.fixed.get(&value.to_bits()) {
                    return *register;
                }
                let (register, known) = (self.numbers.new_one(), self.known(value));
                self.fixed.insert(value.to_bits(), register);
                self.done.fixed.push((register, known));
                register
            }
        }
    }

    /// A register for what an entry computes: that of the state which it follows, if it may.
    fn register(&mut self, at: usize) -> u16 {
        let registers =
            if self.nodes[at].op.is_mask() { &mut self.masks } else { &mut self.numbers };
        let this = Arg::Node(at as u32);
        let Some(target) = self.wanted.iter().position(|arg| *arg == this) else {
            return registers.take();
        };
        let old = |node: &Node| node.op == Op::Input(target as u32);
        let old = self.nodes.iter().position(old);
        if old.is_none_or(|old| self.last[old] <= at) {
            return target as u16;
        }
        registers.take()
    }

    /// Two masks together, which nothing needs but that they do not hold.
    fn guards(&self, at: usize) -> bool {
        self.assumed.contains(&(at as u32)) && self.nodes[at].op == Op::And && self.uses[at] == 2
    }

    /// Executes an entry.
    fn entry(&mut self, at: usize) {
        if self.uses[at] == 0 || self.fused[at] {
            return;
        }
        let node = &self.nodes[at];
        if self.guards(at) {
            let [a, b] = [node.args[0], node.args[1]].map(|mask| self.placed(mask));
            return self.push(Do::NeverBoth, [0, a, b, 0]);
        }
        if let Op::Input(place) = node.op {
            self.place[at] = Some(place as u16);
            return;
        }
        let args = node.args.clone();
        let (what, [a, b, c]) = self.operation(at, &args);
        let d = self.register(at);
        self.place[at] = Some(d);
        self.push(what, [d, a, b, c]);
    }

    /// What to do, and where its operands are.
    fn operation(&mut self, at: usize, args: &[Arg]) -> (Do, [u16; 3]) {
        let op = self.nodes[at].op;
        if let (Op::Add, Some(product)) = (op, self.product_of(at)) {
            let other = if args[0] == Arg::Node(product as u32) { args[1] } else { args[0] };
            let c = self.placed(other);
            let factors = self.nodes[product].args.clone();
            let a = self.placed(factors[0]);
            return match factors[1] {
                Arg::Known(value) => (Do::MulKnownAdd, [a, self.known(value), c]),
                factor => (Do::MulAdd, [a, self.placed(factor), c]),
            };
        }
        match (op, args) {
            (Op::Select, &[mask, yes, no]) => {
                (Do::Select, [self.placed(yes), self.placed(no), self.placed(mask)])
            }
            (Op::Sub, &[Arg::Known(value), b]) => {
                (Do::SubFrom, [self.placed(b), self.known(value), 0])
            }
            (Op::Max, &[a, Arg::Known(value)]) => {
                (Do::MaxKnown, [self.placed(a), self.known(value), 0])
            }
            (Op::Min, &[a, Arg::Known(value)]) => {
                (Do::MinKnown, [self.placed(a), self.known(value), 0])
            }
            (Op::Add, &[a, Arg::Known(value)]) => {
                (Do::AddKnown, [self.placed(a), self.known(value), 0])
            }
            (Op::Mul, &[a, Arg::Known(value)]) => {
                (Do::MulKnown, [self.placed(a), self.known(value), 0])
            }
            (_, &[a]) => (alone(op), [self.placed(a), 0, 0]),
            (_, args) => (alone(op), [self.placed(args[0]), self.placed(args[1]), 0]),
        }
    }

    /// Registers that were read for the last time by this entry are free.
    fn release(&mut self, at: usize) {
        if self.uses[at] == 0 || self.fused[at] {
            return;
        }
        let mut read: Vec<u32> = self.nodes[at].args.iter().filter_map(|arg| arg.node()).collect();
        if let (Op::Add, Some(product)) = (self.nodes[at].op, self.product_of(at)) {
            read.extend(self.nodes[product].args.iter().filter_map(|arg| arg.node()));
        }
        read.sort_unstable();
        read.dedup();
        for node in read.into_iter().map(|node| node as usize) {
            let Some(place) = self.place[node] else { continue };
            if self.last[node] > at {
                continue;
            }
            if self.nodes[node].op.is_mask() {
                self.masks.free.push(place);
            } else if usize::from(place) >= self.wanted.len() {
                self.numbers.free.push(place);
            }
        }
    }

    /// Brings what is wanted where it is wanted.
    fn deliver(&mut self) {
        let mut moves = vec![];
        for (target, arg) in self.wanted.iter().enumerate() {
            let target = target as u16;
            match *arg {
                Arg::Known(value) => {
                    let known = self.known(value);
                    self.push(Do::Known, [target, 0, known, 0]);
                }
                arg => {
                    let from = self.placed(arg);
                    if from != target {
                        moves.push((from, target));
                    }
                }
            }
        }
        // What lies where something else goes is put aside first.
        for (from, _) in &mut moves {
            if usize::from(*from) < self.wanted.len() {
                let aside = self.numbers.new_one();
                self.push(Do::Copy, [aside, *from, 0, 0]);
                *from = aside;
            }
        }
        for (from, target) in moves {
            self.push(Do::Copy, [target, from, 0, 0]);
        }
    }
}

/// What an operation does where nothing of it is known.
fn alone(op: Op) -> Do {
    match op {
        Op::Add => Do::Add,
        Op::Sub => Do::Sub,
        Op::Mul => Do::Mul,
        Op::Div => Do::Div,
        Op::Neg => Do::Neg,
        Op::Sqrt => Do::Sqrt,
        Op::Sin => Do::Sin,
        Op::Cos => Do::Cos,
        Op::Atan2 => Do::Atan2,
        Op::Pow => Do::Pow,
        Op::Max => Do::Max,
        Op::Min => Do::Min,
        Op::Lt => Do::Lt,
        Op::Le => Do::Le,
        Op::Finite => Do::Finite,
        Op::And => Do::And,
        Op::Or => Do::Or,
        Op::Not => Do::Not,
        Op::Select => Do::Select,
        Op::Input(_) => Do::Copy,
    }
}
