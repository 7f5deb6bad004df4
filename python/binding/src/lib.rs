//! Binding of beltrami for Python: one export list. Each function converts, releases the GIL, calls the core, wraps.

mod cholesky;
mod conjugate;
mod convert;
mod eigen;
mod error;
mod geodesic;
mod intrinsic;
mod io;
mod levelset;
mod local_mesh;
mod mls;
mod near;
mod operators;
mod reeb;
mod register;
mod run;
mod sampling;
mod shape;
mod shrink;
mod sliced;
mod sphere;
mod threads;
mod transport;
mod view;

use pyo3::prelude::*;

#[pymodule]
mod _core {
    #[pymodule_export]
    use super::cholesky::Cholesky;
    #[pymodule_export]
    use super::conjugate::Conjugate;
    #[pymodule_export]
    use super::eigen::eigenpairs;
    #[pymodule_export]
    use super::geodesic::{HeatMethod, LaplacianSolver};
    #[pymodule_export]
    use super::intrinsic::{intrinsic_divergence, intrinsic_gradient, intrinsic_operators, thinnest_face};
    #[pymodule_export]
    use super::io::{load_bytes, load_file, save_file, triangulate, weld};
    #[pymodule_export]
    use super::levelset::level_set;
    #[pymodule_export]
    use super::local_mesh::{local_edge_length, local_gradient, local_mass, local_mesh, local_stiffness, local_volumes};
    #[pymodule_export]
    use super::mls::moving_least_squares;
    #[pymodule_export]
    use super::near::{
        closest_points, intersect_rays, nearest_neighbors, nearest_rows, neighbors_within, normals, oriented_normals, plane_fits, sectors,
    };
    #[pymodule_export]
    use super::operators::{cotangent_operators, divergence, galerkin_mass, gradient, has_positive_weights};
    #[pymodule_export]
    use super::reeb::contour_graph;
    #[pymodule_export]
    use super::register::{Rigid, ascend_triple_products, orthogonal_functional_map, polar, spectral_point_maps, upsample_maps};
    #[pymodule_export]
    use super::sampling::{farthest_points, first_copies, poisson_disc};
    #[pymodule_export]
    use super::shape::{
        check_mesh, face_areas, make_cylinder, make_disc, make_ellipsoid, make_flat_torus, make_grid, make_knot, make_star, make_tori,
        make_torus, oriented_faces, topology,
    };
    #[pymodule_export]
    use super::shrink::{Elements, constrain};
    #[pymodule_export]
    use super::sliced::{SlicedAlignment, sliced_distance};
    #[pymodule_export]
    use super::sphere::{excess_gradient, moebius_translated};
    #[pymodule_export]
    use super::threads::{num_threads, set_num_threads};
    #[pymodule_export]
    use super::transport::{SpaceTime, TransportDomain};
    #[pymodule_export]
    use super::view::{paint, png, strokes};
}
