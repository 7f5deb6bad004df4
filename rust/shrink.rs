//! Total variation on simplices: the inner loop of its splitting methods.
//!
//! A function is given by its values at nodes and is linear on each element, so that its gradient is constant there:
//! `g = Σ_c (f_c - f_0) h_c` with the hat gradients `h_c` of all corners but the first. Elements are triangles of a mesh, simplices
//! of a cloud, or the edges of a graph (two corners, one coordinate). Several channels are kept side by side.
//!
//! [`Elements::shrink`] is one sweep of the alternating direction method of multipliers for `Σ_T a_T |G f|_T` (Goldstein and Osher
//! 2009; the chapter's steps (4) and (5)), fused: gradient, over-relaxation, shrinkage, dual update, and the right-hand side of
//! the next linear system. [`constrain`] is the sweep of the nodes: a linear cost over the unit interval or the unit simplex.

use crate::error::{Error, Result};
use crate::sparse::CHUNK;
use rayon::prelude::*;

/// Simplices with weights and hat gradients: what a total variation is summed over.
#[derive(Debug, Clone)]
pub struct Elements {
    nodes: usize,
    pub(crate) corners: usize,
    pub(crate) indices: Vec<u32>,
    pub(crate) hats: Vec<f64>,
    pub(crate) weights: Vec<f64>,
    /// For each node, where its corners are in `indices`.
    pub(crate) starts: Vec<usize>,
    pub(crate) incidence: Vec<u32>,
}

/// How a sweep shrinks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shrinkage {
    /// Channels side by side.
    pub channels: usize,
    /// One length over all channels (Frobenius), or one each.
    pub joint: bool,
    /// Factor of the total variation: the dual's largest length.
    pub radius: f64,
    /// ρ, the weight of the quadratic penalty.
    pub penalty: f64,
    /// Over-relaxation, from 1 to below 2.
    pub relaxation: f64,
}

/// Memory that repeated sweeps use again.
#[derive(Debug, Default)]
pub struct Scratch {
    corners: Vec<f64>,
}

impl Elements {
    /// Elements of `corners` nodes each (2, 3 or 4): their node numbers, `corners - 1` hat gradients of `corners - 1` coordinates, and weights.
    ///
    /// ```
    /// use beltrami::shrink::Elements;
    /// let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![3.0])?;
    /// assert_eq!(edge.total_variation(&[1.0, 5.0], 1, true)?, 12.0);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if the arrays do not fit together, a node is not there, or a number is not finite or a weight negative.
    pub fn new(nodes: usize, corners: usize, indices: Vec<u32>, hats: Vec<f64>, weights: Vec<f64>) -> Result<Elements> {
        let (count, side) = (weights.len(), corners.wrapping_sub(1));
        if !(2..=4).contains(&corners) || indices.len() != count * corners || hats.len() != count * side * side {
            return Err(Error::input(format!(
                "{count} elements of {corners} corners come with {} node numbers and {} coordinates of hat gradients",
                indices.len(),
                hats.len()
            )));
        }
        if indices.len() > u32::MAX as usize {
            return Err(Error::input(format!("{count} elements are too many; up to 2^32 corners are possible")));
        }
        if let Some(at) = indices.iter().position(|&index| index as usize >= nodes) {
            return Err(Error::input(format!("element {} refers to node {}, there are {nodes} nodes", at / corners, indices[at])));
        }
        if let Some(at) = weights.iter().position(|weight| !(weight.is_finite() && *weight >= 0.0)) {
            return Err(Error::input(format!("element {at} has the weight {}; it must be finite and not negative", weights[at])));
        }
        if let Some(at) = hats.iter().position(|number| !number.is_finite()) {
            return Err(Error::input(format!("element {} is degenerate: a gradient on it is not finite", at / (side * side))));
        }
        let mut starts = vec![0; nodes + 1];
        for &index in &indices {
            starts[index as usize + 1] += 1;
        }
        for node in 0..nodes {
            starts[node + 1] += starts[node];
        }
        let (mut next, mut incidence) = (starts.clone(), vec![0; indices.len()]);
        for (at, &index) in indices.iter().enumerate() {
            incidence[next[index as usize]] = at as u32;
            next[index as usize] += 1;
        }
        Ok(Elements { nodes, corners, indices, hats, weights, starts, incidence })
    }

