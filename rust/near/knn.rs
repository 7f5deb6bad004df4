//! Exact nearest neighbours and radius search in R^D, any D, by a kd-tree.
//!
//! The tree is balanced and has no pointers: points are cut at the median of the longest side of their box until `LANES`
//! of them are left, which are kept side by side, coordinate after coordinate, so that a leaf is compared in a few vector
//! instructions. Every node has the tight box of its points; in floating point too, no point of a box is nearer than the box
//! is computed to be, since rounding is monotone and both sums run over the coordinates in the same order. So answers are
//! exactly those of comparing with every point.

use super::BATCH;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::{CHUNK, first_not_finite};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, AtomicU64, AtomicUsize, Ordering};

/// Points in a leaf.
const LANES: usize = 8;

/// Subtrees of at most so many leaves are built, and looked at for cancelling, as one task.
const TASK: usize = 256;

/// Points in R^D, ready to be asked for neighbours.
#[derive(Debug, Clone)]
pub struct KdTree {
    dimension: usize,
    count: usize,
    leaves: usize,
    /// A power of two that keeps squares of huge or tiny coordinates finite and above 0; the points are kept times it.
    scale: f64,
    /// Nodes in preorder: lower corner, upper corner.
    boxes: Vec<f64>,
    /// Leaf after leaf: [`LANES`] first coordinates, then [`LANES`] second ones ...; infinite where the last leaf is not full.
    blocks: Vec<f64>,
    /// Index of each point in the leaves' order; `u32::MAX` where the last leaf is not full.
    slots: Vec<u32>,
}

/// The points within a radius of each query, the lists one after the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Neighbors {
    /// Where the list of each query starts; queries + 1 numbers.
    pub starts: Vec<usize>,
    /// Indices of the points, nearest first.
    pub indices: Vec<u32>,
    /// Their distances.
    pub distances: Vec<f64>,
}

/// Memory that single queries use again and again, and where they leave their answer.
#[derive(Debug, Clone, Default)]
pub struct Scratch {
    indices: Vec<u32>,
    distances: Vec<f64>,
    query: Vec<f64>,
    stack: Vec<Pending>,
    found: Vec<(f64, u32)>,
}

impl Scratch {
    /// Indices of the points found by the last query, nearest first; equally near ones by index.
    pub fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// Distances of the points found by the last query.
    pub fn distances(&self) -> &[f64] {
        &self.distances
    }
}

/// A subtree still to be visited: squared distance of its box, node, range of leaves.
#[derive(Debug, Clone, Copy)]
struct Pending {
    bound: f64,
    node: u32,
    first: u32,
    last: u32,
}

/// The dimension, known when compiling where it is small.
pub(super) trait Space: Copy + Send + Sync {
    /// A point while the tree is built.
    type Record: Copy + Send;
    fn dimension(self) -> usize;
    fn record(self, points: &[f64], index: usize) -> Self::Record;
    fn coordinate(self, points: &[f64], record: &Self::Record, axis: usize) -> f64;
    fn index(self, record: &Self::Record) -> u32;
}

#[derive(Clone, Copy)]
pub(super) struct Fixed<const D: usize>;

impl<const D: usize> Space for Fixed<D> {
    type Record = ([f64; D], u32);

    #[inline(always)]
    fn dimension(self) -> usize {
        D
    }

    #[inline(always)]
    fn record(self, points: &[f64], index: usize) -> Self::Record {
        let mut point = [0.0; D];
        point.copy_from_slice(&points[index * D..][..D]);
        (point, index as u32)
    }

    #[inline(always)]
    fn coordinate(self, _: &[f64], record: &Self::Record, axis: usize) -> f64 {
        record.0[axis]
    }

    #[inline(always)]
    fn index(self, record: &Self::Record) -> u32 {
        record.1
    }
}

#[derive(Clone, Copy)]
pub(super) struct Any(pub(super) usize);

impl Space for Any {
    type Record = u32;

    #[inline(always)]
    fn dimension(self) -> usize {
        self.0
    }

    #[inline(always)]
    fn record(self, _: &[f64], index: usize) -> u32 {
        index as u32
    }

