"""Descriptors from the spectrum of a shape, for the shape and for its points: the shape DNA, heat and wave kernel signatures."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from . import arrays
from .arrays import Floats
from .eigen import Eigenpairs, eigenpairs
from .errors import InputError
from .operators import Operators, operators
from .progress import Progress
from .shapes import Shape
from .sums import rows_times

__all__ = ["hks", "shape_dna", "wks"]

ZERO = 1e-9  # lesser eigenvalues, as a share of the greatest one, are 0 but for rounding


def _pairs(shape: Shape | Operators | Eigenpairs, k: int, progress: Progress) -> Eigenpairs:
    """The first k eigenpairs, at most as many as there are."""
    k = arrays.whole(k, "k", 2)
    if isinstance(shape, Eigenpairs):
        return Eigenpairs(shape.values[:k], shape.functions[:, :k], shape.residuals[:k], shape.iterations, shape.shape)
    ops = operators(shape)
    return eigenpairs(ops, min(k, int((ops.mass > 0).sum())), progress=progress)


def _positive(pairs: Eigenpairs) -> tuple[Floats, Floats]:
    """Eigenvalues, those that are 0 but for rounding as 0, and the functions."""
    values = np.where(pairs.values < ZERO * pairs.values[-1], 0.0, pairs.values)
    if not values.any():
        raise InputError("all eigenvalues are 0; ask for more of them, k=")
    return values, pairs.functions


def hks(
    shape: Shape | Operators | Eigenpairs, *, times: int | npt.ArrayLike = 16, k: int = 100, scaled: bool = True, progress: Progress = None
) -> Floats:
    """The heat kernel signature: how much of the heat put at a point is still there after a given time.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud, Operators or Eigenpairs
        Eigenpairs are used as they are (the first k).
    times : int or (T,) array
        Times, in units of length²; or how many, evenly spaced in the logarithm over the range that k eigenpairs resolve,
        ``4 ln 10 / λ_k`` to ``4 ln 10 / λ_1`` (λ_1 the first above 0).
    k : int
        How many eigenpairs; fewer if the shape has no more.
    scaled : bool
        Whether to divide by the mean over the shape at each time, so that all times count equally and units cancel. Otherwise the
        unit is 1 / area.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    (n, T) array

    Raises
    ------
    InputError
        A time is not positive, or the eigenvalues are all 0.

    References
    ----------
    Sun, Ovsjanikov and Guibas, A concise and provably informative multi-scale signature based on heat diffusion, 2009.

    Examples
    --------
    >>> import beltrami as bt
    >>> signature = bt.hks(bt.shapes.sphere(3))     # every point of a sphere is like every other
    >>> signature.shape, bool(abs(signature - 1).max() < 0.05)
    ((642, 16), True)
    """
    pairs = _pairs(shape, k, progress)
    values, functions = _positive(pairs)
    if np.ndim(times) == 0:
        count = arrays.whole(times, "times", 1)
        arrays.room(2.0 * count * (len(functions) + len(values)), f"times = {count}", "ask for fewer, or give those that are wanted")
        first = values[values > 0]
        span = np.geomspace(4 * np.log(10) / first[-1], 4 * np.log(10) / first[0], count)
    else:
        span = arrays.floats(times, "times", (None,))
        if len(span) == 0 or span.min() <= 0:
            raise InputError("times must be positive, at least one")
    decay = np.exp(-np.minimum(np.multiply.outer(values, span), 745.0))
    signature: Floats = rows_times(functions**2, decay)
    if scaled:
        signature /= decay.sum(0) / _area(pairs)
    return signature


def _area(pairs: Eigenpairs) -> float:
    """Of the shape, from the functions of eigenvalue 0: orthonormal, and constant on each component, however these are mixed in them."""
    zero = pairs.values < ZERO * pairs.values[-1]
    zero[0] = True
    rows = pairs.functions[:, zero]
    squares = np.square(rows).sum(1)  # 1 / area of the component
    left, area = squares > 1e-24 * squares.max(), 0.0
    while left.any():
        one = int(np.argmax(left))
        along = np.einsum("nk,k->n", rows, rows[one] / np.sqrt(squares[one]))
        mine = left & (np.square(along) > 0.5 * squares)  # rows of other components are orthogonal
        area += float(1 / np.mean(squares[mine]))
        left &= ~mine
    return area if area > 0 else 1.0


def wks(shape: Shape | Operators | Eigenpairs, *, energies: int = 16, k: int = 100, progress: Progress = None) -> Floats:
    """The wave kernel signature: the probability of finding a quantum particle of a given energy at a point.

    Energies are evenly spaced in log λ; each weights the eigenfunctions by a normalized Gaussian of 7 spacings. It distinguishes
    details that the heat kernel blurs.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud, Operators or Eigenpairs
        Eigenpairs are used as they are (the first k).
    energies : int
        How many, at least 2.
    k : int
        How many eigenpairs; fewer if the shape has no more.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    (n, energies) array
        Multiplied by the area, so without units and 1 on average.

    Raises
    ------
    InputError
        The eigenvalues are all 0.

    References
    ----------
    Aubry, Schlickewei and Cremers, The wave kernel signature: a quantum mechanical approach to shape analysis, 2011.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.wks(bt.shapes.sphere(3), energies=10).shape
    (642, 10)
    """
    count = arrays.whole(energies, "energies", 2)
    pairs = _pairs(shape, k, progress)
    values, functions = _positive(pairs)
    arrays.room(2.0 * count * (len(functions) + len(values)), f"energies = {count}", "ask for fewer")
    above = values > 0
    logs = np.log(values[above])
    width = max((logs[-1] - logs[0]) / count, 1e-12)
    sigma = 7 * width
    low, high = (logs[0] + 2 * sigma, logs[-1] - 2 * sigma) if logs[-1] - logs[0] > 4 * sigma else (logs[0], logs[-1])
    levels = np.linspace(low, high, count)
    weights = np.exp(-((levels[None, :] - logs[:, None]) ** 2) / (2 * sigma**2))
    signature: Floats = rows_times(functions[:, above] ** 2, weights / weights.sum(0)) * _area(pairs)
    return signature


def shape_dna(shape: Shape | Operators | Eigenpairs, *, k: int = 50, normalize: bool = True, progress: Progress = None) -> Floats:
    """The shape DNA: the first k eigenvalues after that of the constant function, which bending does not change.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud, Operators or Eigenpairs
    k : int
        How many.
    normalize : bool
        Whether to multiply by the area (its power 2 / d in dimension d), so that size does not matter.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    (k,) array
        Ascending; in 1 / length² if not normalized. Shorter where the shape has fewer points with mass.

    Raises
    ------
    InputError
        ``k`` is out of range, or ``shape`` is not a shape.
    ConvergenceError
        The eigenpairs did not converge.

    References
    ----------
    Reuter, Wolter and Peinecke, Laplace-Beltrami spectra as "Shape-DNA" of surfaces and solids, 2006.

    Examples
    --------
    >>> import beltrami as bt
    >>> (bt.shape_dna(bt.shapes.sphere(4), k=8) / (4 * 3.14159265)).round(1)     # l (l + 1)
    array([2., 2., 2., 6., 6., 6., 6., 6.])
    """
    pairs = _pairs(shape, arrays.whole(k, "k", 1) + 1, progress)
    values: Floats = np.maximum(pairs.values[1:], 0.0)
    if normalize:
        dimension = 2 if pairs.shape is None else pairs.shape.intrinsic_dimension
        values = values * _area(pairs) ** (2 / dimension)
    return values
