"""Mesh operators: closed forms, identities that hold exactly, invariance, convergence, refusals."""

from __future__ import annotations

import pickle

import beltrami as bt
import numpy as np
import pytest
import scipy.sparse as sparse
from hypothesis import given, settings
from hypothesis import strategies as st

MAKERS = {
    "sphere": lambda: bt.shapes.sphere(2),
    "torus": lambda: bt.shapes.torus(rows=14, columns=9),
    "flat torus in R^4": lambda: bt.shapes.flat_torus(rows=12, columns=10),
    "disc": lambda: bt.shapes.disc(rings=5),
}


def bumpy(seed: int, dimension: int = 3) -> bt.TriangleMesh:
    """A sheet with jittered vertices, so that no symmetry hides an error."""
    rng = np.random.default_rng(seed)
    sheet = bt.shapes.grid(9, 7)
    vertices = np.zeros((len(sheet.vertices), dimension))
    vertices[:, :2] = sheet.vertices[:, :2] + rng.uniform(-0.03, 0.03, (len(vertices), 2))
    if dimension > 2:
        vertices[:, 2:] = 0.2 * rng.normal(size=(len(vertices), dimension - 2))
    return bt.TriangleMesh(vertices, sheet.faces)


def test_equilateral_triangle_by_hand():
    """cot 60° = 1/√3: off the diagonal -1/(2√3), on it 1/√3; area √3/4 a third of it each; gradients have length 2/√3."""
    mesh = bt.TriangleMesh([[0, 0], [1, 0], [0.5, np.sqrt(3) / 2]], [[0, 1, 2]])
    ops = bt.operators(mesh, laplacian="cotangent")
    off = -1 / (2 * np.sqrt(3))
    assert np.allclose(ops.stiffness.toarray(), np.full((3, 3), off) - 3 * off * np.eye(3), rtol=0, atol=1e-15)
    assert np.allclose(ops.mass, np.sqrt(3) / 12, rtol=0, atol=1e-15)
    assert ops.spacing == pytest.approx(1.0, abs=1e-15)
    hats = ops.gradient.toarray().reshape(2, 3)
    assert np.allclose(np.linalg.norm(hats, axis=0), 2 / np.sqrt(3), rtol=0, atol=1e-15)
    assert np.allclose(ops.galerkin_mass.toarray(), np.sqrt(3) / 4 * (np.ones((3, 3)) + np.eye(3)) / 12, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", MAKERS)
def test_identities(name):
    mesh = MAKERS[name]()
    ops = bt.operators(mesh, laplacian="cotangent")
    rng = np.random.default_rng(0)
    f, field = rng.normal(size=len(ops.mass)), rng.normal(size=(len(mesh.faces), mesh.dimension))
    assert (ops.stiffness != ops.stiffness.T).nnz == 0
    rows = abs(ops.stiffness).sum(axis=1)
    assert (abs(ops.stiffness.sum(axis=1)) <= 1e-14 * rows).all()
    assert ops.mass.sum() == pytest.approx(mesh.area, rel=1e-13)
    # sum |grad x_d|² over the coordinates is 2 on a surface: the metric is the one of R^D
    assert (mesh.vertices * (ops.stiffness @ mesh.vertices)).sum() == pytest.approx(2 * mesh.area, rel=1e-12)
    left = (mesh.face_areas[:, None] * (ops.gradient @ f).reshape(field.shape) * field).sum()
    right = -(ops.mass * f * (ops.divergence @ field.ravel())).sum()
    assert left == pytest.approx(right, rel=1e-11, abs=1e-12)
    assert np.allclose(ops.mass * (ops.divergence @ (ops.gradient @ f)), -(ops.stiffness @ f), rtol=0, atol=1e-11 * rows.max())
    assert np.allclose(ops.laplacian @ f, -(ops.stiffness @ f) / ops.mass, rtol=1e-12, atol=1e-12 * rows.max() / ops.mass.min())


@pytest.mark.parametrize("name", MAKERS)
def test_voronoi_mass_sums_to_the_area(name):
    mesh = MAKERS[name]()
    assert bt.operators(mesh, laplacian="cotangent", mass="voronoi").mass.sum() == pytest.approx(mesh.area, rel=1e-12)


def test_voronoi_mass_of_a_right_angle():
    """Right isosceles triangle with legs 1: the circumcentre is the middle of the hypotenuse, so the shares are 1/4, 1/8, 1/8."""
    mesh = bt.TriangleMesh([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    assert np.allclose(bt.operators(mesh, laplacian="cotangent", mass="voronoi").mass, [0.25, 0.125, 0.125], rtol=0, atol=1e-15)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 5), st.floats(1e-6, 1e6))
def test_motion_scale_and_numbering(seed, dimension, scale):
    """L does not change under motions and scaling, M scales by the square; both follow a new numbering."""
    mesh, rng = bumpy(seed, dimension), np.random.default_rng(seed)
    ops = bt.operators(mesh, laplacian="cotangent")
    turn = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    order = rng.permutation(len(mesh.vertices))
    moved = bt.TriangleMesh(scale * (mesh.vertices @ turn)[order], np.argsort(order)[mesh.faces])
    other = bt.operators(moved, laplacian="cotangent")
    size = abs(ops.stiffness).max()
    assert abs(other.stiffness - ops.stiffness[order][:, order]).max() <= 1e-9 * size
    assert np.allclose(other.mass, scale**2 * ops.mass[order], rtol=1e-9)
    assert other.spacing == pytest.approx(scale * ops.spacing, rel=1e-9)


def test_laplacian_converges_on_a_grid():
    """Right-angled uniform triangles give the 5-point formula: second order. f = sin x sin y, Δf = -2 f, inner vertices."""
    errors, sizes = [], [9, 17, 33, 65]
    for n in sizes:
        mesh = bt.shapes.grid(n, n, width=np.pi, height=np.pi)
        ops = bt.operators(mesh, laplacian="cotangent", mass="voronoi")
        x, y = mesh.vertices[:, 0] - mesh.vertices[:, 0].min(), mesh.vertices[:, 1] - mesh.vertices[:, 1].min()
        f = np.sin(x) * np.sin(y)
        errors.append(np.sqrt(np.mean((ops.laplacian @ f + 2 * f)[~ops.boundary] ** 2)))
    slope = -np.polyfit(np.log(np.array(sizes) - 1), np.log(errors), 1)[0]
    assert slope > 1.9, f"order {slope:.2f} from {errors}"


def test_vertices_of_no_triangle_have_empty_rows():
    mesh = bt.TriangleMesh([[9, 9], [0, 0], [1, 0], [0, 1], [5, 5]], [[1, 2, 3]])
    ops = bt.operators(mesh, laplacian="cotangent")
    assert ops.mass[[0, 4]].tolist() == [0, 0]
    assert np.diff(ops.stiffness.indptr).tolist() == [0, 3, 3, 3, 0]
    assert np.isfinite(ops.laplacian.data).all()
    assert np.isfinite(ops.divergence.data).all()


def test_the_same_bits_for_any_threads():
    before = bt.num_threads()
    mesh = bt.shapes.sphere(5)
    found = []
    try:
        for count in (1, 2, 3):
            bt.set_num_threads(count)
            ops = bt.operators(mesh, laplacian="cotangent")
            found.append(
                (ops.stiffness.data.tobytes(), ops.mass.tobytes(), ops.gradient.data.tobytes(), ops.divergence.data.tobytes(), ops.spacing)
            )
    finally:
        bt.set_num_threads(before)
    assert found[0] == found[1] == found[2]


def test_pickle_and_read_only():
    ops = bt.operators(bumpy(3))
    again = pickle.loads(pickle.dumps(ops))
    assert (again.stiffness != ops.stiffness).nnz == 0
    assert np.array_equal(again.gradient.data, ops.gradient.data)
    assert not ops.shape.vertices.flags.writeable


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        ([[0, 0], [1, 0], [2, 0]], [[0, 1, 2]], "face 0 .* is degenerate"),
        ([[0, 0], [1, 0], [0, 1]], [[0, 0, 1]], "face 0 .* is degenerate"),
        ([[0, 0], [1e200, 0], [0, 1e200]], [[0, 1, 2]], "rescale"),
        ([[0, 0], [1e-80, 0], [0, 1e-80]], [[0, 1, 2]], "rescale"),
        (np.zeros((3, 3)), np.zeros((0, 3), int), "no triangles"),
        (np.zeros((0, 3)), np.zeros((0, 3), int), "no triangles"),
    ],
)
def test_refusals(vertices, faces, words):
    with pytest.raises(bt.InputError, match=words):
        bt.operators(bt.TriangleMesh(vertices, faces), laplacian="cotangent")


