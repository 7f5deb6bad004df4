"""What segmentation and denoising share: a shape of unit area, the linear system of each sweep, the check of the image."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import scipy

from .. import _core, arrays
from ..arrays import Floats, Ints, csr_in
from ..errors import InputError, NumericalError
from ..operators import Operators, operators
from ..shapes import Shape
from ..simplices import hat_gradients, simplices
from ..solvers import Cholesky, plus_diagonal

TotalVariation = Literal["isotropic", "edge"]
RELAXATION = 1.8  # of 1 to 2; 1.9 and 1 take more sweeps
CHECK = 10  # sweeps between two certificates
BALANCE = 50  # sweeps after which the penalty may be changed
REDUCTION = 0.07  # of a linear system's residual, a sweep: less takes more sweeps, more buys none
SOLVE, FACTOR = 20, 300  # steps of conjugate gradients that cost as much as a solve with a factor, as the factor
COUPLED = 0.98  # of two vertices, at most 1, from which on a small residual says little about their difference


class Surface:
    """A shape of unit area: its elements, stiffness and mass. ``length`` is the user's length of one unit."""

    def __init__(self, shape: Shape | Operators, tv: TotalVariation) -> None:
        ops = self.operators = operators(shape)
        arrays.word(tv, "tv", get_args(TotalVariation))
        corners, sides, areas = simplices(ops)
        dimension = corners.shape[1] - 1
        if dimension not in (1, 2, 3):
            raise InputError(f"total variation is there for surfaces and volumes; this shape has dimension {dimension}")
        total = float(ops.mass.sum())
        self.tv, self.count = tv, len(ops.mass)
        self.length = total ** (1 / dimension)
        self.mass = ops.mass / total
        self.weights = np.where(self.mass > 0, self.mass, 1 / self.count)  # of the splitting only: vertices of no triangle take part
        self.corners, self.areas, sides = corners, areas / total, sides / self.length
        if tv == "isotropic":
            hats, self.frames = hat_gradients(sides)
            self.elements = _core.Elements(self.count, corners, hats, np.ascontiguousarray(self.areas))
            self.stiffness = scipy.sparse.csr_array(ops.stiffness * (self.length**2 / total))
            self.spacing = (1 / np.count_nonzero(ops.mass)) ** (1 / dimension)
        else:
            if dimension != 2:
                raise InputError(f"tv='edge' is there for surfaces; this shape has dimension {dimension}")
            self.edges, lengths, beside = _edges(corners, sides, self.areas)
            weights = np.pi / 2 * beside  # of the slope along an edge: Cauchy-Crofton
            self.elements = _core.Elements(self.count, self.edges, 1 / lengths[:, None], weights)
            a, b = self.edges.T
            w = weights / lengths**2
            graph = scipy.sparse.coo_array((np.r_[-w, -w, w, w], (np.r_[a, b, a, b], np.r_[b, a, a, b])), shape=(self.count, self.count))
            self.stiffness = scipy.sparse.csr_array(graph)
            self.spacing = float(lengths.mean())

    def table(self, channels: int) -> tuple[int, int]:
        """Shape of the tables that the core takes: a row per element (simplex or edge), the coordinates of each channel's slope in it."""
        if self.tv == "edge":
            return len(self.edges), channels
        return len(self.corners), channels * (self.corners.shape[1] - 1)

    def fields(self, dual: Floats, channels: int) -> Floats:
        """The dual field in the user's coordinates: (m, D), or (m, channels, D); (edges,) or (edges, channels) for tv="edge"."""
        if self.tv == "edge":
            return dual[:, 0].copy() if channels == 1 else dual.copy()
        local = dual.reshape(len(dual), channels, -1)
        turned: Floats = np.einsum("mca,mad->mcd", local, self.frames)
        return turned[:, 0] if channels == 1 else turned


class System:
    """``(L + D) x = b`` with the stiffness L and a diagonal D, solved every sweep for a right-hand side that hardly changes.

    Conjugate gradients from the last x take a few steps, far fewer than a factor costs. Where they take many (a mesh of very
    unequal triangles, a D of little weight) and a factor would have paid, it is made, and kept from then on; at once where two
    vertices hardly differ in place, for then steps end with a small residual and the difference of these two wrong.
    """

    def __init__(self, surface: Surface, diagonal: Floats) -> None:
        self.surface = surface
        self.debt = FACTOR + 1 if _coupling(surface.stiffness, diagonal) > COUPLED else 0
        self.factor: Cholesky | None = None
        self.change(diagonal)

    def change(self, diagonal: Floats) -> None:
        self.matrix = plus_diagonal(self.surface.stiffness, diagonal)
        if self.factor is None:
            self.iteration = _core.Conjugate(csr_in(self.matrix, "the matrix"))
        else:
            self.factor.refactor(self.matrix)

    def solve(self, right: Floats, x: Floats) -> None:
        """Moves x to the solution, or towards it as far as a sweep needs."""
        if self.factor is None and self.debt <= FACTOR:
            try:
                self.debt += self.iteration.improve(right, x, REDUCTION, 5 * SOLVE) - SOLVE
            except NumericalError:  # a factor copes, or says what is wrong
                self.debt = FACTOR + 1
            self.debt = max(self.debt, 0)
            if self.debt <= FACTOR:
                return
        if self.factor is None:
            self.factor = Cholesky(self.matrix, self.surface.operators.coordinates)
        self.factor.solve(right, out=x)


