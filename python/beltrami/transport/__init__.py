"""Dynamic optimal transport over a surface, with a certificate (section 8.2), and barycenters by the same method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..costs import Lagrangian
from ..operators import Operators
from ..progress import GapWatch, Progress
from ..shapes import Shape
from . import continuity
from .continuity import Problem, Surface
from .flow import Flow, Method, balanced, density_in, flow_fields, options_in, still

__all__ = ["Flow", "TransportResult", "transport"]


@dataclass(frozen=True, eq=False, repr=False)
class TransportResult(Flow):
    """A geodesic of densities in the Wasserstein distance, and a bound on its distance from the optimum.

    It has all attributes of :class:`Flow`, and also:

    Attributes
    ----------
    cost : float
        ``½ W2²``: the kinetic energy of the returned path, ``1 / intervals Σ_k Σ_T A_T |M|² / (2 ρ)``.
    distance : float
        W2, the root of twice the cost, between measures of the mass that the densities have: it grows with the root of that mass.
        For the distance of probability distributions give densities of unit mass, ``density / (ops.mass @ density)``.
    """

    cost: float
    distance: float

    def __repr__(self) -> str:
        state = "" if self.converged else ", NOT CONVERGED"
        return f"TransportResult(distance {self.distance:.6g}, gap {self.gap:.1e} after {self.iterations} iterations{state})"


def transport(
    shape: Shape | Operators,
    density0: npt.ArrayLike,
    density1: npt.ArrayLike,
    *,
    intervals: int = 32,
    normalize: bool = False,
    method: Method = "primal_dual",
    tolerance: float = 1e-3,
    max_iterations: int = 300,
    memory: float | None = None,
    progress: Progress = None,
) -> TransportResult:
    """Compute optimal transport between two densities on a surface: the path of least kinetic energy [1]_, [2]_.

    Minimizes ``∫ Σ_T A_T |M|² / (2 P)`` (8.19-8.20), which is ``½ W2²``, over densities P at vertices and momenta M on triangles with
    ``∂_t P + div M = 0`` and the given ends. The iteration projects exactly onto the continuity equation, with one sparse factor per
    mode of time (8.23-8.25). The returned path satisfies the equation to rounding and has no negative densities, so its cost is an
    upper bound; the potential, corrected until it satisfies the Hamilton-Jacobi inequality, proves a lower bound.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
        With or without boundary (nothing flows through it), with any number of components.
    density0, density1 : array_like (n,)
        Per unit area: ``ops.mass @ density0 == ops.mass @ density1`` on each component, to 1e-9. May be zero anywhere.
    intervals : int
        Number of time intervals, usually 16 to 32. The error of the discretization decreases with their number and with the mesh.
    normalize : bool
        Rescale ``density1`` to the mass of ``density0``, which is left as it is.
    method : {"primal_dual", "projected_gradient"}
        Splitting with the exact projection of the perspective function [3]_, which allows vanishing densities; or the
        chapter's Algorithm 2 with acceleration [2]_, for densities bounded away from zero.
    tolerance : float
        Relative gap to stop at.
    max_iterations : int
        Iterations after which the best answer so far is returned, with ``converged=False``.
    memory : float, optional
        Bytes that the factors may take, 2e9 by default: n vertices take about 300 n bytes per mode (there are ``intervals`` modes). With
        less, modes share factors and the others are solved by preconditioned conjugate gradients, to the same precision.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    TransportResult
        With ``converged=False`` if the gap was not reached; the bounds are valid in any case.

    Raises
    ------
    InputError
        A density is negative, not finite, of the wrong length, or without mass; masses differ (the message says by how much, and on
        which component); an option is out of range.

    See Also
    --------
    mean_field_game, wasserstein_barycenter

    References
    ----------
    .. [1] J.-D. Benamou, Y. Brenier, A computational fluid mechanics solution to the Monge-Kantorovich mass transfer problem, 2000.
    .. [2] J. Yu, R. Lai, W. Li, S. Osher, Computational mean-field games on manifolds, 2023.
    .. [3] N. Papadakis, G. Peyré, E. Oudet, Optimal transport with proximal splitting, 2014.
    .. [4] H. Lavenant, S. Claici, E. Chien, J. Solomon, Dynamical optimal transport on discrete surfaces, 2018.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> sphere = bt.shapes.sphere(3)
    >>> z = sphere.vertices[:, 2]
    >>> r = bt.transport(sphere, np.exp(z), np.exp(-z), intervals=8, normalize=True)
    >>> r.converged, bool(r.lower_bound <= r.cost <= 1.001 * r.lower_bound), bool(r.density.min() >= 0)
    (True, True, True)
    """
    surface = Surface(shape)
    wished, most, limit = options_in(method, tolerance, max_iterations, memory)
    given = [density_in(surface, density0, "density0"), density_in(surface, density1, "density1")]
    start, end = balanced(surface, given, ("density0", "density1"), normalize)
    problem = Problem(surface, start, end, arrays.whole(intervals, "intervals", 1), Lagrangian(), memory=limit)
    if np.abs(end - start).max() <= 1e-14 * start.max():
        return TransportResult(**still(problem), cost=0.0, distance=0.0)
    certificate, iterations = continuity.solve(problem, method, wished, most, GapWatch(progress, "transport", wished))
    fields, cost = flow_fields(problem, certificate, iterations, wished)
    return TransportResult(**fields, cost=cost, distance=float(np.sqrt(2 * max(cost, 0.0))))
