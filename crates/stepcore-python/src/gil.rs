//! The one place where the GIL is released, interrupts are served and panics stop.

use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::time::{Duration, Instant};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use stepcore::error::Error;

use crate::errors::Raised;

/// How long Python may wait for a Ctrl-C to be seen.
const PATIENCE: Duration = Duration::from_millis(20);

/// Runs engine code without the GIL.
pub fn release<T: Send>(
    py: Python<'_>,
    run: impl FnOnce() -> Result<T, Error> + Send,
) -> PyResult<T> {
    match py.detach(|| catch_unwind(AssertUnwindSafe(run))) {
        Ok(outcome) => outcome.raised(py),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
            Err(PyRuntimeError::new_err(format!(
                "an error inside stepcore, please report it: {text}"
            )))
        }
    }
}

/// The engine's side of an object, for one thread at a time. It can be used again after a
/// panic: positions, velocities and inputs are put in anew before each use.
pub fn lock<'a, T>(engine: &'a Mutex<T>, object: &str) -> PyResult<MutexGuard<'a, T>> {
    match engine.try_lock() {
        Ok(guard) => Ok(guard),
        Err(TryLockError::Poisoned(guard)) => Ok(guard.into_inner()),
        Err(TryLockError::WouldBlock) => {
            Err(PyRuntimeError::new_err(format!("this {object} is busy in another thread")))
        }
    }
}

/// Does `n` steps in portions, and serves Python's signals between them.
pub fn steps(
    py: Python<'_>,
    n: u64,
    advance: impl FnMut(u64) -> Result<(), Error> + Send,
) -> PyResult<()> {
    steps_told(py, n, None, advance)
}

/// The same; `told` is called with the count of each portion. What it raises ends the call.
pub fn steps_told(
    py: Python<'_>,
    n: u64,
    told: Option<&Bound<'_, PyAny>>,
    mut advance: impl FnMut(u64) -> Result<(), Error> + Send,
) -> PyResult<()> {
    if n <= 1 && told.is_none() {
        // One step is short: nothing to interrupt, nothing to measure.
        return release(py, || advance(n));
    }
    let (mut left, mut portion) = (n, 1);
    while left > 0 {
        let now = portion.min(left);
        let start = Instant::now();
        release(py, || advance(now))?;
        left -= now;
        let took = start.elapsed();
        if took < PATIENCE / 4 {
            portion = now * 2;
        } else if took > PATIENCE {
            portion = (now / 2).max(1);
        }
        py.check_signals()?;
        if let Some(told) = told {
            told.call1((now,))?;
        }
    }
    Ok(())
}
