//! Contours of a function at many levels at once, split into connected components, and what lies between them: the Reeb graph.

use crate::control::Control;
use crate::error::{Error, Result};
use rayon::prelude::*;

/// A function on a complex of triangles or edges, and the levels at which it is cut.
///
/// Vertices are told apart by rank alone, so that equal values need no tolerance: cut `k` has the vertices of rank below
/// `cuts[k]` beneath it and the others above. `levels[k]` says only where on the edges the contour is drawn.
#[derive(Debug, Clone, Copy)]
pub struct Sliced<'a> {
    /// Coordinates, vertex after vertex.
    pub points: &'a [f64],
    /// Coordinates per vertex.
    pub dimension: usize,
    /// Corners of the cells, `size` each.
    pub cells: &'a [u32],
    /// 3: triangles, two crossings of one triangle lie on one contour; 2: edges, two crossings that share a vertex do.
    pub size: usize,
    /// The function, a value per vertex.
    pub values: &'a [f64],
    /// The place of each vertex among all, by value and then by number.
    pub ranks: &'a [u32],
    /// Ascending, from 1 to the number of vertices - 1.
    pub cuts: &'a [u32],
    /// The value that each cut stands for.
    pub levels: &'a [f64],
    /// How much a crossing counts beside each vertex (edges only).
    pub weights: &'a [f64],
}

/// Contours and the regions between them. Each contour has one region below and one above.
#[derive(Debug, Clone, PartialEq)]
pub struct ContourGraph {
    /// The cut that each contour belongs to, ascending.
    pub cut: Vec<u32>,
    /// Region below each contour.
    pub below: Vec<u32>,
    /// Region above each contour.
    pub above: Vec<u32>,
    /// Points of the contours, contour after contour.
    pub points: Vec<f64>,
    /// How much each point counts: on triangles half the length of the segments beside it.
    pub weights: Vec<f64>,
    /// Where the points of each contour start, and their number at last.
    pub starts: Vec<usize>,
    /// Region of each vertex.
    pub region: Vec<u32>,
    /// How many regions there are.
    pub regions: usize,
}

struct Forest(Vec<u32>);

impl Forest {
    fn new(count: usize) -> Forest {
        Forest((0..count as u32).collect())
    }

    fn root(&mut self, mut at: u32) -> u32 {
        while self.0[at as usize] != at {
            let up = self.0[self.0[at as usize] as usize];
            self.0[at as usize] = up;
            at = up;
        }
        at
    }

