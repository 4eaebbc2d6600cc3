//! A `Sim` with its observers: its recent past, its ledger, and the post-mortem of a failure.

use std::sync::Arc;

use super::last_solve::second_sim;
use super::ledger::{Care, Ledger};
use super::past::Past;
use super::post_mortem::{look_into, Run};
use super::tape::{taped, StepGains, Tape};
use crate::arrays::{ArraySet, Given, Plain};
use crate::error::{Error, Result};
use crate::interrupt::caught;
use crate::model::Model;
use crate::place::Placed;
use crate::real::Real;
use crate::room::Room;
use crate::settings::Settings;
use crate::sim::Sim;
use crate::warm::Warm;

/// A `Sim` whose failures name the element that caused them. It keeps a ledger of its energy if the
/// settings request one.
pub struct Watched<R: Real> {
    pub sim: Sim<R>,
    past: Past<R>,
    ledger: Option<Box<Ledger<R>>>,
    others: Others,
    /// Used for further computations, so that the last solve of the first stays.
    second: Option<Box<Sim<R>>>,
    /// The last step failed: its impulses must not start another state.
    failed: bool,
}

/// The other worlds.
#[derive(Clone, Copy)]
struct Others {
    /// Lanes (bits) that only repeat another, whose failures are reported there.
    copies: u64,
    /// How many worlds there are; see `Run`.
    worlds: usize,
}

impl Others {
    fn is_world(self, lane: usize) -> bool {
        self.copies >> lane & 1 == 0
    }
}

impl<R: Real> Watched<R> {
    pub fn new(model: Arc<Model>, settings: Settings) -> Result<Self> {
        Ok(Self::around(Sim::new(model, settings)?))
    }

    pub fn around(sim: Sim<R>) -> Self {
        let care = if sim.settings.ledger { Care::Full } else { Care::Least };
        // Adaptive steps do their own checks.
        let fixed = sim.settings.accuracy.0.is_none();
        Self {
            past: Past::new(&sim.model),
            ledger: fixed.then(|| Box::new(Ledger::new(&sim.model, care))),
            others: Others { copies: 0, worlds: 1 },
            second: None,
            failed: false,
            sim,
        }
    }

    /// Makes it one of this many worlds, which share the cost of explaining their failures.
    pub(crate) fn among(mut self, worlds: usize) -> Self {
        self.others.worlds = worlds;
        self
    }

    /// Takes one world's arrays, already checked, where they may differ from the present ones. Lane
    /// 0 comes first.
    pub fn put(&mut self, lane: usize, given: &Given, some: ArraySet) {
        if self.sim.put_some(lane, given, some) {
            if std::mem::take(&mut self.failed) {
                self.sim.state.warm.clear();
            }
            self.past.forget(lane);
            self.forget();
        }
    }

    /// Opens a new account: the present state did not come from a step.
    pub fn forget(&mut self) {
        self.ledger.iter_mut().for_each(|ledger| ledger.forget());
    }

    /// Advances by `n` steps, or to the last finite state before an error.
    pub fn step(&mut self, n: u64) -> Result<()> {
        let Self { sim, past, ledger, others, .. } = self;
        let outcome = sim.whole(|sim| match ledger {
            None => sim.step_watched(n, past),
            Some(ledger) => ledger.step(sim, n, past, |ledger, sim, past, lane, gained| {
                suspect(*others, ledger, sim, past, lane, gained)
            }),
        });
        outcome.map_err(|error| self.failed(error))
    }

    /// Balances the account of energies of worlds that continue elsewhere.
    pub(crate) fn end_account(&mut self) -> Result<()> {
        let Self { sim, past, ledger, others, .. } = self;
        let Some(ledger) = ledger else { return Ok(()) };
        ledger
            .end(sim, |ledger, sim, lane, gained| suspect(*others, ledger, sim, past, lane, gained))
    }

    /// Takes one step and records the effect of each element in it, in one lane.
    pub fn taped_step(&mut self, lane: usize) -> Result<StepGains> {
        let Self { sim, past, ledger, others, .. } = self;
        let taped = |sim: &mut Sim<R>| {
            taped(sim, lane, |sim, tape| {
                let mut watchers: (&mut Past<R>, &mut Tape) = (past, tape);
                match ledger {
                    None => sim.step_watched(1, &mut watchers),
                    Some(ledger) => ledger.step(
                        sim,
                        1,
                        &mut watchers,
                        |ledger, sim, (past, _), lane, gained| {
                            suspect(*others, ledger, sim, past, lane, gained)
                        },
                    ),
                }
            })
        };
        let outcome = sim.whole(taped);
        outcome.map_err(|error| self.failed(error))
    }

    /// Runs place, detect and solve at the present state. Nothing is committed.
    pub fn forward(&mut self) -> Result<()> {
        let outcome = self.sim.whole(Sim::forward).map_err(|error| self.explained(error));
        if outcome.is_err() {
            self.sim.clear_solve();
        }
        outcome
    }

    /// See `Sim::go_to_last_stage`.
    pub fn go_to_last_stage(&mut self) -> Result<()> {
        self.sim.whole(Sim::go_to_last_stage).map_err(|error| self.explained(error))
    }

    /// Ends a call of `n` steps, in however many portions it was made: balances the ledger if the
    /// call was long, or if the ledger never was balanced. Nothing that can be read changes.
    pub fn balance_at_end(&mut self, n: u64) -> Result<()> {
        let Self { sim, past, ledger, others, .. } = self;
        let Some(ledger) = ledger else { return Ok(()) };
        let outcome = sim.whole(|sim| {
            ledger.balance_at_end(sim, n, |ledger, sim, lane, gained| {
                suspect(*others, ledger, sim, past, lane, gained)
            })
        });
        outcome.map_err(|error| self.failed(error))
    }

