//! The painter: which surface, ball or line each sample of each pixel sees, its colour and light, and the mean over samples.

use super::light::{Screen, linear_colour, lit, unit};
use super::strokes::distance_to_segment;
use super::{Balls, Camera, Colouring, Frame, Image, Lines, Projected, Rgb, Scene, Surface, hollows};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::sparse::CHUNK;
use crate::vector::{cross, length};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

const TILE: usize = 32;
const NOTHING: u32 = u32::MAX;
const LAYERS: usize = 5; // of a transparent surface that are seen one behind the other
const CREASE: f32 = 0.6; // cosine of the angle beyond which an edge is sharp

/// Barycentric coordinates of a triangle as affine functions of the place on the screen.
#[derive(Clone, Copy)]
struct Affine {
    origin: [f64; 2],
    x: [f64; 3],
    y: [f64; 3],
}

impl Affine {
    fn new([a, b, c]: [Projected; 3]) -> Option<Self> {
        let (bx, by, cx, cy) = (b.x - a.x, b.y - a.y, c.x - a.x, c.y - a.y);
        let area = bx * cy - by * cx;
        if !(area.abs() > 1e-12) {
            return None; // seen from its edge
        }
        let (x1, x2, y1, y2) = (cy / area, -by / area, -cx / area, bx / area);
        Some(Affine { origin: [a.x, a.y], x: [-x1 - x2, x1, x2], y: [-y1 - y2, y1, y2] })
    }

    fn at(&self, x: f64, y: f64) -> [f64; 3] {
        let (x, y) = (x - self.origin[0], y - self.origin[1]);
        let (b, c) = (self.x[1] * x + self.y[1] * y, self.x[2] * x + self.y[2] * y);
        [1.0 - b - c, b, c]
    }
}

/// What all samples of a face share: its corners, how they look, and the rates at which coordinates change on the screen.
struct Local {
    face: usize,
    vertices: [usize; 3],
    affine: Affine,
    shrink: [f64; 3],
    normals: [[f32; 3]; 3],
    values: [f64; 3],
    known: bool,
    steepness: f64,    // change of the values along a pixel
    heights: [f64; 3], // of the triangle, in pixels
}

struct PreparedSurface<'a> {
    surface: &'a Surface<'a>,
    screen: Vec<Projected>,
    vertex_normals: Vec<[f32; 3]>,
    face_normals: Vec<[f32; 3]>,
    table: Vec<Rgb>,
    missing: Rgb,
    level_colour: Rgb,
    edge_colour: Rgb,
}

struct Ball {
    centre: Projected,
    radius: f64,
    colour: Rgb,
    opacity: f32,
    normal: Option<[f32; 3]>,
}

struct Segment {
    ends: [Projected; 2],
    radius: f64,
    colour: Rgb,
    opacity: f32,
}

struct Prepared<'a> {
    surface: Option<PreparedSurface<'a>>,
    balls: Vec<Ball>,
    segments: Vec<Segment>,
}

/// One sample as it is seen: colour (linear), how much it covers, where it looks and how near it is.
#[derive(Clone, Copy)]
struct Seen {
    colour: Rgb,
    opacity: f32,
    normal: [f32; 3],
}

fn linear4(colour: [f32; 4]) -> (Rgb, f32) {
    (linear_colour([colour[0], colour[1], colour[2]]), colour[3].clamp(0.0, 1.0))
}

