//! After a failure: the last stretch again with everything written down, and one paragraph.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::tape::StepGains;
use super::trial::Segment;
use super::Ledger;
use crate::elements::{Element, Named};
use crate::error::Error;
use crate::model::Model;
use crate::real::Real;
use crate::settings::Integrator;
use crate::sim::Sim;
use crate::state::{Inputs, State, Warm};

/// Beyond this many times the energy that circulated, inertial forces, which are quadratic,
/// outgrow whatever started it.
const AFTERMATH: f64 = 1e6;
/// The most steps that a growth rate is fitted to.
const FITTED: usize = 64;
/// Without a ledger, trees up to this many dofs are looked into.
const SMALL: usize = 12;

/// Which dt would have been stable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stable {
    /// Nothing is known.
    Unknown,
    /// The springs' and dampers' own limit [s]; run again just below it, or not.
    Springs { dt: f64, tried: bool },
    /// The integrator feeds springs at every dt; `semi_implicit`: the limit of that one [s],
    /// None where it is stable at the present dt.
    Never { semi_implicit: Option<f64> },
    /// The last stretch was run again with halved steps [s].
    Halved { dt: f64 },
    /// Halving did not help.
    NotFound,
}

/// What a failed run tells about itself: one world, in `f64`.
#[derive(Clone, Debug, PartialEq)]
pub struct PostMortem {
    /// From here, with these inputs, the failure comes again after `steps` steps.
    pub start: State<f64>,
    pub inputs: Inputs<f64>,
    pub changes: Vec<(u64, Inputs<f64>)>,
    pub steps: u64,
    /// More energy than there can be; else something is not finite in the step that follows.
    pub gained: bool,
    /// Part of the growth by element, the largest first.
    pub shares: Vec<(Named, f64)>,
    /// The step from which it grew.
    pub since: Option<u64>,
    /// Kinetic and stored energy grow by exp(growth) a step.
    pub growth: Option<f64>,
    pub stable: Stable,
    pub dt: f64,
    pub integrator: Integrator,
}

impl<R: Real> Sim<R> {
    /// The error for a lane whose run failed, from what is known of how it came there.
    pub(crate) fn found(
        &mut self,
        ledger: Option<&Ledger<R>>,
        lane: usize,
        quantity: String,
        gained: bool,
    ) -> Error {
        let until = self.state.steps;
        let replayed = ledger.and_then(|ledger| ledger.segment(&self.model, lane, until)).and_then(
            |segment| self.written_down(&segment, lane).map(|entries| (segment, entries)),
        );
        let scale = ledger.and_then(|ledger| ledger.accounts.get(lane)).map(|a| a.scale);
        let (segment, entries, exact) = match replayed {
            Some((segment, entries)) => (segment, entries, true),
            None => {
                let entries = self.kept_steps(lane);
                let (state, inputs) = (self.state.clone(), self.inputs.clone());
                let mut segment = Segment { state, inputs, changes: Vec::new(), steps: 0 };
                segment.spread(lane);
                (segment, entries, false)
            }
        };
        let (from, window) = feeding(&self.model, &entries, scale, gained);
        let shares = shares(window);
        let element = match shares.first() {
            Some((element, _)) => Some(*element),
            None => self.strongest(lane, exact && window.is_empty()),
        };
        let model = self.model.clone();
        let element = element.map(|element| model.named(element));
        let shares = shares.into_iter().map(|(element, share)| (model.named(element), share));
        let stable = if exact && window.is_empty() {
            Stable::Unknown
        } else {
            self.stable(&segment, lane, exact)
        };
        let post = PostMortem {
            start: one_lane(&segment.state, lane),
            inputs: one_lane_of(&segment.inputs, lane),
            changes: segment.changes.iter().map(|(k, i)| (*k, one_lane_of(i, lane))).collect(),
            steps: segment.steps,
            gained,
            shares: shares.collect(),
            since: exact.then(|| segment.state.steps + from as u64),
            growth: growth(window, exact),
            stable,
            dt: self.settings.dt,
            integrator: self.settings.integrator,
        };
        Error::Diverged {
            step: until,
            time: self.state.time(self.settings.dt),
            world: lane,
            element,
            quantity,
            post: Box::new(post),
        }
    }

    /// The stretch step by step; None where it does not end in the state at hand.
    fn written_down(&self, segment: &Segment<R>, lane: usize) -> Option<Vec<StepGains>> {
        let mut sim = segment.world(self)?;
        let entries = segment.play(&mut sim, |sim| sim.taped_step(lane).ok())?;
        let same = |a: &[R], b: &[R]| {
            a.iter().zip(b).all(|(a, b)| a.lane(lane).to_bits() == b.lane(lane).to_bits())
        };
        (same(&sim.state.qpos, &self.state.qpos) && same(&sim.state.qvel, &self.state.qvel))
            .then_some(entries)
    }

