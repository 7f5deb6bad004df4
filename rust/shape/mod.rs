//! Shapes: triangle meshes in R^D, what can be said of their connectivity, and exact makers.

mod glue;
mod implicit;
pub(crate) mod intrinsic;
pub mod make;
pub(crate) mod mesh;
mod topology;

pub use intrinsic::{IntrinsicTriangulation, intrinsic_delaunay, thinnest_face, tufted};
pub use mesh::TriangleMesh;
pub use topology::{BoundaryLoop, Topology};
