"""The machinery of dynamic transport: a shape in space and time, two iterations, and the bounds on both sides of their answer.

Inside, everything is without units: the shape has unit area, densities are divided by their size where the mass is, lengths by the
distance that mass travels (:class:`Scales`). Densities are (intervals + 1, n), potentials (intervals, n), momenta (intervals, m d) in
a frame of each element."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from .. import _core, arrays
from ..arrays import Floats
from ..costs import Cost, Lagrangian
from ..errors import InputError
from ..operators import Operators, operators
from ..shapes import Shape, TriangleMesh
from ..simplices import hat_gradients, simplices
from ..solvers import PoissonSolver
from ..sums import weighted_sum

NOBODY = 1e-9  # density, where the mass is 1, that stands for none: nothing could be moved through triangles without any
END = 2.0  # times the number of intervals: what a free end weighs in the projection
RATIO = 0.5  # of the dual to the primal step, in the metric of the density
NONNEGATIVE = 0.3  # κ: weight of the vertices' own block, which keeps the density from being negative and holds the costs
RELAXATION = 1.8
MEMORY = 2e9  # bytes of factors, by default
REPAIRS = [(0, 1.0, False), (3, 1.0, False), (8, 0.5, False), (2, 1.0, True)]  # passes, share, dilated


class Surface:
    """Elements of a shape of unit area."""

    def __init__(self, shape: Shape | Operators) -> None:
        self.operators = ops = _operators(shape)
        corners, sides, areas = simplices(ops)
        dimension = corners.shape[1] - 1
        if dimension not in (1, 2, 3) or len(corners) == 0:
            raise InputError("transport needs elements to move over: a mesh with triangles, or a cloud with laplacian='local_mesh'")
        self.total = float(ops.mass.sum())
        self.length = self.total ** (1 / dimension)
        self.count, self.dimension = len(ops.mass), dimension
        self.mass = ops.mass / self.total
        self.corners, self.areas = corners, areas / self.total
        self.hats, self.frames = hat_gradients(sides / self.length)
        self._domains: dict[float, _core.TransportDomain] = {}
        self.labels = self.domain(1.0).labels().astype(np.int64)
        self.components = int(self.labels.max()) + 1

    def domain(self, unit: float) -> _core.TransportDomain:
        """The core's elements, with lengths in ``unit`` times the root of the area."""
        if unit not in self._domains:
            elements = _core.Elements(self.count, self.corners, self.hats * unit, np.ascontiguousarray(self.areas))
            kept = self._domains.get(1.0)
            self._domains = {} if kept is None else {1.0: kept}
            self._domains[unit] = _core.TransportDomain(elements, self.mass, self.operators.coordinates)
        return self._domains[unit]

    @cached_property
    def poisson(self) -> PoissonSolver:
        return PoissonSolver(self.operators)

    @cached_property
    def average(self) -> scipy.sparse.csr_array:
        """Mean over a vertex and its neighbours."""
        pattern = scipy.sparse.csr_array(abs(self.operators.stiffness) + scipy.sparse.diags_array(np.ones(self.count)))
        pattern.data[:] = np.repeat(1 / np.diff(pattern.indptr), np.diff(pattern.indptr))
        return pattern

    def largest(self, values: Floats) -> Floats:
        """The largest value on a vertex and its neighbours, of each slice (k, n)."""
        pattern = self.average
        found: Floats = np.maximum.reduceat(values[:, pattern.indices], pattern.indptr[:-1], axis=1)
        return found

    def sums(self, integrals: Floats) -> Floats:
        """(k, n) -> (k, components)."""
        if self.components == 1:
            total: Floats = integrals.sum(axis=1, keepdims=True)
            return total
        return np.stack([np.bincount(self.labels, row, self.components) for row in integrals]).astype(np.float64)

    def with_mass(self, density: Floats, masses: Floats) -> Floats:
        """Each slice scaled so that every component has its mass."""
        now = self.sums(density * self.mass)
        factors = np.divide(masses, now, out=np.zeros_like(now), where=now > 0)
        return density * factors[:, self.labels]


def _operators(shape: Shape | Operators) -> Operators:
    """On a mesh its own triangles, whatever their angles, so that momenta live on them."""
    if isinstance(shape, TriangleMesh):
        try:
            return operators(shape, laplacian="cotangent")
        except InputError:
            return operators(shape)
    return operators(shape)


@dataclass(frozen=True, eq=False)
class Problem:
    """A density that moves, as the user gave it."""

    surface: Surface
    start: Floats
    end: Floats | None
    intervals: int
    lagrangian: Lagrangian = field(default_factory=Lagrangian)
    running: Cost | None = None
    terminal: Cost | None = None
    memory: float = MEMORY
    scale: float | None = None  # density where the mass is, if several problems shall share it

    def __post_init__(self) -> None:
        elements = len(self.surface.areas)
        each = 40.0 * elements * self.surface.dimension  # numbers per interval at the least, as measured
        most = int(arrays.memory() / (8 * each))
        remedy = f"take {most} intervals or fewer, or a coarser mesh" if most else "take a coarser mesh"
        arrays.room(each * self.intervals, f"intervals = {self.intervals} over {elements} elements", remedy)

    @cached_property
    def masses(self) -> Floats:
        """Of each component, on a shape of unit area: (1, components)."""
        return self.surface.sums((self.start * self.surface.mass)[None])

    @property
    def mass(self) -> float:
        return float(self.masses.sum())

    @property
    def concentration(self) -> float:
        """Density where the mass is."""
        if self.scale is not None:
            return self.scale
        ends = [self.start] if self.end is None else [self.start, self.end]
        return float(np.mean([weighted_sum(np.square(end / self.mass), self.surface.mass) for end in ends])) * self.mass


