"""Shapes: triangle meshes and point clouds, and exact makers of well-known surfaces.

A shape is frozen: its arrays are read-only copies of what was handed in, so that whatever is computed from it once stays true.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _core, arrays
from .arrays import Floats, Ints
from .errors import InputError

Data = Mapping[str, npt.NDArray[Any]]


def _frozen_data(data: Mapping[str, Any] | None, count: int, what: str) -> Data:
    kept = {}
    for name, values in (data or {}).items():
        array = np.asarray(values)
        if array.shape[:1] != (count,):
            raise InputError(f"data[{name!r}] has shape {array.shape}; its first length must be {count}, one row a {what}")
        kept[str(name)] = arrays.frozen(np.ascontiguousarray(array), values)
    return MappingProxyType(kept)


@dataclass(frozen=True, eq=False, repr=False)
class TriangleMesh:
    """A surface made of triangles, with vertices in R^D (D = 2, 3 or more).

    Parameters
    ----------
    vertices : array_like (n, D)
        Positions, in the user's units. Kept in this order; nothing is merged or dropped.
    faces : array_like (m, 3)
        Vertex numbers of each triangle, from 0.
    data : mapping of str to array_like (n, ...), optional
        Values that belong to the vertices (colours, labels, measurements).

    Attributes
    ----------
    vertices : ndarray (n, D) of float64, read-only
    faces : ndarray (m, 3) of int32, read-only
    data : mapping of str to ndarray (n, ...), read-only

    Raises
    ------
    InputError
        A coordinate is not finite, a face refers to a vertex that is not there, or an array has the wrong shape or type.

    Examples
    --------
    >>> import beltrami as bt
    >>> mesh = bt.TriangleMesh([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    >>> mesh.area
    0.5
    """

    vertices: Floats
    faces: Ints
    data: Data = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        vertices = arrays.points(self.vertices, "vertices", least=2)
        faces = arrays.triangles(self.faces, "faces", len(vertices))
        _core.check_mesh((vertices, faces))
        object.__setattr__(self, "vertices", arrays.frozen(vertices, self.vertices))
        object.__setattr__(self, "faces", arrays.frozen(faces, self.faces))
        object.__setattr__(self, "data", _frozen_data(self.data, len(vertices), "vertex"))

    def __repr__(self) -> str:
        return f"TriangleMesh({len(self.vertices)} vertices in R^{self.dimension}, {len(self.faces)} faces)"

    def __reduce__(self) -> tuple[Any, ...]:
        return _remake, (TriangleMesh, (self.vertices, self.faces), {"data": dict(self.data)})

    @property
    def dimension(self) -> int:
        """D, the dimension of the space that the vertices lie in."""
        return int(self.vertices.shape[1])

    @cached_property
    def face_areas(self) -> Floats:
        """Area of each triangle, (m,)."""
        return _core.face_areas((self.vertices, self.faces))

    @property
    def area(self) -> float:
        """Total area."""
        return float(self.face_areas.sum())


@dataclass(frozen=True, eq=False, repr=False)
class PointCloud:
    """Samples of a d-dimensional surface in R^D.

    Parameters
    ----------
    points : array_like (n, D)
        Positions, in the user's units and in the user's order.
    dimension : int
        Intrinsic dimension d of what was sampled: 2 for a surface, 3 for a volume or a 3-manifold.
    normals : array_like (n, D), optional
        Unit normals.
    weights : array_like (n,), optional
        Positive weights of the samples.
    data : mapping of str to array_like (n, ...), optional
        Values that belong to the points.

    Raises
    ------
    InputError
        A number is not finite, a weight is not positive, a length does not fit, or the dimension is not from 1 to D.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.PointCloud([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dimension=2)
    PointCloud(3 points of a 2-dimensional surface in R^3)
    """

    points: Floats
    dimension: int = field(default=2, kw_only=True)
    normals: Floats | None = field(default=None, kw_only=True)
    weights: Floats | None = field(default=None, kw_only=True)
    data: Data = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        points = arrays.points(self.points, "points")
        points = arrays.floats(points, "points", (None, None))
        count, space = points.shape
        dimension = arrays.whole(self.dimension, "dimension", 1, space)
        set_ = object.__setattr__
        set_(self, "points", arrays.frozen(points, self.points))
        set_(self, "dimension", dimension)
        if self.normals is not None:
            set_(self, "normals", arrays.frozen(arrays.floats(self.normals, "normals", (count, space)), self.normals))
        if self.weights is not None:
            weights = arrays.floats(self.weights, "weights", (count,))
            if (weights <= 0).any():
                at = int(np.flatnonzero(weights <= 0)[0])
                raise InputError(f"weights[{at}] is {weights[at]:g}; weights must be positive")
            set_(self, "weights", arrays.frozen(weights, self.weights))
        set_(self, "data", _frozen_data(self.data, count, "point"))

    def __repr__(self) -> str:
        return f"PointCloud({len(self.points)} points of a {self.dimension}-dimensional surface in R^{self.points.shape[1]})"

    def __reduce__(self) -> tuple[Any, ...]:
        more = {"dimension": self.dimension, "normals": self.normals, "weights": self.weights, "data": dict(self.data)}
        return _remake, (PointCloud, (self.points,), more)


Shape = TriangleMesh | PointCloud


def _remake(kind: type[Any], positional: tuple[Any, ...], keywords: dict[str, Any]) -> Any:
    return kind(*positional, **keywords)
