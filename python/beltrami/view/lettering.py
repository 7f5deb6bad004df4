"""Letters for pictures, as strokes: drawn for this library, so that no font file and no other package is needed.

A glyph is written in a small language: ``M x y`` lifts the pen, ``L x y`` draws a line, ``C`` a cubic curve of three points, and
``A cx cy rx ry from to`` an arc of an ellipse (degrees, counter-clockwise from the right). The baseline is y = 0, capitals are 7 high."""

from __future__ import annotations

import math
import unicodedata
from functools import cache

import numpy as np
import numpy.typing as npt

__all__ = ["strokes", "width"]

_ROUND = "A 2.1 2.5 2.1 2.5 0 360"
_GLYPHS = {
    "a": f"{_ROUND} M 4.2 5 L 4.2 0",
    "b": f"M 0 7.4 L 0 0 {_ROUND.replace('A', 'N')}",
    "c": "A 2.1 2.5 2.1 2.5 50 310",
    "d": f"{_ROUND} M 4.2 7.4 L 4.2 0",
    "e": "M 0 2.6 L 4.2 2.6 A 2.1 2.5 2.1 2.5 2 312",
    "f": "A 2.3 5.9 1.3 1.5 75 180 L 1 0 M 0 5 L 2.4 5",
    "g": f"{_ROUND} M 4.2 5 L 4.2 -0.2 A 2.1 -0.2 2.1 1.9 0 -148",
    "h": "M 0 7.4 L 0 0 M 0 3 A 2 3 2 2 180 0 L 4 0",
    "i": "M 0 5 L 0 0 M 0 6.9 L 0 7.05",
    "j": "M 1.2 5 L 1.2 -0.7 A -0.1 -0.7 1.3 1.4 0 -80 M 1.2 6.9 L 1.2 7.05",
    "k": "M 0 7.4 L 0 0 M 3.6 5 L 0 1.9 M 1.4 3.1 L 3.8 0",
    "l": "M 0 7.4 L 0 0",
    "m": "M 0 5 L 0 0 M 0 3.3 A 1.6 3.3 1.6 1.7 180 0 L 3.2 0 M 3.2 3.3 A 4.8 3.3 1.6 1.7 180 0 L 6.4 0",
    "n": "M 0 5 L 0 0 M 0 3 A 2 3 2 2 180 0 L 4 0",
    "o": "A 2.2 2.5 2.2 2.5 0 360",
    "p": f"M 0 5 L 0 -2 {_ROUND.replace('A', 'N')}",
    "q": f"{_ROUND} M 4.2 5 L 4.2 -2",
    "r": "M 0 5 L 0 0 M 0 3 A 2 3 2 2 180 78",
    "s": "M 3.5 4.2 C 3.1 4.75 2.5 5 1.85 5 C .9 5 .2 4.5 .2 3.7 C .2 2.9 .9 2.7 1.9 2.5 "
    "C 2.9 2.3 3.7 2.1 3.7 1.3 C 3.7 .5 2.9 0 1.9 0 C 1.1 0 .4 .3 0 .9",
    "t": "M 1 6.6 L 1 1.4 A 2.3 1.4 1.3 1.4 180 270 L 2.6 0 M 0 5 L 2.5 5",
    "u": "M 0 5 L 0 2 A 2 2 2 2 180 360 L 4 5 M 4 2 L 4 0",
    "v": "M 0 5 L 2 0 L 4 5",
    "w": "M 0 5 L 1.5 0 L 3.1 5 L 4.7 0 L 6.2 5",
    "x": "M 0 5 L 3.8 0 M 3.8 5 L 0 0",
    "y": "M 0 5 L 2.1 0.1 M 4.2 5 L 1.7 -1.1 C 1.4 -1.8 1 -2 .2 -2",
    "z": "M 0 5 L 3.6 5 L 0 0 L 3.7 0",
    "A": "M 0 0 L 2.7 7 L 5.4 0 M 0.95 2.4 L 4.45 2.4",
    "B": "M 0 0 L 0 7 L 2.4 7 A 2.4 5.3 1.7 1.7 90 -90 L 0 3.6 M 2.4 3.6 A 2.5 1.8 1.9 1.8 90 -90 L 0 0",
    "C": "A 2.9 3.5 2.9 3.5 48 312",
    "D": "M 0 0 L 0 7 L 1.9 7 A 1.9 3.5 3.1 3.5 90 -90 L 0 0",
    "E": "M 4 7 L 0 7 L 0 0 L 4.1 0 M 0 3.6 L 3.5 3.6",
    "F": "M 4 7 L 0 7 L 0 0 M 0 3.5 L 3.4 3.5",
    "G": "A 2.9 3.5 2.9 3.5 48 356 L 3.2 3.3",
    "H": "M 0 7 L 0 0 M 4.9 7 L 4.9 0 M 0 3.6 L 4.9 3.6",
    "I": "M 0 7 L 0 0",
    "J": "M 2.8 7 L 2.8 1.7 A 1.3 1.7 1.5 1.7 0 -150",
    "K": "M 0 7 L 0 0 M 4.5 7 L 0 2.6 M 1.6 4.1 L 4.7 0",
    "L": "M 0 7 L 0 0 L 3.7 0",
    "M": "M 0 0 L 0 7 L 3 1.6 L 6 7 L 6 0",
    "N": "M 0 0 L 0 7 L 4.9 0 L 4.9 7",
    "O": "A 3.1 3.5 3.1 3.5 0 360",
    "P": "M 0 0 L 0 7 L 2.4 7 A 2.4 5 2 2 90 -90 L 0 3",
    "Q": "A 3.1 3.5 3.1 3.5 0 360 M 3.7 1.8 L 5.9 -0.5",
    "R": "M 0 0 L 0 7 L 2.4 7 A 2.4 5 2 2 90 -90 L 0 3 M 2.4 3 L 4.6 0",
    "S": "M 4.4 5.9 C 3.9 6.6 3.2 7 2.3 7 C 1.1 7 .3 6.3 .3 5.2 C .3 4.1 1.2 3.85 2.4 3.5 "
    "C 3.7 3.15 4.6 2.8 4.6 1.75 C 4.6 .6 3.6 0 2.4 0 C 1.3 0 .4 .45 0 1.2",
    "T": "M 0 7 L 4.8 7 M 2.4 7 L 2.4 0",
    "U": "M 0 7 L 0 2.4 A 2.4 2.4 2.4 2.4 180 360 L 4.8 7",
    "V": "M 0 7 L 2.6 0 L 5.2 7",
    "W": "M 0 7 L 1.9 0 L 3.9 6.6 L 5.9 0 L 7.8 7",
    "X": "M 0 7 L 4.8 0 M 4.8 7 L 0 0",
    "Y": "M 0 7 L 2.5 3.4 L 5 7 M 2.5 3.4 L 2.5 0",
    "Z": "M 0 7 L 4.6 7 L 0 0 L 4.7 0",
    "0": "A 2.1 3.5 2.1 3.5 0 360",
    "1": "M 0.7 5.7 L 2.4 7 L 2.4 0",
    "2": "A 2.1 5 2 2 168 -36 L 0 0 L 4.2 0",
    "3": "A 2 5.3 1.8 1.7 160 -90 A 2 1.8 2.1 1.8 90 -158",
    "4": "M 3.2 0 L 3.2 7 L 0 1.9 L 4.3 1.9",
    "5": "M 3.8 7 L 0.7 7 L 0.4 3.9 C .9 4.3 1.5 4.5 2.1 4.5 C 3.4 4.5 4.2 3.5 4.2 2.25 C 4.2 .9 3.3 0 2 0 C 1.1 0 .4 .3 0 1",
    "6": "A 2.1 2.2 2.1 2.2 0 360 M 3 7 C 1.2 5.6 0 4.1 0 2.2",
    "7": "M 0 7 L 4.2 7 L 1.4 0",
    "8": "A 2.1 5.3 1.7 1.7 0 360 N 2.1 1.8 2.1 1.8 0 360",
    "9": "A 2.1 4.8 2.1 2.2 0 360 M 1.2 0 C 3 1.4 4.2 2.9 4.2 4.8",
    ".": "M 0 0 L 0 0.15",
    ",": "M 0.3 0.1 L 0 -1.1",
    ":": "M 0 0 L 0 0.15 M 0 4.2 L 0 4.35",
    ";": "M 0.3 0.1 L 0 -1.1 M 0.3 4.2 L 0.3 4.35",
    "!": "M 0 7 L 0 2.2 M 0 0 L 0 0.15",
    "?": "A 1.8 5.3 1.8 1.7 170 -60 C 1.9 3.2 1.8 3 1.8 2.2 M 1.8 0 L 1.8 0.15",
    "'": "M 0 7.2 L 0 5.4",
    '"': "M 0 7.2 L 0 5.4 M 1.5 7.2 L 1.5 5.4",
    "-": "M 0 2.7 L 2.2 2.7",
    "–": "M 0 2.7 L 3.6 2.7",
    "—": "M 0 2.7 L 6 2.7",
    "−": "M 0 3 L 4.2 3",
    "+": "M 0 3 L 4.2 3 M 2.1 5.1 L 2.1 0.9",
    "=": "M 0 4 L 4.2 4 M 0 2 L 4.2 2",
    "/": "M 0 -1 L 3 7.6",
    "\\": "M 3 -1 L 0 7.6",
    "|": "M 0 -1.6 L 0 7.8",
    "(": "M 1.6 7.8 C -.3 5.6 -.3 .8 1.6 -1.4",
    ")": "M 0 7.8 C 1.9 5.6 1.9 .8 0 -1.4",
    "[": "M 1.5 7.8 L 0 7.8 L 0 -1.4 L 1.5 -1.4",
    "]": "M 0 7.8 L 1.5 7.8 L 1.5 -1.4 L 0 -1.4",
    "{": "M 2 7.8 C .4 7.8 1.5 3.2 0 3.2 C 1.5 3.2 .4 -1.4 2 -1.4",
    "}": "M 0 7.8 C 1.6 7.8 .5 3.2 2 3.2 C .5 3.2 1.6 -1.4 0 -1.4",
    "%": "A 1.2 5.6 1.2 1.4 0 360 N 5 1.4 1.2 1.4 0 360 M 5 7 L 1.2 0",
    "<": "M 3.8 5.2 L 0 3 L 3.8 0.8",
    ">": "M 0 5.2 L 3.8 3 L 0 0.8",
    "≤": "M 3.8 5.8 L 0 3.7 L 3.8 1.6 M 0 0.2 L 3.8 0.2",
    "≥": "M 0 5.8 L 3.8 3.7 L 0 1.6 M 0 0.2 L 3.8 0.2",
    "_": "M 0 -1 L 4.4 -1",
    "*": "M 1.5 6.8 L 1.5 3.8 M 0.2 6.05 L 2.8 4.55 M 0.2 4.55 L 2.8 6.05",
    "~": "M 0 2.6 C .9 4.2 1.7 3.8 2.2 3.1 C 2.8 2.3 3.6 2 4.3 3.5",
    "≈": "M 0 3.6 C .9 5.2 1.7 4.8 2.2 4.1 C 2.8 3.3 3.6 3 4.3 4.5 M 0 1.3 C .9 2.9 1.7 2.5 2.2 1.8 C 2.8 1 3.6 .7 4.3 2.2",
    "&": "M 5.2 0 L 1.4 4.6 C .2 6 1 7 2.1 7 C 3.3 7 4 5.6 2.6 4.6 C .8 3.5 0 2.8 0 1.8 C 0 .7 .9 0 2.1 0 C 3.6 0 4.6 1.2 4.9 3",
    "#": "M 1.6 7 L 0.9 0 M 4 7 L 3.3 0 M 0.2 4.8 L 4.9 4.8 M 0 2.2 L 4.7 2.2",
    "@": "A 3.6 2.9 1.5 1.7 0 360 M 5.1 4.6 L 5.1 2 C 5.2 1 7.2 .8 7.2 3 C 7.2 5.4 5.6 7 3.6 7 C 1.5 7 0 5.2 0 2.9 C 0 .4 1.8 -1.2 4.6 -1",
    "×": "M 0.2 4.7 L 3.6 1.3 M 3.6 4.7 L 0.2 1.3",
    "·": "M 0 2.8 L 0 2.95",
    "•": "M 0 2.8 L 0 2.95",
    "°": "A 1.2 5.8 1.2 1.2 0 360",
    "±": "M 0 3.6 L 4.2 3.6 M 2.1 5.7 L 2.1 1.5 M 0 0 L 4.2 0",
    "∞": "M 3 3 C 2 4.6 0 5 0 3 C 0 1 2 1.4 3 3 C 4 4.6 6 5 6 3 C 6 1 4 1.4 3 3",
    "…": "M 0 0 L 0 0.15 M 2.2 0 L 2.2 0.15 M 4.4 0 L 4.4 0.15",
    "→": "M 0 3 L 5 3 M 3.2 4.8 L 5 3 L 3.2 1.2",
    "√": "M 0 3.2 L 1.3 0 L 3.6 7 L 4.6 7",
    "λ": "M 0.5 7 C 1.6 7 1.8 6 2.2 4.8 L 4 0 M 2.1 4.4 L 0 0",
    "π": "M 0 4.8 L 4.8 4.8 M 1.1 4.8 L 1.1 0 M 3.6 4.8 L 3.6 0",
    "φ": "A 2.4 2.5 2.4 2.5 0 360 M 2.4 7 L 2.4 -2",
    "ψ": "M 0 5 L 0 2.4 A 2.4 2.4 2.4 2.4 180 360 L 4.8 5 M 2.4 7 L 2.4 -2",
    "χ": "M 0 5 L 4 -2 M 4 5 L 0 -2",
    "η": "M 0 5 L 0 0 M 0 3 A 2 3 2 2 180 0 L 4 -2",
    "δ": f"{_ROUND} M 3.4 4.6 C 1.2 5.6 .4 7.4 2 7.4 C 2.7 7.4 3.3 7.2 3.8 6.8",
    "κ": "M 0 5 L 0 0 M 3.6 5 L 0 2 M 1.3 3 L 3.8 0",
    "ν": "M 0 5 L 2 0 L 4 5",
    "μ": "M 0 5 L 0 -2 M 0 2 A 2 2 2 2 180 360 L 4 5 M 4 2 L 4 0",
    "σ": "A 2.1 2.4 2.1 2.4 0 360 M 2.1 4.8 L 4.7 4.8",
    "θ": "A 2 3.5 2 3.5 0 360 M 0 3.5 L 4 3.5",
    "ρ": f"M 0 2.5 L 0 -2 {_ROUND.replace('A', 'N')}",
    "α": "M 4.6 5 C 3.6 1.6 2.8 0 1.8 0 C .7 0 0 1 0 2.5 C 0 4 .7 5 1.8 5 C 2.8 5 3.6 3.4 4.6 0",
    "β": "M 0 -2 L 0 5.4 A 1.9 5.4 1.9 1.8 180 -90 A 1.9 1.8 2.2 1.8 90 -180",
    "γ": "M 0 5 L 2 0 L 4 5 M 2 0 L 2 -2",
    "ε": "A 1.9 3.75 1.7 1.25 40 270 N 1.9 1.25 1.9 1.25 90 320",
    "τ": "M 0 5 L 4 5 M 2 5 L 2 1.2 C 2 .3 2.4 0 3.2 0",
    "ω": "M 1 5 C -.4 3.6 -.4 0 1.5 0 C 2.7 0 3 1.4 3 2.8 C 3 1.4 3.3 0 4.5 0 C 6.4 0 6.4 3.6 5 5",
    "Δ": "M 0 0 L 2.7 7 L 5.4 0 L 0 0",
    "Φ": "A 2.8 3.5 2.8 2.3 0 360 M 2.8 7 L 2.8 0",
    "Ψ": "M 0 7 L 0 5 A 2.6 5 2.6 2.8 180 360 L 5.2 7 M 2.6 7 L 2.6 0",
    "Γ": "M 0 0 L 0 7 L 4 7",
    "Σ": "M 4.4 7 L 0 7 L 2.6 3.5 L 0 0 L 4.5 0",
    "Ω": "M 0 0 L 1.8 0 C 0 1.6 0 7 2.9 7 C 5.8 7 5.8 1.6 4 0 L 5.8 0",
    "ø": "A 2.2 2.5 2.2 2.5 0 360 M 4 5.4 L 0.4 -0.4",
    "ß": "M 0 0 L 0 5.4 A 1.8 5.4 1.8 1.8 180 -60 C 2 3.6 4 3 4 1.6 C 4 .4 2.8 0 1.6 0",
}
_RAISED = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻", "0123456789+−", strict=True))
_LOWERED = dict(zip("₀₁₂₃₄₅₆₇₈₉", "0123456789", strict=True))
_UNKNOWN = "M 0 0 L 0 7 L 4 7 L 4 0 L 0 0"
_GAP = 1.65
_SPACE = 2.6

