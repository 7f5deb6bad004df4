"""Committors and reaction rates: closed forms, orders, symmetries, other programs, refusals."""

from pathlib import Path
from typing import Any, Literal

import beltrami as bt
import numpy as np
import numpy.typing as npt
import pytest
import scipy.sparse as sparse
import scipy.sparse.linalg as linalg
from beltrami.committor import solve, weighted
from hypothesis import given, settings
from hypothesis import strategies as st

Floats = npt.NDArray[np.float64]
SIDE, EDGE, HEIGHT = 1.5, 0.75, 0.5


def strip(columns: int, seed: int, jitter: float = 0.2) -> tuple[Floats, Floats, Any, Any]:
    """Jittered grid on [-1.5, 1.5] x [-0.5, 0.5], U = (x² - 1)² + y²/2, and A, B with their rims on points."""
    h = SIDE / columns
    rows, rim = round(HEIGHT / h), round(columns * EDGE / SIDE)
    i, j = (g.ravel() for g in np.meshgrid(np.arange(-columns, columns + 1), np.arange(-rows, rows + 1), indexing="ij"))
    move = np.random.default_rng(seed).uniform(-jitter, jitter, (len(i), 2))
    move[(np.abs(i) == columns) | (np.abs(i) == rim), 0] = 0
    move[np.abs(j) == rows, 1] = 0
    x = (np.c_[i, j] + move) * h
    return x, (x[:, 0] ** 2 - 1) ** 2 + x[:, 1] ** 2 / 2, i <= -rim, i >= rim


def exact(x: Floats, beta: float, edge: float = EDGE) -> tuple[Floats, float]:
    """q and the rate of the strip: q' is in proportion to exp(β (x² - 1)²), whatever U does along y.

    nu = (1 / (β Z)) ∫ exp(-β U) q'² = 1 / (β ∫_-SIDE^SIDE exp(-β V) ∫_-edge^edge exp(β V)): the integrals along y cancel.
    """
    nodes, weights = np.polynomial.legendre.leggauss(200)
    barrier = lambda t: np.exp(beta * (t * t - 1) ** 2)  # noqa: E731
    total = edge * (weights * barrier(edge * nodes)).sum()
    half = (np.clip(x, -edge, edge) + edge) / 2
    q = half * (weights * barrier(-edge + half[:, None] * (nodes + 1))).sum(1) / total
    return q, 1 / (beta * total * SIDE * (weights / barrier(SIDE * nodes)).sum())


def wells(x: Floats) -> Floats:
    """Three wells on a torus in R^3 (or its first three coordinates), β = 1."""
    t, f = np.arctan2(x[:, 1], x[:, 0]), np.arctan2(x[:, 2], np.hypot(x[:, 0], x[:, 1]) - 2)
    return -sum(
        depth * np.exp(2.5 * (np.cos(t - tk) - 1) + 1.5 * (np.cos(f - fk) - 1))
        for depth, tk, fk in ((6, 0.0, 0.3), (4.5, 2.0, 1.5), (5.5, -1.9, -0.6))
    )


def torus(count: int, seed: int) -> Floats:
    """Uniform by area."""
    rng = np.random.default_rng(seed)
    t, f = rng.uniform(-np.pi, np.pi, (2, 4 * count))
    f = f[rng.random(4 * count) < (2 + 0.8 * np.cos(f)) / 2.8][:count]
    t = t[:count]
    return np.c_[(2 + 0.8 * np.cos(f)) * np.cos(t), (2 + 0.8 * np.cos(f)) * np.sin(t), 0.8 * np.sin(f)]


def ends(x: Floats) -> tuple[Any, Any]:
    one, other = (
        np.array([(2 + 0.8 * np.cos(f)) * np.cos(t), (2 + 0.8 * np.cos(f)) * np.sin(t), 0.8 * np.sin(f)])
        for t, f in ((0, 0.3), (-1.9, -0.6))
    )
    return np.linalg.norm(x[:, :3] - one, axis=1) < 0.4, np.linalg.norm(x[:, :3] - other, axis=1) < 0.4


# --- analytic ----------------------------------------------------------------------------------------------------------------------


def test_double_well_has_its_closed_form() -> None:
    x, u, a, b = strip(32, 1)
    r = bt.committor(bt.PointCloud(x), u, a, b, beta=4.0)
    q, rate = exact(x[:, 0], 4.0)
    assert np.abs(r.q - q).max() < 2e-4  # second order: 0.05 h² at h = 0.047
    assert r.rate == pytest.approx(rate, rel=1e-3)
    assert r.rate_flux == pytest.approx(rate, rel=0.02)
    assert r.verdict == "sound"


def test_times_are_those_of_one_dimension() -> None:
    """Mean time from x to B: β ∫_x^edge exp(β V(y)) ∫_-SIDE^y exp(-β V) dz dy, here by the trapezoid rule on a fine grid."""
    x, u, a, b = strip(32, 2)
    r = bt.committor(bt.PointCloud(x), u, a, b, beta=4.0)
    z = np.linspace(-SIDE, SIDE, 30001)
    v = 4.0 * (z * z - 1) ** 2
    step = z[1] - z[0]
    inner = np.concatenate([[0], np.cumsum((np.exp(-v[1:]) + np.exp(-v[:-1])) / 2)]) * step
    slope = np.where(z < EDGE, np.exp(v) * inner, 0)
    outer = np.concatenate([[0], np.cumsum((slope[1:] + slope[:-1]) / 2)]) * step
    time = 4.0 * (outer[-1] - np.interp(x[:, 0], z, outer))
    time[b] = 0
    assert np.abs(r.passage_time_to_B - time).max() < 2e-3 * time.max()
    forth, back = r.mean_first_passage_times
    assert forth == pytest.approx(back, rel=0.02)  # A and B mirror each other, the jitter does not
    assert r.rate_constant == pytest.approx(r.rate_constant_backward, rel=0.02)


