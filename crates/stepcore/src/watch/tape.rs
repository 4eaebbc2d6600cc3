//! What each element did in one step: its impulse, the work of that impulse, and what it
//! stored meanwhile. Written only when a step is gone through again after a failure.
//!
//! With v̄ = (v + v⁺)/2 and an impulse P = M (v⁺ − v) made of the parts P_e, the change of
//! ½ vᵀMv is exactly Σ v̄ᵀP_e where M does not move. An element's *gain* is v̄ᵀP_e plus the
//! change of what it stores (½ k s² of a spring, −m g·c of gravity, ½ k φ² of a penalty
//! contact): zero in an exact motion, negative where it dissipates. What is left of ΔE in a
//! tree is the integrator's own, charged to the tree's inertial forces, which exactly do none.

use std::collections::BTreeMap;

use crate::elements::{Element, Kind};
use crate::error::Result;
use crate::model::{Model, NONE};
use crate::observer::Observer;
use crate::place::stretch;
use crate::real::{Mask, Real};
use crate::settings::{Integrator, Law};
use crate::sim::Sim;
use crate::spatial::V3;

/// Generalised impulses by element, while a step is written down.
pub struct Tape {
    lane: usize,
    impulses: BTreeMap<Element, Vec<f64>>,
    /// Of the bias forces, by dof.
    bias: Vec<f64>,
}

/// One step: what every element fed in [J], and the energies before and after.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepGains {
    pub gains: BTreeMap<Element, f64>,
    /// Kinetic and stored energy, gravity's left out [J].
    pub before: f64,
    pub after: f64,
}

/// Energies at a state: kinetic by tree, stored by element, and what gravity has.
struct Levels {
    kinetic: Vec<f64>,
    stored: BTreeMap<Element, f64>,
}

const GRAVITY: Element = Element { kind: Kind::Gravity, index: 0, part: Element::WHOLE };
/// Of sums of a few hundred terms, and what f32 adds is left as it is.
const ROUNDING: f64 = 1e-13;

impl Levels {
    /// Kinetic and stored energy without gravity's, which has no natural zero.
    fn circulating(&self) -> f64 {
        let stored = self.stored.iter().filter(|(element, _)| **element != GRAVITY).map(|(_, x)| x);
        self.kinetic.iter().chain(stored).sum()
    }
}

impl Tape {
    fn new(lane: usize, nv: usize) -> Self {
        Self { lane, impulses: BTreeMap::new(), bias: vec![0.0; nv] }
    }

    fn add(&mut self, element: Element, nv: usize, from: usize, parts: &[f64]) {
        if parts.iter().all(|x| *x == 0.0) {
            return;
        }
        let impulse = self.impulses.entry(element).or_insert_with(|| vec![0.0; nv]);
        for (sum, part) in impulse[from..].iter_mut().zip(parts) {
            *sum += part;
        }
    }
}

/// Lets `step` take one step of `sim` under a tape, which writes down what each element did in
/// it, in one lane.
pub(crate) fn taped<R: Real>(
    sim: &mut Sim<R>,
    lane: usize,
    step: impl FnOnce(&mut Sim<R>, &mut Tape) -> Result<()>,
) -> Result<StepGains> {
    let model = sim.model.clone();
    let v0: Vec<f64> = sim.state.qvel.iter().map(|v| v.lane(lane)).collect();
    let before = sim.levels(lane);
    let mut tape = Tape::new(lane, model.nv);
    step(sim, &mut tape)?;
    let Tape { mut impulses, bias, .. } = tape;
    let v1: Vec<f64> = sim.state.qvel.iter().map(|v| v.lane(lane)).collect();
    if sim.damps_implicitly() {
        for (index, joint) in model.joints.iter().enumerate() {
            if let Some(impulse) = impulses.get_mut(&Element::whole(Kind::Damper, index)) {
                for k in joint.dof..joint.dof + joint.dofs() {
                    impulse[k] = -sim.clock.seconds * model.dofs[k].damping * v1[k];
                }
            }
        }
    }
    if sim.settings.integrator == Integrator::ImplicitFast {
        sim.feed_back_late(&mut impulses, &v0, &v1, lane);
    }
    let after = sim.levels(lane);
    let mean: Vec<f64> = v0.iter().zip(&v1).map(|(a, b)| 0.5 * (a + b)).collect();
    Ok(gains(&model, &impulses, &bias, &mean, &before, &after))
}

