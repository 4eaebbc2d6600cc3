//! The origin of a run: the states before its last steps, and some much earlier.
//!
//! Every world has its own past, in a `Sim` and in a batch, however its steps are divided into
//! calls: the same states explain its failure.

use crate::model::Model;
use crate::observer::Observer;
use crate::real::Real;
use crate::sim::Sim;
use crate::state::State;

/// How many of the last steps are kept.
const RECENT: usize = 16;
/// How many milestones are kept, and the steps from one to the next.
const MILESTONES: usize = 4;
const STRIDE: u64 = 64;

/// States before each of the last steps, and at every 64th step before: the lists of each, one
/// after the other.
pub(crate) struct Past<R: Real> {
    recent: Vec<R>,
    milestones: Vec<R>,
    /// Numbers of a state.
    size: usize,
    /// The place of the next of `recent`.
    at: usize,
    /// For each lane: steps since its world was placed there.
    steps: Vec<u64>,
}

room!(Past<R>: recent, milestones, steps; size, at);

/// The past of one world: its steps, and its old states, oldest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WorldPast {
    steps: u64,
    numbers: Vec<f64>,
}

impl<R: Real> Past<R> {
    pub fn new(model: &Model<R::Value>) -> Self {
        let size = State::<R>::new(model).lists().map(Vec::len).iter().sum();
        let states = |count| vec![R::zero(); count * size];
        let (recent, milestones) = (states(RECENT), states(MILESTONES));
        Self { recent, milestones, size, at: 0, steps: vec![0; R::LANES] }
    }

    /// Records that a lane's state did not come from a step.
    pub fn forget(&mut self, lane: usize) {
        self.steps[lane] = 0;
    }

    /// Prepares for repeating this many steps of all lanes.
    pub fn rewind(&mut self, steps: u64) {
        let back = (steps % RECENT as u64) as usize;
        self.at = (self.at + RECENT - back) % RECENT;
        self.steps.iter_mut().for_each(|own| *own = own.saturating_sub(steps));
    }

    /// A lane's old states, oldest first.
    pub fn states(&self, lane: usize) -> impl Iterator<Item = &[R]> {
        let (milestones, recent) = self.places(lane);
        let old = milestones.map(|nth| &self.milestones[nth * self.size..][..self.size]);
        old.chain(recent.map(|nth| &self.recent[nth * self.size..][..self.size]))
    }

    /// The places of these in either list.
    fn places(&self, lane: usize) -> (impl Iterator<Item = usize>, impl Iterator<Item = usize>) {
        let (at, steps) = (self.at, self.steps[lane]);
        let end = steps.div_ceil(STRIDE) as usize;
        let milestones = (end.saturating_sub(MILESTONES)..end).map(|nth| nth % MILESTONES);
        let known = steps.min(RECENT as u64) as usize;
        (milestones, (0..known).map(move |nth| (at + RECENT - known + nth) % RECENT))
    }

    /// The past that a batch needs to continue with a lane's world.
    pub fn of(&self, lane: usize) -> WorldPast {
        let numbers = self.states(lane).flatten().map(|x| x.lane(lane)).collect();
        WorldPast { steps: self.steps[lane], numbers }
    }

    /// Continues a lane with a world.
    pub fn take(&mut self, lane: usize, world: &WorldPast) {
        self.steps[lane] = world.steps;
        let (milestones, recent) = self.places(lane);
        let mut states = world.numbers.chunks_exact(self.size.max(1));
        let (milestones, recent): (Vec<_>, Vec<_>) = (milestones.collect(), recent.collect());
        for (list, places) in [(&mut self.milestones, milestones), (&mut self.recent, recent)] {
            for (place, state) in places.into_iter().zip(&mut states) {
                let own = list[place * self.size..].iter_mut().zip(state);
                own.for_each(|(to, from)| to.set_lane(lane, *from));
            }
        }
    }
}

/// Puts one of `Past::states` back: a lane's numbers into all.
pub(super) fn put_back<R: Real>(kept: &[R], lane: usize, state: &mut State<R>) {
    let all = state.lists_mut().into_iter().flatten();
    all.zip(kept).for_each(|(to, from)| *to = R::of(from.lane(lane)));
}

impl<R: Real> Observer<R> for Past<R> {
    fn looks_inside(&self) -> bool {
        false
    }

    fn committing(&mut self, sim: &Sim<R>) {
        let size = self.size;
        let recent = &mut self.recent[self.at * size..][..size];
        let mut to = &mut *recent;
        for list in sim.state.lists() {
            let (own, rest) = to.split_at_mut(list.len());
            own.copy_from_slice(list);
            to = rest;
        }
        for (lane, steps) in self.steps.iter_mut().enumerate() {
            if steps.is_multiple_of(STRIDE) {
                let nth = (*steps / STRIDE) as usize % MILESTONES;
                let milestone = self.milestones[nth * size..].iter_mut().zip(&*recent);
                milestone.for_each(|(to, from)| to.set_lane(lane, from.lane(lane)));
            }
            *steps += 1;
        }
        self.at = (self.at + 1) % RECENT;
    }
}
