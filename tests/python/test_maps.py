"""Descriptors and maps between shapes."""

import beltrami as bt
import numpy as np
import pytest


@pytest.fixture(scope="module")
def torus():
    return bt.shapes.torus(rows=36, columns=20)


def test_nearest_in_many_dimensions_is_that_of_brute_force():
    rng = np.random.default_rng(0)
    for dimension, scale in ((10, 1.0), (33, 1e-9), (124, 1e7), (16, 1e-200)):
        points = rng.integers(-2, 3, (700, dimension)) * scale  # whole numbers: many ties, which the least index wins
        queries = np.concatenate([points[::7], rng.normal(size=(150, dimension)) * scale])
        indices, distances = bt.nearest_neighbors(points, queries, 1)
        exact = np.sqrt((((points[None] - queries[:, None]) / scale) ** 2).sum(2))
        assert (indices[:, 0] == exact.argmin(1)).mean() > 0.99  # sums in another order may decide a tie otherwise
        assert np.allclose(distances[:, 0] / scale, exact.min(1), rtol=1e-12, atol=1e-12)


def test_shape_dna_of_a_sphere_is_known_and_knows_no_size():
    dna = bt.shape_dna(bt.shapes.sphere(5), k=8)
    assert np.allclose(dna, 4 * np.pi * np.array([2] * 3 + [6] * 5), rtol=2e-3)
    assert np.allclose(bt.shape_dna(bt.shapes.sphere(5, radius=1e-3), k=8), dna, rtol=1e-9)


def test_signatures_do_not_see_pose_size_or_numbering(torus):
    order = np.random.default_rng(1).permutation(len(torus.vertices))
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    number = np.argsort(order)
    other = bt.TriangleMesh(50 * torus.vertices[order] @ turn + 3, number[torus.faces])
    for signature in (bt.hks, bt.wks):
        values, others = signature(torus, k=30), signature(other, k=30)
        assert np.allclose(values[order].mean(0), others.mean(0), rtol=1e-6)
    assert np.allclose(torus_area_mean(torus, bt.hks(torus)), 1)
    assert np.allclose(torus_area_mean(torus, bt.wks(torus)), 1)


def torus_area_mean(shape, signature):
    mass = bt.operators(shape).mass
    return mass @ signature / mass.sum()


def test_heat_kernel_signature_is_the_closed_form_of_the_sphere():
    sphere, time = bt.shapes.sphere(5), 0.3
    degrees = np.arange(30)
    exact = ((2 * degrees + 1) * np.exp(-degrees * (degrees + 1) * time)).sum() / (4 * np.pi)
    assert np.allclose(bt.hks(sphere, times=[time], k=64, scaled=False), exact, rtol=3e-3)


def test_point_map_and_functional_map_give_one_another():
    shape = bt.shapes.ellipsoid(level=3)  # no two eigenvalues are equal
    pairs = bt.eigenpairs(shape, 60)
    order = np.random.default_rng(3).permutation(len(shape.vertices))
    other = bt.TriangleMesh(shape.vertices[order], np.argsort(order)[shape.faces])
    truth = np.argsort(order)
    matrix = bt.functional_map_of(truth, pairs, other, k=60)
    assert np.allclose(abs(matrix), np.eye(60), atol=1e-6)
    assert np.allclose(matrix, bt.functional_map_of(truth, pairs, other, k=60, orthogonal=True), atol=1e-6)
    assert (bt.point_map_of(matrix, pairs, bt.eigenpairs(other, 60)) == truth).all()


def test_values_and_labels_travel(torus):
    n = len(torus.vertices)
    image = np.random.default_rng(4).permutation(n)
    labels = (torus.vertices[:, 0] > 0).astype(np.int8)
    there = bt.transfer(image, labels, direction="to_target", target=torus)
    assert there.dtype == np.int8
    assert (bt.transfer(image, there) == labels).all()
    few = np.zeros(n, int)  # all in one point: everything takes its mean
    mean = bt.transfer(few, torus.vertices, direction="to_target", target=torus)
    assert np.allclose(mean, torus.vertices.mean(0))


def test_evaluation_measures_what_was_moved():
    plane = bt.shapes.grid(21, 21)
    truth = np.arange(441).reshape(21, 21)
    moved = np.minimum(truth + 1, truth[:, -1:])  # one column on
    found = bt.evaluate_map(moved.ravel(), plane, plane, truth=truth.ravel())
    step = np.linalg.norm(plane.vertices[1] - plane.vertices[0])
    assert np.allclose(np.sort(found.errors)[[0, -1]], [0, step])
    assert found.coverage < 1
    assert np.isclose(found.curve([step / 2])[0], 1 / 21)
    perfect = bt.evaluate_map(truth.ravel(), plane, plane, truth=truth.ravel(), points=50, rng=1)
    assert perfect.mean == 0
    assert perfect.coverage == 1
    assert np.isclose(perfect.dirichlet_energy, 2)


def test_what_does_not_fit_is_refused(torus):
    n = len(torus.vertices)
    calls = [
        lambda: bt.hks(torus, times=[0.0]),
        lambda: bt.wks(torus, energies=1),
        lambda: bt.functional_map_of(np.zeros(3, int), torus, torus),
        lambda: bt.point_map_of(np.full((4, 4), np.nan), torus, torus),
        lambda: bt.evaluate_map(np.full(n, n), torus, torus),
        lambda: bt.transfer([0, 5], [1.0, 2.0]),
        lambda: bt.transfer([0, 1], [1.0, 2.0], direction="to_target"),
        lambda: bt.transfer([0, 1], [1.0, 2.0], direction="sideways"),
    ]
    for call in calls:
        with pytest.raises(bt.InputError):
            call()


def test_what_is_carried_over_fits_the_target_and_is_finite():
    source, target = (bt.shapes.ellipsoid(1.0, 0.8, 0.6, level=level) for level in (3, 2))
    found = bt.register(source, target, modes=20)
    with pytest.raises(bt.InputError, match="642 rows; the target has 162"):
        found.transfer(source.vertices[:, 0])
    with pytest.raises(bt.InputError, match=r"values\[3\] is not finite"):
        found.transfer(np.where(np.arange(162) == 3, np.nan, 1.0))
