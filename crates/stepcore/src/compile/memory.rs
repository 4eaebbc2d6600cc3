//! Memory that holds code, and calls of it.
//!
//! Code is written, and then made executable: it is never both at once.
#![allow(unsafe_code)]

use memmap2::{Mmap, MmapMut};

use crate::real::traced::{Traced, TracedMask};
use crate::real::{Mask, Real, PACK};

/// What code is called with: state, space, known numbers, functions, steps. Returns steps left.
#[cfg(target_arch = "x86_64")]
type Step = unsafe extern "sysv64" fn(*mut u8, *mut u8, *const u8, *const usize, u64) -> u64;

/// Bytes at which vectors lie well.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Block([u8; PACK]);

/// Memory of so many bytes, and more, for vectors.
pub(crate) struct Aligned(Vec<Block>);

impl Aligned {
    pub fn new(bytes: usize) -> Self {
        Self(vec![Block([0; PACK]); bytes.div_ceil(PACK)])
    }

    /// One number of the state.
    pub fn number(&self, place: usize) -> &[u8; PACK] {
        &self.0[place].0
    }

    pub fn number_mut(&mut self, place: usize) -> &mut [u8; PACK] {
        &mut self.0[place].0
    }

    /// A number that is known, or stands for its place.
    pub fn read<R: Real>(&self, x: Traced, to: &mut R) {
        match x {
            Traced::Known(value) => *to = R::of(value),
            Traced::Node(place) => to.unpack(self.number(place as usize)),
        }
    }

    /// The same of a mask, which lies there as 1 or 0.
    pub fn lanes<R: Real>(&self, mask: TracedMask) -> R::Mask {
        match mask {
            TracedMask::Known(value) => R::Mask::of(value),
            TracedMask::Node(place) => {
                let mut number = R::zero();
                number.unpack(self.number(place as usize));
                number.gt(R::zero())
            }
        }
    }

    pub fn write<R: Real>(&mut self, place: u32, x: &R) {
        x.pack(self.number_mut(place as usize));
    }

    pub fn bytes(&self) -> &[u8] {
        // SAFETY: a block is bytes, all of which may be anything.
        unsafe { std::slice::from_raw_parts(self.0.as_ptr().cast(), PACK * self.0.len()) }
    }

    pub fn bytes_mut(&mut self) -> &mut [u8] {
        // SAFETY: as above.
        unsafe { std::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast(), PACK * self.0.len()) }
    }
}

/// Code of a step, and all that it reads.
pub(super) struct Executable {
    code: Mmap,
    known: Aligned,
    functions: [usize; 3],
    /// Bytes of the state, of the memory in which it works, and of a vector.
    state: usize,
    space: usize,
    vector: usize,
}

impl Executable {
    /// None where the system gives no such memory.
    pub fn new(
        code: &[u8],
        known: &[u8],
        functions: [usize; 3],
        (state, space, vector): (usize, usize, usize),
    ) -> Option<Self> {
        let mut memory = MmapMut::map_anon(code.len()).ok()?;
        memory[..code.len()].copy_from_slice(code);
        let mut own = Aligned::new(known.len());
        own.bytes_mut()[..known.len()].copy_from_slice(known);
        Some(Self { code: memory.make_exec().ok()?, known: own, functions, state, space, vector })
    }

    /// So many steps, or fewer, of the lanes that begin so many bytes into each number: how many are
    /// left.
    pub fn run(&self, state: &mut Aligned, space: &mut Aligned, lanes: usize, steps: u64) -> u64 {
        let (state, space) = (state.bytes_mut(), space.bytes_mut());
        let fits = state.len() >= self.state && space.len() >= self.space;
        if steps == 0 || !fits || lanes + self.vector > PACK {
            return steps;
        }
        #[cfg(not(target_arch = "x86_64"))]
        return steps;
        // SAFETY: this is code that `emit.rs` made, a function of this kind. It writes in the state and in
        // the space, which are as large as it needs, reads the known numbers, and calls the functions.
        #[cfg(target_arch = "x86_64")]
        unsafe {
            let step: Step = std::mem::transmute(self.code.as_ptr());
            step(
                state.as_mut_ptr().add(lanes),
                space.as_mut_ptr(),
                self.known.bytes().as_ptr(),
                self.functions.as_ptr(),
                steps,
            )
        }
    }
}
