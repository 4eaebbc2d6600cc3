//! Friction loss of a tendon: dry friction along its length, an impulse of at most dt · loss.

use super::constraint::{Constraint, Makings};
use super::friction_loss::Loss;
use super::{Element, Kind};
use crate::model::Model;
use crate::real::Real;
use crate::solve::Rows;

pub(super) struct TendonFriction;

impl Constraint for TendonFriction {
    const MOST_ROWS: usize = 1;

    fn any(model: &Model) -> bool {
        model.features.frictionloss && model.tendons.iter().any(|t| t.frictionloss > 0.0)
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        for (index, tendon) in now.model.tendons.iter().enumerate() {
            if tendon.frictionloss <= 0.0 || now.tendon_rests(index) {
                continue;
            }
            let loss = Loss {
                element: Element::whole(Kind::TendonFriction, index),
                most: tendon.frictionloss,
                soft: &tendon.friction,
                dofs: tendon.closed,
                invweight: tendon.invweight,
                mass: tendon.mass,
            };
            rows.friction_loss(now, &loss, |rows| rows.tendon_jacobian(now, index, false));
        }
    }
}
