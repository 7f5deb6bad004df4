//! Soft darkening of hollows: how much of the sky a pixel's surroundings leave open, judged from the nearness of its neighbours.

use super::raster::Pixel;
use crate::control::Control;
use crate::error::Result;
use rayon::prelude::*;

const TAPS: usize = 24;
const STRENGTH: f32 = 2.3;

/// A number from 0 to 1 for each pixel, spread evenly over neighbours (interleaved gradient noise, Jimenez 2014).
fn noise(x: usize, y: usize) -> f32 {
    (52.982_918 * (0.067_110_56 * x as f32 + 0.005_837_15 * y as f32).fract()).fract()
}

/// Light that reaches each pixel, 0 to 1; `reach` in pixels.
pub(super) fn openness(pixels: &[Pixel], width: usize, height: usize, reach: f64, control: &Control) -> Result<Vec<f32>> {
    let reach = (reach as f32).clamp(2.0, 0.25 * width.max(height) as f32 + 2.0);
    let golden = 2.399_963_2_f32;
    let mut open = vec![1.0f32; width * height];
    open.par_chunks_mut(width).enumerate().try_for_each(|(y, row)| {
        control.check()?;
        for (x, out) in row.iter_mut().enumerate() {
            let pixel = &pixels[y * width + x];
            if pixel.near == f32::NEG_INFINITY {
                continue;
            }
            let turn = noise(x, y);
            let mut hidden = 0.0;
            for tap in 0..TAPS {
                let radius = reach * ((tap as f32 + 0.3 + 0.7 * turn) / TAPS as f32).powf(1.4) + 0.8;
                let (sine, cosine) = (golden * tap as f32 + std::f32::consts::TAU * turn).sin_cos();
                let (dx, dy) = ((radius * cosine).round(), (radius * sine).round());
                let (column, line) = (x as f32 + dx, y as f32 - dy);
                if column < 0.0 || line < 0.0 || column >= width as f32 || line >= height as f32 {
                    continue;
                }
                let other = pixels[line as usize * width + column as usize].near;
                if other == f32::NEG_INFINITY {
                    continue;
                }
                let way = [dx, dy, other - pixel.near];
                let far = (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt();
                let rise = (way[0] * pixel.normal[0] + way[1] * pixel.normal[1] + way[2] * pixel.normal[2]) / far;
                let fade = 1.0 - (way[2].abs() / (1.5 * reach)).min(1.0);
                hidden += (rise - 0.12).max(0.0) * fade;
            }
            *out = (1.0 - STRENGTH * hidden / TAPS as f32).max(0.2);
        }
        Ok(())
    })?;
    control.report(0.85)?;
    // The turned pattern repeats over 4 x 4 pixels or so: a mean over 5 x 5 at like nearness removes its grain.
    let mut smooth = open.clone();
    smooth.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, out) in row.iter_mut().enumerate() {
            let here = pixels[y * width + x];
            if here.near == f32::NEG_INFINITY {
                continue;
            }
            let (mut sum, mut weights) = (0.0, 0.0);
            for line in y.saturating_sub(2)..(y + 3).min(height) {
                for column in x.saturating_sub(2)..(x + 3).min(width) {
                    let other = pixels[line * width + column];
                    let facing = here.normal[0] * other.normal[0] + here.normal[1] * other.normal[1] + here.normal[2] * other.normal[2];
                    if (other.near - here.near).abs() < 0.25 * reach && facing > 0.6 {
                        sum += open[line * width + column];
                        weights += 1.0;
                    }
                }
            }
            if weights > 0.0 {
                *out = sum / weights;
            }
        }
    });
    Ok(smooth)
}
