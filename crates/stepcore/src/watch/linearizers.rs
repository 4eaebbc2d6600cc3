//! Linearisations at many states, on several threads.

use std::sync::{Arc, Mutex};

use super::linearize::{Around, Linearizer};
use crate::arrays::Givens;
use crate::elements::Element;
use crate::error::Result;
use crate::pool::{lock, Pool};
use crate::real::Real;
use crate::room::Room;
use crate::sim::Sim;

/// One for each thread, with its share of the states.
pub struct Linearizers {
    each: Vec<Linearizer>,
    pool: Option<Arc<Pool>>,
    count: usize,
}

room!(Linearizers: each; pool, count);

impl Linearizers {
    /// Of worlds with the model and the settings of this one; see `Linearizer::new`.
    pub fn new<R: Real>(from: &Sim<R>, parameters: Vec<Around>, threads: usize) -> Result<Self> {
        let pool = Pool::new(threads)?;
        let mut each = vec![Linearizer::new(from, parameters)?];
        for _ in 1..threads {
            each.push(each[0].another()?);
        }
        Ok(Self { each, pool, count: 0 })
    }

    /// Whether it is by these parameters, on so many threads.
    pub fn is(&self, parameters: &[Around], threads: usize) -> bool {
        self.each.len() == threads && self.each[0].is_by(parameters)
    }

    /// So many linearisations come next: at the present state, inputs and impulses of a world of the
    /// model, unless `advance` is given others.
    pub fn begin<R: Real>(&mut self, from: &Sim<R>, count: usize) {
        let threads = self.each.len();
        self.count = count;
        for (k, linearizer) in self.each.iter_mut().enumerate() {
            linearizer.begin(from, k * count / threads..(k + 1) * count / threads);
        }
    }

    /// That of the matrices: (linearisations, rows, columns).
    pub fn shape(&self) -> [usize; 3] {
        [self.count, self.each[0].rows(), self.each[0].width()]
    }

    /// Matrices of zeros, to be filled in.
    pub fn matrices(&self) -> Result<Vec<f64>> {
        self.each[0].matrices(self.count)
    }

    /// Steps that the thread with the most takes.
    pub fn steps(&self) -> u64 {
        self.each.iter().map(Linearizer::steps).max().unwrap_or(0)
    }

    /// Takes the next `n` steps of each thread.
    pub fn advance(
        &mut self,
        n: u64,
        states: Option<&Givens>,
        mut matrices: &mut [f64],
    ) -> Result<()> {
        let Some(pool) = &self.pool else { return self.each[0].advance(n, states, matrices) };
        let mut parts = Vec::new();
        for linearizer in &mut self.each {
            let (own, others) = matrices.split_at_mut(linearizer.numbers());
            matrices = others;
            parts.push(Mutex::new((linearizer, own, Ok(()))));
        }
        pool.share(parts.len(), &|part| {
            let (linearizer, own, outcome) = &mut *lock(&parts[part]);
            *outcome = linearizer.advance(n, states, own);
        });
        parts.into_iter().try_for_each(|part| lock(&part).2.clone())
    }

    /// Elements at which the derivatives of the nth linearisation are those of one side.
    pub fn degenerate(&self) -> impl Iterator<Item = (usize, Element)> + '_ {
        self.each.iter().flat_map(|linearizer| linearizer.degenerate.iter().copied())
    }

    /// Memory [bytes]; models are not in it.
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.room()
    }
}
