//! Contacts as rows: a normal, and friction as a pyramid of edges or as a cone.
//!
//! Under `solref` (MuJoCo's convex friction) the pyramid's rows are its edges
//! J_n ± μ_j J_j, two for each way of friction (`friction.rs`). A tangent along which
//! nothing can move leaves two copies of the normal row; they are folded into one with
//! half the regulariser (all four, where neither tangent moves, into one with a quarter),
//! never dropped, because they carry stiffness.

use super::adhesion::Normal;
use super::constraint::{Constraint, Makings};
use super::friction::{Axis, Way, Ways, MOST_WAYS};
use super::surface_velocity::drift;
use crate::detect::path::time_of_impact;
use crate::detect::Contact;
use crate::model::{Model, Pair, NEAR, NONE};
use crate::real::{Constant, Mask, Real, Value};
use crate::settings::{Cone, Law};
use crate::solve::law::{least_softness, target_at, weightless_softness, Near, OnGuess, SolRef};
use crate::solve::{Guessed, Rows, Set, Situation};
use crate::spatial::{Motion, V3};

pub(super) struct Contacts;

impl Constraint for Contacts {
    /// Two edges for each of two tangents, torsion and two ways of rolling.
    const MOST_ROWS: usize = 10;
    const MOST_CONE_ROWS: usize = 6;

    fn any(model: &Model) -> bool {
        model.meets()
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        if rows.shares(now, makings.contacts.len()) {
            return rows.share_contacts(now, makings.contacts);
        }
        match now.settings.law {
            Law::SolRef => rows.soft_contacts(now, makings.contacts),
            Law::Penalty => {
                for contact in &*makings.contacts {
                    rows.penalty(now, contact);
                }
            }
            Law::Lesson | Law::Relaxed | Law::Rigid => {
                for contact in &mut *makings.contacts {
                    let pair = &{ contact.pair };
                    rows.rigid_contact(now, contact, pair);
                }
            }
        }
    }
}

impl<R: Real> Rows<R> {
    /// Makes the rows of how the geoms slide along some directions, or turn about them, each multiplied
    /// by its scale.
    fn moving_rows(
        &mut self,
        now: &Situation<R>,
        (contact, pair): (&Contact<R>, &Pair<R>),
        along: &[V3<R>],
        scales: &[R],
        turn: bool,
    ) {
        let (bodies, points, first) = (bodies(now.model, pair), contact.points(), self.rows.len());
        self.push_relative(now, (bodies, pair.dofs), (!turn).then_some(&points), along);
        for (row, scale) in (first..).zip(scales) {
            self.drop_rounding_of(row, now, (bodies, &contact.pos), pair.mass, |motion, arm| {
                let most = if turn { motion.ang.dot(&motion.ang) } else { motion.most_at(arm) };
                most * (*scale * *scale)
            });
        }
    }

    pub(super) fn normal_row(&mut self, now: &Situation<R>, contact: &Contact<R>, pair: &Pair<R>) {
        self.moving_rows(now, (contact, pair), &[contact.normal], &[R::one()], false);
    }

    /// Makes the rows of the ways of friction, in their measure.
    pub(super) fn friction_rows(
        &mut self,
        now: &Situation<R>,
        contact: &Contact<R>,
        pair: &Pair<R>,
        ways: &Ways<R>,
    ) {
        self.rows_along(now, contact, pair, ways, false);
    }

    /// Makes the rows of the ways of friction, after a row of the normal if requested.
    fn rows_along(
        &mut self,
        now: &Situation<R>,
        contact: &Contact<R>,
        pair: &Pair<R>,
        ways: &Ways<R>,
        normal: bool,
    ) {
        if ways.list().is_empty() {
            if normal {
                self.normal_row(now, contact, pair);
            }
            return;
        }
        let axis = axes_of(contact, now);
        let (mut along, mut scales) = ([contact.normal; 3], [R::one(); 3]);
        for turn in [false, true] {
            let mut count = usize::from(normal && !turn);
            for way in ways.list().iter().filter(|way| way.turns == turn) {
                (along[count], scales[count]) = (axis(way), way.scale);
                count += 1;
            }
            self.moving_rows(now, (contact, pair), &along[..count], &scales[..count], turn);
        }
    }

