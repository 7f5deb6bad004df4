//! Intrinsic triangulations: triangles known by their edge lengths and by how they are glued, made Delaunay by flips.
//!
//! Bobenko & Springborn 2007 (intrinsic Delaunay triangulations), Fisher, Springborn, Bobenko & Schröder 2006 (the flip
//! algorithm), Sharp & Crane 2020 (mollified lengths and the tufted cover, "A Laplacian for nonmanifold triangle meshes").

use crate::control::Control;
use crate::error::{Error, Result};
use crate::shape::glue::{FREE, Glue};
use crate::shape::mesh::{area, squared_edge_lengths};
use crate::shape::topology::repeats_a_corner;
use crate::shape::{Topology, TriangleMesh};
use crate::sparse::CHUNK;
use crate::vector::{cross, dot};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// Every triangle's two shorter edges exceed its longest by at least this share of it; below, rounding decides the angles.
const SLACK: f64 = 1e-10;
/// The same for triangles that shrink to a point, as a share of the mean edge length.
const LEAST_SLACK: f64 = 1e-13;
/// Cotangents that sum to less than this share of themselves below zero make an edge worth flipping.
const TOLERANCE: f64 = 1e-14;
/// Flips allowed for each edge, on average. Sound meshes need one or less, stretched ones some tens.
const MOST_FLIPS: usize = 1000;

/// A Delaunay triangulation of a surface by geodesic edges between its vertices.
///
/// Half-edge `3 f + k` runs from corner `k` of triangle `f` to the next; a triangle can name a vertex twice, and two
/// triangles can share two edges. On a tufted cover each triangle of the mesh is there twice, front and back, and
/// everything is weighted by a half.
#[derive(Debug, Clone)]
pub struct IntrinsicTriangulation {
    vertex_count: usize,
    glue: Glue,
    lengths: Vec<f64>, // in `unit`s
    unit: f64,
    weight: f64,
    flips: usize,
    mollified: usize,
    left_out: usize,
}

/// Area of a triangle from its edge lengths, accurate for slivers too (Kahan); 0 where they make no triangle.
pub(crate) fn area_of(lengths: [f64; 3]) -> f64 {
    let [mut a, mut b, mut c] = lengths;
    if a < b {
        (a, b) = (b, a);
    }
    if b < c {
        (b, c) = (c, b);
    }
    if a < b {
        (a, b) = (b, a);
    }
    let product = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c));
    if product > 0.0 { 0.25 * product.sqrt() } else { 0.0 }
}

/// Cotangent of the angle between the sides `b` and `c`, opposite to `a`, in a triangle of this area.
pub(crate) fn cotangent_of(a: f64, b: f64, c: f64, area: f64) -> f64 {
    ((b - a) * (b + a) + c * c) / (4.0 * area)
}

/// Faces that have three corners, their edges and lengths, ready to be glued.
struct Start {
    faces: Vec<[u32; 3]>,
    left_out: usize,
    unit: f64,
}

impl Start {
    fn new(mesh: &TriangleMesh<'_>) -> Result<Self> {
        let faces: Vec<[u32; 3]> = mesh.faces().iter().filter(|face| !repeats_a_corner(face)).copied().collect();
        if faces.is_empty() {
            return Err(Error::input(format!("the mesh has no triangle ({} vertices); operators need at least one", mesh.vertex_count())));
        }
        let largest = faces
            .par_iter()
            .with_min_len(CHUNK)
            .map(|face| {
                let [a, b, c] = face.map(|corner| mesh.vertex(corner));
                (0..mesh.dimension()).map(|axis| (a[axis] - b[axis]).abs().max((b[axis] - c[axis]).abs())).fold(0.0, f64::max)
            })
            .reduce(|| 0.0, f64::max);
        if largest == 0.0 {
            return Err(Error::input("all triangles lie in one point; the mesh has no extent"));
        }
        if !(1e-140..1e140).contains(&largest) {
            return Err(Error::input(format!(
                "the mesh has edges of length {largest:.3e}, whose squares are out of the range of double precision; rescale it"
            )));
        }
        let left_out = mesh.faces().len() - faces.len();
        Ok(Start { faces, left_out, unit: 2f64.powi(largest.log2().round() as i32) })
    }

