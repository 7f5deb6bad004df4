//! The eigenpairs of `A x = λ M x` nearest to a shift: block shift-invert Lanczos with thick restart, dense for small matrices.
//!
//! The operator `(A - σ M)^-1 M` is self-adjoint in the inner product of M; its eigenvalues θ = 1 / (λ - σ) of largest size
//! belong to the λ nearest to σ. A block of random vectors finds as many copies of a multiple eigenvalue as it is
//! wide; where a cluster is at least that large, the search goes on from a fresh random block until nothing new appears.
//! The basis is kept orthonormal by two passes of Gram-Schmidt (Grimes, Lewis, Simon 1994; Wu, Simon 2000).

mod basis;
mod dense;
mod lanczos;

use self::basis::{ROWS, gram, transform};
use self::dense::{apart, dense_eigen, dense_pencil};
use self::lanczos::TOLERANCE;
use super::indefinite::Indefinite;
use super::{Cholesky, Scratch};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::Csr;
use faer::Mat;
use rayon::prelude::*;

/// The matrix M of a pencil.
#[derive(Debug, Clone, Copy)]
pub enum Mass<'a> {
    /// A diagonal one, by its entries.
    Diagonal(&'a [f64]),
    /// A symmetric positive definite one.
    Matrix(&'a Csr),
}

/// Settings of [`eigenpairs`].
#[derive(Debug, Clone, Copy, Default)]
pub struct EigenOptions<'a> {
    /// σ: the eigenvalues nearest to it are wanted. By default a negative number of the size of the smallest ones.
    pub shift: Option<f64>,
    /// Coordinates of the unknowns and their number an unknown: a better order for the factorization.
    pub coordinates: Option<(&'a [f64], usize)>,
    /// Vectors to start from, (n, width) row after row; random ones join them, so that no copy is missed.
    pub start: Option<(&'a [f64], usize)>,
}

/// Eigenpairs, by ascending eigenvalue.
#[derive(Debug, Clone, PartialEq)]
pub struct Eigenpairs {
    /// Eigenvalues, k of them.
    pub values: Vec<f64>,
    /// Eigenvectors, (n, k) row after row, orthonormal in the inner product of M; the entry of largest size is positive.
    pub vectors: Vec<f64>,
    /// `|A x - λ M x|` in the norm of M^-1 (of the diagonal of M, where M is a matrix): for a diagonal M an exact eigenvalue
    /// lies within this distance of the value.
    pub residuals: Vec<f64>,
    /// Blocks of solves that were needed; 0 on the dense path.
    pub iterations: usize,
}

const BLOCK: usize = 8; // columns of a block of Lanczos
const DENSE: usize = 256; // matrices up to this size are solved densely
const FAR: f64 = 100.0; // a default shift this many times the largest value wanted is chosen again
const ROUNDING: f64 = 1e-12; // values below this share of the matrix's scale are zeros
const ACCEPTED: f64 = 1e-5; // residual that is handed out, relative to the largest of the values and the shift
const POLISHED: f64 = 1e-8; // residual above which a last step is worth its price
const ASYMMETRY: f64 = 1e-10;

/// The k eigenvalues of `A x = λ M x` nearest to the shift (the smallest, by default) with all copies of multiple ones, and their
/// vectors.
///
/// ```
/// use beltrami::{Control, Csr, solvers::{EigenOptions, Mass, eigenpairs}};
/// let path = Csr::new(3, 3, vec![0, 2, 5, 7], vec![0, 1, 0, 1, 2, 1, 2], vec![1.0, -1.0, -1.0, 2.0, -1.0, -1.0, 1.0])?;
/// let found = eigenpairs(&path, Mass::Diagonal(&[1.0; 3]), 3, &EigenOptions::default(), &Control::default())?;
/// for (value, exact) in found.values.iter().zip([0.0, 1.0, 3.0]) {
///     assert!((value - exact).abs() < 1e-12);
/// }
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if sizes do not fit, a matrix is not symmetric, a mass is negative, or k is more than the unknowns that have
/// mass; [`Error::Numerical`] if M is not positive definite, or A has eigenvalues below the default shift;
/// [`Error::NotConverged`]; [`Error::Cancelled`].
pub fn eigenpairs(matrix: &Csr, mass: Mass, k: usize, options: &EigenOptions, control: &Control) -> Result<Eigenpairs> {
    let n = matrix.rows();
    let (mass_rows, mass_columns) = match mass {
        Mass::Diagonal(diagonal) => (diagonal.len(), diagonal.len()),
        Mass::Matrix(m) => (m.rows(), m.columns()),
    };
    if matrix.columns() != n || (mass_rows, mass_columns) != (n, n) {
        return Err(Error::input(format!(
            "the pencil has matrices of {n} x {} and {mass_rows} x {mass_columns}; they must be square and alike",
            matrix.columns()
        )));
    }
    symmetric(matrix, "the matrix")?;
    if let Mass::Matrix(m) = mass {
        symmetric(m, "the mass matrix")?;
    }
    if let Some(shift) = options.shift.filter(|shift| !shift.is_finite()) {
        return Err(Error::input(format!("shift is {shift}; it must be finite")));
    }
    if let Some((numbers, dimension)) = options.coordinates.filter(|(numbers, dimension)| numbers.len() != n * dimension) {
        return Err(Error::input(format!("coordinates has {} numbers, not {n} rows of {dimension}", numbers.len())));
    }
    if k == 0 {
        return Err(Error::input("0 eigenpairs were asked for; ask for at least 1"));
    }
    if let Some((numbers, width)) = options.start
        && (width == 0 || numbers.len() != n * width || numbers.iter().any(|number| !number.is_finite()))
    {
        return Err(Error::input(format!("start has {} numbers, not {n} rows of {width} finite ones", numbers.len())));
    }
    if let Mass::Diagonal(diagonal) = mass {
        if let Some(row) = diagonal.iter().position(|&entry| !(entry >= 0.0 && entry.is_finite())) {
            return Err(Error::input(format!("mass {row} is {}; masses must be positive and finite", diagonal[row])));
        }
        // Unknowns without mass take no part, if nothing couples them (vertices of no triangle).
        let kept: Vec<usize> = (0..n).filter(|&row| diagonal[row] > 0.0).collect();
        if kept.len() < n {
            return without_massless(matrix, diagonal, &kept, k, options, control);
        }
    }
    if k > n {
        return Err(Error::input(format!("{k} eigenpairs were asked for, {n} unknowns have mass; ask for at most {n}")));
    }
    Pencil { matrix, mass, n }.nearest(k, options, control)
}

fn symmetric(matrix: &Csr, name: &str) -> Result<()> {
    let difference = matrix.combine(1.0, &matrix.transpose(), -1.0)?;
    let largest = matrix.values().iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    for row in 0..matrix.rows() {
        let (columns, values) = difference.row(row);
        if let Some(at) = values.iter().position(|value| value.abs() > ASYMMETRY * largest) {
            return Err(Error::input(format!(
                "{name} is not symmetric: entries ({row}, {column}) and ({column}, {row}) differ by {difference:e}; pass (A + A^T) / 2",
                column = columns[at],
                difference = values[at]
            )));
        }
    }
    Ok(())
}

/// The rows and columns of a matrix that are kept, ascending numbers.
fn restricted(matrix: &Csr, kept: &[usize]) -> Csr {
    if kept.len() == matrix.rows() {
        return matrix.clone();
    }
    let mut number = vec![u32::MAX; matrix.columns()];
    for (new, &old) in kept.iter().enumerate() {
        number[old] = new as u32;
    }
    let (mut starts, mut indices, mut values) = (vec![0], Vec::new(), Vec::new());
    for &old in kept {
        let (columns, numbers) = matrix.row(old);
        for (&column, &value) in columns.iter().zip(numbers).filter(|&(&column, _)| number[column as usize] != u32::MAX) {
            indices.push(number[column as usize]);
            values.push(value);
        }
        starts.push(indices.len());
    }
    Csr::trusted(kept.len(), kept.len(), starts, indices, values)
}

fn without_massless(matrix: &Csr, mass: &[f64], kept: &[usize], k: usize, options: &EigenOptions, control: &Control) -> Result<Eigenpairs> {
    let n = matrix.rows();
    if let Some(row) = (0..n).find(|&row| mass[row] == 0.0 && matrix.row(row).1.iter().any(|&value| value != 0.0)) {
        return Err(Error::numerical(format!(
            "unknown {row} has no mass but is coupled to others: the pencil has an infinite eigenvalue; repair the faces around it"
        )));
    }
    let smaller = restricted(matrix, kept);
    let rows = |numbers: &[f64], width: usize| -> Vec<f64> {
        kept.iter().flat_map(|&old| numbers[old * width..][..width].iter().copied()).collect()
    };
    let (coordinates, start) = (options.coordinates.map(|(c, d)| (rows(c, d), d)), options.start.map(|(s, w)| (rows(s, w), w)));
    let smaller_options = EigenOptions {
        shift: options.shift,
        coordinates: coordinates.as_ref().map(|(c, d)| (c.as_slice(), *d)),
        start: start.as_ref().map(|(s, w)| (s.as_slice(), *w)),
    };
    let found = eigenpairs(&smaller, Mass::Diagonal(&rows(mass, 1)), k, &smaller_options, control)?;
    let mut vectors = vec![0.0; n * k];
    for (new, &old) in kept.iter().enumerate() {
        vectors[old * k..][..k].copy_from_slice(&found.vectors[new * k..][..k]);
    }
    Ok(Eigenpairs { vectors, ..found })
}

struct Pencil<'a> {
    matrix: &'a Csr,
    mass: Mass<'a>,
    n: usize,
}

impl Pencil<'_> {
    fn mass_times(&self, block: &[f64], width: usize) -> Result<Vec<f64>> {
        match self.mass {
            Mass::Matrix(matrix) => matrix.multiply_block(block, width),
            Mass::Diagonal(diagonal) => {
                let mut out = block.to_vec();
                out.par_chunks_mut(ROWS * width).zip(diagonal.par_chunks(ROWS)).for_each(|(out, diagonal)| {
                    for (row, &entry) in out.chunks_exact_mut(width).zip(diagonal) {
                        row.iter_mut().for_each(|number| *number *= entry);
                    }
                });
                Ok(out)
            }
        }
    }

    /// A row of A X by differences along the edges: in a Laplacian the large entries of small triangles would drown those of
    /// smooth functions. A row sum within its rounding of 0 is taken as 0.
    fn image(&self, row: usize, block: &[f64], out: &mut [f64]) {
        let width = out.len();
        let (columns, values) = self.matrix.row(row);
        let (sum, size) = values.iter().fold((0.0, 0.0), |(sum, size): (f64, f64), value| (sum + value, size + value.abs()));
        let sum = if sum.abs() > f64::EPSILON * values.len() as f64 * size { sum } else { 0.0 };
        let own = &block[row * width..][..width];
        out.iter_mut().zip(own).for_each(|(out, own)| *out = sum * own);
        for (&column, &value) in columns.iter().zip(values) {
            let other = &block[column as usize * width..][..width];
            out.iter_mut().zip(own.iter().zip(other)).for_each(|(out, (own, other))| *out += value * (other - own));
        }
    }

    /// A row of M X.
    fn mass_image(&self, row: usize, block: &[f64], out: &mut [f64]) {
        let width = out.len();
        match self.mass {
            Mass::Diagonal(diagonal) => out.iter_mut().zip(&block[row * width..]).for_each(|(out, own)| *out = diagonal[row] * own),
            Mass::Matrix(matrix) => {
                out.fill(0.0);
                let (columns, values) = matrix.row(row);
                for (&column, &value) in columns.iter().zip(values) {
                    out.iter_mut().zip(&block[column as usize * width..]).for_each(|(out, other)| *out += value * other);
                }
            }
        }
    }

    /// Adds up over the rows what `add` makes of row, its A X and its M X, in `count` sums a column; rows in fixed groups.
    fn sums(&self, block: &[f64], width: usize, count: usize, add: impl Fn(usize, &[f64], &[f64], &mut [f64]) + Sync) -> Vec<f64> {
        let parts: Vec<Vec<f64>> = (0..self.n.div_ceil(ROWS))
            .into_par_iter()
            .map(|chunk| {
                let (mut image, mut weighted, mut sums) = (vec![0.0; width], vec![0.0; width], vec![0.0; width * count]);
                for row in chunk * ROWS..((chunk + 1) * ROWS).min(self.n) {
                    self.image(row, block, &mut image);
                    self.mass_image(row, block, &mut weighted);
                    add(row, &image, &weighted, &mut sums);
                }
                sums
            })
            .collect();
        let mut total = vec![0.0; width * count];
        parts.iter().for_each(|part| total.iter_mut().zip(part).for_each(|(total, part)| *total += part));
        total
    }

    fn mass_diagonal(&self) -> Vec<f64> {
        match self.mass {
            Mass::Diagonal(diagonal) => diagonal.to_vec(),
            Mass::Matrix(matrix) => matrix.diagonal(),
        }
    }

    /// A - σ M.
    fn shifted(&self, shift: f64) -> Result<Csr> {
        match self.mass {
            Mass::Diagonal(diagonal) => self.matrix.combine(1.0, &Csr::from_diagonal(diagonal), -shift),
            Mass::Matrix(matrix) => self.matrix.combine(1.0, matrix, -shift),
        }
    }

    fn nearest(&self, k: usize, options: &EigenOptions, control: &Control) -> Result<Eigenpairs> {
        let quotients: Vec<f64> =
            self.matrix.diagonal().iter().zip(self.mass_diagonal()).map(|(a, m)| a / m).filter(|q| q.is_finite() && *q > 0.0).collect();
        let largest = quotients.iter().copied().fold(0.0, f64::max);
        // The harmonic mean counts every part of the shape by its area.
        let inverses: f64 = quotients.iter().map(|q| largest / q).sum();
        let scale = if largest > 0.0 { largest * quotients.len() as f64 / inverses } else { 0.0 };
        let above = |share: f64, found: &Eigenpairs, shift: f64| {
            let size = found.values.iter().fold(shift.abs(), |size, value| size.max(value.abs()));
            found.residuals.iter().position(|&rest| rest > share * size)
        };
        let failed =
            |found: &Eigenpairs, shift: f64| above(ACCEPTED, found, shift).filter(|&pair| found.residuals[pair] > TOLERANCE * largest);
        let refused = |found: &Eigenpairs, shift: f64, pair: usize| {
            Err(Error::NotConverged(format!(
                "eigenpair {pair} = {:.6e} has a residual of {:.1e}: the entries of the matrices differ too much in size; give shift= near \
                 the wanted values (now {shift:.1e}), or use an intrinsic Delaunay Laplacian",
                found.values[pair], found.residuals[pair]
            )))
        };
        // With most of the spectrum wanted the basis would be the whole space.
        if self.n <= DENSE || 2 * k > self.n || (3 * k + 4 * BLOCK > self.n && self.n <= 8 * DENSE) {
            let found = self.dense(k, options.shift, control)?.checked(self)?;
            return match failed(&found, scale) {
                Some(pair) => refused(&found, 0.0, pair),
                None => Ok(found),
            };
        }
        // By Weyl's law λ_k is about k / n of the scale. Where that is far from the wanted values, they tell a better shift.
        let share = 0.02 * (k + 1) as f64 / (self.n + 1) as f64;
        let mut shift = options.shift.unwrap_or(if scale > 0.0 { -share * scale } else { -1.0 });
        let mut iterations = 0;
        loop {
            let factor = self.factor(shift, options, control)?;
            let mut found = self.lanczos(k, shift, &factor, options, control)?;
            found.iterations += iterations;
            iterations = found.iterations;
            let mut checked = found.checked(self)?;
            if above(POLISHED, &checked, shift).is_some() {
                checked = self.polished(checked, shift, &factor, control)?;
            }
            let top = checked.values.iter().fold(0.0, |top: f64, value| top.max(value.abs()));
            if options.shift.is_none() && shift.abs() > FAR * top && top > ROUNDING * scale {
                shift = -0.1 * top;
                continue;
            }
            return match failed(&checked, shift) {
                Some(pair) => refused(&checked, shift, pair),
                None => Ok(checked),
            };
        }
    }

    /// The factor of A - σ M: Cholesky's below the spectrum, one with pivots inside it, where the caller asks for that.
    fn factor(&self, shift: f64, options: &EigenOptions, control: &Control) -> Result<Factor> {
        let shifted = self.shifted(shift)?;
        match Cholesky::new(&shifted, options.coordinates, control) {
            Ok(factor) => Ok(Factor::Definite(factor)),
            Err(Error::Numerical(_)) if options.shift.is_some() => {
                Ok(Factor::Indefinite(Box::new(Indefinite::new(shifted, options.coordinates, control)?)))
            }
            Err(Error::Numerical(reason)) => Err(Error::numerical(format!(
                "the pencil has eigenvalues below {shift:.3e}: {reason}; give shift= near the wanted ones, below or among them"
            ))),
            Err(error) => Err(error),
        }
    }

    /// One step of subspace iteration with a Rayleigh-Ritz projection: it damps what is left of the upper end of the spectrum.
    fn polished(&self, found: Eigenpairs, shift: f64, factor: &Factor, control: &Control) -> Result<Eigenpairs> {
        let k = found.values.len();
        let right = self.mass_times(&found.vectors, k)?;
        let mut next = vec![0.0; right.len()];
        factor.solve_block_into(&right, k, &mut next, &mut Scratch::default())?;
        control.check()?;
        let (mass, projected) = (
            gram(&next, &self.mass_times(&next, k)?, k, control)?,
            gram(&next, &self.shifted(shift)?.multiply_block(&next, k)?, k, control)?,
        );
        let scale: Vec<f64> = (0..k).map(|i| 1.0 / mass[(i, i)].sqrt()).collect();
        let unit = |matrix: &Mat<f64>| Mat::from_fn(k, k, |i, j| 0.5 * (matrix[(i, j)] + matrix[(j, i)]) * scale[i] * scale[j]);
        let (sizes, turn) = dense_eigen(unit(&mass).as_ref(), control)?;
        if sizes[0] <= 0.0 {
            return Ok(found);
        }
        let white = Mat::from_fn(k, k, |i, j| scale[i] * turn[(i, j)] / sizes[j].sqrt());
        let projected = Mat::from_fn(k, k, |i, j| 0.5 * (projected[(i, j)] + projected[(j, i)]));
        let (_, vectors) = dense_eigen((white.transpose() * &projected * &white).as_ref(), control)?;
        let vectors = transform(&next, k, (&white * &vectors).as_ref(), control)?;
        let better = Eigenpairs { vectors, ..found.clone() }.checked(self)?;
        let worst = |pairs: &Eigenpairs| pairs.residuals.iter().fold(0.0, |worst: f64, &rest| worst.max(rest));
        Ok(if worst(&better) < worst(&found) { better } else { found })
    }

    /// Densely, each connected part by itself.
    fn dense(&self, k: usize, shift: Option<f64>, control: &Control) -> Result<Eigenpairs> {
        let parts = self.parts();
        let mut found = Vec::with_capacity(parts.len());
        let mut done = 0.0;
        let whole: f64 = parts.iter().map(|part| (part.len() as f64).powi(3)).sum();
        for part in &parts {
            let matrix = restricted(self.matrix, part);
            let mass = match self.mass {
                Mass::Diagonal(diagonal) => Err(part.iter().map(|&row| diagonal[row]).collect()),
                Mass::Matrix(matrix) => Ok(restricted(matrix, part)),
            };
            found.push(if part.len() <= DENSE {
                dense_pencil(&matrix, mass)?
            } else {
                apart(control, move || dense_pencil(&matrix, mass))?
            });
            done += (part.len() as f64).powi(3) / whole;
            control.report(done.min(0.99))?;
        }
        let mut chosen: Vec<(f64, usize, usize)> = found
            .iter()
            .enumerate()
            .flat_map(|(part, (values, _))| values.iter().enumerate().map(move |(j, &value)| (value, part, j)))
            .collect();
        let rank = |value: f64| shift.map_or(value, |shift| (value - shift).abs());
        chosen.sort_by(|a, b| rank(a.0).total_cmp(&rank(b.0)));
        chosen.truncate(k);
        let mut vectors = vec![0.0; self.n * k];
        for (column, &(_, part, j)) in chosen.iter().enumerate() {
            for (i, &row) in parts[part].iter().enumerate() {
                vectors[row * k + column] = found[part].1[(i, j)];
            }
        }
        Ok(Eigenpairs { values: chosen.iter().map(|chosen| chosen.0).collect(), vectors, residuals: Vec::new(), iterations: 0 })
    }

    /// The unknowns that entries of the matrices connect, part after part, each ascending.
    fn parts(&self) -> Vec<Vec<usize>> {
        let mut parts = Vec::new();
        let mut seen = vec![false; self.n];
        for first in 0..self.n {
            if std::mem::replace(&mut seen[first], true) {
                continue;
            }
            let mut part = vec![first];
            let mut next = 0;
            while next < part.len() {
                let row = part[next];
                next += 1;
                let others = match self.mass {
                    Mass::Matrix(matrix) => matrix.row(row).0,
                    Mass::Diagonal(_) => &[],
                };
                for &column in self.matrix.row(row).0.iter().chain(others) {
                    if !std::mem::replace(&mut seen[column as usize], true) {
                        part.push(column as usize);
                    }
                }
            }
            part.sort_unstable();
            parts.push(part);
        }
        parts
    }
}

