//! The worlds of one register of lanes, and their time in the working space of a thread.

use super::failed::Standing;
use crate::arrays::{ArraySet, Given, Givens};
use crate::error::{Divergence, Error, Result};
use crate::interrupt::{caught, unasked};
use crate::model::SideBySide;
use crate::real::Real;
use crate::sim::{Sim, Stretches};
use crate::state::{Inputs, State};
use crate::warm::Sleep;
use crate::watch::{Care, Ledger, Past, Watched};
use std::sync::Arc;

/// The call to which the last solve of the worlds belonged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Last {
    Nothing,
    Forward,
    Step,
}

/// As many worlds as a number has lanes.
pub(super) struct Group<R: Real> {
    /// The models of its worlds; and with the models of the worlds that copies repeat.
    pub models: SideBySide<R>,
    mirrored: Mirrored<R>,
    pub state: State<R>,
    pub inputs: Inputs<R>,
    /// The sleeping trees of a new world.
    initial: Arc<Sleep<R>>,
    /// Acceleration of the last solve.
    pub qacc: Vec<R>,
    /// Forces of actuators in the last solve, if they were kept.
    actuator: Vec<R>,
    keeps_actuator: bool,
    /// The state at the start of the call.
    pub start: State<R>,
    /// The state at the start of the last solve, from which it can be repeated: its rows are in the
    /// working space of a thread, and gone with the next group.
    pub before: State<R>,
    /// One entry for each lane.
    pub last: Vec<Last>,
    /// Whether this call has begun, so that `start` is its start.
    pub begun: bool,
    /// Steps done in this call before one failed, and the error.
    pub failed: Option<(u64, Error)>,
    /// Worlds that failed while the others continued.
    pub standing: Standing,
    /// For each lane: whether it stopped all worlds. Its impulses must start no other state.
    pub ended: Vec<bool>,
    /// The parts of its last adaptive step.
    pub stretches: Stretches,
    pub past: Past<R>,
    pub ledger: Option<Box<Ledger<R>>>,
}

room!(Group<R>: models, mirrored, state, inputs, initial, qacc, actuator, keeps_actuator, start, before, last,
    standing, ended, past, ledger; stretches, begun, failed);

impl<R: Real> Group<R> {
    /// Makes a lane's next step start without impulses, and removes its last solve; a failed world
    /// tries again.
    pub fn forget(&mut self, lane: usize) {
        self.state.forget_impulses(lane);
        self.before.forget_impulses(lane);
        // With sleep there is one lane.
        self.put_to_sleep();
        // A spare lane repeats a world, and has no place here.
        self.standing.lanes.get_mut(lane).iter_mut().for_each(|place| **place = None);
        self.ended[lane] = false;
        self.last[lane] = Last::Nothing;
        self.past.forget(lane);
        self.qacc.iter_mut().for_each(|a| a.set_lane(lane, 0.0));
        self.ledger.iter_mut().for_each(|ledger| ledger.forget());
    }

    /// Sets the start of the last solve of the world in lane `own`: these arrays.
    pub fn begin(&mut self, own: usize, worlds: usize, given: &Given, of: Last, qacc: &[f64]) {
        let last = if own + 1 == worlds { R::LANES } else { own + 1 };
        for lane in own..last {
            self.before.put(lane, given);
            self.inputs.put(lane, given, ArraySet::ALL);
            self.last[lane] = of;
            self.keeps_actuator = false;
            self.qacc.iter_mut().zip(qacc).for_each(|(to, from)| to.set_lane(lane, *from));
        }
    }

    /// Replaces the models of its worlds.
    pub fn take_models(&mut self, models: SideBySide<R>) {
        let care = self.ledger.as_ref().map(|ledger| ledger.care());
        self.ledger = care.map(|care| Box::new(Ledger::new(&models.model, care)));
        self.models = models;
        self.mirrored = Mirrored { copies: 0, models: None };
    }

    /// `worlds` of these models, at qpos0 and at rest.
    pub fn new(
        models: SideBySide<R>,
        initial: Arc<Sleep<R>>,
        worlds: usize,
        care: Option<Care>,
    ) -> Self {
        let model = &*models.model;
        let mut state = State::new(model);
        initial.copy_to(&mut state.sleep);
        Self {
            state,
            initial,
            inputs: Inputs::new(model),
            qacc: vec![R::zero(); model.nv],
            actuator: vec![R::zero(); model.actuators.len()],
            keeps_actuator: false,
            start: State::new(model),
            before: State::new(model),
            last: vec![Last::Nothing; R::LANES],
            begun: false,
            failed: None,
            standing: Standing::new(worlds),
            ended: vec![false; R::LANES],
            stretches: Stretches::default(),
            past: Past::new(model),
            ledger: care.map(|care| Box::new(Ledger::new(model, care))),
            models,
            mirrored: Mirrored { copies: 0, models: None },
        }
    }

    /// Puts the trees to sleep that sleep from the start.
    pub fn put_to_sleep(&mut self) {
        self.initial.copy_to(&mut self.state.sleep);
        self.initial.copy_to(&mut self.before.sleep);
    }