impl<R: Real> Sim<R> {
    /// `implicitfast` takes a servo's velocity feedback at the end of the step.
    fn feed_back_late(
        &self,
        impulses: &mut BTreeMap<Element, Vec<f64>>,
        v0: &[f64],
        v1: &[f64],
        lane: usize,
    ) {
        let servos = self.model.actuators.iter().enumerate();
        for (index, servo) in servos.filter(|(_, servo)| servo.bias[2] != 0.0) {
            let k = self.model.joints[servo.joint].dof;
            let [_, damping] = self.placed.feedback(servo, index);
            if let Some(impulse) = impulses.get_mut(&Element::whole(Kind::Actuator, index)) {
                impulse[k] -= self.clock.seconds * damping.lane(lane) * (v1[k] - v0[k]);
            }
        }
    }

    fn damps_implicitly(&self) -> bool {
        match self.settings.integrator {
            Integrator::Euler => self.model.features.eulerdamp,
            integrator => integrator == Integrator::ImplicitFast,
        }
    }

    /// A force at a body's centre of mass and a moment, in world axes, on the dofs.
    fn on_dofs(&self, body: usize, lane: usize, force: &V3<f64>, moment: &V3<f64>) -> Vec<f64> {
        let model = &*self.model;
        let mut out = vec![0.0; model.nv];
        let arm = self.centre(body) - self.placed.origin[model.bodies[body].tree];
        let arm = lane_of(&arm, lane);
        for &k in model.bodies[body].chain.of(&model.dof_lists) {
            let motion = &self.placed.motion[k];
            let (ang, lin) = (lane_of(&motion.ang, lane), lane_of(&motion.lin, lane));
            out[k] = force.dot(&(lin + ang.cross(&arm))) + moment.dot(&ang);
        }
        out
    }

    /// How a contact's normal distance changes with every dof.
    pub(crate) fn contact_jacobian(&self, index: usize, lane: usize) -> Vec<f64> {
        let model = &*self.model;
        let contact = &self.detected.contacts[index];
        let pair = &model.pairs[contact.pair];
        let (normal, pos) = (lane_of(&contact.normal, lane), lane_of(&contact.pos, lane));
        let mut out = vec![0.0; model.nv];
        for (geom, sign) in [(pair.geom1, -1.0), (pair.geom2, 1.0)] {
            let body = &model.bodies[model.geoms[geom].body];
            if body.tree == NONE {
                continue;
            }
            let arm = pos - lane_of(&self.placed.origin[body.tree], lane);
            for &k in body.chain.of(&model.dof_lists) {
                let motion = &self.placed.motion[k];
                let (ang, lin) = (lane_of(&motion.ang, lane), lane_of(&motion.lin, lane));
                out[k] += sign * normal.dot(&(lin + ang.cross(&arm)));
            }
        }
        out
    }

    /// Stiffness [N/m] and damping [N·s/m] of a penalty contact along its normal.
    pub(crate) fn penalty_law(&self, jacobian: &[f64]) -> [f64; 2] {
        let mut x: Vec<R> = jacobian.iter().map(|x| R::of(*x)).collect();
        self.placed.metric.solve(&mut x);
        let a: f64 = x.iter().zip(jacobian).map(|(x, j)| x.lane(0) * j).sum();
        let k = self.settings.penalty_stiffness;
        let mass = if a > 0.0 { 1.0 / a } else { 0.0 };
        [k, 2.0 * self.settings.penalty_damping_ratio * (k * mass).sqrt()]
    }

