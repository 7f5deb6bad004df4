"""Discrete operators of a shape: stiffness, mass, gradient, divergence, Laplacian. A mesh and a cloud both make them, and every
method takes them, so that a method is written once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy

from . import _core, arrays
from .arrays import Floats, Ints
from .errors import InputError
from .shapes import PointCloud, Shape, TriangleMesh, no_shape

Laplacian = Literal["auto", "cotangent", "intrinsic_delaunay", "tufted", "local_mesh", "mls"]
Mass = Literal["lumped", "voronoi"]


@dataclass(frozen=True, eq=False, repr=False)
class Operators(ABC):
    """Operators of a shape with n vertices or points, made by :func:`operators`. Arrays and the values of matrices are read-only.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
        What they belong to.
    kind : str
        The Laplacian that was built: what ``"auto"`` chose.
    stiffness : scipy.sparse.csr_array (n, n)
        L, positive semidefinite, symmetric to the last bit; rows sum to zero. Dimensionless for surfaces.
    mass : ndarray (n,)
        Lumped areas, in squared units of length; 0 at vertices of no triangle.
    spacing : float
        Mean length of the edges.
    notes : tuple of str
        Remarks on how they were made.
    """

    shape: Shape
    kind: str
    stiffness: scipy.sparse.csr_array
    mass: Floats
    spacing: float
    notes: tuple[str, ...] = field(default=(), kw_only=True)

    def __repr__(self) -> str:
        return f"Operators({self.kind}, n = {len(self.mass)}, {self.stiffness.nnz} entries, spacing {self.spacing:.4g})"

    @property
    def coordinates(self) -> Floats:
        """Positions of the unknowns, (n, D): solvers use them for a good order of elimination."""
        return self.shape.coordinates

    @cached_property
    def laplacian(self) -> scipy.sparse.csr_array:
        """Laplace-Beltrami, (n, n): ``-diag(mass)^-1 stiffness``, negative semidefinite. Empty rows where the mass is 0."""
        inverse = np.divide(-1.0, self.mass, out=np.zeros_like(self.mass), where=self.mass > 0)
        rows = np.repeat(inverse, np.diff(self.stiffness.indptr))
        return arrays.csr_out((self.stiffness.data * rows, self.stiffness.indices, self.stiffness.indptr), self.stiffness.shape)

    @property
    @abstractmethod
    def gradient(self) -> scipy.sparse.csr_array:
        """G, (m D, n): ``(G @ f).reshape(m, D)`` has the tangent vector of ``f`` on each triangle."""

    @property
    @abstractmethod
    def divergence(self) -> scipy.sparse.csr_array:
        """(n, m D): the exact negative adjoint of the gradient in the area and mass inner products."""

    @property
    @abstractmethod
    def element_areas(self) -> Floats:
        """(m,): areas of the triangles that the gradient lives on."""

    @property
    def simplex_gradient(self) -> scipy.sparse.csr_array:
        """Gradient of piecewise-linear functions on the simplices: ``stiffness`` is its square, weighted by ``simplex_areas``.

        For meshes this is ``gradient``. For clouds, where ``gradient`` lives at the points, it has D rows per simplex of the local mesh.
        """
        return self.gradient

    @property
    def simplex_areas(self) -> Floats:
        """Weights of the simplices of ``simplex_gradient``; they add up to the mass."""
        return self.element_areas

    @cached_property
    def boundary(self) -> npt.NDArray[np.bool_]:
        """(n,): which vertices lie on the boundary."""
        mask = np.zeros(len(self.mass), bool)
        if isinstance(self.shape, TriangleMesh):
            for curve in self.shape.boundary_loop_vertices:
                mask[curve] = True
        return arrays.read_only(mask)

    @cached_property
    def component_labels(self) -> Ints:
        """(n,): number of the connected component of each vertex, by the pattern of the stiffness."""
        from scipy.sparse.csgraph import connected_components

        return arrays.read_only(np.asarray(connected_components(self.stiffness, directed=False)[1], np.int32))

    @cached_property
    def component_masses(self) -> Floats:
        """Total mass of each component."""
        return arrays.read_only(np.bincount(self.component_labels, weights=self.mass).astype(np.float64))


class MeshOperators(Operators):
    """Operators with the triangles of the mesh itself as elements (cotangent weights)."""

    shape: TriangleMesh

    @cached_property
    def gradient(self) -> scipy.sparse.csr_array:
        """G, (m D, n): ``(G @ f).reshape(m, D)`` has the tangent vector of ``f`` on each triangle."""
        count = len(self.shape.faces) * self.shape.dimension
        return arrays.csr_out(_core.gradient((self.shape.vertices, self.shape.faces)), (count, len(self.mass)))

    @cached_property
    def divergence(self) -> scipy.sparse.csr_array:
        """(n, m D): ``-diag(mass)^-1 G^T diag(area)``; empty rows where the mass is 0."""
        count = len(self.shape.faces) * self.shape.dimension
        return arrays.csr_out(_core.divergence((self.shape.vertices, self.shape.faces), self.mass), (len(self.mass), count))

    @cached_property
    def element_areas(self) -> Floats:
        """(m,): areas of the triangles."""
        return self.shape.face_areas

    @cached_property
    def galerkin_mass(self) -> scipy.sparse.csr_array:
        """The consistent mass matrix, (n, n)."""
        n = len(self.mass)
        return arrays.csr_out(_core.galerkin_mass((self.shape.vertices, self.shape.faces)), (n, n))


def operators(shape: Shape | Operators, *, laplacian: Laplacian = "auto", mass: Mass = "lumped", **options: Any) -> Operators:
    """Stiffness, mass, gradient and divergence of a shape.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        Operators come back as they are.
    laplacian : {"auto", "cotangent", "intrinsic_delaunay", "tufted", "local_mesh", "mls"}
        ``"cotangent"``: linear finite elements on the mesh's own triangles. ``"auto"`` takes it wherever the triangles allow it,
        and says in ``notes`` where it took another. For clouds: ``"local_mesh"`` (``"auto"``), linear elements on the Delaunay
        stars of the points, and ``"mls"``, moving least squares.
    mass : {"lumped", "voronoi"}
        A third of the adjacent areas at each vertex, or mixed Voronoi areas (Meyer et al. 2003). Both sum to the area.
    **options
        For clouds. ``neighbors=`` (int): how many each point starts from. ``progress=``. Of ``"local_mesh"``: ``reach=`` (n,), the
        distance to the 6th neighbour that is to be expected at each point (the measured one by default), in units of length; simplices
        that are large beside it count as holes; ``symmetric=`` (True); False takes each row of ``laplacian`` from its own point's star
        alone. And of ``"mls"``: ``degree=`` (2) of the
        polynomials, ``weight=`` ("special", "gaussian", "wendland" or "uniform"), ``constrained=`` (True): rows free of negative
        off-diagonal entries wherever that is possible.

    Returns
    -------
    Operators

    Raises
    ------
    InputError
        The shape has no triangles, a triangle is degenerate (the message names it), or its size is out of range. Points of a cloud
        are too few, coincide, are isolated or in a row (the message names them).

    References
    ----------
    Pinkall and Polthier, Computing discrete minimal surfaces and their conjugates, 1993.
    Lai, Liang and Zhao, A local mesh method for solving PDEs on point clouds, 2013.
    Liang and Zhao, Solving partial differential equations on point clouds, 2013.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> ops = bt.operators(bt.shapes.sphere(3))
    >>> bool(abs(ops.stiffness @ np.ones(len(ops.mass))).max() < 1e-12)
    True
    """
    if isinstance(shape, Operators):
        return shape
    if not isinstance(shape, TriangleMesh | PointCloud):
        raise no_shape(shape)
    from .clouds import BUILDERS

    family = _MESH if isinstance(shape, TriangleMesh) else BUILDERS
    arrays.word(mass, "mass", ("lumped", "voronoi"))
    build = family.get(laplacian) if isinstance(laplacian, str) else None
    if build is None:
        raise InputError(f"laplacian is {laplacian!r}; for a {type(shape).__name__} choose one of {', '.join(map(repr, family))}")
    return build(shape, mass, options)


def _no_options(options: dict[str, Any], kind: str) -> None:
    if options:
        raise InputError(f"{', '.join(options)}: no option of laplacian={kind!r}")


def _cotangent(shape: Any, mass: str, options: dict[str, Any]) -> Operators:
    _no_options(options, "cotangent")
    parts, masses, spacing = _core.cotangent_operators((shape.vertices, shape.faces), mass == "voronoi")
    n = len(masses)
    return MeshOperators(shape, "cotangent", arrays.csr_out(parts, (n, n)), arrays.read_only(masses), spacing)


def _intrinsic(kind: Literal["intrinsic_delaunay", "tufted"], notes: tuple[str, ...] = ()) -> _Builder:
    def build(shape: Any, mass: str, options: dict[str, Any]) -> Operators:
        from . import intrinsic  # it builds on this module

        progress = options.pop("progress", None)
        _no_options(options, kind)
        return intrinsic.build(shape, kind, voronoi=mass == "voronoi", progress=progress, notes=notes)

    return build


def _auto(shape: Any, mass: str, options: dict[str, Any]) -> Operators:
    from . import intrinsic

    kind, notes = intrinsic.choose(shape)
    if kind != "cotangent":
        return _intrinsic(kind, notes)(shape, mass, options)
    options.pop("progress", None)  # done before a bar would show
    return _cotangent(shape, mass, options)


_Builder = Callable[[Any, str, dict[str, Any]], Operators]
_MESH: dict[str, _Builder] = {
    "auto": _auto,
    "cotangent": _cotangent,
    "intrinsic_delaunay": _intrinsic("intrinsic_delaunay"),
    "tufted": _intrinsic("tufted"),
}
