"""Shapes: triangle meshes and point clouds, and functions that make well-known surfaces.

A shape is immutable: its arrays are read-only copies of the inputs, so whatever was computed from it remains valid.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import InitVar, dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _core, arrays
from .arrays import Floats, Ints
from .errors import InputError, NumericalError, TopologyError
from .progress import Progress, reporter

if TYPE_CHECKING:
    from .view import Page, Picture

Data = Mapping[str, npt.NDArray[Any]]


def _frozen_data(data: Mapping[str, Any] | None, count: int, what: str) -> Data:
    kept = {}
    if data is not None and not isinstance(data, Mapping):
        raise InputError(f"data is {data!r}; a dict of arrays is needed, one row a {what}")
    for name, values in (data or {}).items():
        array = arrays.anything(values, f"data[{name!r}]")
        if array.shape[:1] != (count,):
            raise InputError(f"data[{name!r}] has shape {array.shape}; its first length must be {count}, one row a {what}")
        kept[str(name)] = arrays.frozen(np.ascontiguousarray(array), values)
    return MappingProxyType(kept)


class _Shown:
    """What meshes and clouds have in common towards other libraries and pictures."""

    def to_trimesh(self: Any) -> Any:
        """The shape as a ``trimesh.Trimesh`` or ``trimesh.PointCloud``: vertices and faces in order, ``data["colors"]`` as colours; other
        data of a mesh as attributes.

        Raises
        ------
        InputError
            The shape lies in R^D with D > 3.
        """
        from .files import to_trimesh

        return to_trimesh(self)

    def to_pyvista(self: Any) -> Any:
        """The shape as a ``pyvista.PolyData`` with its data; a cloud also with its normals and weights.

        Raises
        ------
        DependencyError
            pyvista is missing.
        InputError
            The shape lies in R^D with D > 3.
        """
        from .files import to_pyvista

        return to_pyvista(self)

    def plot(self, values: Any = None, *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints the shape to a ``.png`` or an interactive ``.html``; the options are those of :func:`beltrami.plot`."""
        from .view import plot

        return plot(self, values, path=path, **options)


