"""Matching of shapes that are far from isometric: conformal Laplace-Beltrami basis pursuit (section 8.3.3, equations 8.33 and 8.34).

In two dimensions a change w² of the metric changes the mass and leaves the stiffness as it is. So a target with any conformal factor has a
basis Ψ, orthonormal under diag(w² m), that costs one generalized eigenproblem; and a target that is conformal to the source has, with
the right factor, the source's own basis. The pursuit looks for both. What it cannot do is start from nothing: the start comes from the
spherical conformal maps (:mod:`beltrami.basis_pursuit.limbs`), from landmarks, features or :func:`register`.
"""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..arrays import Floats
from ..eigen import eigenpairs
from ..errors import ConvergenceError, InputError, NumericalError
from ..operators import Operators, operators
from ..progress import Progress, reporter, teller
from ..shapes import Shape
from .pursuit import pursue
from .result import ConformalRegistrationResult
from .spectra import SpectrumMatch, conformal_eigenpairs, match_spectrum, surface_only
from .starts import MISSED, Orientation, Start, Task, candidate, first_maps, registered_start, smoothest, upsampled
from .surface import Indices, Surface, nearest_rows

__all__ = ["ConformalRegistrationResult", "SpectrumMatch", "conformal_eigenpairs", "match_spectrum", "register_conformal"]

TRUSTED = 0.05  # share of sqrt(area) there and back at which the confidence has fallen to 1 / e


def _landmarks(value: Any, count: int, other: int) -> Indices:
    """Pairs of vertices, none of which is named twice."""
    if value is None:
        return np.zeros((0, 2), np.int64)
    marks = arrays.pairs(value, "landmarks", count, other)
    for side, name in ((0, "source"), (1, "target")):
        found, times = np.unique(marks[:, side], return_counts=True)
        if (times > 1).any():
            twice = int(found[times > 1][0])
            rows = np.flatnonzero(marks[:, side] == twice)
            same = len(np.unique(marks[rows, 1 - side])) == 1
            what = "are repeated" if same else "contradict each other"
            raise InputError(f"landmarks {rows[0]} and {rows[1]} {what}: both name vertex {twice} of the {name}; keep one of them")
    return marks


def _tables(value: Any, count: int, other: int) -> tuple[Floats, Floats] | None:
    if value is None:
        return None
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise InputError("features must be a pair (F, G) of arrays: functions on the source and the same functions on the target")
    found = []
    for table, name, n in ((value[0], "F", count), (value[1], "G", other)):
        array = np.asarray(table)
        if array.ndim not in (1, 2) or array.shape[0] != n:
            raise InputError(f"features {name} has shape {array.shape}; ({n}, k) is needed, a row per vertex")
        found.append(arrays.floats(array.reshape(n, -1), f"features {name}", (n, None)))
    if found[0].shape[1] != found[1].shape[1] or found[0].shape[1] == 0:
        raise InputError(f"features have {found[0].shape[1]} and {found[1].shape[1]} functions; equally many, at least one, are needed")
    return found[0], found[1]