    /// Number of elements.
    pub fn count(&self) -> usize {
        self.weights.len()
    }

    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.nodes
    }

    /// Coordinates of a gradient, one less than corners.
    pub fn coordinates(&self) -> usize {
        self.corners - 1
    }

    fn check(&self, values: usize, fields: &[usize], channels: usize) -> Result<()> {
        let (nodes, elements) = (self.nodes * channels, self.count() * channels * self.coordinates());
        if channels == 0 || values != nodes || fields.iter().any(|&field| field != elements) {
            return Err(Error::input(format!(
                "{channels} channels need {nodes} values at nodes and {elements} of each field; there are {values} and {fields:?}"
            )));
        }
        Ok(())
    }

    /// `Σ a |G f|`: `joint`, with one length over all channels, or else the sum over the channels.
    ///
    /// # Errors
    /// [`Error::Input`] if the number of values is not nodes times channels.
    pub fn total_variation(&self, f: &[f64], channels: usize, joint: bool) -> Result<f64> {
        self.check(f.len(), &[], channels)?;
        Ok(match self.corners {
            2 => self.variation::<2>(f, channels, joint),
            3 => self.variation::<3>(f, channels, joint),
            _ => self.variation::<4>(f, channels, joint),
        })
    }

    fn variation<const S: usize>(&self, f: &[f64], channels: usize, joint: bool) -> f64 {
        let parts: Vec<f64> = (0..self.count().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let elements = chunk * CHUNK..((chunk + 1) * CHUNK).min(self.count());
                let mut sum = 0.0;
                for element in elements {
                    let (mut all, mut each) = (0.0, 0.0);
                    for channel in 0..channels {
                        let g = self.slope::<S>(f, channels, element, channel);
                        let squared: f64 = g[..S - 1].iter().map(|x| x * x).sum();
                        all += squared;
                        each += squared.sqrt();
                    }
                    sum += self.weights[element] * if joint { f64::sqrt(all) } else { each };
                }
                sum
            })
            .collect();
        parts.iter().sum()
    }

    /// Gradient of a channel on an element; the last number is unused.
    #[inline]
    fn slope<const S: usize>(&self, f: &[f64], channels: usize, element: usize, channel: usize) -> [f64; S] {
        let corners = &self.indices[element * S..][..S];
        let hats = &self.hats[element * (S - 1) * (S - 1)..][..(S - 1) * (S - 1)];
        let first = f[corners[0] as usize * channels + channel];
        let mut g = [0.0; S];
        for (&corner, hat) in corners[1..].iter().zip(hats.chunks_exact(S - 1)) {
            let rise = f[corner as usize * channels + channel] - first;
            for (sum, h) in g.iter_mut().zip(hat) {
                *sum += rise * h;
            }
        }
        g
    }

    /// What an element's field gives to its corners: `a h_c · x`.
    #[inline]
    fn give<const S: usize>(&self, element: usize, x: &[f64; S], out: &mut [f64], channels: usize, channel: usize) {
        let hats = &self.hats[element * (S - 1) * (S - 1)..][..(S - 1) * (S - 1)];
        let weight = self.weights[element];
        let mut rest = 0.0;
        for (corner, hat) in hats.chunks_exact(S - 1).enumerate() {
            let share = weight * hat.iter().zip(x).map(|(h, x)| h * x).sum::<f64>();
            out[(corner + 1) * channels + channel] = share;
            rest -= share;
        }
        out[channel] = rest;
    }

    /// Sums what corners were given, in the order of the elements.
    fn gather(&self, given: &[f64], channels: usize, flux: &mut [f64]) {
        flux.par_chunks_mut(CHUNK * channels).enumerate().for_each(|(chunk, flux)| {
            let starts = &self.starts[chunk * CHUNK..];
            if channels == 1 {
                for (sum, range) in flux.iter_mut().zip(starts.windows(2)) {
                    *sum = self.incidence[range[0]..range[1]].iter().map(|&at| given[at as usize]).sum();
                }
                return;
            }
            for (sums, range) in flux.chunks_exact_mut(channels).zip(starts.windows(2)) {
                sums.fill(0.0);
                for &at in &self.incidence[range[0]..range[1]] {
                    for (sum, share) in sums.iter_mut().zip(&given[at as usize * channels..][..channels]) {
                        *sum += share;
                    }
                }
            }
        });
    }

    /// `G^T diag(a) X` of a field with `channels * coordinates` numbers per element: the negative divergence times the mass.
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit.
    pub fn flux(&self, field: &[f64], channels: usize, flux: &mut [f64], scratch: &mut Scratch) -> Result<()> {
        self.check(flux.len(), &[field.len()], channels)?;
        match self.corners {
            2 => self.spread::<2>(field, channels, scratch),
            3 => self.spread::<3>(field, channels, scratch),
            _ => self.spread::<4>(field, channels, scratch),
        }
        self.gather(&scratch.corners, channels, flux);
        Ok(())
    }

    fn spread<const S: usize>(&self, field: &[f64], channels: usize, scratch: &mut Scratch) {
        scratch.corners.resize(self.indices.len() * channels, 0.0);
        let given = scratch.corners.par_chunks_mut(CHUNK * S * channels);
        given.zip(field.par_chunks(CHUNK * (S - 1) * channels)).enumerate().for_each(|(chunk, (given, field))| {
            let each = given.chunks_exact_mut(S * channels).zip(field.chunks_exact((S - 1) * channels));
            for (offset, (given, field)) in each.enumerate() {
                for channel in 0..channels {
                    let mut x = [0.0; S];
                    x[..S - 1].copy_from_slice(&field[channel * (S - 1)..][..S - 1]);
                    self.give::<S>(chunk * CHUNK + offset, &x, given, channels, channel);
                }
            }
        });
    }

    /// One sweep: with `v = α G f + (1 - α) w + p / ρ`, `w = shrink(v, radius / ρ)`, `p = ρ (v - w)` (so that |p| <= radius), and
    /// `flux = G^T diag(a) (w - p / ρ)`. `split` is w, `dual` is p, both (element, channel, coordinate).
    ///
    /// Returns `Σ a |G f - w|^2` and `Σ a |w - w before|^2`: the squares of the primal residual and of the dual one over ρ.
    ///
    /// ```
    /// use beltrami::shrink::{Elements, Scratch, Shrinkage};
    /// let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?;
    /// let how = Shrinkage { channels: 1, joint: true, radius: 1.0, penalty: 2.0, relaxation: 1.0 };
    /// let (mut w, mut p, mut flux) = ([0.0], [0.0], [0.0; 2]);
    /// edge.shrink(&[0.0, 3.0], how, &mut w, &mut p, &mut flux, &mut Scratch::default())?;
    /// assert_eq!((w, p, flux), ([2.5], [1.0], [-2.0, 2.0]));
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit or an option is out of range.
    pub fn shrink(
        &self,
        f: &[f64],
        how: Shrinkage,
        split: &mut [f64],
        dual: &mut [f64],
        flux: &mut [f64],
        scratch: &mut Scratch,
    ) -> Result<(f64, f64)> {
        self.check(f.len(), &[split.len(), dual.len()], how.channels)?;
        self.check(flux.len(), &[], how.channels)?;
        if !(how.penalty > 0.0 && how.radius >= 0.0 && how.relaxation > 0.0 && how.relaxation < 2.0) {
            return Err(Error::input(format!("{how:?}: penalty and radius must be positive, relaxation between 0 and 2")));
        }
        // Known numbers of channels let the compiler unroll the loops over them.
        let found = match (self.corners, how.channels) {
            (2, 1) => self.sweep_one::<2>(f, how, split, dual, scratch),
            (3, 1) => self.sweep_one::<3>(f, how, split, dual, scratch),
            (2, _) => self.sweep::<2, 0>(f, how, split, dual, scratch),
            (3, 3) => self.sweep::<3, 3>(f, how, split, dual, scratch),
            (3, _) => self.sweep::<3, 0>(f, how, split, dual, scratch),
            _ => self.sweep::<4, 0>(f, how, split, dual, scratch),
        };
        self.gather(&scratch.corners, how.channels, flux);
        Ok(found)
    }

    /// [`Self::sweep`] of one channel: all stays in registers.
    fn sweep_one<const S: usize>(
        &self,
        f: &[f64],
        how: Shrinkage,
        split: &mut [f64],
        dual: &mut [f64],
        scratch: &mut Scratch,
    ) -> (f64, f64) {
        let Shrinkage { radius, penalty, relaxation, .. } = how;
        let (inverse, threshold) = (1.0 / penalty, radius / penalty);
        scratch.corners.resize(self.indices.len(), 0.0);
        let parts: Vec<(f64, f64)> = scratch
            .corners
            .par_chunks_mut(CHUNK * S)
            .zip(split.par_chunks_mut(CHUNK * (S - 1)).zip(dual.par_chunks_mut(CHUNK * (S - 1))))
            .enumerate()
            .map(|(chunk, (given, (split, dual)))| {
                let (mut primal, mut change) = (0.0, 0.0);
                let each = given.chunks_exact_mut(S).zip(split.chunks_exact_mut(S - 1).zip(dual.chunks_exact_mut(S - 1)));
                for (offset, (given, (split, dual))) in each.enumerate() {
                    let element = chunk * CHUNK + offset;
                    let g = self.slope::<S>(f, 1, element, 0);
                    let mut v = [0.0; S];
                    for k in 0..S - 1 {
                        v[k] = relaxation * g[k] + (1.0 - relaxation) * split[k] + dual[k] * inverse;
                    }
                    let share = (threshold / v.iter().map(|v| v * v).sum::<f64>().sqrt()).min(1.0); // 1 for 0 / 0
                    let (kept, pull) = (1.0 - share, penalty * share);
                    let (mut x, mut missed, mut moved) = ([0.0; S], 0.0, 0.0);
                    for k in 0..S - 1 {
                        let (w, p) = (kept * v[k], pull * v[k]);
                        missed += (g[k] - w) * (g[k] - w);
                        moved += (w - split[k]) * (w - split[k]);
                        (split[k], dual[k]) = (w, p);
                        x[k] = w - p * inverse;
                    }
                    self.give::<S>(element, &x, given, 1, 0);
                    primal += self.weights[element] * missed;
                    change += self.weights[element] * moved;
                }
                (primal, change)
            })
            .collect();
        parts.iter().fold((0.0, 0.0), |sum, part| (sum.0 + part.0, sum.1 + part.1))
    }

    fn sweep<const S: usize, const C: usize>(
        &self,
        f: &[f64],
        how: Shrinkage,
        split: &mut [f64],
        dual: &mut [f64],
        scratch: &mut Scratch,
    ) -> (f64, f64) {
        let Shrinkage { channels, joint, radius, penalty, relaxation } = how;
        let channels = if C > 0 { C } else { channels };
        let (side, inverse, threshold) = (S - 1, 1.0 / penalty, radius / penalty);
        scratch.corners.resize(self.indices.len() * channels, 0.0);
        let parts: Vec<(f64, f64)> = scratch
            .corners
            .par_chunks_mut(CHUNK * S * channels)
            .zip(split.par_chunks_mut(CHUNK * side * channels).zip(dual.par_chunks_mut(CHUNK * side * channels)))
            .enumerate()
            .map(|(chunk, (given, (split, dual)))| {
                let (mut primal, mut change) = (0.0, 0.0);
                let mut slopes = vec![[0.0; S]; channels];
                let each = given.chunks_exact_mut(S * channels).zip(split.chunks_exact_mut(side * channels));
                for (offset, ((given, split), dual)) in each.zip(dual.chunks_exact_mut(side * channels)).enumerate() {
                    let element = chunk * CHUNK + offset;
                    let mut all = 0.0;
                    for (channel, g) in slopes.iter_mut().enumerate() {
                        *g = self.slope::<S>(f, channels, element, channel);
                        let (split, dual) = (&split[channel * side..][..side], &mut dual[channel * side..][..side]);
                        for ((v, &before), &slope) in dual.iter_mut().zip(split).zip(g.iter()) {
                            // the dual holds v until it is shrunk
                            *v = relaxation * slope + (1.0 - relaxation) * before + *v * inverse;
                            all += *v * *v;
                        }
                    }
                    let (mut missed, mut moved) = (0.0, 0.0);
                    for (channel, g) in slopes.iter().enumerate() {
                        let (split, dual) = (&mut split[channel * side..][..side], &mut dual[channel * side..][..side]);
                        let length = if joint { f64::sqrt(all) } else { dual.iter().map(|v| v * v).sum::<f64>().sqrt() };
                        let share = (threshold / length).min(1.0); // 1 for 0 / 0
                        let (kept, pull) = (1.0 - share, penalty * share);
                        let mut x = [0.0; S];
                        for k in 0..side {
                            let (v, before) = (dual[k], split[k]);
                            let (w, p) = (kept * v, pull * v);
                            missed += (g[k] - w) * (g[k] - w);
                            moved += (w - before) * (w - before);
                            split[k] = w;
                            dual[k] = p;
                            x[k] = w - p * inverse;
                        }
                        self.give::<S>(element, &x, given, channels, channel);
                    }
                    primal += self.weights[element] * missed;
                    change += self.weights[element] * moved;
                }
                (primal, change)
            })
            .collect();
        parts.iter().fold((0.0, 0.0), |sum, part| (sum.0 + part.0, sum.1 + part.1))
    }
}