    fn least_softness(&self, first: usize, pair: &Pair<R>) -> R {
        let rows = &self.rows[first..];
        if pair.invweight.is_zero() {
            weightless_softness(rows, pair.mass)
        } else {
            least_softness(rows, pair.mass)
        }
    }

    /// Notes that a contact leaves this much of its overlap to later steps [m].
    fn note_unrecovered(&mut self, mask: R::Mask, left: R) {
        self.unrecovered = R::select(mask, self.unrecovered.max(left), self.unrecovered);
    }

    /// Closes the rows from `first` on into the contact's block.
    fn close(
        &mut self,
        now: &Situation<R>,
        contact: &Contact<R>,
        pair: &Pair<R>,
        (first, set, mu): (usize, Set, R),
        mask: R::Mask,
    ) {
        let block = self.push_block(first, set, mask, now, contact.element(), pair.mass);
        block.mu = mu;
        block.feature = contact.feature;
        block.kin = now.model.kin(pair, contact.part);
    }

    /// Makes MuJoCo's contact: soft normal, convex friction.
    pub(super) fn soft_contact(&mut self, now: &Situation<R>, contact: &Contact<R>) {
        let (settings, dt, pair) = (now.settings, R::of(now.settings.dt), &contact.pair);
        let material = now.model.material(pair);
        let mask = contact.mask.and(contact.dist.lt(material.reach()));
        if mask.none() || self.pyramids(now, core::array::from_ref(contact)) {
            return;
        }
        let r = contact.dist - material.margin.get();
        let mut law = SolRef::at(&material.soft, r, settings.dt, settings.refsafe);
        let ways = Ways::soft(pair.still, material);
        let (weight, mu, impratio) = (pair.invweight, ways.slide, R::of(settings.impratio));
        let first = self.rows.len();
        let most = settings.max_recovery_speed.under(Law::SolRef);
        self.rows_along(now, contact, pair, &ways, true);
        if let Some(most) = most {
            // The normal of a pyramid is all its edges together, four with condim 3.
            let edges = settings.cone == Cone::Pyramidal && material.condim > 1;
            let count = R::of(f64::from(2 * material.condim.max(2) - 2));
            let weight = if edges { edge_weight(weight, mu, impratio) / count } else { weight };
            let row = &self.rows[first];
            let guess = self.dot(now.dof_lists, row, &now.placed.guess);
            let most = target_at(row, law.softness * weight, guess, most);
            let limited = law.at_most(row.velocity, r, most, dt);
            let left = (limited.kd - law.kd) * r * dt * dt;
            law = limited;
            self.note_unrecovered(mask, left);
        }
        let (a, velocity) = (self.rows[first].a, self.rows[first].velocity);
        let normal = |least| Normal { law, weight, least, a, velocity };
        if material.condim == 1 {
            let least = self.least_softness(first, pair);
            law.fill(&mut self.rows[first], r, weight, least, dt);
            self.apply_adhesion(now, contact, pair, (&ways, Set::Interval, first), normal(least));
            return self.close(now, contact, pair, (first, Set::Interval, ways.mu), mask);
        }
        if settings.cone == Cone::Elliptic {
            let least = self.least_softness(first, pair);
            law.fill(&mut self.rows[first], r, weight, least, dt);
            // MuJoCo's R_j = R₁ μ₁²/μ_j², in the measure of the ways.
            let across_weight = weight / impratio * (ways.share * ways.share);
            let across = law.of_friction(&material.solreffriction, &material.soft, now.settings);
            for row in &mut self.rows[first + 1..] {
                across.fill(row, R::zero(), across_weight, least, dt);
                row.lo = R::of(f64::NEG_INFINITY);
            }
            let drift = drift(now, contact, pair, &ways);
            self.apply_surface_velocity(drift.as_ref(), &ways, dt * across.b, (first, false));
            self.anchor(now, contact, pair, &ways, drift.as_ref(), (first, false));
            self.apply_adhesion(now, contact, pair, (&ways, Set::Convex, first), normal(least));
            return self.close(now, contact, pair, (first, Set::Convex, ways.mu), mask);
        }
        let unmoved = R::Mask::of(weight.is_zero()).and(self.rows[first].a.le(R::zero()));
        self.pyramid(now, &ways, first);
        self.fill_pyramid(now, contact, (first, &ways), (law, r, unmoved, [a, velocity]), mask);
    }

