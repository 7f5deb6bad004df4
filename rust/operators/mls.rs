//! Moving least squares on a point cloud (Liang and Zhao, SIAM Journal on Scientific Computing 2013): gradient and
//! Laplace-Beltrami operator from local polynomial fits.
//!
//! At each point the cloud is written as a graph over its tangent space, and the graph as well as any function on the cloud is
//! fitted by a polynomial of degree p in the d tangential coordinates t, with weights that are 1 at the point and 1 / k at its
//! k neighbours. With X(t) = (t, h(t)) the fit, X_a = (e_a, h_a) are the tangent vectors at the point,
//! g_ab = δ_ab + h_a · h_b is the metric and, all derivatives at t = 0,
//!
//! - grad f = Σ g^ab f_b X_a
//! - Δf = Σ g^ab (f_ab - Γ^c_ab f_c), with Γ^c_ab = Σ g^cd h_ab · h_d
//!
//! Every derivative is a linear combination of the function's values at the neighbours, so both are sparse matrices.
//!
//! **Sign of the weights.** A row of the Laplacian that is exact for all polynomials is not unique; least squares picks the
//! one of least weighted squares, whose off-diagonal entries may be negative, and then spurious modes may appear. Here, among
//! the rows that are exact, the one is picked whose negative part counts 10^4 times as much as the positive one. Where a
//! row without any negative entry exists it is found; if all rows are such, all eigenvalues of -Δ have real parts >= 0 by
//! Gershgorin's theorem. Exactness of degree 4 excludes such rows (|t|^4 has a vanishing Laplacian and positive values), and
//! so do one-sided neighbourhoods where a cloud ends.

use super::dense::{Monomials, cholesky, cholesky_solve};
use super::frames::{Cloud, Frames, Progress, STEEP, TASK, agree, name_some};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::near::Scratch;
use crate::sparse::Csr;
use rayon::prelude::*;

/// How much more a negative off-diagonal entry counts than a positive one, as its inverse: at first, and where rows without
/// negative entries are near.
const NEGATIVE: [f64; 2] = [1e-4, 1e-8];

/// Pivots of the normal equations below this share of their diagonal entry: the fit is not determined.
const PIVOT: f64 = 1e-11;

/// Rounds of the search for the signs of a row.
const ROUNDS: usize = 16;

/// How much a neighbour counts in a fit, by its distance r from the point and that of the farthest neighbour, R.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MlsWeight {
    /// 1 at the point, 1 / k at each of its k neighbours (Liang and Zhao).
    #[default]
    Special,
    /// exp(-4 r² / R²).
    Gaussian,
    /// (1 - r/R')^4 (1 + 4 r/R') with R' = 1.1 R (Wendland).
    Wendland,
    /// 1 everywhere.
    Uniform,
}

/// How [`moving_least_squares`] goes about it.
#[derive(Debug, Clone)]
pub struct MlsOptions<'a> {
    /// Degree of the polynomials, 1 to 6; 2 to 4 are usual.
    pub degree: usize,
    /// Neighbours of each point; without it, about three and a half times the number of coefficients.
    pub neighbors: Option<usize>,
    /// Weights of the fits.
    pub weight: MlsWeight,
    /// Whether rows of the Laplacian are kept free of negative off-diagonal entries as far as they can be.
    pub constrained: bool,
    /// Outward normals, D numbers per point: points whose normals oppose each other are never neighbours.
    pub normals: Option<&'a [f64]>,
}

impl Default for MlsOptions<'_> {
    fn default() -> Self {
        MlsOptions { degree: 2, neighbors: None, weight: MlsWeight::default(), constrained: true, normals: None }
    }
}

/// Operators of [`moving_least_squares`].
#[derive(Debug, Clone, PartialEq)]
pub struct MlsOperators {
    /// Gradient, (n D) x n: rows i D ... i D + D - 1 give the tangent vector at point i.
    pub gradient: Csr,
    /// Laplace-Beltrami operator, n x n, not symmetric; its rows sum to zero.
    pub laplacian: Csr,
    /// The points whose row of the Laplacian has a negative off-diagonal entry.
    pub signed: Vec<u32>,
    /// The dimension that the growth of the neighbours' distances suggests.
    pub estimated_dimension: f64,
}