    /// Without a ledger: the steps from the last states, started without their impulses.
    fn kept_steps(&self, lane: usize) -> Vec<StepGains> {
        let (state, inputs) = (self.state.clone(), self.inputs.clone());
        let mut segment = Segment { state, inputs, changes: Vec::new(), steps: 0 };
        segment.spread(lane);
        let Some(mut sim) = segment.world(self) else { return Vec::new() };
        let all = |to: &mut [R], from: &[R]| {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = R::of(from.lane(lane)));
        };
        let mut entries = Vec::new();
        for (qpos, qvel) in self.past.states() {
            all(&mut sim.state.qpos, qpos);
            all(&mut sim.state.qvel, qvel);
            sim.state.warm.clear();
            entries.extend(sim.taped_step(lane).ok());
        }
        entries
    }

    /// Which dt would have been stable, as far as it can be told cheaply.
    fn stable(&mut self, segment: &Segment<R>, lane: usize, exact: bool) -> Stable {
        let Some(mut start) = segment.world(self) else { return Stable::Unknown };
        if !exact && self.model.trees.iter().any(|tree| tree.dofs.len > SMALL) {
            return Stable::Unknown;
        }
        let integrator = self.settings.integrator;
        match start.spring_limit(lane, integrator) {
            Some(0.0) => {
                let semi_implicit = start.spring_limit(lane, Integrator::SemiImplicit);
                Stable::Never { semi_implicit }
            }
            Some(dt) => {
                let below = 0.95 * dt;
                let swing = start.swing(lane, below);
                Stable::Springs { dt, tried: exact && segment.swings(self, below, lane, swing) }
            }
            None if exact => {
                segment.halved(self, lane).map_or(Stable::NotFound, |dt| Stable::Halved { dt })
            }
            None => Stable::Unknown,
        }
    }
}

/// The steps in which it began: from the last one in which there was no more than can have
/// been put in, until far beyond that.
fn feeding<'a>(
    model: &Model,
    entries: &'a [StepGains],
    scale: Option<f64>,
    gained: bool,
) -> (usize, &'a [StepGains]) {
    let Some(scale) = scale else { return (0, entries) };
    let last = entries.last().map_or(0.0, |entry| entry.after);
    // Or what drives from outside has fed all of it.
    for driven in [1.0, 0.0] {
        let can_be = put_in(model, entries, scale, driven);
        let most = can_be.last().copied().unwrap_or(scale);
        if last <= 2.0 * most && !(gained && driven == 0.0) {
            continue;
        }
        let within = |k: &usize| entries[*k].before <= can_be[*k];
        let start = (0..entries.len()).rev().find(within).unwrap_or(0);
        let far = |k: &usize| entries[*k].before > AFTERMATH * can_be[start];
        let end = (start + 1..entries.len()).find(far).unwrap_or(entries.len());
        return (start, &entries[start..end]);
    }
    // All was well until the step that failed.
    (0, &[])
}

/// The most energy that there can be after each step: what circulated, what gravity gave, and,
/// `driven` times, what motors and applied forces did.
fn put_in(model: &Model, entries: &[StepGains], scale: f64, driven: f64) -> Vec<f64> {
    let (mut drives, mut fallen, mut deepest) = (0.0, 0.0, 0.0_f64);
    let put_in = |entry: &StepGains| {
        let fed = entry.gains.iter().filter(|(element, _)| model.drives(**element));
        let fed: f64 = fed.map(|(_, gain)| gain.max(0.0)).sum();
        fallen += entry.after - entry.before - entry.gains.values().sum::<f64>();
        // Rounding of what explodes is nothing that fell.
        let here = AFTERMATH * (scale + drives + fed + deepest.max(fallen));
        if fed.is_finite() && fallen.is_finite() && entry.after < here {
            drives += fed;
            deepest = deepest.max(fallen);
        }
        scale + driven * drives + deepest
    };
    entries.iter().map(put_in).collect()
}

/// Each element's part of the growth: a step counts by how much it adds, relative to what
/// there is, so that the last doublings count no more than the first.
fn shares(entries: &[StepGains]) -> Vec<(Element, f64)> {
    let mut sums: BTreeMap<Element, f64> = BTreeMap::new();
    for entry in entries {
        let size = entry.before.max(entry.after);
        for (element, gain) in &entry.gains {
            let part = gain / size;
            if size > 0.0 && size.is_finite() && part.is_finite() {
                *sums.entry(*element).or_insert(0.0) += part;
            }
        }
    }
    let fed: f64 = sums.values().filter(|x| **x > 0.0).sum();
    let mut shares: Vec<(Element, f64)> = sums
        .into_iter()
        .filter(|(_, sum)| fed > 0.0 && *sum > 0.0)
        .map(|(element, sum)| (element, sum / fed))
        .collect();
    shares.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
    shares
}

