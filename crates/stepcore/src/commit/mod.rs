//! Stage 4, commit: velocities and positions after the step.
//!
//! Integrators that run the first three stages once read the solved u⁺ and commit in
//! `integrate.rs`; `rk4` and `midpoint` run them several times and have separate files. Everything
//! is written to `Next` first: a state that is not finite is never committed.

mod damped;
mod end_of_step_rows;
mod extrapolation;
mod implicit;
mod integrate;
mod midpoint;
mod next;
mod position;
mod rk4;
mod stage_constraints;
mod within;

pub(crate) use extrapolation::Extrapolation;
pub use next::Next;
pub use position::advance;
