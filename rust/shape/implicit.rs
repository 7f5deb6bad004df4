//! Smooth closed surfaces around curves: the zero set of a smoothed distance, meshed by surface nets, projected by Newton
//! steps, its triangles evened out by edge flips and tangential smoothing.

use crate::control::Control;
use crate::error::{Error, Result};
use crate::shape::glue::Glue;
use crate::shape::{Topology, TriangleMesh};
use crate::sparse::CHUNK;
use crate::vector::{cross, dot, minus};
use rayon::prelude::*;

type Point = [f64; 3];

/// What a tube can run along.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Curve {
    /// A circle in a plane z = constant.
    Circle {
        center: Point,
        radius: f64,
    },
    Segment {
        start: Point,
        end: Point,
    },
}

/// `a + factor b`
fn along(a: Point, factor: f64, b: Point) -> Point {
    [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]]
}

impl Curve {
    /// The vector from the nearest point of the curve.
    fn away(&self, point: Point) -> Point {
        match *self {
            Curve::Circle { center, radius } => {
                let [x, y, z] = minus(point, center);
                let rho = x.hypot(y);
                let share = if rho > 0.0 { 1.0 - radius / rho } else { 0.0 };
                [x * share, y * share, z]
            }
            Curve::Segment { start, end } => {
                let (way, from) = (minus(end, start), minus(point, start));
                along(from, -(dot(from, way) / dot(way, way)).clamp(0.0, 1.0), way)
            }
        }
    }

    fn bounds(&self) -> [Point; 2] {
        match *self {
            Curve::Circle { center: [x, y, z], radius } => [[x - radius, y - radius, z], [x + radius, y + radius, z]],
            Curve::Segment { start, end } => {
                [std::array::from_fn(|axis| start[axis].min(end[axis])), std::array::from_fn(|axis| start[axis].max(end[axis]))]
            }
        }
    }
}

/// The smoothed union: `-ln(sum exp(-d_i / softness)) softness - tube`, and its gradient.
struct Field<'c> {
    curves: &'c [Curve],
    tube: f64,
    softness: f64,
}

impl Field<'_> {
    fn value(&self, point: Point) -> f64 {
        let distance = |curve: &Curve| {
            let away = curve.away(point);
            dot(away, away).sqrt()
        };
        let least = self.curves.iter().map(distance).fold(f64::INFINITY, f64::min);
        let sum: f64 = self.curves.iter().map(|curve| ((least - distance(curve)) / self.softness).exp()).sum();
        least - self.softness * sum.ln() - self.tube
    }

    fn with_gradient(&self, point: Point) -> (f64, Point) {
        let least = self.curves.iter().map(|curve| curve.away(point)).map(|away| dot(away, away).sqrt()).fold(f64::INFINITY, f64::min);
        let (mut sum, mut gradient) = (0.0, [0.0; 3]);
        for curve in self.curves {
            let away = curve.away(point);
            let distance = dot(away, away).sqrt();
            let weight = ((least - distance) / self.softness).exp();
            sum += weight;
            if distance > 0.0 {
                gradient = along(gradient, weight / distance, away);
            }
        }
        (least - self.softness * sum.ln() - self.tube, gradient.map(|x| x / sum))
    }

    /// The point moved onto the zero set, and the unit normal there.
    fn project(&self, mut point: Point) -> (Point, Point) {
        let mut normal = [0.0; 3];
        for _ in 0..20 {
            let (value, gradient) = self.with_gradient(point);
            let square = dot(gradient, gradient).max(0.01);
            normal = gradient.map(|x| x / square.sqrt());
            point = along(point, -(value / square).clamp(-self.tube, self.tube), gradient);
            if value.abs() <= 4.0 * f64::EPSILON * (self.tube + dot(point, point).sqrt()) {
                break;
            }
        }
        (point, normal)
    }
}

/// The surface around the curves at distance `tube`, joined smoothly where they come near each other.
pub(crate) fn tube_union(curves: &[Curve], tube: f64, resolution: usize, genus: usize, control: &Control) -> Result<TriangleMesh<'static>> {
    if !(6..=4096).contains(&resolution) {
        return Err(Error::input(format!("resolution is {resolution}; choose from 6 to 4096 cells across a tube")));
    }
    let field = Field { curves, tube, softness: 0.25 * tube };
    let cell = 2.0 * tube / resolution as f64;
    let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for [low, high] in curves.iter().map(Curve::bounds) {
        for axis in 0..3 {
            bounds[0][axis] = bounds[0][axis].min(low[axis]);
            bounds[1][axis] = bounds[1][axis].max(high[axis]);
        }
    }
    let margin = 2.0 * tube + 3.0 * cell; // the smoothed union is a little thicker than the tube
    let counts: [usize; 3] = std::array::from_fn(|axis| ((bounds[1][axis] - bounds[0][axis] + 2.0 * margin) / cell).ceil() as usize + 1);
    let nodes = counts.iter().try_fold(1usize, |product, &count| product.checked_mul(count)).filter(|&nodes| nodes <= 1 << 31);
    if nodes.is_none() {
        return Err(Error::input(format!("resolution {resolution} needs a table of {counts:?} values; choose a coarser one")));
    }
    // Where the surface has a saddle in a plane of the grid, four sheets of the net can meet in one edge: then the grid is shifted.
    let mut last = Error::Cancelled;
    for attempt in 0..SHIFTS {
        let shift = |axis: usize| (0.5 + attempt as f64 * [0.754877666, 0.569840291, 0.430159709][axis]).fract() - 1.0;
        let low = std::array::from_fn(|axis| bounds[0][axis] - margin + cell * shift(axis));
        let share = |done: f64| control.report((attempt as f64 + done) / SHIFTS as f64);
        match tube_union_on(&field, low, cell, counts, genus, &share) {
            Err(error @ Error::Numerical(_)) => last = error,
            outcome => return outcome,
        }
    }
    Err(Error::numerical(format!("resolution {resolution} is too coarse for this surface: {last}")))
}

