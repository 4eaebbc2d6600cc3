//! `Sim` as Python sees it: one world, its arrays, and what can be read of it.

use std::collections::BTreeMap;
use std::ffi::CString;
use std::sync::{Arc, Mutex, MutexGuard};

use numpy::PyArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use stepcore::arrays;
use stepcore::elements::Element;
use stepcore::model::Model as EngineModel;
use stepcore::real::Stage;
use stepcore::sleep::Sleep;

use crate::arguments::{check_body, check_sensor, check_site, check_time, ray_filter};
use crate::element::{id, Id};
use crate::errors::{EnergyWarning, Raised};
use crate::extract::{At, Read};
use crate::gil;
use crate::memory::Arrays;
use crate::model::{result, shaped, Model};
use crate::settings::Settings;
use crate::snapshot::{decode, encode};
use crate::tables::{contacts, rows, ContactTable, RayTable, RowTable};
use crate::world::{world, BodyForce, Memo, Placed, Solved, World};

type Array<'py> = Bound<'py, PyArrayDyn<f64>>;
/// Energy before and after, and gains by element.
type TapedStep = (f64, f64, Vec<(Id, f64)>);

/// Says what there is to say of a world's energies.
fn warn(py: Python<'_>, world: &mut dyn World) -> PyResult<()> {
    let Some(text) = world.take_warning() else { return Ok(()) };
    // Names of a scene may hold a zero byte.
    let text = CString::new(text.replace('\0', "")).unwrap_or_default();
    // Python's own caller of `Sim.step`.
    PyErr::warn(py, &py.get_type::<EnergyWarning>(), &text, 2)
}

/// One world.
#[pyclass(module = "stepcore._core", frozen)]
pub struct Sim {
    model: Arc<EngineModel>,
    arrays: Arrays,
    world: Mutex<Box<dyn World>>,
}

impl Sim {
    fn lock(&self) -> PyResult<MutexGuard<'_, Box<dyn World>>> {
        gil::lock(&self.world, "Sim")
    }

    /// Checks the arrays and copies them into the engine.
    fn load(&self, py: Python<'_>, world: &mut dyn World) -> PyResult<()> {
        let loaded = self.arrays.read(py, 0, |given| {
            world.check(given)?;
            world.put(given);
            Ok(())
        });
        loaded.raised(py)
    }

    fn store(&self, py: Python<'_>, world: &mut dyn World) {
        self.arrays.store(py, move |_, array, out| world.take(array, out));
    }

    fn placed<'py>(&self, py: Python<'py>, what: Placed, shape: &[usize]) -> PyResult<Array<'py>> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        let numbers = self.arrays.read(py, 0, |given| world.placed(given, what)).raised(py)?;
        result(py, numbers, shape)
    }

    fn body_force<'py>(&self, py: Python<'py>, what: BodyForce) -> PyResult<Array<'py>> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        let numbers = gil::release(py, || world.body_force(what))?;
        result(py, numbers, &[self.model.bodies.len(), 6])
    }

    fn solved<'py>(&self, py: Python<'py>, what: Solved) -> PyResult<Array<'py>> {
        let numbers = self.lock()?.solved(what);
        let count = numbers.len();
        result(py, numbers, &[count])
    }
}

#[pymethods]
impl Sim {
    #[new]
    fn new(py: Python<'_>, model: &Model, settings: &Settings) -> PyResult<Self> {
        let model = model.0.clone();
        let world = gil::release(py, || world(model.clone(), &settings.0))?;
        let arrays = Arrays::new(py, &model, 1)?;
        Ok(Self { model, arrays, world: Mutex::new(world) })
    }

