//! Neighbours, closest points and rays.

pub mod bvh;
pub mod knn;
mod normals;

pub use bvh::{Bvh, ClosestPoints, Hits};
pub use knn::{KdTree, Neighbors, Scratch};
pub use normals::normals;

/// How many queries one parallel task takes.
pub(crate) const BATCH: usize = 256;
