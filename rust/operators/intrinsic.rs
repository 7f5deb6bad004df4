//! Piecewise-linear finite elements on an intrinsic triangulation: the operators of the module `cotangent`, from lengths alone.
//!
//! Vector fields have two coordinates per triangle, in the frame whose first axis runs from corner 0 to corner 1.

use super::corners::Corners;
use crate::error::{Error, Result};
use crate::shape::IntrinsicTriangulation;
use crate::shape::intrinsic::{area_of, cotangent_of};
use crate::sparse::{CHUNK, Csr, append_sums};
use rayon::prelude::*;

/// Rows of a matrix, made in parallel: `fill(row, entries)` puts (column, order, value); entries of a column are added up in
/// ascending order, so that (i, j) and (j, i) become the same sum.
fn rows(count: usize, columns: usize, fill: impl Fn(usize, &mut Vec<(u32, u32, f64)>) + Sync) -> Csr {
    Csr::by_rows(count, columns, |row, entries: &mut Vec<(u32, u32, f64)>, indices, values| {
        entries.clear();
        fill(row, entries);
        entries.sort_unstable_by_key(|&(column, order, _)| (column, order));
        append_sums(entries.iter().map(|&(column, _, value)| (column, value)), indices, values);
    })
}

/// Sets the diagonal entries so that rows sum to zero.
fn close_rows(matrix: Csr) -> Csr {
    let rows = matrix.rows();
    let (starts, indices, mut values) = matrix.into_parts();
    for row in 0..rows {
        let range = starts[row]..starts[row + 1];
        let sum: f64 = values[range.clone()].iter().sum(); // its own entry is 0 so far
        if let Ok(at) = indices[range.clone()].binary_search(&(row as u32)) {
            values[range.start + at] = -sum;
        }
    }
    Csr::trusted(rows, rows, starts, indices, values)
}

/// A triangle's angles and hat functions, in units of length.
struct Element {
    cotangents: [f64; 3],
    /// Gradients of the hat functions of the three corners, in the triangle's frame.
    hats: [[f64; 2]; 3],
    area: f64,
}

fn element(lengths: &[f64], face: usize) -> Element {
    let [ab, bc, ca] = [lengths[3 * face], lengths[3 * face + 1], lengths[3 * face + 2]];
    let area = area_of([ab, bc, ca]);
    let cotangents = [cotangent_of(bc, ca, ab, area), cotangent_of(ca, ab, bc, area), cotangent_of(ab, bc, ca, area)];
    // a at (0, 0), b at (ab, 0), c at (x, y) with y > 0: a hat's gradient is its opposite edge turned, over twice the area.
    // x and ab - x come from the cotangents, so that G^T A G agrees with the stiffness also on slivers.
    let y = 2.0 * area / ab;
    let hats = [[-1.0 / ab, -cotangents[1] / ab], [1.0 / ab, -cotangents[0] / ab], [0.0, 1.0 / y]];
    Element { cotangents, hats, area }
}