class _InUnits(Cost):
    """A cost of densities in units of ``density``, divided by the unit of a cost."""

    def __init__(self, cost: Cost, density: float, value: float) -> None:
        self.cost, self.density, self.unit = cost, density, value
        self.upper = None if cost.upper is None else np.maximum(np.asarray(cost.upper) / density, NOBODY)
        self.superlinear = cost.superlinear

    def value(self, density: Floats) -> Floats:
        return self.cost.value(density * self.density) / (self.density * self.unit)

    def derivative(self, density: Floats) -> Floats:
        return self.cost.derivative(density * self.density) / self.unit

    def prox(self, density: Floats, step: float) -> Floats:
        return self._limited(self.cost.prox(density * self.density, step * self.density / self.unit) / self.density)

    def maximizer(self, slope: Floats) -> Floats:
        return self._limited(self.cost.maximizer(slope * self.unit) / self.density)

    def conjugate(self, slope: Floats) -> Floats:
        return self.cost.conjugate(slope * self.unit) / (self.density * self.unit)


@dataclass(frozen=True)
class Scales:
    """Units of the problem without units: ``length`` in roots of the area, and the ``weight`` of moving, where the mass moves."""

    length: float
    weight: float


class Model:
    """The problem without units."""

    def __init__(self, problem: Problem, intervals: int, scales: Scales, end_weight: float | None = None) -> None:
        surface = self.surface = problem.surface
        unit = scales.length
        self.problem, self.n, self.unit = problem, intervals, unit
        self.power = problem.lagrangian.exponent
        self.density = problem.concentration
        self.speed = surface.length * unit  # of the user's units of length, in unit time
        self.cost_unit = self.speed**self.power * scales.weight  # of a unit of mass
        self.value_unit = self.density * surface.total * self.cost_unit
        self.mass = surface.mass
        self.start = problem.start / self.density
        self.end = None if problem.end is None else problem.end / self.density
        self.masses = problem.masses / self.density
        self.weights = np.ascontiguousarray(problem.lagrangian.weights(len(surface.corners)) / scales.weight)
        self.domain = surface.domain(unit)
        scaled = [None if cost is None else _InUnits(cost, self.density, self.cost_unit) for cost in (problem.running, problem.terminal)]
        self.running, terminal = scaled
        self.last: Cost | None = None  # of the last slice, a unit of time long, where it is free
        if self.end is None:
            parts = [0.5 * self.running] if self.running else []
            parts += [float(intervals) * terminal] if terminal else []
            self.last = None if not parts else parts[0] if len(parts) == 1 else parts[0] + parts[1]
        # of the last slice in the projection, where it is free: as if it were a unit of time long
        self.end_weight = END * intervals if end_weight is None else end_weight
        self.last_slice = intervals if self.end is None else intervals - 1  # the last that is free

    @cached_property
    def plain(self) -> Metric:
        """The metric of the chapter's projection, (8.23)."""
        return Metric(self, np.ones(self.elements), np.ones(self.elements))

    def metric(self, density: Floats) -> Metric:
        """That in which the objective bends alike everywhere, for mass that moves like this path.

        The second derivatives of ``w |M|² / (2 ρ)`` are ``w / ρ`` by the momentum and ``w v² / ρ`` by the density. What is constant in
        time keeps the projection separable: the largest density that comes by between the ends, no less than the mean density. Costs of
        being somewhere bend by themselves, so that only the weights count there."""
        size = np.ones(self.elements)
        if self.running is None and self.last is None:
            most = np.maximum(density[1:-1] if len(density) > 2 else density, 0.0).max(axis=0)
            most = self.surface.average @ (self.surface.average @ most)
            size = np.maximum(most[self.surface.corners].max(axis=1), self.problem.mass / self.density)
        return Metric(self, size, size / self.weights)

    # --- spaces -------------------------------------------------------------------------------------------------------------------

    @property
    def elements(self) -> int:
        return len(self.surface.corners)

    def momentum(self) -> Floats:
        return np.zeros((self.n, self.elements * self.surface.dimension))

    def line(self) -> Floats:
        """Densities straight from the start to the end."""
        t = np.linspace(0, 1, self.n + 1)[:, None]
        return self.start + t * ((self.start if self.end is None else self.end) - self.start)

    def gradients(self, potential: Floats) -> Floats:
        out = np.empty((len(potential), self.elements * self.surface.dimension))
        self.domain.gradients(potential, out)
        return out

    def densities(self, density: Floats) -> Floats:
        out = np.empty((len(density) - 1, self.elements))
        self.domain.densities(density, out)
        return out

    def gather(self, scalar: Floats, field: Floats, other: Floats, factors: Floats) -> tuple[Floats, Floats]:
        """What averages over elements give to the vertices, and the flux of ``field - factors other`` into them."""
        mean, flux = np.empty((self.n, self.surface.count)), np.empty((self.n, self.surface.count))
        self.domain.gather(scalar, field, other, factors, mean, flux)
        return mean, flux

    def flux(self, momentum: Floats) -> Floats:
        """(intervals, n): what flows into the vertices."""
        return self.gather(np.zeros((self.n, self.elements)), momentum, momentum, np.zeros(self.elements))[1]

    def squares(self, momentum: Floats) -> Floats:
        """|M|² on each element."""
        squares: Floats = np.square(momentum.reshape(self.n, self.elements, -1)).sum(2)
        return squares

    def at_nodes(self, mean: Floats) -> Floats:
        """What the intervals' nodal integrals give to the slices between them, per unit mass: the adjoint of the average."""
        out = np.zeros((self.n + 1, self.surface.count))
        out[:-1] = 0.5 * mean
        out[1:] += 0.5 * mean
        out[-1] /= self.end_weight
        return np.divide(out, self.mass, out=out, where=self.mass > 0)

    def project(self, density: Floats, momentum_flux: Floats, metric: Metric) -> tuple[Floats, Floats]:
        """Projection on the continuity equation (8.23-8.25) of densities and of momenta with this flux: new densities, and ψ."""
        right = self.n * self.mass * np.diff(density, axis=0) - momentum_flux
        psi = np.empty_like(right)
        metric.projection.solve(right, psi)
        moved = density.copy()
        moved[1:-1] += self.n * metric.nodes * np.diff(psi, axis=0)
        if self.end is None:
            moved[-1] -= self.n / self.end_weight * metric.nodes * psi[-1]
        moved[:, self.mass == 0] = density[:, self.mass == 0]
        return moved, psi

    # --- the objective ------------------------------------------------------------------------------------------------------------

    def kinetic(self, density: Floats, momentum: Floats, weights: Floats | None = None) -> float:
        """Cost of moving; infinite where something moves without mass."""
        weights = self.weights if weights is None else weights
        rho, square = self.densities(density), self.squares(momentum)
        if ((rho <= 0) & (square > 0)).any():
            return np.inf
        q = self.power
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            values = square / rho if q == 2 else square ** (q / 2) * rho ** (1 - q)
        values = np.where(square > 0, values, 0.0)
        return float(weighted_sum(values, self.surface.areas * weights).sum()) / (q * self.n)

    def standing(self, density: Floats) -> float:
        """Running and terminal costs."""
        total = 0.0
        if self.running is not None:
            values = weighted_sum(self.running.value(density), self.mass)
            total += float((values[1:-1].sum() + 0.5 * values[0] + (0.5 * values[-1] if self.end is not None else 0.0)) / self.n)
        if self.last is not None:
            total += float(weighted_sum(self.last.value(density[-1:])[0], self.mass)) / self.n
        return total

    def prox(self, density: Floats, step: Floats) -> Floats:
        """Of the running and terminal costs and of ρ >= 0, on the slices that are free (from the first after the start)."""
        inner = self.n - 1
        out = np.maximum(density, 0.0)
        if self.running is not None and inner:
            out[:inner] = self.running.prox(density[:inner], float(step[0, 0]))
        if self.last is not None:
            out[-1] = self.last.prox(density[-1:], float(step[-1, 0]) / self.end_weight)[0]
        return out

    # --- the bound from below -----------------------------------------------------------------------------------------------------

    def hamiltonian(self, potential: Floats) -> Floats:
        """L*(grad φ), averaged to the vertices."""
        out = np.empty_like(potential)
        self.domain.hamiltonian(potential, self.weights, self.power, out)
        return np.divide(out, self.mass, out=np.zeros_like(out), where=self.mass > 0)

    def slopes(self, density: Floats) -> tuple[Floats, Floats | None]:
        """F' on the inner slices (as a row each, slice k at k), and on the last one if it is free."""
        limit = np.zeros((self.n, self.surface.count))
        if self.running is not None:
            limit[1:] = np.maximum(self.running.derivative(density[1:-1]), -1e100)
        if self.end is not None:
            return limit, None
        last = np.zeros(self.surface.count) if self.last is None else self.last.derivative(density[-1:])[0] / self.n
        return limit, np.maximum(last, -1e100)

    def boundary(self, potential: Floats, h: Floats, last: Floats | None) -> float:
        """What the two ends contribute to the bound; ``last`` has the slopes of the terminal cost."""
        first = potential[0] + h[0] / (2 * self.n)
        value = -float(weighted_sum(self.start * first, self.mass))
        return value + (self.linear_end(potential, h, last) if self.end is None else self.given_end(potential, h))

    def given_end(self, potential: Floats, h: Floats) -> float:
        assert self.end is not None
        return float(weighted_sum(self.end * (potential[-1] - h[-1] / (2 * self.n)), self.mass))

    def linear_end(self, potential: Floats, h: Floats, last: Floats | None) -> float:
        height = potential[-1] - h[-1] / (2 * self.n) + (0.0 if last is None else last)
        least = np.full(self.surface.components, np.inf)
        there = self.mass > 0
        np.minimum.at(least, self.surface.labels[there], height[there])
        return float(weighted_sum(np.where(least < np.inf, least, 0.0), self.masses[0]))  # inf: a part where nothing can be

    def linear_bound(self, potential: Floats, limit: Floats, last: Floats | None) -> tuple[float, Floats]:
        """The least cost for players who pay ``limit`` at each inner slice and ``last`` at the end, from below, and the potential that
        proves it."""
        best, proof = -np.inf, potential
        for phi in self.repaired(potential, limit, last):
            value = self.boundary(phi, self.hamiltonian(phi), last)
            if np.isfinite(value) and value > best and np.abs(phi).max() < 1e100:
                best, proof = value, phi.copy()
        return best, proof

    def repaired(self, potential: Floats, limit: Floats, last: Floats | None) -> Iterator[Floats]:
        """Potentials near this one that satisfy the Hamilton-Jacobi inequality inside."""
        candidates = np.empty((len(REPAIRS) * self.n, self.surface.count))
        for backward in (False, True):
            given = -potential[::-1] if backward else potential
            limits = np.concatenate([limit[:1], limit[:0:-1]]) if backward else limit
            bounded = backward and last is not None
            if bounded:
                assert last is not None
                limits[0] = last
            arguments = (np.ascontiguousarray(given), self.weights, np.ascontiguousarray(limits), bounded, self.power, REPAIRS)
            self.domain.repairs(*arguments, candidates)
            for candidate in candidates.reshape(len(REPAIRS), self.n, -1):
                phi = -candidate[::-1] if backward else candidate
                if np.isfinite(phi).all():  # steep slopes on slivers, squared at each slice, overflow
                    yield np.ascontiguousarray(phi)

    def soft_bound(self, potential: Floats, *, inner: bool) -> float:
        """The bound by the conjugates of superlinear costs. ``inner=False``: the potential satisfies the inequality inside already."""
        h = self.hamiltonian(potential)
        value = -float(weighted_sum(self.start * (potential[0] + h[0] / (2 * self.n)), self.mass))
        if inner and self.running is not None and self.n > 1:
            value -= self._conjugate(self.running, self.n * np.diff(potential, axis=0) + 0.5 * (h[1:] + h[:-1])) / self.n
        if self.end is not None:
            value += self.given_end(potential, h)
        elif self.last is not None and self.last.superlinear:
            value -= self._conjugate(self.last, -self.n * (potential[-1:] - h[-1:] / (2 * self.n))) / self.n
        else:
            value += self.linear_end(potential, h, self.slopes(self.line())[1])
        return value

    def _conjugate(self, cost: Cost, slope: Floats) -> float:
        """Sum over slices of the largest ``∫ slope p - F(p)`` among densities of the right mass."""
        labels, masses = self.surface.labels, self.masses
        low, high = np.full((len(slope), self.surface.components), np.inf), np.full((len(slope), self.surface.components), -np.inf)
        for part in range(self.surface.components):
            there = (labels == part) & (self.mass > 0)
            if there.any():
                low[:, part], high[:, part] = slope[:, there].min(1), slope[:, there].max(1)
        low, high = np.where(np.isfinite(low), low, 0.0), np.where(np.isfinite(high), high, 0.0)
        span = np.maximum(high - low, 1e-3 * (1 + np.abs(high)))

        def missing(shift: Floats) -> Any:
            with np.errstate(over="ignore", invalid="ignore"):
                return self.surface.sums(cost.maximizer(slope - shift[:, labels]) * self.mass) < masses

        for _ in range(60):  # a shift low enough that there is too much mass, one high enough that there is too little
            too_little = missing(low)
            if not too_little.any():
                break
            low = np.where(too_little, low - span, low)
            span = np.where(too_little, 2 * span, span)
        span = np.maximum(high - low, 1e-3 * (1 + np.abs(high)))
        for _ in range(60):
            too_much = ~missing(high)
            if not too_much.any():
                break
            high = np.where(too_much, high + span, high)
            span = np.where(too_much, 2 * span, span)
        for _ in range(60):
            middle = 0.5 * (low + high)
            too_little = missing(middle)
            low, high = np.where(too_little, low, middle), np.where(too_little, middle, high)
        shift = high
        with np.errstate(over="ignore", invalid="ignore"):
            values = weighted_sum(np.where(self.mass > 0, cost.conjugate(slope - shift[:, labels]), 0.0), self.mass)
        total = float(values.sum() + (shift * masses).sum())
        return total if np.isfinite(total) else np.inf

    def tangent(self, density: Floats) -> float:
        """``∫ F'(ρ) ρ`` over the slices that are free."""
        limit, last = self.slopes(density)
        at = float(weighted_sum(limit[1:] * density[1:-1], self.mass).sum()) / self.n
        return at if last is None else at + float(weighted_sum(last * density[-1], self.mass))

    def bound(self, potential: Floats, density: Floats) -> tuple[float, Floats]:
        """A lower bound of the objective, and the potential that proves it: costs are convex, so they lie above their tangents at
        ``density``; or, where they are superlinear, by their conjugates."""
        best, proof = self.linear_bound(potential, *self.slopes(density))
        if self.running is None and self.last is None:
            return best, proof
        best += self.standing(density) - self.tangent(density)
        candidates = []
        if self.running is not None and self.running.superlinear:
            candidates = [(self.soft_bound(phi, inner=True), phi) for phi in (potential, proof)]
        elif self.last is not None and self.last.superlinear:
            forward = itertools.islice(self.repaired(potential, *self.slopes(density)), len(REPAIRS))
            inside = [proof, *(phi.copy() for phi in forward)]
            candidates = [(self.soft_bound(phi, inner=False), phi) for phi in inside if np.abs(phi).max() < 1e100]
        for value, phi in candidates:
            if value + self.start_standing() > best:
                best, proof = value + self.start_standing(), phi
        return best, proof

    def gain(self, density: Floats, momentum: Floats, potentials: list[Floats]) -> float:
        """What players could gain at most, all together, by other paths while the costs stay what they are at ``density``."""
        linear = max(self.linear_bound(np.ascontiguousarray(potential), *self.slopes(density))[0] for potential in potentials)
        return self.kinetic(density, momentum) + self.tangent(density) - linear

    def start_standing(self) -> float:
        """Running costs of the slices that are given."""
        if self.running is None:
            return 0.0
        ends = [self.start] if self.end is None else [self.start, self.end]
        return sum(0.5 * float(weighted_sum(self.running.value(end[None])[0], self.mass)) for end in ends) / self.n

    # --- the bound from above -----------------------------------------------------------------------------------------------------

    def paths(self, density: Floats) -> list[Floats]:
        """Densities without a negative number and of the right mass near one that has the right mass only."""
        free = density[1 : self.last_slice + 1]
        if free.size == 0:
            return [density.copy()]
        negative = np.maximum(-free, 0.0)
        typical = float(self.masses.sum())  # of unit area: the mean density
        t = np.linspace(0, 1, self.n + 1)[1 : self.last_slice + 1, None]
        thin = (4 * t * (1 - t)) ** 2 if self.end is not None else np.ones_like(t)  # at first it has little time to spread
        found = [np.maximum(free - 2 * negative.max(axis=1, keepdims=True), 0.0) + 1e-5 * typical * thin]
        if not negative.any():
            found.append(free.copy())
        else:
            clipped = np.maximum(free, 0.0)
            found.append(clipped + 1e-3 * (self.surface.average @ (self.surface.average @ clipped.T)).T)
            near = self.surface.largest(self.surface.largest(negative))
            beside = near.copy()
            beside[1:] = np.maximum(beside[1:], near[:-1])
            beside[:-1] = np.maximum(beside[:-1], near[1:])
            with np.errstate(invalid="ignore"):
                damped = np.where(clipped > 0, clipped * clipped / np.maximum(clipped + beside, 1e-300), 0.0)
            found.append(damped + 1e-4 * typical)
        out = []
        for slices in found:
            path = density.copy()
            path[0] = self.start
            if self.end is not None:
                path[-1] = self.end
            path[1 : self.last_slice + 1] = self._within(self.surface.with_mass(slices, self.masses))
            out.append(path)
        return out

    def _within(self, slices: Floats) -> Floats:
        """Moved below the largest density allowed, with the same mass."""
        caps = [None if cost is None or cost.upper is None else cost.upper for cost in (self.running, self.last)]
        if caps[0] is None and caps[1] is None:
            return slices
        upper = np.full(slices.shape, np.inf)
        if caps[0] is not None:
            upper[:] = caps[0]
        if self.end is None and caps[1] is not None:
            upper[-1] = np.minimum(upper[-1], caps[1])
        if not (slices > upper).any():
            return slices
        labels = self.surface.labels
        low = np.zeros((len(slices), self.surface.components))
        high = np.full_like(low, 2.0)
        for _ in range(60):
            room = self.surface.sums(np.minimum(slices * high[:, labels], upper) * self.mass) < self.masses
            if not room.any():
                break
            high = np.where(room, 4 * high, high)
        for _ in range(80):
            middle = 0.5 * (low + high)
            room = self.surface.sums(np.minimum(slices * middle[:, labels], upper) * self.mass) < self.masses
            low, high = np.where(room, middle, low), np.where(room, high, middle)
        within: Floats = np.minimum(slices * high[:, labels], upper)
        return within

    def rate(self, density: Floats) -> Floats:
        """The mass that comes to each vertex a unit of time."""
        return self.n * self.mass * np.diff(density, axis=0)

    def corrected(self, density: Floats, momentum: Floats) -> Floats:
        """The momentum nearest to the given one that moves these densities."""
        missing = self.rate(density) - self.flux(momentum)
        size = max(float(np.abs(self.rate(density)).max()), 1e-300)
        if float(np.abs(missing).max()) <= 1e-15 * size:
            return momentum
        u = self.surface.poisson.solve_integrated(np.ascontiguousarray(missing.T)) * (self.surface.total / self.speed**2)
        return momentum + self.gradients(np.ascontiguousarray(u.T))

    def optimal(self, density: Floats, potential: Floats) -> Floats:
        """The cheapest momentum that moves these densities (exactly for the squared speed)."""
        conductivity = self.densities(density)
        if self.power == 2:
            conductivity = conductivity / self.weights
        else:
            r = self.power / (self.power - 1)
            speed = np.sqrt(self.squares(self.gradients(potential)))
            conductivity = conductivity * (speed / self.weights) ** (r - 2) / self.weights
        most = conductivity.max(axis=1, keepdims=True)
        conductivity = np.maximum(conductivity, np.where(most > 0, 1e-9 * most, 1.0))
        out = self.momentum()
        self.domain.optimal_momentum(conductivity, self.rate(density), out)
        return out


