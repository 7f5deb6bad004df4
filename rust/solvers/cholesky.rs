//! Sparse Cholesky factorization `P A P^T = L L^T`: multifrontal over relaxed supernodes, subtrees in parallel.
//!
//! Duff and Reid 1983, Liu 1992. A supernode's front is its columns (kept, as part of L) and an update of what lies below
//! them, handed up to its parent. Subtrees own disjoint stretches of L, so they run in parallel; how the tree is cut into
//! tasks depends on the matrix only, so the same bits come on any number of threads.

use super::dense::{self, Refused};
use super::sweep::{self, Block};
use super::symbolic::{NONE, Symbolic, same_sums};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::{CHUNK, Csr, first_not_finite};
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

const REFINE: f64 = 1e-13; // a relative residual above this is worth a step of refinement
const WIDE: usize = 64; // right-hand sides in work at once
const ASYMMETRY: f64 = 1e-12;

/// The factor of a symmetric positive definite matrix.
///
/// It keeps the matrix too, so every solve knows its residual and takes a step of iterative refinement where that helps.
///
/// ```
/// use beltrami::{Control, Csr, solvers::Cholesky};
/// let a = Csr::new(2, 2, vec![0, 2, 4], vec![0, 1, 0, 1], vec![4.0, 2.0, 2.0, 5.0])?;
/// let mut factor = Cholesky::new(&a, None, &Control::default())?;
/// assert_eq!(factor.solve(&[8.0, 12.0])?, [1.0, 2.0]);
/// assert!((factor.log_determinant() - 16f64.ln()).abs() < 1e-15);
/// # Ok::<(), beltrami::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Cholesky {
    symbolic: Arc<Symbolic>,
    /// The matrix's values in the order of the analysis.
    entries: Vec<f64>,
    values: Vec<f64>,
}

/// Memory that repeated solves use again. See [`Cholesky::solve_block_into`].
#[derive(Debug, Default)]
pub struct Scratch {
    /// Whether a solve looks at its residual and refines where that is above 1e-13. Costs about a tenth.
    pub refine: bool,
    numbers: Vec<f64>,
    pool: sweep::Pool,
}

impl Scratch {
    /// Memory for solves that look at their residuals and refine.
    pub fn refining() -> Self {
        Scratch { refine: true, ..Scratch::default() }
    }
}

impl Cholesky {
    /// Orders, analyses and factors a symmetric positive definite matrix, both of whose triangles are stored.
    ///
    /// `coordinates` (n times D numbers, D) place the unknowns: the order is then found faster, and is as good or better.
    ///
    /// # Errors
    /// [`Error::Input`] if the matrix is not square or not symmetric, or coordinates do not fit it; [`Error::Numerical`] naming
    /// the row if it is not positive definite to working precision; [`Error::Cancelled`] on request.
    pub fn new(matrix: &Csr, coordinates: Option<(&[f64], usize)>, control: &Control) -> Result<Self> {
        let symbolic = Symbolic::new(matrix, coordinates, control)?;
        Self::factored(symbolic, matrix, control)
    }

    /// Factors a matrix with an analysis that was made before, for this matrix or another of the same pattern.
    ///
    /// # Errors
    /// [`Error::Input`] if the pattern differs; else as [`Cholesky::new`].
    pub fn with_symbolic(symbolic: &Arc<Symbolic>, matrix: &Csr, control: &Control) -> Result<Self> {
        symbolic.fits(matrix)?;
        Self::factored(symbolic.clone(), matrix, control)
    }

    fn factored(symbolic: Arc<Symbolic>, matrix: &Csr, control: &Control) -> Result<Self> {
        symmetric(matrix)?;
        let size = symbolic.value_starts[symbolic.supernodes()];
        let mut values: Vec<f64> = Vec::new();
        values.try_reserve_exact(size).map_err(|_| {
            Error::numerical(format!("a factor of {size} numbers does not fit into memory; use an iterative solver or fewer unknowns"))
        })?;
        drop(values);
        let mut factor = Cholesky { entries: vec![0.0; symbolic.columns.len()], values: vec![0.0; size], symbolic };
        factor.number(matrix, control)?;
        Ok(factor)
    }

