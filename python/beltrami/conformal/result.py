"""The result of a map to the sphere, and what is measured on it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..arrays import Floats, Ints
from ..errors import InputError, NumericalError
from ..operators import operators
from ..results import save_result
from ..shapes import PointCloud, Shape, TriangleMesh
from ..view import Page, Picture, plot
from . import spherical
from .iterations import Trace
from .moebius import Moebius
from .surface import Surface, corner_angles, corner_cotangents, lumped, row_products, scaled, unit_rows

STILL_FLIPPED = "still flipped"  # in the note that says how many are


def _needed(value: Any, name: str, kind: type) -> None:
    if not isinstance(value, kind):
        raise InputError(f"{name} is a {type(value).__name__}; a {kind.__name__} is needed")


@dataclass(frozen=True, eq=False, repr=False)
class SphericalMapResult:
    """A map of a shape to the unit sphere, with its certificate.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
        The shape that was mapped.
    positions : ndarray (n, 3)
        Images of the vertices, unit vectors; their mean, weighted by the areas of the source, is zero.
    conformal_factor : ndarray (n,)
        Lumped area of the image over that of the source, in 1 / length².
    energy, area : float
        Dirichlet energy E by the mesh's own cotangents, and signed area A of the image polyhedron.
    flipped : int
        Number of triangles whose image is flipped.
    angle_error : ndarray (m,)
        Mean change of a triangle's three angles, in radians.
    dilatation : ndarray (m,)
        Ratio of the greater to the smaller stretch of each triangle: 1 where it is conformal, infinite where the triangle or its
        image has no area.
    iterations : int
        Number of iterations.
    converged : bool
        Whether the tolerance was reached.
    history : dict of str to ndarray
        ``move`` (root mean square move of each step) and ``excess`` (E - A before each step).
    notes : tuple of str
        Remarks on how the map was found.
    faces : ndarray (m, 3) of int32
        The triangles of the map: those of the mesh, oriented outwards; for clouds the simplices of the stars.
    weights : ndarray (m,)
        Weight of each triangle: 1, or for clouds the share of its corners whose star contains it.
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
        return lumped(corner_cotangents(self.positions, self.faces.astype(np.int64))[1], self.faces.astype(np.int64), len(self.positions))

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
            Size of the image.

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
        return replace(self, positions=unit_rows(self.positions @ matrix.T))

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
        vertices, size = scaled(self.shape.coordinates)
        surface = Surface(vertices, faces, weights)
        if weights is not None:
            surface.mass = operators(self.shape).mass / size**2
        trace = Trace(list(self.history["move"]), list(self.history["excess"]), self.converged)
        folded = None if weights is None else np.zeros(len(faces), bool)
        notes = self.notes if folded is not None else tuple(note for note in self.notes if STILL_FLIPPED not in note)  # told anew
        made = certified(self.shape, surface, moebius(self.positions), size, trace, notes, folded)
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
        """Writes everything but the shape to ``.npz`` (the histories as ``history_move`` and ``history_excess``), the shape with positions
        on the sphere and factor to ``.ply``, a picture to ``.png`` or ``.html``.

        Raises
        ------
        InputError
            The suffix is none of these.
        FileError
            The file cannot be written.
        """
        return save_result(self, path, "a map to the sphere is", values=("positions", "conformal_factor"))

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
            What is drawn: the shape, or its image on the sphere.
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


def certified(
    shape: Shape,
    surface: Surface,
    s: Floats,
    size: float,
    trace: Trace,
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
    _, image = corner_cotangents(s, faces)
    areas = lumped(image * weights, faces, surface.count)
    energy, area = surface.energy_and_area(s)
    p, q, r = (s[faces[:, k]] for k in range(3))
    e = (r - q, p - r, q - p)
    each = 0.25 * sum(surface.cotangents[:, k] * row_products(e[k], e[k]) for k in range(3)) / weights
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.maximum(each / image, 1.0)
        dilatation = np.where(ratio < np.inf, ratio + np.sqrt(ratio * ratio - 1), np.inf)
    return SphericalMapResult(
        shape,
        s,
        areas / surface.mass / size / size,
        energy,
        area,
        len(wrong),
        np.abs(corner_angles(s, faces) - corner_angles(surface.vertices, faces)).mean(1),
        dilatation,
        len(trace.move),
        trace.converged and (not len(wrong) or folded is not None),
        {"move": np.array(trace.move), "excess": np.array(trace.excess)},
        notes,
        np.ascontiguousarray(faces, np.int32),
        weights,
    )
