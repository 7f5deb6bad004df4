//! Neighbours, closest points and rays.

use crate::convert::{MeshArrays, table, table_out, vector, vector_out};
use crate::error;
use crate::run;
use beltrami::near::{self, Bvh, KdTree};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

fn same_dimension(py: Python<'_>, points: usize, queries: usize) -> PyResult<()> {
    if points == queries {
        return Ok(());
    }
    Err(error::input(py, format!("queries have {queries} coordinates, points have {points}")))
}

/// Indices and distances of the nearest points to each query.
#[pyfunction]
#[pyo3(signature = (points, queries, wanted, progress=None))]
pub fn nearest_neighbors<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    queries: PyReadonlyArray2<'py, f64>,
    wanted: usize,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray2<i32>>, Bound<'py, PyArray2<f64>>)> {
    let (points, dimension) = table(&points)?;
    let (queries, columns) = table(&queries)?;
    same_dimension(py, dimension, columns)?;
    let (indices, distances) =
        run::watched(py, progress, |control| KdTree::new(points, dimension, control)?.nearest(queries, wanted, control))?;
    Ok((table_out(py, bytemuck::cast_vec(indices), wanted)?, table_out(py, distances, wanted)?))
}

/// Index and distance of the nearest point to each query, by matrix products.
#[pyfunction]
#[pyo3(signature = (points, queries, progress=None))]
pub fn nearest_rows<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    queries: PyReadonlyArray2<'py, f64>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray1<i32>>, Bound<'py, PyArray1<f64>>)> {
    let (points, dimension) = table(&points)?;
    let (queries, columns) = table(&queries)?;
    same_dimension(py, dimension, columns)?;
    let (indices, distances) = run::watched(py, progress, |control| near::nearest_rows(points, dimension, queries, control))?;
    Ok((vector_out(py, bytemuck::cast_vec(indices)), vector_out(py, distances)))
}

/// List starts, indices and distances of the points within a radius of each query.
#[pyfunction]
#[pyo3(signature = (points, queries, radius, most, progress=None))]
#[allow(clippy::type_complexity)]
pub fn neighbors_within<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    queries: PyReadonlyArray2<'py, f64>,
    radius: f64,
    most: usize,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray1<f64>>)> {
    let (points, dimension) = table(&points)?;
    let (queries, columns) = table(&queries)?;
    same_dimension(py, dimension, columns)?;
    let found = run::watched(py, progress, |control| KdTree::new(points, dimension, control)?.within(queries, radius, most, control))?;
    let starts = found.starts.into_iter().map(|start| start as i64).collect();
    Ok((vector_out(py, starts), vector_out(py, bytemuck::cast_vec(found.indices)), vector_out(py, found.distances)))
}

/// Points, distances, faces and barycentric coordinates of the closest points of a mesh.
#[pyfunction]
#[pyo3(signature = (mesh, queries, progress=None))]
#[allow(clippy::type_complexity)]
pub fn closest_points<'py>(
    py: Python<'py>,
    mesh: MeshArrays<'py>,
    queries: PyReadonlyArray2<'py, f64>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray2<f64>>)> {
    let mesh = mesh.mesh()?;
    let (queries, columns) = table(&queries)?;
    if columns != mesh.dimension() {
        return Err(error::input(py, format!("queries have {columns} coordinates, the mesh lies in R^{}", mesh.dimension())));
    }
    let found = run::watched(py, progress, |control| Bvh::new(&mesh, control)?.closest(queries, control))?;
    Ok((
        table_out(py, found.points, columns)?,
        vector_out(py, found.distances),
        vector_out(py, bytemuck::cast_vec(found.faces)),
        table_out(py, bytemuck::cast_slice(&found.barycentric).to_vec(), 3)?,
    ))
}

/// Faces (-1: missed), distances (inf: missed) and barycentric coordinates of first hits.
#[pyfunction]
#[pyo3(signature = (mesh, origins, directions, progress=None))]
#[allow(clippy::type_complexity)]
pub fn intersect_rays<'py>(
    py: Python<'py>,
    mesh: MeshArrays<'py>,
    origins: PyReadonlyArray2<'py, f64>,
    directions: PyReadonlyArray2<'py, f64>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray1<i32>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>)> {
    let mesh = mesh.mesh()?;
    let ((origins, columns), (directions, others)) = (table(&origins)?, table(&directions)?);
    if columns != 3 || others != 3 || mesh.dimension() != 3 {
        return Err(error::input(
            py,
            format!("origins have {columns} coordinates, directions {others}, the mesh {}; rays live in R^3", mesh.dimension()),
        ));
    }
    let found = run::watched(py, progress, |control| Bvh::new(&mesh, control)?.intersect(origins, directions, control))?;
    // u32::MAX is -1 as int32
    Ok((
        vector_out(py, bytemuck::cast_vec(found.faces)),
        vector_out(py, found.distances),
        table_out(py, bytemuck::cast_slice(&found.barycentric).to_vec(), 3)?,
    ))
}

/// Consistently oriented unit normals of points.
#[pyfunction]
#[pyo3(signature = (points, neighbors, progress=None))]
pub fn normals<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    neighbors: usize,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (points, dimension) = table(&points)?;
    let found = run::watched(py, progress, |control| near::normals(points, dimension, neighbors, control))?;
    table_out(py, found, dimension)
}

/// Normals oriented alike along edges within the surface, and the share of such edges across which they are not.
#[pyfunction]
#[pyo3(signature = (points, fitted, linked, progress=None))]
pub fn oriented_normals<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    fitted: usize,
    linked: usize,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, f64)> {
    let (points, dimension) = table(&points)?;
    let found = run::watched(py, progress, |control| near::oriented(points, dimension, fitted, linked, control))?;
    Ok((table_out(py, found.normals, dimension)?, found.seam))
}

/// Mean, least axis and its share of the variance of the points in each row of `near`.
#[pyfunction]
pub fn plane_fits<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    near: PyReadonlyArray2<'py, i32>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
    let ((points, dimension), (near, neighbors)) = (table(&points)?, table(&near)?);
    let found = run::watched(py, None, |control| near::plane_fits(points, dimension, bytemuck::cast_slice(near), neighbors, control))?;
    Ok((table_out(py, found.means, dimension)?, table_out(py, found.normals, dimension)?, vector_out(py, found.shares)))
}

/// Distances (k, directions) of grouped points from places, in sectors of the planes across the tangents; negative where there are none.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "arrays of two structs")]
pub fn sectors<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    starts: PyReadonlyArray1<'py, i64>,
    axis: usize,
    places: PyReadonlyArray2<'py, f64>,
    tangents: PyReadonlyArray2<'py, f64>,
    first: PyReadonlyArray2<'py, f64>,
    second: PyReadonlyArray2<'py, f64>,
    reach: PyReadonlyArray1<'py, f64>,
    thickness: PyReadonlyArray1<'py, f64>,
    group: PyReadonlyArray1<'py, i32>,
    directions: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let starts: Vec<usize> = vector(&starts)?.iter().map(|&start| start as usize).collect();
    let grouped = near::Grouped { points: table(&points)?.0, starts: &starts, axis };
    let planes = near::Planes {
        places: table(&places)?.0,
        tangents: table(&tangents)?.0,
        frames: [table(&first)?.0, table(&second)?.0],
        reach: vector(&reach)?,
        thickness: vector(&thickness)?,
        group: vector(&group)?,
    };
    let found = run::watched(py, None, |control| near::sectors(&grouped, &planes, directions, control))?;
    table_out(py, found, directions)
}
