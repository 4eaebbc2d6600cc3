//! One world's arrays as the user holds them: `f64`, whatever the engine computes
//! with. They are checked before anything moves, copied in, and copied out again.

use crate::elements::{Element, Kind};
use crate::error::{Error, Result};
use crate::model::Model;
use crate::real::{Mask, Real};
use crate::scene::JointType;
use crate::settings::{Precision, Settings};
use crate::sim::Sim;
use crate::state::{Inputs, State, Warm};

/// The square of a quaternion's length from which it can still be scaled to 1 in any precision.
const SHORTEST_SQUARE: f64 = 1e-30;

/// State and inputs of one world, to be read.
#[derive(Clone, Copy)]
pub struct Given<'a> {
    pub qpos: &'a [f64],
    pub qvel: &'a [f64],
    pub ctrl: &'a [f64],
    pub qfrc_applied: &'a [f64],
    /// Force, then moment, by body: 6 numbers each.
    pub xfrc_applied: &'a [f64],
}

impl Given<'_> {
    /// Refuses what is not finite in the engine's number, and quaternions of no length.
    /// `world`: its index in a batch, for the error text.
    pub fn check<R: Real>(&self, model: &Model, world: Option<usize>) -> Result<()> {
        let bad = |values: &[f64]| values.iter().position(|x| !R::of(*x).is_finite().all());
        let of_joint = |dof: usize| joint_name(model, model.dofs[dof].joint);
        if let Some(k) = bad(self.qpos) {
            let joint = model.joints.iter().rposition(|joint| joint.qpos <= k).unwrap_or(0);
            return Err(refuse::<R>(
                format!("qpos[{k}]"),
                self.qpos[k],
                &joint_name(model, joint),
                world,
            ));
        }
        if let Some(k) = bad(self.qvel) {
            return Err(refuse::<R>(format!("qvel[{k}]"), self.qvel[k], &of_joint(k), world));
        }
        if let Some(k) = bad(self.ctrl) {
            let actuator = model.element_name(Element::whole(Kind::Actuator, k));
            return Err(refuse::<R>(format!("ctrl[{k}]"), self.ctrl[k], &actuator, world));
        }
        if let Some(k) = bad(self.qfrc_applied) {
            return Err(refuse::<R>(
                format!("qfrc_applied[{k}]"),
                self.qfrc_applied[k],
                &of_joint(k),
                world,
            ));
        }
        if let Some(k) = bad(self.xfrc_applied) {
            let (body, part) = (k / 6, k % 6);
            let name = model.element_name(Element::whole(Kind::Body, body));
            let field = format!("xfrc_applied[{body}, {part}]");
            return Err(refuse::<R>(field, self.xfrc_applied[k], &name, world));
        }
        self.check_quaternions::<R>(model, world)
    }

    fn check_quaternions<R: Real>(&self, model: &Model, world: Option<usize>) -> Result<()> {
        for (index, joint) in model.joints.iter().enumerate() {
            let first = match joint.kind {
                JointType::Ball => joint.qpos,
                JointType::Free => joint.qpos + 3,
                JointType::Slide | JointType::Hinge => continue,
            };
            let quat = &self.qpos[first..first + 4];
            let square = quat.iter().fold(R::zero(), |sum, x| sum + R::of(*x) * R::of(*x));
            // Too short to be divided by, or so long that its square overflows.
            if !(square.gt(R::of(SHORTEST_SQUARE)).all() && square.is_finite().all()) {
                let whose = whose(&joint_name(model, index), world);
                let field = format!("qpos[{first}:{}]", first + 4);
                let limit = format!("a quaternion of a length that can be scaled to 1 ({whose}); nothing was stepped");
                return Err(Error::value(field, format!("{quat:?}"), limit));
            }
        }
        Ok(())
    }
}

fn refuse<R: Real>(field: String, value: f64, element: &str, world: Option<usize>) -> Error {
    let kind = if R::EPSILON > f64::EPSILON { "finite in single precision" } else { "finite" };
    Error::value(field, value, format!("{kind} ({}); nothing was stepped", whose(element, world)))
}

fn whose(element: &str, world: Option<usize>) -> String {
    match world {
        Some(world) => format!("{element}, world {world}"),
        None => element.into(),
    }
}

fn joint_name(model: &Model, index: usize) -> String {
    model.element_name(Element::whole(Kind::Joint, index))
}

fn put<R: Real>(to: &mut [R], lane: usize, from: &[f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        to.set_lane(lane, *from);
    }
}

impl<R: Real> State<R> {
    /// Takes one world's positions and velocities; says whether any differed.
    pub fn put(&mut self, lane: usize, given: &Given) -> bool {
        let differs =
            |now: &[R], new: &[f64]| now.iter().zip(new).any(|(now, new)| now.lane(lane) != *new);
        let changed = differs(&self.qpos, given.qpos) || differs(&self.qvel, given.qvel);
        if changed {
            put(&mut self.qpos, lane, given.qpos);
            put(&mut self.qvel, lane, given.qvel);
        }
        changed
    }

    /// Gives one world's positions and velocities.
    pub fn take(&self, lane: usize, qpos: &mut [f64], qvel: &mut [f64]) {
        for (to, from) in qpos.iter_mut().zip(&self.qpos) {
            *to = from.lane(lane);
        }
        for (to, from) in qvel.iter_mut().zip(&self.qvel) {
            *to = from.lane(lane);
        }
    }
}

impl<R: Real> Sim<R> {
    /// Takes one world's arrays, which were checked; says whether its state changed. Lane 0
    /// comes first.
    pub fn put(&mut self, lane: usize, given: &Given) -> bool {
        self.inputs.put(lane, given);
        self.state.put(lane, given)
    }

    /// The world of lane 0 in other numbers, as accurate as `f64`: the same model, settings,
    /// state and inputs.
    pub fn in_doubles<Q: Real>(&self) -> Result<Sim<Q>> {
        let settings =
            Settings { precision: Precision::F64, ledger: false, ..self.settings.clone() };
        let mut sim = Sim::<Q>::new(self.model.clone(), settings)?;
        let plain = |list: &[R]| list.iter().map(|x| x.lane(0)).collect::<Vec<_>>();
        let (qpos, qvel) = (&plain(&self.state.qpos), &plain(&self.state.qvel));
        let [ctrl, qfrc_applied, xfrc_applied] = &self.inputs.arrays().map(plain);
        sim.put(0, &Given { qpos, qvel, ctrl, qfrc_applied, xfrc_applied });
        let number = |x: R| Q::of(x.lane(0));
        let warm = self.state.warm.iter();
        let warm = warm.map(|w| Warm {
            slot: w.slot,
            feature: number(w.feature),
            impulse: w.impulse.map(number),
        });
        sim.state.warm.extend(warm);
        sim.state.sleep = self.state.sleep.cast();
        (sim.state.steps, sim.state.start) = (self.state.steps, self.state.start);
        Ok(sim)
    }
}

impl<R: Real> Inputs<R> {
    /// Takes one world's controls and forces. Lane 0 comes first.
    pub fn put(&mut self, lane: usize, given: &Given) {
        self.set_lane(lane, given.ctrl, given.qfrc_applied, given.xfrc_applied);
    }
}
