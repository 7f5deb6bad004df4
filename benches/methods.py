"""How the cost of every method grows with size: processor time and greatest memory, 1,000 to 1,000,000 vertices.

    python benches/methods.py [--sizes 1000 10000] [--only transport skeleton] [--seconds 300] [--memory 16]
    python benches/methods.py --missing --seconds 900                      # what has no row yet: also how a run that was stopped goes on
    python benches/methods.py --page [--plot docs/images/methods.png]      # the table and the plot of what has been measured

From a shape to its answer, operators and all; options are the default ones. Each run has a process of its own that may take so many
seconds and GiB, and tells its processor time (user and system, all threads: what a busy machine disturbs least) and its greatest memory.
A method that ran out of one of them at some size is not tried at larger ones. Rows go to benches/METHODS.csv, those of the same method
and size in place of older ones.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import beltrami as bt
import numpy as np

SIZES = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
TABLE = Path(__file__).with_name("METHODS.csv")
HEADER = ("method", "vertices", "seconds", "wall", "GiB", "outcome")


class Case:
    """A bumpy ellipsoid of about ``size`` vertices without symmetries, its vertices as a cloud, and functions on it."""

    def __init__(self, size: int) -> None:
        sphere = bt.shapes.sphere(frequency=max(round((size / 10) ** 0.5), 1))
        x, y, z = sphere.vertices.T
        bumps = 1 + 0.15 * np.sin(3 * x + 1) * np.cos(4 * y) + 0.2 * np.exp(-6 * (x - 1) ** 2) + 0.1 * np.sin(5 * z) * x
        self.mesh = bt.TriangleMesh(sphere.vertices * bumps[:, None] * [1.3, 1.0, 0.7], sphere.faces)
        self.points = self.mesh.vertices
        self.cloud = bt.PointCloud(self.points)
        self.size = len(self.points)
        self.image = (np.sin(4 * x) * np.cos(3 * y) > 0.1) + 0.3 * np.random.default_rng(0).standard_normal(self.size)
        self.smooth = x * y + z
        self.wells = (x**2 - 0.5) ** 2 * 4 + y**2
        self.densities = [np.exp(4 * one) for one in (x, y, z)]
        self.moved = self.points * [1.0, 0.9, 1.1] + 0.01
        angle = 0.4 * self.points[:, 2]  # a twist: near an isometry
        turned = np.c_[np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z]
        self.twisted = bt.TriangleMesh(0.2 * turned + 0.8 * self.points, sphere.faces)
        self.left, self.right = np.flatnonzero(x < -0.9), np.flatnonzero(x > 0.9)
        self.spread = np.linspace(0, self.size - 1, 4).astype(int)


def reading(case: Case) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        bt.save(case.mesh, Path(folder) / "mesh.ply")
        return bt.load(Path(folder) / "mesh.ply")


def maps(case: Case) -> Any:
    source, target = (bt.eigenpairs(shape, 30) for shape in (case.mesh, case.twisted))
    matrix = bt.functional_map_of(np.arange(case.size), source, target, k=30)
    return bt.point_map_of(matrix, source, target)


METHODS: dict[str, Callable[[Case], Any]] = {
    "save and load": reading,
    "report": lambda c: c.mesh.report(),
    "operators": lambda c: bt.operators(c.mesh),
    "operators, intrinsic Delaunay": lambda c: bt.operators(c.mesh, laplacian="intrinsic_delaunay"),
    "operators, tufted": lambda c: bt.operators(c.mesh, laplacian="tufted"),
    "operators, local mesh": lambda c: bt.operators(c.cloud),
    "operators, moving least squares": lambda c: bt.operators(c.cloud, laplacian="mls"),
    "Cholesky": lambda c: bt.Cholesky(bt.operators(c.mesh).stiffness + bt.operators(c.mesh).galerkin_mass).solve(c.smooth),
    "solve_poisson": lambda c: bt.solve_poisson(c.mesh, c.smooth),
    "solve_poisson, cloud": lambda c: bt.solve_poisson(c.cloud, c.smooth),
    "eigenpairs": lambda c: bt.eigenpairs(c.mesh, 20),
    "eigenpairs, cloud": lambda c: bt.eigenpairs(c.cloud, 20),
    "conformal_eigenpairs": lambda c: bt.conformal_eigenpairs(c.mesh, 0.2 * c.smooth, 20),
    "geodesic_distance": lambda c: bt.geodesic_distance(c.mesh, 0),
    "geodesic_distance, cloud": lambda c: bt.geodesic_distance(c.cloud, 0),
    "hks": lambda c: bt.hks(c.mesh),
    "wks": lambda c: bt.wks(c.mesh),
    "shape_dna": lambda c: bt.shape_dna(c.mesh),
    "closest_points": lambda c: bt.closest_points(c.mesh, c.moved),
    "nearest_neighbors": lambda c: bt.nearest_neighbors(c.points, c.points, 16),
    "neighbors_within": lambda c: bt.neighbors_within(c.points, c.points, 4 * (4 / c.size) ** 0.5),
    "normals": lambda c: bt.normals(c.points),
    "intersect_rays": lambda c: bt.intersect_rays(c.mesh, c.moved, -c.points),
    "farthest_points": lambda c: bt.farthest_points(c.points, 1000 if c.size > 1000 else c.size),
    "poisson_disc": lambda c: bt.poisson_disc(c.points, 0.05),
    "contours": lambda c: bt.contours(c.mesh, c.smooth),
    "segment": lambda c: bt.segment(c.mesh, c.image, fidelity=30.0),
    "segment, cloud": lambda c: bt.segment(c.cloud, c.image, fidelity=30.0),
    "segment, three regions": lambda c: bt.segment(c.mesh, c.image, fidelity=30.0, regions=3),
    "segment_path": lambda c: bt.segment_path(c.mesh, c.image),
    "denoise": lambda c: bt.denoise(c.mesh, c.image),
    "transport": lambda c: bt.transport(c.mesh, *c.densities[:2], normalize=True),
    "transport, cloud": lambda c: bt.transport(c.cloud, *c.densities[:2], normalize=True),
    "mean_field_game": lambda c: bt.mean_field_game(
        c.mesh, c.densities[0], running_cost=bt.costs.congestion(1.0), terminal_cost=bt.costs.potential(c.smooth), normalize=True
    ),
    "wasserstein_barycenter": lambda c: bt.wasserstein_barycenter(c.mesh, c.densities, normalize=True),
    "spherical_map": lambda c: bt.spherical_map(c.mesh),
    "spherical_map, Cayley": lambda c: bt.spherical_map(c.mesh, method="cayley"),
    "skeleton": lambda c: bt.skeleton(c.mesh),
    "skeleton, cloud": lambda c: bt.skeleton(c.cloud),
    "sliced_wasserstein": lambda c: bt.sliced_wasserstein(c.points, c.moved),
    "rotation_invariant_sliced_wasserstein": lambda c: bt.rotation_invariant_sliced_wasserstein(c.points, c.moved),
    "register": lambda c: bt.register(c.mesh, c.twisted),
    "register, cloud": lambda c: bt.register(c.cloud, bt.PointCloud(c.twisted.vertices)),
    "register, rswd": lambda c: bt.register(c.mesh, c.twisted, method="rswd"),
    "register_conformal": lambda c: bt.register_conformal(c.mesh, c.twisted, landmarks=np.c_[c.spread, c.spread]),
    "match_spectrum": lambda c: bt.match_spectrum(c.mesh, bt.eigenpairs(c.twisted, 10).values),
    "functional_map_of and back": maps,
    "evaluate_map": lambda c: bt.evaluate_map(np.arange(c.size), c.mesh, c.twisted, truth=np.arange(c.size), points=200),
    "transfer": lambda c: bt.transfer(np.arange(c.size), c.smooth, direction="to_target", target=c.twisted),
    "committor": lambda c: bt.committor(c.mesh, c.wells, c.left, c.right, beta=3.0),
    "committor, cloud": lambda c: bt.committor(c.cloud, c.wells, c.left, c.right, beta=3.0),
    "committor, strong": lambda c: bt.committor(c.cloud, c.wells, c.left, c.right, beta=3.0, method="strong"),
    "sample_density": lambda c: bt.sample_density(c.cloud),
    "distance_matrix": lambda c: bt.distance_matrix([c.mesh, c.twisted]),
    "plot": lambda c: bt.plot(c.mesh, c.smooth),
}


def processor() -> float:
    """Seconds of the processor so far, in all threads."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def one(name: str, size: int, seconds: float, memory: float) -> dict[str, Any]:
    """A run, in this process, which is ended by what it may take."""
    resource.setrlimit(resource.RLIMIT_AS, (int(memory * 2**30),) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 1))
    with contextlib.suppress(bt.Error):  # too small for it
        METHODS[name](Case(320))  # imports what it needs
    case = Case(size)
    began, clock = processor(), time.perf_counter()
    try:
        METHODS[name](case)
        outcome = "answer"
    except Exception as error:
        outcome = f"{type(error).__name__}: {error}"
    seconds, wall = processor() - began, time.perf_counter() - clock
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return {"method": name, "vertices": case.size, "seconds": seconds, "wall": wall, "GiB": most, "outcome": outcome}


