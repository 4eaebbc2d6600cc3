//! Steps of a batch under given controls, with the states after each.

use super::lane_layout::LaneLayout;
use crate::arrays::Array;
use crate::real::Real;
use crate::state::State;
use crate::watch::Watched;

/// Controls for every world and step, and room for the states after each step: world,
/// then step, then entry.
pub struct Rollout<'a> {
    pub steps: usize,
    pub ctrl: &'a [f64],
    /// In the order of `Array`.
    pub states: [&'a mut [f64]; Array::CHANGED],
}

/// A group's part of a `Rollout`, by lane.
pub(super) struct Part<'a> {
    /// Entries of every array in one world.
    counts: [usize; Array::COUNT],
    ctrl: Vec<&'a [f64]>,
    states: Vec<[&'a mut [f64]; Array::CHANGED]>,
}

impl Rollout<'_> {
    /// The parts of the groups.
    pub(super) fn parts(
        &mut self,
        layout: &LaneLayout,
        counts: [usize; Array::COUNT],
    ) -> Vec<Part<'_>> {
        let (steps, ctrl) = (self.steps, self.ctrl);
        let mut states = self.states.each_mut().map(|list| &mut **list);
        let mut by_world: Vec<_> = (0..layout.all().len())
            .map(|_| {
                let mut own = counts.iter().map(|count| count * steps);
                Some(states.each_mut().map(|list| cut_mut(list, own.next().unwrap_or(0))))
            })
            .collect();
        let size = counts[Array::Ctrl as usize] * steps;
        let part = |group| {
            let own = layout.worlds(group);
            let ctrl = own.iter().map(|world| &ctrl[world * size..(world + 1) * size]).collect();
            let states = own.iter().filter_map(|world| by_world[*world].take()).collect();
            Part { counts, ctrl, states }
        };
        (0..layout.groups()).map(part).collect()
    }
}

impl Part<'_> {
    /// Puts the controls of a step in; lanes without a world repeat the last one.
    pub fn control<R: Real>(&self, step: usize, watched: &mut Watched<R>) {
        let nu = self.counts[Array::Ctrl as usize];
        let own = (0..R::LANES).find(|lane| watched.is_world(*lane)).unwrap_or(0);
        for lane in 0..R::LANES {
            let world = if watched.is_world(lane) { lane.min(self.ctrl.len() - 1) } else { own };
            let from = &self.ctrl[world][step * nu..(step + 1) * nu];
            for (to, from) in watched.sim.inputs.ctrl.iter_mut().zip(from) {
                to.set_lane(lane, *from);
            }
        }
    }

    /// Keeps the state after a step.
    pub fn record<R: Real>(&mut self, step: usize, state: &State<R>) {
        for (lane, lists) in self.states.iter_mut().enumerate() {
            for (array, list) in Array::ALL.into_iter().zip(lists) {
                let count = self.counts[array as usize];
                state.take(lane, array, &mut list[step * count..(step + 1) * count]);
            }
        }
    }
}

/// Takes up to `count` entries off the front.
fn cut_mut<'a>(all: &mut &'a mut [f64], count: usize) -> &'a mut [f64] {
    let whole = std::mem::take(all);
    let (head, tail) = whole.split_at_mut(count.min(whole.len()));
    *all = tail;
    head
}
