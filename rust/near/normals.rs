//! Normals of point clouds of codimension one: from the neighbours of each point, oriented alike and outwards.

use super::KdTree;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::CHUNK;
use rayon::prelude::*;

/// Unit normals of points in R^D that lie on a surface of dimension D - 1, oriented consistently: `dimension` numbers a point.
///
/// A point's normal is the direction in which its `neighbors` nearest points (itself among them) vary least. Signs are carried along
/// a minimum spanning forest of the graph of neighbours (Hoppe et al. 1992), across an edge by reflection, which is exact on
/// circles and spheres; in each connected piece the point farthest from the piece's mean has its normal pointing away from it,
/// so normals of closed surfaces point outwards.
///
/// ```
/// use beltrami::{Control, near};
/// let circle: Vec<f64> = (0..40).flat_map(|k| { let (s, c) = (k as f64 * 0.157).sin_cos(); [3.0 * c, 3.0 * s] }).collect();
/// let normals = near::normals(&circle, 2, 3, &Control::default())?;
/// assert!(normals.iter().zip(&circle).all(|(normal, point)| (3.0 * normal - point).abs() < 1e-2));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if D < 2, there are fewer points or neighbours than D, a coordinate is not finite, or the neighbours of a point
/// do not span a hyperplane (they coincide, or lie on a line in R^3), which the message names; [`Error::Cancelled`].
pub fn normals(points: &[f64], dimension: usize, neighbors: usize, control: &Control) -> Result<Vec<f64>> {
    if dimension < 2 {
        return Err(Error::input(format!("normals need points in R^2 or more, these are in R^{dimension}")));
    }
    if neighbors < dimension {
        return Err(Error::input(format!("{neighbors} neighbors do not span a hyperplane of R^{dimension}; ask for {dimension} or more")));
    }
    let tree = KdTree::new(points, dimension, control)?;
    let (near, distances) = tree.nearest(points, neighbors, control)?;
    let count = tree.len();
    let mut normals = vec![0.0; points.len()];
    let wrong = normals
        .par_chunks_mut(dimension)
        .with_min_len(CHUNK / 16)
        .zip(near.par_chunks(neighbors))
        .zip(distances.par_chunks(neighbors))
        .map_init(
            || (vec![0.0; dimension * dimension], vec![0.0; dimension * dimension]),
            |(covariance, axes), ((normal, near), distances)| {
                least_axis(points, dimension, near, distances[neighbors - 1], covariance, axes, normal)
            },
        )
        .position_first(|spans| !spans);
    if let Some(point) = wrong {
        return Err(Error::input(format!(
            "the {neighbors} nearest neighbors of point {point} do not span a hyperplane (they coincide or lie on a line); ask for more \
             neighbors or remove repeated points"
        )));
    }
    control.check()?;
    let mut links: Vec<(u64, u32, u32)> = near
        .par_chunks(neighbors)
        .enumerate()
        .with_min_len(CHUNK / 16)
        .flat_map_iter(|(point, near)| {
            let normals = &normals;
            near.iter().filter(move |&&other| other as usize != point).map(move |&other| {
                let agreement = across(points, normals, dimension, point, other as usize).abs();
                ((1.0 - agreement).max(0.0).to_bits(), (point as u32).min(other), (point as u32).max(other))
            })
        })
        .collect();
    control.check()?;
    links.par_sort_unstable();
    let mut forest = Forest { parents: (0..count as u32).collect(), flipped: vec![false; count] };
    for (step, &(_, a, b)) in links.iter().enumerate() {
        if step % (1 << 20) == 0 {
            control.check()?;
        }
        let turned = across(points, &normals, dimension, a as usize, b as usize) < 0.0;
        forest.join(a, b, turned);
    }
    orient(points, &mut normals, dimension, &mut forest);
    Ok(normals)
}

/// The direction of least variance of some points; false if it is not unique.
fn least_axis(
    points: &[f64],
    dimension: usize,
    near: &[u32],
    size: f64,
    covariance: &mut [f64],
    axes: &mut [f64],
    normal: &mut [f64],
) -> bool {
    if size == 0.0 {
        return false;
    }
    let inverse = 1.0 / size;
    let origin = &points[near[0] as usize * dimension..][..dimension];
    let offset = |point: u32, axis: usize| (points[point as usize * dimension + axis] - origin[axis]) * inverse;
    normal.fill(0.0);
    for &point in near {
        for (axis, mean) in normal.iter_mut().enumerate() {
            *mean += offset(point, axis) / near.len() as f64;
        }
    }
    covariance.fill(0.0);
    for &point in near {
        for i in 0..dimension {
            let x = offset(point, i) - normal[i];
            for j in 0..=i {
                covariance[i * dimension + j] += x * (offset(point, j) - normal[j]);
            }
        }
    }
    for i in 0..dimension {
        for j in 0..i {
            covariance[j * dimension + i] = covariance[i * dimension + j];
        }
    }
    jacobi(covariance, axes, dimension);
    let mut order: Vec<usize> = (0..dimension).collect();
    let value = |k: usize| covariance[k * dimension + k];
    order.sort_by(|&a, &b| value(a).total_cmp(&value(b)));
    for (axis, number) in normal.iter_mut().enumerate() {
        *number = axes[axis * dimension + order[0]];
    }
    // the next direction must vary by more than rounding
    let spans = value(order[1]) > 1e-13 * value(order[dimension - 1]) && value(order[1]) > value(order[0]);
    let length = normal.iter().map(|number| number * number).sum::<f64>().sqrt();
    normal.iter_mut().for_each(|number| *number /= length);
    spans
}

