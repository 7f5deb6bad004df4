//! Conjugate gradients from a guess: for a system that is solved again and again while its right-hand side hardly changes.
//!
//! The diagonal is the preconditioner (Jacobi). A few steps cost less than a solve with a factor where the matrix is well
//! conditioned, as `L + κ M` with κ about the inverse square of the spacing is; and there is nothing to factor.

use crate::error::{Error, Result};
use crate::sparse::{CHUNK, Csr};
use rayon::prelude::*;

/// A symmetric positive definite matrix and the inverse of its diagonal.
///
/// ```
/// use beltrami::{Csr, solvers::Conjugate};
/// let a = Csr::new(2, 2, vec![0, 2, 4], vec![0, 1, 0, 1], vec![4.0, -2.0, -2.0, 5.0])?;
/// let mut x = [0.9, 1.1];
/// let steps = Conjugate::new(a)?.improve(&[2.0, 3.0], 1, &mut x, 1e-12, 10, &mut Vec::new())?;
/// assert!(steps == 2 && (x[0] - 1.0).abs() < 1e-14 && (x[1] - 1.0).abs() < 1e-14);
/// # Ok::<(), beltrami::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Conjugate {
    matrix: Csr,
    inverse: Vec<f64>,
}

impl Conjugate {
    /// Keeps the matrix. That it is symmetric is not checked.
    ///
    /// # Errors
    /// [`Error::Input`] if the matrix is not square; [`Error::Numerical`] naming the row if a diagonal entry is not positive.
    pub fn new(matrix: Csr) -> Result<Self> {
        if matrix.rows() != matrix.columns() {
            return Err(Error::input(format!("a matrix of {} rows and {} columns is not square", matrix.rows(), matrix.columns())));
        }
        let diagonal = matrix.diagonal();
        if let Some(row) = diagonal.iter().position(|entry| !(*entry > 0.0)) {
            return Err(Error::numerical(format!("the matrix is not positive definite: diagonal entry {row} is {}", diagonal[row])));
        }
        Ok(Conjugate { matrix, inverse: diagonal.into_iter().map(|entry| 1.0 / entry).collect() })
    }

    /// Moves `x` towards the solution of `A X = B`, `width` right-hand sides side by side, until in each the residual has shrunk by
    /// `reduction` (both in the norm of the inverse diagonal), or for `most` steps. Returns the number of steps. `scratch` grows in
    /// the first call and is used again by later ones.
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit; [`Error::Numerical`] if a number is not finite or the matrix is not positive definite.
    pub fn improve(&self, b: &[f64], width: usize, x: &mut [f64], reduction: f64, most: usize, scratch: &mut Vec<f64>) -> Result<usize> {
        let rows = self.inverse.len();
        if width == 0 || Some(b.len()) != rows.checked_mul(width) || x.len() != b.len() {
            return Err(Error::input(format!("{} and {} numbers do not make {width} vectors of {rows}", b.len(), x.len())));
        }
        let mut run = |b: &[f64], width: usize, x: &mut [f64]| match width {
            1 => self.iterate::<1>(b.as_chunks().0, x.as_chunks_mut().0, reduction, most, scratch),
            2 => self.iterate::<2>(b.as_chunks().0, x.as_chunks_mut().0, reduction, most, scratch),
            3 => self.iterate::<3>(b.as_chunks().0, x.as_chunks_mut().0, reduction, most, scratch),
            _ => self.iterate::<4>(b.as_chunks().0, x.as_chunks_mut().0, reduction, most, scratch),
        };
        if width <= 4 {
            return run(b, width, x);
        }
        let mut steps = 0;
        for first in (0..width).step_by(4) {
            let some = (width - first).min(4);
            let part = |all: &[f64]| all.chunks_exact(width).flat_map(|row| row[first..first + some].to_vec()).collect::<Vec<f64>>();
            let mut own = part(x);
            steps = run(&part(b), some, &mut own)?.max(steps);
            for (row, own) in x.chunks_exact_mut(width).zip(own.chunks_exact(some)) {
                row[first..first + some].copy_from_slice(own);
            }
        }
        Ok(steps)
    }

