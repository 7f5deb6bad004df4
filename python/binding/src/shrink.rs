//! Total variation on simplices.

use crate::convert::{table, vector};
use crate::error;
use crate::run;
use beltrami::shrink::{self, Nodes, Shrinkage};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Simplices with weights and hat gradients. No lock is held while the pool works: a worker that waits may pick up another caller's job.
#[pyclass(frozen, module = "beltrami._core")]
pub struct Elements {
    pub elements: shrink::Elements,
    scratch: Mutex<shrink::Scratch>,
}

impl Elements {
    fn with_scratch<T>(&self, work: impl FnOnce(&mut shrink::Scratch) -> T) -> T {
        let mut scratch = std::mem::take(&mut *self.scratch.lock().unwrap_or_else(PoisonError::into_inner));
        let outcome = work(&mut scratch);
        *self.scratch.lock().unwrap_or_else(PoisonError::into_inner) = scratch;
        outcome
    }
}

pub fn written<'a>(array: &'a mut PyReadwriteArray2<'_, f64>, py: Python<'_>) -> PyResult<&'a mut [f64]> {
    if !array.is_c_contiguous() {
        return Err(error::input(py, "a table handed to the core is not in C order"));
    }
    array.as_slice_mut().map_err(|_| error::input(py, "a table handed to the core is not contiguous"))
}

#[pymethods]
impl Elements {
    /// From node numbers (m, corners), hat gradients (m, (corners - 1)^2) and weights (m,).
    #[new]
    #[pyo3(signature = (nodes, corners, hats, weights))]
    fn new(
        py: Python<'_>,
        nodes: usize,
        corners: PyReadonlyArray2<'_, i32>,
        hats: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Self> {
        let ((corners, each), (hats, _), weights) = (table(&corners)?, table(&hats)?, vector(&weights)?);
        let elements = run::brief(py, || {
            let indices = corners.iter().map(|&corner| corner as u32).collect();
            shrink::Elements::new(nodes, each, indices, hats.to_vec(), weights.to_vec())
        })?;
        Ok(Elements { elements, scratch: Mutex::default() })
    }

    /// Total variation of a table of values (n, channels).
    fn total_variation(&self, py: Python<'_>, values: PyReadonlyArray2<'_, f64>, joint: bool) -> PyResult<f64> {
        let (values, channels) = table(&values)?;
        run::brief(py, || self.elements.total_variation(values, channels, joint))
    }

    /// G^T diag(weights) X into `flux`.
    fn flux(&self, py: Python<'_>, field: PyReadonlyArray2<'_, f64>, mut flux: PyReadwriteArray2<'_, f64>) -> PyResult<()> {
        let channels = flux.shape()[1];
        let ((field, _), flux) = (table(&field)?, written(&mut flux, py)?);
        run::brief(py, || self.with_scratch(|scratch| self.elements.flux(field, channels, flux, scratch)))
    }

    /// One sweep of shrinkage; `split`, `dual` and `flux` are written.
    fn shrink(
        &self,
        py: Python<'_>,
        values: PyReadonlyArray2<'_, f64>,
        mut split: PyReadwriteArray2<'_, f64>,
        mut dual: PyReadwriteArray2<'_, f64>,
        mut flux: PyReadwriteArray2<'_, f64>,
        joint: bool,
        radius: f64,
        penalty: f64,
        relaxation: f64,
    ) -> PyResult<(f64, f64)> {
        let (values, channels) = table(&values)?;
        let how = Shrinkage { channels, joint, radius, penalty, relaxation };
        let (split, dual, flux) = (written(&mut split, py)?, written(&mut dual, py)?, written(&mut flux, py)?);
        run::brief(py, || self.with_scratch(|scratch| self.elements.shrink(values, how, split, dual, flux, scratch)))
    }
}

/// One sweep of the nodes' constraint; `split`, `dual` and `right` are written.
#[pyfunction]
pub fn constrain(
    py: Python<'_>,
    values: PyReadonlyArray2<'_, f64>,
    cost: PyReadonlyArray2<'_, f64>,
    weights: PyReadonlyArray1<'_, f64>,
    mut split: PyReadwriteArray2<'_, f64>,
    mut dual: PyReadwriteArray2<'_, f64>,
    mut right: PyReadwriteArray2<'_, f64>,
    penalty: f64,
    ratio: f64,
    relaxation: f64,
) -> PyResult<(f64, f64)> {
    let ((values, channels), (cost, _), weights) = (table(&values)?, table(&cost)?, vector(&weights)?);
    let (split, dual, right) = (written(&mut split, py)?, written(&mut dual, py)?, written(&mut right, py)?);
    let nodes = Nodes { cost, weights, split, dual };
    run::brief(py, || shrink::constrain(values, channels, nodes, penalty, ratio, relaxation, right))
}