def test_current_carries_the_rate() -> None:
    x, u, a, b = strip(32, 3)
    r = bt.committor(bt.PointCloud(x), u, a, b, beta=4.0)
    between = np.abs(x[:, 0]) < EDGE / 2
    mass = bt.operators(bt.PointCloud(x)).mass[between]
    assert np.average(r.current[between, 0], weights=mass) * 2 * x[:, 1].max() == pytest.approx(r.rate, rel=0.03)
    assert np.abs(r.current[between, 1]).mean() < 0.02 * np.abs(r.current[between, 0]).mean()
    assert (r.current[a | b] == 0).all()


@pytest.mark.parametrize("dimension", [1, 3])
def test_curves_and_volumes(dimension: int) -> None:
    """U = 0 between two ends of a box: q is linear in x, nu = 1 / (β length of the box · distance of the sets)."""
    count = {1: 101, 3: 13}[dimension]
    rng = np.random.default_rng(4)
    axis = np.arange(count) / (count - 1)
    grid = np.stack(np.meshgrid(*[axis] * dimension, indexing="ij"), -1).reshape(-1, dimension)
    inner = (grid[:, :1] > 0) & (grid[:, :1] < 1)
    x = grid + rng.uniform(-0.1, 0.1, grid.shape) * inner * ((grid > 0) & (grid < 1)) / (count - 1)
    r = bt.committor(bt.PointCloud(x, dimension=dimension), np.zeros(len(x)), grid[:, 0] == 0, grid[:, 0] == 1, beta=2.0)
    assert np.abs(r.q - x[:, 0]).max() < 1e-12  # linear elements hold linear functions
    assert r.rate == pytest.approx(0.5, rel=1e-6)


def test_mesh_and_cloud_agree() -> None:
    mesh = bt.shapes.sphere(5)
    x = mesh.vertices
    u = 6 * (x[:, 0] ** 2 - 0.5) ** 2 + x[:, 1]
    a, b = x[:, 2] < -0.9, x[:, 2] > 0.9
    on_mesh = bt.committor(mesh, u, a, b, beta=2.0)
    on_cloud = bt.committor(bt.PointCloud(x), u, a, b, beta=2.0)
    assert np.abs(on_mesh.q - on_cloud.q).max() < 1e-3  # the same triangles; U between the points is fitted otherwise
    assert on_mesh.rate == pytest.approx(on_cloud.rate, rel=1e-3)


def test_grids_on_curved_surfaces() -> None:
    """Four points of a torus' grid lie on a circle: their stars must choose one diagonal. The mesh of the same points judges."""
    mesh = bt.shapes.torus(2.0, 0.8, rows=90, columns=36)
    x = mesh.vertices
    a, b = ends(x)
    on_cloud = bt.committor(bt.PointCloud(x), wells(x), a, b, beta=1.0)
    on_mesh = bt.committor(mesh, wells(x), a, b, beta=1.0)
    assert on_cloud.diagnostics.agreed > 0.8
    assert "disagree" not in on_cloud.verdict
    assert np.abs(on_cloud.q - on_mesh.q).max() < 0.01
    assert on_cloud.rate == pytest.approx(on_mesh.rate, rel=0.01)


def test_disagreeing_stars_are_called_doubtful() -> None:
    """Noise as large as the spacing: no two stars see the same triangles."""
    x = torus(1500, 3)
    x = x + 0.1 * np.random.default_rng(0).standard_normal(x.shape)
    assert "disagree" in bt.committor(bt.PointCloud(x), wells(x), *ends(x), beta=1.0).verdict
    assert bt.committor(bt.PointCloud(torus(1500, 3)), wells, *ends(torus(1500, 3)), beta=1.0).diagnostics.agreed > 0.9


