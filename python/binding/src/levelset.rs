//! Contours of functions on meshes.

use crate::convert::{MeshArrays, table_out, vector, vector_out};
use crate::run;
use beltrami::levelset;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1};
use pyo3::prelude::*;

type ContourArrays<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<i32>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<bool>>,
);

/// Points (p, D), edges (p, 2), shares (p,), starts (lines + 1,), closed (lines,).
#[pyfunction]
pub fn level_set<'py>(
    py: Python<'py>,
    mesh: MeshArrays<'py>,
    values: PyReadonlyArray1<'py, f64>,
    level: f64,
) -> PyResult<ContourArrays<'py>> {
    let (mesh, values) = (mesh.mesh()?, vector(&values)?);
    let found = run::brief(py, || levelset::level_set(&mesh, values, level))?;
    let edges = found.edges.iter().flatten().map(|&end| end as i32).collect();
    Ok((
        table_out(py, found.points, mesh.dimension())?,
        table_out(py, edges, 2)?,
        vector_out(py, found.shares),
        vector_out(py, found.starts.into_iter().map(|start| start as i64).collect()),
        vector_out(py, found.closed),
    ))
}
