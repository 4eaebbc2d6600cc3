//! `Batch` as Python sees it: many worlds, their arrays, and rollouts.

use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

use numpy::{PyArrayDyn, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use stepcore::batch::Play;
use stepcore::model::Model as EngineModel;
use stepcore::settings::Settings as EngineSettings;

use crate::errors::raise;
use crate::extract::{At, Read};
use crate::gil;
use crate::memory::{Layout, Memory};
use crate::model::{shaped, Model};
use crate::settings::Settings;
use crate::snapshot::{decode, encode, Snapshot};
use crate::world::{world, Placed};
use crate::worlds::{worlds, Worlds};

type Array<'py> = Bound<'py, PyArrayDyn<f64>>;

/// Many worlds of one model.
#[pyclass(module = "stepcore._core", frozen)]
pub struct Batch {
    model: Arc<EngineModel>,
    settings: EngineSettings,
    layout: Layout,
    memory: Py<Memory>,
    worlds: Mutex<Box<dyn Worlds>>,
}

impl Batch {
    fn lock(&self) -> PyResult<MutexGuard<'_, Box<dyn Worlds>>> {
        match self.worlds.try_lock() {
            Ok(worlds) => Ok(worlds),
            Err(TryLockError::Poisoned(worlds)) => Ok(worlds.into_inner()),
            Err(TryLockError::WouldBlock) => {
                Err(PyRuntimeError::new_err("this Batch is busy in another thread"))
            }
        }
    }

    fn numbers<'a>(&'a self, py: Python<'a>) -> &'a [f64] {
        self.memory.get().read(py, 0..self.layout.total())
    }

    /// Checks all arrays, then copies them into the engine.
    fn load(&self, py: Python<'_>, worlds: &mut dyn Worlds) -> PyResult<()> {
        let numbers = self.numbers(py);
        for world in 0..self.layout.worlds {
            let given = self.layout.given(numbers, world);
            worlds.check(world, &given).map_err(|error| raise(py, error))?;
        }
        for world in 0..self.layout.worlds {
            worlds.put(world, &self.layout.given(numbers, world));
        }
        Ok(())
    }

    fn store(&self, py: Python<'_>, worlds: &dyn Worlds) {
        let [nq, nv, ..] = self.layout.lengths;
        let n = self.layout.worlds;
        self.memory.get().edit(py, 0..n * (nq + nv), |numbers| {
            let (qpos, qvel) = numbers.split_at_mut(n * nq);
            for world in 0..n {
                worlds.take(world, &mut qpos[world * nq..][..nq], &mut qvel[world * nv..][..nv]);
            }
        });
    }

    fn view<'py>(&self, py: Python<'py>, array: usize, shape: &[usize]) -> PyResult<Array<'py>> {
        let shape = [&[self.layout.worlds], shape].concat();
        Memory::view(self.memory.bind(py), self.layout.range(array), &shape)
    }

    /// Reads every world's present state in turn.
    fn placed<'py>(&self, py: Python<'py>, what: Placed, shape: &[usize]) -> PyResult<Array<'py>> {
        let guard = self.lock()?;
        let numbers = self.numbers(py).to_vec();
        let mut all = Vec::new();
        let mut reader =
            world(self.model.clone(), &self.settings).map_err(|error| raise(py, error))?;
        for world in 0..self.layout.worlds {
            let given = self.layout.given(&numbers, world);
            guard.check(world, &given).map_err(|error| raise(py, error))?;
            all.extend(reader.placed(&given, what).map_err(|error| raise(py, error))?);
        }
        shaped(py, all, &[&[self.layout.worlds], shape].concat())
    }

    /// The controls of a play, checked.
    fn controls(&self, ctrl: &PyReadonlyArray3<'_, f64>) -> PyResult<Vec<f64>> {
        let (n, nu) = (self.layout.worlds, self.layout.lengths[2]);
        let shape = ctrl.shape();
        if shape[0] != n || shape[2] != nu {
            let text = format!("ctrl has shape {shape:?}: must be [{n}, steps, {nu}]");
            return Err(PyValueError::new_err(text));
        }
        let single = self.settings.precision == stepcore::settings::Precision::F32;
        let mut all = Vec::with_capacity(ctrl.len());
        for ((world, step, k), x) in ctrl.as_array().indexed_iter() {
            if !x.is_finite() || single && !(*x as f32).is_finite() {
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

#[pymethods]
impl Batch {
    #[new]
    fn new(
        py: Python<'_>,
        model: &Model,
        settings: &Settings,
        n: &Bound<'_, PyAny>,
        threads: &Bound<'_, PyAny>,
        lanes: bool,
    ) -> PyResult<Self> {
        let n = usize::read(n, &At::Root.field("n"))?;
        let threads = usize::read(threads, &At::Root.field("threads"))?;
        let (model, settings) = (model.0.clone(), settings.0.clone());
        let worlds = gil::release(py, || worlds(model.clone(), &settings, n, threads, lanes))?;
        let layout = Layout::of(&model, n);
        let memory = Py::new(py, Memory::new(layout.total()))?;
        memory.get().write(py, 0, &model.qpos0.repeat(n));
        Ok(Self { model, settings, layout, memory, worlds: Mutex::new(worlds) })
    }

    #[getter]
    fn qpos<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.view(py, 0, &[self.model.nq])
    }
    #[getter]
    fn qvel<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.view(py, 1, &[self.model.nv])
    }
    #[getter]
    fn ctrl<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.view(py, 2, &[self.model.actuators.len()])
    }
    #[getter]
    fn qfrc_applied<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.view(py, 3, &[self.model.nv])
    }
    #[getter]
    fn xfrc_applied<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.view(py, 4, &[self.model.bodies.len(), 6])
    }

    /// Advances every world by n steps.
    fn step(&self, py: Python<'_>, n: &Bound<'_, PyAny>) -> PyResult<()> {
        let n = u64::read(n, &At::Root.field("n"))?;
        let mut guard = self.lock()?;
        let worlds = &mut **guard;
        self.load(py, worlds)?;
        let outcome = gil::steps(py, n, |n| worlds.step(n));
        self.store(py, worlds);
        outcome
    }

    /// Place, detect and solve at the present states.
    fn forward(&self, py: Python<'_>) -> PyResult<()> {
        let mut guard = self.lock()?;
        let worlds = &mut **guard;
        self.load(py, worlds)?;
        gil::release(py, || worlds.forward())
    }

    /// Steps with controls (n, steps, nu); returns qpos and qvel after every step.
    fn rollout<'py>(
        &self,
        py: Python<'py>,
        ctrl: PyReadonlyArray3<'py, f64>,
    ) -> PyResult<(Array<'py>, Array<'py>)> {
        let mut guard = self.lock()?;
        let worlds = &mut **guard;
        let [nq, nv, nu, ..] = self.layout.lengths;
        let (n, steps) = (self.layout.worlds, ctrl.shape()[1]);
        let controls = self.controls(&ctrl)?;
        let (mut qpos, mut qvel) = (room(n, steps, nq)?, room(n, steps, nv)?);
        self.load(py, worlds)?;
        let mut play = Play { steps, ctrl: &controls, qpos: &mut qpos, qvel: &mut qvel };
        let mut from = 0;
        let outcome = gil::steps(py, steps as u64, |count| {
            worlds.play(&mut play, from, count as usize)?;
            from += count as usize;
            Ok(())
        });
        self.store(py, worlds);
        if from > 0 {
            let start = self.layout.range(2).start;
            for world in 0..n {
                let last = &controls[(world * steps + from - 1) * nu..][..nu];
                self.memory.get().write(py, start + world * nu, last);
            }
        }
        outcome?;
        Ok((shaped(py, qpos, &[n, steps, nq])?, shaped(py, qvel, &[n, steps, nv])?))
    }

    #[getter]
    fn time(&self) -> PyResult<f64> {
        Ok(self.lock()?.time())
    }

    /// Sets the time [s] of all worlds and forgets the impulses of the last step.
    fn restart(&self, time: f64) -> PyResult<()> {
        self.lock()?.restart(time);
        Ok(())
    }

    /// One snapshot a world.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyBytes>>> {
        let memos = self.lock()?.memos();
        let numbers = self.numbers(py);
        let given = |world| self.layout.given(numbers, world);
        let snapshots = memos.iter().enumerate();
        Ok(snapshots
            .map(|(world, memo)| PyBytes::new(py, &encode(self.settings.dt, memo, &given(world))))
            .collect())
    }

    fn restore(&self, py: Python<'_>, states: Vec<Vec<u8>>) -> PyResult<()> {
        let mut worlds = self.lock()?;
        let n = self.layout.worlds;
        if states.len() != n {
            return Err(PyValueError::new_err(format!(
                "this state() has {} worlds, not {n}",
                states.len()
            )));
        }
        let decoded = states.iter().map(|state| decode(state, self.layout.lengths));
        let mut snapshots =
            decoded.collect::<Result<Vec<Snapshot>, String>>().map_err(PyValueError::new_err)?;
        for snapshot in &mut snapshots {
            snapshot.count_in(self.settings.dt);
        }
        let memos: Vec<_> = snapshots.iter().map(|snapshot| snapshot.memo.clone()).collect();
        worlds.set_memos(&memos);
        for (world, snapshot) in snapshots.iter().enumerate() {
            let mut rest = snapshot.numbers.as_slice();
            for (array, length) in self.layout.lengths.into_iter().enumerate() {
                let (head, tail) = rest.split_at(length);
                let start = self.layout.range(array).start + world * length;
                self.memory.get().write(py, start, head);
                rest = tail;
            }
        }
        Ok(())
    }

    #[getter]
    fn qacc<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        shaped(py, self.lock()?.qacc(), &[self.layout.worlds, self.model.nv])
    }
    #[getter]
    fn xpos<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::BodyPos, &[self.model.bodies.len(), 3])
    }
    #[getter]
    fn xquat<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::BodyQuat, &[self.model.bodies.len(), 4])
    }
    #[getter]
    fn site_xpos<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::SitePos, &[self.model.sites.len(), 3])
    }
    #[getter]
    fn geom_xpos<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::GeomPos, &[self.model.geoms.len(), 3])
    }
    /// Kinetic, potential.
    #[getter]
    fn energy<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::Energy, &[2])
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
