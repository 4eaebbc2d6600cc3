//! A small quadratic over a box, by active sets: what the friction of a pyramid's ways is.
//!
//! From a point of the box to the minimiser of the face that it is on, or as far as the box
//! allows; there one more way is held. At a face's minimiser the way whose slope leads most
//! inwards is let go, until none does (Nocedal & Wright, Numerical Optimization, 16.5). The cost
//! falls with every step, so no face comes twice.

use super::rows::CONE;
use super::wide::Square6;
use crate::real::{Mask, Real};

/// Steps after which what is left is rounding: five ways seldom need ten.
const STEPS: usize = 40;
/// A slope inwards of so many roundings of its terms is none.
const ROUNDINGS: f64 = 16.0;

pub(super) struct Square<'a, R: Real> {
    pub q: &'a Square6<R>,
    pub g: &'a [R; CONE],
    pub bound: R,
}

impl<R: Real> Square<'_, R> {
    /// The minimiser of ½ xᵀQx + g·x over |x_i| ≤ bound, looked for from x; entry 0 is not part
    /// of it.
    pub fn minimiser(&self, x: &[R; CONE], mask: R::Mask) -> [R; CONE] {
        let (zero, one, bound) = (R::zero(), R::one(), self.bound.max(R::zero()));
        let mut x: [R; CONE] = core::array::from_fn(|i| {
            let moves = R::Mask::of(i > 0).and(self.q[i][i].gt(zero));
            R::select(moves, x[i].clamp(-bound, bound), zero)
        });
        // Every way is let go at first; those that lead outwards come back at once.
        let mut held = [R::Mask::of(false); CONE];
        let mut live = mask.and(bound.gt(zero));
        for _ in 0..STEPS {
            if live.none() {
                break;
            }
            let aim = self.on_face(&x, &held);
            // How far the box allows, and which way ends there.
            let mut share = one;
            let mut stop = [one; CONE];
            for i in 1..CONE {
                let end = R::select(aim[i].lt(zero), -bound, bound);
                let over = held[i].not().and(aim[i].abs().gt(bound));
                let part = ((end - x[i]) / (aim[i] - x[i])).max(zero);
                stop[i] = R::select(over, part, R::of(2.0));
                share = share.min(stop[i]);
            }
            let whole = share.ge(one);
            for i in 1..CONE {
                let end = R::select(aim[i].lt(zero), -bound, bound);
                let ends = live.and(whole.not()).and(stop[i].le(share));
                let way = R::select(whole, aim[i], x[i] + share * (aim[i] - x[i]));
                let way = way.clamp(-bound, bound);
                let new = R::select(ends, end, way);
                x[i] = R::select(live.and(held[i].not()), new, x[i]);
                held[i] = held[i].or(ends);
            }
            // At the face's minimiser: the way that leads most inwards.
            let (mut worst, mut inwards) = (zero, [zero; CONE]);
            for i in 1..CONE {
                let (slope, terms) = self.slope(&x, i);
                let towards = R::select(x[i].lt(zero), -slope, slope);
                let real = towards.gt(R::of(ROUNDINGS * R::epsilon()) * terms);
                let per_root = self.q[i][i].recip_or_zero().sqrt();
                inwards[i] = R::select(held[i].and(real), towards * per_root, zero);
                worst = worst.max(inwards[i]);
            }
            live = live.and(whole.and(worst.le(zero)).not());
            let free = live.and(whole);
            for i in 1..CONE {
                let leaves = free.and(inwards[i].ge(worst)).and(inwards[i].gt(zero));
                held[i] = held[i].and(leaves.not());
            }
        }
        core::array::from_fn(|i| R::select(bound.gt(zero), x[i], zero))
    }

    /// (Qx + g)ᵢ, and the size of its terms.
    fn slope(&self, x: &[R; CONE], i: usize) -> (R, R) {
        let (mut sum, mut terms) = (self.g[i], self.g[i].abs());
        for j in 1..CONE {
            let part = self.q[i][j] * x[j];
            sum += part;
            terms += part.abs();
        }
        (sum, terms)
    }

    /// The minimiser with the held ways where they are; a way that nothing moves stays.
    fn on_face(&self, x: &[R; CONE], held: &[R::Mask; CONE]) -> [R; CONE] {
        let zero = R::zero();
        let mut m = *self.q;
        let mut rhs = [zero; CONE];
        for i in 1..CONE {
            rhs[i] = -self.g[i];
            for j in 1..CONE {
                let moved = rhs[i] - self.q[i][j] * x[j];
                rhs[i] = R::select(held[j], moved, rhs[i]);
            }
        }
        let mut inv = [zero; CONE];
        for k in 1..CONE {
            let own = self.q[k][k];
            let good = held[k].not().and(m[k][k].gt(R::of(64.0 * R::epsilon()) * own));
            inv[k] = R::select(good, m[k][k].recip_or_zero(), zero);
            for i in k + 1..CONE {
                let l = m[i][k] * inv[k];
                for j in k + 1..=i {
                    m[i][j] -= l * m[j][k];
                }
                rhs[i] -= l * rhs[k];
            }
        }
        let mut out = *x;
        for k in (1..CONE).rev() {
            let mut sum = rhs[k] * inv[k];
            for i in k + 1..CONE {
                let l = m[i][k] * inv[k];
                sum -= R::select(held[i], zero, l * out[i]);
            }
            out[k] = R::select(inv[k].gt(zero), sum, out[k]);
        }
        out
    }
}
