//! The last solve, kept for reading.
//!
//! Body forces and sensors belong to the state at which forces were computed: MuJoCo computes them
//! in `mj_forward`, before it integrates. A step leaves its placement, its rows and its impulses in
//! the `Sim`, and its initial state in `next`. While both are valid they are read there, with that
//! state put back meanwhile. Otherwise a second `Sim` repeats the solve: if there were several in
//! the step (`midpoint`, `rk4`), if a body may sleep (a body resting on another presses on it,
//! asleep or not), and if something else was computed since.

use crate::arrays::{ArraySet, Given};
use crate::error::Result;
use crate::real::Real;
use crate::settings::Settings;
use crate::sim::{Effort, Sim};
use crate::state::{Inputs, State};

/// The state and the inputs at which a `Sim` last solved, and a second `Sim`, which repeats solves.
pub struct LastSolve<R: Real> {
    at: At,
    /// The initial state, once it is `Kept`.
    start: State<R>,
    inputs: Inputs<R>,
    second: Option<Box<Sim<R>>>,
    /// The position of the second `Sim`.
    there: There,
}

/// The place of the last solve.
#[derive(Clone, Copy, PartialEq)]
enum At {
    /// There is none.
    Nowhere,
    /// In the `Sim`, whose state has moved on from it.
    Before,
    /// In the `Sim`, at its state.
    Here,
    Kept,
}

impl At {
    /// Copies the state and the inputs of a solve that is in `sim`.
    fn copy_to<R: Real>(self, sim: &Sim<R>, state: &mut State<R>, inputs: &mut Inputs<R>) {
        match self {
            Self::Nowhere | Self::Kept => return,
            Self::Here => sim.state.copy_to(state),
            Self::Before => {
                let before = &sim.next;
                state.qpos.copy_from_slice(&before.qpos);
                state.qvel.copy_from_slice(&before.qvel);
                state.act.copy_from_slice(&before.act);
                state.ctrl_history.copy_from_slice(&before.ctrl_history);
                state.warm.clone_from(&before.warm);
                before.sleep.copy_to(&mut state.sleep);
                (state.start, state.steps) = (sim.state.start, sim.state.steps - 1);
            }
        }
        sim.inputs.copy_to(inputs);
    }
}

/// The position of the second `Sim`.
#[derive(Clone, Copy, PartialEq)]
enum There {
    Elsewhere,
    /// At the state of the last solve.
    Placed,
    Solved,
}

room!(LastSolve<R>: at, start, inputs, second, there);

impl<R: Real> LastSolve<R> {
    pub fn new(sim: &Sim<R>) -> Self {
        let model = &sim.model;
        Self {
            at: At::Nowhere,
            start: State::new(model),
            inputs: Inputs::new(model),
            second: None,
            there: There::Elsewhere,
        }
    }

    /// Records that a step has just been taken, and nothing was computed after it.
    #[inline]
    pub fn stepped(&mut self) {
        (self.at, self.there) = (At::Before, There::Elsewhere);
    }

    /// Records that `forward` was called, and nothing was computed after it.
    pub fn solved(&mut self) {
        (self.at, self.there) = (At::Here, There::Elsewhere);
    }

    /// Makes the present state the place of the last solve, which is made there when it is read.
    pub fn stayed(&mut self, sim: &Sim<R>) {
        self.solved();
        self.keep(sim);
    }

    /// Records that the present state came from elsewhere.
    pub fn forget(&mut self) {
        (self.at, self.there) = (At::Nowhere, There::Elsewhere);
    }

    /// Keeps the state and the inputs of a solve that is in `sim`, which will do something else.
    pub fn keep(&mut self, sim: &Sim<R>) {
        if matches!(self.at, At::Before | At::Here) {
            self.at.copy_to(sim, &mut self.start, &mut self.inputs);
            self.at = At::Kept;
        }
    }

