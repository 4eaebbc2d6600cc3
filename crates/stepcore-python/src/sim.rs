//! `Sim` in Python: one world, its arrays, and its readable quantities.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};

use numpy::{PyArrayDyn, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use stepcore::batch::Motion;
use stepcore::elements::Element;
use stepcore::model::Model as EngineModel;
use stepcore::real::Stage;

use crate::arguments::{check_body, check_sensor, check_site, check_time, ray_filter};
use crate::element::{id, Id};
use crate::errors::{warn, EnergyWarning, Raised, Slow};
use crate::extract::{At, Read};
use crate::gil;
use crate::linearizers::{neighbourhood, Parameters};
use crate::memo::Memo;
use crate::memory::{Arrays, Named};
use crate::model::{result, shaped, Model};
use crate::motion::{Asked, Play, Samples};
use crate::readings::TendonPath;
use crate::readout::Readout;
use crate::settings::Settings;
use crate::snapshot::{decode, decode_last, encode, encode_last};
use crate::tables::{contacts, rows, ContactTable, RayTable, RowTable};
use crate::world::{world, Placed, World};

type Array<'py> = Bound<'py, PyArrayDyn<f64>>;
/// Energy before and after, and gains by element.
type TapedStep = (f64, f64, Vec<(Id, f64)>);
/// A rejected length [s], and the body whose error was too large.
type Refused = (f64, Option<usize>);
/// Elements, forces (n, nv), energies (n,), entries of slopes (m, 5).
type SlopesTable<'py> = (Vec<Id>, Array<'py>, Vec<f64>, Array<'py>);

/// One world.
#[pyclass(module = "stepcore._core", frozen)]
pub struct Sim {
    model: Arc<EngineModel>,
    arrays: Arrays,
    world: Mutex<Box<dyn World>>,
    singles: gil::Singles,
    slow: Slow,
    /// The pace of linearisations and motions.
    pace: gil::Pace,
}

impl Sim {
    fn lock(&self) -> PyResult<MutexGuard<'_, Box<dyn World>>> {
        gil::lock(&self.world, "Sim")
    }

    /// Check the arrays and copy them into the engine, which is about to solve.
    fn load(&self, py: Python<'_>, world: &mut dyn World) -> PyResult<()> {
        self.arrays.load(py, |given, some| world.load(given, some)).raised(py)
    }

    /// The same before an operation other than a solve.
    fn load_beside(&self, py: Python<'_>, world: &mut dyn World) -> PyResult<()> {
        world.keep_solve();
        self.load(py, world)
    }

    fn store(&self, py: Python<'_>, world: &mut dyn World) {
        self.arrays.store(py, move |array, out| world.take(array, out));
    }

    fn placed<'py>(&self, py: Python<'py>, what: Placed) -> PyResult<Array<'py>> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        let numbers = self.arrays.read(py, 0, |given| world.placed(given, what)).raised(py)?;
        result(py, numbers, &what.shape(&self.model))
    }
}

#[pymethods]
impl Sim {
    #[new]
    #[pyo3(signature = (model, settings, threads = None))]
    fn new(
        py: Python<'_>,
        model: &Model,
        settings: &Settings,
        threads: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let read = |threads| usize::read(threads, &At::Root.field("threads"));
        let threads = threads.map_or(Ok(1), read)?;
        let model = model.0.clone();
        let world = gil::release(py, || {
            let mut world = world(model.clone(), &settings.0)?;
            world.use_threads(threads)?;
            Ok(world)
        })?;
        let arrays = Arrays::new(py, &model, 1)?;
        Ok(Self {
            model,
            arrays,
            world: Mutex::new(world),
            singles: gil::Singles::default(),
            slow: Slow::under(&settings.0),
            pace: gil::Pace::default(),
        })
    }