/// Gradient and Laplace-Beltrami operator of a cloud of dimension `dimension` in R^`ambient` by moving least squares.
///
/// ```
/// use beltrami::{Control, operators::{MlsOptions, moving_least_squares}};
/// // 6 x 6 grid points of the plane; f = x² + y has Δf = 2 and grad f = (2x, 1)
/// let points: Vec<f64> = (0..36).flat_map(|i| [(i % 6) as f64, (i / 6) as f64]).collect();
/// let f: Vec<f64> = points.chunks(2).map(|p| p[0] * p[0] + p[1]).collect();
/// let mls = moving_least_squares(&points, 2, 2, &MlsOptions::default(), &Control::default())?;
/// assert!(mls.laplacian.multiply(&f)?.iter().all(|x| (x - 2.0).abs() < 1e-9));
/// let gradient = mls.gradient.multiply(&f)?;
/// assert!((gradient[2 * 8] - 4.0).abs() < 1e-9 && (gradient[2 * 8 + 1] - 1.0).abs() < 1e-9);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] naming the points if there are too few, coordinates that are not finite, copies, isolated points, or
/// neighbourhoods that do not determine a fit; [`Error::Numerical`] if an entry overflows; [`Error::Cancelled`].
pub fn moving_least_squares(
    points: &[f64],
    ambient: usize,
    dimension: usize,
    options: &MlsOptions,
    control: &Control,
) -> Result<MlsOperators> {
    if !(1..=6).contains(&options.degree) {
        return Err(Error::input(format!("polynomials of degree {}; choose 2, 3 or 4 (1 to 6 are possible)", options.degree)));
    }
    let cloud = Cloud::new(points, ambient, dimension, options.normals, control)?;
    let monomials = Monomials::new(dimension, options.degree);
    let terms = monomials.len();
    if cloud.count() < terms {
        return Err(Error::input(format!(
            "{} points do not determine the {terms} coefficients of a polynomial of degree {} in {dimension} variables; lower degree=",
            cloud.count(),
            options.degree
        )));
    }
    let width = options.neighbors.unwrap_or(default_neighbors(terms));
    if width + 1 < terms {
        return Err(Error::input(format!(
            "{width} neighbours do not determine the {terms} coefficients of a polynomial of degree {} in {dimension} variables; give {} or more",
            options.degree,
            2 * terms
        )));
    }
    let frames = Frames::new(&cloud, dimension, width, control, 0.1, 0.5)?;
    let progress = Progress::new(cloud.count(), 0.5, 0.95, control);
    let parts: Vec<Part> = (0..cloud.count().div_ceil(TASK))
        .into_par_iter()
        .map_init(
            || MlsWork::new(&cloud, &frames, &monomials, options),
            |work, task| {
                let range = task * TASK..((task + 1) * TASK).min(cloud.count());
                let mut part = Part::default();
                for index in range.clone() {
                    work.point(index, cloud.rank[index] as usize, &mut part)?;
                }
                progress.step(range.len())?;
                Ok(part)
            },
        )
        .collect::<Result<_>>()?;
    let undetermined: Vec<u32> = parts.iter().flat_map(|part| part.undetermined.iter().copied()).collect();
    if !undetermined.is_empty() {
        return Err(Error::input(format!(
            "the neighbours of {} of {} points ({}) do not determine a polynomial of degree {}: they lie on a few lines or curves; \
             lower degree= or reach farther with a larger neighbors=",
            undetermined.len(),
            cloud.count(),
            name_some(&undetermined),
            options.degree
        )));
    }
    let signed = parts.iter().flat_map(|part| part.signed.iter().copied()).collect();
    let (gradient, laplacian) = join(parts, cloud.count(), ambient)?;
    control.report(1.0)?;
    Ok(MlsOperators { gradient, laplacian, signed, estimated_dimension: frames.estimate })
}

fn default_neighbors(terms: usize) -> usize {
    (7 * terms).div_ceil(2) + 3
}

/// Rows of the points of one task.
#[derive(Default)]
struct Part {
    lengths: Vec<u32>,
    indices: Vec<u32>,
    laplacian: Vec<f64>,
    /// For each point, coordinate after coordinate, a row of as many entries as the Laplacian's.
    gradient: Vec<f64>,
    signed: Vec<u32>,
    undetermined: Vec<u32>,
}

