//! Exact makers: well-known surfaces at any resolution. Vertices lie on the surface to rounding, none is there twice, and
//! faces of closed surfaces are oriented outward.

use crate::control::Control;
use crate::error::{Error, Result};
use crate::shape::TriangleMesh;
use crate::shape::implicit::{Curve, tube_union};
use crate::sparse::CHUNK;
use crate::vector::{cross, length};
use rayon::prelude::*;
use std::f64::consts::TAU;

const MOST: usize = 1 << 27; // vertices; more would not fit into the memory of an ordinary machine

fn positive(value: f64, name: &str) -> Result<f64> {
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(Error::input(format!("{name} is {value}; it must be a positive number"))) }
}

fn at_least(value: usize, least: usize, name: &str) -> Result<usize> {
    if (least..=MOST).contains(&value) {
        Ok(value)
    } else {
        Err(Error::input(format!("{name} is {value}; it must be from {least} to {MOST}")))
    }
}

fn affordable(count: Option<usize>) -> Result<usize> {
    count.filter(|&count| count <= MOST).ok_or_else(|| {
        Error::input(format!(
            "the surface would have {} vertices; at most {MOST} are made",
            count.map_or("too many".into(), |n| n.to_string())
        ))
    })
}

fn mesh<const D: usize>(vertices: Vec<[f64; D]>, faces: Vec<[u32; 3]>) -> Result<TriangleMesh<'static>> {
    TriangleMesh::new(D, vertices.into_flattened(), faces)
}

/// Two triangles a cell of a table of vertices, `rows` x `columns`, closed up in a direction where asked; `alternate` turns
/// the diagonal of every other cell.
fn table_faces(rows: usize, columns: usize, wrap: [bool; 2], alternate: bool) -> Vec<[u32; 3]> {
    let cells = [rows - usize::from(!wrap[0]), columns - usize::from(!wrap[1])];
    (0..cells[0] * cells[1])
        .into_par_iter()
        .with_min_len(CHUNK)
        .flat_map_iter(|cell| {
            let (i, j) = (cell / cells[1], cell % cells[1]);
            let at = |i: usize, j: usize| ((i % rows) * columns + j % columns) as u32;
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            if alternate && (i + j) % 2 == 1 { [[a, b, d], [b, c, d]] } else { [[a, b, c], [a, c, d]] }
        })
        .collect()
}

fn table_vertices<const D: usize>(rows: usize, columns: usize, position: impl Fn(usize, usize) -> [f64; D] + Sync) -> Vec<[f64; D]> {
    (0..rows * columns).into_par_iter().with_min_len(CHUNK).map(|index| position(index / columns, index % columns)).collect()
}

/// cos and sin of a share of the whole turn, exact at its quarters.
fn turn(step: usize, steps: usize) -> [f64; 2] {
    let (step, quarter) = (4 * (step % steps), 4 * (step % steps) / steps);
    let angle = (step - quarter * steps) as f64 / steps as f64 * (TAU / 4.0);
    let (sin, cos) = angle.sin_cos();
    match quarter {
        0 => [cos, sin],
        1 => [-sin, cos],
        2 => [-cos, -sin],
        _ => [sin, -cos],
    }
}

fn scaled(a: [f64; 3], factor: f64) -> [f64; 3] {
    a.map(|x| x * factor)
}

const ICOSAHEDRON: [[u32; 3]; 20] = [
    [0, 11, 5],
    [0, 5, 1],
    [0, 1, 7],
    [0, 7, 10],
    [0, 10, 11],
    [1, 5, 9],
    [5, 11, 4],
    [11, 10, 2],
    [10, 7, 6],
    [7, 1, 8],
    [3, 9, 4],
    [3, 4, 2],
    [3, 2, 6],
    [3, 6, 8],
    [3, 8, 9],
    [4, 9, 5],
    [2, 4, 11],
    [6, 2, 10],
    [8, 6, 7],
    [9, 8, 1],
];

/// A sphere around the origin: the icosahedron, each edge cut into `frequency` equal arcs; 10 frequency^2 + 2 vertices.
///
/// ```
/// let sphere = beltrami::shape::make::sphere(16, 1.0)?;
/// assert_eq!(sphere.vertex_count(), 10 * 16 * 16 + 2);
/// assert!((sphere.area() - 4.0 * std::f64::consts::PI).abs() < 0.05);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if `frequency` is 0 or beyond what memory holds, or `radius` is not positive.
pub fn sphere(frequency: usize, radius: f64) -> Result<TriangleMesh<'static>> {
    let radius = positive(radius, "radius")?;
    ellipsoid_of(frequency, [radius; 3])
}

