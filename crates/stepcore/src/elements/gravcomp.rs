//! Gravity compensation: a force at a body's centre of mass that holds up a share of its weight.
//!
//! On joints with `actuatorgravcomp` it counts as their actuators' force: then a drive gives it, and
//! it is no passive one. It stores energy all the same, as the weight does that it holds.

use super::applied::on_dofs;
use super::force::{Forces, Group, Moment, Sum};
use super::{Element, Kind};
use crate::model::{Model, NONE};
use crate::real::Real;
use crate::spatial::{splat, V3};

/// On joints without `actuatorgravcomp`.
pub(super) struct Compensation;
/// On those with it.
pub(super) struct DrivenCompensation;
/// Neither: the energy of both.
pub(super) struct Held;

/// The mass that is held up.
fn share(model: &Model, body: usize) -> f64 {
    let own = &model.bodies[body];
    if model.compensates && own.tree != NONE {
        own.gravcomp * own.mass
    } else {
        0.0
    }
}

fn push<R: Real>(now: &Moment<R>, body: usize, driven: bool, add: &mut impl FnMut(usize, R)) {
    let model = now.model;
    let share = share(model, body);
    if share != 0.0 {
        let force = splat::<R>(&(model.gravity * -share));
        on_dofs(now, body, &force, &V3::zeros(), &mut |k, force| {
            if model.joints[model.dofs[k].joint].actuatorgravcomp == driven {
                add(k, force);
            }
        });
    }
}

fn push_all<R: Real>(now: &Moment<R>, driven: bool, sum: &mut Sum<R>) {
    if now.model.compensates {
        for body in 1..now.model.bodies.len() {
            push(now, body, driven, &mut |dof, force| sum.force[dof] += force);
        }
    }
}

impl Forces for Compensation {
    const KIND: Kind = Kind::GravityCompensation;
    const GROUP: Group = Group::Passive;

    fn force<R: Real>(now: &Moment<R>, body: usize, add: &mut impl FnMut(usize, R)) {
        push(now, body, false, add);
    }

    #[inline(always)]
    fn push<R: Real>(now: &Moment<R>, sum: &mut Sum<R>) {
        push_all(now, false, sum);
    }
}

impl Forces for DrivenCompensation {
    const KIND: Kind = Kind::GravityCompensation;
    const GROUP: Group = Group::Driven;

    fn count(model: &Model) -> usize {
        if model.joints.iter().any(|joint| joint.actuatorgravcomp) {
            model.bodies.len()
        } else {
            0
        }
    }

    fn element(body: usize) -> Element {
        Element::whole(Kind::GravityCompensation, body)
    }

    fn force<R: Real>(now: &Moment<R>, body: usize, add: &mut impl FnMut(usize, R)) {
        push(now, body, true, add);
    }

    #[inline(always)]
    fn push<R: Real>(now: &Moment<R>, sum: &mut Sum<R>) {
        push_all(now, true, sum);
    }
}

/// What both store, beside the weight.
impl Forces for Held {
    const KIND: Kind = Kind::GravityCompensation;
    const GROUP: Group = Group::Weight;

    fn force<R: Real>(_: &Moment<R>, _body: usize, _add: &mut impl FnMut(usize, R)) {}

    /// m g·c times the share: what the weight stores less.
    fn stored<R: Real>(now: &Moment<R>, body: usize, add: &mut impl FnMut(R)) {
        let share = share(now.model, body);
        if share != 0.0 {
            let gravity = splat::<R>(&now.model.gravity);
            add(R::of(share) * gravity.dot(&now.frames.centre(now.model, body)));
        }
    }
}
