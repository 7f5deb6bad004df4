//! Inner loops of near-isometric registration: functional maps as orthogonal matrices, several candidates at a time, and the
//! rotations of as-rigid-as-possible deformation.
//!
//! A functional map C (n x n, row after row) between two shapes with eigenfunctions Φ and Ψ says that `Φ C` is close to `Ψ ∘ T`
//! for the point map T. [`ascend`] climbs the agreement of triple products, [`upsample`] is one level of spectral upsampling in
//! both directions, [`Rigid`] fits a rotation to each vertex' neighbourhood.

use crate::control::Control;
use crate::error::{Error, Result};
use crate::near::nearest_rows;
use crate::operators::dense::symmetric_eigen;
use crate::sparse::{CHUNK, Csr};
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;

fn shape_error(what: &str) -> Error {
    Error::input(format!("{what} do not fit together"))
}

fn finite(numbers: &[f64], name: &str) -> Result<()> {
    match numbers.iter().position(|number| !number.is_finite()) {
        None => Ok(()),
        Some(at) => Err(Error::input(format!("{name}: number {at} is {}", numbers[at]))),
    }
}

/// The orthogonal matrix nearest to a square one (row after row): U V^T of its singular value decomposition.
///
/// ```
/// let turn = beltrami::register::polar(&[0.0, 2.0, -2.0, 0.0], 2)?;
/// assert!(turn.iter().zip([0.0, 1.0, -1.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-15));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if `matrix` is no n x n matrix of finite numbers; [`Error::Numerical`] if the decomposition fails.
pub fn polar(matrix: &[f64], n: usize) -> Result<Vec<f64>> {
    if matrix.len() != n * n {
        return Err(shape_error("a matrix and its order"));
    }
    finite(matrix, "the matrix")?;
    let svd = MatRef::from_row_major_slice(matrix, n, n)
        .svd()
        .map_err(|_| Error::numerical("a singular value decomposition did not converge"))?;
    let mut product = vec![0.0; n * n];
    matmul(MatMut::from_row_major_slice_mut(&mut product, n, n), Accum::Replace, svd.U(), svd.V().transpose(), 1.0, Par::Seq);
    Ok(product)
}

/// Triple products of eigenfunctions, n x n x n: `even` does not change when indices are exchanged, `odd` changes its sign.
#[derive(Debug, Clone, Copy)]
pub struct Triple<'a> {
    /// `∫ φ_i φ_j φ_k`
    pub even: &'a [f64],
    /// `∫ φ_i dφ_j ∧ dφ_k`: a mirror image has the other sign.
    pub odd: &'a [f64],
}

/// `(<A, C B>, its gradient by C / 3)` for A and B that do not change when indices are rotated.
fn agreement(map: &[f64], n: usize, a: &[f64], b: &[f64], work: &mut [Vec<f64>; 2], gradient: &mut [f64]) -> f64 {
    let c = MatRef::from_row_major_slice(map, n, n);
    let [first, second] = work;
    // first[k, (l, m)] = Σ_p C_kp B_plm
    let all = MatRef::from_row_major_slice(b, n, n * n);
    matmul(MatMut::from_row_major_slice_mut(&mut first[..], n, n * n), Accum::Replace, c, all, 1.0, Par::Seq);
    // second[(k, l), j] = Σ_m first[(k, l), m] C_jm
    let rows = MatRef::from_row_major_slice(&first[..], n * n, n);
    matmul(MatMut::from_row_major_slice_mut(&mut second[..], n * n, n), Accum::Replace, rows, c.transpose(), 1.0, Par::Seq);
    // gradient[i, l] = Σ_kj A_kij second[k, l, j]
    gradient.fill(0.0);
    for (left, right) in a.chunks_exact(n * n).zip(second.chunks_exact(n * n)) {
        matmul(
            MatMut::from_row_major_slice_mut(gradient, n, n),
            Accum::Add,
            MatRef::from_row_major_slice(left, n, n),
            MatRef::from_row_major_slice(right, n, n).transpose(),
            1.0,
            Par::Seq,
        );
    }
    gradient.iter().zip(map).map(|(g, c)| g * c).sum()
}

