//! The eigenpairs of `A x = λ M x` nearest to a shift: block shift-invert Lanczos with thick restart, dense for small matrices.
//!
//! The operator `(A - σ M)^-1 M` is self-adjoint in the inner product of M; its eigenvalues θ = 1 / (λ - σ) of largest size
//! belong to the λ nearest to σ. A block of random vectors finds as many copies of a multiple eigenvalue as it is
//! wide; where a cluster is at least that large, the search goes on from a fresh random block until nothing new appears.
//! The basis is kept orthonormal by two passes of Gram-Schmidt (Grimes, Lewis, Simon 1994; Wu, Simon 2000).

use super::indefinite::Indefinite;
use super::{Cholesky, Scratch};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::{Csr, first_not_finite};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par, Side};
use rayon::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

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

const BLOCK: usize = 8;
const ROWS: usize = 1024; // rows of one parallel task in the dense products; fixed, so that sums are grouped alike
const DENSE: usize = 256; // matrices up to this size are solved densely
const TOLERANCE: f64 = 1e-11; // of a Ritz pair, relative to its θ
const MAX_BLOCKS: usize = 1000;
const ROOMY: usize = 256; // columns that a basis has to spare at most where it is small
const SMALL: usize = 1 << 23; // numbers of such a basis
const GLANCE: Duration = Duration::from_millis(20); // between looks whether dense work is still wanted
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
        return Err(Error::input(format!("{k} eigenpairs were asked for, the shape has {n} vertices with mass; ask for at most {n}")));
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
                "{name} is not symmetric: entries ({row}, {column}) and ({column}, {row}) differ by {difference:e}; pass (A + A.T) / 2",
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

/// A fixed sequence of numbers in [-1, 1): the start must be the same in every run (splitmix64, Steele et al. 2014).
struct Sequence(u64);

impl Sequence {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn block(&mut self, n: usize, width: usize) -> Vec<f64> {
        (0..n * width).map(|_| self.next()).collect()
    }
}

struct Pencil<'a> {
    matrix: &'a Csr,
    mass: Mass<'a>,
    n: usize,
}

/// Columns of length n kept side by side, row after row, with room for more.
struct Basis {
    numbers: Vec<f64>,
    room: usize,
    width: usize,
}

impl Basis {
    fn new(n: usize, room: usize) -> Result<Self> {
        let mut numbers: Vec<f64> = Vec::new();
        let size = n.saturating_mul(room);
        numbers
            .try_reserve_exact(size)
            .map_err(|_| Error::numerical(format!("a basis of {size} numbers does not fit into memory; ask for fewer eigenpairs")))?;
        numbers.resize(size, 0.0);
        Ok(Basis { numbers, room, width: 0 })
    }

    fn push(&mut self, block: &[f64], width: usize) {
        let (room, at) = (self.room, self.width);
        self.numbers.par_chunks_mut(ROWS * room).zip(block.par_chunks(ROWS * width)).for_each(|(rows, block)| {
            for (row, source) in rows.chunks_exact_mut(room).zip(block.chunks_exact(width)) {
                row[at..at + width].copy_from_slice(source);
            }
        });
        self.width += width;
    }

    /// V^T W for the columns of V from `first` on.
    fn inner(&self, first: usize, block: &[f64], width: usize, control: &Control) -> Result<Mat<f64>> {
        let parts: Vec<Mat<f64>> = self
            .numbers
            .par_chunks(ROWS * self.room)
            .zip(block.par_chunks(ROWS * width))
            .map(|(rows, block)| {
                control.check()?;
                let count = block.len() / width;
                let left = MatRef::from_row_major_slice_with_stride(rows, count, self.width, self.room).subcols(first, self.width - first);
                let right = MatRef::from_row_major_slice(block, count, width);
                let mut part = Mat::zeros(self.width - first, width);
                matmul(part.as_mut(), Accum::Replace, left.transpose(), right, 1.0, Par::Seq);
                Ok(part)
            })
            .collect::<Result<_>>()?;
        Ok(parts.into_iter().fold(Mat::zeros(self.width - first, width), |sum, part| sum + part))
    }