/// An ellipsoid around the origin, with these semi-axes along x, y and z: the points of [`sphere`], scaled.
///
/// ```
/// let egg = beltrami::shape::make::ellipsoid(8, [1.0, 0.75, 0.5])?;
/// assert_eq!(egg.vertex_count(), 642);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] as for [`sphere`].
pub fn ellipsoid(frequency: usize, semi_axes: [f64; 3]) -> Result<TriangleMesh<'static>> {
    for axis in semi_axes {
        positive(axis, "a semi-axis")?;
    }
    ellipsoid_of(frequency, semi_axes)
}

fn ellipsoid_of(frequency: usize, semi_axes: [f64; 3]) -> Result<TriangleMesh<'static>> {
    let f = at_least(frequency, 1, "frequency")?;
    let count = affordable(f.checked_mul(f).and_then(|square| square.checked_mul(10)).map(|ten| ten + 2))?;
    let t = (1.0 + 5f64.sqrt()) / 2.0;
    let (small, large) = (1.0 / (1.0 + t * t).sqrt(), t / (1.0 + t * t).sqrt());
    let corners: [[f64; 3]; 12] = [
        [-small, large, 0.0],
        [small, large, 0.0],
        [-small, -large, 0.0],
        [small, -large, 0.0],
        [0.0, -small, large],
        [0.0, small, large],
        [0.0, -small, -large],
        [0.0, small, -large],
        [large, 0.0, -small],
        [large, 0.0, small],
        [-large, 0.0, -small],
        [-large, 0.0, small],
    ];
    let mut edges: Vec<[u32; 2]> =
        ICOSAHEDRON.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).filter(|edge| edge[0] < edge[1]).collect();
    edges.sort_unstable();
    // Weights that cut the edges into equal arcs; inside a face they stay nearly uniform.
    let arc = (1.0 / 5f64.sqrt()).acos();
    let share = |step: usize| (step as f64 / f as f64 * arc).sin();
    let point = |named: &[(u32, usize)]| {
        let mut sum = [0.0; 3];
        for &(corner, step) in named {
            for (sum, x) in sum.iter_mut().zip(corners[corner as usize]) {
                *sum += share(step) * x;
            }
        }
        let length = length(sum);
        std::array::from_fn(|axis| sum[axis] / length * semi_axes[axis])
    };
    let mut vertices = Vec::with_capacity(count);
    vertices.extend((0..12).map(|corner| point(&[(corner, f)])));
    for [a, b] in &edges {
        vertices.extend((1..f).map(|step| point(&[(*a, f - step), (*b, step)])));
    }
    let inside: Vec<Vec<[f64; 3]>> = ICOSAHEDRON
        .par_iter()
        .map(|&[a, b, c]| {
            (1..f).flat_map(|i| (1..f - i).map(move |j| (i, j))).map(|(i, j)| point(&[(a, f - i - j), (b, i), (c, j)])).collect()
        })
        .collect();
    vertices.extend(inside.into_iter().flatten());
    let mut faces = Vec::with_capacity(20 * f * f);
    for (number, &[a, b, c]) in ICOSAHEDRON.iter().enumerate() {
        let along = |from: u32, to: u32, step: usize| {
            let place = edges.binary_search(&[from.min(to), from.max(to)]).unwrap_or_default();
            12 + place * (f - 1) + if from < to { step } else { f - step } - 1
        };
        let first = 12 + edges.len() * (f - 1) + number * (f - 1) * f.saturating_sub(2) / 2;
        let at = |i: usize, j: usize| {
            let index = match (i, j, f - i - j) {
                (0, 0, _) => a as usize,
                (_, 0, 0) => b as usize,
                (0, _, 0) => c as usize,
                (i, 0, _) => along(a, b, i),
                (0, j, _) => along(a, c, j),
                (_, j, 0) => along(b, c, j),
                (i, j, _) => first + (i - 1) * (f - 1) - i * (i - 1) / 2 + j - 1,
            };
            index as u32
        };
        for i in 0..f {
            for j in 0..f - i {
                faces.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
                if i + j + 1 < f {
                    faces.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                }
            }
        }
    }
    mesh(vertices, faces)
}

