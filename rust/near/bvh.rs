//! Closest points on a triangle mesh, in R^D, and first hits of rays, in R^3.
//!
//! Triangles are sorted along a Hilbert curve; consecutive ones share a box, consecutive boxes share a box, and so on: a
//! packed tree that is built in a few passes over the mesh. Everything is computed in double precision, and the tree leaves
//! nothing out: what it finds is what looking at every triangle finds.

use super::{BATCH, knn};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::shape::TriangleMesh;
use crate::sparse::{CHUNK, first_not_finite};
use knn::{Space, in_space};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Triangles in a leaf.
const LEAF: usize = 4;

/// Boxes in a node, compared together.
const WIDTH: usize = 8;

/// A triangle mesh, ready to be asked for closest points and hit by rays.
#[derive(Debug, Clone)]
pub struct Bvh<'a> {
    dimension: usize,
    /// A power of two that keeps squares of huge or tiny coordinates finite and above 0; vertices are kept times it.
    scale: f64,
    vertices: Cow<'a, [f64]>,
    faces: &'a [[u32; 3]],
    /// Faces along the curve.
    order: Vec<u32>,
    /// From the leaves up. A node is [`WIDTH`] boxes: lower and upper bounds on the first axis, then on the second ...
    levels: Vec<Vec<f64>>,
    lower: Vec<f64>,
    upper: Vec<f64>,
}

/// The point of a mesh that is closest to a query.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosestPoints {
    /// Coordinates of the closest points, one after the other.
    pub points: Vec<f64>,
    /// Their distances from the queries.
    pub distances: Vec<f64>,
    /// The faces they lie on; of several equally near ones the least.
    pub faces: Vec<u32>,
    /// Barycentric coordinates on these faces: at least 0, sum 1.
    pub barycentric: Vec<[f64; 3]>,
}

/// Where rays meet a mesh first.
#[derive(Debug, Clone, PartialEq)]
pub struct Hits {
    /// The faces that are hit, of several at the same distance the least; `u32::MAX` where a ray misses.
    pub faces: Vec<u32>,
    /// Distances from the origins, whatever the length of the directions; infinite where a ray misses.
    pub distances: Vec<f64>,
    /// Barycentric coordinates of the hits; 0 where a ray misses.
    pub barycentric: Vec<[f64; 3]>,
}

#[derive(Debug, Clone, Copy)]
struct Pending {
    bound: f64,
    level: u32,
    node: u32,
}

/// The best triangle so far.
#[derive(Debug, Clone, Copy)]
struct Best {
    square: f64,
    face: u32,
    barycentric: [f64; 3],
}