    fn lengths(&self, mesh: &TriangleMesh<'_>, topology: &Topology<'_>) -> Vec<f64> {
        topology
            .edges()
            .par_iter()
            .with_min_len(CHUNK)
            .map(|&[a, b]| {
                let (a, b) = (mesh.vertex(a), mesh.vertex(b));
                a.iter().zip(b).map(|(x, y)| ((x - y) / self.unit).powi(2)).sum::<f64>().sqrt()
            })
            .collect()
    }
}

/// The intrinsic Delaunay triangulation of a mesh whose edges have one or two triangles and that has two sides.
///
/// Lengths of degenerate triangles are mollified, so that all areas are positive; faces that name a vertex twice are left
/// out. Faces that are not consistently oriented are turned.
///
/// ```
/// use beltrami::{Control, TriangleMesh, shape::intrinsic_delaunay};
/// // a long diagonal across a kite: the other one is Delaunay
/// let kite = TriangleMesh::new(2, vec![-2.0, 0.0, 0.0, -0.5, 2.0, 0.0, 0.0, 0.5], vec![[0, 1, 2], [0, 2, 3]])?;
/// let delaunay = intrinsic_delaunay(&kite, &Control::default())?;
/// assert_eq!(delaunay.flips(), 1);
/// assert!((delaunay.face_areas().iter().sum::<f64>() - 2.0).abs() < 1e-14);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Topology`] if an edge has more than two triangles or the surface has one side (use [`tufted`]);
/// [`Error::Input`] if there is no triangle with extent or its size is out of range; [`Error::NotConverged`] if the flips do not
/// end; [`Error::Cancelled`].
pub fn intrinsic_delaunay(mesh: &TriangleMesh<'_>, control: &Control) -> Result<IntrinsicTriangulation> {
    let mut start = Start::new(mesh)?;
    let mut topology = Topology::of_faces(mesh.vertex_count(), &start.faces)?;
    if let Some(edge) = topology.non_manifold_edge() {
        let [a, b] = topology.edges()[edge];
        return Err(Error::Topology(format!(
            "{} faces share the edge from vertex {a} to vertex {b}, so the mesh has no intrinsic triangulation; use the tufted Laplacian",
            topology.edge_half_edges(edge).len()
        )));
    }
    control.report(0.1)?;
    if topology.inconsistent_edge().is_some() {
        let oriented = topology.oriented_faces()?;
        drop(topology);
        start.faces = oriented;
        topology = Topology::of_faces(mesh.vertex_count(), &start.faces)?;
    }
    let mut lengths = start.lengths(mesh, &topology);
    let mollified = mollify(&topology, &mut lengths, control)?;
    control.report(0.2)?;
    let mut twins = vec![FREE; 3 * start.faces.len()];
    for edge in 0..topology.edges().len() {
        if let &[one, other] = topology.edge_half_edges(edge) {
            (twins[one as usize], twins[other as usize]) = (other, one);
        }
    }
    let lengths = spread(&topology, &lengths, start.faces.len());
    drop(topology);
    let mut triangulation = IntrinsicTriangulation {
        vertex_count: mesh.vertex_count(),
        glue: Glue::from_parts(start.faces, twins),
        lengths,
        unit: start.unit,
        weight: 1.0,
        flips: 0,
        mollified,
        left_out: start.left_out,
    };
    triangulation.flip_to_delaunay(control)?;
    Ok(triangulation)
}

