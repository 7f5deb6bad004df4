//! Order-preserving readers and writers of surfaces and clouds.
//!
//! | format | surfaces | clouds | kept beside positions |
//! |---|---|---|---|
//! | PLY (ASCII, little- and big-endian) | yes | yes | every scalar property of a vertex, in its own type |
//! | OBJ | yes | yes | colours, texture coordinates, normals |
//! | OFF, COFF, NOFF | yes | yes | colours, normals |
//! | STL (binary, ASCII) | yes | | |
//! | XYZ, PTS, CSV | | yes | every column |
//!
//! Each of them also as gzip. Vertices and faces keep the file's order and nothing is merged unless asked; STL alone, which
//! has no shared vertices, is welded where positions are equal. Polygons become n - 2 triangles each. What a file promises
//! is believed only as far as its bytes reach.

mod obj;
mod off;
mod ply;
mod polygon;
mod source;
mod stl;
mod text;
mod values;
mod weld;
mod write;
mod xyz;

pub use values::{Field, Values};

use crate::control::Control;
use crate::error::{Error, Result};
use crate::shape::TriangleMesh;
use polygon::Faces;
use source::{Parsed, Source, Stop};
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

/// A file format this library reads and writes itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Wavefront OBJ.
    Obj,
    /// Stanford PLY.
    Ply,
    /// Stereolithography.
    Stl,
    /// Geomview's object file format.
    Off,
    /// Points, one per line.
    Xyz,
    /// Points, one per line, after their number.
    Pts,
    /// A table with or without a header.
    Csv,
}

impl Format {
    /// The format that a file's name tells; a `.gz` at its end does not count.
    ///
    /// ```
    /// use beltrami::io::Format;
    /// assert_eq!(Format::of("hand.PLY.gz".as_ref()), Some(Format::Ply));
    /// assert_eq!(Format::of("hand.blend".as_ref()), None);
    /// ```
    pub fn of(path: &Path) -> Option<Format> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        Format::named(name.strip_suffix(".gz").unwrap_or(&name).rsplit_once('.')?.1)
    }

    /// The format with that extension, which is also its name.
    pub fn named(extension: &str) -> Option<Format> {
        Some(match extension.to_ascii_lowercase().as_str() {
            "obj" => Format::Obj,
            "ply" => Format::Ply,
            "stl" => Format::Stl,
            "off" | "coff" | "noff" | "cnoff" => Format::Off,
            "xyz" | "xyzn" | "xyzrgb" | "asc" | "txt" => Format::Xyz,
            "pts" => Format::Pts,
            "csv" | "tsv" => Format::Csv,
            _ => return None,
        })
    }

    fn guessed(head: &[u8]) -> Option<Format> {
        if head.starts_with(b"ply\n") || head.starts_with(b"ply\r") {
            Some(Format::Ply)
        } else if head.starts_with(b"OFF") || head.starts_with(b"COFF") || head.starts_with(b"NOFF") {
            Some(Format::Off)
        } else if head.starts_with(b"solid") {
            Some(Format::Stl)
        } else {
            None
        }
    }
}

/// What a file holds: positions in R^D, triangles (none: a cloud), and what belongs to each vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry<'a> {
    /// D.
    pub dimension: usize,
    /// Coordinates, vertex after vertex; finite where they come from a file.
    pub vertices: Cow<'a, [f64]>,
    /// Vertex numbers of the triangles, in range where they come from a file.
    pub faces: Cow<'a, [[u32; 3]]>,
    /// Numbers of each vertex. Colours are called `colors`, normals `normals`, texture coordinates `uv`.
    pub data: Vec<Field>,
}

impl Geometry<'_> {
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.vertices.len().checked_div(self.dimension).unwrap_or(0)
    }

    /// The surface, if there is one.
    ///
    /// # Errors
    /// [`Error::Input`] if there are no triangles.
    pub fn into_mesh<'b>(self) -> Result<TriangleMesh<'b>>
    where
        Self: 'b,
    {
        if self.faces.is_empty() {
            return Err(Error::input(format!("{} points without a triangle are no surface", self.vertex_count())));
        }
        TriangleMesh::new(self.dimension, self.vertices.into_owned(), self.faces.into_owned())
    }

    fn check(&self) -> Result<()> {
        let count = self.vertex_count();
        if self.dimension == 0 || count * self.dimension != self.vertices.len() {
            return Err(Error::input(format!("{} coordinates are no whole number of points in R^{}", self.vertices.len(), self.dimension)));
        }
        if let Some(face) = self.faces.iter().position(|face| face.iter().any(|&corner| corner as usize >= count)) {
            return Err(Error::input(format!("face {face} has corners {:?}, the shape has {count} vertices", self.faces[face])));
        }
        for field in &self.data {
            if field.columns.checked_mul(count) != Some(field.values.len()) || (!field.table && field.columns != 1) {
                return Err(Error::input(format!("data {:?} holds {} numbers for {count} vertices", field.name, field.values.len())));
            }
        }
        Ok(())
    }
}

