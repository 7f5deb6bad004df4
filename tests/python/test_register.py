"""Near-isometric registration."""

import beltrami as bt
import numpy as np
import pytest


def bent(mesh, angle=0.8):
    """The mesh bent about the z axis along y: no isometry, yet near one."""
    x, y, z = (mesh.vertices - mesh.vertices.mean(0)).T
    radius = np.ptp(y) / angle
    return bt.TriangleMesh(np.stack([(radius + x) * np.cos(y / radius), (radius + x) * np.sin(y / radius), z], 1), mesh.faces)


def renumbered(mesh, seed):
    order = np.random.default_rng(seed).permutation(len(mesh.vertices))
    number = np.argsort(order)
    return bt.TriangleMesh(mesh.vertices[order], number[mesh.faces]), number


@pytest.fixture(scope="module")
def spot():
    return bt.examples.spot()


@pytest.fixture(scope="module")
def pair(spot):
    target, truth = renumbered(bent(spot), 1)
    return spot, target, truth


@pytest.fixture(scope="module")
def found(pair):
    return bt.register(pair[0], pair[1], rng=0)


def error(point_map, pair):
    return bt.evaluate_map(point_map, pair[0], pair[1], truth=pair[2], points=200).mean


def test_a_bent_copy_is_found_and_not_mirrored(found, pair):
    assert error(found.point_map, pair) < 0.01  # about half an edge
    assert found.mirror_decided
    assert found.extrinsic
    assert found.orientation > 0.9
    assert found.coverage > 0.9


def test_what_the_result_says_is_so(found, pair):
    _source, target, truth = pair
    k = len(found.functional_map)
    assert np.allclose(found.functional_map.T @ found.functional_map, np.eye(k), atol=1e-12)
    n = len(found.rotation)
    assert np.abs(found.rotation.T @ found.rotation - np.eye(n)).max() < 1e-12
    hit = np.unique(found.point_map)
    mass = bt.operators(target).mass
    assert np.isclose(found.coverage, mass[hit].sum() / mass.sum(), rtol=1e-12)
    assert found.distance >= 0
    energies = [candidate.energy for candidate in found.candidates]
    assert energies == sorted(energies)
    size = np.sqrt(target.area)
    assert np.linalg.norm(found.positions - target.vertices[truth], axis=1).mean() < 0.01 * size


def test_colours_and_labels_travel_along_the_map(found, pair):
    source, _target, truth = pair
    labels = (source.vertices[:, 1] > 0).astype(int)
    carried = found.transfer(labels, direction="to_target")
    assert (carried[truth] == labels).mean() > 0.97


def test_size_place_numbering_and_inside_out_do_not_matter(pair):
    source, target, truth = pair
    far = bt.TriangleMesh(1e5 * target.vertices + 3e5, target.faces[:, ::-1])
    assert error(bt.register(source, far).point_map, (source, far, truth)) < 0.01


def test_the_chapters_iteration_alone(pair):
    # what remains of left and right is decided by orientation
    result = bt.register(pair[0], pair[1], method="rswd", rng=0)
    assert error(result.point_map, pair) < 0.05
    assert (np.diff(result.history["levels"]) > 0).all()
    assert not result.extrinsic
    again = bt.register(pair[0], pair[1], method="rswd", rng=0)
    assert (again.point_map == result.point_map).all()
    assert again.distance == result.distance


def test_intrinsic_only_and_clouds(pair):
    source, target, truth = pair
    inner = bt.register(source, target, extrinsic=False)
    assert not inner.extrinsic
    assert error(inner.point_map, pair) < 0.03
    cloud = bt.register(bt.PointCloud(source.vertices), bt.PointCloud(target.vertices))
    assert cloud.mirror_decided  # the cloud is closed: outside is known
    assert cloud.orientation > 0.8
    assert any("closed surface" in note for note in cloud.notes)
    assert error(cloud.point_map, pair) < 0.01
    assert np.linalg.norm(cloud.positions - target.vertices[truth], axis=1).mean() < 0.01 * np.sqrt(target.area)
    mixed = bt.register(source, bt.PointCloud(target.vertices))
    assert mixed.mirror_decided
    assert error(mixed.point_map, pair) < 0.01
    blind = bt.register(bt.PointCloud(source.vertices), bt.PointCloud(target.vertices), extrinsic=False)
    assert blind.mirror_decided
    assert error(blind.point_map, pair) < 0.03


def test_left_and_right_of_open_clouds_are_not_said_to_be_told(pair):
    source, target, truth = pair
    kept = source.vertices[:, 1] > -0.2
    part = bt.PointCloud(source.vertices[kept])
    image = np.flatnonzero(kept)
    bent_part = bt.PointCloud(target.vertices[np.sort(truth[image])])
    found = bt.register(part, bent_part)
    assert not found.mirror_decided
    assert any("left and right" in note for note in found.notes)
    where = np.searchsorted(np.sort(truth[image]), truth[image])
    off = np.linalg.norm(bent_part.points[found.point_map] - bent_part.points[where], axis=1).mean()
    assert off < 0.02 * np.sqrt(target.area)  # the deformation decides, rightly here


