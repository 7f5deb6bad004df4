"""Words, lines, colour bars and legends around a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core, arrays
from . import colors, lettering
from .fields import Field, number_text, tick_texts, ticks_of


@dataclass
class Canvas:
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


def fitted(text: str, size: float, room: float) -> str:
    """The text, shortened to fit."""
    if lettering.width(text, size) <= room:
        return text
    while text and lettering.width(text + "…", size) > room:
        text = text[:-1]
    return text.rstrip() + "…"


def draw_bar(canvas: Canvas, shown: Field, x: float, y: float, width: float, height: float, size: float, upright: bool) -> None:
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
        ticks = ticks_of(low, high)
        texts = tick_texts(ticks)
    else:  # small: its ends, and zero between them
        ticks = np.array([low, 0.0, high] if low < 0 < high else [low, high])
        texts = [number_text(float(f"{tick:.2g}"), 10.0 ** (math.floor(math.log10(max(abs(tick), 1e-300))) - 1)) for tick in ticks]
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


MOST = 24  # labels that a legend names


def legend_width(shown: Field, size: float, width: int) -> float:
    """Room that the colour bar or the legend of a field takes beside pictures, for text of some size."""
    if shown.bar and shown.kind == "scalars":
        wide = max((lettering.width(text, 0.85 * size) for text in tick_texts(ticks_of(*shown.span))), default=0.0)
        return max(1.3 * size + wide + 1.6 * size, lettering.width(fitted(shown.name, 0.9 * size, 0.25 * width), 0.9 * size) + size)
    if shown.bar:  # numbers on faces: the same bar
        return 5.5 * size
    if shown.legend:
        names = [fitted(name, 0.85 * size, 0.24 * width) for name in shown.legend[:MOST]]
        return 2.2 * size + max(lettering.width(name, 0.85 * size) for name in [*names, "and 99 more"])
    return 0.0


def draw_legend(canvas: Canvas, shown: Field, x: float, top: float, height: float, size: float, room: float) -> None:
    """The labels of a field with their colours, one below the other."""
    step = min(1.5 * size, height / (len(shown.legend) + 1))
    names = [*shown.legend[:MOST]] + ([f"and {len(shown.legend) - MOST} more"] if len(shown.legend) > MOST else [])
    y = top + 0.5 * (height - step * len(names))
    for at, name in enumerate(names):
        y += step
        if at < MOST:
            swatch = shown.colours[at] if shown.kind == "labels" else colors.categories(at + 1)[at]
            canvas.dot(x + 0.4 * size, y - 0.3 * size, 0.75 * size, swatch)
        canvas.text(fitted(name, 0.85 * size, room), x + 1.2 * size, y, 0.85 * size, strength=0.9)
