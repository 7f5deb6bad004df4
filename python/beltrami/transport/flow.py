"""What transport and games share: checks of densities and options, and the resulting flow."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..arrays import Floats
from ..errors import InputError
from ..files import save_with
from ..results import save_result
from ..shapes import PointCloud, Shape
from ..sums import weighted_sum
from ..view import Page, Picture, plot
from ..view.film import film
from .continuity import MEMORY, Certificate, Problem, Surface

Method = Literal["primal_dual", "projected_gradient"]
DENSITY_COLOURS = ["#e9e7e2", "#f5c869", "#ec7a45", "#b12e62", "#451264"]  # light where there is nothing
EQUAL = 1e-9  # relative difference of two masses that is still rounding


def density_in(surface: Surface, density: npt.ArrayLike, name: str) -> Floats:
    """(n,), finite, not negative, with mass."""
    array = np.asarray(density)
    if array.ndim == 1 and len(array) != surface.count:
        raise InputError(f"{name} has {len(array)} values, the shape has {surface.count} vertices; give one per vertex")
    values = arrays.floats(density, name, (surface.count,))
    if values.min() < 0:
        where = int(np.argmin(values))
        raise InputError(f"{name}[{where}] is {values[where]:g}; densities must not be negative: clip them with np.maximum(..., 0)")
    mass = float(weighted_sum(values, surface.mass))
    if not (np.isfinite(mass * surface.total) and mass > 1e-200):
        raise InputError(f"{name} has the mass {mass * surface.total:g}; it must be positive and within range")
    return values


def balanced(surface: Surface, densities: list[Floats], names: Sequence[str], normalize: bool) -> list[Floats]:
    """Densities that have the mass of the first one on each component; with ``normalize`` rescaled to it."""
    first = densities[0]
    wanted = surface.sums((first * surface.mass)[None])[0]
    out = [first]
    for density, name in zip(densities[1:], names[1:], strict=True):
        if normalize:
            density = density * (wanted.sum() / float(weighted_sum(density, surface.mass)))
        found = surface.sums((density * surface.mass)[None])[0]
        total, other = wanted.sum() * surface.total, found.sum() * surface.total
        if abs(other - total) > EQUAL * total:
            raise InputError(
                f"{names[0]} has the mass {total:.9g}, {name} has {other:.9g}: a difference of {100 * (other / total - 1):.3g} %; "
                "give densities of equal mass (per unit area), or normalize=True"
            )
        apart = np.abs(found - wanted)
        if (apart > EQUAL * wanted.sum()).any():
            part = int(np.argmax(apart))
            vertex = int(np.flatnonzero(surface.labels == part)[0])
            raise InputError(
                f"component {part} (that of vertex {vertex}) has the mass {wanted[part] * surface.total:.6g} in {names[0]} and "
                f"{found[part] * surface.total:.6g} in {name}; mass cannot leave a component, so it must be equal on each"
            )
        out.append(density)
    return out


@dataclass(frozen=True, eq=False, repr=False)
class Flow:
    """Densities that move over a shape, and the momentum that moves them.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
    density : ndarray (intervals + 1, n)
        Per unit area, at times k / intervals. Never negative; the mass is the same at all times.
    momentum : ndarray (intervals, m, D)
        A tangent vector per triangle (for clouds: per simplex of the local mesh) and interval: density times velocity.
    potential : ndarray (intervals, n)
        φ, whose gradient is the velocity where there is mass.
    lower_bound, gap : float
        A lower bound for the cost of all paths, and the relative distance of the answer above it.
    continuity_residual : float
        Of ``(ρ_{k+1} - ρ_k) intervals + div M = 0``, relative to the sizes of density and change.
    iterations : int
        Number of iterations.
    converged : bool
        Whether the gap reached the tolerance.
    history : dict of str to ndarray
        ``iteration``, ``objective``, ``lower_bound``, ``gap`` each time the bounds were computed; the best so far.
    corners : ndarray (m, 3)
        Vertices of the triangles that the momentum lives on.
    """

    shape: Shape
    density: Floats
    momentum: Floats
    potential: Floats
    lower_bound: float
    gap: float
    continuity_residual: float
    iterations: int
    converged: bool
    history: dict[str, npt.NDArray[Any]]
    corners: npt.NDArray[np.int32]

    @property
    def intervals(self) -> int:
        """Number of time intervals."""
        return len(self.momentum)

    def interpolate(self, t: float) -> Floats:
        """The density at a time from 0 to 1, (n,): linear between the times of ``density``, which keeps the continuity equation.

        Examples
        --------
        >>> import beltrami as bt
        >>> grid = bt.shapes.grid(9, 9)
        >>> x = grid.vertices[:, 0]
        >>> r = bt.transport(grid, 1 + 0.2 * x, 1.2 - 0.2 * x, intervals=4)
        >>> bool((r.interpolate(0.5) == r.density[2]).all())
        True
        """
        time = arrays.number(t, "t", least=0)
        if time > 1:
            raise InputError(f"t is {time:g}; it must be from 0 to 1")
        before = min(int(time * self.intervals), self.intervals - 1)
        part = time * self.intervals - before
        if part in (0.0, 1.0):
            there: Floats = self.density[before + int(part)].copy()
            return there
        between: Floats = (1 - part) * self.density[before] + part * self.density[before + 1]
        return between

    @cached_property
    def velocity(self) -> Floats:
        """(intervals, m, D): momentum over the density of the triangle and interval; 0 where there is none."""
        rho = self.density[:, self.corners].mean(axis=2)
        rho = 0.5 * (rho[1:] + rho[:-1])
        least = 1e-12 * rho.max(initial=0.0)
        v: Floats = np.divide(self.momentum, rho[..., None], out=np.zeros_like(self.momentum), where=rho[..., None] > least)
        return v

    def particle_paths(self, points: npt.ArrayLike, *, substeps: int = 4) -> Floats:
        """Paths of particles: streamlines on the surface.

        Parameters
        ----------
        points : array_like (k, D), or (k,) of int
            Where they start: positions, or vertices.
        substeps : int
            Steps of the midpoint rule in each interval.

        Returns
        -------
        ndarray (intervals * substeps + 1, k, D)

        Raises
        ------
        InputError
            The shape is a cloud; points do not fit.
        """
        if isinstance(self.shape, PointCloud) or len(self.corners) != len(self.shape.faces):
            raise InputError("particle paths are there for flows on the triangles of a mesh")
        from ..near import closest_points

        mesh, steps = self.shape, arrays.whole(substeps, "substeps", 1)
        given = np.asarray(points)
        if given.ndim == 1:
            here = mesh.vertices[arrays.indices(points, "points", len(mesh.vertices), empty=True)]
        else:
            here = arrays.floats(points, "points", (None, mesh.dimension))
        arrays.room(2.0 * (self.intervals * steps + 1) * here.size, f"paths of {len(here)} particles in {steps} substeps", "take fewer")
        if len(here) == 0:
            return np.zeros((self.intervals * steps + 1, 0, mesh.dimension))
        # Velocities at vertices: means over the triangles around, weighted by the mass on them, so that they vary continuously.
        rho = self.density[:, self.corners].mean(axis=2)
        weight = 0.5 * (rho[1:] + rho[:-1]) * mesh.face_areas + 1e-12 * rho.max() * mesh.face_areas
        nodal = np.zeros((self.intervals, len(mesh.vertices), mesh.dimension))
        for k in range(self.intervals):
            total = np.bincount(mesh.faces.ravel(), np.repeat(weight[k], 3), len(mesh.vertices))
            for d in range(mesh.dimension):
                flow = np.bincount(mesh.faces.ravel(), np.repeat(weight[k] * self.velocity[k, :, d], 3), len(mesh.vertices))
                nodal[k, :, d] = np.divide(flow, total, out=np.zeros_like(flow), where=total > 0)

        def at(table: Floats, places: Any) -> Floats:
            v: Floats = np.einsum("kc,kcd->kd", places.barycentric, table[mesh.faces[places.faces]])
            return v

        places = closest_points(mesh, here)
        out = [places.points]
        dt = 1 / (self.intervals * steps)
        for k in range(self.intervals):
            for _ in range(steps):
                middle = closest_points(mesh, places.points + 0.5 * dt * at(nodal[k], places))
                places = closest_points(mesh, places.points + dt * at(nodal[k], middle))
                out.append(places.points)
        return np.stack(out)

    def plot(self, *, times: int | Sequence[float] = 6, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints the density at some times, on one scale: side by side, or in an ``.html`` page with a slider through time.

        Parameters
        ----------
        times : int or sequence of float
            How many times from 0 to 1, up to 1,000, or which.
        path : path, optional
            ``.png`` or ``.html``.
        **options
            Those of :func:`beltrami.plot`.
        """
        counted = np.ndim(arrays.anything(times, "times")) == 0
        chosen = np.linspace(0, 1, arrays.whole(times, "times", 1, 1000)) if counted else arrays.floats(times, "times", (None,))
        if len(chosen) == 0:
            raise InputError("times is empty; name at least one")
        fields = {f"t = {t:.3g}": self.interpolate(float(t)) for t in chosen}
        high = max(float(field.max()) for field in fields.values())
        look: dict[str, Any] = {"limits": (0.0, high), "colormap": DENSITY_COLOURS, **options}
        if path is None or arrays.file(path, "path").suffix.lower() != ".html":
            return plot(self.shape, fields, path=path, **look)
        look = {"size": (1000, 760), "label": "density", **look}
        frames = [plot(self.shape, field, **look) for field in fields.values()]  # pictures, as no path is given
        page = film([frame for frame in frames if isinstance(frame, Picture)], list(fields), title=options.get("title") or "")
        return Page(page.html, page.description, page.save(path))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``, the shape with the densities of all times to ``.ply``, pictures to ``.png`` or ``.html``."""
        kinds = {
            ".ply": lambda file: save_with(self.shape, {"density": self.density.T}, file),
            ".html": lambda file: self.plot(path=file, times=min(self.intervals + 1, 33)),
        }
        return save_result(self, path, "a flow is", kinds, pictures=(".png",))


def flow_fields(problem: Problem, certificate: Certificate, iterations: int, tolerance: float) -> tuple[dict[str, Any], float]:
    """What a :class:`Flow` is made of, in the user's units, and its objective."""
    model, surface = certificate.model, problem.surface
    density = certificate.density * model.density
    density[0] = problem.start
    if problem.end is not None:
        density[-1] = problem.end
    path = density / model.density
    momentum = model.corrected(path, model.corrected(path, certificate.momentum))
    objective = model.kinetic(path, momentum) + model.standing(path)
    flux = model.flux(momentum)
    change = model.rate(path)
    there = surface.mass > 0
    rms = [float(np.sqrt((x[:, there] ** 2 / surface.mass[there]).sum() / model.n)) for x in (change - flux, change)]
    size = rms[1] + float(np.sqrt(weighted_sum(path**2, surface.mass).mean()))
    local = momentum.reshape(model.n, model.elements, -1) * (model.density * model.speed)
    steps = [np.array(column) for column in zip(*certificate.history, strict=True)]
    names = ("iteration", "objective", "lower_bound", "gap")
    units = (1.0, model.value_unit, model.value_unit, 1.0)
    history = {name: column * unit for name, column, unit in zip(names, steps, units, strict=True)}
    scale = max(abs(objective), abs(certificate.lower), 1e-14)
    lower = min(certificate.lower, objective)
    gap = (objective - lower) / scale if np.isfinite(scale) else np.inf
    fields = {
        "shape": surface.operators.shape,
        "density": density,
        "momentum": np.einsum("kmc,mcd->kmd", local, surface.frames),
        "potential": certificate.potential * model.cost_unit,
        "lower_bound": lower * model.value_unit,
        "gap": gap,
        "continuity_residual": rms[0] / max(size, 1e-300),
        "iterations": iterations,
        "converged": bool(gap <= tolerance),
        "history": history,
        "corners": surface.corners,
    }
    return fields, objective * model.value_unit


def still(problem: Problem) -> dict[str, Any]:
    """What a :class:`Flow` is made of where nothing moves."""
    surface, n = problem.surface, problem.intervals
    zero = np.zeros(1)
    return {
        "shape": surface.operators.shape,
        "density": np.repeat(problem.start[None], n + 1, axis=0),
        "momentum": np.zeros((n, len(surface.corners), surface.frames.shape[2])),
        "potential": np.zeros((n, surface.count)),
        "lower_bound": 0.0,
        "gap": 0.0,
        "continuity_residual": 0.0,
        "iterations": 0,
        "converged": True,
        "history": {"iteration": zero, "objective": zero.copy(), "lower_bound": zero.copy(), "gap": zero.copy()},
        "corners": surface.corners,
    }


def options_in(method: str, tolerance: float, max_iterations: int, memory: float | None) -> tuple[float, int, float]:
    """Checked options that all doors share."""
    arrays.word(method, "method", get_args(Method))
    wished = arrays.number(tolerance, "tolerance", above=0)
    return wished, arrays.whole(max_iterations, "max_iterations", 1), MEMORY if memory is None else arrays.number(memory, "memory", least=0)
