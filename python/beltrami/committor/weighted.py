"""Linear elements for ``∫ exp(-U) |grad u|²`` on a shape, with which committors are computed.

U is known at the points and, as a quadratic along each edge, between them. An edge carries the harmonic mean of ``exp(-U)`` along it,
which makes the flux through it exact wherever U varies along the edge only (Scharfetter and Gummel 1969).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from ..arrays import Floats
from ..clouds import CloudOperators
from ..errors import InputError
from ..near import nearest_neighbors
from ..operators import Operators, operators
from ..shapes import TriangleMesh

Longs = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

STEEP = 0.75  # a neighbour whose normal component is a greater part of its distance lies on another sheet, as in the core
FIT = {1: 8, 2: 24, 3: 48}  # neighbours of the polynomial fits, by dimension
RIDGE = 1e-3  # how much of their own size is added to the squares of the fits' cubic terms; quadratic ones get its square
DOUBT = 2.0  # so far, in units of kT, what both ends of an edge say of U at its middle may be apart
LAST = 0.05  # over which part of the squared distance the weight of neighbours falls to 0 in the end
CHUNK = 16384  # points fitted at a time: a bound on memory
SHORTEST = 1e-9  # least share of an edge that is left by the cut at the rim of A or B: of nodes on it rounding decides whether they belong
CLOSEST = 0.05  # the same of edges from A to B, whose rims may touch: there the rate would have no end
ON_RIM = 0.05  # points of a set count as lying on its rim if they are this straight, in units of the spacing


# --- polynomial fits at the points -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fit:
    """Polynomials that interpolate a function at each point and fit it at the neighbours, in tangential coordinates."""

    points: Floats
    frames: Floats
    values: Floats
    reach: Floats
    coefficients: Floats
    degree: int

    def at(self, base: npt.NDArray[Any], places: Floats) -> Floats:
        """Values at ``places`` of the polynomials of the points ``base``."""
        offset = places - self.points[base]
        t = np.einsum("eD,edD->ed", offset, self.frames[base]) / self.reach[base][:, None]
        found: Floats = self.values[base] + np.einsum("ep,ep->e", monomials(t, self.degree), self.coefficients[base])
        return found

    @property
    def gradients(self) -> Floats:
        """(n, D)."""
        d = self.frames.shape[1]
        found: Floats = np.einsum("nd,ndD->nD", self.coefficients[:, :d] / self.reach[:, None], self.frames)
        return found


def monomials(t: Floats, degree: int) -> Floats:
    """All monomials of degree 1 to ``degree`` (at most 3) of the last axis; the linear ones first."""
    d = t.shape[-1]
    columns = [t[..., a] for a in range(d)]
    if degree >= 2:
        columns += [t[..., a] * t[..., b] for a in range(d) for b in range(a, d)]
    if degree >= 3:
        columns += [t[..., a] * t[..., b] * t[..., c] for a in range(d) for b in range(a, d) for c in range(b, d)]
    return np.stack(columns, -1)


def fit(ops: CloudOperators, values: Floats, degree: int = 3, known: Mask | None = None) -> Fit:
    """Fits a function at every point of a cloud, to the neighbours that are ``known`` (all by default)."""
    points, frames, d = ops.shape.points, ops.frames, ops.shape.dimension
    count = min(FIT[d], len(points) - 1)
    while degree > 1 and math.comb(d + degree, d) - 1 > 0.7 * count:
        degree -= 1
    indices, distances = nearest_neighbors(points, points, count + 1)
    reach = distances[:, -1]
    terms = math.comb(d + degree, d) - 1
    coefficients = np.empty((len(points), terms))
    diagonal = np.arange(terms)
    # what few points beside each other cannot tell is flat: cubic terms give way to quadratic ones, these to linear ones
    ridge = np.full(terms, RIDGE)
    ridge[:d] = 0.0
    ridge[d : d + d * (d + 1) // 2] = RIDGE * RIDGE
    for start in range(0, len(points), CHUNK):
        part = slice(start, min(start + CHUNK, len(points)))
        near, distance = indices[part], distances[part]
        offset = points[near] - points[part, None]
        t = np.matmul(offset, frames[part].transpose(0, 2, 1))
        square = np.square(distance)
        same_sheet = np.square(t).sum(2) >= (1 - STEEP * STEEP) * square
        share = square / np.square(reach[part])[:, None]
        # of neighbours that are equally far, as on grids, rounding decides which is the last: those do not count
        weight = np.exp(-3.0 * share) * np.clip((1 - share) / LAST, 1e-9, 1.0) * same_sheet
        if known is not None:
            weight = weight * known[near]
        basis = monomials(t / reach[part][:, None, None], degree)
        weighted = basis * weight[:, :, None]
        matrix = np.matmul(weighted.transpose(0, 2, 1), basis)
        right = np.matmul(weighted.transpose(0, 2, 1), (values[near] - values[part, None])[:, :, None])
        size = np.maximum(np.trace(matrix, axis1=1, axis2=2), 1e-300)[:, None]
        matrix[:, diagonal, diagonal] += ridge * matrix[:, diagonal, diagonal] + 1e-9 * size
        coefficients[part] = np.linalg.solve(matrix, right)[:, :, 0]
    return Fit(points, frames, values, reach, coefficients, degree)


def smoothed(ops: CloudOperators, values: Floats, known: Floats, neighbors: int, degree: int = 3) -> Floats:
    """Values at the points of polynomials fitted around each, points of weight ``known``; not interpolating."""
    points, frames, d = ops.shape.points, ops.frames, ops.shape.dimension
    count = min(neighbors, len(points) - 1)
    while degree > 0 and 3 * math.comb(d + degree, d) > count:
        degree -= 1
    indices, distances = nearest_neighbors(points, points, count + 1)
    found = np.empty(len(points))
    chunk = max(1, CHUNK * FIT[d] // count)
    for start in range(0, len(points), chunk):
        part = slice(start, min(start + chunk, len(points)))
        near, share = indices[part], distances[part] / distances[part, -1:]
        t = np.matmul(points[near] - points[part, None], frames[part].transpose(0, 2, 1)) / distances[part, -1:, None]
        same_sheet = np.square(t).sum(2) >= (1 - STEEP * STEEP) * np.square(share)
        weight = np.maximum(1 - np.square(share), 0) * known[near] * same_sheet
        ones = np.ones((*near.shape, 1))
        basis = np.concatenate([ones, monomials(t, degree)], 2) if degree else ones
        weighted = (basis * weight[:, :, None]).transpose(0, 2, 1)
        matrix, right = np.matmul(weighted, basis), np.matmul(weighted, values[near][:, :, None])
        size = matrix[:, 0, 0]
        slopes = np.arange(1, matrix.shape[1])
        matrix[:, slopes, slopes] += 1e-4 * np.maximum(size, 1e-9)[:, None]  # where little is known the fit is flat
        empty = size <= 0
        matrix[empty, 0, 0] = 1.0
        right[empty, 0, 0] = values[part][empty]
        found[part] = np.linalg.solve(matrix, right)[:, 0, 0]
    return found


# --- elements ----------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Elements:
    """Simplices on points, with everything that lives on points (``potential``, ``levels``) and edges (``bow``).

    ``pairs[s, p]`` is the edge of simplex s between the p-th pair of its corners, in the order of ``numpy.triu_indices``.
    ``conduction[s, p]`` is its part of minus the stiffness, ``bow`` how far U at an edge's middle exceeds the mean of its ends.
    """

    points: Floats
    simplices: Longs
    share: Floats  # votes / (d + 1)
    first: Longs
    second: Longs
    pairs: Longs
    conduction: Floats
    volumes: Floats
    sides: Floats  # squared lengths, (m, pairs)
    potential: Floats
    bow: Floats
    levels: tuple[Floats, Floats]
    mended: Mask  # simplices whose conduction was changed so that no edge conducts less than nothing

    @property
    def mass(self) -> Floats:
        d = self.simplices.shape[1] - 1
        parts = np.repeat(self.volumes / (d + 1), d + 1)
        return np.bincount(self.simplices.ravel(), parts, len(self.points)).astype(np.float64)

    @property
    def edge_conduction(self) -> Floats:
        return np.bincount(self.pairs.ravel(), self.conduction.ravel(), len(self.first)).astype(np.float64)

    def edge_weights(self) -> Floats:
        return harmonic_mean(self.potential[self.first], self.potential[self.second], self.bow)


def harmonic_mean(one: Floats, other: Floats, bow: Floats) -> Floats:
    """1 / mean of ``exp(U)`` along edges; U is linear between its ends plus ``4 s (1 - s) bow``."""
    low, z = np.minimum(one, other), np.abs(one - other)
    steep = z > 1e-5
    safe = np.where(steep, z, 1.0)
    linear = np.exp(-low) * np.where(steep, safe / np.expm1(np.minimum(safe, 700.0)), 1 - z / 2)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    nodes = (nodes + 1) / 2
    excess = np.zeros_like(z)
    decay = np.exp(-safe)
    for y, weight in zip(nodes**2, nodes * weights, strict=True):
        # the mean under the density exp(z s): by its quantiles s(y), whose logarithm at y = 0 the square softens
        s = np.where(steep, 1 + np.log(y + (1 - y) * decay) / safe, y)
        excess += weight * np.exp(np.clip(4 * s * (1 - s) * bow, -100, 100))
    return linear / excess


def geometry(points: Floats, simplices: Longs, share: Floats) -> tuple[Floats, Floats, Floats]:
    """Conduction of each pair of corners, volumes times ``share``, squared lengths. Simplices without volume conduct nothing."""
    d = simplices.shape[1] - 1
    a, b = np.triu_indices(d + 1, 1)
    corners = points[simplices]
    sides = np.square(corners[:, a] - corners[:, b]).sum(2)
    if d == 1:
        volume = np.sqrt(sides[:, 0])
        conduction = np.divide(1.0, volume, out=np.zeros_like(volume), where=volume > 0)[:, None]
    elif d == 2:
        largest = sides.max(1)
        ab, ac, bc = (sides / np.maximum(largest, 1e-300)[:, None]).T
        double = np.sqrt(np.maximum(ab * ac - np.square(ab + ac - bc) / 4, 0))
        double[double <= 1e-14] = 0
        inverse = np.divide(0.25, double, out=np.zeros_like(double), where=double > 0)
        # half the cotangent of the corner opposite to each side
        conduction = np.stack([ac + bc - ab, ab + bc - ac, ab + ac - bc], 1) * inverse[:, None]
        volume = double * largest / 2
    else:
        edges = corners[:, 1:] - corners[:, :1]
        size = np.maximum(np.sqrt(sides.max(1)), 1e-150)
        edges = edges / size[:, None, None]
        gram = np.matmul(edges, edges.transpose(0, 2, 1))
        determinant = np.linalg.det(gram)
        sound = determinant > 1e-14 * np.prod(np.einsum("saa->sa", gram), axis=1)
        gram[~sound] = np.eye(d)
        inner = np.linalg.inv(gram)
        products = np.empty((len(simplices), d + 1, d + 1))
        products[:, 1:, 1:] = inner
        products[:, 0, 1:] = products[:, 1:, 0] = -inner.sum(1)
        products[:, 0, 0] = inner.sum((1, 2))
        volume = np.where(sound, np.sqrt(np.maximum(determinant, 0)) / math.factorial(d), 0) * size**d
        conduction = -products[:, a, b] * (volume / size**2)[:, None]
    return conduction * share[:, None], volume * share, sides


def number_edges(simplices: Longs, count: int) -> tuple[Longs, Longs, Longs]:
    """Ends of each edge, the lesser first, and the edge of each pair of corners of each simplex."""
    a, b = np.triu_indices(simplices.shape[1], 1)
    one, other = simplices[:, a].ravel(), simplices[:, b].ravel()
    keys, where = np.unique(np.minimum(one, other) * count + np.maximum(one, other), return_inverse=True)
    return keys // count, keys % count, where.reshape(len(simplices), -1)


Function = Callable[[Floats], Floats]


def elements(ops: Operators, potential: Floats, exact: Function | None, levels: tuple[Floats, Floats]) -> Elements:
    """The elements of a shape. ``potential`` is β U, least value 0; ``exact`` the same as a function of positions, if there is one."""
    if isinstance(ops, CloudOperators):
        points, simplices = ops.shape.points, ops.simplices.astype(np.int64)
        share = ops.votes / (ops.shape.dimension + 1)
    elif isinstance(ops.shape, TriangleMesh):
        points, simplices = ops.shape.vertices, ops.shape.faces.astype(np.int64)
        proper = (simplices[:, 0] != simplices[:, 1]) & (simplices[:, 1] != simplices[:, 2]) & (simplices[:, 2] != simplices[:, 0])
        simplices = simplices[proper]
        share = np.ones(len(simplices))
    else:
        raise InputError(f"committors are solved on meshes and on local meshes of clouds, not on laplacian={ops.kind!r}")
    first, second, pairs = number_edges(simplices, len(points))
    conduction, volumes, sides = geometry(points, simplices, share)
    found = Elements(
        points, simplices, share, first, second, pairs, conduction, volumes, sides, potential,
        np.zeros(len(first)), levels, np.zeros(len(simplices), bool),
    )  # fmt: skip
    return replace(found, bow=_bows(ops, found, exact))


def gradients(ops: Operators, values: Floats, known: Mask | None = None) -> Floats:
    """(n, D): gradient at the points, fitted for clouds, averaged over triangles for meshes; from the values that are ``known``."""
    if isinstance(ops, CloudOperators):
        return fit(ops, values, known=known).gradients
    if not isinstance(ops.shape, TriangleMesh):
        raise InputError(f"no gradients at the points of laplacian={ops.kind!r}")
    # of the triangles in space, whatever triangulation the stiffness comes from
    flat = ops if ops.kind == "cotangent" else operators(ops.shape, laplacian="cotangent")
    faces, areas = ops.shape.faces, flat.simplex_areas
    slopes = (flat.simplex_gradient @ values).reshape(len(faces), -1)
    if known is not None:
        areas = areas * known[faces].all(1)
    total = np.bincount(faces.ravel(), np.repeat(areas, 3), len(values))
    found = np.stack([np.bincount(faces.ravel(), np.repeat(areas * s, 3), len(values)) for s in slopes.T], 1)
    return np.asarray(found / np.where(total > 0, total, 1.0)[:, None], float)


def _bows(ops: Operators, mesh: Elements, exact: Function | None) -> Floats:
    """How far U at the middles exceeds the mean of the ends: of the cubic along the edge with U's values and slopes at both."""
    i, j = mesh.first, mesh.second
    rise = mesh.potential[j] - mesh.potential[i]
    if exact is not None:
        return exact(middles(ops, mesh)) - (mesh.potential[i] + mesh.potential[j]) / 2
    slopes, step = gradients(ops, mesh.potential), mesh.points[j] - mesh.points[i]
    one, other = (np.einsum("eD,eD->e", slopes[i], step) - rise) / 4, (rise - np.einsum("eD,eD->e", slopes[j], step)) / 4
    trusted = np.abs(one - other) <= DOUBT + np.abs(one + other) / 2
    return np.where(trusted, (one + other) / 2, _agreed(one, other))


