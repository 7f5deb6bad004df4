//! Compressed sparse rows: the one matrix type.

use crate::error::{Error, Result};
use rayon::prelude::*;

/// How many rows or elements one parallel task takes. Fixed, so that sums are grouped alike on any number of threads.
pub(crate) const CHUNK: usize = 4096;

/// Where the first number is that is not finite. Whole chunks first: a loop without an exit is compiled for the machine's vectors.
pub(crate) fn first_not_finite(numbers: &[f64]) -> Option<usize> {
    let finite = numbers.par_chunks(CHUNK).all(|part| part.iter().fold(true, |finite, number| finite & number.is_finite()));
    if finite { None } else { numbers.iter().position(|number| !number.is_finite()) }
}

/// A sparse matrix in compressed rows; columns ascend within a row and none is there twice.
#[derive(Debug, Clone, PartialEq)]
pub struct Csr {
    rows: usize,
    columns: usize,
    starts: Vec<usize>,
    indices: Vec<u32>,
    values: Vec<f64>,
}

impl Csr {
    /// A matrix from its arrays: `starts` (rows + 1), and `indices` and `values` of each entry, checked.
    ///
    /// ```
    /// let a = beltrami::Csr::new(2, 2, vec![0, 1, 3], vec![0, 0, 1], vec![2.0, 1.0, 3.0])?;
    /// assert_eq!(a.multiply(&[1.0, 1.0])?, [2.0, 4.0]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if the arrays do not fit together, columns do not ascend or are out of range, there are more than 2^32 - 1 rows or columns, or a
    /// value is not finite.
    pub fn new(rows: usize, columns: usize, starts: Vec<usize>, indices: Vec<u32>, values: Vec<f64>) -> Result<Self> {
        // u32::MAX itself is never an index: `combine` has it for the end of a row
        if rows.max(columns) > u32::MAX as usize {
            return Err(Error::input(format!("a matrix of {rows} x {columns}; rows and columns are up to 2^32 - 1")));
        }
        if starts.len() != rows + 1 || starts[0] != 0 || starts[rows] != indices.len() || indices.len() != values.len() {
            return Err(Error::input(format!(
                "a matrix of {rows} rows has {} row starts ending at {:?}, {} column indices and {} values; they must be rows + 1, and equal",
                starts.len(),
                starts.last(),
                indices.len(),
                values.len()
            )));
        }
        if let Some(row) = starts.windows(2).position(|pair| pair[1] < pair[0]) {
            return Err(Error::input(format!("row {row} of the matrix ends before it starts")));
        }
        let matrix = Csr { rows, columns, starts, indices, values };
        let wrong = (0..rows).into_par_iter().with_min_len(CHUNK).find_map_first(|row| {
            let (indices, values) = matrix.row(row);
            if let Some(pair) = indices.windows(2).find(|pair| pair[1] <= pair[0]) {
                return Some(format!(
                    "row {row} has column {} after column {}; sort the columns and add up repeated entries",
                    pair[1], pair[0]
                ));
            }
            if let Some(&last) = indices.last().filter(|&&last| last as usize >= columns) {
                return Some(format!("row {row} has an entry in column {last}, the matrix has {columns} columns"));
            }
            let bad = values.iter().position(|value| !value.is_finite())?;
            Some(format!("entry ({row}, {}) of the matrix is {}; entries must be finite", indices[bad], values[bad]))
        });
        match wrong {
            Some(text) => Err(Error::Input(text)),
            None => Ok(matrix),
        }
    }

    /// The same from arrays that a kernel of this crate has made itself.
    pub(crate) fn trusted(rows: usize, columns: usize, starts: Vec<usize>, indices: Vec<u32>, values: Vec<f64>) -> Self {
        debug_assert!(starts.len() == rows + 1 && starts[rows] == indices.len() && indices.len() == values.len());
        Csr { rows, columns, starts, indices, values }
    }

