//! Rotations and the poses of bodies at qpos0, in `f64`, for the builder alone.

use super::Body;
use crate::spatial::{self, Quat};
use nalgebra::{Matrix3, Vector3};

/// Length one; a quaternion that already has it keeps its bits.
pub fn unit_quat(q: [f64; 4]) -> [f64; 4] {
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    q.map(|x| x / length)
}

pub fn rotation(q: [f64; 4]) -> Matrix3<f64> {
    Quat::of(&q).matrix()
}

/// Where a frame stands in the world.
pub type Pose = spatial::Pose<f64>;

impl Pose {
    pub fn new(pos: Vector3<f64>, quat: [f64; 4]) -> Self {
        Self { pos, rot: rotation(quat) }
    }
    /// The world point of a local one.
    pub fn point(&self, local: Vector3<f64>) -> Vector3<f64> {
        self.pos + self.rot * local
    }
    /// The world pose of a frame given in this one.
    pub fn then(&self, local: &Self) -> Self {
        Self { pos: self.point(local.pos), rot: self.rot * local.rot }
    }
}

/// World poses of all bodies at qpos0, where every hinge and slide stands at its
/// reference and so adds no displacement of its own.
pub fn at_qpos0(bodies: &[Body]) -> Vec<Pose> {
    let mut poses: Vec<Pose> = Vec::with_capacity(bodies.len());
    for (i, body) in bodies.iter().enumerate() {
        let own = Pose::new(body.pos, body.quat);
        let pose = if i == 0 { own } else { poses[body.parent].then(&own) };
        poses.push(pose);
    }
    poses
}
