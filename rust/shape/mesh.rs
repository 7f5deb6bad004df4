//! Triangle meshes with vertices in R^D.

use crate::error::{Error, Result};
use crate::sparse::{CHUNK, first_not_finite};
use rayon::prelude::*;
use std::borrow::Cow;

/// Vertices in R^D and triangles between them. Both are kept in the order they came in; nothing is ever merged or dropped.
///
/// A mesh owns its arrays or borrows them (what the binding does with numpy's). Checked on construction: coordinates are
/// finite and corners exist. Everything else (degenerate, repeated, flipped or non-manifold triangles, vertices of no
/// triangle) is allowed here, and the kernels that cannot live with it say so.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangleMesh<'a> {
    dimension: usize,
    vertices: Cow<'a, [f64]>,
    faces: Cow<'a, [[u32; 3]]>,
}

impl<'a> TriangleMesh<'a> {
    /// A mesh of vertices, `dimension` coordinates each, one after the other, and of faces, three vertex numbers each.
    ///
    /// ```
    /// use beltrami::TriangleMesh;
    /// let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0], vec![[0, 1, 2]])?;
    /// assert_eq!(mesh.area(), 0.5);
    /// let broken = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0], vec![[0, 1, 2]]).unwrap_err();
    /// assert_eq!(broken.to_string(), "face 0 refers to vertex 2, the mesh has 2 vertices");
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if `dimension` < 2 or does not divide the numbers, a coordinate is not finite, or a face refers to
    /// a vertex that is not there.
    pub fn new(dimension: usize, vertices: impl Into<Cow<'a, [f64]>>, faces: impl Into<Cow<'a, [[u32; 3]]>>) -> Result<Self> {
        let (vertices, faces) = (vertices.into(), faces.into());
        if dimension < 2 {
            return Err(Error::input(format!("vertices have {dimension} coordinates; a surface needs 2 or more")));
        }
        if vertices.len() % dimension != 0 {
            return Err(Error::input(format!("{} coordinates are no whole number of vertices in R^{dimension}", vertices.len())));
        }
        let count = vertices.len() / dimension;
        if count > u32::MAX as usize / 2 {
            return Err(Error::input(format!("{count} vertices; a mesh can have up to 2^31 - 1")));
        }
        if let Some(at) = first_not_finite(&vertices) {
            return Err(Error::input(format!(
                "coordinate {} of vertex {} is {}; remove that vertex or give it a finite position",
                at % dimension,
                at / dimension,
                vertices[at]
            )));
        }
        let corners = faces.as_flattened();
        let largest = corners.par_chunks(CHUNK).map(|part| part.iter().fold(0, |most: u32, &corner| most.max(corner))).max();
        if largest.is_some_and(|largest| largest as usize >= count) {
            let at = corners.iter().position(|&corner| corner as usize >= count).unwrap_or_default();
            return Err(Error::input(format!("face {} refers to vertex {}, the mesh has {count} vertices", at / 3, corners[at])));
        }
        Ok(TriangleMesh { dimension, vertices, faces })
    }

    /// D, the dimension of the space the vertices lie in.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.vertices.len() / self.dimension
    }

    /// Coordinates, vertex after vertex.
    pub fn vertices(&self) -> &[f64] {
        &self.vertices
    }

    /// Coordinates of one vertex.
    ///
    /// # Panics
    /// If there is no such vertex.
    pub fn vertex(&self, index: u32) -> &[f64] {
        &self.vertices[index as usize * self.dimension..][..self.dimension]
    }

    /// Vertex numbers of the triangles.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// What `take` makes of the positions of a face's corners. In space it is compiled for three coordinates.
    #[inline(always)]
    pub(crate) fn at_corners<T>(&self, face: usize, take: impl Fn([&[f64]; 3]) -> T) -> T {
        let corners = self.faces[face].map(|corner| self.vertex(corner));
        if let (3, [Some(a), Some(b), Some(c)]) = (self.dimension, corners.map(<[f64]>::first_chunk::<3>)) {
            return take([a, b, c]);
        }
        take(corners)
    }

    /// Squared lengths of a face's three edges, each opposite to the corner of the same number.
    ///
    /// # Panics
    /// If there is no such face.
    pub fn squared_edge_lengths(&self, face: usize) -> [f64; 3] {
        self.at_corners(face, squared_edge_lengths)
    }

    /// Area of a face, by Lagrange's identity in any D.
    ///
    /// # Panics
    /// If there is no such face.
    pub fn face_area(&self, face: usize) -> f64 {
        self.at_corners(face, area)
    }

    /// Areas of all faces.
    pub fn face_areas(&self) -> Vec<f64> {
        (0..self.faces.len()).into_par_iter().with_min_len(CHUNK).map(|face| self.face_area(face)).collect()
    }

    /// Total area.
    pub fn area(&self) -> f64 {
        self.face_areas().iter().sum()
    }

    /// The mesh with arrays of its own.
    pub fn into_owned(self) -> TriangleMesh<'static> {
        TriangleMesh {
            dimension: self.dimension,
            vertices: Cow::Owned(self.vertices.into_owned()),
            faces: Cow::Owned(self.faces.into_owned()),
        }
    }
}

/// Squared lengths of a triangle's edges, each opposite to the corner of the same number.
#[inline(always)]
pub(crate) fn squared_edge_lengths([a, b, c]: [&[f64]; 3]) -> [f64; 3] {
    let squared = |p: &[f64], q: &[f64]| p.iter().zip(q).map(|(x, y)| (x - y) * (x - y)).sum::<f64>();
    [squared(b, c), squared(c, a), squared(a, b)]
}

/// Area of a triangle, by Lagrange's identity in any D.
#[inline(always)]
pub(crate) fn area(corners: [&[f64]; 3]) -> f64 {
    let sum = squared_double_area(corners);
    if PLAIN.contains(&sum) { 0.5 * sum.sqrt() } else { extreme_area(corners) }
}

/// Where fourth powers of the edges neither over- nor underflow.
pub(crate) const PLAIN: std::ops::Range<f64> = 1e-200..1e200;

/// The square of twice the area, if it is [`PLAIN`].
#[inline(always)]
pub(crate) fn squared_double_area(corners: [&[f64]; 3]) -> f64 {
    twice_squared(corners, 1.0)
}

/// The square of twice the area, all lengths times `scale`.
#[inline(always)]
fn twice_squared([a, b, c]: [&[f64]; 3], scale: f64) -> f64 {
    let step = |p: &[f64], axis: usize| scale * (p[axis] - a[axis]);
    let mut sum = 0.0;
    for i in 0..a.len() {
        for j in 0..i {
            let minor = step(b, i) * step(c, j) - step(b, j) * step(c, i);
            sum += minor * minor;
        }
    }
    sum
}

/// The area where fourth powers of the edges may have over- or underflowed.
#[cold]
fn extreme_area([a, b, c]: [&[f64]; 3]) -> f64 {
    let largest = (0..a.len()).map(|axis| (b[axis] - a[axis]).abs().max((c[axis] - a[axis]).abs())).fold(0.0, f64::max);
    if !(largest > 0.0 && largest < f64::INFINITY) {
        return largest;
    }
    let scale = 2f64.powi(-largest.log2().round().clamp(-1000.0, 1000.0) as i32);
    0.5 * twice_squared([a, b, c], scale).sqrt() / scale / scale
}