@dataclass(frozen=True, eq=False, repr=False)
class TriangleMesh(_Shown):
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

    @classmethod
    def _trusted(cls, vertices: Floats, faces: Ints, data: dict[str, npt.NDArray[Any]]) -> TriangleMesh:
        """A mesh on arrays that are checked, read-only and nobody else's: a reader of files does not copy them again."""
        mesh = object.__new__(cls)
        for name, value in (("vertices", vertices), ("faces", faces), ("data", MappingProxyType(data))):
            object.__setattr__(mesh, name, value)
        return mesh

    def __repr__(self) -> str:
        return f"TriangleMesh({len(self.vertices)} vertices in R^{self.dimension}, {len(self.faces)} faces)"

    def __reduce__(self) -> tuple[Any, ...]:
        return _remake, (TriangleMesh, (self.vertices, self.faces), {"data": dict(self.data)})

    @property
    def dimension(self) -> int:
        """D, the dimension of the space that the vertices lie in."""
        return int(self.vertices.shape[1])

    @property
    def coordinates(self) -> Floats:
        """``vertices``, (n, D): the name under which meshes, clouds and operators all give the positions of their unknowns."""
        return self.vertices

    @property
    def intrinsic_dimension(self) -> int:
        """2: that of the surface, as a cloud's ``dimension``."""
        return 2

    @cached_property
    def face_areas(self) -> Floats:
        """Area of each triangle, (m,); read-only."""
        return arrays.read_only(_core.face_areas((self.vertices, self.faces)))

    @property
    def area(self) -> float:
        """Total area.

        Raises
        ------
        NumericalError
            It is beyond the range of float64.
        """
        with np.errstate(over="ignore"):
            total = float(self.face_areas.sum())
        if not np.isfinite(total):
            raise NumericalError("the area is beyond the range of float64; rescale the vertices")
        return total

    @cached_property
    def _topology(self) -> _Topology:
        found = _core.topology((self.vertices, self.faces))
        edges, labels, counts, loops, manifold, inconsistent, one_sided, genus = found
        for array in (edges, labels, *loops):
            array.flags.writeable = False
        pair = None if inconsistent is None else (inconsistent[0], inconsistent[1])
        return _Topology(edges, labels, *counts, loops, manifold, pair, one_sided, genus)

    @property
    def edges(self) -> Ints:
        """Edges as pairs of vertices, (e, 2), the lesser first, sorted; read-only."""
        return self._topology.edges

    @property
    def components(self) -> int:
        """Number of connected pieces. Triangles that share a vertex are connected; vertices of no triangle do not count."""
        return self._topology.components

    @property
    def component_labels(self) -> Ints:
        """For each vertex the number of its component, from 0 in the order of their first vertices; -1 for vertices of no triangle."""
        return self._topology.labels

    @property
    def euler_characteristic(self) -> int:
        """Vertices - edges + faces. Vertices of no triangle, and faces that name a vertex twice, do not count."""
        return self._topology.euler

    @property
    def boundary_loops(self) -> int:
        """Number of boundary curves."""
        return len(self._topology.loops)

    @property
    def boundary_loop_vertices(self) -> list[Ints]:
        """The vertices of each boundary curve in order, the surface on the left (of consistently oriented faces).

        Closed curves do not repeat their first vertex. Where the mesh is not manifold a curve may end at an edge of more than two faces.
        """
        return list(self._topology.loops)

    @property
    def is_closed(self) -> bool:
        """True if there are triangles and every edge has more than one of them."""
        return self._topology.closed

    @property
    def is_manifold(self) -> bool:
        """True if every edge has one or two triangles, and the triangles at every vertex form one fan."""
        return self._topology.non_manifold is None

    @property
    def is_oriented(self) -> bool:
        """True if the two triangles of every edge run along it in opposite directions. :meth:`oriented` makes it so."""
        return self._topology.inconsistent is None

    @property
    def is_orientable(self) -> bool:
        """False if the surface has one side only, as a Möbius band."""
        return self._topology.one_sided is None

    @property
    def genus(self) -> int:
        """Number of handles, summed over components, boundary curves filled.

        Raises
        ------
        TopologyError
            The mesh is not manifold or has one side only; the message says where.
        """
        found = self._topology
        if found.non_manifold is not None:
            raise TopologyError(f"the mesh is not manifold, so it has no genus: {found.non_manifold}")
        if found.genus is None:
            raise TopologyError(str(found.one_sided))
        return found.genus

    def report(self) -> MeshReport:
        """A summary of the mesh, for people; ``print(mesh.report())`` shows it.

        Examples
        --------
        >>> import beltrami as bt
        >>> print(bt.shapes.torus().report())  # doctest: +ELLIPSIS
        vertices              2400 in R^3
        faces                 4800
        ...
        """
        found = self._topology
        with np.errstate(all="ignore"):
            low, high = (self.vertices.min(0), self.vertices.max(0)) if len(self.vertices) else (np.zeros(self.dimension),) * 2
            steps = self.vertices[found.edges[:, 0]] - self.vertices[found.edges[:, 1]]
            scale = float(np.abs(steps).max(initial=0.0))
            lengths = np.linalg.norm(steps / scale, axis=1) if 0 < scale < np.inf else np.zeros(len(steps))
            areas = self.face_areas
            total = float(areas.sum())
            sizes = (lengths.min(), lengths.mean(), lengths.max()) if len(lengths) else None
            edge_length = None if sizes is None else (float(sizes[0] * scale), float(sizes[1] * scale), float(sizes[2] * scale))
        return MeshReport(
            vertices=len(self.vertices),
            dimension=self.dimension,
            faces=len(self.faces),
            area=total if np.isfinite(total) else None,
            bounds=(tuple(low.tolist()), tuple(high.tolist())),
            edge_length=edge_length,
            components=found.components,
            euler_characteristic=found.euler,
            genus=found.genus,
            boundary_loops=len(found.loops),
            is_closed=found.closed,
            is_manifold=found.non_manifold is None,
            is_oriented=found.inconsistent is None,
            is_orientable=found.one_sided is None,
            unreferenced_vertices=found.unreferenced,
            repeated_corner_faces=found.degenerate,
            zero_area_faces=int((areas == 0).sum()) - found.degenerate,
            reason=found.non_manifold or found.one_sided,
            data=tuple(self.data),
        )

    def oriented(self) -> TriangleMesh:
        """The same mesh with consistently oriented faces: in each part connected through edges the fewer ones are turned.

        Raises
        ------
        TopologyError
            The surface has one side only.

        Examples
        --------
        >>> import beltrami as bt
        >>> bt.TriangleMesh([[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [0, 3, 2]]).oriented().faces.tolist()
        [[0, 1, 2], [0, 2, 3]]
        """
        if self.is_oriented:
            return self
        return TriangleMesh(self.vertices, _core.oriented_faces((self.vertices, self.faces)), data=self.data)

    def submesh(self, vertices: npt.ArrayLike) -> TriangleMesh:
        """The part of the mesh on some vertices: those, in their order, the faces between them, and their data.

        Parameters
        ----------
        vertices : array_like (n,) of bool, or of vertex numbers
            Which vertices to keep; ``numpy.flatnonzero(mask)`` gives their old indices.

        Raises
        ------
        InputError
            A number is out of range, or none is given.

        Examples
        --------
        >>> import beltrami as bt
        >>> sphere = bt.shapes.sphere(2)
        >>> sphere.submesh(sphere.vertices[:, 2] >= 0).boundary_loops
        1
        """
        chosen = np.unique(arrays.indices(vertices, "vertices", len(self.vertices)))
        numbers = np.full(len(self.vertices), -1, np.int32)
        numbers[chosen] = np.arange(len(chosen), dtype=np.int32)
        faces = numbers[self.faces]
        return TriangleMesh(
            self.vertices[chosen], faces[(faces >= 0).all(axis=1)], data={name: values[chosen] for name, values in self.data.items()}
        )

    def largest_component(self) -> TriangleMesh:
        """The component with the greatest area (the first of equal ones), as :meth:`submesh` gives it.

        Raises
        ------
        TopologyError
            The mesh has no triangle.
        """
        if self.components == 0:
            raise TopologyError("the mesh has no triangle, so it has no component")
        real = self.component_labels[self.faces[:, 0]]
        kept = real >= 0
        areas = np.bincount(real[kept], weights=self.face_areas[kept], minlength=self.components)
        return self.submesh(self.component_labels == int(np.argmax(areas)))


