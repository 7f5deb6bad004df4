"""Skeletons of meshes and point clouds: the Reeb graph of the first eigenfunction, drawn along the middle of the shape (section 8.3.2)."""

from __future__ import annotations

import itertools
import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from . import _core, arrays
from .arrays import Floats, Ints
from .clouds import CloudOperators
from .eigen import eigenpairs
from .errors import FileError, InputError, TopologyError
from .near import intersect_rays, nearest_neighbors
from .operators import Operators, operators
from .progress import Progress, part, reporter
from .sampling import poisson_disc
from .shapes import PointCloud, Shape, TriangleMesh
from .view import Page, Picture

__all__ = ["SkeletonResult", "skeleton"]

Indices = npt.NDArray[np.int64]

LEVELS = 150  # at most
DIRECTIONS = 24  # of the rays that centre a node
MULTIPLE = 1.15  # eigenvalues up to this factor of the first count as copies of it
NOISY = 0.03  # share of the variance of 8 neighbours across the surface; .006 on coarse clean samples, .1 under noise of a spacing
LIMB = 1.4  # a limb is at least this many times longer than it is wide at its root


# --- the complex ---------------------------------------------------------------------------------------------------------------------


@dataclass
class _Complex:
    """What is cut: points, cells (triangles or edges), and who of the user's points each belongs to."""

    points: Floats
    cells: Ints
    edges: Ints
    spacing: float
    weights: Floats
    stiffness: sparse.csr_array
    mass: Floats
    origin: Indices  # the user's number of each point
    sources: Floats  # points that show where the surface is (the user's, not denoised)

    @property
    def is_mesh(self) -> bool:
        return bool(self.cells.shape[1] == 3)


def _unique_edges(pairs: npt.NDArray[Any]) -> Ints:
    pairs = np.sort(pairs.astype(np.int64), axis=1)
    keys = np.unique(pairs[:, 0] << 32 | pairs[:, 1])
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], 1).astype(np.int32)


def _sides(cells: Ints) -> Ints:
    return np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [0, 2]]])


def _mesh_complex(ops: Operators) -> _Complex:
    mesh = ops.shape
    assert isinstance(mesh, TriangleMesh)
    edges = _unique_edges(_sides(mesh.faces))
    lengths = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    n = len(mesh.vertices)
    return _Complex(
        mesh.vertices, mesh.faces, edges, float(np.median(lengths)), np.ones(n), ops.stiffness, ops.mass, np.arange(n), mesh.vertices
    )


def _plane_fits(points: Floats, queries: Floats, count: int) -> tuple[Floats, Floats, Floats]:
    """Mean of the neighbours of each query, direction in which they vary least, share of the variance along it."""
    indices, _ = nearest_neighbors(points, queries, count)
    means, normals, shares = np.empty_like(queries), np.empty_like(queries), np.empty(len(queries))
    for start in range(0, len(queries), 4096):  # so that memory stays small
        here = slice(start, start + 4096)
        near = points[indices[here]]
        means[here] = near.mean(1)
        near = near - means[here, None]
        values, vectors = np.linalg.eigh(np.matmul(near.transpose(0, 2, 1), near))
        normals[here] = vectors[:, :, 0]
        shares[here] = values[:, 0] / np.maximum(values.sum(1), 1e-300)
    return means, normals, shares


