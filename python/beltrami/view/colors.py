"""Colour tables, each made from a few control points, so that no other package is needed.

``viridis`` and ``magma`` interpolate 17 colours of the maps of the same names (Smith, van der Walt, Firing 2015, CC0); all others are this
library's own, drawn in Oklab (Ottosson 2020), where equal steps look equally large."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import InputError

Colours = npt.NDArray[np.float64]

_VIRIDIS = "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26818e 21908c 1f9f88 28ae80 3ebc74 5dc963 82d34c abdc32 d5e21a fde725"
_MAGMA = "000004 0a0822 1d1146 36106a 50127c 691c81 822681 9c2e7f b63779 cf4170 e65163 f5695c fb8761 fea571 fec387 fde0a2 fcfdbf"
_CATEGORIES = "3f6fb5 f0953f 4ea66b d1495b 8f6bb8 37b2c4 e3c04a 9a6a4f ef8fb4 7d8b99 a5c955 2f4858"

_CONES_TO_RGB = np.array(
    [
        [4.0767416621, -1.2684380046, -0.0041960863],
        [-3.3077115913, 2.6097574011, -0.7034186147],
        [0.2309699292, -0.3413193965, 1.7076147010],
    ]
)

NAMES = ("viridis", "magma", "balance", "phase", "grey", "categories")


def _oklab(lightness: npt.ArrayLike, chroma: npt.ArrayLike, hue: npt.ArrayLike) -> Colours:
    """sRGB of Oklab's lightness, chroma and hue (radians)."""
    light, chroma, hue = np.broadcast_arrays(np.asarray(lightness, float), np.asarray(chroma, float), np.asarray(hue, float))
    a, b = chroma * np.cos(hue), chroma * np.sin(hue)
    cones = np.stack(
        [
            light + 0.3963377774 * a + 0.2158037573 * b,
            light - 0.1055613458 * a - 0.0638541728 * b,
            light - 0.0894841775 * a - 1.2914855480 * b,
        ],
        axis=-1,
    )
    linear = np.clip(cones**3 @ _CONES_TO_RGB, 0, 1)
    screen: Colours = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return screen


def _hex(text: str) -> tuple[float, float, float]:
    text = text.strip().lstrip("#")
    if len(text) == 3:
        text = "".join(2 * letter for letter in text)
    try:
        if len(text) != 6:
            raise ValueError
        return int(text[0:2], 16) / 255, int(text[2:4], 16) / 255, int(text[4:6], 16) / 255
    except ValueError:
        raise InputError(f"{text!r} is no colour; write it like '#3b528b', or give three numbers from 0 to 1") from None


def color(value: Any) -> tuple[float, float, float]:
    """A colour as three numbers from 0 to 1: from '#rrggbb', or from three numbers."""
    if isinstance(value, str):
        return _hex(value)
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape[-1:] not in ((3,), (4,)) or array.ndim != 1 or not ((array >= 0) & (array <= 1)).all():
        raise InputError(f"{value!r} is no colour; write it like '#3b528b', or give three numbers from 0 to 1")
    return float(array[0]), float(array[1]), float(array[2])


def listed(colormap: Any) -> Sequence[Any] | npt.NDArray[Any]:
    """A colour map that was given as a list of colours."""
    if not isinstance(colormap, Sequence | np.ndarray) or len(colormap) == 0:
        raise InputError(f"colormap is {colormap!r}; give the name of one, or a list of colours")
    return colormap


def _spread(colours: Sequence[Any] | Colours, count: int) -> Colours:
    points = np.array([color(c) for c in colours])
    place = np.linspace(0, 1, count)
    return np.column_stack([np.interp(place, np.linspace(0, 1, len(points)), points[:, axis]) for axis in range(3)])


def table(name: str | Sequence[Any] | npt.NDArray[Any], count: int = 256) -> Colours:
    """(count, 3) sRGB colours, 0 to 1, of a colour map.

    Parameters
    ----------
    name : str or sequence of colours
        One of ``viridis``, ``magma`` (sequential), ``balance`` (diverging), ``phase`` (cyclic), ``grey``; any of them with ``_r`` at the
        end runs backwards; ``categories`` for labels; a matplotlib name where matplotlib is installed; or a list of colours.
    """
    if not isinstance(name, str):
        return _spread(listed(name), count)
    if name.endswith("_r"):
        return table(name[:-2], count)[::-1]
    if name == "viridis":
        return _spread(_VIRIDIS.split(), count)
    if name == "magma":
        return _spread(_MAGMA.split(), count)
    if name == "grey":
        return _oklab(np.linspace(0.25, 0.97, count), 0, 0)
    if name == "balance":
        side = np.linspace(-1, 1, count)
        # Lightness falls alike on both sides; chroma rises from the white middle and stays inside the screen's gamut.
        far = np.abs(side)
        chroma = 0.165 * np.sin(np.minimum(1.25 * far, 1) * np.pi / 2) * (1 - 0.18 * far**3)
        return _oklab(0.965 - 0.52 * far**1.25, chroma, np.where(side < 0, 4.48, 0.50))
    if name == "phase":
        turn = np.linspace(0, 2 * np.pi, count)
        return _oklab(0.68 + 0.06 * np.cos(turn), 0.125, turn + 0.5)
    if name == "categories":
        return categories(count)
    try:
        import matplotlib as mpl

        return np.asarray(mpl.colormaps[name](np.linspace(0, 1, count)), float)[:, :3]
    except (ImportError, KeyError):
        remedy = f"choose from {', '.join(NAMES)} (matplotlib's are known where it is installed), or give a list of colours"
        raise InputError(f"no colour map is called {name!r}; {remedy}") from None


def categories(count: int) -> Colours:
    """(count, 3) colours that are easy to tell apart: twelve chosen by eye, then always the one farthest from all before."""
    chosen = [np.array(_hex(c)) for c in _CATEGORIES.split()]
    if count > len(chosen):
        light, chroma, hue = np.meshgrid(
            [0.45, 0.55, 0.65, 0.75, 0.85], [0.06, 0.10, 0.14], np.arange(0, 2 * np.pi, np.pi / 30), indexing="ij"
        )
        candidates = _oklab(light.ravel(), chroma.ravel(), hue.ravel())
        nearest = np.linalg.norm(candidates[:, None] - np.array(chosen), axis=2).min(axis=1)
        while len(chosen) < count:
            best = int(np.argmax(nearest))
            chosen.append(candidates[best])
            nearest = np.minimum(nearest, np.linalg.norm(candidates - candidates[best], axis=1))
    return np.array(chosen[:count])
