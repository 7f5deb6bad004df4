//! Fill-reducing orders: nested dissection by planes where coordinates are known, by graph distances where they are not.
//!
//! A set of unknowns is cut in two by the best of several planes (George 1973; the cut is scored by the unknowns it would
//! separate), the separator is the smaller side of the cut, then improved by moves in the manner of Fiduccia and Mattheyses
//! (1982; for vertex separators Ashcraft and Liu 1996). Leaves are ordered by exact minimum degree, with the separators
//! around them counted. Halves are dissected in parallel; nothing depends on the number of threads.

use crate::control::Control;
use crate::error::{Error, Result};
use crate::vector::{dot, length};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;
use rayon::prelude::*;
use std::collections::BinaryHeap;

const LEAF: usize = 120; // unknowns that minimum degree orders at once
const SAMPLE: usize = 1500; // unknowns on which a cut is scored
const FEW: usize = 96; // unknowns whose places tell where the middle is
const BINS: usize = 24; // places of a cut along one direction
const HALO: usize = 512; // unknowns around a leaf that are counted
const SMALL: usize = 3000; // below this, the order without coordinates is approximate minimum degree
const CHUNK: usize = 4096;

/// A symmetric pattern without its diagonal, its unknowns' names in the whole, and their places.
struct Graph {
    starts: Vec<usize>,
    neighbors: Vec<u32>,
    names: Vec<u32>,
    points: Vec<[f64; 3]>,
}

impl Graph {
    fn len(&self) -> usize {
        self.names.len()
    }

    fn neighbors(&self, vertex: usize) -> &[u32] {
        &self.neighbors[self.starts[vertex]..self.starts[vertex + 1]]
    }
}

/// The order of elimination: `order[k]` is the unknown eliminated at step k.
pub(crate) fn order(starts: &[usize], indices: &[u32], coordinates: Option<(&[f64], usize)>, control: &Control) -> Result<Vec<u32>> {
    let n = starts.len() - 1;
    let points = match coordinates {
        Some((coordinates, dimension)) => {
            if dimension == 0 || coordinates.len() / dimension != n || coordinates.len() % dimension != 0 {
                return Err(Error::input(format!(
                    "{} coordinates in dimension {dimension} do not place {n} unknowns; give n * D numbers, or none",
                    coordinates.len()
                )));
            }
            if let Some(at) = coordinates.iter().position(|number| !number.is_finite()) {
                return Err(Error::input(format!("coordinate {} of unknown {} is {}", at % dimension, at / dimension, coordinates[at])));
            }
            if n <= LEAF { None } else { Some(in_three(coordinates, dimension)) }
        }
        None if n <= SMALL => None,
        None => match by_distances(starts, indices, control)? {
            Some(points) => Some(points),
            None => return minimum_degree(starts, indices),
        },
    };
    control.check()?;
    let Some(points) = points else { return minimum_degree(starts, indices) };

    let whole = sorted_in_space(starts, indices, &points);
    control.check()?;
    let mut order = vec![0; n];
    let top = Graph {
        starts: whole.starts.clone(),
        neighbors: whole.neighbors.clone(),
        names: (0..n as u32).collect(),
        points: whole.points.clone(),
    };
    dissect(top, &whole, coordinates.is_none(), &mut order, control)?;
    order.par_iter_mut().with_min_len(CHUNK).for_each(|name| *name = whole.names[*name as usize]);
    Ok(order)
}

