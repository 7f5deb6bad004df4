"""Dynamic optimal transport, mean-field games, barycenters: closed forms, certificates recomputed here, symmetries, peers, faults."""

from __future__ import annotations

from typing import Any

import beltrami as bt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

SPHERE = bt.shapes.sphere(2)


def unit(mesh: Any, density: Any) -> Any:
    return density / (bt.operators(mesh).mass @ density)


def pair(mesh: Any = SPHERE, a: Any = (0.0, 0.3, 1.0), b: Any = (1.0, -0.2, 0.0), sharp: float = 3.0) -> tuple[Any, Any]:
    """Two smooth densities, everywhere positive."""
    p = mesh.vertices - mesh.vertices.mean(0)
    p = p / np.linalg.norm(p, axis=1).max()
    return tuple(unit(mesh, np.exp(sharp * (p[:, : len(c)] @ np.array(c))) + 0.1) for c in (a, b))  # type: ignore[return-value]


def rearrangement(f0: Any, f1: Any, low: float, high: float) -> float:
    """W2² on a line: ∫ (Q0 - Q1)² dq with the quantile functions of two densities."""
    x, q = np.linspace(low, high, 100_001), (np.arange(100_000) + 0.5) / 100_000
    found = []
    for f in (f0, f1):
        mass = np.r_[0, np.cumsum((f(x)[1:] + f(x)[:-1]) / 2)]
        found.append(np.interp(q, mass / mass[-1], x))
    return float(np.mean((found[0] - found[1]) ** 2))


def judge(mesh: Any, r: Any, density0: Any, density1: Any | None = None, weight: Any = 1.0) -> float:
    """Continuity, mass, sign and ends, recomputed from the vertices alone; returns the kinetic cost."""
    p = mesh.vertices[mesh.faces]
    edge, up = p[:, [2, 0, 1]] - p[:, [1, 2, 0]], p - p[:, [1, 2, 0]]
    height = up - edge * ((up * edge).sum(2) / (edge * edge).sum(2))[..., None]
    hats = height / (height * height).sum(2)[..., None]
    areas = 0.5 * np.sqrt((edge[:, 0] ** 2).sum(1) * (height[:, 0] ** 2).sum(1))
    count = len(mesh.vertices)
    mass = np.bincount(mesh.faces.ravel(), np.repeat(areas / 3, 3), count)
    n = len(r.momentum)
    assert r.density.shape == (n + 1, count)
    assert r.momentum.shape == (n, len(mesh.faces), mesh.dimension)
    assert (r.density >= 0).all()
    np.testing.assert_array_equal(r.density[0], density0)
    if density1 is not None:
        np.testing.assert_array_equal(r.density[-1], density1)
    np.testing.assert_allclose(r.density @ mass, mass @ density0, rtol=1e-12)
    change = n * np.diff(r.density, axis=0)
    size = np.sqrt((mass * change**2).sum(1).mean()) + np.sqrt((mass * r.density**2).sum(1).mean())
    for k in range(n):
        flux = np.einsum("tid,td->ti", hats, r.momentum[k]) * areas[:, None]
        residual = change[k] - np.bincount(mesh.faces.ravel(), flux.ravel(), count) / mass
        assert np.sqrt((mass * residual**2).sum()) <= 1e-12 * size * np.sqrt(n)
    rho = r.density[:, mesh.faces].mean(2)
    rho = (rho[1:] + rho[:-1]) / 2
    square = (r.momentum**2).sum(2)
    assert not ((rho == 0) & (square > 0)).any()
    return float((areas * weight * square / (2 * np.where(rho > 0, rho, 1))).sum() / n)


def proved(mesh: Any, r: Any, density0: Any, density1: Any) -> float:
    """The bound that the potential proves, from the operators alone; it must satisfy the inequality already, up to rounding."""
    ops, n = bt.operators(mesh), len(r.potential)
    squares = ((ops.gradient @ r.potential.T).reshape(len(mesh.faces), mesh.dimension, n) ** 2).sum(1) * ops.element_areas[:, None] / 3
    h = np.stack([np.bincount(mesh.faces.ravel(), np.repeat(s, 3), len(ops.mass)) / ops.mass for s in squares.T]) / 2
    excess = n * np.diff(r.potential, axis=0) + 0.5 * (h[1:] + h[:-1])
    assert excess.max(initial=-np.inf) <= 1e-9 * n * max(np.ptp(r.potential), 1e-300)
    first, last = r.potential[0] + h[0] / (2 * n), r.potential[-1] - h[-1] / (2 * n)
    return float(ops.mass @ (last * density1 - first * density0))


# --- analytic ----------------------------------------------------------------------------------------------------------------------


