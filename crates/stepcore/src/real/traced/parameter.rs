//! Numbers of models that differ by world: what the code of a step reads beside the state.

use core::cell::RefCell;
use std::collections::HashMap;

use crate::real::Constant;

/// A number of the model: the same in all, or that of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Parameter {
    Same(f64),
    Each(u32),
}

/// Columns so far: each has a number for every model, and stands once.
#[derive(Default)]
struct Columns {
    all: Vec<Vec<f64>>,
    known: HashMap<Vec<u64>, u32>,
}

thread_local! {
    static COLUMNS: RefCell<Columns> = RefCell::default();
}

impl Parameter {
    /// From here on columns are those of other models.
    pub(crate) fn begin() {
        COLUMNS.with(|columns| *columns.borrow_mut() = Columns::default());
    }

    /// The columns, by which code knows them.
    pub(crate) fn columns() -> Vec<Vec<f64>> {
        COLUMNS.with(|columns| columns.borrow().all.clone())
    }

    fn column(numbers: Vec<f64>) -> Self {
        COLUMNS.with(|columns| {
            let Columns { all, known } = &mut *columns.borrow_mut();
            let bits = numbers.iter().map(|x| x.to_bits()).collect();
            let index = *known.entry(bits).or_insert_with(|| {
                all.push(numbers);
                all.len() as u32 - 1
            });
            Self::Each(index)
        })
    }

    /// What none of a column exceeds.
    pub(super) fn most(index: u32) -> f64 {
        COLUMNS.with(|columns| {
            let own = &columns.borrow().all[index as usize];
            own.iter().fold(0.0_f64, |most, x| most.max(x.abs()))
        })
    }

    /// How many models there are where some number differs.
    pub(super) fn models() -> usize {
        COLUMNS.with(|columns| columns.borrow().all.first().map_or(0, Vec::len))
    }
}

impl Constant for Parameter {
    fn by_lane(numbers: &[f64]) -> Self {
        let first = numbers[0];
        if numbers.iter().all(|x| x.to_bits() == first.to_bits()) {
            return Self::Same(first);
        }
        Self::column(numbers.to_vec())
    }
    fn lane(&self, lane: usize) -> f64 {
        match self {
            Self::Same(x) => *x,
            Self::Each(index) => {
                COLUMNS.with(|columns| columns.borrow().all[*index as usize][lane])
            }
        }
    }
}
