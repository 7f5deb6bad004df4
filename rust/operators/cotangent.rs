//! Piecewise-linear finite elements on a triangle mesh in R^D.
//!
//! With hat functions φ_i, `L_ij = ∫ grad φ_i . grad φ_j = -(cot α_ij + cot β_ij) / 2` (α, β the angles opposite to the edge
//! ij) and the gradient of φ_k is constant on each triangle. Pinkall & Polthier 1993; Meyer et al. 2003 for the mixed
//! Voronoi areas.

use super::corners::Corners;
use crate::error::{Error, Result};
use crate::shape::{TriangleMesh, mesh};
use crate::sparse::{CHUNK, Csr, append_sums};
use bytemuck::{Pod, Zeroable};
use pulp::{Arch, Simd, WithSimd};
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
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
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
/// Corners are numbered with 32 bits.
const MOST_FACES: usize = u32::MAX as usize / 3;

struct Measured {
    element: Element,
    squared_lengths: [f64; 3],
}

#[inline(always)]
fn measured(corners: [&[f64]; 3]) -> Measured {
    let [a, b, c] = corners;
    let dot = |p: &[f64], q: &[f64], r: &[f64]| (0..a.len()).map(|i| (q[i] - p[i]) * (r[i] - p[i])).sum::<f64>();
    let area = mesh::area(corners);
    let half_cotangents = [dot(a, b, c), dot(b, c, a), dot(c, a, b)].map(|product| product / (4.0 * area));
    Measured { element: Element { half_cotangents, area }, squared_lengths: mesh::squared_edge_lengths(corners) }
}

impl Measured {
    fn longest(&self) -> f64 {
        self.squared_lengths.iter().copied().fold(0.0, f64::max)
    }

    fn usable(&self) -> bool {
        let (area, longest) = (self.element.area, self.longest());
        SCALE.contains(&longest) && 2.0 * area > DEGENERATE * longest
    }
}

/// Why a triangle has no element.
fn refusal(mesh: &TriangleMesh, face: usize) -> Error {
    let longest = mesh.at_corners(face, measured).longest();
    if longest > 0.0 && !SCALE.contains(&longest) {
        return Error::input(format!(
            "face {face} has an edge of squared length {longest:e}, which is out of the range of double precision; rescale the shape"
        ));
    }
    Error::input(format!(
        "face {face} ({:?}) is degenerate: its corners lie on a line; use an intrinsic Delaunay Laplacian, or remove it",
        mesh.faces()[face]
    ))
}

fn elements(mesh: &TriangleMesh) -> Result<Box<[Element]>> {
    let count = mesh.faces().len();
    if count == 0 {
        return Err(Error::input(format!("the mesh has no triangles ({} vertices); operators need at least one", mesh.vertex_count())));
    }
    if count > MOST_FACES {
        return Err(Error::input(format!("{count} triangles; operators take up to {MOST_FACES}")));
    }
    let mut all: Box<[Element]> = bytemuck::allocation::zeroed_slice_box(count);
    let good = all
        .par_chunks_mut(CHUNK)
        .enumerate()
        .map(|(chunk, elements)| {
            let mut good = true;
            for (face, element) in (chunk * CHUNK..).zip(elements) {
                let found = mesh.at_corners(face, measured);
                good &= found.usable();
                *element = found.element;
            }
            good
        })
        .reduce(|| true, |a, b| a & b);
    if !good {
        let face = (0..count).find(|&face| !mesh.at_corners(face, measured).usable()).unwrap_or_default();
        return Err(refusal(mesh, face));
    }
    Ok(all)
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
    if mesh.faces().len() <= MOST_FACES {
        let corners = Corners::new(mesh.vertex_count(), mesh.faces());
        if let Some(found) = of_fans(mesh, &corners) {
            return Ok(found);
        }
    }
    // some triangle has no element, or the mesh is no surface: one after the other
    let (elements, corners) = (elements(mesh)?, Corners::new(mesh.vertex_count(), mesh.faces()));
    let stiffness = assemble(&corners, true, |corner, row| {
        let (face, at) = (corner as usize / 3, corner as usize % 3);
        let (next, last) = NEIGHBORS[at];
        let (face, Element { half_cotangents, .. }) = (mesh.faces()[face], elements[face]);
        row.extend([(face[next], -half_cotangents[last]), (face[last], -half_cotangents[next])]);
    });
    let mass = lumped(&corners, |corner| elements[corner as usize / 3].area / 3.0);
    let spacing = mean_edge_length(mesh, &stiffness);
    Ok(MeshOperators { stiffness, mass, spacing })
}

