"""Geodesic distance by the heat method, on meshes and clouds."""

from __future__ import annotations

from typing import Any

from . import _core, arrays, intrinsic
from .arrays import Floats
from .operators import Operators, operators
from .progress import Progress, reporter
from .shapes import Shape, TriangleMesh

__all__ = ["HeatMethod", "geodesic_distance"]


class HeatMethod:
    """Geodesic distances on one shape from many sets of sources, with factorizations computed once.

    Heat spreads for a short time from the sources, its normalized gradient is that of the distance, and a Poisson equation
    recovers the distance from it [1]_:

    1. ``(M + t L) u = δ``, 2. ``X = -grad u / |grad u|``, 3. ``L φ = -M div X``. On shapes with boundary u is the sum
    of the flows with natural and with zero boundary values. Between sources that are neighbours X is 0, and φ is 0 at every source.

    If an off-diagonal entry of a mesh's stiffness is positive (edges that are not Delaunay, obtuse angles at the boundary), heat would
    become negative and distances wrong. Then the operators of the tufted cover [2]_ are used, and ``operators.notes`` says so.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
    time_factor : float
        The time t in units of the squared spacing. Larger values smooth more.

    Attributes
    ----------
    operators : Operators
        The operators that are used.

    References
    ----------
    .. [1] Crane, Weischedel and Wardetzky, Geodesics in heat, ACM Transactions on Graphics 32, 2013.
    .. [2] Sharp and Crane, A Laplacian for nonmanifold triangle meshes, Computer Graphics Forum 39, 2020.

    Examples
    --------
    >>> import beltrami as bt
    >>> heat = bt.HeatMethod(bt.shapes.sphere(4))
    >>> north, south = heat.distance([0]), heat.distance([1])
    """

    def __init__(self, shape: Shape | Operators, *, time_factor: float = 1.0, progress: Progress = None) -> None:
        self.time_factor = arrays.number(time_factor, "time_factor", above=0.0)
        ops = self.operators = _without_positive_weights(operators(shape))
        self._core = _core.HeatMethod(
            arrays.csr_in(ops.stiffness, "the stiffness"),
            ops.mass,
            arrays.csr_in(ops.simplex_gradient, "the gradient"),
            ops.simplex_areas,
            ops.spacing,
            ops.boundary,
            ops.coordinates,
            self.time_factor,
            reporter(progress, "heat method"),
        )

    def __repr__(self) -> str:
        return f"HeatMethod({self.operators!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _remake, (self.operators, self.time_factor)

    def distance(self, sources: Any) -> Floats:
        """Distance to the nearest source.

        Parameters
        ----------
        sources : int, array_like of int, or mask (n,)
            One vertex or several.

        Returns
        -------
        ndarray (n,)
            In the user's units; 0 at the sources, inf on components without a source.

        Raises
        ------
        InputError
            No source, or one that is no vertex.
        """
        return self._core.distance(arrays.indices(sources, "sources", len(self.operators.mass)))


def _without_positive_weights(ops: Operators) -> Operators:
    shape = ops.shape
    if not isinstance(shape, TriangleMesh) or not _core.has_positive_weights(arrays.csr_in(ops.stiffness, "the stiffness")):
        return ops
    note = f"the heat method took 'tufted': {ops.kind!r} has edges of positive weight, where heat would become negative"
    return intrinsic.build(shape, "tufted", voronoi=False, progress=None, notes=(*ops.notes, note))


def _remake(ops: Operators, time_factor: float) -> HeatMethod:
    return HeatMethod(ops, time_factor=time_factor)


def geodesic_distance(shape: Shape | Operators, sources: Any, *, time_factor: float = 1.0, progress: Progress = None) -> Floats:
    """Compute the geodesic distance to the nearest of one or many sources, by the heat method.

    For several sets of sources on one shape, use a :class:`HeatMethod`.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
    sources : int, array_like of int, or mask (n,)
        Vertices at distance 0.
    time_factor : float
        Time of the heat flow in units of the squared spacing.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    ndarray (n,)
        In the user's units; inf on components without a source. The error is about the spacing.

    Notes
    -----
    If an off-diagonal entry of the mesh's stiffness is positive, the tufted cover is used; see :class:`HeatMethod`.

    Raises
    ------
    InputError
        There is no source, a source is not a vertex, or the shape has no triangles.

    References
    ----------
    Crane, Weischedel and Wardetzky, Geodesics in heat, ACM Transactions on Graphics 32, 2013.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> sphere = bt.shapes.sphere(4)
    >>> d = bt.geodesic_distance(sphere, 0)
    >>> bool(abs(d.max() - np.pi) < 0.05)
    True
    """
    ops = operators(shape)
    chosen = arrays.indices(sources, "sources", len(ops.mass))
    return HeatMethod(ops, time_factor=time_factor, progress=progress).distance(chosen)