    /// Fills in the edges from `first` on, at the violation r. `unmoved`: nothing moves the normal, and
    /// its load has no bound; [a, velocity]: the normal's, if contacts adhere.
    pub(super) fn fill_pyramid(
        &mut self,
        now: &Situation<R>,
        contact: &Contact<R>,
        (first, ways): (usize, &Ways<R>),
        (law, r, unmoved, [a, velocity]): (SolRef<R>, R, R::Mask, [R; 2]),
        mask: R::Mask,
    ) {
        let pair = &contact.pair;
        let (dt, mu, still) = (R::of(now.settings.dt), ways.slide, ways.still);
        let edge = edge_weight(pair.invweight, mu, R::of(now.settings.impratio));
        let edges = self.rows.len() - first;
        let least = self.least_softness(first, pair);
        for (k, row) in self.rows[first..].iter_mut().enumerate() {
            // The fold is last: 2 or 4 equal rows in one.
            let folded = still > 0 && k + 1 == edges;
            let weight = if folded { edge * R::of(0.5) / R::of(still as f64) } else { edge };
            law.fill(row, r, weight, least, dt);
        }
        if mask.and(unmoved).any() {
            self.split_unmoved_edges(law, first, edges - edges % 2, unmoved, dt);
        }
        let drift = drift(now, contact, pair, ways);
        self.apply_surface_velocity(drift.as_ref(), ways, dt * law.b, (first, true));
        self.anchor(now, contact, pair, ways, drift.as_ref(), (first, true));
        let normal = Normal { law, weight: pair.invweight, least, a, velocity };
        self.apply_adhesion(now, contact, pair, (ways, Set::Interval, first), normal);
        self.close(now, contact, pair, (first, Set::Interval, ways.mu), mask);
    }

    /// Replaces each pair of edges ±μ J_t, where the normal moves nothing and its load has no bound, by
    /// a tangent without bounds and a row that carries the load. A pair would be solved by differences
    /// of loads, which leave no digits, and which sweeps never reach.
    fn split_unmoved_edges(
        &mut self,
        law: SolRef<R>,
        first: usize,
        edges: usize,
        unmoved: R::Mask,
        dt: R,
    ) {
        let zero = R::zero();
        let set = |x: &mut R, new: R| *x = R::select(unmoved, new, *x);
        for at in (first..first + edges).step_by(2) {
            let [tangent, load] = &mut self.rows[at..at + 2] else { return };
            set(&mut tangent.lo, R::of(f64::NEG_INFINITY));
            set(&mut tangent.gap, zero);
            set(&mut tangent.t, tangent.velocity - dt * (law.b * tangent.velocity));
            set(&mut load.velocity, zero);
            set(&mut load.t, -(dt * (law.kd * load.gap)));
            set(&mut load.a, zero);
            set(&mut load.inv_s, load.c.recip_or_zero());
            let own = load.y..load.y + load.dofs.len;
            self.y[own].iter_mut().for_each(|y| set(y, zero));
        }
    }