def measure(name: str, size: int, seconds: float, memory: float) -> dict[str, Any]:
    """A run in a process of its own."""
    command = [sys.executable, __file__, "--one", name, str(size), "--seconds", str(seconds), "--memory", str(memory)]
    lost = {"method": name, "vertices": size, "seconds": "", "wall": "", "GiB": ""}
    told = subprocess.run(command, capture_output=True, text=True, env={"OPENBLAS_NUM_THREADS": "1", **os.environ}, check=False)
    if told.returncode == -signal.SIGXCPU:
        return {**lost, "outcome": f"more than {seconds:g} s"}
    if told.returncode:
        last = (told.stderr.strip().splitlines() or [""])[-1]
        return {**lost, "outcome": f"ended by signal {-told.returncode}: {last}"}
    found: dict[str, Any] = json.loads(told.stdout.splitlines()[-1])
    return found | {key: f"{found[key]:.3g}" for key in ("seconds", "wall", "GiB")}


def recorded() -> dict[tuple[str, int], dict[str, str]]:
    if not TABLE.exists():
        return {}
    with TABLE.open(newline="") as file:
        return {(row["method"], int(row["vertices"])): row for row in csv.DictReader(file)}


def record(row: dict[str, Any]) -> None:
    order = list(METHODS)
    rows = {**recorded(), (row["method"], int(row["vertices"])): row}
    with TABLE.open("w", newline="") as file:
        writer = csv.DictWriter(file, HEADER, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows[key] for key in sorted(rows, key=lambda key: (order.index(key[0]), key[1])) if key[0] in METHODS)


