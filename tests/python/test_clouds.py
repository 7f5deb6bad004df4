"""Operators of point clouds: closed forms, convergence, invariance, a peer, and every refusal."""

import pickle
import re

import beltrami as bt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigvals, eigvalsh
from scipy.special import jnp_zeros


def sphere(n, seed=0, d=2, even=True):
    """About n points of S^d: independent, or thinned to a Poisson disc sample of many more."""
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((9 * n if even else n, d + 1))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    if not even:
        return points
    measure = 4 * np.pi if d == 2 else 2 * np.pi**2
    return points[bt.poisson_disc(points, {2: 0.745, 3: 0.8}[d] * (measure / n) ** (1 / d))]


def torus(n, seed=0):
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(0, 2 * np.pi, (2, 20 * n))
    keep = rng.uniform(0, 1.4, 20 * n) < 1 + 0.4 * np.cos(v)
    u, v = u[keep], v[keep]
    points = np.c_[(1 + 0.4 * np.cos(v)) * np.cos(u), (1 + 0.4 * np.cos(v)) * np.sin(u), 0.4 * np.sin(v)]
    return points[bt.poisson_disc(points, 0.745 * np.sqrt(1.6 * np.pi**2 / n))]


def harmonic_eigenvalues(count, d=2):
    copies = [2 * k + 1 if d == 2 else (k + 1) ** 2 for k in range(20)]
    return np.repeat([k * (k + d - 1.0) for k in range(20)], copies)[:count]


def moved(points, space, seed):
    """The points by an isometry in R^space."""
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.standard_normal((space, space)))[0]
    return points @ rotation[:, : points.shape[1]].T + rng.standard_normal(space)


# Bars: linear elements, relative error about λ h² / 12 with h² = area / n; twice that for irregular points.
@pytest.mark.parametrize(("n", "even", "bar"), [(1500, True, 0.035), (3000, False, 0.05)])
def test_spectrum_of_the_sphere_with_all_copies(n, even, bar):
    exact = harmonic_eigenvalues(25)
    e = bt.eigenpairs(bt.PointCloud(sphere(n, even=even)), 25)
    assert abs(e.values[0]) < 1e-12
    np.testing.assert_allclose(e.values[1:], exact[1:], rtol=bar)


def test_spectrum_of_the_three_sphere():
    cloud = bt.PointCloud(sphere(1500, d=3), dimension=3)
    ops = bt.operators(cloud)
    assert ops.mass.sum() == pytest.approx(2 * np.pi**2, rel=0.03)  # inscribed tetrahedra: short by about h²/10
    np.testing.assert_allclose(bt.eigenpairs(ops, 14).values[1:], harmonic_eigenvalues(14, 3)[1:], rtol=0.05)


def test_natural_conditions_on_a_disc():
    rng = np.random.default_rng(3)
    inside = rng.uniform(-1, 1, (12000, 2))
    inside = inside[(inside**2).sum(1) < 1]
    h = np.sqrt(np.pi / 1500)
    inside = inside[bt.poisson_disc(inside, 0.745 * h)]
    angle = np.arange(0, 2 * np.pi, h)
    points = np.r_[inside[(inside**2).sum(1) < (1 - 0.6 * h) ** 2], np.c_[np.cos(angle), np.sin(angle)]]
    ops = bt.operators(bt.PointCloud(points))
    np.testing.assert_array_equal(np.flatnonzero(ops.boundary), np.arange(len(points) - len(angle), len(points)))
    exact = np.sort([0.0, *(z**2 for z in jnp_zeros(0, 3)), *(z**2 for m in range(1, 6) for z in jnp_zeros(m, 3) for _ in "ab")])[:12]
    np.testing.assert_allclose(bt.eigenpairs(ops, 12).values[1:], exact[1:], rtol=0.02)


def test_eigenvalues_converge_with_the_square_of_the_spacing():
    rows = []
    for n in (500, 1000, 2000, 4000):
        points = sphere(n, seed=n)
        error = bt.eigenpairs(bt.PointCloud(points), 16).values[1:] / harmonic_eigenvalues(16)[1:] - 1
        rows.append((-0.5 * np.log(len(points)), np.log(np.abs(error).mean())))
    slope = np.polyfit(*np.transpose(rows), 1)[0]
    assert slope > 1.6  # 2 in theory; four random clouds scatter by 0.3


