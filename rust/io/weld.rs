//! Vertices at equal positions become one.

use super::Geometry;
use super::source::Parsed;
use super::values::Field;
use crate::control::Control;
use std::hash::{BuildHasher, Hasher, RandomState};

const EMPTY: u32 = u32::MAX;
const STEP: usize = 1 << 16;

/// The first vertex of each position, in order; triangles refer to those. Minus zero counts as zero.
pub(super) fn welded<'a>(shape: Geometry<'a>, control: &Control) -> Parsed<Geometry<'a>> {
    let (dimension, count) = (shape.dimension, shape.vertex_count());
    let place = |vertex: u32| &shape.vertices[vertex as usize * dimension..][..dimension];
    // A table with open addressing, seeded at random: nobody can prepare a file whose positions all collide.
    let slots = (2 * count).next_power_of_two().max(2);
    let seed = RandomState::new().build_hasher().finish() | 1;
    let slot_of = |vertex: u32| {
        let mut hash = seed;
        for &number in place(vertex) {
            hash = (hash ^ (number + 0.0).to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            hash ^= hash >> 29;
        }
        (hash.wrapping_mul(seed) >> 20) as usize & (slots - 1)
    };
    let mut table = super::source::reserved(slots)?;
    table.resize(slots, EMPTY);
    let mut kept: Vec<u32> = Vec::new();
    let mut number = super::source::reserved(count)?;
    for vertex in 0..count as u32 {
        if (vertex as usize).is_multiple_of(STEP) {
            control.check()?;
        }
        let mut slot = slot_of(vertex);
        loop {
            let found = table[slot];
            if found == EMPTY {
                table[slot] = kept.len() as u32;
                number.push(kept.len() as u32);
                kept.push(vertex);
                break;
            }
            if place(kept[found as usize]) == place(vertex) {
                number.push(found);
                break;
            }
            slot = (slot + 1) & (slots - 1);
        }
    }
    if kept.len() == count {
        return Ok(shape);
    }
    let vertices: Vec<f64> = kept.iter().flat_map(|&vertex| place(vertex).iter().copied()).collect();
    let data = shape.data.iter().map(|field| Field { values: field.values.rows(&kept, field.columns), ..field.clone() }).collect();
    let mut faces = shape.faces.into_owned();
    for corner in faces.as_flattened_mut() {
        *corner = number[*corner as usize];
    }
    Ok(Geometry { dimension, vertices: vertices.into(), faces: faces.into(), data })
}
