//! The model at qpos0: the poses of bodies; and lengths and arms, as a step places them.

use super::{Body, Model, Transmission};
use crate::place::Placed;
use crate::scene::AUTOMATIC;
use crate::spatial::Pose;

/// World poses of all bodies with every hinge and slide at its reference, so that it adds no
/// displacement.
pub fn poses(bodies: &[Body]) -> Vec<Pose<f64>> {
    let mut poses: Vec<Pose<f64>> = Vec::with_capacity(bodies.len());
    for (i, body) in bodies.iter().enumerate() {
        let own = Pose::new(body.pos, body.quat);
        poses.push(if i == 0 { own } else { poses[body.parent].then(&own) });
    }
    poses
}

/// Measures tendons at qpos0, and finds the rest lengths of their springs.
pub fn measure_tendons(model: &mut Model) {
    if model.tendons.is_empty() {
        return;
    }
    let mut placed = Placed::<f64>::new(model);
    placed.positions(model, &model.qpos_spring);
    let rest = placed.tendon_length.clone();
    placed.positions(model, &model.qpos0);
    for (index, tendon) in model.tendons.iter_mut().enumerate() {
        tendon.length0 = placed.tendon_length[index];
        if tendon.springlength == AUTOMATIC {
            tendon.springlength = [rest[index]; 2];
        }
        tendon.arms0 = tendon.arms.of(&placed.tendon_arms).to_vec();
    }
}

impl Model {
    /// The arms of each actuator, by dof, after qpos0 was placed.
    pub(super) fn arms_at_qpos0(&self, placed: &Placed<f64>) -> Vec<Vec<f64>> {
        let arms = |along: &Transmission| {
            let mut row = vec![0.0; self.nv];
            along.arms(self, &self.qpos0, placed.pulls(), |dof, arm: f64| row[dof] += arm);
            row
        };
        self.along.iter().map(arms).collect()
    }
}
