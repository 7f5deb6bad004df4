"""Sliced Wasserstein distances between weighted point sets, and the rotation that minimizes them (section 8.3.3, (8.30)-(8.32))."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from . import _core, arrays
from .arrays import Floats
from .errors import InputError
from .progress import Progress, reporter, teller

__all__ = [
    "RotationInvariantSlicedWassersteinResult",
    "orthonormal_directions",
    "rotation_invariant_sliced_wasserstein",
    "sliced_wasserstein",
]

_SAMPLE = 1000  # points that rotations are tried on before the best few see all points


def orthonormal_directions(dimension: int, count: int, *, rng: int | np.random.Generator | None = 0) -> Floats:
    """Unit vectors in blocks of orthonormal frames, each frame drawn uniformly (Haar) and independently.

    Each block B has ``B.T @ B = I``: so the mean of ``(t . u)**2`` over the directions u is exactly ``|t|**2 / n``, and a step of
    :func:`rotation_invariant_sliced_wasserstein` is the exact minimizer.

    Parameters
    ----------
    dimension : int
        n.
    count : int
        How many at least; rounded up to whole blocks.
    rng : int or numpy Generator

    Returns
    -------
    (T, n) array

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> directions = bt.sliced.orthonormal_directions(3, 10, rng=1)
    >>> directions.shape, bool(np.allclose(directions.T @ directions, 4 * np.eye(3)))
    ((12, 3), True)
    """
    dimension, count = arrays.whole(dimension, "dimension", 1), arrays.whole(count, "count", 1)
    arrays.room(4.0 * (count + dimension) * dimension, f"{count} directions in R^{dimension}", "a few hundred are enough")
    blocks = arrays.generator(rng).standard_normal((-(-count // dimension), dimension, dimension))
    q, r = np.linalg.qr(blocks)
    # QR alone fixes signs by its own convention; R with a positive diagonal makes Q uniform (Mezzadri 2007)
    frames = q * np.where(np.diagonal(r, axis1=1, axis2=2) < 0, -1.0, 1.0)[:, None, :]
    return np.ascontiguousarray(frames.transpose(0, 2, 1).reshape(-1, dimension))


def _measures(
    source: npt.ArrayLike, target: npt.ArrayLike, source_weights: npt.ArrayLike | None, target_weights: npt.ArrayLike | None
) -> tuple[Floats, Floats, Floats | None, Floats | None, float]:
    """The two measures, and the power of two that their coordinates have been divided by: 1 but for huge or tiny ones."""
    x, y = arrays.floats(source, "source", (None, None)), arrays.floats(target, "target", (None, None))
    if x.shape[1] != y.shape[1] or 0 in x.shape + y.shape:
        raise InputError(f"source has shape {x.shape}, target {y.shape}; (n, D) and (m, D) with the same D are needed, and a point in each")
    a, b = (
        None if weights is None else arrays.floats(weights, name, (len(points),))
        for weights, name, points in ((source_weights, "source_weights", x), (target_weights, "target_weights", y))
    )
    most = max(float(abs(x).max()), float(abs(y).max()))
    if most == 0 or 1e-100 <= most <= 1e100:
        return x, y, a, b, 1.0
    scale = float(2.0 ** np.floor(np.log2(most)))
    return x / scale, y / scale, a, b, scale


def _directions(directions: int | npt.ArrayLike, dimension: int, rng: np.random.Generator) -> Floats:
    if np.ndim(directions) == 0:
        return orthonormal_directions(dimension, arrays.whole(directions, "directions", 1), rng=rng)
    return arrays.floats(directions, "directions", (None, dimension))


def sliced_wasserstein(
    source: npt.ArrayLike,
    target: npt.ArrayLike,
    *,
    source_weights: npt.ArrayLike | None = None,
    target_weights: npt.ArrayLike | None = None,
    directions: int | npt.ArrayLike = 100,
    rng: int | np.random.Generator | None = 0,
    progress: Progress = None,
) -> float:
    """Compute the sliced Wasserstein distance of order 2 between two weighted point sets.

    The square root of the mean, over unit directions, of the squared Wasserstein distance between the two projections.

    Parameters
    ----------
    source : (n, D) array
    target : (m, D) array
        In the same units; numbers of points may differ.
    source_weights : (n,) array, optional
    target_weights : (m,) array, optional
        At least 0; divided by their sums. None: equal weights.
    directions : int or (T, D) array
        Minimum number (drawn by :func:`orthonormal_directions`), or unit vectors.
    rng : int or numpy Generator
        Seed or generator for the directions. Calls with the same seed use the same directions, so their distances satisfy the triangle
        inequality.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    float
        In the units of the points.

    Raises
    ------
    InputError
        If shapes do not fit, a number is not finite, weights are negative or all 0, or directions are not of length 1.

    See Also
    --------
    rotation_invariant_sliced_wasserstein

    References
    ----------
    Rabin, Peyré, Delon, Bernot, Wasserstein barycenter and its application to texture mixing, SSVM 2011.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> x = np.random.default_rng(0).normal(size=(100, 3))
    >>> round(bt.sliced_wasserstein(x, x[::-1] + [3.0, 0.0, 0.0]), 12) == round(3 / 3**0.5, 12)
    True
    """
    x, y, a, b, scale = _measures(source, target, source_weights, target_weights)
    theta = _directions(directions, x.shape[1], arrays.generator(rng))
    return scale * _core.sliced_distance(x, y, a, b, theta, reporter(progress, "sliced Wasserstein"))


@dataclass(frozen=True, eq=False)
class RotationInvariantSlicedWassersteinResult:
    """What :func:`rotation_invariant_sliced_wasserstein` found.

    Attributes
    ----------
    distance : float
        The sliced distance between ``source @ rotation`` and ``target``, in the units of the points.
    rotation : (D, D) array
        Orthogonal; its determinant may be -1.
    history : dict of str to ndarray
        ``distance`` (iterations + 1,): at each rotation of the run that led here; never rises.
    iterations : int
        Number of iterations.
    converged : bool
        Whether the last step reduced the squared distance by less than `tolerance`, relatively.
    directions : (T, D) array
        The directions that were used.
    """

    distance: float
    rotation: Floats
    history: dict[str, Floats]
    iterations: int
    converged: bool
    directions: Floats

    def __repr__(self) -> str:
        state = "" if self.converged else ", NOT CONVERGED"
        return f"RotationInvariantSlicedWassersteinResult(distance {self.distance:.6g} after {self.iterations} iterations{state})"


def _polar(cross: Floats) -> Floats:
    """U V^T: the orthogonal matrices nearest to those given."""
    u, _, v = np.linalg.svd(cross)
    product: Floats = u @ v
    return product


@dataclass
class Run:
    rotation: Floats
    value: float = np.inf
    history: list[float] = field(default_factory=list)
    converged: bool = False


def alternate(alignment: _core.SlicedAlignment, runs: list[Run], steps: int, tolerance: float) -> list[Run]:
    """Couplings, then the rotation that is best for them, and again; several runs at a time, each from where it is.

    With directions in orthonormal blocks a step never makes the value larger but by rounding. Steps are lengthened (Nesterov's
    extrapolation); where that makes the value larger, the run goes back to its best rotation and on with a plain step.
    """
    trial = [run.rotation for run in runs]  # where each run looks next
    plain = list(trial)  # the plain step from its best rotation
    lengthened = [0] * len(runs)  # steps since the last plain one
    active = [index for index, run in enumerate(runs) if not run.converged]
    for step in range(steps + 1):
        if not active:
            break
        cross, values = alignment.step(np.array([trial[index] for index in active]))
        ahead = _polar(cross)
        going = []
        for index, value, new in zip(active, values.tolist(), ahead, strict=True):
            run = runs[index]
            enough = step == 0 or value < run.value * (1 - tolerance)
            if value < run.value:
                run.rotation, run.value = trial[index], value
                run.history.append(value)
            if enough and value > 0:
                share = lengthened[index] / (lengthened[index] + 3)
                trial[index] = new + share * (new - plain[index]) if share else new
                plain[index] = new
                lengthened[index] += 1
                going.append(index)
            elif lengthened[index] > 1 and value > 0:
                trial[index], lengthened[index] = plain[index], 0
                going.append(index)
            else:
                run.converged = True
        active = going
        for index, rotation in zip(active, _polar(np.array([trial[index] for index in active])) if active else (), strict=True):
            trial[index] = rotation
    return runs


def _starts(x: Floats, y: Floats, a: Floats | None, b: Floats | None, rng: np.random.Generator) -> Floats:
    """Rotations to begin with: principal axes on principal axes with all signs of the leading ones (and, up to three dimensions, in
    all orders), the identity, and some at random. With x and y exchanged these are the transposed ones."""
    dimension = x.shape[1]

    def axes(points: Floats, weights: Floats | None) -> tuple[Floats, Floats]:
        share = np.full(len(points), 1 / len(points)) if weights is None else weights / max(weights.sum(), np.finfo(float).tiny)
        frame = np.linalg.eigh((points * share[:, None]).T @ points)[1][:, ::-1]
        return frame, share @ (points @ frame) ** 3

    (source, source_skew), (target, target_skew) = axes(x, a), axes(y, b)
    free = min(dimension, 6)
    rest = np.where(source_skew * target_skew < 0, -1.0, 1.0)[free:]
    signs = np.array([[*sign, *rest] for sign in itertools.product((1.0, -1.0), repeat=free)])
    middle = [np.diag(sign) for sign in signs]
    if dimension <= 3:
        orders = [np.eye(dimension)[list(order)] for order in itertools.permutations(range(dimension))]
        middle = [order @ diagonal for order in orders for diagonal in middle]
    for random in _polar(rng.standard_normal((8, dimension, dimension))):
        middle += [random, random.T]
    return np.concatenate([np.eye(dimension)[None], source @ np.array(middle) @ target.T])


Measure = tuple[Floats, Floats | None]


def _samples(points: Floats, weights: Floats | None, seed: int) -> list[Measure]:
    """Some of many points, in two ways: at random; and evenly by mass along an order that no rotation changes, so that rotated copies
    are sampled alike, whatever their numbering, and heavy points are never left out."""
    count = len(points)
    if count <= _SAMPLE * 3 // 2:
        return [(points, weights)]
    chosen = np.sort(np.random.default_rng([seed, count]).choice(count, _SAMPLE, replace=False))
    part = None if weights is None else weights[chosen]
    random: Measure = (np.ascontiguousarray(points[chosen]), part) if part is None or part.any() else (points, weights)
    share = np.full(count, 1 / count) if weights is None else weights / max(weights.sum(), np.finfo(float).tiny)
    x = points / max(float(np.abs(points).max()), np.finfo(float).tiny)
    middle, moment = share @ x, (x * share[:, None]).T @ x
    order = np.argsort(np.einsum("ij,ij->i", x, x + middle + x @ moment), kind="stable")
    masses = np.cumsum(share[order])
    at = np.searchsorted(masses, (np.arange(_SAMPLE) + 0.5) / _SAMPLE * masses[-1])
    chosen, times = np.unique(order[np.minimum(at, count - 1)], return_counts=True)
    return [random, (np.ascontiguousarray(points[chosen]), times.astype(np.float64))]


def _distinct(runs: list[Run], most: int) -> list[Run]:
    """The best runs, without those that ended in the same place."""
    kept: list[Run] = []
    for run in sorted(runs, key=lambda run: run.value):
        if len(kept) < most and all(abs(run.rotation - other.rotation).max() > 1e-3 for other in kept):
            kept.append(run)
    return kept


def rotation_invariant_sliced_wasserstein(
    source: npt.ArrayLike,
    target: npt.ArrayLike,
    *,
    source_weights: npt.ArrayLike | None = None,
    target_weights: npt.ArrayLike | None = None,
    directions: int | npt.ArrayLike = 100,
    rng: int | np.random.Generator | None = 0,
    starts: npt.ArrayLike | None = None,
    max_iterations: int = 300,
    tolerance: float = 1e-10,
    progress: Progress = None,
) -> RotationInvariantSlicedWassersteinResult:
    """Compute the smallest sliced Wasserstein distance over all rotations and reflections of one point set.

    Runs the chapter's alternation from several rotations R: project ``source @ R`` and ``target``, couple the projections, form
    ``H = 1/T sum_t X^T D_t Y theta_t theta_t^T``, take ``R = U V^T`` from its singular value decomposition, and repeat. This is done in
    both orders, ``source`` to ``target`` and back, which differ for finitely many directions. The smaller value is returned, so the
    distance is symmetric.

    Parameters
    ----------
    source : (n, D) array
    target : (m, D) array
        In the same units; numbers of points may differ. They are rotated about the origin and not shifted: subtract the means first
        if shifts should not matter.
    source_weights : (n,) array, optional
    target_weights : (m,) array, optional
        At least 0; divided by their sums. None: equal weights.
    directions : int or (T, D) array
        Minimum number (drawn by :func:`orthonormal_directions`), or unit vectors. With vectors in no orthonormal blocks the
        alternation ends where it would rise.
    rng : int or numpy Generator
        Seed or generator for the directions and some of the starts.
    starts : (k, D, D) array, optional
        Rotations to begin with, instead of principal axes with all signs and some at random.
    max_iterations : int
        Steps of the last run in each order.
    tolerance : float
        A run has converged when a step reduces the squared distance by less than this, relatively.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    RotationInvariantSlicedWassersteinResult
        ``.distance``, ``.rotation`` (``source @ rotation`` is close to ``target``), ``.history``, ``.converged``.

    Raises
    ------
    InputError
        If shapes do not fit, a number is not finite, weights are negative or all 0, or directions are not of length 1.
    Cancelled
        If ``progress`` returned False.

    Notes
    -----
    Steps are extended by Nesterov extrapolation where that reduces the objective. The objective has many local minima; the best one
    found is returned. More can be tried with ``starts``.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> rng = np.random.default_rng(0)
    >>> x, turn = rng.gamma(2.0, size=(200, 3)) * [3, 2, 1], np.linalg.qr(rng.normal(size=(3, 3)))[0]
    >>> found = bt.rotation_invariant_sliced_wasserstein(x, rng.permutation(x @ turn))
    >>> bool(found.distance < 1e-12), bool(np.allclose(found.rotation, turn))
    (True, True)
    """
    x, y, a, b, scale = _measures(source, target, source_weights, target_weights)
    dimension = x.shape[1]
    generator = arrays.generator(rng)
    theta = _directions(directions, dimension, generator)
    most, tolerance = arrays.whole(max_iterations, "max_iterations", 1), arrays.number(tolerance, "tolerance", least=0.0)
    report = teller(reporter(progress, "sliced Wasserstein"))
    if starts is None:
        first = _starts(x, y, a, b, generator)
    else:
        first = arrays.floats(starts, "starts", (None, dimension, dimension))
        if len(first) == 0 or abs(first @ first.transpose(0, 2, 1) - np.eye(dimension)).max() > 1e-6:
            raise InputError("starts must be orthogonal matrices, at least one")
        first = _polar(first)
    seed = int(generator.integers(2**31))
    few = theta[: dimension * -(-40 // dimension)] if np.ndim(directions) == 0 else theta
    tried = list(itertools.zip_longest(_samples(x, a, seed), _samples(y, b, seed)))
    rotations: list[Floats] = []
    for part, pair in enumerate(tried):
        (p, u), (q, v) = pair[0] or (x, a), pair[1] or (y, b)
        # both orders see the same rotations, one of them transposed
        ends: list[Run] = []
        for order, (s, t, sw, tw) in enumerate(((p, q, u, v), (q, p, v, u))):
            coarse = _core.SlicedAlignment(s, t, sw, tw, few)
            runs = [Run(rotation.T if order else rotation) for rotation in first]
            while True:  # a few steps each, the better half goes on
                runs = _distinct(alternate(coarse, runs, 4, tolerance), max(len(runs) // 2, 3))
                report(0.5 * (part + 0.5 * (order + 1 / len(runs))) / len(tried))
                if len(runs) <= 3:
                    break
            runs = _distinct(alternate(coarse, runs, 30, tolerance), 2)
            ends += [Run(run.rotation.T if order else run.rotation, run.value) for run in runs]
        rotations += [run.rotation for run in _distinct(ends, 3 - part)]
    if starts is None:
        rotations.append(np.eye(dimension))
    best: tuple[Run, Floats] | None = None
    for order, (s, t, sw, tw) in enumerate(((x, y, a, b), (y, x, b, a))):
        report(0.5 + 0.25 * order)
        full = _core.SlicedAlignment(s, t, sw, tw, theta)
        runs = alternate(full, [Run(rotation.T if order else rotation) for rotation in rotations], 10, tolerance)
        (run,) = alternate(full, _distinct(runs, 1), most, tolerance)
        if best is None or run.value < best[0].value:
            best = run, run.rotation.T if order else run.rotation
    assert best is not None
    report(1.0)
    run, rotation = best
    return RotationInvariantSlicedWassersteinResult(
        distance=scale * float(np.sqrt(run.value)),
        rotation=np.ascontiguousarray(rotation),
        history={"distance": scale * np.sqrt(np.array(run.history))},
        iterations=len(run.history) - 1,
        converged=run.converged,
        directions=theta,
    )
