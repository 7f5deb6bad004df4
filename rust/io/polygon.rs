//! Polygons into triangles.

use super::source::Parsed;
use crate::control::Control;
use crate::vector::{cross, dot};

// Clipping takes time quadratic in the number of reflex corners; polygons beyond this are cut as a fan.
const MOST_CORNERS: usize = 2048;

/// Faces as they are read: triangles, until the first polygon of another size comes.
#[derive(Default)]
pub(super) struct Faces {
    triangles: Vec<[u32; 3]>,
    corners: Vec<u32>,
    ends: Vec<usize>,
    mixed: bool,
}

impl Faces {
    pub(super) fn with_room(count: usize) -> Parsed<Self> {
        Ok(Faces { triangles: super::source::reserved(count)?, ..Faces::default() })
    }

    #[inline]
    pub(super) fn triangle(&mut self, corners: [u32; 3]) {
        if self.mixed {
            self.polygon(&corners);
        } else {
            self.triangles.push(corners);
        }
    }

    pub(super) fn polygon(&mut self, corners: &[u32]) {
        if let (&[a, b, c], false) = (corners, self.mixed) {
            self.triangles.push([a, b, c]);
            return;
        }
        if !self.mixed {
            self.mixed = true;
            self.ends = (1..=self.triangles.len()).map(|face| 3 * face).collect();
            self.corners = std::mem::take(&mut self.triangles).into_flattened();
        }
        self.corners.extend_from_slice(corners);
        self.ends.push(self.corners.len());
    }

    pub(super) fn count(&self) -> usize {
        if self.mixed { self.ends.len() } else { self.triangles.len() }
    }

    /// The first face with a corner that is not below `count`, and that corner.
    pub(super) fn outside(&self, count: usize) -> Option<(usize, u32)> {
        let outside = |corners: &[u32]| corners.iter().copied().find(|&corner| corner as usize >= count);
        if self.mixed {
            let mut start = 0;
            self.ends.iter().enumerate().find_map(|(face, &end)| {
                let corners = &self.corners[start..end];
                start = end;
                outside(corners).map(|corner| (face, corner))
            })
        } else {
            self.triangles.iter().enumerate().find_map(|(face, corners)| outside(corners).map(|corner| (face, corner)))
        }
    }

    /// Numbers of the corners, face after face.
    pub(super) fn all_corners(&self) -> &[u32] {
        if self.mixed { &self.corners } else { self.triangles.as_flattened() }
    }

    /// Triangles, n - 2 for a polygon of n corners, none for less than 3, in the order of the faces.
    ///
    /// All corners must be below the number of vertices.
    pub(super) fn into_triangles(self, vertices: &[f64], dimension: usize, control: &Control) -> Parsed<Vec<[u32; 3]>> {
        if !self.mixed {
            return Ok(self.triangles);
        }
        let mut out = super::source::reserved(self.corners.len().saturating_sub(2 * self.ends.len()))?;
        let mut cutter = Cutter::default();
        let (mut start, mut since) = (0, 0);
        for &end in &self.ends {
            let corners = &self.corners[start..end];
            since += corners.len() * corners.len().min(64);
            if since > 1 << 18 {
                since = 0;
                control.check()?;
            }
            cutter.cut(corners, vertices, dimension, &mut out);
            start = end;
        }
        Ok(out)
    }
}

/// Cuts polygons into triangles of their own corners: a fan where the polygon is convex, else ears of it in the plane of
/// its vector area (Newell's), where a fan would fold over. Any such cut has the polygon's border, so its vector area too.
#[derive(Default)]
struct Cutter {
    flat: Vec<[f64; 2]>,
    ring: Vec<usize>,
    reflex: Vec<usize>,
}

impl Cutter {
    fn cut(&mut self, corners: &[u32], vertices: &[f64], dimension: usize, out: &mut Vec<[u32; 3]>) {
        match *corners {
            [] | [_] | [_, _] => {}
            [a, b, c] => out.push([a, b, c]),
            _ if corners.len() > MOST_CORNERS || !self.flatten(corners, vertices, dimension) || self.convex() => fan(corners, out),
            _ => self.clip(corners, out),
        }
    }