    fn iterate<const W: usize>(
        &self,
        b: &[[f64; W]],
        x: &mut [[f64; W]],
        reduction: f64,
        most: usize,
        scratch: &mut Vec<f64>,
    ) -> Result<usize> {
        let rows = x.len();
        scratch.resize(scratch.len().max(3 * rows * W), 0.0);
        let (rest, others) = scratch.as_chunks_mut::<W>().0.split_at_mut(rows);
        let (direction, others) = others.split_at_mut(rows);
        let image = &mut others[..rows];
        self.multiply(x, image);
        rest.copy_from_slice(b);
        direction.fill([0.0; W]); // what a call before left may not be finite
        let first = self.advance(x, rest, direction, image, &[1.0; W]);
        self.turn(rest, direction, &[0.0; W]);
        let mut size = first;
        if let Some(size) = size.iter().find(|size| !size.is_finite()) {
            return Err(Error::numerical(format!("the residual of the guess is {size}; scale the matrix or the right-hand side")));
        }
        for step in 0..most {
            if (0..W).all(|k| size[k] <= reduction * reduction * first[k]) {
                return Ok(step);
            }
            let energy = self.multiply(direction, image);
            if let Some(k) = (0..W).find(|&k| size[k] > 0.0 && !(energy[k] > 0.0 && energy[k].is_finite())) {
                return Err(Error::numerical(format!("the matrix is not positive definite: x^T A x = {:.3e} was met", energy[k])));
            }
            let lengths = std::array::from_fn(|k| if size[k] > 0.0 { size[k] / energy[k] } else { 0.0 });
            let new = self.advance(x, rest, direction, image, &lengths);
            self.turn(rest, direction, &std::array::from_fn(|k| if size[k] > 0.0 { new[k] / size[k] } else { 0.0 }));
            size = new;
        }
        Ok(most)
    }

    /// `image := A x`; returns `x · A x` of each column.
    fn multiply<const W: usize>(&self, x: &[[f64; W]], image: &mut [[f64; W]]) -> [f64; W] {
        let parts = image.par_chunks_mut(CHUNK).enumerate().map(|(chunk, image)| {
            let mut sums = [0.0; W];
            for (offset, image) in image.iter_mut().enumerate() {
                let row = chunk * CHUNK + offset;
                let (columns, values) = self.matrix.row(row);
                let mut own = [0.0; W];
                for (&column, &value) in columns.iter().zip(values) {
                    let x = &x[column as usize];
                    (0..W).for_each(|k| own[k] += value * x[k]);
                }
                (0..W).for_each(|k| sums[k] += x[row][k] * own[k]);
                *image = own;
            }
            sums
        });
        added(parts.collect())
    }

    /// `x += lengths * direction; rest -= lengths * image`; returns `Σ rest² / diagonal` of each column.
    fn advance<const W: usize>(
        &self,
        x: &mut [[f64; W]],
        rest: &mut [[f64; W]],
        direction: &[[f64; W]],
        image: &[[f64; W]],
        lengths: &[f64; W],
    ) -> [f64; W] {
        let moved = x.par_chunks_mut(CHUNK).zip(rest.par_chunks_mut(CHUNK)).zip(self.inverse.par_chunks(CHUNK));
        let parts =
            moved.zip(direction.par_chunks(CHUNK).zip(image.par_chunks(CHUNK))).map(|(((x, rest), inverse), (direction, image))| {
                let mut sums = [0.0; W];
                for (((x, rest), inverse), (direction, image)) in x.iter_mut().zip(rest).zip(inverse).zip(direction.iter().zip(image)) {
                    for k in 0..W {
                        x[k] += lengths[k] * direction[k];
                        rest[k] -= lengths[k] * image[k];
                        sums[k] += inverse * rest[k] * rest[k];
                    }
                }
                sums
            });
        added(parts.collect())
    }