fn prepare_surface<'a>(surface: &'a Surface<'a>, camera: &Camera) -> PreparedSurface<'a> {
    let vertex = |corner: u32| {
        let at = 3 * corner as usize;
        [surface.vertices[at], surface.vertices[at + 1], surface.vertices[at + 2]]
    };
    let screen = surface.vertices.par_chunks_exact(3).with_min_len(CHUNK).map(|p| camera.project(p)).collect();
    // Twice the area times the normal of each face, scaled so that squares neither vanish nor overflow.
    let scale = surface.vertices.iter().fold(0.0f64, |most, x| most.max(x.abs())).max(f64::MIN_POSITIVE).recip();
    let vectors: Vec<[f64; 3]> = surface
        .faces
        .par_iter()
        .with_min_len(CHUNK)
        .map(|&[a, b, c]| {
            let (a, b, c) = (vertex(a), vertex(b), vertex(c));
            let edge = |p: [f64; 3]| [(p[0] - a[0]) * scale, (p[1] - a[1]) * scale, (p[2] - a[2]) * scale];
            cross(edge(b), edge(c))
        })
        .collect();
    let mut sums = vec![[0.0f64; 3]; surface.vertices.len() / 3];
    for (face, vector) in surface.faces.iter().zip(&vectors) {
        for &corner in face {
            for axis in 0..3 {
                sums[corner as usize][axis] += vector[axis];
            }
        }
    }
    let direct = |v: &[f64; 3]| {
        let length = length(*v);
        if length > 0.0 { camera.turn(v.map(|x| x / length)).map(|x| x as f32) } else { [0.0; 3] }
    };
    let table = match surface.colouring {
        Colouring::Uniform(colour) => vec![linear_colour(colour)],
        Colouring::Scalars { table, .. } | Colouring::Labels { palette: table, .. } => table.iter().map(|&c| linear_colour(c)).collect(),
        Colouring::Vertices(colours) | Colouring::Faces(colours) => colours.iter().map(|&c| linear4(c).0).collect(),
    };
    PreparedSurface {
        surface,
        screen,
        vertex_normals: sums.par_iter().with_min_len(CHUNK).map(direct).collect(),
        face_normals: vectors.par_iter().with_min_len(CHUNK).map(direct).collect(),
        table,
        missing: linear_colour(surface.missing),
        level_colour: linear4(surface.level_colour).0,
        edge_colour: linear4(surface.edge_colour).0,
    }
}

