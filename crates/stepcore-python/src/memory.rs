//! Numbers that Python and the engine both see: the arrays that are the user's to write.
//!
//! One block belongs to Rust for as long as a numpy view of it lives, so whatever is
//! done to a view (reshaped, made read-only, resized) the block stays what it is.

use std::cell::UnsafeCell;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::ndarray::{ArrayViewMut, IxDyn};
use numpy::{PyArray, PyArrayDyn};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use stepcore::arrays::{Array, Given, Givens};
use stepcore::model::Model;

/// A numpy view with its name.
pub type Named<'py> = (&'static str, Bound<'py, PyArrayDyn<f64>>);

/// The arrays of `worlds` worlds: all worlds' qpos, then all worlds' qvel, and so on.
pub struct Arrays {
    /// Numbers a world has in each of `Array::ALL`, and their shape there.
    pub lengths: [usize; Array::COUNT],
    shapes: [Vec<usize>; Array::COUNT],
    pub worlds: usize,
    memory: Py<Memory>,
}

impl Arrays {
    /// Every world as it is initially: see `Array::initial`.
    pub fn new(py: Python<'_>, model: &Model, worlds: usize) -> PyResult<Self> {
        let (lengths, shapes) = (Array::counts(model), Array::ALL.map(|array| array.shape(model)));
        let memory = Py::new(py, Memory::new(worlds * lengths.iter().sum::<usize>()))?;
        let arrays = Self { lengths, shapes, worlds, memory };
        for array in Array::ALL {
            let start = arrays.range(array).start;
            arrays.memory.get().write(start, &array.initial(model).repeat(worlds));
        }
        Ok(arrays)
    }

    /// Memory [bytes].
    pub fn bytes(&self) -> usize {
        2 * size_of::<f64>() * self.worlds * self.lengths.iter().sum::<usize>()
    }

    /// All worlds' part of one array.
    fn range(&self, array: Array) -> Range<usize> {
        let array = array as usize;
        let start = self.worlds * self.lengths[..array].iter().sum::<usize>();
        start..start + self.worlds * self.lengths[array]
    }

    /// Lets `read` see one world's arrays.
    pub fn read<T>(
        &self,
        py: Python<'_>,
        world: usize,
        read: impl FnOnce(&Given) -> T + Send,
    ) -> T {
        let ranges = Array::ALL.into_iter().map(|array| {
            let (start, length) = (self.range(array).start, self.lengths[array as usize]);
            start + world * length..start + (world + 1) * length
        });
        self.see(py, ranges, |all| read(&all.of(world)))
    }

    /// Lets `read` see all worlds' arrays, from as many threads as it likes.
    pub fn read_all<T>(&self, py: Python<'_>, read: impl FnOnce(&Givens) -> T + Send) -> T {
        self.see(py, Array::ALL.into_iter().map(|array| self.range(array)), read)
    }

    fn see<T>(
        &self,
        _py: Python<'_>,
        ranges: impl Iterator<Item = Range<usize>>,
        read: impl FnOnce(&Givens) -> T + Send,
    ) -> T {
        self.memory.get().read(ranges, |numbers| {
            read(&Givens::new(self.worlds, |array| &numbers[self.range(array)]))
        })
    }

    /// Lets `take(array, numbers)` overwrite what a step changes, an array of all worlds at a time.
    pub fn store(&self, _py: Python<'_>, mut take: impl FnMut(Array, &mut [f64]) + Send) {
        for array in &Array::ALL[..Array::CHANGED] {
            self.memory.get().edit(self.range(*array), |numbers| take(*array, numbers));
        }
    }

    /// Overwrites one world's part of one array.
    pub fn write(&self, _py: Python<'_>, array: Array, world: usize, values: &[f64]) {
        let start = self.range(array).start + world * self.lengths[array as usize];
        self.memory.get().write(start, values);
    }

    /// Overwrites all of one world's arrays with numbers that stand one after the other.
    pub fn restore(&self, py: Python<'_>, world: usize, mut numbers: &[f64]) {
        for array in Array::ALL {
            let (head, tail) = numbers.split_at(self.lengths[array as usize]);
            self.write(py, array, world, head);
            numbers = tail;
        }
    }

