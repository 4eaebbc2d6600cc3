//! The ledger: is more energy there than a passive scene can have, and who fed it in?
//!
//! The engine is deterministic, so little has to be written down while things go well: a
//! complete state every 64 steps, the inputs when they change, and the work of what drives.
//! The account is balanced at those milestones only. A run that fails is gone through
//! again from the last milestone at which all was well, with everything written down.

mod account;
mod audit;
mod drive;
mod linear;
mod post_mortem;
mod tape;
mod trial;

pub(crate) use post_mortem::times;
pub use post_mortem::{PostMortem, Stable};
pub use tape::StepGains;

pub(crate) use tape::Tape;

use account::{Account, Level};

use crate::error::Result;
use crate::model::Model;
use crate::real::Real;
use crate::room::room;
use crate::settings::Settings;
use crate::sim::Sim;
use crate::state::{Inputs, State};

/// How many milestones are kept, and the steps from one to the next.
const MEMORY: usize = 8;
const STRIDE: u64 = 64;
/// A call of so many steps can afford to be balanced at its end; of so many, once an account.
const LONG: u64 = 128;
const SHORT: u64 = 8;

/// A complete state, its inputs, and how these changed until the next one.
pub(crate) struct Milestone<R: Real> {
    pub state: State<R>,
    pub inputs: Inputs<R>,
    /// Energies by lane, and whether any was suspicious.
    levels: Vec<Level>,
    gained: Vec<f64>,
    /// Steps done before each change, and which arrays changed.
    changes: Vec<(u64, [bool; 3])>,
    /// The changed arrays, one after the other.
    numbers: Vec<R>,
}

room!(Milestone<R>: levels, gained, changes, numbers; state, inputs);

/// What a `Sim` keeps while `Settings::ledger` is on.
pub struct Ledger<R: Real> {
    milestones: Vec<Milestone<R>>,
    /// The newest one, and how many there are.
    at: usize,
    len: usize,
    accounts: Vec<Account>,
    levels: Vec<Level>,
    /// Of what drives, since the newest milestone.
    work: R,
    /// The inputs that were written down last.
    seen: Inputs<R>,
    /// The step count that the next step must find; else the state is not this one's.
    expected: Option<(u64, f64)>,
    /// Keeps the account and says nothing.
    quiet: bool,
    /// Balanced since it was opened.
    balanced: bool,
    /// Where a call's last state is looked at: what was solved last stays readable.
    aside: Option<Box<Sim<R>>>,
}

room!(Ledger<R>: accounts, levels; milestones, seen, aside);

impl<R: Real> Ledger<R> {
    pub fn new(model: &Model) -> Self {
        let milestone = || Milestone {
            state: State::new(model),
            inputs: Inputs::new(model),
            levels: vec![Level::default(); R::LANES],
            gained: vec![0.0; R::LANES],
            changes: Vec::new(),
            numbers: Vec::new(),
        };
        Self {
            milestones: (0..MEMORY).map(|_| milestone()).collect(),
            at: 0,
            len: 0,
            accounts: Vec::with_capacity(R::LANES),
            levels: vec![Level::default(); R::LANES],
            work: R::zero(),
            seen: Inputs::new(model),
            expected: None,
            quiet: false,
            balanced: false,
            aside: None,
        }
    }

    /// The state at hand did not come from a step.
    pub fn forget(&mut self) {
        self.expected = None;
    }

    /// A lane became a copy of another.
    pub(crate) fn repeat(&mut self, lane: usize, from: usize) {
        if let [.., _] = self.accounts[..] {
            self.accounts[lane] = self.accounts[from];
        }
    }

    /// After a failure the other lanes go on with the same account.
    pub(crate) fn go_on(&mut self, state: &State<R>) {
        if self.len > 0 {
            self.expected = Some((state.steps, state.start));
        }
    }

    /// Milestones, newest first.
    pub(crate) fn newest_first(&self) -> impl Iterator<Item = &Milestone<R>> {
        (0..self.len).map(|back| &self.milestones[(self.at + MEMORY - back) % MEMORY])
    }

