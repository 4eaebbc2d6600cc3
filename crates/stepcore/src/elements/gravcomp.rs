//! Gravity compensation: a force at a body's centre of mass that holds up a share of its weight.
//!
//! On joints with `actuatorgravcomp` it counts as actuator force: a drive provides it, within the
//! joint's `actuatorfrcrange`, and there is none without an actuator, as in MuJoCo. It stores energy
//! all the same, as the weight that it holds does; a part that a drive withholds counts as put in.

use super::applied::on_dofs;
use super::force::{Forces, Group, Moment};
use super::gravity::weight;
use super::Kind;
use crate::model::{Body, Model, NONE};
use crate::plan::acting::{Acts, MassAt, Why};
use crate::real::{Constant, Real, Value};
use crate::spatial::{splat, V3};

/// Compensation on joints without `actuatorgravcomp`.
pub(super) struct Compensation;
/// Compensation on joints with it.
pub(super) struct DrivenCompensation;
/// Stores the energy of both; pushes nothing.
pub(super) struct Held;

fn at(model: &Model, body: usize) -> Result<MassAt, Why> {
    let Body { tree, gravcomp, mass, .. } = &model.bodies[body];
    match gravcomp * mass {
        mass if model.compensates && *tree != NONE && mass != 0.0 => Ok(MassAt { body, mass }),
        _ => Err(Why::Unsaid),
    }
}

/// Calls `add(dof, force)` for a body's whole compensation, on dofs that drives hold or on the others.
fn whole<R: Real>(
    now: &Moment<R>,
    at: &MassAt<R::Value>,
    driven: bool,
    add: &mut impl FnMut(usize, R),
) {
    let model = now.model;
    let force = -weight(now, at);
    on_dofs(now, at.body, &force, &V3::zeros(), &mut |k, force| {
        if model.joints[model.dofs[k].joint].actuatorgravcomp == driven {
            add(k, force);
        }
    });
}

/// Calls `add(dof, force)` for all of the compensation that is requested from drives.
pub(super) fn asked_of_drives<R: Real>(now: &Moment<R>, mut add: impl FnMut(usize, R)) {
    for Acts { at, .. } in &now.model.acting.driven_compensation {
        whole(now, at, true, &mut add);
    }
}

/// Returns the part of it that drives provide on a dof; None: all.
fn given<R: Real>(now: &Moment<R>, dof: usize) -> Option<R> {
    if !drives(now.model) {
        return Some(R::zero());
    }
    now.frames.shares.get(dof).copied()
}

/// Checks that an actuator exists that can provide it.
fn drives<N: Constant>(model: &Model<N>) -> bool {
    model.features.actuation && !model.actuators.is_empty()
}

impl Forces for Compensation {
    const KIND: Kind = Kind::GravityCompensation;
    const GROUP: Group = Group::Passive;

    type At<N: Constant> = MassAt<N>;

    fn at(model: &Model, body: usize) -> Result<MassAt, Why> {
        at(model, body)
    }

    fn force<R: Real>(now: &Moment<R>, at: &MassAt<R::Value>, add: &mut impl FnMut(usize, R)) {
        whole(now, at, false, add);
    }
}

impl Forces for DrivenCompensation {
    const KIND: Kind = Kind::GravityCompensation;
    const GROUP: Group = Group::Driven;

    type At<N: Constant> = MassAt<N>;

    fn at(model: &Model, body: usize) -> Result<MassAt, Why> {
        let driven = model.joints.iter().any(|joint| joint.actuatorgravcomp);
        if driven {
            at(model, body)
        } else {
            Err(Why::Unsaid)
        }
    }

    fn force<R: Real>(now: &Moment<R>, at: &MassAt<R::Value>, add: &mut impl FnMut(usize, R)) {
        whole(now, at, true, &mut |dof, force| {
            add(dof, given(now, dof).map_or(force, |part| force * part));
        });
    }

    #[inline(always)]
    fn powers<R: Real>(now: &Moment<R>) -> bool {
        !(drives(now.model) && now.frames.shares.is_empty())
    }

    fn power<R: Real>(
        now: &Moment<R>,
        at: &MassAt<R::Value>,
        velocity: &[R],
        add: &mut impl FnMut(R),
    ) {
        whole(now, at, true, &mut |dof, force| {
            if let Some(part) = given(now, dof) {
                add((part - R::one()) * force * velocity[dof]);
            }
        });
    }
}

/// The energy of both, next to the weight's.
impl Forces for Held {
    const KIND: Kind = Kind::GravityCompensation;
    const GROUP: Group = Group::Weight;
    type At<N: Constant> = MassAt<N>;

    fn at(model: &Model, body: usize) -> Result<MassAt, Why> {
        at(model, body)
    }

    fn force<R: Real>(_: &Moment<R>, _: &MassAt<R::Value>, _add: &mut impl FnMut(usize, R)) {}

    /// m g·c times the share: the reduction of the weight's energy.
    fn stored<R: Real>(now: &Moment<R>, at: &MassAt<R::Value>, add: &mut impl FnMut(R)) {
        let gravity = splat::<R, _>(&now.model.gravity);
        add(at.mass.get() * gravity.dot(&now.frames.centre(now.model, at.body)));
    }
}