    /// W - V C for the columns of V from `first` on, in place.
    fn subtract(&self, first: usize, block: &mut [f64], width: usize, coefficients: &Mat<f64>, control: &Control) -> Result<()> {
        block.par_chunks_mut(ROWS * width).zip(self.numbers.par_chunks(ROWS * self.room)).try_for_each(|(block, rows)| {
            control.check()?;
            let count = block.len() / width;
            let left = MatRef::from_row_major_slice_with_stride(rows, count, self.width, self.room).subcols(first, self.width - first);
            let target = MatMut::from_row_major_slice_mut(block, count, width);
            matmul(target, Accum::Add, left, coefficients.as_ref(), -1.0, Par::Seq);
            Ok(())
        })
    }

    /// V S in place of V.
    fn rotate(&mut self, coefficients: MatRef<f64>, control: &Control) -> Result<()> {
        let (room, width, columns) = (self.room, self.width, coefficients.ncols());
        self.numbers.par_chunks_mut(ROWS * room).try_for_each(|rows| {
            control.check()?;
            let count = rows.len() / room;
            let mut turned = Mat::zeros(count, columns);
            let left = MatRef::from_row_major_slice_with_stride(rows, count, width, room);
            matmul(turned.as_mut(), Accum::Replace, left, coefficients, 1.0, Par::Seq);
            for (i, row) in rows.chunks_exact_mut(room).enumerate() {
                (0..columns).for_each(|j| row[j] = turned[(i, j)]);
            }
            Ok(())
        })?;
        self.width = columns;
        Ok(())
    }

    /// The columns alone, row after row.
    fn into_block(self) -> Vec<f64> {
        let (mut numbers, room, width) = (self.numbers, self.room, self.width);
        let n = numbers.len() / room;
        for row in 1..n {
            numbers.copy_within(row * room..row * room + width, row * width);
        }
        numbers.truncate(n * width);
        numbers.shrink_to_fit();
        numbers
    }
}

/// W C for a block W, row after row.
fn transform(block: &[f64], width: usize, coefficients: MatRef<f64>, control: &Control) -> Result<Vec<f64>> {
    let (n, out_width) = (block.len() / width, coefficients.ncols());
    let mut out = vec![0.0; n * out_width];
    out.par_chunks_mut(ROWS * out_width).zip(block.par_chunks(ROWS * width)).try_for_each(|(out, block)| {
        control.check()?;
        let count = block.len() / width;
        let source = MatRef::from_row_major_slice(block, count, width);
        matmul(MatMut::from_row_major_slice_mut(out, count, out_width), Accum::Replace, source, coefficients, 1.0, Par::Seq);
        Ok(())
    })?;
    Ok(out)
}

/// X^T Y for two blocks of one width.
fn gram(x: &[f64], y: &[f64], width: usize, control: &Control) -> Result<Mat<f64>> {
    let parts: Vec<Mat<f64>> = x
        .par_chunks(ROWS * width)
        .zip(y.par_chunks(ROWS * width))
        .map(|(x, y)| {
            control.check()?;
            let count = x.len() / width;
            let (x, y) = (MatRef::from_row_major_slice(x, count, width), MatRef::from_row_major_slice(y, count, width));
            let mut part = Mat::zeros(width, width);
            matmul(part.as_mut(), Accum::Replace, x.transpose(), y, 1.0, Par::Seq);
            Ok(part)
        })
        .collect::<Result<_>>()?;
    Ok(parts.into_iter().fold(Mat::zeros(width, width), |sum, part| sum + part))
}

/// What `work` makes, on a thread of its own that nobody waits for any longer once the caller wants to stop: the dense factorizations
/// cannot be asked to end.
fn apart<T: Send + 'static>(control: &Control, work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    let (send, receive) = channel();
    std::thread::Builder::new()
        .name("beltrami-dense".into())
        .stack_size(16 << 20)
        .spawn(move || {
            let _ = send.send(catch_unwind(AssertUnwindSafe(work)));
        })
        .map_err(|error| Error::numerical(format!("a thread for a dense eigenproblem cannot be started: {error}")))?;
    loop {
        match receive.recv_timeout(GLANCE) {
            Ok(Ok(answer)) => return answer,
            Ok(Err(panic)) => resume_unwind(panic),
            Err(RecvTimeoutError::Timeout) => control.check()?,
            Err(RecvTimeoutError::Disconnected) => return Err(Error::numerical("a dense eigenproblem ended without an answer")),
        }
    }
}

