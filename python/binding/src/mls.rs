//! Moving least squares on point clouds.

use crate::convert::{CsrParts, matrix_out, table, vector_out};
use crate::{error, run};
use beltrami::operators::{MlsOptions, MlsWeight};
use numpy::{PyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

/// Gradient, Laplacian, points whose row has a negative off-diagonal entry, estimated dimension.
#[pyfunction]
#[allow(clippy::type_complexity, clippy::too_many_arguments)]
#[pyo3(signature = (points, dimension, degree, neighbors = None, weight = "special", constrained = true, normals = None, progress = None))]
pub fn moving_least_squares<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    dimension: usize,
    degree: usize,
    neighbors: Option<usize>,
    weight: &str,
    constrained: bool,
    normals: Option<PyReadonlyArray2<'py, f64>>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(CsrParts<'py>, CsrParts<'py>, Bound<'py, PyArray1<u32>>, f64)> {
    let (numbers, ambient) = table(&points)?;
    let weight = match weight {
        "special" => MlsWeight::Special,
        "gaussian" => MlsWeight::Gaussian,
        "wendland" => MlsWeight::Wendland,
        "uniform" => MlsWeight::Uniform,
        other => return Err(error::input(py, format!("weight is {other:?}; choose special, gaussian, wendland or uniform"))),
    };
    let normals = normals.as_ref().map(table).transpose()?.map(|normals| normals.0);
    let options = MlsOptions { degree, neighbors, weight, constrained, normals };
    let mls = run::watched(py, progress.as_ref(), |control| {
        beltrami::operators::moving_least_squares(numbers, ambient, dimension, &options, control)
    })?;
    Ok((matrix_out(py, mls.gradient), matrix_out(py, mls.laplacian), vector_out(py, mls.signed), mls.estimated_dimension))
}
