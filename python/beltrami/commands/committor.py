"""Committors."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import beltrami as bt

from ..errors import Error, FileError, InputError
from ..files import stored
from ..progress import Bar
from . import DONE, Options, check_outputs, cloud_options, command, look_options, looks_of, operators_of, output_files, read, table, write


def _committor_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", help="points (n, D): an .npz with points, potential, A, B, weights; a .csv with such columns; an .npy; or a shape"
    )
    look_options(parser)
    output_files(parser)
    parser.add_argument("--beta", type=float, required=True, help="inverse temperature")
    parser.add_argument(
        "--potential", default="potential", help="the array, column or field with the potential, or a file of its own (potential)"
    )
    parser.add_argument(
        "--A", default="A", help="an array, column, field or file that is nonzero in A or lists its points; or ball:x,y,...,radius (A)"
    )
    parser.add_argument("--B", default="B", help="the same for B (B)")
    parser.add_argument(
        "--sampling",
        choices=("any", "gibbs", "weighted"),
        default="any",
        help="what is known: the potential, or samples (any: the potential)",
    )
    parser.add_argument("--sample-beta", type=float, help="inverse temperature of the samples (--sampling gibbs)")
    parser.add_argument(
        "--method",
        choices=("weak", "strong"),
        default="weak",
        help="weak form on the local mesh, or strong form by moving least squares (weak)",
    )
    parser.add_argument("--refine", type=int, help="how many times triangles are split in four (1)")
    parser.add_argument("--bootstrap", type=int, default=0, help="how many half-samples estimate the error of the rate (0)")
    parser.add_argument(
        "--block", type=int, default=1, help="how many successive points are drawn together: the correlation time of a trajectory (1)"
    )
    parser.add_argument("--lines", type=int, default=12, help="how many streamlines of the reactive current a picture shows (12)")
    cloud_options(parser)


def _samples(options: Options) -> tuple[Any, dict[str, npt.NDArray[Any]]]:
    """A shape, and the named arrays that came with it."""
    path = Path(options.file)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return bt.PointCloud(bt.load_values(path), dimension=options.dimension), {}
    if suffix not in (".npz", ".csv"):
        shape = read(options, options.file)
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


def _values(spec: str, name: str, fields: Mapping[str, npt.NDArray[Any]], missing: str = "no such array or file") -> npt.NDArray[Any]:
    """An array that came with the points, or that is a file of its own."""
    if spec in fields:
        return np.asarray(fields[spec])
    if Path(spec).is_file():
        return bt.load_values(spec)
    raise InputError(f"--{name} {spec}: {missing}; the points came with {', '.join(fields) or 'none'}")


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
    values = _values(spec, name, fields, "no such array or file, and no ball:...")
    if values.dtype.kind == "f" and np.isfinite(values).all() and (values == np.floor(values)).all():
        values = values.astype(np.int64)  # numbers of points, from text
    return values != 0 if len(values) == count and values.dtype.kind != "b" and np.isin(values, (0, 1)).all() else values


@command("committor", "the probability of reaching B before A, and reaction rates from A to B", _committor_options)
def committor(options: Options) -> int:
    check_outputs(options)
    shape, fields = _samples(options)
    if options.deduplicate:
        raise InputError("--deduplicate would leave the arrays behind; take copies out of the file")
    points, look = shape.coordinates, looks_of(options)
    potential = _values(options.potential, "potential", fields) if options.sampling == "any" else None
    r = bt.committor(
        operators_of(shape), potential, _set(options.A, "A", fields, len(points)), _set(options.B, "B", fields, len(points)),
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
    lines = options.lines if shape.intrinsic_dimension == 2 else 0
    write(options, lambda path: r.plot(path=path, streamlines=lines, **look), shape=shape, values=r.table(), result=r)
    return DONE