struct MlsWork<'a> {
    cloud: &'a Cloud,
    frames: &'a Frames,
    monomials: &'a Monomials,
    options: &'a MlsOptions<'a>,
    near: Scratch,
    found: Vec<u32>,
    /// Neighbours of the fit, the point itself last.
    kept: Vec<u32>,
    basis: Vec<f64>,
    normal: Vec<f64>,
    distances: Vec<f64>,
    weights: Vec<f64>,
    matrix: Vec<f64>,
    vector: Vec<f64>,
    /// A row for each derivative of first and second order: its weight at each neighbour.
    derivatives: Vec<f64>,
    /// Derivatives of the graph, in units of the reach.
    height: Vec<f64>,
    /// Inverse metric.
    inverse: Vec<f64>,
    reach: f64,
    row: Vec<f64>,
    trial: Vec<f64>,
    strengths: Vec<f64>,
    order: Vec<u32>,
}

impl<'a> MlsWork<'a> {
    fn new(cloud: &'a Cloud, frames: &'a Frames, monomials: &'a Monomials, options: &'a MlsOptions<'a>) -> Self {
        let terms = monomials.len();
        MlsWork {
            cloud,
            frames,
            monomials,
            options,
            near: Scratch::default(),
            found: vec![],
            kept: vec![],
            basis: vec![],
            normal: vec![],
            distances: vec![],
            weights: vec![],
            matrix: vec![0.0; terms * terms],
            vector: vec![0.0; 2 * terms],
            derivatives: vec![],
            height: vec![],
            inverse: vec![],
            reach: 1.0,
            row: vec![],
            trial: vec![],
            strengths: vec![],
            order: vec![],
        }
    }

    fn point(&mut self, index: usize, rank: usize, part: &mut Part) -> Result<()> {
        self.found.clear();
        self.found.extend_from_slice(self.frames.neighbors(rank));
        let Some(mut width) = self.determine(rank)? else {
            part.undetermined.push(index as u32);
            return Ok(());
        };
        let mut signed = self.fit();
        // Twice the neighbours often allow a row without negative entries; never if it is exact on polynomials of degree 4.
        if signed && self.options.constrained && self.options.degree < 4 && width < self.cloud.count() - 1 {
            let fewer = self.found.clone();
            width = (2 * width).min(self.cloud.count() - 1);
            self.cloud.neighbors_into(rank, width, &mut self.near, &mut self.found)?;
            signed = self.determine(rank)?.is_none() || self.fit();
            if signed {
                self.found = fewer;
                self.determine(rank)?;
                self.fit();
            }
        }
        if signed {
            part.signed.push(index as u32);
        }
        self.emit(rank, part);
        Ok(())
    }

    /// Doubles the neighbours until they determine the polynomial, and factors its normal equations; how many it took.
    fn determine(&mut self, rank: usize) -> Result<Option<usize>> {
        let (mut width, all) = (self.found.len(), self.cloud.count() - 1);
        loop {
            self.reach = self.coordinates(rank);
            if self.kept.len() >= self.monomials.len() && self.factor(None) {
                return Ok(Some(width));
            }
            if width >= (4 * self.frames.width).min(all) {
                return Ok(None);
            }
            width = (2 * width).min(all);
            self.cloud.neighbors_into(rank, width, &mut self.near, &mut self.found)?;
        }
    }

