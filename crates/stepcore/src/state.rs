//! The state that a step changes, and the user's inputs.

use crate::arrays::array::{Array, ArraySet};
use crate::model::Model;
use crate::real::{Mask, Real};
use crate::spatial::{Quat, V3};
use crate::warm::{Sleep, Warm};

/// A complete snapshot: a run restored from it continues bit for bit.
#[derive(Clone, Debug, PartialEq)]
pub struct State<R: Real> {
    /// Steps since `start`, and the time there [s]: time = start + steps · dt.
    pub steps: u64,
    pub start: f64,
    /// Positions [m, rad, unit quaternions w x y z], in MuJoCo's order; nq entries.
    pub qpos: Vec<R>,
    /// Velocities [m/s, rad/s], in MuJoCo's order; nv entries.
    pub qvel: Vec<R>,
    /// Activations of actuators, in MuJoCo's order; na entries.
    pub act: Vec<R>,
    /// Past controls of the actuators with delayed controls, each actuator's newest first.
    pub ctrl_history: Vec<R>,
    pub warm: Vec<Warm<R>>,
    /// The sleeping trees.
    pub sleep: Sleep<R>,
}

room!(State<R>: steps, start, qpos, qvel, act, ctrl_history, warm, sleep);

impl<R: Real> State<R> {
    /// Creates a state at qpos0 and at rest.
    pub fn new(model: &Model<R::Value>) -> Self {
        Self {
            steps: 0,
            start: 0.0,
            qpos: model.qpos0.iter().map(|q| R::of(*q)).collect(),
            qvel: vec![R::zero(); model.nv],
            act: vec![R::zero(); model.na],
            ctrl_history: vec![R::zero(); model.nhistory],
            warm: Vec::new(),
            sleep: Sleep::new(),
        }
    }

    /// Returns the user's part of it, in the order of `arrays::Array`.
    pub(crate) fn lists(&self) -> [&Vec<R>; Array::CHANGED] {
        [&self.qpos, &self.qvel, &self.act, &self.ctrl_history]
    }

    pub(crate) fn lists_mut(&mut self) -> [&mut Vec<R>; Array::CHANGED] {
        [&mut self.qpos, &mut self.qvel, &mut self.act, &mut self.ctrl_history]
    }

    /// Copies into a state of the same model, reusing its memory.
    pub(crate) fn copy_to(&self, to: &mut Self) {
        (to.steps, to.start) = (self.steps, self.start);
        for (to, from) in to.lists_mut().into_iter().zip(self.lists()) {
            to.copy_from_slice(from);
        }
        to.warm.clone_from(&self.warm);
        self.sleep.copy_to(&mut to.sleep);
    }

    /// Starts one lane's next step without impulses.
    pub(crate) fn forget_impulses(&mut self, lane: usize) {
        if R::ALONE {
            return self.warm.clear();
        }
        let impulses = self.warm.iter_mut().flat_map(|warm| &mut warm.impulse);
        impulses.for_each(|impulse| impulse.set_lane(lane, 0.0));
    }

    /// Returns the time [s] of this state in steps of `dt`.
    pub fn time(&self, dt: f64) -> f64 {
        self.start + self.steps as f64 * dt
    }
}

/// The number of arrays of inputs.
pub(crate) const INPUTS: usize = Array::COUNT - Array::CHANGED;

/// Controls and applied forces: constant during a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Inputs<R: Real> {
    /// Per actuator, in the unit that its gear expects.
    pub ctrl: Vec<R>,
    qfrc_applied: Vec<R>,
    xfrc_applied: Vec<R>,
    eq_active: Vec<R>,
    mocap_pos: Vec<R>,
    mocap_quat: Vec<R>,
    /// Whether some applied force may be nonzero. All code that writes them writes this too.
    applied: bool,
}

room!(Inputs<R>: ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat, applied);

impl<R: Real> Inputs<R> {
    /// Creates inputs without control or force; equalities and mocap bodies as in the scene.
    pub fn new(model: &Model<R::Value>) -> Self {
        let initial = |array: Array| {
            let mut all = vec![R::zero(); array.count(model)];
            for lane in 0..R::LANES {
                let own = array.initial_in(model, lane);
                all.iter_mut().zip(own).for_each(|(to, x)| to.set_lane(lane, x));
            }
            all
        };
        Self {
            ctrl: vec![R::zero(); model.actuators.len()],
            qfrc_applied: vec![R::zero(); model.nv],
            xfrc_applied: vec![R::zero(); 6 * model.bodies.len()],
            eq_active: initial(Array::EqActive),
            mocap_pos: initial(Array::MocapPos),
            mocap_quat: initial(Array::MocapQuat),
            applied: false,
        }
    }

