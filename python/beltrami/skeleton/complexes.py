"""What skeletons cut: the edges or triangles of a shape; noise of clouds averaged out, near parts told apart by oriented normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from ..arrays import Floats, Ints
from ..clouds import CloudOperators
from ..near import nearest_neighbors
from ..operators import Operators
from ..sampling import poisson_disc
from ..shapes import PointCloud, TriangleMesh

Indices = npt.NDArray[np.int64]

NOISY = 0.03  # share of the variance of 8 neighbours across the surface; .006 on coarse clean samples, .1 under noise of a spacing


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
    indices, _ = nearest_neighbors(points, queries, count)
    means, normals, shares = np.empty_like(queries), np.empty_like(queries), np.empty(len(queries))
    for start in range(0, len(queries), 4096):  # so that memory stays small
        here = slice(start, start + 4096)
        near = points[indices[here]]
        means[here] = near.mean(1)
        near = near - means[here, None]
        near /= np.maximum(np.abs(near).max((1, 2), keepdims=True), 1e-300)  # squares of very large shapes overflow
        values, vectors = np.linalg.eigh(np.matmul(near.transpose(0, 2, 1), near))
        normals[here] = vectors[:, :, 0]
        shares[here] = values[:, 0] / np.maximum(values.sum(1), 1e-300)
    return means, normals, shares


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


def _oriented(points: Floats) -> tuple[Floats, float]:
    """Normals oriented alike, and the share of tangential edges across which they are not.

    Signs are carried by reflection (Hoppe et al. 1992) along a minimum spanning forest that prefers edges within the surface: edges
    across a gap between two parts, or through a thin part, come last.
    """
    count = len(points)
    indices, _ = nearest_neighbors(points, points, min(13, count))
    _, normals, shares = _plane_fits(points, points, min(8, count))
    pairs = np.stack([np.repeat(np.arange(count), indices.shape[1] - 1), indices[:, 1:].ravel()], 1)
    pairs = unique_edges(pairs[pairs[:, 0] != pairs[:, 1]])
    i, j = pairs.T
    along = points[j] - points[i]
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    a, b = np.einsum("ed,ed->e", along, normals[i]), np.einsum("ed,ed->e", along, normals[j])
    same = np.einsum("ed,ed->e", normals[i], normals[j])
    reflected = same - 2 * a * b
    steep = np.maximum(a * a, b * b)
    cost = 1 - np.abs(reflected) + steep + 3 * (shares[i] + shares[j]) + 1e-6
    forest = scipy.sparse.csgraph.minimum_spanning_tree(scipy.sparse.coo_array((cost, (i, j)), shape=(count, count)).tocsr()).tocoo()
    p, q = forest.coords
    along = points[q] - points[p]
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    turn = np.einsum("ed,ed->e", normals[p], normals[q])
    turn -= 2 * np.einsum("ed,ed->e", along, normals[p]) * np.einsum("ed,ed->e", along, normals[q])
    tree = scipy.sparse.coo_array((np.ones(2 * len(p)), (np.r_[p, q], np.r_[q, p])), shape=(count, count)).tocsr()
    pieces, labels = scipy.sparse.csgraph.connected_components(tree, directed=False)
    signs = np.ones(count)
    for piece in range(pieces):
        members = np.flatnonzero(labels == piece)
        away = points[members] - points[members].mean(0)
        root = members[np.argmax(np.einsum("nd,nd->n", away, away))]
        order, before = scipy.sparse.csgraph.breadth_first_order(tree, root, directed=False)
        mine = labels[p] == piece
        child = np.where(before[p] == q, p, q)[mine]
        kept = np.ones(count)
        kept[child] = np.where(turn[mine] < 0, -1.0, 1.0)
        found, factor = signs.tolist(), kept.tolist()
        found[root] = 1.0 if normals[root] @ (points[root] - points[members].mean(0)) >= 0 else -1.0
        for number, parent in zip(order[1:].tolist(), before[order[1:]].tolist(), strict=True):
            found[number] = found[parent] * factor[number]
        signs = np.asarray(found)
    flat = (steep < 0.1) & (np.abs(same) > 0.8)
    seam = float(((signs[i] * signs[j] * same < 0) & flat).sum() / max(flat.sum(), 1))
    return normals * signs[:, None], seam


def cloud_complex(cloud: PointCloud, notes: list[str], report: Any) -> Complex:
    """Edges of the local mesh, with the sides of thin parts and near parts told apart by oriented normals where they can be found."""
    _, first = np.unique(cloud.points, axis=0, return_index=True)
    origin = np.sort(first)
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
            normals, seam = _oriented(points)
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
