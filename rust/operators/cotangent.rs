//! Piecewise-linear finite elements on a triangle mesh in R^D.
//!
//! With hat functions φ_i, `L_ij = ∫ grad φ_i . grad φ_j = -(cot α_ij + cot β_ij) / 2` (α, β the angles opposite to the edge
//! ij) and the gradient of φ_k is constant on each triangle. Pinkall & Polthier 1993; Meyer et al. 2003 for the mixed
//! Voronoi areas.

use super::corners::Corners;
use crate::error::{Error, Result};
use crate::shape::TriangleMesh;
use crate::sparse::{CHUNK, Csr, append_sums};
use rayon::prelude::*;

/// Stiffness, mass and mean edge length of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshOperators {
    /// (n, n), positive semidefinite, symmetric to the last bit, rows sum to zero.
    pub stiffness: Csr,
    /// A third of the adjacent areas at each vertex; 0 at vertices of no triangle.
    pub mass: Vec<f64>,
    /// Mean length of the edges.
    pub spacing: f64,
}

/// What one triangle contributes: half the cotangent at each corner, and its area.
#[derive(Clone, Copy)]
struct Element {
    half_cotangents: [f64; 3],
    area: f64,
}

/// A triangle counts as degenerate when twice its area is below this share of its longest squared edge: then rounding
/// alone decides its angles.
const DEGENERATE: f64 = 4.0 * f64::EPSILON;
/// A weight below this share of the largest one of its row is taken for 0.
const ROUNDING: f64 = 1e-10;
/// Squared edges beyond these bounds over- or underflow in the squared area.
const SCALE: std::ops::Range<f64> = 1e-140..1e150;

fn element(mesh: &TriangleMesh, face: usize) -> Result<Element> {
    let [a, b, c] = mesh.faces()[face].map(|corner| mesh.vertex(corner));
    let dot = |p: &[f64], q: &[f64], r: &[f64]| (0..mesh.dimension()).map(|i| (q[i] - p[i]) * (r[i] - p[i])).sum::<f64>();
    let area = mesh.face_area(face);
    let longest = mesh.squared_edge_lengths(face).into_iter().fold(0.0, f64::max);
    if longest > 0.0 && !SCALE.contains(&longest) {
        return Err(Error::input(format!(
            "face {face} has an edge of squared length {longest:e}, which is out of the range of double precision; rescale the shape"
        )));
    }
    if 2.0 * area <= DEGENERATE * longest || area == 0.0 {
        return Err(Error::input(format!(
            "face {face} ({:?}) is degenerate: its corners lie on a line; use laplacian=\"intrinsic_delaunay\", or remove it",
            mesh.faces()[face]
        )));
    }
    let half_cotangents = [dot(a, b, c), dot(b, c, a), dot(c, a, b)].map(|product| product / (4.0 * area));
    Ok(Element { half_cotangents, area })
}

fn elements(mesh: &TriangleMesh) -> Result<Vec<Element>> {
    let count = mesh.faces().len();
    if count == 0 {
        return Err(Error::input(format!("the mesh has no triangles ({} vertices); operators need at least one", mesh.vertex_count())));
    }
    if count > u32::MAX as usize / 3 {
        return Err(Error::input(format!("{count} triangles; operators take up to {}", u32::MAX / 3)));
    }
    let mut elements = vec![Element { half_cotangents: [0.0; 3], area: 0.0 }; count];
    let failed = elements.par_chunks_mut(CHUNK).enumerate().find_map_first(|(chunk, elements)| {
        elements.iter_mut().enumerate().find_map(|(offset, out)| match element(mesh, chunk * CHUNK + offset) {
            Ok(found) => {
                *out = found;
                None
            }
            Err(error) => Some(error),
        })
    });
    failed.map_or(Ok(elements), Err)
}

/// A symmetric matrix from what each corner adds to its row: `entries(corner, put)` puts (column, value) pairs.
/// Repeated columns are added up in the order of faces, so that entry (i, j) and entry (j, i) are the same sum.
fn assemble(corners: &Corners, diagonal: bool, entries: impl Fn(u32, &mut Vec<(u32, f64)>) + Sync) -> Csr {
    let count = corners.vertex_count();
    Csr::by_rows(count, count, |vertex, row: &mut Vec<(u32, f64)>, indices, values| {
        row.clear();
        if diagonal && !corners.of(vertex).is_empty() {
            row.push((vertex as u32, 0.0));
        }
        for &corner in corners.of(vertex) {
            entries(corner, row);
        }
        row.sort_by_key(|&(column, _)| column); // stable: faces stay in order
        let first = indices.len();
        append_sums(row.iter().copied(), indices, values);
        if diagonal {
            let sum: f64 = values[first..].iter().sum();
            if let Some(at) = indices[first..].iter().position(|&column| column as usize == vertex) {
                values[first + at] = -sum;
            }
        }
    })
}

