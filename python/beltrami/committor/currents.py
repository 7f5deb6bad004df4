"""Quantities that follow from a committor: currents, the flux through its level sets, passage times, streamlines."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from ..arrays import Floats
from ..clouds import CloudOperators
from ..errors import NumericalError
from ..near import nearest_neighbors
from . import weighted
from .solve import System, TooDeep, reached_first

ROUND = 64  # steps a point: some ten times what a line needs to pass it
TAIL = 3e-5  # q closer to 0 or 1 counts as that in the second estimate of the rate


def passage_time(system: System, which: int) -> Floats:
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
    if len(free) == 0:
        return reach
    # By way of the deepest node: the time until it or the set is reached, and from there what of the Gibbs density comes from it rather
    # than from the set, over the flux of that to the set. Solved for at once, high barriers leave nothing of the time but rounding.
    matrix, load = weighted.laplacian(len(members), mesh.first, mesh.second, conductance), system.beta * system.gibbs
    deepest = np.zeros_like(members)
    deepest[free[np.argmax(load[free])]] = True
    others, share = free[~deepest[free]], deepest.astype(float)
    try:
        if len(others):
            _, share[others], reach[others] = reached_first(matrix, others, (members, deepest), mesh.points, None, load)
    except (TooDeep, NumericalError) as error:
        raise NumericalError(
            f"barriers on the way to {'AB'[which]} are too high for double precision, the mean times to it are lost: take a smaller beta"
        ) from error
    jump = share[mesh.first] - share[mesh.second]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        reach[free] += share[free] * ((load * share).sum() / (conductance * jump * jump).sum())
    if not np.isfinite(reach[free]).all():
        raise NumericalError("mean times are out of the range of double precision; measure in other units, or take a smaller beta")
    return reach


def follow(system: System, current: Floats, starts: Floats, sign: float) -> list[Floats]:
    """Lines along the current at the points from each start, until the nearest point is in A or B, or they go round and round."""
    points = system.mesh.points[: system.count]
    current = np.ldexp(current, -np.frexp(np.abs(current).max(initial=0.0))[1])  # so that squares stay in range
    size = np.linalg.norm(current, axis=1)
    typical = np.maximum(size, 1e-300)
    ops = system.ops
    frames = ops.frames if isinstance(ops, CloudOperators) and ops.shape.dimension < points.shape[1] else None
    count = min(7, len(points))
    place, lines, moving = starts.copy(), [[start] for start in starts], np.arange(len(starts))
    passed: list[set[int]] = [set() for _ in starts]  # the points that were nearest
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
        for at, position, nearby in zip(moving.tolist(), new, near.tolist(), strict=True):
            lines[at].append(position)
            passed[at].add(nearby)
        moving = np.array([at for at in moving.tolist() if len(lines[at]) < ROUND * (len(passed[at]) + 2)], np.int64)
    return [np.array(line) for line in lines]


def reactive_current(system: System, partition: float, backward: Floats | None = None, circulation: Floats | None = None) -> Floats:
    """Reactive current at the points; for a dynamics that is not reversible also its other two terms."""
    corners = system.mesh.simplices.shape[1]
    spread = np.stack(
        [np.bincount(system.mesh.simplices.ravel(), np.repeat(v / corners, corners), len(system.q)) for v in system.vectors.T], 1
    )
    area = system.restrict(system.mesh.mass)
    found: Floats = system.restrict(spread) / np.where(area > 0, area, 1.0)[:, None] / (system.beta * partition)
    if backward is not None and circulation is not None:
        # q- grad q+ - q+ grad q-, with exp(-βU) / (βZ), and what circulates of the reactive density
        turned = reactive_current(replace(system, q=backward), partition)
        q, q_backward, gibbs = system.q[: system.count], backward[: system.count], np.exp(-system.mesh.potential[: system.count])
        found = q_backward[:, None] * found - q[:, None] * turned + (gibbs * q * q_backward / partition)[:, None] * circulation
    found[(system.sets[0] | system.sets[1])[: system.count]] = 0
    return found


def slab_fluxes(system: System, partition: float, unit: float, slabs: int = 8) -> Floats:
    """Flux in a ``unit`` through ``slabs`` layers between q = 0.1 and 0.9, by gradients fitted at the points outside A and B: (slabs,).

    Fitted is q, or its normal quantile, which is nearly linear across a barrier where q itself is steep: the one whose fluxes differ
    less, as they are all the same in truth.
    """
    mesh, q = system.mesh, system.q
    own = q[: system.count]
    known = (own > TAIL) & (own < 1 - TAIL) & ~(system.sets[0] | system.sets[1])[: system.count]
    # exp(-βU) |grad q| is smooth, exp(-βU) is not: harmonic means along the edges, averaged
    weight = mesh.volumes * system.weights[mesh.pairs].mean(1) / (system.beta * partition) / unit
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
