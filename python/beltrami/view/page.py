"""Interactive pages: one HTML file with the shape, its fields and a small viewer inside; it opens from disk without a network."""

from __future__ import annotations

import base64
import html
import json
from importlib import resources
from typing import Any

import numpy as np
import numpy.typing as npt

from .fields import MISSING, Field, tick_texts, ticks_of
from .panels import Drawing
from .scene import Axis

_MOST_LEVELS = 64  # contour lines that the viewer has room for


def _base64(array: npt.NDArray[Any], kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode()


def _bytes(colours: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    return np.round(255 * np.asarray(colours, float)).astype(np.uint8)


def _ramp_and_ticks(shown: Field, drawing: Drawing) -> tuple[npt.NDArray[Any] | None, list[tuple[float, str]]]:
    """The colours of the colour bar, and its ticks by their shares of it; none where no numbers belong to the colours."""
    if not shown.bar:
        return None, []
    low, high = shown.span
    ticks = ticks_of(low, high)
    places = [float((tick - low) / (high - low)) if high > low else 0.5 for tick in ticks]
    return drawing.ramp(shown).colours[:, :3], list(zip(places, tick_texts(ticks), strict=True))


def _field_data(shown: Field, drawing: Drawing) -> dict[str, Any]:
    """What the viewer has to know about a field."""
    ramp, ticks = _ramp_and_ticks(shown, drawing)
    low, high = shown.span
    levels = shown.levels[(shown.levels >= low) & (shown.levels <= high)]
    if len(levels) > _MOST_LEVELS:
        levels = levels[np.linspace(0, len(levels) - 1, _MOST_LEVELS).astype(int)]
    data: dict[str, Any] = {
        "name": shown.name,
        "kind": shown.kind,
        "span": [low, high],
        "table": _base64(_bytes(shown.colours[:, :3] if shown.kind in ("scalars", "labels", "uniform") else [[0, 0, 0]]), "u1"),
        "legend": list(shown.legend),
        "swatches": _bytes(shown.colours[:, :3]).ravel().tolist() if shown.kind == "labels" else [],
        "missing": shown.missing,
        "bar": shown.bar,
        "ramp": _bytes(ramp).ravel().tolist() if ramp is not None else [],
        "ticks": ticks,
        "step": (high - low) / 15 if high > low else 1.0,
        "levels": levels.tolist(),
    }
    if shown.kind == "scalars":
        data["values"] = _base64(shown.scalars, "<f4")
    elif shown.kind == "labels":
        data["values"] = _base64(shown.labels, "<f4")
    elif shown.kind in ("vertices", "faces"):
        data["rgba"] = _base64(_bytes(shown.colours), "u1")
    return data


def build(drawing: Drawing, *, title: str, description: str, up: Axis, plain: tuple[float, float, float], color_bar: bool) -> str:
    """The page. Positions are shifted to the middle of everything and scaled to reach 1."""
    geometry, lines, marks = drawing.geometry, drawing.lines, drawing.marks
    reach = np.concatenate([geometry.vertices, marks, *lines])
    centre = 0.5 * (reach.min(axis=0) + reach.max(axis=0))
    extent = max(float(np.linalg.norm(reach - centre, axis=1).max()), 1e-150)
    tints = np.full((len(marks), 4), 255, np.uint8)
    tints[:, :3] = _bytes(drawing.mark_colours).reshape(-1, 3)
    data = {
        "vertices": _base64((geometry.vertices - centre) / extent, "<f4"),
        "faces": _base64(geometry.faces, "<u4"),
        "normals": _base64(geometry.normals, "<f4") if len(geometry.normals) else None,
        "fields": [_field_data(shown, drawing) for shown in drawing.fields],
        "marks": _base64((marks - centre) / extent, "<f4"),
        "markColours": _base64(tints, "u1"),
        "linePoints": _base64((np.concatenate(lines) - centre) / extent if lines else np.zeros(0), "<f4"),
        "lineStarts": np.concatenate([[0], np.cumsum([len(line) for line in lines], dtype=int)]).tolist(),
        "radius": drawing.radius / extent,
        "axes": drawing.cameras[0][0],
        "up": [float(axis == up) for axis in "xyz"],
        "flat": geometry.flat,
        "lit": drawing.lit,
        "note": geometry.note,
        "plain": plain,
        "missing": MISSING,
        "markSize": drawing.point_size * 0.75,
        "lineWidth": drawing.line_width,
        "lineColours": drawing.line_colours,
        "transparency": drawing.transparency,
        "edges": drawing.edges,
        "contours": any(len(shown.levels) for shown in drawing.fields),
        "colourBar": color_bar,
    }
    text = resources.files(__package__).joinpath("viewer.html").read_text(encoding="utf-8")
    inside = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    words = {"__TITLE__": html.escape(title or "Shape"), "__DESCRIPTION__": html.escape(description)}
    for mark, replacement in words.items():
        text = text.replace(mark, replacement)
    return text.replace("__DATA__", inside)
