//! A `Sim` and those who watch it: its recent past, its ledger, and the post-mortem of a failure.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::ledger::Ledger;
use super::past::Past;
use super::post_mortem::{look_into, Run};
use super::tape::{element_forces, taped, StepGains, Tape};
use crate::arrays::Given;
use crate::elements::Element;
use crate::error::{Error, Result};
use crate::model::Model;
use crate::real::Real;
use crate::room::Room;
use crate::settings::Settings;
use crate::sim::Sim;

/// A `Sim` whose failures say which element they came from, and which keeps a ledger of its
/// energy if the settings ask for one.
pub struct Watched<R: Real> {
    pub sim: Sim<R>,
    past: Past<R>,
    ledger: Option<Box<Ledger<R>>>,
    /// Lanes (bits) that only repeat another, whose failures are reported there.
    copies: u64,
}

impl<R: Real> Watched<R> {
    pub fn new(model: Arc<Model>, settings: Settings) -> Result<Self> {
        Ok(Self::around(Sim::new(model, settings)?))
    }

    pub fn around(sim: Sim<R>) -> Self {
        Self {
            past: Past::new(&sim.model),
            ledger: sim.settings.ledger.then(|| Box::new(Ledger::new(&sim.model))),
            copies: 0,
            sim,
        }
    }

    /// Takes one world's arrays, which were checked. Lane 0 comes first.
    pub fn put(&mut self, lane: usize, given: &Given) {
        if self.sim.put(lane, given) {
            self.past.forget();
            self.forget();
        }
    }

    /// The state at hand did not come from a step: a new account is opened.
    pub fn forget(&mut self) {
        self.ledger.iter_mut().for_each(|ledger| ledger.forget());
    }

    /// Advances by `n` steps, or to the last finite state before an error.
    pub fn step(&mut self, n: u64) -> Result<()> {
        let Self { sim, past, ledger, copies } = self;
        let outcome = match ledger {
            None => sim.step_watched(n, past),
            Some(ledger) => ledger.step(sim, n, past, |ledger, sim, past, lane, gained| {
                suspect(*copies, ledger, sim, past, lane, gained)
            }),
        };
        outcome.map_err(|error| self.explained(error))
    }

    /// Takes one step and writes down what each element did in it, in one lane.
    pub fn taped_step(&mut self, lane: usize) -> Result<StepGains> {
        let Self { sim, past, ledger, copies } = self;
        let outcome = taped(sim, lane, |sim, tape| {
            let mut watchers: (&mut Past<R>, &mut Tape) = (past, tape);
            match ledger {
                None => sim.step_watched(1, &mut watchers),
                Some(ledger) => {
                    ledger.step(sim, 1, &mut watchers, |ledger, sim, (past, _), lane, gained| {
                        suspect(*copies, ledger, sim, past, lane, gained)
                    })
                }
            }
        });
        outcome.map_err(|error| self.explained(error))
    }

    /// The generalised force of every element that pushes at the state of the last solve, in one
    /// lane [N or N·m].
    pub fn element_forces(&self, lane: usize) -> BTreeMap<Element, Vec<f64>> {
        element_forces(&self.sim, lane)
    }

    /// Place, detect and solve at the present state. Nothing is committed.
    pub fn forward(&mut self) -> Result<()> {
        self.sim.forward().map_err(|error| self.explained(error))
    }

    /// At the end of a call of `n` steps, in however many portions these were made: balances
    /// the ledger if the call was long, or it never was balanced. Nothing that can be read
    /// changes.
    pub fn balance_at_end(&mut self, n: u64) -> Result<()> {
        let Self { sim, past, ledger, copies } = self;
        let Some(ledger) = ledger else { return Ok(()) };
        ledger.balance_at_end(sim, n, |ledger, sim, lane, gained| {
            suspect(*copies, ledger, sim, past, lane, gained)
        })
    }

    /// An error with what can be found out about it.
    fn explained(&self, error: Error) -> Error {
        let Error::Diverged(mut divergence) = error else { return error };
        if divergence.post.is_none() {
            // A copy fails with the world that it repeats, which is the first.
            if !self.is_world(divergence.world) {
                let first = (0..R::LANES).find(|lane| self.is_world(*lane));
                divergence.world = first.unwrap_or(divergence.world);
            }
            let run = Run { sim: &self.sim, past: &self.past, ledger: self.ledger.as_deref() };
            *divergence = run.explain(*divergence);
        }
        Error::Diverged(divergence)
    }

    /// Memory of the state, of all working space and of what is kept of the past [bytes]; the
    /// model is not in it.
    pub fn bytes(&self) -> usize {
        let ledger = self.ledger.as_ref().map_or(0, Room::room);
        size_of::<Self>() + self.sim.room() + self.past.room() + ledger
    }
}

/// For batches, whose groups of worlds take turns in one working space.
impl<R: Real> Watched<R> {
    /// Another group's worlds, of which `copies` (bits) repeat another, and its ledger; the one
    /// that was here is left in its place.
    pub(crate) fn swap(&mut self, ledger: &mut Option<Box<Ledger<R>>>, copies: u64) {
        std::mem::swap(&mut self.ledger, ledger);
        self.past.forget();
        self.copies = copies;
    }

    /// Some lanes (bits) repeat lane `from` from now on: their worlds have failed.
    pub(crate) fn repeat(&mut self, from: usize, copies: u64) {
        self.copies = copies;
        if let Some(ledger) = &mut self.ledger {
            (0..R::LANES)
                .filter(|lane| !is_world(copies, *lane))
                .for_each(|lane| ledger.repeat(lane, from));
            ledger.go_on(&self.sim.state);
        }
    }

    /// A lane that stands for a world of its own.
    pub(crate) fn is_world(&self, lane: usize) -> bool {
        is_world(self.copies, lane)
    }
}

/// A world gained more energy than it can have. A copy says nothing: its world does.
fn suspect<R: Real>(
    copies: u64,
    ledger: &mut Ledger<R>,
    sim: &Sim<R>,
    past: &Past<R>,
    lane: usize,
    gained: f64,
) -> Result<()> {
    if !is_world(copies, lane) {
        return Ok(());
    }
    look_into(ledger, sim, past, lane, gained)
}

fn is_world(copies: u64, lane: usize) -> bool {
    copies >> lane & 1 == 0
}

/// Why the next step of an accompanying copy failed: the same step in plain numbers says.
pub(super) fn explained<R: Real>(sim: &Sim<R>, error: Error) -> Error {
    let plain = sim.in_doubles::<f64>().and_then(|plain| Watched::around(plain).step(1));
    plain.err().unwrap_or(error)
}