/// The intrinsic Delaunay triangulation of the tufted cover of any mesh: each triangle twice, front and back, glued around
/// each edge to the next sheet, so that the cover is closed, manifold and two-sided whatever the mesh is (Sharp & Crane
/// 2020). On closed manifold meshes it gives the operators of [`intrinsic_delaunay`].
///
/// ```
/// use beltrami::{Control, TriangleMesh, shape::tufted};
/// // three triangles on one edge
/// let fan = TriangleMesh::new(3, vec![0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, -1.0, 1.0, 0.0, -1.0, -1.0, 0.0],
///     vec![[0, 1, 2], [0, 1, 3], [0, 1, 4]])?;
/// let area = fan.area();
/// assert!((tufted(&fan, &Control::default())?.mass().iter().sum::<f64>() - area).abs() < 1e-14);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`], [`Error::NotConverged`] and [`Error::Cancelled`] as for [`intrinsic_delaunay`].
pub fn tufted(mesh: &TriangleMesh<'_>, control: &Control) -> Result<IntrinsicTriangulation> {
    let start = Start::new(mesh)?;
    let count = start.faces.len();
    if count > u32::MAX as usize / 6 - 1 {
        return Err(Error::input(format!("{count} faces; the tufted cover of at most {} can be made", u32::MAX / 6 - 1)));
    }
    let topology = Topology::of_faces(mesh.vertex_count(), &start.faces)?;
    control.report(0.1)?;
    let mut lengths = start.lengths(mesh, &topology);
    let mollified = mollify(&topology, &mut lengths, control)?;
    control.report(0.2)?;
    let back = |half_edge: u32| 3 * (count as u32 + half_edge / 3) + 2 - half_edge % 3;
    let mut twins = vec![FREE; 6 * count];
    let mut sheets = Vec::new();
    for (edge, &[low, _]) in topology.edges().iter().enumerate() {
        sheets.clear();
        sheets.extend_from_slice(topology.edge_half_edges(edge));
        if sheets.len() > 2 && mesh.dimension() == 3 {
            sort_around(mesh, &topology, edge, &mut sheets);
        }
        // Of each triangle one copy runs up the edge and one down; up faces the next sheet's down.
        for (at, &here) in sheets.iter().enumerate() {
            let next = sheets[(at + 1) % sheets.len()];
            let up = if topology.tail(here) == low { here } else { back(here) };
            let down = if topology.tail(next) == low { back(next) } else { next };
            (twins[up as usize], twins[down as usize]) = (down, up);
        }
    }
    let mut spread = spread(&topology, &lengths, count);
    drop(topology);
    spread.resize(6 * count, 0.0);
    for half_edge in 0..3 * count as u32 {
        spread[back(half_edge) as usize] = spread[half_edge as usize];
    }
    let mut faces = start.faces;
    faces.extend_from_within(..);
    faces[count..].iter_mut().for_each(|face| face.swap(1, 2));
    let mut triangulation = IntrinsicTriangulation {
        vertex_count: mesh.vertex_count(),
        glue: Glue::from_parts(faces, twins),
        lengths: spread,
        unit: start.unit,
        weight: 0.5,
        flips: 0,
        mollified,
        left_out: start.left_out,
    };
    triangulation.flip_to_delaunay(control)?;
    Ok(triangulation)
}

/// Sorts the half-edges on an edge by the angle of their triangles around it, counterclockwise seen from its greater vertex.
fn sort_around(mesh: &TriangleMesh<'_>, topology: &Topology<'_>, edge: usize, sheets: &mut [u32]) {
    let [low, high] = topology.edges()[edge];
    let from_low = |vertex: u32| {
        let (p, q) = (mesh.vertex(vertex), mesh.vertex(low));
        [p[0] - q[0], p[1] - q[1], p[2] - q[2]]
    };
    let axis = from_low(high);
    let size = dot(axis, axis).sqrt();
    // the normals of the triangles turn about the axis as the triangles do
    let normal = |half_edge: u32| cross(axis, from_low(topology.tail(Glue::previous(half_edge))));
    let first = normal(sheets[0]);
    let mut angles: Vec<(f64, u32)> = sheets
        .iter()
        .map(|&sheet| {
            let here = normal(sheet);
            let angle = dot(cross(first, here), axis).atan2(dot(first, here) * size);
            (if sheet == sheets[0] { 0.0 } else { angle.rem_euclid(TAU) }, sheet)
        })
        .collect();
    angles.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for (place, (_, sheet)) in sheets.iter_mut().zip(angles) {
        *place = sheet;
    }
}

