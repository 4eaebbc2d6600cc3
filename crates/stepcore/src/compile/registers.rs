//! Which number is in which register of a region.
//!
//! Where there is none left, the one that is read latest makes room (Belady 1966, which is best for code
//! without branches).

use std::collections::HashMap;

use iced_x86::Register;

use super::assembler::{Assembler, Base, Operand};
use super::isa::Isa;

/// A number or a mask in a region: an entry, or the bits of what is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Value {
    Node(u32),
    Known(u64),
}

/// Which registers hold it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Class {
    Number,
    Mask,
}

#[derive(Default)]
pub(super) struct Registers {
    /// By class and register.
    held: [Vec<Option<Value>>; 2],
    /// Of what is in a register: which.
    place: HashMap<Value, u8>,
    /// Of what the region reads: its readers, the next one last.
    readers: HashMap<Value, Vec<u32>>,
    /// Where it lies in memory, if it does.
    memory: HashMap<Value, Operand>,
    /// Vectors where numbers are put aside: those that are free, and how many there are.
    free: Vec<u32>,
    late: Vec<u32>,
    aside: HashMap<Value, u32>,
    /// The first of them, and the first beyond all that were ever needed.
    pub first: u32,
    pub end: u32,
    /// What the instruction at hand reads stays.
    pinned: Vec<Value>,
    own_masks: bool,
}

impl Registers {
    pub fn new(isa: Isa, first: u32) -> Self {
        let held = isa.registers().map(|count| vec![None; count]);
        Self { held, first, end: first, own_masks: isa.wide, ..Self::default() }
    }

    /// A region begins: nothing is in a register.
    pub fn begin(&mut self) {
        self.held.iter_mut().for_each(|held| held.fill(None));
        self.place.clear();
        self.readers.clear();
        self.memory.clear();
        self.aside.clear();
        self.late.clear();
        self.free = (self.first..self.end).rev().collect();
    }

    /// Readers of a value, in order: this is another one.
    pub fn reads(&mut self, value: Value, reader: u32) {
        self.readers.entry(value).or_default().push(reader);
    }

    /// All readers are known.
    pub fn ready(&mut self) {
        self.readers.values_mut().for_each(|readers| readers.reverse());
    }

    /// A value lies in memory.
    pub fn lies(&mut self, value: Value, at: Operand) {
        self.memory.insert(value, at);
    }

    fn class(&self, class: Class) -> usize {
        usize::from(class == Class::Mask && self.own_masks)
    }

    fn name(&self, isa: Isa, class: usize, index: u8) -> Register {
        if class == 1 {
            Isa::mask(index)
        } else {
            isa.vector(index)
        }
    }

    pub fn is_held(&self, value: Value) -> bool {
        self.place.contains_key(&value)
    }

    /// Who reads it after the instruction at hand, which reads it once.
    pub fn next(&self, value: Value) -> Option<u32> {
        let readers = self.readers.get(&value)?;
        readers.len().checked_sub(2).map(|at| readers[at])
    }

    /// Where a value is.
    pub fn operand(&mut self, isa: Isa, value: Value, class: Class) -> Operand {
        self.pinned.push(value);
        if let Some(index) = self.place.get(&value) {
            return Operand::Register(self.name(isa, self.class(class), *index));
        }
        match value {
            Value::Known(bits) => Operand::Known(bits),
            node => self.memory.get(&node).copied().unwrap_or(Operand::Known(0)),
        }
    }

    /// A value in a register.
    pub fn register(&mut self, asm: &mut Assembler, value: Value, class: Class) -> Register {
        match self.operand(asm.isa, value, class) {
            Operand::Register(register) => register,
            memory => {
                let register = self.take(asm, value, class);
                asm.load(register, memory);
                register
            }
        }
    }

    /// A register for a value, which it holds from now on.
    pub fn take(&mut self, asm: &mut Assembler, value: Value, class: Class) -> Register {
        let bank = self.class(class);
        let empty = self.held[bank].iter().position(Option::is_none);
        let index = empty.unwrap_or_else(|| self.make_room(asm, bank));
        self.held[bank][index] = Some(value);
        self.place.insert(value, index as u8);
        self.name(asm.isa, bank, index as u8)
    }

    /// A register for the moment, which holds nothing afterwards.
    pub fn borrow(&mut self, asm: &mut Assembler, class: Class) -> Register {
        let bank = self.class(class);
        let empty = self.held[bank].iter().position(Option::is_none);
        let index = empty.unwrap_or_else(|| self.make_room(asm, bank));
        self.name(asm.isa, bank, index as u8)
    }

    fn make_room(&mut self, asm: &mut Assembler, bank: usize) -> usize {
        let held = self.held[bank].iter().enumerate();
        let loose = held.filter_map(|(index, value)| Some((index, (*value)?)));
        let loose = loose.filter(|(_, value)| !self.pinned.contains(value));
        let next = |value: &Value| {
            self.readers.get(value).and_then(|readers| readers.last()).copied().unwrap_or(u32::MAX)
        };
        // What lies in memory already goes first among equals.
        let latest = loose.max_by_key(|(_, value)| (next(value), self.memory.contains_key(value)));
        let Some((index, value)) = latest else { return 0 };
        self.save(asm, value, bank, index as u8);
        self.held[bank][index] = None;
        self.place.remove(&value);
        index
    }

    /// Puts a value aside that is read again and lies nowhere in memory.
    fn save(&mut self, asm: &mut Assembler, value: Value, bank: usize, index: u8) {
        let read = self.readers.get(&value).is_some_and(|readers| !readers.is_empty());
        if !read || self.memory.contains_key(&value) || matches!(value, Value::Known(_)) {
            return;
        }
        let vector = self.free.pop().unwrap_or_else(|| {
            self.end += 1;
            self.end - 1
        });
        asm.store(Base::Space, vector, self.name(asm.isa, bank, index));
        self.aside.insert(value, vector);
        self.memory.insert(value, Operand::Memory(Base::Space, vector));
    }

    /// The instruction at hand has read these values once each.
    pub fn have_read(&mut self, values: &[Value]) {
        for value in values {
            let Some(readers) = self.readers.get_mut(value) else { continue };
            readers.pop();
            if !readers.is_empty() {
                continue;
            }
            for held in &mut self.held {
                held.iter_mut().filter(|held| **held == Some(*value)).for_each(|held| *held = None);
            }
            self.place.remove(value);
            if let Some(vector) = self.aside.remove(value) {
                self.memory.remove(value);
                self.late.push(vector);
            }
        }
    }

    /// The instruction is written.
    pub fn release(&mut self) {
        self.pinned.clear();
        self.free.append(&mut self.late);
    }

    /// A value that nobody reads here needs no register any more.
    pub fn drop_unread(&mut self, value: Value) {
        if self.readers.get(&value).is_none_or(Vec::is_empty) {
            for held in &mut self.held {
                held.iter_mut().filter(|held| **held == Some(value)).for_each(|held| *held = None);
            }
            self.place.remove(&value);
        }
    }

    /// Registers lose what they hold.
    pub fn lose_all(&mut self, asm: &mut Assembler) {
        for bank in 0..2 {
            for index in 0..self.held[bank].len() {
                if let Some(value) = self.held[bank][index].take() {
                    self.save(asm, value, bank, index as u8);
                    self.place.remove(&value);
                }
            }
        }
    }
}
