//! `Model` in Python: counts, names and tables of the compiled scene.

use std::sync::Arc;

use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use stepcore::arrays::Array;
use stepcore::elements::{joint_forces, Kind};
use stepcore::model::Model as Engine;
use stepcore::plan::{Entry, Of, Plan};
use stepcore::scene::{JointType, Scene, Target};

use crate::element::read;
use crate::errors::printable;
use crate::extract::{At, Read};
use crate::nearest::cut;
use crate::settings::Settings;
use crate::worlds::{Wide, WideF32};

/// An array of this shape that owns its numbers.
pub fn shaped<'py>(
    py: Python<'py>,
    values: Vec<f64>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    PyArray1::from_vec(py, values).reshape(shape.to_vec())
}

/// The same, read-only: writing into a result would have no effect.
pub fn result<'py>(
    py: Python<'py>,
    values: Vec<f64>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let array = shaped(py, values, shape)?;
    array.readwrite().make_nonwriteable();
    Ok(array)
}

/// A compiled scene; constant.
#[pyclass(module = "stepcore._core", frozen)]
pub struct Model(pub Arc<Engine>);

/// Compile a scene given as plain data: the result of `Scene.to_dict`.
#[pyfunction]
pub fn compile(scene: &Bound<'_, PyAny>) -> PyResult<Model> {
    let py = scene.py();
    let scene = Scene::read(scene, &At::Root)?;
    let model = crate::gil::release(py, || Engine::compile(&scene))?;
    Ok(Model(Arc::new(model)))
}

/// Free the memory that compiling keeps for later models: hulls of meshes (at most some 100 MB),
/// and which pairs of geoms never meet. The next model is compiled as the first one was.
#[pyfunction]
pub fn empty_caches() {
    stepcore::model::empty_caches();
}

fn joint_type(kind: JointType) -> &'static str {
    match kind {
        JointType::Free => "free",
        JointType::Ball => "ball",
        JointType::Slide => "slide",
        JointType::Hinge => "hinge",
    }
}

/// No limit, as a range.
const FREE: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

#[pymethods]
impl Model {
    #[getter]
    fn nq(&self) -> usize {
        self.0.nq
    }
    #[getter]
    fn nv(&self) -> usize {
        self.0.nv
    }

    #[getter]
    fn na(&self) -> usize {
        self.0.na
    }

