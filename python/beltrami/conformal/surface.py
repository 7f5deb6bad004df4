"""Triangles that carry a map to the sphere, and E - A on them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .. import _core
from ..arrays import Floats
from ..errors import InputError

Faces = npt.NDArray[np.int64]


def corner_products(vertices: Floats, faces: Faces) -> tuple[Floats, Floats]:
    """Inner product (m, 3) of the two edges at each corner, and twice the area (m,), of triangles in R^D.

    Coordinates are gathered one by one: rows of three are the slowest that numpy knows.
    """
    columns = np.ascontiguousarray(vertices.T)
    p, q, r = (columns.take(faces[:, k], axis=1) for k in range(3))
    edges = (r - q, p - r, q - p)  # opposite to each corner
    dots = np.empty((len(faces), 3))
    for k in range(3):
        dots[:, k] = -(edges[(k + 1) % 3] * edges[(k + 2) % 3]).sum(0)
    if len(columns) == 3:
        (a, b, c), (x, y, z) = edges[2], edges[1]
        double = np.sqrt((b * z - c * y) ** 2 + (c * x - a * z) ** 2 + (a * y - b * x) ** 2)
    else:
        gram = (edges[2] ** 2).sum(0) * (edges[1] ** 2).sum(0) - dots[:, 0] ** 2
        double = np.sqrt(np.maximum(gram, 0.0))
    return dots, double


def corner_cotangents(vertices: Floats, faces: Faces) -> tuple[Floats, Floats]:
    """Cotangents (m, 3) of the corners, and areas (m,)."""
    dots, double = corner_products(vertices, faces)
    with np.errstate(divide="ignore", invalid="ignore"):
        return dots / double[:, None], 0.5 * double


def corner_angles(vertices: Floats, faces: Faces) -> Floats:
    dots, double = corner_products(vertices, faces)
    angles: Floats = np.arctan2(double[:, None], dots)
    return angles


def determinants(s: Floats, faces: Faces) -> Floats:
    """p . ((q - p) x (r - p)) of each image triangle: by differences, for p . (q x r) is rounding noise on small triangles."""
    p = s[faces[:, 0]]
    found: Floats = np.einsum("ij,ij->i", p, row_crosses(s[faces[:, 1]] - p, s[faces[:, 2]] - p))
    return found


def lumped(areas: Floats, faces: Faces, count: int) -> Floats:
    return np.bincount(faces.ravel(), weights=np.repeat(areas / 3, 3), minlength=count).astype(np.float64)


class Surface:
    """Triangles that carry a map, and E - A on them: a closed mesh whose faces look outwards, or the simplices of a cloud, each with
    the weight of its votes and, for they have no orientation, with unsigned image areas."""

    def __init__(self, vertices: Floats, faces: Faces, weights: Floats | None = None) -> None:
        self.vertices, self.faces, self.count = vertices, faces, len(vertices)
        self.weights = weights
        self.cotangents, self.areas = corner_cotangents(vertices, faces)
        if weights is not None:
            self.cotangents, self.areas = self.cotangents * weights[:, None], self.areas * weights
        self.mass = lumped(self.areas, faces, self.count)
        self._corners = np.ascontiguousarray(faces, np.int32)

    def energy_and_area(self, s: Floats) -> tuple[float, float]:
        """E by the mesh's own cotangents, A with the sign of each triangle's determinant."""
        p, q, r = (s[self.faces[:, k]] for k in range(3))
        e = (r - q, p - r, q - p)
        energy = 0.25 * sum(float((self.cotangents[:, k] * row_products(e[k], e[k])).sum()) for k in range(3))
        cross = row_crosses(e[2], -e[1])
        area = 0.5 * float((row_lengths(cross) * self._signs(row_products(p, cross))).sum())
        return energy, area

    def _signs(self, determinants: Floats) -> Floats:
        found: Floats = np.sign(determinants) if self.weights is None else self.weights
        return found

    def gradient(self, s: Floats) -> tuple[Floats, Floats, float]:
        """Gradient of E - A (n, 3), face by face from edge differences; lumped image areas; E - A."""
        return _core.excess_gradient(np.ascontiguousarray(s), self._corners, self.cotangents, self.weights)

    def regularize(self) -> None:
        """Degenerate triangles count as equilateral ones of hardly any area, so that the repair can deal with them."""
        bad = ~np.isfinite(self.cotangents).all(1) | (self.areas <= 0)
        self.cotangents[bad] = np.sqrt(1 / 3)
        self.areas[bad] = max(1e-9 * float(self.areas.mean()), 1e-300)
        self.mass = lumped(self.areas, self.faces, self.count)

    def flipped(self, s: Floats) -> npt.NDArray[np.bool_]:
        """Which triangles are turned over, or have no area."""
        turned: npt.NDArray[np.bool_] = determinants(s, self.faces) <= 0
        return turned


def row_products(a: Floats, b: Floats) -> Floats:
    """Inner product of each row."""
    found: Floats = np.einsum("ij,ij->i", a, b)
    return found


def row_lengths(a: Floats) -> Floats:
    """Length of each row."""
    found: Floats = np.sqrt(row_products(a, a))
    return found


def row_crosses(a: Floats, b: Floats) -> Floats:
    """Cross product of each row; numpy's is several times slower."""
    out = np.empty_like(a)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[:, k] = a[:, i] * b[:, j] - a[:, j] * b[:, i]
    return out


def unit_rows(s: Floats) -> Floats:
    """Rows of length 1."""
    found: Floats = s / np.sqrt(row_products(s, s))[:, None]
    return found


def scaled(vertices: Floats) -> tuple[Floats, float]:
    """Vertices about the origin and of size 1, so that products of lengths stay in range; and the size they had."""
    middle = 0.5 * (vertices.max(0) + vertices.min(0))
    moved = vertices - middle
    size = float(np.abs(moved).max())
    if not size > 0 or not np.isfinite(size):
        raise InputError(f"the vertices span {size:g}; a surface is needed")
    if not 1e-150 < size < 1e150:
        raise InputError(f"the vertices span {size:g}, so that areas leave the range of double precision; use other units")
    return moved / size, size
