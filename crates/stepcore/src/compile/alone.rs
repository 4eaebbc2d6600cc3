//! One world, or a register of worlds, stepped by code.

use std::sync::Arc;

use super::coming::vectors;
use super::desk::{Compiled, Desk};
use crate::model::Model;
use crate::observer::Observer;
use crate::real::Real;
use crate::scene::JointType;
use crate::settings::{Settings, Solver};
use crate::sim::Sim;

/// Code for a `Sim`, and where it works.
pub(crate) struct Alone<R: Real> {
    desk: Desk<R>,
    /// Row updates for each row.
    sweeps: u64,
}

room!(Alone<R>: desk, sweeps);

/// Operations up to which code is quicker than the stages for one world, of which it fills a vector. A spring
/// takes 23 ns (the stages 55), a ball on the floor 29 (205), towers of two to eight balls with 281
/// operations 85 to 182 (489 to 623); a pendulum of 1009 operations takes as long either way.
const QUICKER: usize = 1000;

/// Whether a step may be that short, before anybody writes it down.
pub(super) fn may_be_short(model: &Model) -> bool {
    let plain = [JointType::Slide, JointType::Hinge];
    model.nv <= 16
        && model.pairs.len() <= 16
        && model.joints.iter().all(|joint| plain.contains(&joint.kind))
        && model.actuators.is_empty()
        && model.tendons.is_empty()
        && model.equalities.is_empty()
}

/// Sweeps over all rows, whatever they are: what a step counts then follows from how many there are.
fn sweeps(settings: &Settings) -> Option<u64> {
    let fixed = settings.solver == Solver::Pgs && settings.tolerance == 0.0;
    fixed.then(|| settings.sweeps.limit().into())
}

impl<R: Real> Sim<R> {
    /// Steps that nobody looks at are made by code of this model, if there is some. The numbers are the
    /// same.
    pub fn use_code(&mut self) {
        let swept = sweeps(&self.settings);
        if vectors().is_none() || !may_be_short(self.model()) || self.settings.accuracy.0.is_some()
        {
            return;
        }
        let code = Compiled::of::<R>(&[self.model().clone()].into(), &self.settings, QUICKER);
        let counts = |code: &Arc<Compiled>| swept.is_some() || code.has_no_rows();
        let code = code.filter(|code| counts(code) && !code.hands_over());
        let alone = |code| Alone { desk: Desk::new(code), sweeps: swept.unwrap_or_default() };
        self.code = code.map(alone).map(Box::new);
    }

    /// Up to `n` steps by code: how many it made. Where it is not right nothing has changed.
    #[inline]
    pub(crate) fn step_by_code<O: Observer<R>>(&mut self, n: u64, observer: &mut O) -> u64 {
        if self.code.is_none() || observer.looks_inside() {
            return 0;
        }
        let Some(mut code) = self.code.take() else { return 0 };
        let made = self.steps_of(&mut code, n, observer);
        self.code = Some(code);
        made
    }

    fn steps_of<O: Observer<R>>(&mut self, alone: &mut Alone<R>, n: u64, observer: &mut O) -> u64 {
        let Alone { desk, sweeps } = alone;
        if !desk.enter(&self.state, &mut self.inputs, &self.model, &[]) {
            return 0;
        }
        let mut made = 0;
        while made < n && desk.step(1) == 1 {
            made += 1;
            let Self { next, effort, .. } = self;
            desk.leave_moving([&mut next.qpos, &mut next.qvel, &mut next.act]);
            let rows = desk.rows();
            effort.evaluations += 1;
            effort.most_rows = effort.most_rows.max(rows);
            effort.row_updates += rows as u64 * *sweeps;
            observer.committing(self);
            self.swap_states();
            self.state.steps += 1;
        }
        if made > 0 {
            desk.leave_warm(&mut self.state.warm);
        }
        made
    }
}
