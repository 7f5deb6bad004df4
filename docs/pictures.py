"""Paints docs/images: `python docs/pictures.py`. Spot is by Keenan Crane (CC0); the other shapes are made by the library."""

from pathlib import Path

import beltrami as bt

FOLDER = Path(__file__).resolve().parent / "images"


def main() -> None:
    """All pictures of the pages."""
    spot, torus = bt.examples.spot(), bt.shapes.torus(rows=90, columns=40)
    front, tail = "three-quarter back", int(spot.vertices[:, 2].argmax())  # Spot looks along -z
    distance = bt.geodesic_distance(spot, tail)
    modes = bt.eigenpairs(spot, 8)
    bt.plot(spot, distance, contours=20, points=[tail], label="distance", views=[front, "three-quarter"],
            size=(940, 440), path=FOLDER / "distance.png")  # fmt: skip
    bt.plot(spot, {f"λ = {modes.values[at]:.1f}": modes.functions[:, at] for at in (1, 4, 7)}, contours=[0.0], color_bar=False, views=front,
            size=(1000, 400), path=FOLDER / "modes.png")  # fmt: skip
    source = torus.vertices[:, 0] * torus.vertices[:, 1]
    bt.plot(torus, bt.solve_poisson(torus, source), contours=14, up="z", label="u", size=(700, 400), path=FOLDER / "poisson.png")
    bt.plot(bt.shapes.figure_eight(resolution=8), up="z", edges=True, views=["top"], size=(560, 300), path=FOLDER / "figure_eight.png")


if __name__ == "__main__":
    main()
