"""The edges or triangles that level sets cut; averaging of noisy clouds; nearby parts told apart by oriented normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from .. import _core
from ..arrays import Floats, Ints
from ..clouds import CloudOperators
from ..near import nearest_neighbors
from ..operators import Operators
from ..sampling import poisson_disc
from ..shapes import PointCloud, TriangleMesh

Indices = npt.NDArray[np.int64]

NOISY = 0.03  # share of the variance of 8 neighbours across the surface; .006 on coarse clean samples, .1 under noise of a spacing
AWAY = 0.008  # share of neighbours more than 70 degrees apart: up to .005 where a shape is sampled well, .009 and more where parts touch


@dataclass
class Complex:
    """What is cut: points, cells (triangles or edges), and who of the user's points each belongs to."""

    points: Floats
    cells: Ints
    edges: Ints
    spacing: float
    weights: Floats
    stiffness: scipy.sparse.csr_array
    mass: Floats
    origin: Indices  # the user's number of each point
    sources: Floats  # points that show where the surface is (the user's, not denoised)

    @property
    def is_mesh(self) -> bool:
        return bool(self.cells.shape[1] == 3)


def unique_edges(pairs: npt.NDArray[Any]) -> Ints:
    pairs = np.sort(pairs.astype(np.int64), axis=1)
    keys = np.sort(pairs[:, 0] << 32 | pairs[:, 1])
    keys = keys[np.diff(keys, prepend=-1) != 0]
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], 1).astype(np.int32)


def sides(cells: Ints) -> Ints:
    return np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [0, 2]]])


def mesh_complex(ops: Operators) -> Complex:
    mesh = ops.shape
    assert isinstance(mesh, TriangleMesh)
    edges = unique_edges(sides(mesh.faces))
    lengths = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    n = len(mesh.vertices)
    return Complex(
        mesh.vertices, mesh.faces, edges, float(np.median(lengths)), np.ones(n), ops.stiffness, ops.mass, np.arange(n), mesh.vertices
    )


def _plane_fits(points: Floats, queries: Floats, count: int) -> tuple[Floats, Floats, Floats]:
    """Mean of the neighbours of each query, direction in which they vary least, share of the variance along it."""
    return _core.plane_fits(points, nearest_neighbors(points, queries, count)[0])


def _denoised(points: Floats) -> tuple[Floats, Indices, int]:
    """Points moved onto the surface that a noisy cloud suggests, fewer of them; the numbers of those kept; neighbours taken (0: clean).

    Where 8 neighbours vary across the surface nearly as much as along it, there is noise of the size of the spacing. Planes through
    as many neighbours as make that share least average it out; two projections on them (moving least squares).
    """
    count = len(points)
    everyone = np.arange(count)
    sample = points[:: max(1, count // 800)]

    def share(neighbors: int) -> float:
        return float(np.median(_plane_fits(points, sample, neighbors)[2]))

    if points.shape[1] != 3 or count < 200:
        return points, everyone, 0
    near = share(8)
    if near < NOISY or share(24) > 2.5 * near:  # bending grows with the number of neighbours, noise does not
        return points, everyone, 0
    sizes = [size for size in (24, 32, 48, 64, 96, 128, 192) if size <= count // 8]
    if not sizes:
        return points, everyone, 0
    neighbors = min(sizes, key=share)
    spacing = float(np.median(nearest_neighbors(points, sample, 7)[1][:, 6]))
    kept = np.sort(poisson_disc(points, spacing * min(1.0, 0.1 * np.sqrt(neighbors)) * 0.8)).astype(np.int64)
    moved = points[kept]
    for _ in range(2):
        means, normals, _ = _plane_fits(points, moved, neighbors)
        moved = moved - normals * np.einsum("nd,nd->n", moved - means, normals)[:, None]
    _, distances = nearest_neighbors(moved, moved, 7)
    apart = np.sort(poisson_disc(moved, 0.4 * float(np.median(distances[:, 6]))))
    return np.ascontiguousarray(moved[apart]), kept[apart], neighbors


def cloud_complex(cloud: PointCloud, notes: list[str], report: Any) -> Complex:
    """Edges of the local mesh, with the sides of thin parts and near parts told apart by oriented normals where they can be found."""
    origin = np.flatnonzero(_core.first_copies(cloud.points))
    if len(origin) < len(cloud.points):
        notes.append(f"{len(cloud.points) - len(origin)} points are copies of others")
    given = cloud.points[origin]
    points, kept, neighbors = _denoised(given) if cloud.dimension == 2 else (given, np.arange(len(given)), 0)
    if neighbors:
        notes.append(f"the cloud is noisy: {len(kept)} of {len(given)} points, moved onto planes through {neighbors} neighbours, are used")
    origin = origin[kept]
    normals: Floats | None = None
    if cloud.dimension == 2 and points.shape[1] == 3 and len(points) >= 20:
        if cloud.normals is not None and not neighbors:
            normals = cloud.normals[origin]
        else:
            normals, seam = _core.oriented_normals(points, 8, 13)
            if seam > 0.005:
                normals = None
                notes.append(f"normals could not be oriented ({100 * seam:.1f} % of neighbours disagree): near parts may join")
    for _ in range(5):
        ops = CloudOperators(PointCloud(points, dimension=cloud.dimension, normals=normals), "local_mesh", neighbors=None, progress=report)
        used = np.zeros(len(points), bool)
        used[ops.simplices.ravel()] = True
        if used.all():
            break
        points, origin = points[used], origin[used]
        normals = None if normals is None else normals[used]
    if normals is not None:
        pairs = ops.simplices[:, [0, 1]]  # of each triangle one side
        away = float((np.einsum("md,md->m", normals[pairs[:, 0]], normals[pairs[:, 1]]) < 0.34).mean())
        if away > AWAY:
            notes.append(f"{100 * away:.1f} % of neighbours turn away from each other: parts nearer than the spacing may have joined")
    edges = unique_edges(ops.simplices[:, [0, 1]] if cloud.dimension == 1 else sides(ops.simplices))
    return Complex(
        points,
        edges,
        edges,
        float(np.median(ops.point_spacing)),
        np.ascontiguousarray(ops.point_spacing),
        ops.stiffness,
        ops.mass,
        origin,
        given,
    )
