"""Segmentation and denoising of images on surfaces."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import beltrami as bt

from . import Sheet, section


@section("Segmentation: sulcal depth of a cortex")
def cortex_regions(sheet: Sheet) -> None:
    sheet.text(
        "Convex Chan-Vese (section 8.1): regions of nearly constant value with short boundaries. The fidelity weighs the image against the "
        "length of the boundary, and a path over fidelities shows what it does: one sparse factor serves all of them. Each answer "
        "comes with a proof, a dual field whose value bounds the energy from below; the relative gap bounds the distance from the optimum."
    )
    mesh = bt.examples.cortex("pial")
    depth = mesh.data["depth"] / np.ptp(mesh.data["depth"])
    fidelities = (450.0, 800.0, 4000.0)
    start = time.perf_counter()
    path = bt.segment_path(mesh, depth, fidelities=fidelities)
    seconds = time.perf_counter() - start
    sheet.figures(
        {"vertices": len(mesh.vertices), "seconds for all three": seconds, "largest relative gap, proved": max(r.gap for r in path)}
    )
    sheet.code("path = bt.segment_path(cortex, depth, fidelities=[450, 800, 4000])\npath[1].plot(depth, path='sulci.png')")
    rows = [(r.fidelity, len(r.contours), r.contour_length, 100 * r.areas[1] / r.areas.sum(), r.gap, r.iterations) for r in path]
    header = ("fidelity", "contours", "their length (mm)", "share of region 1 (%)", "relative gap", "iterations")
    sheet.table(header, rows, caption="What the fidelity does.")
    for r, word in zip(path, ("small", "middle", "large"), strict=True):
        sheet.picture(
            mesh,
            {"sulcal depth (range 1)": depth},
            views={"lateral": "left", "medial": "right"},
            up="z",
            lines=r.contours,
            title=f"Fidelity {r.fidelity:g} ({word}): {len(r.contours)} contours of {r.contour_length:,.0f} mm in all",
            caption=f"The contours are closed curves on the surface. Gap {r.gap:.1e} after {r.iterations} iterations.",
            interactive=word == "middle",
            size=(1600, 700),
        )
    thick = mesh.data["thickness"]
    three = bt.segment(mesh, thick, fidelity=60.0, regions=3, tolerance=1e-3)
    sheet.picture(
        mesh,
        three.labels,
        views={"lateral": "left", "medial": "right"},
        up="z",
        lines=three.contours,
        labels=[f"{mean:.2f} mm" for mean in three.means[:, 0]],
        title="Cortical thickness in three regions",
        caption=f"Three memberships on the simplex, means estimated. Gap {three.gap:.1e} after {three.iterations} iterations.",
        size=(1600, 700),
    )


@section("Segmentation and denoising: colours and noise")
def colours(sheet: Sheet) -> None:
    sheet.text(
        "Images may have several channels. Spot's painted patches are found from her colours; and total variation takes strong noise "
        "off them while their outlines stay sharp, all three channels sharing one gradient length."
    )
    spot = bt.examples.spot()
    colour = np.asarray(spot.data["colors"], float)[:, :3]
    colour = colour / 255 if colour.max() > 1 else colour
    noisy = colour + 0.25 * np.random.default_rng(1).normal(size=colour.shape)
    r = bt.segment(spot, noisy, fidelity=60.0, regions=2)
    u = bt.denoise(spot, noisy, fidelity=150.0)
    before, after = (float(np.sqrt(np.mean(np.square(x - colour)))) for x in (noisy, u.image))
    sheet.figures(
        {
            "error of the noisy colours (rms)": before,
            "error of the denoised ones": after,
            "gap of the denoising": u.gap,
            "gap of the segmentation": r.gap,
        }
    )
    sheet.code("u = bt.denoise(spot, noisy, fidelity=150)\nr = bt.segment(spot, noisy, fidelity=60)")
    sheet.picture(
        spot,
        {"noisy": np.clip(noisy, 0, 1), "denoised": np.clip(u.image, 0, 1), "two regions": r.labels},
        views=["three-quarter back"],
        lines=r.contours,
        title="Noise of a quarter of the range, taken off Spot's colours",
        caption="Left to right: noisy colours, denoised, two regions; the curve is their common boundary.",
        size=(1600, 640),
    )
    # A picture made here: continents as level sets of a random smooth function, a known truth to be wrong about.
    sphere = bt.shapes.sphere(6)
    p, rng = sphere.vertices, np.random.default_rng(5)
    waves = rng.normal(size=(24, 3)) * 3.0
    height = np.cos(p @ waves.T + rng.uniform(0, 2 * np.pi, 24)).sum(1)
    land = height > np.quantile(height, 0.7)
    image = land + 0.4 * rng.normal(size=len(p))
    start = time.perf_counter()
    found = bt.segment(sphere, image, fidelity=300.0)
    seconds = time.perf_counter() - start
    mass = bt.operators(sphere).mass

    def wrong(labels: Any) -> float:
        return float(100 * mass @ (labels != land) / mass.sum())

    sheet.figures(
        {
            "vertices": len(p),
            "seconds": seconds,
            "relative gap": found.gap,
            "wrong area by thresholding (%)": wrong(image > 0.5),
            "wrong area by segmentation (%)": wrong(found.labels),
        }
    )
    sheet.picture(
        sphere,
        {"image": image, "segmentation": found.labels},
        views=[tuple(p[land].mean(axis=0))],
        lines=found.contours,
        line_width=2.5,
        title="Land and sea under noise of 0.4 of the contrast",
        caption=f"A made-up planet. {len(found.contours)} coastlines of {found.contour_length:.1f} radii in all.",
        size=(1600, 760),
    )
