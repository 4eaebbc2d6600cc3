//! What a batch does with each of its worlds: its arrays in and out, and readings of one at a time.

use std::sync::MutexGuard;

use pyo3::prelude::*;
use stepcore::arrays::Given;
use stepcore::error::Error;

use super::{Array, Batch};
use crate::errors::Raised;
use crate::gil;
use crate::model::result;
use crate::world::{world, Placed, World};
use crate::worlds::Worlds;

impl Batch {
    pub(super) fn lock(&self) -> PyResult<MutexGuard<'_, Box<dyn Worlds>>> {
        gil::lock(&self.worlds, "Batch")
    }

    /// Lets `each(world, given)` see every world's arrays in turn.
    pub(super) fn read(
        &self,
        py: Python<'_>,
        mut each: impl FnMut(usize, &Given) -> Result<(), Error> + Send,
    ) -> PyResult<()> {
        let mut worlds = 0..self.arrays.worlds;
        worlds.try_for_each(|world| {
            self.arrays.read(py, world, |given| each(world, given)).raised(py)
        })
    }

    pub(super) fn check(&self, py: Python<'_>, worlds: &dyn Worlds) -> PyResult<()> {
        self.read(py, |world, given| worlds.check(world, given))
    }

    /// Checks all arrays, then copies them into the engine.
    pub(super) fn load(&self, py: Python<'_>, worlds: &mut dyn Worlds) -> PyResult<()> {
        self.check(py, worlds)?;
        self.read(py, |world, given| {
            worlds.put(world, given);
            Ok(())
        })
    }

    pub(super) fn store(&self, py: Python<'_>, worlds: &dyn Worlds) {
        self.arrays.store(py, |world, array, out| worlds.take(world, array, out));
    }

    /// Reads every world's present state in turn.
    pub(super) fn placed<'py>(&self, py: Python<'py>, what: Placed) -> PyResult<Array<'py>> {
        let guard = self.lock()?;
        let worlds = &**guard;
        let mut all = Vec::new();
        let mut reader = world(self.model.clone(), &self.settings).raised(py)?;
        self.read(py, |world, given| {
            worlds.check(world, given)?;
            all.extend(reader.placed(given, what)?);
            Ok(())
        })?;
        result(py, all, &self.shape(&what.shape(&self.model)))
    }

    /// Does every world's last solve again, to read what a batch does not keep of it.
    pub(super) fn again<T: Send>(
        &self,
        py: Python<'_>,
        read: impl Fn(&mut dyn World) -> T + Sync,
    ) -> PyResult<Vec<T>> {
        let guard = self.lock()?;
        let (worlds, model, settings) = (&**guard, self.model.clone(), &self.settings);
        let n = self.arrays.worlds;
        gil::release(py, || {
            let mut reader = world(model, settings)?;
            let each = (0..n).map(|world| {
                worlds.again(world, &mut *reader)?;
                Ok(read(&mut *reader))
            });
            each.collect()
        })
    }

    /// The same of what needs the arrays too, where nothing was solved yet.
    pub(super) fn again_given(
        &self,
        py: Python<'_>,
        mut read: impl FnMut(&mut dyn World, &Given) -> Result<Vec<f64>, Error> + Send,
    ) -> PyResult<Vec<Vec<f64>>> {
        let guard = self.lock()?;
        let worlds = &**guard;
        let mut all = Vec::new();
        let mut reader = world(self.model.clone(), &self.settings).raised(py)?;
        self.read(py, |world, given| {
            worlds.again(world, &mut *reader)?;
            all.push(read(&mut *reader, given)?);
            Ok(())
        })?;
        Ok(all)
    }

    /// Reads every world's last solve in turn; `shape`: that of one world's numbers.
    pub(super) fn solved<'py>(
        &self,
        py: Python<'py>,
        shape: &[usize],
        read: impl FnMut(&mut dyn World, &Given) -> Result<Vec<f64>, Error> + Send,
    ) -> PyResult<Array<'py>> {
        result(py, self.again_given(py, read)?.concat(), &self.shape(shape))
    }

    /// Of all worlds, given that of one.
    fn shape(&self, one: &[usize]) -> Vec<usize> {
        [&[self.arrays.worlds], one].concat()
    }
}
