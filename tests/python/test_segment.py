"""Segmentation and denoising: closed forms, trends, invariances, maximum flow, and what is refused."""

from __future__ import annotations

import sys
import warnings

import beltrami as bt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st


def cap(mesh, angle, noise=0.0, seed=0):
    """A cap around the z axis of the unit sphere, a spacing wide at its rim, with noise."""
    polar = np.arccos(np.clip(mesh.vertices[:, 2], -1, 1))
    spacing = np.sqrt(4 * np.pi / len(polar))
    return np.clip(0.5 - (polar - angle) / spacing, 0, 1) + noise * np.random.default_rng(seed).normal(size=len(polar))


def energy(mesh, phi, image, means, fidelity):
    """The energy by the operators, on unit area: none of the kernels that found phi."""
    ops, area = bt.operators(mesh), mesh.area
    slope = np.linalg.norm((ops.gradient @ phi).reshape(len(mesh.faces), -1), axis=1)
    r = (np.square(image - means[1]) - np.square(image - means[0])).reshape(len(phi), -1).sum(1)
    return float(ops.element_areas @ slope / np.sqrt(area) + fidelity * ops.mass @ (r * phi) / area)


# --- analytic ---


def test_certificate_and_means_are_what_they_claim():
    mesh = bt.shapes.sphere(4)
    image = cap(mesh, 1.0, 0.3)
    r = bt.segment(mesh, image, fidelity=40.0)
    ops = bt.operators(mesh)
    assert r.converged
    assert r.gap <= 1e-4
    assert r.phi.min() >= 0
    assert r.phi.max() <= 1
    assert np.array_equal(r.labels, r.phi > 0.5)
    averages = [np.average(image[r.labels == k], weights=ops.mass[r.labels == k]) for k in (0, 1)]
    assert np.allclose(r.means[:, 0], averages, rtol=0, atol=1e-12)  # two sums of the same numbers
    assert r.primal == pytest.approx(energy(mesh, r.phi, image, r.means, 40.0), rel=1e-10)  # rounding of 1e4 terms
    # the dual value again, from the field that is handed out
    assert np.linalg.norm(r.dual_field, axis=1).max() <= 1 + 1e-12
    area = mesh.area
    flux = -ops.mass * (ops.divergence @ r.dual_field.ravel()) / np.sqrt(area)
    linear = 40.0 * (np.square(image - r.means[1]) - np.square(image - r.means[0])) * ops.mass / area
    assert r.dual == pytest.approx(np.minimum(0, flux + linear).sum(), rel=1e-9)
    assert r.dual <= energy(mesh, (r.phi > 0.5).astype(float), image, r.means, 40.0) == pytest.approx(r.threshold_energy, rel=1e-10)
    assert r.areas.sum() == pytest.approx(area, rel=1e-12)


def test_contrast_that_denoising_takes_from_a_cap():
    # ROF of a cap's indicator is 1 - P / (mu |cap|) inside, P / (mu |rest|) outside (Strong and Chan 2003), mu = fidelity / sqrt(area)
    mesh, angle, fidelity = bt.shapes.sphere(5), 0.9, 60.0
    u = bt.denoise(mesh, cap(mesh, angle), fidelity=fidelity)
    polar, mass = np.arccos(np.clip(mesh.vertices[:, 2], -1, 1)), bt.operators(mesh).mass
    mu, length, inside = fidelity / np.sqrt(4 * np.pi), 2 * np.pi * np.sin(angle), 2 * np.pi * (1 - np.cos(angle))
    core, rest = polar < angle - 0.1, polar > angle + 0.1
    # the discrete perimeter is 1 to 3 % too long at this spacing
    assert 1 - np.average(u.image[core], weights=mass[core]) == pytest.approx(length / (mu * inside), rel=0.05)
    assert np.average(u.image[rest], weights=mass[rest]) == pytest.approx(length / (mu * (4 * np.pi - inside)), rel=0.05)


