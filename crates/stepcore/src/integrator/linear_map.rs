//! The step of each integrator where the motion is linear, M dv' = −K dq − D dv, or x' = J x of
//! x = [dq, dv]. With h = dt, D̂ and K̂ its implicit parts at the end of the step:
//!
//! ```text
//! Map::Taylor   x⁺ = (1 + z + z²/2 + …) x, z = h J
//! Map::Cayley   x⁺ = (1 − z/2)⁻¹ (1 + z/2) x
//! Map::Split    v⁺ = v + h (M + h D̂ + h² K̂)⁻¹ (M J_v x − h K̂ v), then q⁺ = q + h (J_qq q + J_qv v⁺)
//! ```
//!
//! Source: Hairer and Wanner, Solving Ordinary Differential Equations II, chapter IV.

pub use nalgebra::DMatrix;

use super::{Integrator, Map};

/// A linear motion of n dofs, and the parts that may be taken at the end of a step.
pub struct Linear<'a> {
    /// J, 2n by 2n [1/s].
    pub rates: &'a DMatrix<f64>,
    pub mass: &'a DMatrix<f64>,
    /// D̂ and K̂, which only some integrators use.
    pub damping: &'a DMatrix<f64>,
    pub stiffness: &'a DMatrix<f64>,
}

impl Linear<'_> {
    /// x⁺ for every column of x; None if a matrix is singular.
    pub fn step(&self, integrator: Integrator, dt: f64, x: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        match integrator.scheme().map {
            Map::Taylor(order) => {
                let powers = (1..=order).rev();
                Some(powers.fold(x.clone(), |y, k| x + self.rates * y * (dt / f64::from(k))))
            }
            Map::Cayley => self.cayley(dt, x),
            Map::Split => self.split(integrator, dt, x),
        }
    }

    fn cayley(&self, dt: f64, x: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let half = self.rates * (0.5 * dt);
        let one = DMatrix::identity(half.nrows(), half.nrows());
        (&one - &half).lu().solve(&((&one + half) * x))
    }

    fn split(&self, integrator: Integrator, dt: f64, x: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let (n, scheme) = (self.mass.nrows(), integrator.scheme());
        let (q, v) = (x.rows(0, n), x.rows(n, n));
        let mut matrix = self.mass.clone();
        let mut force = self.mass * (self.rates * x).rows(n, n);
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
