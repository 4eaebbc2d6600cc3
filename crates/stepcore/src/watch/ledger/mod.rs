//! The ledger: is there more energy than a passive scene can have, and which element supplied it?
//!
//! The engine is deterministic, so little has to be recorded in a normal run: a complete state
//! every 64 steps, the inputs when they change, and the work of external drives. The account is
//! balanced at those milestones only. A run that fails is repeated from the last good milestone,
//! with everything recorded.

mod account;
mod audit;
mod drive;

use account::{Account, Level, Verdict};
use drive::Work;

use crate::error::{Divergence, Error, Result};
use crate::model::Model;
use crate::observer::Observer;
use crate::real::{Constant, Real};
use crate::settings::Settings;
use crate::sim::Sim;
use crate::state::{Inputs, State, INPUTS};

/// How many milestones are kept, and the steps from one to the next.
const MEMORY: usize = 8;
const STRIDE: u64 = 64;
/// The length of a call that is balanced at its end; and of one that is balanced once an account.
const LONG: u64 = 128;
const SHORT: u64 = 8;

/// The thoroughness of a ledger.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Care {
    /// `Settings::ledger`: every 64 steps, for any impossible gain.
    Full,
    /// Without it: at almost no cost, for gains that no healthy run has.
    Least,
}

impl Care {
    /// Steps to the next milestone, this many after the first.
    fn stride(self, since: u64) -> u64 {
        match self {
            Self::Full => STRIDE,
            Self::Least => since.clamp(STRIDE, 4 * STRIDE),
        }
    }

    fn memory(self) -> usize {
        match self {
            Self::Full => MEMORY,
            Self::Least => 3,
        }
    }

    /// The allowed gain as a multiple of the circulating energy. Rows that are solved after the
    /// stages of a step can slowly feed a rocking body, for as long as it rocks: no healthy run
    /// gains a quarter that way.
    fn allowed(self, settings: &Settings) -> f64 {
        match self {
            Self::Full => 1.0,
            Self::Least if settings.rows_after_stages() => 0.25,
            Self::Least => 10.0,
        }
    }

    /// Servos that count as driving: without a ledger, one that swings at the bounds of its force,
    /// and continues, is tolerated.
    fn driving<N: Constant>(self, model: &Model<N>) -> Vec<usize> {
        match self {
            Self::Full => Vec::new(),
            Self::Least => model.bounded_servos().collect(),
        }
    }

    /// The lengths of calls that are balanced at their end, and once an account.
    fn calls(self) -> [u64; 2] {
        match self {
            Self::Full => [LONG, SHORT],
            Self::Least => [4 * STRIDE, STRIDE],
        }
    }
}

/// A complete state, its inputs, and their changes until the next one.
pub(super) struct Milestone<R: Real> {
    pub state: State<R>,
    pub inputs: Inputs<R>,
    /// For each lane: the energy that had circulated [J], and the gain besides it.
    pub scale: Vec<f64>,
    pub gained: Vec<f64>,
    /// Steps done before each change, and which arrays changed.
    pub changes: Vec<(u64, [bool; INPUTS])>,
    /// The changed arrays, one after the other.
    pub numbers: Vec<R>,
}

room!(Milestone<R>: state, inputs, scale, gained, changes, numbers);

/// The stored data on a world's energy while `Settings::ledger` is on.
pub(crate) struct Ledger<R: Real> {
    care: Care,
    /// The step count at which the account was opened.
    opened: u64,
    milestones: Vec<Milestone<R>>,
    /// The newest one, and how many there are.
    at: usize,
    len: usize,
    /// One entry for each lane. No account is open until the first milestone.
    accounts: Vec<Account>,
    levels: Vec<Level>,
    verdicts: Vec<Verdict>,
    /// The work of external drives since the newest milestone.
    work: Work<R>,
    /// The inputs that were recorded last.
    seen: Inputs<R>,
    /// The step count that the next step must find; else the state belongs to another run.
    expected: Option<(u64, f64)>,
    /// Whether it was balanced since it was opened.
    balanced: bool,
    /// The number of lanes whose verdicts were handled: all unless a failure came in between.
    asked: usize,
    /// A warning that the user has not received yet; nothing more is checked.
    said: Option<Box<Divergence>>,
    /// The `Sim` in which a call's last state is examined, so that the last solve stays readable.
    second: Option<Box<Sim<R>>>,
}

