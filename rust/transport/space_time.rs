//! The space-time Poisson equation of the projection on the continuity equation (8.23-8.25).

use super::Domain;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::solvers::{Cholesky, Scratch};
use crate::sparse::Csr;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::sync::Mutex;

/// Whether the last density is given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ends {
    /// Both densities are given.
    Fixed,
    /// Only the first one is, and the last one weighs so many times as much as those between, at least as much: a weight as large as
    /// the number of intervals makes costs of the end as easy to reach as those of a unit of time.
    Free(f64),
}

/// How freely densities and momenta move: the inverse of the metric in which the projection is orthogonal. Large where there is
/// mass, so that what is missing is brought from there; all ones for the plain projection.
#[derive(Debug, Clone, PartialEq)]
pub struct Mobility {
    /// Of the density at each node.
    pub nodes: Vec<f64>,
    /// Of the momentum on each element.
    pub elements: Vec<f64>,
}

impl Mobility {
    /// The same everywhere.
    ///
    /// ```
    /// assert_eq!(beltrami::transport::Mobility::uniform(3, 1).nodes, [1.0; 3]);
    /// ```
    pub fn uniform(nodes: usize, elements: usize) -> Self {
        Mobility { nodes: vec![1.0; nodes], elements: vec![1.0; elements] }
    }
}

const ITERATIONS: usize = 400;
const TOLERANCE: f64 = 1e-13;

/// Solves `(n^2 T ⊗ diag(r m) + I ⊗ L) ψ = b` over n intervals, T the second difference in time, r the nodes' mobility and L the
/// stiffness with the elements' mobility.
///
/// T is diagonalized by cosines, for given and for free ends, and each mode has a sparse factor of `λ diag(r m) + L`; all share one
/// analysis and are made and used in parallel. Where that many factors do not fit into the memory allowed, modes share factors:
/// each of the others is solved by conjugate gradients, preconditioned by the factor of the mode nearest to it, which bounds the
/// condition number by the ratio of their two λ.
#[derive(Debug)]
pub struct SpaceTime {
    intervals: usize,
    nodes: usize,
    /// `modes[q * n + k]`: orthonormal rows.
    modes: Vec<f64>,
    shifts: Vec<f64>,
    factors: Vec<Cholesky>,
    /// Which factor a mode uses, and whether it is its own.
    uses: Vec<(usize, bool)>,
    singular: bool,
    /// Nodal masses times mobilities.
    mass: Vec<f64>,
    stiffness: Csr,
    scratch: Mutex<Vec<Scratch>>,
}

