"""How cost grows with size: a binary PLY loaded, operators, one Poisson equation, 10k to 10M vertices.

    python benches/scale.py [largest] [--plot docs/images/scale.png]

Each size runs in a process of its own, which tells its greatest memory. Times are of the wall clock.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SIZES = [10_000, 100_000, 1_000_000, 10_000_000]


def one(size: int, method: str) -> None:
    import beltrami as bt
    import numpy as np

    side = round(size**0.5)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "torus.ply"
        bt.save(bt.shapes.torus(rows=side, columns=side), path)
        start = time.perf_counter()
        mesh = bt.load(path)
        loaded = time.perf_counter()
    ops = bt.operators(mesh, laplacian="cotangent")
    stiffness, mass = ops.stiffness, ops.mass
    built = time.perf_counter()
    f = mesh.vertices[:, 2]
    u = bt.PoissonSolver(ops, method=method).solve(f)
    solved = time.perf_counter()
    right = mass * (f - mass @ f / mass.sum())
    residual = float(np.linalg.norm(stiffness @ u - right) / np.linalg.norm(right))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    row = {"vertices": len(mass), "load": loaded - start, "operators": built - loaded, "poisson": solved - built}
    print(json.dumps({**row, "method": method, "residual": residual, "GiB": memory}))


def plot(rows: list[dict[str, float]], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4))
    for what, method, label in (
        ("load", "multilevel", "load binary PLY"),
        ("operators", "multilevel", "stiffness and mass"),
        ("poisson", "direct", "Poisson, Cholesky"),
        ("poisson", "multilevel", "Poisson, multigrid"),
    ):
        chosen = [row for row in rows if row["method"] == method]
        axes.loglog([row["vertices"] for row in chosen], [row[what] for row in chosen], "o-", label=label)
    axes.set(xlabel="vertices", ylabel="seconds")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110, bbox_inches="tight")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("largest", type=int, nargs="?", default=SIZES[-1])
    parser.add_argument("--plot")
    parser.add_argument("--one", nargs=2)
    options = parser.parse_args()
    if options.one:
        one(int(options.one[0]), options.one[1])
        return
    rows = []
    print(f"{'vertices':>10} {'method':>11} {'load':>8} {'operators':>10} {'Poisson':>8} {'residual':>9} {'GiB':>6}")
    for size in (size for size in SIZES if size <= options.largest):
        for method in ("multilevel", "direct"):
            if method == "direct" and size > 3_000_000:
                continue  # the factor alone takes over 10 GiB
            told = subprocess.run([sys.executable, __file__, "--one", str(size), method], capture_output=True, text=True, check=True)
            row = json.loads(told.stdout)
            rows.append(row)
            print(
                f"{row['vertices']:>10} {method:>11} {row['load']:8.3f} {row['operators']:10.3f} {row['poisson']:8.2f} "
                f"{row['residual']:9.1e} {row['GiB']:6.2f}"
            )
    if options.plot:
        plot(rows, options.plot)


if __name__ == "__main__":
    main()
