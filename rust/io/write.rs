//! Writers. Reals are written with as many digits as bring back the same bits.

use super::ply::HINT;
use super::source::{Parsed, Stop};
use super::text::push_number;
use super::values::{Field, Values};
use super::{Format, Geometry, Writing};
use crate::control::Control;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::fs::File;
use std::io::Write;
use std::path::Path;

const FLUSH: usize = 1 << 18;

enum Sink {
    Plain(File),
    Packed(GzEncoder<File>),
}

impl Sink {
    fn write_all(&mut self, bytes: &[u8]) -> Parsed<()> {
        match self {
            Sink::Plain(file) => file.write_all(bytes),
            Sink::Packed(encoder) => encoder.write_all(bytes),
        }
        .map_err(refused)
    }

    fn finish(self) -> Parsed<()> {
        match self {
            Sink::Plain(mut file) => file.flush(),
            Sink::Packed(encoder) => encoder.finish().and_then(|mut file| file.flush()),
        }
        .map_err(refused)
    }
}

/// A file, plain or gzip, written in pieces.
struct Out<'a> {
    file: Sink,
    buffer: Vec<u8>,
    control: &'a Control,
    rows: usize,
    done: usize,
}

impl Out<'_> {
    /// Ends a row: passes on what has gathered, tells how far the work is.
    fn row(&mut self) -> Parsed<()> {
        self.done += 1;
        if self.buffer.len() >= FLUSH {
            self.flush()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Parsed<()> {
        self.file.write_all(&self.buffer)?;
        self.buffer.clear();
        self.control.report(self.done as f64 / self.rows.max(1) as f64)?;
        Ok(())
    }

    fn text(&mut self, text: &str) {
        self.buffer.extend_from_slice(text.as_bytes());
    }

    fn numbers(&mut self, numbers: impl IntoIterator<Item = f64>) {
        let mut first = true;
        for number in numbers {
            if !first {
                self.buffer.push(b' ');
            }
            first = false;
            push_number(&mut self.buffer, number);
        }
    }
}

fn refused(error: std::io::Error) -> Stop {
    Stop::At(crate::error::Place::Whole, format!("cannot be written: {error}"))
}

pub(super) fn write(path: &Path, shape: &Geometry<'_>, writing: Writing, control: &Control) -> Parsed<Vec<String>> {
    let Some(format) = writing.format.or_else(|| Format::of(path)) else {
        return Stop::whole("the format is not known by this name; choose .ply, .obj, .off, .stl, .xyz, .pts or .csv");
    };
    let is_cloud = shape.faces.is_empty();
    if matches!(format, Format::Xyz | Format::Pts | Format::Csv) && !is_cloud {
        return Stop::whole("this format holds points only and would lose the faces; save as .ply, or save a PointCloud of the vertices");
    }
    if format == Format::Stl && is_cloud && shape.vertex_count() > 0 {
        return Stop::whole("STL holds triangles only, the shape has none; save as .ply");
    }
    if shape.dimension > 3 && !matches!(format, Format::Ply | Format::Csv) {
        return Stop::whole(format!("this format holds points of R^3, the shape lies in R^{}; save as .ply", shape.dimension));
    }
    if shape.dimension < 2 {
        return Stop::whole(format!("the shape lies in R^{}; files hold points of R^2 and more", shape.dimension));
    }
    let plan = plan(shape, format, writing)?; // what can be refused is refused before the file is touched
    let file = File::create(path).map_err(refused)?;
    let packed = path.file_name().is_some_and(|name| name.to_string_lossy().to_ascii_lowercase().ends_with(".gz"));
    let file = if packed { Sink::Packed(GzEncoder::new(file, Compression::new(6))) } else { Sink::Plain(file) };
    let rows = shape.vertex_count() + shape.faces.len();
    let mut out = Out { file, buffer: Vec::with_capacity(FLUSH + 4096), control, rows, done: 0 };
    match format {
        Format::Ply => ply(&mut out, shape, &plan, writing.ascii)?,
        Format::Obj => obj(&mut out, shape, &plan)?,
        Format::Off => off(&mut out, shape, &plan)?,
        Format::Stl => stl(&mut out, shape, writing.ascii)?,
        Format::Xyz | Format::Pts | Format::Csv => points(&mut out, shape, &plan, format)?,
    }
    out.flush()?;
    out.file.finish()?;
    let kept: Vec<&str> = plan.iter().map(|column| column.field.name.as_str()).collect();
    Ok(shape
        .data
        .iter()
        .filter(|field| field.columns > 0 && !kept.contains(&field.name.as_str()))
        .map(|field| field.name.clone())
        .collect())
}

/// A field on its way out: the numbers as the file can store them, and the names of their columns.
struct Column<'a> {
    field: &'a Field,
    values: std::borrow::Cow<'a, Values>,
    names: Vec<String>,
    hint: bool,
}

