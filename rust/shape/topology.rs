//! Which triangles meet where: edges, components, boundary curves, manifoldness, orientation, genus.

use crate::error::{Error, Result};
use crate::shape::TriangleMesh;
use crate::sparse::CHUNK;
use rayon::prelude::*;

const NONE: u32 = u32::MAX;

/// Connectivity of a triangle mesh.
///
/// Half-edge `3 f + k` runs from corner `k` of face `f` to its corner `(k + 1) % 3`. A face that names a vertex twice is
/// no triangle: it is left out of everything here, and [`Topology::degenerate_faces`] counts it. Vertices of no (other)
/// face belong to no component and do not count in the Euler characteristic.
#[derive(Debug, Clone)]
pub struct Topology<'a> {
    faces: &'a [[u32; 3]],
    edges: Vec<[u32; 2]>,
    starts: Vec<u32>,
    half_edges: Vec<u32>,
    edge_of: Vec<u32>,
    degrees: Vec<u32>,
    first_corners: Vec<u32>,
    degenerate: usize,
}

/// What lies across a half-edge.
enum Across {
    Nothing,
    One(u32),
    Many,
}

/// A boundary curve.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BoundaryLoop {
    /// Its vertices in order, with the surface on the left where the faces are consistently oriented; the first is not repeated.
    pub vertices: Vec<u32>,
    /// False only at a curve that ends where more than two faces share an edge.
    pub closed: bool,
}

/// True for a face that names a vertex twice.
pub(crate) fn repeats_a_corner(face: &[u32; 3]) -> bool {
    face[0] == face[1] || face[1] == face[2] || face[2] == face[0]
}

/// Cuts `slice` at `ends` (ascending, the last one its length).
pub(crate) fn cut<T>(mut slice: &mut [T], ends: impl Iterator<Item = usize>) -> Vec<&mut [T]> {
    let mut parts = Vec::new();
    let mut start = 0;
    for end in ends {
        let (part, rest) = slice.split_at_mut(end - start);
        parts.push(part);
        slice = rest;
        start = end;
    }
    parts
}

impl<'a> Topology<'a> {
    /// The connectivity of a mesh.
    ///
    /// ```
    /// use beltrami::{TriangleMesh, shape::Topology};
    /// let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0], vec![[0, 1, 2], [0, 2, 3]])?;
    /// let topology = Topology::new(&mesh)?;
    /// assert_eq!((topology.edges().len(), topology.euler_characteristic()), (5, 1));
    /// assert_eq!(topology.boundary_loops()[0].vertices, [0, 1, 2, 3]);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if there are more than 2^32 / 3 faces.
    pub fn new(mesh: &'a TriangleMesh<'_>) -> Result<Self> {
        Self::of_faces(mesh.vertex_count(), mesh.faces())
    }

