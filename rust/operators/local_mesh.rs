//! The local mesh of a point cloud (Lai, Liang and Zhao, Journal of Computational Physics 2013): each point's Delaunay star
//! in its own tangent space, and the simplices that these stars vote for.
//!
//! A star is found by inversion: with y_j the neighbours in tangential coordinates (their distances kept) and
//! u_j = y_j / |y_j|², the simplices at the point are the facets of the convex hull of the u_j whose planes have the origin
//! beneath them. The coordinates are conformal to third order (see `Chart`), so that stars agree on circumspheres. Ties, as on
//! grids, are broken by moving each point's paraboloid height by a little of its squared spacing, times a number that depends
//! on its index alone: all stars see the same weighted Delaunay triangulation, which has no ties. The little is 1e-9 (1e-6 for volumes);
//! on grids of curved clouds it grows with the squared share of the spacing in the radius of curvature, as what stars see differs by.
//!
//! A star is *certified* when all points that could lie in one of its circumspheres were among its neighbours: the distance
//! of the last neighbour is at least twice the greatest circumradius. Neighbours are doubled until it is.
//!
//! Where the cloud ends a star is open, and its outermost simplices bridge bays; simplices whose circumradius is beyond
//! 1.75^(2/d) times the median of their corners' distances to the 6th neighbour are dropped.

use super::frames::{Cloud, Frames, Progress, STEEP, TASK};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::near::Scratch;
use crate::sparse::{CHUNK, Csr};
use rayon::prelude::*;

/// Neighbours whose tangent spaces agree less than this (the determinant between their frames) lie on another sheet.
const AGREEMENT: f64 = 0.3;

/// The most neighbours a star is given.
const MOST: usize = 960;

/// A simplex flatter than this (its Gram determinant against the product of squared edges) has no gradient.
const FLAT: f64 = 1e-14;

/// How [`local_mesh`] goes about it.
#[derive(Debug, Clone, Copy, Default)]
pub struct LocalMeshOptions<'a> {
    /// Neighbours each star starts with; without it 30 for surfaces and 60 for volumes.
    pub neighbors: Option<usize>,
    /// Outward normals, D numbers a point: points whose normals oppose each other are never neighbours, which keeps the two sides of
    /// thin parts apart.
    pub normals: Option<&'a [f64]>,
    /// The distance to the 6th neighbour that is to be expected at each point, for which the measured one is taken otherwise: how large
    /// simplices may be. Who knows that samples grow rare where the cloud ends, and why, says so here.
    pub reach: Option<&'a [f64]>,
}

/// Simplices voted for by the stars of a cloud's points, and what is known about each point.
///
/// A simplex with v of its d + 1 corners' stars behind it counts v / (d + 1) times in every sum over simplices. Where all
/// stars agree, all count once and form a Delaunay mesh; where they do not, areas still add up on average, and stiffness is
/// symmetric and positive semidefinite by construction.
#[derive(Debug, Clone, PartialEq)]
pub struct LocalMesh {
    /// d, the intrinsic dimension.
    pub dimension: usize,
    /// d + 1 point indices a simplex, ascending; simplices in lexicographic order.
    pub simplices: Vec<u32>,
    /// Votes of each simplex, 1 to d + 1.
    pub votes: Vec<u8>,
    /// Whose votes: bit k stands for the star of the simplex's k-th corner.
    pub voters: Vec<u8>,
    /// Volume of the curved simplex over that of the flat one between its corners, to second order in its size; 1 but for
    /// three-dimensional clouds in more than three dimensions.
    pub stretch: Vec<f64>,
    /// Whether each point's star is certified.
    pub certified: Vec<bool>,
    /// Whether each point's star is open: the point lies where the cloud ends.
    pub boundary: Vec<bool>,
    /// Distance to the 6th neighbour of each point, in the user's units.
    pub spacing: Vec<f64>,
    /// Orthonormal tangent vectors, d x D numbers a point.
    pub frames: Vec<f64>,
    /// The second fundamental form in the frame's directions: for each point a vector of R^D for each pair a <= b.
    pub curvature: Vec<f64>,
    /// The dimension that the growth of the neighbours' distances suggests; far from `dimension`, that one may be wrong.
    pub estimated_dimension: f64,
}

/// A facet of a star: d other points, ascending, and the circumradius in the star's coordinates.
#[derive(Debug, Clone, Copy)]
struct Facet {
    corners: [u32; 3],
    radius: f64,
}

#[derive(Default)]
struct StarWork {
    near: Scratch,
    found: Vec<u32>,
    kept: Vec<u32>,
    flat: Vec<[f64; 3]>,
    inverted: Vec<[f64; 3]>,
    hull: Hull,
    facets: Vec<Facet>,
    around: Vec<f64>,
}

/// Finds the local mesh of `points`, `ambient` coordinates each, sampled from something of dimension `dimension` (1 to 3).
///
/// ```
/// use beltrami::{Control, operators::{LocalMeshOptions, local_mesh}};
/// // 5 x 5 grid points of the unit square
/// let points: Vec<f64> = (0..25).flat_map(|i| [(i % 5) as f64 / 4.0, (i / 5) as f64 / 4.0]).collect();
/// let mesh = local_mesh(&points, 2, 2, &LocalMeshOptions::default(), &Control::default())?;
/// assert_eq!((mesh.votes.len(), mesh.votes.iter().all(|&votes| votes == 3)), (32, true));
/// assert_eq!(mesh.boundary.iter().filter(|&&open| open).count(), 16);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] naming the points if there are too few, coordinates that are not finite, copies, isolated points, or
/// neighbourhoods of less than `dimension` dimensions; [`Error::Cancelled`].
pub fn local_mesh(points: &[f64], ambient: usize, dimension: usize, options: &LocalMeshOptions, control: &Control) -> Result<LocalMesh> {
    if !(1..=3).contains(&dimension) {
        return Err(Error::input(format!(
            "local meshes are made for clouds of dimension 1, 2 and 3, not {dimension}; moving least squares (laplacian=\"mls\") takes any"
        )));
    }
    let cloud = Cloud::new(points, ambient, dimension, options.normals, control)?;
    let width = options.neighbors.unwrap_or([8, 30, 60][dimension - 1]);
    if width < dimension + 1 {
        return Err(Error::input(format!("{width} neighbours; a star of dimension {dimension} needs {} or more", dimension + 1)));
    }
    let frames = Frames::new(&cloud, dimension, width, control, 0.1, 0.5)?;
    let reach = match options.reach {
        None => frames.span.clone(),
        Some(given) if given.len() != cloud.count() => {
            return Err(Error::input(format!("reach has {} numbers, the cloud {} points", given.len(), cloud.count())));
        }
        Some(given) => {
            if let Some(at) = given.iter().position(|&x| !(x > 0.0 && x.is_finite())) {
                return Err(Error::input(format!("reach[{at}] is {}; it must be positive and finite", given[at])));
            }
            cloud.original.iter().map(|&point| given[point as usize] * cloud.scale).collect()
        }
    };
    let stars = Stars::new(&cloud, &frames, reach, control, 0.5, 0.95)?;
    let (simplices, voters) = stars.simplices(&cloud);
    let stretch = stretches(&cloud, &frames, &simplices);
    let boundary = stars.open(&cloud);
    let restore = |by_rank: &dyn Fn(usize) -> bool| -> Vec<bool> { cloud.rank.iter().map(|&rank| by_rank(rank as usize)).collect() };
    let size = dimension * ambient;
    let mut axes = vec![0.0; cloud.count() * size];
    axes.par_chunks_mut(size).zip(&cloud.rank).for_each(|(out, &rank)| out.copy_from_slice(frames.axes(rank as usize, ambient)));
    let pairs = dimension * (dimension + 1) / 2 * ambient;
    let mut curvature = vec![0.0; cloud.count() * pairs];
    let doubled: Vec<f64> = (0..dimension).flat_map(|a| (a..dimension).map(move |b| if a == b { 2.0 } else { 1.0 })).collect();
    curvature.par_chunks_mut(pairs).zip(&cloud.rank).for_each(|(out, &rank)| {
        let bends = frames.bends(rank as usize, ambient);
        for (pair, factor) in doubled.iter().enumerate() {
            for coordinate in pair * ambient..(pair + 1) * ambient {
                out[coordinate] = factor * bends[coordinate] * cloud.scale;
            }
        }
    });
    control.report(1.0)?;
    Ok(LocalMesh {
        dimension,
        simplices,
        votes: voters.iter().map(|voters| voters.count_ones() as u8).collect(),
        voters,
        stretch,
        certified: restore(&|rank| stars.certified[rank]),
        boundary: restore(&|rank| boundary[rank]),
        spacing: cloud.rank.iter().map(|&rank| frames.spacing[rank as usize] / cloud.scale).collect(),
        frames: axes,
        curvature,
        estimated_dimension: frames.estimate,
    })
}

