"""Conformal registration: pairs with a known factor, exact invariances, the pursuit's promises, refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import beltrami as bt
import numpy as np
import pytest
import scipy.sparse as sparse
from beltrami.__main__ import main
from beltrami.basis_pursuit import limbs
from beltrami.basis_pursuit.curvature import willmore_measure
from beltrami.basis_pursuit.starts import factor_of_map
from beltrami.basis_pursuit.surface import Surface
from hypothesis import given, settings
from hypothesis import strategies as st


def moebius_image(sphere: bt.TriangleMesh, stretch: float) -> tuple[bt.TriangleMesh, np.ndarray]:
    """A Möbius image of the unit sphere and log of its area factor: w = 1 / (cosh u + h sinh u), h the height along the axis."""
    axis = np.array([1.0, 2.0, -1.5]) / np.linalg.norm([1.0, 2.0, -1.5])
    h = sphere.vertices @ axis
    w = 1 / (np.cosh(stretch) + h * np.sinh(stretch))
    height = (h * np.cosh(stretch) + np.sinh(stretch)) * w
    return bt.TriangleMesh((sphere.vertices - h[:, None] * axis) * w[:, None] + height[:, None] * axis, sphere.faces), 2 * np.log(w)


def inverted(mesh: bt.TriangleMesh, centre: np.ndarray) -> tuple[bt.TriangleMesh, np.ndarray]:
    """x -> c + (x - c) / |x - c|², mirrored so that outwards stays outwards: exactly conformal. The log of its area factor."""
    d = mesh.vertices - centre
    square = (d**2).sum(1)
    return bt.TriangleMesh((centre + d / square[:, None]) * [1, 1, -1], mesh.faces), -2 * np.log(square)


def renumbered(mesh: bt.TriangleMesh, seed: int) -> tuple[bt.TriangleMesh, np.ndarray]:
    """The same mesh with other numbers; new[i] is the new number of vertex i."""
    order = np.random.default_rng(seed).permutation(len(mesh.vertices))
    new = np.empty(len(order), int)
    new[order] = np.arange(len(order))
    return bt.TriangleMesh(mesh.vertices[order], new[mesh.faces]), new


def correlation(mass: np.ndarray, x: np.ndarray, y: np.ndarray) -> float:
    x, y = (v - mass @ v / mass.sum() for v in (x, y))
    return float(mass @ (x * y) / np.sqrt((mass @ x**2) * (mass @ y**2)))


def beside(mesh: bt.TriangleMesh) -> np.ndarray:
    return mesh.vertices.mean(0) + np.array([1.2, 1.1, 0.5])


@pytest.fixture(scope="module")
def spot() -> bt.TriangleMesh:
    return bt.examples.spot()


@pytest.fixture(scope="module")
def pair(spot: bt.TriangleMesh) -> tuple[bt.TriangleMesh, np.ndarray, np.ndarray]:
    """Spot inverted in a point beside it, other numbers; log of the factor of the way back; the new numbers."""
    moved, factor = inverted(spot, beside(spot))
    shuffled, new = renumbered(moved, 3)
    back = np.empty_like(factor)
    back[new] = -factor
    return shuffled, back, new


@pytest.fixture(scope="module")
def found(spot: bt.TriangleMesh, pair: tuple[bt.TriangleMesh, np.ndarray, np.ndarray]) -> bt.ConformalRegistrationResult:
    target, _, new = pair
    marks = bt.farthest_points(spot, 4)
    return bt.register_conformal(spot, target, landmarks=np.stack([marks, new[marks]], 1))


# --- analytic ---


def test_an_inversion_is_found(
    spot: bt.TriangleMesh, pair: tuple[bt.TriangleMesh, np.ndarray, np.ndarray], found: bt.ConformalRegistrationResult
) -> None:
    # The two are conformal, so the map is exact but for vertices that fall within rounding of one another on the sphere.
    target, factor, new = pair
    error = np.linalg.norm(target.vertices[found.point_map] - target.vertices[new], axis=1) / np.sqrt(target.area)
    assert error.mean() < 0.002
    assert (error < 0.05).all()
    assert correlation(bt.operators(target).mass, found.log_factor, factor) > 0.99


def test_nothing_given_is_enough_for_shapes_with_limbs(spot: bt.TriangleMesh, pair: tuple[bt.TriangleMesh, np.ndarray, np.ndarray]) -> None:
    target, _, new = pair
    r = bt.register_conformal(spot, target, start="spherical", sweeps=0, refine=None)
    error = np.linalg.norm(target.vertices[r.point_map] - target.vertices[new], axis=1) / np.sqrt(target.area)
    assert error.mean() < 0.005  # tips are found by themselves, and a tip's number may differ by a vertex


def test_curvature_is_enough_for_shapes_without_limbs() -> None:
    sphere = bt.shapes.sphere(frequency=11)
    x, y, z = sphere.vertices.T
    bumps = 1 + 0.15 * np.sin(3 * x + 1) * np.cos(4 * y) + 0.2 * np.exp(-6 * (x - 1) ** 2) + 0.1 * np.sin(5 * z) * x
    source = bt.TriangleMesh(sphere.vertices * bumps[:, None] * [1.3, 1.0, 0.7], sphere.faces)
    target, new = renumbered(inverted(source, np.array([1.0, 0.9, 0.8]))[0], 7)
    r = bt.register_conformal(source, target, sweeps=0, refine=None)
    assert r.start == "spherical"
    error = np.linalg.norm(target.vertices[r.point_map] - target.vertices[new], axis=1) / np.sqrt(target.area)
    assert error.mean() < 1e-3


def test_willmore_measure_of_closed_forms() -> None:
    """2 π² for Clifford's torus, the least of all tori, and for what inversions make of it; 0 for spheres."""
    off = []
    for rows in (24, 48, 96):
        torus = bt.shapes.torus(2**0.5, 1.0, rows=rows, columns=rows)
        totals = [willmore_measure(Surface(bt.operators(mesh))).sum() for mesh in (torus, inverted(torus, np.array([3.0, 0.5, 0.5]))[0])]
        off.append(np.abs(np.array(totals) / (2 * np.pi**2) - 1))
    assert (np.array(off[:-1]) > 3 * np.array(off[1:])).all()  # second order
    assert off[-1].max() < 0.005
    assert willmore_measure(Surface(bt.operators(bt.shapes.sphere(3)))).sum() < 1e-12
    assert willmore_measure(Surface(bt.operators(bt.PointCloud(bt.shapes.sphere(3).vertices)))) is None


