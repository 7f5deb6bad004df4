//! The star of a point as a convex hull of its inverted neighbours.

use crate::vector::{cross, dot, length, minus};

/// A facet of a star: d other points, ascending, and the circumradius in the star's coordinates.
#[derive(Debug, Clone, Copy)]
pub(super) struct Facet {
    pub(super) corners: [u32; 3],
    pub(super) radius: f64,
}

/// Convex hulls of the origin and inverted neighbours, in one, two and three dimensions.
#[derive(Default)]
pub(super) struct Hull {
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
    pub(super) fn facets(&mut self, inverted: &[[f64; 3]], flat: &[[f64; 3]], dimension: usize, out: &mut Vec<Facet>) -> bool {
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
            let (ab, ac) = (minus(b, a), minus(c, a));
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
