//! What a run is worth: energy, momentum, and which element made it fail.

mod blame;
mod count;
mod energy;
mod linearize;
pub mod ledger;
mod past;
mod readout;

pub use count::Counter;
pub use energy::Energy;
pub use linearize::Linearizer;
pub use ledger::Ledger;
pub(crate) use past::Past;
pub use readout::Coupling;