impl<'a> Bvh<'a> {
    /// A tree of the triangles of a mesh. Degenerate triangles count as the segments or points that they are.
    ///
    /// ```
    /// use beltrami::{Control, TriangleMesh, near::Bvh};
    /// let mesh = TriangleMesh::new(3, vec![0., 0., 0., 2., 0., 0., 0., 2., 0.], vec![[0, 1, 2]])?;
    /// let found = Bvh::new(&mesh, &Control::default())?.closest(&[0.5, 0.5, 3.0], &Control::default())?;
    /// assert_eq!((found.points, found.distances), (vec![0.5, 0.5, 0.0], vec![3.0]));
    /// assert_eq!(found.barycentric, [[0.5, 0.25, 0.25]]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if the mesh has no faces; [`Error::Cancelled`].
    pub fn new(mesh: &'a TriangleMesh<'_>, control: &Control) -> Result<Bvh<'a>> {
        let (dimension, faces) = (mesh.dimension(), mesh.faces());
        if faces.is_empty() {
            return Err(Error::input("the mesh has no faces: there is no closest point and nothing to hit"));
        }
        if faces.len() > u32::MAX as usize / 2 {
            return Err(Error::input(format!("{} faces; up to 2^31 - 1 are possible", faces.len())));
        }
        let scale = knn::tame(mesh.vertices().par_iter().with_min_len(CHUNK).map(|number| number.abs()).reduce(|| 0.0, f64::max));
        let vertices = match scale {
            1.0 => Cow::Borrowed(mesh.vertices()),
            _ => Cow::Owned(mesh.vertices().par_iter().map(|number| number * scale).collect()),
        };
        let mut bvh = Bvh { dimension, scale, vertices, faces, order: vec![], levels: vec![], lower: vec![], upper: vec![] };
        in_space!(dimension, space => bvh.build(space, control))?;
        Ok(bvh)
    }

    #[inline(always)]
    fn corner<S: Space>(&self, space: S, vertex: u32) -> &[f64] {
        &self.vertices[vertex as usize * space.dimension()..][..space.dimension()]
    }

    fn build<S: Space>(&mut self, space: S, control: &Control) -> Result<()> {
        let dimension = space.dimension();
        let (lower, upper) = self
            .vertices
            .par_chunks(dimension * CHUNK)
            .map(|points| {
                let mut corners = (vec![f64::INFINITY; dimension], vec![f64::NEG_INFINITY; dimension]);
                for point in points.chunks_exact(dimension) {
                    for (axis, &number) in point.iter().enumerate() {
                        corners.0[axis] = least(number, corners.0[axis]);
                        corners.1[axis] = most(number, corners.1[axis]);
                    }
                }
                corners
            })
            .reduce_with(|mut a, b| {
                for axis in 0..dimension {
                    a.0[axis] = least(a.0[axis], b.0[axis]);
                    a.1[axis] = most(a.1[axis], b.1[axis]);
                }
                a
            })
            .unwrap_or_default();
        (self.lower, self.upper) = (lower, upper);
        let curve = Curve::new(&self.lower, &self.upper);
        control.report(0.1)?;
        let mut keys: Vec<(u64, u32)> = self
            .faces
            .par_iter()
            .with_min_len(CHUNK)
            .enumerate()
            .map(|(index, face)| {
                let [a, b, c] = face.map(|vertex| self.corner(space, vertex));
                (curve.key(|axis| (a[axis] + b[axis] + c[axis]) * (1.0 / 3.0)), index as u32)
            })
            .collect();
        control.report(0.4)?;
        keys.par_sort_unstable();
        control.report(0.7)?;
        self.order = keys.into_par_iter().with_min_len(CHUNK).map(|key| key.1).collect();
        let size = 2 * dimension * WIDTH;
        let mut below = vec![0.0; self.order.len().div_ceil(LEAF * WIDTH) * size];
        below.par_chunks_mut(size).with_min_len(CHUNK / WIDTH).zip(self.order.par_chunks(LEAF * WIDTH)).for_each(|(node, faces)| {
            for (lane, leaf) in faces.chunks(LEAF).enumerate() {
                for axis in 0..dimension {
                    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
                    for &face in leaf {
                        for vertex in self.faces[face as usize] {
                            let number = self.vertices[vertex as usize * dimension + axis];
                            (low, high) = (least(number, low), most(number, high));
                        }
                    }
                    node[2 * axis * WIDTH + lane] = low;
                    node[(2 * axis + 1) * WIDTH + lane] = high;
                }
            }
        });
        let mut count = self.order.len().div_ceil(LEAF); // boxes in `below`
        loop {
            let nodes = count.div_ceil(WIDTH);
            if nodes == 1 {
                self.levels.push(below);
                return control.report(1.0);
            }
            let mut above = vec![0.0; nodes.div_ceil(WIDTH) * size];
            above.par_chunks_mut(size).with_min_len(CHUNK / WIDTH).enumerate().for_each(|(index, node)| {
                for lane in 0..WIDTH.min(nodes - index * WIDTH) {
                    let child = index * WIDTH + lane;
                    let some = WIDTH.min(count - child * WIDTH);
                    for axis in 0..dimension {
                        let rows = &below[child * size + 2 * axis * WIDTH..][..2 * WIDTH];
                        node[2 * axis * WIDTH + lane] = rows[..some].iter().copied().fold(f64::INFINITY, least);
                        node[(2 * axis + 1) * WIDTH + lane] = rows[WIDTH..][..some].iter().copied().fold(f64::NEG_INFINITY, most);
                    }
                }
            });
            self.levels.push(std::mem::replace(&mut below, above));
            count = nodes;
        }
    }

    /// Boxes there are in a node.
    #[inline(always)]
    fn boxes(&self, level: usize, node: usize) -> usize {
        let below = if level == 0 { self.order.len().div_ceil(LEAF) } else { self.levels[level - 1].len() / (2 * self.dimension * WIDTH) };
        WIDTH.min(below - node * WIDTH)
    }

    fn check(&self, numbers: &[f64], what: &str) -> Result<usize> {
        if !numbers.len().is_multiple_of(self.dimension) {
            return Err(Error::input(format!(
                "{} coordinates are no whole number of {what}s in R^{}, where the mesh is",
                numbers.len(),
                self.dimension
            )));
        }
        match first_not_finite(numbers) {
            None => Ok(numbers.len() / self.dimension),
            Some(at) => Err(Error::input(format!(
                "coordinate {} of {what} {} is {}; it must be finite",
                at % self.dimension,
                at / self.dimension,
                numbers[at]
            ))),
        }
    }

    /// The queries along the curve, so that consecutive ones meet the same triangles.
    fn query_order(&self, queries: &[f64], count: usize) -> Vec<u32> {
        let curve = Curve::new(&self.lower, &self.upper);
        let mut keys: Vec<(u64, u32)> = (0..count)
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|query| (curve.key(|axis| queries[query * self.dimension + axis] * self.scale), query as u32))
            .collect();
        keys.par_sort_unstable();
        keys.into_iter().map(|key| key.1).collect()
    }

    /// The closest point of the mesh to each query.
    ///
    /// # Errors
    /// [`Error::Input`] if a query is not finite; [`Error::Numerical`] if a squared distance overflows;
    /// [`Error::Cancelled`].
    pub fn closest(&self, queries: &[f64], control: &Control) -> Result<ClosestPoints> {
        let count = self.check(queries, "query")?;
        let order = self.query_order(queries, count);
        let done = AtomicUsize::new(0);
        let batches: Vec<Vec<Best>> = order
            .par_chunks(BATCH)
            .map_init(Vec::new, |stack, batch| {
                control.report(done.fetch_add(batch.len(), Ordering::Relaxed) as f64 / count as f64)?;
                Ok(in_space!(self.dimension, space => Arch::new().dispatch(Closest { bvh: self, space, queries, batch, stack })))
            })
            .collect::<Result<_>>()?;
        let place = places(&order);
        let best = |query: usize| &batches[place[query] as usize / BATCH][place[query] as usize % BATCH];
        let unscale = 1.0 / self.scale;
        let mut answer = ClosestPoints {
            points: vec![0.0; count * self.dimension],
            distances: (0..count).into_par_iter().with_min_len(CHUNK).map(|query| best(query).square.sqrt() * unscale).collect(),
            faces: (0..count).into_par_iter().with_min_len(CHUNK).map(|query| best(query).face).collect(),
            barycentric: (0..count).into_par_iter().with_min_len(CHUNK).map(|query| best(query).barycentric).collect(),
        };
        if let Some(query) = answer.distances.iter().position(|distance| !distance.is_finite()) {
            return Err(Error::numerical(format!("the distance of query {query} overflows; divide all coordinates by a large number")));
        }
        answer.points.par_chunks_mut(self.dimension).with_min_len(CHUNK).enumerate().for_each(|(query, point)| {
            let Best { face, barycentric, .. } = best(query);
            let corners = self.faces[*face as usize].map(|vertex| &self.vertices[vertex as usize * self.dimension..]);
            for (axis, number) in point.iter_mut().enumerate() {
                *number = combine(*barycentric, corners.map(|corner| corner[axis])) * unscale;
            }
        });
        Ok(answer)
    }

    /// Squared distances to the boxes of a node.
    #[inline(always)]
    fn box_distances<S: Space>(&self, space: S, level: usize, node: usize, query: &[f64]) -> [f64; WIDTH] {
        let dimension = space.dimension();
        let boxes = &self.levels[level][node * 2 * dimension * WIDTH..][..2 * dimension * WIDTH];
        let mut sums = [0.0; WIDTH];
        for (rows, &number) in boxes.chunks_exact(2 * WIDTH).zip(query) {
            let (lower, upper) = rows.split_at(WIDTH);
            for lane in 0..WIDTH {
                let beside = most(most(lower[lane] - number, number - upper[lane]), 0.0);
                sums[lane] += beside * beside;
            }
        }
        sums
    }

    /// `slack` bounds the rounding of a distance to a triangle.
    #[inline(always)]
    fn closest_to<S: Space>(&self, space: S, query: &[f64], hint: u32, slack: f64, stack: &mut Vec<Pending>) -> Best {
        let mut best = self.on_face(space, query, hint);
        let mut bound = widened(best.square, slack);
        stack.clear();
        stack.push(Pending { bound: 0.0, level: self.levels.len() as u32 - 1, node: 0 });
        while let Some(Pending { bound: to_node, level, node }) = stack.pop() {
            if to_node > bound {
                continue;
            }
            let (level, node) = (level as usize, node as usize);
            let squares = self.box_distances(space, level, node, query);
            let mut near = [(0.0, 0u32); WIDTH]; // nearest last
            let mut some = 0;
            for (lane, &square) in squares[..self.boxes(level, node)].iter().enumerate() {
                if square <= bound {
                    let mut at = some;
                    while at > 0 && near[at - 1].0 < square {
                        near[at] = near[at - 1];
                        at -= 1;
                    }
                    near[at] = (square, lane as u32);
                    some += 1;
                }
            }
            if level > 0 {
                for &(square, lane) in &near[..some] {
                    stack.push(Pending { bound: square, level: level as u32 - 1, node: (node * WIDTH) as u32 + lane });
                }
                continue;
            }
            for &(square, lane) in near[..some].iter().rev() {
                if square > bound {
                    break;
                }
                let first = (node * WIDTH + lane as usize) * LEAF;
                for &face in &self.order[first..(first + LEAF).min(self.order.len())] {
                    let found = self.on_face(space, query, face);
                    if found.square < best.square || (found.square == best.square && face < best.face) {
                        best = found;
                        bound = widened(best.square, slack);
                    }
                }
            }
        }
        best
    }

    /// The closest point of one face.
    ///
    /// Along the longest edge and the height above it, which are orthogonal, so that slivers keep their digits; else on an
    /// edge, taken from its vertex of least number, so that both its faces find the same bits.
    #[inline(always)]
    fn on_face<S: Space>(&self, space: S, query: &[f64], face: u32) -> Best {
        let dimension = space.dimension();
        let vertices = self.faces[face as usize];
        let corners = vertices.map(|vertex| self.corner(space, vertex));
        let lengths: [f64; 3] = std::array::from_fn(|k| squared(corners[(k + 1) % 3], corners[k]));
        let first = if lengths[0] >= lengths[1] && lengths[0] >= lengths[2] {
            0
        } else if lengths[1] >= lengths[2] {
            1
        } else {
            2
        };
        let [a, b, c] = [corners[first], corners[(first + 1) % 3], corners[(first + 2) % 3]];
        let (mut third, mut along) = (0.0, 0.0);
        for axis in 0..dimension {
            let edge = b[axis] - a[axis];
            third += (c[axis] - a[axis]) * edge;
            along += (query[axis] - a[axis]) * edge;
        }
        let inverse = 1.0 / lengths[first];
        let (third, along) = (third * inverse, along * inverse);
        let (mut height, mut up) = (0.0, 0.0);
        for axis in 0..dimension {
            let above = (c[axis] - a[axis]) - third * (b[axis] - a[axis]);
            height += above * above;
            up += (query[axis] - a[axis]) * above;
        }
        let w = up / height;
        let v = along - w * third;
        let u = 1.0 - v - w;
        if u >= 0.0 && v >= 0.0 && w >= 0.0 && u <= 1.0 && v <= 1.0 && w <= 1.0 {
            let mut square = 0.0;
            for axis in 0..dimension {
                let edge = b[axis] - a[axis];
                let above = (c[axis] - a[axis]) - third * edge;
                let rest = (query[axis] - a[axis]) - along * edge - w * above;
                square += rest * rest;
            }
            let mut barycentric = [0.0; 3];
            (barycentric[first], barycentric[(first + 1) % 3], barycentric[(first + 2) % 3]) = (u, v, w);
            return Best { square, face, barycentric };
        }
        let mut best = Best { square: f64::INFINITY, face, barycentric: [1.0, 0.0, 0.0] };
        for (k, length) in lengths.iter().enumerate() {
            let (mut i, mut j) = (k, (k + 1) % 3);
            if vertices[j] < vertices[i] {
                (i, j) = (j, i);
            }
            let (from, to) = (corners[i], corners[j]);
            let mut along = 0.0;
            for axis in 0..dimension {
                along += (query[axis] - from[axis]) * (to[axis] - from[axis]);
            }
            let share = along / length;
            let share = if share > 0.0 { least(share, 1.0) } else { 0.0 };
            let mut square = 0.0;
            for axis in 0..dimension {
                // at an end the difference itself, so that all faces around a vertex find the same bits
                let rest = if share < 1.0 { (query[axis] - from[axis]) - share * (to[axis] - from[axis]) } else { query[axis] - to[axis] };
                square += rest * rest;
            }
            if square < best.square {
                let mut barycentric = [0.0; 3];
                (barycentric[i], barycentric[j]) = (1.0 - share, share);
                best = Best { square, face, barycentric };
            }
        }
        best
    }

    /// The first hit of each ray: the point nearest to its origin, the origin itself included.
    ///
    /// The test is that of Woop, Benthin and Wald (2013): a ray through an edge or a vertex is never lost between the faces
    /// there. Rays within a face's plane do not hit it.
    ///
    /// # Errors
    /// [`Error::Input`] if the mesh is not in R^3, a number is not finite, a direction is zero, or there are not as many
    /// origins as directions; [`Error::Cancelled`].
    pub fn intersect(&self, origins: &[f64], directions: &[f64], control: &Control) -> Result<Hits> {
        if self.dimension != 3 {
            return Err(Error::input(format!("rays meet surfaces in R^3, this mesh is in R^{}", self.dimension)));
        }
        let count = self.check(origins, "origin")?;
        if self.check(directions, "direction")? != count {
            return Err(Error::input(format!("{count} origins and {} directions; there must be as many", directions.len() / 3)));
        }
        if let Some(ray) = directions.chunks_exact(3).position(|direction| direction.iter().all(|&number| number == 0.0)) {
            return Err(Error::input(format!("direction {ray} is zero; a ray needs a direction")));
        }
        let order = self.query_order(origins, count);
        let done = AtomicUsize::new(0);
        let batches: Vec<Vec<Best>> = order
            .par_chunks(BATCH)
            .map_init(Vec::new, |stack, batch| {
                control.report(done.fetch_add(batch.len(), Ordering::Relaxed) as f64 / count as f64)?;
                Ok(Arch::new().dispatch(Rays { bvh: self, origins, directions, batch, stack }))
            })
            .collect::<Result<_>>()?;
        let place = places(&order);
        let best = |ray: usize| &batches[place[ray] as usize / BATCH][place[ray] as usize % BATCH];
        let unscale = 1.0 / self.scale;
        Ok(Hits {
            faces: (0..count).map(|ray| best(ray).face).collect(),
            distances: (0..count).map(|ray| best(ray).square * unscale).collect(),
            barycentric: (0..count).map(|ray| best(ray).barycentric).collect(),
        })
    }

    /// First hit of a ray with a direction of length 1; [`Best::square`] is the distance.
    #[inline(always)]
    fn first_hit(&self, ray: &Ray, stack: &mut Vec<Pending>) -> Best {
        let mut best = Best { square: f64::INFINITY, face: u32::MAX, barycentric: [0.0; 3] };
        stack.clear();
        stack.push(Pending { bound: 0.0, level: self.levels.len() as u32 - 1, node: 0 });
        while let Some(Pending { bound: to_node, level, node }) = stack.pop() {
            if to_node > best.square {
                continue;
            }
            let (level, node) = (level as usize, node as usize);
            let boxes = &self.levels[level][node * 6 * WIDTH..][..6 * WIDTH];
            let (mut enter, mut leave) = ([0.0; WIDTH], [f64::MAX; WIDTH]);
            for (axis, rows) in boxes.chunks_exact(2 * WIDTH).enumerate() {
                let (origin, inverse) = (ray.origin[axis], ray.inverse[axis]);
                for lane in 0..WIDTH {
                    let low = (rows[lane] - origin - ray.slack) * inverse;
                    let high = (rows[WIDTH + lane] - origin + ray.slack) * inverse;
                    enter[lane] = most(least(low, high), enter[lane]);
                    leave[lane] = least(most(low, high), leave[lane]);
                }
            }
            let mut near = [(0.0, 0u32); WIDTH]; // nearest last
            let mut some = 0;
            for lane in 0..self.boxes(level, node) {
                // a few roundings more, so that none hides a hit
                let (from, to) = (enter[lane] * (1.0 - 1e-14), leave[lane] * (1.0 + 1e-14));
                if from <= to && from <= best.square {
                    let mut at = some;
                    while at > 0 && near[at - 1].0 < from {
                        near[at] = near[at - 1];
                        at -= 1;
                    }
                    near[at] = (from, lane as u32);
                    some += 1;
                }
            }
            if level > 0 {
                for &(from, lane) in &near[..some] {
                    stack.push(Pending { bound: from, level: level as u32 - 1, node: (node * WIDTH) as u32 + lane });
                }
                continue;
            }
            for &(from, lane) in near[..some].iter().rev() {
                if from > best.square {
                    break;
                }
                let first = (node * WIDTH + lane as usize) * LEAF;
                for &face in &self.order[first..(first + LEAF).min(self.order.len())] {
                    if let Some((distance, barycentric)) = self.hit(ray, face)
                        && (distance < best.square || (distance == best.square && face < best.face))
                    {
                        best = Best { square: distance, face, barycentric };
                    }
                }
            }
        }
        best
    }

    /// Distance and barycentric coordinates where a ray hits a face.
    #[inline(always)]
    fn hit(&self, ray: &Ray, face: u32) -> Option<(f64, [f64; 3])> {
        let [x, y, z] = ray.axes;
        let sheared = self.faces[face as usize].map(|vertex| {
            let corner = self.corner(knn::Fixed::<3>, vertex);
            let depth = corner[z] - ray.origin[z];
            [corner[x] - ray.origin[x] - ray.shear[0] * depth, corner[y] - ray.origin[y] - ray.shear[1] * depth, ray.shear[2] * depth]
        });
        // the same two products for both faces of an edge, only exchanged: their signs agree to the last bit
        let area = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - p[1] * q[0];
        let [a, b, c] = sheared;
        let (u, v, w) = (area(c, b), area(a, c), area(b, a));
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let determinant = u + v + w;
        if determinant == 0.0 || determinant.is_nan() {
            return None;
        }
        let barycentric = [u / determinant, v / determinant, w / determinant];
        let distance = combine(barycentric, [a[2], b[2], c[2]]);
        (distance >= 0.0 && distance.is_finite()).then_some((distance, barycentric))
    }
}

