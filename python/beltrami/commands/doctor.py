"""A check of the installation."""

from __future__ import annotations

import importlib.metadata
import platform

import numpy as np

import beltrami as bt

from ..solvers import plus_diagonal
from . import DONE, NOT_CONVERGED, Options, command, table


@command("doctor", "versions, threads, extras, and a self-test", lambda parser: None)
def doctor(options: Options) -> int:
    rows: list[tuple[str, object]] = [
        ("beltrami", bt.__version__),
        ("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        ("threads", bt.num_threads()),
    ]
    for package, purpose in (
        ("numpy", ""), ("scipy", ""), ("trimesh", ""), ("matplotlib", "further colour maps"), ("nibabel", "GIFTI and FreeSurfer files"),
        ("nilearn", "the example cortex"), ("pyvista", "to_pyvista"), ("meshio", "its objects"), ("networkx", "to_networkx"),
        ("MDAnalysis", "molecules"), ("distributed", "distances on a Dask cluster"),
    ):  # fmt: skip
        found = next(iter(importlib.metadata.distributions(name=package)), None)
        absent = f"absent (optional: {purpose})" if purpose else "MISSING: pip install beltrami again"
        rows.append((package, absent if found is None else found.version))
    table(rows)
    good = _self_test()
    print("all is well" if good else "something is wrong: please report the lines above")
    return DONE if good else NOT_CONVERGED


def _self_test() -> bool:
    """A solve, two areas and a picture, each held against what is known."""
    sphere = bt.shapes.sphere(4)
    operators = bt.operators(sphere)
    matrix = plus_diagonal(operators.stiffness, operators.mass)
    right = sphere.vertices[:, 2] * operators.mass
    solution = bt.Cholesky(matrix, sphere.vertices).solve(right)
    residual = float(np.linalg.norm(matrix @ solution - right) / np.linalg.norm(right))
    # (L + M) u = M z has the solution z / 3 on the round sphere.
    error = float(np.abs(3 * solution - sphere.vertices[:, 2]).max())
    area = abs(float(operators.mass.sum()) / (4 * np.pi) - 1)
    flat = bt.TriangleMesh(np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    pixels = bt.plot(flat, color="#204080", size=(64, 64), color_bar=False).pixels  # type: ignore[union-attr]
    checks = [
        ("residual of a sparse solve", residual, 1e-12),
        ("error of a solution known in closed form", error, 1e-2),
        ("relative error of the sphere's area", area, 1e-2),
        ("colour of a painted square", float(np.abs(pixels[32, 32].astype(float) - [32, 64, 128]).max()), 0.5),
    ]
    table([(name, value, "ok" if value <= bound else f"ABOVE {bound:g}") for name, value, bound in checks])
    return all(value <= bound for _, value, bound in checks)