def test_curvature_of_triangles_without_area() -> None:
    sphere = bt.shapes.sphere(3)
    vertices = sphere.vertices * [1.0, 1.3, 0.7]
    vertices[sphere.faces[0]] = vertices[sphere.faces[0, 0]]
    vertices[sphere.faces[40, 0]] = vertices[sphere.faces[40, 1]]
    with np.errstate(all="raise"):
        measure = willmore_measure(Surface(bt.operators(bt.TriangleMesh(vertices, sphere.faces))))
    assert measure is not None
    assert (measure >= 0).all()
    assert 0 < measure.sum() < 10


def test_features_alone_fix_the_map() -> None:
    sphere = bt.shapes.sphere(3)
    moved, factor = moebius_image(sphere, 0.5)
    target, new = renumbered(moved, 1)
    table = np.column_stack([sphere.vertices, np.exp(-3 * ((sphere.vertices - sphere.vertices[7]) ** 2).sum(1))])
    carried = np.empty_like(table)
    carried[new] = table
    r = bt.register_conformal(sphere, target, features=(table, carried), k=10, refine=None)
    assert (r.point_map == new).all()
    assert correlation(bt.operators(target).mass[new], r.log_factor[new], -factor) > 0.98  # the bar; blurred over 1 % of the area


def test_the_mirror_image_asks_for_an_orientation(spot: bt.TriangleMesh) -> None:
    mirrored = bt.TriangleMesh(spot.vertices * [1, 1, -1], spot.faces[:, ::-1].copy())
    marks = np.repeat(bt.farthest_points(spot, 5), 2).reshape(-1, 2)
    r = bt.register_conformal(spot, mirrored, landmarks=marks, orientation="any", sweeps=0, refine=None)
    assert "mirrored" in r.start
    assert (r.point_map == np.arange(len(spot.vertices))).all()


def test_a_constant_factor_scales_the_eigenvalues() -> None:
    ops = bt.operators(bt.shapes.sphere(3))
    plain = bt.eigenpairs(ops, 9)
    for scale in (1e-30, 4.0, 1e30):
        scaled = bt.conformal_eigenpairs(ops, np.full(len(ops.mass), np.log(scale)), 9)
        assert np.allclose(scaled.values[1:] * scale, plain.values[1:], rtol=1e-10)  # log and exp of 1e30 lose 70 eps
        assert np.abs(scaled.functions.T @ (scale * ops.mass[:, None] * scaled.functions) - np.eye(9)).max() < 1e-10


