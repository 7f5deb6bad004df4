//! The nearest point to each query in many dimensions, where a tree has little to prune: blocked matrix products.
//!
//! `|x - y|^2 / 2 - |x|^2 / 2 = |y|^2 / 2 - x . y` is computed in single precision, as products of blocks that stay in the cache.
//! Blocks are points and queries near each other, and a block of points is left out where the ball around it is farther from every
//! query than what was found: rows of eigenfunctions lie on a surface, however many there are. What rounding can hide is known; the
//! few points within it of the least are compared again in double precision, by the same sum as a [`KdTree`](super::KdTree) uses.
//! So the answer is that of comparing with every point.

use super::knn::tame;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::first_not_finite;
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

const QUERIES: usize = 128; // of a task
const SIZES: [usize; 2] = [512, 32]; // of blocks and of their parts
const ROUNDING: f64 = 1.0 + 1e-6; // more than that of a distance to a ball; for queries far from all points it is more than the slack
const MANY: usize = 6000; // points; fewer are compared all
const STRAYS: usize = 64; // points at most that lie so far from the others that rounding would hide all differences among these
const FAR: f32 = 4.0; // times as far from the middle as all others

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
    // a power of two, so that nothing is rounded before the mean is taken off
    let scale = if most > 0.0 { 2f64.powi((-most.log2().floor()).clamp(-1022.0, 1022.0) as i32) } else { 1.0 };
    let tamed = tame(most);
    let middle = middle(points, dimension, scale);
    let single = |rows: &[f64]| -> Vec<f32> {
        let mut found = Vec::with_capacity(rows.len());
        for row in rows.chunks_exact(dimension) {
            found.extend(row.iter().zip(&middle).map(|(number, middle)| (number * scale - middle) as f32));
        }
        found
    };
    let total = queries.len() / dimension;
    let mut order: Vec<u32> = (0..total as u32).collect();
    if count > MANY {
        blocks(&mut order, &single(queries), dimension, &[QUERIES], control)?;
    }
    let rows = single(points);
    let (kept, strays) = strays(&rows, dimension);
    let table = Blocks::new(&rows, dimension, &kept, control)?;
    // twice what rounding of the numbers, of the products and of the sum can come to
    let relative = 2.0 * (dimension + 8) as f64 * f64::from(f32::EPSILON);
    let done = AtomicUsize::new(0);
    let found: Vec<Vec<(u32, f64)>> = order
        .par_chunks(QUERIES)
        .map_init(Vec::new, |products, chosen| {
            control.report(done.load(Ordering::Relaxed) as f64 / total as f64)?;
            let part = gather(queries, dimension, chosen);
            let rows = single(&part);
            let wide = chosen.len();
            let norms: Vec<f64> = rows.chunks_exact(dimension).map(norm).collect();
            let slack: Vec<f32> =
                norms.iter().map(|norm| (relative * table.longest * (norm + table.longest) + dimension as f64 * 1e-36) as f32).collect();
            let mut search = Search {
                least: vec![f32::INFINITY; wide],
                near: vec![Vec::new(); wide],
                radii: vec![f32::INFINITY; wide],
                rows: &rows,
                norms: &norms,
                slack: &slack,
            };
            search.all(&table, products, control)?;
            let Search { least, near, .. } = search;
            done.fetch_add(wide, Ordering::Relaxed);
            Ok(part
                .chunks_exact(dimension)
                .zip(near)
                .zip(least.iter().zip(&slack))
                .map(|((query, near), (least, slack))| {
                    let mut best = (u32::MAX, f64::INFINITY);
                    let near = near.into_iter().filter(|(value, _)| *value <= least + slack).map(|(_, index)| index);
                    for index in near.chain(strays.iter().copied()) {
                        let point = &points[index as usize * dimension..][..dimension];
                        let square = squared_distance(point, query, tamed);
                        if square < best.1 || (square == best.1 && index < best.0) {
                            best = (index, square);
                        }
                    }
                    (best.0, best.1.sqrt() / tamed)
                })
                .collect())
        })
        .collect::<Result<_>>()?;
    let (mut indices, mut distances) = (vec![u32::MAX; total], vec![f64::INFINITY; total]);
    for (query, (index, distance)) in order.into_iter().zip(found.into_iter().flatten()) {
        (indices[query as usize], distances[query as usize]) = (index, distance);
    }
    if indices.contains(&u32::MAX) || distances.iter().any(|distance| !distance.is_finite()) {
        return Err(Error::numerical("a squared distance overflows; scale the points down"));
    }
    Ok((indices, distances))
}