/// Steps `C <- polar(gradient of S + C / 2)` for several maps, where S is `<source.even, C target.even>`, plus `weight` times
/// `<source.odd, C target.odd>`, plus `<linear, C>`; C acts on all three indices of a triple product, `linear` (n x n) is what
/// features say of it. Returns the maps, and for each the three inner products at the end.
///
/// ```
/// use beltrami::{Control, register::{Triple, ascend}};
/// // one mode: the products agree if the sign is kept
/// let triple = Triple { even: &[2.0], odd: &[0.0] };
/// let (maps, scores) = ascend(&[-1.0, 1.0], 1, triple, triple, 1.0, &[0.0], 3, &Control::default())?;
/// assert_eq!((maps, scores), (vec![1.0, 1.0], vec![[4.0, 0.0, 0.0]; 2]));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if lengths do not fit or a number is not finite; [`Error::Cancelled`].
pub fn ascend(
    maps: &[f64],
    n: usize,
    source: Triple<'_>,
    target: Triple<'_>,
    weight: f64,
    linear: &[f64],
    steps: usize,
    control: &Control,
) -> Result<(Vec<f64>, Vec<[f64; 3]>)> {
    let cube = n * n * n;
    if n == 0 || !maps.len().is_multiple_of(n * n) || [source.even, source.odd, target.even, target.odd].iter().any(|t| t.len() != cube) {
        return Err(shape_error("maps and triple products"));
    }
    if linear.len() != n * n {
        return Err(shape_error("maps and their linear term"));
    }
    for numbers in [source.even, source.odd, target.even, target.odd, linear] {
        finite(numbers, "triple products")?;
    }
    let ends: Vec<(Vec<f64>, [f64; 3])> = maps
        .par_chunks_exact(n * n)
        .map(|map| {
            let mut map = map.to_vec();
            let mut work = [vec![0.0; cube], vec![0.0; cube]];
            let (mut even, mut odd) = (vec![0.0; n * n], vec![0.0; n * n]);
            let mut scores = [0.0; 3];
            for step in 0..=steps {
                control.check()?;
                scores[0] = agreement(&map, n, source.even, target.even, &mut work, &mut even);
                scores[1] = agreement(&map, n, source.odd, target.odd, &mut work, &mut odd);
                scores[2] = linear.iter().zip(&map).map(|(l, c)| l * c).sum();
                if step < steps {
                    for (((c, even), odd), linear) in map.iter_mut().zip(&even).zip(&odd).zip(linear) {
                        *c = 3.0 * (even + weight * odd) + linear + 0.5 * *c;
                    }
                    map = polar(&map, n)?;
                }
            }
            Ok((map, scores))
        })
        .collect::<Result<_>>()?;
    let scores = ends.iter().map(|end| end.1).collect();
    Ok((ends.into_iter().flat_map(|end| end.0).collect(), scores))
}

/// A shape as upsampling sees it: eigenfunctions at some of its points, row after row, with the points' masses and features.
#[derive(Debug, Clone, Copy)]
pub struct Spectral<'a> {
    /// Points x modes.
    pub functions: &'a [f64],
    /// How many modes there are.
    pub modes: usize,
    /// Points x features, already weighted; may be empty.
    pub features: &'a [f64],
    /// The mass of each point.
    pub masses: &'a [f64],
}

impl Spectral<'_> {
    fn check(&self) -> Result<usize> {
        let count = self.masses.len();
        if count == 0 || self.functions.len() != count * self.modes || !self.features.len().is_multiple_of(count) {
            return Err(shape_error("eigenfunctions, features and masses"));
        }
        for (numbers, name) in [(self.functions, "eigenfunctions"), (self.features, "features"), (self.masses, "masses")] {
            finite(numbers, name)?;
        }
        Ok(self.features.len() / count)
    }

    /// Rows `[Φ C / sqrt(k), features]`; without C `[Φ / sqrt(k), features]`.
    fn rows(&self, map: Option<&[f64]>, k: usize) -> Vec<f64> {
        let count = self.masses.len();
        let extra = self.features.len() / count;
        let width = k + extra;
        let mut rows = vec![0.0; count * width];
        let scale = 1.0 / (k as f64).sqrt();
        let left = MatRef::from_row_major_slice(self.functions, count, self.modes).subcols(0, k);
        let (mut spectral, _) = MatMut::from_row_major_slice_mut(&mut rows, count, width).split_at_col_mut(k);
        match map {
            Some(map) => matmul(spectral, Accum::Replace, left, MatRef::from_row_major_slice(map, k, k), scale, Par::Seq),
            None => spectral.copy_from(faer::Scale(scale) * left),
        }
        for (row, features) in rows.chunks_exact_mut(width).zip(self.features.chunks_exact(extra.max(1))) {
            row[k..].copy_from_slice(features);
        }
        rows
    }
}

