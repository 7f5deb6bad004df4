"""Conformal registration beside near-isometric registration (bt.register) and pyFM (pip install pyfmaps), the same landmarks for all.

pyFM: wave kernel signatures, landmarks and the orientation term, functional map of 35, ZoomOut to 85. Errors are geodesic, over the root
of the area.

    python benches/peers/conformal_registration.py [A.npz B.npz ...] [--landmarks 5]

Without files: Spot and its inversion in a point, and the cortex and its sphere (nilearn). Files are .npz with V, F and (optional) corr, the
vertex of each common sample; row i of A.corr matches row i of B.corr.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import beltrami as bt
import numpy as np

try:
    from pyFM.functional import FunctionalMapping
    from pyFM.mesh import TriMesh
except ImportError:
    FunctionalMapping = None

Pair = tuple[str, bt.TriangleMesh, bt.TriangleMesh, np.ndarray, np.ndarray]


def shuffled(mesh: bt.TriangleMesh, matches: np.ndarray, seed: int = 11) -> tuple[bt.TriangleMesh, np.ndarray]:
    """Other numbers, so that nothing gains from a numbering that both share."""
    order = np.random.default_rng(seed).permutation(len(mesh.vertices))
    new = np.empty(len(order), int)
    new[order] = np.arange(len(order))
    return bt.TriangleMesh(mesh.vertices[order], new[mesh.faces]), new[matches]


def own_pairs() -> Iterator[Pair]:
    spot = bt.examples.spot()
    d = spot.vertices - spot.vertices.mean(0) - np.array([1.2, 1.1, 0.5])
    all_of = np.arange(len(spot.vertices))
    yield "spot, inverted", spot, *shuffled(bt.TriangleMesh(d / (d**2).sum(1)[:, None] * [1, 1, -1], spot.faces), all_of), all_of
    try:
        pial, sphere = bt.examples.cortex("pial"), bt.examples.cortex("sphere")
    except bt.DependencyError as error:
        print(error)
        return
    all_of = np.arange(len(pial.vertices))
    yield "cortex, its sphere", pial, *shuffled(sphere, all_of), all_of


def pairs_of(files: list[Path]) -> Iterator[Pair]:
    for first, second in zip(files[::2], files[1::2], strict=True):
        meshes, matches = [], []
        for file in (first, second):
            with np.load(file) as archive:
                meshes.append(bt.TriangleMesh(archive["V"].astype(float), archive["F"]))
                matches.append(archive["corr"] if "corr" in archive.files else np.arange(len(archive["V"])))
        target, there = shuffled(meshes[1], matches[1])
        yield f"{first.stem} - {second.stem}", meshes[0], target, there, matches[0]


def with_pyfm(source: bt.TriangleMesh, target: bt.TriangleMesh, marks: np.ndarray) -> np.ndarray:
    """Its map runs from its second mesh to its first."""
    model = FunctionalMapping(TriMesh(target.vertices, target.faces), TriMesh(source.vertices, source.faces))
    model.preprocess(n_descr=100, landmarks=marks[:, ::-1], subsample_step=5)
    model.fit(K=(35, 35), w_descr=1.0, w_lap=1e-2, w_dcomm=1e-1, w_orient=1e-1)
    return np.asarray(model.get_p2p(FM=model.zoomout_refine(nit=25, step=2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--landmarks", type=int, default=5)
    given = parser.parse_args()
    print(f"{'pair':<34}{'method':<12}{'mean error':>12}{'below .05':>12}{'CPU s':>9}")
    for name, source, target, there, here in pairs_of(given.files) if given.files else own_pairs():
        picked = bt.farthest_points(source.vertices[here], given.landmarks)
        marks = np.stack([here[picked], there[picked]], axis=1)
        ways: dict[str, Callable[[], np.ndarray]] = {
            "conformal": lambda a=source, b=target, m=marks: bt.register_conformal(a, b, landmarks=m).point_map,
            "register": lambda a=source, b=target, m=marks: bt.register(a, b, landmarks=m).point_map,
        }
        if FunctionalMapping is not None:
            ways["pyFM"] = lambda a=source, b=target, m=marks: with_pyfm(a, b, m)
        truth = np.full(len(source.vertices), -1)
        truth[here] = there
        sample = np.random.default_rng(0).permutation(here)[:300]
        for method, way in ways.items():
            start = time.process_time()
            found = way()
            seconds = time.process_time() - start
            away = np.array([bt.geodesic_distance(target, [truth[i]])[found[i]] for i in sample]) / np.sqrt(target.area)
            print(f"{name:<34}{method:<12}{away.mean():>12.4f}{(away < 0.05).mean():>12.0%}{seconds:>9.1f}", flush=True)


if __name__ == "__main__":
    main()