/// Points in blocks of neighbours.
struct Blocks {
    order: Vec<u32>,
    rows: Vec<f32>,
    halves: Vec<f32>, // |y|^2 / 2
    longest: f64,
    coarse: Balls,
    fine: Balls,
}

impl Blocks {
    /// Of the rows `kept`.
    fn new(table: &[f32], dimension: usize, kept: &[u32], control: &Control) -> Result<Self> {
        let count = kept.len();
        let mut order = kept.to_vec();
        if count > MANY {
            blocks(&mut order, table, dimension, &SIZES, control)?;
        }
        let rows: Vec<f32> = gather(table, dimension, &order);
        let halves: Vec<f32> = rows.par_chunks_exact(dimension).map(|row| (norm(row).powi(2) / 2.0) as f32).collect();
        let longest = (2.0 * f64::from(halves.iter().fold(0.0, |most: f32, &half| most.max(half)))).sqrt();
        let around = if count > MANY { &rows[..] } else { &[] };
        let [coarse, fine] = SIZES.map(|size| Balls::around(around, dimension, size));
        Ok(Blocks { order, rows, halves, longest, coarse, fine })
    }
}

/// A ball around each `size` rows.
struct Balls {
    centres: Vec<f32>,
    reaches: Vec<f32>, // of the rows from the centres, rounded up
}

impl Balls {
    fn around(rows: &[f32], dimension: usize, size: usize) -> Self {
        let (centres, reaches): (Vec<Vec<f32>>, Vec<f32>) = rows
            .par_chunks(size * dimension)
            .map(|block| {
                let count = (block.len() / dimension) as f32;
                let centre: Vec<f32> = (0..dimension).map(|axis| block[axis..].iter().step_by(dimension).sum::<f32>() / count).collect();
                let squares = block.chunks_exact(dimension).map(|row| {
                    row.iter().zip(&centre).map(|(number, middle)| (f64::from(*number) - f64::from(*middle)).powi(2)).sum::<f64>()
                });
                let reach = (squares.fold(0.0, f64::max).sqrt() * ROUNDING) as f32;
                (centre, reach)
            })
            .unzip();
        Balls { centres: centres.concat(), reaches }
    }

    /// What the squared distances of the queries from the centres of some balls are at least: (balls, queries).
    fn lower_bounds(&self, chosen: Range<usize>, search: &Search<'_>) -> Vec<f32> {
        let dimension = self.centres.len() / self.reaches.len();
        let (centres, wide) = (&self.centres[chosen.start * dimension..chosen.end * dimension], search.norms.len());
        let mut products = vec![0f32; chosen.len() * wide];
        product(search.rows, centres, dimension, &mut products);
        for (centre, products) in centres.chunks_exact(dimension).zip(products.chunks_exact_mut(wide)) {
            let half = (norm(centre).powi(2) / 2.0) as f32;
            for ((product, own), slack) in products.iter_mut().zip(search.norms).zip(search.slack) {
                *product = 2.0 * (*product + half + (own * own / 2.0) as f32 - 2.0 * slack);
            }
        }
        products
    }
}

/// What is known of the nearest points of some queries.
struct Search<'a> {
    rows: &'a [f32],
    norms: &'a [f64],
    slack: &'a [f32],
    least: Vec<f32>,            // of |y|^2 / 2 - x . y
    near: Vec<Vec<(f32, u32)>>, // points that may have it
    radii: Vec<f32>,            // of the balls around the queries that hold the nearest points, rounded up
}

