//! Linearisations at many states, on several threads.

use std::sync::{Arc, Mutex};

use super::linearize::{Asked, Linearizer};
use crate::elements::Element;
use crate::error::Result;
use crate::pool::{lock, Pool};
use crate::real::Real;
use crate::room::Room;
use crate::sim::Sim;

/// One linearizer for each thread, with its share of the states.
pub struct Linearizers {
    each: Vec<Linearizer>,
    pool: Option<Arc<Pool>>,
}

room!(Linearizers: each; pool);

impl Linearizers {
    /// For worlds like this one; see `Linearizer::new`.
    pub fn new<R: Real>(from: &Sim<R>, threads: usize) -> Result<Self> {
        let pool = Pool::new(threads)?;
        let each = (0..threads).map(|_| Linearizer::new(from)).collect::<Result<_>>()?;
        Ok(Self { each, pool })
    }

    pub fn threads(&self) -> usize {
        self.each.len()
    }

    /// Starts linearisations at these states. Returns room for their matrices; see
    /// `Linearizer::matrices`.
    pub fn begin(&mut self, asked: &Asked) -> Result<Vec<f64>> {
        let (count, threads) = (asked.count, self.each.len());
        for (k, linearizer) in self.each.iter_mut().enumerate() {
            let own = k * count / threads..(k + 1) * count / threads;
            let first = asked.worlds.get(asked.world(own.start)).unwrap_or(&asked.worlds[0]);
            linearizer.begin_of(own, first)?;
        }
        self.each[0].matrices(count)
    }

    /// Rows and columns of a matrix.
    pub fn shape(&self) -> [usize; 2] {
        [self.each[0].rows(), self.each[0].width()]
    }

    /// The largest number of steps of a thread.
    pub fn steps(&self) -> u64 {
        self.each.iter().map(Linearizer::steps).max().unwrap_or(0)
    }

    /// Takes the next `n` steps of each thread. Of several errors it returns the first state's.
    pub fn advance(&mut self, n: u64, asked: &Asked, mut matrices: &mut [f64]) -> Result<()> {
        let Some(pool) = &self.pool else {
            return self.each[0].advance(n, Some(asked), matrices);
        };
        let mut parts = Vec::new();
        for linearizer in &mut self.each {
            let (own, others) = matrices.split_at_mut(linearizer.numbers());
            matrices = others;
            parts.push(Mutex::new((linearizer, own, Ok(()))));
        }
        pool.share(parts.len(), &|part| {
            let (linearizer, own, outcome) = &mut *lock(&parts[part]);
            *outcome = linearizer.advance(n, Some(asked), own);
        });
        parts.into_iter().try_for_each(|part| lock(&part).2.clone())
    }

    /// Elements at which the derivatives of the nth linearisation are one-sided.
    pub fn degenerate(&self) -> impl Iterator<Item = (usize, Element)> + '_ {
        self.each.iter().flat_map(|linearizer| linearizer.degenerate.iter().copied())
    }

    /// Memory [bytes]; models are not in it.
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.room()
    }
}
