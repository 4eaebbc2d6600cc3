//! After a failure: the last steps are repeated and recorded, and the post-mortem is read from them.

mod blame;
mod injected;
mod linear;
mod segment;

use blame::strongest;
use injected::{feeding, growth, shares};
use segment::Segment;

use super::ledger::Ledger;
use super::past::Past;
use super::tape::{taped, StepGains};
use crate::elements::Element;
use crate::error::{Divergence, Error, Fault, Result};
use crate::post_mortem::{Held, PostMortem, Stable, Start};
use crate::real::Real;
use crate::settings::Integrator;
use crate::sim::Sim;
use crate::state::{Inputs, State};

/// Without a ledger, trees up to this many dofs are looked into.
const SMALL: usize = 12;

/// What is known of a run.
pub(super) struct Run<'a, R: Real> {
    pub sim: &'a Sim<R>,
    pub past: &'a Past<R>,
    pub ledger: Option<&'a Ledger<R>>,
}

/// More energy than there can be: an error, unless a closer look shows where it is from, and
/// the ledger allows it from now on.
#[cold]
pub(super) fn look_into<R: Real>(
    ledger: &mut Ledger<R>,
    sim: &Sim<R>,
    past: &Past<R>,
    lane: usize,
    gained: f64,
) -> Result<()> {
    let Some(account) = ledger.account(lane) else { return Ok(()) };
    let scale = account.scale;
    let present = Segment::at_present(sim, lane);
    let swing = present.world(sim).map_or(1.0, |mut world| world.swing(lane, sim.clock.seconds));
    if gained <= (swing - 1.0) * scale {
        // A healthy run of these springs swings as far.
        account.allow(gained, swing - 1.0);
        return Ok(());
    }
    let segment = Segment::since_well(ledger, lane, sim.state.steps);
    if segment.is_some_and(|segment| !segment.smaller_steps_gain_less(sim, lane)) {
        if let Some(account) = ledger.account(lane) {
            account.allow(gained, 0.0);
        }
        return Ok(());
    }
    let fault = Fault::Energy { has: ledger.moving(lane), allowed: scale };
    let divergence = Divergence {
        step: sim.state.steps,
        time: sim.time(),
        world: lane,
        batch: false,
        fault,
        post: None,
    };
    let run = Run { sim, past, ledger: Some(ledger) };
    Err(Error::Diverged(Box::new(run.explain(divergence))))
}

