"""Paints docs/images: `python docs/pictures.py [NAME ...]`. Spot is by Keenan Crane (CC0); the other shapes are made by the library."""

import sys
from collections.abc import Callable
from pathlib import Path

import beltrami as bt
import numpy as np

FOLDER = Path(__file__).resolve().parent / "images"
FRONT = "three-quarter back"  # Spot looks along -z
SIDES = {"front": FRONT, "back": "three-quarter"}


def distance(path: Path) -> None:
    spot = bt.examples.spot()
    tail = int(spot.vertices[:, 2].argmax())
    values = bt.geodesic_distance(spot, tail)
    bt.plot(spot, values, contours=20, points=[tail], label="distance", views=SIDES, size=(940, 440), path=path)


def modes(path: Path) -> None:
    spot = bt.examples.spot()
    found = bt.eigenpairs(spot, 8)
    fields = {f"λ = {found.values[at]:.1f}": found.functions[:, at] for at in (1, 4, 7)}
    bt.plot(spot, fields, contours=[0.0], color_bar=False, views=FRONT, size=(1000, 400), path=path)


def poisson(path: Path) -> None:
    torus = bt.shapes.torus(rows=90, columns=40)
    source = torus.vertices[:, 0] * torus.vertices[:, 1]
    bt.plot(torus, bt.solve_poisson(torus, source), contours=14, up="z", label="u", size=(700, 400), path=path)


def figure_eight(path: Path) -> None:
    bt.plot(bt.shapes.figure_eight(resolution=8), up="z", edges=True, views=["top"], size=(560, 300), path=path)


def point_cloud(path: Path) -> None:
    cloud = bt.PointCloud(bt.examples.spot().vertices)
    ops = bt.operators(cloud)
    fields = {"third eigenfunction": bt.eigenpairs(ops, 4).functions[:, 3], "distance to a point": bt.geodesic_distance(ops, 0)}
    bt.plot(cloud, fields, views=FRONT, color_bar=False, size=(900, 440), path=path)


def segmentation(path: Path) -> None:
    spot = bt.examples.spot()
    noisy = spot.data["colors"][:, :3] / 255 + 0.25 * np.random.default_rng(0).normal(size=(len(spot.vertices), 3))
    clean = bt.denoise(spot, noisy, fidelity=80.0).image
    found = bt.segment(spot, noisy, fidelity=60.0)
    fields = {"noisy": noisy.clip(0, 1), "denoised": clean.clip(0, 1), "two regions": found.labels}
    bt.plot(spot, fields, views=FRONT, lines=found.contours, line_width=2.0, color_bar=False, size=(1000, 400), path=path)


def spherical_map(path: Path) -> None:
    bt.spherical_map(bt.examples.spot()).plot(views={"three-quarter": FRONT, "front": "back", "left": "left"}, size=(1000, 400), path=path)


def transport(path: Path) -> None:
    spot = bt.examples.spot()
    ends = []
    for vertex in (spot.vertices[:, 2].argmin(), spot.vertices[:, 2].argmax()):
        away = bt.geodesic_distance(spot, int(vertex)) / (0.1 * np.sqrt(spot.area))
        ends.append(np.maximum(1 - away**2 / 4, 0.0) ** 2)
    found = bt.transport(spot, *ends, intervals=16, normalize=True, tolerance=1e-2)
    found.plot(times=5, views="left", color_bar=False, limits=(0.0, 1.0), size=(1000, 260), path=path)


def skeleton(path: Path) -> None:
    bt.skeleton(bt.shapes.knot()).plot(views="front", line_width=3.0, size=(700, 460), path=path)


def registration(path: Path) -> None:
    spot = bt.examples.spot()
    x, y, z = spot.vertices.T
    radius = np.ptp(y) / 0.8
    order = np.random.default_rng(1).permutation(len(x))
    bent = np.stack([(radius + x) * np.cos(y / radius), (radius + x) * np.sin(y / radius), z], 1)[order]
    bt.register(spot, bt.TriangleMesh(bent, np.argsort(order)[spot.faces])).plot(views="back", size=(700, 420), path=path)


def conformal_registration(path: Path) -> None:
    spot = bt.examples.spot()
    away = spot.vertices - spot.vertices.mean(0) - np.array([1.2, 1.1, 0.5])
    square = (away**2).sum(1)
    inverted = bt.TriangleMesh(away / square[:, None] * [1, 1, -1], spot.faces)
    marks = bt.farthest_points(spot, 4)
    found = bt.register_conformal(spot, inverted, landmarks=np.stack([marks, marks], axis=1))
    exact = 2 * np.log(square)
    fields = {"found": found.log_factor, "exact": exact + np.median(found.log_factor - exact)}
    limits = float(found.log_factor.min()), float(found.log_factor.max())
    bt.plot(inverted, fields, label="log w²", limits=limits, views="right", size=(900, 340), path=path)


def committor(path: Path) -> None:
    def energy(p: np.ndarray) -> np.ndarray:
        x, y = p.T
        up, down = (y - 1 / 3) ** 2, (y - 5 / 3) ** 2
        sides = np.exp(-((x - 1) ** 2)) + np.exp(-((x + 1) ** 2))
        wells = 3 * np.exp(-(x**2)) * (np.exp(-up) - np.exp(-down)) - 5 * np.exp(-(y**2)) * sides
        return np.asarray(wells + 0.2 * x**4 + 0.2 * (y - 1 / 3) ** 4)

    x = np.random.default_rng(0).uniform([-2, -1.5], [2, 2.5], (20_000, 2))
    x = x[energy(x) < 1.5]
    ends = [lambda p, at=at: np.hypot(p[:, 0] - at, p[:, 1] + 0.042) - 0.3 for at in (-1.048, 1.048)]
    found = bt.committor(bt.PointCloud(x), energy, *ends, beta=6.67)
    found.plot(streamlines=16, line_width=2.0, label="committor", size=(700, 460), path=path)


PICTURES: tuple[Callable[[Path], None], ...] = (
    distance, modes, poisson, figure_eight, point_cloud, segmentation, spherical_map, transport, skeleton, registration,
    conformal_registration, committor,
)  # fmt: skip


def main() -> None:
    """All pictures of the pages but scale.png and methods.png (`benches/`), or those that are named."""
    for paint in PICTURES:
        if not sys.argv[1:] or paint.__name__ in sys.argv[1:]:
            paint(FOLDER / f"{paint.__name__}.png")


if __name__ == "__main__":
    main()
