//! Contacts that pull: the adhesion δ of geoms, under `solref` and `penalty`.
//!
//! The set of forces is moved down the normal: the acting force is f − δ with f in the cone, so that a
//! contact pulls with up to δ and friction is bounded by μ (f_n + δ). A force −δ along the normal acts
//! next to the rows (`Rows::pushes`). The targets of the rows rise so that the pair of f − δ and the
//! velocity is as in a cone without end, by c δ dt; a pyramid's edges have equal shares (MuJoCo
//! documentation, "Adhesion").
//!
//! It acts throughout the gap. Beyond the margin there is no friction: the normal alone has a row, with
//! the normal's regulariser.

use super::friction::Ways;
use crate::detect::Contact;
use crate::model::{Material, Model, Pair};
use crate::place::Placed;
use crate::real::{Constant, Mask, Real, Value};
use crate::settings::Law;
use crate::solve::law::SolRef;
use crate::solve::{Push, Row, Rows, Set, Situation};
use crate::spatial::Force;

/// The normal of a contact before it became the edges of a pyramid.
#[derive(Clone, Copy)]
pub(super) struct Normal<R: Real> {
    pub law: SolRef<R>,
    pub weight: R,
    pub least: R,
    pub a: R,
    pub velocity: R,
}

impl<N: Constant> Model<N> {
    /// Checks that some contacts pull with forces next to their rows under this law. These are passive
    /// forces: without them the targets of the rows rise all the same, as in MuJoCo.
    pub(crate) fn pulls_beside_rows(&self, law: Law) -> bool {
        self.sticks && law == Law::SolRef && self.features.passive()
    }
}

impl<N: Constant> Material<N> {
    /// Returns the distance below which a contact has rows [m].
    #[inline(always)]
    pub(crate) fn reach<R: Real>(&self) -> R
    where
        N: Value<R>,
    {
        if self.adhesion.is_positive() {
            self.listed()
        } else {
            self.margin.get()
        }
    }
}

impl<R: Real> Placed<R> {
    /// Adds the contacts' adhesion to the passive forces, as MuJoCo counts it.
    pub(crate) fn pull_contacts(&mut self, model: &Model<R::Value>, contacts: &[Contact<R>]) {
        for contact in contacts {
            let material = model.material(&contact.pair);
            let near = contact.mask.and(contact.dist.lt(material.reach()));
            let pull = contact.normal * R::select(near, material.adhesion.get(), R::zero());
            let geoms = [contact.pair.geom1, contact.pair.geom2];
            for (geom, force) in geoms.into_iter().zip([pull, -pull]) {
                for dof in model.bodies[model.geoms[geom].body].chain.of(&model.dof_lists) {
                    let origin = &self.origin[model.dofs[*dof].tree];
                    let ang = (contact.pos - origin).cross(&force);
                    self.passive[*dof] += self.motion[*dof].dot(&Force { ang, lin: force });
                }
            }
        }
    }
}

impl<R: Real> Rows<R> {
    /// Adds adhesion to the contact whose complete rows start at `first`.
    pub(super) fn apply_adhesion(
        &mut self,
        now: &Situation<R>,
        contact: &Contact<R>,
        pair: &Pair<R>,
        (ways, set, first): (&Ways<R>, Set, usize),
        normal: Normal<R>,
    ) {
        let material = now.model.material(pair);
        if !material.adhesion.is_positive() {
            return;
        }
        let (zero, one) = (R::zero(), R::one());
        let mask = contact.mask.and(contact.dist.lt(material.reach()));
        let apart = mask.and(contact.dist.lt(material.margin.get()).not());
        if apart.any() && material.condim > 1 {
            self.keep_normal(now, contact, material, (first, set), &normal, apart);
        }
        let edges = set == Set::Interval && material.condim > 1;
        let most = f64::from(2 * material.condim.max(2) - 2);
        let (impulse, count) = (material.adhesion.get() * now.clock.dt, self.rows.len() - first);
        for k in 0..count {
            // The fold of a pyramid is this many of its edges in one.
            let folded = ways.still > 0 && k + 1 == count;
            let copies = if folded { 2.0 * ways.still as f64 } else { 1.0 };
            let alone = if k == 0 { one } else { zero };
            let share = if edges { R::select(apart, alone, R::of(copies / most)) } else { alone };
            let row = &mut self.rows[first + k];
            let own = mask.and(row.lo.ge(zero).or(R::Mask::of(!edges)));
            row.t += row.c * R::select(own, impulse * share, zero);
        }
        if !now.model.pulls_beside_rows(now.settings.law) {
            return;
        }
        let (dofs, mut y) = (self.rows[first].dofs, self.rows[first].y);
        if edges && count > 1 {
            // The normal from which the edges were made.
            y = self.y.len();
            self.y.extend_from_slice(&self.ways[..dofs.len]);
        }
        let list = dofs.of(now.dof_lists);
        let own = &self.y[y..y + list.len()];
        Self::kick(&mut self.u, &now.placed.metric.inv_d, list, own, -impulse, mask);
        let impulse = R::select(mask, -impulse, zero);
        self.pushes.push(Push { element: contact.element(), dofs, y, impulse });
    }

    /// Makes the first row the normal, and the others rows that nothing moves, where they are `apart`.
    fn keep_normal(
        &mut self,
        now: &Situation<R>,
        contact: &Contact<R>,
        material: &Material<R::Value>,
        (first, set): (usize, Set),
        normal: &Normal<R>,
        apart: R::Mask,
    ) {
        let zero = R::zero();
        let set_to = |x: &mut R, new: R| *x = R::select(apart, new, *x);
        if set == Set::Interval {
            let dt = R::of(now.settings.dt);
            if let [up, _, ..] = &self.rows[first..] {
                // The rows from which the edges were made, the normal first.
                let own = up.y..up.y + up.dofs.len;
                self.y[own].iter_mut().zip(&self.ways).for_each(|(y, new)| set_to(y, *new));
            }
            let row = &mut self.rows[first];
            let mut own = Row { a: normal.a, velocity: normal.velocity, ..row.clone() };
            let r = contact.dist - material.margin.get();
            normal.law.fill(&mut own, r, normal.weight, normal.least, dt);
            let both =
                [(&mut row.a, own.a), (&mut row.velocity, own.velocity), (&mut row.t, own.t)];
            both.into_iter().for_each(|(x, new)| set_to(x, new));
            set_to(&mut row.c, own.c);
            set_to(&mut row.inv_s, own.inv_s);
        }
        for at in first + 1..self.rows.len() {
            let row = &mut self.rows[at];
            for x in [&mut row.a, &mut row.velocity, &mut row.t] {
                set_to(x, zero);
            }
            set_to(&mut row.inv_s, row.c.recip_or_zero());
            let own = row.y..row.y + row.dofs.len;
            self.y[own].iter_mut().for_each(|y| set_to(y, zero));
        }
    }
}