/// Approximate minimum degree (Amestoy, Davis, Duff 1996), faer's.
fn minimum_degree(starts: &[usize], indices: &[u32]) -> Result<Vec<u32>> {
    fn run<I: faer::Index>(starts: &[I], indices: &[I], n: usize) -> Result<Vec<I>> {
        let failed = |_| Error::numerical(format!("no memory for the order of {n} unknowns; give coordinates"));
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, starts, None, indices);
        let mut space = MemBuffer::try_new(amd::order_scratch::<I>(n, indices.len())).map_err(failed)?;
        let (mut order, mut inverse) = (vec![I::truncate(0); n], vec![I::truncate(0); n]);
        amd::order(&mut order, &mut inverse, pattern, amd::Control::default(), MemStack::new(&mut space))
            .map_err(|_| Error::numerical(format!("the pattern of {} entries overflows the order", indices.len())))?;
        Ok(order)
    }
    let n = starts.len() - 1;
    if indices.len() < (i32::MAX / 4) as usize {
        let starts: Vec<u32> = starts.iter().map(|&start| start as u32).collect();
        run(&starts, indices, n)
    } else {
        let indices: Vec<u64> = indices.iter().map(|&index| u64::from(index)).collect();
        let starts: Vec<u64> = starts.iter().map(|&start| start as u64).collect();
        Ok(run(&starts, &indices, n)?.into_iter().map(|index| index as u32).collect())
    }
}

/// Points of any dimension in three: padded, or projected to their three directions of largest extent.
fn in_three(coordinates: &[f64], dimension: usize) -> Vec<[f64; 3]> {
    if dimension <= 3 {
        return coordinates
            .par_chunks_exact(dimension)
            .with_min_len(CHUNK)
            .map(|row| std::array::from_fn(|axis| row.get(axis).copied().unwrap_or(0.0)))
            .collect();
    }
    // Principal directions of a sample by a few steps of subspace iteration: good enough to cut by.
    let n = coordinates.len() / dimension;
    let sample: Vec<&[f64]> = coordinates.chunks_exact(dimension).step_by(n.div_ceil(4096)).collect();
    let scale = sample.iter().flat_map(|row| row.iter()).fold(0.0f64, |most, x| most.max(x.abs())).max(f64::MIN_POSITIVE);
    let mean: Vec<f64> = (0..dimension).map(|axis| sample.iter().map(|row| row[axis] / scale).sum::<f64>() / sample.len() as f64).collect();
    let mut axes: Vec<Vec<f64>> =
        (0..3).map(|k| (0..dimension).map(|axis| if axis % 3 == k { 1.0 + axis as f64 / 64.0 } else { 0.125 }).collect()).collect();
    for _ in 0..12 {
        for k in 0..3 {
            let mut image = vec![0.0; dimension];
            for row in &sample {
                let part: f64 = row.iter().zip(&mean).zip(&axes[k]).map(|((x, m), a)| (x / scale - m) * a).sum();
                image.iter_mut().zip(row.iter().zip(&mean)).for_each(|(sum, (x, m))| *sum += part * (x / scale - m));
            }
            for earlier in &axes[..k] {
                let part: f64 = image.iter().zip(earlier).map(|(x, y)| x * y).sum();
                image.iter_mut().zip(earlier).for_each(|(x, y)| *x -= part * y);
            }
            let length = image.iter().map(|x| x * x).sum::<f64>().sqrt();
            if length > 0.0 {
                axes[k] = image.into_iter().map(|x| x / length).collect();
            }
        }
    }
    coordinates
        .par_chunks_exact(dimension)
        .with_min_len(CHUNK)
        .map(|row| std::array::from_fn(|k| row.iter().zip(&mean).zip(&axes[k]).map(|((x, m), a)| (x / scale - m) * a).sum()))
        .collect()
}

