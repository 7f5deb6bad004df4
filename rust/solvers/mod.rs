//! Solvers: sparse Cholesky, multilevel iterations and eigenpairs. They work on matrices and know nothing of meshes.

mod cholesky;
mod conjugate;
mod dense;
mod eigen;
mod indefinite;
mod laplacian;
mod multilevel;
mod ordering;
mod sweep;
mod symbolic;

pub use cholesky::{Cholesky, Scratch};
pub use conjugate::Conjugate;
pub use eigen::{EigenOptions, Eigenpairs, Mass, eigenpairs};
pub use laplacian::{LaplacianSolver, Method};
pub use multilevel::Multilevel;
pub use symbolic::Symbolic;