struct Closest<'a, 'b, S> {
    bvh: &'a Bvh<'b>,
    space: S,
    queries: &'a [f64],
    batch: &'a [u32],
    stack: &'a mut Vec<Pending>,
}

impl<S: Space> WithSimd for Closest<'_, '_, S> {
    type Output = Vec<Best>;

    #[inline(always)]
    fn with_simd<V: Simd>(self, _: V) -> Vec<Best> {
        let Closest { bvh, space, queries, batch, stack } = self;
        let dimension = space.dimension();
        let extent = (0..dimension).fold(0.0, |sum: f64, axis| sum + (bvh.upper[axis] - bvh.lower[axis]));
        let mut scaled = vec![0.0; dimension];
        let mut hint = None;
        let mut found = Vec::with_capacity(batch.len());
        for &query in batch {
            let given = &queries[query as usize * dimension..][..dimension];
            let mut outside = 0.0;
            for axis in 0..dimension {
                scaled[axis] = given[axis] * bvh.scale;
                outside += most(most(bvh.lower[axis] - scaled[axis], scaled[axis] - bvh.upper[axis]), 0.0);
            }
            let slack = 32.0 * f64::EPSILON * (extent + outside);
            let best = bvh.closest_to(space, &scaled, hint.unwrap_or(bvh.order[0]), slack, stack);
            hint = Some(best.face);
            found.push(best);
        }
        found
    }
}