def test_bad_options():
    mesh = bt.shapes.sphere(1)
    with pytest.raises(bt.InputError, match="laplacian is 'graph'"):
        bt.operators(mesh, laplacian="graph")
    with pytest.raises(bt.InputError, match="mass is 'full'"):
        bt.operators(mesh, mass="full")
    with pytest.raises(bt.InputError, match="shape is a list"):
        bt.operators([1, 2, 3])
    with pytest.raises(bt.InputError, match="neighbors"):
        bt.operators(mesh, neighbors=4)


def test_csr_type():
    ops = bt.operators(bt.shapes.sphere(1))
    for matrix in (ops.stiffness, ops.gradient, ops.divergence, ops.laplacian):
        assert isinstance(matrix, sparse.csr_array)
        assert matrix.has_canonical_format
        matrix.check_format(full_check=True)


@pytest.mark.parametrize("kind", ["cotangent", "intrinsic_delaunay", "tufted", "cloud", "mls"])
def test_what_is_kept_is_read_only(kind):
    """Arrays that are made once and handed out again cannot be changed by who receives them; scipy takes them as they are."""
    mesh = bt.shapes.sphere(2)
    ops = bt.operators(bt.PointCloud(mesh.vertices), laplacian="mls" if kind == "mls" else "auto") if kind in ("cloud", "mls") else None
    ops = ops or bt.operators(mesh, laplacian=kind)
    arrays = [ops.mass, ops.boundary, ops.simplex_areas, ops.element_areas, ops.component_labels, ops.component_masses]
    arrays += [ops.stiffness.data, ops.gradient.data, ops.divergence.data, ops.laplacian.data, ops.simplex_gradient.data, mesh.face_areas]
    assert [at for at, array in enumerate(arrays) if array.flags.writeable] == []
    with pytest.raises(ValueError, match="read-only"):
        ops.stiffness.data[0] = 1.0
    shifted = ops.stiffness + sparse.diags_array(ops.mass)
    assert np.isfinite(sparse.linalg.spsolve(sparse.csc_array(shifted), ops.mass)).all()
    assert np.isfinite(sparse.linalg.eigsh(ops.stiffness, 3, sparse.diags_array(ops.mass), sigma=-1.0, v0=ops.mass)[0]).all()
    assert sparse.csgraph.connected_components(ops.stiffness)[0] == 1
    copy = ops.stiffness.copy()
    copy.data *= 2.0
    assert np.array_equal(copy.data, 2.0 * ops.stiffness.data)


