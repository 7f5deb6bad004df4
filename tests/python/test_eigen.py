"""Eigenpairs: closed forms with complete multiplicities, order of convergence, scipy as peer, refusals."""

from __future__ import annotations

import beltrami as bt
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sparse
import scipy.sparse.linalg
from hypothesis import given, settings
from hypothesis import strategies as st


def dense_values(stiffness, mass, k):
    scale = 1 / np.sqrt(mass)
    return scipy.linalg.eigh(stiffness.toarray() * np.outer(scale, scale), eigvals_only=True, subset_by_index=(0, k - 1))


def check(ops, e, k):
    mass = ops.mass
    assert e.values.shape == (k,)
    assert e.functions.shape == (len(mass), k)
    assert (np.diff(e.values) >= -1e-12 * e.values[-1]).all()
    assert abs(e.functions.T @ (mass[:, None] * e.functions) - np.eye(k)).max() < 1e-10
    rest = ops.stiffness @ e.functions - mass[:, None] * e.functions * e.values
    with np.errstate(divide="ignore", invalid="ignore"):
        own = np.sqrt(np.where(mass[:, None] > 0, rest**2 / mass[:, None], 0).sum(axis=0))
    # Reported and recomputed residuals agree up to the rounding of both.
    assert np.allclose(own, e.residuals, rtol=1e-3, atol=1e-9 * max(e.values[-1], 1))
    assert own.max() <= 1e-7 * max(e.values[-1], 4 * np.pi / mass.sum())
    first = (abs(e.functions) >= (1 - 1e-8) * abs(e.functions).max(axis=0)).argmax(axis=0)  # symmetry makes many entries equal
    assert (np.take_along_axis(e.functions, first[None], axis=0) > 0).all()


def test_sphere_has_every_copy():
    """l(l+1), 2l+1 times: 1, 3, 5, 7, 9, 11; frequency 24 has 5,762 vertices, so the values are off by < 1 %."""
    ops = bt.operators(bt.shapes.sphere(frequency=24))
    e = bt.eigenpairs(ops, 36)
    check(ops, e, 36)
    exact = np.repeat([l * (l + 1) for l in range(6)], [2 * l + 1 for l in range(6)])  # noqa: E741
    assert abs(e.values - exact).max() < 0.01 * exact[-1]
    assert e.iterations > 0  # the iterative path


def test_order_two_on_the_sphere():
    """The finite-element error of l (l + 1) falls with the square of the spacing."""
    exact = np.repeat([0.0, 2.0, 6.0], [1, 3, 5])
    sizes, errors = [6, 10, 16, 25], []
    for frequency in sizes:
        values = bt.eigenpairs(bt.shapes.sphere(frequency=frequency), 9).values
        errors.append(abs(values[1:] / exact[1:] - 1).max())
    slope = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert slope > 1.9, f"order {slope:.2f} from {errors}"


def test_chords_of_the_flat_torus_are_exact():
    """On the product of two regular polygons with n corners (2 - 2 cos h) / chord² = 1: the values p² + q² = 1 come out exactly."""
    values = bt.eigenpairs(bt.shapes.flat_torus(rows=40, columns=27), 9).values
    assert np.allclose(values, [0, 1, 1, 1, 1, 2, 2, 2, 2], rtol=0, atol=1e-12)


def test_four_equal_pieces():
    """More copies (4, then 12, then 20) than a block of the iteration is wide: none may be missing."""
    piece = bt.shapes.sphere(frequency=6)
    vertices = np.vstack([piece.vertices + np.array([3.0 * c, 0, 0]) for c in range(4)])
    faces = np.vstack([piece.faces + c * len(piece.vertices) for c in range(4)])
    ops = bt.operators(bt.TriangleMesh(vertices, faces))
    e = bt.eigenpairs(ops, 40)
    check(ops, e, 40)
    alone = bt.operators(piece)
    exact = np.repeat(dense_values(alone.stiffness, alone.mass, 10), 4)
    assert np.allclose(e.values, exact, rtol=1e-9, atol=1e-9)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([1, 3, 17, 60]))
