//! Points, one per line: XYZ, PTS and CSV.

use super::source::{Parsed, Stop};
use super::text::{SEPARATED, Text, number, shown, whole};
use super::values::{Field, Values};
use super::{Fields, Format, Geometry};
use crate::control::Control;
use std::collections::HashMap;
use std::path::Path;

pub(super) fn parse(bytes: &[u8], format: Format, path: &Path, control: &Control) -> Parsed<Geometry<'static>> {
    let mut text = Text::new(bytes, 1, &SEPARATED, control);
    let mut names: Option<Vec<String>> = None;
    let mut announced: Option<usize> = None;
    let mut tagged = false; // lines `p x y z` among others of one letter
    let mut width = 0;
    let mut values: Vec<f64> = Vec::new();
    let mut row: Vec<f64> = Vec::new();
    let mut more = text.more()?;
    let mut first = true;
    while more {
        row.clear();
        let mut word = text.word();
        if format == Format::Pts && word.is_some_and(|word| matches!(word, b"p" | b"d" | b"s" | b"g")) {
            tagged = true;
            if word != Some(b"p") {
                more = text.next_line()?;
                continue;
            }
            word = text.word();
        } else if tagged {
            return Stop::line(text.line(), "a line without its letter among lines `p x y z`");
        }
        if first && word.is_some_and(|word| number(word).is_none()) && names.is_none() {
            let mut found = Vec::new();
            while let Some(name) = word {
                found.push(String::from_utf8_lossy(name).trim_matches('"').to_string());
                word = text.word();
            }
            if !found.iter().any(|name| name.eq_ignore_ascii_case("x")) {
                return Stop::line(text.line(), format!("{:?} is no number, and no header with a column `x`", found[0]));
            }
            names = Some(found);
            more = text.next_line()?;
            continue;
        }
        while let Some(here) = word {
            match number(here) {
                Some(number) => row.push(number),
                None => return Stop::line(text.line(), format!("column {}: {:?} is no number", row.len() + 1, shown(here))),
            }
            word = text.word();
        }
        if first && row.len() == 1 && names.is_none() && !tagged && row[0] >= 0.0 && row[0] == row[0].trunc() && row[0] < 1e15 {
            announced = Some(row[0] as usize); // how many points follow
            more = text.next_line()?;
            first = false;
            continue;
        }
        first = false;
        if values.is_empty() {
            width = row.len();
            let needed = names.as_ref().map_or(width, Vec::len);
            if width < 2 || width != needed {
                return Stop::line(text.line(), format!("{width} numbers; {} are needed", if names.is_some() { needed } else { 3 }));
            }
        } else if row.len() != width {
            return Stop::line(text.line(), format!("{} numbers, the lines before have {width}", row.len()));
        }
        values.extend_from_slice(&row);
        more = text.next_line()?;
    }
    let count = values.len().checked_div(width).unwrap_or(0);
    if let Some(announced) = announced.filter(|&announced| announced != count) {
        return Stop::line(text.line(), format!("the file announces {announced} points and holds {count}"));
    }
    let table = Table { width: if width == 0 { names.as_ref().map_or(3, Vec::len) } else { width }, values };
    shape(table, names, format, path, bytes, control)
}

struct Table {
    width: usize,
    values: Vec<f64>,
}

impl Table {
    fn columns(&self, columns: &[usize]) -> Vec<f64> {
        self.values.chunks_exact(self.width).flat_map(|row| columns.iter().map(|&column| row[column])).collect()
    }
}

