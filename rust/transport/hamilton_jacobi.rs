//! Potentials that satisfy the discrete Hamilton-Jacobi inequality: what lower bounds are made of.

use super::Domain;
use crate::error::{Error, Result};
use rayon::prelude::*;

/// How a potential is repaired.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Repair {
    /// q of the Lagrangian `weight |p|^q / q`.
    pub power: f64,
    /// How often each slice is lowered where it is too high; 0 only shifts it as a whole.
    pub passes: usize,
    /// How much of the excess is taken off.
    pub share: f64,
    /// Take the largest excess around each node, averaged once.
    pub dilated: bool,
}

impl Domain {
    /// `h = Σ a/corners L*(grad φ)` of each slice, integrated over the nodes' areas, `L*(s) = weight^(1 - r) |s|^r / r`, `1/q + 1/r = 1`.
    ///
    /// ```
    /// # use beltrami::{Control, shrink::Elements, transport::Domain};
    /// # let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1, masses 1/2
    /// # let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// let mut h = [0.0; 2];
    /// domain.hamiltonian(&[0.0, 2.0], &[1.0], 2.0, &mut h)?; // |2|² / 2, half of it at each end
    /// assert_eq!(h, [1.0, 1.0]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit.
    pub fn hamiltonian(&self, potential: &[f64], weights: &[f64], power: f64, out: &mut [f64]) -> Result<()> {
        self.slices(potential.len())?;
        self.expect("the Hamiltonian", out.len(), potential.len())?;
        let factors = self.conjugate_weights(weights, power)?;
        if self.nodes() == 0 {
            return Ok(());
        }
        out.par_chunks_mut(self.nodes()).zip(potential.par_chunks(self.nodes())).for_each(|(out, potential)| {
            self.hamiltonian_slice(potential, &factors, power, out);
        });
        Ok(())
    }

    fn conjugate_weights(&self, weights: &[f64], power: f64) -> Result<Vec<f64>> {
        self.expect("the weights", weights.len(), self.count())?;
        if !(power > 1.0 && power <= 2.0) {
            return Err(Error::input(format!("the power is {power}; it must be above 1 and up to 2")));
        }
        let (r, corners) = (power / (power - 1.0), self.elements.corners as f64);
        let factor = |(&w, &a): (&f64, &f64)| a / corners * if power == 2.0 { 0.5 / w } else { w.powf(1.0 - r) / r };
        Ok(weights.iter().zip(&self.elements.weights).map(factor).collect())
    }

    fn hamiltonian_slice(&self, potential: &[f64], factors: &[f64], power: f64, out: &mut [f64]) {
        out.fill(0.0);
        match self.elements.corners {
            2 => self.energies::<2>(potential, factors, power, out),
            3 => self.energies::<3>(potential, factors, power, out),
            _ => self.energies::<4>(potential, factors, power, out),
        }
    }

    fn energies<const S: usize>(&self, potential: &[f64], factors: &[f64], power: f64, out: &mut [f64]) {
        let r = power / (power - 1.0);
        for (element, (factor, corners)) in factors.iter().zip(self.elements.indices.chunks_exact(S)).enumerate() {
            let square: f64 = self.slope::<S>(potential, element)[..S - 1].iter().map(|x| x * x).sum();
            let energy = factor * if power == 2.0 { square } else { square.powf(0.5 * r) };
            corners.iter().for_each(|&corner| out[corner as usize] += energy);
        }
    }