const SHIFTS: usize = 12;
const ROUNDS: usize = 10;

fn tube_union_on(
    field: &Field<'_>,
    low: Point,
    cell: f64,
    counts: [usize; 3],
    genus: usize,
    share: &impl Fn(f64) -> Result<()>,
) -> Result<TriangleMesh<'static>> {
    let (mut vertices, quads) = surface_net(field, low, cell, counts, share)?;
    vertices.par_iter_mut().with_min_len(64).for_each(|vertex| *vertex = field.project(*vertex).0);
    let mut faces = Vec::with_capacity(2 * quads.len());
    for [a, b, c, d] in quads {
        let [pa, pb, pc, pd] = [a, b, c, d].map(|vertex| vertices[vertex as usize]);
        let (ac, bd) = (minus(pa, pc), minus(pb, pd));
        faces.extend(if dot(ac, ac) <= dot(bd, bd) { [[a, b, c], [a, c, d]] } else { [[b, c, d], [b, d, a]] });
    }
    let mut mesh = TriangleMesh::new(3, vertices.into_flattened(), faces)?;
    check(&mesh, genus)?;
    for round in 0..ROUNDS {
        share(0.6 + 0.4 * round as f64 / ROUNDS as f64)?;
        mesh = even_out(field, &mesh)?;
    }
    Ok(mesh)
}

fn check(mesh: &TriangleMesh<'_>, genus: usize) -> Result<()> {
    let topology = Topology::new(mesh)?;
    if let Some(reason) = topology.non_manifold_reason() {
        return Err(Error::Numerical(reason));
    }
    let (found, components) = (topology.genus()?, topology.components().1);
    if found != genus || components != 1 || !topology.is_closed() {
        return Err(Error::numerical(format!("it comes out with genus {found} in {components} pieces")));
    }
    Ok(())
}

/// A vertex for each cell in which the field changes its sign, and a quadrilateral for each grid edge along which it does.
fn surface_net(
    field: &Field<'_>,
    low: Point,
    cell: f64,
    counts: [usize; 3],
    share: &impl Fn(f64) -> Result<()>,
) -> Result<(Vec<Point>, Vec<[u32; 4]>)> {
    let [nx, ny, nz] = counts;
    let position = |i: usize, j: usize, k: usize| [low[0] + i as f64 * cell, low[1] + j as f64 * cell, low[2] + k as f64 * cell];
    let slice = |k: usize| -> Vec<f64> {
        (0..nx * ny).into_par_iter().with_min_len(256).map(|index| field.value(position(index % nx, index / nx, k))).collect()
    };
    let (mut vertices, mut quads) = (Vec::new(), Vec::new());
    let mut below = slice(0);
    let mut cells_below: Vec<u32> = Vec::new();
    for k in 0..nz - 1 {
        share(0.6 * k as f64 / nz as f64)?;
        let above = slice(k + 1);
        let at = |i: usize, j: usize, up: usize| if up == 0 { below[j * nx + i] } else { above[j * nx + i] };
        let found: Vec<Option<Point>> = (0..(nx - 1) * (ny - 1))
            .into_par_iter()
            .with_min_len(256)
            .map(|index| {
                let (i, j) = (index % (nx - 1), index / (nx - 1));
                let values: [f64; 8] = std::array::from_fn(|corner| at(i + (corner & 1), j + (corner >> 1 & 1), corner >> 2));
                let inside = values.iter().filter(|&&value| value < 0.0).count();
                if inside == 0 || inside == 8 {
                    return None;
                }
                let (mut sum, mut crossings) = ([0.0; 3], 0.0);
                for (a, b) in (0..8usize).flat_map(|a| [1, 2, 4].map(|bit| (a, a | bit))).filter(|(a, b)| a != b) {
                    if (values[a] < 0.0) != (values[b] < 0.0) {
                        let share = values[a] / (values[a] - values[b]);
                        for (axis, sum) in sum.iter_mut().enumerate() {
                            let (from, to) = ((a >> axis & 1) as f64, (b >> axis & 1) as f64);
                            *sum += from + share * (to - from);
                        }
                        crossings += 1.0;
                    }
                }
                Some(along(position(i, j, k), cell / crossings, sum))
            })
            .collect();
        let mut cells = vec![u32::MAX; found.len()];
        for (place, vertex) in cells.iter_mut().zip(found) {
            if let Some(vertex) = vertex {
                *place = vertices.len() as u32;
                vertices.push(vertex);
            }
        }
        if vertices.len() >= 1 << 27 {
            return Err(Error::input(format!("the surface would have more than {} vertices; choose a coarser resolution", 1 << 27)));
        }
        // Quadrilaterals run counterclockwise about the direction of their grid edge where the field grows along it.
        let mut push = |quad: [u32; 4], grows: bool| quads.push(if grows { quad } else { [quad[3], quad[2], quad[1], quad[0]] });
        let cell_at = |cells: &[u32], i: usize, j: usize| cells[j * (nx - 1) + i];
        for j in 1..ny - 1 {
            for i in 1..nx - 1 {
                let here = below[j * nx + i] < 0.0;
                if here != (above[j * nx + i] < 0.0) {
                    let corners = [(i - 1, j - 1), (i, j - 1), (i, j), (i - 1, j)];
                    push(corners.map(|(i, j)| cell_at(&cells, i, j)), here);
                }
                if k == 0 {
                    continue;
                }
                if here != (below[j * nx + i + 1] < 0.0) {
                    let quad =
                        [cell_at(&cells_below, i, j - 1), cell_at(&cells_below, i, j), cell_at(&cells, i, j), cell_at(&cells, i, j - 1)];
                    push(quad, here);
                }
                if here != (below[(j + 1) * nx + i] < 0.0) {
                    let quad =
                        [cell_at(&cells_below, i - 1, j), cell_at(&cells, i - 1, j), cell_at(&cells, i, j), cell_at(&cells_below, i, j)];
                    push(quad, here);
                }
            }
        }
        (below, cells_below) = (above, cells);
    }
    Ok((vertices, quads))
}