/// Lengths of edges to lengths of half-edges.
fn spread(topology: &Topology<'_>, lengths: &[f64], faces: usize) -> Vec<f64> {
    (0..3 * faces)
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|half_edge| topology.edge_of(half_edge).map_or(0.0, |edge| lengths[edge]))
        .collect()
}

/// Lengthens edges of triangles that are degenerate to rounding, as little as that takes, and returns how many. The edges
/// of other triangles keep their lengths; where that does not come to an end all edges are lengthened alike, which always
/// does it (Sharp & Crane 2020, 4.5).
fn mollify(topology: &Topology<'_>, lengths: &mut [f64], control: &Control) -> Result<usize> {
    let parts: Vec<f64> = lengths.par_chunks(CHUNK).map(|part| part.iter().sum()).collect();
    let least = LEAST_SLACK * parts.iter().sum::<f64>() / lengths.len().max(1) as f64;
    let faces = topology.vertex_degrees().iter().map(|&degree| degree as usize).sum::<usize>() / 3;
    let edges_of = |face: usize| -> Option<[usize; 3]> {
        Some([topology.edge_of(3 * face)?, topology.edge_of(3 * face + 1)?, topology.edge_of(3 * face + 2)?])
    };
    // how much the two shorter edges fall short, and which these are
    let shortfall = |lengths: &[f64], face: usize, share: f64| -> Option<(f64, [usize; 2])> {
        let [a, b, c] = edges_of(face)?;
        let (longest, others) = if lengths[a] >= lengths[b] && lengths[a] >= lengths[c] {
            (a, [b, c])
        } else if lengths[b] >= lengths[c] {
            (b, [a, c])
        } else {
            (c, [a, b])
        };
        let wanted = SLACK * lengths[longest] + least;
        let slack = lengths[others[0]] - (lengths[longest] - lengths[others[1]]);
        (slack < share * wanted).then_some((wanted - slack, others))
    };
    let mut queue: VecDeque<usize> =
        (0..faces).into_par_iter().with_min_len(CHUNK).filter(|&face| shortfall(lengths, face, 0.5).is_some()).collect::<Vec<_>>().into();
    if queue.is_empty() {
        return Ok(0);
    }
    let original = lengths.to_vec();
    let mut allowed = 100 * queue.len() + 1000;
    while let Some(face) = queue.pop_front() {
        let Some((missing, others)) = shortfall(lengths, face, 0.5) else { continue };
        if allowed == 0 {
            break;
        }
        allowed -= 1;
        if allowed.is_multiple_of(4096) {
            control.check()?;
        }
        for edge in others {
            lengths[edge] += 0.5 * missing;
            queue.extend(topology.edge_half_edges(edge).iter().map(|half_edge| *half_edge as usize / 3));
        }
    }
    if allowed == 0 {
        let all = (0..faces)
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|face| shortfall(&original, face, 1.0).map_or(0.0, |(missing, _)| missing))
            .reduce(|| 0.0, f64::max);
        lengths.iter_mut().zip(&original).for_each(|(length, before)| *length = before + all);
    }
    Ok(lengths.iter().zip(&original).filter(|(now, before)| now != before).count())
}

/// The two triangles on an edge, laid out: the edge from (0, 0) to (length, 0), one apex above, the other below.
struct Diamond {
    length: f64,
    above: [f64; 2],
    below: [f64; 2],
    cotangents: [f64; 2],
}

