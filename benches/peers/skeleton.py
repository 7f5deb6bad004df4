"""Skeletons beside pygel3d's and skeletor's (pip install pygel3d skeletor), in turn in one run: loops and leaves found, and seconds.

    python benches/peers/skeleton.py [FILE ...] [--rounds 2]

Without files: a torus, a figure eight, a star and Spot. The right number of loops is the genus.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import beltrami as bt
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

try:
    from pygel3d import graph as gel_graph
    from pygel3d import hmesh
except (ImportError, OSError):
    gel_graph = hmesh = None
try:
    import skeletor
    import trimesh
except ImportError:
    skeletor = None


def counted(nodes: int, edges: np.ndarray) -> tuple[int, int]:
    """Independent loops and leaves of a graph."""
    edges = np.unique(np.sort(edges.reshape(-1, 2), axis=1), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    degree = np.bincount(edges.ravel(), minlength=nodes)
    pieces = connected_components(coo_array((np.ones(len(edges)), edges.T), shape=(nodes, nodes)), directed=False)[0]
    return len(edges) - nodes + pieces, int((degree == 1).sum())


def ours(mesh: bt.TriangleMesh) -> tuple[int, int]:
    r = bt.skeleton(bt.TriangleMesh(mesh.vertices, mesh.faces))
    return r.cycles, r.leaves


def ours_from_points(mesh: bt.TriangleMesh) -> tuple[int, int]:
    r = bt.skeleton(bt.PointCloud(mesh.vertices))
    return r.cycles, r.leaves


def _of_gel(graph: object) -> tuple[int, int]:
    nodes = list(graph.nodes())  # type: ignore[attr-defined]
    number = {node: at for at, node in enumerate(nodes)}
    edges = [(number[a], number[b]) for a in nodes for b in graph.neighbors(a)]  # type: ignore[attr-defined]
    return counted(len(nodes), np.array(edges, np.int64).reshape(-1, 2))


def gel(mesh: bt.TriangleMesh) -> tuple[int, int]:
    manifold = hmesh.Manifold.from_triangles(mesh.vertices, mesh.faces)
    return _of_gel(gel_graph.LS_skeleton(gel_graph.from_mesh(manifold)))


def contracted(mesh: bt.TriangleMesh) -> tuple[int, int]:
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    found = skeletor.skeletonize.by_wavefront(shape, waves=1, step_size=1, progress=False)
    return counted(len(found.vertices), np.asarray(found.edges, np.int64))


def timed(work: Callable[[], tuple[int, int]], rounds: int) -> tuple[tuple[int, int], float, float]:
    """The answer, least wall seconds, least processor seconds."""
    walls, processors = [], []
    for _ in range(rounds):
        wall, processor = time.perf_counter(), time.process_time()
        answer = work()
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    return answer, min(walls), min(processors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--slow", type=int, default=6000, help="vertices up to which pygel3d takes part (6000: some 3 CPU seconds)")
    options = parser.parse_args()
    shapes: dict[str, bt.TriangleMesh] = {Path(file).name: bt.load(file) for file in options.files}
    if not shapes:
        shapes = {
            "torus": bt.shapes.torus(1.0, 0.3, rows=120, columns=40),
            "figure eight": bt.shapes.figure_eight(),
            "star": bt.shapes.star(5, arm_length=2.0, tube_radius=0.25),
            "spot": bt.examples.spot(),
        }
    methods: dict[str, Callable[[bt.TriangleMesh], tuple[int, int]]] = {"beltrami": ours, "beltrami, points": ours_from_points}
    if gel_graph is not None:
        methods["pygel3d, local separators"] = gel
    if skeletor is not None:
        methods["skeletor, wavefront"] = contracted
    print(f"{'shape':<16} {'vertices':>8} {'genus':>5}  {'method':<26} {'loops':>5} {'leaves':>6} {'seconds':>8} {'CPU s':>8}")
    for name, mesh in shapes.items():
        for label, method in methods.items():
            if method is gel and len(mesh.vertices) > options.slow:
                continue
            (loops, leaves), wall, processor = timed(lambda method=method, mesh=mesh: method(mesh), options.rounds)
            print(
                f"{name:<16} {len(mesh.vertices):>8} {mesh.genus!s:>5}  {label:<26} {loops:>5} {leaves:>6} {wall:>8.3f} {processor:>8.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
