//! Values from Python. Every failure is a `ValueError` that names the place of the value
//! (`geoms[3].size`), the value and its limit.

use std::fmt;

use std::sync::Arc;

use numpy::{PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyString};

use crate::nearest::nearest;

/// The place of a value; printed only when something is wrong with it.
#[derive(Clone, Copy)]
pub enum At<'a> {
    Root,
    Field(&'a At<'a>, &'a str),
    Index(&'a At<'a>, usize),
}

impl At<'_> {
    pub fn field<'a>(&'a self, name: &'a str) -> At<'a> {
        At::Field(self, name)
    }
    pub fn index(&self, index: usize) -> At<'_> {
        At::Index(self, index)
    }
}

impl fmt::Display for At<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            At::Root => Ok(()),
            At::Field(At::Root, name) => f.write_str(name),
            At::Field(parent, name) => write!(f, "{parent}.{name}"),
            At::Index(parent, index) => write!(f, "{parent}[{index}]"),
        }
    }
}

/// The one form of every error text about a value from Python.
pub fn refuse(value: &Bound<'_, PyAny>, at: &At, limit: &str) -> PyErr {
    let shown = value.repr().map_or_else(|_| "?".into(), |text| text.to_string());
    let mut shown: String = shown.split_whitespace().collect::<Vec<_>>().join(" ");
    if shown.chars().count() > 80 {
        shown = shown.chars().take(79).chain(['…']).collect();
    }
    PyValueError::new_err(format!("{at} = {shown}: must be {limit}"))
}

/// A type that can be read from a Python object.
pub trait Read: Sized {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self>;
}

/// Booleans of Python and numpy are numbers to Python, not here.
fn is_bool(value: &Bound<'_, PyAny>) -> bool {
    value.get_type().name().is_ok_and(|name| name == "bool" || name == "bool_")
}

impl Read for f64 {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        match value.extract() {
            Ok(number) if value.is_exact_instance_of::<PyFloat>() || !is_bool(value) => Ok(number),
            _ => Err(refuse(value, at, "a number")),
        }
    }
}

impl Read for bool {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        match value.extract() {
            Ok(flag) if is_bool(value) => Ok(flag),
            _ => Err(refuse(value, at, "True or False")),
        }
    }
}

macro_rules! read_whole {
    ($($type:ty),+) => {$(
        impl Read for $type {
            fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
                match value.extract() {
                    // numpy's booleans do not convert to integers by themselves.
                    Ok(number) if !value.is_instance_of::<PyBool>() => Ok(number),
                    _ => {
                        let limit = format!("a whole number from {} to {}", <$type>::MIN, <$type>::MAX);
                        Err(refuse(value, at, &limit))
                    }
                }
            }
        }
    )+};
}
read_whole!(i32, u32, u64, usize);

impl Read for String {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        let text = value.cast::<PyString>().map_err(|_| refuse(value, at, "a string"))?;
        Ok(text.to_str().map_err(|_| refuse(value, at, "a string of valid Unicode"))?.to_owned())
    }
}

impl<T: Read> Read for Option<T> {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        if value.is_none() {
            Ok(None)
        } else {
            T::read(value, at).map(Some)
        }
    }
}

impl<T: Read> Read for Vec<T> {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        let list = || refuse(value, at, "a list");
        if value.is_instance_of::<PyString>() || value.is_instance_of::<PyDict>() {
            return Err(list());
        }
        let mut result = Vec::new();
        for (index, item) in value.try_iter().map_err(|_| list())?.enumerate() {
            if result.len() == result.capacity() {
                result.try_reserve(1).map_err(|_| no_room(at, index))?;
            }
            result.push(T::read(&item.map_err(|_| list())?, &at.index(index))?);
        }
        Ok(result)
    }
}