/// The nodes' part of the method: `z` minimizes `cost · z` over the unit interval (one channel) or the unit simplex (several).
#[derive(Debug)]
pub struct Nodes<'a> {
    /// Cost a unit of weight, (node, channel).
    pub cost: &'a [f64],
    /// Weight of each node, positive.
    pub weights: &'a [f64],
    /// The constrained copy z, (node, channel).
    pub split: &'a mut [f64],
    /// Its multiplier y, a unit of weight.
    pub dual: &'a mut [f64],
}

/// One sweep of the nodes: with `v = α f + (1 - α) z`, `z = project(v + (y - cost) / σ)`, `y += σ (v - z)`, and
/// `right += κ weight (z - y / σ)`, the rest of the next right-hand side.
///
/// Returns `Σ weight |f - z|^2` and `Σ weight |z - z before|^2`.
///
/// ```
/// use beltrami::shrink::{Nodes, constrain};
/// let (mut z, mut y, mut right) = ([0.0], [0.0], [0.0]);
/// let nodes = Nodes { cost: &[-1.0], weights: &[2.0], split: &mut z, dual: &mut y };
/// constrain(&[0.8], 1, nodes, 2.0, 10.0, 1.0, &mut right)?;
/// assert_eq!((z, right), ([1.0], [2.0 * 10.0 * 1.2]));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if sizes do not fit.
pub fn constrain(
    f: &[f64],
    channels: usize,
    nodes: Nodes<'_>,
    penalty: f64,
    ratio: f64,
    relaxation: f64,
    right: &mut [f64],
) -> Result<(f64, f64)> {
    let Nodes { cost, weights, split, dual } = nodes;
    let numbers = weights.len() * channels;
    if channels == 0 || [f.len(), cost.len(), split.len(), dual.len(), right.len()].iter().any(|&length| length != numbers) {
        return Err(Error::input(format!("{} nodes with {channels} channels need {numbers} numbers of each kind", weights.len())));
    }
    if !(penalty > 0.0 && ratio > 0.0) {
        return Err(Error::input(format!("the penalty {penalty} and the ratio {ratio} must be positive")));
    }
    let size = CHUNK * channels;
    let parts: Vec<(f64, f64)> = right
        .par_chunks_mut(size)
        .zip(split.par_chunks_mut(size).zip(dual.par_chunks_mut(size)))
        .zip(f.par_chunks(size).zip(cost.par_chunks(size).zip(weights.par_chunks(CHUNK))))
        .map(|((right, (split, dual)), (f, (cost, weights)))| {
            let (mut primal, mut change) = (0.0, 0.0);
            let mut v = vec![0.0; channels];
            let mut sorted = vec![0.0; channels];
            for (node, &weight) in weights.iter().enumerate() {
                let here = node * channels..(node + 1) * channels;
                let (f, z, y) = (&f[here.clone()], &mut split[here.clone()], &mut dual[here.clone()]);
                let (cost, right) = (&cost[here.clone()], &mut right[here]);
                for c in 0..channels {
                    v[c] = relaxation * f[c] + (1.0 - relaxation) * z[c] + (y[c] - cost[c]) / penalty;
                }
                // y + σ (α f + (1 - α) z - z new) = σ (v - z new) + cost
                let level = if channels == 1 { 0.0 } else { simplex_level(&v, &mut sorted) };
                for c in 0..channels {
                    let new = (v[c] - level).clamp(0.0, 1.0);
                    primal += weight * (f[c] - new) * (f[c] - new);
                    change += weight * (new - z[c]) * (new - z[c]);
                    z[c] = new;
                    y[c] = penalty * (v[c] - new) + cost[c];
                    right[c] += ratio * weight * (new - y[c] / penalty);
                }
            }
            (primal, change)
        })
        .collect();
    Ok(parts.iter().fold((0.0, 0.0), |sum, part| (sum.0 + part.0, sum.1 + part.1)))
}