impl PreparedSurface<'_> {
    fn corners(&self, face: usize) -> [Projected; 3] {
        self.surface.faces[face].map(|corner| self.screen[corner as usize])
    }

    fn look_up(&self, value: f64, low: f64, high: f64) -> Rgb {
        let last = self.table.len() - 1;
        let share = if high > low { ((value - low) / (high - low)).clamp(0.0, 1.0) } else { 0.5 };
        let place = share * last as f64;
        let index = (place as usize).min(last);
        let (a, b, t) = (self.table[index], self.table[(index + 1).min(last)], (place - index as f64) as f32);
        [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])]
    }

    /// What all samples of a face share.
    fn local(&self, face: usize) -> Option<Local> {
        let corners = self.corners(face);
        let affine = Affine::new(corners)?;
        let vertices = self.surface.faces[face].map(|corner| corner as usize);
        let mut flat = self.face_normals[face];
        if flat[2] < 0.0 {
            flat = flat.map(|x| -x);
        }
        let normals = vertices.map(|vertex| {
            let own = self.vertex_normals[vertex];
            let cosine = own[0] * flat[0] + own[1] * flat[1] + own[2] * flat[2];
            match self.surface.smooth && cosine.abs() >= CREASE {
                true if cosine < 0.0 => own.map(|x| -x),
                true => own,
                false => flat,
            }
        });
        let length = |x: f64, y: f64| (x * x + y * y).sqrt();
        let mut values = [0.0; 3];
        let mut steepness = 0.0;
        if let Colouring::Scalars { values: all, .. } = self.surface.colouring {
            values = vertices.map(|vertex| all[vertex]);
            steepness = length((0..3).map(|k| affine.x[k] * values[k]).sum(), (0..3).map(|k| affine.y[k] * values[k]).sum());
        }
        Some(Local {
            face,
            vertices,
            shrink: corners.map(|corner| 1.0 / corner.zoom),
            normals,
            values,
            known: values.iter().all(|v| v.is_finite()),
            steepness,
            heights: [0, 1, 2].map(|k| 1.0 / length(affine.x[k], affine.y[k])),
            affine,
        })
    }

    /// Colour before light. `weights` are barycentric coordinates on the triangle itself, not on the screen.
    fn colour(&self, local: &Local, weights: [f64; 3], samples: f64) -> (Rgb, f32) {
        let corners = local.vertices;
        let mut opacity = 1.0;
        let mut colour = match self.surface.colouring {
            Colouring::Uniform(_) => self.table[0],
            Colouring::Faces(colours) => {
                opacity = colours[local.face][3];
                self.table[local.face]
            }
            Colouring::Vertices(colours) => {
                let mix = |axis: usize| (0..3).map(|k| weights[k] as f32 * self.table[corners[k]][axis]).sum();
                opacity = (0..3).map(|k| weights[k] as f32 * colours[corners[k]][3]).sum();
                [mix(0), mix(1), mix(2)]
            }
            Colouring::Labels { labels, .. } => {
                // A region's share of the triangle is the sum over its corners; the largest share wins.
                let label = corners.map(|corner| labels[corner]);
                let share = |k: usize| (0..3).filter(|&j| label[j] == label[k]).map(|j| weights[j]).sum::<f64>();
                let mut best = 0;
                for k in 1..3 {
                    if share(k) > share(best) {
                        best = k;
                    }
                }
                self.table.get(label[best] as usize).copied().unwrap_or(self.missing)
            }
            Colouring::Scalars { low, high, .. } => {
                let value = local.values;
                let here = (0..3).map(|k| weights[k] * value[k]).sum();
                let mut colour = if local.known {
                    self.look_up(here, low, high)
                } else {
                    let heaviest = (1..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best });
                    if value[heaviest].is_finite() { self.look_up(value[heaviest], low, high) } else { self.missing }
                };
                if !self.surface.levels.is_empty() && local.known {
                    let after = self.surface.levels.partition_point(|&level| level < here);
                    let nearest = [after.checked_sub(1), Some(after)]
                        .into_iter()
                        .flatten()
                        .filter_map(|at| self.surface.levels.get(at))
                        .fold(f64::INFINITY, |least, level| least.min((level - here).abs()));
                    let cover = ((0.5 * self.surface.level_width - nearest / local.steepness) * samples + 0.5).clamp(0.0, 1.0);
                    if cover > 0.0 {
                        blend(&mut colour, self.level_colour, cover as f32 * self.surface.level_colour[3]);
                    }
                }
                colour
            }
        };
        if self.surface.edge_width > 0.0 {
            let distance = (0..3).fold(f64::INFINITY, |least, k| least.min(weights[k] * local.heights[k]));
            let cover = ((0.5 * self.surface.edge_width - distance) * samples + 0.5).clamp(0.0, 1.0);
            blend(&mut colour, self.edge_colour, cover as f32 * self.surface.edge_colour[3]);
        }
        (colour, opacity)
    }

    fn see(&self, local: &Local, x: f64, y: f64, frame: &Frame) -> Seen {
        // On the screen, things divided by distance are linear: undo that.
        let flat = local.affine.at(x, y).map(|b| b.max(0.0));
        let mut weights = [flat[0] * local.shrink[0], flat[1] * local.shrink[1], flat[2] * local.shrink[2]];
        let sum: f64 = weights.iter().sum();
        weights = weights.map(|weight| weight / sum);
        let (mut colour, mut opacity) = self.colour(local, weights, frame.samples as f64);
        let mut normal = [0.0; 3];
        for k in 0..3 {
            for axis in 0..3 {
                normal[axis] += weights[k] as f32 * local.normals[k][axis];
            }
        }
        normal[2] = normal[2].max(0.02); // interpolation may turn it from the eye near the outline
        normal = unit(normal);
        if frame.lit {
            colour = lit(colour, normal);
        }
        if self.surface.transparency > 0.0 {
            // Glass: clear where it faces the eye, denser and darker towards the outline.
            let clear = self.surface.transparency as f32;
            let grazing = (1.0 - normal[2]).powf(1.6);
            opacity *= (1.0 - clear) + clear * 0.85 * grazing;
            colour = colour.map(|c| c * (1.0 - 0.6 * clear * grazing));
        }
        Seen { colour, opacity, normal }
    }

    /// Whether colour and light change so little inside a pixel that one look at a face is enough.
    fn calm(&self) -> bool {
        self.surface.levels.is_empty() && self.surface.edge_width <= 0.0 && !matches!(self.surface.colouring, Colouring::Labels { .. })
    }
}

