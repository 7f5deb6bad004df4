"""Conformal maps to the sphere beside LaPy's (pip install lapy), which is a port of Choi's; both sides in turn in one run.

E - A and the mean angle error are measured here, by one formula for both, after Möbius centring.

    python benches/peers/spherical_map.py [FILE ...] [--rounds 3]

Without files: spot, the pial cortex (nilearn) and the latter subdivided to 41k and 164k vertices.
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import beltrami as bt
import numpy as np
from beltrami.conformal.spherical import refined

try:
    import lapy
    from lapy.conformal import spherical_conformal_map
except ImportError:
    lapy = None


def measure(mesh: bt.TriangleMesh, s: np.ndarray) -> tuple[float, float, int]:
    """E - A, mean angle error in degrees, flipped triangles."""
    s = bt.Moebius.centering(s / np.linalg.norm(s, axis=1)[:, None], bt.operators(mesh).mass)(s / np.linalg.norm(s, axis=1)[:, None])
    energy, area, error, turned = 0.0, 0.0, [], 0
    p, q, r = (s[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(q - p, r - p)
    signs = np.sign((p * normal).sum(1))
    turned = int((signs * np.sign(signs.sum()) <= 0).sum())
    area = 0.5 * float(np.linalg.norm(normal, axis=1) @ (signs * np.sign(signs.sum())))
    for k in range(3):
        angles = []
        for x in (mesh.vertices, s):
            a, b = (x[mesh.faces[:, (k + j) % 3]] - x[mesh.faces[:, k]] for j in (1, 2))
            angles.append(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(1)))
        opposite = s[mesh.faces[:, (k + 1) % 3]] - s[mesh.faces[:, (k + 2) % 3]]
        energy += 0.25 * float((opposite**2).sum(1) @ (1 / np.tan(angles[0])))
        error.append(np.abs(angles[1] - angles[0]))
    return energy - area, float(np.degrees(np.mean(error))), turned


def timed(work: Callable[[], np.ndarray], rounds: int) -> tuple[np.ndarray, float, float]:
    """The answer, least wall seconds, least processor seconds."""
    walls, cpus = [], []
    for _ in range(rounds):
        wall, cpu = time.perf_counter(), time.process_time()
        answer = work()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return answer, min(walls), min(cpus)


def theirs(mesh: bt.TriangleMesh) -> np.ndarray:
    with redirect_stdout(io.StringIO()):
        return np.asarray(spherical_conformal_map(lapy.TriaMesh(mesh.vertices.copy(), mesh.faces.astype(np.int64))))


def cases(files: list[str]) -> list[tuple[str, bt.TriangleMesh]]:
    if files:
        return [(Path(file).stem, bt.load(file)) for file in files]
    cortex = bt.examples.cortex("pial")
    finer = [refined(cortex.vertices, cortex.faces, cortex.vertices, least)[0] for least in (20_000, 100_000)]
    return [("spot", bt.examples.spot()), ("pial cortex", cortex), ("cortex, cut once", finer[0]), ("cortex, cut twice", finer[1])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    for name, mesh in cases(options.files):
        sides = [("beltrami", lambda mesh=mesh: bt.spherical_map(mesh).positions)]
        if lapy:
            sides.append((f"LaPy {lapy.__version__}", lambda mesh=mesh: theirs(mesh)))
        for side, work in sides:
            try:
                s, wall, cpu = timed(work, options.rounds)
                excess, angle, turned = measure(mesh, s)
                figures = f"{wall:7.3f} s  {cpu:7.3f} s of processor  E - A {excess:.5f}  angle error {angle:.3f}°  {turned} flipped"
            except Exception as error:  # a peer that fails is a result
                figures = f"fails: {type(error).__name__}: {str(error)[:70]}"
            print(f"{name:<18} {len(mesh.vertices):>7} vertices  {side:<14} {figures}", flush=True)


if __name__ == "__main__":
    main()
