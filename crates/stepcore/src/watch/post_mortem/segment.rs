//! Repeats the last steps from a milestone, with the same dt or another.

use super::budget::Budget;
use crate::real::Real;
use crate::settings::{Integrator, Settings, Sweeps};
use crate::sim::Sim;
use crate::state::{Inputs, State};
use crate::watch::ledger::{Care, Ledger, Milestone};

/// A gain below this share of `scale` is normal.
const WELL: f64 = 0.1;
/// A trial whose gain is below this share of the original gain gains little.
const LITTLE: f64 = 0.05;
/// The most halvings of dt that are tried.
const HALVINGS: u32 = 8;
/// The largest number of halvings with which a gain is searched for: a spring a million times too
/// stiff for dt is stable with a thousandth of it.
const FINEST: u32 = 16;

/// The outcome of a repeated stretch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Trial {
    /// The energy gained, and the energy that circulated [J].
    Gained { gained: f64, scale: f64 },
    /// It left the finite numbers.
    Diverged,
    /// It would take too long.
    Untried,
}

/// The first of dt/2, dt/4, … with which a stretch has no significant gain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Halved {
    Dt(f64),
    /// None of them.
    NotFound,
    /// They were not all tried.
    Untried,
}

/// A stretch of one world's run: where it starts, and its inputs by step.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Segment<R: Real> {
    pub state: State<R>,
    pub inputs: Inputs<R>,
    /// Steps done since the start before each change of the inputs.
    pub changes: Vec<(u64, Inputs<R>)>,
    pub steps: u64,
    /// The energy that had circulated at its start [J], if it was counted.
    pub scale: Option<f64>,
    /// The lane of its world: its numbers are in all lanes.
    lane: usize,
}

impl<R: Real> Segment<R> {
    /// A world's run from the last good milestone to step `until`.
    pub fn since_well(ledger: &Ledger<R>, lane: usize, until: u64) -> Option<Self> {
        Self::since(ledger, lane, until, |milestone| milestone.gained[lane] <= WELL)
    }

    /// A world's run from the last milestone before step `until`.
    pub fn since_last(ledger: &Ledger<R>, lane: usize, until: u64) -> Option<Self> {
        Self::since(ledger, lane, until, |_| true)
    }

    fn since(
        ledger: &Ledger<R>,
        lane: usize,
        until: u64,
        from: impl Fn(&Milestone<R>) -> bool,
    ) -> Option<Self> {
        let mut kept: Vec<&Milestone<R>> = Vec::new();
        for milestone in ledger.newest_first() {
            kept.push(milestone);
            if milestone.state.steps < until && from(milestone) {
                break;
            }
        }
        let first = kept.pop()?;
        let (mut inputs, mut changes) = (first.inputs.clone(), Vec::new());
        for milestone in [first].into_iter().chain(kept.into_iter().rev()) {
            if milestone.state.steps > first.state.steps {
                inputs = milestone.inputs.clone();
                changes.push((milestone.state.steps - first.state.steps, inputs.clone()));
            }
            let mut at = 0;
            for (steps, changed) in &milestone.changes {
                inputs.edit(|arrays| {
                    for (array, _) in arrays.into_iter().zip(changed).filter(|(_, yes)| **yes) {
                        let count = array.len();
                        array.copy_from_slice(&milestone.numbers[at..at + count]);
                        at += count;
                    }
                });
                changes.push((steps - first.state.steps, inputs.clone()));
            }
        }
        let mut segment = Segment {
            state: first.state.clone(),
            inputs: first.inputs.clone(),
            changes,
            steps: until.checked_sub(first.state.steps)?,
            scale: Some(first.scale[lane]),
            lane,
        };
        segment.spread(lane);
        segment.changes.retain(|(step, _)| *step <= segment.steps);
        Some(segment)
    }

    /// A run of no step, at the present state.
    pub fn at_present(sim: &Sim<R>, lane: usize) -> Self {
        let (state, inputs) = (sim.state.clone(), sim.inputs.clone());
        let mut segment = Self { state, inputs, changes: Vec::new(), steps: 0, scale: None, lane };
        segment.spread(lane);
        segment
    }

