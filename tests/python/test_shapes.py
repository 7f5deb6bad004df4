"""Connectivity, parts, reports and makers."""

import pickle

import beltrami as bt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

MAKERS = {
    "sphere": (bt.shapes.sphere, 0, 0, 3),
    "ellipsoid": (bt.shapes.ellipsoid, 0, 0, 3),
    "torus": (bt.shapes.torus, 1, 0, 3),
    "flat_torus": (bt.shapes.flat_torus, 1, 0, 4),
    "grid": (bt.shapes.grid, 0, 1, 3),
    "cylinder": (bt.shapes.cylinder, 0, 2, 3),
    "disc": (bt.shapes.disc, 0, 1, 3),
    "knot": (bt.shapes.knot, 1, 0, 3),
    "figure_eight": (bt.shapes.figure_eight, 2, 0, 3),
    "double_torus": (bt.shapes.double_torus, 2, 0, 3),
    "triple_torus": (bt.shapes.triple_torus, 3, 0, 3),
    "star": (bt.shapes.star, 0, 0, 3),
    "y": (bt.shapes.y, 0, 0, 3),
}


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.einsum("fi,fi->", a, np.cross(b, c)) / 6


@pytest.mark.parametrize("name", MAKERS)
def test_makers_have_their_topology(name):
    make, genus, loops, dimension = MAKERS[name]
    mesh = make()
    assert (mesh.components, mesh.genus, mesh.boundary_loops, mesh.dimension) == (1, genus, loops, dimension)
    assert mesh.euler_characteristic == 2 - 2 * genus - loops
    assert mesh.is_manifold
    assert mesh.is_oriented
    assert mesh.is_closed == (loops == 0)
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    if loops == 0 and dimension == 3:
        assert volume(mesh) > 0  # outward


def test_makers_lie_on_their_surfaces():
    x, y, z = bt.shapes.ellipsoid(3, 2, 0.5, frequency=9).vertices.T
    np.testing.assert_allclose((x / 3) ** 2 + (y / 2) ** 2 + (z / 0.5) ** 2, 1, rtol=4e-16 * 8)
    x, y, z = bt.shapes.torus(2.0, 0.7, rows=31, columns=17).vertices.T
    np.testing.assert_allclose(np.hypot(np.hypot(x, y) - 2.0, z), 0.7, rtol=4e-15)
    a, b, c, d = bt.shapes.flat_torus(2.0, 0.7, rows=31, columns=17).vertices.T
    np.testing.assert_allclose([np.hypot(a, b), np.hypot(c, d)], np.broadcast_to([[2.0], [0.7]], (2, 31 * 17)), rtol=4e-16 * 4)
    # The tube of a knot: the distance to its curve, sampled finely (a chord's sagitta of 2 pi / 20,000 is 1e-7).
    t = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)
    ring = 1.0 + 0.45 * np.cos(3 * t)
    curve = np.stack([ring * np.cos(2 * t), ring * np.sin(2 * t), 0.45 * np.sin(3 * t)], axis=1)
    vertices = bt.shapes.knot(2, 3, rows=30, columns=8).vertices
    distance = np.linalg.norm(vertices[:, None] - curve, axis=2).min(axis=1)
    np.testing.assert_allclose(distance, 0.16, atol=1e-6)
    # A straight tube with round ends: two arms of length 1 (smoothing thickens it only near the joint).
    tube = bt.shapes.star(2, arm_length=1.0, tube_radius=0.2, resolution=10).vertices
    end = tube[abs(tube[:, 1]) > 1.0]
    away = np.linalg.norm(end - np.sign(end[:, 1:2]) * [0, 1, 0], axis=1)
    np.testing.assert_allclose(away, 0.2, atol=1e-8)


def test_areas_of_makers_converge_with_slope_two():
    for make, exact in (
        (lambda f: bt.shapes.sphere(frequency=6 * f), 4 * np.pi),
        (lambda f: bt.shapes.torus(1.0, 0.4, rows=24 * f, columns=12 * f), 4 * np.pi**2 * 0.4),
        (lambda f: bt.shapes.flat_torus(1.0, 0.5, rows=16 * f, columns=12 * f), 4 * np.pi**2 * 0.5),
        (lambda f: bt.shapes.disc(rings=4 * f), np.pi),
        (lambda f: bt.shapes.cylinder(0.5, 2.0, rows=5, columns=10 * f), 2 * np.pi),
    ):
        steps = np.array([1, 2, 4, 8])
        errors = [abs(make(int(f)).area / exact - 1) for f in steps]
        slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert 1.9 < slope < 2.1


def test_resolution_of_smooth_unions_keeps_the_shape():
    coarse, fine = (bt.shapes.double_torus(resolution=r) for r in (8, 20))
    assert len(fine.vertices) > 5 * len(coarse.vertices)
    assert abs(coarse.area / fine.area - 1) < 0.02