    /// Factors another matrix of the same pattern in place of this one. After an error the factor must be refactored before use:
    /// its solves refuse.
    ///
    /// ```
    /// # use beltrami::{Control, Csr, solvers::Cholesky};
    /// let diagonal = |d: f64| Csr::new(2, 2, vec![0, 1, 2], vec![0, 1], vec![d, d]);
    /// let mut factor = Cholesky::new(&diagonal(2.0)?, None, &Control::default())?;
    /// factor.refactor(&diagonal(4.0)?, &Control::default())?;
    /// assert_eq!(factor.solve(&[1.0, 2.0])?, [0.25, 0.5]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if the pattern differs (the factor is then as it was); else as [`Cholesky::new`].
    pub fn refactor(&mut self, matrix: &Csr, control: &Control) -> Result<()> {
        self.symbolic.fits(matrix)?;
        symmetric(matrix)?;
        self.number(matrix, control)
    }

    /// The analysis, for more matrices of the same pattern.
    pub fn symbolic(&self) -> Arc<Symbolic> {
        self.symbolic.clone()
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.symbolic.n
    }

    /// Numbers kept in the factor; see [`Symbolic::nnz`].
    pub fn nnz(&self) -> usize {
        self.symbolic.nonzeros
    }

    /// The logarithm of the determinant.
    pub fn log_determinant(&self) -> f64 {
        let symbolic = &self.symbolic;
        let mut sum = 0.0;
        for node in 0..symbolic.supernodes() {
            let columns = symbolic.columns(node).len();
            let rows = columns + symbolic.below(node);
            for column in 0..columns {
                sum += self.values[symbolic.value_starts[node] + column * (rows + 1)].ln();
            }
        }
        2.0 * sum
    }

    /// The matrix that was factored last.
    pub fn matrix(&self) -> Csr {
        let symbolic = &self.symbolic;
        let (starts, indices) = (symbolic.pattern.0.clone(), symbolic.pattern.1.clone());
        let mut values = vec![0.0; indices.len()];
        for (new, &old) in symbolic.order.iter().enumerate() {
            values[starts[old as usize]..starts[old as usize + 1]]
                .copy_from_slice(&self.entries[symbolic.entry_starts[new]..symbolic.entry_starts[new + 1]]);
        }
        Csr::trusted(symbolic.n, symbolic.n, starts, indices, values)
    }

    fn number(&mut self, matrix: &Csr, control: &Control) -> Result<()> {
        let symbolic = &*self.symbolic;
        {
            let mut parts = Vec::new();
            let mut rest = &mut self.entries[..];
            for rows in symbolic.order.chunks(CHUNK) {
                let size = rows.iter().map(|&old| matrix.starts()[old as usize + 1] - matrix.starts()[old as usize]).sum();
                let (part, after) = rest.split_at_mut(size);
                rest = after;
                parts.push((rows, part));
            }
            parts.into_par_iter().for_each(|(rows, part)| {
                let mut at = 0;
                for &old in rows {
                    let values = matrix.row(old as usize).1;
                    part[at..at + values.len()].copy_from_slice(values);
                    at += values.len();
                }
            });
        }
        control.check()?;
        let total: f64 = symbolic.roots().iter().map(|&root| symbolic.subtree_work[root as usize]).sum();
        let task = Task { symbolic, entries: &self.entries, control, done: AtomicU64::new(0), total: total.max(1.0) };
        let groups = symbolic.groups(symbolic.roots());
        let outcome = task.groups(&groups, &mut self.values);
        outcome.map(|_| ()).map_err(|refused| {
            // A factor that is half old and half new must not answer: its first diagonal entry says so.
            if let Some(first) = self.values.first_mut() {
                *first = f64::NAN;
            }
            match refused {
                Refused::Stopped(error) => error,
                Refused::Pivot(column, value) => {
                    let row = symbolic.order[column];
                    let diagonal = matrix.diagonal()[row as usize];
                    Error::numerical(format!(
                        "the matrix is not positive definite: the pivot of row {row} is {value:.6e} where its diagonal entry is {diagonal:.6e}; \
                         add a positive multiple of the mass matrix, fix an unknown of each component, or check the matrix's sign"
                    ))
                }
            }
        })
    }

    /// Solves `A x = b`.
    ///
    /// # Errors
    /// [`Error::Input`] if `b` does not hold a finite number for each row; [`Error::Numerical`] if the answer is not finite.
    pub fn solve(&self, b: &[f64]) -> Result<Vec<f64>> {
        self.solve_block(b, 1)
    }

    /// Solves `A X = B` for `width` right-hand sides kept side by side: `b[row * width + k]`, and the same in the answer.
    ///
    /// # Errors
    /// As [`Cholesky::solve`].
    pub fn solve_block(&self, b: &[f64], width: usize) -> Result<Vec<f64>> {
        let mut out = vec![0.0; b.len()];
        self.solve_block_into(b, width, &mut out, &mut Scratch::refining())?;
        Ok(out)
    }

