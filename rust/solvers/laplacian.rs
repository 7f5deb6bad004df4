//! Solving with a stiffness matrix whose kernel holds the constants of each component.

use super::cholesky::{Cholesky, Scratch};
use super::multilevel::Multilevel;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::Csr;

/// Solves `L u = b` for a positive semidefinite stiffness matrix L whose rows add up to zero.
///
/// Each component of L has its own constants. `b` is first made compatible (the mean of b / m is taken off on each component), and of
/// all solutions the one with mean zero on each component is returned, means weighted by the mass. One unknown of each
/// component is grounded (its diagonal entry is doubled); for a compatible `b` that changes nothing but the constant.
///
/// ```
/// use beltrami::{Control, Csr, solvers::LaplacianSolver};
/// let l = Csr::new(2, 2, vec![0, 2, 4], vec![0, 1, 0, 1], vec![1.0, -1.0, -1.0, 1.0])?;
/// let solver = LaplacianSolver::new(&l, &[1.0, 1.0], None, &Control::default())?;
/// let u = solver.solve(&[1.0, -1.0], 1, &Control::default())?;
/// assert!((u[0] - 0.5).abs() < 1e-15 && (u[1] + 0.5).abs() < 1e-15);
/// # Ok::<(), beltrami::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct LaplacianSolver {
    engine: Engine,
    labels: Vec<u32>,
    mass: Vec<f64>,
    totals: Vec<f64>,
}

#[derive(Debug, Clone)]
enum Engine {
    Direct(Cholesky),
    Multilevel(Multilevel, f64),
}

/// How a [`LaplacianSolver`] solves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Method {
    /// By a Cholesky factor.
    Direct,
    /// By multilevel iterations down to this relative residual: a fraction of the memory.
    Multilevel(f64),
}

impl LaplacianSolver {
    /// Factors a stiffness matrix; `mass` has a number for each row that is not negative, `coordinates` as in [`Cholesky::new`].
    ///
    /// # Errors
    /// [`Error::Input`] if a mass is negative, sizes do not fit, or a row does not add up to zero; [`Error::Numerical`] if the
    /// matrix is not positive semidefinite; [`Error::Cancelled`] on request.
    pub fn new(stiffness: &Csr, mass: &[f64], coordinates: Option<(&[f64], usize)>, control: &Control) -> Result<Self> {
        Self::with_method(stiffness, mass, coordinates, Method::Direct, control)
    }

    /// The same with a choice of how it solves; the coordinates serve the direct method only.
    ///
    /// # Errors
    /// As [`LaplacianSolver::new`].
    pub fn with_method(
        stiffness: &Csr,
        mass: &[f64],
        coordinates: Option<(&[f64], usize)>,
        method: Method,
        control: &Control,
    ) -> Result<Self> {
        let n = stiffness.rows();
        if stiffness.columns() != n || mass.len() != n {
            return Err(Error::input(format!(
                "a stiffness matrix of {n} x {} and {} masses do not fit; give a square matrix and a mass a row",
                stiffness.columns(),
                mass.len()
            )));
        }
        if let Some(row) = mass.iter().position(|mass| !(*mass >= 0.0 && mass.is_finite())) {
            return Err(Error::input(format!("the mass of row {row} is {}; masses must be finite and not negative", mass[row])));
        }
        for row in 0..n {
            let values = stiffness.row(row).1;
            let (sum, size) = values.iter().fold((0.0, 0.0), |(sum, size), value| (sum + value, size + value.abs()));
            if sum.abs() > 1e-8 * size {
                return Err(Error::input(format!(
                    "row {row} of the stiffness matrix adds up to {sum:e} and not to zero, so constants are not its kernel; use Cholesky"
                )));
            }
        }
        let (labels, pins) = components(stiffness)?;
        let grounded = grounded(stiffness, &pins);
        let engine = match method {
            Method::Direct => Engine::Direct(Cholesky::new(&grounded, coordinates, control)?),
            Method::Multilevel(tolerance) => Engine::Multilevel(Multilevel::new(grounded, control)?, tolerance),
        };
        let mut totals = vec![0.0; pins.len()];
        labels.iter().zip(mass).for_each(|(&label, mass)| totals[label as usize] += mass);
        Ok(LaplacianSolver { engine, labels, mass: mass.to_vec(), totals })
    }

    /// Number of components.
    pub fn components(&self) -> usize {
        self.totals.len()
    }

    /// The component of each unknown, numbered in the order of their first unknowns.
    pub fn labels(&self) -> &[u32] {
        &self.labels
    }

    /// Solves for `width` right-hand sides side by side, each made compatible first.
    ///
    /// # Errors
    /// As [`Cholesky::solve`] or [`Multilevel::solve`].
    pub fn solve(&self, b: &[f64], width: usize, control: &Control) -> Result<Vec<f64>> {
        let mut right = b.to_vec();
        if Some(b.len()) == self.labels.len().checked_mul(width) && width > 0 {
            let excess = self.sums(&right, width, |_| 1.0);
            self.take(&mut right, width, &excess, |mass| mass);
        }
        let mut out = vec![0.0; b.len()];
        match &self.engine {
            Engine::Direct(factor) => factor.solve_block_into(&right, width, &mut out, &mut Scratch::refining())?,
            Engine::Multilevel(solver, tolerance) => {
                for column in 0..width {
                    let one: Vec<f64> = right.iter().skip(column).step_by(width).copied().collect();
                    let (found, _) = solver.solve(&one, *tolerance, control)?;
                    out.iter_mut().skip(column).step_by(width).zip(found).for_each(|(out, found)| *out = found);
                }
            }
        }
        if width > 0 {
            let means = self.sums(&out, width, |mass| mass);
            self.take(&mut out, width, &means, |_| 1.0);
        }
        if let Some(at) = out.iter().position(|number| !number.is_finite()) {
            return Err(Error::numerical(format!(
                "the solution overflows in row {}; scale the right-hand side or the shape down",
                at / width.max(1)
            )));
        }
        Ok(out)
    }

