//! Soft darkening of hollows: how much of the sky a pixel's surroundings leave open, judged from the nearness of its neighbours.

use super::raster::Pixel;
use crate::control::Control;
use crate::error::Result;
use rayon::prelude::*;

const TAPS: usize = 16;
const TURNS: usize = 16; // of the pattern of taps, one a pixel of a 4 x 4 block
const STRENGTH: f32 = 2.3;

/// Steps to the taps of each turn of a spiral of that reach.
fn spirals(reach: f32) -> Vec<[f32; 2]> {
    const GOLDEN: f32 = 2.399_963_2; // the angle at which a spiral covers a disc most evenly
    (0..TURNS * TAPS)
        .map(|at| {
            let (turn, tap) = ((at / TAPS) as f32 / TURNS as f32, (at % TAPS) as f32);
            let radius = reach * ((tap + 0.3 + 0.7 * turn) / TAPS as f32).powf(1.4) + 0.8;
            let (sine, cosine) = (GOLDEN * tap + std::f32::consts::TAU * turn).sin_cos();
            [(radius * cosine).round(), (radius * sine).round()]
        })
        .collect()
}

/// Light that reaches each pixel, 0 to 1; `reach` in pixels.
pub(super) fn openness(pixels: &[Pixel], width: usize, height: usize, reach: f64, control: &Control) -> Result<Vec<f32>> {
    // The order of a 4 x 4 block in which neighbours differ most (Bayer).
    const ORDER: [usize; TURNS] = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5];
    let reach = (reach as f32).clamp(2.0, 0.25 * width.max(height) as f32 + 2.0);
    let spirals = spirals(reach);
    let fade = 1.0 / (1.5 * reach);
    let nears: Vec<f32> = pixels.iter().map(|pixel| pixel.near).collect();
    let mut open = vec![1.0f32; width * height];
    open.par_chunks_mut(width).enumerate().try_for_each(|(y, row)| {
        control.check()?;
        for (x, out) in row.iter_mut().enumerate() {
            let here = nears[y * width + x];
            if here == f32::NEG_INFINITY {
                continue;
            }
            let normal = pixels[y * width + x].normal;
            let turn = ORDER[(y % 4) * 4 + x % 4];
            let mut hidden = 0.0;
            for &[dx, dy] in &spirals[turn * TAPS..(turn + 1) * TAPS] {
                let (column, line) = (x as i32 + dx as i32, y as i32 - dy as i32);
                if column < 0 || line < 0 || column >= width as i32 || line >= height as i32 {
                    continue;
                }
                let rise = nears[line as usize * width + column as usize] - here;
                let weight = 1.0 - rise.abs() * fade; // far in front or behind, and the background: another thing
                if weight <= 0.0 {
                    continue;
                }
                let far = (dx * dx + dy * dy + rise * rise).sqrt();
                let height = (dx * normal[0] + dy * normal[1] + rise * normal[2]) / far;
                hidden += (height - 0.12).max(0.0) * weight;
            }
            *out = (1.0 - STRENGTH * hidden / TAPS as f32).max(0.2);
        }
        Ok(())
    })?;
    control.report(0.85)?;
    // The mean over a 4 x 4 block has each turn of the pattern once: its grain is gone. Only like nearness counts.
    let mut smooth = open.clone();
    smooth.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, out) in row.iter_mut().enumerate() {
            let here = nears[y * width + x];
            if here == f32::NEG_INFINITY {
                continue;
            }
            let (mut sum, mut weights) = (0.0, 0.0);
            for line in y.saturating_sub(2)..(y + 2).min(height) {
                for column in x.saturating_sub(2)..(x + 2).min(width) {
                    let at = line * width + column;
                    if (nears[at] - here).abs() < 0.1 * reach {
                        sum += open[at];
                        weights += 1.0;
                    }
                }
            }
            *out = sum / weights; // it counts itself
        }
    });
    Ok(smooth)
}