/// The corners after and before each corner of a triangle.
const NEIGHBORS: [(usize, usize); 3] = [(1, 2), (2, 0), (0, 1)];

/// The operators of a mesh whose vertices are each surrounded once by their faces, or from boundary to boundary: as the
/// lengths of the rows are known before, they are written at once to where they stay, each from the positions around its vertex.
/// None if a vertex is not like that, or a triangle has no element.
fn of_fans(mesh: &TriangleMesh, corners: &Corners) -> Option<MeshOperators> {
    let count = corners.vertex_count();
    let mut starts = Vec::with_capacity(count + 1);
    let mut sum = 0;
    starts.push(0);
    for vertex in 0..count {
        let neighbors = corners.fan_neighbors(vertex);
        sum += if neighbors == 0 { 0 } else { neighbors + 1 };
        starts.push(sum);
    }
    let (mut indices, mut values, mut mass) = (vec![0; sum], vec![0.0; sum], vec![0.0; count]);
    let mut tasks = Vec::with_capacity(count.div_ceil(CHUNK));
    let (mut left_indices, mut left_values) = (indices.as_mut_slice(), values.as_mut_slice());
    for (chunk, mass) in mass.chunks_mut(CHUNK).enumerate() {
        let first = chunk * CHUNK;
        let size = starts[first + mass.len()] - starts[first];
        let (indices, after_indices) = std::mem::take(&mut left_indices).split_at_mut(size);
        let (values, after_values) = std::mem::take(&mut left_values).split_at_mut(size);
        (left_indices, left_values) = (after_indices, after_values);
        tasks.push(Fans { mesh, corners, starts: &starts, first, indices, values, mass });
    }
    let edges: Vec<f64> = tasks.into_par_iter().with_max_len(1).map(|fans| Arch::new().dispatch(fans)).collect::<Option<_>>()?;
    let ends = sum - (0..count).filter(|&vertex| starts[vertex + 1] > starts[vertex]).count();
    let stiffness = Csr::trusted(count, count, starts, indices, values);
    (ends > 0).then(|| MeshOperators { stiffness, mass, spacing: edges.iter().sum::<f64>() / ends as f64 })
}

/// Vertices whose surroundings are loaded together.
const BLOCK: usize = 32;

/// Some rows in a run.
struct Fans<'a> {
    mesh: &'a TriangleMesh<'a>,
    corners: &'a Corners,
    starts: &'a [usize],
    first: usize,
    indices: &'a mut [u32],
    values: &'a mut [f64],
    mass: &'a mut [f64],
}

impl WithSimd for Fans<'_> {
    /// Lengths of edges, so that over all rows each edge counts twice; none if a row is no fan or a triangle has no element.
    type Output = Option<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Option<f64> {
        match self.mesh.dimension() {
            2 => self.rows::<2>(),
            3 => self.rows::<3>(),
            _ => self.rows::<0>(),
        }
    }
}

impl Fans<'_> {
    /// Fills the rows; D the dimension of space, 0 for those that have no fast way.
    #[inline(always)]
    fn rows<const D: usize>(self) -> Option<f64> {
        let points: &[[f64; D]] = if D > 0 { self.mesh.vertices().as_chunks().0 } else { &[] };
        let (mut triangles, mut positions, mut work) = (Vec::new(), Vec::new(), Vec::new());
        let (count, before) = (self.mass.len(), self.starts[self.first]);
        let mut edges = 0.0;
        for block in (0..count).step_by(BLOCK) {
            let vertices = self.first + block..self.first + (block + BLOCK).min(count);
            // loads that wait for nothing but memory, many at a time
            triangles.clear();
            triangles.extend(self.corners.of_run(vertices.clone()).iter().map(|&corner| self.mesh.faces()[corner as usize / 3]));
            if D > 0 {
                positions.clear();
                positions.extend(triangles.iter().map(|face: &[u32; 3]| face.map(|id| points[id as usize])));
            }
            let mut at = 0;
            for vertex in vertices {
                let around = self.corners.of(vertex);
                let range = self.starts[vertex] - before..self.starts[vertex + 1] - before;
                let here = at..at + around.len();
                at = here.end;
                let mut row = Row {
                    vertex: vertex as u32,
                    around,
                    faces: &triangles[here.clone()],
                    indices: &mut self.indices[range.clone()],
                    values: &mut self.values[range],
                    mass: &mut self.mass[vertex - self.first],
                };
                let closed = match around.len() {
                    0 => Some(0.0),
                    1..=8 if D > 0 => row.closed::<8, D>(&positions[here]),
                    9..=16 if D > 0 => row.closed::<16, D>(&positions[here]),
                    _ => None,
                };
                edges += match closed {
                    Some(lengths) => lengths,
                    None => row.open(self.mesh, &mut work)?,
                };
            }
        }
        Some(edges)
    }
}