/// The triangle with the least height for its longest edge: its number and twice its area over that edge's square, 0 for
/// corners on a line; NaN (counted as least) where that is beyond double precision. Faces that name a vertex twice count.
/// `None` without faces.
///
/// ```
/// use beltrami::{TriangleMesh, shape::thinnest_face};
/// let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 2.0, 0.0, 1.0, 0.5, 1.0, 1.5], vec![[0, 1, 3], [0, 1, 2]])?;
/// assert_eq!(thinnest_face(&mesh), Some((1, 0.25)));
/// # Ok::<(), beltrami::Error>(())
/// ```
pub fn thinnest_face(mesh: &TriangleMesh<'_>) -> Option<(usize, f64)> {
    let rank = |ratio: f64| if ratio.is_nan() { -1.0 } else { ratio };
    (0..mesh.faces().len())
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|face| (face, mesh.at_corners(face, |p| 2.0 * area(p) / squared_edge_lengths(p).into_iter().fold(0.0, f64::max))))
        .min_by(|a, b| rank(a.1).total_cmp(&rank(b.1)).then(a.0.cmp(&b.0)))
}

impl IntrinsicTriangulation {
    /// A triangulation from its parts, as [`IntrinsicTriangulation::faces`], [`twins`](IntrinsicTriangulation::twins),
    /// [`lengths`](IntrinsicTriangulation::lengths) and [`is_cover`](IntrinsicTriangulation::is_cover) give them; they are checked.
    /// It need not be Delaunay. `u32::MAX` in `twins` stands for a boundary.
    ///
    /// # Errors
    /// [`Error::Input`] if the parts do not fit together, or lengths make a triangle without area.
    pub fn from_parts(vertex_count: usize, faces: Vec<[u32; 3]>, twins: Vec<u32>, lengths: Vec<f64>, is_cover: bool) -> Result<Self> {
        let all = 3 * faces.len();
        if twins.len() != all || lengths.len() != all || all >= FREE as usize {
            return Err(Error::input(format!(
                "{} triangles with {} twins and {} lengths; each has three",
                faces.len(),
                twins.len(),
                lengths.len()
            )));
        }
        let tail = |h: usize| faces[h / 3][h % 3];
        let tip = |h: usize| faces[h / 3][(h % 3 + 1) % 3];
        let wrong = (0..all).into_par_iter().with_min_len(CHUNK).find_map_first(|h| {
            let (twin, length) = (twins[h] as usize, lengths[h]);
            if tail(h) as usize >= vertex_count {
                return Some(format!("triangle {} refers to vertex {}, there are {vertex_count}", h / 3, tail(h)));
            }
            if !(length > 0.0 && (1e-290..1e140).contains(&length)) {
                return Some(format!("half-edge {h} has length {length}; lengths must be positive and in the range of double precision"));
            }
            if h % 3 == 0 && area_of([length, lengths[h + 1], lengths[h + 2]]) <= 0.0 {
                return Some(format!("the lengths of triangle {} make no triangle", h / 3));
            }
            let fits = twins[h] == FREE
                || (twin < all
                    && twin != h
                    && twins[twin] as usize == h
                    && lengths[twin] == length
                    && tail(twin) == tip(h)
                    && tip(twin) == tail(h));
            (!fits).then(|| format!("half-edge {h} does not fit the half-edge {twin} that it is glued to"))
        });
        if let Some(text) = wrong {
            return Err(Error::Input(text));
        }
        let longest = lengths.par_iter().copied().reduce(|| 0.0, f64::max);
        let unit = if longest > 0.0 { 2f64.powi(longest.log2().round() as i32) } else { 1.0 };
        let lengths = lengths.into_iter().map(|length| length / unit).collect();
        let (weight, glue) = (if is_cover { 0.5 } else { 1.0 }, Glue::from_parts(faces, twins));
        Ok(IntrinsicTriangulation { vertex_count, glue, lengths, unit, weight, flips: 0, mollified: 0, left_out: 0 })
    }

