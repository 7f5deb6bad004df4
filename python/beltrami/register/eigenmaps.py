"""The chapter's iteration: rotation-invariant sliced Wasserstein between eigenmaps, coarse to fine."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from .. import _core
from ..arrays import Floats
from ..sliced import Run, alternate, orthonormal_directions
from .sides import Side


@dataclass(eq=False)
class Eigenmap:
    """A shape as a weighted point set: λ_k^(-d/4) φ_k, k = 1, 2 ..., at some farthest points, of unit area."""

    values: Floats
    rows: Floats
    masses: Floats
    dimension: int

    def points(self, n: int) -> Floats:
        """The first n coordinates."""
        above = self.values[self.values > 1e-9 * self.values[-1]]
        scale = np.maximum(self.values[:n], above[0] if len(above) else 1.0) ** (-self.dimension / 4)
        return np.ascontiguousarray(self.rows[:, :n] * scale)


def eigenmap(side: Side, count: int, modes: int) -> Eigenmap:
    """The eigenmap at the first `count` samples."""
    chosen, masses = side.first(count)
    return Eigenmap(side.values[:modes].copy(), np.ascontiguousarray(side.functions[chosen, :modes]), masses, side.dimension)


def _align(
    source: Eigenmap, target: Eigenmap, starts: Floats, seed: int, steps: int, *, tolerance: float = 1e-8, directions: int = 40
) -> list[Run]:
    """Runs of the alternation between couplings and rotations, from several rotations, best first."""
    n = starts.shape[1]
    theta = orthonormal_directions(n, max(directions, 2 * n), rng=np.random.default_rng([seed, n]))
    alignment = _core.SlicedAlignment(source.points(n), target.points(n), source.masses, target.masses, theta)
    runs = alternate(alignment, [Run(np.ascontiguousarray(start)) for start in starts], steps, tolerance)
    return sorted(runs, key=lambda run: run.value)


def _lifted(source: Eigenmap, target: Eigenmap, rotation: Floats, n: int) -> list[Floats]:
    """Rotations of order n that go on from one of a lower order: Procrustes on nearest rows, and where a singular value of
    what is new is small, so that it could as well be the opposite, both ways."""
    old = len(rotation)
    x, y = source.points(n), target.points(n)
    image, _ = _core.nearest_rows(np.ascontiguousarray(y[:, :old]), x[:, :old] @ rotation)
    left, sizes, right = np.linalg.svd((x * source.masses[:, None]).T @ y[image])
    ways = [left @ right]
    if sizes[-1] < 0.2 * np.median(sizes):
        turned = left.copy()
        turned[:, -1] *= -1
        ways.append(turned @ right)
    return ways


def align_eigenmaps(
    source: Eigenmap, target: Eigenmap, levels: list[int], seed: int, width: int = 8, finest: tuple[Eigenmap, Eigenmap] | None = None
) -> tuple[list[Run], list[float]]:
    """Rotation-invariant sliced Wasserstein, coarse to fine: all signs of the first modes, then a beam. The runs of the last level
    (between `finest` if given), best first, and the best distance of each level."""
    rotations = np.array([np.diag(signs) for signs in itertools.product((1.0, -1.0), repeat=levels[0])])
    best: list[float] = []
    kept: list[Run] = []
    for index, n in enumerate(levels):
        if index:
            rotations = np.array([way for rotation in rotations for way in _lifted(source, target, rotation, n)])
        pair = finest if finest is not None and index == len(levels) - 1 else (source, target)
        if len(rotations) > 2 * width:  # a few steps each, the better half goes on
            rotations = np.array([run.rotation for run in _align(*pair, rotations, seed, 4)[: 2 * width]])
        kept = []
        for run in _align(*pair, rotations, seed, 30):
            if len(kept) < width and all((run.rotation * other.rotation).sum() < 0.98 * n for other in kept):
                kept.append(run)
        rotations = np.array([run.rotation for run in kept])
        best.append(float(np.sqrt(kept[0].value)))
    return kept, best


def settle(source: Eigenmap, target: Eigenmap, start: Floats, seed: int, steps: int = 6) -> tuple[Floats, float]:
    """The alternation from a rotation, in both orders: the rotation and the distance, the less of both."""
    there = _align(source, target, np.ascontiguousarray(start)[None], seed, steps)[0]
    back = _align(target, source, np.ascontiguousarray(there.rotation.T)[None], seed, steps)[0]
    if back.value < there.value:
        return np.ascontiguousarray(back.rotation.T), float(np.sqrt(max(back.value, 0.0)))
    return there.rotation, float(np.sqrt(max(there.value, 0.0)))
