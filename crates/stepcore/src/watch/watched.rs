//! A `Sim` and those who watch it: its recent past, its ledger, and the post-mortem of a failure.

use std::sync::Arc;

use super::last_solve::second_sim;
use super::ledger::{Care, Ledger};
use super::past::Past;
use super::post_mortem::{look_into, Run};
use super::tape::{taped, StepGains, Tape};
use crate::arrays::{ArraySet, Given, Plain};
use crate::error::{Error, Result};
use crate::model::Model;
use crate::place::Placed;
use crate::real::Real;
use crate::room::Room;
use crate::settings::Settings;
use crate::sim::Sim;
use crate::warm::Warm;

/// A `Sim` whose failures say which element they came from, and which keeps a ledger of its
/// energy if the settings ask for one.
pub struct Watched<R: Real> {
    pub sim: Sim<R>,
    past: Past<R>,
    ledger: Option<Box<Ledger<R>>>,
    others: Others,
    /// Computes what is asked and leaves the last solve of the first as it is.
    second: Option<Box<Sim<R>>>,
    /// The last step failed: its impulses are no start for another state.
    failed: bool,
}

/// The worlds beside one.
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
        // Steps within an accuracy watch themselves.
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

    /// One among so many, which share what explaining their failures may cost.
    pub(crate) fn among(mut self, worlds: usize) -> Self {
        self.others.worlds = worlds;
        self
    }

    /// Takes one world's arrays, which were checked, where they may differ from those at hand. Lane 0
    /// comes first.
    pub fn put(&mut self, lane: usize, given: &Given, some: ArraySet) {
        if self.sim.put_some(lane, given, some) {
            if std::mem::take(&mut self.failed) {
                self.sim.state.warm.clear();
            }
            self.past.forget(lane);
            self.forget();
        }
    }

    /// The state at hand did not come from a step: a new account is opened.
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

    /// Balances the account of energies of worlds that go on elsewhere.
    pub(crate) fn end_account(&mut self) -> Result<()> {
        let Self { sim, past, ledger, others, .. } = self;
        let Some(ledger) = ledger else { return Ok(()) };
        ledger
            .end(sim, |ledger, sim, lane, gained| suspect(*others, ledger, sim, past, lane, gained))
    }

    /// Takes one step and writes down what each element did in it, in one lane.
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

    /// Place, detect and solve at the present state. Nothing is committed.
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

    /// At the end of a call of `n` steps, in however many portions these were made: balances
    /// the ledger if the call was long, or it never was balanced. Nothing that can be read
    /// changes.
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

    /// Without `Settings::ledger`: that more energy was gained than can be, and where from. It is
    /// said once, and nothing is looked for after that.
    pub fn take_warning(&mut self) -> Option<String> {
        let said = self.ledger.as_mut()?.take_said()?;
        self.unwatch();
        Some(said.warning())
    }

    /// Without `Settings::ledger`, energies are not looked at any more.
    pub fn unwatch(&mut self) {
        if !self.sim.settings.ledger {
            self.ledger = None;
        }
    }

    /// A step failed.
    fn failed(&mut self, error: Error) -> Error {
        if error == Error::Interrupted {
            // Where the account of energies was interrupted is not known.
            self.forget();
            return error;
        }
        self.failed = true;
        // The error says more than a warning of the same run.
        self.ledger.iter_mut().for_each(|ledger| drop(ledger.take_said()));
        let error = self.explained(error);
        // What was solved last led nowhere: what can be read is that of the last finite state.
        let effort = self.sim.effort;
        if self.sim.whole(Sim::forward).is_err() {
            self.sim.clear_solve();
        }
        self.sim.effort = effort;
        error
    }

    /// These are the impulses of the last step that went well.
    pub fn put_impulses(&mut self, warm: impl Iterator<Item = Warm<R>>) {
        let (warm, kept): (Vec<_>, _) = (warm.collect(), &self.sim.state.warm);
        if !kept.iter().filter(|w| w.acts()).eq(warm.iter().filter(|w| w.acts())) {
            self.failed = false;
        }
        self.sim.state.warm = warm;
        self.forget();
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
            let ledger = self.ledger.as_deref().filter(|_| self.sim.settings.ledger);
            let run = Run { sim: &self.sim, past: &self.past, ledger, worlds: self.others.worlds };
            *divergence = run.explain(*divergence);
        }
        Error::Diverged(divergence)
    }

    /// Memory of the state, of all working space and of what is kept of the past [bytes]; the
    /// model is not in it.
    pub fn bytes(&self) -> usize {
        let ledger = self.ledger.as_ref().map_or(0, Room::room);
        size_of::<Self>() + self.sim.room() + self.second.room() + self.past.room() + ledger
    }
}

/// For batches, whose groups of worlds take turns in one working space.
impl<R: Real> Watched<R> {
    /// Another group's worlds, of which `copies` (bits) repeat another, with their past and ledger;
    /// those that were here are left in their place.
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

    /// Some lanes (bits) repeat lane `from` from now on: their worlds have failed.
    pub(crate) fn repeat(&mut self, from: usize, copies: u64) {
        self.others.copies = copies;
        if let Some(ledger) = &mut self.ledger {
            (0..R::LANES)
                .filter(|lane| !self.others.is_world(*lane))
                .for_each(|lane| ledger.repeat(lane, from));
            ledger.go_on(&self.sim.state);
        }
    }

    /// A second `Sim`, with the state and the inputs at hand: what is computed there leaves what was
    /// solved last as it is.
    pub(crate) fn second(&mut self) -> Result<&mut Sim<R>> {
        let second = second_sim(&mut self.second, &self.sim)?;
        self.sim.state.copy_to(&mut second.state);
        self.sim.inputs.copy_to(&mut second.inputs);
        Ok(second)
    }

    /// Where bodies were placed last in the second `Sim`; before that, where they are in steps.
    pub(crate) fn placed(&self) -> &Placed<R> {
        self.second.as_ref().map_or(&self.sim.placed, |second| &second.placed)
    }

    /// A lane that stands for a world of its own.
    pub(crate) fn is_world(&self, lane: usize) -> bool {
        self.others.is_world(lane)
    }
}

/// A world gained more energy than it can have. A copy says nothing: its world does.
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

/// Why the next step of a world failed, which an accompanying copy found.
pub(super) type Explain = fn(&Plain, Error) -> Error;

/// The same step in numbers `R` says. Whoever makes a copy knows these, so that their step is compiled
/// with theirs, and not once more with the copy's.
pub(super) fn explained<R: Real>(copy: &Plain, error: Error) -> Error {
    let plain = copy.sim::<R>().and_then(|plain| Watched::around(plain).step(1));
    plain.err().unwrap_or(error)
}
