//! Stiction: friction that holds without creep, under `solref`.
//!
//! MuJoCo's friction rows have no position: at rest they creep at R λ/(dt b). With `Settings::stiction`
//! a contact that sticks has an anchor: the slip s of its two points since then (and their turn against
//! each other). Its friction rows undo s with the spring of their law, as a normal row undoes an
//! overlap: t = u − dt (b u + K d s). At rest the speed is 0, and s = R λ/(dt K d). This is the
//! tangential spring of Cundall and Strack (A discrete numerical model for granular assemblies,
//! Géotechnique 29, 1979). Elastic contacts have one, about as stiff as along their normal (Mindlin
//! 1949), as it is here if impratio is 1.
//!
//! Where the spring requests more than friction can give, the contact slips: s is shortened until the
//! request is exactly at the bound (radial return), so that a spring gives back no more than it took.
//!
//! s is a vector of the world in the plane of the contact. It tilts with the normal at the same
//! length, and turns about the normal with the flatter of the two geoms: a ball that spins on a table
//! does not wind it up.

use super::friction::{Axis, Way, Ways, MOST_WAYS};
use super::surface_velocity::Drift;
use crate::detect::Contact;
use crate::model::{Pair, NONE};
use crate::real::{Constant, Mask, Real, Value};
use crate::scene::{GeomType, Softness};
use crate::settings::Settings;
use crate::solve::law::Spring;
use crate::solve::{Anchor, Block, Rows, Set, Situation};
use crate::spatial::V3;
use crate::warm::{SLIP, SLIPS};

/// dt K d of the friction rows of a contact whose normal has the overlap `r`.
fn pull<R: Real>(
    own: Option<&[R::Value; 2]>,
    soft: &Softness<R::Value>,
    r: R,
    settings: &Settings,
) -> R {
    let [time, ratio] = own.unwrap_or(&soft.solref);
    // A time constant alone, which is all that damping needs: critically damped.
    let alone = time.is_positive() && ratio.vanishes();
    let spring = match alone {
        true => Spring::critical(time, &soft.solimp, settings.dt, settings.refsafe),
        false => Spring::of([time, ratio], &soft.solimp, settings.dt, settings.refsafe),
    };
    R::of(settings.dt) * spring.at(r).kd
}

impl<R: Real> Rows<R> {
    /// Pulls the friction rows of the next block back by the slip of its contact: rows from `first` on
    /// are edges in pairs, or else a normal and its ways.
    pub(super) fn anchor(
        &mut self,
        now: &Situation<R>,
        contact: &Contact<R>,
        pair: &Pair<R>,
        ways: &Ways<R>,
        drift: Option<&Drift<R>>,
        (first, edges): (usize, bool),
    ) {
        if !now.settings.stiction || ways.list().is_empty() {
            return;
        }
        let material = now.model.material(pair);
        let r = contact.dist - material.margin.get();
        let own = material.solreffriction.as_ref().filter(|_| !edges);
        let pull = pull(own, &material.soft, r, now.settings);
        let mut anchor = self.moved(now, contact, pair, ways, drift, (first, edges));
        anchor.pull = pull;
        let mu = ways.mu;
        for (k, slip) in anchor.along.iter().enumerate().take(ways.list().len()) {
            let by = if edges { pull * (mu * *slip) } else { pull * *slip };
            self.shift_target(k, by, (first, edges));
        }
        self.anchors.push(anchor);
    }

    /// Returns the anchor of the last step, carried on, with the points' motion since.
    fn moved(
        &mut self,
        now: &Situation<R>,
        contact: &Contact<R>,
        pair: &Pair<R>,
        ways: &Ways<R>,
        drift: Option<&Drift<R>>,
        (first, edges): (usize, bool),
    ) -> Anchor<R> {
        let tangents = contact.tangents(now.placed);
        let axis = |way: &Way<R>| match way.axis {
            Axis::Normal => contact.normal,
            Axis::Tangent(at) => tangents[at],
        };
        let [mut slide, mut turn] = self.kept_slip(now, contact);
        let n = &contact.normal;
        let spin = self.spin_of_flatter(now, pair, n) * R::of(now.settings.dt);
        let wound = n * turn.dot(n);
        (slide, turn) = (carried(&slide, n, spin), carried(&(turn - wound), n, spin) + wound);
        let per_edge = R::of(0.5) / ways.mu;
        let mut along = [R::zero(); MOST_WAYS];
        for (k, way) in ways.list().iter().enumerate() {
            let velocity = if edges {
                let own = first + 2 * k;
                let alone = self.rows[own].lo.lt(R::zero());
                let other = self.rows[own + 1].velocity;
                let apart = self.rows[own].velocity - other;
                R::select(alone, (apart + other) * (per_edge + per_edge), apart * per_edge)
            } else {
                self.rows[first + 1 + k].velocity
            };
            let velocity = drift.map_or(velocity, |drift| velocity + drift[k]);
            let slip = if way.turns { &mut turn } else { &mut slide };
            if now.first_stage {
                *slip += axis(way) * (velocity * (R::of(now.settings.dt) / way.scale));
            }
            along[k] = axis(way).dot(slip) * way.scale;
        }
        Anchor { block: self.blocks.len(), slide, turn, along, pull: R::zero() }
    }