    /// The same into memory that is there already. `scratch` grows in the first call; later ones allocate next to nothing.
    ///
    /// ```
    /// # use beltrami::{Control, Csr, solvers::{Cholesky, Scratch}};
    /// # let a = Csr::new(1, 1, vec![0, 1], vec![0], vec![4.0])?;
    /// let factor = Cholesky::new(&a, None, &Control::default())?;
    /// let (mut x, mut scratch) = ([0.0; 2], Scratch::default());
    /// factor.solve_block_into(&[2.0, 8.0], 2, &mut x, &mut scratch)?;
    /// assert_eq!(x, [0.5, 2.0]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`Cholesky::solve`], and [`Error::Input`] if `out` is not as long as `b`.
    pub fn solve_block_into(&self, b: &[f64], width: usize, out: &mut [f64], scratch: &mut Scratch) -> Result<()> {
        let n = self.symbolic.n;
        if Some(b.len()) != n.checked_mul(width) || out.len() != b.len() {
            return Err(Error::input(format!(
                "{} numbers in, {} out: {n} rows and {width} right-hand sides need {} of each",
                b.len(),
                out.len(),
                n.saturating_mul(width)
            )));
        }
        if let Some(at) = first_not_finite(b) {
            return Err(Error::input(format!("row {} of right-hand side {} is {}; it must be finite", at / width, at % width, b[at])));
        }
        if self.values.first().is_some_and(|first| first.is_nan()) {
            return Err(Error::numerical(
                "the last refactorization failed, so there is no factor to solve with; refactor with another matrix",
            ));
        }
        for first in (0..width).step_by(WIDE) {
            self.solve_some(b, width, first, (width - first).min(WIDE), out, scratch)?;
        }
        Ok(())
    }

    /// Solves for right-hand sides `first..first + count`.
    fn solve_some(&self, b: &[f64], width: usize, first: usize, count: usize, out: &mut [f64], scratch: &mut Scratch) -> Result<()> {
        let n = self.symbolic.n;
        let mut blocks = Vec::new(); // (first column, columns, columns with padding)
        let mut at = 0;
        while at < count {
            let padded = match count - at {
                1 => 1,
                2..=4 => 4,
                5..=8 => 8,
                _ => 16,
            };
            blocks.push((at, padded.min(count - at), padded));
            at += padded;
        }
        let share = if scratch.refine { 3 } else { 1 }; // solution; right-hand side and residual
        let sizes: usize = blocks.iter().map(|&(_, _, padded)| padded * n * share).sum();
        if scratch.numbers.len() < sizes {
            scratch.numbers.resize(sizes, 0.0);
        }
        let mut rest = &mut scratch.numbers[..sizes];
        let mut work = Vec::new();
        for &(at, columns, padded) in &blocks {
            let (space, after) = rest.split_at_mut(padded * n * share);
            rest = after;
            work.push((at, columns, padded, space));
        }
        let (pool, refine) = (&scratch.pool, scratch.refine);
        let good = work
            .into_par_iter()
            .with_max_len(1)
            .map(|(at, columns, padded, space)| {
                let block = Block {
                    symbolic: &self.symbolic,
                    values: &self.values,
                    entries: &self.entries,
                    pool,
                    refine: refine.then_some(REFINE),
                };
                match padded {
                    1 => block.solve::<1>(b, width, first + at, columns, space),
                    4 => block.solve::<4>(b, width, first + at, columns, space),
                    8 => block.solve::<8>(b, width, first + at, columns, space),
                    _ => block.solve::<16>(b, width, first + at, columns, space),
                }
            })
            .reduce(|| true, |a, b| a && b);
        if !good {
            return Err(Error::numerical("the solution overflows; scale the matrix or the right-hand side"));
        }
        let mut ready = Vec::new();
        let mut rest = &scratch.numbers[..sizes];
        for &(at, columns, padded) in &blocks {
            let (space, after) = rest.split_at(padded * n * share);
            rest = after;
            ready.push((at, columns, padded, &space[..padded * n]));
        }
        let inverse = &self.symbolic.inverse;
        out.par_chunks_mut(CHUNK * width).enumerate().for_each(|(chunk, out)| {
            for (offset, row) in out.chunks_exact_mut(width).enumerate() {
                let new = inverse[chunk * CHUNK + offset] as usize;
                for &(at, columns, padded, x) in &ready {
                    row[first + at..first + at + columns].copy_from_slice(&x[new * padded..new * padded + columns]);
                }
            }
        });
        Ok(())
    }