fn plan<'a>(shape: &'a Geometry<'_>, format: Format, writing: Writing) -> Parsed<Vec<Column<'a>>> {
    let usual =
        |name: &str, widths: &[usize]| shape.data.iter().find(|field| field.name == name && field.table && widths.contains(&field.columns));
    let plain = |field: &'a Field| Column { field, values: std::borrow::Cow::Borrowed(&field.values), names: Vec::new(), hint: false };
    let real = |field: &&Field| matches!(field.values, Values::U8(_) | Values::F32(_) | Values::F64(_));
    Ok(match format {
        Format::Stl => Vec::new(),
        Format::Obj => {
            [usual("colors", &[3, 4]).filter(real), usual("uv", &[2]), usual("normals", &[3])].into_iter().flatten().map(plain).collect()
        }
        Format::Off => [usual("normals", &[3]), usual("colors", &[3, 4]).filter(real)].into_iter().flatten().map(plain).collect(),
        Format::Xyz => usual("normals", &[3]).into_iter().map(plain).collect(),
        Format::Pts => usual("colors", &[3]).filter(|field| matches!(field.values, Values::U8(_))).into_iter().map(plain).collect(),
        Format::Ply | Format::Csv => {
            let mut taken = axis_names(shape.dimension.max(2) + 1); // a column called like the next axis would be read as that
            let mut columns = Vec::new();
            for field in shape.data.iter().filter(|field| field.columns > 0) {
                columns.push(column(field, &mut taken, format, writing)?);
            }
            columns
        }
    })
}

fn axis_names(dimension: usize) -> Vec<String> {
    (0..dimension).map(|axis| ["x", "y", "z"].get(axis).map_or_else(|| format!("x{axis}"), ToString::to_string)).collect()
}

fn column<'a>(field: &'a Field, taken: &mut Vec<String>, format: Format, writing: Writing) -> Parsed<Column<'a>> {
    use std::borrow::Cow;
    if field.name.contains(['\n', '\r']) {
        return Stop::whole(format!("data {:?} has a line break in its name", field.name));
    }
    // PLY has neither booleans nor 64-bit integers; a comment keeps their type, the numbers go where they fit exactly.
    let values = match (&field.values, format) {
        (values @ (Values::Bool(_) | Values::I64(_) | Values::U64(_)), Format::Ply) => {
            let narrower = ["uint8", "int32", "uint32", "float64"].into_iter().skip(usize::from(!matches!(values, Values::Bool(_))));
            let exact = narrower
                .filter_map(|name| values.converted(name))
                .find(|narrow| narrow.converted(values.type_name()).as_ref() == Some(values));
            let Some(exact) = exact else {
                return Stop::whole(format!("data {:?} holds 64-bit integers beyond 2^53, for which PLY has no type", field.name));
            };
            Cow::Owned(exact)
        }
        (values, _) => Cow::Borrowed(values),
    };
    let custom: &[&str] = match (field.name.as_str(), field.columns, field.table) {
        ("colors", 3, true) => &["red", "green", "blue"],
        ("colors", 4, true) => &["red", "green", "blue", "alpha"],
        ("normals", 3, true) => &["nx", "ny", "nz"],
        ("uv", 2, true) => &["s", "t"],
        _ => &[],
    };
    let word: String =
        field.name.chars().map(|c| if c.is_whitespace() || c.is_control() || ",;#\"".contains(c) { '_' } else { c }).collect();
    let word = if word.is_empty() { "data".to_string() } else { word };
    let mut names: Vec<String> = match (custom, field.table) {
        ([], false) => vec![word],
        ([], true) => (0..field.columns).map(|column| format!("{word}_{column}")).collect(),
        (custom, _) => custom.iter().map(ToString::to_string).collect(),
    };
    let same = |a: &str, b: &str| if format == Format::Csv { a.eq_ignore_ascii_case(b) } else { a == b };
    while names.iter().any(|name| taken.iter().any(|other| same(name, other)) || usual_name(name, custom)) {
        names.iter_mut().for_each(|name| name.push('_'));
    }
    taken.extend(names.iter().cloned());
    let native = values.type_name() == field.values.type_name() && !(writing.ascii && matches!(*values, Values::F32(_)));
    let understood =
        if field.table { matches!(field.name.as_str(), "colors" | "normals") && names == custom } else { names[0] == field.name };
    Ok(Column { field, values, names, hint: !(native && understood) })
}