    #[inline(always)]
    fn coordinate(self, points: &[f64], record: &u32, axis: usize) -> f64 {
        points[*record as usize * self.0 + axis]
    }

    #[inline(always)]
    fn index(self, record: &u32) -> u32 {
        *record
    }
}

macro_rules! in_space {
    ($dimension:expr, $space:ident => $work:expr) => {
        match $dimension {
            1 => {
                let $space = $crate::near::knn::Fixed::<1>;
                $work
            }
            2 => {
                let $space = $crate::near::knn::Fixed::<2>;
                $work
            }
            3 => {
                let $space = $crate::near::knn::Fixed::<3>;
                $work
            }
            dimension => {
                let $space = $crate::near::knn::Any(dimension);
                $work
            }
        }
    };
}

pub(super) use in_space;

/// What a search keeps.
trait Found {
    /// Points farther than this (squared) are not wanted.
    fn bound(&self) -> f64;
    fn offer(&mut self, squared: f64, index: u32);
}

/// The k nearest in order; for small k.
struct Sorted<'a> {
    squares: &'a mut [f64],
    indices: &'a mut [u32],
}

impl Found for Sorted<'_> {
    #[inline(always)]
    fn bound(&self) -> f64 {
        self.squares[self.squares.len() - 1]
    }

    #[inline(always)]
    fn offer(&mut self, squared: f64, index: u32) {
        let mut at = self.squares.len().min(self.indices.len()) - 1;
        if !before((squared, index), (self.squares[at], self.indices[at])) {
            return;
        }
        while at > 0 && before((squared, index), (self.squares[at - 1], self.indices[at - 1])) {
            self.squares[at] = self.squares[at - 1];
            self.indices[at] = self.indices[at - 1];
            at -= 1;
        }
        self.squares[at] = squared;
        self.indices[at] = index;
    }
}

/// The k nearest in no order and some more, cut down to k again and again; for large k.
struct Pool<'a> {
    wanted: usize,
    bound: f64,
    found: &'a mut Vec<(f64, u32)>,
}

impl Pool<'_> {
    fn cut(&mut self) {
        if self.found.len() > self.wanted {
            self.found.select_nth_unstable_by(self.wanted - 1, order);
            self.found.truncate(self.wanted);
        }
        if self.found.len() == self.wanted {
            self.bound = self.found.iter().fold(0.0, |most, &(squared, _)| if squared > most { squared } else { most });
        }
    }
}

impl Found for Pool<'_> {
    #[inline(always)]
    fn bound(&self) -> f64 {
        self.bound
    }

    #[inline(always)]
    fn offer(&mut self, squared: f64, index: u32) {
        if index == u32::MAX {
            return;
        }
        self.found.push((squared, index));
        if self.found.len() >= self.wanted + self.wanted / 2 + 64 || (self.bound == f64::INFINITY && self.found.len() == self.wanted) {
            self.cut();
        }
    }
}

/// All within a radius.
struct Ball<'a> {
    radius: f64,
    bound: f64,
    found: &'a mut Vec<(f64, u32)>,
}

impl Found for Ball<'_> {
    #[inline(always)]
    fn bound(&self) -> f64 {
        self.bound
    }

    #[inline(always)]
    fn offer(&mut self, squared: f64, index: u32) {
        if squared.sqrt() <= self.radius && index != u32::MAX {
            self.found.push((squared, index));
        }
    }
}

#[inline(always)]
fn before(a: (f64, u32), b: (f64, u32)) -> bool {
    a.0 < b.0 || (a.0 == b.0 && a.1 < b.1)
}

fn order(a: &(f64, u32), b: &(f64, u32)) -> std::cmp::Ordering {
    a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
}