/// `Σ_x mass(x) a(x) b(T(x))^T`, added to `sum`, over the first k modes.
fn cross(a: &Spectral<'_>, b: &Spectral<'_>, points: &[u32], masses: &[f64], at_source: bool, k: usize, sum: &mut [f64]) {
    let count = points.len();
    let mut left = vec![0.0; count * k];
    let mut right = vec![0.0; count * k];
    for (x, (&image, &mass)) in points.iter().zip(masses).enumerate() {
        let (i, j) = if at_source { (x, image as usize) } else { (image as usize, x) };
        for (value, &function) in left[x * k..][..k].iter_mut().zip(&a.functions[i * a.modes..]) {
            *value = mass * function;
        }
        right[x * k..][..k].copy_from_slice(&b.functions[j * b.modes..][..k]);
    }
    matmul(
        MatMut::from_row_major_slice_mut(sum, k, k),
        Accum::Add,
        MatRef::from_row_major_slice(&left, count, k).transpose(),
        MatRef::from_row_major_slice(&right, count, k),
        1.0,
        Par::Seq,
    );
}

/// Nearest rows in both directions for one functional map of order k: for each source point a target point, and back.
///
/// ```
/// use beltrami::{Control, register::{Spectral, functional_map, point_maps}};
/// let source = Spectral { functions: &[-1.0, 0.0, 2.0], modes: 1, features: &[], masses: &[1.0; 3] };
/// let target = Spectral { functions: &[-2.0, 1.0, 0.0], ..source }; // the sign of the mode has changed
/// let (forward, backward) = point_maps(&[-1.0], 1, source, target, &Control::default())?;
/// assert_eq!((&forward[..], &backward[..]), (&[1, 2, 0][..], &[2, 0, 1][..]));
/// assert_eq!(functional_map(&forward, &backward, 1, source, target)?, [-1.0]);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if lengths do not fit or a number is not finite; [`Error::Cancelled`].
pub fn point_maps(map: &[f64], k: usize, source: Spectral<'_>, target: Spectral<'_>, control: &Control) -> Result<(Vec<u32>, Vec<u32>)> {
    let width = source.check()?;
    if target.check()? != width || map.len() != k * k || k == 0 || k > source.modes.min(target.modes) {
        return Err(shape_error("the functional map and the two shapes"));
    }
    let (x, y) = (source.rows(Some(map), k), target.rows(None, k));
    let forward = nearest_rows(&y, k + width, &x, control)?.0;
    let backward = nearest_rows(&x, k + width, &y, control)?.0;
    Ok((forward, backward))
}

/// The orthogonal functional map of order k that fits two point maps, one in each direction, best; see [`point_maps`] for an example.
///
/// # Errors
/// [`Error::Input`] if lengths do not fit or a point is not there.
pub fn functional_map(forward: &[u32], backward: &[u32], k: usize, source: Spectral<'_>, target: Spectral<'_>) -> Result<Vec<f64>> {
    let (n, m) = (source.masses.len(), target.masses.len());
    if forward.len() != n || backward.len() != m || k == 0 || k > source.modes.min(target.modes) {
        return Err(shape_error("point maps and the two shapes"));
    }
    if forward.iter().any(|&point| point as usize >= m) || backward.iter().any(|&point| point as usize >= n) {
        return Err(Error::input("a point map leaves the shape"));
    }
    let mut sum = vec![0.0; k * k];
    cross(&source, &target, forward, source.masses, true, k, &mut sum);
    cross(&source, &target, backward, target.masses, false, k, &mut sum);
    polar(&sum, k)
}

