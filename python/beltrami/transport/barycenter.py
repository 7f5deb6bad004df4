"""Barycenters of densities in the Wasserstein distance, by dynamic transports that end in a common density."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..arrays import Floats
from ..costs import Lagrangian
from ..errors import InputError
from ..operators import Operators
from ..progress import GapWatch, Progress
from ..results import save_result
from ..shapes import Shape
from ..view import Page, Picture, plot
from .continuity import COARSE, Model, Problem, Scales, Splitting, Surface, coarser, looks, travel
from .flow import DENSITY_COLOURS, balanced, density_in, options_in

__all__ = ["BarycenterResult", "wasserstein_barycenter"]

RATIO = 0.2  # of the dual to the primal step: ends that must agree want longer dual steps than ends that are given


@dataclass(frozen=True, eq=False, repr=False)
class BarycenterResult:
    """A density that minimizes the mean squared Wasserstein distance from given ones, and a bound on its distance from the optimum.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
    density : ndarray (n,)
        Per unit area; not negative.
    weights : ndarray (k,)
        They add up to 1.
    cost, lower_bound, gap : float
        ``½ Σ w_i W2²`` of the paths that were found, a lower bound for all densities, and the relative difference of the two.
    distances : ndarray (k,)
        Length of the path from each density to the barycenter.
    paths : ndarray (k, intervals + 1, n)
        Densities on the way from each to the barycenter.
    iterations : int
        Number of iterations.
    converged : bool
        Whether the tolerance was reached.
    history : dict of str to ndarray
        ``iteration``, ``cost``, ``lower_bound``, ``gap``.
    """

    shape: Shape
    density: Floats
    weights: Floats
    cost: float
    lower_bound: float
    gap: float
    distances: Floats
    paths: Floats
    iterations: int
    converged: bool
    history: dict[str, npt.NDArray[Any]]

    def __repr__(self) -> str:
        state = "" if self.converged else ", NOT CONVERGED"
        return f"BarycenterResult({len(self.weights)} densities, gap {self.gap:.1e} after {self.iterations} iterations{state})"

    def plot(self, *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints the densities and, last, their barycenter; the options are those of :func:`beltrami.plot`."""
        fields = {f"density {k}, weight {w:.3g}": p[0] for k, (w, p) in enumerate(zip(self.weights, self.paths, strict=True))}
        return plot(self.shape, {**fields, "barycenter": self.density}, path=path, **{"colormap": DENSITY_COLOURS, **options})

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``, the shape with the density to ``.ply``, a picture to ``.png`` or ``.html``."""
        return save_result(self, path, "a barycenter is", values=("density",))


class _Joint:
    """Splittings side by side whose last slices are one density."""

    def __init__(self, models: list[Model], start: _Joint | None = None) -> None:
        self.models = models
        starts: list[Splitting | None] = [None] * len(models) if start is None else [*start.runs]
        self.runs: list[Splitting] = []
        for model, before in zip(models, starts, strict=True):
            concentration = model.density / model.problem.mass  # how much denser than the mean the mass is
            self.runs.append(Splitting(model, start=before, ratio=RATIO * concentration))

    def iterate(self) -> None:
        duals, ends = [], []
        for run in self.runs:
            scale = run.sigma * run.kappa
            v = run.dual_vertex[1:] + scale * run.advance()
            dual = np.minimum(v, 0.0)  # ρ >= 0 inside
            duals.append(dual)
            ends.append(v[-1] / scale[-1])
        common = np.maximum(np.mean(ends, axis=0), 0.0)
        for run, dual, end in zip(self.runs, duals, ends, strict=True):
            dual[-1] = run.sigma * run.kappa[-1, 0] * (end - common)
            run.finish(dual)

    def bound(self) -> float:
        """Paths that pay g_i at their end cost at least L_i; where the g_i add up to zero, Σ L_i is a bound for those that end together."""
        models = self.models
        potentials = [run.psi / run.tau for run in self.runs]
        ends = []
        for model, phi in zip(models, potentials, strict=True):
            ends.append(phi[-1] - model.hamiltonian(phi)[-1] / (2 * model.n))
        mean = np.mean(ends, axis=0)
        total = 0.0
        for model, phi, end in zip(models, potentials, ends, strict=True):
            total += model.linear_bound(np.ascontiguousarray(phi), np.zeros_like(phi), mean - end)[0]
        return total

    def paths(self) -> tuple[float, list[float], list[Floats]]:
        """Paths that end together: their cost, the cost of each, and their densities."""
        surface, models = self.models[0].surface, self.models
        typical = float(models[0].masses.sum())
        common = np.maximum(np.mean([run.density[-1] for run in self.runs], axis=0), 0.0) + 1e-6 * typical
        common = surface.with_mass(common[None], models[0].masses)[0]
        values, found = [], []
        for model, run in zip(models, self.runs, strict=True):
            t = np.linspace(0, 1, model.n + 1)[:, None]
            best, kept = np.inf, run.density
            for path in model.paths(run.density + t * (common - run.density[-1])):
                path[-1] = common
                momentum = model.corrected(path, run.momentum)
                value = min(model.kinetic(path, momentum), model.kinetic(path, model.optimal(path, run.psi / run.tau)))
                if value < best:
                    best, kept = value, path
            values.append(best)
            found.append(kept)
        return float(sum(values)), values, found


def wasserstein_barycenter(
    shape: Shape | Operators,
    densities: Sequence[npt.ArrayLike] | npt.ArrayLike,
    *,
    weights: npt.ArrayLike | None = None,
    intervals: int = 16,
    normalize: bool = False,
    tolerance: float = 2e-3,
    max_iterations: int = 300,
    memory: float | None = None,
    progress: Progress = None,
) -> BarycenterResult:
    """Compute the Wasserstein barycenter [1]_ of densities on a surface: the density that minimizes ``Σ w_i W2²(ρ_i, ρ)``.

    A dynamic transport leads from each density to a common, free end. The iteration is that of :func:`transport` with one more step,
    the mean of the ends. For two densities the result is McCann's interpolation, ``transport(...).interpolate(w_1)``, up to the
    discretization of time and the tolerance.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
    densities : array_like (k, n)
        Per unit area, not negative, of equal mass on each component.
    weights : array_like (k,), optional
        Positive; equal by default. They are divided by their sum.
    intervals : int
        Number of time intervals of each path.
    normalize : bool
        Rescale all densities to the mass of the first.
    tolerance : float
        Relative gap to stop at.
    max_iterations : int
        Iterations after which the best answer so far is returned, with ``converged=False``.
    memory : float, optional
        As for :func:`transport`, for each density.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    BarycenterResult
        With ``converged=False`` if the gap was not reached.

    Raises
    ------
    InputError
        As for :func:`transport`; or there are no densities, or a weight is not positive.

    References
    ----------
    .. [1] M. Agueh, G. Carlier, Barycenters in the Wasserstein space, 2011.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> sphere = bt.shapes.sphere(2)
    >>> corners = [np.exp(4 * sphere.vertices @ axis) + 0.1 for axis in np.eye(3)]
    >>> r = bt.wasserstein_barycenter(sphere, corners, intervals=4, normalize=True)
    >>> r.converged, bool((sphere.vertices[r.density.argmax()] > 0.4).all())
    (True, True)
    """
    surface = Surface(shape)
    wished, most, limit = options_in("primal_dual", tolerance, max_iterations, memory)
    rows: list[Any] = list(densities) if isinstance(densities, Sequence | np.ndarray) else []
    count = len(rows)
    if count == 0:
        raise InputError("densities is empty; give at least one")
    names = [f"densities[{k}]" for k in range(count)]
    given = [density_in(surface, density, name) for density, name in zip(rows, names, strict=True)]
    given = balanced(surface, given, names, normalize)
    share = np.ones(count) if weights is None else arrays.floats(weights, "weights", (count,))
    if share.min() <= 0:
        where = int(np.argmin(share))
        raise InputError(f"weights[{where}] is {share[where]:g}; weights must be positive, so leave densities of weight 0 out")
    share = share / share.sum()
    n = arrays.whole(intervals, "intervals", 1)
    same = max(float(np.abs(density - given[0]).max()) for density in given) <= 1e-14 * float(given[0].max())
    if same:
        none: dict[str, npt.NDArray[Any]] = {name: np.zeros(1) for name in ("iteration", "cost", "lower_bound", "gap")}
        paths = np.repeat(np.repeat(given[0][None, None], n + 1, axis=1), count, axis=0)
        return BarycenterResult(surface.operators.shape, given[0].copy(), share, 0.0, 0.0, 0.0, np.zeros(count), paths, 0, True, none)
    middle = np.tensordot(share, np.stack(given), 1)
    scale = float(np.mean([Problem(surface, density, None, n).concentration for density in given]))
    unit = max(travel(Problem(surface, density, middle, n, memory=limit))[0].length for density in given)

    def models(intervals: int) -> list[Model]:
        made = []
        for density, weight in zip(given, share, strict=True):
            problem = Problem(surface, density, None, intervals, Lagrangian(2.0, float(weight * count)), memory=limit, scale=scale)
            made.append(Model(problem, intervals, Scales(unit, 1.0), float(intervals)))
            if len(made) > 1:
                made[-1].plain = made[0].plain  # the same equation
        return made

    watch = GapWatch(progress, "barycenter", wished)
    joint: _Joint | None = None
    for few in coarser(n):
        joint = _Joint(models(few), joint)
        for _ in range(COARSE):
            joint.iterate()
            watch(1.0, 0.0)
    joint = _Joint(models(n), joint)
    stops, history = set(looks(most)), []
    upper, lower, gap = np.inf, -np.inf, np.inf
    each: list[float] = []
    best: list[Floats] = []
    iteration = 0
    for iteration in range(1, most + 1):
        joint.iterate()
        if iteration in stops:
            value, values, found = joint.paths()
            if value < upper or not best:
                upper, each, best = value, values, found
            lower = max(lower, joint.bound())
            gap = max(upper - lower, 0.0) / max(upper, 1e-300) if np.isfinite(upper) and np.isfinite(lower) else np.inf
            history.append((iteration, upper, lower, gap))
        watch(min(gap, 1.0), iteration / most)
        if gap <= wished:
            break
    model = joint.models[0]
    value_unit = model.value_unit / count
    steps = [np.array(column) for column in zip(*history, strict=True)]
    units = (1.0, value_unit, value_unit, 1.0)
    names_of = ("iteration", "cost", "lower_bound", "gap")
    paths = np.stack(best) * model.density
    for path, density in zip(paths, given, strict=True):
        path[0] = density
    return BarycenterResult(
        shape=surface.operators.shape,
        density=paths[0][-1].copy(),
        weights=share,
        cost=upper * value_unit,
        lower_bound=lower * value_unit,
        gap=gap,
        distances=np.sqrt(2 * np.array(each) * value_unit / share),
        paths=paths,
        iterations=iteration,
        converged=bool(gap <= wished),
        history={name: column * factor for name, column, factor in zip(names_of, steps, units, strict=True)},
    )
