//! Surfaces that move while their geoms do not: conveyor belts, treadmills, turntables.
//!
//! A surface moves as σ(x) = v + ω × (x − p), v and ω in the frame of its geom and p the origin of the
//! frame. A contact's friction acts on J u + s: s is the velocity of the surface of geom 2 relative to
//! the surface of geom 1, along the way of friction, or for torsion turning about the normal. Rolling
//! and the normal ignore it (MuJoCo documentation, XML reference, geom/surfacevel).

use super::friction::{Axis, Way, Ways, MOST_WAYS};
use crate::detect::Contact;
use crate::model::{Model, Pair};
use crate::place::Placed;
use crate::real::Real;
use crate::sim::Sim;
use crate::solve::{Rows, Situation};
use crate::spatial::V3;
use nalgebra::Vector3;

/// s along each way of friction, in its measure [m/s].
pub(super) type Drift<R> = [R; MOST_WAYS];

/// Returns the drift; None if no surface moves.
pub(super) fn drift<R: Real>(
    now: &Situation<R>,
    contact: &Contact<R>,
    pair: &Pair<R>,
    ways: &Ways<R>,
) -> Option<Drift<R>> {
    let [slide, turn] = apart(now.model, now.placed, contact, pair)?;
    let tangents = contact.tangents(now.placed);
    let mut drift = [R::zero(); MOST_WAYS];
    for (drift, way) in drift.iter_mut().zip(ways.list()) {
        *drift = match way {
            Way { axis: Axis::Tangent(at), turns: false, .. } => tangents[*at].dot(&slide),
            Way { axis: Axis::Normal, .. } => contact.normal.dot(&turn),
            _ => R::zero(),
        } * way.scale;
    }
    Some(drift)
}

/// Returns the velocity and the angular velocity of geom 2's surface relative to geom 1's, beyond their
/// bodies' motion, where they touch; None if neither moves.
fn apart<R: Real>(
    model: &Model<R::Value>,
    placed: &Placed<R>,
    contact: &Contact<R>,
    pair: &Pair<R>,
) -> Option<[V3<R>; 2]> {
    let geoms = [pair.geom1, pair.geom2];
    if geoms.iter().all(|geom| model.geoms[*geom].belt.is_none()) {
        return None;
    }
    let [one, two] = geoms.map(|geom| surface(model, placed, geom, &contact.pos));
    Some([two[0] - one[0], two[1] - one[1]])
}

/// Returns the velocity of a geom's surface at a point relative to its body, and its angular velocity.
fn surface<R: Real>(
    model: &Model<R::Value>,
    placed: &Placed<R>,
    geom: usize,
    at: &V3<R>,
) -> [V3<R>; 2] {
    let Some([slide, turn]) = &model.geoms[geom].belt else { return [V3::zeros(); 2] };
    let pose = &placed.geom[geom];
    let [slide, turn] = [slide, turn].map(|v| pose.rot * v.map(R::of));
    [slide + turn.cross(&(at - pose.pos)), turn]
}

impl<R: Real> Sim<R> {
    /// Returns the power of surfaces that move [W], by lane: friction takes the heat of a sliding
    /// contact from the sliding bodies and from the surfaces, so that these put in −f·s.
    pub(crate) fn power_of_surfaces(&self) -> R {
        let mut sum = R::zero();
        for lane in 0..R::LANES {
            let mut power = 0.0;
            for (_, contact) in self.live_contacts(lane) {
                let moved = apart(&self.model, &self.placed, contact, &contact.pair);
                let Some([slide, turn]) = moved else { continue };
                let [slide, turn, normal] =
                    [slide, turn, contact.normal].map(|v| v.map(|x| x.lane(lane)));
                let wrench = self.contact_wrench(contact, lane);
                let force = Vector3::new(wrench[0], wrench[1], wrench[2]);
                let torque = Vector3::new(wrench[3], wrench[4], wrench[5]);
                let along = slide - normal * normal.dot(&slide);
                power -= force.dot(&along) + torque.dot(&normal) * normal.dot(&turn);
            }
            sum.set_lane(lane, power);
        }
        sum
    }
}

impl<R: Real> Rows<R> {
    /// Subtracts rate × drift from the friction targets of the next block, so that they follow the
    /// surfaces. Rows from `first` on are edges in pairs, or else a normal and its ways.
    pub(super) fn apply_surface_velocity(
        &mut self,
        drift: Option<&Drift<R>>,
        ways: &Ways<R>,
        rate: R,
        (first, edges): (usize, bool),
    ) {
        let Some(drift) = drift else { return };
        let measure = if edges { rate * ways.mu } else { rate };
        for (way, drift) in drift.iter().enumerate().take(ways.list().len()) {
            self.shift_target(way, measure * *drift, (first, edges));
        }
    }

    /// Subtracts `by` from the target of a way of friction: from its row, or from its two edges.
    pub(super) fn shift_target(&mut self, way: usize, by: R, (first, edges): (usize, bool)) {
        if !edges {
            self.rows[first + 1 + way].t -= by;
            return;
        }
        let [one, other] = &mut self.rows[first + 2 * way..first + 2 * way + 2] else { return };
        // Edges that were split: the first is the tangent, the second its load.
        let alone = one.lo.lt(R::zero());
        one.t -= by;
        other.t = R::select(alone, other.t, other.t + by);
    }
}
