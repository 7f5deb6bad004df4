"""Skeletons: loops, leaves, where nodes lie, what belongs to them, what is written, and what is refused."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import beltrami as bt
import numpy as np
import pytest
from beltrami import _core
from beltrami.__main__ import main
from beltrami.skeleton import _cut
from beltrami.skeleton.complexes import mesh_complex
from scipy.spatial import cKDTree

Points = np.ndarray


def tube(curves: list[Points], radius: float, count: int, rng: np.random.Generator, noise: float = 0.0) -> tuple[Points, cKDTree]:
    """Points uniform on the boundary of all that lies within `radius` of polylines, and a tree of the center lines."""
    pieces = []
    for curve in curves:
        for a, b in itertools.pairwise(curve):
            steps = int(np.linalg.norm(b - a) / (0.05 * radius)) + 2
            pieces.append(a + np.linspace(0, 1, steps)[:, None] * (b - a))
    centers = np.concatenate(pieces)
    tree, found = cKDTree(centers), np.zeros((0, 3))
    while len(found) < count:
        normals = rng.normal(size=(20 * count, 3))
        trial = centers[rng.integers(len(centers), size=20 * count)] + radius * normals / np.linalg.norm(normals, axis=1)[:, None]
        found = np.concatenate([found, trial[tree.query(trial)[0] > radius * (1 - 1e-7)]])
    points = found[:count]
    return points + noise * np.linalg.norm(np.ptp(points, axis=0)) * rng.normal(size=points.shape), tree


def circle(center: tuple[float, float, float], count: int = 120) -> Points:
    t = np.linspace(0, 2 * np.pi, count + 1)
    return np.stack([np.cos(t), np.sin(t), 0 * t], 1) + center


def arms(*ends: tuple[float, float, float]) -> list[Points]:
    return [np.array([(0.0, 0.0, 0.0), end]) for end in ends]


def counted(r: bt.SkeletonResult) -> tuple[int, int, int]:
    """Pieces, loops and leaves, counted from the edges alone."""
    graph = r.to_networkx()
    import networkx

    pieces = networkx.number_connected_components(graph)
    return pieces, graph.number_of_edges() - graph.number_of_nodes() + pieces, sum(degree == 1 for _, degree in graph.degree)


SOLIDS = {
    "ring": ([circle((0, 0, 0))], 1, 0),
    "two rings": ([circle((-1, 0, 0)), circle((1, 0, 0))], 2, 0),
    "Y": (arms((0, -2, 0), (1.5, 1.5, 0), (-1.5, 1.5, 0)), 0, 3),
}


# --- analytic --------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mesh", "loops"),
    [(bt.shapes.torus(1.0, 0.3), 1), (bt.shapes.figure_eight(), 2), (bt.shapes.triple_torus(), 3), (bt.shapes.knot(), 1)],
    ids=["torus", "figure eight", "triple torus", "knot"],
)
def test_loops_of_meshes_are_their_handles(mesh: bt.TriangleMesh, loops: int) -> None:
    r = bt.skeleton(mesh)
    assert (r.cycles, r.leaves) == (loops, 0)
    assert counted(r) == (1, loops, 0)
    minima, saddles, maxima = r.critical
    assert minima - saddles + maxima == mesh.euler_characteristic
    assert len(r.cancelled) == 0


@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_clouds_of_tubes(name: str, noise: float) -> None:
    curves, loops, leaves = SOLIDS[name]
    points, tree = tube(curves, 0.3, 3000, np.random.default_rng(1), noise)
    r = bt.skeleton(bt.PointCloud(points))
    assert counted(r) == (1, loops, leaves)
    assert (r.cycles, r.leaves) == (loops, leaves)
    # a contour of 3,000 points has about 30: its middle is uncertain by some hundredths of the radius, by more with noise
    assert np.median(tree.query(r.nodes)[0]) < (0.12 if noise else 0.06) * 0.3
    assert np.median(np.abs(r.radii / 0.3 - 1)) < 0.15


def test_a_torus_has_its_circle_in_the_middle() -> None:
    r = bt.skeleton(bt.shapes.torus(1.0, 0.3, rows=90, columns=24))
    away = np.hypot(np.hypot(r.nodes[:, 0], r.nodes[:, 1]) - 1.0, r.nodes[:, 2])
    # in a plane across the circle the section is a circle with 24 corners; what is left is the bending of the polyline
    assert away.max() < 0.03 * 0.3
    assert r.radii == pytest.approx(0.3, rel=0.02)
    assert r.lengths.sum() == pytest.approx(2 * np.pi, rel=0.01)
    [line] = r.polylines()
    assert np.array_equal(line[0], line[-1])


def test_a_cylinder_is_a_segment() -> None:
    mesh = bt.shapes.cylinder(0.2, 3.0, closed=True)
    r = bt.skeleton(mesh)
    assert (r.leaves, r.cycles, len(r.limbs)) == (2, 0, 1)
    assert np.hypot(r.nodes[:, 0], r.nodes[:, 1]).max() < 0.02 * 0.2
    ends = np.sort(r.nodes[r.degrees == 1][:, 2])
    assert ends == pytest.approx([-1.3, 1.3], abs=0.1)  # a radius from the lids


def test_parts_a_spacing_apart_are_told_apart_by_normals() -> None:
    """Two parallel tubes joined at one end: the gap is 0.6 of a radius, the points' spacing 0.4."""
    hairpin = [np.array([(-1.3, 0, 0), (-1.3, 6, 0)]), np.array([(-1.3, 0, 0), (1.3, 0, 0)]), np.array([(1.3, 0, 0), (1.3, 6, 0)])]
    points, tree = tube(hairpin, 1.0, 1500, np.random.default_rng(3))
    normals, seam = _core.oriented_normals(points, 8, 13)
    outward = points - tree.data[tree.query(points)[1]]
    assert (np.einsum("nd,nd->n", normals, outward) > 0).mean() > 0.99
    assert seam < 0.005
    r = bt.skeleton(bt.PointCloud(points))
    assert counted(r) == (1, 0, 2)
    assert not any("turn away" in note for note in r.notes)


