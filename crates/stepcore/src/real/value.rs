//! Several numbers of a model, as steps of a `Real` read them.

use super::{Constant, Real, Value};
use nalgebra::Matrix3;

/// Returns several values as `Real`.
pub(crate) fn get<R: Real, V: Value<R>, const N: usize>(values: &[V; N]) -> [R; N] {
    crate::real::array::from_fn(|k| values[k].get())
}

/// Returns a matrix of values as `Real`.
#[inline(always)]
pub(crate) fn matrix<R: Real, V: Value<R>>(m: &Matrix3<V>) -> Matrix3<R> {
    Matrix3::from_fn(|i, k| m[(i, k)].get())
}

/// Returns whether all of them are zero.
#[inline(always)]
pub(crate) fn none<V: Constant, const N: usize>(v: &[V; N]) -> bool {
    v.iter().all(Constant::vanishes)
}
