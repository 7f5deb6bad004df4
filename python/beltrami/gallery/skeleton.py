"""Skeletons."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

import beltrami as bt

from . import Sheet, section


@section("Skeletons")
def skeletons(sheet: Sheet) -> None:
    sheet.text(
        "The first eigenfunction varies along a shape from end to end; the eccentricity, made of six, is largest at the tips of all limbs "
        "and used if the first misses some. The connected components of the level sets are rings around limbs; "
        "`bt.skeleton` joins the middles of neighbouring rings, so that the graph branches and closes loops as the shape does. On a "
        "mesh it is the exact Reeb graph: as many loops as handles. From points alone, with noise, loops that the sampling makes "
        "are told from those of the shape."
    )
    rng = np.random.default_rng(0)
    knot = bt.shapes.knot()
    eight = bt.shapes.figure_eight()
    points = _sampled(eight, 8000, rng)
    noisy = points + 0.01 * np.linalg.norm(np.ptp(points, axis=0)) * rng.normal(size=points.shape)
    shapes: dict[str, bt.TriangleMesh | bt.PointCloud] = {
        "knot": knot,
        "figure eight, 8,000 points with 1 % noise": bt.PointCloud(noisy),
        "star": bt.shapes.star(5, arm_length=2.0, tube_radius=0.25),
        "spot": bt.examples.spot(),
    }
    for name, path in _scans().items():
        shapes[name] = bt.load(path)
    rows, made = [], {}
    for name, shape in shapes.items():
        start = time.perf_counter()
        r = made[name] = bt.skeleton(shape)
        seconds = time.perf_counter() - start
        count = len(r.node_of_point)
        rows.append((name, count, len(r.nodes), r.leaves, r.cycles, len(r.cut), len(r.cancelled), seconds))
    sheet.table(("shape", "points", "nodes", "leaves", "cycles", "limbs cut", "loops cancelled", "seconds"), rows)
    sheet.code(
        'r = bt.skeleton(scan)\nr.plot(path="skeleton.png")\nr.save("skeleton.swc")                      # or .obj, .npz\n'
        "graph = r.to_networkx()\nparts = r.limb_of_point                      # a segmentation into limbs"
    )
    for name, r in made.items():
        flat = name.startswith(("figure", "knot", "star"))
        sheet.picture(
            r.shape,
            title=name[0].upper() + name[1:],
            caption=f"{r.leaves} leaves, {r.cycles} {'cycle' if r.cycles == 1 else 'cycles'}.",
            interactive=True,
            size=(1100, 800),
            views="front" if flat else {"front": "three-quarter back", "left": "left"} if name == "spot" else "three-quarter",
            **r.drawn(),
        )
    r = made["spot"]
    sheet.picture(
        r.shape,
        {"limb": r.limb_of_point},
        title="Each point belongs to a limb",
        caption="The parts that the skeleton's joints divide Spot into: head and neck, four legs, rump.",
        size=(1100, 600),
        views={"front": "three-quarter back", "back": "three-quarter"},
    )


def _sampled(mesh: bt.TriangleMesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random points of a mesh, uniform by area."""
    corners = mesh.vertices[mesh.faces[rng.choice(len(mesh.faces), count, p=mesh.face_areas / mesh.area)]]
    s, t = np.sqrt(rng.uniform(size=(count, 1))), rng.uniform(size=(count, 1))
    points: np.ndarray = (1 - s) * corners[:, 0] + s * (1 - t) * corners[:, 1] + s * t * corners[:, 2]
    return points


def _scans() -> dict[str, Path]:
    """Scans that are not the project's to give away: shown where BELTRAMI_SHAPES names a folder that has them."""
    folder = os.environ.get("BELTRAMI_SHAPES")
    if not folder:
        return {}
    found = {"armadillo": "armadillo.obj", "kitten, points of a scan": "points/kitten.xyz"}
    return {name: Path(folder) / file for name, file in found.items() if (Path(folder) / file).is_file()}