    /// The same from faces alone; they must be in range.
    pub(crate) fn of_faces(vertex_count: usize, faces: &'a [[u32; 3]]) -> Result<Self> {
        if faces.len() >= NONE as usize / 3 {
            return Err(Error::input(format!("{} faces; the connectivity of at most {} can be found", faces.len(), NONE / 3 - 1)));
        }
        // Half-edges go into one bucket for each lesser end; a bucket is then sorted by the greater one.
        let mut bounds = vec![0u32; vertex_count + 1];
        let (mut degrees, mut first_corners) = (vec![0u32; vertex_count], vec![NONE; vertex_count]);
        let mut degenerate = 0;
        for (number, face) in faces.iter().enumerate() {
            if repeats_a_corner(face) {
                degenerate += 1;
                continue;
            }
            for k in 0..3 {
                let vertex = face[k] as usize;
                bounds[face[k].min(face[(k + 1) % 3]) as usize + 1] += 1;
                if degrees[vertex] == 0 {
                    first_corners[vertex] = (3 * number + k) as u32;
                }
                degrees[vertex] += 1;
            }
        }
        for vertex in 0..vertex_count {
            bounds[vertex + 1] += bounds[vertex];
        }
        let mut next = bounds.clone();
        let mut keys = vec![0u64; bounds[vertex_count] as usize];
        for (number, face) in faces.iter().enumerate().filter(|(_, face)| !repeats_a_corner(face)) {
            for k in 0..3 {
                let (a, b) = (face[k], face[(k + 1) % 3]);
                let place = &mut next[a.min(b) as usize];
                keys[*place as usize] = (u64::from(a.max(b)) << 32) | (3 * number + k) as u64;
                *place += 1;
            }
        }
        drop(next);
        let chunks = vertex_count.div_ceil(CHUNK);
        let chunk_end = |chunk: usize| bounds[((chunk + 1) * CHUNK).min(vertex_count)] as usize;
        let parts = cut(&mut keys, (0..chunks).map(chunk_end));
        let bucket = |chunk: usize, vertex: usize| {
            let offset = bounds[chunk * CHUNK] as usize;
            bounds[vertex] as usize - offset..bounds[vertex + 1] as usize - offset
        };
        let vertices_of = |chunk: usize| chunk * CHUNK..((chunk + 1) * CHUNK).min(vertex_count);
        let counts: Vec<usize> = parts
            .into_par_iter()
            .enumerate()
            .map(|(chunk, keys)| {
                let mut edges = 0;
                for vertex in vertices_of(chunk) {
                    let keys = &mut keys[bucket(chunk, vertex)];
                    keys.sort_unstable();
                    edges += usize::from(!keys.is_empty()) + keys.windows(2).filter(|pair| pair[0] >> 32 != pair[1] >> 32).count();
                }
                edges
            })
            .collect();
        let ends: Vec<usize> = counts
            .iter()
            .scan(0, |sum, count| {
                *sum += count;
                Some(*sum)
            })
            .collect();
        let edge_count = ends.last().copied().unwrap_or(0);
        let (mut edges, mut starts) = (vec![[0; 2]; edge_count], vec![0; edge_count + 1]);
        starts[edge_count] = keys.len() as u32;
        let edge_parts = cut(&mut edges, ends.iter().copied());
        let start_parts = cut(&mut starts[..edge_count], ends.iter().copied());
        edge_parts.into_par_iter().zip(start_parts).enumerate().for_each(|(chunk, (edges, starts))| {
            let mut at = 0;
            for vertex in vertices_of(chunk) {
                let mut last = NONE;
                for place in bounds[vertex]..bounds[vertex + 1] {
                    let far = (keys[place as usize] >> 32) as u32;
                    if far != last {
                        (edges[at], starts[at]) = ([vertex as u32, far], place);
                        at += 1;
                        last = far;
                    }
                }
            }
        });
        let half_edges: Vec<u32> = keys.par_iter().with_min_len(CHUNK).map(|&key| key as u32).collect();
        drop(keys);
        let mut edge_of = vec![NONE; 3 * faces.len()];
        for edge in 0..edge_count {
            for &half_edge in &half_edges[starts[edge] as usize..starts[edge + 1] as usize] {
                edge_of[half_edge as usize] = edge as u32;
            }
        }
        Ok(Topology { faces, edges, starts, half_edges, edge_of, degrees, first_corners, degenerate })
    }

    /// The edges as pairs of vertices, the lesser first, sorted.
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// The half-edges on an edge (one at the boundary, two inside, more where the mesh is not manifold), ascending; each
    /// divided by 3 is its face.
    ///
    /// # Panics
    /// If there is no such edge.
    pub fn edge_half_edges(&self, edge: usize) -> &[u32] {
        &self.half_edges[self.starts[edge] as usize..self.starts[edge + 1] as usize]
    }

    /// The edge of half-edge `3 face + k`; `None` if the face names a vertex twice.
    ///
    /// # Panics
    /// If there is no such half-edge.
    pub fn edge_of(&self, half_edge: usize) -> Option<usize> {
        Some(self.edge_of[half_edge]).filter(|&edge| edge != NONE).map(|edge| edge as usize)
    }

    /// Number of triangles at each vertex.
    pub fn vertex_degrees(&self) -> &[u32] {
        &self.degrees
    }

    /// Number of faces that name a vertex twice and are left out.
    pub fn degenerate_faces(&self) -> usize {
        self.degenerate
    }

    /// Number of vertices that belong to no triangle.
    pub fn unreferenced_vertices(&self) -> usize {
        self.degrees.iter().filter(|&&degree| degree == 0).count()
    }

    /// Vertices - edges + faces, of the vertices that belong to a triangle.
    pub fn euler_characteristic(&self) -> i64 {
        let vertices = self.degrees.len() - self.unreferenced_vertices();
        vertices as i64 - self.edges.len() as i64 + (self.faces.len() - self.degenerate) as i64
    }