/// A torus of revolution around the z axis: `rows` circles of `columns` vertices each.
///
/// ```
/// let torus = beltrami::shape::make::torus(1.0, 0.4, 60, 24)?;
/// assert_eq!(beltrami::shape::Topology::new(&torus)?.genus()?, 1);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] unless 0 < `minor_radius` < `major_radius` and `rows` and `columns` are 3 or more.
pub fn torus(major_radius: f64, minor_radius: f64, rows: usize, columns: usize) -> Result<TriangleMesh<'static>> {
    let (big, small) = (positive(major_radius, "major_radius")?, positive(minor_radius, "minor_radius")?);
    if small >= big {
        return Err(Error::input(format!("minor_radius is {small}, major_radius is {big}; the tube must be thinner than the hole's ring")));
    }
    let (rows, columns) = (at_least(rows, 3, "rows")?, at_least(columns, 3, "columns")?);
    affordable(rows.checked_mul(columns))?;
    let vertices = table_vertices(rows, columns, |i, j| {
        let ([x, y], [out, up]) = (turn(i, rows), turn(j, columns));
        let ring = big + small * out;
        [ring * x, ring * y, small * up]
    });
    mesh(vertices, table_faces(rows, columns, [true; 2], false))
}

/// The flat (Clifford) torus in R^4: (a cos u, a sin u, b cos v, b sin v). Its area is close to 4 pi^2 a b, and its
/// eigenvalues to p^2 / a^2 + q^2 / b^2.
///
/// ```
/// let torus = beltrami::shape::make::flat_torus(1.0, 1.0, 40, 40)?;
/// assert_eq!((torus.dimension(), torus.vertex_count()), (4, 1600));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if a radius is not positive or `rows` or `columns` is less than 3.
pub fn flat_torus(first_radius: f64, second_radius: f64, rows: usize, columns: usize) -> Result<TriangleMesh<'static>> {
    let (a, b) = (positive(first_radius, "first_radius")?, positive(second_radius, "second_radius")?);
    let (rows, columns) = (at_least(rows, 3, "rows")?, at_least(columns, 3, "columns")?);
    affordable(rows.checked_mul(columns))?;
    let vertices = table_vertices(rows, columns, |i, j| {
        let ([x, y], [z, w]) = (turn(i, rows), turn(j, columns));
        [a * x, a * y, b * z, b * w]
    });
    mesh(vertices, table_faces(rows, columns, [true; 2], false))
}

/// A flat rectangle [0, width] x [0, height] in R^3 (z = 0): `rows` x `columns` vertices, rows along x; the diagonals alternate.
///
/// ```
/// let sheet = beltrami::shape::make::grid(1.0, 2.0, 11, 21)?;
/// assert!((sheet.area() - 2.0).abs() < 1e-12);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if a length is not positive or `rows` or `columns` is less than 2.
pub fn grid(width: f64, height: f64, rows: usize, columns: usize) -> Result<TriangleMesh<'static>> {
    let (width, height) = (positive(width, "width")?, positive(height, "height")?);
    let (rows, columns) = (at_least(rows, 2, "rows")?, at_least(columns, 2, "columns")?);
    affordable(rows.checked_mul(columns))?;
    let vertices =
        table_vertices(rows, columns, |i, j| [width * (i as f64 / (rows - 1) as f64), height * (j as f64 / (columns - 1) as f64), 0.0]);
    mesh(vertices, table_faces(rows, columns, [false; 2], true))
}

