"""The fields that colour a shape: numbers, labels or colours of its vertices or faces; the ticks and contour levels that go with them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..errors import InputError
from . import colors

Levels = bool | int | Sequence[float] | npt.NDArray[Any] | None
PLAIN = (0.80, 0.835, 0.885)
MISSING = (0.72, 0.72, 0.72)


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
            rgba[:, :3] = MISSING
            rgba[known] = self.colours[self.labels[known]]
        else:
            rgba[:, :3] = _look_up(self.scalars, self.span, self.colours[:, :3].astype(float))
        return rgba


def _look_up(values: npt.NDArray[np.float64], span: tuple[float, float], table: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    low, high = span
    known = np.isfinite(values)
    share = np.clip((values[known] - low) / (high - low), 0, 1) if high > low else np.full(int(known.sum()), 0.5)
    result = np.tile(np.array(MISSING), (len(values), 1))
    place = np.linspace(0, 1, len(table))
    result[known] = np.column_stack([np.interp(share, place, table[:, axis]) for axis in range(3)])
    return result


def ticks_of(low: float, high: float, most: int = 7) -> npt.NDArray[np.float64]:
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


def number_text(value: float, step: float) -> str:
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


def tick_texts(ticks: npt.NDArray[np.float64]) -> list[str]:
    step = float(np.diff(ticks).min()) if len(ticks) > 1 else max(abs(float(ticks[0])) / 100, 1e-300)
    return [number_text(float(tick), step) for tick in ticks]


def _levels(contours: Levels, span: tuple[float, float]) -> npt.NDArray[np.float64]:
    if contours is None or contours is False:
        return np.zeros(0)
    if contours is True:
        contours = 14
    if isinstance(contours, int | np.integer):
        count = arrays.whole(contours, "contours", 1, 10000)
        return np.linspace(span[0], span[1], count + 2)[1:-1] if span[1] > span[0] else np.zeros(0)
    return np.unique(arrays.floats(contours, "contours", (None,)))


def field_of(
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
        plain[0, :3] = PLAIN if color is None else colors.color(color)
        return Field(name, "uniform", nothing, no_labels, plain)
    array = arrays.anything(values, name)
    where = "per vertex" + (" or face" if face_count else "")
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


def ramp_of(shown: Field, colormap: Any, limits: tuple[float, float] | None) -> Field:
    """The table behind numbers on faces, for their colour bar."""
    count = len(shown.scalars)
    return field_of(shown.scalars, shown.name, count, 0, colormap=colormap, limits=limits, contours=None, names=None, color=None)
