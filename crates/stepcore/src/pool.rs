//! Threads that share the work of one world. Between two jobs they wait and allocate nothing: first
//! awake for a moment, as the stages of a step follow one another closely and waking costs as long
//! as hundreds of rows, then asleep.
//!
//! Work is divided into parts that depend on the world alone, and results are combined in the order
//! of the parts: the number of threads and their share of the parts change no bit.

use crate::error::{Error, Result};
use crate::interrupt::{ask, asked};
use crate::room::Room;
use std::any::Any;
use std::cell::RefCell;
use std::hint::spin_loop;
use std::panic::{catch_unwind, resume_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The largest number of threads.
pub(crate) const MOST_THREADS: usize = 1024;
/// The number of contacts or near pairs below which waking threads costs more than it saves.
pub(crate) const WORTH_SHARING: usize = 1024;
/// The same for rows to be solved.
pub(crate) const ROWS_WORTH_SHARING: usize = 4 * WORTH_SHARING;
/// The time for which the caller waits for the other threads before it checks for an interruption.
const ASLEEP: Duration = Duration::from_millis(20);
/// The time for which a thread waits awake for more work, or for the others to finish.
const AWAKE: Duration = Duration::from_micros(50);

/// Reject an invalid number of threads.
pub(crate) fn check_threads(threads: usize) -> Result<()> {
    if (1..=MOST_THREADS).contains(&threads) {
        return Ok(());
    }
    Err(Error::value("threads", threads, format!("from 1 to {MOST_THREADS}")))
}

/// The function of each part, called with its number.
type Work<'a> = &'a (dyn Fn(usize) + Sync);

/// Threads in addition to the owner's.
pub(crate) struct Pool {
    threads: usize,
    /// The process that has the threads: a process forked from it has none, and possibly a lock
    /// that is never released.
    process: u32,
    shared: Arc<Shared>,
}

thread_local! {
    /// The pool that this thread serves.
    static SERVES: RefCell<Option<Arc<Shared>>> = const { RefCell::new(None) };
}

/// The data that the threads share.
struct Shared {
    state: Mutex<State>,
    begin: Condvar,
    end: Condvar,
    /// The next part that no thread has started.
    next: AtomicUsize,
    /// The number of jobs, including the final stop; each has its parts.
    round: AtomicU64,
    /// Threads that work on the current job.
    busy: AtomicUsize,
    /// Whether the current job should end: the check for the threads, as the caller has its check.
    ended: AtomicBool,
}

/// `round` and `busy` change only while it is locked: a sleeping thread misses no change.
#[derive(Default)]
struct State {
    work: Option<(Work<'static>, usize)>,
    /// The number of sleeping threads.
    asleep: usize,
    stop: bool,
    panic: Option<Box<dyn Any + Send>>,
}

/// Lock data that no panic can leave inconsistent.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the contents of a lock that nothing else can hold.
pub(crate) fn inside<T>(mutex: &mut Mutex<T>) -> &mut T {
    mutex.get_mut().unwrap_or_else(PoisonError::into_inner)
}

impl<T: Room> Room for Mutex<T> {
    fn room(&self) -> usize {
        lock(self).room()
    }
}

impl Pool {
    /// None for one thread, which is the caller's.
    pub fn new(threads: usize) -> Result<Option<Arc<Self>>> {
        check_threads(threads)?;
        if threads == 1 {
            return Ok(None);
        }
        let shared = Arc::new(Shared {
            state: Mutex::default(),
            begin: Condvar::new(),
            end: Condvar::new(),
            next: AtomicUsize::new(0),
            round: AtomicU64::new(0),
            busy: AtomicUsize::new(0),
            ended: AtomicBool::new(false),
        });
        // Threads that have started stop when it is dropped.
        let pool = Self { threads, process: std::process::id(), shared };
        for _ in 1..threads {
            let shared = pool.shared.clone();
            let started = std::thread::Builder::new().spawn(move || shared.serve());
            started.map_err(|error| {
                let limit = format!("no more than the system starts ({error})");
                Error::value("threads", threads, limit)
            })?;
        }
        Ok(Some(Arc::new(pool)))
    }

    /// Returns the number of threads, including the caller's.
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// Does the work on every part from 0 to `parts`, and returns when all are done. One caller at a
    /// time.
    pub fn share(&self, parts: usize, work: Work) {
        if self.process != std::process::id() {
            return (0..parts).for_each(work);
        }
        // SAFETY: threads use the reference only while they count among the busy, and start to
        // count only while `state.work` holds it; this function returns, or continues with a panic,
        // only after it has cleared `state.work` and no thread is busy any more.
        let work = unsafe { std::mem::transmute::<Work<'_>, Work<'static>>(work) };
        let shared = &*self.shared;
        let mut state = lock(&shared.state);
        assert!(state.work.is_none(), "a pool has one caller at a time");
        shared.next.store(0, Ordering::Relaxed);
        shared.ended.store(false, Ordering::Relaxed);
        state.work = Some((work, parts));
        shared.round.fetch_add(1, Ordering::Release);
        let asleep = state.asleep > 0;
        drop(state);
        if asleep {
            shared.begin.notify_all();
        }
        let own = catch_unwind(AssertUnwindSafe(|| shared.take_parts(work, parts)));
        // Threads that arrive from now on find no work.
        lock(&shared.state).work = None;
        awake_until(|| shared.busy.load(Ordering::Acquire) == 0);
        let mut state = lock(&shared.state);
        while shared.busy.load(Ordering::Acquire) > 0 {
            shared.ended.fetch_or(asked(), Ordering::Relaxed);
            let waited = shared.end.wait_timeout(state, ASLEEP);
            (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        }
        let other = state.panic.take();
        drop(state);
        if let Some(panic) = own.err().or(other) {
            resume_unwind(panic);
        }
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        if self.process != std::process::id() {
            return;
        }
        // No thread is busy, and no caller waits for the threads.
        lock(&self.shared.state).stop = true;
        self.shared.round.fetch_add(1, Ordering::Release);
        self.shared.begin.notify_all();
    }
}

impl Shared {
    fn take_parts(&self, work: Work, parts: usize) {
        loop {
            let part = self.next.fetch_add(1, Ordering::Relaxed);
            if part >= parts {
                return;
            }
            work(part);
        }
    }

    /// The main loop of a thread.
    fn serve(self: &Arc<Self>) {
        SERVES.set(Some(self.clone()));
        ask(|| SERVES.with_borrow(|own| own.iter().any(|own| own.ended.load(Ordering::Relaxed))));
        let mut seen = 0;
        loop {
            let fresh = || self.round.load(Ordering::Acquire) != seen;
            awake_until(fresh);
            let mut state = lock(&self.state);
            while !fresh() {
                state.asleep += 1;
                state = self.begin.wait(state).unwrap_or_else(PoisonError::into_inner);
                state.asleep -= 1;
            }
            seen = self.round.load(Ordering::Acquire);
            if state.stop {
                return;
            }
            let Some((work, parts)) = state.work else { continue };
            self.busy.fetch_add(1, Ordering::Release);
            drop(state);
            let done = catch_unwind(AssertUnwindSafe(|| self.take_parts(work, parts)));
            let mut state = lock(&self.state);
            if let Err(panic) = done {
                state.panic.get_or_insert(panic);
            }
            if self.busy.fetch_sub(1, Ordering::Release) == 1 {
                self.end.notify_one();
            }
        }
    }
}

/// Waits awake, for no longer than `AWAKE`.
fn awake_until(holds: impl Fn() -> bool) {
    if holds() {
        return;
    }
    let start = Instant::now();
    while start.elapsed() < AWAKE {
        for _ in 0..16 {
            if holds() {
                return;
            }
            spin_loop();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interrupt::{checkpoint, while_asking};

    /// Every part is done once, by any thread.
    #[test]
    fn every_part_is_done_once() {
        for threads in [2, 3, 7] {
            let pool = Pool::new(threads).unwrap().unwrap();
            let counts: Vec<AtomicUsize> = (0..100).map(|_| AtomicUsize::new(0)).collect();
            for parts in [0, 1, 5, 100, 3] {
                pool.share(parts, &|part| {
                    counts[part].fetch_add(1, Ordering::Relaxed);
                });
            }
            for (part, count) in counts.iter().enumerate() {
                let want = [1, 5, 100, 3].iter().filter(|parts| part < **parts).count();
                assert_eq!(count.load(Ordering::Relaxed), want, "part {part}");
            }
        }
    }

    /// A panic reaches the caller, and the pool remains usable.
    #[test]
    fn a_panic_reaches_the_caller() {
        let pool = Pool::new(3).unwrap().unwrap();
        let work = |part: usize| assert!(part != 7, "part 7");
        let caught = catch_unwind(AssertUnwindSafe(|| pool.share(20, &work)));
        assert!(caught.is_err());
        let sum = AtomicUsize::new(0);
        pool.share(20, &|part| {
            sum.fetch_add(part, Ordering::Relaxed);
        });
        assert_eq!(sum.load(Ordering::Relaxed), 190);
    }

    /// The caller's check for an interruption covers all threads.
    #[test]
    fn an_interrupt_ends_the_parts_of_all_threads() {
        let pool = Pool::new(3).unwrap().unwrap();
        let work = |_| loop {
            checkpoint();
        };
        for _ in 0..3 {
            let outcome = while_asking(
                || true,
                || {
                    pool.share(20, &work);
                    Ok(())
                },
            );
            assert_eq!(outcome, Err(Error::Interrupted));
        }
    }

    #[test]
    fn one_thread_is_the_callers() {
        assert!(Pool::new(1).unwrap().is_none());
        for bad in [0, MOST_THREADS + 1] {
            let text = Pool::new(bad).err().map(|error| error.to_string()).unwrap_or_default();
            assert!(text.contains("threads") && text.contains("1024"), "{text}");
        }
    }
}
