//! Forces that the user applies: `qfrc_applied` on dofs, and `xfrc_applied`, a force at a body's centre
//! of mass and a moment, in world axes.

use super::force::{Forces, Group, Moment, Sum};
use super::Kind;
use crate::model::{Model, NONE};
use crate::plan::acting::{Acts, Why};
use crate::real::{Constant, Real};
use crate::spatial::{Force, V3};

pub(super) struct JointForce;

impl Forces for JointForce {
    const KIND: Kind = Kind::JointForce;
    const GROUP: Group = Group::Driven;
    const APPLIED: bool = true;
    /// The joint's first dof, and its number of dofs.
    type At<N: Constant> = (usize, usize);

    fn at(model: &Model, joint: usize) -> Result<(usize, usize), Why> {
        let joint = &model.joints[joint];
        Ok((joint.dof, joint.dofs()))
    }

    #[inline(always)]
    fn force<R: Real>(now: &Moment<R>, dofs: &(usize, usize), add: &mut impl FnMut(usize, R)) {
        if now.inputs.applied() {
            let (first, count) = *dofs;
            (first..first + count).for_each(|k| add(k, now.inputs.qfrc_applied()[k]));
        }
    }

    #[inline(always)]
    fn push<R: Real>(now: &Moment<R>, _: &[Acts<(usize, usize)>], sum: &mut Sum<R>) {
        if now.inputs.applied() {
            let given = now.inputs.qfrc_applied();
            sum.force.iter_mut().zip(given).for_each(|(sum, force)| *sum += *force);
        }
    }

    #[inline(always)]
    fn powers<R: Real>(now: &Moment<R>) -> bool {
        now.inputs.applied()
    }

    fn power<R: Real>(
        now: &Moment<R>,
        dofs: &(usize, usize),
        velocity: &[R],
        add: &mut impl FnMut(R),
    ) {
        Self::force(now, dofs, &mut |k, force| add(force * velocity[k]));
    }
}

pub(super) struct BodyForce;

impl Forces for BodyForce {
    const KIND: Kind = Kind::BodyForce;
    const GROUP: Group = Group::Driven;
    const APPLIED: bool = true;
    /// The body.
    type At<N: Constant> = usize;

    fn at(_: &Model, body: usize) -> Result<usize, Why> {
        Ok(body)
    }

    fn force<R: Real>(now: &Moment<R>, &body: &usize, add: &mut impl FnMut(usize, R)) {
        let [force, moment] = given(now, body);
        if now.inputs.applied() && !force.iter().chain(moment.iter()).all(|x| x.is_zero()) {
            on_dofs(now, body, &force, &moment, add);
        }
    }

    /// All at once: wrenches are passed down each tree to its root and projected on the way.
    #[inline(always)]
    fn push<R: Real>(now: &Moment<R>, _: &[Acts<usize>], sum: &mut Sum<R>) {
        if !now.inputs.applied() {
            return;
        }
        let (model, frames) = (now.model, &now.frames);
        for (tree_index, tree) in model.trees.iter().enumerate() {
            for index in tree.bodies.range() {
                let [lin, moment] = given(now, index);
                let at = frames.centre(model, index) - frames.origin[tree_index];
                sum.wrench[index] = Force { ang: moment + at.cross(&lin), lin };
            }
            for index in tree.bodies.range().rev() {
                let body = &model.bodies[index];
                for k in body.dofs.range() {
                    sum.force[k] += frames.motion[k].dot(&sum.wrench[index]);
                }
                if body.parent >= tree.bodies.start {
                    let part = sum.wrench[index];
                    sum.wrench[body.parent].add(&part);
                }
            }
        }
    }

    #[inline(always)]
    fn powers<R: Real>(now: &Moment<R>) -> bool {
        now.inputs.applied()
    }

    fn power<R: Real>(now: &Moment<R>, body: &usize, velocity: &[R], add: &mut impl FnMut(R)) {
        Self::force(now, body, &mut |k, force| add(force * velocity[k]));
    }

    /// The strength of the force alone, on the body alone.
    fn strength<R: Real>(
        now: &Moment<R>,
        &index: &usize,
        lane: usize,
        _: &dyn Fn(usize) -> f64,
    ) -> f64 {
        let body = &now.model.bodies[index];
        let [force, _] = given(now, index);
        let mass = body.mass.lane(lane);
        if mass > 0.0 {
            force.iter().map(|f| f.lane(lane).powi(2)).sum::<f64>() / mass
        } else {
            0.0
        }
    }
}

/// Returns the force and the moment that are applied to a body.
fn given<R: Real>(now: &Moment<R>, body: usize) -> [V3<R>; 2] {
    let w = &now.inputs.xfrc_applied()[6 * body..6 * body + 6];
    [V3::new(w[0], w[1], w[2]), V3::new(w[3], w[4], w[5])]
}

/// Calls `add(dof, force)` for a force at a body's centre of mass and a moment, in world axes.
pub(super) fn on_dofs<R: Real>(
    now: &Moment<R>,
    body: usize,
    force: &V3<R>,
    moment: &V3<R>,
    add: &mut impl FnMut(usize, R),
) {
    let tree = now.model.bodies[body].tree;
    if tree != NONE {
        let arm = now.frames.centre(now.model, body) - now.frames.origin[tree];
        at_point(now, body, &arm, force, moment, add);
    }
}

/// Does the same for a force at a point of a body that moves, `arm` from its tree's origin.
pub(super) fn at_point<R: Real>(
    now: &Moment<R>,
    body: usize,
    arm: &V3<R>,
    force: &V3<R>,
    moment: &V3<R>,
    add: &mut impl FnMut(usize, R),
) {
    for &k in now.model.bodies[body].chain.of(&now.model.dof_lists) {
        let motion = &now.frames.motion[k];
        let along = force.dot(&(motion.lin + motion.ang.cross(arm)));
        add(k, along + moment.dot(&motion.ang));
    }
}