def test_zonal_densities_on_the_sphere() -> None:
    """They move along meridians: the monotone rearrangement of the polar angle θ, with f(cos θ) sin θ the mass at θ."""
    mesh = bt.shapes.sphere(3)
    axis = np.array([1, 2, -1]) / np.sqrt(6)
    z = mesh.vertices @ axis
    f0, f1 = (lambda z: np.exp(2 * z) + 0.1), (lambda z: np.exp(-4 * (z + 0.4) ** 2) + 0.1)
    a, b = unit(mesh, f0(z)), unit(mesh, f1(z))
    exact = rearrangement(lambda t: f0(np.cos(t)) * np.sin(t), lambda t: f1(np.cos(t)) * np.sin(t), 0, np.pi)
    r = bt.transport(mesh, a, b, intervals=16)
    assert r.converged
    cost = judge(mesh, r, a, b)
    assert r.cost == pytest.approx(cost, rel=1e-12)
    assert r.distance == pytest.approx(np.sqrt(2 * cost), rel=1e-12)
    assert r.distance**2 == pytest.approx(exact, rel=0.007)  # the mesh's error at 642 vertices
    bound = proved(mesh, r, a, b)
    assert r.lower_bound <= bound * (1 + 1e-9)
    assert r.lower_bound <= r.cost
    assert r.gap == pytest.approx((r.cost - r.lower_bound) / r.cost, rel=1e-6, abs=1e-12)
    assert r.gap <= 1e-3
    assert r.continuity_residual <= 1e-12


def test_shift_of_a_compact_bump_on_a_flat_torus_in_four_dimensions() -> None:
    """W2 is the shift while every pair stays within half a period. ρ = 0 outside of the bump."""
    mesh = bt.shapes.flat_torus(rows=24, columns=24)
    u = np.arctan2(mesh.vertices[:, [1, 3]], mesh.vertices[:, [0, 2]]) / (2 * np.pi)

    def bump(centre: Any) -> Any:
        d = u - centre
        return unit(mesh, np.maximum(1 - (np.linalg.norm(d - np.round(d), axis=1) / 0.2) ** 2, 0) ** 2)

    a, b = bump(np.array([0.0, 0.25])), bump(np.array([1 / 6, 0.25]))
    assert (a == 0).any()
    r = bt.transport(mesh, a, b, intervals=16, tolerance=5e-3)
    assert r.converged
    judge(mesh, r, a, b)
    assert r.distance == pytest.approx(2 * np.pi / 6, rel=0.02)  # 5 cells across the bump's radius


def test_equal_densities_cost_nothing_and_do_not_move() -> None:
    a, _ = pair()
    r = bt.transport(SPHERE, a, a, intervals=4)
    assert r.cost == r.distance == r.gap == 0
    assert r.converged
    assert not r.momentum.any()
    np.testing.assert_array_equal(r.density, np.repeat(a[None], 5, axis=0))


def test_one_triangle_is_a_problem_of_two_unknowns_an_interval() -> None:
    """div M on one triangle is invertible: M follows from the densities, and with one interval nothing is left to choose."""
    mesh = bt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]], [[0, 1, 2]])
    a, b = np.array([1.0, 2, 3]), np.array([3.0, 2, 1])
    r = bt.transport(mesh, a, b, intervals=1)
    # change c = b - a, mass 1/6 each: A h_i . M = c_i / 6, so M = (c_1, c_2) / 3 with A = 1/2, h_1 = e_x, h_2 = e_y
    np.testing.assert_allclose(r.momentum[0, 0], np.array([0, -2, 0]) / 3, atol=1e-12)
    assert r.cost == pytest.approx(0.5 * (4 / 9) / (2 * 2), rel=1e-12)


# --- convergence -------------------------------------------------------------------------------------------------------------------


def test_error_falls_with_refinement_in_space_and_time() -> None:
    exact = rearrangement(lambda x: 1 + 1.5 * (x - 0.5), lambda x: 1 - 1.0 * (x - 0.5), 0, 1)
    errors, sizes = [], [9, 13, 19, 27]
    for n in sizes:
        mesh = bt.shapes.grid(n, n)
        x = mesh.vertices[:, 0]
        a, b = unit(mesh, 1 + 1.5 * (x - 0.5)), unit(mesh, 1 - 1.0 * (x - 0.5))
        errors.append(abs(bt.transport(mesh, a, b, intervals=n - 1, tolerance=1e-5).distance ** 2 / exact - 1))
    slope = np.polyfit(np.log(np.array(sizes) - 1), np.log(errors), 1)[0]
    assert errors[-1] < 0.005, errors
    assert slope < -0.8, (slope, errors)  # first order at the boundary, where lumping shifts half cells


