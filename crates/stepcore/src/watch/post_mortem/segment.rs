//! The last steps again, from a milestone, with the same dt or another.

use crate::real::Real;
use crate::settings::Settings;
use crate::sim::Sim;
use crate::state::{Inputs, State};
use crate::watch::ledger::{Ledger, Milestone};

/// A gain beside `scale` below which all is well.
const WELL: f64 = 0.1;
/// Steps that the search for a stable dt may take.
const MOST_STEPS: f64 = 40_000.0;

/// A stretch of one world's run: where it starts, and its inputs by step.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Segment<R: Real> {
    pub state: State<R>,
    pub inputs: Inputs<R>,
    /// Steps done since the start before each change of the inputs.
    pub changes: Vec<(u64, Inputs<R>)>,
    pub steps: u64,
}

impl<R: Real> Segment<R> {
    /// A world's run from the last milestone at which all was well to step `until`.
    pub fn since_well(ledger: &Ledger<R>, lane: usize, until: u64) -> Option<Self> {
        let mut kept: Vec<&Milestone<R>> = Vec::new();
        for milestone in ledger.newest_first() {
            kept.push(milestone);
            if milestone.gained[lane] <= WELL && milestone.state.steps < until {
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
        };
        segment.spread(lane);
        segment.changes.retain(|(step, _)| *step <= segment.steps);
        Some(segment)
    }

    /// A run of no step, at the present state.
    pub fn at_present(sim: &Sim<R>, lane: usize) -> Self {
        let (state, inputs) = (sim.state.clone(), sim.inputs.clone());
        let mut segment = Self { state, inputs, changes: Vec::new(), steps: 0 };
        segment.spread(lane);
        segment
    }

    /// One lane's numbers into all lanes.
    fn spread(&mut self, lane: usize) {
        let all = |list: &mut [R]| list.iter_mut().for_each(|x| *x = R::of(x.lane(lane)));
        all(&mut self.state.qpos);
        all(&mut self.state.qvel);
        for warm in &mut self.state.warm {
            all(&mut warm.impulse);
        }
        for inputs in
            [&mut self.inputs].into_iter().chain(self.changes.iter_mut().map(|c| &mut c.1))
        {
            inputs.edit(|arrays| arrays.into_iter().for_each(all));
        }
    }

    /// A world of its own that stands at the start.
    pub fn world(&self, of: &Sim<R>) -> Option<Sim<R>> {
        let mut sim = Sim::new(of.model.clone(), of.settings.clone()).ok()?;
        sim.state = self.state.clone();
        sim.inputs = self.inputs.clone();
        Some(sim)
    }

    /// The inputs that hold before step `step`.
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

    /// What the whole stretch gains with steps of dt / `parts`, and the energy that
    /// circulates; None if it leaves the finite numbers.
    fn gain(&self, of: &Sim<R>, dt: f64, lane: usize) -> Option<[f64; 2]> {
        let mut sim = Sim::new(of.model.clone(), Settings { dt, ..of.settings.clone() }).ok()?;
        let mut ledger = Ledger::new(&of.model);
        sim.state = self.state.clone();
        sim.state.warm.clear();
        let whole = self.steps as f64 * of.clock.seconds;
        let steps = (whole / dt).round() as u64;
        for step in 0..steps {
            let before = ((step as f64 + 0.5) * dt / of.clock.seconds) as u64;
            sim.inputs.clone_from(self.inputs_at(before));
            ledger.step(&mut sim, 1, &mut (), |_, _, _, _, _| Ok(())).ok()?;
        }
        ledger.total(&mut sim, lane)
    }

    /// The largest of dt/2, dt/4, … with which the stretch gains nothing to speak of.
    pub fn halved(&self, of: &Sim<R>, lane: usize) -> Option<f64> {
        let dt = of.clock.seconds;
        let now = self.gain(of, dt, lane).map(|[gained, _]| gained);
        let mut left = MOST_STEPS;
        for halvings in 1..=8 {
            let smaller = dt / f64::from(1 << halvings);
            left -= self.steps as f64 * dt / smaller;
            if left < 0.0 {
                return None;
            }
            if self.holds(of, smaller, lane, now) {
                return Some(smaller);
            }
        }
        None
    }

    /// With steps of `dt` it stays within `swing` times the energy that circulates.
    pub fn swings(&self, of: &Sim<R>, dt: f64, lane: usize, swing: f64) -> bool {
        self.gain(of, dt, lane).is_some_and(|[gained, scale]| gained <= swing * scale)
    }

    /// With steps of `dt` nothing is gained to speak of,
    /// and little beside what is gained `now`.
    pub fn holds(&self, of: &Sim<R>, dt: f64, lane: usize, now: Option<f64>) -> bool {
        let little = 0.05 * now.unwrap_or(f64::INFINITY);
        let small = |[gained, scale]: [f64; 2]| gained <= (0.25 * scale).min(little);
        self.gain(of, dt, lane).is_some_and(small)
    }

    /// Whether what it gains comes from the size of the step.
    pub fn smaller_steps_gain_less(&self, of: &Sim<R>, lane: usize) -> bool {
        let dt = of.clock.seconds;
        let Some([now, _]) = self.gain(of, dt, lane) else { return true };
        [4.0, 16.0]
            .iter()
            .any(|parts| self.gain(of, dt / parts, lane).is_some_and(|[less, _]| less < 0.5 * now))
    }
}
