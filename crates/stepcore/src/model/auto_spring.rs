//! Springs and dampers of joints that are given by a time constant and a damping ratio: MuJoCo's
//! `springdamper`.

use super::Model;
use crate::scene::Scene;

/// With the inertia m = 1/invweight that a joint moves at the initial configuration (the mean of a free
/// joint's six), stiffness m/(τ ζ)² and damping 2 m/τ in place of its own.
pub fn fill(scene: &Scene, model: &mut Model) {
    for (index, source) in scene.joints.iter().enumerate() {
        let [constant, ratio] = source.springdamper;
        if !(constant > 0.0 && ratio > 0.0) {
            continue;
        }
        let joint = &mut model.joints[index];
        let dofs = &model.dofs[joint.dof..joint.dof + joint.dofs()];
        let weight = dofs.iter().map(|dof| dof.invweight).sum::<f64>() / dofs.len() as f64;
        let inertia = if weight > 0.0 { 1.0 / weight } else { 0.0 };
        if scene.features.spring {
            joint.stiffness[0] = inertia / (constant * constant * ratio * ratio);
        }
        if scene.features.damper {
            // That of actuators on it, which is in the sum already, stays.
            let of_actuators = joint.damping[0] - source.damping[0];
            joint.damping[0] = of_actuators + 2.0 * inertia / constant;
        }
    }
}
