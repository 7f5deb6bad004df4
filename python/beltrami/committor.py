"""Committor functions and reaction rates on point clouds and meshes of any dimension (section 8.4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse
from scipy.sparse.csgraph import connected_components

from . import arrays, weighted
from .arrays import Floats
from .clouds import CloudOperators
from .errors import InputError, NumericalError, TopologyError
from .operators import Operators, operators
from .progress import Progress, part, reporter
from .shapes import Shape
from .solvers import Cholesky
from .weighted import Elements, Mask

__all__ = ["CommittorResult", "committor"]

STEEPEST = 600.0  # β U may exceed its least value by as much: exp(-600) is a number yet
REFINED = 20_000  # up to so many points triangles are split in four
LOST = 1e-6  # how far the two committors' sum may be from 1


def _places(ops: Operators) -> Floats:
    return ops.coordinates


def _dimension(ops: Operators) -> int:
    return ops.shape.dimension if isinstance(ops, CloudOperators) else 2


def _some(numbers: npt.NDArray[Any]) -> str:
    text = ", ".join(map(str, numbers[:8].tolist()))
    return f"{text} and {len(numbers) - 8} more" if len(numbers) > 8 else text


# --- what is handed in -------------------------------------------------------------------------------------------------------------


def _potential(potential: Any, points: Floats, name: str = "potential") -> Floats:
    if callable(potential):
        return _called(potential, points, name)
    return arrays.floats(potential, name, (len(points),))


def _called(function: Callable[[Floats], Any], points: Floats, name: str) -> Floats:
    """Values of a user's function of (n, D) positions."""
    return arrays.floats(function(points.copy()), f"{name}(points)", (len(points),))


def _members(given: Any, points: Floats, name: str) -> tuple[Mask, Floats | None]:
    """Which points belong to a set, and its level function's values where it is given by one."""
    if callable(given):
        level = _called(given, points, name)
        members = level <= 0
        if not members.any():
            raise InputError(f"{name} is empty: its level function is positive at all {len(points)} points (it is negative inside)")
        return members, level
    if isinstance(given, list | tuple) and len(given) == 0:
        raise InputError(f"{name} is empty; give the points of the set, as a mask, as numbers, or as a level function")
    array = np.asarray(given)
    if array.size == 0 or (array.dtype.kind == "b" and not array.any()):
        raise InputError(f"{name} is empty; give the points of the set, as a mask, as numbers, or as a level function")
    members = np.zeros(len(points), bool)
    members[arrays.indices(given, name, len(points))] = True
    return members, None


def _checked(ops: Operators, u: Floats, a: Mask, b: Mask, beta: float) -> None:
    """Refuses what has no answer; the messages name points."""
    both = np.flatnonzero(a & b)
    if len(both):
        raise InputError(f"A and B overlap at {len(both)} points ({_some(both)}); take those out of one of them")
    high = np.flatnonzero(u > STEEPEST)
    if len(high):
        worst = int(high[np.argmax(u[high])])
        raise NumericalError(
            f"exp(-beta U) vanishes in double precision at {len(high)} points ({_some(high)}): there beta U is up to {u[worst]:.4g} "
            f"above its least value, at point {worst}; leave such points out, clip the potential to {STEEPEST / beta:.4g} above its "
            "minimum, or take a smaller beta"
        )


def _reached(mesh: Elements, a: Mask, b: Mask) -> None:
    count = len(mesh.points)
    used = np.zeros(count, bool)
    used[mesh.simplices] = True
    graph = sparse.coo_array((np.ones(len(mesh.first)), (mesh.first, mesh.second)), shape=(count, count))
    pieces, label = connected_components(graph, directed=False)
    has_a, has_b = (np.bincount(label[s], minlength=pieces) > 0 for s in (a, b))
    lost = np.flatnonzero(~(has_a | has_b)[label])
    if len(lost):
        raise TopologyError(
            f"{len(lost)} points ({_some(lost)}) reach neither A nor B: no simplices join them; remove these points, or sample the gap"
        )
    if not (has_a & has_b).any():
        at, bt_ = int(np.flatnonzero(a)[0]), int(np.flatnonzero(b)[0])
        raise TopologyError(
            f"A (point {at}) and B (point {bt_}) lie in different pieces of the shape; sample the gap between them, or reach farther "
            "with bt.operators(cloud, neighbors=)"
        )


@dataclass(frozen=True)
class _System:
    """The final elements and what was solved on them."""

    mesh: Elements
    ops: Operators
    count: int  # points of the shape; further nodes are middles of edges
    parents: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]  # ends of the edges that have nodes in their middles
    sets: tuple[Mask, Mask]
    outside: Floats  # share of each edge outside A and B
    weights: Floats  # of the edges
    q: Floats  # at the nodes
    beta: float
    attempts: int

    @property
    def conductance(self) -> Floats:
        return self.mesh.edge_conduction * self.weights / self.outside

    @cached_property
    def gibbs(self) -> Floats:
        """Mass times exp(-β U) of each node."""
        found: Floats = self.mesh.mass * np.exp(-self.mesh.potential)
        return found

    def restrict(self, values: Floats) -> Floats:
        """Sums over nodes as sums over points: middles give a half to each end."""
        found = values[: self.count].copy()
        if len(values) > self.count:
            for end in self.parents:
                np.add.at(found, end, values[self.count :] / 2)
        return found

    @cached_property
    def vectors(self) -> Floats:
        """(m, D): exp(-β U) grad q integrated over each simplex."""
        mesh = self.mesh
        a, b = np.triu_indices(mesh.simplices.shape[1], 1)
        one, other = mesh.simplices[:, a], mesh.simplices[:, b]
        strength = mesh.conduction * self.weights[mesh.pairs] * (self.q[other] - self.q[one])
        found: Floats = np.einsum("sp,spD->sD", strength, mesh.points[other] - mesh.points[one])
        return found


