//! Machine code of a list.
//!
//! Within a region numbers stay in registers while they are read; between regions they are in their slots.

use std::collections::HashMap;

use iced_x86::Register;

use super::assembler::{Assembled, Assembler, Base, Label, Operand, When, CALLS};
use super::isa::{Do, Isa, NOT_AT_MOST};
use super::list::List;
use super::needs::Needs;
use super::regions::{Order, Part, Region};
use super::registers::{Registers, Value};
use super::slots::{Home, Slots};
use crate::real::traced::{Arg, Op};

pub(super) struct Emitter<'a> {
    pub(super) isa: Isa,
    pub(super) asm: Assembler,
    pub(super) list: &'a List,
    pub(super) needs: &'a Needs,
    order: &'a Order,
    pub(super) homes: &'a [Home],
    /// The first vector of the slots.
    base: u32,
    pub(super) registers: Registers,
    /// Entries of the region at hand that are made with others.
    pub(super) made: Vec<u32>,
    /// Sines and cosines of the same, by what they are of.
    pub(super) turns: HashMap<(bool, u64), [Option<u32>; 2]>,
}

/// Code, and in how many vectors it works.
pub(super) struct Emitted {
    pub assembled: Assembled,
    pub space: usize,
}

impl<'a> Emitter<'a> {
    pub fn new(
        isa: Isa,
        list: &'a List,
        needs: &'a Needs,
        order: &'a Order,
        slots: &'a Slots,
    ) -> Self {
        let base = CALLS + list.loops.len() as u32;
        Self {
            isa,
            asm: Assembler::new(isa),
            list,
            needs,
            order,
            homes: &slots.homes,
            base,
            registers: Registers::new(isa, base + slots.count),
            made: vec![],
            turns: HashMap::new(),
        }
    }

    /// So many steps, or as many as it is right for: it commits no other, and returns how many are left.
    pub fn emit(mut self) -> Option<Emitted> {
        let (top, wrong) = (self.asm.label(), self.asm.label());
        self.asm.enter();
        self.asm.bind(top);
        let order = self.order;
        let mut open: Vec<(Label, Label)> = vec![];
        for (index, part) in order.parts.iter().enumerate() {
            match part {
                Part::Region(region) => self.region(index, region),
                Part::Begin(own) => open.push(self.begin_loop(*own)),
                Part::End(own) => {
                    let labels = open.pop()?;
                    self.end_loop(*own, labels);
                }
            }
        }
        self.check(wrong);
        self.commit();
        self.asm.next_step(top);
        self.asm.bind(wrong);
        self.asm.leave();
        Some(Emitted { space: self.registers.end as usize, assembled: self.asm.finish()? })
    }

    /// The state becomes the next one.
    fn commit(&mut self) {
        let register = self.isa.vector(0);
        let wanted = self.list.wanted.iter().enumerate();
        let goes = wanted.map(|(at, (arg, _))| (at as u32, self.operand(*arg)));
        let mut goes: Vec<(u32, Operand)> =
            goes.filter(|(at, from)| *from != Operand::Memory(Base::State, *at)).collect();
        // What only changes its place is put aside before something else comes there.
        let ends = self.list.wanted.len() as u32;
        let mut aside = self.registers.first;
        for (_, from) in &mut goes {
            if matches!(from, Operand::Memory(Base::State, place) if *place < ends) {
                self.asm.load(register, *from);
                self.asm.store(Base::Space, aside, register);
                *from = Operand::Memory(Base::Space, aside);
                aside += 1;
            }
        }
        self.registers.end = self.registers.end.max(aside);
        let under = |(at, _): &(u32, Operand)| self.list.under.get(&(*at as usize)).copied();
        for same in goes.chunk_by(|a, b| under(a) == under(b)) {
            let past = under(&same[0]).map(|mask| {
                let mask = self.operand(Arg::Node(mask));
                let label = self.asm.label();
                self.asm.test(mask);
                self.asm.jump(When::None, label);
                label
            });
            for (at, from) in same {
                self.asm.load(register, *from);
                self.asm.store(Base::State, *at, register);
            }
            past.into_iter().for_each(|label| self.asm.bind(label));
        }
    }

    pub(super) fn is_mask(&self, node: u32) -> bool {
        self.list.nodes[node as usize].op.is_mask()
    }

    pub(super) fn vector(&self, home: Home) -> Option<u32> {
        match home {
            Home::Slot(slot) => Some(self.base + slot),
            _ => None,
        }
    }