    fn keep(&mut self, state: &State<R>, inputs: &Inputs<R>) {
        // A new account starts in the room that the last one has filled.
        self.at = if self.len == 0 { 0 } else { (self.at + 1) % MEMORY };
        self.len = (self.len + 1).min(MEMORY);
        let milestone = &mut self.milestones[self.at];
        state.copy_to(&mut milestone.state);
        inputs.copy_to(&mut milestone.inputs);
        milestone.levels.copy_from_slice(&self.levels);
        milestone.changes.clear();
        milestone.numbers.clear();
    }

    /// Writes the inputs down where they changed.
    fn note_inputs(&mut self, steps: u64, inputs: &Inputs<R>) {
        let (new, old) = (inputs.arrays(), self.seen.arrays());
        let changed = std::array::from_fn(|k| new[k] != old[k]);
        if changed == [false; 3] {
            return;
        }
        let milestone = &mut self.milestones[self.at];
        milestone.changes.push((steps, changed));
        for (array, changed) in new.iter().zip(changed) {
            if changed {
                milestone.numbers.extend_from_slice(array);
            }
        }
        inputs.copy_to(&mut self.seen);
    }
}

impl<R: Real> Sim<R> {
    /// The state at hand did not come from a step: a new account is opened.
    pub fn forget_ledger(&mut self) {
        if let Some(ledger) = &mut self.ledger {
            ledger.forget();
        }
    }

    /// Advances from milestone to milestone.
    pub(crate) fn step_in_ledger(&mut self, n: u64) -> Result<()> {
        self.open_ledger();
        let driven = !self.model.actuators.is_empty() || self.inputs.applied;
        let mut left = n;
        let mut outcome = Ok(());
        while left > 0 && outcome.is_ok() {
            outcome = match self.balance() {
                Ok(room) => {
                    let portion = left.min(room);
                    left -= portion;
                    self.advance(portion, driven)
                }
                Err(error) => Err(error),
            };
        }
        let now = (self.state.steps, self.state.start);
        if let Some(expected) = self.ledger.as_mut().and_then(|ledger| ledger.expected.as_mut()) {
            *expected = now;
        }
        outcome
    }

    /// Before a call's first step: is this still the run that the ledger knows?
    fn open_ledger(&mut self) {
        let Some(ledger) = &mut self.ledger else { return };
        if ledger.expected != Some((self.state.steps, self.state.start)) {
            ledger.expected = None;
            ledger.len = 0;
        } else if ledger.len > 0 {
            self.note_inputs();
        }
    }

    /// Writes the inputs down where they changed, and what a moved control put in.
    fn note_inputs(&mut self) {
        let Some(mut ledger) = self.ledger.take() else { return };
        if ledger.seen.ctrl != self.inputs.ctrl {
            ledger.work += self.stored_in_servos(&self.inputs);
            ledger.work += -self.stored_in_servos(&ledger.seen);
        }
        ledger.note_inputs(self.state.steps, &self.inputs);
        self.ledger = Some(ledger);
    }

    /// Balances the account at a milestone; returns the steps to the next one.
    fn balance(&mut self) -> Result<u64> {
        let Some(mut ledger) = self.ledger.take() else { return Ok(u64::MAX) };
        let newest = ledger.newest_first().next();
        let since = newest.map_or(STRIDE, |newest| self.state.steps - newest.state.steps);
        let mut outcome = Ok(());
        if since >= STRIDE {
            outcome = self.balance_now(&mut ledger);
        }
        self.ledger = Some(ledger);
        outcome.map(|()| if since >= STRIDE { STRIDE } else { STRIDE - since })
    }

    fn balance_now(&mut self, ledger: &mut Ledger<R>) -> Result<()> {
        if !self.audit(&mut ledger.levels) {
            return Ok(());
        }
        let new = ledger.expected.is_none();
        ledger.expected = Some((self.state.steps, self.state.start));
        let mut outcome = Ok(());
        let mut gained = [0.0; 64];
        if new {
            ledger.accounts.clear();
            ledger.accounts.extend(ledger.levels.iter().map(Account::open));
            ledger.balanced = false;
        } else {
            outcome = self.judge(ledger, &mut gained);
        }
        ledger.work = R::zero();
        ledger.keep(&self.state, &self.inputs);
        self.inputs.copy_to(&mut ledger.seen);
        let newest = ledger.at;
        ledger.milestones[newest].gained.copy_from_slice(&gained[..R::LANES]);
        if outcome.is_err() {
            // Whoever goes on from here opens a new account.
            ledger.forget();
        }
        outcome
    }

