//! Gravity compensation: a force at a body's centre of mass that holds up a share of its weight.
//!
//! On joints with `actuatorgravcomp` it counts as their actuators' force: then a drive gives it, within
//! the joint's `actuatorfrcrange`, and none where there is no actuator, as in MuJoCo. It stores energy
//! all the same, as the weight does that it holds; what a drive withholds counts as put in.

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

/// Calls `add(dof, force)` for what holds a body, whole, on dofs that drives hold or on the others.
fn whole<R: Real>(now: &Moment<R>, body: usize, driven: bool, add: &mut impl FnMut(usize, R)) {
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

/// Calls `add(dof, force)` for all of it that drives are asked for.
pub(super) fn asked_of_drives<R: Real>(now: &Moment<R>, mut add: impl FnMut(usize, R)) {
    for body in 1..DrivenCompensation::count(now.model) {
        whole(now, body, true, &mut add);
    }
}

/// The part of it that drives give on a dof; None: all.
fn given<R: Real>(now: &Moment<R>, dof: usize) -> Option<R> {
    if !drives(now.model) {
        return Some(R::zero());
    }
    now.frames.shares.get(dof).copied()
}

/// There is an actuator that can give it.
fn drives(model: &Model) -> bool {
    model.features.actuation && !model.actuators.is_empty()
}

impl Forces for Compensation {
    const KIND: Kind = Kind::GravityCompensation;
    const GROUP: Group = Group::Passive;

    fn force<R: Real>(now: &Moment<R>, body: usize, add: &mut impl FnMut(usize, R)) {
        whole(now, body, false, add);
    }

    #[inline(always)]
    fn push<R: Real>(now: &Moment<R>, sum: &mut Sum<R>) {
        if now.model.compensates {
            for body in 1..now.model.bodies.len() {
                whole(now, body, false, &mut |dof, force| sum.force[dof] += force);
            }
        }
    }
}

impl Forces for DrivenCompensation {
    const KIND: Kind = Kind::GravityCompensation;
    const GROUP: Group = Group::Driven;

    fn count(model: &Model) -> usize {
        if model.compensates && model.joints.iter().any(|joint| joint.actuatorgravcomp) {
            model.bodies.len()
        } else {
            0
        }
    }

    fn element(body: usize) -> Element {
        Element::whole(Kind::GravityCompensation, body)
    }

    fn force<R: Real>(now: &Moment<R>, body: usize, add: &mut impl FnMut(usize, R)) {
        whole(now, body, true, &mut |dof, force| {
            add(dof, given(now, dof).map_or(force, |part| force * part));
        });
    }

    #[inline(always)]
    fn powers<R: Real>(now: &Moment<R>) -> bool {
        !(drives(now.model) && now.frames.shares.is_empty())
    }

    fn power<R: Real>(
        now: &Moment<R>,
        body: usize,
        velocity: &impl Fn(usize) -> R,
        add: &mut impl FnMut(R),
    ) {
        whole(now, body, true, &mut |dof, force| {
            if let Some(part) = given(now, dof) {
                add((part - R::one()) * force * velocity(dof));
            }
        });
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
