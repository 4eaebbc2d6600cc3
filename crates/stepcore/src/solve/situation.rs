//! The input for building rows: placement, state and inputs at one time.

use crate::clock::Clock;
use crate::model::{Model, NONE};
use crate::place::Placed;
use crate::real::Real;
use crate::settings::Settings;
use crate::state::Inputs;
use crate::warm::Warm;

/// The rows that are built, and the velocity on which their impulses act.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// All, on the velocity of the step.
    Whole,
    /// Equalities alone, on the velocity at the start, which then satisfies them.
    Start,
    /// Equalities alone, on the acceleration of a stage.
    Stage,
    /// All, after a smooth motion: see `commit/end_of_step_rows.rs`. Equalities that its stages
    /// held only respond to the others.
    End,
}

/// The input of everything that builds rows.
pub struct Situation<'a, R: Real> {
    pub model: &'a Model<R::Value>,
    pub placed: &'a Placed<R>,
    /// The target of the rows' spans: `Model::dof_lists`, extended in a pile.
    pub dof_lists: &'a [usize],
    pub settings: &'a Settings,
    pub clock: Clock<R>,
    pub qpos: &'a [R],
    pub qvel: &'a [R],
    pub inputs: &'a Inputs<R>,
    pub part: Part,
    /// The impulses stored by the last step.
    pub warm: &'a [Warm<R>],
    /// Per tree: whether it sleeps; empty if none does.
    pub asleep: &'a [bool],
    /// Whether no stage of this step has been solved yet.
    pub first_stage: bool,
}

impl<R: Real> Situation<'_, R> {
    /// Returns whether a law on velocities constrains the mean velocity of `midpoint` or `rk4`.
    pub fn halves(&self) -> bool {
        self.part == Part::End && self.settings.law.on_guess()
    }

    /// Returns whether a tree sleeps or is immovable (`NONE`).
    pub fn rests(&self, tree: usize) -> bool {
        tree == NONE || self.asleep.get(tree).is_some_and(|asleep| *asleep)
    }
}