def assembled(mesh: bt.TriangleMesh) -> tuple[np.ndarray, np.ndarray, float]:
    """Stiffness, mass and mean edge length face after face, as a definition has them."""
    n = len(mesh.vertices)
    stiffness, mass, edges = np.zeros((n, n)), np.zeros(n), set()
    for face in mesh.faces:
        for k in range(3):
            i, j, opposite = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            p, q = mesh.vertices[i] - mesh.vertices[opposite], mesh.vertices[j] - mesh.vertices[opposite]
            double_area = np.sqrt((p @ p) * (q @ q) - (p @ q) ** 2)
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
                stiffness[a, b] += sign * (p @ q) / double_area / 2
            mass[opposite] += double_area / 6
            edges.add((min(i, j), max(i, j)))
    return stiffness, mass, float(np.mean([np.linalg.norm(mesh.vertices[i] - mesh.vertices[j]) for i, j in edges]))


@pytest.mark.parametrize(
    "kind", ["closed", "boundary", "flipped", "renumbered", "two fans at a vertex", "three faces at an edge", "a face twice", "many faces"]
)
def test_any_faces_around_a_vertex(kind: str):
    """Rows are written where a closed fan of faces would have them; whatever else surrounds a vertex must come out as right."""
    rng = np.random.default_rng(3)
    mesh = bt.shapes.sphere(3) if kind in ("closed", "renumbered", "flipped") else bumpy(1)
    vertices, faces = mesh.vertices.copy(), mesh.faces.copy()
    if kind == "flipped":
        turned = rng.random(len(faces)) < 0.3
        faces[turned] = faces[turned][:, ::-1]
    elif kind == "renumbered":
        order = rng.permutation(len(vertices))
        vertices, faces = vertices[order], np.argsort(order)[faces][rng.permutation(len(faces))]
    elif kind == "two fans at a vertex":
        faces = np.delete(faces, np.flatnonzero((faces == 30).any(axis=1))[[0, 3]], axis=0)
    elif kind in ("three faces at an edge", "a face twice"):
        third = faces[10, 2] if kind == "a face twice" else (set(range(len(vertices))) - set(faces[10])).pop()
        faces = np.vstack([faces, [faces[10, 0], faces[10, 1], third]])
    elif kind == "many faces":
        angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        vertices = np.vstack([[0, 0, 1.0], np.c_[np.cos(angles), np.sin(angles), 0 * angles]])
        faces = np.c_[np.zeros(40, int), 1 + np.arange(40), 1 + (np.arange(40) + 1) % 40]
    mesh = bt.TriangleMesh(vertices, faces)
    ops = bt.operators(mesh, laplacian="cotangent")
    stiffness, mass, spacing = assembled(mesh)
    assert abs(ops.stiffness.toarray() - stiffness).max() < 1e-12 * abs(stiffness).max()
    assert abs(ops.stiffness - ops.stiffness.T).max() == 0
    assert (np.diff(ops.stiffness.indices)[np.setdiff1d(np.arange(ops.stiffness.nnz - 1), ops.stiffness.indptr[1:-1] - 1)] > 0).all()
    assert np.allclose(ops.mass, mass, rtol=1e-13, atol=0)
    assert ops.spacing == pytest.approx(spacing, rel=1e-13)