def _agreed(one: Floats, other: Floats) -> Floats:
    """The mean where both agree, near the smaller one where not, 0 where their signs differ (van Albada's limiter)."""
    product = one * other
    square = one * one + other * other
    found: Floats = np.where(product > 0, product * (one + other) / np.where(square > 0, square, 1.0), 0.0)
    return found


def middles(ops: Operators, mesh: Elements) -> Floats:
    """Middles of the edges; those of clouds are lifted to the surface that the curvatures at both ends suggest."""
    i, j = mesh.first, mesh.second
    middle = (mesh.points[i] + mesh.points[j]) / 2
    if not isinstance(ops, CloudOperators) or ops.shape.dimension == ops.shape.points.shape[1]:
        return middle
    if len(mesh.points) > len(ops.coordinates):  # at further refinements the triangles are small enough to be flat
        return middle
    step = mesh.points[j] - mesh.points[i]
    lift = np.zeros_like(middle)
    for end in (i, j):
        t = np.einsum("eD,edD->ed", step, ops.frames[end])
        lift -= np.einsum("ea,eb,eabD->eD", t, t, ops.second_fundamental_form[end], optimize=True) / 16
    size = np.linalg.norm(lift, axis=1)
    limit = 0.2 * np.linalg.norm(step, axis=1)
    lift *= np.divide(limit, size, out=np.ones_like(size), where=size > limit)[:, None]
    return middle + lift