/// A row to be filled.
struct Row<'a> {
    vertex: u32,
    /// Corners that lie on the vertex, and the vertices of their triangles.
    around: &'a [u32],
    faces: &'a [[u32; 3]],
    indices: &'a mut [u32],
    values: &'a mut [f64],
    mass: &'a mut f64,
}

impl Row<'_> {
    /// Up to N faces of one orientation that close around the vertex: each neighbour is the next of one corner and the last of another.
    /// The lengths of the edges to its neighbours; none if it is not so. N triangles are measured side by side, with the very
    /// operations of [`measured`], so that both rows of an edge get the same sum; and without branches that depend on the mesh.
    #[inline(always)]
    fn closed<const N: usize, const D: usize>(&mut self, positions: &[[[f64; D]; 3]]) -> Option<f64> {
        let size = self.around.len();
        if size + 1 != self.indices.len() {
            return None;
        }
        // corner, axis, triangle; lanes without a triangle hold half a unit square
        let mut x = [[[0.0; N]; D]; 3];
        (x[1][0], x[2][1]) = ([1.0; N], [1.0; N]);
        let (mut nexts, mut lasts, mut ats) = ([u32::MAX; N], [u32::MAX; N], [0u64; N]);
        for (lane, ((&corner, face), triangle)) in self.around.iter().zip(self.faces).zip(positions).enumerate().take(N) {
            let at = corner as usize % 3;
            for (x, point) in x.iter_mut().zip(triangle) {
                for (x, &coordinate) in x.iter_mut().zip(point) {
                    x[lane] = coordinate;
                }
            }
            let (next, last) = NEIGHBORS[at];
            (nexts[lane], lasts[lane], ats[lane]) = (face[next], face[last], at as u64);
        }
        let (mut next_values, mut last_values, mut areas, mut lengths) = ([0.0; N], [0.0; N], [0.0; N], [0.0; N]);
        let mut bad = [false; N];
        for lane in 0..N {
            let point: [[f64; D]; 3] = std::array::from_fn(|corner| std::array::from_fn(|axis| x[corner][axis][lane]));
            let [a, b, c] = &point;
            let dot = |p: &[f64; D], q: &[f64; D], r: &[f64; D]| (0..D).map(|i| (q[i] - p[i]) * (r[i] - p[i])).sum::<f64>();
            let dots = [dot(a, b, c), dot(b, c, a), dot(c, a, b)];
            let squared = mesh::squared_edge_lengths([a, b, c]);
            let square = mesh::squared_double_area([a, b, c]);
            let area = 0.5 * square.sqrt();
            let longest = squared[0].max(squared[1]).max(squared[2]);
            let usable = mesh::PLAIN.contains(&square) & SCALE.contains(&longest) & (2.0 * area > DEGENERATE * longest);
            let pick = |of: &[f64; 3], corners: [usize; 3]| match ats[lane] {
                0 => of[corners[0]],
                1 => of[corners[1]],
                _ => of[corners[2]],
            };
            bad[lane] = !usable;
            areas[lane] = area / 3.0;
            next_values[lane] = -(pick(&dots, [2, 0, 1]) / (4.0 * area));
            last_values[lane] = -(pick(&dots, [1, 2, 0]) / (4.0 * area));
            lengths[lane] = pick(&squared, [2, 0, 1]).sqrt();
        }
        // each neighbour's other triangle, and its place in the row
        let (mut partners, mut places) = ([0u32; N], [0u32; N]);
        for k in 0..N {
            places[k] = u32::from(self.vertex < nexts[k]);
        }
        for other in 0..size.min(N) {
            for k in 0..N {
                let same = nexts[k] == lasts[other];
                partners[k] += u32::from(same);
                next_values[k] += if same { last_values[other] } else { 0.0 };
                places[k] += u32::from(nexts[other] < nexts[k]);
            }
        }
        if bad.contains(&true) || partners[..size] != [1; N][..size] {
            return None;
        }
        for k in 0..size.min(N) {
            let at = places[k] as usize;
            *self.indices.get_mut(at)? = nexts[k];
            *self.values.get_mut(at)? = next_values[k];
        }
        let own = nexts[..size].iter().map(|&next| usize::from(next < self.vertex)).sum::<usize>();
        self.indices[own] = self.vertex;
        self.values[own] = 0.0;
        self.values[own] = -self.values.iter().sum::<f64>();
        *self.mass = areas[..size].iter().sum();
        Some(lengths[..size].iter().sum())
    }

    /// Any faces around the vertex with one or two at each edge; the lengths of the edges as their rows share them. None if it is
    /// not so, or a triangle has no element.
    fn open(&mut self, mesh: &TriangleMesh, work: &mut Vec<(u32, f64)>) -> Option<f64> {
        work.clear();
        work.push((self.vertex, 0.0));
        *self.mass = 0.0;
        for (&corner, face) in self.around.iter().zip(self.faces) {
            let (next, last) = NEIGHBORS[corner as usize % 3];
            let found = mesh.at_corners(corner as usize / 3, measured);
            if !found.usable() {
                return None;
            }
            let Element { half_cotangents, area } = found.element;
            work.extend([(face[next], -half_cotangents[last]), (face[last], -half_cotangents[next])]);
            *self.mass += area / 3.0;
        }
        work.sort_by_key(|&(column, _)| column);
        let (mut length, mut slot, mut own) = (0.0, 0, 0);
        for same in work.chunk_by(|a, b| a.0 == b.0) {
            let column = same[0].0;
            *self.indices.get_mut(slot)? = column;
            self.values[slot] = same[1..].iter().fold(same[0].1, |sum, entry| sum + entry.1);
            match same.len() {
                1 if column == self.vertex => own = slot,
                1 | 2 => {
                    let (p, q) = (mesh.vertex(self.vertex), mesh.vertex(column));
                    length += p.iter().zip(q).map(|(x, y)| (x - y) * (x - y)).sum::<f64>().sqrt();
                }
                _ => return None,
            }
            slot += 1;
        }
        self.values[own] = -self.values.iter().sum::<f64>();
        (slot == self.indices.len()).then_some(length)
    }
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
/// ```
/// use beltrami::{TriangleMesh, operators::voronoi_mass};
/// let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0], vec![[0, 1, 2]])?;
/// assert_eq!(voronoi_mass(&mesh)?, [0.25, 0.125, 0.125]);
/// # Ok::<(), beltrami::Error>(())
/// ```
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
/// ```
/// use beltrami::{TriangleMesh, operators::galerkin_mass};
/// let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0], vec![[0, 1, 2]])?;
/// assert_eq!(galerkin_mass(&mesh)?.row(0).1, [1.0 / 12.0, 1.0 / 24.0, 1.0 / 24.0]);
/// # Ok::<(), beltrami::Error>(())
/// ```
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
/// ```
/// use beltrami::{TriangleMesh, operators::gradient};
/// let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0], vec![[0, 1, 2]])?;
/// let gradient = gradient(&mesh)?; // of one face: a row an axis
/// assert_eq!([gradient.row(0).1, gradient.row(1).1], [[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]]);
/// # Ok::<(), beltrami::Error>(())
/// ```
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
/// ```
/// use beltrami::{TriangleMesh, operators::{divergence, voronoi_mass}};
/// let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0], vec![[0, 1, 2]])?;
/// let divergence = divergence(&mesh, &voronoi_mass(&mesh)?)?;
/// assert_eq!([0, 1, 2].map(|vertex| divergence.row(vertex).1), [[2.0, 2.0], [-4.0, 0.0], [0.0, -4.0]]);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// Those of [`cotangent_operators`].
pub fn divergence(mesh: &TriangleMesh, mass: &[f64]) -> Result<Csr> {
    let (elements, corners, dimension) = (elements(mesh)?, Corners::new(mesh.vertex_count(), mesh.faces()), mesh.dimension());
    let count = mesh.vertex_count();
    if mass.len() != count {
        return Err(Error::input(format!("{} masses for a mesh of {count} vertices", mass.len())));
    }
    let starts: Vec<usize> = corners.starts().iter().map(|&start| start as usize * dimension).collect();
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
