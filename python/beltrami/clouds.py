"""Operators of point clouds: local meshes and moving least squares."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt
import scipy

from . import _core, arrays
from .arrays import Floats, Ints
from .errors import InputError
from .near import nearest_neighbors
from .operators import Operators
from .progress import Progress, reporter
from .shapes import PointCloud

Weight = Literal["special", "gaussian", "wendland", "uniform"]
SimplexArrays = tuple[Floats, Ints, npt.NDArray[np.uint8], Floats | None]


class _LocalMesh(NamedTuple):
    simplices: Ints
    votes: npt.NDArray[np.uint8]
    voters: npt.NDArray[np.uint8]
    stretch: Floats
    certified: npt.NDArray[np.bool_]
    boundary: npt.NDArray[np.bool_]
    spacing: Floats
    frames: Floats
    curvature: Floats
    estimated_dimension: float


class CloudOperators(Operators):
    """Operators of a point cloud, made by ``bt.operators(cloud)``.

    Where the cloud has normals that are oriented alike, points whose normals oppose each other are never neighbours: the two sides of
    thin parts stay apart (``bt.normals`` finds such normals).

    The elements are the simplices (triangles for d = 2, tetrahedra for d = 3) that the Delaunay stars of the points vote for. A
    simplex with v of its d + 1 corners' stars behind it counts v / (d + 1) times in every sum.

    Attributes
    ----------
    simplices : ndarray (m, d + 1) of int32
        Point numbers, ascending.
    votes : ndarray (m,) of uint8
        From 1 to d + 1.
    voters : ndarray (m,) of uint8
        Whose votes: bit k stands for the star of the simplex's k-th corner.
    certified : float
        Share of the points whose star provably is their Delaunay star: no point that could change it was left out.
    certified_points : ndarray (n,) of bool
        Which those are.
    boundary : ndarray (n,) of bool
        Where the star is open: the cloud ends there.
    point_spacing : ndarray (n,)
        Distance to the 6th neighbour, in units of length.
    frames : ndarray (n, d, D)
        Orthonormal tangent vectors of each point.
    estimated_dimension : float
        The dimension that the growth of the neighbours' distances suggests.
    """

    shape: PointCloud

    def __init__(self, shape: PointCloud, kind: str, *, neighbors: int | None, progress: Progress, reach: Floats | None = None) -> None:
        set_ = object.__setattr__
        set_(self, "shape", shape)
        set_(self, "kind", kind)
        set_(self, "_neighbors", neighbors)
        set_(self, "_reach", reach)
        set_(self, "_reporter", reporter(progress, "operators"))
        set_(self, "notes", ())

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_reporter": None}

    @cached_property
    def _found(self) -> _LocalMesh:
        cloud, d = self.shape, self.shape.dimension
        normals, notes = _usable_normals(cloud)
        own = vars(self)
        found = _LocalMesh(*_core.local_mesh(cloud.points, d, own["_neighbors"], normals, own["_reach"], own["_reporter"]))
        for array in found[:-1]:
            array.flags.writeable = False
        notes += _dimension_note(found.estimated_dimension, d)
        if not found.certified.all():
            wrong = np.flatnonzero(~found.certified)
            notes += (f"the stars of {len(wrong)} of {len(found.certified)} points are not certified, the first is {wrong[0]}",)
        agreed = float((found.votes == d + 1).mean())
        if agreed < 0.7:
            why = "noise, sheets near each other, or cells far longer than wide"
            notes += (f"the stars agree on {100 * agreed:.0f} % of the simplices only ({why})",)
        object.__setattr__(self, "notes", tuple(dict.fromkeys(self.notes + notes)))
        return found

    def reaching(self, reach: Floats) -> CloudOperators:
        """The local mesh anew with ``reach=``, unless that was given when these operators were made."""
        own = vars(self)
        if own["_reach"] is not None:
            return self
        return CloudOperators(self.shape, self.kind, neighbors=own["_neighbors"], progress=None, reach=reach)

    @property
    def simplices(self) -> Ints:
        """Point numbers, ascending, (m, d + 1)."""
        return self._found.simplices

    @property
    def votes(self) -> npt.NDArray[np.uint8]:
        """Corners whose star holds the simplex, (m,)."""
        return self._found.votes

    @property
    def voters(self) -> npt.NDArray[np.uint8]:
        """Which corners' stars hold the simplex, (m,): bit k stands for corner k."""
        return self._found.voters

    @property
    def certified_points(self) -> npt.NDArray[np.bool_]:
        """Which points' stars are certified, (n,)."""
        return self._found.certified

    @property
    def boundary(self) -> npt.NDArray[np.bool_]:
        """Which points' stars are open, (n,)."""
        return self._found.boundary

    @property
    def point_spacing(self) -> Floats:
        """Distance of each point to its 6th neighbour, (n,)."""
        return self._found.spacing

    @property
    def frames(self) -> Floats:
        """Orthonormal tangent vectors of each point, (n, d, D)."""
        return self._found.frames.reshape(len(self._found.frames), self.shape.dimension, -1)

    @property
    def estimated_dimension(self) -> float:
        """The dimension that the growth of the neighbours' distances suggests."""
        return self._found.estimated_dimension

    @property
    def local_mesh(self) -> SimplexArrays:
        """Points, simplices, votes and stretch, as the core's kernels take them."""
        return self.shape.points, self.simplices, self.votes, self._found.stretch

    @property
    def certified(self) -> float:
        """Share of the points whose star is certified."""
        return float(self.certified_points.mean())

    @cached_property
    def stiffness(self) -> scipy.sparse.csr_array:
        """L, (n, n): positive semidefinite, symmetric to the last bit; rows sum to zero."""
        n = len(self.shape.points)
        return arrays.csr_out(_core.local_stiffness(self.local_mesh), (n, n))

    @cached_property
    def mass(self) -> Floats:
        """Lumped masses, (n,), in units of length^d."""
        return arrays.read_only(_core.local_mass(self.local_mesh))

    @cached_property
    def raw_stiffness(self) -> scipy.sparse.csr_array:
        """(n, n): each row from its own point's star alone (Lai, Liang and Zhao). Rows sum to zero; not symmetric where stars disagree."""
        n, space = self.shape.points.shape
        size = self.shape.dimension + 1
        hats = self.simplex_gradient.data.reshape(-1, space, size)
        products = np.einsum("mxi,mxj->mij", hats, hats) * self._volumes[:, None, None]
        simplex, corner = np.nonzero(self.held)
        rows = np.repeat(self.simplices[simplex, corner], size)
        entries = scipy.sparse.coo_array((products[simplex, corner].ravel(), (rows, self.simplices[simplex].ravel())), shape=(n, n))
        matrix = scipy.sparse.csr_array(entries)
        matrix.sort_indices()
        return arrays.csr_out((matrix.data, matrix.indices, matrix.indptr), (n, n))

    @cached_property
    def raw_mass(self) -> Floats:
        """(n,): a (d + 1)-th of each point's own star, in units of length^d."""
        size = self.shape.dimension + 1
        simplex, corner = np.nonzero(self.held)
        weights = self._volumes[simplex] / size
        sums = np.bincount(self.simplices[simplex, corner], weights=weights, minlength=len(self.shape.points))
        return arrays.read_only(sums.astype(np.float64))

    @property
    def held(self) -> npt.NDArray[np.bool_]:
        """Which corners' stars hold each simplex, (m, d + 1): the bits of ``voters``."""
        held: npt.NDArray[np.bool_] = (self.voters[:, None] >> np.arange(self.shape.dimension + 1, dtype=np.uint8)) % 2 == 1
        return held

    @cached_property
    def _volumes(self) -> Floats:
        volumes: Floats = _core.local_volumes(self.local_mesh) * self._found.stretch
        return volumes

    @cached_property
    def spacing(self) -> float:
        """Mean length of the edges of the local mesh."""
        return _core.local_edge_length(self.local_mesh)

    def weighted_stiffness(self, potential: npt.ArrayLike) -> scipy.sparse.csr_array:
        """Stiffness of ``∫ exp(-potential) |grad u|²``, the weight averaged on each edge by the harmonic mean.

        Parameters
        ----------
        potential : array_like (n,)
            Taken relative to its least value, so that the greatest weight is 1.

        Returns
        -------
        scipy.sparse.csr_array (n, n)

        References
        ----------
        Scharfetter and Gummel, Large-signal analysis of a silicon Read diode oscillator, 1969.
        """
        n = len(self.shape.points)
        values = arrays.floats(potential, "potential", (n,))
        return arrays.csr_out(_core.local_stiffness(self.local_mesh, values), (n, n))

    @cached_property
    def simplex_areas(self) -> Floats:
        """(m,): area (volume) of each simplex, times votes / (d + 1): they add up to the mass.

        In three-dimensional clouds that are curved each simplex counts with the volume of the curved one between its corners.
        """
        return arrays.read_only(self._volumes * self.votes / (self.shape.dimension + 1))

    @cached_property
    def simplex_gradient(self) -> scipy.sparse.csr_array:
        """(m D, n): gradient of piecewise-linear functions on each simplex; ``stiffness`` is its square, weighted by ``simplex_areas``."""
        n, space = self.shape.points.shape
        return arrays.csr_out(_core.local_gradient(self.local_mesh), (len(self.votes) * space, n))

    @cached_property
    def second_fundamental_form(self) -> Floats:
        """(n, d, d, D): the normal vectors by which the cloud bends along the directions of ``frames``, in 1 / length."""
        n, space = self.shape.points.shape
        d = self.shape.dimension
        pairs = self._found.curvature.reshape(n, -1, space)
        form = np.empty((n, d, d, space))
        for at, (a, b) in enumerate(zip(*np.triu_indices(d), strict=True)):
            form[:, a, b] = form[:, b, a] = pairs[:, at]
        return arrays.read_only(form)

    @property
    def mean_curvature(self) -> Floats:
        """(n, D): the mean curvature vector, the mean of the second fundamental form's diagonal; -x on the unit sphere."""
        trace: Floats = np.trace(self.second_fundamental_form, axis1=1, axis2=2) / self.shape.dimension
        return trace

    @property
    def scalar_curvature(self) -> Floats:
        """(n,): Σ h_aa · h_bb - |h_ab|² (Gauss' equation): twice the Gaussian curvature of a surface, 6 on the unit S^3."""
        form = self.second_fundamental_form
        trace = np.trace(form, axis1=1, axis2=2)
        curvature: Floats = (trace * trace).sum(1) - (form * form).sum((1, 2, 3))
        return curvature

    @cached_property
    def _least_squares(self) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
        cloud = self.shape
        n, space = cloud.points.shape
        gradient, laplacian, _, _ = _core.moving_least_squares(cloud.points, cloud.dimension, 2, normals=_usable_normals(cloud)[0])
        return arrays.csr_out(gradient, (n * space, n)), arrays.csr_out(laplacian, (n, n))

    @cached_property
    def gradient(self) -> scipy.sparse.csr_array:
        """G, (n D, n): ``(G @ f).reshape(n, D)`` has the tangent vector of ``f`` at each point, by moving least squares."""
        return self._least_squares[0]

    @cached_property
    def divergence(self) -> scipy.sparse.csr_array:
        """(n, n D): the exact negative adjoint of the gradient in the mass inner product."""
        adjoint = scipy.sparse.csr_array(self.gradient.T)
        columns = np.repeat(self.mass, self.shape.points.shape[1])[adjoint.indices]
        rows = np.repeat(-1.0 / self.mass, np.diff(adjoint.indptr))
        return arrays.csr_out((adjoint.data * columns * rows, adjoint.indices, adjoint.indptr), adjoint.shape)

    @cached_property
    def element_areas(self) -> Floats:
        """(n,): the masses; the gradient of a cloud lives at its points."""
        return self.mass