impl<R: Real> Run<'_, R> {
    /// Adds what can be found out about a failure of the lane `divergence.world`.
    pub fn explain(&self, divergence: Divergence) -> Divergence {
        let gained = matches!(divergence.fault, Fault::Energy { .. });
        let post = self.post_mortem(divergence.world, gained);
        Divergence { post: Some(post), ..divergence }
    }

    fn post_mortem(&self, lane: usize, gained: bool) -> PostMortem {
        let sim = self.sim;
        let replayed = self
            .ledger
            .and_then(|ledger| Segment::since_well(ledger, lane, sim.state.steps))
            .and_then(|segment| self.replayed(&segment, lane).map(|steps| (segment, steps)));
        let (segment, steps, exact) = match replayed {
            Some((segment, steps)) => (segment, steps, true),
            None => (Segment::at_present(sim, lane), self.kept_steps(lane), false),
        };
        let scale = self.ledger.and_then(|ledger| ledger.scale(lane));
        let (from, window) = feeding(&sim.model, &steps, scale, gained);
        let was_well = exact && window.is_empty();
        let shares = shares(window);
        let element = match shares.first() {
            Some((element, _)) => Some(*element),
            None => self.strongest(lane, was_well),
        };
        let shares = shares.into_iter();
        let stable = if was_well { Stable::Unknown } else { self.stable(&segment, lane, exact) };
        PostMortem {
            start: start(&segment.state, lane),
            inputs: held(&segment.inputs, lane),
            changes: segment.changes.iter().map(|(step, i)| (*step, held(i, lane))).collect(),
            steps: segment.steps,
            element: element.map(|element| sim.model.named(element)),
            shares: shares.map(|(element, share)| (sim.model.named(element), share)).collect(),
            since: exact.then(|| segment.state.steps + from as u64),
            growth: growth(window, exact),
            stable,
            dt: sim.clock.seconds,
            integrator: sim.settings.integrator.name(),
        }
    }

    /// The segment step by step; None where it does not end in the state at hand.
    fn replayed(&self, segment: &Segment<R>, lane: usize) -> Option<Vec<StepGains>> {
        let mut sim = segment.world(self.sim)?;
        let steps = segment.play(&mut sim, |sim| one_taped(sim, lane))?;
        let same = |a: &[R], b: &[R]| {
            a.iter().zip(b).all(|(a, b)| a.lane(lane).to_bits() == b.lane(lane).to_bits())
        };
        let (now, there) = (&self.sim.state, &sim.state);
        (same(&there.qpos, &now.qpos) && same(&there.qvel, &now.qvel)).then_some(steps)
    }

    /// Without a ledger: the steps from the last states, started without their impulses.
    fn kept_steps(&self, lane: usize) -> Vec<StepGains> {
        let Some(mut sim) = Segment::at_present(self.sim, lane).world(self.sim) else {
            return Vec::new();
        };
        let all = |to: &mut [R], from: &[R]| {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = R::of(from.lane(lane)));
        };
        let mut steps = Vec::new();
        for (qpos, qvel) in self.past.states() {
            all(&mut sim.state.qpos, qpos);
            all(&mut sim.state.qvel, qvel);
            sim.state.warm.clear();
            steps.extend(one_taped(&mut sim, lane));
        }
        steps
    }

    /// The element that became the strongest on the way here, or, where all was well until
    /// then, that is the strongest now.
    fn strongest(&self, lane: usize, was_well: bool) -> Option<Element> {
        let sim = Segment::at_present(self.sim, lane).world(self.sim)?;
        let past = self.past.states().filter(|_| !was_well);
        let mut way: Vec<_> = past.map(|(qpos, qvel)| (&qpos[..], &qvel[..])).collect();
        way.push((&self.sim.state.qpos, &self.sim.state.qvel));
        strongest(sim, &way, lane)
    }

    /// Which dt would have been stable, as far as that can be found cheaply.
    fn stable(&self, segment: &Segment<R>, lane: usize, exact: bool) -> Stable {
        let sim = self.sim;
        let Some(mut start) = segment.world(sim) else { return Stable::Unknown };
        if !exact && sim.model.trees.iter().any(|tree| tree.dofs.len > SMALL) {
            return Stable::Unknown;
        }
        match start.spring_limit(lane, sim.settings.integrator) {
            Some(0.0) => {
                let semi_implicit = start.spring_limit(lane, Integrator::SemiImplicit);
                Stable::Never { semi_implicit }
            }
            Some(dt) => {
                let below = 0.95 * dt;
                let swing = start.swing(lane, below);
                Stable::Springs { dt, tried: exact && segment.swings(sim, below, lane, swing) }
            }
            None if exact => {
                segment.halved(sim, lane).map_or(Stable::NotFound, |dt| Stable::Halved { dt })
            }
            None => Stable::Unknown,
        }
    }
}

/// One step under a tape, if it can be committed.
fn one_taped<R: Real>(sim: &mut Sim<R>, lane: usize) -> Option<StepGains> {
    taped(sim, lane, |sim, tape| sim.step_watched(1, tape)).ok()
}

fn numbers<R: Real>(list: &[R], lane: usize) -> Vec<f64> {
    list.iter().map(|x| x.lane(lane)).collect()
}

/// One lane of a state.
fn start<R: Real>(state: &State<R>, lane: usize) -> Start {
    let warm = state.warm.iter().map(|w| (w.slot, w.impulse.map(|x| x.lane(lane))));
    Start {
        steps: state.steps,
        time: state.start,
        qpos: numbers(&state.qpos, lane),
        qvel: numbers(&state.qvel, lane),
        // An impulse of zero is as good as none, and a lane has zeros for its neighbours' contacts.
        warm: warm.filter(|(_, impulse)| impulse.iter().any(|x| *x != 0.0)).collect(),
    }
}

/// One lane of the inputs.
fn held<R: Real>(inputs: &Inputs<R>, lane: usize) -> Held {
    let [ctrl, qfrc_applied, xfrc_applied] = inputs.arrays().map(|list| numbers(list, lane));
    Held { ctrl, qfrc_applied, xfrc_applied }
}
