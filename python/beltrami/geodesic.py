"""Geodesic distance by the heat method, on meshes and clouds."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import arrays
from .arrays import Floats
from .errors import InputError
from .operators import Operators, operators
from .progress import Progress, part, reporter
from .shapes import Shape
from .solvers import Cholesky, PoissonSolver, plus_diagonal

__all__ = ["HeatMethod", "geodesic_distance"]

_FADED = 1e-250  # heat below this has lost digits to underflow: a longer time shows the direction there
_LONGER = 64.0  # factor between one time and the next


class HeatMethod:
    """Distances on one shape from as many sets of sources as one likes: the factorizations are kept.

    Heat spreads for a short time from the sources, its normalized gradient is that of the distance, and a Poisson equation
    recovers the distance from it (Crane, Weischedel and Wardetzky 2013):

    1. ``(M + t L) u = δ``, 2. ``X = -grad u / |grad u|``, 3. ``L φ = -M div X``.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
    time_factor : float
        The time t in units of the squared spacing. Larger smooths.

    Examples
    --------
    >>> import beltrami as bt
    >>> heat = bt.HeatMethod(bt.shapes.sphere(4))
    >>> north, south = heat.distance([0]), heat.distance([1])
    """

    def __init__(self, shape: Shape | Operators, *, time_factor: float = 1.0, progress: Progress = None) -> None:
        report = reporter(progress, "heat method")
        self.operators = operators(shape)
        self.time = arrays.number(time_factor, "time_factor", above=0.0) * self.operators.spacing**2
        self._heat = [self._factor(self.time, part(report, 0.0, 0.5))]
        self._poisson = PoissonSolver(self.operators, progress=part(report, 0.5, 1.0))

    def _factor(self, time: float, report: Any) -> Cholesky:
        ops = self.operators
        diagonal = np.where(ops.mass > 0, ops.mass, 1.0)  # vertices of no triangle stay apart
        return Cholesky(plus_diagonal(time * ops.stiffness, diagonal), ops.coordinates, progress=report)

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
        ops = self.operators
        n = len(ops.mass)
        chosen = arrays.indices(sources, "sources", n)
        labels = ops.component_labels
        reached = np.isin(labels, labels[chosen])
        field = self._directions(chosen, reached)
        flux = ops.simplex_gradient.T @ (field * ops.simplex_areas[:, None]).ravel()
        distance = self._poisson.solve_integrated(flux)
        # The Poisson equation leaves a constant free on each component: the distance is 0 at its sources, on the average.
        offset = np.zeros(int(labels.max()) + 1)
        np.add.at(offset, labels[chosen], distance[chosen])
        offset /= np.maximum(np.bincount(labels[chosen], minlength=len(offset)), 1)
        distance = np.maximum(distance - offset[labels], 0.0)
        distance[chosen] = 0.0
        distance[~reached] = np.inf
        return distance

    def _directions(self, chosen: Any, reached: Any) -> Floats:
        """The unit field -grad u / |grad u|, one row an element."""
        ops = self.operators
        impulse = np.zeros(len(ops.mass))
        impulse[chosen] = 1.0
        count = len(ops.simplex_areas)
        field, unknown = np.zeros((count, ops.simplex_gradient.shape[0] // count)), np.ones(count, bool)
        for step in range(12):
            if step == len(self._heat):
                self._heat.append(self._factor(self.time * _LONGER**step, None))
            heat = self._heat[step].solve(impulse)
            slope = (ops.simplex_gradient @ heat).reshape(field.shape)
            largest = np.abs(slope).max(axis=1)
            usable = unknown & (largest * ops.spacing > _FADED)
            direction = slope[usable] / largest[usable, None]
            field[usable] = -direction / np.linalg.norm(direction, axis=1, keepdims=True)
            unknown &= ~usable
            if not (reached & (np.abs(heat) <= _FADED) & (ops.mass > 0)).any():
                break
        return field


def geodesic_distance(shape: Shape | Operators, sources: Any, *, time_factor: float = 1.0, progress: Progress = None) -> Floats:
    """Geodesic distance to the nearest of one or many sources, by the heat method.

    For several sets of sources on one shape keep a :class:`HeatMethod`.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
    sources : int, array_like of int, or mask (n,)
        Vertices at distance 0.
    time_factor : float
        Time of the heat flow in units of the squared spacing.
    progress : callable or True, optional

    Returns
    -------
    ndarray (n,)
        In the user's units; inf on components without a source. The error is about the spacing.

    Raises
    ------
    InputError
        No source, one that is no vertex, or a shape without triangles.

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
    if not ops.spacing > 0:
        raise InputError("all vertices lie in one point; there are no distances")
    return HeatMethod(ops, time_factor=time_factor, progress=progress).distance(chosen)
