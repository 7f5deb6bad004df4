//! Geodesic distance by the heat method (Crane, Weischedel, Wardetzky: Geodesics in heat, ACM TOG 32, 2013).
//!
//! 1. heat flows from the sources for a short time, `(M + t L) u = δ`; 2. `X = -grad u / |grad u|` on each simplex;
//! 3. a Poisson equation recovers the distance, `L φ = G^T A X`. On shapes with boundary u is the sum of the flows with
//!    natural and with zero boundary values, which follows the boundary less than either.
//!
//! A positive weight of an edge (an angle beyond the Delaunay condition, also one at the boundary) can make u negative and turn X round:
//! meshes that have one are handed to their tufted cover, which has none (Sharp & Crane 2020). Among many sources X is 0 where all corners
//! are sources, and φ is 0 at each of them.

use crate::control::Control;
use crate::error::{Error, Result};
use crate::operators::{cotangent_operators, gradient, has_positive_weights};
use crate::shape::{Topology, TriangleMesh, tufted};
use crate::solvers::{Cholesky, LaplacianSolver};
use crate::sparse::{CHUNK, Csr};
use rayon::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

/// Heat below this has lost digits to underflow; a longer time shows the direction there.
const FADED: f64 = 1e-250;
/// Between one time and the next longer one.
const LONGER: f64 = 64.0;
const TIMES: usize = 12;
/// Beyond this factor the mass vanishes beside the stiffness and rounding decides the answer.
const MOST_TIME: f64 = 1e8;

/// What the heat method needs of a shape.
#[derive(Debug, Clone)]
pub struct HeatOperators {
    /// (n, n), positive semidefinite, rows sum to zero.
    pub stiffness: Csr,
    /// (n), not negative.
    pub mass: Vec<f64>,
    /// G, (m k, n): k coordinates of the gradient on each of m simplices.
    pub gradient: Csr,
    /// (m), areas (volumes) of the simplices.
    pub areas: Vec<f64>,
    /// Mean length of the edges; the time is its square times a factor.
    pub spacing: f64,
    /// Which vertices lie on the boundary, (n).
    pub boundary: Vec<bool>,
    /// Positions of the vertices and how many numbers each has: a better order for the factorizations.
    pub coordinates: Option<(Vec<f64>, usize)>,
}

#[derive(Debug)]
struct Heat {
    natural: Cholesky,
    zero: Option<Cholesky>,
}

/// Distances on one shape from as many sets of sources as one likes: the factorizations are kept.
///
/// ```
/// use beltrami::{Control, geodesic::HeatMethod, shape::make};
/// let sphere = make::sphere(16, 1.0)?;
/// let heat = HeatMethod::on_mesh(&sphere, 1.0, &Control::default())?;
/// let distance = heat.distance(&[0], &Control::default())?;
/// let farthest = distance.iter().fold(0.0, |a: f64, &b| a.max(b));
/// assert!((farthest - std::f64::consts::PI).abs() < 0.1);
/// # Ok::<(), beltrami::Error>(())
/// ```
#[derive(Debug)]
pub struct HeatMethod {
    shape: HeatOperators,
    transposed: Csr,
    time: f64,
    heats: Mutex<Vec<Arc<Heat>>>,
    poisson: LaplacianSolver,
}

