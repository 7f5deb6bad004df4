"""Maps that the pursuit may start from: through spheres, from landmarks or features, or near-isometric; and the choice between them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from ..arrays import Floats
from ..conformal import SphericalMapResult, spherical_map
from ..eigen import eigenpairs
from ..errors import InputError, NumericalError, TopologyError
from ..register import register
from ..sampling import farthest_points
from ..shapes import TriangleMesh
from ..solvers import Cholesky, plus_diagonal
from . import limbs
from .curvature import paired_by_curvature
from .limbs import Sphered
from .surface import Indices, Surface, nearest_rows

Start = Literal["auto", "spherical", "landmarks", "register"]
Orientation = Literal["preserving", "reversing", "any"]
BLUR = 0.01  # share of the area over which the factor of a map is averaged
COARSE_BLUR = 0.3  # the same for the weights of upsampling, where only the factor's main course matters
CONFORMAL = 0.02  # logarithmic misfit of the landmarks' cross-ratios below which two shapes count as conformal
INVARIANT = 0.1  # the same for potentials on shapes of any topology, which feel the mesh around each landmark
UNEVEN = 15.0  # roughness of the factor up to which two shapes may be nearly isometric
SMOOTH = 100.0  # roughness of the factor from which a map is so poor that other guesses are worth their time
ANCHOR = 3.0  # weight of the spherical features beside the bases of a shape of unit area
CHARGES = 16  # pairs of a feature map that potentials are made of
WORTH = 3.0  # so much rougher may a map be that hits the landmarks
MISSED = 0.1  # share of sqrt(area) from which on a landmark is missed


def factor_of_map(source: Surface, target: Surface, forward: Indices, blur: float = BLUR, sweeps: int = 3) -> Floats:
    """η on the target with ``exp(η) m`` = the source's mass pushed forward by the map, smoothed; total mass 1.

    Each sweep solves ``(exp(η) M + t L) u = mass that arrives`` and multiplies the factor by u: the blur is that of the new metric.
    """
    arriving = np.bincount(forward, source.mass, len(target.mass))
    eta = np.zeros(len(target.mass))
    weights = np.maximum(target.mass, 1e-12 / len(target.mass))
    blurred = blur * target.stiffness
    factor: Cholesky | None = None
    for _ in range(sweeps):
        matrix = plus_diagonal(blurred, np.exp(eta) * weights)
        factor = Cholesky(matrix, target.operators.coordinates) if factor is None else factor.refactor(matrix)
        eta = np.clip(eta + np.log(np.maximum(factor.solve(arriving), 1e-3)), -25.0, 25.0)
        eta -= np.log(np.exp(eta) @ target.mass)
    return eta


@dataclass(frozen=True, eq=False)
class Candidate:
    """A map and its inverse, and how rough its factor is: the Dirichlet energy of η, both ways. No change of the metrics' scale and no
    conformal map of both changes that energy; of two maps the one with the lesser energy is nearly always the better one."""

    name: str
    forward: Indices
    backward: Indices
    marks: Indices
    eta: Floats
    roughness: float
    anchors: tuple[Floats, Floats] | None = None  # features that the map came from
    binding: bool = False  # the shapes are conformal, so that these features are the same on both


def candidate(
    name: str,
    source: Surface,
    target: Surface,
    forward: Indices,
    backward: Indices,
    marks: Indices,
    anchors: tuple[Floats, Floats] | None = None,
    binding: bool = False,
) -> Candidate:
    eta, back = factor_of_map(source, target, forward), factor_of_map(target, source, backward)
    rough = float(eta @ (target.stiffness @ eta)) + float(back @ (source.stiffness @ back))
    return Candidate(name, forward, backward, marks, eta, rough, anchors, binding)


def aligned(source: Surface, phi: Floats, psi: Floats, weight: Floats, forward: Indices, backward: Indices) -> Floats:
    """R orthogonal with ``phi @ R`` near ``psi`` under the map, both ways."""
    both = phi.T @ (source.mass[:, None] * psi[forward]) + phi[backward].T @ (weight[:, None] * psi)
    u, _, v = np.linalg.svd(both)
    found: Floats = u @ v
    return found


def smoothest(task: Task, candidates: Sequence[Candidate]) -> Candidate:
    """The least rough; of equals, as the turns of a symmetric shape are, the first, which was made from the landmarks. Maps that miss most
    of the landmarks count only where the others are far rougher, as for landmarks that cannot be right; and where the shapes proved to
    be conformal, only those count that keep what is invariant then."""
    for sure in (one for one in candidates if one.binding and one.anchors is not None):
        first, second = sure.anchors  # type: ignore[misc]
        off = [float(task.source.mass @ np.square(first - second[one.forward]).sum(1)) for one in candidates]
        least = off[candidates.index(sure)]
        candidates = [one for one, value in zip(candidates, off, strict=True) if value <= 4 * least + 1e-6]
        break
    if len(task.marks):
        true = [one for one in candidates if (task.missed(one.forward) > MISSED).mean() <= 0.5]
        least = min(one.roughness for one in candidates)
        if true and min(one.roughness for one in true) <= WORTH * least:
            candidates = true
    least = min(one.roughness for one in candidates)
    return next(one for one in candidates if one.roughness <= (1 + 1e-6) * least)


def upsampled(task: Task, phi: Floats, start: Candidate, levels: Iterable[int], report: Callable[[float], None]) -> Candidate:
    """Spectral upsampling (Melzi et al. 2019) in the metric of the map's own factor. Where the start has features, rows of both are
    compared: the bases smooth the map, the features keep it from sliding along limbs."""
    source, target = task.source, task.target
    forward, backward = start.forward, start.backward
    near: Floats | None = None
    for k in levels:
        weight = np.exp(factor_of_map(source, target, forward, COARSE_BLUR, 1)) * target.mass
        right = near = eigenpairs(target.stiffness, k, mass=weight, start=near).functions
        left = phi[:, :k] @ aligned(source, phi[:, :k], right, weight, forward, backward)
        if start.anchors is not None:
            left, right = (np.column_stack([x, ANCHOR * y]) for x, y in zip((left, right), start.anchors, strict=True))
        forward, backward = nearest_rows(right, left), nearest_rows(left, right)
        report(0.5)
    return candidate(f"{start.name}, upsampled", source, target, forward, backward, start.marks)


def _bumps(surface: Surface, weight: Floats, at: Indices, time: float = 0.01) -> Floats:
    """Heat from each vertex after a while, in the metric of the weight."""
    right = np.zeros((len(weight), len(at)))
    right[at, np.arange(len(at))] = 1.0
    safe = np.maximum(weight, 1e-12 / len(weight))
    return Cholesky(plus_diagonal(time * surface.stiffness, safe), surface.operators.coordinates).solve(right)


@dataclass(frozen=True, eq=False)
class Task:
    source: Surface
    target: Surface
    marks: Indices
    tables: tuple[Floats, Floats] | None
    rng: np.random.Generator
    orientation: Orientation
    notes: list[str]

    @cached_property
    def _from_marks(self) -> Floats:
        return self.target.distances(self.marks[:, 1])

    def missed(self, forward: Indices) -> Floats:
        """How far a map takes each landmark from where it belongs, over sqrt(area)."""
        found: Floats = self._from_marks[np.arange(len(self.marks)), forward[self.marks[:, 0]]]
        return found


def first_maps(task: Task, start: Start, report: Callable[[float], None]) -> tuple[list[Candidate], bool]:
    """All maps that apply, at least one; and whether no other need be tried."""
    found: list[Candidate] = []
    settled = start != "auto"
    if start in ("auto", "spherical"):
        spheres = _spheres(task, start == "spherical")
        report(0.1)
        if spheres is not None:
            found, conformal = _spherical_starts(task, spheres, report)
            settled |= conformal
            if not found:
                task.notes.append("nothing fixes the spherical maps on one another: no landmarks, no features, hardly any limb")
    if start == "landmarks" or (start == "auto" and not found and (len(task.marks) or task.tables is not None)):
        if not len(task.marks) and task.tables is None:
            raise InputError("start='landmarks' needs landmarks= or features=")
        found += [*_harmonic_starts(task), _spectral_start(task)]
    if not found:
        return [registered_start(task)], True
    return found, settled or task.orientation != "preserving"


def _spheres(task: Task, needed: bool) -> tuple[SphericalMapResult, SphericalMapResult] | None:
    results = []
    for surface, name in ((task.source, "source"), (task.target, "target")):
        shape = surface.operators.shape
        holes = isinstance(shape, TriangleMesh) and not shape.is_closed
        try:
            results.append(spherical_map(shape, fill_holes=holes))
        except (TopologyError, NumericalError) as error:
            if needed:
                remedy = "leave start='auto', or give landmarks with start='landmarks'"
                raise type(error)(f"the spherical start is not for this {name}: {error}; {remedy}") from error
            task.notes.append(f"no spherical start, because of the {name}: {error}")
            return None
    return results[0], results[1]


def _spherical_starts(
    task: Task, spheres: tuple[SphericalMapResult, SphericalMapResult], report: Callable[[float], None]
) -> tuple[list[Candidate], bool]:
    """Maps through the spheres; and whether the shapes turned out to be conformal, so that no other map need be tried."""
    found: list[Candidate] = []
    settled = False
    sides = {"preserving": [False], "reversing": [True], "any": [False, True]}[task.orientation]
    for mirrored in sides:
        a, b = Sphered.of(task.source, spheres[0]), Sphered.of(task.target, spheres[1], mirrored=mirrored)
        name = "spherical, mirrored" if mirrored else "spherical"
        choices: list[Indices] = []
        by_curvature, same = np.zeros((0, 2), np.int64), False
        if len(task.marks) >= 3:
            choices = [task.marks]
        elif task.tables is not None:
            pairs = _feature_pairs(task)
            moebius = limbs.robust_moebius(a, b, pairs, task.rng)
            if moebius is not None:
                choices = [limbs.distinct(np.concatenate([task.marks, limbs.agreeing_pairs(a, b, moebius, pairs)]))]
        elif not mirrored:
            turned = spheres[0].aligned_to(spheres[1])
            spread = np.asarray(farthest_points(task.source.points, 12), np.int64)
            images = nearest_rows(b.sphere, turned.positions[spread])
            choices = [limbs.distinct(np.concatenate([task.marks, np.stack([spread, images], 1)]))]
        if not len(task.marks) and task.tables is None:
            by_curvature, same = paired_by_curvature(a, b)
        made = [one for marks in choices if len(marks) >= 3 for one in _from_marks(task, a, b, marks, name)]
        if len(by_curvature) >= 3:
            made += _from_marks(task, a, b, by_curvature, name, same)
        trusted = len(task.marks) >= 3 or task.tables is not None
        placed = {tuple(pair) for marks in (*choices, by_curvature) for pair in marks.tolist()}  # where a Möbius map took them
        # Landmarks too few, or off the limbs of shapes that are not conformal: guesses at the tips that go with them.
        for tried, guess in enumerate(limbs.guessed_marks(a, b, task.marks)):
            report(0.2)
            if made and min(one.roughness for one in made) < (SMOOTH if tried >= 4 or trusted else 0.0):
                break
            made += _from_marks(task, a, b, limbs.distinct(np.concatenate([task.marks, guess])), name)
        made.sort(key=lambda one: (not one.binding, one.roughness))
        found += made[:2]
        if made and made[0].name == name:
            tips = made[0].marks if trusted else np.array([pair for pair in made[0].marks.tolist() if tuple(pair) not in placed])
            settled |= made[0].binding or ((trusted or len(tips) > 3) and limbs.misfit(a, b, tips) < CONFORMAL)
    return found, settled


def _from_marks(task: Task, a: Sphered, b: Sphered, marks: Indices, name: str, same: bool = False) -> list[Candidate]:
    """The map by the features of the landmarks and of the tips found from them: as they are, and with stretched limbs. The first is binding
    if the shapes count as the ``same`` but for a conformal map, and not nearly isometric as well."""
    marks = limbs.without_outliers(a, b, limbs.paired_tips(a, b, marks), len(task.marks))
    first, second = limbs.features(a, b, marks)
    made = []
    for how, other in ((name, second), (f"{name}, limbs stretched", limbs.stretched(a, b, marks, first, second))):
        forward, backward = nearest_rows(other, first), nearest_rows(first, other)
        one = candidate(how, task.source, task.target, forward, backward, marks, (first, other))
        made.append(replace(one, binding=same and other is second and one.roughness > UNEVEN))
    return made


def _feature_pairs(task: Task, most: int = 1000) -> Indices:
    """Vertices that are each other's nearest by the features."""
    assert task.tables is not None
    first, second = task.tables
    scale = np.maximum(first.std(0), 1e-12 * np.abs(first).max() + 1e-300)
    first, second = first / scale, second / scale
    forward, backward = nearest_rows(second, first), nearest_rows(first, second)
    mutual = np.flatnonzero(backward[forward] == np.arange(len(forward)))
    if len(mutual) > most:
        mutual = np.sort(task.rng.choice(mutual, most, replace=False))
    return np.stack([mutual, forward[mutual]], axis=1)


