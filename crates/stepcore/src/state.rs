//! What a step changes, and what the user puts in from outside.

use crate::model::Model;
use crate::real::Real;

/// The impulses of one contact, limit or other source, kept for the next step's start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warm<R: Real> {
    /// Which source; ascending in the list.
    pub slot: u32,
    pub impulse: [R; 6],
}

/// A complete snapshot: restored, a run continues bit for bit.
#[derive(Clone, Debug, PartialEq)]
pub struct State<R: Real> {
    /// Steps since `start`, and the time there: time = start + steps · dt.
    pub steps: u64,
    pub start: f64,
    pub qpos: Vec<R>,
    pub qvel: Vec<R>,
    pub warm: Vec<Warm<R>>,
}

impl<R: Real> State<R> {
    pub fn new(model: &Model) -> Self {
        Self {
            steps: 0,
            start: 0.0,
            qpos: model.qpos0.iter().map(|q| R::of(*q)).collect(),
            qvel: vec![R::zero(); model.nv],
            warm: Vec::new(),
        }
    }
    pub fn time(&self, dt: f64) -> f64 {
        self.start + self.steps as f64 * dt
    }
}

/// Controls and applied forces: held during a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Inputs<R: Real> {
    pub ctrl: Vec<R>,
    pub qfrc_applied: Vec<R>,
    /// Force, then moment, by body: 6 numbers each.
    pub xfrc_applied: Vec<R>,
    /// Some applied force is not zero.
    pub applied: bool,
}

impl<R: Real> Inputs<R> {
    pub fn new(model: &Model) -> Self {
        Self {
            ctrl: vec![R::zero(); model.actuators.len()],
            qfrc_applied: vec![R::zero(); model.nv],
            xfrc_applied: vec![R::zero(); 6 * model.bodies.len()],
            applied: false,
        }
    }
}
