//! Numbers that Python and the engine both see: the arrays that are the user's to write.
//!
//! One block belongs to Rust for as long as a numpy view of it lives, so whatever is
//! done to a view (reshaped, made read-only, resized) the block stays what it is.

use std::cell::UnsafeCell;
use std::ops::Range;
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
            arrays.memory.get().write(py, start, &array.initial(model).repeat(worlds));
        }
        Ok(arrays)
    }

    /// Memory [bytes].
    pub fn bytes(&self) -> usize {
        size_of::<f64>() * self.worlds * self.lengths.iter().sum::<usize>()
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
        self.read_all(py, |all| read(&all.of(world)))
    }

    /// Lets `read` see all worlds' arrays, from as many threads as it likes.
    pub fn read_all<T>(&self, py: Python<'_>, read: impl FnOnce(&Givens) -> T + Send) -> T {
        self.memory.get().read(py, |numbers| {
            read(&Givens::new(self.worlds, |array| &numbers[self.range(array)]))
        })
    }

    /// Lets `take(array, numbers)` overwrite what a step changes, an array of all worlds at a time.
    pub fn store(&self, py: Python<'_>, mut take: impl FnMut(Array, &mut [f64]) + Send) {
        for array in &Array::ALL[..Array::CHANGED] {
            self.memory.get().edit(py, self.range(*array), |numbers| take(*array, numbers));
        }
    }

    /// Overwrites one world's part of one array.
    pub fn write(&self, py: Python<'_>, array: Array, world: usize, values: &[f64]) {
        let start = self.range(array).start + world * self.lengths[array as usize];
        self.memory.get().write(py, start, values);
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
    sliced: Mutex<()>,
}

// SAFETY: the numbers are reached through `read` and `edit`, of which one runs at a time, and
// through numpy views. Those need the GIL, where there is one; without it, to write to a view
// while another thread steps is a race as it is for every numpy array. What it can spoil is
// numbers, and no index into the engine's memory goes unchecked because of one.
unsafe impl Sync for Memory {}

/// Slices of the numbers exist only while a closure of `read` or `edit` runs. The closure is
/// `Send`, so it cannot hold what Python code is run by (`Python`, `Bound`): with the GIL nothing
/// else reaches the numbers while there is a slice, and whoever holds `sliced` waits for no one.
impl Memory {
    fn new(count: usize) -> Self {
        let numbers = (0..count).map(|_| UnsafeCell::new(0.0)).collect();
        Self { numbers, sliced: Mutex::new(()) }
    }

    /// Where a range starts. The pointer may be written through: it comes from the cells, not
    /// from a reference to a number.
    fn start(&self, range: &Range<usize>) -> *mut f64 {
        UnsafeCell::raw_get(self.numbers[range.clone()].as_ptr())
    }

    /// Held while there is a slice of the numbers: a Python without the GIL has several threads
    /// in here at once. Where there is a GIL, that is enough, and costs nothing.
    fn alone(&self) -> Option<MutexGuard<'_, ()>> {
        cfg!(Py_GIL_DISABLED).then(|| self.sliced.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Lets `read` see all numbers.
    fn read<T>(&self, _py: Python<'_>, read: impl FnOnce(&[f64]) -> T + Send) -> T {
        let count = self.numbers.len();
        let _alone = self.alone();
        // SAFETY: the cells are `count` numbers in a row, and nobody writes: see `Sync`.
        read(unsafe { std::slice::from_raw_parts(self.start(&(0..count)), count) })
    }

    /// Lets `write` overwrite the numbers of a range.
    fn edit(&self, _py: Python<'_>, range: Range<usize>, write: impl FnOnce(&mut [f64]) + Send) {
        let start = self.start(&range);
        let _alone = self.alone();
        // SAFETY: as for `read`; nobody else reads or writes.
        write(unsafe { std::slice::from_raw_parts_mut(start, range.len()) });
    }

    /// Overwrites the numbers from `start` on.
    fn write(&self, py: Python<'_>, start: usize, values: &[f64]) {
        self.edit(py, start..start + values.len(), |numbers| numbers.copy_from_slice(values));
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
