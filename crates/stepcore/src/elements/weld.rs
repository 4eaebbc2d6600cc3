//! `weld`: a frame of one body stays on a frame of another. Three rows of their points, as in
//! `connect`, and three of their turn.
//!
//! With A and B the orientations of frame 1 and 2, the turn is s · vec Q, Q = B* A, half the rotation
//! vector where it is small; s is `torquescale`. As Ȧ = ½ ω₁ A and Ḃ = ½ ω₂ B (quaternion products),
//!
//! ```text
//! Q̇ = ½ B* ω A,  Q̈ = ½ B* (ω̇ + ω₁ × ω₂ − ½ |ω|²) A,  ω = ω₁ − ω₂
//! ```
//!
//! so that row k turns along d = ½ s R_B (Q_w e_k + Q_v × e_k), and its J̇ v is
//! d · (ω̇ + ω₁ × ω₂) − ¼ s |ω|² Q_k, ω̇ at zero acceleration of the dofs.

use super::connect::Apart;
use super::equality::Held;
use crate::model::{Ends, NONE};
use crate::real::{Mask, Real, Value};
use crate::solve::{Rows, Situation};
use crate::spatial::{rotate, Motion, Quat, M3, V3};

/// Roundings of a product of unit quaternions.
const ROUNDINGS: f64 = 8.0;

impl<R: Real> Rows<R> {
    pub(super) fn weld(
        &mut self,
        now: &Situation<R>,
        index: usize,
        ends: &Ends<R::Value>,
        scale: f64,
    ) {
        let first = self.rows.len();
        let Apart { way, curving } = self.points(now, index, ends);
        let zero = Held { gap: R::zero(), curving: R::zero(), invweight: R::zero() };
        let mut held = [zero; 6];
        for k in 0..3 {
            held[k] = Held { gap: way[k], curving: curving[k], invweight: ends.invweight[0].get() };
        }
        self.turns(now, index, ends, scale, &mut held[3..]);
        let square = held.iter().fold(R::zero(), |sum, held| sum + held.gap * held.gap);
        self.tie(now, index, first, square.sqrt(), &held);
    }

    /// Makes the rows of the turn.
    fn turns(
        &mut self,
        now: &Situation<R>,
        index: usize,
        ends: &Ends<R::Value>,
        scale: f64,
        held: &mut [Held<R>],
    ) {
        let (placed, equality) = (now.placed, &now.model.equalities[index]);
        let [one, two] = ends.bodies;
        let frame = |k: usize| placed.xquat[ends.bodies[k]].mul(&Quat::splat(&ends.quat[k]));
        let (a, b) = (frame(0), frame(1));
        let (turn, matrix) = (b.conjugate().mul(&a), b.matrix());
        let ([v1, v2], [a1, a2]) = ([one, two].map(spin(now)), [one, two].map(spinning_up(now)));
        let (relative, gains) = (v1 - v2, a1 - a2 + v1.cross(&v2));
        let at = placed.xpos[one];
        let (along, first) = (axes(&turn, &matrix, scale), self.rows.len());
        // Body 1 relative to body 2.
        self.push_relative(now, ([two, one], equality.dofs), None, &along);
        for (k, along) in along.into_iter().enumerate() {
            self.rows[first + k].lo = R::of(f64::NEG_INFINITY);
            self.drop_rounding_of(
                first + k,
                now,
                (ends.bodies, &at),
                equality.mass.get(),
                |motion: &Motion<R>, _| motion.ang.dot(&motion.ang) * R::of(0.25 * scale * scale),
            );
            let mut gap = R::of(scale) * turn.v[k];
            let unmoved = self.rows[first + k].a.le(R::zero());
            if unmoved.any() {
                // A row that nothing turns has the load gap/R with the least R: rounding must not load it.
                let rounding = turn.v[k].abs().le(R::of(ROUNDINGS * R::epsilon()));
                gap = R::select(unmoved.and(rounding), R::zero(), gap);
            }
            let bent = R::of(0.25) * relative.dot(&relative) * gap;
            held[k] =
                Held { gap, curving: along.dot(&gains) - bent, invweight: ends.invweight[1].get() };
        }
    }
}

/// Returns the direction along which each row of the turn Q turns, in the world; `matrix` is R_B.
pub(crate) fn axes<R: Real>(turn: &Quat<R>, matrix: &M3<R>, scale: f64) -> [V3<R>; 3] {
    [0, 1, 2].map(|k| {
        let mut axis = V3::zeros();
        axis[k] = R::one();
        let local = axis * turn.w + turn.v.cross(&axis);
        rotate(matrix, &local) * R::of(0.5 * scale)
    })
}

/// Returns the angular velocity of a body.
fn spin<'a, R: Real>(now: &'a Situation<'a, R>) -> impl Fn(usize) -> V3<R> + 'a {
    |body| if turns(now, body) { now.placed.velocity[body].ang } else { V3::zeros() }
}

/// Returns the angular acceleration when no dof accelerates.
fn spinning_up<'a, R: Real>(now: &'a Situation<'a, R>) -> impl Fn(usize) -> V3<R> + 'a {
    |body| {
        if turns(now, body) {
            now.placed.free_acceleration(now.model, body).ang
        } else {
            V3::zeros()
        }
    }
}

fn turns<R: Real>(now: &Situation<R>, body: usize) -> bool {
    let tree = now.model.bodies[body].tree;
    tree != NONE && !now.model.trees[tree].slides_only
}