    pub(super) fn bits(&self, value: f64) -> u64 {
        if self.isa.single {
            u64::from((value as f32).to_bits())
        } else {
            value.to_bits()
        }
    }

    /// Where a number or a mask lies between regions.
    fn operand(&self, arg: Arg) -> Operand {
        match self.needs.choices.of(arg) {
            Arg::Known(value) => Operand::Known(self.bits(value)),
            Arg::Node(node) => match self.homes[node as usize] {
                Home::Input(place) => Operand::Memory(Base::State, place),
                Home::Slot(slot) => Operand::Memory(Base::Space, self.base + slot),
                Home::None => Operand::Known(0),
            },
        }
    }

    /// Between regions: a number or a mask to a slot.
    fn copy(&mut self, from: Arg, to: u32, mask: bool) {
        let from = self.needs.choices.of(from);
        match from {
            Arg::Known(value) if mask => self.known_mask(to, value != 0.0),
            from => {
                let source = self.operand(from);
                let register =
                    if mask && self.isa.wide { Isa::mask(0) } else { self.isa.vector(0) };
                self.asm.load(register, source);
                self.asm.store(Base::Space, to, register);
            }
        }
    }

    /// What must be moved so that the slot of an entry holds this, if anything: from, to, a mask.
    fn moved(&self, from: Arg, entry: u32) -> Option<(Arg, u32, bool)> {
        let home = self.homes[entry as usize];
        let there = from.node().is_some_and(|node| self.homes[node as usize] == home);
        self.vector(home).filter(|_| !there).map(|to| (from, to, self.is_mask(entry)))
    }

    /// All at once: what lies where something else goes is put aside first.
    fn move_all(&mut self, moves: &[(Arg, u32, bool)]) {
        let goals: Vec<u32> = moves.iter().map(|(_, to, _)| *to).collect();
        let lies = |own: &Self, from: Arg| own.vector(own.homes[from.node()? as usize]);
        let (late, now): (Vec<_>, Vec<_>) = moves
            .iter()
            .copied()
            .partition(|(from, _, _)| lies(self, *from).is_some_and(|from| goals.contains(&from)));
        let first = self.registers.first;
        for (aside, (from, _, mask)) in (first..).zip(&late) {
            self.copy(*from, aside, *mask);
        }
        for (from, to, mask) in now {
            self.copy(from, to, mask);
        }
        for (aside, (_, to, mask)) in (first..).zip(&late) {
            let register = if *mask && self.isa.wide { Isa::mask(0) } else { self.isa.vector(0) };
            self.asm.load(register, Operand::Memory(Base::Space, aside));
            self.asm.store(Base::Space, *to, register);
        }
        self.registers.end = self.registers.end.max(first + late.len() as u32);
    }

    fn known_mask(&mut self, to: u32, value: bool) {
        if self.isa.wide {
            return self.asm.store_mask(to, value);
        }
        let register = self.isa.vector(0);
        self.asm.load(register, Operand::Known(if value { !0 } else { 0 }));
        self.asm.store(Base::Space, to, register);
    }

    // ---- what ends a step

    /// Masks that hold nowhere, and numbers up to which the list is right; else it goes no further.
    fn check(&mut self, wrong: Label) {
        let (isa, list) = (self.isa, self.list);
        let abs = if isa.single { u64::from(u32::MAX >> 1) } else { u64::MAX >> 1 };
        let [x, other, bad] = [0, 1, 2].map(|index| isa.vector(index));
        let (bad, more) = if isa.wide { (Isa::mask(0), Isa::mask(1)) } else { (bad, other) };
        let mut any = false;
        for (arg, limit) in &list.wanted {
            let from = self.operand(*arg);
            if !limit.is_finite() || matches!(from, Operand::Known(_)) {
                continue;
            }
            self.asm.load(x, from);
            self.asm.two(Do::And, x, x, Operand::Known(abs));
            let limit = Operand::Known(self.bits(*limit));
            self.asm.compare(if any { more } else { bad }, x, limit, NOT_AT_MOST);
            self.gather(&mut any, bad, more);
        }
        for mask in &list.assumed {
            let from = self.operand(Arg::Node(*mask));
            self.asm.load(if any { more } else { bad }, from);
            self.gather(&mut any, bad, more);
        }
        if any {
            self.asm.test(Operand::Register(bad));
            self.asm.jump(When::Some, wrong);
        }
    }

    fn gather(&mut self, any: &mut bool, bad: Register, more: Register) {
        if !std::mem::replace(any, true) {
            return;
        }
        if self.isa.wide {
            self.asm.masks(Do::Or, bad, bad, more);
        } else {
            self.asm.two(Do::Or, bad, bad, Operand::Register(more));
        }
    }

