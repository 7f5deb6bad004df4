"""Segmentation and denoising of images on surfaces: convex Chan-Vese and total variation, with a certificate (section 8.1)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core, arrays
from ..arrays import Floats
from ..errors import InputError
from ..operators import Operators
from ..progress import GapWatch, Progress
from ..shapes import Shape
from ..sums import weighted_sum
from .denoising import DenoisingResult, denoise
from .level_sets import contours, lines_of
from .result import SegmentationResult
from .surface import BALANCE, CHECK, RELAXATION, Surface, System, TotalVariation, balance, check_range, image_in, mask_in

__all__ = ["DenoisingResult", "SegmentationResult", "contours", "denoise", "segment", "segment_path"]

PULL, SOFTEST = 3.0, 1 / 8  # what the nodes' penalty may be of the image's pull before κ is lowered for it, and how far at most
STRENGTH = 10.0  # what it may be after that, before ρ is lowered
SETTLED = 0.1  # share of the image's whole pull that the gap may be for the means to move
HASTY = 100  # sweeps in which that is enough; later on they move when they are solved for, and regions of the same mean become one


class _Segmenter:
    """The splitting of one surface and image: one linear system for all fidelities, and the state that the next one starts from."""

    def __init__(self, shape: Shape | Operators, image: Any, regions: int, means: Any, mask: Any, tv: TotalVariation) -> None:
        surface = self.surface = Surface(shape, tv)
        count = surface.count
        known = mask_in(mask, count)
        self.image = image_in(image, count, known)
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
        self.system: System | None = None
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
        centred = data - weighted_sum(data.T, weights) / weights.sum()
        scale = np.abs(centred).max()
        centred = centred / scale
        _, axes = np.linalg.eigh(np.einsum("n,nc,nd->cd", weights, centred, centred))
        axis = axes[:, -1] * (1 if axes[:, -1].sum() >= 0 else -1)
        position = centred @ axis
        order = np.argsort(position, kind="stable")
        if self.image.shape[1] == 1 and self.regions == 2:
            # the best of all thresholds: the variance between the two sides
            x, w = position[order], weights[order]
            mass, moment = np.cumsum(w)[:-1], np.cumsum(w * x)[:-1]
            rest, rest_moment = w.sum() - mass, (w * x).sum() - moment
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
        shape = surface.table(channels)
        means, weights = self.means, surface.weights
        with np.errstate(over="ignore", invalid="ignore"):
            cost = self._cost(means, fidelity)
        top = float(np.abs(cost).max())
        check_range(top, "fidelity times the squared contrast")
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
            self.system = System(surface, ratio * weights)
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
                factor *= balance(missed + ratio * off, moved + ratio * shifted)
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
        if weighted_sum(cost[:, other], both) < weighted_sum(cost[:, one], both):
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
            lines, length = lines_of(surface, found[:, 0], 0.5)
        else:
            lines, length = [], 0.0
            for region in range(self.regions):
                others = np.delete(found, region, axis=1).max(1)
                some, long = lines_of(surface, found[:, region] - others, 0.0)
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


def _spread(values: npt.NDArray[Any], where: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    out = np.zeros(len(where), np.intp)
    out[where] = values
    return out


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

    is minimized by the alternating direction method of multipliers (section 8.1, steps (1)-(7), with a second splitting for the
    bounds). Each sweep has a linear solve (with one matrix throughout), a shrinkage on each triangle and a clipping at each vertex.
    The means are updated as area-weighted averages. For the means that are returned the problem is convex, and ``dual`` bounds it
    from below.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        With or without boundary, in any number of pieces.
    image : array_like (n,) or (n, channels)
        Values at the vertices, e.g. a curvature or colours.
    fidelity : float
        Weight of the image relative to the length of the boundary, in units of 1 / (units of the image)²: details smaller than about
        ``sqrt(area) / (fidelity * contrast²)`` are smoothed away. Start with ``30 / contrast²`` and see :func:`segment_path`.
    regions : int
        The number K of regions. More than two share memberships on the simplex: ``1/2 Σ_l ∫ |grad φ_l| + fidelity Σ_l ∫ φ_l |I - c_l|²``.
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
        Iterations after which the best answer so far is returned, with ``converged=False``.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

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
    """Segment an image with several fidelities, to choose one: all share a linear system, and each starts from the one before.

    Parameters
    ----------
    fidelities : sequence of float
        In any order; ascending or descending is fastest.
    shape, image, regions, means, mask, tv, tolerance, max_iterations, progress
        As for :func:`segment`.

    Returns
    -------
    list of SegmentationResult
        One per fidelity, in the order given.

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
