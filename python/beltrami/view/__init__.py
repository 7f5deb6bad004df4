"""Pictures of shapes without a display, and interactive pages in one file.

Everything is painted by the compiled core (perspective, depth, soft light, a colour computed for each pixel) and lettered by
:mod:`beltrami.view.lettering`: no window system, no OpenGL and no plotting package is needed."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .. import _core, arrays
from ..errors import InputError
from ..files import written
from ..progress import Progress, part, reporter
from . import colors, lettering

__all__ = ["Page", "Picture", "plot"]

Axis = Literal["x", "y", "z"]
View = str | Sequence[float]
Levels = bool | int | Sequence[float] | npt.NDArray[Any] | None

# Azimuth (from the front to the right) and elevation of the eye, in degrees.
_VIEWS: dict[str, tuple[float, float]] = {
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
_PLAIN = (0.80, 0.835, 0.885)
_MISSING = (0.72, 0.72, 0.72)


@dataclass(frozen=True, eq=False)
class Picture:
    """A painted picture.

    Attributes
    ----------
    pixels : ndarray (height, width, 3) of uint8
    description : str
        What is to be seen, for those who cannot see it.
    path : Path or None
        Where it was saved.
    """

    pixels: npt.NDArray[np.uint8]
    description: str = ""
    path: Path | None = None

    def __repr__(self) -> str:
        return f"Picture({self.pixels.shape[1]} x {self.pixels.shape[0]} pixels: {self.description})"

    def png(self) -> bytes:
        """The picture as a PNG file."""
        return _core.png(self.pixels)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes a PNG file.

        Raises
        ------
        FileError
            It cannot be written.
        """
        return _write(path, self.png())

    def _repr_png_(self) -> bytes:
        return self.png()