    /// The generalised force of a penalty contact: see `solve/contact.rs`.
    fn penalty_force(&self, index: usize, qvel: &[R], lane: usize) -> Vec<f64> {
        let contact = &self.detected.contacts[index];
        let dist = contact.dist.lane(lane);
        if !contact.mask.lane(lane) || dist >= 0.0 {
            return vec![0.0; self.model.nv];
        }
        let mut jacobian = self.contact_jacobian(index, lane);
        let [k, damping] = self.penalty_law(&jacobian);
        let speed: f64 = jacobian.iter().zip(qvel).map(|(j, v)| j * v.lane(lane)).sum();
        let force = -k * dist - damping * speed;
        jacobian.iter_mut().for_each(|x| *x *= force);
        jacobian
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
        let mut stored = BTreeMap::new();
        for (index, joint) in model.joints.iter().enumerate().filter(|(_, j)| j.stiffness != 0.0) {
            let (away, count) = stretch(&model, joint, &self.state.qpos);
            let square: f64 = away[..count].iter().map(|s| s.lane(lane).powi(2)).sum();
            stored.insert(Element::whole(Kind::Spring, index), 0.5 * joint.stiffness * square);
        }
        if model.features.actuation {
            for (index, servo) in model.actuators.iter().enumerate() {
                let energy = self.stored_in_servo(index, self.inputs.ctrl[index]).lane(lane);
                if servo.bias[1] < 0.0 {
                    stored.insert(Element::whole(Kind::Actuator, index), energy);
                }
            }
        }
        if model.features.gravity {
            let moving = model.bodies.iter().enumerate().filter(|(_, body)| body.tree != NONE);
            let weigh = |(index, body): (usize, &crate::model::Body)| {
                -body.mass * model.gravity.dot(&lane_of(&self.centre(index), lane))
            };
            stored.insert(GRAVITY, moving.map(weigh).sum());
        }
        if self.settings.law == Law::Penalty {
            self.detected.detect(&model, &self.placed, &self.settings, &self.state.qpos);
            for index in 0..self.detected.contacts.len() {
                let contact = &self.detected.contacts[index];
                let depth = contact.dist.lane(lane).min(0.0);
                let name = self.detected.contacts[index].element().of_part();
                if contact.mask.lane(lane) {
                    *stored.entry(name).or_insert(0.0) +=
                        0.5 * self.settings.penalty_stiffness * depth * depth;
                }
            }
        }
        Levels { kinetic, stored }
    }
}