def test_stiffness_is_semidefinite_and_made_of_simplices():
    ops = bt.operators(bt.PointCloud(sphere(300, even=False)))
    assert (ops.stiffness != ops.stiffness.T).nnz == 0
    values = eigvalsh(ops.stiffness.toarray())
    assert values[0] > -1e-12 * values[-1]
    areas = np.repeat(ops.simplex_areas, 3)
    again = ops.simplex_gradient.T @ (areas[:, None] * ops.simplex_gradient.toarray())
    np.testing.assert_allclose(again, ops.stiffness.toarray(), atol=1e-11 * values[-1])
    assert ops.simplex_areas.sum() == pytest.approx(ops.mass.sum(), rel=1e-13)
    assert ops.certified == 1.0
    assert ops.notes == ()
    assert abs(ops.estimated_dimension - 2) < 0.3


@pytest.mark.parametrize("kind", ["local_mesh", "mls"])
def test_divergence_is_the_negative_adjoint_of_the_gradient(kind):
    ops = bt.operators(bt.PointCloud(torus(500)), laplacian=kind)
    rng = np.random.default_rng(0)
    f, field = rng.standard_normal(len(ops.mass)), rng.standard_normal(ops.gradient.shape[0])
    left = (ops.gradient @ f * np.repeat(ops.element_areas, 3)) @ field
    right = -(ops.mass * f) @ (ops.divergence @ field)
    assert left == pytest.approx(right, rel=1e-11)


@pytest.mark.parametrize("degree", [2, 3, 4])
@pytest.mark.parametrize("space", [2, 3, 7])
def test_least_squares_are_exact_on_polynomials(degree, space):
    rng = np.random.default_rng(degree)
    x = rng.uniform(-1, 1, (4000, 2))
    x = x[bt.poisson_disc(x, 0.08)]
    points = moved(x, space, 1)
    rotation = np.linalg.qr(np.random.default_rng(1).standard_normal((space, space)))[0][:, :2]
    a, b, p, q = 0.7, -1.3, degree - 1, 1
    f = a * x[:, 0] ** degree + b * x[:, 0] ** p * x[:, 1] ** q
    gradient = np.c_[
        a * degree * x[:, 0] ** (degree - 1) + b * p * x[:, 0] ** (p - 1) * x[:, 1],
        b * x[:, 0] ** p,
    ]
    second = a * degree * (degree - 1) * x[:, 0] ** (degree - 2)
    if p > 1:
        second = second + b * p * (p - 1) * x[:, 0] ** (p - 2) * x[:, 1]
    ops = bt.operators(bt.PointCloud(points), laplacian="mls", degree=degree)
    # rounding: eps / h for first, eps / h² for second derivatives, times the condition of the fits (1e4)
    np.testing.assert_allclose((ops.gradient @ f).reshape(-1, space), gradient @ rotation.T, atol=1e-10)
    np.testing.assert_allclose(ops.laplacian @ f, second, atol=1e-8)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_least_squares_have_no_spurious_modes(degree):
    for points in (sphere(300), sphere(300, even=False), torus(400)):
        ops = bt.operators(bt.PointCloud(points), laplacian="mls", degree=degree)
        values = eigvals(-ops.laplacian.toarray())
        assert values.real.min() > -1e-8 * np.abs(values).max()
        if degree < 4:
            assert len(ops.signed_points) == 0


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6), space=st.sampled_from([3, 4, 10, 30]), unit=st.sampled_from([1e-6, 0.3, 1e5]))
def test_isometries_relabelling_and_units(seed, space, unit):
    rng = np.random.default_rng(seed)
    points = sphere(250, seed, even=False) * (1, 0.8, 1.3)
    order = rng.permutation(len(points))
    a = bt.operators(bt.PointCloud(points))
    b = bt.operators(bt.PointCloud(unit * moved(points[order], space, seed)))
    largest = abs(a.stiffness).max()
    assert abs(a.stiffness[order][:, order] - b.stiffness).max() < 1e-9 * largest
    np.testing.assert_allclose(b.mass, unit**2 * a.mass[order], rtol=1e-9)
    np.testing.assert_allclose(b.spacing, unit * a.spacing, rtol=1e-9)


def test_noise_of_a_hundredth_of_the_spacing_changes_little():
    points = sphere(1500)
    rng = np.random.default_rng(0)
    noisy = points + 0.01 * bt.operators(bt.PointCloud(points)).spacing * rng.standard_normal(points.shape)
    a, b = (bt.eigenpairs(bt.PointCloud(p), 21).values[1:] for p in (points, noisy))
    np.testing.assert_allclose(a, b, rtol=0.02)