    /// Neighbours on this sheet: monomials of their scaled tangential coordinates, normal components, weights.
    fn coordinates(&mut self, rank: usize) -> f64 {
        let (ambient, dimension, terms) = (self.cloud.ambient, self.frames.dimension, self.monomials.len());
        let (here, axes) = (self.cloud.point(rank), self.frames.axes(rank, ambient));
        self.kept.clear();
        self.normal.clear();
        self.distances.clear();
        self.basis.clear();
        let mut flat = vec![0.0; dimension];
        let farthest = self.found.last().map_or(here, |&last| self.cloud.point(last as usize));
        let reach = farthest.iter().zip(here).map(|(x, o)| (x - o) * (x - o)).sum::<f64>().sqrt();
        for &neighbor in &self.found {
            let there = self.cloud.point(neighbor as usize);
            let start = self.normal.len();
            self.normal.extend(there.iter().zip(here).map(|(x, o)| x - o));
            let normal = &mut self.normal[start..];
            let square: f64 = normal.iter().map(|x| x * x).sum();
            for (flat, axis) in flat.iter_mut().zip(axes.chunks_exact(ambient)) {
                *flat = axis.iter().zip(normal.iter()).map(|(a, x)| a * x).sum();
            }
            for (flat, axis) in flat.iter_mut().zip(axes.chunks_exact(ambient)) {
                normal.iter_mut().zip(axis).for_each(|(normal, a)| *normal -= *flat * a);
                *flat /= reach;
            }
            let height: f64 = normal.iter().map(|x| x * x).sum();
            let other_sheet = ambient > dimension
                && (height > STEEP * STEEP * square || !agree(axes, self.frames.axes(neighbor as usize, ambient), ambient, dimension));
            if other_sheet {
                self.normal.truncate(start);
                continue;
            }
            self.kept.push(neighbor);
            self.distances.push(square.sqrt());
            let start = self.basis.len();
            self.basis.resize(start + terms, 0.0);
            self.monomials.evaluate(&flat, &mut self.basis[start..]);
        }
        let count = self.kept.len();
        let farthest = self.distances.last().copied().unwrap_or(1.0);
        self.weights.clear();
        self.weights.extend(self.distances.iter().map(|&r| {
            let r = r / farthest;
            match self.options.weight {
                MlsWeight::Special => 1.0 / count as f64,
                MlsWeight::Gaussian => (-4.0 * r * r).exp(),
                MlsWeight::Wendland => (1.0 - r / 1.1).powi(4) * (1.0 + 4.0 * r / 1.1),
                MlsWeight::Uniform => 1.0,
            }
        }));
        self.kept.push(rank as u32);
        self.weights.push(1.0);
        self.normal.resize(self.normal.len() + ambient, 0.0);
        self.basis.resize((count + 1) * terms, 0.0);
        self.basis[count * terms] = 1.0;
        reach
    }

    /// Cholesky factor of the normal equations, each neighbour's weight times its strength.
    fn factor(&mut self, strengths: Option<&[f64]>) -> bool {
        let terms = self.monomials.len();
        self.matrix.fill(0.0);
        for (j, basis) in self.basis.chunks_exact(terms).enumerate() {
            let weight = self.weights[j] * strengths.map_or(1.0, |strengths| strengths[j]);
            if weight == 0.0 {
                continue;
            }
            for a in 0..terms {
                let x = weight * basis[a];
                let row = &mut self.matrix[a * terms..][..=a];
                row.iter_mut().zip(basis).for_each(|(m, y)| *m += x * y);
            }
        }
        cholesky(&mut self.matrix, terms, PIVOT)
    }

    /// The row of least weighted squares with the moments `target`, corrected until its moments are exact to rounding; whether
    /// they are: ill-conditioned normal equations can fail.
    fn solve(&mut self, target: &[f64], strengths: Option<&[f64]>, out: &mut [f64]) -> bool {
        let terms = self.monomials.len();
        let mut vector = std::mem::take(&mut self.vector);
        let (solution, residual) = vector.split_at_mut(terms);
        let scale = target.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        residual.copy_from_slice(target);
        out.fill(0.0);
        let mut exact = false;
        for _ in 0..4 {
            solution.copy_from_slice(residual);
            cholesky_solve(&self.matrix, terms, solution);
            residual.copy_from_slice(target);
            let mut size = scale;
            for (j, basis) in self.basis.chunks_exact(terms).enumerate() {
                let weight = self.weights[j] * strengths.map_or(1.0, |strengths| strengths[j]);
                if weight != 0.0 {
                    out[j] += weight * basis.iter().zip(solution.iter()).map(|(x, y)| x * y).sum::<f64>();
                    size = size.max(out[j].abs());
                    residual.iter_mut().zip(basis).for_each(|(r, b)| *r -= out[j] * b);
                }
            }
            exact = residual.iter().all(|r| r.abs() <= 1e-13 * size);
            if exact {
                break;
            }
        }
        self.vector = vector;
        exact
    }

    /// Weights of the derivatives of first and second order, in scaled coordinates.
    fn differentiate(&mut self) {
        let (terms, dimension, count) = (self.monomials.len(), self.frames.dimension, self.kept.len());
        let wanted = (dimension + dimension * (dimension + 1) / 2).min(terms - 1);
        let mut derivatives = std::mem::take(&mut self.derivatives);
        derivatives.resize(wanted * count, 0.0);
        let mut target = vec![0.0; terms];
        for (at, out) in derivatives.chunks_exact_mut(count).enumerate() {
            target.fill(0.0);
            target[1 + at] = 1.0;
            self.solve(&target, None, out);
        }
        self.derivatives = derivatives;
    }

