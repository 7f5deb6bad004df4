"""Optimal transport and mean-field games."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import beltrami as bt

from ..transport import DENSITY_COLOURS
from ..transport.film import film
from ..view import Picture
from . import Sheet, section


def _bump(mesh: bt.TriangleMesh, vertex: int, width: float) -> Any:
    """Unit mass around a vertex; zero beyond twice the width (in roots of the area)."""
    mass = bt.operators(mesh, laplacian="cotangent").mass
    distance = bt.geodesic_distance(mesh, vertex) / (width * np.sqrt(mass.sum()))
    density = np.maximum(1 - distance**2 / 4, 0.0) ** 2
    return density / (mass @ density)


@section("Optimal transport: mass that moves over a surface")
def moving_mass(sheet: Sheet) -> None:
    sheet.text(
        "Two densities and the cheapest way from one to the other (section 8.2): densities at vertices and times, momenta on triangles, "
        "the continuity equation satisfied to rounding and no density below zero. The cost of the path is an upper bound; a potential that "
        "satisfies the Hamilton-Jacobi inequality proves a lower one. The mass is compact: outside of it there is nothing at all."
    )
    rows = []
    spot = bt.examples.spot()
    head, tail = int(np.argmax(spot.vertices[:, 2])), int(np.argmin(spot.vertices[:, 2]))
    cortex = bt.examples.cortex("pial")
    front, back = int(np.argmax(cortex.vertices[:, 1])), int(np.argmin(cortex.vertices[:, 1]))
    ball = bt.shapes.sphere(4)
    keep = (np.linalg.norm(ball.vertices - [0, 0, 1], axis=1) > 0.45) & (np.linalg.norm(ball.vertices - [0.9, 0, -0.43], axis=1) > 0.5)
    punctured = ball.submesh(keep).largest_component()
    west, east = (int(np.argmax(punctured.vertices @ np.array(d))) for d in ((0.75, -0.6, 0.3), (0.75, 0.6, -0.1)))
    cases: tuple[Any, ...] = (
        ("Spot", spot, head, tail, 0.10, "left", "y", 16, 1e-2),
        ("sphere with two holes", punctured, west, east, 0.10, "right", "z", 16, 1e-2),
        ("cortex", cortex, front, back, 0.12, "left", "z", 12, 3e-2),
    )
    for name, mesh, a, b, width, view, up, intervals, tolerance in cases:
        start = time.perf_counter()
        r = bt.transport(mesh, _bump(mesh, a, width), _bump(mesh, b, width), intervals=intervals, tolerance=tolerance)
        seconds = time.perf_counter() - start
        rows.append((name, len(mesh.vertices), intervals, r.distance, r.gap, r.iterations, r.continuity_residual, seconds))
        times = np.linspace(0, 1, 5)
        first = np.flatnonzero(r.density[0] > 0.6 * r.density[0].max())[:12] if name != "cortex" else np.zeros(0, int)
        tracks = r.particle_paths(first, substeps=3)
        sheet.picture(
            mesh,
            {f"t = {t:g}": r.interpolate(float(t)) for t in times},
            views=[view],
            up=up,
            colormap=DENSITY_COLOURS,
            limits=(0.0, float(np.quantile(r.density[r.density > 0], 0.995))),
            lines=list(tracks.transpose(1, 0, 2)) or None,
            line_color="#27506b",
            line_width=2.0,
            title=f"{name}: W2 = {r.distance:.4g}, gap {100 * r.gap:.2g} %",
            caption=f"{len(mesh.vertices):,} vertices, {intervals} intervals."
            + (" The lines are paths of particles." if len(first) else ""),
            size=(1800, 620) if name != "cortex" else (1800, 520),
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
        "A crowd that pays for moving, for where it is and for where it ends. A wall that is a hundred times dearer to cross sends it "
        "through the door; congestion spreads it out on the way. The gap is proved here too."
    )
    grid = bt.shapes.grid(41, 41)
    mass = bt.operators(grid).mass
    middle = grid.vertices[grid.faces].mean(axis=1)
    wall = (np.abs(middle[:, 0] - 0.5) < 0.04) & (np.abs(middle[:, 1] - 0.72) > 0.1)

    def hill(x: float, y: float) -> Any:
        density = np.exp(-60 * ((grid.vertices[:, :2] - [x, y]) ** 2).sum(1)) + 0.01
        return density / (mass @ density)

    start, end = hill(0.2, 0.4), hill(0.8, 0.35)
    rows = []
    for title, running, weight in (
        ("A wall with a door", None, np.where(wall, 100.0, 1.0)),
        ("The same wall, and crowds are dear", bt.costs.congestion(0.5), np.where(wall, 100.0, 1.0)),
    ):
        r = bt.mean_field_game(grid, start, end, intervals=16, running_cost=running, lagrangian=bt.costs.kinetic(weight), tolerance=5e-3)
        rows.append((title, r.kinetic, r.running, r.gap, r.iterations))
        sheet.picture(
            grid,
            {f"t = {t:g}": r.interpolate(float(t)) for t in np.linspace(0, 1, 5)},
            colormap=DENSITY_COLOURS,
            limits=(0.0, float(np.quantile(r.density, 0.998))),
            lines=[np.array([[x, low, 0.001], [x, high, 0.001]]) for x in (0.46, 0.54) for low, high in ((0, 0.62), (0.82, 1))],
            line_color="#333333",
            title=title,
            caption=f"Kinetic cost {r.kinetic:.4g}, gap {r.gap:.1e} after {r.iterations} iterations. The lines are the wall.",
            views=["front"],
            shading=False,
            size=(1800, 480),
        )
    sheet.table(("game", "moving", "crowding", "gap, proved", "iterations"), rows)
    bob = bt.examples.bob()
    ends = [_bump(bob, int(np.argmax(bob.vertices @ np.array(d))), 0.1) for d in ((0.0, 1.0, 1.0), (1.0, -0.3, -0.6), (-1.0, -0.3, -0.6))]
    b = bt.wasserstein_barycenter(bob, ends, intervals=8, tolerance=1e-2)
    sheet.picture(
        bob,
        {**{f"density {k + 1}": end for k, end in enumerate(ends)}, "barycenter": b.density},
        colormap=DENSITY_COLOURS,
        limits=(0.0, float(max(end.max() for end in ends))),
        views=["top"],
        title="Barycenter of three densities on Bob",
        caption=f"Distances {', '.join(f'{d:.3g}' for d in b.distances)}; gap {b.gap:.1e} after {b.iterations} iterations.",
        size=(1800, 560),
    )
    sheet.code("r = bt.mean_field_game(grid, start, end, running_cost=bt.costs.congestion(0.5), lagrangian=bt.costs.kinetic(weight))")