def test_parts_that_touch_are_said_and_told_apart_by_given_normals() -> None:
    """The same with a gap of 0.2 of a radius, half the spacing: nothing in the points alone says where one tube ends."""
    hairpin = [np.array([(-1.1, 0, 0), (-1.1, 6, 0)]), np.array([(-1.1, 0, 0), (1.1, 0, 0)]), np.array([(1.1, 0, 0), (1.1, 6, 0)])]
    for seed in range(3):
        points, tree = tube(hairpin, 1.0, 1500, np.random.default_rng(seed))
        assert any("turn away" in note for note in bt.skeleton(bt.PointCloud(points)).notes)
        outward = points - tree.data[tree.query(points)[1]]
        outward /= np.linalg.norm(outward, axis=1)[:, None]
        assert counted(bt.skeleton(bt.PointCloud(points, normals=outward))) == (1, 0, 2)


def test_other_functions() -> None:
    mesh = bt.shapes.figure_eight()
    assert bt.skeleton(mesh, function=mesh.vertices[:, 0] + 0.1 * mesh.vertices[:, 1]).cycles == 2
    r = bt.skeleton(mesh, function="geodesic", source=5)
    assert r.cycles == 2
    assert r.function[5] == pytest.approx(0.0, abs=1e-6)
    assert bt.skeleton(mesh, function="geodesic").cycles == 2


def test_legs_that_the_first_eigenfunction_runs_past_are_found() -> None:
    """Spot's legs make no extrema along the axis from head to tail."""
    spot = bt.examples.spot()
    r = bt.skeleton(spot)
    assert (r.leaves, r.cycles) == (5, 0)
    assert any("runs past 3 limbs" in note for note in r.notes)
    feet = np.flatnonzero(spot.vertices[:, 1] < np.quantile(spot.vertices[:, 1], 0.03))
    assert len(np.unique(r.limb_of_point[feet])) == 4
    assert bt.skeleton(spot, function="eigenfunction").leaves == 2
    cloud = bt.skeleton(bt.PointCloud(spot.vertices))
    assert len(np.unique(cloud.limb_of_point[feet])) == 4


