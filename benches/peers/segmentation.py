"""Segmentation beside the same splitting in numpy and scipy, and beside maximum flow (PyMaxflow): all in one run.

The peer is honest: one SuperLU factor (symmetric mode, minimum degree), sparse matrices for gradient and divergence, the same penalties,
the same over-relaxation and the same certificate every tenth sweep, no Python loop over vertices. "scipy, fixed" has penalties that do not
follow the spacing of the mesh (ρ = 0.05, σ = 50), as a scratch program would. Times are the best of several runs.

    python benches/peers/segmentation.py [--levels 5 6 7] [--rounds 3]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import beltrami as bt
import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import splu

try:
    import maxflow
except ImportError:
    maxflow = None


def problem(level: int) -> tuple[bt.TriangleMesh, np.ndarray]:
    """A sphere of 10 * 4^level + 2 vertices and a two-phase image with noise."""
    mesh = bt.shapes.sphere(level)
    p = mesh.vertices / np.sqrt(4 * np.pi)
    return mesh, (np.sin(12 * p).sum(1) > 0.3) + 0.4 * np.random.default_rng(0).normal(size=len(p))


def scipy_segment(
    mesh: bt.TriangleMesh, image: np.ndarray, fidelity: float, fixed: bool = False, tolerance: float = 1e-4
) -> tuple[float, int]:
    """The gap and the sweeps of the splitting in numpy and scipy; the mesh's operators are built here too."""
    vertices, faces = mesh.vertices, mesh.faces
    edge = vertices[faces][:, [2, 0, 1]] - vertices[faces][:, [1, 2, 0]]
    normal = np.cross(edge[:, 0], edge[:, 1])
    areas = 0.5 * np.linalg.norm(normal, axis=1)
    unit = np.sqrt(areas.sum())
    hats = np.cross(normal[:, None], edge) / (4 * areas**2)[:, None, None] * unit
    areas = areas / unit**2
    m, n = len(faces), len(vertices)
    rows = np.repeat(np.arange(3 * m).reshape(m, 3), 3, axis=0).reshape(m, 3, 3)
    columns = np.broadcast_to(faces[:, :, None], (m, 3, 3))
    gradient = sparse.csr_matrix((hats.ravel(), (rows.ravel(), columns.ravel())), shape=(3 * m, n))
    adjoint = sparse.csr_matrix(gradient.T.multiply(np.repeat(areas, 3)[None]))
    mass = np.bincount(faces.ravel(), np.repeat(areas / 3, 3), n)
    h = 1 / np.sqrt(n)
    penalty, ratio = (0.05, 1000.0) if fixed else (1.5 * h, 0.35 / h**2)
    matrix = (adjoint @ gradient + sparse.diags(ratio * mass)).tocsc()
    solve = splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve

    def r_of(phi: np.ndarray) -> np.ndarray:
        means = [np.average(image[side], weights=mass[side]) for side in (phi <= 0.5, phi > 0.5)]
        return (image - means[1]) ** 2 - (image - means[0]) ** 2

    r = r_of((image > 0.5).astype(float))
    z, y, w, p = (r < 0).astype(float), np.zeros(n), np.zeros((m, 3)), np.zeros((m, 3))
    for sweep in range(1, 2001):
        sigma = penalty * ratio
        phi = solve(adjoint @ (w - p / penalty).ravel() + ratio * mass * (z - y / sigma))
        v = 1.8 * (gradient @ phi).reshape(m, 3) - 0.8 * w + p / penalty
        length = np.sqrt(np.einsum("md,md->m", v, v))
        w = v * np.maximum(1 - 1 / (penalty * np.maximum(length, 1e-300)), 0)[:, None]
        p = penalty * (v - w)
        relaxed = 1.8 * phi - 0.8 * z
        z = np.clip(relaxed + (y - fidelity * r) / sigma, 0, 1)
        y += sigma * (relaxed - z)
        if sweep % 10 == 0:
            values = []
            for phi_ in (np.clip(phi, 0, 1), z):
                g = (gradient @ phi_).reshape(m, 3)
                values.append((areas @ np.sqrt(np.einsum("md,md->m", g, g)) + fidelity * mass @ (r * phi_), phi_))
            primal, best = min(values, key=lambda pair: pair[0])
            r_new = r_of(best)
            primal += fidelity * mass @ ((r_new - r) * best)
            r = r_new
            dual = np.minimum(0, adjoint @ p.ravel() + fidelity * mass * r).sum()
            gap = (primal - dual) / abs(primal)
            if gap <= tolerance:
                break
    return gap, sweep