    /// Projects the corners along the vector area, so that it counts as positive; false where there is none.
    fn flatten(&mut self, corners: &[u32], vertices: &[f64], dimension: usize) -> bool {
        if dimension > 3 {
            return false;
        }
        let place = |corner: u32| {
            let mut place = [0.0; 3];
            place[..dimension].copy_from_slice(&vertices[corner as usize * dimension..][..dimension]);
            place
        };
        let origin = place(corners[0]);
        let offsets = corners.iter().map(|&corner| {
            let place = place(corner);
            [place[0] - origin[0], place[1] - origin[1], place[2] - origin[2]]
        });
        let size = offsets.clone().flatten().fold(0.0f64, |most, offset| most.max(offset.abs()));
        if !(size > 0.0 && size.is_finite()) {
            return false;
        }
        let scaled = offsets.map(|offset| offset.map(|number| number / size));
        let (mut area, mut last) = ([0.0; 3], [0.0; 3]);
        for next in scaled.clone().skip(1) {
            let part = cross(last, next);
            area = std::array::from_fn(|axis| area[axis] + part[axis]);
            last = next;
        }
        let length = area.iter().map(|number| number * number).sum::<f64>().sqrt();
        if length.is_nan() || length <= 1e-14 {
            return false;
        }
        let normal = area.map(|number| number / length);
        // an axis far from the normal, made orthogonal to it, and their cross product
        let axis = (0..3).min_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs())).unwrap_or(0);
        let mut first = normal.map(|number| -number * normal[axis]);
        first[axis] += 1.0;
        let second = cross(normal, first);
        self.flat.clear();
        self.flat.extend(scaled.map(|place| [dot(place, first), dot(place, second)]));
        true
    }

    fn convex(&self) -> bool {
        let n = self.flat.len();
        (0..n).all(|i| turn(self.flat[(i + n - 1) % n], self.flat[i], self.flat[(i + 1) % n]) >= -1e-15)
    }

    fn clip(&mut self, corners: &[u32], out: &mut Vec<[u32; 3]>) {
        let Cutter { flat, ring, reflex } = self;
        let n = flat.len();
        ring.clear();
        ring.extend(0..n);
        reflex.clear();
        reflex.extend((0..n).filter(|&i| turn(flat[(i + n - 1) % n], flat[i], flat[(i + 1) % n]) <= 0.0));
        let mut at = 0;
        while ring.len() > 3 {
            let count = ring.len();
            let around = |i: usize| [ring[(i + count - 1) % count], ring[i], ring[(i + 1) % count]];
            // an ear that stands out and holds no reflex corner; where there is none, one without area, so that slits close
            let ear = (0..count).map(|step| (at + step) % count).find(|&i| {
                let [a, b, c] = around(i);
                turn(flat[a], flat[b], flat[c]) > 0.0 && !reflex.iter().any(|&corner| inside(flat, [a, b, c], corner))
            });
            let flat_ear = || {
                (0..count).map(|step| (at + step) % count).find(|&i| {
                    let [a, b, c] = around(i);
                    turn(flat[a], flat[b], flat[c]) == 0.0
                })
            };
            let Some(i) = ear.or_else(flat_ear) else {
                let left: Vec<u32> = ring.iter().map(|&corner| corners[corner]).collect();
                fan(&left, out);
                return;
            };
            let ends = around(i);
            out.push(ends.map(|corner| corners[corner]));
            ring.remove(i);
            let count = ring.len();
            let straightened =
                |corner: usize, i: usize| turn(flat[ring[(i + count - 1) % count]], flat[corner], flat[ring[(i + 1) % count]]) > 0.0;
            let (before, after) = (straightened(ends[0], (i + count - 1) % count), straightened(ends[2], i % count));
            reflex.retain(|&corner| corner != ends[1] && !(corner == ends[0] && before) && !(corner == ends[2] && after));
            at = i % count; // go on beyond the ear: strips rather than one long fan
        }
        out.push([corners[ring[0]], corners[ring[1]], corners[ring[2]]]);
    }
}

fn fan(corners: &[u32], out: &mut Vec<[u32; 3]>) {
    out.extend(corners.windows(2).skip(1).map(|pair| [corners[0], pair[0], pair[1]]));
}

/// Twice the signed area of a triangle.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Whether a corner lies in a triangle of others or on its border; corners at the same place as one of the three do not count.
fn inside(flat: &[[f64; 2]], [a, b, c]: [usize; 3], corner: usize) -> bool {
    let place = flat[corner];
    if place == flat[a] || place == flat[b] || place == flat[c] {
        return false;
    }
    turn(flat[a], flat[b], place) >= 0.0 && turn(flat[b], flat[c], place) >= 0.0 && turn(flat[c], flat[a], place) >= 0.0
}
