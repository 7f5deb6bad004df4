"""Segmentation and denoising of images on surfaces."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import numpy.typing as npt

import beltrami as bt

from ..errors import InputError
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
    one_field,
    operators_of,
    output_files,
    painted,
    shape_of,
    table,
    tell_notes,
    unfinished,
    values_of,
    write,
)


def _image_options(parser: argparse.ArgumentParser) -> None:
    input_file(parser)
    look_options(parser)
    output_files(parser)
    parser.add_argument(
        "--values", help="the image: a field of the file, or a file of numbers (see plot), one value or row per vertex (its colours)"
    )
    weight = (
        "weight of the image against length (segment: 7.5 over its variance, more until no region is empty; denoise: 100 over its range)"
    )
    parser.add_argument("--fidelity", type=float, help=weight)
    parser.add_argument(
        "--tv",
        choices=("isotropic", "edge"),
        default="isotropic",
        help="total variation on triangles, or along edges as in graph cuts (isotropic)",
    )
    parser.add_argument("--tolerance", type=float, help="relative gap to stop at (1e-4)")
    parser.add_argument("--max-iterations", type=int, default=2000, help="where to stop without the gap (2000)")
    cloud_options(parser)


def _image(options: Options, shape: Any) -> npt.NDArray[np.float64]:
    values, _ = values_of(options.values, shape)
    if values is None:
        raise InputError(f"{options.file} has no colours; name the image with --values (it has {', '.join(shape.data) or 'no data'})")
    array = np.asarray(one_field(f"--values {options.values}", values))
    image: npt.NDArray[np.float64] = array / 255.0 if array.dtype == np.uint8 else np.asarray(array, np.float64)
    return image[:, :3] if image.ndim == 2 and image.shape[1] == 4 and options.values is None else image  # no alpha


def _segment_options(parser: argparse.ArgumentParser) -> None:
    _image_options(parser)
    parser.add_argument("--regions", type=int, default=2, help="how many regions (2)")


@command("segment", "segment an image on a surface into regions with short boundaries, certified", _segment_options)
def segment(options: Options) -> int:
    check_outputs(options)
    shape, look = shape_of(options), looks_of(options)
    image = _image(options, shape)
    spread = float(np.var(image.reshape(len(image), -1), axis=0).sum())
    fidelity = options.fidelity if options.fidelity is not None else 30.0 / (4 * spread) if spread > 0 else 1.0
    operators = operators_of(shape)
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
    tell_notes(r.notes)
    picture = painted(shape, {"region": r.labels}, lines=r.contours or None, **look)
    write(options, picture, shape=shape, values={"labels": r.labels, "phi": r.phi}, result=r)
    return DONE if r.converged else unfinished(r)


@command("denoise", "denoise an image on a surface by total variation, colours too, certified", _image_options)
def denoise(options: Options) -> int:
    check_outputs(options)
    shape, look = shape_of(options), looks_of(options)
    image = _image(options, shape)
    reach = float(np.ptp(image)) if image.size else 0.0
    u = bt.denoise(
        operators_of(shape),
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
    write(options, painted(shape, pictures, **look), shape=shape, values={"image": u.image}, result=u)
    return DONE if u.converged else unfinished(u)