def test_denoising_keeps_the_mean_of_each_piece_and_certifies_itself():
    first = bt.shapes.sphere(3)
    vertices = np.concatenate([first.vertices, first.vertices + 4])
    mesh = bt.TriangleMesh(vertices, np.concatenate([first.faces, first.faces + len(first.vertices)]))
    image = np.random.default_rng(3).normal(size=(len(vertices), 3))
    u = bt.denoise(mesh, image, fidelity=8.0)
    mass, half = bt.operators(mesh).mass, len(first.vertices)
    for piece in (slice(0, half), slice(half, None)):
        assert np.allclose(mass[piece] @ (u.image[piece] - image[piece]), 0, atol=1e-9)  # rows of the stiffness sum to zero
    assert u.converged
    assert u.dual <= u.primal
    assert u.dual_field.shape == (len(mesh.faces), 3, 3)
    assert np.sqrt(np.square(u.dual_field).sum((1, 2))).max() <= 1 + 1e-12


def test_three_values_in_bands():
    mesh = bt.shapes.sphere(4)
    truth = np.digitize(mesh.vertices[:, 2], [-0.35, 0.4])
    image = truth / 2 + 0.08 * np.random.default_rng(7).normal(size=len(truth))
    r = bt.segment(mesh, image, fidelity=100.0, regions=3)
    mass = bt.operators(mesh).mass
    assert r.converged
    assert mass @ (r.labels != truth) / mass.sum() < 0.02
    assert np.allclose(r.phi.sum(1), 1, atol=1e-12)
    assert r.phi.min() >= 0
    # two circles of latitude, each boundary counted once
    length = 2 * np.pi * (np.sqrt(1 - 0.35**2) + np.sqrt(1 - 0.4**2))
    assert r.contour_length == pytest.approx(length, rel=0.08)  # jagged by a triangle where the image jumps between vertices


def test_two_regions_either_way():
    """The simplex of two memberships is the unit interval: the same minimum."""
    mesh = bt.shapes.grid(17, 17)
    image = (mesh.vertices[:, 0] > 0.5) + 0.2 * np.random.default_rng(1).normal(size=289)
    scalar = bt.segment(mesh, image, fidelity=20.0, tolerance=1e-6, means=[0.0, 1.0])
    three = bt.segment(mesh, image, fidelity=20.0, tolerance=1e-6, means=[0.0, 1.0, 50.0], regions=3)  # nobody wants 50
    mass = bt.operators(mesh).mass
    constant = 20.0 * mass @ np.square(image) / mass.sum()  # the part that r leaves out
    assert three.primal == pytest.approx(scalar.primal + constant, rel=1e-5)
    assert np.array_equal(three.labels, scalar.labels)


# --- convergence ---


def test_length_of_a_cap_improves_with_refinement():
    errors = []
    for level in (3, 4, 5, 6):
        mesh = bt.shapes.sphere(level)
        r = bt.segment(mesh, cap(mesh, 1.1), fidelity=30.0)
        errors.append(abs(r.contour_length / (2 * np.pi * np.sin(1.1)) - 1))
    assert errors[2] < 0.03
    assert errors[3] < 0.02
    assert errors[3] < errors[0]


def test_sweeps_hardly_depend_on_the_mesh():
    sweeps = []
    for level in (4, 5, 6):
        mesh = bt.shapes.sphere(level)
        p = mesh.vertices / np.sqrt(4 * np.pi)
        image = (np.sin(9 * p).sum(1) > 0.3) + 0.4 * np.random.default_rng(2).normal(size=len(p))
        sweeps.append(bt.segment(mesh, image, fidelity=60.0).iterations)
    assert max(sweeps) <= 100  # 20 to 50 were seen


# --- properties ---