/// Places by distances in the graph from unknowns far from each other; None where the graph has no extent to speak of.
fn by_distances(starts: &[usize], indices: &[u32], control: &Control) -> Result<Option<Vec<[f64; 3]>>> {
    let n = starts.len() - 1;
    let mut points = vec![[f64::NAN; 3]; n];
    let mut queue: Vec<u32> = Vec::with_capacity(n);
    let mut found = vec![u32::MAX; n];
    let mut shift = 0.0;
    let mut longest = 0;
    for first in 0..n {
        if !points[first][0].is_nan() {
            continue;
        }
        control.check()?;
        let mut from = first as u32;
        let mut reach = 0;
        let mut members = Vec::new();
        // The first walk only finds a far end; each later one starts where all before are far.
        for walk in 0..4usize {
            queue.clear();
            queue.push(from);
            found[from as usize] = 0;
            let mut next = 0;
            while let Some(&vertex) = queue.get(next) {
                next += 1;
                if next % (1 << 16) == 0 {
                    control.check()?;
                }
                let away = found[vertex as usize] + 1;
                for &other in &indices[starts[vertex as usize]..starts[vertex as usize + 1]] {
                    if found[other as usize] == u32::MAX {
                        found[other as usize] = away;
                        queue.push(other);
                    }
                }
            }
            let last = queue.last().copied().unwrap_or(from);
            reach = reach.max(found[last as usize]);
            if walk > 0 {
                queue.iter().for_each(|&vertex| points[vertex as usize][walk - 1] = f64::from(found[vertex as usize]));
            }
            from = match walk {
                0 => last,
                _ => queue
                    .iter()
                    .copied()
                    .max_by(|&p, &q| {
                        let least = |v: u32| points[v as usize][..walk].iter().copied().fold(f64::MAX, f64::min);
                        least(p).total_cmp(&least(q)).then(q.cmp(&p))
                    })
                    .unwrap_or(last),
            };
            queue.iter().for_each(|&vertex| found[vertex as usize] = u32::MAX);
            if walk == 0 {
                members.clone_from(&queue);
            }
        }
        for &vertex in &members {
            points[vertex as usize][0] += shift;
            found[vertex as usize] = 0;
        }
        shift += f64::from(reach) + 2.0;
        longest = longest.max(reach);
    }
    if longest < 12 && shift < 0.5 * n as f64 {
        return Ok(None);
    }
    // Distances are whole numbers: averages over neighbours part what ties.
    for _ in 0..3 {
        control.check()?;
        points = (0..n)
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|vertex| {
                let near = &indices[starts[vertex]..starts[vertex + 1]];
                let mut sum = points[vertex];
                near.iter().for_each(|&other| (0..3).for_each(|axis| sum[axis] += points[other as usize][axis]));
                sum.map(|x| x / (near.len() + 1) as f64)
            })
            .collect();
    }
    Ok(Some(points))
}

/// Interleaves the bits of a point of a grid of 2^20 cells a side.
fn curve(cell: [u64; 3]) -> u64 {
    let spread = |x: u64| {
        let mut x = x & 0x1f_ffff;
        for (shift, mask) in [
            (32, 0x1f_0000_0000_ffff),
            (16, 0x1f_0000_ff00_00ff),
            (8, 0x100f_00f0_0f00_f00f),
            (4, 0x10c3_0c30_c30c_30c3),
            (2, 0x1249_2492_4924_9249),
        ] {
            x = (x | (x << shift)) & mask;
        }
        x
    };
    spread(cell[0]) | (spread(cell[1]) << 1) | (spread(cell[2]) << 2)
}