impl KdTree {
    /// A tree of points, `dimension` coordinates each, one after the other. Points may repeat; there may be none.
    ///
    /// ```
    /// use beltrami::{Control, near::KdTree};
    /// let tree = KdTree::new(&[0.0, 0.0, 3.0, 4.0, 1.0, 0.0], 2, &Control::default())?;
    /// let (indices, distances) = tree.nearest(&[0.0, 0.0], 2, &Control::default())?;
    /// assert_eq!((indices, distances), (vec![0, 2], vec![0.0, 1.0]));
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if `dimension` is 0 or does not divide the numbers, or a coordinate is not finite;
    /// [`Error::Cancelled`].
    pub fn new(points: &[f64], dimension: usize, control: &Control) -> Result<KdTree> {
        if dimension == 0 || !points.len().is_multiple_of(dimension) {
            return Err(Error::input(format!("{} coordinates are no whole number of points in R^{dimension}", points.len())));
        }
        let count = points.len() / dimension;
        if count > u32::MAX as usize / 2 {
            return Err(Error::input(format!("{count} points; a tree can hold up to 2^31 - 1")));
        }
        if let Some(at) = first_not_finite(points) {
            return Err(Error::input(format!(
                "coordinate {} of point {} is {}; remove that point or give it a finite position",
                at % dimension,
                at / dimension,
                points[at]
            )));
        }
        let most = points.par_iter().with_min_len(CHUNK).map(|number| number.abs()).reduce(|| 0.0, f64::max);
        let leaves = count.div_ceil(LANES);
        let mut tree = KdTree {
            dimension,
            count,
            leaves,
            scale: tame(most),
            boxes: vec![0.0; (2 * leaves).saturating_sub(1) * 2 * dimension],
            blocks: vec![f64::INFINITY; leaves * LANES * dimension],
            slots: vec![u32::MAX; leaves * LANES],
        };
        if leaves > 0 {
            in_space!(dimension, space => tree.build(space, points, control))?;
        }
        Ok(tree)
    }

    fn build<S: Space>(&mut self, space: S, points: &[f64], control: &Control) -> Result<()> {
        let mut records: Vec<S::Record> =
            (0..self.count).into_par_iter().with_min_len(CHUNK).map(|index| space.record(points, index)).collect();
        let builder = Builder { space, points, scale: self.scale, control };
        builder.subtree(&mut records, 0, self.leaves, &mut self.boxes, &mut self.blocks, &mut self.slots)
    }

    /// D.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The indices of the points in the tree's order, in which near points stand near each other: good for going through
    /// them, or for numbering them anew.
    pub fn order(&self) -> &[u32] {
        &self.slots[..self.count]
    }

    fn check_queries(&self, queries: &[f64]) -> Result<usize> {
        if !queries.len().is_multiple_of(self.dimension) {
            return Err(Error::input(format!(
                "{} coordinates are no whole number of queries in R^{}, where the points are",
                queries.len(),
                self.dimension
            )));
        }
        match first_not_finite(queries) {
            None => Ok(queries.len() / self.dimension),
            Some(at) => Err(Error::input(format!(
                "coordinate {} of query {} is {}; remove that query or give it a finite position",
                at % self.dimension,
                at / self.dimension,
                queries[at]
            ))),
        }
    }

    fn check_wanted(&self, wanted: usize) -> Result<()> {
        if wanted == 0 || wanted > self.count {
            return Err(Error::input(format!("{wanted} nearest neighbors among {} points; ask for 1 to {}", self.count, self.count)));
        }
        Ok(())
    }