    /// `|b - A x| / |b|` of each right-hand side (0 where both are zero), as the factored matrix has it.
    ///
    /// # Errors
    /// [`Error::Input`] if the sizes do not fit or a number is not finite.
    pub fn residuals(&self, b: &[f64], x: &[f64], width: usize) -> Result<Vec<f64>> {
        let n = self.symbolic.n;
        if Some(b.len()) != n.checked_mul(width) || x.len() != b.len() {
            return Err(Error::input(format!("{} and {} numbers do not make {width} vectors of {n}", b.len(), x.len())));
        }
        if let Some(at) = b.iter().zip(x).position(|(b, x)| !(b.is_finite() && x.is_finite())) {
            return Err(Error::input(format!("row {} of b or x is {} or {}; numbers must be finite", at / width, b[at], x[at])));
        }
        let product = self.matrix().multiply_block(x, width)?;
        let rest: Vec<f64> = b.iter().zip(&product).map(|(b, product)| b - product).collect();
        let (rest, whole) = (norms(&rest, width), norms(b, width));
        Ok(rest.into_iter().zip(whole).map(|(rest, whole)| if rest == 0.0 { 0.0 } else { rest / whole }).collect())
    }
}

/// Euclidean norm of each column, infinite only if a number is: squares of very large or small numbers are out of range.
fn norms(numbers: &[f64], width: usize) -> Vec<f64> {
    let rows = || numbers.chunks_exact(width.max(1));
    let mut largest = vec![0.0f64; width];
    rows().for_each(|row| largest.iter_mut().zip(row).for_each(|(most, number)| *most = most.max(number.abs())));
    let mut sums = vec![0.0f64; width];
    for row in rows() {
        for ((sum, number), &most) in sums.iter_mut().zip(row).zip(&largest) {
            *sum += if most > 0.0 && most.is_finite() { (number / most) * (number / most) } else { 0.0 };
        }
    }
    largest.iter().zip(sums).map(|(most, sum)| if most.is_finite() { most * sum.sqrt() } else { f64::INFINITY }).collect()
}

/// An error unless `a_ij` equals `a_ji` to rounding.
fn symmetric(matrix: &Csr) -> Result<()> {
    let values = matrix.values();
    if same_sums(matrix.rows(), matrix.starts(), matrix.indices(), |entry| values[entry].to_bits()) {
        return Ok(());
    }
    let diagonal = matrix.diagonal();
    let wrong = (0..matrix.rows()).into_par_iter().with_min_len(CHUNK).find_map_first(|row| {
        let (columns, numbers) = matrix.row(row);
        columns.iter().zip(numbers).filter(|&(&column, _)| (column as usize) > row).find_map(|(&column, &value)| {
            let (back, others) = matrix.row(column as usize);
            let other = back.binary_search(&(row as u32)).map_or(0.0, |at| others[at]);
            let scale = value.abs().max(other.abs()).max((diagonal[row].abs() * diagonal[column as usize].abs()).sqrt());
            ((value - other).abs() > ASYMMETRY * scale).then_some((row, column, value, other))
        })
    });
    match wrong {
        None => Ok(()),
        Some((row, column, value, other)) => Err(Error::input(format!(
            "the matrix is not symmetric: entry ({row}, {column}) is {value:e}, entry ({column}, {row}) is {other:e}; use (A + A^T) / 2 if the difference means nothing"
        ))),
    }
}

type Outcome<T> = std::result::Result<T, Refused>;

/// One numeric factorization.
struct Task<'a> {
    symbolic: &'a Symbolic,
    entries: &'a [f64],
    control: &'a Control,
    done: AtomicU64,
    total: f64,
}

