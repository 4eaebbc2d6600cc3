//! Softness of elements that act by rows.

/// A spring-damper pair and an impedance curve: MuJoCo's `solref`, `solimp`.
/// MuJoCo documentation, "Solver parameters".
#[derive(Clone, Debug, PartialEq)]
pub struct Softness<N = f64> {
    /// Time constant [s] and damping ratio, both > 0; or −stiffness and −damping, both ≤ 0.
    pub solref: [N; 2],
    /// d0, dwidth, width [m or rad], midpoint, power.
    pub solimp: [N; 5],
}

impl Default for Softness {
    fn default() -> Self {
        Self { solref: [0.02, 1.0], solimp: [0.9, 0.95, 0.001, 0.5, 2.0] }
    }
}
