"""Skeletons."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

import beltrami as bt

from ..progress import Bar
from . import (
    DONE,
    PICTURES,
    Options,
    check_outputs,
    cloud_options,
    command,
    input_file,
    look_options,
    looks_of,
    shape_of,
    table,
    tell_notes,
    values_of,
    write,
)

GRAPHS = (".swc", ".obj", ".npz")


def _skeleton_options(parser: argparse.ArgumentParser) -> None:
    input_file(parser)
    look_options(parser)
    parser.add_argument("-o", "--out", action="append", metavar="OUT", help=".swc (trees), .obj (lines), .npz, .png or .html; repeatable")
    parser.add_argument("--function", help="eigenfunction, eccentricity, geodesic, or a field of the file or a file of numbers")
    parser.add_argument("--source", type=int, help="the vertex that --function geodesic measures from")
    parser.add_argument("--shortest-limb", type=float, default=0.04, help="limbs below this share of the function's length are cut (0.04)")
    parser.add_argument("--remove-outliers", action="store_true", help="clouds: leave out points far from their neighbours")
    parser.add_argument("--one-piece", action="store_true", help="refuse a shape of several connected pieces")
    cloud_options(parser)


@command("skeleton", "a curve along the middle: the Reeb graph of an eigenfunction or of the eccentricity", _skeleton_options)
def skeleton(options: Options) -> int:
    check_outputs(options, (*GRAPHS, *PICTURES), "a skeleton")
    shape, look = shape_of(options), looks_of(options)
    function: Any = options.function
    if function not in (None, "eigenfunction", "eccentricity", "geodesic"):
        function, _ = values_of(function, shape, "--function")
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
    tell_notes(r.notes)
    write(options, lambda path: r.plot(path=path, **look), result=r, saved=GRAPHS)
    return DONE
