//! Triangles glued along their edges, with flips: the connectivity that extrinsic and intrinsic retriangulation share.

use crate::error::{Error, Result};
use crate::shape::Topology;

/// No triangle across a half-edge.
pub(crate) const FREE: u32 = u32::MAX;

/// Triangles and, for each half-edge `3 face + k` (from corner `k` to the next one), the half-edge it is glued to, which
/// runs the other way. Two triangles may be glued along several edges, and a triangle to itself.
#[derive(Debug, Clone)]
pub(crate) struct Glue {
    faces: Vec<[u32; 3]>,
    twins: Vec<u32>,
}

impl Glue {
    /// The gluing of manifold, consistently oriented triangles.
    pub fn new(faces: &[[u32; 3]], vertex_count: usize) -> Result<Self> {
        let topology = Topology::of_faces(vertex_count, faces)?;
        let mut twins = vec![FREE; 3 * faces.len()];
        for edge in 0..topology.edges().len() {
            if let &[one, other] = topology.edge_half_edges(edge) {
                (twins[one as usize], twins[other as usize]) = (other, one);
            }
        }
        if let Some(edge) = topology.non_manifold_edge().or_else(|| topology.inconsistent_edge()) {
            let [a, b] = topology.edges()[edge];
            return Err(Error::Topology(format!(
                "the faces at the edge from vertex {a} to vertex {b} do not fit together; the mesh must be manifold and consistently oriented"
            )));
        }
        Ok(Glue { faces: faces.to_vec(), twins })
    }

    /// From parts that fit together.
    pub fn from_parts(faces: Vec<[u32; 3]>, twins: Vec<u32>) -> Self {
        debug_assert_eq!(twins.len(), 3 * faces.len());
        Glue { faces, twins }
    }

    pub fn next(half_edge: u32) -> u32 {
        if half_edge % 3 == 2 { half_edge - 2 } else { half_edge + 1 }
    }

    pub fn previous(half_edge: u32) -> u32 {
        if half_edge.is_multiple_of(3) { half_edge + 2 } else { half_edge - 1 }
    }

    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    pub fn into_faces(self) -> Vec<[u32; 3]> {
        self.faces
    }

    pub fn twins(&self) -> &[u32] {
        &self.twins
    }

    pub fn twin(&self, half_edge: u32) -> u32 {
        self.twins[half_edge as usize]
    }

    pub fn tail(&self, half_edge: u32) -> u32 {
        self.faces[half_edge as usize / 3][half_edge as usize % 3]
    }

    /// The vertices next to the apex over `half_edge`, around it. The apex must be inside the surface.
    pub fn neighbours(&self, half_edge: u32) -> impl Iterator<Item = u32> + '_ {
        let first = Self::previous(half_edge); // leaves the apex
        let mut spoke = first;
        let mut done = false;
        std::iter::from_fn(move || {
            if done {
                return None;
            }
            let tip = self.tail(Self::next(spoke));
            let twin = self.twin(Self::previous(spoke));
            done = twin == FREE || twin == first;
            spoke = if done { spoke } else { twin };
            Some(tip)
        })
    }

    /// Turns the edge of `half_edge` (a to b, with c and d over it) into the one from c to d. Its two triangles must differ.
    /// Afterwards `half_edge` runs from c to d, the one after it from d to b, and then from b to c; its twin from d to c, then
    /// from c to a, then from a to d.
    pub fn flip(&mut self, half_edge: u32) {
        let twin = self.twin(half_edge);
        let (h1, h2, t1, t2) = (Self::next(half_edge), Self::previous(half_edge), Self::next(twin), Self::previous(twin));
        let [a, b, c, d] = [half_edge, h1, h2, t2].map(|h| self.tail(h));
        let place = |h: u32| {
            if h == h1 {
                h2
            } else if h == h2 {
                t1
            } else if h == t1 {
                t2
            } else if h == t2 {
                h1
            } else {
                h
            }
        };
        let outer = [h1, h2, t1, t2].map(|h| (place(h), self.twin(h)));
        for (here, there) in outer {
            if there == FREE {
                self.twins[here as usize] = FREE;
            } else {
                self.twins[here as usize] = place(there);
                self.twins[place(there) as usize] = here;
            }
        }
        for (h, tail) in [(half_edge, c), (h1, d), (h2, b), (twin, d), (t1, c), (t2, a)] {
            self.faces[h as usize / 3][h as usize % 3] = tail;
        }
    }
}