    /// The same for right-hand sides that must be compatible already: refused if a component's sum is above `tolerance` times
    /// the sum of its entries' sizes.
    ///
    /// # Errors
    /// [`Error::Input`] naming the component; else as [`LaplacianSolver::solve`].
    pub fn solve_compatible(&self, b: &[f64], width: usize, tolerance: f64, control: &Control) -> Result<Vec<f64>> {
        if Some(b.len()) == self.labels.len().checked_mul(width) && width > 0 {
            let sums = self.sums(b, width, |_| 1.0);
            let sizes: Vec<f64> = b.iter().map(|number| number.abs()).collect();
            let sizes = self.sums(&sizes, width, |_| 1.0);
            if let Some(at) = sums.iter().zip(&sizes).position(|(sum, size)| sum.abs() > tolerance * size) {
                let component = at / width;
                let first = self.labels.iter().position(|&label| label as usize == component).unwrap_or(0);
                return Err(Error::input(format!(
                    "right-hand side {} adds up to {:e} on component {component} (that of row {first}), so there is no solution; take its mean off first",
                    at % width,
                    sums[at]
                )));
            }
        }
        self.solve(b, width, control)
    }

    /// Sums over each component: `sums[component * width + k]`.
    fn sums(&self, numbers: &[f64], width: usize, weight: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut sums = vec![0.0; self.totals.len() * width];
        for ((row, &label), &mass) in numbers.chunks_exact(width).zip(&self.labels).zip(&self.mass) {
            let weight = weight(mass);
            let sums = &mut sums[label as usize * width..][..width];
            sums.iter_mut().zip(row).for_each(|(sum, number)| *sum += weight * number);
        }
        sums
    }

    /// Takes `sums / total mass`, times a weight, off each row.
    fn take(&self, numbers: &mut [f64], width: usize, sums: &[f64], weight: impl Fn(f64) -> f64) {
        for ((row, &label), &mass) in numbers.chunks_exact_mut(width).zip(&self.labels).zip(&self.mass) {
            let total = self.totals[label as usize];
            let factor = if total > 0.0 { weight(mass) / total } else { 0.0 };
            let sums = &sums[label as usize * width..][..width];
            row.iter_mut().zip(sums).for_each(|(number, sum)| *number -= factor * sum);
        }
    }
}

/// The component of each row by entries that are not zero, and the row of each with the largest diagonal entry.
fn components(matrix: &Csr) -> Result<(Vec<u32>, Vec<usize>)> {
    let n = matrix.rows();
    let mut labels = vec![u32::MAX; n];
    let mut pins = Vec::new();
    let mut open = Vec::new();
    let diagonal = matrix.diagonal();
    for first in 0..n {
        if labels[first] != u32::MAX {
            continue;
        }
        let label = pins.len() as u32;
        let mut pin = first;
        labels[first] = label;
        open.push(first);
        while let Some(row) = open.pop() {
            if diagonal[row] > diagonal[pin] || (diagonal[row] == diagonal[pin] && row < pin) {
                pin = row;
            }
            let (columns, values) = matrix.row(row);
            for (&column, &value) in columns.iter().zip(values) {
                let column = column as usize;
                if column >= n {
                    return Err(Error::input(format!("entry ({row}, {column}) is outside a matrix of {n} rows")));
                }
                if value != 0.0 && labels[column] == u32::MAX {
                    labels[column] = label;
                    open.push(column);
                }
            }
        }
        pins.push(pin);
    }
    Ok((labels, pins))
}

/// The matrix with the diagonal entries of some rows doubled (1 where there is none).
fn grounded(matrix: &Csr, pins: &[usize]) -> Csr {
    let n = matrix.rows();
    let mut pinned = vec![false; n];
    pins.iter().for_each(|&pin| pinned[pin] = true);
    let (mut starts, mut indices, mut values) =
        (vec![0], Vec::with_capacity(matrix.indices().len()), Vec::with_capacity(matrix.indices().len()));
    for (row, &pinned) in pinned.iter().enumerate() {
        let (columns, numbers) = matrix.row(row);
        let at = columns.partition_point(|&column| (column as usize) < row);
        let own = columns.get(at).filter(|&&column| column as usize == row).map(|_| numbers[at]);
        indices.extend_from_slice(&columns[..at]);
        values.extend_from_slice(&numbers[..at]);
        if own.is_some() || pinned {
            let own = own.unwrap_or(0.0);
            indices.push(row as u32);
            values.push(if !pinned {
                own
            } else if own > 0.0 {
                2.0 * own
            } else {
                own + 1.0
            });
        }
        let rest = at + usize::from(own.is_some());
        indices.extend_from_slice(&columns[rest..]);
        values.extend_from_slice(&numbers[rest..]);
        starts.push(indices.len());
    }
    Csr::trusted(n, n, starts, indices, values)
}