def test_the_spectrum_of_a_larger_sphere_gives_a_constant_factor() -> None:
    sphere = bt.shapes.sphere(3)
    r = bt.match_spectrum(sphere, bt.eigenpairs(sphere, 9).values.clip(0) / 9)
    assert r.converged
    assert np.abs(r.log_factor - np.log(9)).max() < 1e-6


def test_the_spectrum_of_another_shape_is_reached() -> None:
    wanted = bt.eigenpairs(bt.shapes.ellipsoid(1.0, 0.8, 0.7, level=3), 8).values
    r = bt.match_spectrum(bt.shapes.sphere(3), wanted)
    assert r.converged
    assert r.error < 1e-3
    assert (np.diff(r.history["objective"]) < 0).all()
    again = bt.conformal_eigenpairs(bt.shapes.sphere(3), r.log_factor, 8)
    assert np.abs(again.values[1:] / wanted[1:] - 1).max() < 1e-3


# --- convergence ---


def test_conformal_eigenvalues_converge_with_the_square_of_the_spacing() -> None:
    # With the factor of the way back the Möbius image of the sphere is the unit sphere again: eigenvalues 2 and 6.
    errors = []
    for level in (2, 3, 4, 5):
        moved, factor = moebius_image(bt.shapes.sphere(level), 0.6)
        values = bt.conformal_eigenpairs(moved, -factor, 9).values
        errors.append(np.abs(values[1:] - [2, 2, 2, 6, 6, 6, 6, 6]).max())
    slope = np.polyfit(np.arange(4), np.log2(errors), 1)[0]
    assert -2.3 < slope < -1.7


# --- properties ---


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.1, 0.8))
def test_features_do_not_know_moebius_maps(seed: int, length: float) -> None:
    rng = np.random.default_rng(seed)
    direction = rng.standard_normal(3)
    move = bt.Moebius.translation(length * direction / np.linalg.norm(direction))
    mesh = bt.shapes.ellipsoid(1.0, 0.8, 0.6, level=2)
    surface = Surface(bt.operators(mesh))
    result = bt.spherical_map(mesh)
    a, b = limbs.Sphered.of(surface, result), limbs.Sphered.of(surface, result.moved(move))
    picked = rng.choice(len(mesh.vertices), 6, replace=False)
    marks = np.stack([picked, picked], 1)
    first, second = limbs.features(a, b, marks)
    others = np.setdiff1d(np.arange(len(mesh.vertices)), picked)  # at a landmark itself the angle has no value
    # Chords of 0.05 carry rounding of 1e-15 of the sphere; the translation squeezes by up to (1 + 0.8) / (1 - 0.8) = 9.
    assert np.abs(first - second)[others].max() < 1e-10
    assert limbs.misfit(a, b, marks) < 1e-12


def persistent_minima(scale: np.ndarray, mass: np.ndarray, graph: Any) -> list[int]:
    """By the definition: the sublevel sets grow vertex by vertex, and where several parts meet all but the one of the least minimum end."""
    parts: dict[int, list[int]] = {}
    found = []
    order = np.argsort(scale, kind="stable")
    for v in order.tolist():
        around = [lowest for lowest, part in parts.items() if set(part) & set(graph.indices[graph.indptr[v] : graph.indptr[v + 1]])]
        first, *others = sorted(around, key=lambda lowest: (scale[lowest], lowest)) or [v]
        for other in others:
            if scale[v] - scale[other] > limbs.PROTRUDES and mass[parts[other]].sum() > limbs.LEAST_LIMB:
                found.append((scale[other] - scale[v], other))
            parts[first] = parts.get(first, []) + parts.pop(other)
        parts.setdefault(first, []).append(v)
    deepest = [(scale.min() - scale.max(), int(order[0]))] if np.ptp(scale) > limbs.PROTRUDES else []
    return [v for _, v in sorted([*found, *deepest])]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.5, 1.0, 3.0]), st.booleans())
def test_tips_are_the_persistent_minima(seed: int, size: float, ties: bool) -> None:
    mesh = bt.shapes.sphere(2)
    surface, rng = Surface(bt.operators(mesh)), np.random.default_rng(seed)
    scale = size * (rng.normal(size=(5, 3)) @ mesh.vertices.T).max(0) + 0.3 * size * rng.normal(size=len(mesh.vertices))
    if ties:
        scale = np.round(2 * scale) / 2
    sphered = limbs.Sphered(surface, mesh.vertices, scale, mesh.vertices[:, 0] + 0j, mesh.vertices[:, 1] + 0j)
    assert sphered.tips == persistent_minima(scale, surface.mass, surface.stiffness)