/// Cyclic Jacobi rotations: leaves eigenvalues on the diagonal of `matrix`, eigenvectors in the columns of `axes`.
fn jacobi(matrix: &mut [f64], axes: &mut [f64], n: usize) {
    axes.fill(0.0);
    for k in 0..n {
        axes[k * n + k] = 1.0;
    }
    for _ in 0..50 {
        let mut done = true;
        for p in 0..n {
            for q in p + 1..n {
                let off = matrix[p * n + q];
                if off.abs() <= 1e-18 * (matrix[p * n + p].abs() + matrix[q * n + q].abs()) || off.abs() < 1e-300 {
                    continue;
                }
                done = false;
                let theta = (matrix[q * n + q] - matrix[p * n + p]) / (2.0 * off);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                for k in 0..n {
                    let (a, b) = (matrix[k * n + p], matrix[k * n + q]);
                    (matrix[k * n + p], matrix[k * n + q]) = (c * a - s * b, s * a + c * b);
                }
                for k in 0..n {
                    let (a, b) = (matrix[p * n + k], matrix[q * n + k]);
                    (matrix[p * n + k], matrix[q * n + k]) = (c * a - s * b, s * a + c * b);
                    let (a, b) = (axes[k * n + p], axes[k * n + q]);
                    (axes[k * n + p], axes[k * n + q]) = (c * a - s * b, s * a + c * b);
                }
            }
        }
        if done {
            return;
        }
    }
}

/// Cosine between the normal of `b` and that of `a` reflected in the plane between the two points, the sign turned so that normals of
/// a circle agree.
fn across(points: &[f64], normals: &[f64], dimension: usize, a: usize, b: usize) -> f64 {
    let (p, q) = (&points[a * dimension..][..dimension], &points[b * dimension..][..dimension]);
    let (n, m) = (&normals[a * dimension..][..dimension], &normals[b * dimension..][..dimension]);
    let (mut square, mut dot, mut along, mut beside) = (0.0, 0.0, 0.0, 0.0);
    let size = p.iter().zip(q).fold(0.0, |size: f64, (x, y)| size.max((y - x).abs()));
    if size == 0.0 {
        return n.iter().zip(m).map(|(x, y)| x * y).sum();
    }
    for axis in 0..dimension {
        let edge = (q[axis] - p[axis]) / size;
        square += edge * edge;
        dot += n[axis] * m[axis];
        along += n[axis] * edge;
        beside += m[axis] * edge;
    }
    dot - 2.0 * along * beside / square
}

/// Union and find that also knows whether a point is flipped against its root.
struct Forest {
    parents: Vec<u32>,
    flipped: Vec<bool>,
}

impl Forest {
    /// The root, and whether the point is flipped against it.
    fn root(&mut self, point: u32) -> (u32, bool) {
        let (mut top, mut turned) = (point, false);
        while self.parents[top as usize] != top {
            turned ^= self.flipped[top as usize];
            top = self.parents[top as usize];
        }
        let (mut at, mut left) = (point, turned);
        while self.parents[at as usize] != top && at != top {
            let (next, own) = (self.parents[at as usize], self.flipped[at as usize]);
            (self.parents[at as usize], self.flipped[at as usize]) = (top, left);
            (at, left) = (next, left ^ own);
        }
        (top, turned)
    }

    fn join(&mut self, a: u32, b: u32, turned: bool) {
        let ((a, turned_a), (b, turned_b)) = (self.root(a), self.root(b));
        if a != b {
            let (low, high) = (a.min(b), a.max(b));
            self.parents[high as usize] = low;
            self.flipped[high as usize] = turned ^ turned_a ^ turned_b;
        }
    }
}

fn orient(points: &[f64], normals: &mut [f64], dimension: usize, forest: &mut Forest) {
    let count = forest.parents.len();
    let places: Vec<(u32, bool)> = (0..count as u32).map(|point| forest.root(point)).collect();
    let mut sizes = vec![0usize; count];
    let mut means = vec![0.0; points.len()];
    for (point, &(root, _)) in places.iter().enumerate() {
        sizes[root as usize] += 1;
        for axis in 0..dimension {
            let mean = &mut means[root as usize * dimension + axis];
            *mean += (points[point * dimension + axis] - *mean) / sizes[root as usize] as f64;
        }
    }
    // of each piece: distance of its farthest point, and whether the normal there must be turned
    let mut farthest = vec![(-1.0, false); count];
    for (point, &(root, turned)) in places.iter().enumerate() {
        let (mut distance, mut outward) = (0.0f64, 0.0);
        for axis in 0..dimension {
            let offset = points[point * dimension + axis] - means[root as usize * dimension + axis];
            distance = distance.hypot(offset);
            outward += offset * normals[point * dimension + axis];
        }
        if distance > farthest[root as usize].0 {
            farthest[root as usize] = (distance, turned ^ (outward < 0.0));
        }
    }
    for (normal, &(root, turned)) in normals.chunks_exact_mut(dimension).zip(&places) {
        if turned ^ farthest[root as usize].1 {
            normal.iter_mut().for_each(|number| *number = -*number);
        }
    }
}
