"""Pictures: which panel lies where on the sheet, what is painted in it, and the words and colour bars around."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core, arrays
from ..errors import InputError
from ..progress import part
from . import colors
from .canvas import Canvas, draw_bar, draw_legend, fitted, legend_width
from .fields import MISSING, Field, ramp_of
from .scene import Geometry

Pixels = npt.NDArray[np.uint8]
Colour = tuple[float, float, float]
EYE = 4.2  # distance of the eye in radii of what is seen


@dataclass(frozen=True)
class Drawing:
    """A shape with its fields, lines and marks, as cameras see them: what a picture shows, and a page."""

    geometry: Geometry
    fields: list[Field]
    cameras: list[tuple[list[list[float]], str]]  # axes of the eye, name of the view
    colormap: Any
    limits: tuple[float, float] | None
    marks: arrays.Floats
    mark_colours: list[Colour]
    point_size: float
    lines: list[arrays.Floats]
    line_colours: list[Colour]
    line_width: float
    radius: float  # of the points of a cloud; 0 for surfaces
    transparency: float
    edges: bool
    smooth: bool
    lit: bool

    def ramp(self, shown: Field) -> Field:
        """The field whose colours a colour bar shows."""
        return shown if shown.kind == "scalars" else ramp_of(shown, self.colormap, self.limits)

    @property
    def one_bar(self) -> bool:
        """Whether one colour bar serves all fields."""
        return len(self.fields) == 1 or (self.limits is not None and all(f.bar and f.kind == "scalars" for f in self.fields))

    @property
    def note(self) -> str:
        """What has to be said about the shape and its fields."""
        most = max(self.fields, key=lambda field: field.missing)
        total = len(self.geometry.faces) if most.kind == "faces" else self.geometry.count
        notes = [self.geometry.note, f"grey: no data at {most.missing:,} of {total:,}" if most.missing else ""]
        return " · ".join(note for note in notes if note)


class _Sheet:
    """The pixels of a picture, and what is left of them for panels when words and bars have taken their room."""

    def __init__(self, size: tuple[int, int], background: Any) -> None:
        self.width, self.height = size
        self.background = colors.color(background)
        dark = 0.3 * self.background[0] + 0.59 * self.background[1] + 0.11 * self.background[2] < 0.45
        self.canvas = Canvas(np.empty((self.height, self.width, 3), np.uint8), (0.93, 0.94, 0.96) if dark else (0.12, 0.14, 0.19))
        self.canvas.pixels[:] = np.round(255 * np.array(self.background)).astype(np.uint8)
        self.unit = max(min(9.0, 0.06 * min(size)), 0.0205 * math.sqrt(self.width * self.height))  # the size of ordinary text
        self.pad = 0.9 * self.unit
        self.top = self.bottom = self.pad
        self.bar_room = 0.0

    @property
    def inside(self) -> tuple[float, float]:
        return self.width - 2 * self.pad - self.bar_room, self.height - self.top - self.bottom

    def title(self, text: str) -> None:
        unit, pad = self.unit, self.pad
        self.canvas.text(fitted(text, 1.35 * unit, self.width - 2 * pad), pad + 0.2 * unit, pad + 1.3 * unit, 1.35 * unit, bold=True)
        self.top += 2.3 * unit

    def note(self, text: str) -> None:
        unit, pad = self.unit, self.pad
        words = fitted(text, 0.78 * unit, self.width - 2 * pad)
        self.canvas.text(words, pad + 0.2 * unit, self.height - pad, 0.78 * unit, strength=0.75)
        self.bottom += 1.5 * unit

    def side_bar(self, drawing: Drawing) -> None:
        """The colour bar, or the legend, to the right of all panels."""
        first, unit = drawing.fields[0], self.unit
        x = self.width - self.pad - self.bar_room + 0.8 * unit
        if not first.bar:
            draw_legend(self.canvas, first, x, self.top, self.inside[1], unit, 0.24 * self.width)
            return
        tall = min(self.inside[1] * 0.72, 22 * unit)
        y = self.top + 0.5 * (self.inside[1] - tall)
        draw_bar(self.canvas, drawing.ramp(first), x, y, 0.8 * unit, tall, 0.85 * unit, True)
        if first.name and len(drawing.fields) == 1:
            words = fitted(first.name, 0.9 * unit, 0.25 * self.width)
            self.canvas.text(words, self.width - self.pad, y - 1.1 * unit, 0.9 * unit, align="right")


class _View:
    """Where the eye is: around the middle of all that is seen."""

    def __init__(self, drawing: Drawing, perspective: bool) -> None:
        self.reach = np.concatenate([drawing.geometry.vertices, drawing.marks, *drawing.lines])
        self.centre = 0.5 * (self.reach.min(axis=0) + self.reach.max(axis=0))
        largest = max(float(np.abs(self.reach - self.centre).max()), 1e-150)
        spread = np.linalg.norm((self.reach - self.centre) / largest, axis=1)  # squares of 1e300 would overflow
        self.extent = largest * max(float(spread.max()), 1.0)
        self.distance = math.inf if drawing.geometry.flat or not perspective else EYE * self.extent

    def box(self, axes: list[list[float]], ball: float) -> tuple[arrays.Floats, arrays.Floats]:
        """The least and the greatest coordinates of what a camera sees, at one pixel per unit."""
        seen = (self.reach - self.centre) @ np.array(axes).T
        if math.isfinite(self.distance):
            seen = seen / (1 - seen[:, 2:] / self.distance)
        return seen[:, :2].min(axis=0) - ball, seen[:, :2].max(axis=0) + ball


def paint(
    drawing: Drawing,
    *,
    size: tuple[int, int],
    title: str | None,
    background: Any,
    samples: int,
    perspective: bool,
    color_bar: bool,
    report: Callable[[float], object] | None,
) -> Pixels:
    """The pixels of a picture: a panel for each field and view, with their names, and colour bars."""
    sheet, view = _Sheet(size, background), _View(drawing, perspective)
    unit, canvas = sheet.unit, sheet.canvas
    if title:
        sheet.title(title)
    if drawing.note:
        sheet.note(drawing.note)
    panels = [(shown, camera) for shown in drawing.fields for camera in range(len(drawing.cameras))]
    several, own_bars = len(panels) > 1, color_bar and not drawing.one_bar
    if color_bar and drawing.one_bar:
        sheet.bar_room = legend_width(drawing.fields[0], unit, sheet.width)
    named = several and (len(drawing.fields) > 1 or any(name for _, name in drawing.cameras))
    under = (1.7 * unit if named else 0.0) + (2.4 * unit if own_bars else 0.0)

    # One scale for all panels, so that views compare.
    boxes = [view.box(axes, drawing.radius) for axes, _ in drawing.cameras]
    sizes = [np.maximum(high - low, 1e-3 * view.extent) for low, high in boxes] * len(drawing.fields)
    inside = sheet.inside
    scale, columns, shares = _arranged(sizes, inside, (1.2 * unit, 0.8 * unit), under)
    if scale <= 0 or not math.isfinite(scale):
        raise InputError(f"size {sheet.width} x {sheet.height} leaves no room for {len(panels)} panels; make it larger")
    rows = math.ceil(len(panels) / columns)
    lowest = 0.5 * scale * max(float(box[1]) for box in sizes)
    for at, (shown, camera) in enumerate(panels):
        row = at // columns
        before = float(shares[row * columns : at].sum())
        x0, x1 = (round(sheet.pad + inside[0] * share) for share in (before, before + float(shares[at])))
        y0, y1 = (round(sheet.top + inside[1] * r / rows) for r in (row, row + 1))
        y1 -= round(under)
        (axes, view_name), (low, high) = drawing.cameras[camera], boxes[camera]
        middle = [0.5 * (x1 - x0) - 0.5 * scale * float(low[0] + high[0]), 0.5 * (y1 - y0) + 0.5 * scale * float(low[1] + high[1])]
        frame = {
            "width": max(x1 - x0, 1),
            "height": max(y1 - y0, 1),
            "samples": samples,
            "background": sheet.background,
            "lit": drawing.lit,
            "hollows": 0.16 * view.extent,
        }
        eye = {"axes": axes, "centre": view.centre.tolist(), "middle": middle, "scale": scale, "distance": view.distance}
        surface, balls, ropes = _surface(drawing, shown, unit), _balls(drawing, shown, scale), _ropes(drawing)
        painted = _core.paint(frame, eye, surface, balls, ropes, part(report, at / len(panels), (at + 1) / len(panels)))
        canvas.pixels[y0:y1, x0:x1] = painted[: y1 - y0, : x1 - x0]
        if several:
            names = [shown.name if len(drawing.fields) > 1 else "", view_name if len(drawing.cameras) > 1 else ""]
            words = fitted(" · ".join(name for name in names if name), 0.9 * unit, x1 - x0 - unit)
            foot = min(float(y1), 0.5 * (y0 + y1) + lowest + 0.5 * unit)
            canvas.text(words, 0.5 * (x0 + x1), foot + 1.1 * unit, 0.9 * unit, align="middle", strength=0.85)
        if own_bars and shown.bar:
            long = min(0.6 * (x1 - x0), 14 * unit)
            draw_bar(canvas, shown, 0.5 * (x0 + x1 - long), y1 + 1.75 * unit, long, 0.45 * unit, 0.72 * unit, False)
    if sheet.bar_room:
        sheet.side_bar(drawing)
    return canvas.done()


def _surface(drawing: Drawing, shown: Field, unit: float) -> dict[str, Any] | None:
    """The triangles of a panel as the core takes them; None for a cloud."""
    if not len(drawing.geometry.faces):
        return None
    return {
        "vertices": drawing.geometry.vertices,
        "faces": drawing.geometry.faces,
        "kind": shown.kind,
        "scalars": shown.scalars,
        "span": shown.span,
        "labels": shown.labels,
        "colours": shown.colours,
        "missing": MISSING,
        "levels": shown.levels,
        "level_colour": (0.07, 0.07, 0.10, 0.72),
        "level_width": max(1.2, 0.075 * unit),
        "edge_colour": (0.10, 0.12, 0.18, 0.55),
        "edge_width": 1.0 if drawing.edges else 0.0,
        "transparency": drawing.transparency,
        "smooth": drawing.smooth,
    }


def _balls(drawing: Drawing, shown: Field, scale: float) -> list[tuple[arrays.Floats, arrays.Floats, Any, arrays.Floats]]:
    """The points of a cloud as discs, and marks as balls: centres, radii, colours, normals."""
    geometry, balls = drawing.geometry, []
    if not len(geometry.faces):
        rgba = shown.each(geometry.count).copy()
        rgba[:, 3] *= 1 - drawing.transparency
        balls.append((geometry.vertices, np.full(geometry.count, drawing.radius), rgba, geometry.normals))
    if len(drawing.marks):
        rgba = np.ones((len(drawing.marks), 4), np.float32)
        rgba[:, :3] = drawing.mark_colours
        radii = np.full(len(drawing.marks), 0.5 * drawing.point_size / scale)
        balls.append((drawing.marks, radii, rgba, np.zeros((0, 3))))
    return balls


def _ropes(drawing: Drawing) -> tuple[arrays.Floats, list[int], list[float], list[tuple[float, float, float, float]]] | None:
    """Polylines as the core takes them: points end to end, where each starts, widths, colours."""
    lines = drawing.lines
    if not lines:
        return None
    starts = np.concatenate([[0], np.cumsum([len(line) for line in lines])]).tolist()
    points = np.ascontiguousarray(np.concatenate(lines))
    return points, starts, [drawing.line_width] * len(lines), [(*colour, 1.0) for colour in drawing.line_colours]


def _arranged(
    sizes: list[npt.NDArray[np.float64]], inside: tuple[float, float], gap: tuple[float, float], under: float
) -> tuple[float, int, npt.NDArray[np.float64]]:
    """Pixels per unit, as many as panels of these sizes leave room for; how many panels stand in a row; the share of the row of each."""
    count = len(sizes)
    scale, columns = 0.0, 1
    for some in range(1, count + 1):
        room = inside[0] / some - gap[0], inside[1] / math.ceil(count / some) - under - gap[1]
        fit = min(min(room[0] / float(box[0]), room[1] / float(box[1])) for box in sizes)
        if fit > scale * 1.0001:
            scale, columns = fit, some
    # In a single row narrow views leave their room to wide ones.
    widths = np.array([float(box[0]) for box in sizes])
    in_a_row = min((inside[0] - count * gap[0]) / widths.sum(), (inside[1] - under - gap[1]) / max(float(box[1]) for box in sizes))
    if in_a_row > scale:
        return in_a_row, count, (widths * in_a_row + gap[0]) / (widths * in_a_row + gap[0]).sum()
    return scale, columns, np.full(count, 1 / columns)
