"""Uses of a map to the sphere: transfer of functions, longitude-latitude images, maps between surfaces, best rotations,
spherical harmonics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..arrays import Floats, Ints
from ..errors import InputError
from ..near import closest_points, nearest_neighbors
from ..shapes import TriangleMesh

__all__ = ["SphericalHarmonics", "SurfaceMap"]


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceMap:
    """A map from the vertices of one surface into the triangles of another.

    Attributes
    ----------
    faces : ndarray (n,) of int32
        The triangle in which each vertex lands, a row of ``triangles``.
    barycentric : ndarray (n, 3)
        Barycentric coordinates in that triangle.
    triangles : ndarray (m, 3) of int32
        Triangles of the target.
    target_points : ndarray (k, D)
        Vertices of the target.
    """

    faces: Ints
    barycentric: Floats
    triangles: Ints
    target_points: Floats

    def __repr__(self) -> str:
        return f"SurfaceMap({len(self.faces)} vertices into {len(self.triangles)} triangles)"

    def pull_back(self, values: npt.ArrayLike) -> Floats:
        """Values (k,) or (k, c) of the target's vertices, at the source's vertices: linear in each triangle."""
        given = np.asarray(values)
        given = arrays.floats(given, "values", (len(self.target_points), *([None] * (given.ndim - 1))))
        corners = given[self.triangles[self.faces]]
        found: Floats = np.einsum("nk,nk...->n...", self.barycentric, corners)
        return found

    @property
    def points(self) -> Floats:
        """Images of the source's vertices on the target, (n, D)."""
        return self.pull_back(self.target_points)

    @property
    def vertices(self) -> Ints:
        """The target's vertex that is nearest to each image by barycentric coordinates, (n,)."""
        found: Ints = self.triangles[self.faces, self.barycentric.argmax(1)]
        return found


def surface_map(positions: Floats, target_positions: Floats, triangles: Ints, target_points: Floats) -> SurfaceMap:
    """Through the sphere: where the target's image triangles hold the source's image points."""
    found = closest_points(TriangleMesh(target_positions, triangles), positions)
    return SurfaceMap(np.asarray(found.faces, np.int32), found.barycentric, triangles, target_points)


def grid_directions(rows: int, columns: int) -> Floats:
    """Middles of the cells of a longitude-latitude image, (rows, columns, 3): north in the first row, longitude 0 (+x) at the left."""
    latitude = np.pi / 2 - (np.arange(rows) + 0.5) * (np.pi / rows)
    longitude = (np.arange(columns) + 0.5) * (2 * np.pi / columns)
    flat = np.cos(latitude)[:, None]
    return np.stack(
        [flat * np.cos(longitude), flat * np.sin(longitude), np.broadcast_to(np.sin(latitude)[:, None], (rows, columns))], axis=2
    )


