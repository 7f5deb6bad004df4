"""Matching of shapes that are far from isometric: conformal Laplace-Beltrami basis pursuit (section 8.3.3, equations 8.33 and 8.34).

In two dimensions a change w² of the metric changes the mass and leaves the stiffness as it is. So a target with any conformal factor has a
basis Ψ, orthonormal under diag(w² m), that costs one generalized eigenproblem; and a target that is conformal to the source has, with
the right factor, the source's own basis. The pursuit looks for both. What it cannot do is start from nothing: the start comes from the
spherical conformal maps (:mod:`beltrami.basis_pursuit.limbs`), from landmarks, features or :func:`register`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import scipy

from .. import arrays
from ..arrays import Floats
from ..conformal import SphericalMapResult, spherical_map
from ..eigen import Eigenpairs, eigenpairs
from ..errors import ConvergenceError, InputError, NumericalError, TopologyError
from ..files import written
from ..operators import Operators, operators
from ..progress import Progress, reporter, teller
from ..register import register
from ..sampling import farthest_points
from ..shapes import Shape, TriangleMesh
from ..solvers import Cholesky, plus_diagonal
from ..view import Page, Picture, plot
from . import limbs
from .limbs import Indices, Sphered, Surface, nearest_rows

__all__ = ["ConformalRegistrationResult", "SpectrumMatch", "conformal_eigenpairs", "match_spectrum", "register_conformal"]

Start = Literal["auto", "spherical", "landmarks", "register"]
Orientation = Literal["preserving", "reversing", "any"]

BLUR = 0.01  # share of the area over which the factor of a map is averaged
COARSE_BLUR = 0.3  # the same for the weights of upsampling, where only the factor's main course matters
CONFORMAL = 0.02  # logarithmic misfit of the landmarks' cross-ratios below which two shapes count as conformal
INVARIANT = 0.1  # the same for potentials on shapes of any topology, which feel the mesh around each landmark
SMOOTH = 100.0  # roughness of the factor from which a map is so poor that other guesses are worth their time
ANCHOR = 3.0  # weight of the spherical features beside the bases of a shape of unit area
CHARGES = 16  # pairs of a feature map that potentials are made of
WORTH = 3.0  # so much rougher may a map be that hits the landmarks
MISSED = 0.1  # share of sqrt(area) from which on a landmark is missed
TRUSTED = 0.05  # share of sqrt(area) there and back at which the confidence has fallen to 1 / e


# --- conformal eigenpairs -----------------------------------------------------------------------------------------------------------


def conformal_eigenpairs(
    shape: Shape | Operators, log_factor: npt.ArrayLike, k: int, *, start: Any = None, progress: Progress = None
) -> Eigenpairs:
    """Eigenpairs of the shape with its metric multiplied by ``exp(log_factor)``: ``L ψ = λ diag(exp(η) m) ψ`` (equation 8.33).

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        Of dimension 2: only there the stiffness stays as it is.
    log_factor : array_like (n,)
        η = log w² at the vertices.
    k : int
        How many.
    start : array_like (n, c), optional
        Vectors near the wanted ones, see :func:`eigenpairs`.
    progress : callable or True, optional

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
    _surface_only(ops)
    eta = _log_factor(log_factor, len(ops.mass))
    level = float(eta.max())  # taken out, so that no exponential overflows
    if not abs(level) < 600:
        raise InputError(f"log_factor reaches {level:g}; exp of it leaves the range of double precision")
    scale = np.exp(level)
    found = eigenpairs(ops.stiffness, k, mass=np.exp(eta - level) * ops.mass, start=start, progress=progress)
    return Eigenpairs(found.values / scale, found.functions / np.sqrt(scale), found.residuals / np.sqrt(scale), found.iterations, ops.shape)


def _surface_only(ops: Operators) -> None:
    dimension = ops.shape.intrinsic_dimension
    if dimension != 2:
        raise InputError(f"the shape has dimension {dimension}; a conformal change leaves the stiffness as it is for surfaces only")


def _log_factor(value: npt.ArrayLike, count: int) -> Floats:
    eta = arrays.floats(value, "log_factor", (count,))
    if float(np.ptp(eta)) > 200:
        raise InputError(f"log_factor spans {float(np.ptp(eta)):.3g}; at most 200 (a factor of 10^86) can be resolved")
    return eta


