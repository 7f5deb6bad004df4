"""Sparse Cholesky beside CHOLMOD (scikit-sparse 0.4.16, which needs Debian's libsuitesparse-dev): both sides in turn in one run.

The matrix is mean(m) L + M of a sphere whose vertices are numbered at random, so that nobody gains from the maker's numbering.

    python benches/peers/cholesky.py [--vertices 10000 100000 1000000] [--rounds 3]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import beltrami as bt
import numpy as np
import scipy.sparse as sparse

try:
    from sksparse import cholmod
except ImportError:
    cholmod = None


def system(vertices: int, seed: int = 0) -> tuple[sparse.csr_array, np.ndarray]:
    """Points spread over the sphere and joined by their convex hull: cotangent stiffness and lumped mass."""
    from scipy.spatial import ConvexHull

    rng = np.random.default_rng(seed)
    at = np.arange(vertices) + 0.5
    height, angle = 1 - 2 * at / vertices, np.pi * (1 + np.sqrt(5)) * at
    ring = np.sqrt(1 - height**2)
    points = np.c_[ring * np.cos(angle), ring * np.sin(angle), height] + rng.normal(size=(vertices, 3)) * 0.2 / np.sqrt(vertices)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points = points[rng.permutation(vertices)]
    faces = ConvexHull(points).simplices
    rows, columns, values, mass = [], [], [], np.zeros(vertices)
    for k in range(3):
        i, j, apex = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3], faces[:, k]
        u, v = points[i] - points[apex], points[j] - points[apex]
        double_area = np.linalg.norm(np.cross(u, v), axis=1)
        half = (u * v).sum(1) / double_area / 2
        rows += [i, j, i, j]
        columns += [j, i, i, j]
        values += [-half, -half, half, half]
        mass += np.bincount(apex, double_area / 6, minlength=vertices)
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    stiffness = sparse.csr_array(sparse.coo_array(entries, shape=(vertices, vertices)))
    return sparse.csr_array(mass.mean() * stiffness + sparse.diags_array(mass)), points


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def compare(vertices: int, rounds: int) -> None:
    a, points = system(vertices)
    csc, block = sparse.csc_matrix(a), np.random.default_rng(1).normal(size=(vertices, 32))
    table: dict[str, list[tuple[float, float, float]]] = {}
    notes: dict[str, tuple[float, float]] = {}
    for _ in range(rounds):
        for name, places in (("beltrami, coordinates", points), ("beltrami", None)):
            new = seconds(lambda places=places: bt.Cholesky(a, coordinates=places))
            ours = bt.Cholesky(a, coordinates=places)
            ours.solve(block)
            times = new, seconds(lambda ours=ours: ours.refactor(a)), seconds(lambda ours=ours: ours.solve(block))
            table.setdefault(name, []).append(times)
            notes[name] = ours.nnz / 1e6, float(np.max(ours.residual(block, ours.solve(block))))
            del ours
        for order in ("amd", "metis", "nesdis") if cholmod else ():
            name = f"CHOLMOD {order}"
            new = seconds(lambda order=order: cholmod.cholesky(csc, ordering_method=order))
            theirs = cholmod.cholesky(csc, ordering_method=order)
            theirs(block)
            times = new, seconds(lambda theirs=theirs: theirs.cholesky_inplace(csc)), seconds(lambda theirs=theirs: theirs(block))
            table.setdefault(name, []).append(times)
            rest = np.linalg.norm(a @ theirs(block) - block, axis=0) / np.linalg.norm(block, axis=0)
            notes[name] = theirs.L().nnz / 1e6, float(rest.max())
            del theirs
    for name, measured in table.items():
        new, again, solve = np.median(measured, axis=0)
        values, rest = notes[name]
        print(f"| {vertices} | {name} | {new:.3f} | {again:.3f} | {solve:.3f} | {values:.1f} M | {rest:.0e} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vertices", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    print(f"{bt.num_threads()} threads; seconds, median of {options.rounds}")
    print("| unknowns | | order + analyse + factor | refactor | 32 right-hand sides | values in L | residual |")
    print("|---|---|---|---|---|---|---|")
    for vertices in options.vertices:
        compare(vertices, options.rounds)


if __name__ == "__main__":
    main()
