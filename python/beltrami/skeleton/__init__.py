"""Skeletons of meshes and point clouds: Reeb graphs of an eigenfunction or of the eccentricity, drawn along the middle (section 8.3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy

from .. import _core, arrays
from ..arrays import Floats
from ..eigen import eigenpairs
from ..errors import InputError, TopologyError
from ..near import nearest_neighbors
from ..operators import Operators, operators
from ..progress import Progress, part, reporter
from ..shapes import PointCloud, Shape, TriangleMesh, no_shape
from .centerline import Drawing, center, descended, draw, section_of
from .complexes import Complex, Indices, cloud_complex, mesh_complex, unique_edges
from .functions import first_function
from .reeb import ReebGraph, SimplifiedGraph, reeb_graph
from .result import SkeletonResult

__all__ = ["SkeletonResult", "skeleton"]

FADING = 0.1  # relative distance to the sixth eigenvalue; copies of a multiple one lie up to .015 apart in a sphere of 500 points
CONSTANT = 0.1  # of its mean: up to this range an eccentricity shows the sampling; .08 on spheres of 500 points, .02 of 2,000
VARIED = 0.5  # and up to this it has no limbs: .5 on an ellipsoid of axes 1, 1, 1.3; .9 to 12 where there are limbs


def skeleton(
    shape: Shape | Operators,
    *,
    function: npt.ArrayLike | Literal["eigenfunction", "eccentricity", "geodesic"] | None = None,
    source: int | None = None,
    components: bool = True,
    shortest_limb: float = 0.04,
    remove_outliers: bool = False,
    progress: Progress = None,
) -> SkeletonResult:
    """Compute the skeleton of a shape: the Reeb graph of its first eigenfunction, or of its eccentricity, drawn along its middle.

    The first nontrivial eigenfunction of the Laplace-Beltrami operator varies along a shape from end to end; if it misses limbs, the
    eccentricity, computed from six eigenfunctions, replaces it. The connected components of its level sets are rings around limbs; their
    barycentres are nodes, and neighbouring rings are joined. So the graph branches and closes loops as the shape does.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        A surface. Clouds may be noisy (a note says what was done about it). Thin parts close to each other are told apart by normals,
        which are estimated if the cloud has none.
    function : array_like (n,), "eigenfunction", "eccentricity" or "geodesic", optional
        The function whose level sets are used: the first eigenfunction; the eccentricity, which is largest at the tips of all limbs; the
        geodesic distance from ``source``; or values, such as a height. By default the first eigenfunction, or the eccentricity if the
        eigenfunction misses prominent limbs (such as the legs between head and tail of an animal); a note says so.
    source : int, optional
        Vertex for ``function="geodesic"``; by default where the first eigenfunction is largest.
    components : bool
        Whether a shape may have several components, each of which gets its own skeleton.
    shortest_limb : float
        Limbs with a free end that are shorter than this share of the length of the function (the distance over which it goes from its
        minimum to its maximum) are cut, and so are all that are less than 1.6 times as long as wide. They are listed in ``cut``.
    remove_outliers : bool
        Leave out points of a cloud that are much farther from their neighbours than others are (beyond the mean and four deviations).
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    SkeletonResult

    Raises
    ------
    InputError
        There are too few points, the function is constant or not finite, or the shape is not a surface.
    TopologyError
        The shape has several components and ``components=False``.

    Notes
    -----
    On meshes the graph is exact: vertices are ordered by value and then by number, and there is a level between any two critical
    vertices, so that the loops are the handles of a closed oriented surface. Limbs are cut by length, loops never. On clouds loops
    that the sampling makes are cancelled: one side thinner than the sampling shows, or an arc and no ring. ``cancelled`` and
    ``stability`` say how sure that is.

    The eccentricity of a point is its mean squared biharmonic distance from all points, without the constant: the sum of
    φ_k² / λ_k² over the first six eigenfunctions. The seventh and eighth count the less the farther above the sixth eigenvalue theirs lie,
    from 10 % on nothing, so that the sum does not depend on which functions of a multiple eigenvalue come first. A limb stands out if it
    is longer than 8 % of the square root of the area, from where it leaves the body to its tip, and more than 2.5 % of the function high.

    Where eigenvalues up to 15 % above the first make a multiple one, the combination is taken whose slope varies least over the
    surface, and a note says so.

    References
    ----------
    Lai and Zhao, Multiscale nonrigid point cloud registration using rotation-invariant sliced-Wasserstein distance via
    Laplace-Beltrami eigenmap, 2017; Lai, Liang and Zhao, A local mesh method for solving PDEs on point clouds, 2013 (skeletons by level
    sets of eigenfunctions). Agarwal, Edelsbrunner, Harer and Wang, Extreme elevation on a 2-manifold, 2006 (extended persistence).

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.skeleton(bt.shapes.torus()).cycles
    1
    """
    report = reporter(progress, "skeleton")
    shortest_limb = arrays.number(shortest_limb, "shortest_limb", least=0.0)
    notes: list[str] = []
    given = shape.shape if isinstance(shape, Operators) else shape
    if not isinstance(given, TriangleMesh | PointCloud):
        raise no_shape(given)
    count = len(given.coordinates)
    if count < 10:
        raise InputError(f"{count} points are too few for a skeleton; 10 or more are needed")
    values = _values(given, function, source, count)
    if isinstance(given, PointCloud):
        if given.dimension != 2:
            raise InputError(f"skeletons are made of surfaces; this cloud has dimension {given.dimension}")
        cloud, chosen = given, np.arange(count)
        if remove_outliers:
            chosen = _inliers(given.points)
            notes.append(f"{count - len(chosen)} outliers were left out")
            normals = None if given.normals is None else given.normals[chosen]
            cloud = PointCloud(given.points[chosen], dimension=2, normals=normals)
        complex_ = cloud_complex(cloud, notes, part(report, 0.0, 0.4))
        complex_.origin = chosen[complex_.origin]
    else:
        complex_ = mesh_complex(operators(shape))
    labels = _pieces(complex_, components, notes)
    parts = []
    function_out = np.full(count, np.nan) if values is None else values.copy()
    eigenvalues = np.zeros(0)
    for name in range(int(labels.max()) + 1):
        members = np.flatnonzero(labels == name)
        piece = complex_ if len(members) == len(labels) else _restricted(complex_, members)
        if values is None:
            f, cut, found = _intrinsic(piece, function, shortest_limb, notes, report)
            if name == 0:
                eigenvalues = found
            function_out[piece.origin] = f
        else:
            cut = _cut(piece, np.ascontiguousarray(values[piece.origin]), shortest_limb, part(report, 0.7, 0.9))
        parts.append(_one(piece, cut, given, notes))
    return _assembled(given, complex_, labels, parts, function_out, eigenvalues, notes)


def _intrinsic(complex_: Complex, function: Any, shortest_limb: float, notes: list[str], report: Any) -> tuple[Floats, _Cut, Floats]:
    """The first eigenfunction of a connected complex or its eccentricity, the graph of it, and the eigenvalues.

    If none is asked for: the eigenfunction, unless limbs stand out that it runs past.
    """
    count = min(9, len(complex_.mass))
    matrix = arrays.csr_in(complex_.stiffness, "the stiffness")
    pairs = _core.eigenpairs(matrix, complex_.mass, None, count, None, complex_.points, None, part(report, 0.4, 0.7))
    values, functions = pairs[0][1:], pairs[1][:, 1:]
    # free of units; six, and those after them fade as they get farther: all copies of a multiple eigenvalue count, or none
    weights = (values[0] / values) ** 2 * np.clip(1 - (values / values[:6][-1] - 1) / FADING, 0.0, 1.0)
    centric = (functions / np.abs(functions[:, :6]).max()) ** 2 @ weights
    values, functions = values[:6], functions[:, :6]
    varied = np.ptp(centric) * complex_.mass.sum() / max(float(complex_.mass @ centric), 1e-300)
    if function == "eccentricity" and varied > CONSTANT:
        return centric, _cut(complex_, centric, shortest_limb, part(report, 0.7, 0.9)), values
    said: list[str] = []
    first = first_function(complex_, values, functions, said)
    cut = _cut(complex_, first, shortest_limb, part(report, 0.7, 0.8))
    if function == "eccentricity":
        notes.append("the eccentricity is constant on a piece, but for its sampling; its first eigenfunction was taken")
    if function is None and varied > VARIED:
        other = _cut(complex_, centric, shortest_limb, part(report, 0.8, 0.9))
        missed = other.simple.beyond(cut.simple, float(np.sqrt(complex_.mass.sum())))
        # on clouds a function whose levels run along the handles may lose them
        if missed and len(other.kept) == len(cut.kept) and len(other.simple.tips()) > len(cut.simple.tips()):
            notes.append(f"the first eigenfunction runs past {missed} limbs, so the eccentricity was taken")
            return centric, other, values
    notes += said
    return first, cut, values


def _values(given: Shape, function: Any, source: int | None, count: int) -> Floats | None:
    if isinstance(function, str):
        if function not in ("eigenfunction", "eccentricity", "geodesic"):
            raise InputError(f"function is {function!r}; choose 'eigenfunction', 'eccentricity', 'geodesic' or give an array")
        if function == "geodesic":
            from ..geodesic import geodesic_distance

            if source is None:
                ops = operators(given)
                source = int(np.argmax(eigenpairs(ops, 2).functions[:, 1]))
            values = geodesic_distance(given, arrays.whole(source, "source", 0, count - 1))
            if not np.isfinite(values).all():
                raise TopologyError("distances are infinite on pieces without the source; hand in a function, or one piece")
            return values
        function = None
    if source is not None:
        raise InputError("source= goes with function='geodesic'")
    return None if function is None else arrays.floats(function, "function", (count,))


def _inliers(points: Floats) -> Indices:
    distances = nearest_neighbors(points, points, min(9, len(points)))[1][:, 1:].mean(1)
    return np.flatnonzero(distances <= distances.mean() + 4 * distances.std())


def _pieces(complex_: Complex, components: bool, notes: list[str]) -> Indices:
    """Number of the piece of each point; -1 in no piece, or in one too small to be more than a stray of a cloud."""
    n = len(complex_.points)
    a, b = complex_.edges.T
    graph = scipy.sparse.coo_array((np.ones(len(a)), (a, b)), shape=(n, n))
    number, labels = scipy.sparse.csgraph.connected_components(graph, directed=False)
    sizes = np.bincount(labels, minlength=number)
    least = 4 if complex_.is_mesh else max(10, int(0.01 * n))
    kept = np.flatnonzero(sizes >= least)
    if len(kept) == 0:
        raise InputError(f"no connected piece has {least} points or more: there is nothing to find a skeleton of")
    if len(kept) < number:
        lost = int(n - sizes[kept].sum())
        notes.append(f"{number - len(kept)} pieces of fewer than {least} points ({lost} points in all) have no skeleton of their own")
    if len(kept) > 1 and not components:
        raise TopologyError(f"the shape has {len(kept)} connected pieces; components=True makes a skeleton of each")
    rename = np.full(number, -1)
    rename[kept] = np.arange(len(kept))
    pieces: Indices = rename[labels]
    return pieces


def _restricted(complex_: Complex, members: Indices) -> Complex:
    new = np.full(len(complex_.points), -1, np.int32)
    new[members] = np.arange(len(members), dtype=np.int32)
    cells = new[complex_.cells]
    edges = new[complex_.edges]
    matrix = scipy.sparse.csr_array(complex_.stiffness[members][:, members])
    return Complex(
        np.ascontiguousarray(complex_.points[members]),
        np.ascontiguousarray(cells[(cells >= 0).all(1)]),
        edges[(edges >= 0).all(1)],
        complex_.spacing,
        np.ascontiguousarray(complex_.weights[members]),
        matrix,
        complex_.mass[members],
        complex_.origin[members],
        complex_.sources,
    )


@dataclass
class _Part:
    drawing: Drawing
    graph: ReebGraph
    owners: Indices  # node of each point of the complex
    cut: list[float]
    cancelled: list[float]
    kept: list[float]
    counts: tuple[int, int, int]


@dataclass
class _Cut:
    graph: ReebGraph
    simple: SimplifiedGraph
    counts: tuple[int, int, int]
    exact: bool
    cancelled: list[float]
    kept: list[float]


def _cut(complex_: Complex, values: Floats, shortest_limb: float, report: Any) -> _Cut:
    """The Reeb graph of a function, whole and without stubs."""
    middle, half = values.max() / 2 + values.min() / 2, values.max() / 2 - values.min() / 2
    if not half > 0:
        raise InputError("the function is constant on a connected piece of the shape; hand in one that varies")
    graph, length, step, counts, exact = reeb_graph(complex_, (values - middle) / half, report)  # from -1 to 1: no scale is too large
    cancelled = [] if complex_.is_mesh else graph.cancel_loops(complex_.spacing, step)
    kept = [loop[0] for loop in graph.loops()]
    simple = SimplifiedGraph(graph)
    simple.prune(shortest_limb * length)
    simple.contract()
    return _Cut(graph, simple, counts, exact, cancelled, kept)


def _one(complex_: Complex, cut: _Cut, shape: Shape, notes: list[str]) -> _Part:
    graph, simple = cut.graph, cut.simple
    if not cut.exact:
        notes.append(f"the function has {sum(cut.counts)} critical vertices, too many for a level between any two: loops may be missing")
    drawing = draw(simple, complex_.spacing, isinstance(shape, TriangleMesh) and not shape.is_closed)
    owners = drawing.node_of_group[graph.group_of_vertex()]
    owners = descended(drawing, complex_.points, owners)
    if complex_.points.shape[1] == 3:
        center(drawing, section_of(complex_, drawing, owners, shape))
        owners = descended(drawing, complex_.points, owners)
    return _Part(drawing, graph, owners, simple.cut, cut.cancelled, cut.kept, cut.counts)


def _ordered(points: Floats, center: Floats) -> Floats:
    """Points by their angle around the middle, in the plane in which they spread most."""
    if len(points) < 3:
        return points
    around = points - center
    axes = np.linalg.eigh(around.T @ around)[1][:, ::-1]
    return points[np.argsort(np.arctan2(around @ axes[:, 1], around @ axes[:, 0]), kind="stable")]


def _assembled(
    shape: Shape, complex_: Complex, labels: Indices, parts: list[_Part], function: Floats, eigenvalues: Floats, notes: list[str]
) -> SkeletonResult:
    nodes, radii, limbs, contours, pieces = [], [], [], [], []
    owners = np.full(len(complex_.points), -1)
    start = 0
    for name, piece in enumerate(parts):
        drawing, graph = piece.drawing, piece.graph
        nodes.append(drawing.nodes)
        radii.append(drawing.radii)
        limbs += [np.array(chain, np.int32) + np.int32(start) for chain in drawing.chains]
        owners[labels == name] = piece.owners + start
        group_of: dict[int, int] = {}
        offset = np.linalg.norm(graph.centers - drawing.nodes[drawing.node_of_group], axis=1)
        for group in np.argsort(-offset, kind="stable").tolist():
            group_of[int(drawing.node_of_group[group])] = group
        order = np.argsort(graph.point_group, kind="stable")
        bounds = np.searchsorted(graph.point_group[order], np.arange(len(graph.centers) + 1))
        for node in range(len(drawing.nodes)):
            group = group_of.get(node)
            if group is None:
                contours.append(np.zeros((0, complex_.points.shape[1])))
            else:
                contours.append(_ordered(graph.points[order[bounds[group] : bounds[group + 1]]], graph.centers[group]))
        pieces += [name] * len(drawing.nodes)
        start += len(drawing.nodes)
    places = np.concatenate(nodes)
    coordinates = shape.coordinates
    node_of_point = np.full(len(coordinates), -1)
    node_of_point[complex_.origin] = owners
    missing = np.flatnonzero(node_of_point < 0)
    if len(missing):
        known = np.flatnonzero(owners >= 0)
        nearest = nearest_neighbors(np.ascontiguousarray(complex_.points[known]), coordinates[missing], 1)[0][:, 0]
        node_of_point[missing] = owners[known[nearest]]
        unknown = np.isnan(function[missing])  # the user's own values stay
        function[missing[unknown]] = function[complex_.origin[known[nearest[unknown]]]]
    pairs = np.concatenate([np.stack([limb[:-1], limb[1:]], 1) for limb in limbs]) if limbs else np.zeros((0, 2), np.int32)
    edges = unique_edges(pairs[pairs[:, 0] != pairs[:, 1]])
    limb_of_node = np.full(len(places), -1, np.int32)
    for number in range(len(limbs) - 1, -1, -1):
        limb_of_node[limbs[number]] = number
    degrees = np.bincount(edges.ravel(), minlength=len(places))
    cancelled = np.array([height for piece in parts for height in piece.cancelled])
    kept = [height for piece in parts for height in piece.kept]
    minima, saddles, maxima = (sum(piece.counts[k] for piece in parts) for k in range(3))
    cut = np.array([ratio for piece in parts for ratio in piece.cut])
    return SkeletonResult(
        shape=shape,
        nodes=places,
        edges=edges,
        radii=np.concatenate(radii),
        leaves=int((degrees == 1).sum()),
        cycles=len(edges) - len(places) + len(parts),
        node_of_point=node_of_point.astype(np.int32),
        limbs=limbs,
        limb_of_node=limb_of_node,
        components=np.array(pieces, np.int32),
        contours=contours,
        function=arrays.read_only(function),
        eigenvalues=eigenvalues,
        critical=(minima, saddles, maxima),
        cut=cut,
        cancelled=cancelled,
        stability=(float(cancelled.max(initial=0.0)), float(min(kept, default=np.inf))),
        notes=tuple(notes),
    )
