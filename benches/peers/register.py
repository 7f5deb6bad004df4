"""Registration beside pyFM (wave kernel signatures, orientation term, ZoomOut) in the same run: error and CPU seconds.

By default Spot against Spot bent, coarsened by nothing and renumbered; or pairs of shapes with known truth: files .npz with V, F and,
if the numbering is not common, corr (the vertex of each common sample).

    python benches/peers/register.py [SOURCE.npz TARGET.npz ...] [--rounds 1]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import beltrami as bt
import numpy as np

try:
    from pyFM.functional import FunctionalMapping
    from pyFM.mesh import TriMesh
except ImportError:
    FunctionalMapping = None

Pair = tuple[str, bt.TriangleMesh, bt.TriangleMesh, np.ndarray, np.ndarray]


def renumbered(vertices: np.ndarray, faces: np.ndarray, seed: int) -> tuple[bt.TriangleMesh, np.ndarray]:
    order = np.random.default_rng(seed).permutation(len(vertices))
    place = np.argsort(order)
    return bt.TriangleMesh(vertices[order], place[faces]), place


def made() -> Pair:
    """Spot and Spot bent by formula."""
    spot = bt.examples.spot()
    x, y, z = (spot.vertices - spot.vertices.mean(0)).T
    radius = np.ptp(y) / 0.8
    bent = np.stack([(radius + x) * np.cos(y / radius), (radius + x) * np.sin(y / radius), z], 1)
    target, place = renumbered(bent, spot.faces, 1)
    return "Spot, bent", spot, target, np.arange(len(place)), place


def read(source: Path, target: Path) -> Pair:
    with np.load(source) as a, np.load(target) as b:
        first = bt.TriangleMesh(a["V"].astype(float), a["F"])
        second, place = renumbered(b["V"].astype(float), b["F"], 11)
        samples = a["corr"] if "corr" in a.files else np.arange(len(first.vertices))
        images = b["corr"] if "corr" in b.files else np.arange(len(second.vertices))
        return f"{source.stem} - {target.stem}", first, second, samples, place[images]


def pyfm(source: bt.TriangleMesh, target: bt.TriangleMesh) -> np.ndarray:
    """pyFM's map from source to target with what its authors propose, and the orientation term that keeps it from mirroring."""
    # pyFM's point map goes from its second mesh to its first
    model = FunctionalMapping(
        TriMesh(target.vertices, target.faces, area_normalize=True), TriMesh(source.vertices, source.faces, area_normalize=True)
    )
    model.preprocess(n_descr=100, descr_type="WKS", subsample_step=5, k_process=150)
    model.fit(K=(30, 30), w_descr=1.0, w_lap=1e-2, w_dcomm=1e-1, w_orient=1e-1)
    model.zoomout_refine(nit=24, step=5)
    return np.asarray(model.get_p2p())


def timed(work: Callable[[], np.ndarray], rounds: int) -> tuple[np.ndarray, float, float]:
    """The answer, CPU seconds and wall seconds: best of the rounds."""
    cpu = wall = np.inf
    for _ in range(rounds):
        start, begun = time.process_time(), time.perf_counter()
        answer = work()
        cpu, wall = min(cpu, time.process_time() - start), min(wall, time.perf_counter() - begun)
    return answer, cpu, wall


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--rounds", type=int, default=1)
    options = parser.parse_args()
    pairs = [read(*pair) for pair in zip(options.files[::2], options.files[1::2], strict=True)] or [made()]
    print(f"{'pair':30} {'method':22} {'mean error':>10} {'CPU s':>7} {'wall s':>7}")
    for name, source, target, samples, images in pairs:
        truth = np.zeros(len(source.vertices), int)
        truth[samples] = images
        chosen = np.unique(samples[np.random.default_rng(0).permutation(len(samples))[:300]])
        methods: dict[str, Callable[[], np.ndarray]] = {
            "beltrami": lambda: bt.register(source, target).point_map,  # noqa: B023 - called at once
            "beltrami, rswd alone": lambda: bt.register(source, target, method="rswd").point_map,  # noqa: B023
        }
        if FunctionalMapping is not None:
            methods["pyFM"] = lambda: pyfm(source, target)  # noqa: B023
        for method, work in methods.items():
            found, cpu, wall = timed(work, options.rounds)
            score = bt.evaluate_map(found, source, target, truth=truth, points=chosen)
            print(f"{name:30} {method:22} {score.mean:10.4f} {cpu:7.2f} {wall:7.2f}", flush=True)
    if FunctionalMapping is None:
        print("pyFM is missing: pip install pyfmaps")


if __name__ == "__main__":
    main()