    /// Replaces the rows from `first` on, the normal and the ways, by the edges J_n ± μ_j J_j, then
    /// the fold.
    fn pyramid(&mut self, now: &Situation<R>, ways: &Ways<R>, first: usize) {
        let moving = self.rows.len() - first - 1;
        if moving == 0 {
            return; // The normal row is the fold.
        }
        let normal = &self.rows[first];
        let (dofs, a, velocity) = (normal.dofs, normal.a, normal.velocity);
        let mut tangents = [R::zero(); MOST_WAYS];
        for (tangent, row) in tangents.iter_mut().zip(&self.rows[first + 1..]) {
            *tangent = row.velocity;
        }
        self.take_ways(first);
        for (way, tangent) in (1..).zip(&tangents[..moving]) {
            self.push_edges(now, dofs, way, (velocity, *tangent), ways.mu);
        }
        if ways.still > 0 {
            self.push_normal(dofs, a, velocity);
        }
    }

    /// Makes a contact under `lesson`, `relaxed` or `rigid`: a row where the guess overlaps, or where
    /// the shapes are so near that other rows may make it overlap.
    fn rigid_contact(&mut self, now: &Situation<R>, contact: &mut Contact<R>, pair: &Pair<R>) {
        let law = OnGuess::new(now);
        let first = self.rows.len();
        self.normal_row(now, contact, pair);
        let [one, two] = [pair.geom1, pair.geom2].map(|geom| &now.model.geoms[geom].reach);
        let size: R = Value::calc([one, two], |[one, two]| one.min(two));
        let (mut phi, touching) = (contact.dist, contact.dist.le(R::of(NEAR) * size));
        let Guessed { closing, mut gained } = self.guessed(now, first, phi);
        let closing = contact.mask.and(closing);
        let mut mask = contact.mask.and(closing.or(touching));
        let mut arrives = R::Mask::of(true);
        let ahead = closing.and(touching.not());
        if pair.test.curved() && ahead.any() {
            let found = self.met_ahead(now, contact, pair, size, ahead);
            mask = mask.and(ahead.not().or(found.met));
            arrives = found.turned.not();
            if found.turned.any() {
                self.pop_row();
                phi = R::select(found.turned, found.phi, phi);
                self.normal_row(now, contact, pair);
                gained = self.guessed(now, first, phi).gained;
            }
        }
        contact.mask = mask;
        if mask.none() {
            self.pop_row();
            return;
        }
        let near = Near { phi, closing, gained, arrives, far: phi.gt(size) };
        let mut push = law.push(phi);
        if let Some(most) = now.settings.max_recovery_speed.under(now.settings.law) {
            let over = mask.and(push.gt(R::of(most)));
            if over.any() {
                let row = &self.rows[first];
                let guess = self.dot(now.dof_lists, row, &now.placed.guess);
                let most = push.min(target_at(row, law.regulariser(), guess, most));
                self.note_unrecovered(over, (push - most) * R::of(now.settings.dt));
                push = R::select(over, most, push);
            }
        }
        law.distance(&mut self.rows[first], &near, now.settings.restitution, push);
        let material = now.model.material(pair);
        let ways = Ways::plain(pair.still, material);
        if !ways.rubs || material.condim == 1 {
            return self.close(now, contact, pair, (first, Set::Interval, ways.mu), mask);
        }
        self.friction_rows(now, contact, pair, &ways);
        let least = weightless_softness(&self.rows[first..], pair.mass);
        law.unmoved(&mut self.rows[first], least);
        for row in &mut self.rows[first + 1..] {
            law.friction(row);
            row.lo = R::of(f64::NEG_INFINITY);
        }
        let drift = drift(now, contact, pair, &ways);
        self.apply_surface_velocity(drift.as_ref(), &ways, R::one(), (first, false));
        let set = match now.settings.cone {
            Cone::Elliptic => Set::CoulombRound,
            Cone::Pyramidal => Set::CoulombBox,
        };
        self.close(now, contact, pair, (first, set, ways.mu), mask);
    }