/// How [`read`] reads.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Reading {
    /// The format; by default as the file's name or its first bytes tell.
    pub format: Option<Format>,
    /// Whether vertices at equal positions become one; by default for STL only.
    pub weld: Option<bool>,
}

/// How [`write()`] writes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Writing {
    /// The format; by default as the file's name tells.
    pub format: Option<Format>,
    /// Text also where the format has a binary form (PLY, STL).
    pub ascii: bool,
}

/// Loads a file with the defaults of [`Reading`].
///
/// ```
/// use beltrami::io::{Field, Geometry, Values, load, save};
/// let path = std::env::temp_dir().join("beltrami-load-example.ply");
/// let square = Geometry {
///     dimension: 2,
///     vertices: vec![0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0].into(),
///     faces: vec![[0, 1, 2], [0, 2, 3]].into(),
///     data: vec![Field { name: "label".into(), columns: 1, table: false, values: Values::I16(vec![1, 2, 3, 4]) }],
/// };
/// save(&path, &square)?;
/// assert_eq!(load(&path)?, square);
/// # std::fs::remove_file(path).ok();
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::File`] names the file, the line or byte, and the cause.
pub fn load(path: impl AsRef<Path>) -> Result<Geometry<'static>> {
    read(path.as_ref(), Reading::default(), &Control::default())
}

/// Saves a shape with the defaults of [`Writing`]; see [`load`] for an example.
///
/// # Errors
/// Those of [`write()`].
pub fn save(path: impl AsRef<Path>, shape: &Geometry<'_>) -> Result<()> {
    write(path.as_ref(), shape, Writing::default(), &Control::default()).map(|_| ())
}

/// Reads a file.
///
/// ```
/// use beltrami::io::{Format, Reading, read};
/// let missing = read("missing.off".as_ref(), Reading::default(), &beltrami::Control::default()).unwrap_err();
/// assert!(missing.to_string().starts_with("missing.off: cannot be read"));
/// ```
///
/// # Errors
/// [`Error::File`] names the file, the line or byte, and the cause; [`Error::Cancelled`].
pub fn read(path: &Path, reading: Reading, control: &Control) -> Result<Geometry<'static>> {
    Source::file(path, control).and_then(|source| parse(source, path, reading, control)).map_err(|stop| stop.within(path))
}

/// Reads what a file holds from memory; `name` stands for the file in errors and tells the format if nothing else does.
///
/// ```
/// use beltrami::io::{Reading, read_bytes};
/// let text = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
/// let shape = read_bytes(text, "triangle.off".as_ref(), Reading::default(), &beltrami::Control::default())?;
/// assert_eq!(shape.faces[..], [[0, 1, 2]]);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// Those of [`read`].
pub fn read_bytes(bytes: &[u8], name: &Path, reading: Reading, control: &Control) -> Result<Geometry<'static>> {
    Source::bytes(bytes, control).and_then(|source| parse(source, name, reading, control)).map_err(|stop| stop.within(name))
}

