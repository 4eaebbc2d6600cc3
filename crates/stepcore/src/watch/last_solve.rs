//! The last solve once more, for what is read of it and was not kept.
//!
//! A step leaves the state that it started from behind, and keeps of its solve only what it needs.
//! Body forces and sensors belong to that state: MuJoCo computes them in `mj_forward`, before it
//! integrates. They are computed when they are read, by solving there again; that is the same
//! solve bit for bit but under `midpoint` and `rk4`, whose steps have several. Nobody sleeps in it:
//! what rests on something presses on it, asleep or not.

use crate::arrays::Given;
use crate::error::Result;
use crate::model::Model;
use crate::real::Real;
use crate::room::room;
use crate::settings::Settings;
use crate::sim::Sim;
use crate::state::{Inputs, State};

/// The state and the inputs at which a `Sim` last solved.
pub struct LastSolve<R: Real> {
    start: State<R>,
    inputs: Inputs<R>,
    /// Something was solved.
    any: bool,
    again: Option<Box<Sim<R>>>,
    /// `again` has that state, and has solved there.
    placed: bool,
    solved: bool,
}

room!(LastSolve<R>: ; start, inputs, again);

impl<R: Real> LastSolve<R> {
    pub fn new(model: &Model) -> Self {
        Self {
            start: State::new(model),
            inputs: Inputs::new(model),
            any: false,
            again: None,
            placed: false,
            solved: false,
        }
    }

    /// A step has just been taken.
    pub fn stepped(&mut self, sim: &Sim<R>) {
        let (start, before) = (&mut self.start, &sim.next);
        start.qpos.copy_from_slice(&before.qpos);
        start.qvel.copy_from_slice(&before.qvel);
        start.act.copy_from_slice(&before.act);
        start.ctrl_history.copy_from_slice(&before.ctrl_history);
        start.warm.clone_from(&before.warm);
        before.sleep.copy_to(&mut start.sleep);
        (start.start, start.steps) = (sim.state.start, sim.state.steps - 1);
        self.noted(sim);
    }

    /// `forward` was called, or a step failed, and the state is as it was.
    pub fn stayed(&mut self, sim: &Sim<R>) {
        sim.state.copy_to(&mut self.start);
        self.noted(sim);
    }

    fn noted(&mut self, sim: &Sim<R>) {
        sim.inputs.copy_to(&mut self.inputs);
        (self.any, self.placed, self.solved) = (true, false, false);
    }

    /// The state at hand came from elsewhere.
    pub fn forget(&mut self) {
        self.any = false;
    }

    /// A copy of `sim` at the state of the last solve, where it has solved once more if `solve`.
    /// While there was none, at the state and inputs that are given.
    pub fn again(&mut self, sim: &Sim<R>, given: &Given, solve: bool) -> Result<&mut Sim<R>> {
        if !self.any {
            given.check::<R>(&sim.model, None)?;
            sim.state.copy_to(&mut self.start);
            self.start.put(0, given);
            self.inputs.put(0, given);
            (self.placed, self.solved) = (false, false);
        }
        let again = match &mut self.again {
            Some(again) => again,
            none => {
                let settings = Settings { sleep: false, ..sim.settings.clone() };
                none.insert(Box::new(Sim::new(sim.model.clone(), settings)?))
            }
        };
        if !self.placed {
            self.start.copy_to(&mut again.state);
            self.inputs.copy_to(&mut again.inputs);
            self.placed = true;
        }
        if solve && !self.solved {
            again.forward()?;
            self.solved = true;
        }
        Ok(again)
    }
}
