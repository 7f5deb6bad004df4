//! Neighbours, closest points and rays.

pub mod knn;

pub use knn::{KdTree, Neighbors, Scratch};

/// How many queries one parallel task takes.
pub(crate) const BATCH: usize = 256;
