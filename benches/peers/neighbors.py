"""k nearest neighbours and radius search: beltrami, scipy's cKDTree and nanoflann on the same points, in turn, in one process.

python benches/peers/neighbors.py [points]      medians of three rounds, wall and processor seconds, tree included
"""

import statistics
import sys
import time

import beltrami as bt
import numpy as np
from scipy.spatial import cKDTree


def compare(name, runners, rounds=3):
    times = {peer: [] for peer in runners}
    for run in runners.values():  # imports, caches, first allocation
        run()
    for _ in range(rounds):
        for peer, run in runners.items():
            wall, processor = time.perf_counter(), time.process_time()
            run()
            times[peer].append((time.perf_counter() - wall, time.process_time() - processor))
    own = statistics.median(wall for wall, _ in times["beltrami"])
    for peer, measured in times.items():
        wall, processor = (statistics.median(column) for column in zip(*measured, strict=True))
        print(f"{name:<34} {peer:<12} {wall:8.3f} s wall {processor:8.3f} s processor   {wall / own:6.2f} x beltrami", flush=True)


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    rng = np.random.default_rng(0)
    sphere = rng.normal(size=(count, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    turn = np.linalg.qr(rng.normal(size=(30, 30)))[0][:3]
    clouds = {
        "sphere in R^3": sphere,
        "square in R^2": rng.random((count, 2)),
        "sphere in R^30": sphere[: count // 10] @ turn,
        "normal in R^10": rng.normal(size=(count // 50, 10)),
    }
    try:
        import pynanoflann
    except ImportError:
        pynanoflann = None
    for name, points in clouds.items():

        def nanoflann(points=points):
            tree = pynanoflann.KDTree(leaf_size=10)
            tree.fit(points)
            return tree.kneighbors(points, n_neighbors=16, n_jobs=bt.num_threads())

        runners = {
            "beltrami": lambda points=points: bt.nearest_neighbors(points, points, 16),
            "scipy": lambda points=points: cKDTree(points).query(points, 16, workers=bt.num_threads()),
        }
        if pynanoflann:
            runners["nanoflann"] = nanoflann
        compare(f"k = 16, {len(points)}, {name}", runners)


if __name__ == "__main__":
    main()
