//! The relation between a length and the dofs: value at a position, and gradient (the arms).
//!
//! Elements that pull along a length (an actuator, a limit, a tendon's spring) use this and need
//! neither joint nor path. The lengths and arms of tendons are computed in `place/tendon.rs`.

pub(crate) use super::lengths::{Limited, Rubbing};
pub use super::Transmission;
use super::{Linkage, Model, Span};
use crate::real::{Constant, Real, Value};
use crate::scene::JointType;
use crate::spatial::{Quat, V3};

/// Placed lengths: by tendon, and their arms (see `Tendon::arms`).
#[derive(Clone, Copy)]
pub struct Pulls<'a, R: Real> {
    pub length: &'a [R],
    pub arms: &'a [R],
}

/// The length of a joint and its arms.
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
    /// The dofs that move the length and all their ancestors, in `Model::dof_lists`.
    pub fn dofs<N: Constant>(self, model: &Model<N>) -> Span {
        match self {
            Self::Joint(joint) | Self::Geared(joint, _) | Self::InParent(joint, _) => {
                let joint = &model.joints[joint];
                model.chain_of_dof(joint.dof + joint.dofs() - 1)
            }
            Self::Tendon(tendon, _) => model.tendons[tendon].closed,
            Self::Linkage(linkage) => model.linkages[linkage].dofs,
            Self::Dof(k) => model.chain_of_dof(k),
        }
    }

    /// [m or rad]
    #[inline(always)]
    pub fn length<R: Real>(self, model: &Model<R::Value>, qpos: &[R], pulls: Pulls<R>) -> R {
        match self {
            Self::Joint(joint) => Reach::of(model, joint, qpos).length,
            Self::Geared(joint, gear) | Self::InParent(joint, gear) => {
                let joint = &model.joints[joint];
                match joint.kind {
                    JointType::Hinge | JointType::Slide => {
                        model.gears[gear].get() * qpos[joint.qpos]
                    }
                    // A rotation leaves its axis where it is: in both frames it is the same.
                    JointType::Ball => {
                        turned(joint.qpos, qpos).log().dot(&axis(&model.gears[gear..]))
                    }
                    JointType::Free => R::zero(),
                }
            }
            Self::Tendon(tendon, gear) => factor::<R>(model, gear) * pulls.length[tendon],
            Self::Linkage(linkage) => pulls.length[model.linkages[linkage].length],
            Self::Dof(_) => R::zero(),
        }
    }

    /// The velocity along the arms: the rate of a hinge, slide or tendon [m/s or rad/s].
    #[inline(always)]
    pub fn velocity<R: Real>(
        self,
        model: &Model<R::Value>,
        qpos: &[R],
        qvel: &[R],
        pulls: Pulls<R>,
    ) -> R {
        let along = |dofs: Span, arms: Span| {
            let mut sum = R::zero();
            for (dof, arm) in dofs.of(&model.dof_lists).iter().zip(arms.of(pulls.arms)) {
                sum += *arm * qvel[*dof];
            }
            sum
        };
        match self {
            Self::Joint(joint) => qvel[model.joints[joint].dof],
            Self::Dof(k) => qvel[k],
            Self::Geared(joint, gear) if model.joints[joint].dofs() == 1 => {
                model.gears[gear].get() * qvel[model.joints[joint].dof]
            }
            Self::Geared(..) | Self::InParent(..) => {
                let mut sum = R::zero();
                self.arms(model, qpos, pulls, |dof, arm: R| sum += arm * qvel[dof]);
                sum
            }
            Self::Tendon(tendon, gear) => {
                let tendon = &model.tendons[tendon];
                factor::<R>(model, gear) * along(tendon.dofs, tendon.arms)
            }
            Self::Linkage(linkage) => {
                let Linkage { dofs, arms, .. } = model.linkages[linkage];
                along(dofs, arms)
            }
        }
    }

    /// Calls `each(dof, ∂length/∂dof)` for every dof that moves the length.
    #[inline(always)]
    pub fn arms<R: Real>(
        self,
        model: &Model<R::Value>,
        qpos: &[R],
        pulls: Pulls<R>,
        mut each: impl FnMut(usize, R),
    ) {
        match self {
            Self::Joint(joint) => {
                Reach::of(model, joint, qpos).arms().for_each(|(dof, arm)| each(dof, arm));
            }
            Self::Geared(joint, gear) => {
                let joint = &model.joints[joint];
                (0..joint.dofs()).for_each(|k| each(joint.dof + k, model.gears[gear + k].get()));
            }
            Self::InParent(joint, gear) => {
                let joint = &model.joints[joint];
                let moves = joint.dofs() - 3;
                (0..moves).for_each(|k| each(joint.dof + k, model.gears[gear + k].get()));
                let back = turned(joint.qpos + joint.kind.positions() - 4, qpos).conjugate();
                let turns = back.rotate(&axis(&model.gears[gear + moves..]));
                (0..3).for_each(|k| each(joint.dof + moves + k, turns[k]));
            }
            Self::Tendon(tendon, gear) => {
                let (tendon, gear) = (&model.tendons[tendon], factor::<R>(model, gear));
                let arms = tendon.arms.of(pulls.arms);
                for (dof, arm) in tendon.dofs.of(&model.dof_lists).iter().zip(arms) {
                    each(*dof, gear * *arm);
                }
            }
            Self::Linkage(linkage) => {
                let Linkage { dofs, arms, .. } = model.linkages[linkage];
                for (dof, arm) in dofs.of(&model.dof_lists).iter().zip(arms.of(pulls.arms)) {
                    each(*dof, *arm);
                }
            }
            Self::Dof(k) => each(k, R::one()),
        }
    }

    /// Calls `each` with every dof that can move the length.
    pub fn movers<N: Constant>(self, model: &Model<N>, mut each: impl FnMut(usize)) {
        match self {
            Self::Joint(joint) | Self::Geared(joint, _) | Self::InParent(joint, _) => {
                let joint = &model.joints[joint];
                (joint.dof..joint.dof + joint.dofs()).for_each(each);
            }
            Self::Tendon(tendon, _) => {
                model.tendons[tendon].dofs.of(&model.dof_lists).iter().for_each(|k| each(*k));
            }
            Self::Dof(k) => each(k),
            Self::Linkage(linkage) => {
                model.linkages[linkage].movers.iter().for_each(|moved| each(moved.dof));
            }
        }
    }

    /// Calls `each(i, j, aᵢ aⱼ)` for every pair of arms, both ways, and each with itself: this
    /// matrix on the dofs is a unit stiffness along the length.
    #[inline(always)]
    pub fn pairs<R: Real>(
        self,
        model: &Model<R::Value>,
        qpos: &[R],
        pulls: Pulls<R>,
        mut each: impl FnMut(usize, usize, R),
    ) {
        if let Some((dof, arm)) = self.only_arm(model) {
            let arm: R = factor(model, arm);
            return each(dof, dof, arm * arm);
        }
        self.all_arms(model, qpos, pulls, &mut |i, a: R| {
            self.all_arms(model, qpos, pulls, &mut |j, b: R| each(i, j, a * b));
        });
    }

    /// The dof and the arm of a length with a constant arm on one dof: a hinge or a slide.
    #[inline(always)]
    fn only_arm<N: Constant>(self, model: &Model<N>) -> Option<(usize, Option<usize>)> {
        let (joint, arm) = match self {
            Self::Joint(joint) => (joint, None),
            Self::Geared(joint, gear) => (joint, Some(gear)),
            _ => return None,
        };
        let joint = &model.joints[joint];
        (joint.dofs() == 1).then_some((joint.dof, arm))
    }

    /// `arms` as a call: inlining every kind of arm into every other makes much machine code.
    #[inline(never)]
    fn all_arms<R: Real>(
        self,
        model: &Model<R::Value>,
        qpos: &[R],
        pulls: Pulls<R>,
        each: &mut dyn FnMut(usize, R),
    ) {
        self.arms(model, qpos, pulls, each);
    }
}

