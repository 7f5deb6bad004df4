"""Point clouds: operators without a mesh."""

from __future__ import annotations

import numpy as np

import beltrami as bt

from ..clouds import CloudOperators
from . import Sheet, section


@section("Point clouds")
def clouds(sheet: Sheet) -> None:
    sheet.text(
        "Only the points of the surfaces are kept, without their triangles. Each point finds its Delaunay star in its tangent plane; "
        "stiffness and mass come from the triangles that these stars vote for. A star is certified if no point that could change it "
        "was left out. The mesh is only used to measure errors: the cloud never saw its eigenvalues and distances."
    )
    mesh = bt.examples.spot()
    cloud = bt.PointCloud(mesh.vertices)
    operators = bt.operators(cloud)
    assert isinstance(operators, CloudOperators)
    modes, judge = bt.eigenpairs(operators, 12), bt.eigenpairs(mesh, 12)
    scale = operators.mass.sum() / mesh.area
    error = float(np.abs(modes.values[1:] * scale / judge.values[1:] - 1).max())
    distance, exact = bt.geodesic_distance(operators, 0), bt.geodesic_distance(mesh, 0)
    sheet.figures(
        {
            "points": len(cloud.points),
            "certified stars, %": 100 * operators.certified,
            "triangles with all three votes, %": 100 * float((operators.votes == 3).mean()),
            "eigenvalues 1 to 11 against the mesh, largest difference": error,
            "distances against the mesh, mean difference": float(np.abs(distance - exact).mean() / exact.max()),
        }
    )
    sheet.code(
        "cloud = bt.PointCloud(points)\noperators = bt.operators(cloud)\nmodes = bt.eigenpairs(operators, 12)\n"
        "distance = bt.geodesic_distance(operators, 0)"
    )
    sheet.picture(
        cloud,
        {"third eigenfunction": modes.functions[:, 3], "distance to a point": distance},
        views=["three-quarter back"],
        title="A cloud of 2,930 points: eigenfunction and distance without a mesh",
        caption="The vertices of Spot (Keenan Crane, CC0), drawn as they are.",
        interactive=True,
        size=(1600, 760),
    )
    compared: list[tuple[object, ...]] = []
    for name, other in (
        ("Spot", mesh),
        ("cortex, inflated", bt.examples.cortex("infl")),
        ("cortex, white surface", bt.examples.cortex("white")),
    ):
        alone = bt.operators(bt.PointCloud(other.vertices))
        assert isinstance(alone, CloudOperators)
        area = alone.mass.sum() / other.area
        difference = bt.eigenpairs(alone, 12).values[1:] * area / bt.eigenpairs(other, 12).values[1:] - 1
        compared.append((name, len(other.vertices), float((alone.votes == 3).mean()), float(area - 1), float(np.abs(difference).max())))
    sheet.table(
        ("points of", "count", "triangles with all votes", "area against the mesh", "eigenvalues against the mesh"),
        compared,
        "The walls of the folds of the cortex are as close to each other as its points: points alone do not determine the surface there.",
    )
    rng = np.random.default_rng(0)
    rows: list[tuple[object, ...]] = []
    for count in (1000, 2000, 4000, 8000):
        points = rng.standard_normal((8 * count, 3))
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        points = points[bt.poisson_disc(points, 0.745 * np.sqrt(4 * np.pi / count))]
        exactly = np.repeat([2.0, 6, 12, 20, 30], [3, 5, 7, 9, 11])
        sphere = bt.PointCloud(points)
        linear = float(np.abs(bt.eigenpairs(sphere, 36).values[1:] / exactly - 1).max())
        z, errors = points[:, 2], []
        for degree in (2, 3, 4):
            laplacian = bt.operators(sphere, laplacian="mls", degree=degree).laplacian
            errors.append(float(np.sqrt(np.mean((laplacian @ z**3 - 6 * z + 12 * z**3) ** 2) / np.mean((6 * z - 12 * z**3) ** 2))))
        rows.append((len(points), linear, *errors))
    sheet.table(
        ("points of the sphere", "local mesh: 36 eigenvalues", "least squares, degree 2: Δz³", "degree 3", "degree 4"),
        rows,
        "Relative errors against closed forms: largest of the eigenvalues, rms of the Laplacian.",
    )