    /// Fits the graph, and from it the row of the Laplacian; whether that has a negative entry beside the diagonal.
    fn fit(&mut self) -> bool {
        self.differentiate();
        let (ambient, dimension, terms, count) = (self.cloud.ambient, self.frames.dimension, self.monomials.len(), self.kept.len());
        let wanted = self.derivatives.len() / count;
        self.height.clear();
        self.height.resize(wanted * ambient, 0.0);
        if ambient > dimension {
            for (height, derivative) in self.height.chunks_exact_mut(ambient).zip(self.derivatives.chunks_exact(count)) {
                for (&c, normal) in derivative.iter().zip(self.normal.chunks_exact(ambient)) {
                    height.iter_mut().zip(normal).for_each(|(h, x)| *h += c * x / self.reach);
                }
            }
        }
        let first = |a: usize| &self.height[a * ambient..][..ambient];
        let second = |a: usize, b: usize| (self.monomials.second(a, b) - 1, if a == b { 2.0 } else { 1.0 });
        let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        let mut metric = vec![0.0; dimension * dimension];
        for a in 0..dimension {
            for b in 0..dimension {
                metric[a * dimension + b] = dot(first(a), first(b)) + if a == b { 1.0 } else { 0.0 };
            }
        }
        let sound = cholesky(&mut metric, dimension, 0.0);
        let mut inverse = vec![0.0; dimension * dimension];
        for (a, column) in inverse.chunks_exact_mut(dimension).enumerate() {
            column[a] = 1.0;
            if sound {
                cholesky_solve(&metric, dimension, column);
            }
        }
        let mut target = vec![0.0; terms];
        for a in 0..dimension {
            for b in 0..dimension {
                let (at, factor) = second(a, b);
                if at >= wanted {
                    continue; // degree 1 has no second derivatives
                }
                let g = inverse[a * dimension + b];
                target[1 + at] += g * factor;
                for e in 0..dimension {
                    let bend = factor * dot(&self.height[at * ambient..][..ambient], first(e));
                    for c in 0..dimension {
                        target[1 + c] -= g * inverse[c * dimension + e] * bend;
                    }
                }
            }
        }
        let mut row = std::mem::take(&mut self.row);
        row.clear();
        row.resize(count, 0.0);
        for (at, derivative) in self.derivatives.chunks_exact(count).enumerate() {
            row.iter_mut().zip(derivative).for_each(|(row, c)| *row += target[1 + at] * c);
        }
        if self.options.constrained && row[..count - 1].iter().any(|&c| c < 0.0) {
            self.constrain(&target, &mut row);
        }
        let signed = row[..count - 1].iter().any(|&c| c < 0.0);
        row[count - 1] = -row[..count - 1].iter().sum::<f64>();
        self.row = row;
        self.inverse = inverse;
        signed
    }

    /// The rows of a point in the caller's numbering and units.
    fn emit(&mut self, rank: usize, part: &mut Part) {
        let (ambient, dimension, count) = (self.cloud.ambient, self.frames.dimension, self.kept.len());
        let unit = self.cloud.scale / self.reach;
        let names = |at: u32| self.cloud.original[self.kept[at as usize] as usize];
        self.order.clear();
        self.order.extend(0..count as u32);
        self.order.sort_unstable_by_key(|&at| names(at));
        part.lengths.push(count as u32);
        part.indices.extend(self.order.iter().map(|&at| names(at)));
        part.laplacian.extend(self.order.iter().map(|&at| self.row[at as usize] * unit * unit));
        let axes = self.frames.axes(rank, ambient);
        for coordinate in 0..ambient {
            let lift: Vec<f64> = (0..dimension)
                .map(|b| {
                    (0..dimension)
                        .map(|a| self.inverse[a * dimension + b] * (axes[a * ambient + coordinate] + self.height[a * ambient + coordinate]))
                        .sum::<f64>()
                })
                .collect();
            part.gradient.extend(
                self.order.iter().map(|&at| {
                    unit * lift.iter().enumerate().map(|(b, lift)| lift * self.derivatives[b * count + at as usize]).sum::<f64>()
                }),
            );
        }
    }