def split(ops: Operators, mesh: Elements, exact: tuple[Function | None, Function | None]) -> Elements:
    """Every triangle in four, by the middles of its sides; in an obtuse one the longest side's middle is joined to the corner opposite.

    U stays the same quadratic on each triangle. ``exact`` are the level functions of A and B, where there are such.
    """
    n, (i, j) = len(mesh.points), (mesh.first, mesh.second)
    middle = middles(ops, mesh)
    points = np.concatenate([mesh.points, middle])
    potential = np.concatenate([mesh.potential, (mesh.potential[i] + mesh.potential[j]) / 2 + mesh.bow])
    levels = tuple(
        np.concatenate([level, (level[i] + level[j]) / 2 if function is None else function(middle)])
        for level, function in zip(mesh.levels, exact, strict=True)
    )
    # sides opposite to the corners: pairs run (0, 1), (0, 2), (1, 2)
    opposite, squares = n + mesh.pairs[:, ::-1], mesh.sides[:, ::-1]
    obtuse = 2 * squares.max(1) > squares.sum(1) * (1 + 1e-9)
    plain, bent = np.flatnonzero(~obtuse), np.flatnonzero(obtuse)
    t, e = mesh.simplices[plain], opposite[plain]
    apex = squares[bent].argmax(1)
    a, b, c = (mesh.simplices[bent, (apex + k) % 3] for k in range(3))
    ea, eb, ec = (opposite[bent, (apex + k) % 3] for k in range(3))
    children = [
        np.stack([t[:, 0], e[:, 2], e[:, 1]], 1), np.stack([t[:, 1], e[:, 0], e[:, 2]], 1), np.stack([t[:, 2], e[:, 1], e[:, 0]], 1), e,
        np.stack([a, ec, ea], 1), np.stack([a, ea, eb], 1), np.stack([b, ea, ec], 1), np.stack([c, eb, ea], 1),
    ]  # fmt: skip
    simplices = np.concatenate(children)
    parents = np.concatenate([plain] * 4 + [bent] * 4)
    share = mesh.share[parents]
    first, second, pairs = number_edges(simplices, len(points))
    conduction, volumes, sides = geometry(points, simplices, share)
    # U's bow on the new edges: a quarter on halves; the rest from the quadratic on the triangle
    low = first[pairs]
    crossing = np.maximum(second[pairs] - n, 0)  # the old edge whose middle the second end is
    around = mesh.bow[mesh.pairs[parents]].sum(1)[:, None]
    of_crossing = mesh.bow[crossing]
    half = (low < n) & ((i[crossing] == low) | (j[crossing] == low))
    median = (around - of_crossing) / 2 - of_crossing / 4
    parallel = (around - of_crossing - mesh.bow[np.maximum(low - n, 0)]) / 4
    bows = np.where(half, of_crossing / 4, np.where(low < n, median, parallel))
    bow = np.zeros(len(first))
    bow[pairs.ravel()] = bows.ravel()
    return Elements(
        points, simplices, share, first, second, pairs, conduction, volumes, sides, potential, bow, (levels[0], levels[1]),
        mesh.mended[parents],
    )  # fmt: skip