def _coupling(stiffness: scipy.sparse.csr_array, diagonal: Floats) -> float:
    """The largest entry beside the diagonal of ``L + D``, its diagonal scaled to 1."""
    root = np.sqrt(np.maximum(stiffness.diagonal() + diagonal, 1e-300))
    rows = np.repeat(np.arange(len(root)), np.diff(stiffness.indptr))
    beside = np.flatnonzero(rows != stiffness.indices)
    rows, columns = rows[beside], stiffness.indices[beside]
    return float((np.abs(stiffness.data[beside]) / root[rows] / root[columns]).max(initial=0.0))


def _edges(corners: Ints, sides: Floats, areas: Floats) -> tuple[Ints, Floats, Floats]:
    """Edges (e, 2), their lengths, and a third of the areas beside each."""
    pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    vectors = np.concatenate([sides[:, 0], sides[:, 1] - sides[:, 0], sides[:, 1]])
    kept = np.tile(areas, 3) / 3
    proper = pairs[:, 0] != pairs[:, 1]
    pairs, vectors, kept = np.sort(pairs[proper], axis=1).astype(np.int64), vectors[proper], kept[proper]
    _, first, where = np.unique(pairs[:, 0] << 32 | pairs[:, 1], return_index=True, return_inverse=True)
    return pairs[first].astype(np.int32), np.linalg.norm(vectors[first], axis=1), np.bincount(where, kept).astype(np.float64)


def image_in(image: Any, count: int, known: npt.NDArray[np.bool_] | None) -> Floats:
    """(n, channels), finite wherever it is known; 0 elsewhere."""
    array = arrays.anything(image, "image")
    if array.ndim not in (1, 2):
        raise InputError(f"image has shape {array.shape}; ({count},) or ({count}, channels) is needed")
    if array.shape[0] != count:
        raise InputError(f"image has {array.shape[0]} values, the shape has {count} vertices; give one (or one row) per vertex")
    table = arrays.floats(array, "image", (count,) if array.ndim == 1 else (count, None), finite=False).reshape(count, -1)
    if known is None and not np.isfinite(table).all():
        at, lacking = int(np.argwhere(~np.isfinite(table))[0][0]), int((~np.isfinite(table)).any(axis=1).sum())
        remedy = f"replace it, or say where the image is known: mask=np.isfinite(image){'' if array.ndim == 1 else '.all(axis=1)'}"
        raise InputError(f"image[{at}] is {array[at]}, one of {lacking} vertices without a number; {remedy}")
    if table.shape[1] == 0:
        raise InputError("image has no channels")
    if known is None or known.any():
        most = float(np.abs(table if known is None else np.nan_to_num(table[known], posinf=0.0, neginf=0.0)).max())
        if most > 1e100:
            raise InputError(f"image has values up to {most:.3g}; divide it by some unit so that they stay below 1e100")
    if known is not None:
        table = table.copy()
        table[~known] = 0.0
        if not np.isfinite(table).all():
            where = int(np.argwhere(~np.isfinite(table))[0, 0])
            raise InputError(f"image[{where}] is not finite although the mask says that it is known; set mask[{where}] to False")
    return table


def check_range(weight: float, what: str) -> None:
    """Refuses a problem whose two terms are too far apart for double precision."""
    if not 1e-9 <= weight <= 1e9:
        raise InputError(f"{what} is {weight:.3g}; from 1e-9 to 1e9 can be solved, so choose another fidelity or rescale the image")


def mask_in(mask: Any, count: int) -> npt.NDArray[np.bool_] | None:
    if mask is None:
        return None
    known = arrays.anything(mask, "mask")
    if known.dtype.kind != "b" or known.shape != (count,):
        raise InputError(
            f"mask has dtype {known.dtype} and shape {known.shape}; ({count},) booleans are needed, True where the image is known"
        )
    if not known.any():
        raise InputError("mask is False everywhere; the image must be known somewhere")
    return known.copy()


def balance(primal: float, dual: float) -> float:
    """Factor of the penalty where one squared residual is far above the other (He, Yang and Wang 2000)."""
    if primal / 100 > dual:
        return 2.0
    if dual / 100 > primal:
        return 0.5
    return 1.0