    /// Lengths of a triangle's half-edges, in units.
    fn sides(&self, face: usize) -> [f64; 3] {
        [self.lengths[3 * face], self.lengths[3 * face + 1], self.lengths[3 * face + 2]]
    }

    /// Cotangent of the angle opposite to a half-edge, and the triangle's area.
    fn opposite_cotangent(&self, half_edge: u32) -> (f64, f64) {
        let area = area_of(self.sides(half_edge as usize / 3));
        let [a, b, c] = [half_edge, Glue::next(half_edge), Glue::previous(half_edge)].map(|h| self.lengths[h as usize]);
        (cotangent_of(a, b, c, area), area)
    }

    /// True if an edge between two triangles is worth flipping.
    fn is_bad(&self, half_edge: u32) -> bool {
        let twin = self.glue.twin(half_edge);
        if twin == FREE || twin / 3 == half_edge / 3 {
            return false;
        }
        let ((one, _), (other, _)) = (self.opposite_cotangent(half_edge), self.opposite_cotangent(twin));
        one + other < -TOLERANCE * (1.0 + one.abs() + other.abs())
    }

    fn diamond(&self, half_edge: u32) -> Diamond {
        let twin = self.glue.twin(half_edge);
        let length = self.lengths[half_edge as usize];
        let apex = |from_start: f64, to_end: f64, area: f64| {
            [0.5 * (length + (from_start - to_end) * (from_start + to_end) / length), 2.0 * area / length]
        };
        let of = |h: u32| self.lengths[h as usize];
        let ((one, area), (other, other_area)) = (self.opposite_cotangent(half_edge), self.opposite_cotangent(twin));
        let above = apex(of(Glue::previous(half_edge)), of(Glue::next(half_edge)), area);
        let below = apex(of(Glue::next(twin)), of(Glue::previous(twin)), other_area);
        Diamond { length, above, below: [below[0], -below[1]], cotangents: [one, other] }
    }

    /// Flips an edge unless rounding would make the new triangles degenerate or worse than the old ones; true if it did.
    fn flip(&mut self, half_edge: u32) -> bool {
        let twin = self.glue.twin(half_edge);
        let Diamond { length, above, below, cotangents } = self.diamond(half_edge);
        let across = [above[0] - below[0], above[1] - below[1]];
        // both ends of the old edge must lie strictly on their sides of the new one
        let side = |x: f64| across[0] * (0.0 - below[1]) - across[1] * (x - below[0]);
        if !(side(0.0) > 0.0 && side(length) < 0.0) {
            return false;
        }
        let new = across[0].hypot(across[1]);
        let [h1, h2, t1, t2] = [Glue::next(half_edge), Glue::previous(half_edge), Glue::next(twin), Glue::previous(twin)];
        let [bc, ca, ad, db] = [h1, h2, t1, t2].map(|h| self.lengths[h as usize]);
        let (near_end, near_start) = (area_of([new, db, bc]), area_of([new, ca, ad]));
        if !(near_end > 0.0 && near_start > 0.0) {
            return false;
        }
        let after = cotangent_of(new, db, bc, near_end) + cotangent_of(new, ca, ad, near_start);
        if !(after > cotangents[0] + cotangents[1] && after.is_finite()) {
            return false;
        }
        self.glue.flip(half_edge);
        for (h, value) in [(half_edge, new), (h1, db), (h2, bc), (twin, new), (t1, ca), (t2, ad)] {
            self.lengths[h as usize] = value;
        }
        true
    }

