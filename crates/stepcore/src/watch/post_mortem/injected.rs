//! The elements that injected the energy of a failure: in which steps, what shares, at what rate.

use std::collections::BTreeMap;

use crate::elements::{Element, Kind};
use crate::model::Model;
use crate::watch::tape::StepGains;

/// Beyond this many times the energy that circulated, inertial forces, which are quadratic, outgrow
/// the original cause.
const AFTERMATH: f64 = 1e6;
/// The most steps that a growth rate is fitted to.
const FITTED: usize = 64;

/// The steps in which the failure started: the last one without more energy than was put in, and
/// the following ones that do not end far beyond that.
pub(super) fn feeding<'a>(
    model: &Model,
    entries: &'a [StepGains],
    scale: Option<f64>,
    gained: bool,
) -> (usize, &'a [StepGains]) {
    let Some(scale) = scale else { return (0, before_aftermath(entries)) };
    let last = entries.last().map_or(0.0, |entry| entry.after.abs());
    // The second attempt is for external drives that have fed all of it.
    for driven in [1.0, 0.0] {
        let can_be = put_in(model, entries, scale, driven);
        let most = can_be.last().copied().unwrap_or(scale);
        if last <= 2.0 * most && !(gained && driven == 0.0) {
            continue;
        }
        // Far beyond all meaningful numbers, rounding makes energies below zero.
        let within = |k: &usize| entries[*k].before.abs() <= can_be[*k];
        let start = (0..entries.len()).rev().find(within).unwrap_or(0);
        let far = |k: &usize| entries[*k].after.abs() > AFTERMATH * can_be[start];
        let end = (start + 1..entries.len()).find(far).unwrap_or(entries.len());
        return (start, &entries[start..end]);
    }
    // All was well until the step that failed.
    (0, &[])
}

/// Without a ledger: the steps up to the one that exceeds `AFTERMATH` times the energy at their
/// start; all of them if none does, or if it happened between the recorded ones.
fn before_aftermath(entries: &[StepGains]) -> &[StepGains] {
    let Some(begin) = entries.iter().map(|entry| entry.before).find(|energy| *energy > 0.0) else {
        return entries;
    };
    let far = |energy: f64| energy.abs() > AFTERMATH * begin || energy.is_nan();
    let end = entries.iter().position(|entry| far(entry.before)).unwrap_or(entries.len());
    let early = &entries[..end];
    // Gravity is never the cause: a large share of it is the rounding of a world at rest.
    let told = shares(early).first().is_some_and(|(element, _)| *element != Element::GRAVITY);
    match early.last() {
        Some(last) if told && far(last.after) => early,
        _ => entries,
    }
}

/// The largest possible energy after each step: the energy that circulated, gravity's work, and,
/// `driven` times, the work of motors and applied forces.
fn put_in(model: &Model, entries: &[StepGains], scale: f64, driven: f64) -> Vec<f64> {
    let (mut drives, mut fallen, mut deepest) = (0.0, 0.0, 0.0_f64);
    let put_in = |entry: &StepGains| {
        let fed = entry.gains.iter().filter(|(element, _)| model.drives(**element));
        let fed: f64 = fed.map(|(_, gain)| gain.max(0.0)).sum();
        fallen += entry.after - entry.before - entry.gains.values().sum::<f64>();
        // The rounding of an explosion is no fall.
        let here = AFTERMATH * (scale + drives + fed + deepest.max(fallen));
        if fed.is_finite() && fallen.is_finite() && entry.after.abs() < here {
            drives += fed;
            deepest = deepest.max(fallen);
        }
        scale + driven * drives + deepest
    };
    entries.iter().map(put_in).collect()
}

/// Each element's part of the growth: a step counts by its gain relative to the present energy, so
/// that the last doublings count no more than the first.
pub(super) fn shares(entries: &[StepGains]) -> Vec<(Element, f64)> {
    let mut sums: BTreeMap<Element, f64> = BTreeMap::new();
    let mut brought = Brought::default();
    for entry in entries {
        let size = entry.before.max(entry.after);
        for (element, gain) in brought.answered_for(entry) {
            let part = gain / size;
            if size > 0.0 && size.is_finite() && part.is_finite() {
                *sums.entry(element).or_insert(0.0) += part;
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

/// The part of the present energy that each element has brought [J]. Inertial forces bring none:
/// their effect on it is charged to the elements that brought it, and to themselves for the initial
/// energy. If an element brings far more than that, bodies move so far in a step that their inertia
/// is no longer the one used by the step.
#[derive(Default)]
struct Brought(BTreeMap<Element, f64>);

impl Brought {
    fn total(&self) -> f64 {
        self.0.values().sum()
    }

    fn scale(&mut self, factor: f64) {
        self.0.values_mut().for_each(|own| *own *= factor);
    }

    /// The gains of the next step, by the elements that are charged with them.
    fn answered_for(&mut self, entry: &StepGains) -> Vec<(Element, f64)> {
        let known = self.total();
        if known > entry.before {
            // Elements that removed energy removed a share of everyone's.
            self.scale(entry.before / known);
        }
        let there = (entry.before - known).max(0.0);
        let all = entry.gains.iter().map(|(element, gain)| (*element, *gain));
        let (inertial, mut gains): (Vec<_>, Vec<_>) =
            all.partition(|(element, _)| element.kind == Kind::Inertia);
        for (element, gain) in gains.iter().filter(|(element, _)| *element != Element::GRAVITY) {
            *self.0.entry(*element).or_insert(0.0) += gain.max(0.0);
        }
        let total = there + self.total();
        let grown = inertial.iter().map(|(_, gain)| gain / total).sum::<f64>();
        for (element, gain) in inertial {
            gains.push((element, gain * (there / total)));
            gains.extend(self.0.iter().map(|(owner, own)| (*owner, gain * (own / total))));
        }
        self.scale((1.0 + grown).max(0.0));
        gains
    }
}

/// The servo whose force was most often at its bound, in at least a share of some steps. It does
/// not damp there, and its effect in a step is larger than intended: other forces then act over
/// distances that they did not cause, and seem to inject.
pub(super) fn saturated(entries: &[StepGains], share: f64) -> Option<Element> {
    let mut counts: BTreeMap<Element, usize> = BTreeMap::new();
    for element in entries.iter().flat_map(|entry| &entry.saturated) {
        *counts.entry(*element).or_insert(0) += 1;
    }
    let (element, count) = counts.into_iter().rev().max_by_key(|(_, count)| *count)?;
    (count as f64 >= share * entries.len() as f64).then_some(element)
}

/// The gain of ln E in a step: the mean over the later half of a stretch, after the initial
/// transient; for single steps the median.
pub(super) fn growth(entries: &[StepGains], stretch: bool) -> Option<f64> {
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
