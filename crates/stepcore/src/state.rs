//! What a step changes, and what the user puts in from outside.

use crate::model::Model;
use crate::real::Real;
use crate::room::room;

/// The impulses of one contact, limit or other source, kept for the next step's start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warm<R: Real> {
    /// Which source (see `Block::slot`); ascending in the list.
    pub slot: u32,
    /// By row of its block [N·s or N·m·s]; zero beyond.
    pub impulse: [R; 6],
}

/// A complete snapshot: restored, a run continues bit for bit.
#[derive(Clone, Debug, PartialEq)]
pub struct State<R: Real> {
    /// Steps since `start`, and the time there [s]: time = start + steps · dt.
    pub steps: u64,
    pub start: f64,
    /// Positions [m, rad, unit quaternions w x y z], in MuJoCo's order; nq entries.
    pub qpos: Vec<R>,
    /// Velocities [m/s, rad/s], in MuJoCo's order; nv entries.
    pub qvel: Vec<R>,
    pub warm: Vec<Warm<R>>,
}

room!(State<R>: qpos, qvel, warm;);

impl<R: Real> State<R> {
    /// At qpos0 and at rest.
    pub fn new(model: &Model) -> Self {
        Self {
            steps: 0,
            start: 0.0,
            qpos: model.qpos0.iter().map(|q| R::of(*q)).collect(),
            qvel: vec![R::zero(); model.nv],
            warm: Vec::new(),
        }
    }

    /// Copies into a state of the same model, whose room is used again.
    pub(crate) fn copy_to(&self, to: &mut Self) {
        (to.steps, to.start) = (self.steps, self.start);
        to.qpos.copy_from_slice(&self.qpos);
        to.qvel.copy_from_slice(&self.qvel);
        to.warm.clone_from(&self.warm);
    }

    /// Time [s] of this state in steps of `dt`.
    pub fn time(&self, dt: f64) -> f64 {
        self.start + self.steps as f64 * dt
    }
}

/// Controls and applied forces: held during a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Inputs<R: Real> {
    /// By actuator, in the unit that its gear expects.
    pub ctrl: Vec<R>,
    /// By dof [N or N·m].
    pub qfrc_applied: Vec<R>,
    /// Force at the centre of mass [N], then moment [N·m], in world axes, by body: 6
    /// numbers each.
    pub xfrc_applied: Vec<R>,
    /// Some applied force is not zero.
    pub applied: bool,
}

room!(Inputs<R>: ctrl, qfrc_applied, xfrc_applied;);

impl<R: Real> Inputs<R> {
    /// ctrl, qfrc_applied, xfrc_applied.
    pub(crate) fn arrays(&self) -> [&[R]; 3] {
        [&self.ctrl, &self.qfrc_applied, &self.xfrc_applied]
    }

    pub(crate) fn arrays_mut(&mut self) -> [&mut [R]; 3] {
        [&mut self.ctrl, &mut self.qfrc_applied, &mut self.xfrc_applied]
    }

    pub(crate) fn any_applied(&self) -> bool {
        self.qfrc_applied.iter().chain(&self.xfrc_applied).any(|x| !x.is_zero())
    }

    /// Copies into inputs of the same model, whose room is used again.
    pub(crate) fn copy_to(&self, to: &mut Self) {
        for (to, from) in to.arrays_mut().into_iter().zip(self.arrays()) {
            to.copy_from_slice(from);
        }
        to.applied = self.applied;
    }

    /// No control, no force.
    pub fn new(model: &Model) -> Self {
        Self {
            ctrl: vec![R::zero(); model.actuators.len()],
            qfrc_applied: vec![R::zero(); model.nv],
            xfrc_applied: vec![R::zero(); 6 * model.bodies.len()],
            applied: false,
        }
    }
}
