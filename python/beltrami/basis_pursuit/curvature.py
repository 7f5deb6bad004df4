"""Which point of one sphere belongs to which of another, without landmarks: by the curvature of conformal surfaces.

No inversion of space changes ``(H² - K) dA``, whose integral is Willmore's energy. So the spherical maps of two surfaces that are
inversions of one another carry the same measure, and become equal up to a rotation when the mean of each measure is brought to the origin.
"""

from __future__ import annotations

import numpy as np
import scipy

from ..arrays import Floats
from ..conformal.moebius import centred
from ..sampling import farthest_points
from ..shapes import TriangleMesh
from ..sliced import rotation_invariant_sliced_wasserstein
from ..sums import gathered
from .limbs import Sphered, distinct
from .surface import Indices, Surface, nearest_rows

ROUND = 1.0  # total measure below which a surface is too nearly a round sphere to be recognized by it
ALIKE = 2.0  # ratio of the totals from which on they are not those of one surface; other triangles alone change them 1.5 times
SHARPNESS = (10.0, 40.0)  # of the kernels exp(k (x·y - 1)) by which the measures are compared, from coarse to fine
FINEST = 160.0  # the same, where the measures of a surface and of its bent and stretched copies differ: they agreed up to 0.92
SAME = 0.95  # agreement from which on measures count as one: of inversions .98 and more, of coarse or noisy meshes down to .55
TURNS = 4000  # rotations to begin with: some 0.3 rad apart
GRID = 64  # parallels at which a smoothed measure is tabulated; twice as many meridians
PAIRS = 12


def willmore_measure(surface: Surface) -> Floats | None:
    """(n,): ``(H² - K) dA``, a quarter of the squared difference of the principal curvatures; None but for triangles in R^3.

    The second fundamental form of each triangle is fitted to the differences of the normals at its corners (Rusinkiewicz 2004), and these
    normals are exact on spheres (Max 1999).
    """
    mesh = surface.operators.shape
    if not isinstance(mesh, TriangleMesh) or mesh.vertices.shape[1] != 3:
        return None
    corners = surface.points[mesh.faces]
    edges = np.stack([corners[:, k - 1] - corners[:, k - 2] for k in range(3)], 1)  # opposite to corner k
    cross = np.cross(edges[:, 0], edges[:, 1])
    squares = np.maximum(np.square(edges).sum(2), 1e-20)  # triangles thinner than that have no curvature
    ends = mesh.faces.ravel()
    sums = np.stack([cross / (squares[:, k - 1] * squares[:, k - 2])[:, None] for k in range(3)], 1).reshape(-1, 3)
    normals = np.stack([gathered(ends, column, len(surface.points)) for column in sums.T], 1)
    normals = normals / np.maximum(np.sqrt(np.square(normals).sum(1)), 1e-100)[:, None]
    double = np.sqrt(np.square(cross).sum(1))
    first = edges[:, 0] / np.sqrt(squares[:, 0])[:, None]
    second = np.cross(cross / np.maximum(double, 1e-100)[:, None], first)
    frame = np.stack([first, second], 2)
    along = edges @ frame  # (m, 3, 2)
    turned = np.stack([normals[mesh.faces[:, k - 1]] - normals[mesh.faces[:, k - 2]] for k in range(3)], 1) @ frame
    equations = np.zeros((len(along), 3, 2, 3))  # II along = turned, for II = [[x, y], [y, z]]
    equations[:, :, 0, :2] = equations[:, :, 1, 1:] = along
    rows = equations.reshape(-1, 6, 3)
    normal_matrix = np.einsum("fij,fik->fjk", rows, rows)
    normal_matrix += (1e-12 * np.einsum("fii->f", normal_matrix) + 1e-100)[:, None, None] * np.eye(3)
    x, y, z = np.linalg.solve(normal_matrix, np.einsum("fij,fi->fj", rows, turned.reshape(-1, 6))[..., None])[..., 0].T
    found = (np.square(x - z) / 4 + np.square(y)) * double / 2
    return gathered(ends, np.repeat(found / 3, 3), len(surface.points))