@settings(max_examples=8, deadline=None)
@given(st.floats(1e-6, 1e6), st.integers(0, 2**31))
def test_scale_motion_and_numbering_change_nothing(scale, seed):
    rng = np.random.default_rng(seed)
    mesh = bt.shapes.sphere(3)
    image = cap(mesh, 1.0, 0.2)
    r = bt.segment(mesh, image, fidelity=30.0)
    turn, order = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.permutation(len(image))
    moved = bt.TriangleMesh(scale * (mesh.vertices[order] @ turn.T + 5), np.argsort(order)[mesh.faces][rng.permutation(len(mesh.faces))])
    other = bt.segment(moved, image[order], fidelity=30.0)
    assert other.primal == pytest.approx(r.primal, rel=2e-4)  # the two gaps
    assert other.contour_length / scale == pytest.approx(r.contour_length, rel=0.02)
    assert np.mean(other.labels != r.labels[order]) < 0.01


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from(["isotropic", "edge"]), st.floats(1.0, 500.0))
def test_no_other_function_is_below_the_bound(seed, tv, fidelity):
    rng = np.random.default_rng(seed)
    mesh = bt.shapes.grid(9, 8)
    image = rng.normal(size=72)
    u = bt.denoise(mesh, image, fidelity=fidelity, tv=tv)
    ops = bt.operators(mesh)

    def value(x):
        if tv == "isotropic":
            variation = ops.element_areas @ np.linalg.norm((ops.gradient @ x).reshape(-1, 3), axis=1)
        else:
            pairs = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), 1)
            edges, where = np.unique(pairs, axis=0, return_inverse=True)
            weights = np.pi / 2 * np.bincount(where.ravel(), np.tile(ops.element_areas, 3)) / 3
            lengths = np.linalg.norm(np.diff(mesh.vertices[edges], axis=1)[:, 0], axis=1)
            variation = weights / lengths @ np.abs(np.diff(x[edges], axis=1)[:, 0])
        return variation + fidelity / 2 * ops.mass @ np.square(x - image)

    assert u.converged
    assert value(u.image) == pytest.approx(u.primal, rel=1e-9)
    for rival in (image, np.full(72, image.mean()), u.image + 1e-2 * rng.normal(size=72), 0.5 * (u.image + image)):
        assert value(rival) >= u.dual * (1 - 1e-12)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_contours_of_closed_surfaces_are_closed(seed):
    rng = np.random.default_rng(seed)
    mesh = bt.shapes.torus(rows=12, columns=9)
    values = rng.choice([0.0, 0.5, 1.0], len(mesh.vertices)) if seed % 2 else rng.normal(size=len(mesh.vertices))
    lines = bt.contours(mesh, values)
    above = values > 0.5
    crossed = (above[mesh.faces].any(1) & ~above[mesh.faces].all(1)).sum()
    assert sum(len(line) - 1 for line in lines) == crossed  # each crossed triangle once
    assert all(np.array_equal(line[0], line[-1]) for line in lines)


def test_contours_keep_the_greater_side_to_the_left():
    mesh = bt.shapes.grid(21, 21)
    (line,) = bt.contours(mesh, -np.hypot(mesh.vertices[:, 0] - 0.5, mesh.vertices[:, 1] - 0.5), level=-0.3)
    x, y = line[:, 0], line[:, 1]
    area = 0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])
    normal = np.cross(*(mesh.vertices[mesh.faces[0, k]] - mesh.vertices[mesh.faces[0, 0]] for k in (1, 2)))[2]
    assert area * np.sign(normal) == pytest.approx(np.pi * 0.09, rel=0.02)  # a polygon of some 40 sides


# --- peers ---


@pytest.mark.parametrize("surface", ["grid", "sphere"])
def test_edges_agree_with_maximum_flow(surface):
    maxflow = pytest.importorskip("maxflow")
    mesh = bt.shapes.grid(25, 25) if surface == "grid" else bt.shapes.sphere(4)
    rng = np.random.default_rng(4)
    image = (np.sin(7 * mesh.vertices).sum(1) > 0.3) + 0.4 * rng.normal(size=len(mesh.vertices))
    fidelity = 50.0
    r = bt.segment(mesh, image, fidelity=fidelity, tv="edge")
    area = mesh.area
    pairs = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), 1)
    edges, where = np.unique(pairs, axis=0, return_inverse=True)
    beside = np.bincount(where.ravel(), np.tile(mesh.face_areas, 3)) / 3
    w = np.pi / 2 * beside / np.linalg.norm(np.diff(mesh.vertices[edges], axis=1)[:, 0], axis=1) / np.sqrt(area)
    linear = fidelity * bt.operators(mesh).mass / area * (np.square(image - r.means[1]) - np.square(image - r.means[0]))
    graph = maxflow.Graph[float]()
    nodes = graph.add_nodes(len(linear))
    graph.add_edges(edges[:, 0], edges[:, 1], w, w)
    graph.add_grid_tedges(nodes, np.maximum(linear, 0), np.maximum(-linear, 0))
    exact = graph.maxflow() + np.minimum(linear, 0).sum()
    assert r.primal == pytest.approx(exact, rel=1e-6)
    assert r.dual <= exact + 1e-9 * abs(exact)


