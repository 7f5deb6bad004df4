//! What happens in space: averages, gradients, the perspective's projection, optimal momenta.

use crate::control::Control;
use crate::error::{Error, Result};
use crate::shrink::Elements;
use crate::solvers::{Cholesky, Scratch, Symbolic};
use crate::sparse::{CHUNK, Csr};
use rayon::prelude::*;
use std::sync::Arc;

/// Simplices and nodal masses, with the pattern of their stiffness analysed.
#[derive(Debug, Clone)]
pub struct Domain {
    pub(super) elements: Elements,
    pub(super) mass: Vec<f64>,
    /// Hat gradients of all corners, that of the first included.
    hats: Vec<f64>,
    starts: Vec<usize>,
    indices: Vec<u32>,
    /// Where the entry of each pair of corners is in the stiffness.
    slots: Vec<u32>,
    pub(super) labels: Vec<u32>,
    /// One node of each component.
    pub(super) grounds: Vec<u32>,
    pub(super) symbolic: Arc<Symbolic>,
}

/// One step of the splitting on the elements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Length of the primal step, where the mobility is 1.
    pub primal: f64,
    /// Length of the dual step, where density and mobility are 1.
    pub dual: f64,
    /// Over-relaxation, from 1 to below 2.
    pub relaxation: f64,
    /// q of the Lagrangian `weight |p|^q / q`, above 1 and up to 2.
    pub power: f64,
}

