//! Registers of worlds, stepped side by side by a list: one operation for all of them, then the next.

use std::sync::Mutex;

use super::order::Ordered;
use super::run::Space;
use super::{Limits, Program};
use crate::pool::lock;
use crate::real::Real;
use crate::room::Room;
use crate::state::State;

/// Registers of worlds in a block.
const WIDE: usize = 8;
/// So many are worth a block of their own, which takes as long as a full one.
pub(super) const WORTH: usize = WIDE / 2;

/// The lists of a program with the registers of every thread.
pub(crate) struct Blocks<R: Real> {
    lists: Lists,
    serves_one: bool,
    free: Mutex<Vec<Desk<R>>>,
}

/// Of all steps but the last, and of that.
struct Lists {
    steps: Ordered,
    last: Ordered,
    limits: Limits,
}

/// Where one thread works: for one register of worlds, and for as many as a block has.
struct Desk<R: Real> {
    one: Pair<R, 1>,
    wide: Pair<R, WIDE>,
}

/// The registers of both lists.
struct Pair<R: Real, const C: usize> {
    steps: Space<R, C>,
    last: Space<R, C>,
}

/// A register of worlds, and where the last of its steps began and what its accelerations were.
pub(crate) struct Place<'a, R: Real> {
    pub state: &'a mut State<R>,
    pub before: &'a mut State<R>,
    pub qacc: &'a mut [R],
}

/// Who holds a register of worlds.
pub(crate) trait Holds<R: Real> {
    fn place(&mut self) -> Place<'_, R>;
}

impl<R: Real> Blocks<R> {
    /// Registers in a block, at most.
    pub const MOST: usize = WIDE;

    pub fn new(program: &Program, threads: usize) -> Self {
        let (steps, last, limits) = (program.steps(), program.last(), program.limits);
        let lists = Lists { steps, last, limits };
        let serves_one = program.serves_one();
        let desk = |_| Desk { one: Pair::new(&lists), wide: Pair::new(&lists) };
        let free = Mutex::new((0..threads).map(desk).collect());
        Self { lists, serves_one, free }
    }

    /// Of so many registers how many are stepped at a time.
    pub fn portion(left: usize) -> usize {
        if left < WORTH {
            1
        } else {
            left.min(WIDE)
        }
    }

    /// Memory of the registers [bytes].
    pub fn bytes(&self) -> usize {
        let of = |desk: &Desk<R>| desk.one.bytes() + desk.wide.bytes();
        lock(&self.free).iter().map(of).sum()
    }

    /// The list is quicker than the stages for so many.
    pub fn serves(&self, registers: usize) -> bool {
        registers > 1 || self.serves_one
    }

    /// Takes `n` steps, one or more, of at most `MOST` registers. False: the list is not right for
    /// them, and nothing has changed.
    pub fn step(&self, n: u64, worlds: &mut [impl Holds<R>]) -> bool {
        // There is one for every thread.
        let Some(desk) = lock(&self.free).pop() else { return false };
        let right = match worlds.len() {
            1 => desk.one.step(&self.lists, n, worlds),
            _ => desk.wide.step(&self.lists, n, worlds),
        };
        lock(&self.free).push(desk);
        right
    }
}

impl<R: Real, const C: usize> Pair<R, C> {
    fn new(lists: &Lists) -> Self {
        Self { steps: Space::new(&lists.steps), last: Space::new(&lists.last) }
    }

    fn bytes(&self) -> usize {
        self.steps.room() + self.last.room()
    }

    fn step(&self, lists: &Lists, n: u64, worlds: &mut [impl Holds<R>]) -> bool {
        let Lists { limits, steps, last } = lists;
        let [q, v] = [limits.qpos, limits.qvel].map(R::of);
        let first = worlds[0].place();
        let (nq, nv) = (first.state.qpos.len(), first.state.qvel.len());
        let of_state = |at: usize| if at < nq { q } else { v };
        self.steps.begin();
        for part in 0..C {
            // What has no worlds repeats the last one.
            let state = worlds[part.min(worlds.len() - 1)].place().state;
            let numbers = state.qpos.iter().chain(&state.qvel);
            numbers.enumerate().for_each(|(at, x)| self.steps.set(at, part, *x));
        }
        let check = |space: &Space<R, C>| {
            (0..nq + nv).for_each(|at| space.require(at, of_state(at)));
        };
        check(&self.steps);
        for _ in 1..n {
            self.steps.step(steps, q);
        }
        check(&self.steps);
        self.last.begin();
        for (at, part) in (0..nq + nv).flat_map(|at| (0..C).map(move |part| (at, part))) {
            self.last.set(at, part, self.steps.get(at, part));
        }
        self.last.step(last, q);
        check(&self.last);
        if !(self.steps.was_right() && self.last.was_right()) {
            return false;
        }
        for (part, place) in worlds.iter_mut().map(Holds::place).enumerate() {
            (place.before.start, place.before.steps) =
                (place.state.start, place.state.steps + n - 1);
            place.state.steps += n;
            for at in 0..nq {
                place.before.qpos[at] = self.steps.get(at, part);
                place.state.qpos[at] = self.last.get(at, part);
            }
            for at in 0..nv {
                place.before.qvel[at] = self.steps.get(nq + at, part);
                place.state.qvel[at] = self.last.get(nq + at, part);
                place.qacc[at] = self.last.get(nq + nv + at, part);
            }
        }
        true
    }
}