enum Factor {
    Definite(Cholesky),
    Indefinite(Box<Indefinite>),
}

impl Factor {
    fn solve_block_into(&self, b: &[f64], width: usize, out: &mut [f64], scratch: &mut Scratch) -> Result<()> {
        match self {
            Factor::Definite(factor) => factor.solve_block_into(b, width, out, scratch),
            Factor::Indefinite(factor) => factor.solve_block_into(b, width, out),
        }
    }
}

impl Eigenpairs {
    /// Sorted, with fixed signs, Rayleigh quotients as values, and the residuals. No second block of vectors is held.
    fn checked(mut self, pencil: &Pencil) -> Result<Self> {
        let k = self.values.len();
        let diagonal = pencil.mass_diagonal();
        let quotients = pencil.sums(&self.vectors, k, 2, |row, image, weighted, sums| {
            let own = &self.vectors[row * k..][..k];
            for (j, sums) in sums.chunks_exact_mut(2).enumerate() {
                sums[0] += own[j] * weighted[j];
                sums[1] += own[j] * image[j];
            }
        });
        let values: Vec<f64> = quotients.chunks_exact(2).map(|sums| sums[1] / sums[0]).collect();
        let rests = pencil.sums(&self.vectors, k, 1, |row, image, weighted, sums| {
            for (j, sum) in sums.iter_mut().enumerate() {
                *sum += (image[j] - values[j] * weighted[j]).powi(2) / diagonal[row];
            }
        });
        let mut largest = vec![0.0f64; k];
        for row in self.vectors.chunks_exact(k) {
            for (largest, &x) in largest.iter_mut().zip(row) {
                if x.abs() > largest.abs() * (1.0 + 1e-9) {
                    *largest = x;
                }
            }
        }
        let columns: Vec<(f64, f64, f64)> = (0..k)
            .map(|j| {
                let norm = quotients[2 * j];
                (values[j], (rests[j] / norm).sqrt(), largest[j].signum() / norm.sqrt())
            })
            .collect();
        if let Some(j) = columns.iter().position(|&(value, rest, scale)| !(value.is_finite() && rest.is_finite() && scale.is_finite())) {
            return Err(Error::numerical(format!("eigenpair {j} overflowed; rescale the shape, or use an intrinsic Delaunay Laplacian")));
        }
        let mut order: Vec<usize> = (0..k).collect();
        order.sort_by(|&a, &b| columns[a].0.total_cmp(&columns[b].0));
        self.values = order.iter().map(|&j| columns[j].0).collect();
        self.residuals = order.iter().map(|&j| columns[j].1).collect();
        self.vectors.par_chunks_mut(ROWS * k).for_each(|rows| {
            let mut old = vec![0.0; k];
            for row in rows.chunks_exact_mut(k) {
                old.copy_from_slice(row);
                row.iter_mut().zip(&order).for_each(|(number, &j)| *number = old[j] * columns[j].2);
            }
        });
        Ok(self)
    }
}
