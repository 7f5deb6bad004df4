"""Near-isometric registration: eigenmaps, rotation-invariant sliced Wasserstein, functional maps (section 8.3.3, (8.30)-(8.32)).

Two surfaces that differ by a bending have the same Laplace-Beltrami eigenfunctions, up to signs and rotations of equal ones. So an
orthogonal matrix C between the eigenfunctions says where each point goes: to the nearest row. The matrix is found coarse to fine.
``method="rswd"`` is the chapter's way: rotation-invariant sliced Wasserstein between the embeddings. The default generates more
candidates, from what eigenfunctions' products tell, refines each, and lets the deformation energy decide.
"""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy

from . import _core, arrays
from .arrays import Floats, Ints
from .clouds import CloudOperators
from .eigen import eigenpairs
from .errors import InputError
from .files import written
from .inside import closed_surface
from .maps import coverage, transfer
from .near import nearest_neighbors
from .operators import Operators, operators
from .progress import Progress, part, reporter, teller
from .sampling import farthest_points
from .shapes import PointCloud, Shape, TriangleMesh
from .sliced import Run, alternate, orthonormal_directions
from .solvers import Cholesky
from .view import Page, Picture, plot

__all__ = ["RegistrationCandidate", "RegistrationResult", "register"]

_MODES = 120  # eigenfunctions after the constant
_TENSOR = 30  # of them in triple products
_TOP = 18  # where candidates are handed from triple products to upsampling
_SAMPLES = 1000
_CURVATURE_TIMES = (5e-4, 1e-3, 2e-3, 5e-3)  # of smoothing, of unit area


@dataclass(eq=False)
class Side:
    """A shape scaled to unit area, with what registration needs to know of it."""

    shape: Shape
    unit: float  # of length
    centre: Floats
    mass: Floats  # 0 where a point hangs loose of the largest part
    stiffness: scipy.sparse.csr_array  # rows of points that are copies of others are empty
    values: Floats
    functions: Floats
    positions: Floats
    faces: Ints | None  # consistently oriented, outward if closed; None: unknown orientation
    follows: npt.NDArray[np.int64]  # the point of the largest part that each goes along with
    dimension: int
    samples: Ints
    sample_masses: Floats
    embedded: bool = False  # a surface in R^3 whose place there may be used
    normals: Floats | None = None
    curvature: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    descriptors: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def modes(self) -> int:
        return len(self.values)

    def spectral(self, modes: int, weight: float, samples: tuple[Ints, Floats] | None = None) -> tuple[Floats, Floats, Floats]:
        """Eigenfunctions, weighted features and masses, at samples with their masses or everywhere, as the core takes them."""
        chosen, masses = (slice(None), self.mass) if samples is None else samples
        scale = weight / np.sqrt(max(self.curvature.shape[1], 1))
        features = np.concatenate([scale * self.curvature[chosen], self.descriptors[chosen]], 1)
        return np.ascontiguousarray(self.functions[chosen, :modes]), features, masses

    def first(self, count: int) -> tuple[Ints, Floats]:
        """The first samples, which are farthest points too, and their masses."""
        chosen = self.samples[:count]
        if len(chosen) == len(self.samples):
            return chosen, self.sample_masses
        owner = nearest_neighbors(self.positions[chosen], self.positions, 1)[0][:, 0]
        return chosen, _gathered(owner, self.mass, len(chosen))


def vertex_normals(positions: Floats, faces: Ints) -> Floats:
    """Unit normals at vertices of triangles in R^3, weighted by area."""
    corners = positions[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ends = faces.ravel()
    sums = np.stack([np.bincount(ends, weights=np.repeat(column, 3), minlength=len(positions)) for column in cross.T], 1)
    lengths: Floats = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 0)


def _oriented_faces(mesh: TriangleMesh) -> Ints | None:
    """Faces all turned alike, outward where the mesh is closed in R^3; None if that cannot be."""
    if not mesh.is_orientable:
        return None
    turned = mesh.oriented()
    faces = turned.faces
    if mesh.dimension == 3 and mesh.is_closed:
        a, b, c = (mesh.vertices[faces[:, k]] - mesh.vertices.mean(0) for k in range(3))
        if (a * np.cross(b, c)).sum() < 0:
            return np.ascontiguousarray(faces[:, ::-1])
    return faces


def prepare(shape: Shape | Operators, *, modes: int = _MODES, samples: int = _SAMPLES, extrinsic: bool = True) -> Side:
    """What registration computes of one shape alone; collections keep it."""
    return _side(*_given(shape), None, modes, samples, extrinsic)


def readings(shape: Shape | Operators, *, modes: int = _MODES, samples: int = _SAMPLES, extrinsic: bool = True) -> list[Side]:
    """:func:`prepare`; of a cloud that samples a closed surface also as this surface, whose orientation both have.

    Where limbs are thin or touch, the local mesh of a cloud tears or leaks; where the surface is coarse, it is the better one. Operators
    that are given are taken as they are.
    """
    whole, ops, single = _given(shape)
    local = _side(whole, ops, single, None, modes, samples, extrinsic)
    if isinstance(shape, Operators) or not isinstance(ops, CloudOperators) or ops.shape.dimension != 2 or ops.shape.points.shape[1] != 3:
        return [local]
    surface = closed_surface(ops)
    if surface is None:
        return [local]
    closed = operators(TriangleMesh(ops.shape.points, surface), laplacian="tufted")
    faces = surface if single is None else single[surface].astype(np.int32)
    return [replace(local, faces=faces), _side(whole, closed, single, faces, modes, samples, extrinsic)]


def _given(shape: Shape | Operators) -> tuple[Shape, Operators, npt.NDArray[np.int64] | None]:
    """The shape, its operators, and the points these are of if a cloud has copies: copies go along with the first of each."""
    whole = shape.shape if isinstance(shape, Operators) else shape
    single: npt.NDArray[np.int64] | None = None
    if isinstance(shape, PointCloud):
        first = _core.first_copies(shape.points)
        if not first.all():
            single = np.flatnonzero(first)
            normals = None if shape.normals is None else shape.normals[single]
            shape = PointCloud(shape.points[single], dimension=shape.dimension, normals=normals)
    return whole, operators(shape), single