class RawOperators(CloudOperators):
    """Operators of a point cloud whose Laplacian has raw rows, made by ``bt.operators(cloud, symmetric=False)``.

    Each row of ``laplacian`` comes from its own point's star alone, as Lai, Liang and Zhao state the method; it is not symmetric where
    stars disagree. Eigenproblems and Poisson equations take ``stiffness`` and ``mass``, which are the symmetric ones.
    """

    @cached_property
    def laplacian(self) -> scipy.sparse.csr_array:
        """Laplace-Beltrami, (n, n): ``-diag(raw_mass)^-1 raw_stiffness``."""
        rows = np.divide(-1.0, self.raw_mass, out=np.zeros(len(self.raw_mass)), where=self.raw_mass > 0)
        matrix = self.raw_stiffness
        return arrays.csr_out((matrix.data * np.repeat(rows, np.diff(matrix.indptr)), matrix.indices, matrix.indptr), matrix.shape)


class LeastSquaresOperators(CloudOperators):
    """Operators of a point cloud by moving least squares, made by ``bt.operators(cloud, laplacian="mls")``.

    ``gradient`` and ``laplacian`` are exact on polynomials of the degree where the cloud is flat. ``laplacian`` is not symmetric:
    eigenproblems and Poisson equations take ``stiffness`` and ``mass``, which are those of the local mesh.

    Attributes
    ----------
    signed_points : ndarray of int
        Points whose row of the Laplacian has a negative off-diagonal entry. Where there is none, every eigenvalue of
        ``-laplacian`` has a real part >= 0.
    """

    signed_points: npt.NDArray[np.uint32]

    def __init__(
        self, shape: PointCloud, *, degree: int, neighbors: int | None, weight: str, constrained: bool, progress: Progress
    ) -> None:
        super().__init__(shape, "mls", neighbors=None, progress=None)
        n, space = shape.points.shape
        normals, notes = _usable_normals(shape)
        gradient, laplacian, signed, estimate = _core.moving_least_squares(
            shape.points, shape.dimension, degree, neighbors, weight, constrained, normals, reporter(progress, "moving least squares")
        )
        vars(self).update(
            gradient=arrays.csr_out(gradient, (n * space, n)),
            laplacian=arrays.csr_out(laplacian, (n, n)),
            signed_points=signed,
            notes=notes + _dimension_note(estimate, shape.dimension),
        )

    def __repr__(self) -> str:
        return f"Operators(mls, n = {len(self.shape.points)}, {self.laplacian.nnz} entries)"