/// One level of spectral upsampling in both directions (Melzi et al. 2019; two-way as in Ren et al. 2020) for several maps of
/// order k at a time: point maps from `C`, and from them maps of order `next`.
///
/// ```
/// use beltrami::{Control, register::{Spectral, upsample}};
/// let source = Spectral { functions: &[-1.0, 1.0, 0.0, -2.0, 1.0, 1.0], modes: 2, features: &[], masses: &[1.0; 3] };
/// let target = Spectral { functions: &[-1.0, -1.0, 0.0, 2.0, 1.0, -1.0], ..source }; // the sign of the second mode has changed
/// let map = upsample(&[1.0], 1, 2, source, target, &Control::default())?;
/// assert!(map.iter().zip([1.0, 0.0, 0.0, -1.0]).all(|(a, b)| (a - b).abs() < 1e-15));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if lengths do not fit or a number is not finite; [`Error::Cancelled`].
pub fn upsample(maps: &[f64], k: usize, next: usize, source: Spectral<'_>, target: Spectral<'_>, control: &Control) -> Result<Vec<f64>> {
    if k == 0 || !maps.len().is_multiple_of(k * k) {
        return Err(shape_error("maps and their order"));
    }
    let found: Vec<Vec<f64>> = maps
        .par_chunks_exact(k * k)
        .map(|map| {
            let (forward, backward) = point_maps(map, k, source, target, control)?;
            functional_map(&forward, &backward, next, source, target)
        })
        .collect::<Result<_>>()?;
    Ok(found.concat())
}

/// The neighbourhoods of a surface in R^3 and their shape at rest.
#[derive(Debug, Clone)]
pub struct Rigid {
    weights: Csr,
    rest: Vec<[f64; 3]>,
}

/// What [`Rigid::fit`] found.
#[derive(Debug, Clone, PartialEq)]
pub struct RigidFit {
    /// `Σ_j w_ij (s_i R_i + s_j R_j) / 2 (r_i - r_j)`: the right-hand side for new positions, three numbers per vertex.
    pub right: Vec<f64>,
    /// `1/2 Σ_ij w_ij |x_j - x_i - R_i (r_j - r_i)|^2`, without scales.
    pub energy: f64,
}

impl Rigid {
    /// Weights w_ij >= 0 between neighbours (symmetric, without a diagonal) and positions at rest, three numbers per vertex.
    ///
    /// ```
    /// use beltrami::{Csr, register::Rigid};
    /// let edge = Csr::new(2, 2, vec![0, 1, 2], vec![1, 0], vec![1.0, 1.0])?;
    /// let fit = Rigid::new(edge, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0])?.fit(&[0.0, 0.0, 0.0, 0.0, 3.0, 0.0], 0.0)?;
    /// assert!((fit.energy - 4.0).abs() < 1e-12); // turned freely, twice as long
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if lengths do not fit or a number is not finite.
    pub fn new(weights: Csr, rest: &[f64]) -> Result<Rigid> {
        if weights.rows() != weights.columns() || rest.len() != 3 * weights.rows() {
            return Err(shape_error("weights and positions"));
        }
        finite(rest, "positions")?;
        finite(weights.values(), "weights")?;
        Ok(Rigid { rest: rest.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect(), weights })
    }

    fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.weights.starts()[i]..self.weights.starts()[i + 1];
        self.weights.indices()[range.clone()].iter().zip(&self.weights.values()[range]).map(|(&j, &w)| (j as usize, w))
    }

    /// The best rotation of each vertex' neighbourhood (covariances added up over the ring) from rest to `positions`, and what
    /// follows from it. With `stretch` > 0 neighbourhoods may also change their size: rotations are multiplied by the local
    /// scale, between 1/2 and 2, to this power.
    ///
    /// # Errors
    /// [`Error::Input`] if there are not three finite numbers per vertex.
    pub fn fit(&self, positions: &[f64], stretch: f64) -> Result<RigidFit> {
        let n = self.rest.len();
        if positions.len() != 3 * n {
            return Err(shape_error("positions and weights"));
        }
        finite(positions, "positions")?;
        let at = |i: usize| [positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]];
        let minus = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        // covariance of rest and position (9), squared lengths of both
        let local: Vec<[f64; 11]> = (0..n)
            .into_par_iter()
            .with_min_len(CHUNK / 16)
            .map(|i| {
                let mut sum = [0.0; 11];
                for (j, w) in self.row(i) {
                    let (r, x) = (minus(self.rest[j], self.rest[i]), minus(at(j), at(i)));
                    for a in 0..3 {
                        for b in 0..3 {
                            sum[3 * a + b] += w * r[a] * x[b];
                        }
                        sum[9] += w * r[a] * r[a];
                        sum[10] += w * x[a] * x[a];
                    }
                }
                sum
            })
            .collect();
        let turns: Vec<([f64; 9], f64)> = (0..n)
            .into_par_iter()
            .with_min_len(CHUNK / 16)
            .map(|i| {
                let mut sum = local[i];
                for (j, _) in self.row(i) {
                    sum.iter_mut().zip(&local[j]).for_each(|(sum, part)| *sum += part);
                }
                let scale = if stretch > 0.0 && sum[9] > 0.0 { (sum[10] / sum[9]).sqrt().clamp(0.5, 2.0).powf(stretch) } else { 1.0 };
                (rotation(&sum[..9]), scale)
            })
            .collect();
        let apply = |turn: &[f64; 9], r: [f64; 3], out: &mut [f64; 3], factor: f64| {
            for a in 0..3 {
                out[a] += factor * (turn[3 * a] * r[0] + turn[3 * a + 1] * r[1] + turn[3 * a + 2] * r[2]);
            }
        };
        let rows: Vec<([f64; 3], f64)> = (0..n)
            .into_par_iter()
            .with_min_len(CHUNK / 16)
            .map(|i| {
                let (mut right, mut energy) = ([0.0; 3], 0.0);
                for (j, w) in self.row(i) {
                    let r = minus(self.rest[j], self.rest[i]);
                    apply(&turns[i].0, r, &mut right, -0.5 * w * turns[i].1);
                    apply(&turns[j].0, r, &mut right, -0.5 * w * turns[j].1);
                    let mut off = minus(at(j), at(i));
                    apply(&turns[i].0, r, &mut off, -1.0);
                    energy += 0.5 * w * off.iter().map(|d| d * d).sum::<f64>();
                }
                (right, energy)
            })
            .collect();
        Ok(RigidFit { right: rows.iter().flat_map(|row| row.0).collect(), energy: rows.iter().map(|row| row.1).sum() })
    }
}