/// [`symmetric_eigen`], given up when the caller wants to stop.
fn dense_eigen(matrix: MatRef<f64>, control: &Control) -> Result<(Vec<f64>, Mat<f64>)> {
    if matrix.nrows() <= DENSE {
        return symmetric_eigen(matrix);
    }
    let matrix = matrix.to_owned();
    apart(control, move || symmetric_eigen(matrix.as_ref()))
}

/// Eigenvalues (ascending) and vectors of a symmetric matrix.
fn symmetric_eigen(matrix: MatRef<f64>) -> Result<(Vec<f64>, Mat<f64>)> {
    let broken = || {
        Error::numerical(
            "a projected eigenproblem could not be solved: the matrices are too badly scaled; use laplacian=\"intrinsic_delaunay\"",
        )
    };
    let n = matrix.nrows();
    if (0..n).any(|j| (0..n).any(|i| !matrix[(i, j)].is_finite())) {
        return Err(broken());
    }
    // faer's divide and conquer has absolute thresholds: bring the entries near 1, by a power of two, so exactly.
    let largest = (0..n).flat_map(|j| (0..n).map(move |i| matrix[(i, j)].abs())).fold(0.0, f64::max);
    let scale = if largest > 0.0 { largest.log2().floor().clamp(-1000.0, 1000.0).exp2() } else { 1.0 };
    let near_one = Mat::from_fn(n, n, |i, j| matrix[(i, j)] / scale);
    let found = near_one.self_adjoint_eigen(Side::Lower).map_err(|_| broken())?;
    let values: Vec<f64> = (0..n).map(|i| scale * found.S()[i]).collect();
    if values.iter().any(|value| !value.is_finite()) {
        return Err(broken());
    }
    Ok((values, found.U().to_owned()))
}

