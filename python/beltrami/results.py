"""What the results of all methods have in common: saving."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from . import arrays
from .errors import InputError
from .files import save_with, written

Writer = Callable[[Path], object]


def save_result(
    result: Any,
    path: str | os.PathLike[str],
    what: str,
    kinds: Mapping[str, Writer] | None = None,
    *,
    values: Sequence[str] = (),
    pictures: Sequence[str] = (".png", ".html"),
) -> Path:
    """Writes a result: everything to ``.npz``; the shape to ``.ply`` with those fields, named as ``values``, that have a row per vertex; by
    their suffixes what ``kinds`` write; what its ``plot`` paints to ``pictures``.

    Raises
    ------
    InputError
        The suffix is none of these; the message begins with ``what`` ("a segmentation is").
    FileError
        The file cannot be written.
    """
    file = arrays.file(path, "path")
    writers: dict[str, Writer] = {".npz": lambda file: save_arrays(file, archived(result))}
    if values:
        writers[".ply"] = lambda file: save_with(result.shape, {name: getattr(result, name) for name in values}, file)
    writers |= kinds or {}
    writers |= dict.fromkeys(pictures, lambda file: result.plot(path=file))
    write = writers.get(file.suffix.lower())
    if write is None:
        *others, last = writers
        raise InputError(f"{file}: {what} written to {', '.join(others)} or {last}")
    write(file)
    return file


def save_arrays(path: Path, table: Mapping[str, Any]) -> Path:
    """Arrays, numbers and words by their names, to ``.npz``."""
    return written(path, lambda stream: np.savez_compressed(stream, **table))


def archived(result: Any) -> dict[str, Any]:
    """The arrays, numbers and words of a result by their names; the columns of ``history`` as ``history_...``. A list of arrays, such as
    contours, is put end to end, and ``contour_starts`` has where each begins and the last one ends. Shapes and what belongs to the
    making of the result are left out."""
    kept: dict[str, Any] = {}
    for name in (one.name for one in fields(result) if not one.name.startswith("_")):
        value = getattr(result, name)
        if name == "history":
            kept |= {f"history_{column}": numbers for column, numbers in value.items()}
        elif isinstance(value, np.ndarray | np.generic | float | int | str):
            kept[name] = value
        elif isinstance(value, tuple) and all(isinstance(entry, float | int | str) for entry in value):
            kept[name] = np.array(value, str if name == "notes" else None)  # notes may be none
        elif isinstance(value, list) and all(isinstance(entry, np.ndarray) for entry in value):
            kept[name] = np.concatenate(value) if value else result.shape.coordinates[:0]
            kept[f"{name.removesuffix('s')}_starts"] = np.cumsum([0, *map(len, value)])
    return kept