class Metric:
    """A metric for densities and momenta, constant in time: what their size is on each element, and how freely momenta move."""

    def __init__(self, model: Model, size: Floats, mobility: Floats) -> None:
        surface = model.surface
        self.size, self.mobility = np.ascontiguousarray(size), np.ascontiguousarray(mobility)
        # harmonic means, so that averages from vertices to elements do not lengthen: mean(1 / size) <= 1 / nodes
        corners, each = surface.corners.ravel(), surface.corners.shape[1]
        area = np.bincount(corners, np.repeat(surface.areas, each), surface.count)
        inverse = np.bincount(corners, np.repeat(surface.areas / self.size, each), surface.count)
        self.nodes = np.divide(area, inverse, out=np.ones_like(area), where=inverse > 0)
        end = model.end_weight if model.end is None else None
        self.projection = _core.SpaceTime(model.domain, model.n, end, self.nodes, self.mobility, model.problem.memory)


@dataclass
class Iterate:
    """Where an iteration stands: densities and momenta that satisfy the continuity equation, and a potential."""

    density: Floats
    momentum: Floats
    potential: Floats


class Splitting:
    """Primal-dual splitting (Chambolle and Pock) with the exact projection on the continuity equation on one side, the exact
    projection of the perspective function on the other, and a block of the vertices for ρ >= 0 and the costs of being somewhere."""

    def __init__(self, model: Model, *, metric: Metric | None = None, start: Splitting | None = None, ratio: float | None = None) -> None:
        self.model, self.metric = model, model.plain if metric is None else metric
        q = model.density / model.problem.mass  # how much denser than the mean the mass is
        stiff = model.running is not None and model.running.superlinear
        kappa = 1.0 if stiff else NONNEGATIVE
        if ratio is None:  # of the dual to the primal step
            even = model.running is None and model.last is None and metric is not None
            ratio = RATIO if even else q if stiff else q * min(0.25, 0.05 * max(1.0, q / 4))
        self.tau, self.sigma = float(np.sqrt(1 / (ratio * (1 + kappa**2)))), float(np.sqrt(ratio / (1 + kappa**2)))
        self.kappa = np.full((model.last_slice, 1), kappa)  # of the slices that are free
        if model.end is None:
            self.kappa[-1] = 1.0  # the average's part of the norm is small there
        if start is None:
            self.density, self.momentum = model.line(), model.momentum()
            self.dual_density = np.zeros((model.n, model.elements))
            self.dual_momentum, self.dual_vertex = model.momentum(), np.zeros_like(self.density)
        else:
            where = (np.arange(model.n) * start.model.n) // model.n
            t = np.linspace(0, start.model.n, model.n + 1)
            before = np.minimum(t.astype(int), start.model.n - 1)
            part = (t - before)[:, None]
            self.density = (1 - part) * start.density[before] + part * start.density[before + 1]
            self.dual_vertex = (1 - part) * start.dual_vertex[before] + part * start.dual_vertex[before + 1]
            self.momentum, self.dual_momentum = start.momentum[where], start.dual_momentum[where]
            self.dual_density = start.dual_density[where]
        self.after, self.psi = self.density, np.zeros((model.n, model.surface.count))

    def advance(self) -> Floats:
        """Half an iteration: the projection. Returns ``2 P' - P`` of the slices that are free."""
        model, metric, tau = self.model, self.metric, self.tau
        mean, flux = model.gather(self.dual_density, self.momentum, self.dual_momentum, tau * metric.mobility)
        pull = model.at_nodes(mean)
        pull[1 : model.last_slice + 1] += self.kappa * self.dual_vertex[1 : model.last_slice + 1]
        pull[0] = 0
        if model.end is not None:
            pull[-1] = 0
        self.after, self.psi = model.project(self.density - tau * metric.nodes * pull, flux, metric)
        return 2 * self.after[1 : model.last_slice + 1] - self.density[1 : model.last_slice + 1]

    def finish(self, vertex: Floats) -> None:
        """The other half: dual steps, ``vertex`` being the new dual of the vertices, and over-relaxation."""
        model = self.model
        steps = (self.tau, self.sigma, RELAXATION, model.power)
        sizes = (model.weights, self.metric.size, self.metric.mobility)
        tables = (self.density, self.after, self.psi, self.momentum, self.dual_density, self.dual_momentum)
        model.domain.step(steps, *sizes, *tables)
        free = slice(1, model.last_slice + 1)
        self.dual_vertex[free] += RELAXATION * (vertex - self.dual_vertex[free])
        self.density = self.density + RELAXATION * (self.after - self.density)

    def iterate(self) -> None:
        ahead = self.advance()
        self.finish(self.vertex_dual(ahead))

    def vertex_dual(self, ahead: Floats) -> Floats:
        model, scale = self.model, self.sigma * self.kappa
        if model.running is None and model.last is None:
            return np.minimum(self.dual_vertex[1 : model.last_slice + 1] + scale / self.metric.nodes * ahead, 0.0)
        v = self.dual_vertex[1 : model.last_slice + 1] + scale * ahead
        return v - scale * model.prox(v / scale, 1 / (scale * self.kappa)) if v.size else v

    def state(self) -> Iterate:
        """The densities as projected, with a momentum that moves them."""
        return Iterate(self.density, self.momentum, self.psi / self.tau)