def test_the_number_of_threads_changes_no_bit():
    cloud, before = bt.PointCloud(torus(2000)), bt.num_threads()
    answers = []
    try:
        for threads in (1, 3):
            bt.set_num_threads(threads)
            ops, mls = bt.operators(cloud), bt.operators(cloud, laplacian="mls", degree=3)
            answers.append([ops.stiffness.data, ops.mass, ops.simplices, mls.laplacian.data, mls.gradient.data])
    finally:
        bt.set_num_threads(before)
    for one, three in zip(*answers, strict=True):
        np.testing.assert_array_equal(one, three)


def test_distances_on_the_sphere():
    points = sphere(2000)
    d = bt.geodesic_distance(bt.PointCloud(points), 5)
    exact = np.arccos(np.clip(points @ points[5], -1, 1))
    assert np.abs(d - exact).mean() < 0.01 * np.pi
    assert np.abs(d - exact).max() < 0.025 * np.pi


def test_components_stay_apart():
    points = np.r_[sphere(400), sphere(300, 1) * 0.2 + 5]
    cloud = bt.PointCloud(points)
    first = bt.operators(cloud).component_labels == 0
    assert set(np.flatnonzero(~first)) == set(range(len(sphere(400)), len(points)))
    values = bt.eigenpairs(cloud, 4).values
    assert (values[:2] < 1e-10 * values[2]).all()
    np.testing.assert_array_equal(np.isinf(bt.geodesic_distance(cloud, 0)), ~first)


def test_curvature():
    points = sphere(3000)
    ops = bt.operators(bt.PointCloud(2 * points))
    np.testing.assert_allclose(ops.mean_curvature, -points / 2, atol=0.01)  # a cubic fit of 24 points: h² = 4e-3
    np.testing.assert_allclose(ops.scalar_curvature, 2 / 4, rtol=0.05)
    assert ops.second_fundamental_form.shape == (len(points), 2, 2, 3)
    np.testing.assert_allclose(np.einsum("nad,nd->na", ops.frames, points), 0, atol=1e-3)
    three = bt.operators(bt.PointCloud(sphere(2500, d=3), dimension=3))
    np.testing.assert_allclose(three.scalar_curvature, 6, rtol=0.15)


def test_weights_scale_the_energy():
    points = torus(600)
    ops = bt.operators(bt.PointCloud(points))
    np.testing.assert_array_equal(ops.weighted_stiffness(np.full(len(points), 3.0)).data, ops.stiffness.data)
    potential = 30 * points[:, 0]
    f = points[:, 1]
    weight = np.exp(potential.min() - potential)
    energy = (weight[ops.simplices].mean(1) * ops.simplex_areas * ((ops.simplex_gradient @ f).reshape(-1, 3) ** 2).sum(1)).sum()
    # other means of a weight that changes by e² on an edge: the same within a third
    assert f @ ops.weighted_stiffness(potential) @ f == pytest.approx(energy, rel=0.35)
    with pytest.raises(bt.Error, match="potential"):
        ops.weighted_stiffness(potential[1:])


def test_better_than_robust_laplacian():
    robust = pytest.importorskip("robust_laplacian")
    from scipy.sparse.linalg import eigsh

    exact = harmonic_eigenvalues(25)[1:]
    for even in (True, False):
        points = sphere(1500, 2, even=even)
        stiffness, mass = robust.point_cloud_laplacian(points)
        theirs = np.sort(eigsh(stiffness, 25, mass, sigma=-1e-3)[0])[1:]
        ours = bt.eigenpairs(bt.PointCloud(points), 25).values[1:]
        assert np.abs(ours / exact - 1).mean() < np.abs(theirs / exact - 1).mean()


