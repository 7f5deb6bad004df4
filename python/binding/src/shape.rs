//! Shapes.

use crate::convert::{MeshArrays, vector_out};
use crate::run;
use numpy::PyArray1;
use pyo3::prelude::*;

/// Area of each triangle.
#[pyfunction]
pub fn face_areas<'py>(py: Python<'py>, mesh: MeshArrays<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let mesh = mesh.mesh()?;
    let areas = run::brief(py, || Ok(mesh.face_areas()))?;
    Ok(vector_out(py, areas))
}
