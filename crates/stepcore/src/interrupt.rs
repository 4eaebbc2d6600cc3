//! Interruption of long computations: loops that may take long check for it now and then.
//!
//! An interrupted computation is unwound up to `caught`, without the message of a panic (salsa
//! cancels queries in the same way), so that loops deep inside need no return path. Incomplete data
//! are dropped: a model that is being compiled, and the working space of a `Sim` (`Sim::whole`).

use std::any::Any;
use std::cell::Cell;
use std::panic::{catch_unwind, resume_unwind, AssertUnwindSafe};

use crate::error::{Error, Result};

thread_local! {
    static ASK: Cell<Option<fn() -> bool>> = const { Cell::new(None) };
}

/// The payload that unwinds a computation.
struct Interruption;

/// Runs `work`, which calls `ask` now and then, in this thread, to check for an interruption.
pub fn while_asking<T>(ask: fn() -> bool, work: impl FnOnce() -> Result<T>) -> Result<T> {
    /// Restores the previous check, after a panic too.
    struct Before(Option<fn() -> bool>);
    impl Drop for Before {
        fn drop(&mut self) {
            ASK.set(self.0);
        }
    }
    let _before = Before(ASK.replace(Some(ask)));
    caught(work)
}

/// Runs `work` without interruption: it repairs what an interruption has left incomplete.
pub(crate) fn unasked<T>(work: impl FnOnce() -> T) -> T {
    let before = ASK.take();
    let result = work();
    ASK.set(before);
    result
}

/// Runs `work`; returns `Error::Interrupted` if it was unwound.
pub(crate) fn caught<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(ended)
}

#[cold]
fn ended<T>(panic: Box<dyn Any + Send>) -> Result<T> {
    if panic.is::<Interruption>() {
        return Err(Error::Interrupted);
    }
    resume_unwind(panic)
}

/// Uses this check for later computations of this thread.
pub(crate) fn ask(ask: fn() -> bool) {
    ASK.set(Some(ask));
}

/// Returns whether the computation should end.
pub(crate) fn asked() -> bool {
    ASK.get().is_some_and(|ask| ask())
}

/// Unwind the computation if it should end. The check takes less than 100 ns.
#[cold]
#[inline(never)]
pub(crate) fn checkpoint() {
    if asked() {
        resume_unwind(Box::new(Interruption));
    }
}

/// Work between two checks, in units of some nanoseconds: below a millisecond, and a thousand times
/// the cost of a check.
const MUCH: usize = 1 << 14;

/// Work of a row in a sweep, an exact test of two shapes, and a part of an adaptive step: the least
/// of each, as the unit is rough.
pub(crate) const ROW: usize = 16;
pub(crate) const TEST: usize = 64;
pub(crate) const STRETCH: usize = 1024;

/// Counts the work of a loop, and checks for an interruption now and then.
#[derive(Default)]
pub(crate) struct Meter(usize);

impl Meter {
    /// Adds this much work, finished or next, in units of some nanoseconds.
    #[inline(always)]
    pub fn count(&mut self, work: usize) {
        self.0 += work;
        if self.0 >= MUCH {
            self.0 = 0;
            checkpoint();
        }
    }
}
