//! Gravity: the weight of every body at its centre of mass.
//!
//! `place` holds it in the bias forces, as an upward acceleration of the world; what is
//! written here is the same force by itself, and its potential.

use super::applied::on_dofs;
use super::force::{Forces, Group, Moment, Sum};
use super::{Element, Kind};
use crate::model::Model;
use crate::real::Real;
use crate::spatial::{splat, V3};

pub(super) struct Gravity;

impl Forces for Gravity {
    const KIND: Kind = Kind::Gravity;
    const GROUP: Group = Group::Weight;

    #[inline(always)]
    fn count(model: &Model) -> usize {
        model.bodies.len()
    }

    fn element(body: usize) -> Element {
        Element::part(Kind::Gravity, 0, body)
    }

    fn force<R: Real>(now: &Moment<R>, body: usize, add: &mut impl FnMut(usize, R)) {
        let mass = now.model.bodies[body].mass;
        if now.model.features.gravity && mass > 0.0 {
            let weight = splat::<R>(&(now.model.gravity * mass));
            on_dofs(now, body, &weight, &V3::zeros(), add);
        }
    }

    /// The bias forces hold it.
    fn push<R: Real>(_: &Moment<R>, _: &mut Sum<R>) {}

    /// −m g·c, zero at the world's origin; of fixed bodies too.
    #[inline(always)]
    fn stored<R: Real>(now: &Moment<R>, body: usize, add: &mut impl FnMut(R)) {
        if now.model.features.gravity && body > 0 {
            let gravity = splat::<R>(&now.model.gravity);
            let centre = now.frames.centre(now.model, body);
            add(-(R::of(now.model.bodies[body].mass) * gravity.dot(&centre)));
        }
    }
}
