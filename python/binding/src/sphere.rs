//! Inner loops of conformal maps to the sphere.

use crate::convert::{table, table_out, vector, vector_out};
use crate::error;
use crate::run;
use beltrami::sphere;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

type GradientOut<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>, f64);

/// Gradient of E - A (n, 3), lumped image areas (n,), E - A.
#[pyfunction]
#[pyo3(signature = (positions, faces, cotangents, weights))]
pub fn excess_gradient<'py>(
    py: Python<'py>,
    positions: PyReadonlyArray2<'py, f64>,
    faces: PyReadonlyArray2<'py, i32>,
    cotangents: PyReadonlyArray2<'py, f64>,
    weights: Option<PyReadonlyArray1<'py, f64>>,
) -> PyResult<GradientOut<'py>> {
    let ((positions, three), (corners, a), (cotangents, b)) = (table(&positions)?, table(&faces)?, table(&cotangents)?);
    if [three, a, b] != [3, 3, 3] {
        return Err(error::input(py, "positions, faces and cotangents need three columns"));
    }
    let faces: &[[u32; 3]] = bytemuck::cast_slice(corners);
    let weights = weights.as_ref().map(vector).transpose()?;
    let found = run::watched(py, None, |control| sphere::excess_gradient(positions, faces, cotangents, weights, control))?;
    Ok((table_out(py, found.gradient, 3)?, vector_out(py, found.areas), found.excess))
}

/// A Möbius translation of unit vectors (n, 3), and the weighted sum of the images.
#[pyfunction]
#[pyo3(signature = (positions, center, weights))]
pub fn moebius_translated<'py>(
    py: Python<'py>,
    positions: PyReadonlyArray2<'py, f64>,
    center: [f64; 3],
    weights: PyReadonlyArray1<'py, f64>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, [f64; 3])> {
    let ((positions, three), weights) = (table(&positions)?, vector(&weights)?);
    if three != 3 {
        return Err(error::input(py, "positions need three columns"));
    }
    let (moved, sum) = run::brief(py, || sphere::translated(positions, center, weights))?;
    Ok((table_out(py, moved, 3)?, sum))
}