/// A cylinder around the z axis, from z = -height / 2 to height / 2: `rows` circles of `columns` vertices; open at both
/// ends, or closed by flat discs.
///
/// ```
/// use beltrami::shape::{Topology, make};
/// assert_eq!(Topology::new(&make::cylinder(0.5, 2.0, 20, 32, false)?)?.boundary_loops().len(), 2);
/// assert!(Topology::new(&make::cylinder(0.5, 2.0, 20, 32, true)?)?.is_closed());
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if a length is not positive, `rows` is less than 2 or `columns` less than 3.
pub fn cylinder(radius: f64, height: f64, rows: usize, columns: usize, closed: bool) -> Result<TriangleMesh<'static>> {
    let (radius, height) = (positive(radius, "radius")?, positive(height, "height")?);
    let (rows, columns) = (at_least(rows, 2, "rows")?, at_least(columns, 3, "columns")?);
    let rings = if closed { columns.div_ceil(6) } else { 0 }; // inner ones of a cap have spacing as the rim's
    affordable(rows.checked_mul(columns).and_then(|side| rings.checked_mul(columns).and_then(|cap| side.checked_add(2 * cap))))?;
    let level = |i: usize| height * (i as f64 / (rows - 1) as f64 - 0.5);
    let mut vertices = table_vertices(rows, columns, |i, j| {
        let [x, y] = turn(j, columns);
        [radius * x, radius * y, level(i)]
    });
    let mut faces: Vec<[u32; 3]> = table_faces(rows, columns, [false, true], true).into_iter().map(|[a, b, c]| [a, c, b]).collect();
    for (row, up) in [(0, false), (rows - 1, true)].into_iter().filter(|_| closed) {
        let mut outer: Vec<u32> = (0..columns).map(|j| (row * columns + j) as u32).collect();
        for ring in (0..rings).rev() {
            let count = if ring == 0 { 1 } else { (columns * ring).div_ceil(rings).max(3) };
            let first = vertices.len() as u32;
            let share = radius * (ring as f64 / rings as f64);
            vertices.extend((0..count).map(|j| {
                let [x, y] = turn(j, count);
                [share * x, share * y, level(row)]
            }));
            let inner: Vec<u32> = (first..first + count as u32).collect();
            let band = band_faces(&inner, &outer);
            faces.extend(band.into_iter().map(|[a, b, c]| if up { [a, b, c] } else { [a, c, b] }));
            outer = inner;
        }
    }
    mesh(vertices, faces)
}

/// Triangles between two circles of vertices that start at angle 0 and run counterclockwise, oriented counterclockwise; the
/// inner one may be a single point.
fn band_faces(inner: &[u32], outer: &[u32]) -> Vec<[u32; 3]> {
    let (p, q) = (if inner.len() == 1 { 0 } else { inner.len() }, outer.len());
    let mut faces = Vec::with_capacity(p + q);
    let (mut i, mut j) = (0, 0);
    while i < p || j < q {
        // go on along the circle whose next vertex comes first, (j + 1) / q against (i + 1) / p
        let (a, b) = (inner[i % inner.len()], outer[j % q]);
        if j < q && (i == p || (2 * j + 1) * p <= (2 * i + 1) * q) {
            faces.push([a, b, outer[(j + 1) % q]]);
            j += 1;
        } else {
            faces.push([a, b, inner[(i + 1) % p]]);
            i += 1;
        }
    }
    faces
}

/// A flat disc around the origin of R^3 (z = 0): a centre and `rings` circles, the k-th of 6 k vertices.
///
/// ```
/// let disc = beltrami::shape::make::disc(1.0, 10)?;
/// assert_eq!(disc.vertex_count(), 1 + 3 * 10 * 11);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if `radius` is not positive or `rings` is 0.
pub fn disc(radius: f64, rings: usize) -> Result<TriangleMesh<'static>> {
    let (radius, rings) = (positive(radius, "radius")?, at_least(rings, 1, "rings")?);
    affordable(rings.checked_mul(rings + 1).and_then(|product| product.checked_mul(3)).map(|outer| outer + 1))?;
    let mut vertices = vec![[0.0; 3]];
    let mut faces = Vec::with_capacity(6 * rings * rings);
    let mut inner = vec![0];
    for ring in 1..=rings {
        let first = vertices.len() as u32;
        let share = radius * (ring as f64 / rings as f64);
        vertices.extend((0..6 * ring).map(|j| {
            let [x, y] = turn(j, 6 * ring);
            [share * x, share * y, 0.0]
        }));
        let outer: Vec<u32> = (first..first + 6 * ring as u32).collect();
        faces.extend(band_faces(&inner, &outer));
        inner = outer;
    }
    mesh(vertices, faces)
}