def test_corners_of_a_window_are_no_limbs() -> None:
    """Each is 1.5 times as long as the contour that leaves it for both sides is wide."""
    bars = [2.0 * np.array([(i, j, 0), (i + 1, j, 0)]) for i in range(2) for j in range(3)]
    bars += [2.0 * np.array([(i, j, 0), (i, j + 1, 0)]) for i in range(3) for j in range(2)]
    points, _ = tube(bars, 0.25, 8000, np.random.default_rng(0))
    r = bt.skeleton(bt.PointCloud(points))
    assert (r.cycles, r.leaves) == (4, 0)


def test_a_handle_is_not_given_up_for_limbs() -> None:
    """The eccentricity of a fat ring is greatest along its rim: levels along the handle, which a cloud's sampling breaks."""
    for seed in range(2):
        points, _ = tube([circle((0, 0, 0))], 0.55, 4000, np.random.default_rng(seed))
        r = bt.skeleton(bt.PointCloud(points))
        assert (r.cycles, r.leaves) == (1, 0)


def test_the_eccentricity_sees_every_limb_and_needs_some() -> None:
    points, _ = tube(arms((-3, 0, 0), (3, 0, 0), (-1.5, 2.5, 0), (1.5, -2.5, 0), (0, 0, 2)), 0.3, 4000, np.random.default_rng(3))
    r = bt.skeleton(bt.PointCloud(points), function="eccentricity")
    assert (r.leaves, r.cycles) == (5, 0)
    assert r.function.argmin() in np.argsort(np.linalg.norm(points, axis=1))[:400]  # it is least in the middle
    assert bt.skeleton(bt.shapes.figure_eight(), function="eccentricity").cycles == 2
    # of a tetrahedron it is constant
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    solid = bt.TriangleMesh(corners, [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    torus = bt.shapes.torus(1.0, 0.3)
    both = bt.TriangleMesh(np.concatenate([torus.vertices, corners + 9]), np.concatenate([torus.faces, solid.faces + len(torus.vertices)]))
    r = bt.skeleton(both, function="eccentricity")
    assert np.isfinite(r.nodes).all()
    assert any("constant" in note for note in r.notes)


@pytest.mark.parametrize("count", [None, 500, 2000])
def test_the_eccentricity_of_a_sphere_is_constant(count: int | None) -> None:
    """Of the five copies of its second eigenvalue three are among the first six functions: they must not count."""
    if count is None:
        r = bt.skeleton(bt.shapes.sphere(), function="eccentricity")
    else:
        points = np.random.default_rng(1).normal(size=(count, 3))
        r = bt.skeleton(bt.PointCloud(points / np.linalg.norm(points, axis=1)[:, None]), function="eccentricity")
    assert any("eccentricity is constant" in note for note in r.notes)
    assert len(r.eigenvalues) == 6


def test_ties_are_broken_by_number() -> None:
    """A grid's height takes few values: the count of critical vertices is exact all the same."""
    mesh = bt.shapes.torus(1.0, 0.4, rows=24, columns=12)
    r = bt.skeleton(mesh, function=np.round(mesh.vertices[:, 0], 1))
    minima, saddles, maxima = r.critical
    assert minima - saddles + maxima == 0


@pytest.mark.parametrize(
    ("ends", "leaves"),
    [
        ([(-3, 0, 0), (3, 0, 0), (0, 2, 0)], 3),
        ([(-4, 0, 0), (4, 0, 0), (0, -2.5, 0), (0, 2.5, 0)], 4),
        ([(-3, 0, 0), (3, 0, 0), (0, -3, 0), (0, 3, 0), (0, 0, -3), (0, 0, 3)], 6),
    ],
    ids=["T", "cross", "jack"],
)
def test_limbs_where_the_first_eigenfunction_vanishes_are_found(ends: list[tuple[float, float, float]], leaves: int) -> None:
    points, _ = tube(arms(*ends), 0.3, 4000, np.random.default_rng(2))
    r = bt.skeleton(bt.PointCloud(points))
    assert (r.leaves, r.cycles) == (leaves, 0)


def test_edges_run_along_the_middle_where_a_limb_bends() -> None:
    """Spot's spine: what 36 rays from the middle of each edge find."""
    mesh = bt.examples.spot()
    r = bt.skeleton(mesh, function="eigenfunction")
    a, b = r.nodes[r.edges[:, 0]], r.nodes[r.edges[:, 1]]
    length = np.linalg.norm(b - a, axis=1)
    along = (b - a) / length[:, None]
    u = np.cross(along, np.eye(3)[np.abs(along).argmin(1)])
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(along, u)
    turn = np.arange(36) * np.pi / 18
    directions = np.cos(turn)[None, :, None] * u[:, None] + np.sin(turn)[None, :, None] * v[:, None]
    hits = bt.intersect_rays(mesh, np.repeat((a + b) / 2, 36, axis=0), directions.reshape(-1, 3))
    reach = hits.distances.reshape(-1, 36)
    off = np.linalg.norm((reach[:, :, None] * directions).mean(1), axis=1) / reach.mean(1)
    order = np.argsort(off)
    share = np.cumsum(length[order]) / length.sum()
    assert off[order][np.searchsorted(share, 0.9)] < 0.12  # .19 where tangents alone say where the section lies


def test_radii_are_those_of_the_places_where_nodes_came_to_lie() -> None:
    """Spot's spine moves while it settles: what 36 rays from each node find across its neighbours."""
    mesh = bt.examples.spot()
    r = bt.skeleton(mesh, function="eigenfunction")
    inner = np.flatnonzero(r.degrees == 2)
    ends = np.array([[other for edge in r.edges[(r.edges == node).any(1)] for other in edge if other != node] for node in inner])
    along = r.nodes[ends[:, 1]] - r.nodes[ends[:, 0]]
    along /= np.linalg.norm(along, axis=1)[:, None]
    u = np.cross(along, np.eye(3)[np.abs(along).argmin(1)])
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(along, u)
    turn = np.arange(36) * np.pi / 18
    directions = np.cos(turn)[None, :, None] * u[:, None] + np.sin(turn)[None, :, None] * v[:, None]
    hits = bt.intersect_rays(mesh, np.repeat(r.nodes[inner], 36, axis=0), directions.reshape(-1, 3))
    reach = hits.distances.reshape(-1, 36)
    reach = np.minimum(reach, 1.9 * np.median(reach, axis=1)[:, None])  # rays that run into another limb
    off = np.abs(r.radii[inner] / reach.mean(1) - 1)
    assert off.mean() < 0.005  # .039 where radii stay behind; 24 rays instead of 36 make .0012
    assert off.max() < 0.05  # .18; .012


# --- convergence -----------------------------------------------------------------------------------------------------------------------


def test_the_middle_gets_better_with_the_mesh() -> None:
    errors = []
    for columns in (8, 12, 16, 24, 32):
        r = bt.skeleton(bt.shapes.torus(1.0, 0.3, rows=4 * columns, columns=columns))
        assert r.cycles == 1
        errors.append(float(np.median(np.abs(r.radii / 0.3 - 1))))
    slope = np.polyfit(np.log([8, 12, 16, 24, 32]), np.log(errors), 1)[0]
    assert slope < -1.5  # the sections are polygons: second order


# --- properties ------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cloud", [False, True])
def test_rigid_motion_scale_and_numbering_change_nothing(cloud: bool) -> None:
    mesh = bt.shapes.star(5, arm_length=2.0, tube_radius=0.25, resolution=6)
    rng = np.random.default_rng(4)
    order = rng.permutation(len(mesh.vertices))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))

    def shape(scale: float) -> bt.TriangleMesh | bt.PointCloud:
        moved = (scale * mesh.vertices @ turn.T + 3.0 * scale)[order]
        return bt.PointCloud(moved) if cloud else bt.TriangleMesh(moved, np.argsort(order)[mesh.faces])

    plain = bt.skeleton(bt.PointCloud(mesh.vertices) if cloud else mesh)
    assert counted(plain) == (1, 0, 5)
    for scale in (1.0, 1e-6, 1e6):
        r = bt.skeleton(shape(scale))
        assert counted(r) == counted(plain)
        assert np.median(r.radii) / scale == pytest.approx(np.median(plain.radii), rel=0.05)


