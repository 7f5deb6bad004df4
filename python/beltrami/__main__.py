"""The command line: ``beltrami COMMAND FILE... [options] -o OUT``.

Each command prints a short table of what it found and certified, shows a bar while it works, and writes what ``-o`` names: arrays to
``.npz`` or ``.csv``, shapes with their values to ``.ply``, pictures to ``.png``, interactive pages to ``.html``. Exit codes: 0 done,
1 not converged (the answer is still written, and it is said), 2 bad input (one line: what, where, remedy)."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

import beltrami as bt

from . import arrays
from .clouds import CloudOperators
from .errors import ConvergenceError, Error, FileError, InputError
from .files import stored, written
from .progress import Bar

Options = argparse.Namespace
DONE, NOT_CONVERGED, BAD_INPUT = 0, 1, 2


@dataclass(frozen=True)
class Command:
    """A command: what it does with its options, how it names them, and its line in the help."""

    run: Callable[[Options], int]
    declare: Callable[[argparse.ArgumentParser], None]
    summary: str


COMMANDS: dict[str, Command] = {}
ORDER = (
    "info", "convert", "eigen", "geodesic", "segment", "denoise", "transport", "game", "sphere", "skeleton", "register",
    "register-conformal", "distances", "committor", "plot", "gallery", "doctor",
)  # fmt: skip


def command(
    name: str, summary: str, declare: Callable[[argparse.ArgumentParser], None]
) -> Callable[[Callable[[Options], int]], Callable[[Options], int]]:
    """Registers a command; ``declare`` adds its options to a parser."""

    def register(run: Callable[[Options], int]) -> Callable[[Options], int]:
        COMMANDS[name] = Command(run, declare, summary)
        return run

    return register


# --- what commands share -----------------------------------------------------------------------------------------------------------


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


def shape_of(options: Options, file: str | None = None) -> Any:
    """The shape in the file that was named; ``example:spot`` is one of :mod:`beltrami.examples`."""
    name = file or options.file
    if name.startswith("example:"):
        known = {"spot": bt.examples.spot, "bob": bt.examples.bob, "cortex": bt.examples.cortex}
        if name[8:] not in known:
            raise InputError(f"{name}: the examples are {', '.join(known)}")
        return known[name[8:]]()
    return bt.load(name, dimension=getattr(options, "dimension", 2), progress=Bar("loading"))


def write(
    options: Options,
    shape: Any,
    values: Mapping[str, npt.NDArray[Any]],
    shown: Mapping[str, npt.NDArray[Any]],
    *,
    result: Any = None,
    **look: Any,
) -> None:
    """Writes an answer to each file of ``-o``: the ``result``, as its ``save`` does, or all ``values`` to .npz; those of the vertices to
    .csv and .ply; ``shown`` to pictures."""
    count = len(shape.coordinates)
    for name in options.out or []:
        path = Path(name)
        suffix = path.suffix.lower()
        if suffix == ".npz":
            if result is not None:
                result.save(path)
            else:
                written(path, lambda stream: np.savez_compressed(stream, **values))  # type: ignore[arg-type]
        elif suffix == ".csv":
            written(path, lambda stream: stream.write(_csv(values, count).encode()))
        elif suffix == ".ply":
            flat = dict(_columns(values, count))
            data = {**dict(shape.data), **flat}
            if isinstance(shape, bt.PointCloud):
                bt.save(bt.PointCloud(shape.points, dimension=shape.dimension, normals=shape.normals, data=data), path)
            else:
                bt.save(bt.TriangleMesh(shape.vertices, shape.faces, data=data), path)
        elif suffix in (".png", ".html"):
            bt.plot(shape, dict(shown) if len(shown) != 1 else next(iter(shown.values())), label=next(iter(shown), None), path=path, **look)
        else:
            raise InputError(f"{path}: the answer can be written to .npz, .csv, .ply, .png or .html")
        print(f"wrote {path}")


def check_outputs(options: Options) -> None:
    """Refuses an unknown kind of file before the work, not after it."""
    for name in options.out or []:
        if Path(name).suffix.lower() not in (".npz", ".csv", ".ply", ".png", ".html"):
            raise InputError(f"{name}: the answer can be written to .npz, .csv, .ply, .png or .html")


def _columns(values: Mapping[str, npt.NDArray[Any]], count: int) -> list[tuple[str, npt.NDArray[Any]]]:
    """One column each, of the arrays that have a row a vertex."""
    columns: list[tuple[str, npt.NDArray[Any]]] = []
    for name, array in values.items():
        if array.shape[:1] == (count,) and array.ndim == 1:
            columns.append((name, array))
        elif array.shape[:1] == (count,) and array.ndim == 2:
            columns += [(f"{name}_{at}", np.ascontiguousarray(array[:, at])) for at in range(array.shape[1])]
    return columns


def _csv(values: Mapping[str, npt.NDArray[Any]], count: int) -> str:
    columns = _columns(values, count)
    lines = [",".join(name for name, _ in columns)]
    lines += [",".join(repr(cell.item()) for cell in row) for row in zip(*(array for _, array in columns), strict=True)]
    return "\n".join(lines) + "\n"


FILES = "a surface or a cloud (OBJ, PLY, STL, OFF, XYZ, ...), or example:spot, example:bob, example:cortex"


def _input(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", help=FILES)


def _output(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--out", action="append", metavar="OUT", help=".npz, .csv, .ply, .png or .html; may be given several times")


def _look(parser: argparse.ArgumentParser, view: str = "three-quarter") -> None:
    names = "front, back, left, right, top, bottom, three-quarter ..."
    parser.add_argument("--view", action="append", help=f"{names}; may be given several times, side by side ({view})")
    parser.set_defaults(views=[view])
    parser.add_argument("--up", choices="xyz", default="y", help="the axis that points upwards (y)")
    parser.add_argument("--title")
    parser.add_argument("--size", metavar="WxH", default="1600x1000", help="of the picture in pixels (1600x1000)")


def _looks(options: Options) -> dict[str, Any]:
    try:
        width, height = (int(side) for side in options.size.lower().split("x"))
    except ValueError:
        raise InputError(f"--size {options.size}: write it like 1600x1000") from None
    return {"views": options.view or options.views, "up": options.up, "title": options.title, "size": (width, height)}


# --- the commands ------------------------------------------------------------------------------------------------------------------


def _info_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="file", help=FILES)


@command("info", "what a shape is: counts, topology, size, data", _info_options)
def info(options: Options) -> int:
    for at, file in enumerate(options.files):
        shape = shape_of(options, file)
        if at:
            print()
        print(file)
        if isinstance(shape, bt.TriangleMesh):
            print(shape.report())
        else:
            points = shape.points
            rows = [
                ("points", f"{len(points)} in R^{points.shape[1]}"),
                ("dimension", shape.dimension),
                ("normals", shape.normals is not None),
            ]
            if len(points):
                rows.append(
                    (
                        "bounds",
                        "  ".join(f"[{low:.4g}, {high:.4g}]" for low, high in zip(points.min(axis=0), points.max(axis=0), strict=True)),
                    )
                )
            table([*rows, ("data", ", ".join(shape.data) or "none")])
    return DONE


def _convert_options(parser: argparse.ArgumentParser) -> None:
    _input(parser)
    parser.add_argument("target", nargs="?", metavar="OUT", help=".ply, .obj, .off, .stl, .xyz, .pts or .csv")
    parser.add_argument("-o", "--out", metavar="OUT", help="the same, as with the other commands")
    parser.add_argument("--weld", action="store_true", help="vertices at equal positions become one")
    parser.add_argument("--ascii", action="store_true", help="a text file where the format has both")


@command("convert", "a shape into another format", _convert_options)
def convert(options: Options) -> int:
    if (options.target is None) == (options.out is None):
        raise InputError("name one file to write: beltrami convert FILE OUT")
    out = options.target or options.out
    shape = shape_of(options)
    if options.weld:
        shape = bt.load(shape, weld=True)
    bt.save(shape, out, ascii=options.ascii, progress=Bar("writing"))
    print(f"{shape}\nwrote {out}")
    return DONE


def _cloud_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--deduplicate", action="store_true", help="clouds: keep the first of points that coincide")
    parser.add_argument("--dimension", metavar="D", type=int, default=2, help="clouds: intrinsic dimension of what was sampled (2)")


def _distinct(options: Options) -> Any:
    shape = shape_of(options)
    if options.deduplicate and isinstance(shape, bt.PointCloud):
        more: dict[str, Any] = {"dimension": shape.dimension, "normals": shape.normals, "weights": shape.weights, "data": shape.data}
        return bt.PointCloud(shape.points, deduplicate=True, **more)
    return shape


def _operators(shape: Any) -> Any:
    """The operators, and for clouds what is known about them."""
    operators = bt.operators(shape)
    if isinstance(operators, CloudOperators):
        table([("certified stars", f"{100 * operators.certified:.4g} %"), ("points at the rim", int(operators.boundary.sum()))])
    for note in operators.notes:
        print(f"note: {note}")
    return operators


def _eigen_options(parser: argparse.ArgumentParser) -> None:
    _input(parser)
    _look(parser)
    _output(parser)
    parser.add_argument("-k", type=int, default=20, help="how many pairs, from the smallest (20)")
    _cloud_options(parser)


@command("eigen", "eigenvalues and eigenfunctions of the Laplacian", _eigen_options)
def eigen(options: Options) -> int:
    check_outputs(options)
    shape, look = _distinct(options), _looks(options)
    pairs = bt.eigenpairs(_operators(shape), arrays.whole(options.k, "-k", 1), progress=Bar("eigenpairs"))
    table(list(zip(range(len(pairs.values)), pairs.values, pairs.residuals, strict=True)), ("", "eigenvalue", "residual"))
    first = 1 if len(pairs.values) > 1 else 0
    shown = {f"mode {at}, λ = {pairs.values[at] + 0.0:.4g}": pairs.functions[:, at] for at in range(first, min(len(pairs.values), 13))}
    write(options, shape, {"functions": pairs.functions}, shown, result=pairs, contours=[0.0], **look)
    return DONE


def _geodesic_options(parser: argparse.ArgumentParser) -> None:
    _input(parser)
    _look(parser)
    _output(parser)
    parser.add_argument("--source", type=int, action="append", help="a vertex at distance 0 (0); may be given several times")
    parser.add_argument("--contours", type=int, default=20, help="contour lines in pictures (20)")
    _cloud_options(parser)


@command("geodesic", "distances along the surface from one or many vertices", _geodesic_options)
def geodesic(options: Options) -> int:
    check_outputs(options)
    shape, look = _distinct(options), _looks(options)
    sources = options.source or [0]
    distance = bt.geodesic_distance(_operators(shape), sources, progress=Bar("distances"))
    reached = distance[np.isfinite(distance)]
    far = int(np.argmax(np.where(np.isfinite(distance), distance, -1.0)))
    rows: list[tuple[str, object]] = [
        ("sources", ", ".join(map(str, sources))),
        ("greatest distance", float(reached.max())),
        ("at vertex", far),
    ]
    rows.append(("mean distance", float(reached.mean())))
    if len(reached) < len(distance):
        rows.append(("not reached", f"{len(distance) - len(reached)} vertices of other components: inf"))
    table(rows)
    write(options, shape, {"distance": distance}, {"distance": distance}, contours=options.contours or None, points=sources, **look)
    return DONE


def _image_options(parser: argparse.ArgumentParser) -> None:
    _input(parser)
    _look(parser)
    _output(parser)
    parser.add_argument(
        "--values", help="the image: a field of the file, or a file of numbers (see plot), one or one row a vertex (the colours)"
    )
    weight = (
        "weight of the image against length (segment: 7.5 over its variance, more until no region is empty; denoise: 100 over its range)"
    )
    parser.add_argument("--fidelity", type=float, help=weight)
    parser.add_argument("--tv", choices=("isotropic", "edge"), default="isotropic", help="total variation on triangles, or a graph cut's")
    parser.add_argument("--tolerance", type=float, help="relative gap to stop at (1e-4)")
    parser.add_argument("--max-iterations", type=int, default=2000)
    _cloud_options(parser)


def _image(options: Options, shape: Any) -> npt.NDArray[np.float64]:
    values, _ = _values(options.values, shape)
    if values is None:
        raise InputError(f"{options.file} has no colours; name the image with --values (it has {', '.join(shape.data) or 'no data'})")
    if isinstance(values, dict):
        raise InputError(f"--values {options.values} holds {', '.join(values)}; put the one that is meant into a file of its own")
    array = np.asarray(values)
    image: npt.NDArray[np.float64] = array / 255.0 if array.dtype == np.uint8 else np.asarray(array, np.float64)
    return image[:, :3] if image.ndim == 2 and image.shape[1] == 4 and options.values is None else image  # no alpha


def _segment_options(parser: argparse.ArgumentParser) -> None:
    _image_options(parser)
    parser.add_argument("--regions", type=int, default=2, help="how many (2)")


@command("segment", "an image on a surface into regions with short boundaries (convex Chan-Vese), certified", _segment_options)
def segment(options: Options) -> int:
    check_outputs(options)
    shape, look = _distinct(options), _looks(options)
    image = _image(options, shape)
    spread = float(np.var(image.reshape(len(image), -1), axis=0).sum())
    fidelity = options.fidelity if options.fidelity is not None else 30.0 / (4 * spread) if spread > 0 else 1.0
    operators = _operators(shape)
    for tries in range(5):
        r = bt.segment(
            operators,
            image,
            fidelity=fidelity,
            regions=options.regions,
            tv=options.tv,
            tolerance=options.tolerance,
            max_iterations=options.max_iterations,
            progress=Bar("segment"),
        )
        if options.fidelity is not None or not r.notes or tries == 4:
            break
        fidelity *= 4
    means = [" ".join(f"{value:.5g}" for value in mean) for mean in r.means]
    table([(k, area, area / r.areas.sum(), mean) for k, (area, mean) in enumerate(zip(r.areas, means, strict=True))],
          ("region", "area", "share", "mean"))  # fmt: skip
    rows = [("fidelity", fidelity), ("contours", len(r.contours)), ("their length", r.contour_length), ("energy", r.primal)]
    rows += [("proved lower bound", r.dual), ("relative gap", r.gap), ("excess of the labels", r.excess), ("iterations", r.iterations)]
    print()
    table([*rows, ("converged", r.converged)])
    for note in r.notes:
        print(note)
    write(options, shape, {"labels": r.labels, "phi": r.phi}, {"region": r.labels}, result=r, lines=r.contours or None, **look)
    return DONE if r.converged else _unfinished(r)


@command("denoise", "an image on a surface by total variation (Rudin-Osher-Fatemi, colour too), certified", _image_options)
def denoise(options: Options) -> int:
    check_outputs(options)
    shape, look = _distinct(options), _looks(options)
    image = _image(options, shape)
    reach = float(np.ptp(image)) if image.size else 0.0
    u = bt.denoise(
        _operators(shape),
        image,
        fidelity=options.fidelity if options.fidelity is not None else 100.0 / reach if reach > 0 else 1.0,
        tv=options.tv,
        tolerance=1e-4 if options.tolerance is None else options.tolerance,
        max_iterations=options.max_iterations,
        progress=Bar("denoise"),
    )
    rows = [("fidelity", u.fidelity), ("energy", u.primal), ("proved lower bound", u.dual), ("relative gap", u.gap)]
    table([*rows, ("iterations", u.iterations), ("converged", u.converged)])
    shown = np.clip(u.image, 0, 1) if u.image.ndim == 2 and u.image.shape[1] == 3 else u.image
    pictures = {"denoised": shown} if shown.ndim == 1 or shown.shape[1] == 3 else {f"channel {k}": c for k, c in enumerate(shown.T)}
    write(options, shape, {"image": u.image}, pictures, result=u, **look)
    return DONE if u.converged else _unfinished(u)


def _unfinished(result: Any) -> int:
    print(f"not converged: the gap is {result.gap:.1e} after {result.iterations} iterations; give more with --max-iterations")
    return NOT_CONVERGED


def _sphere_options(parser: argparse.ArgumentParser) -> None:
    _input(parser)
    _look(parser)
    _output(parser)
    parser.add_argument("--method", choices=("fast", "cayley", "preconditioned_cayley"), default="fast")
    parser.add_argument("--fill-holes", action="store_true", help="close the holes of a mesh for the map")
    parser.add_argument("--no-check-genus", action="store_true", help="map a cloud even where it does not look like a sphere")
    parser.add_argument("--show", choices=("checkerboard", "angle_error", "conformal_factor"), default="checkerboard", help="in pictures")
    parser.add_argument("--on", choices=("shape", "sphere"), default="shape", help="what pictures show")
    _cloud_options(parser)


@command("sphere", "the conformal map of a surface of genus 0 to the unit sphere", _sphere_options)
def sphere(options: Options) -> int:
    check_outputs(options)
    shape, look = _distinct(options), _looks(options)
    bar = Bar("spherical map")
    check = not options.no_check_genus
    found = bt.spherical_map(shape, method=options.method, fill_holes=options.fill_holes, check_genus=check, progress=bar)
    error = np.degrees(found.angle_error)
    table(
        [
            ("energy less image area", found.excess),
            ("image area", found.area),
            ("angle error, degrees", f"mean {error.mean():.4g}, median {np.median(error):.4g}, greatest {error.max():.4g}"),
            ("flipped triangles", found.flipped),
            ("steps", found.iterations),
            ("converged", found.converged),
        ]
    )
    for note in found.notes:
        print(f"note: {note}")
    values = {"positions": found.positions, "conformal_factor": found.conformal_factor}
    rest = argparse.Namespace(out=[name for name in options.out or [] if Path(name).suffix.lower() not in (".png", ".html")])
    write(rest, shape, values, {}, result=found)
    for name in options.out or []:
        if name not in rest.out:
            print(f"wrote {found.plot(options.show, on=options.on, path=name, **look).path}")
    return DONE if found.converged else NOT_CONVERGED


def _register_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", help=FILES)
    parser.add_argument("file", metavar="target", help="the shape to which it is matched")
    _look(parser, "front")
    _output(parser)
    parser.add_argument("--method", choices=("auto", "rswd"), default="auto", help="rswd: sliced Wasserstein of the eigenmaps alone")
    parser.add_argument("--landmarks", metavar="FILE", help="pairs of vertex numbers, source and target: lines of .csv or .txt, or .npy")
    parser.add_argument("--intrinsic", action="store_true", help="only what no bending changes: no positions, no curvature")
    parser.add_argument("--seed", type=int, default=0, help="of the directions (0)")
    _cloud_options(parser)


@command("register", "the point map between two shapes that differ by a bending", _register_options)
def register(options: Options) -> int:
    check_outputs(options)
    look = _looks(options)
    target = _distinct(options)
    source = _distinct(argparse.Namespace(**{**vars(options), "file": options.source}))
    found = bt.register(
        source,
        target,
        method=options.method,
        landmarks=_vertex_pairs(options.landmarks),
        extrinsic=not options.intrinsic,
        rng=options.seed,
        progress=Bar("register"),
    )
    table(
        [
            ("coverage of the target", found.coverage),
            ("there and back, over sqrt(area)", found.bijectivity),
            ("orientation score", found.orientation),
            ("left and right told apart", found.mirror_decided),
            ("positions in R^3 used", found.extrinsic),
            ("sliced distance of the eigenmaps", found.distance),
        ]
    )
    rows = [(k, c.energy, c.smoothness, c.orientation) for k, c in enumerate(found.candidates)]
    table(rows, ("candidate", "energy", "smoothness", "orientation"))
    for note in found.notes:
        print(f"note: {note}")
    on_source: dict[str, npt.NDArray[Any]] = {"point_map": found.point_map}
    if found.positions is not None:
        on_source["deformed"] = found.positions
    for name in options.out or []:
        if Path(name).suffix.lower() == ".ply":
            write(argparse.Namespace(out=[name]), source, on_source, {})
        elif Path(name).suffix.lower() in (".png", ".html"):
            print(f"wrote {found.plot(path=name, **look).path}")
        else:
            print(f"wrote {found.save(name)}")
    return DONE


def _distances_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="file", help="shapes; one that cannot be read is said, and the others go on")
    parser.add_argument("-o", "--out", action="append", metavar="OUT", help="the matrix (.npz, .csv), a picture (.png)")
    parser.add_argument("--method", choices=("rswd", "shape_dna"), default="rswd")
    parser.add_argument("--processes", type=int, default=0, help="worker processes (0: none)")
    parser.add_argument("--checkpoint", metavar="FOLDER", help="keeps what is done; the same command goes on from there")
    parser.add_argument("--picture", choices=("map", "matrix", "dendrogram", "nearest"), default="map", help="what a .png shows (map)")


@command("distances", "distances between all pairs of shapes: a matrix, a map, a tree", _distances_options)
def distances(options: Options) -> int:
    import concurrent.futures

    for name in options.out or []:
        if Path(name).suffix.lower() not in (".npz", ".csv", ".png"):
            raise InputError(f"{name}: distances can be written to .npz, .csv or .png")
    workers = arrays.whole(options.processes, "--processes", 0, 4096)
    executor = concurrent.futures.ProcessPoolExecutor(workers) if workers else None
    try:
        shapes = [shape_of(options, file) if file.startswith("example:") else file for file in options.files]
        labels = [Path(file.removeprefix("example:")).stem for file in options.files]
        found = bt.distance_matrix(
            shapes, labels=labels, method=options.method, executor=executor, checkpoint=options.checkpoint, progress=Bar("distances")
        )
    finally:
        if executor is not None:
            executor.shutdown(cancel_futures=True)
    near = found.nearest()[:, 0]
    rows = [
        (name, found.labels[j] if j >= 0 else "-", found[i, j] if j >= 0 else np.inf)
        for i, (name, j) in enumerate(zip(found.labels, near, strict=True))
    ]
    table(rows, ("shape", "nearest", "distance"))
    for index, wrong in found.failures.items():
        print(f"failed: {found.labels[index]}: {wrong}")
    for name in options.out or []:
        if name.lower().endswith(".png"):
            found.plot(options.picture, path=name)
        else:
            found.save(name)
        print(f"wrote {name}")
    return NOT_CONVERGED if found.failures else DONE


def _register_conformal_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", help=FILES)
    parser.add_argument("file", metavar="target", help="the surface to which it is matched")
    _look(parser)
    _output(parser)
    parser.add_argument("--landmarks", metavar="FILE", help="pairs of vertex numbers, source and target: lines of .csv or .txt, or .npy")
    parser.add_argument("-k", type=int, default=20, help="size of the bases (20)")
    parser.add_argument("--refine", type=int, default=100, help="size of the basis the map is refined to; 0: not at all (100)")
    parser.add_argument("--start", choices=("auto", "spherical", "landmarks", "register"), default="auto")
    parser.add_argument("--orientation", choices=("preserving", "reversing", "any"), default="preserving")
    _cloud_options(parser)


@command("register-conformal", "the map between two shapes far from isometric, with its conformal factor", _register_conformal_options)
def register_conformal(options: Options) -> int:
    check_outputs(options)
    look = _looks(options)
    target = _distinct(options)
    source = _distinct(argparse.Namespace(**{**vars(options), "file": options.source}))
    found = bt.register_conformal(
        source,
        target,
        landmarks=_vertex_pairs(options.landmarks),
        k=options.k,
        refine=options.refine or None,
        start=options.start,
        orientation=options.orientation,
        progress=Bar("register conformal"),
    )
    table(
        [
            ("map", found.start),
            ("landmarks, with those found", len(found.landmarks)),
            ("coverage of the target", found.coverage),
            ("there and back, over sqrt(area)", found.consistency),
            ("log factor", f"{found.log_factor.min():.4g} to {found.log_factor.max():.4g}"),
            ("orthonormality error", found.orthonormality_error),
            ("objective", found.objective),
            ("converged", found.converged),
        ]
    )
    for note in found.notes:
        print(f"note: {note}")
    on_target = {"log_factor": found.log_factor, "inverse_map": found.inverse_map, "basis": found.basis}
    write(options, target, on_target, {"log w²": found.log_factor}, result=found, **look)
    return DONE if found.converged else NOT_CONVERGED


def _only(path: Path) -> npt.NDArray[Any]:
    """The array of an ``.npy`` file; by its content it may be an ``.npz``, of one array then."""
    fields = stored(path)
    if len(fields) != 1:
        raise FileError(f"{path} holds {len(fields)} arrays ({', '.join(fields) or 'none'}); one is needed, or name the file .npz")
    return next(iter(fields.values()))


def _vertex_pairs(name: str | None) -> npt.NDArray[np.int64] | None:
    """Rows of two vertex numbers from a file."""
    if name is None:
        return None
    path = Path(name)
    try:
        if path.suffix.lower() == ".npy":
            return _only(path)
        lines = [line.replace(",", " ").split() for line in path.read_text(encoding="utf-8-sig").splitlines()]
    except (OSError, ValueError) as error:
        if isinstance(error, Error):
            raise
        raise FileError(f"{path} cannot be read: {error}") from None
    rows = []
    for number, words in enumerate(lines, 1):
        try:
            pair = [int(word) for word in words]
        except ValueError:
            if number == 1:
                continue  # a heading
            raise InputError(f"{path}, line {number}: {' '.join(words)!r}; two vertex numbers are needed") from None
        if pair and len(pair) != 2:
            raise InputError(f"{path}, line {number}: {len(pair)} numbers; two are needed, of the source and of the target")
        if pair:
            rows.append(pair)
    return np.array(rows, np.int64).reshape(-1, 2)


def _flow_options(parser: argparse.ArgumentParser) -> None:
    _input(parser)
    _look(parser)
    _output(parser)
    what = "a field of the file, a file of numbers, one a vertex, uniform, or vertex:K[:WIDTH], a bump (width .1, in roots of the area)"
    parser.add_argument("--from", dest="start", required=True, metavar="DENSITY", help=f"the density at time 0: {what}")
    parser.add_argument("--to", dest="end", metavar="DENSITY", help="the density at time 1")
    parser.add_argument("--intervals", type=int, default=32, help="of time (32)")
    parser.add_argument("--method", choices=("primal_dual", "projected_gradient"), default="primal_dual")
    parser.add_argument("--tolerance", type=float, default=1e-3, help="relative gap to stop at (1e-3)")
    parser.add_argument("--max-iterations", type=int, default=300)
    parser.add_argument("--times", type=int, default=6, help="how many times in a picture (6); .html has at least 25")
    _cloud_options(parser)


def _density(name: str, shape: Any) -> npt.NDArray[np.float64]:
    """A density that was named on the command line."""
    places = shape.coordinates
    if name == "uniform":
        return np.ones(len(places))
    if name.startswith("vertex:"):
        try:
            vertex, width = (*name.split(":")[1:], "0.1")[:2]
            centre, size = int(vertex), arrays.number(float(width), "the bump's width", above=0)
        except ValueError as error:
            raise InputError(f"{name}: write it like vertex:120 or vertex:120:0.1 ({error})") from None
        arrays.indices([centre], name, len(places))
        reach = size * np.sqrt(bt.operators(shape).mass.sum())
        distance = bt.geodesic_distance(shape, centre) / reach
        bump: npt.NDArray[np.float64] = np.maximum(1 - distance**2 / 4, 0.0) ** 2
        return bump
    values, _ = _values(name, shape)
    if isinstance(values, dict):
        raise InputError(f"{name} holds {', '.join(values)}; put the one that is meant into a file of its own")
    array = np.asarray(values, np.float64)
    if array.shape != (len(places),):
        raise InputError(f"{name} has shape {array.shape}; one number a vertex is needed, that is ({len(places)},)")
    return array


def _unit_mass(density: npt.NDArray[np.float64], ops: Any) -> npt.NDArray[np.float64]:
    mass = float(ops.mass @ density)
    return density / mass if np.isfinite(mass) and mass > 0 else density


def _write_flow(options: Options, shape: Any, r: Any) -> None:
    values = {"density": np.ascontiguousarray(r.density.T), "potential": np.ascontiguousarray(r.potential.T)}  # a row a vertex
    pictures = [name for name in options.out or [] if Path(name).suffix.lower() in (".png", ".html")]
    write(argparse.Namespace(out=[name for name in options.out or [] if name not in pictures]), shape, values, {}, result=r)
    for name in pictures:
        times = options.times if name.lower().endswith(".png") else max(options.times, 25)
        print(f"wrote {r.plot(times=times, path=name, **_looks(options)).path}")


def _transport_options(parser: argparse.ArgumentParser) -> None:
    _flow_options(parser)


@command("transport", "optimal transport between two densities (of unit mass), certified", _transport_options)
def transport(options: Options) -> int:
    check_outputs(options)
    _looks(options)
    if options.end is None:
        raise InputError("--to is missing; name the density at time 1 (a game can do without)")
    shape = _distinct(options)
    ops = bt.operators(shape, laplacian="cotangent") if isinstance(shape, bt.TriangleMesh) else _operators(shape)
    ends = [_unit_mass(_density(name, shape), ops) for name in (options.start, options.end)]
    r = bt.transport(
        ops,
        *ends,
        intervals=options.intervals,
        normalize=True,
        method=options.method,
        tolerance=options.tolerance,
        max_iterations=options.max_iterations,
        progress=Bar("transport"),
    )
    rows = [("distance W2", r.distance), ("cost, half its square", r.cost), ("proved lower bound", r.lower_bound), ("relative gap", r.gap)]
    rows += [("continuity residual", r.continuity_residual), ("least density", float(r.density.min())), ("iterations", r.iterations)]
    table([*rows, ("converged", r.converged)])
    _write_flow(options, shape, r)
    return DONE if r.converged else _unfinished(r)


def _game_options(parser: argparse.ArgumentParser) -> None:
    _flow_options(parser)
    parser.add_argument("--congestion", type=float, metavar="W", help="running cost W/2 ∫ ρ²")
    parser.add_argument("--entropy", type=float, metavar="W", help="running cost W ∫ ρ log ρ - ρ")
    parser.add_argument("--cap", type=float, metavar="C", help="largest density, in units of the mean density")
    parser.add_argument("--potential", metavar="VALUES", help="running cost ∫ V ρ: a field or a file of numbers, one a vertex")
    parser.add_argument("--target", metavar="DENSITY", help="where the end shall be near, instead of --to")
    parser.add_argument(
        "--target-weight", type=float, default=10.0, metavar="W", help="how near (10): W ∫ ρ log(ρ / target) or W/2 ∫ (ρ - target)²"
    )
    parser.add_argument("--terminal", choices=("kullback_leibler", "quadratic"), default="kullback_leibler")
    parser.add_argument("--power", type=float, default=2.0, metavar="Q", help="speed to this power costs, from 1.05 to 2 (2)")


@command("game", "a mean-field game: transport with costs of crowds, places and the end, certified", _game_options)
def game(options: Options) -> int:
    check_outputs(options)
    _looks(options)
    if options.end is not None and options.target is not None:
        raise InputError("--to and --target are both given; the end is either fixed or free, so leave one out")
    shape = _distinct(options)
    ops = bt.operators(shape, laplacian="cotangent") if isinstance(shape, bt.TriangleMesh) else _operators(shape)
    start = _unit_mass(_density(options.start, shape), ops)
    running: list[bt.costs.Cost] = []
    if options.congestion is not None:
        running.append(bt.costs.congestion(options.congestion))
    if options.entropy is not None:
        running.append(bt.costs.entropy(options.entropy))
    if options.potential is not None:
        running.append(bt.costs.potential(_density(options.potential, shape)))
    if options.cap is not None:
        running.append(bt.costs.density_cap(arrays.number(options.cap, "--cap", above=0) / float(ops.mass.sum())))
    terminal = None
    if options.target is not None:
        target = _unit_mass(_density(options.target, shape), ops)
        if options.terminal == "kullback_leibler":
            target = _unit_mass(target + 1e-3 * target.max(), ops)  # it must be positive
        terminal = getattr(bt.costs, options.terminal)(target, weight=options.target_weight)
    total = None
    for cost in running:
        total = cost if total is None else total + cost
    r = bt.mean_field_game(
        ops,
        start,
        None if options.end is None else _unit_mass(_density(options.end, shape), ops),
        intervals=options.intervals,
        running_cost=total,
        terminal_cost=terminal,
        lagrangian=bt.costs.power(options.power),
        normalize=True,
        method=options.method,
        tolerance=options.tolerance,
        max_iterations=options.max_iterations,
        progress=Bar("game"),
    )
    rows = [("objective", r.objective), ("moving", r.kinetic), ("being somewhere", r.running), ("the end", r.terminal)]
    rows += [
        ("proved lower bound", r.lower_bound),
        ("relative gap", r.gap),
        ("exploitability", r.exploitability),
        ("iterations", r.iterations),
    ]
    table([*rows, ("converged", r.converged)])
    _write_flow(options, shape, r)
    return DONE if r.converged else _unfinished(r)


def _skeleton_options(parser: argparse.ArgumentParser) -> None:
    _input(parser)
    _look(parser)
    parser.add_argument("-o", "--out", action="append", metavar="OUT", help=".swc (trees), .obj (lines), .npz, .png or .html; repeatable")
    parser.add_argument("--function", help="eigenfunction, eccentricity, geodesic, or a field of the file or a file of numbers")
    parser.add_argument("--source", type=int, help="the vertex that --function geodesic measures from")
    parser.add_argument("--shortest-limb", type=float, default=0.04, help="limbs below this share of the function's length are cut (0.04)")
    parser.add_argument("--remove-outliers", action="store_true", help="clouds: leave out points far from their neighbours")
    parser.add_argument("--one-piece", action="store_true", help="refuse a shape of several connected pieces")
    _cloud_options(parser)


@command("skeleton", "a curve along the middle: the Reeb graph of an eigenfunction or of the eccentricity", _skeleton_options)
def skeleton(options: Options) -> int:
    for name in options.out or []:
        if Path(name).suffix.lower() not in (".swc", ".obj", ".npz", ".png", ".html"):
            raise InputError(f"{name}: a skeleton can be written to .swc, .obj, .npz, .png or .html")
    shape, look = _distinct(options), _looks(options)
    function: Any = options.function
    if function not in (None, "eigenfunction", "eccentricity", "geodesic"):
        function, _ = _values(function, shape)
    r = bt.skeleton(
        shape,
        function=function,
        source=options.source,
        components=not options.one_piece,
        shortest_limb=options.shortest_limb,
        remove_outliers=options.remove_outliers,
        progress=Bar("skeleton"),
    )
    rows = [
        (k, f"{limb[0]} - {limb[-1]}", len(limb), length, float(np.median(r.radii[limb])))
        for k, (limb, length) in enumerate(zip(r.limbs, r.lengths, strict=True))
    ]
    table(rows, ("limb", "ends", "nodes", "length", "radius"))
    print()
    low, high = r.stability
    table(
        [
            ("nodes", len(r.nodes)),
            ("leaves", r.leaves),
            ("cycles", r.cycles),
            ("pieces", int(r.components.max()) + 1),
            ("limbs cut", len(r.cut)),
            ("loops cancelled, greatest height", f"{len(r.cancelled)}, {low:.4g}"),
            ("least height of a loop", f"{high:.4g}"),
        ]
    )
    for note in r.notes:
        print(f"note: {note}")
    for name in options.out or []:
        if Path(name).suffix.lower() in (".png", ".html"):
            r.plot(path=name, **look)
        else:
            r.save(name)
        print(f"wrote {name}")
    return DONE


def _committor_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", help="points (n, D): an .npz with points, potential, A, B, weights; a .csv with such columns; or a shape")
    _look(parser)
    _output(parser)
    parser.add_argument("--beta", type=float, required=True, help="inverse temperature")
    parser.add_argument("--potential", default="potential", help="the array, column or field with the potential (potential)")
    parser.add_argument("--A", default="A", help="array, column or field that is not 0 in A; or ball:x,y,...,radius (A)")
    parser.add_argument("--B", default="B", help="the same for B (B)")
    parser.add_argument(
        "--sampling", choices=("any", "gibbs", "weighted"), default="any", help="what is known of U: its values, or samples"
    )
    parser.add_argument("--sample-beta", type=float, help="inverse temperature of the samples (--sampling gibbs)")
    parser.add_argument("--method", choices=("weak", "strong"), default="weak")
    parser.add_argument("--refine", type=int, help="how often triangles are split in four (1)")
    parser.add_argument("--bootstrap", type=int, default=0, help="half-samples for the error of the rate (0)")
    parser.add_argument("--block", type=int, default=1, help="points that are drawn together: the correlation time of a trajectory (1)")
    parser.add_argument("--lines", type=int, default=12, help="reactive streamlines in pictures (12)")
    _cloud_options(parser)


def _samples(options: Options) -> tuple[Any, dict[str, npt.NDArray[Any]]]:
    """A shape, and the named arrays that came with it."""
    path = Path(options.file)
    suffix = path.suffix.lower()
    if suffix not in (".npz", ".csv"):
        shape = shape_of(options)
        return shape, dict(shape.data)
    try:
        if suffix == ".npz":
            fields = stored(path)
        else:
            rows = np.genfromtxt(path, delimiter=",", names=True, encoding="utf-8-sig")
            if rows.dtype.names is None or rows.ndim != 1:
                raise InputError(f"{path}: a line with the columns' names and two or more lines of numbers are needed")
            fields = {name: np.asarray(rows[name]) for name in rows.dtype.names}
    except (OSError, ValueError) as error:
        if isinstance(error, Error):
            raise
        raise FileError(f"{path} cannot be read: {error}") from None
    if suffix == ".csv":
        known = {options.potential, options.A, options.B, "potential", "A", "B", "weights"}
        columns = [values for name, values in fields.items() if name not in known]
        if not columns:
            raise InputError(f"{path} has no columns of coordinates beside {', '.join(fields)}")
        fields["points"] = np.column_stack(columns)
    if "points" not in fields:
        raise InputError(f"{path} has no array 'points' (n, D); it has {', '.join(fields) or 'none'}")
    points = fields.pop("points")
    data = {name: values for name, values in fields.items() if values.shape[:1] == points.shape[:1]}
    weights = data.get("weights") if options.sampling == "weighted" else None
    return bt.PointCloud(points, dimension=options.dimension, weights=weights, data=data), {**fields, **data}


def _set(spec: str, name: str, fields: Mapping[str, npt.NDArray[Any]], count: int) -> Any:
    if spec.startswith("ball:"):
        try:
            *centre, radius = (float(word) for word in spec[5:].split(","))
        except ValueError:
            raise InputError(f"--{name} {spec}: write it like ball:0.5,-1,0.25 (the centre's coordinates, then the radius)") from None

        def level(points: npt.NDArray[np.float64]) -> Any:
            if points.shape[1] != len(centre):
                raise InputError(f"--{name} {spec}: the centre has {len(centre)} coordinates, the points have {points.shape[1]}")
            return np.linalg.norm(points - np.array(centre), axis=1) - radius

        return level
    if spec not in fields:
        raise InputError(f"--{name} {spec}: no such array, and no ball:...; the file has {', '.join(fields) or 'none'}")
    values = np.asarray(fields[spec])
    return values != 0 if len(values) == count and values.dtype.kind != "b" and np.isin(values, (0, 1)).all() else values


@command("committor", "the probability of reaching B before A, and the rate of reactions from A to B", _committor_options)
def committor(options: Options) -> int:
    check_outputs(options)
    shape, fields = _samples(options)
    if options.deduplicate:
        raise InputError("--deduplicate would leave the arrays behind; take copies out of the file")
    points, look = shape.coordinates, _looks(options)
    potential = None
    if options.sampling == "any":
        if options.potential not in fields:
            raise InputError(f"--potential {options.potential}: the file has {', '.join(fields) or 'no such array'}")
        potential = fields[options.potential]
    r = bt.committor(
        _operators(shape), potential, _set(options.A, "A", fields, len(points)), _set(options.B, "B", fields, len(points)),
        beta=options.beta, sampling=options.sampling, sample_beta=options.sample_beta, method=options.method, refine=options.refine,
        bootstrap=options.bootstrap, block=options.block, progress=Bar("committor"),
    )  # fmt: skip
    forth, back = r.mean_first_passage_times
    found = r.diagnostics
    table(
        [
            ("points, in A, in B", f"{len(points)}, {int(r.in_A.sum())}, {int(r.in_B.sum())}"),
            ("rate nu_AB", r.rate if r.rate_error is None else f"{r.rate:.6g} ± {r.rate_error:.2g}"),
            ("rate by the flux through q = 0.1 to 0.9", f"{r.rate_flux:.6g} ± {r.rate_flux_error:.2g}"),
            ("rate constants k_AB, k_BA", f"{r.rate_constant:.6g}, {r.rate_constant_backward:.6g}"),
            ("mean first passage times A to B, B to A", f"{forth:.6g}, {back:.6g}"),
            ("share of time last in A", r.share_A),
            ("points with 0.1 < q < 0.9", found.transition_points),
            ("effective samples, of the transition", f"{found.effective_sample_size:.0f}, {found.transition_sample_size:.0f}"),
            ("assumption", r.assumption),
            ("verdict", r.verdict),
        ]
    )
    painted = [name for name in options.out or [] if Path(name).suffix.lower() in (".png", ".html")]
    rest = argparse.Namespace(out=[name for name in options.out or [] if name not in painted])
    write(rest, shape, r.table(), {}, result=r)
    lines = options.lines if getattr(shape, "dimension", 2) == 2 or isinstance(shape, bt.TriangleMesh) else 0
    for name in painted:
        print(f"wrote {r.plot(path=name, streamlines=lines, **look).path}")
    return DONE


def _plot_options(parser: argparse.ArgumentParser) -> None:
    _input(parser)
    _look(parser)
    parser.add_argument("-o", "--out", action="append", metavar="OUT", required=True, help=".png or .html; may be given several times")
    parser.add_argument(
        "--values", help="a field of the file, or a file of numbers, one a vertex or a face (.npy .npz .csv .txt, GIFTI, FreeSurfer)"
    )
    parser.add_argument("--colormap")
    parser.add_argument("--contours", type=int, help="how many contour lines")
    parser.add_argument("--limits", type=float, nargs=2, metavar=("LOW", "HIGH"))
    parser.add_argument("--transparency", type=float, default=0.0)
    parser.add_argument("--edges", action="store_true", help="draw the mesh's edges")


@command("plot", "a picture (.png) or an interactive page (.html)", _plot_options)
def plot(options: Options) -> int:
    shape = shape_of(options)
    values, label = _values(options.values, shape)
    look = {
        "colormap": options.colormap,
        "contours": options.contours,
        "limits": options.limits,
        "transparency": options.transparency,
        "edges": options.edges,
    }
    for out in options.out:
        print(f"wrote {bt.plot(shape, values, label=label, path=out, progress=Bar('painting'), **look, **_looks(options)).path}")
    return DONE


def _values(name: str | None, shape: Any) -> tuple[Any, str | None]:
    if name is None:
        return (shape.data["colors"], None) if "colors" in shape.data else (None, None)
    if name in shape.data:
        return shape.data[name], name
    path = Path(name)
    if not path.exists():
        raise InputError(f"--values {name}: no such file, and the shape has no such field (it has {', '.join(shape.data) or 'none'})")
    if path.suffix.lower() == ".npz":
        count = len(shape.coordinates)
        fields = {key: array for key, array in stored(path).items() if array.shape == (count,)}
        if not fields:
            raise InputError(f"--values {name}: none of its arrays has one number a vertex")
        return (fields, None) if len(fields) > 1 else next((array, key) for key, array in fields.items())
    stem = path.name.removesuffix(".gz").removesuffix(".gii")
    label = stem.split(".")[-1] if stem.startswith(("lh.", "rh.")) else Path(stem).stem  # lh.sulc, as FreeSurfer names it
    return bt.load_values(path), label


def _gallery_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--out", default="gallery", help="folder (gallery)")
    parser.add_argument("--only", action="append", metavar="WORD", help="sections whose title has this word")
    parser.add_argument("--list", action="store_true", help="the titles")


@command("gallery", "the main results on real shapes, as one page that opens from disk", _gallery_options)
def gallery(options: Options) -> int:
    from .gallery import run, titles

    if options.list:
        print("\n".join(titles()))
        return DONE
    outcomes = run(options.out, only=options.only, progress=lambda text: print(text, file=sys.stderr, flush=True))
    table([(outcome.title, round(outcome.seconds, 2), outcome.error or "done") for outcome in outcomes], ("section", "seconds", ""))
    print(f"wrote {Path(options.out) / 'index.html'}")
    return DONE if all(outcome.error is None for outcome in outcomes) else NOT_CONVERGED


@command("doctor", "versions, threads, extras, and a self-test", lambda parser: None)
def doctor(options: Options) -> int:
    import importlib.metadata
    import platform

    rows: list[tuple[str, object]] = [
        ("beltrami", bt.__version__),
        ("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        ("threads", bt.num_threads()),
    ]
    for package, purpose in (
        ("numpy", ""), ("scipy", ""), ("trimesh", ""), ("matplotlib", "further colour maps"), ("nibabel", "GIFTI and FreeSurfer files"),
        ("nilearn", "the example cortex"), ("pyvista", "to_pyvista"), ("meshio", "its objects"), ("networkx", "to_networkx"),
        ("MDAnalysis", "molecules"), ("distributed", "distances on a Dask cluster"),
    ):  # fmt: skip
        found = next(iter(importlib.metadata.distributions(name=package)), None)
        absent = f"absent (optional: {purpose})" if purpose else "MISSING: pip install beltrami again"
        rows.append((package, absent if found is None else found.version))
    table(rows)
    good = _self_test()
    print("all is well" if good else "something is wrong: please report the lines above")
    return DONE if good else NOT_CONVERGED


def _self_test() -> bool:
    """A solve, two areas and a picture, each held against what is known."""
    sphere = bt.shapes.sphere(4)
    operators = bt.operators(sphere)
    matrix = operators.stiffness + _diagonal(operators.mass)
    right = sphere.vertices[:, 2] * operators.mass
    solution = bt.Cholesky(matrix, sphere.vertices).solve(right)
    residual = float(np.linalg.norm(matrix @ solution - right) / np.linalg.norm(right))
    # (L + M) u = M z has the solution z / 3 on the round sphere.
    error = float(np.abs(3 * solution - sphere.vertices[:, 2]).max())
    area = abs(float(operators.mass.sum()) / (4 * np.pi) - 1)
    flat = bt.TriangleMesh(np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    pixels = bt.plot(flat, color="#204080", size=(64, 64), color_bar=False).pixels  # type: ignore[union-attr]
    checks = [
        ("residual of a sparse solve", residual, 1e-12),
        ("error of a solution known in closed form", error, 1e-2),
        ("relative error of the sphere's area", area, 1e-2),
        ("colour of a painted square", float(np.abs(pixels[32, 32].astype(float) - [32, 64, 128]).max()), 0.5),
    ]
    table([(name, value, "ok" if value <= bound else f"ABOVE {bound:g}") for name, value, bound in checks])
    return all(value <= bound for _, value, bound in checks)


def _diagonal(values: npt.NDArray[np.float64]) -> Any:
    from scipy.sparse import dia_array

    return dia_array((values[None], [0]), shape=(len(values), len(values)))


# --- the door ----------------------------------------------------------------------------------------------------------------------


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message}; {self.prog} --help lists what there is\n")


def _warning(message: Warning | str, *where: Any, **more: Any) -> None:
    print(f"note: {message}", file=sys.stderr)


def parser() -> argparse.ArgumentParser:
    """The parser with all commands."""
    top = _Parser(
        prog="beltrami", description="Intrinsic computing on triangle meshes and point clouds.",
        epilog="Exit codes: 0 done, 1 not converged (the answer is still written), 2 bad input.",
    )  # fmt: skip
    top.add_argument("--version", action="version", version=f"beltrami {bt.__version__}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in sorted(COMMANDS, key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER)):
        entry = COMMANDS[name]
        one = commands.add_parser(name, help=entry.summary, description=entry.summary[:1].upper() + entry.summary[1:] + ".")
        one.add_argument("--threads", metavar="K", type=int, help="how many threads to use")
        entry.declare(one)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; the exit code."""
    try:
        options = parser().parse_args(arguments)
    except SystemExit as leaving:  # argparse has said why
        return int(leaving.code or 0)
    try:
        if options.threads is not None:
            bt.set_num_threads(arrays.whole(options.threads, "--threads", 1, 4096))
        with warnings.catch_warnings():
            warnings.showwarning = _warning
            return COMMANDS[options.command].run(options)
    except ConvergenceError as error:
        print(f"beltrami {options.command}: not converged: {error}", file=sys.stderr)
        return NOT_CONVERGED
    except Error as error:
        print(f"beltrami {options.command}: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT
    except BrokenPipeError:  # whoever read the table has seen enough
        sys.stderr.close()
        return DONE
    except KeyboardInterrupt:
        print(f"beltrami {options.command}: stopped", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