def test_against_a_dense_solver(seed, k):
    rng = np.random.default_rng(seed)
    mesh = bt.shapes.torus(rows=int(rng.integers(8, 24)), columns=int(rng.integers(8, 16)))
    mesh = bt.TriangleMesh(mesh.vertices * rng.uniform(0.3, 2.0, 3), mesh.faces)
    ops = bt.operators(mesh, laplacian="cotangent")
    k = min(k, len(ops.mass))
    e = bt.eigenpairs(ops, k)
    check(ops, e, k)
    exact = dense_values(ops.stiffness, ops.mass, k)
    assert np.allclose(e.values, exact, rtol=1e-9, atol=1e-9 * 4 * np.pi / mesh.area)


def test_peer_scipy_on_a_knot():
    ops = bt.operators(bt.shapes.knot())
    e = bt.eigenpairs(ops, 20)
    mass = sparse.diags_array(ops.mass).tocsc()
    theirs = scipy.sparse.linalg.eigsh(sparse.csc_array(ops.stiffness), 20, mass, sigma=-1e-2, v0=np.ones(len(ops.mass)))[0]
    assert np.allclose(e.values[1:], np.sort(theirs)[1:], rtol=1e-9)


def test_scaling():
    """Lengths times s: values times s^-2, functions divided by s."""
    mesh = bt.shapes.ellipsoid(level=3)
    big = bt.TriangleMesh(1e4 * mesh.vertices, mesh.faces)
    a, b = bt.eigenpairs(mesh, 6), bt.eigenpairs(big, 6)
    assert np.allclose(b.values[1:] * 1e8, a.values[1:], rtol=1e-9)
    assert np.allclose(abs(b.functions) * 1e4, abs(a.functions), rtol=0, atol=1e-6 * abs(a.functions).max())


def test_pencil_of_matrices():
    """The path of 400 points: values 2 - 2 cos(π j / 400); a mass matrix 2 I halves them."""
    n = 400
    diagonal = np.r_[1.0, np.full(n - 2, 2.0), 1.0]
    a = sparse.diags_array([-np.ones(n - 1), diagonal, -np.ones(n - 1)], offsets=(-1, 0, 1))
    exact = 2 - 2 * np.cos(np.pi * np.arange(9) / n)
    assert np.allclose(bt.eigenpairs(a, 9).values, exact, rtol=0, atol=1e-12)
    halves = bt.eigenpairs(a, 9, mass=sparse.diags_array(np.full(n, 2.0)))
    assert np.allclose(halves.values, exact / 2, rtol=0, atol=1e-12)
    assert abs(halves.functions.T @ halves.functions - np.eye(9) / 2).max() < 1e-10


def test_a_full_mass_matrix_against_scipy():
    mesh = bt.shapes.torus(rows=20, columns=14)
    ops = bt.operators(mesh, laplacian="cotangent")
    e = bt.eigenpairs(ops.stiffness, 12, mass=ops.galerkin_mass)
    exact = scipy.linalg.eigh(ops.stiffness.toarray(), ops.galerkin_mass.toarray(), eigvals_only=True)[:12]
    assert np.allclose(e.values, exact, rtol=1e-9, atol=1e-10)


def test_warm_start_needs_fewer_solves():
    mesh = bt.shapes.ellipsoid(level=4)
    ops = bt.operators(mesh)
    cold = bt.eigenpairs(ops, 12)
    near = bt.operators(bt.TriangleMesh(mesh.vertices * [1.0, 1.01, 1.0], mesh.faces))
    warm = bt.eigenpairs(near, 12, start=cold.functions)
    assert np.allclose(warm.values, bt.eigenpairs(near, 12).values, rtol=1e-9, atol=1e-9)
    assert warm.iterations < cold.iterations


def test_vertices_of_no_triangle_take_no_part():
    mesh = bt.shapes.sphere(2)
    more = bt.TriangleMesh(np.vstack([[[9.0, 9.0, 9.0]], mesh.vertices]), mesh.faces + 1)
    a, b = bt.eigenpairs(mesh, 5), bt.eigenpairs(more, 5)
    assert np.allclose(a.values, b.values, rtol=0, atol=1e-12)
    assert (b.functions[0] == 0).all()