def test_the_certified_gap_reaches_small_tolerances() -> None:
    a, b = pair()
    r = bt.transport(SPHERE, a, b, intervals=8, tolerance=1e-6)
    assert r.converged
    assert r.gap <= 1e-6
    assert (np.diff(r.history["objective"]) <= 0).all()
    assert (np.diff(r.history["lower_bound"]) >= 0).all()


# --- properties --------------------------------------------------------------------------------------------------------------------


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([1e-6, 1e-2, 30.0, 1e6]), st.sampled_from([1e-5, 1.0, 1e4]))
def test_scale_motion_and_numbering_change_nothing(seed: int, scale: float, amount: float) -> None:
    rng = np.random.default_rng(seed)
    mesh = bt.shapes.sphere(1)
    a, b = pair(mesh)
    plain = bt.transport(mesh, a, b, intervals=4, tolerance=1e-5)
    turn, order = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.permutation(len(a))
    place = np.argsort(order)
    moved = bt.TriangleMesh((scale * mesh.vertices @ turn.T + scale)[order], place[mesh.faces][rng.permutation(len(mesh.faces))])
    other = bt.transport(moved, amount * a[order], amount * b[order], intervals=4, tolerance=1e-5)
    assert other.cost == pytest.approx(amount * scale**4 * plain.cost, rel=1e-4)
    np.testing.assert_allclose(other.density[2][place] / amount, plain.density[2], rtol=0.05, atol=0.02 * a.max())


def test_swapping_the_ends_reverses_the_path() -> None:
    a, b = pair()
    there, back = (bt.transport(SPHERE, *ends, intervals=6, tolerance=1e-6) for ends in ((a, b), (b, a)))
    assert there.cost == pytest.approx(back.cost, rel=1e-6)
    np.testing.assert_allclose(there.density, back.density[::-1], atol=1e-3 * a.max())


def test_triangle_inequality() -> None:
    a, b = pair()
    c = unit(SPHERE, np.exp(3 * SPHERE.vertices[:, 1]) + 0.1)
    distance = {
        name: bt.transport(SPHERE, *ends, intervals=6).distance for name, ends in {"ab": (a, b), "bc": (b, c), "ac": (a, c)}.items()
    }
    assert distance["ac"] <= distance["ab"] + distance["bc"]


def test_the_same_bits_on_any_number_of_threads_and_inputs_unchanged() -> None:
    a, b = pair()
    copies, before, found = (a.copy(), b.copy()), bt.num_threads(), []
    try:
        for threads in (1, 3):
            bt.set_num_threads(threads)
            found.append(bt.transport(SPHERE, a, b, intervals=5))
    finally:
        bt.set_num_threads(before)
    np.testing.assert_array_equal(found[0].density, found[1].density)
    np.testing.assert_array_equal(found[0].momentum, found[1].momentum)
    np.testing.assert_array_equal(found[0].potential, found[1].potential)
    np.testing.assert_array_equal(a, copies[0])
    np.testing.assert_array_equal(b, copies[1])


def test_little_memory_gives_the_same_path() -> None:
    a, b = pair()
    rich, poor = (bt.transport(SPHERE, a, b, intervals=8, memory=memory) for memory in (None, 0))
    judge(SPHERE, poor, a, b)
    assert poor.iterations == rich.iterations
    np.testing.assert_allclose(poor.density, rich.density, atol=1e-8 * a.max())


def test_pieces_move_by_themselves() -> None:
    a, b = pair()
    two = bt.TriangleMesh(np.r_[SPHERE.vertices, SPHERE.vertices + 9], np.r_[SPHERE.faces, SPHERE.faces + len(a)])
    r = bt.transport(two, np.r_[a, b], np.r_[b, b], intervals=6, tolerance=1e-5)
    judge(two, r, np.r_[a, b], np.r_[b, b])
    alone = bt.transport(SPHERE, a, b, intervals=6, tolerance=1e-5)
    assert r.cost == pytest.approx(alone.cost, rel=1e-4)
    assert np.linalg.norm(r.momentum[:, len(SPHERE.faces) :]) < 0.02 * np.linalg.norm(r.momentum)


def test_a_vertex_of_no_triangle_does_no_harm() -> None:
    a, b = pair()
    loose = bt.TriangleMesh(np.r_[SPHERE.vertices, [[5.0, 5, 5]]], SPHERE.faces)
    r = bt.transport(loose, np.r_[a, 0.0], np.r_[b, 0.0], intervals=4)
    assert r.converged
    assert np.isfinite(r.density).all()
    assert np.isfinite(r.potential).all()
    assert r.cost == pytest.approx(bt.transport(SPHERE, a, b, intervals=4).cost, rel=1e-3)