impl HeatMethod {
    /// Factors what the method needs. `time_factor`: the time in units of the squared spacing; larger smooths.
    ///
    /// # Errors
    /// [`Error::Input`] if sizes do not fit or the time is not positive; [`Error::Numerical`] if a matrix is not positive
    /// definite; [`Error::Cancelled`] on request.
    pub fn new(shape: HeatOperators, time_factor: f64, control: &Control) -> Result<Self> {
        let (n, m) = (shape.stiffness.rows(), shape.areas.len());
        if shape.mass.len() != n
            || shape.boundary.len() != n
            || shape.gradient.columns() != n
            || m == 0
            || !shape.gradient.rows().is_multiple_of(m)
        {
            return Err(Error::input(format!(
                "operators do not fit together: {n} rows of the stiffness, {} masses, {} boundary flags, a {} x {} gradient on {m} simplices",
                shape.mass.len(),
                shape.boundary.len(),
                shape.gradient.rows(),
                shape.gradient.columns()
            )));
        }
        let time = time_factor * shape.spacing * shape.spacing;
        if !(time > 0.0 && time.is_finite() && time_factor <= MOST_TIME) {
            return Err(Error::input(format!(
                "the time of the heat flow is {time:e} (factor {time_factor:e}, spacing {:e}); the factor must be positive and at most {MOST_TIME:e}",
                shape.spacing
            )));
        }
        let coordinates = shape.coordinates.as_ref().map(|(numbers, width)| (numbers.as_slice(), *width));
        let poisson = LaplacianSolver::new(&shape.stiffness, &shape.mass, coordinates, control)?;
        let transposed = shape.gradient.transpose();
        let method = HeatMethod { shape, transposed, time, heats: Mutex::new(Vec::new()), poisson };
        method.heat(0, control)?;
        Ok(method)
    }

    /// The method on a mesh: with its cotangent operators, or those of its tufted cover where a weight of theirs is positive.
    ///
    /// # Errors
    /// Those of [`HeatMethod::new`], of [`cotangent_operators`] and of [`tufted`].
    pub fn on_mesh(mesh: &TriangleMesh, time_factor: f64, control: &Control) -> Result<Self> {
        let operators = cotangent_operators(mesh)?;
        let mut boundary = vec![false; mesh.vertex_count()];
        for curve in Topology::new(mesh)?.boundary_loops() {
            curve.vertices.iter().for_each(|&vertex| boundary[vertex as usize] = true);
        }
        let coordinates = Some((mesh.vertices().to_vec(), mesh.dimension()));
        let shape = if has_positive_weights(&operators.stiffness) {
            let cover = tufted(mesh, control)?;
            HeatOperators {
                gradient: cover.gradient(),
                areas: cover.face_areas(),
                stiffness: cover.stiffness(),
                mass: cover.mass(),
                spacing: cover.spacing(),
                boundary,
                coordinates,
            }
        } else {
            HeatOperators {
                gradient: gradient(mesh)?,
                areas: mesh.face_areas(),
                stiffness: operators.stiffness,
                mass: operators.mass,
                spacing: operators.spacing,
                boundary,
                coordinates,
            }
        };
        HeatMethod::new(shape, time_factor, control)
    }

    /// The time of the heat flow.
    pub fn time(&self) -> f64 {
        self.time
    }

    fn heat(&self, step: usize, control: &Control) -> Result<Arc<Heat>> {
        // No lock is held while factors are made: a worker that waits may pick up another caller's job.
        loop {
            let made = {
                let heats = self.heats.lock().unwrap_or_else(PoisonError::into_inner);
                if let Some(heat) = heats.get(step) {
                    return Ok(heat.clone());
                }
                heats.len()
            };
            let time = self.time * LONGER.powi(made as i32);
            // Vertices of no triangle have no mass: a 1 keeps them apart and the matrix definite.
            let diagonal: Vec<f64> = self.shape.mass.iter().map(|&mass| if mass > 0.0 { mass } else { 1.0 }).collect();
            let matrix = self.shape.stiffness.combine(time, &Csr::from_diagonal(&diagonal), 1.0)?;
            let coordinates = self.shape.coordinates.as_ref().map(|(numbers, width)| (numbers.as_slice(), *width));
            let natural = Cholesky::new(&matrix, coordinates, control)?;
            let boundary = &self.shape.boundary;
            let zero = if boundary.contains(&true) {
                Some(Cholesky::with_symbolic(&natural.symbolic(), &apart(&matrix, boundary)?, control)?)
            } else {
                None
            };
            let mut heats = self.heats.lock().unwrap_or_else(PoisonError::into_inner);
            if heats.len() == made {
                heats.push(Arc::new(Heat { natural, zero }));
            }
        }
    }