def register_conformal(
    source: Shape | Operators,
    target: Shape | Operators,
    *,
    landmarks: npt.ArrayLike | None = None,
    features: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    k: int = 20,
    start: Start = "auto",
    refine: int | None = 100,
    sweeps: int = 4,
    misfit_weight: float = 10.0,
    smoothness: float = 0.3,
    orientation: Orientation = "preserving",
    rng: int | np.random.Generator | None = 0,
    progress: Progress = None,
) -> ConformalRegistrationResult:
    """Match two shapes that are far from isometric: find a point map, a conformal factor and bases (equations 8.33 and 8.34).

    Several maps are computed: for surfaces of genus 0 from their conformal maps to the sphere, determined by landmarks, features or
    the tips of the shapes, with and without stretched limbs; otherwise from landmarks and features. The best is refined and, unless
    the shapes prove to be conformal, compared with that of :func:`register`. The map with the smoothest conformal factor is chosen.
    From its factor the alternation of the paper starts: Ψ by splitting, η by Gauss-Newton.

    Parameters
    ----------
    source, target : TriangleMesh, PointCloud or Operators
        Surfaces.
    landmarks : array_like (k, 2) of int, optional
        Pairs of vertices, source and target.
    features : pair of array_like (n_source, c) and (n_target, c), optional
        The same functions on both: descriptors, label maps, anything with one row per vertex.
    k : int
        Size of the bases Φ and Ψ; the alternation grows from 10.
    start : {"auto", "spherical", "landmarks", "register"}
        ``"spherical"`` needs closed surfaces of genus 0; ``"landmarks"`` needs landmarks or features; ``"register"`` is
        near-isometric registration. ``"auto"`` uses whatever applies.
    refine : int or None
        Size of the basis to which the map is refined by upsampling in the metric of its factor; None: no refinement.
    sweeps : int
        Maximum number of sweeps of the alternation per level; 0 keeps the initial factor and its eigenbasis.
    misfit_weight, smoothness : float
        Weights of the misfit of the features and of the change of η, ``∫ |grad δη|² + δη²``, relative to the mean Dirichlet energy of Φ.
    orientation : {"preserving", "reversing", "any"}
        Of the map, for spherical starts: ``"reversing"`` for a mirror image of the source.
    rng : int or numpy Generator
        For the sampling of feature pairs.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    ConformalRegistrationResult

    Raises
    ------
    InputError
        Landmarks are out of range, repeated or contradictory, features do not fit, or nothing determines the map.
    TopologyError
        ``start="spherical"`` and a shape is not closed, connected and of genus 0.

    References
    ----------
    Schonsheck, Bronstein and Lai, Nonisometric surface registration via conformal Laplace-Beltrami basis pursuit, 2021.
    Melzi, Ren, Rodolà, Sharma, Wonka and Ovsjanikov, ZoomOut: spectral upsampling for efficient shape correspondence, 2019.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> sphere = bt.shapes.sphere(3)
    >>> moved = bt.TriangleMesh(bt.Moebius.translation([0.3, 0.1, -0.2])(sphere.vertices), sphere.faces)
    >>> marks = np.repeat(bt.farthest_points(sphere, 12), 2).reshape(-1, 2)
    >>> r = bt.register_conformal(sphere, moved, landmarks=marks, k=10)
    >>> bool((r.point_map == np.arange(642)).all())
    True
    """
    given = [operators(source), operators(target)]
    for ops in given:
        surface_only(ops)
    a, b = Surface(given[0]), Surface(given[1])
    counts = len(a.mass), len(b.mass)
    marks, tables = _landmarks(landmarks, *counts), _tables(features, *counts)
    k = arrays.whole(k, "k", 4, min(counts) - 1)
    finest = None if refine is None else arrays.whole(refine, "refine", 10)
    sweeps = arrays.whole(sweeps, "sweeps", 0)
    first, second = arrays.number(misfit_weight, "misfit_weight", above=0), arrays.number(smoothness, "smoothness", above=0)
    arrays.word(start, "start", get_args(Start))
    arrays.word(orientation, "orientation", get_args(Orientation))
    report = teller(reporter(progress, "register conformal"))
    task = Task(a, b, marks, tables, arrays.generator(rng), orientation, [])

    candidates, settled = first_maps(task, start, report)
    report(0.4)
    best = smoothest(task, candidates)
    size = max(k, min(finest or k, min(counts) // 4))
    pairs = eigenpairs(a.stiffness, size, mass=a.mass)
    if finest is not None:
        levels = sorted({max(k, (share * size) // 10) for share in (4, 7, 10)})
        try:
            candidates.append(upsampled(task, pairs.functions, best, levels, report))
        except (ConvergenceError, NumericalError) as error:
            task.notes.append(f"not refined: {error}")
        best = smoothest(task, candidates)
    report(0.6)
    if not settled:
        try:
            candidates.append(registered_start(task))
        except (InputError, NumericalError, ConvergenceError) as error:
            task.notes.append(f"no near-isometric start: {error}")
        best = smoothest(task, candidates)
    report(0.7)

    phi = pairs.functions[:, :k]
    pursuit, history, levels_of, converged = pursue(task, best, pairs, k, sweeps, (first, second), report)
    left, right = phi, pursuit.psi
    found = candidate("pursuit", a, b, nearest_rows(right, left), nearest_rows(left, right), best.marks)
    candidates.append(found)
    best = smoothest(task, candidates)
    report(1.0)

    if len(marks):
        missed = task.missed(best.forward)
        if missed.max() > MISSED:
            row = int(np.argmax(missed))
            task.notes.append(
                f"the map misses {int((missed > MISSED).sum())} of {len(marks)} landmarks by more than {MISSED} sqrt(area); the worst is "
                f"landmark {row} (vertices {marks[row, 0]} and {marks[row, 1]}), by {missed[row]:.2f}: look whether it is right"
            )
    there_and_back = np.sqrt(((a.points - a.points[best.backward[best.forward]]) ** 2).sum(1))
    area = a.unit**2
    weight = np.exp(pursuit.eta) * b.mass
    gram = pursuit.psi.T @ (weight[:, None] * pursuit.psi)
    reached = np.zeros(counts[1], bool)
    reached[best.forward] = True
    return ConformalRegistrationResult(
        source=given[0].shape,
        target=given[1].shape,
        point_map=best.forward,
        inverse_map=best.backward,
        log_factor=pursuit.eta + np.log(area / b.unit**2),
        source_basis=phi / a.unit,
        basis=pursuit.psi / a.unit,
        values=pairs.values[:k] / area,
        orthonormality_error=float(np.abs(gram - np.eye(k)).max()),
        objective=history[-1],
        history={"objective": np.array(history), "level": np.array(levels_of, np.int64)},
        roughness={one.name: one.roughness for one in candidates},
        landmarks=best.marks,
        coverage=float(b.mass[reached].sum()),
        confidence=np.exp(-there_and_back / TRUSTED),
        consistency=float(a.mass @ there_and_back),
        start=best.name,
        iterations=len(history) - len(set(levels_of)),
        converged=converged,
        notes=tuple(task.notes),
    )