def test_clouds_and_boundaries() -> None:
    grid = bt.shapes.grid(13, 13)
    x = grid.vertices[:, 0]
    a, b = unit(grid, 1 + 0.8 * x), unit(grid, 1.8 - 0.8 * x)
    on_mesh = bt.transport(grid, a, b, intervals=6)
    judge(grid, on_mesh, a, b)
    points = bt.shapes.sphere(3).vertices
    cloud = bt.PointCloud(points)
    ends = [np.exp(points[:, k]) for k in (0, 2)]
    r = bt.transport(cloud, *ends, intervals=6, normalize=True)
    same = bt.transport(bt.shapes.sphere(3), *ends, intervals=6, normalize=True)
    assert r.converged
    assert r.distance == pytest.approx(same.distance, rel=0.02)
    assert r.momentum.shape[1] == len(r.corners)


# --- peers -------------------------------------------------------------------------------------------------------------------------


def test_linear_programme() -> None:
    """Optimal transport of vertex masses for squared great-circle distances (POT): itself a few tenths of a per cent off."""
    ot = pytest.importorskip("ot", reason="the exact linear programme needs POT")
    mesh = bt.shapes.sphere(3)
    a, b = pair(mesh)
    mass = bt.operators(mesh).mass
    angle = np.arccos(np.clip(mesh.vertices @ mesh.vertices.T, -1, 1))
    exact = ot.emd2(a * mass / (a @ mass), b * mass / (b @ mass), angle**2, numItermax=10_000_000)
    assert bt.transport(mesh, a, b, intervals=16).distance ** 2 == pytest.approx(exact, rel=0.007)


GAMES: dict[str, dict[str, Any]] = {
    "transport": {"density1": pair()[1]},
    "speed to the power 1.5": {"density1": pair()[1], "lagrangian": bt.costs.power(1.5)},
    "congestion": {"density1": pair()[1], "running_cost": bt.costs.congestion(20.0)},
    "entropy and terminal divergence": {"running_cost": bt.costs.entropy(0.3), "terminal_cost": bt.costs.kullback_leibler(pair()[1], 3.0)},
    "terminal square": {"terminal_cost": bt.costs.quadratic(pair()[1], 20.0)},
    "walls": {"density1": pair()[1], "lagrangian": bt.costs.kinetic(np.where(SPHERE.vertices[SPHERE.faces].mean(1)[:, 1] > 0.3, 5.0, 1.0))},
}


@pytest.mark.parametrize("name", GAMES)
def test_both_iterations_agree_within_their_gaps(name: str) -> None:
    a, _ = pair()
    found = [
        bt.mean_field_game(SPHERE, a, intervals=6, tolerance=1e-4, method=method, **GAMES[name])  # type: ignore[arg-type]
        for method in ("primal_dual", "projected_gradient")
    ]
    for r in found:
        assert r.converged, r
        judge(SPHERE, r, a, GAMES[name].get("density1"))
        assert r.objective == pytest.approx(r.kinetic + r.running + r.terminal, rel=1e-12)
        assert (np.diff(r.history["objective"]) <= 0).all()
    assert max(r.lower_bound for r in found) <= min(r.objective for r in found) * (1 + 1e-12)


def test_projected_gradient_where_the_path_thins_out() -> None:
    """The ends are bounded away from zero, the path is not: densities went below any bound and the gap stayed at 1 %."""
    mesh = bt.shapes.figure_eight(resolution=6)
    p = mesh.vertices / np.sqrt(mesh.area)
    a, b = unit(mesh, np.exp(2 * p[:, 0])), unit(mesh, np.exp(-2 * p[:, 1]))
    r = bt.transport(mesh, a, b, intervals=8, method="projected_gradient")
    assert r.converged, r
    judge(mesh, r, a, b)


# --- games -------------------------------------------------------------------------------------------------------------------------


def test_nothing_moves_where_every_cost_is_least() -> None:
    a, _ = pair()
    for make in (bt.costs.quadratic, bt.costs.kullback_leibler):
        r = bt.mean_field_game(SPHERE, a, intervals=4, running_cost=make(a, 5.0), terminal_cost=make(a, 5.0))
        np.testing.assert_allclose(r.density, np.repeat(a[None], 5, axis=0), rtol=1e-12)
        assert r.converged
        assert abs(r.objective) < 1e-12
        assert r.exploitability < 1e-6


