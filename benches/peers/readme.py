"""The ratios of README.md: CPU seconds on one thread, this library and SciPy in one run. `python benches/peers/readme.py`"""

import os
import sys
import time
from collections.abc import Callable

import beltrami as bt
import numpy as np
import scipy
import scipy.sparse as sparse
import scipy.sparse.linalg as linalg
from scipy.spatial import cKDTree


def seconds(work: Callable[[], object]) -> float:
    """Best of three, CPU time of all threads."""
    found = []
    for _ in range(3):
        start = time.process_time()
        work()
        found.append(time.process_time() - start)
    return min(found)


def main() -> None:
    """Prints a line each."""
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":  # threads of BLAS that only wait count as processor time: of SciPy's eigsh, tenfold
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, "OPENBLAS_NUM_THREADS": "1"})
    bt.set_num_threads(1)
    fine, coarse = bt.shapes.sphere(6), bt.shapes.sphere(5)
    ops, few = bt.operators(fine), bt.operators(coarse)
    matrix = ops.stiffness + sparse.diags_array(ops.mass)
    columns, mass = sparse.csc_array(matrix), sparse.diags_array(few.mass).tocsc()
    points = np.random.default_rng(0).normal(size=(200_000, 3))
    symmetric = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0, "options": {"SymmetricMode": True}}
    start = np.ones(len(few.mass))
    rows = [
        (f"factor, {len(ops.mass)} unknowns, splu in symmetric mode", lambda: bt.Cholesky(matrix, fine.vertices),
         lambda: linalg.splu(columns, **symmetric)),
        (f"50 eigenpairs, {len(few.mass)} vertices, eigsh(sigma=)", lambda: bt.eigenpairs(few, 50),
         lambda: linalg.eigsh(sparse.csc_array(few.stiffness), 50, M=mass, sigma=-0.01, v0=start)),
        (f"16 nearest of {len(points)} points, cKDTree", lambda: bt.nearest_neighbors(points, points, 16),
         lambda: cKDTree(points).query(points, 16)),
    ]  # fmt: skip
    print(f"numpy {np.__version__}, scipy {scipy.__version__}; CPU seconds on one thread")
    for name, ours, theirs in rows:
        one, other = seconds(ours), seconds(theirs)
        print(f"{name:<60}{one:8.3f}{other:8.3f}{other / one:7.1f}x")


if __name__ == "__main__":
    main()