impl SpaceTime {
    /// Factors the modes of `intervals` intervals; `memory` in bytes is what the factors may take (two are kept at least).
    ///
    /// ```
    /// # use beltrami::{Control, shrink::Elements, transport::Domain};
    /// # let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1, masses 1/2
    /// # let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// use beltrami::transport::{Ends, Mobility, SpaceTime};
    /// let solver = SpaceTime::new(&domain, 4, Ends::Free(4.0), &Mobility::uniform(2, 1), 1e9, &Control::default())?;
    /// assert_eq!((solver.intervals(), solver.factors()), (4, 4));
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] for no intervals or a mobility that is not positive; [`Error::Numerical`] if a factor breaks down; [`Error::Cancelled`].
    pub fn new(domain: &Domain, intervals: usize, ends: Ends, mobility: &Mobility, memory: f64, control: &Control) -> Result<Self> {
        if intervals == 0 {
            return Err(Error::input("there are no intervals; at least one is needed".to_string()));
        }
        domain.expect("the mobility of densities", mobility.nodes.len(), domain.nodes())?;
        domain.expect("the mobility of momenta", mobility.elements.len(), domain.count())?;
        if let Some(bad) = mobility.nodes.iter().chain(&mobility.elements).find(|x| !(**x > 0.0 && x.is_finite())) {
            return Err(Error::input(format!("a mobility is {bad}; mobilities must be positive")));
        }
        // cos(θ (k + 1/2)) satisfies the equation inside and at the start; at the end it must be `kept` times its last value.
        let (n, kept) = match ends {
            Ends::Fixed => (intervals as f64, 1.0),
            Ends::Free(weight) if weight >= 1.0 && weight.is_finite() => (intervals as f64, 1.0 - 1.0 / weight),
            Ends::Free(weight) => return Err(Error::input(format!("the last slice weighs {weight}; it must weigh at least 1"))),
        };
        let (mut modes, mut shifts) = (Vec::with_capacity(intervals * intervals), Vec::with_capacity(intervals));
        for q in 0..intervals {
            // between the modes of given ends and those of an end of weight 1
            let (mut low, mut high) = (PI * q as f64 / n, PI * (2 * q + 1) as f64 / (2.0 * n + 1.0));
            if ends == Ends::Fixed {
                high = low;
            }
            let sign = if q % 2 == 0 { 1.0 } else { -1.0 };
            for _ in 0..80 {
                let middle = 0.5 * (low + high);
                let value = (middle * (n + 0.5)).cos() - kept * (middle * (n - 0.5)).cos();
                if sign * value > 0.0 {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            let angle = if ends == Ends::Fixed { PI * q as f64 / n } else { high };
            let row: Vec<f64> = (0..intervals).map(|k| (angle * (k as f64 + 0.5)).cos()).collect();
            let norm = row.iter().map(|x| x * x).sum::<f64>().sqrt();
            modes.extend(row.iter().map(|x| x / norm));
            shifts.push(4.0 * n * n * (0.5 * angle).sin().powi(2));
        }
        let conductivity = |element: usize| mobility.elements[element];
        let stiffness = domain.stiffness(conductivity, false);
        let shifted = |(&mass, &r): (&f64, &f64)| if mass > 0.0 { mass * r } else { 1.0 };
        let mass: Vec<f64> = domain.mass.iter().zip(&mobility.nodes).map(shifted).collect();
        let singular = ends == Ends::Fixed;
        let size = 8.0 * (domain.symbolic.nnz() + stiffness.values().len()) as f64;
        let most = ((memory / size.max(1.0)) as usize).clamp(2.min(intervals), intervals);
        let own = chosen(&shifts, most, singular);
        let mut factors = Vec::new();
        for some in own.chunks(16) {
            let made: Result<Vec<Cholesky>> = some
                .par_iter()
                .with_max_len(1)
                .map(|&q| {
                    let matrix = if q == 0 && singular {
                        domain.stiffness(conductivity, true)
                    } else {
                        let mut values = stiffness.values().to_vec();
                        for (node, &mass) in mass.iter().enumerate() {
                            values[domain.diagonal(node)] += shifts[q] * mass;
                        }
                        Csr::trusted(
                            stiffness.rows(),
                            stiffness.columns(),
                            stiffness.starts().to_vec(),
                            stiffness.indices().to_vec(),
                            values,
                        )
                    };
                    Cholesky::with_symbolic(&domain.symbolic, &matrix, control)
                })
                .collect();
            factors.extend(made?);
            control.report(factors.len() as f64 / own.len() as f64)?;
        }
        let uses = (0..intervals)
            .map(|q| match own.iter().position(|&other| other == q) {
                Some(at) => (at, true),
                None => {
                    let distance = |other: usize| (shifts[other] / shifts[q]).ln().abs();
                    let candidates = own.iter().enumerate().filter(|&(_, &other)| other > 0 || !singular);
                    let nearest = candidates.min_by(|a, b| distance(*a.1).total_cmp(&distance(*b.1)));
                    (nearest.map_or(0, |(at, _)| at), false)
                }
            })
            .collect();
        Ok(SpaceTime {
            intervals,
            nodes: domain.nodes(),
            modes,
            shifts,
            factors,
            uses,
            singular,
            mass,
            stiffness,
            scratch: Mutex::default(),
        })
    }

    /// Number of intervals.
    pub fn intervals(&self) -> usize {
        self.intervals
    }

    /// Number of factors that are kept.
    pub fn factors(&self) -> usize {
        self.factors.len()
    }

    /// ψ for a right-hand side of integrals, (intervals, nodes). For fixed ends, what of it is constant in space and time is ignored, and ψ
    /// is determined up to such a constant on each component.
    ///
    /// ```
    /// # use beltrami::{Control, shrink::Elements, transport::Domain};
    /// # let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1, masses 1/2
    /// # let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// use beltrami::transport::{Ends, Mobility, SpaceTime};
    /// let solver = SpaceTime::new(&domain, 1, Ends::Fixed, &Mobility::uniform(2, 1), 1e9, &Control::default())?;
    /// let mut psi = [0.0; 2];
    /// solver.solve(&domain, &[-1.0, 1.0], &mut psi, &Control::default())?;
    /// assert!((psi[1] - psi[0] - 1.0).abs() < 1e-14);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit or a number is not finite; [`Error::Numerical`] on overflow.
    pub fn solve(&self, domain: &Domain, b: &[f64], out: &mut [f64], control: &Control) -> Result<()> {
        let (n, nodes) = (self.intervals, self.nodes);
        domain.expect("the right-hand side", b.len(), n * nodes)?;
        domain.expect("the potential", out.len(), b.len())?;
        if domain.nodes() != nodes {
            return Err(Error::input(format!("made for {nodes} nodes, called with a domain of {}", domain.nodes())));
        }
        if nodes == 0 {
            return Ok(());
        }
        let mut spectral = vec![0.0; b.len()];
        mix(&mut spectral, b, nodes, |q, k| self.modes[q * n + k]);
        spectral.par_chunks_mut(nodes).enumerate().with_max_len(1).try_for_each(|(q, b)| {
            control.check()?;
            if q == 0 && self.singular {
                domain.make_compatible(b);
            }
            let mut scratch = self.scratch.lock().map_or_else(|e| e.into_inner().pop(), |mut kept| kept.pop()).unwrap_or_default();
            let mut x = vec![0.0; nodes];
            let (at, own) = self.uses[q];
            let outcome = if own {
                scratch.refine = q == 0 && self.singular;
                self.factors[at].solve_block_into(b, 1, &mut x, &mut scratch)
            } else {
                self.conjugate_gradients(q, &self.factors[at], b, &mut x, &mut scratch)
            };
            if let Ok(mut kept) = self.scratch.lock() {
                kept.push(scratch);
            }
            b.copy_from_slice(&x);
            outcome
        })?;
        mix(out, &spectral, nodes, |k, q| self.modes[q * n + k]);
        Ok(())
    }

    fn conjugate_gradients(&self, q: usize, factor: &Cholesky, b: &[f64], x: &mut [f64], scratch: &mut Scratch) -> Result<()> {
        let apply = |x: &[f64]| -> Result<Vec<f64>> {
            let mut y = self.stiffness.multiply(x)?;
            for ((y, x), &mass) in y.iter_mut().zip(x).zip(&self.mass) {
                *y += self.shifts[q] * mass * x;
            }
            Ok(y)
        };
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        scratch.refine = false;
        let (mut r, mut z) = (b.to_vec(), vec![0.0; b.len()]);
        let target = TOLERANCE * dot(b, b).sqrt();
        x.fill(0.0);
        if target == 0.0 {
            return Ok(());
        }
        factor.solve_block_into(&r, 1, &mut z, scratch)?;
        let (mut p, mut rz) = (z.clone(), dot(&r, &z));
        for _ in 0..ITERATIONS {
            let ap = apply(&p)?;
            let length = rz / dot(&p, &ap);
            x.iter_mut().zip(&p).for_each(|(x, p)| *x += length * p);
            r.iter_mut().zip(&ap).for_each(|(r, ap)| *r -= length * ap);
            if dot(&r, &r).sqrt() <= target {
                return Ok(());
            }
            factor.solve_block_into(&r, 1, &mut z, scratch)?;
            let next = dot(&r, &z);
            p.iter_mut().zip(&z).for_each(|(p, z)| *p = z + next / rz * *p);
            rz = next;
        }
        Ok(()) // stagnated at rounding: the caller looks at the residual of what it hands out
    }
}

/// Which modes get a factor: all, or the singular one and others spread evenly in the logarithm of their shifts.
fn chosen(shifts: &[f64], most: usize, singular: bool) -> Vec<usize> {
    let n = shifts.len();
    if most >= n {
        return (0..n).collect();
    }
    let first = usize::from(singular);
    let (low, high) = (shifts[first].ln(), shifts[n - 1].ln());
    let count = most - first;
    let mut own: Vec<usize> = (0..first).collect();
    for at in 0..count {
        let wanted = low + (high - low) * (at as f64 + 0.5) / count as f64;
        let nearest = (first..n).min_by(|&a, &b| (shifts[a].ln() - wanted).abs().total_cmp(&(shifts[b].ln() - wanted).abs()));
        own.extend(nearest);
    }
    own.sort_unstable();
    own.dedup();
    own
}

/// `out[i] = Σ_j c(i, j) in[j]` for slices of `nodes` numbers.
fn mix(out: &mut [f64], slices: &[f64], nodes: usize, c: impl Fn(usize, usize) -> f64 + Sync) {
    const BLOCK: usize = 512;
    let count = slices.len() / nodes;
    out.par_chunks_mut(nodes).enumerate().for_each(|(i, out)| {
        out.fill(0.0);
        for (block, out) in out.chunks_mut(BLOCK).enumerate() {
            let size = out.len();
            let part = |j: usize| &slices[j * nodes + block * BLOCK..][..size];
            let mut j = 0;
            while j + 4 <= count {
                let (c0, c1, c2, c3) = (c(i, j), c(i, j + 1), c(i, j + 2), c(i, j + 3));
                let (p, q, r, s) = (part(j), part(j + 1), part(j + 2), part(j + 3));
                let rows = out.iter().zip(p).zip(q).zip(r).zip(s);
                let sums: Vec<f64> = rows.map(|((((out, p), q), r), s)| out + ((c0 * p + c1 * q) + (c2 * r + c3 * s))).collect();
                out.copy_from_slice(&sums);
                j += 4;
            }
            while j < count {
                let (factor, source) = (c(i, j), part(j));
                out.iter_mut().zip(source).for_each(|(out, x)| *out += factor * x);
                j += 1;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shrink::Elements;

    fn square() -> Domain {
        // two triangles of the unit square: hat gradients of the second and third corners
        let hats = vec![1.0, -1.0, 0.0, 1.0, 1.0, 0.0, -1.0, 1.0];
        let elements = Elements::new(4, 3, vec![0, 1, 2, 0, 2, 3], hats, vec![0.5, 0.5]).unwrap();
        Domain::new(elements, vec![1.0 / 3.0, 1.0 / 6.0, 1.0 / 3.0, 1.0 / 6.0], None, &Control::default()).unwrap()
    }

    /// The answer satisfies the difference equation, with as few factors as may be, too.
    #[test]
    fn solves_the_difference_equation() {
        let domain = square();
        let mobility = Mobility { nodes: vec![1.0, 0.4, 2.0, 1.3], elements: vec![0.7, 0.05] };
        for ends in [Ends::Fixed, Ends::Free(1.0), Ends::Free(7.5)] {
            for memory in [1e9, 0.0] {
                let (n, nodes) = (7, 4);
                let solver = SpaceTime::new(&domain, n, ends, &mobility, memory, &Control::default()).unwrap();
                assert_eq!(solver.factors(), if memory > 0.0 { n } else { 2 });
                let mut b: Vec<f64> = (0..n * nodes).map(|k| ((k * k) as f64 * 0.37).sin()).collect();
                let mean = b.iter().sum::<f64>() / domain.mass.iter().sum::<f64>() / n as f64;
                if ends == Ends::Fixed {
                    b.iter_mut().zip(domain.mass.iter().cycle()).for_each(|(b, mass)| *b -= mean * mass);
                }
                let mut x = vec![0.0; b.len()];
                solver.solve(&domain, &b, &mut x, &Control::default()).unwrap();
                let stiffness = domain.stiffness(|element| mobility.elements[element], false);
                for k in 0..n {
                    let rows = stiffness.multiply(&x[k * nodes..(k + 1) * nodes]).unwrap();
                    for i in 0..nodes {
                        let here = x[k * nodes + i];
                        let before = if k == 0 { here } else { x[(k - 1) * nodes + i] };
                        let after = match ends {
                            _ if k + 1 < n => x[(k + 1) * nodes + i],
                            Ends::Fixed => here,
                            Ends::Free(weight) => (1.0 - 1.0 / weight) * here,
                        };
                        let value = (n * n) as f64 * (2.0 * here - before - after) * domain.mass[i] * mobility.nodes[i] + rows[i];
                        assert!((value - b[k * nodes + i]).abs() < 1e-11, "{ends:?} {k} {i}: {value} {}", b[k * nodes + i]);
                    }
                }
            }
        }
    }
}
