"""Conformal maps of closed surfaces of genus 0 to the unit sphere, and the Möbius maps of the sphere.

A map s of the vertices to the unit sphere has the Dirichlet energy E(s) = 1/2 tr(s^T L s) and its image polyhedron the signed area
A(s). E - A is never negative, and zero only where every triangle keeps its angles: that is what is minimized and reported, for E alone
is smallest where all vertices meet in one point. Möbius maps change neither E nor A in the limit of fine meshes; the one map that
is returned has its area-weighted centre at the origin.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

import numpy as np
import numpy.typing as npt
import scipy

from .. import _core, arrays
from ..arrays import Floats, Ints
from ..errors import InputError, NumericalError, TopologyError
from ..files import save_fields
from ..operators import Operators, operators
from ..progress import Progress, reporter, teller
from ..shapes import PointCloud, Shape, TriangleMesh, no_shape
from ..solvers import Cholesky, plus_diagonal
from ..view import Page, Picture, plot
from . import genus, spherical
from .moebius import Moebius

if TYPE_CHECKING:
    from ..clouds import CloudOperators

Faces = npt.NDArray[np.int64]

__all__ = ["SphericalMapResult", "spherical_map"]

STILL_FLIPPED = "still flipped"  # in the note that says how many are


# --- the result ---------------------------------------------------------------------------------------------------------------------


def _needed(value: Any, name: str, kind: type) -> None:
    if not isinstance(value, kind):
        raise InputError(f"{name} is a {type(value).__name__}; a {kind.__name__} is needed")


@dataclass(frozen=True, eq=False, repr=False)
class SphericalMapResult:
    """A map of a shape to the unit sphere, with what certifies it.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
        What was mapped.
    positions : ndarray (n, 3)
        Images of the vertices, unit vectors; their mean, weighted by the areas of the source, is zero.
    conformal_factor : ndarray (n,)
        Lumped area of the image over that of the source, in 1 / length².
    energy, area : float
        Dirichlet energy E by the mesh's own cotangents, and signed area A of the image polyhedron.
    flipped : int
        Triangles whose image is turned over.
    angle_error : ndarray (m,)
        Mean change of a triangle's three angles, in radians.
    dilatation : ndarray (m,)
        Ratio of the greater to the smaller stretch of each triangle: 1 where it is conformal, infinite where the triangle or its
        image has no area.
    iterations : int
    converged : bool
    history : dict of str to ndarray
        ``move`` (root mean square move of each step) and ``excess`` (E - A before each step).
    notes : tuple of str
        What is worth knowing about how the map was found.
    faces : ndarray (m, 3) of int32
        The triangles of the map: those of the mesh, turned outwards where they looked inwards; of a cloud the simplices of the stars.
    weights : ndarray (m,)
        How much each triangle counts: 1, of a cloud the share of its corners whose star holds it.
    """

    shape: Shape
    positions: Floats
    conformal_factor: Floats
    energy: float
    area: float
    flipped: int
    angle_error: Floats
    dilatation: Floats
    iterations: int
    converged: bool
    history: dict[str, Floats]
    notes: tuple[str, ...] = ()
    faces: Ints = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    weights: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def excess(self) -> float:
        """E - A: zero only for a map that keeps all angles."""
        return self.energy - self.area

    def __repr__(self) -> str:
        return (
            f"SphericalMapResult({len(self.positions)} vertices, E - A = {self.excess:.4g}, mean angle error "
            f"{np.degrees(self.angle_error.mean()):.3g} degrees, {self.flipped} flipped)"
        )

    @property
    def sphere(self) -> TriangleMesh:
        """The image as a mesh."""
        return TriangleMesh(self.positions, self.faces)

    @cached_property
    def image_areas(self) -> Floats:
        """Lumped areas of the image, (n,)."""
        return _lumped(_corner_cotangents(self.positions, self.faces.astype(np.int64))[1], self.faces.astype(np.int64), len(self.positions))

    def pull_back(self, values: Callable[[Floats], npt.ArrayLike] | npt.ArrayLike) -> Floats:
        """A function on the sphere, at the vertices of the shape.

        Parameters
        ----------
        values : callable or array_like (rows, columns) or (rows, columns, channels)
            Of unit vectors (n, 3); or a longitude-latitude image (a texture): north in the first row, longitude 0 (+x) at the left.

        Returns
        -------
        ndarray (n,) or (n, channels)

        Examples
        --------
        >>> import beltrami as bt
        >>> r = bt.spherical_map(bt.shapes.sphere(2))
        >>> r.pull_back(lambda p: p[:, 2]).shape
        (162,)
        """
        return spherical.on_sphere(values, self.positions)

    def image(self, values: npt.ArrayLike | None = None, *, rows: int = 256, columns: int = 512) -> Floats:
        """The longitude-latitude image of values at the vertices, (rows, columns, ...); without values that of the coordinates, a
        geometry image.

        Parameters
        ----------
        values : array_like (n,) or (n, c), optional
        rows, columns : int

        Returns
        -------
        ndarray (rows, columns) or (rows, columns, c)
        """
        given = np.asarray(self.shape.coordinates if values is None else values)
        given = arrays.floats(given, "values", (len(self.positions), *([None] * (given.ndim - 1))))
        rows, columns = arrays.whole(rows, "rows", 2), arrays.whole(columns, "columns", 2)
        channels = given.size // len(given)
        arrays.room((20.0 + 2 * channels) * rows * columns, f"a grid of {rows} x {columns}", "take fewer rows or columns")
        directions = spherical.grid_directions(rows, columns).reshape(-1, 3)
        found = spherical.surface_map(directions, self.positions, self.faces, self.shape.coordinates).pull_back(given)
        return found.reshape(rows, columns, *given.shape[1:])

    def map_to(self, other: SphericalMapResult) -> spherical.SurfaceMap:
        """The conformal map to another surface through the sphere. Align the two first: :meth:`aligned_to`.

        Parameters
        ----------
        other : SphericalMapResult

        Returns
        -------
        SurfaceMap
            ``points`` are the images of this shape's vertices; ``pull_back`` brings values over.

        Examples
        --------
        >>> import beltrami as bt
        >>> fine, coarse = (bt.spherical_map(bt.shapes.ellipsoid(level=level)) for level in (3, 2))
        >>> fine.aligned_to(coarse, fine.shape.vertices, coarse.shape.vertices).map_to(coarse).points.shape
        (642, 3)
        """
        _needed(other, "other", SphericalMapResult)
        return spherical.surface_map(self.positions, other.positions, other.faces, other.shape.coordinates)

    def turned(self, rotation: npt.ArrayLike) -> SphericalMapResult:
        """The same map, its sphere turned by a (3, 3) rotation matrix: each position p becomes ``rotation @ p``."""
        matrix = arrays.floats(rotation, "rotation", (3, 3))
        if np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-8 or np.linalg.det(matrix) < 0:
            raise InputError("rotation is not orthogonal with determinant 1")
        return replace(self, positions=_unit(self.positions @ matrix.T))

    def moved(self, moebius: Moebius) -> SphericalMapResult:
        """The map followed by a Möbius map of the sphere, with all that is measured on it measured again.

        Raises
        ------
        NumericalError
            What the map crowds together rounds away.
        """
        _needed(moebius, "moebius", Moebius)
        faces = self.faces.astype(np.int64)
        weights = None
        if isinstance(self.shape, PointCloud):
            weights = self.weights
        vertices, size = _scaled(self.shape.coordinates)
        surface = _Surface(vertices, faces, weights)
        if weights is not None:
            surface.mass = operators(self.shape).mass / size**2
        trace = _Trace(list(self.history["move"]), list(self.history["excess"]), self.converged)
        folded = None if weights is None else np.zeros(len(faces), bool)
        notes = self.notes if folded is not None else tuple(note for note in self.notes if STILL_FLIPPED not in note)  # told anew
        made = _certified(self.shape, surface, moebius(self.positions), size, trace, notes, folded)
        return made if weights is None else replace(made, flipped=self.flipped)

    def with_landmarks(self, vertices: npt.ArrayLike, directions: npt.ArrayLike) -> SphericalMapResult:
        """The map that takes three vertices to three given directions exactly (the area-weighted centre is then no longer the origin).

        Parameters
        ----------
        vertices : array_like (3,) of int
        directions : array_like (3, 3)
            Unit vectors: :attr:`positions` of another map's landmarks, for example.
        """
        picked = arrays.indices(vertices, "vertices", len(self.positions))
        if len(picked) != 3:
            raise InputError(f"vertices has {len(picked)} numbers; three landmarks fix a Möbius map")
        return self.moved(Moebius.through(self.positions[picked], directions))

    def aligned_to(
        self, other: SphericalMapResult, values: npt.ArrayLike | None = None, other_values: npt.ArrayLike | None = None
    ) -> SphericalMapResult:
        """The same map, its sphere turned so that values on it correlate best with another map's.

        Parameters
        ----------
        other : SphericalMapResult
        values, other_values : array_like (n,) or (n, c), optional
            At this shape's vertices and at the other's, e.g. sulcal depths; by default the logarithms of the conformal factors.

        Returns
        -------
        SphericalMapResult

        Notes
        -----
        4000 rotations spread evenly are tried on a sample of points, the best five are refined to 0.002 radians.
        """
        _needed(other, "other", SphericalMapResult)
        if (values is None) != (other_values is None):
            raise InputError("give values of both maps, or of neither")
        pairs = []
        for result, given, name in ((self, values, "values"), (other, other_values, "other_values")):
            array = np.log(result.conformal_factor.clip(1e-300)) if given is None else np.asarray(given)
            pairs.append(arrays.floats(array, name, (len(result.positions), *([None] * (array.ndim - 1)))))
        if pairs[0].shape[1:] != pairs[1].shape[1:]:
            raise InputError(f"values have {pairs[0].shape[1:]} channels, other_values {pairs[1].shape[1:]}; they must be equal")
        image = other.image(pairs[1], rows=90, columns=180)
        return self.turned(spherical.best_rotation(self.positions, pairs[0], self.image_areas, image)[0])

    def harmonics(self, degree: int = 15, values: npt.ArrayLike | None = None) -> spherical.SphericalHarmonics:
        """Coefficients of the shape, or of values at its vertices, in spherical harmonics: least squares weighted by image areas.

        Parameters
        ----------
        degree : int
            From 0 to 100.
        values : array_like (n,) or (n, c), optional
            By default the coordinates of the vertices.

        Raises
        ------
        InputError
            There are fewer vertices than coefficients.

        References
        ----------
        Brechbühler, Gerig and Kübler, Parametrization of closed surfaces for 3-D shape description, 1995.

        Examples
        --------
        >>> import beltrami as bt
        >>> r = bt.spherical_map(bt.shapes.ellipsoid(level=3))
        >>> r.harmonics(7).error < 0.01
        True
        """
        degree = arrays.whole(degree, "degree", 0, 100)
        if (degree + 1) ** 2 > len(self.positions):
            raise InputError(f"degree {degree} has {(degree + 1) ** 2} coefficients, the shape {len(self.positions)} vertices")
        given = np.asarray(self.shape.coordinates if values is None else values)
        given = arrays.floats(given, "values", (len(self.positions), *([None] * (given.ndim - 1))))
        return spherical.fit_harmonics(self.positions, self.image_areas, given.reshape(len(given), -1), degree)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes all arrays and numbers of the map to ``.npz`` (the histories as ``history_move`` and ``history_excess``; neither the
        shape nor the notes), the shape with positions on the sphere and factor to ``.ply``, a picture to ``.png`` or ``.html``.

        Raises
        ------
        InputError
            The suffix is none of these.
        FileError
            The file cannot be written.
        """
        file = arrays.file(path, "path")
        suffix = file.suffix.lower()
        if suffix in (".png", ".html"):
            self.plot(path=file)
            return file
        if suffix not in (".npz", ".ply"):
            raise InputError(f"{file}: a map to the sphere is written to .npz, .ply, .png or .html")
        kept = {one.name: getattr(self, one.name) for one in fields(self) if one.name not in ("shape", "history", "notes")}
        kept |= {f"history_{name}": column for name, column in self.history.items()}
        return save_fields(self.shape, kept, file, values=("positions", "conformal_factor"))

    def plot(
        self,
        values: Any = "checkerboard",
        *,
        on: Literal["shape", "sphere"] = "shape",
        path: str | os.PathLike[str] | None = None,
        **options: Any,
    ) -> Picture | Page:
        """Paints the shape or the sphere.

        Parameters
        ----------
        values : str or array_like
            ``"checkerboard"``: squares of the sphere's Mercator projection, on which a conformal map leaves right angles;
            ``"angle_error"`` (degrees); ``"conformal_factor"`` (its logarithm, base 10); or what :func:`beltrami.plot` takes.
        on : {"shape", "sphere"}
        path, **options
            As for :func:`beltrami.plot`.
        """
        target: Any = self.sphere if arrays.word(on, "on", ("shape", "sphere")) == "sphere" else self.shape
        if isinstance(values, str):
            if values == "checkerboard":
                source = self.positions if on == "sphere" else self.shape.coordinates
                positions = self.positions
                if isinstance(target, TriangleMesh) and len(self.faces):
                    target, positions = spherical.refined(source, self.faces, positions, 40_000)
                values = spherical.checkerboard(positions)
                options = {"colormap": ["#27466b", "#f3e9d2"], "limits": (-0.02, 0.02), "color_bar": False, **options}
            elif values == "angle_error":
                values = at_vertices(self, np.degrees(self.angle_error))
                options = {"label": "angle error (degrees)", "limits": (0.0, float(np.quantile(values, 0.98)) or 1.0), **options}
            elif values == "conformal_factor":
                values = np.log10(self.conformal_factor.clip(1e-300))
                options = {"label": "log10 conformal factor", **options}
            else:
                raise InputError(f"values is {values!r}; choose 'checkerboard', 'angle_error' or 'conformal_factor', or give an array")
        return plot(target, values, path=path, **options)


