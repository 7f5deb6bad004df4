"""Optimal transport and mean-field games."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import beltrami as bt

from .. import arrays
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
    shape_of,
    table,
    unfinished,
    values_of,
    write,
)


def _flow_options(parser: argparse.ArgumentParser) -> None:
    input_file(parser)
    look_options(parser)
    output_files(parser)
    what = "a field of the file; a file of numbers, one per vertex; uniform; or vertex:K[:WIDTH], a bump (WIDTH 0.1, times sqrt(area))"
    parser.add_argument("--from", dest="start", required=True, metavar="DENSITY", help=f"the density at time 0: {what}")
    parser.add_argument("--to", dest="end", metavar="DENSITY", help="the density at time 1")
    parser.add_argument("--intervals", type=int, default=32, help="how many intervals of time (32)")
    parser.add_argument(
        "--method", choices=("primal_dual", "projected_gradient"), default="primal_dual", help="the iteration (primal_dual)"
    )
    parser.add_argument("--tolerance", type=float, default=1e-3, help="relative gap to stop at (1e-3)")
    parser.add_argument("--max-iterations", type=int, default=300, help="where to stop without the gap (300)")
    parser.add_argument("--times", type=int, default=6, help="how many times a picture shows (6); an .html has at least 25")
    cloud_options(parser)


def density_of(name: str, shape: Any, option: str) -> npt.NDArray[np.float64]:
    """The density that an option of the command line names."""
    places = shape.coordinates
    if name == "uniform":
        return np.ones(len(places))
    if name.startswith("vertex:"):
        try:
            vertex, width = (*name.split(":")[1:], "0.1")[:2]
            centre, size = int(vertex), arrays.number(float(width), "the bump's width", above=0)
        except ValueError as error:
            raise InputError(f"{option} {name}: write it like vertex:120 or vertex:120:0.1 ({error})") from None
        arrays.indices([centre], f"{option} {name}", len(places))
        reach = size * np.sqrt(bt.operators(shape).mass.sum())
        distance = bt.geodesic_distance(shape, centre) / reach
        bump: npt.NDArray[np.float64] = np.maximum(1 - distance**2 / 4, 0.0) ** 2
        return bump
    values, _ = values_of(name, shape, option)
    array = np.asarray(one_field(f"{option} {name}", values), np.float64)
    if array.shape != (len(places),):
        raise InputError(f"{option} {name} has shape {array.shape}; one number per vertex is needed, that is ({len(places)},)")
    return array


def _unit_mass(density: npt.NDArray[np.float64], ops: Any) -> npt.NDArray[np.float64]:
    mass = float(ops.mass @ density)
    return density / mass if np.isfinite(mass) and mass > 0 else density


def _write_flow(options: Options, shape: Any, r: Any) -> None:
    values = {"density": np.ascontiguousarray(r.density.T), "potential": np.ascontiguousarray(r.potential.T)}  # a row per vertex

    def picture(path: Path) -> object:
        times = options.times if path.suffix.lower() == ".png" else max(options.times, 25)
        return r.plot(times=times, path=path, **looks_of(options))

    write(options, picture, shape=shape, values=values, result=r)


@command("transport", "optimal transport between two densities (of unit mass), certified", _flow_options)
def transport(options: Options) -> int:
    check_outputs(options)
    looks_of(options)
    if options.end is None:
        raise InputError("--to is missing; name the density at time 1 (only a game can do without)")
    shape = shape_of(options)
    ops = bt.operators(shape, laplacian="cotangent") if isinstance(shape, bt.TriangleMesh) else operators_of(shape)
    ends = [_unit_mass(density_of(name, shape, option), ops) for name, option in ((options.start, "--from"), (options.end, "--to"))]
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
    return DONE if r.converged else unfinished(r)


def _game_options(parser: argparse.ArgumentParser) -> None:
    _flow_options(parser)
    parser.add_argument("--congestion", type=float, metavar="W", help="running cost W/2 ∫ ρ²")
    parser.add_argument("--entropy", type=float, metavar="W", help="running cost W ∫ ρ log ρ - ρ")
    parser.add_argument("--cap", type=float, metavar="C", help="largest density, in units of the mean density")
    parser.add_argument("--potential", metavar="VALUES", help="running cost ∫ V ρ: a field or a file of numbers, one per vertex")
    parser.add_argument("--target", metavar="DENSITY", help="density that the end should be close to, instead of --to")
    parser.add_argument(
        "--target-weight", type=float, default=10.0, metavar="W", help="how close (10): W ∫ ρ log(ρ / target) or W/2 ∫ (ρ - target)²"
    )
    parser.add_argument(
        "--terminal",
        choices=("kullback_leibler", "quadratic"),
        default="kullback_leibler",
        help="how the distance from --target is measured (kullback_leibler)",
    )
    parser.add_argument("--power", type=float, default=2.0, metavar="Q", help="moving costs the speed to this power, from 1.05 to 2 (2)")


@command("game", "a mean-field game: transport with running and terminal costs, certified", _game_options)
def game(options: Options) -> int:
    check_outputs(options)
    looks_of(options)
    if options.end is not None and options.target is not None:
        raise InputError("--to and --target are both given; the end is either fixed or free, so leave one out")
    shape = shape_of(options)
    ops = bt.operators(shape, laplacian="cotangent") if isinstance(shape, bt.TriangleMesh) else operators_of(shape)
    start = _unit_mass(density_of(options.start, shape, "--from"), ops)
    running: list[bt.costs.Cost] = []
    if options.congestion is not None:
        running.append(bt.costs.congestion(options.congestion))
    if options.entropy is not None:
        running.append(bt.costs.entropy(options.entropy))
    if options.potential is not None:
        running.append(bt.costs.potential(density_of(options.potential, shape, "--potential")))
    if options.cap is not None:
        running.append(bt.costs.density_cap(arrays.number(options.cap, "--cap", above=0) / float(ops.mass.sum())))
    terminal = None
    if options.target is not None:
        target = _unit_mass(density_of(options.target, shape, "--target"), ops)
        if options.terminal == "kullback_leibler":
            target = _unit_mass(target + 1e-3 * target.max(), ops)  # it must be positive
        terminal = getattr(bt.costs, options.terminal)(target, weight=options.target_weight)
    total = None
    for cost in running:
        total = cost if total is None else total + cost
    r = bt.mean_field_game(
        ops,
        start,
        None if options.end is None else _unit_mass(density_of(options.end, shape, "--to"), ops),
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
    rows = [("objective", r.objective), ("kinetic cost", r.kinetic), ("running cost", r.running), ("terminal cost", r.terminal)]
    rows += [
        ("proved lower bound", r.lower_bound),
        ("relative gap", r.gap),
        ("exploitability", r.exploitability),
        ("iterations", r.iterations),
    ]
    table([*rows, ("converged", r.converged)])
    _write_flow(options, shape, r)
    return DONE if r.converged else unfinished(r)
