//! Velocities of bodies, and the forces that maintain the present velocity: recursive Newton-Euler
//! (Featherstone 2008, 5.3), gravity as an upward acceleration.

use super::Placed;
use crate::model::{Model, Tree};
use crate::real::Real;
use crate::scene::JointType;
use crate::spatial::{splat, Motion, V3};

impl<R: Real> Placed<R> {
    /// Computes the velocity of each body, and its acceleration when no dof accelerates.
    pub(super) fn velocities(
        &mut self,
        model: &Model<R::Value>,
        qvel: &[R],
        tree: &Tree<R::Value>,
    ) {
        let up = if model.features.gravity { -splat::<R, _>(&model.gravity) } else { V3::zeros() };
        for index in tree.bodies.range() {
            let body = &model.bodies[index];
            let (mut v, mut a) = if body.parent >= tree.bodies.start {
                (self.velocity[body.parent], self.acceleration[body.parent])
            } else {
                (Motion::zero(), Motion { ang: V3::zeros(), lin: up })
            };
            for joint in body.joints.of(&model.joints) {
                // Axes of slides and hinges are fixed in the frame before the joint. A
                // ball's three and a free joint's last three share one rotation, whose effect on itself
                // cancels in the sum; a free joint's first three never turn.
                let mut frame = v;
                for k in joint.dof..joint.dof + joint.dofs() {
                    let motion = self.motion[k];
                    v.add_scaled(&motion, qvel[k]);
                    if joint.kind == JointType::Free {
                        if k == joint.dof + 2 {
                            frame = v;
                        }
                        if k < joint.dof + 3 {
                            continue;
                        }
                    }
                    a.add_scaled(&frame.cross(&motion), qvel[k]);
                }
            }
            self.velocity[index] = v;
            self.acceleration[index] = a;
        }
    }

    /// Returns the acceleration of a body when no dof accelerates, without gravity.
    pub fn free_acceleration(&self, model: &Model<R::Value>, body: usize) -> Motion<R> {
        let mut a = self.acceleration[body];
        if model.features.gravity {
            a.lin += splat::<R, _>(&model.gravity);
        }
        a
    }

    /// Computes the velocities, if needed, and the bias force.
    pub(super) fn bias_in_space(&mut self, model: &Model<R::Value>, qvel: &[R], tree: usize) {
        if model.features.coriolis || !model.equalities.is_empty() {
            self.velocities(model, qvel, &model.trees[tree]);
        }
        self.bias_of_tree(model, tree);
    }

    /// Computes the force on each dof that maintains those accelerations.
    pub(super) fn bias_of_tree(&mut self, model: &Model<R::Value>, tree: usize) {
        let tree = &model.trees[tree];
        if !model.features.coriolis {
            return self.weight_of_tree(model, tree);
        }
        for index in tree.bodies.range() {
            let (v, a) = (&self.velocity[index], &self.acceleration[index]);
            let inertia = &self.inertia[index];
            let mut wrench = inertia.mul(a);
            wrench.add(&v.cross_force(&inertia.mul(v)));
            self.wrench[index] = wrench;
        }
        self.wrench_to_dofs(model, tree);
    }

    /// Computes the bias force at zero velocity: the force that carries the weight.
    fn weight_of_tree(&mut self, model: &Model<R::Value>, tree: &Tree<R::Value>) {
        let up = match model.features.gravity {
            true => -splat::<R, _>(&model.gravity),
            false => -V3::zeros(),
        };
        let up = Motion { ang: V3::zeros(), lin: up };
        for index in tree.bodies.range() {
            self.wrench[index] = self.inertia[index].mul(&up);
        }
        self.wrench_to_dofs(model, tree);
    }

    /// Passes wrenches down to the root and projects them on the dofs: `bias`.
    fn wrench_to_dofs(&mut self, model: &Model<R::Value>, tree: &Tree<R::Value>) {
        for index in tree.bodies.range().rev() {
            let body = &model.bodies[index];
            for k in body.dofs.range() {
                self.bias[k] = self.motion[k].dot(&self.wrench[index]);
            }
            if body.parent >= tree.bodies.start {
                let part = self.wrench[index];
                self.wrench[body.parent].add(&part);
            }
        }
    }
}