struct Rays<'a, 'b> {
    bvh: &'a Bvh<'b>,
    origins: &'a [f64],
    directions: &'a [f64],
    batch: &'a [u32],
    stack: &'a mut Vec<Pending>,
}

impl WithSimd for Rays<'_, '_> {
    type Output = Vec<Best>;

    #[inline(always)]
    fn with_simd<V: Simd>(self, _: V) -> Vec<Best> {
        let Rays { bvh, origins, directions, batch, stack } = self;
        let mut found = Vec::with_capacity(batch.len());
        for &index in batch {
            let at = 3 * index as usize;
            let ray = Ray::new(bvh, &origins[at..at + 3], &directions[at..at + 3]);
            found.push(bvh.first_hit(&ray, stack));
        }
        found
    }
}

/// A ray, prepared for boxes and for triangles.
struct Ray {
    origin: [f64; 3],
    inverse: [f64; 3],
    /// Two axes and the one that the direction is longest along, in an order that keeps orientation.
    axes: [usize; 3],
    shear: [f64; 3],
    slack: f64,
}

impl Ray {
    #[inline(always)]
    fn new(bvh: &Bvh, origin: &[f64], direction: &[f64]) -> Ray {
        let origin: [f64; 3] = std::array::from_fn(|axis| origin[axis] * bvh.scale);
        // divided by the largest first: its square may overflow or vanish
        let size = direction.iter().fold(0.0, |size: f64, number| size.max(number.abs()));
        let direction: [f64; 3] = std::array::from_fn(|axis| direction[axis] / size);
        let length = direction.iter().map(|number| number * number).sum::<f64>().sqrt();
        let direction = direction.map(|number| number / length);
        let mut z = 0;
        for axis in 1..3 {
            if direction[axis].abs() > direction[z].abs() {
                z = axis;
            }
        }
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if direction[z] < 0.0 {
            (x, y) = (y, x);
        }
        let reach = (0..3)
            .fold(0.0, |reach: f64, axis| reach.max((bvh.lower[axis] - origin[axis]).abs()).max((bvh.upper[axis] - origin[axis]).abs()));
        Ray {
            origin,
            inverse: direction.map(|number| if number.abs() > 1e-200 { 1.0 / number } else { 1e200f64.copysign(number) }),
            axes: [x, y, z],
            shear: [direction[x] / direction[z], direction[y] / direction[z], 1.0 / direction[z]],
            slack: 16.0 * f64::EPSILON * reach,
        }
    }
}

