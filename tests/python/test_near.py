"""Neighbours, closest points and rays against brute force and closed forms."""

import os
import subprocess
import sys

import beltrami as bt
import numpy as np
import pytest
from beltrami import _core
from hypothesis import given, settings
from hypothesis import strategies as st


def brute_neighbors(points, queries, k):
    """Squared distances summed coordinate by coordinate, as the tree does, so that ties are the same ties."""
    squares = np.zeros((len(queries), len(points)))
    for axis in range(points.shape[1]):
        squares += (queries[:, None, axis] - points[None, :, axis]) ** 2
    indices = np.argsort(squares, axis=1, kind="stable")[:, :k]
    return indices, np.sqrt(np.take_along_axis(squares, indices, 1))


def clouds(dimension, count):
    rng = np.random.default_rng(dimension * 1000 + count)
    yield rng.normal(size=(count, dimension))
    yield rng.integers(0, 3, (count, dimension)).astype(float)  # a grid: many ties, many repeated points
    yield np.zeros((count, dimension))
    yield 1e6 + rng.normal(size=(count, dimension))
    yield np.outer(rng.random(count), np.arange(dimension) + 1.0)  # a line


@pytest.mark.parametrize("dimension", [1, 2, 3, 4, 10, 50])
@pytest.mark.parametrize("count", [1, 7, 8, 9, 17, 300])
def test_neighbors_equal_brute_force(dimension, count):
    rng = np.random.default_rng(0)
    for points in clouds(dimension, count):
        spread = np.ptp(points) + 1
        queries = np.vstack([points[:90], points[:90] + spread * rng.normal(size=(min(count, 90), dimension))])
        for k in {1, min(count, 16), min(count, 65), count}:
            for asked in (queries, points):
                indices, distances = bt.nearest_neighbors(points, asked, k)
                expected = brute_neighbors(points, asked, k)
                np.testing.assert_array_equal(indices, expected[0])
                np.testing.assert_array_equal(distances, expected[1])


@pytest.mark.parametrize("dimension", [1, 2, 3, 10])
def test_within_equals_brute_force(dimension):
    for points in clouds(dimension, 200):
        indices, distances = brute_neighbors(points, points, len(points))
        for radius in (0.0, 1.0, np.sqrt(2), float(distances.max())):  # on grids many points lie at exactly these distances
            starts, got, reached = bt.neighbors_within(points, points, radius)
            assert starts[0] == 0
            assert starts[-1] == len(got) == len(reached)
            for query in range(len(points)):
                here = distances[query] <= radius
                np.testing.assert_array_equal(got[starts[query] : starts[query + 1]], indices[query][here])
                np.testing.assert_array_equal(reached[starts[query] : starts[query + 1]], distances[query][here])


def test_neighbors_of_many_points_against_scipy():
    spatial = pytest.importorskip("scipy.spatial")
    rng = np.random.default_rng(3)
    points = rng.normal(size=(20_000, 3)) * (1.0, 0.1, 0.01)
    queries = rng.normal(size=(5_000, 3))
    _, distances = bt.nearest_neighbors(points, queries, 12)
    np.testing.assert_allclose(distances, spatial.cKDTree(points).query(queries, 12)[0], rtol=1e-14)


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 200), st.sampled_from([1e-160, 1e-20, 1.0, 1e20, 1e160]))
@settings(max_examples=40, deadline=None)
def test_scaling(seed, dimension, count, scale):
    """Powers of two, however huge or tiny, change distances exactly in proportion and neighbours not at all."""
    points = np.random.default_rng(seed).normal(size=(count, dimension))
    power = 2.0 ** round(np.log2(scale))
    k = min(count, 9)
    indices, distances = bt.nearest_neighbors(points, points, k)
    scaled, lengths = bt.nearest_neighbors(points * power, points * power, k)
    np.testing.assert_array_equal(indices, scaled)
    np.testing.assert_array_equal(distances * power, lengths)


