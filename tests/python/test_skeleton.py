"""Skeletons: loops, leaves, where nodes lie, what belongs to them, and what is refused."""

from __future__ import annotations

import beltrami as bt
import pytest


@pytest.mark.parametrize(
    ("mesh", "loops"),
    [
        (bt.shapes.torus(1.0, 0.3, rows=60, columns=24), 1),
        (bt.shapes.figure_eight(), 2),
        (bt.shapes.knot(), 1),
    ],
)
def test_loops_are_the_handles(mesh: bt.TriangleMesh, loops: int) -> None:
    for shape in (mesh, bt.PointCloud(mesh.vertices, dimension=2)):
        r = bt.skeleton(shape)
        assert (r.cycles, r.leaves) == (loops, 0)
