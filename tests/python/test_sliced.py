"""Sliced Wasserstein distances against closed forms, an exact coupling by breakpoints, and POT."""

import os
import subprocess
import sys

import beltrami as bt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st


def exact_line(x, a, y, b):
    """Optimal cost on a line by integrating the two quantile functions between all breakpoints of the cumulative masses."""
    i, j = np.argsort(x, kind="stable"), np.argsort(y, kind="stable")
    ca, cb = np.cumsum(a[i]) / a.sum(), np.cumsum(b[j]) / b.sum()
    ends = np.unique(np.concatenate([ca, cb]).clip(0, 1))
    mass = np.diff(ends, prepend=0.0)
    middle = ends - mass / 2
    xs = x[i][np.searchsorted(ca, middle).clip(max=len(x) - 1)]
    ys = y[j][np.searchsorted(cb, middle).clip(max=len(y) - 1)]
    return (mass * (xs - ys) ** 2).sum()


def exact(x, y, directions, a=None, b=None):
    a = np.ones(len(x)) if a is None else a
    b = np.ones(len(y)) if b is None else b
    return np.sqrt(np.mean([exact_line(x @ u, a, y @ u, b) for u in directions]))


def skewed(count, dimension, seed):
    rng = np.random.default_rng(seed)
    return (rng.gamma(np.linspace(1.2, 3.0, dimension), 1.0, (count, dimension)) - 1.5) * np.linspace(2.0, 0.6, dimension)


@pytest.mark.parametrize(("n", "m"), [(300, 300), (300, 173), (1, 40), (40, 1), (8, 9), (1, 1)])
@pytest.mark.parametrize("dimension", [1, 2, 3, 7, 20])
@pytest.mark.parametrize("weighted", [(False, False), (True, False), (False, True), (True, True)])
def test_equals_exact_coupling(n, m, dimension, weighted):
    rng = np.random.default_rng(n + m)
    x, y = skewed(n, dimension, 1), skewed(m, dimension, 2) + 0.3
    a, b = (rng.dirichlet(np.full(count, 0.3)) if w else None for w, count in zip(weighted, (n, m), strict=True))
    directions = bt.sliced.orthonormal_directions(dimension, 15, rng=5)
    got = bt.sliced_wasserstein(x, y, source_weights=a, target_weights=b, directions=directions)
    assert got == pytest.approx(exact(x, y, directions, a, b), rel=1e-11)  # a thousand roundings of masses


