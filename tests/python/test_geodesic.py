"""Geodesic distance by the heat method, and the Poisson equation it rests on."""

from __future__ import annotations

import pickle

import beltrami as bt
import numpy as np
import pytest
from scipy.spatial import Delaunay, cKDTree


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


@pytest.mark.parametrize("laplacian", ["cotangent", "intrinsic_delaunay", "auto"])
def test_obtuse_triangles_at_the_boundary(laplacian):
    """A random Delaunay square has boundary angles near 180 degrees: positive weights, by which distances can be a third of it off."""
    points = np.random.default_rng(0).random((1500, 2))
    a, b, c = np.moveaxis(points[(faces := Delaunay(points).simplices)], 1, 0)
    mesh = bt.TriangleMesh(points, faces[abs(np.linalg.det(np.stack([b - a, c - a], 1))) > 1e-9])
    ops, source = bt.operators(mesh, laplacian=laplacian), int(np.linalg.norm(points - 0.5, axis=1).argmin())
    heat = bt.HeatMethod(ops)
    error = abs(heat.distance(source) - np.linalg.norm(points - points[source], axis=1))
    assert error.max() < 1.5 * ops.spacing  # measured 1.03, and 4.4 without the cover
    assert heat.operators.kind == "tufted"
    assert any("positive weight" in note for note in heat.operators.notes)
    assert bt.HeatMethod(bt.shapes.sphere(3)).operators.kind == "cotangent"


@pytest.mark.parametrize("radius", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("kind", ["sphere", "plane", "cloud"])
def test_discs_of_sources(kind, radius):
    """Distance to a disc, exact from the nearest of its vertices: errors as small as of one source (without care 3 to 6 spacings)."""
    mesh = bt.shapes.sphere(frequency=24) if kind == "sphere" else bt.shapes.grid(61, 61)
    vertices, middle = mesh.vertices, mesh.vertices[len(mesh.vertices) // 2 + 7]
    disc = (np.arccos(np.clip(vertices @ middle, -1, 1)) if kind == "sphere" else np.linalg.norm(vertices - middle, axis=1)) <= radius
    exact = cKDTree(vertices[disc]).query(vertices)[0]
    if kind == "sphere":
        exact = 2 * np.arcsin(exact / 2)
    ops = bt.operators(bt.PointCloud(vertices[:, :2], dimension=2) if kind == "cloud" else mesh)
    d = bt.geodesic_distance(ops, disc)
    assert abs(d - exact).max() < 0.8 * ops.spacing
    assert (d[disc] == 0).all()


def test_sources_of_equal_strength_at_a_corner():
    """A corner holds a quarter of the heat's way out: it emits less, or the line between two sources would lie a spacing off."""
    mesh = bt.shapes.grid(81, 81)
    sources = [40 * 81 + 40, 0]
    exact = np.linalg.norm(mesh.vertices[:, None] - mesh.vertices[sources], axis=2)
    d = bt.geodesic_distance(mesh, sources)
    assert abs(d - exact.min(1)).max() < 0.8 / 80  # measured .0089, and .0124 without


def test_every_vertex_a_source():
    assert (bt.geodesic_distance(bt.shapes.grid(5, 5), np.ones(25, bool)) == 0).all()
    sphere = bt.shapes.sphere(2)
    assert np.array_equal(bt.geodesic_distance(sphere, [3, 3, 3]), bt.geodesic_distance(sphere, 3))


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


@pytest.mark.parametrize("factor", [0, -1, np.nan, np.inf, "x", 10**400, 1j, np.complex128(1), np.array(1j), [1.0], np.ones(1), None])
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
