"""Correspondence of two closed surfaces of genus 0 through their spherical conformal maps.

A conformal map takes whatever protrudes (a finger, a leg) to a spot that is smaller by orders of magnitude, and two spherical maps of one
surface differ by a Möbius map. So everything here is measured in logarithms and in quantities that no Möbius map changes: for
landmarks a_i, depth towards a_i (differences of log |x - a_i|) and angle around a_i (arguments of cross-ratios). On a limb that ends in
a_i these are the coordinates of a cylinder: along it and around it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from ..arrays import Floats
from ..conformal import SphericalMapResult
from ..conformal.moebius import Moebius
from ..errors import InputError
from ..sampling import farthest_points
from .surface import Indices, Surface, nearest_rows

Complex = npt.NDArray[np.complex128]

DEEPEST = 35.0  # depths beyond it are below rounding: exp(-35) is 6e-16 of the sphere
PROTRUDES = 1.5  # depth, in e-foldings of the map's scale, from which something that protrudes counts as a limb
LEAST_LIMB = 2e-3  # share of the area from which it does
SAME_PLACE = 0.6  # distance of features below which two tips cannot be told apart
CLEAR = 0.6  # a pair of tips must be nearer by this factor than any other choice
CLOSE = 0.15  # the same: up to here a pair of tips must fit better
NEAR_LANDMARK = 0.06  # share of sqrt(area): a tip nearer than this to a landmark says nothing new


def _basins(graph: scipy.sparse.csr_array, rank: Indices) -> tuple[Indices, list[tuple[int, set[int]]]]:
    """The minimum to which the steepest way down leads from each vertex; and, in ascending order, the vertices at which basins meet for the
    first time, with the minima of these."""
    rows = np.repeat(np.arange(len(rank)), np.diff(graph.indptr))
    lowest = rank.copy()
    np.minimum.at(lowest, rows, rank[graph.indices])
    order = np.argsort(rank)
    basin: Indices = order[lowest]
    while True:
        further = basin[basin]
        if (further == basin).all():
            break
        basin = further
    n, down = len(rank), rank[graph.indices] < rank[rows]
    keys = np.unique(rank[rows[down]] * n + basin[graph.indices[down]])  # a vertex by its rank, a basin that it touches
    vertex, touched = keys // n, keys % n
    again = np.flatnonzero(vertex[1:] == vertex[:-1])
    one, other = np.minimum(touched[again], touched[again + 1]), np.maximum(touched[again], touched[again + 1])
    first = np.sort(np.unique(one * n + other, return_index=True)[1])  # later meetings of the same two change nothing
    meeting: dict[int, set[int]] = {}
    for at, *pair in zip(vertex[again[first]].tolist(), one[first].tolist(), other[first].tolist(), strict=True):
        meeting.setdefault(at, set()).update(pair)
    return basin, [(int(order[at]), basins) for at, basins in meeting.items()]


@dataclass(frozen=True, eq=False)
class Sphered:
    """A surface on the sphere."""

    surface: Surface
    sphere: Floats
    log_scale: Floats
    up: Complex
    down: Complex

    @classmethod
    def of(cls, surface: Surface, result: SphericalMapResult, *, mirrored: bool = False) -> Sphered:
        p = result.positions * [1.0, -1.0, 1.0] if mirrored else result.positions
        # Homogeneous coordinates of the stereographic projection, in whichever of two forms has no cancellation.
        upper, planar = p[:, 2] > 0, p[:, 0] + 1j * p[:, 1]
        up, down = np.where(upper, 1 + p[:, 2], planar), np.where(upper, planar.conj(), 1 - p[:, 2])
        size = np.sqrt(np.abs(up) ** 2 + np.abs(down) ** 2)
        scale = 0.5 * np.log(np.maximum(result.conformal_factor, 1e-300) * surface.unit**2)
        return cls(surface, p, scale, up / size, down / size)

    def log_chords(self, to: Indices) -> Floats:
        """(n, k): log |x - a_i|."""
        apart = [np.sqrt(((self.sphere - self.sphere[i]) ** 2).sum(1)) for i in to]
        found: Floats = np.log(np.maximum(np.stack(apart, axis=1), 1e-17))
        return found

    def bracket(self, i: int) -> Complex:
        """Homogeneous difference from vertex i: cross-ratios are made of them."""
        found: Complex = self.up * self.down[i] - self.down * self.up[i]
        return found

    @cached_property
    def tips(self) -> list[int]:
        """Ends of all that protrudes, deepest first: minima of the map's scale, by persistence."""
        scale = self.log_scale
        rank = np.empty(len(scale), np.int64)
        rank[np.argsort(scale, kind="stable")] = np.arange(len(scale))
        basin, meeting = _basins(self.surface.stiffness, rank)
        found: list[tuple[float, int]] = []
        parent = {root: root for root in np.unique(basin).tolist()}
        joined = {root: [root] for root in parent}  # basins that have come together

        def root(i: int) -> int:
            while parent[i] != i:
                parent[i] = parent[parent[i]]
                i = parent[i]
            return i

        for v, basins in meeting:
            first, *others = sorted({root(i) for i in basins}, key=lambda i: int(rank[i]))
            for other in others:
                depth = float(scale[v] - scale[other])
                if depth > PROTRUDES:
                    below = np.isin(basin, joined[other]) & (rank < rank[v])
                    if self.surface.mass[below].sum() > LEAST_LIMB:
                        found.append((-depth, other))
                parent[other] = first
                joined[first] += joined.pop(other)
        lowest, highest = int(rank.argmin()), int(rank.argmax())
        if scale[highest] - scale[lowest] > PROTRUDES:
            found.append((float(scale[lowest] - scale[highest]), lowest))
        return [v for _, v in sorted(found)]


