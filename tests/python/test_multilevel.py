"""Poisson equations by multigrid iterations: the factor as reference, closed forms, faults."""

from __future__ import annotations

import pickle

import beltrami as bt
import numpy as np
import pytest


def shapes():
    torus = bt.shapes.torus(rows=300, columns=240)
    shuffled = np.random.default_rng(5).permutation(len(torus.vertices))
    place = np.argsort(shuffled)
    yield "torus", torus
    yield "torus in random order", bt.TriangleMesh(torus.vertices[shuffled], place[torus.faces])
    yield "flat torus, stretched", bt.TriangleMesh(torus.vertices * [1.0, 5.0, 1.0], torus.faces)
    ball = bt.shapes.sphere(frequency=40)
    yield (
        "three pieces",
        bt.TriangleMesh(
            np.vstack([torus.vertices, ball.vertices + 5, 1e-3 * ball.vertices - 5]),
            np.vstack([torus.faces, ball.faces + len(torus.vertices), ball.faces + len(torus.vertices) + len(ball.vertices)]),
        ),
    )


@pytest.mark.parametrize(("name", "mesh"), list(shapes()), ids=lambda value: value if isinstance(value, str) else "")
def test_the_factor_and_the_iteration_agree(name, mesh):
    ops = bt.operators(mesh)
    f = np.sin(3 * mesh.vertices[:, 0]) + np.random.default_rng(1).normal(size=len(mesh.vertices))
    direct = bt.PoissonSolver(ops, method="direct").solve(f)
    solver = bt.PoissonSolver(ops, method="multilevel")
    assert solver.method == "multilevel"
    found = solver.solve(f)
    assert abs(found - direct).max() < 1e-8 * abs(direct).max()
    assert np.array_equal(found, pickle.loads(pickle.dumps(solver)).solve(f))
    before = bt.num_threads()
    try:
        bt.set_num_threads(1)
        assert np.array_equal(found, solver.solve(f))
    finally:
        bt.set_num_threads(before)


def test_small_shapes_and_faults():
    ball = bt.shapes.sphere(3)
    z = ball.vertices[:, 2]
    assert np.allclose(bt.PoissonSolver(ball, method="multilevel").solve(z), bt.PoissonSolver(ball).solve(z), atol=1e-12)
    assert (bt.PoissonSolver(ball, method="multilevel").solve(np.zeros(len(z))) == 0).all()
    with pytest.raises(bt.InputError, match="'auto', 'direct' or 'multilevel'"):
        bt.PoissonSolver(ball, method="magic")
    with pytest.raises(bt.InputError, match="tolerance"):
        bt.PoissonSolver(ball, tolerance=0)
    with pytest.raises(bt.InputError, match="f"):
        bt.PoissonSolver(ball, method="multilevel").solve(z[1:])
