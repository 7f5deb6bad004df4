"""The closed surface through the points of a cloud."""

import beltrami as bt
import numpy as np
import pytest
from beltrami.inside import closed_surface


def surface(points):
    return closed_surface(bt.operators(bt.PointCloud(points, dimension=2)))


def volume(points, faces):
    a, b, c = (points[faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def uniform_sphere(count, seed):
    points = np.random.default_rng(seed).standard_normal((count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def as_set(faces):
    """Triangles without regard to their first corner, but to their turn."""
    first = faces.argmin(1)
    return {tuple(np.roll(face, -k).tolist()) for face, k in zip(faces, first, strict=True)}


def test_volume_and_area_of_an_ellipsoid_and_all_points_on_it():
    points = uniform_sphere(3000, 0) * [1.0, 0.7, 0.4]
    faces = surface(points)
    assert len(np.unique(faces)) == len(points)
    assert volume(points, faces) == pytest.approx(4 / 3 * np.pi * 0.28, rel=0.01)  # inscribed: lower by about the area of a triangle
    mesh = bt.TriangleMesh(points, faces)
    assert mesh.is_closed
    assert mesh.euler_characteristic == 2


def test_the_volume_converges_with_the_spacing():
    errors = [4 / 3 * np.pi - volume(points, surface(points)) for points in (uniform_sphere(n, 1) for n in (500, 2000, 8000))]
    assert errors[0] > 3 * errors[1] > 9 * errors[2] > 0  # second order in the spacing: 4 and 16


def test_symmetric_points_on_circles():
    # quadrilaterals of mirrored points are flat tetrahedra, whose circumspheres are anything: the surface must not be filled by them
    spot = bt.examples.spot()
    faces = surface(spot.vertices)
    assert bt.TriangleMesh(spot.vertices, faces).area == pytest.approx(spot.area, rel=0.01)
    assert volume(spot.vertices, faces) == pytest.approx(volume(spot.vertices, spot.faces), rel=0.01)


def cube(count):
    at = np.linspace(0, 1, count)
    points = np.stack(np.meshgrid(at, at, at), -1).reshape(-1, 3)
    return points[((points == 0) | (points == 1)).any(1)]


@pytest.mark.parametrize(
    ("points", "inside"),
    [
        (bt.shapes.torus().vertices, 2 * np.pi**2 * 0.4**2),
        (bt.shapes.cylinder(closed=True).vertices, np.pi * 0.5**2 * 2),
        (cube(13), 1.0),
    ],
    ids=["torus", "cylinder", "cube"],
)
def test_grids_are_turned_alike(points, inside):
    # flat tetrahedra lie beside a grid's quadrilaterals: each edge still has one triangle on either side, and all look outward
    faces = surface(points)
    assert volume(points, faces) == pytest.approx(inside, rel=0.015)  # 32 or 48 points around a circle
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)


def test_moved_scaled_and_renumbered():
    points = uniform_sphere(800, 2) * [1.0, 0.8, 0.3]
    faces = as_set(surface(points))
    turn = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    for scale in (1e-6, 1e6):
        assert as_set(surface(scale * (points @ turn + 2))) == faces
    mirrored = surface(points * [-1, 1, 1])
    assert as_set(mirrored[:, ::-1]) == faces
    order = np.random.default_rng(4).permutation(len(points))
    assert as_set(order[surface(points[order])]) == faces


def test_limbs_that_are_thin_and_limbs_that_touch_nearly():
    # two slim capsules side by side on a ball: five points around each, a gap of two spacings
    angle, height = np.meshgrid(np.arange(5) * 2 * np.pi / 5, np.arange(0.95, 3, 0.07))
    twist = angle + 0.3 * np.arange(len(height))[:, None]
    limb = np.stack([0.06 * np.cos(twist), 0.06 * np.sin(twist), height], 2).reshape(-1, 3)
    tip = [[0, 0, height.max() + 0.05]]
    ball = uniform_sphere(4000, 5)
    outside = [np.linalg.norm(ball[:, :2] - [x, 0], axis=1) > 0.11 for x in (-0.13, 0.13)]
    ball = ball[(outside[0] & outside[1]) | (ball[:, 2] < 0)]
    limb = np.concatenate([limb, tip])
    points = np.concatenate([ball, limb + np.array([0.13, 0, 0]), limb - np.array([0.13, 0, 0])])
    faces = surface(points)
    mesh = bt.TriangleMesh(points, faces)
    ops = bt.operators(mesh, laplacian="tufted")
    assert ops.component_masses.max() > 0.999 * ops.mass.sum()
    above = points[:, 2] > 1.3
    left = above & (points[:, 0] < 0)
    right = above & (points[:, 0] > 0)
    crossing = left[faces].any(1) & right[faces].any(1)
    assert crossing.sum() == 0


def test_what_is_not_closed_is_refused():
    ball = uniform_sphere(2000, 6)
    generator = np.random.default_rng(7)
    flat = np.concatenate([generator.random((1500, 2)), np.zeros((1500, 1))], 1)
    wavy = flat + 0.1 * np.sin(5 * flat[:, :1]) * [0, 0, 1]
    angle, width = generator.random(3000) * 2 * np.pi, generator.uniform(-0.4, 0.4, 3000)
    radius = 1 + width * np.cos(angle / 2)
    band = np.stack([radius * np.cos(angle), radius * np.sin(angle), width * np.sin(angle / 2)], 1)
    rough = flat + 0.01 * generator.standard_normal((1500, 1)) * [0, 0, 1]
    for points in (ball[ball[:, 2] > 0], ball[ball[:, 2] > -0.6], flat, wavy, rough, band):
        assert surface(points) is None