class _Topology(NamedTuple):
    edges: Ints
    labels: Ints
    components: int
    euler: int
    unreferenced: int
    degenerate: int
    closed: bool
    edge_manifold: bool
    loops: list[Ints]
    non_manifold: str | None
    inconsistent: tuple[int, int] | None
    one_sided: str | None
    genus: int | None


@dataclass(frozen=True)
class MeshReport:
    """What :meth:`TriangleMesh.report` found; ``str()`` of it is a table for people.

    ``area`` is None where it is beyond the range of float64, ``genus`` where there is none (``reason`` says why),
    ``edge_length`` (least, mean, greatest) where there is no edge.
    """

    vertices: int
    dimension: int
    faces: int
    area: float | None
    bounds: tuple[tuple[float, ...], tuple[float, ...]]
    edge_length: tuple[float, float, float] | None
    components: int
    euler_characteristic: int
    genus: int | None
    boundary_loops: int
    is_closed: bool
    is_manifold: bool
    is_oriented: bool
    is_orientable: bool
    unreferenced_vertices: int
    repeated_corner_faces: int
    zero_area_faces: int
    reason: str | None
    data: tuple[str, ...]

    def __str__(self) -> str:
        yes = {True: "yes", False: "no"}
        rows = [
            ("vertices", f"{self.vertices} in R^{self.dimension}"),
            ("faces", str(self.faces)),
            ("area", "beyond float64" if self.area is None else f"{self.area:.6g}"),
            ("bounds", "  ".join(f"[{a:.4g}, {b:.4g}]" for a, b in zip(*self.bounds, strict=True))),
        ]
        if self.edge_length is not None:
            rows.append(("edge length", "least {:.4g}, mean {:.4g}, greatest {:.4g}".format(*self.edge_length)))
        rows += [
            ("components", str(self.components)),
            ("genus", "none" if self.genus is None else str(self.genus)),
            ("Euler characteristic", str(self.euler_characteristic)),
            ("boundary loops", str(self.boundary_loops)),
            ("closed", yes[self.is_closed]),
            ("manifold", yes[self.is_manifold]),
            ("oriented", yes[self.is_oriented] if self.is_orientable else "no, it has one side only"),
        ]
        oddities = [
            ("unreferenced", self.unreferenced_vertices, "vertices of no triangle"),
            ("repeated corners", self.repeated_corner_faces, "faces that name a vertex twice"),
            ("zero area", self.zero_area_faces, "faces without area"),
        ]
        rows += [(name, f"{count} {what}") for name, count, what in oddities if count]
        if self.data:
            rows.append(("data", ", ".join(self.data)))
        if self.reason is not None:
            rows.append(("note", self.reason))
        return "\n".join(f"{name:<22}{text}" for name, text in rows)