    /// The `wanted` nearest points to each query, nearest first, equally near ones by index: indices and distances, a row a
    /// query. A point counts as its own neighbor if it is a query too.
    ///
    /// # Errors
    /// [`Error::Input`] if `wanted` is not from 1 to the number of points, or a query is not finite; [`Error::Numerical`] if a
    /// squared distance overflows; [`Error::Cancelled`].
    pub fn nearest(&self, queries: &[f64], wanted: usize, control: &Control) -> Result<(Vec<u32>, Vec<f64>)> {
        let count = self.check_queries(queries)?;
        self.check_wanted(wanted)?;
        let order = self.spatial_order(queries, count);
        let size = count
            .checked_mul(wanted)
            .filter(|&size| size <= isize::MAX as usize / 8)
            .ok_or_else(|| Error::input(format!("{count} queries with {wanted} neighbors each do not fit into memory")))?;
        let indices: Vec<AtomicU32> = (0..size).into_par_iter().with_min_len(CHUNK).map(|_| AtomicU32::new(0)).collect();
        let distances: Vec<AtomicU64> = (0..size).into_par_iter().with_min_len(CHUNK).map(|_| AtomicU64::new(0)).collect();
        let done = AtomicUsize::new(0);
        order.par_chunks(BATCH).try_for_each_init(Scratch::default, |scratch, batch| {
            control.report(done.fetch_add(batch.len(), Ordering::Relaxed) as f64 / count as f64)?;
            for &query in batch {
                let query = query as usize;
                in_space!(self.dimension, space =>
                    self.nearest_in(space, &queries[query * self.dimension..][..self.dimension], wanted, scratch))?;
                let row = query * wanted..(query + 1) * wanted;
                for (target, &index) in indices[row.clone()].iter().zip(&scratch.indices) {
                    target.store(index, Ordering::Relaxed);
                }
                for (target, distance) in distances[row].iter().zip(&scratch.distances) {
                    target.store(distance.to_bits(), Ordering::Relaxed);
                }
            }
            Ok(())
        })?;
        let indices = indices.into_iter().map(AtomicU32::into_inner).collect();
        Ok((indices, distances.into_iter().map(|bits| f64::from_bits(bits.into_inner())).collect()))
    }

    /// The points whose distance to a query is at most `radius`, a list a query, nearest first, equally near ones by index.
    ///
    /// # Errors
    /// [`Error::Input`] if `radius` is negative or not finite, a query is not finite, or all lists together are longer than `most`;
    /// [`Error::Cancelled`].
    pub fn within(&self, queries: &[f64], radius: f64, most: usize, control: &Control) -> Result<Neighbors> {
        let count = self.check_queries(queries)?;
        check_radius(radius)?;
        let order = self.spatial_order(queries, count);
        let (done, total) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let lists: Vec<Vec<(Vec<u32>, Vec<f64>)>> = order
            .par_chunks(BATCH)
            .map_init(Scratch::default, |scratch, batch| {
                control.report(done.fetch_add(batch.len(), Ordering::Relaxed) as f64 / count as f64)?;
                let each = batch.iter().map(|&query| {
                    let query = &queries[query as usize * self.dimension..][..self.dimension];
                    in_space!(self.dimension, space => self.within_in(space, query, radius, scratch));
                    let found = scratch.indices.len();
                    if total.fetch_add(found, Ordering::Relaxed).saturating_add(found) > most {
                        let cause = format!("more than {most} points lie within {radius} of the {count} queries; that is the most that");
                        return Err(Error::input(format!("{cause} memory has room for: take a smaller radius or fewer queries")));
                    }
                    Ok((scratch.indices.clone(), scratch.distances.clone()))
                });
                each.collect()
            })
            .collect::<Result<_>>()?;
        let mut place = vec![0; count];
        for (position, &query) in order.iter().enumerate() {
            place[query as usize] = position;
        }
        let list = |query: usize| &lists[place[query] / BATCH][place[query] % BATCH];
        let mut answer = Neighbors { starts: Vec::with_capacity(count + 1), indices: vec![], distances: vec![] };
        answer.starts.push(0);
        for query in 0..count {
            answer.indices.extend_from_slice(&list(query).0);
            answer.distances.extend_from_slice(&list(query).1);
            answer.starts.push(answer.indices.len());
        }
        Ok(answer)
    }

    /// [`KdTree::nearest`] of a single query, for kernels that ask many times: the answer is left in `scratch`.
    ///
    /// ```
    /// use beltrami::{Control, near::{KdTree, Scratch}};
    /// let tree = KdTree::new(&[0.0, 3.0, 1.0], 1, &Control::default())?;
    /// let mut scratch = Scratch::default();
    /// tree.nearest_into(&[2.0], 2, &mut scratch)?;
    /// assert_eq!(scratch.indices(), [1, 2]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// Those of [`KdTree::nearest`].
    pub fn nearest_into(&self, query: &[f64], wanted: usize, scratch: &mut Scratch) -> Result<()> {
        self.check_single(query)?;
        self.check_wanted(wanted)?;
        in_space!(self.dimension, space => self.nearest_in(space, query, wanted, scratch))
    }

