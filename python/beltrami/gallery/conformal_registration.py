"""Registration of shapes that are far from isometric."""

from __future__ import annotations

import time
from typing import Literal

import numpy as np

import beltrami as bt
from beltrami.arrays import Floats

from . import Sheet, research_data, section

HEADER = ("pair", "landmarks", "mean error / √area", "share below 0.05", "coverage", "orthonormality error", "map taken", "seconds")


def _match(
    name: str, source: bt.TriangleMesh, target: bt.TriangleMesh, count: int, start: Literal["auto", "spherical"] = "auto"
) -> tuple[bt.ConformalRegistrationResult, tuple[object, ...]]:
    """The map from vertex i to vertex i, with so many landmarks, and a row of the table."""
    marks = bt.farthest_points(source, count) if count else None
    began = time.perf_counter()
    pairs = None if marks is None else np.stack([marks, marks], axis=1)
    r = bt.register_conformal(source, target, landmarks=pairs, start=start)
    seconds = time.perf_counter() - began
    away = np.linalg.norm(target.vertices[r.point_map] - target.vertices, axis=1) / np.sqrt(target.area)
    return r, (name, count, float(away.mean()), float((away < 0.05).mean()), r.coverage, r.orthonormality_error, r.start, seconds)


def _beside(left: bt.TriangleMesh, right: bt.TriangleMesh, axis: int, across: Floats) -> bt.TriangleMesh:
    """Both shapes in one, of equal height along an axis, one beside the other in the direction ``across``."""
    placed, reach = [], 0.0
    for shape in (left, right):
        vertices = (shape.vertices - shape.vertices.mean(0)) / np.ptp(shape.vertices[:, axis])
        along = vertices @ across
        placed.append(vertices + (reach - along.min()) * across)
        reach += np.ptp(along) + 0.25
    return bt.TriangleMesh(np.concatenate(placed), np.concatenate([left.faces, right.faces + len(left.vertices)]))


@section("Matching shapes that are far from isometric")
def known(sheet: Sheet) -> None:
    sheet.text(
        "A conformal change of the metric changes areas and keeps the stiffness matrix. So for any factor w² on the target there is a "
        "basis that costs one eigenproblem, and with the right factor it is the source's own. `bt.register_conformal` finds the factor: "
        "through the spherical conformal maps of both shapes, in depths and angles that no Möbius map changes, then by the "
        "alternation of Schonsheck, Bronstein and Lai between basis and factor. The map taken is the one whose factor is smoothest."
    )
    spot = bt.examples.spot()
    d = spot.vertices - (spot.vertices.mean(0) + np.array([1.2, 1.1, 0.5]))
    square = (d**2).sum(1)
    inverted = bt.TriangleMesh(d / square[:, None] * [1, 1, -1], spot.faces)
    r, first = _match("Spot, inverted in a point beside it", spot, inverted, 4)
    _, second = _match("the same, nothing given", spot, inverted, 0)
    sheet.table(HEADER, [first, second], "The inversion x / |x|² is conformal, so that map and factor are known")
    sheet.code(
        "r = bt.register_conformal(source, target, landmarks=pairs)     # pairs: (k, 2), or none\n"
        "r.point_map, r.inverse_map, r.log_factor, r.basis, r.confidence\n"
        'r.plot("log_factor", path="factor.png")\nr.plot(source.vertices[:, 1], path="height.png")'
    )
    exact = 2 * np.log(square)
    exact += np.median(r.log_factor - exact)
    sheet.picture(
        inverted,
        {"log w², found": r.log_factor, "exact": exact},
        limits=(float(exact.min()), float(exact.max())),
        views=["right"],
        title="Spot inverted in a point: the factor",
        caption="Parts near the point have grown. Left: found from four landmarks; right: the closed form.",
        size=(1600, 760),
        interactive=True,
    )
    height = spot.vertices[:, 1]
    lines = list(np.linspace(height.min(), height.max(), 12)[1:-1])
    sheet.picture(
        _beside(spot, inverted, 1, np.array([0.0, 0.0, -1.0])),
        {"height": np.concatenate([height, r.push_forward(height)])},
        contours=lines,
        views=["right"],
        title="A function on Spot, and transferred by the map",
        caption="Left: height above ground. Right: the same on the image, which lies on its back.",
        size=(1600, 760),
    )