def test_sizes_and_places_do_not_matter(spot: bt.TriangleMesh) -> None:
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    marks = np.repeat(bt.farthest_points(spot, 4), 2).reshape(-1, 2)
    for size in (1e-6, 1e6):
        other = bt.TriangleMesh(size * spot.vertices @ turn + size, spot.faces)
        r = bt.register_conformal(spot, other, landmarks=marks, k=8, sweeps=1, refine=None)
        assert (r.point_map == np.arange(len(spot.vertices))).all()
        assert np.abs(r.log_factor + 2 * np.log(size)).max() < 1e-5  # coordinates moved by their size lose 1e-10 of a triangle
        assert np.isclose(np.exp(r.log_factor) @ bt.operators(other).mass, spot.area, rtol=1e-10)


def test_what_every_answer_promises(
    spot: bt.TriangleMesh, pair: tuple[bt.TriangleMesh, np.ndarray, np.ndarray], found: bt.ConformalRegistrationResult
) -> None:
    mass = bt.operators(pair[0]).mass
    weight = np.exp(found.log_factor) * mass
    assert np.abs(found.basis.T @ (weight[:, None] * found.basis) - np.eye(20)).max() < 1e-10
    assert found.orthonormality_error < 1e-10
    assert abs(weight.sum() / spot.area - 1) < 1e-10
    for level in np.unique(found.history["level"]):
        values = found.history["objective"][found.history["level"] == level]
        assert (np.diff(values) <= 0).all()
        assert values[-1] < values[0]
    assert found.objective == found.history["objective"][-1]
    assert found.roughness[found.start] == min(found.roughness.values())
    assert ((found.confidence >= 0) & (found.confidence <= 1)).all()
    assert found.confidence.mean() > 0.9
    assert 0.9 < found.coverage <= 1
    values = np.arange(len(spot.vertices))
    assert (found.push_forward(values)[found.point_map] == values).mean() > 0.9
    assert (found.pull_back(np.arange(len(mass))) == found.point_map).all()


def test_the_same_bits_on_any_number_of_threads(spot: bt.TriangleMesh) -> None:
    target, _ = inverted(spot, beside(spot))
    marks = np.repeat(bt.farthest_points(spot, 4), 2).reshape(-1, 2)
    before = bt.num_threads()
    answers = []
    try:
        for threads in (1, 2):
            bt.set_num_threads(threads)
            answers.append(bt.register_conformal(spot, target, landmarks=marks, k=10, sweeps=1, refine=20))
    finally:
        bt.set_num_threads(before)
    for name in ("point_map", "log_factor", "basis"):
        assert (getattr(answers[0], name) == getattr(answers[1], name)).all()


def test_the_factor_of_the_identity_is_one() -> None:
    surface = Surface(bt.operators(bt.shapes.ellipsoid(1.0, 0.7, 0.5, level=3)))
    assert np.abs(factor_of_map(surface, surface, np.arange(642))).max() < 1e-10


def test_a_wrong_landmark_among_found_ones_is_dropped(spot: bt.TriangleMesh) -> None:
    surface = Surface(bt.operators(spot))
    side = limbs.Sphered.of(surface, bt.spherical_map(spot))
    good = np.repeat(bt.farthest_points(spot, 7).astype(np.int64), 2).reshape(-1, 2)
    wrong = good.copy()
    wrong[5, 1] = good[4, 1] + 1
    kept = limbs.without_outliers(side, side, wrong, 3)
    assert 5 not in [int(np.flatnonzero((wrong == row).all(1))[0]) for row in kept]
    assert len(limbs.without_outliers(side, side, wrong, 7)) == 7  # what was given is never dropped


def test_landmarks_that_cannot_be_right_are_named(spot: bt.TriangleMesh) -> None:
    marks = np.repeat(bt.farthest_points(spot, 6), 2).reshape(-1, 2)
    marks[:, 1] = np.roll(marks[:, 1], 1)  # each is somebody else's
    r = bt.register_conformal(spot, spot, landmarks=marks, k=8, sweeps=0, refine=None)
    assert any("misses" in note for note in r.notes)


# --- other topology, clouds ---


