"""Conformal maps to the sphere."""

from __future__ import annotations

import argparse

import numpy as np

import beltrami as bt

from ..progress import Bar
from . import (
    DONE,
    NOT_CONVERGED,
    Options,
    check_outputs,
    cloud_options,
    command,
    input_file,
    look_options,
    looks_of,
    output_files,
    shape_of,
    table,
    tell_notes,
    write,
)


def _sphere_options(parser: argparse.ArgumentParser) -> None:
    input_file(parser)
    look_options(parser)
    output_files(parser)
    parser.add_argument("--method", choices=("fast", "cayley", "preconditioned_cayley"), default="fast", help="the iteration (fast)")
    parser.add_argument("--fill-holes", action="store_true", help="close the holes of a mesh for the map")
    parser.add_argument("--no-check-genus", action="store_true", help="map a cloud even if it does not look like a sphere")
    parser.add_argument(
        "--show",
        choices=("checkerboard", "angle_error", "conformal_factor"),
        default="checkerboard",
        help="what colours the picture (checkerboard)",
    )
    parser.add_argument("--on", choices=("shape", "sphere"), default="shape", help="which of the two is drawn (shape)")
    cloud_options(parser)


@command("sphere", "the conformal map of a surface of genus 0 to the unit sphere", _sphere_options)
def sphere(options: Options) -> int:
    check_outputs(options)
    shape, look = shape_of(options), looks_of(options)
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
    tell_notes(found.notes)
    values = {"positions": found.positions, "conformal_factor": found.conformal_factor}
    write(options, lambda path: found.plot(options.show, on=options.on, path=path, **look), shape=shape, values=values, result=found)
    return DONE if found.converged else NOT_CONVERGED
