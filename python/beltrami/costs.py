"""Costs of mean-field games (8.18), of moving, of location and of congestion. ``bt.costs.kinetic``, ``bt.costs.quadratic``, ..."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import arrays
from .arrays import Floats
from .errors import InputError

__all__ = [
    "Cost",
    "Lagrangian",
    "congestion",
    "custom",
    "density_cap",
    "entropy",
    "kinetic",
    "kullback_leibler",
    "potential",
    "power",
    "quadratic",
]

LEAST, MOST, STEPS = -690.0, 340.0, 100  # logarithms of the smallest and largest density looked at; steps to its last bit at most


def _line(cost: Any) -> str:
    """A cost in a line: its numbers, and how many of those it has one a place of."""
    told = []
    for entry in fields(cost) if is_dataclass(cost) else ():
        value = getattr(cost, entry.name)
        shown = f"{len(value)} numbers" if np.ndim(value) else f"{value:g}" if isinstance(value, float) else str(value)
        told.append(f"{entry.name} = {shown}")
    return f"{type(cost).__name__.lstrip('_')}({', '.join(told)})"


@dataclass(frozen=True, eq=False, repr=False)
class Lagrangian:
    """``weight |p|^exponent / exponent``: what moving at velocity p costs a unit of mass and time; see :func:`kinetic`, :func:`power`.

    Attributes
    ----------
    exponent : float
        q, above 1 and up to 2.
    weight : float or ndarray (m,)
        A positive number, or one per triangle: large where it is slow to go.
    """

    exponent: float = 2.0
    weight: float | Floats = 1.0

    def __repr__(self) -> str:
        return _line(self)

    def weights(self, count: int) -> Floats:
        """(m,)."""
        if isinstance(self.weight, float):
            return np.full(count, self.weight)
        if len(self.weight) != count:
            raise InputError(f"weight has {len(self.weight)} numbers, the shape has {count} triangles; give one per triangle")
        return self.weight


def _positive(weight: Any, name: str = "weight") -> float | Floats:
    array = np.asarray(weight)
    if array.ndim == 0:
        return arrays.number(weight, name, above=0)
    values = arrays.floats(weight, name, (None,))
    if len(values) and values.min() <= 0:
        where = int(np.argmin(values))
        raise InputError(f"{name}[{where}] is {values[where]:g}; weights must be positive")
    return arrays.frozen(values, weight)


def kinetic(weight: npt.ArrayLike = 1.0) -> Lagrangian:
    """``weight |p|² / 2``: the optimal transport of Benamou and Brenier.

    Parameters
    ----------
    weight : float or array_like (m,)
        One value per triangle makes obstacles: a value of 100 is a wall.

    Returns
    -------
    Lagrangian

    Raises
    ------
    InputError
        A weight is not positive.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.costs.kinetic(2.0).exponent
    2.0
    """
    return Lagrangian(2.0, _positive(weight))


def power(exponent: float, weight: npt.ArrayLike = 1.0) -> Lagrangian:
    """``weight |p|^q / q`` with 1 < q <= 2.

    Parameters
    ----------
    exponent : float
        q. Closer to 1, high speed costs less, so that mass moves in turn instead of all at once.
    weight : float or array_like (m,)

    Returns
    -------
    Lagrangian

    Raises
    ------
    InputError
        The exponent or a weight is out of range.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.costs.power(1.5).exponent
    1.5
    """
    q = arrays.number(exponent, "exponent", above=1)
    if q < 1.05 or q > 2:
        raise InputError(f"exponent is {q:g}; it must be from 1.05 to 2")
    return Lagrangian(q, _positive(weight))


class Cost(ABC):
    """A convex cost of densities, vertex by vertex: ``∫ F(x, ρ(x)) dx`` with ρ from 0 to ``upper``.

    Subclasses give ``value`` and ``derivative`` (nondecreasing in the density); ``prox``, ``maximizer`` and ``conjugate`` follow from
    them, and may be replaced by closed forms. Densities are (..., n). Costs can be added, and multiplied by positive numbers.

    Attributes
    ----------
    upper : ndarray (n,), float or None
        Largest density allowed.
    superlinear : bool
        Whether F grows faster than any line, so that its conjugate is finite.
    """

    upper: Any = None
    superlinear: bool = True

    def __repr__(self) -> str:
        return _line(self)

    @abstractmethod
    def value(self, density: Floats) -> Floats:
        """F(ρ), per unit area."""

    @abstractmethod
    def derivative(self, density: Floats) -> Floats:
        """F'(ρ); at ρ = 0 it may be very negative but must be finite."""

    def prox(self, density: Floats, step: float) -> Floats:
        """The p from 0 to ``upper`` with the least ``step F(p) + (p - density)² / 2``."""
        return self._limited(_root(lambda p: p + step * self.derivative(p) - density, np.abs(density)))

    def maximizer(self, slope: Floats) -> Floats:
        """The p from 0 to ``upper`` with the largest ``slope p - F(p)``."""
        return self._limited(_root(lambda p: self.derivative(p) - slope, np.ones_like(slope)))

    def conjugate(self, slope: Floats) -> Floats:
        """``F*(slope)``, the largest value of ``slope p - F(p)``."""
        p = self.maximizer(slope)
        with np.errstate(over="ignore", invalid="ignore"):
            return slope * p - self.value(p)

    def _limited(self, p: Floats) -> Floats:
        p = np.maximum(p, 0.0)
        return p if self.upper is None else np.minimum(p, self.upper)

    def check(self, count: int) -> None:
        """An :class:`InputError` unless the cost is for a shape with ``count`` vertices."""
        if self.upper is not None and np.ndim(self.upper) and len(self.upper) != count:
            raise InputError(f"a limit of the density has {len(self.upper)} numbers, the shape has {count} vertices")

    def __add__(self, other: object) -> Cost:
        if not isinstance(other, Cost):
            return NotImplemented
        return _Sum(self, other)

    def __mul__(self, factor: float) -> Cost:
        return _Scaled(self, arrays.number(factor, "the factor of a cost", above=0))

    __rmul__ = __mul__