def _side(
    whole: Shape,
    ops: Operators,
    single: npt.NDArray[np.int64] | None,
    faces: Ints | None,
    modes: int,
    samples: int,
    extrinsic: bool,
) -> Side:
    """The largest part of what operators are of, with the faces that orient a cloud, if there are any."""
    dimension = ops.shape.intrinsic_dimension
    kept = np.flatnonzero((ops.component_labels == ops.component_masses.argmax()) & (ops.mass > 0))
    if len(kept) < 4:
        raise InputError(f"the shape has {len(kept)} connected points with mass; registration needs 4 at least")
    area = float(ops.mass[kept].sum())
    unit = area ** (1 / dimension)  # of length
    count = min(modes + 1, len(kept))
    alone = len(kept) == len(ops.mass)
    pairs = eigenpairs(ops, count) if alone else eigenpairs(ops.stiffness[kept][:, kept], count, mass=ops.mass[kept])
    functions = np.ascontiguousarray(pairs.functions[:, 1:] * np.sqrt(area))
    values = np.maximum(pairs.values[1:], 0.0) * unit**2
    places = whole.coordinates
    main = kept if single is None else single[kept]
    mass = np.zeros(len(places))
    mass[main] = ops.mass[kept] / area
    centre: Floats = mass @ places
    positions = (places - centre) / unit
    follows = main
    if len(main) < len(places):  # what hangs loose goes along with the nearest point of the largest part
        nearest = nearest_neighbors(positions[main], positions, 1)[0][:, 0]
        functions, follows = functions[nearest], main[nearest]
    if faces is None and isinstance(ops.shape, TriangleMesh):
        faces = _oriented_faces(ops.shape)
    chosen = main[farthest_points(positions[main], min(samples, len(main)))].astype(np.int32)
    owner = nearest_neighbors(positions[chosen], positions, 1)[0][:, 0]
    stiffness = ops.stiffness
    if single is not None:
        coo = stiffness.tocoo()
        stiffness = scipy.sparse.csr_array((coo.data, (single[coo.row], single[coo.col])), shape=(len(places),) * 2)
    return Side(
        shape=whole,
        unit=unit,
        centre=centre,
        mass=mass,
        stiffness=stiffness,
        values=values,
        functions=functions,
        positions=positions,
        faces=faces,
        follows=follows,
        dimension=dimension,
        samples=chosen,
        sample_masses=_gathered(owner, mass, len(chosen)),
        curvature=np.zeros((len(mass), 0)),
        descriptors=np.zeros((len(mass), 0)),
        embedded=extrinsic and dimension == 2 and positions.shape[1] == 3,
    )


def _spectral_gap(source: Side, target: Side) -> float:
    """How far the spectra are apart: mean difference of the logarithms of the first eigenvalues."""
    count = min(_TENSOR, source.modes, target.modes)
    floor = 1e-9 * max(source.values[-1], target.values[-1])
    first, second = (np.log(np.maximum(side.values[:count], floor)) for side in (source, target))
    return float(abs(first - second).mean())


def _gathered(owner: npt.NDArray[Any], weights: Floats, count: int) -> Floats:
    """Sums of weights by owner."""
    sums: Floats = np.bincount(owner, weights=weights, minlength=count).astype(np.float64)
    return sums


def _standard(values: Floats, mass: Floats) -> Floats:
    """Columns with mean 0 and variance 1, cut at 3."""
    centred = values - mass @ values
    spread = np.sqrt(mass @ centred**2)
    return np.clip(np.divide(centred, spread, out=np.zeros_like(centred), where=spread > 1e-12 * abs(values).max(initial=1e-300)), -3, 3)


def _with_curvature(side: Side, oriented: bool) -> Side:
    """With mean curvature, smoothed by the heat equation for several times: it tells front from back, and inside from outside.

    Without an orientation of both shapes its size alone, and no normals.
    """
    normals = vertex_normals(side.positions, side.faces) if oriented and side.faces is not None else None
    mass = np.maximum(side.mass, 1e-12 / len(side.mass))
    vectors = (side.stiffness @ side.positions) / mass[:, None] / 2
    curvature = np.clip(np.linalg.norm(vectors, axis=1) if normals is None else (vectors * normals).sum(1), -50, 50)
    diagonal = scipy.sparse.diags_array(mass)
    columns: list[Floats] = []
    factor: Cholesky | None = None
    for time in _CURVATURE_TIMES:
        matrix = scipy.sparse.csr_array(diagonal + time * side.stiffness)
        factor = Cholesky(matrix, coordinates=side.positions) if factor is None else factor.refactor(matrix)
        columns.append(factor.solve(mass * curvature))
    return replace(side, normals=normals, curvature=_standard(np.stack(columns, 1), side.mass))


# --- candidates from triple products ------------------------------------------------------------------------------------------


def _triple_products(side: Side, count: int) -> tuple[Floats, Floats]:
    """∫ φ_i φ_j φ_k, and ∫ φ_i dφ_j ∧ dφ_k, which a mirror image has with the other sign (0 without an orientation)."""
    functions = np.ascontiguousarray(side.functions[:, :count])
    even, odd = np.zeros((2, count, count, count))
    first, second = np.triu_indices(count)
    products = np.zeros((count, len(first)))
    for rows in _parts(len(functions)):
        some = functions[rows]
        products += (side.mass[rows, None] * some).T @ _pairs(some, some)
    even[:, first, second] = even[:, second, first] = products
    if side.faces is not None and side.dimension == 2:
        faces = side.faces[(side.mass[side.faces] > 0).all(1)]
        first, second = np.triu_indices(count, 1)
        products = np.zeros((count, len(first)))
        for rows in _parts(len(faces)):
            a, b, c = (functions[faces[rows, corner]] for corner in range(3))
            products += ((a + b + c) / 6).T @ (_pairs(b - a, c - a, 1) - _pairs(c - a, b - a, 1))
        odd[:, first, second], odd[:, second, first] = products, -products
        odd = (odd + odd.transpose(1, 2, 0) + odd.transpose(2, 0, 1)) / 3
    return even, odd


def _parts(count: int) -> list[slice]:
    """Rows that fit into a processor's cache with their products."""
    return [slice(start, start + 256) for start in range(0, count, 256)]


def _pairs(left: Floats, right: Floats, apart: int = 0) -> Floats:
    """Products of column i of the left and column j >= i + apart of the right."""
    count = left.shape[1]
    return np.concatenate([left[:, i, None] * right[:, i + apart :] for i in range(count)], 1)


