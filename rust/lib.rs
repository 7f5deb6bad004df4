//! Intrinsic computing on triangle meshes and point clouds.
//!
//! ```
//! use beltrami::geodesic::HeatMethod;
//! use beltrami::operators::cotangent_operators;
//! use beltrami::solvers::{EigenOptions, Mass, eigenpairs};
//! use beltrami::{Control, shape::make};
//!
//! let control = Control::default(); // progress and cancelling
//! let torus = make::torus(1.0, 0.4, 60, 24)?;
//! let operators = cotangent_operators(&torus)?;
//! let modes = eigenpairs(&operators.stiffness, Mass::Diagonal(&operators.mass), 6, &EigenOptions::default(), &control)?;
//! let distance = HeatMethod::on_mesh(&torus, 1.0, &control)?.distance(&[0], &control)?;
//! assert!(modes.values[0].abs() < 1e-9 && distance[0] == 0.0);
//! # Ok::<(), beltrami::Error>(())
//! ```
//!
//! Data flows one way through the modules of this crate, and so do imports:
//!
//! | module | what it contains |
//! |---|---|
//! | [`io`] | order-preserving readers and writers: OBJ, PLY, STL, OFF, point lists, gzip of each |
//! | [`shape`] | triangle meshes in R^D, topology, exact makers (spheres, tori, knots ...) |
//! | [`near`] | neighbours, closest points, rays |
//! | [`operators`] | stiffness, mass, gradient, divergence |
//! | [`solvers`] | sparse Cholesky, multigrid and eigenpairs, of matrices without knowledge of meshes |
//! | [`geodesic`] | distance by the heat method |
//! | [`sphere`] | inner loops of conformal maps to the sphere |
//! | [`sliced`] | sliced Wasserstein distances, also over rotations |
//! | [`register`] | inner loops of near-isometric registration |
//! | [`shrink`], [`levelset`], [`reeb`] | total variation on simplices; contours of functions on meshes; Reeb graphs |
//! | [`transport`] | space-time projection, perspective steps and bounds of dynamic optimal transport |
//! | [`view`] | pictures without a display |
//!
//! They are built on [`sparse`] (the matrix type), [`error`], [`control`] (progress and cancelling) and [`threads`].
//!
//! Every public function reports failure as an [`Error`] that says what is wrong, where, and what to do about it. No
//! function panics on bad input, and no result contains NaN. The same input gives the same bits on any number of threads.

pub mod control;
pub mod error;
pub mod geodesic;
pub mod io;
pub mod levelset;
pub mod near;
pub mod operators;
pub mod reeb;
pub mod register;
pub mod shape;
pub mod shrink;
pub mod sliced;
pub mod solvers;
pub mod sparse;
pub mod sphere;
pub mod threads;
pub mod transport;
mod vector;
pub mod view;

pub use control::Control;
pub use error::{Error, Result};
pub use shape::TriangleMesh;
pub use sparse::Csr;
