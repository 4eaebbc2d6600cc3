//! What a run is worth: energy, momentum, and which element made it fail.

mod blame;
mod energy;
mod past;
mod readout;

pub use energy::Energy;
pub(crate) use past::Past;
