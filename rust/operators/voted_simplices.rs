//! Operators on the simplices of a local mesh: sums over simplices, each counted by its votes.

use crate::error::{Error, Result};
use crate::sparse::{CHUNK, Csr};
use rayon::prelude::*;

/// A simplex flatter than this (its Gram determinant against the product of squared edges) has no gradient.
const FLAT: f64 = 1e-14;

/// The piecewise-linear element on one simplex of dimension 1 to 3 in R^D, in units of its longest first edge.
#[derive(Debug, Clone, Copy)]
pub(super) struct Element {
    /// Length of the unit.
    pub(super) unit: f64,
    /// Volume in units^d.
    volume: f64,
    pub(super) circumradius: f64,
    /// Products of the hat functions' gradients, in units^-2.
    products: [[f64; 4]; 4],
    /// Inverse of the edges' Gram matrix: gradient of hat b + 1 = Σ_a inverse[b][a] edge_a.
    pub(super) inverse: [[f64; 3]; 3],
}

#[allow(clippy::needless_range_loop)] // indices of small matrices, as they are written
impl Element {
    /// `None` for a simplex so flat that it has no gradients.
    pub(super) fn new(points: &[f64], ambient: usize, corners: &[u32]) -> Option<Element> {
        let d = corners.len() - 1;
        let origin = &points[corners[0] as usize * ambient..][..ambient];
        let other = |a: usize| &points[corners[a + 1] as usize * ambient..][..ambient];
        let mut unit = 0.0f64;
        for a in 0..d {
            for (x, o) in other(a).iter().zip(origin) {
                unit = unit.max((x - o).abs());
            }
        }
        if !(unit > 0.0 && unit.is_finite()) {
            return None;
        }
        let mut gram = [[0.0; 3]; 3];
        for i in 0..ambient {
            let mut edge = [0.0; 3];
            for (a, edge) in edge[..d].iter_mut().enumerate() {
                *edge = (other(a)[i] - origin[i]) / unit;
            }
            for a in 0..d {
                for b in 0..=a {
                    gram[a][b] += edge[a] * edge[b];
                }
            }
        }
        for a in 0..d {
            for b in a + 1..d {
                gram[a][b] = gram[b][a];
            }
        }
        let g = &gram;
        let (determinant, adjugate) = match d {
            1 => (g[0][0], [[1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]]),
            2 => (g[0][0] * g[1][1] - g[0][1] * g[0][1], [[g[1][1], -g[0][1], 0.0], [-g[0][1], g[0][0], 0.0], [0.0; 3]]),
            _ => {
                let minor = |a: usize, b: usize| {
                    let (r, s) = ((a + 1) % 3, (a + 2) % 3);
                    let (t, u) = ((b + 1) % 3, (b + 2) % 3);
                    g[r][t] * g[s][u] - g[r][u] * g[s][t]
                };
                let mut adjugate = [[0.0; 3]; 3];
                for a in 0..3 {
                    for b in 0..=a {
                        adjugate[a][b] = minor(a, b);
                        adjugate[b][a] = adjugate[a][b];
                    }
                }
                (g[0][0] * adjugate[0][0] + g[0][1] * adjugate[0][1] + g[0][2] * adjugate[0][2], adjugate)
            }
        };
        let bound: f64 = (0..d).map(|a| g[a][a]).product();
        if determinant.is_nan() || determinant <= FLAT * bound {
            return None;
        }
        let inverse = adjugate.map(|row| row.map(|x| x / determinant));
        let mut products = [[0.0; 4]; 4];
        for a in 0..d {
            for b in 0..d {
                products[a + 1][b + 1] = inverse[a][b];
            }
        }
        for a in 0..d {
            let sum: f64 = inverse[a][..d].iter().sum();
            products[0][a + 1] = -sum;
            products[a + 1][0] = -sum;
            products[0][0] += sum;
        }
        // circumcentre c with 2 G c = diag G, in the basis of the edges; |c|² = diag G · c / 2
        let mut square = 0.0;
        for a in 0..d {
            for b in 0..d {
                square += g[a][a] * inverse[a][b] * g[b][b] / 4.0;
            }
        }
        let volume = determinant.sqrt() / [1.0, 2.0, 6.0][d - 1];
        Some(Element { unit, volume, circumradius: unit * square.max(0.0).sqrt(), products, inverse })
    }
}

/// The simplices of a local mesh on their points, ready for assembly.
///
/// Everything here is a sum over simplices, each counted votes / (d + 1) times.
#[derive(Debug, Clone, Copy)]
pub struct VotedSimplices<'a> {
    points: &'a [f64],
    ambient: usize,
    dimension: usize,
    corners: &'a [u32],
    votes: &'a [u8],
    stretch: Option<&'a [f64]>,
}

