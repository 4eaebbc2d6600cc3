//! Limits of tendons: a length goes no further than its range. One row a bound.

use super::constraint::{Constraint, Makings};
use super::{limit, Element, Kind};
use crate::model::Model;
use crate::real::Real;
use crate::solve::{Rows, Situation};

pub(super) struct TendonLimit;

impl Constraint for TendonLimit {
    const MOST_ROWS: usize = 1;

    fn any(model: &Model) -> bool {
        model.features.limit && model.tendons.iter().any(|tendon| tendon.range.is_some())
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        for (index, tendon) in now.model.tendons.iter().enumerate() {
            let Some([lo, hi]) = tendon.range else { continue };
            if now.tendon_rests(index) {
                continue;
            }
            let length = now.placed.tendon_length[index];
            for (side, phi) in [length - R::of(lo), R::of(hi) - length].into_iter().enumerate() {
                let bound = limit::Bound {
                    element: Element::part(Kind::TendonLimit, index, side),
                    phi,
                    range: [lo, hi],
                    margin: tendon.margin,
                    soft: &tendon.limit,
                    dofs: tendon.closed,
                    invweight: tendon.invweight,
                    mass: tendon.mass,
                };
                rows.limit(now, &bound, |rows| rows.tendon_jacobian(now, index, side == 1));
            }
        }
    }
}

impl<R: Real> Situation<'_, R> {
    /// Everything that moves a tendon sleeps, or nothing does.
    pub(super) fn tendon_rests(&self, index: usize) -> bool {
        let dofs = self.model.tendons[index].dofs.of(&self.model.dof_lists);
        dofs.iter().all(|dof| self.rests(self.model.dofs[*dof].tree))
    }
}

impl<R: Real> Rows<R> {
    /// The arms of a tendon, or their opposite, into `scratch`, which is clear on its dofs.
    pub(super) fn tendon_jacobian(&mut self, now: &Situation<R>, index: usize, opposite: bool) {
        let tendon = &now.model.tendons[index];
        let arms = tendon.arms.of(&now.placed.tendon_arms);
        for (dof, arm) in tendon.dofs.of(&now.model.dof_lists).iter().zip(arms) {
            self.scratch[*dof] = if opposite { -*arm } else { *arm };
        }
    }
}
