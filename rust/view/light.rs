//! Light, and the screen's curve between numbers and brightness.

use super::Rgb;

/// Brightness (linear) of an sRGB number.
pub(super) fn linear(x: f32) -> f32 {
    if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

pub(super) fn linear_colour(colour: Rgb) -> Rgb {
    colour.map(|x| linear(x.clamp(0.0, 1.0)))
}

/// sRGB bytes of brightness 0..=1 in steps fine enough that each byte is met (the curve is steepest near black).
pub(super) struct Screen(Vec<u8>);

const STEPS: f32 = 16384.0;

impl Screen {
    pub(super) fn new() -> Self {
        let byte = |step: usize| {
            let x = step as f32 / STEPS;
            let y = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
            (255.0 * y + 0.5) as u8
        };
        Screen((0..=STEPS as usize).map(byte).collect())
    }

    pub(super) fn byte(&self, brightness: f32) -> u8 {
        self.0[(brightness.clamp(0.0, 1.0) * STEPS + 0.5) as usize]
    }
}

pub(super) fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    if length > 0.0 { v.map(|x| x / length) } else { [0.0, 0.0, 1.0] }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A colour (linear) under a bright sky, one soft lamp from the upper left and a weak one from the right. The normal is in
/// the camera's axes and faces the eye. What faces the lamp keeps the colour of the colour bar.
pub(super) fn lit(colour: Rgb, normal: [f32; 3]) -> Rgb {
    const LAMP: [f32; 3] = [-0.408_25, 0.563_1, 0.718_5];
    const HALF: [f32; 3] = [-0.220_2, 0.303_7, 0.927_0];
    const FILL: [f32; 3] = [0.872_9, -0.087_3, 0.480_1];
    let sky = 0.37 + 0.12 * normal[1];
    let lamp = 0.64 * ((dot(normal, LAMP) + 0.22) / 1.22).max(0.0);
    let fill = 0.13 * dot(normal, FILL).max(0.0);
    let light = sky + lamp + fill;
    let gloss = dot(normal, HALF).max(0.0).powi(48) * 0.07;
    let rim = (1.0 - normal[2]).powi(4) * 0.05;
    colour.map(|c| c * light + gloss + rim)
}
