//! Operators of meshes.

use crate::convert::{CsrArrays, CsrParts, MeshArrays, matrix_out, vector, vector_out};
use crate::run;
use beltrami::operators;
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;

/// Cotangent stiffness, mass (lumped, or mixed Voronoi areas) and mean edge length.
#[pyfunction]
pub fn cotangent_operators<'py>(
    py: Python<'py>,
    mesh: MeshArrays<'py>,
    voronoi: bool,
) -> PyResult<(CsrParts<'py>, Bound<'py, PyArray1<f64>>, f64)> {
    let mesh = mesh.mesh()?;
    let found = run::watched(py, None, |_| {
        let mut found = operators::cotangent_operators(&mesh)?;
        if voronoi {
            found.mass = operators::voronoi_mass(&mesh)?;
        }
        Ok(found)
    })?;
    Ok((matrix_out(py, found.stiffness), vector_out(py, found.mass), found.spacing))
}

/// The gradient, (m D, n).
#[pyfunction]
pub fn gradient<'py>(py: Python<'py>, mesh: MeshArrays<'py>) -> PyResult<CsrParts<'py>> {
    let mesh = mesh.mesh()?;
    let found = run::watched(py, None, |_| operators::gradient(&mesh))?;
    Ok(matrix_out(py, found))
}

/// The divergence, (n, m D).
#[pyfunction]
pub fn divergence<'py>(py: Python<'py>, mesh: MeshArrays<'py>, mass: PyReadonlyArray1<'py, f64>) -> PyResult<CsrParts<'py>> {
    let (mesh, mass) = (mesh.mesh()?, vector(&mass)?);
    let found = run::watched(py, None, |_| operators::divergence(&mesh, mass))?;
    Ok(matrix_out(py, found))
}

/// The consistent mass matrix, (n, n).
#[pyfunction]
pub fn galerkin_mass<'py>(py: Python<'py>, mesh: MeshArrays<'py>) -> PyResult<CsrParts<'py>> {
    let mesh = mesh.mesh()?;
    let found = run::watched(py, None, |_| operators::galerkin_mass(&mesh))?;
    Ok(matrix_out(py, found))
}

/// True if an edge of a stiffness matrix has a positive weight.
#[pyfunction]
pub fn has_positive_weights(py: Python<'_>, stiffness: CsrArrays<'_>) -> PyResult<bool> {
    let stiffness = stiffness.matrix()?;
    run::brief(py, || Ok(operators::has_positive_weights(&stiffness)))
}
