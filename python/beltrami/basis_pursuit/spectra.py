"""Eigenpairs under a conformal change of the metric (equation 8.33), and the change that gives a shape a prescribed spectrum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..arrays import Floats
from ..eigen import Eigenpairs, eigenpairs
from ..errors import InputError
from ..operators import Operators, operators
from ..progress import Progress, reporter, teller
from ..shapes import Shape
from ..solvers import Cholesky, plus_diagonal
from .surface import Indices


def conformal_eigenpairs(
    shape: Shape | Operators, log_factor: npt.ArrayLike, k: int, *, start: Any = None, progress: Progress = None
) -> Eigenpairs:
    """Compute eigenpairs of the shape with its metric multiplied by ``exp(log_factor)``: ``L ψ = λ diag(exp(η) m) ψ`` (equation 8.33).

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        A surface: only in dimension 2 a conformal factor leaves the stiffness unchanged.
    log_factor : array_like (n,)
        η = log w² at the vertices.
    k : int
        How many.
    start : array_like (n, c), optional
        Vectors close to the wanted ones, see :func:`eigenpairs`.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    Eigenpairs
        ``functions`` are orthonormal under ``exp(η) m``.

    Raises
    ------
    InputError
        η has the wrong length, is not finite, or spans more than 200 (a factor of 10^86).

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> sphere = bt.shapes.sphere(4)
    >>> twice = bt.conformal_eigenpairs(sphere, np.full(len(sphere.vertices), np.log(4.0)), 4)
    >>> abs(twice.values).round(2)  # a sphere of radius 2
    array([0. , 0.5, 0.5, 0.5])
    """
    ops = operators(shape)
    surface_only(ops)
    eta = _log_factor(log_factor, len(ops.mass))
    level = float(eta.max())  # taken out, so that no exponential overflows
    if not abs(level) < 600:
        raise InputError(f"log_factor reaches {level:g}; exp of it leaves the range of double precision")
    scale = np.exp(level)
    found = eigenpairs(ops.stiffness, k, mass=np.exp(eta - level) * ops.mass, start=start, progress=progress)
    return Eigenpairs(found.values / scale, found.functions / np.sqrt(scale), found.residuals / np.sqrt(scale), found.iterations, ops.shape)


def surface_only(ops: Operators) -> None:
    dimension = ops.shape.intrinsic_dimension
    if dimension != 2:
        raise InputError(f"the shape has dimension {dimension}; a conformal change leaves the stiffness as it is for surfaces only")


def _log_factor(value: npt.ArrayLike, count: int) -> Floats:
    eta = arrays.floats(value, "log_factor", (count,))
    if float(np.ptp(eta)) > 200:
        raise InputError(f"log_factor spans {float(np.ptp(eta)):.3g}; at most 200 (a factor of 10^86) can be resolved")
    return eta


@dataclass(frozen=True, eq=False, repr=False)
class SpectrumMatch:
    """A conformal factor with which a shape has a given spectrum.

    Attributes
    ----------
    log_factor : ndarray (n,)
        η = log w².
    pairs : Eigenpairs
        The eigenpairs of the shape with that factor.
    wanted : ndarray (k,)
        The prescribed eigenvalues.
    error : float
        Largest relative difference from them, without the zero.
    history : dict of str to ndarray
        ``objective`` of each step; it never rises.
    converged : bool
        Whether the error reached the tolerance.
    """

    log_factor: Floats
    pairs: Eigenpairs
    wanted: Floats
    error: float
    history: dict[str, Floats]
    converged: bool

    def __repr__(self) -> str:
        state = "" if self.converged else ", NOT CONVERGED"
        return f"SpectrumMatch({len(self.wanted)} values, relative error {self.error:.2e}, {len(self.history['objective'])} steps{state})"


def match_spectrum(
    shape: Shape | Operators,
    values: npt.ArrayLike,
    *,
    smoothness: float = 1e-6,
    tolerance: float = 1e-3,
    max_iterations: int = 40,
    progress: Progress = None,
) -> SpectrumMatch:
    """Find a conformal factor exp(η) that gives the shape prescribed eigenvalues.

    Gauss-Newton on the logarithms of the eigenvalues, whose derivative is ``-∫ ψ² exp(η) δη``, with ``smoothness/2 ∫ |grad η|²``
    added; a step that does not lower the objective is shortened.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        Connected, of dimension 2.
    values : array_like (k,)
        Ascending, in 1 / length², beginning with the zero of the constant function.
    smoothness : float
        Weight of the Dirichlet energy of η relative to the squared logarithmic errors.
    tolerance : float
        Relative error of the eigenvalues at which to stop.
    max_iterations : int
        Iterations after which the best answer so far is returned, with ``converged=False``.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    SpectrumMatch

    Raises
    ------
    InputError
        Values are not ascending, do not begin with zero, or are fewer than two.

    Notes
    -----
    Many factors have the same spectrum (at least those that a symmetry exchanges): the answer is one near η = constant.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> ellipsoid = bt.eigenpairs(bt.shapes.ellipsoid(1.0, 0.9, 0.8, level=3), 6).values
    >>> bt.match_spectrum(bt.shapes.sphere(3), ellipsoid).error < 1e-3
    True
    """
    ops = operators(shape)
    surface_only(ops)
    wanted = arrays.floats(values, "values", (None,))
    if len(wanted) < 2 or len(wanted) > len(ops.mass):
        raise InputError(f"values has {len(wanted)} numbers; from 2 to the number of vertices ({len(ops.mass)}) are needed")
    if (np.diff(wanted) < 0).any() or abs(wanted[0]) > 1e-6 * wanted[1] or not wanted[1] > 0:
        raise InputError("values must ascend, and only the first, of the constant function, is zero")
    weight, tolerance = arrays.number(smoothness, "smoothness", above=0), arrays.number(tolerance, "tolerance", above=0)
    steps = arrays.whole(max_iterations, "max_iterations", 1)
    if len(ops.component_masses) > 1:
        raise InputError(f"the shape has {len(ops.component_masses)} components; match the spectrum of one")
    report = teller(reporter(progress, "match spectrum"))
    k, area = len(wanted), float(ops.mass.sum())
    mass = ops.mass / area
    more = min(4, int(np.count_nonzero(mass)) - k)  # values beyond the last: they must not come below it
    target = np.log(np.concatenate([wanted[1:], np.full(more, wanted[-1])]))
    smooth = Cholesky(plus_diagonal(ops.stiffness, 1e-2 * mass), ops.coordinates)
    eta = np.zeros(len(mass))
    start: Floats | None = None

    def evaluate(eta: Floats) -> tuple[float, Floats, Floats]:
        pairs = eigenpairs(ops.stiffness, k + more, mass=np.exp(eta) * mass, start=start)
        errors = np.log(np.maximum(pairs.values[1:], 1e-300) / area) - target
        errors[k - 1 :] = np.minimum(errors[k - 1 :], 0.0)
        value = 0.5 * float(errors @ errors) + 0.5 * weight * float(eta @ (ops.stiffness @ eta))
        return value, errors, pairs.functions

    value, errors, functions = evaluate(eta)
    eta = eta + errors[: k - 1].mean()  # the right size first
    value, errors, functions = evaluate(eta)
    history, damping, done = [value], 1e-4, False
    for step in range(steps):
        start = functions
        done = float(np.abs(np.expm1(errors)).max()) <= tolerance
        if done:
            break
        report(step / steps)
        felt = np.flatnonzero(np.concatenate([np.ones(k - 1, bool), errors[k - 1 :] < 0]))
        logs = errors[felt] + target[felt]
        # Functions of values close together turn into one another: within a cluster the whole matrix of derivatives counts.
        i, j = (np.concatenate(part) for part in zip((felt, felt), _close(logs, felt), strict=True))
        rows = -(functions[:, 1 + i] * functions[:, 1 + j] * (np.exp(eta) * mass)[:, None]).T  # derivatives of log λ
        asked = np.concatenate([errors[felt], np.zeros(len(i) - len(felt))])
        bent = smooth.solve(np.ascontiguousarray(rows.T))
        gram, at_eta = rows @ bent, rows @ eta
        moved = False
        for _ in range(10):
            stiff = weight + damping  # of the step, in the norm of the smoothing
            multiplier = np.linalg.solve(gram / stiff + np.eye(len(gram)), asked - weight / stiff * at_eta)
            shift = -weight / stiff * eta - bent @ multiplier / stiff
            trial = eta + shift * min(1.0, 1.0 / max(float(np.abs(shift).max()), 1e-300))
            new = evaluate(trial)
            if new[0] < value:
                eta, moved, damping = trial, True, damping / 5
                value, errors, functions = new
                history.append(value)
                break
            damping *= 5
        if not moved:
            break
    pairs = conformal_eigenpairs(ops, eta, k, start=functions[:, :k])
    report(1.0)
    error = float(np.abs(pairs.values[1:] / wanted[1:] - 1).max())
    return SpectrumMatch(eta, pairs, wanted.copy(), error, {"objective": np.array(history)}, error <= tolerance)


def _close(logs: Floats, numbers: Indices) -> tuple[Indices, Indices]:
    """Pairs of numbers, each once, whose logarithms differ by less than 0.2."""
    i, j = np.triu_indices(len(logs), 1)
    near = np.abs(logs[i] - logs[j]) < 0.2
    return numbers[i[near]], numbers[j[near]]