# --- masks, paths, boundaries, clouds ---


def test_unknown_pixels_are_filled():
    mesh = bt.shapes.grid(31, 31)
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    clean = (x > 0.5).astype(float)
    known = np.hypot(x - 0.5, y - 0.5) > 0.12
    image = np.where(known, clean, np.nan)
    r = bt.segment(mesh, image, fidelity=30.0, mask=known)
    assert r.converged
    assert np.mean(r.labels != clean) < 0.02
    u = bt.denoise(mesh, image, fidelity=200.0, mask=known)
    assert u.converged
    assert np.isfinite(u.image).all()
    assert np.abs(u.image - clean)[np.abs(x - 0.5) > 0.06].max() < 0.1


def test_a_path_gives_what_single_runs_give():
    mesh = bt.shapes.sphere(4)
    image = cap(mesh, 1.0, 0.4)
    path = bt.segment_path(mesh, image, fidelities=[10.0, 30.0, 90.0])
    for r in path:
        alone = bt.segment(mesh, image, fidelity=r.fidelity)
        assert r.primal == pytest.approx(alone.primal, rel=1e-3)  # the means may differ by a vertex or two
    assert path[0].contour_length < path[2].contour_length


def test_contours_end_at_the_boundary():
    mesh = bt.shapes.grid(21, 21)
    r = bt.segment(mesh, (mesh.vertices[:, 0] > 0.42).astype(float), fidelity=100.0)
    (line,) = r.contours
    assert not np.array_equal(line[0], line[-1])
    assert r.contour_length == pytest.approx(1, rel=0.01)
    assert set(line[[0, -1], 1]) == {0.0, 1.0}


@pytest.mark.parametrize("apart", [0.0, 1e-6])
def test_vertices_that_nearly_coincide(apart):
    """Their difference was left wrong in every sweep, whose residual it hardly moves: gaps of 100 % after 2,000 sweeps."""
    sphere = bt.shapes.sphere(4)
    vertices = sphere.vertices.copy()
    first, second, _ = sphere.faces[0]
    vertices[second] = vertices[first] + apart * (vertices[second] - vertices[first])
    mesh = bt.TriangleMesh(vertices, sphere.faces)
    image = np.random.default_rng(0).random(len(vertices))
    assert bt.denoise(mesh, image, fidelity=10.0).iterations < 200
    assert bt.segment(mesh, image, fidelity=100.0).iterations < 200
    assert bt.denoise(mesh, image, fidelity=30.0, tv="edge").iterations < 200


