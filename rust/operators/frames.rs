//! Local geometry of a point cloud: neighbours, tangent frames, spacing, the dimension the points themselves suggest.
//!
//! The frame of a point starts from the principal axes of its nearest neighbours; then, twice, the neighbours' normal
//! components are fitted by a cubic polynomial of the tangential ones, and the frame is tilted by the fit's linear term, which
//! removes what curvature and an uneven neighbourhood do to principal axes. Neighbours that lie rather along the normal than
//! along the surface belong to another sheet and are left out.

use super::dense::{Monomials, cholesky, cholesky_solve, symmetric_eigen};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::near::sampling::{COINCIDENT, normalized};
use crate::near::{KdTree, Scratch};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How many points one parallel task takes.
pub(crate) const TASK: usize = 128;

/// A neighbour whose normal component is a greater part of its distance than this lies on another sheet.
pub(crate) const STEEP: f64 = 0.75;

/// The neighbour whose distance counts as local spacing.
const SPACING_RANK: usize = 6;

/// Principal axes count as found when the least variance is this share of the greatest: otherwise the neighbours stand in a row, as
/// on grids of long cells, and more are taken.
const THIN: f64 = 0.02;

/// The square of the cosine between the last axis and the neighbour that shows it.
const ACROSS: f64 = 0.2;

/// How many times the usual neighbours are taken at most to reach the next row.
const ROWS: usize = 8;

/// Neighbours lie on all sides when the determinant of their second moments is this share of what it is for a round neighbourhood.
const ROUND: f64 = 0.15;

/// A point whose spacing is so many times that of its neighbours, and of the whole cloud, is isolated.
const ISOLATED: f64 = 20.0;

/// Points in R^D made ready: moved to the origin, scaled by a power of two to size 1 and renumbered so that near points have
/// near numbers ("ranks"); all kernels on clouds work in ranks and hand out the caller's numbers.
#[derive(Debug)]
pub(crate) struct Cloud {
    pub(crate) ambient: usize,
    pub(crate) points: Vec<f64>,
    /// What the coordinates were multiplied by.
    pub(crate) scale: f64,
    /// The caller's number of each rank, and back.
    pub(crate) original: Vec<u32>,
    pub(crate) rank: Vec<u32>,
    pub(crate) tree: KdTree,
    /// Outward normals by rank, where they are known: neighbours whose normal points the other way lie on another sheet.
    normals: Option<Vec<f64>>,
}

/// Neighbours and frames of every point, by rank.
#[derive(Debug)]
pub(crate) struct Frames {
    pub(crate) dimension: usize,
    /// Neighbours a point, nearest first, without the point itself.
    pub(crate) width: usize,
    pub(crate) neighbors: Vec<u32>,
    /// `dimension` orthonormal vectors of R^D a point.
    pub(crate) axes: Vec<f64>,
    /// The second-order part of the fit of the normal components: a vector of R^D for each t_a t_b, a <= b.
    pub(crate) bends: Vec<f64>,
    /// Distance of the 6th neighbour, in scaled units.
    pub(crate) spacing: Vec<f64>,
    /// Distance within which neighbours lie on all sides: `spacing`, or more where the cloud is sampled much more densely in one
    /// direction than in another.
    pub(crate) span: Vec<f64>,
    /// Distance of the nearest neighbour.
    pub(crate) nearest: Vec<f64>,
    /// The dimension that the growth of the neighbours' distances suggests (Levina and Bickel 2004).
    pub(crate) estimate: f64,
}

/// Neighbours whose tangent spaces agree less than this (the determinant between their frames) lie on another sheet.
const AGREEMENT: f64 = 0.3;

/// Whether two tangent spaces are near each other.
pub(crate) fn agree(x: &[f64], y: &[f64], ambient: usize, dimension: usize) -> bool {
    let mut m = [[0.0; 3]; 3];
    for a in 0..dimension {
        for b in 0..dimension {
            m[a][b] = x[a * ambient..][..ambient].iter().zip(&y[b * ambient..][..ambient]).map(|(x, y)| x * y).sum();
        }
    }
    let determinant = match dimension {
        1 => m[0][0],
        2 => m[0][0] * m[1][1] - m[0][1] * m[1][0],
        _ => {
            m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
        }
    };
    determinant.abs() > AGREEMENT
}

