"""Segmentation and denoising of images on surfaces: convex Chan-Vese and total variation, with a certificate (section 8.1)."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import scipy

from .. import _core, arrays
from ..arrays import Floats, Ints, csr_in
from ..clouds import CloudOperators
from ..errors import InputError, NumericalError
from ..files import written
from ..operators import Operators, operators
from ..progress import GapWatch, Progress
from ..results import save_result
from ..shapes import PointCloud, Shape, TriangleMesh
from ..simplices import hat_gradients, simplices
from ..solvers import Cholesky, plus_diagonal
from ..view import Page, Picture
from .contours import cloud_contours

__all__ = ["DenoisingResult", "SegmentationResult", "contours", "denoise", "segment", "segment_path"]

TotalVariation = Literal["isotropic", "edge"]

RELAXATION = 1.8  # of 1 to 2; 1.9 and 1 take more sweeps
CHECK = 10  # sweeps between two certificates
PULL, SOFTEST = 3.0, 1 / 8  # what the nodes' penalty may be of the image's pull before κ is lowered for it, and how far at most
STRENGTH = 10.0  # what it may be after that, before ρ is lowered
SETTLED = 0.1  # share of the image's whole pull that the gap may be for the means to move
HASTY = 100  # sweeps in which that is enough; later on they move when they are solved for, and regions of the same mean become one
BALANCE = 50  # sweeps after which the penalty may be changed
PENALTY = 9.0  # of denoising, for an image of standard deviation 1, in units of the spacing
REDUCTION = 0.07  # of a linear system's residual, a sweep: less takes more sweeps, more buys none
SOLVE, FACTOR = 20, 300  # steps of conjugate gradients that cost as much as a solve with a factor, as the factor


# --- what both methods stand on ----------------------------------------------------------------------------------------------------


class _Surface:
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

    def fields(self, dual: Floats, channels: int) -> Floats:
        """The dual field in the user's coordinates: (m, D), or (m, channels, D); (edges,) or (edges, channels) for tv="edge"."""
        if self.tv == "edge":
            return dual[:, 0].copy() if channels == 1 else dual.copy()
        local = dual.reshape(len(dual), channels, -1)
        turned: Floats = np.einsum("mca,mad->mcd", local, self.frames)
        return turned[:, 0] if channels == 1 else turned


class _System:
    """``(L + D) x = b`` with the stiffness L and a diagonal D, solved every sweep for a right-hand side that hardly changes.

    Conjugate gradients from the last x take a few steps, far fewer than a factor costs. Where they take many (a mesh of very
    unequal triangles, a D of little weight) and a factor would have paid, it is made, and kept from then on.
    """

    def __init__(self, surface: _Surface, diagonal: Floats) -> None:
        self.surface, self.debt = surface, 0
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
        if self.factor is None:
            try:
                self.debt += self.iteration.improve(right, x, REDUCTION, 5 * SOLVE) - SOLVE
            except NumericalError:  # a factor copes, or says what is wrong
                self.debt = FACTOR + 1
            self.debt = max(self.debt, 0)
            if self.debt <= FACTOR:
                return
            self.factor = Cholesky(self.matrix, self.surface.operators.coordinates)
        self.factor.solve(right, out=x)


def _edges(corners: Ints, sides: Floats, areas: Floats) -> tuple[Ints, Floats, Floats]:
    """Edges (e, 2), their lengths, and a third of the areas beside each."""
    pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    vectors = np.concatenate([sides[:, 0], sides[:, 1] - sides[:, 0], sides[:, 1]])
    kept = np.tile(areas, 3) / 3
    proper = pairs[:, 0] != pairs[:, 1]
    pairs, vectors, kept = np.sort(pairs[proper], axis=1).astype(np.int64), vectors[proper], kept[proper]
    _, first, where = np.unique(pairs[:, 0] << 32 | pairs[:, 1], return_index=True, return_inverse=True)
    return pairs[first].astype(np.int32), np.linalg.norm(vectors[first], axis=1), np.bincount(where, kept).astype(np.float64)


def _image(image: Any, count: int, known: npt.NDArray[np.bool_] | None) -> Floats:
    """(n, channels), finite wherever it is known; 0 elsewhere."""
    array = arrays.anything(image, "image")
    if array.ndim not in (1, 2):
        raise InputError(f"image has shape {array.shape}; ({count},) or ({count}, channels) is needed")
    if array.shape[0] != count:
        raise InputError(f"image has {array.shape[0]} values, the shape has {count} vertices; give one (or one row) a vertex")
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


def _in_range(weight: float, what: str) -> None:
    """Refuses a problem whose two terms are too far apart for double precision."""
    if not 1e-9 <= weight <= 1e9:
        raise InputError(f"{what} is {weight:.3g}; from 1e-9 to 1e9 can be solved, so choose another fidelity or rescale the image")


def _mask(mask: Any, count: int) -> npt.NDArray[np.bool_] | None:
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