def test_bad_neighbor_queries_are_refused():
    points = np.zeros((5, 3))
    for wrong in (0, 6, -1):
        with pytest.raises(bt.InputError, match="k is"):
            bt.nearest_neighbors(points, points, wrong)
    with pytest.raises(bt.InputError, match="queries have 2 coordinates, points have 3"):
        bt.nearest_neighbors(points, np.zeros((1, 2)), 1)
    with pytest.raises(bt.InputError, match="point 3"):
        bt.nearest_neighbors([[0.0], [1.0], [2.0], [np.nan]], [[0.0]], 1)
    with pytest.raises(bt.InputError, match="query 1"):
        bt.nearest_neighbors(points, [[0, 0, 0], [0, np.inf, 0]], 1)
    with pytest.raises(bt.InputError):
        bt.nearest_neighbors(np.zeros((0, 3)), points, 1)
    with pytest.raises(bt.InputError, match="radius"):
        bt.neighbors_within(points, points, -1.0)
    with pytest.raises(bt.NumericalError, match="overflows"):
        bt.nearest_neighbors(points, [[1e200, 0, 0]], 1)
    assert bt.nearest_neighbors(points, [], 2)[0].shape == (0, 2)
    assert bt.neighbors_within(np.zeros((0, 3)), points, 1.0)[0].tolist() == [0] * 6


DIGEST = """
import hashlib, numpy as np, beltrami as bt
rng = np.random.default_rng(1)
points, queries = np.round(rng.normal(size=(20_000, 3)), 2), rng.normal(size=(3_000, 3))
found = [*bt.nearest_neighbors(points, points, 9), *bt.nearest_neighbors(points, queries, 80), *bt.neighbors_within(points, queries, 0.1)]
mesh = bt.TriangleMesh(points, rng.integers(0, 20_000, (5_000, 3)))
closest, hits = bt.closest_points(mesh, queries), bt.intersect_rays(mesh, queries, -queries)
found += [closest.points, closest.distances, closest.faces, closest.barycentric, hits.faces, hits.distances, bt.normals(queries)]
print(hashlib.sha256(b"".join(np.ascontiguousarray(x).tobytes() for x in found)).hexdigest())
"""


def test_same_bits_on_any_number_of_threads():
    def fingerprint(threads):
        environment = {**os.environ, "BELTRAMI_NUM_THREADS": threads}
        return subprocess.run([sys.executable, "-c", DIGEST], capture_output=True, text=True, check=True, env=environment).stdout

    assert fingerprint("1") == fingerprint("3")


def sphere(level):
    """Unit sphere by subdivision of an octahedron, outward faces."""
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(level):
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        a, b, c = (inverse.reshape(-1, 3) + len(vertices)).T
        vertices = np.vstack([vertices, vertices[unique].sum(1)])
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
        i, j, k = faces.T
        faces = np.concatenate([np.stack(t, 1) for t in ((i, a, c), (j, b, a), (k, c, b), (a, b, c))])
    return vertices, faces


def segment_distance(q, a, b):
    d = b - a
    share = np.clip(((q - a) * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-300), 0, 1)
    return np.linalg.norm(q - a - share[..., None] * d, axis=-1)