def at_vertices(result: SphericalMapResult, values: Floats) -> Floats:
    """Values of triangles, averaged at the vertices."""
    corners = result.faces.ravel()
    sums = np.bincount(corners, np.repeat(values, 3), len(result.positions))
    found: Floats = sums / np.bincount(corners, minlength=len(result.positions)).clip(1)
    return found


# --- triangles ----------------------------------------------------------------------------------------------------------------------


def _corners(vertices: Floats, faces: Faces) -> tuple[Floats, Floats]:
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


def _corner_cotangents(vertices: Floats, faces: Faces) -> tuple[Floats, Floats]:
    """Cotangents (m, 3) of the corners, and areas (m,)."""
    dots, double = _corners(vertices, faces)
    with np.errstate(divide="ignore", invalid="ignore"):
        return dots / double[:, None], 0.5 * double


def _corner_angles(vertices: Floats, faces: Faces) -> Floats:
    dots, double = _corners(vertices, faces)
    angles: Floats = np.arctan2(double[:, None], dots)
    return angles


def _determinants(s: Floats, faces: Faces) -> Floats:
    """p . ((q - p) x (r - p)) of each image triangle: by differences, for p . (q x r) is rounding noise on small triangles."""
    p = s[faces[:, 0]]
    found: Floats = np.einsum("ij,ij->i", p, _cross(s[faces[:, 1]] - p, s[faces[:, 2]] - p))
    return found