room!(Ledger<R>: care, opened, milestones, at, len, accounts, levels, verdicts, work, seen,
    expected, balanced, asked, second; said);

impl<R: Real> Ledger<R> {
    pub fn care(&self) -> Care {
        self.care
    }

    pub fn new(model: &Model<R::Value>, care: Care) -> Self {
        let milestone = || Milestone {
            state: State::new(model),
            inputs: Inputs::new(model),
            scale: vec![0.0; R::LANES],
            gained: vec![0.0; R::LANES],
            changes: Vec::new(),
            numbers: Vec::new(),
        };
        Self {
            care,
            opened: 0,
            milestones: (0..care.memory()).map(|_| milestone()).collect(),
            at: 0,
            len: 0,
            accounts: Vec::with_capacity(R::LANES),
            levels: vec![Level::default(); R::LANES],
            verdicts: vec![Verdict::default(); R::LANES],
            work: Work::new(model, care.driving(model)),
            seen: Inputs::new(model),
            expected: None,
            balanced: false,
            asked: R::LANES,
            said: None,
            second: None,
        }
    }

    /// Records that the present state did not come from a step.
    pub fn forget(&mut self) {
        self.expected = None;
    }

    /// Under the least care an impossible gain becomes a warning, and the run continues.
    pub fn heard(&mut self, error: Error) -> Result<()> {
        match (self.care, error) {
            (Care::Least, Error::Diverged(divergence)) => {
                self.said = Some(divergence);
                Ok(())
            }
            (_, error) => Err(error),
        }
    }

    /// The pending warning.
    pub fn take_said(&mut self) -> Option<Box<Divergence>> {
        self.said.take()
    }

    /// Makes a lane a copy of another.
    pub fn repeat(&mut self, lane: usize, from: usize) {
        if let Some(account) = self.accounts.get(from).copied() {
            self.accounts[lane] = account;
        }
    }

    /// After a failure, continues the other lanes with the same account.
    pub fn go_on(&mut self, state: &State<R>) {
        if self.len > 0 {
            self.expected = Some((state.steps, state.start));
        }
    }

    /// Milestones, newest first.
    pub(super) fn newest_first(&self) -> impl Iterator<Item = &Milestone<R>> {
        let memory = self.milestones.len();
        (0..self.len).map(move |back| &self.milestones[(self.at + memory - back) % memory])
    }

    /// Makes the present state the newest milestone.
    fn keep(&mut self, state: &State<R>, inputs: &Inputs<R>) {
        // A new account starts in the memory that the last one has filled.
        let memory = self.milestones.len();
        self.at = if self.len == 0 { 0 } else { (self.at + 1) % memory };
        self.len = (self.len + 1).min(memory);
        let milestone = &mut self.milestones[self.at];
        state.copy_to(&mut milestone.state);
        inputs.copy_to(&mut milestone.inputs);
        for (lane, account) in self.accounts.iter().enumerate() {
            let gained = self.verdicts[lane].gained / account.scale;
            milestone.scale[lane] = account.scale;
            milestone.gained[lane] = if account.scale > 0.0 { gained } else { 0.0 };
        }
        milestone.changes.clear();
        milestone.numbers.clear();
    }

    /// The account of a lane, if it is open.
    pub fn account(&mut self, lane: usize) -> Option<&mut Account> {
        self.accounts.get_mut(lane)
    }

    /// Energy of motion and springs of a lane when it was last summed up [J].
    pub fn moving(&self, lane: usize) -> f64 {
        self.levels[lane].moving
    }

