//! One map from the engine's errors to Python's.

use std::ffi::CString;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use pyo3::exceptions::{
    PyBaseException, PyKeyboardInterrupt, PyRuntimeError, PyRuntimeWarning, PyUserWarning,
    PyValueError,
};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use pyo3::PyTypeInfo;
use stepcore::arrays::{Array, Given};
use stepcore::elements::{Mention, Named};
use stepcore::error::{Divergence, Error, Fault};
use stepcore::post_mortem::{Held, PostMortem, Stable};
use stepcore::settings::Settings;

use crate::element::id;
use crate::gil::with_python;
use crate::memo::Memo;
use crate::snapshot::encode;

pyo3::create_exception!(
    stepcore,
    SimulationError,
    PyRuntimeError,
    "The motion stopped being finite, or (with the setting ledger) has more energy than it can have.\n\
     The last finite state is kept. The text is the post-mortem, one paragraph.\n\n\
     step: steps done before it; time: of that state [s]; world: its index in a Batch (0 in a Sim);\n\
     gained: True for energy that cannot have been gained, False for what is not finite, or faster\n\
     than anything moves;\n\
     element: the name of the element that injected the most energy; element_id: the same element\n\
     as (kind, index, part), or None; shares: each element's share of the energy injected over the\n\
     last steps, by name; share_ids: the (kind, index, part) of each; growth: rate at which the\n\
     energy grew [1/s], or None; stable_dt: a step that would have been stable [s], or None;\n\
     replay: a `stepcore.Replay` of the failure."
);

pyo3::create_exception!(
    stepcore,
    EnergyWarning,
    PyUserWarning,
    "Without the setting ledger: a world has far more energy than its scene can have gained, or is\n\
     faster than anything moves.\n\n\
     The text says by which step, which element it came from and which dt would have been stable.\n\
     The run goes on. It is said once a Sim or Batch, whose energies are not looked at after that."
);

/// Issues a warning of type `W` to the Python caller of `step`.
pub fn warn<W: PyTypeInfo>(py: Python<'_>, text: &str) -> PyResult<()> {
    let text = CString::new(printable(text)).unwrap_or_default();
    PyErr::warn(py, &py.get_type::<W>(), &text, 2)
}

/// The duration above which a call gives the reason.
const SLOW: Duration = Duration::from_secs(1);

/// Whether the reason for slow adaptive steps was given: it is given once.
pub struct Slow(AtomicBool);

/// A call, whose steps may be slow.
pub struct SlowCall<'a> {
    said: &'a AtomicBool,
    /// The clock is not read if there will be no warning.
    begun: Option<Instant>,
    raised: Option<PyErr>,
}

impl Slow {
    /// With steps of a fixed length there is no warning.
    pub fn under(settings: &Settings) -> Self {
        Self(AtomicBool::new(settings.accuracy.0.is_none()))
    }

    pub fn begin(&self) -> SlowCall<'_> {
        let begun = (!self.0.load(Ordering::Relaxed)).then(Instant::now);
        SlowCall { said: &self.0, begun, raised: None }
    }

    /// Turns the warning off: no reader could choose other steps.
    pub fn keep_quiet(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl SlowCall<'_> {
    /// Records that some of its steps are done; `why`: the reason why they are slow, if known.
    pub fn portion(&mut self, why: impl FnOnce() -> Option<String>) {
        let early = self.begun.is_none_or(|begun| begun.elapsed() < SLOW);
        if early || self.said.load(Ordering::Relaxed) {
            return;
        }
        if let Some(text) = why() {
            self.said.store(true, Ordering::Relaxed);
            self.raised = with_python(|py| warn::<PyRuntimeWarning>(py, &text)).err();
        }
    }

    /// The result of the call, or of the warning.
    pub fn end(self, outcome: PyResult<()>) -> PyResult<()> {
        self.raised.map_or(outcome, Err)
    }
}

/// Raises the engine's errors in Python.
pub trait Raised<T> {
    fn raised(self, py: Python<'_>) -> PyResult<T>;
}

impl<T> Raised<T> for Result<T, Error> {
    fn raised(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|error| raise(py, error))
    }
}

/// A text that is safe in a terminal: names of a scene can hold commands to terminals, and
/// characters that turn the direction of writing.
pub fn printable(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\u{061c}'
            | '\u{200e}'
            | '\u{200f}'
            | '\u{2028}'..='\u{202e}'
            | '\u{2066}'..='\u{2069}' => {
                shown.push_str(&format!("\\u{:04x}", u32::from(c)));
            }
            _ if c.is_control() => shown.push_str(&format!("\\x{:02x}", u32::from(c))),
            _ => shown.push(c),
        }
    }
    shown
}

