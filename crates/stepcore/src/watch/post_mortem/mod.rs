//! After a failure: the last steps are repeated and recorded for the post-mortem.

mod blame;
mod budget;
mod injected;
mod linear;
mod segment;
mod unsolved;

use blame::strongest;
use budget::Budget;
use injected::{feeding, growth, saturated, shares};
use segment::{Halved, Segment};
use unsolved::missed_most;

use super::ledger::Ledger;
use super::past::{put_back, Past};
use super::tape::{taped, StepGains};
use crate::elements::{Element, Kind};
use crate::error::{Divergence, Error, Fault, Result};
use crate::post_mortem::{Held, Missed, PostMortem, Stable, Start};
use crate::real::Real;
use crate::settings::{Integrator, Law, Sweeps};
use crate::sim::{At, Sim};
use crate::state::{Inputs, State};
use crate::warm::Warm;

/// Without a ledger, trees up to this many dofs are examined.
const SMALL: usize = 12;

/// Unsolved rows are blamed for a gain of which they may have added this share.
const UNSOLVED: f64 = 0.5;

/// The share of steps with a servo at its force bounds that charges it with inertial gains.
const OUT_OF_HAND: f64 = 0.25;
/// How many times as long a rerun under law `penalty` continues, until its contacts recur.
const AFTERWARDS: u32 = 7;

/// The data of a run.
pub(super) struct Run<'a, R: Real> {
    pub sim: &'a Sim<R>,
    pub past: &'a Past<R>,
    pub ledger: Option<&'a Ledger<R>>,
    /// The number of worlds that may fail as well, and share the cost of explanations.
    pub worlds: usize,
}

/// Handles more energy than possible: an error, unless a closer look finds its source, and the
/// ledger allows it from now on. None gained: velocities are beyond all bounds.
#[cold]
pub(super) fn look_into<R: Real>(
    ledger: &mut Ledger<R>,
    sim: &Sim<R>,
    past: &Past<R>,
    worlds: usize,
    lane: usize,
    gained: Option<f64>,
) -> Result<()> {
    let Some(gained) = gained else {
        let Some(fault) = sim.beyond(lane) else { return Ok(()) };
        let run = Run { sim, past, ledger: Some(ledger), worlds };
        return Err(Error::Diverged(Box::new(run.explain(sim.divergence(lane, fault)))));
    };
    let Some(account) = ledger.account(lane) else { return Ok(()) };
    let scale = account.scale;
    let present = Segment::at_present(sim, lane);
    let (dt, budget) = (sim.clock.seconds, Budget::whole());
    let swing = present.world(sim).map_or(1.0, |mut world| world.swing(lane, dt, &budget));
    if gained <= (swing - 1.0) * scale {
        // A healthy run of these springs swings as far.
        account.allow(gained, swing - 1.0);
        return Ok(());
    }
    // The whole of it, or the newest part if that would take too long.
    let stretches = [Segment::since_well, Segment::since_last].iter();
    let stretches = stretches.filter_map(|since| since(ledger, lane, sim.state.steps));
    let stretches: Vec<_> = stretches.collect();
    let unsolved = stretches.first().and_then(|stretch| stretch.unsolved(sim, lane, &budget));
    let unsolved = unsolved.filter(|unsolved| unsolved.total >= UNSOLVED * gained);
    if unsolved.is_none() {
        let mut stretches = stretches.iter();
        let less = stretches.find_map(|part| part.smaller_steps_gain_less(sim, lane, &budget));
        if less != Some(true) {
            if let Some(account) = ledger.account(lane) {
                account.allow(gained, 0.0);
            }
            return Ok(());
        }
    }
    let fault = Fault::Energy { gained, moving: ledger.moving(lane) };
    let run = Run { sim, past, ledger: Some(ledger), worlds };
    let mut divergence = run.explain(sim.divergence(lane, fault));
    if let (Some(post), Some(unsolved)) = (&mut divergence.post, unsolved) {
        let auto = stretches.first().filter(|_| sim.settings.sweeps != Sweeps::Auto);
        let auto = auto.is_some_and(|stretch| stretch.auto_gains_less(sim, lane, gained, &budget));
        post.unsolved = Some(Missed {
            element: sim.model.named(unsolved.element),
            added: Some(unsolved.added),
            residual: unsolved.residual,
            auto,
        });
    }
    Err(Error::Diverged(Box::new(divergence)))
}

