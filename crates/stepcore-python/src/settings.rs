//! `Settings` in Python: the fields, defaults and limits of the engine's.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString, PyTuple};
use stepcore::settings::{
    Acceleration, Accuracy, Cone, Integrator, Law, Precision, RecoverySpeed, Settings as Engine,
    Solver, Sweeps,
};

use crate::errors::Raised;
use crate::extract::{refuse, At, Read};
use crate::nearest::{cut, nearest};

/// A field in Python.
trait Shown {
    type Out;
    fn shown(self) -> Self::Out;
}

macro_rules! shown_as_it_is {
    ($($type:ty),+) => {$(
        impl Shown for $type {
            type Out = $type;
            fn shown(self) -> $type {
                self
            }
        }
    )+};
}
shown_as_it_is!(f64, u32, usize, bool);

macro_rules! shown_by_name {
    ($($type:ty),+) => {$(
        impl Shown for $type {
            type Out = &'static str;
            fn shown(self) -> &'static str {
                self.name()
            }
        }
        impl Read for $type {
            fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
                let name = String::read(value, at)?;
                <$type>::parse(&cut(&name)).raised(value.py())
            }
        }
    )+};
}
shown_by_name!(Integrator, Solver, Acceleration, Precision, Law, Cone);

/// A number or a name.
#[derive(IntoPyObject)]
enum Shows {
    Count(u32),
    Number(f64),
    Name(&'static str),
}

impl Shown for Sweeps {
    type Out = Shows;
    fn shown(self) -> Shows {
        match self {
            Self::AtMost(count) => Shows::Count(count),
            Self::Auto => Shows::Name(Self::AUTO),
        }
    }
}

impl Read for Sweeps {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        match value.cast::<PyString>() {
            Ok(name) if name == Self::AUTO => Ok(Self::Auto),
            Ok(_) => Err(refuse(value, at, "'auto' or a whole number")),
            Err(_) => Ok(Self::AtMost(u32::read(value, at)?)),
        }
    }
}

impl Shown for RecoverySpeed {
    type Out = Shows;
    fn shown(self) -> Shows {
        match self {
            Self::Auto => Shows::Name(Self::AUTO),
            Self::None => Shows::Name(Self::NONE),
            Self::AtMost(speed) => Shows::Number(speed),
        }
    }
}

impl Read for RecoverySpeed {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        match value.cast::<PyString>() {
            Ok(name) if name == Self::AUTO => Ok(Self::Auto),
            Ok(name) if name == Self::NONE => Ok(Self::None),
            Ok(_) => Err(refuse(value, at, "'auto', 'none' or a number")),
            Err(_) => Ok(Self::AtMost(f64::read(value, at)?)),
        }
    }
}

impl Shown for Accuracy {
    type Out = Option<f64>;
    fn shown(self) -> Option<f64> {
        self.0
    }
}

impl Read for Accuracy {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        if value.is_none() {
            return Ok(Self(None));
        }
        if value.cast::<PyString>().is_err() {
            return Ok(Self(Some(f64::read(value, at)?)));
        }
        let units = value.py().import("stepcore.report.units")?;
        match units.call_method1("length_of", (value,))?.extract()? {
            None => Err(refuse(value, at, "None, metres, or a length such as '1mm'")),
            length => Ok(Self(length)),
        }
    }
}

