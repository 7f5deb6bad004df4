//! Block Lanczos with thick restart for `(A - σ M)^-1 M`.

use super::basis::{Basis, gram, transform};
use super::dense::dense_eigen;
use super::{BLOCK, EigenOptions, Eigenpairs, Factor, Pencil};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::solvers::Scratch;
use crate::sparse::first_not_finite;
use faer::Mat;

pub(super) const TOLERANCE: f64 = 1e-11; // of a Ritz pair, relative to its θ
const MAX_BLOCKS: usize = 1000;
const ROOMY: usize = 256; // columns that a basis has to spare at most where it is small
const SMALL: usize = 1 << 23; // numbers of such a basis

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

impl Pencil<'_> {
    pub(super) fn lanczos(&self, k: usize, shift: f64, factor: &Factor, options: &EigenOptions, control: &Control) -> Result<Eigenpairs> {
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
            "{k} eigenpairs of {n} unknowns did not converge in {most} blocks of solves (shift = {shift:.1e}); the shape may have slivers: use an intrinsic Delaunay Laplacian, or ask for fewer"
        )))
    }
}

/// Whether so many of the values are equal that copies beyond the width of a block may be missing.
fn has_large_cluster(theta: &[f64]) -> bool {
    let mut theta = theta.to_vec();
    theta.sort_unstable_by(f64::total_cmp);
    theta.windows(BLOCK).any(|window| window[BLOCK - 1] - window[0] <= 1e-6 * window[0].abs())
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
                "a solve of the eigenproblem overflowed; rescale the shape, or use an intrinsic Delaunay Laplacian",
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