def _denoised(points: Floats) -> tuple[Floats, Indices, int]:
    """Points moved onto the surface that a noisy cloud suggests, fewer of them; the numbers of those kept; neighbours taken (0: clean).

    Where 8 neighbours vary across the surface nearly as much as along it, there is noise of the size of the spacing. Planes through
    as many neighbours as make that share least average it out; two projections on them (moving least squares).
    """
    count = len(points)
    everyone = np.arange(count)
    sample = points[:: max(1, count // 1500)]

    def share(neighbors: int) -> float:
        return float(np.median(_plane_fits(points, sample, neighbors)[2]))

    if points.shape[1] != 3 or count < 100 or share(8) < NOISY:
        return points, everyone, 0
    sizes = [size for size in (24, 32, 48, 64, 96, 128, 192) if size <= count // 8]
    if not sizes:
        return points, everyone, 0
    neighbors = min(sizes, key=share)
    spacing = float(np.median(nearest_neighbors(points, sample, 7)[1][:, 6]))
    kept = np.sort(poisson_disc(points, spacing * min(1.0, 0.1 * np.sqrt(neighbors)) * 0.6)).astype(np.int64)
    moved = points[kept]
    for _ in range(2):
        means, normals, _ = _plane_fits(points, moved, neighbors)
        moved = moved - normals * np.einsum("nd,nd->n", moved - means, normals)[:, None]
    _, distances = nearest_neighbors(moved, moved, 7)
    apart = np.sort(poisson_disc(moved, 0.4 * float(np.median(distances[:, 6]))))
    return np.ascontiguousarray(moved[apart]), kept[apart], neighbors


def _oriented(points: Floats) -> tuple[Floats, float]:
    """Normals oriented alike, and the share of tangential edges across which they are not.

    Signs are carried by reflection (Hoppe et al. 1992) along a minimum spanning forest that prefers edges within the surface: edges
    across a gap between two parts, or through a thin part, come last.
    """
    count = len(points)
    indices, _ = nearest_neighbors(points, points, min(13, count))
    _, normals, shares = _plane_fits(points, points, min(8, count))
    pairs = np.stack([np.repeat(np.arange(count), indices.shape[1] - 1), indices[:, 1:].ravel()], 1)
    pairs = _unique_edges(pairs[pairs[:, 0] != pairs[:, 1]])
    i, j = pairs.T
    along = points[j] - points[i]
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    a, b = np.einsum("ed,ed->e", along, normals[i]), np.einsum("ed,ed->e", along, normals[j])
    same = np.einsum("ed,ed->e", normals[i], normals[j])
    reflected = same - 2 * a * b
    steep = np.maximum(a * a, b * b)
    cost = 1 - np.abs(reflected) + steep + 3 * (shares[i] + shares[j]) + 1e-6
    forest = minimum_spanning_tree(sparse.coo_array((cost, (i, j)), shape=(count, count)).tocsr()).tocoo()
    p, q = forest.coords
    along = points[q] - points[p]
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    turn = np.einsum("ed,ed->e", normals[p], normals[q])
    turn -= 2 * np.einsum("ed,ed->e", along, normals[p]) * np.einsum("ed,ed->e", along, normals[q])
    turn = np.where(turn < 0, -1.0, 1.0)
    tree = sparse.coo_array((np.r_[turn, turn], (np.r_[p, q], np.r_[q, p])), shape=(count, count)).tocsr()
    pieces, labels = connected_components(tree, directed=False)
    signs = np.ones(count)
    for piece in range(pieces):
        members = np.flatnonzero(labels == piece)
        away = points[members] - points[members].mean(0)
        root = members[np.argmax(np.einsum("nd,nd->n", away, away))]
        signs[root] = 1.0 if normals[root] @ (points[root] - points[members].mean(0)) >= 0 else -1.0
        order, before = breadth_first_order(tree, root, directed=False)
        for child, parent in zip(order[1:].tolist(), before[order[1:]].tolist(), strict=True):
            row = slice(tree.indptr[child], tree.indptr[child + 1])
            signs[child] = signs[parent] * tree.data[row][tree.indices[row] == parent][0]
    flat = (steep < 0.1) & (np.abs(same) > 0.8)
    seam = float(((signs[i] * signs[j] * same < 0) & flat).sum() / max(flat.sum(), 1))
    return normals * signs[:, None], seam


def _cloud_complex(cloud: PointCloud, notes: list[str], report: Any) -> _Complex:
    """Edges of the local mesh, with the sides of thin parts and near parts told apart by oriented normals where they can be found."""
    _, first = np.unique(cloud.points, axis=0, return_index=True)
    origin = np.sort(first)
    if len(origin) < len(cloud.points):
        notes.append(f"{len(cloud.points) - len(origin)} points are copies of others")
    given = cloud.points[origin]
    points, kept, neighbors = _denoised(given) if cloud.dimension == 2 else (given, np.arange(len(given)), 0)
    if neighbors:
        notes.append(f"the cloud is noisy: {len(kept)} of {len(given)} points, moved onto planes through {neighbors} neighbours, are used")
    origin = origin[kept]
    normals: Floats | None = None
    if cloud.dimension == 2 and points.shape[1] == 3 and len(points) >= 20:
        if cloud.normals is not None and not neighbors:
            normals = cloud.normals[origin]
        else:
            normals, seam = _oriented(points)
            if seam > 0.005:
                normals = None
                notes.append(f"normals could not be oriented ({100 * seam:.1f} % of neighbours disagree): near parts may join")
    for _ in range(5):
        ops = CloudOperators(PointCloud(points, dimension=cloud.dimension, normals=normals), "local_mesh", neighbors=None, progress=report)
        used = np.zeros(len(points), bool)
        used[ops.simplices.ravel()] = True
        if used.all():
            break
        points, origin = points[used], origin[used]
        normals = None if normals is None else normals[used]
    edges = _unique_edges(ops.simplices[:, [0, 1]] if cloud.dimension == 1 else _sides(ops.simplices))
    return _Complex(
        points,
        edges,
        edges,
        float(np.median(ops.point_spacing)),
        np.ascontiguousarray(ops.point_spacing),
        ops.stiffness,
        ops.mass,
        origin,
        given,
    )


# --- the function --------------------------------------------------------------------------------------------------------------------


def _first_function(complex_: _Complex, report: Any) -> tuple[Floats, Floats]:
    """φ_1 of a connected complex, and the eigenvalues. Of a multiple λ_1 the combination that changes most evenly.

    Evenly: the mean over the vertices of the logarithm of the mean squared slope around each is greatest, so that no part lies
    within one level.
    """
    count = min(7, len(complex_.mass))
    matrix = arrays.csr_in(complex_.stiffness, "the stiffness")
    pairs = _core.eigenpairs(matrix, complex_.mass, None, count, None, complex_.points, None, report)
    values = pairs[0][1:]
    copies = int((values <= MULTIPLE * values[0]).sum())
    space = pairs[1][:, 1 : 1 + copies]
    if copies == 1:
        return space[:, 0].copy(), values
    a, b = complex_.edges.T
    steps = complex_.points[a] - complex_.points[b]
    inverse = 1 / np.maximum(np.einsum("ed,ed->e", steps, steps), 1e-300)
    slopes, n = space[a] - space[b], len(space)
    degrees = np.maximum(np.bincount(a, minlength=n) + np.bincount(b, minlength=n), 1)
    products = np.empty((n, copies, copies))
    for i in range(copies):
        for j in range(i, copies):
            product = slopes[:, i] * slopes[:, j] * inverse
            products[:, i, j] = products[:, j, i] = (np.bincount(a, product, n) + np.bincount(b, product, n)) / degrees

    def score(weights: Floats) -> float:
        squares = np.einsum("nij,i,j->n", products, weights, weights)
        return float(np.log(np.maximum(squares, 0) + 1e-6 * squares.mean()).mean())

    if copies == 2:
        angles = np.arange(24) * np.pi / 24
        starts = np.stack([np.cos(angles), np.sin(angles)], 1)
    else:
        starts = np.random.default_rng(0).normal(size=(64, copies))
        starts /= np.linalg.norm(starts, axis=1, keepdims=True)
    scores = [score(start) for start in starts]
    best, top = starts[int(np.argmax(scores))], max(scores)
    step = 0.1
    while step > 0.01:
        moves = best + step * np.concatenate([np.eye(copies), -np.eye(copies)])
        moves /= np.linalg.norm(moves, axis=1, keepdims=True)
        scores = [score(move) for move in moves]
        if max(scores) > top + 1e-9:
            best, top = moves[int(np.argmax(scores))], max(scores)
        else:
            step /= 2
    found = space @ best
    return found * (1.0 if found[np.argmax(np.abs(found))] > 0 else -1.0), values


def _critical(faces: Ints, ranks: Indices) -> tuple[Indices, Indices, npt.NDArray[np.bool_]]:
    """Components of the lower and of the upper link of each vertex, and which vertices are in use.

    Banchoff's index of a vertex is 1 - edges down + triangles down, so that the sum over all is the Euler characteristic.
    """
    n = len(ranks)
    edges = _unique_edges(_sides(faces))
    a, b = ranks[edges].T
    high = np.where(a > b, edges[:, 0], edges[:, 1])
    low = np.where(a > b, edges[:, 1], edges[:, 0])
    down, up = np.bincount(high, minlength=n), np.bincount(low, minlength=n)
    order = np.take_along_axis(faces, np.argsort(ranks[faces], axis=1), 1)
    top, bottom = np.bincount(order[:, 2], minlength=n), np.bincount(order[:, 0], minlength=n)
    used = (down + up) > 0
    # a full circle has as many edges as vertices; a maximum's lower link is one component of this kind
    lower = np.where((down > 0) & (down == top), 1, down - top)
    upper = np.where((up > 0) & (up == bottom), 1, up - bottom)
    return lower, upper, used


# --- the Reeb graph ------------------------------------------------------------------------------------------------------------------


@dataclass
class _Branch:
    low: int  # regions at its ends
    high: int
    contours: list[int]  # groups of contours, from low to high


class _ReebGraph:
    """Contours and regions of one component, with what was merged; reduced to branches between joints."""

    def __init__(
        self, complex_: _Complex, values: Floats, ranks: Indices, cuts: Indices, levels: Floats, arcs: Floats, report: Any
    ) -> None:
        found = _core.contour_graph(
            np.ascontiguousarray(complex_.points),
            np.ascontiguousarray(complex_.cells, dtype=np.int32),
            values,
            ranks.astype(np.uint32),
            cuts.astype(np.uint32),
            levels,
            complex_.weights,
            report,
        )
        cut, below, above, self.points, self.weights, self.starts, region, self.regions = found
        self.cut, self.below, self.above = (np.asarray(part, np.int64) for part in (cut, below, above))
        self.region = np.asarray(region, np.int64)
        self.vertices, self.values = complex_.points, values
        self.arcs, self.levels = arcs, levels  # arc length along the function at each cut
        self.count = len(self.cut)
        self.owner = np.repeat(np.arange(self.count), np.diff(self.starts))
        self.weights = np.maximum(self.weights, 1e-12 * max(float(self.weights.max(initial=0.0)), 1e-300))
        self.contour_label, self.region_label = np.arange(self.count), np.arange(self.regions)
        self.reduce()

    def reduce(self) -> None:
        """Groups of contours with their barycentres and radii, and the branches."""
        roots, self.group = np.unique(self.contour_label, return_inverse=True)
        size = len(roots)
        self.group_cut = self.cut[roots]
        self.group_below, self.group_above = self.region_label[self.below[roots]], self.region_label[self.above[roots]]
        owner = self.group[self.owner]
        self.point_group = owner
        self.length = np.bincount(owner, self.weights, size)
        columns = [np.bincount(owner, self.weights * column, size) for column in self.points.T]
        self.centers = np.stack(columns, 1) / self.length[:, None]
        reach = np.linalg.norm(self.points - self.centers[owner], axis=1)
        self.radii = np.bincount(owner, self.weights * reach, size) / self.length
        self.arc = self.arcs[self.group_cut]
        regions = self.region_label[self.region]
        self.members = np.argsort(regions, kind="stable")
        self.bounds = np.searchsorted(regions[self.members], np.arange(self.regions + 1))
        up = np.bincount(self.group_below, minlength=self.regions)
        down = np.bincount(self.group_above, minlength=self.regions)
        regular = (up == 1) & (down == 1)
        following = np.full(self.regions, -1)
        following[self.group_below] = np.arange(size)
        self.branches: list[_Branch] = []
        for first in np.flatnonzero(~regular[self.group_below]).tolist():
            chain = [first]
            while regular[self.group_above[chain[-1]]]:
                chain.append(int(following[self.group_above[chain[-1]]]))
            self.branches.append(_Branch(int(self.group_below[first]), int(self.group_above[chain[-1]]), chain))

    def tip(self, region: int, group: int) -> Floats:
        """The point of a region that is farthest in value from the contour beside it."""
        inside = self.members[self.bounds[region] : self.bounds[region + 1]]
        if len(inside) == 0:
            center: Floats = self.centers[group]
            return center
        away = np.abs(self.values[inside] - self.levels[self.group_cut[group]])
        farthest: Floats = self.vertices[inside[int(away.argmax())]]
        return farthest

    def heights(self) -> dict[int, float]:
        """Arc length at each joint: midway between the contours below and those above it."""
        low: dict[int, float] = {}
        high: dict[int, float] = {}
        for branch in self.branches:
            first, last = float(self.arc[branch.contours[0]]), float(self.arc[branch.contours[-1]])
            high[branch.low] = min(high.get(branch.low, np.inf), first)
            low[branch.high] = max(low.get(branch.high, -np.inf), last)
        return {joint: (low.get(joint, high.get(joint, 0.0)) + high.get(joint, low.get(joint, 0.0))) / 2 for joint in {*low, *high}}

    def loops(self) -> list[tuple[float, int, int, int, int]]:
        """(height, top joint, bottom joint, branch down, other branch down) of a basis of the loops, by extended persistence."""
        height = self.heights()
        below, above = defaultdict(list), defaultdict(list)
        for number, branch in enumerate(self.branches):
            below[branch.high].append(number)
            above[branch.low].append(number)
        ordered = sorted(height, key=lambda joint: (-height[joint], joint))
        place = {joint: at for at, joint in enumerate(ordered)}
        found = []
        for top in ordered:
            down = below[top]
            if len(down) < 2:
                continue
            forest = _Forest(range(len(self.branches)))
            apart = {forest.root(number): number for number in down}
            for bottom in ordered[place[top] + 1 :]:
                here = below[bottom] + [number for number in above[bottom] if place[self.branches[number].high] >= place[top]]
                for number in here[1:]:
                    forest.join(here[0], number)
                now: dict[int, int] = {}
                for number in apart.values():
                    root = forest.root(number)
                    if root in now:
                        found.append((height[top] - height[bottom], top, bottom, now[root], number))
                    else:
                        now[root] = number
                apart = now
                if len(apart) == 1:
                    break
        return sorted(found)

    def path(self, top: int, bottom: int, start: int) -> list[int]:
        """Contour groups on the shortest way from a branch below ``top`` to ``bottom``, within their heights."""
        height = self.heights()
        around = defaultdict(list)
        for number, branch in enumerate(self.branches):
            if height[branch.low] >= height[bottom] and height[branch.high] <= height[top]:
                around[branch.low].append((number, branch.high))
                around[branch.high].append((number, branch.low))
        first = self.branches[start].low
        came: dict[int, tuple[int, int]] = {first: (start, top)}
        queue = [first]
        for joint in queue:
            if joint == bottom:
                break
            for number, other in around[joint]:
                if other not in came and other != top:
                    came[other] = (number, joint)
                    queue.append(other)
        if bottom not in came:
            return list(self.branches[start].contours)
        groups: list[int] = []
        joint = bottom
        while True:
            number, joint = came[joint]
            groups += self.branches[number].contours
            if joint == top:
                return groups

    def merge(self, groups: Sequence[int]) -> None:
        """Makes one contour of those of ``groups`` that belong to the same cut, and one region of those beside them."""
        contours, regions = _Forest(range(self.count)), _Forest(range(self.regions))
        for number, label in enumerate(self.contour_label.tolist()):
            contours.join(number, label)
        for number, label in enumerate(self.region_label.tolist()):
            regions.join(number, label)
        first: dict[int, int] = {}
        members = np.unique(self.contour_label)[np.asarray(groups, np.int64)]
        for contour in members.tolist():
            cut = int(self.cut[contour])
            other = first.setdefault(cut, contour)
            if other != contour:
                contours.join(other, contour)
                regions.join(int(self.below[other]), int(self.below[contour]))
                regions.join(int(self.above[other]), int(self.above[contour]))
        self.contour_label = np.array([contours.root(number) for number in range(self.count)])
        self.region_label = np.array([regions.root(number) for number in range(self.regions)])
        self.reduce()

    def opening(self, groups: Sequence[int]) -> float:
        """Largest angle, seen from their middle, without a point of the contours: below 1 for rings, above 1.7 for arcs."""
        chosen = np.isin(self.point_group, groups)
        points, weights = self.points[chosen], self.weights[chosen]
        if len(points) < 5:
            return 2 * np.pi
        around = points - weights @ points / weights.sum()
        axes = np.linalg.eigh(around.T @ around)[1][:, ::-1]
        angles = np.sort(np.arctan2(around @ axes[:, 1], around @ axes[:, 0]))
        return float(np.diff(angles, append=angles[0] + 2 * np.pi).max())

    def cancel_loops(self, spacing: float, step: float) -> list[float]:
        """Merges the loops that a cloud's sampling makes: their heights. See ``_spurious``."""
        heights: list[float] = []
        for _ in range(1000):
            for height, top, bottom, one, other in self.loops():
                first, second = self.path(top, bottom, one), self.path(top, bottom, other)
                shared = set(first) & set(second)
                first, second = [g for g in first if g not in shared], [g for g in second if g not in shared]
                if first and second and self._spurious(first, second, height, spacing, step):
                    self.merge([*first, *second])
                    heights.append(height)
                    break
            else:
                break
        return heights

    def _spurious(self, first: list[int], second: list[int], height: float, spacing: float, step: float) -> bool:
        """Whether two sides of a loop are no two tubes: one is thinner than the sampling shows, or an arc and no ring, or within the
        other, or the loop is but one level high and its sides touch."""
        radius = [float(np.median(self.radii[side])) for side in (first, second)]
        if min(radius) < 0.75 * spacing:
            return True
        level = (self.arc[first].min() + self.arc[first].max()) / 2
        middle = [min(side, key=lambda group: (abs(self.arc[group] - level), group)) for side in (first, second)]
        apart = float(np.linalg.norm(self.centers[middle[0]] - self.centers[middle[1]]))
        if apart < 1.05 * sum(self.radii[middle]):
            return True
        if height < 1.5 * step and apart < 1.6 * sum(self.radii[middle]):
            return True
        return max(self.opening([middle[0]]), self.opening([middle[1]])) > 1.8


class _Forest:
    """Disjoint sets; the lesser element stands for the set."""

    def __init__(self, members: Any) -> None:
        self.parents = {member: member for member in members}

    def root(self, member: int) -> int:
        while self.parents[member] != member:
            self.parents[member] = member = self.parents[self.parents[member]]
        return member

    def join(self, a: int, b: int) -> bool:
        """False if they were together already."""
        a, b = self.root(a), self.root(b)
        self.parents[max(a, b)] = min(a, b)
        return a != b


def _levels(values: Floats, complex_: _Complex) -> tuple[Floats, Floats, Callable[[Floats], Floats]]:
    """Levels a spacing apart, at most ``LEVELS``; the function that turns a level into arc length from the minimum.

    The slope at a level is the mean over the edges there: g² = 2 mean((df / d)²), as edges point in all directions.
    """
    low, high = float(values.min()), float(values.max())
    a, b = complex_.edges.T
    steps = complex_.points[a] - complex_.points[b]
    squares = (values[a] - values[b]) ** 2 / np.maximum(np.einsum("ed,ed->e", steps, steps), 1e-300)
    bins = 256
    count, total = np.zeros(bins), np.zeros(bins)
    for level in (values[a], values[b], (values[a] + values[b]) / 2):
        place = np.minimum(((level - low) / (high - low) * bins).astype(np.int64), bins - 1)
        count += np.bincount(place, minlength=bins)
        total += np.bincount(place, squares, bins)
    known = np.flatnonzero(count)
    slope = np.sqrt(2 * np.interp(np.arange(bins), known, total[known] / count[known]))
    slope = np.maximum(slope, 1e-6 * slope.max())
    grid = np.linspace(low, high, bins + 1)
    arc = np.concatenate([[0.0], np.cumsum((high - low) / bins / slope)])
    number = int(np.clip(round(arc[-1] / complex_.spacing), 8, LEVELS))
    wanted = (np.arange(number) + 0.5) * (arc[-1] / number)
    return np.interp(wanted, arc, grid), np.array([arc[-1], arc[-1] / number]), lambda level: np.interp(level, grid, arc)


def _reeb_graph(complex_: _Complex, values: Floats, report: Any) -> tuple[_ReebGraph, float, float, tuple[int, int, int]]:
    """The graph, the arc length of the function, the distance of levels, and the numbers of minima, saddles and maxima (meshes)."""
    n = len(values)
    order = np.lexsort((np.arange(n), values))
    ranks = np.empty(n, np.int64)
    ranks[order] = np.arange(n)
    ascending = values[order]
    levels, (length, step), arc = _levels(values, complex_)
    cuts = np.searchsorted(ascending, levels, side="right")
    keep = (cuts > 0) & (cuts < n) & (np.diff(cuts, prepend=0) > 0)
    cuts, levels = cuts[keep], levels[keep]
    counts = (0, 0, 0)
    if complex_.is_mesh:
        lower, upper, used = _critical(complex_.cells, ranks)
        counts = (int((used & (lower == 0)).sum()), int(np.maximum(lower - 1, 0).sum()), int((used & (upper == 0)).sum()))
        special = np.sort(ranks[used & ((lower != 1) | (upper != 1))])
        if len(special) > 1:  # a cut between any two critical vertices
            low, high = special[:-1], special[1:]
            missing = np.searchsorted(cuts, high, side="right") == np.searchsorted(cuts, low, side="right")
            extra = ((low + high + 1) // 2)[missing]
            cuts = np.concatenate([cuts, extra])
            levels = np.concatenate([levels, 0.5 * ascending[extra - 1] + 0.5 * ascending[extra]])
            by_cut = np.argsort(cuts, kind="stable")
            cuts, levels = cuts[by_cut], levels[by_cut]
    graph = _ReebGraph(complex_, values, ranks, cuts, levels, arc(levels), report)
    return graph, float(length), float(step), counts


# --- simplification --------------------------------------------------------------------------------------------------------------------


@dataclass
class _Limb:
    """A branch of the simplified graph: its ends, and its groups of contours from the first end to the second."""

    ends: list[int]
    groups: list[int]


class _Simplified:
    """The Reeb graph without stubs. ``home`` says for each group whose branch fell to which joint."""

    def __init__(self, graph: _ReebGraph) -> None:
        self.graph = graph
        self.limbs = [_Limb([branch.low, branch.high], list(branch.contours)) for branch in graph.branches]
        self.fallen: dict[int, list[int]] = defaultdict(list)  # joint: groups of limbs cut there
        self.stray: list[tuple[int, int]] = []  # groups of limbs cut where no joint is left, and the group beside them
        self.cut: list[float] = []
        self.join()

    def degrees(self) -> dict[int, int]:
        degree: dict[int, int] = defaultdict(int)
        for limb in self.limbs:
            degree[limb.ends[0]] += 1
            degree[limb.ends[1]] += 1
        return degree

    def join(self) -> None:
        """Makes one limb of the two at each joint of two; a limb that is a loop keeps its joint."""
        while True:
            at: dict[int, list[_Limb]] = defaultdict(list)
            for limb in self.limbs:
                at[limb.ends[0]].append(limb)
                at[limb.ends[1]].append(limb)
            joint = next((joint for joint, limbs in sorted(at.items()) if len(limbs) == 2 and limbs[0] is not limbs[1]), None)
            if joint is None:
                return
            first, second = at[joint]
            if first.ends[1] != joint:
                first = _Limb(first.ends[::-1], first.groups[::-1])
            if second.ends[0] != joint:
                second = _Limb(second.ends[::-1], second.groups[::-1])
            fallen = self.fallen.pop(joint, [])
            self.limbs = [limb for limb in self.limbs if limb is not at[joint][0] and limb is not at[joint][1]]
            whole = _Limb([first.ends[0], second.ends[1]], first.groups + second.groups)
            self.limbs.append(whole)
            if fallen:
                self.stray.extend((group, first.groups[-1]) for group in fallen)

    def reach(self, limb: _Limb, end: int) -> tuple[float, float]:
        """Length of a limb from its root to the tip at ``end``, and how many times farther the tip is than the root is wide."""
        graph = self.graph
        groups = limb.groups if end == 1 else limb.groups[::-1]
        x, root = graph.centers[groups], groups[0]
        tip = graph.tip(limb.ends[end], groups[-1])
        length = float(np.linalg.norm(np.diff(x, axis=0), axis=1).sum() + np.linalg.norm(tip - x[-1]))
        return length, float(np.linalg.norm(tip - x[0]) / max(graph.radii[root], 1e-300))

    def prune(self, shortest: float) -> None:
        """Cuts limbs that end, the shortest first: those below ``shortest``, and those less than ``LIMB`` times as long as wide."""
        while True:
            degree = self.degrees()
            worst: tuple[float, float, int, int] | None = None
            for number, limb in enumerate(self.limbs):
                if (degree[limb.ends[0]] == 1) == (degree[limb.ends[1]] == 1):
                    continue  # inner, or all there is
                end = 0 if degree[limb.ends[0]] == 1 else 1
                length, ratio = self.reach(limb, end)
                if (length < shortest or ratio < LIMB) and (worst is None or length < worst[0]):
                    worst = (length, ratio, number, end)
            if worst is None:
                return
            limb = self.limbs.pop(worst[2])
            self.cut.append(worst[1])
            self.fallen[limb.ends[1 - worst[3]]] += limb.groups
            self.join()

    def contract(self) -> None:
        """Makes one joint of two whose branch is shorter than it is wide."""
        graph = self.graph
        while True:
            degree = self.degrees()
            pairs: dict[tuple[int, int], int] = defaultdict(int)
            for limb in self.limbs:
                pairs[min(limb.ends), max(limb.ends)] += 1
            shortest: tuple[float, int] | None = None
            for number, limb in enumerate(self.limbs):
                a, b = limb.ends
                if min(degree[a], degree[b]) < 3 or a == b or pairs[min(a, b), max(a, b)] > 1:
                    continue
                length = float(np.ptp(graph.arc[limb.groups]))
                ratio = length / float(np.median(graph.radii[limb.groups]))
                if ratio < 1.5 and (shortest is None or ratio < shortest[0]):
                    shortest = (ratio, number)
            if shortest is None:
                return
            limb = self.limbs.pop(shortest[1])
            a, b = limb.ends
            self.fallen[a] += limb.groups + self.fallen.pop(b, [])
            for other in self.limbs:
                other.ends = [a if end == b else end for end in other.ends]


# --- drawing along the middle ----------------------------------------------------------------------------------------------------------


@dataclass
class _Drawing:
    """Nodes of one component: limbs are chains of node numbers, joints and tips included."""

    nodes: Floats
    radii: Floats
    chains: list[list[int]]
    node_of_group: Indices


def _draw(simple: _Simplified, spacing: float) -> _Drawing:
    """Chooses the contours that become nodes: not those bent by a joint nor those at the very tip, and not too dense."""
    graph = simple.graph
    centers, radii = graph.centers, graph.radii
    degree = simple.degrees()
    at: dict[int, list[tuple[_Limb, bool]]] = defaultdict(list)
    for limb in simple.limbs:
        at[limb.ends[0]].append((limb, True))
        at[limb.ends[1]].append((limb, False))
    typical = {id(limb): float(np.median(radii[limb.groups])) for limb in simple.limbs}
    place: dict[int, Floats] = {}
    ball: dict[int, float] = {}
    for joint, limbs in at.items():
        near = [limb.groups[0] if first else limb.groups[-1] for limb, first in limbs]
        place[joint] = np.average(centers[near], axis=0, weights=graph.length[near])
        ball[joint] = max(typical[id(limb)] for limb, _ in limbs)
    nodes: list[Floats] = []
    widths: list[float] = []
    number: dict[int, int] = {}
    node_of_group = np.full(len(centers), -1)
    chains = []
    for joint in sorted(at):
        if degree[joint] > 2:
            number[joint] = len(nodes)
            nodes.append(place[joint])
            widths.append(ball[joint])
    for limb in simple.limbs:
        groups = np.asarray(limb.groups)
        x, width = centers[groups], typical[id(limb)]
        travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
        total = float(travelled[-1])
        allowed = np.ones(len(groups), bool)
        for end, joint in enumerate(limb.ends):
            if degree[joint] > 2:
                allowed &= np.linalg.norm(x - place[joint], axis=1) > 0.9 * min(ball[joint], max(0.45 * total, width))
            elif degree[joint] == 1:
                ahead = travelled if end == 0 else total - travelled
                tip = min(float(np.median(radii[groups])), 0.4 * total)
                allowed &= ahead >= tip
        if degree[limb.ends[0]] > 2 or degree[limb.ends[1]] > 2:
            allowed &= radii[groups] < 1.5 * width
        need = 3 if limb.ends[0] == limb.ends[1] else 2 if min(degree[end] for end in limb.ends) == 1 else 1
        if allowed.sum() < need:
            middle = np.argsort(np.abs(travelled - total / 2), kind="stable")
            allowed[middle[: max(need, 1)]] = True
        chosen: list[int] = []
        for k in np.flatnonzero(allowed).tolist():
            if not chosen or travelled[k] - travelled[chosen[-1]] >= max(0.3 * width, 0.5 * spacing) or allowed[: k + 1].sum() <= need:
                chosen.append(k)
        last = int(np.flatnonzero(allowed)[-1])
        if degree[limb.ends[1]] == 1 and chosen[-1] != last:
            if len(chosen) > need:
                chosen[-1] = last
            else:
                chosen.append(last)
        numbers = list(range(len(nodes), len(nodes) + len(chosen)))
        nodes += list(x[chosen])
        widths += radii[groups[chosen]].tolist()
        nearest = np.abs(np.arange(len(groups))[:, None] - np.asarray(chosen)).argmin(1)
        node_of_group[groups] = np.asarray(numbers)[nearest]
        head = [number[limb.ends[0]]] if limb.ends[0] in number else []
        tail = [number[limb.ends[1]]] if limb.ends[1] in number else []
        chain = head + numbers + tail
        if not head and not tail and limb.ends[0] == limb.ends[1]:
            chain = [*numbers, numbers[0]]
        chains.append(chain)
    for joint, fallen in simple.fallen.items():
        home = number.get(joint)
        if home is None:  # a joint of a loop: the nearest end of its limb
            limb, first = at[joint][0]
            home = int(node_of_group[limb.groups[0] if first else limb.groups[-1]])
        node_of_group[np.asarray(fallen, np.int64)] = home
    for group, beside in simple.stray:
        node_of_group[group] = node_of_group[beside]
    return _Drawing(np.array(nodes), np.array(widths), chains, node_of_group)


def _smooth(x: Floats, widths: Floats, closed: bool, factor: float) -> tuple[Floats, Floats]:
    """Positions and tangents of a polyline by local quadratic fits, Gaussian weights of ``factor`` times the radius."""
    count = len(x)
    if count < 3:
        tangents = np.repeat((x[-1] - x[0])[None], count, axis=0)
        return x.copy(), tangents / max(float(np.linalg.norm(tangents[0])), 1e-300)
    steps = np.linalg.norm(np.diff(x, axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    apart = travelled[None] - travelled[:, None]
    if closed:
        turn = travelled[-1] + float(np.linalg.norm(x[0] - x[-1]))
        apart = (apart + turn / 2) % turn - turn / 2
    near = np.sort(np.abs(apart), axis=1)[:, min(3, count - 1)]
    sigma = np.maximum(factor * widths, 0.7 * near)[:, None]
    weights = np.exp(-0.5 * (apart / sigma) ** 2)
    scaled = apart / sigma
    moments = np.stack([(weights * scaled**power).sum(1) for power in range(5)], 1)
    matrix = np.stack([moments[:, [0, 1, 2]], moments[:, [1, 2, 3]], moments[:, [2, 3, 4]]], 1) + 1e-9 * np.eye(3)
    right = np.stack([(weights * scaled**power) @ x for power in range(3)], 1)
    fit = np.linalg.solve(matrix, right)
    tangents = fit[:, 1]
    return fit[:, 0], tangents / np.maximum(np.linalg.norm(tangents, axis=1), 1e-300)[:, None]


def _frames(tangents: Floats) -> tuple[Floats, Floats]:
    axis = np.eye(3)[np.abs(tangents).argmin(1)]
    u = np.cross(tangents, axis)
    u /= np.maximum(np.linalg.norm(u, axis=1), 1e-300)[:, None]
    return u, np.cross(tangents, u)


class _Section:
    """Distances from nodes to the surface in the planes across the skeleton, in ``DIRECTIONS`` directions; NaN where there is none."""

    def __init__(self, complex_: _Complex, drawing: _Drawing, owners: Indices, shape: Shape) -> None:
        self.mesh = shape if isinstance(shape, TriangleMesh) else None
        self.sources, self.owners, self.spacing = complex_.sources, owners, complex_.spacing
        self.turn = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
        if self.mesh is not None:
            corners = self.mesh.vertices[self.mesh.faces]
            self.normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            self.side = 1.0 if np.einsum("md,md->", self.normals, corners[:, 0] - corners[:, 0].mean(0)) >= 0 else -1.0

    def __call__(self, x: Floats, tangents: Floats, widths: Floats, limb: Sequence[int]) -> tuple[Floats, Floats, Floats]:
        u, v = _frames(tangents)
        directions = np.cos(self.turn)[None, :, None] * u[:, None] + np.sin(self.turn)[None, :, None] * v[:, None]
        if self.mesh is not None:
            return self._rays(x, directions), u, v
        return self._sectors(x, tangents, u, v, widths, limb), u, v

    def _rays(self, x: Floats, directions: Floats) -> Floats:
        assert self.mesh is not None
        count = len(x)
        flat = directions.reshape(-1, 3)
        hits = intersect_rays(self.mesh, np.repeat(x, DIRECTIONS, axis=0), flat)
        outward = self.side * np.einsum("rd,rd->r", self.normals[hits.faces], flat) > 0
        distances = np.where((hits.faces >= 0) & outward, hits.distances, np.nan)
        return distances.reshape(count, DIRECTIONS)

    def _sectors(self, x: Floats, tangents: Floats, u: Floats, v: Floats, widths: Floats, limb: Sequence[int]) -> Floats:
        points = self.sources[np.isin(self.owners, limb)]
        distances = np.full((len(x), DIRECTIONS), np.nan)
        for node in range(len(x)):
            offset = points - x[node]
            height = offset @ tangents[node]
            thick = max(0.35 * widths[node], self.spacing)
            offset, height = offset[np.abs(height) < thick], height[np.abs(height) < thick]
            a, b = offset @ u[node], offset @ v[node]
            reach = np.hypot(a, b)
            near = reach < 2.5 * widths[node]
            if near.sum() < 6:
                continue
            a, b, reach = a[near], b[near], reach[near]
            # each direction sees the points within a bump of two sectors: few points a contour
            angle = np.arctan2(b, a)
            bump = np.cos(angle[None] - self.turn[:, None])
            bump = np.exp(24.0 * (bump - 1.0))
            total = bump.sum(1)
            with np.errstate(all="ignore"):
                distances[node] = np.where(total > 0.5, bump @ reach / total, np.nan)
        return distances


def _center(drawing: _Drawing, section: _Section | None, noisy: bool, rounds: int = 6) -> None:
    """Moves nodes to the middle of the sections across the skeleton, and joints to where their limbs point."""
    ends: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for at, chain in enumerate(drawing.chains):
        ends[chain[0]].append((at, 0))
        ends[chain[-1]].append((at, 1))
    joints = [node for node, limbs in ends.items() if len(limbs) > 2]
    fixed = np.zeros(len(drawing.nodes), bool)
    fixed[joints] = True
    for _ in range(rounds):
        for chain in drawing.chains:
            closed = len(chain) > 3 and chain[0] == chain[-1] and not fixed[chain[0]]
            numbers = np.asarray(chain[:-1] if closed else chain)
            x, widths = drawing.nodes[numbers], drawing.radii[numbers]
            smooth, tangents = _smooth(x, widths, closed, 0.6)
            free = ~fixed[numbers]
            if section is None:
                drawing.nodes[numbers[free]] = smooth[free]
                continue
            start = smooth if noisy else x
            distances, u, v = section(start[free], tangents[free], widths[free], chain)
            absent = np.isnan(distances).sum(1) / DIRECTIONS
            typical = np.asarray(np.nanmedian(np.where((absent == 1)[:, None], 0.0, distances), axis=1))
            good: npt.NDArray[np.bool_] = (absent < 0.4) & (typical > 0)
            bounded = np.minimum(distances, 2.2 * typical[:, None])
            bounded = np.where(np.isnan(bounded), typical[:, None], bounded)
            turn = section.turn
            shift = (bounded @ np.cos(turn) / DIRECTIONS)[:, None] * u + (bounded @ np.sin(turn) / DIRECTIONS)[:, None] * v
            moved = start[free]
            moved[good] += shift[good]
            moved[~good] = smooth[free][~good]
            drawing.nodes[numbers[free]] = moved
            fresh = drawing.radii[numbers[free]]
            fresh[good] = bounded.mean(1)[good]
            drawing.radii[numbers[free]] = fresh
        for joint in joints:
            _place_joint(drawing, joint, ends[joint])
    if noisy:
        for chain in drawing.chains:
            closed = len(chain) > 3 and chain[0] == chain[-1] and not fixed[chain[0]]
            numbers = np.asarray(chain[:-1] if closed else chain)
            smooth, _ = _smooth(drawing.nodes[numbers], drawing.radii[numbers], closed, 0.8)
            free = ~fixed[numbers]
            drawing.nodes[numbers[free]] = smooth[free]


def _place_joint(drawing: _Drawing, joint: int, limbs: list[tuple[int, int]]) -> None:
    """Where the straight continuations of the limbs come nearest to each other."""
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    width = drawing.radii[joint]
    anchors = []
    for at, end in limbs:
        chain = drawing.chains[at] if end == 0 else drawing.chains[at][::-1]
        near = np.asarray([node for node in chain[1:] if node != joint])
        if len(near) == 0:
            continue
        anchors.append(drawing.nodes[near[0]])
        if len(near) < 2:
            continue
        reach = np.linalg.norm(drawing.nodes[near] - drawing.nodes[near[0]], axis=1)
        keep = near[: max(2, int((np.cumsum(reach > 2.0 * drawing.radii[near[0]]) == 0).sum()))]
        points = drawing.nodes[keep]
        middle = points.mean(0)
        direction = np.linalg.svd(points - middle)[2][0]
        across = np.eye(3) - np.outer(direction, direction)
        matrix += across
        right += across @ middle
    if not anchors:
        return
    center = np.mean(anchors, axis=0)
    matrix += 0.03 * np.eye(3)
    right += 0.03 * center
    found = np.linalg.solve(matrix, right)
    away = found - center
    length = float(np.linalg.norm(away))
    drawing.nodes[joint] = center + away * min(1.0, 1.5 * width / max(length, 1e-300))


# --- the result ------------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class SkeletonResult:
    """A graph along the middle of a shape, and what belongs to each node of it.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
    nodes : ndarray (k, D)
        Positions, in units of length.
    edges : ndarray (e, 2) of int32
        Pairs of nodes; no edge twice, none from a node to itself.
    radii : ndarray (k,)
        Mean distance of the surface from each node, across the skeleton.
    leaves, cycles : int
        Nodes of one edge, and independent loops. On closed meshes the loops are the handles: exactly, before ``cancelled``.
    node_of_point : ndarray (n,) of int32
        The node that each vertex or point belongs to.
    limbs : list of ndarray of int32
        Chains of nodes from joint or tip to joint or tip; a closed loop repeats its first node.
    limb_of_node : ndarray (k,) of int32
        The limb that each node lies on; of a joint the first.
    components : ndarray (k,) of int32
        The connected piece of the shape that each node belongs to.
    contours : list of ndarray (c, D)
        Points of the level set that each node stands for, in order around it; empty at some joints.
    function : ndarray (n,)
        What the levels are of.
    eigenvalues : ndarray
        The first eigenvalues of the (first) piece if the function is an eigenfunction; else empty.
    critical : tuple of int
        Minima, saddles (with multiplicity) and maxima of the function. On closed meshes minima - saddles + maxima is the Euler
        characteristic; (0, 0, 0) for clouds.
    cut : ndarray
        How many times longer than wide each limb was that was too short to keep.
    cancelled : ndarray
        Height of each loop that was ascribed to the sampling of a cloud, in units of length along the function.
    stability : tuple of float
        The greatest height of a cancelled loop and the least of one that is kept: the number of loops is the same for every
        threshold between. ``(0, inf)`` for trees in which nothing was cancelled.
    notes : tuple of str
        What is worth knowing: pieces left out, noise, multiple eigenvalues.
    """

    shape: Shape
    nodes: Floats
    edges: Ints
    radii: Floats
    leaves: int
    cycles: int
    node_of_point: Ints
    limbs: list[Ints]
    limb_of_node: Ints
    components: Ints
    contours: list[Floats]
    function: Floats
    eigenvalues: Floats
    critical: tuple[int, int, int]
    cut: Floats
    cancelled: Floats
    stability: tuple[float, float]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"SkeletonResult({len(self.nodes)} nodes, {len(self.limbs)} limbs, {self.leaves} leaves, {self.cycles} cycles)"

    @property
    def degrees(self) -> Ints:
        """(k,): how many edges each node has."""
        return np.bincount(self.edges.ravel(), minlength=len(self.nodes)).astype(np.int32)

    @property
    def lengths(self) -> Floats:
        """Length of each limb along its nodes, in units of length."""
        return np.array([np.linalg.norm(np.diff(self.nodes[limb], axis=0), axis=1).sum() for limb in self.limbs])

    @property
    def limb_of_point(self) -> Ints:
        """(n,): the limb of each vertex or point: a segmentation of the shape."""
        return self.limb_of_node[self.node_of_point]

    def polylines(self, steps: int = 4) -> list[Floats]:
        """Each limb as a smooth curve through its nodes (Catmull-Rom splines), ``steps`` segments an edge.

        Examples
        --------
        >>> import beltrami as bt
        >>> [len(line) > 20 for line in bt.skeleton(bt.shapes.torus()).polylines()]
        [True]
        """
        steps = arrays.whole(steps, "steps", 1)
        share = (np.arange(steps) / steps)[None, :, None]
        lines = []
        for limb in self.limbs:
            x = self.nodes[limb]
            closed = limb[0] == limb[-1]
            before = np.concatenate([x[-2:-1] if closed else 2 * x[:1] - x[1:2], x[:-2]])[:, None]
            after = np.concatenate([x[2:], x[1:2] if closed else 2 * x[-1:] - x[-2:-1]])[:, None]
            a, b = x[:-1, None], x[1:, None]
            curve = a + 0.5 * share * (b - before + share * (2 * before - 5 * a + 4 * b - after + share * (3 * a - 3 * b + after - before)))
            lines.append(np.concatenate([curve.reshape(-1, x.shape[1]), x[-1:]]))
        return lines

    def to_networkx(self) -> Any:
        """A ``networkx.Graph``: nodes with ``position``, ``radius``, ``component``; edges with ``length``.

        Raises
        ------
        DependencyError
            networkx is not installed.
        """
        try:
            import networkx
        except ImportError:
            from .errors import DependencyError

            raise DependencyError("to_networkx needs the package networkx: pip install networkx") from None
        graph = networkx.Graph()
        for node, (x, radius, piece) in enumerate(zip(self.nodes, self.radii, self.components, strict=True)):
            graph.add_node(node, position=tuple(x.tolist()), radius=float(radius), component=int(piece))
        lengths = np.linalg.norm(self.nodes[self.edges[:, 0]] - self.nodes[self.edges[:, 1]], axis=1)
        for (a, b), length in zip(self.edges.tolist(), lengths.tolist(), strict=True):
            graph.add_edge(a, b, length=length)
        return graph

    def plot(self, *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints the skeleton inside the transparent shape; the options are those of :func:`beltrami.plot`."""
        from .view import plot

        drawn = {
            "lines": self.polylines(),
            "points": self.nodes[self.degrees != 2] if (self.degrees != 2).any() else None,
            "transparency": 0.75,
            "color": "#b9c4d0",
            **options,
        }
        if isinstance(self.shape, PointCloud) and "radius" not in options:
            distances = nearest_neighbors(self.shape.points, self.shape.points[:: max(1, len(self.shape.points) // 500)], 7)[1]
            drawn["radius"] = 0.2 * float(np.median(distances[:, -1]))
        return plot(self.shape, path=path, **drawn)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the graph: ``.swc`` (trees), ``.obj`` with lines, ``.npz`` with everything; a picture to ``.png`` or ``.html``.

        Raises
        ------
        TopologyError
            A graph with loops cannot be written to SWC, which knows one parent a node.
        InputError
            The suffix is none of these, or points of R^D with D other than 3 are to go to ``.swc`` or ``.obj``.
        FileError
            The file cannot be written.
        """
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix in (".png", ".html"):
            self.plot(path=path)
            return path
        if suffix not in (".swc", ".obj", ".npz"):
            raise InputError(f"{path}: a skeleton is written to .swc, .obj, .npz, .png or .html")
        if suffix != ".npz" and self.nodes.shape[1] != 3:
            raise InputError(f"{path}: {suffix} holds points of R^3, these lie in R^{self.nodes.shape[1]}; write .npz")
        try:
            if suffix == ".npz":
                np.savez_compressed(
                    path,
                    nodes=self.nodes,
                    edges=self.edges,
                    radii=self.radii,
                    node_of_point=self.node_of_point,
                    limb_of_node=self.limb_of_node,
                    components=self.components,
                    function=self.function,
                    limbs=np.concatenate(self.limbs),
                    limb_starts=np.cumsum([0, *map(len, self.limbs)]),
                    contours=np.concatenate(self.contours),
                    contour_starts=np.cumsum([0, *map(len, self.contours)]),
                )
            else:
                path.write_text("\n".join(self._swc(path) if suffix == ".swc" else self._obj()) + "\n", encoding="ascii")
        except OSError as error:
            raise FileError(f"{path} cannot be written: {error.strerror or error}") from None
        return path

    def _obj(self) -> list[str]:
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in self.nodes.tolist()]
        return lines + ["l " + " ".join(str(node + 1) for node in limb.tolist()) for limb in self.limbs]

    def _swc(self, path: Path) -> list[str]:
        if self.cycles:
            raise TopologyError(f"{path}: SWC holds trees and this skeleton has {self.cycles} cycles; write .obj or .npz")
        size = len(self.nodes)
        tree = sparse.coo_array((np.ones(len(self.edges)), (self.edges[:, 0], self.edges[:, 1])), shape=(size, size)).tocsr()
        lines, number = ["# id type x y z radius parent"], {-9999: -1}
        kinds = {1: 6, 2: 0}  # 6: end point, 5: fork point, 0: undefined
        for piece in np.unique(self.components):
            members = np.flatnonzero(self.components == piece)
            root = members[np.argmax(self.radii[members])]
            order, parents = breadth_first_order(tree, root, directed=False)
            for node in order.tolist():
                number[node] = len(number)
                x, y, z = self.nodes[node].tolist()
                kind = kinds.get(int(self.degrees[node]), 5)
                lines.append(f"{number[node]} {kind} {x!r} {y!r} {z!r} {float(self.radii[node])!r} {number[int(parents[node])]}")
        return lines


# --- the method ------------------------------------------------------------------------------------------------------------------------


def skeleton(
    shape: Shape | Operators,
    *,
    function: npt.ArrayLike | Literal["eigenfunction", "geodesic"] | None = None,
    source: int | None = None,
    components: bool = True,
    shortest_limb: float = 0.04,
    remove_outliers: bool = False,
    progress: Progress = None,
) -> SkeletonResult:
    """The skeleton of a shape: the Reeb graph of its first eigenfunction, drawn along its middle.

    The first nontrivial eigenfunction of the Laplace-Beltrami operator runs along a shape from end to end. Its level sets, split into
    connected pieces, are rings around limbs; their barycentres are nodes, and neighbouring rings are joined. So the graph branches
    and closes loops as the shape does.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        A surface. Clouds may be noisy (a note says what was done about it); thin parts near each other are told apart by normals, which
        are found if the cloud has none.
    function : array_like (n,), "eigenfunction" or "geodesic", optional
        Another function: a height, a distance. "geodesic" is the distance from ``source``.
    source : int, optional
        Vertex for ``function="geodesic"``; without it where the first eigenfunction is greatest.
    components : bool
        Whether a shape may have several connected pieces: each gets its own skeleton.
    shortest_limb : float
        Limbs that end and are shorter than this share of the length of the function (how far it runs from its minimum to its maximum)
        are cut; those less than 1.4 times as long as wide always are. They are counted in ``cut``.
    remove_outliers : bool
        Leave out points of a cloud that are much farther from their neighbours than others are (beyond the mean and four deviations).
    progress : callable or True, optional
        Called with the share of work done; returning False stops with :class:`Cancelled`.

    Returns
    -------
    SkeletonResult

    Raises
    ------
    InputError
        Too few points, a constant function, numbers that are not finite, or no surface.
    TopologyError
        The shape has several pieces and ``components=False``.

    Notes
    -----
    On meshes the graph is exact: vertices are ordered by value and then by number, and there is a level between any two critical
    vertices, so that the loops are the handles of a closed oriented surface. Limbs are cut by length, loops never. On clouds loops
    that the sampling makes are cancelled: one side thinner than the sampling shows, or an arc and no ring. ``cancelled`` and
    ``stability`` say how sure that is.

    Where eigenvalues up to 15 % above the first make a multiple one, the combination is taken whose slope varies least over the
    surface, and a note says so.

    References
    ----------
    Lai and Zhao, Multiscale nonrigid point cloud registration using rotation-invariant sliced-Wasserstein distance via
    Laplace-Beltrami eigenmap, 2017; Lai, Liang and Zhao, A local mesh method for solving PDEs on point clouds, 2013 (skeletons by level
    sets of eigenfunctions). Agarwal, Edelsbrunner, Harer and Wang, Extreme elevation on a 2-manifold, 2006 (extended persistence).

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.skeleton(bt.shapes.torus()).cycles
    1
    """
    report = reporter(progress, "skeleton")
    shortest_limb = arrays.number(shortest_limb, "shortest_limb", least=0.0)
    notes: list[str] = []
    given = shape.shape if isinstance(shape, Operators) else shape
    if not isinstance(given, TriangleMesh | PointCloud):
        raise InputError(f"shape is a {type(given).__name__}; a TriangleMesh, a PointCloud or Operators is needed (bt.load makes them)")
    count = len(given.points) if isinstance(given, PointCloud) else len(given.vertices)
    if count < 10:
        raise InputError(f"{count} points are too few for a skeleton; 10 or more are needed")
    values = _values(given, function, source, count, report)
    if isinstance(given, PointCloud):
        if given.dimension != 2:
            raise InputError(f"skeletons are made of surfaces; this cloud has dimension {given.dimension}")
        cloud, chosen = given, np.arange(count)
        if remove_outliers:
            chosen = _inliers(given.points)
            notes.append(f"{count - len(chosen)} outliers were left out")
            normals = None if given.normals is None else given.normals[chosen]
            cloud = PointCloud(given.points[chosen], dimension=2, normals=normals)
        complex_ = _cloud_complex(cloud, notes, part(report, 0.0, 0.4))
        complex_.origin = chosen[complex_.origin]
    else:
        complex_ = _mesh_complex(operators(shape))
    labels = _pieces(complex_, components, notes)
    parts = []
    function_out = np.zeros(count) if values is None else values
    eigenvalues = np.zeros(0)
    for name in range(int(labels.max()) + 1):
        members = np.flatnonzero(labels == name)
        piece = complex_ if len(members) == len(labels) else _restricted(complex_, members)
        if values is None:
            f, found = _first_function(piece, part(report, 0.4, 0.7))
            if name == 0:
                eigenvalues = found
            copies = int((found <= MULTIPLE * found[0]).sum())
            if copies > 1:
                gap = found[copies - 1] / found[0] - 1
                notes.append(f"the first {copies} eigenvalues lie within {100 * gap:.1g} %: their most even combination is taken")
            function_out[piece.origin] = f
        else:
            f = np.ascontiguousarray(values[piece.origin])
        if not np.ptp(f) > 0:
            raise InputError("the function is constant on a connected piece of the shape; hand in one that varies")
        parts.append(_one(piece, f, given, shortest_limb, part(report, 0.7, 0.9)))
    return _assembled(given, complex_, labels, parts, function_out, eigenvalues, notes)


def _values(given: Shape, function: Any, source: int | None, count: int, report: Any) -> Floats | None:
    if isinstance(function, str):
        if function not in ("eigenfunction", "geodesic"):
            raise InputError(f"function is {function!r}; choose 'eigenfunction', 'geodesic' or give an array")
        if function == "geodesic":
            from .geodesic import geodesic_distance

            if source is None:
                ops = operators(given)
                source = int(np.argmax(eigenpairs(ops, 2).functions[:, 1]))
            values = geodesic_distance(given, arrays.whole(source, "source", 0, count - 1))
            if not np.isfinite(values).all():
                raise TopologyError("distances are infinite on pieces without the source; hand in a function, or one piece")
            return values
        function = None
    if source is not None:
        raise InputError("source= goes with function='geodesic'")
    return None if function is None else arrays.floats(function, "function", (count,))


def _inliers(points: Floats) -> Indices:
    distances = nearest_neighbors(points, points, min(9, len(points)))[1][:, 1:].mean(1)
    return np.flatnonzero(distances <= distances.mean() + 4 * distances.std())


def _pieces(complex_: _Complex, components: bool, notes: list[str]) -> Indices:
    """Number of the piece of each point; -1 in no piece, or in one too small to be more than a stray of a cloud."""
    n = len(complex_.points)
    a, b = complex_.edges.T
    graph = sparse.coo_array((np.ones(len(a)), (a, b)), shape=(n, n))
    number, labels = connected_components(graph, directed=False)
    sizes = np.bincount(labels, minlength=number)
    least = 4 if complex_.is_mesh else max(10, int(0.01 * n))
    kept = np.flatnonzero(sizes >= least)
    if len(kept) == 0:
        raise InputError(f"no connected piece has {least} points or more: there is nothing to find a skeleton of")
    if len(kept) < number:
        lost = int(n - sizes[kept].sum())
        notes.append(f"{number - len(kept)} pieces of fewer than {least} points ({lost} points in all) have no skeleton of their own")
    if len(kept) > 1 and not components:
        raise TopologyError(f"the shape has {len(kept)} connected pieces; components=True makes a skeleton of each")
    rename = np.full(number, -1)
    rename[kept] = np.arange(len(kept))
    pieces: Indices = rename[labels]
    return pieces


def _restricted(complex_: _Complex, members: Indices) -> _Complex:
    new = np.full(len(complex_.points), -1, np.int32)
    new[members] = np.arange(len(members), dtype=np.int32)
    cells = new[complex_.cells]
    edges = new[complex_.edges]
    matrix = sparse.csr_array(complex_.stiffness[members][:, members])
    return _Complex(
        np.ascontiguousarray(complex_.points[members]),
        np.ascontiguousarray(cells[(cells >= 0).all(1)]),
        edges[(edges >= 0).all(1)],
        complex_.spacing,
        np.ascontiguousarray(complex_.weights[members]),
        matrix,
        complex_.mass[members],
        complex_.origin[members],
        complex_.sources,
    )


@dataclass
class _Part:
    drawing: _Drawing
    graph: _ReebGraph
    owners: Indices  # node of each point of the complex
    cut: list[float]
    cancelled: list[float]
    kept: list[float]
    counts: tuple[int, int, int]


def _one(complex_: _Complex, values: Floats, shape: Shape, shortest_limb: float, report: Any) -> _Part:
    graph, length, step, counts = _reeb_graph(complex_, values, report)
    cancelled = [] if complex_.is_mesh else graph.cancel_loops(complex_.spacing, step)
    kept = [loop[0] for loop in graph.loops()]
    simple = _Simplified(graph)
    simple.prune(shortest_limb * length)
    simple.contract()
    drawing = _draw(simple, complex_.spacing)
    first = np.full(graph.regions, -1)
    first[graph.group_below] = np.arange(len(graph.group_below))
    first[graph.group_above] = np.arange(len(graph.group_above))
    owners = drawing.node_of_group[first[graph.region_label[graph.region]]]
    owners = _descended(drawing, complex_.points, owners)
    if complex_.points.shape[1] == 3:
        section = _section(complex_, drawing, owners, shape)
        _center(drawing, section, not complex_.is_mesh)
        owners = _descended(drawing, complex_.points, owners)
    return _Part(drawing, graph, owners, simple.cut, cancelled, kept, counts)


def _section(complex_: _Complex, drawing: _Drawing, owners: Indices, shape: Shape) -> _Section | None:
    if isinstance(shape, TriangleMesh):
        return _Section(complex_, drawing, owners, shape) if shape.is_closed else None
    nearest = nearest_neighbors(complex_.points, complex_.sources, 1)[0][:, 0]
    return _Section(complex_, drawing, owners[nearest], shape)


def _descended(drawing: _Drawing, points: Floats, owners: Indices) -> Indices:
    """Moves each point's node along the graph as long as that brings it nearer."""
    size = len(drawing.nodes)
    around: list[set[int]] = [set() for _ in range(size)]
    for chain in drawing.chains:
        for a, b in itertools.pairwise(chain):
            around[a].add(b)
            around[b].add(a)
    width = max(map(len, around), default=0)
    table = np.array([[node, *sorted(other), *[node] * (width - len(other))] for node, other in enumerate(around)])
    owners = owners.copy()
    for _ in range(size):
        options = table[owners]
        offset = points[:, None] - drawing.nodes[options]
        best = np.einsum("nkd,nkd->nk", offset, offset).argmin(1)
        if not best.any():
            break
        owners = options[np.arange(len(owners)), best]
    return owners


def _ordered(points: Floats, center: Floats) -> Floats:
    """Points by their angle around the middle, in the plane in which they spread most."""
    if len(points) < 3:
        return points
    around = points - center
    axes = np.linalg.eigh(around.T @ around)[1][:, ::-1]
    return points[np.argsort(np.arctan2(around @ axes[:, 1], around @ axes[:, 0]), kind="stable")]


def _assembled(
    shape: Shape, complex_: _Complex, labels: Indices, parts: list[_Part], function: Floats, eigenvalues: Floats, notes: list[str]
) -> SkeletonResult:
    nodes, radii, limbs, contours, pieces = [], [], [], [], []
    owners = np.full(len(complex_.points), -1)
    start = 0
    for name, piece in enumerate(parts):
        drawing, graph = piece.drawing, piece.graph
        nodes.append(drawing.nodes)
        radii.append(drawing.radii)
        limbs += [np.array(chain, np.int32) + np.int32(start) for chain in drawing.chains]
        owners[labels == name] = piece.owners + start
        group_of: dict[int, int] = {}
        offset = np.linalg.norm(graph.centers - drawing.nodes[drawing.node_of_group], axis=1)
        for group in np.argsort(-offset, kind="stable").tolist():
            group_of[int(drawing.node_of_group[group])] = group
        order = np.argsort(graph.point_group, kind="stable")
        bounds = np.searchsorted(graph.point_group[order], np.arange(len(graph.centers) + 1))
        for node in range(len(drawing.nodes)):
            group = group_of.get(node)
            if group is None:
                contours.append(np.zeros((0, complex_.points.shape[1])))
            else:
                contours.append(_ordered(graph.points[order[bounds[group] : bounds[group + 1]]], graph.centers[group]))
        pieces += [name] * len(drawing.nodes)
        start += len(drawing.nodes)
    places = np.concatenate(nodes)
    coordinates = shape.points if isinstance(shape, PointCloud) else shape.vertices
    node_of_point = np.full(len(coordinates), -1)
    node_of_point[complex_.origin] = owners
    missing = np.flatnonzero(node_of_point < 0)
    if len(missing):
        known = np.flatnonzero(owners >= 0)
        nearest = nearest_neighbors(np.ascontiguousarray(complex_.points[known]), coordinates[missing], 1)[0][:, 0]
        node_of_point[missing] = owners[known[nearest]]
        function = function.copy()
        function[missing] = function[complex_.origin[known[nearest]]]
    pairs = np.concatenate([np.stack([limb[:-1], limb[1:]], 1) for limb in limbs]) if limbs else np.zeros((0, 2), np.int32)
    edges = _unique_edges(pairs[pairs[:, 0] != pairs[:, 1]])
    limb_of_node = np.full(len(places), -1, np.int32)
    for number in range(len(limbs) - 1, -1, -1):
        limb_of_node[limbs[number]] = number
    degrees = np.bincount(edges.ravel(), minlength=len(places))
    cancelled = np.array([height for piece in parts for height in piece.cancelled])
    kept = [height for piece in parts for height in piece.kept]
    minima, saddles, maxima = (sum(piece.counts[k] for piece in parts) for k in range(3))
    cut = np.array([ratio for piece in parts for ratio in piece.cut])
    return SkeletonResult(
        shape=shape,
        nodes=places,
        edges=edges,
        radii=np.concatenate(radii),
        leaves=int((degrees == 1).sum()),
        cycles=len(edges) - len(places) + len(parts),
        node_of_point=node_of_point.astype(np.int32),
        limbs=limbs,
        limb_of_node=limb_of_node,
        components=np.array(pieces, np.int32),
        contours=contours,
        function=function,
        eigenvalues=eigenvalues,
        critical=(minima, saddles, maxima),
        cut=cut,
        cancelled=cancelled,
        stability=(float(cancelled.max(initial=0.0)), float(min(kept, default=np.inf))),
        notes=tuple(notes),
    )
