//! Machine code of a step: what a scene requires, and nothing else.
//!
//! The stages ask of every element whether it is there, go through lists, and find each number by its
//! address: in lanes that is three quarters of their instructions. Here the operations of a step are
//! written down once (`real/traced/`), ordered so that what no lane needs is jumped over (`needs.rs`,
//! `regions.rs`), and made to code for the vectors of this processor (`emit.rs`). The formulas are those
//! of the stages, written nowhere else, and so are the bits: no sum is put in another order, and no
//! product is fused with one.

mod alone;
mod aside;
mod assembler;
mod coming;
mod desk;
mod emit;
mod functions;
mod handed;
mod isa;
mod list;
mod memory;
mod needs;
mod operations;
mod pairs;
mod regions;
mod registers;
mod rows;
mod slots;
mod split;
#[cfg(test)]
mod tests;
mod text;
mod trace;

pub(crate) use alone::Alone;
pub use coming::{vectors, Coming};
pub use desk::Compiled;
pub(crate) use desk::Desk;
pub(crate) use isa::Isa;
pub(crate) use list::List;
pub(crate) use memory::Aligned;

use emit::Emitter;
use memory::Executable;
use needs::Needs;
use regions::Order;
use slots::Slots;

use crate::real::PACK;

/// Code of a step for some worlds side by side.
pub(crate) struct Code {
    pub isa: Isa,
    executable: Executable,
    /// Bytes of code, of known numbers, of the state, and of the memory in which it works.
    pub sizes: [usize; 4],
}

impl Code {
    /// That of a list; none where this machine has no memory for it, or the list is not one.
    pub fn of(list: &List, isa: Isa) -> Option<Self> {
        let needs = Needs::of(list);
        let order = Order::of(list, &needs);
        let slots = Slots::of(list, &needs, &order);
        let emitted = Emitter::new(isa, list, &needs, &order, &slots).emit()?;
        let (code, known) = (emitted.assembled.code, emitted.assembled.known);
        let state = PACK * list.places();
        let space = isa.bytes() * emitted.space;
        let sizes = [code.len(), known.len(), state, space];
        #[cfg(target_arch = "x86_64")]
        let functions = functions::of(isa);
        #[cfg(not(target_arch = "x86_64"))]
        let functions = [0; 3];
        let memory = (state, space, isa.bytes());
        let executable = Executable::new(&code, &known, functions, memory)?;
        Some(Self { isa, executable, sizes })
    }

    /// So many steps of the lanes of one vector, or as many as the list is right for: how many are left.
    pub fn run(&self, [state, space]: &mut [Aligned; 2], vector: usize, steps: u64) -> u64 {
        self.executable.run(state, space, vector * self.isa.bytes(), steps)
    }
}