impl<R: Real> Run<'_, R> {
    /// Adds the findings about a failure of the lane `divergence.world`.
    pub fn explain(&self, divergence: Divergence) -> Divergence {
        if self.sim.settings.accuracy.0.is_some() {
            let post = self.within_accuracy(&divergence);
            return Divergence { post: Some(post), ..divergence };
        }
        let gained = matches!(divergence.fault, Fault::Energy { .. });
        let mut post = self.post_mortem(divergence.world, gained);
        if divergence.fault == Fault::Midpoint {
            if let Some((element, residual)) = self.missed_here(divergence.world) {
                // The intermediate states of its iteration are no solutions.
                let element = self.sim.model.named(element);
                post.element = Some(element.clone());
                post.shares.clear();
                post.unsolved = Some(Missed { element, added: None, residual, auto: false });
            }
        }
        Divergence { post: Some(post), ..divergence }
    }

    /// The element that violates its law most at the start of the step, in a separate world: the
    /// present rows may be another world's.
    fn missed_here(&self, lane: usize) -> Option<(Element, f64)> {
        let mut world = Segment::at_present(self.sim, lane).world(self.sim)?;
        world.place_detect_solve(At::State).ok()?;
        missed_most(&world, lane)
    }

    /// For adaptive steps: the error names the cause, and it recurs from here.
    fn within_accuracy(&self, divergence: &Divergence) -> PostMortem {
        let (sim, lane) = (self.sim, divergence.world);
        let here = Segment::at_present(sim, lane);
        PostMortem {
            start: start(&here.state, lane),
            inputs: held(&here.inputs, lane),
            changes: Vec::new(),
            steps: 1,
            element: match &divergence.fault {
                Fault::Rough { body, .. } => Some(body.clone()),
                Fault::NotFinite { joint, .. } => Some(joint.clone()),
                _ => None,
            },
            shares: Vec::new(),
            saturated: false,
            since: None,
            growth: None,
            unsolved: None,
            stable: Stable::Unknown,
            dt: sim.period,
            integrator: sim.settings.integrator.name(),
        }
    }

    fn post_mortem(&self, lane: usize, gained: bool) -> PostMortem {
        let (sim, budget, cause) = (self.sim, Budget::shared(self.worlds), Budget::of_cause());
        let since = |ledger| Segment::since_well(ledger, lane, sim.state.steps);
        let since = self.ledger.and_then(since);
        let scale = since.as_ref().and_then(|segment| segment.scale);
        let replayed =
            since.and_then(|segment| Some((self.replayed(&segment, lane, &budget)?, segment)));
        let (segment, steps, exact) = match replayed {
            Some((steps, segment)) => (segment, steps, true),
            None => (Segment::at_present(sim, lane), self.kept_steps(lane, &cause), false),
        };
        let (from, window) = feeding(sim.model_of(lane), &steps, scale, gained);
        let was_well = exact && window.is_empty();
        let mut shares = shares(window);
        let element = match shares.first() {
            Some((element, _)) => Some(*element),
            None => self.strongest(lane, was_well, &cause),
        };
        // Gravity and inertia are not the cause where a servo is out of hand, gravity never is.
        let seen = if window.is_empty() { &steps[..] } else { window };
        let saturated = match element.map(|element| element.kind) {
            Some(Kind::Gravity) => saturated(&steps, 0.0),
            Some(Kind::Inertia) => saturated(seen, OUT_OF_HAND),
            Some(Kind::Actuator) if shares.is_empty() => {
                saturated(&steps, OUT_OF_HAND).filter(|servo| element == Some(*servo))
            }
            _ => None,
        };
        let element = saturated.or_else(|| {
            if element != Some(Element::GRAVITY) {
                return element;
            }
            // Gravity gives back what it took: a large share shows bodies moved wrongly by others.
            shares = without_gravity(std::mem::take(&mut shares));
            let next = shares.first().map(|(element, _)| *element);
            next.or_else(|| self.strongest(lane, was_well, &budget))
                .filter(|element| *element != Element::GRAVITY)
        });
        let shares = shares.into_iter();
        let stable = match was_well {
            true => Stable::Unknown,
            false => self.stable(&segment, lane, exact, &budget),
        };
        PostMortem {
            start: start(&segment.state, lane),
            inputs: held(&segment.inputs, lane),
            changes: segment.changes.iter().map(|(step, i)| (*step, held(i, lane))).collect(),
            steps: segment.steps,
            element: element.map(|element| sim.model.named(element)),
            shares: shares.map(|(element, share)| (sim.model.named(element), share)).collect(),
            saturated: saturated.is_some(),
            since: exact.then(|| segment.state.steps + from as u64),
            growth: growth(window, exact),
            unsolved: None,
            stable,
            dt: sim.clock.seconds,
            integrator: sim.settings.integrator.name(),
        }
    }

    /// Repeats the segment step by step; None if it does not end in this state, or is too long.
    fn replayed(
        &self,
        segment: &Segment<R>,
        lane: usize,
        budget: &Budget,
    ) -> Option<Vec<StepGains>> {
        let mut sim = segment.world(self.sim)?;
        let steps = segment.play(&mut sim, |sim| one_taped(sim, lane, budget))?;
        let same = |a: &[R], b: &[R]| {
            a.iter().zip(b).all(|(a, b)| a.lane(lane).to_bits() == b.lane(lane).to_bits())
        };
        let (now, there) = (&self.sim.state, &sim.state);
        let mut both = there.lists().into_iter().zip(now.lists());
        both.all(|(there, now)| same(there, now)).then_some(steps)
    }

    /// Without a ledger: the steps from the last states, started without their impulses.
    fn kept_steps(&self, lane: usize, budget: &Budget) -> Vec<StepGains> {
        let Some(mut sim) = Segment::at_present(self.sim, lane).world(self.sim) else {
            return Vec::new();
        };
        let mut steps = Vec::new();
        for kept in self.affordable(lane, budget) {
            put_back(kept, lane, &mut sim.state);
            sim.state.warm.clear();
            steps.extend(one_taped(&mut sim, lane, budget));
        }
        steps
    }

    /// The newest of the old states at which a step can be recorded.
    fn affordable(&self, lane: usize, budget: &Budget) -> Vec<&[R]> {
        let mut states: Vec<_> = self.past.states(lane).collect();
        states.drain(..states.len() - budget.count(self.sim.tape(), states.len()));
        states
    }

    /// The element that became the strongest on the way here, or, if all was well until then, the
    /// strongest one now.
    fn strongest(&self, lane: usize, was_well: bool, budget: &Budget) -> Option<Element> {
        let present = Segment::at_present(self.sim, lane);
        let past = if was_well { Vec::new() } else { self.affordable(lane, budget) };
        strongest(present.world(self.sim)?, &past, &present.state, lane)
    }

    /// The dt that would have been stable, if that can be found cheaply.
    fn stable(&self, segment: &Segment<R>, lane: usize, exact: bool, budget: &Budget) -> Stable {
        let sim = self.sim;
        let Some(mut start) = segment.world(sim) else { return Stable::Unknown };
        if !exact && sim.model.trees.iter().any(|tree| tree.dofs.len > SMALL) {
            return Stable::Unknown;
        }
        let integrator = sim.settings.integrator;
        if exact && sim.settings.rows_after_stages() {
            if let Some(share) = segment.under_semi_implicit(sim, lane, budget) {
                return Stable::AfterStages { share };
            }
        }
        // The contacts' springs are not among the analysed ones: only a rerun decides, one that
        // meets the contacts again.
        let penalty = sim.settings.law == Law::Penalty;
        let more = if penalty { AFTERWARDS } else { 0 };
        match start.spring_limit(lane, integrator, budget) {
            Some(0.0) => {
                let semi_implicit = start.spring_limit(lane, Integrator::SemiImplicit, budget);
                return Stable::Never { semi_implicit };
            }
            Some(dt) => {
                let below = 0.95 * dt;
                let swing = start.swing(lane, below, budget);
                let tried = exact && segment.swings(sim, below, lane, swing, more, budget);
                if tried || !penalty {
                    return Stable::Springs { dt, tried };
                }
            }
            None => {}
        }
        if !exact {
            return Stable::Unknown;
        }
        match segment.halved(sim, lane, more, budget) {
            Halved::Dt(dt) => Stable::Halved { dt },
            Halved::NotFound => Stable::NotFound,
            Halved::Untried => Stable::Unknown,
        }
    }
}