    /// Follows the shapes of a contact that is still ahead along the guess, in the lanes of `open`, to
    /// see if they meet. If the normal has changed by then, the contact becomes the later one.
    fn met_ahead(
        &mut self,
        now: &Situation<R>,
        contact: &mut Contact<R>,
        pair: &Pair<R>,
        size: R,
        open: R::Mask,
    ) -> Ahead<R> {
        let way = self.way(now, contact, pair);
        let met = time_of_impact(now.model, now.placed, contact, &way, R::of(NEAR) * size, open);
        if met.turned.any() {
            for k in 0..3 {
                contact.pos[k] = R::select(met.turned, met.pos[k], contact.pos[k]);
                contact.normal[k] = R::select(met.turned, met.normal[k], contact.normal[k]);
                contact.ahead[k] = R::select(met.turned, way[k] * met.share, R::zero());
            }
        }
        let phi = -(met.normal.dot(&way) * met.share);
        Ahead { met: met.met, turned: met.turned, phi }
    }

    /// Returns the motion of geom 2 relative to geom 1 in the step, by the guess [m]: of the round
    /// shapes' centres, and of the flat ones' nearest points.
    fn way(&mut self, now: &Situation<R>, contact: &Contact<R>, pair: &Pair<R>) -> V3<R> {
        let half = R::of(0.5) * contact.dist;
        let [first, second] = [(pair.geom1, -R::one()), (pair.geom2, R::one())].map(|(g, side)| {
            let geom = &now.model.geoms[g];
            let core = half + geom.kind.roundness(&geom.size);
            self.motion_by_guess(now, geom.body, &(contact.pos + contact.normal * (side * core)))
        });
        (second - first) * R::of(now.settings.dt)
    }

    /// Returns the velocity of a body's point by the guess [m/s].
    fn motion_by_guess(&mut self, now: &Situation<R>, body: usize, at: &V3<R>) -> V3<R> {
        let body = &now.model.bodies[body];
        if body.tree == NONE {
            return V3::zeros();
        }
        let [chain, closed] = [body.chain, body.closed].map(|dofs| dofs.of(&now.model.dof_lists));
        now.placed.metric.from_factored_on(closed, &now.placed.guess, &mut self.guess);
        let arm = at - now.placed.origin[body.tree];
        let mut motion = Motion::zero();
        for &k in chain {
            motion.add_scaled(&now.placed.motion[k], self.guess[k]);
        }
        motion.at(&arm)
    }
}

/// Returns the axis of a way of friction, multiplied by its scale.
pub(super) fn axes_of<R: Real>(
    contact: &Contact<R>,
    now: &Situation<R>,
) -> impl Fn(&Way<R>) -> V3<R> {
    let (normal, tangents) = (contact.normal, contact.tangents(now.placed));
    move |way| {
        let axis = match way.axis {
            Axis::Normal => normal,
            Axis::Tangent(at) => tangents[at],
        };
        if way.scale == R::one() {
            axis
        } else {
            axis * way.scale
        }
    }
}

/// Returns MuJoCo's inverse weight of an edge: 2 μ² (1 + μ²)/impratio of the normal's.
fn edge_weight<R: Real>(normal: R, mu: R, impratio: R) -> R {
    normal * R::of(2.0) * mu * mu / impratio * (R::one() + mu * mu)
}

pub(super) fn bodies<N: Constant, P>(model: &Model<N>, pair: &Pair<P>) -> [usize; 2] {
    [model.geoms[pair.geom1].body, model.geoms[pair.geom2].body]
}

/// The meeting ahead of a contact.
struct Ahead<R: Real> {
    /// The shapes meet, and with another normal than the present one.
    met: R::Mask,
    turned: R::Mask,
    /// The present distance from the plane in which they meet [m].
    phi: R,
}
