//! The smooth forces on the dofs: springs, dampers, motors and servos, and what the user
//! applies.

use super::Placed;
use crate::model::{Joint, Model};
use crate::real::{Mask, Real};
use crate::scene::{Actuator, JointType};
use crate::spatial::{rotate, splat, Force, Quat, V3};
use crate::state::Inputs;

impl<R: Real> Placed<R> {
    pub(super) fn smooth_force(
        &mut self,
        model: &Model,
        qpos: &[R],
        qvel: &[R],
        inputs: &Inputs<R>,
    ) {
        self.springs_and_dampers(model, qpos, qvel);
        for k in 0..model.nv {
            self.force[k] = self.passive[k] - self.bias[k];
        }
        self.actuators(model, qpos, qvel, inputs);
        if inputs.applied() {
            self.applied(model, inputs);
        }
    }

    fn springs_and_dampers(&mut self, model: &Model, qpos: &[R], qvel: &[R]) {
        for k in 0..model.nv {
            self.passive[k] = -(R::of(model.dofs[k].damping) * qvel[k]);
        }
        for joint in model.joints.iter().filter(|joint| joint.stiffness != 0.0) {
            let k = R::of(joint.stiffness);
            let (stretch, count) = stretch(model, joint, qpos);
            for (at, s) in stretch[..count].iter().enumerate() {
                self.passive[joint.dof + at] -= k * *s;
            }
        }
    }

    fn actuators(&mut self, model: &Model, qpos: &[R], qvel: &[R], inputs: &Inputs<R>) {
        if !model.features.actuation {
            return;
        }
        for (index, actuator) in model.actuators.iter().enumerate() {
            let mut force = inputs.ctrl[index];
            if let (Some([lo, hi]), true) = (actuator.ctrlrange, model.features.clampctrl) {
                force = force.clamp(R::of(lo), R::of(hi));
            }
            let joint = &model.joints[actuator.joint];
            force = R::of(actuator.gain) * force;
            if actuator.bias != [0.0; 3] {
                force += bias(actuator, joint, qpos, qvel);
            }
            if let Some([lo, hi]) = actuator.forcerange {
                force = force.clamp(R::of(lo), R::of(hi));
            }
            self.actuator[index] = force;
            for k in 0..joint.dofs() {
                self.force[joint.dof + k] += R::of(actuator.gear[k]) * force;
            }
        }
    }

    /// Stiffness and damping that a servo gives its dof: minus the derivatives of its force by
    /// position and velocity. Zero at the bounds of `forcerange`, as in MuJoCo.
    pub fn feedback(&self, actuator: &Actuator, index: usize) -> [R; 2] {
        let squared = R::of(actuator.gear[0]) * R::of(actuator.gear[0]);
        let slope = [1, 2].map(|i| -(squared * R::of(actuator.bias[i])));
        let Some([lo, hi]) = actuator.forcerange else { return slope };
        let force = self.actuator[index];
        let free = force.gt(R::of(lo)).and(force.lt(R::of(hi)));
        slope.map(|slope| R::select(free, slope, R::zero()))
    }

    /// `qfrc_applied` on dofs; `xfrc_applied` (force, moment) at centres of mass, in world axes.
    fn applied(&mut self, model: &Model, inputs: &Inputs<R>) {
        for k in 0..model.nv {
            self.force[k] += inputs.qfrc_applied()[k];
        }
        for (tree_index, tree) in model.trees.iter().enumerate() {
            for index in tree.bodies.range() {
                let body = &model.bodies[index];
                let at = self.xpos[index] + rotate(&self.xmat[index], &splat(&body.ipos))
                    - self.origin[tree_index];
                let w = &inputs.xfrc_applied()[6 * index..6 * index + 6];
                let lin = V3::new(w[0], w[1], w[2]);
                let moment = V3::new(w[3], w[4], w[5]) + at.cross(&lin);
                self.wrench[index] = Force { ang: moment, lin };
            }
            for index in tree.bodies.range().rev() {
                let body = &model.bodies[index];
                for k in body.dofs.range() {
                    self.force[k] += self.motion[k].dot(&self.wrench[index]);
                }
                if body.parent >= tree.bodies.start {
                    let part = self.wrench[index];
                    self.wrench[body.parent].add(&part);
                }
            }
        }
    }
}

/// What an actuator's force has beside the control: bias₀ + bias₁·length + bias₂·velocity.
fn bias<R: Real>(actuator: &Actuator, joint: &Joint, qpos: &[R], qvel: &[R]) -> R {
    let [constant, length, velocity] = actuator.bias.map(R::of);
    if !actuator.feeds_back() {
        return constant;
    }
    let gear = R::of(actuator.gear[0]);
    constant + length * (gear * qpos[joint.qpos]) + velocity * (gear * qvel[joint.dof])
}

/// How far a joint is from its spring's rest, by dof of the joint [m or rad].
pub fn stretch<R: Real>(model: &Model, joint: &Joint, qpos: &[R]) -> ([R; 6], usize) {
    let mut out = [R::zero(); 6];
    let rest = |k: usize| R::of(model.qpos_spring[joint.qpos + k]);
    let turn = |at: usize| {
        let q = Quat::of(&qpos[joint.qpos + at..joint.qpos + at + 4]).normalized();
        let zero = Quat::of(&[rest(at), rest(at + 1), rest(at + 2), rest(at + 3)]);
        zero.conjugate().mul(&q).log()
    };
    match joint.kind {
        JointType::Slide | JointType::Hinge => out[0] = qpos[joint.qpos] - rest(0),
        JointType::Ball => out[..3].copy_from_slice(turn(0).as_slice()),
        JointType::Free => {
            for k in 0..3 {
                out[k] = qpos[joint.qpos + k] - rest(k);
            }
            out[3..].copy_from_slice(turn(3).as_slice());
        }
    }
    (out, joint.dofs())
}

/// Energy in the joint springs [J].
pub fn spring_energy<R: Real>(model: &Model, qpos: &[R]) -> R {
    let mut sum = R::zero();
    for joint in model.joints.iter().filter(|joint| joint.stiffness != 0.0) {
        let (stretch, count) = stretch(model, joint, qpos);
        for s in &stretch[..count] {
            sum += R::of(0.5 * joint.stiffness) * *s * *s;
        }
    }
    sum
}