#[inline(always)]
fn least(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[inline(always)]
fn most(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

#[inline(always)]
fn widened(square: f64, slack: f64) -> f64 {
    let distance = square.sqrt() + slack;
    least(distance * distance, f64::MAX)
}

#[inline(always)]
fn squared(a: &[f64], b: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (x, y) in a.iter().zip(b) {
        sum += (x - y) * (x - y);
    }
    sum
}

#[inline(always)]
fn combine(weights: [f64; 3], numbers: [f64; 3]) -> f64 {
    weights[0] * numbers[0] + weights[1] * numbers[1] + weights[2] * numbers[2]
}

fn places(order: &[u32]) -> Vec<u32> {
    let mut place = vec![0; order.len()];
    for (position, &query) in order.iter().enumerate() {
        place[query as usize] = position as u32;
    }
    place
}

/// A Hilbert curve through a box, along its (up to) three widest sides.
struct Curve {
    axes: Vec<usize>,
    lower: Vec<f64>,
    steps: f64,
}

/// Bits of a coordinate on the curve.
const BITS: u32 = 20;

impl Curve {
    fn new(lower: &[f64], upper: &[f64]) -> Curve {
        let mut axes: Vec<usize> = (0..lower.len()).collect();
        axes.sort_by(|&a, &b| (upper[b] - lower[b]).total_cmp(&(upper[a] - lower[a])));
        axes.truncate(3);
        let widest = upper[axes[0]] - lower[axes[0]];
        let steps = if widest > 0.0 { ((1u64 << BITS) - 1) as f64 / widest } else { 0.0 };
        Curve { lower: axes.iter().map(|&axis| lower[axis]).collect(), axes, steps }
    }

    /// The place of a point on the curve (Skilling 2004).
    #[inline(always)]
    fn key(&self, coordinate: impl Fn(usize) -> f64) -> u64 {
        let mut x = [0u32; 3];
        for (place, &axis) in self.axes.iter().enumerate() {
            // the cast takes what is outside, and NaN, to an end of the range
            x[place] = (((coordinate(axis) - self.lower[place]) * self.steps) as u32).min((1 << BITS) - 1);
        }
        let mut q = 1 << (BITS - 1);
        while q > 1 {
            let low = q - 1;
            for k in 0..3 {
                // without branches: the bits are as good as random
                let set = 0u32.wrapping_sub((x[k] & q != 0) as u32);
                let swap = (x[0] ^ x[k]) & low & !set;
                x[0] ^= swap | (low & set);
                x[k] ^= swap;
            }
            q >>= 1;
        }
        x[1] ^= x[0];
        x[2] ^= x[1];
        let mut turn = 0;
        let mut q = 1 << (BITS - 1);
        while q > 1 {
            turn ^= (q - 1) & 0u32.wrapping_sub((x[2] & q != 0) as u32);
            q >>= 1;
        }
        spread(x[0] ^ turn) << 2 | spread(x[1] ^ turn) << 1 | spread(x[2] ^ turn)
    }
}

/// The bits of a number of up to 21 bits, three places apart.
#[inline(always)]
fn spread(number: u32) -> u64 {
    let mut x = number as u64;
    x = (x | x << 32) & 0x1f00000000ffff;
    x = (x | x << 16) & 0x1f0000ff0000ff;
    x = (x | x << 8) & 0x100f00f00f00f00f;
    x = (x | x << 4) & 0x10c30c30c30c30c3;
    (x | x << 2) & 0x1249249249249249
}
