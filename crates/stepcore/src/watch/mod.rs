//! The watchers: energy, the ledger, post-mortems, linearisation and counts, around a `Sim`.

mod blame;
mod count;
mod energy;
pub mod ledger;
mod linearize;
mod past;
mod readout;

pub use count::Counter;
pub use energy::Energy;
pub use ledger::Ledger;
pub use linearize::Linearizer;
pub(crate) use past::Past;
pub use readout::Coupling;
