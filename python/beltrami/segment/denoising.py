"""Images on surfaces denoised by total variation (Rudin, Osher and Fatemi), with a certificate."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..arrays import Floats
from ..errors import InputError
from ..operators import Operators
from ..progress import GapWatch, Progress
from ..results import save_result
from ..shapes import Shape
from ..sums import weighted_sum
from ..view import Page, Picture, plot
from .surface import BALANCE, CHECK, RELAXATION, Surface, System, TotalVariation, balance, check_range, image_in, mask_in

PENALTY = 9.0  # of denoising, for an image of standard deviation 1, in units of the spacing


@dataclass(frozen=True, eq=False, repr=False)
class DenoisingResult:
    """A denoised image, and a bound on its distance from the optimum.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
    image : ndarray (n,) or (n, channels)
    primal, dual, gap : float
        Energy of the answer, a lower bound for all images, and ``(primal - dual) / primal``, for a surface of unit area.
    dual_field : ndarray (m, D), (m, channels, D), or (edges,), (edges, channels) for ``tv="edge"``
        Of length at most 1; it proves the bound.
    fidelity : float
        The fidelity that was used.
    iterations : int
        Number of iterations.
    converged : bool
        Whether the tolerance was reached.
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

    Minimizes ``∫ |grad u| + fidelity / 2 ∫ |u - I|²`` over the surface scaled to unit area, where |·| is the Frobenius norm over the
    channels. Edges stay sharp, each component keeps its mean, and ``dual`` proves how close the answer is to the minimum.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
    image : array_like (n,) or (n, channels)
        Values at the vertices, e.g. a curvature or colours.
    fidelity : float
        Weight of the image; larger values stay closer to it. In units of 1 / (units of the image). A round patch of height a and radius
        R (at unit area) survives if ``fidelity > 2 / (a R)``.
    mask : array_like (n,) of bool, optional
        True where the image is known. Elsewhere it may hold NaN and is filled in, within the range of the known values.
    tv : {"isotropic", "edge"}
        As for :func:`segment`; "edge" sums over the edges.
    tolerance : float
        Relative gap to stop at.
    max_iterations : int
        Iterations after which the best answer so far is returned, with ``converged=False``.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    DenoisingResult
        With ``converged=False`` if the gap was not reached.

    Raises
    ------
    InputError
        The image does not fit the shape or is not finite; an option is out of range; a component of the shape has no known value.

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
    surface = Surface(shape, tv)
    known = mask_in(mask, surface.count)
    data = image_in(image, surface.count, known)
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
    centre = weighted_sum(data[known].T, share)
    span = float((high - low).max())
    unit = span * float(np.sqrt(weighted_sum(np.square((data[known] - centre) / span).sum(1), share))) if span > 0 else 0.0
    if unit <= 0:
        empty = np.zeros(surface.table(data.shape[1]))
        filled = np.where(known[:, None], data, low)
        history: dict[str, npt.NDArray[Any]] = {name: np.zeros(0) for name in ("iteration", "primal", "dual", "gap")}
        fields = surface.fields(empty, data.shape[1])
        return DenoisingResult(surface.operators.shape, filled[:, 0] if flat else filled, 0.0, 0.0, 0.0, fields, fidelity, 0, True, history)
    target = (data - centre) / unit * known[:, None]
    least, greatest = (low - centre) / unit, (high - centre) / unit
    weight = fidelity * unit
    check_range(weight, "fidelity times the image's deviation")
    mass = surface.mass[:, None]
    loose = surface.mass == 0  # they keep their values
    pull = weight * surface.mass * known + loose * (weight / surface.count)
    elements, channels = surface.elements, data.shape[1]
    penalty = PENALTY * surface.spacing
    w, p = np.zeros(surface.table(channels)), np.zeros(surface.table(channels))
    u, right, flux = np.zeros_like(target), np.zeros_like(target), np.zeros_like(target)
    system = System(surface, pull / penalty)
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
            change = balance(missed, moved)
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
