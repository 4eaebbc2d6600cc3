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

/// Where the five arrays of `worlds` worlds stand in their memory: all worlds' qpos,
/// then all worlds' qvel, and so on.
pub struct Layout {
    /// Numbers a world has in qpos, qvel, ctrl, qfrc_applied, xfrc_applied.
    pub lengths: [usize; 5],
    pub worlds: usize,
}

impl Layout {
    pub fn of(model: &Model, worlds: usize) -> Self {
        let (nv, nu) = (model.nv, model.actuators.len());
        Self { lengths: [model.nq, nv, nu, nv, 6 * model.bodies.len()], worlds }
    }

    pub fn total(&self) -> usize {
        self.worlds * self.lengths.iter().sum::<usize>()
    }

    /// All worlds' part of one array.
    pub fn range(&self, array: usize) -> Range<usize> {
        let start = self.worlds * self.lengths[..array].iter().sum::<usize>();
        start..start + self.worlds * self.lengths[array]
    }

    /// One world's arrays among the numbers of the whole memory.
    pub fn given<'a>(&self, numbers: &'a [f64], world: usize) -> Given<'a> {
        let of = |array| {
            let start = self.range(array).start + world * self.lengths[array];
            &numbers[start..start + self.lengths[array]]
        };
        Given { qpos: of(0), qvel: of(1), ctrl: of(2), qfrc_applied: of(3), xfrc_applied: of(4) }
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
    pub fn new(count: usize) -> Self {
        Self { numbers: (0..count).map(|_| UnsafeCell::new(0.0)).collect() }
    }

    /// The numbers of a range; valid until Python code runs again.
    pub fn read<'a>(&'a self, _py: Python<'a>, range: Range<usize>) -> &'a [f64] {
        let cells = &self.numbers[range];
        // SAFETY: UnsafeCell<f64> has the layout of f64; nobody writes while the GIL is
        // held here, and no caller keeps the slice while it lets Python run.
        unsafe { std::slice::from_raw_parts(cells.as_ptr().cast(), cells.len()) }
    }

    /// Lets `write` overwrite the numbers of a range. It must not run Python code.
    pub fn edit(&self, _py: Python<'_>, range: Range<usize>, write: impl FnOnce(&mut [f64])) {
        let cells = &self.numbers[range];
        // SAFETY: as for `read`; the slice ends with `write`, which runs no Python code.
        write(unsafe { std::slice::from_raw_parts_mut(cells.as_ptr() as *mut f64, cells.len()) });
    }

    /// Overwrites the numbers from `start` on.
    pub fn write(&self, py: Python<'_>, start: usize, values: &[f64]) {
        self.edit(py, start..start + values.len(), |numbers| numbers.copy_from_slice(values));
    }

    /// A numpy view of a range.
    pub fn view<'py>(
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