    /// `direction := r / diagonal + turn * direction`.
    fn turn<const W: usize>(&self, rest: &[[f64; W]], direction: &mut [[f64; W]], turns: &[f64; W]) {
        let each = direction.par_chunks_mut(CHUNK).zip(rest.par_chunks(CHUNK).zip(self.inverse.par_chunks(CHUNK)));
        each.for_each(|(direction, (rest, inverse))| {
            for ((direction, rest), inverse) in direction.iter_mut().zip(rest).zip(inverse) {
                (0..W).for_each(|k| direction[k] = inverse * rest[k] + turns[k] * direction[k]);
            }
        });
    }
}

fn added<const W: usize>(parts: Vec<[f64; W]>) -> [f64; W] {
    parts.iter().fold([0.0; W], |sums, part| std::array::from_fn(|k| sums[k] + part[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The second differences of a path plus a multiple of the identity.
    fn path(n: usize, shift: f64) -> Csr {
        let (mut starts, mut indices, mut values) = (vec![0], Vec::new(), Vec::new());
        for row in 0..n {
            for column in row.saturating_sub(1)..(row + 2).min(n) {
                indices.push(column as u32);
                values.push(if column == row { 2.0 + shift } else { -1.0 });
            }
            starts.push(indices.len());
        }
        Csr::new(n, n, starts, indices, values).unwrap()
    }

    #[test]
    fn columns_side_by_side_are_solved_as_each_alone() {
        let (n, solver) = (5000, Conjugate::new(path(5000, 0.5)).unwrap());
        for width in [1, 2, 3, 4, 5, 9] {
            let truth: Vec<f64> = (0..n * width).map(|at| ((at * at) as f64 * 0.37).sin()).collect();
            let b = solver.matrix.multiply_block(&truth, width).unwrap();
            let mut x = vec![0.0; n * width];
            let steps = solver.improve(&b, width, &mut x, 1e-13, 200, &mut Vec::new()).unwrap();
            assert!(steps < 60, "{steps}");
            assert!(x.iter().zip(&truth).all(|(x, truth)| (x - truth).abs() < 1e-12));
        }
    }

    #[test]
    fn the_residual_shrinks_as_far_as_asked_and_no_further() {
        let (n, solver) = (5000, Conjugate::new(path(5000, 0.1)).unwrap());
        let b: Vec<f64> = (0..n).map(|at| ((at * at) as f64 * 0.37).sin()).collect();
        let size = |x: &[f64]| {
            let image = solver.matrix.multiply(x).unwrap();
            b.iter().zip(image).map(|(b, image)| (b - image).powi(2)).sum::<f64>().sqrt()
        };
        let (mut x, mut less) = (vec![0.3; n], vec![0.3; n]);
        let before = size(&x);
        let steps = solver.improve(&b, 1, &mut x, 0.1, 100, &mut Vec::new()).unwrap();
        assert!(size(&x) <= 0.11 * before); // the diagonal is constant but for rounding
        assert_eq!(solver.improve(&b, 1, &mut less, 0.1, steps - 1, &mut Vec::new()).unwrap(), steps - 1);
        assert!(size(&less) > 0.1 * before);
    }

    #[test]
    fn what_is_solved_stays_and_nonsense_is_refused() {
        let solver = Conjugate::new(path(3, 1.0)).unwrap();
        let mut x = [1.0, 1.0, 1.0];
        assert_eq!(solver.improve(&[2.0, 1.0, 2.0], 1, &mut x, 0.1, 9, &mut Vec::new()).unwrap(), 0);
        assert_eq!(x, [1.0; 3]);
        assert!(solver.improve(&[1.0; 2], 1, &mut x, 0.1, 9, &mut Vec::new()).is_err());
        assert!(solver.improve(&[f64::NAN; 3], 1, &mut x, 0.1, 9, &mut Vec::new()).is_err());
        let indefinite = Csr::new(2, 2, vec![0, 2, 4], vec![0, 1, 0, 1], vec![1.0, 3.0, 3.0, 1.0]).unwrap();
        assert!(Conjugate::new(indefinite).unwrap().improve(&[1.0, -1.0], 1, &mut [0.0; 2], 0.1, 9, &mut Vec::new()).is_err());
        assert!(Conjugate::new(Csr::new(1, 1, vec![0, 1], vec![0], vec![-1.0]).unwrap()).is_err());
    }
}
