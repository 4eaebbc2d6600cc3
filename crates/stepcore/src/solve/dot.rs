//! y·u: the velocity along a row, in factored coordinates.

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