    /// A matrix made row by row, in parallel: `fill(row, work, indices, values)` appends the entries of a row, columns ascending.
    pub(crate) fn by_rows<W: Default>(
        rows: usize,
        columns: usize,
        fill: impl Fn(usize, &mut W, &mut Vec<u32>, &mut Vec<f64>) + Sync,
    ) -> Self {
        let parts: Vec<(Vec<usize>, Vec<u32>, Vec<f64>)> = (0..rows.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let (mut ends, mut indices, mut values) =
                    (Vec::with_capacity(CHUNK), Vec::with_capacity(8 * CHUNK), Vec::with_capacity(8 * CHUNK));
                let mut work = W::default();
                for row in chunk * CHUNK..((chunk + 1) * CHUNK).min(rows) {
                    fill(row, &mut work, &mut indices, &mut values);
                    ends.push(indices.len());
                }
                (ends, indices, values)
            })
            .collect();
        let mut starts = Vec::with_capacity(rows + 1);
        starts.push(0);
        for (ends, _, _) in &parts {
            let before = starts[starts.len() - 1];
            starts.extend(ends.iter().map(|end| before + end));
        }
        let total = starts[rows];
        let (mut indices, mut values) = (vec![0; total], vec![0.0; total]);
        let (mut left_indices, mut left_values) = (indices.as_mut_slice(), values.as_mut_slice());
        let mut copies = Vec::with_capacity(parts.len());
        for (_, from_indices, from_values) in &parts {
            let (to_indices, after_indices) = std::mem::take(&mut left_indices).split_at_mut(from_indices.len());
            let (to_values, after_values) = std::mem::take(&mut left_values).split_at_mut(from_values.len());
            copies.push((from_indices, from_values, to_indices, to_values));
            (left_indices, left_values) = (after_indices, after_values);
        }
        copies.into_par_iter().for_each(|(from_indices, from_values, to_indices, to_values)| {
            to_indices.copy_from_slice(from_indices);
            to_values.copy_from_slice(from_values);
        });
        Csr::trusted(rows, columns, starts, indices, values)
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Where each row starts in [`Csr::indices`] and [`Csr::values`]; rows + 1 numbers.
    pub fn starts(&self) -> &[usize] {
        &self.starts
    }

    /// Column of each entry, row after row.
    pub fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// Value of each entry, row after row.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Columns and values of one row.
    ///
    /// # Panics
    /// If there is no such row.
    pub fn row(&self, row: usize) -> (&[u32], &[f64]) {
        let range = self.starts[row]..self.starts[row + 1];
        (&self.indices[range.clone()], &self.values[range])
    }

    /// The arrays: row starts, column indices, values.
    pub fn into_parts(self) -> (Vec<usize>, Vec<u32>, Vec<f64>) {
        (self.starts, self.indices, self.values)
    }

    /// The entries on the diagonal, 0 where there is none.
    pub fn diagonal(&self) -> Vec<f64> {
        (0..self.rows.min(self.columns))
            .map(|row| {
                let (indices, values) = self.row(row);
                indices.binary_search(&(row as u32)).map_or(0.0, |at| values[at])
            })
            .collect()
    }

    /// `A x`, in parallel over rows.
    ///
    /// # Errors
    /// [`Error::Input`] if `x` is not as long as the matrix is wide.
    pub fn multiply(&self, x: &[f64]) -> Result<Vec<f64>> {
        self.multiply_block(x, 1)
    }

    /// `A X` for `width` columns kept side by side: `x[column * width + k]`, and the same in the answer.
    ///
    /// # Errors
    /// [`Error::Input`] if `x` does not hold `columns * width` numbers.
    pub fn multiply_block(&self, x: &[f64], width: usize) -> Result<Vec<f64>> {
        if x.len() != self.columns * width {
            return Err(Error::input(format!(
                "{} numbers cannot be multiplied by a matrix of {} columns ({width} vectors)",
                x.len(),
                self.columns
            )));
        }
        let mut out = vec![0.0; self.rows * width];
        if width == 0 {
            return Ok(out);
        }
        out.par_chunks_mut(CHUNK * width).enumerate().for_each(|(chunk, out)| {
            for (offset, sums) in out.chunks_exact_mut(width).enumerate() {
                let (indices, values) = self.row(chunk * CHUNK + offset);
                for (&column, &value) in indices.iter().zip(values) {
                    let source = &x[column as usize * width..][..width];
                    for (sum, &number) in sums.iter_mut().zip(source) {
                        *sum += value * number;
                    }
                }
            }
        });
        Ok(out)
    }