@section("A cortex and its sphere")
def cortex(sheet: Sheet) -> None:
    pial, sphere = bt.examples.cortex("pial"), bt.examples.cortex("sphere")
    sheet.text(
        "FreeSurfer's sphere of a cortex is not a conformal image of it: areas are evened out. Five landmarks are given, and with "
        "`start='spherical'` near-isometric matching is not tried. The errors of the conformal start are reduced by stretching the map "
        "along protrusions and refining it in the metric of its own factor."
    )
    r, row = _match("pial cortex to FreeSurfer's sphere", pial, sphere, 5, start="spherical")
    sheet.table(HEADER, [row], "Truth: the vertex of the same number; straight distances")
    factor = r.log_factor - np.median(r.log_factor)
    span = float(np.quantile(np.abs(factor), 0.995))
    sheet.picture(
        sphere,
        {"log w²": factor},
        views={"lateral": "left", "medial": "right", "dorsal": "top"},
        up="z",
        colormap="balance",
        limits=(-span, span),
        title="The factor with which the sphere becomes the cortex",
        caption="Where it is high, the sphere has too little room for what is there.",
        size=(1600, 760),
    )
    depth = pial.data["depth"]
    span = float(np.abs(depth).max())
    sheet.picture(
        sphere,
        {"sulcal depth through the map": r.push_forward(depth), "by the anatomy": depth},
        views=["left"],
        up="z",
        colormap="balance",
        limits=(-span, span),
        title="Sulcal depth of the cortex on the sphere",
        caption="Left: transferred by the map found from five landmarks. Right: the truth.",
        size=(1600, 760),
    )


@section("A gorilla and a man")
def apes(sheet: Sheet) -> None:
    files = research_data(*(f"registration/noniso5k/8_{name}_01.npz" for name in ("gorilla", "man")))
    if files is None:
        sheet.text(
            "The shapes of this section are research data that do not come with the package: set `BELTRAMI_DATA` to a folder with "
            "`registration/noniso5k/8_gorilla_01.npz` and `8_man_01.npz` (V, F, corr: the vertices of common samples)."
        )
        return
    shapes, samples = [], []
    for file in files:
        with np.load(file) as data:
            shapes.append(bt.TriangleMesh(data["V"].astype(float), data["F"]))
            samples.append(data["corr"].astype(np.int64))
    gorilla, man = shapes
    spread = bt.farthest_points(gorilla.vertices[samples[0]], 5)
    marks = np.stack([samples[0][spread], samples[1][spread]], axis=1)
    rows = []
    for name, match in (
        ("conformal", lambda: bt.register_conformal(gorilla, man, landmarks=marks, start="spherical")),
        ("register", lambda: bt.register(gorilla, man, landmarks=marks)),
    ):
        began = time.perf_counter()
        found = match()
        seconds = time.perf_counter() - began
        away = np.linalg.norm(man.vertices[found.point_map[samples[0]]] - man.vertices[samples[1]], axis=1) / np.sqrt(man.area)
        rows.append((name, float(away.mean()), float((away < 0.05).mean()), seconds))
        if isinstance(found, bt.ConformalRegistrationResult):
            r = found
    sheet.text(
        "Far from isometric and not conformal either: arms and legs differ in length and girth. Five landmarks are given; the limbs' "
        "other tips are found, and the map with the smoothest factor is taken."
    )
    sheet.table(("method", "mean error / √area", "share below 0.05", "seconds"), rows, "At 900 common samples, straight distances")
    height = gorilla.vertices[:, 2]
    sheet.picture(
        _beside(gorilla, man, 2, np.array([1.0, 0.0, 0.0])),
        {"height on the gorilla": np.concatenate([height, r.push_forward(height)])},
        up="z",
        views="front",
        contours=12,
        title="A function on the gorilla, and transferred to the man",
        caption="The height of the gorilla's points, on the gorilla and, by the map, on the man: shoulders on shoulders, knees on knees.",
        size=(1600, 760),
    )
    factor = r.log_factor - np.median(r.log_factor)
    span = float(np.quantile(np.abs(factor), 0.99))
    sheet.picture(
        man,
        {"log w²": factor},
        up="z",
        views=["front", "back"],
        limits=(-span, span),
        colormap="balance",
        title="The factor with which the man becomes the gorilla",
        caption="Where it is high, the gorilla has more area: arms and trunk against legs.",
        size=(1600, 760),
    )


@section("A factor for a spectrum")
def spectra(sheet: Sheet) -> None:
    sheet.text(
        "The inverse problem: a conformal factor that gives a shape prescribed eigenvalues. Here a sphere gets the first "
        "twelve of an ellipsoid. It is one factor of many, for a spectrum does not say where things are."
    )
    sphere = bt.shapes.sphere(4)
    wanted = bt.eigenpairs(bt.shapes.ellipsoid(1.0, 0.8, 0.6, level=4), 12).values
    r = bt.match_spectrum(sphere, wanted)
    before = bt.eigenpairs(sphere, 12).values
    sheet.figures({"relative error of the spectrum": r.error, "before": float(np.abs(before[1:] / wanted[1:] - 1).max())})
    span = float(np.abs(r.log_factor).max())
    sheet.picture(
        sphere,
        {"log w²": r.log_factor},
        views=["front", "right", "top", "bottom"],
        limits=(-span, span),
        colormap="balance",
        contours=[k * span / 6 for k in range(-5, 6)],
        title="A sphere with an ellipsoid's spectrum",
        caption="Its factor: where it is high, the sphere has grown.",
        size=(1600, 520),
    )