@pytest.mark.parametrize("kind", ["outlier", "repeated", "grid", "clusters", "tiny"])
def test_hard_to_sort(kind):
    """Values that crowd one bucket of the sort, or fill a few only."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 5000, 1))
    if kind == "outlier":
        x[17] = 1e12
    elif kind == "repeated":
        x[:4000] = 0.5
    elif kind == "grid":
        x, y = np.round(x), np.round(y)
    elif kind == "clusters":
        x, y = np.round(3 * x) + 1e-9 * y, np.round(2 * y) + 1e-9 * x
    else:
        x, y = x * 1e-180, y * 1e-180
    got = bt.sliced_wasserstein(x, y, directions=1)
    top = max(abs(x).max(), abs(y).max())
    expected = top * np.sqrt((((np.sort(x, axis=0) - np.sort(y, axis=0)) / top) ** 2).mean())
    assert got == pytest.approx(expected, rel=1e-12)


def test_shift_is_seen_exactly():
    """Over orthonormal blocks the mean of (t . u)^2 is |t|^2 / n."""
    x, shift = skewed(400, 5, 0), np.random.default_rng(9).normal(size=5)
    got = bt.sliced_wasserstein(x, x[::-1] + shift, directions=40, rng=3)
    assert got == pytest.approx(np.linalg.norm(shift) / np.sqrt(5), rel=1e-13)


def test_normal_distributions():
    """N(0, 1) and N(0, s^2) are |s - 1| apart in every direction; samples agree to their own noise of 1 / sqrt(n)."""
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(40_000, 3)), 1.7 * rng.normal(size=(40_000, 3))
    assert bt.sliced_wasserstein(x, y) == pytest.approx(0.7, abs=0.02)


def test_against_pot():
    ot = pytest.importorskip("ot")
    x, y = skewed(150, 4, 0), skewed(211, 4, 1)
    directions = bt.sliced.orthonormal_directions(4, 20, rng=0)
    theirs = ot.sliced_wasserstein_distance(x, y, projections=directions.T)
    assert bt.sliced_wasserstein(x, y, directions=directions) == pytest.approx(float(theirs), rel=1e-9)


def test_triangle_inequality_at_the_default_directions():
    x, y, z = skewed(50, 3, 0), skewed(80, 3, 1) + 1, skewed(60, 3, 2) * 2
    d = bt.sliced_wasserstein
    assert d(x, z) <= d(x, y) + d(y, z)
    assert d(x, x) == 0.0


def test_directions_are_uniform():
    """Each block is orthonormal; over many blocks E[u_i^4] = 3 / (n (n + 2)), as of uniform directions."""
    directions = bt.sliced.orthonormal_directions(3, 30_000, rng=0)
    blocks = directions.reshape(-1, 3, 3)
    np.testing.assert_allclose(blocks @ blocks.transpose(0, 2, 1), np.broadcast_to(np.eye(3), blocks.shape), atol=1e-14)
    assert (directions**4).mean(0) == pytest.approx(3 / 15, abs=0.005)
    assert abs(directions.mean(0)).max() < 0.02


@given(st.integers(0, 2**31), st.integers(1, 6), st.integers(1, 60), st.integers(1, 60), st.booleans())
@settings(max_examples=40, deadline=None)
def test_symmetry_scaling_and_weights(seed, dimension, n, m, weighted):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(n, dimension)), rng.normal(size=(m, dimension))
    a, b = (rng.uniform(0.01, 1, n), rng.uniform(0.01, 1, m)) if weighted else (None, None)
    directions = bt.sliced.orthonormal_directions(dimension, 6, rng=seed)
    d = bt.sliced_wasserstein(x, y, source_weights=a, target_weights=b, directions=directions)
    assert bt.sliced_wasserstein(y, x, source_weights=b, target_weights=a, directions=directions) == pytest.approx(d, rel=1e-12)
    huge = bt.sliced_wasserstein(x * 2.0**600, y * 2.0**600, source_weights=a, target_weights=b, directions=directions)
    assert huge == pytest.approx(d * 2.0**600, rel=1e-12)
    twice = np.concatenate([x, x])
    doubled = None if a is None else np.concatenate([a, a])
    again = bt.sliced_wasserstein(twice, y, source_weights=doubled, target_weights=b, directions=directions)
    assert again == pytest.approx(d, rel=1e-10)


@pytest.mark.parametrize("dimension", [1, 2, 3, 4, 5, 8])
@pytest.mark.parametrize("weighted", [False, True])
def test_rotated_copy_is_recovered(dimension, weighted):
    rng = np.random.default_rng(dimension)
    x, turn = skewed(300, dimension, dimension), np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    order = rng.permutation(len(x))
    weights = rng.uniform(0.1, 1, len(x)) if weighted else None
    found = bt.rotation_invariant_sliced_wasserstein(
        x, (x @ turn)[order], source_weights=weights, target_weights=None if weights is None else weights[order]
    )
    assert found.distance < 1e-12
    np.testing.assert_allclose(found.rotation, turn, atol=1e-10)
    assert found.converged


@pytest.mark.parametrize("dimension", [2, 3, 6])
def test_rotation_invariant_distance(dimension):
    rng = np.random.default_rng(7)
    turn = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    x, y = skewed(210, dimension, 1), skewed(150, dimension, 2) @ turn
    a = rng.dirichlet(np.full(210, 3.0))
    found = bt.rotation_invariant_sliced_wasserstein(x, y, source_weights=a, rng=4)
    np.testing.assert_allclose(found.rotation.T @ found.rotation, np.eye(dimension), atol=1e-12)
    forth = exact(x @ found.rotation, y, found.directions, a)
    back = exact(y @ found.rotation.T, x, found.directions, None, a)
    assert min(abs(found.distance / forth - 1), abs(found.distance / back - 1)) < 1e-10
    assert (np.diff(found.history["distance"]) <= 0).all()
    assert found.history["distance"][-1] == pytest.approx(found.distance, rel=1e-14)
    other = bt.rotation_invariant_sliced_wasserstein(y, x, target_weights=a, rng=4)
    assert other.distance == pytest.approx(found.distance, rel=1e-9)
    plain = bt.sliced_wasserstein(x, y, source_weights=a, directions=found.directions)
    assert found.distance <= plain
    turned = bt.rotation_invariant_sliced_wasserstein(x @ turn, y, source_weights=a, rng=4)
    assert turned.distance == pytest.approx(found.distance, rel=0.05)  # invariant up to the finite number of directions


def test_rotation_invariant_distance_of_many_points():
    """More points than the coarse search looks at."""
    x = skewed(3000, 4, 3)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(4, 4)))[0]
    found = bt.rotation_invariant_sliced_wasserstein(x, np.random.default_rng(6).permutation(x @ turn))
    assert found.distance < 1e-12
    np.testing.assert_allclose(found.rotation, turn, atol=1e-10)


def test_cross_matrix_is_the_gradient():
    """At fixed couplings the value is |X|^2/n + |Y|^2/n - 2 tr(R^T H): two independent evaluations of one identity."""
    x, y = skewed(70, 3, 0), skewed(95, 3, 1)
    directions = bt.sliced.orthonormal_directions(3, 9, rng=0)
    from beltrami import _core

    cross, values = _core.SlicedAlignment(x, y, None, None, directions).step(np.eye(3)[None])
    squares = ((x @ directions.T) ** 2).mean() + ((y @ directions.T) ** 2).mean()
    assert values[0] == pytest.approx(squares - 2 * np.trace(cross[0]), rel=1e-12)


def test_bad_measures_are_refused():
    x, d, r = np.zeros((4, 3)), bt.sliced_wasserstein, bt.rotation_invariant_sliced_wasserstein
    for method in (d, r):
        with pytest.raises(bt.InputError, match="same D"):
            method(x, np.zeros((4, 2)))
        with pytest.raises(bt.InputError, match="point in each"):
            method(x, np.zeros((0, 3)))
        with pytest.raises(bt.InputError, match="weight 2"):
            method(x, x, source_weights=[1, 1, -1, 1])
        with pytest.raises(bt.InputError, match="all weights"):
            method(x, x, target_weights=np.zeros(4))
        with pytest.raises(bt.InputError, match="direction 1 has length 2"):
            method(x, x, directions=[[1, 0, 0], [0, 2, 0]])
        with pytest.raises(bt.InputError, match=r"source\[\(1, 0\)\]"):
            method([[0.0], [np.nan]], [[0.0]])
        with pytest.raises(bt.Cancelled):
            method(skewed(40_000, 3, 0), skewed(40_000, 3, 1), directions=600, progress=lambda share: False)
    with pytest.raises(bt.InputError, match="orthogonal"):
        r(x, x, starts=np.zeros((1, 3, 3)))
    same = r(x, x)  # all points at the origin: every rotation is as good
    assert same.distance == 0
    assert np.isfinite(same.rotation).all()


DIGEST = """
import numpy as np, beltrami as bt
x, y = np.random.default_rng(0).gamma(2.0, size=(2, 1700, 4))
r = bt.rotation_invariant_sliced_wasserstein(x, y[:1500], rng=7)
print(bt.sliced_wasserstein(x, y, rng=1).hex(), bt.sliced_wasserstein(x, y[:-1], rng=1).hex(), r.distance.hex(), r.rotation.tobytes().hex())
"""


def test_same_bits_on_any_number_of_threads():
    def fingerprint(threads):
        environment = {**os.environ, "BELTRAMI_NUM_THREADS": threads}
        return subprocess.run([sys.executable, "-c", DIGEST], capture_output=True, text=True, check=True, env=environment).stdout

    assert fingerprint("1") == fingerprint("3")


@pytest.mark.parametrize("spread", [0.0, 2.0])
def test_rotated_copies_of_many_points_are_found_whatever_their_numbering_and_weights(spread: float) -> None:
    """Rotations are tried on a part of them: with nearly equal principal axes, or a few heavy points, other parts had other answers."""
    rng = np.random.default_rng(3)
    x, weights = rng.normal(size=(3000, 3)), np.exp(spread * rng.normal(size=3000))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    order = rng.permutation(len(x))
    found = bt.rotation_invariant_sliced_wasserstein(x, (x @ turn)[order], source_weights=weights, target_weights=weights[order])
    assert found.distance < 1e-12
    np.testing.assert_allclose(found.rotation, turn, atol=1e-10)
