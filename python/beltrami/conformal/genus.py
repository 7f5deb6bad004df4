"""Whether a cloud that was mapped to the sphere is one: what the map shows, and the Reeb graph of the first eigenfunction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from ..arrays import Floats
from ..clouds import CloudOperators
from ..errors import InputError, TopologyError
from ..near import nearest_neighbors

Faces = npt.NDArray[np.int64]
Ints64 = npt.NDArray[np.int64]

# Set by 250 clouds of 25 closed shapes of genus 0 (as they are, sampled at random with 500 to 6,000 points, with noise up to 1 % of the
# diagonal), 40 of genus 1 to 4 and 30 open ones; what each number was on them stands beside it.
DOUBT = 0.01  # mixed points above which loops are counted
FOLDED = 0.35  # mixed points of a cloud that is no sphere whatever else is seen (genus 0: at most .15, tori .1 to .9)
MIXED = 0.06  # the same where there are loops (genus 0 with loops by mistake: at most .04)
STABLE = 0.3  # height of the least loop over the diagonal, enough by itself (genus 0 with loops by mistake: at most .15, thin tori .8)
BARE = 0.03  # share of the sphere without images (closed: at most .0025, hemispheres .14), where half as many boundary points hang together
RING = 1.0  # connected boundary points over the root of the number of points (closed: at most .43, hemispheres 1.4)
AGREED, HARDLY = 0.7, 0.3  # simplices that all their stars hold, where boundary points count: noise makes more


def within_edges(faces: Faces, n: int, edges: int, points: Ints64, rows: Ints64, others: Ints64) -> npt.NDArray[np.bool_]:
    """Whether each of the others is at most so many edges away from ``points[rows]``."""
    a, b = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    graph = scipy.sparse.csr_array((np.ones(len(a), np.int32), (a, b)), (n, n))
    graph = scipy.sparse.csr_array(graph + graph.T + scipy.sparse.eye_array(n, dtype=np.int32))
    graph.data[:] = 1
    reached = graph[points]
    for _ in range(edges - 1):
        reached = scipy.sparse.csr_array(reached @ graph)
        reached.data[:] = 1
    reached.sort_indices()
    keys = np.repeat(np.arange(len(points)), np.diff(reached.indptr)) * n + reached.indices
    wanted = rows * n + others
    found: npt.NDArray[np.bool_] = keys[np.searchsorted(keys, wanted).clip(max=len(keys) - 1)] == wanted
    return found


def mixed_share(s: Floats, faces: Faces, count: int = 3000) -> float:
    """Share of the points that have two or more of their six nearest images from elsewhere, more than four edges away.

    Where a map is one to one, neighbours on the sphere are neighbours on the surface. A surface of higher genus covers the sphere several
    times or in folds, and points of several sheets lie between each other.
    """
    n = len(s)
    picked = np.unique(np.linspace(0, n - 1, min(n, count)).astype(np.int64))
    near = nearest_neighbors(s, s[picked], min(7, n))[0].astype(np.int64)
    known = within_edges(faces, n, 4, picked, np.arange(len(picked))[:, None], near)
    return float(((~known).sum(1) >= 2).mean())


def bare_share(s: Floats, count: int = 2000) -> float:
    """Share of the sphere that is farther from the nearest image than twice that image's own spacing."""
    turns = np.arange(count) + 0.5
    height = 1 - 2 * turns / count
    radius, angle = np.sqrt(1 - height * height), np.pi * (1 + np.sqrt(5)) * turns
    directions = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    nearest, distance = nearest_neighbors(s, directions, 1)
    spacing = nearest_neighbors(s, s[nearest[:, 0]], min(7, len(s)))[1][:, -1]
    return float((distance[:, 0] > 2 * spacing).mean())


def largest_ring(ops: CloudOperators) -> int:
    """How many boundary points hang together at most."""
    index = np.flatnonzero(ops.boundary)
    if len(index) == 0:
        return 0
    labels = scipy.sparse.csgraph.connected_components(ops.stiffness[index][:, index], directed=False)[1]
    return int(np.bincount(labels).max())


@dataclass(frozen=True)
class Findings:
    """What the map of a cloud shows."""

    covered: float  # how many times the images of the simplices cover the sphere
    mixed: float
    bare: float
    ring: int
    agreed: float

    def checked(self, ops: CloudOperators, facts: str) -> tuple[str, ...]:
        """Notes on what is doubtful; an error where the cloud is no sphere."""
        onward = "check_genus=False maps it all the same"
        seen = self.bare > 5e-4 or float(ops.boundary.mean()) > 0.1  # a groove finer than the points makes a ring as well, but no hole
        rings = self.ring / (RING * np.sqrt(len(ops.shape.points)))
        if (self.bare > BARE and rings > 0.5 and self.agreed > HARDLY) or (self.agreed >= AGREED and rings > 1 and seen):
            raise TopologyError(
                f"the cloud is open: {self.ring} boundary points hang together, and {100 * self.bare:.0f} % of the sphere is left without "
                f"images; {facts}. A closed surface is needed: sample what is missing, or mesh the cloud and take fill_holes=True; {onward}"
            )
        if self.mixed <= DOUBT and self.covered > 0.9:  # noise alone crumples simplices, which then cover more
            return ()
        loops, stable = _loops(ops)
        told = (
            f"{100 * self.mixed:.0f} % of the points have images between those of far points, the best map covers the sphere "
            f"{self.covered:.2f} times"
        )
        if loops and (self.mixed > MIXED or stable > STABLE):
            handles = "handle" if loops == 1 else "handles"
            raise TopologyError(
                f"the cloud has genus {loops} or more: the Reeb graph of its first eigenfunction has {loops} {handles}, {told}; {facts}. "
                "Only surfaces of genus 0 map to the sphere one to one. Where the cloud has no handle, its sheets are nearer to each other "
                f"than its points: give it oriented normals, or more points; {onward}"
            )
        if self.mixed > FOLDED:
            raise TopologyError(
                f"the cloud does not map to the sphere one to one: {told}; {facts}. Its genus is above 0, or its sheets are nearer to each "
                f"other than its points, or than the noise: give it oriented normals, or more points; {onward}"
            )
        if (loops and self.mixed > DOUBT) or self.mixed > MIXED:
            return (f"genus 0 is doubtful: {told}, the Reeb graph of the first eigenfunction has {loops} loops",)
        return ()


def _loops(ops: CloudOperators) -> tuple[int, float]:
    """Loops of the Reeb graph of the first eigenfunction, and the height of the least over the diagonal of the cloud."""
    from ..skeleton import skeleton

    try:
        found = skeleton(ops.shape, function="eigenfunction")
    except InputError:
        return 0, 0.0  # too few points
    diagonal = float(np.linalg.norm(np.ptp(ops.shape.points, axis=0)))
    return found.cycles, found.stability[1] / diagonal if found.cycles else 0.0
