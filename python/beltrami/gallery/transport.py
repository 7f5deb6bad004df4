"""Optimal transport and mean-field games."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import beltrami as bt

from ..transport.flow import DENSITY_COLOURS
from ..view import Picture
from ..view.film import film
from . import Sheet, section


def _bump(mesh: bt.TriangleMesh, vertex: int, width: float) -> Any:
    """Unit mass around a vertex; zero beyond twice the width (in roots of the area)."""
    mass = bt.operators(mesh, laplacian="cotangent").mass
    distance = bt.geodesic_distance(mesh, vertex) / (width * np.sqrt(mass.sum()))
    density = np.maximum(1 - distance**2 / 4, 0.0) ** 2
    return density / (mass @ density)


def _punctured(mesh: bt.TriangleMesh, centre: Any, reach: float) -> bt.TriangleMesh:
    """The unit sphere without what is nearer than ``reach`` to a place on it; the rim is moved onto a circle."""
    away = np.linalg.norm(mesh.vertices - centre, axis=1)
    cut = mesh.submesh(away > reach).largest_component()
    rim = np.unique(np.concatenate(cut.boundary_loop_vertices))
    rim = rim[np.linalg.norm(cut.vertices[rim] - centre, axis=1) < 1.4 * reach]
    vertices, axis = cut.vertices.copy(), centre / np.linalg.norm(centre)
    aside = vertices[rim] - (vertices[rim] @ axis)[:, None] * axis
    angle = 2 * np.arcsin(reach / 2)
    vertices[rim] = np.cos(angle) * axis + np.sin(angle) * aside / np.linalg.norm(aside, axis=1, keepdims=True)
    return bt.TriangleMesh(vertices, cut.faces)


@section("Optimal transport: mass that moves over a surface")
def moving_mass(sheet: Sheet) -> None:
    sheet.text(
        "Two densities and the cheapest way from one to the other (section 8.2): densities at vertices and times, momenta on triangles, "
        "the continuity equation satisfied to rounding and no density below zero. The cost of the path is an upper bound; a potential that "
        "satisfies the Hamilton-Jacobi inequality proves a lower one. The mass is compact: outside of it there is nothing at all."
    )
    rows = []
    spot = bt.examples.spot()
    tail, muzzle = int(np.argmax(spot.vertices[:, 2])), int(np.argmin(spot.vertices[:, 2]))
    cortex = bt.examples.cortex("pial")
    front, back = int(np.argmax(cortex.vertices[:, 1])), int(np.argmin(cortex.vertices[:, 1]))
    ball = bt.shapes.sphere(4)
    punctured = _punctured(_punctured(ball, np.array([0.0, 0.0, 1.0]), 0.45), np.array([0.9, 0.0, -0.43]), 0.5)
    west, east = (int(np.argmax(punctured.vertices @ np.array(d))) for d in ((0.75, -0.6, 0.3), (0.75, 0.6, -0.1)))
    cases: tuple[Any, ...] = (
        ("Spot", spot, tail, muzzle, 0.10, "left", "y", 16, 1e-2),
        ("sphere with two holes", punctured, west, east, 0.10, "right", "z", 16, 1e-2),
        ("cortex", cortex, front, back, 0.12, "left", "z", 12, 3e-2),
    )
    for name, mesh, a, b, width, view, up, intervals, tolerance in cases:
        start = time.perf_counter()
        r = bt.transport(mesh, _bump(mesh, a, width), _bump(mesh, b, width), intervals=intervals, tolerance=tolerance)
        seconds = time.perf_counter() - start
        rows.append((name, len(mesh.vertices), intervals, r.distance, r.gap, r.iterations, r.continuity_residual, seconds))
        times = np.linspace(0, 1, 5)
        dense = np.flatnonzero(r.density[0] > 0.25 * r.density[0].max())
        first = dense[bt.farthest_points(mesh.vertices[dense], min(14, len(dense)))] if name != "cortex" else np.zeros(0, int)
        tracks = r.particle_paths(first, substeps=3)
        sheet.picture(
            bt.examples.cortex("infl") if name == "cortex" else mesh,
            {f"t = {t:g}": r.interpolate(float(t)) for t in times},
            views=[view],
            up=up,
            colormap=DENSITY_COLOURS,
            limits=(0.0, float(np.quantile(r.density[r.density > 0], 0.98 if name == "cortex" else 0.995))),
            lines=list(tracks.transpose(1, 0, 2)) or None,
            line_color="#27506b",
            line_width=2.0,
            title=f"{name}: W2 = {r.distance:.4g}, gap {100 * r.gap:.2g} %",
            caption=f"{len(mesh.vertices):,} vertices, {intervals} intervals."
            + (" The lines are paths of particles." if len(first) else " Computed on the folded surface, shown on the inflated one."),
            size=(1800, 480),
        )
        if name == "Spot":
            moments = np.linspace(0, 1, intervals + 1)
            frames = [
                bt.plot(
                    mesh,
                    r.interpolate(float(t)),
                    views=[view],
                    up=up,
                    colormap=DENSITY_COLOURS,
                    limits=(0.0, float(r.density.max())),
                    label="density",
                    size=(900, 700),
                )
                for t in moments
            ]
            pictures = [frame for frame in frames if isinstance(frame, Picture)]
            sheet.page(film(pictures, [f"t = {t:.2f}" for t in moments], title="Mass moving over Spot"), "Move through time")
    sheet.table(("shape", "vertices", "intervals", "W2", "gap, proved", "iterations", "continuity residual", "seconds"), rows)
    sheet.code("r = bt.transport(mesh, density0, density1, intervals=16)\nr.plot(path='flow.html')   # a slider through time")


@section("Mean-field games: obstacles, crowds, averages")
def crowds(sheet: Sheet) -> None:
    sheet.text(
        "A crowd pays for moving, for its location and for its final density. A wall that costs a hundred times as much to cross sends it "
        "through the door; congestion spreads it out on the way. The gap is proved here too."
    )
    grid = bt.shapes.grid(51, 51)
    mass = bt.operators(grid).mass
    middle = grid.vertices[grid.faces].mean(axis=1)
    wall = (np.abs(middle[:, 0] - 0.5) < 0.04) & (np.abs(middle[:, 1] - 0.72) > 0.1)

    def hill(x: float, y: float) -> Any:
        density = np.exp(-60 * ((grid.vertices[:, :2] - [x, y]) ** 2).sum(1)) + 0.01
        return density / (mass @ density)

    start, end = hill(0.2, 0.4), hill(0.8, 0.35)
    rows = []
    for title, running, weight in (
        ("A wall with a door, crowds cost little", bt.costs.congestion(0.01), np.where(wall, 100.0, 1.0)),
        ("The same door, crowds are dear", bt.costs.congestion(0.1), np.where(wall, 100.0, 1.0)),
    ):
        r = bt.mean_field_game(grid, start, end, intervals=16, running_cost=running, lagrangian=bt.costs.kinetic(weight), tolerance=5e-3)
        rows.append((title, r.kinetic, r.running, r.gap, r.iterations))
        sheet.picture(
            grid,
            {f"t = {t:g}": r.interpolate(float(t)) for t in np.linspace(0, 1, 5)},
            colormap=DENSITY_COLOURS,
            limits=(0.0, float(np.quantile(r.density, 0.992))),
            lines=[np.array([[x, low, 0.001], [x, high, 0.001]]) for x in (0.46, 0.54) for low, high in ((0, 0.62), (0.82, 1))],
            line_color="#333333",
            title=title,
            caption=f"Kinetic cost {r.kinetic:.4g}, gap {r.gap:.1e} after {r.iterations} iterations. The lines are the wall.",
            views=["front"],
            shading=False,
            size=(1800, 480),
        )
    sheet.table(("game", "kinetic cost", "running cost", "gap, proved", "iterations"), rows)
    x, y = np.abs(grid.vertices[:, :2] - 0.5).T
    far, wide, high = np.hypot(x, y), np.maximum(x - 0.36, y - 0.08), np.maximum(x - 0.08, y - 0.36)
    outlines = np.abs(far - 0.3) - 0.05, np.minimum(wide, high)  # negative inside: a ring, a cross
    ring, cross = (1 / (1 + np.exp(outline / 0.012)) for outline in outlines)
    ends = [ring / (mass @ ring), cross / (mass @ cross)]
    shown, gaps = {"ring": ends[0]}, []
    for share in (0.25, 0.5, 0.75):
        b = bt.wasserstein_barycenter(grid, ends, weights=[1 - share, share], intervals=4, tolerance=3e-2)
        shown[f"{100 - 100 * share:g} % ring, {100 * share:g} % cross"] = b.density
        gaps.append(b.gap)
    sheet.picture(
        grid,
        {**shown, "cross": ends[1]},
        colormap=DENSITY_COLOURS,
        limits=(0.0, float(max(end.max() for end in ends))),
        views=["front"],
        shading=False,
        title="Barycenters of a ring and a cross",
        caption=f"The densities with the least weighted sum of squared distances to both; gaps at most {max(gaps):.1e}.",
        size=(1800, 480),
    )
    sheet.code("r = bt.mean_field_game(grid, start, end, running_cost=bt.costs.congestion(0.1), lagrangian=bt.costs.kinetic(weight))")
