//! Linearisations of many worlds at many states, in Python.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use stepcore::arrays::{Array as EngineArray, Givens};
use stepcore::error::Error;
use stepcore::model::Model as EngineModel;
use stepcore::real::AROUND;
use stepcore::settings::{Precision, Settings as EngineSettings};
use stepcore::sim::Sim;
use stepcore::watch::{Around, Asked, Linearizers as Engine, Neighbourhood};

use crate::element::{id, Id};
use crate::errors::Raised;
use crate::gil;
use crate::model::{result, Model};
use crate::settings::Settings;

type Array<'py> = Bound<'py, PyArrayDyn<f64>>;
/// The models around each parameter.
pub type Parameters<'py> = Vec<[PyRef<'py, Model>; AROUND]>;

pub fn neighbourhood(model: &Arc<EngineModel>, parameters: &Parameters) -> Arc<Neighbourhood> {
    let around = |models: &[PyRef<Model>; AROUND]| -> Around {
        models.each_ref().map(|model| model.0.clone())
    };
    let parameters = parameters.iter().map(around).collect();
    Arc::new(Neighbourhood { model: model.clone(), parameters })
}

/// Linearisations of worlds, each with one of some models, which differ in numbers.
#[pyclass(module = "stepcore._core", frozen)]
pub struct Linearizers {
    models: Vec<Arc<EngineModel>>,
    /// For each world: the number of its model.
    of: Vec<usize>,
    first: usize,
    settings: EngineSettings,
    threads: usize,
    /// The last ones.
    kept: Mutex<Option<Engine>>,
    pace: gil::Pace,
}

impl Linearizers {
    fn kept(&self) -> MutexGuard<'_, Option<Engine>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn made(&self, threads: usize) -> Result<Engine, Error> {
        let settings = EngineSettings { precision: Precision::F64, ..self.settings.clone() };
        Engine::new(&Sim::<f64>::new(self.models[0].clone(), settings)?, threads)
    }

    /// The number of given states of the worlds, and all arrays of each.
    fn rows_of(
        &self,
        given: &HashMap<String, PyReadonlyArrayDyn<'_, f64>>,
    ) -> PyResult<(usize, Vec<Vec<f64>>)> {
        let count = given.values().next().map_or(0, |rows| rows.shape()[..2].iter().product());
        let mut lists = Vec::new();
        for array in EngineArray::ALL {
            let own = array.initial(&self.models[0]);
            let Some(rows) = given.get(array.name()) else {
                lists.push(own.repeat(count));
                continue;
            };
            if rows.shape()[0] != self.of.len() || rows.len() != count * own.len() {
                let text = format!("{} of {count} states has {} numbers", array.name(), rows.len());
                return Err(PyValueError::new_err(text));
            }
            lists.push(rows.as_slice()?.to_vec());
        }
        if self.settings.precision == Precision::F32 {
            // As a `Sim` has them.
            lists.iter_mut().flatten().for_each(|x| *x = f64::from(*x as f32));
        }
        Ok((count, lists))
    }
}

#[pymethods]
impl Linearizers {
    /// `models`: the distinct ones. `of`: the number of each world's. `first`: the first world's
    /// number, in errors.
    #[new]
    fn new(
        py: Python<'_>,
        models: Vec<PyRef<'_, Model>>,
        of: Vec<usize>,
        settings: &Settings,
        threads: usize,
        first: usize,
    ) -> PyResult<Self> {
        settings.0.check_fixed("linearize").raised(py)?;
        Ok(Self {
            models: models.iter().map(|model| model.0.clone()).collect(),
            of,
            first,
            settings: settings.0.clone(),
            threads,
            kept: Mutex::new(None),
            pace: gil::Pace::default(),
        })
    }

    /// Return A (as many columns as rows), B (nu columns) and P, side by side, of a step from each
    /// of some states, (worlds, states, rows, columns); the elements at which the nth are
    /// one-sided. `parameters`: for each model, the models around each. `states`: arrays by name,
    /// of shape (worlds, states, …); absent arrays are as at the start.
    fn linearize<'py>(
        &self,
        py: Python<'py>,
        parameters: Vec<Parameters<'py>>,
        states: HashMap<String, PyReadonlyArrayDyn<'py, f64>>,
    ) -> PyResult<(Array<'py>, Vec<(usize, Id)>)> {
        let both = self.models.iter().zip(&parameters);
        let known: Vec<_> = both.map(|(model, own)| neighbourhood(model, own)).collect();
        let worlds: Vec<_> = self.of.iter().map(|model| known[*model].clone()).collect();
        let (count, lists) = self.rows_of(&states)?;
        let each = count / worlds.len();
        let states = Givens::new(count.max(1), |array| &lists[array as usize]);
        let asked = Asked { states, count, worlds: &worlds, first: self.first };
        let threads = self.threads.clamp(1, count.max(1));
        let kept = self.kept().take().filter(|kept| kept.threads() >= threads);
        let (mut linearizers, mut matrices) = gil::release(py, || {
            for nth in 0..count {
                let (given, world) = (asked.states.of(nth), Some(self.first + nth / each));
                match self.settings.precision {
                    Precision::F64 => given.check::<f64>(&self.models[0], world)?,
                    Precision::F32 => given.check::<f32>(&self.models[0], world)?,
                }
            }
            let mut linearizers = kept.map_or_else(|| self.made(threads), Ok)?;
            let matrices = linearizers.begin(&asked)?;
            Ok((linearizers, matrices))
        })?;
        gil::steps_told(py, linearizers.steps(), &self.pace, None, |n| {
            linearizers.advance(n, &asked, &mut matrices)
        })?;
        let degenerate = linearizers.degenerate().map(|(nth, at)| (nth, id(at))).collect();
        let [rows, columns] = linearizers.shape();
        *self.kept() = Some(linearizers);
        Ok((result(py, matrices, &[worlds.len(), each, rows, columns])?, degenerate))
    }

    #[getter]
    fn nbytes(&self) -> usize {
        size_of::<Self>() + self.kept().as_ref().map_or(0, Engine::bytes)
    }
}
