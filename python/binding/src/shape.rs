//! Shapes.

use crate::convert::{MeshArrays, table_out, vector_out};
use crate::{error, run};
use beltrami::shape::{Topology, make};
use beltrami::{Control, TriangleMesh};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

/// Area of each triangle.
#[pyfunction]
pub fn face_areas<'py>(py: Python<'py>, mesh: MeshArrays<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let mesh = mesh.mesh()?;
    let areas = run::brief(py, || Ok(mesh.face_areas()))?;
    Ok(vector_out(py, areas))
}

/// Checks a mesh: finite coordinates, faces in range.
#[pyfunction]
pub fn check_mesh(mesh: MeshArrays<'_>) -> PyResult<()> {
    mesh.mesh().map(|_| ())
}

/// What `beltrami.shapes` keeps of a mesh's connectivity, in the order of its `_Topology`.
type TopologyParts<'py> = (
    Bound<'py, PyArray2<i32>>,
    Bound<'py, PyArray1<i32>>,
    (usize, i64, usize, usize, bool, bool),
    Vec<Bound<'py, PyArray1<i32>>>,
    Option<String>,
    Option<[u32; 2]>,
    Option<String>,
    Option<usize>,
);

fn signed(numbers: Vec<u32>) -> Vec<i32> {
    numbers.into_iter().map(|number| number as i32).collect() // vertices number below 2^31
}

/// Connectivity: edges, component labels, counts, boundary curves, and why the mesh is not manifold, oriented or orientable.
#[pyfunction]
pub fn topology<'py>(py: Python<'py>, mesh: MeshArrays<'py>) -> PyResult<TopologyParts<'py>> {
    let mesh = mesh.mesh()?;
    let (edges, (labels, components), counts, loops, non_manifold, inconsistent, one_sided) = run::watched(py, None, |control| {
        let topology = Topology::new(&mesh)?;
        control.check()?;
        let inconsistent = topology.inconsistent_edge().map(|edge| topology.edges()[edge]);
        let one_sided = topology.turned_faces().err().map(|error| error.to_string());
        control.check()?;
        let loops: Vec<Vec<u32>> = topology.boundary_loops().into_iter().map(|curve| curve.vertices).collect();
        let counts = (
            topology.euler_characteristic(),
            topology.unreferenced_vertices(),
            topology.degenerate_faces(),
            topology.is_closed(),
            topology.non_manifold_edge().is_none(),
        );
        let non_manifold = topology.non_manifold_reason();
        Ok((topology.edges().as_flattened().to_vec(), topology.components(), counts, loops, non_manifold, inconsistent, one_sided))
    })?;
    let genus = (non_manifold.is_none() && one_sided.is_none())
        .then(|| ((2 * components as i64 - counts.0 - loops.len() as i64) / 2).max(0) as usize);
    Ok((
        table_out(py, signed(edges), 2)?,
        vector_out(py, labels),
        (components, counts.0, counts.1, counts.2, counts.3, counts.4),
        loops.into_iter().map(|curve| vector_out(py, signed(curve))).collect(),
        non_manifold,
        inconsistent,
        one_sided,
        genus,
    ))
}

/// Consistently oriented faces.
#[pyfunction]
pub fn oriented_faces<'py>(py: Python<'py>, mesh: MeshArrays<'py>) -> PyResult<Bound<'py, PyArray2<i32>>> {
    let mesh = mesh.mesh()?;
    let faces = run::watched(py, None, |_| Topology::new(&mesh)?.oriented_faces())?;
    table_out(py, signed(faces.into_flattened()), 3)
}

/// Vertices and faces of a mesh that the core made.
type Made<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<i32>>);

fn made<'py>(
    py: Python<'py>,
    progress: Option<&Bound<'py, PyAny>>,
    make: impl FnOnce(&Control) -> beltrami::Result<TriangleMesh<'static>> + Send,
) -> PyResult<Made<'py>> {
    let (dimension, vertices, faces) = run::watched(py, progress, |control| {
        let mesh = make(control)?;
        Ok((mesh.dimension(), mesh.vertices().to_vec(), mesh.faces().as_flattened().to_vec()))
    })?;
    Ok((table_out(py, vertices, dimension)?, table_out(py, signed(faces), 3)?))
}

/// An ellipsoid.
#[pyfunction]
pub fn make_ellipsoid(py: Python<'_>, frequency: usize, semi_axes: [f64; 3]) -> PyResult<Made<'_>> {
    made(py, None, |_| make::ellipsoid(frequency, semi_axes))
}

/// A torus of revolution.
#[pyfunction]
pub fn make_torus(py: Python<'_>, radii: [f64; 2], rows: usize, columns: usize) -> PyResult<Made<'_>> {
    made(py, None, |_| make::torus(radii[0], radii[1], rows, columns))
}

/// A Clifford torus.
#[pyfunction]
pub fn make_flat_torus(py: Python<'_>, radii: [f64; 2], rows: usize, columns: usize) -> PyResult<Made<'_>> {
    made(py, None, |_| make::flat_torus(radii[0], radii[1], rows, columns))
}

/// A flat rectangle.
#[pyfunction]
pub fn make_grid(py: Python<'_>, width: f64, height: f64, rows: usize, columns: usize) -> PyResult<Made<'_>> {
    made(py, None, |_| make::grid(width, height, rows, columns))
}

/// A cylinder.
#[pyfunction]
pub fn make_cylinder(py: Python<'_>, radius: f64, height: f64, rows: usize, columns: usize, closed: bool) -> PyResult<Made<'_>> {
    made(py, None, |_| make::cylinder(radius, height, rows, columns, closed))
}

/// A flat disc.
#[pyfunction]
pub fn make_disc(py: Python<'_>, radius: f64, rings: usize) -> PyResult<Made<'_>> {
    made(py, None, |_| make::disc(radius, rings))
}

/// A tube around a torus knot.
#[pyfunction]
pub fn make_knot(py: Python<'_>, p: usize, q: usize, radii: [f64; 3], rows: usize, columns: usize) -> PyResult<Made<'_>> {
    made(py, None, |_| make::knot(p, q, radii, rows, columns))
}

/// Tori joined smoothly: kind "figure_eight", "double_torus" or "triple_torus".
#[pyfunction]
#[pyo3(signature = (kind, radii, resolution, progress=None))]
pub fn make_tori<'py>(
    py: Python<'py>,
    kind: &str,
    radii: [f64; 2],
    resolution: usize,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Made<'py>> {
    let make = match kind {
        "figure_eight" => make::figure_eight,
        "double_torus" => make::double_torus,
        "triple_torus" => make::triple_torus,
        _ => return Err(error::input(py, format!("there is no maker of {kind:?}"))),
    };
    made(py, progress, |control| make(radii, resolution, control))
}

/// Tubes that meet at the origin.
#[pyfunction]
#[pyo3(signature = (arms, arm_length, tube_radius, resolution, progress=None))]
pub fn make_star<'py>(
    py: Python<'py>,
    arms: usize,
    arm_length: f64,
    tube_radius: f64,
    resolution: usize,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Made<'py>> {
    made(py, progress, |control| make::star(arms, arm_length, tube_radius, resolution, control))
}