    /// Among all rows of these moments, the one with the least sum of squares over weights, negative off-diagonal entries
    /// counted 1 / [`NEGATIVE`] times more: Newton's method on the dual, whose Hessian changes only where an entry changes its sign.
    fn constrain(&mut self, target: &[f64], row: &mut [f64]) {
        let count = row.len();
        let mut strengths = std::mem::take(&mut self.strengths);
        let mut trial = std::mem::take(&mut self.trial);
        trial.resize(count, 0.0);
        let burden = |row: &[f64]| row[..count - 1].iter().map(|&c| c.min(0.0) * c.min(0.0)).sum::<f64>();
        let mut least = burden(row);
        let mut current = row.to_vec();
        'found: for strength in NEGATIVE {
            for _ in 0..ROUNDS {
                let signs = |strength: f64| move |(j, &c): (usize, &f64)| if j + 1 < count && c < 0.0 { strength } else { 1.0 };
                // First whether the positive entries alone can do it; for degree 4 they never can.
                strengths.clear();
                strengths.extend(current.iter().enumerate().map(signs(0.0)));
                if self.options.degree < 4
                    && self.factor(Some(&strengths))
                    && self.solve(target, Some(&strengths), &mut trial)
                    && trial[..count - 1].iter().all(|&c| c >= 0.0)
                {
                    row.copy_from_slice(&trial);
                    break 'found;
                }
                strengths.clear();
                strengths.extend(current.iter().enumerate().map(signs(strength)));
                if !(self.factor(Some(&strengths)) && self.solve(target, Some(&strengths), &mut trial)) {
                    break 'found;
                }
                let negative = burden(&trial);
                if negative < least {
                    least = negative;
                    row.copy_from_slice(&trial);
                }
                let settled = trial[..count - 1].iter().zip(&current).all(|(x, y)| (*x < 0.0) == (*y < 0.0));
                current.copy_from_slice(&trial);
                if settled {
                    break;
                }
            }
            if self.options.degree >= 4 {
                break; // no row without negative entries exists
            }
        }
        self.trial = trial;
        self.strengths = strengths;
    }
}

/// One matrix from the parts, gradient rows D times as many.
fn join(parts: Vec<Part>, count: usize, ambient: usize) -> Result<(Csr, Csr)> {
    let total: usize = parts.iter().map(|part| part.indices.len()).sum();
    let finite = parts.par_iter().all(|part| part.laplacian.iter().chain(&part.gradient).all(|value| value.is_finite()));
    if !finite {
        return Err(Error::numerical("an entry of the operator overflows; measure the coordinates in larger units"));
    }
    let mut starts = Vec::with_capacity(count + 1);
    let mut gradient_starts = Vec::with_capacity(count * ambient + 1);
    starts.push(0);
    gradient_starts.push(0);
    for part in &parts {
        for &length in &part.lengths {
            starts.push(starts[starts.len() - 1] + length as usize);
            for _ in 0..ambient {
                gradient_starts.push(gradient_starts[gradient_starts.len() - 1] + length as usize);
            }
        }
    }
    let (mut indices, mut values) = (Vec::with_capacity(total), Vec::with_capacity(total));
    let mut gradient_indices = vec![0; total * ambient];
    let mut gradient_values = vec![0.0; total * ambient];
    let (mut rest_indices, mut rest_values) = (&mut gradient_indices[..], &mut gradient_values[..]);
    let mut slices = Vec::with_capacity(parts.len());
    for part in &parts {
        indices.extend_from_slice(&part.indices);
        values.extend_from_slice(&part.laplacian);
        let (indices, more) = rest_indices.split_at_mut(part.gradient.len());
        rest_indices = more;
        let (values, more) = rest_values.split_at_mut(part.gradient.len());
        rest_values = more;
        slices.push((indices, values));
    }
    slices.into_par_iter().zip(&parts).for_each(|((indices, values), part)| {
        values.copy_from_slice(&part.gradient);
        let (mut to, mut from) = (0, 0);
        for &length in &part.lengths {
            let row = &part.indices[from..from + length as usize];
            for _ in 0..ambient {
                indices[to..to + row.len()].copy_from_slice(row);
                to += row.len();
            }
            from += row.len();
        }
    });
    Ok((
        Csr::trusted(count * ambient, count, gradient_starts, gradient_indices, gradient_values),
        Csr::trusted(count, count, starts, indices, values),
    ))
}
