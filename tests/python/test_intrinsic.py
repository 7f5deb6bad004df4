"""Intrinsic Delaunay triangulations and tufted covers behind ``bt.operators``."""

import os
import pickle
import subprocess
import sys

import beltrami as bt
import numpy as np
import pytest
import scipy.sparse as sparse
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

KINDS = ("intrinsic_delaunay", "tufted")


def cotangent_stiffness(vertices, faces):
    """Plain assembly, any D."""
    n = len(vertices)
    total = sparse.csr_array((n, n))
    for k in range(3):
        p, q, r = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        u, v = vertices[q] - vertices[p], vertices[r] - vertices[p]
        dot, square = (u * v).sum(1), (u * u).sum(1) * (v * v).sum(1)
        half = 0.5 * dot / np.sqrt(square - dot**2)
        for a, b, sign in ((q, r, -1), (r, q, -1), (q, q, 1), (r, r, 1)):
            total += sparse.coo_array((sign * half, (a, b)), (n, n)).tocsr()
    return total


def random_disk(seed, count=200):
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    inner = rng.uniform(-1, 1, (count, 2))
    return np.vstack([np.c_[np.cos(angle), np.sin(angle)], inner[np.linalg.norm(inner, axis=1) < 0.9]])


@pytest.mark.parametrize("stretch", [1.5, 3.0])
def test_in_the_plane_it_is_the_delaunay_triangulation(stretch):
    points = random_disk(1)
    given_faces = Delaunay(points * (stretch, 1.0)).simplices
    exact = cotangent_stiffness(points, Delaunay(points).simplices)
    assert abs(cotangent_stiffness(points, given_faces) - exact).max() > 0.1
    ops = bt.operators(bt.TriangleMesh(points, given_faces), laplacian="intrinsic_delaunay")
    assert abs(ops.stiffness - exact).max() < 1e-10 * abs(exact).max()  # some tens of flips, each good to rounding
    assert any("flipped" in note for note in ops.notes)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mass", ["lumped", "voronoi"])
def test_gradient_and_divergence_are_adjoint(kind, mass):
    rng = np.random.default_rng(0)
    mesh = bt.shapes.ellipsoid(1.0, 0.6, 0.1, frequency=8)
    ops = bt.operators(mesh, laplacian=kind, mass=mass)
    m, n = len(ops.element_areas), len(mesh.vertices)
    f, field = rng.normal(size=n), rng.normal(size=(m, 2))
    slope, source = (ops.gradient @ f).reshape(m, 2), ops.divergence @ field.ravel()
    products = ops.element_areas[:, None] * slope * field
    assert abs(products.sum() + (ops.mass * f * source).sum()) < 1e-12 * abs(products).sum()
    assert abs((ops.mass * source).sum()) < 1e-12 * abs(ops.mass * source).sum()
    assert abs(-ops.mass * (ops.divergence @ slope.ravel()) - ops.stiffness @ f).max() < 1e-10 * abs(ops.stiffness @ f).max()
    np.testing.assert_allclose([ops.mass.sum(), ops.element_areas.sum()], mesh.area, rtol=1e-10)
    assert (ops.mass > 0).all()
    weights = ops.stiffness - sparse.diags_array(ops.stiffness.diagonal())
    assert weights.max() <= 1e-14  # where four vertices lie on a circle the weight is 0 but for rounding


def test_regular_meshes_are_left_alone():
    mesh = bt.shapes.sphere(3)
    plain = bt.operators(mesh, laplacian="cotangent")
    for kind in KINDS:
        ops = bt.operators(mesh, laplacian=kind)
        assert ops.notes == ()
        assert abs(ops.stiffness - plain.stiffness).max() < 1e-13
        np.testing.assert_allclose(ops.mass, plain.mass, rtol=1e-13)
        np.testing.assert_allclose(ops.spacing, plain.spacing, rtol=1e-13)
    one, other = (bt.operators(mesh, laplacian=kind, mass="voronoi").mass for kind in ("cotangent", "tufted"))
    np.testing.assert_allclose(one, other, rtol=1e-12)


def test_the_length_of_a_gradient_is_that_of_the_function():
    """On a flat sheet, whatever its triangles, a linear function has one slope."""
    x, y = np.meshgrid(np.arange(8.0), np.arange(6.0), indexing="ij")
    sheet = bt.shapes.grid(8, 6)
    vertices = np.c_[x.ravel() + 2 * y.ravel(), y.ravel()]
    ops = bt.operators(bt.TriangleMesh(vertices, sheet.faces), laplacian="intrinsic_delaunay")
    slope = (ops.gradient @ (vertices @ [0.3, 0.4])).reshape(-1, 2)
    np.testing.assert_allclose(np.linalg.norm(slope, axis=1), 0.5, rtol=1e-12)