/// The pattern with its unknowns renamed along a space-filling curve: every later pass then reads near what it read before.
fn sorted_in_space(starts: &[usize], indices: &[u32], points: &[[f64; 3]]) -> Graph {
    let n = points.len();
    let bounds = |axis: usize| points.iter().fold((f64::MAX, f64::MIN), |(low, high), p| (low.min(p[axis]), high.max(p[axis])));
    let bounds: [(f64, f64); 3] = std::array::from_fn(bounds);
    let side = bounds.iter().fold(0.0f64, |most, (low, high)| most.max(high / 2.0 - low / 2.0)).max(f64::MIN_POSITIVE);
    let mut keys: Vec<(u64, u32)> = (0..n as u32)
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|vertex| {
            let point = &points[vertex as usize];
            let cell = |axis: usize| (((point[axis] / 2.0 - bounds[axis].0 / 2.0) / side * 1_048_575.0) as u64).min(1_048_575);
            (curve(std::array::from_fn(cell)), vertex)
        })
        .collect();
    keys.par_sort_unstable();
    let names: Vec<u32> = keys.into_iter().map(|(_, vertex)| vertex).collect();
    let mut place = vec![0u32; n];
    names.iter().enumerate().for_each(|(at, &vertex)| place[vertex as usize] = at as u32);
    let parts: Vec<(Vec<u32>, Vec<usize>)> = names
        .par_chunks(CHUNK)
        .map(|names| {
            let mut neighbors = Vec::with_capacity(names.len() * 8);
            let ends = names
                .iter()
                .map(|&name| {
                    let row = &indices[starts[name as usize]..starts[name as usize + 1]];
                    neighbors.extend(row.iter().filter(|&&other| other != name).map(|&other| place[other as usize]));
                    neighbors.len()
                })
                .collect();
            (neighbors, ends)
        })
        .collect();
    let mut renamed = Vec::with_capacity(n + 1);
    renamed.push(0);
    let mut neighbors = Vec::with_capacity(indices.len().saturating_sub(n));
    for (part, ends) in &parts {
        let before = neighbors.len();
        renamed.extend(ends.iter().map(|end| before + end));
        neighbors.extend_from_slice(part);
    }
    let points = names.par_iter().with_min_len(CHUNK).map(|&name| points[name as usize]).collect();
    Graph { starts: renamed, neighbors, names, points }
}

/// Orders `graph` into `out`: one half, the other half, their separator.
fn dissect(graph: Graph, whole: &Graph, guessed: bool, out: &mut [u32], control: &Control) -> Result<()> {
    let count = graph.len();
    if count <= LEAF {
        leaf(&graph, whole, out);
        return Ok(());
    }
    if count > 1000 {
        control.check()?;
    }
    // Distances in a graph without geometry cut badly: there minimum degree is better.
    let widest = if guessed { 2.5 * (count as f64).powf(2.0 / 3.0) } else { f64::INFINITY };
    let Some(side) = cut(&graph, widest) else {
        let mut graph = graph;
        for vertex in 0..count {
            graph.neighbors[graph.starts[vertex]..graph.starts[vertex + 1]].sort_unstable();
        }
        for (out, at) in out.iter_mut().zip(minimum_degree(&graph.starts, &graph.neighbors)?) {
            *out = graph.names[at as usize];
        }
        return Ok(());
    };
    let [left, right, _] = tally(&side);
    let (first, rest) = out.split_at_mut(left);
    let (second, between) = rest.split_at_mut(right);
    let separator = graph.names.iter().zip(&side).filter(|&(_, &side)| side == 2).map(|(&name, _)| name);
    between.iter_mut().zip(separator).for_each(|(out, name)| *out = name);
    if count > 2000 {
        let (left, right) = rayon::join(|| part(&graph, &side, 0, left), || part(&graph, &side, 1, right));
        drop((graph, side));
        let (left, right) =
            rayon::join(|| dissect(left, whole, guessed, first, control), || dissect(right, whole, guessed, second, control));
        left.and(right)
    } else {
        let (left, right) = (part(&graph, &side, 0, left), part(&graph, &side, 1, right));
        drop((graph, side));
        dissect(left, whole, guessed, first, control)?;
        dissect(right, whole, guessed, second, control)
    }
}

/// The subgraph of one side.
fn part(graph: &Graph, side: &[u8], which: u8, count: usize) -> Graph {
    let mut place = vec![0u32; graph.len()];
    let mut next = 0;
    for (place, &side) in place.iter_mut().zip(side) {
        *place = next;
        next += u32::from(side == which);
    }
    let mut result = Graph {
        starts: Vec::with_capacity(count + 1),
        neighbors: Vec::with_capacity(count * graph.neighbors.len() / graph.len().max(1)),
        names: Vec::with_capacity(count),
        points: Vec::with_capacity(count),
    };
    result.starts.push(0);
    for vertex in 0..graph.len() {
        if side[vertex] == which {
            let inside = graph.neighbors(vertex).iter().filter(|&&other| side[other as usize] == which);
            result.neighbors.extend(inside.map(|&other| place[other as usize]));
            result.starts.push(result.neighbors.len());
            result.names.push(graph.names[vertex]);
            result.points.push(graph.points[vertex]);
        }
    }
    result
}