def cut(mesh: bt.TriangleMesh, image: np.ndarray, means: np.ndarray, fidelity: float) -> float:
    """The exact minimum of the edge model by maximum flow."""
    area = mesh.area
    pairs = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), 1)
    edges, where = np.unique(pairs, axis=0, return_inverse=True)
    beside = np.bincount(where.ravel(), np.tile(mesh.face_areas, 3)) / 3
    w = np.pi / 2 * beside / np.linalg.norm(np.diff(mesh.vertices[edges], axis=1)[:, 0], axis=1) / np.sqrt(area)
    linear = fidelity * bt.operators(mesh).mass / area * ((image - means[1]) ** 2 - (image - means[0]) ** 2)
    graph = maxflow.Graph[float]()
    nodes = graph.add_nodes(len(linear))
    graph.add_edges(edges[:, 0], edges[:, 1], w, w)
    graph.add_grid_tedges(nodes, np.maximum(linear, 0), np.maximum(-linear, 0))
    return float(graph.maxflow() + np.minimum(linear, 0).sum())


def seconds(work: Callable[[], Any]) -> tuple[float, float, Any]:
    wall, processor = time.perf_counter(), time.process_time()
    answer = work()
    return time.perf_counter() - wall, time.process_time() - processor, answer


def compare(level: int, rounds: int, fidelity: float = 60.0) -> None:
    mesh, image = problem(level)
    n = len(mesh.vertices)
    work: dict[str, Callable[[], Any]] = {
        "beltrami": lambda: bt.segment(bt.TriangleMesh(mesh.vertices, mesh.faces), image, fidelity=fidelity),
        "scipy": lambda: scipy_segment(mesh, image, fidelity),
        "scipy, fixed": lambda: scipy_segment(mesh, image, fidelity, fixed=True),
    }
    runs: dict[str, list[tuple[float, float, Any]]] = {name: [] for name in work}
    for _ in range(rounds):  # in turn, so that a busy machine is busy for all
        for name, job in work.items():
            runs[name].append(seconds(job))
    ours = tuple(min(run[k] for run in runs["beltrami"]) for k in (0, 1))
    for name, done in runs.items():
        wall, processor = (min(run[k] for run in done) for k in (0, 1))
        answer = done[0][2]
        gap, sweeps = answer if isinstance(answer, tuple) else (answer.gap, answer.iterations)
        ratio = "" if name == "beltrami" else f"{wall / ours[0]:6.1f} x wall {processor / ours[1]:6.1f} x CPU"
        print(f"{n:>9} {name:<13} {wall:>8.3f} {processor:>8.3f} {sweeps:>7} {gap:>9.1e} {ratio}", flush=True)
    if maxflow is not None and level <= 6:
        wall, processor, edge = seconds(lambda: bt.segment(mesh, image, fidelity=fidelity, tv="edge"))
        flow_wall, flow_processor, exact = seconds(lambda: cut(mesh, image, edge.means, fidelity))
        print(f"{n:>9} edge model    {wall:>8.3f} {processor:>8.3f} {edge.iterations:>7} {edge.gap:>9.1e}")
        print(
            f"{n:>9} maximum flow  {flow_wall:>8.3f} {flow_processor:>8.3f}   primal / exact - 1 = {edge.primal / exact - 1:.1e}",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--levels", type=int, nargs="+", default=[5, 6, 7])
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    print(f"{'vertices':>9} {'':<13} {'seconds':>8} {'CPU s':>8} {'sweeps':>7} {'gap':>9}")
    for level in options.levels:
        compare(level, options.rounds)


if __name__ == "__main__":
    main()
