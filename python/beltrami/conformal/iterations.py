"""From a surface to its map: the start, preconditioned descent of E - A, and the chapter's Cayley steps (8.28)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy

from ..arrays import Floats
from ..progress import Progress
from ..solvers import Cholesky, plus_diagonal
from ..sums import weighted_sum
from .moebius import centred
from .surface import Surface, corner_products, determinants, row_products, unit_rows

ASTRAY = 1.1  # times the least E - A so far: a step went astray

LEAPS = 30  # Cayley steps at most that the line search does not see


def _tangential(vectors: Floats, s: Floats) -> Floats:
    found: Floats = vectors - row_products(vectors, s)[:, None] * s
    return found


def _without_turn(moves: Floats, s: Floats, weights: Floats) -> Floats:
    """Tangential moves less their mean rotation: the energy knows none, and steps that all turn a little never end."""
    weighted = s * weights[:, None]
    inertia = np.eye(3) - np.einsum("ij,ik->jk", weighted, s)
    moment = np.einsum("ij,ik->jk", weighted, moves)  # its skew part is the sum of the cross products
    x, y, z = np.linalg.solve(inertia, [moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], moment[0, 1] - moment[1, 0]])
    turned: Floats = np.einsum("ij,kj->ik", s, np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    return moves - turned


def _start(surface: Surface, solve: Callable[[Floats], Floats]) -> Floats:
    """A linear map to the plane with its pole in one large and well-shaped triangle, and up to the sphere (Haker et al. 2000)."""
    v, f = surface.vertices, surface.faces
    sides = corner_products(v, f)[0].sum(1)  # half the sum of squared sides
    shapely = np.divide(surface.areas, sides, out=np.zeros_like(sides), where=sides > 0)
    if surface.weights is not None:
        shapely = np.where(surface.weights == 1, shapely, 0.0)  # all three stars agree on it
    good = shapely >= 0.9 * np.quantile(shapely, 0.98)
    pole = int(np.flatnonzero(good)[np.argmax(surface.areas[good])])
    a, b, c = v[f[pole]]
    x = (b - a) / np.linalg.norm(b - a)
    y = (c - a) - ((c - a) @ x) * x
    p = np.array([0, np.linalg.norm(b - a), (c - a) @ x + 1j * np.linalg.norm(y)])
    right = np.zeros((surface.count, 2))
    for k in range(3):
        load = np.conj(1j * (p[(k + 2) % 3] - p[(k + 1) % 3]) / 2)
        right[f[pole, k]] += load.real, load.imag
    right /= np.abs(right).max()
    z = solve(right)
    z = z - np.median(z, axis=0)
    z = z / np.median(np.sqrt(row_products(z, z)))
    square = row_products(z, z)
    s = np.column_stack([2 * z, square - 1]) / (1 + square)[:, None]
    if surface.weights is None and np.sign(determinants(s, f)).sum() < 0:
        s[:, 1] *= -1
    return unit_rows(s)


def _anderson(residuals: list[Floats], images: list[Floats], weights: Floats) -> Floats:
    """The mix of the last steps whose residual is least (Anderson 1965; Walker and Ni 2011)."""
    newest, image = residuals[-1], images[-1]
    if len(residuals) == 1:
        return image
    root = np.sqrt(weights)[:, None]
    differences = [(newest - r) * root for r in residuals[:-1]]
    newest = newest * root
    scale = [float(np.sqrt(np.einsum("ij,ij->", d, d))) for d in differences]
    kept = [k for k, size in enumerate(scale) if size > 0]
    if not kept:
        return image
    columns = [differences[k] / scale[k] for k in kept]
    gram = np.array([[np.einsum("ij,ij->", a, b) for b in columns] for a in columns])
    right = np.array([np.einsum("ij,ij->", a, newest) for a in columns])
    values, vectors = np.linalg.eigh(gram)
    inverse = np.where(values > 1e-6 * values[-1], 1 / np.maximum(values, 1e-300), 0.0)  # the rest is noise
    shares = vectors @ (inverse * (vectors.T @ right))
    for k, share in zip(kept, shares, strict=True):
        image = image - share / scale[k] * (images[-1] - images[k])
    return image


@dataclass
class Trace:
    move: list[float] = field(default_factory=list)
    excess: list[float] = field(default_factory=list)
    converged: bool = False


def descend(
    surface: Surface,
    solve: Callable[[Floats], Floats],
    gradient: Callable[[Floats], tuple[Floats, Floats, float]],
    s: Floats,
    tolerance: float,
    steps: int,
    report: Callable[[float], object],
    *,
    guarded: bool = False,
) -> tuple[Floats, Trace]:
    """Preconditioned descent of E - A with Anderson acceleration; the centre stays at the origin, for which one Newton step
    each time does, and all at the end.

    Where rounding ends the progress before the tolerance is met, the map that moved least is returned. Steps of length 1 may rise for
    a while and come down elsewhere; where they ended far above, because limbs are long and thin, a second run goes back to the lowest
    map whenever it rises, with shorter steps (``guarded``), and the lower of both maps counts.
    """
    began = s
    trace, weights = Trace(), surface.mass / surface.mass.sum()
    best, still = (np.inf, s), 0
    residuals: list[Floats] = []
    images: list[Floats] = []
    lowest, length = (np.inf, s), 1.0
    for step in range(steps):
        g, image_areas, excess = gradient(s)
        if guarded and excess > ASTRAY * lowest[0]:
            trace.move.append(trace.move[-1])
            trace.excess.append(excess)
            s, residuals, images, length = lowest[1], [], [], 0.5 * length
            continue
        if excess < lowest[0]:
            lowest = excess, s
        g = _tangential(g, s)
        share = image_areas / image_areas.sum()
        g -= share[:, None] * np.einsum("ij->j", g)
        d = solve(g)
        d -= np.einsum("i,ij->j", share, d)
        image = centred(unit_rows(s - length * _without_turn(_tangential(d, s), s, weights)), surface.mass, 1)
        residuals, images = [*residuals[-3:], image - s], [*images[-3:], image]
        move = float(np.sqrt((weights * row_products(residuals[-1], residuals[-1])).sum()))
        trace.move.append(move)
        trace.excess.append(excess)
        best, still = ((move, s), 0) if move < best[0] else (best, still + 1)
        s = centred(unit_rows(_anderson(residuals, images, weights)), surface.mass, 1)
        report((step + 1) / steps)
        if move < tolerance:
            trace.converged = True
            break
        if still == 6 and best[0] < 1e-6:
            s = best[1]
            break
    if not (guarded or trace.converged) and trace.excess[-1] > 2 * min(trace.excess):
        calmer, other = descend(surface, solve, gradient, began, tolerance, steps, report, guarded=True)
        if gradient(calmer)[2] < gradient(s)[2]:
            return calmer, other
    return centred(s, surface.mass), trace


def _cayley_step(s: Floats, h: Floats, tau: float) -> Floats:
    """(I + τ/2 A)^-1 (I - τ/2 A) s with A = h s^T - s h^T (8.28): A has rank two, so a turn in the plane of s and h. h is tangential."""
    square = (0.25 * tau * tau * row_products(h, h))[:, None]
    return unit_rows(((1 - square) * s - tau * h) / (1 + square))


def cayley(
    surface: Surface,
    metric: Callable[[Floats], Floats] | None,
    stiffness: scipy.sparse.csr_array,
    s: Floats,
    tolerance: float,
    steps: int,
    report: Callable[[float], object],
) -> tuple[Floats, Trace]:
    """Cayley steps of Barzilai-Borwein length with a nonmonotone line search (Wen and Yin 2013).

    The direction is the gradient of E - A by unit mass, or with ``metric`` L^-1 of the gradient; its part along Möbius maps is taken
    off, so that the centre stays.
    """
    mass = surface.mass * (4 * np.pi / surface.mass.sum())

    def evaluate(s: Floats) -> tuple[float, Floats, Floats]:
        g, areas, excess = surface.gradient(s)
        g = _tangential(g, s)
        moebius = np.eye(3) * mass.sum() - np.einsum("n,na,nb->ab", mass, s, s)
        if metric is None:
            h = g / mass[:, None]
        else:
            share = (areas / areas.sum())[:, None]
            h = metric(g - share * g.sum(0))
            h = _tangential(h - (share * h).sum(0), s)
        h = h - _tangential(np.broadcast_to(np.linalg.solve(moebius, weighted_sum(h.T, mass)), s.shape), s)
        return excess, g, h

    trace = Trace()
    value, g, h = evaluate(s)
    reference, count, tau = value, 1.0, 1.0 if metric is not None else float((mass / np.maximum(stiffness.diagonal(), 1e-300)).min())
    leaps, usual = 0, tau
    for step in range(steps):
        residual = float(np.sqrt(weighted_sum(row_products(h, h), mass) / mass.sum()))
        trace.move.append(residual)
        trace.excess.append(value)
        report((step + 1) / steps)
        if residual < tolerance:
            trace.converged = True
            break
        slope = float((g * h).sum())
        wished = tau
        for _ in range(40):
            new = centred(_cayley_step(s, h, tau), surface.mass)
            new_value, new_g, new_h = evaluate(new)
            if new_value <= reference - 1e-4 * tau * slope + 1e-14 * abs(reference):
                break
            tau *= 0.2
        else:
            break
        if tau < 1e-6 * wished:  # before a triangle that is upright, whose signed area jumps: over it
            if leaps == LEAPS:
                break
            leaps += 1
            tau = usual
            new = centred(_cayley_step(s, h, tau), surface.mass)
            new_value, new_g, new_h = evaluate(new)
            reference, count = new_value, 0.0
        else:
            usual = tau
        ds, dh = new - s, new_h - h
        weighted = mass[:, None] * ds if metric is None else stiffness @ ds
        weighted_h = mass[:, None] * dh if metric is None else stiffness @ dh
        ss, sy, yy = float((ds * weighted).sum()), abs(float((ds * weighted_h).sum())), float((dh * weighted_h).sum())
        tau = ss / max(sy, 1e-300) if step % 2 else sy / max(yy, 1e-300)
        tau = min(max(tau, 1e-12), 1e6)
        s, value, g, h = new, new_value, new_g, new_h
        reference, count = (0.85 * count * reference + value) / (0.85 * count + 1), 0.85 * count + 1
    return s, trace


def _solver(stiffness: scipy.sparse.csr_array, coordinates: Floats, progress: Progress) -> Callable[[Floats], Floats]:
    """Solves with the stiffness, one vertex pinned by a spring; exact for right-hand sides that add up to zero."""
    spring = np.zeros(stiffness.shape[0])
    spring[0] = stiffness.diagonal()[0]
    return Cholesky(plus_diagonal(stiffness, spring), coordinates, progress=progress).solve


@dataclass(frozen=True)
class Task:
    method: str
    tolerance: float
    steps: int
    report: Callable[[float], None]

    def iterate(self, surface: Surface, stiffness: scipy.sparse.csr_array, *, energy_only: bool = False) -> tuple[Floats, Trace]:
        """Factors, makes the start, iterates."""

        def gradient(s: Floats) -> tuple[Floats, Floats, float]:
            g, areas, excess = surface.gradient(s)
            return (stiffness @ s if energy_only else g), areas, excess

        def later(share: float) -> None:
            self.report(0.4 + 0.5 * share)

        solve = _solver(stiffness, surface.vertices, lambda share: self.report(0.4 * share))
        s = centred(_start(surface, solve), surface.mass)
        if self.method == "fast" or energy_only:
            return descend(surface, solve, gradient, s, self.tolerance, self.steps, later)
        return cayley(surface, None if self.method == "cayley" else solve, stiffness, s, self.tolerance, self.steps, later)

    def onward(self, surface: Surface, stiffness: scipy.sparse.csr_array, s: Floats) -> tuple[Floats, Trace]:
        """Factors and iterates from a map that is there."""
        solve = _solver(stiffness, surface.vertices, lambda share: self.report(0.9))
        s = centred(s, surface.mass)
        if self.method == "fast":
            return descend(surface, solve, surface.gradient, s, self.tolerance, self.steps, lambda share: self.report(0.9))
        metric = None if self.method == "cayley" else solve
        return cayley(surface, metric, stiffness, s, self.tolerance, self.steps, lambda share: self.report(0.9))
