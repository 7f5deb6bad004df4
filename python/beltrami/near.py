"""Neighbours, closest points and rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import _core, arrays
from .arrays import Floats, Ints
from .errors import InputError
from .progress import Progress, reporter
from .shapes import PointCloud, TriangleMesh, no_shape

__all__ = [
    "ClosestPointsResult",
    "RayHitsResult",
    "closest_points",
    "intersect_rays",
    "nearest_neighbors",
    "neighbors_within",
    "normals",
]


_MANY = 10  # dimensions from which on a tree prunes nothing

Places = npt.ArrayLike | PointCloud | TriangleMesh


def places(value: Places, name: str) -> Floats:
    """Positions (n, D) from an array or a shape."""
    return value.coordinates if isinstance(value, TriangleMesh | PointCloud) else arrays.points(value, name)


def _queries(value: Places, name: str, dimension: int) -> Floats:
    queries = places(value, name)
    return queries if len(queries) else np.zeros((0, dimension))


def nearest_neighbors(points: Places, queries: Places, k: int, *, progress: Progress = None) -> tuple[Ints, Floats]:
    """Find the k points nearest to each query, exactly, in any dimension.

    Parameters
    ----------
    points : (n, D) array, or a shape
        May repeat.
    queries : (m, D) array, or a shape
        The points themselves, or others. A query that is one of the points finds itself first (of equal points, the one of least
        index).
    k : int
        From 1 to n.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    indices : (m, k) int32 array
        Nearest first; equally near points by index.
    distances : (m, k) array
        In the units of the points.

    Raises
    ------
    InputError
        If k is out of range or too large for memory, dimensions differ or a coordinate is not finite.

    Notes
    -----
    The search uses a kd-tree with tight boxes; for k = 1 in many dimensions, it uses products of matrices and rechecks what rounding
    leaves open. The result is that of comparing with every point, and bit-for-bit the same on any number of threads.
    "Equally near" compares squared distances as computed in double precision.

    Examples
    --------
    >>> import beltrami as bt
    >>> indices, distances = bt.nearest_neighbors([[0.0, 0.0], [3.0, 4.0], [1.0, 0.0]], [[0.0, 0.0]], 2)
    >>> indices.tolist(), distances.tolist()
    ([[0, 2]], [[0.0, 1.0]])
    """
    table = places(points, "points")
    wanted = _queries(queries, "queries", table.shape[1])
    k = arrays.whole(k, "k", 1, max(len(table), 1))
    arrays.room(1.5 * k * len(wanted), f"k = {k} neighbours of {len(wanted)} queries", "take a smaller k or fewer queries at a time")
    if k == 1 and table.shape[1] >= _MANY and len(table):
        indices, distances = _core.nearest_rows(table, wanted, reporter(progress, "neighbours"))
        return indices[:, None], distances[:, None]
    return _core.nearest_neighbors(table, wanted, k, reporter(progress, "neighbours"))


def neighbors_within(
    points: Places, queries: Places, radius: float, *, progress: Progress = None
) -> tuple[npt.NDArray[np.int64], Ints, Floats]:
    """Find all points within a radius of each query, exactly, in any dimension.

    Parameters
    ----------
    points : (n, D) array, or a shape
        May repeat.
    queries : (m, D) array, or a shape
        The points themselves, or others.
    radius : float
        At least 0; a point at exactly this distance counts.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    starts : (m + 1,) int64 array
        The points near query i are ``indices[starts[i]:starts[i + 1]]``: the layout of a sparse matrix in compressed rows.
    indices : int32 array
        Nearest first; equally near points by index.
    distances : array
        In the units of the points.

    Raises
    ------
    InputError
        If the radius is negative, dimensions differ, a coordinate is not finite, or memory has no room for all that is near.

    Examples
    --------
    >>> import beltrami as bt
    >>> starts, indices, distances = bt.neighbors_within([[0.0], [1.0], [5.0]], [[0.0], [4.0]], 1.0)
    >>> starts.tolist(), indices.tolist()
    ([0, 2, 3], [0, 1, 2])
    """
    table = places(points, "points")
    wanted = _queries(queries, "queries", table.shape[1])
    most = arrays.memory() // 32  # an index and a distance, in lists and in one array
    return _core.neighbors_within(table, wanted, arrays.number(radius, "radius", least=0.0), most, reporter(progress, "neighbours"))


def _mesh(mesh: TriangleMesh) -> tuple[Floats, Ints]:
    if not isinstance(mesh, TriangleMesh):
        raise no_shape(mesh, "mesh", "a TriangleMesh")
    return mesh.vertices, mesh.faces


@dataclass(frozen=True, eq=False)
class ClosestPointsResult:
    """What :func:`closest_points` found, a row per query.

    Attributes
    ----------
    points : (q, D) array
        The points of the mesh that are closest.
    distances : (q,) array
        In the units of the mesh.
    faces : (q,) int32 array
        The triangle each lies on; in a tie the one with the lowest index.
    barycentric : (q, 3) array
        ``points[i]`` is ``barycentric[i] @ vertices[mesh.faces[faces[i]]]``; at least 0, sum 1.
    """

    points: Floats
    distances: Floats
    faces: Ints
    barycentric: Floats

    def __repr__(self) -> str:
        far = f", the farthest {self.distances.max():.6g} away" if len(self.distances) else ""
        return f"ClosestPointsResult({len(self.distances)} queries{far})"


def closest_points(mesh: TriangleMesh, queries: Places, *, progress: Progress = None) -> ClosestPointsResult:
    """Find the point of a triangle mesh that is closest to each query, exactly, in R^D.

    Parameters
    ----------
    mesh : TriangleMesh
        At least one face. Degenerate triangles count as the segments or points that they are.
    queries : (q, D) array
        Points in the space of the mesh.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    ClosestPointsResult

    Raises
    ------
    InputError
        If the mesh has no faces, a query is not finite or has another dimension.

    Notes
    -----
    The search uses a tree of bounding boxes along a Hilbert curve, in double precision: distances are accurate to some 1e-15 of the
    extent of mesh and queries, and bit-for-bit the same on any number of threads.

    Examples
    --------
    >>> import beltrami as bt
    >>> mesh = bt.TriangleMesh([[0, 0, 0], [2, 0, 0], [0, 2, 0]], [[0, 1, 2]])
    >>> found = bt.closest_points(mesh, [[0.5, 0.5, 3.0], [-1.0, 0.0, 0.0]])
    >>> found.distances.tolist(), found.points.tolist()
    ([3.0, 1.0], [[0.5, 0.5, 0.0], [0.0, 0.0, 0.0]])
    """
    arrays_of = _mesh(mesh)
    wanted = _queries(queries, "queries", mesh.dimension)
    return ClosestPointsResult(*_core.closest_points(arrays_of, wanted, reporter(progress, "closest points")))


@dataclass(frozen=True, eq=False)
class RayHitsResult:
    """Where :func:`intersect_rays` found each ray to meet the mesh first, a row per ray.

    Attributes
    ----------
    faces : (r,) int32 array
        The triangle that is hit, in a tie the one with the lowest index; -1 if the ray misses.
    distances : (r,) array
        From the origins, in the units of the mesh, whatever the lengths of the directions; inf if the ray misses.
    points : (r, 3) array
        The points that are hit; the origin of the ray if it misses.
    barycentric : (r, 3) array
        Barycentric coordinates of the hits in their faces; 0 if the ray misses.
    """

    faces: Ints
    distances: Floats
    points: Floats
    barycentric: Floats

    def __repr__(self) -> str:
        return f"RayHitsResult({len(self.faces)} rays, {int((self.faces >= 0).sum())} hits)"


def intersect_rays(mesh: TriangleMesh, origins: npt.ArrayLike, directions: npt.ArrayLike, *, progress: Progress = None) -> RayHitsResult:
    """Find the first point of a triangle mesh in R^3 that each ray meets.

    Parameters
    ----------
    mesh : TriangleMesh
        In R^3, at least one face. Both sides of a face count.
    origins : (r, 3) array
        A ray that starts on the mesh hits it there, at distance 0.
    directions : (r, 3) array
        Of any positive length.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    RayHitsResult

    Raises
    ------
    InputError
        If the mesh is not in R^3 or has no faces, a number is not finite, a direction is zero, or shapes differ.

    References
    ----------
    Woop, Benthin, Wald, Watertight ray/triangle intersection, JCGT 2013: a ray through an edge or a vertex is never lost between the
    faces there. Rays within a face's plane do not hit it.

    Examples
    --------
    >>> import beltrami as bt
    >>> mesh = bt.TriangleMesh([[0, 0, 0], [2, 0, 0], [0, 2, 0]], [[0, 1, 2]])
    >>> found = bt.intersect_rays(mesh, [[0.5, 0.5, 3.0], [5.0, 5.0, 3.0]], [[0, 0, -1], [0, 0, -1]])
    >>> found.faces.tolist(), found.distances.tolist()
    ([0, -1], [3.0, inf])
    """
    vertices, triangles = _mesh(mesh)
    starts = _queries(origins, "origins", 3)
    faces, distances, barycentric = _core.intersect_rays(
        (vertices, triangles), starts, _queries(directions, "directions", 3), reporter(progress, "rays")
    )
    points = starts.copy()
    hit = faces >= 0
    points[hit] = np.einsum("rk,rkd->rd", barycentric[hit], vertices[triangles[faces[hit]]])
    return RayHitsResult(faces, distances, points, barycentric)


def normals(points: npt.ArrayLike | PointCloud, *, neighbors: int = 16, progress: Progress = None) -> Floats:
    """Estimate unit normals of points on a surface of dimension D - 1 in R^D, oriented consistently and, on closed surfaces, outwards.

    Parameters
    ----------
    points : (n, D) array or PointCloud
        n >= D >= 2.
    neighbors : int
        How many nearest points, itself included, a normal is estimated from; at least D. At most n are used.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    (n, D) array

    Raises
    ------
    InputError
        If the neighbours of a point do not span a hyperplane (they coincide, or lie on a line); the message names the point.

    Notes
    -----
    A normal is the direction in which the neighbours vary least. Signs are propagated along a minimum spanning forest of the graph of
    neighbours, by reflection across each edge. In each component of that graph the normal of the point farthest from the mean of the
    component points away from the mean. A surface without a consistent orientation (a Möbius strip) gets a seam.

    References
    ----------
    Hoppe, DeRose, Duchamp, McDonald, Stuetzle, Surface reconstruction from unorganized points, SIGGRAPH 1992.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> sphere = np.random.default_rng(0).normal(size=(500, 3))
    >>> sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    >>> bool(((bt.normals(sphere) * sphere).sum(1) > 0.95).all())
    True
    """
    table = arrays.points(points.points if isinstance(points, PointCloud) else points, "points", least=2)
    wanted = min(arrays.whole(neighbors, "neighbors", table.shape[1]), len(table))
    if len(table) < table.shape[1]:
        raise InputError(f"{len(table)} points do not span a hyperplane of R^{table.shape[1]}; {table.shape[1]} or more are needed")
    arrays.room(4.0 * wanted * len(table), f"neighbors = {wanted} of each of {len(table)} points", "take fewer neighbours")
    return _core.normals(table, wanted, reporter(progress, "normals"))
