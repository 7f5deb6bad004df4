//! Conjugate gradients from a guess.

use crate::convert::{CsrArrays, table};
use crate::run;
use crate::shrink::written;
use beltrami::solvers;
use numpy::{PyReadonlyArray2, PyReadwriteArray2};
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// A symmetric positive definite matrix.
#[pyclass(frozen, module = "beltrami._core")]
pub struct Conjugate {
    solver: solvers::Conjugate,
    scratch: Mutex<Vec<f64>>,
}

#[pymethods]
impl Conjugate {
    #[new]
    fn new(py: Python<'_>, matrix: CsrArrays<'_>) -> PyResult<Self> {
        let matrix = matrix.matrix()?;
        let solver = run::brief(py, || solvers::Conjugate::new(matrix))?;
        Ok(Conjugate { solver, scratch: Mutex::default() })
    }

    /// Moves `x` towards the solution until the residual has shrunk by `reduction`; the number of steps.
    fn improve(
        &self,
        py: Python<'_>,
        b: PyReadonlyArray2<'_, f64>,
        mut x: PyReadwriteArray2<'_, f64>,
        reduction: f64,
        most: usize,
    ) -> PyResult<usize> {
        let ((b, width), x) = (table(&b)?, written(&mut x, py)?);
        run::brief(py, || {
            // no lock is held while the pool works
            let mut scratch = std::mem::take(&mut *self.scratch.lock().unwrap_or_else(PoisonError::into_inner));
            let outcome = self.solver.improve(b, width, x, reduction, most, &mut scratch);
            *self.scratch.lock().unwrap_or_else(PoisonError::into_inner) = scratch;
            outcome
        })
    }
}
