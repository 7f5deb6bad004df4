"""Maps between shapes: conversion between point maps and functional maps, transfer of functions, evaluation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy

from . import arrays
from .arrays import Floats
from .eigen import Eigenpairs, eigenpairs
from .errors import InputError
from .near import nearest_neighbors
from .operators import Operators, operators
from .shapes import Shape, TriangleMesh

__all__ = ["MapEvaluation", "evaluate_map", "functional_map_of", "point_map_of", "transfer"]

Indices = npt.NDArray[np.int64]


def checked_point_map(value: Any, source: int, target: int) -> Indices:
    """A point map as int64: one index from 0 to ``target`` - 1 for each of ``source`` points."""
    array = arrays.indices(value, "point_map", target)
    if len(array) != source or np.asarray(value).dtype.kind == "b":
        raise InputError(f"point_map has {len(array)} entries, the source has {source} points: one index a point is needed")
    return array


def _eigenpairs(shape: Shape | Operators | Eigenpairs, k: int, name: str) -> Eigenpairs:
    pairs = shape if isinstance(shape, Eigenpairs) else eigenpairs(shape, k)
    if pairs.functions.shape[1] < k:
        raise InputError(f"{name} has {pairs.functions.shape[1]} eigenpairs, {k} are needed")
    return pairs


def _mass(pairs: Eigenpairs) -> Floats:
    if pairs.shape is None:
        raise InputError("these eigenpairs belong to matrices, not to a shape")
    return operators(pairs.shape).mass


def functional_map_of(
    point_map: npt.ArrayLike,
    source: Shape | Operators | Eigenpairs,
    target: Shape | Operators | Eigenpairs,
    *,
    k: int = 50,
    orthogonal: bool = False,
) -> Floats:
    """The functional map that a point map T from source to target induces: functions on the target go back to the source.

    ``C = Φᵀ M (Ψ ∘ T)`` with the eigenfunctions Φ of the source and Ψ of the target: ``Φ C`` is the best approximation of
    ``Ψ[T]``, and a function with coefficients b on the target has the coefficients ``C b`` on the source.

    Parameters
    ----------
    point_map : (n,) int array
        Index in the target of each source point.
    source, target : TriangleMesh, PointCloud, Operators or Eigenpairs
    k : int
        How many eigenfunctions, including the constant one.
    orthogonal : bool
        Whether to return the nearest orthogonal matrix, as for a map that preserves areas.

    Returns
    -------
    (k, k) array

    Raises
    ------
    InputError
        Lengths do not fit, or an index is out of range.

    References
    ----------
    Ovsjanikov, Ben-Chen, Solomon, Butscher and Guibas, Functional maps: a flexible representation of maps between shapes, 2012.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> shape = bt.shapes.sphere(3)
    >>> bool(np.allclose(bt.functional_map_of(np.arange(642), shape, shape, k=9), np.eye(9)))
    True
    """
    k = arrays.whole(k, "k", 1)
    a, b = _eigenpairs(source, k, "the source"), _eigenpairs(target, k, "the target")
    image = checked_point_map(point_map, len(a.functions), len(b.functions))
    matrix: Floats = a.functions[:, :k].T @ (_mass(a)[:, None] * b.functions[image, :k])
    if orthogonal:
        left, _, right = np.linalg.svd(matrix)
        matrix = left @ right
    return matrix


def point_map_of(
    functional_map: npt.ArrayLike, source: Shape | Operators | Eigenpairs, target: Shape | Operators | Eigenpairs
) -> npt.NDArray[np.int32]:
    """The point map from source to target that fits a functional map C: nearest rows of Ψ for the rows of Φ C.

    Parameters
    ----------
    functional_map : (k, l) array
        From functions on the target (l eigenfunctions) to functions on the source (k), see :func:`functional_map_of`.
    source, target : TriangleMesh, PointCloud, Operators or Eigenpairs

    Returns
    -------
    (n,) int32 array
        Index in the target of each source point.

    Raises
    ------
    InputError
        The matrix has more rows or columns than there are eigenfunctions, or a number is not finite.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> shape = bt.shapes.sphere(3)
    >>> bool((bt.point_map_of(np.eye(9), shape, shape) == np.arange(642)).all())
    True
    """
    matrix = arrays.floats(functional_map, "functional_map", (None, None))
    if 0 in matrix.shape:
        raise InputError("functional_map is empty")
    a = _eigenpairs(source, matrix.shape[0], "the source")
    b = _eigenpairs(target, matrix.shape[1], "the target")
    rows, columns = matrix.shape
    return nearest_neighbors(b.functions[:, :columns], a.functions[:, :rows] @ matrix, 1)[0][:, 0]


def transfer(
    point_map: npt.ArrayLike,
    values: npt.ArrayLike,
    *,
    direction: Literal["to_source", "to_target"] = "to_source",
    target: Shape | None = None,
    weights: npt.ArrayLike | None = None,
) -> npt.NDArray[Any]:
    """Transfer values, colours or labels along a point map from source to target.

    Parameters
    ----------
    point_map : (n,) int array
        Index in the target of each source point.
    values : array
        A row per point: on the target for ``"to_source"``, on the source for ``"to_target"``. Integers and booleans are labels.
    direction : {"to_source", "to_target"}
        ``"to_source"``: each source point takes the value of its image. ``"to_target"``: each target point takes the weighted mean of
        the points mapped to it (for labels the most frequent one, in a tie the smallest), or if there are none, the value of the
        nearest point that has one.
    target : TriangleMesh or PointCloud
        Needed for ``"to_target"``: the number of points, and which are close.
    weights : (n,) array, optional
        For ``"to_target"``: weights of the source points, e.g. their masses.

    Returns
    -------
    array
        A row per point, of the same dtype (float64 for means).

    Raises
    ------
    InputError
        Lengths do not fit, an index is out of range, or ``target`` is missing.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> bt.transfer([2, 0, 0], [10.0, 20.0, 30.0])
    array([30., 10., 10.])
    >>> line = bt.PointCloud([[0.0], [1.0], [3.0]], dimension=1)
    >>> bt.transfer([2, 0, 0], [10.0, 20.0, 40.0], direction="to_target", target=line)
    array([30., 30., 10.])
    """
    table = np.asarray(values)
    if table.ndim == 0 or table.dtype.kind not in "buif":
        raise InputError("values needs a row of numbers or labels a point")
    if table.dtype.kind == "f" and not np.isfinite(table).all():
        row = int(np.flatnonzero(~np.isfinite(table.reshape(len(table), -1)).all(1))[0])
        raise InputError(f"values[{row}] is not finite; leave such points out of the map, or give them a number")
    if arrays.word(direction, "direction", ("to_source", "to_target")) == "to_source":
        image = arrays.indices(point_map, "point_map", len(table))
        return np.ascontiguousarray(table[image])
    if target is None:
        raise InputError("direction='to_target' needs target=, the shape that values are carried to")
    places = target.coordinates
    image = checked_point_map(point_map, len(table), len(places))
    share = np.ones(len(table)) if weights is None else arrays.floats(weights, "weights", (len(table),))
    if share.min() < 0:
        raise InputError("weights must be at least 0")
    total = np.bincount(image, weights=share, minlength=len(places))
    if not total.any():
        raise InputError("weights are all 0")
    hit = np.flatnonzero(total > 0)
    if table.dtype.kind in "bui":
        if table.ndim != 1:
            raise InputError(f"labels have shape {table.shape}; one per point is needed")
        names, numbers = np.unique(table, return_inverse=True)
        votes = scipy.sparse.csr_array((share, (image, numbers)), shape=(len(places), len(names)))
        result = np.zeros(len(places), table.dtype)
        result[hit] = names[np.asarray(votes[hit].argmax(axis=1)).ravel()]
    else:
        flat = arrays.floats(table.reshape(len(table), -1), "values", (len(table), None))
        sums = np.stack([np.bincount(image, weights=share * column, minlength=len(places)) for column in flat.T], 1)
        result = np.zeros(sums.shape)
        result[hit] = sums[hit] / total[hit, None]
        result = result.reshape(len(places), *table.shape[1:])
    if len(hit) < len(places):
        bare = np.flatnonzero(total <= 0)
        result[bare] = result[hit[nearest_neighbors(places[hit], places[bare], 1)[0][:, 0]]]
    return result


def geodesic_graph(shape: Shape | Operators) -> scipy.sparse.csr_array:
    """Edges with their lengths, and across each edge the straight way between the two opposite corners (its triangles unfolded).

    Shortest paths in it are never shorter than geodesics and about 2 % longer. For clouds the edges of the stiffness.
    """
    ops = operators(shape)
    places = ops.coordinates
    n = len(places)
    if not isinstance(ops.shape, TriangleMesh):
        pattern = scipy.sparse.coo_array(scipy.sparse.triu(ops.stiffness, 1))
        lengths = np.linalg.norm(places[pattern.row] - places[pattern.col], axis=1)
        return scipy.sparse.csr_array((np.maximum(lengths, 1e-300), (pattern.row, pattern.col)), shape=(n, n))
    faces = ops.shape.faces.astype(np.int64)
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    sides, opposite = sides[order], opposite[order]
    shared = np.flatnonzero((sides[1:] == sides[:-1]).all(1))
    start, end, left, right = sides[shared, 0], sides[shared, 1], opposite[shared], opposite[shared + 1]
    along = places[end] - places[start]
    length = np.linalg.norm(along, axis=1)

    def unfolded(corner: Indices) -> tuple[Floats, Floats]:
        offset = places[corner] - places[start]
        x = (offset * along).sum(1) / np.maximum(length, 1e-300)
        return x, np.sqrt(np.maximum((offset**2).sum(1) - x**2, 0.0))

    (x0, y0), (x1, y1) = unfolded(left), unfolded(right)
    crossing = x0 + (x1 - x0) * y0 / np.maximum(y0 + y1, 1e-300)
    straight = (crossing >= 0) & (crossing <= length) & (left != right)
    rows = np.concatenate([sides[:, 0], left[straight]])
    columns = np.concatenate([sides[:, 1], right[straight]])
    weights = np.concatenate([np.linalg.norm(places[sides[:, 0]] - places[sides[:, 1]], axis=1), np.hypot(x0 - x1, y0 + y1)[straight]])
    low, high = np.minimum(rows, columns), np.maximum(rows, columns)
    order = np.lexsort((weights, high, low))  # of several ways between the same ends the shortest
    low, high, weights = low[order], high[order], weights[order]
    first = np.ones(len(low), bool)
    first[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    return scipy.sparse.csr_array((np.maximum(weights[first], 1e-300), (low[first], high[first])), shape=(n, n))


@dataclass(frozen=True, eq=False, repr=False)
class MapEvaluation:
    """The quality of a point map, computed by :func:`evaluate_map`.

    Attributes
    ----------
    errors : (q,) array or None
        Geodesic distance on the target between image and truth over the root of the target's area, at the points evaluated; ``inf``
        on another component. None without a truth.
    coverage : float
        Share of the target's area that lies at points that are images.
    dirichlet_energy : float
        ``Σ_c ∫ |grad X_c|²`` of the image's coordinates, the target scaled to unit area: how rough the map is. 2 for an isometry onto
        a flat copy, more for bent ones.
    points : (q,) int array
        The source points that were evaluated.
    """

    errors: Floats | None
    coverage: float
    dirichlet_energy: float
    points: Indices

    @property
    def mean(self) -> float:
        """Mean error; NaN-free: ``inf`` without a truth."""
        return float(self.errors.mean()) if self.errors is not None else float("inf")

    @property
    def median(self) -> float:
        """Median error; ``inf`` without a truth."""
        return float(np.median(self.errors)) if self.errors is not None else float("inf")

    def curve(self, thresholds: npt.ArrayLike) -> Floats:
        """The share of points whose error is at most each threshold (the Princeton protocol's curve)."""
        wanted = arrays.floats(thresholds, "thresholds", (None,))
        if self.errors is None:
            raise InputError("the map was evaluated without a truth; there are no errors")
        return np.searchsorted(np.sort(self.errors), wanted, side="right") / len(self.errors)

    def __repr__(self) -> str:
        errors = "" if self.errors is None else f"mean error {self.mean:.4f}, median {self.median:.4f}, "
        return f"MapEvaluation({errors}coverage {self.coverage:.0%}, Dirichlet energy {self.dirichlet_energy:.3g})"


def evaluate_map(
    point_map: npt.ArrayLike,
    source: Shape | Operators,
    target: Shape | Operators,
    *,
    truth: npt.ArrayLike | None = None,
    points: npt.ArrayLike | int | None = None,
    rng: int | np.random.Generator | None = 0,
) -> MapEvaluation:
    """Score a point map: geodesic errors against the true map, coverage, Dirichlet energy.

    Parameters
    ----------
    point_map : (n,) int array
        Index in the target of each source point.
    source, target : TriangleMesh, PointCloud or Operators
    truth : (n,) int array, optional
        The correct index in the target of each source point.
    points : (q,) int array or int, optional
        Which source points to compare with the truth, or how many of them to draw at random. All by default.
    rng : int or numpy Generator, optional
        Seed or generator for drawing the points.

    Returns
    -------
    MapEvaluation

    Raises
    ------
    InputError
        Lengths do not fit, or an index is out of range.

    References
    ----------
    Kim, Lipman and Funkhouser, Blended intrinsic maps, 2011 (the protocol of the errors).

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> shape = bt.shapes.sphere(3)
    >>> found = bt.evaluate_map(np.arange(642), shape, shape, truth=np.arange(642))
    >>> found.mean, found.coverage
    (0.0, 1.0)
    """
    a, b = operators(source), operators(target)
    image = checked_point_map(point_map, len(a.mass), len(b.mass))
    area = float(b.mass.sum())
    places = b.coordinates[image]
    rough = float((places * (a.stiffness @ places)).sum()) / area
    chosen = np.arange(len(image)) if points is None or np.ndim(points) == 0 else arrays.indices(points, "points", len(image))
    if points is not None and np.ndim(points) == 0:
        chosen = np.sort(arrays.generator(rng).permutation(len(image))[: arrays.whole(points, "points", 1)])
    errors: Floats | None = None
    if truth is not None:
        right = checked_point_map(truth, len(a.mass), len(b.mass))
        errors = np.zeros(len(chosen))
        graph = geodesic_graph(b)
        wrong = np.flatnonzero(right[chosen] != image[chosen])
        for part in np.array_split(wrong, max(1, -(-len(wrong) // 200))):
            if len(part):
                errors[part] = _distances(graph, right[chosen[part]], image[chosen[part]]) / np.sqrt(area)
    return MapEvaluation(errors, coverage(image, b.mass), rough, chosen)


def _distances(graph: scipy.sparse.csr_array, sources: Indices, ends: Indices) -> Floats:
    from scipy.sparse.csgraph import dijkstra

    distances: Floats = dijkstra(graph, directed=False, indices=sources)[np.arange(len(sources)), ends]
    return distances


def coverage(point_map: npt.NDArray[Any], mass: Floats) -> float:
    """The share of the target's area (``mass``, one per point) that lies at images of a point map."""
    hit = np.zeros(len(mass), bool)
    hit[point_map] = True
    return float(mass[hit].sum() / mass.sum())
