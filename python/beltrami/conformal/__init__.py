"""Conformal maps of closed surfaces of genus 0 to the unit sphere, and the Möbius maps of the sphere.

A map s of the vertices to the unit sphere has the Dirichlet energy E(s) = 1/2 tr(s^T L s) and its image polyhedron the signed area
A(s). E - A is never negative, and zero only where every triangle keeps its angles: that is what is minimized and reported, for E alone
is smallest where all vertices meet in one point. Möbius maps change neither E nor A in the limit of fine meshes; the one map that
is returned has its area-weighted centre at the origin.
"""

from __future__ import annotations

from typing import Literal, get_args

from .. import arrays
from ..errors import InputError
from ..operators import Operators
from ..progress import Progress, reporter, teller
from ..shapes import PointCloud, Shape, TriangleMesh, no_shape
from .clouds import map_cloud
from .iterations import Task
from .meshes import map_mesh
from .result import SphericalMapResult

__all__ = ["SphericalMapResult", "spherical_map"]

Method = Literal["fast", "cayley", "preconditioned_cayley"]


def spherical_map(
    shape: Shape | Operators,
    *,
    method: Method = "fast",
    tolerance: float = 1e-4,
    max_iterations: int | None = None,
    fill_holes: bool = False,
    check_genus: bool = True,
    progress: Progress = None,
) -> SphericalMapResult:
    """Map a closed surface of genus 0 conformally to the unit sphere.

    Minimizes E - A, Dirichlet energy minus signed image area, among the maps whose area-weighted centre is the origin: a linear map
    to start from, an iteration, and a repair of the triangles that are still flipped.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        Closed, connected, manifold, of genus 0. Orientation is preserved: seen from outside, the image is not mirrored. Of Operators
        only the shape is used.
    method : {"fast", "cayley", "preconditioned_cayley"}
        ``"fast"``: descent preconditioned by one Cholesky factorization, with Anderson acceleration: a handful of steps.
        ``"cayley"``: the iteration of equation 8.28, Cayley steps of Barzilai-Borwein length along the gradient by unit mass, with a
        nonmonotone line search; hundreds of steps. ``"preconditioned_cayley"``: the same along L^-1 of the gradient.
    tolerance : float
        Stop when the root-mean-square movement in a step, in radii, is below this (``"cayley"``: the gradient, on a sphere of area 4π).
    max_iterations : int, optional
        By default 20; 5000 and 200 for the two Cayley iterations.
    fill_holes : bool
        Close the holes of a mesh with rings of triangles for the map only; the result is that of the mesh itself.
    check_genus : bool
        Refuse a cloud that the map shows to be open, or of higher genus; see Notes. Meshes of higher genus are always refused.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    SphericalMapResult

    Raises
    ------
    TopologyError
        The surface is not closed, connected, manifold or of genus 0; the message gives its Euler characteristic and what to do.
    NumericalError
        Parts of the image are lost to rounding: the message says which.

    Notes
    -----
    A cloud has no reliable Euler characteristic, so its genus is checked by the result: if the map is one-to-one, neighbours on the
    sphere are neighbours in the cloud. If more than one point in a hundred has images from elsewhere between its own
    neighbours', or the images do not cover the sphere, the loops of the Reeb graph of the first eigenfunction are counted
    (:func:`beltrami.skeleton`): a cloud is refused where both say that it has handles, or one of them by far. Clouds that leave a part
    of the sphere uncovered, or whose boundary points form a ring, are refused as open.

    References
    ----------
    Lai, Wen, Yin, Gu and Lui, Folding-free global conformal mapping for genus-0 surfaces by harmonic energy minimization, 2014.
    Wen and Yin, A feasible method for optimization with orthogonality constraints, 2013.
    Baden, Crane and Kazhdan, Möbius registration, 2018.

    Examples
    --------
    >>> import beltrami as bt
    >>> r = bt.spherical_map(bt.shapes.ellipsoid(1.0, 0.7, 0.5, level=3))
    >>> r.flipped, r.excess < 0.02
    (0, True)
    """
    arrays.word(method, "method", get_args(Method))
    tolerance = arrays.number(tolerance, "tolerance", above=0)
    steps = _STEPS[method] if max_iterations is None else arrays.whole(max_iterations, "max_iterations", 1)
    task = Task(method, tolerance, steps, teller(reporter(progress, "spherical map")))
    given = shape.shape if isinstance(shape, Operators) else shape
    if isinstance(given, TriangleMesh):
        return map_mesh(given, bool(fill_holes), task)
    if isinstance(given, PointCloud):
        if fill_holes:
            raise InputError("fill_holes=True is for meshes; a cloud has no holes to fill")
        return map_cloud(given, shape if isinstance(shape, Operators) else None, bool(check_genus), task)
    raise no_shape(shape)


_STEPS = {"fast": 20, "cayley": 5000, "preconditioned_cayley": 200}