def test_a_dear_end_tends_to_the_transport() -> None:
    a, b = pair()
    limit = bt.transport(SPHERE, a, b, intervals=6).cost
    done = [bt.mean_field_game(SPHERE, a, intervals=6, terminal_cost=bt.costs.quadratic(b, weight)) for weight in (10.0, 100.0, 1000.0)]
    values = [r.objective for r in done]
    assert all(r.converged for r in done)
    assert values[0] < values[1] < values[2] < limit * 1.001
    assert values[2] == pytest.approx(limit, rel=0.03)
    miss = [np.abs(r.density[-1] - b).max() for r in done]
    assert miss[0] > miss[1] > miss[2]


def test_the_potential_is_the_gradient_of_the_terminal_cost() -> None:
    """Where there is mass at the end, -φ(1) = F_T'(ρ(1)) up to a constant, and φ(1) is φ of the last interval less its Hamiltonian."""
    a, b = pair()
    r = bt.mean_field_game(SPHERE, a, intervals=6, terminal_cost=bt.costs.quadratic(b, 30.0), tolerance=1e-6)
    ops = bt.operators(SPHERE)
    square = ((ops.gradient @ r.potential[-1]).reshape(-1, 3) ** 2).sum(1) * ops.element_areas / 3
    h = np.bincount(SPHERE.faces.ravel(), np.repeat(square, 3), len(a)) / ops.mass / 2
    end = r.potential[-1] - h / 12
    pull = -30.0 * (r.density[-1] - b)
    spread = np.ptp(end)
    np.testing.assert_allclose(end - end.mean(), pull - pull.mean(), atol=0.02 * spread)


def test_caps_with_a_number_at_each_vertex() -> None:
    """They were compared with None as a whole, which no array allows; and behind walls where nobody may be no path was finite."""
    a, b = pair(sharp=1.5)
    cap = np.where(SPHERE.vertices[:, 1] > 0.5, 1.02, 10.0) * max(a.max(), b.max())
    r = bt.mean_field_game(SPHERE, a, b, intervals=6, running_cost=bt.costs.density_cap(cap))
    assert r.converged
    judge(SPHERE, r, a, b)
    assert (r.density <= cap * (1 + 1e-12)).all()
    grid = bt.shapes.grid(17, 17)
    x, y = grid.vertices[:, 0], grid.vertices[:, 1]
    wall = (np.abs(x - 0.5) < 0.1) & (y < 0.7)
    start, end = (unit(grid, np.where(wall, 0.0, np.exp(-30 * ((x - c) ** 2 + (y - 0.3) ** 2)) + 0.01)) for c in (0.2, 0.8))
    round_it = bt.mean_field_game(grid, start, end, intervals=6, running_cost=bt.costs.density_cap(np.where(wall, 0.0, 50.0)))
    judge(grid, round_it, start, end)
    assert round_it.gap < 0.03
    assert round_it.density[:, wall].max() < 1e-8 * round_it.density.max()
    assert round_it.kinetic > 1.2 * bt.transport(grid, start, end, intervals=6).cost


def test_progress_ends_at_one() -> None:
    a, b = pair()
    seen: list[float] = []
    assert bt.transport(SPHERE, a, b, intervals=4, progress=seen.append).converged
    assert seen[-1] == 1.0
    assert (np.diff(seen) >= 0).all()


def test_a_capped_end_is_certified() -> None:
    """The bound was that of an end without a cap: zero, for nothing has to move."""
    a, _ = pair()
    r = bt.mean_field_game(SPHERE, a, intervals=6, terminal_cost=bt.costs.density_cap(0.6 * a.max()))
    judge(SPHERE, r, a)
    assert r.converged
    assert 0 < r.lower_bound <= r.objective
    assert r.density[-1].max() <= 0.6 * a.max() * (1 + 1e-12)


def test_caps_potentials_and_custom_costs() -> None:
    a, b = pair(sharp=1.5)
    low = bt.mean_field_game(SPHERE, a, b, intervals=6, tolerance=1e-4)
    cap = 1.02 * max(a.max(), b.max())
    capped = bt.mean_field_game(SPHERE, a, b, intervals=6, running_cost=bt.costs.density_cap(cap), tolerance=2e-3)
    judge(SPHERE, capped, a, b)
    assert capped.density.max() <= cap * (1 + 1e-12)
    assert capped.objective >= low.lower_bound
    north = SPHERE.vertices[:, 2]
    dear = bt.mean_field_game(SPHERE, a, b, intervals=6, running_cost=bt.costs.potential(3 * north))
    assert dear.density[3] @ (north > 0) < low.density[3] @ (north > 0)
    custom = bt.costs.custom(lambda p: p**2 / 2 * 5, lambda p: 5 * p)
    one, two = (
        bt.mean_field_game(SPHERE, a, b, intervals=4, running_cost=cost, tolerance=1e-5) for cost in (custom, bt.costs.congestion(5.0))
    )
    assert one.objective == pytest.approx(two.objective, rel=1e-4)


