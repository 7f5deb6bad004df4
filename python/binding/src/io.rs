//! Files.

use crate::convert::{table, table_out, vector, vector_out};
use crate::{error, run};
use beltrami::io::{Field, Format, Geometry, Reading, Values, Writing, read, read_bytes, write};
use numpy::{
    Element, IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArrayDyn, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use std::path::PathBuf;

/// Vertices (n, D), faces (m, 3), and the data by name.
type Loaded<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<i32>>, Vec<(String, Bound<'py, PyAny>)>);

fn format_named(py: Python<'_>, name: Option<&str>) -> PyResult<Option<Format>> {
    name.map(|name| {
        Format::named(name)
            .ok_or_else(|| error::input(py, format!("format {name:?} is not known; choose obj, ply, stl, off, xyz, pts or csv")))
    })
    .transpose()
}

fn out<'py>(py: Python<'py>, shape: Geometry<'static>) -> PyResult<Loaded<'py>> {
    let count = shape.vertex_count();
    let faces: Vec<i32> = bytemuck::cast_vec(shape.faces.into_owned().into_flattened());
    let data = shape.data.into_iter().map(|field| Ok((field.name.clone(), field_out(py, field, count)?))).collect::<PyResult<_>>()?;
    let vertices = shape.vertices.into_owned().into_pyarray(py).reshape([count, shape.dimension])?;
    Ok((vertices, table_out(py, faces, 3)?, data))
}

fn field_out<'py>(py: Python<'py>, field: Field, count: usize) -> PyResult<Bound<'py, PyAny>> {
    fn array<'py, T: Element>(py: Python<'py>, values: Vec<T>, rows: Option<[usize; 2]>) -> PyResult<Bound<'py, PyAny>> {
        match rows {
            Some(shape) => Ok(values.into_pyarray(py).reshape(shape)?.into_any()),
            None => Ok(vector_out(py, values).into_any()),
        }
    }
    let shape = field.table.then_some([count, field.columns]);
    match field.values {
        Values::Bool(values) => array(py, values, shape),
        Values::I8(values) => array(py, values, shape),
        Values::U8(values) => array(py, values, shape),
        Values::I16(values) => array(py, values, shape),
        Values::U16(values) => array(py, values, shape),
        Values::I32(values) => array(py, values, shape),
        Values::U32(values) => array(py, values, shape),
        Values::I64(values) => array(py, values, shape),
        Values::U64(values) => array(py, values, shape),
        Values::F32(values) => array(py, values, shape),
        Values::F64(values) => array(py, values, shape),
    }
}

fn field_in(name: String, array: &Bound<'_, PyAny>) -> PyResult<Field> {
    fn numbers<T: Element + Clone>(array: &Bound<'_, PyAny>) -> Option<(Vec<T>, usize, bool)> {
        let array: PyReadonlyArrayDyn<'_, T> = array.extract().ok()?;
        if !array.is_c_contiguous() {
            return None;
        }
        let (columns, table) = match array.shape() {
            [_] => (1, false),
            [_, columns] => (*columns, true),
            _ => return None,
        };
        Some((array.as_slice().ok()?.to_vec(), columns, table))
    }
    macro_rules! first_of {
        ($($variant:ident),*) => {
            $(if let Some((values, columns, table)) = numbers(array) {
                return Ok(Field { name, columns, table, values: Values::$variant(values) });
            })*
        };
    }
    first_of!(Bool, I8, U8, I16, U16, I32, U32, I64, U64, F32, F64);
    Err(error::input(array.py(), format!("data {name:?} is no contiguous array of one or two axes of booleans, integers or reals")))
}

fn shape_in<'a>(
    vertices: &'a PyReadonlyArray2<'_, f64>,
    faces: &'a PyReadonlyArray2<'_, i32>,
    data: Vec<(String, Bound<'_, PyAny>)>,
) -> PyResult<Geometry<'a>> {
    let (numbers, dimension) = table(vertices)?;
    let (corners, three) = table(faces)?;
    if three != 3 {
        return Err(error::input(vertices.py(), format!("faces have {three} columns, a triangle has 3")));
    }
    let faces: &[[u32; 3]] = bytemuck::cast_slice(corners);
    let data = data.into_iter().map(|(name, array)| field_in(name, &array)).collect::<PyResult<_>>()?;
    Ok(Geometry { dimension, vertices: numbers.into(), faces: faces.into(), data })
}

/// Reads a file.
#[pyfunction]
pub fn load_file<'py>(
    py: Python<'py>,
    path: PathBuf,
    format: Option<&str>,
    weld: Option<bool>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Loaded<'py>> {
    let reading = Reading { format: format_named(py, format)?, weld };
    let shape = run::watched(py, progress, |control| read(&path, reading, control))?;
    out(py, shape)
}

/// Reads what a file holds; `name` stands for it in errors.
#[pyfunction]
pub fn load_bytes<'py>(
    py: Python<'py>,
    bytes: &[u8],
    name: PathBuf,
    format: Option<&str>,
    weld: Option<bool>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Loaded<'py>> {
    let reading = Reading { format: format_named(py, format)?, weld };
    let shape = run::watched(py, progress, |control| read_bytes(bytes, &name, reading, control))?;
    out(py, shape)
}

/// Writes a file; returns the names of the data that the format has no place for.
#[pyfunction]
pub fn save_file<'py>(
    py: Python<'py>,
    path: PathBuf,
    vertices: PyReadonlyArray2<'py, f64>,
    faces: PyReadonlyArray2<'py, i32>,
    data: Vec<(String, Bound<'py, PyAny>)>,
    format: Option<&str>,
    ascii: bool,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Vec<String>> {
    let writing = Writing { format: format_named(py, format)?, ascii };
    let shape = shape_in(&vertices, &faces, data)?;
    run::watched(py, progress, |control| write(&path, &shape, writing, control))
}

/// Triangles of polygons, given by their sizes and the numbers of their corners one after the other.
#[pyfunction]
pub fn triangulate<'py>(
    py: Python<'py>,
    vertices: PyReadonlyArray2<'py, f64>,
    sizes: PyReadonlyArray1<'py, i64>,
    corners: PyReadonlyArray1<'py, i32>,
) -> PyResult<Bound<'py, PyArray2<i32>>> {
    let (numbers, dimension) = table(&vertices)?;
    let sizes: Vec<usize> = vector(&sizes)?.iter().map(|&size| usize::try_from(size).unwrap_or(usize::MAX)).collect();
    let corners: &[u32] = bytemuck::cast_slice(vector(&corners)?);
    let faces = run::watched(py, None, |control| beltrami::io::triangulate(dimension, numbers, &sizes, corners, control))?;
    table_out(py, bytemuck::cast_vec(faces.into_flattened()), 3)
}

/// The shape with one vertex a position.
#[pyfunction]
pub fn weld<'py>(
    py: Python<'py>,
    vertices: PyReadonlyArray2<'py, f64>,
    faces: PyReadonlyArray2<'py, i32>,
    data: Vec<(String, Bound<'py, PyAny>)>,
) -> PyResult<Loaded<'py>> {
    let shape = shape_in(&vertices, &faces, data)?;
    let Geometry { dimension, vertices, faces, data } = run::watched(py, None, |control| beltrami::io::weld(shape, control))?;
    out(py, Geometry { dimension, vertices: vertices.into_owned().into(), faces: faces.into_owned().into(), data })
}
