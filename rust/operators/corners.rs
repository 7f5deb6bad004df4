//! Which corners of triangles lie on a vertex.

use rayon::prelude::*;

/// For each vertex the corners (3 face + corner) that lie on it, by ascending face.
pub(super) struct Corners {
    starts: Vec<usize>,
    corners: Vec<u32>,
}

impl Corners {
    pub(super) fn new(count: usize, faces: &[[u32; 3]]) -> Self {
        let flat = faces.as_flattened();
        // Each task owns a range of vertices and reads all faces: no atomics, and the same order however many tasks.
        let tasks = rayon::current_num_threads().clamp(1, 16);
        let width = count.div_ceil(tasks).max(1);
        let mut starts = vec![0; count + 1];
        starts[1..].par_chunks_mut(width).enumerate().for_each(|(task, counts)| {
            let first = task * width;
            for &vertex in flat {
                if let Some(number) = counts.get_mut((vertex as usize).wrapping_sub(first)) {
                    *number += 1;
                }
            }
        });
        for vertex in 0..count {
            starts[vertex + 1] += starts[vertex];
        }
        let mut corners = vec![0; flat.len()];
        let mut rest = corners.as_mut_slice();
        let mut parts = Vec::new();
        for first in (0..count).step_by(width) {
            let last = (first + width).min(count);
            let (part, after) = std::mem::take(&mut rest).split_at_mut(starts[last] - starts[first]);
            parts.push((first, last, part));
            rest = after;
        }
        parts.into_par_iter().for_each(|(first, last, part)| {
            let mut next: Vec<usize> = starts[first..last].iter().map(|start| start - starts[first]).collect();
            for (corner, &vertex) in flat.iter().enumerate() {
                if let Some(at) = next.get_mut((vertex as usize).wrapping_sub(first)) {
                    part[*at] = corner as u32;
                    *at += 1;
                }
            }
        });
        Corners { starts, corners }
    }

    pub(super) fn vertex_count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Where the corners of each vertex start among all; vertices + 1 numbers.
    pub(super) fn starts(&self) -> &[usize] {
        &self.starts
    }

    pub(super) fn of(&self, vertex: usize) -> &[u32] {
        &self.corners[self.starts[vertex]..self.starts[vertex + 1]]
    }
}