def _lumped(areas: Floats, faces: Faces, count: int) -> Floats:
    return np.bincount(faces.ravel(), weights=np.repeat(areas / 3, 3), minlength=count).astype(np.float64)


class _Surface:
    """Triangles that carry a map, and E - A on them: a closed mesh whose faces look outwards, or the simplices of a cloud, each with
    the weight of its votes and, for they have no orientation, with unsigned image areas."""

    def __init__(self, vertices: Floats, faces: Faces, weights: Floats | None = None) -> None:
        self.vertices, self.faces, self.count = vertices, faces, len(vertices)
        self.weights = weights
        self.cotangents, self.areas = _corner_cotangents(vertices, faces)
        if weights is not None:
            self.cotangents, self.areas = self.cotangents * weights[:, None], self.areas * weights
        self.mass = _lumped(self.areas, faces, self.count)
        self._corners = np.ascontiguousarray(faces, np.int32)

    def energy_and_area(self, s: Floats) -> tuple[float, float]:
        """E by the mesh's own cotangents, A with the sign of each triangle's determinant."""
        p, q, r = (s[self.faces[:, k]] for k in range(3))
        e = (r - q, p - r, q - p)
        energy = 0.25 * sum(float((self.cotangents[:, k] * _rows(e[k], e[k])).sum()) for k in range(3))
        cross = _cross(e[2], -e[1])
        area = 0.5 * float((_length(cross) * self._signs(_rows(p, cross))).sum())
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
        self.mass = _lumped(self.areas, self.faces, self.count)

    def flipped(self, s: Floats) -> npt.NDArray[np.bool_]:
        """Which triangles are turned over, or have no area."""
        turned: npt.NDArray[np.bool_] = _determinants(s, self.faces) <= 0
        return turned


# --- Möbius maps --------------------------------------------------------------------------------------------------------------------


def _rows(a: Floats, b: Floats) -> Floats:
    """Inner product of each row."""
    found: Floats = np.einsum("ij,ij->i", a, b)
    return found


def _length(a: Floats) -> Floats:
    """Length of each row."""
    found: Floats = np.sqrt(_rows(a, a))
    return found


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross product of each row; numpy's is several times slower."""
    out = np.empty_like(a)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[:, k] = a[:, i] * b[:, j] - a[:, j] * b[:, i]
    return out


def _unit(s: Floats) -> Floats:
    """Rows of length 1."""
    found: Floats = s / np.sqrt(_rows(s, s))[:, None]
    return found


def centring_steps(s: Floats, mass: Floats, most: int = 100) -> tuple[list[Floats], Floats]:
    """Translations whose product makes the mean, weighted by the mass, zero (Baden, Crane and Kazhdan 2018), and the centred points."""
    weights, s = mass / mass.sum(), np.ascontiguousarray(s)
    mean = np.einsum("i,ij->j", weights, s)
    best = float(np.linalg.norm(mean))
    steps: list[Floats] = []
    for _ in range(most):
        if best < 3e-16:
            break
        jacobian = 2 * (np.eye(3) - np.einsum("ij,ik->jk", s * weights[:, None], s))
        c = -np.linalg.solve(jacobian + 1e-14 * np.eye(3), mean)
        length = float(np.linalg.norm(c))
        c *= min(1.0, 0.75 / length) if length > 0 else 1.0
        for _ in range(30):
            moved, total = _core.moebius_translated(s, (float(c[0]), float(c[1]), float(c[2])), weights)
            mean_moved = np.array(total)
            size = float(np.linalg.norm(mean_moved))
            if size < best:
                break
            c /= 2
        else:
            break
        done = best < 1e-13 and size > 0.25 * best
        s, mean, best = moved, mean_moved, size
        steps.append(c)
        if done:
            break
    return steps, s


def _centred(s: Floats, mass: Floats, most: int = 100) -> Floats:
    return centring_steps(s, mass, most)[1]


# --- the fast route -----------------------------------------------------------------------------------------------------------------


def _tangential(vectors: Floats, s: Floats) -> Floats:
    found: Floats = vectors - _rows(vectors, s)[:, None] * s
    return found


