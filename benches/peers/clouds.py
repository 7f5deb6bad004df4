"""Operators of point clouds beside robust_laplacian and pcdiff: seconds, and errors on the sphere of the first 36 eigenvalues or, of
pointwise operators, of Δ(x y). (pycompadre has no wheel and builds Trilinos; it is not compared.)

    python benches/peers/clouds.py [--sizes 8000 32000 100000] [--runs 3]

Best of some runs, wall clock and CPU seconds of the process.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import beltrami as bt
import numpy as np
import pcdiff
import robust_laplacian
from scipy.sparse.linalg import eigsh


def best(work: Callable[[], Any], runs: int) -> tuple[float, float, Any]:
    """Least wall clock and CPU seconds of some runs, and the last answer."""
    wall = busy = np.inf
    for _ in range(runs):
        start, cpu = time.perf_counter(), time.process_time()
        answer = work()
        wall, busy = min(wall, time.perf_counter() - start), min(busy, time.process_time() - cpu)
    return wall, busy, answer


def gradient_and_divergence(points: Any) -> tuple[Any, Any]:
    """pcdiff's moving least squares, with the outward normals that are known here."""
    edges = pcdiff.knn_graph(points, 20)
    return pcdiff.build_grad_div(points, points, *pcdiff.build_tangent_basis(points), edges)


def pointwise(f: Any, laplacian: Any) -> str:
    return f"Δ(x y): {np.sqrt(np.mean((laplacian + 6 * f) ** 2) / np.mean((6 * f) ** 2)):.2e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[8000, 32000, 100000])
    parser.add_argument("--runs", type=int, default=3)
    chosen = parser.parse_args()
    exact = np.repeat([k * (k + 1.0) for k in range(6)], [2 * k + 1 for k in range(6)])[1:]
    print(f"{'points':>8}  {'operators':<30}{'wall':>8}{'CPU':>8}   mean error of eigenvalues")
    for n in chosen.sizes:
        points = np.random.default_rng(n).standard_normal((n, 3))
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        cloud = bt.PointCloud(points)
        wall, busy, ops = best(lambda cloud=cloud: bt.operators(cloud), chosen.runs)
        error = np.abs(bt.eigenpairs(ops, 36).values[1:] / exact - 1).mean()
        print(f"{n:>8}  {'local mesh':<30}{wall:>8.3f}{busy:>8.3f}   {error:.2e}")
        f = points[:, 0] * points[:, 1]
        for degree in (2, 3, 4):
            wall, busy, mls = best(lambda cloud=cloud, degree=degree: bt.operators(cloud, laplacian="mls", degree=degree), chosen.runs)
            print(f"{n:>8}  {f'moving least squares, degree {degree}':<30}{wall:>8.3f}{busy:>8.3f}   {pointwise(f, mls.laplacian @ f)}")
        wall, busy, (gradient, divergence) = best(lambda points=points: gradient_and_divergence(points), chosen.runs)
        print(f"{n:>8}  {'pcdiff':<30}{wall:>8.3f}{busy:>8.3f}   {pointwise(f, divergence @ (gradient @ f))}")
        wall, busy, (stiffness, mass) = best(lambda points=points: robust_laplacian.point_cloud_laplacian(points), chosen.runs)
        theirs = np.sort(eigsh(stiffness, 36, mass, sigma=-1e-3)[0])[1:]
        print(f"{n:>8}  {'robust_laplacian':<30}{wall:>8.3f}{busy:>8.3f}   {np.abs(theirs / exact - 1).mean():.2e}")


if __name__ == "__main__":
    main()
