"""The compiled core. Users call it through the modules of beltrami; stubtest holds this file against the real thing."""

from collections.abc import Callable
from typing import Any, final

import numpy as np
import numpy.typing as npt

from .arrays import CsrArrays as CsrArrays
from .arrays import Floats as Floats
from .arrays import Ints as Ints

__all__ = [
    "Cholesky",
    "Conjugate",
    "Elements",
    "HeatMethod",
    "LaplacianSolver",
    "Rigid",
    "SlicedAlignment",
    "SpaceTime",
    "TransportDomain",
    "ascend_triple_products",
    "check_mesh",
    "closest_points",
    "constrain",
    "contour_graph",
    "cotangent_operators",
    "divergence",
    "eigenpairs",
    "excess_gradient",
    "face_areas",
    "farthest_points",
    "first_copies",
    "galerkin_mass",
    "gradient",
    "has_positive_weights",
    "intersect_rays",
    "intrinsic_divergence",
    "intrinsic_gradient",
    "intrinsic_operators",
    "level_set",
    "load_bytes",
    "load_file",
    "local_edge_length",
    "local_gradient",
    "local_mass",
    "local_mesh",
    "local_stiffness",
    "local_volumes",
    "make_cylinder",
    "make_disc",
    "make_ellipsoid",
    "make_flat_torus",
    "make_grid",
    "make_knot",
    "make_star",
    "make_tori",
    "make_torus",
    "moebius_translated",
    "moving_least_squares",
    "nearest_neighbors",
    "nearest_rows",
    "neighbors_within",
    "normals",
    "num_threads",
    "oriented_faces",
    "oriented_normals",
    "orthogonal_functional_map",
    "paint",
    "plane_fits",
    "png",
    "poisson_disc",
    "polar",
    "save_file",
    "sectors",
    "set_num_threads",
    "sliced_distance",
    "spectral_point_maps",
    "strokes",
    "thinnest_face",
    "topology",
    "triangulate",
    "upsample_maps",
    "weld",
]

_CsrParts = tuple[Floats, npt.NDArray[np.integer], npt.NDArray[np.integer]]

# io
def load_file(
    path: str, format: str | None, weld: bool | None, progress: Callable[[float], object] | None
) -> tuple[Floats, Ints, list[tuple[str, npt.NDArray[Any]]]]: ...
def load_bytes(
    bytes: bytes, name: str, format: str | None, weld: bool | None, progress: Callable[[float], object] | None
) -> tuple[Floats, Ints, list[tuple[str, npt.NDArray[Any]]]]: ...
def save_file(
    path: str,
    vertices: Floats,
    faces: Ints,
    data: list[tuple[str, npt.NDArray[Any]]],
    format: str | None,
    ascii: bool,
    progress: Callable[[float], object] | None,
) -> list[str]: ...
def triangulate(vertices: Floats, sizes: npt.NDArray[np.int64], corners: Ints) -> Ints: ...
def weld(
    vertices: Floats, faces: Ints, data: list[tuple[str, npt.NDArray[Any]]]
) -> tuple[Floats, Ints, list[tuple[str, npt.NDArray[Any]]]]: ...

_SimplexArrays = tuple[Floats, Ints, npt.NDArray[np.uint8], Floats | None]

# local_mesh
def local_mesh(
    points: Floats,
    dimension: int,
    neighbors: int | None = None,
    normals: Floats | None = None,
    reach: Floats | None = None,
    progress: Callable[[float], object] | None = None,
) -> tuple[
    Ints,
    npt.NDArray[np.uint8],
    npt.NDArray[np.uint8],
    Floats,
    npt.NDArray[np.bool_],
    npt.NDArray[np.bool_],
    Floats,
    Floats,
    Floats,
    float,
]: ...
def local_stiffness(mesh: _SimplexArrays, potential: Floats | None = None) -> _CsrParts: ...
def local_mass(mesh: _SimplexArrays) -> Floats: ...
def local_edge_length(mesh: _SimplexArrays) -> float: ...
def local_volumes(mesh: _SimplexArrays) -> Floats: ...
def local_gradient(mesh: _SimplexArrays) -> _CsrParts: ...

# mls
def moving_least_squares(
    points: Floats,
    dimension: int,
    degree: int,
    neighbors: int | None = None,
    weight: str = "special",
    constrained: bool = True,
    normals: Floats | None = None,
    progress: Callable[[float], object] | None = None,
) -> tuple[_CsrParts, _CsrParts, npt.NDArray[np.uint32], float]: ...