# --- features that no Möbius map changes --------------------------------------------------------------------------------------------


def _offsets(a: Sphered, b: Sphered, marks: Indices) -> tuple[Floats, Floats]:
    """u with log|a_i - a_j| - log|b_i - b_j| = u_i + u_j as well as can be, and what is left (k, k): zero for conformal pairs."""
    i, j = np.triu_indices(len(marks), 1)
    differences = a.log_chords(marks[:, 0])[marks[:, 0]] - b.log_chords(marks[:, 1])[marks[:, 1]]
    rows = np.zeros((len(i), len(marks)))
    rows[np.arange(len(i)), i] = rows[np.arange(len(i)), j] = 1.0
    u = np.asarray(np.linalg.lstsq(rows, differences[i, j], rcond=None)[0], np.float64)
    left: Floats = differences - u[:, None] - u[None]
    np.fill_diagonal(left, 0.0)
    return u, left


def misfit(a: Sphered, b: Sphered, marks: Indices) -> float:
    """Root mean square by which the cross-ratios of the landmarks differ, in logarithms: 0 for conformal pairs."""
    left = _offsets(a, b, marks)[1]
    pairs = len(marks) * (len(marks) - 1)
    return float(np.sqrt((left**2).sum() / pairs)) if pairs else 0.0


def _misfit_of(a: Sphered, b: Sphered, marks: Indices, pair: tuple[int, int]) -> float:
    """How badly one more pair fits those that are there."""
    u, _ = _offsets(a, b, marks)
    new = a.log_chords(marks[:, 0])[pair[0]] - b.log_chords(marks[:, 1])[pair[1]]
    return float(np.std(new - u))


def features(a: Sphered, b: Sphered, marks: Indices, deepest: float = DEEPEST) -> tuple[Floats, Floats]:
    """Depth towards each of k >= 3 landmarks (columns 0 to k - 1) and direction around it (2 k columns), for both surfaces."""
    k = len(marks)
    u, _ = _offsets(a, b, marks)
    depths = []
    for side, own, shift in ((a, marks[:, 0], u - u.mean()), (b, marks[:, 1], np.zeros(k))):
        chords = side.log_chords(own)
        depths.append(np.clip(chords.mean(1, keepdims=True) - chords + shift, -deepest, deepest))
    between = ((a.sphere[marks[:, 0], None] - a.sphere[None, marks[:, 0]]) ** 2).sum(2)
    angles: tuple[list[Floats], list[Floats]] = ([], [])
    for i in range(k):
        far = int(np.argmax(between[i]))
        others = [q for q in range(k) if q not in (i, far)]
        turns = []
        for side, own in ((a, marks[:, 0]), (b, marks[:, 1])):
            turn = side.bracket(own[i]) * side.bracket(own[far]).conj()
            turns.append(turn / np.maximum(np.abs(turn), 1e-300))
        # The angle at which both count as turned alike: the circular mean over the other landmarks.
        against = (turns[0][marks[others, 0]] * turns[1][marks[others, 1]].conj()).sum()
        turns[1] = turns[1] * (against / max(abs(against), 1e-300))
        for turn, columns in zip(turns, angles, strict=True):
            columns += [turn.real, turn.imag]
    return np.column_stack([depths[0], *angles[0]]), np.column_stack([depths[1], *angles[1]])


