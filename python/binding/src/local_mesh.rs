//! Local meshes of point clouds.

use crate::convert::{CsrParts, matrix_out, table, table_out, vector, vector_out};
use crate::run;
use beltrami::operators::{LocalMeshOptions, VotedSimplices};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

/// Points (n, D), simplices (m, d + 1), votes (m,) and stretch (m,) or None as Python keeps them.
#[derive(FromPyObject)]
pub struct SimplexArrays<'py>(
    PyReadonlyArray2<'py, f64>,
    PyReadonlyArray2<'py, i32>,
    PyReadonlyArray1<'py, u8>,
    Option<PyReadonlyArray1<'py, f64>>,
);

impl SimplexArrays<'_> {
    /// The core's view of these arrays, without a copy.
    pub fn simplices(&self) -> PyResult<VotedSimplices<'_>> {
        let (points, ambient) = table(&self.0)?;
        let (corners, columns) = table(&self.1)?;
        let stretch = self.3.as_ref().map(vector).transpose()?;
        let votes = vector(&self.2)?;
        run::brief(self.0.py(), || {
            VotedSimplices::new(points, ambient, columns.saturating_sub(1), bytemuck::cast_slice(corners), votes)
                .and_then(|simplices| stretch.map_or(Ok(simplices), |stretch| simplices.stretched(stretch)))
        })
    }
}

type LocalMeshParts<'py> = (
    Bound<'py, PyArray2<i32>>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    f64,
);

/// Simplices, votes, voters, stretch, certified, boundary, spacing, frames (n, d D), second fundamental form (n, d (d + 1) / 2 D), estimated dimension.
#[pyfunction]
#[pyo3(signature = (points, dimension, neighbors = None, normals = None, reach = None, progress = None))]
pub fn local_mesh<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    dimension: usize,
    neighbors: Option<usize>,
    normals: Option<PyReadonlyArray2<'py, f64>>,
    reach: Option<PyReadonlyArray1<'py, f64>>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<LocalMeshParts<'py>> {
    let (numbers, ambient) = table(&points)?;
    let normals = normals.as_ref().map(table).transpose()?.map(|normals| normals.0);
    let reach = reach.as_ref().map(vector).transpose()?;
    let mesh = run::watched(py, progress.as_ref(), |control| {
        beltrami::operators::local_mesh(numbers, ambient, dimension, &LocalMeshOptions { neighbors, normals, reach }, control)
    })?;
    Ok((
        table_out(py, mesh.simplices.into_iter().map(|corner| corner as i32).collect(), dimension + 1)?,
        vector_out(py, mesh.votes),
        vector_out(py, mesh.voters),
        vector_out(py, mesh.stretch),
        vector_out(py, mesh.certified),
        vector_out(py, mesh.boundary),
        vector_out(py, mesh.spacing),
        table_out(py, mesh.frames, dimension * ambient)?,
        table_out(py, mesh.curvature, dimension * (dimension + 1) / 2 * ambient)?,
        mesh.estimated_dimension,
    ))
}

/// Stiffness of a local mesh, weighted by exp(-potential) if a potential is given.
#[pyfunction]
#[pyo3(signature = (mesh, potential = None))]
pub fn local_stiffness<'py>(
    py: Python<'py>,
    mesh: SimplexArrays<'py>,
    potential: Option<PyReadonlyArray1<'py, f64>>,
) -> PyResult<CsrParts<'py>> {
    let simplices = mesh.simplices()?;
    let potential = potential.as_ref().map(vector).transpose()?;
    let matrix = run::brief(py, || match potential {
        None => simplices.stiffness(),
        Some(values) => simplices.weighted_stiffness(values),
    })?;
    Ok(matrix_out(py, matrix))
}

/// Lumped mass of each point of a local mesh.
#[pyfunction]
pub fn local_mass<'py>(py: Python<'py>, mesh: SimplexArrays<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let simplices = mesh.simplices()?;
    let mass = run::brief(py, || simplices.mass())?;
    Ok(vector_out(py, mass))
}

/// Mean edge length of a local mesh.
#[pyfunction]
pub fn local_edge_length<'py>(py: Python<'py>, mesh: SimplexArrays<'py>) -> PyResult<f64> {
    let simplices = mesh.simplices()?;
    run::brief(py, || Ok(simplices.mean_edge_length()))
}

/// Volume of each simplex of a local mesh.
#[pyfunction]
pub fn local_volumes<'py>(py: Python<'py>, mesh: SimplexArrays<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let simplices = mesh.simplices()?;
    let volumes = run::brief(py, || Ok(simplices.volumes()))?;
    Ok(vector_out(py, volumes))
}

/// Gradient of piecewise-linear functions on the simplices, (m D, n).
#[pyfunction]
pub fn local_gradient<'py>(py: Python<'py>, mesh: SimplexArrays<'py>) -> PyResult<CsrParts<'py>> {
    let simplices = mesh.simplices()?;
    let matrix = run::brief(py, || simplices.gradient())?;
    Ok(matrix_out(py, matrix))
}