fn shape(
    table: Table,
    names: Option<Vec<String>>,
    format: Format,
    path: &Path,
    bytes: &[u8],
    control: &Control,
) -> Parsed<Geometry<'static>> {
    let named = names.is_some();
    let names = names.unwrap_or_else(|| standard_names(&table, format, path));
    let mut places = HashMap::new(); // a table may have as many columns as there are dimensions
    for (column, name) in names.iter().enumerate() {
        places.entry(name.to_ascii_lowercase()).or_insert(column);
    }
    let find = |wanted: &str| places.get(wanted).copied();
    let mut axes: Vec<usize> = ["x", "y", "z"].into_iter().map_while(find).collect();
    if axes.len() == 3 {
        axes.extend((3..names.len()).map_while(|axis| find(&format!("x{axis}"))));
    }
    if axes.len() < 2 {
        return Stop::line(1, "the header names no columns x and y");
    }
    let vertices =
        if axes.len() == table.width && axes.iter().copied().eq(0..table.width) { table.values.clone() } else { table.columns(&axes) };
    if let Some(at) = vertices.iter().position(|number| !number.is_finite()) {
        return not_finite_line(bytes, at / axes.len(), vertices[at], named, format, control);
    }
    let mut used = vec![false; names.len()];
    axes.iter().for_each(|&axis| used[axis] = true);
    let mut groups: Vec<(Vec<usize>, &str)> = Vec::new();
    for (members, name) in
        [(&["red", "green", "blue", "alpha"][..], "colors"), (&["red", "green", "blue"], "colors"), (&["nx", "ny", "nz"], "normals")]
    {
        if let Some(columns) = members.iter().map(|member| find(member).filter(|&column| !used[column])).collect::<Option<Vec<_>>>() {
            columns.iter().for_each(|&column| used[column] = true);
            groups.push((columns, name));
        }
    }
    let mut data = Fields::default();
    for (column, name) in names.iter().enumerate() {
        if let Some((columns, name)) = groups.iter().find(|(columns, _)| columns[0] == column) {
            let values = table.columns(columns);
            let bytes = *name == "colors"
                && values.iter().all(|&value| value == value.trunc() && (0.0..256.0).contains(&value))
                && values.iter().any(|&value| value > 1.0);
            let values = if bytes { Values::U8(values.into_iter().map(|value| value as u8).collect()) } else { Values::F64(values) };
            data.push(Field::table(*name, columns.len(), values));
        } else if !used[column] {
            data.push(Field::vector(name, Values::F64(table.columns(&[column]))));
        }
    }
    Ok(Geometry { dimension: axes.len(), vertices: vertices.into(), faces: Vec::new().into(), data: data.fields })
}

/// What the columns of a table without a header are, by custom.
fn standard_names(table: &Table, format: Format, path: &Path) -> Vec<String> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let colors = ["red", "green", "blue"];
    let normals = ["nx", "ny", "nz"];
    let mut names = vec!["x", "y", "z"];
    names.truncate(table.width);
    let unit = |row: &[f64]| {
        let length = row[3] * row[3] + row[4] * row[4] + row[5] * row[5];
        length == 0.0 || (length - 1.0).abs() < 0.02
    };
    let channel = |row: &[f64]| row[3..6].iter().all(|&value| value == value.trunc() && (0.0..256.0).contains(&value));
    match table.width {
        4 if format == Format::Pts => names.push("intensity"),
        7 if format == Format::Pts => {
            names.push("intensity");
            names.extend(colors);
        }
        6 if name.contains(".xyzrgb") => names.extend(colors),
        6 if format != Format::Pts && table.values.chunks_exact(6).all(unit) => names.extend(normals),
        6 if table.values.chunks_exact(6).all(channel) || format == Format::Pts => names.extend(colors),
        9 if format == Format::Xyz && table.values.chunks_exact(9).all(channel) => {
            names.extend(colors);
            names.extend(normals);
        }
        _ => {}
    }
    let mut names: Vec<String> = names.into_iter().map(String::from).collect();
    names.extend((names.len()..table.width).map(|column| format!("column_{column}")));
    names
}

/// The error for a position that is not finite, with its line, which is found by counting once more.
fn not_finite_line<T>(bytes: &[u8], point: usize, number: f64, named: bool, format: Format, control: &Control) -> Parsed<T> {
    let mut text = Text::new(bytes, 1, &SEPARATED, control);
    let mut seen = 0;
    let mut more = text.more()?;
    if named {
        more = text.next_line()?;
    }
    while more {
        let mut words = Vec::new();
        while let Some(word) = text.word() {
            words.push(word);
        }
        let counts = if format == Format::Pts && words.first().is_some_and(|word| word.len() == 1 && whole(word).is_none()) {
            words[0] == b"p"
        } else {
            words.len() > 1
        };
        if counts {
            if seen == point {
                break;
            }
            seen += 1;
        }
        more = text.next_line()?;
    }
    Stop::line(text.line(), super::not_finite(point, number))
}
