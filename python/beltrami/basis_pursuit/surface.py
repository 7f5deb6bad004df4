"""One of two shapes that are matched, at unit area."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from ..arrays import Floats
from ..near import nearest_neighbors
from ..operators import Operators

Indices = npt.NDArray[np.int64]


def nearest_rows(table: Floats, queries: Floats) -> Indices:
    """For each query the row of the table that is nearest."""
    found: Indices = nearest_neighbors(table, queries, 1)[0][:, 0].astype(np.int64)
    return found


@dataclass(frozen=True, eq=False)
class Surface:
    """One of the two shapes, scaled to unit area, with its map to the sphere where it has one."""

    operators: Operators
    points: Floats = field(init=False)
    mass: Floats = field(init=False)
    unit: float = field(init=False)

    def __post_init__(self) -> None:
        area = float(self.operators.mass.sum())
        unit = np.sqrt(area)
        places = self.operators.coordinates
        object.__setattr__(self, "unit", unit)
        object.__setattr__(self, "mass", self.operators.mass / area)
        object.__setattr__(self, "points", (places - places.mean(0)) / unit)

    @property
    def stiffness(self) -> scipy.sparse.csr_array:
        return self.operators.stiffness

    @cached_property
    def graph(self) -> scipy.sparse.csr_array:
        """Lengths of the edges."""
        pattern = self.stiffness.tocoo()
        apart = pattern.row != pattern.col
        i, j = pattern.row[apart], pattern.col[apart]
        lengths = np.sqrt(((self.points[i] - self.points[j]) ** 2).sum(1))
        n = len(self.points)
        return scipy.sparse.csr_array((np.maximum(lengths, 1e-300), (i, j)), shape=(n, n))

    def distances(self, sources: Indices) -> Floats:
        """(sources, n): along the edges."""
        found: Floats = np.atleast_2d(scipy.sparse.csgraph.dijkstra(self.graph, directed=False, indices=np.asarray(sources)))
        return found
