//! Steps of a batch under given controls, with the states after each.

use crate::arrays::Array;
use crate::real::Real;
use crate::state::State;
use crate::watch::Watched;

/// Controls for every world and step, and room for the states after each step: world,
/// then step, then entry.
pub struct Play<'a> {
    pub steps: usize,
    pub ctrl: &'a [f64],
    /// In the order of `Array`.
    pub states: [&'a mut [f64]; Array::CHANGED],
}

/// A group's part of a `Play`.
pub(super) struct Part<'a> {
    worlds: usize,
    steps: usize,
    /// Entries of every array in one world.
    counts: [usize; Array::COUNT],
    ctrl: &'a [f64],
    states: [&'a mut [f64]; Array::CHANGED],
}

impl Play<'_> {
    /// The parts of the groups: `lanes` worlds each, the last one what is left of all `worlds`.
    pub(super) fn parts(
        &mut self,
        worlds: usize,
        lanes: usize,
        counts: [usize; Array::COUNT],
    ) -> Vec<Part<'_>> {
        let steps = self.steps;
        let mut ctrl = self.ctrl;
        let mut states = self.states.each_mut().map(|list| &mut **list);
        let part = |first: usize| {
            let worlds = (worlds - first).min(lanes);
            let size = |array: usize| counts[array] * steps * lanes;
            let mut own = 0..Array::CHANGED;
            let states = states.each_mut().map(|list| cut_mut(list, own.next().map_or(0, size)));
            let ctrl = cut(&mut ctrl, size(Array::Ctrl as usize));
            Part { worlds, steps, counts, ctrl, states }
        };
        (0..worlds).step_by(lanes).map(part).collect()
    }
}

impl Part<'_> {
    /// Puts the controls of a step in; lanes without a world repeat the last one.
    pub fn control<R: Real>(&self, step: usize, watched: &mut Watched<R>) {
        let nu = self.counts[Array::Ctrl as usize];
        let own = (0..R::LANES).find(|lane| watched.is_world(*lane)).unwrap_or(0);
        for lane in 0..R::LANES {
            let world = if watched.is_world(lane) { lane.min(self.worlds - 1) } else { own };
            let start = (world * self.steps + step) * nu;
            for (to, from) in watched.sim.inputs.ctrl.iter_mut().zip(&self.ctrl[start..start + nu])
            {
                to.set_lane(lane, *from);
            }
        }
    }

    /// Keeps the state after a step.
    pub fn record<R: Real>(&mut self, step: usize, state: &State<R>) {
        for lane in 0..self.worlds {
            let at = lane * self.steps + step;
            for (array, list) in Array::ALL.into_iter().zip(&mut self.states) {
                let count = self.counts[array as usize];
                state.take(lane, array, &mut list[at * count..(at + 1) * count]);
            }
        }
    }
}

/// Takes up to `count` entries off the front.
fn cut<'a>(all: &mut &'a [f64], count: usize) -> &'a [f64] {
    let (head, tail) = all.split_at(count.min(all.len()));
    *all = tail;
    head
}

fn cut_mut<'a>(all: &mut &'a mut [f64], count: usize) -> &'a mut [f64] {
    let whole = std::mem::take(all);
    let (head, tail) = whole.split_at_mut(count.min(whole.len()));
    *all = tail;
    head
}
