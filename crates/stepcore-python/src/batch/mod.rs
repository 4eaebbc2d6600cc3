//! `Batch` in Python: many worlds, their arrays, and their readable quantities.

mod each;

use std::collections::HashMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

use numpy::{PyArrayDyn, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::{PyBaseException, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use stepcore::arrays::{Array as EngineArray, Given};
use stepcore::batch::{of_one_model, Motion};
use stepcore::model::Model as EngineModel;
use stepcore::settings::Settings as EngineSettings;

use crate::arguments::{check_body, check_sensor, check_site, check_time, ray_filter};
use crate::errors::{raise, Slow};
use crate::extract::{At, Read};
use crate::gil;
use crate::memo::{Memo, Solve};
use crate::memory::{Arrays, Named};
use crate::model::{result, Model};
use crate::motion::{Asked, Play, Samples};
use crate::readout::Readout;
use crate::settings::Settings;
use crate::snapshot::{decode, decode_last, encode, encode_last, Clock, Snapshot};
use crate::tables::{contacts, rows, ContactTable, RayTable, RowTable};
use crate::world::{Placed, Solved};
use crate::worlds::{How, Worlds};

type Array<'py> = Bound<'py, PyArrayDyn<f64>>;

/// Many worlds of one model.
#[pyclass(module = "stepcore._core", frozen)]
pub struct Batch {
    model: Arc<EngineModel>,
    settings: EngineSettings,
    arrays: Arrays,
    how: How,
    worlds: Mutex<Box<dyn Worlds>>,
    slow: Slow,
    pace: gil::Pace,
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
        lanes: Option<bool>,
        goes_on: bool,
    ) -> PyResult<Self> {
        let n = usize::read(n, &At::Root.field("n"))?;
        let threads = usize::read(threads, &At::Root.field("threads"))?;
        let (model, settings) = (model.0.clone(), settings.0.clone());
        let unwatched = Arc::default();
        let how = How { settings: settings.clone(), threads, lanes, goes_on, unwatched };
        let worlds =
            gil::release(py, || how.worlds(vec![model.clone()], &of_one_model(&model, n)?))?;
        let arrays = Arrays::new(py, &model, n)?;
        let worlds = Mutex::new(worlds);
        let (slow, pace) = (Slow::under(&settings), gil::Pace::default());
        Ok(Self { model, settings, arrays, how, worlds, slow, pace })
    }

    /// Return the arrays that the user may write, each with its name.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Vec<Named<'py>>> {
        self.arrays.views(py, &[self.arrays.worlds])
    }

    /// Return the quantity of this name; see `Readout::named`.
    fn readout<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Array<'py>> {
        let what = Readout::named(name)?;
        let shape = what.shape(&self.model);
        match what {
            Readout::Placed(what) => self.placed(py, what),
            Readout::Solved(Solved::Acceleration) if self.failed()?.is_empty() => {
                result(py, self.lock()?.qacc(), &[self.arrays.worlds, self.model.nv])
            }
            Readout::Solved(Solved::ActuatorForce) => {
                let kept = self.lock()?.actuator_forces();
                match kept {
                    Some(forces) => result(py, forces, &self.shape(&shape)),
                    None => {
                        self.solved(py, &shape, |world, _| Ok(world.solved(Solved::ActuatorForce)))
                    }
                }
            }
            Readout::Solved(what) => self.solved(py, &shape, |world, _| Ok(world.solved(what))),
            Readout::BodyForce(what) => {
                let all = self.before(py, |world, given| world.body_force(given, what))?;
                result(py, all.concat(), &self.shape(&shape))
            }
        }
    }

    /// Advance every world by n steps; see `gil::steps_told`.
    #[pyo3(signature = (n, told = None))]
    fn step(
        &self,
        py: Python<'_>,
        n: &Bound<'_, PyAny>,
        told: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let n = u64::read(n, &At::Root.field("n"))?;
        let mut guard = self.lock()?;
        let worlds = &mut **guard;
        if n == 0 {
            // The inputs of the last solve stay as they were.
            return self.check(py, worlds);
        }
        self.load(py, worlds)?;
        let mut call = self.slow.begin();
        let outcome = gil::steps_told(py, n, &self.pace, told, |n| {
            let outcome = worlds.step(n);
            call.portion(|| worlds.slow());
            outcome
        });
        self.store(py, worlds);
        call.end(outcome)?;
        self.warn(py, worlds)
    }

    /// Stop checking energies, except in the ledger of the settings, and explaining slow steps.
    fn unwatch(&self) -> PyResult<()> {
        self.slow.keep_quiet();
        self.how.unwatched.store(true, Ordering::Relaxed);
        self.lock()?.unwatch();
        Ok(())
    }

    /// Place, detect and solve at the present states.
    fn forward(&self, py: Python<'_>) -> PyResult<()> {
        let mut guard = self.lock()?;
        let worlds = &mut **guard;
        self.load(py, worlds)?;
        gil::release(py, || worlds.forward())
    }

    /// Put qpos and qvel where a step from here evaluates its forces last.
    fn go_to_last_stage(&self, py: Python<'_>) -> PyResult<()> {
        let mut guard = self.lock()?;
        let worlds = &mut **guard;
        self.load(py, worlds)?;
        let outcome = gil::release(py, || worlds.go_to_last_stage());
        self.store(py, worlds);
        outcome
    }

    /// Step with controls (n, steps, nu); return qpos, qvel and act after every step.
    #[pyo3(signature = (ctrl, told = None))]
    fn rollout<'py>(
        &self,
        py: Python<'py>,
        ctrl: PyReadonlyArray3<'py, f64>,
        told: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Vec<Array<'py>>> {
        let nu = self.model.actuators.len();
        let shape = ctrl.shape();
        if shape[0] != self.arrays.worlds || shape[2] != nu {
            let n = self.arrays.worlds;
            let text = format!("ctrl has shape {shape:?}: must be [{n}, steps, {nu}]");
            return Err(PyValueError::new_err(text));
        }
        let names = ["qpos", "qvel", "act", "ctrl_history"].map(String::from).to_vec();
        let asked = Asked::every_step(names, shape[1]);
        Ok(self.follow(py, asked, Some(ctrl), told)?.0)
    }

    /// Step under controls, (n or 1, rows, nu); return the requested samples.
    #[pyo3(signature = (asked, ctrl = None, told = None))]
    fn follow<'py>(
        &self,
        py: Python<'py>,
        asked: Asked,
        ctrl: Option<PyReadonlyArray3<'py, f64>>,
        told: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Samples<'py>> {
        let mut guard = self.lock()?;
        let worlds = &mut **guard;
        let play = Play::new(
            self.model.clone(),
            &self.settings,
            self.arrays.worlds,
            asked,
            ctrl.as_ref(),
        )?;
        if play.steps() == 0 {
            self.check(py, worlds)?;
        } else {
            self.load(py, worlds)?;
        }
        let mut call = self.slow.begin();
        let run = |motion: &mut Motion, from, n| {
            let outcome = worlds.follow(motion, from, n);
            call.portion(|| worlds.slow());
            outcome
        };
        let (done, samples) = play.run(py, &self.pace, told, run)?;
        if done > 0 {
            self.store(py, worlds);
            play.write_last(py, done, &self.arrays);
        }
        call.end(Ok(()))?;
        let samples = samples?;
        self.warn(py, worlds)?;
        Ok(samples)
    }

    /// Return the errors of worlds that failed while the others continued; `known` are left out.
    fn failures<'py>(
        &self,
        py: Python<'py>,
        known: Vec<usize>,
    ) -> PyResult<(Vec<usize>, Vec<Bound<'py, PyBaseException>>)> {
        let failed = self.failed()?;
        let guard = self.lock()?;
        let new = failed.iter().filter(|world| !known.contains(world));
        let errors = new.filter_map(|world| guard.failed(*world));
        let errors = errors.map(|error| raise(py, error.clone()).into_value(py).into_bound(py));
        let errors = errors.collect();
        Ok((failed, errors))
    }

    /// Return the memory of all worlds here, with the user's arrays.
    #[getter]
    fn nbytes(&self) -> PyResult<usize> {
        Ok(self.lock()?.bytes() + self.arrays.bytes())
    }

    #[getter]
    fn time(&self) -> PyResult<f64> {
        Ok(self.lock()?.time())
    }

    /// Set the time [s] from which the steps of all worlds are counted.
    #[setter]
    fn set_time(&self, time: &Bound<'_, PyAny>) -> PyResult<()> {
        let start = f64::read(time, &At::Root.field("time"))?;
        check_time(start)?;
        let mut worlds = self.lock()?;
        let memos = worlds.memos().into_iter().map(|memo| Memo { start, steps: 0, ..memo });
        let memos: Vec<Memo> = memos.collect();
        worlds.set_memos(&memos);
        Ok(())
    }

    /// Give the worlds models that differ from this one's in numbers only: `model_of` has the index
    /// of each world's. States, time and impulses stay; nothing was solved yet.
    fn set_models(
        &self,
        py: Python<'_>,
        models: Vec<PyRef<'_, Model>>,
        model_of: Vec<usize>,
    ) -> PyResult<()> {
        let models: Vec<_> = models.iter().map(|model| model.0.clone()).collect();
        if model_of.len() != self.arrays.worlds || model_of.iter().any(|k| *k >= models.len()) {
            let text = "model_of: must be the index of a model for every world";
            return Err(PyValueError::new_err(text));
        }
        for (index, model) in models.iter().enumerate() {
            if EngineArray::counts(model) != self.arrays.lengths {
                let world = model_of.iter().position(|k| *k == index).unwrap_or(0);
                let text =
                    format!("world {world}: its model has other joints, bodies or actuators");
                return Err(PyValueError::new_err(text));
            }
        }
        let mut guard = self.lock()?;
        let worlds = &mut *guard;
        gil::release(py, || {
            if !worlds.set_models(&self.how, &models, &model_of) {
                let (memos, failures) = (worlds.memos(), worlds.failures());
                *worlds = self.how.worlds(models, &model_of)?;
                worlds.set_memos(&memos);
                worlds.set_failures(failures);
            }
            worlds.unsolved();
            Ok(())
        })
    }

    /// Return whether the worlds are stepped in lanes now.
    #[getter]
    fn in_lanes(&self) -> PyResult<bool> {
        Ok(self.lock()?.in_lanes())
    }

    /// For tests: with lanes "auto", every step goes the other way than the one before.
    fn turn_at_every_step(&self) -> PyResult<()> {
        self.lock()?.turn_at_every_step();
        Ok(())
    }

    /// Forget the impulses, the failures and the last solves of some worlds.
    fn forget(&self, worlds: Vec<usize>) -> PyResult<()> {
        if let Some(world) = worlds.iter().find(|world| **world >= self.arrays.worlds) {
            let text = format!("worlds: {world} must be below {}", self.arrays.worlds);
            return Err(PyValueError::new_err(text));
        }
        self.lock()?.forget(&worlds);
        Ok(())
    }

    /// Set the time [s] of all worlds and forget the impulses of the last step.
    fn restart(&self, time: f64) -> PyResult<()> {
        let mut worlds = self.lock()?;
        worlds.restart(time);
        worlds.unsolved();
        Ok(())
    }

    /// Return a snapshot for each world; own: those with a time of start + steps · dt.
    fn state<'py>(
        &self,
        py: Python<'py>,
        own: HashMap<usize, (f64, u64)>,
    ) -> PyResult<Vec<Bound<'py, PyBytes>>> {
        let memos = self.lock()?.memos();
        let dt = self.settings.dt;
        let snapshot = |(world, mut memo): (usize, Memo)| {
            let shared = Some(memo.clock());
            if let Some((start, steps)) = own.get(&world).copied() {
                memo.set_clock(Clock { start, steps });
            }
            let bytes = |given: &Given| encode(dt, &memo, shared, given);
            PyBytes::new(py, &self.arrays.read(py, world, bytes))
        };
        Ok(memos.into_iter().enumerate().map(snapshot).collect())
    }

    /// Return the start of each world's last solve and its result.
    fn last<'py>(&self, py: Python<'py>) -> PyResult<Vec<Option<Bound<'py, PyBytes>>>> {
        let worlds = self.lock()?;
        let last = |last: Solve| PyBytes::new(py, &encode_last(self.settings.dt, &last));
        Ok((0..self.arrays.worlds).map(|world| worlds.last_of(world).map(last)).collect())
    }

    /// Restore states; lasts: the results of `last` at them. Return the worlds that count their own
    /// time, as `state` takes them.
    fn restore(
        &self,
        py: Python<'_>,
        states: Vec<Vec<u8>>,
        lasts: Vec<Option<Vec<u8>>>,
    ) -> PyResult<HashMap<usize, (f64, u64)>> {
        let mut worlds = self.lock()?;
        let n = self.arrays.worlds;
        if states.len() != n {
            return Err(PyValueError::new_err(format!(
                "this state() has {} worlds, not {n}",
                states.len()
            )));
        }
        let decoded = states.iter().map(|state| decode(state, self.arrays.lengths));
        let mut snapshots =
            decoded.collect::<Result<Vec<Snapshot>, String>>().map_err(PyValueError::new_err)?;
        let last = |last: &Option<Vec<u8>>| {
            last.as_ref().map(|last| decode_last(last, self.arrays.lengths)).transpose()
        };
        let mut lasts = lasts
            .iter()
            .map(last)
            .collect::<Result<Vec<_>, String>>()
            .map_err(PyValueError::new_err)?;
        lasts.resize(n, None);
        snapshots.iter_mut().for_each(|snapshot| snapshot.count_in(self.settings.dt));
        let shared = snapshots[0].shared;
        let clocks = snapshots.iter().map(|snapshot| snapshot.memo.clock()).enumerate();
        let own = clocks.filter(|(_, own)| *own != shared);
        let own = own.map(|(world, own)| (world, (own.start, own.steps))).collect();
        snapshots.iter_mut().for_each(|snapshot| snapshot.memo.set_clock(shared));
        let memos: Vec<_> = snapshots.iter().map(|snapshot| snapshot.memo.clone()).collect();
        worlds.set_memos(&memos);
        worlds.set_lasts(&lasts);
        for (world, snapshot) in snapshots.iter().enumerate() {
            self.arrays.restore(py, world, &snapshot.numbers);
        }
        Ok(own)
    }

    fn jacobian<'py>(&self, py: Python<'py>, body: usize) -> PyResult<Array<'py>> {
        check_body(&self.model, body)?;
        self.placed(py, Placed::Jacobian(body))
    }
    fn site_jacobian<'py>(&self, py: Python<'py>, site: usize) -> PyResult<Array<'py>> {
        check_site(&self.model, site)?;
        self.placed(py, Placed::SiteJacobian(site))
    }
    fn point_jacobian<'py>(
        &self,
        py: Python<'py>,
        body: usize,
        point: [f64; 3],
    ) -> PyResult<Array<'py>> {
        check_body(&self.model, body)?;
        self.placed(py, Placed::PointJacobian(body, point))
    }

    /// Return a sensor's values, or all sensors'.
    #[pyo3(signature = (sensor = None))]
    fn sensordata<'py>(&self, py: Python<'py>, sensor: Option<usize>) -> PyResult<Array<'py>> {
        check_sensor(&self.model, sensor)?;
        let all = self.before(py, |world, given| world.sensordata(given, sensor))?;
        let shape = [self.arrays.worlds, all.first().map_or(0, Vec::len)];
        result(py, all.concat(), &shape)
    }
    /// Return the forces that give accelerations (n, nv), by default the last solves'.
    #[pyo3(signature = (qacc = None))]
    fn inverse<'py>(&self, py: Python<'py>, qacc: Option<Vec<f64>>) -> PyResult<Array<'py>> {
        let nv = self.model.nv;
        let qacc = match qacc {
            Some(qacc) => qacc,
            None => self.lock()?.qacc(),
        };
        let all = self.present(py, |reader, world, given| {
            reader.inverse(given, Some(&qacc[world * nv..][..nv]))
        })?;
        result(py, all.concat(), &[self.arrays.worlds, nv])
    }
    /// Return distances, geoms and normals of equally many rays (n, rays, 6) in each world.
    #[pyo3(signature = (rays, excluded = None, groups = None, moving = false))]
    fn rays<'py>(
        &self,
        py: Python<'py>,
        rays: Vec<f64>,
        excluded: Option<usize>,
        groups: Option<[bool; 6]>,
        moving: bool,
    ) -> PyResult<RayTable<'py>> {
        let filter = ray_filter(excluded, groups, moving);
        let each = rays.len() / self.arrays.worlds;
        let (mut dist, mut geom, mut normal) = (Vec::new(), Vec::new(), Vec::new());
        let all = self.present(py, |reader, world, given| {
            reader.rays(given, &rays[world * each..][..each], &filter)
        })?;
        for found in all {
            dist.extend(found.dist);
            geom.extend(found.geom);
            normal.extend(found.normal);
        }
        let count = dist.len();
        Ok((result(py, dist, &[count])?, geom, result(py, normal, &[count, 3])?))
    }
    /// Return one table of `Sim.contacts` for each world.
    fn contacts<'py>(&self, py: Python<'py>) -> PyResult<Vec<ContactTable<'py>>> {
        let tables = self.again(py, |world, _| Ok(world.contacts()))?;
        tables.into_iter().map(|table| contacts(py, table)).collect()
    }
    /// Return one table of `Sim.rows` for each world.
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<Vec<RowTable<'py>>> {
        let tables = self.again(py, |world, _| Ok(world.rows()))?;
        tables.into_iter().map(|table| rows(py, table)).collect()
    }
    /// Return `Sim.asleep` of each world.
    #[getter]
    fn asleep(&self) -> PyResult<Vec<Vec<bool>>> {
        let memos = self.lock()?.memos();
        Ok(memos.iter().map(|memo| memo.sleep.bodies(&self.model)).collect())
    }
    #[getter]
    fn residual<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        let all = self.again(py, |world, _| Ok(world.residual()))?;
        result(py, all, &[self.arrays.worlds])
    }
    #[getter]
    fn unrecovered<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        let all = self.again(py, |world, _| Ok(world.unrecovered()))?;
        result(py, all, &[self.arrays.worlds])
    }
}