class Gradient:
    """The chapter's Algorithm 2: a gradient step and the projection on the continuity equation, accelerated (FISTA), with backtracking
    that also lengthens the step and a restart whenever the acceleration points uphill. For densities bounded away from zero: below a
    floor moving costs no more than there, and a spring on each vertex pulls back, without which densities would go below any bound."""

    def __init__(self, model: Model) -> None:
        self.model = model
        ends = [model.start] if model.end is None else [model.start, model.end]
        least = min(float(end[model.mass > 0].min()) for end in ends)
        self.floor = max((0.15 if model.end is not None else 0.1) * least, 1e-3 * model.problem.mass / model.density)
        self.stiffness = 1 / self.floor
        self.density = model.line()
        self.momentum = model.corrected(self.density, model.momentum())
        self.behind = (self.density, self.momentum)
        self.t, self.step, self.psi = 1.0, 0.5, np.zeros((model.n, model.surface.count))

    def value(self, density: Floats, momentum: Floats) -> float:
        model, q = self.model, self.model.power
        rho = np.maximum(model.densities(density), self.floor)
        square = model.squares(momentum)
        moving = float(weighted_sum(square ** (q / 2) * rho ** (1 - q), model.surface.areas * model.weights).sum()) / (q * model.n)
        short = np.maximum(self.floor - density[1:], 0.0)
        moving += 0.5 * self.stiffness * float(weighted_sum(np.square(short), model.mass).sum()) / model.n
        standing = (
            share * float(weighted_sum(self.extended(cost, density[k : k + 1])[0][0], model.mass)) for cost, k, share in self.costs()
        )
        return moving + sum(standing)

    def costs(self) -> list[tuple[Cost, int, float]]:
        """The costs of being somewhere: of which slice, and with which share of time."""
        model = self.model
        found: list[tuple[Cost, int, float]] = []
        if model.running is not None:
            found += [(model.running, k, 1 / model.n) for k in range(1, model.n)]
        if model.last is not None:
            found.append((model.last, model.n, 1 / model.n))
        return found

    def extended(self, cost: Cost, density: Floats) -> tuple[Floats, Floats]:
        """Value and derivative, continued below the floor by a parabola, so that logarithms do not hold the steps down."""
        kept = np.maximum(density, self.floor)
        below = density - kept
        slope = cost.derivative(kept)
        bend = (cost.derivative(1.5 * kept) - slope) / (0.5 * kept)
        return cost.value(kept) + below * (slope + 0.5 * bend * below), slope + bend * below

    def slope(self, density: Floats, momentum: Floats) -> tuple[Floats, Floats]:
        """Gradient of the objective in the inner products of the two spaces."""
        model, q = self.model, self.model.power
        rho = model.densities(density)
        floored = np.maximum(rho, self.floor)
        square = model.squares(momentum)
        with np.errstate(divide="ignore"):
            factor = model.weights * np.where(square > 0, square ** (q / 2 - 1), 0.0) * floored ** (1 - q)
        by_density = np.where(rho > self.floor, model.weights * (1 - q) / q * square ** (q / 2) * floored ** (-q), 0.0)
        by_momentum = momentum * np.repeat(factor, model.surface.dimension, axis=1)
        out = model.at_nodes(model.gather(by_density, momentum, momentum, np.zeros(model.elements))[0])
        short = np.where(model.mass > 0, np.maximum(self.floor - density, 0.0), 0.0)
        short[-1] /= 1.0 if model.end is not None else model.end_weight
        out -= self.stiffness * short
        for cost, k, _ in self.costs():
            out[k] += self.extended(cost, density[k : k + 1])[1][0] / (model.end_weight if k == model.n else 1.0)
        out[0] = 0
        if model.end is not None:
            out[-1] = 0
        return out, by_momentum

    def iterate(self) -> None:
        model = self.model
        t = 0.5 * (1 + np.sqrt(1 + 4 * self.t**2))
        ahead = (self.t - 1) / t
        p = self.density + ahead * (self.density - self.behind[0])
        m = self.momentum + ahead * (self.momentum - self.behind[1])
        here, (slope_p, slope_m) = self.value(p, m), self.slope(p, m)
        self.step *= 1.3
        measure, slices = np.repeat(model.surface.areas, model.surface.dimension), np.ones(model.n + 1)
        slices[-1] = 1.0 if model.end is not None else model.end_weight
        while True:
            eta = self.step
            moved, psi = model.project(p - eta * slope_p, model.flux(m - eta * slope_m), model.plain)
            momentum = m - eta * slope_m + model.gradients(psi)
            dp, dm = moved - p, momentum - m
            linear = float(slices @ weighted_sum(slope_p * dp, model.mass)) + float(weighted_sum(slope_m * dm, measure).sum())
            size = float(slices @ weighted_sum(np.square(dp), model.mass) + weighted_sum(np.square(dm), measure).sum())
            there = self.value(moved, momentum)
            if there <= here + (linear + 0.5 * size / eta) / model.n + 1e-13 * abs(here) or eta < 1e-9:
                break
            self.step *= 0.5
        uphill = float(slices @ weighted_sum((p - moved) * (moved - self.density), model.mass))
        uphill += float(weighted_sum((m - momentum) * (momentum - self.momentum), measure).sum())
        self.behind = (self.density, self.momentum)
        self.density, self.momentum, self.psi, self.t = moved, momentum, psi / eta, t
        if uphill > 0:
            self.behind, self.t = (moved, momentum), 1.0

    def state(self) -> Iterate:
        return Iterate(self.density, self.momentum, self.psi)