def test_contours_of_clouds_close():
    """Stars disagree here and there: lines were left open in a segmentation, and loops that single stars had drawn were counted."""
    torus = bt.shapes.torus()
    cloud = bt.PointCloud(torus.vertices)
    r = bt.segment(cloud, torus.vertices @ [1.0, 0.5, 0.2] > 0.2, fidelity=60.0)
    assert len(r.contours) == 2
    rng = np.random.default_rng(1)
    points = rng.normal(size=(4000, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    band = bt.contours(bt.PointCloud(points), np.abs(points[:, 2]), level=0.5)
    assert len(band) == 2
    for line in [*r.contours, *band]:
        np.testing.assert_array_equal(line[0], line[-1])
    length = sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in band)
    assert length == pytest.approx(2 * np.pi * np.sqrt(3), rel=0.03)


def test_clouds():
    sphere = bt.shapes.sphere(4)
    cloud = bt.PointCloud(sphere.vertices)
    image = cap(sphere, 1.0, 0.3)
    r, on_mesh = bt.segment(cloud, image, fidelity=40.0), bt.segment(sphere, image, fidelity=40.0)
    assert r.converged
    assert np.mean(r.labels != on_mesh.labels) < 0.01
    assert r.contour_length == pytest.approx(on_mesh.contour_length, rel=0.05)
    assert bt.denoise(cloud, image, fidelity=20.0).converged


def test_bits_do_not_depend_on_threads():
    mesh = bt.shapes.sphere(5)
    image = cap(mesh, 1.0, 0.4)
    before = bt.num_threads()
    try:
        found = []
        for threads in (1, 3):
            bt.set_num_threads(threads)
            found.append(bt.segment(mesh, image, fidelity=40.0))
    finally:
        bt.set_num_threads(before)
    assert np.array_equal(found[0].phi, found[1].phi)
    assert found[0].dual == found[1].dual


def test_vertices_of_no_triangle_and_repeated_calls():
    sphere = bt.shapes.sphere(3)
    mesh = bt.TriangleMesh(np.concatenate([sphere.vertices, [[9, 9, 9]]]), sphere.faces)
    image = np.append(cap(sphere, 1.0, 0.2), 7.0)
    given = image.copy()
    r = bt.segment(mesh, image, fidelity=30.0)
    assert r.converged
    assert np.isfinite(r.phi).all()
    assert np.array_equal(image, given)
    assert r.means.max() < 2  # the lone value has no area
    u = bt.denoise(mesh, image, fidelity=30.0)
    assert u.image[-1] == pytest.approx(7.0)


# --- faults ---


@pytest.mark.parametrize("verb", [bt.segment, bt.denoise])
@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"image": np.zeros(3)}, "162 vertices"),
        ({"image": np.full(162, np.nan)}, "nan"),
        ({"image": np.zeros((162, 0))}, "channels"),
        ({"image": np.zeros((162, 2, 2))}, "shape"),
        ({"fidelity": 0.0}, "fidelity"),
        ({"fidelity": -1.0}, "fidelity"),
        ({"fidelity": np.inf}, "fidelity"),
        ({"fidelity": "x"}, "fidelity"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"tv": "total"}, "tv"),
        ({"mask": np.zeros(162, bool)}, "mask"),
        ({"mask": np.ones(3, bool)}, "mask"),
    ],
)
def test_refusals(verb, change, word):
    mesh = bt.shapes.sphere(2)
    options = {"image": np.arange(162.0), "fidelity": 1.0, **change}
    with pytest.raises(bt.InputError, match=word):
        verb(mesh, options.pop("image"), **options)


def test_refusals_of_segment():
    mesh = bt.shapes.sphere(2)
    with pytest.raises(bt.InputError, match="constant"):
        bt.segment(mesh, np.ones(162))
    with pytest.raises(bt.InputError, match="2 distinct"):
        bt.segment(mesh, np.arange(162) % 2, regions=3)
    with pytest.raises(bt.InputError, match="equal"):
        bt.segment(mesh, np.arange(162.0), means=[1.0, 1.0])
    with pytest.raises(bt.InputError, match="means"):
        bt.segment(mesh, np.arange(162.0), means="ab")
    with pytest.raises(bt.InputError, match="fidelities is"):
        bt.segment_path(mesh, np.arange(162.0), fidelities="a")
    with pytest.raises(bt.InputError, match="empty"):
        bt.segment_path(mesh, np.arange(162.0), fidelities=[])
    with pytest.raises(bt.InputError):
        bt.contours(mesh, np.full(162, np.nan))


def test_not_converged_is_said():
    mesh = bt.shapes.sphere(3)
    r = bt.segment(mesh, cap(mesh, 1.0, 0.4), fidelity=40.0, tolerance=1e-14, max_iterations=15)
    assert not r.converged
    assert r.iterations == 15
    assert r.gap > 1e-14
    assert "NOT CONVERGED" in repr(r)
    assert np.isfinite(r.phi).all()
    assert np.isfinite(r.dual)


@pytest.mark.parametrize("seed", [0, 1])
def test_weak_images_whose_means_move_are_solved(seed):
    """The penalty fits the contrast of the means, which move while it is found; and two sets of means may not take turns for ever."""
    mesh = bt.shapes.star()
    x, y, _ = ((mesh.vertices - mesh.vertices.mean(0)) / np.abs(mesh.vertices - mesh.vertices.mean(0)).max()).T
    image = (np.sin(8 * x) + np.sin(7 * y + 1) > 0.4) + 0.4 * np.random.default_rng(seed).normal(size=len(x))
    assert bt.segment(mesh, image, fidelity=6.0, max_iterations=400).converged


