"""Intrinsic computing on triangle meshes and point clouds, with certified answers.

``import beltrami as bt``; every name below is documented where it is defined.
"""

from __future__ import annotations

from . import costs, examples, molecules, shapes
from .basis_pursuit import ConformalRegistrationResult, SpectrumMatch, conformal_eigenpairs, match_spectrum, register_conformal
from .collection import DistanceMatrix, distance_matrix
from .committor import CommittorResult, committor, reweight, sample_density
from .conformal import SphericalMapResult, spherical_map
from .conformal.moebius import Moebius
from .conformal.spherical import SphericalHarmonics, SurfaceMap
from .descriptors import hks, shape_dna, wks
from .eigen import Eigenpairs, eigenpairs
from .errors import (
    Cancelled,
    ConvergenceError,
    DependencyError,
    Error,
    FileError,
    InputError,
    InternalError,
    NumericalError,
    TopologyError,
)
from .files import load, load_values, save
from .geodesic import HeatMethod, geodesic_distance
from .maps import MapEvaluation, evaluate_map, functional_map_of, point_map_of, transfer
from .near import ClosestPointsResult, RayHitsResult, closest_points, intersect_rays, nearest_neighbors, neighbors_within, normals
from .operators import Operators, operators
from .register import RegistrationCandidate, RegistrationResult, register
from .sampling import farthest_points, poisson_disc
from .segment import DenoisingResult, SegmentationResult, contours, denoise, segment, segment_path
from .shapes import PointCloud, TriangleMesh
from .skeleton import SkeletonResult, skeleton
from .sliced import RotationInvariantSlicedWassersteinResult, rotation_invariant_sliced_wasserstein, sliced_wasserstein
from .solvers import Cholesky, PoissonSolver, solve_poisson
from .threads import num_threads, set_num_threads
from .transport import Flow, TransportResult, transport
from .transport.barycenter import BarycenterResult, wasserstein_barycenter
from .transport.games import MeanFieldGameResult, mean_field_game
from .view import Page, Picture, plot

__version__ = "0.1.0"

__all__ = [
    "BarycenterResult",
    "Cancelled",
    "Cholesky",
    "ClosestPointsResult",
    "CommittorResult",
    "ConformalRegistrationResult",
    "ConvergenceError",
    "DenoisingResult",
    "DependencyError",
    "DistanceMatrix",
    "Eigenpairs",
    "Error",
    "FileError",
    "Flow",
    "HeatMethod",
    "InputError",
    "InternalError",
    "MapEvaluation",
    "MeanFieldGameResult",
    "Moebius",
    "NumericalError",
    "Operators",
    "Page",
    "Picture",
    "PointCloud",
    "PoissonSolver",
    "RayHitsResult",
    "RegistrationCandidate",
    "RegistrationResult",
    "RotationInvariantSlicedWassersteinResult",
    "SegmentationResult",
    "SkeletonResult",
    "SpectrumMatch",
    "SphericalHarmonics",
    "SphericalMapResult",
    "SurfaceMap",
    "TopologyError",
    "TransportResult",
    "TriangleMesh",
    "__version__",
    "closest_points",
    "committor",
    "conformal_eigenpairs",
    "contours",
    "costs",
    "denoise",
    "distance_matrix",
    "eigenpairs",
    "evaluate_map",
    "examples",
    "farthest_points",
    "functional_map_of",
    "geodesic_distance",
    "hks",
    "intersect_rays",
    "load",
    "load_values",
    "match_spectrum",
    "mean_field_game",
    "molecules",
    "nearest_neighbors",
    "neighbors_within",
    "normals",
    "num_threads",
    "operators",
    "plot",
    "point_map_of",
    "poisson_disc",
    "register",
    "register_conformal",
    "reweight",
    "rotation_invariant_sliced_wasserstein",
    "sample_density",
    "save",
    "segment",
    "segment_path",
    "set_num_threads",
    "shape_dna",
    "shapes",
    "skeleton",
    "sliced_wasserstein",
    "solve_poisson",
    "spherical_map",
    "transfer",
    "transport",
    "wasserstein_barycenter",
    "wks",
]


def __dir__() -> list[str]:
    return __all__  # what a person may use, when a tab asks