/// Names some indices for a message: "3, 17, 20 and 5 more".
pub(crate) fn name_some(indices: &[u32]) -> String {
    let mut text = indices.iter().take(8).map(u32::to_string).collect::<Vec<_>>().join(", ");
    if indices.len() > 8 {
        text += &format!(" and {} more", indices.len() - 8);
    }
    text
}

impl Cloud {
    pub(crate) fn new(points: &[f64], ambient: usize, dimension: usize, normals: Option<&[f64]>, control: &Control) -> Result<Cloud> {
        if dimension == 0 || dimension > ambient {
            return Err(Error::input(format!("intrinsic dimension {dimension} of points in R^{ambient}; it must be from 1 to {ambient}")));
        }
        let count = points.len() / ambient.max(1);
        if count < dimension + 2 {
            return Err(Error::input(format!(
                "{count} points; operators of a {dimension}-dimensional cloud need {} or more",
                dimension + 2
            )));
        }
        let Some((scaled, scale)) = normalized(points, ambient)? else {
            return Err(Error::input(format!(
                "all {count} points, 0 to {}, are at one place; an operator needs points that differ (keep one of each place)",
                count - 1
            )));
        };
        let tree = KdTree::new(&scaled, ambient, control)?;
        let original = tree.order().to_vec();
        let mut rank = vec![0; count];
        let mut ordered = Vec::with_capacity(scaled.len());
        for (at, &index) in original.iter().enumerate() {
            rank[index as usize] = at as u32;
            ordered.extend_from_slice(&scaled[index as usize * ambient..][..ambient]);
        }
        let normals = match normals {
            None => None,
            Some(normals) if normals.len() != points.len() || normals.iter().any(|x| !x.is_finite()) => {
                return Err(Error::input(format!(
                    "normals are {} numbers for {count} points in R^{ambient}; one finite vector per point is needed",
                    normals.len()
                )));
            }
            Some(normals) => {
                let vectors = original.iter().flat_map(|&index| normals[index as usize * ambient..][..ambient].iter().copied());
                Some(vectors.collect())
            }
        };
        Ok(Cloud { ambient, points: ordered, scale, original, rank, tree, normals })
    }

    pub(crate) fn count(&self) -> usize {
        self.original.len()
    }

    pub(crate) fn point(&self, rank: usize) -> &[f64] {
        &self.points[rank * self.ambient..][..self.ambient]
    }

    /// Whether the normals of two points do not oppose each other.
    fn same_side(&self, a: usize, b: u32) -> bool {
        self.normals.as_ref().is_none_or(|normals| {
            let (x, y) = (&normals[a * self.ambient..][..self.ambient], &normals[b as usize * self.ambient..][..self.ambient]);
            x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>() >= 0.0
        })
    }

    /// The `width` nearest other points on this side as ranks, nearest first; filled up by the other side's where there are not so many.
    pub(crate) fn neighbors_into(&self, rank: usize, width: usize, scratch: &mut Scratch, out: &mut Vec<u32>) -> Result<()> {
        let own = self.original[rank];
        let mut asked = width + 1;
        loop {
            self.tree.nearest_into(self.point(rank), asked, scratch)?;
            let others = || scratch.indices().iter().filter(|&&index| index != own).map(|&index| self.rank[index as usize]);
            out.clear();
            out.extend(others().filter(|&other| self.same_side(rank, other)).take(width));
            if out.len() == width {
                return Ok(());
            }
            if asked == self.count() {
                let missing = width - out.len();
                out.extend(others().filter(|&other| !self.same_side(rank, other)).take(missing));
                return Ok(());
            }
            asked = (2 * asked).min(self.count());
        }
    }

    /// The caller's numbers of some ranks, ascending.
    pub(crate) fn names(&self, ranks: impl Iterator<Item = usize>) -> Vec<u32> {
        let mut names: Vec<u32> = ranks.map(|rank| self.original[rank]).collect();
        names.sort_unstable();
        names
    }
}

/// Counts finished tasks and passes the share of work on.
pub(crate) struct Progress<'a> {
    done: AtomicUsize,
    total: usize,
    from: f64,
    to: f64,
    control: &'a Control,
}

impl<'a> Progress<'a> {
    pub(crate) fn new(total: usize, from: f64, to: f64, control: &'a Control) -> Self {
        Progress { done: AtomicUsize::new(0), total: total.max(1), from, to, control }
    }