    /// The lesser number becomes the root, so that the answer does not depend on the order of the unions.
    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// Cuts a function at all levels and finds the components of the contours and of the regions between them.
///
/// On a closed surface where every region holds at most one critical vertex, contours and regions are the Reeb graph of the function.
///
/// ```
/// use beltrami::{Control, reeb::{Sliced, contour_graph}};
/// // a ring of eight vertices, its edges only: its middle cut has two contours, one on each branch
/// let cells: Vec<u32> = (0..8).flat_map(|i| [i, (i + 1) % 8]).collect();
/// let values = [0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0];
/// let ranks = [0, 1, 3, 5, 7, 6, 4, 2];
/// let points: Vec<f64> = values.iter().flat_map(|&v| [v, 0.0]).collect();
/// let (cuts, levels) = ([1, 3, 7], [0.5, 1.5, 3.5]);
/// let sliced = Sliced { points: &points, dimension: 2, cells: &cells, size: 2, values: &values, ranks: &ranks,
///                       cuts: &cuts, levels: &levels, weights: &[1.0; 8] };
/// let graph = contour_graph(&sliced, &Control::default())?;
/// assert_eq!((graph.cut, graph.regions), (vec![0, 1, 1, 2], 4));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if lengths do not fit together, a number is out of range, or there are more than 2^31 crossings of edges and
/// levels; [`Error::Cancelled`].
pub fn contour_graph(sliced: &Sliced<'_>, control: &Control) -> Result<ContourGraph> {
    check(sliced)?;
    let count = sliced.ranks.len();
    let slab: Vec<u32> = sliced.ranks.par_iter().map(|&rank| sliced.cuts.partition_point(|&cut| cut <= rank) as u32).collect();
    let (edges, cell_edges) = edges(sliced.cells, sliced.size, &slab);
    control.report(0.1)?;

    // The crossings of edge e with cuts slab(low) .. slab(high) are first[e], first[e] + 1, ...
    let mut first = Vec::with_capacity(edges.len() + 1);
    let mut total = 0_usize;
    for &[a, b] in &edges {
        first.push(total);
        total += (slab[b as usize] - slab[a as usize]) as usize;
    }
    first.push(total);
    if total > i32::MAX as usize {
        return Err(Error::input(format!("{total} crossings of edges and levels are too many; ask for fewer levels")));
    }
    let mut forest = Forest::new(total);
    let mut weights = vec![0.0; total];
    let d = sliced.dimension;
    let point = |edge: usize, cut: u32, out: &mut [f64]| -> f64 {
        let [a, b] = edges[edge].map(|end| end as usize);
        let (low, high, level) = (sliced.values[a], sliced.values[b], sliced.levels[cut as usize]);
        // halved, so that the difference of huge values does not overflow
        let rise = 0.5 * high - 0.5 * low;
        let share = if rise > 0.0 { ((0.5 * level - 0.5 * low) / rise).clamp(0.0, 1.0) } else { 0.5 };
        for (axis, slot) in out.iter_mut().enumerate() {
            *slot = (1.0 - share) * sliced.points[a * d + axis] + share * sliced.points[b * d + axis];
        }
        share
    };
    if sliced.size == 3 {
        let (mut p, mut q) = (vec![0.0; d], vec![0.0; d]);
        for (step, (corners, sides)) in sliced.cells.chunks_exact(3).zip(&cell_edges).enumerate() {
            if step % (1 << 16) == 0 {
                control.report(0.1 + 0.4 * step as f64 / cell_edges.len() as f64)?;
            }
            let (low, high) = corners.iter().fold((u32::MAX, 0), |(low, high), &corner| {
                let at = slab[corner as usize];
                (low.min(at), high.max(at))
            });
            for cut in low..high {
                // exactly two of the three sides cross a cut that lies between the corners
                let mut ends = sides.iter().map(|&side| side as usize).filter(|&side| {
                    let [a, b] = edges[side].map(|end| slab[end as usize]);
                    a <= cut && cut < b
                });
                if let (Some(one), Some(two)) = (ends.next(), ends.next()) {
                    point(one, cut, &mut p);
                    point(two, cut, &mut q);
                    let length = p.iter().zip(&q).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
                    let at = [one, two].map(|side| first[side] + (cut - slab[edges[side][0] as usize]) as usize);
                    at.iter().for_each(|&crossing| weights[crossing] += 0.5 * length);
                    forest.join(at[0] as u32, at[1] as u32);
                }
            }
        }
    } else {
        join_at_vertices(&edges, &first, &slab, count, &mut forest, control)?;
        for (edge, &[a, b]) in edges.iter().enumerate() {
            let mean = 0.5 * (sliced.weights[a as usize] + sliced.weights[b as usize]);
            weights[first[edge]..first[edge + 1]].fill(mean);
        }
    }
    control.report(0.6)?;

    // Contours, numbered by cut and then by their first crossing.
    let mut cut_of = vec![0_u32; total];
    for (edge, &[a, _]) in edges.iter().enumerate() {
        for (step, slot) in cut_of[first[edge]..first[edge + 1]].iter_mut().enumerate() {
            *slot = slab[a as usize] + step as u32;
        }
    }
    let mut roots: Vec<(u32, u32)> =
        (0..total as u32).filter(|&crossing| forest.0[crossing as usize] == crossing).map(|root| (cut_of[root as usize], root)).collect();
    roots.sort_unstable();
    let mut number = vec![0_u32; total];
    for (contour, &(_, root)) in roots.iter().enumerate() {
        number[root as usize] = contour as u32;
    }
    let contour_of: Vec<u32> = (0..total as u32).map(|crossing| number[forest.root(crossing) as usize]).collect();
    let contours = roots.len();
    control.report(0.7)?;

    // Regions: vertices, and the two sides of each contour, joined along the edges.
    let mut regions = Forest::new(count + 2 * contours);
    let side = |contour: u32, above: bool| (count + 2 * contour as usize + usize::from(above)) as u32;
    for (edge, &[a, b]) in edges.iter().enumerate() {
        let mut under = a;
        for &contour in &contour_of[first[edge]..first[edge + 1]] {
            regions.join(under, side(contour, false));
            under = side(contour, true);
        }
        regions.join(under, b);
    }
    control.report(0.8)?;
    let mut names = vec![u32::MAX; count + 2 * contours];
    let mut found = 0;
    let mut name = |at: u32| {
        let root = regions.root(at) as usize;
        if names[root] == u32::MAX {
            names[root] = found;
            found += 1;
        }
        names[root]
    };
    let region = (0..count as u32).map(&mut name).collect();
    let below = (0..contours as u32).map(|contour| name(side(contour, false))).collect();
    let above = (0..contours as u32).map(|contour| name(side(contour, true))).collect();

    // Points, grouped by contour.
    let mut starts = vec![0_usize; contours + 1];
    contour_of.iter().for_each(|&contour| starts[contour as usize + 1] += 1);
    for contour in 0..contours {
        starts[contour + 1] += starts[contour];
    }
    let mut next = starts.clone();
    let (mut points, mut grouped) = (vec![0.0; total * d], vec![0.0; total]);
    for (edge, &[a, _]) in edges.iter().enumerate() {
        for crossing in first[edge]..first[edge + 1] {
            let slot = &mut next[contour_of[crossing] as usize];
            point(edge, slab[a as usize] + (crossing - first[edge]) as u32, &mut points[*slot * d..(*slot + 1) * d]);
            grouped[*slot] = weights[crossing];
            *slot += 1;
        }
    }
    control.report(1.0)?;
    let cut = roots.iter().map(|&(cut, _)| cut).collect();
    Ok(ContourGraph { cut, below, above, points, weights: grouped, starts, region, regions: found as usize })
}

/// Crossings of one cut on edges that share a vertex are one contour.
fn join_at_vertices(edges: &[[u32; 2]], first: &[usize], slab: &[u32], count: usize, forest: &mut Forest, control: &Control) -> Result<()> {
    const NONE: u32 = u32::MAX;
    // One slot a vertex and cut that its edges reach: those below it, then those above.
    let mut reach: Vec<(u32, u32)> = slab.iter().map(|&at| (at, at)).collect();
    for &[a, b] in edges {
        let (low, high) = (slab[a as usize], slab[b as usize]);
        reach[a as usize].1 = reach[a as usize].1.max(high);
        reach[b as usize].0 = reach[b as usize].0.min(low);
    }
    let mut base = Vec::with_capacity(count);
    let mut slots = 0_usize;
    for &(low, high) in &reach {
        base.push(slots);
        slots += (high - low) as usize;
    }
    let mut held = vec![NONE; slots];
    for (edge, &[a, b]) in edges.iter().enumerate() {
        if edge % (1 << 16) == 0 {
            control.report(0.1 + 0.5 * edge as f64 / edges.len() as f64)?;
        }
        let low = slab[a as usize];
        for (step, crossing) in (first[edge]..first[edge + 1]).enumerate() {
            for end in [a, b] {
                let slot = &mut held[base[end as usize] + low as usize + step - reach[end as usize].0 as usize];
                if *slot == NONE {
                    *slot = crossing as u32;
                } else {
                    forest.join(*slot, crossing as u32);
                }
            }
        }
    }
    Ok(())
}

/// Distinct edges, the lower slab first (within a slab the lower number), and the three sides of each triangle.
fn edges(cells: &[u32], size: usize, slab: &[u32]) -> (Vec<[u32; 2]>, Vec<[u32; 3]>) {
    let sides = if size == 3 { 3 } else { 1 };
    let mut keys: Vec<(u64, u32)> = cells
        .par_chunks_exact(size)
        .enumerate()
        .flat_map_iter(|(cell, corners)| {
            (0..sides).map(move |side| {
                let (a, b) = (corners[side], corners[(side + 1) % size]);
                ((u64::from(a.min(b)) << 32) | u64::from(a.max(b)), (cell * sides + side) as u32)
            })
        })
        .collect();
    keys.par_sort_unstable();
    let mut edges: Vec<[u32; 2]> = Vec::new();
    let mut of_cell = vec![[0_u32; 3]; if size == 3 { cells.len() / 3 } else { 0 }];
    let mut last = u64::MAX;
    for (key, at) in keys {
        if key != last {
            let (a, b) = ((key >> 32) as u32, key as u32);
            edges.push(if slab[a as usize] <= slab[b as usize] { [a, b] } else { [b, a] });
            last = key;
        }
        if size == 3 {
            of_cell[at as usize / 3][at as usize % 3] = edges.len() as u32 - 1;
        }
    }
    (edges, of_cell)
}

fn check(sliced: &Sliced<'_>) -> Result<()> {
    let count = sliced.ranks.len();
    if sliced.size != 2 && sliced.size != 3 {
        return Err(Error::input(format!("cells have {} corners; edges (2) and triangles (3) can be cut", sliced.size)));
    }
    let lengths = [
        (sliced.points.len(), count * sliced.dimension, "coordinates"),
        (sliced.values.len(), count, "values"),
        (sliced.weights.len(), count, "weights"),
        (sliced.levels.len(), sliced.cuts.len(), "levels"),
        (sliced.cells.len() % sliced.size, 0, "corners too many"),
    ];
    if let Some((got, want, what)) = lengths.into_iter().find(|(got, want, _)| got != want) {
        return Err(Error::input(format!("{got} {what}, {want} are needed")));
    }
    let finite = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
    if ![sliced.points, sliced.values, sliced.levels, sliced.weights].into_iter().all(finite) {
        return Err(Error::input("coordinates, values, levels and weights must be finite"));
    }
    if let Some(&corner) = sliced.cells.iter().find(|&&corner| corner as usize >= count) {
        return Err(Error::input(format!("a cell refers to vertex {corner}, there are {count}")));
    }
    if sliced.cuts.windows(2).any(|pair| pair[0] >= pair[1]) || sliced.cuts.iter().any(|&cut| cut == 0 || cut as usize >= count) {
        return Err(Error::input(format!("cuts must ascend from 1 to {}", count.saturating_sub(1))));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::TriangleMesh;
    use crate::shape::make;

    fn graph(mesh: &TriangleMesh<'_>, values: &[f64], size: usize, levels: usize) -> ContourGraph {
        let count = values.len();
        let mut order: Vec<u32> = (0..count as u32).collect();
        order.sort_by(|&a, &b| values[a as usize].total_cmp(&values[b as usize]).then(a.cmp(&b)));
        let mut ranks = vec![0; count];
        order.iter().enumerate().for_each(|(rank, &vertex)| ranks[vertex as usize] = rank as u32);
        let cuts: Vec<u32> = (1..=levels).map(|k| (k * count / (levels + 1)) as u32).collect();
        let at = |rank: u32| values[order[rank as usize] as usize];
        let heights: Vec<f64> = cuts.iter().map(|&cut| 0.5 * (at(cut - 1) + at(cut))).collect();
        let cells: Vec<u32> = if size == 3 {
            mesh.faces().iter().flatten().copied().collect()
        } else {
            mesh.faces().iter().flat_map(|&[a, b, c]| [a, b, b, c, c, a]).collect()
        };
        let points: Vec<f64> = (0..count).flat_map(|vertex| mesh.vertex(vertex as u32).to_vec()).collect();
        let weights = vec![1.0; count];
        let sliced = Sliced {
            points: &points,
            dimension: 3,
            cells: &cells,
            size,
            values,
            ranks: &ranks,
            cuts: &cuts,
            levels: &heights,
            weights: &weights,
        };
        contour_graph(&sliced, &Control::default()).unwrap()
    }

    #[test]
    fn a_torus_on_its_side_has_one_loop() {
        let mesh = make::torus(1.0, 0.3, 60, 40).unwrap();
        let values: Vec<f64> =
            (0..mesh.vertex_count()).map(|vertex| mesh.vertex(vertex as u32)[0] + 1e-3 * mesh.vertex(vertex as u32)[1]).collect();
        for size in [2, 3] {
            let found = graph(&mesh, &values, size, 31);
            // a connected graph with contours for edges: b1 = contours - regions + 1
            assert_eq!(found.cut.len() + 1 - found.regions, 1, "size {size}");
            let middle = found.cut.iter().filter(|&&cut| cut == 15).count();
            assert_eq!(middle, 2);
        }
    }

    #[test]
    fn contours_of_a_sphere_are_circles_of_the_right_length() {
        let mesh = make::ellipsoid(30, [1.0; 3]).unwrap();
        let values: Vec<f64> = (0..mesh.vertex_count()).map(|vertex| mesh.vertex(vertex as u32)[2]).collect();
        let found = graph(&mesh, &values, 3, 3);
        assert_eq!((found.cut.clone(), found.regions), (vec![0, 1, 2], 4));
        for contour in 0..3 {
            let range = found.starts[contour]..found.starts[contour + 1];
            let z = found.points[3 * range.start + 2];
            let length: f64 = found.weights[range].iter().sum();
            // inscribed polygons of some 150 sides
            assert!((length / (std::f64::consts::TAU * (1.0 - z * z).sqrt()) - 1.0).abs() < 2e-3, "{length} at {z}");
        }
    }

    #[test]
    fn bad_input_is_an_error() {
        let sound = Sliced {
            points: &[0.0, 1.0],
            dimension: 1,
            cells: &[0, 1],
            size: 2,
            values: &[0.0, 1.0],
            ranks: &[0, 1],
            cuts: &[1],
            levels: &[0.5],
            weights: &[1.0, 1.0],
        };
        let run = |sliced: Sliced<'_>| contour_graph(&sliced, &Control::default());
        assert_eq!(run(sound).unwrap().points, [0.5]);
        assert!(run(Sliced { cells: &[0, 2], ..sound }).is_err());
        assert!(run(Sliced { cells: &[0, 1, 1], ..sound }).is_err());
        assert!(run(Sliced { size: 4, ..sound }).is_err());
        assert!(run(Sliced { cuts: &[2], ..sound }).is_err());
        assert!(run(Sliced { levels: &[f64::NAN], ..sound }).is_err());
        assert!(run(Sliced { values: &[0.0], ..sound }).is_err());
    }
}
