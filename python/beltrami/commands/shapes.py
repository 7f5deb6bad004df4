"""Information on shapes, and conversion between formats."""

from __future__ import annotations

import argparse

import beltrami as bt

from ..errors import InputError
from ..progress import Bar
from . import DONE, FILES, Options, command, input_file, read, table


def _info_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="file", help=FILES)


@command("info", "describe shapes: counts, topology, size, data", _info_options)
def info(options: Options) -> int:
    for at, file in enumerate(options.files):
        shape = read(options, file)
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
    input_file(parser)
    parser.add_argument("target", nargs="?", metavar="OUT", help=".ply, .obj, .off, .stl, .xyz, .pts or .csv")
    parser.add_argument("-o", "--out", metavar="OUT", help="the file to write, as with the other commands")
    parser.add_argument("--weld", action="store_true", help="merge vertices at equal positions")
    parser.add_argument("--ascii", action="store_true", help="write text if the format has both text and binary")


@command("convert", "convert a shape to another format", _convert_options)
def convert(options: Options) -> int:
    if (options.target is None) == (options.out is None):
        raise InputError("name one file to write: beltrami convert FILE OUT")
    out = options.target or options.out
    shape = read(options, options.file)
    if options.weld:
        shape = bt.load(shape, weld=True)
    bt.save(shape, out, ascii=options.ascii, progress=Bar("writing"))
    print(f"{shape}\nwrote {out}")
    return DONE
