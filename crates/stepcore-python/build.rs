//! Lets the code ask for which Python it is built: `cfg!(Py_GIL_DISABLED)`.

fn main() {
    pyo3_build_config::use_pyo3_cfgs();
}
