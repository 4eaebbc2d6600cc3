//! The one place where the GIL is released, interrupts are served and panics stop.

use std::cell::{Cell, RefCell};
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::thread;
use std::time::{Duration, Instant};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use stepcore::error::Error;
use stepcore::interrupt::while_asking;

use crate::errors::Raised;

/// The longest time until Python sees a Ctrl-C.
const PATIENCE: Duration = Duration::from_millis(20);
/// The largest ratio of the lengths of two successive portions of steps.
const GROWTH: u64 = 16;

/// The steps in a portion when a call last ended: the next one starts with this many.
pub struct Pace(AtomicU64);

impl Default for Pace {
    fn default() -> Self {
        Self(AtomicU64::new(1))
    }
}

thread_local! {
    /// When solvers last checked signals, and the exception that a signal raised.
    static ASKED: Cell<Option<Instant>> = const { Cell::new(None) };
    static RAISED: RefCell<Option<PyErr>> = const { RefCell::new(None) };
}

/// Whether a signal is to end a long step: checked as often as between steps.
fn interrupted() -> bool {
    if RAISED.with_borrow(Option::is_some) {
        return true;
    }
    let now = Instant::now();
    let since = ASKED.get().unwrap_or(now);
    if now - since < PATIENCE {
        ASKED.set(Some(since));
        return false;
    }
    ASKED.set(Some(now));
    let raised = with_python(|py| py.check_signals()).err();
    RAISED.with_borrow_mut(|to| *to = raised);
    RAISED.with_borrow(Option::is_some)
}

/// The interpreter is about to end; its thread; the number of threads about to take the GIL.
static ENDING: AtomicBool = AtomicBool::new(false);
static COMING_BACK: AtomicU64 = AtomicU64::new(0);
thread_local! {
    static ENDS: Cell<bool> = const { Cell::new(false) };
}

/// Call before this thread takes the GIL. An ending interpreter kills a thread that requests it,
/// and with Rust on the stack that aborts the program: such a thread waits here until the program
/// ends.
fn come_back() {
    COMING_BACK.fetch_add(1, Ordering::SeqCst);
    if ENDING.load(Ordering::SeqCst) && !ENDS.get() {
        COMING_BACK.fetch_sub(1, Ordering::SeqCst);
        loop {
            thread::park();
        }
    }
}

/// Records that this thread has the GIL again.
fn is_back() {
    COMING_BACK.fetch_sub(1, Ordering::SeqCst);
}

/// Takes the GIL for a moment in a call that has released it.
pub fn with_python<T>(look: impl FnOnce(Python<'_>) -> T) -> T {
    come_back();
    Python::attach(|py| {
        is_back();
        look(py)
    })
}

/// Called by Python when the program ends, while every thread can still take the GIL: lets in the
/// threads that are about to, and none after them.
#[pyfunction]
pub fn end_threads(py: Python<'_>) {
    ENDS.set(true);
    ENDING.store(true, Ordering::SeqCst);
    py.detach(|| {
        while COMING_BACK.load(Ordering::SeqCst) > 0 {
            thread::sleep(Duration::from_micros(100));
        }
    });
}

/// Runs engine code without the GIL. An exception from a signal within a long step ends it, and the
/// step is not committed.
pub fn release<T: Send>(
    py: Python<'_>,
    run: impl FnOnce() -> Result<T, Error> + Send,
) -> PyResult<T> {
    let done = py.detach(|| {
        let done = guard(run);
        come_back();
        done
    });
    is_back();
    finish(py, done)
}

/// Single steps, of which the short ones keep the GIL: releasing it and taking it back takes as
/// long as a small model's step, and no other thread gets far meanwhile.
#[derive(Default)]
pub struct Singles {
    calls: AtomicU64,
    short: AtomicBool,
}

/// A step at least as long as this runs without the GIL: ten times the cost of releasing it.
const SHORT: Duration = Duration::from_micros(10);
/// One call in this many is timed.
const TIMED: u64 = 32;

impl Singles {
    pub fn step(
        &self,
        py: Python<'_>,
        step: impl FnOnce() -> Result<(), Error> + Send,
    ) -> PyResult<()> {
        let calls = self.calls.load(Ordering::Relaxed);
        self.calls.store(calls + 1, Ordering::Relaxed);
        if calls.is_multiple_of(TIMED) {
            let start = Instant::now();
            let outcome = release(py, step);
            self.short.store(start.elapsed() < SHORT, Ordering::Relaxed);
            outcome
        } else if self.short.load(Ordering::Relaxed) {
            finish(py, guard(step))
        } else {
            release(py, step)
        }
    }
}

fn guard<T>(run: impl FnOnce() -> Result<T, Error>) -> thread::Result<Result<T, Error>> {
    catch_unwind(AssertUnwindSafe(|| while_asking(interrupted, run)))
}

fn finish<T>(py: Python<'_>, done: thread::Result<Result<T, Error>>) -> PyResult<T> {
    if let Some(raised) = RAISED.take() {
        return Err(raised);
    }
    match done {
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

/// The engine's side of an object, for one thread at a time. It can be used again after a panic:
/// positions, velocities and inputs are copied in before each use.
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
    steps_told(py, n, &Pace::default(), None, advance)
}

/// The same; `told` is called with the count of each portion. Its exceptions end the call.
pub fn steps_told(
    py: Python<'_>,
    n: u64,
    pace: &Pace,
    told: Option<&Bound<'_, PyAny>>,
    mut advance: impl FnMut(u64) -> Result<(), Error> + Send,
) -> PyResult<()> {
    if n <= 1 && told.is_none() {
        // Nothing to do between steps, nothing to measure.
        return release(py, || advance(n));
    }
    let (mut left, mut portion) = (n, pace.0.load(Ordering::Relaxed));
    while left > 0 {
        let now = portion.min(left);
        let start = Instant::now();
        release(py, || advance(now))?;
        left -= now;
        let most = portion.saturating_mul(GROWTH);
        portion = fitting(now, start.elapsed()).clamp(1, most);
        py.check_signals()?;
        if let Some(told) = told {
            told.call1((now,))?;
        }
    }
    pace.0.store(portion, Ordering::Relaxed);
    Ok(())
}

/// The number of steps that take half of Python's patience, if `steps` took this long.
fn fitting(steps: u64, took: Duration) -> u64 {
    let half = (PATIENCE / 2).as_nanos();
    (u128::from(steps) * half / took.as_nanos().max(1)) as u64
}
