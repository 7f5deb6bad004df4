"""Eigenfunctions and distances."""

from __future__ import annotations

import numpy as np

import beltrami as bt

from . import Sheet, section


@section("Eigenfunctions of the cortex")
def eigenfunctions(sheet: Sheet) -> None:
    sheet.text(
        "The eigenfunctions of the Laplacian are to a surface what sines are to a string. Each pair comes with its residual, "
        "measured against the matrices, and the functions are orthonormal in the mass."
    )
    cortex = bt.examples.cortex("white")
    pairs = bt.eigenpairs(cortex, 40)
    operators = bt.operators(cortex)
    gram = pairs.functions.T @ (operators.mass[:, None] * pairs.functions)
    sheet.figures(
        {
            "pairs": len(pairs.values),
            "largest residual": float(np.max(pairs.residuals)),
            "defect of orthonormality": float(np.abs(gram - np.eye(len(gram))).max()),
            "first eigenvalue above zero, 1/mm²": float(pairs.values[1]),
        }
    )
    sheet.code('pairs = bt.eigenpairs(cortex, 40)\ncortex.plot({"mode 1": pairs.functions[:, 1], ...}, path="modes.png")')
    chosen = (1, 2, 3, 5, 8, 13, 21, 34)
    sheet.picture(
        cortex,
        {f"mode {k}, λ = {pairs.values[k]:.3g}": pairs.functions[:, k] for k in chosen},
        views="left",
        up="z",
        contours=[0.0],
        title="Eigenfunctions of the left cortex, lateral view",
        caption="Eight of forty modes on the white surface, λ in 1/mm²; lines are where a function vanishes.",
        interactive=True,
        size=(1600, 860),
    )


@section("Spectrum of the sphere, with multiplicities")
def sphere_spectrum(sheet: Sheet) -> None:
    sheet.text(
        "The unit sphere has the eigenvalues l (l + 1), each 2 l + 1 times. All copies are found, none twice; what remains is the error of "
        "the triangles, which falls with the square of their size."
    )
    degrees = 7
    wanted = np.concatenate([np.full(2 * degree + 1, degree * (degree + 1.0)) for degree in range(degrees)])
    rows, errors, spacings = [], [], []
    for level in (3, 4, 5):
        mesh = bt.shapes.sphere(level)
        pairs = bt.eigenpairs(mesh, len(wanted))
        errors.append(float(np.abs(pairs.values[1:] / wanted[1:] - 1).max()))
        spacings.append(bt.operators(mesh).spacing)
    start = 0
    for degree in range(degrees):
        group = pairs.values[start : start + 2 * degree + 1]
        start += 2 * degree + 1
        near = int((np.abs(pairs.values - degree * (degree + 1)) < degree + 0.5).sum())
        rows.append((degree, degree * (degree + 1), 2 * degree + 1, near, float(group.min()), float(group.max())))
    slope = float(np.polyfit(np.log(spacings), np.log(errors), 1)[0])
    sheet.figures(
        {
            "vertices": len(mesh.vertices),
            "largest residual": float(np.max(pairs.residuals)),
            "largest relative error": errors[-1],
            "slope of the error over three sizes (2 is right)": slope,
        }
    )
    sheet.table(("degree l", "l (l + 1)", "multiplicity", "found", "smallest", "largest"), rows, "Eigenvalues of the finest sphere")
    sheet.code("bt.eigenpairs(bt.shapes.sphere(5), 49).values")
    ends = np.cumsum([2 * degree + 1 for degree in range(degrees)])
    sheet.picture(
        mesh,
        {f"degree {degree}": pairs.functions[:, ends[degree] - 1] for degree in range(1, degrees)},
        contours=[0.0],
        title="One eigenfunction of each degree",
        caption="Within a degree every rotation is as good as another; the solver's choice is the same in every run.",
        size=(1600, 900),
    )


@section("Geodesic distance by the heat method")
def geodesic(sheet: Sheet) -> None:
    sheet.text(
        "Heat that has diffused for a short time points the way: take its gradient, normalize it, and integrate (Crane, Weischedel, "
        "Wardetzky 2013). Two sparse solves; a factor that is kept serves any number of sources."
    )
    sphere = bt.shapes.sphere(5)
    exact = np.arccos(np.clip(sphere.vertices @ sphere.vertices[0], -1, 1))
    error = np.abs(bt.geodesic_distance(sphere, 0) - exact)
    cortex = bt.examples.cortex()
    source = int(np.argmax(cortex.vertices[:, 1]))
    away = bt.geodesic_distance(cortex, source)
    sheet.figures(
        {
            "sphere: mean error, of the diameter": float(error.mean() / np.pi),
            "sphere: greatest error, of the diameter": float(error.max() / np.pi),
            "cortex: farthest vertex, mm": float(away.max()),
            "the same as the crow flies, mm": float(np.linalg.norm(cortex.vertices[np.argmax(away)] - cortex.vertices[source])),
        }
    )
    sheet.code('distance = bt.geodesic_distance(cortex, source)\ncortex.plot(distance, contours=24, points=[source], path="distance.png")')
    spot = bt.examples.spot()
    nose = int(np.argmin(spot.vertices[:, 2]))
    sheet.picture(
        spot,
        {"distance": bt.geodesic_distance(spot, nose)},
        views={"front": "three-quarter back", "left": "left", "back": "three-quarter"},
        contours=24,
        points=[nose],
        title="Distance from the muzzle of Spot",
        caption="Contour lines at equal distances.",
        interactive=True,
        size=(1600, 760),
    )
    sheet.picture(
        cortex,
        {"distance, mm": away},
        views={"lateral": "left", "medial": "right"},
        up="z",
        contours=24,
        points=[source],
        title="Distance along the cortex from its frontal pole",
        caption="Through the folds, not across them: that is what makes the lines crowd.",
        interactive=True,
        size=(1600, 820),
    )
