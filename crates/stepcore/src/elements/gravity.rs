//! Gravity: the weight of every body at its centre of mass.
//!
//! `place` includes it in the bias forces, as an upward acceleration of the world. This file has the
//! same force by itself, and its potential.

use super::applied::on_dofs;
use super::force::{Forces, Group, Moment, Sum};
use super::{Element, Kind};
use crate::model::Model;
use crate::plan::acting::{Acts, MassAt, Why};
use crate::real::{Constant, Real, Value};
use crate::spatial::{splat, V3};

pub(super) struct Gravity;

/// m g.
pub(super) fn weight<R: Real>(now: &Moment<R>, at: &MassAt<R::Value>) -> V3<R> {
    V3::from_fn(|k, _| Value::calc([&now.model.gravity[k], &at.mass], |[g, m]| g * m))
}

impl Forces for Gravity {
    const KIND: Kind = Kind::Gravity;
    const GROUP: Group = Group::Weight;
    type At<N: Constant> = MassAt<N>;

    #[inline(always)]
    fn count(model: &Model) -> usize {
        model.bodies.len()
    }

    fn element(body: usize) -> Element {
        Element::part(Kind::Gravity, 0, body)
    }

    fn at(model: &Model, body: usize) -> Result<MassAt, Why> {
        match model.bodies[body].mass {
            _ if !model.features.gravity => Err(Why::Off("gravity")),
            mass if body > 0 && mass > 0.0 => Ok(MassAt { body, mass }),
            _ => Err(Why::Zero("mass")),
        }
    }

    fn force<R: Real>(now: &Moment<R>, at: &MassAt<R::Value>, add: &mut impl FnMut(usize, R)) {
        let weight = weight(now, at);
        on_dofs(now, at.body, &weight, &V3::zeros(), add);
    }

    /// The bias forces include it.
    fn push<R: Real>(_: &Moment<R>, _: &[Acts<MassAt<R::Value>>], _: &mut Sum<R>) {}

    /// −m g·c, zero at the world's origin; for fixed bodies too.
    #[inline(always)]
    fn stored<R: Real>(now: &Moment<R>, at: &MassAt<R::Value>, add: &mut impl FnMut(R)) {
        let gravity = splat::<R, _>(&now.model.gravity);
        let centre = now.frames.centre(now.model, at.body);
        add(-(at.mass.get() * gravity.dot(&centre)));
    }
}