    /// Copies one lane's numbers into all lanes.
    fn spread(&mut self, lane: usize) {
        let all = |list: &mut [R]| list.iter_mut().for_each(|x| *x = R::of(x.lane(lane)));
        self.state.lists_mut().into_iter().for_each(|list| all(list));
        for warm in &mut self.state.warm {
            all(&mut warm.impulse);
        }
        for inputs in
            [&mut self.inputs].into_iter().chain(self.changes.iter_mut().map(|c| &mut c.1))
        {
            inputs.edit(|arrays| arrays.into_iter().for_each(all));
        }
    }

    /// A separate world at the start.
    pub fn world(&self, of: &Sim<R>) -> Option<Sim<R>> {
        let mut sim = Sim::new(of.model_of(self.lane).clone(), of.settings.clone()).ok()?;
        sim.state = self.state.clone();
        sim.inputs = self.inputs.clone();
        Some(sim)
    }

    /// The inputs in effect before step `step`.
    fn inputs_at(&self, step: u64) -> &Inputs<R> {
        let last = self.changes.iter().rev().find(|(from, _)| *from <= step);
        last.map_or(&self.inputs, |(_, inputs)| inputs)
    }

    /// Lets `each` do every step, with the inputs in place.
    pub fn play<T>(
        &self,
        sim: &mut Sim<R>,
        mut each: impl FnMut(&mut Sim<R>) -> Option<T>,
    ) -> Option<Vec<T>> {
        let mut done = Vec::new();
        for step in 0..self.steps {
            if let Some((_, inputs)) = self.changes.iter().rev().find(|(from, _)| *from == step) {
                sim.inputs = inputs.clone();
            }
            done.push(each(sim)?);
        }
        Some(done)
    }

    /// The gain of the whole stretch with steps of `dt`, and, with the last inputs held, of as long
    /// again `more` times.
    fn gain(&self, of: &Sim<R>, dt: f64, lane: usize, more: u32, budget: &Budget) -> Trial {
        self.gain_under(Settings { dt, ..of.settings.clone() }, of, lane, more, budget)
    }

    fn gain_under(
        &self,
        settings: Settings,
        of: &Sim<R>,
        lane: usize,
        more: u32,
        budget: &Budget,
    ) -> Trial {
        let dt = settings.dt;
        let model = of.model_of(self.lane).clone();
        let Ok(mut sim) = Sim::new(model, settings) else { return Trial::Untried };
        let mut ledger = Ledger::new(&of.model, Care::Full);
        sim.state = self.state.clone();
        sim.state.warm.clear();
        let whole = self.steps as f64 * of.clock.seconds;
        let steps = (whole / dt).round() * f64::from(1 + more);
        let work = steps * sim.least_step() as f64;
        if work.is_nan() || work > budget.left() as f64 {
            return Trial::Untried;
        }
        let mut most = 0.0_f64;
        for step in 0..steps as u64 {
            let before = ((step as f64 + 0.5) * dt / of.clock.seconds) as u64;
            sim.inputs.clone_from(self.inputs_at(before));
            let effort = sim.effort;
            // A trial is not explained itself.
            let outcome = ledger.step(&mut sim, 1, &mut (), |_, _, _, of, gained| {
                most = if of == lane { most.max(gained.unwrap_or(0.0)) } else { most };
                Ok(())
            });
            if outcome.is_err() {
                return Trial::Diverged;
            }
            if !budget.take(sim.work_since(&effort)) {
                return Trial::Untried;
            }
        }
        match ledger.total(&mut sim, lane) {
            // In a continued trial the largest gain counts, even if it is gone at the end.
            Some([gained, scale]) if more > 0 => Trial::Gained { gained: gained.max(most), scale },
            Some([gained, scale]) => Trial::Gained { gained, scale },
            None => Trial::Diverged,
        }
    }

