"""Conformal maps to the sphere."""

from __future__ import annotations

import time

import numpy as np

import beltrami as bt
from beltrami.conformal.result import at_vertices
from beltrami.conformal.spherical import checkerboard, refined

from . import Sheet, section


@section("Conformal maps to the sphere")
def maps(sheet: Sheet) -> None:
    sheet.text(
        "Every closed surface without handles has a map to the sphere that keeps all angles. `bt.spherical_map` minimizes E - A, the "
        "Dirichlet energy less the area of the image, which is zero only where each triangle keeps its shape; it centres the "
        "image by a Möbius transformation and repairs flipped triangles. The squares below are those of the sphere's Mercator "
        "projection, pulled back: right angles everywhere, though sizes differ by powers of ten."
    )
    cortex, spot = bt.examples.cortex("pial"), bt.examples.spot()
    rows, made = [], {}
    for name, shape in (
        ("cortex, pial surface", cortex),
        ("cortex, white surface", bt.examples.cortex("white")),
        ("spot", spot),
        ("spot, its points alone", bt.PointCloud(spot.vertices)),
    ):
        start = time.perf_counter()
        r = made[name] = bt.spherical_map(shape)
        seconds = time.perf_counter() - start
        error = np.degrees(r.angle_error)
        rows.append((name, len(r.positions), r.excess, float(error.mean()), float(np.median(error)), r.flipped, r.iterations, seconds))
    sheet.table(("shape", "vertices", "E - A", "mean angle error, °", "median, °", "flipped", "steps", "seconds"), rows)
    sheet.code(
        'r = bt.spherical_map(cortex)\nr.plot("checkerboard", path="squares.png")\nr.plot("angle_error", on="sphere", path="error.png")\n'
        "depth = r.image(cortex.data['depth'])          # longitude-latitude image\n"
        "there = r.aligned_to(other).map_to(other)      # another cortex, through the sphere"
    )
    r = made["cortex, pial surface"]
    squares = {"colormap": ["#27466b", "#f3e9d2"], "limits": (-0.02, 0.02), "color_bar": False, "size": (1600, 760)}
    fine, positions = refined(cortex.vertices, r.faces, r.positions, 40_000)
    sheet.picture(
        fine,
        checkerboard(positions),
        views={"lateral": "left", "medial": "right", "dorsal": "top"},
        up="z",
        title="Squares of the sphere on the cortex",
        caption="Left pial surface.",
        description="A cortex under squares of two colours: large ones on the medial wall, small ones where it protrudes",
        interactive=True,
        **squares,
    )
    depth = cortex.data["depth"]
    span = float(np.abs(depth).max())
    sheet.picture(
        r.sphere,
        {"sulcal depth": depth},
        views={"lateral": "left", "medial": "right", "dorsal": "top"},
        up="z",
        colormap="balance",
        limits=(-span, span),
        contours=[0.0],
        title="The same cortex on the sphere",
        caption="Sulcal depth; gyri and sulci in one view, angles kept.",
        interactive=True,
        size=(1600, 760),
    )
    sheet.picture(
        cortex,
        {"angle error, degrees": at_vertices(r, np.degrees(r.angle_error))},
        views={"lateral": "left", "medial": "right", "dorsal": "top"},
        up="z",
        limits=(0.0, 8.0),
        title="How much the angles of the triangles change",
        caption="Mean over the three angles. The remaining error is due to the mesh and decreases with the size of its triangles.",
        size=(1600, 760),
    )
    r = made["spot"]
    fine, positions = refined(spot.vertices, r.faces, r.positions, 40_000)
    sheet.picture(
        fine,
        checkerboard(positions),
        views={"three-quarter": "three-quarter back", "front": "back", "left": "left"},
        title="Squares of the sphere on Spot",
        caption="Horns, ears and legs are tiny on the sphere, and still no triangle is flipped.",
        description="Spot, a cow, under squares of two colours: a few large ones on her head and legs, many small ones on neck and rump",
        interactive=True,
        **squares,
    )
    sheet.text("On the sphere a shape is three functions; their spherical harmonics describe it coarse to fine.")
    sums = [r.harmonics(degree) for degree in (3, 8, 15, 40)]
    sheet.table(("degree", "relative error"), [(one.degree, one.error) for one in sums], "Spot as a sum of spherical harmonics")
