//! Bytes of instructions, jumps, and the numbers that code reads.

use std::collections::HashMap;

use iced_x86::{Code, Encoder, IcedError, Instruction, MemoryOperand, Register};

use super::isa::{Do, Isa};
use crate::real::PACK;

/// The state that a step changes, the memory in which it works, known numbers, functions; steps left
/// are counted in r15.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Base {
    State,
    Space,
}

const KNOWN: Register = Register::R13;

impl Base {
    fn register(self) -> Register {
        match self {
            Self::State => Register::RBX,
            Self::Space => Register::R12,
        }
    }
}

/// Functions that code calls, by their places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Function {
    SinCos,
    Atan2,
    Pow,
}

/// Vectors at the beginning of the memory of a step: what a function reads, and what it leaves.
pub(super) const READ: u32 = 0;
pub(super) const LEFT: u32 = 2;
pub(super) const CALLS: u32 = 4;

/// Where an operand is: in a register, in memory by its vector there, or among the known numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Operand {
    Register(Register),
    Memory(Base, u32),
    Known(u64),
}

/// Where code goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Label(usize);

/// When it does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum When {
    /// The mask that was tested holds nowhere; or somewhere.
    None,
    Some,
}

pub(super) struct Assembler {
    pub isa: Isa,
    code: Vec<u8>,
    encoder: Encoder,
    known: HashMap<u64, u32>,
    pool: Vec<u8>,
    /// Where an offset is missing, and to which label.
    jumps: Vec<(usize, Label)>,
    labels: Vec<usize>,
    /// An instruction does not exist: there is no code.
    failed: bool,
}

/// Code, and the bits of the numbers that it knows.
pub(super) struct Assembled {
    pub code: Vec<u8>,
    pub known: Vec<u8>,
}

impl Assembler {
    pub fn new(isa: Isa) -> Self {
        Self {
            isa,
            code: vec![],
            encoder: Encoder::new(64),
            known: HashMap::new(),
            pool: vec![],
            jumps: vec![],
            labels: vec![],
            failed: false,
        }
    }

    pub fn finish(self) -> Option<Assembled> {
        let Self { mut code, pool, jumps, labels, failed, .. } = self;
        for (at, label) in jumps {
            let by = labels[label.0] as i64 - (at as i64 + 4);
            code[at..at + 4].copy_from_slice(&i32::try_from(by).ok()?.to_le_bytes());
        }
        (!failed).then_some(Assembled { code, known: pool })
    }

    fn put(&mut self, instruction: Result<Instruction, IcedError>) {
        let Ok(instruction) = instruction else { return self.failed = true };
        self.failed |= self.encoder.encode(&instruction, 0).is_err();
        self.code.append(&mut self.encoder.take_buffer());
    }

    pub fn bytes(&mut self, bytes: &[u8]) {
        self.code.extend_from_slice(bytes);
    }

    fn offset(&self, vector: u32) -> i32 {
        (vector as usize * self.isa.bytes()) as i32
    }

    /// Of a number of the state, where those of all lanes lie together.
    fn place(&self, base: Base, at: u32) -> i32 {
        match base {
            Base::State => (at as usize * PACK) as i32,
            Base::Space => self.offset(at),
        }
    }

    fn memory(&mut self, operand: Operand) -> MemoryOperand {
        let (base, at, repeated) = match operand {
            Operand::Memory(base, at) => (base.register(), self.place(base, at), false),
            Operand::Known(bits) => (KNOWN, self.constant(bits), self.isa.wide),
            Operand::Register(_) => (KNOWN, 0, false),
        };
        MemoryOperand::new(base, Register::None, 1, at.into(), 1, repeated, Register::None)
    }

    /// Where a known number lies. AVX-512 repeats it for all lanes, and others read a vector.
    fn constant(&mut self, bits: u64) -> i32 {
        let Self { isa, known, pool, .. } = self;
        let each = if isa.wide { isa.size() } else { isa.bytes() };
        let index = *known.entry(bits).or_insert_with(|| {
            for _ in 0..each / isa.size() {
                pool.extend_from_slice(&bits.to_le_bytes()[..isa.size()]);
            }
            (pool.len() / each - 1) as u32
        });
        (index as usize * each) as i32
    }

