"""Sliced Wasserstein distances: beltrami, two numpy sorts of the same projections, and POT, in turn, in one process.

python benches/peers/sliced.py [points]
"""

import sys

import beltrami as bt
import numpy as np
from neighbors import compare


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(count, 5)), 1.3 * rng.normal(size=(count, 5))
    weights = rng.uniform(0.5, 1.5, count)
    directions = bt.sliced.orthonormal_directions(5, 100, rng=0)

    def sorts():
        total = 0.0
        for part in np.split(directions, 4):
            p, q = (np.sort(part @ points.T, axis=1) for points in (x, y))
            total += ((p - q) ** 2).mean(1).sum()
        return (total / len(directions)) ** 0.5

    runners = {"beltrami": lambda: bt.sliced_wasserstein(x, y, directions=directions), "numpy sort": sorts}
    weighted = {"beltrami": lambda: bt.sliced_wasserstein(x, y, source_weights=weights, directions=directions)}
    try:
        import ot
    except ImportError:
        pass
    else:
        runners["POT"] = lambda: ot.sliced_wasserstein_distance(x, y, projections=directions.T)
        weighted["POT"] = lambda: ot.sliced_wasserstein_distance(x, y, weights / weights.sum(), projections=directions.T)
    compare(f"{count} points, 100 directions", runners)
    compare(f"{count} weighted points, 100 directions", weighted)


if __name__ == "__main__":
    main()
