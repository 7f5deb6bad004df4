//! Contours at many levels and the regions between them.

use crate::convert::{table, table_out, vector, vector_out};
use crate::run;
use beltrami::reeb::{Sliced, contour_graph as cut};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

type ContourGraphArrays<'py> = (
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<u32>>,
    usize,
);

/// Cut, region below and region above of each contour; points (p, D), weights (p,), starts (contours + 1,); region of each vertex, regions.
#[pyfunction]
#[pyo3(signature = (points, cells, values, ranks, cuts, levels, weights, progress = None))]
#[expect(clippy::too_many_arguments, reason = "arrays of one struct")]
pub fn contour_graph<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    cells: PyReadonlyArray2<'py, i32>,
    values: PyReadonlyArray1<'py, f64>,
    ranks: PyReadonlyArray1<'py, u32>,
    cuts: PyReadonlyArray1<'py, u32>,
    levels: PyReadonlyArray1<'py, f64>,
    weights: PyReadonlyArray1<'py, f64>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<ContourGraphArrays<'py>> {
    let ((points, dimension), (cells, size)) = (table(&points)?, table(&cells)?);
    let sliced = Sliced {
        points,
        dimension,
        cells: bytemuck::cast_slice(cells),
        size,
        values: vector(&values)?,
        ranks: vector(&ranks)?,
        cuts: vector(&cuts)?,
        levels: vector(&levels)?,
        weights: vector(&weights)?,
    };
    let found = run::watched(py, progress.as_ref(), |control| cut(&sliced, control))?;
    Ok((
        vector_out(py, found.cut),
        vector_out(py, found.below),
        vector_out(py, found.above),
        table_out(py, found.points, dimension)?,
        vector_out(py, found.weights),
        vector_out(py, found.starts.into_iter().map(|start| start as i64).collect()),
        vector_out(py, found.region),
        found.regions,
    ))
}