def test_twice_the_same_bits_on_any_number_of_threads() -> None:
    points, _ = tube(SOLIDS["two rings"][0], 0.3, 2000, np.random.default_rng(5), 0.005)
    threads = bt.num_threads()
    try:
        found = []
        for count in (1, 3):
            bt.set_num_threads(count)
            found.append(bt.skeleton(bt.PointCloud(points)))
    finally:
        bt.set_num_threads(threads)
    for name in ("nodes", "edges", "radii", "node_of_point"):
        assert np.array_equal(getattr(found[0], name), getattr(found[1], name))


def test_points_belong_to_nodes_nearby() -> None:
    mesh = bt.shapes.star(5, arm_length=2.0, tube_radius=0.25, resolution=8)
    before = mesh.vertices.copy()
    r = bt.skeleton(mesh)
    assert np.array_equal(mesh.vertices, before)
    assert r.node_of_point.shape == (len(mesh.vertices),)
    away = np.linalg.norm(mesh.vertices - r.nodes[r.node_of_point], axis=1)
    assert np.quantile(away, 0.9) < 0.25 * 1.6
    tips = mesh.vertices[np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) > 1.5]
    assert len(np.unique(r.limb_of_point[np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) > 1.5])) == 5
    assert len(tips) > 100


def test_a_limb_that_is_short_is_cut_and_counted() -> None:
    curves = arms((-3, 0, 0), (3, 0, 0), (0, 0.55, 0))
    points, _ = tube(curves, 0.3, 4000, np.random.default_rng(6))
    assert bt.skeleton(bt.PointCloud(points)).leaves == 2
    longer, _ = tube(arms((-3, 0, 0), (3, 0, 0), (0, 2.0, 0)), 0.3, 4000, np.random.default_rng(6))
    assert bt.skeleton(bt.PointCloud(longer)).leaves == 3
    cut = bt.skeleton(bt.PointCloud(longer), shortest_limb=0.6)
    assert cut.leaves == 2
    assert len(cut.cut) >= 1


