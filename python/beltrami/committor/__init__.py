"""Committor functions and reaction rates on point clouds and meshes of any dimension (section 8.4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..arrays import Floats
from ..clouds import CloudOperators, LeastSquaresOperators
from ..errors import Cancelled, Error, InputError, NumericalError
from ..near import nearest_neighbors
from ..operators import Operators, operators
from ..progress import Progress, part, reporter, teller
from ..sampling import poisson_disc
from ..shapes import PointCloud, Shape
from . import weighted
from .currents import reactive_current, slab_fluxes
from .diagnostics import CommittorDiagnostics, diagnosed
from .result import CommittorResult, FreeEnergyResult, IsocommittorResult, Method
from .samples import Sampling, reweight, sample_density, sampled
from .solve import System, checked, expected_spacing, rotating_form, strong_form, weak_form
from .weighted import Function, Mask

__all__ = [
    "CommittorDiagnostics",
    "CommittorResult",
    "FreeEnergyResult",
    "IsocommittorResult",
    "committor",
    "reweight",
    "sample_density",
]


_System = System  # the name that pickles of earlier layouts have


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
    """The probability of reaching B before A, and the rate of reactions, for ``dX = -grad U dt + sqrt(2 / β) dW`` on a shape.

    Parameters
    ----------
    shape : PointCloud, TriangleMesh or Operators
        Points of any density in R^D; a cloud may have dimension 1, 2 or 3. Trajectories are reflected at its boundary.
    potential : array_like (n,), callable, or None
        U at the points; or a function of (k, D) positions with (k,) values, which is then evaluated between the points too; or None if
        U follows from the samples (see ``sampling``).
    A, B : array_like of bool (n,), of point numbers, or callable
        Disjoint sets. A callable is either a level function of (k, D) positions, negative inside, so that edges are cut where they cross
        its zero level; or a predicate that returns (k,) bool, which is a mask. The boundary of other sets is assumed half-way to the
        surrounding points, or at the outermost members if these lie in a row.
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
        Inverse temperature of the samples for ``"gibbs"`` (default β) and ``"mixed"`` (one per sample).
    circulation : array_like (n, D), optional
        A further drift ``l`` that keeps the Gibbs density, ``div(exp(-β U) l) = 0``: the dynamics is then not reversible, and
        ``q_backward`` is solved for too.
    refine : int, optional
        How many times triangles are divided into four, with U a quadratic on each: 1 for surfaces by default; 0 is faster. Surfaces
        only.
    max_points : int, optional
        Clouds with more points are thinned evenly to about this number (no two points closer than a radius, and no omitted point farther
        from them than that). They carry the masses of the omitted points, for which q is fitted. Densities count all points.
    bootstrap : int
        How many half-samples (without replacement) the error of the rate is estimated from; 0 for none. Clouds only.
    block : int
        Points are drawn in blocks of this many consecutive ones: for trajectories, the correlation time.
    rng : int or numpy Generator
        Seed or generator of the half-samples.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

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
    energy, assumption = sampled(ops, potential, sampling, weights, sample_beta, beta)
    function = potential if energy is None and callable(potential) else None
    if energy is None:
        energy = _potential(potential, points)
    drift = None if circulation is None else arrays.floats(circulation, "circulation", points.shape)
    least = float(energy.min())
    energy = energy - least
    with np.errstate(over="ignore"):
        u = beta * energy
    checked(u, a, b, beta)
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
        reach = expected_spacing(ops, u[part_of])
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
    numbers = 250.0 if method == "weak" and drift is None else 320.0  # as measured; GMRES keeps its directions
    arrays.room(numbers * 4**levels * len(ops.mass), f"refine = {levels} of {len(ops.mass)} points", remedy)
    system = weak_form(
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
        values, slopes = strong_form(ops, u[part_of], a[part_of], b[part_of], None if drift is None else drift[part_of], beta, system)
        outside = float(((values < -1e-10) | (values > 1 + 1e-10)).mean())
        system = replace(system, q=np.clip(values, 0, 1))
        rate = float((system.gibbs * np.square(slopes).sum(1)).sum()) / (beta * partition)
    else:
        if drift is not None:
            system = replace(system, q=rotating_form(system, drift[part_of], False))
            jump = system.q[system.mesh.first] - system.q[system.mesh.second]
        rate = float((system.conductance * jump * jump).sum()) / (beta * partition)
    backward = 1 - system.q if drift is None else rotating_form(system, drift[part_of], True)
    if not (np.isfinite(rate) and rate > 0):
        raise NumericalError(f"the rate is {rate:g}: out of the range of double precision; measure in other units, or take another beta")
    ahead = system.q if drift is None else 1 - backward
    share_a, share_b = (float((system.gibbs * share).sum()) / partition for share in (backward, ahead))
    unit = float(np.ldexp(1.0, np.frexp(rate)[1] - 1))  # a power of 2, so that squares stay in range and no digit changes
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        fluxes = slab_fluxes(system, partition, unit)
        flux, flux_error = (float(value) * unit for value in (fluxes.mean(), fluxes.std(ddof=1)))
        constants = [float(np.float64(rate) / share) for share in (share_a, share_b)]
    if not np.isfinite([flux, flux_error, *constants]).all():
        raise NumericalError("rates are out of the range of double precision; measure in other units, or take a larger beta")
    with np.errstate(over="ignore", invalid="ignore"):
        current = reactive_current(system, partition) if drift is None else reactive_current(system, partition, backward, drift[part_of])
    if not np.isfinite(current).all():
        raise NumericalError("the current is out of the range of double precision; measure in other units")
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
        rate_flux_error=flux_error, rate_constant=constants[0], rate_constant_backward=constants[1], share_A=share_a,
        current=current, reactive_density=amount * q * q_backward, potential=energy, in_A=a, in_B=b, beta=beta, method=method,
        assumption=assumption, replicates=errors, diagnostics=diagnosed(system, outside, flux / rate - 1), _system=system,
        _partition=partition, _kept=kept,
    )  # fmt: skip


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
