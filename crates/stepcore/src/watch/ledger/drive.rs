//! What drives from outside: the work of motors and applied forces, and what moving the
//! control of a servo puts into its spring. What is which, `elements/` says.

use crate::elements::force::{Group, Moment};
use crate::elements::forces::{power, stored};
use crate::observer::Observer;
use crate::real::Real;
use crate::sim::{At, Sim};
use crate::state::Inputs;

/// Work of motors and applied forces [J], by lane.
pub(super) struct Work<R: Real> {
    pub done: R,
    /// Something can do work at all.
    pub counts: bool,
}

impl<R: Real> Default for Work<R> {
    fn default() -> Self {
        Self { done: R::zero(), counts: false }
    }
}

impl<R: Real> Observer<R> for Work<R> {
    fn committing(&mut self, sim: &Sim<R>) {
        if self.counts {
            self.done += sim.driven();
        }
    }
}

impl<R: Real> Sim<R> {
    /// What all servos store under some controls.
    pub(super) fn stored_in_servos(&self, inputs: &Inputs<R>) -> R {
        let mut sum = R::zero();
        let now = Moment { inputs, ..self.moment(At::State) };
        stored(&now, Group::Driven, |_, energy| sum += energy);
        sum
    }

    /// Work of motors and applied forces in the step from `state` to `next`: what they did on
    /// the mean of both velocities.
    fn driven(&self) -> R {
        let half = R::of(0.5);
        self.clock.dt
            * power(&self.moment(At::State), |k| half * (self.state.qvel[k] + self.next.qvel[k]))
    }
}
