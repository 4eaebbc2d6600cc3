//! Friction cones: projections onto them.
//!
//! Vectors are (normal, ways of friction): two tangents, or up to five ways with torsion and
//! rolling, each in the measure that makes its bound that of the first (`elements/friction.rs`).
//! A block with fewer is padded with zeros, which every function here leaves at zero.

use super::rows::{CONE, NARROW};
use crate::real::Real;

/// The nearest point of the round cone |x_t| ≤ μ x_n.
pub fn project_round<R: Real, const N: usize>(mu: R, x: [R; N]) -> [R; N] {
    let a = across(&x);
    let inside = a.le(mu * x[0]);
    let n = ((x[0] + mu * a) / (R::one() + mu * mu)).max(R::zero());
    let k = mu * n * a.recip_or_zero();
    core::array::from_fn(|i| R::select(inside, x[i], if i == 0 { n } else { k * x[i] }))
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

/// The same with more than two ways: n is the largest of the roots with the m largest ways at
/// their bound, (x_n + μ Σ |x_i|)/(1 + m μ²), because what they are roots of is concave in m.
pub fn project_box_wide<R: Real, const N: usize>(mu: R, x: [R; N]) -> [R; N] {
    let mut size: [R; N] = x.map(R::abs);
    // The largest first, by exchanges.
    for end in (2..N).rev() {
        for i in 1..end {
            (size[i], size[i + 1]) = (size[i].max(size[i + 1]), size[i].min(size[i + 1]));
        }
    }
    let (mut n, mut sum, mut count) = (x[0], x[0], R::one());
    for size in &size[1..] {
        sum += mu * *size;
        count += mu * mu;
        n = R::select(size.gt(mu * n), sum / count, n);
    }
    let n = n.max(R::zero());
    let bound = mu * n;
    core::array::from_fn(|i| if i == 0 { n } else { x[i].clamp(-bound, bound) })
}

/// The nearest point of the round cone, of vectors with `len` entries.
#[inline(always)]
pub(super) fn project_some<R: Real>(mu: R, x: [R; CONE], len: usize) -> [R; CONE] {
    if len > NARROW {
        return project_round(mu, x);
    }
    let near = project_round::<R, NARROW>(mu, core::array::from_fn(|i| x[i]));
    core::array::from_fn(|i| if i < NARROW { near[i] } else { x[i] })
}

/// |x_t|.
pub(super) fn across<R: Real, const N: usize>(x: &[R; N]) -> R {
    let mut sum = x[1] * x[1];
    for x in &x[2..] {
        sum += *x * *x;
    }
    sum.sqrt()
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