    /// The state and the inputs at the start of the last solve.
    pub fn begun(&self, sim: &Sim<R>) -> Option<(State<R>, Inputs<R>)> {
        if self.at == At::Nowhere {
            return None;
        }
        let (mut state, mut inputs) = (self.start.clone(), self.inputs.clone());
        self.at.copy_to(sim, &mut state, &mut inputs);
        Some((state, inputs))
    }

    /// Sets the start of the last solve: these arrays, and the additions of `put` to the state.
    pub fn begin(&mut self, given: &Given, put: impl FnOnce(&mut State<R>)) {
        self.start.put(0, given);
        self.inputs.put(0, given, ArraySet::ALL);
        put(&mut self.start);
        (self.at, self.there) = (At::Kept, There::Elsewhere);
    }

    /// Repeats the kept solve in `sim`, whose state and inputs stay; step: it was a step's.
    pub fn make_again(&mut self, sim: &mut Sim<R>, step: bool) {
        let (state, inputs, qacc) = (sim.state.clone(), sim.inputs.clone(), sim.qacc.clone());
        let effort = sim.effort;
        self.start.copy_to(&mut sim.state);
        self.inputs.copy_to(&mut sim.inputs);
        let made = if step { sim.step(1) } else { sim.forward() };
        if made.is_err() {
            sim.clear_solve();
        }
        (sim.state, sim.inputs, sim.qacc) = (state, inputs, qacc);
        // It was already counted the first time.
        let Effort { sweeps, decrement, .. } = sim.effort;
        sim.effort = Effort { sweeps, decrement, ..effort };
    }

    /// Lets `read` see a `Sim` at the state of the last solve, with that solve if `solve`. If there
    /// was none, at the given state and inputs.
    pub fn read<T>(
        &mut self,
        sim: &mut Sim<R>,
        given: &Given,
        solve: bool,
        read: impl FnOnce(&mut Sim<R>) -> T,
    ) -> Result<T> {
        match self.at {
            At::Here if !sim.plan.sleeps => return Ok(read(sim)),
            At::Before if sim.plan.solves_once => {
                sim.swap_states();
                sim.state.steps -= 1;
                let value = read(sim);
                sim.state.steps += 1;
                sim.swap_states();
                return Ok(value);
            }
            At::Nowhere => {
                given.check::<R>(&sim.models[0], None)?;
                sim.state.copy_to(&mut self.start);
                self.start.put(0, given);
                self.inputs.put(0, given, ArraySet::ALL);
                self.there = There::Elsewhere;
            }
            _ => self.keep(sim),
        }
        let there = std::mem::replace(&mut self.there, There::Elsewhere);
        let (start, inputs) = (&self.start, &self.inputs);
        let second = second_sim(&mut self.second, sim)?;
        if there == There::Elsewhere {
            start.copy_to(&mut second.state);
            inputs.copy_to(&mut second.inputs);
        }
        if solve && there != There::Solved {
            second.forward()?;
        }
        let solved = solve || there == There::Solved;
        self.there = if solved { There::Solved } else { There::Placed };
        Ok(read(second))
    }

    /// A `Sim` placed at the given state and inputs, which were checked.
    pub fn present(&mut self, sim: &Sim<R>, given: &Given) -> Result<&mut Sim<R>> {
        self.there = There::Elsewhere;
        let second = second_sim(&mut self.second, sim)?;
        second.put(0, given);
        second.refresh();
        Ok(second)
    }
}

/// The second `Sim`, in which no body sleeps.
pub(super) fn second_sim<'a, R: Real>(
    second: &'a mut Option<Box<Sim<R>>>,
    sim: &Sim<R>,
) -> Result<&'a mut Sim<R>> {
    Ok(match second {
        Some(second) => {
            second.take_models(&sim.models());
            second
        }
        none => {
            let settings = Settings { sleep: false, ..sim.settings.clone() };
            none.insert(Box::new(Sim::side_by_side(sim.models(), settings)?))
        }
    })
}
