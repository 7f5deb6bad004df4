//! Eigenpairs of small and of projected matrices, densely.

use super::DENSE;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::Csr;
use faer::{Mat, MatRef, Par, Side};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

const GLANCE: Duration = Duration::from_millis(20); // between looks whether dense work is still wanted

/// What `work` makes, on a thread of its own that nobody waits for any longer once the caller wants to stop: the dense factorizations
/// cannot be asked to end.
pub(super) fn apart<T: Send + 'static>(control: &Control, work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    let (send, receive) = channel();
    std::thread::Builder::new()
        .name("beltrami-dense".into())
        .stack_size(16 << 20)
        .spawn(move || {
            let _ = send.send(catch_unwind(AssertUnwindSafe(work)));
        })
        .map_err(|error| Error::numerical(format!("a thread for a dense eigenproblem cannot be started: {error}")))?;
    loop {
        match receive.recv_timeout(GLANCE) {
            Ok(Ok(answer)) => return answer,
            Ok(Err(panic)) => resume_unwind(panic),
            Err(RecvTimeoutError::Timeout) => control.check()?,
            Err(RecvTimeoutError::Disconnected) => return Err(Error::numerical("a dense eigenproblem ended without an answer")),
        }
    }
}

/// [`symmetric_eigen`], given up when the caller wants to stop.
pub(super) fn dense_eigen(matrix: MatRef<f64>, control: &Control) -> Result<(Vec<f64>, Mat<f64>)> {
    if matrix.nrows() <= DENSE {
        return symmetric_eigen(matrix);
    }
    let matrix = matrix.to_owned();
    apart(control, move || symmetric_eigen(matrix.as_ref()))
}

/// Eigenvalues (ascending) and vectors of a symmetric matrix.
fn symmetric_eigen(matrix: MatRef<f64>) -> Result<(Vec<f64>, Mat<f64>)> {
    let broken = || {
        Error::numerical(
            "a projected eigenproblem could not be solved: the matrices are too badly scaled; use an intrinsic Delaunay Laplacian",
        )
    };
    let n = matrix.nrows();
    if (0..n).any(|j| (0..n).any(|i| !matrix[(i, j)].is_finite())) {
        return Err(broken());
    }
    // faer's divide and conquer has absolute thresholds: bring the entries near 1, by a power of two, so exactly.
    let largest = (0..n).flat_map(|j| (0..n).map(move |i| matrix[(i, j)].abs())).fold(0.0, f64::max);
    let scale = if largest > 0.0 { largest.log2().floor().clamp(-1000.0, 1000.0).exp2() } else { 1.0 };
    let near_one = Mat::from_fn(n, n, |i, j| matrix[(i, j)] / scale);
    let found = near_one.self_adjoint_eigen(Side::Lower).map_err(|_| broken())?;
    let values: Vec<f64> = (0..n).map(|i| scale * found.S()[i]).collect();
    if values.iter().any(|value| !value.is_finite()) {
        return Err(broken());
    }
    Ok((values, found.U().to_owned()))
}

/// All eigenvalues and vectors of a pencil, the mass a matrix or a diagonal.
pub(super) fn dense_pencil(matrix: &Csr, mass: std::result::Result<Csr, Vec<f64>>) -> Result<(Vec<f64>, Mat<f64>)> {
    let n = matrix.rows();
    let full = |matrix: &Csr| {
        let mut dense = Mat::<f64>::zeros(n, n);
        for row in 0..n {
            let (columns, values) = matrix.row(row);
            for (&column, &value) in columns.iter().zip(values) {
                dense[(row, column as usize)] = value;
            }
        }
        dense
    };
    let mut a = full(matrix);
    // Reduce to a standard problem: C^-1 A C^-T with M = C C^T.
    match mass {
        Err(diagonal) => {
            let scale: Vec<f64> = diagonal.iter().map(|m| 1.0 / m.sqrt()).collect();
            for j in 0..n {
                for i in 0..n {
                    a[(i, j)] *= scale[i] * scale[j];
                }
            }
            let (values, mut vectors) = symmetric_eigen(a.as_ref())?;
            for j in 0..n {
                for i in 0..n {
                    vectors[(i, j)] *= scale[i];
                }
            }
            Ok((values, vectors))
        }
        Ok(mass) => {
            let lower =
                full(&mass).llt(Side::Lower).map_err(|_| Error::numerical("the mass matrix is not positive definite"))?.L().to_owned();
            let mut back = Mat::<f64>::identity(n, n);
            faer::linalg::triangular_solve::solve_lower_triangular_in_place(lower.as_ref(), back.as_mut(), Par::Seq);
            let (values, vectors) = symmetric_eigen((&back * &a * back.transpose()).as_ref())?;
            Ok((values, back.transpose() * &vectors))
        }
    }
}
