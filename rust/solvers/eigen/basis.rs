//! Products with blocks of long vectors, kept side by side; sums are grouped by rows, alike on any number of threads.

use crate::control::Control;
use crate::error::{Error, Result};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rayon::prelude::*;

pub(super) const ROWS: usize = 1024; // rows of one parallel task in the dense products; fixed, so that sums are grouped alike

/// Columns of length n kept side by side, row after row, with room for more.
pub(super) struct Basis {
    numbers: Vec<f64>,
    pub(super) room: usize,
    pub(super) width: usize,
}

impl Basis {
    pub(super) fn new(n: usize, room: usize) -> Result<Self> {
        let mut numbers: Vec<f64> = Vec::new();
        let size = n.saturating_mul(room);
        numbers
            .try_reserve_exact(size)
            .map_err(|_| Error::numerical(format!("a basis of {size} numbers does not fit into memory; ask for fewer eigenpairs")))?;
        numbers.resize(size, 0.0);
        Ok(Basis { numbers, room, width: 0 })
    }

    pub(super) fn push(&mut self, block: &[f64], width: usize) {
        let (room, at) = (self.room, self.width);
        self.numbers.par_chunks_mut(ROWS * room).zip(block.par_chunks(ROWS * width)).for_each(|(rows, block)| {
            for (row, source) in rows.chunks_exact_mut(room).zip(block.chunks_exact(width)) {
                row[at..at + width].copy_from_slice(source);
            }
        });
        self.width += width;
    }

    /// V^T W for the columns of V from `first` on.
    pub(super) fn inner(&self, first: usize, block: &[f64], width: usize, control: &Control) -> Result<Mat<f64>> {
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
    pub(super) fn subtract(&self, first: usize, block: &mut [f64], width: usize, coefficients: &Mat<f64>, control: &Control) -> Result<()> {
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
    pub(super) fn rotate(&mut self, coefficients: MatRef<f64>, control: &Control) -> Result<()> {
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
    pub(super) fn into_block(self) -> Vec<f64> {
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
pub(super) fn transform(block: &[f64], width: usize, coefficients: MatRef<f64>, control: &Control) -> Result<Vec<f64>> {
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
pub(super) fn gram(x: &[f64], y: &[f64], width: usize, control: &Control) -> Result<Mat<f64>> {
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
