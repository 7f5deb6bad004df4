//! Geomview's OFF with colours (COFF) and normals (NOFF) of the vertices.

use super::source::{Parsed, Stop, reserved};
use super::text::{COMMENTED, Text, number, shown, whole};
use super::values::{Field, Values};
use super::{Faces, Geometry};
use crate::control::Control;

pub(super) fn parse(bytes: &[u8], control: &Control) -> Parsed<Geometry<'static>> {
    let mut text = Text::new(bytes, 1, &COMMENTED, control);
    if !text.more()? {
        return Stop::line(text.line(), "the file is empty; an OFF file begins with the line `OFF`");
    }
    let word = text.word().unwrap_or_default();
    let (colored, with_normals) = match word {
        b"OFF" => (false, false),
        b"COFF" => (true, false),
        b"NOFF" => (false, true),
        b"CNOFF" | b"NCOFF" => (true, true),
        _ if word.ends_with(b"OFF") && word.len() <= 9 => {
            return Stop::line(text.line(), format!("{:?} is not read (of OFF's variants COFF and NOFF are)", shown(word)));
        }
        _ => return Stop::line(text.line(), format!("{:?} is not `OFF`, with which an OFF file begins", shown(word))),
    };
    let mut first = text.word();
    if first == Some(b"BINARY") {
        return Stop::line(text.line(), "binary OFF is not read; convert it to PLY");
    }
    if first.is_none() {
        if !text.more()? {
            return Stop::line(text.line(), "the numbers of vertices and faces are missing");
        }
        first = text.word();
    }
    let Some(count) = first.and_then(whole).and_then(|count| usize::try_from(count).ok()) else {
        return Stop::line(text.line(), format!("{:?} is no number of vertices", shown(first.unwrap_or_default())));
    };
    let face_count = text.count("number of faces")?;
    let least = if with_normals { 12 } else { 6 }; // bytes of a line
    let mut vertices = reserved(3 * count.min(bytes.len() / least + 1))?;
    let mut extras = Extras::default();
    for vertex in 0..count {
        if !text.next_line()? {
            return Stop::line(text.line(), format!("the file ends after {vertex} of {count} vertices"));
        }
        for _ in 0..3 {
            vertices.push(text.coordinate()?);
        }
        extras.line(&mut text, vertex, if colored { with_normals as usize * 3 + 3 } else { with_normals as usize * 3 })?;
    }
    let mut faces = Faces::with_room(face_count.min(bytes.len() / 8 + 1))?;
    let mut polygon = Vec::new();
    for face in 0..face_count {
        if !text.next_line()? {
            return Stop::line(text.line(), format!("the file ends after {face} of {face_count} faces"));
        }
        let size = text.count("number of corners")?;
        polygon.clear();
        for _ in 0..size {
            let corner = text.whole("corner of the face")?;
            if !(0..count as i64).contains(&corner) {
                return Stop::line(text.line(), format!("face {face} refers to vertex {corner}, the file has {count} vertices"));
            }
            polygon.push(corner as u32);
        }
        faces.polygon(&polygon); // what follows in the line is the face's colour
    }
    if text.next_line()? {
        return Stop::line(text.line(), format!("more lines than {count} vertices and {face_count} faces"));
    }
    let data = extras.fields(with_normals);
    let faces = faces.into_triangles(&vertices, 3, control)?;
    Ok(Geometry { dimension: 3, vertices: vertices.into(), faces: faces.into(), data })
}

/// Numbers beyond the position: the same many in each line, else they are dropped.
#[derive(Default)]
struct Extras {
    width: usize,
    values: Vec<f64>,
    bytes: bool,
}

impl Extras {
    fn line(&mut self, text: &mut Text<'_>, vertex: usize, least: usize) -> Parsed<()> {
        let mut width = 0;
        if vertex == 0 {
            self.bytes = true;
        }
        while let Some(word) = text.word() {
            let Some(value) = number(word) else {
                return Stop::line(text.line(), format!("vertex {vertex}: {:?} is no number", shown(word)));
            };
            width += 1;
            if vertex == 0 || self.width > 0 {
                self.values.push(value);
                // colours are the last numbers of the line; the first three may be normals
                self.bytes &= width <= least.saturating_sub(3) || whole(word).is_some_and(|value| (0..256).contains(&value));
            }
        }
        if width < least {
            return Stop::line(text.line(), format!("vertex {vertex} has {width} numbers after its position, {least} are needed"));
        }
        if vertex == 0 {
            self.width = width;
        } else if width != self.width {
            if least > 0 {
                return Stop::line(
                    text.line(),
                    format!("vertex {vertex} has {width} numbers after its position, those before have {}", self.width),
                );
            }
            (self.width, self.values) = (0, Vec::new());
        }
        Ok(())
    }

    fn fields(self, with_normals: bool) -> Vec<Field> {
        let columns =
            |from: usize, to: usize| self.values.chunks_exact(self.width.max(1)).flat_map(move |row| row[from..to].iter().copied());
        let mut data = Vec::new();
        let mut at = 0;
        if with_normals && self.width >= 3 {
            data.push(Field::table("normals", 3, Values::F64(columns(0, 3).collect())));
            at = 3;
        }
        if matches!(self.width - at, 3 | 4) {
            let width = self.width - at;
            let values = if self.bytes {
                Values::U8(columns(at, self.width).map(|value| value as u8).collect())
            } else {
                Values::F64(columns(at, self.width).collect())
            };
            data.push(Field::table("colors", width, values));
        }
        data
    }
}
