"""The potential as known from samples: their density, and weights that bring samples of several temperatures to one temperature."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
import scipy

from .. import arrays
from ..arrays import Floats
from ..clouds import CloudOperators
from ..errors import InputError, NumericalError
from ..near import nearest_neighbors
from ..operators import Operators, operators
from ..shapes import Shape
from . import weighted

Sampling = Literal["any", "gibbs", "weighted", "mixed"]


def sample_density(shape: Shape | Operators, *, weights: Any = None, neighbors: int | None = None) -> Floats:
    """Estimate the density of the samples of a cloud: samples, or their weights, per unit of area, with integral 1.

    The logarithm of the points' areas in the local mesh, whose scatter does not depend on the density, is fitted by a cubic around
    each point: in valleys narrower than the neighbourhood nothing is smeared out, and points at the boundary, whose areas are cut off, do
    not count.

    Parameters
    ----------
    shape : PointCloud or Operators
    weights : array_like (n,), optional
        Weights of the samples, at least 0; by default those of the cloud, or 1 for each.
    neighbors : int, optional
        How many neighbours a fit uses; by default 40, 128 and 250 in one, two and three dimensions.

    Returns
    -------
    ndarray (n,)
        In units of 1 / length^d; ``ops.mass @ density`` is 1.

    Raises
    ------
    InputError
        The shape is no cloud, or the weights are negative somewhere or 0 everywhere.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> cloud = bt.PointCloud(np.random.default_rng(0).random((4000, 2)))
    >>> bool(abs(np.median(bt.sample_density(cloud)) - 1) < 0.1)
    True
    """
    ops = operators(shape)
    if not isinstance(ops, CloudOperators):
        raise InputError("densities of samples are there for clouds")
    points, mass = ops.shape.points, ops.mass
    count = {1: 40, 2: 128, 3: 250}[ops.shape.dimension] if neighbors is None else arrays.whole(neighbors, "neighbors", 2)
    smooth = weighted.smoothed(ops, np.log(mass), (~ops.boundary).astype(float), count)
    if not np.abs(smooth).max() < 690:  # exp(700) is the end of float64
        power = np.abs(smooth).max() / np.log(10)
        raise NumericalError(f"a point stands for a volume of about 1e{power:.0f} or its inverse; rescale the cloud")
    found = np.exp(-smooth)
    given = weights if weights is not None else ops.shape.weights
    if given is not None:
        weight = arrays.floats(given, "weights", (len(points),))
        if (weight < 0).any() or not weight.sum() > 0:
            raise InputError("weights are negative somewhere or 0 everywhere; importance weights are at least 0")
        known = weight > 0
        weight = weight / weight.max()
        trend = np.exp(np.clip(weighted.smoothed(ops, np.log(np.where(known, weight, 1.0)), known.astype(float), count), -600, 600))
        # the weights scatter about the trend of their logarithm: their mean over it, nearby
        indices, distances = nearest_neighbors(points, points, min(count, len(points)))
        kernel = np.maximum(1 - np.square(distances / np.maximum(distances[:, -1:], 1e-300)), 1e-12)
        found = found * trend * (kernel * (weight / trend)[indices]).sum(1) / kernel.sum(1)
    return np.asarray(found / (found * mass).sum(), float)


def reweight(energies: Any, sample_betas: Any, beta: float, *, tolerance: float = 1e-10) -> Floats:
    """Compute weights that turn samples taken at several temperatures into a sample at one temperature (multistate reweighting).

    Parameters
    ----------
    energies : array_like (n,)
        Potential energy of each sample: of the whole system, not a free energy.
    sample_betas : array_like (n,)
        Inverse temperature at which each was taken.
    beta : float
        Inverse temperature of the reweighted sample.
    tolerance : float
        Tolerance for the free energies, in units of kT.

    Returns
    -------
    ndarray (n,)
        They sum to 1.

    Raises
    ------
    InputError
        Arrays differ in length or are not finite, an inverse temperature is not positive, or there are more than 1,000 of them.

    References
    ----------
    Shirts and Chodera, Statistically optimal analysis of samples from multiple equilibrium states, 2008, equation (11).

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.reweight([0.0, 1.0], [1.0, 1.0], 1.0).tolist()
    [0.5, 0.5]
    """
    energy = arrays.floats(energies, "energies", (None,))
    betas = arrays.floats(sample_betas, "sample_betas", (len(energy),))
    wanted = arrays.number(beta, "beta", above=0.0)
    if len(energy) == 0 or (betas <= 0).any():
        raise InputError("sample_betas must be positive, one per sample")
    states, counts = np.unique(betas, return_counts=True)
    if len(states) > 1000:
        raise InputError(f"{len(states)} different temperatures; up to 1000 can be reweighted")
    shifted = energy - energy.min()
    bias = -states[:, None] * shifted[None]
    free = np.zeros(len(states))
    tolerance = arrays.number(tolerance, "tolerance", above=0)
    for _ in range(10_000):
        mixture = scipy.special.logsumexp(np.log(counts)[:, None] + free[:, None] + bias, axis=0)
        new = -scipy.special.logsumexp(bias - mixture, axis=1)
        new -= new[0]
        done = np.abs(new - free).max() <= tolerance
        free = new
        if done:
            break
    mixture = scipy.special.logsumexp(np.log(counts)[:, None] + free[:, None] + bias, axis=0)
    logarithm = -wanted * shifted - mixture
    weight = np.exp(logarithm - logarithm.max())
    found: Floats = weight / weight.sum()
    return found


def sampled(ops: Operators, potential: Any, sampling: str | None, weights: Any, sample_beta: Any, beta: float) -> tuple[Floats | None, str]:
    """Potential at the points where it is to come from the samples, and what was assumed."""
    if sampling is None:
        if potential is None:
            raise InputError(
                "potential is None; say what the samples are: sampling='gibbs' (of a known temperature), 'weighted' (with importance "
                "weights) or 'mixed' (of several temperatures, with their energies)"
            )
        sampling = "any"
    arrays.word(sampling, "sampling", get_args(Sampling))
    if sampling == "any":
        if weights is not None or sample_beta is not None:
            raise InputError("weights and sample_beta say how points were sampled; sampling='any' asks for neither")
        if potential is None:
            raise InputError("sampling='any' needs the potential")
        return None, "potential given; the points may be samples of any density, areas come from the local mesh"
    if not isinstance(ops, CloudOperators):
        raise InputError(f"sampling={sampling!r} takes the potential from the density of samples; a mesh has none")
    count = len(ops.coordinates)
    if sampling == "gibbs":
        if potential is not None or weights is not None:
            raise InputError("sampling='gibbs' takes the potential from the samples' density; leave out potential and weights")
        taken = beta if sample_beta is None else arrays.number(sample_beta, "sample_beta", above=0.0)
        return -np.log(sample_density(ops)) / taken, f"the density of the samples is assumed to be exp(-{taken:g} U)"
    if sampling == "weighted":
        if potential is not None or sample_beta is not None:
            raise InputError(
                "sampling='weighted' takes the potential from the weighted samples' density; leave potential and sample_beta out"
            )
        given = weights if weights is not None else ops.shape.weights
        if given is None:
            raise InputError("sampling='weighted' needs weights= (or a cloud with weights)")
        text = "the density of the weighted samples is assumed to be exp(-beta U)"
    else:
        if potential is None or callable(potential) or sample_beta is None:
            raise InputError("sampling='mixed' needs the energy of each sample as potential, and its inverse temperature as sample_beta")
        energies = arrays.floats(potential, "potential", (count,))
        given = reweight(energies, arrays.floats(sample_beta, "sample_beta", (count,)), beta)
        text = "the samples are reweighted from their temperatures to beta; their density is then taken for exp(-beta U)"
    found = sample_density(ops, weights=given)
    empty = np.flatnonzero(~(found > 0))
    if len(empty):
        raise InputError(f"the weighted density vanishes at {len(empty)} points ({arrays.some(empty)}); leave samples of no weight out")
    return -np.log(found) / beta, text