impl Domain {
    /// Elements with a mass for each node. `coordinates` (nodes times D numbers, D) place the nodes for a good order.
    ///
    /// ```
    /// use beltrami::{Control, shrink::Elements, transport::Domain};
    /// let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1
    /// let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// assert_eq!((domain.nodes(), domain.count(), domain.labels()), (2, 1, &[0, 0][..]));
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if a mass is not finite or negative, or sizes do not fit.
    pub fn new(elements: Elements, mass: Vec<f64>, coordinates: Option<(&[f64], usize)>, control: &Control) -> Result<Self> {
        let (nodes, corners) = (elements.nodes(), elements.corners);
        if mass.len() != nodes {
            return Err(Error::input(format!("{nodes} nodes come with {} masses", mass.len())));
        }
        if let Some(at) = mass.iter().position(|mass| !(mass.is_finite() && *mass >= 0.0)) {
            return Err(Error::input(format!("the mass of node {at} is {}; it must be finite and not negative", mass[at])));
        }
        let side = corners - 1;
        let mut hats = Vec::with_capacity(elements.count() * corners * side);
        for element in elements.hats.chunks_exact(side * side) {
            hats.extend((0..side).map(|k| -element.chunks_exact(side).map(|hat| hat[k]).sum::<f64>()));
            hats.extend_from_slice(element);
        }
        let (mut starts, mut indices, mut slots) = (vec![0], Vec::new(), vec![0; elements.count() * corners * corners]);
        let mut row: Vec<u32> = Vec::new();
        for node in 0..nodes {
            row.clear();
            row.push(node as u32);
            let around = &elements.incidence[elements.starts[node]..elements.starts[node + 1]];
            for &at in around {
                let element = at as usize / corners;
                row.extend_from_slice(&elements.indices[element * corners..(element + 1) * corners]);
            }
            row.sort_unstable();
            row.dedup();
            for &at in around {
                let element = at as usize / corners;
                for other in 0..corners {
                    let found = row.binary_search(&elements.indices[element * corners + other]).unwrap_or(0);
                    slots[at as usize * corners + other] = (indices.len() + found) as u32;
                }
            }
            indices.extend_from_slice(&row);
            starts.push(indices.len());
        }
        if indices.len() > u32::MAX as usize {
            return Err(Error::input(format!("{} entries are too many; up to 2^32 are possible", indices.len())));
        }
        let pattern = Csr::trusted(nodes, nodes, starts.clone(), indices.clone(), vec![1.0; indices.len()]);
        let symbolic = Symbolic::new(&pattern, coordinates, control)?;
        let (mut labels, mut grounds) = (vec![u32::MAX; nodes], Vec::new());
        let mut open = Vec::new();
        for first in 0..nodes {
            if labels[first] != u32::MAX {
                continue;
            }
            let label = grounds.len() as u32;
            grounds.push(first as u32);
            labels[first] = label;
            open.push(first);
            while let Some(node) = open.pop() {
                for &other in &indices[starts[node]..starts[node + 1]] {
                    if labels[other as usize] == u32::MAX {
                        labels[other as usize] = label;
                        open.push(other as usize);
                    }
                }
            }
        }
        Ok(Domain { elements, mass, hats, starts, indices, slots, labels, grounds, symbolic })
    }

    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.elements.nodes()
    }

    /// Number of elements.
    pub fn count(&self) -> usize {
        self.elements.count()
    }

    /// Coordinates of a vector on an element.
    pub fn coordinates(&self) -> usize {
        self.elements.coordinates()
    }

    /// The connected component of each node.
    pub fn labels(&self) -> &[u32] {
        &self.labels
    }

    /// Slices in a table of nodes.
    pub(super) fn slices(&self, nodal: usize) -> Result<usize> {
        match nodal.checked_div(self.nodes()) {
            Some(slices) if slices * self.nodes() == nodal => Ok(slices),
            _ => Err(Error::input(format!("{nodal} numbers are no whole number of slices of {} nodes", self.nodes()))),
        }
    }

    pub(super) fn expect(&self, what: &str, found: usize, wanted: usize) -> Result<()> {
        if found != wanted {
            return Err(Error::input(format!("{what} has {found} numbers, {wanted} are needed")));
        }
        Ok(())
    }

    /// `G^T diag(a c) G` with a conductivity `c` for each element, in the pattern that was analysed; one node of each component grounded if asked.
    pub(super) fn stiffness(&self, conductivity: impl Fn(usize) -> f64, grounded: bool) -> Csr {
        let (corners, side) = (self.elements.corners, self.coordinates());
        let mut values = vec![0.0; self.indices.len()];
        for element in 0..self.count() {
            let weight = self.elements.weights[element] * conductivity(element);
            let hats = &self.hats[element * corners * side..][..corners * side];
            let slots = &self.slots[element * corners * corners..][..corners * corners];
            for a in 0..corners {
                for b in 0..corners {
                    let product: f64 = (0..side).map(|k| hats[a * side + k] * hats[b * side + k]).sum();
                    values[slots[a * corners + b] as usize] += weight * product;
                }
            }
        }
        if grounded {
            for &node in &self.grounds {
                let at = self.diagonal(node as usize);
                values[at] = if values[at] > 0.0 { 2.0 * values[at] } else { 1.0 };
            }
        }
        Csr::trusted(self.nodes(), self.nodes(), self.starts.clone(), self.indices.clone(), values)
    }

    /// A node and its neighbours.
    pub(super) fn neighbours(&self, node: usize) -> &[u32] {
        &self.indices[self.starts[node]..self.starts[node + 1]]
    }

    pub(super) fn diagonal(&self, node: usize) -> usize {
        let row = &self.indices[self.starts[node]..self.starts[node + 1]];
        self.starts[node] + row.binary_search(&(node as u32)).unwrap_or(0)
    }

    /// Takes the sum over each component off a right-hand side of integrals, in proportion to the mass.
    pub(super) fn make_compatible(&self, b: &mut [f64]) {
        let mut sums = vec![(0.0, 0.0); self.grounds.len()];
        for ((&label, &mass), &number) in self.labels.iter().zip(&self.mass).zip(b.iter()) {
            let sum = &mut sums[label as usize];
            *sum = (sum.0 + number, sum.1 + mass);
        }
        for ((&label, &mass), number) in self.labels.iter().zip(&self.mass).zip(b.iter_mut()) {
            let (excess, total) = sums[label as usize];
            *number = if total > 0.0 { *number - excess / total * mass } else { 0.0 };
        }
    }

    /// Sums what elements give to their corners: for each slice `mean = Σ a/corners f` and `flux = Σ a h · (X - factor Y)`, with a
    /// factor for each element.
    ///
    /// ```
    /// # use beltrami::{Control, shrink::Elements, transport::Domain};
    /// # let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1, masses 1/2
    /// # let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// let (mut mean, mut flux) = ([0.0; 2], [0.0; 2]);
    /// domain.gather(&[3.0], &[2.0], &[1.0], &[0.5], &mut mean, &mut flux)?;
    /// assert_eq!((mean, flux), ([1.5, 1.5], [-1.5, 1.5]));
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit.
    pub fn gather(&self, scalar: &[f64], field: &[f64], other: &[f64], factors: &[f64], mean: &mut [f64], flux: &mut [f64]) -> Result<()> {
        let slices = self.slices(mean.len())?;
        self.expect("flux", flux.len(), mean.len())?;
        self.expect("the scalars", scalar.len(), slices * self.count())?;
        self.expect("the field", field.len(), scalar.len() * self.coordinates())?;
        self.expect("the other field", other.len(), field.len())?;
        self.expect("the factors", factors.len(), self.count())?;
        match self.elements.corners {
            2 => self.gather_sized::<2>(scalar, field, other, factors, mean, flux),
            3 => self.gather_sized::<3>(scalar, field, other, factors, mean, flux),
            _ => self.gather_sized::<4>(scalar, field, other, factors, mean, flux),
        }
        Ok(())
    }

    fn gather_sized<const S: usize>(
        &self,
        scalar: &[f64],
        field: &[f64],
        other: &[f64],
        factors: &[f64],
        mean: &mut [f64],
        flux: &mut [f64],
    ) {
        let (nodes, count, side) = (self.nodes(), self.count(), S - 1);
        if nodes == 0 {
            return;
        }
        let elements = &self.elements;
        mean.par_chunks_mut(nodes).zip(flux.par_chunks_mut(nodes)).enumerate().for_each(|(slice, (mean, flux))| {
            mean.fill(0.0);
            flux.fill(0.0);
            let scalar = &scalar[slice * count..][..count];
            let (field, other) = (&field[slice * count * side..][..count * side], &other[slice * count * side..][..count * side]);
            // element by element: their tables are streamed once, and a slice of nodes stays in the cache
            let each = scalar.iter().zip(field.chunks_exact(side)).zip(other.chunks_exact(side)).zip(&elements.weights).zip(factors);
            let corners = elements.indices.chunks_exact(S).zip(self.hats.chunks_exact(S * side));
            for (((((scalar, x), y), weight), factor), (corners, hats)) in each.zip(corners) {
                let average = weight * scalar / S as f64;
                let mut given = [0.0; S];
                for k in 0..side {
                    given[k] = weight * (x[k] - factor * y[k]);
                }
                for (&corner, hat) in corners.iter().zip(hats.chunks_exact(side)) {
                    let product: f64 = hat.iter().zip(&given).map(|(h, v)| h * v).sum();
                    mean[corner as usize] += average;
                    flux[corner as usize] += product;
                }
            }
        });
    }

    /// Densities on the elements: means over the corners and over the two ends of each interval. `nodal` has one slice more.
    ///
    /// ```
    /// # use beltrami::{Control, shrink::Elements, transport::Domain};
    /// # let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1, masses 1/2
    /// # let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// let mut out = [0.0];
    /// domain.densities(&[1.0, 3.0, 5.0, 7.0], &mut out)?; // two slices
    /// assert_eq!(out, [4.0]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit.
    pub fn densities(&self, nodal: &[f64], out: &mut [f64]) -> Result<()> {
        let slices = self.slices(nodal.len())?;
        self.expect("the densities on elements", out.len(), slices.saturating_sub(1) * self.count())?;
        let (nodes, count, corners) = (self.nodes(), self.count(), self.elements.corners);
        if count == 0 {
            return Ok(());
        }
        let share = 0.5 / corners as f64;
        out.par_chunks_mut(count).enumerate().for_each(|(slice, out)| {
            let (before, after) = (&nodal[slice * nodes..][..nodes], &nodal[(slice + 1) * nodes..][..nodes]);
            for (out, corners) in out.iter_mut().zip(self.elements.indices.chunks_exact(corners)) {
                *out = share * corners.iter().map(|&node| before[node as usize] + after[node as usize]).sum::<f64>();
            }
        });
        Ok(())
    }

    /// Gradients on the elements of each slice.
    ///
    /// ```
    /// # use beltrami::{Control, shrink::Elements, transport::Domain};
    /// # let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1, masses 1/2
    /// # let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// let mut out = [0.0];
    /// domain.gradients(&[1.0, 4.0], &mut out)?;
    /// assert_eq!(out, [3.0]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit.
    pub fn gradients(&self, nodal: &[f64], out: &mut [f64]) -> Result<()> {
        let slices = self.slices(nodal.len())?;
        let (nodes, width) = (self.nodes(), self.count() * self.coordinates());
        self.expect("the gradients", out.len(), slices * width)?;
        if width == 0 {
            return Ok(());
        }
        out.par_chunks_mut(width).enumerate().for_each(|(slice, out)| {
            let nodal = &nodal[slice * nodes..][..nodes];
            match self.elements.corners {
                2 => self.slopes::<2>(nodal, out),
                3 => self.slopes::<3>(nodal, out),
                _ => self.slopes::<4>(nodal, out),
            }
        });
        Ok(())
    }

    fn slopes<const S: usize>(&self, nodal: &[f64], out: &mut [f64]) {
        for (element, out) in out.chunks_exact_mut(S - 1).enumerate() {
            out.copy_from_slice(&self.slope::<S>(nodal, element)[..S - 1]);
        }
    }

    /// Gradient on an element; the last number is unused.
    #[inline]
    pub(super) fn slope<const S: usize>(&self, nodal: &[f64], element: usize) -> [f64; S] {
        let corners = &self.elements.indices[element * S..][..S];
        let hats = &self.elements.hats[element * (S - 1) * (S - 1)..][..(S - 1) * (S - 1)];
        let first = nodal[corners[0] as usize];
        let mut g = [0.0; S];
        for (&corner, hat) in corners[1..].iter().zip(hats.chunks_exact(S - 1)) {
            let rise = nodal[corner as usize] - first;
            for (sum, h) in g.iter_mut().zip(hat) {
                *sum += rise * h;
            }
        }
        g
    }

    /// One step of the splitting on the elements. With the nodal tables `before` and `after` (the densities, one slice more than
    /// intervals) and `potential` (the projection's, a slice an interval):
    ///
    /// `M' = M + e (grad ψ - τ y_M)`, `(y_R, y_M)' = Π(y_R + σ/r mean(2 P' - P), y_M + σ/e (2 M' - M))`, everything over-relaxed, where Π
    /// projects on `α + L*(β) <= 0`, the dual of the perspective `ρ L(M / ρ)` (Benamou and Brenier 2000; Papadakis, Peyré and Oudet
    /// 2014), in the metric (r, e). For each element r is the size of the density there, e the mobility of the momentum.
    ///
    /// ```
    /// # use beltrami::{Control, shrink::Elements, transport::{Domain, Step}};
    /// # let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1, masses 1/2
    /// # let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// let how = Step { primal: 1.0, dual: 1.0, relaxation: 1.0, power: 2.0 };
    /// let (mut m, mut r, mut d) = ([0.0], [0.0], [0.0]);
    /// domain.step(how, [&[1.0]; 3], &[0.0; 4], &[-1.0; 4], &[0.0, 0.5], &mut m, &mut r, &mut d)?;
    /// assert_eq!((m, r, d), ([0.5], [-2.0], [1.0])); // (-2, 1) satisfies α + β² / 2 <= 0 already
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit or an option is out of range.
    pub fn step(
        &self,
        how: Step,
        [weights, sizes, mobility]: [&[f64]; 3],
        before: &[f64],
        after: &[f64],
        potential: &[f64],
        momentum: &mut [f64],
        dual_density: &mut [f64],
        dual_momentum: &mut [f64],
    ) -> Result<()> {
        let slices = self.slices(potential.len())?;
        self.expect("the densities before", before.len(), (slices + 1) * self.nodes())?;
        self.expect("the densities after", after.len(), before.len())?;
        self.expect("the weights", weights.len(), self.count())?;
        self.expect("the sizes", sizes.len(), self.count())?;
        self.expect("the mobilities", mobility.len(), self.count())?;
        self.expect("the dual densities", dual_density.len(), slices * self.count())?;
        self.expect("the momenta", momentum.len(), dual_density.len() * self.coordinates())?;
        self.expect("the dual momenta", dual_momentum.len(), momentum.len())?;
        if !(how.primal > 0.0 && how.dual > 0.0 && how.relaxation > 0.0 && how.relaxation < 2.0 && how.power > 1.0 && how.power <= 2.0) {
            return Err(Error::input(format!(
                "{how:?}: steps must be positive, relaxation between 0 and 2, the power above 1 and up to 2"
            )));
        }
        let (nodes, count, side) = (self.nodes(), self.count(), self.coordinates());
        if count == 0 {
            return Ok(());
        }
        let slices =
            momentum.par_chunks_mut(count * side).zip(dual_density.par_chunks_mut(count)).zip(dual_momentum.par_chunks_mut(count * side));
        slices.enumerate().for_each(|(slice, ((momentum, dual_density), dual_momentum))| {
            let ends = [before, after].map(|table| &table[slice * nodes..(slice + 2) * nodes]);
            let potential = &potential[slice * nodes..][..nodes];
            let chunks = momentum.par_chunks_mut(CHUNK * side).zip(dual_density.par_chunks_mut(CHUNK));
            chunks.zip(dual_momentum.par_chunks_mut(CHUNK * side)).enumerate().for_each(|(chunk, ((m, r), d))| {
                let first = chunk * CHUNK;
                match side {
                    1 => self.step_sized::<2>(how, [weights, sizes, mobility], ends, potential, first, m, r, d),
                    2 => self.step_sized::<3>(how, [weights, sizes, mobility], ends, potential, first, m, r, d),
                    _ => self.step_sized::<4>(how, [weights, sizes, mobility], ends, potential, first, m, r, d),
                }
            });
        });
        Ok(())
    }

    fn step_sized<const S: usize>(
        &self,
        how: Step,
        [weights, sizes, mobility]: [&[f64]; 3],
        ends: [&[f64]; 2],
        potential: &[f64],
        first: usize,
        momentum: &mut [f64],
        dual_density: &mut [f64],
        dual_momentum: &mut [f64],
    ) {
        let Step { primal, dual, relaxation, power } = how;
        let (nodes, side, share) = (self.nodes(), S - 1, 0.5 / S as f64);
        let [before, after] = ends;
        let conjugate = power / (power - 1.0);
        let each = momentum.chunks_exact_mut(side).zip(dual_density).zip(dual_momentum.chunks_exact_mut(side));
        for (offset, ((m, r), d)) in each.enumerate() {
            let element = first + offset;
            let slope = self.slope::<S>(potential, element);
            let (size, mobility) = (sizes[element], mobility[element]);
            // in coordinates where the projection is orthogonal: momenta are multiplied by the root of this, and so are their weights
            let stretch = mobility / size;
            let mut mean = 0.0;
            for &corner in &self.elements.indices[element * S..][..S] {
                let corner = corner as usize;
                mean += 2.0 * (after[corner] + after[corner + nodes]) - (before[corner] + before[corner + nodes]);
            }
            let a = *r + dual / size * (share * mean);
            let (mut b, mut moved, mut square, mut last) = ([0.0; S], [0.0; S], 0.0, 0.0);
            for k in 0..side {
                last += d[k] * d[k];
                moved[k] = mobility * (slope[k] - primal * d[k]);
                b[k] = d[k] + dual / mobility * (m[k] + 2.0 * moved[k]);
                square += b[k] * b[k];
            }
            let square = stretch * square;
            let (alpha, scale) = if power == 2.0 {
                nearest_square(a, square, stretch * weights[element], (stretch * last).sqrt())
            } else {
                nearest(a, square, weights[element] * stretch.powf(0.5 * power), conjugate)
            };
            *r += relaxation * (alpha - *r);
            for k in 0..side {
                d[k] += relaxation * (scale * b[k] - d[k]);
                m[k] += relaxation * moved[k];
            }
        }
    }

    /// Momenta of least `Σ a |M|^2 / (2 c)` with `div M = -rate` in each slice: `M = c grad u`. `conductivity` (slices, count) is
    /// positive; `rate` (slices, nodes) is integrated over the nodes' areas and adds up to zero on each component.
    ///
    /// ```
    /// # use beltrami::{Control, shrink::Elements, transport::Domain};
    /// # let edge = Elements::new(2, 2, vec![0, 1], vec![1.0], vec![1.0])?; // one edge of length 1, masses 1/2
    /// # let domain = Domain::new(edge, vec![0.5, 0.5], None, &Control::default())?;
    /// let mut m = [0.0];
    /// domain.optimal_momentum(&[7.0], &[-2.0, 2.0], &mut m, &Control::default())?; // two units of mass go over, whatever it costs
    /// assert!((m[0] - 2.0).abs() < 1e-14);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit; [`Error::Numerical`] if a conductivity is not positive; [`Error::Cancelled`] on request.
    pub fn optimal_momentum(&self, conductivity: &[f64], rate: &[f64], out: &mut [f64], control: &Control) -> Result<()> {
        let slices = self.slices(rate.len())?;
        let (nodes, count, side) = (self.nodes(), self.count(), self.coordinates());
        self.expect("the conductivities", conductivity.len(), slices * count)?;
        self.expect("the momenta", out.len(), conductivity.len() * side)?;
        if count == 0 {
            return Ok(());
        }
        out.par_chunks_mut(count * side).enumerate().try_for_each_init(
            || (None, Scratch::refining(), vec![0.0; nodes], vec![0.0; nodes]),
            |(factor, scratch, b, u), (slice, out)| {
                let c = &conductivity[slice * count..][..count];
                let matrix = self.stiffness(|element| c[element], true);
                match factor {
                    None => *factor = Some(Cholesky::with_symbolic(&self.symbolic, &matrix, control)?),
                    Some(factor) => factor.refactor(&matrix, control)?,
                }
                b.copy_from_slice(&rate[slice * nodes..][..nodes]);
                self.make_compatible(b);
                if let Some(factor) = factor {
                    factor.solve_block_into(b, 1, u, scratch)?;
                }
                match side {
                    1 => self.slopes::<2>(u, out),
                    2 => self.slopes::<3>(u, out),
                    _ => self.slopes::<4>(u, out),
                }
                for (out, &c) in out.chunks_exact_mut(side).zip(c) {
                    out.iter_mut().for_each(|x| *x *= c);
                }
                control.check()
            },
        )
    }
}