/// The shares of all elements but gravity in the total that these injected.
fn without_gravity(mut shares: Vec<(Element, f64)>) -> Vec<(Element, f64)> {
    shares.retain(|(element, _)| *element != Element::GRAVITY);
    let all: f64 = shares.iter().map(|(_, share)| share).sum();
    shares.iter_mut().for_each(|(_, share)| *share /= all);
    shares
}

/// One step under a tape, if it can be committed and is within the budget.
fn one_taped<R: Real>(sim: &mut Sim<R>, lane: usize, budget: &Budget) -> Option<StepGains> {
    let effort = sim.effort;
    let gains = taped(sim, lane, |sim, tape| sim.step_watched(1, tape)).ok();
    budget.take(sim.work_since(&effort) + sim.tape()).then_some(gains).flatten()
}

fn numbers<R: Real>(list: &[R], lane: usize) -> Vec<f64> {
    list.iter().map(|x| x.lane(lane)).collect()
}

/// One lane of a state.
fn start<R: Real>(state: &State<R>, lane: usize) -> Start {
    let warm = state.warm.iter().map(|w| w.in_lane(lane));
    Start {
        steps: state.steps,
        time: state.start,
        qpos: numbers(&state.qpos, lane),
        qvel: numbers(&state.qvel, lane),
        act: numbers(&state.act, lane),
        ctrl_history: numbers(&state.ctrl_history, lane),
        // A zero impulse equals no impulse, and a lane has zeros for its neighbours' contacts.
        warm: warm.filter(Warm::acts).collect(),
        sleep: state.sleep.cast(),
    }
}

/// One lane of the inputs.
fn held<R: Real>(inputs: &Inputs<R>, lane: usize) -> Held {
    let [ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat] =
        inputs.arrays().map(|list| numbers(list, lane));
    Held { ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat }
}