def _without_turn(moves: Floats, s: Floats, weights: Floats) -> Floats:
    """Tangential moves less their mean rotation: the energy knows none, and steps that all turn a little never end."""
    weighted = s * weights[:, None]
    inertia = np.eye(3) - np.einsum("ij,ik->jk", weighted, s)
    moment = np.einsum("ij,ik->jk", weighted, moves)  # its skew part is the sum of the cross products
    x, y, z = np.linalg.solve(inertia, [moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], moment[0, 1] - moment[1, 0]])
    turned: Floats = np.einsum("ij,kj->ik", s, np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    return moves - turned


def _start(surface: _Surface, solve: Callable[[Floats], Floats]) -> Floats:
    """A linear map to the plane with its pole in one large and well-shaped triangle, and up to the sphere (Haker et al. 2000)."""
    v, f = surface.vertices, surface.faces
    sides = _corners(v, f)[0].sum(1)  # half the sum of squared sides
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
    z = z / np.median(np.sqrt(_rows(z, z)))
    square = _rows(z, z)
    s = np.column_stack([2 * z, square - 1]) / (1 + square)[:, None]
    if surface.weights is None and np.sign(_determinants(s, f)).sum() < 0:
        s[:, 1] *= -1
    return _unit(s)


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
class _Trace:
    move: list[float] = field(default_factory=list)
    excess: list[float] = field(default_factory=list)
    converged: bool = False


def _descend(
    surface: _Surface,
    solve: Callable[[Floats], Floats],
    gradient: Callable[[Floats], tuple[Floats, Floats, float]],
    s: Floats,
    tolerance: float,
    steps: int,
    report: Callable[[float], object],
) -> tuple[Floats, _Trace]:
    """Preconditioned descent of E - A with Anderson acceleration; the centre stays at the origin, for which one Newton step
    each time does, and all at the end.

    Where rounding ends the progress before the tolerance is met, the map that moved least is returned.
    """
    trace, weights = _Trace(), surface.mass / surface.mass.sum()
    best, still = (np.inf, s), 0
    residuals: list[Floats] = []
    images: list[Floats] = []
    for step in range(steps):
        g, image_areas, excess = gradient(s)
        g = _tangential(g, s)
        share = image_areas / image_areas.sum()
        g -= share[:, None] * np.einsum("ij->j", g)
        d = solve(g)
        d -= np.einsum("i,ij->j", share, d)
        image = _centred(_unit(s - _without_turn(_tangential(d, s), s, weights)), surface.mass, 1)
        residuals, images = [*residuals[-3:], image - s], [*images[-3:], image]
        move = float(np.sqrt((weights * _rows(residuals[-1], residuals[-1])).sum()))
        trace.move.append(move)
        trace.excess.append(excess)
        best, still = ((move, s), 0) if move < best[0] else (best, still + 1)
        s = _centred(_unit(_anderson(residuals, images, weights)), surface.mass, 1)
        report((step + 1) / steps)
        if move < tolerance:
            trace.converged = True
            break
        if still == 6 and best[0] < 1e-6:
            s = best[1]
            break
    return _centred(s, surface.mass), trace


# --- the chapter's iteration --------------------------------------------------------------------------------------------------------


def _cayley_step(s: Floats, h: Floats, tau: float) -> Floats:
    """(I + τ/2 A)^-1 (I - τ/2 A) s with A = h s^T - s h^T (8.28): A has rank two, so a turn in the plane of s and h. h is tangential."""
    square = (0.25 * tau * tau * _rows(h, h))[:, None]
    return _unit(((1 - square) * s - tau * h) / (1 + square))


def _cayley(
    surface: _Surface,
    metric: Callable[[Floats], Floats] | None,
    stiffness: scipy.sparse.csr_array,
    s: Floats,
    tolerance: float,
    steps: int,
    report: Callable[[float], object],
) -> tuple[Floats, _Trace]:
    """Cayley steps of Barzilai-Borwein length with a nonmonotone line search (Wen and Yin 2013).

    The direction is the gradient of E - A by unit mass, or with ``metric`` L^-1 of the gradient; its part along Möbius maps is taken
    off, so that the centre stays.
    """
    mass = surface.mass * (4 * np.pi / surface.mass.sum())

    def evaluate(s: Floats) -> tuple[float, Floats, Floats]:
        g, areas, excess = surface.gradient(s)
        g = _tangential(g, s)
        moebius = np.eye(3) * mass.sum() - (s * mass[:, None]).T @ s
        if metric is None:
            h = g / mass[:, None]
        else:
            share = (areas / areas.sum())[:, None]
            h = metric(g - share * g.sum(0))
            h = _tangential(h - (share * h).sum(0), s)
        h = h - _tangential(np.broadcast_to(np.linalg.solve(moebius, mass @ h), s.shape), s)
        return excess, g, h

    trace = _Trace()
    value, g, h = evaluate(s)
    reference, count, tau = value, 1.0, 1.0 if metric is not None else float((mass / np.maximum(stiffness.diagonal(), 1e-300)).min())
    for step in range(steps):
        residual = float(np.sqrt(mass @ _rows(h, h) / mass.sum()))
        trace.move.append(residual)
        trace.excess.append(value)
        report((step + 1) / steps)
        if residual < tolerance:
            trace.converged = True
            break
        slope = float((g * h).sum())
        for _ in range(40):
            new = _centred(_cayley_step(s, h, tau), surface.mass)
            new_value, new_g, new_h = evaluate(new)
            if new_value <= reference - 1e-4 * tau * slope + 1e-14 * abs(reference):
                break
            tau *= 0.2
        else:
            break
        ds, dh = new - s, new_h - h
        weighted = mass[:, None] * ds if metric is None else stiffness @ ds
        weighted_h = mass[:, None] * dh if metric is None else stiffness @ dh
        ss, sy, yy = float((ds * weighted).sum()), abs(float((ds * weighted_h).sum())), float((dh * weighted_h).sum())
        tau = ss / max(sy, 1e-300) if step % 2 else sy / max(yy, 1e-300)
        tau = min(max(tau, 1e-12), 1e6)
        s, value, g, h = new, new_value, new_g, new_h
        reference, count = (0.85 * count * reference + value) / (0.85 * count + 1), 0.85 * count + 1
    return s, trace


# --- repair of what is still turned over ---------------------------------------------------------------------------------------------


class _Patch:
    """Vertices that may move, the triangles around them, in a stereographic chart at the middle of the patch.

    The chart is made from differences and scaled to size 1, so that patches of any size down to rounding are treated alike.
    """

    def __init__(self, surface: _Surface, s: Floats, free: Faces, triangles: Faces) -> None:
        faces = surface.faces[triangles]
        self.vertices, local = np.unique(faces, return_inverse=True)
        self.faces = local.reshape(-1, 3)
        self.free = np.searchsorted(self.vertices, free)
        self.cotangents = surface.cotangents[triangles]
        self.shares = surface.areas[triangles] / surface.areas.sum()
        self.shares = self.shares / self.shares.sum()
        here = s[self.vertices]
        rim = np.ones(len(here), bool)
        rim[self.free] = False
        centre = here[rim].mean(0)
        if np.linalg.norm(centre) < 1e-3:
            centre = here.mean(0)
        self.centre = centre / np.linalg.norm(centre)
        axis = np.eye(3)[np.argmin(np.abs(self.centre))]
        first = axis - (axis @ self.centre) * self.centre
        first /= np.linalg.norm(first)
        self.frame = np.stack([first, np.cross(self.centre, first)])
        away = here - self.centre
        z = 2 * (away @ self.frame.T) / (4 - _rows(away, away))[:, None]
        self.scale = float(np.sqrt(_rows(z, z).max()))
        self.z = z / self.scale

    def lifted(self, z: Floats) -> Floats:
        """Sphere positions minus the centre of the chart, over the scale."""
        square = self.scale**2 * _rows(z, z)
        found: Floats = (2 * (z @ self.frame) - (2 / self.scale * square)[:, None] * self.centre) / (1 + square)[:, None]
        return found

    def pulled(self, z: Floats, lifted: Floats, gradient: Floats) -> Floats:
        """A gradient by lifted positions as one by chart coordinates."""
        denominator = (1 + self.scale**2 * _rows(z, z))[:, None]
        along = -2 * self.scale**2 * _rows(gradient, lifted)[:, None] * z
        across = 2 * (gradient @ self.frame.T) - 4 * self.scale * (gradient @ self.centre)[:, None] * z
        found: Floats = (across + along) / denominator
        return found

    def measure(self, z: Floats) -> tuple[Floats, Floats, Floats, tuple[Floats, Floats, Floats]]:
        """Lifted positions, energy E_T and half the determinant d of each triangle, its edges."""
        x = self.lifted(z)
        p, q, r = (x[self.faces[:, k]] for k in range(3))
        e = (r - q, p - r, q - p)
        squares = np.stack([_rows(one, one) for one in e], axis=1)
        energy = 0.25 * _rows(self.cotangents, squares)
        base = self.centre + self.scale * p
        determinant = 0.5 * _rows(base, _cross(e[2], -e[1]))
        return x, energy, determinant, e

    def sizes(self, z: Floats) -> Floats:
        """Area of an equilateral triangle with the mean edge around each triangle's corners."""
        x = self.lifted(z)
        a, b = self.faces.ravel(), self.faces[:, [1, 2, 0]].ravel()
        length = np.sqrt(((x[a] - x[b]) ** 2).sum(1))
        total = np.bincount(a, length, len(x)) + np.bincount(b, length, len(x))
        mean = total / (np.bincount(a, minlength=len(x)) + np.bincount(b, minlength=len(x)))
        found: Floats = np.maximum(0.43 * mean[self.faces].mean(1) ** 2, 1e-24)
        return found

    def objective(self, z: Floats, epsilon: Floats) -> tuple[float, Floats, Floats]:
        """Sum of a_T E_T / χ(d_T), its gradient at the free vertices, and the d_T."""
        x, energy, d, e = self.measure(z)
        root = np.sqrt(epsilon**2 + d * d)
        chi = np.maximum(np.where(d > 0, 0.5 * (d + root), 0.5 * epsilon**2 / np.maximum(root - d, 1e-300)), 1e-150)
        value = float((self.shares * energy / chi).sum())
        by_energy = (0.5 * self.shares / chi)[:, None]
        by_determinant = (-self.shares * energy / chi / root)[:, None]
        w = [by_energy * self.cotangents[:, k, None] * e[k] for k in range(3)]
        p = self.centre + self.scale * x[self.faces[:, 0]]
        gradient = np.zeros_like(x)
        by_q, by_r = 0.5 * _cross(-e[1], p), 0.5 * _cross(p, e[2])
        area = [0.5 * self.scale * _cross(e[2], -e[1]) - by_q - by_r, by_q, by_r]
        for k in range(3):
            here = w[(k + 1) % 3] - w[(k + 2) % 3] + by_determinant * area[k]
            for axis in range(3):
                gradient[:, axis] += np.bincount(self.faces[:, k], here[:, axis], len(x))
        return value, self.pulled(z, x, gradient)[self.free], d

    def preconditioner(self, weights: Floats) -> Callable[[Floats], Floats]:
        """Solves with the stiffness of the patch, each triangle weighted, the rim fixed."""
        index = np.full(len(self.vertices), -1)
        index[self.free] = np.arange(len(self.free))
        weights = weights / weights.max()
        matrix = np.zeros((len(self.free), len(self.free))) if len(self.free) <= 400 else None
        rows, columns, entries = [], [], []
        for k in range(3):
            a, b = index[self.faces[:, (k + 1) % 3]], index[self.faces[:, (k + 2) % 3]]
            value = 0.5 * weights * self.cotangents[:, k]
            for i, j, sign in ((a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)):
                inside = (i >= 0) & (j >= 0)
                rows.append(i[inside])
                columns.append(j[inside])
                entries.append(sign * value[inside])
        i, j, w = (np.concatenate(part) for part in (rows, columns, entries))
        if matrix is not None:
            np.add.at(matrix, (i, j), w)
            matrix += 1e-12 * np.diag(np.abs(np.diag(matrix)) + 1e-300)
            try:
                factor = scipy.linalg.cho_factor(matrix)
                return lambda b: np.asarray(scipy.linalg.cho_solve(factor, b), np.float64)
            except np.linalg.LinAlgError:
                diagonal = np.maximum(np.diag(matrix), 1e-300)
                return lambda b: b / diagonal[:, None]
        whole = scipy.sparse.csr_array((w, (i, j)), (len(self.free),) * 2)
        whole = scipy.sparse.csr_array(0.5 * (whole + whole.T))
        diagonal = np.maximum(whole.diagonal(), 1e-300)
        try:
            return Cholesky(plus_diagonal(whole, 1e-12 * diagonal)).solve
        except NumericalError:
            return lambda b: b / diagonal[:, None]

    def tutte(self) -> None:
        """Each free vertex in the mean of its neighbours: no triangle is turned over where the rim is convex."""
        index = np.full(len(self.vertices), -1)
        index[self.free] = np.arange(len(self.free))
        a, b = self.faces.ravel(), self.faces[:, [1, 2, 0]].ravel()
        a, b = np.concatenate([a, b]), np.concatenate([b, a])
        graph = scipy.sparse.csr_array((np.ones(len(a)), (a, b)), (len(self.vertices),) * 2)[self.free]
        inner = scipy.sparse.csr_array(scipy.sparse.diags_array(graph.sum(axis=1)) - graph[:, self.free])
        outer = self.z.copy()
        outer[self.free] = 0.0
        self.z[self.free] = Cholesky(inner).solve(graph @ outer)

    def _minimize(self, epsilon: Floats, steps: int, guard: bool) -> bool:
        """L-BFGS on the free vertices; with ``guard`` no step may turn a triangle over. Says whether anything moved."""
        value, g, d = self.objective(self.z, epsilon)
        solve = self.preconditioner(self.shares / np.sqrt(epsilon**2 + d * d))
        history: list[tuple[Floats, Floats, float]] = []
        moved = False
        for _ in range(steps):
            q, shares = g.copy(), []
            for dz, dg, rho in reversed(history):
                alpha = rho * float((dz * q).sum())
                shares.append(alpha)
                q -= alpha * dg
            direction = solve(q)
            if history:
                dz, dg, _rho = history[-1]
                direction *= float((dz * dg).sum()) / max(float((dg * solve(dg)).sum()), 1e-300)
            for (dz, dg, rho), alpha in zip(history, reversed(shares), strict=True):
                direction += (alpha - rho * float((dg * direction).sum())) * dz
            slope = -float((g * direction).sum())
            if not slope < 0:
                if not history:
                    break
                history = []
                continue
            length = min(1.0, 0.5 / max(float(np.abs(direction).max()), 1e-300))
            for _ in range(30):
                z = self.z.copy()
                z[self.free] -= length * direction
                new, new_g, new_d = self.objective(z, epsilon)
                if np.isfinite(new) and new <= value + 1e-4 * length * slope and not (guard and (new_d <= 0).any()):
                    break
                length *= 0.5
            else:
                break
            dz, dg = (z - self.z)[self.free], new_g - g
            curvature = float((dz * dg).sum())
            if curvature > 1e-14 * np.linalg.norm(dz) * np.linalg.norm(dg):
                history = [*history[-9:], (dz, dg, 1 / curvature)]
            small = value - new < 1e-7 * abs(value)
            self.z, value, g, moved = z, new, new_g, True
            if small:
                break
        return moved

    def untangle(self) -> bool:
        with np.errstate(all="ignore"):  # what overflows is refused by the line search
            return self._untangle()

    def _untangle(self) -> bool:
        """Minimizes Σ a_T E_T / χ with ε that falls as the flips vanish (Garanzha et al. 2021), then with hardly any ε."""
        fewest, stalled = (int((self.measure(self.z)[2] <= 0).sum()), self.z), 0
        for _sweep in range(15):
            if fewest[0] == 0 or stalled == 4:
                break
            sizes = self.sizes(self.z)
            for floor, share in ((1e-4, 0.25), (1e-6, 0.04)):
                least = float((self.measure(self.z)[2] / sizes).min())
                self._minimize(np.sqrt(floor + share * min(least, 0.0) ** 2) * sizes, 60, guard=False)
            flips = int((self.measure(self.z)[2] <= 0).sum())
            stalled = 0 if flips < fewest[0] else stalled + 1
            if flips < fewest[0]:
                fewest = flips, self.z
        self.z = fewest[1]
        if (self.measure(self.z)[2] <= 0).any():
            return False
        for share in (1e-2, 1e-4, 1e-9):
            self._minimize(share * self.sizes(self.z), 60, guard=True)
        # Weighted by the areas of the image, Σ a_T (E_T / d_T - 1) is E - A: nothing else that the patch costs is left.
        d = self.measure(self.z)[2]
        self.shares = np.maximum(d, 1e-3 * d.mean())
        self.shares /= self.shares.sum()
        self._minimize(1e-9 * self.sizes(self.z), 120, guard=True)
        return True

    def place(self, s: Floats) -> None:
        """Writes the free vertices into sphere positions."""
        s[self.vertices[self.free]] = _unit(self.centre + self.scale * self.lifted(self.z)[self.free])


def _repair(surface: _Surface, s: Floats, rounds: int, report: Callable[[float], object]) -> Floats:
    """Frees the surroundings of flipped triangles, patch by patch, and untangles each; kept only where flips become fewer."""
    faces, n = surface.faces, surface.count
    a, b = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    neighbours = scipy.sparse.csr_array((np.ones(len(a), np.int8), (a, b)), (n, n))
    for attempt in range(rounds):
        wrong = surface.flipped(s)
        if not wrong.any():
            break
        seeds = np.zeros(n, bool)
        seeds[faces[wrong].ravel()] = True
        for patch_free in _patches(neighbours, s, seeds, attempt):
            inside = np.zeros(n, bool)
            inside[patch_free] = True
            touched = np.flatnonzero(inside[faces].any(1))
            before = int(surface.flipped(s)[touched].sum())
            if before == 0 or len(touched) > 0.5 * len(faces):
                continue
            patch = _Patch(surface, s, patch_free, touched)
            if attempt >= 2:
                patch.tutte()
            patch.untangle()
            trial = s.copy()
            patch.place(trial)
            if int((_determinants(trial, faces[touched]) <= 0).sum()) < before:
                s = trial
            report((attempt + 0.5) / rounds)
    return s


def _patches(neighbours: scipy.sparse.csr_array, s: Floats, seeds: npt.NDArray[np.bool_], attempt: int) -> list[Faces]:
    """Sets of vertices to free: rings around the flips at first, round caps later."""
    from scipy.sparse.csgraph import connected_components

    def grown(mask: npt.NDArray[np.bool_], rings: int) -> npt.NDArray[np.bool_]:
        for _ in range(rings):
            mask = mask | (neighbours @ mask.astype(np.int8) > 0)
        return mask

    def clusters(mask: npt.NDArray[np.bool_]) -> list[Faces]:
        index = np.flatnonzero(mask)
        labels = connected_components(neighbours[index][:, index], directed=False)[1]
        return [index[labels == label] for label in range(labels.max(initial=-1) + 1)]

    if attempt < 2:
        return clusters(grown(seeds, 1 + 2 * attempt))
    found = []
    for cluster in clusters(grown(seeds, 1)):
        middle = s[cluster].mean(0)
        middle /= max(float(np.linalg.norm(middle)), 1e-300)
        radius = float(np.sqrt(((s[cluster] - middle) ** 2).sum(1).max()))
        reach = min(3.0 * 2.0 ** (attempt - 2) * radius, 1.0)
        cap = np.sqrt(((s - middle) ** 2).sum(1)) <= reach
        # Only the piece that holds the cluster, and what it encloses, so that the patch is a disc.
        pieces = [piece for piece in clusters(cap) if np.isin(cluster, piece).any()]
        if pieces:
            found.append(np.unique(np.concatenate([*pieces, cluster])))
    return found


# --- the door -----------------------------------------------------------------------------------------------------------------------


def _sphere_mesh(mesh: TriangleMesh) -> Faces:
    """The faces of a closed, connected, orientable mesh of genus 0, oriented consistently; or an error that says what it is instead."""
    n, euler = len(mesh.vertices), mesh.euler_characteristic
    facts = f"it has Euler characteristic {euler}"
    used = np.zeros(n, bool)
    used[mesh.faces.ravel()] = True
    if len(mesh.faces) == 0:
        raise TopologyError("the mesh has no triangles; a closed surface of genus 0 is needed")
    if not mesh.is_manifold:
        raise TopologyError(f"the mesh is not manifold: {mesh._topology.non_manifold}; {facts}, a sphere has 2. Repair it first")
    if mesh.components > 1:
        raise TopologyError(f"the mesh has {mesh.components} components; {facts}, a sphere has 2. Take mesh.largest_component()")
    if not mesh.is_closed:
        loops = mesh.boundary_loops
        holes = "hole" if loops == 1 else "holes"
        raise TopologyError(
            f"the mesh is not closed: {loops} {holes}; {facts}, a sphere has 2. spherical_map(mesh, "
            "fill_holes=True) closes them for the map"
        )
    if euler != 2 or not mesh.is_orientable:
        what = f"genus {mesh.genus}" if mesh.is_orientable else "only one side"
        raise TopologyError(f"the mesh has {what}; {facts}, a sphere has 2. Only surfaces of genus 0 map to the sphere one to one")
    if not used.all():
        raise InputError(f"vertex {int(np.flatnonzero(~used)[0])} belongs to no triangle; remove it (mesh.largest_component() does)")
    oriented = mesh if mesh.is_oriented else mesh.oriented()
    return oriented.faces.astype(np.int64)


def _scaled(vertices: Floats) -> tuple[Floats, float]:
    """Vertices about the origin and of size 1, so that products of lengths stay in range; and the size they had."""
    middle = 0.5 * (vertices.max(0) + vertices.min(0))
    moved = vertices - middle
    size = float(np.abs(moved).max())
    if not size > 0 or not np.isfinite(size):
        raise InputError(f"the vertices span {size:g}; a surface is needed")
    if not 1e-150 < size < 1e150:
        raise InputError(f"the vertices span {size:g}, so that areas leave the range of double precision; use other units")
    return moved / size, size


def _solver(stiffness: scipy.sparse.csr_array, coordinates: Floats, progress: Progress) -> Callable[[Floats], Floats]:
    """Solves with the stiffness, one vertex pinned by a spring; exact for right-hand sides that add up to zero."""
    spring = np.zeros(stiffness.shape[0])
    spring[0] = stiffness.diagonal()[0]
    return Cholesky(plus_diagonal(stiffness, spring), coordinates, progress=progress).solve


Method = Literal["fast", "cayley", "preconditioned_cayley"]


def spherical_map(
    shape: Shape | Operators,
    *,
    method: Method = "fast",
    tolerance: float = 1e-4,
    max_iterations: int | None = None,
    fill_holes: bool = False,
    check_genus: bool = True,
    progress: Progress = None,
) -> SphericalMapResult:
    """Maps a closed surface of genus 0 conformally to the unit sphere.

    Minimizes E - A, Dirichlet energy less signed image area, among the maps whose area-weighted centre is the origin: a linear map
    to start from, an iteration, and a repair of the triangles that are still turned over.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        Closed, connected, manifold, of genus 0. The orientation is kept: seen from outside, the image is not mirrored. Of Operators
        the shape is taken.
    method : {"fast", "cayley", "preconditioned_cayley"}
        ``"fast"``: descent preconditioned by one Cholesky factorization, with Anderson acceleration: a handful of steps.
        ``"cayley"``: the iteration of equation 8.28, Cayley steps of Barzilai-Borwein length along the gradient by unit mass, with a
        nonmonotone line search; hundreds of steps. ``"preconditioned_cayley"``: the same along L^-1 of the gradient.
    tolerance : float
        Root mean square move of a step (``"cayley"``: of the gradient, on a sphere of area 4π), in radii, at which to stop.
    max_iterations : int, optional
        20; 5000 and 200 for the Cayley iterations.
    fill_holes : bool
        Close the holes of a mesh with rings of triangles for the map only; the result is that of the mesh itself.
    check_genus : bool
        Refuse a cloud that the map shows to be open, or of higher genus; see Notes. Meshes of higher genus are always refused.
    progress : callable or True, optional

    Returns
    -------
    SphericalMapResult

    Raises
    ------
    TopologyError
        The surface is not closed, connected, manifold or of genus 0; the message gives its Euler characteristic and what to do.
    NumericalError
        Parts of the image round away: the message says which.

    Notes
    -----
    A cloud has no Euler characteristic that could be relied on, so its genus is checked by what comes out: where the map is one to one,
    neighbours on the sphere are neighbours in the cloud. If more than one point in a hundred has images from elsewhere between its own
    neighbours', or the images do not cover the sphere, the loops of the Reeb graph of the first eigenfunction are counted
    (:func:`beltrami.skeleton`): a cloud is refused where both say that it has handles, or one of them by far. Clouds that leave a part
    of the sphere bare, or whose boundary points hang together in a ring, are refused as open.

    References
    ----------
    Lai, Wen, Yin, Gu and Lui, Folding-free global conformal mapping for genus-0 surfaces by harmonic energy minimization, 2014.
    Wen and Yin, A feasible method for optimization with orthogonality constraints, 2013.
    Baden, Crane and Kazhdan, Möbius registration, 2018.

    Examples
    --------
    >>> import beltrami as bt
    >>> r = bt.spherical_map(bt.shapes.ellipsoid(1.0, 0.7, 0.5, level=3))
    >>> r.flipped, r.excess < 0.02
    (0, True)
    """
    arrays.word(method, "method", get_args(Method))
    tolerance = arrays.number(tolerance, "tolerance", above=0)
    steps = _STEPS[method] if max_iterations is None else arrays.whole(max_iterations, "max_iterations", 1)
    task = _Task(method, tolerance, steps, teller(reporter(progress, "spherical map")))
    given = shape.shape if isinstance(shape, Operators) else shape
    if isinstance(given, TriangleMesh):
        return _map_mesh(given, bool(fill_holes), task)
    if isinstance(given, PointCloud):
        if fill_holes:
            raise InputError("fill_holes=True is for meshes; a cloud has no holes to fill")
        return _map_cloud(given, shape if isinstance(shape, Operators) else None, bool(check_genus), task)
    raise no_shape(shape)


_STEPS = {"fast": 20, "cayley": 5000, "preconditioned_cayley": 200}


@dataclass(frozen=True)
class _Task:
    method: str
    tolerance: float
    steps: int
    report: Callable[[float], None]

    def iterate(self, surface: _Surface, stiffness: scipy.sparse.csr_array, *, energy_only: bool = False) -> tuple[Floats, _Trace]:
        """Factors, makes the start, iterates."""

        def gradient(s: Floats) -> tuple[Floats, Floats, float]:
            g, areas, excess = surface.gradient(s)
            return (stiffness @ s if energy_only else g), areas, excess

        def later(share: float) -> None:
            self.report(0.4 + 0.5 * share)

        solve = _solver(stiffness, surface.vertices, lambda share: self.report(0.4 * share))
        s = _centred(_start(surface, solve), surface.mass)
        if self.method == "fast" or energy_only:
            return _descend(surface, solve, gradient, s, self.tolerance, self.steps, later)
        return _cayley(surface, None if self.method == "cayley" else solve, stiffness, s, self.tolerance, self.steps, later)

    def onward(self, surface: _Surface, stiffness: scipy.sparse.csr_array, s: Floats) -> tuple[Floats, _Trace]:
        """Factors and iterates from a map that is there."""
        solve = _solver(stiffness, surface.vertices, lambda share: self.report(0.9))
        s = _centred(s, surface.mass)
        if self.method == "fast":
            return _descend(surface, solve, surface.gradient, s, self.tolerance, self.steps, lambda share: self.report(0.9))
        metric = None if self.method == "cayley" else solve
        return _cayley(surface, metric, stiffness, s, self.tolerance, self.steps, lambda share: self.report(0.9))


def _filled(mesh: TriangleMesh) -> tuple[Floats, Faces]:
    """The mesh with a cap on each boundary loop: rings that shrink to the loop's centre, and a fan. The mesh's own come first."""
    vertices, faces = [mesh.vertices], [mesh.faces.astype(np.int64)]
    count = len(mesh.vertices)
    heads = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]).astype(np.int64)
    directed = set((heads[:, 0] * count + heads[:, 1]).tolist())
    for loop in mesh.boundary_loop_vertices:
        ring = np.asarray(loop, np.int64)
        if int(ring[0]) * count + int(ring[1]) in directed:
            ring = ring[::-1]  # the cap runs against the triangles beside it
        corners = mesh.vertices[ring]
        centre, k = corners.mean(0), len(ring)
        ratio = 1 - 2 * np.pi / max(k, 12)  # triangles about as high as wide
        share, next_index = 1.0, count + sum(len(v) for v in vertices[1:])
        while k > 12 and share * ratio > 12 / k and share > 0.02:
            share *= ratio
            inner = np.arange(next_index, next_index + k)
            vertices.append(centre + share * (corners - centre))
            a, b, c, d = ring, np.roll(ring, -1), inner, np.roll(inner, -1)
            faces += [np.stack([a, b, d], 1), np.stack([a, d, c], 1)]
            ring, next_index = inner, next_index + k
        vertices.append(centre[None])
        faces.append(np.stack([ring, np.roll(ring, -1), np.full(k, next_index)], 1))
    return np.concatenate(vertices), np.concatenate(faces)


