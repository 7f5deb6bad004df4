//! Neighbours, closest points and rays.

use crate::convert::{table, table_out, vector_out};
use crate::error;
use crate::run;
use beltrami::near::KdTree;
use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;

fn same_dimension(py: Python<'_>, points: usize, queries: usize) -> PyResult<()> {
    if points == queries {
        return Ok(());
    }
    Err(error::input(py, format!("queries have {queries} coordinates, points have {points}")))
}

/// Indices and distances of the nearest points to each query.
#[pyfunction]
#[pyo3(signature = (points, queries, wanted, progress=None))]
pub fn nearest_neighbors<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    queries: PyReadonlyArray2<'py, f64>,
    wanted: usize,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray2<i32>>, Bound<'py, PyArray2<f64>>)> {
    let (points, dimension) = table(&points)?;
    let (queries, columns) = table(&queries)?;
    same_dimension(py, dimension, columns)?;
    let (indices, distances) =
        run::watched(py, progress, |control| KdTree::new(points, dimension, control)?.nearest(queries, wanted, control))?;
    Ok((table_out(py, bytemuck::cast_vec(indices), wanted)?, table_out(py, distances, wanted)?))
}

/// List starts, indices and distances of the points within a radius of each query.
#[pyfunction]
#[pyo3(signature = (points, queries, radius, progress=None))]
#[allow(clippy::type_complexity)]
pub fn neighbors_within<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    queries: PyReadonlyArray2<'py, f64>,
    radius: f64,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray1<f64>>)> {
    let (points, dimension) = table(&points)?;
    let (queries, columns) = table(&queries)?;
    same_dimension(py, dimension, columns)?;
    let found = run::watched(py, progress, |control| KdTree::new(points, dimension, control)?.within(queries, radius, control))?;
    let starts = found.starts.into_iter().map(|start| start as i64).collect();
    Ok((vector_out(py, starts), vector_out(py, bytemuck::cast_vec(found.indices)), vector_out(py, found.distances)))
}