/// The rows of a numpy array, read at once, or of any list.
macro_rules! read_rows {
    ($($item:ty: $row:ty),+) => {$(
        impl Read for Arc<Vec<$row>> {
            fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
                let rows = match value.cast::<PyArrayDyn<$item>>() {
                    Ok(array) => <$row>::rows(&array.readonly(), value, at)?,
                    Err(_) => Vec::read(value, at)?,
                };
                Ok(Self::new(rows))
            }
        }
    )+};
}
read_rows!(f64: f64, f64: [f64; 3], usize: [usize; 3]);

/// The content of one row of an array.
trait Row<T>: Sized {
    fn rows(
        array: &PyReadonlyArrayDyn<'_, T>,
        value: &Bound<'_, PyAny>,
        at: &At,
    ) -> PyResult<Vec<Self>>
    where
        T: numpy::Element;
}

impl Row<f64> for f64 {
    fn rows(
        array: &PyReadonlyArrayDyn<'_, f64>,
        value: &Bound<'_, PyAny>,
        at: &At,
    ) -> PyResult<Vec<Self>> {
        match *array.shape() {
            [count] => {
                let mut rows = room(count, at)?;
                rows.extend(array.as_array().iter().copied());
                Ok(rows)
            }
            _ => Err(refuse(value, at, "an array of one axis")),
        }
    }
}

impl<T: Copy> Row<T> for [T; 3] {
    fn rows(
        array: &PyReadonlyArrayDyn<'_, T>,
        value: &Bound<'_, PyAny>,
        at: &At,
    ) -> PyResult<Vec<Self>>
    where
        T: numpy::Element,
    {
        let [count, 3] = *array.shape() else {
            return Err(refuse(value, at, "an array of shape (n, 3)"));
        };
        let view = array.as_array();
        let mut rows = room(count, at)?;
        rows.extend((0..count).map(|i| std::array::from_fn(|k| view[[i, k]])));
        Ok(rows)
    }
}

/// An empty list with room for this many; a MemoryError if they do not fit in memory.
fn room<T>(count: usize, at: &At) -> PyResult<Vec<T>> {
    let mut rows = Vec::new();
    rows.try_reserve_exact(count).map_err(|_| no_room(at, count))?;
    Ok(rows)
}

fn no_room(at: &At, count: usize) -> PyErr {
    PyMemoryError::new_err(format!("{at}: the memory has no room for {count} entries"))
}

impl<T: Read, const N: usize> Read for [T; N] {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        let items = Vec::<T>::read(value, at)?;
        items.try_into().map_err(|_| refuse(value, at, &format!("{N} values")))
    }
}

/// A dict whose keys are exactly the fields of a record.
pub struct Record<'a, 'py> {
    dict: Bound<'py, PyDict>,
    at: &'a At<'a>,
}

impl<'a, 'py> Record<'a, 'py> {
    pub fn new(value: &Bound<'py, PyAny>, at: &'a At<'a>, fields: &[&str]) -> PyResult<Self> {
        let dict = value.cast::<PyDict>().map_err(|_| refuse(value, at, "a dict"))?.clone();
        for key in dict.keys() {
            let name = String::read(&key, &at.field("key"))?;
            if !fields.contains(&name.as_str()) {
                let place = at.field(&name);
                return Err(PyValueError::new_err(format!(
                    "{place}: no such field{}",
                    nearest(&name, fields)
                )));
            }
        }
        Ok(Self { dict, at })
    }

    pub fn field<T: Read>(&self, name: &str) -> PyResult<T> {
        let at = self.at.field(name);
        match self.dict.get_item(name)? {
            Some(value) => T::read(&value, &at),
            None => Err(PyValueError::new_err(format!("{at}: missing"))),
        }
    }
}

/// Reads a record from a dict with one key for each field.
macro_rules! record {
    ($type:ty { $($field:ident),+ $(,)? }) => {
        impl $crate::extract::Read for $type {
            fn read(value: &pyo3::Bound<'_, pyo3::PyAny>, at: &$crate::extract::At) -> pyo3::PyResult<Self> {
                let record = $crate::extract::Record::new(value, at, &[$(stringify!($field)),+])?;
                Ok(Self { $($field: record.field(stringify!($field))?),+ })
            }
        }
    };
}
pub(crate) use record;