def _root(f: Callable[[Floats], Floats], start: Floats) -> Floats:
    """The root over p >= 0 of an increasing function, element by element: 0 where there is none, very large where it is not reached.

    In log p: a bracket that doubles its width, then Chandrupatla's mixture of bisection and inverse quadratic interpolation (1997)."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        middle = np.log(np.clip(start, 1e-100, 1e100))
        low, high, width = middle - 1, middle + 1, 1.0
        f_low, f_high = f(np.exp(low)), f(np.exp(high))
        for _ in range(11):
            above, below = (f_low > 0) & (low > LEAST), (f_high < 0) & (high < MOST)
            if not (above.any() or below.any()):
                break
            width *= 2
            low, high = np.where(above, np.maximum(low - width, LEAST), low), np.where(below, np.minimum(high + width, MOST), high)
            f_low, f_high = f(np.exp(low)), f(np.exp(high))
        none, never = f_low > 0, f_high < 0
        x1, f1, x2, f2, t = high, f_high, low, f_low, np.full_like(middle, 0.5)
        for _ in range(STEPS):
            x = x1 + t * (x2 - x1)
            fx = f(np.exp(x))
            same = np.sign(fx) == np.sign(f1)
            x3, f3 = np.where(same, x1, x2), np.where(same, f1, f2)
            x2, f2 = np.where(same, x2, x1), np.where(same, f2, f1)
            x1, f1 = x, fx
            best = np.where(np.abs(f2) < np.abs(f1), x2, x1)
            small = (4e-16 * np.abs(best) + 1e-16) / np.abs(x2 - x1)
            if ((small > 0.5) | (f1 == 0) | none | never).all():
                break
            xi, phi = (x1 - x2) / (x3 - x2), (f1 - f2) / (f3 - f2)
            quadratic = (phi**2 < xi) & ((1 - phi) ** 2 < 1 - xi)
            guess = f1 / (f2 - f1) * f3 / (f2 - f3) + (x3 - x1) / (x2 - x1) * f1 / (f3 - f1) * f2 / (f3 - f2)
            t = np.clip(np.where(quadratic & np.isfinite(guess), guess, 0.5), np.minimum(small, 0.5), 1 - np.minimum(small, 0.5))
        found: Floats = np.where(none | (best <= LEAST + 1), 0.0, np.where(never, np.exp(MOST), np.exp(best)))
    return found


@dataclass(frozen=True, eq=False, repr=False)
class _Sum(Cost):
    first: Cost
    second: Cost

    def __post_init__(self) -> None:
        limits = [cost.upper for cost in (self.first, self.second) if cost.upper is not None]
        object.__setattr__(self, "upper", None if not limits else limits[0] if len(limits) == 1 else np.minimum(*limits))
        object.__setattr__(self, "superlinear", self.first.superlinear or self.second.superlinear)

    def value(self, density: Floats) -> Floats:
        return self.first.value(density) + self.second.value(density)

    def derivative(self, density: Floats) -> Floats:
        return self.first.derivative(density) + self.second.derivative(density)

    def prox(self, density: Floats, step: float) -> Floats:
        for line, other in ((self.first, self.second), (self.second, self.first)):
            if isinstance(line, _Potential):  # a linear term only shifts the other's
                shifted = other.prox(density - step * line.values, step)
                return self._limited(shifted)
            if isinstance(line, _Cap):
                return self._limited(other.prox(density, step))
        return super().prox(density, step)

    def maximizer(self, slope: Floats) -> Floats:
        for line, other in ((self.first, self.second), (self.second, self.first)):
            if isinstance(line, _Potential):
                return self._limited(other.maximizer(slope - line.values))
            if isinstance(line, _Cap):
                return self._limited(other.maximizer(slope))
        return super().maximizer(slope)

    def check(self, count: int) -> None:
        self.first.check(count)
        self.second.check(count)


@dataclass(frozen=True, eq=False, repr=False)
class _Scaled(Cost):
    cost: Cost
    factor: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "upper", self.cost.upper)
        object.__setattr__(self, "superlinear", self.cost.superlinear)

    def value(self, density: Floats) -> Floats:
        return self.factor * self.cost.value(density)

    def derivative(self, density: Floats) -> Floats:
        return self.factor * self.cost.derivative(density)

    def prox(self, density: Floats, step: float) -> Floats:
        return self.cost.prox(density, self.factor * step)

    def maximizer(self, slope: Floats) -> Floats:
        return self.cost.maximizer(slope / self.factor)

    def check(self, count: int) -> None:
        self.cost.check(count)


def _per_vertex(values: Any, name: str, least: float | None = None) -> Floats:
    table = arrays.floats(values, name, (None,))
    if least is not None and len(table) and table.min() < least:
        where = int(np.argmin(table))
        raise InputError(f"{name}[{where}] is {table[where]:g}; it must be at least {least:g}")
    return arrays.frozen(table, values)


def _fits(values: Floats, count: int, name: str) -> None:
    if len(values) != count:
        raise InputError(f"{name} has {len(values)} values, the shape has {count} vertices; give one per vertex")


@dataclass(frozen=True, eq=False, repr=False)
class _Quadratic(Cost):
    target: Floats
    weight: float

    def value(self, density: Floats) -> Floats:
        return 0.5 * self.weight * np.square(density - self.target)

    def derivative(self, density: Floats) -> Floats:
        return self.weight * (density - self.target)

    def prox(self, density: Floats, step: float) -> Floats:
        return np.maximum((density + step * self.weight * self.target) / (1 + step * self.weight), 0.0)

    def maximizer(self, slope: Floats) -> Floats:
        return np.maximum(self.target + slope / self.weight, 0.0)

    def check(self, count: int) -> None:
        _fits(self.target, count, "target")


def quadratic(target: npt.ArrayLike, weight: float = 1.0) -> Cost:
    """``weight / 2 ∫ (ρ - target)²``.

    Parameters
    ----------
    target : array_like (n,)
        Of any sign.
    weight : float
        Positive.

    Returns
    -------
    Cost

    Raises
    ------
    InputError
        A number is not finite or the weight not positive.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> bt.costs.quadratic(np.array([1.0, 2.0]), weight=4.0).value(np.array([1.0, 3.0]))
    array([0., 2.])
    """
    return _Quadratic(_per_vertex(target, "target"), arrays.number(weight, "weight", above=0))


@dataclass(frozen=True, eq=False, repr=False)
class _Entropy(Cost):
    """``weight (ρ log(ρ / target) - ρ + offset)``."""

    target: Floats | float
    weight: float
    offset: Floats | float

    def value(self, density: Floats) -> Floats:
        safe = np.maximum(density, 1e-300)
        return self.weight * (np.where(density > 0, density * np.log(safe / self.target), 0.0) - density + self.offset)

    def derivative(self, density: Floats) -> Floats:
        return self.weight * np.log(np.maximum(density, 1e-300) / self.target)

    def prox(self, density: Floats, step: float) -> Floats:
        from scipy.special import wrightomega  # ω + log ω = z

        scale = step * self.weight
        found: Floats = scale * np.real(wrightomega(density / scale + np.log(self.target / scale)))
        return found

    def maximizer(self, slope: Floats) -> Floats:
        return self.target * np.exp(np.minimum(slope / self.weight, 600.0))

    def conjugate(self, slope: Floats) -> Floats:
        p = self.maximizer(slope)
        return np.where(slope / self.weight > 600.0, np.inf, self.weight * (p - self.offset))

    def check(self, count: int) -> None:
        if isinstance(self.target, np.ndarray):
            _fits(self.target, count, "target")


def kullback_leibler(target: npt.ArrayLike, weight: float = 1.0) -> Cost:
    """``weight ∫ ρ log(ρ / target) - ρ + target``.

    Parameters
    ----------
    target : array_like (n,)
        Positive.
    weight : float
        Positive.

    Returns
    -------
    Cost

    Raises
    ------
    InputError
        The target is not positive somewhere or the weight is not.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> bt.costs.kullback_leibler(np.array([1.0, 2.0])).value(np.array([1.0, 2.0]))
    array([0., 0.])
    """
    values = _per_vertex(target, "target")
    if len(values) and values.min() <= 0:
        where = int(np.argmin(values))
        raise InputError(f"target[{where}] is {values[where]:g}; it must be positive: add a small floor to it")
    return _Entropy(values, arrays.number(weight, "weight", above=0), values)


def entropy(weight: float = 1.0) -> Cost:
    """``weight ∫ ρ log ρ - ρ``: spreads mass out.

    Parameters
    ----------
    weight : float
        Positive.

    Returns
    -------
    Cost

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> float(bt.costs.entropy(2.0).derivative(np.array([1.0]))[0])
    0.0
    """
    return _Entropy(1.0, arrays.number(weight, "weight", above=0), 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class _Congestion(Cost):
    weight: float
    exponent: float

    def value(self, density: Floats) -> Floats:
        return self.weight / self.exponent * np.maximum(density, 0.0) ** self.exponent

    def derivative(self, density: Floats) -> Floats:
        return self.weight * np.maximum(density, 0.0) ** (self.exponent - 1)

    def prox(self, density: Floats, step: float) -> Floats:
        if self.exponent == 2:
            return np.maximum(density, 0.0) / (1 + step * self.weight)
        return super().prox(density, step)

    def maximizer(self, slope: Floats) -> Floats:
        return (np.maximum(slope, 0.0) / self.weight) ** (1 / (self.exponent - 1))


def congestion(weight: float = 1.0, exponent: float = 2.0) -> Cost:
    """``weight / exponent ∫ ρ^exponent``: makes crowds expensive.

    Parameters
    ----------
    weight : float
        Positive.
    exponent : float
        Above 1.

    Returns
    -------
    Cost

    Raises
    ------
    InputError
        A number is out of range.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> bt.costs.congestion(3.0).value(np.array([2.0]))
    array([6.])
    """
    return _Congestion(arrays.number(weight, "weight", above=0), arrays.number(exponent, "exponent", above=1))


@dataclass(frozen=True, eq=False, repr=False)
class _Potential(Cost):
    values: Floats
    superlinear: bool = False

    def value(self, density: Floats) -> Floats:
        return self.values * density

    def derivative(self, density: Floats) -> Floats:
        return np.broadcast_to(self.values, np.shape(density)).copy()

    def prox(self, density: Floats, step: float) -> Floats:
        return np.maximum(density - step * self.values, 0.0)

    def check(self, count: int) -> None:
        _fits(self.values, count, "the potential")


def potential(values: npt.ArrayLike) -> Cost:
    """``∫ V ρ``: makes some places more expensive than others.

    Parameters
    ----------
    values : array_like (n,)
        V, of any sign.

    Returns
    -------
    Cost

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> bt.costs.potential([1.0, -2.0]).value(np.array([3.0, 3.0]))
    array([ 3., -6.])
    """
    return _Potential(_per_vertex(values, "the potential"))


@dataclass(frozen=True, eq=False, repr=False)
class _Cap(Cost):
    upper: Any

    def value(self, density: Floats) -> Floats:
        return np.zeros_like(density)

    def derivative(self, density: Floats) -> Floats:
        return np.zeros_like(density)

    def prox(self, density: Floats, step: float) -> Floats:
        return self._limited(density)

    def maximizer(self, slope: Floats) -> Floats:
        return np.where(slope > 0, self.upper, 0.0)


def density_cap(limit: npt.ArrayLike) -> Cost:
    """ρ may not exceed a limit.

    Parameters
    ----------
    limit : float or array_like (n,)
        Not negative; as an array, 0 where no mass may be.

    Returns
    -------
    Cost

    Raises
    ------
    InputError
        A limit is negative, or the number not positive.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> bt.costs.density_cap(2.0).prox(np.array([-1.0, 1.0, 5.0]), 1.0)
    array([0., 1., 2.])
    """
    if np.ndim(limit) == 0:
        return _Cap(arrays.number(limit, "limit", above=0))
    return _Cap(_per_vertex(limit, "limit", 0.0))


@dataclass(frozen=True, eq=False, repr=False)
class _Custom(Cost):
    value_of: Callable[[Floats], Any]
    derivative_of: Callable[[Floats], Any]
    prox_of: Callable[[Floats, float], Any] | None

    def value(self, density: Floats) -> Floats:
        return _answer(self.value_of(density), density, "value")

    def derivative(self, density: Floats) -> Floats:
        return _answer(self.derivative_of(density), density, "derivative")

    def prox(self, density: Floats, step: float) -> Floats:
        if self.prox_of is None:
            return super().prox(density, step)
        return self._limited(_answer(self.prox_of(density, step), density, "prox"))


def _answer(answer: Any, density: Floats, name: str) -> Floats:
    try:
        return np.broadcast_to(np.asarray(answer, np.float64), density.shape)
    except (TypeError, ValueError):
        raise InputError(f"the {name} of a custom cost came back as {answer!r:.60}; an array of shape {density.shape} is needed") from None


def custom(
    value: Callable[[Floats], Any], derivative: Callable[[Floats], Any], *, prox: Callable[[Floats, float], Any] | None = None
) -> Cost:
    """Any convex function of the density.

    Parameters
    ----------
    value, derivative : callable
        Of an array of densities (..., n), elementwise, not negative; the derivative must not decrease with the density.
    prox : callable, optional
        ``prox(density, step)``: the p that minimizes ``step F(p) + (p - density)² / 2``; by default computed from the derivative.

    Returns
    -------
    Cost

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> cubic = bt.costs.custom(lambda p: p**3 / 3, lambda p: p**2)
    >>> bool(abs(cubic.prox(np.array([2.0]), 1.0)[0] - 1.0) < 1e-12)
    True
    """
    for name, function in (("value", value), ("derivative", derivative)):
        if not callable(function):
            raise InputError(f"{name} is {function!r}; a callable is needed")
    if prox is not None and not callable(prox):
        raise InputError(f"prox is {prox!r}; a callable is needed")
    return _Custom(value, derivative, prox)
