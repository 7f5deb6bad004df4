"""Sparse Cholesky from Python: scipy as the peer, every form of input, faults, pickles, threads, Ctrl-C."""

import pickle

import beltrami as bt
import numpy as np
import pytest
import scipy.sparse as sparse
import scipy.sparse.linalg as linalg
from hypothesis import given, settings
from hypothesis import strategies as st


def grid(*sides):
    """Second differences with Dirichlet ends, and the places of the nodes."""
    matrix = sparse.csr_array((1, 1))
    for side in sides:
        line = sparse.diags_array([-np.ones(side - 1), 2 * np.ones(side), -np.ones(side - 1)], offsets=[-1, 0, 1])
        matrix = sparse.kron(matrix, sparse.eye_array(side)) + sparse.kron(sparse.eye_array(matrix.shape[0]), line)
    return sparse.csr_array(matrix), np.stack(np.meshgrid(*map(np.arange, sides), indexing="ij"), -1).reshape(-1, len(sides)).astype(float)


def relative(a, b, x):
    return (np.linalg.norm(b - a @ x, axis=0) / np.linalg.norm(b, axis=0)).max()


@pytest.mark.parametrize("sides", [(1,), (50,), (60, 61), (15, 16, 14)])
@pytest.mark.parametrize("placed", [False, True])
def test_residual_and_determinant(sides, placed):
    a, points = grid(*sides)
    factor = bt.Cholesky(a, coordinates=points if placed else None)
    wave = np.zeros(1)  # eigenvalues are sums of 4 sin^2(k pi / (2 side + 2))
    for side in sides:
        wave = np.add.outer(wave, 4 * np.sin(np.arange(1, side + 1) * np.pi / (2 * side + 2)) ** 2).ravel()
    assert factor.log_determinant == pytest.approx(np.log(wave).sum(), rel=1e-12)
    assert factor.shape == a.shape
    assert factor.nnz >= (a.nnz + len(points)) // 2
    for k in (1, 3, 32):
        b = np.random.default_rng(k).normal(size=(len(points), k))
        x = factor.solve(b)
        assert relative(a, b, x) < 1e-14 * 100
        np.testing.assert_allclose(factor.residual(b, x), np.linalg.norm(b - a @ x, axis=0) / np.linalg.norm(b, axis=0), atol=1e-15)


def test_against_scipy():
    a, _ = grid(30, 31)
    b = np.random.default_rng(0).normal(size=a.shape[0])
    theirs = linalg.spsolve(sparse.csc_matrix(a), b)
    np.testing.assert_allclose(bt.Cholesky(a).solve(b), theirs, atol=1e-12 * abs(theirs).max())  # condition 1e3 times rounding


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 80), st.floats(0.0, 8.0), st.integers(0, 2**32 - 1), st.integers(0, 4))
def test_random_patterns(n, density, seed, dimension):
    rng = np.random.default_rng(seed)
    half = sparse.random_array((n, n), density=min(1.0, density / n), rng=rng)
    a = sparse.csr_array(half @ half.T + sparse.eye_array(n))
    factor = bt.Cholesky(a, coordinates=rng.normal(size=(n, dimension)) if dimension else None)
    assert factor.log_determinant == pytest.approx(np.linalg.slogdet(a.toarray())[1], rel=1e-11, abs=1e-11)
    b = rng.normal(size=(n, 2))
    assert relative(a, b, factor.solve(b)) < 1e-13


@pytest.mark.parametrize("form", ["csr", "csc", "coo", "lil", "dok", "dia", "bsr", "dense"])
def test_any_format(form):
    a, _ = grid(6, 7)
    given_matrix = a.toarray() if form == "dense" else a.asformat(form)
    b = np.arange(42.0)
    np.testing.assert_array_equal(bt.Cholesky(given_matrix).solve(b), bt.Cholesky(a).solve(b))


def test_any_right_hand_side():
    a, _ = grid(20, 11)
    factor, b = bt.Cholesky(a), np.random.default_rng(0).integers(-9, 9, (220, 5)).astype(float)
    x, kept = factor.solve(b), b.copy()
    strided = np.zeros((440, 10))
    strided[::2, ::2] = b
    for same in (np.asfortranarray(b), strided[::2, ::2], b.astype(np.int8), b.astype(">f4"), b[::-1][::-1], b.tolist()):
        np.testing.assert_array_equal(factor.solve(same), x)
    np.testing.assert_array_equal(b, kept)
    np.testing.assert_allclose(factor.solve(b[:, 2]), x[:, 2], rtol=1e-12)
    assert factor.solve(np.zeros((220, 0))).shape == (220, 0)
    out = np.empty_like(b)
    assert factor.solve(b, out=out) is out
    np.testing.assert_array_equal(out, x)
    np.testing.assert_array_equal(factor.solve(out := b.copy(), out=out), x)  # in place
    one = np.empty(220)
    np.testing.assert_array_equal(factor.solve(b[:, 0], out=one), factor.solve(b[:, 0]))


