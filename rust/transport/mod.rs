//! Dynamic optimal transport: inner loops of its splitting method and of its two bounds.
//!
//! Densities live at nodes and at the ends of time intervals, momenta on simplices and on intervals, as the chapter's section 8.2 has
//! them: a density on a simplex is the mean over its corners and over the interval's two ends. [`Domain`] holds the simplices and
//! does all that happens in space; [`SpaceTime`] solves the space-time Poisson equation of the projection on the continuity equation.
//!
//! Tables are kept slice after slice: `nodes` numbers per slice, or `count` elements of `coordinates` numbers.

mod domain;
mod hamilton_jacobi;
mod space_time;

pub use domain::{Domain, Step};
pub use hamilton_jacobi::Repair;
pub use space_time::{Ends, Mobility, SpaceTime};