    /// The warning about a world with impossible energies, which is the world of a lane.
    pub fn take_said(&mut self) -> Option<Box<Divergence>> {
        self.ledger.as_mut()?.take_said()
    }

    /// Ends the account of energies, unless the settings request it.
    pub fn unwatch(&mut self) {
        self.ledger = self.ledger.take().filter(|ledger| ledger.is_full());
    }

    /// Copies the arrays of the world in lane `own`; `worlds`: how many worlds the group has.
    pub fn put(&mut self, own: usize, worlds: usize, given: &Given) {
        if let Some(failed) = &self.standing.lanes[own] {
            if failed.stands(given) {
                return;
            }
            self.standing.lanes[own] = None;
            // Its lane repeated another, whose impulses do not belong to it.
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

    /// Copies the arrays of all its worlds, `own`; idle: no force is applied in them.
    #[inline(never)] // Once a call: copies of it in each caller would only be large.
    pub fn put_all(&mut self, own: &[usize], given: &Givens, idle: bool) {
        if !idle || self.inputs.applied() || self.standing.any() {
            for (lane, world) in own.iter().enumerate() {
                self.put(lane, own.len(), &given.of(*world));
            }
            return;
        }
        for lane in 0..R::LANES {
            // Spare lanes repeat the last world.
            let world = own[lane.min(own.len() - 1)];
            if self.state.put_of(lane, given, world) {
                self.moved(lane);
            }
            self.inputs.put_idle(lane, given, world);
        }
    }

    /// Records that a lane's state did not come from a step.
    fn moved(&mut self, lane: usize) {
        if std::mem::take(&mut self.ended[lane]) {
            self.state.forget_impulses(lane);
        }
        self.past.forget(lane);
        self.ledger.iter_mut().for_each(|ledger| ledger.forget());
    }

    /// Puts all worlds back to the start of the call; `done` of its steps are repeated.
    pub fn go_back(&mut self, done: u64) {
        if self.state.steps - self.start.steps == done {
            self.past.rewind(done);
        } else {
            // Later states have overwritten older ones.
            (0..R::LANES).for_each(|lane| self.past.forget(lane));
        }
        self.start.copy_to(&mut self.state);
        self.ledger.iter_mut().for_each(|ledger| ledger.forget());
    }

    /// Records that nothing is solved at the present states.
    pub fn unsolved(&mut self) {
        self.state.copy_to(&mut self.before);
        self.last.fill(Last::Nothing);
        self.qacc.fill(R::zero());
    }

    /// Begins a call, to whose start `go_back` returns.
    pub fn begin_call(&mut self) {
        self.state.copy_to(&mut self.start);
        self.begun = true;
    }

    /// Does part of a call. If it is interrupted, the working space is made anew.
    pub fn attempt(
        &mut self,
        watched: &mut Watched<R>,
        work: impl FnOnce(&mut Self, &mut Watched<R>),
    ) {
        let outcome = caught(|| {
            work(self, watched);
            Ok(())
        });
        if let Err(error) = outcome {
            unasked(|| watched.sim.renew());
            self.failed = Some((0, error));
        }
    }

    /// Stops all worlds because one failed, the one in lane `failed` if it is here. Readings are
    /// then for the present states, and do not depend on how calls divided the steps.
    pub fn stop(&mut self, watched: &mut Watched<R>, failed: Option<usize>) {
        for lane in (0..R::LANES).filter(|lane| Some(*lane) != failed) {
            self.past.forget(lane);
        }
        failed.into_iter().for_each(|lane| self.ended[lane] = true);
        self.ledger.iter_mut().for_each(|ledger| ledger.forget());
        drop(self.take_said());
        self.state.copy_to(&mut self.before);
        self.last.fill(Last::Forward);
        self.keeps_actuator = false;
        watched.sim.qacc.fill(R::zero());
        // If that fails there is no acceleration.
        let _ = self.look(watched, |watched| watched.sim.whole(Sim::forward));
        for lane in 0..R::LANES {
            let qacc = watched.sim.qacc.iter().map(|a| a.lane(lane));
            let some = qacc.clone().all(f64::is_finite);
            self.qacc
                .iter_mut()
                .zip(qacc)
                .for_each(|(to, a)| to.set_lane(lane, if some { a } else { 0.0 }));
        }
    }

    /// Lets `look` see its worlds in a thread's working space.
    pub fn look<T>(
        &mut self,
        watched: &mut Watched<R>,
        look: impl FnOnce(&mut Watched<R>) -> T,
    ) -> T {
        let Self { models, mirrored, state, inputs, past, ledger, standing, .. } = self;
        watched.sim.take_models(mirrored.of(models, standing));
        let guest = Guest { watched, state, inputs, past, ledger };
        look(guest.come(standing.mask::<R>()).watched)
    }

    /// Runs `one` up to `n` times on this group's state in a thread's working space; `worlds`: the
    /// worlds in the lanes. After each, worlds may fail in `check` as they do in `one`.
    #[allow(clippy::too_many_arguments)]
    #[inline(never)] // As `put_all`.
    pub fn run(
        &mut self,
        watched: &mut Watched<R>,
        worlds: &[usize],
        n: u64,
        last: Last,
        goes_on: bool,
        one: impl Fn(u64, &mut Watched<R>) -> Result<()>,
        check: impl Fn(u64, &mut Watched<R>) -> Result<()>,
    ) {
        let Self { models, mirrored, state, inputs, past, ledger, standing, before, qacc, .. } =
            self;
        let steps = last == Last::Step;
        standing.lanes.iter_mut().flatten().for_each(|failed| failed.done = 0);
        if standing.any() && !standing.mirror(state, inputs) {
            // No world is left; time continues.
            state.steps += if steps { n } else { 0 };
            return;
        }
        let copies = standing.mask::<R>();
        watched.sim.take_models(mirrored.of(models, standing));
        // In adaptive steps the last solve belongs to a part of a step, so worlds, which then are
        // one by one, end with a solve at their state.
        let solves = steps && watched.sim.settings.accuracy.0.is_some();
        let last = if solves { Last::Forward } else { last };
        let guest = Guest { watched, state, inputs, past, ledger }.come(copies);
        if n == 0 {
            let ended = guest.watched.end_account();
            self.failed = ended.err().map(|error| (0, error));
            return;
        }
        self.failed = (0..n).find_map(|k| {
            if k + 1 == n {
                guest.watched.sim.state.copy_to(before);
            }
            let mut stepped = false;
            loop {
                let mut outcome =
                    if stepped { check(k, guest.watched) } else { one(k, guest.watched) };
                if solves && k + 1 == n && outcome.is_ok() && !stepped {
                    guest.watched.sim.state.copy_to(before);
                    outcome = guest.watched.forward();
                }
                let Err(error) = outcome else {
                    if std::mem::replace(&mut stepped, true) {
                        return None;
                    }
                    continue;
                };
                let done = k + u64::from(stepped);
                if !(goes_on && set_aside(standing, guest.watched, worlds, done, &error)) {
                    return Some((done, error));
                }
                guest.watched.sim.take_models(mirrored.of(models, standing));
                if standing.healthy().is_none() {
                    guest.watched.sim.state.steps += if steps { n - done } else { 0 };
                    return Some((u64::MAX, error));
                }
            }
        });
        self.failed = self.failed.take().filter(|(k, _)| *k != u64::MAX);
        self.last.fill(last);
        self.stretches = guest.watched.sim.effort.stretches;
        qacc.copy_from_slice(&guest.watched.sim.qacc);
        self.actuator.copy_from_slice(&guest.watched.sim.placed.actuator);
        self.keeps_actuator = self.failed.is_none() && !standing.any();
    }

    /// Forces of actuators in the last solve, if every world's were kept.
    pub fn actuator(&self) -> Option<&[R]> {
        let kept = self.keeps_actuator && !self.last.contains(&Last::Nothing);
        kept.then_some(&*self.actuator)
    }
}

/// The models of a group in which some lanes repeat a healthy world.
struct Mirrored<R: Real> {
    copies: u64,
    models: Option<SideBySide<R>>,
}

room!(Mirrored<R>: copies, models);

impl<R: Real> Mirrored<R> {
    /// The models of the lanes: copies have the model of the world that they repeat.
    fn of<'a>(&'a mut self, own: &'a SideBySide<R>, standing: &Standing) -> &'a SideBySide<R> {
        let copies = standing.mask::<R>();
        let Some(from) = standing.healthy().filter(|_| copies != 0) else { return own };
        if self.copies != copies {
            let of = |lane: usize| if copies >> lane & 1 == 0 { lane } else { from };
            let all = (0..R::LANES).map(|lane| own.of(of(lane)).clone());
            (self.copies, self.models) = (copies, SideBySide::new(all.collect()).ok());
        }
        self.models.as_ref().unwrap_or(own)
    }
}

/// A group's worlds in the working space of a thread. They are returned when this is dropped, after
/// a panic too.
struct Guest<'a, R: Real> {
    watched: &'a mut Watched<R>,
    state: &'a mut State<R>,
    inputs: &'a mut Inputs<R>,
    past: &'a mut Past<R>,
    ledger: &'a mut Option<Box<Ledger<R>>>,
}

impl<R: Real> Guest<'_, R> {
    fn come(mut self, copies: u64) -> Self {
        self.swap(copies);
        self
    }

    fn swap(&mut self, copies: u64) {
        self.watched.swap(self.past, self.ledger, copies);
        std::mem::swap(&mut self.watched.sim.state, self.state);
        std::mem::swap(&mut self.watched.sim.inputs, self.inputs);
    }
}

impl<R: Real> Drop for Guest<'_, R> {
    fn drop(&mut self) {
        self.swap(0);
    }
}

/// Takes the failed world, if there is one, out of the run; false for other errors.
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

/// Turns a lane's failure into the failure of a world of the batch.
pub(super) fn in_batch(error: &mut Error, worlds: &[usize]) {
    if let Error::Diverged(divergence) = error {
        divergence.world = worlds[divergence.world.min(worlds.len() - 1)];
        divergence.batch = true;
    }
}