def paired_by_curvature(a: Sphered, b: Sphered) -> tuple[Indices, bool]:
    """Some pairs of vertices that lie apart, as the measures of the two surfaces place them, none if these are not alike; and whether the
    measures are the same, so that the surfaces count as inversions of one another."""
    nothing = np.zeros((0, 2), np.int64), False
    first, second = willmore_measure(a.surface), willmore_measure(b.surface)
    if first is None or second is None:
        return nothing
    totals = first.sum(), second.sum()
    first, second = first / max(totals[0], 1e-300), second / max(totals[1], 1e-300)
    if not min(totals) > max(ROUND, max(totals) / ALIKE) or max(first.max(), second.max()) > 0.4:
        return nothing
    ours, theirs = centred(a.sphere, first), centred(b.sphere, second)
    turned = ours @ best_rotation(ours, first, theirs, second)
    spread = np.asarray(farthest_points(ours, min(PAIRS, len(ours))), np.int64)
    pairs = distinct(np.stack([spread, nearest_rows(theirs, turned[spread])], 1))
    return pairs, _agreement(_gathered(turned, first, 1500), _gathered(theirs, second, 1500)) > SAME


def _agreement(first: tuple[Floats, Floats], second: tuple[Floats, Floats]) -> float:
    """The cosine of the angle between two smoothed measures; 1 if they are equal."""
    products = [
        float(np.einsum("i,ij,j->", masses, np.exp(FINEST * (points @ others.T - 1)), weights))
        for points, masses in (first, second)
        for others, weights in (first, second)
    ]
    return products[1] / max(float(np.sqrt(products[0] * products[3])), 1e-300)


def best_rotation(first: Floats, masses: Floats, second: Floats, other_masses: Floats) -> Floats:
    """R with which the points ``first @ R`` of the sphere, with their masses, lie like the second: of many the best, improved."""
    rng, rotation = np.random.default_rng(0), scipy.spatial.transform.Rotation
    few, heavy = _gathered(first, masses, 300)
    many, weights = _gathered(second, other_masses, 1500)
    polar, around = (np.arange(GRID) + 0.5) * np.pi / GRID, (np.arange(2 * GRID) + 0.5) * np.pi / GRID
    ring = np.stack([np.cos(around), np.sin(around), 0 * around], 1)
    sphere = np.sin(polar)[:, None, None] * ring + np.cos(polar)[:, None, None] * np.array([0.0, 0.0, 1.0])
    turns = rotation.from_quat(rng.normal(size=(TURNS, 4))).as_matrix()
    for sharpness in SHARPNESS:
        table = np.einsum("ijk,k->ij", np.exp(sharpness * (sphere @ many.T - 1)), weights)
        for _ in range(6):
            x, y, z = np.moveaxis(few @ turns, -1, 0)
            i = np.minimum((np.arccos(np.clip(z, -1, 1)) * (GRID / np.pi)).astype(int), GRID - 1)
            j = (np.arctan2(y, x) * (GRID / np.pi)).astype(int) % (2 * GRID)
            best = turns[np.argsort(-np.einsum("ri,i->r", table[i, j], heavy), kind="stable")[:40]]
            sizes = 0.5 / np.sqrt(sharpness) * 0.6 ** np.arange(12)
            near = [best @ rotation.from_rotvec(size * rng.normal(size=(40, 3))).as_matrix() for size in sizes]
            turns = np.concatenate([best, *near])
    few, heavy = _gathered(first, masses, 1500)
    found = rotation_invariant_sliced_wasserstein(few, many, source_weights=heavy, target_weights=weights, starts=best[:1]).rotation
    return found if np.linalg.det(found) > 0 else np.asarray(best[0])


def _gathered(points: Floats, masses: Floats, count: int) -> tuple[Floats, Floats]:
    """The means and masses of what is nearest to each of a few of the points."""
    chosen = points[np.asarray(farthest_points(points, min(count, len(points))), np.int64)]
    owner = nearest_rows(chosen, points)
    totals = gathered(owner, masses, len(chosen))
    sums = np.stack([gathered(owner, masses * column, len(chosen)) for column in points.T], 1)
    return sums / np.maximum(totals, 1e-300)[:, None], totals