@dataclass(eq=False)
class _Products:
    """Triple products of both shapes, ready for any level: low frequencies weigh more, and each level has norm 1."""

    source: tuple[Floats, Floats]
    target: tuple[Floats, Floats]
    scales: tuple[Floats, Floats]
    linear: Floats

    def level(self, n: int, powers: tuple[float, float]) -> list[Floats]:
        out = []
        for tensors, scale in zip((self.source, self.target), self.scales, strict=True):
            for tensor, power in zip(tensors, powers, strict=True):
                weight = scale[:n] ** -power
                part = tensor[:n, :n, :n] * weight[:, None, None] * weight[None, :, None] * weight[None, None, :]
                norm = np.linalg.norm(part)
                out.append(np.ascontiguousarray(part / norm if norm > 0 else part))
        return out

    def ascend(self, maps: Floats, powers: tuple[float, float], weight: float, steps: int) -> tuple[Floats, Floats]:
        n = maps.shape[1]
        linear = np.ascontiguousarray(self.linear[:n, :n])
        norm = np.linalg.norm(linear)
        linear = 0.3 * linear / norm if norm > 0 else linear
        a, b, c, d = self.level(n, powers)
        return _core.ascend_triple_products(np.ascontiguousarray(maps), a, b, c, d, weight, linear, steps)


def _frequencies(side: Side) -> Floats:
    """Eigenvalues over the first that is not 0; those that are, as 1."""
    above = side.values > 1e-9 * side.values[-1]
    first = side.values[above][0] if above.any() else 1.0
    return np.maximum(side.values / first, 1.0)


def _products(source: Side, target: Side) -> _Products:
    count = min(_TENSOR, source.modes, target.modes)
    linear = np.zeros((count, count))
    if source.descriptors.shape[1]:
        a, b = (side.functions[:, :count].T @ (side.mass[:, None] * side.descriptors) for side in (source, target))
        linear = a @ b.T
    return _Products(
        _triple_products(source, count),
        _triple_products(target, count),
        (_frequencies(source)[:count], _frequencies(target)[:count]),
        linear,
    )


def _distinct(maps: Floats, scores: Floats, width: int, alike: float, share: int = 4) -> npt.NDArray[np.int64]:
    """The best `width` maps, those left out that overlap with a better one, or share a leading block with `share` better ones."""
    n = maps.shape[1]
    lead = min(6, n)
    flat = maps.reshape(len(maps), -1)
    block = maps[:, :lead, :lead].reshape(len(maps), -1)
    block = block / np.maximum(np.linalg.norm(block, axis=1, keepdims=True), 1e-300)
    kept: list[int] = []
    for index in np.argsort(-scores, kind="stable").tolist():
        if kept and ((flat[kept] * flat[index]).sum(1).max() > alike * n or ((block[kept] * block[index]).sum(1) > 0.8).sum() >= share):
            continue
        kept.append(index)
        if len(kept) == width:
            break
    return np.array(kept)


def _beam(products: _Products, top: int, powers: tuple[float, float], weight: float, width: int, keep: int) -> Floats:
    """Maps whose triple products agree: all signs of the first four modes, then mode after mode with either sign."""
    start = min(4, top)
    maps = np.array([np.diag(signs) for signs in itertools.product((1.0, -1.0), repeat=start)])
    for n in range(start, top + 1):
        if n > start:
            wider = np.zeros((2, len(maps), n, n))
            wider[:, :, :-1, :-1] = maps
            wider[0, :, -1, -1], wider[1, :, -1, -1] = 1.0, -1.0
            maps = wider.reshape(-1, n, n)
        maps, scores = products.ascend(maps, powers, weight, 6)
        total = scores[:, 0] + weight * scores[:, 1] + scores[:, 2]
        maps = maps[_distinct(maps, total, width, 0.98)]
    return maps[:keep]


def _grown(maps: Floats, levels: list[int], source: Side, target: Side, weight: float, samples: int = _SAMPLES) -> Floats:
    """Two-way upsampling on some samples through `levels`."""
    chosen = [side.first(samples) for side in (source, target)]
    for k, following in itertools.pairwise([maps.shape[1], *levels]):
        a, b = (side.spectral(max(k, following), weight, some) for side, some in zip((source, target), chosen, strict=True))
        maps = _core.upsample_maps(np.ascontiguousarray(maps), following, a, b)
    return maps


# --- what a map costs -----------------------------------------------------------------------------------------------------------


class _Rigid:
    """As-rigid-as-possible deformation of the source (Sorkine and Alexa 2007), rotations smoothed over a ring."""

    def __init__(self, side: Side) -> None:
        coo = scipy.sparse.coo_array(side.stiffness)
        apart = coo.row != coo.col
        n = len(side.mass)
        weights = scipy.sparse.csr_array((np.maximum(-coo.data[apart], 0.0), (coo.row[apart], coo.col[apart])), shape=(n, n))
        self.side = side
        self.core = _core.Rigid(arrays.csr_in(weights, "weights"), side.positions)
        degrees = np.asarray(weights.sum(1)).ravel() + 1e-9 * weights.sum() / n
        self.laplacian = scipy.sparse.csr_array(scipy.sparse.diags_array(degrees) - weights)
        self.factor: Cholesky | None = None

    def pulled(self, strength: Floats) -> Cholesky:
        """The factor of the deformation's matrix with every point pulled by a spring."""
        matrix = scipy.sparse.csr_array(self.laplacian + scipy.sparse.diags_array(strength))
        if self.factor is None:
            self.factor = Cholesky(matrix, coordinates=self.side.positions)
        else:
            self.factor.refactor(matrix)
        return self.factor


@dataclass(frozen=True, eq=False, repr=False)
class RegistrationCandidate:
    """A map that was considered.

    Attributes
    ----------
    functional_map : (k, k) array
        Orthogonal, between the eigenfunctions, the constant first.
    point_map : (n,) int32 array
        Index in the target of each source point, by this map alone (not polished). Computed when it is asked for.
    energy : float
        What decides: of deforming the source onto its image (surfaces in R^3), or else the mean squared distance of nearest
        rows. Only energies of one call compare.
    smoothness : float
        Agreement of the triple products of eigenfunctions, at most 1.
    orientation : float
        Agreement of their oriented triple products: negative for a mirror image; 0 where the shapes have no orientation.
    """

    functional_map: Floats
    energy: float
    smoothness: float
    orientation: float
    functions: tuple[Floats, Floats] = field(repr=False)

    @cached_property
    def point_map(self) -> Ints:
        k = len(self.functional_map) - 1
        source, target = self.functions
        return _core.nearest_rows(np.ascontiguousarray(target[:, :k]), _product(source[:, :k], self.functional_map[1:, 1:]))[0]

    def __repr__(self) -> str:
        return f"RegistrationCandidate(energy {self.energy:.4g}, smoothness {self.smoothness:.3f}, orientation {self.orientation:.3f})"


