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

use super::chart::Chart;
use super::frames::{Cloud, Frames, Progress, STEEP, TASK, agree};
use super::hull::{Facet, Hull};
use super::voted_simplices::Element;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::near::Scratch;
use crate::vector::length;
use rayon::prelude::*;

/// The most neighbours a star is given.
const MOST: usize = 960;

/// How [`local_mesh`] goes about it.
#[derive(Debug, Clone, Copy, Default)]
pub struct LocalMeshOptions<'a> {
    /// Neighbours each star starts with; without it 30 for surfaces and 60 for volumes.
    pub neighbors: Option<usize>,
    /// Outward normals, D numbers per point: points whose normals oppose each other are never neighbours, which keeps the two sides of
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
    /// Orthonormal tangent vectors, d x D numbers per point.
    pub frames: Vec<f64>,
    /// The second fundamental form in the frame's directions: for each point a vector of R^D for each pair a <= b.
    pub curvature: Vec<f64>,
    /// The dimension that the growth of the neighbours' distances suggests; far from `dimension`, that one may be wrong.
    pub estimated_dimension: f64,
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
            "local meshes are made for clouds of dimension 1, 2 and 3, not {dimension}; moving least squares takes any"
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
