//! The watchers: energy, the ledger, post-mortems, linearisation and counts, around a `Sim`.
//!
//! A [`Watched`] is a `Sim` with its recent past, a ledger if the settings ask for one, and an
//! explanation of every failure. A [`Linearizer`] and a [`Counter`] step a copy in other numbers.

mod count;
mod energy;
mod ledger;
mod linearize;
mod past;
mod post_mortem;
mod readout;
mod tape;
mod tendons;
mod watched;

pub use count::Counter;
pub use energy::Energy;
pub(crate) use ledger::{Care, Ledger};
pub use linearize::Linearizer;
pub use readout::Coupling;
pub use tape::StepGains;
pub use watched::Watched;