def test_auto_says_what_it_took():
    sphere = bt.shapes.sphere(2)
    assert (bt.operators(sphere).kind, bt.operators(sphere).notes) == ("cotangent", ())
    vertices = sphere.vertices.copy()
    vertices[sphere.faces[5, 0]] = vertices[sphere.faces[5, 1]]
    ops = bt.operators(bt.TriangleMesh(vertices, sphere.faces))
    assert ops.kind == "intrinsic_delaunay"
    assert "auto" in ops.notes[0]
    faces = np.vstack([sphere.faces, sphere.faces[:1]])
    ops = bt.operators(bt.TriangleMesh(vertices, faces))
    assert ops.kind == "tufted"
    faces = np.vstack([sphere.faces, [[4, 4, 9]]])
    ops = bt.operators(bt.TriangleMesh(sphere.vertices, faces))
    assert ops.kind == "intrinsic_delaunay"
    assert any("name a vertex twice" in note for note in ops.notes)
    np.testing.assert_allclose(ops.mass.sum(), sphere.area, rtol=1e-12)


def test_isolated_vertices_have_no_mass_and_empty_rows():
    sphere = bt.shapes.sphere(1)
    mesh = bt.TriangleMesh(np.vstack([sphere.vertices, [[3.0, 3.0, 3.0]]]), sphere.faces)
    for kind in KINDS:
        ops = bt.operators(mesh, laplacian=kind)
        assert ops.mass[-1] == 0
        assert ops.stiffness[[-1]].nnz == ops.divergence[[-1]].nnz == ops.laplacian[[-1]].nnz == 0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("height", [0.0, 1e-14, 1e-10, 1e-6])
