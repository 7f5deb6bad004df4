"""Shapes, their topology, their operators."""

from __future__ import annotations

import numpy as np

import beltrami as bt

from . import Sheet, section


@section("Shapes and their topology")
def shapes(sheet: Sheet) -> None:
    sheet.text(
        "A surface is loaded with its vertices in the order of the file, none of them merged, and examined: components, boundary "
        "loops, Euler characteristic, genus, whether it is a manifold and oriented. Nothing is assumed; methods that need more say so."
    )
    cortex = bt.examples.cortex()
    named = [
        ("spot", bt.examples.spot()),
        ("bob", bt.examples.bob()),
        ("cortex, left pial surface", cortex),
        ("figure-eight (made)", bt.shapes.figure_eight(resolution=16)),
        ("triple torus (made)", bt.shapes.triple_torus(resolution=16)),
        ("cylinder, open (made)", bt.shapes.cylinder()),
    ]
    rows = []
    for name, mesh in named:
        rows.append(
            (
                name,
                len(mesh.vertices),
                len(mesh.faces),
                mesh.components,
                mesh.euler_characteristic,
                mesh.genus,
                mesh.boundary_loops,
                mesh.is_closed,
            )
        )
    sheet.table(("shape", "vertices", "triangles", "components", "Euler characteristic", "genus", "boundary loops", "closed"), rows)
    sheet.code(
        'spot = bt.load("spot.ply")\nprint(spot.report())\n'
        'spot.plot(spot.data["colors"], views={"three-quarter": "three-quarter back", "front": "back"}, path="spot.png")'
    )
    spot = named[0][1]
    sheet.picture(
        spot,
        spot.data["colors"],
        views={"three-quarter": "three-quarter back", "front": "back", "left": "left"},
        title="Spot, with the colours of its vertices",
        caption="Spot (Keenan Crane, CC0): 2,930 vertices, closed, genus 0.",
        interactive=True,
        size=(1600, 760),
    )
    sheet.picture(
        cortex,
        {"sulcal depth": cortex.data["depth"]},
        views={"lateral": "left", "medial": "right", "dorsal": "top"},
        up="z",
        contours=[0.0],
        title="Human cortex, left pial surface (fsaverage5)",
        caption="10,242 vertices of FreeSurfer's average cortex, from nilearn's package data; "
        "the line is where the depth changes its sign.",
        interactive=True,
        size=(1600, 760),
    )


@section("Operators and a sparse solve")
def solve(sheet: Sheet) -> None:
    sheet.text(
        "Every method rests on four matrices of a shape, stiffness, mass, gradient and divergence, and on a sparse Cholesky factor. "
        "Each figure below is measured on the matrices themselves: symmetry to the last bit, constants in the kernel, the divergence as "
        "exact negative adjoint of the gradient, and the residual of a solve."
    )
    cortex = bt.examples.cortex("white")
    operators = bt.operators(cortex)
    stiffness, mass = operators.stiffness, operators.mass
    generator = np.random.default_rng(8)
    f, field = generator.normal(size=len(mass)), generator.normal(size=operators.gradient.shape[0])
    areas = np.repeat(operators.element_areas, cortex.dimension)
    left = float((operators.gradient @ f * areas) @ field)
    right = float(f @ (mass * (operators.divergence @ field)))
    # Diffusion for the time in which heat travels some ten millimetres smooths a measured map.
    from scipy.sparse import dia_array

    system = dia_array((mass[None], [0]), shape=stiffness.shape) + 50.0 * stiffness
    factor = bt.Cholesky(system, cortex.vertices)
    load = mass * cortex.data["depth"]
    smooth = factor.solve(load)
    sheet.figures(
        {
            "unknowns": len(mass),
            "asymmetry of the stiffness": float(abs(stiffness - stiffness.T).max()),
            "largest row sum, relative": float(np.abs(stiffness.sum(axis=1)).max() / stiffness.diagonal().max()),
            "gradient and divergence, defect of adjointness": abs(left + right) / max(abs(left), 1e-300),
            "residual of the solve": float(np.linalg.norm(system @ smooth - load) / np.linalg.norm(load)),
        }
    )
    sheet.code(
        "operators = bt.operators(cortex)\nfactor = bt.Cholesky(mass + 50 * operators.stiffness, cortex.vertices)\n"
        "smooth = factor.solve(load)"
    )
    span = float(np.abs(cortex.data["depth"]).max())
    sheet.picture(
        cortex,
        {"measured": cortex.data["depth"], "after diffusion, 50 mm²": smooth},
        views=["left"],
        up="z",
        limits=(-span, span),
        colormap="balance",
        contours=[0.0],
        title="Sulcal depth on the white surface, before and after an implicit step of diffusion",
        caption="One solve of (M + t L) u = M f. The small folds are gone, the large ones remain.",
        size=(1600, 760),
    )
