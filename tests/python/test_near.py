"""Neighbours, closest points and rays against brute force and closed forms."""

import os
import subprocess
import sys

import beltrami as bt
import numpy as np
import pytest
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
print(hashlib.sha256(b"".join(np.ascontiguousarray(x).tobytes() for x in found)).hexdigest())
"""


def test_same_bits_on_any_number_of_threads():
    def fingerprint(threads):
        environment = {**os.environ, "BELTRAMI_NUM_THREADS": threads}
        return subprocess.run([sys.executable, "-c", DIGEST], capture_output=True, text=True, check=True, env=environment).stdout

    assert fingerprint("1") == fingerprint("3")