def _usable_normals(cloud: PointCloud) -> tuple[Floats | None, tuple[str, ...]]:
    """The cloud's normals if they are oriented alike, and a note if they are not."""
    count, space = cloud.points.shape
    if cloud.normals is None or space != cloud.dimension + 1 or count < 7:
        return None, ()
    sample = slice(None, None, max(1, count // 4000))
    indices, _ = nearest_neighbors(cloud.points, cloud.points[sample], 7)
    opposed = float((np.einsum("nd,nkd->nk", cloud.normals[sample], cloud.normals[indices[:, 1:]]) < 0).mean())
    if opposed > 0.4:  # a half where signs are random
        return None, (f"normals were not used: {100 * opposed:.0f} % of those of near neighbours point the other way",)
    return cloud.normals, ()


def _dimension_note(estimate: float, dimension: int) -> tuple[str, ...]:
    if round(estimate) == dimension:
        return ()
    return (f"the points look {estimate:.1f}-dimensional, dimension={dimension} was given",)


def _local_mesh(cloud: PointCloud, mass: str, options: dict[str, Any]) -> Operators:
    neighbors, reach, progress = options.pop("neighbors", None), options.pop("reach", None), options.pop("progress", None)
    family = CloudOperators if options.pop("symmetric", True) else RawOperators
    _no_more(options, mass, "local_mesh", "neighbors, reach, symmetric, progress")
    neighbors = _neighbors(neighbors, cloud, 0.8)
    if reach is not None:
        reach = arrays.floats(reach, "reach", (len(cloud.points),))
    ops = family(cloud, "local_mesh", neighbors=neighbors, progress=progress, reach=reach)
    _ = ops.stiffness, ops.mass, ops.spacing  # what is wrong with the cloud is said now
    return ops


def _moving_least_squares(cloud: PointCloud, mass: str, options: dict[str, Any]) -> Operators:
    degree = arrays.whole(options.pop("degree", 2), "degree", 1, 6)
    neighbors, progress = options.pop("neighbors", None), options.pop("progress", None)
    weight, constrained = options.pop("weight", "special"), options.pop("constrained", True)
    _no_more(options, mass, "mls", "degree, neighbors, weight, constrained, progress")
    neighbors = _neighbors(neighbors, cloud, 6.0)
    arrays.word(weight, "weight", get_args(Weight))
    return LeastSquaresOperators(cloud, degree=degree, neighbors=neighbors, weight=weight, constrained=bool(constrained), progress=progress)


def _neighbors(given: Any, cloud: PointCloud, numbers: float) -> int | None:
    """How many each point starts from; so many ``numbers`` are kept for each of them."""
    if given is None:
        return None
    wanted, count = arrays.whole(given, "neighbors", cloud.dimension + 1), len(cloud.points)
    arrays.room(numbers * min(wanted, count) * count, f"neighbors = {wanted} of each of {count} points", "take fewer neighbours")
    return wanted


def _no_more(options: dict[str, Any], mass: str, kind: str, known: str) -> None:
    if options:
        raise InputError(f"{', '.join(options)}: no option of laplacian={kind!r}; its options are {known}")
    if mass != "lumped":
        raise InputError(f"mass is {mass!r}; point clouds have lumped masses")


BUILDERS: dict[str, Callable[[Any, str, dict[str, Any]], Operators]] = {
    "auto": _local_mesh,
    "local_mesh": _local_mesh,
    "mls": _moving_least_squares,
}