    /// Without `Settings::ledger`: the warning that more energy was gained than possible, and its
    /// source. It is given once, and nothing is checked after that.
    pub fn take_warning(&mut self) -> Option<String> {
        let said = self.ledger.as_mut()?.take_said()?;
        self.unwatch();
        Some(said.warning())
    }

    /// Without `Settings::ledger`, stops checking energies.
    pub fn unwatch(&mut self) {
        if !self.sim.settings.ledger {
            self.ledger = None;
        }
    }

    /// Handles a failed step.
    fn failed(&mut self, error: Error) -> Error {
        if error == Error::Interrupted {
            // The account of energies was interrupted at an unknown point.
            self.forget();
            return error;
        }
        self.failed = true;
        // The error contains more than a warning of the same run.
        self.ledger.iter_mut().for_each(|ledger| drop(ledger.take_said()));
        let error = self.explained(error);
        // The last solve led nowhere: the readable one is at the last finite state.
        let effort = self.sim.effort;
        if self.sim.whole(Sim::forward).is_err() {
            self.sim.clear_solve();
        }
        self.sim.effort = effort;
        error
    }

    /// Puts back the impulses of the last successful step.
    pub fn put_impulses(&mut self, warm: impl Iterator<Item = Warm<R>>) {
        let (warm, kept): (Vec<_>, _) = (warm.collect(), &self.sim.state.warm);
        if !kept.iter().filter(|w| w.acts()).eq(warm.iter().filter(|w| w.acts())) {
            self.failed = false;
        }
        self.sim.state.warm = warm;
        self.forget();
    }

    /// Adds to an error everything that can be found out about it.
    fn explained(&self, error: Error) -> Error {
        let Error::Diverged(mut divergence) = error else { return error };
        if divergence.post.is_none() {
            // A copy fails together with the world that it repeats, which comes first.
            if !self.is_world(divergence.world) {
                let first = (0..R::LANES).find(|lane| self.is_world(*lane));
                divergence.world = first.unwrap_or(divergence.world);
            }
            let ledger = self.ledger.as_deref().filter(|_| self.sim.settings.ledger);
            let run = Run { sim: &self.sim, past: &self.past, ledger, worlds: self.others.worlds };
            let plain = divergence.clone();
            return match caught(|| Ok(run.explain(*plain))) {
                Ok(explained) => Error::Diverged(Box::new(explained)),
                // Ctrl-C ends the analysis, not the failure.
                Err(_) => Error::Diverged(divergence),
            };
        }
        Error::Diverged(divergence)
    }

    /// Memory of the state, of all working space and of the stored past [bytes]; without the model.
    pub fn bytes(&self) -> usize {
        let ledger = self.ledger.as_ref().map_or(0, Room::room);
        size_of::<Self>() + self.sim.room() + self.second.room() + self.past.room() + ledger
    }
}

/// For batches, whose groups of worlds share one working space.
impl<R: Real> Watched<R> {
    /// Swaps in another group's worlds, of which `copies` (bits) repeat another, with their past
    /// and ledger; the previous ones are stored in their place.
    pub(crate) fn swap(
        &mut self,
        past: &mut Past<R>,
        ledger: &mut Option<Box<Ledger<R>>>,
        copies: u64,
    ) {
        std::mem::swap(&mut self.past, past);
        std::mem::swap(&mut self.ledger, ledger);
        self.others.copies = copies;
    }

    /// Makes some lanes (bits) repeat lane `from` from now on: their worlds have failed.
    pub(crate) fn repeat(&mut self, from: usize, copies: u64) {
        self.others.copies = copies;
        if let Some(ledger) = &mut self.ledger {
            (0..R::LANES)
                .filter(|lane| !self.others.is_world(*lane))
                .for_each(|lane| ledger.repeat(lane, from));
            ledger.go_on(&self.sim.state);
        }
    }

    /// A second `Sim`, with the present state and inputs: computing there leaves the last solve as
    /// it is.
    pub(crate) fn second(&mut self) -> Result<&mut Sim<R>> {
        let second = second_sim(&mut self.second, &self.sim)?;
        self.sim.state.copy_to(&mut second.state);
        self.sim.inputs.copy_to(&mut second.inputs);
        Ok(second)
    }

    /// The last placement of the second `Sim`; before there is one, the placement of the steps.
    pub(crate) fn placed(&self) -> &Placed<R> {
        self.second.as_ref().map_or(&self.sim.placed, |second| &second.placed)
    }

    /// Whether a lane is a world rather than a copy.
    pub(crate) fn is_world(&self, lane: usize) -> bool {
        self.others.is_world(lane)
    }
}

/// Handles a world that gained more energy than possible. A copy reports nothing: its world does.
fn suspect<R: Real>(
    others: Others,
    ledger: &mut Ledger<R>,
    sim: &Sim<R>,
    past: &Past<R>,
    lane: usize,
    gained: Option<f64>,
) -> Result<()> {
    if !others.is_world(lane) {
        return Ok(());
    }
    look_into(ledger, sim, past, others.worlds, lane, gained).or_else(|error| ledger.heard(error))
}

/// Explains, in an accompanying copy, why the next step of a world failed.
pub(super) type Explain = fn(&Plain, Error) -> Error;

/// Explains the same step in the number type `R`. The code that makes a copy chooses `R`, so that
/// this step is compiled with its step, and not once more with the copy's.
pub(super) fn explained<R: Real>(copy: &Plain, error: Error) -> Error {
    let plain = copy.sim::<R>().and_then(|plain| Watched::around(plain).step(1));
    plain.err().unwrap_or(error)
}