fn lumped(corners: &Corners, share: impl Fn(u32) -> f64 + Sync) -> Vec<f64> {
    (0..corners.vertex_count())
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|vertex| corners.of(vertex).iter().map(|&corner| share(corner)).sum())
        .collect()
}

fn mean_edge_length(mesh: &TriangleMesh, stiffness: &Csr) -> f64 {
    let parts: Vec<(f64, usize)> = (0..stiffness.rows().div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let (mut sum, mut number) = (0.0, 0);
            for row in chunk * CHUNK..((chunk + 1) * CHUNK).min(stiffness.rows()) {
                let here = mesh.vertex(row as u32);
                for &column in stiffness.row(row).0.iter().filter(|&&column| column as usize > row) {
                    sum += here.iter().zip(mesh.vertex(column)).map(|(x, y)| (x - y) * (x - y)).sum::<f64>().sqrt();
                    number += 1;
                }
            }
            (sum, number)
        })
        .collect();
    let (sum, number) = parts.into_iter().fold((0.0, 0), |(s, n), (sum, number)| (s + sum, n + number));
    if number == 0 { 0.0 } else { sum / number as f64 }
}

/// Cotangent stiffness, lumped mass and mean edge length.
///
/// ```
/// use beltrami::{TriangleMesh, operators::cotangent_operators};
/// let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0], vec![[0, 1, 2]])?;
/// let operators = cotangent_operators(&mesh)?;
/// assert_eq!(operators.stiffness.row(0).1, [1.0, -0.5, -0.5]);
/// assert_eq!(operators.mass, [0.5 / 3.0; 3]);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if there is no triangle, one is degenerate, or its size is out of the range of double precision.
pub fn cotangent_operators(mesh: &TriangleMesh) -> Result<MeshOperators> {
    let (elements, corners) = (elements(mesh)?, Corners::new(mesh.vertex_count(), mesh.faces()));
    let stiffness = assemble(&corners, true, |corner, row| {
        let (face, at) = (corner as usize / 3, corner as usize % 3);
        let (next, last) = ((at + 1) % 3, (at + 2) % 3);
        let element = &elements[face];
        row.push((mesh.faces()[face][next], -element.half_cotangents[last]));
        row.push((mesh.faces()[face][last], -element.half_cotangents[next]));
    });
    let mass = lumped(&corners, |corner| elements[corner as usize / 3].area / 3.0);
    let spacing = mean_edge_length(mesh, &stiffness);
    Ok(MeshOperators { stiffness, mass, spacing })
}

/// True if an edge of a stiffness matrix has a positive weight (an entry off the diagonal above rounding), as edges do that are not
/// Delaunay or face an obtuse angle at the boundary. Without one, solutions of the heat equation cannot become negative.
///
/// ```
/// use beltrami::{TriangleMesh, operators::{cotangent_operators, has_positive_weights}};
/// let flat = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 0.5, 0.1], vec![[0, 1, 2]])?;
/// assert!(has_positive_weights(&cotangent_operators(&flat)?.stiffness));
/// # Ok::<(), beltrami::Error>(())
/// ```
pub fn has_positive_weights(stiffness: &Csr) -> bool {
    (0..stiffness.rows()).into_par_iter().with_min_len(CHUNK).any(|row| {
        let (columns, values) = stiffness.row(row);
        let size = values.iter().fold(0.0, |size: f64, value| size.max(value.abs()));
        columns.iter().zip(values).any(|(&column, &value)| column as usize != row && value > ROUNDING * size)
    })
}

/// Mixed Voronoi areas of the vertices (Meyer et al. 2003): Voronoi areas where a triangle is acute; in an obtuse one half
/// of its area goes to the obtuse corner and a quarter to each other. They sum to the total area.
///
/// # Errors
/// Those of [`cotangent_operators`].
pub fn voronoi_mass(mesh: &TriangleMesh) -> Result<Vec<f64>> {
    let (elements, corners) = (elements(mesh)?, Corners::new(mesh.vertex_count(), mesh.faces()));
    Ok(lumped(&corners, |corner| {
        let (face, at) = (corner as usize / 3, corner as usize % 3);
        let Element { half_cotangents: cotangents, area } = elements[face];
        match cotangents.iter().position(|&cotangent| cotangent < 0.0) {
            Some(obtuse) if obtuse == at => area / 2.0,
            Some(_) => area / 4.0,
            None => {
                let squared = mesh.squared_edge_lengths(face);
                let (next, last) = ((at + 1) % 3, (at + 2) % 3);
                (squared[next] * cotangents[next] + squared[last] * cotangents[last]) / 4.0
            }
        }
    }))
}

