"""The closed surface through the points of a cloud: which of Delaunay's tetrahedra lie inside.

Triangles that stars of neighbours agree on have inside and outside on their two sides. So have the two poles of a point, the farthest
corners of its Voronoi cell; tetrahedra whose circumspheres overlap deeply lie on the same side. These wishes are the edges of a graph
with signs, far outside is known, and a linear system weighs them all: thin limbs come out whole, and limbs that touch apart, where
tangent planes alone tell neither.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt
import scipy

from .arrays import Floats, Ints
from .clouds import CloudOperators
from .solvers import Cholesky

_SIDES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # opposite to each corner of a tetrahedron


def _tetrahedra(points: Floats) -> scipy.spatial.Delaunay | None:
    """Delaunay's tetrahedra, computed beside the main thread so that Ctrl-C need not wait for Qhull."""
    pool = ThreadPoolExecutor(1)
    try:
        return pool.submit(scipy.spatial.Delaunay, points).result()
    except scipy.spatial.QhullError:
        return None
    finally:
        pool.shutdown(wait=False)


def _circumspheres(points: Floats, tetrahedra: Ints) -> tuple[Floats, Floats]:
    """Centres and radii. Flat tetrahedra, of four points on a circle, get the least of their spheres."""
    start = points[tetrahedra[:, 0]]
    edges = points[tetrahedra[:, 1:]] - start[:, None]
    squares = (edges**2).sum(2)
    normals = np.cross(edges[:, [1, 2, 0]], edges[:, [2, 0, 1]])
    determinant = (edges[:, 0] * normals[:, 0]).sum(1)
    centres: Floats = (squares[:, :, None] * normals).sum(1) / (2 * np.where(determinant == 0, 1.0, determinant))[:, None]
    # the ratio of the least singular value to the greatest is no less than this one's
    flat = np.flatnonzero(abs(determinant) < 1e-3 * squares.sum(1) ** 1.5)
    for some in np.array_split(flat, len(flat) // 20_000 + 1):
        left, sizes, right = np.linalg.svd(edges[some])
        inverse = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > 1e-4 * sizes[:, :1])
        half = np.einsum("tkj,tk->tj", left, squares[some] / 2)
        centres[some] = np.einsum("tj,tjk->tk", inverse * half, right)
    return start + centres, np.linalg.norm(centres, axis=1)


def _levels(matrix: scipy.sparse.csr_array, right: Floats) -> Floats:
    """The solution of a diagonally dominant system; only its signs are wanted."""
    diagonal = matrix.diagonal()
    preconditioner = scipy.sparse.linalg.LinearOperator(matrix.shape, matvec=lambda x: x.ravel() / diagonal)
    level, failed = scipy.sparse.linalg.cg(matrix, right, rtol=1e-8, maxiter=2000, M=preconditioner)
    return Cholesky(matrix).solve(right) if failed else level


def _crossing(centres: Floats, radii: Floats, first: Ints, second: Ints) -> Floats:
    """Cosine of the angle between two spheres' radii where they meet: 1 one in the other, -1 touching from outside."""
    apart = ((centres[first] - centres[second]) ** 2).sum(1)
    r, s = radii[first], radii[second]
    cosine: Floats = np.clip((r**2 + s**2 - apart) / np.maximum(2 * r * s, 1e-300), -1.0, 1.0)
    return cosine


def _poles(points: Floats, tetrahedra: Ints, centres: Floats, radii: Floats, count: int) -> tuple[Ints, Ints]:
    """Pairs of tetrahedra around a point: the one with the farthest centre, and the farthest on the opposite side."""
    point, tetrahedron = tetrahedra.ravel(), np.repeat(np.arange(len(tetrahedra)), 4)
    near = point < count
    point, tetrahedron = point[near], tetrahedron[near]
    order = np.lexsort((-radii[tetrahedron], point))
    point, tetrahedron = point[order], tetrahedron[order]
    owner, start = np.unique(point, return_index=True)
    pole = np.full(count, -1)
    pole[owner] = tetrahedron[start]
    way = centres[tetrahedron] - points[point]
    opposite = np.einsum("ij,ij->i", way, (centres[pole] - points[:count])[point]) < 0
    point, tetrahedron = point[opposite], tetrahedron[opposite]
    owner, start = np.unique(point, return_index=True)
    return pole[owner], tetrahedron[start]