@dataclass(frozen=True, eq=False, repr=False)
class PointCloud(_Shown):
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
    deduplicate : bool
        Keep only the first of points that coincide (to 1e-10 of the distance to their 6th neighbour), with its data.
        Operators refuse clouds with repeated points.

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
    deduplicate: InitVar[bool] = field(default=False, kw_only=True)

    def __post_init__(self, deduplicate: bool) -> None:
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
        if deduplicate and count > 1:
            self._keep(_core.first_copies(self.points))

    @property
    def coordinates(self) -> Floats:
        """``points``, (n, D): the name under which meshes, clouds and operators all give the positions of their unknowns."""
        return self.points

    @property
    def intrinsic_dimension(self) -> int:
        """``dimension``, by the name that meshes have it under too."""
        return self.dimension

    def _keep(self, kept: npt.NDArray[np.bool_]) -> None:
        for name in ("points", "normals", "weights"):
            array = getattr(self, name)
            if array is not None:
                object.__setattr__(self, name, arrays.frozen(array[kept], array))
        object.__setattr__(self, "data", _frozen_data({name: array[kept] for name, array in self.data.items()}, int(kept.sum()), "point"))

    def __repr__(self) -> str:
        return f"PointCloud({len(self.points)} points of a {self.dimension}-dimensional surface in R^{self.points.shape[1]})"

    def __reduce__(self) -> tuple[Any, ...]:
        more = {"dimension": self.dimension, "normals": self.normals, "weights": self.weights, "data": dict(self.data)}
        return _remake, (PointCloud, (self.points,), more)


Shape = TriangleMesh | PointCloud


def no_shape(given: Any, name: str = "shape", wanted: str = "a TriangleMesh, a PointCloud or Operators") -> InputError:
    """The error for something else in the place of a shape, with what would make one of it."""
    kind = type(given)
    package = kind.__module__.split(".")[0]
    what = kind.__name__ if package in ("builtins", "beltrami") else f"{package}.{kind.__name__}"
    if isinstance(given, str | os.PathLike):
        remedy = f"bt.load({os.fspath(given)!r}) reads a file"
    elif isinstance(given, np.ndarray) or (isinstance(given, tuple | list) and len(given) != 2):
        remedy = f"bt.PointCloud({name}) makes a cloud of points"
    elif package == "beltrami":
        return InputError(f"{name} is a {what}; {wanted} is needed")
    else:
        remedy = f"bt.load({name}) makes one of an object of trimesh, pyvista, open3d or meshio, or of a pair (vertices, faces)"
    return InputError(f"{name} is a {what}; {wanted} is needed: {remedy}")


def _remake(kind: type[Any], positional: tuple[Any, ...], keywords: dict[str, Any]) -> Any:
    return kind(*positional, **keywords)


def _frequency(level: int, frequency: int | None) -> int:
    if frequency is not None:
        return arrays.whole(frequency, "frequency", 1, 3600)
    return int(2 ** arrays.whole(level, "level", 0, 11))


def _count(value: Any, name: str, least: int) -> int:
    return arrays.whole(value, name, least, 1 << 27)


def _made(make: Callable[..., tuple[Floats, Ints]], vertices: int, *arguments: Any) -> TriangleMesh:
    """A surface of the core's, if there is memory for it: coordinates, triangles, and what it takes to make and to check them."""
    if vertices <= 1 << 27:  # the core refuses more
        arrays.room(12.0 * vertices, f"a surface of {vertices} vertices", "make a coarser one")
    return TriangleMesh(*make(*arguments))


def sphere(level: int = 4, *, frequency: int | None = None, radius: float = 1.0) -> TriangleMesh:
    """A sphere around the origin: an icosahedron whose edges are cut into 2^level (or ``frequency``) equal arcs.

    Parameters
    ----------
    level : int
        Refinement; 10 * 4^level + 2 vertices.
    frequency : int, optional
        In place of ``level``; 10 * frequency^2 + 2 vertices.
    radius : float
        Its radius.

    Raises
    ------
    InputError
        A number is out of range.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.sphere(4)
    TriangleMesh(2562 vertices in R^3, 5120 faces)
    """
    size = arrays.number(radius, "radius", above=0)
    return ellipsoid(size, size, size, level=level, frequency=frequency)