Points = npt.NDArray[np.float64]


def _arc(cx: float, cy: float, rx: float, ry: float, start: float, end: float) -> list[tuple[float, float]]:
    steps = max(4, int(abs(end - start) / 9))
    angles = [math.radians(start + (end - start) * i / steps) for i in range(steps + 1)]
    return [(cx + rx * math.cos(a), cy + ry * math.sin(a)) for a in angles]


@cache
def _glyph(letter: str) -> tuple[tuple[Points, ...], float]:
    """The polylines of a letter and how far the pen goes on."""
    if letter in _RAISED or letter in _LOWERED:
        lines, advance = _glyph(_RAISED.get(letter) or _LOWERED[letter])
        lift = 3.4 if letter in _RAISED else -1.6
        return tuple(0.6 * line + np.array([0.0, lift]) for line in lines), 0.66 * advance
    if letter not in _GLYPHS:
        plain = "".join(c for c in unicodedata.normalize("NFKD", letter) if not unicodedata.combining(c))
        letter = plain[0] if plain and plain[0] in _GLYPHS else ""
    words = _GLYPHS.get(letter, _UNKNOWN).split()
    lines_: list[list[tuple[float, float]]] = []
    at = 0

    def take(count: int) -> list[float]:
        nonlocal at
        at += count
        return [float(word) for word in words[at - count : at]]

    while at < len(words):
        command = words[at]
        at += 1
        if command == "M" or not lines_ or command == "N":
            lines_.append([])
        line = lines_[-1]
        if command in "ML":
            x, y = take(2)
            line.append((x, y))
        elif command in "AN":  # N: an arc that starts a line of its own
            line.extend(_arc(*take(6)))
        else:
            (x0, y0), (x1, y1, x2, y2, x3, y3) = line[-1], take(6)
            for i in range(1, 9):
                t = i / 8
                a, b, c, d = (1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3
                line.append((a * x0 + b * x1 + c * x2 + d * x3, a * y0 + b * y1 + c * y2 + d * y3))
    arrays = tuple(np.array(line) for line in lines_)
    ink = max(float(array[:, 0].max()) for array in arrays)
    return arrays, (4.2 if letter.isdigit() else ink) + _GAP


def width(text: str, size: float) -> float:
    """Width of a text in pixels; ``size`` is ten sevenths of the height of a capital."""
    return sum(_SPACE if letter == " " else _glyph(letter)[1] for letter in text) * size / 10 - (_GAP * size / 10 if text else 0)


def strokes(text: str, x: float, y: float, size: float, align: str = "left") -> tuple[Points, list[int]]:
    """The strokes of one line of text whose baseline (x, y) lies on: points (k, 2) in pixels (y downwards), starts of the polylines."""
    pen = x - width(text, size) * {"left": 0.0, "middle": 0.5, "right": 1.0}[align]
    unit = size / 10
    points: list[Points] = []
    starts = [0]
    for letter in text:
        if letter == " ":
            pen += _SPACE * unit
            continue
        lines, advance = _glyph(letter)
        for line in lines:
            points.append(np.column_stack([pen + unit * line[:, 0], y - unit * line[:, 1]]))
            starts.append(starts[-1] + len(line))
        pen += advance * unit
    return (np.concatenate(points) if points else np.zeros((0, 2))), starts