/// How much larger the curved simplices are than the flat ones. Between two points at distance c the cloud is longer by the factor
/// 1 + |h(e, e)|² c² / 24, and a simplex whose edges have these lengths holds more than a flat one where curvature is positive; on a
/// sphere of curvature K both together make 1 + K (Σ c² / 10 - R² / 2), with R the circumradius.
fn stretches(cloud: &Cloud, frames: &Frames, simplices: &[u32]) -> Vec<f64> {
    let (d, ambient) = (frames.dimension, cloud.ambient);
    if d != 3 || ambient == d {
        return vec![1.0; simplices.len() / (d + 1)];
    }
    let charts: Vec<Chart> =
        (0..cloud.count()).into_par_iter().with_min_len(TASK).map(|rank| Chart::new(frames.bends(rank, ambient), ambient, d)).collect();
    simplices
        .par_chunks_exact(d + 1)
        .with_min_len(TASK)
        .map(|corners| {
            let ranks: Vec<u32> = corners.iter().map(|&corner| cloud.rank[corner as usize]).collect();
            let Some(element) = Element::new(&cloud.points, ambient, &ranks) else { return 1.0 };
            // squares of the edges, what they gain, and what they would gain on a sphere of curvature 1
            let (mut squares, mut gains) = (0.0, [[[0.0; 4]; 4]; 2]);
            for a in 0..=d {
                for b in 0..a {
                    let (p, q) = (cloud.point(ranks[a] as usize), cloud.point(ranks[b] as usize));
                    let square: f64 = p.iter().zip(q).map(|(x, y)| (x - y) * (x - y)).sum();
                    let bend = |rank: u32| {
                        let mut t = [0.0; 3];
                        for (t, axis) in t.iter_mut().zip(frames.axes(rank as usize, ambient).chunks_exact(ambient)) {
                            *t = axis.iter().zip(p.iter().zip(q)).map(|(a, (x, y))| a * (x - y)).sum();
                        }
                        charts[rank as usize].bend(t)
                    };
                    squares += square;
                    let gain = [(bend(ranks[a]) + bend(ranks[b])) / 24.0, square * square / 12.0];
                    for (gains, gain) in gains.iter_mut().zip(gain) {
                        (gains[a][b], gains[b][a]) = (gain, gain);
                    }
                }
            }
            let growth = gains.map(|gain| {
                let mut sum = 0.0;
                for a in 0..d {
                    for b in 0..d {
                        sum += element.inverse[a][b] * (gain[0][a + 1] + gain[0][b + 1] - gain[a + 1][b + 1]);
                    }
                }
                sum / 4.0 / element.unit / element.unit
            });
            let curvature = ranks.iter().map(|&rank| charts[rank as usize].sectional()).sum::<f64>() / ranks.len() as f64;
            let rest = squares / 10.0 - element.circumradius * element.circumradius / 2.0 - growth[1];
            1.0 + (growth[0] + curvature * rest).clamp(-0.2, 0.2)
        })
        .collect()
}

/// The circumradius beyond which a simplex is dropped, in units of the median distance to the 6th neighbour: a ball of that
/// radius holds about 18 points, of a Poisson process as well, in any dimension.
fn radius_factor(dimension: usize) -> f64 {
    1.75f64.powf(2.0 / dimension as f64)
}

