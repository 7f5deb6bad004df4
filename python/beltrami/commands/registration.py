"""Maps between shapes, and distances within a collection."""

from __future__ import annotations

import argparse
import concurrent.futures
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import beltrami as bt

from .. import arrays
from ..errors import Error, FileError, InputError
from ..progress import Bar
from . import (
    DONE,
    FILES,
    NOT_CONVERGED,
    Options,
    check_outputs,
    cloud_options,
    command,
    look_options,
    looks_of,
    only_array,
    output_files,
    painted,
    read,
    shape_of,
    table,
    tell_notes,
    write,
)


def _pair_options(parser: argparse.ArgumentParser, view: str) -> None:
    """What all maps between two shapes have: the shapes, landmarks, and where the answer goes."""
    parser.add_argument("source", help=FILES)
    parser.add_argument("file", metavar="target", help="the shape it is matched to")
    look_options(parser, view)
    output_files(parser)
    parser.add_argument("--landmarks", metavar="FILE", help="pairs of vertex numbers, source and target: lines of .csv or .txt, or .npy")
    cloud_options(parser)


def _register_options(parser: argparse.ArgumentParser) -> None:
    _pair_options(parser, "front")
    parser.add_argument(
        "--method", choices=("auto", "rswd"), default="auto", help="rswd: the sliced Wasserstein iteration between eigenmaps alone (auto)"
    )
    parser.add_argument("--intrinsic", action="store_true", help="use only what bending does not change: neither positions nor curvature")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random directions (0)")


@command("register", "the point map between two nearly isometric shapes", _register_options)
def register(options: Options) -> int:
    check_outputs(options)
    look = looks_of(options)
    target = shape_of(options)
    source = shape_of(options, options.source)
    found = bt.register(
        source,
        target,
        method=options.method,
        landmarks=vertex_pairs(options.landmarks),
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
    tell_notes(found.notes)
    on_source: dict[str, npt.NDArray[Any]] = {"point_map": found.point_map}
    if found.positions is not None:
        on_source["deformed"] = found.positions
    write(options, lambda path: found.plot(path=path, **look), shape=source, values=on_source, result=found, saved=(".npz", ".csv"))
    return DONE


def _register_conformal_options(parser: argparse.ArgumentParser) -> None:
    _pair_options(parser, "three-quarter")
    parser.add_argument("-k", type=int, default=20, help="size of the bases (20)")
    parser.add_argument("--refine", type=int, default=100, help="size of the basis to which the map is refined; 0: no refinement (100)")
    parser.add_argument(
        "--start", choices=("auto", "spherical", "landmarks", "register"), default="auto", help="where the first map comes from (auto)"
    )
    parser.add_argument(
        "--orientation", choices=("preserving", "reversing", "any"), default="preserving", help="reversing: for mirror images (preserving)"
    )


@command("register-conformal", "the map between two shapes far from isometric, with its conformal factor", _register_conformal_options)
def register_conformal(options: Options) -> int:
    check_outputs(options)
    look = looks_of(options)
    target = shape_of(options)
    source = shape_of(options, options.source)
    found = bt.register_conformal(
        source,
        target,
        landmarks=vertex_pairs(options.landmarks),
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
    tell_notes(found.notes)
    on_target = {"log_factor": found.log_factor, "inverse_map": found.inverse_map, "basis": found.basis}
    write(options, painted(target, {"log w²": found.log_factor}, **look), shape=target, values=on_target, result=found)
    return DONE if found.converged else NOT_CONVERGED


def vertex_pairs(name: str | None) -> npt.NDArray[np.int64] | None:
    """Rows of two vertex numbers from a file."""
    if name is None:
        return None
    path = Path(name)
    try:
        if path.suffix.lower() == ".npy":
            return only_array(path)
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


def _distances_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="file", help="shapes; one that cannot be read is reported, and the others go on")
    parser.add_argument("-o", "--out", action="append", metavar="OUT", help="the matrix (.npz, .csv), a picture (.png)")
    parser.add_argument(
        "--method",
        choices=("rswd", "shape_dna"),
        default="rswd",
        help="sliced Wasserstein of the eigenmaps, or a comparison of eigenvalues (rswd)",
    )
    parser.add_argument("--processes", type=int, default=0, help="worker processes (0: none)")
    parser.add_argument("--checkpoint", metavar="FOLDER", help="where finished pairs are kept; the same command resumes from there")
    parser.add_argument("--picture", choices=("map", "matrix", "dendrogram", "nearest"), default="map", help="what a .png shows (map)")


@command("distances", "the distances between all pairs of shapes, as a matrix, a map or a tree", _distances_options)
def distances(options: Options) -> int:
    check_outputs(options, (".npz", ".csv", ".png"), "distances")
    if len(options.files) < 2:
        raise InputError(f"{options.files[0]} is the only shape; distances are between shapes: give two files or more")
    workers = arrays.whole(options.processes, "--processes", 0, 4096)
    executor = concurrent.futures.ProcessPoolExecutor(workers) if workers else None
    try:
        shapes = [read(options, file) if file.startswith("example:") else file for file in options.files]
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
    write(options, lambda path: found.plot(options.picture, path=path), result=found, saved=(".npz", ".csv"))
    return NOT_CONVERGED if found.failures else DONE
