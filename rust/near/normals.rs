//! Normals of point clouds of codimension one: from the neighbours of each point, oriented alike and outwards.

use super::KdTree;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::CHUNK;
use rayon::prelude::*;

/// Unit normals of points in R^D that lie on a surface of dimension D - 1, oriented consistently: `dimension` numbers per point.
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

/// Planes through some neighbours of each query, as [`plane_fits`] finds them.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneFits {
    /// The neighbours' mean, `dimension` numbers per query.
    pub means: Vec<f64>,
    /// The direction in which they vary least, a unit vector of either sign.
    pub normals: Vec<f64>,
    /// The share of their variance along it; 0 if all are one point.
    pub shares: Vec<f64>,
}

/// Fits a plane (hyperplane) to the `neighbors` points of each row of `near`.
///
/// ```
/// use beltrami::{Control, near};
/// let fits = near::plane_fits(&[0.0, 0.0, 1.0, 0.1, 2.0, 0.0, 3.0, 0.1], 2, &[0, 1, 2, 3], 4, &Control::default())?;
/// assert!((fits.means[0] - 1.5).abs() < 1e-12 && fits.normals[1].abs() > 0.99 && fits.shares[0] < 0.01);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if lengths do not fit together or a row refers to no point; [`Error::Cancelled`].
pub fn plane_fits(points: &[f64], dimension: usize, near: &[u32], neighbors: usize, control: &Control) -> Result<PlaneFits> {
    let count = points.len() / dimension.max(1);
    if dimension == 0 || neighbors == 0 || !near.len().is_multiple_of(neighbors) || near.iter().any(|&point| point as usize >= count) {
        return Err(Error::input(format!("rows of {neighbors} neighbors do not fit {count} points in R^{dimension}")));
    }
    let queries = near.len() / neighbors;
    let (mut means, mut normals) = (vec![0.0; queries * dimension], vec![0.0; queries * dimension]);
    let mut shares = vec![0.0; queries];
    near.par_chunks(neighbors * (CHUNK / 16))
        .zip(means.par_chunks_mut(dimension * (CHUNK / 16)))
        .zip(normals.par_chunks_mut(dimension * (CHUNK / 16)))
        .zip(shares.par_chunks_mut(CHUNK / 16))
        .try_for_each(|(((near, means), normals), shares)| {
            control.check()?;
            let (mut covariance, mut axes) = (vec![0.0; dimension * dimension], vec![0.0; dimension * dimension]);
            let places = near.chunks_exact(neighbors).zip(means.chunks_exact_mut(dimension)).zip(normals.chunks_exact_mut(dimension));
            for (((near, mean), normal), share) in places.zip(shares) {
                let origin = &points[near[0] as usize * dimension..][..dimension];
                let offset = |point: u32, axis: usize| points[point as usize * dimension + axis] - origin[axis];
                // squares of very large shapes overflow, of very small ones vanish
                let size = near.iter().flat_map(|&point| (0..dimension).map(move |axis| offset(point, axis).abs())).fold(0.0, f64::max);
                let inverse = if size > 0.0 { 1.0 / size } else { 0.0 };
                least_axis(points, dimension, near, size, &mut covariance, &mut axes, normal);
                mean.iter_mut().enumerate().for_each(|(axis, mean)| {
                    *mean = origin[axis] + size * near.iter().map(|&point| offset(point, axis) * inverse).sum::<f64>() / near.len() as f64;
                });
                if size > 0.0 {
                    let variances = || (0..dimension).map(|k| covariance[k * dimension + k].max(0.0));
                    *share = variances().fold(f64::INFINITY, f64::min) / variances().sum::<f64>().max(1e-300);
                } else {
                    normal.fill(0.0);
                    normal[0] = 1.0;
                }
            }
            Ok(())
        })?;
    Ok(PlaneFits { means, normals, shares })
}

/// Normals oriented alike where the surface may be thin or near itself, as [`oriented`] finds them.
#[derive(Debug, Clone, PartialEq)]
pub struct Oriented {
    /// Unit vectors, `dimension` numbers per point.
    pub normals: Vec<f64>,
    /// The share of edges along the surface between points whose normals agree but for their sign, and whose signs differ.
    pub seam: f64,
}

