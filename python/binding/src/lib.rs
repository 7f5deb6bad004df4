//! Binding of beltrami for Python: one export list. Each function converts, releases the GIL, calls the core, wraps.

mod convert;
mod error;
mod near;
mod run;
mod shape;
mod threads;

use pyo3::prelude::*;

#[pymodule]
mod _core {
    #[pymodule_export]
    use super::near::{nearest_neighbors, neighbors_within};
    #[pymodule_export]
    use super::shape::{check_mesh, face_areas};
    #[pymodule_export]
    use super::threads::{num_threads, set_num_threads};
}