def _harmonic_starts(task: Task) -> list[Candidate]:
    """Without a sphere: by potentials of point charges at the landmarks, which no conformal map changes, whatever the topology.

    ``L u = e_i - e_j`` has no mass in it, so the difference u of two charges' potentials is the same function on conformal surfaces.
    """
    a, b, marks = task.source, task.target, task.marks
    if max(len(a.operators.component_masses), len(b.operators.component_masses)) > 1:
        return []
    if len(marks) < 4 and task.tables is not None:
        pairs = _feature_pairs(task)
        if len(pairs) >= 4:
            chosen = np.asarray(farthest_points(a.points[pairs[:, 0]], min(CHARGES, len(pairs))), np.int64)
            marks = limbs.distinct(np.concatenate([marks, pairs[chosen]]))
    if len(marks) < 4:
        return []
    first, second = _potentials(a, marks[:, 0]), _potentials(b, marks[:, 1])
    others = ~np.eye(len(marks), dtype=bool)
    misfit = 2 * np.pi * float(np.sqrt(np.mean(np.square(first[marks[:, 0]] - second[marks[:, 1]])[others])))  # as of logarithms
    scale = float(np.sqrt(a.mass @ np.square(first).sum(1)))
    first, second = first / scale, second / scale
    forward, backward = nearest_rows(second, first), nearest_rows(first, second)
    return [candidate("harmonic", a, b, forward, backward, marks, (first, second), misfit < INVARIANT)]


