//! Neighbours, closest points and rays.

pub mod bvh;
pub mod knn;
mod normals;
mod rows;
pub mod sampling;
mod sectors;

pub use bvh::{Bvh, ClosestPoints, Hits};
pub use knn::{KdTree, Neighbors, Scratch};
pub use normals::{Oriented, PlaneFits, normals, oriented, plane_fits};
pub use rows::nearest_rows;
pub use sampling::{farthest_points, first_copies, poisson_disc};
pub use sectors::{Grouped, Planes, sectors};

/// How many queries one parallel task takes.
pub(crate) const BATCH: usize = 256;