def test_the_same_bits_for_any_threads():
    before, found = bt.num_threads(), []
    ops = bt.operators(bt.shapes.sphere(4))
    try:
        for count in (1, 2, 3):
            bt.set_num_threads(count)
            e = bt.eigenpairs(ops, 9)
            found.append(e.values.tobytes() + e.functions.tobytes())
    finally:
        bt.set_num_threads(before)
    assert found[0] == found[1] == found[2]


def test_progress_stops():
    with pytest.raises(bt.Cancelled):
        bt.eigenpairs(bt.shapes.sphere(6), 150, progress=lambda share: False)


@pytest.mark.parametrize("k", [0, -3, 13, 2.5, "4", None, True])
def test_bad_counts(k):
    with pytest.raises(bt.InputError):
        bt.eigenpairs(bt.shapes.sphere(0), k)


def test_bad_input():
    mesh = bt.shapes.sphere(1)
    with pytest.raises(bt.InputError, match="mass= goes with a matrix"):
        bt.eigenpairs(mesh, 3, mass=np.ones(42))
    with pytest.raises(bt.InputError, match="start"):
        bt.eigenpairs(mesh, 3, start=np.ones((5, 2)))
    with pytest.raises(bt.InputError, match="mass"):
        bt.eigenpairs(sparse.eye_array(4), 2, mass=[1, 1, -1, 1])
    with pytest.raises(bt.InputError, match="k is 1000000000000000000000000000000"):
        bt.eigenpairs(mesh, 10**30)
    with pytest.raises(bt.InputError, match=r"not symmetric: entries \(0, 1\)"):
        bt.eigenpairs(sparse.csr_array([[2.0, 1.0], [0.0, 2.0]]), 1)
    with pytest.raises(bt.InputError, match="mass matrix is not symmetric"):
        bt.eigenpairs(sparse.eye_array(2), 1, mass=sparse.csr_array([[2.0, 1.0], [0.0, 2.0]]))
    with pytest.raises(bt.InputError, match="2 x 3"):
        bt.eigenpairs(sparse.eye_array(2), 1, mass=sparse.csr_array(np.ones((2, 3))))
    with pytest.raises(bt.NumericalError, match="give shift="):
        bt.eigenpairs(sparse.diags_array(np.linspace(-1, 5, 1000)), 2)


def test_the_values_nearest_to_a_shift():
    """On the sphere 6 and 12 have 5 and 7 copies; on a diagonal matrix everything is known."""
    ops = bt.operators(bt.shapes.sphere(frequency=7))
    all_of_them = dense_values(ops.stiffness, ops.mass, 60)
    for shift, k in ((5.9, 5), (12.1, 7), (8.9, 12)):
        e = bt.eigenpairs(ops, k, shift=shift)
        nearest = np.sort(all_of_them[np.argsort(abs(all_of_them - shift))[:k]])
        assert np.allclose(e.values, nearest, rtol=1e-10)
        assert abs(e.functions.T @ (ops.mass[:, None] * e.functions) - np.eye(k)).max() < 1e-10
    line = sparse.diags_array(np.linspace(-1, 5, 601))
    assert np.allclose(bt.eigenpairs(line, 3, shift=2.003).values, [1.99, 2.0, 2.01], atol=1e-12)
    assert np.allclose(bt.eigenpairs(line, 2, shift=-7.0).values, [-1, -0.99], atol=1e-12)
    few = sparse.diags_array(np.arange(-5.0, 6))
    assert np.allclose(bt.eigenpairs(few, 3, shift=2.1).values, [1, 2, 3], atol=1e-12)


