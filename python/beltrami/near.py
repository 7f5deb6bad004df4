"""Neighbours, closest points and rays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from . import _core, arrays
from .arrays import Floats, Ints

__all__ = ["nearest_neighbors", "neighbors_within"]


def nearest_neighbors(points: npt.ArrayLike, queries: npt.ArrayLike, k: int) -> tuple[Ints, Floats]:
    """The k nearest points to each query, exactly, in any dimension.

    Parameters
    ----------
    points : (n, D) array
        May repeat.
    queries : (m, D) array
        The points themselves, or others. A query that is one of the points finds itself first (of equal points, the one of least
        index).
    k : int
        From 1 to n.

    Returns
    -------
    indices : (m, k) int32 array
        Nearest first; equally near points by index.
    distances : (m, k) array
        In the units of the points.

    Raises
    ------
    InputError
        If k is out of range, dimensions differ or a coordinate is not finite.

    Notes
    -----
    A kd-tree with tight boxes, searched exactly: what is found is what comparing with every point finds, and the same bits on any
    number of threads. "Equally near" compares squared distances as computed in double precision.

    Examples
    --------
    >>> import beltrami as bt
    >>> indices, distances = bt.nearest_neighbors([[0.0, 0.0], [3.0, 4.0], [1.0, 0.0]], [[0.0, 0.0]], 2)
    >>> indices.tolist(), distances.tolist()
    ([[0, 2]], [[0.0, 1.0]])
    """
    points, queries = arrays.points(points, "points"), arrays.points(queries, "queries")
    if len(queries) == 0:
        queries = queries.reshape(0, points.shape[1])
    return _core.nearest_neighbors(points, queries, arrays.whole(k, "k", 1, max(len(points), 1)))


def neighbors_within(points: npt.ArrayLike, queries: npt.ArrayLike, radius: float) -> tuple[npt.NDArray[np.int64], Ints, Floats]:
    """All points within a radius of each query, exactly, in any dimension.

    Parameters
    ----------
    points : (n, D) array
        May repeat.
    queries : (m, D) array
    radius : float
        At least 0; a point at exactly this distance counts.

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
        If the radius is negative, dimensions differ or a coordinate is not finite.

    Examples
    --------
    >>> import beltrami as bt
    >>> starts, indices, distances = bt.neighbors_within([[0.0], [1.0], [5.0]], [[0.0], [4.0]], 1.0)
    >>> starts.tolist(), indices.tolist()
    ([0, 2, 3], [0, 1, 2])
    """
    points, queries = arrays.points(points, "points"), arrays.points(queries, "queries")
    if len(queries) == 0:
        queries = queries.reshape(0, points.shape[1])
    return _core.neighbors_within(points, queries, arrays.number(radius, "radius", least=0.0))
