//! Pictures of shapes, painted without a display: surfaces, balls and lines with depth, exact colours, soft light.
//!
//! [`paint`] turns a [`Scene`] seen by a [`Camera`] into an [`Image`]; [`Image::strokes`] writes and rules on top of it and
//! [`Image::to_png`] encodes it. The picture is made tile by tile, each by one thread, so its bits do not depend on how many
//! threads there are.

// Loops over three axes of several arrays at once read best with an index; a comparison that fails on NaN is meant so.
#![allow(clippy::needless_range_loop, clippy::neg_cmp_op_on_partial_ord)]

mod hollows;
mod light;
mod png;
mod raster;
mod strokes;

pub use raster::paint;

use crate::error::{Error, Result};
use crate::sparse::CHUNK;
use rayon::prelude::*;

/// Red, green and blue as the screen shows them (sRGB), 0 to 1.
pub type Rgb = [f32; 3];
/// [`Rgb`] and opacity, each 0 to 1.
pub type Rgba = [f32; 4];

/// Where the eye is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Unit vectors to the right, upwards and towards the eye.
    pub axes: [[f64; 3]; 3],
    /// The point that is looked at.
    pub centre: [f64; 3],
    /// The pixel on which [`centre`](Self::centre) falls.
    pub middle: [f64; 2],
    /// Pixels a unit of length, at the centre's depth.
    pub scale: f64,
    /// Distance of the eye from the centre; infinite for parallel projection.
    pub distance: f64,
}

/// A point on the screen: x and y in pixels, nearness (in pixels, linear across a triangle on the screen, larger is nearer), and
/// the factor by which things look larger there than at the camera's centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Projected {
    pub x: f64,
    pub y: f64,
    pub near: f64,
    pub zoom: f64,
}

impl Camera {
    pub(crate) fn turn(&self, v: [f64; 3]) -> [f64; 3] {
        self.axes.map(|axis| axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2])
    }

    pub(crate) fn project(&self, p: &[f64]) -> Projected {
        let q = self.turn([p[0] - self.centre[0], p[1] - self.centre[1], p[2] - self.centre[2]]);
        // Whatever is behind the eye is flattened onto a plane just before it: callers keep shapes in front.
        let zoom = 1.0 / (1.0 - q[2] / self.distance).max(1e-3);
        Projected {
            x: self.middle[0] + self.scale * q[0] * zoom,
            y: self.middle[1] - self.scale * q[1] * zoom,
            near: self.scale * q[2] * zoom,
            zoom,
        }
    }
}

/// What colours a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Colouring<'a> {
    /// One colour.
    Uniform(Rgb),
    /// One number per vertex, interpolated and then looked up pixel by pixel; not finite: no data.
    Scalars {
        /// The numbers.
        values: &'a [f64],
        /// The number that gets the first colour of the table.
        low: f64,
        /// The number that gets the last colour of the table.
        high: f64,
        /// Colours at equal steps from `low` to `high`, interpolated in between.
        table: &'a [Rgb],
    },
    /// One colour per vertex.
    Vertices(&'a [Rgba]),
    /// One colour per face.
    Faces(&'a [Rgba]),
    /// One label per vertex, an index into the palette; regions meet half way. A label beyond the palette: no data.
    Labels {
        /// The labels.
        labels: &'a [u32],
        /// Their colours.
        palette: &'a [Rgb],
    },
}

/// A triangle mesh in R^3 and how it looks.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface<'a> {
    /// Three coordinates per vertex.
    pub vertices: &'a [f64],
    /// Vertex numbers.
    pub faces: &'a [[u32; 3]],
    /// The colours.
    pub colouring: Colouring<'a>,
    /// Colour where there is no data.
    pub missing: Rgb,
    /// Contour lines of the scalars: ascending levels.
    pub levels: &'a [f64],
    /// Colour and opacity of the contour lines.
    pub level_colour: Rgba,
    /// Width of the contour lines in pixels.
    pub level_width: f64,
    /// Colour and opacity of the mesh's edges.
    pub edge_colour: Rgba,
    /// Width of the mesh's edges in pixels; 0 for none.
    pub edge_width: f64,
    /// From 0 (cannot be seen through) to 1 (glass).
    pub transparency: f64,
    /// Whether light is interpolated across triangles.
    pub smooth: bool,
}

/// Balls, or discs along the surface where there are normals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Balls<'a> {
    /// Three coordinates each.
    pub centres: &'a [f64],
    /// Radius each, as a length.
    pub radii: &'a [f64],
    /// Colour each.
    pub colours: &'a [Rgba],
    /// Three numbers each, or empty: then they are balls.
    pub normals: &'a [f64],
}

/// Polylines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lines<'a> {
    /// Three coordinates per point.
    pub points: &'a [f64],
    /// Polyline `i` goes through the points `starts[i]..starts[i + 1]`.
    pub starts: &'a [usize],
    /// Width of each polyline in pixels.
    pub widths: &'a [f64],
    /// Colour of each polyline.
    pub colours: &'a [Rgba],
}

