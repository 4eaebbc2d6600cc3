//! Operations of a batch on each of its worlds: its arrays in and out, and readings one at a time.

use std::panic::resume_unwind;
use std::sync::atomic::Ordering;
use std::sync::{Arc, MutexGuard};

use pyo3::prelude::*;
use stepcore::arrays::{Given, Givens};
use stepcore::error::Error;
use stepcore::model::Model;
use stepcore::settings::Settings;

use super::{Array, Batch};
use crate::errors::{warn, EnergyWarning, Raised};
use crate::gil;
use crate::model::result;
use crate::world::{world, Placed, World};
use crate::worlds::Worlds;

/// The number of worlds that justifies a thread to read them.
const WORTH_A_THREAD: usize = 16;

impl Batch {
    pub(super) fn lock(&self) -> PyResult<MutexGuard<'_, Box<dyn Worlds>>> {
        gil::lock(&self.worlds, "Batch")
    }

    /// The worlds that failed while the others continued.
    pub(super) fn failed(&self) -> PyResult<Vec<usize>> {
        let guard = self.lock()?;
        Ok((0..self.arrays.worlds).filter(|world| guard.failed(*world).is_some()).collect())
    }

    /// Issues the pending warning about energies, once.
    pub(super) fn warn(&self, py: Python<'_>, worlds: &mut dyn Worlds) -> PyResult<()> {
        let Some(text) = worlds.take_warning() else { return Ok(()) };
        self.how.unwatched.store(true, Ordering::Relaxed);
        warn::<EnergyWarning>(py, &text)
    }

    /// Refuses arrays with which a world cannot be stepped; reports the first world.
    pub(super) fn check(&self, py: Python<'_>, worlds: &dyn Worlds) -> PyResult<()> {
        let n = self.arrays.worlds;
        self.arrays
            .read_all(py, |all| (0..n).try_for_each(|world| worlds.check(world, &all.of(world))))
            .raised(py)
    }

    /// Checks all arrays, then copies them into the engine.
    pub(super) fn load(&self, py: Python<'_>, worlds: &mut dyn Worlds) -> PyResult<()> {
        self.arrays.read_all(py, |all| worlds.load(all)).raised(py)
    }

    pub(super) fn store(&self, py: Python<'_>, worlds: &dyn Worlds) {
        self.arrays.store(py, |array, numbers| worlds.store(array, numbers));
    }

    /// Reads each world's present state, which is checked.
    pub(super) fn present<T: Send>(
        &self,
        py: Python<'_>,
        read: impl Fn(&mut dyn World, usize, &Given) -> Result<T, Error> + Sync,
    ) -> PyResult<Vec<T>> {
        let guard = self.lock()?;
        let worlds = &**guard;
        self.readings(py, worlds, |reader, world, given| {
            worlds.check(world, given)?;
            read(reader, world, given)
        })
    }

    /// The same for quantities of positions, velocities and inputs alone.
    pub(super) fn placed<'py>(&self, py: Python<'py>, what: Placed) -> PyResult<Array<'py>> {
        let all = self.present(py, |reader, _, given| reader.placed(given, what))?;
        result(py, all.concat(), &self.shape(&what.shape(&self.model)))
    }

    /// Repeats each world's last solve, to read quantities that a batch does not keep; and sees its
    /// arrays, for worlds without a solve yet.
    pub(super) fn again<T: Send>(
        &self,
        py: Python<'_>,
        read: impl Fn(&mut dyn World, &Given) -> Result<T, Error> + Sync,
    ) -> PyResult<Vec<T>> {
        let guard = self.lock()?;
        let worlds = &**guard;
        self.readings(py, worlds, |reader, world, given| {
            worlds.again(world, reader)?;
            read(reader, given)
        })
    }

    /// The same for quantities that a world reads by solving there itself.
    pub(super) fn before<T: Send>(
        &self,
        py: Python<'_>,
        read: impl Fn(&mut dyn World, &Given) -> Result<T, Error> + Sync,
    ) -> PyResult<Vec<T>> {
        let guard = self.lock()?;
        let worlds = &**guard;
        self.readings(py, worlds, |reader, world, given| {
            worlds.before(world, reader)?;
            read(reader, given)
        })
    }

    /// Numbers of each world's last solve; `shape`: the shape for one world.
    pub(super) fn solved<'py>(
        &self,
        py: Python<'py>,
        shape: &[usize],
        read: impl Fn(&mut dyn World, &Given) -> Result<Vec<f64>, Error> + Sync,
    ) -> PyResult<Array<'py>> {
        result(py, self.again(py, read)?.concat(), &self.shape(shape))
    }

    /// Reads each world by itself, over the batch's threads.
    fn readings<T: Send>(
        &self,
        py: Python<'_>,
        worlds: &dyn Worlds,
        read: impl Fn(&mut dyn World, usize, &Given) -> Result<T, Error> + Sync,
    ) -> PyResult<Vec<T>> {
        let order = worlds.by_model();
        let threads = self.how.threads.min(order.len() / WORTH_A_THREAD).max(1);
        let some = |own: &[usize], all: &Givens| {
            let mut reader = Reader { settings: &self.settings, held: None };
            let one = |world: &usize| {
                let reader = reader.of(worlds.model(*world))?;
                Ok((*world, read(reader, *world, &all.of(*world))?))
            };
            own.iter().map(one).collect::<Result<Vec<_>, Error>>()
        };
        let found = self.arrays.read_all(py, |all| shared(order, threads, |own| some(own, all)));
        let mut found = found.raised(py)?;
        found.sort_by_key(|(world, _)| *world);
        Ok(found.into_iter().map(|(_, value)| value).collect())
    }

    /// The shape for all worlds, given the shape for one.
    pub(super) fn shape(&self, one: &[usize]) -> Vec<usize> {
        [&[self.arrays.worlds], one].concat()
    }
}

/// A world for reading, as long as the worlds have one model.
struct Reader<'a> {
    settings: &'a Settings,
    held: Option<(Arc<Model>, Box<dyn World>)>,
}

impl Reader<'_> {
    fn of(&mut self, model: &Arc<Model>) -> Result<&mut dyn World, Error> {
        let held = self.held.take().filter(|(held, _)| Arc::ptr_eq(held, model));
        let held = match held {
            Some(held) => held,
            None => (model.clone(), world(model.clone(), self.settings)?),
        };
        Ok(&mut *self.held.insert(held).1)
    }
}

/// Does `work` on equal shares of a list, over threads; the first error in the order of the shares.
fn shared<T: Send>(
    list: &[usize],
    threads: usize,
    work: impl Fn(&[usize]) -> Result<Vec<T>, Error> + Sync,
) -> Result<Vec<T>, Error> {
    if threads == 1 {
        return work(list);
    }
    let work = &work;
    std::thread::scope(|scope| {
        let shares = list.chunks(list.len().div_ceil(threads));
        let started: Vec<_> = shares.map(|share| scope.spawn(move || work(share))).collect();
        let mut all = Vec::with_capacity(list.len());
        for thread in started {
            all.extend(thread.join().unwrap_or_else(|panic| resume_unwind(panic))?);
        }
        Ok(all)
    })
}
