//! The worlds of one register of lanes, and their stay in the working space of a thread.

use super::failed::Standing;
use crate::arrays::{ArraySet, Given, Givens};
use crate::error::{Divergence, Error, Result};
use crate::model::Model;
use crate::program::{Holds, Place};
use crate::real::Real;
use crate::state::{Inputs, State};
use crate::warm::Sleep;
use crate::watch::{Care, Ledger, Watched};
use std::sync::Arc;

/// What the last solve of the worlds belonged to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Last {
    Nothing,
    Forward,
    Step,
}

/// As many worlds as a number has lanes.
pub(super) struct Group<R: Real> {
    pub state: State<R>,
    pub inputs: Inputs<R>,
    /// Who sleeps in a world that begins anew.
    initial: Arc<Sleep<R>>,
    /// Acceleration of the last solve.
    pub qacc: Vec<R>,
    /// The state when the call began.
    pub start: State<R>,
    /// The state when the last solve began, from which it can be done again: its rows
    /// are in the working space of a thread, and gone with the next group.
    pub before: State<R>,
    /// By lane.
    pub last: Vec<Last>,
    /// Steps done in this call before one failed, and why it did.
    pub failed: Option<(u64, Error)>,
    /// Worlds that failed while the others went on.
    pub standing: Standing,
    /// By lane: all worlds stopped because of it. Its impulses are no start for another state.
    pub ended: Vec<bool>,
    pub ledger: Option<Box<Ledger<R>>>,
}

room!(Group<R>: state, inputs, initial, qacc, start, before, last, standing, ended, ledger; failed);

impl<R: Real> Group<R> {
    /// A lane's next step starts without impulses, and nothing is known of its last solve; a world
    /// that failed tries again.
    pub fn forget(&mut self, lane: usize) {
        self.state.forget_impulses(lane);
        self.before.forget_impulses(lane);
        // Where somebody sleeps there is one lane.
        self.put_to_sleep();
        // A lane to spare repeats a world, and has no place of its own here.
        self.standing.lanes.get_mut(lane).iter_mut().for_each(|place| **place = None);
        self.ended[lane] = false;
        self.last[lane] = Last::Nothing;
        self.ledger.iter_mut().for_each(|ledger| ledger.forget());
    }

    /// `worlds` of a model, at qpos0 and at rest.
    pub fn new(model: &Model, initial: Arc<Sleep<R>>, worlds: usize, care: Option<Care>) -> Self {
        let mut state = State::new(model);
        initial.copy_to(&mut state.sleep);
        Self {
            state,
            initial,
            inputs: Inputs::new(model),
            qacc: vec![R::zero(); model.nv],
            start: State::new(model),
            before: State::new(model),
            last: vec![Last::Nothing; R::LANES],
            failed: None,
            standing: Standing::new(worlds),
            ended: vec![false; R::LANES],
            ledger: care.map(|care| Box::new(Ledger::new(model, care))),
        }
    }

    /// Those sleep who do so from the start.
    pub fn put_to_sleep(&mut self) {
        self.initial.copy_to(&mut self.state.sleep);
        self.initial.copy_to(&mut self.before.sleep);
    }

    /// No list can step it as it is.
    pub fn is_special(&self) -> bool {
        self.ledger.as_ref().is_some_and(|ledger| ledger.is_full())
            || self.standing.any()
            || self.inputs.applied()
            || self.state.carries()
    }

    /// A list has stepped it.
    pub fn listed(&mut self) {
        self.last.fill(Last::Step);
        self.ledger.iter_mut().for_each(|ledger| ledger.went_on(&self.state));
    }

    /// Steps until somebody looks at its energies, if anybody does.
    pub fn until_look(&self) -> Option<u64> {
        self.ledger.as_ref().map(|ledger| ledger.until_due(&self.state))
    }

    /// What there is to say of a world whose energies cannot be, which is that of a lane.
    pub fn take_said(&mut self) -> Option<Box<Divergence>> {
        self.ledger.as_mut()?.take_said()
    }

    /// Unless the settings ask for it, there is no account of energies any more.
    pub fn unwatch(&mut self) {
        self.ledger = self.ledger.take().filter(|ledger| ledger.is_full());
    }

    /// Some world of it failed in this call.
    pub fn has_failed(&self) -> bool {
        self.failed.is_some() || self.standing.any()
    }

    /// As it was when the call began, when none had failed.
    pub fn begin_again(&mut self) {
        self.start.copy_to(&mut self.state);
        self.standing.lanes.fill(None);
    }

    /// Takes the arrays of the world in lane `own`; `worlds`: how many worlds the group has.
    pub fn put(&mut self, own: usize, worlds: usize, given: &Given) {
        if let Some(failed) = &self.standing.lanes[own] {
            if failed.stands(given) {
                return;
            }
            self.standing.lanes[own] = None;
            // Its lane repeated another, whose impulses are none of its own.
            self.state.forget_impulses(own);
        }
        let last = if own + 1 == worlds { R::LANES } else { own + 1 };
        for lane in own..last {
            if self.state.put(lane, given) {
                self.moved(lane);
            }
            self.inputs.put(lane, given, ArraySet::ALL);
        }
    }