impl<'a> VotedSimplices<'a> {
    /// Simplices of `dimension` + 1 corners each on `points` of `ambient` coordinates each.
    ///
    /// ```
    /// use beltrami::operators::VotedSimplices;
    /// let square = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0];
    /// let mesh = VotedSimplices::new(&square, 2, 2, &[0, 1, 2, 1, 2, 3], &[3, 3])?;
    /// assert!((mesh.mass()?.iter().sum::<f64>() - 1.0).abs() < 1e-15);
    /// assert!(mesh.stiffness()?.diagonal().iter().all(|entry| (entry - 1.0).abs() < 1e-15));
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if the arrays do not fit together, a corner is no point, or a dimension is not supported.
    pub fn new(points: &'a [f64], ambient: usize, dimension: usize, corners: &'a [u32], votes: &'a [u8]) -> Result<Self> {
        if !(1..=3).contains(&dimension) || ambient < dimension || !points.len().is_multiple_of(ambient) {
            return Err(Error::input(format!(
                "simplices of dimension {dimension} on {} coordinates in R^{ambient}; the dimension must be 1 to 3 and at most D",
                points.len()
            )));
        }
        if corners.len() != votes.len() * (dimension + 1) {
            return Err(Error::input(format!(
                "{} corners and {} votes do not make simplices of dimension {dimension}",
                corners.len(),
                votes.len()
            )));
        }
        let count = points.len() / ambient;
        if let Some(at) = corners.par_iter().with_min_len(CHUNK).position_first(|&corner| corner as usize >= count) {
            return Err(Error::input(format!("simplex {} has corner {}, the cloud has {count} points", at / (dimension + 1), corners[at])));
        }
        Ok(VotedSimplices { points, ambient, dimension, corners, votes, stretch: None })
    }

    /// The same, each simplex counted so many times more in every sum ([`LocalMesh::stretch`](super::LocalMesh::stretch)).
    ///
    /// ```
    /// use beltrami::operators::VotedSimplices;
    /// let mesh = VotedSimplices::new(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0], 2, 2, &[0, 1, 2], &[3])?.stretched(&[1.5])?;
    /// assert!((mesh.mass()?.iter().sum::<f64>() - 0.75).abs() < 1e-15);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if there are not as many numbers as simplices, or one is not positive.
    pub fn stretched(self, stretch: &'a [f64]) -> Result<Self> {
        match stretch.len() == self.votes.len() && stretch.iter().all(|&x| x > 0.0 && x.is_finite()) {
            true => Ok(VotedSimplices { stretch: Some(stretch), ..self }),
            false => Err(Error::input(format!("stretch has {} numbers; {} positive ones are needed", stretch.len(), self.votes.len()))),
        }
    }

    fn count(&self) -> usize {
        self.points.len() / self.ambient
    }

    fn corners(&self, simplex: usize) -> &[u32] {
        &self.corners[simplex * (self.dimension + 1)..][..self.dimension + 1]
    }

    fn share(&self, simplex: usize) -> f64 {
        f64::from(self.votes[simplex]) / (self.dimension + 1) as f64 * self.stretch.map_or(1.0, |stretch| stretch[simplex])
    }

    fn element(&self, simplex: usize) -> Option<Element> {
        Element::new(self.points, self.ambient, self.corners(simplex))
    }

    /// Which simplices each point is a corner of: starts (points + 1) and simplices, ascending.
    fn incidence(&self) -> (Vec<usize>, Vec<u32>) {
        let mut starts = vec![0; self.count() + 1];
        for &corner in self.corners {
            starts[corner as usize + 1] += 1;
        }
        for point in 0..self.count() {
            starts[point + 1] += starts[point];
        }
        let mut next = starts.clone();
        let mut simplices = vec![0; self.corners.len()];
        for (at, &corner) in self.corners.iter().enumerate() {
            simplices[next[corner as usize]] = (at / (self.dimension + 1)) as u32;
            next[corner as usize] += 1;
        }
        (starts, simplices)
    }

