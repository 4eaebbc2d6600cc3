//! The effect of each element in one step: its impulse, the work of that impulse, and the change of
//! its stored energy. Recorded only when a step is repeated after a failure.
//!
//! With v̄ = (v + v⁺)/2 and an impulse P = M (v⁺ − v) made of the parts P_e, the change of ½ vᵀMv
//! is exactly Σ v̄ᵀP_e where M does not move. An element's *gain* is v̄ᵀP_e plus the change of its
//! stored energy (½ k s² of a spring, −m g·c of gravity, ½ k φ² of a penalty contact): zero in an
//! exact motion, negative where it dissipates. The rest of ΔE in a tree is due to the integrator,
//! charged to the tree's inertial forces, which exactly do no work.

use std::collections::{BTreeMap, BTreeSet};

use crate::elements::actuator::saturated;
use crate::elements::force::Group;
use crate::elements::forces::{damping_by_element, each, holding, stored};
use crate::elements::{penalty, Element, Kind};
use crate::error::Result;
use crate::model::{Model, Span};
use crate::observer::Observer;
use crate::real::{Mask, Real};
use crate::settings::Law;
use crate::sim::{At, Sim};

/// Generalised impulses by element, while a step is recorded.
pub struct Tape {
    lane: usize,
    impulses: BTreeMap<Element, Vec<f64>>,
    /// Impulses of the bias forces, by dof.
    bias: Vec<f64>,
    /// Servos whose force was at its bound.
    saturated: BTreeSet<Element>,
}

/// One step: the energy that every element injected [J], and the energies before and after.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepGains {
    pub gains: BTreeMap<Element, f64>,
    /// Kinetic and stored energy, without gravity's [J].
    pub before: f64,
    pub after: f64,
    /// Servos whose force was at its bound.
    pub saturated: BTreeSet<Element>,
}

/// For an element and two dofs: a stiffness and a damping.
type LateSlope = (Element, [usize; 2], [f64; 2]);

/// Energies at a state: kinetic by tree, stored by element, and gravity's.
struct Levels {
    kinetic: Vec<f64>,
    stored: BTreeMap<Element, f64>,
}

/// Rounding of sums of a few hundred terms; additional f32 rounding is not removed.
const ROUNDING: f64 = 1e-13;

impl Levels {
    /// Kinetic and stored energy without gravity's, which has no natural zero.
    fn circulating(&self) -> f64 {
        let stored =
            self.stored.iter().filter(|(element, _)| **element != Element::GRAVITY).map(|(_, x)| x);
        self.kinetic.iter().chain(stored).sum()
    }
}

impl Tape {
    fn new(lane: usize, nv: usize) -> Self {
        let (impulses, saturated) = (BTreeMap::new(), BTreeSet::new());
        Self { lane, impulses, bias: vec![0.0; nv], saturated }
    }

    /// Adds a part of an element's impulse on one dof.
    fn add(&mut self, element: Element, dof: usize, part: f64) {
        if part != 0.0 {
            let nv = self.bias.len();
            let impulse = self.impulses.entry(element.of_part()).or_insert_with(|| vec![0.0; nv]);
            impulse[dof] += part;
        }
    }
}

/// Lets `step` take one step of `sim` under a tape, which records the effect of each element in it,
/// in one lane.
pub(crate) fn taped<R: Real>(
    sim: &mut Sim<R>,
    lane: usize,
    step: impl FnOnce(&mut Sim<R>, &mut Tape) -> Result<()>,
) -> Result<StepGains> {
    let model = sim.model_of(lane).clone();
    let v0: Vec<f64> = sim.state.qvel.iter().map(|v| v.lane(lane)).collect();
    let before = sim.levels(lane);
    let late = sim.late_slopes(lane);
    let mut tape = Tape::new(lane, model.nv);
    step(sim, &mut tape)?;
    let v1: Vec<f64> = sim.state.qvel.iter().map(|v| v.lane(lane)).collect();
    let dt = sim.clock.seconds;
    for (element, [i, j], [stiffness, damping]) in late {
        // Forces at the end of the step: the addition of their slopes to the earlier forces.
        let more = damping * (v1[j] - v0[j]) + stiffness * dt * v1[j];
        tape.add(element, i, -dt * more);
    }
    let Tape { impulses, bias, saturated, .. } = tape;
    let after = sim.levels(lane);
    let mean: Vec<f64> = v0.iter().zip(&v1).map(|(a, b)| 0.5 * (a + b)).collect();
    Ok(StepGains { saturated, ..gains(&model, &impulses, &bias, &mean, &before, &after) })
}