def ellipsoid(a: float = 1.0, b: float = 0.75, c: float = 0.5, *, level: int = 4, frequency: int | None = None) -> TriangleMesh:
    """An ellipsoid with semi-axes a, b, c along x, y, z: the vertices of :func:`sphere`, scaled. Errors as there.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.ellipsoid(1, 1, 2, frequency=10)
    TriangleMesh(1002 vertices in R^3, 2000 faces)
    """
    axes = arrays.number(a, "a", above=0), arrays.number(b, "b", above=0), arrays.number(c, "c", above=0)
    cuts = _frequency(level, frequency)
    return _made(_core.make_ellipsoid, 10 * cuts**2 + 2, cuts, axes)


def torus(major_radius: float = 1.0, minor_radius: float = 0.4, *, rows: int = 75, columns: int = 32) -> TriangleMesh:
    """A torus of revolution around the z axis: ``rows`` circles of ``columns`` vertices.

    Raises
    ------
    InputError
        Not 0 < minor_radius < major_radius, or a number of vertices is below 3.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.torus(1.0, 0.3, rows=90, columns=30).genus
    1
    """
    radii = arrays.number(major_radius, "major_radius", above=0), arrays.number(minor_radius, "minor_radius", above=0)
    counts = _count(rows, "rows", 3), _count(columns, "columns", 3)
    return _made(_core.make_torus, math.prod(counts), radii, *counts)


def flat_torus(first_radius: float = 1.0, second_radius: float = 1.0, *, rows: int = 48, columns: int = 48) -> TriangleMesh:
    """The flat (Clifford) torus (a cos u, a sin u, b cos v, b sin v) in R^4; area 4 π² a b, eigenvalues p²/a² + q²/b².

    Raises
    ------
    InputError
        A radius is not positive, or a number of vertices is below 3.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.flat_torus(rows=40, columns=40)
    TriangleMesh(1600 vertices in R^4, 3200 faces)
    """
    radii = arrays.number(first_radius, "first_radius", above=0), arrays.number(second_radius, "second_radius", above=0)
    counts = _count(rows, "rows", 3), _count(columns, "columns", 3)
    return _made(_core.make_flat_torus, math.prod(counts), radii, *counts)


def grid(rows: int = 33, columns: int = 33, *, width: float = 1.0, height: float = 1.0) -> TriangleMesh:
    """The flat rectangle [0, width] x [0, height] in R^3 (z = 0): ``rows`` x ``columns`` vertices, rows along x.

    Raises
    ------
    InputError
        A length is not positive, or a number of vertices is below 2.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.grid(11, 21, height=2).area
    2.0
    """
    lengths = arrays.number(width, "width", above=0), arrays.number(height, "height", above=0)
    counts = _count(rows, "rows", 2), _count(columns, "columns", 2)
    return _made(_core.make_grid, math.prod(counts), *lengths, *counts)


def cylinder(radius: float = 0.5, height: float = 2.0, *, rows: int = 33, columns: int = 48, closed: bool = False) -> TriangleMesh:
    """A cylinder around the z axis: ``rows`` circles of ``columns`` vertices, open at both ends or ``closed`` by flat discs.

    Raises
    ------
    InputError
        A length is not positive, ``rows`` is below 2 or ``columns`` below 3.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.cylinder().boundary_loops, bt.shapes.cylinder(closed=True).boundary_loops
    (2, 0)
    """
    lengths = arrays.number(radius, "radius", above=0), arrays.number(height, "height", above=0)
    counts = _count(rows, "rows", 2), _count(columns, "columns", 3)
    return _made(_core.make_cylinder, math.prod(counts), *lengths, *counts, bool(closed))


def disc(radius: float = 1.0, *, rings: int = 20) -> TriangleMesh:
    """A flat disc around the origin of R^3 (z = 0): a centre and ``rings`` circles, the k-th of 6 k vertices.

    Raises
    ------
    InputError
        ``radius`` is not positive or ``rings`` is below 1.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.disc(rings=10)
    TriangleMesh(331 vertices in R^3, 600 faces)
    """
    size, circles = arrays.number(radius, "radius", above=0), arrays.whole(rings, "rings", 1, 6000)
    return _made(_core.make_disc, 3 * circles * (circles + 1) + 1, size, circles)