    fn flip_to_delaunay(&mut self, control: &Control) -> Result<()> {
        let all = self.lengths.len() as u32;
        let bad = |this: &Self| -> Vec<u32> {
            (0..all).into_par_iter().with_min_len(CHUNK).filter(|&h| this.glue.twin(h) > h && this.is_bad(h)).collect()
        };
        let mut queue: VecDeque<u32> = bad(self).into();
        control.report(0.4)?;
        let mut waiting = vec![false; all as usize];
        queue.iter().for_each(|&h| waiting[h as usize] = true);
        let cap = MOST_FLIPS.saturating_mul(all as usize);
        let (mut tried, mut seen) = (0usize, queue.len());
        while let Some(half_edge) = queue.pop_front() {
            waiting[half_edge as usize] = false;
            tried += 1;
            if tried.is_multiple_of(16384) {
                control.report(0.4 + 0.6 * (tried as f64 / seen as f64).min(1.0))?;
            }
            if !self.is_bad(half_edge) {
                continue;
            }
            let twin = self.glue.twin(half_edge);
            if !self.flip(half_edge) {
                continue;
            }
            self.flips += 1;
            if self.flips > cap {
                return Err(Error::NotConverged(format!(
                    "the edges of {} triangles are not Delaunay after {} flips; the mesh is too distorted for double precision",
                    self.glue.faces().len(),
                    self.flips
                )));
            }
            for side in [Glue::next(half_edge), Glue::previous(half_edge), Glue::next(twin), Glue::previous(twin)] {
                let other = self.glue.twin(side);
                let least = side.min(other);
                if other != FREE && !waiting[least as usize] && self.is_bad(least) {
                    waiting[least as usize] = true;
                    queue.push_back(least);
                    seen += 1;
                }
            }
        }
        Ok(())
    }

    /// Number of vertices, those of the mesh.
    pub fn vertex_count(&self) -> usize {
        self.vertex_count
    }

    /// Vertices of the triangles.
    pub fn faces(&self) -> &[[u32; 3]] {
        self.glue.faces()
    }

    /// The half-edge on the other side of an edge, `None` at the boundary.
    ///
    /// # Panics
    /// If there is no such half-edge.
    pub fn twin(&self, half_edge: u32) -> Option<u32> {
        Some(self.glue.twin(half_edge)).filter(|&twin| twin != FREE)
    }

    /// The half-edge that each one is glued to, `u32::MAX` at the boundary.
    pub fn twins(&self) -> &[u32] {
        self.glue.twins()
    }

    /// Length of each half-edge; the two of an edge have the same.
    pub fn lengths(&self) -> Vec<f64> {
        self.lengths.iter().map(|length| length * self.unit).collect()
    }

    /// Mean length of the edges.
    pub fn spacing(&self) -> f64 {
        let parts: Vec<(f64, usize)> = (0..self.lengths.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                (chunk * CHUNK..((chunk + 1) * CHUNK).min(self.lengths.len()))
                    .filter(|&h| self.glue.twin(h as u32) > h as u32) // FREE is the greatest
                    .fold((0.0, 0), |(sum, count), h| (sum + self.lengths[h], count + 1))
            })
            .collect();
        let (sum, count) = parts.into_iter().fold((0.0, 0), |(s, c), (sum, count)| (s + sum, c + count));
        sum / count.max(1) as f64 * self.unit
    }

    /// Area that each triangle counts for; on a tufted cover half its area. They sum to the area of the surface.
    pub fn face_areas(&self) -> Vec<f64> {
        let factor = self.weight * self.unit * self.unit;
        (0..self.glue.faces().len()).into_par_iter().with_min_len(CHUNK).map(|face| factor * area_of(self.sides(face))).collect()
    }

    /// Number of edges flipped.
    pub fn flips(&self) -> usize {
        self.flips
    }

    /// Number of edges lengthened because a triangle was degenerate.
    pub fn mollified(&self) -> usize {
        self.mollified
    }

    /// Number of faces left out because they name a vertex twice.
    pub fn left_out(&self) -> usize {
        self.left_out
    }

    /// True if this is a tufted cover: every triangle of the mesh is there twice and counts half.
    pub fn is_cover(&self) -> bool {
        self.weight != 1.0
    }

    /// Half-edges' lengths in units, the unit and the weight of a triangle: what the operators are made from.
    pub(crate) fn scaled(&self) -> (&[f64], f64, f64) {
        (&self.lengths, self.unit, self.weight)
    }
}
