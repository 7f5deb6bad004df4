"""The result of a committor computation."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy

from .. import arrays
from ..arrays import Floats
from ..clouds import CloudOperators
from ..errors import InputError
from ..files import columns, written
from ..near import nearest_neighbors
from ..results import archived, save_arrays, save_result
from ..shapes import Shape, TriangleMesh
from ..view import Page, Picture, plot
from .currents import follow, passage_time, reactive_current
from .diagnostics import CommittorDiagnostics
from .solve import System
from .weighted import Mask

Method = Literal["weak", "strong"]


@dataclass(frozen=True, eq=False)
class FreeEnergyResult:
    """Free energy along the committor: ``-log(density of q) / β``, least value 0; inf where no point is.

    ``q`` (bins,) are the middles of the bins, ``free_energy`` (bins,) in units of the potential.
    """

    q: Floats
    free_energy: Floats


@dataclass(frozen=True, eq=False)
class IsocommittorResult:
    """Where q has one value: ``points`` (k, D) on the edges that cross it, ``flux`` (k,) the share of the reactive trajectories through
    each, and their sum 1."""

    level: float
    points: Floats
    flux: Floats


@dataclass(frozen=True, eq=False, repr=False)
class CommittorResult:
    """The committor and what follows from it.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
    q : ndarray (n,)
        Probability of reaching B before A from each point: 0 on A, 1 on B.
    q_backward : ndarray (n,)
        Probability of having come from A rather than from B; ``1 - q`` unless a circulation was given.
    rate : float
        nu_AB, reactive trajectories from A to B per unit of time: the Dirichlet form of q.
    rate_error : float or None
        Its standard error, by half-samples; None without ``bootstrap``.
    rate_flux, rate_flux_error : float
        The second estimate, the flux through isocommittor surfaces by gradients fitted to q, and how much it differs between them
        (standard deviation).
    rate_constant, rate_constant_backward : float
        k_AB = nu_AB / p_A and k_BA = nu_AB / (1 - p_A).
    share_A : float
        p_A, the share of time during which A was visited last.
    current : ndarray (n, D)
        Reactive current, exp(-β U) grad q / (β Z): trajectories per unit of time and length; 0 in A and B.
    reactive_density : ndarray (n,)
        Probability density of being at the point while on the way from A to B.
    potential : ndarray (n,)
        The potential U that was used, in the user's units, with minimum 0.
    in_A, in_B : ndarray (n,) of bool
        Which points lie in the sets.
    beta : float
        The inverse temperature.
    method : {"weak", "strong"}
        The method that was used.
    assumption : str
        What was assumed about the samples.
    replicates : ndarray (k,)
        The rates of the half-samples.
    diagnostics : CommittorDiagnostics
        ``diagnostics.verdict`` is one line.
    """

    shape: Shape
    q: Floats
    q_backward: Floats
    rate: float
    rate_error: float | None
    rate_flux: float
    rate_flux_error: float
    rate_constant: float
    rate_constant_backward: float
    share_A: float
    current: Floats
    reactive_density: Floats
    potential: Floats
    in_A: Mask
    in_B: Mask
    beta: float
    method: Method
    assumption: str
    replicates: Floats
    diagnostics: CommittorDiagnostics
    _system: System
    _partition: float
    _kept: npt.NDArray[np.int64] | None = None

    def __repr__(self) -> str:
        error = "" if self.rate_error is None else f" ± {self.rate_error:.2g}"
        return f"CommittorResult({len(self.q)} points, rate {self.rate:.6g}{error}, k_AB {self.rate_constant:.6g}, {self.verdict})"

    @property
    def verdict(self) -> str:
        """One line: sound, or what is wrong."""
        return self.diagnostics.verdict

    # times

    @cached_property
    def passage_time_to_A(self) -> Floats:
        """(n,): mean time until A is reached from each point, on average over the noise; 0 in A."""
        return self._spread(passage_time(self._system, 0))

    @cached_property
    def passage_time_to_B(self) -> Floats:
        """(n,): mean time until B is reached; 0 in B."""
        return self._spread(passage_time(self._system, 1))

    @property
    def mean_first_passage_times(self) -> tuple[float, float]:
        """From A to B and from B to A: the start distributed in its set as exp(-β U)."""
        gibbs = self._system.restrict(self._system.gibbs)
        a, b = (s[: self._system.count] for s in self._system.sets)
        there, back = passage_time(self._system, 1)[: len(a)], passage_time(self._system, 0)[: len(a)]
        return float((gibbs[a] * there[a]).sum() / gibbs[a].sum()), float((gibbs[b] * back[b]).sum() / gibbs[b].sum())

    # places

    def isocommittor(self, level: float = 0.5) -> IsocommittorResult:
        """Points where q is ``level`` (0 < level < 1), with the share of the flux through each.

        Examples
        --------
        >>> import numpy as np, beltrami as bt
        >>> mesh = bt.shapes.grid(41, 21, width=2.0)
        >>> x = mesh.vertices[:, 0]
        >>> r = bt.committor(mesh, np.zeros_like(x), x <= 0, x >= 2, beta=1.0)
        >>> bool(abs(r.isocommittor(0.25).points[:, 0] - 0.5).max() < 1e-9)
        True
        """
        height = arrays.number(level, "level", above=0.0)
        if height >= 1:
            raise InputError(f"level is {height:g}; it must be between 0 and 1")
        system = self._system
        one, other = system.q[system.mesh.first], system.q[system.mesh.second]
        crossing = np.flatnonzero((one > height) != (other > height))
        one, other = one[crossing], other[crossing]
        share = ((height - one) / (other - one))[:, None]
        points = system.mesh.points[system.mesh.first[crossing]] * (1 - share) + system.mesh.points[system.mesh.second[crossing]] * share
        flux = system.conductance[crossing] * np.abs(other - one)
        return IsocommittorResult(height, points, flux / flux.sum())

    def transition_states(self, width: float = 0.05) -> npt.NDArray[np.int64]:
        """Indices of the points with \\|q - 1/2\\| <= width, the most probable ones (greatest exp(-β U)) first."""
        half = arrays.number(width, "width", above=0.0)
        found = np.flatnonzero((np.abs(self.q - 0.5) <= half) & ~self.in_A & ~self.in_B)
        return found[np.argsort(self.potential[found], kind="stable")]

    def free_energy(self, bins: int = 50) -> FreeEnergyResult:
        """Free energy along q: of the density of q outside A and B, (bins,), in units of the potential."""
        count = arrays.whole(bins, "bins", 1, 100_000)
        system = self._system
        free = ~(system.sets[0] | system.sets[1])
        amount, edges = np.histogram(system.q[free], bins=count, range=(0.0, 1.0), weights=system.gibbs[free])
        with np.errstate(divide="ignore"):
            energy = -np.log(amount * count) / self.beta
        return FreeEnergyResult((edges[1:] + edges[:-1]) / 2, energy - energy.min() if np.isfinite(energy).any() else energy)

    def path(self) -> Floats:
        """The maximum-flux path from A to B, (k, D): of all paths along edges the one with the least ∫ exp(β U) ds.

        References
        ----------
        Berkowitz, Morgan, McCammon, Northrup, Diffusion-controlled reactions: a variational formula for the optimum reaction path, 1983.
        """
        system = self._system
        mesh, (a, b) = system.mesh, system.sets
        length = np.linalg.norm(mesh.points[mesh.first] - mesh.points[mesh.second], axis=1)
        cost = length / np.maximum(system.weights, 1e-300)
        cost = cost / cost[system.mesh.edge_conduction > 0].min()
        n = len(mesh.points)
        graph = scipy.sparse.csr_array(scipy.sparse.coo_array((cost, (mesh.first, mesh.second)), shape=(n, n)))
        sources = np.flatnonzero(a)
        distance, before, _ = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=sources, min_only=True, return_predecessors=True)
        ends = np.flatnonzero(b & np.isfinite(distance))
        at = int(ends[np.argmin(distance[ends])])
        chain = []
        while at >= 0:
            chain.append(at)
            at = int(before[at])
        return mesh.points[chain[::-1]].copy()

    def streamlines(self, count: int = 20, *, rng: int | np.random.Generator | None = 0) -> list[Floats]:
        """Lines of the mean reactive current from A to B, (k, D) each, started where the flux through q = 1/2 is, in proportion to it."""
        wanted = arrays.whole(count, "count", 1, 100_000)
        generator = arrays.generator(rng)
        middle = self.isocommittor(0.5)
        # systematic sampling: evenly over the flux, whatever the order of the edges
        order = np.argsort(middle.points @ np.linalg.svd(middle.points - middle.points.mean(0), full_matrices=False)[2][0], kind="stable")
        marks = (np.arange(wanted) + generator.random()) / wanted
        chosen = order[np.minimum(np.searchsorted(np.cumsum(middle.flux[order]), marks), len(order) - 1)]
        starts = middle.points[chosen]
        current = self.current if self._kept is None else reactive_current(self._system, self._partition)
        ahead, behind = (follow(self._system, current, starts, sign) for sign in (1.0, -1.0))
        return [np.concatenate([back[::-1], there[1:]]) for back, there in zip(behind, ahead, strict=True)]

    def plot(
        self, *, path: str | os.PathLike[str] | None = None, surface: bool = True, streamlines: int = 0, **options: Any
    ) -> Picture | Page:
        """Paints q with its contours; the options are those of :func:`beltrami.plot`.

        Parameters
        ----------
        surface : bool
            Clouds of dimension 2 as the triangles that most of their stars agree on; False: as dots.
        streamlines : int
            How many lines of the reactive current to draw.
        """
        shown = {"label": "committor", "limits": (0.0, 1.0), **options}
        shape, values, two = self.shape, self.q, self.shape.intrinsic_dimension == 2
        ops = self._system.ops
        if two and surface and isinstance(ops, CloudOperators):
            shape = TriangleMesh(ops.shape.points, ops.simplices[ops.votes >= 2])
            values = self.q if self._kept is None else self.q[self._kept]
        if two and "contours" not in shown:
            shown["contours"] = [k / 10 for k in range(1, 10)]
        if streamlines:
            shown.setdefault("lines", self.streamlines(streamlines))
            shown.setdefault("line_color", "#ffffff")
        return plot(shape, values, path=path, **shown)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``, a row per point to ``.csv``, or a picture to ``.png`` or ``.html``."""
        archive = {"points": self.shape.coordinates, **archived(self)}
        kinds = {".npz": lambda file: save_arrays(file, archive), ".csv": self._save_points}
        return save_result(self, path, "a committor is", kinds)

    def _save_points(self, path: Path) -> Path:
        table = columns(self.table())
        rows = np.column_stack([np.asarray(column, float) for column in table.values()])
        return written(path, lambda stream: np.savetxt(stream, rows, delimiter=",", header=",".join(table), comments="", fmt="%.17g"))

    def table(self) -> dict[str, npt.NDArray[Any]]:
        """The arrays with a row per point."""
        names = ("q", "q_backward", "current", "reactive_density", "potential", "in_A", "in_B")
        return {"points": self.shape.coordinates, **{name: getattr(self, name) for name in names}}

    def _spread(self, values: Floats) -> Floats:
        """Values at the nodes as values at the shape's points: the nearest one's where points were thinned out."""
        own = values[: self._system.count]
        if self._kept is None:
            return own.copy()
        base = nearest_neighbors(self._system.mesh.points[: self._system.count], self.shape.coordinates, 1)[0][:, 0]
        return own[base]