def test_clouds_with_thin_limbs():
    # a ball with five limbs of different lengths, five points around each, straight and bent: the local meshes tear and leak there
    axes = np.linalg.qr(np.random.default_rng(8).standard_normal((3, 3)))[0]
    axes = np.concatenate([axes, -axes[:2]])

    def body(bend, seed):
        ball = np.random.default_rng(seed).standard_normal((1500, 3))
        ball /= np.linalg.norm(ball, axis=1, keepdims=True)
        parts, numbers = [ball[(ball @ axes.T < 0.985).all(1)]], []
        for limb, length in enumerate((0.8, 1.2, 1.7, 2.3, 3.0)):
            way, side = axes[limb], axes[(limb + 2) % 3] if limb < 3 else axes[2]
            other = np.cross(way, side)
            height = np.arange(0.0, length, 0.07)
            angle = 2 * np.pi * np.arange(5) / 5 + 0.6 * np.arange(len(height))[:, None]
            curve = (1 + height[:, None]) * way + bend * height[:, None] ** 2 * side
            ring = 0.12 * (np.cos(angle)[..., None] * side + np.sin(angle)[..., None] * other)
            parts += [(curve[:, None] + ring).reshape(-1, 3), curve[-1:] + 0.05 * way]
            numbers.append(np.full(5 * len(height) + 1, limb))
        return np.concatenate(parts), np.concatenate([np.full(len(parts[0]), -1), *numbers])

    (first, limbs), (second, images) = body(0.0, 1), body(0.1, 2)
    found = bt.register(bt.PointCloud(first), bt.PointCloud(second))
    on_limb = limbs >= 0
    assert found.mirror_decided
    assert (images[found.point_map] == limbs)[on_limb].mean() > 0.95


def test_copies_of_points_change_nothing_and_keep_their_normals():
    ball = bt.shapes.ellipsoid(level=3)
    x, y, z = ball.vertices.T
    shape = bt.TriangleMesh(ball.vertices * (1 + 0.2 * x + 0.1 * y + 0.15 * z * (x + 1))[:, None], ball.faces)  # no symmetry
    points, normals = shape.vertices, bt.normals(shape.vertices)
    once = bt.register(bt.PointCloud(points, normals=normals), shape)
    twice = bt.register(bt.PointCloud(np.r_[points, points[:9]], normals=np.r_[normals, normals[:9]]), shape)
    assert (once.point_map == np.arange(len(points))).mean() > 0.99
    assert (twice.point_map[: len(points)] == once.point_map).mean() > 0.99
    assert (twice.point_map[len(points) :] == twice.point_map[:9]).all()
    assert (twice.positions[len(points) :] == twice.positions[:9]).all()


def test_landmarks_decide_where_symmetry_cannot():
    # an ellipsoid has eight isometries, four of them keep the orientation
    shape = bt.shapes.ellipsoid(level=3)
    target, truth = renumbered(shape, 5)
    ends = [int(shape.vertices[:, axis].argmax()) for axis in range(3)]
    found = bt.register(shape, target, landmarks=np.stack([ends, truth[ends]], 1))
    assert error(found.point_map, (shape, target, truth)) < 0.02
    height = shape.vertices @ [1.0, 2.0, 3.0]
    found = bt.register(shape, target, descriptors=(height, height[np.argsort(truth)]))
    assert error(found.point_map, (shape, target, truth)) < 0.02


def test_parts_that_hang_loose_follow_and_are_said():
    shape = bt.shapes.ellipsoid(level=3)
    crumb = bt.shapes.sphere(1)
    n = len(shape.vertices)
    both = bt.TriangleMesh(
        np.concatenate([shape.vertices, 0.01 * crumb.vertices + [2.0, 0, 0]]), np.concatenate([shape.faces, crumb.faces + n])
    )
    found = bt.register(both, shape)
    assert any("hang loose" in note for note in found.notes)
    assert len(found.point_map) == n + len(crumb.vertices)
    assert np.isfinite(found.positions).all()


def test_a_part_of_a_shape_and_tiny_shapes_run(spot):
    part = spot.submesh(spot.vertices[:, 1] > -0.2)
    found = bt.register(part, spot)
    assert 0 < found.coverage < 1
    octahedron = bt.shapes.sphere(0)
    assert bt.register(octahedron, octahedron).point_map.shape == (len(octahedron.vertices),)


def test_bad_input_is_refused(spot):
    small = bt.shapes.sphere(2)
    n = len(small.vertices)
    calls = [
        lambda: bt.register(small, small, method="icp"),
        lambda: bt.register(small, small, landmarks=[[0, n]]),
        lambda: bt.register(small, small, landmarks=[0, 1]),
        lambda: bt.register(small, small, descriptors=(np.zeros((n, 2)), np.zeros((n, 3)))),
        lambda: bt.register(small, small, descriptors=np.zeros(n)),
        lambda: bt.register(small, small, descriptors="sift"),
        lambda: bt.register(small, small, modes=0),
        lambda: bt.register(small, "horse"),
    ]
    for call in calls:
        with pytest.raises(bt.InputError):
            call()
    with pytest.raises(bt.Cancelled):
        bt.register(small, small, progress=lambda share: share < 0.3)


def test_shapes_that_no_bending_joins_are_said_to_be_so() -> None:
    torus, ball = bt.shapes.torus(rows=60, columns=24), bt.shapes.ellipsoid(1.0, 0.8, 0.6, level=4)
    notes = bt.register(ball, torus, rng=0).notes
    assert any("Euler characteristics are 2 and 0" in note for note in notes)
    assert any("more than a bending" in note for note in notes)
    assert bt.register(ball, ball, rng=0).notes == ()
