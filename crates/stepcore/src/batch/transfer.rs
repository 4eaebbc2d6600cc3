//! All worlds' arrays in and out, over the threads of the batch.

use std::ops::Range;
use std::sync::Mutex;

use super::Batch;
use crate::arrays::{Array, Givens};
use crate::error::{Error, Result};
use crate::pool::lock;
use crate::real::Real;

impl<R: Real> Batch<R> {
    /// Copies the arrays of all worlds in; refuses the first world that cannot be stepped, and then
    /// copies nothing.
    pub fn load(&mut self, given: &Givens) -> Result<()> {
        let Self { worlds, workers, groups, layout, models, model_of, .. } = self;
        let refused = Mutex::new(None::<(usize, Error)>);
        let forms = models[0].has_forms();
        workers.transfer(*worlds, groups, 1, |first, portion| {
            let own = layout.of_groups(first..first + portion.len());
            let finite = given.all_finite::<R>(span(own));
            if finite && !forms {
                return;
            }
            for &world in own {
                let model = &models[model_of[world]];
                let given = given.of(world);
                let outcome = match finite {
                    true => given.check_forms::<R>(model, Some(world)),
                    false => given.check::<R>(model, Some(world)),
                };
                let Err(error) = outcome else { continue };
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
        workers.transfer(*worlds, groups, 1, |first, portion| {
            let idle = given.no_forces(span(layout.of_groups(first..first + portion.len())));
            for (index, group) in (first..).zip(portion) {
                group.put_all(layout.worlds(index), given, idle);
            }
        });
        Ok(())
    }

    /// Copies out an array that a step changes, for all worlds one after the other.
    pub fn store(&self, array: Array, numbers: &mut [f64]) {
        let length = numbers.len() / self.worlds;
        self.workers.transfer(self.worlds, numbers, length, |first, portion| {
            for (world, out) in (first..).zip(portion.chunks_exact_mut(length)) {
                self.take(world, array, out);
            }
        });
    }
}

/// The worlds from the first to the last of some.
fn span(worlds: &[usize]) -> Range<usize> {
    let (least, most) = worlds.iter().fold((usize::MAX, 0), |(a, b), w| (a.min(*w), b.max(*w)));
    least..most + 1
}