def test_refactor():
    a, points = grid(25, 30)
    factor, b = bt.Cholesky(a, coordinates=points), np.random.default_rng(0).normal(size=750)
    x = factor.solve(b)
    assert factor.refactor(a * 4) is factor
    np.testing.assert_array_equal(factor.solve(b), x / 4)  # a power of four changes no bit of a root
    assert abs(factor.matrix - 4 * a).max() == 0
    with pytest.raises(bt.InputError, match="row 0"):
        factor.refactor(sparse.eye_array(750))
    np.testing.assert_array_equal(factor.solve(b), x / 4)
    with pytest.raises(bt.NumericalError, match="positive definite"):
        factor.refactor(-a)
    np.testing.assert_array_equal(factor.solve(b), x / 4)
    np.testing.assert_array_equal(factor.refactor(a).solve(b), x)


@pytest.mark.parametrize("placed", [False, True])
def test_pickle(placed):
    a, points = grid(70, 60)
    factor, b = bt.Cholesky(a, coordinates=points if placed else None), np.random.default_rng(0).normal(size=(4200, 3))
    factor.refactor(a + sparse.eye_array(4200))
    again = pickle.loads(pickle.dumps(factor))
    np.testing.assert_array_equal(again.solve(b), factor.solve(b))
    assert again.nnz == factor.nnz
    assert again.shape == factor.shape


def test_refused_matrices():
    a, points = grid(12, 12)
    with pytest.raises(bt.NumericalError, match=r"pivot of row \d+ is"):
        bt.Cholesky(a - 3 * sparse.eye_array(144))
    bad = a.tolil()
    bad[100, 100] = -5.0
    with pytest.raises(bt.NumericalError, match="pivot of row 100 is"):
        bt.Cholesky(bad)
    bad = a.tolil()
    bad[7, 8] = -2.0
    with pytest.raises(bt.InputError, match=r"\(7, 8\)"):
        bt.Cholesky(bad)
    with pytest.raises(bt.InputError, match="both triangles"):
        bt.Cholesky(sparse.triu(a))
    with pytest.raises(bt.InputError, match="square"):
        bt.Cholesky(a[:, :100])
    with pytest.raises(bt.InputError, match="NaN"):
        bt.Cholesky(sparse.diags_array([1.0, np.nan]))
    with pytest.raises(bt.InputError, match="coordinates"):
        bt.Cholesky(a, coordinates=points[:-1])
    with pytest.raises(bt.InputError, match="inf"):
        bt.Cholesky(a, coordinates=np.where(points == 3, np.inf, points))


def test_refused_right_hand_sides():
    a, _ = grid(12, 12)
    factor, b = bt.Cholesky(a), np.ones(144)
    for wrong in (np.ones(143), np.ones((143, 2)), np.ones((2, 144)), 1.0, np.ones((144, 1, 1)), b + 1j, ["a"] * 144):
        with pytest.raises(bt.InputError):
            factor.solve(wrong)
    with pytest.raises(bt.InputError, match="row 5 of right-hand side 0 is NaN"):
        factor.solve(np.where(np.arange(144) == 5, np.nan, b))
    for out in (np.ones(143), np.ones(144, np.float32), np.ones((144, 1)), np.ones(288)[::2], [0.0] * 144):
        with pytest.raises(bt.InputError, match="out"):
            factor.solve(b, out=out)


@pytest.mark.parametrize("scale", [1e-200, 1e-300, 1.0, 1e200, 1e300])
def test_residuals_at_any_scale(scale):
    """Squares of such numbers over- or underflow; the residual does not, nor does a step of refinement stay out."""
    a, points = grid(20, 20)
    factor, b = bt.Cholesky(a, coordinates=points), scale * np.random.default_rng(0).normal(size=(400, 2))
    x = factor.solve(b)
    assert (factor.residual(b, x) < 1e-13).all()
    assert np.allclose(factor.residual(b, x * (1 + 1e-6)), 1e-6, rtol=1e-3)
    with pytest.raises(bt.InputError, match="row 3"):
        factor.residual(np.where(np.arange(400) == 3, np.nan, b[:, 0]), x[:, 0])


@pytest.mark.parametrize("matrix", [sparse.coo_array(np.ones(4)), sparse.csr_array((2**31, 2**31)), [[1.0], [1.0, 2.0]], [1.0]])
def test_what_is_no_matrix(matrix):
    with pytest.raises(bt.InputError):
        bt.Cholesky(matrix)


def test_ragged_right_hand_sides():
    with pytest.raises(bt.InputError):
        bt.Cholesky(sparse.eye_array(2)).solve([[1.0], [1.0, 2.0]])
    with pytest.raises(bt.InputError):
        bt.PoissonSolver(bt.shapes.sphere(0)).solve([[1.0], [1.0, 2.0]] * 6)


def test_progress():
    a, points = grid(300, 300)
    shares = []
    bt.Cholesky(a, coordinates=points, progress=shares.append)
    assert shares[-1] == 1.0
    assert all(0 <= share <= 1 for share in shares)
    with pytest.raises(bt.Cancelled):
        bt.Cholesky(grid(700, 700)[0], progress=lambda share: False)


def test_same_bits_on_any_number_of_threads():
    a, points = grid(110, 120)
    b = np.random.default_rng(0).normal(size=(len(points), 19))
    before, answers = bt.num_threads(), []
    try:
        for threads in (1, 2, 4):
            bt.set_num_threads(threads)
            answers.append([bt.Cholesky(a, coordinates=c).solve(b[:, :k]) for c in (None, points) for k in (1, 19)])
    finally:
        bt.set_num_threads(before)
    for answer in answers[1:]:
        for one, other in zip(answers[0], answer, strict=True):
            np.testing.assert_array_equal(one, other)