    /// Distance to the nearest source; 0 at the sources, infinite on components without one.
    ///
    /// # Errors
    /// [`Error::Input`] if there is no source or one is no vertex; [`Error::Cancelled`] on request.
    pub fn distance(&self, sources: &[usize], control: &Control) -> Result<Vec<f64>> {
        let n = self.shape.mass.len();
        if sources.is_empty() {
            return Err(Error::input("there is no source; name at least one vertex"));
        }
        if let Some(wrong) = sources.iter().find(|&&source| source >= n) {
            return Err(Error::input(format!("source {wrong} is no vertex; the shape has {n}, numbered from 0")));
        }
        let labels = self.poisson.labels();
        let mut is_source = vec![false; n];
        let mut counts = vec![0usize; self.poisson.components()];
        for &source in sources {
            counts[labels[source] as usize] += usize::from(!is_source[source]);
            is_source[source] = true;
        }
        let reached: Vec<bool> = labels.iter().map(|&label| counts[label as usize] > 0).collect();
        let mut flux = self.flux(&is_source, &reached, control)?;
        let mut distance = if counts.iter().any(|&count| count > 1) {
            // φ = 0 at every source: the Poisson equation for the others alone
            let fixed: Vec<bool> = is_source.iter().zip(&reached).map(|(source, reached)| *source || !reached).collect();
            let whole = self.shape.stiffness.combine(1.0, &Csr::from_diagonal(&vec![0.0; n]), 1.0)?;
            let symbolic = self.heat(0, control)?.natural.symbolic();
            flux.iter_mut().zip(&fixed).filter(|(_, fixed)| **fixed).for_each(|(flux, _)| *flux = 0.0);
            Cholesky::with_symbolic(&symbolic, &apart(&whole, &fixed)?, control)?.solve(&flux)?
        } else {
            // one source leaves only a constant to find, on each component
            let mut distance = self.poisson.solve(&flux, 1, control)?;
            let mut starts = vec![0.0; counts.len()];
            sources.iter().for_each(|&source| starts[labels[source] as usize] = distance[source]);
            distance.iter_mut().zip(labels).for_each(|(distance, &label)| *distance -= starts[label as usize]);
            distance
        };
        if distance.iter().any(|number| !number.is_finite()) {
            return Err(Error::numerical("the distances overflow; rescale the shape"));
        }
        for ((distance, &source), &reached) in distance.iter_mut().zip(&is_source).zip(&reached) {
            *distance = match (source, reached) {
                (true, _) => 0.0,
                (false, true) => distance.max(0.0),
                (false, false) => f64::INFINITY,
            };
        }
        Ok(distance)
    }

    /// What a source emits for all to be equally hot a little way off: 1, and at the boundary its angle over π, because both flows
    /// together are twice as hot as on a shape without boundary, and at a straight edge the natural one alone is.
    fn emission(&self, vertex: usize) -> f64 {
        let width = self.shape.gradient.rows() / self.shape.areas.len();
        let mut simplices: Vec<usize> = self.transposed.row(vertex).0.iter().map(|&row| row as usize / width).collect();
        simplices.dedup();
        if !self.shape.boundary[vertex] || simplices.is_empty() {
            return 1.0;
        }
        let mut angle = 0.0;
        for simplex in simplices {
            let rows = simplex * width..(simplex + 1) * width;
            let mut corners: Vec<u32> = rows.clone().flat_map(|row| self.shape.gradient.row(row).0.iter().copied()).collect();
            corners.sort_unstable();
            corners.dedup();
            corners.retain(|&corner| corner as usize != vertex);
            let &[b, c] = corners.as_slice() else { return 1.0 }; // no triangle
            let (mut bb, mut bc, mut cc) = (0.0, 0.0, 0.0);
            for row in rows {
                let (columns, values) = self.shape.gradient.row(row);
                let [x, y] = [b, c].map(|corner| columns.binary_search(&corner).map_or(0.0, |at| values[at]));
                (bb, bc, cc) = (bb + x * x, bc + x * y, cc + y * y);
            }
            // the two hats' gradients are perpendicular to the edges at the vertex, and their cross product is 1 / (2 area)
            let cross = (bb * cc - bc * bc).max(0.0).sqrt();
            angle += cross.atan2(-bc) * (2.0 * self.shape.areas[simplex] * cross);
        }
        (angle / std::f64::consts::PI).clamp(0.1, 2.0)
    }

