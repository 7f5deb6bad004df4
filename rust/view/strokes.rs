//! Round-ended strokes drawn flat on a picture: letters, ticks, frames.

use super::{Image, Rgba};
use crate::error::{Error, Result};

pub(super) fn distance_to_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> (f64, f64) {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let squared = dx * dx + dy * dy;
    let share = if squared > 0.0 { (((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / squared).clamp(0.0, 1.0) } else { 0.0 };
    ((p[0] - a[0] - share * dx).hypot(p[1] - a[1] - share * dy), share)
}

impl Image {
    /// Draws polylines of one colour with round ends, smoothly; where they overlap the colour counts once.
    ///
    /// `points` are pixel coordinates (x, y, x, y ...; a pixel's middle is at halves), polyline `i` goes through the points
    /// `starts[i]..starts[i + 1]`.
    ///
    /// ```
    /// let mut image = beltrami::view::Image::new(3, 3, vec![255; 27])?;
    /// image.strokes(&[0.0, 1.5, 3.0, 1.5], &[0, 2], 1.0, [0.0, 0.0, 0.0, 1.0])?;
    /// assert_eq!(image.pixel(1, 1), Some([0, 0, 0]));
    /// assert_eq!(image.pixel(1, 0), Some([255, 255, 255]));
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if a coordinate is not finite or `starts` do not fit the points.
    pub fn strokes(&mut self, points: &[f64], starts: &[usize], width: f64, colour: Rgba) -> Result<()> {
        let count = super::shape_of("points of strokes", points, 2)?;
        if starts.windows(2).any(|pair| pair[0] > pair[1]) || starts.last().is_some_and(|&last| last > count) || !width.is_finite() {
            return Err(Error::input("starts of strokes do not ascend or go beyond the points, or the width is not finite"));
        }
        let used = &points[..2 * starts.last().copied().unwrap_or(0)];
        if used.is_empty() {
            return Ok(());
        }
        let reach = 0.5 * width + 1.0;
        let clip = |x: f64, most: usize| x.clamp(0.0, most as f64) as usize;
        let extent = |axis: usize| {
            let along = used.iter().skip(axis).step_by(2);
            (along.clone().fold(f64::INFINITY, |m, &x| m.min(x)) - reach, along.fold(f64::NEG_INFINITY, |m, &x| m.max(x)) + reach)
        };
        let (left, right) = extent(0);
        let (top, bottom) = extent(1);
        let (x0, x1) = (clip(left.floor(), self.width), clip(right.ceil(), self.width));
        let (y0, y1) = (clip(top.floor(), self.height), clip(bottom.ceil(), self.height));
        let across = x1 - x0;
        let mut cover = vec![0.0f32; across * (y1 - y0)];
        for pair in starts.windows(2) {
            let line = &points[2 * pair[0]..2 * pair[1]];
            let ends = line.len() / 2;
            for i in 0..ends.saturating_sub(1).max(usize::from(ends == 1)) {
                let a = [line[2 * i], line[2 * i + 1]];
                let j = (i + 1).min(ends - 1);
                let b = [line[2 * j], line[2 * j + 1]];
                let rows =
                    clip((a[1].min(b[1]) - reach).floor(), self.height).max(y0)..clip((a[1].max(b[1]) + reach).ceil(), self.height).min(y1);
                let columns =
                    clip((a[0].min(b[0]) - reach).floor(), self.width).max(x0)..clip((a[0].max(b[0]) + reach).ceil(), self.width).min(x1);
                for y in rows {
                    for x in columns.clone() {
                        let (distance, _) = distance_to_segment([x as f64 + 0.5, y as f64 + 0.5], a, b);
                        // A stroke thinner than a pixel covers less of it.
                        let share = (0.5 * width + 0.5 - distance).clamp(0.0, width.min(1.0)) as f32;
                        let cell = &mut cover[(y - y0) * across + x - x0];
                        *cell = cell.max(share);
                    }
                }
            }
        }
        for (row, y) in cover.chunks(across.max(1)).zip(y0..y1) {
            for (&share, x) in row.iter().zip(x0..x1) {
                let opacity = share * colour[3];
                if opacity > 0.0 {
                    for channel in 0..3 {
                        let byte = &mut self.pixels[3 * (y * self.width + x) + channel];
                        *byte = (f32::from(*byte) * (1.0 - opacity) + 255.0 * colour[channel].clamp(0.0, 1.0) * opacity + 0.5) as u8;
                    }
                }
            }
        }
        Ok(())
    }
}
