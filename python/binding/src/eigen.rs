//! Eigenpairs.

use crate::convert::{CsrArrays, table, table_out, vector, vector_out};
use crate::{error, run};
use beltrami::solvers::{self, EigenOptions, Mass};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

type Found<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>, usize);

/// The k smallest eigenpairs of a pencil, the mass a diagonal or a matrix: values, vectors (n, k), residuals, blocks.
#[pyfunction]
pub fn eigenpairs<'py>(
    py: Python<'py>,
    matrix: CsrArrays<'py>,
    diagonal: Option<PyReadonlyArray1<'py, f64>>,
    mass: Option<CsrArrays<'py>>,
    k: usize,
    shift: Option<f64>,
    coordinates: Option<PyReadonlyArray2<'py, f64>>,
    start: Option<PyReadonlyArray2<'py, f64>>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Found<'py>> {
    let (matrix, mass) = (matrix.matrix()?, mass.map(|mass| mass.matrix()).transpose()?);
    let mass = match (&diagonal, &mass) {
        (Some(diagonal), None) => Mass::Diagonal(vector(diagonal)?),
        (None, Some(mass)) => Mass::Matrix(mass),
        _ => return Err(error::input(py, "either a diagonal or a mass matrix is needed")),
    };
    let coordinates = coordinates.as_ref().map(table).transpose()?;
    let start = start.as_ref().map(table).transpose()?;
    let options = EigenOptions { shift, coordinates, start };
    let found = run::watched(py, progress.as_ref(), |control| solvers::eigenpairs(&matrix, mass, k, &options, control))?;
    Ok((vector_out(py, found.values), table_out(py, found.vectors, k)?, vector_out(py, found.residuals), found.iterations))
}