    /// For each vertex the number of its component (numbered by their first vertices), -1 for vertices of no triangle; and
    /// the number of components. Triangles that share a vertex are connected.
    pub fn components(&self) -> (Vec<i32>, usize) {
        let mut parents: Vec<u32> = (0..self.degrees.len() as u32).collect();
        for face in self.faces.iter().filter(|face| !repeats_a_corner(face)) {
            unite(&mut parents, face[0], face[1]);
            unite(&mut parents, face[1], face[2]);
        }
        let mut labels = vec![-1; parents.len()];
        let mut count = 0;
        for vertex in 0..parents.len() as u32 {
            if self.degrees[vertex as usize] == 0 {
                continue;
            }
            let root = find(&mut parents, vertex);
            if root == vertex {
                labels[vertex as usize] = count as i32;
                count += 1;
            } else {
                labels[vertex as usize] = labels[root as usize]; // a root is the least of its vertices
            }
        }
        (labels, count)
    }

    /// True if there are triangles and none has a free edge.
    pub fn is_closed(&self) -> bool {
        !self.edges.is_empty() && self.starts.par_windows(2).with_min_len(CHUNK).all(|pair| pair[1] - pair[0] > 1)
    }

    /// The first edge that more than two triangles share.
    pub fn non_manifold_edge(&self) -> Option<usize> {
        self.starts.par_windows(2).with_min_len(CHUNK).position_first(|pair| pair[1] - pair[0] > 2)
    }

    /// The vertices whose triangles are not all connected through edges at the vertex (two cones that touch, for example).
    pub fn non_manifold_vertices(&self) -> Vec<u32> {
        let vertices = 0..self.degrees.len() as u32;
        let (mut wrong, hard): (Vec<_>, Vec<_>) = vertices
            .into_par_iter()
            .with_min_len(CHUNK)
            .filter_map(|vertex| match (self.degrees[vertex as usize], self.fan_size(vertex)) {
                (0, _) => None,
                (_, None) => Some((vertex, false)),
                (degree, Some(size)) => (size != degree).then_some((vertex, true)),
            })
            .partition(|&(_, wrong)| wrong);
        if !hard.is_empty() {
            wrong.extend(self.separated(&hard).into_iter().map(|vertex| (vertex, true)));
            wrong.sort_unstable();
        }
        wrong.into_iter().map(|(vertex, _)| vertex).collect()
    }

    /// Those of the vertices at which some edge has more than two faces whose triangles are not connected through edges.
    fn separated(&self, hard: &[(u32, bool)]) -> Vec<u32> {
        let mut slots = vec![NONE; self.degrees.len()];
        for (slot, &(vertex, _)) in hard.iter().enumerate() {
            slots[vertex as usize] = slot as u32;
        }
        // (slot, edge at the vertex, corner): corners of one slot with the same edge are connected
        let mut meetings = Vec::new();
        let mut corners = vec![0; hard.len()];
        for (number, face) in self.faces.iter().enumerate().filter(|(_, face)| !repeats_a_corner(face)) {
            for k in 0..3 {
                let slot = slots[face[k] as usize];
                if slot != NONE {
                    let corner = corners[slot as usize];
                    corners[slot as usize] += 1;
                    for half_edge in [3 * number + k, 3 * number + (k + 2) % 3] {
                        meetings.push((slot, self.edge_of[half_edge], corner));
                    }
                }
            }
        }
        meetings.par_sort_unstable();
        let mut wrong = Vec::new();
        for group in meetings.chunk_by(|a, b| a.0 == b.0) {
            let slot = group[0].0 as usize;
            let mut parents: Vec<u32> = (0..corners[slot]).collect();
            for pair in group.windows(2).filter(|pair| pair[0].1 == pair[1].1) {
                unite(&mut parents, pair[0].2, pair[1].2);
            }
            if (0..corners[slot]).any(|corner| find(&mut parents, corner) != 0) {
                wrong.push(hard[slot].0);
            }
        }
        wrong
    }

    /// Why the mesh is not manifold, `None` if it is: every edge has one or two triangles, and the triangles at every
    /// vertex form one fan.
    pub fn non_manifold_reason(&self) -> Option<String> {
        if let Some(edge) = self.non_manifold_edge() {
            let faces: Vec<String> = self.edge_half_edges(edge).iter().take(4).map(|half_edge| (half_edge / 3).to_string()).collect();
            let (count, [a, b]) = (self.edge_half_edges(edge).len(), self.edges[edge]);
            let more = if count > 4 { " ..." } else { "" };
            return Some(format!("{count} faces ({}{more}) share the edge from vertex {a} to vertex {b}", faces.join(", ")));
        }
        let wrong = self.non_manifold_vertices();
        let vertex = wrong.first()?;
        Some(match wrong.len() {
            1 => format!("the faces at vertex {vertex} form more than one fan"),
            count => format!("the faces at {count} vertices, the first of them {vertex}, form more than one fan"),
        })
    }