def _map_mesh(mesh: TriangleMesh, fill: bool, task: _Task) -> SphericalMapResult:
    notes: list[str] = []
    source = mesh if mesh.is_oriented or not mesh.is_orientable or not mesh.is_manifold else mesh.oriented()
    whole = source
    if fill and mesh.is_manifold and mesh.boundary_loops:
        points, triangles = _filled(source)
        whole = TriangleMesh(points, triangles.astype(np.int32))
        notes.append(f"{mesh.boundary_loops} hole{'s were' if mesh.boundary_loops > 1 else ' was'} filled for the map")
    faces = _sphere_mesh(whole)
    vertices, size = _scaled(whole.vertices)
    if vertices.shape[1] == 3:
        p = vertices[faces[:, 0]]
        volume = float(np.einsum("ij,ij->", p, _cross(vertices[faces[:, 1]], vertices[faces[:, 2]])))
        if volume < 0:
            faces = np.ascontiguousarray(faces[:, [0, 2, 1]])
    surface = _Surface(vertices, faces)
    work = TriangleMesh(vertices, faces.astype(np.int32))
    found: list[tuple[Floats, _Trace]] = []
    regular = False
    try:
        found.append(task.iterate(surface, operators(work, laplacian="cotangent").stiffness))
    except (InputError, NumericalError) as error:
        notes.append(f"cotangents cannot be used ({error}); intrinsic Delaunay weights instead")
        surface.regularize()
        regular = True
    if not found or surface.flipped(found[0][0]).sum() > 0.01 * len(faces):
        found.append(task.iterate(surface, operators(work, laplacian="intrinsic_delaunay").stiffness, energy_only=True))
        if len(found) == 2:
            notes.append("more than 1 % of the triangles were flipped, so the map was made again with intrinsic Delaunay weights")
    s, trace = min(found, key=lambda one: int(surface.flipped(one[0]).sum()))
    before = int(surface.flipped(s).sum())
    if before:
        energy, area = surface.energy_and_area(s)
        s = _centred(_repair(surface, s, 8, lambda share: task.report(0.9 + 0.1 * share)), surface.mass)
        excess, after = energy - area, float(np.subtract(*surface.energy_and_area(s)))
        heavy = ", at the price of larger changes of angle there" if after > 1.2 * excess + 1e-3 else ""
        gone = before - int(surface.flipped(s).sum())
        notes.append(f"{gone} of {before} flipped triangles were repaired: E - A {excess:.4g} before, {after:.4g} after{heavy}")
    if whole is not source:
        own = surface.faces[: len(mesh.faces)]
        surface = _Surface(vertices[: len(mesh.vertices)], own)
        if not surface.mass.sum() > 0:
            raise InputError("no triangle of the surface has an area: only the holes that were filled have; give another shape")
        if regular:
            surface.regularize()
        s = _centred(s[: len(mesh.vertices)], surface.mass)
    task.report(1.0)
    return _certified(mesh, surface, s, size, trace, tuple(notes))