def test_frequency_and_level():
    assert len(bt.shapes.sphere(3).vertices) == 10 * 4**3 + 2
    np.testing.assert_array_equal(bt.shapes.sphere(3).vertices, bt.shapes.sphere(frequency=8).vertices)


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (lambda: bt.shapes.sphere(-1), "level is -1"),
        (lambda: bt.shapes.sphere(2.5), "whole number"),
        (lambda: bt.shapes.sphere(20), "level is 20"),
        (lambda: bt.shapes.sphere(radius=0), "radius is 0"),
        (lambda: bt.shapes.torus(1.0, 2.0), "minor_radius"),
        (lambda: bt.shapes.torus(rows=2), "rows is 2"),
        (lambda: bt.shapes.knot(2, 4), "common divisor"),
        (lambda: bt.shapes.knot(2, 3, tube_radius=0.6), "tube"),
        (lambda: bt.shapes.figure_eight(tube_radius=0.9), "holes"),
        (lambda: bt.shapes.star(1), "arms is 1"),
        (lambda: bt.shapes.star(resolution="fine"), "resolution"),
        (lambda: bt.shapes.disc(float("nan")), "radius is nan"),
        (lambda: bt.shapes.star(progress=3), "progress"),
    ],
)
def test_makers_refuse(call, word):
    with pytest.raises(bt.InputError, match=word):
        call()


def test_makers_stop_when_progress_says_so():
    with pytest.raises(bt.Cancelled):
        bt.shapes.triple_torus(resolution=60, progress=lambda share: False)


def test_components_parts_and_largest():
    sphere, torus = bt.shapes.sphere(2), bt.shapes.torus(rows=20, columns=9)
    vertices = np.vstack([sphere.vertices, [[9.0, 9.0, 9.0]], torus.vertices + 5.0])
    faces = np.vstack([sphere.faces, torus.faces + len(sphere.vertices) + 1])
    order = np.arange(len(vertices))
    mesh = bt.TriangleMesh(vertices, faces, data={"order": order})
    assert (mesh.components, mesh.genus, mesh.euler_characteristic) == (2, 1, 2)
    labels = mesh.component_labels
    assert labels[len(sphere.vertices)] == -1
    assert set(labels[: len(sphere.vertices)]) == {0}
    assert set(labels[len(sphere.vertices) + 1 :]) == {1}
    big = mesh.largest_component()
    np.testing.assert_array_equal(big.faces, torus.faces)  # area 15.8 against 12.6
    np.testing.assert_array_equal(big.data["order"], order[len(sphere.vertices) + 1 :])
    with pytest.raises(bt.TopologyError, match="no triangle"):
        bt.TriangleMesh([[0.0, 0.0]], []).largest_component()


def test_submesh():
    sphere = bt.shapes.sphere(3)
    half = sphere.submesh(sphere.vertices[:, 2] >= 0)
    assert (half.boundary_loops, half.euler_characteristic, half.is_closed) == (1, 1, False)
    (loop,) = half.boundary_loop_vertices
    assert len(np.unique(loop)) == len(loop)
    turn = np.unwrap(np.arctan2(half.vertices[loop, 1], half.vertices[loop, 0]))
    assert turn[-1] > turn[0]  # counterclockwise from above: the surface on the left
    np.testing.assert_array_equal(sphere.submesh(range(len(sphere.vertices))).faces, sphere.faces)
    with pytest.raises(bt.InputError, match=r"vertices\[0\] is 999999"):
        sphere.submesh([999999])


