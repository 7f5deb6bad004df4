//! Intrinsic triangulations and their operators.

use crate::convert::{CsrParts, MeshArrays, matrix_out, table, table_out, vector, vector_out};
use crate::{error, run};
use beltrami::shape::{self, IntrinsicTriangulation};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

type Table<'py, T> = Bound<'py, PyArray2<T>>;

/// A triangulation as Python keeps it: vertex count, faces, twins (-1: boundary), lengths (m, 3 each), is a cover.
#[derive(FromPyObject)]
pub struct TriangulationArrays<'py>(usize, PyReadonlyArray2<'py, i32>, PyReadonlyArray2<'py, i32>, PyReadonlyArray2<'py, f64>, bool);

impl TriangulationArrays<'_> {
    fn triangulation(&self) -> PyResult<IntrinsicTriangulation> {
        let faces: &[[u32; 3]] =
            bytemuck::try_cast_slice(table(&self.1)?.0).map_err(|e| error::input(self.1.py(), format!("triangles: {e}")))?;
        let twins: &[u32] = bytemuck::cast_slice(table(&self.2)?.0);
        let (vertices, lengths, cover) = (self.0, table(&self.3)?.0, self.4);
        run::brief(self.1.py(), || IntrinsicTriangulation::from_parts(vertices, faces.to_vec(), twins.to_vec(), lengths.to_vec(), cover))
    }
}

/// What `beltrami.intrinsic` makes its operators of.
type Parts<'py> = (
    CsrParts<'py>,
    Bound<'py, PyArray1<f64>>,
    (Table<'py, i32>, Table<'py, i32>, Table<'py, f64>, Bound<'py, PyArray1<f64>>),
    f64,
    (usize, usize, usize),
);

/// Operators of the intrinsic Delaunay triangulation of a mesh, or of its tufted cover: stiffness; mass; faces, twins, lengths
/// and areas of the triangles; mean edge length; how many edges were flipped and lengthened and faces left out.
#[pyfunction]
#[pyo3(signature = (mesh, cover, voronoi, progress=None))]
pub fn intrinsic_operators<'py>(
    py: Python<'py>,
    mesh: MeshArrays<'py>,
    cover: bool,
    voronoi: bool,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Parts<'py>> {
    let mesh = mesh.mesh()?;
    let (found, stiffness, mass, areas, spacing) = run::watched(py, progress, |control| {
        let found = if cover { shape::tufted(&mesh, control) } else { shape::intrinsic_delaunay(&mesh, control) }?;
        let (stiffness, mass) = (found.stiffness(), if voronoi { found.voronoi_mass() } else { found.mass() });
        let (areas, spacing) = (found.face_areas(), found.spacing());
        Ok((found, stiffness, mass, areas, spacing))
    })?;
    let signed = |numbers: &[u32]| numbers.iter().map(|&number| number as i32).collect::<Vec<_>>(); // u32::MAX becomes -1
    let tables = (
        table_out(py, signed(found.faces().as_flattened()), 3)?,
        table_out(py, signed(found.twins()), 3)?,
        table_out(py, found.lengths(), 3)?,
        vector_out(py, areas),
    );
    let counts = (found.flips(), found.mollified(), found.left_out());
    Ok((matrix_out(py, stiffness), vector_out(py, mass), tables, spacing, counts))
}

/// The gradient on an intrinsic triangulation, (2 m, n).
#[pyfunction]
pub fn intrinsic_gradient<'py>(py: Python<'py>, triangulation: TriangulationArrays<'py>) -> PyResult<CsrParts<'py>> {
    let triangulation = triangulation.triangulation()?;
    let found = run::watched(py, None, |_| Ok(triangulation.gradient()))?;
    Ok(matrix_out(py, found))
}

/// The divergence on an intrinsic triangulation, (n, 2 m).
#[pyfunction]
pub fn intrinsic_divergence<'py>(
    py: Python<'py>,
    triangulation: TriangulationArrays<'py>,
    mass: PyReadonlyArray1<'py, f64>,
) -> PyResult<CsrParts<'py>> {
    let (triangulation, mass) = (triangulation.triangulation()?, vector(&mass)?);
    let found = run::watched(py, None, |_| triangulation.divergence(mass))?;
    Ok(matrix_out(py, found))
}

/// The triangle with the least height for its longest edge, and twice its area over that edge's square.
#[pyfunction]
pub fn thinnest_face(py: Python<'_>, mesh: MeshArrays<'_>) -> PyResult<Option<(usize, f64)>> {
    let mesh = mesh.mesh()?;
    run::brief(py, || Ok(shape::thinnest_face(&mesh)))
}