fn parse(mut source: Source<'_>, path: &Path, reading: Reading, control: &Control) -> Parsed<Geometry<'static>> {
    let format = match reading.format.or_else(|| Format::of(path)) {
        Some(format) => format,
        None => {
            source.need(16)?;
            match Format::guessed(source.window()) {
                Some(format) => format,
                None => return Stop::whole("the format is not known by this name; name it (format=), or convert the file to PLY"),
            }
        }
    };
    let shape = match format {
        Format::Ply => ply::parse(source, control)?,
        Format::Stl => stl::parse(source, control)?,
        Format::Obj => obj::parse(&text::decoded(&source.rest()?), control)?,
        Format::Off => off::parse(&text::decoded(&source.rest()?), control)?,
        Format::Xyz | Format::Pts | Format::Csv => xyz::parse(&text::decoded(&source.rest()?), format, path, control)?,
    };
    if shape.vertex_count() > i32::MAX as usize {
        return Stop::whole(format!("{} vertices; a shape can have up to 2^31 - 1", shape.vertex_count()));
    }
    Ok(if reading.weld.unwrap_or(format == Format::Stl) { weld::welded(shape, control)? } else { shape })
}

/// Writes a shape and says what of its data the format has no place for, by name.
///
/// PLY holds everything. Reals are written so that they read back as the same bits (binary STL alone has single precision).
///
/// ```
/// use beltrami::io::{Geometry, Writing, write};
/// let path = std::env::temp_dir().join("beltrami-write-example.off");
/// let triangle = Geometry {
///     dimension: 3,
///     vertices: vec![0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1, 0.0].into(),
///     faces: vec![[0, 1, 2]].into(),
///     data: vec![],
/// };
/// let lost = write(&path, &triangle, Writing::default(), &beltrami::Control::default())?;
/// assert!(lost.is_empty());
/// assert_eq!(std::fs::read_to_string(&path).unwrap(), "OFF\n3 1 0\n0 0 0\n0.1 0 0\n0 0.1 0\n3 0 1 2\n");
/// # std::fs::remove_file(path).ok();
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::File`] if the format is not known by the name, cannot hold such a shape, or the file cannot be written;
/// [`Error::Input`] if the shape's arrays do not fit each other; [`Error::Cancelled`].
pub fn write(path: &Path, shape: &Geometry<'_>, writing: Writing, control: &Control) -> Result<Vec<String>> {
    shape.check()?;
    write::write(path, shape, writing, control).map_err(|stop| stop.within(path))
}

/// The shape with one vertex a position: the first of each in order, with its data. Minus zero counts as zero.
///
/// ```
/// use beltrami::io::{Geometry, weld};
/// let vertices = vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0, 1.0];
/// let soup = Geometry { dimension: 2, vertices: vertices.into(), faces: vec![[0, 1, 2], [3, 4, 5]].into(), data: vec![] };
/// let square = weld(soup, &beltrami::Control::default())?;
/// assert_eq!((square.vertex_count(), &square.faces[..]), (4, &[[0, 1, 2], [2, 1, 3]][..]));
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if the shape's arrays do not fit each other; [`Error::Cancelled`].
pub fn weld<'a>(shape: Geometry<'a>, control: &Control) -> Result<Geometry<'a>> {
    shape.check()?;
    weld::welded(shape, control).map_err(bare)
}

/// The error where no file is involved.
fn bare(stop: Stop) -> Error {
    match stop {
        Stop::Cancelled => Error::Cancelled,
        Stop::At(_, cause) => Error::input(cause),
    }
}

/// Polygons, as the numbers of their corners one after the other, into n - 2 triangles each, in the order of the faces;
/// polygons of less than three corners give none.
///
/// ```
/// use beltrami::io::triangulate;
/// let dart = [0.0, 0.0, 2.0, -1.0, 0.5, 0.0, 2.0, 1.0]; // its corner 2 points inward
/// assert_eq!(triangulate(2, &dart, &[4], &[0, 1, 2, 3], &beltrami::Control::default())?, [[0, 1, 2], [0, 2, 3]]);
/// # Ok::<(), beltrami::Error>(())
/// ```
///
/// # Errors
/// [`Error::Input`] if `sizes` do not add up to the corners or a corner is no vertex; [`Error::Cancelled`].
pub fn triangulate(dimension: usize, vertices: &[f64], sizes: &[usize], corners: &[u32], control: &Control) -> Result<Vec<[u32; 3]>> {
    let count = vertices.len().checked_div(dimension).unwrap_or(0);
    let mut faces = Faces::default();
    let mut left = corners;
    for (face, &size) in sizes.iter().enumerate() {
        let Some((corners, rest)) = left.split_at_checked(size) else {
            return Err(Error::input(format!("polygon {face} has {size} corners, {} are left", left.len())));
        };
        faces.polygon(corners);
        left = rest;
    }
    if !left.is_empty() {
        return Err(Error::input(format!("{} corners belong to no polygon", left.len())));
    }
    if let Some((face, corner)) = faces.outside(count) {
        return Err(Error::input(format!("face {face} refers to vertex {corner}, the mesh has {count} vertices")));
    }
    faces.into_triangles(vertices, dimension, control).map_err(bare)
}

/// Message for a position that is no number of R.
fn not_finite(vertex: usize, number: f64) -> String {
    format!("a coordinate of vertex {vertex} is {number}; positions must be finite")
}

/// Fields with names of their own: where a file repeats `name`, the next is called `name_2`.
#[derive(Default)]
struct Fields {
    fields: Vec<Field>,
    counts: HashMap<String, usize>, // up to which number each name is taken
}

impl Fields {
    fn push(&mut self, mut field: Field) {
        if let Some(mut count) = self.counts.get(&field.name).copied() {
            let wanted = field.name;
            loop {
                count += 1;
                field.name = format!("{wanted}_{count}");
                if !self.counts.contains_key(&field.name) {
                    break;
                }
            }
            self.counts.insert(wanted, count);
        }
        self.counts.insert(field.name.clone(), 1);
        self.fields.push(field);
    }
}