def mend(mesh: Elements, only: Mask | None = None) -> Elements:
    """No edge conducts less than nothing: then 0 <= q <= 1 whatever U is.

    A triangle that is obtuse at a corner pulls the side opposite below zero, which matters where nothing lies beyond it (at the rim of a
    cloud). Its two other sides then carry what the triangle conducts: c = area / (a (a + t b)), with a, b their lengths and t minus the
    cosine of the angle between; this is the element's own where the angle is right, and a chain of two where it is straight. In other
    dimensions the conduction of such an edge counts as 0. ``only``: simplices that may be changed.
    """
    conduction, mended = mesh.conduction.copy(), mesh.mended.copy()
    allowed = np.ones(len(conduction), bool) if only is None else only
    edges = len(mesh.first)
    for _ in range(64):
        total = np.bincount(mesh.pairs.ravel(), conduction.ravel(), edges)
        size = np.bincount(mesh.pairs.ravel(), np.abs(conduction).ravel(), edges)
        bad = total < -1e-13 * size
        simplex, pair = np.nonzero(bad[mesh.pairs] & (conduction < 0) & allowed[:, None])
        if len(simplex) == 0:
            break
        mended[simplex] = True
        if mesh.simplices.shape[1] == 3:
            one, other = (pair + 1) % 3, (pair + 2) % 3
            aa, bb = mesh.sides[simplex, one], mesh.sides[simplex, other]
            a, b = np.sqrt(aa), np.sqrt(bb)
            turn = np.clip((mesh.sides[simplex, pair] - aa - bb) / (2 * a * b), 0, 1)
            conduction[simplex, one] = mesh.volumes[simplex] / (a * (a + turn * b))
            conduction[simplex, other] = mesh.volumes[simplex] / (b * (b + turn * a))
        conduction[simplex, pair] = 0
    return replace(mesh, conduction=conduction, mended=mended)


