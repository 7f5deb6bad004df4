"""As-rigid-as-possible deformation of the source onto the target: the energy of a candidate, and the polishing of the map."""

from __future__ import annotations

import numpy as np
import scipy

from .. import _core, arrays
from ..arrays import Floats, Ints
from ..solvers import Cholesky
from ..sums import gathered
from .sides import Side, vertex_normals


class Rigid:
    """As-rigid-as-possible deformation of the source (Sorkine and Alexa 2007), rotations smoothed over a ring."""

    def __init__(self, side: Side) -> None:
        coo = scipy.sparse.coo_array(side.stiffness)
        apart = coo.row != coo.col
        n = len(side.mass)
        weights = scipy.sparse.csr_array((np.maximum(-coo.data[apart], 0.0), (coo.row[apart], coo.col[apart])), shape=(n, n))
        self.side = side
        self.core = _core.Rigid(arrays.csr_in(weights, "weights"), side.positions)
        degrees = np.asarray(weights.sum(1)).ravel() + 1e-9 * weights.sum() / n
        self.laplacian = scipy.sparse.csr_array(scipy.sparse.diags_array(degrees) - weights)
        self.factor: Cholesky | None = None

    def pulled(self, strength: Floats) -> Cholesky:
        """The factor of the deformation's matrix with every point pulled by a spring."""
        matrix = scipy.sparse.csr_array(self.laplacian + scipy.sparse.diags_array(strength))
        if self.factor is None:
            self.factor = Cholesky(matrix, coordinates=self.side.positions)
        else:
            self.factor.refactor(matrix)
        return self.factor


def low_passed(matrix: Floats, source: Side, target: Side) -> Floats:
    """The target's coordinates, as far as the functional map carries them to the source."""
    k = len(matrix)
    coefficients = target.functions[:, :k].T @ (target.mass[:, None] * target.positions)
    carried: Floats = source.functions[:, :k] @ (matrix @ coefficients)
    return carried


def _marked(side: Side, positions: Floats, turned: float, curved: float) -> Floats:
    """The side at some positions (of unit area): these, their normals and the curvature, which are weighted, and descriptors."""
    columns = [positions, curved * side.curvature, 0.1 * side.descriptors]
    if side.normals is not None and side.faces is not None:
        columns.append(turned * (side.normals if positions is side.positions else vertex_normals(positions, side.faces)))
    return np.concatenate(columns, 1)


class Fitting:
    """Deforms the source onto the target, its samples drawn to nearest points in position, normal and curvature, round by round."""

    def __init__(self, source: Side, target: Side, rigid: Rigid, pull: float = 300.0) -> None:
        self.source, self.target, self.rigid, self.pull = source, target, rigid, pull
        self.masses = np.zeros(len(source.mass))
        self.masses[source.samples] = source.sample_masses
        self.anchor = 1e-6 / len(source.mass)  # holds what is tied to nothing
        self.factor = rigid.pulled(pull * (self.masses + self.anchor))
        self.rows = _marked(target, target.positions, 0.05, 0.03)

    def run(self, positions: Floats, rounds: int) -> tuple[float, Floats]:
        """The energy at the last look, and where the source is then."""
        samples = self.source.samples
        held = self.pull * self.anchor * positions
        energy = np.inf
        for step in range(rounds + 1):
            moved = _marked(self.source, positions, 0.05, 0.03)[samples]
            image, distance = _core.nearest_neighbors(self.rows, moved, 1)
            right, bent = self.rigid.core.fit(positions, 0.0)
            energy = bent + self.pull * float(self.source.sample_masses @ distance[:, 0] ** 2)
            if step < rounds:
                drawn = held.copy()
                drawn[samples] += self.pull * self.source.sample_masses[:, None] * self.target.positions[image[:, 0]]
                positions = self.factor.solve(right + drawn)
                positions = self.factor.solve(self.rigid.core.fit(positions, 0.0)[0] + drawn)
        return energy, positions


def polish_map(start: Floats, source: Side, target: Side, rigid: Rigid, *, steps: int = 15) -> tuple[Ints, Ints, Floats]:
    """The source deformed onto the target: nearest points in position, normal and curvature, both ways, and a rigid step, in turns.

    Normals and curvature weigh much at first, when positions are still off, and little at the end.
    """
    positions = start

    def nearest(share: float) -> tuple[Ints, Ints]:
        turned, curved = 0.2 + share * (0.03 - 0.2), 0.05 + share * (0.01 - 0.05)
        moved, rows = _marked(source, positions, turned, curved), _marked(target, target.positions, turned, curved)
        return _core.nearest_neighbors(rows, moved, 1)[0][:, 0], _core.nearest_neighbors(moved, rows, 1)[0][:, 0]

    n = len(source.mass)
    own = np.maximum(source.mass, 1e-3 / n)
    for step, pull in enumerate(np.geomspace(100.0, 1000.0, steps)):
        forward, backward = nearest(step / (steps - 1))
        weight = own + gathered(backward, target.mass, n)
        images = own[:, None] * target.positions[forward]
        for axis in range(3):
            images[:, axis] += gathered(backward, target.mass * target.positions[:, axis], n)
        factor = rigid.pulled(pull * weight)
        for _ in range(2):
            right, _energy = rigid.core.fit(positions, 0.8)
            positions = factor.solve(right + pull * images)
    forward, backward = nearest(1.0)
    copies = (source.positions[source.follows] == source.positions).all(1)
    positions = np.where(copies[:, None], positions[source.follows], positions)
    return forward[source.follows], backward[target.follows], positions