/// The consistent (Galerkin) mass matrix `∫ φ_i φ_j`: a twelfth of the adjacent areas off the diagonal, a sixth on it.
///
/// # Errors
/// Those of [`cotangent_operators`].
pub fn galerkin_mass(mesh: &TriangleMesh) -> Result<Csr> {
    let (elements, corners) = (elements(mesh)?, Corners::new(mesh.vertex_count(), mesh.faces()));
    Ok(assemble(&corners, false, |corner, row| {
        let (face, at) = (corner as usize / 3, corner as usize % 3);
        for other in 0..3 {
            row.push((mesh.faces()[face][other], elements[face].area / if other == at { 6.0 } else { 12.0 }));
        }
    }))
}

/// Gradient of the hat function of one corner: (c_l (p_k - p_j) + c_j (p_k - p_l)) / area, with half cotangents c.
fn hat_gradient(mesh: &TriangleMesh, element: &Element, face: usize, corner: usize, axis: usize) -> f64 {
    let (next, last) = ((corner + 1) % 3, (corner + 2) % 3);
    let position = |at: usize| mesh.vertex(mesh.faces()[face][at])[axis];
    let here = position(corner);
    (element.half_cotangents[last] * (here - position(next)) + element.half_cotangents[next] * (here - position(last))) / element.area
}

/// The gradient, (m D, n): row `D face + axis` gives one coordinate of the tangent vector on a face.
///
/// # Errors
/// Those of [`cotangent_operators`].
pub fn gradient(mesh: &TriangleMesh) -> Result<Csr> {
    let (elements, dimension) = (elements(mesh)?, mesh.dimension());
    let rows = elements.len() * dimension;
    let (mut indices, mut values) = (vec![0; 3 * rows], vec![0.0; 3 * rows]);
    let width = 3 * dimension;
    indices.par_chunks_mut(CHUNK * width).zip(values.par_chunks_mut(CHUNK * width)).enumerate().for_each(|(chunk, (indices, values))| {
        for (offset, (indices, values)) in indices.chunks_mut(width).zip(values.chunks_mut(width)).enumerate() {
            let face = chunk * CHUNK + offset;
            let corners = mesh.faces()[face];
            let mut order = [0, 1, 2];
            order.sort_by_key(|&at| corners[at]);
            for axis in 0..dimension {
                for (slot, &at) in order.iter().enumerate() {
                    indices[3 * axis + slot] = corners[at];
                    values[3 * axis + slot] = hat_gradient(mesh, &elements[face], face, at, axis);
                }
            }
        }
    });
    Ok(Csr::trusted(rows, mesh.vertex_count(), (0..=rows).map(|row| 3 * row).collect(), indices, values))
}

/// The divergence, (n, m D): the negative adjoint of the gradient in the area and mass inner products,
/// `-diag(mass)^-1 G^T diag(area)`. Rows of vertices without mass are empty.
///
/// # Errors
/// Those of [`cotangent_operators`].
pub fn divergence(mesh: &TriangleMesh, mass: &[f64]) -> Result<Csr> {
    let (elements, corners, dimension) = (elements(mesh)?, Corners::new(mesh.vertex_count(), mesh.faces()), mesh.dimension());
    let count = mesh.vertex_count();
    if mass.len() != count {
        return Err(Error::input(format!("{} masses for a mesh of {count} vertices", mass.len())));
    }
    let starts: Vec<usize> = corners.starts().iter().map(|start| start * dimension).collect();
    let columns = elements.len() * dimension;
    if columns > u32::MAX as usize {
        return Err(Error::input(format!("{columns} columns; a matrix can have up to 2^32 - 1")));
    }
    let pairs: Vec<(u32, f64)> = (0..count)
        .into_par_iter()
        .with_min_len(CHUNK)
        .flat_map_iter(|vertex| {
            let (elements, mass) = (&elements, mass[vertex]);
            corners.of(vertex).iter().flat_map(move |&corner| {
                let (face, at) = (corner as usize / 3, corner as usize % 3);
                let factor = if mass > 0.0 { -elements[face].area / mass } else { 0.0 };
                (0..dimension)
                    .map(move |axis| ((face * dimension + axis) as u32, factor * hat_gradient(mesh, &elements[face], face, at, axis)))
            })
        })
        .collect();
    let (indices, values) = pairs.into_par_iter().unzip();
    Ok(Csr::trusted(count, columns, starts, indices, values))
}
