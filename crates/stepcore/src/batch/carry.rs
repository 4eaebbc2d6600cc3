//! All worlds' arrays in and out, over the threads of the batch.

use std::sync::Mutex;

use super::Batch;
use crate::arrays::{Array, Given};
use crate::error::{Error, Result};
use crate::pool::lock;
use crate::real::Real;

/// The arrays of each world, which threads may ask for.
pub type Givens<'a> = dyn Fn(usize) -> Given<'a> + Sync + 'a;

impl<R: Real> Batch<R> {
    /// Takes the arrays of all worlds; of those that cannot be stepped the first is refused, and
    /// nothing is taken.
    pub fn load(&mut self, given: &Givens) -> Result<()> {
        let Self { worlds, crew, groups, seats, models, .. } = self;
        let refused = Mutex::new(None::<(usize, Error)>);
        crew.carry(*worlds, groups, 1, |first, portion| {
            let own = (first..first + portion.len())
                .flat_map(|index| seats.worlds(index).iter().map(move |world| (index, *world)));
            for (index, world) in own {
                let model = &models[seats.model(index)];
                let Err(error) = given(world).check::<R>(model, Some(world)) else { continue };
                let mut refused = lock(&refused);
                if refused.as_ref().is_none_or(|(least, _)| world < *least) {
                    *refused = Some((world, error));
                }
            }
        });
        let refused = lock(&refused).take();
        if let Some((_, error)) = refused {
            return Err(error);
        }
        crew.carry(*worlds, groups, 1, |first, portion| {
            for (index, group) in (first..).zip(portion) {
                let own = seats.worlds(index);
                for (lane, world) in own.iter().enumerate() {
                    group.put(lane, own.len(), &given(*world));
                }
            }
        });
        Ok(())
    }

    /// Gives an array that a step changes, of all worlds one after the other.
    pub fn store(&self, array: Array, numbers: &mut [f64]) {
        let length = numbers.len() / self.worlds;
        self.crew.carry(self.worlds, numbers, length, |first, portion| {
            for (world, out) in (first..).zip(portion.chunks_mut(length)) {
                self.take(world, array, out);
            }
        });
    }
}