    pub(crate) fn step(&self, count: usize) -> Result<()> {
        let done = self.done.fetch_add(count, Ordering::Relaxed) + count;
        self.control.report(self.from + (self.to - self.from) * done as f64 / self.total as f64)
    }
}

/// What is wrong with a point.
#[derive(Clone, Copy, PartialEq)]
enum State {
    Sound,
    Duplicate,
    Flat,
}

/// Memory of one task.
struct Work {
    near: Scratch,
    found: Vec<u32>,
    offsets: Vec<f64>,
    distances: Vec<f64>,
    rows: Vec<f64>,
    matrix: Vec<f64>,
    values: Vec<f64>,
    spare: Vec<f64>,
    fit: Fit,
}

/// Weighted least squares by a polynomial of a few variables: the functionals that give its linear coefficients.
struct Fit {
    bases: [Monomials; 3],
    basis: Vec<f64>,
    weights: Vec<f64>,
    matrix: Vec<f64>,
    right: Vec<f64>,
    tangential: Vec<f64>,
    normal: Vec<f64>,
    slope: Vec<f64>,
}

impl Work {
    fn new(ambient: usize, dimension: usize, width: usize) -> Self {
        let bases = [1, 2, 3].map(|degree| Monomials::new(dimension, degree));
        let terms = bases[2].len();
        let order = ambient.min(ROWS * width + 2);
        Work {
            near: Scratch::default(),
            found: vec![],
            offsets: vec![],
            distances: vec![],
            rows: vec![],
            matrix: vec![0.0; order * order],
            values: vec![0.0; order],
            spare: vec![0.0; order],
            fit: Fit {
                bases,
                basis: vec![],
                weights: vec![],
                matrix: vec![0.0; terms * terms],
                right: vec![0.0; terms],
                tangential: vec![],
                normal: vec![],
                slope: vec![],
            },
        }
    }

    fn offsets(&mut self, cloud: &Cloud, rank: usize, neighbors: &[u32]) {
        let here = cloud.point(rank);
        self.offsets.clear();
        self.distances.clear();
        for &neighbor in neighbors {
            let mut sum = 0.0;
            for (x, o) in cloud.point(neighbor as usize).iter().zip(here) {
                self.offsets.push(x - o);
                sum += (x - o) * (x - o);
            }
            self.distances.push(sum.sqrt());
        }
    }

    /// Principal axes of the point (at the origin) and its first `count` neighbours; the greatest and the d-th variance.
    fn principal_axes(&mut self, ambient: usize, dimension: usize, count: usize, axes: &mut [f64]) -> Option<(f64, f64)> {
        let reach = self.distances[count - 1];
        let rows = count + 1;
        self.rows.clear();
        self.rows.resize(rows * ambient, 0.0);
        let mut mean = vec![0.0; ambient];
        let mut total = 1.0;
        let weight = |distance: f64| (-2.0 * (distance / reach) * (distance / reach)).exp();
        for j in 0..count {
            let w = weight(self.distances[j]);
            total += w;
            for (mean, x) in mean.iter_mut().zip(&self.offsets[j * ambient..][..ambient]) {
                *mean += w * x;
            }
        }
        for x in &mut mean {
            *x /= total;
        }
        for j in 0..rows {
            let root = if j == count { 1.0 } else { weight(self.distances[j]).sqrt() };
            for (a, mean) in mean.iter().enumerate() {
                let x = if j == count { 0.0 } else { self.offsets[j * ambient + a] };
                self.rows[j * ambient + a] = root * (x - mean) / reach;
            }
        }
        let order = ambient.min(rows);
        let matrix = &mut self.matrix[..order * order];
        matrix.fill(0.0);
        if ambient <= rows {
            for row in self.rows.chunks_exact(ambient) {
                for a in 0..ambient {
                    for b in 0..=a {
                        matrix[a * ambient + b] += row[a] * row[b];
                    }
                }
            }
        } else {
            for i in 0..rows {
                for j in 0..=i {
                    matrix[i * rows + j] =
                        self.rows[i * ambient..][..ambient].iter().zip(&self.rows[j * ambient..][..ambient]).map(|(x, y)| x * y).sum();
                }
            }
        }
        for a in 0..order {
            for b in 0..a {
                matrix[b * order + a] = matrix[a * order + b];
            }
        }
        if !symmetric_eigen(matrix, order, &mut self.values, &mut self.spare) || order < dimension {
            return None;
        }
        for a in 0..dimension {
            let column = order - 1 - a;
            let axis = &mut axes[a * ambient..][..ambient];
            if ambient <= rows {
                for (row, x) in axis.iter_mut().enumerate() {
                    *x = matrix[row * order + column];
                }
            } else {
                axis.fill(0.0);
                for (j, row) in self.rows.chunks_exact(ambient).enumerate() {
                    let u = matrix[j * order + column];
                    for (x, r) in axis.iter_mut().zip(row) {
                        *x += u * r;
                    }
                }
            }
        }
        let variances = (self.values[order - 1], self.values[order - dimension]);
        (variances.1 > 1e-12 * variances.0 && orthonormalize(axes, ambient)).then_some(variances)
    }