def look_up(image: Floats, directions: Floats) -> Floats:
    """A longitude-latitude image (rows, columns, ...) at unit vectors (n, 3), bilinear, around the date line and over the poles."""
    rows, columns = image.shape[:2]
    y = (np.pi / 2 - np.arctan2(directions[:, 2], np.hypot(directions[:, 0], directions[:, 1]))) * (rows / np.pi) - 0.5
    x = (np.arctan2(directions[:, 1], directions[:, 0]) % (2 * np.pi)) * (columns / (2 * np.pi)) - 0.5
    top, left = np.floor(y).astype(np.int64), np.floor(x).astype(np.int64)
    fy, fx = y - top, x - left
    total: Any = 0.0
    for dy in (0, 1):
        for dx in (0, 1):
            row, column = top + dy, left + dx
            over = (row < 0) | (row >= rows)
            column = np.where(over, column + columns // 2, column) % columns  # beyond a pole: the other side of it
            weight = (fy if dy else 1 - fy) * (fx if dx else 1 - fx)
            part = image[np.clip(row, 0, rows - 1), column]
            total = total + weight.reshape(-1, *([1] * (part.ndim - 1))) * part
    found: Floats = total
    return found


def on_sphere(values: Callable[[Floats], npt.ArrayLike] | npt.ArrayLike, directions: Floats) -> Floats:
    """A function on the sphere, callable of (n, 3) unit vectors or longitude-latitude image, at unit vectors."""
    if callable(values):
        answer = np.asarray(values(directions.copy()))
        if answer.shape[:1] != (len(directions),):
            raise InputError(f"the function gave shape {answer.shape} for {len(directions)} unit vectors; one row each is needed")
        return arrays.floats(answer, "values", answer.shape)
    image = np.asarray(values)
    if image.ndim not in (2, 3):
        raise InputError(f"values have shape {image.shape}; a callable or a longitude-latitude image (rows, columns[, c]) is needed")
    return look_up(arrays.floats(image, "values", image.shape), directions)


def checkerboard(directions: Floats, squares: int = 12) -> Floats:
    """A continuous function whose sign is a checkerboard of the Mercator projection: squares stay squares under conformal maps.
    It grows alike from every side of a square, so that corners are as sharp as sides."""
    ring = np.hypot(directions[:, 0], directions[:, 1]).clip(1e-12)
    height = np.arcsinh(directions[:, 2] / ring)
    across, along = np.sin(squares * np.arctan2(directions[:, 1], directions[:, 0])), np.sin(squares * height)
    found: Floats = np.sign(across * along) * np.minimum(np.abs(across), np.abs(along))
    return found


def refined(vertices: Floats, faces: Ints, positions: Floats, least: int) -> tuple[TriangleMesh, Floats]:
    """The mesh with its triangles cut in four until it has ``least`` vertices, and images of the new vertices: for smooth pictures."""
    while len(vertices) < least:
        n = len(vertices)
        pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64), axis=1)
        keys, inverse = np.unique(pairs[:, 0] * n + pairs[:, 1], return_inverse=True)
        a, b = keys // n, keys % n
        middle = positions[a] + positions[b]
        positions = np.concatenate([positions, middle / np.sqrt((middle * middle).sum(1)).clip(1e-300)[:, None]])
        vertices = np.concatenate([vertices, 0.5 * (vertices[a] + vertices[b])])
        ab, bc, ca = inverse.reshape(3, -1) + n
        p, q, r = faces.T
        faces = np.concatenate([np.stack(part, 1) for part in ((p, ab, ca), (q, bc, ab), (r, ca, bc), (ab, bc, ca))]).astype(np.int32)
    return TriangleMesh(vertices, faces), positions


# --- rotations ----------------------------------------------------------------------------------------------------------------------


