//! Conjugate gradients with an aggregation multigrid cycle: for matrices whose factor does not fit into memory.
//!
//! Unknowns are paired along their strongest couplings, twice a level (Notay 2010); each level is smoothed by a Chebyshev
//! polynomial, its correction improved by two steps of flexible conjugate gradients on the next one (the K-cycle, Notay and
//! Vassilevski 2008), and the coarsest is solved by Cholesky. Memory: about 1.5 times the matrix.

use super::{Cholesky, Scratch};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::{CHUNK, Csr, append_sums};
use rayon::prelude::*;

const COARSEST: usize = 60_000; // rows that are left to Cholesky
const STRONG: f64 = 0.25; // share of the strongest coupling that a pair needs
const DEGREE: usize = 3; // of the smoothing polynomial
const SMOOTHED: f64 = 6.0; // ratio of the ends of the spectrum that is smoothed
const MOST: usize = 500;

/// Solves `A x = b` for a sparse symmetric positive definite matrix, iteratively.
///
/// ```
/// use beltrami::{Control, Csr, solvers::Multilevel};
/// let a = Csr::new(2, 2, vec![0, 2, 4], vec![0, 1, 0, 1], vec![4.0, -2.0, -2.0, 5.0])?;
/// let solver = Multilevel::new(a, &Control::default())?;
/// let (x, residual) = solver.solve(&[2.0, 3.0], 1e-12, &Control::default())?;
/// assert!((x[0] - 1.0).abs() < 1e-14 && (x[1] - 1.0).abs() < 1e-14 && residual < 1e-12);
/// # Ok::<(), beltrami::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Multilevel {
    levels: Vec<Level>,
    coarsest: Cholesky,
    rows: usize,
}

#[derive(Debug, Clone)]
struct Level {
    matrix: Csr,
    inverse: Vec<f64>, // of the diagonal
    bound: f64,        // of the eigenvalues of the matrix over its diagonal
    parents: Vec<u32>,
    members: Vec<u32>, // fine unknowns by coarse one
    starts: Vec<u32>,
}

impl Multilevel {
    /// Makes the levels.
    ///
    /// # Errors
    /// [`Error::Input`] if the matrix is not square; [`Error::Numerical`] naming the row if a diagonal entry is not positive, or
    /// if the coarsest matrix is not positive definite; [`Error::Cancelled`] on request.
    pub fn new(matrix: Csr, control: &Control) -> Result<Self> {
        let rows = matrix.rows();
        if matrix.columns() != rows {
            return Err(Error::input(format!("a matrix of {rows} rows and {} columns is not square", matrix.columns())));
        }
        let (mut levels, mut matrix) = (Vec::new(), matrix);
        while matrix.rows() > COARSEST {
            let (first, count) = pairs(&matrix, control)?;
            let half = collapsed(&matrix, &first, count, control)?;
            let (second, count) = pairs(&half, control)?;
            if count > matrix.rows() / 4 * 3 {
                break; // nothing couples the unknowns
            }
            let coarse = collapsed(&half, &second, count, control)?;
            let parents: Vec<u32> = first.iter().map(|&pair| second[pair as usize]).collect();
            levels.push(Level::new(std::mem::replace(&mut matrix, coarse), parents, count)?);
            control.report(1.0 - 1.0 / (levels.len() + 1) as f64)?;
        }
        Ok(Multilevel { levels, coarsest: Cholesky::new(&matrix, None, control)?, rows })
    }