    /// Returns the slip that the last step left, found as impulses are: by slot and feature.
    fn kept_slip(&self, now: &Situation<R>, contact: &Contact<R>) -> [V3<R>; 2] {
        let kin = now.model.kin(&contact.pair, contact.part);
        let mut slip = [R::zero(); SLIPS];
        let from = now.warm.partition_point(|warm| warm.slot < kin.start);
        for warm in now.warm[from..].iter().take_while(|warm| warm.slot < kin.end) {
            let own = warm.feature.le(contact.feature).and(warm.feature.ge(contact.feature));
            for (slip, kept) in slip.iter_mut().zip(&warm.impulse[SLIP..]) {
                *slip = R::select(own, *kept, *slip);
            }
        }
        let [a, b, c, d, e, f] = slip;
        [V3::new(a, b, c), V3::new(d, e, f)]
    }

    /// Returns the rate at which the flatter of two geoms turns about the normal [rad/s]; both equally
    /// flat: their mean.
    fn spin_of_flatter(&mut self, now: &Situation<R>, pair: &Pair<R>, normal: &V3<R>) -> R {
        let flat = |geom: usize| match now.model.geoms[geom].kind {
            GeomType::Plane | GeomType::HField => 100,
            kind => kind as u8,
        };
        let (one, two) = (flat(pair.geom1), flat(pair.geom2));
        if one == two {
            let both = self.spin(now, pair.geom1, normal) + self.spin(now, pair.geom2, normal);
            return R::of(0.5) * both;
        }
        self.spin(now, if one > two { pair.geom1 } else { pair.geom2 }, normal)
    }

    fn spin(&mut self, now: &Situation<R>, geom: usize, normal: &V3<R>) -> R {
        let body = &now.model.bodies[now.model.geoms[geom].body];
        if body.tree == NONE || !body.turns {
            return R::zero();
        }
        let [chain, closed] = [body.chain, body.closed].map(|dofs| dofs.of(&now.model.dof_lists));
        now.placed.metric.from_factored_on(closed, &now.placed.u, &mut self.guess);
        chain
            .iter()
            .fold(R::zero(), |spin, &k| spin + now.placed.motion[k].ang.dot(normal) * self.guess[k])
    }

    /// Returns the slip of a block with which the next step starts: no more than friction held.
    pub(crate) fn held_slip(&self, anchor: &Anchor<R>, block: &Block<R>) -> [R; SLIPS] {
        let zero = R::zero();
        let own = block.rows.range();
        let Some(normal) = self.rows.get(own.start) else { return [zero; SLIPS] };
        let impulse = |at: usize| self.solved(at);
        let (asked, most) = if block.set == Set::Convex {
            let square = anchor.along.iter().fold(zero, |sum, s| sum + *s * *s);
            let c = self.rows.get(own.start + 1).map_or(zero, |row| row.c);
            let some = square.gt(zero);
            let size = R::select(some, square, R::one()).sqrt();
            (R::select(some, size, zero) * anchor.pull, c * block.mu * impulse(own.start))
        } else {
            // |λ₊ − λ₋| = 2 pull μ s/c for each pair, together no more than the sum of all edges.
            let sum = anchor.along.iter().fold(zero, |sum, s| sum + s.abs());
            let load = own.clone().fold(zero, |load, at| load + impulse(at).max(zero));
            (sum * anchor.pull * (block.mu + block.mu), normal.c * load)
        };
        let share = (most * asked.recip_or_zero()).min(R::one());
        let (s, t) = (anchor.slide * share, anchor.turn * share);
        [s.x, s.y, s.z, t.x, t.y, t.z]
    }
}

/// Returns a vector of the plane of an earlier normal, in the plane of this one at the same length,
/// turned by an angle (as a rational rotation, exact to the third order).
fn carried<R: Real>(slip: &V3<R>, normal: &V3<R>, angle: R) -> V3<R> {
    let flat = slip - normal * slip.dot(normal);
    let (square, left) = (slip.dot(slip), flat.dot(&flat));
    let some = left.gt(R::zero());
    let length = R::select(some, square * left.recip_or_zero(), R::one()).sqrt();
    let half = R::of(0.5) * angle;
    let per = (R::one() + half * half).recip_or_zero();
    let (cos, sin) = ((R::one() - half * half) * per, (half + half) * per);
    (flat * cos + normal.cross(&flat) * sin) * length
}

#[cfg(test)]
mod tests {
    use super::carried;
    use crate::spatial::V3;

    /// A tilt of the normal keeps the length, a turn about it the angle.
    #[test]
    fn slip_is_carried_with_the_plane() {
        let (slip, up) = (V3::new(3.0, 4.0, 0.0), V3::new(0.0, 0.0, 1.0));
        assert_eq!(carried(&slip, &up, 0.0), slip);
        let (sin, cos) = 0.3_f64.sin_cos();
        let tilted = carried(&slip, &V3::new(sin, 0.0, cos), 0.0);
        assert!(
            (tilted.norm() - 5.0).abs() < 1e-15 && (tilted.x * sin + tilted.z * cos).abs() < 1e-15
        );
        let turned = carried(&slip, &up, 1e-3);
        let exact = V3::new(3.0 - 4e-3, 4.0 + 3e-3, 0.0) - slip * 0.5e-6;
        assert!((turned - exact).norm() < 5e-9 && (turned.norm() - 5.0).abs() < 1e-14);
        assert_eq!(carried(&V3::zeros(), &up, 0.1), V3::zeros());
        assert_eq!(carried(&(up * 2.0), &up, 0.1), V3::zeros());
    }
}
