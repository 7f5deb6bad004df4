//! Wavefront OBJ: positions, faces, and colours, texture coordinates and normals of the vertices.

use super::source::{Parsed, Stop};
use super::text::{CONTINUED, Text, number, shown, whole};
use super::values::{Field, Values};
use super::{Faces, Geometry};
use crate::control::Control;

const NONE: u32 = u32::MAX;
const MIXED: u32 = u32::MAX - 1;

/// Which entry of a further list (texture coordinates, normals) goes with each vertex.
#[derive(Default)]
struct Links {
    of_vertex: Vec<u32>,
    used: bool,
}

impl Links {
    /// Notes an entry for a vertex; returns what stood there before if it differs.
    fn note(&mut self, vertex: u32, entry: u32) -> Option<&mut u32> {
        self.used = true;
        let vertex = vertex as usize;
        if self.of_vertex.len() <= vertex {
            self.of_vertex.resize(vertex + 1, NONE);
        }
        let link = &mut self.of_vertex[vertex];
        if *link == NONE {
            *link = entry;
        }
        (*link != entry).then_some(link)
    }

    /// The table of entries in the order of vertices; nothing if a corner's vertex lacks one or has several.
    fn table(&self, name: &str, columns: usize, entries: &[f64], count: usize, corners: &[u32]) -> Option<Field> {
        if !self.used {
            return None;
        }
        let entry = |vertex: usize| {
            let link = self.of_vertex.get(vertex).copied().filter(|&link| link < MIXED)? as usize;
            entries.get(link * columns..(link + 1) * columns)
        };
        if corners.iter().any(|&corner| entry(corner as usize).is_none()) {
            return None;
        }
        let zero = [0.0; 3]; // vertices of no face
        let values = (0..count).flat_map(|vertex| entry(vertex).unwrap_or(&zero[..columns]).iter().copied()).collect();
        Some(Field::table(name, columns, Values::F64(values)))
    }
}