def test_multiple_eigenvalues_are_said() -> None:
    r = bt.skeleton(bt.shapes.torus(1.0, 0.3))
    assert r.eigenvalues[1] < 1.01 * r.eigenvalues[0]
    assert any("eigenvalues" in note for note in r.notes)


def test_pieces_have_a_skeleton_each() -> None:
    torus, star = bt.shapes.torus(1.0, 0.3), bt.shapes.star(3, arm_length=2.0, resolution=8)
    both = bt.TriangleMesh(
        np.concatenate([torus.vertices, star.vertices + 10.0]), np.concatenate([torus.faces, star.faces + len(torus.vertices)])
    )
    r = bt.skeleton(both)
    assert counted(r) == (2, 1, 3)
    assert np.array_equal(r.components[r.node_of_point], np.repeat([0, 1], [len(torus.vertices), len(star.vertices)]))
    with pytest.raises(bt.TopologyError, match="2 connected pieces"):
        bt.skeleton(both, components=False)
    cloud = bt.skeleton(bt.PointCloud(both.vertices))
    assert counted(cloud) == (2, 1, 3)


def test_outliers_are_left_out() -> None:
    points, _ = tube(SOLIDS["Y"][0], 0.3, 3000, np.random.default_rng(7))
    rng = np.random.default_rng(8)
    far = np.concatenate([points, rng.uniform(-3, 3, size=(30, 3))])
    r = bt.skeleton(bt.PointCloud(far), remove_outliers=True)
    assert counted(r) == (1, 0, 3)
    assert r.node_of_point.shape == (3030,)
    assert r.node_of_point.min() >= 0