    /// The solution and its relative residual `|b - A x| / |b|`, at most `tolerance` or what rounding allows.
    ///
    /// # Errors
    /// [`Error::Input`] if b does not fit or is not finite; [`Error::NotConverged`]; [`Error::Cancelled`] on request.
    pub fn solve(&self, b: &[f64], tolerance: f64, control: &Control) -> Result<(Vec<f64>, f64)> {
        if b.len() != self.rows {
            return Err(Error::input(format!("b has {} numbers, the matrix {} rows", b.len(), self.rows)));
        }
        let largest = b.iter().fold(0.0, |largest: f64, number| largest.max(number.abs()));
        if !largest.is_finite() || b.iter().any(|number| number.is_nan()) {
            return Err(Error::input("b has entries that are not finite"));
        }
        if largest == 0.0 {
            return Ok((vec![0.0; b.len()], 0.0));
        }
        let Some(level) = self.levels.first() else {
            let mut x = vec![0.0; b.len()];
            self.coarsest.solve_block_into(b, 1, &mut x, &mut Scratch::refining())?;
            let residual = self.coarsest.residuals(b, &x, 1)?[0];
            return Ok((x, residual));
        };
        let b: Vec<f64> = b.par_iter().map(|number| number / largest).collect(); // no overflow of squares
        let goal = dot(&b, &b).sqrt();
        let (mut x, mut rest, mut direction) = (vec![0.0; b.len()], b.clone(), Vec::new());
        let (mut before, mut old_rest): (f64, Vec<f64>) = (0.0, Vec::new());
        for _ in 0..MOST {
            let better = self.cycle(0, &rest, control)?;
            let along = dot(&rest, &better);
            if direction.is_empty() {
                direction = better;
            } else {
                let turn = (along - dot(&old_rest, &better)) / before;
                direction.par_iter_mut().zip(&better).for_each(|(direction, better)| *direction = better + turn * *direction);
            }
            let image = level.matrix.multiply(&direction)?;
            let step = along / dot(&direction, &image);
            if !(along > 0.0 && step.is_finite()) {
                return Err(Error::numerical(
                    "the matrix is not positive definite, or too badly scaled for an iteration; factor it instead",
                ));
            }
            add(&mut x, step, &direction);
            (old_rest, before) = (rest.clone(), along);
            add(&mut rest, -step, &image);
            let size = dot(&rest, &rest).sqrt();
            control.report((size / goal).ln() / tolerance.max(1e-16).ln())?;
            // What rounding leaves in b - A x, by the size of its terms.
            let floor = || {
                let terms = |(x, inverse): (&f64, &f64)| (x / inverse).powi(2);
                4.0 * f64::EPSILON * x.par_iter().zip(&level.inverse).map(terms).collect::<Vec<f64>>().iter().sum::<f64>().sqrt()
            };
            if size <= tolerance * goal || size <= floor() {
                rest = b.clone();
                add(&mut rest, -1.0, &level.matrix.multiply(&x)?);
                let size = dot(&rest, &rest).sqrt();
                if size <= tolerance * goal || size <= 4.0 * floor() {
                    x.par_iter_mut().for_each(|x| *x *= largest);
                    return Ok((x, size / goal));
                }
                direction = Vec::new();
            }
        }
        Err(Error::NotConverged(format!(
            "{MOST} iterations reached a relative residual of {:.1e}, {tolerance:.1e} was asked for; factor the matrix instead, or use \
             an intrinsic Delaunay Laplacian",
            dot(&rest, &rest).sqrt() / goal
        )))
    }

    /// About A^-1 r.
    fn cycle(&self, at: usize, right: &[f64], control: &Control) -> Result<Vec<f64>> {
        control.check()?;
        let Some(level) = self.levels.get(at) else {
            let mut x = vec![0.0; right.len()];
            self.coarsest.solve_block_into(right, 1, &mut x, &mut Scratch::default())?;
            return Ok(x);
        };
        let mut rest = right.to_vec();
        let mut x = vec![0.0; right.len()];
        level.smooth(&mut x, &mut rest)?;
        let correction = self.improved(at + 1, &level.restricted(&rest), control)?;
        x.par_iter_mut().zip(&level.parents).for_each(|(x, &parent)| *x += correction[parent as usize]);
        let image = level.matrix.multiply(&x)?;
        rest.par_iter_mut().zip(right.par_iter().zip(&image)).for_each(|(rest, (right, image))| *rest = right - image);
        level.smooth(&mut x, &mut rest)?;
        Ok(x)
    }

    /// At most two steps of flexible conjugate gradients around a cycle.
    fn improved(&self, at: usize, right: &[f64], control: &Control) -> Result<Vec<f64>> {
        let mut first = self.cycle(at, right, control)?;
        let Some(level) = self.levels.get(at) else { return Ok(first) };
        let image = level.matrix.multiply(&first)?;
        let (size, along) = (dot(&first, &image), dot(&first, right));
        if !(size > 0.0) {
            return Ok(first);
        }
        let mut rest = right.to_vec();
        add(&mut rest, -along / size, &image);
        if dot(&rest, &rest) <= 0.0625 * dot(right, right) {
            first.par_iter_mut().for_each(|x| *x *= along / size);
            return Ok(first);
        }
        let second = self.cycle(at, &rest, control)?;
        let second_image = level.matrix.multiply(&second)?;
        let (mixed, second_along) = (dot(&second, &image), dot(&second, &rest));
        let second_size = dot(&second, &second_image) - mixed * mixed / size;
        let share = if second_size > 0.0 { second_along / second_size } else { 0.0 };
        let own = (along - mixed * share) / size;
        first.par_iter_mut().zip(&second).for_each(|(x, second)| *x = own * *x + share * second);
        Ok(first)
    }
}

