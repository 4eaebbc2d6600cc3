//! Threads that share the work of one world. They wait, and allocate nothing, between one piece of
//! work and the next.
//!
//! Work is cut into parts that depend on the world alone, and what they make is put together in the
//! order of the parts: which thread did which, and how many there are, shows in no bit.

use crate::error::{Error, Result};
use crate::room::Room;
use std::any::Any;
use std::panic::{catch_unwind, resume_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// The most threads that may be asked for.
pub(crate) const MOST_THREADS: usize = 1024;
/// Contacts, pairs or rows below which waking threads costs more than they would save.
pub(crate) const WORTH_SHARING: usize = 256;

/// Refuses a number of threads.
pub(crate) fn check_threads(threads: usize) -> Result<()> {
    if (1..=MOST_THREADS).contains(&threads) {
        return Ok(());
    }
    Err(Error::value("threads", threads, format!("from 1 to {MOST_THREADS}")))
}

/// What is done with each part, by its number.
type Work<'a> = &'a (dyn Fn(usize) + Sync);

/// Threads beside the one that owns it.
pub(crate) struct Pool {
    threads: usize,
    shared: Arc<Shared>,
}

/// What the threads look at.
struct Shared {
    state: Mutex<State>,
    begin: Condvar,
    end: Condvar,
    /// The next part that nobody has begun.
    next: AtomicUsize,
}

#[derive(Default)]
struct State {
    /// Counts the pieces of work; each has its parts.
    round: u64,
    work: Option<(Work<'static>, usize)>,
    /// Threads that have begun the work at hand.
    busy: usize,
    stop: bool,
    panic: Option<Box<dyn Any + Send>>,
}

/// Locks what no panic can leave half done.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What a lock that nobody else can hold is around.
pub(crate) fn inside<T>(mutex: &mut Mutex<T>) -> &mut T {
    mutex.get_mut().unwrap_or_else(PoisonError::into_inner)
}

impl<T: Room> Room for Mutex<T> {
    fn room(&self) -> usize {
        lock(self).room()
    }
}

impl Pool {
    /// None: one thread, which is the caller's.
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
        });
        // Those that have started stop when it is dropped.
        let pool = Self { threads, shared };
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

    /// The caller's thread counts.
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// Does the work on every part from 0 to `parts`, and returns when all are done. One caller at a
    /// time.
    pub fn share(&self, parts: usize, work: Work) {
        // SAFETY: threads use the reference only between counting themselves among the busy, while
        // `state.work` holds it, and leaving these; and this function returns, or goes on with a
        // panic, only after it has taken the work back and nobody is busy any more.
        let work = unsafe { std::mem::transmute::<Work<'_>, Work<'static>>(work) };
        let shared = &*self.shared;
        let mut state = lock(&shared.state);
        assert!(state.work.is_none(), "a pool has one caller at a time");
        shared.next.store(0, Ordering::Relaxed);
        state.round += 1;
        state.work = Some((work, parts));
        drop(state);
        shared.begin.notify_all();
        let own = catch_unwind(AssertUnwindSafe(|| shared.take_parts(work, parts)));
        let mut state = lock(&shared.state);
        // Whoever wakes from now on finds nothing to do.
        state.work = None;
        while state.busy > 0 {
            state = shared.end.wait(state).unwrap_or_else(PoisonError::into_inner);
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
        // Nobody is busy, and nobody waits for the threads: in a forked process there are none.
        lock(&self.shared.state).stop = true;
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

    /// A thread's life.
    fn serve(&self) {
        let mut seen = 0;
        let mut state = lock(&self.state);
        while !state.stop {
            let fresh = std::mem::replace(&mut seen, state.round) != state.round;
            let Some((work, parts)) = state.work.filter(|_| fresh) else {
                state = self.begin.wait(state).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            state.busy += 1;
            drop(state);
            let done = catch_unwind(AssertUnwindSafe(|| self.take_parts(work, parts)));
            state = lock(&self.state);
            state.busy -= 1;
            if let Err(panic) = done {
                state.panic.get_or_insert(panic);
            }
            if state.busy == 0 {
                self.end.notify_one();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every part is done once, whoever does it.
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

    /// A panic reaches the caller, and the pool goes on.
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

    #[test]
    fn one_thread_is_the_callers() {
        assert!(Pool::new(1).unwrap().is_none());
        for bad in [0, MOST_THREADS + 1] {
            let text = Pool::new(bad).err().map(|error| error.to_string()).unwrap_or_default();
            assert!(text.contains("threads") && text.contains("1024"), "{text}");
        }
    }
}