    /// [`KdTree::within`] of a single query, for kernels that ask many times: the answer is left in `scratch`.
    ///
    /// # Errors
    /// Those of [`KdTree::within`].
    pub fn within_into(&self, query: &[f64], radius: f64, scratch: &mut Scratch) -> Result<()> {
        self.check_single(query)?;
        check_radius(radius)?;
        in_space!(self.dimension, space => self.within_in(space, query, radius, scratch));
        Ok(())
    }

    fn check_single(&self, query: &[f64]) -> Result<()> {
        if query.len() != self.dimension || !query.iter().all(|number| number.is_finite()) {
            return Err(Error::input(format!("the query {query:?} is no finite point of R^{}", self.dimension)));
        }
        Ok(())
    }

    fn nearest_in<S: Space>(&self, space: S, query: &[f64], wanted: usize, scratch: &mut Scratch) -> Result<()> {
        let Scratch { indices, distances, query: scaled, stack, found } = scratch;
        scaled.clear();
        scaled.extend(query.iter().map(|number| number * self.scale));
        if wanted <= 64 {
            distances.clear();
            distances.resize(wanted, f64::INFINITY);
            indices.clear();
            indices.resize(wanted, u32::MAX);
            Arch::new().dispatch(Search { tree: self, space, query: scaled, stack, found: &mut Sorted { squares: distances, indices } });
        } else {
            found.clear();
            let mut pool = Pool { wanted, bound: f64::INFINITY, found };
            Arch::new().dispatch(Search { tree: self, space, query: scaled, stack, found: &mut pool });
            pool.cut();
            found.sort_unstable_by(order);
            indices.clear();
            indices.extend(found.iter().map(|pair| pair.1));
            distances.clear();
            distances.extend(found.iter().map(|pair| pair.0));
        }
        let unscale = 1.0 / self.scale;
        for number in distances.iter_mut() {
            *number = number.sqrt() * unscale;
        }
        match distances.last() {
            Some(last) if !last.is_finite() => {
                Err(Error::numerical("a distance between points overflows; divide all coordinates by a large number"))
            }
            _ => Ok(()),
        }
    }

    fn within_in<S: Space>(&self, space: S, query: &[f64], radius: f64, scratch: &mut Scratch) {
        let Scratch { indices, distances, query: scaled, stack, found } = scratch;
        scaled.clear();
        scaled.extend(query.iter().map(|number| number * self.scale));
        found.clear();
        let radius = radius * self.scale;
        // a little more than the square, whose rounding must not lose a point: each is then compared by its distance
        let bound = radius * radius * (1.0 + 4.0 * f64::EPSILON) + f64::MIN_POSITIVE;
        Arch::new().dispatch(Search { tree: self, space, query: scaled, stack, found: &mut Ball { radius, bound, found } });
        found.sort_unstable_by(order);
        let unscale = 1.0 / self.scale;
        indices.clear();
        indices.extend(found.iter().map(|pair| pair.1));
        distances.clear();
        distances.extend(found.iter().map(|pair| pair.0.sqrt() * unscale));
    }

    /// Squared distance from a point to the box of a node.
    #[inline(always)]
    fn box_distance<S: Space>(&self, space: S, node: usize, query: &[f64]) -> f64 {
        let dimension = space.dimension();
        let corners = &self.boxes[node * 2 * dimension..][..2 * dimension];
        let (lower, upper) = corners.split_at(dimension);
        let query = &query[..dimension];
        let mut sum = 0.0;
        for axis in 0..dimension {
            let (below, above) = (lower[axis] - query[axis], query[axis] - upper[axis]);
            let beside = if below > above { below } else { above };
            let beside = if beside > 0.0 { beside } else { 0.0 };
            sum += beside * beside;
        }
        sum
    }

