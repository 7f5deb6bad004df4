//! Arrays in and out.
//!
//! The Python side hands over C-ordered, aligned arrays of the exact type (its one gate is `beltrami/arrays.py`); here that
//! is checked again and refused otherwise, because `as_slice` of the numpy crate would take Fortran order for C order.

use crate::error;
use crate::run;
use beltrami::{Csr, TriangleMesh};
use numpy::{Element, IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// The numbers of a vector.
pub fn vector<'a, T: Element>(array: &'a PyReadonlyArray1<'_, T>) -> PyResult<&'a [T]> {
    array.as_slice().map_err(|_| error::input(array.py(), "a vector handed to the core is not contiguous"))
}

/// The numbers of a table, row after row, and its number of columns.
pub fn table<'a, T: Element>(array: &'a PyReadonlyArray2<'_, T>) -> PyResult<(&'a [T], usize)> {
    if !array.is_c_contiguous() {
        return Err(error::input(array.py(), "a table handed to the core is not in C order"));
    }
    let numbers = array.as_slice().map_err(|_| error::input(array.py(), "a table handed to the core is not contiguous"))?;
    Ok((numbers, array.shape()[1]))
}

/// The arrays of a mesh as Python keeps them: (n, D) float64 and (m, 3) int32, C-ordered.
#[derive(FromPyObject)]
pub struct MeshArrays<'py>(PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, i32>);

impl MeshArrays<'_> {
    /// The mesh of the core on these arrays, without a copy.
    pub fn mesh(&self) -> PyResult<TriangleMesh<'_>> {
        let py = self.0.py();
        let (vertices, dimension) = table(&self.0)?;
        let (corners, three) = table(&self.1)?;
        if three != 3 {
            return Err(error::input(py, format!("faces have {three} columns, a triangle has 3")));
        }
        let faces: &[[u32; 3]] = bytemuck::cast_slice(corners);
        run::brief(py, || TriangleMesh::new(dimension, vertices, faces))
    }
}

/// A matrix as Python hands it over: rows, columns, row starts (int64), column indices (int32), values.
#[derive(FromPyObject)]
pub struct CsrArrays<'py>(usize, usize, PyReadonlyArray1<'py, i64>, PyReadonlyArray1<'py, i32>, PyReadonlyArray1<'py, f64>);

impl CsrArrays<'_> {
    /// The core's matrix, a checked copy. A negative start or column turns into one that is out of range.
    pub fn matrix(&self) -> PyResult<Csr> {
        let (starts, indices, values) = (vector(&self.2)?, vector(&self.3)?, vector(&self.4)?);
        let (rows, columns) = (self.0, self.1);
        run::brief(self.2.py(), || {
            let starts = starts.iter().map(|&start| start as usize).collect();
            let indices = indices.iter().map(|&index| index as u32).collect();
            Csr::new(rows, columns, starts, indices, values.to_vec())
        })
    }
}

/// A matrix on its way to Python: (values, column indices, row starts), the indices 32 bits wide if that is enough.
pub type CsrParts<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyAny>, Bound<'py, PyAny>);

/// The arrays of a matrix for `scipy.sparse.csr_array`.
pub fn matrix_out<'py>(py: Python<'py>, matrix: Csr) -> CsrParts<'py> {
    let narrow = matrix.values().len() < i32::MAX as usize;
    let (starts, indices, values) = matrix.into_parts();
    let (indices, starts) = if narrow {
        let indices: Vec<i32> = bytemuck::cast_vec(indices);
        let starts: Vec<i32> = starts.into_iter().map(|start| start as i32).collect();
        (indices.into_pyarray(py).into_any(), starts.into_pyarray(py).into_any())
    } else {
        let indices: Vec<i64> = indices.into_iter().map(i64::from).collect();
        let starts: Vec<i64> = starts.into_iter().map(|start| start as i64).collect();
        (indices.into_pyarray(py).into_any(), starts.into_pyarray(py).into_any())
    };
    (values.into_pyarray(py), indices, starts)
}

/// A vector on its way to Python, without a copy.
pub fn vector_out<T: Element>(py: Python<'_>, numbers: Vec<T>) -> Bound<'_, PyArray1<T>> {
    numbers.into_pyarray(py)
}

/// A table on its way to Python, without a copy: `numbers` row after row.
pub fn table_out<T: Element>(py: Python<'_>, numbers: Vec<T>, columns: usize) -> PyResult<Bound<'_, PyArray2<T>>> {
    let rows = numbers.len().checked_div(columns).unwrap_or(0);
    numbers.into_pyarray(py).reshape([rows, columns])
}
