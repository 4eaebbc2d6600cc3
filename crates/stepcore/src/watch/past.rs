//! Where a run came from: the states of its last steps, and of some long before.

use crate::arrays::Array;
use crate::model::Model;
use crate::observer::Observer;
use crate::real::Real;
use crate::sim::Sim;
use crate::state::State;

/// How many of the last steps are kept, and how many milestones.
const MEMORY: usize = 16;
/// Steps from one milestone to the next.
const STRIDE: u64 = 64;

/// States before each of the last steps, and at every 64th step before.
pub(crate) struct Past<R: Real> {
    recent: Ring<R>,
    milestones: Ring<R>,
    steps: u64,
}

room!(Past<R>: recent, milestones, steps);

/// What of a state is kept: its lists, in the order of `arrays::Array`.
pub(crate) type Kept<R> = [Vec<R>; Array::CHANGED];

struct Ring<R: Real> {
    states: Vec<Kept<R>>,
    at: usize,
    len: usize,
}

room!(Ring<R>: states, at, len);

impl<R: Real> Ring<R> {
    fn new(model: &Model<R::Value>) -> Self {
        let mut counts = Array::counts(model).into_iter();
        let empty = core::array::from_fn(|_| vec![R::zero(); counts.next().unwrap_or(0)]);
        Self { states: vec![empty; MEMORY], at: 0, len: 0 }
    }

    /// Keeps a state in the place of the oldest.
    fn keep(&mut self, state: &State<R>) {
        let lists = self.states[self.at].iter_mut().zip(state.lists());
        for (to, from) in lists.filter(|(to, _)| !to.is_empty()) {
            to.copy_from_slice(from);
        }
        self.at = (self.at + 1) % MEMORY;
        self.len = (self.len + 1).min(MEMORY);
    }

    fn oldest_first(&self) -> impl Iterator<Item = &Kept<R>> {
        (0..self.len).rev().map(|back| &self.states[(self.at + MEMORY - 1 - back) % MEMORY])
    }
}

impl<R: Real> Past<R> {
    pub fn new(model: &Model<R::Value>) -> Self {
        Self { recent: Ring::new(model), milestones: Ring::new(model), steps: 0 }
    }

    /// The state at hand did not come from a step.
    pub fn forget(&mut self) {
        (self.recent.len, self.milestones.len, self.steps) = (0, 0, 0);
    }

    /// Old states, oldest first.
    pub fn states(&self) -> impl Iterator<Item = &Kept<R>> {
        self.milestones.oldest_first().chain(self.recent.oldest_first())
    }
}

impl<R: Real> Observer<R> for Past<R> {
    fn looks_inside(&self) -> bool {
        false
    }

    fn committing(&mut self, sim: &Sim<R>) {
        if self.steps.is_multiple_of(STRIDE) {
            self.milestones.keep(&sim.state);
        }
        self.steps += 1;
        self.recent.keep(&sim.state);
    }
}