/// A tube around the torus knot that runs `p` times around the axis and `q` times around the ring of a torus of revolution;
/// `rows` circles of `columns` vertices, at equal lengths of arc.
///
/// ```
/// let trefoil = beltrami::shape::make::knot(2, 3, [1.0, 0.45, 0.15], 200, 16)?;
/// assert_eq!(beltrami::shape::Topology::new(&trefoil)?.genus()?, 1);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// `radii`: of the torus (major, minor) and of the tube.
///
/// # Errors
/// [`Error::Input`] if `p` and `q` are 0 or have a common divisor, a radius is not positive, the minor radius is not below the
/// major one, or the tube is so thick that it would meet itself.
pub fn knot(p: usize, q: usize, radii: [f64; 3], rows: usize, columns: usize) -> Result<TriangleMesh<'static>> {
    let names = ["major_radius", "minor_radius", "tube_radius"];
    for (radius, name) in radii.into_iter().zip(names) {
        positive(radius, name)?;
    }
    let [big, small, tube] = radii;
    if small >= big {
        return Err(Error::input(format!("minor_radius is {small}, major_radius is {big}; the minor one must be less")));
    }
    let divisor = {
        let (mut a, mut b) = (p, q);
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    if p == 0 || q == 0 || divisor != 1 || p > 1000 || q > 1000 {
        return Err(Error::input(format!("p is {p} and q is {q}; a knot needs whole numbers from 1 to 1000 without a common divisor")));
    }
    let (rows, columns) = (at_least(rows, 3, "rows")?, at_least(columns, 3, "columns")?);
    affordable(rows.checked_mul(columns))?;
    let (around, ring) = (p as f64, q as f64);
    // position, velocity, acceleration and the torus's normal there
    let curve = |t: f64| -> [[f64; 3]; 4] {
        let ((sp, cp), (sq, cq)) = ((around * t).sin_cos(), (ring * t).sin_cos());
        let (rho, slope, bend) = (big + small * cq, -small * ring * sq, -small * ring * ring * cq);
        [
            [rho * cp, rho * sp, small * sq],
            [slope * cp - rho * around * sp, slope * sp + rho * around * cp, small * ring * cq],
            [
                (bend - rho * around * around) * cp - 2.0 * slope * around * sp,
                (bend - rho * around * around) * sp + 2.0 * slope * around * cp,
                -small * ring * ring * sq,
            ],
            [cq * cp, cq * sp, sq],
        ]
    };
    let samples = 200 * (p + q);
    let places: Vec<[[f64; 3]; 4]> = (0..samples).into_par_iter().map(|k| curve(TAU * k as f64 / samples as f64)).collect();
    let sharpest = places.iter().map(|[_, v, a, _]| length(cross(*v, *a)) / length(*v).powi(3)).fold(0.0, f64::max);
    if tube * sharpest >= 1.0 {
        return Err(Error::input(format!(
            "tube_radius is {tube}, the knot's least radius of curvature is {}; the tube would fold",
            1.0 / sharpest
        )));
    }
    // lengths of arc by the trapezoid rule, which converges exponentially on a closed smooth curve
    let mut lengths = vec![0.0; samples + 1];
    for k in 0..samples {
        lengths[k + 1] = lengths[k] + 0.5 * (length(places[k][1]) + length(places[(k + 1) % samples][1])) * TAU / samples as f64;
    }
    let total = lengths[samples];
    let stride = (samples / 800).max(1);
    let thick = (0..samples).step_by(stride).collect::<Vec<_>>().into_par_iter().find_map_first(|k| {
        (0..k).step_by(stride).find_map(|l| {
            let apart = (lengths[k] - lengths[l]).min(total - lengths[k] + lengths[l]);
            let [one, other] = [places[k][0], places[l][0]];
            let gap = length([one[0] - other[0], one[1] - other[1], one[2] - other[2]]);
            (apart > std::f64::consts::PI * tube && gap < 2.0 * tube).then_some(gap)
        })
    });
    if let Some(gap) = thick {
        return Err(Error::input(format!(
            "tube_radius is {tube}, but strands of the knot come as near as {gap}; the tube would meet itself"
        )));
    }
    let frames: Vec<[[f64; 3]; 3]> = (0..rows)
        .map(|row| {
            let wanted = total * row as f64 / rows as f64;
            let k = lengths.partition_point(|&length| length <= wanted).clamp(1, samples) - 1;
            let t = (k as f64 + (wanted - lengths[k]) / (lengths[k + 1] - lengths[k])) * TAU / samples as f64;
            let [place, velocity, _, normal] = curve(t);
            let along = scaled(velocity, 1.0 / length(velocity));
            [place, normal, cross(along, normal)]
        })
        .collect();
    let vertices: Vec<[f64; 3]> = table_vertices(rows, columns, |i, j| {
        let ([place, normal, side], [c, s]) = (frames[i], turn(j, columns));
        std::array::from_fn(|axis| place[axis] + tube * (c * normal[axis] + s * side[axis]))
    });
    mesh(vertices, table_faces(rows, columns, [true; 2], false).into_iter().map(|[a, b, c]| [a, c, b]).collect())
}