@pytest.mark.parametrize("given", ["landmarks", "features"])
def test_an_inverted_torus_is_found(given: str) -> None:
    """No sphere leads to it; the potentials of charges at the landmarks do. The bases alone led to 0.29."""
    torus = bt.shapes.torus(2.0, 0.8, rows=40, columns=20)
    moved, _ = inverted(torus, np.array([4.0, 1.0, 1.0]))
    target, new = renumbered(moved, 5)
    marks = np.random.default_rng(6).choice(len(new), 12, replace=False)
    values = np.column_stack([torus.vertices, np.sin(3 * torus.vertices)])
    carried = np.empty_like(values)
    carried[new] = values
    r = (
        bt.register_conformal(torus, target, landmarks=np.stack([marks, new[marks]], axis=1))
        if given == "landmarks"
        else bt.register_conformal(torus, target, features=(values, carried))
    )
    away = np.linalg.norm(target.vertices[r.point_map] - target.vertices[new], axis=1) / np.sqrt(target.area)
    assert away.mean() < 0.01
    assert not any("misses" in note for note in r.notes)


def test_maps_that_miss_the_landmarks_are_not_taken() -> None:
    """A torus and the inversion of another mesh of it: the smoothest map missed ten of twelve landmarks, by 0.5 sqrt(area) at worst."""
    torus, finer = (bt.shapes.torus(2.0, 0.8, rows=rows, columns=columns) for rows, columns in ((40, 20), (53, 27)))
    centre = np.array([4.0, 1.0, 1.0])
    there, _ = inverted(torus, centre)
    target, _ = inverted(finer, centre)
    marks = np.random.default_rng(7).choice(len(torus.vertices), 12, replace=False)
    images = bt.nearest_neighbors(target.vertices, there.vertices[marks], 1)[0][:, 0]
    r = bt.register_conformal(torus, target, landmarks=np.stack([marks, images], axis=1))
    away = np.linalg.norm(target.vertices[r.point_map] - there.vertices, axis=1) / np.sqrt(target.area)
    assert away.mean() < 0.05  # the target's own spacing is 0.03
    assert np.linalg.norm(target.vertices[r.point_map[marks]] - target.vertices[images], axis=1).max() < 0.1 * np.sqrt(target.area)


def test_a_torus_is_matched_from_landmarks() -> None:
    torus = bt.shapes.torus(rows=36, columns=18)
    stretched = bt.TriangleMesh(torus.vertices * [1.0, 1.15, 0.9], torus.faces)
    marks = np.repeat(bt.farthest_points(torus, 12), 2).reshape(-1, 2)
    r = bt.register_conformal(torus, stretched, landmarks=marks, k=12)
    error = np.linalg.norm(stretched.vertices[r.point_map] - stretched.vertices, axis=1) / np.sqrt(stretched.area)
    assert error.mean() < 0.03
    assert any("genus 1" in note for note in r.notes)


def test_the_near_isometric_start_is_there() -> None:
    ellipsoid = bt.shapes.ellipsoid(1.0, 0.7, 0.5, level=3)
    target, new = renumbered(ellipsoid, 5)
    r = bt.register_conformal(ellipsoid, target, start="register", k=10, refine=None)
    turns = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])  # half turns are symmetries of an ellipsoid
    errors = [np.linalg.norm(target.vertices[r.point_map] - target.vertices[new] * turn, axis=1).mean() for turn in turns]
    assert min(errors) < 0.02


# --- peer ---


def test_conformal_eigenpairs_are_those_of_scipy(spot: bt.TriangleMesh) -> None:
    from scipy.sparse.linalg import eigsh

    ops = bt.operators(spot)
    eta = 2 * np.sin(3 * spot.vertices[:, 0]) - spot.vertices[:, 1]
    mine = bt.conformal_eigenpairs(ops, eta, 12)
    theirs = eigsh(ops.stiffness, 12, sparse.diags_array(np.exp(eta) * ops.mass), sigma=-1e-3, v0=np.ones(len(eta)))[0]
    assert np.allclose(mine.values, np.sort(theirs), rtol=1e-8, atol=1e-9)


# --- faults ---