def test_a_wall_with_a_door() -> None:
    grid = bt.shapes.grid(13, 13)
    middle = grid.vertices[grid.faces].mean(1)
    wall = (np.abs(middle[:, 0] - 0.5) < 0.09) & (middle[:, 1] < 0.66)
    a, b = (unit(grid, np.exp(-20 * ((grid.vertices[:, :2] - c) ** 2).sum(1)) + 0.02) for c in ((0.2, 0.4), (0.8, 0.4)))
    flow = []
    for weight in (np.where(wall, 100.0, 1.0), np.ones(len(wall))):
        r = bt.mean_field_game(grid, a, b, intervals=6, lagrangian=bt.costs.kinetic(weight), tolerance=5e-3)
        assert r.converged
        assert r.kinetic == pytest.approx(judge(grid, r, a, b, weight), rel=1e-9)
        flow.append(np.abs(r.momentum[:, wall, 0]).mean())
    assert flow[0] < 0.1 * flow[1]


@pytest.mark.parametrize(("contrast", "power", "tolerance"), [(1e6, 2.0, 5e-2), (1e-6, 2.0, 1e-2), (1e4, 1.5, 1e-2)])
def test_weights_of_any_contrast(contrast: float, power: float, tolerance: float) -> None:
    """Weights are part of the projection's metric: without that a wall a million times dearer stays at a gap of .43."""
    grid = bt.shapes.grid(17, 17)
    middle = grid.vertices[grid.faces].mean(1)
    wall = (np.abs(middle[:, 0] - 0.5) < 0.07) & (np.abs(middle[:, 1] - 0.7) > 0.15)
    a, b = (unit(grid, np.exp(-20 * ((grid.vertices[:, :2] - c) ** 2).sum(1)) + 0.02) for c in ((0.2, 0.4), (0.8, 0.4)))
    weight = np.where(wall, contrast, 1.0)
    r = bt.mean_field_game(grid, a, b, intervals=8, lagrangian=bt.costs.power(power, weight), tolerance=tolerance, max_iterations=400)
    assert r.converged, r
    moving = judge(grid, r, a, b, weight)
    assert power != 2 or r.lower_bound <= moving * (1 + 1e-12)


def test_mass_that_vanishes_outside_bumps_converges_too() -> None:
    """A metric that follows the mass: few iterations for what took 200 in the plain one."""
    ball = bt.shapes.sphere(3)
    away = np.arccos(np.clip(ball.vertices @ np.array([[0.75, -0.6, 0.3], [0.75, 0.6, -0.1]]).T / [1.0062, 0.9657], -1, 1))
    a, b = (unit(ball, np.maximum(1 - (angle / 0.6) ** 2, 0.0) ** 2) for angle in away.T)
    r = bt.transport(ball, a, b, intervals=16, tolerance=1e-3, max_iterations=60)
    assert r.converged, r
    assert judge(ball, r, a, b) == pytest.approx(r.cost, rel=1e-9)


COSTS = {
    "quadratic": bt.costs.quadratic(np.array([0.3, 1.0, -0.5]), 2.0),
    "divergence": bt.costs.kullback_leibler(np.array([0.3, 1.0, 2.5]), 0.7),
    "entropy": bt.costs.entropy(1.3),
    "congestion": bt.costs.congestion(2.0, 3.0),
    "sum": bt.costs.congestion(1.0) + bt.costs.potential([1.0, -1.0, 0.5]) + 0.5 * bt.costs.entropy(1.0),
    "capped": bt.costs.congestion(1.0) + bt.costs.density_cap(0.8),
    "custom": bt.costs.custom(lambda p: np.cosh(p) - 1, np.sinh),
}


@pytest.mark.parametrize("name", COSTS)
@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-5, 5), min_size=3, max_size=3), st.floats(0.01, 50))
def test_proximal_points_and_conjugates(name: str, numbers: list[float], step: float) -> None:
    """No other density is better, on a fine grid; and Fenchel's inequality holds with equality at the maximizer."""
    cost, v = COSTS[name], np.array(numbers)
    grid = np.linspace(0, 8, 4001)[:, None] * np.ones(3)
    if cost.upper is not None:
        grid = np.minimum(grid, cost.upper)
    p = cost.prox(v, step)
    assert (p >= 0).all()
    assert cost.upper is None or (p <= cost.upper + 1e-12).all()
    values = step * cost.value(grid) + 0.5 * (grid - v) ** 2
    assert (step * cost.value(p) + 0.5 * (p - v) ** 2 <= values.min(0) + 1e-9 * (1 + np.abs(values.min(0)))).all()
    assert (cost.conjugate(v) >= (v * grid - cost.value(grid)).max(0) - 1e-9).all()


