"""The committor itself: linear elements weighted by exp(-β U), moving least squares, and drifts that circulate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from .. import arrays
from ..arrays import Floats
from ..clouds import CloudOperators, LeastSquaresOperators
from ..errors import InputError, NumericalError, TopologyError
from ..near import nearest_neighbors
from ..operators import Operators, operators
from ..progress import part
from ..solvers import Cholesky
from . import weighted
from .weighted import Elements, Function, Longs, Mask

STEEPEST = 600.0  # β U may exceed its least value by as much: exp(-600) is a number yet
LEAST_SHARE = 0.5  # samples hotter than twice the temperature are dense enough where the transition is
CLUMP = 30  # neighbours whose mean spacing is to be expected
FARTHEST = 4.0  # how many times their measured spacing the points at the outskirts may be apart
DAMPING = 0.7  # of Jacobi's smoothing
FEW = 10_000  # unknowns
RESTART = 60  # directions of GMRES that are kept
EXACT = 1e-12  # how great a share of the right side may be left of unsymmetric systems
WELLS = 32  # beside A and B, at most, that are too deep for double precision
DEEP = 8.0  # kT: the least depth of those
LOST = 1e-6  # how far the two committors' sum may be from 1


def checked(u: Floats, a: Mask, b: Mask, beta: float) -> None:
    """Refuses what has no answer; the messages name points."""
    both = np.flatnonzero(a & b)
    if len(both):
        raise InputError(f"A and B overlap at {len(both)} points ({arrays.some(both)}); take those out of one of them")
    high = np.flatnonzero(u > STEEPEST)
    if len(high):
        worst = int(high[np.argmax(u[high])])
        raise NumericalError(
            f"exp(-beta U) vanishes in double precision at {len(high)} points ({arrays.some(high)}): there beta U is up to {u[worst]:.4g} "
            f"above its least value, at point {worst}; leave such points out, clip the potential to {STEEPEST / beta:.4g} above its "
            "minimum, or take a smaller beta"
        )


def _reached(mesh: Elements, a: Mask, b: Mask) -> None:
    count = len(mesh.points)
    used = np.zeros(count, bool)
    used[mesh.simplices] = True
    graph = scipy.sparse.coo_array((np.ones(len(mesh.first)), (mesh.first, mesh.second)), shape=(count, count))
    pieces, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    has_a, has_b = (np.bincount(label[s], minlength=pieces) > 0 for s in (a, b))
    lost = np.flatnonzero(~(has_a | has_b)[label])
    if len(lost):
        raise TopologyError(
            f"{len(lost)} points ({arrays.some(lost)}) reach neither A nor B: no simplices join them; remove these points, or "
            "sample the gap"
        )
    if not (has_a & has_b).any():
        at, bt_ = int(np.flatnonzero(a)[0]), int(np.flatnonzero(b)[0])
        raise TopologyError(
            f"A (point {at}) and B (point {bt_}) lie in different pieces of the shape; sample the gap between them, or reach farther "
            "with bt.operators(cloud, neighbors=)"
        )


@dataclass(frozen=True)
class System:
    """The final elements and what was solved on them."""

    mesh: Elements
    ops: Operators
    count: int  # points of the shape; further nodes are middles of edges
    parents: tuple[tuple[Longs, Longs], ...]  # at each refinement, the ends of the edges that got nodes in their middles
    sets: tuple[Mask, Mask]
    outside: Floats  # share of each edge outside A and B
    weights: Floats  # of the edges
    q: Floats  # at the nodes
    beta: float
    carried: Floats | None = None  # mass times exp(-β U) that thinned-out points left to the points kept

    @property
    def conductance(self) -> Floats:
        return self.mesh.edge_conduction * self.weights / self.outside

    @cached_property
    def gibbs(self) -> Floats:
        """Mass times exp(-β U) of each node."""
        if self.carried is not None:
            return np.concatenate([self.carried, np.zeros(len(self.q) - self.count)])
        found: Floats = self.mesh.mass * np.exp(-self.mesh.potential)
        return found

    def restrict(self, values: npt.NDArray[Any]) -> Floats:
        """Sums over nodes as sums over points: middles give a half to each end."""
        for ends in reversed(self.parents):
            count = len(values) - len(ends[0])
            halves = values[count:] / 2
            values = values[:count].copy()
            for end in ends:
                np.add.at(values, end, halves)
        return values.copy()

    def prolong(self, values: Floats) -> Floats:
        """Values at points as values at nodes: middles get the mean of both ends."""
        for one, other in self.parents:
            values = np.concatenate([values, (values[one] + values[other]) / 2])
        return values

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
        q[free] = _by_way_of_wells(matrix, free, (a, b), mesh, report)
    return q, weights, outside


def reached_first(matrix: Any, free: Longs, sets: tuple[Mask, ...], places: Floats, report: Any, load: Floats | None = None) -> Floats:
    """Of a symmetric ``matrix`` with row sums 0, at the nodes ``free``: the solutions that are 1 in one of the sets and 0 in the others.

    (sets, k). All that the matrix joins to these nodes is in one of the sets. A ``load`` (nodes) has a further row: its solution, 0 in
    all sets.
    """
    rows = matrix[free]
    inner = rows[:, free]
    diagonal = inner.diagonal()
    if not (diagonal > 0).all():
        raise NumericalError("a point has no conduction")
    scale = 1 / np.sqrt(diagonal)
    inner = scipy.sparse.csr_array(inner.multiply(scale[:, None]).multiply(scale[None]))
    factor = Cholesky(inner, places[free], progress=report)
    right = -(rows @ np.stack(sets, 1).astype(float))
    if load is not None:
        right = np.column_stack([right, load[free]])
    # of all sets at once: their sum is 1 but for rounding, which division takes off, and which says what is left of the shares
    found = factor.solve(right * scale[:, None]) * scale[:, None]
    total = found[:, : len(sets)].sum(1)
    lost = np.abs(total - 1)
    if not lost.max() <= LOST:
        raise TooDeep(int(free[np.argmax(np.nan_to_num(lost, nan=np.inf))]))
    found[:, : len(sets)] /= total[:, None]
    return np.asarray(found.T, float)


def _by_way_of_wells(matrix: Any, free: Longs, sets: tuple[Mask, Mask], mesh: Elements, report: Any) -> Floats:
    """q at the nodes ``free``; where deep wells beside the sets lose it in rounding, by way of a node in each of these.

    From anywhere else it is reached in double precision which of A, B and these nodes comes first; and among these there is a chain of
    jumps, whose states are eliminated one by one without a subtraction (Grassmann, Taksar and Heyman 1985).
    """
    try:
        return np.asarray(reached_first(matrix, free, sets, mesh.points, report)[1])
    except (TooDeep, NumericalError):
        entries = matrix.tocoo()
        if (entries.data > 1e-10 * matrix.diagonal()[entries.row])[entries.row != entries.col].any():
            raise  # an edge that conducts less than nothing is another cause
        wells = _wells(mesh, sets)
        if not wells:
            raise
    groups = (*sets, *(np.arange(len(mesh.points)) == well for well in wells))
    rest = free[~np.isin(free, wells)]
    shares = np.stack([group.astype(float) for group in groups])
    shares[:, rest] = reached_first(matrix, rest, groups, mesh.points, report)
    flux = np.maximum(-(matrix[wells] @ shares.T), 0)  # from each well to each group; no terms of both signs but to itself
    states = list(range(2, len(groups)))
    flux = np.vstack([np.zeros((2, len(groups))), flux])
    for place, state in enumerate(states):
        later = [0, 1, *states[place + 1 :]]
        leaving = flux[state, later].sum()
        if not leaving > 0:
            raise TooDeep(wells[place])
        flux[state, later] /= leaving
        for other in states[place + 1 :]:
            flux[other, later] += flux[other, state] * flux[state, later]
    heights = np.zeros(len(groups))
    heights[1] = 1.0
    for place, state in reversed(list(enumerate(states))):
        later = [0, 1, *states[place + 1 :]]
        heights[state] = (flux[state, later] * heights[later]).sum()
    return np.asarray((heights[:, None] * shares).sum(0)[free])


def _wells(mesh: Elements, sets: tuple[Mask, Mask]) -> list[int]:
    """The lowest nodes of wells of U beside the sets from which the way to a deeper well or a set leads over more than ``DEEP``."""
    height = np.where(sets[0] | sets[1], -np.inf, mesh.potential)
    ends, others = np.concatenate([mesh.first, mesh.second]), np.concatenate([mesh.second, mesh.first])
    order = np.lexsort((others, height[others], ends))
    nodes, at = np.unique(ends[order], return_index=True)
    lowest, lower = others[order][at], np.arange(len(height))
    down = (height[lowest] < height[nodes]) | ((height[lowest] == height[nodes]) & (lowest < nodes))
    lower[nodes[down]] = lowest[down]
    while (lower[lower] != lower).any():
        lower = lower[lower]
    passes = np.stack([lower[mesh.first], lower[mesh.second]], 1)
    over = np.maximum(height[mesh.first], height[mesh.second])
    order = np.flatnonzero(passes[:, 0] != passes[:, 1])
    order = order[np.argsort(over[order], kind="stable")]
    into: dict[int, int] = {}  # the deeper well that one has merged with
    depths: list[tuple[float, int]] = []

    def bottom(well: int) -> int:
        while well in into:
            into[well] = into.get(into[well], into[well])
            well = into[well]
        return well

    for (one, other), rim in zip(passes[order].tolist(), over[order].tolist(), strict=True):
        deep, shallow = sorted((bottom(one), bottom(other)), key=lambda well: (height[well], well))
        if deep != shallow:
            into[shallow] = deep
            if height[shallow] > -np.inf:
                depths.append((rim - float(height[shallow]), shallow))
    return [well for depth, well in sorted(depths, reverse=True)[:WELLS] if depth > DEEP]


class TooDeep(Exception):
    """Barriers that double precision cannot hold."""


def weak_form(
    ops: Operators, u: Floats, exact: Any, members: tuple[Mask, Mask], levels: tuple[Function | None, Function | None],
    given: tuple[Floats | None, ...],
    beta: float, refine: int, report: Any,
) -> System:  # fmt: skip
    count = len(u)
    edges: tuple[Any, Any] | None = None
    found = []
    for inside, other, level in zip(members, members[::-1], given, strict=True):
        if level is None:
            if edges is None:
                upper = scipy.sparse.coo_array(scipy.sparse.triu(ops.stiffness, 1))
                edges = upper.row, upper.col
            level = weighted.level_of_set(ops.coordinates, inside, other, edges, ops.shape.intrinsic_dimension)
        found.append(level)
    coarse = weighted.elements(ops, u, exact, (found[0], found[1]))
    _reached(coarse, *members)
    last: Exception | None = None
    for attempt in range(3):
        mesh, sets = weighted.mend(coarse) if attempt else coarse, members
        parents: list[tuple[Longs, Longs]] = []
        for _ in range(refine):
            parents.append((mesh.first, mesh.second))
            before = len(mesh.points)
            mesh = weighted.split(ops, mesh, levels)
            if attempt:
                mesh = weighted.mend(mesh, mesh.mended if attempt == 1 else None)
            one, other = (np.concatenate([s, at[before:] <= 0]) for s, at in zip(sets, mesh.levels, strict=True))
            sets = one, other
        try:
            q, weights, outside = _solve(mesh, sets, part(report, 0.5 + 0.15 * attempt, 1.0))
        except (NumericalError, TooDeep) as error:
            last = error
            continue
        if q.min() < -1e-12 or q.max() > 1 + 1e-12:
            last = NumericalError("q leaves [0, 1]")
            continue
        return System(mesh, ops, count, tuple(parents), sets, outside, weights, np.clip(q, 0, 1), beta)
    # What is left once no conduction is negative is rounding: a well whose way out is lost beside its own conduction.
    outside = np.where(members[0] | members[1], np.inf, u)
    deepest = last.args[0] if isinstance(last, TooDeep) and last.args[0] < count else int(np.argmin(outside))
    raise NumericalError(
        f"barriers around the well at point {deepest} are too high for double precision, q is lost there: take a smaller beta, or count "
        "the well to A or B"
    ) from last


def expected_spacing(ops: CloudOperators, u: Floats) -> Floats | None:
    """Spacing to be expected at each point, which says how large a simplex may be before it counts as a hole; None where none is missing.

    It is at least the mean around: random points lie in clumps, beside which chance gaps look like holes. And where the potential explains
    the samples' density, as that of Gibbs samples, the cloud ends because U is high, and large simplices there are no holes either:
    without them a barrier with few samples conducts too little. For that a line is fitted to log density against β U, outliers counting
    little; it must explain more than half of the scatter, which it does not for uniform samples: those end at a wall.
    """
    if not ops.boundary.any():
        return None
    d, points, spacing = ops.shape.dimension, ops.shape.points, ops.point_spacing
    logarithm = np.log(spacing)
    around = nearest_neighbors(points, points, min(CLUMP, len(points)))[0]
    expected = np.exp(logarithm[around].mean(1))
    density = -d * logarithm
    terms, weight = np.stack([np.ones_like(u), -u], 1), np.ones(len(u))
    for _ in range(10):
        line = np.linalg.lstsq(terms * weight[:, None], density * weight, rcond=None)[0]
        off = np.abs(density - terms @ line)
        weight = 1 / np.sqrt(np.maximum(1.0, off / max(3 * float(np.median(off)), 1e-12)))
    share = float(np.clip(line[1], 0.0, 1.0))  # inverse temperature of the samples, over β
    if share > LEAST_SHARE and np.square(density - terms @ line).sum() < np.square(density - density.mean()).sum() / 2:
        # beyond its point the density goes on falling
        expected = np.maximum(expected, (1 + share * share) * np.exp(-(terms @ line) / d))
    return np.asarray(np.clip(expected, spacing, FARTHEST * spacing), float)


def strong_form(
    ops: Operators, u: Floats, a: Mask, b: Mask, circulation: Floats | None, beta: float, weak: System
) -> tuple[Floats, Floats]:
    """q by Δq - grad(β U) · grad q + β circulation · grad q = 0 at each point, and its gradient (n, D); ``weak`` is the way to it."""
    if not isinstance(ops, CloudOperators):
        raise InputError("method='strong' stands on moving least squares, which are there for clouds; meshes have the weak form")
    if not isinstance(ops, LeastSquaresOperators):
        made = operators(ops.shape, laplacian="mls")
        assert isinstance(made, LeastSquaresOperators)
        ops = made
    count, space = ops.coordinates.shape
    gradient = ops.gradient
    drift = -(gradient @ u).reshape(count, space)
    if circulation is not None:
        drift = drift + beta * circulation
    rows = np.repeat(np.arange(count), space)
    along = scipy.sparse.csr_array(scipy.sparse.coo_array((drift.ravel(), (rows, np.arange(count * space))), shape=(count, count * space)))
    matrix = scipy.sparse.csr_array(ops.laplacian + along @ gradient)
    if ops.boundary.any():  # nothing leaves: the derivative outwards is 0
        near = nearest_neighbors(ops.coordinates, ops.coordinates, min(16, count))[0]
        outward = ops.coordinates - ops.coordinates[near].mean(1)
        outward = np.einsum("nd,ndD->nD", np.einsum("ndD,nD->nd", ops.frames, outward), ops.frames)
        outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-300)[:, None]
        columns = np.arange(count * space)
        across = scipy.sparse.csr_array((outward.ravel(), (rows, columns)), shape=(count, count * space))
        rim = scipy.sparse.diags_array(ops.boundary.astype(float))
        matrix = scipy.sparse.csr_array((scipy.sparse.eye_array(count) - rim) @ matrix + rim @ (across @ gradient))
    free = np.flatnonzero(~(a | b))
    q = b.astype(float)
    if len(free):
        rows = matrix[free]
        inner = scipy.sparse.csr_array(rows[:, free])
        # at the rim the greatest entry, where the derivative outwards may have next to nothing of the point itself
        middle = inner.diagonal()
        greatest = np.copysign(abs(inner).max(1).toarray().ravel(), middle)
        mesh = weak.mesh
        nearby = weighted.laplacian(count, mesh.first, mesh.second, weak.conductance)[free][:, free]
        q[free] = _unsymmetric(
            inner, rows, (a, b), weak.q[free], np.where(ops.boundary[free], greatest, middle), nearby, ops.coordinates[free],
            "the strong form is lost in rounding on these points; take the weak form, or more points",
        )  # fmt: skip
    return q, (gradient @ q).reshape(count, space)


def _unsymmetric(
    matrix: Any, rows: Any, sets: tuple[Mask, Mask], start: Floats, smoother: Floats, nearby: Any, places: Floats, lost: str
) -> Floats:
    """q of ``rows q = 0`` at the free points, whose columns of the ``rows`` are the ``matrix``; q is 0 in the one set and 1 in the other.

    Few unknowns are solved for by elimination, many by GMRES from ``start``, or by elimination, which then takes long and is not
    interrupted, where that is not enough. Each step of GMRES smooths by Jacobi's with ``smoother`` as the diagonal, solves with the
    symmetric matrix ``nearby`` (of unknowns at ``places``), whose rows may be of another scale, and smooths again: what both matrices have
    not in common is oscillation. As ``rows 1 = 0``, the same is done for what is 1 in both sets and has to be 1 everywhere.

    Raises
    ------
    NumericalError
        With the text ``lost``, if it is not.
    """
    scale = 1 / np.maximum(abs(matrix).sum(1), 1e-300)
    matrix = scipy.sparse.csr_array(matrix.multiply(scale[:, None]))
    right = -scale[:, None] * (rows @ np.stack([sets[1], sets[0] | sets[1]], 1).astype(float))
    starts = start, np.zeros_like(start)
    if len(start) > FEW:
        with np.errstate(all="ignore"):
            found = _iterated(matrix, right, starts, scale * smoother, nearby, places)
        if found is not None and np.abs(found[1] - 1).max() <= LOST:
            return found[0]
    # as matrices whose entries stand symmetrically: by its default SuperLU takes up to three times as long and twice the memory
    ways: dict[str, Any] = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.1, "options": {"SymmetricMode": True}}
    try:
        found = scipy.sparse.linalg.splu(scipy.sparse.csc_array(matrix), **ways).solve(right).T
    except RuntimeError as error:
        raise NumericalError(f"{lost} ({error})") from None
    if not np.abs(found[1] - 1).max() <= LOST or not np.isfinite(found[0]).all():
        raise NumericalError(lost)
    return np.array(found[0])


def _iterated(
    matrix: Any, right: Floats, starts: tuple[Floats, Floats], smoother: Floats, nearby: Any, places: Floats
) -> tuple[Floats, Floats] | None:
    """The two columns of the solution by GMRES; None where it does not come near them."""
    middle = nearby.diagonal()
    if not ((middle > 0).all() and (smoother != 0).all()):
        return None
    half, smooth = 1 / np.sqrt(middle), DAMPING / smoother

    def roughly(residual: Floats) -> Floats:
        moved = smooth * residual
        moved = moved + half * factor.solve((residual - matrix @ moved) * (middle / smoother) * half)
        return np.asarray(moved + smooth * (residual - matrix @ moved), float)

    try:
        factor = Cholesky(scipy.sparse.csr_array(nearby.multiply(half[:, None]).multiply(half[None])), places)
        q = _gmres(matrix, right[:, 0], starts[0], roughly)
        one = None if q is None else _gmres(matrix, right[:, 1], starts[1], roughly)
    except (NumericalError, InputError):  # barriers that double precision cannot hold
        return None
    return None if q is None or one is None else (q, one)


def _gmres(matrix: Any, right: Floats, x: Floats, roughly: Callable[[Floats], Floats]) -> Floats | None:
    """x of ``matrix x = right`` where ``roughly`` solves it roughly (Saad and Schultz 1986); None where it does not come near it.

    Sums are numpy's own, as those of BLAS depend on its threads.
    """
    enough = EXACT * np.sqrt(np.square(right).sum())
    if not 1e-100 < enough < 1e100:
        return None
    basis, h = np.empty((RESTART + 1, len(right))), np.zeros((RESTART + 1, RESTART))
    before = np.inf
    while True:
        residual = right - matrix @ x
        size = np.sqrt(np.square(residual).sum())
        if size <= enough:
            return x
        if not size < before / 10:
            return None
        before, basis[0], h[:] = size, residual / size, 0
        for k in range(RESTART):
            moved = matrix @ roughly(basis[k])
            for _ in range(2):
                along = np.einsum("kn,n->k", basis[: k + 1], moved)
                moved -= np.einsum("k,kn->n", along, basis[: k + 1])
                h[: k + 1, k] += along
            h[k + 1, k] = np.sqrt(np.square(moved).sum())
            if not np.isfinite(h[k + 1, k]):
                return None
            first = np.zeros(k + 2)
            first[0] = size
            share = np.linalg.lstsq(h[: k + 2, : k + 1], first, rcond=None)[0]
            if np.linalg.norm(first - h[: k + 2, : k + 1] @ share) < enough / 2 or h[k + 1, k] == 0:
                break
            basis[k + 1] = moved / h[k + 1, k]
        x = x + roughly(np.einsum("k,kn->n", share, basis[: len(share)]))


def rotating_form(system: System, circulation: Floats, backwards: bool) -> Floats:
    """q of a drift with a part that keeps the Gibbs density: exponentially fitted on each edge, so that 0 <= q <= 1 still."""
    mesh, (a, b) = system.mesh, system.sets
    sign = -1.0 if backwards else 1.0
    field = system.prolong(circulation)
    step = mesh.points[mesh.second] - mesh.points[mesh.first]
    peclet = sign * system.beta * np.einsum("eD,eD->e", (field[mesh.first] + field[mesh.second]) / 2, step)
    peclet = np.clip(peclet, -700, 700)
    size = np.where(np.abs(peclet) < 1e-6, 1.0, peclet)
    ahead = np.where(np.abs(peclet) < 1e-6, 1 + peclet / 2, size / -np.expm1(-size))  # z / (1 - exp(-z)), seen from the first end
    behind = ahead - peclet
    k = np.maximum(system.conductance, 0)
    n, (i, j) = len(mesh.points), (mesh.first, mesh.second)
    rows, columns = np.concatenate([i, j, i, j]), np.concatenate([j, i, i, j])
    values = np.concatenate([-k * ahead, -k * behind, k * ahead, k * behind])
    matrix = scipy.sparse.csr_array(scipy.sparse.coo_array((values, (rows, columns)), shape=(n, n)))
    free = np.flatnonzero(~(a | b))
    q = (a if backwards else b).astype(float)
    diagonal = matrix.diagonal()[free]
    if not (diagonal > 0).all():
        raise NumericalError("the drift of this circulation is too strong for the spacing of the points: nothing leads on from some")
    lost = "the committor of this circulation is lost in rounding; take a weaker circulation, more points, or a smaller beta"
    if len(free):
        rows, start = matrix[free], 1 - system.q if backwards else system.q
        nearby = weighted.laplacian(n, i, j, k * (ahead + behind) / 2)[free][:, free]
        ends = (b, a) if backwards else (a, b)
        q[free] = _unsymmetric(rows[:, free], rows, ends, start[free], diagonal, nearby, mesh.points[free], lost)
    if q.min() < -LOST or q.max() > 1 + LOST:
        raise NumericalError(lost)
    found: Floats = np.clip(q, 0, 1)
    return found
