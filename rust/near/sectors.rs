//! How far a surface that is known by points lies from places inside it, in the directions of a plane.

use crate::control::Control;
use crate::error::{Error, Result};
use crate::vector::dot;
use rayon::prelude::*;

/// A point counts for a direction by exp(SHARPNESS (cos - 1)) of the angle between them: two of 24 sectors wide.
const SHARPNESS: f64 = 24.0;

/// Beyond an angle with this cosine a point does not count: exp(-12).
const LEAST: f64 = 0.5;

/// What the points near a direction must weigh together for it to see the surface.
const SEEN: f64 = 0.5;

/// So many points in a section say something.
const FEW: usize = 6;

/// Points of R^3 in groups (the points of group g are `starts[g] .. starts[g + 1]`), of which each place sees one.
#[derive(Debug, Clone, Copy)]
pub struct Grouped<'a> {
    /// Coordinates, three per point; within a group ascending along `axis`.
    pub points: &'a [f64],
    /// Where each group starts, and the number of points at last.
    pub starts: &'a [usize],
    /// 0 to 2.
    pub axis: usize,
}

/// Where surfaces are measured: planes across `tangents` through `places`, three numbers each.
#[derive(Debug, Clone, Copy)]
pub struct Planes<'a> {
    /// Points inside.
    pub places: &'a [f64],
    /// Unit vectors across the planes.
    pub tangents: &'a [f64],
    /// Two more unit vectors a plane, which span it.
    pub frames: [&'a [f64]; 2],
    /// Points farther than this are not seen.
    pub reach: &'a [f64],
    /// Nor those farther than this from the plane.
    pub thickness: &'a [f64],
    /// The group that each place sees; none if it is negative.
    pub group: &'a [i32],
}

/// Mean distances, in their planes, of the points around each of `directions` directions: `directions` numbers a place, turning from the
/// first vector of its frame to the second; negative where there are too few points.
///
/// ```
/// use beltrami::{Control, near::{Grouped, Planes, sectors}};
/// // a tube of radius 2 around the z-axis, seen from a place one off its middle
/// let ring = |z: f64| (0..60).flat_map(move |k| { let t = k as f64 / 60.0 * 6.2831853; [2.0 * t.cos(), 2.0 * t.sin(), z] });
/// let points: Vec<f64> = ring(0.0).chain(ring(0.1)).collect();
/// let mut rows: Vec<&[f64]> = points.chunks(3).collect();
/// rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
/// let grouped = Grouped { points: &rows.concat(), starts: &[0, 120], axis: 0 };
/// let planes = Planes { places: &[1.0, 0.0, 0.0], tangents: &[0.0, 0.0, 1.0], frames: [&[1.0, 0.0, 0.0], &[0.0, 1.0, 0.0]],
///                       reach: &[10.0], thickness: &[0.5], group: &[0] };
/// let found = sectors(&grouped, &planes, 24, &Control::default())?;
/// assert!((found[0] - 1.0).abs() < 0.1 && (found[12] - 3.0).abs() < 0.1);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if lengths do not fit together or a number is out of range; [`Error::Cancelled`].
pub fn sectors(grouped: &Grouped<'_>, planes: &Planes<'_>, directions: usize, control: &Control) -> Result<Vec<f64>> {
    let Planes { places, tangents, frames: [u, v], reach, thickness, group } = *planes;
    let (count, groups) = (group.len(), grouped.starts.len().saturating_sub(1));
    let long = [places, tangents, u, v].iter().all(|vectors| vectors.len() == 3 * count);
    if !long || reach.len() != count || thickness.len() != count {
        return Err(Error::input(format!("the arrays of {count} planes do not fit together")));
    }
    let last = grouped.starts.last().copied().unwrap_or(0);
    if grouped.axis > 2 || 3 * last != grouped.points.len() || grouped.starts.windows(2).any(|pair| pair[0] > pair[1]) {
        return Err(Error::input(format!("{groups} groups do not fit the points")));
    }
    if let Some(&wrong) = group.iter().find(|&&group| group >= 0 && group as usize >= groups) {
        return Err(Error::input(format!("a place sees group {wrong}, there are {groups}")));
    }
    let turns: Vec<(f64, f64)> =
        (0..directions).map(|k| (std::f64::consts::TAU * k as f64 / directions as f64).sin_cos()).map(|(sin, cos)| (cos, sin)).collect();
    let mut out = vec![-1.0; count * directions];
    out.par_chunks_mut(directions.max(1)).enumerate().try_for_each_init(Vec::new, |seen: &mut Vec<[f64; 3]>, (at, out)| {
        control.check()?;
        let Ok(group) = usize::try_from(group[at]) else { return Ok(()) };
        let vector = |all: &[f64]| [all[3 * at], all[3 * at + 1], all[3 * at + 2]];
        let (place, tangent, u, v) = (vector(places), vector(tangents), vector(u), vector(v));
        let mine = grouped.points[3 * grouped.starts[group]..3 * grouped.starts[group + 1]].as_chunks::<3>().0;
        let (low, high) = (place[grouped.axis] - reach[at], place[grouped.axis] + reach[at]);
        let from = mine.partition_point(|point| point[grouped.axis] < low);
        let square = reach[at] * reach[at];
        seen.clear();
        for point in mine[from..].iter().take_while(|point| point[grouped.axis] <= high) {
            let offset = [point[0] - place[0], point[1] - place[1], point[2] - place[2]];
            if dot(offset, tangent).abs() < thickness[at] && dot(offset, offset) <= square {
                let (x, y) = (dot(offset, u), dot(offset, v));
                seen.push([x, y, x.hypot(y)]);
            }
        }
        if seen.len() < FEW {
            return Ok(());
        }
        for (slot, &(cos, sin)) in out.iter_mut().zip(&turns) {
            let (mut total, mut sum) = (0.0, 0.0);
            for &[x, y, length] in seen.iter() {
                let near = x * cos + y * sin;
                if near > LEAST * length {
                    let bump = (SHARPNESS * (near / length - 1.0)).exp();
                    total += bump;
                    sum += bump * length;
                }
            }
            if total > SEEN {
                *slot = sum / total;
            }
        }
        Ok(())
    })?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_is_refused() {
        let one = [0.0, 0.0, 1.0];
        let planes = Planes { places: &one, tangents: &one, frames: [&one, &one], reach: &[1.0], thickness: &[1.0], group: &[0] };
        let sound = Grouped { points: &one, starts: &[0, 1], axis: 0 };
        let control = Control::default();
        assert_eq!(sectors(&sound, &planes, 4, &control).unwrap(), [-1.0; 4]);
        assert!(sectors(&Grouped { axis: 3, ..sound }, &planes, 4, &control).is_err());
        assert!(sectors(&Grouped { starts: &[0, 2], ..sound }, &planes, 4, &control).is_err());
        assert!(sectors(&Grouped { starts: &[], ..sound }, &planes, 4, &control).is_err());
        assert!(sectors(&sound, &Planes { group: &[1], ..planes }, 4, &control).is_err());
        assert!(sectors(&sound, &Planes { reach: &[], ..planes }, 4, &control).is_err());
        assert_eq!(sectors(&sound, &Planes { group: &[-1], ..planes }, 2, &control).unwrap(), [-1.0; 2]);
    }
}