def _potentials(surface: Surface, at: Indices) -> Floats:
    """(n, k): of a charge at each vertex against charges at all of them alike, with mean 0 over the other vertices."""
    charges = np.zeros((len(surface.mass), len(at)))
    charges[at, np.arange(len(at))] = 1.0
    charges -= surface.mass[:, None]
    grounded = plus_diagonal(surface.stiffness, np.maximum(1e-8 * surface.mass, 1e-20))
    found = Cholesky(grounded, surface.operators.coordinates).solve(charges)
    found -= found.mean(1, keepdims=True)
    there = found[at]
    found -= (there.sum(0) - np.diag(there)) / (len(at) - 1)
    return np.asarray(found, float)


def _spectral_start(task: Task) -> Candidate:
    """Without a sphere: the bases that agree on the landmarks' heat and on the features, from few functions to many."""
    a, b = task.source, task.target
    size = min(60, len(a.mass) // 4, len(b.mass) // 4)
    phi, psi = (eigenpairs(s.stiffness, size, mass=s.mass).functions for s in (a, b))
    first, second = pursuit_features(task, task.marks, np.zeros(len(b.mass)))
    few = min(max(4, first.shape[1]), size)
    u, _, v = np.linalg.svd((phi[:, :few].T @ (a.mass[:, None] * first)) @ (psi[:, :few].T @ (b.mass[:, None] * second)).T)
    left, right = phi[:, :few] @ (u @ v), psi[:, :few]
    forward, backward = nearest_rows(right, left), nearest_rows(left, right)
    for level in range(few, size + 1, 4):
        right = psi[:, :level]
        left = phi[:, :level] @ aligned(a, phi[:, :level], right, b.mass, forward, backward)
        forward, backward = nearest_rows(right, left), nearest_rows(left, right)
    return candidate("landmarks", a, b, forward, backward, task.marks)


def registered_start(task: Task) -> Candidate:
    """Near-isometric registration."""
    marks = task.marks if len(task.marks) else None
    r = register(task.source.operators, task.target.operators, landmarks=marks, descriptors=task.tables, rng=task.rng)
    forward, backward = (np.asarray(x, np.int64) for x in (r.point_map, r.inverse_map))
    task.notes.extend(f"register: {note}" for note in r.notes)
    return candidate("register", task.source, task.target, forward, backward, task.marks)


def pursuit_features(task: Task, marks: Indices, eta: Floats) -> tuple[Floats, Floats]:
    """Heat from the landmarks, in each one's metric, and the features that were given; of norm 1 on the source."""
    a, b = task.source, task.target
    first, second = np.zeros((len(a.mass), 0)), np.zeros((len(b.mass), 0))
    if len(marks):
        first, second = _bumps(a, a.mass, marks[:, 0]), _bumps(b, np.exp(eta) * b.mass, marks[:, 1])
    if task.tables is not None:
        first, second = np.column_stack([first, task.tables[0]]), np.column_stack([second, task.tables[1]])
    norms = np.sqrt(a.mass @ first**2)
    norms = np.where(norms > 0, norms, 1.0)
    return first / norms, second / norms