def _map_cloud(cloud: PointCloud, given: Operators | None, check: bool, task: _Task) -> SphericalMapResult:
    from ..clouds import CloudOperators

    if cloud.dimension != 2:
        raise InputError(f"the cloud has dimension {cloud.dimension}; a surface (dimension 2) is needed")
    ops = given if isinstance(given, CloudOperators) else operators(cloud)
    if not isinstance(ops, CloudOperators):
        raise InputError("these operators have no simplices; bt.operators(cloud) makes them")
    components = int(ops.component_labels.max()) + 1
    faces = ops.simplices.astype(np.int64)
    facts = f"the triangles that all their corners' stars hold have Euler characteristic {_euler(faces[ops.votes == 3])}, a sphere has 2"
    if components > 1:
        raise TopologyError(f"the cloud falls into {components} components; {facts}. Map each alone")
    vertices, size = _scaled(cloud.points)
    surface = _Surface(vertices, faces, ops.votes / 3.0)
    s, trace = task.iterate(surface, ops.stiffness)
    notes = ops.notes
    if check:
        covered = float(np.abs(_solid_angles(s, faces)) @ ops.votes) / (12 * np.pi)
        agreed = float((ops.votes == 3).mean())
        findings = genus.Findings(covered, genus.mixed_share(s, faces), genus.bare_share(s), genus.largest_ring(ops), agreed)
        notes += findings.checked(ops, facts)
    surface, s, trace = _with_stars_of_the_image(ops, surface, s, trace, task)
    # Each simplex is oriented as its image is; the volume within tells inside from outside.
    faces, votes = surface.faces, np.rint(3 * surface.weights) if surface.weights is not None else np.zeros(0)
    turned = np.where(_determinants(s, faces) < 0, -1.0, 1.0)
    if vertices.shape[1] == 3:
        p, q, r = (vertices[faces[:, k]] for k in range(3))
        if float((turned * votes * _rows(p, _cross(q, r))).sum()) < 0:
            s = _centred(s * [1.0, 1.0, -1.0], surface.mass)
            turned = -turned
    wrong = _folded(ops, faces, votes, turned)
    task.report(1.0)
    return _certified(cloud, surface, s, size, trace, notes, wrong)