    /// Volume (length, area) of each simplex, not weighted by its votes.
    pub fn volumes(&self) -> Vec<f64> {
        (0..self.votes.len())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|simplex| self.element(simplex).map_or(0.0, |e| e.volume * e.unit.powi(self.dimension as i32)))
            .collect()
    }

    /// Lumped mass of each point: a (d + 1)-th of the volumes of its simplices.
    ///
    /// # Errors
    /// [`Error::Input`] if points are in no simplex, [`Error::Numerical`] if a mass underflows or is not finite; the points are named.
    pub fn mass(&self) -> Result<Vec<f64>> {
        let volumes = self.volumes();
        let mut mass = vec![0.0; self.count()];
        for (simplex, volume) in volumes.iter().enumerate() {
            let part = volume * self.share(simplex) / (self.dimension + 1) as f64;
            for &corner in self.corners(simplex) {
                mass[corner as usize] += part;
            }
        }
        let bad: Vec<u32> =
            (0..mass.len() as u32).filter(|&point| !(mass[point as usize] > 0.0 && mass[point as usize].is_finite())).collect();
        match bad.first() {
            None => Ok(mass),
            Some(&first) if mass[first as usize] == 0.0 && self.corners.contains(&first) => Err(Error::numerical(format!(
                "areas at {} points ({}) underflow to 0; measure the coordinates in smaller units",
                bad.len(),
                super::frames::name_some(&bad)
            ))),
            Some(&first) if mass[first as usize] == 0.0 => Err(Error::input(format!(
                "{} points ({}) are in no simplex; remove them or reach farther with a larger neighbors=",
                bad.len(),
                super::frames::name_some(&bad)
            ))),
            Some(_) => Err(Error::numerical(format!(
                "areas at {} points ({}) overflow; measure the coordinates in larger units",
                bad.len(),
                super::frames::name_some(&bad)
            ))),
        }
    }

    /// The stiffness matrix of piecewise-linear functions: symmetric to the last bit, positive semidefinite, rows sum to zero.
    ///
    /// # Errors
    /// [`Error::Numerical`] if an entry is not finite (volumes and curves measured in extreme units).
    pub fn stiffness(&self) -> Result<Csr> {
        self.assemble(|_, _| 1.0)
    }

    /// The stiffness of `∫ w |grad u|²` with the weight `w = exp(-potential)` averaged on each edge as if the potential were
    /// linear on it (the harmonic mean, Scharfetter and Gummel 1969): `w_i z / (1 - exp(-z))`, `z = potential_i - potential_j`.
    /// Potentials are taken relative to their least value, so the greatest weight is 1.
    ///
    /// # Errors
    /// [`Error::Input`] if `potential` has another length than the cloud or a value is not finite; [`Error::Numerical`].
    pub fn weighted_stiffness(&self, potential: &[f64]) -> Result<Csr> {
        if potential.len() != self.count() {
            return Err(Error::input(format!("the potential has {} values, the cloud has {} points", potential.len(), self.count())));
        }
        if let Some(at) = potential.iter().position(|value| !value.is_finite()) {
            return Err(Error::input(format!("the potential at point {at} is {}", potential[at])));
        }
        let least = potential.iter().copied().fold(f64::INFINITY, f64::min);
        self.assemble(|i, j| edge_weight(potential[i] - least, potential[j] - least))
    }

    fn assemble(&self, weight: impl Fn(usize, usize) -> f64 + Sync) -> Result<Csr> {
        let size = self.dimension + 1;
        let edges = size * (size - 1) / 2;
        // minus the product of two hat functions' gradients, integrated, for each pair of corners
        let mut pairs = vec![0.0; self.votes.len() * edges];
        pairs.par_chunks_mut(CHUNK * edges).enumerate().for_each(|(chunk, pairs)| {
            for (at, pairs) in pairs.chunks_exact_mut(edges).enumerate() {
                let simplex = chunk * CHUNK + at;
                let Some(element) = self.element(simplex) else { continue };
                let factor = self.share(simplex) * element.volume * element.unit.powi(self.dimension as i32 - 2);
                let corners = self.corners(simplex);
                let mut next = 0;
                for a in 0..size {
                    for b in a + 1..size {
                        pairs[next] = factor * element.products[a][b] * weight(corners[a] as usize, corners[b] as usize);
                        next += 1;
                    }
                }
            }
        });
        let (starts, simplices) = self.incidence();
        let matrix = Csr::by_rows(self.count(), self.count(), |point, entries: &mut Vec<(u32, u32, f64)>, indices, values| {
            entries.clear();
            for &simplex in &simplices[starts[point]..starts[point + 1]] {
                let corners = self.corners(simplex as usize);
                let numbers = &pairs[simplex as usize * edges..][..edges];
                let mut next = 0;
                for a in 0..size {
                    for b in a + 1..size {
                        if corners[a] as usize == point {
                            entries.push((corners[b], simplex, numbers[next]));
                        } else if corners[b] as usize == point {
                            entries.push((corners[a], simplex, numbers[next]));
                        }
                        next += 1;
                    }
                }
            }
            // by neighbour, then by simplex: both rows of a pair add up the same numbers in the same order
            entries.sort_unstable_by_key(|entry| (entry.0, entry.1));
            let mut diagonal = None;
            let mut total = 0.0;
            for group in entries.chunk_by(|x, y| x.0 == y.0) {
                let sum: f64 = group.iter().map(|entry| entry.2).sum();
                if group[0].0 as usize > point && diagonal.is_none() {
                    diagonal = Some(indices.len());
                    indices.push(point as u32);
                    values.push(0.0);
                }
                indices.push(group[0].0);
                values.push(sum);
                total += sum;
            }
            let diagonal = diagonal.unwrap_or_else(|| {
                indices.push(point as u32);
                values.push(0.0);
                indices.len() - 1
            });
            values[diagonal] = -total;
        });
        match matrix.values().iter().any(|value| !value.is_finite()) {
            true => Err(Error::numerical("an entry of the operator overflows; measure the coordinates in other units")),
            false => Ok(matrix),
        }
    }

    /// Mean length of the edges.
    pub fn mean_edge_length(&self) -> f64 {
        let size = self.dimension + 1;
        let sums: Vec<(f64, f64)> = (0..self.votes.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let mut sum = (0.0, 0.0);
                for simplex in chunk * CHUNK..((chunk + 1) * CHUNK).min(self.votes.len()) {
                    let corners = self.corners(simplex);
                    for a in 0..size {
                        for b in a + 1..size {
                            sum.0 += self.share(simplex) * self.distance(corners[a], corners[b]);
                            sum.1 += self.share(simplex);
                        }
                    }
                }
                sum
            })
            .collect();
        let (length, count) = sums.iter().fold((0.0, 0.0), |(x, y), (a, b)| (x + a, y + b));
        if count > 0.0 { length / count } else { 0.0 }
    }

    fn distance(&self, a: u32, b: u32) -> f64 {
        let (p, q) = (&self.points[a as usize * self.ambient..][..self.ambient], &self.points[b as usize * self.ambient..][..self.ambient]);
        let unit = p.iter().zip(q).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
        if unit == 0.0 {
            return 0.0;
        }
        unit * p.iter().zip(q).map(|(x, y)| ((x - y) / unit) * ((x - y) / unit)).sum::<f64>().sqrt()
    }

    /// Gradient of piecewise-linear functions, (simplices D) x points: rows s D ... s D + D - 1 give the gradient on simplex s.
    ///
    /// With A the volumes times votes / (d + 1), `stiffness = gradient^T A gradient`.
    ///
    /// # Errors
    /// [`Error::Numerical`] if an entry is not finite (coordinates in extreme units).
    pub fn gradient(&self) -> Result<Csr> {
        let (size, ambient) = (self.dimension + 1, self.ambient);
        let rows = self.votes.len() * ambient;
        let (mut indices, mut values) = (vec![0; rows * size], vec![0.0; rows * size]);
        let block = CHUNK * ambient * size;
        indices.par_chunks_mut(block).zip(values.par_chunks_mut(block)).enumerate().for_each(|(chunk, (indices, values))| {
            let simplices = indices.chunks_exact_mut(ambient * size).zip(values.chunks_exact_mut(ambient * size));
            for (at, (indices, values)) in simplices.enumerate() {
                let simplex = chunk * CHUNK + at;
                let corners = self.corners(simplex);
                let element = self.element(simplex);
                let mut order = [0, 1, 2, 3];
                order[..size].sort_unstable_by_key(|&a| corners[a]);
                let origin = &self.points[corners[0] as usize * ambient..][..ambient];
                for coordinate in 0..ambient {
                    let mut hats = [0.0; 4];
                    if let Some(element) = &element {
                        for a in 0..self.dimension {
                            let there = self.points[corners[a + 1] as usize * ambient + coordinate];
                            let edge = (there - origin[coordinate]) / element.unit / element.unit;
                            for b in 0..self.dimension {
                                hats[b + 1] += element.inverse[b][a] * edge;
                            }
                        }
                        hats[0] = -hats[1..].iter().sum::<f64>();
                    }
                    for (to, &a) in order[..size].iter().enumerate() {
                        indices[coordinate * size + to] = corners[a];
                        values[coordinate * size + to] = hats[a];
                    }
                }
            }
        });
        if values.par_iter().with_min_len(CHUNK).any(|value| !value.is_finite()) {
            return Err(Error::numerical("an entry of the gradient overflows; measure the coordinates in larger units"));
        }
        Ok(Csr::trusted(rows, self.count(), (0..=rows).map(|row| row * size).collect(), indices, values))
    }
}

/// Mean of `exp(-x)` between two potentials such that the flux through the edge is exact for a linear potential.
fn edge_weight(here: f64, there: f64) -> f64 {
    let (low, z) = if here <= there { (here, there - here) } else { (there, here - there) };
    // seen from the lower end: w (-z) / (1 - e^z) = w z / (e^z - 1)
    let bernoulli = if z < 1e-5 { 1.0 - z / 2.0 + z * z / 12.0 } else { z / z.exp_m1() };
    (-low).exp() * bernoulli
}