@pytest.mark.parametrize(
    ("points", "dimension", "named"),
    [
        (np.r_[sphere(300), sphere(300)[7:8]], 2, [7, len(sphere(300))]),
        (np.r_[sphere(300)[:40], [[60.0, 0, 0]], sphere(300)[40:]], 2, [40]),
        (np.r_[sphere(300)[:3], [[np.nan, 0, 0]], sphere(300)[3:]], 2, [3]),
        (np.linspace(0, 1, 200)[:, None] * [1.0, 2, 3], 2, [0]),
        (np.c_[np.random.default_rng(0).uniform(size=(300, 2)), np.zeros(300)], 3, [0]),
        (np.ones((50, 3)), 2, [49]),
        (np.eye(3), 2, []),
        (np.zeros((0, 3)), 2, []),
    ],
)
def test_what_is_wrong_with_a_cloud_is_named(points, dimension, named):
    with pytest.raises(bt.Error) as error:
        bt.operators(bt.PointCloud(points, dimension=dimension))
    assert set(named) <= {int(x) for x in re.findall(r"\d+", str(error.value))}


def test_wrong_options_are_refused():
    cloud = bt.PointCloud(sphere(200))
    for options in (
        {"neighbors": 2},
        {"neighbors": 2.5},
        {"degree": 3},
        {"laplacian": "cotangent"},
        {"mass": "voronoi"},
        {"laplacian": "mls", "degree": 0},
        {"laplacian": "mls", "degree": 2, "weight": "heavy"},
        {"laplacian": "mls", "degree": 4, "neighbors": 8},
        {"progress": 3},
    ):
        with pytest.raises(bt.InputError):
            bt.operators(cloud, **options)
    with pytest.raises(bt.Cancelled):
        bt.operators(bt.PointCloud(sphere(20000, even=False)), progress=lambda share: False)


def test_a_wrong_dimension_is_said():
    rng = np.random.default_rng(0)
    ops = bt.operators(bt.PointCloud(rng.uniform(size=(3000, 3))))
    assert any("dimensional" in note for note in ops.notes)


def test_copies_are_left_out_on_request():
    points = sphere(300)
    n = len(points)
    twice = np.r_[points, points[:20], points[30:35] + 1e-14]
    cloud = bt.PointCloud(twice, data={"number": np.arange(len(twice))}, weights=np.ones(len(twice)), deduplicate=True)
    np.testing.assert_array_equal(cloud.points, points)
    np.testing.assert_array_equal(cloud.data["number"], np.arange(n))
    assert cloud.weights.shape == (n,)
    assert bt.operators(cloud).mass.shape == (n,)


def test_subsets():
    points = sphere(3000, even=False)
    chosen = bt.poisson_disc(points, 0.2, rng=1)
    np.testing.assert_array_equal(chosen, bt.poisson_disc(bt.PointCloud(points), 0.2, rng=1))
    between = np.linalg.norm(points[chosen][:, None] - points[chosen], axis=2)
    assert between[np.triu_indices(len(chosen), 1)].min() >= 0.2 - 1e-9
    assert np.linalg.norm(points[:, None] - points[chosen], axis=2).min(1).max() < 0.2
    far = bt.farthest_points(points, 30, start=4)
    assert far[0] == 4
    np.testing.assert_array_equal(far[:10], bt.farthest_points(points, 10, start=4))
    for call in (
        lambda: bt.poisson_disc(points, 0.0),
        lambda: bt.farthest_points(points, 0),
        lambda: bt.farthest_points(points, 3, start=3000),
        lambda: bt.farthest_points(points, 3001),
        lambda: bt.poisson_disc(points * np.nan, 1.0),
    ):
        with pytest.raises(bt.InputError):
            call()


def test_operators_pickle():
    for kind in ("local_mesh", "mls"):
        ops = bt.operators(bt.PointCloud(sphere(200)), laplacian=kind)
        again = pickle.loads(pickle.dumps(ops))
        assert (again.laplacian != ops.laplacian).nnz == 0
        np.testing.assert_array_equal(again.mass, ops.mass)


def test_contours_of_clouds_and_meshes():
    points = sphere(2000)
    for level in (0.0, 0.6):
        [curve] = bt.contours(bt.PointCloud(points), points[:, 2], level=level)
        np.testing.assert_array_equal(curve[0], curve[-1])
        # chords of an inscribed polyhedron: short by h²/24 at each of two scales
        length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
        assert length == pytest.approx(2 * np.pi * np.sqrt(1 - level**2), rel=5e-3)
        np.testing.assert_allclose(curve[:, 2], level, atol=1e-14)
    rings = bt.contours(bt.PointCloud(torus(2500)), torus(2500)[:, 0], level=0.0)
    assert sorted(np.sign(ring[:, 1].mean()) for ring in rings) == [-1, 1]
    mesh = bt.shapes.torus()
    assert len(bt.contours(mesh, mesh.vertices[:, 0], level=0.013)) == 2
    assert bt.contours(mesh, mesh.vertices[:, 0], level=9.0) == []
    flat = bt.PointCloud(np.random.default_rng(0).uniform(size=(800, 2)))
    [line] = bt.contours(flat, flat.points[:, 0])
    assert abs(np.diff(line[[0, -1], 1])) > 0.9
    with pytest.raises(bt.InputError):
        bt.contours(flat, flat.points[:, 0], level=np.nan)
    with pytest.raises(bt.InputError, match="dimension"):
        bt.contours(bt.operators(bt.PointCloud(sphere(300, d=3), dimension=3)), np.zeros(len(sphere(300, d=3))))


