//! Contacts under the law `penalty`: a spring and a damper under the surface, the trap that is
//! kept so that it can be measured. No row, a force on the guess.

use crate::detect::Contact;
use crate::model::Pair;
use crate::real::{Mask, Real};
use crate::settings::Settings;
use crate::solve::{Push, Rows, Situation};

impl<R: Real> Rows<R> {
    /// −k φ − b J v along the normal while shapes overlap, b a share of what is critical to the
    /// mass 1/A that the contact moves.
    pub(super) fn penalty(&mut self, now: &Situation<R>, contact: &Contact<R>, pair: &Pair) {
        let settings = now.settings;
        self.normal_row(now, contact, pair);
        let Some(row) = self.rows.pop() else { return };
        let mass = row.a.recip_or_zero();
        let k = R::of(settings.penalty_stiffness);
        let damping = R::of(2.0 * settings.penalty_damping_ratio) * (k * mass).sqrt();
        let force = -(k * contact.dist) - damping * row.velocity;
        let mask = contact.mask.and(contact.dist.lt(R::zero()));
        let dofs = row.dofs.of(&now.model.dof_lists);
        let y = &self.y[row.y..row.y + dofs.len()];
        let impulse = R::of(settings.dt) * force;
        Self::kick(&mut self.u, &now.placed.metric.inv_d, dofs, y, impulse, mask);
        self.pushes.push(Push {
            element: contact.element(),
            dofs: row.dofs,
            y: row.y,
            impulse: R::select(mask, impulse, R::zero()),
        });
    }
}

/// What a contact's spring stores [J].
pub(crate) fn stored<R: Real>(settings: &Settings, contact: &Contact<R>) -> R {
    let depth = contact.dist.min(R::zero());
    let energy = R::of(0.5 * settings.penalty_stiffness) * depth * depth;
    R::select(contact.mask, energy, R::zero())
}
