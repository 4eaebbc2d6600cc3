//! Elements in Python: (kind, index, part), part -1 for the whole of an element.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use stepcore::elements::{Element, Kind};
use stepcore::model::Model;

use crate::nearest::{cut, nearest};

/// Kind by its word, index in the model's list, part.
pub type Id = (&'static str, u64, i64);

pub fn id(element: Element) -> Id {
    let part = if element.part == Element::WHOLE { -1 } else { i64::from(element.part) };
    (element.kind.word(), element.index, part)
}

/// The element for these arguments, if the model has it.
pub fn read(model: &Model, kind: &str, index: usize, part: i64) -> PyResult<Element> {
    let Some(found) = Kind::ALL.into_iter().find(|known| known.word() == kind) else {
        let known = Kind::ALL.map(Kind::word);
        let near = nearest(kind, &known);
        return Err(PyValueError::new_err(format!("kind = '{}': no such kind{near}", cut(kind))));
    };
    let count = model.count(found);
    if index >= count {
        return Err(PyValueError::new_err(format!("index = {index}: must be below {count}")));
    }
    if found == Kind::Contact && model.contact_geoms(index).is_none() {
        let limit = "must be the number of a pair of geoms that can meet";
        return Err(PyValueError::new_err(format!("index = {index}: {limit}")));
    }
    match part {
        -1 => Ok(Element::whole(found, index)),
        part => usize::try_from(part).map(|part| Element::part(found, index, part)).map_err(|_| {
            PyValueError::new_err(format!("part = {part}: must be -1 (all of it) or above"))
        }),
    }
}