def test_command_line(tmp_path, capsys):
    from beltrami.__main__ import main

    points = sphere(500)
    file = tmp_path / "cloud.xyz"
    bt.save(bt.PointCloud(np.r_[points, points[:3]]), file)
    assert main(["eigen", str(file)]) == 2
    assert "deduplicate" in capsys.readouterr().err
    assert main(["eigen", str(file), "--deduplicate", "-k", "4", "-o", str(tmp_path / "e.npz")]) == 0
    with np.load(tmp_path / "e.npz") as found:
        np.testing.assert_allclose(found["values"][1:], 2, rtol=0.03)
    assert "certified stars" in capsys.readouterr().out
    assert main(["geodesic", str(file), "--deduplicate", "--source", "4", "-o", str(tmp_path / "d.csv")]) == 0
    assert main(["geodesic", str(file), "--deduplicate", "--source", "900"]) == 2


def test_oriented_normals_keep_the_sides_of_a_thin_shell_apart():
    # Two concentric spheres about the spacing apart: joined as a cloud alone, two components with normals.
    outer = sphere(1200)
    inner = sphere(1200, 1) * 0.9
    normals = np.r_[outer, -inner / 0.9]
    ops = bt.operators(bt.PointCloud(np.r_[outer, inner], normals=normals))
    assert ops.component_labels.max() == 1
    assert ops.mass.sum() == pytest.approx(4 * np.pi * (1 + 0.9**2), rel=0.01)
    np.testing.assert_allclose(bt.eigenpairs(ops, 8).values[2:], np.repeat([2, 2 / 0.9**2], 3), rtol=0.02)
    # normals without a common orientation are left alone, and it is said
    signs = np.where(np.random.default_rng(0).random(len(outer)) < 0.5, -1.0, 1.0)[:, None]
    plain, mixed = bt.operators(bt.PointCloud(outer)), bt.operators(bt.PointCloud(outer, normals=signs * outer))
    assert (plain.stiffness != mixed.stiffness).nnz == 0
    assert any("normals were not used" in note for note in mixed.notes)


def torus_grid(rows, columns):
    u, v = np.meshgrid(np.arange(rows) * 2 * np.pi / rows, np.arange(columns) * 2 * np.pi / columns, indexing="ij")
    w = 1 + 0.4 * np.cos(v)
    return np.c_[(w * np.cos(u)).ravel(), (w * np.sin(u)).ravel(), 0.4 * np.sin(v).ravel()]


def sphere_grid(rows):
    polar, angle = np.meshgrid(np.arange(1, rows) * np.pi / rows, np.arange(2 * rows) * np.pi / rows, indexing="ij")
    points = np.c_[(np.sin(polar) * np.cos(angle)).ravel(), (np.sin(polar) * np.sin(angle)).ravel(), np.cos(polar).ravel()]
    return np.r_[points, [[0, 0, 1], [0, 0, -1]]]


def cylinder_grid(rows, columns):
    angle, height = np.meshgrid(np.arange(rows) * 2 * np.pi / rows, np.linspace(0, 2, columns), indexing="ij")
    return np.c_[np.cos(angle).ravel(), np.sin(angle).ravel(), height.ravel()]


def flat_torus_grid(*counts):
    angles = np.stack(np.meshgrid(*(np.arange(n) * 2 * np.pi / n for n in counts), indexing="ij"), -1).reshape(-1, len(counts))
    return np.concatenate([np.cos(angles), np.sin(angles)], 1)


