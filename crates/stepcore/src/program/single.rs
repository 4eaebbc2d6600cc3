//! A world, or a register of worlds, stepped by a list.

use std::sync::{Arc, Mutex};

use super::order::Ordered;
use super::run::Space;
use super::{Limits, Program, ALONE};
use crate::model::Model;
use crate::observer::Observer;
use crate::pool::inside;
use crate::real::Real;
use crate::settings::Settings;
use crate::sim::Sim;

/// Entries of which so few operations may be left: some are folded into others, and some nothing
/// needs.
const ENTRIES: usize = 3 * ALONE;

/// A list and its registers.
pub(crate) struct Listed<R: Real> {
    list: Ordered,
    space: Space<R, 1>,
    limits: Limits,
    sweeps: u64,
}

room!(Listed<R>: space, limits, sweeps; list);

impl<R: Real> Listed<R> {
    /// That of a model, if it has one that is quicker than the stages.
    fn of(model: &Arc<Model>, settings: &Settings) -> Option<Self> {
        let program = Program::within::<R>(model, settings, ENTRIES)?;
        let list = program.counted();
        let Program { limits, sweeps, .. } = program;
        (list.steps.len() <= ALONE).then(|| Self { space: Space::new(&list), list, limits, sweeps })
    }
}

impl<R: Real> Sim<R> {
    /// Steps that nobody looks at are made by the list of this model, if it has one. The numbers are
    /// the same.
    pub fn use_list(&mut self) {
        self.list = Listed::of(&self.model, &self.settings).map(|list| Box::new(Mutex::new(list)));
    }

    /// A step by the list; false: it is none that the list is right for, and nothing has changed.
    #[inline]
    pub(crate) fn step_by_list<O: Observer<R>>(&mut self, observer: &mut O) -> bool {
        if self.list.is_none() || observer.looks_inside() || self.inputs.applied() {
            return false;
        }
        if self.state.carries() || !self.next.warm.is_empty() || !self.run_list() {
            return false;
        }
        observer.committing(self);
        std::mem::swap(&mut self.state.qpos, &mut self.next.qpos);
        std::mem::swap(&mut self.state.qvel, &mut self.next.qvel);
        self.state.steps += 1;
        true
    }

    /// Runs the list on the state, into `next`; false: it is not right there.
    #[inline]
    fn run_list(&mut self) -> bool {
        let Self { list: Some(list), state, next, effort, .. } = self else { return false };
        let Listed { list, space, limits, sweeps } = inside(list);
        let (nq, nv) = (state.qpos.len(), state.qvel.len());
        let [q, v] = [limits.qpos, limits.qvel].map(R::of);
        space.begin();
        for (at, x) in state.qpos.iter().enumerate() {
            space.set(at, 0, *x);
            space.require(at, q);
        }
        for (at, x) in state.qvel.iter().enumerate() {
            space.set(nq + at, 0, *x);
            space.require(nq + at, v);
        }
        space.step(list, q);
        (nq..nq + nv).for_each(|at| space.require(at, v));
        if !space.was_right() {
            return false;
        }
        (0..nq).for_each(|at| next.qpos[at] = space.get(at, 0));
        (0..nv).for_each(|at| next.qvel[at] = space.get(nq + at, 0));
        // Counts of a register are nobody's.
        let rows = space.get(nq + nv, 0).lane(0) as usize;
        effort.evaluations += 1;
        effort.most_rows = effort.most_rows.max(rows);
        effort.row_updates += rows as u64 * *sweeps;
        true
    }
}