/// All eigenvalues and vectors of a pencil, the mass a matrix or a diagonal.
fn dense_pencil(matrix: &Csr, mass: std::result::Result<Csr, Vec<f64>>) -> Result<(Vec<f64>, Mat<f64>)> {
    let n = matrix.rows();
    let full = |matrix: &Csr| {
        let mut dense = Mat::<f64>::zeros(n, n);
        for row in 0..n {
            let (columns, values) = matrix.row(row);
            for (&column, &value) in columns.iter().zip(values) {
                dense[(row, column as usize)] = value;
            }
        }
        dense
    };
    let mut a = full(matrix);
    // Reduce to a standard problem: C^-1 A C^-T with M = C C^T.
    match mass {
        Err(diagonal) => {
            let scale: Vec<f64> = diagonal.iter().map(|m| 1.0 / m.sqrt()).collect();
            for j in 0..n {
                for i in 0..n {
                    a[(i, j)] *= scale[i] * scale[j];
                }
            }
            let (values, mut vectors) = symmetric_eigen(a.as_ref())?;
            for j in 0..n {
                for i in 0..n {
                    vectors[(i, j)] *= scale[i];
                }
            }
            Ok((values, vectors))
        }
        Ok(mass) => {
            let lower =
                full(&mass).llt(Side::Lower).map_err(|_| Error::numerical("the mass matrix is not positive definite"))?.L().to_owned();
            let mut back = Mat::<f64>::identity(n, n);
            faer::linalg::triangular_solve::solve_lower_triangular_in_place(lower.as_ref(), back.as_mut(), Par::Seq);
            let (values, vectors) = symmetric_eigen((&back * &a * back.transpose()).as_ref())?;
            Ok((values, back.transpose() * &vectors))
        }
    }
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
                 the wanted values (now {shift:.1e}), or use laplacian=\"intrinsic_delaunay\"",
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

    fn lanczos(&self, k: usize, shift: f64, factor: &Factor, options: &EigenOptions, control: &Control) -> Result<Eigenpairs> {
        let n = self.n;
        let given = options.start.map_or(0, |(_, width)| width.min(k + BLOCK));
        let start_width = (given + BLOCK).min(n);
        // More room means fewer solves; where the basis stays small beside everything else it has as much as pays.
        let spare = (k + k / 4).min(ROOMY).min((SMALL / n).saturating_sub(k)).max(k / 2).max(5 * BLOCK);
        let room = (k + spare + 2 * start_width).min(n);
        let mut search = Search {
            pencil: self,
            factor,
            control,
            basis: Basis::new(n, room)?,
            projected: Mat::zeros(room, room),
            sequence: Sequence(0),
            block: Vec::new(),
            mass_block: Vec::new(),
            scratch: Scratch::default(),
            coupling: Mat::zeros(0, 0),
        };
        let mut start = search.sequence.block(n, start_width);
        if let Some((numbers, width)) = options.start {
            let largest: Vec<f64> =
                (0..given).map(|j| numbers.chunks_exact(width).fold(0.0, |largest: f64, row| largest.max(row[j].abs()))).collect();
            for (row, source) in start.chunks_exact_mut(start_width).zip(numbers.chunks_exact(width)) {
                for j in (0..given).filter(|&j| largest[j] > 0.0) {
                    row[j] = source[j] / largest[j];
                }
            }
        }
        search.fresh_block(start, start_width)?;
        let mut known: Option<Vec<f64>> = None; // the values before the last search for missing copies
        let most = MAX_BLOCKS.max(4 * room / BLOCK);
        for blocks in 1..=most {
            control.check()?;
            search.expand()?;
            let full = search.basis.width == n && search.block.is_empty();
            let crowded = search.basis.width + search.width() > room;
            // While it looks for missing copies a fresh block gets all the room: they must have the time to appear.
            let due = full || crowded || (known.is_none() && search.basis.width >= k + k / 2 + BLOCK && blocks % 3 == 0);
            if !due {
                control.report((search.basis.width as f64 / room as f64).min(0.99))?;
                continue;
            }
            let (theta, vectors, errors) = search.ritz()?;
            let enough = theta.len() >= k && (0..k).all(|i| errors[i] <= TOLERANCE * theta[i].abs());
            if full || enough {
                let values: Vec<f64> = theta[..k].to_vec();
                let last_search_found_nothing =
                    known.as_ref().is_some_and(|known| known.iter().zip(&values).all(|(a, b)| (a - b).abs() <= 1e-9 * a.abs()));
                if full || last_search_found_nothing || !has_large_cluster(&values) {
                    search.basis.rotate(vectors.as_ref().subcols(0, k), control)?;
                    return Ok(Eigenpairs {
                        values: values.iter().map(|theta| shift + 1.0 / theta).collect(),
                        vectors: search.basis.into_block(),
                        residuals: Vec::new(),
                        iterations: blocks,
                    });
                }
                known = Some(values);
                search.restart(k, &theta, &vectors, true)?;
            } else if crowded {
                search.restart(k + (room - k) / 3, &theta, &vectors, false)?;
            }
        }
        Err(Error::NotConverged(format!(
            "{k} eigenpairs of {n} unknowns did not converge in {most} blocks of solves (shift = {shift:.1e}); the shape may have slivers: use laplacian=\"intrinsic_delaunay\", or ask for fewer"
        )))
    }
}

/// Whether so many of the values are equal that copies beyond the width of a block may be missing.
fn has_large_cluster(theta: &[f64]) -> bool {
    let mut theta = theta.to_vec();
    theta.sort_unstable_by(f64::total_cmp);
    theta.windows(BLOCK).any(|window| window[BLOCK - 1] - window[0] <= 1e-6 * window[0].abs())
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

/// The state of one block Lanczos run: `Op V = V H + Q (coupling) E^T`, V orthonormal, Q the block to come.
struct Search<'a> {
    pencil: &'a Pencil<'a>,
    factor: &'a Factor,
    control: &'a Control,
    basis: Basis,
    projected: Mat<f64>,
    sequence: Sequence,
    block: Vec<f64>,
    mass_block: Vec<f64>,
    scratch: Scratch,
    coupling: Mat<f64>, // of the block to come with the last columns of the basis
}