fn blend(colour: &mut Rgb, other: Rgb, share: f32) {
    for axis in 0..3 {
        colour[axis] += share * (other[axis] - colour[axis]);
    }
}

impl Ball {
    /// Nearness and normal where a place on the screen meets it.
    fn meet(&self, x: f64, y: f64) -> Option<(f64, [f32; 3])> {
        let (dx, dy) = (x - self.centre.x, self.centre.y - y);
        match self.normal {
            None => {
                let square = self.radius * self.radius - dx * dx - dy * dy;
                let height = (square >= 0.0).then(|| square.sqrt())?;
                let normal = [(dx / self.radius) as f32, (dy / self.radius) as f32, (height / self.radius) as f32];
                Some((self.centre.near + height, normal))
            }
            Some(normal) => {
                let steep = f64::from(normal[2]).max(0.2);
                let height = -(f64::from(normal[0]) * dx + f64::from(normal[1]) * dy) / steep;
                (dx * dx + dy * dy + height * height <= self.radius * self.radius).then_some((self.centre.near + height, normal))
            }
        }
    }
}

impl Segment {
    fn meet(&self, x: f64, y: f64) -> Option<(f64, [f32; 3])> {
        let [a, b] = self.ends;
        let (distance, share) = distance_to_segment([x, y], [a.x, a.y], [b.x, b.y]);
        let square = self.radius * self.radius - distance * distance;
        let height = (square >= 0.0).then(|| square.sqrt())?;
        let near = a.near + share * (b.near - a.near);
        let (dx, dy) = (x - a.x - share * (b.x - a.x), a.y + share * (b.y - a.y) - y);
        let normal = [(dx / self.radius) as f32, (dy / self.radius) as f32, (height / self.radius) as f32];
        // A pixel nearer than it is: a line drawn on a surface stays above it.
        Some((near + height + 1.0, normal))
    }
}

fn prepare_balls(balls: &Balls<'_>, camera: &Camera, out: &mut Vec<Ball>) {
    for (at, centre) in balls.centres.chunks_exact(3).enumerate() {
        let centre = camera.project(centre);
        let (colour, opacity) = linear4(balls.colours[at]);
        let normal = balls.normals.get(3 * at..3 * at + 3).map(|n| {
            let turned = camera.turn([n[0], n[1], n[2]]).map(|x| x as f32);
            let turned = unit(turned);
            if turned[2] < 0.0 { turned.map(|x| -x) } else { turned }
        });
        out.push(Ball { radius: (balls.radii[at] * camera.scale * centre.zoom).max(0.0), centre, colour, opacity, normal });
    }
}

fn prepare_lines(lines: &Lines<'_>, camera: &Camera, out: &mut Vec<Segment>) {
    for (at, pair) in lines.starts.windows(2).enumerate() {
        let (colour, opacity) = linear4(lines.colours[at]);
        let radius = (0.5 * lines.widths[at]).max(0.25);
        let places: Vec<Projected> = lines.points[3 * pair[0]..3 * pair[1]].chunks_exact(3).map(|p| camera.project(p)).collect();
        out.extend(places.windows(2).map(|ends| Segment { ends: [ends[0], ends[1]], radius, colour, opacity }));
    }
}