impl IntrinsicTriangulation {
    /// The stiffness matrix: positive semidefinite, symmetric to the last bit, rows sum to zero. Entries off the diagonal are
    /// at most 0 (but for rounding) where no boundary edge faces an obtuse angle. Rows of vertices of no triangle are empty.
    ///
    /// ```
    /// use beltrami::{Control, shape::{intrinsic_delaunay, make}};
    /// let egg = make::ellipsoid(6, [1.0, 0.5, 0.1])?;
    /// let stiffness = intrinsic_delaunay(&egg, &Control::default())?.stiffness();
    /// for row in 0..egg.vertex_count() {
    ///     let (columns, values) = stiffness.row(row);
    ///     assert!(columns.iter().zip(values).all(|(&column, &value)| column as usize == row || value < 1e-13));
    /// }
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    pub fn stiffness(&self) -> Csr {
        let (lengths, _, weight) = self.scaled();
        let corners = Corners::new(self.vertex_count(), self.faces());
        let half: Vec<[f64; 3]> = (0..self.faces().len())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|face| element(lengths, face).cotangents.map(|cotangent| -0.5 * weight * cotangent))
            .collect();
        let faces = self.faces();
        let off_diagonal = rows(self.vertex_count(), self.vertex_count(), |vertex, entries| {
            if corners.of(vertex).is_empty() {
                return;
            }
            entries.push((vertex as u32, 0, 0.0));
            for &corner in corners.of(vertex) {
                let (face, at) = (corner as usize / 3, corner as usize % 3);
                for (other, opposite) in [((at + 1) % 3, (at + 2) % 3), ((at + 2) % 3, (at + 1) % 3)] {
                    if faces[face][other] as usize != vertex {
                        entries.push((faces[face][other], (3 * face + opposite) as u32, half[face][opposite]));
                    }
                }
            }
        });
        close_rows(off_diagonal)
    }

    /// Lumped mass: a third of the adjacent areas at each vertex, 0 at vertices of no triangle.
    pub fn mass(&self) -> Vec<f64> {
        let areas = self.face_areas();
        let corners = Corners::new(self.vertex_count(), self.faces());
        (0..self.vertex_count())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|vertex| corners.of(vertex).iter().map(|&corner| areas[corner as usize / 3] / 3.0).sum())
            .collect()
    }

    /// Mixed Voronoi areas of the vertices (Meyer et al. 2003), as [`voronoi_mass`](crate::operators::voronoi_mass) has them
    /// for a mesh. They sum to the total area.
    pub fn voronoi_mass(&self) -> Vec<f64> {
        let (lengths, unit, weight) = self.scaled();
        let corners = Corners::new(self.vertex_count(), self.faces());
        let share = |corner: u32| {
            let (face, at) = (corner as usize / 3, corner as usize % 3);
            let Element { cotangents, area, .. } = element(lengths, face);
            match cotangents.iter().position(|&cotangent| cotangent < 0.0) {
                Some(obtuse) if obtuse == at => area / 2.0,
                Some(_) => area / 4.0,
                // half-edge k is opposite to corner k + 2
                None => {
                    let (after, before) = (lengths[3 * face + at], lengths[3 * face + (at + 2) % 3]);
                    (after * after * cotangents[(at + 2) % 3] + before * before * cotangents[(at + 1) % 3]) / 8.0
                }
            }
        };
        (0..self.vertex_count())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|vertex| weight * unit * unit * corners.of(vertex).iter().map(|&corner| share(corner)).sum::<f64>())
            .collect()
    }

    /// The gradient, (2 m, n): rows `2 face` and `2 face + 1` give the vector on a triangle in its frame, whose first axis
    /// runs from corner 0 to corner 1.
    pub fn gradient(&self) -> Csr {
        let (lengths, unit, _) = self.scaled();
        let faces = self.faces();
        rows(2 * faces.len(), self.vertex_count(), |row, entries| {
            let (face, axis) = (row / 2, row % 2);
            let hats = element(lengths, face).hats;
            entries.extend((0..3).map(|at| (faces[face][at], at as u32, hats[at][axis] / unit)));
        })
    }

    /// The divergence, (n, 2 m): the negative adjoint of the gradient in the area and mass inner products,
    /// `-diag(mass)^-1 G^T diag(area)`. Rows of vertices without mass are empty.
    ///
    /// # Errors
    /// [`Error::Input`] if there is not one mass a vertex, or there are 2^31 triangles or more.
    pub fn divergence(&self, mass: &[f64]) -> Result<Csr> {
        let (lengths, unit, weight) = self.scaled();
        let faces = self.faces();
        if mass.len() != self.vertex_count() {
            return Err(Error::input(format!("{} masses for {} vertices", mass.len(), self.vertex_count())));
        }
        if faces.len() >= 1 << 31 {
            return Err(Error::input(format!("{} triangles; the divergence takes up to 2^31 - 1", faces.len())));
        }
        let corners = Corners::new(self.vertex_count(), self.faces());
        Ok(rows(self.vertex_count(), 2 * faces.len(), |vertex, entries| {
            if mass[vertex] <= 0.0 || mass[vertex].is_nan() {
                return;
            }
            for &corner in corners.of(vertex) {
                let (face, at) = (corner as usize / 3, corner as usize % 3);
                let Element { hats, area, .. } = element(lengths, face);
                let factor = -weight * area * unit / mass[vertex]; // unit^2 of the area, over the unit of the gradient
                entries.extend((0..2).map(|axis| ((2 * face + axis) as u32, at as u32, factor * hats[at][axis])));
            }
        }))
    }
}
