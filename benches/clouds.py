"""Convergence of the operators of point clouds on the unit sphere: moving least squares of degree 2 to 4, and the local mesh.

    python benches/clouds.py [largest] [--plot docs/images/cloud_convergence.png]

Errors of grad f and of Δf for f = x y + z³ (relative, rms), and the greatest relative error of the eigenvalues 2 to 36 with all their
copies, each the mean over three samples; slopes are fitted in the mean spacing (area / n)^(1/2). Points are evenly spread (a Poisson
disc sample), independent, or a grid of latitudes and longitudes, on which every cell is a tie between two diagonals.
"""

from __future__ import annotations

import argparse

import beltrami as bt
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
SIZES = [1000, 2000, 4000, 8000, 16000, 32000]
SAMPLES = 3


def evenly_spread(n: int, seed: int) -> Floats:
    points = independent(10 * n, seed)
    return np.ascontiguousarray(points[bt.poisson_disc(points, 0.745 * np.sqrt(4 * np.pi / n))])


def independent(n: int, seed: int) -> Floats:
    points = np.random.default_rng(seed).standard_normal((n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def grid(n: int, seed: int) -> Floats:
    rows = round(np.sqrt(n / 2)) + seed
    polar, angle = np.meshgrid(np.arange(1, rows) * np.pi / rows, np.arange(2 * rows) * np.pi / rows, indexing="ij")
    points = np.c_[(np.sin(polar) * np.cos(angle)).ravel(), (np.sin(polar) * np.sin(angle)).ravel(), np.cos(polar).ravel()]
    return np.r_[points, [[0, 0, 1], [0, 0, -1]]]


def least_squares_errors(points: Floats, degree: int) -> tuple[float, float]:
    ops = bt.operators(bt.PointCloud(points), laplacian="mls", degree=degree)
    x, y, z = points.T
    f, ambient = x * y + z**3, np.c_[y, x, 3 * z * z]
    gradient = ambient - points * (ambient * points).sum(1)[:, None]
    laplacian = -6 * x * y - 12 * z**3 + 6 * z
    off = (ops.gradient @ f).reshape(-1, 3) - gradient
    return (
        float(np.sqrt((off**2).sum() / (gradient**2).sum())),
        float(np.linalg.norm(ops.laplacian @ f - laplacian) / np.linalg.norm(laplacian)),
    )


def eigenvalue_error(points: Floats) -> float:
    exact = np.repeat([k * (k + 1.0) for k in range(6)], [2 * k + 1 for k in range(6)])
    return float(np.abs(bt.eigenpairs(bt.PointCloud(points), 36).values[1:] / exact[1:] - 1).max())


def measure(largest: int) -> tuple[list[int], dict[str, dict[str, list[float]]]]:
    """Errors by panel and curve, a number for each size."""
    sizes = [size for size in SIZES if size <= largest]
    found: dict[str, dict[str, list[float]]] = {"grad f, moving least squares": {}, "Δf, moving least squares": {}}
    for degree in (2, 3, 4):
        pairs = [np.mean([least_squares_errors(evenly_spread(n, seed), degree) for seed in range(SAMPLES)], axis=0) for n in sizes]
        for panel, errors in zip(found, np.transpose(pairs), strict=True):
            found[panel][f"degree {degree}"] = errors.tolist()
    found["eigenvalues, local mesh"] = {
        name: [float(np.mean([eigenvalue_error(make(n, seed)) for seed in range(SAMPLES)])) for n in sizes]
        for name, make in (("evenly spread", evenly_spread), ("independent", independent), ("grid", grid))
    }
    return sizes, found


def slope(sizes: list[int], errors: list[float]) -> float:
    return float(-2 * np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def plot(sizes: list[int], found: dict[str, dict[str, list[float]]], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, 3, figsize=(11, 3.8))
    for axes, (panel, curves) in zip(panels, found.items(), strict=True):
        for name, errors in curves.items():
            axes.loglog(sizes, errors, "o-", label=f"{name}: order {slope(sizes, errors):.1f}")
        axes.set(title=panel, xlabel="points")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    panels[0].set_ylabel("relative error")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("largest", type=int, nargs="?", default=SIZES[-1])
    parser.add_argument("--plot")
    options = parser.parse_args()
    sizes, found = measure(options.largest)
    print(f"{'':>44}" + "".join(f"{size:>10}" for size in sizes) + f"{'order':>8}")
    for panel, curves in found.items():
        for name, errors in curves.items():
            row = "".join(f"{error:>10.1e}" for error in errors)
            print(f"{panel + ', ' + name:>44}{row}{slope(sizes, errors):>8.2f}")
    if options.plot:
        plot(sizes, found, options.plot)


if __name__ == "__main__":
    main()