/// Names that a reader takes for parts of colours or normals must not stand for anything else.
fn usual_name(name: &str, custom: &[&str]) -> bool {
    custom.is_empty() && ["red", "green", "blue", "alpha", "nx", "ny", "nz"].contains(&name)
}

fn ply(out: &mut Out<'_>, shape: &Geometry<'_>, plan: &[Column<'_>], ascii: bool) -> Parsed<()> {
    out.text(if ascii { "ply\nformat ascii 1.0\n" } else { "ply\nformat binary_little_endian 1.0\n" });
    if shape.dimension > 3 {
        out.text(&format!("comment {HINT} dimension {}\n", shape.dimension));
    }
    for column in plan.iter().filter(|column| column.hint) {
        let columns = if column.field.table { column.field.columns.to_string() } else { "vector".into() };
        out.text(&format!(
            "comment {HINT} field {} {columns} {} {}\n",
            column.names[0],
            column.field.values.type_name(),
            column.field.name
        ));
    }
    out.text(&format!("element vertex {}\n", shape.vertex_count()));
    for name in axis_names(shape.dimension) {
        out.text(&format!("property double {name}\n"));
    }
    for column in plan {
        let kind = match *column.values {
            Values::I8(_) => "char",
            Values::U8(_) | Values::Bool(_) => "uchar",
            Values::I16(_) => "short",
            Values::U16(_) => "ushort",
            Values::I32(_) => "int",
            Values::U32(_) => "uint",
            Values::I64(_) => "int64",
            Values::U64(_) => "uint64",
            Values::F32(_) => "float",
            Values::F64(_) => "double",
        };
        for name in &column.names {
            out.text(&format!("property {kind} {name}\n"));
        }
    }
    if !shape.faces.is_empty() {
        out.text(&format!("element face {}\nproperty list uchar int vertex_indices\n", shape.faces.len()));
    }
    out.text("end_header\n");
    for (row, place) in shape.vertices.chunks_exact(shape.dimension).enumerate() {
        if ascii {
            out.numbers(place.iter().copied());
            for column in plan {
                push_text(&mut out.buffer, &column.values, row * column.field.columns, column.field.columns, b' ');
            }
            out.buffer.push(b'\n');
        } else {
            for number in place {
                out.buffer.extend_from_slice(&number.to_le_bytes());
            }
            for column in plan {
                push_bytes(&mut out.buffer, &column.values, row * column.field.columns, column.field.columns);
            }
        }
        out.row()?;
    }
    for face in shape.faces.iter() {
        if ascii {
            out.text(&format!("3 {} {} {}\n", face[0], face[1], face[2]));
        } else {
            out.buffer.push(3);
            for corner in face {
                out.buffer.extend_from_slice(&corner.to_le_bytes());
            }
        }
        out.row()?;
    }
    Ok(())
}

fn push_bytes(buffer: &mut Vec<u8>, values: &Values, start: usize, count: usize) {
    macro_rules! bytes {
        ($vector:expr) => {
            for number in $vector.iter().skip(start).take(count) {
                buffer.extend_from_slice(&number.to_le_bytes());
            }
        };
    }
    match values {
        Values::Bool(vector) => buffer.extend(vector.iter().skip(start).take(count).map(|&value| u8::from(value))),
        Values::I8(vector) => bytes!(vector),
        Values::U8(vector) => bytes!(vector),
        Values::I16(vector) => bytes!(vector),
        Values::U16(vector) => bytes!(vector),
        Values::I32(vector) => bytes!(vector),
        Values::U32(vector) => bytes!(vector),
        Values::I64(vector) => bytes!(vector),
        Values::U64(vector) => bytes!(vector),
        Values::F32(vector) => bytes!(vector),
        Values::F64(vector) => bytes!(vector),
    }
}

/// Appends numbers, each after a separator. A float32 is written as the double it equals: every reader finds the same bits.
fn push_text(buffer: &mut Vec<u8>, values: &Values, start: usize, count: usize, separator: u8) {
    for index in start..start + count {
        buffer.push(separator);
        match values.whole(index) {
            Some(whole) => {
                let _ = write!(buffer, "{whole}"); // writing to a vector cannot fail
            }
            None => push_number(buffer, values.number(index).unwrap_or(0.0)),
        }
    }
}

/// A row of a field as reals; bytes of colours as shares of 255 where `shares`.
fn reals<'a>(column: &'a Column<'_>, row: usize, shares: bool) -> impl Iterator<Item = f64> + 'a {
    let scale = if shares && matches!(*column.values, Values::U8(_)) { 255.0 } else { 1.0 };
    (row * column.field.columns..(row + 1) * column.field.columns).map(move |index| column.values.number(index).unwrap_or(0.0) / scale)
}

/// A position in space: what lies in the plane gets height zero.
fn in_space<'a>(place: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
    place.iter().copied().chain(std::iter::repeat_n(0.0, 3usize.saturating_sub(place.len())))
}