impl Search<'_> {
    /// Looks among all points, block by block, the nearest first.
    fn all(&mut self, table: &Blocks, products: &mut Vec<f32>, control: &Control) -> Result<()> {
        if table.order.len() <= MANY {
            for first in (0..table.order.len()).step_by(SIZES[0]) {
                control.check()?;
                self.among(table, first..table.order.len().min(first + SIZES[0]), products);
            }
            return Ok(());
        }
        let (wide, parts_of_block) = (self.norms.len(), SIZES[0] / SIZES[1]);
        let coarse = table.coarse.lower_bounds(0..table.coarse.reaches.len(), self);
        let nearest = |squares: &[f32]| squares.iter().fold(f32::INFINITY, |least, &square| least.min(square)).max(0.0).sqrt();
        let mut way: Vec<(f32, usize)> =
            coarse.chunks_exact(wide).zip(&table.coarse.reaches).map(|(squares, reach)| nearest(squares) - reach).zip(0..).collect();
        way.sort_unstable_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)));
        let (mut asked, mut needed) = (0, 0);
        for (_, block) in way {
            if !self.reach_into(&coarse[block * wide..][..wide], table.coarse.reaches[block]) {
                continue;
            }
            control.check()?;
            let parts = block * parts_of_block..table.fine.reaches.len().min((block + 1) * parts_of_block);
            let end = table.order.len().min(parts.end * SIZES[1]);
            if asked > 4 * parts_of_block && 10 * needed > 9 * asked {
                self.among(table, parts.start * SIZES[1]..end, products); // nearly all have been needed
                continue;
            }
            let fine = table.fine.lower_bounds(parts.clone(), self);
            let mut open = None; // where the parts that are searched together begin
            for (part, squares) in parts.clone().zip(fine.chunks_exact(wide)) {
                let reached = self.reach_into(squares, table.fine.reaches[part]);
                (asked, needed) = (asked + 1, needed + usize::from(reached));
                match open {
                    Some(first) if !reached => {
                        self.among(table, first..part * SIZES[1], products);
                        open = None;
                    }
                    None if reached => open = Some(part * SIZES[1]),
                    _ => {}
                }
            }
            if let Some(first) = open {
                self.among(table, first..end, products);
            }
        }
        Ok(())
    }

    /// Whether a point of a ball can be as near to a query as what was found.
    fn reach_into(&self, squares: &[f32], reach: f32) -> bool {
        squares
            .iter()
            .zip(&self.radii)
            .fold(false, |any, (square, radius)| any | (*square <= (radius + reach) * (radius + reach) * ROUNDING as f32))
    }

    /// Looks among the points at some places of the table.
    fn among(&mut self, table: &Blocks, places: Range<usize>, products: &mut Vec<f32>) {
        let (wide, tall, dimension) = (self.norms.len(), places.len(), self.rows.len() / self.norms.len());
        products.resize(QUERIES * SIZES[0], 0.0);
        product(&table.rows[places.start * dimension..places.end * dimension], self.rows, dimension, &mut products[..tall * wide]);
        let halves = &table.halves[places.clone()];
        for (query, column) in products.chunks_exact_mut(tall).take(wide).enumerate() {
            let mut lanes = [f32::INFINITY; 16];
            for (part, halves) in column.chunks_mut(16).zip(halves.chunks(16)) {
                for ((value, half), lane) in part.iter_mut().zip(halves).zip(&mut lanes) {
                    *value += half;
                    *lane = if *value < *lane { *value } else { *lane };
                }
            }
            let here = lanes.iter().fold(f32::INFINITY, |least, &lane| least.min(lane));
            if here <= self.least[query] + self.slack[query] {
                self.least[query] = self.least[query].min(here);
                let limit = self.least[query] + self.slack[query];
                let close = column.iter().zip(&table.order[places.clone()]).filter(|(value, _)| **value <= limit);
                self.near[query].extend(close.map(|(&value, &index)| (value, index)));
                let half = f64::from(self.least[query]) + self.norms[query].powi(2) / 2.0 + 2.0 * f64::from(self.slack[query]);
                self.radii[query] = ((2.0 * half).max(0.0).sqrt() * ROUNDING) as f32;
            }
        }
    }
}