    /// The square matrix with these numbers on its diagonal.
    pub fn from_diagonal(numbers: &[f64]) -> Csr {
        let n = numbers.len();
        Csr { rows: n, columns: n, starts: (0..=n).collect(), indices: (0..n as u32).collect(), values: numbers.to_vec() }
    }

    /// `a A + b B`; an entry that either matrix has is there, even if it is 0.
    ///
    /// ```
    /// use beltrami::Csr;
    /// let (a, b) = (Csr::new(1, 2, vec![0, 1], vec![1], vec![2.0])?, Csr::new(1, 2, vec![0, 1], vec![0], vec![3.0])?);
    /// assert_eq!(a.combine(1.0, &b, 10.0)?.row(0), (&[0, 1][..], &[30.0, 2.0][..]));
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if the sizes differ; [`Error::Numerical`] if an entry overflows.
    pub fn combine(&self, a: f64, other: &Csr, b: f64) -> Result<Csr> {
        if (self.rows, self.columns) != (other.rows, other.columns) {
            return Err(Error::input(format!(
                "a {} x {} matrix and a {} x {} matrix cannot be added",
                self.rows, self.columns, other.rows, other.columns
            )));
        }
        let sum = Csr::by_rows(self.rows, self.columns, |row, (): &mut (), indices, values| {
            let ((left, left_values), (right, right_values)) = (self.row(row), other.row(row));
            let (mut i, mut j) = (0, 0);
            while i < left.len() || j < right.len() {
                let (l, r) = (left.get(i).copied().unwrap_or(u32::MAX), right.get(j).copied().unwrap_or(u32::MAX));
                let mut value = 0.0;
                if l <= r {
                    value += a * left_values[i];
                    i += 1;
                }
                if r <= l {
                    value += b * right_values[j];
                    j += 1;
                }
                indices.push(l.min(r));
                values.push(value);
            }
        });
        if let Some(at) = sum.values.iter().position(|value| !value.is_finite()) {
            return Err(Error::numerical(format!(
                "a sum of two matrices overflows: an entry in column {} is {}; rescale them",
                sum.indices[at], sum.values[at]
            )));
        }
        Ok(sum)
    }

    /// The transposed matrix.
    pub fn transpose(&self) -> Csr {
        let mut starts = vec![0; self.columns + 1];
        for &column in &self.indices {
            starts[column as usize + 1] += 1;
        }
        for column in 0..self.columns {
            starts[column + 1] += starts[column];
        }
        let mut next = starts.clone();
        let mut indices = vec![0; self.indices.len()];
        let mut values = vec![0.0; self.values.len()];
        for row in 0..self.rows {
            let (columns, numbers) = self.row(row);
            for (&column, &number) in columns.iter().zip(numbers) {
                let at = next[column as usize];
                next[column as usize] += 1;
                indices[at] = row as u32;
                values[at] = number;
            }
        }
        Csr { rows: self.columns, columns: self.rows, starts, indices, values }
    }
}

/// Appends (column, value) pairs to a row, columns ascending; values of one column are added up in their order.
pub(crate) fn append_sums(entries: impl IntoIterator<Item = (u32, f64)>, indices: &mut Vec<u32>, values: &mut Vec<f64>) {
    let first = indices.len();
    for (column, value) in entries {
        match values.last_mut() {
            Some(last) if indices.len() > first && indices.last() == Some(&column) => *last += value,
            _ => {
                indices.push(column);
                values.push(value);
            }
        }
    }
}
