//! Subsets of points: copies left out, farthest points, Poisson discs.

use super::{KdTree, Scratch};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::{CHUNK, first_not_finite};
use rayon::prelude::*;

/// Points nearer to another than this share of the distance to their 6th neighbour coincide with it.
pub(crate) const COINCIDENT: f64 = 1e-10;

/// The points moved to the origin and times a power of two, so that they fill the unit box; that power of two. `None` if they
/// all lie in one place.
pub(crate) fn normalized(points: &[f64], dimension: usize) -> Result<Option<(Vec<f64>, f64)>> {
    if dimension == 0 || !points.len().is_multiple_of(dimension) {
        return Err(Error::input(format!("{} coordinates are no whole number of points in R^{dimension}", points.len())));
    }
    if points.len() / dimension > u32::MAX as usize / 2 {
        return Err(Error::input(format!("{} points; a cloud can have up to 2^31 - 1", points.len() / dimension)));
    }
    if let Some(at) = first_not_finite(points) {
        return Err(Error::input(format!(
            "coordinate {} of point {} is {}; remove that point",
            at % dimension,
            at / dimension,
            points[at]
        )));
    }
    let (mut low, mut high) = (vec![f64::INFINITY; dimension], vec![f64::NEG_INFINITY; dimension]);
    for point in points.chunks_exact(dimension) {
        for ((low, high), &x) in low.iter_mut().zip(&mut high).zip(point) {
            *low = low.min(x);
            *high = high.max(x);
        }
    }
    let extent = low.iter().zip(&high).map(|(a, b)| b / 2.0 - a / 2.0).fold(0.0, f64::max);
    if extent == 0.0 {
        return Ok(None);
    }
    let scale = (-extent.log2().ceil()).clamp(-1023.0, 1023.0).exp2();
    let middle: Vec<f64> = low.iter().zip(&high).map(|(a, b)| (a / 2.0 + b / 2.0) * scale).collect();
    let mut out = vec![0.0; points.len()];
    out.par_chunks_mut(CHUNK * dimension).zip(points.par_chunks(CHUNK * dimension)).for_each(|(out, points)| {
        for (out, point) in out.chunks_exact_mut(dimension).zip(points.chunks_exact(dimension)) {
            for ((out, x), middle) in out.iter_mut().zip(point).zip(&middle) {
                *out = x * scale - middle;
            }
        }
    });
    Ok(Some((out, scale)))
}

/// Whether each point is the first of those that coincide with it, to 1e-10 of the distance to its 6th neighbour.
///
/// ```
/// let points = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
/// assert_eq!(beltrami::near::first_copies(&points, 2, &Default::default())?, [true, true, false]);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if a coordinate is not finite; [`Error::Cancelled`].
pub fn first_copies(points: &[f64], dimension: usize, control: &Control) -> Result<Vec<bool>> {
    let count = points.len() / dimension.max(1);
    let mut kept = vec![true; count];
    let Some((points, _)) = normalized(points, dimension)? else {
        kept.iter_mut().skip(1).for_each(|kept| *kept = false);
        return Ok(kept);
    };
    let at = |index: u32| &points[index as usize * dimension..][..dimension];
    let mut order: Vec<u32> = (0..count as u32).collect();
    let compare = |a: u32, b: u32| at(a).iter().zip(at(b)).map(|(x, y)| (x + 0.0).total_cmp(&(y + 0.0))).find(|order| order.is_ne());
    order.par_sort_unstable_by(|&a, &b| compare(a, b).unwrap_or(a.cmp(&b)));
    for pair in order.windows(2) {
        if compare(pair[0], pair[1]).is_none() {
            kept[pair[1] as usize] = false;
        }
    }
    let names: Vec<u32> = (0..count as u32).filter(|&index| kept[index as usize]).collect();
    let distinct: Vec<f64> = names.iter().flat_map(|&index| at(index).iter().copied()).collect();
    let wanted = 7.min(names.len());
    let (neighbors, distances) = KdTree::new(&distinct, dimension, control)?.nearest(&distinct, wanted, control)?;
    for (place, &index) in names.iter().enumerate() {
        let row = place * wanted..(place + 1) * wanted;
        let limit = COINCIDENT * distances[row.end - 1];
        let near = neighbors[row.clone()].iter().zip(&distances[row]);
        let copy =
            near.take_while(|pair| *pair.1 <= limit).any(|(&other, _)| (other as usize) < place && kept[names[other as usize] as usize]);
        kept[index as usize] = !copy;
    }
    Ok(kept)
}

