//! Subsets of points.

use crate::convert::{table, vector, vector_out};
use crate::run;
use beltrami::near;
use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

/// Whether each point is the first of those that coincide with it.
#[pyfunction]
pub fn first_copies<'py>(py: Python<'py>, points: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray1<bool>>> {
    let (points, dimension) = table(&points)?;
    let kept = run::watched(py, None, |control| near::first_copies(points, dimension, control))?;
    Ok(vector_out(py, kept))
}

/// Points each of which is the farthest from those before it.
#[pyfunction]
#[pyo3(signature = (points, wanted, start, progress = None))]
pub fn farthest_points<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    wanted: usize,
    start: usize,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<i32>>> {
    let (points, dimension) = table(&points)?;
    let chosen = run::watched(py, progress.as_ref(), |control| near::farthest_points(points, dimension, wanted, start, control))?;
    Ok(vector_out(py, bytemuck::cast_vec(chosen)))
}

/// Points no two of which are nearer than a radius, taken in a given order.
#[pyfunction]
#[pyo3(signature = (points, radius, order, progress = None))]
pub fn poisson_disc<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    radius: f64,
    order: PyReadonlyArray1<'py, i32>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<i32>>> {
    let (points, dimension) = table(&points)?;
    let order = bytemuck::cast_slice(vector(&order)?);
    let chosen = run::watched(py, progress.as_ref(), |control| near::poisson_disc(points, dimension, radius, order, control))?;
    Ok(vector_out(py, bytemuck::cast_vec(chosen)))
}