/// The Python exception of an engine error.
pub fn raise(py: Python<'_>, error: Error) -> PyErr {
    let raw = error.to_string();
    let text = printable(&raw);
    match error {
        Error::Value { .. } | Error::Scene(_) => {
            let raised = PyValueError::new_err(text);
            let mentions: Vec<_> = error.mentions().iter().map(|m| mention(&raw, m)).collect();
            if mentions.is_empty() {
                return raised;
            }
            let attribute = raised.value(py).setattr("mentions", mentions);
            attribute.err().unwrap_or(raised)
        }
        // By the code that interrupted it: see `gil::release`.
        Error::Interrupted => PyKeyboardInterrupt::new_err(()),
        Error::Diverged(divergence) => {
            let raised = SimulationError::new_err(text);
            let attached = attach(raised.value(py), &divergence);
            attached.err().unwrap_or(raised)
        }
    }
}

/// `SimulationError.element` if no element stands out.
const NONE: &str = "no single element";

/// The place of an element in a text, in characters, and its kind and index.
fn mention(text: &str, mention: &Mention) -> (usize, usize, &'static str, u64) {
    let count = |bytes: usize| text.get(..bytes).map_or(0, |head| printable(head).chars().count());
    let (kind, index, _) = id(mention.element);
    (count(mention.at.start), count(mention.at.end), kind, index)
}

/// Attaches the data on a step that could not be committed as attributes.
fn attach(error: &Bound<'_, PyBaseException>, divergence: &Divergence) -> PyResult<()> {
    error.setattr("step", divergence.step)?;
    error.setattr("time", divergence.time)?;
    error.setattr("world", divergence.world)?;
    error.setattr("gained", matches!(divergence.fault, Fault::Energy { .. }))?;
    // The state itself is impossible, and not the step after it.
    let finite = matches!(divergence.fault, Fault::Energy { .. } | Fault::Beyond { .. });
    error.setattr("_finite", finite)?;
    let stopped = match &divergence.fault {
        Fault::Far { body, .. } => Some(Some(body)),
        Fault::Evaluations => Some(None),
        _ => None,
    };
    if let Some(element) = stopped {
        error.setattr("shares", PyDict::new(error.py()))?;
        error.setattr("share_ids", Vec::<u32>::new())?;
        for unknown in ["growth", "stable_dt"] {
            error.setattr(unknown, error.py().None())?;
        }
        return attach_element(error, element);
    }
    divergence.post.as_ref().map_or(Ok(()), |post| attach_post_mortem(error, post))
}

fn attach_element(error: &Bound<'_, PyBaseException>, element: Option<&Named>) -> PyResult<()> {
    error.setattr("element_id", element.map(|named| id(named.element)))?;
    let name = element.map_or_else(|| NONE.to_owned(), |named| printable(&named.name));
    error.setattr("element", name)
}

/// Attaches the findings of a post-mortem, and the state from which its failure recurs.
fn attach_post_mortem(error: &Bound<'_, PyBaseException>, post: &PostMortem) -> PyResult<()> {
    let py = error.py();
    attach_element(error, post.element.as_ref())?;
    let shares = PyDict::new(py);
    for (named, share) in &post.shares {
        shares.set_item(printable(&named.name), share)?;
    }
    error.setattr("shares", shares)?;
    let ids: Vec<_> = post.shares.iter().map(|(named, _)| id(named.element)).collect();
    error.setattr("share_ids", ids)?;
    error.setattr("growth", post.growth.map(|growth| growth / post.dt))?;
    let stable = match post.stable {
        Stable::Springs { dt, .. } | Stable::Halved { dt } => Some(dt),
        Stable::Unknown | Stable::Never { .. } | Stable::AfterStages { .. } | Stable::NotFound => {
            None
        }
    };
    error.setattr("stable_dt", stable)?;
    let (start, inputs) = (&post.start, &post.inputs);
    let memo = Memo {
        start: start.time,
        steps: start.steps,
        warm: start.warm.clone(),
        sleep: start.sleep.clone(),
    };
    let given = Given::new(|array| match array {
        Array::Qpos => &start.qpos,
        Array::Qvel => &start.qvel,
        Array::Act => &start.act,
        Array::CtrlHistory => &start.ctrl_history,
        Array::Ctrl => &inputs.ctrl,
        Array::QfrcApplied => &inputs.qfrc_applied,
        Array::XfrcApplied => &inputs.xfrc_applied,
        Array::EqActive => &inputs.eq_active,
        Array::MocapPos => &inputs.mocap_pos,
        Array::MocapQuat => &inputs.mocap_quat,
    });
    error.setattr("_start", PyBytes::new(py, &encode(post.dt, &memo, None, &given)))?;
    let change = |(step, inputs): &(u64, Held)| {
        let Held { ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat } =
            inputs.clone();
        (*step, ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat)
    };
    let changes: Vec<_> = post.changes.iter().map(change).collect();
    error.setattr("_changes", changes)?;
    error.setattr("_steps", post.steps)
}