    /// The two faces of an edge that run along it in the same direction, `None` if the faces are consistently oriented.
    /// Edges of more than two faces say nothing about orientation.
    pub fn inconsistent_edge(&self) -> Option<usize> {
        (0..self.edges.len()).into_par_iter().with_min_len(CHUNK).find_first(|&edge| match self.edge_half_edges(edge) {
            &[one, other] => self.tail(one) == self.tail(other),
            _ => false,
        })
    }

    /// For each face whether turning it around makes all faces consistently oriented; in each part connected through
    /// edges the fewer faces are turned (if equally many, its first face is kept).
    ///
    /// # Errors
    /// [`Error::Topology`] if the surface has one side only, as a Möbius band; the edge where that shows is named.
    pub fn turned_faces(&self) -> Result<Vec<bool>> {
        let mut turned = vec![false; self.faces.len()];
        if self.inconsistent_edge().is_none() {
            return Ok(turned);
        }
        let mut seen = vec![false; self.faces.len()];
        let mut part = Vec::new();
        for seed in 0..self.faces.len() {
            if seen[seed] || repeats_a_corner(&self.faces[seed]) {
                continue;
            }
            part.clear();
            part.push(seed as u32);
            seen[seed] = true;
            let (mut at, mut count) = (0, 0);
            while let Some(&face) = part.get(at) {
                at += 1;
                count += usize::from(turned[face as usize]);
                for half_edge in 3 * face..3 * face + 3 {
                    let Across::One(other) = self.across(half_edge) else { continue };
                    let wanted = turned[face as usize] ^ (self.tail(half_edge) == self.tail(other));
                    let next = other as usize / 3;
                    if !seen[next] {
                        (seen[next], turned[next]) = (true, wanted);
                        part.push(next as u32);
                    } else if turned[next] != wanted {
                        let [a, b] = self.edges[self.edge_of[half_edge as usize] as usize];
                        return Err(Error::Topology(format!(
                            "the surface has one side only (like a Möbius band): its faces {face} and {next} cannot agree at the edge from vertex {a} to vertex {b}; the tufted Laplacian works on such surfaces"
                        )));
                    }
                }
            }
            if 2 * count > part.len() {
                for &face in &part {
                    turned[face as usize] ^= true;
                }
            }
        }
        Ok(turned)
    }

    /// The faces, consistently oriented, as [`Topology::turned_faces`] says; their first corners stay.
    ///
    /// # Errors
    /// Those of [`Topology::turned_faces`].
    pub fn oriented_faces(&self) -> Result<Vec<[u32; 3]>> {
        let turned = self.turned_faces()?;
        Ok(self.faces.iter().zip(turned).map(|(&[a, b, c], turned)| if turned { [a, c, b] } else { [a, b, c] }).collect())
    }

    /// The genus, summed over components: handles of the surface, boundary curves filled.
    ///
    /// # Errors
    /// [`Error::Topology`] if the mesh is not manifold or has one side only.
    pub fn genus(&self) -> Result<usize> {
        if let Some(reason) = self.non_manifold_reason() {
            return Err(Error::Topology(format!("the mesh is not manifold, so it has no genus: {reason}")));
        }
        self.turned_faces()?;
        let twice = 2 * self.components().1 as i64 - self.euler_characteristic() - self.boundary_loops().len() as i64;
        Ok((twice / 2) as usize)
    }

