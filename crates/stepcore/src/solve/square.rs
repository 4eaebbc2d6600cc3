//! A small quadratic over a box: the friction ways of a pyramid.
//!
//! Two ways have a closed form; more use active sets: from a point of the box to the minimiser of
//! its face, or as far as the box allows, where one more way is held. At a face's minimiser the way
//! with the slope most inwards is released, until none points inwards (Nocedal & Wright, Numerical
//! Optimization, 16.5). The cost falls with every step, so no face is visited twice.

use super::cone::Matrix;
use crate::real::array::from_fn;
use crate::real::{Mask, Real};

/// After this many steps only rounding remains: five ways seldom need ten.
const STEPS: usize = 40;
/// An inward slope of at most this many roundings of its terms counts as zero.
const ROUNDINGS: f64 = 16.0;

#[derive(Clone, Copy, Debug)]
pub(super) struct Square<R: Real, const N: usize> {
    pub q: Matrix<R, N>,
    /// For two ways: the inverses of q₁₁, q₂₂, and of q₁₁ with x₂ minimised out.
    inv: [R; 3],
}

impl<R: Real, const N: usize> Square<R, N> {
    /// Prepares a positive semi-definite Q.
    pub fn new(q: Matrix<R, N>) -> Self {
        let (i1, i2) = (q[0][0].recip_or_zero(), q[1][1].recip_or_zero());
        let schur = q[0][0] - q[1][0] * q[1][0] * i2;
        let moves = schur.gt(R::of(4.0 * R::epsilon()) * q[0][0]);
        let schur = R::select(moves, schur, R::zero());
        Self { q, inv: [i1, i2, schur.recip_or_zero()] }
    }

    /// Returns the minimiser of ½ xᵀQx + g·x over |x_i| ≤ bound, searched from x.
    pub fn least(&self, g: &[R; N], bound: R, x: &[R; N], mask: R::Mask) -> [R; N] {
        if N == 2 {
            let both = self.of_two(g, bound);
            return from_fn(|i| both[i]);
        }
        self.by_active_sets(g, bound, x, mask)
    }

    /// With x₂ optimal for a given x₁ the cost is convex in x₁ with three quadratic pieces (x₂
    /// free, at one bound, at the other); x₂ at the root of the free piece shows which piece holds
    /// the minimum.
    #[inline(always)]
    fn of_two(&self, g: &[R; N], bound: R) -> [R; 2] {
        let (q12, [i1, i2, inv]) = (self.q[1][0], self.inv);
        let second = |x1: R| -(g[1] + q12 * x1) * i2;
        let free = -(g[0] - q12 * g[1] * i2) * inv;
        let x2 = second(free);
        let held = -(g[0] + q12 * x2.clamp(-bound, bound)) * i1;
        let x1 = R::select(x2.abs().le(bound), free, held).clamp(-bound, bound);
        [x1, second(x1).clamp(-bound, bound)]
    }

    fn by_active_sets(&self, g: &[R; N], bound: R, x: &[R; N], mask: R::Mask) -> [R; N] {
        let (zero, one, bound) = (R::zero(), R::one(), bound.max(R::zero()));
        let mut x: [R; N] =
            from_fn(|i| R::select(self.q[i][i].gt(zero), x[i].clamp(-bound, bound), zero));
        // Every way is released at first; ways that lead outwards are held again at once.
        let mut held = [R::Mask::of(false); N];
        let mut todo = mask.and(bound.gt(zero));
        for _ in 0..STEPS {
            if todo.none() {
                break;
            }
            let aim = self.on_face(g, &x, &held);
            // The largest step within the box, and the way that ends it.
            let mut share = one;
            let mut stop = [one; N];
            for i in 0..N {
                let end = R::select(aim[i].lt(zero), -bound, bound);
                let over = held[i].not().and(aim[i].abs().gt(bound));
                let part = ((end - x[i]) / (aim[i] - x[i])).max(zero);
                stop[i] = R::select(over, part, R::of(2.0));
                share = share.min(stop[i]);
            }
            let whole = share.ge(one);
            for i in 0..N {
                let end = R::select(aim[i].lt(zero), -bound, bound);
                let ends = todo.and(whole.not()).and(stop[i].le(share));
                let way = R::select(whole, aim[i], x[i] + share * (aim[i] - x[i]));
                let way = way.clamp(-bound, bound);
                let new = R::select(ends, end, way);
                x[i] = R::select(todo.and(held[i].not()), new, x[i]);
                held[i] = held[i].or(ends);
            }
            // At the face's minimiser: the way with the slope most inwards.
            let (mut worst, mut inwards) = (zero, [zero; N]);
            for i in 0..N {
                let (slope, terms) = self.slope(g, &x, i);
                let towards = R::select(x[i].lt(zero), -slope, slope);
                let real = towards.gt(R::of(ROUNDINGS * R::epsilon()) * terms);
                let per_root = self.q[i][i].recip_or_zero().sqrt();
                inwards[i] = R::select(held[i].and(real), towards * per_root, zero);
                worst = worst.max(inwards[i]);
            }
            todo = todo.and(whole.and(worst.le(zero)).not());
            let free = todo.and(whole);
            for i in 0..N {
                let leaves = free.and(inwards[i].ge(worst)).and(inwards[i].gt(zero));
                held[i] = held[i].and(leaves.not());
            }
        }
        from_fn(|i| R::select(bound.gt(zero), x[i], zero))
    }

    /// Returns (Qx + g)ᵢ, and the size of its terms.
    fn slope(&self, g: &[R; N], x: &[R; N], i: usize) -> (R, R) {
        let (mut sum, mut terms) = (g[i], g[i].abs());
        for j in 0..N {
            let part = self.q[i][j] * x[j];
            sum += part;
            terms += part.abs();
        }
        (sum, terms)
    }

    /// Returns the minimiser with the held ways fixed; a way that nothing moves stays.
    fn on_face(&self, g: &[R; N], x: &[R; N], held: &[R::Mask; N]) -> [R; N] {
        let zero = R::zero();
        let mut m = self.q;
        let mut rhs = [zero; N];
        for i in 0..N {
            rhs[i] = -g[i];
            for j in 0..N {
                let moved = rhs[i] - self.q[i][j] * x[j];
                rhs[i] = R::select(held[j], moved, rhs[i]);
            }
        }
        let mut inv = [zero; N];
        for k in 0..N {
            let own = self.q[k][k];
            let good = held[k].not().and(m[k][k].gt(R::of(64.0 * R::epsilon()) * own));
            inv[k] = R::select(good, m[k][k].recip_or_zero(), zero);
            for i in k + 1..N {
                let l = m[i][k] * inv[k];
                for j in k + 1..=i {
                    m[i][j] -= l * m[j][k];
                }
                rhs[i] -= l * rhs[k];
            }
        }
        let mut out = *x;
        for k in (0..N).rev() {
            let mut sum = rhs[k] * inv[k];
            for i in k + 1..N {
                let l = m[i][k] * inv[k];
                sum -= R::select(held[i], zero, l * out[i]);
            }
            out[k] = R::select(inv[k].gt(zero), sum, out[k]);
        }
        out
    }
}