def _nothing() -> Floats:
    return np.zeros((0, 0))


@dataclass
class Certificate:
    """The best path so far and the best bound, in units of the model."""

    model: Model
    upper: float = np.inf
    lower: float = -np.inf
    density: Floats = field(default_factory=_nothing)
    momentum: Floats = field(default_factory=_nothing)
    potential: Floats = field(default_factory=_nothing)
    last: Floats = field(default_factory=_nothing)  # potential that was looked at last, as the iteration left it
    history: list[tuple[int, float, float, float]] = field(default_factory=list)

    @property
    def gap(self) -> float:
        """Relative to the objective, or to what moves where that is larger."""
        if not np.isfinite(self.upper) or not np.isfinite(self.lower):
            return np.inf
        size = max(abs(self.upper), abs(self.lower), 1e-14)
        return max(self.upper - self.lower, 0.0) / size

    def offer(self, density: Floats, momentum: Floats) -> None:
        value = self.model.kinetic(density, momentum) + self.model.standing(density)
        if value < self.upper:
            self.upper, self.density, self.momentum = value, density, momentum

    def look(self, state: Iterate, iteration: int, tolerance: float) -> None:
        model = self.model
        found = []
        for path in model.paths(state.density):
            momentum = model.corrected(path, state.momentum)
            found.append((model.kinetic(path, momentum) + model.standing(path), path, momentum))
        found.sort(key=lambda item: item[0])
        if found[0][0] < self.upper or self.density.size == 0:
            self.upper, self.density, self.momentum = found[0]
        lower, proof = model.bound(np.ascontiguousarray(state.potential), self.density)
        if lower > self.lower or self.potential.size == 0:
            self.lower, self.potential = max(lower, self.lower), proof
        if self.gap > tolerance:
            for value, path, _ in found:
                if np.isinf(value) and np.isfinite(self.upper):
                    continue  # something moves where there is nothing
                self.offer(path, model.optimal(path, state.potential))
        self.last = state.potential
        self.history.append((iteration, self.upper, self.lower, self.gap))


