//! The watchers: energy, the ledger, post-mortems, linearisation and counts, around a `Sim`.
//!
//! A [`Watched`] is a `Sim` with its recent past, a ledger if the settings request one, and an
//! explanation of every failure. `Bodies` and `BodyForces` hold MuJoCo's quantities of bodies, rays
//! find the geoms they meet, and a [`LastSolve`] holds the last solve for reading. A [`Linearizer`]
//! and a [`Counter`] step a copy in other numbers.

mod actuators;
mod bodies;
mod body_forces;
mod corners;
mod count;
mod element_slopes;
mod energy;
mod inverse;
mod last_solve;
mod ledger;
mod linearize;
mod linearizers;
mod past;
mod post_mortem;
mod rays;
mod readout;
mod tape;
mod tendon_path;
mod tendons;
mod watched;

use crate::error::{Error, Result};

pub use bodies::Bodies;
pub use body_forces::BodyForces;
pub use count::Counter;
pub use element_slopes::{Acts, ElementSlopes};
pub use energy::Energy;
pub use last_solve::LastSolve;
pub(crate) use ledger::{Care, Ledger};
pub use linearize::{Around, Asked, Linearizer, Neighbourhood};
pub use linearizers::Linearizers;
pub(crate) use past::Past;
pub use past::WorldPast;
pub use rays::{first_hit, RayFilter};
pub use readout::Coupling;
pub use tape::StepGains;
pub use tendon_path::{tendon_path, Way};
pub use watched::Watched;

/// A matrix of zeros, whose size depends on a model; refuses one that does not fit in memory.
fn zeros(what: &str, rows: usize, columns: usize) -> Result<Vec<f64>> {
    let mut all = Vec::new();
    match rows.checked_mul(columns) {
        Some(count) if all.try_reserve_exact(count).is_ok() => {
            all.resize(count, 0.0);
            Ok(all)
        }
        _ => {
            let limit = "a matrix that the memory can hold";
            Err(Error::value(what, format!("{rows} × {columns} numbers"), limit))
        }
    }
}
