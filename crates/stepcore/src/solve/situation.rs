//! What rows are made from: the placement, the state and the inputs of a moment.

use crate::clock::Clock;
use crate::model::{Model, NONE};
use crate::place::Placed;
use crate::real::Real;
use crate::settings::Settings;
use crate::state::Inputs;
use crate::warm::Warm;

/// Which rows are made, and what their impulses act on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// All, on the velocity of the step.
    Whole,
    /// Equalities alone, on the velocity at the start, which then keeps them.
    Start,
    /// Equalities alone, on the acceleration of a stage.
    Stage,
    /// All, after a smooth motion: see `commit/end_of_step_rows.rs`. Equalities that its stages held answer
    /// to the others only.
    End,
}

/// Everything the row makers read.
pub struct Situation<'a, R: Real> {
    pub model: &'a Model<R::Value>,
    pub placed: &'a Placed<R>,
    /// What the spans of rows point into: `Model::dof_lists`, and in a pile what follows it.
    pub dof_lists: &'a [usize],
    pub settings: &'a Settings,
    pub clock: Clock<R>,
    pub qpos: &'a [R],
    pub qvel: &'a [R],
    pub inputs: &'a Inputs<R>,
    pub part: Part,
    /// What the last step kept.
    pub warm: &'a [Warm<R>],
    /// By tree: it sleeps; empty where nobody does.
    pub asleep: &'a [bool],
    /// No stage of this step has been solved yet.
    pub first_stage: bool,
}

impl<R: Real> Situation<'_, R> {
    /// The rows judge the mean velocity of a step of `midpoint` or `rk4`, by a law on velocities.
    pub fn halves(&self) -> bool {
        self.part == Part::End && self.settings.law.on_guess()
    }

    /// A tree sleeps, or nothing moves what it stands for (`NONE`).
    pub fn rests(&self, tree: usize) -> bool {
        tree == NONE || self.asleep.get(tree).is_some_and(|asleep| *asleep)
    }
}