/// All that is painted.
#[derive(Debug, Clone, Default)]
pub struct Scene<'a> {
    /// A surface.
    pub surface: Option<Surface<'a>>,
    /// Balls.
    pub balls: Vec<Balls<'a>>,
    /// Lines.
    pub lines: Option<Lines<'a>>,
}

/// The picture's size and light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Rows and columns of samples in a pixel, 1 to 8.
    pub samples: usize,
    /// Colour behind everything.
    pub background: Rgb,
    /// Whether there is light; without it colours are those of the table to the last bit.
    pub lit: bool,
    /// Reach of the soft darkening of hollows as a length; 0 for none.
    pub hollows: f64,
}

impl Default for Frame {
    fn default() -> Self {
        Frame { width: 800, height: 600, samples: 3, background: [1.0; 3], lit: true, hollows: 0.0 }
    }
}

/// A picture: rows from the top, three bytes per pixel (red, green, blue).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) pixels: Vec<u8>,
}

impl Image {
    /// A picture of pixels already made.
    ///
    /// ```
    /// let image = beltrami::view::Image::new(2, 1, vec![0, 0, 0, 255, 255, 255])?;
    /// assert_eq!(image.pixel(1, 0), Some([255, 255, 255]));
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if the number of bytes is not 3 `width` `height`.
    pub fn new(width: usize, height: usize, pixels: Vec<u8>) -> Result<Self> {
        if width.checked_mul(height).and_then(|count| count.checked_mul(3)) != Some(pixels.len()) || width == 0 || height == 0 {
            return Err(Error::input(format!("{} bytes are no picture of {width} x {height} pixels of 3 bytes", pixels.len())));
        }
        Ok(Image { width, height, pixels })
    }

    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All bytes.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// The bytes, without a copy.
    pub fn into_pixels(self) -> Vec<u8> {
        self.pixels
    }

    /// Colour of a pixel, if it is in the picture.
    pub fn pixel(&self, x: usize, y: usize) -> Option<[u8; 3]> {
        if x >= self.width || y >= self.height {
            return None;
        }
        let at = 3 * (y * self.width + x);
        Some([self.pixels[at], self.pixels[at + 1], self.pixels[at + 2]])
    }
}

fn shape_of(name: &str, numbers: &[f64], columns: usize) -> Result<usize> {
    if !numbers.len().is_multiple_of(columns) {
        return Err(Error::input(format!("{name}: {} numbers do not make rows of {columns}", numbers.len())));
    }
    match numbers.par_iter().with_min_len(CHUNK).position_first(|x| !x.is_finite()) {
        Some(at) => Err(Error::input(format!("{name}: number {} of row {} is {}", at % columns, at / columns, numbers[at]))),
        None => Ok(numbers.len() / columns),
    }
}

fn same(name: &str, got: usize, want: usize) -> Result<()> {
    if got == want { Ok(()) } else { Err(Error::input(format!("{name}: {got} of them, {want} are needed"))) }
}

impl Scene<'_> {
    fn check(&self) -> Result<()> {
        if let Some(surface) = &self.surface {
            let count = shape_of("vertices", surface.vertices, 3)?;
            if let Some(at) = surface.faces.iter().position(|face| face.iter().any(|&corner| corner as usize >= count)) {
                return Err(Error::input(format!("face {at} refers to a vertex beyond the {count} there are")));
            }
            match surface.colouring {
                Colouring::Uniform(_) => {}
                Colouring::Scalars { values, low, high, table } => {
                    same("values", values.len(), count)?;
                    if table.is_empty() || !(low <= high) || !(high - low).is_finite() {
                        return Err(Error::input(format!("a table of {} colours from {low} to {high}; a span is needed", table.len())));
                    }
                }
                Colouring::Vertices(colours) => same("vertex colours", colours.len(), count)?,
                Colouring::Faces(colours) => same("face colours", colours.len(), surface.faces.len())?,
                Colouring::Labels { labels, .. } => same("labels", labels.len(), count)?,
            }
        }
        for balls in &self.balls {
            let count = shape_of("centres of balls", balls.centres, 3)?;
            same("radii of balls", shape_of("radii of balls", balls.radii, 1)?, count)?;
            same("colours of balls", balls.colours.len(), count)?;
            if !balls.normals.is_empty() {
                same("normals", shape_of("normals", balls.normals, 3)?, count)?;
            }
        }
        if let Some(lines) = &self.lines {
            let count = shape_of("points of lines", lines.points, 3)?;
            let polylines = lines.starts.len().saturating_sub(1);
            same("widths of lines", shape_of("widths of lines", lines.widths, 1)?, polylines)?;
            same("colours of lines", lines.colours.len(), polylines)?;
            if lines.starts.windows(2).any(|pair| pair[0] > pair[1]) || lines.starts.last().is_some_and(|&last| last > count) {
                return Err(Error::input("starts of lines do not ascend, or go beyond the points"));
            }
        }
        Ok(())
    }
}