/// The Python class, from the one list of fields.
macro_rules! settings {
    ($($(#[$doc:meta])* $field:ident: $type:ty),+ $(,)?) => {
        const FIELDS: &[&str] = &[$(stringify!($field)),+];

        fn set(settings: &mut Engine, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
            let at = At::Root;
            let at = at.field(name);
            match name {
                $(stringify!($field) => settings.$field = <$type>::read(value, &at)?,)+
                _ => {
                    let text = format!("settings have no '{}'{}", cut(name), nearest(name, FIELDS));
                    return Err(PyValueError::new_err(text));
                }
            }
            Ok(())
        }

        /// How a scene is simulated; immutable. Every field is a keyword argument with a default; a bad
        /// value is a ValueError that names the field and its limit.
        #[pyclass(module = "stepcore", frozen)]
        #[derive(Clone, PartialEq)]
        pub struct Settings(pub Engine);

        #[pymethods]
        impl Settings {
            #[new]
            #[pyo3(signature = (**fields))]
            fn new(fields: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
                changed(&Engine::default(), fields)
            }

            /// Returns a copy with some fields changed.
            #[pyo3(signature = (**fields))]
            fn replace(&self, fields: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
                changed(&self.0, fields)
            }

            /// Returns all fields by name.
            fn as_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
                let dict = PyDict::new(py);
                $(dict.set_item(stringify!($field), self.0.$field.shown())?;)+
                Ok(dict)
            }

            fn __eq__(&self, other: &Self) -> bool {
                self == other
            }

            fn __hash__(&self, py: Python<'_>) -> PyResult<isize> {
                self.__repr__(py)?.into_pyobject(py)?.hash()
            }

            /// The fields that differ from their defaults.
            fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
                let defaults = Engine::default();
                let mut parts = Vec::<String>::new();
                $(if self.0.$field != defaults.$field {
                    let value = self.0.$field.shown().into_pyobject(py)?;
                    parts.push(format!("{}={}", stringify!($field), value.repr()?));
                })+
                Ok(format!("Settings({})", parts.join(", ")))
            }

            fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyTuple>, Bound<'py, PyDict>)> {
                Ok((PyTuple::empty(py), self.as_dict(py)?))
            }

            $($(#[$doc])* #[getter] fn $field(&self) -> <$type as Shown>::Out { self.0.$field.shown() })+
        }
    };
}

settings! {
    /// Time step [s], > 0.
    dt: f64,
    /// The largest error that a second of motion may add to the position of a body [m], or None for
    /// steps of a fixed length: each step of `dt` is then made of as many shorter ones as this takes.
    accuracy: Accuracy,
    /// Integrator: "explicit", "semi-implicit", "euler" (semi-implicit with implicit joint
    /// damping), "implicitfast", "implicit", "discrete", "midpoint" or "rk4".
    integrator: Integrator,
    /// Solver of the constraint rows: "pgs" (projected Gauss-Seidel) or "newton".
    solver: Solver,
    /// Acceleration of projected Gauss-Seidel: "none" or "momentum".
    acceleration: Acceleration,
    /// Maximum number of sweeps, or Newton iterations, in a solve. "auto" iterates until the
    /// residual is within the tolerance, which must be > 0, or at rounding, at most 10 000 times;
    /// under "rigid", "lesson" and "relaxed" a proximal method then goes on with what is left.
    sweeps: Sweeps,
    /// Residual at which a solve stops [m/s], >= 0; 0 always takes all sweeps. Given without a
    /// cost_tolerance, it replaces the one that the file asks for.
    tolerance: f64,
    /// MuJoCo's tolerance: with a number of sweeps, a solve under "solref" stops after a sweep or a
    /// Newton step that lowers the cost by less than this share of the trace of the mass matrix
    /// [m²/s⁴], >= 0; 0 for none, as in scenes that are not MJCF files. Newton's impulses then agree
    /// with the velocities to that tolerance, else to rounding.
    cost_tolerance: f64,
    /// Whether a solve starts from the impulses and the acceleration of the last step.
    warm_start: bool,
    /// Precision of the computation: "f64" or "f32".
    precision: Precision,
    /// Number of contacts to reserve memory for; more are allowed.
    max_contacts: usize,
    /// Whether the energy balance is checked every 64 steps and recorded for a post-mortem.
    ledger: bool,
    /// Constraint law: "solref" (MuJoCo's), "lesson", "relaxed", "rigid" or "penalty".
    law: Law,
    /// Fraction of a constraint violation that a step corrects, in (0, 1].
    beta: f64,
    /// Regulariser of the rows under "lesson" and "relaxed" [1/kg], >= 0.
    softness: f64,
    /// Fraction of the normal speed after an impact under "rigid", in [0, 1].
    restitution: f64,
    /// Overlap that is not corrected under "rigid" [m], >= 0.
    slop: f64,
    /// The fastest that a contact pushes an overlap apart [m/s], > 0; "none" for no limit. "auto"
    /// is 3 m/s under "lesson", "relaxed" and "rigid", and no limit under "solref". "penalty" has
    /// none.
    max_recovery_speed: RecoverySpeed,
    /// Contact stiffness under "penalty" [N/m], > 0.
    penalty_stiffness: f64,
    /// Damping ratio of a contact under "penalty", >= 0.
    penalty_damping_ratio: f64,
    /// Friction cone: "pyramidal" or "elliptic".
    cone: Cone,
    /// Ratio of frictional to normal impedance, > 0.
    impratio: f64,
    /// Sweeps over friction rows alone, with a regulariser of 0, after each solve under "solref":
    /// MuJoCo's noslip. 0 for none.
    noslip_iterations: u32,
    /// MuJoCo's noslip_tolerance: noslip stops after a sweep that lowers the cost by less than this
    /// share of the trace of the mass matrix [m²/s⁴], >= 0; 0 for none, as in scenes that are not
    /// MJCF files.
    noslip_tolerance: f64,
    /// Whether friction under "solref" holds a contact that sticks by a tangential spring as
    /// stiff as the contact's solref, instead of letting it creep. Other laws have no creep.
    stiction: bool,
    /// Whether islands at rest sleep: they stand still and make no rows until something touches
    /// them. Runs one world at a time, with integrators that evaluate forces once a step.
    sleep: bool,
    /// Speed below which every dof of a tree must be for it to sleep [m/s], >= 0; turning counts
    /// as the speed at the reach of its body (MuJoCo's dof_length).
    sleep_tolerance: f64,
    /// Time for which a whole island must have been as slow before it sleeps [s], >= 0. A file
    /// with MJCF's flag "sleep" has MuJoCo's 10 time steps.
    sleep_time: f64,
    /// Whether the time constants of solref are at least 2 dt.
    refsafe: bool,
}

/// `base` with some fields changed, checked as a whole.
fn changed(base: &Engine, fields: Option<&Bound<'_, PyDict>>) -> PyResult<Settings> {
    let mut settings = base.clone();
    if let Some(fields) = fields {
        for (name, value) in fields {
            set(&mut settings, &name.extract::<String>()?, &value)?;
        }
        if fields.contains("tolerance")? && !fields.contains("cost_tolerance")? {
            settings.cost_tolerance = 0.0;
        }
        settings.check().raised(fields.py())?;
    }
    Ok(Settings(settings))
}
