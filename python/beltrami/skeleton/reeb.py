"""Reeb graphs: contours at many levels, joined to branches; removal of loops due to the sampling, and of stubs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core
from ..arrays import Floats, Ints
from ..near import nearest_neighbors
from .complexes import Complex, Indices, sides, unique_edges

LEVELS = 150  # at most, beside those between critical vertices
CROSSINGS = 5_000_000  # of edges and levels between critical vertices, at most: a function of noise has thousands of levels
LONG = 0.08  # of the root of the area: limbs that stand out are longer; Spot's legs .11, .14, fingers of men .05
HIGH = 0.025  # of the range of the function: and higher; fingers of men .02
LIMB = 1.6  # a limb is at least this many times longer than it is wide at its root; the corner of a square of tubes is 1.5 times


@dataclass
class _Branch:
    low: int  # regions at its ends
    high: int
    contours: list[int]  # groups of contours, from low to high


class ReebGraph:
    """Contours and regions of one component, with what was merged; reduced to branches between joints."""

    def __init__(self, complex_: Complex, values: Floats, ranks: Indices, cuts: Indices, levels: Floats, arcs: Floats, report: Any) -> None:
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

    def tip(self, region: int, group: int) -> int:
        """The vertex of a region that is farthest in value from the contour beside it; -1 if there is none."""
        inside = self.members[self.bounds[region] : self.bounds[region + 1]]
        if len(inside) == 0:
            return -1
        away = np.abs(self.values[inside] - self.levels[self.group_cut[group]])
        return int(inside[int(away.argmax())])

    def group_of_vertex(self) -> Indices:
        """A group of contours beside each vertex."""
        first = np.full(self.regions, -1)
        first[self.group_below] = np.arange(len(self.group_below))
        first[self.group_above] = np.arange(len(self.group_above))
        found: Indices = first[self.region_label[self.region]]
        return found

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

    def _gap(self, one: int, other: int) -> float:
        """Least distance between the points of two groups of contours."""
        first, second = (self.points[self.point_group == group] for group in (one, other))
        return float(nearest_neighbors(first, second, 1)[1].min())

    def _spurious(self, first: list[int], second: list[int], height: float, spacing: float, step: float) -> bool:
        """Whether two sides of a loop are no two tubes: one is thinner than the sampling shows, or an arc of the ring that the other
        completes, or within the other and near it, or the loop is but one level high and its sides touch."""
        radius = [float(np.median(self.radii[side])) for side in (first, second)]
        if min(radius) < 0.75 * spacing:
            return True
        level = (self.arc[first].min() + self.arc[first].max()) / 2
        middle = [min(side, key=lambda group: (abs(self.arc[group] - level), group)) for side in (first, second)]
        apart = float(np.linalg.norm(self.centers[middle[0]] - self.centers[middle[1]]))
        whole = max(self.opening([group]) for group in middle) <= 1.8
        if apart < 1.05 * sum(self.radii[middle]):
            # rings one within the other may be the two sides of a hole, as where a torus that lies flat is cut by height
            return not (whole and self._gap(*middle) > 3 * spacing)
        if height < 1.5 * step and apart < 1.6 * sum(self.radii[middle]):
            return True
        if whole:
            return False
        # two arcs: of one ring, unless they lie far apart and make no ring together, as in an open scan
        return apart < 2.5 * sum(self.radii[middle]) or self.opening(middle) < 1.8


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


def _levels(values: Floats, complex_: Complex) -> tuple[Floats, Floats, Callable[[Floats], Floats]]:
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
    spacing = max(complex_.spacing, arc[-1] / LEVELS)  # which is 0 where most points coincide
    number = int(np.clip(round(arc[-1] / spacing), 8, LEVELS))
    wanted = (np.arange(number) + 0.5) * (arc[-1] / number)
    return np.interp(wanted, arc, grid), np.array([arc[-1], arc[-1] / number]), lambda level: np.interp(level, grid, arc)


def reeb_graph(complex_: Complex, values: Floats, report: Any) -> tuple[ReebGraph, float, float, tuple[int, int, int], bool]:
    """The graph, the arc length of the function, the distance of levels, the numbers of minima, saddles and maxima (meshes), and
    whether there is a level between any two critical vertices."""
    n = len(values)
    order = np.lexsort((np.arange(n), values))
    ranks = np.empty(n, np.int64)
    ranks[order] = np.arange(n)
    ascending = values[order]
    levels, (length, step), arc = _levels(values, complex_)
    cuts = np.searchsorted(ascending, levels, side="right")
    keep = (cuts > 0) & (cuts < n) & (np.diff(cuts, prepend=0) > 0)
    cuts, levels = cuts[keep], levels[keep]
    counts, exact = (0, 0, 0), True
    if complex_.is_mesh:
        lower, upper, used = _critical(complex_.cells, ranks)
        counts = (int((used & (lower == 0)).sum()), int(np.maximum(lower - 1, 0).sum()), int((used & (upper == 0)).sum()))
        special = np.sort(ranks[used & ((lower != 1) | (upper != 1))])
        if len(special) > 1:  # a cut between any two critical vertices
            low, high = special[:-1], special[1:]
            missing = np.searchsorted(cuts, high, side="right") == np.searchsorted(cuts, low, side="right")
            extra = ((low + high + 1) // 2)[missing]
            a, b = ranks[complex_.edges.T]
            crossings = np.abs(np.searchsorted(extra, a, side="right") - np.searchsorted(extra, b, side="right")).sum()
            if crossings > CROSSINGS:
                exact, extra = False, extra[:0]
            cuts = np.concatenate([cuts, extra])
            levels = np.concatenate([levels, 0.5 * ascending[extra - 1] + 0.5 * ascending[extra]])
            by_cut = np.argsort(cuts, kind="stable")
            cuts, levels = cuts[by_cut], levels[by_cut]
    graph = ReebGraph(complex_, values, ranks, cuts, levels, arc(levels), report)
    return graph, float(length), float(step), counts, exact


def _critical(faces: Ints, ranks: Indices) -> tuple[Indices, Indices, npt.NDArray[np.bool_]]:
    """Components of the lower and of the upper link of each vertex, and which vertices are in use.

    Banchoff's index of a vertex is 1 - edges down + triangles down, so that the sum over all is the Euler characteristic.
    """
    n = len(ranks)
    edges = unique_edges(sides(faces))
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


@dataclass
class Limb:
    """A branch of the simplified graph: its ends, and its groups of contours from the first end to the second."""

    ends: list[int]
    groups: list[int]


class SimplifiedGraph:
    """The Reeb graph without stubs. ``fallen`` holds for each joint the groups of the limbs cut there."""

    def __init__(self, graph: ReebGraph) -> None:
        self.graph = graph
        self.limbs = [Limb([branch.low, branch.high], list(branch.contours)) for branch in graph.branches]
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
        at: dict[int, list[Limb]] = defaultdict(list)
        for limb in self.limbs:
            at[limb.ends[0]].append(limb)
            at[limb.ends[1]].append(limb)
        gone: set[int] = set()
        for joint in sorted(at):
            if len(at[joint]) != 2 or at[joint][0] is at[joint][1]:
                continue
            first, second = at[joint]
            # the first one grows: it ends at the joint, and the second one follows
            if first.ends[1] != joint:
                first.ends, first.groups = first.ends[::-1], first.groups[::-1]
            ends, groups = (second.ends, second.groups) if second.ends[0] == joint else (second.ends[::-1], second.groups[::-1])
            self.stray.extend((group, first.groups[-1]) for group in self.fallen.pop(joint, []))
            first.ends, first.groups = [first.ends[0], ends[1]], first.groups + groups
            gone.add(id(second))
            at[ends[1]][next(k for k, limb in enumerate(at[ends[1]]) if limb is second)] = first
        self.limbs = [limb for limb in self.limbs if id(limb) not in gone]

    def reach(self, limb: Limb, end: int) -> tuple[float, float]:
        """Length of a limb from its root to the tip at ``end``, and how many times farther the tip is than the root is wide."""
        graph = self.graph
        groups = limb.groups if end == 1 else limb.groups[::-1]
        x, root = graph.centers[groups], groups[0]
        vertex = graph.tip(limb.ends[end], groups[-1])
        tip = x[-1] if vertex < 0 else graph.vertices[vertex]
        length = float(np.linalg.norm(np.diff(x, axis=0), axis=1).sum() + np.linalg.norm(tip - x[-1]))
        return length, float(np.linalg.norm(tip - x[0])) / max(float(graph.radii[root]), 1e-300)

    def tips(self) -> list[tuple[int, int, int]]:
        """(limb, which of its ends, vertex) of each tip."""
        degree = self.degrees()
        ends = [(number, end) for number, limb in enumerate(self.limbs) for end in (0, 1) if degree[limb.ends[end]] == 1]
        return [(k, end, self.graph.tip(self.limbs[k].ends[end], self.limbs[k].groups[-end])) for k, end in ends]

    def beyond(self, other: SimplifiedGraph, size: float) -> int:
        """How many limbs end that ``other``, of the same shape, has no tip in: those that stand out. ``size``: root of the area."""
        graph = self.graph
        limb_of_group = np.full(len(graph.centers), -1)
        for number, limb in enumerate(self.limbs):
            limb_of_group[limb.groups] = number
        for group, beside in self.stray:
            limb_of_group[group] = limb_of_group[beside]
        limb_of_vertex = limb_of_group[graph.group_of_vertex()]
        seen = {int(limb_of_vertex[vertex]) for _, _, vertex in other.tips() if vertex >= 0}
        found = 0
        for number, end, _ in self.tips():
            rise = np.ptp(graph.values[limb_of_vertex == number]) / np.ptp(graph.values)
            found += number not in seen and rise > HIGH and self.reach(self.limbs[number], end)[0] > LONG * size
        return found

    def prune(self, shortest: float) -> None:
        """Cuts limbs that end, the shortest first: those below ``shortest``, and those less than ``LIMB`` times as long as wide."""
        while True:
            degree = self.degrees()
            failing: list[tuple[float, float, int, int]] = []
            for number, limb in enumerate(self.limbs):
                if (degree[limb.ends[0]] == 1) == (degree[limb.ends[1]] == 1):
                    continue  # inner, or all there is
                end = 0 if degree[limb.ends[0]] == 1 else 1
                length, ratio = self.reach(limb, end)
                if length < shortest or ratio < LIMB:
                    failing.append((length, ratio, number, end))
            if not failing:
                return
            failing.sort()
            # one at a joint at a time, because what is left there may become a limb that is long enough; of many the shortest quarter
            touched: set[int] = set()
            cut: set[int] = set()
            for _, ratio, number, end in failing:
                joint = self.limbs[number].ends[1 - end]
                if joint in touched or 4 * len(cut) > max(len(failing) - 16, 0):
                    continue
                touched.add(joint)
                cut.add(number)
                self.cut.append(ratio)
                self.fallen[joint] += self.limbs[number].groups
            self.limbs = [limb for number, limb in enumerate(self.limbs) if number not in cut]
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
                x = graph.centers[limb.groups]
                length = max(float(np.ptp(graph.arc[limb.groups])), float(np.linalg.norm(np.diff(x, axis=0), axis=1).sum()))
                ratio = length / max(float(np.median(graph.radii[limb.groups])), 1e-300)
                if ratio < 0.75 and (shortest is None or ratio < shortest[0]):
                    shortest = (ratio, number)
            if shortest is None:
                return
            limb = self.limbs.pop(shortest[1])
            a, b = limb.ends
            self.fallen[a] += limb.groups + self.fallen.pop(b, [])
            for other in self.limbs:
                other.ends = [a if end == b else end for end in other.ends]
