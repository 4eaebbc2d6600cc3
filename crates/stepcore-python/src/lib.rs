//! `stepcore._core`: the engine's Python interface. Thin shims; no physics here.
//!
//! `extract` and `scene` read values from Python, `memory` holds the arrays that both sides see,
//! `arguments` and `tables` are the arguments and results of methods, `world` is one world of
//! either precision and `worlds` many, `snapshot` a state as bytes, `gil` the one place where the
//! GIL is released, `errors` the one map of errors, `readout` the one table of quantities that are
//! read by name.

mod arguments;
mod auto;
mod batch;
mod element;
mod errors;
mod extract;
mod gil;
mod integrators;
mod linearizers;
mod memo;
#[allow(unsafe_code)]
mod memory;
mod model;
mod motion;
mod nearest;
mod noise;
mod readings;
mod readout;
mod scene;
// For the code that pyo3 generates in it.
#[allow(unsafe_op_in_unsafe_fn)]
mod settings;
mod sim;
mod snapshot;
mod tables;
mod world;
mod worlds;

use pyo3::prelude::*;

// Objects lock their data (`gil::lock`, `memory`): no GIL is needed.
#[pymodule(gil_used = false)]
mod _core {
    use pyo3::prelude::*;

    /// The vector instructions that this module was compiled for.
    #[pymodule_export]
    const VECTORS: &str = if cfg!(target_feature = "avx2") {
        "avx2"
    } else if cfg!(target_feature = "sse2") {
        "sse2"
    } else if cfg!(target_feature = "neon") {
        "neon"
    } else {
        "none"
    };
    #[pymodule_export]
    use super::batch::Batch;
    #[pymodule_export]
    use super::errors::{EnergyWarning, SimulationError};
    #[pymodule_export]
    use super::gil::end_threads;
    #[pymodule_export]
    use super::integrators::{integrators, linear_step};
    #[pymodule_export]
    use super::linearizers::Linearizers;
    #[pymodule_export]
    use super::model::{compile, empty_caches, Model};
    #[pymodule_export]
    use super::noise::{noise, quantile};
    #[pymodule_export]
    use super::settings::Settings;
    #[pymodule_export]
    use super::sim::Sim;

    /// Threads that step when the program ends do not abort it.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        let end_threads = module.getattr("end_threads")?;
        module.py().import("atexit")?.call_method1("register", (end_threads,))?;
        Ok(())
    }
}
