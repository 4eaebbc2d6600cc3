//! Rollouts: controls in, the states after every step out.

use numpy::{PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use stepcore::arrays;
use stepcore::batch::Rollout;

use super::{Array, Batch};
use crate::gil;
use crate::model::shaped;
use crate::worlds::Worlds;

impl Batch {
    /// Steps with controls (n, steps, nu); returns qpos, qvel and act after every step.
    pub(super) fn roll_out<'py>(
        &self,
        py: Python<'py>,
        ctrl: &PyReadonlyArray3<'py, f64>,
        told: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Vec<Array<'py>>> {
        let mut guard = self.lock()?;
        let worlds = &mut **guard;
        let lengths = self.arrays.lengths;
        let (n, steps) = (self.arrays.worlds, ctrl.shape()[1]);
        let controls = self.controls(ctrl)?;
        let mut states: [Vec<f64>; arrays::Array::CHANGED] = Default::default();
        for (list, entries) in states.iter_mut().zip(lengths) {
            *list = room(n, steps, entries)?;
        }
        if steps == 0 {
            self.check(py, worlds)?;
        } else {
            self.load(py, worlds)?;
            self.played(py, worlds, &controls, steps, &mut states, told)?;
        }
        let states = states.into_iter().zip(lengths);
        states.map(|(list, entries)| shaped(py, list, &[n, steps, entries])).collect()
    }

    /// Steps the worlds, whose arrays are loaded, and stores what came of it.
    fn played(
        &self,
        py: Python<'_>,
        worlds: &mut dyn Worlds,
        controls: &[f64],
        steps: usize,
        states: &mut [Vec<f64>; arrays::Array::CHANGED],
        told: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let nu = self.arrays.lengths[arrays::Array::Ctrl as usize];
        let states = states.each_mut().map(|list| &mut list[..]);
        let mut rollout = Rollout { steps, ctrl: controls, states };
        let mut from = 0;
        let outcome = gil::steps_told(py, steps as u64, &self.pace, told, |count| {
            worlds.roll_out(&mut rollout, from, count as usize)?;
            from += count as usize;
            Ok(())
        });
        self.store(py, worlds);
        if from > 0 {
            for world in 0..self.arrays.worlds {
                let last = &controls[(world * steps + from - 1) * nu..][..nu];
                self.arrays.write(py, arrays::Array::Ctrl, world, last);
            }
        }
        outcome?;
        self.warn(py, worlds)
    }

    /// The controls of a rollout, checked.
    fn controls(&self, ctrl: &PyReadonlyArray3<'_, f64>) -> PyResult<Vec<f64>> {
        let (n, nu) = (self.arrays.worlds, self.arrays.lengths[arrays::Array::Ctrl as usize]);
        let shape = ctrl.shape();
        if shape[0] != n || shape[2] != nu {
            let text = format!("ctrl has shape {shape:?}: must be [{n}, steps, {nu}]");
            return Err(PyValueError::new_err(text));
        }
        let single = self.settings.precision == stepcore::settings::Precision::F32;
        let fine = |x: &f64| x.is_finite() && (!single || (*x as f32).is_finite());
        let in_order = ctrl.as_slice().ok();
        // Without a branch for each, so that vectors serve.
        if let Some(list) = in_order.filter(|list| list.iter().fold(true, |all, x| all & fine(x))) {
            return Ok(list.to_vec());
        }
        let mut all = Vec::with_capacity(ctrl.len());
        for ((world, step, k), x) in ctrl.as_array().indexed_iter() {
            if !fine(x) {
                let text = format!(
                    "ctrl[{world}, {step}, {k}] = {x}: must be finite; nothing was stepped"
                );
                return Err(PyValueError::new_err(text));
            }
            all.push(*x);
        }
        Ok(all)
    }
}

/// Zeros for every world, step and entry, if the memory can hold them.
fn room(n: usize, steps: usize, entries: usize) -> PyResult<Vec<f64>> {
    let mut room = Vec::new();
    let count = n.checked_mul(steps).and_then(|count| count.checked_mul(entries));
    if count.is_none_or(|count| room.try_reserve_exact(count).is_err()) {
        let text = format!("{n} worlds of {steps} steps: their states do not fit into memory");
        return Err(PyValueError::new_err(text));
    }
    room.resize(n * steps * entries, 0.0);
    Ok(room)
}