pub(super) fn parse(bytes: &[u8], control: &Control) -> Parsed<Geometry<'static>> {
    let mut text = Text::new(bytes, 1, &CONTINUED, control);
    let mut vertices: Vec<f64> = Vec::new();
    let mut colors: Vec<f64> = Vec::new();
    let mut color_width = None;
    let (mut textures, mut normals): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
    let (mut texture_links, mut normal_links) = (Links::default(), Links::default());
    let mut faces = Faces::default();
    let mut polygon = Vec::new();
    let mut unknown = None;
    let mut more = text.more()?;
    while more {
        match text.word().unwrap_or_default() {
            b"v" => {
                for _ in 0..3 {
                    vertices.push(text.coordinate()?);
                }
                let mut extra = [0.0; 5];
                let mut width = 0;
                while let Some(word) = text.word() {
                    let Some(value) = number(word) else {
                        return Stop::line(text.line(), format!("{:?} is no number", shown(word)));
                    };
                    if width < extra.len() {
                        extra[width] = value;
                    }
                    width += 1;
                }
                // x y z w: a weight that polygons do not use; x y z r g b; x y z r g b a
                let width = if matches!(width, 3 | 4) { width } else { 0 };
                if *color_width.get_or_insert(width) != width {
                    color_width = Some(0); // only some vertices have a colour
                }
                if color_width != Some(0) {
                    colors.extend_from_slice(&extra[..width]);
                }
            }
            b"vt" => {
                let first = text.number("texture coordinate")?;
                let second = text.word().map_or(Some(0.0), number);
                let Some(second) = second else { return Stop::line(text.line(), "a texture coordinate is no number") };
                textures.extend([first, second]);
            }
            b"vn" => {
                for _ in 0..3 {
                    normals.push(text.number("normal")?);
                }
            }
            b"f" => {
                polygon.clear();
                let line = text.line();
                while let Some(word) = text.word() {
                    let mut parts = word.split(|&byte| byte == b'/');
                    let vertex = index(parts.next().unwrap_or_default(), vertices.len() / 3, bytes.len(), line, faces.count(), word)?;
                    polygon.push(vertex);
                    if let Some(part) = parts.next().filter(|part| !part.is_empty()) {
                        let entry = index(part, textures.len() / 2, bytes.len(), line, faces.count(), word)?;
                        texture_links.note(vertex, entry); // along a seam the first one counts
                    }
                    if let Some(part) = parts.next().filter(|part| !part.is_empty()) {
                        let entry = index(part, normals.len() / 3, bytes.len(), line, faces.count(), word)?;
                        if let Some(link) = normal_links.note(vertex, entry) {
                            let same = |a: u32, b: u32| {
                                normals.get(a as usize * 3..a as usize * 3 + 3) == normals.get(b as usize * 3..b as usize * 3 + 3)
                            };
                            if *link != MIXED && !same(*link, entry) {
                                *link = MIXED; // the corners' normals differ: none of them is the vertex's
                            }
                        }
                    }
                }
                faces.polygon(&polygon);
            }
            b"g" | b"o" | b"s" | b"l" | b"p" | b"vp" | b"usemtl" | b"mtllib" => {}
            word => {
                unknown.get_or_insert((text.line(), shown(word)));
            }
        }
        more = text.next_line()?;
    }
    let count = vertices.len() / 3;
    if let (0, Some((line, word))) = (count, unknown) {
        return Stop::line(line, format!("{word:?} is no word of an OBJ file, and no vertex is in it"));
    }
    if let Some((face, corner)) = faces.outside(count) {
        return Stop::line(
            line_of_face(bytes, face, control)?,
            format!("face {face} refers to vertex {}, the file has {count} vertices", i64::from(corner) + 1),
        );
    }
    let mut data = Vec::new();
    if let Some(width) = color_width.filter(|&width| width > 0) {
        data.push(Field::table("colors", width, Values::F64(colors)));
    }
    let corners = faces.all_corners();
    data.extend(texture_links.table("uv", 2, &textures, count, corners));
    if corners.is_empty() && count > 0 && normals.len() == vertices.len() {
        data.push(Field::table("normals", 3, Values::F64(normals)));
    } else {
        data.extend(normal_links.table("normals", 3, &normals, count, corners));
    }
    let faces = faces.into_triangles(&vertices, 3, control)?;
    Ok(Geometry { dimension: 3, vertices: vertices.into(), faces: faces.into(), data })
}

/// An index of a face's corner, from 0: given from 1, or from the last entry backwards. It may be ahead of its entry, but no
/// file holds as many entries as bytes.
#[inline]
fn index(part: &[u8], count: usize, most: usize, line: usize, face: usize, word: &[u8]) -> Parsed<u32> {
    let wrong = |cause: String| Stop::line(line, format!("face {face}: {cause}"));
    match whole(part) {
        Some(given) if given > 0 && given < i64::from(MIXED).min(most as i64) => Ok((given - 1) as u32),
        Some(given) if given < 0 && given >= -(count as i64) => Ok((count as i64 + given) as u32),
        Some(0) => wrong(format!("corner {:?} has index 0; OBJ counts from 1", shown(word))),
        Some(given) => wrong(format!("corner {:?} refers to entry {given}, there are {count} so far", shown(word))),
        None => wrong(format!("corner {:?} has no whole number where an index should be", shown(word))),
    }
}

/// Line of the face with that number, counted once more: an index may be ahead of its vertex, so it is judged at the end.
fn line_of_face(bytes: &[u8], face: usize, control: &Control) -> Parsed<usize> {
    let mut text = Text::new(bytes, 1, &CONTINUED, control);
    let mut seen = 0;
    let mut more = text.more()?;
    while more {
        if text.word() == Some(b"f") {
            if seen == face {
                break;
            }
            seen += 1;
        }
        more = text.next_line()?;
    }
    Ok(text.line())
}
