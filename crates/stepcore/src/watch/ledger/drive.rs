//! External drives: the work of motors, applied forces and moving surfaces, and the energy that
//! moving the control of a servo puts into its spring. `elements/` decides which element is which.

use crate::elements::activation::Activations;
use crate::elements::actuator::{power_beyond, stored_under, stores};
use crate::elements::force::Moment;
use crate::elements::forces::power;
use crate::elements::{Element, Kind};
use crate::model::Model;
use crate::observer::Observer;
use crate::real::Real;
use crate::sim::{At, Sim};
use crate::state::Inputs;

/// Work of motors, applied forces and surfaces [J], by lane.
pub(super) struct Work<R: Real> {
    pub done: R,
    /// The mean of both velocities of a step, by dof.
    mean: Vec<R>,
    /// Whether something can do work at all.
    pub counts: bool,
    /// Whether surfaces move.
    belts: bool,
    /// Servos, by actuator, whose whole force counts as driving, and which store nothing in the
    /// account; and whether they are springs.
    driving: Vec<(usize, bool)>,
    /// The servos that store energy; and those among them whose activation or late control moves.
    springs: Vec<usize>,
    remembering: Vec<usize>,
    /// Whether some element has a power besides applied forces.
    powers: bool,
}

room!(Work<R>: done, mean, counts, belts, driving, springs, remembering, powers);

impl<R: Real> Work<R> {
    pub fn new(model: &Model<R::Value>, driving: Vec<usize>) -> Self {
        let belts = model.geoms.iter().any(|geom| geom.belt.is_some());
        let motors = (0..model.actuators.len()).any(|index| !stores(model, index));
        let springs = (0..model.actuators.len())
            .filter(|index| stores(model, *index) && !driving.contains(index))
            .collect();
        let remembers = |index: &usize| {
            stores(model, *index) && model.activations[*index].len + model.histories[*index].len > 0
        };
        Self {
            done: R::zero(),
            mean: vec![R::zero(); model.nv],
            counts: false,
            belts,
            driving: driving.into_iter().map(|index| (index, stores(model, index))).collect(),
            springs,
            remembering: (0..model.actuators.len()).filter(remembers).collect(),
            powers: motors || model.compensates || !model.fluid.parts.is_empty(),
        }
    }

    /// Starts a call of steps.
    pub fn begin(&mut self, sim: &Sim<R>) {
        self.counts = self.belts || !sim.model.actuators.is_empty() || sim.inputs.applied();
    }

    /// Whether the stored energy of an element is left out of the account.
    pub fn drives(&self, element: Element) -> bool {
        let drives = |(index, _): &(usize, bool)| *index == element.index as usize;
        element.kind == Kind::Actuator && self.driving.iter().any(drives)
    }
}

impl<R: Real> Observer<R> for Work<R> {
    fn looks_inside(&self) -> bool {
        self.counts
    }

    fn committing(&mut self, sim: &Sim<R>) {
        if self.counts {
            let both = sim.state.qvel.iter().zip(&sim.next.qvel);
            for (mean, (old, new)) in self.mean.iter_mut().zip(both) {
                *mean = R::of(0.5) * (*old + *new);
            }
            self.done += sim.driven(self);
            if self.belts {
                self.done += sim.clock.dt * sim.power_of_surfaces();
            }
        }
    }
}

impl<R: Real> Sim<R> {
    /// The energy that moving the controls from `old` put into the storing servos of an account.
    pub(super) fn put_into_servos(&self, old: &Inputs<R>, work: &Work<R>) -> R {
        let mut sum = R::zero();
        if work.springs.is_empty() || old.ctrl == self.inputs.ctrl {
            return sum;
        }
        let now = self.moment(At::State);
        for &index in &work.springs {
            let stored = |inputs: &Inputs<R>| {
                let ctrl = now.act.ctrl(now.model, index, inputs);
                stored_under(now.model, index, now.qpos, now.frames.pulls, now.act, ctrl)
            };
            sum += stored(&self.inputs) + -stored(old);
        }
        sum
    }

    /// Work of motors, applied forces and some servos in the step from `state` to `next`: their
    /// force times the mean of both velocities.
    fn driven(&self, work: &Work<R>) -> R {
        let now = self.moment(At::State);
        let mut sum = R::zero();
        if work.powers || self.inputs.applied() {
            sum += power(&now, &work.mean);
        }
        for (index, stores) in &work.driving {
            sum += power_beyond(&now, *index, *stores, &work.mean);
        }
        self.clock.dt * sum + self.driven_by_activations(&now, work)
    }

    /// The energy that moving activations and late controls put into the springs of their servos.
    fn driven_by_activations(&self, now: &Moment<R>, work: &Work<R>) -> R {
        let mut sum = R::zero();
        let (act, history) = (&self.next.act, &self.next.ctrl_history);
        let after = Activations { act, history, ..now.act };
        for &index in &work.remembering {
            let stored = |act: Activations<R>| {
                let ctrl = act.ctrl(&self.model, index, now.inputs);
                stored_under(&self.model, index, now.qpos, now.frames.pulls, act, ctrl)
            };
            sum += stored(after) + -stored(now.act);
        }
        sum
    }
}