    #[inline(always)]
    fn search<S: Space, F: Found>(&self, space: S, query: &[f64], stack: &mut Vec<Pending>, found: &mut F) {
        let dimension = space.dimension();
        if self.leaves == 0 {
            return;
        }
        let query = &query[..dimension];
        stack.clear();
        let (mut node, mut first, mut last) = (0, 0, self.leaves);
        // where many dimensions leave boxes nothing to tell, what is left is compared without asking them
        let patience = if dimension > 8 { self.leaves / 8 } else { usize::MAX };
        let mut visited = 0;
        loop {
            if visited > patience {
                for leaf in first..last {
                    self.look_into(space, leaf, query, found);
                }
            } else if last - first > 1 {
                let middle = first + (last - first) / 2;
                let (left, right) = (node + 1, node + 2 * (middle - first));
                let (to_left, to_right) = (self.box_distance(space, left, query), self.box_distance(space, right, query));
                let bound = found.bound();
                let far = if to_left <= to_right {
                    let far = Pending { bound: to_right, node: right as u32, first: middle as u32, last: last as u32 };
                    (node, last) = (left, middle);
                    far
                } else {
                    let far = Pending { bound: to_left, node: left as u32, first: first as u32, last: middle as u32 };
                    (node, first) = (right, middle);
                    far
                };
                if far.bound <= bound {
                    stack.push(far);
                }
                if to_left <= bound || to_right <= bound {
                    continue;
                }
            } else {
                self.look_into(space, first, query, found);
                visited += 1;
            }
            loop {
                match stack.pop() {
                    None => return,
                    Some(next) if next.bound <= found.bound() => {
                        (node, first, last) = (next.node as usize, next.first as usize, next.last as usize);
                        break;
                    }
                    Some(_) => {}
                }
            }
        }
    }

    #[inline(always)]
    fn look_into<S: Space, F: Found>(&self, space: S, leaf: usize, query: &[f64], found: &mut F) {
        let dimension = space.dimension();
        let block = &self.blocks[leaf * LANES * dimension..][..LANES * dimension];
        let bound = found.bound();
        let mut squares = [0.0; LANES];
        for (axis, (&number, row)) in query[..dimension].iter().zip(block.chunks_exact(LANES)).enumerate() {
            for lane in 0..LANES {
                let difference = row[lane] - number;
                squares[lane] += difference * difference;
            }
            // in many dimensions a few of them often tell
            if dimension > 8 && axis % 8 == 7 && squares.iter().all(|&square| square > bound) {
                return;
            }
        }
        let slots = &self.slots[leaf * LANES..][..LANES];
        for lane in 0..LANES {
            if squares[lane] <= bound {
                found.offer(squares[lane], slots[lane]);
            }
        }
    }

    /// An order of the queries in which consecutive ones are near each other, so that they meet the same leaves: that of the
    /// tree if the queries are its own points, else along a Z-order curve through up to three widest sides of the box.
    fn spatial_order(&self, queries: &[f64], count: usize) -> Vec<u32> {
        if count <= BATCH || self.leaves == 0 {
            return (0..count as u32).collect();
        }
        let dimension = self.dimension;
        let own = |slot: usize| {
            let (leaf, lane) = (slot / LANES, slot % LANES);
            let block = &self.blocks[leaf * LANES * dimension..][..LANES * dimension];
            let query = &queries[self.slots[slot] as usize * dimension..][..dimension];
            query.iter().zip(block.chunks_exact(LANES)).all(|(&number, row)| number * self.scale == row[lane])
        };
        if count == self.count && (0..count).into_par_iter().with_min_len(CHUNK).all(own) {
            return self.slots[..count].to_vec();
        }
        let (lower, upper) = self.boxes[..2 * dimension].split_at(dimension);
        let mut axes: Vec<usize> = (0..dimension).collect();
        axes.sort_by(|&a, &b| (upper[b] - lower[b]).total_cmp(&(upper[a] - lower[a])));
        axes.truncate(3);
        let bits = [32, 16, 10][axes.len() - 1];
        let most = (1u64 << bits) - 1;
        let mut keys: Vec<u64> = (0..count)
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|query| {
                let mut key = 0;
                for (place, &axis) in axes.iter().enumerate() {
                    let share = (queries[query * dimension + axis] * self.scale - lower[axis]) / (upper[axis] - lower[axis]);
                    // the cast takes what is outside, and NaN of an empty side, to an end of the range
                    let cell = ((share * most as f64) as u64).min(most);
                    key |= spread(cell, axes.len()) << place;
                }
                key << 32 | query as u64
            })
            .collect();
        keys.par_sort_unstable();
        keys.into_par_iter().with_min_len(CHUNK).map(|key| key as u32).collect()
    }
}

