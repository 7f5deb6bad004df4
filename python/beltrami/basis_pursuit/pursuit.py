"""The alternation for equation 8.34: the basis by splitting, the factor by Gauss-Newton, level by level."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from ..arrays import Floats
from ..eigen import Eigenpairs, eigenpairs
from ..sampling import farthest_points
from ..solvers import Cholesky, plus_diagonal
from . import limbs
from .starts import Candidate, Task, aligned, pursuit_features
from .surface import Surface


class Pursuit:
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
            feasible = weighted_orthonormal(q / np.maximum(root, 1e-300), weight)
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
            psi = weighted_orthonormal(self.psi, np.exp(eta) * self.target.mass)
            trial = self.objective(psi, eta)
            if trial < value:
                self.eta, self.psi = eta, psi
                return trial
        return value


def _orthonormal(table: Floats) -> Floats:
    u, _, v = np.linalg.svd(table, full_matrices=False)
    found: Floats = u @ v
    return found


def weighted_orthonormal(psi: Floats, weight: Floats) -> Floats:
    """The nearest functions that are orthonormal under the weight: psi (psi^T W psi)^-1/2, twice for rounding."""
    for _ in range(2):
        values, vectors = np.linalg.eigh(psi.T @ (weight[:, None] * psi))
        psi = psi @ ((vectors / np.sqrt(np.maximum(values, 1e-300))) @ vectors.T)
    return psi


def pursue(
    task: Task,
    best: Candidate,
    pairs: Eigenpairs,
    k: int,
    sweeps: int,
    weights: tuple[float, float],
    report: Callable[[float], None],
) -> tuple[Pursuit, list[float], list[int], bool]:
    """From the factor of the start, level by level."""
    a, b = task.source, task.target
    marks = best.marks
    if len(marks) < 12:  # heat from more places, with their images under the start
        more = np.asarray(farthest_points(a.points, min(16, len(a.mass))), np.int64)
        marks = limbs.distinct(np.concatenate([marks, np.stack([more, best.forward[more]], 1)]))
    first, second = pursuit_features(task, marks, best.eta)
    scale = float(pairs.values[1:k].mean())
    strengths = (weights[0] * scale, 1.0, weights[1] * scale)
    sizes = [10 * 2**i for i in range(12) if 10 * 2**i < k] + [k]
    history: list[float] = []
    levels: list[int] = []
    pursuit = Pursuit(b, second, np.zeros((0, 0)), best.eta, strengths)
    converged, near = False, None
    for number, size in enumerate(sizes):
        phi = pairs.functions[:, :size]
        weight = np.exp(pursuit.eta) * b.mass
        near = eigenpairs(b.stiffness, size, mass=weight, start=near).functions
        pursuit.coefficients = phi.T @ (a.mass[:, None] * first)
        turn = aligned(a, phi, near, weight, best.forward, best.backward)
        pursuit.psi = weighted_orthonormal(near @ turn.T, weight)
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
