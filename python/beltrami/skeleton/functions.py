"""The choice of a combination of eigenfunctions if the first eigenvalue is multiple, or the first function nearly constant somewhere."""

from __future__ import annotations

import numpy as np

from ..arrays import Floats
from .complexes import Complex

MULTIPLE = 1.15  # eigenvalues up to this factor of the first count as copies of it
IDLE = 0.05  # share of the area with slopes below a tenth of the mean, beyond which another eigenfunction may be added
GAIN = 1.35  # in the mean logarithm of squared slopes that justifies it: 1.5 to 3 for limbs in the nodal set, up to 1.3 else


class _Evenness:
    """How evenly functions change over a surface: the mean over its area of the logarithm of the mean squared slope around each vertex."""

    def __init__(self, complex_: Complex, unit: float) -> None:
        self.ends = complex_.edges.T
        steps = complex_.points[self.ends[0]] - complex_.points[self.ends[1]]
        self.unit = unit  # neither the size of the functions nor that of the shape counts, and their squares could overflow
        steps /= max(float(np.abs(steps).max()), 1e-300)
        self.inverse = 1 / np.maximum(np.einsum("ed,ed->e", steps, steps), 1e-100)
        self.count, self.share = len(complex_.mass), complex_.mass / complex_.mass.sum()
        self.degrees = np.maximum(sum(np.bincount(end, minlength=self.count) for end in self.ends), 1)

    def products(self, f: Floats, g: Floats) -> Floats:
        """(n,): the mean product of the slopes of two functions along the edges at each vertex."""
        a, b = self.ends
        product = (f[a] / self.unit - f[b] / self.unit) * (g[a] / self.unit - g[b] / self.unit) * self.inverse
        found: Floats = (np.bincount(a, product, self.count) + np.bincount(b, product, self.count)) / self.degrees
        return found

    def score(self, squares: Floats) -> float:
        """Of the squared slopes; parts without slope count as if it were a thousandth of the others'."""
        return float(self.share @ np.log(np.maximum(squares, 0) + max(1e-6 * float(squares.mean()), 1e-300)))


def first_function(complex_: Complex, values: Floats, functions: Floats, notes: list[str]) -> Floats:
    """φ_1 of a connected complex. Of a multiple λ_1 the combination that changes most evenly; and where a limb lies in the set where φ_1
    vanishes (the stem of a T), with an admixture of another eigenfunction that changes along it."""
    copies = int((values <= MULTIPLE * values[0]).sum())
    even = _Evenness(complex_, float(np.abs(functions).max()))
    found = functions[:, 0]
    if copies > 1:
        found = functions[:, :copies] @ _most_even(even, functions[:, :copies])
        gap = 100 * (values[copies - 1] / values[0] - 1)
        notes.append(f"the first {copies} eigenvalues lie within {gap:.2g} %: their most even combination is taken")
    squares = even.products(found, found)
    idle = float(even.share[squares < 0.01 * squares.mean()].sum())
    if idle > IDLE:
        base = even.score(squares)
        tries = [(weight, number) for number in range(copies, len(values)) for weight in (-0.4, -0.2, 0.2, 0.4)]
        mixed = [found + weight * functions[:, number] for weight, number in tries]
        scores = [even.score(even.products(f, f)) for f in mixed]
        best = int(np.argmax(scores)) if scores else -1
        if best >= 0 and scores[best] - base > GAIN:
            found = mixed[best]
            what = f"{tries[best][0]} times eigenfunction {tries[best][1] + 1} was added"
            notes.append(f"the eigenfunction is nearly constant on {100 * idle:.0f} % of the surface: {what}")
    sign = 1.0 if found[np.argmax(np.abs(found))] > 0 else -1.0
    oriented: Floats = sign * found
    return oriented


def _most_even(even: _Evenness, space: Floats) -> Floats:
    """The combination of some functions, a unit vector, that changes most evenly."""
    copies = space.shape[1]
    products = np.empty((len(space), copies, copies))
    for i in range(copies):
        for j in range(i, copies):
            products[:, i, j] = products[:, j, i] = even.products(space[:, i], space[:, j])

    def score(weights: Floats) -> float:
        return even.score(products.reshape(len(space), -1) @ np.outer(weights, weights).ravel())

    if copies == 2:
        angles = np.arange(24) * np.pi / 24
        starts = np.stack([np.cos(angles), np.sin(angles)], 1)
    else:
        starts = np.random.default_rng(0).normal(size=(64, copies))
        starts /= np.linalg.norm(starts, axis=1, keepdims=True)
    scores = [score(start) for start in starts]
    best, top = starts[int(np.argmax(scores))], max(scores)
    step = 0.1
    while step > 0.01:
        moves = best + step * np.concatenate([np.eye(copies), -np.eye(copies)])
        moves /= np.linalg.norm(moves, axis=1, keepdims=True)
        scores = [score(move) for move in moves]
        if max(scores) > top + 1e-9:
            best, top = moves[int(np.argmax(scores))], max(scores)
        else:
            step /= 2
    return np.asarray(best, np.float64)
