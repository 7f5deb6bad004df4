"""Committors beside target-measure diffusion maps (numpy and SciPy, and pydiffmap where it is installed), in one run.

Double well on a strip with uniform points: q and the rate are known in closed form. The diffusion maps get the bandwidth, of a few, that is
best for their error: no user could choose better.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import beltrami as bt
import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg as linalg

try:
    from pydiffmap import diffusion_map, kernel
except ImportError:
    diffusion_map = kernel = None

SIDE, EDGE, HEIGHT, BETA = 1.5, 0.75, 0.5, 4.0


def energy(x: np.ndarray) -> np.ndarray:
    return (x[:, 0] ** 2 - 1) ** 2 + x[:, 1] ** 2 / 2


def exact(x: np.ndarray) -> tuple[np.ndarray, float]:
    nodes, weights = np.polynomial.legendre.leggauss(200)

    def barrier(t: np.ndarray) -> np.ndarray:
        return np.exp(BETA * (t * t - 1) ** 2)

    total = EDGE * (weights * barrier(EDGE * nodes)).sum()
    half = (np.clip(x, -EDGE, EDGE) + EDGE) / 2
    q = half * (weights * barrier(-EDGE + half[:, None] * (nodes + 1))).sum(1) / total
    return q, 1 / (BETA * total * SIDE * (weights / barrier(SIDE * nodes)).sum())


def target_measure(x: np.ndarray, u: np.ndarray, a: np.ndarray, b: np.ndarray, epsilon: float) -> tuple[np.ndarray, float]:
    """Banisch et al. 2020: kernel, density by its row sums, right normalization by sqrt(exp(-β U)) / density."""
    starts, near, distances = bt.neighbors_within(x, x, 3.5 * np.sqrt(2 * epsilon))
    n = len(x)
    k = sparse.csr_array((np.exp(-(distances**2) / (4 * epsilon)), near, starts), shape=(n, n))
    density = k.sum(1)
    right = sparse.diags_array(np.exp(-BETA * (u - u.min()) / 2) / density)
    k = sparse.csr_array(k @ right)
    rows = k.sum(1)
    generator = sparse.csr_array((sparse.diags_array(1 / rows) @ k - sparse.eye_array(n)) / (epsilon * BETA))
    q, free = b.astype(float), np.flatnonzero(~(a | b))
    q[free] = linalg.spsolve(sparse.csc_array(generator[free][:, free]), -(generator[free] @ q))
    # nu = <|grad q|^2> / β by the carré du champ, averaged over the target measure
    square = (generator @ (q * q) - 2 * q * (generator @ q)) / 2
    weight = np.exp(-BETA * (u - u.min())) / density
    return q, float((weight * square).sum() / weight.sum())


def with_pydiffmap(x: np.ndarray, u: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, float]:
    found = diffusion_map.TMDmap(alpha=1.0, k=200, epsilon="bgh", change_of_measure=lambda p: np.exp(-BETA * energy(np.atleast_2d(p))))
    found.fit(x)
    generator = sparse.csr_array(found.L)
    q, free = b.astype(float), np.flatnonzero(~(a | b))
    q[free] = linalg.spsolve(sparse.csc_array(generator[free][:, free]), -(generator[free] @ q))
    return q, float("nan")


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    start = time.process_time()
    answer = work()
    return time.process_time() - start, answer


def compare(count: int, rounds: int) -> None:
    rng = np.random.default_rng(count)
    x = rng.uniform([-SIDE, -HEIGHT], [SIDE, HEIGHT], (count, 2))
    u, a, b = energy(x), x[:, 0] <= -EDGE, x[:, 0] >= EDGE
    q, rate = exact(x[:, 0])
    weight = np.exp(-BETA * u) * ~(a | b)

    def error(found: np.ndarray) -> float:
        return float(np.sqrt((weight * (found - q) ** 2).sum() / weight.sum()))

    spacing = np.sqrt(2 * SIDE * 2 * HEIGHT / count)
    widths = [(factor * spacing) ** 2 for factor in (0.7, 1.0, 1.4, 2.0)]
    best = min(widths, key=lambda e: error(target_measure(x, u, a, b, e)[0]))
    work: dict[str, Callable[[], tuple[np.ndarray, float]]] = {
        "beltrami": lambda: (lambda r: (r.q, r.rate))(bt.committor(bt.PointCloud(x), u, a, b, beta=BETA)),
        "beltrami, refine=0": lambda: (lambda r: (r.q, r.rate))(bt.committor(bt.PointCloud(x), u, a, b, beta=BETA, refine=0)),
        "TMDmap, best width": lambda: target_measure(x, u, a, b, best),
    }
    if diffusion_map is not None and count <= 8000:
        work["pydiffmap"] = lambda: with_pydiffmap(x, u, a, b)
    seconds: dict[str, float] = {}
    answers: dict[str, tuple[np.ndarray, float]] = {}
    for _ in range(rounds):  # in turn, so that a busy machine is busy for all
        for name, job in work.items():
            try:
                spent, answers[name] = timed(job)
            except Exception as failure:  # a peer that does not run with these versions of its dependencies
                print(f"{count:>7} {name:<20} did not run: {failure}")
                continue
            seconds[name] = min(spent, seconds.get(name, np.inf))
    for name, (found, nu) in answers.items():
        line = f"{count:>7} {name:<20} {seconds[name]:>8.2f} {1e4 * error(found):>9.2f} {100 * (nu / rate - 1):>8.2f}"
        print(line, f"{seconds[name] / seconds['beltrami']:>7.1f} x", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--counts", type=int, nargs="+", default=[2000, 8000, 32000])
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    print(f"{'points':>7} {'':<20} {'CPU s':>8} {'rms 1e-4':>9} {'rate, %':>8}")
    for count in options.counts:
        compare(count, options.rounds)


if __name__ == "__main__":
    main()
