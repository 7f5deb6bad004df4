"""docs/coming_from.md: what it calls equal to a line of another package is equal. Each test is skipped where its package is missing."""

from __future__ import annotations

from typing import Any

import beltrami as bt
import numpy as np
import pytest

BALL = bt.shapes.ellipsoid(1.0, 0.8, 0.6, level=3)
V = BALL.vertices + 0.03 * np.sin(5 * BALL.vertices[:, [1, 2, 0]])
F = BALL.faces.copy()
MESH = bt.TriangleMesh(V, F)
OPS = bt.operators(MESH)
f = V[:, 0] - OPS.mass @ V[:, 0] / OPS.mass.sum()


def test_trimesh() -> None:
    trimesh = pytest.importorskip("trimesh")
    theirs = trimesh.Trimesh(V, F, process=False)
    assert theirs.area == pytest.approx(MESH.area, rel=1e-12)
    assert theirs.euler_number == MESH.euler_characteristic
    assert theirs.is_watertight == MESH.is_closed
    pytest.importorskip("rtree", reason="what trimesh searches with")
    queries = np.random.default_rng(0).normal(size=(50, 3))
    assert bt.closest_points(MESH, queries).distances == pytest.approx(trimesh.proximity.closest_point(theirs, queries)[1], abs=1e-12)
    origins = np.zeros((5, 3))
    hits, rays, _ = theirs.ray.intersects_location(origins, queries[:5])
    directions = queries[:5] / np.linalg.norm(queries[:5], axis=1, keepdims=True)
    assert bt.intersect_rays(MESH, origins, directions).distances[rays] == pytest.approx(np.linalg.norm(hits, axis=1), rel=1e-9)


def test_open3d() -> None:
    o3d = pytest.importorskip("open3d")
    back = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(MESH.vertices.copy()), o3d.utility.Vector3iVector(MESH.faces.copy()))
    assert np.array_equal(bt.load(back).vertices, V)  # type: ignore[union-attr]


def test_lapy() -> None:
    lapy = pytest.importorskip("lapy")
    from lapy import diffgeo, shapedna

    theirs = lapy.TriaMesh(V, F.astype(int))
    lumped, full = lapy.Solver(theirs, lump=True), lapy.Solver(theirs)
    assert abs(lumped.stiffness - OPS.stiffness).max() < 1e-5  # LaPy's numbers are of single precision
    assert lumped.mass.diagonal() == pytest.approx(OPS.mass, rel=1e-5)
    values = lumped.eigs(10)[0][1:]
    assert bt.eigenpairs(MESH, 10).values[1:] == pytest.approx(values, rel=1e-5)
    assert bt.eigenpairs(OPS.stiffness, 10, mass=full.mass).values[1:] == pytest.approx(full.eigs(10)[0][1:], rel=1e-5)
    ours, u = bt.solve_poisson(MESH, f), lumped.poisson(f)
    assert ours == pytest.approx(u - OPS.mass @ u / OPS.mass.sum(), abs=1e-5 * np.abs(ours).max())
    X = (OPS.gradient @ f).reshape(-1, 3)
    assert diffgeo.compute_gradient(theirs, f) == pytest.approx(X, abs=1e-5)
    assert np.ravel(diffgeo.compute_divergence(theirs, X)) == pytest.approx(OPS.mass * (OPS.divergence @ X.ravel()), abs=1e-5)
    found = shapedna.compute_shapedna(theirs, k=6, lump=True)["Eigenvalues"]
    normed = shapedna.normalize_ev(theirs, found, method="surface")
    assert bt.shape_dna(MESH, k=5) == pytest.approx(normed[1:], rel=1e-5)


def test_pyfm() -> None:
    mesh = pytest.importorskip("pyFM.mesh")
    from pyFM import spectral

    p2p_21 = np.random.default_rng(0).permutation(len(V))  # vertex i of the second is vertex p2p_21[i] of the first
    bent = V + np.c_[0.2 * V[:, 1] ** 2, 0 * V[:, :2]]
    target = bt.TriangleMesh(bent[p2p_21], np.argsort(p2p_21)[F])
    theirs = [mesh.TriMesh(shape.vertices, shape.faces).process(k=30, verbose=False) for shape in (MESH, target)]
    C = spectral.mesh_p2p_to_FM(p2p_21, *theirs, dims=20)
    ours = bt.functional_map_of(p2p_21, target, MESH, k=20)
    assert np.abs(ours) == pytest.approx(np.abs(C), abs=1e-6)  # signs of eigenfunctions are each library's own
    assert np.mean(bt.point_map_of(ours, target, MESH) == spectral.mesh_FM_to_p2p(C, *theirs)) > 0.99


def test_pot() -> None:
    ot = pytest.importorskip("ot")
    X, Y = np.random.default_rng(0).normal(size=(2, 200, 3))
    a = np.random.default_rng(1).uniform(size=200)
    a /= a.sum()
    thetas = ot.sliced.get_random_projections(3, 100, seed=0)
    theirs = ot.sliced_wasserstein_distance(X, Y, a, None, projections=thetas)
    assert bt.sliced_wasserstein(X, Y, source_weights=a, directions=thetas.T) == pytest.approx(theirs, rel=1e-12)


def test_libigl() -> None:
    igl = pytest.importorskip("igl")
    assert abs(igl.cotmatrix(V, F) + OPS.stiffness).max() < 1e-12
    for kind, mass in ((igl.MASSMATRIX_TYPE_BARYCENTRIC, OPS.mass), (igl.MASSMATRIX_TYPE_VORONOI, bt.operators(MESH, mass="voronoi").mass)):
        assert igl.massmatrix(V, F, kind).diagonal() == pytest.approx(mass, rel=1e-10)
    theirs: Any = (igl.grad(V, F) @ f).reshape(3, -1).T
    assert (OPS.gradient @ f).reshape(-1, 3) == pytest.approx(theirs, abs=1e-12)


def test_heat_method_and_robust_laplacian() -> None:
    pp3d, robust = pytest.importorskip("potpourri3d"), pytest.importorskip("robust_laplacian")
    theirs = pp3d.MeshHeatMethodDistanceSolver(V, F).compute_distance(3)
    assert np.abs(theirs - bt.HeatMethod(MESH).distance(3)).max() < 0.5 * OPS.spacing
    L, M = robust.mesh_laplacian(V, F)
    tufted = bt.operators(MESH, laplacian="tufted")
    assert abs(L - tufted.stiffness).max() < 1e-5  # it mollifies every mesh a little
    assert M.diagonal() == pytest.approx(tufted.mass, rel=1e-5)