@pytest.mark.parametrize("width", [1, 2, 5])
def test_a_narrow_start_misses_no_copy(width):
    ops = bt.operators(bt.shapes.sphere(frequency=8))
    cold = bt.eigenpairs(ops, 16)
    for scale in (1.0, 1e200, 1e-200):
        warm = bt.eigenpairs(ops, 16, start=scale * cold.functions[:, :width])
        assert np.allclose(warm.values, cold.values, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("ratio", [1e-3, 1e-6])
def test_pieces_of_very_different_size(ratio):
    """The small piece has a single value, 0, among the first of the large one."""
    piece = bt.shapes.sphere(frequency=6)
    mesh = bt.TriangleMesh(
        np.vstack([piece.vertices, 5 + ratio * piece.vertices]), np.vstack([piece.faces, piece.faces + len(piece.vertices)])
    )
    alone = bt.operators(piece)
    exact = np.r_[0, dense_values(alone.stiffness, alone.mass, 19)]
    e = bt.eigenpairs(mesh, 20)
    assert np.allclose(e.values, exact, rtol=1e-6, atol=1e-6)


def test_graded_mesh_against_a_dense_solver():
    """Spacings from 1 to 1e-5 in one disc."""
    radii = np.geomspace(1e-5, 1.0, 25)
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    points = np.vstack([[[0.0, 0.0]], *(r * np.c_[np.cos(angles), np.sin(angles)] for r in radii)])
    ring = np.arange(24)
    faces = [np.c_[np.zeros(24, int), 1 + ring, 1 + (ring + 1) % 24]]
    for at in range(24):
        a, b = 1 + 24 * at, 25 + 24 * at
        faces += [np.c_[a + ring, b + ring, b + (ring + 1) % 24], np.c_[a + ring, b + (ring + 1) % 24, a + (ring + 1) % 24]]
    ops = bt.operators(bt.TriangleMesh(points, np.vstack(faces)))
    e = bt.eigenpairs(ops, 12)
    # The dense solver has the rounding of the largest value, some 1e10 times the wanted ones.
    assert np.allclose(e.values, dense_values(ops.stiffness, ops.mass, 12), rtol=1e-4, atol=1e-4)
    assert e.residuals.max() < 1e-5 * e.values[-1]  # what is handed out at most


def test_plot_shows_the_modes_asked_for(tmp_path):
    modes = bt.eigenpairs(bt.shapes.sphere(2), 4)
    picture = modes.plot([1, 3], path=tmp_path / "modes.png", size=(200, 100))
    assert picture.pixels.shape == (100, 200, 3)
    assert "mode 1" in picture.description
    assert "mode 2" not in picture.description
    assert (tmp_path / "modes.png").stat().st_size > 0
    with pytest.raises(bt.InputError, match="modes is 4"):
        modes.plot(4)
    with pytest.raises(bt.InputError, match="matrices"):
        bt.eigenpairs(sparse.diags_array([1.0, 2.0]), 1).plot()


SHAPES = {
    "sphere": lambda: bt.shapes.sphere(frequency=9),
    "small sphere": lambda: bt.shapes.sphere(frequency=8, radius=1e-3),
    "ellipsoid": lambda: bt.shapes.ellipsoid(frequency=9),
    "needle": lambda: bt.shapes.ellipsoid(3.0, 0.2, 0.1, frequency=9),
    "torus": lambda: bt.shapes.torus(rows=40, columns=20),
    "thin torus": lambda: bt.shapes.torus(1.0, 0.05, rows=90, columns=8),
    "flat torus": lambda: bt.shapes.flat_torus(rows=24, columns=24),
    "flat torus of two radii": lambda: bt.shapes.flat_torus(1.0, 0.3, rows=30, columns=18),
    "square": lambda: bt.shapes.grid(25, 25),
    "ribbon": lambda: bt.shapes.grid(120, 5, width=30.0),
    "huge square": lambda: bt.shapes.grid(21, 31, width=1e4, height=2e4),
    "cylinder": lambda: bt.shapes.cylinder(rows=20, columns=30),
    "tin": lambda: bt.shapes.cylinder(rows=20, columns=30, closed=True),
    "disc": lambda: bt.shapes.disc(rings=14),
    "trefoil": lambda: bt.shapes.knot(rows=90, columns=8),
    "knot": lambda: bt.shapes.knot(3, 5, rows=110, columns=8),
    "figure eight": lambda: bt.shapes.figure_eight(resolution=6),
    "triple torus": lambda: bt.shapes.triple_torus(resolution=6),
    "star": lambda: bt.shapes.star(resolution=6),
    "y": lambda: bt.shapes.y(resolution=6),
}


@pytest.mark.parametrize("name", SHAPES)
def test_twenty_shapes_against_scipy(name):
    """The same pencil in ARPACK. It misses copies of multiple eigenvalues, so the shapes are made a little uneven."""
    mesh, k = SHAPES[name](), 20
    noise = np.random.default_rng(1).normal(size=mesh.vertices.shape)
    ops = bt.operators(bt.TriangleMesh(mesh.vertices + 0.05 * bt.operators(mesh).spacing * noise, mesh.faces))
    e = bt.eigenpairs(ops, k)
    assert e.iterations > 0, "too small: solved densely"
    pencil = sparse.csc_array(ops.stiffness), sparse.diags_array(ops.mass).tocsc()
    peer = np.sort(scipy.sparse.linalg.eigsh(pencil[0], k, pencil[1], sigma=-0.05 * e.values[-1], tol=1e-12, ncv=3 * k)[0])
    assert abs(e.values - peer).max() < 1e-9 * peer[-1]
    check(ops, e, k)


def test_all_pairs_of_many_pieces():
    """With most of the spectrum wanted each piece is solved by itself; a function lives on one piece unless pieces are alike."""
    pieces = [bt.shapes.sphere(frequency=3), bt.shapes.torus(rows=12, columns=8), bt.shapes.disc(rings=5), bt.shapes.grid(9, 8)]
    starts = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    vertices = np.vstack([np.c_[p.vertices, np.zeros((len(p.vertices), 3 - p.dimension))] for p in pieces])
    faces = np.vstack([piece.faces + start for piece, start in zip(pieces, starts, strict=False)])
    order = np.random.default_rng(2).permutation(len(vertices))
    ops = bt.operators(bt.TriangleMesh(vertices[order], np.argsort(order)[faces]))
    n = len(order)
    e = bt.eigenpairs(ops, n)
    check(ops, e, n)
    assert np.allclose(e.values, dense_values(ops.stiffness, ops.mass, n), rtol=1e-10, atol=1e-11 * e.values[-1])
    some = bt.eigenpairs(ops, n // 2 + 1)
    assert np.allclose(some.values, e.values[: n // 2 + 1], rtol=1e-10, atol=1e-11 * e.values[-1])
    full = bt.eigenpairs(ops.stiffness, n, mass=ops.mass[:, None] * sparse.eye_array(n))
    assert np.allclose(full.values, e.values, rtol=1e-10, atol=1e-11 * e.values[-1])


def test_signatures_of_several_pieces():
    """The functions of eigenvalue 0 mix the pieces as rounding has it, and the area was read off the first: up to 3 times too little."""
    sphere, torus = bt.shapes.sphere(3), bt.shapes.torus(rows=20, columns=12)
    vertices = np.vstack([2 * sphere.vertices, torus.vertices + np.array([9, 0, 0]), 1e-3 * sphere.vertices - [9, 0, 0]]) * [
        1,
        0.8,
        0.65,
    ]  # no multiple eigenvalues
    n, t = len(sphere.vertices), len(torus.vertices)
    faces = np.vstack([sphere.faces, torus.faces + n, sphere.faces + n + t])
    whole = bt.TriangleMesh(vertices, faces)
    pairs = bt.eigenpairs(whole, 12)
    area = bt.operators(whole).mass.sum()
    decay = np.exp(-pairs.values * 0.7)
    expected = (pairs.functions**2 @ decay) * area / decay.sum()
    assert bt.hks(whole, times=[0.7], k=12)[:, 0] == pytest.approx(expected, rel=1e-9)
    rng = np.random.default_rng(0)
    order = rng.permutation(len(vertices))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned = bt.TriangleMesh(1e6 * vertices[order] @ turn, np.argsort(order)[faces])
    for signature in (bt.hks, bt.wks):
        assert signature(turned, k=12) == pytest.approx(signature(whole, k=12)[order], rel=1e-5)


def test_shape_dna_of_a_conformal_factor_counts_its_area():
    mesh = bt.shapes.torus(rows=20, columns=12)
    factor = 0.5 * mesh.vertices[:, 0]
    pairs = bt.conformal_eigenpairs(mesh, factor, 6)
    area = (bt.operators(mesh).mass * np.exp(factor)).sum()
    assert bt.shape_dna(pairs, k=5) == pytest.approx(pairs.values[1:] * area, rel=1e-9)