def test_open_meshes_have_skeletons_too() -> None:
    tube = bt.shapes.cylinder(0.3, 4.0)
    by_height = bt.skeleton(tube, function=tube.vertices[:, 2])  # its levels are circles around the axis, to the last bit
    assert counted(by_height) == (1, 0, 2)
    assert np.abs(by_height.nodes[:, :2]).max() < 1e-9
    assert 1.5 < np.abs(by_height.nodes[:, 2]).max() < 2
    # The eigenfunction is flat at the rims, z = ±2, where rounding decides about the last levels, and smoothing spreads that: two
    # diameters away from them it has died out (.002 of the radius in any position and numbering of the mesh).
    rng = np.random.default_rng(0)
    for _ in range(3):
        turn, order = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.permutation(len(tube.vertices))
        r = bt.skeleton(bt.TriangleMesh((tube.vertices @ turn)[order], np.argsort(order)[tube.faces]))
        assert counted(r) == (1, 0, 2)
        x, y, z = (r.nodes @ turn.T).T
        assert (np.abs(z) < 0.8).sum() > 5
        assert np.hypot(x, y)[np.abs(z) < 0.8].max() < 0.02 * 0.3


# --- peers -----------------------------------------------------------------------------------------------------------------------------


def test_networkx_counts_the_same_loops() -> None:
    networkx = pytest.importorskip("networkx")
    r = bt.skeleton(bt.shapes.figure_eight())
    graph = r.to_networkx()
    assert len(networkx.cycle_basis(graph)) == r.cycles
    assert sum(length for _, _, length in graph.edges(data="length")) == pytest.approx(r.lengths.sum())


def test_sectors_are_weighted_means() -> None:
    rng = np.random.default_rng(11)
    points = rng.normal(size=(300, 3))
    points = points[np.argsort(points[:, 1])]
    place, tangent = 0.2 * rng.normal(size=3), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn = np.arange(24) * np.pi / 12
    offset = points - place
    offset = offset[(np.abs(offset @ tangent[0]) < 0.4) & (np.linalg.norm(offset, axis=1) <= 1.5)]
    x, y = offset @ tangent[1], offset @ tangent[2]
    bump = np.exp(24 * ((np.outer(x, np.cos(turn)) + np.outer(y, np.sin(turn))) / np.hypot(x, y)[:, None] - 1))
    expected = np.where(bump.sum(0) > 0.5, np.hypot(x, y) @ bump / bump.sum(0), -1.0)
    rows = [np.ascontiguousarray(row[None]) for row in (place, *tangent)]
    one = np.ones(1)
    found = _core.sectors(points, np.array([0, 300]), 1, *rows, 1.5 * one, 0.4 * one, np.zeros(1, np.int32), 24)[0]
    assert found == pytest.approx(expected, rel=1e-3)  # points beyond 60 degrees count below exp(-12)
    assert (found > 0).sum() > 12


# --- files and the command line --------------------------------------------------------------------------------------------------------