def paired_tips(a: Sphered, b: Sphered, marks: Indices) -> Indices:
    """The landmarks, and pairs of tips that the landmarks leave no doubt about; the surest first, and each helps to find the next."""
    base = misfit(a, b, marks)
    while True:
        first, second = features(a, b, marks, 12.0)
        free, ways = [], []
        for side, own, table in ((a, marks[:, 0], first), (b, marks[:, 1], second)):
            near = side.surface.distances(own).min(0)
            ways.append(near)
            kept: list[int] = []
            for v in side.tips:
                if near[v] >= NEAR_LANDMARK and all(np.linalg.norm(table[v] - table[w]) > SAME_PLACE for w in kept):
                    kept.append(v)
            free.append(kept)
        if not free[0] or not free[1]:
            return marks
        apart = np.sqrt(((first[free[0]][:, None] - second[free[1]][None]) ** 2).sum(2))
        best: tuple[float, int, int] | None = None
        for i, row in enumerate(apart):
            j = int(np.argmin(row))
            others = np.concatenate([np.delete(row, j), np.delete(apart[:, j], i)])
            if (others * CLEAR <= row[j]).any() or row[j] > 3.0 or (best is not None and row[j] >= best[0]):
                continue
            p, q = free[0][i], free[1][j]
            # Close to a landmark a wrong pair (of fingers) does more harm than none; a whole limb without one does most.
            limit = max(2 * base, 0.5) if min(ways[0][p], ways[1][q]) < CLOSE else max(4 * base, 2.0)
            if _misfit_of(a, b, marks, (p, q)) < limit:
                best = (float(row[j]), p, q)
        if best is None:
            return marks
        marks = np.concatenate([marks, [best[1:]]])


def without_outliers(a: Sphered, b: Sphered, marks: Indices, given: int) -> Indices:
    """The landmarks without those, after the first ``given``, but for which the others would fit far better."""
    while len(marks) > max(4, given):
        rests = [np.delete(marks, i, axis=0) for i in range(given, len(marks))]
        misfits = [misfit(a, b, rest) for rest in rests]
        best = int(np.argmin(misfits))
        if misfits[best] * 3.0 > misfit(a, b, marks):
            break
        marks = rests[best]
    return marks


def stretched(a: Sphered, b: Sphered, marks: Indices, first: Floats, second: Floats) -> Floats:
    """The features of b with the depth along each limb stretched: what lies at a certain share of the way from the middle of the body
    (depth 0) to the tip, by geodesic distance, comes to the depth at which that share lies on a. No conformal map does that; two
    limbs of different slenderness need it."""
    out = second.copy()
    ways = (a.surface.distances(marks[:, 0]), b.surface.distances(marks[:, 1]))
    for i in range(len(marks)):
        profiles = []
        for side, table, way in ((a, first, ways[0]), (b, second, ways[1])):
            depth = table[:, i]
            grid = np.arange(0.0, np.partition(depth, -2)[-2] + 0.25, 0.25)
            kernel = np.exp(-0.5 * ((grid[:, None] - depth[None]) / 0.3) ** 2) * side.surface.mass
            total = kernel.sum(1)
            seen = total > 1e-12
            mean = np.minimum.accumulate((kernel[seen] @ way[i]) / total[seen])
            profiles.append((grid[seen], mean / max(mean[0], 1e-300)) if len(mean) else (grid[:0], mean))
        (grid_a, share_a), (grid_b, share_b) = profiles
        if len(grid_a) < 2 or len(grid_b) < 2:
            continue
        depth = second[:, i]
        along = depth > 0
        moved = np.interp(-np.interp(depth[along], grid_b, share_b), -share_a, grid_a)
        beyond = depth[along] > grid_b[-1]
        out[along, i] = np.minimum(np.where(beyond, depth[along] - grid_b[-1] + grid_a[-1], moved), DEEPEST)
    return out


# --- the first three landmarks ------------------------------------------------------------------------------------------------------


