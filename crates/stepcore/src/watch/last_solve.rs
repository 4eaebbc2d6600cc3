//! The last solve, for what is read of it.
//!
//! Body forces and sensors belong to the state at which forces were computed: MuJoCo computes them in
//! `mj_forward`, before it integrates. A step leaves its placement, its rows and its impulses in the
//! `Sim`, and the state that it started from in `next`: while both stand they are read there, with
//! that state put back as long as it takes. Only where they do not stand the solve is made again,
//! aside: where several were made in the step (`midpoint`, `rk4`), where somebody may sleep (what rests
//! on something presses on it, asleep or not), and where something else was computed since.

use crate::arrays::{ArraySet, Given};
use crate::error::Result;
use crate::model::Model;
use crate::real::Real;
use crate::settings::Settings;
use crate::sim::Sim;
use crate::state::{Inputs, State};

/// The state and the inputs at which a `Sim` last solved, and a `Sim` for what is computed aside.
pub struct LastSolve<R: Real> {
    at: At,
    /// Where it was, once it is `Kept`.
    start: State<R>,
    inputs: Inputs<R>,
    aside: Option<Box<Sim<R>>>,
    /// Where `aside` is.
    there: There,
}

/// Where the last solve is found.
#[derive(Clone, Copy, PartialEq)]
enum At {
    /// There is none.
    Nowhere,
    /// In the `Sim`, whose state has gone on from it.
    Before,
    /// In the `Sim`, at its state.
    Here,
    Kept,
}

/// Where the `Sim` aside is.
#[derive(Clone, Copy, PartialEq)]
enum There {
    Elsewhere,
    /// At the state of the last solve.
    Placed,
    Solved,
}

room!(LastSolve<R>: at, start, inputs, aside, there);

impl<R: Real> LastSolve<R> {
    pub fn new(model: &Model) -> Self {
        Self {
            at: At::Nowhere,
            start: State::new(model),
            inputs: Inputs::new(model),
            aside: None,
            there: There::Elsewhere,
        }
    }

    /// A step has just been taken, and nothing was computed after it.
    #[inline]
    pub fn stepped(&mut self) {
        (self.at, self.there) = (At::Before, There::Elsewhere);
    }

    /// `forward` was called, and nothing was computed after it.
    pub fn solved(&mut self) {
        (self.at, self.there) = (At::Here, There::Elsewhere);
    }

    /// What is read of it is read at the state at hand, where it is made when that happens.
    pub fn stayed(&mut self, sim: &Sim<R>) {
        self.solved();
        self.keep(sim);
    }

    /// The state at hand came from elsewhere.
    pub fn forget(&mut self) {
        (self.at, self.there) = (At::Nowhere, There::Elsewhere);
    }

    /// Keeps the state and the inputs of a solve that stands in `sim`, which will do something else.
    pub fn keep(&mut self, sim: &Sim<R>) {
        let Self { start, inputs, at, .. } = self;
        match at {
            At::Nowhere | At::Kept => return,
            At::Here => sim.state.copy_to(start),
            At::Before => {
                let before = &sim.next;
                start.qpos.copy_from_slice(&before.qpos);
                start.qvel.copy_from_slice(&before.qvel);
                start.act.copy_from_slice(&before.act);
                start.ctrl_history.copy_from_slice(&before.ctrl_history);
                start.warm.clone_from(&before.warm);
                before.sleep.copy_to(&mut start.sleep);
                (start.start, start.steps) = (sim.state.start, sim.state.steps - 1);
            }
        }
        sim.inputs.copy_to(inputs);
        *at = At::Kept;
    }

    /// Lets `read` see a `Sim` at the state of the last solve, with that solve if `solve`. While there
    /// was none, at the state and inputs that are given.
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
                given.check::<R>(&sim.model, None)?;
                sim.state.copy_to(&mut self.start);
                self.start.put(0, given);
                self.inputs.put(0, given, ArraySet::ALL);
                self.there = There::Elsewhere;
            }
            _ => self.keep(sim),
        }
        let there = std::mem::replace(&mut self.there, There::Elsewhere);
        let (start, inputs) = (&self.start, &self.inputs);
        let aside = sim_aside(&mut self.aside, sim)?;
        if there == There::Elsewhere {
            start.copy_to(&mut aside.state);
            inputs.copy_to(&mut aside.inputs);
        }
        if solve && there != There::Solved {
            aside.forward()?;
        }
        let solved = solve || there == There::Solved;
        self.there = if solved { There::Solved } else { There::Placed };
        Ok(read(aside))
    }

    /// A `Sim` placed at the state and inputs that are given, which were checked.
    pub fn present(&mut self, sim: &Sim<R>, given: &Given) -> Result<&mut Sim<R>> {
        self.there = There::Elsewhere;
        let aside = sim_aside(&mut self.aside, sim)?;
        aside.put(0, given);
        aside.refresh();
        Ok(aside)
    }
}

/// Nobody sleeps in it.
fn sim_aside<'a, R: Real>(
    aside: &'a mut Option<Box<Sim<R>>>,
    sim: &Sim<R>,
) -> Result<&'a mut Sim<R>> {
    Ok(match aside {
        Some(aside) => aside,
        none => {
            let settings = Settings { sleep: false, ..sim.settings.clone() };
            none.insert(Box::new(Sim::new(sim.model.clone(), settings)?))
        }
    })
}