    // ---- loops

    /// What a loop changes, as far as anybody reads it.
    fn changed(&self, own: usize) -> Vec<(u32, u32)> {
        let used = |both: &&(u32, u32)| self.needs.used[both.0 as usize];
        self.list.loops[own].changed.iter().filter(used).copied().collect()
    }

    fn begin_loop(&mut self, own: usize) -> (Label, Label) {
        let mut moves = vec![];
        for (enter, _) in self.changed(own) {
            let before = self.needs.choices.of(self.list.nodes[enter as usize].args[0]);
            moves.extend(self.moved(before, enter));
        }
        self.move_all(&moves);
        let inside = &self.list.loops[own];
        let (top, end) = (self.asm.label(), self.asm.label());
        if !self.needs.used[inside.changed[inside.live].0 as usize] {
            return (top, end);
        }
        self.asm.count_from(CALLS + own as u32, inside.most);
        self.asm.bind(top);
        let live = self.operand(Arg::Node(inside.changed[inside.live].0));
        self.asm.test(live);
        self.asm.jump(When::None, end);
        (top, end)
    }

    fn end_loop(&mut self, own: usize, (top, end): (Label, Label)) {
        let inside = &self.list.loops[own];
        if !self.needs.used[inside.changed[inside.live].0 as usize] {
            return;
        }
        let mut moves = vec![];
        for (enter, leave) in self.changed(own) {
            let after = self.needs.choices.of(self.list.nodes[leave as usize].args[0]);
            moves.extend(self.moved(after, enter));
        }
        self.move_all(&moves);
        self.asm.count_down(CALLS + own as u32);
        self.asm.jump(When::Some, top);
        self.asm.bind(end);
    }

    // ---- regions

    fn region(&mut self, part: usize, region: &Region) {
        let mut past = None;
        if let Some(guard) = region.guard {
            let guard = self.operand(Arg::Node(guard));
            self.asm.test(guard);
            let label = self.asm.label();
            self.asm.jump(When::None, label);
            past = Some(label);
        }
        self.registers.begin();
        self.made.clear();
        self.turns.clear();
        for (at, entry) in region.entries.iter().enumerate() {
            for value in self.values(*entry) {
                self.registers.reads(value, at as u32);
                if let Value::Node(node) = value {
                    if self.order.part_of[node as usize] != part
                        || matches!(self.homes[node as usize], Home::Input(_))
                    {
                        let home = self.operand(Arg::Node(node));
                        self.registers.lies(value, home);
                    }
                }
            }
            let node = &self.list.nodes[*entry as usize];
            if let Op::Sin | Op::Cos = node.op {
                let of = self.needs.choices.of(node.args[0]).key();
                let both = self.turns.entry(of).or_default();
                both[usize::from(node.op == Op::Cos)] = Some(*entry);
            }
        }
        self.registers.ready();
        for (at, entry) in region.entries.iter().enumerate() {
            if !self.made.contains(entry) {
                self.entry(at as u32, *entry);
            } else {
                let values = self.values(*entry);
                self.registers.have_read(&values);
            }
            self.registers.release();
        }
        let Some(past) = past else { return };
        let left = self.left_alone(part, region);
        if left.is_empty() {
            return self.asm.bind(past);
        }
        let end = self.asm.label();
        self.asm.go(end);
        self.asm.bind(past);
        self.move_all(&left);
        self.asm.bind(end);
    }

    /// Where a guard holds nowhere: what stands in the place of what is made behind it.
    fn left_alone(&self, part: usize, region: &Region) -> Vec<(Arg, u32, bool)> {
        let mut done: Vec<Home> = vec![];
        let mut left = vec![];
        for entry in region.entries.iter().filter(|entry| self.needs.merged.contains_key(entry)) {
            let home = self.homes[*entry as usize];
            if !done.contains(&home) {
                done.push(home);
                left.extend(self.moved(self.outside(part, *entry), *entry));
            }
        }
        left
    }

    /// What a merged entry is where its region is not executed: through others of that region.
    fn outside(&self, part: usize, entry: u32) -> Arg {
        let mut own = entry;
        loop {
            let Some((_, other)) = self.needs.merged.get(&own) else { return Arg::Node(own) };
            match self.needs.choices.of(*other) {
                Arg::Node(node)
                    if self.needs.merged.contains_key(&node)
                        && self.order.part_of[node as usize] == part =>
                {
                    own = node;
                }
                other => return other,
            }
        }
    }
}
