//! Numbers that Python and the engine both see: the arrays that are the user's to write.
//!
//! One block belongs to Rust for as long as a numpy view of it lives, so whatever is
//! done to a view (reshaped, made read-only, resized) the block stays what it is.

use std::cell::UnsafeCell;
use std::ops::Range;

use numpy::ndarray::{ArrayView, IxDyn};
use numpy::{PyArray, PyArrayDyn};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use stepcore::arrays::Given;
use stepcore::model::Model;

/// The five arrays of `worlds` worlds: all worlds' qpos, then all worlds' qvel, and so on.
pub struct Arrays {
    /// Numbers a world has in qpos, qvel, ctrl, qfrc_applied, xfrc_applied.
    pub lengths: [usize; 5],
    pub worlds: usize,
    memory: Py<Memory>,
}

impl Arrays {
    /// Every world at qpos0 and at rest.
    pub fn new(py: Python<'_>, model: &Model, worlds: usize) -> PyResult<Self> {
        let (nv, nu) = (model.nv, model.actuators.len());
        let lengths = [model.nq, nv, nu, nv, 6 * model.bodies.len()];
        let memory = Py::new(py, Memory::new(worlds * lengths.iter().sum::<usize>()))?;
        memory.get().write(py, 0, &model.qpos0.repeat(worlds));
        Ok(Self { lengths, worlds, memory })
    }

    /// All worlds' part of one array.
    fn range(&self, array: usize) -> Range<usize> {
        let start = self.worlds * self.lengths[..array].iter().sum::<usize>();
        start..start + self.worlds * self.lengths[array]
    }

    /// One world's arrays; valid until Python code runs again.
    pub fn given<'a>(&'a self, py: Python<'a>, world: usize) -> Given<'a> {
        let of = |array| {
            let start = self.range(array).start + world * self.lengths[array];
            self.memory.get().read(py, start..start + self.lengths[array])
        };
        Given { qpos: of(0), qvel: of(1), ctrl: of(2), qfrc_applied: of(3), xfrc_applied: of(4) }
    }

    /// Lets `take(world, qpos, qvel)` overwrite every world's positions and velocities.
    /// It must not run Python code.
    pub fn store(&self, py: Python<'_>, mut take: impl FnMut(usize, &mut [f64], &mut [f64])) {
        let ([nq, nv, ..], n) = (self.lengths, self.worlds);
        self.memory.get().edit(py, 0..n * (nq + nv), |numbers| {
            let (qpos, qvel) = numbers.split_at_mut(n * nq);
            for world in 0..n {
                take(world, &mut qpos[world * nq..][..nq], &mut qvel[world * nv..][..nv]);
            }
        });
    }

    /// Overwrites one world's part of one array.
    pub fn write(&self, py: Python<'_>, array: usize, world: usize, values: &[f64]) {
        self.memory.get().write(py, self.range(array).start + world * self.lengths[array], values);
    }

    /// Overwrites all of one world's arrays with numbers that stand one after the other.
    pub fn restore(&self, py: Python<'_>, world: usize, mut numbers: &[f64]) {
        for (array, length) in self.lengths.into_iter().enumerate() {
            let (head, tail) = numbers.split_at(length);
            self.write(py, array, world, head);
            numbers = tail;
        }
    }

    /// A numpy view of all worlds' part of one array.
    pub fn view<'py>(
        &self,
        py: Python<'py>,
        array: usize,
        shape: &[usize],
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        Memory::view(self.memory.bind(py), self.range(array), shape)
    }
}

#[pyclass(module = "stepcore._core", frozen)]
pub struct Memory {
    numbers: Box<[UnsafeCell<f64>]>,
}

// SAFETY: the numbers are reached through numpy views and through `read` and `edit`,
// which need the GIL: never by two threads at once, except from native code that
// writes to a numpy array without the GIL, which is a race for every numpy array.
unsafe impl Sync for Memory {}

impl Memory {
    fn new(count: usize) -> Self {
        Self { numbers: (0..count).map(|_| UnsafeCell::new(0.0)).collect() }
    }

    /// The numbers of a range; valid until Python code runs again.
    fn read<'a>(&'a self, _py: Python<'a>, range: Range<usize>) -> &'a [f64] {
        let cells = &self.numbers[range];
        // SAFETY: UnsafeCell<f64> has the layout of f64; nobody writes while the GIL is
        // held here, and no caller keeps the slice while it lets Python run.
        unsafe { std::slice::from_raw_parts(cells.as_ptr().cast(), cells.len()) }
    }

    /// Lets `write` overwrite the numbers of a range. It must not run Python code.
    fn edit(&self, _py: Python<'_>, range: Range<usize>, write: impl FnOnce(&mut [f64])) {
        let cells = &self.numbers[range];
        // SAFETY: as for `read`; the slice ends with `write`, which runs no Python code.
        write(unsafe { std::slice::from_raw_parts_mut(cells.as_ptr() as *mut f64, cells.len()) });
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
        let cells = &this.get().numbers[range];
        // SAFETY: as for `read`; only the address and the shape are taken from the view.
        let numbers: &[f64] =
            unsafe { std::slice::from_raw_parts(cells.as_ptr().cast(), cells.len()) };
        let view = ArrayView::from_shape(IxDyn(shape), numbers)
            .map_err(|e| PyRuntimeError::new_err(e.to_string()))?;
        // SAFETY: the block is never moved or freed before `this`, which the array holds.
        Ok(unsafe { PyArray::borrow_from_array(&view, this.clone().into_any()) })
    }
}
