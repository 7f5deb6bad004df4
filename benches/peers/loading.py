"""Loading and saving beside trimesh and meshio: the same surface, each format, best of some runs, in this process.

    python benches/peers/loading.py [--vertices 1000000] [--runs 3]

Seconds of wall clock; the ratio is the fastest peer's over ours.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import beltrami as bt
import meshio
import numpy as np
import trimesh


def best(work: Callable[[], Any], runs: int) -> float:
    """Least time of some runs; NaN where the peer cannot do it."""
    least = np.inf
    for _ in range(runs):
        start = time.perf_counter()
        try:
            work()
        except Exception:
            return np.nan
        least = min(least, time.perf_counter() - start)
    return least


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vertices", type=int, default=250_000)
    parser.add_argument("--runs", type=int, default=3)
    chosen = parser.parse_args()
    side = max(2, round(chosen.vertices**0.5))
    flat = bt.shapes.grid(rows=side, columns=side)
    height = np.sin(7 * flat.vertices[:, :1]) * np.cos(5 * flat.vertices[:, 1:2])
    mesh = bt.TriangleMesh(np.hstack([flat.vertices[:, :2], height]), flat.faces)
    theirs = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    plain = meshio.Mesh(mesh.vertices, [("triangle", mesh.faces)])
    print(f"{len(mesh.vertices)} vertices, {len(mesh.faces)} triangles; seconds, best of {chosen.runs}")
    print(f"{'':<22}{'MB':>6}{'beltrami':>10}{'trimesh':>10}{'meshio':>10}{'ratio':>8}")
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, ascii in (("binary.ply", False), ("ascii.ply", True), ("a.obj", True), ("a.off", True), ("binary.stl", False)):
            path = Path(folder) / name
            binary = {"binary": not ascii} if path.suffix in (".ply", ".stl") else {}
            peer_path = str(path.with_stem("peer"))
            saving = [
                lambda path=path, ascii=ascii: bt.save(mesh, path, ascii=ascii),
                lambda path=peer_path, name=name: theirs.export(path, **({"encoding": "ascii"} if name == "ascii.ply" else {})),
                lambda path=peer_path, binary=binary: meshio.write(path, plain, **binary),
            ]
            loading = [
                lambda path=path: bt.load(path, weld=False),
                lambda path=path: trimesh.load(path, process=False, maintain_order=True),
                lambda path=path: meshio.read(path),
            ]
            for label, works in (("save", saving), ("load", loading)):
                times = [best(work, chosen.runs) for work in works]
                size = path.stat().st_size / 1e6
                ratio = np.nanmin(times[1:]) / times[0]
                columns = "".join(f"{seconds:>10.3f}" for seconds in times)
                print(f"{label + ' ' + name:<22}{size:>6.0f}{columns}{ratio:>8.1f}", flush=True)


if __name__ == "__main__":
    main()