impl<R: Real> Observer<R> for Tape {
    /// Adds the impulses of the smooth forces.
    fn placed(&mut self, sim: &Sim<R>, qvel: &[R], weight: f64) {
        let (model, lane) = (&*sim.model, self.lane);
        let share = weight * sim.clock.seconds;
        let nv = model.nv;
        for (sum, bias) in self.bias.iter_mut().zip(&sim.placed.bias) {
            *sum -= share * bias.lane(lane);
        }
        for (index, joint) in model.joints.iter().enumerate() {
            let dofs = joint.dof..joint.dof + joint.dofs();
            let damping = |k: usize| model.dofs[k].damping * qvel[k].lane(lane);
            let damper: Vec<f64> = dofs.clone().map(|k| -share * damping(k)).collect();
            self.add(Element::whole(Kind::Damper, index), nv, joint.dof, &damper);
            let passive = |k: usize| sim.placed.passive[k].lane(lane);
            let spring: Vec<f64> =
                dofs.clone().map(|k| share * (passive(k) + damping(k))).collect();
            if joint.stiffness != 0.0 {
                self.add(Element::whole(Kind::Spring, index), nv, joint.dof, &spring);
            }
            let applied = |k: usize| share * sim.inputs.qfrc_applied()[k].lane(lane);
            let applied: Vec<f64> = dofs.map(applied).collect();
            self.add(Element::whole(Kind::JointForce, index), nv, joint.dof, &applied);
        }
        for (index, motor) in model.actuators.iter().enumerate() {
            let joint = &model.joints[motor.joint];
            let force = share * sim.placed.actuator[index].lane(lane);
            let parts: Vec<f64> = (0..joint.dofs()).map(|k| motor.gear[k] * force).collect();
            self.add(Element::whole(Kind::Actuator, index), nv, joint.dof, &parts);
        }
        let still = V3::<f64>::zeros();
        for (index, body) in model.bodies.iter().enumerate().filter(|(_, body)| body.tree != NONE) {
            if model.features.gravity && body.mass > 0.0 {
                let weight = model.gravity * (share * body.mass);
                self.add(GRAVITY, nv, 0, &sim.on_dofs(index, lane, &weight, &still));
            }
            let given = &sim.inputs.xfrc_applied()[6 * index..6 * index + 6];
            let given: Vec<f64> = given.iter().map(|x| share * x.lane(lane)).collect();
            if given.iter().any(|x| *x != 0.0) {
                let (force, moment) = given.split_at(3);
                let force = V3::new(force[0], force[1], force[2]);
                let moment = V3::new(moment[0], moment[1], moment[2]);
                let parts = sim.on_dofs(index, lane, &force, &moment);
                self.add(Element::whole(Kind::BodyForce, index), nv, 0, &parts);
            }
        }
    }

    /// Adds the impulses of rows and penalty contacts.
    fn solved(&mut self, sim: &Sim<R>, qvel: &[R], weight: f64) {
        let (model, lane) = (&*sim.model, self.lane);
        for block in sim.rows.blocks.iter().filter(|block| block.mask.lane(lane)) {
            let mut impulse = vec![R::zero(); model.nv];
            for row in &sim.rows.rows[block.rows.range()] {
                let dofs = row.dofs.of(&model.dof_lists);
                for (k, y) in dofs.iter().zip(&sim.rows.y[row.y..]) {
                    impulse[*k] += *y * row.impulse;
                }
            }
            sim.placed.metric.lower(&mut impulse);
            let impulse: Vec<f64> = impulse.iter().map(|x| weight * x.lane(lane)).collect();
            self.add(block.element.of_part(), model.nv, 0, &impulse);
        }
        if sim.settings.law == Law::Penalty {
            for (index, contact) in sim.detected.contacts.iter().enumerate() {
                let mut impulse = sim.penalty_force(index, qvel, lane);
                impulse.iter_mut().for_each(|x| *x *= weight * sim.clock.seconds);
                self.add(contact.element().of_part(), model.nv, 0, &impulse);
            }
        }
    }
}

/// Gains out of impulses and levels; what is left in a tree goes to its inertial forces.
fn gains(
    model: &Model,
    impulses: &BTreeMap<Element, Vec<f64>>,
    bias: &[f64],
    mean: &[f64],
    before: &Levels,
    after: &Levels,
) -> StepGains {
    let mut gains: BTreeMap<Element, f64> = BTreeMap::new();
    // What was taken off, in size: a difference that is only rounding beside it is none.
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
        // Named by the joint on which they worked most.
        let weight = |k: usize| impulses.get(&GRAVITY).map_or(0.0, |gravity| gravity[k]);
        let worked = |k: &usize| ((bias[*k] - weight(*k)) * mean[*k]).abs();
        let most = tree.dofs.range().max_by(|a, b| worked(a).total_cmp(&worked(b)));
        let joint = model.dofs[most.unwrap_or(tree.dofs.start)].joint;
        *gains.entry(Element::whole(Kind::Inertia, joint)).or_insert(0.0) += left;
    }
    StepGains { gains, before: before.circulating(), after: after.circulating() }
}

fn lane_of<R: Real>(v: &V3<R>, lane: usize) -> V3<f64> {
    V3::new(v.x.lane(lane), v.y.lane(lane), v.z.lane(lane))
}
