//! Sine, cosine, arctangent, exponential, logarithm and power, the same bits everywhere.
//!
//! The functions of C libraries differ between versions and processors, and no compiler vectorises
//! them. These are sums, products, quotients and selections of `f64` alone, without fused products
//! or tables: a compiler vectorises loops over them, and a lane equals a scalar bit for bit. Each
//! is within 1 ulp, `exp_m1` within 3 (`tests.rs`, against numbers of 400 bits). Arguments that no
//! step has (angles beyond 2²⁰ quarter turns, powers of 0 or ∞) are computed separately, one by
//! one. In `f32` they are the results of `f64`, rounded.

mod arctan;
mod exponential;
mod lanes;
mod reduce;
#[cfg(test)]
mod tests;
mod trig;

pub use arctan::atan2;
pub use exponential::{exp, exp_m1, ln, pow};
pub use lanes::{atan2_each, pow_each, sin_cos_each};
pub use trig::{near_of, sin_cos};

/// 1.5 · 2⁵²: added to a number below 2⁵¹ it rounds it to an integer, whose last bits are then the
/// last of the sum.
const INTEGER: f64 = 6_755_399_441_055_744.0;