    /// Judges every lane by the levels at hand; `gained` beside what circulated.
    fn judge(&mut self, ledger: &mut Ledger<R>, gained: &mut [f64; 64]) -> Result<()> {
        ledger.balanced = true;
        let mut outcome = Ok(());
        for lane in 0..R::LANES {
            let work = ledger.work.lane(lane);
            let verdict = ledger.accounts[lane].judge::<R>(&ledger.levels[lane], work);
            let scale = ledger.accounts[lane].scale;
            gained[lane] = if scale > 0.0 { verdict.gained / scale } else { 0.0 };
            let told = !ledger.quiet && self.is_world(lane);
            if verdict.gained > verdict.limit && told && outcome.is_ok() {
                outcome = self.suspect(ledger, lane, verdict.gained);
            }
        }
        outcome
    }

    /// At the end of a call of `n` steps, in however many portions these were made: balances
    /// the account if the call was long, or the account never was balanced. No milestone is
    /// made, and nothing that can be read changes.
    pub fn balance_at_end(&mut self, n: u64) -> Result<()> {
        let due = |ledger: &Ledger<R>| n >= LONG || (n >= SHORT && !ledger.balanced);
        if !self.ledger.as_deref().is_some_and(due) {
            return Ok(());
        }
        self.open_ledger();
        let Some(mut ledger) = self.ledger.take() else { return Ok(()) };
        let newest = ledger.newest_first().next().map(|newest| newest.state.steps);
        let mut outcome = Ok(());
        if newest.is_some_and(|steps| steps < self.state.steps) {
            outcome = self.balance_aside(&mut ledger);
        }
        self.ledger = Some(ledger);
        outcome
    }

    fn balance_aside(&mut self, ledger: &mut Ledger<R>) -> Result<()> {
        let mut aside = match ledger.aside.take() {
            Some(aside) => aside,
            None => {
                let settings = Settings { ledger: false, ..self.settings.clone() };
                Box::new(Sim::new(self.model.clone(), settings)?)
            }
        };
        self.state.copy_to(&mut aside.state);
        self.inputs.copy_to(&mut aside.inputs);
        let summed = aside.audit(&mut ledger.levels);
        ledger.aside = Some(aside);
        if !summed {
            return Ok(());
        }
        let outcome = self.judge(ledger, &mut [0.0; 64]);
        ledger.work = R::zero();
        if outcome.is_err() {
            ledger.forget();
        }
        outcome
    }

    /// After a step that can be committed: the work of what drove it.
    pub(crate) fn pay(&mut self) {
        let work = self.driven();
        if let Some(ledger) = &mut self.ledger {
            ledger.work += work;
        }
    }

    /// Balances the account of a run that ended: what was gained, and what circulated.
    fn total(&mut self, lane: usize) -> Option<[f64; 2]> {
        let mut ledger = self.ledger.take()?;
        self.audit(&mut ledger.levels);
        let work = ledger.work.lane(lane);
        let account = ledger.accounts.get_mut(lane)?;
        let verdict = account.judge::<R>(&ledger.levels[lane], work);
        Some([verdict.gained, account.scale])
    }

    /// More energy than there can be: an error, unless a closer look shows where it is from.
    #[cold]
    fn suspect(&mut self, ledger: &mut Ledger<R>, lane: usize, gained: f64) -> Result<()> {
        let account = ledger.accounts[lane];
        let swing = self.swing(lane, self.settings.dt);
        if gained <= (swing - 1.0) * account.scale {
            // A healthy run of these springs swings as far.
            ledger.accounts[lane].allow(gained, swing - 1.0);
            return Ok(());
        }
        if !self.smaller_steps_gain_less(ledger, lane) {
            ledger.accounts[lane].allow(gained, 0.0);
            return Ok(());
        }
        let quantity = format!(
            "the energy of motion and springs is {} J, of which a passive scene can have {} J",
            times(ledger.levels[lane].moving),
            times(account.scale)
        );
        Err(self.found(Some(ledger), lane, quantity, true))
    }
}