impl Task<'_> {
    /// Factors groups of subtrees in parallel; `values` is their part of the factor. Returns what each group hands up.
    fn groups(&self, groups: &[&[u32]], values: &mut [f64]) -> Outcome<Vec<Vec<f64>>> {
        match groups {
            [] => Ok(Vec::new()),
            [group] => self.group(group, values).map(|updates| vec![updates]),
            _ => {
                let (one, two) = groups.split_at(groups.len() / 2);
                let starts = &self.symbolic.value_starts;
                let first = |groups: &[&[u32]]| starts[self.symbolic.subtree_firsts[groups[0][0] as usize] as usize];
                let (left, right) = values.split_at_mut(first(two) - first(one));
                let (left, right) = rayon::join(|| self.groups(one, left), || self.groups(two, right));
                let mut all = left?;
                all.extend(right?);
                Ok(all)
            }
        }
    }

    fn group(&self, tops: &[u32], values: &mut [f64]) -> Outcome<Vec<f64>> {
        let symbolic = self.symbolic;
        let (first, last) = (symbolic.subtree_firsts[tops[0] as usize] as usize, tops[tops.len() - 1] as usize);
        let base = symbolic.value_starts[first];
        if tops.len() == 1 && symbolic.subtree_work[last] > symbolic.grain && first < last {
            let groups = symbolic.groups(symbolic.children(last));
            let (inner, panel) = values.split_at_mut(symbolic.value_starts[last] - base);
            let updates = self.groups(&groups, inner)?;
            let below = symbolic.below(last);
            let mut own = vec![0.0; below * below];
            let children = groups.iter().zip(&updates).flat_map(|(group, updates)| {
                group.iter().scan(0, move |at, &child| {
                    let size = symbolic.below(child as usize).pow(2);
                    *at += size;
                    Some((child as usize, &updates[*at - size..*at]))
                })
            });
            self.front(last, panel, &mut own, children)?;
            return Ok(own);
        }
        let mut stacks = [Vec::new(), Vec::new()];
        let mut sizes = Vec::new();
        for node in first..=last {
            let [even, odd] = &mut stacks;
            let (own, others) = if symbolic.odd[node] { (odd, even) } else { (even, odd) };
            let below = symbolic.below(node);
            let start = own.len();
            own.resize(start + below * below, 0.0);
            sizes.clear();
            let handed: usize = symbolic.children(node).iter().map(|&child| symbolic.below(child as usize).pow(2)).sum();
            let mut at = others.len() - handed;
            let left = at;
            sizes.extend(symbolic.children(node).iter().map(|&child| {
                let size = symbolic.below(child as usize).pow(2);
                at += size;
                (child as usize, at - size..at)
            }));
            let children = sizes.iter().map(|(child, range)| (*child, &others[range.clone()]));
            let panel = &mut values[symbolic.value_starts[node] - base..symbolic.value_starts[node + 1] - base];
            self.front(node, panel, &mut own[start..], children)?;
            others.truncate(left);
        }
        let [even, odd] = stacks;
        Ok(if symbolic.odd[last] { odd } else { even })
    }

    /// One front: its entries, what its children hand up, its factor, its own update.
    fn front<'a>(
        &self,
        node: usize,
        panel: &mut [f64],
        update: &mut [f64],
        children: impl Iterator<Item = (usize, &'a [f64])>,
    ) -> Outcome<()> {
        let symbolic = self.symbolic;
        let range = symbolic.columns(node);
        let (columns, below) = (range.len(), symbolic.below(node));
        let rows = columns + below;
        panel.fill(0.0);
        let mut few = [0.0; 64];
        let mut many = Vec::new();
        let floors = if columns <= few.len() {
            &mut few[..columns]
        } else {
            many.resize(columns, 0.0);
            &mut many[..]
        };
        for (column, (target, floor)) in range.clone().zip(panel.chunks_exact_mut(rows).zip(floors.iter_mut())) {
            let entries = symbolic.entry_starts[column]..symbolic.entry_starts[column + 1];
            for (&at, &value) in symbolic.targets[entries.clone()].iter().zip(&self.entries[entries]) {
                if at != NONE {
                    target[at as usize] = value;
                }
            }
            // A pivot that keeps no digit of its diagonal entry is no pivot.
            *floor = (2.0 * f64::EPSILON * target[column - range.start]).max(0.0);
        }
        for (child, handed) in children {
            add(symbolic.places(child), handed, panel, update, columns, below);
        }
        dense::factor(panel, rows, columns, floors, self.control).map_err(|refused| match refused {
            Refused::Pivot(column, value) => Refused::Pivot(range.start + column, value),
            stopped => stopped,
        })?;
        dense::update(update, panel, rows, columns);
        let work = columns as f64 * (columns as f64 * columns as f64 / 3.0 + rows as f64 * below as f64) + 20.0 * rows as f64;
        let before = self.done.fetch_add(work as u64, Ordering::Relaxed);
        self.control.report(((before as f64 + work) / self.total).min(1.0))?;
        Ok(())
    }
}

/// Adds a child's update (lower triangle) to its parent's front.
fn add(places: &[u32], handed: &[f64], panel: &mut [f64], update: &mut [f64], columns: usize, below: usize) {
    let size = places.len();
    let rows = columns + below;
    for (j, source) in handed.chunks_exact(size.max(1)).enumerate() {
        let column = places[j] as usize;
        let source = &source[j..];
        if column < columns {
            let target = &mut panel[column * rows..][..rows];
            for (&place, &value) in places[j..].iter().zip(source) {
                target[place as usize] += value;
            }
        } else {
            let target = &mut update[(column - columns) * below..][..below];
            for (&place, &value) in places[j..].iter().zip(source) {
                target[place as usize - columns] += value;
            }
        }
    }
}