def _point_maps(maps: Floats, source: Side, target: Side, weight: float) -> tuple[Ints, Ints]:
    k = len(maps)
    return _core.spectral_point_maps(np.ascontiguousarray(maps), source.spectral(k, weight), target.spectral(k, weight))


def _sample_image(matrix: Floats, source: Side, target: Side, weight: float) -> tuple[Ints, Floats]:
    """Nearest target point of each source sample, and its distance."""
    k = len(matrix)
    functions, features, _ = source.spectral(k, weight, source.first(len(source.samples)))
    others, other_features, _ = target.spectral(k, weight)
    rows = np.concatenate([_product(functions, matrix) / np.sqrt(k), features], 1)
    return _core.nearest_rows(np.concatenate([others / np.sqrt(k), other_features], 1), rows)


def _product(rows: Floats, matrix: Floats) -> Floats:
    result: Floats = rows @ matrix
    return result


def _low_passed(matrix: Floats, source: Side, target: Side) -> Floats:
    """The target's coordinates, as far as the functional map carries them to the source."""
    k = len(matrix)
    coefficients = target.functions[:, :k].T @ (target.mass[:, None] * target.positions)
    return _product(source.functions[:, :k], matrix @ coefficients)


def _marked(side: Side, positions: Floats, turned: float, curved: float) -> Floats:
    """The side at some positions (of unit area): these, their normals and the curvature, which are weighted, and descriptors."""
    columns = [positions, curved * side.curvature, 0.1 * side.descriptors]
    if side.normals is not None and side.faces is not None:
        columns.append(turned * (side.normals if positions is side.positions else vertex_normals(positions, side.faces)))
    return np.concatenate(columns, 1)


class _Fitting:
    """Deforms the source onto the target, its samples drawn to nearest points in position, normal and curvature, round by round."""

    def __init__(self, source: Side, target: Side, rigid: _Rigid, pull: float = 300.0) -> None:
        self.source, self.target, self.rigid, self.pull = source, target, rigid, pull
        self.masses = np.zeros(len(source.mass))
        self.masses[source.samples] = source.sample_masses
        self.anchor = 1e-6 / len(source.mass)  # holds what is tied to nothing
        self.factor = rigid.pulled(pull * (self.masses + self.anchor))
        self.rows = _marked(target, target.positions, 0.05, 0.03)

    def run(self, positions: Floats, rounds: int) -> tuple[float, Floats]:
        """The energy at the last look, and where the source is then."""
        samples = self.source.samples
        held = self.pull * self.anchor * positions
        energy = np.inf
        for step in range(rounds + 1):
            moved = _marked(self.source, positions, 0.05, 0.03)[samples]
            image, distance = _core.nearest_neighbors(self.rows, moved, 1)
            right, bent = self.rigid.core.fit(positions, 0.0)
            energy = bent + self.pull * float(self.source.sample_masses @ distance[:, 0] ** 2)
            if step < rounds:
                drawn = held.copy()
                drawn[samples] += self.pull * self.source.sample_masses[:, None] * self.target.positions[image[:, 0]]
                positions = self.factor.solve(right + drawn)
                positions = self.factor.solve(self.rigid.core.fit(positions, 0.0)[0] + drawn)
        return energy, positions


def _judge(maps: Floats, products: _Products, source: Side, target: Side, rigid: _Rigid | None) -> list[RegistrationCandidate]:
    """Candidates with their energies, best first."""
    n = min(maps.shape[1], len(products.linear))
    _, scores = products.ascend(maps[:, :n, :n], (0.25, 0.5), 1.0, 0)
    energies = np.zeros(len(maps))
    for index, matrix in enumerate(maps):
        if rigid is None:
            _, distance = _sample_image(matrix, source, target, 0.6)
            _, gap = _sample_image(np.ascontiguousarray(matrix.T), target, source, 0.6)
            energies[index] = source.sample_masses @ distance**2 + target.sample_masses @ gap**2
    if rigid is not None:
        fitting = _Fitting(source, target, rigid)
        places = [_low_passed(matrix, source, target) for matrix in maps]
        for index in range(len(maps)):
            energies[index], places[index] = fitting.run(places[index], 3)
        for index in np.argsort(energies, kind="stable")[:4]:
            if energies[index] < 1.5 * energies.min():
                energies[index], places[index] = fitting.run(places[index], 3)
    return _listed(maps, energies, scores, source, target)


def _listed(maps: Floats, energies: Floats, scores: Floats, source: Side, target: Side) -> list[RegistrationCandidate]:
    """Candidates, best first. Mirror images are left out as long as there is another."""
    k = maps.shape[1]
    functions = (source.functions[:, :k].copy(), target.functions[:, :k].copy())
    found = [
        RegistrationCandidate(_with_constant(matrix), float(energy), float(score[0]), float(score[1]), functions)
        for matrix, energy, score in zip(maps, energies, scores, strict=True)
    ]
    found.sort(key=lambda candidate: candidate.energy)
    return [candidate for candidate in found if candidate.orientation >= 0] or found


def _polish(start: Floats, source: Side, target: Side, rigid: _Rigid, *, steps: int = 15) -> tuple[Ints, Ints, Floats]:
    """The source deformed onto the target: nearest points in position, normal and curvature, both ways, and a rigid step, in turns.

    Normals and curvature weigh much at first, when positions are still off, and little at the end.
    """
    positions = start

    def nearest(share: float) -> tuple[Ints, Ints]:
        turned, curved = 0.2 + share * (0.03 - 0.2), 0.05 + share * (0.01 - 0.05)
        moved, rows = _marked(source, positions, turned, curved), _marked(target, target.positions, turned, curved)
        return _core.nearest_neighbors(rows, moved, 1)[0][:, 0], _core.nearest_neighbors(moved, rows, 1)[0][:, 0]

    n = len(source.mass)
    own = np.maximum(source.mass, 1e-3 / n)
    for step, pull in enumerate(np.geomspace(100.0, 1000.0, steps)):
        forward, backward = nearest(step / (steps - 1))
        weight = own + _gathered(backward, target.mass, n)
        images = own[:, None] * target.positions[forward]
        for axis in range(3):
            images[:, axis] += _gathered(backward, target.mass * target.positions[:, axis], n)
        factor = rigid.pulled(pull * weight)
        for _ in range(2):
            right, _energy = rigid.core.fit(positions, 0.8)
            positions = factor.solve(right + pull * images)
    forward, backward = nearest(1.0)
    copies = (source.positions[source.follows] == source.positions).all(1)
    positions = np.where(copies[:, None], positions[source.follows], positions)
    return forward[source.follows], backward[target.follows], positions