# --- barycenters -------------------------------------------------------------------------------------------------------------------


def test_the_barycenter_of_two_is_on_the_geodesic_between_them() -> None:
    a, b = pair(sharp=1.5)
    r = bt.wasserstein_barycenter(SPHERE, [a, b], weights=[3, 1], intervals=8)
    whole = bt.transport(SPHERE, a, b, intervals=16, tolerance=1e-5)
    assert r.converged
    assert r.lower_bound <= r.cost
    assert r.cost == pytest.approx(0.75 * 0.25 * whole.cost, rel=0.01)  # Σ w_i (1 - w_i)² W2² / 2 with other time steps
    assert bt.operators(SPHERE).mass @ np.abs(r.density - whole.interpolate(0.25)) < 0.02
    np.testing.assert_allclose(r.distances, np.array([0.25, 0.75]) * whole.distance, rtol=0.02)


def test_the_barycenter_of_three_is_symmetric() -> None:
    ends = [unit(SPHERE, np.exp(2 * SPHERE.vertices @ axis)) for axis in np.eye(3)]
    r = bt.wasserstein_barycenter(SPHERE, ends, intervals=4)
    assert r.converged
    np.testing.assert_allclose(r.distances, r.distances.mean(), rtol=0.01)
    assert SPHERE.vertices[r.density.argmax()].min() > 0.4
    assert bt.operators(SPHERE).mass @ r.density == pytest.approx(1, rel=1e-12)
    same = bt.wasserstein_barycenter(SPHERE, [ends[0], ends[0]])
    assert same.cost == 0
    np.testing.assert_array_equal(same.density, ends[0])


# --- what is handed out ------------------------------------------------------------------------------------------------------------


def test_velocity_interpolation_paths_and_files(tmp_path: Any) -> None:
    a, b = pair()
    r = bt.transport(SPHERE, a, b, intervals=5)
    assert r.velocity.shape == r.momentum.shape
    assert r.intervals == 5
    np.testing.assert_allclose(r.interpolate(0.5), (r.density[2] + r.density[3]) / 2)
    np.testing.assert_array_equal(r.interpolate(1.0), b)
    tracks = r.particle_paths([0, 3, 9], substeps=2)
    assert tracks.shape == (11, 3, 3)
    assert bt.closest_points(SPHERE, tracks.reshape(-1, 3)).distances.max() < 1e-12
    assert r.particle_paths(np.zeros((0, 3))).shape == (21, 0, 3)
    with np.load(r.save(tmp_path / "flow.npz")) as kept:
        np.testing.assert_array_equal(kept["density"], r.density)
        assert float(kept["cost"]) == r.cost
    assert bt.load(r.save(tmp_path / "flow.ply")).data["density_5"].shape == (len(a),)
    assert r.save(tmp_path / "flow.png").stat().st_size > 1000
    page = r.save(tmp_path / "flow.html").read_text(encoding="utf-8")
    assert "<input" in page
    assert not any(f'{name}="http' in page for name in ("src", "href"))  # needs no network
    with pytest.raises(bt.InputError, match="npz"):
        r.save(tmp_path / "flow.txt")
    with pytest.raises(bt.InputError, match="from 0 to 1"):
        r.interpolate(1.5)


def test_particles_follow_the_mass() -> None:
    """Mass that moves from the south to the north carries its particles along."""
    mesh = bt.shapes.sphere(3)
    z = mesh.vertices[:, 2]
    r = bt.transport(mesh, unit(mesh, np.exp(-4 * z)), unit(mesh, np.exp(4 * z)), intervals=8)
    ring = np.flatnonzero(np.abs(z) < 0.3)[:20]
    tracks = r.particle_paths(ring)
    assert (tracks[-1, :, 2] > tracks[0, :, 2] + 0.3).all()


def test_not_converged_is_a_result_that_says_so() -> None:
    a, b = pair()
    r = bt.transport(SPHERE, a, b, intervals=8, max_iterations=2)
    assert not r.converged
    assert "NOT CONVERGED" in repr(r)
    assert r.gap > 1e-3
    judge(SPHERE, r, a, b)
    assert r.lower_bound <= proved(SPHERE, r, a, b) * (1 + 1e-9)
    assert r.lower_bound <= bt.transport(SPHERE, a, b, intervals=8, tolerance=1e-5).cost <= r.cost


# --- faults ------------------------------------------------------------------------------------------------------------------------


