"""The scene: the shape in space, the cameras, lines and marks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from .. import arrays
from ..errors import InputError
from . import colors

Axis = Literal["x", "y", "z"]
View = str | Sequence[float]
# Azimuth (from the front to the right) and elevation of the eye, in degrees.
VIEWS: dict[str, tuple[float, float]] = {
    "front": (0, 0),
    "back": (180, 0),
    "right": (90, 0),
    "left": (-90, 0),
    "top": (0, 90),
    "bottom": (0, -90),
    "three-quarter": (-35, 22),
    "three-quarter right": (35, 22),
    "three-quarter back": (145, 22),
}


@dataclass(frozen=True)
class Geometry:
    vertices: arrays.Floats  # (n, 3)
    faces: arrays.Ints
    normals: arrays.Floats
    flat: bool
    note: str
    centre: arrays.Floats  # of the D coordinates
    axes: arrays.Floats  # (D, 3): what turns positions into space

    @property
    def count(self) -> int:
        return len(self.vertices)

    def place(self, points: Any, name: str) -> arrays.Floats:
        array = arrays.points(points, name)
        if array.shape[1] != len(self.axes):
            raise InputError(f"{name} have {array.shape[1]} coordinates, the shape has {len(self.axes)}")
        array = arrays.floats(array, name, (None, None))
        return np.ascontiguousarray((array - self.centre) @ self.axes)


def geometry_of(shape: Any) -> Geometry:
    normals = None
    faces: Any = np.zeros((0, 3), np.int32)
    if hasattr(shape, "stiffness") and hasattr(shape, "shape"):  # operators know their shape
        shape = shape.shape
    if hasattr(shape, "vertices") and hasattr(shape, "faces"):
        vertices, faces = shape.vertices, shape.faces
    elif hasattr(shape, "points"):
        vertices, normals = shape.points, getattr(shape, "normals", None)
    elif isinstance(shape, tuple) and len(shape) == 2:
        vertices, faces = shape
    elif isinstance(shape, np.ndarray):
        vertices = shape
    else:
        raise InputError(f"a {type(shape).__name__} cannot be plotted; give a TriangleMesh, a PointCloud, or an array of points")
    points = arrays.points(vertices, "vertices", 2)
    points = arrays.floats(points, "vertices", (None, None))
    faces = arrays.triangles(faces, "faces", len(points))
    if len(points) == 0:
        raise InputError("the shape has no vertices; there is nothing to draw")
    dimension = points.shape[1]
    note = ""
    centre = np.zeros(dimension)
    if dimension <= 3:
        axes = np.eye(dimension, 3)
    else:
        centre = points.mean(axis=0)
        _, strengths, directions = np.linalg.svd(points - centre, full_matrices=False)
        directions = np.vstack([directions, np.zeros((3, dimension))])[:3]
        turned = np.sign(directions[np.arange(3), np.abs(directions).argmax(axis=1)])
        axes = (directions * np.where(turned == 0, 1, turned)[:, None]).T
        share = float((strengths[:3] ** 2).sum() / max((strengths**2).sum(), 1e-300))
        note = f"R^{dimension} seen along its three principal axes ({100 * share:.0f} % of the variance)"
    given = np.zeros((0, 3))
    if normals is not None and dimension == 3:
        given = arrays.floats(normals, "normals", (len(points), 3))
    return Geometry(np.ascontiguousarray((points - centre) @ axes), faces, given, dimension == 2, note, centre, axes)


def named_views(views: View | Sequence[View] | Mapping[str, View] | None) -> list[tuple[str, View]]:
    """Views with the names that they were given, or none."""
    if not isinstance(views, Mapping):
        return [("", view) for view in _views(views)]
    if not views:
        raise InputError("views is empty; name at least one")
    for name in views:
        if not isinstance(name, str):
            raise InputError(f"views has the name {name!r}; a str is needed")
    return [(name, _views(view)[0]) for name, view in views.items()]


def _views(views: View | Sequence[View] | None) -> list[View]:
    """One view or several, as a list."""
    if views is None:
        return ["three-quarter"]
    if isinstance(views, str):
        return [views]
    if not isinstance(views, Sequence | np.ndarray):
        raise InputError(f"views is {views!r}; give one view, or a list of views")
    if len(views) == 0:
        raise InputError("views is empty; name at least one")
    several: list[View] = []
    numbers: list[float] = []
    for view in views:
        if isinstance(view, str) or np.ndim(view) == 1:
            several.append(view)  # type: ignore[arg-type]
        else:
            numbers.append(arrays.number(view, "view"))
    if several and numbers:
        raise InputError(f"views is {views!r}; give one view, or a list of views")
    return several or [numbers]


def camera_of(view: View, up: Axis, flat: bool) -> tuple[list[list[float]], str]:
    """Axes to the right, upwards and towards the eye, and what the view is called."""
    if flat:
        return np.eye(3).tolist(), ""
    frames = {"y": np.eye(3), "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), "x": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])}
    frame = frames[arrays.word(up, "up", ("x", "y", "z"))]  # rows: to the right, upwards and towards the eye, seen from the front
    if isinstance(view, str):
        if view not in VIEWS:
            remedy = "give (azimuth, elevation) in radians, or a direction towards the eye"
            raise InputError(f"no view is called {view!r}; choose from {', '.join(VIEWS)}, {remedy}")
        azimuth, elevation = (math.radians(angle) for angle in VIEWS[view])
        called = view
    else:
        numbers = arrays.floats(view, "view", (None,))
        called = ""
        if len(numbers) == 2:
            azimuth, elevation = float(numbers[0]), float(numbers[1])
        elif len(numbers) == 3 and np.linalg.norm(numbers) > 0:
            x, y, z = frame @ (numbers / np.linalg.norm(numbers))
            azimuth, elevation = math.atan2(x, z), math.asin(min(max(y, -1.0), 1.0))
        else:
            raise InputError(f"view is {view!r}; give a name, (azimuth, elevation) in radians, or a direction (x, y, z) towards the eye")
    ca, sa, ce, se = math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation)
    turned = np.array([[ca, 0, -sa], [-sa * se, ce, -ca * se], [sa * ce, se, ca * ce]])
    return (turned @ frame).tolist(), called


def polylines_of(lines: Any, geometry: Geometry) -> list[arrays.Floats]:
    if lines is None:
        return []
    if isinstance(lines, np.ndarray) and lines.ndim == 2:
        lines = [lines]
    if not isinstance(lines, Iterable):
        raise InputError(f"lines are {lines!r}; give one (k, D) array, or a list of them")
    if isinstance(lines, np.ndarray) and lines.ndim != 3:
        raise InputError(f"lines have shape {lines.shape}; give one (k, D) array, or a list of them")
    return [geometry.place(line, f"lines[{at}]") for at, line in enumerate(lines)]


def marks_of(points: Any, geometry: Geometry) -> arrays.Floats:
    if points is None:
        return np.zeros((0, 3))
    array = arrays.anything(points, "points")
    if array.ndim < 2 and array.dtype.kind in "bui":
        return np.ascontiguousarray(geometry.vertices[arrays.indices(points, "points", geometry.count, empty=True)])
    return geometry.place(points, "points")


def each_colour(given: Any, count: int, default: tuple[float, float, float], name: str) -> list[tuple[float, float, float]]:
    if given is None:
        return [default] * count
    several = isinstance(given, Sequence | np.ndarray) and len(given) > 0 and (isinstance(given[0], str) or np.ndim(given[0]) > 0)
    if isinstance(given, str) or not several:
        return [colors.color(given)] * count
    if len(given) != count:
        raise InputError(f"{name}: {len(given)} colours for {count}; give one, or one each")
    return [colors.color(c) for c in given]


def radius_of(radius: float | None, geometry: Geometry) -> float:
    """The radius at which the points of a cloud are drawn; 0 for a surface."""
    if len(geometry.faces):
        return 0.0
    return _touching_radius(geometry) if radius is None else arrays.number(radius, "radius", above=0)


def _touching_radius(geometry: Geometry) -> float:
    """Radius at which the points of a cloud cover what they lie on: from the distances of neighbours."""
    from scipy.spatial import cKDTree

    points = geometry.vertices
    if len(points) < 3:
        return max(float(np.ptp(points, axis=0).max()) * 0.05, 1e-9) if len(points) > 1 else 1.0
    some = points[np.linspace(0, len(points) - 1, min(len(points), 2000)).astype(int)]
    distances, _ = cKDTree(points).query(some, k=min(7, len(points)))
    far = float(np.median(distances[:, -1]))  # of the sixth neighbour: about 1.4 times the spacing of even samples
    reach = float(np.ptp(points, axis=0).max())
    return max((0.8 if len(geometry.normals) else 0.5) * far, 1e-4 * reach, 1e-150)