    #[getter]
    fn qpos<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.arrays.view(py, arrays::Array::Qpos, &[])
    }
    #[getter]
    fn qvel<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.arrays.view(py, arrays::Array::Qvel, &[])
    }
    #[getter]
    fn act<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.arrays.view(py, arrays::Array::Act, &[])
    }
    #[getter]
    fn ctrl<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.arrays.view(py, arrays::Array::Ctrl, &[])
    }
    #[getter]
    fn qfrc_applied<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.arrays.view(py, arrays::Array::QfrcApplied, &[])
    }
    #[getter]
    fn xfrc_applied<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.arrays.view(py, arrays::Array::XfrcApplied, &[])
    }
    #[getter]
    fn eq_active<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.arrays.view(py, arrays::Array::EqActive, &[])
    }
    #[getter]
    fn mocap_pos<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.arrays.view(py, arrays::Array::MocapPos, &[])
    }
    #[getter]
    fn mocap_quat<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.arrays.view(py, arrays::Array::MocapQuat, &[])
    }

    /// Advances by n steps.
    fn step(&self, py: Python<'_>, n: &Bound<'_, PyAny>) -> PyResult<()> {
        let n = u64::read(n, &At::Root.field("n"))?;
        let mut guard = self.lock()?;
        let world = &mut **guard;
        self.load(py, world)?;
        let mut outcome = gil::steps(py, n, |n| world.step(n));
        if n > 1 && outcome.is_ok() {
            // Not in each portion: how many there are depends on the machine.
            outcome = gil::release(py, || world.balance_at_end(n));
        }
        self.store(py, world);
        outcome?;
        warn(py, world)
    }

    /// Energies are not looked at, but by the ledger of the settings.
    fn unwatch(&self) -> PyResult<()> {
        self.lock()?.unwatch();
        Ok(())
    }

    /// Balances the ledger at the present state.
    fn balance(&self, py: Python<'_>) -> PyResult<()> {
        let mut guard = self.lock()?;
        let world = &mut **guard;
        self.load(py, world)?;
        let outcome = gil::release(py, || world.balance_at_end(u64::MAX));
        self.store(py, world);
        outcome?;
        warn(py, world)
    }

    /// Steps once; returns the kinetic and spring energy before and after, and the energy that
    /// each element injected.
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

    #[getter]
    fn time(&self) -> PyResult<f64> {
        Ok(self.lock()?.time())
    }

    /// Sets the time [s] from which steps are counted.
    #[setter]
    fn set_time(&self, time: &Bound<'_, PyAny>) -> PyResult<()> {
        let start = f64::read(time, &At::Root.field("time"))?;
        check_time(start)?;
        let mut world = self.lock()?;
        let memo = Memo { start, steps: 0, ..world.memo() };
        world.set_memo(&memo);
        Ok(())
    }

    /// Forgets the impulses of the last step, and wakes everybody.
    fn forget(&self) -> PyResult<()> {
        let mut world = self.lock()?;
        let memo = Memo { warm: Vec::new(), sleep: Sleep::new(), ..world.memo() };
        world.set_memo(&memo);
        Ok(())
    }

    /// A (2 nv + na columns) and B (nu columns), side by side, of the step from the present state; the
    /// elements at which they are one-sided.
    fn linearize<'py>(&self, py: Python<'py>) -> PyResult<(Array<'py>, Vec<Id>)> {
        let mut linearizer = {
            let mut guard = self.lock()?;
            let world = &mut **guard;
            self.load(py, world)?;
            gil::release(py, || world.linearizer())?
        };
        gil::steps(py, linearizer.steps(), |n| linearizer.advance(n))?;
        let rows = 2 * self.model.nv + self.model.na;
        let degenerate = linearizer.degenerate().iter().copied().map(id).collect();
        let matrix = result(py, linearizer.matrix, &[rows, rows + self.model.actuators.len()])?;
        Ok((matrix, degenerate))
    }

    /// Floating-point operations of the next n steps, by stage.
    fn count(&self, py: Python<'_>, n: &Bound<'_, PyAny>) -> PyResult<Vec<(&'static str, u64)>> {
        let n = u64::read(n, &At::Root.field("n"))?;
        let mut counter = {
            let mut guard = self.lock()?;
            let world = &mut **guard;
            self.load(py, world)?;
            gil::release(py, || world.counter())?
        };
        gil::steps(py, n, |n| counter.advance(n))?;
        Ok(Stage::ALL.iter().map(|stage| stage.name()).zip(counter.counts).collect())
    }

    /// Memory of state and working space in the engine.
    #[getter]
    fn nbytes(&self) -> PyResult<usize> {
        Ok(self.lock()?.bytes())
    }

    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let (dt, memo) = {
            let world = self.lock()?;
            (world.dt(), world.memo())
        };
        Ok(PyBytes::new(py, &self.arrays.read(py, 0, |given| encode(dt, &memo, given))))
    }

    fn restore(&self, py: Python<'_>, state: &[u8]) -> PyResult<()> {
        let mut world = self.lock()?;
        let mut snapshot = decode(state, self.arrays.lengths).map_err(PyValueError::new_err)?;
        snapshot.count_in(world.dt());
        world.set_memo(&snapshot.memo);
        self.arrays.restore(py, 0, &snapshot.numbers);
        Ok(())
    }

    // At the present state.

    #[getter]
    fn xpos<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::BodyPos, &[self.model.bodies.len(), 3])
    }
    #[getter]
    fn xquat<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::BodyQuat, &[self.model.bodies.len(), 4])
    }
    #[getter]
    fn xmat<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::BodyMat, &[self.model.bodies.len(), 3, 3])
    }
    #[getter]
    fn geom_xpos<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::GeomPos, &[self.model.geoms.len(), 3])
    }
    #[getter]
    fn geom_xmat<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::GeomMat, &[self.model.geoms.len(), 3, 3])
    }
    #[getter]
    fn actuator_length<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::ActuatorLength, &[self.model.actuators.len()])
    }
    #[getter]
    fn actuator_velocity<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::ActuatorVelocity, &[self.model.actuators.len()])
    }
    #[getter]
    fn ten_length<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::TendonLength, &[self.model.tendons.len()])
    }
    #[getter]
    fn ten_velocity<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::TendonVelocity, &[self.model.tendons.len()])
    }
    #[getter]
    #[pyo3(name = "ten_J")]
    fn ten_jacobian<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::TendonJacobian, &[self.model.tendons.len(), self.model.nv])
    }
    #[getter]
    fn ten_force<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::TendonForce, &[self.model.tendons.len()])
    }
    #[getter]
    fn site_xpos<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::SitePos, &[self.model.sites.len(), 3])
    }
    #[getter]
    fn site_xmat<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::SiteMat, &[self.model.sites.len(), 3, 3])
    }
    #[getter]
    fn subtree_com<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::SubtreeCom, &[self.model.bodies.len(), 3])
    }
    #[getter]
    fn cinert<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::Inertias, &[self.model.bodies.len(), 10])
    }
    #[getter]
    fn cvel<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::Velocities, &[self.model.bodies.len(), 6])
    }
    fn mass_matrix<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::MassMatrix, &[self.model.nv, self.model.nv])
    }
    #[getter]
    fn bias<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::Bias, &[self.model.nv])
    }
    #[getter]
    fn passive<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::Passive, &[self.model.nv])
    }
    /// Kinetic, potential.
    #[getter]
    fn energy<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::Energy, &[2])
    }
    /// Linear, angular about the world's origin.
    #[getter]
    fn momentum<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::Momentum, &[2, 3])
    }
    /// The deepest.
    #[getter]
    fn overlap<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.placed(py, Placed::Overlap, &[])
    }
    fn jacobian<'py>(&self, py: Python<'py>, body: usize) -> PyResult<Array<'py>> {
        check_body(&self.model, body)?;
        self.placed(py, Placed::Jacobian(body), &[6, self.model.nv])
    }
    fn site_jacobian<'py>(&self, py: Python<'py>, site: usize) -> PyResult<Array<'py>> {
        check_site(&self.model, site)?;
        self.placed(py, Placed::SiteJacobian(site), &[6, self.model.nv])
    }
    fn point_jacobian<'py>(
        &self,
        py: Python<'py>,
        body: usize,
        point: [f64; 3],
    ) -> PyResult<Array<'py>> {
        check_body(&self.model, body)?;
        self.placed(py, Placed::PointJacobian(body, point), &[6, self.model.nv])
    }

    // Of the last solve.

    #[getter]
    fn qacc<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.solved(py, Solved::Acceleration)
    }
    #[getter]
    fn constraint_force<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.solved(py, Solved::ConstraintForce)
    }
    #[getter]
    fn actuator_force<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.solved(py, Solved::ActuatorForce)
    }
    #[getter]
    fn cfrc_ext<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.body_force(py, BodyForce::External)
    }
    #[getter]
    fn cfrc_int<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.body_force(py, BodyForce::Internal)
    }
    #[getter]
    fn cacc<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.body_force(py, BodyForce::Acceleration)
    }
    /// A sensor's values, or all sensors'.
    #[pyo3(signature = (sensor = None))]
    fn sensordata<'py>(&self, py: Python<'py>, sensor: Option<usize>) -> PyResult<Array<'py>> {
        check_sensor(&self.model, sensor)?;
        let mut guard = self.lock()?;
        let world = &mut **guard;
        let numbers = gil::release(py, || world.sensordata(sensor))?;
        let count = numbers.len();
        result(py, numbers, &[count])
    }
    /// The forces that give an acceleration (nv,), by default that of the last solve.
    #[pyo3(signature = (qacc = None))]
    fn inverse<'py>(&self, py: Python<'py>, qacc: Option<Vec<f64>>) -> PyResult<Array<'py>> {
        let mut guard = self.lock()?;
        let (world, qacc) = (&mut **guard, qacc.as_deref());
        let forces = self.arrays.read(py, 0, |given| world.inverse(given, qacc)).raised(py)?;
        result(py, forces, &[self.model.nv])
    }
    /// Distances, geoms and normals of rays (n, 6) at the present state.
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
    /// Elements that push, and the generalised force of each.
    fn element_forces<'py>(&self, py: Python<'py>) -> PyResult<(Vec<Id>, Array<'py>)> {
        let forces = self.lock()?.element_forces();
        let shape = [forces.len(), self.model.nv];
        let elements = forces.keys().map(|element| id(*element)).collect();
        Ok((elements, shaped(py, forces.into_values().flatten().collect(), &shape)?))
    }
    /// Elements, geoms, and dist, pos, normal, force in the columns of one array.
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
    /// By body.
    #[getter]
    fn asleep(&self) -> PyResult<Vec<bool>> {
        Ok(self.lock()?.asleep())
    }
    #[getter]
    fn row_updates(&self) -> PyResult<u64> {
        Ok(self.lock()?.effort().row_updates)
    }
    #[getter]
    fn most_rows(&self) -> PyResult<usize> {
        Ok(self.lock()?.effort().most_rows)
    }
    #[getter]
    fn decrement(&self) -> PyResult<f64> {
        Ok(self.lock()?.effort().decrement)
    }
    /// How often the list of contacts had to grow.
    #[getter]
    fn contacts_grown(&self) -> PyResult<u64> {
        Ok(self.lock()?.grown())
    }
}