/// What ln E gains in a step: the mean of the later half of a stretch, after what it began
/// with; of single steps the median.
fn growth(entries: &[StepGains], stretch: bool) -> Option<f64> {
    let half = if stretch { entries.len() / 2 } else { 0 };
    let from = half.max(entries.len().saturating_sub(FITTED));
    let mut rates: Vec<f64> = entries[from..]
        .iter()
        .map(|entry| (entry.after / entry.before).ln())
        .filter(|rate| rate.is_finite())
        .collect();
    rates.sort_by(f64::total_cmp);
    let middle = rates.get(rates.len().saturating_sub(1) / 2).copied()?;
    let mean = rates.iter().sum::<f64>() / rates.len() as f64;
    Some(if stretch { mean } else { middle }).filter(|rate| *rate > 0.0)
}

fn one_lane<R: Real>(state: &State<R>, lane: usize) -> State<f64> {
    let of = |list: &[R]| list.iter().map(|x| x.lane(lane)).collect();
    // An impulse of zero is as good as none, and a lane has zeros for its neighbours' contacts.
    let warm =
        state.warm.iter().map(|w| Warm { slot: w.slot, impulse: w.impulse.map(|x| x.lane(lane)) });
    State {
        steps: state.steps,
        start: state.start,
        qpos: of(&state.qpos),
        qvel: of(&state.qvel),
        warm: warm.filter(|w| w.impulse.iter().any(|x| *x != 0.0)).collect(),
    }
}

fn one_lane_of<R: Real>(inputs: &Inputs<R>, lane: usize) -> Inputs<f64> {
    let of = |list: &[R]| list.iter().map(|x| x.lane(lane)).collect();
    Inputs {
        ctrl: of(&inputs.ctrl),
        qfrc_applied: of(&inputs.qfrc_applied),
        xfrc_applied: of(&inputs.xfrc_applied),
        applied: inputs.applied,
    }
}

impl PostMortem {
    /// The part of the paragraph that says where the energy came from and what would help.
    pub fn sentence(&self) -> String {
        let mut text = String::new();
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        if let Some((name, share)) = self.shares.first() {
            let since = self
                .since
                .map_or("over the steps that are kept".into(), |step| format!("since step {step}"));
            let _ = write!(text, "; of the energy fed in {since} {name} gave {}", percent(*share));
            if let Some((name, share)) = self.shares.get(1).filter(|(_, share)| *share >= 0.005) {
                let _ = write!(text, ", {name} {}", percent(*share));
            }
        }
        if let Some(growth) = self.growth {
            let _ = write!(
                text,
                "; the energy of motion and springs grows {} times a step (at a rate of {} /s)",
                times(growth.exp()),
                times(growth / self.dt)
            );
        }
        let name = self.integrator.name();
        let _ = match self.stable {
            Stable::Unknown => Ok(()),
            Stable::Springs { dt, tried } => write!(
                text,
                "; under {name} the springs, dampers and servos here are stable below dt = {} s ({})",
                times(dt),
                if tried {
                    "from their own linear step; the same stretch run again just below it stays bounded"
                } else {
                    "from their own linear step"
                }
            ),
            Stable::Never { semi_implicit } => write!(
                text,
                "; no dt is stable, {name} feeds these springs at every step; semi-implicit is \
                 stable {}",
                semi_implicit.map_or("at this dt".into(), |dt| format!("below dt = {} s", times(dt)))
            ),
            Stable::Halved { dt } => write!(
                text,
                "; with dt = {} s the same stretch gains next to nothing (run again with halved steps)",
                times(dt)
            ),
            Stable::NotFound => {
                write!(text, "; the same stretch run again with halved steps gains as well")
            }
        };
        text
    }
}

/// A number of a few digits, in whichever way is short.
pub(crate) fn times(x: f64) -> String {
    if x.is_infinite() {
        format!("more than {:.1e}", f64::MAX)
    } else if x == 0.0 {
        "0".into()
    } else if (1e-3..1e4).contains(&x) {
        let digits = (3 - x.log10().floor() as i32).clamp(0, 6) as usize;
        format!("{x:.digits$}")
    } else {
        format!("{x:.2e}")
    }
}
