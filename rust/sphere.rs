//! Inner loops of conformal maps to the unit sphere: the gradient of E - A, Möbius translations.
//!
//! E is the Dirichlet energy of a map of the vertices to the sphere, A the signed area of the image polyhedron.

use crate::control::Control;
use crate::error::{Error, Result};
use crate::vector::{cross, dot, minus};
use rayon::prelude::*;

/// What [`excess_gradient`] finds.
#[derive(Debug, Clone, PartialEq)]
pub struct ExcessGradient {
    /// Gradient of E - A by the positions, three numbers per vertex.
    pub gradient: Vec<f64>,
    /// Lumped (unsigned) image area of each vertex.
    pub areas: Vec<f64>,
    /// E - A.
    pub excess: f64,
}

const FACES: usize = 2048; // of one parallel task
const POINTS: usize = 4096;

#[derive(Clone, Copy, Default)]
struct Share {
    corners: [[f64; 3]; 3],
    area: f64,
    excess: f64,
}

fn share(p: [[f64; 3]; 3], cotangents: &[f64], weight: Option<f64>) -> Share {
    let edges = [minus(p[2], p[1]), minus(p[0], p[2]), minus(p[1], p[0])];
    let normal = cross(edges[2], edges[1].map(|x| -x));
    let double = dot(normal, normal).sqrt();
    let turned = dot(p[0], normal);
    let sign = weight.unwrap_or(if turned > 0.0 { 1.0 } else { -f64::from(turned < 0.0) });
    let factor = if double > 0.0 { 0.5 * sign / double } else { 0.0 };
    let normal = normal.map(|x| x * factor);
    let mut out = Share { area: 0.5 * double * weight.unwrap_or(1.0), excess: -0.5 * sign * double, ..Share::default() };
    for k in 0..3 {
        out.excess += 0.25 * cotangents[k] * dot(edges[k], edges[k]);
        // Corner k is the end of edge k + 1 and the start of edge k + 2; edge k lies opposite to it.
        let (next, last) = ((k + 1) % 3, (k + 2) % 3);
        let by_area = cross(normal, edges[k]);
        for axis in 0..3 {
            let by_energy = 0.5 * (cotangents[next] * edges[next][axis] - cotangents[last] * edges[last][axis]);
            out.corners[k][axis] = by_energy - by_area[axis];
        }
    }
    out
}

/// Gradient of E - A, face by face from edge differences.
///
/// `positions` has three numbers per vertex, `cotangents` three per face, of the source's corners. Areas count with the sign of
/// p · ((q - p) x (r - p)); with `weights` (one per face) unsigned and times the weight, and `cotangents` must hold the weights already.
///
/// ```
/// use beltrami::{Control, sphere::excess_gradient};
/// let octant = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
/// let cotangent = (1.0f64 / 3.0).sqrt(); // of an equilateral triangle, which this map keeps
/// let found = excess_gradient(&octant, &[[0, 1, 2]], &[cotangent; 3], None, &Control::default())?;
/// assert!(found.excess.abs() < 1e-15 && found.gradient.iter().all(|g| g.abs() < 1e-15));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if lengths do not fit or a face names a vertex that is not there; [`Error::Cancelled`] on request.
pub fn excess_gradient(
    positions: &[f64],
    faces: &[[u32; 3]],
    cotangents: &[f64],
    weights: Option<&[f64]>,
    control: &Control,
) -> Result<ExcessGradient> {
    let count = positions.len() / 3;
    if positions.len() != 3 * count || cotangents.len() != 3 * faces.len() || weights.is_some_and(|w| w.len() != faces.len()) {
        return Err(Error::input("positions, faces, cotangents and weights do not fit together"));
    }
    if let Some(face) = faces.iter().position(|face| face.iter().any(|&vertex| vertex as usize >= count)) {
        return Err(Error::input(format!("face {face} names a vertex that is not there; there are {count}")));
    }
    control.check()?;
    let at = |vertex: u32| {
        let start = 3 * vertex as usize;
        [positions[start], positions[start + 1], positions[start + 2]]
    };
    let shares: Vec<Share> = faces
        .par_iter()
        .with_min_len(FACES)
        .enumerate()
        .map(|(face, corners)| share(corners.map(at), &cotangents[3 * face..3 * face + 3], weights.map(|w| w[face])))
        .collect();
    control.check()?;
    let mut out = ExcessGradient { gradient: vec![0.0; positions.len()], areas: vec![0.0; count], excess: 0.0 };
    for (corners, share) in faces.iter().zip(&shares) {
        for (&vertex, part) in corners.iter().zip(&share.corners) {
            let vertex = vertex as usize;
            out.areas[vertex] += share.area / 3.0;
            out.gradient[3 * vertex..3 * vertex + 3].iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        }
        out.excess += share.excess;
    }
    Ok(out)
}

/// The Möbius translation p -> (1 - |c|²) (p + c) / |p + c|² + c of unit vectors, and the weighted sum of the images.
///
/// ```
/// let (moved, sum) = beltrami::sphere::translated(&[0.0, 0.0, 1.0], [0.0, 0.0, 0.5], &[2.0])?;
/// assert_eq!((moved, sum), (vec![0.0, 0.0, 1.0], [0.0, 0.0, 2.0]));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if lengths do not fit or |c| >= 1.
pub fn translated(positions: &[f64], c: [f64; 3], weights: &[f64]) -> Result<(Vec<f64>, [f64; 3])> {
    let square = dot(c, c);
    if positions.len() != 3 * weights.len() || square.is_nan() || square >= 1.0 {
        return Err(Error::input("positions and weights do not fit together, or the translation is not inside the ball"));
    }
    let mut moved = vec![0.0; positions.len()];
    let sums: Vec<[f64; 3]> = moved
        .par_chunks_mut(3 * POINTS)
        .zip(positions.par_chunks(3 * POINTS))
        .zip(weights.par_chunks(POINTS))
        .map(|((moved, positions), weights)| {
            let mut sum = [0.0; 3];
            for ((out, p), &weight) in moved.chunks_exact_mut(3).zip(positions.chunks_exact(3)).zip(weights) {
                let d = [p[0] + c[0], p[1] + c[1], p[2] + c[2]];
                let factor = (1.0 - square) / dot(d, d);
                let image = [d[0] * factor + c[0], d[1] * factor + c[1], d[2] * factor + c[2]];
                let length = dot(image, image).sqrt();
                for axis in 0..3 {
                    out[axis] = image[axis] / length;
                    sum[axis] += weight * out[axis];
                }
            }
            sum
        })
        .collect();
    let total = sums.iter().fold([0.0; 3], |total, sum| [total[0] + sum[0], total[1] + sum[1], total[2] + sum[2]]);
    Ok((moved, total))
}