/// `wanted` points, each the farthest from those before it, from `start` on: indices in that order. Equally far ones by index.
///
/// ```
/// let line = [0.0, 1.0, 2.0, 3.0, 10.0];
/// assert_eq!(beltrami::near::farthest_points(&line, 1, 3, 0, &Default::default())?, [0, 4, 3]);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if `wanted` is not from 1 to the number of points, `start` is no point, or a coordinate is not finite;
/// [`Error::Cancelled`].
pub fn farthest_points(points: &[f64], dimension: usize, wanted: usize, start: usize, control: &Control) -> Result<Vec<u32>> {
    let count = points.len() / dimension.max(1);
    if wanted == 0 || wanted > count {
        return Err(Error::input(format!("{wanted} of {count} points; ask for 1 to {count}")));
    }
    if start >= count {
        return Err(Error::input(format!("start is {start}; there are {count} points, numbered from 0")));
    }
    let points = normalized(points, dimension)?.map_or_else(|| points.to_vec(), |(points, _)| points);
    let mut nearest = vec![f64::INFINITY; count];
    let mut chosen = Vec::with_capacity(wanted);
    let mut last = start;
    loop {
        chosen.push(last as u32);
        nearest[last] = -1.0;
        if chosen.len() == wanted {
            return Ok(chosen);
        }
        let there = &points[last * dimension..][..dimension];
        let best = |x: (f64, usize), y: (f64, usize)| if y.0 > x.0 || (y.0 == x.0 && y.1 < x.1) { y } else { x };
        let farthest = (nearest.par_chunks_mut(CHUNK).zip(points.par_chunks(CHUNK * dimension)))
            .enumerate()
            .map(|(chunk, (nearest, points))| {
                let mut farthest = (-2.0, usize::MAX);
                for (at, (nearest, point)) in nearest.iter_mut().zip(points.chunks_exact(dimension)).enumerate() {
                    let square: f64 = point.iter().zip(there).map(|(x, y)| (x - y) * (x - y)).sum();
                    *nearest = nearest.min(square);
                    farthest = best(farthest, (*nearest, chunk * CHUNK + at));
                }
                farthest
            })
            .reduce(|| (-2.0, usize::MAX), best);
        last = farthest.1;
        control.report(chosen.len() as f64 / wanted as f64)?;
    }
}

/// Points no two of which are nearer than `radius`, and none of the others farther than it from all of them: whoever comes
/// first in `order` and is not yet covered is chosen. Indices in that order.
///
/// ```
/// let line = [0.0, 1.0, 2.0, 3.0];
/// assert_eq!(beltrami::near::poisson_disc(&line, 1, 1.5, &[0, 1, 2, 3], &Default::default())?, [0, 2]);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if `radius` is not positive, `order` names what is no point, or a coordinate is not finite;
/// [`Error::Cancelled`].
pub fn poisson_disc(points: &[f64], dimension: usize, radius: f64, order: &[u32], control: &Control) -> Result<Vec<u32>> {
    if !(radius > 0.0 && radius.is_finite()) {
        return Err(Error::input(format!("radius is {radius}; it must be positive")));
    }
    let Some((points, scale)) = normalized(points, dimension)? else {
        return Ok(order.first().copied().into_iter().collect());
    };
    let count = points.len() / dimension;
    if let Some(&wrong) = order.iter().find(|&&index| index as usize >= count) {
        return Err(Error::input(format!("the order names point {wrong}; there are {count}")));
    }
    let tree = KdTree::new(&points, dimension, control)?;
    let mut covered = vec![false; count];
    let mut chosen = vec![];
    let mut scratch = Scratch::default();
    // at exactly the radius two points may both stay
    let reach = (radius * scale).min(1e3) * (1.0 - 1e-12);
    for (step, &index) in order.iter().enumerate() {
        if step % 1024 == 0 {
            control.report(step as f64 / order.len() as f64)?;
        }
        if covered[index as usize] {
            continue;
        }
        chosen.push(index);
        tree.within_into(&points[index as usize * dimension..][..dimension], reach, &mut scratch)?;
        for &near in scratch.indices() {
            covered[near as usize] = true;
        }
    }
    Ok(chosen)
}
