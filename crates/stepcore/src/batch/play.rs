//! Steps of a batch under given controls, with the states after each.

use crate::real::Real;
use crate::state::State;
use crate::watch::Watched;

/// Controls for every world and step, and room for the states after each step: world,
/// then step, then entry.
pub struct Play<'a> {
    pub steps: usize,
    pub ctrl: &'a [f64],
    pub qpos: &'a mut [f64],
    pub qvel: &'a mut [f64],
}

/// A group's part of a `Play`.
pub(super) struct Part<'a> {
    worlds: usize,
    steps: usize,
    /// nu, nq, nv.
    sizes: [usize; 3],
    ctrl: &'a [f64],
    qpos: &'a mut [f64],
    qvel: &'a mut [f64],
}

impl Play<'_> {
    /// The parts of the groups: `lanes` worlds each, the last one what is left of all `worlds`.
    pub(super) fn parts(
        &mut self,
        worlds: usize,
        lanes: usize,
        sizes: [usize; 3],
    ) -> Vec<Part<'_>> {
        let steps = self.steps;
        let [nu, nq, nv] = sizes.map(|size| size * steps * lanes);
        let (mut ctrl, mut qpos, mut qvel) = (self.ctrl, &mut *self.qpos, &mut *self.qvel);
        let part = |first: usize| {
            let worlds = (worlds - first).min(lanes);
            let (ctrl, qpos, qvel) =
                (cut(&mut ctrl, nu), cut_mut(&mut qpos, nq), cut_mut(&mut qvel, nv));
            Part { worlds, steps, sizes, ctrl, qpos, qvel }
        };
        (0..worlds).step_by(lanes).map(part).collect()
    }
}

impl Part<'_> {
    /// Puts the controls of a step in; lanes without a world repeat the last one.
    pub fn control<R: Real>(&self, step: usize, watched: &mut Watched<R>) {
        let nu = self.sizes[0];
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
        let [_, nq, nv] = self.sizes;
        for lane in 0..self.worlds {
            let at = lane * self.steps + step;
            state.take(
                lane,
                &mut self.qpos[at * nq..(at + 1) * nq],
                &mut self.qvel[at * nv..(at + 1) * nv],
            );
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