def looks(most: int) -> list[int]:
    """After how many iterations the bounds are worked out."""
    at, found = 8.0, []
    while at < most:
        found.append(round(at))
        at = max(at * 1.3, at + 8)
    return [*found, most]


def next_look(history: list[tuple[int, float, float, float]], tolerance: float) -> int:
    """The iteration at which the gap will have come down to the tolerance, if it goes on like a power of the iterations: bounds cost as
    much as ten iterations and more. At least 1.2 and at most twice as many as now."""
    now, gap = history[-1][0], history[-1][3]
    before, wider = history[-2][0], history[-2][3]
    order = np.log(wider / gap) / np.log(now / before) if before > 0 and 0 < gap < wider < np.inf else 1.5
    factor = (gap / tolerance) ** (1 / max(order, 0.5)) if np.isfinite(gap) else 2.0
    return max(int(np.ceil(now * np.clip(factor, 1.2, 2.0))), now + 4)


def travel(problem: Problem, iterations: int = 40) -> tuple[Scales, Floats]:
    """How far mass goes, over which weights, and its path, from a short run with few intervals."""
    weights = problem.lagrangian.weights(len(problem.surface.corners))
    model = Model(problem, min(problem.intervals, 4), Scales(0.5, float(np.median(weights))))
    run = Splitting(model)
    for _ in range(iterations):
        run.iterate()
    found = Certificate(model)
    found.look(run.state(), iterations, 0.0)
    q, mass = model.power, float(model.masses.sum())
    energy = model.kinetic(found.density, found.momentum)
    level = np.ones_like(model.weights)
    plain = model.kinetic(found.density, found.momentum, level)
    if not (np.isfinite(plain) and plain > 0):
        return Scales(1e-3, float(np.median(weights))), run.density
    weight = float(np.clip(energy / plain, model.weights.min(), model.weights.max()))
    if model.running is None and model.last is None:
        plain *= float(np.sqrt(np.clip(found.lower / found.upper, 0.05, 1.0)))  # the run is short: between its two bounds
    length = float(np.clip(0.5 * (q * plain / mass) ** (1 / q), 1e-3, 10.0))
    return Scales(length, weight * float(np.median(weights))), run.density