    /// to = a what b.
    pub fn two(&mut self, what: Do, to: Register, a: Register, b: Operand) {
        let code = self.isa.code(what);
        let made = match b {
            Operand::Register(b) => Instruction::with3(code, to, a, b),
            memory => {
                let memory = self.memory(memory);
                Instruction::with3(code, to, a, memory)
            }
        };
        self.put(made);
    }

    /// to = what a.
    pub fn one(&mut self, what: Do, to: Register, a: Operand) {
        let what = match (what, a) {
            (Do::Load, Operand::Known(_)) if self.isa.wide => Do::Broadcast,
            _ => what,
        };
        let code = self.isa.code(what);
        let made = match a {
            Operand::Register(a) => Instruction::with2(code, to, a),
            memory => {
                let mut memory = self.memory(memory);
                memory.is_broadcast &= what != Do::Broadcast;
                Instruction::with2(code, to, memory)
            }
        };
        self.put(made);
    }

    pub fn compare(&mut self, to: Register, a: Register, b: Operand, how: u8) {
        let (code, how) = (self.isa.code(Do::Compare), u32::from(how));
        let made = match b {
            Operand::Register(b) => Instruction::with4(code, to, a, b, how),
            memory => {
                let memory = self.memory(memory);
                Instruction::with4(code, to, a, memory, how)
            }
        };
        self.put(made);
    }

    /// to = mask ? yes : no.
    pub fn choose(&mut self, to: Register, mask: Register, yes: Operand, no: Register) {
        let code = self.isa.code(Do::Choose);
        let memory = match yes {
            Operand::Register(_) => None,
            memory => Some(self.memory(memory)),
        };
        let made = match (self.isa.wide, yes, memory) {
            (false, Operand::Register(yes), _) => Instruction::with4(code, to, no, yes, mask),
            (false, _, Some(yes)) => Instruction::with4(code, to, no, yes, mask),
            (_, Operand::Register(yes), _) => Instruction::with3(code, to, no, yes),
            (_, _, Some(yes)) => Instruction::with3(code, to, no, yes),
            _ => return self.failed = true,
        };
        self.put(made.map(|mut made| {
            if self.isa.wide {
                made.set_op_mask(mask);
            }
            made
        }));
    }

    /// Of masks in registers of their own.
    pub fn masks(&mut self, what: Do, to: Register, a: Register, b: Register) {
        let single = self.isa.single;
        let made = match (what, single) {
            (Do::And, false) => Instruction::with3(Code::VEX_Kandb_kr_kr_kr, to, a, b),
            (Do::And, true) => Instruction::with3(Code::VEX_Kandw_kr_kr_kr, to, a, b),
            (Do::Or, false) => Instruction::with3(Code::VEX_Korb_kr_kr_kr, to, a, b),
            (Do::Or, true) => Instruction::with3(Code::VEX_Korw_kr_kr_kr, to, a, b),
            (_, false) => Instruction::with2(Code::VEX_Knotb_kr_kr, to, a),
            (_, true) => Instruction::with2(Code::VEX_Knotw_kr_kr, to, a),
        };
        self.put(made);
    }

    pub fn load(&mut self, to: Register, from: Operand) {
        match from {
            Operand::Register(from) if from == to => {}
            memory if to.is_k() => {
                let memory = self.memory(memory);
                self.put(Instruction::with2(Code::VEX_Kmovw_kr_km16, to, memory));
            }
            from => self.one(Do::Load, to, from),
        }
    }

    pub fn store(&mut self, base: Base, vector: u32, from: Register) {
        let memory = self.memory(Operand::Memory(base, vector));
        let code = if from.is_k() { Code::VEX_Kmovw_m16_kr } else { self.isa.code(Do::Store) };
        self.put(Instruction::with2(code, memory, from));
    }

    /// A known mask, where masks have registers of their own.
    pub fn store_mask(&mut self, vector: u32, value: bool) {
        self.bytes(&[0x66, 0x41, 0xC7, 0x84, 0x24]);
        self.bytes(&self.offset(vector).to_le_bytes());
        self.bytes(&if value { [0xFF; 2] } else { [0; 2] });
    }