def test_files(tmp_path: Path) -> None:
    tree = bt.skeleton(bt.shapes.star(3, arm_length=2.0, resolution=8))
    rows = [line.split() for line in tree.save(tmp_path / "a.swc").read_text().splitlines() if not line.startswith("#")]
    assert len(rows) == len(tree.nodes)
    assert sum(row[6] == "-1" for row in rows) == 1
    assert all(int(row[6]) < int(row[0]) for row in rows)  # parents come first
    read = np.array([[float(cell) for cell in row[2:6]] for row in rows])
    assert np.array_equal(np.sort(read[:, 0]), np.sort(tree.nodes[:, 0]))
    lines = tree.save(tmp_path / "a.obj").read_text().splitlines()
    assert sum(line.startswith("v ") for line in lines) == len(tree.nodes)
    assert sum(line.startswith("l ") for line in lines) == len(tree.limbs)
    with np.load(tree.save(tmp_path / "a.npz")) as archive:
        assert np.array_equal(archive["edges"], tree.edges)
    assert tree.save(tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    ring = bt.skeleton(bt.shapes.torus(1.0, 0.3))
    with pytest.raises(bt.TopologyError, match="1 cycles"):
        ring.save(tmp_path / "b.swc")
    with pytest.raises(bt.InputError, match=r"\.swc, \.obj"):
        ring.save(tmp_path / "b.stl")
    with pytest.raises(bt.FileError, match="cannot be written"):
        ring.save(tmp_path / "a.obj" / "b.obj")


def test_contours_lie_on_the_surface() -> None:
    r = bt.skeleton(bt.shapes.torus(1.0, 0.3, rows=60, columns=24))
    for contour in r.contours:
        if len(contour):
            away = np.abs(np.hypot(np.hypot(contour[:, 0], contour[:, 1]) - 1, contour[:, 2]) - 0.3)
            assert away.max() < 0.01


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bt.save(bt.shapes.figure_eight(), tmp_path / "eight.ply")
    outs = [arg for name in ("a.obj", "a.npz", "a.png") for arg in ("-o", str(tmp_path / name))]
    assert main(["skeleton", str(tmp_path / "eight.ply"), "--size", "200x150", *outs]) == 0
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["cycles", "2"] in printed
    assert all((tmp_path / name).is_file() for name in ("a.obj", "a.npz", "a.png"))
    assert main(["skeleton", str(tmp_path / "eight.ply"), "-o", str(tmp_path / "a.swc")]) == 2
    assert main(["skeleton", str(tmp_path / "eight.ply"), "-o", str(tmp_path / "a.txt")]) == 2


# --- faults ----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"function": np.zeros(2400)}, "constant"),
        ({"function": np.full(2400, np.nan)}, "nan"),
        ({"function": np.zeros(3)}, "shape"),
        ({"function": "heigth"}, "choose 'eigenfunction', 'eccentricity'"),
        ({"source": 3}, "geodesic"),
        ({"function": "geodesic", "source": 2400}, "source"),
        ({"shortest_limb": -1.0}, "shortest_limb"),
        ({"shortest_limb": np.nan}, "shortest_limb"),
    ],
)
def test_bad_arguments(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(bt.InputError, match=message):
        bt.skeleton(bt.shapes.torus(1.0, 0.4), **arguments)  # type: ignore[arg-type]


def test_bad_shapes() -> None:
    with pytest.raises(bt.InputError, match="too few"):
        bt.skeleton(bt.PointCloud(np.random.default_rng(0).normal(size=(5, 3))))
    with pytest.raises(bt.InputError, match="too few"):
        bt.skeleton(bt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    with pytest.raises(bt.InputError, match="dimension"):
        bt.skeleton(bt.PointCloud(np.random.default_rng(0).normal(size=(50, 3)), dimension=1))
    with pytest.raises(bt.InputError, match="TriangleMesh"):
        bt.skeleton(np.zeros((50, 3)))  # type: ignore[arg-type]
    with pytest.raises(bt.Error):
        bt.skeleton(bt.PointCloud(np.zeros((50, 3))))
    with pytest.raises(bt.Error):
        bt.skeleton(bt.PointCloud(np.stack([np.arange(50.0), np.zeros(50), np.zeros(50)], 1)))
    with pytest.raises(bt.InputError):
        bt.skeleton(bt.TriangleMesh(np.random.default_rng(0).normal(size=(20, 3)), np.zeros((0, 3), int)))


def test_copies_of_points_do_no_harm() -> None:
    points, _ = tube(SOLIDS["ring"][0], 0.3, 1500, np.random.default_rng(9))
    r = bt.skeleton(bt.PointCloud(np.concatenate([points, points[:200]])))
    assert r.cycles == 1
    assert np.array_equal(r.node_of_point[1500:], r.node_of_point[:200])


def test_numbers_handed_in_stay_what_they_are() -> None:
    points, _ = tube(SOLIDS["ring"][0], 0.3, 1500, np.random.default_rng(9))
    points = np.concatenate([points, points[:2], [[9.0, 9.0, 9.0]]])  # two copies and a stray
    height = points[:, 0].copy()
    height[-3:] = 99.0
    r = bt.skeleton(bt.PointCloud(points), function=height, remove_outliers=True)
    assert np.array_equal(r.function, height)
    assert not np.shares_memory(r.function, height)
    assert height.flags.writeable
    assert not r.function.flags.writeable
    filled = bt.skeleton(bt.PointCloud(points), remove_outliers=True).function  # an eigenfunction is continued to points left out
    assert np.array_equal(filled[1500:1502], filled[:2])
    assert np.isfinite(filled).all()


def test_a_tip_without_a_vertex_hides_no_limb() -> None:
    mesh = bt.shapes.star(5, arm_length=2.0)
    simple = _cut(mesh_complex(bt.operators(mesh)), np.linalg.norm(mesh.vertices, axis=1), 0.04, None).simple
    last = len(mesh.vertices) - 1  # on a limb, and what -1 would be as an index
    seen = simple.beyond(cast(Any, SimpleNamespace(tips=lambda: [(0, 0, last)])), 1.0)
    assert simple.beyond(cast(Any, SimpleNamespace(tips=lambda: [(0, 0, -1)])), 1.0) == 5 == seen + 1


def test_stops_on_request() -> None:
    points, _ = tube(SOLIDS["ring"][0], 0.3, 20000, np.random.default_rng(10))
    with pytest.raises(bt.Cancelled):
        bt.skeleton(bt.PointCloud(points), progress=lambda share: False)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("name", ["ring", "two rings"])
def test_twenty_seeds_with_noise(name: str, seed: int) -> None:
    curves, loops, leaves = SOLIDS[name]
    points, _ = tube(curves, 0.3, 6000, np.random.default_rng(seed), 0.01)
    assert counted(bt.skeleton(bt.PointCloud(points))) == (1, loops, leaves)


@pytest.mark.parametrize("below", [-0.1, 0.0])
def test_an_open_scan_of_a_ring_is_a_ring(below: float) -> None:
    """Its contours are arcs on both sides, far from each other: no halves of one ring."""
    points, _ = tube(SOLIDS["ring"][0], 0.3, 5000, np.random.default_rng(2), 0.0)
    r = bt.skeleton(bt.PointCloud(points[points[:, 2] > below]))
    assert (r.cycles, r.leaves) == (1, 0)


@pytest.mark.parametrize("scale", [1e-300, 1e300])
def test_functions_of_any_scale(scale: float) -> None:
    mesh = bt.shapes.torus(1.0, 0.4)
    r = bt.skeleton(mesh, function=scale * mesh.vertices[:, 0])
    assert (r.cycles, r.leaves) == (1, 0)
    assert np.abs(r.nodes - bt.skeleton(mesh, function=mesh.vertices[:, 0]).nodes).max() < 1e-6


def test_a_loop_of_one_level_is_a_loop() -> None:
    """In R^4 both saddles of the flat torus lie within a level of each other."""
    mesh = bt.shapes.flat_torus()
    for shape in (mesh, bt.TriangleMesh(mesh.vertices[:, [2, 3, 0, 1]], mesh.faces)):
        r = bt.skeleton(shape)
        assert (r.cycles, r.leaves) == (1, 0)
        assert counted(r) == (1, 1, 0)


def test_a_function_of_noise_ends_and_says_so() -> None:
    mesh = bt.shapes.torus(1.0, 0.4)
    r = bt.skeleton(mesh, function=np.random.default_rng(0).normal(size=len(mesh.vertices)))
    minima, saddles, maxima = r.critical
    assert minima - saddles + maxima == 0
    assert len(r.cut) > 100
    assert r.cycles == 1 or any("too many" in note for note in r.notes)


@pytest.mark.parametrize("shape", [bt.shapes.torus(1.0, 0.3), bt.shapes.figure_eight()], ids=["torus", "figure eight"])
def test_rings_within_each_other_are_the_sides_of_a_hole_on_clouds_too(shape):
    # cut by height, a torus that lies flat shows two circles of one middle
    up = shape.vertices[:, 2]
    assert bt.skeleton(bt.PointCloud(shape.vertices), function=up).cycles == bt.skeleton(shape, function=up).cycles > 0