_Star = tuple[Faces, npt.NDArray[np.bool_]]


def _with_stars_of_the_image(
    ops: CloudOperators, surface: _Surface, s: Floats, trace: _Trace, task: _Task
) -> tuple[_Surface, Floats, _Trace]:
    """The map of a cloud again, with the Delaunay stars of the images in place of those of the points.

    Where sheets are nearer to each other than the points, stars in space join them; their images lie far apart. A conformal map keeps
    Delaunay triangles, so the stars of the images are those of the surface, if the map is nearly right there. Points whose star of
    images reaches far in the cloud keep their own star. A pass is kept if it lowers the mean change of angle in the images' triangles.
    """
    n, points = surface.count, surface.vertices
    own: _Star = surface.faces, ops._held
    mass = surface.mass
    spacing = ops.point_spacing * float(np.sqrt(mass.sum() / ops.mass.sum()))
    stars, error, grown = _image_stars(s, points, mass)
    for _ in range(PASSES):
        if stars is None:
            break
        faces, held = stars
        far = ~(_circumradii(points, faces) <= 20 * np.median(spacing[faces], axis=1))
        if grown > 1.05:  # the images of several sheets are mixed: triangles between them
            near = genus.within_edges(own[0], n, 3, np.arange(n), faces, faces[:, [1, 2, 0]])
            far |= ~near.all(1)
        unfit = np.bincount(faces[held & far[:, None]], minlength=n) > 0
        unfit |= np.bincount(faces[held], minlength=n) == 0
        both = np.concatenate([faces, own[0]])
        counts = np.concatenate([(held & ~unfit[faces]).sum(1), (own[1] & unfit[own[0]]).sum(1)])
        both, place = np.unique(both, axis=0, return_inverse=True)
        votes = np.bincount(place.ravel(), counts).astype(np.uint8)
        both, votes = both[votes > 0], votes[votes > 0]
        trial = _Surface(points, both, votes / 3.0)
        trial.mass = mass
        stiffness = arrays.csr_out(_core.local_stiffness((points, both.astype(np.int32), votes, None)), (n, n))
        if scipy.sparse.csgraph.connected_components(stiffness, directed=False)[0] > 1:
            break
        moved, steps = task.onward(trial, stiffness, s)
        found = _image_stars(moved, points, mass)
        if not found[1] < error:
            break
        done = found[1] > 0.98 * error
        stars, error, grown = found
        surface, s = trial, moved
        trace = _Trace(trace.move + steps.move, trace.excess + steps.excess, steps.converged)
        if done:
            break
    return surface, s, trace


