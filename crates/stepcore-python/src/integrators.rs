//! The integrators in Python: the properties of each, and its step for linear motion.

use numpy::{PyArrayDyn, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use stepcore::integrator::linear_map::{DMatrix, Linear};
use stepcore::integrator::{Integrator, Late, Scheme, Stages, Turning};

use crate::errors::Raised;
use crate::model::shaped;

/// Return by name: where in a step forces are evaluated, and which damping, bias forces and
/// stiffness are taken at its end.
#[pyfunction]
pub fn integrators(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let all = PyDict::new(py);
    for integrator in Integrator::ALL {
        let Scheme { stages, damping, turning, stiffness, .. } = *integrator.scheme();
        let scheme = PyDict::new(py);
        let stages = match stages {
            Stages::Start => "start",
            Stages::Middle => "middle",
            Stages::Four => "four",
        };
        scheme.set_item("stages", stages)?;
        let damping = damping.map(|late| match late {
            Late::Joints => "joints",
            Late::All => "all",
        });
        scheme.set_item("damping", damping)?;
        let turning = turning.map(|turning| match turning {
            Turning::FreeBodies => "free bodies",
            Turning::Trees => "trees",
        });
        scheme.set_item("turning", turning)?;
        scheme.set_item("stiffness", stiffness)?;
        all.set_item(integrator.name(), scheme)?;
    }
    Ok(all)
}

/// Return x⁺ for every column of x, or None if a matrix is singular: see `engine/linear_maps.py`.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn linear_step<'py>(
    py: Python<'py>,
    integrator: &str,
    dt: f64,
    x: PyReadonlyArray2<'py, f64>,
    rates: PyReadonlyArray2<'py, f64>,
    mass: PyReadonlyArray2<'py, f64>,
    damping: PyReadonlyArray2<'py, f64>,
    stiffness: PyReadonlyArray2<'py, f64>,
) -> PyResult<Option<Bound<'py, PyArrayDyn<f64>>>> {
    let integrator = Integrator::parse(integrator).raised(py)?;
    let matrix = |array: &PyReadonlyArray2<'py, f64>| {
        let array = array.as_array();
        DMatrix::from_row_iterator(array.nrows(), array.ncols(), array.iter().copied())
    };
    let motion = Linear {
        rates: &matrix(&rates),
        mass: &matrix(&mass),
        damping: &matrix(&damping),
        stiffness: &matrix(&stiffness),
    };
    let Some(made) = motion.step(integrator, dt, &matrix(&x)) else { return Ok(None) };
    let shape = [made.nrows(), made.ncols()];
    shaped(py, made.transpose().as_slice().to_vec(), &shape).map(Some)
}
