//! Numbers that Python and the engine both see: the arrays that the user may write.
//!
//! One block belongs to Rust for as long as a numpy view of it lives, so the block stays the same
//! whatever is done to a view (reshaped, made read-only, resized).

use std::cell::UnsafeCell;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::ndarray::{ArrayViewMut, IxDyn};
use numpy::{PyArray, PyArrayDyn};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use stepcore::arrays::{Array, ArraySet, Given, Givens};
use stepcore::model::Model;

/// A numpy view with its name.
pub type Named<'py> = (&'static str, Bound<'py, PyArrayDyn<f64>>);

/// The arrays of `worlds` worlds: all worlds' qpos, then all worlds' qvel, and so on.
pub struct Arrays {
    /// Numbers a world has in each of `Array::ALL`, and their shape there.
    pub lengths: [usize; Array::COUNT],
    shapes: [Vec<usize>; Array::COUNT],
    /// The start of the first world's part of each.
    starts: [usize; Array::COUNT],
    pub worlds: usize,
    memory: Py<Memory>,
}

impl Arrays {
    /// The initial arrays of every world: see `Array::initial`.
    pub fn new(py: Python<'_>, model: &Model, worlds: usize) -> PyResult<Self> {
        let (lengths, shapes) = (Array::counts(model), Array::ALL.map(|array| array.shape(model)));
        let mut count = 0;
        let starts = lengths.map(|length| {
            let start = count;
            count += worlds * length;
            start
        });
        let memory = Py::new(py, Memory::new(count))?;
        let arrays = Self { lengths, shapes, starts, worlds, memory };
        for array in Array::ALL {
            let initial = array.initial(model).repeat(worlds);
            arrays.memory.get().write(array, arrays.range(array), &initial);
        }
        Ok(arrays)
    }

    /// Memory [bytes].
    pub fn bytes(&self) -> usize {
        2 * size_of::<f64>() * self.worlds * self.lengths.iter().sum::<usize>()
    }

    /// All worlds' part of one array.
    fn range(&self, array: Array) -> Range<usize> {
        let start = self.starts[array as usize];
        start..start + self.worlds * self.lengths[array as usize]
    }

    /// One world's part of one array.
    #[inline]
    fn range_of(&self, array: Array, world: usize) -> Range<usize> {
        let length = self.lengths[array as usize];
        let start = self.starts[array as usize] + world * length;
        start..start + length
    }

    /// Lets `read` see one world's arrays.
    pub fn read<T>(
        &self,
        _py: Python<'_>,
        world: usize,
        read: impl FnOnce(&Given) -> T + Send,
    ) -> T {
        let range = |array| self.range_of(array, world);
        self.memory.get().read(range, |numbers, _| {
            read(&Given::new(|array| &numbers[self.range_of(array, world)]))
        })
    }

    /// Lets `load` copy in the arrays of the only world, of which some may have changed since it
    /// last did so; it is not called if none has.
    pub fn load<E>(
        &self,
        _py: Python<'_>,
        load: impl FnOnce(&Given, ArraySet) -> Result<(), E> + Send,
    ) -> Result<(), E> {
        let range = |array| self.range_of(array, 0);
        self.memory.get().read(range, |numbers, news| {
            if *news != ArraySet::NONE {
                load(&Given::new(|array| &numbers[self.range_of(array, 0)]), *news)?;
                *news = ArraySet::NONE;
            }
            Ok(())
        })
    }

    /// Lets `read` see all worlds' arrays, from any number of threads.
    pub fn read_all<T>(&self, _py: Python<'_>, read: impl FnOnce(&Givens) -> T + Send) -> T {
        self.memory.get().read(
            |array| self.range(array),
            |numbers, _| read(&Givens::new(self.worlds, |array| &numbers[self.range(array)])),
        )
    }

    /// Lets `take(array, numbers)` overwrite the arrays that a step changes, all worlds at once.
    pub fn store(&self, _py: Python<'_>, mut take: impl FnMut(Array, &mut [f64]) + Send) {
        let mut own = self.memory.get().own();
        for array in &Array::ALL[..Array::CHANGED] {
            let numbers = self.range(*array);
            if numbers.is_empty() {
                continue;
            }
            take(*array, &mut own.numbers[numbers.clone()]);
            self.memory.get().show(&own, numbers);
        }
    }