/// For each tile, what may be seen in it; in the order of the scene.
fn bins(boxes: impl Iterator<Item = [f64; 4]>, columns: usize, rows: usize) -> Vec<Vec<u32>> {
    let mut bins = vec![Vec::new(); columns * rows];
    for (index, [left, right, top, bottom]) in boxes.enumerate() {
        let tile = |x: f64, most: usize| (x / TILE as f64).floor().clamp(0.0, most as f64) as usize;
        // One pixel more on each side: samples lie beside the middle of their pixel.
        let (width, height) = ((columns * TILE) as f64, (rows * TILE) as f64);
        if !(right >= -1.0 && left <= width + 1.0 && bottom >= -1.0 && top <= height + 1.0) {
            continue;
        }
        for row in tile(top - 1.0, rows - 1)..=tile(bottom + 1.0, rows - 1) {
            for column in tile(left - 1.0, columns - 1)..=tile(right + 1.0, columns - 1) {
                bins[row * columns + column].push(index as u32);
            }
        }
    }
    bins
}

fn around(places: &[Projected], reach: f64) -> [f64; 4] {
    places.iter().fold([f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY], |b, p| {
        [b[0].min(p.x - reach), b[1].max(p.x + reach), b[2].min(p.y - reach), b[3].max(p.y + reach)]
    })
}

/// A pixel before the last steps: colour (linear, times cover), cover, nearness and normal of what hides the rest.
#[derive(Clone, Copy)]
pub(super) struct Pixel {
    pub colour: Rgb,
    pub cover: f32,
    pub near: f32,
    pub normal: [f32; 3],
}

struct Tile {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

struct Painter<'a> {
    scene: Prepared<'a>,
    frame: &'a Frame,
    offsets: Vec<[f64; 2]>,
}

