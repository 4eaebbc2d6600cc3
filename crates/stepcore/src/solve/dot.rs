//! y·u: how fast a row moves, in factored coordinates.

use crate::real::Real;

/// y·u over a row's dofs.
#[inline(always)]
pub(super) fn dot<R: Real>(dofs: &[usize], y: &[R], u: &[R]) -> R {
    let mut sum = R::zero();
    for (k, y) in dofs.iter().zip(y) {
        sum += *y * u[*k];
    }
    sum
}

/// y·x of N rows on the same dofs, whose y stand one after another.
#[inline(always)]
pub(super) fn dots<R: Real, const N: usize>(list: &[usize], y: &[R], x: &[R]) -> [R; N] {
    let len = list.len();
    let y = &y[..N * len];
    let mut sums = [R::zero(); N];
    for (at, k) in list.iter().enumerate() {
        let x = x[*k];
        for i in 0..N {
            sums[i] += y[i * len + at] * x;
        }
    }
    sums
}