    /// Return the arrays that the user may write, each with its name.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Vec<Named<'py>>> {
        self.arrays.views(py, &[])
    }

    /// Return the quantity of this name; see `Readout::named`.
    fn readout<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Array<'py>> {
        let what = Readout::named(name)?;
        let mut guard = self.lock()?;
        let world = &mut **guard;
        let numbers = match what {
            Readout::Placed(what) => {
                self.arrays.read(py, 0, |given| world.placed(given, what)).raised(py)?
            }
            Readout::Solved(what) => world.solved(what),
            Readout::BodyForce(what) => {
                self.arrays.read(py, 0, |given| world.body_force(given, what)).raised(py)?
            }
        };
        result(py, numbers, &what.shape(&self.model))
    }

    /// Advance by n steps.
    fn step(&self, py: Python<'_>, n: &Bound<'_, PyAny>) -> PyResult<()> {
        let n = u64::read(n, &At::Root.field("n"))?;
        let mut guard = self.lock()?;
        let world = &mut **guard;
        if n == 0 {
            return self.load_beside(py, world);
        }
        self.load(py, world)?;
        let mut call = self.slow.begin();
        let mut step = |n| {
            let outcome = world.step(n);
            call.portion(|| world.slow());
            outcome
        };
        let mut outcome = match n {
            1 => self.singles.step(py, || step(1)),
            _ => gil::steps(py, n, step),
        };
        outcome = call.end(outcome);
        if n > 1 && outcome.is_ok() {
            // Not in each portion: how many there are depends on the machine.
            outcome = gil::release(py, || world.balance_at_end(n));
        }
        self.store(py, world);
        outcome?;
        world.take_warning().map_or(Ok(()), |text| warn::<EnergyWarning>(py, &text))
    }

    /// Step under controls, (1, rows, nu); return the requested samples.
    #[pyo3(signature = (asked, ctrl = None))]
    fn follow<'py>(
        &self,
        py: Python<'py>,
        asked: Asked,
        ctrl: Option<PyReadonlyArray3<'py, f64>>,
    ) -> PyResult<Samples<'py>> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        let play = Play::new(self.model.clone(), world.settings(), 1, asked, ctrl.as_ref())?;
        if play.steps() == 0 {
            self.load_beside(py, world)?;
        } else {
            self.load(py, world)?;
        }
        let mut call = self.slow.begin();
        let run = |motion: &mut Motion, from, n| {
            let outcome = world.follow(motion, from, n);
            call.portion(|| world.slow());
            outcome
        };
        let (done, samples) = play.run(py, &self.pace, None, run)?;
        self.store(py, world);
        play.write_last(py, done, &self.arrays);
        call.end(Ok(()))?;
        let samples = samples?;
        world.take_warning().map_or(Ok(()), |text| warn::<EnergyWarning>(py, &text))?;
        Ok(samples)
    }

    /// Stop checking energies, except in the ledger of the settings, and explaining slow steps.
    fn unwatch(&self) -> PyResult<()> {
        self.slow.keep_quiet();
        self.lock()?.unwatch();
        Ok(())
    }

    /// Balance the ledger at the present state.
    fn balance(&self, py: Python<'_>) -> PyResult<()> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        self.load_beside(py, world)?;
        let outcome = gil::release(py, || world.balance_at_end(u64::MAX));
        self.store(py, world);
        outcome?;
        world.take_warning().map_or(Ok(()), |text| warn::<EnergyWarning>(py, &text))
    }

    /// Step once; return the kinetic and spring energy before and after, and the energy that each
    /// element injected.
    fn taped_step(&self, py: Python<'_>) -> PyResult<TapedStep> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        self.load(py, world)?;
        let outcome = gil::release(py, || world.taped_step());
        self.store(py, world);
        let gains = |gains: BTreeMap<Element, f64>| {
            gains.into_iter().map(|(element, gain)| (id(element), gain)).collect()
        };
        outcome.map(|entry| (entry.before, entry.after, gains(entry.gains)))
    }

    /// Place, detect and solve at the present state.
    fn forward(&self, py: Python<'_>) -> PyResult<()> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        self.load(py, world)?;
        gil::release(py, || world.forward())
    }

    /// Put qpos and qvel where a step from here evaluates its forces last.
    fn go_to_last_stage(&self, py: Python<'_>) -> PyResult<()> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        self.load(py, world)?;
        let outcome = gil::release(py, || world.go_to_last_stage());
        self.store(py, world);
        outcome
    }

    #[getter]
    fn time(&self) -> PyResult<f64> {
        Ok(self.lock()?.time())
    }

    /// Set the time [s] from which steps are counted.
    #[setter]
    fn set_time(&self, time: &Bound<'_, PyAny>) -> PyResult<()> {
        let start = f64::read(time, &At::Root.field("time"))?;
        check_time(start)?;
        let mut world = self.lock()?;
        let memo = Memo { start, steps: 0, ..world.memo() };
        world.set_memo(&memo);
        Ok(())
    }

    /// Forget the impulses of the last step, and reset sleep to its initial state.
    fn forget(&self) -> PyResult<()> {
        let mut world = self.lock()?;
        let memo = Memo { warm: Vec::new(), sleep: world.initial_sleep(), ..world.memo() };
        world.set_memo(&memo);
        world.unsolved();
        Ok(())
    }

    /// Return A (as many columns as rows), B (nu columns) and P, side by side, of a step from the
    /// present state; the elements where they are one-sided. `parameters`: the models around each.
    fn linearize<'py>(
        &self,
        py: Python<'py>,
        parameters: Parameters<'py>,
    ) -> PyResult<(Array<'py>, Vec<Id>)> {
        let of = neighbourhood(&self.model, &parameters);
        let mut linearizer = {
            let mut guard = self.lock()?;
            let world = &mut **guard;
            self.load_beside(py, world)?;
            gil::release(py, || world.linearizer(&of))?
        };
        let mut matrix = gil::release(py, || linearizer.matrices(1))?;
        gil::steps_told(py, linearizer.steps(), &self.pace, None, |n| {
            linearizer.advance(n, None, &mut matrix)
        })?;
        let degenerate = linearizer.degenerate.iter().map(|(_, at)| id(*at)).collect();
        let shape = [linearizer.rows(), linearizer.width()];
        // Another thread that now works with the world makes a new one.
        if let Ok(mut world) = self.lock() {
            world.keep(linearizer);
        }
        Ok((result(py, matrix, &shape)?, degenerate))
    }

    /// For every element that acts at the present state, return its force by dof, its stored energy
    /// [J], and its slopes, in the columns (nth element, dof, dof, stiffness, damping).
    fn element_slopes<'py>(&self, py: Python<'py>) -> PyResult<SlopesTable<'py>> {
        let mut slopes = {
            let mut guard = self.lock()?;
            let world = &mut **guard;
            self.load_beside(py, world)?;
            gil::release(py, || world.element_slopes())?
        };
        gil::steps(py, slopes.steps(), |n| slopes.advance(n))?;
        let acting = gil::release(py, || slopes.finish())?;
        let (nv, count) = (self.model.nv, acting.len());
        let (mut force, mut entries) = (vec![0.0; count * nv], Vec::new());
        for (nth, acts) in acting.values().enumerate() {
            acts.force.iter().for_each(|(dof, pushed)| force[nth * nv + dof] = *pushed);
            for ((i, j), [stiffness, damping]) in &acts.slopes {
                entries.extend([nth as f64, *i as f64, *j as f64, *stiffness, *damping]);
            }
        }
        let rows = entries.len() / 5;
        Ok((
            acting.keys().copied().map(id).collect(),
            shaped(py, force, &[count, nv])?,
            acting.values().map(|acts| acts.energy).collect(),
            shaped(py, entries, &[rows, 5])?,
        ))
    }

    /// Count the floating-point operations of the next n steps, by stage.
    fn count(&self, py: Python<'_>, n: &Bound<'_, PyAny>) -> PyResult<Vec<(&'static str, u64)>> {
        let n = u64::read(n, &At::Root.field("n"))?;
        let mut counter = {
            let mut guard = self.lock()?;
            let world = &mut **guard;
            self.load_beside(py, world)?;
            gil::release(py, || world.counter())?
        };
        gil::steps(py, n, |n| counter.advance(n))?;
        Ok(Stage::ALL.iter().map(|stage| stage.name()).zip(counter.counts).collect())
    }

    /// Return the memory of state and working space in the engine.
    #[getter]
    fn nbytes(&self) -> PyResult<usize> {
        Ok(self.lock()?.bytes())
    }

    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let (dt, memo) = {
            let world = self.lock()?;
            (world.dt(), world.memo())
        };
        Ok(PyBytes::new(py, &self.arrays.read(py, 0, |given| encode(dt, &memo, None, given))))
    }

    /// Return the start of the last solve and its result.
    fn last<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyBytes>>> {
        let world = self.lock()?;
        Ok(world.last().map(|last| PyBytes::new(py, &encode_last(world.dt(), &last))))
    }

    /// Restore a state; last: the result of `last` at that state.
    fn restore(&self, py: Python<'_>, state: &[u8], last: Option<&[u8]>) -> PyResult<()> {
        let mut world = self.lock()?;
        let last = last.map(|last| decode_last(last, self.arrays.lengths)).transpose();
        let last = last.map_err(PyValueError::new_err)?;
        let mut snapshot = decode(state, self.arrays.lengths).map_err(PyValueError::new_err)?;
        snapshot.count_in(world.dt());
        world.set_memo(&snapshot.memo);
        world.set_last(last.as_ref());
        self.arrays.restore(py, 0, &snapshot.numbers);
        Ok(())
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
        let mut guard = self.lock()?;
        let world = &mut **guard;
        let numbers =
            self.arrays.read(py, 0, |given| world.sensordata(given, sensor)).raised(py)?;
        let count = numbers.len();
        result(py, numbers, &[count])
    }
    /// Return the forces that give an acceleration (nv,), by default the last solve's.
    #[pyo3(signature = (qacc = None))]
    fn inverse<'py>(&self, py: Python<'py>, qacc: Option<Vec<f64>>) -> PyResult<Array<'py>> {
        let mut guard = self.lock()?;
        let (world, qacc) = (&mut **guard, qacc.as_deref());
        let forces = self.arrays.read(py, 0, |given| world.inverse(given, qacc)).raised(py)?;
        result(py, forces, &[self.model.nv])
    }
    /// Return distances, geoms and normals of rays (n, 6) at the present state.
    #[pyo3(signature = (rays, excluded = None, groups = None, moving = false))]
    fn rays<'py>(
        &self,
        py: Python<'py>,
        rays: Vec<f64>,
        excluded: Option<usize>,
        groups: Option<[bool; 6]>,
        moving: bool,
    ) -> PyResult<RayTable<'py>> {
        let mut guard = self.lock()?;
        let (world, filter) = (&mut **guard, ray_filter(excluded, groups, moving));
        let found =
            self.arrays.read(py, 0, |given| world.rays(given, &rays, &filter)).raised(py)?;
        let count = found.dist.len();
        Ok((result(py, found.dist, &[count])?, found.geom, result(py, found.normal, &[count, 3])?))
    }
    /// Return the paths of all tendons, by stretch: points (n, 3), flat.
    fn tendon_paths(&self, py: Python<'_>) -> PyResult<Vec<TendonPath>> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        self.arrays.read(py, 0, |given| world.tendon_paths(given)).raised(py)
    }
    /// Return the elements that push, and the generalised force of each.
    fn element_forces<'py>(&self, py: Python<'py>) -> PyResult<(Vec<Id>, Array<'py>)> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        let forces = self.arrays.read(py, 0, |given| world.element_forces(given)).raised(py)?;
        let shape = [forces.len(), self.model.nv];
        let elements = forces.keys().map(|element| id(*element)).collect();
        Ok((elements, shaped(py, forces.into_values().flatten().collect(), &shape)?))
    }
    /// Return elements, geoms, and dist, pos, normal, force in the columns of one array.
    fn contacts<'py>(&self, py: Python<'py>) -> PyResult<ContactTable<'py>> {
        contacts(py, self.lock()?.contacts())
    }
    /// Elements, names, blocks, and impulse, velocity, target, regulariser, residual, lo, hi.
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<RowTable<'py>> {
        rows(py, self.lock()?.rows())
    }
    /// J H⁻¹ Jᵀ of the rows, and by row: 1/s, mass, friction, kind of set, unit of its impulse.
    fn coupling<'py>(&self, py: Python<'py>) -> PyResult<(Array<'py>, Array<'py>)> {
        let found = self.lock()?.coupling();
        let count = found.rows.len();
        let own = result(py, found.rows.concat(), &[count, 5])?;
        Ok((result(py, found.a, &[count, count])?, own))
    }
    #[getter]
    fn residual(&self) -> PyResult<f64> {
        Ok(self.lock()?.residual())
    }
    #[getter]
    fn unrecovered(&self) -> PyResult<f64> {
        Ok(self.lock()?.unrecovered())
    }
    #[getter]
    fn sweeps_done(&self) -> PyResult<u32> {
        Ok(self.lock()?.effort().sweeps)
    }
    /// One entry for each body.
    #[getter]
    fn asleep(&self) -> PyResult<Vec<bool>> {
        Ok(self.lock()?.asleep())
    }
    #[getter]
    fn row_updates(&self) -> PyResult<u64> {
        Ok(self.lock()?.effort().row_updates)
    }
    #[getter]
    fn evaluations(&self) -> PyResult<u64> {
        Ok(self.lock()?.effort().evaluations)
    }
    /// Return, for the last adaptive step: the shortest accepted part [s]; the shortest rejected
    /// one [s], with the body whose error was too large.
    #[getter]
    fn stretches(&self) -> PyResult<(f64, Option<Refused>)> {
        let stretches = self.lock()?.effort().stretches;
        Ok((stretches.shortest, stretches.refused))
    }
    #[getter]
    fn most_rows(&self) -> PyResult<usize> {
        Ok(self.lock()?.effort().most_rows)
    }
    #[getter]
    fn decrement(&self) -> PyResult<f64> {
        Ok(self.lock()?.effort().decrement)
    }
    /// Return how many times the list of contacts had to grow.
    #[getter]
    fn contacts_grown(&self) -> PyResult<u64> {
        Ok(self.lock()?.grown())
    }
}