/// Parallel planes: those at `low`, `low + 1 / steps`, ... along a direction.
#[derive(Clone, Copy)]
struct Planes {
    direction: [f64; 3],
    low: f64,
    steps: f64,
}

impl Planes {
    /// The first plane beyond a point; BINS if it is beyond all.
    fn bin(&self, point: &[f64; 3]) -> u8 {
        (((dot(*point, self.direction) - self.low) * self.steps + 1.0) as i32).clamp(0, BINS as i32) as u8
    }
}

/// Two sides (0, 1) and the separator (2); None where no plane leaves two sides worth having.
fn cut(graph: &Graph, widest: f64) -> Option<Vec<u8>> {
    let count = graph.len();
    let stride = count.div_ceil(SAMPLE);
    let sample: Vec<usize> = (0..count).step_by(stride).collect();
    let few: Vec<usize> = (0..count).step_by(count.div_ceil(FEW)).collect();
    let mut best: Option<(f64, Planes, u8)> = None;
    let (mut along, mut bins) = (Vec::new(), Vec::new());
    for direction in directions(graph, &few) {
        along.clear();
        along.extend(few.iter().map(|&vertex| dot(graph.points[vertex], direction)));
        along.sort_unstable_by(f64::total_cmp);
        let quantile = |share: f64| along[((along.len() - 1) as f64 * share) as usize];
        let (low, high) = (quantile(0.38), quantile(0.62));
        let steps = (BINS - 1) as f64 / (high - low);
        if !(high > low && steps.is_finite()) {
            continue;
        }
        let planes = Planes { direction, low, steps };
        let (mut below, mut rims) = ([0i32; BINS + 1], [[0i32; BINS + 1]; 2]);
        let mut score = |own: u8, least: u8, most: u8| {
            below[own as usize] += 1;
            rims[0][own as usize] += 1;
            rims[0][most as usize] -= 1;
            rims[1][least as usize] += 1;
            rims[1][own as usize] -= 1;
        };
        if stride == 1 {
            bins.clear();
            bins.extend(graph.points.iter().map(|point| planes.bin(point)));
            for vertex in 0..count {
                let own = bins[vertex];
                let near = graph.neighbors(vertex).iter().map(|&other| bins[other as usize]);
                let (least, most) = near.fold((own, own), |(least, most), bin| (least.min(bin), most.max(bin)));
                score(own, least, most);
            }
        } else {
            for &vertex in &sample {
                let own = planes.bin(&graph.points[vertex]);
                let near = graph.neighbors(vertex).iter().map(|&other| planes.bin(&graph.points[other as usize]));
                let (least, most) = near.fold((own, own), |(least, most), bin| (least.min(bin), most.max(bin)));
                score(own, least, most);
            }
        }
        let (mut under, mut lower, mut upper) = (0, 0, 0);
        for at in 0..BINS {
            under += below[at];
            lower += rims[0][at];
            upper += rims[1][at];
            let balance = (2.0 * f64::from(under) / sample.len() as f64 - 1.0).abs();
            let score = (f64::from(lower.min(upper)) + 0.5) * (1.0 + balance + 2.0 * balance * balance);
            if best.is_none_or(|(least, ..)| score < least) {
                best = Some((score, planes, at as u8));
            }
        }
    }
    let (_, planes, place) = best?;
    let mut side: Vec<u8> = graph.points.iter().map(|point| u8::from(planes.bin(point) > place)).collect();
    let mut rims = [0usize; 2];
    let mut edge = Vec::new();
    for vertex in 0..count {
        let own = side[vertex];
        if graph.neighbors(vertex).iter().fold(0, |differ, &other| differ | (side[other as usize] ^ own)) != 0 {
            edge.push(vertex);
            rims[own as usize] += 1;
        }
    }
    let smaller = u8::from(rims[1] < rims[0]);
    edge.retain(|&vertex| side[vertex] == smaller);
    edge.iter().for_each(|&vertex| side[vertex] = 2);
    refine(graph, &mut side, edge);
    let counts = tally(&side);
    (counts[0].min(counts[1]) * 8 >= count && counts[2] * 3 <= count && counts[2] as f64 <= widest).then_some(side)
}

