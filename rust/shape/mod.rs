//! Shapes: triangle meshes in R^D, what can be said of their connectivity, and exact makers.

mod mesh;

pub use mesh::TriangleMesh;