fn obj(out: &mut Out<'_>, shape: &Geometry<'_>, plan: &[Column<'_>]) -> Parsed<()> {
    let named = |name: &str| plan.iter().find(|column| column.field.name == name);
    let (colors, uv, normals) = (named("colors"), named("uv"), named("normals"));
    for (row, place) in shape.vertices.chunks_exact(shape.dimension).enumerate() {
        out.text("v ");
        out.numbers(in_space(place).chain(colors.into_iter().flat_map(|column| reals(column, row, true))));
        out.buffer.push(b'\n');
        for (word, column) in [("vt ", uv), ("vn ", normals)] {
            if let Some(column) = column {
                out.text(word);
                out.numbers(reals(column, row, false));
                out.buffer.push(b'\n');
            }
        }
        out.row()?;
    }
    for face in shape.faces.iter() {
        out.buffer.push(b'f');
        for &corner in face {
            let n = u64::from(corner) + 1;
            let _ = match (uv, normals) {
                (None, None) => write!(out.buffer, " {n}"),
                (Some(_), None) => write!(out.buffer, " {n}/{n}"),
                (None, Some(_)) => write!(out.buffer, " {n}//{n}"),
                (Some(_), Some(_)) => write!(out.buffer, " {n}/{n}/{n}"),
            };
        }
        out.buffer.push(b'\n');
        out.row()?;
    }
    Ok(())
}

fn off(out: &mut Out<'_>, shape: &Geometry<'_>, plan: &[Column<'_>]) -> Parsed<()> {
    let has = |name: &str| plan.iter().any(|column| column.field.name == name);
    out.text(match (has("colors"), has("normals")) {
        (false, false) => "OFF\n",
        (true, false) => "COFF\n",
        (false, true) => "NOFF\n",
        (true, true) => "CNOFF\n",
    });
    out.text(&format!("{} {} 0\n", shape.vertex_count(), shape.faces.len()));
    for (row, place) in shape.vertices.chunks_exact(shape.dimension).enumerate() {
        out.numbers(in_space(place));
        for column in plan {
            let whole = matches!(*column.values, Values::U8(_));
            for number in reals(column, row, false) {
                // a point tells reals from bytes
                let _ = if whole { write!(out.buffer, " {}", number as u8) } else { write!(out.buffer, " {number:?}") };
            }
        }
        out.buffer.push(b'\n');
        out.row()?;
    }
    for face in shape.faces.iter() {
        out.text(&format!("3 {} {} {}\n", face[0], face[1], face[2]));
        out.row()?;
    }
    Ok(())
}

fn stl(out: &mut Out<'_>, shape: &Geometry<'_>, ascii: bool) -> Parsed<()> {
    if ascii {
        out.text("solid beltrami\n");
    } else {
        let Ok(count) = u32::try_from(shape.faces.len()) else {
            return Stop::whole(format!("{} facets; binary STL holds up to 2^32 - 1", shape.faces.len()));
        };
        let head = b"binary STL written by beltrami";
        out.buffer.extend_from_slice(head);
        out.buffer.resize(80, b' ');
        out.buffer.extend_from_slice(&count.to_le_bytes());
    }
    for face in shape.faces.iter() {
        let corners = face.map(|corner| {
            let mut place = [0.0; 3];
            place[..shape.dimension].copy_from_slice(&shape.vertices[corner as usize * shape.dimension..][..shape.dimension]);
            place
        });
        let normal = normal(corners);
        if ascii {
            out.text("facet normal ");
            out.numbers(normal);
            out.text("\nouter loop\n");
            for corner in corners {
                out.text("vertex ");
                out.numbers(corner);
                out.buffer.push(b'\n');
            }
            out.text("endloop\nendfacet\n");
        } else {
            let mut record = [0; 50];
            for (place, number) in record.chunks_exact_mut(4).zip(normal.iter().chain(corners.as_flattened())) {
                let single = *number as f32;
                if !single.is_finite() {
                    return Stop::whole(format!("coordinate {number:e} is beyond single precision, which binary STL has; save as .ply"));
                }
                place.copy_from_slice(&single.to_le_bytes());
            }
            out.buffer.extend_from_slice(&record);
        }
        out.row()?;
    }
    if ascii {
        out.text("endsolid beltrami\n");
    }
    Ok(())
}

/// Unit normal of a triangle; zero where it has none.
fn normal([a, b, c]: [[f64; 3]; 3]) -> [f64; 3] {
    let size = [a, b, c].as_flattened().iter().fold(0.0f64, |most, number| most.max(number.abs()));
    if size == 0.0 {
        return [0.0; 3];
    }
    let edge = |p: [f64; 3]| -> [f64; 3] { std::array::from_fn(|i| p[i] / size - a[i] / size) };
    let (u, v) = (edge(b), edge(c));
    let cross = crate::vector::cross(u, v);
    let length = cross.iter().map(|number| number * number).sum::<f64>().sqrt();
    if length > 0.0 { cross.map(|number| number / length) } else { [0.0; 3] }
}

fn points(out: &mut Out<'_>, shape: &Geometry<'_>, plan: &[Column<'_>], format: Format) -> Parsed<()> {
    let separator = if format == Format::Csv { b',' } else { b' ' };
    match format {
        Format::Csv => {
            let names: Vec<String> =
                axis_names(shape.dimension).into_iter().chain(plan.iter().flat_map(|column| column.names.clone())).collect();
            out.text(&names.join(","));
            out.buffer.push(b'\n');
        }
        Format::Pts => out.text(&format!("{}\n", shape.vertex_count())),
        _ => {}
    }
    for (row, place) in shape.vertices.chunks_exact(shape.dimension).enumerate() {
        let height = if format == Format::Csv { 0 } else { 3 - shape.dimension };
        for (axis, number) in place.iter().copied().chain(std::iter::repeat_n(0.0, height)).enumerate() {
            if axis > 0 {
                out.buffer.push(separator);
            }
            push_number(&mut out.buffer, number);
        }
        for column in plan {
            push_text(&mut out.buffer, &column.values, row * column.field.columns, column.field.columns, separator);
        }
        out.buffer.push(b'\n');
        out.row()?;
    }
    Ok(())
}
