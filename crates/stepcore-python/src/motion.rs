//! Whole motions: controls in, samples out, in one call without the GIL.

use std::sync::Arc;

use numpy::{PyArrayDyn, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use stepcore::arrays::Array;
use stepcore::batch::{Motion, Record, Sampled};
use stepcore::error::Error;
use stepcore::model::Model;
use stepcore::settings::{Precision, Settings};

use crate::gil;
use crate::memory::Arrays;
use crate::model::shaped;

/// Samples by name, and the number of force evaluations in each world.
pub type Samples<'py> = (Vec<Bound<'py, PyArrayDyn<f64>>>, Vec<u64>);

/// The request from Python.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Asked {
    /// The sampled quantities, by the names of `Sampled`.
    names: Vec<String>,
    steps: usize,
    every: usize,
    /// Steps for which a row of controls is held.
    hold: usize,
    /// Whether the start is sampled.
    first: bool,
    /// A world of a batch stops when a body is farther than this from its start [m].
    bound: f64,
    /// The number of force evaluations after which adaptive steps stop.
    most: u64,
}

impl Asked {
    /// Requests a sample after each step, with a row of controls for each.
    pub fn every_step(names: Vec<String>, steps: usize) -> Self {
        let (bound, most) = (f64::INFINITY, u64::MAX);
        Self { names, steps, every: 1, hold: 1, first: false, bound, most }
    }
}

/// A motion of some worlds, ready to run.
pub struct Play {
    model: Arc<Model>,
    worlds: usize,
    asked: Asked,
    samples: usize,
    names: Vec<Sampled>,
    /// For all worlds together, or for each; `rows` of them.
    ctrl: Vec<f64>,
    rows: usize,
}

impl Play {
    pub fn new(
        model: Arc<Model>,
        settings: &Settings,
        worlds: usize,
        asked: Asked,
        ctrl: Option<&PyReadonlyArray3<'_, f64>>,
    ) -> PyResult<Self> {
        let named = |name: &String| Sampled::ALL.into_iter().find(|what| what.name() == name);
        let unknown = |name: &String| PyValueError::new_err(format!("{name} cannot be sampled"));
        let names = asked.names.iter().map(|name| named(name).ok_or_else(|| unknown(name)));
        let names = names.collect::<PyResult<Vec<_>>>()?;
        let nu = model.actuators.len();
        let (ctrl, rows) = match ctrl {
            Some(ctrl) => (controls(settings, worlds, nu, ctrl)?, ctrl.shape()[1]),
            None => (Vec::new(), 0),
        };
        let samples = asked.steps / asked.every.max(1) + usize::from(asked.first);
        Ok(Self { model, worlds, asked, samples, names, ctrl, rows })
    }

    /// Runs it: `run(motion, from, n)` makes some of its steps. Returns the number of steps, and
    /// the outcome.
    pub fn run<'py>(
        &self,
        py: Python<'py>,
        pace: &gil::Pace,
        told: Option<&Bound<'_, PyAny>>,
        mut run: impl FnMut(&mut Motion, usize, usize) -> Result<(), Error> + Send,
    ) -> PyResult<(usize, PyResult<Samples<'py>>)> {
        let Self { model, worlds, asked, samples, names, .. } = self;
        let size = |what: &Sampled| what.shape(model).iter().product::<usize>();
        let lists = names.iter().map(|what| room(*worlds, *samples, size(what)));
        let mut lists = lists.collect::<PyResult<Vec<_>>>()?;
        let homes = if asked.bound.is_finite() { size(&Sampled::Position) } else { 0 };
        let mut motion = Motion {
            every: asked.every.max(1),
            samples: *samples,
            first: asked.first,
            ctrl: &self.ctrl,
            rows: self.rows,
            hold: asked.hold.max(1),
            bound: asked.bound,
            most: asked.most,
            home: room(*worlds, 1, homes)?,
            records: names
                .iter()
                .zip(&mut lists)
                .map(|(what, numbers)| Record { what: *what, numbers })
                .collect(),
            evaluations: vec![0; *worlds],
        };
        let mut from = 0;
        let outcome = gil::steps_told(py, asked.steps as u64, pace, told, |count| {
            run(&mut motion, from, count as usize)?;
            from += count as usize;
            Ok(())
        });
        let evaluations = std::mem::take(&mut motion.evaluations);
        drop(motion);
        let shape = |what: &Sampled| [&[*worlds, *samples], &what.shape(model)[..]].concat();
        let both = names.iter().zip(lists);
        let arrays = both.map(|(what, list)| shaped(py, list, &shape(what)));
        let done = outcome.and_then(|()| Ok((arrays.collect::<PyResult<_>>()?, evaluations)));
        Ok((from, done))
    }

    pub fn steps(&self) -> usize {
        self.asked.steps
    }

    /// Shows numpy the controls of the last of this many steps.
    pub fn write_last(&self, py: Python<'_>, steps: usize, arrays: &Arrays) {
        for world in 0..self.worlds {
            if let Some(row) = self.last_row(world, steps) {
                arrays.write(py, Array::Ctrl, world, row);
            }
        }
    }

    /// A world's controls in the last of this many steps, if it had any.
    fn last_row(&self, world: usize, steps: usize) -> Option<&[f64]> {
        let nu = self.model.actuators.len();
        let row = steps.checked_sub(1)? / self.asked.hold.max(1);
        let own = if self.ctrl.len() == self.rows * nu { 0 } else { world };
        let row = row.min(self.rows.checked_sub(1)?);
        Some(&self.ctrl[(own * self.rows + row) * nu..][..nu])
    }
}

/// Controls for all worlds together, or for each, checked.
fn controls(
    settings: &Settings,
    n: usize,
    nu: usize,
    ctrl: &PyReadonlyArray3<'_, f64>,
) -> PyResult<Vec<f64>> {
    let shape = ctrl.shape();
    if !(shape[0] == n || shape[0] == 1) || shape[2] != nu {
        let text = format!("ctrl has shape {shape:?}: must be [{n}, steps, {nu}]");
        return Err(PyValueError::new_err(text));
    }
    let single = settings.precision == Precision::F32;
    let fine = |x: &f64| x.is_finite() && (!single || (*x as f32).is_finite());
    let in_order = ctrl.as_slice().ok();
    // Without a branch for each, so that the loop vectorises.
    if let Some(list) = in_order.filter(|list| list.iter().fold(true, |all, x| all & fine(x))) {
        return Ok(list.to_vec());
    }
    let mut all = Vec::with_capacity(ctrl.len());
    for ((world, step, k), x) in ctrl.as_array().indexed_iter() {
        if !fine(x) {
            let text =
                format!("ctrl[{world}, {step}, {k}] = {x}: must be finite; nothing was stepped");
            return Err(PyValueError::new_err(text));
        }
        all.push(*x);
    }
    Ok(all)
}

/// Zeros for every world, sample and entry, if they fit in memory.
fn room(n: usize, samples: usize, entries: usize) -> PyResult<Vec<f64>> {
    let mut room = Vec::new();
    let count = n.checked_mul(samples).and_then(|count| count.checked_mul(entries));
    if count.is_none_or(|count| room.try_reserve_exact(count).is_err()) {
        let text = format!("{n} worlds of {samples} samples do not fit into memory");
        return Err(PyValueError::new_err(text));
    }
    room.resize(n * samples * entries, 0.0);
    Ok(room)
}