def test_slivers_become_finite(kind, height):
    """A cap: one triangle whose corner lies (nearly) on the opposite edge."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, height, 0], [0.5, 1, 0], [0.5, -1, 0]], float)
    mesh = bt.TriangleMesh(vertices, [[0, 1, 2], [0, 2, 3], [2, 1, 3], [1, 0, 4]])
    ops = bt.operators(mesh, laplacian=kind)
    inner = ops.stiffness - sparse.diags_array(ops.stiffness.diagonal())
    assert abs(inner).max() < 10  # flipped away, not 1 / height
    np.testing.assert_allclose(ops.mass.sum(), 1.0, rtol=1e-4)  # lengthened edges add a little area
    smallest = np.linalg.eigvalsh(ops.stiffness.toarray())[:2]
    assert abs(smallest[0]) < 1e-12
    assert smallest[1] > 0.1


@pytest.mark.parametrize(
    ("vertices", "faces", "kind", "error", "word"),
    [
        (np.eye(3), [], "intrinsic_delaunay", bt.InputError, "no triangle"),
        (np.zeros((3, 3)), [[0, 1, 2]], "tufted", bt.InputError, "no extent"),
        (1e200 * np.eye(3), [[0, 1, 2]], "tufted", bt.InputError, "rescale"),
        (np.eye(5, 3), [[0, 1, 2], [0, 1, 3], [0, 1, 4]], "intrinsic_delaunay", bt.TopologyError, "vertex 0 to vertex 1"),
        (np.eye(5, 3), [[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 0], [4, 0, 1]], "intrinsic_delaunay", bt.TopologyError, "one side"),
    ],
)
def test_refusals(vertices, faces, kind, error, word):
    with pytest.raises(error, match=word):
        bt.operators(bt.TriangleMesh(vertices, faces), laplacian=kind)


def test_options_and_progress():
    mesh = bt.shapes.sphere(1)
    with pytest.raises(bt.InputError, match="flavour"):
        bt.operators(mesh, laplacian="tufted", flavour=1)
    shares = []
    bt.operators(mesh, laplacian="tufted", progress=shares.append)
    assert shares[-1] == 1.0


def test_pickles_with_its_triangulation():
    ops = bt.operators(bt.shapes.ellipsoid(1, 0.5, 0.2, frequency=5), laplacian="intrinsic_delaunay")
    again = pickle.loads(pickle.dumps(ops))
    for name in ("stiffness", "gradient", "divergence"):
        assert (getattr(ops, name) != getattr(again, name)).nnz == 0
    assert again.triangulation.flips == ops.triangulation.flips > 0


def test_the_same_bits_for_any_number_of_threads():
    code = (
        "import hashlib, beltrami as bt; m = bt.shapes.ellipsoid(3, 1, .1, frequency=40)\n"
        "for k in ('intrinsic_delaunay', 'tufted'):\n"
        "    o = bt.operators(m, laplacian=k)\n"
        "    data = (o.stiffness.data, o.stiffness.indices, o.mass, o.gradient.data, o.divergence.data)\n"
        "    print(hashlib.sha256(b''.join(x.tobytes() for x in data)).hexdigest(), o.spacing.hex())\n"
    )
    outcomes = {
        subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "BELTRAMI_NUM_THREADS": t}, capture_output=True, text=True, check=True
        ).stdout
        for t in "124"
    }
    assert len(outcomes) == 1


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(*[st.integers(0, 7)] * 3), min_size=1, max_size=20),
    st.lists(st.tuples(*[st.integers(-2, 2)] * 3), min_size=8, max_size=8),
)
def test_soups_on_a_grid_are_finite_or_refused(faces, points):
    """Few places, so that repeated points, lines and doubled faces abound."""
    mesh = bt.TriangleMesh(np.array(points, float), np.array(faces))
    for kind in ("auto", *KINDS):
        try:
            ops = bt.operators(mesh, laplacian=kind)
        except bt.InputError:
            continue
        for values in (ops.stiffness.data, ops.mass, ops.gradient.data, ops.divergence.data):
            assert np.isfinite(values).all()
        assert (ops.stiffness != ops.stiffness.T).nnz == 0
        dense = ops.stiffness.toarray()
        assert np.linalg.eigvalsh(dense).min() >= -1e-9 * max(abs(dense).max(), 1e-300)
        if kind == "tufted":
            assert (dense - np.diag(np.diag(dense))).max() <= 1e-6 * abs(dense).max()  # mollified angles are known to 1e-6


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31), st.floats(1e-3, 1e3))
def test_rigid_motion_scale_and_numbering(seed, scale):
    rng = np.random.default_rng(seed)
    base = bt.shapes.ellipsoid(1.0, 0.5, 0.2, frequency=5)
    vertices = base.vertices * (1 + 0.02 * rng.random(base.vertices.shape))
    turn, order = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.permutation(len(vertices))
    numbers = np.argsort(order)
    faces = numbers[base.faces[rng.permutation(len(base.faces))]]
    for kind in KINDS:
        one = bt.operators(bt.TriangleMesh(vertices, base.faces), laplacian=kind)
        other = bt.operators(bt.TriangleMesh(scale * vertices[order] @ turn + 1.0, faces), laplacian=kind)
        size = abs(one.stiffness).max()
        assert abs(one.stiffness[order][:, order] - other.stiffness).max() < 1e-9 * size
        np.testing.assert_allclose(other.mass, scale**2 * one.mass[order], rtol=1e-8)


def test_against_robust_laplacian():
    """Sharp's own code, on closed, open and non-manifold shapes. His default also lengthens edges; that is switched off."""
    robust_laplacian = pytest.importorskip("robust_laplacian")
    disc = bt.shapes.disc(rings=9)
    book = bt.shapes.grid(9, 9)  # five pages that share a spine
    pages = [book.vertices @ [[np.cos(a), np.sin(a), 0], [0.3, 0, 1], [0, 0, 0]] for a in (0.1, 1.0, 2.2, 3.3, 5.0)]
    vertices, places = np.unique(np.round(np.vstack(pages), 12), axis=0, return_inverse=True)
    leaves = places.ravel()[np.vstack([book.faces + k * len(book.vertices) for k in range(5)])]
    for mesh in (
        bt.shapes.ellipsoid(1.0, 0.6, 0.15, frequency=12),
        bt.shapes.knot(rows=60, columns=40),
        bt.TriangleMesh(disc.vertices * (3.0, 1.0, 1.0) + 0.05 * np.sin(7 * disc.vertices), disc.faces),
        bt.TriangleMesh(vertices, leaves),
    ):
        rough = mesh.vertices * (1 + 0.01 * np.random.default_rng(0).random(mesh.vertices.shape))  # no four on a circle
        mesh = bt.TriangleMesh(rough, mesh.faces)
        theirs, their_mass = robust_laplacian.mesh_laplacian(mesh.vertices, mesh.faces, mollify_factor=0.0)
        ours = bt.operators(mesh, laplacian="tufted")
        assert abs(ours.stiffness - theirs).max() < 1e-9 * abs(ours.stiffness).max()
        np.testing.assert_allclose(ours.mass, their_mass.diagonal(), rtol=1e-8)


def test_boundary_weights_of_the_cover_are_of_one_sign():
    """Where a boundary edge faces an obtuse angle cotangents stay negative; the tufted cover repairs that too."""
    flat = bt.TriangleMesh([[0.0, 0.0], [4.0, 0.0], [2.0, 0.4], [2.0, 3.0]], [[0, 1, 2], [0, 2, 3], [2, 1, 3]])
    values = {kind: bt.operators(flat, laplacian=kind).stiffness.toarray() for kind in KINDS}
    assert values["intrinsic_delaunay"][0, 1] > 0.1
    assert (values["tufted"] - np.diag(np.diag(values["tufted"]))).max() <= 1e-14