    /// The boundary curves, in the order of their first edges. Where two of them touch at a vertex they stay two.
    pub fn boundary_loops(&self) -> Vec<BoundaryLoop> {
        let boundary: Vec<u32> = (0..self.edges.len() as u32)
            .into_par_iter()
            .with_min_len(CHUNK)
            .filter(|&edge| self.starts[edge as usize + 1] - self.starts[edge as usize] == 1)
            .collect();
        // End 2 i + s is the tail (s = 0) or tip (s = 1) of the only half-edge of boundary edge i; partners are the two ends
        // at a vertex that the same fan of triangles joins.
        let vertex_of = |end: usize| {
            let half_edge = self.half_edges[self.starts[boundary[end / 2] as usize] as usize];
            if end.is_multiple_of(2) { self.tail(half_edge) } else { self.tip(half_edge) }
        };
        let mut partners: Vec<u32> = (0..2 * boundary.len())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|end| {
                let vertex = vertex_of(end);
                let half_edge = self.half_edges[self.starts[boundary[end / 2] as usize] as usize];
                let Some(other) = self.end_of_fan(vertex, self.other_side(vertex, half_edge)) else { return NONE };
                let Ok(place) = boundary.binary_search(&self.edge_of[other as usize]) else { return NONE };
                (2 * place + usize::from(self.tip(other) == vertex)) as u32
            })
            .collect();
        let mut left: Vec<(u32, u32)> =
            (0..partners.len()).filter(|&end| partners[end] == NONE).map(|end| (vertex_of(end), end as u32)).collect();
        left.sort_unstable();
        let mut at = 0;
        while at + 1 < left.len() {
            let ((vertex, end), (other_vertex, other)) = (left[at], left[at + 1]);
            if vertex == other_vertex && end / 2 != other / 2 {
                (partners[end as usize], partners[other as usize]) = (other, end);
                at += 2;
            } else {
                at += 1;
            }
        }
        let mut seen = vec![false; boundary.len()];
        let mut loops = Vec::new();
        let mut follow = |first: usize, closed: bool| {
            if seen[first / 2] {
                return;
            }
            let mut vertices = vec![vertex_of(first)];
            let mut end = first;
            loop {
                seen[end / 2] = true;
                let far = end ^ 1;
                let partner = partners[far];
                if partner == NONE {
                    vertices.push(vertex_of(far));
                    break;
                }
                if partner as usize == first {
                    break;
                }
                vertices.push(vertex_of(far));
                end = partner as usize;
            }
            loops.push((first / 2, BoundaryLoop { vertices, closed }));
        };
        (0..partners.len()).filter(|&end| partners[end] == NONE).for_each(|end| follow(end, false));
        (0..boundary.len()).for_each(|edge| follow(2 * edge, true));
        loops.sort_by_key(|(first, _)| *first);
        loops.into_iter().map(|(_, found)| found).collect()
    }

    pub(crate) fn tail(&self, half_edge: u32) -> u32 {
        self.faces[half_edge as usize / 3][half_edge as usize % 3]
    }

    pub(crate) fn tip(&self, half_edge: u32) -> u32 {
        self.faces[half_edge as usize / 3][(half_edge as usize % 3 + 1) % 3]
    }

    fn across(&self, half_edge: u32) -> Across {
        match self.edge_half_edges(self.edge_of[half_edge as usize] as usize) {
            [_] => Across::Nothing,
            &[one, other] => Across::One(if one == half_edge { other } else { one }),
            _ => Across::Many,
        }
    }

    /// The other edge at `vertex` of the triangle that `half_edge` belongs to.
    fn other_side(&self, vertex: u32, half_edge: u32) -> u32 {
        let (face, side) = (half_edge / 3 * 3, half_edge % 3);
        if self.tail(half_edge) == vertex { face + (side + 2) % 3 } else { face + (side + 1) % 3 }
    }

    /// From triangle to triangle around `vertex`, first across `half_edge`: the free edge at the end, `None` if an edge of
    /// more than two faces comes first. The caller starts from a free edge, so the walk ends.
    fn end_of_fan(&self, vertex: u32, mut half_edge: u32) -> Option<u32> {
        loop {
            match self.across(half_edge) {
                Across::Nothing => return Some(half_edge),
                Across::One(other) => half_edge = self.other_side(vertex, other),
                Across::Many => return None,
            }
        }
    }

    /// How many triangles the fan of the first corner at `vertex` has; `None` if an edge in it has more than two faces.
    fn fan_size(&self, vertex: u32) -> Option<u32> {
        let corner = self.first_corners[vertex as usize];
        if corner == NONE {
            return Some(0);
        }
        let mut size = 1;
        for first in [corner, self.other_side(vertex, corner)] {
            let mut half_edge = first;
            loop {
                match self.across(half_edge) {
                    Across::Nothing => break,
                    Across::Many => return None,
                    Across::One(other) => half_edge = self.other_side(vertex, other),
                }
                if half_edge == first {
                    return Some(size); // all around
                }
                size += 1;
            }
        }
        Some(size)
    }
}

/// The root of an element's tree; roots are the least elements of their trees.
pub(crate) fn find(parents: &mut [u32], mut element: u32) -> u32 {
    while parents[element as usize] != element {
        let above = parents[parents[element as usize] as usize];
        parents[element as usize] = above;
        element = above;
    }
    element
}

/// Joins two trees.
pub(crate) fn unite(parents: &mut [u32], a: u32, b: u32) {
    let (a, b) = (find(parents, a), find(parents, b));
    match a.cmp(&b) {
        std::cmp::Ordering::Less => parents[b as usize] = a,
        std::cmp::Ordering::Greater => parents[a as usize] = b,
        std::cmp::Ordering::Equal => {}
    }
}