def bumpy(frequency):
    """An ellipsoid without symmetries, and an image on it: 1 on a part of it, else 0, with noise at every vertex."""
    sphere = bt.shapes.sphere(frequency=frequency)
    x, y, z = sphere.vertices.T
    bumps = 1 + 0.15 * np.sin(3 * x + 1) * np.cos(4 * y) + 0.2 * np.exp(-6 * (x - 1) ** 2) + 0.1 * np.sin(5 * z) * x
    mesh = bt.TriangleMesh(sphere.vertices * bumps[:, None] * [1.3, 1.0, 0.7], sphere.faces)
    height = mesh.vertices[:, 2] / np.linalg.norm(mesh.vertices, axis=1)
    return mesh, (height > 0.3) + 0.4 * np.random.default_rng(1).normal(size=len(x))


def test_the_means_wait_for_the_regions():
    """They once followed a phi that still swung, came near to each other, and all was one region: the energy was 3.64, not 3.46."""
    mesh, image = bumpy(63)
    r = bt.segment(mesh, image, fidelity=10.0)
    assert r.converged
    assert r.means[:, 0] == pytest.approx([0, 1], abs=0.02)


def test_a_region_too_many_is_given_up():
    """Two means become one: the boundary between them has no reason to be anywhere, and took more than 1,000 sweeps to go."""
    mesh, image = bumpy(32)
    two, three = (bt.segment(mesh, image, fidelity=60.0, regions=regions, max_iterations=600) for regions in (2, 3))
    assert three.converged
    energy = two.primal + 60 * float(bt.operators(mesh).mass @ np.square(image - two.means[0, 0])) / mesh.area
    assert three.primal < energy * (1 + 2e-4)


@pytest.mark.parametrize("tv", ["isotropic", "edge"])
def test_a_factor_that_takes_over_gives_the_same_answer(tv, monkeypatch):
    mesh = bt.shapes.sphere(4)
    image = np.stack([cap(mesh, 1.0, 0.3), cap(mesh, 0.5, 0.3, seed=1)], 1)
    answers = []
    for dear in (300, -1):
        monkeypatch.setattr(sys.modules["beltrami.segment.surface"], "FACTOR", dear)
        answers.append((bt.segment(mesh, image, fidelity=40.0, tv=tv), bt.denoise(mesh, image, fidelity=40.0, tv=tv, tolerance=1e-6)))
    (one, smooth), (two, smoother) = answers
    assert one.primal == pytest.approx(two.primal, rel=2e-4)
    assert (one.labels != two.labels).mean() < 0.002
    # strong convexity: fidelity / 2 |u - u*|² <= primal - minimum, for both
    assert np.abs(smooth.image - smoother.image).max() ** 2 <= 4 * (2 * 1e-6 * smooth.primal / 40) * len(mesh.vertices)


def test_flat_triangles_raise_no_warnings():
    flat = bt.TriangleMesh([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 3]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bt.segment(flat, [0.0, 1, 2, 3], max_iterations=100)


def test_progress_stops_the_work():
    mesh = bt.shapes.sphere(3)
    with pytest.raises(bt.Cancelled):
        bt.segment(mesh, cap(mesh, 1.0, 0.4), progress=lambda share: False)


def test_one_phase_is_an_answer():
    mesh = bt.shapes.sphere(3)
    r = bt.segment(mesh, cap(mesh, 0.3, 0.2), fidelity=0.01)
    assert r.converged
    assert np.isfinite(r.means).all()
    assert r.contours == []
    assert r.contour_length == 0


def test_save_and_plot(tmp_path):
    mesh = bt.shapes.sphere(3)
    r = bt.segment(mesh, cap(mesh, 1.0, 0.2), fidelity=30.0)
    for name in ("a.npz", "a.ply", "a.obj", "a.csv", "a.png"):
        assert r.save(tmp_path / name).stat().st_size > 100
    with np.load(tmp_path / "a.npz") as kept:
        assert np.array_equal(kept["labels"], r.labels)
        assert kept["gap"] == r.gap
    assert np.array_equal(bt.load(tmp_path / "a.ply").data["labels"], r.labels)
    rows = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)
    assert np.array_equal(rows[:, 2:], np.concatenate(r.contours))
    text = (tmp_path / "a.obj").read_text()
    assert text.count("\nl ") == len(r.contours)
    assert "element edge" in r.save_contours(tmp_path / "b.ply").read_text()
    with pytest.raises(bt.InputError, match="npz"):
        r.save(tmp_path / "a.docx")
    assert bt.denoise(mesh, cap(mesh, 1.0, 0.2)).save(tmp_path / "u.ply").exists()


