//! The instructions of one operation.

use iced_x86::Register;

use super::assembler::{Base, Function, Operand, LEFT, READ};
use super::emit::Emitter;
use super::isa::{Do, ABOVE, AT_LEAST, AT_MOST, LESS};
use super::registers::{Class, Value};
use crate::real::traced::{Arg, Op};

/// A number that is read again within so many entries is worth a register.
const SOON: u32 = 32;

impl Emitter<'_> {
    fn value(&self, arg: Arg, mask: bool) -> Value {
        match self.needs.choices.of(arg) {
            Arg::Node(node) => Value::Node(node),
            Arg::Known(value) if mask => Value::Known(if value == 0.0 { 0 } else { !0 }),
            Arg::Known(value) => Value::Known(self.bits(value)),
        }
    }

    /// What an entry reads.
    pub(super) fn values(&self, entry: u32) -> Vec<Value> {
        let node = &self.list.nodes[entry as usize];
        let of_masks = matches!(node.op, Op::And | Op::Or | Op::Not);
        let read = |(at, arg): (usize, &Arg)| {
            self.value(*arg, of_masks || node.op == Op::Select && at == 0)
        };
        let mut values: Vec<Value> = node.args.iter().enumerate().map(read).collect();
        // Who reads the same twice reads it once.
        values.dedup();
        if values.len() == 3 && values[0] == values[2] {
            values.pop();
        }
        values
    }

    pub(super) fn entry(&mut self, at: u32, entry: u32) {
        let node = &self.list.nodes[entry as usize];
        let (op, args) = (node.op, node.args.clone());
        let reads = self.values(entry);
        match (op, &args[..]) {
            (Op::Sin | Op::Cos, &[x]) => return self.turn(entry, x, &reads),
            (Op::Atan2 | Op::Pow, &[y, x]) => return self.call_of_two(entry, op, [y, x], &reads),
            (Op::Select, &[mask, yes, no]) => self.choice(entry, [mask, yes, no], &reads),
            (Op::And | Op::Or, &[a, b]) => self.masks(entry, op, [a, b], &reads),
            (Op::Not, &[a]) => {
                let a = self.value(a, true);
                let from = self.registers.register(&mut self.asm, a, Class::Mask);
                let to = self.target(entry, &reads);
                if self.isa.wide {
                    self.asm.masks(Do::Xor, to, from, from);
                } else {
                    self.asm.two(Do::Xor, to, from, Operand::Known(!0));
                }
            }
            (Op::Lt | Op::Le, &[a, b]) => self.comparison(entry, op, [a, b], at, &reads),
            (Op::Finite, &[a]) => {
                let a = self.value(a, false);
                let from = self.registers.register(&mut self.asm, a, Class::Number);
                let size = self.registers.borrow(&mut self.asm, Class::Number);
                let abs = if self.isa.single { u64::from(u32::MAX >> 1) } else { u64::MAX >> 1 };
                let infinite = Operand::Known(self.bits(f64::INFINITY));
                self.asm.two(Do::And, size, from, Operand::Known(abs));
                let to = self.target(entry, &reads);
                self.asm.compare(to, size, infinite, LESS);
            }
            (Op::Put(place), &[a]) => {
                let a = self.value(a, false);
                let from = self.registers.register(&mut self.asm, a, Class::Number);
                self.asm.store(Base::State, place, from);
                self.registers.have_read(&reads);
            }
            (Op::Neg, &[a]) => {
                let a = self.value(a, false);
                let from = self.registers.register(&mut self.asm, a, Class::Number);
                let to = self.target(entry, &reads);
                let sign = self.bits(-0.0);
                self.asm.two(Do::Xor, to, from, Operand::Known(sign));
            }
            (Op::Sqrt, &[a]) => {
                let a = self.value(a, false);
                let from = self.registers.operand(self.isa, a, Class::Number);
                let from = match from {
                    Operand::Known(_) => {
                        Operand::Register(self.registers.register(&mut self.asm, a, Class::Number))
                    }
                    from => from,
                };
                let to = self.target(entry, &reads);
                self.asm.one(Do::Sqrt, to, from);
            }
            (op, &[a, b]) => self.arithmetic(entry, op, [a, b], at, &reads),
            _ => {}
        }
        self.finish(entry);
    }

    /// The register of what an entry makes, once it has read what it reads.
    fn target(&mut self, entry: u32, reads: &[Value]) -> Register {
        self.registers.have_read(reads);
        let class = if self.is_mask(entry) { Class::Mask } else { Class::Number };
        self.registers.take(&mut self.asm, Value::Node(entry), class)
    }

    /// What an entry made is there for others.
    fn finish(&mut self, entry: u32) {
        let value = Value::Node(entry);
        if let Some(to) = self.vector(self.homes[entry as usize]) {
            let class = if self.is_mask(entry) { Class::Mask } else { Class::Number };
            if let Operand::Register(register) = self.registers.operand(self.isa, value, class) {
                self.asm.store(Base::Space, to, register);
            }
            self.registers.lies(value, Operand::Memory(Base::Space, to));
        }
        self.registers.drop_unread(value);
    }

    /// In a register if it is in one, or soon read again; else where it lies.
    fn either(&mut self, value: Value, at: u32, class: Class) -> Operand {
        let soon = self.registers.next(value).is_some_and(|next| next < at + SOON);
        let known = matches!(value, Value::Known(_));
        if soon && !known && !self.registers.is_held(value) {
            return Operand::Register(self.registers.register(&mut self.asm, value, class));
        }
        self.registers.operand(self.isa, value, class)
    }

    fn arithmetic(&mut self, entry: u32, op: Op, [a, b]: [Arg; 2], at: u32, reads: &[Value]) {
        let [mut a, mut b] = [a, b].map(|arg| self.value(arg, false));
        let what = match op {
            Op::Add => Do::Add,
            Op::Sub => Do::Sub,
            Op::Mul => Do::Mul,
            Op::Div => Do::Div,
            Op::Max => Do::Max,
            _ => Do::Min,
        };
        let either_way = matches!(op, Op::Add | Op::Mul);
        // Of a and b, neither of which is the larger, vectors give the second.
        if matches!(op, Op::Max | Op::Min)
            || either_way && !self.registers.is_held(a) && self.registers.is_held(b)
        {
            (a, b) = (b, a);
        }
        let first = self.registers.register(&mut self.asm, a, Class::Number);
        let second = self.either(b, at, Class::Number);
        let to = self.target(entry, reads);
        self.asm.two(what, to, first, second);
    }

    fn comparison(&mut self, entry: u32, op: Op, [a, b]: [Arg; 2], at: u32, reads: &[Value]) {
        let [mut a, mut b] = [a, b].map(|arg| self.value(arg, false));
        let mut how = if op == Op::Lt { LESS } else { AT_MOST };
        if !self.registers.is_held(a) && self.registers.is_held(b) {
            (a, b) = (b, a);
            how = if op == Op::Lt { ABOVE } else { AT_LEAST };
        }
        let first = self.registers.register(&mut self.asm, a, Class::Number);
        let second = self.either(b, at, Class::Number);
        let to = self.target(entry, reads);
        self.asm.compare(to, first, second, how);
    }

    fn masks(&mut self, entry: u32, op: Op, [a, b]: [Arg; 2], reads: &[Value]) {
        let [a, b] = [a, b].map(|arg| self.value(arg, true));
        let what = if op == Op::And { Do::And } else { Do::Or };
        let first = self.registers.register(&mut self.asm, a, Class::Mask);
        if self.isa.wide {
            let second = self.registers.register(&mut self.asm, b, Class::Mask);
            let to = self.target(entry, reads);
            return self.asm.masks(what, to, first, second);
        }
        let second = self.registers.operand(self.isa, b, Class::Mask);
        let to = self.target(entry, reads);
        self.asm.two(what, to, first, second);
    }

    fn choice(&mut self, entry: u32, [mask, yes, no]: [Arg; 3], reads: &[Value]) {
        let mask = self.value(mask, true);
        let [yes, no] = [yes, no].map(|arg| self.value(arg, false));
        let mask = self.registers.register(&mut self.asm, mask, Class::Mask);
        if no == Value::Known(0) && !self.isa.wide {
            let yes = self.registers.operand(self.isa, yes, Class::Number);
            let to = self.target(entry, reads);
            return self.asm.two(Do::And, to, mask, yes);
        }
        let no = self.registers.register(&mut self.asm, no, Class::Number);
        let yes = self.registers.operand(self.isa, yes, Class::Number);
        let to = self.target(entry, reads);
        self.asm.choose(to, mask, yes, no);
    }

    // ---- functions

    /// Sine and cosine, both at once if the region has both.
    fn turn(&mut self, entry: u32, x: Arg, reads: &[Value]) {
        let of = self.needs.choices.of(x).key();
        let mut both = self.turns.get(&of).copied().unwrap_or_default();
        let cosine = self.list.nodes[entry as usize].op == Op::Cos;
        both[usize::from(cosine)] = Some(entry);
        self.call(Function::SinCos, &[x], reads);
        for (index, own) in both.into_iter().enumerate() {
            if let Some(own) = own {
                self.take_result(own, LEFT + index as u32);
                if own != entry {
                    self.made.push(own);
                }
            }
        }
    }

    fn call_of_two(&mut self, entry: u32, op: Op, args: [Arg; 2], reads: &[Value]) {
        let function = if op == Op::Atan2 { Function::Atan2 } else { Function::Pow };
        self.call(function, &args, reads);
        self.take_result(entry, LEFT);
    }

    fn call(&mut self, function: Function, args: &[Arg], reads: &[Value]) {
        for (at, arg) in args.iter().enumerate() {
            let value = self.value(*arg, false);
            let register = self.registers.register(&mut self.asm, value, Class::Number);
            self.asm.store(Base::Space, READ + at as u32, register);
        }
        self.registers.have_read(reads);
        self.registers.release();
        self.registers.lose_all(&mut self.asm);
        self.asm.call(function);
    }

    fn take_result(&mut self, entry: u32, from: u32) {
        let register = self.registers.take(&mut self.asm, Value::Node(entry), Class::Number);
        self.asm.load(register, Operand::Memory(Base::Space, from));
        self.finish(entry);
    }
}