    /// Names of every kind of element, in the order of the model; "" where there is none.
    fn names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let m = &*self.0;
        let names = PyDict::new(py);
        names.set_item("body", m.bodies.iter().map(|e| &e.name).collect::<Vec<_>>())?;
        names.set_item("joint", m.joints.iter().map(|e| &e.name).collect::<Vec<_>>())?;
        names.set_item("geom", m.geoms.iter().map(|e| &e.name).collect::<Vec<_>>())?;
        names.set_item("site", m.sites.iter().map(|e| &e.name).collect::<Vec<_>>())?;
        names.set_item("tendon", m.tendons.iter().map(|e| &e.name).collect::<Vec<_>>())?;
        names.set_item("sensor", m.sensors.iter().map(|e| &e.name).collect::<Vec<_>>())?;
        names.set_item("actuator", m.actuators.iter().map(|e| &e.name).collect::<Vec<_>>())?;
        names.set_item("equality", m.equalities.iter().map(|e| &e.name).collect::<Vec<_>>())?;
        names.set_item("key", m.keys.iter().map(|e| &e.name).collect::<Vec<_>>())?;
        Ok(names)
    }

    /// Return the name of an element: kind, index and part as in rows, contacts and errors.
    #[pyo3(signature = (kind, index, part = -1))]
    fn element_name(&self, kind: &str, index: usize, part: i64) -> PyResult<String> {
        Ok(printable(&self.0.element_name(read(&self.0, kind, index, part)?)))
    }

    /// Return the parts of that name: noun, owner and label, as in "spring", "joint", "`knee`".
    #[pyo3(signature = (kind, index, part = -1))]
    fn element_words(
        &self,
        kind: &str,
        index: usize,
        part: i64,
    ) -> PyResult<(&'static str, &'static str, String)> {
        let words = self.0.element_words(read(&self.0, kind, index, part)?);
        Ok((words.noun, words.owner, printable(&words.label)))
    }

    /// Return the force of all springs, dampers or actuators on the dofs at many states: ctrl (n,
    /// nu), act (n, na), qpos (n, nq), qvel (n, nv).
    fn element_force<'py>(
        &self,
        py: Python<'py>,
        kind: &str,
        ctrl: PyReadonlyArray2<'py, f64>,
        act: PyReadonlyArray2<'py, f64>,
        qpos: PyReadonlyArray2<'py, f64>,
        qvel: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let (m, n) = (&*self.0, qvel.shape()[0]);
        for (name, array, width) in [
            ("ctrl", &ctrl, m.actuators.len()),
            ("act", &act, m.na),
            ("qpos", &qpos, m.nq),
            ("qvel", &qvel, m.nv),
        ] {
            if array.shape() != [n, width] {
                let shape = array.shape();
                let text = format!("{name} has shape {shape:?}: must be ({n}, {width})");
                return Err(PyValueError::new_err(text));
            }
        }
        let list = |array: &PyReadonlyArray2<'py, f64>| array.as_array().iter().copied().collect();
        let [ctrl, act, qpos, qvel]: [Vec<f64>; 4] = [&ctrl, &act, &qpos, &qvel].map(list);
        let found = Kind::ALL.into_iter().find(|known| known.word() == kind);
        let forces = found.and_then(|kind| joint_forces(m, kind, &ctrl, &act, &qpos, &qvel));
        let Some(forces) = forces else {
            let limit = "must be 'spring', 'damper' or 'actuator'";
            return Err(PyValueError::new_err(format!("kind = '{}': {limit}", cut(kind))));
        };
        result(py, forces, &[n, m.nv])
    }

    /// Find the contacts of two geoms at positions qpos (n, nq), in numbers of type "f64" or "f32",
    /// in lanes if the name ends with that ("f32 lanes") and the module has them: exists and
    /// feature (n, slots), dist (n, slots), pos and normal (n, slots, 3).
    fn touches<'py>(
        &self,
        py: Python<'py>,
        geom1: usize,
        geom2: usize,
        qpos: PyReadonlyArray2<'py, f64>,
        numbers: &str,
    ) -> PyResult<[Bound<'py, PyAny>; 5]> {
        let (m, n) = (&self.0, qpos.shape()[0]);
        if qpos.shape()[1] != m.nq || geom1.max(geom2) >= m.geoms.len() {
            let limit = format!("shape (n, {}) and geoms below {}", m.nq, m.geoms.len());
            return Err(PyValueError::new_err(format!("qpos, geom1, geom2: must be of {limit}")));
        }
        let qpos: Vec<f64> = qpos.as_array().iter().copied().collect();
        let found = crate::gil::release(py, || match numbers {
            "f64" => m.touches::<f64>(geom1, geom2, n, &qpos),
            "f32" => m.touches::<f32>(geom1, geom2, n, &qpos),
            "f32 lanes" => m.touches::<WideF32>(geom1, geom2, n, &qpos),
            _ => m.touches::<Wide>(geom1, geom2, n, &qpos),
        })?;
        let shape = [n, found.slots];
        let wide = [n, found.slots, 3];
        let flat = |vectors: Vec<[f64; 3]>| vectors.into_iter().flatten().collect();
        Ok([
            PyArray1::from_vec(py, found.exists).reshape(shape)?.into_any(),
            result(py, found.dist, &shape)?.into_any(),
            result(py, flat(found.pos), &wide)?.into_any(),
            result(py, flat(found.normal), &wide)?.into_any(),
            result(py, found.feature, &shape)?.into_any(),
        ])
    }

    /// Return the convex hull of a geom, in its frame [m]: vertices (n, 3) and triangles (m, 3),
    /// flat; None if it has none.
    fn geom_hull(&self, geom: usize) -> Option<(Vec<f64>, Vec<usize>)> {
        let hull = self.0.geoms.get(geom)?.hull.as_ref()?;
        let vertices = hull.vertices.iter().flat_map(|v| [v.x, v.y, v.z]);
        Some((vertices.collect(), hull.triangles.iter().flatten().copied().collect()))
    }

    /// Return numbers by name, each an array whose first axis is the element.
    fn tables<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let m = &*self.0;
        let tables = PyDict::new(py);
        let add = |name: &str, values: Vec<f64>, shape: &[usize]| {
            tables.set_item(name, shaped(py, values, shape)?)
        };
        let (nbody, njnt, ngeom, nu) =
            (m.bodies.len(), m.joints.len(), m.geoms.len(), m.actuators.len());
        add("qpos0", m.qpos0.clone(), &[m.nq])?;
        add("body_mass", m.bodies.iter().map(|b| b.mass).collect(), &[nbody])?;
        let inertia = m.bodies.iter().flat_map(|b| b.inertia.iter().copied().collect::<Vec<_>>());
        add("body_inertia", inertia.collect(), &[nbody, 3, 3])?;
        add(
            "body_ipos",
            m.bodies.iter().flat_map(|b| [b.ipos.x, b.ipos.y, b.ipos.z]).collect(),
            &[nbody, 3],
        )?;
        add("body_iquat", m.bodies.iter().flat_map(|b| b.iquat).collect(), &[nbody, 4])?;
        add("body_invweight0", m.bodies.iter().flat_map(|b| b.invweight).collect(), &[nbody, 2])?;
        add("dof_invweight0", m.dofs.iter().map(|d| d.invweight).collect(), &[m.nv])?;
        add(
            "jnt_range",
            m.joints.iter().flat_map(|j| j.range.unwrap_or(FREE)).collect(),
            &[njnt, 2],
        )?;
        add(
            "jnt_axis",
            m.joints.iter().flat_map(|j| [j.axis.x, j.axis.y, j.axis.z]).collect(),
            &[njnt, 3],
        )?;
        add(
            "jnt_pos",
            m.joints.iter().flat_map(|j| [j.pos.x, j.pos.y, j.pos.z]).collect(),
            &[njnt, 3],
        )?;
        let tendons = || m.tendons.iter();
        let ntendon = m.tendons.len();
        add("tendon_length0", tendons().map(|t| t.length0).collect(), &[ntendon])?;
        add("tendon_invweight0", tendons().map(|t| t.invweight).collect(), &[ntendon])?;
        add(
            "tendon_lengthspring",
            tendons().flat_map(|t| t.springlength).collect(),
            &[ntendon, 2],
        )?;
        add(
            "tendon_range",
            tendons().flat_map(|t| t.range.unwrap_or(FREE)).collect(),
            &[ntendon, 2],
        )?;
        add("geom_size", m.geoms.iter().flat_map(|g| g.size).collect(), &[ngeom, 3])?;
        add(
            "actuator_ctrlrange",
            m.actuators.iter().flat_map(|a| a.ctrlrange.unwrap_or(FREE)).collect(),
            &[nu, 2],
        )?;
        add(
            "actuator_forcerange",
            m.actuators.iter().flat_map(|a| a.forcerange.unwrap_or(FREE)).collect(),
            &[nu, 2],
        )?;
        add(
            "actuator_actrange",
            m.actuators.iter().flat_map(|a| a.actrange.unwrap_or(FREE)).collect(),
            &[nu, 2],
        )?;
        add("actuator_gain", m.actuators.iter().map(|a| a.gain[0]).collect(), &[nu])?;
        add("actuator_bias", m.actuators.iter().flat_map(|a| a.bias).collect(), &[nu, 3])?;
        add("actuator_gear", m.actuators.iter().flat_map(|a| a.gear).collect(), &[nu, 6])?;
        let npair = m.pairs.len();
        add(
            "pair_solref",
            m.pairs.iter().flat_map(|p| m.material(p).soft.solref).collect(),
            &[npair, 2],
        )?;
        add(
            "pair_friction",
            m.pairs.iter().map(|p| m.material(p).friction[0]).collect(),
            &[npair],
        )?;
        add("pair_invweight0", m.pairs.iter().map(|p| p.invweight).collect(), &[npair])?;
        Ok(tables)
    }

    /// Return addresses and owners by name, each a list of integers.
    fn addresses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let m = &*self.0;
        let lists = PyDict::new(py);
        lists.set_item("body_parent", m.bodies.iter().map(|b| b.parent).collect::<Vec<_>>())?;
        lists.set_item("jnt_qposadr", m.joints.iter().map(|j| j.qpos).collect::<Vec<_>>())?;
        lists.set_item("jnt_dofadr", m.joints.iter().map(|j| j.dof).collect::<Vec<_>>())?;
        lists.set_item("jnt_body", m.joints.iter().map(|j| j.body).collect::<Vec<_>>())?;
        let act = |span: &stepcore::model::Span| if span.len > 0 { span.start as i64 } else { -1 };
        let actadr: Vec<i64> = m.activations.iter().map(act).collect();
        lists.set_item("actuator_actadr", actadr)?;
        lists.set_item("geom_body", m.geoms.iter().map(|g| g.body).collect::<Vec<_>>())?;
        lists.set_item("sensor_dim", m.sensors.iter().map(|s| s.size()).collect::<Vec<_>>())?;
        lists.set_item("site_body", m.sites.iter().map(|s| s.body).collect::<Vec<_>>())?;
        let joint = |target: &Target| match *target {
            Target::Joint(joint) | Target::InParent(joint) => joint as i64,
            _ => -1,
        };
        let joints: Vec<i64> = m.actuators.iter().map(|a| joint(&a.target)).collect();
        lists.set_item("actuator_joint", joints)?;
        Ok(lists)
    }

    fn joint_types(&self) -> Vec<&'static str> {
        self.0.joints.iter().map(|joint| joint_type(joint.kind)).collect()
    }

    fn geom_types(&self) -> Vec<&'static str> {
        self.0.geoms.iter().map(|geom| geom.kind.word()).collect()
    }

    fn sensor_types(&self) -> Vec<&'static str> {
        self.0.sensors.iter().map(|sensor| sensor.kind.word()).collect()
    }

    /// Return the geoms that can meet, by index; empty in a pile.
    fn pairs(&self) -> Vec<(usize, usize)> {
        self.0.pairs.iter().map(|pair| (pair.geom1, pair.geom2)).collect()
    }

    /// Return the pair of a contact: its geoms, condim, friction, solref and invweight.
    fn pair(&self, index: usize) -> PyResult<(usize, usize, u32, f64, [f64; 2], f64)> {
        let m = &*self.0;
        let Some(pair) = m.pair(index) else {
            let limit = "must be the index of a pair of geoms that can meet";
            return Err(PyValueError::new_err(format!("index = {index}: {limit}")));
        };
        let material = m.material(&pair);
        let (condim, solref) = (material.condim, material.soft.solref);
        Ok((pair.geom1, pair.geom2, condim, material.friction[0], solref, pair.invweight))
    }

    /// Return how many pairs of a pile can meet, by the two kinds of geoms; None for other models.
    fn heap(&self) -> Option<Vec<(&'static str, &'static str, usize)>> {
        self.0.dynamic_pairs.as_ref()?;
        let meet = self.0.tally().meet;
        Some(meet.into_iter().map(|((a, b), count)| (a.word(), b.word(), count)).collect())
    }

    /// Return the work that a step does and leaves out: see `Plan` in `plan/mod.rs`. Stage, kind,
    /// name, type of elements, indices, how many, whether used, why not, and the kind of rows.
    #[allow(clippy::type_complexity)]
    fn entries(
        &self,
        settings: &Settings,
    ) -> Vec<(
        &'static str,
        &'static str,
        String,
        &'static str,
        Vec<usize>,
        usize,
        bool,
        String,
        Option<&'static str>,
    )> {
        let of = |entry: &Entry| match entry.of {
            Of::Body => "body",
            Of::Joint => "joint",
            Of::Geom => "geom",
            Of::Tendon => "tendon",
            Of::Actuator => "actuator",
            Of::Equality => "equality",
            Of::Sensor => "sensor",
            Of::Tree => "tree",
            Of::Island => "island",
            Of::Pair => "pair",
        };
        let entries = Plan::of(&self.0, &settings.0).entries(&self.0, &settings.0).into_iter();
        entries
            .map(|e| {
                (
                    e.stage,
                    e.kind,
                    e.name.clone(),
                    of(&e),
                    e.elements,
                    e.count,
                    e.used,
                    e.why,
                    e.rows,
                )
            })
            .collect()
    }

    /// Return decisions of compilation that `entries` omits: by pair, tree and geom, in order.
    fn plan<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let m = &*self.0;
        let plan = PyDict::new(py);
        let unmet =
            m.unmet().into_iter().map(|(why, unmet)| (why.why(), unmet.count, unmet.examples));
        plan.set_item("unmet", unmet.collect::<Vec<_>>())?;
        let pairs = m.pairs.iter();
        plan.set_item("condim", pairs.clone().map(|p| m.material(p).condim).collect::<Vec<_>>())?;
        plan.set_item("apart", pairs.map(|p| p.apart).collect::<Vec<_>>())?;
        let guards = m.guards.iter().map(|g| (g.joint, g.low, g.high));
        plan.set_item("guards", guards.collect::<Vec<_>>())?;
        let trees = m.trees.iter();
        let spans = trees.clone().map(|t| (t.bodies.start, t.bodies.len, t.dofs.start, t.dofs.len));
        plan.set_item("trees", spans.collect::<Vec<_>>())?;
        plan.set_item("constant", trees.map(|t| t.constant).collect::<Vec<_>>())?;
        plan.set_item("collides", m.geoms.iter().map(|g| g.collides).collect::<Vec<_>>())?;
        plan.set_item("tendons", m.tendons.iter().map(|t| t.used).collect::<Vec<_>>())?;
        plan.set_item("islands", m.islands())?;
        Ok(plan)
    }

    /// Return the time of every keyframe and its qpos, qvel, act, ctrl, mocap_pos and mocap_quat,
    /// defaults filled in.
    fn keys(&self) -> Vec<(f64, Vec<Vec<f64>>)> {
        let m = &*self.0;
        let key = |k: &stepcore::scene::Key| {
            let given = [
                (Array::Qpos, &k.qpos),
                (Array::Qvel, &k.qvel),
                (Array::Act, &k.act),
                (Array::Ctrl, &k.ctrl),
                (Array::MocapPos, &k.mpos),
                (Array::MocapQuat, &k.mquat),
            ];
            let filled =
                given.map(|(array, values)| values.clone().unwrap_or_else(|| array.initial(m)));
            (k.time, filled.to_vec())
        };
        m.keys.iter().map(key).collect()
    }

    /// Return every array that the user may write, by name, with its initial numbers one after the
    /// other.
    fn initial(&self) -> Vec<(&'static str, Vec<f64>)> {
        Array::ALL.map(|array| (array.name(), array.initial(&self.0))).to_vec()
    }
}