def test_bad_input_is_refused_with_what_to_do() -> None:
    a, b = pair()
    bad: list[tuple[str, dict[str, Any]]] = [
        (r"density0\[\d+\] is -", {"density0": a - a.max()}),
        (r"density1\[4\] is nan", {"density1": np.where(np.arange(len(a)) == 4, np.nan, b)}),
        ("161 values, the shape has 162", {"density0": a[:-1]}),
        (r"difference of 1 %.*normalize", {"density1": 1.01 * b}),
        ("has the mass 0", {"density0": 0 * a}),
        ("intervals is 0", {"intervals": 0}),
        ("intervals is 2.5", {"intervals": 2.5}),
        ("tolerance is 0", {"tolerance": 0}),
        ("max_iterations is 0", {"max_iterations": 0}),
        ("method is 'newton'", {"method": "newton"}),
        ("memory is -1", {"memory": -1}),
    ]
    for message, change in bad:
        options: dict[str, Any] = {"density0": a, "density1": b, "intervals": 4, **change}
        with pytest.raises(bt.InputError, match=message):
            bt.transport(SPHERE, options.pop("density0"), options.pop("density1"), **options)
    two = bt.TriangleMesh(np.r_[SPHERE.vertices, SPHERE.vertices + 9], np.r_[SPHERE.faces, SPHERE.faces + len(a)])
    with pytest.raises(bt.InputError, match=r"component \d .* mass cannot leave a component"):
        bt.transport(two, np.r_[a, 2 * b], np.r_[2 * b, a])
    with pytest.raises(bt.InputError, match="no triangles"):
        bt.transport(bt.TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), int)), [], [])
    with pytest.raises(bt.Cancelled):
        bt.transport(SPHERE, a, b, progress=lambda share: False)


def test_games_refuse_what_does_not_fit() -> None:
    a, b = pair()
    costs = bt.costs
    bad: list[tuple[str, dict[str, Any]]] = [
        ("make one with bt.costs", {"running_cost": 3.0}),
        ("target has 3 values", {"terminal_cost": costs.quadratic([1.0, 2, 3])}),
        ("either fixed or free", {"density1": b, "terminal_cost": costs.quadratic(b)}),
        ("weight has 2 numbers", {"lagrangian": costs.kinetic([1.0, 2.0])}),
        ("lagrangian is a float", {"lagrangian": 2.0}),
        ("room for a mass", {"running_cost": costs.density_cap(1e-3)}),
        ("above the cap", {"running_cost": costs.density_cap(0.9 * a.max())}),
        ("came back as", {"running_cost": costs.custom(lambda p: "x", lambda p: p)}),
        ("not finite", {"running_cost": costs.custom(lambda p: p * np.nan, lambda p: p)}),
        ("not finite", {"terminal_cost": costs.custom(lambda p: p, lambda p: p * np.inf)}),
        ("not convex", {"running_cost": costs.custom(lambda p: -(p**2), lambda p: -2 * p)}),
    ]
    for message, options in bad:
        with pytest.raises(bt.InputError, match=message):
            bt.mean_field_game(SPHERE, a, intervals=4, **options)
    for call, message in (
        (lambda: costs.power(1.0), "exponent is 1"),
        (lambda: costs.power(3.0), "from 1.05 to 2"),
        (lambda: costs.kinetic(0.0), "above 0"),
        (lambda: costs.kinetic([1.0, -1.0]), r"weight\[1\] is -1"),
        (lambda: costs.kullback_leibler([1.0, 0.0]), r"target\[1\] is 0"),
        (lambda: costs.density_cap([1.0, -1.0]), r"limit\[1\] is -1"),
        (lambda: costs.custom(1, 2), "callable"),  # type: ignore[arg-type]
        (lambda: -1.0 * costs.entropy(), "factor"),
        (lambda: bt.wasserstein_barycenter(SPHERE, []), "empty"),
        (lambda: bt.wasserstein_barycenter(SPHERE, [a, b], weights=[1, 0]), r"weights\[1\] is 0"),
    ):
        with pytest.raises(bt.InputError, match=message):
            call()


def test_the_number_of_times_is_an_integer_of_any_width() -> None:
    a, b = np.ones(len(SPHERE.vertices)), 1.5 + SPHERE.vertices[:, 2]
    r = bt.transport(SPHERE, a, b, normalize=True, intervals=2, max_iterations=2)
    look = {"size": (40, 30), "samples": 1}
    assert r.plot(times=np.int64(2), **look).description == r.plot(times=2, **look).description  # type: ignore[arg-type]
    with pytest.raises(bt.InputError, match=r"times is 2\.5; a whole number"):
        r.plot(times=2.5)  # type: ignore[arg-type]
