//! Sliced Wasserstein distances.

use crate::convert::{table, vector, vector_out};
use crate::error;
use crate::run;
use beltrami::sliced;
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

type Weights<'py> = Option<PyReadonlyArray1<'py, f64>>;

fn weights<'a>(given: &'a Weights<'_>) -> PyResult<Option<&'a [f64]>> {
    given.as_ref().map(vector).transpose()
}

fn same(py: Python<'_>, all: [usize; 3]) -> PyResult<usize> {
    if all[0] == all[1] && all[0] == all[2] {
        return Ok(all[0]);
    }
    Err(error::input(py, format!("the source has {} coordinates, the target {}, the directions {}", all[0], all[1], all[2])))
}

/// Sliced Wasserstein distance over given directions.
#[pyfunction]
#[pyo3(signature = (source, target, source_weights, target_weights, directions, progress=None))]
pub fn sliced_distance<'py>(
    py: Python<'py>,
    source: PyReadonlyArray2<'py, f64>,
    target: PyReadonlyArray2<'py, f64>,
    source_weights: Weights<'py>,
    target_weights: Weights<'py>,
    directions: PyReadonlyArray2<'py, f64>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<f64> {
    let ((source, n), (target, m), (directions, k)) = (table(&source)?, table(&target)?, table(&directions)?);
    let dimension = same(py, [n, m, k])?;
    let (a, b) = (weights(&source_weights)?, weights(&target_weights)?);
    run::watched(py, progress, |control| sliced::distance(source, target, dimension, a, b, directions, control))
}

/// What an alternation between couplings and rotations keeps.
#[pyclass(frozen, module = "beltrami._core")]
pub struct SlicedAlignment(sliced::Alignment);

#[pymethods]
impl SlicedAlignment {
    #[new]
    #[pyo3(signature = (source, target, source_weights, target_weights, directions))]
    fn new<'py>(
        py: Python<'py>,
        source: PyReadonlyArray2<'py, f64>,
        target: PyReadonlyArray2<'py, f64>,
        source_weights: Weights<'py>,
        target_weights: Weights<'py>,
        directions: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Self> {
        let ((source, n), (target, m), (directions, k)) = (table(&source)?, table(&target)?, table(&directions)?);
        let dimension = same(py, [n, m, k])?;
        let (a, b) = (weights(&source_weights)?, weights(&target_weights)?);
        run::watched(py, None, |control| sliced::Alignment::new(source, target, dimension, a, b, directions, control)).map(SlicedAlignment)
    }

    /// H at each of several rotations (k, n, n), and the squared distances there.
    fn step<'py>(
        &self,
        py: Python<'py>,
        rotations: PyReadonlyArray3<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray3<f64>>, Bound<'py, PyArray1<f64>>)> {
        let (dimension, shape) = (self.0.dimension(), rotations.shape().to_vec());
        if !rotations.is_c_contiguous() || shape[1] != dimension || shape[2] != dimension {
            return Err(error::input(py, format!("rotations have shape {shape:?}; (k, {dimension}, {dimension}) in C order is needed")));
        }
        let numbers = rotations.as_slice().map_err(|_| error::input(py, "rotations handed to the core are not contiguous"))?;
        let steps = run::watched(py, None, |control| self.0.step(numbers, control))?;
        let mut cross = Vec::with_capacity(numbers.len());
        steps.iter().for_each(|step| cross.extend_from_slice(&step.cross));
        let values = steps.iter().map(|step| step.value).collect();
        Ok((cross.into_pyarray(py).reshape([shape[0], dimension, dimension])?, vector_out(py, values)))
    }
}