impl<R: Real> Sim<R> {
    /// The generalised force of every element that pushes, after `forward`, in one lane [N or N·m]:
    /// impulses of a step over its length.
    pub fn element_forces(&self, lane: usize) -> BTreeMap<Element, Vec<f64>> {
        let mut tape = Tape::new(lane, self.model.nv);
        tape.placed(self, At::State, 1.0);
        tape.solved(self, At::State, 1.0);
        for impulse in tape.impulses.values_mut() {
            impulse.iter_mut().for_each(|x| *x /= self.clock.seconds);
        }
        tape.impulses
    }

    /// Stiffness and damping that the integrator takes at the end of a step from the state at which
    /// the levels were measured.
    fn late_slopes(&self, lane: usize) -> Vec<LateSlope> {
        let (now, mut list) = (self.moment(At::State), Vec::new());
        let scheme = self.settings.integrator.scheme();
        if scheme.stiffness {
            holding(&now, &mut |element, i, j, slopes| {
                list.push((element, [i, j], slopes.map(|slope| slope.lane(lane))));
            });
            return list;
        }
        let Some(late) = scheme.late(self.model.features.eulerdamp) else { return list };
        damping_by_element(&now, late, &mut |element, i, j, damping| {
            if self.model.entry(i, j).is_some() {
                list.push((element, [i, j], [0.0, damping.lane(lane)]));
            }
        });
        list
    }

    /// Energies at the present state of one lane.
    fn levels(&mut self, lane: usize) -> Levels {
        self.refresh();
        let model = self.model.clone();
        let mut kinetic = vec![0.0; model.trees.len()];
        for (k, dof) in model.dofs.iter().enumerate() {
            let v = self.state.qvel[k].lane(lane);
            for (nth, at) in dof.row.range().enumerate() {
                let other = self.state.qvel[model.row_dofs[at]].lane(lane);
                let half = if nth == 0 { 0.5 } else { 1.0 };
                kinetic[dof.tree] += half * self.placed.mass[at].lane(lane) * v * other;
            }
        }
        Levels { kinetic, stored: self.stored_by_element(lane) }
    }

    /// The stored energy of each element, placed by `refresh`, in one lane [J].
    pub(super) fn stored_by_element(&mut self, lane: usize) -> BTreeMap<Element, f64> {
        let model = self.model.clone();
        let mut energies = BTreeMap::new();
        let mut add = |element: Element, energy: f64| {
            if energy != 0.0 && model.moves(element) {
                *energies.entry(element.of_part()).or_insert(0.0) += energy;
            }
        };
        let now = self.moment(At::State);
        for group in [Group::Passive, Group::Driven, Group::Weight] {
            stored(&now, group, &mut |element, energy| add(element, energy.lane(lane)));
        }
        if self.settings.law == Law::Penalty {
            let detected = self.detect_again();
            for contact in &detected.contacts {
                let energy = penalty::stored(&self.settings, contact);
                add(contact.element(), energy.lane(lane));
            }
        }
        energies
    }
}

impl<R: Real> Observer<R> for Tape {
    /// Adds the impulses of the smooth forces.
    fn placed(&mut self, sim: &Sim<R>, at: At, weight: f64) {
        let (lane, share) = (self.lane, weight * sim.clock.seconds);
        for (sum, bias) in self.bias.iter_mut().zip(&sim.placed.bias) {
            *sum -= share * bias.lane(lane);
        }
        let now = sim.moment(at);
        each(&now, &mut |element, dof, force| self.add(element, dof, share * force.lane(lane)));
        let servos = sim.model.bounded_servos();
        let saturated = servos.filter(|index| saturated(&now, *index).lane(lane));
        self.saturated.extend(saturated.map(|index| Element::whole(Kind::Actuator, index)));
    }

