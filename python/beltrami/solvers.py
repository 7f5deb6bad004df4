"""Sparse Cholesky factorization, for any number of solves; Poisson equations, also by multigrid."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import scipy

from . import _core
from .arrays import Floats, anything, csr_in, csr_out, floats, number, points, word
from .errors import InputError
from .operators import Operators, operators
from .progress import Progress, reporter
from .shapes import Shape

__all__ = ["Cholesky", "PoissonSolver", "plus_diagonal", "solve_poisson"]


class Cholesky:
    """The factor of a symmetric positive definite matrix.

    Multifrontal over supernodes [1]_, in parallel, with the same bits on any number of threads. The order is nested
    dissection [2]_ by planes through the coordinates, or by distances in the graph of the matrix, with minimum degree in its leaves.
    Every solve checks its residual and takes a step of iterative refinement if it is above 1e-13.

    Parameters
    ----------
    matrix : sparse matrix or array, (n, n)
        Symmetric positive definite, both triangles stored; any format of scipy.
    coordinates : (n, D) array, optional
        Positions of the unknowns, e.g. the vertices of the mesh; they speed up the ordering.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Raises
    ------
    InputError
        If the matrix is not square, not symmetric or not finite.
    NumericalError
        If it is not positive definite; the message names the row.

    References
    ----------
    .. [1] I. S. Duff, J. K. Reid, The multifrontal solution of indefinite sparse symmetric linear equations, ACM TOMS 9, 1983.
    .. [2] A. George, Nested dissection of a regular finite element mesh, SIAM J. Numer. Anal. 10, 1973.

    Examples
    --------
    >>> import numpy as np, scipy.sparse as sparse, beltrami as bt
    >>> factor = bt.Cholesky(sparse.diags_array([2.0, 4.0]))
    >>> factor.solve(np.array([2.0, 2.0]))
    array([1. , 0.5])
    >>> factor.refactor(sparse.diags_array([1.0, 1.0])).solve([3.0, 5.0])
    array([3., 5.])
    """

    _core: _core.Cholesky
    _n: int

    def __init__(self, matrix: Any, coordinates: Any = None, *, progress: Progress = None) -> None:
        parts = csr_in(matrix, "the matrix")
        places = None if coordinates is None else points(coordinates, "coordinates")
        if places is not None and len(places) != parts[0]:
            raise InputError(f"coordinates has {len(places)} rows, the matrix has {parts[0]}; give one point an unknown")
        self._core = _core.Cholesky(parts, places, None, reporter(progress, "Cholesky"))
        self._n = parts[0]

    def solve(self, b: npt.ArrayLike, out: Floats | None = None) -> Floats:
        """Solve ``A x = b`` for one right-hand side (n,) or several (n, k).

        Parameters
        ----------
        b : (n,) or (n, k) array
            Any dtype of real numbers, any order; not changed.
        out : (n,) or (n, k) float64 array, optional
            Where the answer goes: C-ordered, of the shape of ``b``. May be ``b`` itself.

        Returns
        -------
        (n,) or (n, k) array

        Raises
        ------
        InputError
            If shapes do not fit or a number is not finite.
        """
        table, vector = self._table(b, "b")
        if out is None:
            if table.size == 0:
                return np.zeros(self._n if vector else table.shape)
            x = self._core.solve(table)
            return x[:, 0] if vector else x
        shape = (self._n,) if vector else table.shape
        if not isinstance(out, np.ndarray) or out.dtype != np.float64 or out.shape != shape or not out.flags.carray:
            raise InputError(f"out must be a writable C-ordered float64 array of shape {shape}")
        if np.may_share_memory(out, table):
            table = table.copy()
        self._core.solve_into(table, out.reshape(table.shape))
        return out

    def refactor(self, matrix: Any, *, progress: Progress = None) -> Cholesky:
        """Factor another matrix of the same pattern, in place; the analysis is kept.

        Parameters
        ----------
        matrix : sparse matrix, (n, n)
            Symmetric positive definite, with entries where the first one had them.

        Returns
        -------
        Cholesky
            The factor itself.

        Raises
        ------
        InputError
            If the pattern differs; the factor is then as it was.
        NumericalError
            If it is not positive definite; the factor is then as it was.
        """
        self._core.refactor(csr_in(matrix, "the matrix"), reporter(progress, "Cholesky"))
        return self

    def residual(self, b: npt.ArrayLike, x: npt.ArrayLike) -> float | Floats:
        """``|b - A x| / |b|``: a number, or (k,) numbers for (n, k)."""
        (right, vector), (solution, _) = self._table(b, "b"), self._table(x, "x")
        if right.shape != solution.shape:
            raise InputError(f"b has shape {right.shape}, x {solution.shape}; they must be equal")
        found = self._core.residuals(right, solution)
        return float(found[0]) if vector else found

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the matrix."""
        return (self._n, self._n)

    @property
    def nnz(self) -> int:
        """Numbers kept in the factor."""
        return self._core.nnz()

    @property
    def log_determinant(self) -> float:
        """Logarithm of the matrix's determinant."""
        return self._core.log_determinant()

    @property
    def matrix(self) -> scipy.sparse.csr_array:
        """The matrix that was factored last."""
        return csr_out(self._core.matrix(), self.shape)

    def __repr__(self) -> str:
        return f"Cholesky({self._n} unknowns, {self.nnz} numbers)"

    def __getstate__(self) -> dict[str, Any]:
        return {"matrix": self.matrix, "order": self._core.order()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        parts = csr_in(state["matrix"], "the matrix")
        self._core = _core.Cholesky(parts, None, state["order"], None)
        self._n = parts[0]

    def _table(self, b: npt.ArrayLike, name: str) -> tuple[Floats, bool]:
        array = anything(b, name)
        if array.ndim == 1:
            return floats(array, name, (self._n,), finite=False).reshape(-1, 1), True
        return floats(array, name, (self._n, None), finite=False), False


_COMPATIBLE = 1e-9  # share of its size that the sum of a strict right-hand side may have


def plus_diagonal(matrix: scipy.sparse.csr_array, diagonal: Floats) -> scipy.sparse.csr_array:
    """``matrix + diag(diagonal)``."""
    return scipy.sparse.csr_array(matrix + scipy.sparse.diags_array(diagonal))


PoissonMethod = Literal["auto", "direct", "multilevel"]
_DIRECT = 3_000_000  # vertices whose factor some GB can hold


def _again(ops: Operators, method: PoissonMethod, tolerance: float) -> PoissonSolver:
    return PoissonSolver(ops, method=method, tolerance=tolerance)


class PoissonSolver:
    """Solver of ``L u = b`` on one shape, whose stiffness L is singular: its kernel has one constant per connected component.

    The right-hand side is made compatible, one unknown of each component is fixed, and the solution with zero mean is returned.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
    method : {"auto", "direct", "multilevel"}
        A Cholesky factor, which makes repeated solves fast; or conjugate gradients with a multigrid cycle, which needs 1.5 times the
        memory of the matrix instead of some 15 times. ``"auto"`` is direct up to 3 million vertices.
    tolerance : float
        Relative residual at which the multilevel iteration stops, or where rounding stops it.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    References
    ----------
    Notay, An aggregation-based algebraic multigrid method, Electronic Transactions on Numerical Analysis 37, 2010.

    Examples
    --------
    >>> import beltrami as bt
    >>> sphere = bt.shapes.sphere(4)
    >>> solver = bt.PoissonSolver(sphere)
    >>> u = solver.solve(sphere.vertices[:, 2])  # -Δu = z has u = z / 2
    >>> bool(abs(u - sphere.vertices[:, 2] / 2).max() < 0.01)
    True
    """

    def __init__(
        self, shape: Shape | Operators, *, method: PoissonMethod = "auto", tolerance: float = 1e-12, progress: Progress = None
    ) -> None:
        ops = self.operators = operators(shape)
        word(method, "method", get_args(PoissonMethod))
        #: ``"direct"`` or ``"multilevel"``.
        self.method: PoissonMethod = method if method != "auto" else "direct" if len(ops.mass) <= _DIRECT else "multilevel"
        self._tolerance = number(tolerance, "tolerance", above=0)
        stiffness = csr_in(ops.stiffness, "the stiffness")
        residual = self._tolerance if self.method == "multilevel" else None
        self._core = _core.LaplacianSolver(stiffness, ops.mass, ops.coordinates, residual, reporter(progress, "Poisson"))

    def __repr__(self) -> str:
        return f"PoissonSolver({self.operators!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (self.operators, self.method, self._tolerance)

    def solve(self, f: npt.ArrayLike, *, strict: bool = False) -> Floats:
        """``L u = M f``, that is ``-Δu = f``, with zero mean on each component.

        Parameters
        ----------
        f : array_like (n,) or (n, k)
            Values at the vertices. Their mean on each component is subtracted first, since otherwise there is no solution.
        strict : bool
            Refuse an f whose mean is not zero, instead of subtracting it.

        Returns
        -------
        ndarray (n,) or (n, k)

        Raises
        ------
        InputError
            The length does not fit, a number is not finite, or (``strict``) a mean is not zero.
        """
        values = self._values(f, "f")
        table = values.reshape(len(values), -1) * self.operators.mass[:, None]
        return self._core.solve(table, _COMPATIBLE if strict else None).reshape(values.shape)

    def solve_integrated(self, b: npt.ArrayLike) -> Floats:
        """``L u = b`` for a right-hand side that is integrated already, (n,) or (n, k); zero mean on each component."""
        values = self._values(b, "b")
        return self._core.solve(values.reshape(len(values), -1), None).reshape(values.shape)

    def _values(self, given: npt.ArrayLike, name: str) -> Floats:
        array, n = anything(given, name), len(self.operators.mass)
        return floats(array, name, (n,) if array.ndim == 1 else (n, None))


def solve_poisson(shape: Shape | Operators, f: npt.ArrayLike, *, strict: bool = False, progress: Progress = None) -> Floats:
    """Solve ``-Δu = f`` on a shape: ``L u = M f`` with zero mean on each component.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud or Operators
    f : array_like (n,) or (n, k)
        Values at the vertices; their mean on each component is subtracted first.
    strict : bool
        Refuse an f whose mean is not zero, instead of subtracting it.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    ndarray (n,) or (n, k)

    Raises
    ------
    InputError
        The length does not fit, a number is not finite, or (``strict``) a mean is not zero.

    Examples
    --------
    >>> import beltrami as bt
    >>> sphere = bt.shapes.sphere(4)
    >>> u = bt.solve_poisson(sphere, sphere.vertices[:, 2])
    >>> bool(abs(u - sphere.vertices[:, 2] / 2).max() < 0.01)
    True
    """
    return PoissonSolver(shape, progress=progress).solve(f, strict=strict)
