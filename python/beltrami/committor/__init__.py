"""Committor functions and reaction rates on point clouds and meshes of any dimension (section 8.4)."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import scipy

from .. import arrays
from ..arrays import Floats
from ..clouds import CloudOperators, LeastSquaresOperators
from ..errors import Cancelled, Error, InputError, NumericalError, TopologyError
from ..files import written
from ..near import nearest_neighbors
from ..operators import Operators, operators
from ..progress import Progress, part, reporter, teller
from ..sampling import poisson_disc
from ..shapes import PointCloud, Shape, TriangleMesh
from ..solvers import Cholesky
from ..view import Page, Picture, plot
from . import weighted
from .weighted import Elements, Function, Longs, Mask

__all__ = [
    "CommittorDiagnostics",
    "CommittorResult",
    "FreeEnergyResult",
    "IsocommittorResult",
    "committor",
    "reweight",
    "sample_density",
]

Method = Literal["weak", "strong"]
Sampling = Literal["any", "gibbs", "weighted", "mixed"]

STEEPEST = 600.0  # β U may exceed its least value by as much: exp(-600) is a number yet
TAIL = 3e-5  # q closer to 0 or 1 counts as that in the second estimate of the rate
LEAST_SHARE = 0.5  # samples hotter than twice the temperature are dense enough where the transition is
CLUMP = 30  # neighbours whose mean spacing is to be expected
FARTHEST = 4.0  # how many times their measured spacing the points at the outskirts may be apart
LOST = 1e-6  # how far the two committors' sum may be from 1


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
        inside = np.asarray(given(points.copy()))
        if inside.dtype.kind == "b":
            if inside.shape != (len(points),):
                raise InputError(f"{name}(points) has shape {inside.shape}, ({len(points)},) is needed")
            return _members(inside, points, name)
        level = arrays.floats(inside, f"{name}(points)", (len(points),))
        members = level <= 0
        if not members.any():
            raise InputError(f"{name} is empty: its level function is positive at all {len(points)} points (it is negative inside)")
        return members, level
    if isinstance(given, list | tuple) and len(given) == 0:
        raise InputError(f"{name} is empty; give the points of the set, as a mask, as numbers, or as a level function")
    array = np.asarray(given)
    if array.size == 0 or (array.dtype.kind == "b" and not array.any()):
        raise InputError(f"{name} is empty; give the points of the set, as a mask, as numbers, or as a level function")
    if array.dtype.kind in "iuf" and array.shape == (len(points),) and len(points) > 2 and np.isin(array, (0, 1)).all():
        raise InputError(f"{name} has a 0 or 1 for each point, which could be numbers of points; a mask is given as {name}.astype(bool)")
    members = np.zeros(len(points), bool)
    members[arrays.indices(given, name, len(points))] = True
    return members, None


def _checked(u: Floats, a: Mask, b: Mask, beta: float) -> None:
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
    graph = scipy.sparse.coo_array((np.ones(len(mesh.first)), (mesh.first, mesh.second)), shape=(count, count))
    pieces, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
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
        rows = matrix[free]
        inner = rows[:, free]
        diagonal = inner.diagonal()
        if not (diagonal > 0).all():
            raise NumericalError("a point has no conduction")
        scale = 1 / np.sqrt(diagonal)
        inner = scipy.sparse.csr_array(inner.multiply(scale[:, None]).multiply(scale[None]))
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
    ops: Operators, u: Floats, exact: Any, members: tuple[Mask, Mask], levels: tuple[Function | None, Function | None],
    given: tuple[Floats | None, ...],
    beta: float, refine: int, report: Any,
) -> _System:  # fmt: skip
    count = len(u)
    edges: tuple[Any, Any] | None = None
    found = []
    for inside, level in zip(members, given, strict=True):
        if level is None:
            if edges is None:
                upper = scipy.sparse.coo_array(scipy.sparse.triu(ops.stiffness, 1))
                edges = upper.row, upper.col
            level = weighted.level_of_set(ops.coordinates, inside, edges, ops.shape.intrinsic_dimension)
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
        except (NumericalError, _TooDeep) as error:
            last = error
            continue
        if q.min() < -1e-12 or q.max() > 1 + 1e-12:
            last = NumericalError("q leaves [0, 1]")
            continue
        return _System(mesh, ops, count, tuple(parents), sets, outside, weights, np.clip(q, 0, 1), beta)
    # What is left once no conduction is negative is rounding: a well whose way out is lost beside its own conduction.
    outside = np.where(members[0] | members[1], np.inf, u)
    deepest = last.args[0] if isinstance(last, _TooDeep) and last.args[0] < count else int(np.argmin(outside))
    raise NumericalError(
        f"barriers around the well at point {deepest} are too high for double precision, q is lost there: take a smaller beta, or count "
        "the well to A or B"
    ) from last


def _expected_spacing(ops: CloudOperators, u: Floats) -> Floats | None:
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


def _strong(ops: Operators, u: Floats, a: Mask, b: Mask, circulation: Floats | None, beta: float) -> tuple[Floats, Floats]:
    """q by Δq - grad(β U) · grad q + β circulation · grad q = 0 at each point, and its gradient (n, D)."""
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
    scale = 1 / np.maximum(abs(matrix).sum(1), 1e-300)[free]
    inner = scipy.sparse.csc_array(matrix[free][:, free].multiply(scale[:, None]))
    try:
        q[free] = scipy.sparse.linalg.splu(inner).solve(-scale * (matrix[free] @ q))
    except RuntimeError as error:
        raise NumericalError(f"the strong form has no solution on these points ({error}); take the weak form, or more points") from None
    if not np.isfinite(q).all():
        raise NumericalError("the strong form has no finite solution on these points; take the weak form, or more points")
    return q, (gradient @ q).reshape(count, space)


def _rotating(system: _System, circulation: Floats, backwards: bool) -> Floats:
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
    scale = 1 / diagonal
    inner = scipy.sparse.csc_array(matrix[free][:, free].multiply(scale[:, None]))
    q[free] = scipy.sparse.linalg.splu(inner).solve(-scale * (matrix[free] @ q))
    if not np.isfinite(q).all():
        raise NumericalError("the committor of this circulation is not finite; its drift is too strong for the spacing of the points")
    found: Floats = np.clip(q, 0, 1)
    return found


# --- what samples say about U ------------------------------------------------------------------------------------------------------


def sample_density(shape: Shape | Operators, *, weights: Any = None, neighbors: int | None = None) -> Floats:
    """Density of the samples of a cloud: samples, or their weights, per unit of area; its integral is 1.

    The logarithm of the points' areas in the local mesh, whose scatter does not depend on the density, is fitted by a cubic around
    each point: in valleys narrower than the neighbourhood nothing is smeared out, and points at the rim, whose areas are cut off, do
    not count.

    Parameters
    ----------
    shape : PointCloud or Operators
    weights : array_like (n,), optional
        Of the samples, at least 0; the cloud's own, or 1 for each.
    neighbors : int, optional
        How many a fit takes: 40, 128 and 250 in one, two and three dimensions.

    Returns
    -------
    ndarray (n,)
        In one over units of length^d; its sum times ``ops.mass`` is 1.

    Raises
    ------
    InputError
        The shape is no cloud, or the weights are negative somewhere or 0 everywhere.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> cloud = bt.PointCloud(np.random.default_rng(0).random((4000, 2)))
    >>> bool(abs(np.median(bt.sample_density(cloud)) - 1) < 0.1)
    True
    """
    ops = operators(shape)
    if not isinstance(ops, CloudOperators):
        raise InputError("densities of samples are there for clouds")
    points, mass = ops.shape.points, ops.mass
    count = {1: 40, 2: 128, 3: 250}[ops.shape.dimension] if neighbors is None else arrays.whole(neighbors, "neighbors", 2)
    smooth = weighted.smoothed(ops, np.log(mass), (~ops.boundary).astype(float), count)
    if not np.abs(smooth).max() < 690:  # exp(700) is the end of float64
        power = np.abs(smooth).max() / np.log(10)
        raise NumericalError(f"a point stands for a volume of about 1e{power:.0f} or its inverse; rescale the cloud")
    found = np.exp(-smooth)
    given = weights if weights is not None else ops.shape.weights
    if given is not None:
        weight = arrays.floats(given, "weights", (len(points),))
        if (weight < 0).any() or not weight.sum() > 0:
            raise InputError("weights are negative somewhere or 0 everywhere; importance weights are at least 0")
        known = weight > 0
        weight = weight / weight.max()
        trend = np.exp(np.clip(weighted.smoothed(ops, np.log(np.where(known, weight, 1.0)), known.astype(float), count), -600, 600))
        # the weights scatter about the trend of their logarithm: their mean over it, nearby
        indices, distances = nearest_neighbors(points, points, min(count, len(points)))
        kernel = np.maximum(1 - np.square(distances / np.maximum(distances[:, -1:], 1e-300)), 1e-12)
        found = found * trend * (kernel * (weight / trend)[indices]).sum(1) / kernel.sum(1)
    return np.asarray(found / (found @ mass), float)


def reweight(energies: Any, sample_betas: Any, beta: float, *, tolerance: float = 1e-10) -> Floats:
    """Weights that make samples taken at several temperatures a sample at one (multistate reweighting).

    Parameters
    ----------
    energies : array_like (n,)
        Potential energy of each sample: of the whole system, not a free energy.
    sample_betas : array_like (n,)
        Inverse temperature at which each was taken.
    beta : float
        That of the answer.
    tolerance : float
        On the free energies, in units of kT.

    Returns
    -------
    ndarray (n,)
        They sum to 1.

    Raises
    ------
    InputError
        Arrays differ in length or are not finite, an inverse temperature is not positive, or there are more than 1,000 of them.

    References
    ----------
    Shirts and Chodera, Statistically optimal analysis of samples from multiple equilibrium states, 2008, equation (11).

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.reweight([0.0, 1.0], [1.0, 1.0], 1.0).tolist()
    [0.5, 0.5]
    """
    energy = arrays.floats(energies, "energies", (None,))
    betas = arrays.floats(sample_betas, "sample_betas", (len(energy),))
    wanted = arrays.number(beta, "beta", above=0.0)
    if len(energy) == 0 or (betas <= 0).any():
        raise InputError("sample_betas must be positive, one a sample")
    states, counts = np.unique(betas, return_counts=True)
    if len(states) > 1000:
        raise InputError(f"{len(states)} different temperatures; up to 1000 can be reweighted")
    shifted = energy - energy.min()
    bias = -states[:, None] * shifted[None]
    free = np.zeros(len(states))
    tolerance = arrays.number(tolerance, "tolerance", above=0)
    for _ in range(10_000):
        mixture = scipy.special.logsumexp(np.log(counts)[:, None] + free[:, None] + bias, axis=0)
        new = -scipy.special.logsumexp(bias - mixture, axis=1)
        new -= new[0]
        done = np.abs(new - free).max() <= tolerance
        free = new
        if done:
            break
    mixture = scipy.special.logsumexp(np.log(counts)[:, None] + free[:, None] + bias, axis=0)
    logarithm = -wanted * shifted - mixture
    weight = np.exp(logarithm - logarithm.max())
    found: Floats = weight / weight.sum()
    return found


def _sampled(
    ops: Operators, potential: Any, sampling: str | None, weights: Any, sample_beta: Any, beta: float
) -> tuple[Floats | None, str]:
    """Potential at the points where it is to come from the samples, and what was assumed."""
    if sampling is None:
        if potential is None:
            raise InputError(
                "potential is None; say what the samples are: sampling='gibbs' (of a known temperature), 'weighted' (with importance "
                "weights) or 'mixed' (of several temperatures, with their energies)"
            )
        sampling = "any"
    arrays.word(sampling, "sampling", get_args(Sampling))
    if sampling == "any":
        if weights is not None or sample_beta is not None:
            raise InputError("weights and sample_beta say how points were sampled; sampling='any' asks for neither")
        if potential is None:
            raise InputError("sampling='any' needs the potential")
        return None, "potential given; the points may be samples of any density, areas come from the local mesh"
    if not isinstance(ops, CloudOperators):
        raise InputError(f"sampling={sampling!r} takes the potential from the density of samples; a mesh has none")
    count = len(ops.coordinates)
    if sampling == "gibbs":
        if potential is not None or weights is not None:
            raise InputError("sampling='gibbs' takes the potential from the samples' density; leave out potential and weights")
        taken = beta if sample_beta is None else arrays.number(sample_beta, "sample_beta", above=0.0)
        return -np.log(sample_density(ops)) / taken, f"the samples' density is taken for exp(-{taken:g} U)"
    if sampling == "weighted":
        if potential is not None or sample_beta is not None:
            raise InputError(
                "sampling='weighted' takes the potential from the weighted samples' density; leave potential and sample_beta out"
            )
        given = weights if weights is not None else ops.shape.weights
        if given is None:
            raise InputError("sampling='weighted' needs weights= (or a cloud with weights)")
        text = "the weighted samples' density is taken for exp(-beta U)"
    else:
        if potential is None or callable(potential) or sample_beta is None:
            raise InputError("sampling='mixed' needs the energy of each sample as potential, and its inverse temperature as sample_beta")
        energies = arrays.floats(potential, "potential", (count,))
        given = reweight(energies, arrays.floats(sample_beta, "sample_beta", (count,)), beta)
        text = "the samples are reweighted from their temperatures to beta; their density is then taken for exp(-beta U)"
    found = sample_density(ops, weights=given)
    empty = np.flatnonzero(~(found > 0))
    if len(empty):
        raise InputError(f"the weighted density vanishes at {len(empty)} points ({_some(empty)}); leave samples of no weight out")
    return -np.log(found) / beta, text


# --- results -----------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CommittorDiagnostics:
    """How far a committor can be trusted.

    Attributes
    ----------
    outside : float
        Share of the points whose q was outside [0, 1] before it was clipped; 0 for the weak form.
    pieces : int
        Connected pieces of the shape.
    certified : float or None
        Share of certified stars; None for meshes.
    agreed : float
        Share of the area in simplices that all their corners' stars hold; 1 for meshes.
    transition_points : int
        Points with 0.1 < q < 0.9.
    effective_sample_size : float
        (Σ g)² / Σ g² of the Gibbs weights g of the points.
    transition_sample_size : float
        The same of g q (1 - q): how many points carry the transition.
    steepest : float
        Greatest β |ΔU| along an edge where the current flows (mean over the current).
    mended : int
        Triangles whose conduction was changed for 0 <= q <= 1.
    rate_mismatch : float
        Relative difference of the two estimates of the rate.
    """

    outside: float
    pieces: int
    certified: float | None
    agreed: float
    transition_points: int
    effective_sample_size: float
    transition_sample_size: float
    steepest: float
    mended: int
    rate_mismatch: float

    @property
    def concerns(self) -> tuple[str, ...]:
        """What speaks against the answer, in words; empty if nothing does."""
        found = []
        if self.outside > 0.01:
            found.append(f"q leaves [0, 1] at {100 * self.outside:.2g} % of the points")
        if self.transition_sample_size < 30:
            found.append(f"only {self.transition_sample_size:.0f} points effectively carry the transition: sample there")
        if self.steepest > 3:
            found.append(f"beta U changes by {self.steepest:.2g} along the edges that carry the current: take more points there")
        if self.certified is not None and self.certified < 0.99:
            found.append(f"{100 * (1 - self.certified):.2g} % of the stars are not certified")
        if self.agreed < 0.8:
            found.append(
                f"the stars disagree about {100 * (1 - self.agreed):.0f} % of the area: the surface is sampled too sparsely there, or in "
                "cells far longer than wide"
            )
        if self.rate_mismatch > 0.1:
            found.append(f"the two estimates of the rate differ by {100 * self.rate_mismatch:.2g} %")
        return tuple(found)

    @property
    def verdict(self) -> str:
        """One line: sound, or what is wrong."""
        return "sound" if not self.concerns else "doubtful: " + "; ".join(self.concerns)


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
        nu_AB, reactive trajectories from A to B a unit of time: the Dirichlet form of q.
    rate_error : float or None
        Its standard error, by half-samples; None without ``bootstrap``.
    rate_flux, rate_flux_error : float
        The second estimate, the flux through isocommittor surfaces by gradients fitted to q, and how much it differs between them
        (standard deviation).
    rate_constant, rate_constant_backward : float
        k_AB = nu_AB / p_A and k_BA = nu_AB / (1 - p_A).
    share_A : float
        p_A, the share of time for which A was visited last.
    current : ndarray (n, D)
        Reactive current, exp(-β U) grad q / (β Z): trajectories a unit of time and length; 0 in A and B.
    reactive_density : ndarray (n,)
        Probability density of being there and on the way from A to B.
    potential : ndarray (n,)
        U that was used, in the user's units, least value 0.
    in_A, in_B : ndarray (n,) of bool
    beta : float
    method : {"weak", "strong"}
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
    _system: _System
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
        return self._spread(_passage(self._system, 0))

    @cached_property
    def passage_time_to_B(self) -> Floats:
        """(n,): mean time until B is reached; 0 in B."""
        return self._spread(_passage(self._system, 1))

    @property
    def mean_first_passage_times(self) -> tuple[float, float]:
        """From A to B and from B to A: the start distributed in its set as exp(-β U)."""
        gibbs = self._system.restrict(self._system.gibbs)
        a, b = (s[: self._system.count] for s in self._system.sets)
        there, back = _passage(self._system, 1)[: len(a)], _passage(self._system, 0)[: len(a)]
        return float(gibbs[a] @ there[a] / gibbs[a].sum()), float(gibbs[b] @ back[b] / gibbs[b].sum())

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
        """Numbers of the points with \\|q - 1/2\\| <= width, the most probable ones (greatest exp(-β U)) first."""
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
        return FreeEnergyResult((edges[1:] + edges[:-1]) / 2, energy - energy.min() if len(energy) else energy)

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
        ahead, behind = _follow(self, starts, 1.0), _follow(self, starts, -1.0)
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
        """Writes everything to ``.npz``, a row a point to ``.csv``, or a picture to ``.png`` or ``.html``."""
        file = arrays.file(path, "path")
        suffix = file.suffix.lower()
        if suffix in (".png", ".html"):
            self.plot(path=file)
            return file
        if suffix not in (".npz", ".csv"):
            raise InputError(f"{file}: a committor is written to .npz, .csv, .png or .html")
        table = self.table()
        if suffix == ".npz":
            return written(file, lambda stream: np.savez_compressed(stream, **table, **self.scalars()))  # type: ignore[arg-type]
        rows = np.column_stack([np.asarray(column, float) for column in table.values()])
        names = [f"{name}_{k}" if array.ndim == 2 else name for name, array in table.items() for k in range(array[0].size)]
        return written(file, lambda stream: np.savetxt(stream, rows, delimiter=",", header=",".join(names), comments="", fmt="%.17g"))

    def table(self) -> dict[str, npt.NDArray[Any]]:
        """The arrays with a row a point."""
        names = ("q", "q_backward", "current", "reactive_density", "potential", "in_A", "in_B")
        return {"points": self.shape.coordinates, **{name: getattr(self, name) for name in names}}

    def scalars(self) -> dict[str, float]:
        """The rates, and what certifies them."""
        found = {"beta": self.beta, "rate": self.rate, "rate_flux": self.rate_flux, "rate_flux_error": self.rate_flux_error}
        found |= {"rate_constant": self.rate_constant, "rate_constant_backward": self.rate_constant_backward, "share_A": self.share_A}
        return found if self.rate_error is None else {**found, "rate_error": self.rate_error}

    def _spread(self, values: Floats) -> Floats:
        """Values at the nodes as values at the shape's points: the nearest one's where points were thinned out."""
        own = values[: self._system.count]
        if self._kept is None:
            return own.copy()
        base = nearest_neighbors(self._system.mesh.points[: self._system.count], self.shape.coordinates, 1)[0][:, 0]
        return own[base]


def _passage(system: _System, which: int) -> Floats:
    """Mean time until a set is reached: ∫ exp(-β U) grad t · grad v = β ∫ exp(-β U) v, t = 0 there."""
    mesh = system.mesh
    only = tuple(s if k == which else np.zeros_like(s) for k, s in enumerate(system.sets))
    conductance = mesh.edge_conduction * system.weights / weighted.cut(mesh, (only[0], only[1]))
    members = system.sets[which]
    free = np.flatnonzero(~members)
    reach = np.zeros(len(members))
    graph = scipy.sparse.coo_array((np.ones(len(mesh.first)), (mesh.first, mesh.second)), shape=(len(members),) * 2)
    label = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
    joined = np.isin(label[free], label[members])
    reach[free[~joined]] = np.inf
    free = free[joined]
    matrix = weighted.laplacian(len(members), mesh.first, mesh.second, conductance)[free][:, free]
    scale = 1 / np.sqrt(matrix.diagonal())
    factor = Cholesky(scipy.sparse.csr_array(matrix.multiply(scale[:, None]).multiply(scale[None])), mesh.points[free])
    reach[free] = factor.solve(system.beta * system.gibbs[free] * scale) * scale
    return reach


def _follow(result: CommittorResult, starts: Floats, sign: float) -> list[Floats]:
    """Lines along the current from each start, until the nearest point is in A or B."""
    system = result._system
    points = system.mesh.points[: system.count]
    current = result.current if result._kept is None else _current(system, result._partition)
    size = np.linalg.norm(current, axis=1)
    typical = np.maximum(size, 1e-300)
    ops = system.ops
    frames = ops.frames if isinstance(ops, CloudOperators) and ops.shape.dimension < points.shape[1] else None
    count = min(7, len(points))
    place, lines, moving = starts.copy(), [[start] for start in starts], np.arange(len(starts))
    target = system.sets[1 if sign > 0 else 0][: system.count]
    other = system.sets[0 if sign > 0 else 1][: system.count]
    reach = nearest_neighbors(points, points, min(7, len(points)))[1][:, -1]

    def direction(at: Floats) -> tuple[Floats, Floats, npt.NDArray[Any]]:
        near, distance = nearest_neighbors(points, at, count)
        width = np.maximum(distance[:, -1:], 1e-300)
        weight = np.exp(-3 * np.square(distance / width)) * (size[near] > 0)
        unit = np.einsum("sk,skD->sD", weight, current[near] / typical[near][:, :, None])
        length = np.linalg.norm(unit, axis=1)
        return sign * unit / np.maximum(length, 1e-300)[:, None], length, near[:, 0]

    for _ in range(20_000):
        if len(moving) == 0:
            break
        here = place[moving]
        first, length, near = direction(here)
        alive = (length > 1e-12) & ~target[near] & ~other[near]
        moving, here, first, near = moving[alive], here[alive], first[alive], near[alive]
        if len(moving) == 0:
            break
        step = 0.25 * reach[near][:, None]
        second, length, _ = direction(here + step / 2 * first)
        new = here + step * np.where((length > 1e-12)[:, None], second, first)
        if frames is not None:  # back to the surface: the part of the offset that is normal at the nearest point shrinks
            nearest = nearest_neighbors(points, new, 1)[0][:, 0]
            offset = new - points[nearest]
            tangent = np.einsum("sdD,sd->sD", frames[nearest], np.einsum("sdD,sD->sd", frames[nearest], offset))
            new = points[nearest] + tangent
        place[moving] = new
        for at, position in zip(moving.tolist(), new, strict=True):
            lines[at].append(position)
    return [np.array(line) for line in lines]


# --- the door ----------------------------------------------------------------------------------------------------------------------


def _current(system: _System, partition: float, backward: Floats | None = None, circulation: Floats | None = None) -> Floats:
    """Reactive current at the points; for a dynamics that is not reversible also its other two terms."""
    corners = system.mesh.simplices.shape[1]
    spread = np.stack(
        [np.bincount(system.mesh.simplices.ravel(), np.repeat(v / corners, corners), len(system.q)) for v in system.vectors.T], 1
    )
    area = system.restrict(system.mesh.mass)
    found: Floats = system.restrict(spread) / np.where(area > 0, area, 1.0)[:, None] / (system.beta * partition)
    if backward is not None and circulation is not None:
        # q- grad q+ - q+ grad q-, with exp(-βU) / (βZ), and what circulates of the reactive density
        turned = _current(replace(system, q=backward), partition)
        q, q_backward, gibbs = system.q[: system.count], backward[: system.count], np.exp(-system.mesh.potential[: system.count])
        found = q_backward[:, None] * found - q[:, None] * turned + (gibbs * q * q_backward / partition)[:, None] * circulation
    found[(system.sets[0] | system.sets[1])[: system.count]] = 0
    return found


def _fluxes(system: _System, partition: float, slabs: int = 8) -> Floats:
    """Flux through ``slabs`` layers between q = 0.1 and 0.9, by gradients fitted at the points outside A and B: (slabs,).

    Fitted is q, or its normal quantile, which is nearly linear across a barrier where q itself is steep: the one whose fluxes differ
    less, as they are all the same in truth.
    """
    mesh, q = system.mesh, system.q
    own = q[: system.count]
    known = (own > TAIL) & (own < 1 - TAIL) & ~(system.sets[0] | system.sets[1])[: system.count]
    # exp(-βU) |grad q| is smooth, exp(-βU) is not: harmonic means along the edges, averaged
    weight = mesh.volumes * system.weights[mesh.pairs].mean(1) / (system.beta * partition)
    low, high = q[mesh.simplices].min(1), q[mesh.simplices].max(1)
    width = np.maximum(high - low, 1e-300)
    below = [np.clip((level - low) / width, 0, 1) for level in np.linspace(0.1, 0.9, slabs + 1)]
    share = system.prolong(known.astype(float))[mesh.simplices].sum(1)
    middle = scipy.special.ndtri(np.clip(q[mesh.simplices].mean(1), TAIL, 1 - TAIL))
    quantile = scipy.special.ndtri(np.clip(own, TAIL, 1 - TAIL))
    found = []
    for values, scale in ((own, np.ones(len(weight))), (quantile, np.exp(-middle * middle) / (2 * np.pi))):
        slopes = weighted.gradients(system.ops, values, known) * known[:, None]
        gradient = system.prolong(slopes)[mesh.simplices].sum(1)
        energy = weight * scale * np.square(gradient / np.where(share > 0, share, 1.0)[:, None]).sum(1)
        found.append(np.array([(energy * (upper - lower)).sum() for lower, upper in itertools.pairwise(below)]) * slabs / 0.8)
    return min(found, key=lambda flux: float(flux.std() / max(flux.mean(), 1e-300)))


def committor(
    shape: Shape | Operators,
    potential: Any,
    A: Any,
    B: Any,
    *,
    beta: float,
    method: Method = "weak",
    sampling: Sampling | None = None,
    weights: Any = None,
    sample_beta: Any = None,
    circulation: Any = None,
    refine: int | None = None,
    max_points: int | None = None,
    bootstrap: int = 0,
    block: int = 1,
    rng: int | np.random.Generator | None = 0,
    progress: Progress = None,
) -> CommittorResult:
    """Probability of reaching B before A, and the rate of reactions from A to B, for ``dX = -grad U dt + sqrt(2 / β) dW`` on a shape.

    Parameters
    ----------
    shape : PointCloud, TriangleMesh or Operators
        Points of any density in R^D; a cloud of dimension 1, 2 or 3. Where it ends, trajectories are reflected.
    potential : array_like (n,), callable, or None
        U at the points; or a function of (k, D) positions with (k,) values, which is then evaluated between the points too; or None where
        U is to come from the samples (see ``sampling``).
    A, B : array_like of bool (n,), of point numbers, or callable
        Disjoint sets. A callable is a level function of (k, D) positions, negative inside: edges that cross its rim are cut there; or a
        predicate with (k,) bool, which is a mask. Of other sets the rim is taken to lie half-way to the points around, or at the outermost
        members where these lie in a row.
    beta : float
        Inverse temperature, in one over the units of the potential.
    method : {"weak", "strong"}
        Linear elements weighted by exp(-β U) on the local mesh (or on the mesh's triangles); or collocation by moving least squares,
        a cross-check for clouds that are dense enough.
    sampling : {"any", "gibbs", "weighted", "mixed"}, optional
        ``"any"`` (where a potential is given): the points may be samples of any density. ``"gibbs"``: no potential; the points are samples
        of exp(-sample_beta U). ``"weighted"``: no potential; samples with ``weights`` stand for exp(-β U). ``"mixed"``: ``potential`` is
        the energy of each sample, which was taken at its ``sample_beta``; they are reweighted to β. In the last three U is the free
        energy on the shape, from the samples' (weighted) density.
    weights : array_like (n,), optional
        Importance weights for ``"weighted"``; the cloud's own by default.
    sample_beta : float or array_like (n,), optional
        Inverse temperature of the samples for ``"gibbs"`` (default β) and ``"mixed"`` (one a sample).
    circulation : array_like (n, D), optional
        A further drift ``l`` that keeps the Gibbs density, ``div(exp(-β U) l) = 0``: the dynamics is then not reversible, and
        ``q_backward`` is solved for too.
    refine : int, optional
        How often triangles are split in four, U a quadratic on each: 1 for surfaces by default, 0 is faster; surfaces only.
    max_points : int, optional
        Clouds with more points are thinned out evenly to about so many (no two nearer, and none left out farther from them, than a
        radius); these carry the masses of the others, and q is fitted there. Densities count all points.
    bootstrap : int
        How many half-samples (without replacement) the error of the rate is estimated from; 0 for none. Clouds only.
    block : int
        Points are drawn in blocks of so many consecutive ones: for trajectories, their correlation time.
    rng : int or numpy Generator
        Of the half-samples.
    progress : callable or True, optional

    Returns
    -------
    CommittorResult
        ``r.q``, ``r.rate``, ``r.rate_constant``, ``r.current``, ``r.verdict`` and more. Time is counted in units of length² β.

    Raises
    ------
    InputError
        A or B is empty, they overlap, a number is not finite, beta is not positive, or arguments contradict each other.
    TopologyError
        Points reach neither A nor B, or these lie in different pieces; the message names points.
    NumericalError
        exp(-β U) underflows at points that are named, or barriers are too high for double precision.

    References
    ----------
    E and Vanden-Eijnden, Towards a theory of transition paths, 2006.
    Lai and Lu, Point cloud discretization of Fokker-Planck operators for committor functions, 2018.
    Scharfetter and Gummel, Large-signal analysis of a silicon Read diode oscillator, 1969.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> x = np.random.default_rng(0).uniform([-1.6, -1], [1.6, 1], (2000, 2))
    >>> r = bt.committor(
    ...     bt.PointCloud(x), lambda x: (x[:, 0] ** 2 - 1) ** 2, lambda x: x[:, 0] + 1, lambda x: 1 - x[:, 0], beta=4.0
    ... )
    >>> bool(abs(r.q[abs(x[:, 0]) < 0.02] - 0.5).max() < 0.03), r.verdict
    (True, 'sound')
    """
    report = reporter(progress, "committor")
    beta = arrays.number(beta, "beta", above=0.0)
    replicates = arrays.whole(bootstrap, "bootstrap", 0, 10_000)
    length = arrays.whole(block, "block", 1)
    arrays.word(method, "method", get_args(Method))
    given = shape.shape if isinstance(shape, Operators) else shape
    first = part(report, 0.0, 0.4 / (1 + replicates))
    ops = shape if isinstance(shape, Operators) else operators(shape, progress=first)
    points = ops.coordinates
    if replicates and not isinstance(given, PointCloud):
        raise InputError("bootstrap draws half of the samples again and again; a mesh has no samples")
    a, level_a = _members(A, points, "A")
    b, level_b = _members(B, points, "B")
    energy, assumption = _sampled(ops, potential, sampling, weights, sample_beta, beta)
    function = potential if energy is None and callable(potential) else None
    if energy is None:
        energy = _potential(potential, points)
    drift = None if circulation is None else arrays.floats(circulation, "circulation", points.shape)
    least = float(energy.min())
    energy = energy - least
    with np.errstate(over="ignore"):
        u = beta * energy
    _checked(u, a, b, beta)
    kept = None
    if max_points is not None:
        kept = _thinned(ops, arrays.whole(max_points, "max_points", 10), a, b)
    carried, base = None, np.zeros(0, np.int64)
    if kept is not None:
        assert isinstance(given, PointCloud)
        base = nearest_neighbors(points[kept], points, 1)[0][:, 0].astype(np.int64)
        carried = np.bincount(base, ops.mass * np.exp(-u), len(kept)).astype(float)
        normals = None if given.normals is None else given.normals[kept]
        ops = operators(PointCloud(points[kept], dimension=given.dimension, normals=normals))
    part_of = slice(None) if kept is None else kept
    if method == "weak" and isinstance(ops, CloudOperators) and not isinstance(ops, LeastSquaresOperators):
        reach = _expected_spacing(ops, u[part_of])
        if reach is not None:
            ops = ops.reaching(reach)

    def exact(places: Floats) -> Floats:
        return beta * (_called(function, places, "potential") - least)  # type: ignore[arg-type]

    def level_of(given: Any, level: Floats | None, name: str) -> Function | None:
        return None if level is None else (lambda places: _called(given, places, name))

    if refine is None:
        levels = 1 if ops.shape.intrinsic_dimension == 2 and method == "weak" else 0
    else:
        levels = arrays.whole(refine, "refine", 0, 3)
        if levels and (ops.shape.intrinsic_dimension != 2 or method != "weak"):
            raise InputError(f"refine is {levels}; triangles are split, and only in the weak form")
    remedy = "refine less, or take " + ("fewer points (max_points=)" if isinstance(ops.shape, PointCloud) else "a coarser mesh")
    arrays.room(250.0 * 4**levels * len(ops.mass), f"refine = {levels} of {len(ops.mass)} points", remedy)  # numbers as measured
    system = _weak(
        ops, u[part_of], None if function is None else exact, (a[part_of], b[part_of]),
        (level_of(A, level_a, "A"), level_of(B, level_b, "B")),
        tuple(None if level is None else level[part_of] for level in (level_a, level_b)), beta, levels,
        part(report, 0.4 / (1 + replicates), 1.0 / (1 + replicates)),
    )  # fmt: skip
    system = replace(system, carried=carried)
    outside = 0.0
    partition = float(system.gibbs.sum())
    jump = system.q[system.mesh.first] - system.q[system.mesh.second]
    if method == "strong":
        values, slopes = _strong(ops, u[part_of], a[part_of], b[part_of], None if drift is None else drift[part_of], beta)
        outside = float(((values < -1e-10) | (values > 1 + 1e-10)).mean())
        system = replace(system, q=np.clip(values, 0, 1))
        rate = float(system.gibbs @ np.square(slopes).sum(1)) / (beta * partition)
    else:
        if drift is not None:
            system = replace(system, q=_rotating(system, drift[part_of], False))
            jump = system.q[system.mesh.first] - system.q[system.mesh.second]
        rate = float((system.conductance * jump * jump).sum()) / (beta * partition)
    backward = 1 - system.q if drift is None else _rotating(system, drift[part_of], True)
    if not (np.isfinite(rate) and rate > 0):
        raise NumericalError(f"the rate is {rate:g}: out of the range of double precision; measure in other units, or take a smaller beta")
    share_a = float(system.gibbs @ backward) / partition
    fluxes = _fluxes(system, partition)
    flux, flux_error = float(fluxes.mean()), float(fluxes.std(ddof=1))
    current = _current(system, partition, backward if drift is not None else None, drift[part_of] if drift is not None else None)
    q, q_backward = system.q[: system.count].copy(), backward[: system.count].copy()
    if kept is not None:
        q, q_backward = (_extended(ops, values, points, base, a, b, one) for values, one in ((q, b), (q_backward, a)))
        current = current[base]
        current[a | b] = 0
    amount = np.exp(-u) / partition
    errors = np.zeros(0)
    if replicates:
        assert isinstance(given, PointCloud)
        halves = {"method": method, "sampling": sampling, "refine": refine, "max_points": max_points, "beta": beta}
        errors = _half_samples(
            given, potential, (A, a), (B, b), (weights, sample_beta, drift), halves, replicates, length, arrays.generator(rng),
            part(report, 1.0 / (1 + replicates), 1.0),
        )  # fmt: skip
    teller(report)(1.0)
    return CommittorResult(
        shape=given, q=q, q_backward=q_backward, rate=rate, rate_error=_error(errors, rate) if replicates else None, rate_flux=flux,
        rate_flux_error=flux_error, rate_constant=rate / share_a, rate_constant_backward=rate / (1 - share_a), share_A=share_a,
        current=current, reactive_density=amount * q * q_backward, potential=energy, in_A=a, in_B=b, beta=beta, method=method,
        assumption=assumption, replicates=errors, diagnostics=_diagnosed(system, outside, flux / rate - 1), _system=system,
        _partition=partition, _kept=kept,
    )  # fmt: skip


def _diagnosed(system: _System, outside: float, mismatch: float) -> CommittorDiagnostics:
    mesh, ops = system.mesh, system.ops
    gibbs, q = system.restrict(system.gibbs), system.q[: system.count]
    transition = gibbs * q * (1 - q)
    used = system.conductance * np.square(system.q[mesh.first] - system.q[mesh.second])
    used = np.maximum(used, 0)
    length = 2.0 ** len(system.parents)  # steps of U along the edges of the shape itself
    steep = length * float(used @ np.abs(mesh.potential[mesh.first] - mesh.potential[mesh.second]) / used.sum()) if used.sum() > 0 else 0.0

    def effective(weights: Floats) -> float:
        top = float(weights.max())
        scaled = weights / top if top > 0 else weights
        return float(scaled.sum() ** 2 / np.square(scaled).sum()) if top > 0 else 0.0

    return CommittorDiagnostics(
        outside=outside,
        pieces=int(ops.component_labels.max()) + 1,
        certified=ops.certified if isinstance(ops, CloudOperators) else None,
        agreed=float(mesh.volumes[mesh.share > 0.999].sum() / mesh.volumes.sum()),
        transition_points=int(((q > 0.1) & (q < 0.9)).sum()),
        effective_sample_size=effective(gibbs),
        transition_sample_size=effective(transition),
        steepest=steep,
        mended=int(mesh.mended.sum()),
        rate_mismatch=abs(mismatch),
    )


def _thinned(ops: Operators, most: int, a: Mask, b: Mask) -> npt.NDArray[np.int64] | None:
    """About ``most`` points that cover a cloud evenly, ascending; none where it has no more."""
    if not isinstance(ops, CloudOperators):
        raise InputError("max_points thins out clouds; a mesh stays as it is")
    points, d = ops.shape.points, ops.shape.dimension
    if len(points) <= most:
        return None
    radius = (float(ops.mass.sum()) / most) ** (1 / d)
    kept = np.arange(len(points))
    low, high = 0.0, np.inf
    for _ in range(12):
        kept = np.sort(poisson_disc(points, radius)).astype(np.int64)
        if 0.95 * most <= len(kept) <= most:
            break
        low, high = (radius, high) if len(kept) > most else (low, radius)
        guess = radius * (len(kept) / (0.975 * most)) ** (1 / d)
        radius = guess if low < guess < high else (low + high) / 2 if np.isfinite(high) else 2 * low
    for members, name in ((a, "A"), (b, "B")):
        if not members[kept].any():
            raise InputError(f"no point of {name} is left of {most}; raise max_points, or enlarge {name}")
    return kept


def _extended(ops: Operators, q: Floats, points: Floats, base: npt.NDArray[Any], a: Mask, b: Mask, one: Mask) -> Floats:
    assert isinstance(ops, CloudOperators)
    found = np.clip(weighted.fit(ops, q, 2).at(base, points), 0, 1)
    found[a | b] = 0
    found[one] = 1
    return found


def _half_samples(
    cloud: PointCloud, potential: Any, one: tuple[Any, Mask], other: tuple[Any, Mask], extra: tuple[Any, Any, Any],
    options: dict[str, Any], replicates: int, block: int, generator: np.random.Generator, report: Any,
) -> Floats:  # fmt: skip
    count = len(cloud.points)
    blocks = -(-count // block)
    if blocks < 4:
        raise InputError(f"{count} points make {blocks} blocks of {block}; bootstrap needs 4 or more")
    weights, sample_beta, drift = extra
    rates, reason = [], ""
    for replicate in range(replicates):
        chosen = np.zeros(blocks, bool)
        chosen[generator.permutation(blocks)[: blocks // 2]] = True
        half = np.flatnonzero(np.repeat(chosen, block)[:count])
        part_of = PointCloud(
            cloud.points[half], dimension=cloud.dimension, normals=None if cloud.normals is None else cloud.normals[half],
            weights=None if cloud.weights is None else cloud.weights[half],
        )  # fmt: skip
        try:
            found = committor(
                part_of, potential if potential is None or callable(potential) else np.asarray(potential)[half],
                *(given if callable(given) else members[half] for given, members in (one, other)),
                weights=None if weights is None else np.asarray(weights)[half],
                sample_beta=np.asarray(sample_beta)[half] if np.ndim(sample_beta) else sample_beta,
                circulation=None if drift is None else drift[half], **options,
            )  # fmt: skip
            rates.append(found.rate)
        except Cancelled:
            raise
        except Error as error:  # a half may fall apart where the whole does not
            reason = str(error)
        teller(report)((replicate + 1) / replicates)
    if len(rates) < max(2, replicates / 2):
        raise NumericalError(f"{replicates - len(rates)} of {replicates} half-samples have no committor, the last because: {reason}")
    return np.array(rates)


def _error(replicates: Floats, rate: float) -> float:
    """Standard error of a rate from those of half-samples: their spread, and how far they are off on average.

    A half-sample's variance about the whole is that of the whole about the truth; and where the error of the discretization goes like
    1 / n, half of the points have twice of it.
    """
    return float(np.hypot(replicates.std(ddof=1), replicates.mean() - rate))