# intrinsic
_TriangulationArrays = tuple[int, Ints, Ints, Floats, bool]

def intrinsic_operators(
    mesh: tuple[Floats, Ints], cover: bool, voronoi: bool, progress: Callable[[float], object] | None = None
) -> tuple[_CsrParts, Floats, tuple[Ints, Ints, Floats, Floats], float, tuple[int, int, int]]: ...
def intrinsic_gradient(triangulation: _TriangulationArrays) -> _CsrParts: ...
def intrinsic_divergence(triangulation: _TriangulationArrays, mass: Floats) -> _CsrParts: ...
def thinnest_face(mesh: tuple[Floats, Ints]) -> tuple[int, float] | None: ...

# levelset
def level_set(
    mesh: tuple[Floats, Ints], values: Floats, level: float
) -> tuple[Floats, Ints, Floats, npt.NDArray[np.int64], npt.NDArray[np.bool_]]: ...

# shrink
@final
class Elements:
    def __new__(cls, nodes: int, corners: Ints, hats: Floats, weights: Floats) -> Elements: ...
    def total_variation(self, values: Floats, joint: bool) -> float: ...
    def flux(self, field: Floats, flux: Floats) -> None: ...
    def shrink(
        self,
        values: Floats,
        split: Floats,
        dual: Floats,
        flux: Floats,
        joint: bool,
        radius: float,
        penalty: float,
        relaxation: float,
    ) -> tuple[float, float]: ...

def constrain(
    values: Floats,
    cost: Floats,
    weights: Floats,
    split: Floats,
    dual: Floats,
    right: Floats,
    penalty: float,
    ratio: float,
    relaxation: float,
) -> tuple[float, float]: ...

# eigen
def eigenpairs(
    matrix: CsrArrays,
    diagonal: Floats | None,
    mass: CsrArrays | None,
    k: int,
    shift: float | None,
    coordinates: Floats | None,
    start: Floats | None,
    progress: Callable[[float], object] | None,
) -> tuple[Floats, Floats, Floats, int]: ...

# geodesic
@final
class HeatMethod:
    def __new__(
        cls,
        stiffness: CsrArrays,
        mass: Floats,
        gradient: CsrArrays,
        areas: Floats,
        spacing: float,
        boundary: npt.NDArray[np.bool_],
        coordinates: Floats,
        time_factor: float,
        progress: Callable[[float], object] | None,
    ) -> HeatMethod: ...
    def distance(self, sources: npt.NDArray[np.int64]) -> Floats: ...

@final
class LaplacianSolver:
    def __new__(
        cls,
        stiffness: CsrArrays,
        mass: Floats,
        coordinates: Floats,
        residual: float | None,
        progress: Callable[[float], object] | None,
    ) -> LaplacianSolver: ...
    def solve(self, b: Floats, tolerance: float | None) -> Floats: ...

# near
def closest_points(
    mesh: tuple[Floats, Ints], queries: Floats, progress: Callable[[float], object] | None = None
) -> tuple[Floats, Floats, Ints, Floats]: ...
def intersect_rays(
    mesh: tuple[Floats, Ints], origins: Floats, directions: Floats, progress: Callable[[float], object] | None = None
) -> tuple[Ints, Floats, Floats]: ...
def normals(points: Floats, neighbors: int, progress: Callable[[float], object] | None = None) -> Floats: ...
def nearest_neighbors(
    points: Floats, queries: Floats, wanted: int, progress: Callable[[float], object] | None = None
) -> tuple[Ints, Floats]: ...
def nearest_rows(points: Floats, queries: Floats, progress: Callable[[float], object] | None = None) -> tuple[Ints, Floats]: ...
def neighbors_within(
    points: Floats, queries: Floats, radius: float, most: int, progress: Callable[[float], object] | None = None
) -> tuple[npt.NDArray[np.int64], Ints, Floats]: ...
def oriented_normals(
    points: Floats, fitted: int, linked: int, progress: Callable[[float], object] | None = None
) -> tuple[Floats, float]: ...
def plane_fits(points: Floats, near: Ints) -> tuple[Floats, Floats, Floats]: ...
def sectors(
    points: Floats,
    starts: npt.NDArray[np.int64],
    axis: int,
    places: Floats,
    tangents: Floats,
    first: Floats,
    second: Floats,
    reach: Floats,
    thickness: Floats,
    group: Ints,
    directions: int,
) -> Floats: ...