/// A number in [0, 1) that depends on the index alone (splitmix64).
fn jitter(index: u32) -> f64 {
    let mut z = (u64::from(index) + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Whether the nearest neighbours lie in pairs on opposite sides, as on a grid.
fn paired(cloud: &Cloud, frames: &Frames, rank: usize) -> bool {
    let (here, near) = (cloud.point(rank), frames.neighbors(rank));
    let offsets: Vec<[f64; 3]> = near
        .iter()
        .map(|&neighbor| {
            let there = cloud.point(neighbor as usize);
            let mut t = [0.0; 3];
            for (t, axis) in t.iter_mut().zip(frames.axes(rank, cloud.ambient).chunks_exact(cloud.ambient)) {
                *t = axis.iter().zip(there.iter().zip(here)).map(|(a, (x, y))| a * (x - y)).sum();
            }
            t
        })
        .collect();
    let opposite = |t: &[f64; 3]| offsets.iter().any(|s| length(std::array::from_fn(|i| s[i] + t[i])) <= 0.15 * length(*t));
    offsets.iter().take(2 * frames.dimension).all(opposite)
}

/// By how much the points' paraboloid heights are moved to break ties. On grids of curved clouds every cell is a tie, and what two
/// stars see of one simplex differs by about the share (span times curvature)² of the squared spacing: there heights are moved by as
/// much, though never so much that a neighbour could hide a point. Elsewhere ties are rare, and what is moved is next to nothing, so
/// that the numbering of the points does not matter.
fn heights(cloud: &Cloud, frames: &Frames) -> Vec<f64> {
    let ranks = || (0..cloud.count()).into_par_iter().with_min_len(TASK);
    let paired: Vec<bool> = ranks().map(|rank| paired(cloud, frames, rank)).collect();
    // in three dimensions the faces between tied points are thin, and rounding moves them more
    let least = if frames.dimension == 3 { 1e-6 } else { 1e-9 };
    ranks()
        .map(|rank| {
            let (span, nearest) = (frames.span[rank], frames.nearest[rank]);
            let around = frames.neighbors(rank).iter().take(2 * frames.dimension).filter(|&&near| paired[near as usize]).count();
            // three of four: random points have one pair in some hundred, and never such company
            let share = if 4 * around >= 6 * frames.dimension {
                let bending = Chart::new(frames.bends(rank, cloud.ambient), cloud.ambient, frames.dimension).bending();
                least + (span * span * bending).min(0.05)
            } else {
                least
            };
            (share * span * nearest).min(0.5 * nearest * nearest) * jitter(cloud.original[rank])
        })
        .collect()
}

/// How many facets each point of a task has, the facets, and whether each star is certified and open.
type StarsOfTask = (Vec<u32>, Vec<Facet>, Vec<(bool, bool)>);

/// The stars of all points, by rank.
struct Stars {
    dimension: usize,
    reach: Vec<f64>,
    starts: Vec<usize>,
    facets: Vec<Facet>,
    certified: Vec<bool>,
    open: Vec<bool>,
}

impl Stars {
    fn new(cloud: &Cloud, frames: &Frames, reach: Vec<f64>, control: &Control, from: f64, to: f64) -> Result<Stars> {
        let dimension = frames.dimension;
        let progress = Progress::new(cloud.count(), from, to, control);
        let heights = heights(cloud, frames);
        let tasks: Vec<StarsOfTask> = (0..cloud.count().div_ceil(TASK))
            .into_par_iter()
            .map_init(StarWork::default, |work, task| {
                let range = task * TASK..((task + 1) * TASK).min(cloud.count());
                let (mut counts, mut facets, mut flags) = (vec![], vec![], vec![]);
                for rank in range.clone() {
                    flags.push(work.star(cloud, frames, &reach, &heights, rank)?);
                    counts.push(work.facets.len() as u32);
                    facets.extend_from_slice(&work.facets);
                }
                progress.step(range.len())?;
                Ok((counts, facets, flags))
            })
            .collect::<Result<_>>()?;
        let mut starts = Vec::with_capacity(cloud.count() + 1);
        starts.push(0);
        let mut facets = Vec::with_capacity(tasks.iter().map(|task| task.1.len()).sum());
        let (mut certified, mut open) = (vec![], vec![]);
        for (counts, found, flags) in tasks {
            for count in counts {
                starts.push(starts[starts.len() - 1] + count as usize);
            }
            facets.extend_from_slice(&found);
            certified.extend(flags.iter().map(|flag| flag.0));
            open.extend(flags.iter().map(|flag| flag.1));
        }
        Ok(Stars { dimension, reach, starts, facets, certified, open })
    }

    fn of(&self, rank: usize) -> &[Facet] {
        &self.facets[self.starts[rank]..self.starts[rank + 1]]
    }

    /// The simplex of a facet at a point, corners ascending.
    fn simplex(&self, rank: usize, facet: &Facet) -> [u32; 4] {
        let mut corners = [u32::MAX; 4];
        corners[..self.dimension].copy_from_slice(&facet.corners[..self.dimension]);
        corners[self.dimension] = rank as u32;
        corners[..=self.dimension].sort_unstable();
        corners
    }

    fn holds(&self, rank: u32, simplex: &[u32; 4]) -> bool {
        let mut wanted = [u32::MAX; 3];
        let others = simplex[..=self.dimension].iter().filter(|&&corner| corner != rank);
        wanted.iter_mut().zip(others).for_each(|(slot, &corner)| *slot = corner);
        self.of(rank as usize).iter().any(|facet| facet.corners == wanted)
    }

    /// Which corners' stars hold a simplex, a bit each; 0 if a corner of less rank does and counts it.
    fn voters(&self, rank: usize, simplex: &[u32; 4]) -> u8 {
        let mut voters = 0;
        for (at, &corner) in simplex[..=self.dimension].iter().enumerate() {
            if corner as usize == rank {
                voters |= 1 << at;
            } else if self.holds(corner, simplex) {
                if (corner as usize) < rank {
                    return 0;
                }
                voters |= 1 << at;
            }
        }
        voters
    }

    /// Whether a simplex is small enough for its place, and no sliver without a gradient.
    fn fits(&self, cloud: &Cloud, simplex: &[u32; 4]) -> bool {
        let corners = &simplex[..=self.dimension];
        let mut spacing = [0.0; 4];
        corners.iter().zip(&mut spacing).for_each(|(&corner, slot)| *slot = self.reach[corner as usize]);
        spacing[..corners.len()].sort_unstable_by(f64::total_cmp);
        let middle = (spacing[(corners.len() - 1) / 2] + spacing[corners.len() / 2]) / 2.0;
        let element = Element::new(&cloud.points, cloud.ambient, corners);
        element.is_some_and(|element| element.circumradius <= radius_factor(self.dimension) * middle)
    }

    /// All simplices with their voters, in the user's numbering and lexicographic order.
    fn simplices(&self, cloud: &Cloud) -> (Vec<u32>, Vec<u8>) {
        let size = self.dimension + 1;
        let mut found: Vec<([u32; 4], u8)> = (0..cloud.count())
            .into_par_iter()
            .with_min_len(TASK)
            .flat_map_iter(|rank| {
                self.of(rank).iter().filter_map(move |facet| {
                    let simplex = self.simplex(rank, facet);
                    let voters = self.voters(rank, &simplex);
                    (voters > 0 && self.fits(cloud, &simplex)).then_some((simplex, voters))
                })
            })
            .collect();
        // A point whose simplices are all too large for their place keeps its smallest: it stays in the mesh.
        let mut used = vec![false; cloud.count()];
        for (simplex, _) in &found {
            simplex[..size].iter().for_each(|&corner| used[corner as usize] = true);
        }
        let mut kept: Vec<[u32; 4]> = (0..cloud.count())
            .filter(|&rank| !used[rank])
            .filter_map(|rank| {
                let sound = |facet: &&Facet| Element::new(&cloud.points, cloud.ambient, &self.simplex(rank, facet)[..size]).is_some();
                let facet = self.of(rank).iter().filter(sound).min_by(|x, y| x.radius.total_cmp(&y.radius))?;
                Some(self.simplex(rank, facet))
            })
            .collect();
        kept.sort_unstable();
        kept.dedup();
        found.extend(kept.iter().map(|simplex| {
            let voters = (0..size).filter(|&at| self.holds(simplex[at], simplex)).fold(0, |voters, at| voters | 1 << at);
            (*simplex, voters)
        }));
        for (simplex, voters) in &mut found {
            let mut corners = [(u32::MAX, 0); 4];
            for (at, slot) in corners[..size].iter_mut().enumerate() {
                *slot = (cloud.original[simplex[at] as usize], *voters >> at & 1);
            }
            corners[..size].sort_unstable();
            *simplex = corners.map(|corner| corner.0);
            *voters = (0..size).fold(0, |voters, at| voters | corners[at].1 << at);
        }
        found.par_sort_unstable();
        let voters = found.iter().map(|(_, voters)| *voters).collect();
        (found.iter().flat_map(|(simplex, _)| simplex[..size].iter().copied()).collect(), voters)
    }

    /// Whether each point's star is open once large simplices are dropped: some ridge of its link is in one facet only.
    fn open(&self, cloud: &Cloud) -> Vec<bool> {
        (0..cloud.count())
            .into_par_iter()
            .with_min_len(TASK)
            .map_init(Vec::new, |ridges: &mut Vec<[u32; 2]>, rank| {
                if self.open[rank] {
                    return true;
                }
                ridges.clear();
                for facet in self.of(rank).iter().filter(|facet| self.fits(cloud, &self.simplex(rank, facet))) {
                    let [a, b, c] = facet.corners;
                    match self.dimension {
                        1 => ridges.push([0, 0]),
                        2 => ridges.extend([[a, 0], [b, 0]]),
                        _ => ridges.extend([[a, b], [b, c], [a, c]]),
                    }
                }
                ridges.sort_unstable();
                ridges.is_empty() || ridges.chunk_by(|x, y| x == y).any(|group| group.len() != 2)
            })
            .collect()
    }
}

impl StarWork {
    /// Finds the star of one point; whether it is certified, and whether it is open.
    fn star(&mut self, cloud: &Cloud, frames: &Frames, reach: &[f64], heights: &[f64], rank: usize) -> Result<(bool, bool)> {
        let dimension = frames.dimension;
        let mut width = frames.width;
        self.found.clear();
        self.found.extend_from_slice(frames.neighbors(rank));
        // No simplex larger than this will be kept: the second largest spacing bounds the median of any corners' spacings.
        self.around.clear();
        self.around.push(reach[rank]);
        self.around.extend(self.found.iter().map(|&neighbor| reach[neighbor as usize]));
        self.around.sort_unstable_by(|x, y| y.total_cmp(x));
        let limit = radius_factor(dimension) * self.around[1] * (1.0 + 1e-9);
        loop {
            let farthest = self.coordinates(cloud, frames, heights, rank);
            let open = self.hull.facets(&self.inverted, &self.flat, dimension, &mut self.facets);
            let most = self.facets.iter().map(|facet| facet.radius.min(limit)).fold(if open { limit } else { 0.0 }, f64::max);
            let all = width >= cloud.count() - 1;
            let certified = all || farthest >= 2.0 * most;
            if certified || width >= MOST {
                self.finish(dimension, limit);
                return Ok((certified, open));
            }
            width = (2 * width).min(MOST).min(cloud.count() - 1);
            cloud.neighbors_into(rank, width, &mut self.near, &mut self.found)?;
        }
    }

    /// Tangential coordinates of the neighbours on this sheet, and their inversions; the distance of the last neighbour.
    fn coordinates(&mut self, cloud: &Cloud, frames: &Frames, heights: &[f64], rank: usize) -> f64 {
        let (ambient, dimension) = (cloud.ambient, frames.dimension);
        let (here, axes) = (cloud.point(rank), frames.axes(rank, ambient));
        let chart = Chart::new(frames.bends(rank, ambient), ambient, dimension);
        let mut reach = 0.0;
        self.kept.clear();
        self.flat.clear();
        self.inverted.clear();
        for &neighbor in &self.found {
            let there = cloud.point(neighbor as usize);
            let mut t = [0.0; 3];
            let mut square = 0.0;
            for (at, (x, o)) in there.iter().zip(here).enumerate() {
                let x = x - o;
                square += x * x;
                for a in 0..dimension {
                    t[a] += axes[a * ambient + at] * x;
                }
            }
            reach = square;
            let tangential: f64 = t.iter().map(|t| t * t).sum();
            if ambient > dimension {
                if tangential < (1.0 - STEEP * STEEP) * square || !agree(axes, frames.axes(neighbor as usize, ambient), ambient, dimension)
                {
                    continue;
                }
                t = chart.straighten(t);
            }
            let power = t.iter().map(|t| t * t).sum::<f64>() + heights[neighbor as usize] - heights[rank];
            self.kept.push(neighbor);
            self.flat.push(t);
            self.inverted.push(t.map(|t| t / power));
        }
        reach.sqrt()
    }

    /// Facets by rank instead of by place in the list, small ones only (always one), sorted.
    fn finish(&mut self, dimension: usize, limit: f64) {
        let least = self.facets.iter().map(|facet| facet.radius).fold(f64::INFINITY, f64::min);
        // Radii in the star's coordinates differ a little from those of the simplex itself, which decide.
        self.facets.retain(|facet| facet.radius <= (1.5 * limit).max(least));
        for facet in &mut self.facets {
            facet.corners[..dimension].iter_mut().for_each(|corner| *corner = self.kept[*corner as usize]);
            facet.corners[..dimension].sort_unstable();
        }
        self.facets.sort_unstable_by_key(|facet| facet.corners);
    }
}

/// The map from tangential coordinates to conformal ones of the fitted surface, to third order.
///
/// Normal coordinates are y = t + (h(t) · h(t, t)) / 6, with h the second fundamental form. They keep distances from the star's own
/// point but not circles; with S the Schouten tensor (half the Gaussian curvature of a surface), z = y + S(y, y) y / 3 - |y|² S y / 6
/// are normal coordinates of a metric that is conformal to the surface's and flat at the point: circumspheres there are circumspheres
/// here, so that the stars of all points see the same Delaunay simplices but for terms of the next order. (On a sphere: stereographic
/// projection.)
struct Chart {
    dimension: usize,
    /// h_ab · h_cd
    products: [[f64; 6]; 6],
    schouten: [[f64; 3]; 3],
}

/// Where h_ab stands among the pairs a <= b.
const PAIRS: [[[usize; 3]; 3]; 3] = [[[0; 3]; 3], [[0, 1, 0], [1, 2, 0], [0; 3]], [[0, 1, 2], [1, 3, 4], [2, 4, 5]]];

impl Chart {
    /// From the coefficients of t_a t_b, a <= b, in the fit of the normal components.
    fn new(bends: &[f64], ambient: usize, dimension: usize) -> Chart {
        let pair = &PAIRS[dimension - 1];
        let mut factors = [1.0; 6];
        (0..dimension).for_each(|a| factors[pair[a][a]] = 2.0);
        let mut products = [[0.0; 6]; 6];
        let vectors: Vec<&[f64]> = bends.chunks_exact(ambient).collect();
        for p in 0..vectors.len() {
            for q in 0..=p {
                let dot: f64 = vectors[p].iter().zip(vectors[q]).map(|(x, y)| x * y).sum();
                products[p][q] = factors[p] * factors[q] * dot;
                products[q][p] = products[p][q];
            }
        }
        let mut ricci = [[0.0; 3]; 3];
        let mut scalar = 0.0;
        for a in 0..dimension {
            for b in 0..dimension {
                for c in 0..dimension {
                    ricci[a][b] += products[pair[c][c]][pair[a][b]] - products[pair[a][c]][pair[b][c]];
                }
            }
            scalar += ricci[a][a];
        }
        let mut schouten = [[0.0; 3]; 3];
        for a in 0..dimension {
            match dimension {
                2 => schouten[a][a] = scalar / 4.0,
                3 => {
                    schouten[a] = ricci[a];
                    schouten[a][a] -= scalar / 4.0;
                }
                _ => {}
            }
        }
        Chart { dimension, products, schouten }
    }

    /// |h(t, t)|².
    fn bend(&self, t: [f64; 3]) -> f64 {
        let (d, pair) = (self.dimension, &PAIRS[self.dimension - 1]);
        let indices = || (0..d).flat_map(move |a| (0..d).map(move |b| (a, b)));
        indices().map(|(a, b)| indices().map(|(c, e)| t[a] * t[b] * t[c] * t[e] * self.products[pair[a][b]][pair[c][e]]).sum::<f64>()).sum()
    }

    /// The mean sectional curvature of a three-dimensional cloud.
    fn sectional(&self) -> f64 {
        // the trace of the Schouten tensor is a quarter of the scalar curvature, which is six times the mean
        (0..self.dimension).map(|a| self.schouten[a][a]).sum::<f64>() * 4.0 / 6.0
    }

    /// Sum of the |h_ab|².
    fn bending(&self) -> f64 {
        let pair = &PAIRS[self.dimension - 1];
        (0..self.dimension).flat_map(|a| (0..self.dimension).map(move |b| pair[a][b])).map(|p| self.products[p][p]).sum()
    }

    fn straighten(&self, t: [f64; 3]) -> [f64; 3] {
        let (d, pair) = (self.dimension, &PAIRS[self.dimension - 1]);
        // h(t, t) · h_p for each pair p
        let mut along = [0.0; 6];
        for a in 0..d {
            for b in 0..d {
                for p in 0..d * (d + 1) / 2 {
                    along[p] += t[a] * t[b] * self.products[pair[a][b]][p];
                }
            }
        }
        let square: f64 = t.iter().map(|t| t * t).sum();
        let (mut bent, mut stretch) = ([0.0; 3], 0.0);
        for a in 0..d {
            for b in 0..d {
                bent[a] += t[b] * (along[pair[a][b]] - square * self.schouten[a][b]) / 6.0;
                stretch += t[a] * t[b] * self.schouten[a][b] / 3.0;
            }
        }
        let change: [f64; 3] = std::array::from_fn(|a| bent[a] + stretch * t[a]);
        let size = length(change);
        let share = (0.4 * square.sqrt() / size).min(1.0);
        std::array::from_fn(|a| t[a] + share * change[a])
    }
}

/// Whether two tangent spaces are near each other.
pub(super) fn agree(x: &[f64], y: &[f64], ambient: usize, dimension: usize) -> bool {
    let mut m = [[0.0; 3]; 3];
    for a in 0..dimension {
        for b in 0..dimension {
            m[a][b] = x[a * ambient..][..ambient].iter().zip(&y[b * ambient..][..ambient]).map(|(x, y)| x * y).sum();
        }
    }
    let determinant = match dimension {
        1 => m[0][0],
        2 => m[0][0] * m[1][1] - m[0][1] * m[1][0],
        _ => {
            m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
        }
    };
    determinant.abs() > AGREEMENT
}

/// Convex hulls of the origin and inverted neighbours, in one, two and three dimensions.
#[derive(Default)]
struct Hull {
    order: Vec<u32>,
    chain: Vec<u32>,
    faces: Vec<HullFace>,
    horizon: Vec<[u32; 2]>,
}

#[derive(Clone, Copy)]
struct HullFace {
    corners: [u32; 3],
    normal: [f64; 3],
    offset: f64,
    /// What rounding does to the height of a point above the face, per unit of distance: a thin face's normal is uncertain.
    rounding: f64,
    size: f64,
}

/// Relative error of a height above a face.
const ROUNDING: f64 = 4e-15;

/// The origin's number in a hull of three dimensions.
const ORIGIN: u32 = u32::MAX;

impl Hull {
    /// The facets that have the origin strictly beneath them, as places in the list; whether they leave a gap.
    fn facets(&mut self, inverted: &[[f64; 3]], flat: &[[f64; 3]], dimension: usize, out: &mut Vec<Facet>) -> bool {
        out.clear();
        match dimension {
            1 => {
                let best = |sign: f64| {
                    let ahead = (0..inverted.len()).filter(|&j| sign * inverted[j][0] > 0.0);
                    ahead.max_by(|&x, &y| (sign * inverted[x][0]).total_cmp(&(sign * inverted[y][0])))
                };
                for j in [best(1.0), best(-1.0)].into_iter().flatten() {
                    out.push(Facet { corners: [j as u32, ORIGIN, ORIGIN], radius: flat[j][0].abs() / 2.0 });
                }
                out.len() < 2
            }
            2 => self.plane(inverted, flat, out),
            _ => self.space(inverted, flat, out),
        }
    }

    /// Monotone chain.
    fn plane(&mut self, u: &[[f64; 3]], flat: &[[f64; 3]], out: &mut Vec<Facet>) -> bool {
        if u.len() < 2 {
            return true;
        }
        self.order.clear();
        self.order.extend(0..u.len() as u32);
        self.order.sort_unstable_by(|&a, &b| {
            let (p, q) = (u[a as usize], u[b as usize]);
            p[0].total_cmp(&q[0]).then(p[1].total_cmp(&q[1])).then(a.cmp(&b))
        });
        let turn = |a: u32, b: u32, c: u32| {
            let (a, b, c) = (u[a as usize], u[b as usize], u[c as usize]);
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        };
        let mut open = false;
        for backwards in [false, true] {
            self.chain.clear();
            for at in 0..self.order.len() {
                let next = self.order[if backwards { self.order.len() - 1 - at } else { at }];
                while self.chain.len() >= 2 && turn(self.chain[self.chain.len() - 2], self.chain[self.chain.len() - 1], next) <= 0.0 {
                    self.chain.pop();
                }
                self.chain.push(next);
            }
            for pair in self.chain.windows(2) {
                let (p, q) = (u[pair[0] as usize], u[pair[1] as usize]);
                let cross = p[0] * q[1] - p[1] * q[0];
                if cross > 0.0 {
                    let (p, q) = (flat[pair[0] as usize], flat[pair[1] as usize]);
                    let (pp, qq) = (p[0] * p[0] + p[1] * p[1], q[0] * q[0] + q[1] * q[1]);
                    let area = 2.0 * (p[0] * q[1] - p[1] * q[0]).abs();
                    let center = [(q[1] * pp - p[1] * qq) / area, (p[0] * qq - q[0] * pp) / area];
                    let radius = center[0].hypot(center[1]);
                    if radius.is_finite() {
                        out.push(Facet { corners: [pair[0], pair[1], ORIGIN], radius });
                        continue;
                    }
                }
                open = true;
            }
        }
        open
    }

    /// Incremental hull; points come nearest first, so that nearly all later ones lie inside.
    fn space(&mut self, u: &[[f64; 3]], flat: &[[f64; 3]], out: &mut Vec<Facet>) -> bool {
        let at = |corner: u32| if corner == ORIGIN { [0.0; 3] } else { u[corner as usize] };
        let face = |corners: [u32; 3]| {
            let [a, b, c] = corners.map(at);
            let (ab, ac) = (subtract(b, a), subtract(c, a));
            let normal = cross(ab, ac);
            // measured from the nearest corner to the origin's side: the least rounding
            HullFace { corners, normal, offset: dot(normal, a), rounding: ROUNDING * length(ab) * length(ac), size: length(a) }
        };
        let Some(start) = first_tetrahedron(u) else { return true };
        self.faces.clear();
        let [a, b, c] = start;
        for corners in [[a, b, c], [ORIGIN, b, a], [ORIGIN, c, b], [ORIGIN, a, c]] {
            self.faces.push(face(corners));
        }
        for (index, point) in u.iter().enumerate() {
            let index = index as u32;
            if start.contains(&index) {
                continue;
            }
            let size = length(*point);
            self.horizon.clear();
            let horizon = &mut self.horizon;
            self.faces.retain(|face| {
                // A point in the plane of a face, as grids have many, is not above it: rounding would say yes to one face and no to the next.
                let inside = dot(face.normal, *point) <= face.offset + face.rounding * (size + face.size);
                if !inside {
                    let [a, b, c] = face.corners;
                    for edge in [[a, b], [b, c], [c, a]] {
                        if let Some(twin) = horizon.iter().position(|other| *other == [edge[1], edge[0]]) {
                            horizon.swap_remove(twin);
                        } else {
                            horizon.push(edge);
                        }
                    }
                }
                inside
            });
            for at in 0..self.horizon.len() {
                let [a, b] = self.horizon[at];
                self.faces.push(face([a, b, index]));
            }
        }
        let mut open = false;
        for face in &self.faces {
            if face.corners.contains(&ORIGIN) {
                open = true;
                continue;
            }
            let [p, q, r] = face.corners.map(|corner| flat[corner as usize]);
            let determinant = 2.0 * dot(p, cross(q, r));
            let (qr, rp, pq) = (cross(q, r), cross(r, p), cross(p, q));
            let (pp, qq, rr) = (dot(p, p), dot(q, q), dot(r, r));
            let center: [f64; 3] = std::array::from_fn(|i| (pp * qr[i] + qq * rp[i] + rr * pq[i]) / determinant);
            let radius = length(center);
            if radius.is_finite() {
                out.push(Facet { corners: face.corners, radius });
            }
        }
        open
    }
}

/// Three points that span a tetrahedron with the origin, ordered so that the origin lies beneath their plane.
fn first_tetrahedron(u: &[[f64; 3]]) -> Option<[u32; 3]> {
    let a = 0;
    let best = |measure: &dyn Fn(usize) -> f64| {
        let at = (1..u.len().min(24)).max_by(|&x, &y| measure(x).total_cmp(&measure(y)).then(y.cmp(&x)))?;
        (measure(at) > 0.0).then_some(at)
    };
    let size = dot(*u.first()?, *u.first()?);
    let b = best(&|j| dot(cross(u[a], u[j]), cross(u[a], u[j])))?;
    let c = best(&|j| dot(cross(u[a], u[b]), u[j]).abs())?;
    let volume = dot(cross(u[a], u[b]), u[c]);
    if volume.abs() <= 1e-12 * size * size.sqrt() {
        return None;
    }
    Some(if volume > 0.0 { [a as u32, b as u32, c as u32] } else { [a as u32, c as u32, b as u32] })
}

fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The piecewise-linear element on one simplex of dimension 1 to 3 in R^D, in units of its longest first edge.
#[derive(Debug, Clone, Copy)]
struct Element {
    /// Length of the unit.
    unit: f64,
    /// Volume in units^d.
    volume: f64,
    circumradius: f64,
    /// Products of the hat functions' gradients, in units^-2.
    products: [[f64; 4]; 4],
    /// Inverse of the edges' Gram matrix: gradient of hat b + 1 = Σ_a inverse[b][a] edge_a.
    inverse: [[f64; 3]; 3],
}

#[allow(clippy::needless_range_loop)] // indices of small matrices, as they are written
impl Element {
    /// `None` for a simplex so flat that it has no gradients.
    fn new(points: &[f64], ambient: usize, corners: &[u32]) -> Option<Element> {
        let d = corners.len() - 1;
        let origin = &points[corners[0] as usize * ambient..][..ambient];
        let other = |a: usize| &points[corners[a + 1] as usize * ambient..][..ambient];
        let mut unit = 0.0f64;
        for a in 0..d {
            for (x, o) in other(a).iter().zip(origin) {
                unit = unit.max((x - o).abs());
            }
        }
        if !(unit > 0.0 && unit.is_finite()) {
            return None;
        }
        let mut gram = [[0.0; 3]; 3];
        for i in 0..ambient {
            let mut edge = [0.0; 3];
            for (a, edge) in edge[..d].iter_mut().enumerate() {
                *edge = (other(a)[i] - origin[i]) / unit;
            }
            for a in 0..d {
                for b in 0..=a {
                    gram[a][b] += edge[a] * edge[b];
                }
            }
        }
        for a in 0..d {
            for b in a + 1..d {
                gram[a][b] = gram[b][a];
            }
        }
        let g = &gram;
        let (determinant, adjugate) = match d {
            1 => (g[0][0], [[1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]]),
            2 => (g[0][0] * g[1][1] - g[0][1] * g[0][1], [[g[1][1], -g[0][1], 0.0], [-g[0][1], g[0][0], 0.0], [0.0; 3]]),
            _ => {
                let minor = |a: usize, b: usize| {
                    let (r, s) = ((a + 1) % 3, (a + 2) % 3);
                    let (t, u) = ((b + 1) % 3, (b + 2) % 3);
                    g[r][t] * g[s][u] - g[r][u] * g[s][t]
                };
                let mut adjugate = [[0.0; 3]; 3];
                for a in 0..3 {
                    for b in 0..=a {
                        adjugate[a][b] = minor(a, b);
                        adjugate[b][a] = adjugate[a][b];
                    }
                }
                (g[0][0] * adjugate[0][0] + g[0][1] * adjugate[0][1] + g[0][2] * adjugate[0][2], adjugate)
            }
        };
        let bound: f64 = (0..d).map(|a| g[a][a]).product();
        if determinant.is_nan() || determinant <= FLAT * bound {
            return None;
        }
        let inverse = adjugate.map(|row| row.map(|x| x / determinant));
        let mut products = [[0.0; 4]; 4];
        for a in 0..d {
            for b in 0..d {
                products[a + 1][b + 1] = inverse[a][b];
            }
        }
        for a in 0..d {
            let sum: f64 = inverse[a][..d].iter().sum();
            products[0][a + 1] = -sum;
            products[a + 1][0] = -sum;
            products[0][0] += sum;
        }
        // circumcentre c with 2 G c = diag G, in the basis of the edges; |c|² = diag G · c / 2
        let mut square = 0.0;
        for a in 0..d {
            for b in 0..d {
                square += g[a][a] * inverse[a][b] * g[b][b] / 4.0;
            }
        }
        let volume = determinant.sqrt() / [1.0, 2.0, 6.0][d - 1];
        Some(Element { unit, volume, circumradius: unit * square.max(0.0).sqrt(), products, inverse })
    }
}

/// The simplices of a local mesh on their points, ready for assembly.
///
/// Everything here is a sum over simplices, each counted votes / (d + 1) times.
#[derive(Debug, Clone, Copy)]
pub struct VotedSimplices<'a> {
    points: &'a [f64],
    ambient: usize,
    dimension: usize,
    corners: &'a [u32],
    votes: &'a [u8],
    stretch: Option<&'a [f64]>,
}

impl<'a> VotedSimplices<'a> {
    /// Simplices of `dimension` + 1 corners each on `points` of `ambient` coordinates each.
    ///
    /// ```
    /// use beltrami::operators::VotedSimplices;
    /// let square = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0];
    /// let mesh = VotedSimplices::new(&square, 2, 2, &[0, 1, 2, 1, 2, 3], &[3, 3])?;
    /// assert!((mesh.mass()?.iter().sum::<f64>() - 1.0).abs() < 1e-15);
    /// assert!(mesh.stiffness()?.diagonal().iter().all(|entry| (entry - 1.0).abs() < 1e-15));
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if the arrays do not fit together, a corner is no point, or a dimension is not supported.
    pub fn new(points: &'a [f64], ambient: usize, dimension: usize, corners: &'a [u32], votes: &'a [u8]) -> Result<Self> {
        if !(1..=3).contains(&dimension) || ambient < dimension || !points.len().is_multiple_of(ambient) {
            return Err(Error::input(format!(
                "simplices of dimension {dimension} on {} coordinates in R^{ambient}; the dimension must be 1 to 3 and at most D",
                points.len()
            )));
        }
        if corners.len() != votes.len() * (dimension + 1) {
            return Err(Error::input(format!(
                "{} corners and {} votes do not make simplices of dimension {dimension}",
                corners.len(),
                votes.len()
            )));
        }
        let count = points.len() / ambient;
        if let Some(at) = corners.par_iter().with_min_len(CHUNK).position_first(|&corner| corner as usize >= count) {
            return Err(Error::input(format!("simplex {} has corner {}, the cloud has {count} points", at / (dimension + 1), corners[at])));
        }
        Ok(VotedSimplices { points, ambient, dimension, corners, votes, stretch: None })
    }

    /// The same, each simplex counted so many times more in every sum ([`LocalMesh::stretch`]).
    ///
    /// ```
    /// use beltrami::operators::VotedSimplices;
    /// let mesh = VotedSimplices::new(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0], 2, 2, &[0, 1, 2], &[3])?.stretched(&[1.5])?;
    /// assert!((mesh.mass()?.iter().sum::<f64>() - 0.75).abs() < 1e-15);
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if there are not as many numbers as simplices, or one is not positive.
    pub fn stretched(self, stretch: &'a [f64]) -> Result<Self> {
        match stretch.len() == self.votes.len() && stretch.iter().all(|&x| x > 0.0 && x.is_finite()) {
            true => Ok(VotedSimplices { stretch: Some(stretch), ..self }),
            false => Err(Error::input(format!("stretch has {} numbers; {} positive ones are needed", stretch.len(), self.votes.len()))),
        }
    }

    fn count(&self) -> usize {
        self.points.len() / self.ambient
    }

    fn corners(&self, simplex: usize) -> &[u32] {
        &self.corners[simplex * (self.dimension + 1)..][..self.dimension + 1]
    }

    fn share(&self, simplex: usize) -> f64 {
        f64::from(self.votes[simplex]) / (self.dimension + 1) as f64 * self.stretch.map_or(1.0, |stretch| stretch[simplex])
    }

    fn element(&self, simplex: usize) -> Option<Element> {
        Element::new(self.points, self.ambient, self.corners(simplex))
    }

    /// Which simplices each point is a corner of: starts (points + 1) and simplices, ascending.
    fn incidence(&self) -> (Vec<usize>, Vec<u32>) {
        let mut starts = vec![0; self.count() + 1];
        for &corner in self.corners {
            starts[corner as usize + 1] += 1;
        }
        for point in 0..self.count() {
            starts[point + 1] += starts[point];
        }
        let mut next = starts.clone();
        let mut simplices = vec![0; self.corners.len()];
        for (at, &corner) in self.corners.iter().enumerate() {
            simplices[next[corner as usize]] = (at / (self.dimension + 1)) as u32;
            next[corner as usize] += 1;
        }
        (starts, simplices)
    }

    /// Volume (length, area) of each simplex, not weighted by its votes.
    pub fn volumes(&self) -> Vec<f64> {
        (0..self.votes.len())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|simplex| self.element(simplex).map_or(0.0, |e| e.volume * e.unit.powi(self.dimension as i32)))
            .collect()
    }

    /// Lumped mass of each point: a (d + 1)-th of the volumes of its simplices.
    ///
    /// # Errors
    /// [`Error::Input`] if points are in no simplex, [`Error::Numerical`] if a mass underflows or is not finite; the points are named.
    pub fn mass(&self) -> Result<Vec<f64>> {
        let volumes = self.volumes();
        let mut mass = vec![0.0; self.count()];
        for (simplex, volume) in volumes.iter().enumerate() {
            let part = volume * self.share(simplex) / (self.dimension + 1) as f64;
            for &corner in self.corners(simplex) {
                mass[corner as usize] += part;
            }
        }
        let bad: Vec<u32> =
            (0..mass.len() as u32).filter(|&point| !(mass[point as usize] > 0.0 && mass[point as usize].is_finite())).collect();
        match bad.first() {
            None => Ok(mass),
            Some(&first) if mass[first as usize] == 0.0 && self.corners.contains(&first) => Err(Error::numerical(format!(
                "areas at {} points ({}) underflow to 0; measure the coordinates in smaller units",
                bad.len(),
                super::frames::name_some(&bad)
            ))),
            Some(&first) if mass[first as usize] == 0.0 => Err(Error::input(format!(
                "{} points ({}) are in no simplex; remove them or reach farther with a larger neighbors=",
                bad.len(),
                super::frames::name_some(&bad)
            ))),
            Some(_) => Err(Error::numerical(format!(
                "areas at {} points ({}) overflow; measure the coordinates in larger units",
                bad.len(),
                super::frames::name_some(&bad)
            ))),
        }
    }

    /// The stiffness matrix of piecewise-linear functions: symmetric to the last bit, positive semidefinite, rows sum to zero.
    ///
    /// # Errors
    /// [`Error::Numerical`] if an entry is not finite (volumes and curves measured in extreme units).
    pub fn stiffness(&self) -> Result<Csr> {
        self.assemble(|_, _| 1.0)
    }

    /// The stiffness of `∫ w |grad u|²` with the weight `w = exp(-potential)` averaged on each edge as if the potential were
    /// linear on it (the harmonic mean, Scharfetter and Gummel 1969): `w_i z / (1 - exp(-z))`, `z = potential_i - potential_j`.
    /// Potentials are taken relative to their least value, so the greatest weight is 1.
    ///
    /// # Errors
    /// [`Error::Input`] if `potential` has another length than the cloud or a value is not finite; [`Error::Numerical`].
    pub fn weighted_stiffness(&self, potential: &[f64]) -> Result<Csr> {
        if potential.len() != self.count() {
            return Err(Error::input(format!("the potential has {} values, the cloud has {} points", potential.len(), self.count())));
        }
        if let Some(at) = potential.iter().position(|value| !value.is_finite()) {
            return Err(Error::input(format!("the potential at point {at} is {}", potential[at])));
        }
        let least = potential.iter().copied().fold(f64::INFINITY, f64::min);
        self.assemble(|i, j| edge_weight(potential[i] - least, potential[j] - least))
    }

    fn assemble(&self, weight: impl Fn(usize, usize) -> f64 + Sync) -> Result<Csr> {
        let size = self.dimension + 1;
        let edges = size * (size - 1) / 2;
        // minus the product of two hat functions' gradients, integrated, for each pair of corners
        let mut pairs = vec![0.0; self.votes.len() * edges];
        pairs.par_chunks_mut(CHUNK * edges).enumerate().for_each(|(chunk, pairs)| {
            for (at, pairs) in pairs.chunks_exact_mut(edges).enumerate() {
                let simplex = chunk * CHUNK + at;
                let Some(element) = self.element(simplex) else { continue };
                let factor = self.share(simplex) * element.volume * element.unit.powi(self.dimension as i32 - 2);
                let corners = self.corners(simplex);
                let mut next = 0;
                for a in 0..size {
                    for b in a + 1..size {
                        pairs[next] = factor * element.products[a][b] * weight(corners[a] as usize, corners[b] as usize);
                        next += 1;
                    }
                }
            }
        });
        let (starts, simplices) = self.incidence();
        let matrix = Csr::by_rows(self.count(), self.count(), |point, entries: &mut Vec<(u32, u32, f64)>, indices, values| {
            entries.clear();
            for &simplex in &simplices[starts[point]..starts[point + 1]] {
                let corners = self.corners(simplex as usize);
                let numbers = &pairs[simplex as usize * edges..][..edges];
                let mut next = 0;
                for a in 0..size {
                    for b in a + 1..size {
                        if corners[a] as usize == point {
                            entries.push((corners[b], simplex, numbers[next]));
                        } else if corners[b] as usize == point {
                            entries.push((corners[a], simplex, numbers[next]));
                        }
                        next += 1;
                    }
                }
            }
            // by neighbour, then by simplex: both rows of a pair add up the same numbers in the same order
            entries.sort_unstable_by_key(|entry| (entry.0, entry.1));
            let mut diagonal = None;
            let mut total = 0.0;
            for group in entries.chunk_by(|x, y| x.0 == y.0) {
                let sum: f64 = group.iter().map(|entry| entry.2).sum();
                if group[0].0 as usize > point && diagonal.is_none() {
                    diagonal = Some(indices.len());
                    indices.push(point as u32);
                    values.push(0.0);
                }
                indices.push(group[0].0);
                values.push(sum);
                total += sum;
            }
            let diagonal = diagonal.unwrap_or_else(|| {
                indices.push(point as u32);
                values.push(0.0);
                indices.len() - 1
            });
            values[diagonal] = -total;
        });
        match matrix.values().iter().any(|value| !value.is_finite()) {
            true => Err(Error::numerical("an entry of the operator overflows; measure the coordinates in other units")),
            false => Ok(matrix),
        }
    }

    /// Mean length of the edges.
    pub fn mean_edge_length(&self) -> f64 {
        let size = self.dimension + 1;
        let sums: Vec<(f64, f64)> = (0..self.votes.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let mut sum = (0.0, 0.0);
                for simplex in chunk * CHUNK..((chunk + 1) * CHUNK).min(self.votes.len()) {
                    let corners = self.corners(simplex);
                    for a in 0..size {
                        for b in a + 1..size {
                            sum.0 += self.share(simplex) * self.distance(corners[a], corners[b]);
                            sum.1 += self.share(simplex);
                        }
                    }
                }
                sum
            })
            .collect();
        let (length, count) = sums.iter().fold((0.0, 0.0), |(x, y), (a, b)| (x + a, y + b));
        if count > 0.0 { length / count } else { 0.0 }
    }

    fn distance(&self, a: u32, b: u32) -> f64 {
        let (p, q) = (&self.points[a as usize * self.ambient..][..self.ambient], &self.points[b as usize * self.ambient..][..self.ambient]);
        let unit = p.iter().zip(q).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
        if unit == 0.0 {
            return 0.0;
        }
        unit * p.iter().zip(q).map(|(x, y)| ((x - y) / unit) * ((x - y) / unit)).sum::<f64>().sqrt()
    }

    /// Gradient of piecewise-linear functions, (simplices D) x points: rows s D ... s D + D - 1 give the gradient on simplex s.
    ///
    /// With A the volumes times votes / (d + 1), `stiffness = gradient^T A gradient`.
    ///
    /// # Errors
    /// [`Error::Numerical`] if an entry is not finite (coordinates in extreme units).
    pub fn gradient(&self) -> Result<Csr> {
        let (size, ambient) = (self.dimension + 1, self.ambient);
        let rows = self.votes.len() * ambient;
        let (mut indices, mut values) = (vec![0; rows * size], vec![0.0; rows * size]);
        let block = CHUNK * ambient * size;
        indices.par_chunks_mut(block).zip(values.par_chunks_mut(block)).enumerate().for_each(|(chunk, (indices, values))| {
            let simplices = indices.chunks_exact_mut(ambient * size).zip(values.chunks_exact_mut(ambient * size));
            for (at, (indices, values)) in simplices.enumerate() {
                let simplex = chunk * CHUNK + at;
                let corners = self.corners(simplex);
                let element = self.element(simplex);
                let mut order = [0, 1, 2, 3];
                order[..size].sort_unstable_by_key(|&a| corners[a]);
                let origin = &self.points[corners[0] as usize * ambient..][..ambient];
                for coordinate in 0..ambient {
                    let mut hats = [0.0; 4];
                    if let Some(element) = &element {
                        for a in 0..self.dimension {
                            let there = self.points[corners[a + 1] as usize * ambient + coordinate];
                            let edge = (there - origin[coordinate]) / element.unit / element.unit;
                            for b in 0..self.dimension {
                                hats[b + 1] += element.inverse[b][a] * edge;
                            }
                        }
                        hats[0] = -hats[1..].iter().sum::<f64>();
                    }
                    for (to, &a) in order[..size].iter().enumerate() {
                        indices[coordinate * size + to] = corners[a];
                        values[coordinate * size + to] = hats[a];
                    }
                }
            }
        });
        if values.par_iter().with_min_len(CHUNK).any(|value| !value.is_finite()) {
            return Err(Error::numerical("an entry of the gradient overflows; measure the coordinates in larger units"));
        }
        Ok(Csr::trusted(rows, self.count(), (0..=rows).map(|row| row * size).collect(), indices, values))
    }
}

/// Mean of `exp(-x)` between two potentials such that the flux through the edge is exact for a linear potential.
fn edge_weight(here: f64, there: f64) -> f64 {
    let (low, z) = if here <= there { (here, there - here) } else { (there, here - there) };
    // seen from the lower end: w (-z) / (1 - e^z) = w z / (e^z - 1)
    let bernoulli = if z < 1e-5 { 1.0 - z / 2.0 + z * z / 12.0 } else { z / z.exp_m1() };
    (-low).exp() * bernoulli
}