/// Normals of the planes through the `fitted` nearest points of each, oriented alike along a spanning forest of the graph of the `linked`
/// nearest (Hoppe et al. 1992) that prefers edges within the surface: those across a gap between two parts, or through a thin part, come
/// last. Unlike [`normals`] it refuses no neighbourhood, and says how well it went.
///
/// ```
/// use beltrami::{Control, near};
/// let circle: Vec<f64> = (0..40).flat_map(|k| { let (s, c) = (k as f64 * 0.157).sin_cos(); [3.0 * c, 3.0 * s] }).collect();
/// let found = near::oriented(&circle, 2, 3, 5, &Control::default())?;
/// assert!(found.normals.iter().zip(&circle).all(|(normal, point)| (3.0 * normal - point).abs() < 1e-2));
/// assert_eq!(found.seam, 0.0);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if a number of neighbours is 0 or more than there are points, or a coordinate is not finite; [`Error::Cancelled`].
pub fn oriented(points: &[f64], dimension: usize, fitted: usize, linked: usize, control: &Control) -> Result<Oriented> {
    let tree = KdTree::new(points, dimension, control)?;
    let (near, _) = tree.nearest(points, linked.max(fitted), control)?;
    let (linked, count) = (linked.max(fitted), tree.len());
    let first: Vec<u32> = near.chunks_exact(linked).flat_map(|near| near[..fitted].iter().copied()).collect();
    let PlaneFits { mut normals, shares, .. } = plane_fits(points, dimension, &first, fitted, control)?;
    control.check()?;
    let mut links: Vec<Link> = near
        .par_chunks(linked)
        .enumerate()
        .with_min_len(CHUNK / 16)
        .flat_map_iter(|(point, near)| {
            let (normals, shares) = (&normals, &shares);
            near.iter().filter(move |&&other| other as usize != point).map(move |&other| {
                let ends = ((point as u32).min(other), (point as u32).max(other));
                let [a, b] = [ends.0, ends.1].map(|end| end as usize);
                let (same, reflected, steep) = along(points, normals, dimension, a, b);
                let cost = (1.0 - reflected.abs()).max(0.0) + steep + 3.0 * (shares[a] + shares[b]);
                Link { cost: cost.to_bits(), ends, turned: reflected < 0.0, flat: (steep < 0.1 && same.abs() > 0.8).then_some(same < 0.0) }
            })
        })
        .collect();
    links.par_sort_unstable_by_key(|link| (link.cost, link.ends));
    links.dedup_by_key(|link| link.ends);
    control.check()?;
    let mut forest = Forest { parents: (0..count as u32).collect(), flipped: vec![false; count] };
    links.iter().for_each(|link| forest.join(link.ends.0, link.ends.1, link.turned));
    let (mut flat, mut wrong) = (0_usize, 0_usize);
    for link in &links {
        if let Some(opposed) = link.flat {
            let (a, b) = (forest.root(link.ends.0), forest.root(link.ends.1));
            flat += 1;
            wrong += usize::from(a.1 ^ b.1 ^ opposed);
        }
    }
    orient(points, &mut normals, dimension, &mut forest);
    Ok(Oriented { normals, seam: wrong as f64 / flat.max(1) as f64 })
}

/// An edge of the graph of neighbours.
struct Link {
    cost: u64,
    ends: (u32, u32),
    /// Whether the normals at its ends point to different sides.
    turned: bool,
    /// Of edges along the surface whether the normals oppose each other.
    flat: Option<bool>,
}

/// Cosine between two normals, the same with the second one reflected between the points, and the greater squared cosine between edge and
/// normal.
fn along(points: &[f64], normals: &[f64], dimension: usize, a: usize, b: usize) -> (f64, f64, f64) {
    let [p, q] = [a, b].map(|at| &points[at * dimension..][..dimension]);
    let [n, m] = [a, b].map(|at| &normals[at * dimension..][..dimension]);
    let same: f64 = n.iter().zip(m).map(|(x, y)| x * y).sum();
    let size = p.iter().zip(q).fold(0.0, |size: f64, (x, y)| size.max((y - x).abs()));
    if size == 0.0 {
        return (same, same, 0.0);
    }
    let edge = || p.iter().zip(q).map(|(x, y)| (y - x) / size);
    let square: f64 = edge().map(|x| x * x).sum();
    let [first, second] = [n, m].map(|normal| normal.iter().zip(edge()).map(|(x, y)| x * y).sum::<f64>());
    (same, same - 2.0 * first * second / square, (first * first).max(second * second) / square)
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
    along(points, normals, dimension, a, b).1
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