    /// Returns the generalised forces by dof [N or N·m].
    pub fn qfrc_applied(&self) -> &[R] {
        &self.qfrc_applied
    }

    /// Force at the centre of mass [N], then moment [N·m], in world axes, by body: 6
    /// numbers each.
    pub fn xfrc_applied(&self) -> &[R] {
        &self.xfrc_applied
    }

    /// Returns false if every applied force is zero, so that a step need not add them.
    pub fn applied(&self) -> bool {
        self.applied
    }

    /// Changes the applied forces with `write(qfrc_applied, xfrc_applied)`.
    pub fn apply(&mut self, write: impl FnOnce(&mut [R], &mut [R])) {
        self.edit(|[_, qfrc, xfrc, ..]| write(qfrc, xfrc));
    }

    /// Returns the lanes in which an equality acts.
    #[inline(always)]
    pub(crate) fn eq_active(&self, index: usize) -> R::Mask {
        let (active, zero) = (self.eq_active[index], R::zero());
        active.gt(zero).or(active.lt(zero))
    }

    /// Returns the poses of mocap bodies.
    pub(crate) fn mocap(&self) -> impl Iterator<Item = (V3<R>, Quat<R>)> + '_ {
        let quats = self.mocap_quat.chunks(4).map(|quat| Quat::of(quat).normalized());
        self.mocap_pos.chunks(3).map(|pos| V3::new(pos[0], pos[1], pos[2])).zip(quats)
    }

    /// Returns the arrays in the order of `arrays::Array`.
    pub(crate) fn arrays(&self) -> [&[R]; INPUTS] {
        let Self { ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat, .. } = self;
        [ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat]
    }

    fn arrays_mut(&mut self) -> [&mut [R]; INPUTS] {
        let Self { ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat, .. } = self;
        [ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat]
    }

    /// Change them with `write`, in this order.
    pub(crate) fn edit(&mut self, write: impl FnOnce([&mut [R]; INPUTS])) {
        write(self.arrays_mut());
        let mut forces = self.qfrc_applied.iter().chain(&self.xfrc_applied);
        self.applied = forces.any(|force| !force.is_zero());
    }

    /// Copies in some of one world's arrays, in the order of `arrays`. Lane 0 comes first.
    pub(crate) fn set_lane(&mut self, lane: usize, given: &[&[f64]], some: ArraySet) {
        if some.has(Array::QfrcApplied) || some.has(Array::XfrcApplied) {
            let applied = given[1..3].iter().copied().flatten().any(|force| *force != 0.0);
            self.applied = applied || (lane > 0 && self.applied);
        }
        let named = Array::ALL[Array::CHANGED..].iter().zip(given);
        for (to, (array, from)) in self.arrays_mut().into_iter().zip(named) {
            if some.has(*array) {
                to.iter_mut().zip(*from).for_each(|(to, from)| to.set_lane(lane, *from));
            }
        }
    }

    /// Copies a world's numbers into one lane; no force is applied there, and none was before.
    #[inline(always)]
    pub(crate) fn set_idle_lane<'a>(&mut self, lane: usize, given: impl Fn(Array) -> &'a [f64]) {
        for (to, array) in self.arrays_mut().into_iter().zip(&Array::ALL[Array::CHANGED..]) {
            if !matches!(array, Array::QfrcApplied | Array::XfrcApplied) {
                for (to, from) in to.iter_mut().zip(given(*array)) {
                    to.set_lane(lane, *from);
                }
            }
        }
    }

    /// Returns, by array, whether it differs from the one in `old`.
    pub(crate) fn changes(&self, old: &Self) -> [bool; INPUTS] {
        let (new, applied) = (self.arrays(), self.applied || old.applied);
        let mut changes = [false; INPUTS];
        for ((changes, array), (new, old)) in
            changes.iter_mut().zip(&Array::ALL[Array::CHANGED..]).zip(new.iter().zip(old.arrays()))
        {
            // If no force is applied, all of them are zero.
            let zero = !applied && matches!(array, Array::QfrcApplied | Array::XfrcApplied);
            *changes = !zero && *new != old;
        }
        changes
    }

    /// Copies into inputs of the same model, reusing their memory.
    pub(crate) fn copy_to(&self, to: &mut Self) {
        self.copy_some([true; INPUTS], to);
    }

    /// The same for some arrays.
    pub(crate) fn copy_some(&self, some: [bool; INPUTS], to: &mut Self) {
        for ((to, from), copied) in to.arrays_mut().into_iter().zip(self.arrays()).zip(some) {
            if copied {
                to.copy_from_slice(from);
            }
        }
        to.applied = self.applied;
    }
}