COARSE = 20  # iterations with few intervals, of each number, before those with all


def coarser(intervals: int) -> list[int]:
    """Numbers of intervals to begin with: halves, down to 3."""
    found: list[int] = []
    while intervals >= 6:
        intervals //= 2
        found.insert(0, intervals)
    return found


def solve(problem: Problem, method: str, tolerance: float, most: int, watch: Callable[[float, float], None]) -> tuple[Certificate, int]:
    """Iterates until the certified gap is below the tolerance, or ``most`` times."""
    scales, path = travel(problem)
    model = Model(problem, problem.intervals, scales, 1.0 if method == "projected_gradient" else None)
    certificate = Certificate(model)
    line = model.line()
    if problem.end is not None:
        line = model.paths(line)[0]
    still = Iterate(line, model.corrected(line, model.momentum()), np.zeros((model.n, model.surface.count)))
    certificate.look(still, 0, np.inf)
    if certificate.gap <= tolerance:
        return certificate, 0
    run: Splitting | Gradient
    if method == "projected_gradient":
        run = Gradient(model)
    else:
        before = None
        for few in coarser(problem.intervals):
            coarse = Model(problem, few, scales)
            before = Splitting(coarse, metric=coarse.metric(path), start=before)
            for _ in range(COARSE):
                before.iterate()
                watch(1.0, 0.0)
            path = before.density
        run = Splitting(model, metric=model.metric(path), start=before)
    stop = min(8, most)
    for iteration in range(1, most + 1):
        run.iterate()
        if iteration == stop:
            certificate.look(run.state(), iteration, tolerance)
            if certificate.gap <= tolerance:
                watch(certificate.gap, iteration / most)
                break
            stop = min(next_look(certificate.history, tolerance), most)
        watch(min(certificate.gap, 1.0), iteration / most)
    return certificate, iteration