def test_bad_input_is_refused(spot: bt.TriangleMesh, tmp_path: Path) -> None:
    n = len(spot.vertices)
    for marks, said in (
        ([[0, n]], "vertices, numbered from 0"),
        ([[-1, 0]], "vertices, numbered from 0"),
        ([[0, 1], [5, 6], [0, 1]], "repeated"),
        ([[0, 1], [0, 2]], "contradict"),
        ([[0, 1], [3, 1]], "contradict"),
        ([0, 1, 2], "shape"),
        ([[0.5, 1]], "whole"),
    ):
        with pytest.raises(bt.InputError, match=said):
            bt.register_conformal(spot, spot, landmarks=marks)
    for features, said in (
        ((np.ones(n), np.ones(n - 1)), "a row per vertex"),
        (np.ones((n, 2)), "pair"),
        ((np.ones((n, 2)), np.ones((n, 3))), "equally many"),
        ((np.full(n, np.nan), np.ones(n)), "is nan"),
    ):
        with pytest.raises(bt.InputError, match=said):
            bt.register_conformal(spot, spot, features=features)
    for options in ({"start": "guess"}, {"orientation": "up"}, {"k": 2}, {"refine": 3}, {"misfit_weight": 0.0}, {"start": "landmarks"}):
        with pytest.raises(bt.InputError, match=next(iter(options))):
            bt.register_conformal(spot, spot, **options)
    torus = bt.shapes.torus(rows=24, columns=12)
    with pytest.raises(bt.TopologyError, match=r"genus 1.*start='landmarks'"):
        bt.register_conformal(torus, spot, landmarks=[[0, 0]], start="spherical")
    with pytest.raises(bt.Cancelled):
        bt.register_conformal(spot, spot, landmarks=[[0, 0], [100, 100], [2000, 2000]], progress=lambda share: share < 0.05)


def test_factors_and_spectra_are_checked() -> None:
    sphere = bt.shapes.sphere(2)
    steep = np.zeros(162)
    steep[0] = 300.0
    for eta, said in ((np.zeros(5), "shape"), (np.full(162, np.nan), "is nan"), (steep, "spans"), (np.full(162, 800.0), "exp")):
        with pytest.raises(bt.InputError, match=said):
            bt.conformal_eigenpairs(sphere, eta, 4)
    for values, said in (([0.0], "2 to"), ([0.0, 2.0, 1.0], "ascend"), ([1.0, 2.0], "zero"), ([0.0, 0.0, 2.0], "zero")):
        with pytest.raises(bt.InputError, match=said):
            bt.match_spectrum(sphere, values)
    volume = bt.PointCloud(np.random.default_rng(0).random((200, 3)), dimension=3)
    with pytest.raises(bt.InputError, match="surfaces only"):
        bt.conformal_eigenpairs(volume, np.zeros(200), 4)


# --- files, pictures, command line ---


def test_results_are_saved_and_painted(found: bt.ConformalRegistrationResult, spot: bt.TriangleMesh, tmp_path: Path) -> None:
    found.save(tmp_path / "r.npz")
    with np.load(tmp_path / "r.npz") as archive:
        assert (archive["point_map"] == found.point_map).all()
        assert "objective" in archive.files
    found.save(tmp_path / "r.csv")
    assert len((tmp_path / "r.csv").read_text().splitlines()) == len(spot.vertices) + 1
    assert found.plot(size=(200, 160)).pixels.shape == (160, 200, 3)
    assert found.plot(spot.vertices[:, 1], size=(200, 160)).pixels.std() > 1
    with pytest.raises(bt.InputError, match="log_factor"):
        found.plot("map")
    with pytest.raises(bt.InputError, match=r"\.npz"):
        found.save(tmp_path / "r.txt")


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = bt.shapes.ellipsoid(1.0, 0.8, 0.6, level=2)
    bt.save(source, tmp_path / "a.ply")
    bt.save(moebius_image(bt.shapes.sphere(2), 0.2)[0], tmp_path / "b.ply")
    marks = bt.farthest_points(source, 6)
    (tmp_path / "marks.csv").write_text("source,target\n" + "".join(f"{m},{m}\n" for m in marks))
    files = [str(tmp_path / name) for name in ("a.ply", "b.ply")]
    outputs = [str(tmp_path / name) for name in ("map.npz", "map.csv", "map.ply", "factor.png")]
    options = ["--landmarks", str(tmp_path / "marks.csv"), "-k", "8", "--refine", "16"]
    assert main(["register-conformal", *files, *options, *[word for name in outputs for word in ("-o", name)]]) in (0, 1)
    assert "coverage" in capsys.readouterr().out
    assert all(Path(name).exists() for name in outputs)
    assert main(["register-conformal", *files, "--landmarks", str(tmp_path / "none.csv")]) == 2
