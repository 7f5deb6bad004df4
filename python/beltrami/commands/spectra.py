"""Eigenfunctions of the Laplacian, and distances along a surface."""

from __future__ import annotations

import argparse

import numpy as np

import beltrami as bt

from .. import arrays
from ..progress import Bar
from . import (
    DONE,
    Options,
    check_outputs,
    cloud_options,
    command,
    input_file,
    look_options,
    looks_of,
    operators_of,
    output_files,
    painted,
    shape_of,
    table,
    write,
)


def _eigen_options(parser: argparse.ArgumentParser) -> None:
    input_file(parser)
    look_options(parser)
    output_files(parser)
    parser.add_argument("-k", type=int, default=20, help="how many pairs, from the smallest (20)")
    cloud_options(parser)


@command("eigen", "eigenvalues and eigenfunctions of the Laplacian", _eigen_options)
def eigen(options: Options) -> int:
    check_outputs(options)
    shape, look = shape_of(options), looks_of(options)
    pairs = bt.eigenpairs(operators_of(shape), arrays.whole(options.k, "-k", 1), progress=Bar("eigenpairs"))
    table(list(zip(range(len(pairs.values)), pairs.values, pairs.residuals, strict=True)), ("", "eigenvalue", "residual"))
    first = 1 if len(pairs.values) > 1 else 0
    shown = {f"mode {at}, λ = {pairs.values[at] + 0.0:.4g}": pairs.functions[:, at] for at in range(first, min(len(pairs.values), 13))}
    picture = painted(shape, shown, contours=[0.0], **look)
    write(options, picture, shape=shape, values={"functions": pairs.functions}, result=pairs)
    return DONE


def _geodesic_options(parser: argparse.ArgumentParser) -> None:
    input_file(parser)
    look_options(parser)
    output_files(parser)
    parser.add_argument("--source", type=int, action="append", help="a vertex at distance 0 (0); may be given several times")
    parser.add_argument("--contours", type=int, default=20, help="contour lines in pictures (20)")
    cloud_options(parser)


@command("geodesic", "distances along the surface from one or many vertices", _geodesic_options)
def geodesic(options: Options) -> int:
    check_outputs(options)
    shape, look = shape_of(options), looks_of(options)
    sources = options.source or [0]
    distance = bt.geodesic_distance(operators_of(shape), sources, progress=Bar("distances"))
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
    values = {"distance": distance}
    write(options, painted(shape, values, contours=options.contours or None, points=sources, **look), shape=shape, values=values)
    return DONE