# --- the chapter's iteration --------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Eigenmap:
    """A shape as a weighted point set: λ_k^(-d/4) φ_k, k = 1, 2 ..., at some farthest points, of unit area."""

    values: Floats
    rows: Floats
    masses: Floats
    dimension: int

    def points(self, n: int) -> Floats:
        """The first n coordinates."""
        above = self.values[self.values > 1e-9 * self.values[-1]]
        scale = np.maximum(self.values[:n], above[0] if len(above) else 1.0) ** (-self.dimension / 4)
        return np.ascontiguousarray(self.rows[:, :n] * scale)


def eigenmap(side: Side, count: int, modes: int) -> Eigenmap:
    """The eigenmap at the first `count` samples."""
    chosen, masses = side.first(count)
    return Eigenmap(side.values[:modes].copy(), np.ascontiguousarray(side.functions[chosen, :modes]), masses, side.dimension)


def _align(
    source: Eigenmap, target: Eigenmap, starts: Floats, seed: int, steps: int, *, tolerance: float = 1e-8, directions: int = 40
) -> list[Run]:
    """Runs of the alternation between couplings and rotations, from several rotations, best first."""
    n = starts.shape[1]
    theta = orthonormal_directions(n, max(directions, 2 * n), rng=np.random.default_rng([seed, n]))
    alignment = _core.SlicedAlignment(source.points(n), target.points(n), source.masses, target.masses, theta)
    runs = alternate(alignment, [Run(np.ascontiguousarray(start)) for start in starts], steps, tolerance)
    return sorted(runs, key=lambda run: run.value)


def _lifted(source: Eigenmap, target: Eigenmap, rotation: Floats, n: int) -> list[Floats]:
    """Rotations of order n that go on from one of a lower order: Procrustes on nearest rows, and where a singular value of
    what is new is small, so that it could as well be the opposite, both ways."""
    old = len(rotation)
    x, y = source.points(n), target.points(n)
    image, _ = _core.nearest_rows(np.ascontiguousarray(y[:, :old]), x[:, :old] @ rotation)
    left, sizes, right = np.linalg.svd((x * source.masses[:, None]).T @ y[image])
    ways = [left @ right]
    if sizes[-1] < 0.2 * np.median(sizes):
        turned = left.copy()
        turned[:, -1] *= -1
        ways.append(turned @ right)
    return ways


def align_eigenmaps(
    source: Eigenmap, target: Eigenmap, levels: list[int], seed: int, width: int = 8, finest: tuple[Eigenmap, Eigenmap] | None = None
) -> tuple[list[Run], list[float]]:
    """Rotation-invariant sliced Wasserstein, coarse to fine: all signs of the first modes, then a beam. The runs of the last level
    (between `finest` if given), best first, and the best distance of each level."""
    rotations = np.array([np.diag(signs) for signs in itertools.product((1.0, -1.0), repeat=levels[0])])
    best: list[float] = []
    kept: list[Run] = []
    for index, n in enumerate(levels):
        if index:
            rotations = np.array([way for rotation in rotations for way in _lifted(source, target, rotation, n)])
        pair = finest if finest is not None and index == len(levels) - 1 else (source, target)
        if len(rotations) > 2 * width:  # a few steps each, the better half goes on
            rotations = np.array([run.rotation for run in _align(*pair, rotations, seed, 4)[: 2 * width]])
        kept = []
        for run in _align(*pair, rotations, seed, 30):
            if len(kept) < width and all((run.rotation * other.rotation).sum() < 0.98 * n for other in kept):
                kept.append(run)
        rotations = np.array([run.rotation for run in kept])
        best.append(float(np.sqrt(kept[0].value)))
    return kept, best


def settle(source: Eigenmap, target: Eigenmap, start: Floats, seed: int, steps: int = 6) -> tuple[Floats, float]:
    """The alternation from a rotation, in both orders: the rotation and the distance, the less of both."""
    there = _align(source, target, np.ascontiguousarray(start)[None], seed, steps)[0]
    back = _align(target, source, np.ascontiguousarray(there.rotation.T)[None], seed, steps)[0]
    if back.value < there.value:
        return np.ascontiguousarray(back.rotation.T), float(np.sqrt(max(back.value, 0.0)))
    return there.rotation, float(np.sqrt(max(there.value, 0.0)))