def quaternion_matrices(q: Floats) -> Floats:
    """Rotation matrices (k, 3, 3) of unit quaternions (k, 4)."""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def spread_rotations(count: int) -> Floats:
    """Rotations spread evenly, as quaternions: super-Fibonacci spirals (Alexa 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    t, d = s / count, 2 * np.pi * s
    r, big = np.sqrt(t), np.sqrt(1 - t)
    return np.stack([r * np.sin(d / phi), r * np.cos(d / phi), big * np.sin(d / psi), big * np.cos(d / psi)], axis=1)


def best_rotation(
    positions: Floats, values: Floats, weights: Floats, image: Floats, *, count: int = 4000, samples: int = 1500
) -> tuple[Floats, float]:
    """The rotation R (3, 3) for which ``values`` at ``positions @ R.T`` correlate best with a longitude-latitude image, and how well.

    All rotations of an even spread are tried on samples, then the best few are refined on halving scales with all points.
    """

    def scores(matrices: Floats, p: Floats, f: Floats, w: Floats) -> Floats:
        w = w / w.sum()
        centred = f - w @ f
        found = np.empty(len(matrices))
        for k, matrix in enumerate(matrices):
            g = look_up(image, p @ matrix.T)
            g = g - w @ g
            size = np.sqrt((w @ (g * g)).clip(1e-300) * (w @ (centred * centred)).clip(1e-300))
            found[k] = np.mean((w @ (g * centred)) / size)
        return found

    values, image = values.reshape(len(values), -1), image.reshape(*image.shape[:2], -1)
    # Deviations in units of the largest: no square leaves the range.
    values, image = values - values.mean(0), image - image.mean((0, 1))
    spans = np.abs(values).max(0), np.abs(image).max((0, 1))
    if any(not (span > 0).all() for span in spans):
        raise InputError("values that are constant on one of the two maps say nothing about rotations; leave that channel out")
    values, image = values / spans[0], image / spans[1]
    picked = nearest_neighbors(positions, grid_directions(samples // 50, 50).reshape(-1, 3), 1)[0][:, 0]
    area = np.cos(np.linspace(np.pi / 2, -np.pi / 2, samples // 50 + 2)[1:-1]).repeat(50)
    quaternions = spread_rotations(count)
    first = scores(quaternion_matrices(quaternions), positions[picked], values[picked], area)
    best, top = np.eye(3), -np.inf
    spread = spread_rotations(48)
    spread = spread * np.where(spread[:, :1] < 0, -1, 1)
    axes = spread[:, 1:] / np.linalg.norm(spread[:, 1:], axis=1)[:, None]
    for start in np.argsort(-first, kind="stable")[:5]:
        matrix = quaternion_matrices(quaternions[start : start + 1])[0]
        score, angle = float(scores(matrix[None], positions[picked], values[picked], area)[0]), 0.2
        while angle > 2e-3:
            turns = quaternion_matrices(np.column_stack([np.full(len(axes), np.cos(angle / 2)), np.sin(angle / 2) * axes])) @ matrix
            around = scores(turns, positions[picked], values[picked], area)
            if around.max() > score:
                matrix, score = turns[int(around.argmax())], float(around.max())
            else:
                angle /= 2
        final = float(scores(matrix[None], positions, values, weights)[0])
        if final > top:
            best, top = matrix, final
    u, _, v = np.linalg.svd(best)
    return np.asarray(u @ v, np.float64), top


# --- spherical harmonics ------------------------------------------------------------------------------------------------------------


def harmonics(directions: Floats, degree: int) -> Floats:
    """Real spherical harmonics, orthonormal on the unit sphere, (n, (degree + 1)²): column l (l + 1) + m."""
    x, y, z = directions.T
    found = np.zeros((len(z), (degree + 1) ** 2))
    ring = np.hypot(x, y)
    c, s = (np.divide(part, ring, out=np.full_like(ring, default), where=ring > 0) for part, default in ((x, 1.0), (y, 0.0)))
    cosine, sine = np.ones_like(z), np.zeros_like(z)
    diagonal = np.full_like(z, np.sqrt(1 / (4 * np.pi)))
    for m in range(degree + 1):
        older, newer = np.zeros_like(z), diagonal
        for order in range(m, degree + 1):
            if order > m:
                a = np.sqrt((4.0 * order * order - 1) / (order * order - m * m))
                b = np.sqrt(((order - 1.0) ** 2 - m * m) / (4 * (order - 1.0) ** 2 - 1)) if order > m + 1 else 0.0
                older, newer = newer, a * (z * newer - b * older)
            factor = np.sqrt(2.0) if m else 1.0
            found[:, order * (order + 1) + m] = factor * newer * cosine
            if m:
                found[:, order * (order + 1) - m] = factor * newer * sine
        diagonal = diagonal * ring * np.sqrt((2 * m + 3) / (2 * m + 2))
        cosine, sine = cosine * c - sine * s, sine * c + cosine * s
    return found


@dataclass(frozen=True, eq=False, repr=False)
class SphericalHarmonics:
    """A shape (or any values) as a sum of real spherical harmonics, orthonormal on the unit sphere.

    Attributes
    ----------
    coefficients : ndarray ((degree + 1)², c)
        Row l (l + 1) + m belongs to degree l and order m, -l <= m <= l.
    degree : int
    error : float
        Root mean square of the remainder, divided by the root-mean-square distance from the mean.
    """

    coefficients: Floats
    degree: int
    error: float

    def __repr__(self) -> str:
        return f"SphericalHarmonics(degree {self.degree}, relative error {self.error:.3g})"

    def __call__(self, directions: npt.ArrayLike) -> Floats:
        """The sum at unit vectors (n, 3), (n, c). Other lengths are refused."""
        found: Floats = harmonics(arrays.unit_vectors(directions, "directions"), self.degree) @ self.coefficients
        return found

    @property
    def power(self) -> Floats:
        """Sum of squares in each degree, (degree + 1,): it does not change when the sphere is turned."""
        each = (self.coefficients**2).sum(1)
        return np.array([each[k * k : (k + 1) ** 2].sum() for k in range(self.degree + 1)])


def fit_harmonics(positions: Floats, weights: Floats, values: Floats, degree: int) -> SphericalHarmonics:
    """Weighted least squares."""
    basis = harmonics(positions, degree)
    root = np.sqrt(weights / weights.sum())[:, None]
    coefficients = np.linalg.lstsq(root * basis, root * values, rcond=None)[0]
    left = np.sqrt((root**2 * (values - basis @ coefficients) ** 2).sum())
    mean = (root**2 * values).sum(0)
    size = np.sqrt((root**2 * (values - mean) ** 2).sum())
    return SphericalHarmonics(coefficients, degree, float(left / size) if size > 0 else 0.0)