def knot(
    p: int = 2,
    q: int = 3,
    *,
    major_radius: float = 1.0,
    minor_radius: float = 0.45,
    tube_radius: float = 0.16,
    rows: int = 240,
    columns: int = 16,
) -> TriangleMesh:
    """A tube around the torus knot that runs p times around the z axis and q times around the ring; genus 1.

    Parameters
    ----------
    p, q : int
        Without a common divisor; (2, 3) is the trefoil.
    major_radius, minor_radius : float
        Of the torus on which the knot lies.
    tube_radius : float
        Of the tube around it.
    rows, columns : int
        ``rows`` circles of ``columns`` vertices, at equal lengths of arc.

    Raises
    ------
    InputError
        A number is out of range, p and q have a common divisor, or the tube would meet itself.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.knot(2, 3).genus
    1
    """
    radii = (
        arrays.number(major_radius, "major_radius", above=0),
        arrays.number(minor_radius, "minor_radius", above=0),
        arrays.number(tube_radius, "tube_radius", above=0),
    )
    windings = arrays.whole(p, "p", 1, 1000), arrays.whole(q, "q", 1, 1000)
    counts = _count(rows, "rows", 3), _count(columns, "columns", 3)
    return _made(_core.make_knot, math.prod(counts), *windings, radii, *counts)


def _tori(kind: str, ring_radius: float, tube_radius: float, resolution: int, progress: Progress) -> TriangleMesh:
    radii = arrays.number(ring_radius, "ring_radius", above=0), arrays.number(tube_radius, "tube_radius", above=0)
    cells, report = arrays.whole(resolution, "resolution", 6, 4096), reporter(progress, kind.replace("_", " "))
    return TriangleMesh(*_core.make_tori(kind, radii, cells, report))


def figure_eight(*, ring_radius: float = 1.0, tube_radius: float = 0.35, resolution: int = 12, progress: Progress = None) -> TriangleMesh:
    """A thick figure eight: tubes around two circles that touch at the origin, joined smoothly; genus 2.

    Parameters
    ----------
    ring_radius, tube_radius : float
        Of the circles and of the tubes; the tube may have 0.7 of the ring's radius.
    resolution : int
        Cells across a tube; the triangles' edges are about 2 tube_radius / resolution.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Raises
    ------
    InputError
        A number is out of range.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.figure_eight().genus
    2
    """
    return _tori("figure_eight", ring_radius, tube_radius, resolution, progress)


def double_torus(*, ring_radius: float = 1.0, tube_radius: float = 0.35, resolution: int = 12, progress: Progress = None) -> TriangleMesh:
    """Two tori side by side, joined smoothly; genus 2. Parameters and errors as for :func:`figure_eight`.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.double_torus(resolution=8).genus
    2
    """
    return _tori("double_torus", ring_radius, tube_radius, resolution, progress)


def triple_torus(*, ring_radius: float = 1.0, tube_radius: float = 0.35, resolution: int = 12, progress: Progress = None) -> TriangleMesh:
    """Three tori in a row, joined smoothly; genus 3. Parameters and errors as for :func:`figure_eight`.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.triple_torus(resolution=8).genus
    3
    """
    return _tori("triple_torus", ring_radius, tube_radius, resolution, progress)


def star(
    arms: int = 5, *, arm_length: float = 1.0, tube_radius: float = 0.15, resolution: int = 12, progress: Progress = None
) -> TriangleMesh:
    """Tubes with round ends that meet at the origin at equal angles in the plane z = 0, joined smoothly; genus 0.

    Parameters
    ----------
    arms : int
        From 2 to 100.
    arm_length, tube_radius : float
        From the origin to the centre of the round end; the tube may be half as thick as its arm is long.
    resolution : int
        Cells across a tube; the triangles' edges are about 2 tube_radius / resolution.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Raises
    ------
    InputError
        A number is out of range.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.star(5, resolution=8).euler_characteristic
    2
    """
    lengths = arrays.number(arm_length, "arm_length", above=0), arrays.number(tube_radius, "tube_radius", above=0)
    cells, report = arrays.whole(resolution, "resolution", 6, 4096), reporter(progress, "star")
    return TriangleMesh(*_core.make_star(arrays.whole(arms, "arms", 2, 100), *lengths, cells, report))


def y(*, arm_length: float = 1.0, tube_radius: float = 0.2, resolution: int = 12, progress: Progress = None) -> TriangleMesh:
    """Three tubes that meet in a Y: :func:`star` with three arms.

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.shapes.y(resolution=8).genus
    0
    """
    return star(3, arm_length=arm_length, tube_radius=tube_radius, resolution=resolution, progress=progress)