/// The bits of a number, `step` places apart.
fn spread(number: u64, step: usize) -> u64 {
    if step == 1 {
        return number;
    }
    (0..32 / step + 1).map(|bit| (number >> bit & 1) << (bit * step)).sum()
}

/// A search compiled for the processor at hand.
struct Search<'a, S, F> {
    tree: &'a KdTree,
    space: S,
    query: &'a [f64],
    stack: &'a mut Vec<Pending>,
    found: &'a mut F,
}

impl<S: Space, F: Found> WithSimd for Search<'_, S, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, _: V) {
        self.tree.search(self.space, self.query, self.stack, self.found);
    }
}

fn check_radius(radius: f64) -> Result<()> {
    if radius.is_finite() && radius >= 0.0 {
        return Ok(());
    }
    Err(Error::input(format!("the radius is {radius}; it must be finite and at least 0")))
}

/// 1, or a power of two that brings numbers as large as `most` near 1 where squares would overflow or vanish.
pub(super) fn tame(most: f64) -> f64 {
    if most == 0.0 || (1e-100..=1e100).contains(&most) {
        return 1.0;
    }
    2f64.powi((-most.log2().floor()).clamp(-1022.0, 1022.0) as i32)
}

struct Builder<'a, S: Space> {
    space: S,
    points: &'a [f64],
    scale: f64,
    control: &'a Control,
}

impl<S: Space> Builder<'_, S> {
    fn subtree(
        &self,
        records: &mut [S::Record],
        first: usize,
        last: usize,
        boxes: &mut [f64],
        blocks: &mut [f64],
        slots: &mut [u32],
    ) -> Result<()> {
        let (space, points, dimension) = (self.space, self.points, self.space.dimension());
        let (own, below) = boxes.split_at_mut(2 * dimension);
        let (lower, upper) = own.split_at_mut(dimension);
        lower.fill(f64::INFINITY);
        upper.fill(f64::NEG_INFINITY);
        for record in records.iter() {
            for axis in 0..dimension {
                let number = space.coordinate(points, record, axis);
                lower[axis] = if number < lower[axis] { number } else { lower[axis] };
                upper[axis] = if number > upper[axis] { number } else { upper[axis] };
            }
        }
        let mut widest = 0;
        for axis in 1..dimension {
            // halves, since the difference of two huge coordinates may overflow
            if 0.5 * upper[axis] - 0.5 * lower[axis] > 0.5 * upper[widest] - 0.5 * lower[widest] {
                widest = axis;
            }
        }
        for number in own.iter_mut() {
            *number *= self.scale;
        }
        if last - first > TASK {
            self.control.check()?;
        }
        if last - first == 1 {
            for (lane, record) in records.iter().enumerate() {
                slots[lane] = space.index(record);
                for axis in 0..dimension {
                    blocks[axis * LANES + lane] = space.coordinate(points, record, axis) * self.scale;
                }
            }
            return Ok(());
        }
        let middle = first + (last - first) / 2;
        let left = middle - first;
        records.select_nth_unstable_by(left * LANES, |a, b| {
            let (x, y) = (space.coordinate(points, a, widest), space.coordinate(points, b, widest));
            x.total_cmp(&y).then(space.index(a).cmp(&space.index(b)))
        });
        let records = records.split_at_mut(left * LANES);
        let boxes = below.split_at_mut((2 * left - 1) * 2 * dimension);
        let blocks = blocks.split_at_mut(left * LANES * dimension);
        let slots = slots.split_at_mut(left * LANES);
        let mut lefts = || self.subtree(records.0, first, middle, boxes.0, blocks.0, slots.0);
        let mut rights = || self.subtree(records.1, middle, last, boxes.1, blocks.1, slots.1);
        if last - first > TASK {
            let (a, b) = rayon::join(lefts, rights);
            a.and(b)
        } else {
            lefts().and_then(|()| rights())
        }
    }
}
