"""The simplices on which functions are linear, for any kind of operators: total variation and transport are defined on them."""

from __future__ import annotations

import numpy as np

from .arrays import Floats, Ints
from .clouds import CloudOperators
from .errors import InputError
from .intrinsic import IntrinsicOperators
from .operators import Operators
from .shapes import TriangleMesh


def simplices(ops: Operators) -> tuple[Ints, Floats, Floats]:
    """Corners (m, s), sides from the first corner to the others (m, s - 1, D), and areas."""
    if isinstance(ops, CloudOperators):
        corners, places = ops.simplices, ops.shape.points
    elif isinstance(ops, IntrinsicOperators):
        corners, lengths = ops.triangulation.faces, ops.triangulation.lengths
        first, second, third = lengths.T
        along = (first**2 + third**2 - second**2) / (2 * first)
        up = 2 * _heron(lengths) / first
        zero = np.zeros_like(first)
        return corners, np.stack([np.stack([first, zero], 1), np.stack([along, up], 1)], 1), ops.simplex_areas
    else:
        assert isinstance(ops.shape, TriangleMesh)  # clouds have CloudOperators
        corners, places = ops.shape.faces, ops.shape.vertices
    return corners, places[corners[:, 1:]] - places[corners[:, :1]], ops.simplex_areas


def _heron(lengths: Floats) -> Floats:
    c, b, a = np.sort(lengths, axis=1).T
    area: Floats = 0.25 * np.sqrt((a + (b + c)) * np.maximum(c - (a - b), 0)) * np.sqrt((c + (a - b)) * (a + (b - c)))
    return area


def hat_gradients(sides: Floats) -> tuple[Floats, Floats]:
    """Gradients of all hat functions but the first, in a frame of each simplex (its first axis along the first side); the frames."""
    count, side, space = sides.shape
    local, frames = np.zeros((count, side, side)), np.zeros((count, side, space))
    for j in range(side):
        rest = sides[:, j].copy()
        for a in range(j):
            local[:, j, a] = np.einsum("md,md->m", rest, frames[:, a])
            rest -= local[:, j, a, None] * frames[:, a]
        local[:, j, j] = np.linalg.norm(rest, axis=1)
        frames[:, j] = rest / np.where(local[:, j, j] > 0, local[:, j, j], 1.0)[:, None]
    flat = np.flatnonzero((np.einsum("mjj->mj", local) <= 0).any(axis=1))
    if len(flat):
        raise InputError(f"element {flat[0]} has no area; bt.operators(shape, laplacian='intrinsic_delaunay') can do without it")
    hats = np.zeros_like(local)  # inverse of the triangular `local`, transposed
    for j in range(side):
        hats[:, j, j] = 1 / local[:, j, j]
    for j in range(side):
        for k in range(j + 1, side):
            hats[:, j, k] = -np.einsum("ma,ma->m", local[:, k, j:k], hats[:, j, j:k]) / local[:, k, k]
    return np.ascontiguousarray(hats.reshape(count, -1)), frames
