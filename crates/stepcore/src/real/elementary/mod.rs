//! Sine, cosine, arctangent, exponential, logarithm and power, the same bits everywhere.
//!
//! A C library's own are not the same in all versions and on all processors, and no compiler
//! makes lanes of them. These are sums, products, quotients and choices of `f64` alone, without
//! fused products or tables: a compiler makes lanes of a loop over them, and a lane is a scalar
//! bit for bit. Each is within 1 ulp, `exp_m1` within 3 (`tests.rs`, against numbers of 400 bits).
//! Arguments that no step has (angles beyond 2²⁰ quarter turns, powers of 0 or ∞) go an own
//! way, one by one. In `f32` they are those of `f64`, rounded.

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

/// 1.5 · 2⁵²: added to a number below 2⁵¹ it rounds it to a whole one, whose last bits are
/// then the last of the sum.
const INTEGER: f64 = 6_755_399_441_055_744.0;