    /// Principal axes of as many neighbours as it takes to see more than one row of them; the offsets are those of the neighbours taken.
    /// `false` if all stand in a row.
    fn axes_of_rows(
        &mut self,
        cloud: &Cloud,
        rank: usize,
        dimension: usize,
        (few, some, width): (usize, usize, usize),
        found: &mut Vec<u32>,
        axes: &mut [f64],
    ) -> Result<bool> {
        let ambient = cloud.ambient;
        let round = |variances: Option<(f64, f64)>| variances.is_some_and(|(most, least)| least > THIN * most);
        for reach in [few, some] {
            if round(self.principal_axes(ambient, dimension, reach, axes)) && self.reaches_across(ambient, axes, reach) {
                return Ok(true);
            }
        }
        let (mut wider, most) = (width, (ROWS * width).min(cloud.count() - 1));
        while wider < most {
            wider = (2 * wider).min(most);
            cloud.neighbors_into(rank, wider, &mut self.near, found)?;
            self.offsets(cloud, rank, found);
            if round(self.principal_axes(ambient, dimension, wider, axes)) && self.reaches_across(ambient, axes, wider) {
                return Ok(true);
            }
        }
        // no other row beside this one: what the nearest say, if they say anything
        for reach in [some, (2 * width).min(cloud.count() - 1)] {
            cloud.neighbors_into(rank, reach, &mut self.near, found)?;
            self.offsets(cloud, rank, found);
            if self.principal_axes(ambient, dimension, reach, axes).is_some() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// One over the dimension that the growth of these distances suggests: Levina and Bickel's estimate, but of neighbours at the
    /// greatest distance half are counted, so that it is right on grids as well.
    fn growth(&self) -> f64 {
        let last = self.distances[self.distances.len() - 1];
        let inside = self.distances.iter().take_while(|&&distance| distance < last * (1.0 - 1e-9)).count();
        let sum: f64 = self.distances[..inside].iter().map(|distance| (last / distance).ln()).sum();
        sum / (inside as f64 - 1.0 + (self.distances.len() - inside) as f64 / 2.0).max(1.0)
    }

    /// How many neighbours it takes to have `count` and all others at the same distance.
    fn whole_shell(&self, count: usize) -> usize {
        let limit = self.distances[count - 1] * (1.0 + 1e-9);
        count + self.distances[count..].iter().take_while(|&&distance| distance <= limit).count()
    }

    /// Whether some of the first neighbours lie along the last axis rather than ahead: neither the arc of one row of a grid nor the end
    /// of a whisker, which sees its surface before it, shows a tangent space.
    fn reaches_across(&self, ambient: usize, axes: &[f64], count: usize) -> bool {
        let axis = &axes[axes.len() - ambient..];
        self.offsets.chunks_exact(ambient).zip(&self.distances).take(count).any(|(offset, distance)| {
            let along: f64 = offset.iter().zip(axis).map(|(x, a)| x * a).sum();
            along * along >= ACROSS * distance * distance
        })
    }

    /// Distance of the first neighbour with which the neighbours so far lie on all sides; that of the last if there is none.
    fn span(&self, ambient: usize, axes: &[f64]) -> f64 {
        let dimension = axes.len() / ambient;
        let Some(&last) = self.distances.last() else { return 0.0 };
        if !(2..=3).contains(&dimension) {
            return 0.0;
        }
        let mut m = [0.0; 6]; // xx, xy, yy, xz, yz, zz
        for (at, (offset, &distance)) in self.offsets.chunks_exact(ambient).zip(&self.distances).enumerate() {
            let mut t = [0.0; 3];
            for (t, axis) in t.iter_mut().zip(axes.chunks_exact(ambient)) {
                *t = axis.iter().zip(offset).map(|(a, x)| a * x / last).sum();
            }
            for (m, product) in m.iter_mut().zip([t[0] * t[0], t[0] * t[1], t[1] * t[1], t[0] * t[2], t[1] * t[2], t[2] * t[2]]) {
                *m += product;
            }
            if at + 1 < SPACING_RANK {
                continue;
            }
            let plane = m[0] * m[2] - m[1] * m[1];
            let (determinant, mean) = match dimension {
                2 => (plane, (m[0] + m[2]) / 2.0),
                _ => {
                    let rest = m[3] * (m[3] * m[2] - m[4] * m[1]) - m[4] * (m[3] * m[1] - m[4] * m[0]);
                    (m[5] * plane - rest, (m[0] + m[2] + m[5]) / 3.0)
                }
            };
            if determinant >= ROUND * mean.powi(dimension as i32) {
                return distance;
            }
        }
        last
    }

    /// Tilts the frame by the linear term of a polynomial fit of the normal components; as it was if there are too few
    /// neighbours for a fit.
    fn tilt(&mut self, ambient: usize, dimension: usize, axes: &mut [f64], bend: Option<&mut [f64]>) {
        let fit = &mut self.fit;
        let Some(&reach) = self.distances.last() else { return };
        fit.tangential.clear();
        fit.normal.clear();
        fit.weights.clear();
        for (offset, &distance) in self.offsets.chunks_exact(ambient).zip(&self.distances) {
            let start = fit.normal.len();
            fit.normal.extend_from_slice(offset);
            let normal = &mut fit.normal[start..];
            for axis in axes.chunks_exact(ambient) {
                let t: f64 = axis.iter().zip(offset).map(|(a, x)| a * x).sum();
                for (normal, a) in normal.iter_mut().zip(axis) {
                    *normal -= t * a;
                }
                fit.tangential.push(t / reach);
            }
            let height = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
            if height > STEEP * distance {
                fit.normal.truncate(start);
                fit.tangential.truncate(start / ambient * dimension);
            } else {
                fit.weights.push((-3.0 * (distance / reach) * (distance / reach)).exp());
            }
        }
        let count = fit.weights.len();
        for degree in (0..3).rev() {
            let monomials = &fit.bases[degree];
            let terms = monomials.len();
            if 2 * (count + 1) < 3 * terms {
                continue;
            }
            fit.basis.resize(count * terms, 0.0);
            let matrix = &mut fit.matrix[..terms * terms];
            matrix.fill(0.0);
            matrix[0] = 1.0; // the point itself
            for j in 0..count {
                let basis = &mut fit.basis[j * terms..][..terms];
                monomials.evaluate(&fit.tangential[j * dimension..][..dimension], basis);
                for a in 0..terms {
                    let x = fit.weights[j] * basis[a];
                    for b in 0..=a {
                        matrix[a * terms + b] += x * basis[b];
                    }
                }
            }
            if !cholesky(matrix, terms, 1e-10) {
                continue;
            }
            let bends = bend.as_ref().map_or(0, |bend| bend.len() / ambient).min(terms - 1 - dimension);
            fit.slope.clear();
            fit.slope.resize((dimension + bends) * ambient, 0.0);
            for (a, slope) in fit.slope.chunks_exact_mut(ambient).enumerate() {
                let right = &mut fit.right[..terms];
                right.fill(0.0);
                right[1 + a] = 1.0;
                cholesky_solve(matrix, terms, right);
                for j in 0..count {
                    let basis = &fit.basis[j * terms..][..terms];
                    let c = fit.weights[j] * basis.iter().zip(right.iter()).map(|(x, y)| x * y).sum::<f64>();
                    for (slope, normal) in slope.iter_mut().zip(&fit.normal[j * ambient..][..ambient]) {
                        *slope += c * normal;
                    }
                }
            }
            let (slope, curve) = fit.slope.split_at(dimension * ambient);
            let steepness = slope.iter().map(|x| x * x).sum::<f64>().sqrt() / reach;
            if steepness < 1.0 {
                for (axis, slope) in axes.iter_mut().zip(slope) {
                    *axis += slope / reach;
                }
                orthonormalize(axes, ambient);
                if let Some(bend) = bend {
                    bend.iter_mut().zip(curve).for_each(|(bend, curve)| *bend = curve / reach / reach);
                }
                return;
            }
        }
    }
}

/// Gram-Schmidt, twice; `false` if the vectors are dependent.
fn orthonormalize(axes: &mut [f64], ambient: usize) -> bool {
    for at in 0..axes.len() / ambient {
        let (before, rest) = axes.split_at_mut(at * ambient);
        let axis = &mut rest[..ambient];
        for _ in 0..2 {
            for other in before.chunks_exact(ambient) {
                let dot: f64 = other.iter().zip(axis.iter()).map(|(x, y)| x * y).sum();
                for (x, y) in axis.iter_mut().zip(other) {
                    *x -= dot * y;
                }
            }
            let length = axis.iter().map(|x| x * x).sum::<f64>().sqrt();
            if length.is_nan() || length <= 1e-300 {
                return false;
            }
            for x in axis.iter_mut() {
                *x /= length;
            }
        }
    }
    true
}

impl Frames {
    /// Frames of a cloud's points, and their `width` nearest neighbours.
    pub(crate) fn new(cloud: &Cloud, dimension: usize, width: usize, control: &Control, from: f64, to: f64) -> Result<Frames> {
        let (count, ambient) = (cloud.count(), cloud.ambient);
        let width = width.min(count - 1);
        let few = [8, 12, 20][dimension.min(3) - 1].min(width); // for principal axes
        let some = [12, 24, 40][dimension.min(3) - 1].min(width); // for the polynomial fit
        let near = (SPACING_RANK - 1).min(width - 1);
        let mut neighbors = vec![0u32; count * width];
        let mut axes = vec![0.0; count * dimension * ambient];
        let curves = dimension * (dimension + 1) / 2;
        let mut bends = vec![0.0; count * curves * ambient];
        let mut spacing = vec![0.0; count];
        let mut span = vec![0.0; count];
        let mut nearest = vec![0.0; count];
        let mut growth = vec![0.0; count];
        let mut states = vec![State::Sound; count];
        let progress = Progress::new(count, from, to, control);
        (neighbors.par_chunks_mut(TASK * width))
            .zip(axes.par_chunks_mut(TASK * dimension * ambient))
            .zip(bends.par_chunks_mut(TASK * curves * ambient))
            .zip(spacing.par_chunks_mut(TASK))
            .zip(span.par_chunks_mut(TASK))
            .zip(nearest.par_chunks_mut(TASK))
            .zip(growth.par_chunks_mut(TASK))
            .zip(states.par_chunks_mut(TASK))
            .enumerate()
            .try_for_each_init(
                || Work::new(ambient, dimension, width),
                |work, (task, (((((((neighbors, axes), bends), spacing), span), nearest), growth), states))| -> Result<()> {
                    let tasks = neighbors.chunks_exact_mut(width).zip(axes.chunks_exact_mut(dimension * ambient));
                    for (at, ((neighbors, axes), bends)) in tasks.zip(bends.chunks_exact_mut(curves * ambient)).enumerate() {
                        let rank = task * TASK + at;
                        let mut found = std::mem::take(&mut work.found);
                        cloud.neighbors_into(rank, width, &mut work.near, &mut found)?;
                        neighbors.copy_from_slice(&found);
                        work.offsets(cloud, rank, &found);
                        // neighbours at one distance, as on grids, come all or not at all: what is fitted has the grid's symmetry
                        let some = work.whole_shell(some);
                        let few = work.whole_shell(few).min(some); // neighbours of the other side, which fill up, may be nearer
                        work.offsets.truncate(some * ambient);
                        work.distances.truncate(some);
                        spacing[at] = work.distances[near.min(some - 1)];
                        nearest[at] = work.distances[0];
                        growth[at] = work.growth();
                        if work.distances[0] <= COINCIDENT * spacing[at] {
                            states[at] = State::Duplicate;
                            work.found = found;
                            continue;
                        }
                        let sound = work.axes_of_rows(cloud, rank, dimension, (few, some, width), &mut found, axes)?;
                        work.found = found;
                        if !sound {
                            states[at] = State::Flat;
                        } else if ambient == dimension {
                            axes.fill(0.0);
                            axes.iter_mut().step_by(ambient + 1).for_each(|x| *x = 1.0);
                        } else {
                            work.tilt(ambient, dimension, axes, None);
                            work.tilt(ambient, dimension, axes, Some(bends));
                        }
                        span[at] = work.span(ambient, axes).max(spacing[at]);
                    }
                    progress.step(states.len())
                },
            )?;
        refuse_duplicates(cloud, &states, &neighbors, width)?;
        refuse_isolated(cloud, &spacing, &neighbors, width)?;
        refuse_flat(cloud, &states, dimension)?;
        let mean = growth.iter().sum::<f64>() / count as f64;
        let estimate = if mean > 0.0 && some > 6 { 1.0 / mean } else { dimension as f64 };
        Ok(Frames { dimension, width, neighbors, axes, bends, spacing, span, nearest, estimate })
    }

    pub(crate) fn neighbors(&self, rank: usize) -> &[u32] {
        &self.neighbors[rank * self.width..][..self.width]
    }

    pub(crate) fn bends(&self, rank: usize, ambient: usize) -> &[f64] {
        let size = self.dimension * (self.dimension + 1) / 2 * ambient;
        &self.bends[rank * size..][..size]
    }

    pub(crate) fn axes(&self, rank: usize, ambient: usize) -> &[f64] {
        let size = self.dimension * ambient;
        &self.axes[rank * size..][..size]
    }
}

fn refuse_duplicates(cloud: &Cloud, states: &[State], neighbors: &[u32], width: usize) -> Result<()> {
    let mut copies: Vec<(u32, u32)> = (0..states.len())
        .filter(|&rank| states[rank] == State::Duplicate)
        .map(|rank| (cloud.original[rank], cloud.original[neighbors[rank * width] as usize]))
        .map(|(point, other)| (point.min(other), point.max(other)))
        .collect();
    if copies.is_empty() {
        return Ok(());
    }
    copies.sort_unstable();
    copies.dedup();
    let mut text =
        copies.iter().take(6).map(|(point, other)| format!("point {point} coincides with point {other}")).collect::<Vec<_>>().join(", ");
    if copies.len() > 6 {
        text += &format!(" ({} such pairs in all)", copies.len());
    }
    Err(Error::input(format!("{text}; remove copies, or ask for the first of each to be kept (deduplicate)")))
}

fn refuse_isolated(cloud: &Cloud, spacing: &[f64], neighbors: &[u32], width: usize) -> Result<()> {
    let middle = |values: &mut Vec<f64>| {
        let half = values.len() / 2;
        *values.select_nth_unstable_by(half, f64::total_cmp).1
    };
    let usual = middle(&mut spacing.to_vec());
    let lonely: Vec<usize> = (0..spacing.len())
        .filter(|&rank| spacing[rank] > ISOLATED * usual)
        .filter(|&rank| {
            let mut around: Vec<f64> = neighbors[rank * width..][..width].iter().map(|&j| spacing[j as usize]).collect();
            spacing[rank] > ISOLATED * middle(&mut around)
        })
        .collect();
    if lonely.is_empty() {
        return Ok(());
    }
    let (names, many) = (cloud.names(lonely.iter().copied()), lonely.len() > 1);
    Err(Error::input(format!(
        "point{} {} {} isolated: the 6th neighbour is {:.3e} away, {} times as far as is usual in this cloud; remove {}",
        if many { "s" } else { "" },
        name_some(&names),
        if many { "are" } else { "is" },
        spacing[cloud.rank[names[0] as usize] as usize] / cloud.scale,
        (spacing[cloud.rank[names[0] as usize] as usize] / usual).round(),
        if many { "them" } else { "it" },
    )))
}

fn refuse_flat(cloud: &Cloud, states: &[State], dimension: usize) -> Result<()> {
    let names = cloud.names((0..states.len()).filter(|&rank| states[rank] == State::Flat));
    if names.is_empty() {
        return Ok(());
    }
    let place = ["at one place", "on a line", "in a plane"].get(dimension - 1).copied().unwrap_or("in a subspace of less dimension");
    Err(Error::input(format!(
        "the neighbours of {} of {} points ({}) lie {place}, which gives no {dimension}-dimensional tangent space; remove these points, \
         give a smaller dimension=, or reach farther with a larger neighbors=",
        names.len(),
        states.len(),
        name_some(&names),
    )))
}
