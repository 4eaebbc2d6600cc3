//! Whether somebody wants a long computation to end: solvers ask now and then, within a step.

use std::cell::Cell;

thread_local! {
    static ASK: Cell<Option<fn() -> bool>> = const { Cell::new(None) };
}

/// Sweeps, or stretches of a step, between two questions; and iterations of Newton's method.
const SWEEPS: u32 = 256;
const ITERATIONS: u32 = 8;

/// Runs `work`, whose solvers ask `ask` now and then, in this thread, whether to end.
pub fn while_asking<T>(ask: fn() -> bool, work: impl FnOnce() -> T) -> T {
    /// Puts back what was asked before, after a panic too.
    struct Before(Option<fn() -> bool>);
    impl Drop for Before {
        fn drop(&mut self) {
            ASK.set(self.0);
        }
    }
    let _before = Before(ASK.replace(Some(ask)));
    work()
}

/// After this sweep the solver is to end, or the step after this stretch.
#[inline]
pub(crate) fn ends_after(sweep: u32) -> bool {
    sweep % SWEEPS == SWEEPS - 1 && ASK.get().is_some_and(|ask| ask())
}

/// After this iteration Newton's method is to end.
#[inline]
pub(crate) fn ends_after_iteration(iteration: u32) -> bool {
    iteration % ITERATIONS == ITERATIONS - 1 && ASK.get().is_some_and(|ask| ask())
}