    /// Advances `sim` by `n` steps, from milestone to milestone. `suspect` is called for each lane
    /// that gained more energy [J] than possible, or is beyond all bounds: it allows it or fails.
    pub fn step<O: Observer<R>>(
        &mut self,
        sim: &mut Sim<R>,
        n: u64,
        observer: &mut O,
        mut suspect: impl FnMut(&mut Self, &Sim<R>, &O, usize, Option<f64>) -> Result<()>,
    ) -> Result<()> {
        self.open(sim);
        self.work.begin(sim);
        let mut left = n;
        let mut outcome = Ok(());
        while left > 0 && outcome.is_ok() {
            let suspect = |ledger: &mut Self, sim: &Sim<R>, lane, gained| {
                suspect(ledger, sim, observer, lane, gained)
            };
            outcome = self.balance(sim, suspect).and_then(|(room, solved)| {
                let portion = left.min(room);
                left -= portion;
                sim.stands = solved && sim.audit_stands();
                sim.step_watched(portion, &mut (&mut self.work, &mut *observer))
            });
        }
        if let Some(expected) = &mut self.expected {
            *expected = (sim.state.steps, sim.state.start);
        }
        outcome
    }

    /// Balances the account of a run that continues elsewhere, whenever it started.
    pub fn end(
        &mut self,
        sim: &mut Sim<R>,
        suspect: impl FnMut(&mut Self, &Sim<R>, usize, Option<f64>) -> Result<()>,
    ) -> Result<()> {
        self.open(sim);
        let newest = self.newest_first().next().map(|newest| newest.state.steps);
        if newest.is_none_or(|steps| steps >= sim.state.steps) {
            return Ok(());
        }
        let effort = sim.effort;
        let solved = sim.audit(&mut self.levels, &self.work);
        sim.effort = effort;
        if !solved {
            return Ok(());
        }
        self.judge(sim, suspect)
    }

    /// Whether this is the account that the settings request.
    pub fn is_full(&self) -> bool {
        self.care == Care::Full
    }

    /// Before a call's first step: checks that this is still the ledger's run.
    fn open(&mut self, sim: &Sim<R>) {
        if self.expected != Some((sim.state.steps, sim.state.start)) {
            self.expected = None;
            (self.len, self.asked) = (0, R::LANES);
        } else if self.len > 0 {
            self.note_inputs(sim);
        }
    }

    /// Records the inputs where they changed, and the energy of a moved control.
    fn note_inputs(&mut self, sim: &Sim<R>) {
        self.work.done += sim.put_into_servos(&self.seen, &self.work);
        let changed = sim.inputs.changes(&self.seen);
        if !changed.contains(&true) {
            return;
        }
        let milestone = &mut self.milestones[self.at];
        milestone.changes.push((sim.state.steps, changed));
        for (array, changed) in sim.inputs.arrays().iter().zip(changed) {
            if changed {
                milestone.numbers.extend_from_slice(array);
            }
        }
        sim.inputs.copy_some(changed, &mut self.seen);
    }

    /// Balances the accounts if a milestone is due. Returns the steps to the next one, and whether
    /// it has solved at the present state, with which the next step then starts.
    fn balance(
        &mut self,
        sim: &mut Sim<R>,
        mut suspect: impl FnMut(&mut Self, &Sim<R>, usize, Option<f64>) -> Result<()>,
    ) -> Result<(u64, bool)> {
        // Left from the last balance: the lanes after one that failed.
        self.ask(sim, &mut suspect)?;
        if let Some(newest) = self.newest_first().next() {
            let stride = self.care.stride(newest.state.steps - self.opened);
            let since = sim.state.steps - newest.state.steps;
            if since < stride {
                return Ok((stride - since, false));
            }
        }
        let effort = sim.effort;
        let solved = sim.audit(&mut self.levels, &self.work);
        if !solved || !sim.audit_stands() {
            // The step solves again, and counts it.
            sim.effort = effort;
        }
        if !solved {
            return Ok((STRIDE, false));
        }
        let new = self.expected.is_none();
        self.expected = Some((sim.state.steps, sim.state.start));
        let mut outcome = Ok(());
        if new {
            self.opened = sim.state.steps;
            let allowed = self.care.allowed(&sim.settings);
            self.accounts.clear();
            self.accounts.extend(self.levels.iter().map(|level| Account::open(level, allowed)));
            self.verdicts.fill(Verdict::default());
            self.balanced = false;
        } else {
            outcome = self.judge(sim, &mut suspect);
        }
        self.work.done = R::zero();
        self.keep(&sim.state, &sim.inputs);
        sim.inputs.copy_to(&mut self.seen);
        outcome.map(|()| (self.care.stride(sim.state.steps - self.opened), true))
    }