# --- the front door -----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class RegistrationResult:
    """What :func:`register` found.

    Attributes
    ----------
    point_map : (n_source,) int32 array
        Index in the target of each source point.
    inverse_map : (n_target,) int32 array
        Index in the source of each target point. Not exactly the inverse: maps need not be one to one.
    functional_map : (k, k) array
        Orthogonal, between the eigenfunctions of both shapes scaled to unit area, the constant first:
        ``source_functions @ functional_map`` is close to ``target_functions[point_map]``.
    rotation : (n, n) array
        Of the eigenmaps ``λ_k^(-d/4) φ_k``, k = 1 ... n: orthogonal, the source's rows times it are close to the target's.
    distance : float
        The rotation-invariant sliced Wasserstein distance of the eigenmaps at this rotation; no unit.
    candidates : tuple of RegistrationCandidate
        All that were compared to the end, best first; the first one led to the answer.
    coverage : float
        Share of the target's area at points that are images.
    bijectivity : float
        Mean distance, over the root of the area, between a source point and where the map and the map back bring it.
    orientation : float
        Agreement of oriented triple products, at most 1; 0 if a shape has no orientation.
    mirror_decided : bool
        Whether orientation told left and right apart. A cloud has one if it samples a closed surface in R^3. False for other clouds and
        for faces that cannot be oriented: look at ``candidates``.
    extrinsic : bool
        Whether positions in R^3 took part (curvature, rigid deformation), and not only what bending keeps.
    positions : (n_source, 3) array or None
        The source deformed onto the target, in the target's place and size; None if not extrinsic.
    history : dict of str to array
        ``"levels"``: orders of the functional map; with ``method="rswd"`` also ``"distance"`` at each.
    notes : tuple of str
        What is worth knowing.
    source, target : TriangleMesh or PointCloud
    source_masses : (n_source,) array
        Shares of the source's area.
    """

    point_map: Ints
    inverse_map: Ints
    functional_map: Floats
    rotation: Floats
    distance: float
    candidates: tuple[RegistrationCandidate, ...]
    coverage: float
    bijectivity: float
    orientation: float
    mirror_decided: bool
    extrinsic: bool
    positions: Floats | None
    history: dict[str, Floats]
    notes: tuple[str, ...]
    source: Shape
    target: Shape
    source_masses: Floats

    def __repr__(self) -> str:
        side = "" if self.mirror_decided else ", left and right NOT told apart"
        return (
            f"RegistrationResult({len(self.point_map)} -> {len(self.inverse_map)} points, coverage {self.coverage:.0%}, "
            f"bijectivity {self.bijectivity:.4f}, {len(self.candidates)} candidates{side})"
        )

    def transfer(self, values: npt.ArrayLike, *, direction: Literal["to_source", "to_target"] = "to_source") -> npt.NDArray[Any]:
        """Carries values, colours or labels from one shape to the other; see :func:`beltrami.transfer`."""
        if direction == "to_source":
            count = len(self.target.coordinates)
            if np.ndim(values) and len(np.asarray(values)) != count:
                raise InputError(f"values has {len(np.asarray(values))} rows; the target has {count} points")
            return transfer(self.point_map, values)
        return transfer(self.point_map, values, direction=direction, target=self.target, weights=self.source_masses)

    def plot(self, values: Any = None, *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints source and target side by side, matching points in the same colour.

        Parameters
        ----------
        values : array, optional
            Numbers, labels or colours at the target's points; if left out, colours that tell places of the target apart.
        path, **options
            As for :func:`beltrami.plot`.
        """
        shape, colours = self.side_by_side(values)
        return plot(shape, colours, path=path, **{"views": ["front"], **options})

    def side_by_side(self, values: Any = None) -> tuple[Shape, npt.NDArray[Any]]:
        """Source and target as one shape, the source brought to the target's size, and the values of both: those of :meth:`plot`."""
        places = [self.source.coordinates, self.target.coordinates]
        if places[0].shape[1] != places[1].shape[1]:
            raise InputError(f"the source lies in R^{places[0].shape[1]}, the target in R^{places[1].shape[1]}: plot them one by one")
        if values is None:
            values = (places[1] - places[1].min(0)) / np.maximum(np.ptp(places[1], axis=0), 1e-300)
            values = 0.1 + 0.8 * np.pad(values[:, :3], ((0, 0), (0, max(0, 3 - values.shape[1]))), constant_values=0.5)
        table = np.asarray(values)
        joined = np.concatenate([self.transfer(table), table])
        scale = float(np.ptp(places[1], axis=0).max() / max(np.ptp(places[0], axis=0).max(), 1e-300))
        first = scale * (places[0] - places[0].mean(0))
        second = places[1] - places[1].mean(0)
        second[:, 0] += first[:, 0].max() - second[:, 0].min() + 0.1 * max(np.ptp(first[:, 0]), np.ptp(second[:, 0]))
        if isinstance(self.source, TriangleMesh) and isinstance(self.target, TriangleMesh):
            faces = np.concatenate([self.source.faces, self.target.faces + np.int32(len(first))])
            return TriangleMesh(np.concatenate([first, second]), faces), joined
        return PointCloud(np.concatenate([first, second]), dimension=2), joined

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``, the point map to ``.csv`` (source, target), a picture to ``.png`` or ``.html``."""
        path = arrays.file(path, "path")
        suffix = path.suffix.lower()
        if suffix in (".png", ".html"):
            self.plot(path=path)
        elif suffix == ".npz":
            names = ("point_map", "inverse_map", "functional_map", "rotation", "distance", "coverage", "bijectivity", "orientation")
            fields: dict[str, Any] = {name: getattr(self, name) for name in names}
            if self.positions is not None:
                fields["positions"] = self.positions
            written(path, lambda stream: np.savez_compressed(stream, **fields))
        elif suffix == ".csv":
            rows = np.column_stack([np.arange(len(self.point_map)), self.point_map])
            written(path, lambda stream: np.savetxt(stream, rows, fmt="%d", delimiter=",", header="source,target", comments=""))
        else:
            raise InputError(f"{path}: a registration is written to .npz, .csv, .png or .html")
        return path


def _twins(candidates: list[RegistrationCandidate]) -> str:
    """Says it where another candidate is as good as the best but for a tenth."""
    close = [k for k, other in enumerate(candidates[1:], 1) if other.energy < 1.1 * candidates[0].energy]
    if not close:
        return ""
    energies = ", ".join(f"{candidates[k].energy:.4g}" for k in close)
    return f"; candidates {', '.join(map(str, close))} with energies {energies} nearly tie with the first ({candidates[0].energy:.4g})"


def _joined(values: tuple[Floats, Floats], masses: tuple[Floats, Floats], weight: float) -> tuple[Floats, Floats]:
    """Columns of both shapes on one scale: mean 0 and variance 1 over both together, cut at 3, and weighted."""
    mean = sum(mass @ value for value, mass in zip(values, masses, strict=True)) / 2
    spread = np.sqrt(sum(mass @ (value - mean) ** 2 for value, mass in zip(values, masses, strict=True)) / 2)
    alive = spread > 1e-12 * max(abs(values[0]).max(initial=0), abs(values[1]).max(initial=0), 1e-300)
    scale = np.where(alive, weight / np.maximum(spread, 1e-300), 0.0)
    first, second = (np.clip((value - mean) * scale, -3 * weight, 3 * weight) for value in values)
    return first, second


def _describe(source: Side, target: Side, landmarks: Any, descriptors: Any) -> None:
    """Turns landmarks and descriptors into features of both sides."""
    blocks: list[tuple[Floats, Floats]] = []
    masses = (source.mass, target.mass)
    if descriptors is not None:
        if isinstance(descriptors, str):
            blocks.append(_joined((_signature(source, descriptors), _signature(target, descriptors)), masses, 0.3))
        else:
            try:
                first, second = descriptors
            except (TypeError, ValueError):
                raise InputError("descriptors must be a pair (of the source, of the target), or 'hks' or 'wks'") from None
            pair = []
            for values, side, name in ((first, source, "source"), (second, target, "target")):
                table = np.asarray(values)
                pair.append(
                    arrays.floats(table[:, None] if table.ndim == 1 else table, f"descriptors of the {name}", (len(side.mass), None))
                )
            if pair[0].shape[1] != pair[1].shape[1] or pair[0].shape[1] == 0:
                raise InputError(f"the source has {pair[0].shape[1]} descriptors, the target {pair[1].shape[1]}; as many are needed")
            blocks.append(_joined((pair[0], pair[1]), masses, 0.3))
        blocks[-1] = (blocks[-1][0] / np.sqrt(blocks[-1][0].shape[1]), blocks[-1][1] / np.sqrt(blocks[-1][1].shape[1]))
    if landmarks is not None:
        pairs = arrays.pairs(landmarks, "landmarks", len(source.mass), len(target.mass))
        if len(pairs) == 0:
            raise InputError("landmarks is empty; give at least one pair, or None")
        count = min(source.modes, target.modes)
        bumps = []
        for side, points in zip((source, target), pairs.T, strict=True):
            columns = []
            for time in (0.005, 0.05):
                heat = (side.functions[points, :count] * np.exp(-side.values[:count] * time)) @ side.functions[:, :count].T + 1
                columns.append(heat.T / np.maximum(heat[np.arange(len(points)), points], 1e-300))
            bumps.append(np.concatenate(columns, 1))
        blocks.append((bumps[0] / np.sqrt(len(pairs)), bumps[1] / np.sqrt(len(pairs))))
    if blocks:
        source.descriptors = np.concatenate([block[0] for block in blocks], 1)
        target.descriptors = np.concatenate([block[1] for block in blocks], 1)


def _signature(side: Side, name: str) -> Floats:
    from .descriptors import hks, wks
    from .eigen import Eigenpairs

    if name not in ("hks", "wks"):
        raise InputError(f"descriptors is {name!r}; choose 'hks' or 'wks', or give a pair of arrays")
    functions = np.concatenate([np.ones((len(side.mass), 1)), side.functions], 1)
    values = np.concatenate([[0.0], side.values])
    pairs = Eigenpairs(values, functions, np.zeros_like(values), 0, side.shape)
    return np.log(np.maximum(hks(pairs, k=len(values)), 1e-6)) if name == "hks" else wks(pairs, k=len(values))


_LEADS = (
    ((0.5, 0.75), 1.0),
    ((0.5, 0.75), 0.3),
    ((0.25, 0.5), 1.0),
    ((0.25, 0.5), 0.1),
)  # powers of the frequency in both products, and the weight of the oriented one


def match(
    source: Side,
    target: Side,
    *,
    method: str = "auto",
    polish: bool = True,
    most: int = 8,
    rng: np.random.Generator | None = None,
    report: Any = None,
) -> RegistrationResult:
    """:func:`register` for two prepared sides."""
    seed = int(arrays.generator(rng).integers(2**31))
    told = teller(report)
    modes = min(source.modes, target.modes)
    top = min(_TOP, modes)
    oriented = source.faces is not None and target.faces is not None
    extrinsic = source.embedded and target.embedded and method == "auto"
    notes: list[str] = []
    history: dict[str, Floats] = {}
    if extrinsic:
        source, target = _with_curvature(source, oriented), _with_curvature(target, oriented)
    products = _products(source, target)
    if not oriented:
        products.source[1][:], products.target[1][:] = 0.0, 0.0
    for side, name in ((source, "source"), (target, "target")):
        loose = int((side.mass == 0).sum())
        if loose:
            notes.append(f"{loose} points of the {name} hang loose of its largest part, and go along with the nearest of it")
        if isinstance(side.shape, PointCloud) and oriented:
            notes.append(f"left and right of the {name} are those of the closed surface through its points")
    told(0.05)

    def upto(*levels: int) -> list[int]:
        return [level for level in levels if level <= modes]

    if method == "rswd":
        levels = [level for level in (5, 8, 12, 16, 20, 25, 30) if level <= modes] or [modes]
        coarse, fine = ([eigenmap(side, count, levels[-1]) for side in (source, target)] for count in (300, _SAMPLES))
        runs, distances = align_eigenmaps(coarse[0], coarse[1], levels, seed, finest=(fine[0], fine[1]))
        history["levels"], history["distance"] = np.array(levels, float), np.array(distances)
        told(0.8)
        maps = np.array([run.rotation for run in runs])
        n = min(maps.shape[1], len(products.linear))
        _, scores = products.ascend(maps[:, :n, :n], (0.25, 0.5), 1.0, 0)
        candidates = _listed(maps, np.array([run.value for run in runs]), scores, source, target)
        if candidates[0].energy > runs[0].value:
            notes.append("a mirror image has the smaller distance; orientation decided")
        matrix = candidates[0].functional_map[1:, 1:]
        forward, backward = _point_maps(matrix, source, target, 0.0)
        positions = None
    else:
        leads = _LEADS if oriented else [(powers, 0.0) for powers, weight in _LEADS if weight == 1.0]
        found = [_beam(products, top, powers, weight, 32, 8) for powers, weight in leads]
        if not oriented:  # half of what tells maps apart is missing: the chapter's iteration finds others
            coarse = [eigenmap(side, 300, top) for side in (source, target)]
            runs, _ = align_eigenmaps(coarse[0], coarse[1], [*(level for level in (5, 10) if level < top), top], seed)
            found.append(np.array([run.rotation for run in runs]))
        maps = np.concatenate(found)
        maps = maps[_distinct(maps, -np.arange(len(maps), dtype=float), len(maps), 0.98, len(maps))]
        told(0.3)
        maps = _grown(maps, upto(24, 30), source, target, 0.3, _SAMPLES // 2)
        n = maps.shape[1]
        _, scores = products.ascend(maps, (0.25, 0.5), 1.0, 0)
        maps = maps[_distinct(maps, scores.sum(1), most, 0.95, len(maps))]
        told(0.4)
        maps = _grown(maps, upto(36, 42, 48, 54, 60), source, target, 0.3)
        maps = maps[_distinct(maps, -np.arange(len(maps), dtype=float), most, 0.95, len(maps))]
        rigid = _Rigid(source) if extrinsic else None
        candidates = _judge(maps, products, source, target, rigid)
        told(0.6)
        matrix = _grown(candidates[0].functional_map[None, 1:, 1:], upto(80, 100, 120), source, target, 0.6)[0]
        n = len(matrix)
        history["levels"] = np.array([*range(min(4, top), top + 1), *upto(24, 30, 36, 42, 48, 54, 60, 80, 100, 120)], float)
        sides = [side.spectral(n, 0.6) for side in (source, target)]
        forward, backward = _point_maps(matrix, source, target, 0.6)
        matrix = _core.orthogonal_functional_map(forward, backward, n, *sides)
        told(0.7)
        positions = None
        if rigid is not None and polish:
            forward, backward, positions = _polish(_low_passed(matrix, source, target), source, target, rigid)
            matrix = _core.orthogonal_functional_map(forward, backward, n, *sides)
        else:
            forward, backward = _point_maps(matrix, source, target, 0.6)
    told(0.95)
    n = min(30, modes)
    start = _core.polar(np.ascontiguousarray(matrix[:n, :n]))
    rotation, distance = settle(eigenmap(source, _SAMPLES, n), eigenmap(target, _SAMPLES, n), start, seed)
    if not oriented:
        how = "rest on the energies of the deformations alone" if extrinsic else "cannot be told apart"
        notes.append(f"no orientation: left and right {how}{_twins(candidates)}")
    moved = source.positions[backward[forward]] - source.positions
    result = RegistrationResult(
        point_map=forward,
        inverse_map=backward,
        functional_map=_with_constant(matrix),
        rotation=rotation,
        distance=distance,
        candidates=tuple(candidates),
        coverage=coverage(forward, target.mass),
        bijectivity=float(source.mass @ np.linalg.norm(moved, axis=1)),
        orientation=candidates[0].orientation,
        mirror_decided=oriented,
        extrinsic=extrinsic,
        positions=None if positions is None else positions * target.unit + target.centre,
        history=history,
        notes=tuple(notes),
        source=source.shape,
        target=target.shape,
        source_masses=source.mass,
    )
    told(1.0)
    return result


def _with_constant(matrix: Floats) -> Floats:
    whole = np.zeros((len(matrix) + 1,) * 2)
    whole[0, 0] = 1.0
    whole[1:, 1:] = matrix
    return whole


def register(
    source: Shape | Operators,
    target: Shape | Operators,
    *,
    method: Literal["auto", "rswd"] = "auto",
    landmarks: npt.ArrayLike | None = None,
    descriptors: Any = None,
    extrinsic: bool = True,
    polish: bool = True,
    modes: int = _MODES,
    samples: int = _SAMPLES,
    candidates: int = 8,
    rng: int | np.random.Generator | None = 0,
    progress: Progress = None,
) -> RegistrationResult:
    """The point map between two shapes that differ by a bending, without landmarks.

    Shapes are scaled to unit area. Candidates for the orthogonal matrix between the eigenfunctions come from a beam search over
    signs and rotations that makes triple products agree, ``∫ φ_i φ_j φ_k``, and oriented ones, ``∫ φ_i dφ_j ∧ dφ_k``, which tell a mirror
    image. Each is refined by upsampling in both directions. On surfaces in R^3 the least energy of deforming the source
    onto the target decides, and the map is polished by such a deformation. With ``method="rswd"`` the chapter's iteration alone:
    rotation-invariant sliced Wasserstein between the eigenmaps ``λ_k^(-d/4) φ_k``, coarse to fine from all sign starts.

    Parameters
    ----------
    source, target : TriangleMesh, PointCloud or Operators
        Numbers of points may differ; position, size and numbering do not matter. Closed meshes are turned outward.
    method : {"auto", "rswd"}
    landmarks : (k, 2) int array, optional
        Pairs (source point, target point) that are known to match, roughly.
    descriptors : pair of arrays (n_source, p) and (n_target, p), "hks" or "wks", optional
        Functions that should be carried over. Brought to one scale; joined to the eigenmaps.
    extrinsic : bool
        Whether positions may help, where both shapes are surfaces in R^3. False: only what no bending changes.
    polish : bool
        Whether the map is polished by a deformation, if extrinsic.
    modes : int
        How many eigenfunctions after the constant.
    samples : int
        Farthest points that candidates are refined on.
    candidates : int
        How many are compared to the end.
    rng : int or numpy Generator
        What directions of the sliced distance are drawn with.
    progress : callable or True, optional
        Called with the share of work done; returning False stops. True draws a bar.

    Returns
    -------
    RegistrationResult

    Raises
    ------
    InputError
        A shape has too few points, landmarks or descriptors do not fit, or intrinsic dimensions differ.
    Cancelled
        If ``progress`` returned False.

    Notes
    -----
    Clouds are taken by their local mesh and, where they sample a closed surface in R^3, also by its triangles (from Delaunay's
    tetrahedra): those go on whose spectra agree best, and inside and outside tell left from right. On open clouds nothing but the
    energy of the deformation does, and in other spaces than R^3 nothing.
    For partial shapes a map comes back too; look at ``coverage``, ``bijectivity`` and ``notes``.

    References
    ----------
    Lai and Zhao, Multi-scale non-rigid point cloud registration using robust sliced-Wasserstein distance via Laplace-Beltrami
    eigenmap, 2017. Melzi, Ren, Rodolà, Sharma, Wonka and Ovsjanikov, ZoomOut, 2019. Ren, Poulenard, Wonka and Ovsjanikov, Continuous and
    orientation-preserving correspondences via functional maps, 2018. Sorkine and Alexa, As-rigid-as-possible surface modeling, 2007.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> shape = bt.shapes.ellipsoid(level=3)
    >>> found = bt.register(shape, bt.TriangleMesh(10 * shape.vertices[:, [1, 2, 0]], shape.faces))
    >>> found.mirror_decided, bool(found.coverage > 0.9)
    (True, True)
    """
    arrays.word(method, "method", ("auto", "rswd"))
    modes, samples = arrays.whole(modes, "modes", 3), arrays.whole(samples, "samples", 4)
    most = arrays.whole(candidates, "candidates", 1)
    generator = arrays.generator(rng)
    report = reporter(progress, "registration")
    sides = []
    for index, shape in enumerate((source, target)):
        sides.append(readings(shape, modes=modes, samples=samples, extrinsic=extrinsic))
        teller(report)(0.2 * (index + 1))
    a, b = min(itertools.product(*sides), key=lambda pair: _spectral_gap(*pair))
    if a.dimension != b.dimension:
        raise InputError(f"the source has intrinsic dimension {a.dimension}, the target {b.dimension}; they must agree")
    _describe(a, b, landmarks, descriptors)
    return match(a, b, method=method, polish=polish, most=most, rng=generator, report=part(report, 0.4, 1.0))
