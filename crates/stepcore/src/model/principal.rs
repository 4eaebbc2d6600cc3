//! The principal axes of a symmetric matrix as a rotation from the matrix's axes.

use crate::spatial::{rotation, unit_quat};
use nalgebra::{Matrix3, Vector3};

/// Relative to the trace: below this an element is rounding, and two moments are equal.
const ROUNDING: f64 = 1e-12;
/// Rotations after which the iteration ends in any case; three or four sweeps of three are enough.
const MOST: usize = 500;

/// The principal axes of a body's inertia.
#[derive(Clone, Copy, Debug)]
pub enum Axes {
    /// Existing axes: of the only geom, as given, or of the inertia before a rule changed it.
    Own([f64; 4]),
    /// Axes to compute from the matrix.
    Found,
}

impl Axes {
    /// w x y z, in body axes.
    pub fn of(self, inertia: &Matrix3<f64>) -> [f64; 4] {
        match self {
            Self::Own(quat) => quat,
            Self::Found => axes(inertia),
        }
    }
}

/// Orientation (w x y z) of the principal axes, the greatest moment first: Jacobi's iteration
/// (Golub and Van Loan, Matrix Computations, section 8.5), largest element first, on a quaternion,
/// which keeps the axes a rotation and near the matrix's axes.
pub fn axes(matrix: &Matrix3<f64>) -> [f64; 4] {
    let scale = matrix.trace().abs();
    let mut quat = [1.0, 0.0, 0.0, 0.0];
    let mut own = *matrix;
    for _ in 0..MOST {
        own = seen_from(quat, matrix);
        let size = |(i, j): (usize, usize)| own[(i, j)].abs();
        let (xy, xz, yz) = (size((0, 1)), size((0, 2)), size((1, 2)));
        // Rows i and j, and the axis k that the rotation leaves unchanged.
        let (i, j, k) = if xy > xz && xy > yz {
            (0, 1, 2)
        } else if xz > yz {
            (0, 2, 1)
        } else {
            (1, 2, 0)
        };
        if size((i, j)) <= ROUNDING * scale {
            break;
        }
        // tan of the angle: the smaller root of t² + 2τt − 1 = 0.
        let tau = (own[(j, j)] - own[(i, i)]) / (2.0 * own[(i, j)]);
        let root = 1.0 / (tau.abs() + (1.0 + tau * tau).sqrt());
        let cos = 1.0 / (1.0 + root * root).sqrt();
        // sin of half the angle; 1 − cos would lose the digits of a small one.
        let half = root * cos / (2.0 * (0.5 + 0.5 * cos).sqrt());
        // A positive turn about y takes z to x, not x to z.
        let positive = (tau < 0.0) != (k == 1);
        let mut turn = [(1.0 - half * half).sqrt(), 0.0, 0.0, 0.0];
        turn[k + 1] = if positive { half } else { -half };
        quat = unit_quat(product(quat, turn));
    }
    in_falling_order(quat, own.diagonal(), scale)
}

/// Quarter turns that bring the greatest moment to x and the least to z.
fn in_falling_order(mut quat: [f64; 4], mut moments: Vector3<f64>, scale: f64) -> [f64; 4] {
    for first in [0, 1, 0] {
        if moments[first] + ROUNDING * scale < moments[first + 1] {
            moments.swap_rows(first, first + 1);
            let mut turn = [0.5_f64.sqrt(), 0.0, 0.0, 0.0];
            turn[(first + 2) % 3 + 1] = turn[0];
            quat = unit_quat(product(quat, turn));
        }
    }
    quat
}

/// A matrix expressed in a rotated frame, symmetric to the last bit.
pub fn seen_from(quat: [f64; 4], matrix: &Matrix3<f64>) -> Matrix3<f64> {
    let rot = rotation(quat);
    let mut own = rot.transpose() * matrix * rot;
    for (i, j) in [(0, 1), (0, 2), (1, 2)] {
        own[(j, i)] = own[(i, j)];
    }
    own
}

/// The quaternion product: rotation b, then a.
pub fn product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_principal_and_in_falling_order() {
        for seed in 0..200 {
            let wave = |k: usize| ((seed * 7 + k) as f64 * 1.7).sin();
            let half =
                Matrix3::from_fn(|i, j| wave(3 * i + j) * 0.1_f64.powi((i * seed % 4) as i32));
            let matrix = half * half.transpose();
            let own = seen_from(axes(&matrix), &matrix);
            let trace = matrix.trace();
            for (i, j) in [(0, 1), (0, 2), (1, 2)] {
                assert!(own[(i, j)].abs() < 2e-12 * trace);
            }
            assert!(own[(0, 0)] >= own[(1, 1)] - 1e-11 * trace);
            assert!(own[(1, 1)] >= own[(2, 2)] - 1e-11 * trace);
        }
    }

    #[test]
    fn axes_of_a_diagonal_in_falling_order_are_its_own() {
        let matrix = Matrix3::from_diagonal(&Vector3::new(3.0, 2.0, 1.0));
        assert_eq!(axes(&matrix), [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(axes(&Matrix3::identity()), [1.0, 0.0, 0.0, 0.0]);
    }
}
