"""Subsets of a shape's points that cover it evenly."""

from __future__ import annotations

import numpy as np

from . import _core, arrays
from .arrays import Ints
from .near import Places, places
from .progress import Progress, reporter

__all__ = ["farthest_points", "poisson_disc"]


def farthest_points(points: Places, k: int, *, start: int = 0, progress: Progress = None) -> Ints:
    """Choose k points, each the farthest (in a straight line) from all those before it.

    Parameters
    ----------
    points : PointCloud, TriangleMesh, or array_like (n, D)
    k : int
        From 1 to n.
    start : int
        The first one.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    ndarray (k,) of int32
        Their indices, in the order of choice; ties go to the lower index. The first j of them are the answer for j.

    Raises
    ------
    InputError
        k or start is out of range, or a coordinate is not finite.

    References
    ----------
    Gonzalez, Clustering to minimize the maximum intercluster distance, 1985: no k balls that cover the points have less than
    half the radius of these.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.farthest_points([[0.0], [1.0], [2.0], [3.0], [10.0]], 3).tolist()
    [0, 4, 3]
    """
    table = places(points, "points")
    wanted = arrays.whole(k, "k", 1, len(table))
    first = arrays.whole(start, "start", 0, len(table) - 1)
    return _core.farthest_points(table, wanted, first, reporter(progress, "farthest points"))


def poisson_disc(points: Places, radius: float, *, rng: int | np.random.Generator | None = None, progress: Progress = None) -> Ints:
    """Choose points such that no two are closer than a radius, and every other point is closer than that to one of them.

    Parameters
    ----------
    points : PointCloud, TriangleMesh, or array_like (n, D)
    radius : float
        In units of length.
    rng : int or numpy Generator, optional
        Points are tried in a random order; without it, in the order of their indices.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    ndarray (k,) of int32
        Their indices, in the order of choice.

    Raises
    ------
    InputError
        The radius is not positive, or a coordinate is not finite.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.poisson_disc([[0.0], [1.0], [2.0], [3.0]], 1.5).tolist()
    [0, 2]
    """
    table = places(points, "points")
    size = arrays.number(radius, "radius", above=0.0)
    order = np.arange(len(table)) if rng is None else arrays.generator(rng).permutation(len(table))
    return _core.poisson_disc(table, size, order.astype(np.int32), reporter(progress, "Poisson discs"))