impl Painter<'_> {
    /// Calls `hit(slot, nearness)` for each sample of the tile inside the face.
    fn scan(&self, tile: &Tile, face: usize, mut hit: impl FnMut(usize, f32)) {
        let Some(surface) = &self.scene.surface else { return };
        let corners = surface.corners(face);
        let Some(affine) = Affine::new(corners) else { return };
        let [left, right, top, bottom] = around(&corners, 1.0);
        let columns = tile.range(left, right, tile.x, tile.width);
        let rows = tile.range(top, bottom, tile.y, tile.height);
        let count = self.offsets.len();
        // The most that a coordinate can grow from the middle of a pixel to one of its samples.
        let slack = [0, 1, 2].map(|k| 0.7 * (affine.x[k].abs() + affine.y[k].abs()) + 1e-9);
        for row in rows {
            for column in columns.clone() {
                let (x, y) = ((tile.x + column) as f64 + 0.5, (tile.y + row) as f64 + 0.5);
                let middle = affine.at(x, y);
                if (0..3).any(|k| middle[k] < -slack[k]) {
                    continue;
                }
                let near: f64 = (0..3).map(|k| middle[k] * corners[k].near).sum();
                for (sample, offset) in self.offsets.iter().enumerate() {
                    let b = middle[1] + affine.x[1] * offset[0] + affine.y[1] * offset[1];
                    let c = middle[2] + affine.x[2] * offset[0] + affine.y[2] * offset[1];
                    let a = 1.0 - b - c;
                    if a >= -1e-9 && b >= -1e-9 && c >= -1e-9 {
                        let shift =
                            (b - middle[1]) * (corners[1].near - corners[0].near) + (c - middle[2]) * (corners[2].near - corners[0].near);
                        hit((row * tile.width + column) * count + sample, (near + shift) as f32);
                    }
                }
            }
        }
    }

    fn paint_tile(&self, tile: &Tile, faces: &[u32], balls: &[u32], segments: &[u32]) -> Vec<Pixel> {
        let count = self.offsets.len();
        let slots = tile.width * tile.height * count;
        let mut near = vec![f32::NEG_INFINITY; slots];
        let mut first = vec![NOTHING; slots];
        let transparent = self.scene.surface.as_ref().is_some_and(|s| s.surface.transparency > 0.0);
        if !transparent {
            for &face in faces {
                self.scan(tile, face as usize, |slot, here| {
                    if here > near[slot] {
                        near[slot] = here;
                        first[slot] = face;
                    }
                });
            }
        }
        // Balls and segments are numbered on from the faces.
        let face_count = self.scene.surface.as_ref().map_or(0, |s| s.surface.faces.len()) as u32;
        let ball_count = self.scene.balls.len() as u32;
        let mut cover = |id: u32, extent: [f64; 4], meet: &dyn Fn(f64, f64) -> Option<(f64, [f32; 3])>| {
            let columns = tile.range(extent[0] - 1.0, extent[1] + 1.0, tile.x, tile.width);
            for row in tile.range(extent[2] - 1.0, extent[3] + 1.0, tile.y, tile.height) {
                for column in columns.clone() {
                    for (sample, offset) in self.offsets.iter().enumerate() {
                        let (x, y) = ((tile.x + column) as f64 + 0.5 + offset[0], (tile.y + row) as f64 + 0.5 + offset[1]);
                        let slot = (row * tile.width + column) * count + sample;
                        if let Some((here, _)) = meet(x, y).filter(|&(here, _)| here as f32 > near[slot]) {
                            near[slot] = here as f32;
                            first[slot] = id;
                        }
                    }
                }
            }
        };
        for &at in balls {
            let ball = &self.scene.balls[at as usize];
            cover(face_count + at, around(&[ball.centre], ball.radius), &|x, y| ball.meet(x, y));
        }
        for &at in segments {
            let segment = &self.scene.segments[at as usize];
            cover(face_count + ball_count + at, around(&segment.ends, segment.radius), &|x, y| segment.meet(x, y));
        }
        let mut layers: Vec<Vec<(f32, u32)>> = Vec::new();
        if transparent {
            // Depth peeling: each layer is the nearest one behind the last, in front of what is solid.
            for layer in 0..LAYERS {
                let mut next = vec![(f32::NEG_INFINITY, NOTHING); slots];
                let mut any = false;
                for &face in faces {
                    self.scan(tile, face as usize, |slot, here| {
                        let behind = layer == 0 || {
                            let last: (f32, u32) = layers[layer - 1][slot];
                            last.1 != NOTHING && (here < last.0 || (here == last.0 && face > last.1))
                        };
                        let best = next[slot];
                        if behind && here > near[slot] && (here > best.0 || (here == best.0 && face < best.1)) {
                            next[slot] = (here, face);
                            any = true;
                        }
                    });
                }
                layers.push(next);
                if !any {
                    break;
                }
            }
        }
        let mut pixels = Vec::with_capacity(tile.width * tile.height);
        let surface = self.scene.surface.as_ref();
        let calm = surface.is_some_and(PreparedSurface::calm) && layers.is_empty();
        // Samples side by side mostly see the same face.
        let mut local: Option<Local> = None;
        let mut look = |face: u32, x: f64, y: f64| -> Option<Seen> {
            let surface = surface?;
            if local.as_ref().is_none_or(|local| local.face != face as usize) {
                local = surface.local(face as usize);
            }
            local.as_ref().map(|local| surface.see(local, x, y, self.frame))
        };
        for place in 0..tile.width * tile.height {
            let (column, row) = (place % tile.width, place / tile.width);
            let mut pixel = Pixel { colour: [0.0; 3], cover: 0.0, near: 0.0, normal: [0.0; 3] };
            let mut solid = 0u32;
            let (middle_x, middle_y) = ((tile.x + column) as f64 + 0.5, (tile.y + row) as f64 + 0.5);
            let mut before: Option<(u32, Seen)> = None;
            for (sample, offset) in self.offsets.iter().enumerate() {
                let slot = place * count + sample;
                let (x, y) = (middle_x + offset[0], middle_y + offset[1]);
                let mut left = 1.0f32;
                let mut add = |seen: Seen| {
                    let share = left * seen.opacity;
                    for axis in 0..3 {
                        pixel.colour[axis] += share * seen.colour[axis];
                    }
                    pixel.cover += share;
                    left -= share;
                };
                for layer in &layers {
                    let (_, face) = layer[slot];
                    if face == NOTHING {
                        break;
                    }
                    if let Some(seen) = look(face, x, y) {
                        add(seen);
                    }
                }
                let id = first[slot];
                let seen = match before {
                    Some((last, seen)) if calm && last == id => Some(seen),
                    _ if id < face_count && calm => look(id, middle_x, middle_y),
                    _ if id < face_count => look(id, x, y),
                    _ => self.see(id, face_count, ball_count, x, y),
                };
                if let Some(seen) = seen {
                    before = (id < face_count).then_some((id, seen));
                    add(seen);
                    pixel.near += near[slot];
                    for axis in 0..3 {
                        pixel.normal[axis] += seen.normal[axis];
                    }
                    solid += 1;
                }
            }
            let share = 1.0 / count as f32;
            pixel.colour = pixel.colour.map(|c| c * share);
            pixel.cover *= share;
            pixel.near = if solid == 0 { f32::NEG_INFINITY } else { pixel.near / solid as f32 };
            pixel.normal = unit(pixel.normal);
            pixels.push(pixel);
        }
        pixels
    }

    /// A ball or a line.
    fn see(&self, id: u32, face_count: u32, ball_count: u32, x: f64, y: f64) -> Option<Seen> {
        if id == NOTHING {
            return None;
        }
        let id = id - face_count;
        let (colour, opacity, normal) = if id < ball_count {
            let ball = &self.scene.balls[id as usize];
            (ball.colour, ball.opacity, ball.meet(x, y)?.1)
        } else {
            let segment = &self.scene.segments[(id - ball_count) as usize];
            let normal = segment.meet(x, y)?.1;
            // Thin lines are ink, thick ones are tubes.
            (segment.colour, segment.opacity, if segment.radius < 2.0 { [0.0, 0.0, 1.0] } else { normal })
        };
        let ink = id >= ball_count && self.scene.segments[(id - ball_count) as usize].radius < 2.0;
        Some(Seen { colour: if self.frame.lit && !ink { lit(colour, normal) } else { colour }, opacity, normal })
    }
}

