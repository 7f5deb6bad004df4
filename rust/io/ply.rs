//! Stanford PLY: ASCII, little- and big-endian; streamed, so that a file of any size needs little more than what it holds.

use super::source::{Parsed, Source, Stop, reserved};
use super::text::{PLAIN, Text, number, shown, whole};
use super::values::{Field, Scalar, Stored, Values, at, with_number, with_values};
use super::{Faces, Fields, Geometry, not_finite};
use crate::control::Control;
use std::collections::HashMap;

const LONGEST_HEADER: usize = 1 << 20;
const MOST_PROPERTIES: usize = 4096;
const RESERVED_ON_TRUST: usize = 1 << 16; // rows, where the file's length is not known

/// Comments of this library's own writer begin so; they tell what PLY itself has no words for.
pub(super) const HINT: &str = "beltrami";

struct Property {
    name: String,
    list: Option<Scalar>,
    kind: Scalar,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

impl Element {
    /// Bytes of a record, and the offset of each property in it; nothing if there are lists.
    fn layout(&self) -> Option<(usize, Vec<usize>)> {
        let mut stride = 0;
        let mut offsets = Vec::with_capacity(self.properties.len());
        for property in &self.properties {
            if property.list.is_some() {
                return None;
            }
            offsets.push(stride);
            stride += property.kind.size();
        }
        Some((stride, offsets))
    }
}

struct Hint {
    property: String,
    columns: usize,
    table: bool,
    kind: String,
    name: String,
}

#[derive(Default)]
struct Header {
    elements: Vec<Element>,
    hints: Vec<Hint>,
    dimension: Option<usize>,
    lines: usize,
    ascii: bool,
    big: bool,
}

fn scalar(word: &str) -> Option<Scalar> {
    Some(match word {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "int64" => Scalar::I64,
        "uint64" => Scalar::U64,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

fn header(source: &mut Source<'_>) -> Parsed<Header> {
    if !source.need(4)? || &source.window()[..3] != b"ply" || !matches!(source.window()[3], b'\n' | b'\r') {
        return Stop::line(1, "a PLY file begins with the line `ply`");
    }
    let newline = if source.need(5)? && source.window()[3] == b'\r' && source.window()[4] != b'\n' { b'\r' } else { b'\n' };
    let mut header = Header::default();
    let mut format = false;
    loop {
        let mut length = 0;
        let line = loop {
            if let Some(end) = source.window()[length..].iter().position(|&byte| byte == newline) {
                let line = String::from_utf8_lossy(&source.window()[..length + end]).into_owned();
                source.take(length + end + 1);
                break line;
            }
            length = source.window().len();
            if source.position() + length > LONGEST_HEADER || !source.need(length + 1)? {
                return Stop::line(header.lines + 1, "the header does not end: no line `end_header`");
            }
        };
        header.lines += 1;
        let at = header.lines;
        if at == 1 {
            continue;
        }
        let words: Vec<&str> = line.split_whitespace().collect();
        match *words.as_slice() {
            ["format", kind, ..] => {
                format = true;
                (header.ascii, header.big) = match kind {
                    "ascii" => (true, false),
                    "binary_little_endian" => (false, false),
                    "binary_big_endian" => (false, true),
                    _ => return Stop::line(at, format!("format {kind:?} is not ascii, binary_little_endian or binary_big_endian")),
                };
            }
            ["element", name, count] => {
                let Some(count) = count.parse::<usize>().ok().filter(|&count| count < 1 << 48) else {
                    return Stop::line(at, format!("{count:?} is no number of {name} elements"));
                };
                header.elements.push(Element { name: name.into(), count, properties: Vec::new() });
            }
            ["property", ref kinds @ .., name] => {
                let Some(element) = header.elements.last_mut() else {
                    return Stop::line(at, "a property stands before the first element");
                };
                let (list, kind) = match *kinds {
                    [kind] => (None, kind),
                    ["list", length, kind] => (Some(length), kind),
                    _ => return Stop::line(at, format!("{line:?} is no property")),
                };
                let known = |word: &str| scalar(word).map_or_else(|| Stop::line(at, format!("{word:?} is no type of PLY")), Ok);
                let list = list.map(known).transpose()?;
                if list.is_some_and(Scalar::is_float) {
                    return Stop::line(at, "the length of a list cannot be a float");
                }
                if element.properties.len() >= MOST_PROPERTIES {
                    return Stop::line(at, format!("element {:?} has more than {MOST_PROPERTIES} properties", element.name));
                }
                if element.properties.iter().any(|property| property.name == name) {
                    return Stop::line(at, format!("property {name:?} is there twice"));
                }
                let kind = known(kind)?;
                element.properties.push(Property { name: name.into(), list, kind });
            }
            ["comment", HINT, "dimension", dimension] => header.dimension = dimension.parse().ok().filter(|&d: &usize| d > 3),
            ["comment", HINT, "field", property, columns, kind, ..] => {
                let name = line.splitn(7, ' ').nth(6).unwrap_or("").trim_end_matches('\r');
                if let Some(columns) = if columns == "vector" { Some(1) } else { columns.parse().ok() } {
                    let table = line.split_whitespace().nth(4) != Some("vector");
                    header.hints.push(Hint { property: property.into(), columns, table, kind: kind.into(), name: name.into() });
                }
            }
            ["end_header", ..] if format => return Ok(header),
            ["end_header", ..] => return Stop::line(at, "the header names no format"),
            [] | ["comment" | "obj_info", ..] => {}
            [word, ..] => return Stop::line(at, format!("{:?} is no word of a PLY header", shown(word.as_bytes()))),
        }
    }
}

/// A number of the body before it finds its place.
enum Number {
    Whole(i64),
    Huge(u64),
    Real(f64),
}

impl Number {
    fn double(&self) -> f64 {
        match *self {
            Number::Whole(number) => number as f64,
            Number::Huge(number) => number as f64,
            Number::Real(number) => number,
        }
    }

    fn whole(&self) -> Option<i64> {
        match *self {
            Number::Whole(number) => Some(number),
            Number::Huge(number) => number.try_into().ok(),
            Number::Real(number) => (number == number.trunc() && number.abs() < 9e15).then_some(number as i64),
        }
    }
}

/// Either kind of body, number by number.
enum Body<'t, 's> {
    Ascii(Text<'t>),
    Binary(Source<'s>, bool),
}

impl Body<'_, '_> {
    fn stop<T>(&self, cause: String) -> Parsed<T> {
        match self {
            Body::Ascii(text) => Stop::line(text.line(), cause),
            Body::Binary(source, _) => Stop::byte(source.position(), cause),
        }
    }

    fn number(&mut self, kind: Scalar, element: &Element, row: usize) -> Parsed<Number> {
        match self {
            Body::Ascii(text) => {
                if !text.more()? {
                    return Stop::line(text.line(), format!("the file ends within {} {row} of {}", element.name, element.count));
                }
                let word = text.word().unwrap_or_default();
                let read = if kind.is_float() {
                    number(word).map(Number::Real)
                } else if kind == Scalar::U64 && word.len() > 18 {
                    std::str::from_utf8(word).ok().and_then(|word| word.parse().ok()).map(Number::Huge)
                } else {
                    whole(word).map(Number::Whole).or_else(|| number(word).filter(|real| real.is_finite()).map(Number::Real))
                };
                read.map_or_else(|| Stop::line(text.line(), format!("{} {row}: {:?} is no number", element.name, shown(word))), Ok)
            }
            Body::Binary(source, swap) => {
                let size = kind.size();
                if !source.need(size)? {
                    return ends(source, element, row);
                }
                let record = source.window();
                let number = match kind {
                    Scalar::U64 => Number::Huge(at(record, 0, *swap)),
                    Scalar::F32 => Number::Real(at::<f32>(record, 0, *swap).into()),
                    Scalar::F64 => Number::Real(at(record, 0, *swap)),
                    _ => with_number!(kind, record, 0, *swap, number => Number::Whole(number as i64)),
                };
                source.take(size);
                Ok(number)
            }
        }
    }

    /// Length of a list, which is believed only as far as the bytes of the file reach.
    fn list_length(&mut self, length: Scalar, kind: Scalar, element: &Element, row: usize) -> Parsed<usize> {
        let number = self.number(length, element, row)?;
        let Some(count) = number.whole().and_then(|count| usize::try_from(count).ok()) else {
            return self.stop(format!("{} {row}: a list cannot have {} entries", element.name, number.double()));
        };
        let possible = match self {
            Body::Ascii(text) => text.length(),
            Body::Binary(source, _) => source.left().unwrap_or(usize::MAX) / kind.size(),
        };
        if count > possible {
            return self.stop(format!("{} {row}: a list of {count} entries is longer than the file", element.name));
        }
        Ok(count)
    }

    fn list(&mut self, length: Scalar, kind: Scalar, element: &Element, row: usize, out: &mut Vec<Number>) -> Parsed<()> {
        out.clear();
        for _ in 0..self.list_length(length, kind, element, row)? {
            out.push(self.number(kind, element, row)?);
        }
        Ok(())
    }

    fn skip(&mut self, element: &Element) -> Parsed<()> {
        if let (Body::Binary(source, _), Some((stride, _))) = (&mut *self, element.layout()) {
            let mut left = element.count.saturating_mul(stride);
            while left > 0 {
                if !source.need(1)? {
                    return ends(source, element, element.count.saturating_sub(left.div_ceil(stride)));
                }
                let here = source.window().len().min(left);
                source.take(here);
                left -= here;
            }
            return Ok(());
        }
        if element.properties.is_empty() {
            return Ok(()); // rows of nothing, however many
        }
        for row in 0..element.count {
            for property in &element.properties {
                let count = property.list.map_or(Ok(1), |length| self.list_length(length, property.kind, element, row))?;
                for _ in 0..count {
                    self.number(property.kind, element, row)?;
                }
            }
        }
        Ok(())
    }

    fn possible_rows(&self, element: &Element) -> usize {
        let least: usize = element.properties.iter().map(|property| property.list.unwrap_or(property.kind).size()).sum();
        match self {
            Body::Ascii(text) => element.count.min(text.length() / (2 * element.properties.len()).max(1) + 1),
            Body::Binary(source, _) => element.count.min(source.left().map_or(RESERVED_ON_TRUST, |left| left / least.max(1) + 1)),
        }
    }
}

fn ends<T>(source: &Source<'_>, element: &Element, row: usize) -> Parsed<T> {
    Stop::byte(source.position() + source.window().len(), format!("the file ends within {} {row} of {}", element.name, element.count))
}

pub(super) fn parse(mut source: Source<'_>, control: &Control) -> Parsed<Geometry<'static>> {
    let header = header(&mut source)?;
    let bytes;
    let mut body = if header.ascii {
        bytes = source.rest()?;
        Body::Ascii(Text::new(&bytes, header.lines + 1, &PLAIN, control))
    } else {
        Body::Binary(source, header.big == cfg!(target_endian = "little"))
    };
    let Some(count) = header.elements.iter().find(|element| element.name == "vertex").map(|element| element.count) else {
        return Stop::line(header.lines, "the header has no element `vertex`");
    };
    if count > i32::MAX as usize {
        return Stop::line(header.lines, format!("{count} vertices; a shape can have up to 2^31 - 1"));
    }
    let mut vertices = None;
    let mut faces = Faces::default();
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" if vertices.is_none() => vertices = Some(read_vertices(&mut body, element, &header)?),
            "face" => read_faces(&mut body, element, count, &mut faces)?,
            "tristrips" => read_strips(&mut body, element, count, &mut faces)?,
            _ => body.skip(element)?,
        }
    }
    if let Body::Ascii(text) = &mut body
        && text.more()?
    {
        return Stop::line(text.line(), "more numbers than the header announces");
    }
    let Some((dimension, vertices, columns)) = vertices else {
        return Stop::line(header.lines, "the header has no element `vertex`");
    };
    let faces = faces.into_triangles(&vertices, dimension, control)?;
    Ok(Geometry { dimension, vertices: vertices.into(), faces: faces.into(), data: grouped(columns, &header.hints) })
}

enum Target {
    Coordinate(usize),
    Column(Values),
    List { width: Option<usize>, values: Values },
}

type Vertices = (usize, Vec<f64>, Vec<Field>);

fn read_vertices(body: &mut Body<'_, '_>, element: &Element, header: &Header) -> Parsed<Vertices> {
    let scalar_named = |name: &str| element.properties.iter().any(|property| property.name == name && property.list.is_none());
    let mut names: Vec<String> = ["x", "y", "z"].into_iter().filter(|name| scalar_named(name)).map(String::from).collect();
    let further: Vec<String> = (3..header.dimension.unwrap_or(3).min(element.properties.len())).map(|axis| format!("x{axis}")).collect();
    if names.len() == 3 && header.dimension == Some(3 + further.len()) && further.iter().all(|name| scalar_named(name)) {
        names.extend(further);
    }
    if names.len() < 2 || names[1] != "y" {
        return Stop::line(header.lines, "the vertices have no properties x and y");
    }
    let dimension = names.len();
    let floats_as_doubles = header.ascii; // text may hold more digits than the declared type
    let mut targets: Vec<Target> = element
        .properties
        .iter()
        .map(|property| {
            let kind = if floats_as_doubles && property.kind == Scalar::F32 { Scalar::F64 } else { property.kind };
            match names.iter().position(|name| *name == property.name) {
                Some(axis) if property.list.is_none() => Target::Coordinate(axis),
                _ if property.list.is_some() => Target::List { width: None, values: kind.empty() },
                _ => Target::Column(kind.empty()),
            }
        })
        .collect();
    let mut vertices = reserved(body.possible_rows(element) * dimension)?;
    let layout = element.layout();
    match (body, layout) {
        (Body::Binary(source, swap), Some(layout)) => {
            read_records(source, *swap, element, layout, dimension, &mut vertices, &mut targets)?;
        }
        (body, _) => {
            let mut list = Vec::new();
            for row in 0..element.count {
                let start = vertices.len();
                vertices.resize(start + dimension, 0.0);
                for (property, target) in element.properties.iter().zip(&mut targets) {
                    match (target, property.list) {
                        (Target::List { width, values }, Some(length)) => {
                            body.list(length, property.kind, element, row, &mut list)?;
                            if row == 0 {
                                *width = Some(list.len());
                            } else if *width != Some(list.len()) {
                                *width = None; // lists of several lengths are no table
                            }
                            if width.is_some() {
                                for number in &list {
                                    store(values, number, body, element, row)?;
                                }
                            }
                        }
                        (Target::Coordinate(axis), _) => {
                            let number = body.number(property.kind, element, row)?.double();
                            if !number.is_finite() {
                                return body.stop(not_finite(row, number));
                            }
                            vertices[start + *axis] = number;
                        }
                        (Target::Column(values) | Target::List { values, .. }, _) => {
                            let number = body.number(property.kind, element, row)?;
                            store(values, &number, body, element, row)?;
                        }
                    }
                }
            }
        }
    }
    let columns = element
        .properties
        .iter()
        .zip(targets)
        .filter_map(|(property, target)| match target {
            Target::Column(values) => Some(Field::vector(&property.name, values)),
            Target::List { width: Some(width), values } if width > 0 && values.len() == width * element.count => {
                Some(Field::table(&property.name, width, values))
            }
            _ => None,
        })
        .collect();
    Ok((dimension, vertices, columns))
}

/// Appends a number to values of its type.
fn store(values: &mut Values, number: &Number, body: &Body<'_, '_>, element: &Element, row: usize) -> Parsed<()> {
    fn push<T: TryFrom<i64>>(vector: &mut Vec<T>, number: &Number) -> bool {
        number.whole().and_then(|number| T::try_from(number).ok()).map(|number| vector.push(number)).is_some()
    }
    let fits = match values {
        Values::F32(vector) => {
            vector.push(number.double() as f32);
            true
        }
        Values::F64(vector) => {
            vector.push(number.double());
            true
        }
        Values::U64(vector) => match *number {
            Number::Huge(number) => {
                vector.push(number);
                true
            }
            _ => push(vector, number),
        },
        Values::I8(vector) => push(vector, number),
        Values::U8(vector) => push(vector, number),
        Values::I16(vector) => push(vector, number),
        Values::U16(vector) => push(vector, number),
        Values::I32(vector) => push(vector, number),
        Values::U32(vector) => push(vector, number),
        Values::I64(vector) => push(vector, number),
        Values::Bool(_) => false,
    };
    if fits { Ok(()) } else { body.stop(format!("{} {row}: {} does not fit type {}", element.name, number.double(), values.type_name())) }
}

/// Records of scalars alone: a block at a time, column by column.
fn read_records(
    source: &mut Source<'_>,
    swap: bool,
    element: &Element,
    (stride, offsets): (usize, Vec<usize>),
    dimension: usize,
    vertices: &mut Vec<f64>,
    targets: &mut [Target],
) -> Parsed<()> {
    if let Some(left) = source.left().filter(|&left| left / stride < element.count) {
        return Stop::byte(
            source.position(),
            format!("the header announces {} vertices of {stride} bytes, {left} bytes are left", element.count),
        );
    }
    let rows = if source.left().is_some() { element.count } else { element.count.min(RESERVED_ON_TRUST) };
    for target in &mut *targets {
        if let Target::Column(values) = target {
            with_values!(values, vector => *vector = reserved(rows)?);
        }
    }
    let mut done = 0;
    while done < element.count {
        if !source.need(stride)? {
            return ends(source, element, done);
        }
        let rows = (source.window().len() / stride).min(element.count - done);
        let block = &source.window()[..rows * stride];
        let start = vertices.len();
        vertices.resize(start + rows * dimension, 0.0);
        let places = &mut vertices[start..];
        for ((property, &offset), target) in element.properties.iter().zip(&offsets).zip(&mut *targets) {
            match target {
                Target::Coordinate(axis) => match property.kind {
                    Scalar::I8 => spread::<i8>(block, stride, offset, swap, places, dimension, *axis),
                    Scalar::U8 => spread::<u8>(block, stride, offset, swap, places, dimension, *axis),
                    Scalar::I16 => spread::<i16>(block, stride, offset, swap, places, dimension, *axis),
                    Scalar::U16 => spread::<u16>(block, stride, offset, swap, places, dimension, *axis),
                    Scalar::I32 => spread::<i32>(block, stride, offset, swap, places, dimension, *axis),
                    Scalar::U32 => spread::<u32>(block, stride, offset, swap, places, dimension, *axis),
                    Scalar::I64 => spread::<i64>(block, stride, offset, swap, places, dimension, *axis),
                    Scalar::U64 => spread::<u64>(block, stride, offset, swap, places, dimension, *axis),
                    Scalar::F32 => spread::<f32>(block, stride, offset, swap, places, dimension, *axis),
                    Scalar::F64 => spread::<f64>(block, stride, offset, swap, places, dimension, *axis),
                },
                Target::Column(values) | Target::List { values, .. } => match values {
                    Values::Bool(_) => {}
                    Values::I8(vector) => append(block, stride, offset, swap, vector),
                    Values::U8(vector) => append(block, stride, offset, swap, vector),
                    Values::I16(vector) => append(block, stride, offset, swap, vector),
                    Values::U16(vector) => append(block, stride, offset, swap, vector),
                    Values::I32(vector) => append(block, stride, offset, swap, vector),
                    Values::U32(vector) => append(block, stride, offset, swap, vector),
                    Values::I64(vector) => append(block, stride, offset, swap, vector),
                    Values::U64(vector) => append(block, stride, offset, swap, vector),
                    Values::F32(vector) => append(block, stride, offset, swap, vector),
                    Values::F64(vector) => append(block, stride, offset, swap, vector),
                },
            }
        }
        if let Some(at) = places.iter().position(|number| !number.is_finite()) {
            return Stop::byte(source.position() + at / dimension * stride, not_finite(done + at / dimension, places[at]));
        }
        source.take(rows * stride);
        done += rows;
    }
    Ok(())
}

fn spread<T: Stored>(block: &[u8], stride: usize, offset: usize, swap: bool, places: &mut [f64], dimension: usize, axis: usize) {
    for (record, place) in block.chunks_exact(stride).zip(places.chunks_exact_mut(dimension)) {
        place[axis] = at::<T>(record, offset, swap).as_double();
    }
}

fn append<T: Stored>(block: &[u8], stride: usize, offset: usize, swap: bool, vector: &mut Vec<T>) {
    vector.extend(block.chunks_exact(stride).map(|record| at::<T>(record, offset, swap)));
}

fn is_corners(property: &Property) -> bool {
    property.list.is_some() && matches!(property.name.as_str(), "vertex_indices" | "vertex_index")
}

/// A list's entries as numbers of vertices.
fn corners(list: &[Number], body: &Body<'_, '_>, row: usize, count: usize, out: &mut Vec<u32>) -> Parsed<()> {
    out.clear();
    for number in list {
        match number.whole().filter(|&corner| (0..count as i64).contains(&corner)) {
            Some(corner) => out.push(corner as u32),
            None => return body.stop(format!("face {row} refers to vertex {}, the file has {count} vertices", number.double())),
        }
    }
    Ok(())
}

fn read_faces(body: &mut Body<'_, '_>, element: &Element, count: usize, faces: &mut Faces) -> Parsed<()> {
    if !element.properties.iter().any(is_corners) {
        return body.skip(element);
    }
    if faces.count() == 0 {
        *faces = Faces::with_room(body.possible_rows(element))?;
    }
    let (mut row, mut list, mut polygon) = (0, Vec::new(), Vec::new());
    while row < element.count {
        if let (Body::Binary(source, swap), [property]) = (&mut *body, element.properties.as_slice())
            && let (Some(Scalar::U8 | Scalar::I8), Scalar::I32 | Scalar::U32) = (property.list, property.kind)
        {
            row += plain_triangles(source, *swap, element.count - row, count, faces);
            if row == element.count {
                break;
            }
        }
        for property in &element.properties {
            match property.list {
                Some(length) if is_corners(property) => {
                    body.list(length, property.kind, element, row, &mut list)?;
                    corners(&list, body, row, count, &mut polygon)?;
                    faces.polygon(&polygon);
                }
                Some(length) => body.list(length, property.kind, element, row, &mut list)?,
                None => {
                    body.number(property.kind, element, row)?;
                }
            }
        }
        row += 1;
    }
    Ok(())
}

/// Takes triangles with a byte for the length and 4 for each corner as far as the window reaches; the first record that is
/// anything else, or wrong, is left.
fn plain_triangles(source: &mut Source<'_>, swap: bool, most: usize, count: usize, faces: &mut Faces) -> usize {
    let mut taken = 0;
    for record in source.window().chunks_exact(13).take(most) {
        let corners = [1, 5, 9].map(|offset| at::<u32>(record, offset, swap));
        if record[0] != 3 || corners.iter().any(|&corner| corner as usize >= count) {
            break;
        }
        faces.triangle(corners);
        taken += 1;
    }
    source.take(13 * taken);
    taken
}

/// Strips of triangles, each sharing two corners with the one before; -1 begins a new strip.
fn read_strips(body: &mut Body<'_, '_>, element: &Element, count: usize, faces: &mut Faces) -> Parsed<()> {
    let (mut list, mut strip) = (Vec::new(), Vec::new());
    for row in 0..element.count {
        if element.properties.is_empty() {
            break;
        }
        for property in &element.properties {
            let Some(length) = property.list else {
                body.number(property.kind, element, row)?;
                continue;
            };
            body.list(length, property.kind, element, row, &mut list)?;
            if is_corners(property) {
                for part in list.split(|number| number.whole() == Some(-1)) {
                    corners(part, body, row, count, &mut strip)?;
                    for (turn, three) in strip.windows(3).enumerate() {
                        let [a, b, c] = [three[0], three[1], three[2]];
                        if a != b && b != c && c != a {
                            faces.triangle(if turn % 2 == 0 { [a, b, c] } else { [b, a, c] });
                        }
                    }
                }
            }
        }
    }
    Ok(())
}

/// Properties that belong together become one field: those the writer's hints name, colours and normals.
fn grouped(columns: Vec<Field>, hints: &[Hint]) -> Vec<Field> {
    let scalars = columns.iter().enumerate().filter(|(_, column)| !column.table);
    let places: HashMap<String, usize> = scalars.map(|(place, column)| (column.name.clone(), place)).collect();
    let mut columns: Vec<Option<Field>> = columns.into_iter().map(Some).collect();
    let mut made: Vec<(usize, Field)> = Vec::new();
    let mut claimed = vec![false; columns.len()]; // a property belongs to one hint, so that a header full of them is read in passing
    for hint in hints {
        let members = places.get(&hint.property).and_then(|&start| Some(start..start.checked_add(hint.columns)?));
        let Some(members) = members.filter(|members| members.end <= columns.len() && !members.is_empty()) else { continue };
        if claimed[members.clone()].contains(&true) {
            continue;
        }
        claimed[members.clone()].fill(true);
        let parts: Option<Vec<&Values>> =
            columns[members.clone()].iter().map(|column| column.as_ref().filter(|field| !field.table).map(|field| &field.values)).collect();
        let values = parts.and_then(|parts| Values::side_by_side(&parts)).and_then(|joined| joined.converted(&hint.kind));
        let Some(values) = values else { continue };
        made.push((members.start, Field { name: hint.name.clone(), columns: hint.columns, table: hint.table, values }));
        columns[members].fill(None);
    }
    let usual: [(&[&str], &str); 3] =
        [(&["red", "green", "blue", "alpha"], "colors"), (&["red", "green", "blue"], "colors"), (&["nx", "ny", "nz"], "normals")];
    for (names, name) in usual {
        let members: Option<Vec<usize>> = names.iter().map(|name| places.get(*name).copied()).collect();
        let Some(members) = members else { continue };
        let Some(parts) = members.iter().map(|&member| columns[member].as_ref().map(|field| &field.values)).collect::<Option<Vec<_>>>()
        else {
            continue;
        };
        if columns.iter().flatten().chain(made.iter().map(|(_, field)| field)).any(|field| field.name == name) {
            continue;
        }
        let Some(values) = Values::side_by_side(&parts) else { continue };
        made.push((members[0], Field::table(name, members.len(), values)));
        for member in members {
            columns[member] = None;
        }
    }
    made.extend(columns.into_iter().enumerate().filter_map(|(place, column)| column.map(|column| (place, column))));
    made.sort_by_key(|(place, _)| *place);
    let mut data = Fields::default();
    for (_, field) in made {
        data.push(field);
    }
    data.fields
}