/// How many are on each side, and between.
fn tally(side: &[u8]) -> [usize; 3] {
    let ones = side.iter().filter(|&&side| side == 1).count();
    let twos = side.iter().filter(|&&side| side == 2).count();
    [side.len() - ones - twos, ones, twos]
}

/// Directions to try: the axes and the diagonals between them, without those along which there is little to cut.
fn directions(graph: &Graph, sample: &[usize]) -> Vec<[f64; 3]> {
    let mut mean = [0.0; 3];
    for &vertex in sample {
        (0..3).for_each(|axis| mean[axis] += graph.points[vertex][axis] / sample.len() as f64);
    }
    let mut spread = [[0.0f64; 3]; 3];
    for &vertex in sample {
        let from: [f64; 3] = std::array::from_fn(|axis| graph.points[vertex][axis] - mean[axis]);
        for p in 0..3 {
            for q in 0..3 {
                spread[p][q] += from[p] * from[q];
            }
        }
    }
    let mut all = vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for (p, q) in [(0, 1), (0, 2), (1, 2)] {
        for sign in [1.0, -1.0] {
            let mut diagonal = [0.0; 3];
            diagonal[p] = std::f64::consts::FRAC_1_SQRT_2;
            diagonal[q] = sign * std::f64::consts::FRAC_1_SQRT_2;
            all.push(diagonal);
        }
    }
    // The longest direction of all, by a few powers of the spread.
    let mut longest = [0.6, 0.5, 0.7];
    for _ in 0..8 {
        let image: [f64; 3] = std::array::from_fn(|p| dot(spread[p], longest));
        let length = length(image);
        if length > 0.0 {
            longest = image.map(|x| x / length);
        }
    }
    all.push(longest);
    let extent = |d: &[f64; 3]| (0..3).map(|p| d[p] * dot(spread[p], *d)).sum::<f64>();
    all.sort_by(|a, b| extent(b).total_cmp(&extent(a)));
    let most = extent(&all[0]);
    all.retain(|d| extent(d) > 0.15 * most);
    all.truncate(if graph.len() < 2000 { 4 } else { 6 });
    all
}