def sums_of_squares(*units):
    """Eigenvalues of products of circles (of half circles where the unit is no integer: Neumann segments)."""
    sums = np.zeros(1)
    for unit in units:
        wave = np.arange(-9, 10) if unit == 1 else np.arange(10)
        sums = (sums[:, None] + (unit * wave) ** 2).ravel()
    return np.sort(sums)[:20]


@pytest.mark.parametrize(
    ("points", "dimension", "area", "exact", "bars"),
    [
        # areas: of inscribed triangles, second order in the largest spacing; eigenvalues likewise
        (sphere_grid(48), 2, 4 * np.pi, harmonic_eigenvalues(25), (0.01, 0.012)),
        (cylinder_grid(100, 32), 2, 4 * np.pi, sums_of_squares(1, np.pi / 2), (0.002, 0.01)),
        (cylinder_grid(200, 20), 2, 4 * np.pi, sums_of_squares(1, np.pi / 2), (0.002, 0.01)),
        (cylinder_grid(24, 100), 2, 4 * np.pi, sums_of_squares(1, np.pi / 2), (0.02, 0.12)),
        (flat_torus_grid(100, 40), 2, 4 * np.pi**2, sums_of_squares(1, 1), (0.006, 0.02)),
        (flat_torus_grid(14, 14, 14), 3, 8 * np.pi**3, sums_of_squares(1, 1, 1), (0.04, 0.06)),
    ],
    ids=["sphere", "cylinder", "wide cells", "long cells", "flat torus", "three-torus"],
)
def test_grids_on_curved_shapes(points, dimension, area, exact, bars):
    """Every cell is a tie between diagonals, which all stars must break alike; a fixed third of the area was lost or counted twice."""
    ops = bt.operators(bt.PointCloud(points, dimension=dimension))
    assert ops.mass.sum() == pytest.approx(area, rel=bars[0])
    assert bt.eigenpairs(ops, len(exact)).values[1:] == pytest.approx(exact[1:], rel=bars[1])


@pytest.mark.parametrize("shape", [(120, 48), (80, 80), (40, 100), (200, 30)], ids=str)
def test_grids_of_the_torus_at_any_aspect(shape):
    points = torus_grid(*shape)
    ops = bt.operators(bt.PointCloud(points))
    mesh = bt.operators(bt.shapes.torus(1.0, 0.4, rows=200, columns=100))
    assert not ops.boundary.any()
    assert ops.mass.sum() == pytest.approx(1.6 * np.pi**2, rel=0.012)
    assert bt.eigenpairs(ops, 12).values[1:] == pytest.approx(bt.eigenpairs(mesh, 12).values[1:], rel=0.03)


def test_raw_rows_are_those_of_each_star_alone():
    rng = np.random.default_rng(4)
    points = rng.standard_normal((600, 3))
    points *= (1 + 0.03 * rng.standard_normal((600, 1))) / np.linalg.norm(points, axis=1, keepdims=True)
    cloud = bt.PointCloud(points)
    ops, raw = bt.operators(cloud), bt.operators(cloud, symmetric=False)
    assert (ops.votes < 3).any()
    assert (raw.stiffness != ops.stiffness).nnz == 0
    assert np.abs(raw.raw_stiffness @ np.ones(600)).max() < 1e-11
    assert np.array_equal(np.unpackbits(ops.voters[:, None], axis=1).sum(1), ops.votes)
    own = (ops.voters[:, None] >> np.arange(3)) % 2 == 1
    held, corner = np.nonzero(own)
    for point in (0, int(ops.simplices[ops.votes < 3][0, 0])):  # cotangents of the star's own triangles
        row, area = np.zeros(600), 0.0
        for triangle in held[ops.simplices[held, corner] == point]:
            a, b = (k for k in ops.simplices[triangle] if k != point)
            p, q, r = points[point], points[a], points[b]
            twice = np.linalg.norm(np.cross(q - p, r - p))
            row[a] -= (p - r) @ (q - r) / twice / 2
            row[b] -= (p - q) @ (r - q) / twice / 2
            area += twice / 6
        row[point] = -row.sum()
        assert raw.raw_stiffness[[point]].toarray()[0] == pytest.approx(row, abs=1e-11)
        assert raw.laplacian[[point]].toarray()[0] == pytest.approx(-row / area, abs=1e-8 / area)
    whole = np.ones(600, bool)
    whole[ops.simplices[ops.votes < 3]] = False
    assert abs((raw.laplacian - ops.laplacian)[whole]).max() < 1e-9 * abs(ops.laplacian).max()
