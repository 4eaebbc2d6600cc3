//! One map from the engine's errors to Python's.

use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use stepcore::error::Error;

pyo3::create_exception!(
    stepcore,
    SimulationError,
    PyRuntimeError,
    "The simulation left the finite numbers; the last finite state is kept.\n\n\
     step: steps done before it, time: of that state [s], world: its index in a Batch (0 in a Sim),\n\
     element: what grew most over the last steps."
);

/// The Python exception of an engine error.
pub fn raise(py: Python<'_>, error: Error) -> PyErr {
    let text = error.to_string();
    match error {
        Error::Value { .. } | Error::Scene(_) => PyValueError::new_err(text),
        Error::Diverged { step, time, world, element, .. } => {
            let raised = SimulationError::new_err(text);
            let value = raised.value(py);
            let attributes = value
                .setattr("step", step)
                .and_then(|()| value.setattr("time", time))
                .and_then(|()| value.setattr("world", world))
                .and_then(|()| value.setattr("element", element));
            attributes.err().unwrap_or(raised)
        }
    }
}

/// "; nearest: a, b" out of the known names, for a name that is not among them.
pub fn nearest(name: &str, known: &[&str]) -> String {
    let mut near: Vec<(usize, &str)> = known
        .iter()
        .map(|other| (edits(name, other), *other))
        .filter(|(distance, other)| distance * 2 <= name.len().max(other.len()))
        .collect();
    near.sort();
    let names: Vec<&str> = near.iter().take(3).map(|(_, name)| *name).collect();
    if names.is_empty() {
        format!("; known: {}", known.join(", "))
    } else {
        format!("; nearest: {}", names.join(", "))
    }
}

/// How many letters to insert, drop or change to get from one name to the other.
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let change = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = change.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}
