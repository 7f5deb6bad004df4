"""The two shapes of a registration at unit area, with what it needs to know of each: spectrum, samples, curvature, descriptors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from .. import _core, arrays
from ..arrays import Floats, Ints
from ..clouds import CloudOperators
from ..descriptors import hks, wks
from ..eigen import Eigenpairs, eigenpairs
from ..errors import InputError
from ..inside import closed_surface
from ..near import nearest_neighbors
from ..operators import Operators, operators
from ..sampling import farthest_points
from ..shapes import PointCloud, Shape, TriangleMesh
from ..solvers import Cholesky
from ..sums import gathered

MODES = 120  # eigenfunctions after the constant
TENSOR = 30  # of them in triple products
SAMPLES = 1000
CURVATURE_TIMES = (5e-4, 1e-3, 2e-3, 5e-3)  # of smoothing, of unit area


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
        return chosen, gathered(owner, self.mass, len(chosen))


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


def prepare(shape: Shape | Operators, *, modes: int = MODES, samples: int = SAMPLES, extrinsic: bool = True) -> Side:
    """What registration computes of one shape alone; collections keep it."""
    return _side(*_given(shape), None, modes, samples, extrinsic)


def readings(shape: Shape | Operators, *, modes: int = MODES, samples: int = SAMPLES, extrinsic: bool = True) -> list[Side]:
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
        sample_masses=gathered(owner, mass, len(chosen)),
        curvature=np.zeros((len(mass), 0)),
        descriptors=np.zeros((len(mass), 0)),
        embedded=extrinsic and dimension == 2 and positions.shape[1] == 3,
    )


def spectral_gap(source: Side, target: Side) -> float:
    """How far the spectra are apart: mean difference of the logarithms of the first eigenvalues."""
    count = min(TENSOR, source.modes, target.modes)
    floor = 1e-9 * max(source.values[-1], target.values[-1])
    first, second = (np.log(np.maximum(side.values[:count], floor)) for side in (source, target))
    return float(abs(first - second).mean())


def _standard(values: Floats, mass: Floats) -> Floats:
    """Columns with mean 0 and variance 1, cut at 3."""
    centred = values - mass @ values
    spread = np.sqrt(mass @ centred**2)
    return np.clip(np.divide(centred, spread, out=np.zeros_like(centred), where=spread > 1e-12 * abs(values).max(initial=1e-300)), -3, 3)


def with_curvature(side: Side, oriented: bool) -> Side:
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
    for time in CURVATURE_TIMES:
        matrix = scipy.sparse.csr_array(diagonal + time * side.stiffness)
        factor = Cholesky(matrix, coordinates=side.positions) if factor is None else factor.refactor(matrix)
        columns.append(factor.solve(mass * curvature))
    return replace(side, normals=normals, curvature=_standard(np.stack(columns, 1), side.mass))


def _joined(values: tuple[Floats, Floats], masses: tuple[Floats, Floats], weight: float) -> tuple[Floats, Floats]:
    """Columns of both shapes on one scale: mean 0 and variance 1 over both together, cut at 3, and weighted."""
    mean = sum(mass @ value for value, mass in zip(values, masses, strict=True)) / 2
    spread = np.sqrt(sum(mass @ (value - mean) ** 2 for value, mass in zip(values, masses, strict=True)) / 2)
    alive = spread > 1e-12 * max(abs(values[0]).max(initial=0), abs(values[1]).max(initial=0), 1e-300)
    scale = np.where(alive, weight / np.maximum(spread, 1e-300), 0.0)
    first, second = (np.clip((value - mean) * scale, -3 * weight, 3 * weight) for value in values)
    return first, second


def describe(source: Side, target: Side, landmarks: Any, descriptors: Any) -> None:
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
    if name not in ("hks", "wks"):
        raise InputError(f"descriptors is {name!r}; choose 'hks' or 'wks', or give a pair of arrays")
    functions = np.concatenate([np.ones((len(side.mass), 1)), side.functions], 1)
    values = np.concatenate([[0.0], side.values])
    pairs = Eigenpairs(values, functions, np.zeros_like(values), 0, side.shape)
    return np.log(np.maximum(hks(pairs, k=len(values)), 1e-6)) if name == "hks" else wks(pairs, k=len(values))
