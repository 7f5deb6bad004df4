//! The nearest point to each query in many dimensions, where a tree has nothing to prune: blocked matrix products.
//!
//! `|x - y|^2 / 2 - |x|^2 / 2 = |y|^2 / 2 - x . y` is computed for all pairs in single precision, as products of blocks that stay
//! in the cache. What rounding can hide is known; the few points within it of the least are compared again in double
//! precision, by the same sum as a [`KdTree`](super::KdTree) uses. So the answer is that of comparing with every point.

use super::knn::tame;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::first_not_finite;
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

const QUERIES: usize = 128; // of a task
const POINTS: usize = 512; // of a block

/// Index and distance of the nearest point to each query; of equally near ones the one of least index.
///
/// Meant for tens of dimensions and more; below about ten a [`KdTree`](super::KdTree) is faster.
///
/// ```
/// use beltrami::{Control, near::nearest_rows};
///
/// let (indices, distances) = nearest_rows(&[0.0, 0.0, 3.0, 4.0], 2, &[3.0, 3.0], &Control::default())?;
/// assert_eq!((indices, distances), (vec![1], vec![1.0]));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if `dimension` is 0 or divides the numbers of points or queries not, there is no point, or a coordinate is
/// not finite; [`Error::Numerical`] if a squared distance overflows; [`Error::Cancelled`].
pub fn nearest_rows(points: &[f64], dimension: usize, queries: &[f64], control: &Control) -> Result<(Vec<u32>, Vec<f64>)> {
    if dimension == 0 || !points.len().is_multiple_of(dimension) || !queries.len().is_multiple_of(dimension) {
        return Err(Error::input(format!(
            "{} and {} coordinates are no whole numbers of points in R^{dimension}",
            points.len(),
            queries.len()
        )));
    }
    let count = points.len() / dimension;
    if count == 0 || count > u32::MAX as usize / 2 {
        return Err(Error::input(format!("{count} points; from 1 to 2^31 - 1 are possible")));
    }
    for (name, numbers) in [("point", points), ("query", queries)] {
        if let Some(at) = first_not_finite(numbers) {
            return Err(Error::input(format!("coordinate {} of {name} {} is {}", at % dimension, at / dimension, numbers[at])));
        }
    }
    let most = points.iter().chain(queries).fold(0.0, |most: f64, number| most.max(number.abs()));
    let (scale, tamed) = (if most > 0.0 { 1.0 / most } else { 1.0 }, tame(most));
    let mean: Vec<f64> = (0..dimension)
        .map(|axis| points[axis..].iter().step_by(dimension).map(|number| number * scale).sum::<f64>() / count as f64)
        .collect();
    let single = |rows: &[f64]| -> Vec<f32> {
        rows.chunks_exact(dimension).flat_map(|row| row.iter().zip(&mean).map(|(number, mean)| (number * scale - mean) as f32)).collect()
    };
    let table = single(points);
    let halves: Vec<f32> = table.par_chunks_exact(dimension).map(|row| (norm(row).powi(2) / 2.0) as f32).collect();
    let longest = halves.iter().fold(0.0, |most: f32, &half| most.max(half));
    let longest = (2.0 * f64::from(longest)).sqrt();
    // twice what rounding of the numbers, of the products and of the sum can come to
    let relative = 2.0 * (dimension + 8) as f64 * f64::from(f32::EPSILON);
    let total = queries.len() / dimension;
    let done = AtomicUsize::new(0);
    let found: Vec<Vec<(u32, f64)>> = queries
        .par_chunks(QUERIES * dimension)
        .map_init(
            || vec![0f32; QUERIES * POINTS],
            |products, part| {
                let rows = single(part);
                let wide = part.len() / dimension;
                let slack: Vec<f32> = rows
                    .chunks_exact(dimension)
                    .map(|row| (relative * longest * (norm(row) + longest) + dimension as f64 * 1e-36) as f32)
                    .collect();
                let mut least = vec![f32::INFINITY; wide];
                let mut near: Vec<Vec<(f32, u32)>> = vec![Vec::new(); wide];
                for (block, first) in table.chunks(POINTS * dimension).zip((0..).step_by(POINTS)) {
                    control.report(done.load(Ordering::Relaxed) as f64 / total as f64)?;
                    let tall = block.len() / dimension;
                    let a = MatRef::from_row_major_slice(block, tall, dimension);
                    let b = MatRef::from_column_major_slice(&rows, dimension, wide);
                    let c = MatMut::from_column_major_slice_mut(&mut products[..tall * wide], tall, wide);
                    matmul(c, Accum::Replace, a, b, -1.0, Par::Seq);
                    let halves = &halves[first..first + tall];
                    for (query, column) in products.chunks_exact_mut(tall).take(wide).enumerate() {
                        let mut lanes = [f32::INFINITY; 16];
                        for (part, halves) in column.chunks_mut(16).zip(halves.chunks(16)) {
                            for ((value, half), lane) in part.iter_mut().zip(halves).zip(&mut lanes) {
                                *value += half;
                                *lane = if *value < *lane { *value } else { *lane };
                            }
                        }
                        let here = lanes.iter().fold(f32::INFINITY, |least, &lane| least.min(lane));
                        if here <= least[query] + slack[query] {
                            least[query] = least[query].min(here);
                            let limit = least[query] + slack[query];
                            let close = column.iter().zip(first as u32..).filter(|(value, _)| **value <= limit);
                            near[query].extend(close.map(|(&value, index)| (value, index)));
                        }
                    }
                }
                done.fetch_add(wide, Ordering::Relaxed);
                part.chunks_exact(dimension)
                    .zip(near)
                    .zip(least.iter().zip(&slack))
                    .map(|((query, near), (least, slack))| {
                        let mut best = (u32::MAX, f64::INFINITY);
                        for (_, index) in near.into_iter().filter(|(value, _)| *value <= least + slack) {
                            let point = &points[index as usize * dimension..][..dimension];
                            let square = squared_distance(point, query, tamed);
                            if square < best.1 {
                                best = (index, square);
                            }
                        }
                        Ok((best.0, best.1.sqrt() / tamed))
                    })
                    .collect()
            },
        )
        .collect::<Result<_>>()?;
    let (indices, distances): (Vec<u32>, Vec<f64>) = found.into_iter().flatten().unzip();
    if indices.contains(&u32::MAX) || distances.iter().any(|distance| !distance.is_finite()) {
        return Err(Error::numerical("a squared distance overflows; scale the points down"));
    }
    Ok((indices, distances))
}

fn norm(row: &[f32]) -> f64 {
    row.iter().map(|&number| f64::from(number) * f64::from(number)).sum::<f64>().sqrt()
}

fn squared_distance(point: &[f64], query: &[f64], scale: f64) -> f64 {
    point.iter().zip(query).fold(0.0, |sum, (p, q)| {
        let difference = q * scale - p * scale;
        sum + difference * difference
    })
}