/// Moves unknowns out of the separator as long as it shrinks, over small hills too; both sides stay near half.
fn refine(graph: &Graph, side: &mut [u8], mut separator: Vec<usize>) {
    let count = graph.len();
    let most = count * 11 / 20;
    let mut counts = tally(side);
    let mut moved = vec![false; count];
    for _ in 0..3 {
        let before = separator.len();
        let pulled = |side: &[u8], vertex: usize, to: u8| {
            graph.neighbors(vertex).iter().filter(|&&other| side[other as usize] == 1 - to).count() as i64
        };
        let mut heap = BinaryHeap::new();
        for &vertex in &separator {
            for to in [0u8, 1] {
                heap.push((1 - pulled(side, vertex, to), std::cmp::Reverse(vertex), to));
            }
        }
        let mut log: Vec<(usize, u8)> = Vec::new();
        let score = |counts: &[usize; 3]| (counts[2], counts[0].abs_diff(counts[1]));
        let mut best = (score(&counts), 0);
        let mut touched = Vec::new();
        let patience = 24 + separator.len() / 8;
        let mut waited = 0;
        while let Some((gain, std::cmp::Reverse(vertex), to)) = heap.pop() {
            if side[vertex] != 2 || moved[vertex] {
                continue;
            }
            let now = 1 - pulled(side, vertex, to);
            if now != gain {
                heap.push((now, std::cmp::Reverse(vertex), to));
                continue;
            }
            if counts[to as usize] + 1 > most {
                continue;
            }
            side[vertex] = to;
            moved[vertex] = true;
            touched.push(vertex);
            log.push((vertex, 2));
            counts[2] -= 1;
            counts[to as usize] += 1;
            for &other in graph.neighbors(vertex) {
                let other = other as usize;
                if side[other] == 1 - to {
                    side[other] = 2;
                    counts[1 - to as usize] -= 1;
                    counts[2] += 1;
                    log.push((other, 1 - to));
                    separator.push(other);
                    for to in [0u8, 1] {
                        heap.push((1 - pulled(side, other, to), std::cmp::Reverse(other), to));
                    }
                    // Those of the separator that saw it on the far side now gain more by leaving to this side.
                    for &near in graph.neighbors(other) {
                        let near = near as usize;
                        if side[near] == 2 && !moved[near] {
                            heap.push((1 - pulled(side, near, to), std::cmp::Reverse(near), to));
                        }
                    }
                }
            }
            if score(&counts) < best.0 {
                best = (score(&counts), log.len());
                waited = 0;
            } else {
                waited += 1;
                if waited > patience {
                    break;
                }
            }
        }
        for &(vertex, was) in log[best.1..].iter().rev() {
            counts[side[vertex] as usize] -= 1;
            counts[was as usize] += 1;
            side[vertex] = was;
        }
        touched.iter().for_each(|&vertex| moved[vertex] = false);
        separator.sort_unstable();
        separator.dedup();
        separator.retain(|&vertex| side[vertex] == 2);
        if separator.len() >= before {
            break;
        }
    }
}

/// Exact minimum degree of a small set; unknowns around it count as neighbours that stay.
fn leaf(graph: &Graph, whole: &Graph, out: &mut [u32]) {
    let count = graph.len();
    let mut around: Vec<u32> = Vec::new();
    let outside = |vertex: usize| {
        let name = graph.names[vertex];
        let all = whole.neighbors(name as usize);
        let none = all.len() == graph.neighbors(vertex).len();
        all.iter().copied().filter(move |other| !none && graph.names.binary_search(other).is_err())
    };
    for vertex in 0..count {
        around.extend(outside(vertex));
        if around.len() > 8 * HALO {
            break;
        }
    }
    around.sort_unstable();
    around.dedup();
    around.truncate(HALO);
    let words = (count + around.len()).div_ceil(64);
    let mut near = vec![0u64; count * words];
    for vertex in 0..count {
        let row = &mut near[vertex * words..][..words];
        let mut set = |at: usize| row[at / 64] |= 1 << (at % 64);
        set(vertex);
        graph.neighbors(vertex).iter().for_each(|&other| set(other as usize));
        if !around.is_empty() {
            outside(vertex).filter_map(|other| around.binary_search(&other).ok()).for_each(|at| set(count + at));
        }
    }
    let degree = |row: &[u64]| row.iter().map(|word| word.count_ones()).sum::<u32>();
    let mut degrees: Vec<u32> = near.chunks_exact(words).map(degree).collect();
    let mut pivot = vec![0u64; words];
    for out in out.iter_mut() {
        let least = degrees.iter().enumerate().min_by_key(|&(at, &degree)| (degree, at)).map_or(0, |(at, _)| at);
        *out = graph.names[least];
        degrees[least] = u32::MAX;
        pivot.copy_from_slice(&near[least * words..][..words]);
        pivot[least / 64] &= !(1 << (least % 64));
        for word in 0..count.div_ceil(64) {
            let mut bits = pivot[word];
            while bits != 0 {
                let other = word * 64 + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                if other >= count {
                    break;
                }
                let row = &mut near[other * words..][..words];
                row.iter_mut().zip(&pivot).for_each(|(row, pivot)| *row |= pivot);
                row[least / 64] &= !(1 << (least % 64));
                degrees[other] = degree(row);
            }
        }
    }
}
