"""Mean-field games over a surface (8.18): crowds with costs of moving, of location and of the final density, with a certificate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..arrays import Floats
from ..costs import Cost, Lagrangian
from ..errors import InputError
from ..operators import Operators
from ..progress import GapWatch, Progress
from ..shapes import Shape
from ..sums import weighted_sum
from . import continuity
from .continuity import Problem, Surface
from .flow import Flow, Method, balanced, density_in, flow_fields, options_in

__all__ = ["MeanFieldGameResult", "mean_field_game"]


@dataclass(frozen=True, eq=False, repr=False)
class MeanFieldGameResult(Flow):
    """An equilibrium of a potential mean-field game, and a bound on the distance of the answer from it.

    It has all attributes of :class:`Flow`, and also:

    Attributes
    ----------
    objective : float
        ``kinetic + running + terminal``.
    kinetic, running, terminal : float
        The costs of moving, the running costs (trapezoid rule in time), and the terminal cost.
    exploitability : float
        The first-order (Nash) residual: an upper bound on what players could gain together by other paths while everybody else keeps
        to this one, relative to the size of the objective. Infinite if no potential bounds it, far from convergence.
    """

    objective: float
    kinetic: float
    running: float
    terminal: float
    exploitability: float

    def __repr__(self) -> str:
        state = "" if self.converged else ", NOT CONVERGED"
        return f"MeanFieldGameResult(objective {self.objective:.6g}, gap {self.gap:.1e} after {self.iterations} iterations{state})"


def _cost(value: object, name: str, count: int, density: Floats) -> Cost | None:
    if value is None:
        return None
    if not isinstance(value, Cost):
        raise InputError(f"{name} is a {type(value).__name__}; make one with bt.costs, e.g. bt.costs.congestion(2.0)")
    value.check(count)
    there = density > 0
    with np.errstate(all="ignore"):
        worth, slope, steeper = (
            np.asarray(x)[there] for x in (value.value(density), value.derivative(density), value.derivative(2 * density))
        )
    for numbers, what in ((worth, "value"), (slope, "derivative")):
        if not np.isfinite(numbers).all():
            raise InputError(f"the {what} of {name} is not finite where the density is that of the start")
    if (steeper < slope - 1e-6 * np.abs(slope)).any():
        raise InputError(f"{name} is not convex: its derivative falls where the density grows from that of the start to twice as much")
    return value


def _within(density: Floats, name: str, limit: object) -> None:
    if limit is None:
        return
    over = density - np.asarray(limit) > 1e-12 * density.max()
    if over.any():
        where = int(np.argmax(density - np.asarray(limit)))
        raise InputError(f"{name}[{where}] is {density[where]:g}, above the cap; raise the cap or spread the mass")


def mean_field_game(
    shape: Shape | Operators,
    density0: npt.ArrayLike,
    density1: npt.ArrayLike | None = None,
    *,
    intervals: int = 32,
    running_cost: Cost | None = None,
    terminal_cost: Cost | None = None,
    lagrangian: Lagrangian | None = None,
    normalize: bool = False,
    method: Method = "primal_dual",
    tolerance: float = 1e-3,
    max_iterations: int = 600,
    memory: float | None = None,
    progress: Progress = None,
) -> MeanFieldGameResult:
    """Solve a potential mean-field game on a surface [1]_: find the path of densities that minimizes

    ``∫ Σ_T A_T P L(x_T, M / P) + ∫ F(P) dt + F_T(P(1))`` with ``∂_t P + div M = 0``

    from ``density0`` to ``density1``, or with a free end and a terminal cost if ``density1`` is None. At the minimum no player gains
    by taking another path, so it is an equilibrium. Costs are convex and created by ``bt.costs``; running costs are integrated in time
    by the trapezoid rule.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
    density0 : array_like (n,)
        Per unit area, not negative.
    density1 : array_like (n,), optional
        Of equal mass on each component.
    intervals : int
        Number of time intervals.
    running_cost, terminal_cost : Cost, optional
        Sums are allowed: ``bt.costs.congestion(1.0) + bt.costs.potential(v)``. A terminal cost needs ``density1=None``.
    lagrangian : Lagrangian, optional
        ``bt.costs.kinetic(weight)`` (the default has weight 1) or ``bt.costs.power(q, weight)``.
    normalize : bool
        Rescale ``density1`` to the mass of ``density0``.
    method : {"primal_dual", "projected_gradient"}
        As for :func:`transport`; the second is for costs with a derivative and densities bounded away from zero.
    tolerance : float
        Relative gap to stop at.
    max_iterations : int
        Iterations after which the best answer so far is returned, with ``converged=False``.
    memory : float, optional
        As for :func:`transport`.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    MeanFieldGameResult
        With ``converged=False`` if the gap was not reached.

    Raises
    ------
    InputError
        As for :func:`transport`; or a cost does not fit the shape, is not finite or not convex, a density is above its cap, or the cap
        leaves no room for the mass.

    References
    ----------
    .. [1] J. Yu, R. Lai, W. Li, S. Osher, Computational mean-field games on manifolds, 2023.
    .. [2] J.-M. Lasry, P.-L. Lions, Mean field games, 2007.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> sphere = bt.shapes.sphere(2)
    >>> z = sphere.vertices[:, 2]
    >>> away = bt.costs.potential(2 * z)  # the north pole is dear at the end
    >>> r = bt.mean_field_game(sphere, np.exp(z), intervals=8, terminal_cost=away, running_cost=bt.costs.congestion(0.1))
    >>> r.converged, bool(r.density[-1][z < 0].mean() > r.density[0][z < 0].mean())
    (True, True)
    """
    surface = Surface(shape)
    wished, most, limit = options_in(method, tolerance, max_iterations, memory)
    start = density_in(surface, density0, "density0")
    end = None
    if density1 is not None:
        given = [start, density_in(surface, density1, "density1")]
        start, end = balanced(surface, given, ("density0", "density1"), normalize)
    running, terminal = (
        _cost(cost, name, surface.count, start) for cost, name in ((running_cost, "running_cost"), (terminal_cost, "terminal_cost"))
    )
    if end is not None and terminal is not None:
        raise InputError("density1 and terminal_cost are both given; the end is either fixed or free, so leave one out")
    if lagrangian is None:
        lagrangian = Lagrangian()
    if not isinstance(lagrangian, Lagrangian):
        raise InputError(f"lagrangian is a {type(lagrangian).__name__}; make one with bt.costs.kinetic or bt.costs.power")
    lagrangian.weights(len(surface.corners))
    for cost in (running, terminal):
        if cost is None or cost.upper is None:
            continue
        room = surface.sums((np.broadcast_to(np.asarray(cost.upper, float), start.shape) * surface.mass)[None])[0]
        needed = surface.sums((start * surface.mass)[None])[0]
        if (room < needed * (1 + 1e-9)).any():
            there, mass = room.sum() * surface.total, needed.sum() * surface.total
            raise InputError(f"the density cap leaves room for a mass of {there:.6g}, there is {mass:.6g}; raise the cap")
    if running is not None:
        _within(start, "density0", running.upper)
        if end is not None:
            _within(end, "density1", running.upper)
    problem = Problem(surface, start, end, arrays.whole(intervals, "intervals", 1), lagrangian, running, terminal, limit)
    certificate, iterations = continuity.solve(problem, method, wished, most, GapWatch(progress, "game", wished))
    fields, value = flow_fields(problem, certificate, iterations, wished)
    model, density = certificate.model, fields["density"]
    values = [] if running is None else list(weighted_sum(running.value(density), surface.mass) * surface.total)
    running_value = float(sum(values[1:-1]) + 0.5 * (values[0] + values[-1])) / model.n if values else 0.0
    terminal_value = 0.0 if terminal is None else float(weighted_sum(terminal.value(density[-1:])[0], surface.mass)) * surface.total
    moving = model.kinetic(density / model.density, certificate.momentum)
    kinetic = value - model.standing(density / model.density) * model.value_unit if running or terminal else value
    objective = kinetic + running_value + terminal_value
    gain = model.gain(density / model.density, certificate.momentum, [certificate.last, certificate.potential])
    size = max(abs(value) / model.value_unit, moving, 1e-14)
    return MeanFieldGameResult(
        **fields,
        objective=objective,
        kinetic=kinetic,
        running=running_value,
        terminal=terminal_value,
        exploitability=max(gain, 0.0) / size,
    )