# --- segmentation ------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class SegmentationResult:
    """Regions of an image on a surface, and how far from the best they can be at most.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
    labels : ndarray (n,) of int32
        Region of each vertex. With two regions 1 is where ``phi > 1/2``, otherwise it is the largest of the memberships.
    phi : ndarray (n,), or (n, regions) for more than two
        Memberships, exactly from 0 to 1: the certified answer of the convex problem.
    means : ndarray (regions, channels)
        Area-weighted averages of the image over the labels, or those that were given.
    areas : ndarray (regions,)
        Area of each label, in squared units of length; they sum to the area of the shape.
    contours : list of ndarray (k, D)
        Polylines on the surface where phi is 1/2 (where a region's membership passes the others'), the greater side to the left;
        closed ones repeat their first point.
    contour_length : float
        Their total length in units of length; where two regions of many meet, counted once.
    primal, dual, gap : float
        Value reached, a lower bound of all values, and ``(primal - dual) / |primal|``, for a surface of unit area.
    threshold_energy, excess : float
        Value of the labels themselves (memberships 0 and 1), and ``(threshold_energy - dual) / |primal|``. With ``tv="edge"`` the
        excess tends to zero; with isotropic total variation a percent is usual, because triangles make the labels' outline jagged.
    dual_field : ndarray (m, D), (m, regions, D) for more than two, or (edges,) for ``tv="edge"``
        Tangent vectors of length at most 1 (1/2 for more than two regions) that prove the bound. On intrinsic triangulations in frames.
    fidelity : float
    iterations : int
    converged : bool
        Whether the gap reached the tolerance.
    history : dict of str to ndarray
        ``iteration``, ``primal``, ``dual``, ``gap`` at each certificate.
    """

    shape: Shape
    labels: Ints
    phi: Floats
    means: Floats
    areas: Floats
    contours: list[Floats]
    contour_length: float
    primal: float
    dual: float
    gap: float
    threshold_energy: float
    excess: float
    dual_field: Floats
    fidelity: float
    iterations: int
    converged: bool
    history: dict[str, npt.NDArray[Any]]

    def __repr__(self) -> str:
        state = "" if self.converged else ", NOT CONVERGED"
        return f"SegmentationResult({len(self.means)} regions, gap {self.gap:.1e} after {self.iterations} iterations{state})"

    @property
    def notes(self) -> tuple[str, ...]:
        """What was noticed: regions that are empty, because no part of the image is worth its boundary at this fidelity."""
        empty = np.flatnonzero(self.areas == 0)
        if not len(empty):
            return ()
        which = f"region {empty[0]} is" if len(empty) == 1 else f"regions {', '.join(map(str, empty))} are"
        return (
            f"{which} empty: at fidelity {self.fidelity:.4g} a boundary costs more than the image gains by it; try {4 * self.fidelity:.4g}",
        )

    def plot(self, image: Any = None, *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints the labels (or an image) with the contours over them; the options are those of :func:`beltrami.plot`."""
        from ..view import plot

        drawn = {"lines": self.contours or None, **options}
        return plot(self.shape, self.labels if image is None else image, path=path, **drawn)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``; the shape with labels and memberships to ``.ply``; a picture to ``.png`` or ``.html``;
        the contours to ``.obj`` (lines), or to ``.csv`` (line, closed, coordinates). :meth:`save_contours` writes them to ``.ply``.
        """
        kinds = {".obj": self.save_contours, ".csv": self.save_contours}
        return save_result(self, path, "a segmentation is", kinds, values=("labels", "phi"))

    def save_contours(self, path: str | os.PathLike[str]) -> Path:
        """Writes the contours: ``.obj`` with lines, ``.ply`` with vertices and edges, ``.csv`` with a point a row."""
        path = arrays.file(path, "path")
        suffix = path.suffix.lower()
        points, number = _stack(self), 0
        if suffix in (".obj", ".ply") and points.shape[1] > 3:
            raise InputError(f"{path}: {suffix} holds points of R^3, these lie in R^{points.shape[1]}; write .csv")
        out: list[str] = []
        if suffix == ".csv":
            out.append(",".join(["line", "closed", *(f"x{axis}" for axis in range(points.shape[1]))]))
            for at, line in enumerate(self.contours):
                closed = int(np.array_equal(line[0], line[-1]))
                out += [",".join([str(at), str(closed), *map(repr, row)]) for row in line.tolist()]
        elif suffix == ".obj":
            spatial = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
            out += [f"v {x!r} {y!r} {z!r}" for x, y, z in spatial.tolist()]
            for line in self.contours:
                out.append("l " + " ".join(str(number + k + 1) for k in range(len(line))))
                number += len(line)
        elif suffix == ".ply":
            spatial = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
            edges = len(points) - len(self.contours)
            out += ["ply", "format ascii 1.0", f"element vertex {len(points)}", *(f"property double {axis}" for axis in "xyz")]
            out += [f"element edge {edges}", "property int vertex1", "property int vertex2", "end_header"]
            out += [f"{x!r} {y!r} {z!r}" for x, y, z in spatial.tolist()]
            for line in self.contours:
                out += [f"{number + k} {number + k + 1}" for k in range(len(line) - 1)]
                number += len(line)
        else:
            raise InputError(f"{path}: contours are written to .obj, .ply or .csv")
        written(path, lambda stream: stream.write(("\n".join(out) + "\n").encode()))
        return path


def _stack(result: SegmentationResult) -> Floats:
    return np.concatenate([result.shape.coordinates[:0], *result.contours])


class _Segmenter:
    """The splitting of one surface and image: one linear system for all fidelities, and the state that the next one starts from."""

    def __init__(self, shape: Shape | Operators, image: Any, regions: int, means: Any, mask: Any, tv: TotalVariation) -> None:
        surface = self.surface = _Surface(shape, tv)
        count = surface.count
        known = _mask(mask, count)
        self.image = _image(image, count, known)
        self.known = (np.ones(count, bool) if known is None else known) & (surface.mass > 0)
        self.data_mass = surface.mass * self.known
        self.regions = arrays.whole(regions, "regions", 2, 1000)
        arrays.room(30.0 * self.regions * count, f"regions = {self.regions} on {count} vertices", "ask for fewer, or take a coarser shape")
        self.given = means is not None
        self.start = self._given(means) if self.given else self._clusters()
        self.means = self.start
        # Penalty and ratio for which the sweeps hardly depend on the size of the mesh: ρ in units of the spacing, κ of its inverse square.
        self.penalty = 1.5 * surface.spacing
        self.ratio = self.softened = 0.35 / surface.spacing**2
        self.system: _System | None = None
        self.split: list[Floats] | None = None

    def _given(self, means: Any) -> Floats:
        table = arrays.anything(means, "means")
        found = arrays.floats(table[:, None] if table.ndim == 1 else table, "means", (self.regions, self.image.shape[1]))
        if len(np.unique(found, axis=0)) < self.regions:
            raise InputError("two of the given means are equal; regions cannot be told apart then")
        return found.copy()

    def _clusters(self) -> Floats:
        """Area-weighted k-means: from quantiles along the image's principal axis, sorted along it."""
        data, weights = self.image[self.known], self.data_mass[self.known]
        if len(data) == 0:
            raise InputError("the image is known at no vertex that belongs to a triangle")
        distinct = len(np.unique(data[:1000], axis=0))  # usually enough, and sorting all takes time
        if distinct < self.regions:
            distinct = len(np.unique(data, axis=0))
        if distinct < self.regions:
            text = "the image is constant" if distinct == 1 else f"the image has {distinct} distinct values"
            raise InputError(f"{text}; {self.regions} regions need at least {self.regions}: ask for fewer, or give means")
        centred = data - weights @ data / weights.sum()
        scale = np.abs(centred).max()
        centred = centred / scale
        _, axes = np.linalg.eigh((centred * weights[:, None]).T @ centred)
        axis = axes[:, -1] * (1 if axes[:, -1].sum() >= 0 else -1)
        position = centred @ axis
        order = np.argsort(position, kind="stable")
        if self.image.shape[1] == 1 and self.regions == 2:
            # the best of all thresholds: the variance between the two sides
            x, w = position[order], weights[order]
            mass, moment = np.cumsum(w)[:-1], np.cumsum(w * x)[:-1]
            rest, rest_moment = w.sum() - mass, (w @ x) - moment
            cut = np.where(np.diff(x) > 0, moment**2 / mass + rest_moment**2 / np.maximum(rest, 1e-300), -np.inf)
            labels = np.zeros(len(data), np.intp)
            labels[order[int(np.argmax(cut)) + 1 :]] = 1
        else:
            share = (np.cumsum(weights[order]) - 0.5 * weights[order]) / weights.sum()
            labels = np.empty(len(data), np.intp)
            labels[order] = np.minimum((share * self.regions).astype(np.intp), self.regions - 1)
            # distinct values first: a quantile may hold one value only
            seeds = np.array([position[labels == k].mean() if (labels == k).any() else np.nan for k in range(self.regions)])
            if np.isnan(seeds).any() or len(np.unique(np.round(seeds, 12))) < self.regions:
                values, where = np.unique(position, return_inverse=True)
                labels = np.minimum(where * self.regions // len(values), self.regions - 1)
        for _ in range(100):
            total = np.bincount(labels, weights, self.regions)
            sums = np.stack([np.bincount(labels, weights * channel, self.regions) for channel in centred.T], 1)
            centres = sums / np.where(total > 0, total, 1.0)[:, None]
            distance = np.stack([np.square(centred - centre).sum(1) for centre in centres], 1)
            distance[:, total == 0] = np.inf
            new = distance.argmin(1)
            for empty in np.flatnonzero(np.bincount(new, minlength=self.regions) == 0):  # it takes the point that fits worst
                worst = int(np.argmax(distance[np.arange(len(new)), new]))
                new[worst], distance[worst] = empty, 0.0
            if np.array_equal(new, labels):
                break
            labels = new
        found = self._averages(np.where(self.known, _spread(labels, self.known), 0), None)
        return found[np.argsort((found - found.mean(0)) @ axis, kind="stable")]

    def _averages(self, labels: npt.NDArray[Any], kept: Floats | None) -> Floats:
        """Step (6): area-weighted averages over the labels; an empty region keeps its mean."""
        total = np.bincount(labels, self.data_mass, self.regions)
        sums = np.stack([np.bincount(labels, self.data_mass * channel, self.regions) for channel in self.image.T], 1)
        means: Floats = sums / np.where(total > 0, total, 1.0)[:, None]
        if kept is not None:
            means[total == 0] = kept[total == 0]
        return means

    def _cost(self, means: Floats, fidelity: float) -> Floats:
        """Step (2): the linear term a unit of area. Two regions: fidelity r, r = |I - c1|² - |I - c0|²; more: fidelity |I - c|² of each."""
        distance = np.stack([np.square(self.image - mean).sum(1) for mean in means], 1)
        cost = distance[:, 1:] - distance[:, :1] if self.regions == 2 else distance
        return np.ascontiguousarray(fidelity * cost * self.known[:, None])

    def _labels(self, phi: Floats) -> npt.NDArray[np.intp]:
        return (phi[:, 0] > 0.5).astype(np.intp) if self.regions == 2 else phi.argmax(1)

    def run(self, fidelity: float, tolerance: float, most: int, watch: GapWatch) -> SegmentationResult:
        surface, elements, mass = self.surface, self.surface.elements, self.surface.mass[:, None]
        channels, radius = (1, 1.0) if self.regions == 2 else (self.regions, 0.5)
        shape = (elements_count(surface), channels * (surface.corners.shape[1] - 1 if surface.tv == "isotropic" else 1))
        means, weights = self.means, surface.weights
        with np.errstate(over="ignore"):
            cost = self._cost(means, fidelity)
        top = float(np.abs(cost).max())
        _in_range(top, "fidelity times the squared contrast")
        scale = float((mass * np.abs(cost)).sum())
        if self.split is None:
            z = (cost < 0).astype(float) if channels == 1 else (cost == cost.min(1, keepdims=True)).astype(float)
            z /= z.sum(1, keepdims=True) if channels > 1 else 1.0
            self.split = [np.zeros(shape), np.zeros(shape), z, np.zeros_like(z)]
        w, p, z, y = self.split  # splits of the gradient and of phi, each with its multiplier
        phi, right, flux = z.copy(), np.zeros_like(z), np.zeros_like(z)

        def pull(cost: Floats) -> float:
            """How strongly the image moves phi: the root of the mean square of the cost."""
            top = max(float(np.abs(cost).max()), 1e-300)
            return top * float(np.sqrt((mass * np.square(cost / top)).sum() / channels))

        ratio = self.ratio * float(np.clip(PULL * pull(cost) / (self.penalty * self.ratio), SOFTEST, 1.0))
        if self.system is None:
            self.system = _System(surface, ratio * weights)
        elif ratio != self.softened:
            self.system.change(ratio * weights)
        system, self.softened = self.system, ratio

        def fitting(cost: Floats) -> float:
            """A weak image moves phi slowly against a strong penalty."""
            return float(self.penalty * np.clip(STRENGTH * pull(cost) / (self.penalty * ratio), 1e-12, 1.0))

        penalty = fitted = fitting(cost)

        def tv(values: Floats) -> float:
            return radius * elements.total_variation(values, False)

        def restart() -> None:
            elements.flux(w - p / penalty, right)
            np.add(right, ratio * weights[:, None] * (z - y / (penalty * ratio)), out=right)

        def certificate() -> tuple[Floats, Floats, Floats, float, float, float]:
            """The better of both copies of phi, its labels' means and cost (steps 6 and 2), primal, dual and gap for these."""
            candidates = [np.clip(phi, 0, 1), z] if channels == 1 else [z]
            if surface.tv == "edge" and channels == 1:  # the coarea formula is exact on a graph: a threshold is as good
                candidates.append((phi > 0.5).astype(float))
            whole = np.zeros_like(z)  # all in one region: a weak image hardly moves the mean of phi, however far the rest is
            totals = (mass * cost).sum(0)
            if channels > 1 or totals[0] < 0:
                whole[:, int(totals.argmin())] = 1.0
            values = [*(tv(candidate) for candidate in candidates), 0.0]
            candidates.append(whole)
            best = int(np.argmin([value + float((mass * cost * c).sum()) for value, c in zip(values, candidates, strict=True)]))
            found = candidates[best]
            elements.flux(p, flux)

            def judged(cost: Floats) -> tuple[float, float, float]:
                primal = values[best] + float((mass * cost * found).sum())
                slack = flux + mass * cost
                dual = float(np.minimum(slack, 0).sum() if channels == 1 else slack.min(1).sum())
                return primal, dual, (primal - dual) / max(abs(primal), 1e-3 * scale, 1e-300)

            # Means of a phi that still swings would lose the regions. Later on they move only once they are solved for: two that
            # take turns would go on for ever.
            now = judged(cost)
            settled = now[2] <= tolerance or (sweep <= HASTY and now[0] - now[1] <= SETTLED * float((mass * np.abs(cost)).sum()))
            if self.given or not settled:
                return found, means, cost, *now
            new = self._averages(self._labels(found), means)
            new_cost = self._cost(new, fidelity)
            return found, new, new_cost, *judged(new_cost)

        history: list[tuple[int, float, float, float]] = []
        converged, sweep, united = False, 0, np.zeros(0)  # the means for which two regions were made one
        restart()
        for sweep in range(1, most + 1):
            system.solve(right, phi)  # step (3): (L + κ M) phi = G^T A (W - B) + κ M (z - y / σ)
            missed, moved = elements.shrink(phi, w, p, right, False, radius, penalty, RELAXATION)  # steps (4) and (5)
            off, shifted = _core.constrain(phi, cost, weights, z, y, right, penalty * ratio, ratio, RELAXATION)  # 0 <= phi <= 1
            if sweep % CHECK and sweep != most:
                continue
            found, means, cost, primal, dual, gap = certificate()  # steps (6) and (2)
            history.append((sweep, primal, dual, gap))
            watch(gap, sweep / most)
            if gap <= tolerance:
                converged = True
                break
            if sweep > HASTY and channels > 1 and united is not means and self._unite(found, means, cost, (w, z, phi), (p, y), tv):
                united = means
                restart()
            # Means that have moved make another image.
            fit = fitting(cost)
            factor = 1.0 if fitted / 2 <= fit <= 2 * fitted else fit / fitted
            fitted = fitted if factor == 1.0 else fit
            if sweep % BALANCE == 0:
                factor *= _balance(missed + ratio * off, moved + ratio * shifted)
            if factor != 1.0:
                penalty *= factor
                restart()
        self.means = means
        return self._result(found, means, cost, history, sweep, converged, fidelity, radius, p)

    def _unite(
        self,
        found: Floats,
        means: Floats,
        cost: Floats,
        splits: Sequence[Floats],
        multipliers: Sequence[Floats],
        tv: Callable[[Floats], float],
    ) -> bool:
        """Makes one of the two regions whose means are nearest, where that is better: a boundary between equals takes long to shrink.

        Both get the average of their multipliers, as in a minimum where they cost the same.
        """
        pairs = np.array(list(itertools.combinations(range(self.regions), 2)))
        one, other = pairs[np.argmin(np.square(means[pairs[:, 0]] - means[pairs[:, 1]]).sum(1))]
        if not found[:, other].any() or not found[:, one].any():
            return False
        mass, united = self.surface.mass, found.copy()
        both = mass * (found[:, one] + found[:, other])
        if both @ cost[:, other] < both @ cost[:, one]:
            one, other = other, one
        united[:, one] += united[:, other]
        united[:, other] = 0.0
        if tv(united) + float((mass[:, None] * cost * united).sum()) >= tv(found) + float((mass[:, None] * cost * found).sum()):
            return False
        for field in splits:
            split = field.reshape(len(field), self.regions, -1)
            split[:, one] += split[:, other]
            split[:, other] = 0.0
        for field in multipliers:
            multiplier = field.reshape(len(field), self.regions, -1)
            multiplier[:, one] = multiplier[:, other] = 0.5 * (multiplier[:, one] + multiplier[:, other])
        return True

    def _result(
        self,
        found: Floats,
        means: Floats,
        cost: Floats,
        history: list[tuple[int, float, float, float]],
        sweep: int,
        converged: bool,
        fidelity: float,
        radius: float,
        p: Floats,
    ) -> SegmentationResult:
        surface, ops = self.surface, self.surface.operators
        labels = self._labels(found)
        corners = (labels[:, None] == (1 if self.regions == 2 else np.arange(self.regions))).astype(float)
        energy = radius * surface.elements.total_variation(corners, False) + float((surface.mass[:, None] * cost * corners).sum())
        _, primal, dual, gap = history[-1]
        if self.regions == 2:
            lines, length = _lines(surface, found[:, 0], 0.5)
        else:
            lines, length = [], 0.0
            for region in range(self.regions):
                others = np.delete(found, region, axis=1).max(1)
                some, long = _lines(surface, found[:, region] - others, 0.0)
                lines, length = lines + some, length + 0.5 * long
        columns = [np.array(column) for column in zip(*history, strict=True)]
        return SegmentationResult(
            shape=ops.shape,
            labels=labels.astype(np.int32),
            phi=found[:, 0].copy() if self.regions == 2 else found.copy(),
            means=means,
            areas=np.bincount(labels, ops.mass, self.regions).astype(np.float64),
            contours=lines,
            contour_length=length,
            primal=primal,
            dual=dual,
            gap=gap,
            threshold_energy=energy,
            excess=(energy - dual) / max(abs(primal), 1e-300),
            dual_field=surface.fields(p, found.shape[1]),
            fidelity=fidelity,
            iterations=sweep,
            converged=converged,
            history=dict(zip(("iteration", "primal", "dual", "gap"), columns, strict=True)),
        )


def elements_count(surface: _Surface) -> int:
    """Elements of the surface's total variation: simplices, or edges."""
    return len(surface.edges) if surface.tv == "edge" else len(surface.corners)


def _spread(values: npt.NDArray[Any], where: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    out = np.zeros(len(where), np.intp)
    out[where] = values
    return out


def _balance(primal: float, dual: float) -> float:
    """Factor of the penalty where one squared residual is far above the other (He, Yang and Wang 2000)."""
    if primal / 100 > dual:
        return 2.0
    if dual / 100 > primal:
        return 0.5
    return 1.0


def _lines(surface: _Surface, values: Floats, level: float) -> tuple[list[Floats], float]:
    """Contours in the user's units, and their length."""
    shape = surface.operators.shape
    if isinstance(shape, TriangleMesh):
        found = contours(shape, values, level=level)
        return found, float(sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in found))
    if surface.corners.shape[1] != 3 or not isinstance(surface.operators, CloudOperators):
        return [], 0.0
    # A cloud's triangles count by their votes; lines run over those that most of their corners see.
    ops = surface.operators
    faces = np.ascontiguousarray(ops.simplices[ops.votes >= 2])
    found = _polylines(_core.level_set((shape.points, faces), np.ascontiguousarray(values), level))
    return found, float(sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in found))


def _polylines(parts: tuple[Floats, Ints, Floats, npt.NDArray[np.int64], npt.NDArray[np.bool_]]) -> list[Floats]:
    points, _, _, starts, _ = parts
    return [points[a:b].copy() for a, b in itertools.pairwise(starts)]


def contours(shape: Shape | Operators, values: npt.ArrayLike, *, level: float = 0.5) -> list[Floats]:
    """Where a piecewise-linear function on a surface takes a level: ordered polylines.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        Of a surface. On clouds the function is linear on the triangles of the local mesh: those with more votes go first, and ends
        that are left within two edge lengths, where stars disagree, are joined.
    values : array_like (n,)
        A vertex counts as above where its value is greater than the level.
    level : float

    Returns
    -------
    list of ndarray (k, D)
        Points on edges, in units of length; the greater side to the left of a consistently oriented mesh. Closed polylines repeat
        their first point; others end at a boundary, or where more than two triangles share an edge.

    Raises
    ------
    InputError
        Not one finite value a vertex.

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
    return _polylines(_core.level_set((mesh.vertices, mesh.faces), numbers, arrays.number(level, "level")))


def segment(
    shape: Shape | Operators,
    image: npt.ArrayLike,
    *,
    fidelity: float = 100.0,
    regions: int = 2,
    means: npt.ArrayLike | None = None,
    mask: npt.ArrayLike | None = None,
    tv: TotalVariation = "isotropic",
    tolerance: float | None = None,
    max_iterations: int = 2000,
    progress: Progress = None,
) -> SegmentationResult:
    """Divide an image on a surface into regions of nearly constant value with short boundaries: convex Chan-Vese [1]_ [2]_.

    Over memberships 0 <= φ <= 1 and the means c of the regions, on the surface scaled to unit area,

        ``∫ |grad φ| + fidelity ∫ r φ``,  ``r = |I - c_1|² - |I - c_0|²``

    is made least by the alternating direction method of multipliers (section 8.1, steps (1)-(7), with a second split for the
    bounds): a solve (one matrix throughout), a shrinkage on each triangle and a clipping at each vertex a sweep. The means are
    updated as area-weighted averages. For the means that are returned the problem is convex, and ``dual`` bounds it from below.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        With or without boundary, in any number of pieces.
    image : array_like (n,) or (n, channels)
    fidelity : float
        Weight of the image against the length of the boundary, dimensionless but for the image's own units, squared: details
        smaller than about ``sqrt(area) / (fidelity * contrast²)`` are smoothed away. Start with ``30 / contrast²`` and see
        :func:`segment_path`.
    regions : int
        K. More than two share memberships on the simplex: ``1/2 Σ_l ∫ |grad φ_l| + fidelity Σ_l ∫ φ_l |I - c_l|²``.
    means : array_like (regions,) or (regions, channels), optional
        Fixed means. Otherwise they are estimated, beginning with area-weighted k-means.
    mask : array_like (n,) of bool, optional
        True where the image is known; elsewhere it may hold NaN, and only the length of the boundary counts.
    tv : {"isotropic", "edge"}
        Total variation of linear functions on triangles; or ``Σ w |φ_a - φ_b|`` over edges with the weights of Cauchy-Crofton,
        ``w = π/2 (A_1 + A_2) / 3 / length``, whose minimum is that of a graph cut.
    tolerance : float, optional
        Relative gap to stop at: 1e-4, or 1e-6 for ``tv="edge"``.
    max_iterations : int
    progress : bool or callable, optional

    Returns
    -------
    SegmentationResult
        With ``converged=False`` if the gap was not reached.

    Raises
    ------
    InputError
        The image does not fit the shape, is not finite or has fewer distinct values than regions; an option is out of range.

    See Also
    --------
    segment_path, denoise, contours

    References
    ----------
    .. [1] T. Chan, S. Esedoglu, M. Nikolova, Algorithms for finding global minimizers of image segmentation and denoising models, 2006.
    .. [2] R. Lai, T. Chan, A framework for intrinsic image processing on surfaces, 2011.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> sphere = bt.shapes.sphere(4)
    >>> image = (sphere.vertices[:, 2] > 0.5) + 0.4 * np.random.default_rng(0).normal(size=len(sphere.vertices))
    >>> found = bt.segment(sphere, image, fidelity=40.0)
    >>> found.converged, len(found.contours), bool(abs(found.areas[1] / np.pi - 1) < 0.05)
    (True, 1, True)
    """
    return segment_path(
        shape,
        image,
        fidelities=[arrays.number(fidelity, "fidelity", above=0)],
        regions=regions,
        means=means,
        mask=mask,
        tv=tv,
        tolerance=tolerance,
        max_iterations=max_iterations,
        progress=progress,
    )[0]


def segment_path(
    shape: Shape | Operators,
    image: npt.ArrayLike,
    *,
    fidelities: Sequence[float] | npt.ArrayLike = (10.0, 100.0, 1000.0),
    regions: int = 2,
    means: npt.ArrayLike | None = None,
    mask: npt.ArrayLike | None = None,
    tv: TotalVariation = "isotropic",
    tolerance: float | None = None,
    max_iterations: int = 2000,
    progress: Progress = None,
) -> list[SegmentationResult]:
    """Segmentations for several fidelities, so that one can be chosen: one linear system serves all, each starts from the one before.

    Parameters
    ----------
    fidelities : sequence of float
        In the order in which they are wanted; ascending or descending goes fastest.
    shape, image, regions, means, mask, tv, tolerance, max_iterations, progress
        As for :func:`segment`.

    Returns
    -------
    list of SegmentationResult
        One a fidelity, in the order given.

    Raises
    ------
    InputError
        As for :func:`segment`; or ``fidelities`` is empty.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> grid = bt.shapes.grid(33, 33)
    >>> x, y = grid.vertices[:, 0], grid.vertices[:, 1]
    >>> image = np.hypot(x - 0.4, y - 0.4) < 0.25
    >>> [round(r.contour_length, 1) for r in bt.segment_path(grid, image, fidelities=[3, 30])]
    [0.0, 1.7]
    """
    wanted = [arrays.number(value, "fidelities", above=0) for value in np.atleast_1d(arrays.anything(fidelities, "fidelities")).ravel()]
    if not wanted:
        raise InputError("fidelities is empty; give at least one")
    wished = arrays.number((1e-6 if tv == "edge" else 1e-4) if tolerance is None else tolerance, "tolerance", above=0)
    most = arrays.whole(max_iterations, "max_iterations", 1)
    segmenter = _Segmenter(shape, image, regions, means, mask, tv)
    results = []
    for value in wanted:
        results.append(segmenter.run(value, wished, most, GapWatch(progress, "segment", wished)))
        populated = np.bincount(results[-1].labels, minlength=segmenter.regions) > 0
        if not segmenter.given and not populated.all():
            segmenter.means = segmenter.start  # a region died out: the next fidelity begins with all of them
    return results


# --- denoising ---------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class DenoisingResult:
    """A denoised image, and how far from the best it can be at most.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
    image : ndarray (n,) or (n, channels)
    primal, dual, gap : float
        Value reached, a lower bound of all values, and ``(primal - dual) / primal``, for a surface of unit area.
    dual_field : ndarray (m, D), (m, channels, D), or (edges,), (edges, channels) for ``tv="edge"``
        Of length at most 1; it proves the bound.
    fidelity : float
    iterations : int
    converged : bool
    history : dict of str to ndarray
        ``iteration``, ``primal``, ``dual``, ``gap`` at each certificate.
    """

    shape: Shape
    image: Floats
    primal: float
    dual: float
    gap: float
    dual_field: Floats
    fidelity: float
    iterations: int
    converged: bool
    history: dict[str, npt.NDArray[Any]]

    def __repr__(self) -> str:
        state = "" if self.converged else ", NOT CONVERGED"
        return f"DenoisingResult(gap {self.gap:.1e} after {self.iterations} iterations{state})"

    def plot(self, *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints the image; three channels count as colours. The options are those of :func:`beltrami.plot`."""
        from ..view import plot

        values: Any = self.image
        if values.ndim == 2 and values.shape[1] == 3 and values.min() >= -0.01 and values.max() <= 1.01:
            values = np.clip(values, 0, 1)
        elif values.ndim == 2:
            values = {f"channel {k}": channel for k, channel in enumerate(values.T)}
        return plot(self.shape, values, path=path, **options)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``, the shape with the image to ``.ply``, a picture to ``.png`` or ``.html``."""
        return save_result(self, path, "a denoised image is", values=("image",))


def denoise(
    shape: Shape | Operators,
    image: npt.ArrayLike,
    *,
    fidelity: float = 100.0,
    mask: npt.ArrayLike | None = None,
    tv: TotalVariation = "isotropic",
    tolerance: float = 1e-4,
    max_iterations: int = 2000,
    progress: Progress = None,
) -> DenoisingResult:
    """Denoise an image on a surface by total variation (Rudin, Osher and Fatemi [1]_), colour and other channels together [2]_.

    ``∫ |grad u| + fidelity / 2 ∫ |u - I|²`` over the surface scaled to unit area, |·| the Frobenius norm over the channels. Edges
    stay sharp, each piece keeps its mean, and ``dual`` proves how close to the minimum the answer is.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
    image : array_like (n,) or (n, channels)
    fidelity : float
        Larger stays nearer to the image; in units of one over the image's. A round patch of height a and radius R (unit area) survives
        if ``fidelity > 2 / (a R)``.
    mask : array_like (n,) of bool, optional
        True where the image is known. Elsewhere it may hold NaN and is filled in, within the range of the known values.
    tv : {"isotropic", "edge"}
        As for :func:`segment`; "edge" sums over the edges.
    tolerance : float
        Relative gap to stop at.
    max_iterations : int
    progress : bool or callable, optional

    Returns
    -------
    DenoisingResult
        With ``converged=False`` if the gap was not reached.

    Raises
    ------
    InputError
        The image does not fit the shape or is not finite; an option is out of range; a piece of the shape has no known value.

    References
    ----------
    .. [1] L. Rudin, S. Osher, E. Fatemi, Nonlinear total variation based noise removal algorithms, 1992.
    .. [2] P. Blomgren, T. Chan, Color TV: total variation methods for restoration of vector-valued images, 1998.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> sphere = bt.shapes.sphere(4)
    >>> clean = (sphere.vertices[:, 2] > 0.3).astype(float)
    >>> noisy = clean + 0.3 * np.random.default_rng(0).normal(size=len(clean))
    >>> u = bt.denoise(sphere, noisy, fidelity=80.0)
    >>> u.converged, bool(np.abs(u.image - clean).mean() < 0.3 * np.abs(noisy - clean).mean())
    (True, True)
    """
    fidelity = arrays.number(fidelity, "fidelity", above=0)
    tolerance = arrays.number(tolerance, "tolerance", above=0)
    most = arrays.whole(max_iterations, "max_iterations", 1)
    surface = _Surface(shape, tv)
    known = _mask(mask, surface.count)
    data = _image(image, surface.count, known)
    flat = np.ndim(image) == 1
    everywhere = known is None
    known = np.ones(surface.count, bool) if known is None else known
    pieces = surface.operators.component_labels
    blind = np.flatnonzero(np.bincount(pieces, known) == 0)
    if len(blind):
        at = int(np.flatnonzero(pieces == blind[0])[0])
        raise InputError(f"the piece of the shape with vertex {at} has no known value; take it out or make its mask True somewhere")
    # The image's deviation is the unit of its values, so that one penalty fits all.
    low, high = data[known].min(0), data[known].max(0)
    share = surface.mass[known] / max(surface.mass[known].sum(), 1e-300)
    centre = share @ data[known]
    span = float((high - low).max())
    unit = span * float(np.sqrt(share @ np.square((data[known] - centre) / span).sum(1))) if span > 0 else 0.0
    if unit <= 0:
        empty = np.zeros((elements_count(surface), data.shape[1] * (surface.corners.shape[1] - 1 if tv == "isotropic" else 1)))
        filled = np.where(known[:, None], data, low)
        history: dict[str, npt.NDArray[Any]] = {name: np.zeros(0) for name in ("iteration", "primal", "dual", "gap")}
        fields = surface.fields(empty, data.shape[1])
        return DenoisingResult(surface.operators.shape, filled[:, 0] if flat else filled, 0.0, 0.0, 0.0, fields, fidelity, 0, True, history)
    target = (data - centre) / unit * known[:, None]
    least, greatest = (low - centre) / unit, (high - centre) / unit
    weight = fidelity * unit
    _in_range(weight, "fidelity times the image's deviation")
    mass = surface.mass[:, None]
    loose = surface.mass == 0  # they keep their values
    pull = weight * surface.mass * known + loose * (weight / surface.count)
    elements, channels = surface.elements, data.shape[1]
    penalty = PENALTY * surface.spacing
    shape_of = (elements_count(surface), channels * (surface.corners.shape[1] - 1 if tv == "isotropic" else 1))
    w, p = np.zeros(shape_of), np.zeros(shape_of)
    u, right, flux = np.zeros_like(target), np.zeros_like(target), np.zeros_like(target)
    system = _System(surface, pull / penalty)
    watch = GapWatch(progress, "denoise", tolerance)
    steps: list[tuple[int, float, float, float]] = []
    converged, sweep, best = False, 0, target
    for sweep in range(1, most + 1):
        right += pull[:, None] / penalty * target
        system.solve(right, u)  # (L + μ M / ρ) u = G^T A (W - B) + μ M I / ρ
        missed, moved = elements.shrink(u, w, p, right, True, 1.0, penalty, RELAXATION)
        if sweep % CHECK and sweep != most:
            continue
        elements.flux(p, flux)
        with np.errstate(divide="ignore", invalid="ignore"):
            drop = np.where(mass > 0, flux / (weight * mass), 0.0)
        free = (flux * np.where(flux > 0, least, greatest))[~known].sum()
        dual = float((flux * target)[known].sum() - 0.5 * (flux * drop)[known].sum() + free)
        # each piece has the mean of its image, and that is best, however well the system was solved
        offsets = np.stack([np.bincount(pieces, pull * channel) for channel in (u - target).T], 1) / np.bincount(pieces, pull)[:, None]
        inside = u - offsets[pieces]
        if not everywhere:
            inside[~known] = np.clip(inside[~known], least, greatest)
        choices = [inside, np.where(known[:, None], target - drop, inside)]
        values = [
            elements.total_variation(choice, True) + 0.5 * weight * float((mass * np.square(choice - target))[known].sum())
            for choice in choices
        ]
        primal, best = min(values), choices[int(np.argmin(values))]
        gap = (primal - dual) / max(primal, 1e-300)
        steps.append((sweep, unit * primal, unit * dual, gap))
        watch(gap, sweep / most)
        if gap <= tolerance:
            converged = True
            break
        if sweep % BALANCE == 0:
            change = _balance(missed, moved)
            if change != 1.0:
                penalty *= change
                system.change(pull / penalty)
                elements.flux(w - p / penalty, right)
    answer = best * unit + centre
    columns = [np.array(column) for column in zip(*steps, strict=True)]
    return DenoisingResult(
        shape=surface.operators.shape,
        image=answer[:, 0].copy() if flat else answer,
        primal=steps[-1][1],
        dual=steps[-1][2],
        gap=steps[-1][3],
        dual_field=surface.fields(p, channels),
        fidelity=fidelity,
        iterations=sweep,
        converged=converged,
        history=dict(zip(("iteration", "primal", "dual", "gap"), columns, strict=True)),
    )