def test_intrinsic_triangulations_certify_too():
    mesh = bt.shapes.grid(15, 12)
    image = (mesh.vertices[:, 0] > 0.5) + 0.2 * np.random.default_rng(1).normal(size=180)
    for kind in ("intrinsic_delaunay", "tufted"):
        r = bt.segment(bt.operators(mesh, laplacian=kind), image, fidelity=30.0)
        assert r.converged
        assert r.contour_length == pytest.approx(1, rel=0.1)


def test_command_line(tmp_path, capsys):
    from beltrami.__main__ import main

    mesh = bt.shapes.sphere(3)
    bt.save(bt.TriangleMesh(mesh.vertices, mesh.faces, data={"height": mesh.vertices[:, 2]}), tmp_path / "sphere.ply")
    arguments = [str(tmp_path / "sphere.ply"), "--values", "height", "-o", str(tmp_path / "out.npz")]
    assert main(["segment", *arguments]) == 0
    assert "relative gap" in capsys.readouterr().out
    with np.load(tmp_path / "out.npz") as kept:
        assert kept["labels"].shape == (len(mesh.vertices),)
    assert main(["denoise", *arguments, "--max-iterations", "1", "--tolerance", "1e-15"]) == 1
    assert main(["segment", str(tmp_path / "sphere.ply")]) == 2  # no colours, no --values


@pytest.mark.parametrize("verb", [bt.segment, bt.denoise])
@pytest.mark.parametrize("tv", ["isotropic", "edge"])
def test_numbers_out_of_range_are_refused_and_the_rest_is_solved(verb, tv):
    mesh = bt.shapes.sphere(2)
    image = cap(mesh, 1.0, 0.2)
    for factor, fidelity in ((1e200, 30.0), (1e-200, 30.0), (1.0, 1e300), (1.0, 1e-300), (1e308, 1.0)):
        with pytest.raises(bt.InputError, match=r"rescale|unit"):
            verb(mesh, factor * image, fidelity=fidelity, tv=tv)
    for factor, fidelity in ((1.0, 1e-6), (1.0, 1e6), (1e40, 1e-39), (1e-40, 1e41)):
        power = 2 if verb is bt.segment else 1
        r = verb(mesh, factor * image, fidelity=fidelity if factor == 1 else 30 / factor**power, tv=tv)
        assert np.isfinite([r.primal, r.dual, r.gap]).all()
        assert r.dual <= r.primal * (1 + np.sign(r.primal) * 1e-9) + 1e-12


def test_an_empty_region_is_said_with_the_remedy():
    mesh = bt.shapes.sphere(3)
    r = bt.segment(mesh, cap(mesh, 0.5), fidelity=0.5)
    assert r.areas.min() == 0
    [note] = r.notes
    assert "region 1 is empty: at fidelity 0.5" in note
    assert "try 2" in note
    assert bt.segment(mesh, cap(mesh, 0.5), fidelity=40.0).notes == ()


def test_an_image_with_holes_is_pointed_to_its_mask():
    mesh = bt.shapes.sphere(3)
    image = cap(mesh, 1.0)
    image[[7, 9]] = np.nan
    for method in (bt.segment, bt.denoise):
        with pytest.raises(bt.InputError, match=r"image\[7\] is nan, one of 2 vertices .*mask=np.isfinite\(image\)$"):
            method(mesh, image)
        assert method(mesh, image, mask=np.isfinite(image)).converged
    with pytest.raises(bt.InputError, match=r"all\(axis=1\)$"):
        bt.segment(mesh, np.c_[image, image])
