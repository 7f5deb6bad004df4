//! Inner loops of near-isometric registration.

use crate::convert::{CsrArrays, table, table_out, vector, vector_out};
use crate::error;
use crate::run;
use beltrami::register::{self, Spectral, Triple};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

fn cube<'a>(array: &'a PyReadonlyArray3<'_, f64>) -> PyResult<(&'a [f64], usize)> {
    if !array.is_c_contiguous() {
        return Err(error::input(array.py(), "matrices handed to the core are not in C order"));
    }
    Ok((array.as_slice().map_err(|_| error::input(array.py(), "matrices handed to the core are not contiguous"))?, array.shape()[1]))
}

fn square(py: Python<'_>, numbers: Vec<f64>, n: usize) -> PyResult<Bound<'_, PyArray3<f64>>> {
    let count = numbers.len().checked_div(n * n).unwrap_or(0);
    numbers.into_pyarray(py).reshape([count, n, n])
}

/// The orthogonal matrix nearest to a square one.
#[pyfunction]
#[pyo3(signature = (matrix))]
pub fn polar<'py>(py: Python<'py>, matrix: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (numbers, n) = table(&matrix)?;
    let found = run::brief(py, || register::polar(numbers, n))?;
    table_out(py, found, n)
}

/// A shape as upsampling sees it: eigenfunctions (n, k), weighted features (n, f), masses (n,).
#[derive(FromPyObject)]
pub struct SpectralArrays<'py>(PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>, PyReadonlyArray1<'py, f64>);

impl SpectralArrays<'_> {
    fn view(&self) -> PyResult<Spectral<'_>> {
        let ((functions, modes), (features, _)) = (table(&self.0)?, table(&self.1)?);
        Ok(Spectral { functions, modes, features, masses: vector(&self.2)? })
    }
}

/// Maps after some steps up the agreement of triple products, and the three inner products of each.
#[pyfunction]
#[pyo3(signature = (maps, source_even, source_odd, target_even, target_odd, weight, linear, steps, progress=None))]
pub fn ascend_triple_products<'py>(
    py: Python<'py>,
    maps: PyReadonlyArray3<'py, f64>,
    source_even: PyReadonlyArray3<'py, f64>,
    source_odd: PyReadonlyArray3<'py, f64>,
    target_even: PyReadonlyArray3<'py, f64>,
    target_odd: PyReadonlyArray3<'py, f64>,
    weight: f64,
    linear: PyReadonlyArray2<'py, f64>,
    steps: usize,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray3<f64>>, Bound<'py, PyArray2<f64>>)> {
    let (numbers, n) = cube(&maps)?;
    let (linear, _) = table(&linear)?;
    let source = Triple { even: cube(&source_even)?.0, odd: cube(&source_odd)?.0 };
    let target = Triple { even: cube(&target_even)?.0, odd: cube(&target_odd)?.0 };
    let (found, scores) =
        run::watched(py, progress, |control| register::ascend(numbers, n, source, target, weight, linear, steps, control))?;
    Ok((square(py, found, n)?, table_out(py, bytemuck::cast_slice(&scores).to_vec(), 3)?))
}

/// One level of two-way spectral upsampling of several maps.
#[pyfunction]
#[pyo3(signature = (maps, following, source, target, progress=None))]
pub fn upsample_maps<'py>(
    py: Python<'py>,
    maps: PyReadonlyArray3<'py, f64>,
    following: usize,
    source: SpectralArrays<'py>,
    target: SpectralArrays<'py>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let (numbers, k) = cube(&maps)?;
    let (source, target) = (source.view()?, target.view()?);
    let found = run::watched(py, progress, |control| register::upsample(numbers, k, following, source, target, control))?;
    square(py, found, following)
}

/// Nearest rows in both directions.
#[pyfunction]
#[pyo3(signature = (map, source, target, progress=None))]
pub fn spectral_point_maps<'py>(
    py: Python<'py>,
    map: PyReadonlyArray2<'py, f64>,
    source: SpectralArrays<'py>,
    target: SpectralArrays<'py>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray1<i32>>, Bound<'py, PyArray1<i32>>)> {
    let (numbers, k) = table(&map)?;
    let (source, target) = (source.view()?, target.view()?);
    let (forward, backward) = run::watched(py, progress, |control| register::point_maps(numbers, k, source, target, control))?;
    Ok((vector_out(py, bytemuck::cast_vec(forward)), vector_out(py, bytemuck::cast_vec(backward))))
}

/// The orthogonal functional map that fits two point maps best.
#[pyfunction]
#[pyo3(signature = (forward, backward, modes, source, target))]
pub fn orthogonal_functional_map<'py>(
    py: Python<'py>,
    forward: PyReadonlyArray1<'py, i32>,
    backward: PyReadonlyArray1<'py, i32>,
    modes: usize,
    source: SpectralArrays<'py>,
    target: SpectralArrays<'py>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (forward, backward) = (bytemuck::cast_slice(vector(&forward)?), bytemuck::cast_slice(vector(&backward)?));
    let (source, target) = (source.view()?, target.view()?);
    let found = run::brief(py, || register::functional_map(forward, backward, modes, source, target))?;
    table_out(py, found, modes)
}

/// Neighbourhoods of a surface and their shape at rest.
#[pyclass(frozen, module = "beltrami._core")]
pub struct Rigid(register::Rigid);

#[pymethods]
impl Rigid {
    #[new]
    #[pyo3(signature = (weights, rest))]
    fn new(py: Python<'_>, weights: CsrArrays<'_>, rest: PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let (weights, (rest, _)) = (weights.matrix()?, table(&rest)?);
        run::brief(py, || register::Rigid::new(weights, rest)).map(Rigid)
    }

    /// Right-hand side for new positions (n, 3), and the energy of the positions given.
    fn fit<'py>(&self, py: Python<'py>, positions: PyReadonlyArray2<'py, f64>, stretch: f64) -> PyResult<(Bound<'py, PyArray2<f64>>, f64)> {
        let (positions, _) = table(&positions)?;
        let fit = run::brief(py, || self.0.fit(positions, stretch))?;
        Ok((table_out(py, fit.right, 3)?, fit.energy))
    }
}