/// One round: edges flipped where the two angles that face them exceed a half-turn, then each vertex moved towards the mean
/// of its neighbours, along the surface.
fn even_out(field: &Field<'_>, mesh: &TriangleMesh<'_>) -> Result<TriangleMesh<'static>> {
    let position = |vertex: u32| -> Point {
        let p = mesh.vertex(vertex);
        [p[0], p[1], p[2]]
    };
    let mut glue = Glue::new(mesh.faces(), mesh.vertex_count())?;
    let mut degrees = vec![0u32; mesh.vertex_count()];
    mesh.faces().iter().flatten().for_each(|&corner| degrees[corner as usize] += 1);
    // Several passes: a flip can make its neighbours worth flipping.
    for _ in 0..4 {
        let mut flips = 0;
        for half_edge in 0..3 * mesh.faces().len() as u32 {
            let twin = glue.twin(half_edge);
            if twin < half_edge {
                continue;
            }
            let [a, b, c, d] =
                [glue.tail(half_edge), glue.tail(twin), glue.tail(Glue::previous(half_edge)), glue.tail(Glue::previous(twin))];
            if degrees[a as usize] <= 3 || degrees[b as usize] <= 3 {
                continue;
            }
            let [pa, pb, pc, pd] = [a, b, c, d].map(position);
            let angle = |p: Point, q: Point, r: Point| {
                let (u, v) = (minus(q, p), minus(r, p));
                let w = cross(u, v);
                dot(w, w).sqrt().atan2(dot(u, v))
            };
            if angle(pc, pa, pb) + angle(pd, pb, pa) <= std::f64::consts::PI + 1e-6 {
                continue;
            }
            let (old, one, other) =
                (cross(minus(pb, pa), minus(pc, pa)), cross(minus(pb, pd), minus(pc, pd)), cross(minus(pa, pc), minus(pd, pc)));
            let size = |n: Point| dot(n, n).sqrt();
            let agree = |n: Point| dot(n, old) > 0.5 * size(n) * size(old);
            if !agree(one) || !agree(other) || glue.neighbours(half_edge).any(|neighbour| neighbour == d) {
                continue;
            }
            glue.flip(half_edge);
            degrees[a as usize] -= 1;
            degrees[b as usize] -= 1;
            degrees[c as usize] += 1;
            degrees[d as usize] += 1;
            flips += 1;
        }
        if flips == 0 {
            break;
        }
    }
    let faces = glue.into_faces();
    let mut sums = vec![[0.0; 4]; mesh.vertex_count()];
    for face in &faces {
        for k in 0..3 {
            let (sum, next) = (&mut sums[face[k] as usize], position(face[(k + 1) % 3]));
            for axis in 0..3 {
                sum[axis] += next[axis]; // each neighbour comes once: the surface is closed and oriented
            }
            sum[3] += 1.0;
        }
    }
    let vertices: Vec<Point> = sums
        .par_iter()
        .with_min_len(CHUNK / 16)
        .enumerate()
        .map(|(vertex, &[x, y, z, count])| {
            let here = position(vertex as u32);
            let normal = field.project(here).1;
            let step = minus([x / count, y / count, z / count], here);
            let tangential = along(step, -dot(step, normal), normal);
            field.project(along(here, 0.6, tangential)).0
        })
        .collect();
    TriangleMesh::new(3, vertices.into_flattened(), faces)
}
