//! Geodesic distance and Poisson equations: solvers that keep their factors.

use crate::convert::{CsrArrays, table, table_out, vector, vector_out};
use crate::{error, run};
use beltrami::geodesic::{self, HeatOperators};
use beltrami::solvers::{self, Method};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

/// Distances from any sets of sources.
#[pyclass(frozen, module = "beltrami._core")]
pub struct HeatMethod(geodesic::HeatMethod);

#[pymethods]
impl HeatMethod {
    #[new]
    fn new(
        py: Python<'_>,
        stiffness: CsrArrays<'_>,
        mass: PyReadonlyArray1<'_, f64>,
        gradient: CsrArrays<'_>,
        areas: PyReadonlyArray1<'_, f64>,
        spacing: f64,
        boundary: PyReadonlyArray1<'_, bool>,
        coordinates: PyReadonlyArray2<'_, f64>,
        time_factor: f64,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let (numbers, width) = table(&coordinates)?;
        let shape = HeatOperators {
            stiffness: stiffness.matrix()?,
            mass: vector(&mass)?.to_vec(),
            gradient: gradient.matrix()?,
            areas: vector(&areas)?.to_vec(),
            spacing,
            boundary: vector(&boundary)?.to_vec(),
            coordinates: Some((numbers.to_vec(), width)),
        };
        run::watched(py, progress.as_ref(), |control| geodesic::HeatMethod::new(shape, time_factor, control)).map(HeatMethod)
    }

    /// Distance to the nearest source.
    fn distance<'py>(&self, py: Python<'py>, sources: PyReadonlyArray1<'py, i64>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let sources = vector(&sources)?.iter().map(|&source| usize::try_from(source)).collect::<Result<Vec<_>, _>>();
        let sources = sources.map_err(|_| error::input(py, "a source is negative"))?;
        let found = run::watched(py, None, |control| self.0.distance(&sources, control))?;
        Ok(vector_out(py, found))
    }
}

/// Solves with a singular stiffness matrix: directly, or by multilevel iterations down to a relative residual.
#[pyclass(frozen, module = "beltrami._core")]
pub struct LaplacianSolver(solvers::LaplacianSolver);

#[pymethods]
impl LaplacianSolver {
    #[new]
    fn new(
        py: Python<'_>,
        stiffness: CsrArrays<'_>,
        mass: PyReadonlyArray1<'_, f64>,
        coordinates: PyReadonlyArray2<'_, f64>,
        residual: Option<f64>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let (stiffness, mass, coordinates) = (stiffness.matrix()?, vector(&mass)?, table(&coordinates)?);
        let method = residual.map_or(Method::Direct, Method::Multilevel);
        run::watched(py, progress.as_ref(), |control| {
            solvers::LaplacianSolver::with_method(&stiffness, mass, Some(coordinates), method, control)
        })
        .map(LaplacianSolver)
    }

    /// Solves for (n, k) right-hand sides; with a tolerance, refuses those that are not compatible.
    fn solve<'py>(&self, py: Python<'py>, b: PyReadonlyArray2<'py, f64>, tolerance: Option<f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (numbers, width) = table(&b)?;
        let found = run::watched(py, None, |control| match tolerance {
            Some(tolerance) => self.0.solve_compatible(numbers, width, tolerance, control),
            None => self.0.solve(numbers, width, control),
        })?;
        table_out(py, found, width)
    }
}