/// The nearest point with `α + |β|^2 / (2 w) <= 0`: α, and the factor of β. `square` is |β|^2, `guess` a length near that of the answer.
///
/// With s the length of the answer, `f(s) = (s / w) (a + s^2 / (2 w)) + s - |b|` vanishes. It is convex and increasing right of where its
/// first factor is positive, so Newton from the right comes down to the root; a guess left of it, where f increases, leaps over to the right.
#[inline]
fn nearest_square(a: f64, square: f64, w: f64, guess: f64) -> (f64, f64) {
    let v = 1.0 / w;
    if a + 0.5 * v * square <= 0.0 {
        return (a, 1.0);
    }
    let length = square.sqrt();
    if length <= 1e-150 {
        return (a.min(0.0), 1.0);
    }
    let (slope, cube) = (1.0 + a * v, 0.5 * v * v);
    let upper = if slope > 1.0 { length / slope } else { length };
    let mut s = upper;
    if guess < upper && 3.0 * cube * guess * guess + slope > 0.25 {
        s = guess;
    }
    for _ in 0..200 {
        let step = ((cube * s * s + slope) * s - length) / (3.0 * cube * s * s + slope);
        s = (s - step).min(upper);
        if step.abs() <= 1e-10 * s {
            break; // the next step would be below 1e-20: Newton squares the error
        }
    }
    (-0.5 * v * s * s, s / length)
}

