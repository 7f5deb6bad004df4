//! Neighbours, closest points and rays.

pub mod bvh;
pub mod knn;
mod normals;
mod rows;
pub mod sampling;

pub use bvh::{Bvh, ClosestPoints, Hits};
pub use knn::{KdTree, Neighbors, Scratch};
pub use normals::normals;
pub use rows::nearest_rows;
pub use sampling::{farthest_points, first_copies, poisson_disc};

/// How many queries one parallel task takes.
pub(crate) const BATCH: usize = 256;