def closed_surface(ops: CloudOperators) -> Ints | None:
    """Triangles through the points of a cloud in R^3, turned outward; None if it samples no closed surface.

    The triangles bound a volume. Edges may have four triangles, where two sheets touch, and points may be left out.

    Parameters
    ----------
    ops : CloudOperators
        Of the local mesh of a 2-dimensional cloud in R^3.

    Returns
    -------
    (m, 3) int32 array or None

    References
    ----------
    Kolluri, Shewchuk and O'Brien, Spectral surface reconstruction from noisy point clouds, SGP 2004: poles and the weights of
    spheres that meet. Here a linear system with the outside given replaces their eigenvectors, and the triangles that stars agree on
    take part.
    """
    points = ops.shape.points
    count = len(points)
    lower, upper = points.min(0), points.max(0)
    size = float((upper - lower).max())
    if size == 0 or not np.isfinite(size):
        return None
    box = np.array(np.meshgrid([-10.0, 10.0], [-10.0, 10.0], [-10.0, 10.0])).reshape(3, -1).T
    places = np.concatenate([(points - (lower + upper) / 2) / size, box])
    shaken = places + 1e-8 * np.random.default_rng(0).standard_normal(places.shape)  # many points on one sphere take Qhull for ever
    found = _tetrahedra(shaken)
    if found is None:
        return None
    tetrahedra: Ints = found.simplices
    total = len(tetrahedra)
    centres, radii = _circumspheres(places, tetrahedra)
    outer = (tetrahedra >= count).any(1)

    first, second = np.repeat(np.arange(total), 4), found.neighbors.ravel()
    once = second > first
    first, second = first[once], second[once]
    triangles = tetrahedra[:, _SIDES].reshape(-1, 3)[once]
    agreed = _known(triangles, ops.simplices[ops.votes == 3], len(places))
    corners = places[triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    width = lengths.prod(1) / np.maximum(2 * twice, 1e-300)  # of the circumcircle: what is large is no part of the surface
    width = np.sqrt(np.clip(width / np.median(width), 0.1, 100.0))
    joined = width * np.exp(4 + 4 * _crossing(centres, radii, first, second))
    poles = _poles(places, tetrahedra, centres, radii, count)
    parted = np.exp(4 - 4 * _crossing(centres, radii, *poles))
    i, j = np.concatenate([first, poles[0]]), np.concatenate([second, poles[1]])
    weight = np.concatenate([np.where(agreed, -10 * np.exp(8.0), joined), -parted])

    # least Σ |w| (x_i - sign(w) x_j)^2 with x = 1 far outside
    degree = np.bincount(i, abs(weight), total) + np.bincount(j, abs(weight), total)
    free = np.flatnonzero(~outer)
    both = (np.concatenate([i, j]), np.concatenate([j, i]))
    wishes = scipy.sparse.csr_array((np.concatenate([weight, weight]), both), shape=(total, total))[free]
    matrix = scipy.sparse.csr_array(scipy.sparse.diags_array(degree[free]) - wishes[:, free])
    level = np.ones(total)
    level[free] = _levels(matrix, wishes @ outer.astype(np.float64))
    inside = level < 0

    cut = inside[first] != inside[second]
    surface = triangles[cut]
    within = np.where(inside[first], first, second)[cut]
    # as shaken: four points on a circle have no side otherwise
    base = shaken[surface[:, 0]]
    fourth = shaken[tetrahedra[within].sum(1) - surface.sum(1)] - base
    across = np.cross(shaken[surface[:, 1]] - base, shaken[surface[:, 2]] - base)
    inward = (across * fourth).sum(1) > 0
    surface[inward], across[inward] = surface[inward][:, [0, 2, 1]], -across[inward]

    # a lid over an opening has triangles far larger than the spacing; a sheet with noise is no thicker than that
    area = twice[cut] / 2
    large = lengths[cut].max(1) > 3 * ops.point_spacing[surface].max(1) / size
    volume = (across * base).sum() / 6
    thin = 2 * volume <= area.sum() * float(np.median(ops.point_spacing)) / size
    missed = (twice[agreed] / 2).sum() - area[agreed[cut]].sum()
    if thin or area[large].sum() > 0.05 * area.sum() or missed > 0.05 * area.sum():
        return None
    return np.ascontiguousarray(surface, dtype=np.int32)


def _known(triangles: Ints, wanted: Ints, count: int) -> npt.NDArray[np.bool_]:
    """Which triangles are among the wanted ones."""

    def key(corners: Ints) -> npt.NDArray[np.int64]:
        ordered = np.sort(corners, 1).astype(np.int64)
        numbers: npt.NDArray[np.int64] = (ordered[:, 0] * count + ordered[:, 1]) * count + ordered[:, 2]
        return numbers

    return np.isin(key(triangles), key(wanted))