    /// Adds the impulses of rows and penalty contacts.
    fn solved(&mut self, sim: &Sim<R>, _: At, weight: f64) {
        let lane = self.lane;
        sim.each_row_impulse(lane, |element, dof, impulse| {
            self.add(element, dof, weight * impulse.lane(lane));
        });
    }
}

impl<R: Real> Sim<R> {
    /// Calls `each(element, dof, impulse)` for the rows and penalty contacts that act in a lane:
    /// Lᵀ Σ yλ of the rows of each block.
    pub(super) fn each_row_impulse(&self, lane: usize, mut each: impl FnMut(Element, usize, R)) {
        let lists = self.detected.dof_lists(&self.model);
        let mut impulse = vec![R::zero(); self.model.nv];
        let mut add = |element: Element, rows: &mut dyn Iterator<Item = (Span, usize, R)>| {
            impulse.fill(R::zero());
            for (dofs, y, own) in rows {
                for (k, y) in dofs.of(lists).iter().zip(&self.rows.y[y..]) {
                    impulse[*k] += *y * own;
                }
            }
            self.placed.metric.lower(&mut impulse);
            for (dof, part) in impulse.iter().enumerate() {
                each(element, dof, *part);
            }
        };
        for block in self.rows.blocks.iter().filter(|block| block.mask.lane(lane)) {
            let rows = self.rows.rows[block.rows.range()].iter();
            add(block.element, &mut rows.map(|row| (row.dofs, row.y, row.impulse)));
        }
        for push in &self.rows.pushes {
            let row = (push.dofs, push.y, push.impulse);
            add(push.element, &mut [row].into_iter());
        }
    }
}

/// Computes gains from impulses and levels; the rest in a tree goes to its inertial forces.
fn gains(
    model: &Model,
    impulses: &BTreeMap<Element, Vec<f64>>,
    bias: &[f64],
    mean: &[f64],
    before: &Levels,
    after: &Levels,
) -> StepGains {
    let mut gains: BTreeMap<Element, f64> = BTreeMap::new();
    // The size of the subtracted terms: a difference that is their rounding counts as zero.
    let mut size: Vec<f64> =
        after.kinetic.iter().zip(&before.kinetic).map(|(after, before)| after + before).collect();
    let mut left: Vec<f64> =
        after.kinetic.iter().zip(&before.kinetic).map(|(after, before)| after - before).collect();
    for (element, impulse) in impulses {
        for (k, (impulse, mean)) in impulse.iter().zip(mean).enumerate() {
            *gains.entry(*element).or_insert(0.0) += impulse * mean;
            left[model.dofs[k].tree] -= impulse * mean;
            size[model.dofs[k].tree] += (impulse * mean).abs();
        }
    }
    for element in before.stored.keys().chain(after.stored.keys()) {
        gains.entry(*element).or_insert(0.0);
    }
    for (element, gain) in &mut gains {
        let of = |levels: &Levels| levels.stored.get(element).copied().unwrap_or(0.0);
        *gain += of(after) - of(before);
    }
    for ((tree, left), size) in model.trees.iter().zip(left).zip(size) {
        if left.abs() <= ROUNDING * size {
            continue;
        }
        // Named by the joint on which they did most work.
        let weight = |k: usize| impulses.get(&Element::GRAVITY).map_or(0.0, |gravity| gravity[k]);
        let worked = |k: &usize| ((bias[*k] - weight(*k)) * mean[*k]).abs();
        let most = tree.dofs.range().max_by(|a, b| worked(a).total_cmp(&worked(b)));
        let joint = model.dofs[most.unwrap_or(tree.dofs.start)].joint;
        *gains.entry(Element::whole(Kind::Inertia, joint)).or_insert(0.0) += left;
    }
    let (before, after) = (before.circulating(), after.circulating());
    StepGains { gains, before, after, saturated: BTreeSet::new() }
}