impl Search<'_> {
    fn width(&self) -> usize {
        self.block.len() / self.pencil.n
    }

    /// Takes the block into the basis, applies the operator to it and makes the next block.
    fn expand(&mut self) -> Result<()> {
        let (first, width) = (self.basis.width, self.width());
        // The operator couples a block with itself and with the one before alone, after a restart with all that was kept.
        let near = if self.coupling.ncols() == 0 { 0 } else { first - self.coupling.ncols() };
        self.basis.push(&self.block, width);
        let mut next = vec![0.0; self.mass_block.len()];
        self.factor.solve_block_into(&self.mass_block, width, &mut next, &mut self.scratch)?;
        self.control.check()?;
        if first_not_finite(&next).is_some() {
            return Err(Error::numerical(
                "a solve of the eigenproblem overflowed; rescale the shape, or use laplacian=\"intrinsic_delaunay\"",
            ));
        }
        let coefficients = self.orthogonalize(near, &mut next, width)?;
        for j in 0..width {
            for i in near..self.basis.width {
                self.projected[(i, first + j)] = coefficients[(i - near, j)];
                self.projected[(first + j, i)] = coefficients[(i - near, j)];
            }
        }
        for i in 0..width {
            for j in 0..i {
                let mean = 0.5 * (coefficients[(first - near + i, j)] + coefficients[(first - near + j, i)]);
                self.projected[(first + i, first + j)] = mean;
                self.projected[(first + j, first + i)] = mean;
            }
        }
        let room = (self.pencil.n - self.basis.width).min(width);
        self.normalize(next, width, room)
    }

    /// W - V (V^T M W) for the columns of V from `first` on, in place; the coefficients.
    fn orthogonalize(&self, first: usize, block: &mut [f64], width: usize) -> Result<Mat<f64>> {
        if self.basis.width == 0 {
            return Ok(Mat::zeros(0, width));
        }
        let coefficients = self.basis.inner(first, &self.pencil.mass_times(block, width)?, width, self.control)?;
        self.basis.subtract(first, block, width, &coefficients, self.control)?;
        Ok(coefficients)
    }

    /// Makes the block orthonormal, W = Q R: Q becomes the next block (at most `room` columns), R the coupling. Directions
    /// that vanish are left out; when none is left a fresh random block takes over.
    fn normalize(&mut self, block: Vec<f64>, width: usize, room: usize) -> Result<()> {
        let (q, r) = self.orthonormal(block, width, 1e-13)?;
        let got = q.len() / self.pencil.n;
        if got == 0 && room > 0 {
            let fresh = self.sequence.block(self.pencil.n, room);
            return self.fresh_block(fresh, room);
        }
        let kept = got.min(room);
        self.mass_block = Vec::new();
        self.block = if kept == 0 {
            Vec::new()
        } else if kept == got {
            q
        } else {
            transform(&q, got, Mat::<f64>::identity(got, got).as_ref().subcols(0, kept), self.control)?
        };
        if kept > 0 {
            self.mass_block = self.pencil.mass_times(&self.block, kept)?;
        }
        self.coupling = r.as_ref().subrows(0, kept).to_owned();
        Ok(())
    }

    /// A block that is not coupled to the basis.
    fn fresh_block(&mut self, mut block: Vec<f64>, width: usize) -> Result<()> {
        self.orthogonalize(0, &mut block, width)?;
        let (q, _) = self.orthonormal(block, width, 1e-10)?;
        self.block = q;
        let kept = self.width();
        if kept == 0 {
            return Err(Error::numerical("no start vector is independent of the others; leave start= out"));
        }
        self.mass_block = self.pencil.mass_times(&self.block, kept)?;
        self.coupling = Mat::zeros(kept, 0);
        Ok(())
    }

    /// W = Q R with Q^T M Q = I and Q orthogonal to the basis, by the eigenvectors of the Gram matrix (Stathopoulos & Wu
    /// 2002), repeated until orthonormal; R has one row a column of Q.
    fn orthonormal(&self, mut block: Vec<f64>, width: usize, drop: f64) -> Result<(Vec<f64>, Mat<f64>)> {
        let n = self.pencil.n;
        let mut r = Mat::<f64>::identity(width, width);
        let mut columns = width;
        for pass in 0..4 {
            if columns == 0 {
                break;
            }
            // what rounding has left of the whole basis, once the block is of unit size; later passes only polish within the block
            if pass == 1 {
                self.orthogonalize(0, &mut block, columns)?;
            }
            let inner = gram(&block, &self.pencil.mass_times(&block, columns)?, columns, self.control)?;
            let scale: Vec<f64> = (0..columns).map(|i| inner[(i, i)].max(0.0).sqrt()).collect();
            let largest = scale.iter().fold(0.0, |a: f64, &b| a.max(b));
            if largest == 0.0 {
                return Ok((Vec::new(), Mat::zeros(0, width)));
            }
            let unit = |i: usize| if scale[i] > 0.0 { 1.0 / scale[i] } else { 0.0 };
            let mut normed = Mat::zeros(columns, columns);
            for j in 0..columns {
                for i in 0..columns {
                    normed[(i, j)] = 0.5 * (inner[(i, j)] + inner[(j, i)]) * unit(i) * unit(j);
                }
            }
            let off = (0..columns)
                .flat_map(|j| (0..columns).map(move |i| (i, j)))
                .map(|(i, j)| (inner[(i, j)] - f64::from(u8::from(i == j))).abs())
                .fold(0.0, f64::max);
            if pass > 0 && off < 1e-14 * columns as f64 {
                break;
            }
            let (values, vectors) = dense_eigen(normed.as_ref(), self.control)?;
            // In the first pass a direction of no weight is noise; later ones only polish.
            let floor = if pass == 0 { drop * drop } else { 0.0 };
            let kept: Vec<usize> = (0..columns).filter(|&i| values[i] > floor * columns as f64 && values[i] > 0.0).collect();
            let mut forward = Mat::zeros(columns, kept.len());
            let mut backward = Mat::zeros(kept.len(), columns);
            for (new, &old) in kept.iter().enumerate() {
                let root = values[old].sqrt();
                for i in 0..columns {
                    forward[(i, new)] = unit(i) * vectors[(i, old)] / root;
                    backward[(new, i)] = root * vectors[(i, old)] * scale[i];
                }
            }
            block = transform(&block, columns, forward.as_ref(), self.control)?;
            r = &backward * &r;
            columns = kept.len();
        }
        if columns == 0 {
            block = Vec::new();
        }
        debug_assert_eq!(block.len(), n * columns);
        Ok((block, r))
    }

    /// Ritz values by descending size of θ, vectors in the basis, and the error of each.
    fn ritz(&self) -> Result<(Vec<f64>, Mat<f64>, Vec<f64>)> {
        let size = self.basis.width;
        let (values, vectors) = dense_eigen(self.projected.as_ref().submatrix(0, 0, size, size), self.control)?;
        let mut order: Vec<usize> = (0..size).rev().collect();
        order.sort_by(|&a, &b| values[b].abs().total_cmp(&values[a].abs()));
        let theta: Vec<f64> = order.iter().map(|&i| values[i]).collect();
        let turned = Mat::from_fn(size, size, |i, j| vectors[(i, order[j])]);
        let last = self.coupling.ncols();
        let tail = &self.coupling * turned.as_ref().subrows(size - last, last);
        let errors = (0..size).map(|j| (0..tail.nrows()).map(|i| tail[(i, j)] * tail[(i, j)]).sum::<f64>().sqrt()).collect();
        Ok((theta, turned, errors))
    }

    /// Shrinks the basis to its `keep` best Ritz vectors. `fresh`: goes on with a random block, to look for missing copies.
    fn restart(&mut self, keep: usize, theta: &[f64], vectors: &Mat<f64>, fresh: bool) -> Result<()> {
        let (n, keep) = (self.pencil.n, keep.min(theta.len()));
        let last = self.coupling.ncols();
        let size = self.basis.width;
        let arrow = &self.coupling * vectors.as_ref().submatrix(size - last, 0, last, keep);
        self.basis.rotate(vectors.as_ref().subcols(0, keep), self.control)?;
        let room = self.basis.room;
        self.projected = Mat::zeros(room, room);
        for (i, &value) in theta[..keep].iter().enumerate() {
            self.projected[(i, i)] = value;
        }
        self.coupling = arrow;
        if fresh {
            let width = BLOCK.min(n - keep);
            let block = self.sequence.block(n, width);
            self.fresh_block(block, width)?;
        }
        Ok(())
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
            return Err(Error::numerical(format!("eigenpair {j} overflowed; rescale the shape, or use laplacian=\"intrinsic_delaunay\"")));
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
