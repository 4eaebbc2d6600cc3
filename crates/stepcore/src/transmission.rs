//! How a length follows the dofs: its value at a position, and its gradient, the moment arms.
//!
//! What pulls along a length (an actuator, a limit; a tendon's spring, once there are tendons)
//! asks here, and knows no joint. A tendon will be one more variant.

use crate::model::{Model, Span};
use crate::real::Real;
use crate::scene::JointType;
use crate::spatial::Quat;

/// Whose length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Transmission {
    /// Of a hinge or a slide its position; of a ball the angle by which it is turned, never
    /// negative.
    Joint(usize),
    /// A joint behind a gear, which has one entry for each dof. The length is that of a hinge
    /// or a slide; the arms are there for every joint.
    Geared(usize, [f64; 6]),
}

/// A length and its arms.
#[derive(Clone, Copy, Debug)]
pub struct Reach<R: Real> {
    /// [m or rad]
    pub length: R,
    /// The first dof that moves it; the others follow.
    first: usize,
    arms: [R; 3],
    count: usize,
}

impl<R: Real> Reach<R> {
    /// Each dof that moves the length, and ∂length/∂dof.
    pub fn arms(&self) -> impl Iterator<Item = (usize, R)> + '_ {
        self.arms[..self.count].iter().enumerate().map(|(k, arm)| (self.first + k, *arm))
    }
}

impl Transmission {
    fn joint(self) -> usize {
        let (Self::Joint(joint) | Self::Geared(joint, _)) = self;
        joint
    }

    /// The dofs that move the length and all their ancestors, in `Model::dof_lists`.
    pub fn dofs(self, model: &Model) -> Span {
        let joint = &model.joints[self.joint()];
        model.chain_of_dof(joint.dof + joint.dofs() - 1)
    }

    /// [m or rad]
    #[inline(always)]
    pub fn length<R: Real>(self, model: &Model, qpos: &[R]) -> R {
        match self {
            Self::Joint(_) => self.reach(model, qpos).length,
            Self::Geared(joint, gear) => R::of(gear[0]) * qpos[model.joints[joint].qpos],
        }
    }

    /// Rate of the length of a hinge or a slide [m/s or rad/s].
    #[inline(always)]
    pub fn velocity<R: Real>(self, model: &Model, qvel: &[R]) -> R {
        let velocity = qvel[model.joints[self.joint()].dof];
        match self {
            Self::Joint(_) => velocity,
            Self::Geared(_, gear) => R::of(gear[0]) * velocity,
        }
    }

    /// Calls `each(dof, ∂length/∂dof)` for every dof that moves the length.
    #[inline(always)]
    pub fn arms<R: Real>(self, model: &Model, qpos: &[R], mut each: impl FnMut(usize, R)) {
        match self {
            Self::Joint(_) => {
                self.reach(model, qpos).arms().for_each(|(dof, arm)| each(dof, arm));
            }
            Self::Geared(joint, gear) => {
                let joint = &model.joints[joint];
                (0..joint.dofs()).for_each(|k| each(joint.dof + k, R::of(gear[k])));
            }
        }
    }

    /// Calls `each(i, j, aᵢ aⱼ)` for every pair of arms, both ways, and each with itself: along a
    /// length a stiffness of one is this matrix on the dofs.
    #[inline(always)]
    pub fn pairs<R: Real>(self, model: &Model, qpos: &[R], mut each: impl FnMut(usize, usize, R)) {
        self.arms(model, qpos, |i, a: R| {
            self.arms(model, qpos, |j, b: R| each(i, j, a * b));
        });
    }

    /// Length and arms at once, without a gear.
    #[inline(always)]
    pub fn reach<R: Real>(self, model: &Model, qpos: &[R]) -> Reach<R> {
        let joint = &model.joints[self.joint()];
        let first = joint.dof;
        if joint.kind == JointType::Ball {
            let quat = Quat::of(&qpos[joint.qpos..joint.qpos + 4]).normalized();
            let (axis, angle) = quat.axis_angle();
            let sign = R::select(angle.lt(R::zero()), -R::one(), R::one());
            let arms = [axis.x * sign, axis.y * sign, axis.z * sign];
            return Reach { length: angle.abs(), first, arms, count: 3 };
        }
        let arms = [R::one(), R::zero(), R::zero()];
        Reach { length: qpos[joint.qpos], first, arms, count: 1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commit::advance;
    use crate::scene::{Body, Geom, Joint, Scene};

    fn model(kind: JointType) -> Model {
        let mut scene = Scene::default();
        scene.bodies.push(Body::default());
        scene.joints.push(Joint { body: 1, kind, ..Joint::default() });
        scene.geoms.push(Geom { body: 1, size: [0.1, 0.0, 0.0], ..Geom::default() });
        Model::compile(&scene).unwrap()
    }

    /// Arms are the derivatives of the length along each dof.
    #[test]
    fn arms_are_derivatives() {
        for kind in [JointType::Slide, JointType::Hinge, JointType::Ball] {
            let model = model(kind);
            let mut start = model.qpos0.clone();
            let push: Vec<f64> = (0..model.nv).map(|k| 0.4 - 0.3 * k as f64).collect();
            advance(&model, &model.qpos0, &push, 1.0, &mut start);
            let mut all = vec![Transmission::Joint(0)];
            if kind != JointType::Ball {
                all.push(Transmission::Geared(0, [-2.5, 0.0, 0.0, 0.0, 0.0, 0.0]));
            }
            for along in all {
                let mut arms = vec![0.0; model.nv];
                along.arms(&model, &start, |dof, arm: f64| arms[dof] += arm);
                for (dof, arm) in arms.iter().enumerate() {
                    let length = |by: f64| {
                        let mut unit = vec![0.0; model.nv];
                        unit[dof] = by;
                        let mut moved = start.clone();
                        advance(&model, &start, &unit, 1.0, &mut moved);
                        along.length(&model, &moved)
                    };
                    let slope = (length(1e-6) - length(-1e-6)) / 2e-6;
                    assert!((slope - arm).abs() < 1e-8, "{kind:?} {dof}: {slope} {arm}");
                }
                let dofs = along.dofs(&model);
                assert_eq!(dofs.of(&model.dof_lists), (0..model.nv).collect::<Vec<_>>());
            }
        }
    }
}
