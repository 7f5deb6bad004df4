"""Pictures of shapes, and the gallery."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import beltrami as bt

from ..progress import Bar
from . import DONE, NOT_CONVERGED, Options, command, input_file, look_options, looks_of, read, table, values_of


def _plot_options(parser: argparse.ArgumentParser) -> None:
    input_file(parser)
    look_options(parser)
    parser.add_argument("-o", "--out", action="append", metavar="OUT", required=True, help=".png or .html; may be given several times")
    parser.add_argument(
        "--values", help="a field of the file, or a file of numbers, one per vertex or face (.npy .npz .csv .txt, GIFTI, FreeSurfer)"
    )
    parser.add_argument("--colormap", help="viridis, balance, ... (chosen by the values)")
    parser.add_argument("--contours", type=int, help="how many contour lines")
    parser.add_argument("--limits", type=float, nargs=2, metavar=("LOW", "HIGH"), help="values at the ends of the colour bar")
    parser.add_argument("--transparency", type=float, default=0.0, help="of the surface, from 0 to 1 (0)")
    parser.add_argument("--edges", action="store_true", help="draw the mesh's edges")


@command("plot", "a picture (.png) or an interactive page (.html)", _plot_options)
def plot(options: Options) -> int:
    shape = read(options, options.file)
    values, label = values_of(options.values, shape)
    look = {
        "colormap": options.colormap,
        "contours": options.contours,
        "limits": options.limits,
        "transparency": options.transparency,
        "edges": options.edges,
    }
    for out in options.out:
        print(f"wrote {bt.plot(shape, values, label=label, path=out, progress=Bar('painting'), **look, **looks_of(options)).path}")
    return DONE


def _gallery_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--out", default="gallery", help="the folder to write (gallery)")
    parser.add_argument("--only", action="append", metavar="WORD", help="only sections whose title contains this word")
    parser.add_argument("--list", action="store_true", help="print the titles of the sections and stop")


@command("gallery", "the main results on real shapes, as one page that opens from disk", _gallery_options)
def gallery(options: Options) -> int:
    from ..gallery import run, titles  # this loads every method

    if options.list:
        print("\n".join(titles()))
        return DONE
    outcomes = run(options.out, only=options.only, progress=lambda text: print(text, file=sys.stderr, flush=True))
    table([(outcome.title, round(outcome.seconds, 2), outcome.error or "done") for outcome in outcomes], ("section", "seconds", ""))
    print(f"wrote {Path(options.out) / 'index.html'}")
    return DONE if all(outcome.error is None for outcome in outcomes) else NOT_CONVERGED
