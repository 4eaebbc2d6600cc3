//! Tables of contacts, rows and rays for Python.

use numpy::PyArrayDyn;
use pyo3::prelude::*;

use crate::element::{id, Id};
use crate::model::shaped;
use crate::world::{Contacts, Rows};

type Array<'py> = Bound<'py, PyArrayDyn<f64>>;
/// Elements, geoms; dist, pos, normal, force, torque.
pub type ContactTable<'py> = (Vec<Id>, Vec<(usize, usize)>, Array<'py>);
/// Elements, names, blocks; impulse, velocity, target, regulariser, residual, lo, hi.
pub type RowTable<'py> = (Vec<Id>, Vec<String>, Vec<usize>, Array<'py>);

/// Distances, geoms, normals.
pub type RayTable<'py> = (Array<'py>, Vec<i64>, Array<'py>);

pub fn contacts<'py>(py: Python<'py>, table: Contacts) -> PyResult<ContactTable<'py>> {
    let count = table.geoms.len();
    let elements = table.elements.into_iter().map(id).collect();
    Ok((elements, table.geoms, shaped(py, table.numbers, &[count, 13])?))
}

pub fn rows<'py>(py: Python<'py>, table: Rows) -> PyResult<RowTable<'py>> {
    let count = table.blocks.len();
    let elements = table.elements.into_iter().map(id).collect();
    Ok((elements, table.names, table.blocks, shaped(py, table.numbers, &[count, 7])?))
}
