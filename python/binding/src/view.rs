//! Pictures.

use crate::convert::{table, vector, vector_out};
use crate::{error, run};
use beltrami::view::{self, Balls, Camera, Colouring, Frame, Image, Lines, Scene, Surface};
use numpy::{PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

type Rgb = [f32; 3];
type Rgba = [f32; 4];

/// The dictionary that describes a camera.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct CameraIn {
    axes: [[f64; 3]; 3],
    centre: [f64; 3],
    middle: [f64; 2],
    scale: f64,
    distance: f64,
}

/// The dictionary that describes the picture's size and light.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct FrameIn {
    width: usize,
    height: usize,
    samples: usize,
    background: Rgb,
    lit: bool,
    hollows: f64,
}

/// The dictionary that describes a surface.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct SurfaceIn<'py> {
    vertices: PyReadonlyArray2<'py, f64>,
    faces: PyReadonlyArray2<'py, i32>,
    kind: String,
    scalars: PyReadonlyArray1<'py, f64>,
    span: (f64, f64),
    labels: PyReadonlyArray1<'py, i64>,
    colours: PyReadonlyArray2<'py, f32>,
    missing: Rgb,
    levels: PyReadonlyArray1<'py, f64>,
    level_colour: Rgba,
    level_width: f64,
    edge_colour: Rgba,
    edge_width: f64,
    transparency: f64,
    smooth: bool,
}

type BallsIn<'py> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray1<'py, f64>, PyReadonlyArray2<'py, f32>, PyReadonlyArray2<'py, f64>);
type LinesIn<'py> = (PyReadonlyArray2<'py, f64>, Vec<usize>, Vec<f64>, Vec<Rgba>);

fn rows<'a, T: numpy::Element + bytemuck::Pod, const N: usize>(array: &'a PyReadonlyArray2<'_, T>, name: &str) -> PyResult<&'a [[T; N]]>
where
    [T; N]: bytemuck::Pod,
{
    let (numbers, columns) = table(array)?;
    if columns != N {
        return Err(error::input(array.py(), format!("{name} have {columns} columns, {N} are needed")));
    }
    Ok(bytemuck::cast_slice(numbers))
}

fn image_in(array: &PyReadonlyArray3<'_, u8>) -> PyResult<Image> {
    let py = array.py();
    if !array.is_c_contiguous() || array.shape()[2] != 3 {
        return Err(error::input(py, format!("a picture of shape {:?}; (height, width, 3) in C order is needed", array.shape())));
    }
    let bytes = array.as_slice().map_err(|_| error::input(py, "a picture that is not contiguous"))?.to_vec();
    Image::new(array.shape()[1], array.shape()[0], bytes).map_err(|e| error::convert(py, e))
}

fn image_out(py: Python<'_>, image: Image) -> PyResult<Bound<'_, PyArray3<u8>>> {
    let shape = [image.height(), image.width(), 3];
    vector_out(py, image.into_pixels()).reshape(shape)
}

/// Paints a surface, balls and lines.
#[pyfunction]
#[pyo3(signature = (frame, camera, surface, balls, lines, progress=None))]
pub fn paint<'py>(
    py: Python<'py>,
    frame: FrameIn,
    camera: CameraIn,
    surface: Option<SurfaceIn<'py>>,
    balls: Vec<BallsIn<'py>>,
    lines: Option<LinesIn<'py>>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let FrameIn { width, height, samples, background, lit, hollows } = frame;
    let frame = Frame { width, height, samples, background, lit, hollows };
    let CameraIn { axes, centre, middle, scale, distance } = camera;
    let camera = Camera { axes, centre, middle, scale, distance };
    let labels: Vec<u32> = match &surface {
        // A label below zero counts as one beyond the palette: no data.
        Some(s) => vector(&s.labels)?.iter().map(|&label| u32::try_from(label).unwrap_or(u32::MAX)).collect(),
        None => Vec::new(),
    };
    let palette: Vec<Rgb> = match &surface {
        Some(s) => rows::<f32, 4>(&s.colours, "colours")?.iter().map(|c| [c[0], c[1], c[2]]).collect(),
        None => Vec::new(),
    };
    let mut scene = Scene::default();
    if let Some(s) = &surface {
        let colours = rows::<f32, 4>(&s.colours, "colours")?;
        let faces: &[[i32; 3]] = rows(&s.faces, "faces")?;
        let colouring = match s.kind.as_str() {
            "scalars" => Colouring::Scalars { values: vector(&s.scalars)?, low: s.span.0, high: s.span.1, table: &palette },
            "labels" => Colouring::Labels { labels: &labels, palette: &palette },
            "vertices" => Colouring::Vertices(colours),
            "faces" => Colouring::Faces(colours),
            _ => Colouring::Uniform(palette.first().copied().unwrap_or([0.8; 3])),
        };
        let vertices: &[[f64; 3]] = rows(&s.vertices, "vertices")?;
        scene.surface = Some(Surface {
            vertices: vertices.as_flattened(),
            faces: bytemuck::cast_slice(faces),
            colouring,
            missing: s.missing,
            levels: vector(&s.levels)?,
            level_colour: s.level_colour,
            level_width: s.level_width,
            edge_colour: s.edge_colour,
            edge_width: s.edge_width,
            transparency: s.transparency,
            smooth: s.smooth,
        });
    }
    for (centres, radii, colours, normals) in &balls {
        scene.balls.push(Balls {
            centres: rows::<f64, 3>(centres, "centres")?.as_flattened(),
            radii: vector(radii)?,
            colours: rows::<f32, 4>(colours, "colours")?,
            normals: rows::<f64, 3>(normals, "normals")?.as_flattened(),
        });
    }
    if let Some((points, starts, widths, colours)) = &lines {
        scene.lines = Some(Lines { points: rows::<f64, 3>(points, "points")?.as_flattened(), starts, widths, colours });
    }
    let image = run::watched(py, progress.as_ref(), |control| view::paint(&scene, &camera, &frame, control))?;
    image_out(py, image)
}

/// Draws strokes of a width and a colour on a copy of a picture.
#[pyfunction]
pub fn strokes<'py>(
    py: Python<'py>,
    picture: PyReadonlyArray3<'py, u8>,
    groups: Vec<(PyReadonlyArray2<'py, f64>, Vec<usize>, f64, Rgba)>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let mut image = image_in(&picture)?;
    let mut borrowed = Vec::with_capacity(groups.len());
    for (points, starts, width, colour) in &groups {
        borrowed.push((rows::<f64, 2>(points, "points")?.as_flattened(), starts, *width, *colour));
    }
    let image = run::brief(py, || {
        for (points, starts, width, colour) in borrowed {
            image.strokes(points, starts, width, colour)?;
        }
        Ok(image)
    })?;
    image_out(py, image)
}

/// A picture as a PNG file.
#[pyfunction]
pub fn png<'py>(py: Python<'py>, picture: PyReadonlyArray3<'py, u8>) -> PyResult<Bound<'py, PyBytes>> {
    let image = image_in(&picture)?;
    let bytes = run::brief(py, || image.to_png())?;
    Ok(PyBytes::new(py, &bytes))
}