def robust_moebius(a: Sphered, b: Sphered, pairs: Indices, rng: np.random.Generator, *, trials: int = 400) -> Moebius | None:
    """The Möbius map from a's sphere to b's on which most of the pairs agree (random sample consensus, then all that agree)."""
    if len(pairs) < 3:
        return None
    p, q = a.sphere[pairs[:, 0]], b.sphere[pairs[:, 1]]
    best, most = None, -1.0
    for _ in range(trials):
        picked = rng.choice(len(pairs), 3, replace=False)
        try:
            map_ = Moebius.through(p[picked], q[picked])
        except InputError:  # two of them fall together
            continue
        agreement = float(np.exp(-((map_(p) - q) ** 2).sum(1) / 0.1**2).sum())
        if agreement > most:
            best, most = map_, agreement
    return best


def guessed_marks(a: Sphered, b: Sphered, marks: Indices, most: int = 10) -> list[Indices]:
    """Pairs of tips that make three with up to two of the landmarks: the choices whose Möbius maps have the most even factor and take
    landmarks to landmarks.

    A Möbius map M between the spheres makes a conformal map of the surfaces, with a factor log w = log(scale of a) + log|M'| -
    log(scale of b) that is known at once. Its spread over a sample of points, without the quarter that fits worst, is the score.
    """
    kept_marks = marks if len(marks) < 3 else marks[:0]
    missing = 3 - len(kept_marks)
    tips = []
    for side, own in ((a, marks[:, 0]), (b, marks[:, 1])):
        near = side.surface.distances(own).min(0) if len(kept_marks) else np.full(len(side.sphere), np.inf)
        kept: list[int] = []
        for v in side.tips:
            if near[v] >= NEAR_LANDMARK and all(((side.sphere[v] - side.sphere[w]) ** 2).sum() > 0.03**2 for w in kept):
                kept.append(v)
        tips.append(kept[:6])
    choices: list[tuple[Moebius, Indices]] = []
    for ours in itertools.combinations(tips[0][:5], missing):
        for theirs in itertools.permutations(tips[1], missing):
            three = np.concatenate([kept_marks, np.array(list(zip(ours, theirs, strict=True)), np.int64)])
            try:
                choices.append((Moebius.through(a.sphere[three[:, 0]], b.sphere[three[:, 1]]), three))
            except InputError:  # two of them fall together
                continue
    if not choices:
        return []
    sample = np.asarray(farthest_points(a.surface.points, min(200, len(a.sphere))), np.int64)
    images = np.concatenate([moebius(a.sphere[sample]) for moebius, _ in choices])
    found = b.log_scale[nearest_rows(b.sphere, images)].reshape(len(choices), -1)
    scores = np.empty(len(choices))
    for number, (moebius, _) in enumerate(choices):
        (p, q), (r, s) = moebius.matrix
        up, down = a.up[sample], a.down[sample]
        change = -np.log(np.abs(p * up + q * down) ** 2 + np.abs(r * up + s * down) ** 2)
        factor = a.log_scale[sample] + change - found[number]
        away = np.sort(np.abs(factor - np.median(factor)))
        scores[number] = away[: (3 * len(away)) // 4].mean()
        if len(marks):
            scores[number] += 2 * np.sqrt(((moebius(a.sphere[marks[:, 0]]) - b.sphere[marks[:, 1]]) ** 2).sum(1)).mean()
    return [choices[number][1] for number in np.argsort(scores, kind="stable")[:most]]


def distinct(pairs: Indices) -> Indices:
    """Pairs without those that name a vertex again."""
    kept: list[int] = []
    first: set[int] = set()
    second: set[int] = set()
    for row, (i, j) in enumerate(pairs.tolist()):
        if i not in first and j not in second:
            kept.append(row)
            first.add(i)
            second.add(j)
    return pairs[kept]


def agreeing_pairs(a: Sphered, b: Sphered, moebius: Moebius, pairs: Indices, count: int = 12) -> Indices:
    """Of the pairs on which the Möbius map agrees, some that lie apart."""
    agree = pairs[((moebius(a.sphere[pairs[:, 0]]) - b.sphere[pairs[:, 1]]) ** 2).sum(1) < 0.05**2]
    if len(agree) <= count:
        return distinct(agree)
    return distinct(agree[np.asarray(farthest_points(a.surface.points[agree[:, 0]], count))])