    /// Judges every lane by the present levels.
    fn judge(
        &mut self,
        sim: &Sim<R>,
        suspect: impl FnMut(&mut Self, &Sim<R>, usize, Option<f64>) -> Result<()>,
    ) -> Result<()> {
        self.balanced = true;
        let before = self.newest_first().next().map_or(self.opened, |newest| newest.state.steps);
        let steps = sim.state.steps.saturating_sub(before) as f64;
        for lane in 0..R::LANES {
            let work = self.work.done.lane(lane);
            self.verdicts[lane] = self.accounts[lane].judge::<R>(&self.levels[lane], work, steps);
        }
        self.asked = 0;
        self.ask(sim, suspect)
    }

    /// Calls `suspect` for the remaining lanes that gained more than possible, or are beyond all
    /// bounds. A run that continues after an error opens a new account, unless other lanes `go_on`
    /// with this one.
    fn ask(
        &mut self,
        sim: &Sim<R>,
        mut suspect: impl FnMut(&mut Self, &Sim<R>, usize, Option<f64>) -> Result<()>,
    ) -> Result<()> {
        while self.asked < R::LANES {
            let lane = self.asked;
            self.asked += 1;
            let Verdict { gained, limit } = self.verdicts[lane];
            let gained = (gained > limit).then_some(gained);
            if self.said.is_none() && (gained.is_some() || sim.beyond(lane).is_some()) {
                let outcome = suspect(self, sim, lane, gained);
                if outcome.is_err() {
                    self.forget();
                    return outcome;
                }
            }
        }
        Ok(())
    }

    /// Ends a call of `n` steps, in however many portions it was made: balances the account if the
    /// call was long, or the account never was balanced. No milestone is made, and nothing that can
    /// be read changes.
    pub fn balance_at_end(
        &mut self,
        sim: &Sim<R>,
        n: u64,
        suspect: impl FnMut(&mut Self, &Sim<R>, usize, Option<f64>) -> Result<()>,
    ) -> Result<()> {
        let [long, short] = self.care.calls();
        if n < long && (n < short || self.balanced) {
            return Ok(());
        }
        self.open(sim);
        let newest = self.newest_first().next().map(|newest| newest.state.steps);
        if newest.is_none_or(|steps| steps >= sim.state.steps) || !self.audit_aside(sim)? {
            return Ok(());
        }
        let outcome = self.judge(sim, suspect);
        self.work.done = R::zero();
        outcome
    }

    /// Sums up the energies of `sim` in a copy; false if that failed.
    fn audit_aside(&mut self, sim: &Sim<R>) -> Result<bool> {
        let second = match &mut self.second {
            Some(second) => second,
            none => none.insert(Box::new(Sim::side_by_side(sim.models(), sim.settings.clone())?)),
        };
        second.take_models(&sim.models());
        sim.state.copy_to(&mut second.state);
        sim.inputs.copy_to(&mut second.inputs);
        Ok(second.audit(&mut self.levels, &self.work))
    }

    /// Balances the account of a run that ended: the gain, and the circulating energy [J].
    pub fn total(&mut self, sim: &mut Sim<R>, lane: usize) -> Option<[f64; 2]> {
        sim.audit(&mut self.levels, &self.work);
        let work = self.work.done.lane(lane);
        let account = self.accounts.get_mut(lane)?;
        let verdict = account.judge::<R>(&self.levels[lane], work, 0.0);
        Some([verdict.gained, account.scale])
    }
}