/// Several tori of revolution with their centres on the x axis, joined smoothly.
fn tori(count: usize, spacing: f64, radii: [f64; 2], resolution: usize, control: &Control) -> Result<TriangleMesh<'static>> {
    let (big, tube) = (positive(radii[0], "ring_radius")?, positive(radii[1], "tube_radius")?);
    if tube > 0.7 * big {
        return Err(Error::input(format!(
            "tube_radius is {tube}, ring_radius is {big}; the tube may have 0.7 of the ring's radius, or the holes would close"
        )));
    }
    let circles: Vec<Curve> =
        (0..count).map(|k| Curve::Circle { center: [spacing * (k as f64 - 0.5 * (count - 1) as f64), 0.0, 0.0], radius: big }).collect();
    tube_union(&circles, tube, resolution, count, control)
}

/// A thick figure eight: tubes around two circles of radius `radii[0]` that touch, joined smoothly; genus 2. `radii[1]` is
/// the tube's radius, `resolution` the number of cells across the tube.
///
/// ```
/// use beltrami::{Control, shape::{Topology, make}};
/// let eight = make::figure_eight([1.0, 0.35], 8, &Control::default())?;
/// assert_eq!(Topology::new(&eight)?.genus()?, 2);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if a radius is not positive, the tube is thicker than 0.7 ring radii, or `resolution` is below 6 or beyond
/// what memory holds.
pub fn figure_eight(radii: [f64; 2], resolution: usize, control: &Control) -> Result<TriangleMesh<'static>> {
    tori(2, 2.0 * radii[0], radii, resolution, control)
}

/// Two tori side by side, joined smoothly; genus 2. Arguments and errors as for [`figure_eight`].
///
/// ```
/// use beltrami::{Control, shape::{Topology, make}};
/// let surface = make::double_torus([1.0, 0.35], 8, &Control::default())?;
/// assert_eq!(Topology::new(&surface)?.genus()?, 2);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// Those of [`figure_eight`].
pub fn double_torus(radii: [f64; 2], resolution: usize, control: &Control) -> Result<TriangleMesh<'static>> {
    tori(2, 2.0 * radii[0] + 1.2 * radii[1], radii, resolution, control)
}

/// Three tori in a row, joined smoothly; genus 3. Arguments and errors as for [`figure_eight`].
///
/// ```
/// use beltrami::{Control, shape::{Topology, make}};
/// let surface = make::triple_torus([1.0, 0.35], 8, &Control::default())?;
/// assert_eq!(Topology::new(&surface)?.genus()?, 3);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// Those of [`figure_eight`].
pub fn triple_torus(radii: [f64; 2], resolution: usize, control: &Control) -> Result<TriangleMesh<'static>> {
    tori(3, 2.0 * radii[0] + 1.2 * radii[1], radii, resolution, control)
}

/// `arms` tubes with round ends that meet at the origin, at equal angles in the plane z = 0, joined smoothly; genus 0. Three
/// arms make a Y, five a star. `resolution` is the number of cells across a tube.
///
/// ```
/// use beltrami::{Control, shape::{Topology, make}};
/// let y = make::star(3, 1.0, 0.2, 8, &Control::default())?;
/// assert_eq!(Topology::new(&y)?.genus()?, 0);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if `arms` is not from 2 to 100, `arm_length` or `tube_radius` is not positive, the tube is thicker than half
/// the arm's length, or `resolution` is below 6 or beyond what memory holds.
pub fn star(arms: usize, arm_length: f64, tube_radius: f64, resolution: usize, control: &Control) -> Result<TriangleMesh<'static>> {
    let (length, tube) = (positive(arm_length, "arm_length")?, positive(tube_radius, "tube_radius")?);
    if !(2..=100).contains(&arms) {
        return Err(Error::input(format!("arms is {arms}; it must be from 2 to 100")));
    }
    if tube > 0.5 * length {
        return Err(Error::input(format!("tube_radius is {tube}, arm_length is {length}; a tube may be half as thick as its arm is long")));
    }
    let segments: Vec<Curve> = (0..arms)
        .map(|k| {
            let [x, y] = turn((4 * k + arms) % (4 * arms), 4 * arms); // the first arm points along y
            Curve::Segment { start: [0.0; 3], end: [length * x, length * y, 0.0] }
        })
        .collect();
    tube_union(&segments, tube, resolution, 0, control)
}