def test_edges_are_sorted_and_frozen():
    mesh = bt.shapes.torus(rows=9, columns=7)
    own = np.unique(np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    np.testing.assert_array_equal(mesh.edges, own)
    with pytest.raises(ValueError, match="read-only"):
        mesh.edges[0] = 0


def test_non_manifold_and_one_sided_meshes_say_where():
    points = np.random.default_rng(0).normal(size=(6, 3))
    fin = bt.TriangleMesh(points, [[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert not fin.is_manifold
    assert fin.is_oriented  # three faces at an edge say nothing about sides
    with pytest.raises(bt.TopologyError, match=r"3 faces .* share the edge from vertex 0 to vertex 1"):
        _ = fin.genus
    assert "3 faces" in str(fin.report())
    band = bt.TriangleMesh(points[:5], [[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 0], [4, 0, 1]])
    assert band.is_manifold
    assert not band.is_orientable
    assert not band.is_oriented
    for question in (lambda: band.genus, band.oriented):
        with pytest.raises(bt.TopologyError, match="one side"):
            question()


def test_oriented_turns_the_fewer():
    torus = bt.shapes.torus(rows=20, columns=10)
    faces = torus.faces.copy()
    faces[::3] = faces[::3, ::-1]
    mixed = bt.TriangleMesh(torus.vertices, faces, data={"x": torus.vertices[:, 0]})
    assert not mixed.is_oriented
    assert mixed.genus == 1
    again = mixed.oriented()
    assert again.is_oriented
    assert volume(again) > 0
    assert "x" in again.data
    assert torus.oriented() is torus


def test_reports():
    report = bt.shapes.cylinder().report()
    assert (report.genus, report.boundary_loops, report.is_manifold, report.zero_area_faces) == (0, 2, True, 0)
    assert "boundary loops        2" in str(report)
    odd = bt.TriangleMesh(np.eye(5, 3), [[0, 1, 2], [0, 0, 1], [0, 1, 3]]).report()
    assert (odd.repeated_corner_faces, odd.unreferenced_vertices) == (1, 1)
    empty = bt.TriangleMesh([], []).report()
    assert (empty.area, empty.edge_length, empty.genus) == (0.0, None, 0)
    huge = bt.TriangleMesh(1e200 * np.eye(3), [[0, 1, 2]])
    assert huge.report().area is None
    with pytest.raises(bt.NumericalError, match="rescale"):
        _ = huge.area
    assert pickle.loads(pickle.dumps(report)) == report


@pytest.mark.parametrize("size", [1e-120, 1e-60, 1e60, 1e120])
def test_areas_at_the_ends_of_double_precision(size):
    mesh = bt.shapes.sphere(2)
    scaled = bt.TriangleMesh(mesh.vertices * size, mesh.faces)
    np.testing.assert_allclose(scaled.area / size / size, mesh.area, rtol=1e-12)


def counts(vertex_count, faces):
    """Components, Euler characteristic and boundary edges, by sets."""
    good = [f for f in faces if len(set(f)) == 3]
    edges = {}
    for f in good:
        for k in range(3):
            pair = tuple(sorted((f[k], f[(k + 1) % 3])))
            edges[pair] = edges.get(pair, 0) + 1
    parents = {v: v for f in good for v in f}

    def root(v):
        while parents[v] != v:
            v = parents[v]
        return v

    for a, b in edges:
        parents[root(a)] = root(b)
    used = len(parents)
    return len({root(v) for v in parents}), used - len(edges) + len(good), edges


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(*[st.integers(0, 8)] * 3), max_size=25), st.permutations(range(9)))
def test_any_faces_are_counted_right(faces, numbers):
    points = np.random.default_rng(3).normal(size=(9, 3))
    mesh = bt.TriangleMesh(points, np.array(faces, int).reshape(-1, 3))
    components, euler, edges = counts(9, faces)
    assert (mesh.components, mesh.euler_characteristic, len(mesh.edges)) == (components, euler, len(edges))
    assert mesh.is_closed == (bool(edges) and all(n > 1 for n in edges.values()))
    free = sorted(pair for pair, n in edges.items() if n == 1)
    # every free edge lies on exactly one boundary curve
    walked = []
    for loop in mesh.boundary_loop_vertices:
        walked += [tuple(sorted(pair)) for pair in zip(loop.tolist(), loop.tolist()[1:], strict=False)]
        closing = tuple(sorted((int(loop[0]), int(loop[-1]))))
        if closing in free and (len(loop) > 2 or walked[-1] != closing):
            walked.append(closing)
    assert set(walked) >= set(free)
    renumbered = bt.TriangleMesh(points[np.argsort(numbers)], np.array(numbers)[np.array(faces, int).reshape(-1, 3)])
    for name in ("components", "euler_characteristic", "is_closed", "is_manifold", "is_oriented", "is_orientable"):
        assert getattr(renumbered, name) == getattr(mesh, name)
    if mesh.is_manifold:
        assert renumbered.boundary_loops == mesh.boundary_loops


@pytest.mark.parametrize("values", [[[1], [2, 3], [4]], [np.ones(2), np.ones(3), np.ones(2)], [1, 2], 5.0])
def test_data_that_are_no_array(values):
    with pytest.raises(bt.InputError, match=r"data\['x'\]"):
        bt.TriangleMesh([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], data={"x": values})
    with pytest.raises(bt.InputError, match=r"data\['x'\]"):
        bt.PointCloud([[0, 0], [1, 0], [0, 1]], dimension=1, data={"x": values})


def test_meshes_clouds_and_operators_call_their_places_alike():
    volume = bt.PointCloud(np.random.default_rng(0).random((60, 3)), dimension=3)
    for shape, dimension in ((bt.shapes.flat_torus(rows=8, columns=8), 2), (volume, 3)):
        assert shape.coordinates is (shape.vertices if isinstance(shape, bt.TriangleMesh) else shape.points)
        assert bt.operators(shape).coordinates is shape.coordinates
        assert shape.intrinsic_dimension == dimension


def test_usual_slips_are_named():
    ball = bt.shapes.sphere(2)
    with pytest.raises(bt.InputError, match=r"these start at 1: subtract 1"):
        bt.TriangleMesh(ball.vertices, ball.faces + 1)
    with pytest.raises(bt.InputError, match=r"the mesh has 3 vertices .*transposed"):
        bt.TriangleMesh(ball.vertices.T, ball.faces)
    with pytest.raises(bt.InputError, match=r"queries has shape \(3,\).*of one point write \[queries\]"):
        bt.closest_points(ball, [0.0, 0.0, 0.0])