GROUPS = {  # of the plot, by the first of each
    "Shapes and operators": "save and load",
    "Equations": "Cholesky",
    "Neighbours": "closest_points",
    "Images on surfaces": "contours",
    "Maps, skeletons, transport": "transport",
    "Registration, committors": "sliced_wasserstein",
}


def answers(name: str, rows: dict[tuple[str, int], dict[str, str]]) -> list[tuple[int, float]]:
    """Vertices and seconds of the runs that came to an answer."""
    return [(size, float(row["seconds"])) for (method, size), row in rows.items() if method == name and row["outcome"] == "answer"]


def exponent(points: list[tuple[int, float]]) -> float | None:
    """The slope of log seconds in log vertices, from 10,000 vertices on."""
    large = np.log([point for point in points if point[0] >= 10_000])
    return float(np.polyfit(*large.T, 1)[0]) if len(large) > 1 else None


def page(rows: dict[tuple[str, int], dict[str, str]]) -> str:
    """A table: seconds of the processor by size, the exponent, and memory at the largest size."""
    shown = (1_000, 10_000, 100_000, 1_000_000)
    lines = ["| Method | " + " | ".join(f"{size:,}" for size in shown) + " | Exponent | Memory at the largest size, GiB |"]
    lines.append("|---|" + "---|" * (len(shown) + 2))
    notes = []
    for name in METHODS:
        points = answers(name, rows)
        cells, memory = [], ""
        for size in shown:
            near = [row for (method, at), row in rows.items() if method == name and 0.9 < at / size < 1.1]
            best = min(near, key=lambda row: row["outcome"] != "answer", default=None)
            if best is None:
                cells.append("")
            elif best["outcome"] == "answer":
                seconds = float(best["seconds"])
                cells.append(f"{seconds:.0f}" if seconds >= 100 else f"{seconds:.2g}")
                memory = best["GiB"]
            elif best["outcome"].startswith("more than"):
                cells.append("> " + best["outcome"].split()[2])
            else:
                cells.append("refused")
                notes.append(f"- {name}: {best['outcome']}")
        slope = exponent(points)
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {'' if slope is None else f'{slope:.2f}'} | {memory} |")
    return "\n".join([*lines, "", *notes])