impl Level {
    fn new(matrix: Csr, parents: Vec<u32>, count: usize) -> Result<Self> {
        let diagonal = matrix.diagonal();
        if let Some(row) = diagonal.iter().position(|entry| !(*entry > 0.0)) {
            return Err(Error::numerical(format!("the matrix is not positive definite: diagonal entry {row} is {}", diagonal[row])));
        }
        let inverse: Vec<f64> = diagonal.iter().map(|entry| 1.0 / entry).collect();
        let bounds: Vec<f64> = (0..matrix.rows())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|row| inverse[row] * matrix.row(row).1.iter().map(|value| value.abs()).sum::<f64>())
            .collect();
        let bound = bounds.into_iter().fold(1.0, f64::max); // Gershgorin
        let mut starts = vec![0u32; count + 1];
        parents.iter().for_each(|&parent| starts[parent as usize + 1] += 1);
        for at in 0..count {
            starts[at + 1] += starts[at];
        }
        let (mut next, mut members) = (starts.clone(), vec![0u32; parents.len()]);
        for (fine, &parent) in parents.iter().enumerate() {
            members[next[parent as usize] as usize] = fine as u32;
            next[parent as usize] += 1;
        }
        Ok(Level { matrix, inverse, bound, parents, members, starts })
    }

    /// Adds a Chebyshev polynomial's correction to x and keeps the residual up to date.
    fn smooth(&self, x: &mut [f64], rest: &mut [f64]) -> Result<()> {
        let (high, low) = (self.bound, self.bound / SMOOTHED);
        let (middle, radius) = (0.5 * (high + low), 0.5 * (high - low));
        let mut ratio = radius / middle;
        let mut step: Vec<f64> = rest.par_iter().zip(&self.inverse).map(|(rest, inverse)| rest * inverse / middle).collect();
        for degree in 1..=DEGREE {
            let image = self.matrix.multiply(&step)?;
            x.par_iter_mut().zip(&step).for_each(|(x, step)| *x += step);
            add(rest, -1.0, &image);
            if degree < DEGREE {
                let next = 1.0 / (2.0 * middle / radius - ratio);
                let (old, new) = (next * ratio, 2.0 * next / radius);
                step.par_iter_mut()
                    .zip(rest.par_iter().zip(&self.inverse))
                    .for_each(|(step, (rest, inverse))| *step = old * *step + new * inverse * rest);
                ratio = next;
            }
        }
        Ok(())
    }

    fn restricted(&self, rest: &[f64]) -> Vec<f64> {
        self.starts
            .par_windows(2)
            .with_min_len(CHUNK)
            .map(|range| self.members[range[0] as usize..range[1] as usize].iter().map(|&fine| rest[fine as usize]).sum())
            .collect()
    }
}

/// y += a x.
fn add(y: &mut [f64], a: f64, x: &[f64]) {
    y.par_iter_mut().with_min_len(CHUNK).zip(x).for_each(|(y, x)| *y += a * x);
}

fn dot(x: &[f64], y: &[f64]) -> f64 {
    let parts: Vec<f64> = x.par_chunks(CHUNK).zip(y.par_chunks(CHUNK)).map(|(x, y)| x.iter().zip(y).map(|(x, y)| x * y).sum()).collect();
    parts.iter().sum()
}

/// Pairs of unknowns along strong negative couplings, in the order of the rows; each one's pair, and their number.
fn pairs(matrix: &Csr, control: &Control) -> Result<(Vec<u32>, usize)> {
    let mut pair = vec![u32::MAX; matrix.rows()];
    let mut count = 0;
    for row in 0..matrix.rows() {
        if row % (1 << 18) == 0 {
            control.check()?;
        }
        if pair[row] != u32::MAX {
            continue;
        }
        let (columns, values) = matrix.row(row);
        let (mut strongest, mut best, mut other) = (0.0, 0.0, None);
        for (&column, &value) in columns.iter().zip(values).filter(|&(&column, _)| column as usize != row) {
            strongest = f64::max(strongest, -value);
            if -value > best && pair[column as usize] == u32::MAX {
                (best, other) = (-value, Some(column as usize));
            }
        }
        pair[row] = count;
        if let Some(other) = other.filter(|_| best > STRONG * strongest) {
            pair[other] = count;
        }
        count += 1;
    }
    Ok((pair, count as usize))
}

/// P^T A P, where P adds up the members of each group.
fn collapsed(matrix: &Csr, group: &[u32], count: usize, control: &Control) -> Result<Csr> {
    let mut starts = vec![0usize; count + 1];
    group.iter().for_each(|&group| starts[group as usize + 1] += 1);
    for at in 0..count {
        starts[at + 1] += starts[at];
    }
    let (mut next, mut members) = (starts.clone(), vec![0u32; group.len()]);
    for (fine, &group) in group.iter().enumerate() {
        members[next[group as usize]] = fine as u32;
        next[group as usize] += 1;
    }
    control.check()?;
    Ok(Csr::by_rows(count, count, |row, entries: &mut Vec<(u32, f64)>, indices, values| {
        entries.clear();
        for &fine in &members[starts[row]..starts[row + 1]] {
            let (columns, numbers) = matrix.row(fine as usize);
            entries.extend(columns.iter().zip(numbers).map(|(&column, &number)| (group[column as usize], number)));
        }
        entries.sort_by_key(|entry| entry.0); // stable: sums are grouped alike
        append_sums(entries.iter().copied(), indices, values);
    }))
}
