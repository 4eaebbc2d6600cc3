//! Armature of tendons: an inertia m of a change of length, ½ m (a·v)² with the arms a.
//!
//! The mass matrix gets m a aᵀ, and the bias force m a (ȧ·v): the acceleration of the length while no
//! dof accelerates. As in MuJoCo the mass matrix keeps its pattern: entries of two dofs of which
//! neither moves the other are left out (the plan lists them), and so is armature round geoms.

use super::Placed;
use crate::model::{Course, Model, Stretch, Tendon, Tree, NONE};
use crate::real::{Constant, Real, Value};
use crate::spatial::V3;

impl<R: Real> Placed<R> {
    /// Adds the armature of tendons to a tree's part of the mass matrix.
    pub(super) fn weigh_tendons(&mut self, model: &Model<R::Value>, tree: &Tree<R::Value>) {
        let own = tree.dofs.range();
        for tendon in model.tendons.iter().filter(|tendon| !tendon.armature.vanishes()) {
            let dofs = tendon.dofs.of(&model.dof_lists);
            let arms = tendon.arms.of(&self.tendon_arms);
            for (k, &i) in dofs.iter().enumerate().filter(|(_, dof)| own.contains(dof)) {
                for (l, &j) in dofs[..=k].iter().enumerate() {
                    if let Some(at) = model.entry(i, j) {
                        self.mass[at] += tendon.armature.get() * arms[k] * arms[l];
                    }
                }
            }
        }
    }

    /// Adds the bias forces of tendons to the ones of the trees.
    pub(super) fn bias_of_tendons(&mut self, model: &Model<R::Value>) {
        if !model.features.coriolis {
            return;
        }
        for tendon in model.tendons.iter().filter(|tendon| !tendon.armature.vanishes()) {
            let Course::Spatial(_) = &tendon.course else { continue };
            let pull = tendon.armature.get() * self.free_acceleration_along(model, tendon);
            let arms = tendon.arms.of(&self.tendon_arms);
            for (dof, arm) in tendon.dofs.of(&model.dof_lists).iter().zip(arms) {
                self.bias[*dof] += *arm * pull;
            }
        }
    }

    /// Returns d²L/dt² of a spatial tendon while no dof accelerates.
    pub(crate) fn free_acceleration_along(
        &self,
        model: &Model<R::Value>,
        tendon: &Tendon<R::Value>,
    ) -> R {
        let mut sum = R::zero();
        if let Course::Spatial(stretches) = &tendon.course {
            for stretch in stretches {
                sum += R::of(stretch.share) * self.acceleration_of(model, stretch);
            }
        }
        sum
    }

    /// Returns d²/dt² |b − a| while no dof accelerates: along the line the difference of both ends'
    /// accelerations, and the square of their velocity about each other over the length.
    fn acceleration_of(&self, model: &Model<R::Value>, stretch: &Stretch) -> R {
        let [a, b] = [0, 1].map(|end| {
            let point = &stretch.ends[end];
            (self.point(point), self.free_motion_of(model, point.body, &self.point(point)))
        });
        let apart = b.0 - a.0;
        let inverse = apart.dot(&apart).sqrt().recip_or_zero();
        let along = apart * inverse;
        let (velocity, acceleration) = (b.1[0] - a.1[0], b.1[1] - a.1[1]);
        let rate = along.dot(&velocity);
        along.dot(&acceleration) + (velocity.dot(&velocity) - rate * rate) * inverse
    }

    /// Returns the velocity and acceleration of a body point while no dof accelerates.
    fn free_motion_of(&self, model: &Model<R::Value>, body: usize, at: &V3<R>) -> [V3<R>; 2] {
        let tree = model.bodies[body].tree;
        if tree == NONE {
            return [V3::zeros(); 2];
        }
        let arm = at - self.origin[tree];
        let motion = &self.velocity[body];
        let velocity = motion.at(&arm);
        let free = self.free_acceleration(model, body).at(&arm);
        [velocity, free + motion.ang.cross(&velocity)]
    }
}