PASSES = 4


def _image_stars(s: Floats, points: Floats, mass: Floats) -> tuple[_Star | None, float, float]:
    """Simplices of the images' local mesh and which corners' stars hold them; mean change of angle, and their area over the cloud's."""
    try:
        ops = cast("CloudOperators", operators(PointCloud(s, dimension=2)))
        faces, held = ops.simplices.astype(np.int64), ops._held
    except InputError:  # images that round to one place
        return None, np.inf, np.inf
    weights = ops.votes / 3.0
    change = np.abs(_corner_angles(s, faces) - _corner_angles(points, faces)).mean(1)
    area = float(_corner_cotangents(points, faces)[1] @ weights)
    return (faces, held), float(change @ weights / weights.sum()), area / float(mass.sum())


def _circumradii(vertices: Floats, faces: Faces) -> Floats:
    p, q, r = (vertices[faces[:, k]] for k in range(3))
    product = _length(q - r) * _length(r - p) * _length(p - q)
    with np.errstate(divide="ignore", invalid="ignore"):
        found: Floats = product / (4 * _corner_cotangents(vertices, faces)[1])
    return found


def _euler(faces: Faces) -> int:
    """Vertices less edges plus triangles."""
    if len(faces) == 0:
        return 0
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    keys = pairs[:, 0] * (int(faces.max()) + 1) + pairs[:, 1]
    return len(np.unique(faces)) - len(np.unique(keys)) + len(faces)


def _solid_angles(s: Floats, faces: Faces) -> Floats:
    p, q, r = (s[faces[:, k]] for k in range(3))
    found: Floats = 2 * np.arctan2(_determinants(s, faces), 1 + _rows(p, q) + _rows(q, r) + _rows(r, p))
    return found


def _folded(ops: Any, faces: Faces, counts: Floats, turned: Floats) -> npt.NDArray[np.bool_]:
    """Simplices, of those that all three stars hold, whose image is turned against most of its neighbours' around each corner."""
    frames, points = ops.frames, ops.shape.points
    against = np.zeros((len(faces), 3))
    for k in range(3):
        corner = faces[:, k]
        e = [points[faces[:, (k + j) % 3]] - points[corner] for j in (1, 2)]
        a, b = (np.einsum("tdj,tj->td", frames[corner], one) for one in e)
        against[:, k] = np.sign(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * turned
    sense = np.sign(np.bincount(faces.ravel(), against.ravel(), len(points)))
    votes = (against * sense[faces] < 0).sum(1)
    found: npt.NDArray[np.bool_] = (counts == 3) & (votes >= 2)
    return found


def _certified(
    shape: Shape,
    surface: _Surface,
    s: Floats,
    size: float,
    trace: _Trace,
    notes: tuple[str, ...],
    folded: npt.NDArray[np.bool_] | None = None,
) -> SphericalMapResult:
    """The result with what is measured on it; an error where what is flipped has rounded away."""
    faces = surface.faces
    wrong = np.flatnonzero(surface.flipped(s) if folded is None else folded)
    if len(wrong) and folded is None:
        corners = s[faces[wrong]]
        extent = np.sqrt(((corners - corners[:, [1, 2, 0]]) ** 2).sum(2)).max(1)
        if (extent < 1e-13).any():
            lost = wrong[extent < 1e-13]
            where = surface.vertices[faces[lost].ravel()].mean(0)
            raise NumericalError(
                f"the images of {len(lost)} triangles round away (they are below 1e-13 of the sphere), around triangle {lost[0]} "
                f"(its first vertex is {faces[lost[0], 0]}; from the middle of the bounding box, over half its size: "
                f"{', '.join(f'{x:.3g}' for x in where)}): a limb there is too long and thin for double precision; cut it off, "
                "or thicken it"
            )
    if len(wrong):
        who = f"{len(wrong)} triangles are {STILL_FLIPPED}, the first is" if len(wrong) > 1 else f"1 triangle is {STILL_FLIPPED}:"
        notes += (f"{who} {wrong[0]}",)
    weights = np.ones(len(faces)) if surface.weights is None else surface.weights
    _, image = _corner_cotangents(s, faces)
    lumped = _lumped(image * weights, faces, surface.count)
    energy, area = surface.energy_and_area(s)
    p, q, r = (s[faces[:, k]] for k in range(3))
    e = (r - q, p - r, q - p)
    each = 0.25 * sum(surface.cotangents[:, k] * _rows(e[k], e[k]) for k in range(3)) / weights
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.maximum(each / image, 1.0)
        dilatation = np.where(ratio < np.inf, ratio + np.sqrt(ratio * ratio - 1), np.inf)
    return SphericalMapResult(
        shape,
        s,
        lumped / surface.mass / size / size,
        energy,
        area,
        len(wrong),
        np.abs(_corner_angles(s, faces) - _corner_angles(surface.vertices, faces)).mean(1),
        dilatation,
        len(trace.move),
        trace.converged and (not len(wrong) or folded is not None),
        {"move": np.array(trace.move), "excess": np.array(trace.excess)},
        notes,
        np.ascontiguousarray(faces, np.int32),
        weights,
    )