/// The number to subtract so that the positive parts sum to 1 (Held, Wolfe and Crowder 1974).
fn simplex_level(v: &[f64], sorted: &mut [f64]) -> f64 {
    sorted.copy_from_slice(v);
    sorted.sort_unstable_by(|a, b| b.total_cmp(a));
    let (mut sum, mut level) = (0.0, 0.0);
    for (count, &value) in sorted.iter().enumerate() {
        sum += value;
        let candidate = (sum - 1.0) / (count + 1) as f64;
        if value > candidate {
            level = candidate;
        }
    }
    level
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two triangles of the unit square, with a third of a graph's freedom: hats of (0,0), (1,0), (1,1) and (0,0), (1,1), (0,1).
    fn square() -> Elements {
        let hats = vec![1.0, -1.0, 0.0, 1.0, 1.0, 0.0, -1.0, 1.0];
        Elements::new(4, 3, vec![0, 1, 2, 0, 2, 3], hats, vec![0.5, 0.5]).unwrap()
    }

    #[test]
    fn linear_functions_have_the_slope_they_should() {
        // f = 3 x + 4 y: |grad| = 5 on area 1
        assert!((square().total_variation(&[0.0, 3.0, 7.0, 4.0], 1, true).unwrap() - 5.0).abs() < 1e-15);
        // two channels, 5 and 5: Frobenius sqrt(50), separately 10
        let two = [0.0, 0.0, 3.0, 3.0, 7.0, 7.0, 4.0, 4.0];
        assert!((square().total_variation(&two, 2, true).unwrap() - 50f64.sqrt()).abs() < 1e-14);
        assert!((square().total_variation(&two, 2, false).unwrap() - 10.0).abs() < 1e-14);
    }

    #[test]
    fn flux_is_the_adjoint_of_the_gradient() {
        let (square, field, f) = (square(), [0.3, -1.0, 2.0, 0.7], [0.1, -2.0, 0.4, 3.0]);
        let mut flux = [0.0; 4];
        square.flux(&field, 1, &mut flux, &mut Scratch::default()).unwrap();
        let left: f64 = flux.iter().zip(f).map(|(a, b)| a * b).sum();
        let right: f64 = (0..2)
            .map(|t| {
                let g = square.slope::<3>(&f, 1, t, 0);
                0.5 * (g[0] * field[2 * t] + g[1] * field[2 * t + 1])
            })
            .sum();
        assert!((left - right).abs() < 1e-15, "{left} {right}");
        assert!(flux.iter().sum::<f64>().abs() < 1e-15);
    }

    #[test]
    fn the_dual_stays_in_the_ball_and_moreau_holds() {
        let (square, how) = (square(), Shrinkage { channels: 2, joint: true, radius: 0.5, penalty: 3.0, relaxation: 1.0 });
        let f: Vec<f64> = (0..8).map(|i| f64::from(i * i % 7) - 2.0).collect();
        let (mut w, mut p, mut flux) = (vec![0.0; 8], vec![0.1; 8], vec![0.0; 8]);
        let before = p.clone();
        square.shrink(&f, how, &mut w, &mut p, &mut flux, &mut Scratch::default()).unwrap();
        for t in 0..2 {
            let length = p[4 * t..4 * t + 4].iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!(length <= 0.5 * (1.0 + 1e-15));
            for c in 0..2 {
                let g = square.slope::<3>(&f, 2, t, c);
                for k in 0..2 {
                    let at = 4 * t + 2 * c + k;
                    assert!((w[at] + p[at] / 3.0 - g[k] - before[at] / 3.0).abs() < 1e-14); // v = w + p / rho
                }
            }
        }
    }

    #[test]
    fn points_land_on_the_simplex() {
        let mut sorted = [0.0; 3];
        for v in [[0.2, 0.3, 0.5], [5.0, 0.0, -1.0], [0.4, 0.4, 0.4], [-3.0, -3.5, -2.9]] {
            let level = simplex_level(&v, &mut sorted);
            let sum: f64 = v.iter().map(|x| (x - level).max(0.0)).sum();
            assert!((sum - 1.0).abs() < 1e-14, "{v:?} {sum}");
        }
    }

    #[test]
    fn nonsense_is_refused() {
        assert!(Elements::new(2, 3, vec![0, 1, 2], vec![0.0; 4], vec![1.0]).is_err());
        assert!(Elements::new(3, 3, vec![0, 1, 2], vec![f64::NAN; 4], vec![1.0]).is_err());
        assert!(Elements::new(3, 3, vec![0, 1, 2], vec![0.0; 4], vec![-1.0]).is_err());
        assert!(square().total_variation(&[0.0; 3], 1, true).is_err());
    }
}