def _solve(mesh: Elements, sets: tuple[Mask, Mask], report: Any) -> tuple[Floats, Floats, Floats]:
    """q at the nodes, the weights of the edges, and their shares outside A and B."""
    weights, outside = mesh.edge_weights(), weighted.cut(mesh, sets)
    conductance = mesh.edge_conduction * weights / outside
    a, b = sets
    free = np.flatnonzero(~(a | b))
    q = b.astype(float)
    if len(free):
        matrix = weighted.laplacian(len(mesh.points), mesh.first, mesh.second, conductance)
        rows = matrix[free]
        inner = rows[:, free]
        diagonal = inner.diagonal()
        if not (diagonal > 0).all():
            raise NumericalError("a point has no conduction")
        scale = 1 / np.sqrt(diagonal)
        inner = sparse.csr_array(inner.multiply(scale[:, None]).multiply(scale[None]))
        factor = Cholesky(inner, mesh.points[free], progress=report)
        right = -(rows @ np.stack([a, b], 1).astype(float)) * scale[:, None]
        # of A and of B at once: their sum is 1 but for rounding, which division takes off, and which says what is left of q
        ends = factor.solve(right) * scale[:, None]
        total = ends.sum(1)
        lost = np.abs(total - 1)
        if not lost.max() <= LOST:
            worst = int(free[np.argmax(np.nan_to_num(lost, nan=np.inf))])
            raise _TooDeep(worst)
        q[free] = ends[:, 1] / total
    return q, weights, outside


class _TooDeep(Exception):
    """Barriers that double precision cannot hold."""


def _weak(
    ops: Operators, u: Floats, exact: Any, members: tuple[Mask, Mask], levels: tuple[Any, Any], given: tuple[Any, Any],
    beta: float, refine: int, report: Any,
) -> _System:  # fmt: skip
    count = len(u)
    edges: tuple[Any, Any] | None = None
    found = []
    for inside, level in zip(members, given, strict=True):
        if level is None:
            if edges is None:
                upper = sparse.coo_array(sparse.triu(ops.stiffness, 1))
                edges = upper.row, upper.col
            level = weighted.level_of_set(_places(ops), inside, edges, _dimension(ops))
        found.append(level)
    coarse = weighted.elements(ops, u, exact, (found[0], found[1]))
    _reached(coarse, *members)
    last: Exception | None = None
    for attempt in range(3):
        mesh, parents = coarse, (coarse.first[:0], coarse.second[:0])
        if attempt:
            mesh = weighted.mend(mesh)
        sets = members
        if refine:
            parents = mesh.first, mesh.second
            fine = weighted.split(ops, mesh, levels)
            sets = tuple(np.concatenate([s, level[count:] <= 0]) for s, level in zip(members, fine.levels, strict=True))  # type: ignore
            mesh = fine
            if attempt:
                mesh = weighted.mend(mesh, mesh.mended if attempt == 1 else None)
        try:
            q, weights, outside = _solve(mesh, sets, part(report, 0.5 + 0.15 * attempt, 1.0))
        except (NumericalError, _TooDeep) as error:
            last = error
            continue
        if q.min() < -1e-12 or q.max() > 1 + 1e-12:
            last = NumericalError("q leaves [0, 1]")
            continue
        return _System(mesh, ops, count, parents, sets, outside, weights, np.clip(q, 0, 1), beta, attempt)
    if isinstance(last, _TooDeep):
        raise NumericalError(
            f"barriers around point {last.args[0]} are too high for double precision: q is lost there; take a smaller beta, "
            "or count the well there to A or B"
        )
    raise NumericalError(f"the committor could not be solved for: {last}; clip the potential or take a smaller beta")


@dataclass(frozen=True, eq=False, repr=False)
class CommittorResult:
    """x"""

    shape: Shape
    q: Floats
    rate: float
    rate_constant: float
    current: Floats
    system: Any

def committor(shape, potential, A, B, *, beta, refine=None, progress=None):
    report = reporter(progress, "committor")
    beta = arrays.number(beta, "beta", above=0.0)
    ops = operators(shape, progress=part(report, 0, 0.4)) if not isinstance(shape, Operators) else shape
    points = _places(ops)
    energy = _potential(potential, points)
    least = float(energy.min())
    with np.errstate(over="ignore"):
        u = beta * (energy - least)
    a, level_a = _members(A, points, "A")
    b, level_b = _members(B, points, "B")
    _checked(ops, u, a, b, beta)
    def exact(places):
        return beta * (_called(potential, places, "potential") - least)
    functions = tuple((lambda f, name: (lambda p: _called(f, p, name)))(f, name) if callable(f) else None for f, name in ((A, "A"), (B, "B")))
    if refine is None:
        refine = int(_dimension(ops) == 2 and len(points) <= REFINED)
    s = _weak(ops, u, exact if callable(potential) else None, (a, b), functions, (level_a, level_b), beta, refine, report)
    z = float(s.gibbs.sum())
    difference = s.q[s.mesh.first] - s.q[s.mesh.second]
    rate = float((s.conductance * difference * difference).sum()) / (beta * z)
    share_a = float((s.gibbs * (1 - s.q)).sum()) / z
    corners = s.mesh.simplices.shape[1]
    spread = np.stack([np.bincount(s.mesh.simplices.ravel(), np.repeat(v / corners, corners), len(s.q)) for v in s.vectors.T], 1)
    current = s.restrict(spread) / s.restrict(s.mesh.mass)[:, None] / (beta * z)
    current[a | b] = 0
    return CommittorResult(ops.shape, s.q[:s.count], rate, rate / share_a, current, s)
