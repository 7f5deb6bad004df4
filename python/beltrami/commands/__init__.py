"""The commands of the command line, ``beltrami COMMAND FILE... [options] -o OUT``: a module for each area, and here what they share.

Each command prints a short table of what it found and certified, shows a bar while it works, and writes what ``-o`` names: arrays to
``.npz`` or ``.csv``, shapes with their values to ``.ply``, pictures to ``.png``, interactive pages to ``.html``. Exit codes: 0 done,
1 not converged (the answer is still written, and it is said), 2 bad input (one line: what, where, remedy). To add a command, write a
function with :func:`command` in a module of this folder and name the module in ``_MODULES``."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import beltrami as bt

from ..clouds import CloudOperators
from ..errors import FileError, InputError
from ..files import columns, save_with, stored, written
from ..progress import Bar

Options = argparse.Namespace
DONE, NOT_CONVERGED, BAD_INPUT = 0, 1, 2
PICTURES = (".png", ".html")
ARRAYS = (".npz", ".csv", ".ply")
_MODULES = ("shapes", "spectra", "segmentation", "transport", "sphere", "skeleton", "registration", "committor", "pictures", "doctor")


@dataclass(frozen=True)
class Command:
    """A command: what it does with its options, how it names them, and its line in the help."""

    run: Callable[[Options], int]
    declare: Callable[[argparse.ArgumentParser], None]
    summary: str


COMMANDS: dict[str, Command] = {}


def command(
    name: str, summary: str, declare: Callable[[argparse.ArgumentParser], None]
) -> Callable[[Callable[[Options], int]], Callable[[Options], int]]:
    """Registers a command; ``declare`` adds its options to a parser."""

    def register(run: Callable[[Options], int]) -> Callable[[Options], int]:
        COMMANDS[name] = Command(run, declare, summary)
        return run

    return register


def load_commands() -> dict[str, Command]:
    """All commands, in the order in which the help lists them."""
    for module in _MODULES:
        importlib.import_module(f"{__name__}.{module}")
    return COMMANDS


# --- what is printed ---------------------------------------------------------------------------------------------------------------


def table(rows: Sequence[Sequence[object]], header: Sequence[str] = ()) -> None:
    """Prints rows in columns: numbers to the right, words to the left."""
    texts = [[_text(cell) for cell in row] for row in [*([header] if header else []), *rows]]
    if not texts:
        return
    widths = [max(len(row[at]) for row in texts) for at in range(len(texts[0]))]
    numeric = [bool(rows) and all(isinstance(row[at], int | float | np.number) for row in rows) for at in range(len(widths))]
    for row in texts:
        cells = (cell.rjust(width) if right else cell.ljust(width) for cell, width, right in zip(row, widths, numeric, strict=True))
        print("  ".join(cells).rstrip())


def _text(cell: object) -> str:
    if isinstance(cell, bool | np.bool_):
        return "yes" if cell else "no"
    if isinstance(cell, float | np.floating):
        return f"{cell + 0.0:.6g}"  # -0 is 0
    return str(cell)


def tell_notes(notes: Sequence[str]) -> None:
    """What is worth knowing, a line each."""
    for note in notes:
        print(f"note: {note}")


def unfinished(result: Any) -> int:
    """Says that the gap was not reached; the exit code."""
    print(f"not converged: the gap is {result.gap:.1e} after {result.iterations} iterations; give more with --max-iterations")
    return NOT_CONVERGED


# --- what comes in -----------------------------------------------------------------------------------------------------------------

FILES = "a surface or a cloud (OBJ, PLY, STL, OFF, XYZ, ...), or example:spot, example:bob, example:cortex"


def input_file(parser: argparse.ArgumentParser) -> None:
    """The option every method has: its shape."""
    parser.add_argument("file", help=FILES)


def cloud_options(parser: argparse.ArgumentParser) -> None:
    """What to make of a file of points."""
    parser.add_argument("--deduplicate", action="store_true", help="clouds: of points that coincide keep only the first")
    parser.add_argument(
        "--dimension", metavar="D", type=int, default=2, help="clouds: intrinsic dimension of the surface that was sampled (2)"
    )


def read(options: Options, file: str) -> Any:
    """The shape in the file that was named; ``example:spot`` is one of :mod:`beltrami.examples`."""
    if file.startswith("example:"):
        known = {"spot": bt.examples.spot, "bob": bt.examples.bob, "cortex": bt.examples.cortex}
        if file[8:] not in known:
            raise InputError(f"{file}: the examples are {', '.join(known)}")
        return known[file[8:]]()
    return bt.load(file, dimension=getattr(options, "dimension", 2), progress=Bar("loading"))


def shape_of(options: Options, file: str | None = None) -> Any:
    """The shape of a method: that in ``options.file`` or in another file, without copies of points where that is asked for."""
    shape = read(options, file or options.file)
    if options.deduplicate and isinstance(shape, bt.PointCloud):
        more: dict[str, Any] = {"dimension": shape.dimension, "normals": shape.normals, "weights": shape.weights, "data": shape.data}
        return bt.PointCloud(shape.points, deduplicate=True, **more)
    return shape


def operators_of(shape: Any) -> Any:
    """The operators, and for clouds what is known about them."""
    operators = bt.operators(shape)
    if isinstance(operators, CloudOperators):
        table([("certified stars", f"{100 * operators.certified:.4g} %"), ("points at the rim", int(operators.boundary.sum()))])
    tell_notes(operators.notes)
    return operators


def values_of(name: str | None, shape: Any, option: str = "--values") -> tuple[Any, str | None]:
    """A field of the shape or the numbers of a file, and what to call them; the shape's colours where nothing is named. ``option``
    named them."""
    if name is None:
        return (shape.data["colors"], None) if "colors" in shape.data else (None, None)
    if name in shape.data:
        return shape.data[name], name
    path = Path(name)
    if not path.exists():
        raise InputError(f"{option} {name}: no such file, and the shape has no such field (it has {', '.join(shape.data) or 'none'})")
    if path.suffix.lower() == ".npz":
        count = len(shape.coordinates)
        fields = {key: array for key, array in stored(path).items() if array.shape == (count,)}
        if not fields:
            raise InputError(f"{option} {name}: none of its arrays has one number per vertex")
        return (fields, None) if len(fields) > 1 else next((array, key) for key, array in fields.items())
    stem = path.name.removesuffix(".gz").removesuffix(".gii")
    label = stem.split(".")[-1] if stem.startswith(("lh.", "rh.")) else Path(stem).stem  # lh.sulc, as FreeSurfer names it
    return bt.load_values(path), label


def only_array(path: Path) -> npt.NDArray[Any]:
    """The array of an ``.npy`` file; by its content it may be an ``.npz``, of one array then."""
    fields = stored(path)
    if len(fields) != 1:
        raise FileError(f"{path} holds {len(fields)} arrays ({', '.join(fields) or 'none'}); one is needed, or name the file .npz")
    return next(iter(fields.values()))


def one_field(name: str, values: Any) -> Any:
    """What :func:`values_of` found, refused where it is several fields."""
    if isinstance(values, dict):
        raise InputError(f"{name} holds {', '.join(values)}; put the one that is meant into a file of its own")
    return values


# --- what goes out -----------------------------------------------------------------------------------------------------------------


def output_files(parser: argparse.ArgumentParser) -> None:
    """Where the answer goes."""
    parser.add_argument("-o", "--out", action="append", metavar="OUT", help=".npz, .csv, .ply, .png or .html; may be given several times")


def look_options(parser: argparse.ArgumentParser, view: str = "three-quarter") -> None:
    """How pictures look."""
    names = "front, back, left, right, top, bottom, three-quarter ..."
    parser.add_argument("--view", action="append", help=f"{names}; may be given several times, side by side ({view})")
    parser.set_defaults(views=[view])
    parser.add_argument("--up", choices="xyz", default="y", help="the axis that points upwards (y)")
    parser.add_argument("--title", help="a line of text above the picture")
    parser.add_argument("--size", metavar="WxH", default="1600x1000", help="size of the picture in pixels (1600x1000)")


def looks_of(options: Options) -> dict[str, Any]:
    """The options of :func:`beltrami.plot` that were given."""
    try:
        width, height = (int(side) for side in options.size.lower().split("x"))
    except ValueError:
        raise InputError(f"--size {options.size}: write it like 1600x1000") from None
    return {"views": options.view or options.views, "up": options.up, "title": options.title, "size": (width, height)}


def check_outputs(options: Options, kinds: Sequence[str] = (*ARRAYS, *PICTURES), what: str = "the answer") -> None:
    """Refuses an unknown kind of file before the work, not after it."""
    for name in options.out or []:
        if Path(name).suffix.lower() not in kinds:
            raise InputError(f"{name}: {what} can be written to {', '.join(kinds[:-1])} or {kinds[-1]}")


def write(
    options: Options,
    picture: Callable[[Path], object],
    *,
    shape: Any = None,
    values: Mapping[str, npt.NDArray[Any]] | None = None,
    result: Any = None,
    saved: Sequence[str] = (".npz",),
) -> None:
    """Writes an answer to each file of ``-o``: a ``picture``; the ``result`` as its ``save`` does, to kinds that are ``saved`` so; or the
    ``values``, those with a row a vertex of the ``shape`` to .csv and .ply."""
    every = {} if values is None else dict(values)
    count = 0 if shape is None else len(shape.coordinates)
    rows = {name: array for name, array in every.items() if array.ndim in (1, 2) and len(array) == count}
    for name in options.out or []:
        path = Path(name)
        suffix = path.suffix.lower()
        if suffix in PICTURES:
            picture(path)
        elif result is not None and suffix in saved:
            result.save(path)
        elif suffix == ".npz":
            written(path, lambda stream: np.savez_compressed(stream, **every))  # type: ignore[arg-type]
        elif suffix == ".csv":
            written(path, lambda stream: stream.write(_csv(columns(rows)).encode()))
        else:
            save_with(shape, rows, path)
        print(f"wrote {path}")


def painted(shape: Any, shown: Mapping[str, npt.NDArray[Any]], **look: Any) -> Callable[[Path], object]:
    """The picture of a shape with one field or several."""
    values = dict(shown) if len(shown) != 1 else next(iter(shown.values()))
    return lambda path: bt.plot(shape, values, label=next(iter(shown), None), path=path, **look)


def _csv(table: Mapping[str, npt.NDArray[Any]]) -> str:
    lines = [",".join(table)]
    lines += [",".join(repr(cell.item()) for cell in row) for row in zip(*table.values(), strict=True)]
    return "\n".join(lines) + "\n"