/// The rotation R that maximizes tr(R S) for a covariance `S = Σ r x^T`: Horn's quaternion (1987), the eigenvector of the largest
/// eigenvalue of a symmetric 4 x 4 matrix without trace. That eigenvalue by Newton's method from above (Theobald 2005), its vector
/// from the adjugate; by a full decomposition where eigenvalues nearly coincide.
fn rotation(s: &[f64]) -> [f64; 9] {
    let largest = s.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    if !(largest > 0.0) {
        return [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    }
    let s: [f64; 9] = std::array::from_fn(|k| s[k] / largest);
    let [xx, xy, xz, yx, yy, yz, zx, zy, zz] = s;
    #[rustfmt::skip]
    let mut matrix = [
        xx + yy + zz, yz - zy, zx - xz, xy - yx,
        yz - zy, xx - yy - zz, xy + yx, zx + xz,
        zx - xz, xy + yx, yy - xx - zz, yz + zy,
        xy - yx, zx + xz, yz + zy, zz - xx - yy,
    ];
    let square: f64 = s.iter().map(|x| x * x).sum();
    let linear = -8.0 * (xx * (yy * zz - yz * zy) - xy * (yx * zz - yz * zx) + xz * (yx * zy - yy * zx));
    let constant = adjugate(&matrix).1;
    let mut top = (3.0 * square).sqrt(); // no singular values of S add up to more
    for _ in 0..50 {
        let slope = (4.0 * top * top - 4.0 * square) * top + linear;
        let step = (((top * top - 2.0 * square) * top + linear) * top + constant) / slope;
        if !(step > 1e-15 * top) {
            break;
        }
        top -= step;
    }
    let mut shifted = matrix;
    (0..4).for_each(|k| shifted[5 * k] -= top);
    let columns = adjugate(&shifted).0;
    let best = (0..4).fold(0, |best, k| if columns[k][k].abs() > columns[best][best].abs() { k } else { best });
    let length = columns[best].iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 1e-3 {
        return turn(columns[best].map(|x| x / length));
    }
    let (mut values, mut work) = ([0.0; 4], [0.0; 4]);
    if !symmetric_eigen(&mut matrix, 4, &mut values, &mut work) {
        return [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    }
    turn([matrix[3], matrix[7], matrix[11], matrix[15]])
}

/// Adjugate, row after row, and determinant of a symmetric matrix of order 4.
fn adjugate(m: &[f64; 16]) -> ([[f64; 4]; 4], f64) {
    let minor = |row: usize, a: usize, b: usize| m[row + a] * m[row + 4 + b] - m[row + 4 + a] * m[row + b];
    let [s0, s1, s2, s3, s4, s5] = [minor(0, 0, 1), minor(0, 0, 2), minor(0, 0, 3), minor(0, 1, 2), minor(0, 1, 3), minor(0, 2, 3)];
    let [c0, c1, c2, c3, c4, c5] = [minor(8, 0, 1), minor(8, 0, 2), minor(8, 0, 3), minor(8, 1, 2), minor(8, 1, 3), minor(8, 2, 3)];
    let b00 = m[5] * c5 - m[6] * c4 + m[7] * c3;
    let b01 = -m[1] * c5 + m[2] * c4 - m[3] * c3;
    let b02 = m[13] * s5 - m[14] * s4 + m[15] * s3;
    let b03 = -m[9] * s5 + m[10] * s4 - m[11] * s3;
    let b11 = m[0] * c5 - m[2] * c2 + m[3] * c1;
    let b12 = -m[12] * s5 + m[14] * s2 - m[15] * s1;
    let b13 = m[8] * s5 - m[10] * s2 + m[11] * s1;
    let b22 = m[12] * s4 - m[13] * s2 + m[15] * s0;
    let b23 = -m[8] * s4 + m[9] * s2 - m[11] * s0;
    let b33 = m[8] * s3 - m[9] * s1 + m[10] * s0;
    let determinant = s0 * c5 - s1 * c4 + s2 * c3 + s3 * c2 - s4 * c1 + s5 * c0;
    ([[b00, b01, b02, b03], [b01, b11, b12, b13], [b02, b12, b22, b23], [b03, b13, b23, b33]], determinant)
}

/// The rotation of a unit quaternion.
fn turn([w, x, y, z]: [f64; 4]) -> [f64; 9] {
    [
        w * w + x * x - y * y - z * z,
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        w * w - x * x + y * y - z * z,
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        w * w - x * x - y * y + z * z,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace(r: &[f64; 9], s: &[f64]) -> f64 {
        (0..9).map(|k| r[k] * s[3 * (k % 3) + k / 3]).sum()
    }

    #[test]
    fn rotations_are_the_best_ones() {
        // pseudo-random covariances: full, flat, thin, mirrored, of rank one, tiny and huge
        let mut state = 1u64;
        let mut number = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as f64 / f64::from(1u32 << 30) - 1.0
        };
        for case in 0..2000 {
            let rank = 1 + case % 3;
            let mut s = [0.0; 9];
            for term in 0..rank {
                let (a, b): ([f64; 3], [f64; 3]) = (std::array::from_fn(|_| number()), std::array::from_fn(|_| number()));
                let weight = 10f64.powi(-((term * (case / 3 % 6)) as i32));
                (0..9).for_each(|k| s[k] += weight * a[k / 3] * b[k % 3]);
            }
            let scale = [1e-200, 1.0, 1e150][case % 3];
            let scaled = s.map(|x| x * scale);
            let r = rotation(&scaled);
            for a in 0..3 {
                for b in 0..3 {
                    let product: f64 = (0..3).map(|k| r[3 * a + k] * r[3 * b + k]).sum();
                    assert!((product - f64::from(u8::from(a == b))).abs() < 1e-12);
                }
            }
            let matrix = MatRef::from_row_major_slice(&s, 3, 3);
            let svd = matrix.svd().unwrap();
            let sizes = [svd.S()[0], svd.S()[1], svd.S()[2]];
            let determinant = matrix.determinant();
            let most = sizes[0] + sizes[1] + if determinant < 0.0 { -sizes[2] } else { sizes[2] };
            assert!((trace(&r, &s) - most).abs() < 1e-12 * sizes[0], "{case}: {} {most}", trace(&r, &s));
        }
    }
}
