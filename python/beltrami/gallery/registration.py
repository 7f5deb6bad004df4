"""Registration of nearly isometric shapes; distances within a collection."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import beltrami as bt

from . import Sheet, section


def bent(mesh: bt.TriangleMesh, angle: float, *, twist: float = 0.0) -> bt.TriangleMesh:
    """The mesh bent sideways by an angle over its height, and twisted."""
    x, y, z = (mesh.vertices - mesh.vertices.mean(0)).T
    height = np.ptp(y)
    turn = twist * y / height
    x, z = x * np.cos(turn) - z * np.sin(turn), x * np.sin(turn) + z * np.cos(turn)
    if angle == 0:
        return bt.TriangleMesh(np.stack([x, y, z], 1), mesh.faces)
    radius = height / angle
    return bt.TriangleMesh(np.stack([(radius + x) * np.cos(y / radius) - radius, (radius + x) * np.sin(y / radius), z], 1), mesh.faces)


def shuffled(mesh: bt.TriangleMesh, seed: int) -> tuple[bt.TriangleMesh, np.ndarray]:
    """The mesh with its vertices in another order, and where each went."""
    order = np.random.default_rng(seed).permutation(len(mesh.vertices))
    place = np.argsort(order)
    return bt.TriangleMesh(mesh.vertices[order], place[mesh.faces].astype(np.int32)), place


@section("Matching shapes that differ by a bending")
def matching(sheet: Sheet) -> None:
    sheet.text(
        "Surfaces that differ by bending have the same eigenfunctions up to signs and rotations. `bt.register` finds these from triple "
        "products, which also tell left from right, refines the best candidates in both directions, and lets the energy of the deformation "
        "decide. No landmark is given; the vertices of the second shape are renumbered."
    )
    spot = bt.examples.spot()
    rows = []
    shown = []
    for name, shape, method in (
        ("bent by 46°", bent(spot, 0.8), "auto"),
        ("bent by 46°, the chapter's RSWD alone", bent(spot, 0.8), "rswd"),
        ("twisted by 69°, bent by 23°", bent(spot, 0.4, twist=1.2), "auto"),
    ):
        target, truth = shuffled(shape, 1)
        start = time.perf_counter()
        r = bt.register(spot, target, method=method, rng=0)  # type: ignore[arg-type]
        seconds = time.perf_counter() - start
        score = bt.evaluate_map(r.point_map, spot, target, truth=truth, points=300)
        rows.append((name, score.mean, 100 * float(score.curve([0.05])[0]), 100 * r.coverage, r.bijectivity, r.orientation, seconds))
        shown.append(r)
    header = ("Spot and Spot", "mean error / √area", "below 0.05 (%)", "coverage (%)", "there and back / √area", "orientation", "seconds")
    sheet.table(header, rows, "Geodesic errors at 300 points")
    sheet.code(
        "r = bt.register(source, target)\nr.point_map, r.functional_map, r.coverage, r.candidates\n"
        "r.transfer(colors)                # from the target to the source\nr.plot(path='map.png')"
    )
    for r, title in ((shown[0], "Spot and Spot bent"), (shown[2], "Spot and Spot twisted")):
        both, colours = r.side_by_side()
        caption = "Matched points have the same colour; colours show positions on the target."
        sheet.picture(both, colours, views=["back"], title=title, caption=caption, size=(1600, 800), interactive=True)


@section("A map of a collection")
def collection(sheet: Sheet) -> None:
    sheet.text(
        "Distances between all pairs of a collection: rotation-invariant sliced Wasserstein between the eigenmaps. Bending, size and "
        "numbering do not matter, so poses of the same body are close to each other. Any executor does the work; interrupted runs resume."
    )
    shapes, names, kinds = [], [], []
    for kind, shape in (("Spot", bt.examples.spot()), ("Bob", bt.examples.bob()), ("star", bt.shapes.star(resolution=8))):
        for number, (angle, twist) in enumerate(((0.0, 0.0), (0.8, 0.0), (0.4, 0.8))):
            shapes.append(shuffled(bent(shape, angle, twist=twist), number)[0])
            names.append(f"{kind} {number + 1}")
            kinds.append(kind)
    start = time.perf_counter()
    with ThreadPoolExecutor(2) as pool:
        d = bt.distance_matrix(shapes, labels=names, executor=pool)
    seconds = time.perf_counter() - start
    right = int(sum(kinds[j] == kinds[i] for i, j in enumerate(d.nearest()[:, 0])))
    sheet.figures({"shapes": len(shapes), "nearest neighbour of the own kind": right, "seconds": seconds})
    sheet.code("d = bt.distance_matrix(shapes, executor=pool, checkpoint='run')\nd.embed(), d.nearest(), d.plot('dendrogram')")
    places = d.embed(2)
    span = np.ptp(places, axis=0).max()
    for _ in range(300):  # apart where they would hide one another
        away = places[:, None] - places[None]
        gap = np.maximum(np.linalg.norm(away, axis=2), 1e-9 * span)
        push = np.maximum(0.2 * span - gap, 0)
        places = places + 0.25 * ((push / gap)[:, :, None] * away).sum(1)
    spots, faces, colours, total = [], [], [], 0
    for shape, place, kind in zip(shapes, places, kinds, strict=True):
        size = 0.16 * span / np.ptp(shape.vertices, axis=0).max()
        spots.append(size * (shape.vertices - shape.vertices.mean(0)) + [-place[0], place[1], 0.0])  # seen from the back
        faces.append(shape.faces + total)
        colours.append(np.full(len(shape.vertices), sorted(set(kinds)).index(kind)))
        total += len(shape.vertices)
    sheet.picture(
        bt.TriangleMesh(np.concatenate(spots), np.concatenate(faces)),
        np.concatenate(colours),
        views=["back"],
        labels=sorted(set(kinds)),
        title="The collection, laid out by its distances",
        caption="Classical multidimensional scaling of the distances; shapes that would hide one another are moved apart.",
        size=(1600, 680),
    )
    rows = [(names[i], names[j], float(d[i, j])) for i, j in enumerate(d.nearest()[:, 0])]
    sheet.table(("shape", "its nearest", "distance"), rows)
