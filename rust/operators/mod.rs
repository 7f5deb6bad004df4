//! Discrete operators of a shape: stiffness, mass, gradient, divergence.
//!
//! The stiffness L is positive semidefinite, its rows sum to zero; Laplace-Beltrami is -diag(mass)^-1 L.

mod chart;
mod corners;
pub mod cotangent;
pub(crate) mod dense;
pub(crate) mod frames;
mod hull;
mod intrinsic;
pub mod local_mesh;
pub mod mls;
mod voted_simplices;

pub use cotangent::{MeshOperators, cotangent_operators, divergence, galerkin_mass, gradient, has_positive_weights, voronoi_mass};
pub use local_mesh::{LocalMesh, LocalMeshOptions, local_mesh};
pub use mls::{MlsOperators, MlsOptions, MlsWeight, moving_least_squares};
pub use voted_simplices::VotedSimplices;
