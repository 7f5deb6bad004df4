//! Contours of a function on a mesh: ordered, oriented polylines on the surface.

use crate::error::{Error, Result};
use crate::shape::TriangleMesh;
use std::collections::HashMap;

/// Polylines on a mesh. Each point lies on an edge.
#[derive(Debug, Clone, PartialEq)]
pub struct Contours {
    /// Coordinates, point after point.
    pub points: Vec<f64>,
    /// The two ends of the edge that each point lies on, the lower number first.
    pub edges: Vec<[u32; 2]>,
    /// Where on the edge: 0 at the first end, 1 at the second.
    pub shares: Vec<f64>,
    /// Where each polyline starts, and the number of points at last. A closed one repeats its first point.
    pub starts: Vec<usize>,
    /// Which polylines are closed.
    pub closed: Vec<bool>,
}

const NONE: usize = usize::MAX;

/// The polylines where a piecewise linear function takes a level. Vertices count as above where their value is greater.
///
/// On a consistently oriented mesh the greater side lies to the left, seen from outside. Closed surfaces give closed polylines;
/// they end at boundaries, and where more than two triangles share an edge.
///
/// ```
/// use beltrami::{TriangleMesh, levelset::level_set};
/// let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0], vec![[0, 1, 2]])?;
/// let line = level_set(&mesh, &[1.0, 0.0, 0.0], 0.5)?;
/// assert_eq!(line.points, [0.5, 0.0, 0.0, 0.5]);
/// assert_eq!(line.closed, [false]);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if there is not one finite value per vertex, or the level is not finite.
pub fn level_set(mesh: &TriangleMesh<'_>, values: &[f64], level: f64) -> Result<Contours> {
    if values.len() != mesh.vertex_count() || !level.is_finite() {
        return Err(Error::input(format!(
            "{} values and the level {level}: one value for each of {} vertices and a finite level are needed",
            values.len(),
            mesh.vertex_count()
        )));
    }
    if let Some(at) = values.iter().position(|value| !value.is_finite()) {
        return Err(Error::input(format!("the value at vertex {at} is {}; contours need finite values", values[at])));
    }
    let above: Vec<bool> = values.iter().map(|&value| value > level).collect();
    let mut numbers: HashMap<[u32; 2], usize> = HashMap::new();
    let mut edges: Vec<[u32; 2]> = Vec::new();
    let mut segments: Vec<[usize; 2]> = Vec::new();
    for &corners in mesh.faces() {
        let [a, b, c] = corners.map(|corner| above[corner as usize]);
        if a == b && b == c {
            continue;
        }
        let alone = if b == c {
            0
        } else if a == c {
            1
        } else {
            2
        };
        let (i, j, k) = (corners[alone], corners[(alone + 1) % 3], corners[(alone + 2) % 3]);
        let mut number = |p: u32, q: u32| {
            let edge = [p.min(q), p.max(q)];
            *numbers.entry(edge).or_insert_with(|| {
                edges.push(edge);
                edges.len() - 1
            })
        };
        let (first, second) = (number(i, j), number(i, k));
        segments.push(if above[i as usize] { [first, second] } else { [second, first] });
    }
    let mut degree = vec![0_usize; edges.len()];
    for segment in &segments {
        degree[segment[0]] += 1;
        degree[segment[1]] += 1;
    }
    let mut slots = vec![[NONE; 2]; edges.len()]; // the two segments at an edge of two triangles
    for (at, segment) in segments.iter().enumerate() {
        for &end in segment {
            let slot = usize::from(slots[end][0] != NONE);
            slots[end][slot] = at;
        }
    }
    let mut used = vec![false; segments.len()];
    let mut lines: Vec<(Vec<usize>, bool)> = Vec::new();
    // Open ones first, from their ends; what is left are loops.
    for open in [true, false] {
        for start in 0..segments.len() {
            for side in 0..2 {
                if used[start] || (open && degree[segments[start][side]] == 2) {
                    continue;
                }
                let (mut line, mut forward, mut at, mut from) = (vec![segments[start][side]], 0_isize, start, segments[start][side]);
                let closed = loop {
                    used[at] = true;
                    forward += if segments[at][0] == from { 1 } else { -1 };
                    from = if segments[at][0] == from { segments[at][1] } else { segments[at][0] };
                    line.push(from);
                    if !open && from == line[0] {
                        break true;
                    }
                    if degree[from] != 2 {
                        break false;
                    }
                    let [one, two] = slots[from];
                    at = if one == at { two } else { one };
                    if at == NONE || used[at] {
                        break from == line[0];
                    }
                };
                if forward < 0 {
                    line.reverse();
                }
                lines.push((line, closed));
            }
        }
    }
    let mut out = Contours { points: Vec::new(), edges: Vec::new(), shares: Vec::new(), starts: vec![0], closed: Vec::new() };
    for (line, closed) in lines {
        for number in line {
            let [p, q] = edges[number];
            let (low, high) = (values[p as usize], values[q as usize]);
            // halved, so that the difference of huge values does not overflow
            let share = (0.5 * level - 0.5 * low) / (0.5 * high - 0.5 * low);
            out.points.extend(mesh.vertex(p).iter().zip(mesh.vertex(q)).map(|(a, b)| (1.0 - share) * a + share * b));
            out.edges.push([p, q]);
            out.shares.push(share);
        }
        out.starts.push(out.edges.len());
        out.closed.push(closed);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tetrahedron_is_cut_in_one_closed_triangle() {
        let mesh = TriangleMesh::new(
            3,
            vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        )
        .unwrap();
        let found = level_set(&mesh, &[0.0, 0.0, 0.0, 1.0], 0.5).unwrap();
        assert_eq!((found.starts.clone(), found.closed.clone()), (vec![0, 4], vec![true]));
        assert_eq!(found.points[..3], found.points[9..]);
        // seen from above, the tip to the left: counterclockwise
        let p = |k: usize| &found.points[3 * k..3 * k + 2];
        let turn = (p(1)[0] - p(0)[0]) * (p(2)[1] - p(0)[1]) - (p(1)[1] - p(0)[1]) * (p(2)[0] - p(0)[0]);
        assert!(turn > 0.0, "{turn}");
    }

    #[test]
    fn a_third_triangle_at_an_edge_ends_the_lines() {
        let mesh = TriangleMesh::new(
            3,
            vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0],
            vec![[0, 1, 2], [0, 1, 3], [0, 1, 4]],
        )
        .unwrap();
        let found = level_set(&mesh, &[0.0, 1.0, 0.0, 0.0, 0.0], 0.5).unwrap();
        assert_eq!(found.starts, [0, 2, 4, 6]);
        assert_eq!(found.closed, [false; 3]);
    }

    #[test]
    fn a_level_above_everything_gives_nothing() {
        let mesh = TriangleMesh::new(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0], vec![[0, 1, 2]]).unwrap();
        assert_eq!(level_set(&mesh, &[1.0, 0.0, 0.0], 1.0).unwrap().starts, [0]);
        assert!(level_set(&mesh, &[f64::NAN, 0.0, 0.0], 1.0).is_err());
        assert!(level_set(&mesh, &[0.0, 0.0], 1.0).is_err());
    }
}