    /// Asks whether a mask holds anywhere; a jump follows.
    pub fn test(&mut self, mask: Operand) {
        match (mask, self.isa.wide) {
            (Operand::Register(mask), true) => {
                let kortest = if self.isa.single {
                    Code::VEX_Kortestw_kr_kr
                } else {
                    Code::VEX_Kortestb_kr_kr
                };
                self.put(Instruction::with2(kortest, mask, mask));
            }
            (Operand::Memory(_, vector), true) => {
                let compare: &[u8] = if self.isa.single {
                    &[0x66, 0x41, 0x83, 0xBC, 0x24]
                } else {
                    &[0x41, 0x80, 0xBC, 0x24]
                };
                self.bytes(compare);
                self.bytes(&self.offset(vector).to_le_bytes());
                self.bytes(&[0]);
            }
            (mask, false) => {
                let own = self.isa.vector(0);
                let register = if let Operand::Register(mask) = mask { mask } else { own };
                self.load(register, mask);
                self.put(Instruction::with2(Code::VEX_Vptest_ymm_ymmm256, register, register));
            }
            // What is known needs no test: no trace asks.
            (Operand::Known(_), true) => self.failed = true,
        }
    }

    pub fn label(&mut self) -> Label {
        self.labels.push(usize::MAX);
        Label(self.labels.len() - 1)
    }

    pub fn bind(&mut self, label: Label) {
        self.labels[label.0] = self.code.len();
    }

    pub fn jump(&mut self, when: When, to: Label) {
        self.bytes(&[0x0F, if when == When::None { 0x84 } else { 0x85 }]);
        self.jumps.push((self.code.len(), to));
        self.bytes(&[0; 4]);
    }

    /// Code goes on there.
    pub fn go(&mut self, to: Label) {
        self.bytes(&[0xE9]);
        self.jumps.push((self.code.len(), to));
        self.bytes(&[0; 4]);
    }

    /// A counter in memory begins.
    pub fn count_from(&mut self, vector: u32, most: u32) {
        self.bytes(&[0x41, 0xC7, 0x84, 0x24]);
        self.bytes(&self.offset(vector).to_le_bytes());
        self.bytes(&most.to_le_bytes());
    }

    /// It is one less; a jump follows, which some are left for.
    pub fn count_down(&mut self, vector: u32) {
        self.bytes(&[0x41, 0x83, 0xAC, 0x24]);
        self.bytes(&self.offset(vector).to_le_bytes());
        self.bytes(&[1]);
    }

    /// A function of what lies at `READ` leaves its values at `LEFT`. No register keeps anything.
    pub fn call(&mut self, function: Function) {
        // vzeroupper; rdi = r12; rsi = r12 + …; call [r14 + …]
        self.bytes(&[0xC5, 0xF8, 0x77, 0x4C, 0x89, 0xE7, 0x49, 0x8D, 0xB4, 0x24]);
        self.bytes(&self.offset(LEFT).to_le_bytes());
        self.bytes(&[0x41, 0xFF, 0x96]);
        self.bytes(&(8 * function as i32).to_le_bytes());
    }

    /// A function begins: of state, memory, known numbers, functions, and a number of steps.
    pub fn enter(&mut self) {
        // push rbx, rbp, r12 to r15; rsp −= 8, so that calls find the stack aligned
        self.bytes(&[0x53, 0x55, 0x41, 0x54, 0x41, 0x55, 0x41, 0x56, 0x41, 0x57]);
        self.bytes(&[0x48, 0x83, 0xEC, 0x08]);
        // rbx, r12, r13, r14, r15 = rdi, rsi, rdx, rcx, r8
        self.bytes(&[0x48, 0x89, 0xFB, 0x49, 0x89, 0xF4, 0x49, 0x89, 0xD5]);
        self.bytes(&[0x49, 0x89, 0xCE, 0x4D, 0x89, 0xC7]);
    }

    /// One step less is left: back, if there is another.
    pub fn next_step(&mut self, top: Label) {
        self.bytes(&[0x49, 0xFF, 0xCF]);
        self.jump(When::Some, top);
    }

    /// It returns how many steps are left.
    pub fn leave(&mut self) {
        self.bytes(&[0x4C, 0x89, 0xF8, 0xC5, 0xF8, 0x77, 0x48, 0x83, 0xC4, 0x08]);
        self.bytes(&[0x41, 0x5F, 0x41, 0x5E, 0x41, 0x5D, 0x41, 0x5C, 0x5D, 0x5B, 0xC3]);
    }
}
