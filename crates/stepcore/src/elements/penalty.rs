//! Contacts under the law `penalty`: a spring and a damper under the surface, a trap that is kept so
//! that it can be measured. No row, a force on the guess.
//!
//! Friction is Coulomb's, regularised by a damper: |f_t| = min(μ f_n, γ |v_t|), against v_t. The
//! damper is an eighth of the critical one of the contact's spring and the mass 1/A_t that it moves
//! sideways, γ = ¼ √(k/A_t): a contact that holds f_t creeps at f_t/γ, and v_t decays at a rate of
//! γ A_t = ¼ √(k A_t), which a step that is stable for the spring can follow. Torsion and rolling are
//! velocities and forces of the same kind in their measure (`friction.rs`), so that one bound holds
//! for all ways together, Σ (f_j/μ_j)² ≤ f_n²; each has the damper that ends it as fast, γ A_t/A_j.

use super::friction::{Way, Ways};
use super::surface_velocity::drift;
use crate::detect::Contact;
use crate::model::{Pair, Span};
use crate::real::{Mask, Real, Value};
use crate::settings::Settings;
use crate::solve::{Push, Row, Rows, Situation};

/// γ over √(k/A_t).
const SIDEWAYS: f64 = 0.25;

impl<R: Real> Rows<R> {
    /// Applies −k φ − b J v along the normal while shapes overlap, b a share of the critical damping
    /// for the mass 1/A that the contact moves; then friction along the tangents.
    pub(super) fn penalty(&mut self, now: &Situation<R>, contact: &Contact<R>) {
        let (settings, pair) = (now.settings, &contact.pair);
        let mask = contact.mask.and(contact.dist.lt(R::zero()));
        let dt = R::of(settings.dt);
        self.normal_row(now, contact, pair);
        let Some(row) = self.rows.pop() else { return };
        let mass = row.a.recip_or_zero();
        let k = R::of(settings.penalty_stiffness);
        let damping = R::of(2.0 * settings.penalty_damping_ratio) * (k * mass).sqrt();
        let force = -(k * contact.dist) - damping * row.velocity;
        let material = now.model.material(pair);
        let pull = material.adhesion.get();
        let net = if now.model.features.passive() { force - pull } else { force };
        self.push_apart(now, contact, row.dofs, row.y, dt * net, mask);
        let ways = Ways::plain(pair.still, material);
        if material.condim > 1 && ways.rubs && mask.any() {
            let bound = ways.mu * force.max(R::zero());
            self.rub(now, contact, pair, &ways, dt * bound, mask);
        }
    }

    /// Applies friction of at most `bound` [N·s] in all its ways together, each in its measure.
    fn rub(
        &mut self,
        now: &Situation<R>,
        contact: &Contact<R>,
        pair: &Pair<R>,
        ways: &Ways<R>,
        bound: R,
        mask: R::Mask,
    ) {
        let first = self.rows.len();
        self.friction_rows(now, contact, pair, ways);
        if let Some(drift) = drift(now, contact, pair, ways) {
            let rows = self.rows[first..].iter_mut().zip(drift);
            rows.for_each(|(row, drift)| row.velocity += drift);
        }
        let rows = self.rows[first..].iter().zip(ways.list());
        let slides = rows.clone().filter(|(_, way)| !way.turns);
        let most = |a: R, (row, _): (&Row<R>, &Way<R>)| a.max(row.a);
        let a = slides.fold(R::zero(), most);
        let a = R::select(a.gt(R::zero()), a, rows.clone().fold(R::zero(), most));
        let mut square = R::zero();
        for (row, way) in rows {
            let speed = eased(row, way, a);
            square += speed * speed;
        }
        let k = R::of(now.settings.penalty_stiffness);
        let damper = R::of(SIDEWAYS * now.settings.dt) * (k * a.recip_or_zero()).sqrt();
        let slides = (damper * damper * square).gt(bound * bound);
        let damper = R::select(slides, bound * square.sqrt().recip_or_zero(), damper);
        for way in ways.list() {
            let row = &self.rows[first];
            let (dofs, y, impulse) = (row.dofs, row.y, -(damper * eased(row, way, a)));
            self.rows.remove(first);
            self.push_apart(now, contact, dofs, y, impulse, mask);
        }
    }

    /// Gives the guess an impulse along a complete row.
    fn push_apart(
        &mut self,
        now: &Situation<R>,
        contact: &Contact<R>,
        dofs: Span,
        y: usize,
        impulse: R,
        mask: R::Mask,
    ) {
        let list = dofs.of(now.dof_lists);
        let own = &self.y[y..y + list.len()];
        Self::kick(&mut self.u, &now.placed.metric.inv_d, list, own, impulse, mask);
        let impulse = R::select(mask, impulse, R::zero());
        self.pushes.push(Push { element: contact.element(), dofs, y, impulse });
    }
}

/// Returns the velocity that the damper of a way acts on: turning ends as fast as sliding with this A.
fn eased<R: Real>(row: &Row<R>, way: &Way<R>, a: R) -> R {
    if way.turns {
        row.velocity * (a * row.a.recip_or_zero())
    } else {
        row.velocity
    }
}

/// Returns the energy of a contact's spring [J].
pub(crate) fn stored<R: Real>(settings: &Settings, contact: &Contact<R>) -> R {
    let depth = contact.dist.min(R::zero());
    let energy = R::of(0.5 * settings.penalty_stiffness) * depth * depth;
    R::select(contact.mask, energy, R::zero())
}
