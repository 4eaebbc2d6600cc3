//! The step of each integrator where the motion is linear, M dv' = −K dq − D dv, or x' = J x of
//! x = [dq, dv]. With h = dt, D̂ and K̂ what the integrator takes at the end of the step:
//!
//! ```text
//! Map::Taylor   x⁺ = (1 + z + z²/2 + …) x, z = h J
//! Map::Cayley   x⁺ = (1 − z/2)⁻¹ (1 + z/2) x
//! Map::Split    v⁺ = v + h (M + h D̂ + h² K̂)⁻¹ (M J_v x − h K̂ v), then q⁺ = q + h (J_qq q + J_qv v⁺)
//! ```
//!
//! Source: Hairer and Wanner, Solving Ordinary Differential Equations II, chapter IV.

use nalgebra::Complex;
pub use nalgebra::DMatrix;

use super::{Integrator, Map};

/// A linear motion of n dofs, and what of it may be taken at the end of a step.
pub struct Linear<'a> {
    /// J, 2n by 2n [1/s].
    pub rates: &'a DMatrix<f64>,
    pub mass: &'a DMatrix<f64>,
    /// D̂ and K̂, which only integrators that take them look at.
    pub damping: &'a DMatrix<f64>,
    pub stiffness: &'a DMatrix<f64>,
    /// The part of J, n by 2n, whose accelerations `Map::Cayley` adds to the velocities after its
    /// step, and by half to what moves positions: rows of `solref`.
    pub after: Option<&'a DMatrix<f64>>,
    /// Accelerations that last through the step, n by the columns of x.
    pub push: Option<&'a DMatrix<f64>>,
}

impl Linear<'_> {
    /// x⁺ of every column of x; None where a matrix is singular.
    pub fn step(&self, integrator: Integrator, dt: f64, x: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        match integrator.scheme().map {
            Map::Taylor(order) => {
                let powers = (1..=order).rev();
                Some(powers.fold(x.clone(), |y, k| x + self.rate(&y) * (dt / f64::from(k))))
            }
            Map::Cayley => self.cayley(dt, x),
            Map::Split => self.split(integrator, dt, x),
        }
    }

    /// x' = J x, with the push.
    fn rate(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut rate = self.rates * x;
        if let Some(push) = self.push {
            let mut last = rate.rows_mut(self.mass.nrows(), self.mass.nrows());
            last += push;
        }
        rate
    }

    fn cayley(&self, dt: f64, x: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let n = self.mass.nrows();
        let (half, mut within) = (0.5 * dt, self.rates.clone());
        let mut made = x + self.rate(x) * half;
        if let Some(push) = self.push {
            let mut last = made.rows_mut(n, n);
            last += push * half;
        }
        if let Some(after) = self.after {
            let mut last = within.rows_mut(n, n);
            last -= after;
            let mut last = made.rows_mut(n, n);
            last -= after * x * half;
        }
        let left = DMatrix::identity(2 * n, 2 * n) - within * half;
        let mut made = left.lu().solve(&made)?;
        if let Some(after) = self.after {
            let kick = after * x * dt;
            let mut moved = made.rows_mut(0, n);
            moved += &kick * half;
            let mut last = made.rows_mut(n, n);
            last += kick;
        }
        Some(made)
    }

    fn split(&self, integrator: Integrator, dt: f64, x: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let (n, scheme) = (self.mass.nrows(), integrator.scheme());
        let (q, v) = (x.rows(0, n), x.rows(n, n));
        let mut matrix = self.mass.clone();
        let mut force = self.mass * self.rate(x).rows(n, n);
        if scheme.damping.is_some() {
            matrix += self.damping * dt;
        }
        if scheme.stiffness {
            matrix += self.stiffness * (dt * dt);
            force -= self.stiffness * v * dt;
        }
        let last = matrix.lu().solve(&force)? * dt + v;
        let mut made = x.clone();
        made.rows_mut(n, n).copy_from(&last);
        let moved = self.rates.rows(0, n) * &made * dt + q;
        made.rows_mut(0, n).copy_from(&moved);
        Some(made)
    }
}

impl Map {
    /// The factor of one step on a mode of rate s, z = dt s: the eigenvalues of a map that is a function
    /// of dt J. `Split` is none.
    pub fn factor(self, z: Complex<f64>) -> Option<Complex<f64>> {
        let one = Complex::new(1.0, 0.0);
        match self {
            Self::Taylor(order) => {
                Some((1..=order).rev().fold(one, |sum, k| one + z * sum / f64::from(k)))
            }
            Self::Cayley => Some((one + z * 0.5) / (one - z * 0.5)),
            Self::Split => None,
        }
    }
}
