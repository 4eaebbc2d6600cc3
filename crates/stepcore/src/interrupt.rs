//! Interrupts of long computations: loops that may take long check for one now and then.
//!
//! An interrupted computation is unwound up to `caught`, without the message of a panic (salsa
//! cancels queries in the same way), so that inner loops need no way to return. Half-made results
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

/// Runs `work`, which calls `ask` now and then, in this thread, to learn whether to end.
pub fn while_asking<T>(ask: fn() -> bool, work: impl FnOnce() -> Result<T>) -> Result<T> {
    /// Restores the previous function, after a panic too.
    struct Before(Option<fn() -> bool>);
    impl Drop for Before {
        fn drop(&mut self) {
            ASK.set(self.0);
        }
    }
    let _before = Before(ASK.replace(Some(ask)));
    caught(work)
}

/// Runs `work`; `Error::Interrupted` if it was unwound.
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

/// Sets the function that computations of this thread call from now on.
pub(crate) fn ask(ask: fn() -> bool) {
    ASK.set(Some(ask));
}

/// Whether the computation is to end.
pub(crate) fn asked() -> bool {
    ASK.get().is_some_and(|ask| ask())
}

/// Unwinds the computation if it is to end. The check takes less than 100 ns.
#[cold]
#[inline(never)]
pub(crate) fn checkpoint() {
    if asked() {
        resume_unwind(Box::new(Interruption));
    }
}

/// Work between two checks, in units of some nanoseconds: below a millisecond, and a thousand times
/// the duration of a check.
const MUCH: usize = 1 << 14;

/// Work of a row that is swept, an exact test of two shapes, and a part of an adaptive step: the
/// least of each, as the unit is rough.
pub(crate) const ROW: usize = 16;
pub(crate) const TEST: usize = 64;
pub(crate) const STRETCH: usize = 1024;

/// Counts the work of a loop, and checks now and then.
#[derive(Default)]
pub(crate) struct Meter(usize);

impl Meter {
    /// Counts this much work, in units of some nanoseconds, done or about to be.
    #[inline(always)]
    pub fn count(&mut self, work: usize) {
        self.0 += work;
        if self.0 >= MUCH {
            self.0 = 0;
            checkpoint();
        }
    }
}
