//! How many threads the core uses.

use crate::error;
use pyo3::prelude::*;

/// Number of threads.
#[pyfunction]
pub fn num_threads(py: Python<'_>) -> PyResult<usize> {
    beltrami::threads::num_threads().map_err(|e| error::convert(py, e))
}

/// Sets the number of threads.
#[pyfunction]
pub fn set_num_threads(py: Python<'_>, count: usize) -> PyResult<()> {
    beltrami::threads::set_num_threads(count).map_err(|e| error::convert(py, e))
}