    /// Lowers a potential (intervals, nodes) slice by slice, from the first to the last, until
    /// `n (φ_k - φ_{k-1}) + (h_k + h_{k-1}) / 2 <= limit_k` holds at every node with mass, h per unit area. `limit` (intervals, nodes) has the
    /// slice between the intervals k - 1 and k at k; its first slice bounds `φ_0 + h_0 / (2 n)` itself where `bounded` says so.
    ///
    /// ```
    /// # use beltrami::{Control, shrink::Elements, transport::{Domain, Repair}};
    /// # let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1, masses 1/2
    /// # let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// let shift = Repair { power: 2.0, passes: 0, share: 1.0, dilated: false };
    /// let mut out = [0.0; 4];
    /// domain.repair(&[0.0, 0.0, 1.0, 1.0], &[1.0], &[0.0; 4], false, shift, &mut out)?; // may not rise with time
    /// assert_eq!(out, [0.0; 4]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit.
    pub fn repair(&self, potential: &[f64], weights: &[f64], limit: &[f64], bounded: bool, how: Repair, out: &mut [f64]) -> Result<()> {
        let intervals = self.slices(potential.len())?;
        self.expect("the limits", limit.len(), potential.len())?;
        self.expect("the repaired potential", out.len(), potential.len())?;
        let factors = self.conjugate_weights(weights, how.power)?;
        let (nodes, n) = (self.nodes(), intervals as f64);
        if nodes == 0 {
            return Ok(());
        }
        let (mut h, mut before) = (vec![0.0; nodes], vec![0.0; nodes]);
        let (mut excess, mut spread) = (vec![0.0; nodes], vec![0.0; nodes]);
        let components = self.grounds.len();
        let mut shift = vec![0.0; components]; // of the slices so far, on each component
        for k in 0..intervals {
            let here = &mut out[k * nodes..(k + 1) * nodes];
            for ((here, given), &label) in here.iter_mut().zip(&potential[k * nodes..]).zip(&self.labels) {
                *here = given - shift[label as usize];
            }
            if k == 0 && !bounded {
                self.hamiltonian_slice(here, &factors, how.power, &mut h);
                for ((b, phi), (h, &mass)) in before.iter_mut().zip(&*here).zip(h.iter().zip(&self.mass)) {
                    *b = phi - if mass > 0.0 { h / mass / (2.0 * n) } else { 0.0 };
                }
                continue;
            }
            // The bound: B = φ_{k-1} - h_{k-1} / 2n + limit / n; wanted is φ_k + h_k / 2n <= B.
            let limit = &limit[k * nodes..(k + 1) * nodes];
            if k == 0 {
                before.copy_from_slice(limit);
            } else {
                before.iter_mut().zip(limit).for_each(|(b, limit)| *b += limit / n);
            }
            let mut best: Option<(f64, Vec<f64>, Vec<f64>)> = None;
            for pass in 0..=how.passes {
                self.hamiltonian_slice(here, &factors, how.power, &mut h);
                let mut most = vec![f64::NEG_INFINITY; components];
                for (node, e) in excess.iter_mut().enumerate() {
                    if self.mass[node] > 0.0 {
                        *e = here[node] + h[node] / self.mass[node] / (2.0 * n) - before[node];
                        let most = &mut most[self.labels[node] as usize];
                        *most = most.max(*e);
                    } else {
                        *e = 0.0;
                    }
                }
                let worst = most.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                if best.as_ref().is_none_or(|(least, _, _)| worst < *least) {
                    best = Some((worst, here.to_vec(), most));
                }
                if pass == how.passes {
                    break;
                }
                excess.iter_mut().for_each(|e| *e = e.max(0.0));
                if how.dilated {
                    self.around(&excess, &mut spread, |values| values.fold(0.0, f64::max));
                    self.around(&spread, &mut excess, |values| {
                        let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
                        sum / count
                    });
                }
                here.iter_mut().zip(&excess).for_each(|(phi, e)| *phi -= how.share * e);
            }
            if let Some((_, kept, most)) = best {
                let down: Vec<f64> = most.iter().map(|most| if most.is_finite() { *most } else { 0.0 }).collect();
                for ((phi, kept), &label) in here.iter_mut().zip(&kept).zip(&self.labels) {
                    *phi = kept - down[label as usize];
                }
                shift.iter_mut().zip(&down).for_each(|(shift, down)| *shift += down);
            }
            self.hamiltonian_slice(here, &factors, how.power, &mut h);
            for ((b, phi), (h, &mass)) in before.iter_mut().zip(&*here).zip(h.iter().zip(&self.mass)) {
                *b = phi - if mass > 0.0 { h / mass / (2.0 * n) } else { 0.0 };
            }
        }
        Ok(())
    }

    /// A function of the values at each node and its neighbours.
    fn around(&self, values: &[f64], out: &mut [f64], f: impl Fn(&mut dyn Iterator<Item = f64>) -> f64) {
        for (node, out) in out.iter_mut().enumerate() {
            *out = f(&mut self.neighbours(node).iter().map(|&other| values[other as usize]));
        }
    }

    /// Several repairs of the same potential side by side; see [`Domain::repair`].
    ///
    /// ```
    /// # use beltrami::{Control, shrink::Elements, transport::{Domain, Repair}};
    /// # let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1, masses 1/2
    /// # let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// let ways = [0, 2].map(|passes| Repair { power: 2.0, passes, share: 1.0, dilated: false });
    /// let mut out = [0.0; 8];
    /// domain.repairs(&[0.0, 0.0, 1.0, 1.0], &[1.0], &[0.0; 4], false, &ways, &mut out)?;
    /// assert_eq!(out, [0.0; 8]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`Domain::repair`].
    pub fn repairs(
        &self,
        potential: &[f64],
        weights: &[f64],
        limit: &[f64],
        bounded: bool,
        ways: &[Repair],
        out: &mut [f64],
    ) -> Result<()> {
        self.expect("the repaired potentials", out.len(), ways.len() * potential.len())?;
        if potential.is_empty() {
            return Ok(());
        }
        out.par_chunks_mut(potential.len()).zip(ways).try_for_each(|(out, &how)| self.repair(potential, weights, limit, bounded, how, out))
    }
}