    /// Takes the arrays of all its worlds, `own`; idle: no force is applied in them.
    pub fn put_all(&mut self, own: &[usize], given: &Givens, idle: bool) {
        if !idle || self.inputs.applied() || self.standing.any() {
            for (lane, world) in own.iter().enumerate() {
                self.put(lane, own.len(), &given.of(*world));
            }
            return;
        }
        for lane in 0..R::LANES {
            // Lanes to spare repeat the last world.
            let world = own[lane.min(own.len() - 1)];
            if self.state.put_of(lane, given, world) {
                self.moved(lane);
            }
            self.inputs.put_idle(lane, given, world);
        }
    }

    /// A lane's state did not come from a step.
    fn moved(&mut self, lane: usize) {
        if std::mem::take(&mut self.ended[lane]) {
            self.state.forget_impulses(lane);
        }
        self.ledger.iter_mut().for_each(|ledger| ledger.forget());
    }

    /// Runs `one` up to `n` times on this group's state in a thread's working space; `worlds`: whose
    /// the lanes are.
    pub fn run(
        &mut self,
        watched: &mut Watched<R>,
        worlds: &[usize],
        n: u64,
        last: Last,
        goes_on: bool,
        one: impl Fn(u64, &mut Watched<R>) -> Result<()>,
    ) {
        let Self { state, inputs, ledger, standing, before, qacc, .. } = self;
        standing.lanes.iter_mut().flatten().for_each(|failed| failed.done = 0);
        if standing.any() && !standing.mirror(state, inputs) {
            // Nobody is left; time goes on.
            state.steps += if last == Last::Step { n } else { 0 };
            return;
        }
        let copies = standing.mask::<R>();
        let guest = Guest::new(watched, state, inputs, ledger, copies);
        if n == 0 {
            self.failed = guest.watched.look().err().map(|error| (0, error));
            return;
        }
        self.failed = (0..n).find_map(|k| {
            if k + 1 == n {
                guest.watched.sim.state.copy_to(before);
            }
            loop {
                let error = one(k, guest.watched).err()?;
                if !(goes_on && set_aside(standing, guest.watched, worlds, k, &error)) {
                    return Some((k, error));
                }
                if standing.healthy().is_none() {
                    guest.watched.sim.state.steps += if last == Last::Step { n - k } else { 0 };
                    return Some((u64::MAX, error));
                }
            }
        });
        self.failed = self.failed.take().filter(|(k, _)| *k != u64::MAX);
        self.last.fill(last);
        qacc.copy_from_slice(&guest.watched.sim.qacc);
    }
}

impl<R: Real> Holds<R> for Group<R> {
    fn place(&mut self) -> Place<'_, R> {
        let Self { state, before, qacc, .. } = self;
        Place { state, before, qacc }
    }
}

/// A group's worlds in the working space of a thread. They go back when this is dropped, after
/// a panic too.
struct Guest<'a, R: Real> {
    watched: &'a mut Watched<R>,
    state: &'a mut State<R>,
    inputs: &'a mut Inputs<R>,
    ledger: &'a mut Option<Box<Ledger<R>>>,
}

impl<'a, R: Real> Guest<'a, R> {
    fn new(
        watched: &'a mut Watched<R>,
        state: &'a mut State<R>,
        inputs: &'a mut Inputs<R>,
        ledger: &'a mut Option<Box<Ledger<R>>>,
        copies: u64,
    ) -> Self {
        let mut guest = Self { watched, state, inputs, ledger };
        guest.swap(copies);
        guest
    }

    fn swap(&mut self, copies: u64) {
        self.watched.swap(self.ledger, copies);
        std::mem::swap(&mut self.watched.sim.state, self.state);
        std::mem::swap(&mut self.watched.sim.inputs, self.inputs);
    }
}

impl<R: Real> Drop for Guest<'_, R> {
    fn drop(&mut self) {
        self.swap(0);
    }
}

/// Takes the world that failed out of the run, if one did; false for other errors.
fn set_aside<R: Real>(
    standing: &mut Standing,
    watched: &mut Watched<R>,
    worlds: &[usize],
    done: u64,
    error: &Error,
) -> bool {
    let Error::Diverged(divergence) = error else { return false };
    let (lane, mut error) = (divergence.world, error.clone());
    in_batch(&mut error, worlds);
    standing.take(&watched.sim.state, lane, done, error);
    standing.mirror_in(watched);
    true
}

/// A lane's failure becomes that of a world of the batch.
pub(super) fn in_batch(error: &mut Error, worlds: &[usize]) {
    if let Error::Diverged(divergence) = error {
        divergence.world = worlds[divergence.world.min(worlds.len() - 1)];
        divergence.batch = true;
    }
}