def plot(rows: dict[tuple[str, int], dict[str, str]], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list(METHODS)
    starts = [names.index(first) for first in GROUPS.values()]
    figure, axes = pyplot.subplots(3, 2, figsize=(11, 15), sharex=True, sharey=True, layout="constrained")
    for axis, title, start, end in zip(axes.flat, GROUPS, starts, [*starts[1:], len(names)], strict=True):
        for at, name in enumerate(names[start:end]):
            points = sorted(answers(name, rows))
            slope = exponent(points)
            if slope is not None:
                look = {"marker": "os^vD<>"[at % 7], "color": f"C{at % 10}", "ls": ("-", "--")[at // 10], "ms": 5, "lw": 1.5}
                axis.loglog(*zip(*points, strict=True), **look, label=f"{name}  {slope:.2f}")
        axis.set_title(title)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7.8, loc="upper left", ncols=2, columnspacing=0.6, handlelength=1.4, framealpha=0.9)
        axis.set_ylim(1e-4, 1e6)
    for axis in axes[-1]:
        axis.set_xlabel("vertices")
    for axis in axes[:, 0]:
        axis.set_ylabel("CPU seconds")
    figure.suptitle("Every method, with the exponent of its cost")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="*", default=SIZES)
    parser.add_argument("--only", nargs="*", choices=METHODS, default=list(METHODS))
    parser.add_argument("--seconds", type=float, default=300.0, help="the most of the processor that a run may take")
    parser.add_argument("--memory", type=float, default=16.0, help="the most memory that it may ask for, in GiB")
    parser.add_argument("--missing", action="store_true", help="leave out what has a row, or ended for want of time or memory when smaller")
    parser.add_argument("--page", action="store_true", help="print the table of what has been measured, and do nothing else")
    parser.add_argument("--plot", help="the picture that goes with --page")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(one(options.one[0], int(options.one[1]), options.seconds, options.memory)))
        return
    if options.page:
        print(page(recorded()))
        if options.plot:
            plot(recorded(), options.plot)
        return
    had = recorded() if options.missing else {}
    for name in options.only:
        for size in sorted(options.sizes):
            there = [row for (method, at), row in had.items() if method == name and 0.9 < at / size < 1.1]
            if any(row["seconds"] for row in there):  # an answer, or a refusal
                continue
            if any(
                not row["seconds"] and float(row["outcome"].split()[2]) >= options.seconds for row in there if "more than" in row["outcome"]
            ):
                break
            row = measure(name, size, options.seconds, options.memory)
            record(row)
            print(f"{name:38}{row['vertices']:>9}{row['seconds']:>9}{row['wall']:>9}{row['GiB']:>7}  {row['outcome'][:160]}", flush=True)
            if not row["seconds"]:
                break


if __name__ == "__main__":
    main()
