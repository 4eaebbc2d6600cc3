//! Friction cones: projections onto them.
//!
//! Vectors are (normal, tangent, tangent). A block with fewer tangents is padded
//! with zeros, which every function here leaves at zero.

use crate::real::Real;

/// The nearest point of the round cone |x_t| ≤ μ x_n.
pub fn project_round<R: Real>(mu: R, x: [R; 3]) -> [R; 3] {
    let a = norm(x[1], x[2]);
    let inside = a.le(mu * x[0]);
    let n = ((x[0] + mu * a) / (R::one() + mu * mu)).max(R::zero());
    let k = mu * n * a.recip_or_zero();
    select3(inside, x, [n, k * x[1], k * x[2]])
}

/// The nearest point of the box cone |x_i| ≤ μ x_n.
///
/// n is the root of the increasing n − x_n − μ Σ (|x_i| − μ n)₊: with no, one or
/// two tangents at their bound.
pub fn project_box<R: Real>(mu: R, x: [R; 3]) -> [R; 3] {
    let (a, b) = (x[1].abs(), x[2].abs());
    let (large, small) = (a.max(b), a.min(b));
    let k = mu * mu;
    let one = (x[0] + mu * large) / (R::one() + k);
    let two = (x[0] + mu * (a + b)) / (R::one() + k + k);
    let n = R::select(large.le(mu * x[0]), x[0], R::select(small.le(mu * one), one, two));
    let n = n.max(R::zero());
    let bound = mu * n;
    [n, x[1].clamp(-bound, bound), x[2].clamp(-bound, bound)]
}

pub(super) fn norm<R: Real>(a: R, b: R) -> R {
    (a * a + b * b).sqrt()
}

pub(super) fn select2<R: Real>(mask: R::Mask, yes: [R; 2], no: [R; 2]) -> [R; 2] {
    core::array::from_fn(|i| R::select(mask, yes[i], no[i]))
}

pub(super) fn select3<R: Real>(mask: R::Mask, yes: [R; 3], no: [R; 3]) -> [R; 3] {
    core::array::from_fn(|i| R::select(mask, yes[i], no[i]))
}