    /// Whether the stretch with sweeps 'auto' gains almost none of the original gain.
    pub fn auto_gains_less(&self, of: &Sim<R>, lane: usize, gained: f64, budget: &Budget) -> bool {
        let mut settings = Settings { sweeps: Sweeps::Auto, ..of.settings.clone() };
        if settings.tolerance == 0.0 {
            settings.tolerance = Settings::default().tolerance;
        }
        let trial = self.gain_under(settings, of, lane, 0, budget);
        matches!(trial, Trial::Gained { gained: left, .. } if left <= LITTLE * gained)
    }

    /// The gain of semi-implicit over the stretch, as a share of the original gain; None if it is
    /// not below half, or would take too long to find out.
    pub fn under_semi_implicit(&self, of: &Sim<R>, lane: usize, budget: &Budget) -> Option<f64> {
        let settings = Settings { integrator: Integrator::SemiImplicit, ..of.settings.clone() };
        let now = self.gain(of, of.clock.seconds, lane, 0, budget);
        match (now, self.gain_under(settings, of, lane, 0, budget)) {
            (Trial::Gained { gained: now, .. }, Trial::Gained { gained, .. }) => {
                Some((gained / now).max(0.0)).filter(|share| *share < 0.5)
            }
            _ => None,
        }
    }

    /// The largest of dt/2, dt/4, … with which the stretch has no significant gain, nor as long
    /// again `more` times.
    pub fn halved(&self, of: &Sim<R>, lane: usize, more: u32, budget: &Budget) -> Halved {
        let dt = of.clock.seconds;
        let now = self.gain(of, dt, lane, 0, budget);
        for halvings in 1..=HALVINGS {
            let smaller = dt / f64::from(1 << halvings);
            let trial = self.gain(of, smaller, lane, more, budget);
            if trial == Trial::Untried {
                return Halved::Untried;
            }
            if trial.gains_little(now) {
                return Halved::Dt(smaller);
            }
        }
        Halved::NotFound
    }

    /// Whether with steps of `dt` it stays within `swing` times the energy that circulates.
    pub fn swings(
        &self,
        of: &Sim<R>,
        dt: f64,
        lane: usize,
        swing: f64,
        more: u32,
        budget: &Budget,
    ) -> bool {
        let trial = self.gain(of, dt, lane, more, budget);
        matches!(trial, Trial::Gained { gained, scale } if gained <= swing * scale)
    }

    /// Whether its gain comes from the size of the step; None if that would take too long.
    pub fn smaller_steps_gain_less(
        &self,
        of: &Sim<R>,
        lane: usize,
        budget: &Budget,
    ) -> Option<bool> {
        let dt = of.clock.seconds;
        let now = match self.gain(of, dt, lane, 0, budget) {
            Trial::Gained { gained, .. } => gained,
            Trial::Diverged => return Some(true),
            Trial::Untried => return None,
        };
        let (mut known, mut last) = (None, f64::INFINITY);
        for halvings in (2..=FINEST).step_by(2) {
            match self.gain(of, dt / f64::from(1_u32 << halvings), lane, 0, budget) {
                Trial::Gained { gained, .. } if gained < 0.5 * now => return Some(true),
                // Converged: the gain belongs to the scene.
                Trial::Gained { gained, .. } if gained > 0.5 * last && gained < 2.0 * last => {
                    return Some(false)
                }
                Trial::Gained { gained, .. } => (known, last) = (Some(false), gained),
                Trial::Diverged => (known, last) = (Some(false), f64::INFINITY),
                Trial::Untried => break,
            }
        }
        known
    }
}

impl Trial {
    /// Whether nothing significant is gained, and little next to the gain of `now`.
    fn gains_little(self, now: Self) -> bool {
        let most = match now {
            Self::Gained { gained, .. } => LITTLE * gained,
            Self::Diverged | Self::Untried => f64::INFINITY,
        };
        matches!(self, Self::Gained { gained, scale } if gained <= (0.25 * scale).min(most))
    }
}
