"""Geodesic distance by the heat method, and the Poisson equation it rests on."""

from __future__ import annotations

import pickle

import beltrami as bt
import numpy as np
import pytest


def test_great_circles():
    """On the unit sphere the distance is the angle; the heat method's error is about the spacing (here .027)."""
    mesh = bt.shapes.sphere(frequency=40)
    d = bt.geodesic_distance(mesh, 5)
    exact = np.arccos(np.clip(mesh.vertices @ mesh.vertices[5], -1, 1))
    assert abs(d - exact).mean() < 0.01
    assert abs(d - exact).max() < 0.027
    assert d[5] == 0


def test_plane_with_boundary():
    """Straight lines, up to the boundary: the sum of both heat flows keeps the level lines from bending there."""
    mesh = bt.shapes.grid(61, 61)
    d = bt.geodesic_distance(mesh, 30 * 61 + 12)
    exact = np.linalg.norm(mesh.vertices - mesh.vertices[30 * 61 + 12], axis=1)
    assert abs(d - exact).max() < 1 / 60


def test_error_falls():
    errors, sizes = [], [8, 16, 32, 64]
    for frequency in sizes:
        mesh = bt.shapes.sphere(frequency=frequency)
        exact = np.arccos(np.clip(mesh.vertices @ mesh.vertices[0], -1, 1))
        errors.append(abs(bt.geodesic_distance(mesh, 0) - exact).mean())
    # With t = h² the method is about of order 2/3 in this range: measured .0229, .0130, .0084, .0062.
    assert (np.diff(errors) < 0).all()
    assert -np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 0.55, errors


def test_many_sources_and_a_mask():
    mesh = bt.shapes.torus(rows=60, columns=24)
    both = bt.geodesic_distance(mesh, [3, 700])
    mask = np.zeros(len(mesh.vertices), bool)
    mask[[3, 700]] = True
    assert np.array_equal(both, bt.geodesic_distance(mesh, mask))
    one, other = bt.geodesic_distance(mesh, 3), bt.geodesic_distance(mesh, 700)
    assert abs(both - np.minimum(one, other)).max() < 3 * bt.operators(mesh).spacing


def test_components():
    mesh = bt.shapes.sphere(3)
    two = bt.TriangleMesh(np.vstack([mesh.vertices, mesh.vertices + 5]), np.vstack([mesh.faces, mesh.faces + len(mesh.vertices)]))
    d = bt.geodesic_distance(two, 0)
    half = len(mesh.vertices)
    assert np.isfinite(d[:half]).all()
    assert np.isinf(d[half:]).all()


def test_heat_that_fades_away():
    """Along 600 edges heat falls by e^-600 at the default time: without longer times the far end would have no direction."""
    strip = bt.shapes.grid(1200, 3, width=1200.0, height=2.0)
    d = bt.geodesic_distance(strip, 0)
    exact = np.linalg.norm(strip.vertices - strip.vertices[0], axis=1)
    assert abs(d - exact).max() < 0.02 * exact.max()


def test_scale_and_reuse():
    mesh = bt.shapes.ellipsoid(level=3)
    heat = bt.HeatMethod(mesh)
    assert np.array_equal(heat.distance(7), bt.geodesic_distance(mesh, 7))
    big = bt.geodesic_distance(bt.TriangleMesh(1e3 * mesh.vertices, mesh.faces), 7)
    assert np.allclose(big, 1e3 * heat.distance(7), rtol=1e-9, atol=1e-9)
    again = pickle.loads(pickle.dumps(heat))
    assert np.array_equal(again.distance(7), heat.distance(7))


@pytest.mark.parametrize("sources", [[], [642], [-1], [0.5], "a", None, [[0]], np.zeros(5, bool), [True, False]])
def test_bad_sources(sources):
    with pytest.raises(bt.InputError):
        bt.geodesic_distance(bt.shapes.sphere(3), sources)


@pytest.mark.parametrize("factor", [0, -1, np.nan, np.inf, "x"])
def test_bad_time(factor):
    with pytest.raises(bt.InputError):
        bt.geodesic_distance(bt.shapes.sphere(1), 0, time_factor=factor)


def test_poisson_on_the_sphere():
    """-Δ z = 2 z: for f = z the solution is z / 2."""
    mesh = bt.shapes.sphere(4)
    u = bt.solve_poisson(mesh, mesh.vertices[:, 2])
    assert abs(u - mesh.vertices[:, 2] / 2).max() < 2e-3


def test_poisson_residual_mean_and_blocks():
    mesh = bt.shapes.torus()
    ops, rng = bt.operators(mesh), np.random.default_rng(0)
    f = rng.normal(size=(len(ops.mass), 3))
    solver = bt.PoissonSolver(ops)
    u = solver.solve(f)
    right = ops.mass[:, None] * (f - (ops.mass @ f) / ops.mass.sum())
    assert np.linalg.norm(ops.stiffness @ u - right) <= 1e-11 * np.linalg.norm(right)
    assert abs(ops.mass @ u).max() <= 1e-12 * (ops.mass @ abs(u)).max()
    assert np.allclose(solver.solve(f[:, 1]), u[:, 1], rtol=0, atol=1e-12 * abs(u).max())
    assert np.array_equal(pickle.loads(pickle.dumps(solver)).solve(f), u)


def test_strict_poisson_names_the_component():
    with pytest.raises(bt.InputError, match="component 0"):
        bt.solve_poisson(bt.shapes.sphere(2), np.ones(162), strict=True)
    bt.solve_poisson(bt.shapes.sphere(2), bt.shapes.sphere(2).vertices[:, 0], strict=True)
