//! What stands where at qpos0: the poses of bodies; and lengths and arms, as a step places them.

use super::{Body, Model, Transmission};
use crate::place::Placed;
use crate::scene::AUTOMATIC;
use crate::spatial::Pose;

/// World poses of all bodies, where every hinge and slide stands at its reference and so adds no
/// displacement of its own.
pub fn poses(bodies: &[Body]) -> Vec<Pose<f64>> {
    let mut poses: Vec<Pose<f64>> = Vec::with_capacity(bodies.len());
    for (i, body) in bodies.iter().enumerate() {
        let own = Pose::new(body.pos, body.quat);
        poses.push(if i == 0 { own } else { poses[body.parent].then(&own) });
    }
    poses
}

/// What tendons are at qpos0, and where their springs are at rest.
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
    /// The arms of each actuator where qpos0 was placed, by dof.
    pub(super) fn arms_at_qpos0(&self, placed: &Placed<f64>) -> Vec<Vec<f64>> {
        let arms = |along: &Transmission| {
            let mut row = vec![0.0; self.nv];
            along.arms(self, &self.qpos0, placed.pulls(), |dof, arm: f64| row[dof] += arm);
            row
        };
        self.along.iter().map(arms).collect()
    }
}