# --- the rims of A and B -----------------------------------------------------------------------------------------------------------


def level_of_set(points: Floats, inside: Mask, other: Mask, mesh_edges: tuple[Any, Any], dimension: int) -> Floats:
    """A level function of a set known by its members: half the distance to the set less that to the rest; 0 inside where the members
    lie on the set's rim, are single points, or are next to members of the ``other`` set, which rims half-way between would touch."""
    outward = nearest_neighbors(points[inside], points, 1)[1][:, 0]
    if not inside.all():
        inward = nearest_neighbors(points[~inside], points, 1)[1][:, 0]
    else:
        return -outward
    i, j = mesh_edges
    alone = not (inside[i] & inside[j]).any()
    touching = ((inside[i] & other[j]) | (other[i] & inside[j])).any()
    if alone or touching or _on_rim(points, inside, mesh_edges, dimension):
        return outward
    return (outward - inward) / 2


def _on_rim(points: Floats, inside: Mask, edges: tuple[Any, Any], dimension: int) -> bool:
    """Whether the outermost members of a set lie in a row: then someone put them there, and the set ends at them, not beyond."""
    i, j = edges
    crossing = inside[i] != inside[j]
    rim = np.unique(np.where(inside[i], i, j)[crossing])
    count = 2 * dimension + 1
    if dimension == 1 or len(rim) < count:
        return False
    indices, distances = nearest_neighbors(points[rim], points[rim], count)
    group = points[rim][indices]
    group = group - group.mean(1, keepdims=True)
    across = np.linalg.svd(group, compute_uv=False)[:, dimension - 1] / math.sqrt(count)
    spacing = np.maximum(distances[:, 1], 1e-300)
    return bool(np.median(across / spacing) < ON_RIM)


