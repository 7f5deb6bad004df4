//! Solvers: sparse Cholesky and eigenpairs. They know matrices, never meshes.
