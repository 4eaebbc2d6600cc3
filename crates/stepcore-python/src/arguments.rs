//! Arguments of methods that `Sim` and `Batch` have in common.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use stepcore::model::Model;
use stepcore::watch::RayFilter;

pub fn check_time(time: f64) -> PyResult<()> {
    if time.is_finite() {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("time = {time}: must be finite")))
}

pub fn check_body(model: &Model, body: usize) -> PyResult<()> {
    let count = model.bodies.len();
    if body < count {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("body = {body}: must be below {count}")))
}

pub fn check_site(model: &Model, site: usize) -> PyResult<()> {
    let count = model.sites.len();
    if site < count {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("site = {site}: must be below {count}")))
}

pub fn check_sensor(model: &Model, sensor: Option<usize>) -> PyResult<()> {
    let count = model.sensors.len();
    match sensor {
        Some(index) if index >= count => {
            Err(PyValueError::new_err(format!("sensor = {index}: must be below {count}")))
        }
        _ => Ok(()),
    }
}

/// The arguments of `rays` other than the rays, as in MuJoCo.
pub fn ray_filter(excluded: Option<usize>, groups: Option<[bool; 6]>, moving: bool) -> RayFilter {
    RayFilter { excluded, groups, moving }
}