def brute_closest(vertices, faces, queries):
    """Distances to every face, (q, m): the three edges, and the plane where its foot lies inside (least squares, by numpy)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    q = queries[:, None]
    best = np.minimum(np.minimum(segment_distance(q, a, b), segment_distance(q, b, c)), segment_distance(q, c, a))
    for face in range(len(faces)):
        edges = np.stack([b[face] - a[face], c[face] - a[face]], 1)
        if np.linalg.matrix_rank(edges, tol=1e-12 * max(abs(edges).max(), 1e-300)) < 2:
            continue
        v, w = np.linalg.lstsq(edges, (queries - a[face]).T, rcond=None)[0]
        rest = np.linalg.norm(queries - a[face] - np.stack([v, w], 1) @ edges.T, axis=1)
        inside = (v >= 0) & (w >= 0) & (v + w <= 1)
        best[inside, face] = np.minimum(best[inside, face], rest[inside])
    return best


def check_closest(vertices, faces, queries, tolerance=1e-13):
    found = bt.closest_points(bt.TriangleMesh(vertices, faces), queries)
    every = brute_closest(vertices, faces, queries)
    scale = np.ptp(vertices) + abs(queries).max() + 1e-300
    np.testing.assert_allclose(found.distances, every.min(1), atol=tolerance * scale, rtol=0)
    np.testing.assert_allclose(every[np.arange(len(queries)), found.faces], found.distances, atol=tolerance * scale, rtol=0)
    combined = np.einsum("qk,qkd->qd", found.barycentric, vertices[faces[found.faces]])
    np.testing.assert_allclose(found.points, combined, atol=tolerance * scale, rtol=0)
    np.testing.assert_allclose(np.linalg.norm(queries - found.points, axis=1), found.distances, atol=tolerance * scale, rtol=0)
    assert found.barycentric.min() >= 0
    np.testing.assert_allclose(found.barycentric.sum(1), 1, atol=1e-14)
    return found


@pytest.mark.parametrize("dimension", [2, 3, 5])
@pytest.mark.parametrize("count", [1, 3, 4, 5, 33, 300])
def test_closest_points_of_triangle_soup(dimension, count):
    rng = np.random.default_rng(dimension + count)
    vertices = rng.normal(size=(3 * count, dimension))
    faces = rng.permutation(3 * count).reshape(-1, 3)
    queries = np.vstack([rng.normal(size=(100, dimension)), vertices[:50], 1e3 * rng.normal(size=(20, dimension))])
    check_closest(vertices, faces, queries)


def test_closest_points_of_slivers_and_degenerate_triangles():
    rng = np.random.default_rng(0)
    base = rng.normal(size=(60, 3))
    soup = [
        np.stack([base, base, base], 1),  # points
        np.stack([base, base + 1, base + 0.3], 1),  # segments
        np.stack([base, base + 1, base + 0.5 + 1e-9 * rng.normal(size=base.shape)], 1),  # needles
        np.stack([base, base + rng.normal(size=base.shape), base + 1e-10 * rng.normal(size=base.shape)], 1),
    ]
    for corners in soup:
        vertices = corners.reshape(-1, 3)
        check_closest(vertices, np.arange(180).reshape(-1, 3), np.vstack([rng.normal(size=(60, 3)), vertices[:30]]))


def test_closest_points_on_a_sphere():
    vertices, faces = sphere(4)
    rng = np.random.default_rng(1)
    queries = np.vstack([rng.normal(size=(300, 3)), np.zeros((1, 3)), vertices[:50], vertices[faces[:50]].mean(1)])
    found = check_closest(vertices, faces, queries)
    assert (found.distances[301:351] == 0).all()
    around = [np.flatnonzero((faces == vertex).any(1)).min() for vertex in range(50)]
    np.testing.assert_array_equal(found.faces[301:351], around)  # of the faces around a vertex the least
    np.testing.assert_array_equal(found.points[301:351], vertices[:50])


@pytest.mark.parametrize("power", [2.0**-600, 2.0**600])
def test_closest_points_and_rays_in_huge_and_tiny_units(power):
    vertices, faces = sphere(2)
    queries = 3 * np.random.default_rng(0).normal(size=(50, 3))
    here = bt.closest_points(bt.TriangleMesh(vertices, faces), queries)
    there = bt.closest_points(bt.TriangleMesh(vertices * power, faces), queries * power)
    np.testing.assert_allclose(there.distances, here.distances * power, rtol=1e-14)
    hits = bt.intersect_rays(bt.TriangleMesh(vertices * power, faces), queries * power, -queries * power)
    expected = bt.intersect_rays(bt.TriangleMesh(vertices, faces), queries, -queries)
    np.testing.assert_array_equal(hits.faces, expected.faces)
    np.testing.assert_allclose(hits.distances, expected.distances * power, rtol=1e-14)


def brute_rays(vertices, faces, origins, directions):
    """Moeller and Trumbore for every triangle."""
    a, u, v = vertices[faces[:, 0]], vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    p = np.cross(directions[:, None], v)
    determinant = (u * p).sum(-1)
    s = origins[:, None] - a
    x, q = (s * p).sum(-1) / determinant, np.cross(s, u)
    y, t = (directions[:, None] * q).sum(-1) / determinant, (v * q).sum(-1) / determinant
    return np.where((x >= 0) & (y >= 0) & (x + y <= 1) & (t >= 0), t, np.inf).min(1)


@pytest.mark.parametrize("count", [1, 5, 40, 400])
def test_rays_through_triangle_soup(count):
    rng = np.random.default_rng(count)
    vertices, faces = rng.normal(size=(3 * count, 3)), np.arange(3 * count).reshape(-1, 3)
    origins, directions = 2 * rng.normal(size=(500, 3)), rng.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = bt.intersect_rays(bt.TriangleMesh(vertices, faces), origins, 7.5 * directions)
    expected = brute_rays(vertices, faces, origins, directions)
    np.testing.assert_array_equal(found.faces >= 0, np.isfinite(expected))
    np.testing.assert_allclose(found.distances, expected, rtol=1e-9)  # grazing hits lose digits in either formula
    hit = found.faces >= 0
    np.testing.assert_allclose(found.points[hit], (origins + found.distances[:, None] * directions)[hit], atol=1e-9)
    np.testing.assert_array_equal(found.points[~hit], origins[~hit])


def test_rays_are_never_lost_at_edges_and_vertices():
    vertices, faces = sphere(3)
    mesh = bt.TriangleMesh(vertices, faces)
    middles = vertices[faces].sum(1), vertices[faces[:, :2]].sum(1), vertices
    towards = np.vstack(middles)
    rng = np.random.default_rng(0)
    for origin in (np.zeros(3), np.array([0.1, 0.0, 0.0]), 0.2 * rng.normal(size=3)):  # from within every ray hits
        found = bt.intersect_rays(mesh, np.broadcast_to(origin, towards.shape), towards - origin)
        assert (found.faces >= 0).all()
        assert np.isfinite(found.distances).all()
    axes = np.concatenate([np.eye(3), -np.eye(3)])  # along coordinate axes, where divisions by zero lurk
    np.testing.assert_allclose(bt.intersect_rays(mesh, 2 * axes, -axes).distances, 1.0, rtol=1e-15)
    assert (bt.intersect_rays(mesh, 2 * axes, axes).faces == -1).all()
    np.testing.assert_array_equal(bt.intersect_rays(mesh, axes, axes).distances, 0.0)  # an origin on the mesh


def test_bad_meshes_and_rays_are_refused():
    mesh = bt.TriangleMesh(*sphere(0))
    with pytest.raises(bt.InputError, match="no faces"):
        bt.closest_points(bt.TriangleMesh(np.zeros((3, 3)), []), np.zeros((1, 3)))
    with pytest.raises(bt.InputError, match="query 1"):
        bt.closest_points(mesh, [[0, 0, 0], [0, np.nan, 0]])
    with pytest.raises(bt.InputError, match="2 coordinates"):
        bt.closest_points(mesh, np.zeros((1, 2)))
    with pytest.raises(bt.InputError, match="direction 1 is zero"):
        bt.intersect_rays(mesh, np.zeros((2, 3)), [[0, 0, 1], [0, 0, 0]])
    with pytest.raises(bt.InputError, match="as many"):
        bt.intersect_rays(mesh, np.zeros((2, 3)), [[0, 0, 1]])
    with pytest.raises(bt.InputError, match=r"R\^3"):
        bt.intersect_rays(bt.TriangleMesh([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]]), np.zeros((1, 2)), np.ones((1, 2)))
    with pytest.raises(bt.NumericalError, match="overflows"):
        bt.closest_points(mesh, [[1e200, 0, 0]])
    assert bt.closest_points(mesh, []).points.shape == (0, 3)
    assert bt.intersect_rays(mesh, [], []).faces.shape == (0,)
    with pytest.raises(bt.InputError, match="TriangleMesh"):
        bt.closest_points(np.zeros((3, 3)), [])


def test_normals_of_closed_surfaces_point_outwards():
    rng = np.random.default_rng(0)
    angles = rng.uniform(0, 2 * np.pi, (6000, 2))
    around, through = angles.T
    ring = np.stack([np.cos(around), np.sin(around), 0 * around], 1)
    tube = np.cos(through)[:, None] * ring + np.sin(through)[:, None] * np.array([0, 0, 1.0])
    shapes = {"torus": (ring + 0.35 * tube, tube)}
    for dimension in (2, 3, 4):
        directions = rng.normal(size=(600 if dimension < 4 else 6000, dimension))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        shapes[f"sphere in R^{dimension}"] = directions * 3 + 10, directions
    two = np.vstack([directions := shapes["sphere in R^3"][1], directions + 9])  # two pieces
    shapes["two spheres"] = two, np.vstack([directions, directions])
    for name, (points, outward) in shapes.items():
        order = rng.permutation(len(points))
        found = bt.normals(points[order], neighbors=8 if name.endswith("2") else 16)
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-14, err_msg=name)
        assert ((found * outward[order]).sum(1) > 0.8).all(), name


def test_normals_converge():
    """The error of a normal on a sphere falls with the size of its neighbourhood: a fitted slope against the spacing."""
    errors, counts = [], (500, 2000, 8000, 32000)
    for count in counts:
        index = np.arange(count) + 0.5  # a spiral of even points
        z, turn = 1 - 2 * index / count, np.pi * (1 + 5**0.5) * index
        points = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], 1)
        found = bt.normals(points, neighbors=12)
        errors.append(np.sqrt((np.cross(found, points) ** 2).sum(1).mean()))
    slope = np.polyfit(np.log(1 / np.sqrt(counts)), np.log(errors), 1)[0]
    assert slope > 0.9
    assert errors[-1] < 0.02


def test_normals_of_a_plane_and_bad_clouds():
    flat = np.column_stack([np.random.default_rng(0).random((200, 2)), np.zeros(200)])
    found = bt.normals(flat)
    np.testing.assert_allclose(abs(found[:, 2]), 1, atol=1e-12)
    assert abs(found[:, 2].sum()) == pytest.approx(200)
    cloud = bt.PointCloud(flat, dimension=2)
    np.testing.assert_array_equal(bt.normals(cloud), found)
    with pytest.raises(bt.InputError, match="point 0 do not span"):
        bt.normals(np.outer(np.arange(30.0), [1, 2, 3]))
    with pytest.raises(bt.InputError, match="do not span"):
        bt.normals(np.zeros((30, 3)))
    with pytest.raises(bt.InputError, match="neighbors"):
        bt.normals(flat, neighbors=2)
    with pytest.raises(bt.InputError, match="2 points"):
        bt.normals(flat[:2])


def test_shapes_are_points_too():
    mesh = bt.shapes.sphere(2)
    cloud = bt.PointCloud(mesh.vertices[::3])
    from_arrays = bt.nearest_neighbors(mesh.vertices, cloud.points, 3)
    for ours, plain in zip(bt.nearest_neighbors(mesh, cloud, 3), from_arrays, strict=True):
        assert np.array_equal(ours, plain)
    assert np.array_equal(bt.neighbors_within(cloud, mesh, 0.4)[1], bt.neighbors_within(cloud.points, mesh.vertices, 0.4)[1])
    assert bt.closest_points(mesh, cloud).distances.max() < 1e-15


def test_a_bar_is_taken_and_other_progress_refused():
    points = np.random.default_rng(0).normal(size=(50, 3))
    assert bt.nearest_neighbors(points, points, 2, progress=True)[0].shape == (50, 2)
    assert bt.sliced_wasserstein(points, points, progress=True) == 0
    with pytest.raises(bt.InputError, match="progress"):
        bt.normals(points, progress="yes")


@pytest.mark.parametrize("count", [0, -1, 4097, "2", 2.5, None])
def test_thread_counts_are_refused(count):
    before = bt.num_threads()
    with pytest.raises(bt.InputError, match="count"):
        bt.set_num_threads(count)
    assert bt.num_threads() == before


@pytest.mark.parametrize("dimension", [4, 30])
def test_nearest_rows_with_strays(dimension):
    """A point far from all others made the doubt of rounding great for all: 40,000 points of R^4 took 40 times as long."""
    rng = np.random.default_rng(dimension)
    points, queries = rng.normal(size=(7000, dimension)), rng.normal(size=(300, dimension))
    points[::300] *= 1e6
    points[5], points[6] = 1e9, 1e9
    queries[:24], queries[24] = points[::300] + 1.0, points[6]
    indices, distances = _core.nearest_rows(points, queries, lambda share: True)
    squares = np.array([np.square(points - query).sum(1) for query in queries])
    expected = squares.argmin(1)
    assert indices.tolist() == expected.tolist()
    assert indices[24] == 5  # of equally near ones the first
    assert distances == pytest.approx(np.sqrt(squares.min(1)), rel=1e-12)


@pytest.mark.parametrize(("radius", "needed"), [(np.inf, "finite and at least 0"), (-1.0, "at least 0"), (np.nan, "finite and at least 0")])
def test_numbers_out_of_range_are_told_so(radius, needed):
    with pytest.raises(bt.InputError, match=f"it must be {needed}$"):
        bt.neighbors_within([[0.0]], [[0.0]], radius)