/// The quaternion that starts at a place of qpos.
#[inline(always)]
fn turned<R: Real>(from: usize, qpos: &[R]) -> Quat<R> {
    Quat::of(&qpos[from..from + 4]).normalized()
}

/// A gear; 1 without one.
#[inline(always)]
fn factor<R: Real>(model: &Model<R::Value>, gear: Option<usize>) -> R {
    gear.map_or(R::one(), |at| model.gears[at].get())
}

fn axis<R: Real>(gear: &[R::Value]) -> V3<R> {
    V3::new(gear[0].get(), gear[1].get(), gear[2].get())
}

impl<R: Real> Reach<R> {
    /// Length and arms of a joint at once.
    #[inline(always)]
    pub fn of(model: &Model<R::Value>, joint: usize, qpos: &[R]) -> Self {
        let joint = &model.joints[joint];
        let first = joint.dof;
        if joint.kind == JointType::Ball {
            let quat = Quat::of(&qpos[joint.qpos..joint.qpos + 4]).normalized();
            let (axis, angle) = quat.axis_angle();
            let sign = R::select(angle.lt(R::zero()), -R::one(), R::one());
            let arms = [axis.x * sign, axis.y * sign, axis.z * sign];
            return Self { length: angle.abs(), first, arms, count: 3 };
        }
        let arms = [R::one(), R::zero(), R::zero()];
        Self { length: qpos[joint.qpos], first, arms, count: 1 }
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
            let mut model = model(kind);
            model.gears.push(-2.5);
            let mut start = model.qpos0.clone();
            let push: Vec<f64> = (0..model.nv).map(|k| 0.4 - 0.3 * k as f64).collect();
            advance(&model, &model.qpos0, &push, 1.0, &mut start);
            let mut all = vec![Transmission::Joint(0)];
            if kind != JointType::Ball {
                all.push(Transmission::Geared(0, 0));
            }
            for along in all {
                let mut arms = vec![0.0; model.nv];
                let pulls = Pulls { length: &[], arms: &[] };
                along.arms(&model, &start, pulls, |dof, arm: f64| arms[dof] += arm);
                for (dof, arm) in arms.iter().enumerate() {
                    let length = |by: f64| {
                        let mut unit = vec![0.0; model.nv];
                        unit[dof] = by;
                        let mut moved = start.clone();
                        advance(&model, &start, &unit, 1.0, &mut moved);
                        along.length(&model, &moved, pulls)
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