def cut(mesh: Elements, sets: tuple[Mask, Mask]) -> Floats:
    """Share of each edge that lies outside A and B: where it crosses a rim, a level function that is linear along it says how much."""
    share = np.ones(len(mesh.first))
    a, b = sets
    across = (a[mesh.first] & b[mesh.second]) | (b[mesh.first] & a[mesh.second])
    for level, members in zip(mesh.levels, sets, strict=True):
        one, other = members[mesh.first], members[mesh.second]
        crossing = one != other
        outer = np.where(one, mesh.second, mesh.first)[crossing]
        inner = np.where(one, mesh.first, mesh.second)[crossing]
        ahead, behind = np.maximum(level[outer], 0), np.maximum(-level[inner], 0)
        total = ahead + behind
        share[crossing] -= np.where(total > 0, behind / np.where(total > 0, total, 1.0), 0.0)
    return np.maximum(share, np.where(across, CLOSEST, SHORTEST))


def laplacian(count: int, first: Longs, second: Longs, weights: Floats) -> scipy.sparse.csr_array:
    """Σ weights (u_first - u_second)² as a matrix."""
    rows = np.concatenate([first, second, first, second])
    columns = np.concatenate([second, first, first, second])
    values = np.concatenate([-weights, -weights, weights, weights])
    return scipy.sparse.csr_array(scipy.sparse.coo_array((values, (rows, columns)), shape=(count, count)))