# --- spectra ------------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class SpectrumMatch:
    """A conformal factor with which a shape has a given spectrum.

    Attributes
    ----------
    log_factor : ndarray (n,)
        η = log w².
    pairs : Eigenpairs
        Of the shape with that factor.
    wanted : ndarray (k,)
        The values that were asked for.
    error : float
        Greatest relative difference from them, the zero left out.
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
    """Finds a conformal factor exp(η) with which the shape has given eigenvalues.

    Gauss-Newton on the logarithms of the eigenvalues, whose derivative is ``-∫ ψ² exp(η) δη``, with ``smoothness/2 ∫ |grad η|²``
    added; a step that does not lower the objective is shortened.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        Connected, of dimension 2.
    values : array_like (k,)
        Ascending, in 1 / length², beginning with the zero of the constant function.
    smoothness : float
        Weight of the Dirichlet energy of η against the squared logarithmic errors.
    tolerance : float
        Relative error of the eigenvalues at which to stop.
    max_iterations : int
    progress : callable or True, optional

    Returns
    -------
    SpectrumMatch

    Raises
    ------
    InputError
        Values are not ascending, do not begin with zero, or are fewer than two.

    Notes
    -----
    Many factors have one and the same spectrum (those that a symmetry exchanges, at least): the answer is one near η = constant.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> ellipsoid = bt.eigenpairs(bt.shapes.ellipsoid(1.0, 0.9, 0.8, level=3), 6).values
    >>> bt.match_spectrum(bt.shapes.sphere(3), ellipsoid).error < 1e-3
    True
    """
    ops = operators(shape)
    _surface_only(ops)
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
    error = float(np.abs(pairs.values[1:] / wanted[1:] - 1).max())
    return SpectrumMatch(eta, pairs, wanted.copy(), error, {"objective": np.array(history)}, error <= tolerance)


def _close(logs: Floats, numbers: Indices) -> tuple[Indices, Indices]:
    """Pairs of numbers, each once, whose logarithms differ by less than 0.2."""
    i, j = np.triu_indices(len(logs), 1)
    near = np.abs(logs[i] - logs[j]) < 0.2
    return numbers[i[near]], numbers[j[near]]


# --- maps and their factors ---------------------------------------------------------------------------------------------------------


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
class _Candidate:
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


def _candidate(
    name: str,
    source: Surface,
    target: Surface,
    forward: Indices,
    backward: Indices,
    marks: Indices,
    anchors: tuple[Floats, Floats] | None = None,
    binding: bool = False,
) -> _Candidate:
    eta, back = factor_of_map(source, target, forward), factor_of_map(target, source, backward)
    rough = float(eta @ (target.stiffness @ eta)) + float(back @ (source.stiffness @ back))
    return _Candidate(name, forward, backward, marks, eta, rough, anchors, binding)


def _aligned(source: Surface, phi: Floats, psi: Floats, weight: Floats, forward: Indices, backward: Indices) -> Floats:
    """R orthogonal with ``phi @ R`` near ``psi`` under the map, both ways."""
    both = phi.T @ (source.mass[:, None] * psi[forward]) + phi[backward].T @ (weight[:, None] * psi)
    u, _, v = np.linalg.svd(both)
    found: Floats = u @ v
    return found


def _smoothest(task: _Task, candidates: Sequence[_Candidate]) -> _Candidate:
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


def _upsampled(task: _Task, phi: Floats, start: _Candidate, levels: Iterable[int], report: Callable[[float], None]) -> _Candidate:
    """Spectral upsampling (Melzi et al. 2019) in the metric of the map's own factor. Where the start has features, rows of both are
    compared: the bases smooth the map, the features keep it from sliding along limbs."""
    source, target = task.source, task.target
    forward, backward = start.forward, start.backward
    near: Floats | None = None
    for k in levels:
        weight = np.exp(factor_of_map(source, target, forward, COARSE_BLUR, 1)) * target.mass
        right = near = eigenpairs(target.stiffness, k, mass=weight, start=near).functions
        left = phi[:, :k] @ _aligned(source, phi[:, :k], right, weight, forward, backward)
        if start.anchors is not None:
            left, right = (np.column_stack([x, ANCHOR * y]) for x, y in zip((left, right), start.anchors, strict=True))
        forward, backward = nearest_rows(right, left), nearest_rows(left, right)
        report(0.5)
    return _candidate(f"{start.name}, upsampled", source, target, forward, backward, start.marks)


# --- the pursuit --------------------------------------------------------------------------------------------------------------------


class _Pursuit:
    """The alternation for equation 8.34: Ψ by splitting, η by Gauss-Newton. Each block lowers the objective, or changes nothing."""

    def __init__(self, target: Surface, features: Floats, coefficients: Floats, eta: Floats, weights: tuple[float, float, float]) -> None:
        self.target, self.features, self.coefficients = target, features, coefficients
        self.r1, self.r2, self.r3 = weights
        self.start = self.eta = eta
        self.psi = np.zeros((0, 0))
        self.smooth = plus_diagonal(self.r3 * target.stiffness, self.r3 * target.mass)
        self._smooth_factor = Cholesky(plus_diagonal(self.smooth, np.full(len(eta), 1e-12 * self.r3)), target.operators.coordinates)
        self._factor: Cholesky | None = None

    def objective(self, psi: Floats, eta: Floats) -> float:
        weight = np.exp(eta) * self.target.mass
        misfit = self.coefficients - psi.T @ (weight[:, None] * self.features)
        bent, change = self.target.stiffness @ psi, eta - self.start
        return float(0.5 * self.r1 * (misfit**2).sum() + 0.5 * self.r2 * (psi * bent).sum() + 0.5 * change @ (self.smooth @ change))

    def basis_step(self, inner: int = 6) -> float:
        """Step 1: with Q = (exp(η) m)^1/2 Ψ apart from Ψ, a quadratic problem (sparse plus rank of the features: Woodbury on one factor),
        then Q onto orthonormal columns (thin SVD), then the multiplier. Returns the objective."""
        best, value = self.psi, self.objective(self.psi, self.eta)
        weight = np.exp(self.eta) * self.target.mass
        root = np.sqrt(weight)[:, None]
        penalty = self.r2 * float((self.psi * (self.target.stiffness @ self.psi)).sum()) / self.psi.shape[1] + 1e-12
        matrix = plus_diagonal(self.r2 * self.target.stiffness, penalty * weight)
        self._factor = Cholesky(matrix, self.target.operators.coordinates) if self._factor is None else self._factor.refactor(matrix)
        pull = np.sqrt(self.r1) * weight[:, None] * self.features
        solved = self._factor.solve(pull)
        small = scipy.linalg.cho_factor(np.eye(pull.shape[1]) + pull.T @ solved)
        linear = np.sqrt(self.r1) * pull @ self.coefficients.T
        q, multiplier = root * self.psi, np.zeros_like(self.psi)
        for _ in range(inner):
            psi = self._factor.solve(linear + penalty * root * (q - multiplier))
            psi -= solved @ scipy.linalg.cho_solve(small, pull.T @ psi)
            q = _orthonormal(root * psi + multiplier)
            multiplier = multiplier + root * psi - q
            feasible = _weighted_orthonormal(q / np.maximum(root, 1e-300), weight)
            trial = self.objective(feasible, self.eta)
            if trial < value:
                best, value = feasible, trial
        self.psi = best
        return value

    def factor_step(self) -> float:
        """Step 2: Gauss-Newton for η by conjugate gradients on the kept factor of the smoothing; bounded, total area fixed. Returns the
        objective."""
        value = self.objective(self.psi, self.eta)
        weight = np.exp(self.eta) * self.target.mass
        misfit = self.coefficients - self.psi.T @ (weight[:, None] * self.features)
        weighted = weight[:, None] * self.features

        def forward(delta: Floats) -> Floats:
            found: Floats = self.psi.T @ (weighted * delta[:, None])
            return found

        def adjoint(table: Floats) -> Floats:
            found: Floats = ((self.psi @ table) * weighted).sum(1)
            return found

        right = self.r1 * adjoint(misfit) - self.smooth @ (self.eta - self.start)
        delta = np.zeros_like(right)
        residual = right.copy()
        z = self._smooth_factor.solve(residual)
        direction, energy = z, float(residual @ z)
        first = energy
        for _ in range(30):
            if energy <= 1e-6 * first or first <= 0:
                break
            image = self.r1 * adjoint(forward(direction)) + self.smooth @ direction
            length = energy / float(direction @ image)
            delta = delta + length * direction
            residual = residual - length * image
            z = self._smooth_factor.solve(residual)
            energy, before = float(residual @ z), energy
            direction = z + energy / before * direction
        delta = np.clip(delta, -0.5, 0.5)
        for length in (1.0, 0.5, 0.25, 0.125):
            eta = self.eta + length * delta
            eta = eta - np.log(np.exp(eta) @ self.target.mass)
            psi = _weighted_orthonormal(self.psi, np.exp(eta) * self.target.mass)
            trial = self.objective(psi, eta)
            if trial < value:
                self.eta, self.psi = eta, psi
                return trial
        return value


def _orthonormal(table: Floats) -> Floats:
    u, _, v = np.linalg.svd(table, full_matrices=False)
    found: Floats = u @ v
    return found


def _weighted_orthonormal(psi: Floats, weight: Floats) -> Floats:
    """The nearest functions that are orthonormal under the weight: psi (psi^T W psi)^-1/2, twice for rounding."""
    for _ in range(2):
        values, vectors = np.linalg.eigh(psi.T @ (weight[:, None] * psi))
        psi = psi @ ((vectors / np.sqrt(np.maximum(values, 1e-300))) @ vectors.T)
    return psi


def _bumps(surface: Surface, weight: Floats, at: Indices, time: float = 0.01) -> Floats:
    """Heat from each vertex after a while, in the metric of the weight."""
    right = np.zeros((len(weight), len(at)))
    right[at, np.arange(len(at))] = 1.0
    safe = np.maximum(weight, 1e-12 / len(weight))
    return Cholesky(plus_diagonal(time * surface.stiffness, safe), surface.operators.coordinates).solve(right)


# --- the result ---------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class ConformalRegistrationResult:
    """A map between two shapes with the conformal factor and the bases that belong to it.

    Attributes
    ----------
    source, target : TriangleMesh or PointCloud
    point_map : ndarray (n_source,) of int64
        The vertex of the target for each vertex of the source.
    inverse_map : ndarray (n_target,) of int64
        The vertex of the source for each vertex of the target.
    log_factor : ndarray (n_target,)
        η = log w²: ``exp(η)`` times the target's mass is the source's; it adds up to the source's area.
    source_basis : ndarray (n_source, N)
        Φ: eigenfunctions of the source, orthonormal under its mass.
    basis : ndarray (n_target, N)
        Ψ: orthonormal under ``exp(η) m``; row for row near Φ where the map is right.
    values : ndarray (N,)
        Eigenvalues of Φ.
    orthonormality_error : float
        Greatest entry of ``Ψ^T diag(exp(η) m) Ψ - I``.
    objective : float
        Equation 8.34 at the end, for shapes of unit area, with the smoothing of η.
    history : dict of str to ndarray
        ``objective`` after each block of the alternation and its ``level`` (size of the basis); it never rises within a level.
    roughness : dict of str to float
        Dirichlet energy of the factor, both ways, of each map that was tried; the least was taken.
    landmarks : ndarray (k, 2) of int64
        Those that were given and those that were found.
    coverage : float
        Share of the target's area that the point map reaches.
    confidence : ndarray (n_source,)
        From 0 to 1: exp(-d / 0.05), d the distance from a vertex to where the two maps take it, there and back, over sqrt(area).
    consistency : float
        Mean of d.
    start : str
        Which map was taken.
    iterations : int
        Blocks of the alternation.
    converged : bool
        Whether the last level ended because nothing changed any more.
    notes : tuple of str
    """

    source: Shape
    target: Shape
    point_map: Indices
    inverse_map: Indices
    log_factor: Floats
    source_basis: Floats
    basis: Floats
    values: Floats
    orthonormality_error: float
    objective: float
    history: dict[str, npt.NDArray[Any]]
    roughness: dict[str, float]
    landmarks: Indices
    coverage: float
    confidence: Floats
    consistency: float
    start: str
    iterations: int
    converged: bool
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        low, high = self.log_factor.min(), self.log_factor.max()
        return (
            f"ConformalRegistrationResult({len(self.point_map)} to {len(self.inverse_map)} vertices, {self.start}, coverage "
            f"{self.coverage:.0%}, log factor {low:.2f} to {high:.2f})"
        )

    def pull_back(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """Values (n_target,) or (n_target, c) of the target, at the source's vertices."""
        given = np.asarray(values)
        if given.shape[:1] != self.inverse_map.shape:
            raise InputError(f"values has {given.shape[:1]} rows, the target has {len(self.inverse_map)} vertices")
        return given[self.point_map]

    def push_forward(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """Values (n_source,) or (n_source, c) of the source, at the target's vertices."""
        given = np.asarray(values)
        if given.shape[:1] != self.point_map.shape:
            raise InputError(f"values has {given.shape[:1]} rows, the source has {len(self.point_map)} vertices")
        return given[self.inverse_map]

    def plot(self, values: Any = "log_factor", *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints the target.

        Parameters
        ----------
        values : str or array_like
            ``"log_factor"``; or values at the source's vertices, which the map brings over.
        path, **options
            As for :func:`beltrami.plot`.
        """
        if isinstance(values, str):
            if values != "log_factor":
                raise InputError(f"values is {values!r}; choose 'log_factor', or give an array of the source's vertices")
            most = float(np.abs(self.log_factor - np.median(self.log_factor)).max()) or 1.0
            middle = float(np.median(self.log_factor))
            return plot(self.target, self.log_factor, path=path, **{"label": "log w²", "limits": (middle - most, middle + most), **options})
        return plot(self.target, self.push_forward(values), path=path, **options)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``, the point map to ``.csv`` (source, target, confidence), a picture to ``.png`` or ``.html``."""
        path = arrays.file(path, "path")
        suffix = path.suffix.lower()
        if suffix in (".png", ".html"):
            self.plot(path=path)
        elif suffix == ".npz":
            names = ("point_map", "inverse_map", "log_factor", "source_basis", "basis", "values", "landmarks", "confidence")
            fields: dict[str, Any] = {name: getattr(self, name) for name in names}
            written(path, lambda stream: np.savez_compressed(stream, **{**fields, **self.history}))
        elif suffix == ".csv":
            rows = np.column_stack([np.arange(len(self.point_map)), self.point_map, self.confidence])
            table = {"fmt": ["%d", "%d", "%.6g"], "delimiter": ",", "header": "source,target,confidence", "comments": ""}
            written(path, lambda stream: np.savetxt(stream, rows, **table))  # type: ignore[arg-type]
        else:
            raise InputError(f"{path}: a registration is written to .npz, .csv, .png or .html")
        return path


# --- the door -----------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Task:
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


def _landmarks(value: Any, count: int, other: int) -> Indices:
    if value is None:
        return np.zeros((0, 2), np.int64)
    table = np.asarray(value)
    if table.ndim != 2 or table.shape[1] != 2:
        raise InputError(f"landmarks has shape {table.shape}; (k, 2) vertex numbers are needed: source, target")
    if len(table) == 0:
        return np.zeros((0, 2), np.int64)
    marks = np.stack([arrays.indices(table[:, 0], "landmarks[:, 0]", count), arrays.indices(table[:, 1], "landmarks[:, 1]", other)], 1)
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
            raise InputError(f"features {name} has shape {array.shape}; ({n}, k) is needed, a row a vertex")
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
    """Matches two shapes that are far from isometric: point map, conformal factor and bases (equations 8.33 and 8.34).

    Several maps are made: for surfaces of genus 0 from their spherical conformal maps, with landmarks, features or the shapes' own
    tips to fix them, as it is and with its limbs stretched; else from landmarks and features. The best is refined, and, unless the
    shapes prove to be conformal, compared with that of :func:`register`. The one with the smoothest conformal factor is taken. From
    its factor the alternation of the paper starts: Ψ by splitting, η by Gauss-Newton.

    Parameters
    ----------
    source, target : TriangleMesh, PointCloud or Operators
        Surfaces.
    landmarks : array_like (k, 2) of int, optional
        Pairs of vertices, source and target.
    features : pair of array_like (n_source, c) and (n_target, c), optional
        The same functions on both: descriptors, label maps, anything a vertex.
    k : int
        Size of the bases Φ and Ψ; the alternation grows from 10.
    start : {"auto", "spherical", "landmarks", "register"}
        ``"spherical"`` needs closed surfaces of genus 0; ``"landmarks"`` needs landmarks or features; ``"register"`` is
        near-isometric registration. ``"auto"`` takes what applies.
    refine : int or None
        Size of the basis to which the map is refined by upsampling in the metric of its factor; None: not at all.
    sweeps : int
        Most sweeps of the alternation a level; 0 leaves the start's factor and its eigenbasis.
    misfit_weight, smoothness : float
        Weights of the features' misfit and of the change of η, ``∫ |grad δη|² + δη²``, against the mean Dirichlet energy of Φ.
    orientation : {"preserving", "reversing", "any"}
        Of the map, for spherical starts: ``"reversing"`` for a mirror image of the source.
    rng : int or numpy Generator
        For the sampling of feature pairs.
    progress : callable or True, optional
        Called with the share of work done; returning False stops with :class:`Cancelled`.

    Returns
    -------
    ConformalRegistrationResult

    Raises
    ------
    InputError
        Landmarks are out of range, repeated or contradictory, features do not fit, or nothing fixes the map.
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
        _surface_only(ops)
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
    task = _Task(a, b, marks, tables, arrays.generator(rng), orientation, [])

    candidates, settled = _starts(task, start, report)
    report(0.4)
    best = _smoothest(task, candidates)
    size = max(k, min(finest or k, min(counts) // 4))
    pairs = eigenpairs(a.stiffness, size, mass=a.mass)
    if finest is not None:
        levels = sorted({max(k, (share * size) // 10) for share in (4, 7, 10)})
        try:
            candidates.append(_upsampled(task, pairs.functions, best, levels, report))
        except (ConvergenceError, NumericalError) as error:
            task.notes.append(f"not refined: {error}")
        best = _smoothest(task, candidates)
    report(0.6)
    if not settled:
        try:
            candidates.append(_registered_start(task))
        except (InputError, NumericalError, ConvergenceError) as error:
            task.notes.append(f"no near-isometric start: {error}")
        best = _smoothest(task, candidates)
    report(0.7)

    phi = pairs.functions[:, :k]
    pursuit, history, levels_of, converged = _pursue(task, best, pairs, k, sweeps, (first, second), report)
    left, right = phi, pursuit.psi
    found = _candidate("pursuit", a, b, nearest_rows(right, left), nearest_rows(left, right), best.marks)
    candidates.append(found)
    best = _smoothest(task, candidates)
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


def _starts(task: _Task, start: Start, report: Callable[[float], None]) -> tuple[list[_Candidate], bool]:
    """All maps that apply, at least one; and whether no other need be tried."""
    found: list[_Candidate] = []
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
        return [_registered_start(task)], True
    return found, settled or task.orientation != "preserving"


def _spheres(task: _Task, needed: bool) -> tuple[SphericalMapResult, SphericalMapResult] | None:
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
    task: _Task, spheres: tuple[SphericalMapResult, SphericalMapResult], report: Callable[[float], None]
) -> tuple[list[_Candidate], bool]:
    """Maps through the spheres; and whether the shapes turned out to be conformal, so that no other map need be tried."""
    found: list[_Candidate] = []
    settled = False
    sides = {"preserving": [False], "reversing": [True], "any": [False, True]}[task.orientation]
    for mirrored in sides:
        a, b = Sphered.of(task.source, spheres[0]), Sphered.of(task.target, spheres[1], mirrored=mirrored)
        name = "spherical, mirrored" if mirrored else "spherical"
        choices: list[Indices] = []
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
        made = [one for marks in choices if len(marks) >= 3 for one in _from_marks(task, a, b, marks, name)]
        trusted = len(task.marks) >= 3 or task.tables is not None
        # Landmarks too few, or off the limbs of shapes that are not conformal: guesses at the tips that go with them.
        for tried, guess in enumerate(limbs.guessed_marks(a, b, task.marks)):
            report(0.2)
            if made and min(one.roughness for one in made) < (SMOOTH if tried >= 4 or trusted else 0.0):
                break
            made += _from_marks(task, a, b, limbs.distinct(np.concatenate([task.marks, guess])), name)
        made.sort(key=lambda one: one.roughness)
        found += made[:2]
        settled |= bool(made) and made[0].name == name and limbs.misfit(a, b, made[0].marks) < CONFORMAL
    return found, settled


def _from_marks(task: _Task, a: Sphered, b: Sphered, marks: Indices, name: str) -> list[_Candidate]:
    """The map by the features of the landmarks and of the tips found from them: as they are, and with stretched limbs."""
    marks = limbs.without_outliers(a, b, limbs.paired_tips(a, b, marks), len(task.marks))
    first, second = limbs.features(a, b, marks)
    made = []
    for how, other in ((name, second), (f"{name}, limbs stretched", limbs.stretched(a, b, marks, first, second))):
        forward, backward = nearest_rows(other, first), nearest_rows(first, other)
        made.append(_candidate(how, task.source, task.target, forward, backward, marks, (first, other)))
    return made


def _feature_pairs(task: _Task, most: int = 1000) -> Indices:
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


def _harmonic_starts(task: _Task) -> list[_Candidate]:
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
    return [_candidate("harmonic", a, b, forward, backward, marks, (first, second), misfit < INVARIANT)]


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


def _spectral_start(task: _Task) -> _Candidate:
    """Without a sphere: the bases that agree on the landmarks' heat and on the features, from few functions to many."""
    a, b = task.source, task.target
    size = min(60, len(a.mass) // 4, len(b.mass) // 4)
    phi, psi = (eigenpairs(s.stiffness, size, mass=s.mass).functions for s in (a, b))
    first, second = _pursuit_features(task, task.marks, np.zeros(len(b.mass)))
    few = min(max(4, first.shape[1]), size)
    u, _, v = np.linalg.svd((phi[:, :few].T @ (a.mass[:, None] * first)) @ (psi[:, :few].T @ (b.mass[:, None] * second)).T)
    left, right = phi[:, :few] @ (u @ v), psi[:, :few]
    forward, backward = nearest_rows(right, left), nearest_rows(left, right)
    for level in range(few, size + 1, 4):
        right = psi[:, :level]
        left = phi[:, :level] @ _aligned(a, phi[:, :level], right, b.mass, forward, backward)
        forward, backward = nearest_rows(right, left), nearest_rows(left, right)
    return _candidate("landmarks", a, b, forward, backward, task.marks)


def _registered_start(task: _Task) -> _Candidate:
    """Near-isometric registration."""
    marks = task.marks if len(task.marks) else None
    r = register(task.source.operators, task.target.operators, landmarks=marks, descriptors=task.tables, rng=task.rng)
    forward, backward = (np.asarray(x, np.int64) for x in (r.point_map, r.inverse_map))
    task.notes.extend(f"register: {note}" for note in r.notes)
    return _candidate("register", task.source, task.target, forward, backward, task.marks)


def _pursuit_features(task: _Task, marks: Indices, eta: Floats) -> tuple[Floats, Floats]:
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


def _pursue(
    task: _Task,
    best: _Candidate,
    pairs: Eigenpairs,
    k: int,
    sweeps: int,
    weights: tuple[float, float],
    report: Callable[[float], None],
) -> tuple[_Pursuit, list[float], list[int], bool]:
    """From the factor of the start, level by level."""
    a, b = task.source, task.target
    marks = best.marks
    if len(marks) < 12:  # heat from more places, with their images under the start
        more = np.asarray(farthest_points(a.points, min(16, len(a.mass))), np.int64)
        marks = limbs.distinct(np.concatenate([marks, np.stack([more, best.forward[more]], 1)]))
    first, second = _pursuit_features(task, marks, best.eta)
    scale = float(pairs.values[1:k].mean())
    strengths = (weights[0] * scale, 1.0, weights[1] * scale)
    sizes = [10 * 2**i for i in range(12) if 10 * 2**i < k] + [k]
    history: list[float] = []
    levels: list[int] = []
    pursuit = _Pursuit(b, second, np.zeros((0, 0)), best.eta, strengths)
    converged, near = False, None
    for number, size in enumerate(sizes):
        phi = pairs.functions[:, :size]
        weight = np.exp(pursuit.eta) * b.mass
        near = eigenpairs(b.stiffness, size, mass=weight, start=near).functions
        pursuit.coefficients = phi.T @ (a.mass[:, None] * first)
        turn = _aligned(a, phi, near, weight, best.forward, best.backward)
        pursuit.psi = _weighted_orthonormal(near @ turn.T, weight)
        history.append(pursuit.objective(pursuit.psi, pursuit.eta))
        levels.append(size)
        converged = False
        for _ in range(sweeps):
            before = history[-1]
            for step in (pursuit.basis_step, pursuit.factor_step):
                history.append(step())
                levels.append(size)
            report(0.7 + 0.25 * (number + 1) / len(sizes))
            if before - history[-1] <= 1e-4 * abs(before):
                converged = True
                break
    return pursuit, history, levels, converged
