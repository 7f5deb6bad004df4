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

/// Checks a mesh: finite coordinates, faces in range.
#[pyfunction]
pub fn check_mesh(mesh: MeshArrays<'_>) -> PyResult<()> {
    mesh.mesh().map(|_| ())
}