    /// Overwrites one world's part of one array.
    pub fn write(&self, _py: Python<'_>, array: Array, world: usize, values: &[f64]) {
        self.memory.get().write(array, self.range_of(array, world), values);
    }

    /// Overwrites all of one world's arrays with numbers one after the other.
    pub fn restore(&self, py: Python<'_>, world: usize, mut numbers: &[f64]) {
        for array in Array::ALL {
            let (head, tail) = numbers.split_at(self.lengths[array as usize]);
            self.write(py, array, world, head);
            numbers = tail;
        }
    }

    /// Numpy views of all worlds' part of each array; `before`: axes before a world's.
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
    own: Mutex<Own>,
}

/// The engine's copy, which is what was checked, whoever writes meanwhile.
struct Own {
    numbers: Box<[f64]>,
    /// The arrays that may differ from the engine's.
    news: ArraySet,
}

// SAFETY: here the numbers are reached one by one, as atomics; no slice of them exists. Numpy reads
// and writes them through its views, also where it has released the GIL: a race, as it is for every
// numpy array, in which each number is one that was written.
unsafe impl Sync for Memory {}

impl Memory {
    fn new(count: usize) -> Self {
        let numbers = (0..count).map(|_| UnsafeCell::new(0.0)).collect();
        let own = Own { numbers: vec![0.0; count].into(), news: ArraySet::NONE };
        Self { numbers, own: Mutex::new(own) }
    }

    /// The start of a range. The pointer may be written through: it comes from the cells, not from
    /// a reference to a number.
    fn start(&self, range: &Range<usize>) -> *mut f64 {
        UnsafeCell::raw_get(self.numbers[range.clone()].as_ptr())
    }

    /// The numbers of a range, for this thread and all others.
    fn cells(&self, range: Range<usize>) -> impl Iterator<Item = &AtomicU64> {
        let cells = self.numbers[range].iter();
        // SAFETY: a cell has the size and the alignment of eight bytes, lives as long as `self`,
        // and is reached here as an atomic alone.
        cells.map(|cell| unsafe { AtomicU64::from_ptr(UnsafeCell::raw_get(cell).cast()) })
    }

    fn own(&self) -> MutexGuard<'_, Own> {
        self.own.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets `read` see the present numbers of a range of each array, and which arrays may have
    /// changed; for other numbers it returns no information.
    fn read<T>(
        &self,
        range: impl Fn(Array) -> Range<usize>,
        read: impl FnOnce(&[f64], &mut ArraySet) -> T + Send,
    ) -> T {
        let Own { numbers, news } = &mut *self.own();
        for array in Array::ALL {
            let range = range(array);
            let own = &mut numbers[range.clone()];
            // Most of the time nothing was written: this is checked first, without writing.
            let both = own.iter().zip(self.cells(range.clone()));
            let differ = both
                .fold(0, |differ, (own, now)| differ | own.to_bits() ^ now.load(Ordering::Relaxed));
            if differ != 0 {
                for (own, now) in own.iter_mut().zip(self.cells(range)) {
                    *own = f64::from_bits(now.load(Ordering::Relaxed));
                }
                news.insert(array);
            }
        }
        read(numbers, news)
    }

    /// Shows numpy the numbers of a range.
    fn show(&self, own: &Own, range: Range<usize>) {
        for (to, from) in self.cells(range.clone()).zip(&own.numbers[range]) {
            to.store(from.to_bits(), Ordering::Relaxed);
        }
    }

    /// Overwrites a range of an array.
    fn write(&self, array: Array, range: Range<usize>, values: &[f64]) {
        let mut own = self.own();
        own.numbers[range.clone()].copy_from_slice(values);
        own.news.insert(array);
        self.show(&own, range);
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
        // SAFETY: the pointer is to as many numbers as the shape has, and they may be written. No
        // reference to a number is made: numpy gets the address and the shape.
        let view = unsafe { ArrayViewMut::from_shape_ptr(IxDyn(shape), this.get().start(&range)) };
        // SAFETY: the block is never moved or freed before `this`, which the array holds.
        Ok(unsafe { PyArray::borrow_from_array(&view, this.clone().into_any()) })
    }
}