impl Tile {
    fn range(&self, from: f64, to: f64, start: usize, length: usize) -> std::ops::Range<usize> {
        let clip = |x: f64| (x - start as f64).clamp(0.0, length as f64) as usize;
        clip(from.floor())..clip(to.ceil())
    }
}

/// Paints a scene.
///
/// ```
/// use beltrami::{Control, view::{Camera, Colouring, Frame, Scene, Surface, paint}};
/// let surface = Surface {
///     vertices: &[-1.0, -1.0, 0.0, 1.0, -1.0, 0.0, 0.0, 1.0, 0.0],
///     faces: &[[0, 1, 2]],
///     colouring: Colouring::Uniform([1.0, 0.0, 0.0]),
///     missing: [0.8; 3],
///     levels: &[],
///     level_colour: [0.0; 4],
///     level_width: 0.0,
///     edge_colour: [0.0; 4],
///     edge_width: 0.0,
///     transparency: 0.0,
///     smooth: true,
/// };
/// let camera = Camera {
///     axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
///     centre: [0.0; 3],
///     middle: [20.0, 20.0],
///     scale: 15.0,
///     distance: f64::INFINITY,
/// };
/// let frame = Frame { width: 40, height: 40, lit: false, ..Frame::default() };
/// let image = paint(&Scene { surface: Some(surface), ..Scene::default() }, &camera, &frame, &Control::default())?;
/// assert_eq!(image.pixel(20, 20), Some([255, 0, 0]));
/// assert_eq!(image.pixel(0, 0), Some([255, 255, 255]));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if the frame is empty or has more than 2^28 pixels, a coordinate or the camera is not finite, or arrays
/// do not fit each other; [`Error::Cancelled`].
pub fn paint(scene: &Scene<'_>, camera: &Camera, frame: &Frame, control: &Control) -> Result<Image> {
    scene.check()?;
    let (width, height) = (frame.width, frame.height);
    if width == 0 || height == 0 || width.saturating_mul(height) > 1 << 28 || !(1..=8).contains(&frame.samples) {
        return Err(Error::input(format!("a picture of {width} x {height} pixels with {0} x {0} samples each", frame.samples)));
    }
    let numbers = camera.axes.iter().flatten().chain(&camera.centre).chain(&camera.middle);
    if !numbers.chain([&camera.scale]).all(|x| x.is_finite()) || !(camera.scale > 0.0) || !(camera.distance > 0.0) {
        return Err(Error::input("the camera needs finite numbers, a positive scale and a positive distance"));
    }
    let mut prepared =
        Prepared { surface: scene.surface.as_ref().map(|s| prepare_surface(s, camera)), balls: Vec::new(), segments: Vec::new() };
    for balls in &scene.balls {
        prepare_balls(balls, camera, &mut prepared.balls);
    }
    if let Some(lines) = &scene.lines {
        prepare_lines(lines, camera, &mut prepared.segments);
    }
    control.report(0.1)?;
    let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
    let faces = match &prepared.surface {
        Some(surface) => bins((0..surface.surface.faces.len()).map(|face| around(&surface.corners(face), 0.0)), columns, rows),
        None => vec![Vec::new(); columns * rows],
    };
    let balls = bins(prepared.balls.iter().map(|ball| around(&[ball.centre], ball.radius)), columns, rows);
    let segments = bins(prepared.segments.iter().map(|segment| around(&segment.ends, segment.radius)), columns, rows);
    let (side, slant) = (frame.samples as f64, (frame.samples * frame.samples) as f64);
    // A grid turned a little, so that no two samples of a pixel share a row or a column: edges of any direction come out smooth.
    let offsets = (0..frame.samples * frame.samples)
        .map(|at| {
            let (i, j) = ((at % frame.samples) as f64 + 0.5 - 0.5 * side, (at / frame.samples) as f64 + 0.5 - 0.5 * side);
            [i / side + j / slant, j / side - i / slant]
        })
        .collect();
    let painter = Painter { scene: prepared, frame, offsets };
    let done = AtomicUsize::new(0);
    let tiles: Vec<(Tile, Vec<Pixel>)> = (0..columns * rows)
        .into_par_iter()
        .map(|at| {
            let (x, y) = (at % columns * TILE, at / columns * TILE);
            let tile = Tile { x, y, width: TILE.min(width - x), height: TILE.min(height - y) };
            let pixels = painter.paint_tile(&tile, &faces[at], &balls[at], &segments[at]);
            control.report(0.1 + 0.6 * (done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / (columns * rows) as f64)?;
            Ok((tile, pixels))
        })
        .collect::<Result<_>>()?;
    let mut pixels = vec![Pixel { colour: [0.0; 3], cover: 0.0, near: f32::NEG_INFINITY, normal: [0.0; 3] }; width * height];
    for (tile, painted) in tiles {
        for (row, line) in painted.chunks_exact(tile.width).enumerate() {
            let at = (tile.y + row) * width + tile.x;
            pixels[at..at + tile.width].copy_from_slice(line);
        }
    }
    let open = if frame.hollows > 0.0 && frame.lit {
        hollows::openness(&pixels, width, height, frame.hollows * camera.scale, control)?
    } else {
        Vec::new()
    };
    let screen = Screen::new();
    let background = linear_colour(frame.background);
    let mut bytes = vec![0u8; 3 * width * height];
    bytes.par_chunks_mut(3 * width).enumerate().for_each(|(y, row)| {
        for (x, out) in row.chunks_exact_mut(3).enumerate() {
            let pixel = &pixels[y * width + x];
            let light = open.get(y * width + x).copied().unwrap_or(1.0);
            for axis in 0..3 {
                out[axis] = screen.byte(pixel.colour[axis].min(pixel.cover) * light + (1.0 - pixel.cover) * background[axis]);
            }
        }
    });
    control.report(1.0)?;
    Ok(Image { width, height, pixels: bytes })
}