    /// Numpy views of all worlds' part of each array; `before`: axes before those of a world.
    pub fn views<'py>(&self, py: Python<'py>, before: &[usize]) -> PyResult<Vec<Named<'py>>> {
        let view = |array: Array| {
            let shape = [before, &self.shapes[array as usize]].concat();
            let view = Memory::view(self.memory.bind(py), self.range(array), &shape)?;
            Ok((array.name(), view))
        };
        Array::ALL.into_iter().map(view).collect()
    }
}

#[pyclass(module = "stepcore._core", frozen)]
pub struct Memory {
    numbers: Box<[UnsafeCell<f64>]>,
    /// What the engine reads and writes: what was checked is what is used, whoever writes meanwhile.
    copy: Mutex<Box<[f64]>>,
}

// SAFETY: here the numbers are reached one by one, as atomics; no slice of them exists. Numpy reads and
// writes them through its views, also where it has released the GIL: a race, as it is for every numpy
// array, of which each number is one that was written.
unsafe impl Sync for Memory {}

impl Memory {
    fn new(count: usize) -> Self {
        let numbers = (0..count).map(|_| UnsafeCell::new(0.0)).collect();
        Self { numbers, copy: Mutex::new(vec![0.0; count].into()) }
    }

    /// Where a range starts. The pointer may be written through: it comes from the cells, not
    /// from a reference to a number.
    fn start(&self, range: &Range<usize>) -> *mut f64 {
        UnsafeCell::raw_get(self.numbers[range.clone()].as_ptr())
    }

    /// The numbers of a range, for this thread and all others.
    fn cells(&self, range: Range<usize>) -> impl Iterator<Item = &AtomicU64> {
        let cells = self.numbers[range].iter();
        // SAFETY: a cell has the size and the alignment of eight bytes, lives as long as `self`, and is
        // reached here as an atomic alone.
        cells.map(|cell| unsafe { AtomicU64::from_ptr(UnsafeCell::raw_get(cell).cast()) })
    }

    fn own(&self) -> MutexGuard<'_, Box<[f64]>> {
        self.copy.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets `read` see the numbers of some ranges as they are now; of the others nothing is said.
    fn read<T>(
        &self,
        ranges: impl Iterator<Item = Range<usize>>,
        read: impl FnOnce(&[f64]) -> T + Send,
    ) -> T {
        let mut copy = self.own();
        for range in ranges {
            for (to, from) in copy[range.clone()].iter_mut().zip(self.cells(range)) {
                *to = f64::from_bits(from.load(Ordering::Relaxed));
            }
        }
        read(&copy)
    }

    /// Lets `write` overwrite the numbers of a range, all of them.
    fn edit(&self, range: Range<usize>, write: impl FnOnce(&mut [f64]) + Send) {
        let mut copy = self.own();
        let own = &mut copy[range.clone()];
        write(own);
        for (to, from) in self.cells(range).zip(own) {
            to.store(from.to_bits(), Ordering::Relaxed);
        }
    }

    /// Overwrites the numbers from `start` on.
    fn write(&self, start: usize, values: &[f64]) {
        self.edit(start..start + values.len(), |numbers| numbers.copy_from_slice(values));
    }

    /// A numpy view of a range.
    fn view<'py>(
        this: &Bound<'py, Self>,
        range: Range<usize>,
        shape: &[usize],
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        if shape.iter().product::<usize>() != range.len() {
            let text = format!("a view of {} numbers cannot have shape {shape:?}", range.len());
            return Err(PyRuntimeError::new_err(text));
        }
        // SAFETY: the pointer is that of as many numbers as the shape has, and they may be
        // written. No reference to a number is made: numpy gets the address and the shape.
        let view = unsafe { ArrayViewMut::from_shape_ptr(IxDyn(shape), this.get().start(&range)) };
        // SAFETY: the block is never moved or freed before `this`, which the array holds.
        Ok(unsafe { PyArray::borrow_from_array(&view, this.clone().into_any()) })
    }
}
