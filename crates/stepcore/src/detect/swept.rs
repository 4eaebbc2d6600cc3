//! Bounds on the motion of each geom in a step, for laws that read the guess.
//!
//! Under these laws a contact at distance φ has a row only if the guess overlaps, φ + dt·J v̂ < 0,
//! or if φ is a thousandth of the smaller geom (see `elements/contact.rs`). J v̂ is the approach of
//! the two bodies' points halfway between the surfaces. Such a point is within ρ + φ/2 of its
//! geom's centre, which moves by v, so it moves by at most v + ω (ρ + φ/2). With E = dt (v + ω ρ) and
//! c = dt ω/2, a row needs φ (1 − c₁ − c₂) < E₁ + E₂. With C no less than any c, this is
//! φ < (E₁ + E₂)/(1 − 2C), a part for each geom, by which its sphere is enlarged. A geom that turns by
//! more than half a radian in a step is near everything.
//!
//! Nothing is assumed of the effect of rows on the guess: a row that would exist only because of
//! another row's effect is one that the row maker does not make either.

use crate::model::{Geom, Model, Pair, NEAR, NONE};
use crate::place::Placed;
use crate::real::{Real, Value};
use crate::spatial::Motion;

/// Parts of a geom's size and of its way that rounding cannot exceed, in single precision too.
const ROUNDING: f64 = 1e-4;
/// The largest c for which E counts.
const MOST_TURN: f64 = 0.25;

/// Spheres that hold a geom throughout the step.
pub(super) struct Swept<R: Real> {
    /// v̂, by dof.
    velocity: Vec<R>,
    /// By body.
    motion: Vec<Motion<R>>,
    /// c by geom.
    turn: Vec<R>,
    /// By geom: E at first, then the enlargement of its sphere [m].
    more: Vec<R>,
}

room!(Swept<R>: velocity, motion, turn, more);

impl<R: Real> Swept<R> {
    pub fn new() -> Self {
        Self { velocity: vec![], motion: vec![], turn: vec![], more: vec![] }
    }

    /// Bounds the motion of all geoms that collide, by the present guess.
    pub fn sweep(&mut self, model: &Model<R::Value>, placed: &Placed<R>, dt: f64) {
        let (zero, one) = (R::zero(), R::one());
        self.velocity.resize(model.nv, zero);
        self.motion.resize(model.bodies.len(), Motion::zero());
        self.turn.resize(model.geoms.len(), zero);
        self.more.resize(model.geoms.len(), zero);
        placed.metric.from_factored(&placed.guess, &mut self.velocity);
        self.motions(model, placed);
        let (dt, most) = (R::of(dt), R::of(MOST_TURN));
        let mut turned = zero;
        for (index, geom) in model.geoms.iter().enumerate().filter(|(_, geom)| geom.collides) {
            let body = &model.bodies[geom.body];
            if body.tree == NONE {
                continue;
            }
            let motion = &self.motion[geom.body];
            let arm = placed.geom[index].pos - placed.origin[body.tree];
            let centre = motion.at(&arm);
            let (speed, spin) = (centre.dot(&centre).sqrt(), motion.ang.dot(&motion.ang).sqrt());
            // Cancellation in the centre's velocity leaves rounding.
            let terms = motion.lin.dot(&motion.lin).sqrt() + spin * arm.dot(&arm).sqrt();
            let rounding = R::of(64.0 * R::epsilon()) * terms;
            self.more[index] = dt * (speed + spin * geom.reach.get() + rounding);
            let turn = R::of(0.5) * dt * spin;
            self.turn[index] = turn;
            turned = R::select(turn.le(most), turned.max(turn), turned);
        }
        let share = R::of(1.0 + ROUNDING) / (one - R::of(2.0) * turned);
        let moves = |geom: &Geom<R::Value>| geom.collides && model.bodies[geom.body].tree != NONE;
        for (index, geom) in model.geoms.iter().enumerate().filter(|(_, geom)| moves(geom)) {
            let least = geom.reach.times(NEAR + ROUNDING);
            let more = self.more[index] * share + least;
            let counts = self.turn[index].le(most);
            self.more[index] = R::select(counts, more, R::of(f64::INFINITY));
        }
    }

    /// Returns the total enlargement of a pair's spheres: adhesion pulls through the whole gap.
    #[inline(always)]
    pub fn of<P>(&self, model: &Model<R::Value>, pair: &Pair<P>) -> R {
        let more = self.more[pair.geom1] + self.more[pair.geom2];
        if model.adheres {
            more.max(model.material(pair).listed())
        } else {
            more
        }
    }

    /// Returns the enlargement of a geom's sphere.
    pub fn geom(&self, geom: usize) -> R {
        self.more[geom]
    }

    /// Computes the motion of every body about its tree's origin.
    fn motions(&mut self, model: &Model<R::Value>, placed: &Placed<R>) {
        for (index, body) in model.bodies.iter().enumerate().filter(|(_, body)| body.tree != NONE) {
            let first = model.trees[body.tree].bodies.start == index;
            let mut motion = if first { Motion::zero() } else { self.motion[body.parent] };
            for k in body.dofs.range() {
                motion.add_scaled(&placed.motion[k], self.velocity[k]);
            }
            self.motion[index] = motion;
        }
    }
}