fn gather<T: Copy>(table: &[T], dimension: usize, chosen: &[u32]) -> Vec<T> {
    let mut found = Vec::with_capacity(chosen.len() * dimension);
    for &row in chosen {
        found.extend_from_slice(&table[row as usize * dimension..][..dimension]);
    }
    found
}

/// `-A B^T` of two row-major tables, column-major.
fn product(a: &[f32], b: &[f32], dimension: usize, out: &mut [f32]) {
    let (tall, wide) = (a.len() / dimension, b.len() / dimension);
    let a = MatRef::from_row_major_slice(a, tall, dimension);
    let b = MatRef::from_column_major_slice(b, dimension, wide);
    matmul(MatMut::from_column_major_slice_mut(out, tall, wide), Accum::Replace, a, b, -1.0, Par::Seq);
}

/// The median of a sample of the points on each axis: those far from the others do not move it as they do a mean.
fn middle(points: &[f64], dimension: usize, scale: f64) -> Vec<f64> {
    let step = (points.len() / dimension).div_ceil(1000) * dimension;
    let median = |axis: usize| {
        let mut values: Vec<f64> = points[axis..].iter().step_by(step).copied().collect();
        let half = values.len() / 2;
        *values.select_nth_unstable_by(half, f64::total_cmp).1 * scale
    };
    (0..dimension).map(median).collect()
}

/// The numbers of all rows but the strays, and of these.
fn strays(rows: &[f32], dimension: usize) -> (Vec<u32>, Vec<u32>) {
    let lengths: Vec<f32> = rows.par_chunks_exact(dimension).map(|row| norm(row) as f32).collect();
    let all = 0..lengths.len() as u32;
    if lengths.len() <= MANY {
        return (all.collect(), Vec::new());
    }
    let mut sorted = lengths.clone();
    let place = lengths.len() - 1 - STRAYS;
    let bound = FAR * *sorted.select_nth_unstable_by(place, f32::total_cmp).1;
    all.partition(|&row| lengths[row as usize] <= bound)
}

/// Sorts rows so that those of a block, and in it of a part, are near each other: halves along the axis of greatest spread.
fn blocks(order: &mut [u32], table: &[f32], dimension: usize, sizes: &[usize], control: &Control) -> Result<()> {
    fn halve(part: &mut [u32], table: &[f32], dimension: usize, sizes: &[usize], control: &Control) -> Result<()> {
        let Some(size) = sizes.iter().find(|&&size| size < part.len()) else { return Ok(()) };
        control.check()?;
        let (mut sums, mut squares) = (vec![0f64; dimension], vec![0f64; dimension]);
        for &row in part.iter() {
            let row = &table[row as usize * dimension..][..dimension];
            for ((number, sum), square) in row.iter().zip(&mut sums).zip(&mut squares) {
                let number = f64::from(*number);
                *sum += number;
                *square += number * number;
            }
        }
        let count = part.len() as f64;
        let spread = |axis: usize| squares[axis] - sums[axis] * sums[axis] / count;
        let axis = (1..dimension).fold(0, |most, axis| if spread(axis) > spread(most) { axis } else { most });
        let value = |row: u32| table[row as usize * dimension + axis];
        let middle = part.len().div_ceil(*size).div_ceil(2) * size;
        part.select_nth_unstable_by(middle, |&one, &other| value(one).total_cmp(&value(other)).then(one.cmp(&other)));
        let (low, high) = part.split_at_mut(middle);
        let (one, other) = rayon::join(|| halve(low, table, dimension, sizes, control), || halve(high, table, dimension, sizes, control));
        one.and(other)
    }
    halve(order, table, dimension, sizes, control)
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