# register
_Spectral = tuple[Floats, Floats, Floats]

def polar(matrix: Floats) -> Floats: ...
def ascend_triple_products(
    maps: Floats,
    source_even: Floats,
    source_odd: Floats,
    target_even: Floats,
    target_odd: Floats,
    weight: float,
    linear: Floats,
    steps: int,
    progress: Callable[[float], object] | None = None,
) -> tuple[Floats, Floats]: ...
def upsample_maps(
    maps: Floats, following: int, source: _Spectral, target: _Spectral, progress: Callable[[float], object] | None = None
) -> Floats: ...
def spectral_point_maps(
    map: Floats, source: _Spectral, target: _Spectral, progress: Callable[[float], object] | None = None
) -> tuple[Ints, Ints]: ...
def orthogonal_functional_map(forward: Ints, backward: Ints, modes: int, source: _Spectral, target: _Spectral) -> Floats: ...

@final
class Rigid:
    def __new__(cls, weights: CsrArrays, rest: Floats) -> Rigid: ...
    def fit(self, positions: Floats, stretch: float) -> tuple[Floats, float]: ...

# operators
def cotangent_operators(mesh: tuple[Floats, Ints], voronoi: bool) -> tuple[_CsrParts, Floats, float]: ...
def gradient(mesh: tuple[Floats, Ints]) -> _CsrParts: ...
def divergence(mesh: tuple[Floats, Ints], mass: Floats) -> _CsrParts: ...
def galerkin_mass(mesh: tuple[Floats, Ints]) -> _CsrParts: ...
def has_positive_weights(stiffness: CsrArrays) -> bool: ...

# reeb
def contour_graph(
    points: Floats,
    cells: Ints,
    values: Floats,
    ranks: npt.NDArray[np.uint32],
    cuts: npt.NDArray[np.uint32],
    levels: Floats,
    weights: Floats,
    progress: Callable[[float], object] | None = None,
) -> tuple[
    npt.NDArray[np.uint32],
    npt.NDArray[np.uint32],
    npt.NDArray[np.uint32],
    Floats,
    Floats,
    npt.NDArray[np.int64],
    npt.NDArray[np.uint32],
    int,
]: ...

# sampling
def first_copies(points: Floats) -> npt.NDArray[np.bool_]: ...
def farthest_points(points: Floats, wanted: int, start: int, progress: Callable[[float], object] | None = None) -> Ints: ...
def poisson_disc(points: Floats, radius: float, order: Ints, progress: Callable[[float], object] | None = None) -> Ints: ...

# shape
def check_mesh(mesh: tuple[Floats, Ints]) -> None: ...
def face_areas(mesh: tuple[Floats, Ints]) -> Floats: ...
def topology(
    mesh: tuple[Floats, Ints],
) -> tuple[Ints, Ints, tuple[int, int, int, int, bool, bool], list[Ints], str | None, list[int] | None, str | None, int | None]: ...
def oriented_faces(mesh: tuple[Floats, Ints]) -> Ints: ...
def make_ellipsoid(frequency: int, semi_axes: tuple[float, float, float]) -> tuple[Floats, Ints]: ...
def make_torus(radii: tuple[float, float], rows: int, columns: int) -> tuple[Floats, Ints]: ...
def make_flat_torus(radii: tuple[float, float], rows: int, columns: int) -> tuple[Floats, Ints]: ...
def make_grid(width: float, height: float, rows: int, columns: int) -> tuple[Floats, Ints]: ...
def make_cylinder(radius: float, height: float, rows: int, columns: int, closed: bool) -> tuple[Floats, Ints]: ...
def make_disc(radius: float, rings: int) -> tuple[Floats, Ints]: ...
def make_knot(p: int, q: int, radii: tuple[float, float, float], rows: int, columns: int) -> tuple[Floats, Ints]: ...
def make_tori(
    kind: str, radii: tuple[float, float], resolution: int, progress: Callable[[float], object] | None = None
) -> tuple[Floats, Ints]: ...
def make_star(
    arms: int, arm_length: float, tube_radius: float, resolution: int, progress: Callable[[float], object] | None = None
) -> tuple[Floats, Ints]: ...

