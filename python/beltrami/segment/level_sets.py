"""Level sets of functions on meshes and clouds, as polylines."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from .. import _core, arrays
from ..arrays import Floats, Ints
from ..clouds import CloudOperators
from ..errors import InputError
from ..near import nearest_neighbors
from ..operators import Operators, operators
from ..shapes import PointCloud, Shape, TriangleMesh
from .surface import Surface

Edge = tuple[int, int]


def lines_of(surface: Surface, values: Floats, level: float) -> tuple[list[Floats], float]:
    """Contours in the user's units, and their length."""
    shape = surface.operators.shape
    if isinstance(shape, TriangleMesh):
        found = contours(shape, values, level=level)
        return found, float(sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in found))
    if surface.corners.shape[1] != 3 or not isinstance(surface.operators, CloudOperators):
        return [], 0.0
    found = cloud_contours(surface.operators, values, level)
    return found, float(sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in found))


def polylines(parts: tuple[Floats, Ints, Floats, npt.NDArray[np.int64], npt.NDArray[np.bool_]]) -> list[Floats]:
    points, _, _, starts, _ = parts
    return [points[a:b].copy() for a, b in itertools.pairwise(starts)]


def contours(shape: Shape | Operators, values: npt.ArrayLike, *, level: float = 0.5) -> list[Floats]:
    """Contours of a piecewise-linear function on a surface at a level, as ordered polylines.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        A surface. On clouds the function is linear on the triangles of the local mesh. Triangles with more votes go first, and loose
        ends within two edge lengths of each other, where stars disagree, are joined.
    values : array_like (n,)
        A vertex counts as above the level if its value is greater.
    level : float
        The value on the contours.

    Returns
    -------
    list of ndarray (k, D)
        Points on edges, in units of length, with the greater values on the left on a consistently oriented mesh. Closed polylines
        repeat their first point; others end at a boundary, or where more than two triangles share an edge.

    Raises
    ------
    InputError
        There is not one finite value per vertex.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> sphere = bt.shapes.sphere(5)
    >>> (line,) = bt.contours(sphere, sphere.vertices[:, 2], level=0.6)
    >>> length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
    >>> bool(abs(length / (2 * np.pi * 0.8) - 1) < 1e-3)
    True
    """
    if isinstance(shape, PointCloud | CloudOperators):
        return cloud_contours(shape, values, arrays.number(level, "level"))
    mesh = shape.shape if isinstance(shape, Operators) else shape
    if not isinstance(mesh, TriangleMesh):
        raise InputError(f"contours are there on a TriangleMesh or a PointCloud, not on a {type(mesh).__name__}")
    numbers = arrays.floats(values, "values", (len(mesh.vertices),))
    return polylines(_core.level_set((mesh.vertices, mesh.faces), numbers, arrays.number(level, "level")))


def cloud_contours(shape: PointCloud | CloudOperators, values: npt.ArrayLike, height: float) -> list[Floats]:
    """:func:`beltrami.contours` on a cloud."""
    ops = operators(shape)
    if not isinstance(ops, CloudOperators) or ops.shape.dimension != 2:
        raise InputError("contours are curves on surfaces; this cloud has another dimension than 2")
    points, triangles, votes, _ = ops.local_mesh
    number = arrays.floats(values, "values", (len(points),))
    above = number > height
    inside = above[triangles]
    cut = inside.any(1) & ~inside.all(1)
    triangles, inside = triangles[cut].astype(np.int64), inside[cut]
    # The corner that is alone on its side: its two edges are crossed.
    lone = np.where(inside.sum(1) == 1, inside.argmax(1), (~inside).argmax(1))
    rows = np.arange(len(triangles))
    apex, left, right = triangles[rows, lone], triangles[rows, (lone + 1) % 3], triangles[rows, (lone + 2) % 3]
    ends = np.stack([np.sort(np.c_[apex, left], 1), np.sort(np.c_[apex, right], 1)], 1)
    order = np.argsort(-votes[cut].astype(np.int64), kind="stable")
    segments = [((a, b), (c, d)) for (a, b), (c, d) in ends[order].tolist()]
    sure = {frozenset(segment) for segment, many in zip(segments, votes[cut][order] >= 2, strict=True) if many}
    links = _link([pair for chain in _chains(_link(segments)) for pair in itertools.pairwise(_trimmed(chain, sure))])
    _join(links, ops.boundary, points)
    chains = _chains(links)
    found = []
    for chain in chains:
        i, j = np.transpose(chain)
        share = ((height - number[i]) / (number[j] - number[i]))[:, None]
        found.append(points[i] * (1 - share) + points[j] * share)
    return found


def _link(segments: list[tuple[Edge, Edge]]) -> dict[Edge, list[Edge]]:
    """Crossed edges and the one or two that follow them; a segment to an edge that has two already is left out."""
    links: dict[Edge, list[Edge]] = {}
    for start, end in segments:
        first, second = links.setdefault(start, []), links.setdefault(end, [])
        if len(first) < 2 and len(second) < 2 and end not in first:
            first.append(end)
            second.append(start)
    return links


def _trimmed(chain: list[Edge], sure: set[frozenset[Edge]]) -> list[Edge]:
    """Without ends that single stars have drawn; nothing where these have drawn the most of it."""
    known = np.array([frozenset(pair) in sure for pair in itertools.pairwise(chain)])
    if not known.any() or 2 * np.count_nonzero(known) < len(known):
        return []
    if len(chain) > 2 and chain[0] == chain[-1]:
        return chain
    first, last = np.flatnonzero(known)[[0, -1]]
    return chain[first : last + 2]


def _join(links: dict[Edge, list[Edge]], rim: npt.NDArray[np.bool_], points: Floats) -> None:
    """Joins ends of chains that are within two edge lengths: stars that disagree have left a gap there."""
    ends = sorted(edge for edge, following in links.items() if len(following) < 2 and not rim[list(edge)].all())
    if len(ends) < 2:
        return
    corners = points[np.array(ends)]
    middle, reach = corners.mean(1), 2.0 * np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    indices, distances = nearest_neighbors(middle, middle, min(8, len(ends)))
    pairs = {(float(d), min(a, b), max(a, b)) for a in range(len(ends)) for b, d in zip(indices[a].tolist(), distances[a], strict=True)}
    for distance, a, b in sorted(pairs):
        first, second = links[ends[a]], links[ends[b]]
        near = a != b and distance <= max(reach[a], reach[b]) and ends[b] not in first
        if near and len(first) < 2 and len(second) < 2:
            first.append(ends[b])
            second.append(ends[a])


def _chains(links: dict[Edge, list[Edge]]) -> list[list[Edge]]:
    """Open chains from their ends, then closed ones, in the order of their first edge."""
    chains: list[list[Edge]] = []
    seen: set[Edge] = set()
    for open_ends in (True, False):
        for start in sorted(links):
            if start in seen or not links[start] or (open_ends and len(links[start]) == 2):
                continue
            chain = [start]
            seen.add(start)
            while following := [edge for edge in links[chain[-1]] if edge not in seen]:
                chain.append(following[0])
                seen.add(following[0])
            if not open_ends and len(chain) > 2:
                chain.append(start)
            chains.append(chain)
    return chains
