//! Which corners of triangles lie on a vertex.

use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

/// For each vertex the corners (3 face + corner) that lie on it, by ascending face.
pub(super) struct Corners {
    starts: Vec<u32>,
    corners: Vec<u32>,
    /// Whether the neighbours of a vertex do not pair up: each is there an even number of times where faces close around it.
    open: Vec<bool>,
}

impl Corners {
    pub(super) fn new(count: usize, faces: &[[u32; 3]]) -> Self {
        // Each task counts and then places the corners of its own faces, behind those of the tasks before: so the order is
        // the same however many tasks.
        let tasks = rayon::current_num_threads().clamp(1, 8);
        let width = faces.len().div_ceil(tasks).max(1);
        let mut tables: Vec<Vec<[u32; 2]>> = faces
            .par_chunks(width)
            .map(|faces| {
                let mut table = vec![[0; 2]; count];
                for &[a, b, c] in faces {
                    for (vertex, others) in [(a, b ^ c), (b, c ^ a), (c, a ^ b)] {
                        let [number, odd] = &mut table[vertex as usize];
                        *number += 1;
                        *odd ^= others;
                    }
                }
                table
            })
            .collect();
        let mut starts = Vec::with_capacity(count + 1);
        let mut open = Vec::with_capacity(count);
        let mut sum = 0;
        for vertex in 0..count {
            starts.push(sum);
            let mut odd = 0;
            for table in &mut tables {
                let [number, others] = &mut table[vertex];
                odd ^= *others;
                sum += std::mem::replace(number, sum);
            }
            open.push(odd != 0);
        }
        starts.push(sum);
        // Places are disjoint, which only atomics can say: their stores are ordinary ones.
        let corners: Vec<AtomicU32> = (0..sum).into_par_iter().map(|_| AtomicU32::new(0)).collect();
        faces.par_chunks(width).zip(&mut tables).enumerate().for_each(|(task, (faces, table))| {
            for (corner, &vertex) in (3 * task * width..).zip(faces.as_flattened()) {
                let at = &mut table[vertex as usize][0];
                corners[*at as usize].store(corner as u32, Ordering::Relaxed);
                *at += 1;
            }
        });
        Corners { starts, corners: corners.into_iter().map(AtomicU32::into_inner).collect(), open }
    }

    pub(super) fn vertex_count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Where the corners of each vertex start among all; vertices + 1 numbers.
    pub(super) fn starts(&self) -> &[u32] {
        &self.starts
    }

    /// The corners of a run of vertices, one vertex after the other.
    pub(super) fn of_run(&self, vertices: Range<usize>) -> &[u32] {
        &self.corners[self.starts[vertices.start] as usize..self.starts[vertices.end] as usize]
    }

    pub(super) fn of(&self, vertex: usize) -> &[u32] {
        &self.corners[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }

    /// Number of neighbours of a vertex that the faces surround once, all around or from boundary to boundary.
    pub(super) fn fan_neighbors(&self, vertex: usize) -> usize {
        self.of(vertex).len() + usize::from(self.open[vertex])
    }
}