# cholesky
@final
class Cholesky:
    def __new__(
        cls,
        matrix: CsrArrays,
        coordinates: Floats | None,
        order: npt.NDArray[np.uint32] | None,
        progress: Callable[[float], object] | None,
    ) -> Cholesky: ...
    def refactor(self, matrix: CsrArrays, progress: Callable[[float], object] | None) -> None: ...
    def solve(self, b: Floats) -> Floats: ...
    def solve_into(self, b: Floats, out: Floats) -> None: ...
    def residuals(self, b: Floats, x: Floats) -> Floats: ...
    def matrix(self) -> tuple[Floats, npt.NDArray[Any], npt.NDArray[Any]]: ...
    def order(self) -> npt.NDArray[np.uint32]: ...
    def unknowns(self) -> int: ...
    def nnz(self) -> int: ...
    def log_determinant(self) -> float: ...

# conjugate
@final
class Conjugate:
    def __new__(cls, matrix: CsrArrays) -> Conjugate: ...
    def improve(self, b: Floats, x: Floats, reduction: float, most: int) -> int: ...

# sliced
def sliced_distance(
    source: Floats,
    target: Floats,
    source_weights: Floats | None,
    target_weights: Floats | None,
    directions: Floats,
    progress: Callable[[float], object] | None = None,
) -> float: ...

@final
class SlicedAlignment:
    def __new__(
        cls, source: Floats, target: Floats, source_weights: Floats | None, target_weights: Floats | None, directions: Floats
    ) -> SlicedAlignment: ...
    def step(self, rotations: Floats) -> tuple[Floats, Floats]: ...

# threads
def num_threads() -> int: ...
def set_num_threads(count: int) -> None: ...

# view
def paint(
    frame: dict[str, Any],
    camera: dict[str, Any],
    surface: dict[str, Any] | None,
    balls: list[tuple[Floats, Floats, npt.NDArray[np.float32], Floats]],
    lines: tuple[Floats, list[int], list[float], list[tuple[float, float, float, float]]] | None,
    progress: Callable[[float], object] | None = None,
) -> npt.NDArray[np.uint8]: ...
def png(picture: npt.NDArray[np.uint8]) -> bytes: ...
def strokes(
    picture: npt.NDArray[np.uint8], groups: list[tuple[Floats, list[int], float, tuple[float, float, float, float]]]
) -> npt.NDArray[np.uint8]: ...

# sphere
def excess_gradient(positions: Floats, faces: Ints, cotangents: Floats, weights: Floats | None) -> tuple[Floats, Floats, float]: ...
def moebius_translated(
    positions: Floats, center: tuple[float, float, float], weights: Floats
) -> tuple[Floats, tuple[float, float, float]]: ...

@final
class TransportDomain:
    def __new__(cls, elements: Elements, mass: Floats, coordinates: Floats | None) -> TransportDomain: ...
    def labels(self) -> npt.NDArray[np.uint32]: ...
    def gather(self, scalar: Floats, field: Floats, other: Floats, factors: Floats, mean: Floats, flux: Floats) -> None: ...
    def densities(self, nodal: Floats, out: Floats) -> None: ...
    def gradients(self, nodal: Floats, out: Floats) -> None: ...
    def hamiltonian(self, potential: Floats, weights: Floats, power: float, out: Floats) -> None: ...
    def step(
        self,
        steps: tuple[float, float, float, float],
        weights: Floats,
        sizes: Floats,
        mobility: Floats,
        before: Floats,
        after: Floats,
        potential: Floats,
        momentum: Floats,
        dual_density: Floats,
        dual_momentum: Floats,
    ) -> None: ...
    def repairs(
        self,
        potential: Floats,
        weights: Floats,
        limit: Floats,
        bounded: bool,
        power: float,
        ways: list[tuple[int, float, bool]],
        out: Floats,
    ) -> None: ...
    def optimal_momentum(self, conductivity: Floats, rate: Floats, out: Floats) -> None: ...

@final
class SpaceTime:
    def __new__(
        cls, domain: TransportDomain, intervals: int, end: float | None, nodes: Floats, elements: Floats, memory: float
    ) -> SpaceTime: ...
    def factors(self) -> int: ...
    def solve(self, right: Floats, out: Floats) -> None: ...