def test_circulation_leaves_the_density_and_turns_the_committors() -> None:
    """Around a ring with U = 0 and drift c, q+ solves q'' + β c q' = 0: exponentials on both arcs between A (angle 0) and B (angle π)."""
    count, c = 400, 0.7
    angle = 2 * np.pi * np.arange(count) / count
    x = np.c_[np.cos(angle), np.sin(angle)]
    turn = c * np.c_[-x[:, 1], x[:, 0]]
    a, b = [0], [count // 2]
    r = bt.committor(bt.PointCloud(x, dimension=1), np.zeros(count), a, b, beta=1.0, circulation=turn)
    rising = np.expm1(-c * angle) / np.expm1(-c * np.pi)
    falling = np.expm1(c * (2 * np.pi - angle)) / np.expm1(c * np.pi)
    wanted = np.where(angle <= np.pi, rising, falling)
    assert np.abs(r.q - wanted).max() < 1e-4
    mirrored = bt.committor(bt.PointCloud(x, dimension=1), np.zeros(count), a, b, beta=1.0, circulation=-turn)
    assert np.abs(r.q_backward - (1 - mirrored.q)).max() < 1e-12


@pytest.mark.parametrize("method", ["weak", "strong"])
@pytest.mark.parametrize("turn", [0.0, 0.5, 3.0])
def test_iteration_and_elimination_agree(method: Literal["weak", "strong"], turn: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Systems that are not symmetric, of all sizes; and where iteration is of no use, it says so and elimination follows."""
    x = torus(1500, 3)
    drift = turn * np.c_[-x[:, 1], x[:, 0], 0 * x[:, 0]]
    found, eliminated = [], []
    real = linalg.splu
    monkeypatch.setattr(linalg, "splu", lambda *args, **ways: eliminated.append(1) or real(*args, **ways))
    for few in (0, 10**9):
        monkeypatch.setattr(solve, "FEW", few)
        eliminated.clear()
        found.append(bt.committor(bt.PointCloud(x), wells, *ends(x), beta=1.0, method=method, circulation=drift if turn else None))
        assert bool(eliminated) == (few > 0 and (method == "strong" or turn > 0))
    for name in ("q", "q_backward"):
        assert np.abs(getattr(found[0], name) - getattr(found[1], name)).max() < 1e-9
    assert found[0].rate == pytest.approx(found[1].rate, rel=1e-8)
    monkeypatch.setattr(solve, "FEW", 0)
    monkeypatch.setattr(solve, "RESTART", 1)
    third = bt.committor(bt.PointCloud(x), wells, *ends(x), beta=1.0, method=method, circulation=drift if turn else None)
    assert np.abs(third.q - found[1].q).max() < 1e-12


def test_nothing_left_to_solve_for() -> None:
    x = np.random.default_rng(3).uniform(-1, 1, (500, 2))
    a = x[:, 0] < 0
    for extra in ({"method": "strong"}, {"circulation": x}):
        r = bt.committor(bt.PointCloud(x), np.square(x).sum(1), a, ~a, beta=1.0, **extra)
        assert (r.q == ~a).all()


@pytest.mark.parametrize("few", [0, 10**9])
def test_what_rounding_loses_is_refused(few: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small residual is no small error: drifts far too strong and points a thousand times denser once had q off by half."""
    monkeypatch.setattr(solve, "FEW", few)
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, (200, 2))
    with pytest.raises(bt.NumericalError, match="weaker circulation"):
        bt.committor(bt.PointCloud(x), np.square(x).sum(1), x[:, 0] < -0.8, x[:, 0] > 0.8, beta=1.0, circulation=-300 * x)
    x = np.random.default_rng(3).uniform(-1, 1, (1500, 2))
    x = np.concatenate([x, 1e-3 * x[:900]])
    with pytest.raises(bt.NumericalError, match="take the weak form"):
        bt.committor(bt.PointCloud(x), np.square(x).sum(1), x[:, 0] < -0.7, x[:, 0] > 0.7, beta=1.0, method="strong")


def annulus(count: int, seed: int) -> Floats:
    """Uniform on 0.7 < r < 3.6."""
    rng = np.random.default_rng(seed)
    angle, r = rng.uniform(-np.pi, np.pi, count), np.sqrt(rng.uniform(0.49, 12.96, count))
    return np.c_[r * np.cos(angle), r * np.sin(angle)]


def test_both_estimates_agree_without_a_barrier() -> None:
    """U = 0 between circles of radius 1 and 3: q = log r / log 3. The sets' kinks once spoiled the gradients of the second estimate."""
    x = annulus(2000, 1)
    q = np.clip(np.log(np.linalg.norm(x, axis=1)) / np.log(3), 0, 1)
    r = bt.committor(
        bt.PointCloud(x), np.zeros(2000), lambda p: np.linalg.norm(p, axis=1) - 1, lambda p: 3 - np.linalg.norm(p, axis=1), beta=1.0
    )
    assert np.abs(r.q - q).max() < 3e-3
    assert r.rate == pytest.approx(2 * np.pi / np.log(3) / (np.pi * (12.96 - 0.49)), rel=0.06)  # the cloud's rim lacks half a spacing
    assert abs(r.rate_flux - r.rate) < 2 * r.rate_flux_error < 0.02 * r.rate
    assert r.verdict == "sound"


@pytest.mark.parametrize("seed", [11, 12, 17])
def test_chance_gaps_are_no_holes(seed: int) -> None:
    """Uniform points on the flat torus, U = 0: q is linear in the first angle. A gap beside a clump counted as a hole, and q was off by
    8e-3 to 16e-3 around it; what is left comes from the chords of the circles and from the rims."""
    angles = np.random.default_rng(seed).uniform(-np.pi, np.pi, (6000, 2))
    folded = np.where(np.abs(angles[:, 0]) <= np.pi / 2, angles[:, 0], np.sign(angles[:, 0]) * np.pi - angles[:, 0])
    q = np.clip((folded + np.pi / 2 - 0.3) / (np.pi - 0.6), 0, 1)

    def near(centre: float) -> Any:
        return lambda p: np.abs(np.angle(np.exp(1j * (np.arctan2(p[:, 1], p[:, 0]) - centre)))) - 0.3

    cloud = bt.PointCloud(bt.molecules.on_torus(angles))
    assert bt.operators(cloud).boundary.any()
    r = bt.committor(cloud, np.zeros(6000), near(-np.pi / 2), near(np.pi / 2), beta=1.0)
    assert np.abs(r.q - q).max() < 6.5e-3


def test_cold_samples_end_where_the_potential_is_high() -> None:
    """Gibbs samples of U = (x² - 1)² + y² at β = 5: few at the barrier, and gaps there are no holes (9 % low on average)."""
    beta, edge, off = 5.0, 0.7, []
    nodes, weights = np.polynomial.legendre.leggauss(200)
    well = lambda t: (t * t - 1) ** 2  # noqa: E731
    rate = 1 / (beta * edge * (weights * np.exp(beta * well(edge * nodes))).sum() * 3 * (weights * np.exp(-beta * well(3 * nodes))).sum())
    for seed in range(6):
        rng = np.random.default_rng(seed)
        t = rng.uniform(-2, 2, 60_000)
        t = t[rng.random(len(t)) < np.exp(-beta * well(t))][:2000]
        x = np.c_[t, rng.normal(size=2000) / np.sqrt(2 * beta)]
        r = bt.committor(bt.PointCloud(x), well(t) + x[:, 1] ** 2, t < -edge, t > edge, beta=beta)
        off.append(r.rate / rate - 1)
    assert abs(np.mean(off)) < 0.03
    assert np.sqrt(np.mean(np.square(off))) < 0.05


# --- convergence -------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("refine", [0, 1])
def test_second_order_in_the_spacing(refine: int) -> None:
    errors, spacings = [], []
    for columns in (8, 12, 16, 24):
        x, u, a, b = strip(columns, columns)
        r = bt.committor(bt.PointCloud(x), u, a, b, beta=4.0, refine=refine)
        errors.append(np.sqrt(np.mean((r.q - exact(x[:, 0], 4.0)[0]) ** 2)))
        spacings.append(SIDE / columns)
    assert np.polyfit(np.log(spacings), np.log(errors), 1)[0] > 1.7


def test_middles_of_edges_have_the_potential_of_smooth_functions() -> None:
    """Quadratics to the ridge of the fits; of exp(x - y) the error of a cubic along edges of 0.05."""
    x = np.random.default_rng(24).random((1500, 2))
    ops = bt.operators(bt.PointCloud(x))
    ones = np.ones(len(x))
    quadratic = lambda p: 3 * p[:, 0] ** 2 - 5 * p[:, 0] * p[:, 1] + p[:, 1]  # noqa: E731
    for function, bar in ((quadratic, 1e-7), (lambda p: np.exp(p[:, 0] - p[:, 1]), 1e-4)):
        mesh = weighted.elements(ops, function(x), None, (ones, ones))
        middle = (x[mesh.first] + x[mesh.second]) / 2
        off = mesh.bow - function(middle) + (mesh.potential[mesh.first] + mesh.potential[mesh.second]) / 2
        assert np.sqrt(np.mean(off**2)) < bar


def test_level_functions_cut_edges_where_the_rim_is() -> None:
    """Rims between the points: without the cut the error is of first order, some 2e-2 here."""
    x, u, _, _ = strip(24, 5)
    edge = EDGE - 0.4 * SIDE / 24
    r = bt.committor(bt.PointCloud(x), u, lambda p: p[:, 0] + edge, lambda p: edge - p[:, 0], beta=4.0)
    q, rate = exact(x[:, 0], 4.0, edge)
    assert np.abs(r.q - q).max() < 1e-3
    assert r.rate == pytest.approx(rate, rel=3e-3)


def test_predicates_are_masks() -> None:
    x, u, a, b = strip(12, 26)
    r = bt.committor(bt.PointCloud(x), u, lambda p: p[:, 0] <= -EDGE + 1e-9, lambda p: p[:, 0] >= EDGE - 1e-9, beta=4.0)
    np.testing.assert_array_equal(r.q, bt.committor(bt.PointCloud(x), u, a, b, beta=4.0).q)


# --- property ----------------------------------------------------------------------------------------------------------------------


def test_identities_on_the_torus() -> None:
    x = torus(1500, 6)
    u = wells(x)
    a, b = ends(x)
    r = bt.committor(bt.PointCloud(x), u, a, b, beta=1.0)
    turn = np.linalg.qr(np.random.default_rng(7).normal(size=(10, 10)))[0][:3]
    order = np.random.default_rng(8).permutation(len(x))
    swapped = bt.committor(bt.PointCloud(x), u, b, a, beta=1.0)
    embedded = bt.committor(bt.PointCloud(3 * x @ turn + 1), u + 100, np.flatnonzero(a), np.flatnonzero(b), beta=1.0)
    shuffled = bt.committor(bt.PointCloud(x[order]), u[order], a[order], b[order], beta=1.0)
    assert np.abs(swapped.q - (1 - r.q)).max() < 1e-12
    assert np.abs(embedded.q - r.q).max() < 1e-9
    assert embedded.rate == pytest.approx(r.rate / 9, rel=1e-9)  # time goes like length²
    assert np.abs(shuffled.q - r.q[order]).max() < 1e-9
    assert r.rate == pytest.approx(r.rate_constant * r.share_A) == pytest.approx(r.rate_constant_backward * (1 - r.share_A))


@settings(deadline=None)  # the machine may be busy
@given(seed=st.integers(0, 10_000), steepness=st.floats(0.0, 30.0), count=st.integers(12, 200))
def test_q_is_a_probability_whatever_the_potential(seed: int, steepness: float, count: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.random((count, 2)) ** rng.uniform(0.5, 3)
    u = steepness * rng.random(count)
    try:
        r = bt.committor(bt.PointCloud(x), u, [int(x[:, 0].argmin())], [int(x[:, 0].argmax())], beta=1.0)
    except (bt.InputError, bt.NumericalError):  # points too near each other, or A is B; a pit that nothing leaves
        return
    assert (r.q >= 0).all()
    assert (r.q <= 1).all()
    assert r.rate > 0
    assert np.isfinite(r.current).all()


def test_flux_is_the_same_through_every_cut() -> None:
    x = torus(1500, 9)
    a, b = ends(x)
    r = bt.committor(bt.PointCloud(x), wells(x), a, b, beta=1.0)
    for level in (0.2, 0.5, 0.8):
        cut = r.isocommittor(level)
        assert cut.flux.sum() == pytest.approx(1)
        assert len(cut.points) == len(cut.flux)
    assert abs(r.rate_flux - r.rate) < 3 * r.rate_flux_error


def test_lines_and_path_lead_from_a_to_b() -> None:
    x, u, a, b = strip(24, 10)
    r = bt.committor(bt.PointCloud(x), u, a, b, beta=4.0)
    h = SIDE / 24
    for line in r.streamlines(5):
        assert line[0, 0] < -EDGE + 1.5 * h
        assert line[-1, 0] > EDGE - 1.5 * h
        assert np.ptp(line[:, 1]) < 0.05  # the current runs along x
    path = r.path()
    assert path[0, 0] <= -EDGE + 1e-12
    assert path[-1, 0] >= EDGE - 1e-12
    assert (np.abs(path[:, 1]) < 0.3).all()  # along the valley's floor, y = 0
    assert (np.abs(r.q[r.transition_states(0.1)] - 0.5) <= 0.1).all()
    energy = r.free_energy(10)
    assert energy.free_energy.min() == 0
    assert len(energy.q) == 10


def test_half_samples_give_an_error_that_covers() -> None:
    x, _, _, _ = strip(16, 11)
    rng = np.random.default_rng(12)
    x = rng.uniform([-SIDE, -HEIGHT], [SIDE, HEIGHT], (1500, 2))
    u = (x[:, 0] ** 2 - 1) ** 2
    r = bt.committor(bt.PointCloud(x), u, x[:, 0] < -EDGE, x[:, 0] > EDGE, beta=4.0, bootstrap=6)
    again = bt.committor(bt.PointCloud(x), u, x[:, 0] < -EDGE, x[:, 0] > EDGE, beta=4.0, bootstrap=6)
    assert r.rate_error is not None
    assert len(r.replicates) == 6
    assert abs(r.rate - exact(x[:, 0], 4.0)[1]) < 3 * r.rate_error
    np.testing.assert_array_equal(r.replicates, again.replicates)


# --- what samples say --------------------------------------------------------------------------------------------------------------


def gibbs(count: int, beta: float, seed: int) -> Floats:
    rng = np.random.default_rng(seed)
    x = rng.uniform([-SIDE, -HEIGHT], [SIDE, HEIGHT], (40 * count, 2))
    return x[rng.random(len(x)) < np.exp(-beta * (x[:, 0] ** 2 - 1) ** 2)][:count]


def test_density_of_samples_stands_for_the_potential() -> None:
    beta, edge = 3.0, 0.7
    a, b = (lambda p: p[:, 0] + edge), (lambda p: edge - p[:, 0])
    x = gibbs(4000, beta, 13)
    q, rate = exact(x[:, 0], beta, edge)
    plain = bt.committor(bt.PointCloud(x), None, a, b, beta=beta, sampling="gibbs")
    assert plain.rate == pytest.approx(rate, rel=0.15)
    assert np.sqrt(np.mean((plain.q - q) ** 2)) < 0.03
    # the same of uniform samples with weights, and of hotter samples reweighted by their energies
    y = np.random.default_rng(14).uniform([-SIDE, -HEIGHT], [SIDE, HEIGHT], (4000, 2))
    weight = np.exp(-beta * (y[:, 0] ** 2 - 1) ** 2)
    for found in (
        bt.committor(bt.PointCloud(y), None, a, b, beta=beta, sampling="weighted", weights=weight),
        bt.committor(bt.PointCloud(y, weights=weight), None, a, b, beta=beta, sampling="weighted"),
    ):
        assert found.rate == pytest.approx(rate, rel=0.15)
    z = np.concatenate([x[:2000], gibbs(2000, 1.0, 15)])
    betas = np.repeat([beta, 1.0], 2000)
    mixed = bt.committor(bt.PointCloud(z), (z[:, 0] ** 2 - 1) ** 2, a, b, beta=beta, sampling="mixed", sample_beta=betas)
    assert mixed.rate == pytest.approx(rate, rel=0.15)
    assert "reweighted" in mixed.assumption


def test_reweighting_of_one_temperature_is_the_boltzmann_factor() -> None:
    energy = np.array([0.0, 0.5, 2.0, 1.0])
    weights = bt.reweight(energy, np.full(4, 1.0), 3.0)
    np.testing.assert_allclose(weights, np.exp(-2 * energy) / np.exp(-2 * energy).sum(), rtol=1e-12)


def test_thinning_carries_masses() -> None:
    """600 of 12,000 points: Z is summed over all of them."""
    x = torus(12_000, 25)
    a, b = ends(x)
    full = bt.committor(bt.PointCloud(x), wells(x), a, b, beta=1.0)
    thin = bt.committor(bt.PointCloud(x), wells(x), a, b, beta=1.0, max_points=600)
    middle = np.abs(full.q - 0.5) < 0.2
    density = [np.median((r.reactive_density / (r.q * r.q_backward))[middle] / np.exp(-r.potential[middle])) for r in (full, thin)]
    assert density[1] == pytest.approx(density[0], rel=2e-3)  # 7e-3 without
    assert thin.rate == pytest.approx(full.rate, rel=0.03)


def test_thinning_keeps_the_answer() -> None:
    x = torus(6000, 16)
    a, b = ends(x)
    full = bt.committor(bt.PointCloud(x), wells(x), a, b, beta=1.0)
    thin = bt.committor(bt.PointCloud(x), wells(x), a, b, beta=1.0, max_points=2500)
    assert thin.q.shape == full.q.shape
    assert (thin.q[a] == 0).all()
    assert (thin.q[b] == 1).all()
    assert np.sqrt(np.mean((thin.q - full.q) ** 2)) < 5e-3
    assert thin.rate == pytest.approx(full.rate, rel=0.03)


# --- peer --------------------------------------------------------------------------------------------------------------------------


def test_strong_form_agrees() -> None:
    x, u, a, b = strip(24, 17)
    weak = bt.committor(bt.PointCloud(x), u, a, b, beta=4.0)
    strong = bt.committor(bt.PointCloud(x), u, a, b, beta=4.0, method="strong")
    assert np.sqrt(np.mean((weak.q - strong.q) ** 2)) < 0.02  # one-sided fits at the rim are of lower order
    assert strong.rate == pytest.approx(weak.rate, rel=0.03)
    assert strong.method == "strong"


def test_linear_elements_are_those_of_scipy() -> None:
    """U = 0 on a mesh: the same matrix and right-hand side, solved by SciPy; no refinement and rims on vertices."""
    mesh = bt.shapes.grid(17, 9, width=2.0)
    x = mesh.vertices[:, 0]
    a, b = (x <= 0) & (mesh.vertices[:, 1] < 0.6), x >= 2
    r = bt.committor(mesh, np.zeros(len(x)), a, b, beta=1.0, refine=0)
    stiffness = sparse.csr_array(bt.operators(mesh).stiffness)
    free = np.flatnonzero(~(a | b))
    q = b.astype(float)
    q[free] = linalg.spsolve(sparse.csc_array(stiffness[free][:, free]), -(stiffness[free] @ q))
    assert np.abs(r.q - q).max() < 1e-10
    assert r.rate == pytest.approx(q @ (stiffness @ q) / 2.0, rel=1e-10)


def test_weights_are_those_of_the_local_mesh() -> None:
    x = torus(400, 18)
    ops = bt.operators(bt.PointCloud(x))
    u = wells(x) - wells(x).min()
    levels = np.ones(len(x)), np.ones(len(x))
    mesh = weighted.elements(ops, u, None, levels)
    straight = weighted.harmonic_mean(u[mesh.first], u[mesh.second], np.zeros(len(mesh.first)))
    mine = weighted.laplacian(len(x), mesh.first, mesh.second, mesh.edge_conduction * straight)
    theirs = ops.weighted_stiffness(u)  # type: ignore[attr-defined]
    assert abs(mine - theirs).max() < 1e-12 * abs(theirs).max()
    np.testing.assert_allclose(mesh.mass, ops.mass, rtol=1e-12)


def test_harmonic_mean_of_a_quadratic() -> None:
    rng = np.random.default_rng(19)
    one, other, bow = rng.uniform(0, 30, 50), rng.uniform(0, 30, 50), rng.uniform(-2, 2, 50)
    s = (np.arange(200_000) + 0.5) / 200_000
    wanted = [1 / np.mean(np.exp(a + (b - a) * s + 4 * s * (1 - s) * c)) for a, b, c in zip(one, other, bow, strict=True)]
    np.testing.assert_allclose(weighted.harmonic_mean(one, other, bow), wanted, rtol=1e-3)  # six nodes


# --- fault -------------------------------------------------------------------------------------------------------------------------


def test_refusals_say_what_and_where() -> None:
    x, u, a, b = strip(8, 20)
    n = len(x)
    cloud = bt.PointCloud(x)
    none = np.zeros(n, bool)
    broken, steep = u.copy(), u.copy()
    broken[7], steep[11] = np.nan, 1e6
    island = np.concatenate([x, x[:30] * 0.1 + 50])
    for error, words, arguments in (
        (bt.InputError, "A is empty", (cloud, u, none, b)),
        (bt.InputError, "B is empty", (cloud, u, a, [])),
        (bt.InputError, "A is empty", (cloud, u, lambda p: p[:, 0] + 99, b)),
        (bt.InputError, "overlap", (cloud, u, a | b, b)),
        (bt.InputError, r"potential\[7\] is nan", (cloud, broken, a, b)),
        (bt.InputError, "shape", (cloud, u[:-1], a, b)),
        (bt.InputError, "numbered from 0", (cloud, u, a, [n])),
        (bt.InputError, r"A\.astype\(bool\)", (cloud, u, a.astype(int), b)),
        (bt.NumericalError, "point 11", (cloud, steep, a, b)),
        (bt.InputError, "sampling=", (cloud, None, a, b)),
        (bt.InputError, r"potential\(points\)", (cloud, lambda p: p, a, b)),
    ):
        with pytest.raises(error, match=words):
            bt.committor(*arguments, beta=4.0)  # type: ignore[arg-type]
    extra = np.zeros(30, bool)
    with pytest.raises(bt.TopologyError, match=rf"{n}, {n + 1}"):
        bt.committor(bt.PointCloud(island), np.concatenate([u, np.zeros(30)]), np.r_[a, extra], np.r_[b, extra], beta=4.0)
    with pytest.raises(bt.TopologyError, match="different pieces"):
        bt.committor(bt.PointCloud(island), np.concatenate([u, np.zeros(30)]), np.r_[a | b, extra], np.r_[none, ~extra], beta=4.0)
    for beta in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(bt.InputError, match="beta"):
            bt.committor(cloud, u, a, b, beta=beta)
    for options in (
        {"method": "other"}, {"sampling": "other"}, {"sampling": "gibbs"}, {"sampling": "weighted"}, {"sampling": "mixed"},
        {"weights": u}, {"refine": -1}, {"refine": 1, "method": "strong"}, {"bootstrap": -1}, {"circulation": u}, {"max_points": 1},
        {"block": n, "bootstrap": 3},
    ):  # fmt: skip
        with pytest.raises(bt.InputError):
            bt.committor(cloud, u, a, b, beta=4.0, **options)  # type: ignore[arg-type]
    mesh = bt.shapes.grid(9, 9)
    left, right = mesh.vertices[:, 0] <= 0, mesh.vertices[:, 0] >= 1
    for options in ({"method": "strong"}, {"bootstrap": 3}, {"max_points": 20}):
        with pytest.raises(bt.InputError):
            bt.committor(mesh, np.zeros(81), left, right, beta=1.0, **options)  # type: ignore[arg-type]


def test_a_well_that_nothing_leaves_in_double_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    """exp(-200) of its conduction leads out of the third well; q in it was refused as lost."""
    x, _, a, b = strip(16, 21)
    u = 200.0 * (1 - np.exp(-8 * (x[:, 0] ** 2 + x[:, 1] ** 2)))
    r, back = (bt.committor(bt.PointCloud(x), u, *sets, beta=1.0) for sets in ((a, b), (b, a)))
    inside = u < 100
    assert np.ptp(r.q[inside]) < 1e-12
    assert r.q[inside][0] == pytest.approx(0.5, abs=0.02)
    assert r.q + back.q == pytest.approx(1.0, abs=1e-10)
    monkeypatch.setattr(solve, "WELLS", 0)
    with pytest.raises(bt.NumericalError, match="barriers around the well at point"):
        bt.committor(bt.PointCloud(x), u, a, b, beta=1.0)


@pytest.mark.parametrize("beta", [10.0, 20.0, 40.0, 60.0])
def test_two_wells_on_the_way(beta):
    """Against the integral of exp(β U): from barriers of some 15 kT on it was refused."""
    mesh = bt.shapes.grid(321, 7)
    plane = mesh.vertices[:, :2]
    plane = (plane - plane.min(0)) / np.ptp(plane, axis=0) * [3.0, 0.1]
    x = plane[:, 0]
    r = bt.committor(bt.TriangleMesh(plane, mesh.faces), np.sin(np.pi * x) ** 2, x < 0.02, x > 2.98, beta=beta)
    t = np.linspace(0.02, 2.98, 200_001)
    heights = np.exp(beta * (np.sin(np.pi * t) ** 2 - 1))
    below = np.concatenate([[0], np.cumsum((heights[1:] + heights[:-1]) / 2)])
    assert r.q == pytest.approx(np.interp(x, t, below / below[-1]), abs=1e-6)
    weights = np.exp(-beta * np.sin(np.pi * np.linspace(0, 3, 300_001)) ** 2)
    exact = np.exp(-beta) / (beta * weights.sum() * 1e-5 * below[-1] * (t[1] - t[0]))
    assert r.rate == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize("beta", [30.0, 100.0, 300.0])
def test_wells_of_all_depths_on_the_way(beta):
    mesh = bt.shapes.grid(601, 4)
    plane = mesh.vertices[:, :2]
    plane = (plane - plane.min(0)) / np.ptp(plane, axis=0) * [3.0, 0.02]
    rng = np.random.default_rng(7)
    waves, phases, heights = rng.uniform(2, 12, 4), rng.uniform(0, 6, 4), rng.normal(size=4)
    x, t = plane[:, 0], np.linspace(0.045, 2.955, 400_001)
    u, along = ((heights[:, None] * np.sin(np.multiply.outer(waves, at) + phases[:, None])).sum(0) for at in (x, t))
    u, along = beta * u / np.ptp(u), beta * along / np.ptp(u)
    r = bt.committor(bt.TriangleMesh(plane, mesh.faces), u, x < 0.0499, x > 2.9501, beta=1.0)
    weights = np.exp(along - along.max())
    below = np.concatenate([[0], np.cumsum((weights[1:] + weights[:-1]) / 2)])
    assert r.q == pytest.approx(np.interp(x, t, below / below[-1]), abs=1e-5)


def test_progress_and_cancelling() -> None:
    x, u, a, b = strip(16, 22)
    shares: list[float] = []
    bt.committor(bt.PointCloud(x), u, a, b, beta=4.0, bootstrap=2, progress=shares.append)
    assert shares[-1] == 1.0
    assert all(0 <= share <= 1 for share in shares)
    with pytest.raises(bt.Cancelled):
        bt.committor(bt.PointCloud(x), u, a, b, beta=4.0, progress=lambda share: False)


def test_inputs_are_left_alone_and_results_are_written(tmp_path: Path) -> None:
    x, u, a, b = strip(12, 23)
    copies = x.copy(), u.copy(), a.copy(), b.copy()
    r = bt.committor(bt.PointCloud(x), u, a, b, beta=4.0)
    for before, after in zip(copies, (x, u, a, b), strict=True):
        np.testing.assert_array_equal(before, after)
    with np.load(r.save(tmp_path / "r.npz")) as saved:
        np.testing.assert_array_equal(saved["q"], r.q)
        assert float(saved["rate"]) == r.rate
    rows = np.genfromtxt(r.save(tmp_path / "r.csv"), delimiter=",", names=True)
    np.testing.assert_array_equal(rows["q"], r.q)
    assert r.save(tmp_path / "r.png").stat().st_size > 1000
    with pytest.raises(bt.InputError, match=r"\.npz"):
        r.save(tmp_path / "r.xyz")
    with pytest.raises(bt.FileError):
        r.save(tmp_path / "r.csv" / "r.npz")


@pytest.mark.parametrize("beta", [5.0, 20.0, 40.0, 100.0])
def test_passage_times_over_high_barriers(beta):
    """Against T(-1) = β ∫_-1^1 exp(β U(y)) ∫_-end^y exp(-β U) dy: solved for at once, they lost all digits from a barrier of 25 kT on."""
    mesh = bt.shapes.grid(321, 9)
    plane = mesh.vertices[:, :2]
    vertices = (plane - plane.min(0)) / np.ptp(plane, axis=0) * [3.2, 0.1] - [1.6, 0.0]
    r = bt.committor(
        bt.TriangleMesh(vertices, mesh.faces), lambda x: (x[:, 0] ** 2 - 1) ** 2, lambda x: x[:, 0] + 1, lambda x: 1 - x[:, 0], beta=beta
    )
    t = np.linspace(-1.6, 1.6, 400_001)
    weights = np.exp(-beta * (t * t - 1) ** 2)
    below = np.concatenate([[0], np.cumsum((weights[1:] + weights[:-1]) / 2)]) * (t[1] - t[0])
    between = np.abs(t) <= 1
    time = beta * np.trapezoid((np.exp(beta * ((t * t - 1) ** 2 - 1)) * below)[between], t[between]) * np.exp(beta)
    at = np.argmin(np.abs(vertices[:, 0] + 1))
    assert r.passage_time_to_B[at] == pytest.approx(time, rel=1e-6)
    there, back = r.mean_first_passage_times
    assert there == pytest.approx(back, rel=1e-12)
    assert r.rate_constant == pytest.approx(r.rate_constant_backward, rel=1e-9)


def test_passage_times_that_are_lost_are_refused():
    """A third well beside the way, from which nothing leads on in double precision; 'add a positive multiple of the mass', it said."""
    mesh = bt.shapes.grid(201, 5)
    x = mesh.vertices[:, 0] / np.ptp(mesh.vertices[:, 0])
    x = x - x.min()
    potential = np.sin(3.5 * np.pi * x) ** 2  # minima at 0, 2/7, 4/7, 6/7
    r = bt.committor(mesh, potential, x < 1 / 7, x > 1 / 7, beta=45.0)
    with pytest.raises(bt.NumericalError, match="barriers on the way to A are too high for double precision"):
        _ = r.passage_time_to_A


@pytest.mark.parametrize("beta", [1e-307, 1e-300, 1e-160])
@pytest.mark.parametrize("method", ["weak", "strong"])
@pytest.mark.filterwarnings("error")
def test_rates_at_the_end_of_double_precision(beta, method):
    """Squares of rates of 1e300 overflowed."""
    points = torus(600, 0)
    a, b = [int(np.argmin(points[:, 0]))], [int(np.argmax(points[:, 0]))]
    one, tiny = (bt.committor(bt.PointCloud(points), np.zeros(600), a, b, beta=value, method=method) for value in (1.0, beta))
    assert tiny.rate * beta == pytest.approx(one.rate, rel=1e-12)
    assert tiny.rate_flux_error * beta == pytest.approx(one.rate_flux_error, rel=1e-9)
    for line, other in zip(tiny.streamlines(3), one.streamlines(3), strict=True):
        assert line == pytest.approx(other, abs=1e-6)


def test_a_set_that_is_next_to_never_left_last():
    """1 - share_A is 0 in double precision: that divided by zero."""
    mesh = bt.shapes.torus(rows=20, columns=15)
    x = mesh.vertices[:, 0]
    r = bt.committor(mesh, x, [int(x.argmin())], [int(x.argmax())], beta=20.0)
    assert r.share_A == 1
    times = r.mean_first_passage_times
    assert r.rate_constant_backward == pytest.approx(1 / times[1], rel=0.05)


@pytest.mark.parametrize("cloud", [False, True])
def test_turned_grids_have_the_same_committor(cloud):
    """Where the rim of a set runs through nodes, and where neighbours are equally far, rounding decided: q was .005 off."""
    mesh = bt.shapes.torus(rows=30, columns=18)
    x = np.array(mesh.vertices)
    potential = x[:, 0] + x[:, 1] ** 2
    order = np.argsort(x[:, 0] + 0.1 * x[:, 1])
    a, b = order[:3], order[-3:]
    rng = np.random.default_rng(5)
    found = []
    for turn in [np.eye(3)] + [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(4)]:
        shape = bt.PointCloud(x @ turn, dimension=2) if cloud else bt.TriangleMesh(x @ turn, mesh.faces)
        found.append(bt.committor(shape, potential, a, b, beta=2.0))
    for other in found[1:]:
        assert other.q == pytest.approx(found[0].q, abs=1e-8)
        assert other.rate == pytest.approx(found[0].rate, rel=1e-8)


@pytest.mark.filterwarnings("error")
def test_sets_that_touch():
    """Rims half-way between them left no room (a rate of 1e9); and the free energy of no points at all was not a number."""
    x = np.random.default_rng(0).uniform([-1, -0.5], [1, 0.5], (2000, 2))
    left = x[:, 0] + 0.1 * x[:, 1] < 0
    r = bt.committor(bt.PointCloud(x), np.zeros(len(x)), left, ~left, beta=1.0)
    assert 1 < r.rate < 100  # some 1 / spacing, length 1 and area 2
    assert "transition" in r.verdict
    assert not np.isnan(r.free_energy().free_energy).any()
    r = bt.committor(bt.PointCloud(x), np.zeros(len(x)), left, ~left, beta=1.0, refine=0)
    assert np.isposinf(r.free_energy().free_energy).all()
