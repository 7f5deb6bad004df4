//! Stereolithography: a soup of triangles, binary or text.

use super::source::{Parsed, Source, Stop, reserved};
use super::text::{PLAIN, Text, decoded, shown};
use super::values::at;
use super::{Geometry, not_finite};
use crate::control::Control;

const HEAD: usize = 84;
const FACET: usize = 50;

pub(super) fn parse(source: Source<'_>, control: &Control) -> Parsed<Geometry<'static>> {
    let bytes = source.rest()?;
    let announced = (bytes.len() >= HEAD).then(|| at::<u32>(&bytes, 80, cfg!(target_endian = "big")) as usize);
    let fits = announced.is_some_and(|count| bytes.len() == HEAD + FACET * count);
    // Binary files may begin with `solid` as well: the length decides first.
    let text = decoded(&bytes);
    let start = text.iter().position(|byte| !byte.is_ascii_whitespace()).unwrap_or(0);
    let says_solid = text[start..].get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    let vertices = match announced {
        Some(count) if fits || !(says_solid && looks_like_text(&text)) => binary(&bytes, count)?,
        _ if says_solid => ascii(&text, control)?,
        _ => return Stop::byte(0, "is neither text that begins with `solid` nor long enough for binary STL"),
    };
    let faces: Vec<[u32; 3]> = (0..(vertices.len() / 9) as u32).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect();
    Ok(Geometry { dimension: 3, vertices: vertices.into(), faces: faces.into(), data: Vec::new() })
}

fn looks_like_text(bytes: &[u8]) -> bool {
    !bytes[..bytes.len().min(1024)].contains(&0)
}

fn binary(bytes: &[u8], count: usize) -> Parsed<Vec<f64>> {
    let room = (bytes.len() - HEAD) / FACET;
    if count != room {
        return Stop::byte(80, format!("the header announces {count} facets, the file has room for {room}"));
    }
    if count > i32::MAX as usize / 3 {
        return Stop::byte(80, format!("{count} facets; up to 2^31 / 3 can be read"));
    }
    let mut vertices = reserved(9 * count)?;
    for (facet, record) in bytes[HEAD..].chunks_exact(FACET).enumerate() {
        for number in 0..9 {
            let coordinate = f64::from(at::<f32>(record, 12 + 4 * number, cfg!(target_endian = "big")));
            if !coordinate.is_finite() {
                return Stop::byte(
                    HEAD + FACET * facet + 12 + 4 * number,
                    format!("facet {facet}: {}", not_finite(number / 3, coordinate)),
                );
            }
            vertices.push(coordinate);
        }
    }
    Ok(vertices)
}

fn ascii(bytes: &[u8], control: &Control) -> Parsed<Vec<f64>> {
    let mut text = Text::new(bytes, 1, &PLAIN, control);
    let mut vertices: Vec<f64> = Vec::new();
    let mut inside = false; // of a solid
    let mut facet: Option<usize> = None; // corners of the open facet so far
    let mut more = text.more()?;
    while more {
        let word = text.word().unwrap_or_default();
        let line = text.line();
        let is = |name: &[u8]| word.eq_ignore_ascii_case(name);
        if is(b"vertex") {
            facet = match facet {
                Some(corners @ 0..3) => Some(corners + 1),
                Some(_) => return Stop::line(line, "a facet has more than three corners"),
                None => return Stop::line(line, "a vertex stands outside a facet"),
            };
            for _ in 0..3 {
                vertices.push(text.coordinate()?);
            }
        } else if is(b"facet") {
            if facet.is_some() || !inside {
                return Stop::line(line, if inside { "a facet begins within a facet" } else { "a facet stands outside a solid" });
            }
            facet = Some(0);
        } else if is(b"endfacet") {
            match facet {
                Some(3) => facet = None,
                Some(corners) => return Stop::line(line, format!("a facet has {corners} corners, 3 are needed")),
                None => return Stop::line(line, "a facet ends that did not begin"),
            }
        } else if is(b"solid") || is(b"endsolid") {
            if facet.is_some() {
                return Stop::line(line, "a solid ends or begins within a facet");
            }
            inside = is(b"solid");
        } else if !(is(b"outer") || is(b"endloop") || is(b"color") || is(b"end")) {
            return Stop::line(line, format!("{:?} is no word of an STL file", shown(word)));
        }
        more = text.next_line()?;
    }
    if inside || facet.is_some() {
        return Stop::line(text.line(), "the file ends within a solid: no `endsolid`");
    }
    Ok(vertices)
}