@dataclass(frozen=True, eq=False)
class Page:
    """An interactive page in one file: it opens from disk and needs no network.

    Attributes
    ----------
    html : str
    description : str
    path : Path or None
        Where it was saved.
    """

    html: str = field(repr=False)
    description: str = ""
    path: Path | None = None

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the page.

        Raises
        ------
        FileError
            It cannot be written.
        """
        return _write(path, self.html.encode())

    def _repr_html_(self) -> str:
        import html

        look, title = "width:100%;height:560px;border:0", html.escape(self.description)
        return f'<iframe srcdoc="{html.escape(self.html)}" style="{look}" title="{title}"></iframe>'


def _write(path: str | os.PathLike[str], content: bytes) -> Path:
    return written(arrays.file(path, "path"), lambda stream: stream.write(content))


@dataclass(frozen=True)
class Field:
    """One way to colour a shape, ready for the painter."""

    name: str
    kind: Literal["uniform", "scalars", "labels", "vertices", "faces"]
    scalars: npt.NDArray[np.float64]
    labels: npt.NDArray[np.int64]
    colours: npt.NDArray[np.float32]
    span: tuple[float, float] = (0.0, 1.0)
    levels: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    legend: tuple[str, ...] = ()
    missing: int = 0  # vertices or faces without data
    bar: bool = False  # whether numbers belong to the colours

    def each(self, count: int) -> npt.NDArray[np.float32]:
        """The colour of each point, (count, 4)."""
        if self.kind in ("vertices", "faces"):
            return self.colours
        if self.kind == "uniform":
            return np.repeat(self.colours[:1], count, axis=0)
        rgba = np.ones((count, 4), np.float32)
        if self.kind == "labels":
            known = (self.labels >= 0) & (self.labels < len(self.colours))
            rgba[:, :3] = _MISSING
            rgba[known] = self.colours[self.labels[known]]
        else:
            rgba[:, :3] = _look_up(self.scalars, self.span, self.colours[:, :3].astype(float))
        return rgba


def _look_up(values: npt.NDArray[np.float64], span: tuple[float, float], table: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    low, high = span
    known = np.isfinite(values)
    share = np.clip((values[known] - low) / (high - low), 0, 1) if high > low else np.full(int(known.sum()), 0.5)
    result = np.tile(np.array(_MISSING), (len(values), 1))
    place = np.linspace(0, 1, len(table))
    result[known] = np.column_stack([np.interp(share, place, table[:, axis]) for axis in range(3)])
    return result


def _ticks(low: float, high: float, most: int = 7) -> npt.NDArray[np.float64]:
    """Round numbers in a span."""
    if not high > low:
        return np.array([low])
    rough = (high - low) / max(most - 1, 1)
    power = 10.0 ** math.floor(math.log10(rough)) if rough > 0 else 1.0
    step = next((s * power for s in (1, 2, 2.5, 5, 10) if s * power >= rough * 0.999), 10 * power)
    first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
    if last - first > 4 * most:
        return np.array([low, high])
    return np.clip(np.arange(first, last + 1) * step, low, high)


def _number(value: float, step: float) -> str:
    """A number as a tick shows it."""
    if value == 0 or abs(value) < 1e-9 * step:
        return "0"
    if 1e-3 <= max(abs(value), step) < 1e5 and step >= 1e-4:
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        digits += round(step * 10**digits, 6) % 1 > 1e-6
        text = f"{value:.{digits}f}"
    else:
        mantissa, exponent = f"{value:.3g}".split("e") if "e" in f"{value:.3g}" else f"{value:.2e}".split("e")
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        text = f"{mantissa}·10" + "".join(dict(zip("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹", strict=True))[c] for c in str(int(exponent)))
    return text.replace("-", "−")


def _tick_texts(ticks: npt.NDArray[np.float64]) -> list[str]:
    step = float(np.diff(ticks).min()) if len(ticks) > 1 else max(abs(float(ticks[0])) / 100, 1e-300)
    return [_number(float(tick), step) for tick in ticks]


def _levels(contours: Levels, span: tuple[float, float]) -> npt.NDArray[np.float64]:
    if contours is None or contours is False:
        return np.zeros(0)
    if contours is True:
        contours = 14
    if isinstance(contours, int | np.integer):
        count = arrays.whole(contours, "contours", 1, 10000)
        return np.linspace(span[0], span[1], count + 2)[1:-1] if span[1] > span[0] else np.zeros(0)
    return np.unique(arrays.floats(contours, "contours", (None,)))


def _field(
    values: Any,
    name: str,
    vertex_count: int,
    face_count: int,
    *,
    colormap: Any,
    limits: tuple[float, float] | None,
    contours: Levels,
    names: Mapping[int, str] | Sequence[str] | None,
    color: Any,
) -> Field:
    nothing, no_labels = np.zeros(0), np.zeros(0, np.int64)
    if values is None:
        plain = np.ones((1, 4), np.float32)
        plain[0, :3] = _PLAIN if color is None else colors.color(color)
        return Field(name, "uniform", nothing, no_labels, plain)
    array = arrays.anything(values, name)
    where = "a vertex" + (" or a face" if face_count else "")
    lengths = (vertex_count, face_count or vertex_count)
    if array.dtype.kind not in "buif" or array.ndim not in (1, 2) or len(array) not in lengths:
        wanted = f"({vertex_count},)" + (f" or ({face_count},)" if face_count else "") + f", or ({vertex_count}, 3)"
        got = f"values have shape {array.shape} and dtype {array.dtype}"
        raise InputError(f"{got}; {wanted} real numbers are needed: one, or one colour, {where}")
    of_faces = len(array) != vertex_count
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim == 2:
        if array.shape[1] not in (3, 4):
            remedy = f"give one number {where}, or colours of 3 or 4 numbers; choose a column to plot it"
            raise InputError(f"values have shape {array.shape}; {remedy}")
        rgba = np.ones((len(array), 4), np.float32)
        rgba[:, : array.shape[1]] = array / 255.0 if array.dtype.kind in "ui" else array
        if not ((rgba >= 0) & (rgba <= 1)).all():
            row = int(np.flatnonzero(~((rgba >= 0) & (rgba <= 1)).all(axis=1))[0])
            raise InputError(f"values[{row}] is {array[row]}, no colour; give numbers from 0 to 1, or integers from 0 to 255")
        return Field(name, "faces" if of_faces else "vertices", nothing, no_labels, rgba)
    numeric_map = isinstance(colormap, str) and colormap != "categories"
    categorical = array.dtype.kind in "bui" and not numeric_map and limits is None
    if categorical:
        kinds = np.unique(array[array >= 0]) if array.dtype.kind != "b" else np.unique(array)
        categorical = len(kinds) <= 256
    if categorical:
        rgba = np.ones((max(len(kinds), 1), 4), np.float32)
        own = None if colormap is None or isinstance(colormap, str) else np.array([colors.color(c) for c in colors.listed(colormap)])
        chosen = colors.categories(len(kinds)) if own is None else own
        if len(chosen) < len(kinds):
            raise InputError(f"colormap has {len(chosen)} colours for {len(kinds)} labels")
        rgba[: len(kinds), :3] = chosen[: len(kinds)]
        labels = np.searchsorted(kinds, array).astype(np.int64) if len(kinds) else np.full(len(array), -1)
        labels[(array < 0) if array.dtype.kind == "i" else np.zeros(len(array), bool)] = -1

        def call(kind: Any) -> str:
            if isinstance(names, Mapping):
                return str(names.get(kind.item(), kind))
            return str(names[int(kind)]) if names is not None and int(kind) < len(names) else str(kind)

        made = Field(name, "labels", nothing, labels, rgba, legend=tuple(call(kind) for kind in kinds), missing=int((labels < 0).sum()))
    else:
        numbers = array.astype(float)
        known = numbers[np.isfinite(numbers)]
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
        signed = low < 0 < high and min(-low, high) > 0.15 * max(-low, high)
        if colormap is None:
            colormap = "balance" if signed and limits is None else "viridis"
        if limits is not None:
            try:
                low, high = (arrays.number(limit, "limits") for limit in limits)
            except (TypeError, ValueError) as error:
                raise InputError(f"limits are {limits!r}; two numbers are needed") from error
            if not low < high:
                raise InputError(f"limits are {low:g} and {high:g}; the first must be less")
        elif signed and isinstance(colormap, str) and colormap.removesuffix("_r") == "balance":
            low, high = -max(-low, high), max(-low, high)
        table = np.ones((256, 4), np.float32)
        table[:, :3] = colors.table(colormap)
        levels = np.zeros(0) if of_faces else _levels(contours, (low, high))
        made = Field(name, "scalars", numbers, no_labels, table, (low, high), levels, missing=len(numbers) - len(known), bar=True)
    if of_faces:  # constant on each face, so the colour can be looked up at once
        each = made.each(len(array))
        return Field(name, "faces", made.scalars, made.labels, each, made.span, nothing, made.legend, made.missing, made.bar)
    return made


@dataclass(frozen=True)
class _Geometry:
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


def _geometry(shape: Any) -> _Geometry:
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
    return _Geometry(np.ascontiguousarray((points - centre) @ axes), faces, given, dimension == 2, note, centre, axes)


def _named_views(views: View | Sequence[View] | Mapping[str, View] | None) -> list[tuple[str, View]]:
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


def _camera(view: View, up: Axis, flat: bool) -> tuple[list[list[float]], str]:
    """Axes to the right, upwards and towards the eye, and what the view is called."""
    if flat:
        return np.eye(3).tolist(), ""
    frames = {"y": np.eye(3), "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), "x": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])}
    frame = frames[arrays.word(up, "up", ("x", "y", "z"))]  # rows: to the right, upwards and towards the eye, seen from the front
    if isinstance(view, str):
        if view not in _VIEWS:
            remedy = "give (azimuth, elevation) in radians, or a direction towards the eye"
            raise InputError(f"no view is called {view!r}; choose from {', '.join(_VIEWS)}, {remedy}")
        azimuth, elevation = (math.radians(angle) for angle in _VIEWS[view])
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


@dataclass
class _Canvas:
    pixels: npt.NDArray[np.uint8]
    ink: tuple[float, float, float]
    strokes: list[tuple[arrays.Floats, list[int], float, tuple[float, float, float, float]]] = field(default_factory=list)

    def text(self, text: str, x: float, y: float, size: float, *, align: str = "left", bold: bool = False, strength: float = 1.0) -> None:
        points, starts = lettering.strokes(text, x, y, size, align)
        self.strokes.append((points, starts, size * (0.118 if bold else 0.088), (*self.ink, strength)))

    def line(self, points: Sequence[tuple[float, float]], width: float, strength: float = 1.0) -> None:
        self.strokes.append((np.array(points, float), [0, len(points)], width, (*self.ink, strength)))

    def dot(self, x: float, y: float, size: float, colour: npt.NDArray[Any]) -> None:
        self.strokes.append((np.array([[x, y]], float), [0, 1], size, (float(colour[0]), float(colour[1]), float(colour[2]), 1.0)))

    def done(self) -> npt.NDArray[np.uint8]:
        return _core.strokes(self.pixels, self.strokes)


def _fit(text: str, size: float, room: float) -> str:
    """The text, shortened to fit."""
    if lettering.width(text, size) <= room:
        return text
    while text and lettering.width(text + "…", size) > room:
        text = text[:-1]
    return text.rstrip() + "…"


def _bar(canvas: _Canvas, shown: Field, x: float, y: float, width: float, height: float, size: float, upright: bool) -> None:
    """A colour bar with ticks beside it."""
    x0, x1, y0, y1 = round(x), round(x + width), round(y), round(y + height)
    table = shown.colours[:, :3].astype(float) if shown.kind == "scalars" else None
    low, high = shown.span
    length = (y1 - y0) if upright else (x1 - x0)
    if table is None or length < 2:
        return
    share = (np.arange(length) + 0.5) / length
    ramp = np.column_stack([np.interp(share, np.linspace(0, 1, len(table)), table[:, axis]) for axis in range(3)])
    bytes_ = np.round(255 * ramp).astype(np.uint8)
    canvas.pixels[y0:y1, x0:x1] = bytes_[::-1, None] if upright else bytes_[None]
    canvas.line([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)], 1.0, 0.35)
    if upright:
        ticks = _ticks(low, high)
        texts = _tick_texts(ticks)
    else:  # small: its ends, and zero between them
        ticks = np.array([low, 0.0, high] if low < 0 < high else [low, high])
        texts = [_number(float(f"{tick:.2g}"), 10.0 ** (math.floor(math.log10(max(abs(tick), 1e-300))) - 1)) for tick in ticks]
    for tick, text in zip(ticks, texts, strict=True):
        along = (tick - low) / (high - low) if high > low else 0.5
        if upright:
            at = y1 - along * (y1 - y0)
            canvas.line([(x1 + 2, at), (x1 + 0.35 * size, at)], 1.2, 0.6)
            canvas.text(text, x1 + 0.85 * size, at + 0.34 * size, size, strength=0.9)
        else:
            at = x0 + along * (x1 - x0)
            canvas.line([(at, y1 + 1), (at, y1 + 0.25 * size)], 1.2, 0.6)
            half = 0.5 * lettering.width(text, size)
            canvas.text(text, min(max(at, x0 + half - size), x1 - half + size), y1 + 1.2 * size, size, align="middle", strength=0.9)
    for level in shown.levels[(shown.levels >= low) & (shown.levels <= high)]:
        along = (level - low) / (high - low) if high > low else 0.5
        across, down = x0 + along * (x1 - x0), y1 - along * (y1 - y0)
        ends = [(x0, down), (x1, down)] if upright else [(across, y0), (across, y1)]
        canvas.strokes.append((np.array(ends, float), [0, 2], 1.0, (0.08, 0.08, 0.12, 0.5)))


def _polylines(lines: Any, geometry: _Geometry) -> list[arrays.Floats]:
    if lines is None:
        return []
    if isinstance(lines, np.ndarray) and lines.ndim == 2:
        lines = [lines]
    if not isinstance(lines, Iterable):
        raise InputError(f"lines are {lines!r}; give one (k, D) array, or a list of them")
    if isinstance(lines, np.ndarray) and lines.ndim != 3:
        raise InputError(f"lines have shape {lines.shape}; give one (k, D) array, or a list of them")
    return [geometry.place(line, f"lines[{at}]") for at, line in enumerate(lines)]


def _marks(points: Any, geometry: _Geometry) -> arrays.Floats:
    if points is None:
        return np.zeros((0, 3))
    array = arrays.anything(points, "points")
    if array.ndim < 2 and array.dtype.kind in "bui":
        return np.ascontiguousarray(geometry.vertices[arrays.indices(points, "points", geometry.count, empty=True)])
    return geometry.place(points, "points")


def _each_colour(given: Any, count: int, default: tuple[float, float, float], name: str) -> list[tuple[float, float, float]]:
    if given is None:
        return [default] * count
    several = isinstance(given, Sequence | np.ndarray) and len(given) > 0 and (isinstance(given[0], str) or np.ndim(given[0]) > 0)
    if isinstance(given, str) or not several:
        return [colors.color(given)] * count
    if len(given) != count:
        raise InputError(f"{name}: {len(given)} colours for {count}; give one, or one each")
    return [colors.color(c) for c in given]


def _touching(geometry: _Geometry) -> float:
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


def plot(
    shape: Any,
    values: Any = None,
    *,
    path: str | os.PathLike[str] | None = None,
    views: View | Sequence[View] | Mapping[str, View] | None = None,
    up: Axis = "y",
    title: str | None = None,
    label: str | None = None,
    colormap: Any = None,
    limits: tuple[float, float] | None = None,
    contours: Levels = None,
    labels: Mapping[int, str] | Sequence[str] | None = None,
    color_bar: bool = True,
    color: Any = None,
    lines: Any = None,
    line_color: Any = None,
    line_width: float = 4.0,
    points: Any = None,
    point_color: Any = None,
    point_size: float = 16.0,
    radius: float | None = None,
    transparency: float = 0.0,
    edges: bool = False,
    smooth: bool = True,
    shading: bool = True,
    perspective: bool = True,
    background: Any = "#ffffff",
    size: tuple[int, int] = (1600, 1000),
    samples: int = 3,
    description: str | None = None,
    progress: Progress = None,
) -> Picture | Page:
    """Paints a shape; no display is needed.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud, tuple of (vertices, faces), or ndarray (n, D)
        Where D = 2 it is drawn flat; where D > 3 it is seen along its three principal axes, and the picture says so.
    values : array_like or mapping of str to array_like, optional
        What to colour it by: (n,) numbers; (n, 3) or (n, 4) colours from 0 to 1 or integers from 0 to 255; (n,) integers or booleans as
        labels (negative: no label); or any of these for the m faces. Several, by name, give a panel each (an interactive page lets
        choose). Where a number is not finite there is no data: grey, and the picture says how many.
    path : path, optional
        ``.png`` for a picture, ``.html`` for an interactive page in one file. Without it the picture is only returned.
    views : view, list of views, or mapping of names to views, optional
        From where: 'front', 'back', 'left', 'right', 'top', 'bottom', 'three-quarter', 'three-quarter right', 'three-quarter back';
        (azimuth, elevation) in radians; or a direction (x, y, z) towards the eye. Several are painted side by side,
        with their names below: ``{"lateral": "left", "medial": "right"}`` gives them others.
    up : {'y', 'z', 'x'}
        Which axis of the shape points upwards.
    title, label : str, optional
        Headline; what the colour bar measures, with its unit.
    colormap : str or list of colours, optional
        A name of :func:`beltrami.view.colors.table`; by default 'viridis', or 'balance' around zero for numbers of both signs.
    limits : (low, high), optional
        Numbers at the ends of the colour bar.
    contours : bool, int or array_like, optional
        Contour lines of the numbers: how many, or at which levels.
    labels : mapping or sequence, optional
        Names of the labels.
    color_bar : bool
        Whether a colour bar or a legend is drawn.
    color : colour, optional
        Colour of a shape without values.
    lines : array_like (k, D) or list of them, optional
        Polylines with depth; ``line_color`` one colour or one each, ``line_width`` in pixels.
    points : array_like (k, D) or of vertex numbers, optional
        Marked places; ``point_color`` one colour or one each, ``point_size`` in pixels.
    radius : float, optional
        Radius of the points of a cloud as a length; by default so that neighbours touch.
    transparency : float
        From 0 to 1 (clear glass), for lines and points inside.
    edges, smooth, shading, perspective : bool
        Draw the mesh's edges; interpolate light over triangles; any light at all (without it colours are exactly those of the bar);
        perspective.
    background : colour
        '#rrggbb', or three numbers from 0 to 1; words are light on dark ones. Of pictures; a page follows the reader's settings.
    size : (width, height)
        In pixels.
    samples : int
        Rows and columns of samples in a pixel, 1 to 8.
    description : str, optional
        Text for those who cannot see the picture; one is made otherwise.
    progress : bool or callable, optional

    Returns
    -------
    Picture or Page
        Jupyter shows either.

    Raises
    ------
    InputError
        The shape is empty, values do not fit it, or an option cannot be used.
    FileError
        The file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> import beltrami as bt
    >>> mesh = bt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> bt.plot(mesh, np.array([0.0, 1.0, 2.0]), size=(320, 200)).pixels.shape
    (200, 320, 3)
    """
    if path is not None and arrays.file(path, "path").suffix.lower() not in (".png", ".html", ".htm"):
        raise InputError(f"{path}: a picture ends in .png, an interactive page in .html")
    if np.shape(size) != (2,):
        raise InputError(f"size is {size!r}; give (width, height) in pixels")
    width, height = (arrays.whole(side, "size", 16, 20000) for side in size)
    for name, text in (("title", title), ("label", label), ("description", description)):
        if text is not None and not isinstance(text, str):
            raise InputError(f"{name} is {text!r}; a str is needed")
    transparency = arrays.number(transparency, "transparency", least=0)
    if transparency > 1:
        raise InputError(f"transparency is {transparency:g}; it must be from 0 to 1")
    geometry = _geometry(shape)
    given = dict(values) if isinstance(values, Mapping) else {label or "": values}
    if not given:
        raise InputError("values is an empty mapping; give at least one field, or None")
    counts = geometry.count, len(geometry.faces)
    look = {"colormap": colormap, "limits": limits, "contours": contours, "names": labels, "color": color}
    fields = [_field(numbers, str(name), *counts, **look) for name, numbers in given.items()]
    chosen = _named_views(views)
    cameras = [_camera(view, up, geometry.flat) for _, view in (chosen[:1] if geometry.flat else chosen)]
    cameras = [(axes, given or name) for (given, _), (axes, name) in zip(chosen, cameras, strict=False)]
    polylines, marks = _polylines(lines, geometry), _marks(points, geometry)
    line_colours = _each_colour(line_color, len(polylines), (0.82, 0.16, 0.20), "line_color")
    mark_colours = _each_colour(point_color, len(marks), (0.89, 0.34, 0.18), "point_color")
    said = description or _describe(geometry, fields, [name for _, name in cameras], title)
    report = reporter(progress, "painting")
    if path is not None and Path(path).suffix.lower() != ".png":
        from . import page

        html = page.build(
            geometry.vertices,
            geometry.faces,
            geometry.normals,
            [_page_field(page, f, colormap, limits) for f in fields],
            title=title or "",
            description=said,
            marks=marks,
            mark_colours=mark_colours,
            lines=polylines,
            radius=0.0 if len(geometry.faces) else _touching(geometry) if radius is None else radius,
            axes=cameras[0][0],
            up=[float(axis == up) for axis in "xyz"],
            flat=geometry.flat,
            lit=bool(shading) and not geometry.flat,
            note=geometry.note,
            plain=colors.color(color) if color is not None else _PLAIN,
            missing=_MISSING,
            markSize=arrays.number(point_size, "point_size", above=0) * 0.75,
            lineWidth=arrays.number(line_width, "line_width", above=0),
            lineColours=line_colours,
            transparency=transparency,
            edges=bool(edges),
            contours=any(len(f.levels) for f in fields),
            colourBar=bool(color_bar),
        )
        if report is not None:
            report(1.0)
        return Page(html, said, _write(path, html.encode()))
    reach = np.concatenate([geometry.vertices, marks, *polylines])
    centre = 0.5 * (reach.min(axis=0) + reach.max(axis=0))
    largest = max(float(np.abs(reach - centre).max()), 1e-150)
    extent = largest * max(float(np.linalg.norm((reach - centre) / largest, axis=1).max()), 1.0)  # squares of 1e300 would overflow
    distance = math.inf if geometry.flat or not perspective else 4.2 * extent
    ball = 0.0 if len(geometry.faces) else (_touching(geometry) if radius is None else arrays.number(radius, "radius", above=0))
    behind = colors.color(background)
    dark = 0.3 * behind[0] + 0.59 * behind[1] + 0.11 * behind[2] < 0.45
    ink = (0.93, 0.94, 0.96) if dark else (0.12, 0.14, 0.19)
    canvas = _Canvas(np.empty((height, width, 3), np.uint8), ink)
    canvas.pixels[:] = np.round(255 * np.array(behind)).astype(np.uint8)

    # Room for words: the unit is the size of ordinary text.
    size_ = max(min(9.0, 0.06 * min(width, height)), 0.0205 * math.sqrt(width * height))
    pad = 0.9 * size_
    top, bottom, left, right = pad, pad, pad, pad
    if title:
        canvas.text(_fit(title, 1.35 * size_, width - 2 * pad), pad + 0.2 * size_, pad + 1.3 * size_, 1.35 * size_, bold=True)
        top += 2.3 * size_
    missing = max(f.missing for f in fields)
    total = max(fields, key=lambda f: f.missing)
    total_count = len(geometry.faces) if total.kind == "faces" else geometry.count
    notes = [geometry.note, f"grey: no data at {missing:,} of {total_count:,}" if missing else ""]
    note = " · ".join(n for n in notes if n)
    if note:
        canvas.text(_fit(note, 0.78 * size_, width - 2 * pad), pad + 0.2 * size_, height - pad, 0.78 * size_, strength=0.75)
        bottom += 1.5 * size_
    panels = [(f, axes, name) for f in fields for axes, name in cameras]
    alone = len(fields) == 1 or (limits is not None and all(f.bar and f.kind == "scalars" for f in fields))
    first = fields[0]
    bar_room = 0.0
    if color_bar and alone and first.bar and first.kind == "scalars":
        wide = max((lettering.width(text, 0.85 * size_) for text in _tick_texts(_ticks(*first.span))), default=0.0)
        bar_room = max(1.3 * size_ + wide + 1.6 * size_, lettering.width(_fit(first.name, 0.9 * size_, 0.25 * width), 0.9 * size_) + size_)
    elif color_bar and alone and first.bar:  # numbers on faces: the same bar
        bar_room = 5.5 * size_
    elif color_bar and alone and first.legend:
        shown_names = [_fit(name, 0.85 * size_, 0.24 * width) for name in first.legend[:24]]
        bar_room = 2.2 * size_ + max(lettering.width(name, 0.85 * size_) for name in [*shown_names, "and 99 more"])
    inside = (width - left - right - bar_room, height - top - bottom)
    several = len(panels) > 1
    own_bar = color_bar and not alone
    named = several and (len(fields) > 1 or any(name for _, _, name in panels))
    under = (1.7 * size_ if named else 0.0) + (2.4 * size_ if own_bar else 0.0)

    # Projected extents at one pixel a unit; one scale for all panels, so that views compare.
    boxes = []
    for axes, _ in cameras:
        q = (reach - centre) @ np.array(axes).T
        if math.isfinite(distance):
            q = q / (1 - q[:, 2:] / distance)
        boxes.append((q[:, :2].min(axis=0) - ball, q[:, :2].max(axis=0) + ball))
    sizes = [np.maximum(high - low, 1e-3 * extent) for low, high in boxes] * len(fields)
    gap = (1.2 * size_, 0.8 * size_)
    best: tuple[float, int] = (0.0, 1)
    for columns in range(1, len(panels) + 1):
        room = inside[0] / columns - gap[0], inside[1] / math.ceil(len(panels) / columns) - under - gap[1]
        fit = min(min(room[0] / float(box[0]), room[1] / float(box[1])) for box in sizes)
        if fit > best[0] * 1.0001:
            best = fit, columns
    scale, columns = best
    shares = np.full(len(panels), 1 / columns)
    # In a single row narrow views leave their room to wide ones.
    widths = np.array([float(box[0]) for box in sizes])
    in_a_row = min((inside[0] - len(panels) * gap[0]) / widths.sum(), (inside[1] - under - gap[1]) / max(float(box[1]) for box in sizes))
    if in_a_row > scale:
        scale, columns = in_a_row, len(panels)
        shares = (widths * scale + gap[0]) / (widths * scale + gap[0]).sum()
    if scale <= 0 or not math.isfinite(scale):
        raise InputError(f"size {width} x {height} leaves no room for {len(panels)} panels; make it larger")
    rows = math.ceil(len(panels) / columns)
    lowest = 0.5 * scale * max(float(box[1]) for box in sizes)
    for at, (shown, axes, view_name) in enumerate(panels):
        row = at // columns
        before = float(shares[row * columns : at].sum())
        x0, x1 = (round(left + inside[0] * share) for share in (before, before + float(shares[at])))
        y0, y1 = (round(top + inside[1] * r / rows) for r in (row, row + 1))
        y1 -= round(under)
        low, high = boxes[at % len(cameras)]
        middle = [0.5 * (x1 - x0) - 0.5 * scale * float(low[0] + high[0]), 0.5 * (y1 - y0) + 0.5 * scale * float(low[1] + high[1])]
        camera = {"axes": axes, "centre": centre.tolist(), "middle": middle, "scale": scale, "distance": distance}
        frame = {
            "width": max(x1 - x0, 1),
            "height": max(y1 - y0, 1),
            "samples": arrays.whole(samples, "samples", 1, 8),
            "background": behind,
            "lit": bool(shading) and not geometry.flat,
            "hollows": 0.16 * extent,
        }
        surface = None
        balls = []
        if len(geometry.faces):
            surface = {
                "vertices": geometry.vertices,
                "faces": geometry.faces,
                "kind": shown.kind,
                "scalars": shown.scalars,
                "span": shown.span,
                "labels": shown.labels,
                "colours": shown.colours,
                "missing": _MISSING,
                "levels": shown.levels,
                "level_colour": (0.07, 0.07, 0.10, 0.72),
                "level_width": max(1.2, 0.075 * size_),
                "edge_colour": (0.10, 0.12, 0.18, 0.55),
                "edge_width": 1.0 if edges else 0.0,
                "transparency": transparency,
                "smooth": bool(smooth),
            }
        else:
            rgba = shown.each(geometry.count).copy()
            rgba[:, 3] *= 1 - transparency
            balls.append((geometry.vertices, np.full(geometry.count, ball), rgba, geometry.normals))
        if len(marks):
            rgba = np.ones((len(marks), 4), np.float32)
            rgba[:, :3] = mark_colours
            half = 0.5 * arrays.number(point_size, "point_size", above=0) / scale
            balls.append((marks, np.full(len(marks), half), rgba, np.zeros((0, 3))))
        ropes = None
        if polylines:
            starts = np.concatenate([[0], np.cumsum([len(line) for line in polylines])]).tolist()
            thick = [arrays.number(line_width, "line_width", above=0)] * len(polylines)
            ropes = (np.ascontiguousarray(np.concatenate(polylines)), starts, thick, [(*c, 1.0) for c in line_colours])
        painted = _core.paint(frame, camera, surface, balls, ropes, part(report, at / len(panels), (at + 1) / len(panels)))
        canvas.pixels[y0:y1, x0:x1] = painted[: y1 - y0, : x1 - x0]
        if several:
            names = [shown.name if len(fields) > 1 else "", view_name if len(cameras) > 1 else ""]
            words = _fit(" · ".join(n for n in names if n), 0.9 * size_, x1 - x0 - size_)
            foot = min(float(y1), 0.5 * (y0 + y1) + lowest + 0.5 * size_)
            canvas.text(words, 0.5 * (x0 + x1), foot + 1.1 * size_, 0.9 * size_, align="middle", strength=0.85)
        if own_bar and shown.bar:
            long = min(0.6 * (x1 - x0), 14 * size_)
            _bar(canvas, shown, 0.5 * (x0 + x1 - long), y1 + 1.75 * size_, long, 0.45 * size_, 0.72 * size_, False)
    if bar_room:
        x = width - right - bar_room + 0.8 * size_
        if first.bar:
            table = first if first.kind == "scalars" else _ramp(first, colormap, limits)
            tall = min(inside[1] * 0.72, 22 * size_)
            y = top + 0.5 * (inside[1] - tall)
            _bar(canvas, table, x, y, 0.8 * size_, tall, 0.85 * size_, True)
            if first.name and len(fields) == 1:
                canvas.text(_fit(first.name, 0.9 * size_, 0.25 * width), width - right, y - 1.1 * size_, 0.9 * size_, align="right")
        else:
            step = min(1.5 * size_, inside[1] / (len(first.legend) + 1))
            shown_names = [*first.legend[:24]] + ([f"and {len(first.legend) - 24} more"] if len(first.legend) > 24 else [])
            y = top + 0.5 * (inside[1] - step * len(shown_names))
            for at, name in enumerate(shown_names):
                y += step
                if at < 24:
                    swatch = first.colours[at] if first.kind == "labels" else colors.categories(at + 1)[at]
                    canvas.dot(x + 0.4 * size_, y - 0.3 * size_, 0.75 * size_, swatch)
                canvas.text(_fit(name, 0.85 * size_, 0.24 * width), x + 1.2 * size_, y, 0.85 * size_, strength=0.9)
    picture = Picture(canvas.done(), said)
    return picture if path is None else Picture(picture.pixels, said, picture.save(path))


def _ramp(shown: Field, colormap: Any, limits: tuple[float, float] | None) -> Field:
    """The table behind numbers on faces, for their colour bar."""
    count = len(shown.scalars)
    return _field(shown.scalars, shown.name, count, 0, colormap=colormap, limits=limits, contours=None, names=None, color=None)


def _page_field(page: Any, shown: Field, colormap: Any, limits: tuple[float, float] | None) -> dict[str, Any]:
    if not shown.bar:
        made: dict[str, Any] = page.field_data(shown, None, [])
        return made
    table = shown if shown.kind == "scalars" else _ramp(shown, colormap, limits)
    low, high = shown.span
    ticks = _ticks(low, high)
    places = [float((tick - low) / (high - low)) if high > low else 0.5 for tick in ticks]
    made = page.field_data(shown, table.colours[:, :3], list(zip(places, _tick_texts(ticks), strict=True)))
    return made


def _describe(geometry: _Geometry, fields: list[Field], views: list[str], title: str | None) -> str:
    what = f"a surface of {len(geometry.faces):,} triangles" if len(geometry.faces) else f"{geometry.count:,} points"
    colour = []
    for shown in fields:
        name = shown.name or ("values" if shown.bar else "labels")
        if shown.bar:
            colour.append(f"{name} from {shown.span[0]:.4g} to {shown.span[1]:.4g}")
        elif shown.legend:
            colour.append(f"{name}: {len(shown.legend)} regions")
    text = f"{title}: " if title else ""
    text += what + (", coloured by " + "; ".join(colour) if colour else "")
    named = [view for view in views if view]
    return text + (f", seen from {' and '.join(named)}" if named else "") + (f" ({geometry.note})" if geometry.note else "")