    /// G^T A X of the unit field X = -grad u / |grad u|, which is 0 on simplices between sources only.
    fn flux(&self, is_source: &[bool], reached: &[bool], control: &Control) -> Result<Vec<f64>> {
        let (n, m) = (self.shape.mass.len(), self.shape.areas.len());
        let width = self.shape.gradient.rows() / m;
        let impulse: Vec<f64> =
            is_source.iter().enumerate().map(|(vertex, source)| if *source { self.emission(vertex) } else { 0.0 }).collect();
        let inner: Vec<f64> =
            impulse.iter().zip(&self.shape.boundary).map(|(&heat, &boundary)| if boundary { 0.0 } else { heat }).collect();
        let mut field = vec![0.0; m * width];
        let between = |simplex: usize| {
            let mut rows = simplex * width..(simplex + 1) * width;
            rows.all(|row| self.shape.gradient.row(row).0.iter().all(|&corner| is_source[corner as usize]))
        };
        let mut known: Vec<bool> = (0..m).into_par_iter().with_min_len(CHUNK).map(between).collect();
        for step in 0..TIMES {
            control.check()?;
            let factors = self.heat(step, control)?;
            let mut heat = factors.natural.solve(&impulse)?;
            if let Some(zero) = &factors.zero {
                heat.iter_mut().zip(zero.solve(&inner)?).for_each(|(heat, more)| *heat += more);
            }
            let slope = self.shape.gradient.multiply(&heat)?;
            let spacing = self.shape.spacing;
            field
                .par_chunks_mut(CHUNK * width)
                .zip(known.par_chunks_mut(CHUNK))
                .zip(slope.par_chunks(CHUNK * width).zip(self.shape.areas.par_chunks(CHUNK)))
                .for_each(|((field, known), (slope, areas))| {
                    for (((field, known), slope), &area) in
                        field.chunks_exact_mut(width).zip(known).zip(slope.chunks_exact(width)).zip(areas)
                    {
                        let largest = slope.iter().fold(0.0, |a: f64, &b| a.max(b.abs()));
                        if *known || largest * spacing <= FADED {
                            continue;
                        }
                        let norm = slope.iter().map(|s| (s / largest) * (s / largest)).sum::<f64>().sqrt();
                        field.iter_mut().zip(slope).for_each(|(x, s)| *x = -area * (s / largest) / norm);
                        *known = true;
                    }
                });
            let faded =
                (0..n).into_par_iter().with_min_len(CHUNK).any(|i| reached[i] && self.shape.mass[i] > 0.0 && heat[i].abs() <= FADED);
            if !faded {
                return self.transposed.multiply(&field);
            }
        }
        Err(Error::numerical(format!(
            "heat does not reach all of the shape even after {:e} times the time {:e}; take a larger time_factor",
            LONGER.powi(TIMES as i32 - 1),
            self.time
        )))
    }
}

/// The matrix without the entries that join a fixed unknown to another; fixed unknowns keep a positive diagonal.
fn apart(matrix: &Csr, fixed: &[bool]) -> Result<Csr> {
    let values = (0..matrix.rows())
        .into_par_iter()
        .with_min_len(CHUNK)
        .flat_map_iter(|row| {
            let (columns, values) = matrix.row(row);
            columns.iter().zip(values).map(move |(&column, &value)| match column as usize {
                column if column == row => {
                    if fixed[row] && value <= 0.0 {
                        1.0
                    } else {
                        value
                    }
                }
                column if fixed[row] || fixed[column] => 0.0,
                _ => value,
            })
        })
        .collect();
    Csr::new(matrix.rows(), matrix.columns(), matrix.starts().to_vec(), matrix.indices().to_vec(), values)
}