/// The same for `α + w^(1 - r) |β|^r / r <= 0`, r at least 2.
#[inline]
fn nearest(a: f64, square: f64, w: f64, r: f64) -> (f64, f64) {
    let length = square.sqrt();
    let c = w.powf(1.0 - r) / r;
    if a + c * length.powf(r) <= 0.0 {
        return (a, 1.0);
    }
    if length <= 1e-150 {
        return (a.min(0.0), 1.0);
    }
    // (a + c s^r) c r s^(r-1) + s - length
    let mut s = length;
    if a >= 0.0 {
        s = s.min((length / (c * c * r)).powf(1.0 / (2.0 * r - 1.0)));
    }
    for _ in 0..200 {
        let power = s.powf(r - 2.0);
        let (low, high) = (c * r * power * s, c * power * s * s);
        let value = (a + high) * low + s - length;
        let step = value / (low * low + (a + high) * c * r * (r - 1.0) * power + 1.0);
        s -= step;
        if !(step > 1e-15 * s) {
            break;
        }
    }
    (-c * s.powf(r), s / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A projection's remainder is a multiple of the constraint's gradient, and the constraint holds with equality.
    #[test]
    fn projections_satisfy_their_conditions() {
        for &w in &[1e-3, 1.0, 50.0, 1e6] {
            for &a in &[-1e3, -2.0, -0.1, 0.0, 0.3, 40.0] {
                for &b in &[0.0, 1e-8, 0.2, 1.0, 70.0f64] {
                    for &(r, guess) in &[(2.0, 0.0), (2.0, 0.01), (2.0, 0.9), (2.0, 1e3), (3.0, 0.0), (6.0, 0.0)] {
                        let (alpha, scale) = if r == 2.0 { nearest_square(a, b * b, w, guess) } else { nearest(a, b * b, w, r) };
                        let (c, s) = (f64::powf(w, 1.0 - r) / r, scale * b);
                        if a + c * b.powf(r) <= 0.0 {
                            assert_eq!((alpha, scale), (a, 1.0));
                            continue;
                        }
                        let size = 1.0 + a.abs() + b;
                        assert!((alpha + c * s.powf(r)).abs() <= 1e-9 * size, "constraint: {a} {b} {w} {r}");
                        let multiplier = a - alpha;
                        assert!(multiplier >= -1e-12 * size, "sign: {a} {b} {w} {r}");
                        assert!((b - s - multiplier * c * r * s.powf(r - 1.0)).abs() <= 1e-9 * size, "direction: {a} {b} {w} {r}");
                    }
                }
            }
        }
    }
}
