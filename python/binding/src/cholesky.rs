//! Sparse Cholesky.

use crate::convert::{CsrArrays, CsrParts, matrix_out, table, table_out, vector, vector_out};
use crate::error;
use crate::run;
use beltrami::solvers;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

/// A factor. No lock is held while the pool works: a worker that waits may pick up another caller's job.
#[pyclass(frozen, module = "beltrami._core")]
pub struct Cholesky {
    factor: Mutex<Arc<solvers::Cholesky>>,
    scratch: Mutex<Option<solvers::Scratch>>,
}

impl Cholesky {
    fn read(&self) -> Arc<solvers::Cholesky> {
        self.factor.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn solved(&self, b: &[f64], width: usize, out: &mut [f64]) -> beltrami::Result<()> {
        let kept = self.scratch.lock().unwrap_or_else(PoisonError::into_inner).take();
        let mut scratch = kept.unwrap_or_default();
        scratch.refine = true;
        let outcome = self.read().solve_block_into(b, width, out, &mut scratch);
        *self.scratch.lock().unwrap_or_else(PoisonError::into_inner) = Some(scratch);
        outcome
    }
}

#[pymethods]
impl Cholesky {
    #[new]
    #[pyo3(signature = (matrix, coordinates, order, progress))]
    fn new(
        py: Python<'_>,
        matrix: CsrArrays<'_>,
        coordinates: Option<PyReadonlyArray2<'_, f64>>,
        order: Option<PyReadonlyArray1<'_, u32>>,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let matrix = matrix.matrix()?;
        let coordinates = coordinates.as_ref().map(|c| table(c)).transpose()?;
        let order = order.as_ref().map(|o| vector(o)).transpose()?;
        let factor = run::watched(py, progress, |control| match order {
            None => solvers::Cholesky::new(&matrix, coordinates, control),
            Some(order) => {
                let symbolic = solvers::Symbolic::with_order(&matrix, order, control)?;
                solvers::Cholesky::with_symbolic(&symbolic, &matrix, control)
            }
        })?;
        Ok(Cholesky { factor: Mutex::new(Arc::new(factor)), scratch: Mutex::new(None) })
    }

    /// Factors another matrix of the same pattern.
    fn refactor(&self, py: Python<'_>, matrix: CsrArrays<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let matrix = matrix.matrix()?;
        let symbolic = self.read().symbolic();
        let factor = run::watched(py, progress, |control| solvers::Cholesky::with_symbolic(&symbolic, &matrix, control))?;
        *self.factor.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(factor);
        Ok(())
    }

    /// Solves for a table of right-hand sides.
    fn solve<'py>(&self, py: Python<'py>, b: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (b, width) = table(&b)?;
        let out = run::watched(py, None, |_| {
            let mut out = vec![0.0; b.len()];
            self.solved(b, width, &mut out).map(|()| out)
        })?;
        table_out(py, out, width)
    }

    /// The same into an array.
    fn solve_into(&self, py: Python<'_>, b: PyReadonlyArray2<'_, f64>, mut out: PyReadwriteArray2<'_, f64>) -> PyResult<()> {
        if !out.is_c_contiguous() || out.shape() != b.shape() {
            return Err(error::input(py, "out does not have the shape of b in C order"));
        }
        let (b, width) = table(&b)?;
        let out = out.as_slice_mut().map_err(|_| error::input(py, "out is not contiguous"))?;
        run::watched(py, None, |_| self.solved(b, width, out))
    }

    /// Relative residual of each column.
    fn residuals<'py>(
        &self,
        py: Python<'py>,
        b: PyReadonlyArray2<'py, f64>,
        x: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let ((b, width), (x, _)) = (table(&b)?, table(&x)?);
        let found = run::watched(py, None, |_| self.read().residuals(b, x, width))?;
        Ok(vector_out(py, found))
    }

    /// The matrix that was factored last.
    fn matrix<'py>(&self, py: Python<'py>) -> PyResult<CsrParts<'py>> {
        let matrix = run::brief(py, || Ok(self.read().matrix()))?;
        Ok(matrix_out(py, matrix))
    }

    /// The order that was found.
    fn order<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        vector_out(py, self.read().symbolic().given_order().to_vec())
    }

    fn unknowns(&self) -> usize {
        self.read().unknowns()
    }

    fn nnz(&self) -> usize {
        self.read().nnz()
    }

    fn log_determinant(&self) -> f64 {
        self.read().log_determinant()
    }
}
