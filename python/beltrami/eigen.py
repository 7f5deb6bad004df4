"""Laplace-Beltrami eigenpairs: the frequencies of a shape and its modes of vibration."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from . import _core, arrays
from .arrays import Floats
from .errors import InputError
from .files import written
from .operators import Operators, operators
from .progress import Progress, reporter
from .results import save_result
from .shapes import Shape
from .view import Page, Picture, plot

__all__ = ["Eigenpairs", "eigenpairs"]


@dataclass(frozen=True, eq=False, repr=False)
class Eigenpairs:
    """k eigenpairs ``L φ = λ diag(m) φ``.

    Attributes
    ----------
    values : ndarray (k,)
        λ, ascending, with multiplicities; in 1 / length² for surfaces.
    functions : ndarray (n, k)
        φ, orthonormal in the mass inner product; the entry of largest size is positive. 0 at vertices without mass.
    residuals : ndarray (k,)
        ``|L φ - λ m φ|`` in the norm of ``diag(m)^-1``: an exact eigenvalue lies within this distance of the value.
    iterations : int
        Number of block solves; 0 if a dense solver was used.
    shape : TriangleMesh or PointCloud or None
        The shape they belong to; None for a matrix pencil.
    """

    values: Floats
    functions: Floats
    residuals: Floats
    iterations: int
    shape: Shape | None = None

    def __repr__(self) -> str:
        n, k = self.functions.shape
        return f"Eigenpairs(k = {k}, n = {n}, largest residual {self.residuals.max():.1e})"

    def plot(
        self, modes: int | Sequence[int] | None = None, *, path: str | os.PathLike[str] | None = None, **options: Any
    ) -> Picture | Page:
        """Paints eigenfunctions with the lines where they vanish, a panel each; options are those of :func:`beltrami.plot`.

        Parameters
        ----------
        modes : int or sequence of int, optional
            Which modes; by default the first six after the constant one.
        path : path, optional
            ``.png`` or ``.html``.

        Raises
        ------
        InputError
            There is no such mode, or the pairs belong to matrices and not to a shape.

        Examples
        --------
        >>> import beltrami as bt
        >>> bt.eigenpairs(bt.shapes.sphere(3), 4).plot([1, 2], size=(400, 200)).pixels.shape
        (200, 400, 3)
        """
        if self.shape is None:
            raise InputError("these pairs belong to matrices, not to a shape: bt.plot(shape, pairs.functions[:, k]) shows one")
        count = len(self.values)
        first = 1 if count > 1 else 0
        chosen = range(first, min(count, first + 6)) if modes is None else np.atleast_1d(np.asarray(modes))
        columns = [arrays.whole(mode, "modes", 0, count - 1) for mode in chosen]
        shown = {f"mode {mode}, λ = {self.values[mode] + 0.0:.4g}": self.functions[:, mode] for mode in columns}
        if not shown:
            raise InputError("modes is empty; name at least one")
        options = {"contours": [0.0], "color_bar": False, **options}
        return plot(self.shape, shown, path=path, **options)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``, values and residuals to ``.csv``, the shape with the functions to ``.ply``, a picture to ``.png``
        or ``.html``.

        Raises
        ------
        InputError
            The suffix is none of these; or it wants a shape, and the pairs belong to matrices.
        FileError
            The file cannot be written.
        """
        if self.shape is None and arrays.file(path, "path").suffix.lower() not in (".npz", ".csv"):
            raise InputError(f"{path}: eigenpairs are written to .npz or .csv, those of a shape to .ply, .png or .html too")
        return save_result(self, path, "eigenpairs are", {".csv": self._save_values}, values=("functions",))

    def _save_values(self, path: Path) -> Path:
        rows, look = np.column_stack([self.values, self.residuals]), {"header": "value,residual", "comments": "", "delimiter": ","}
        return written(path, lambda stream: np.savetxt(stream, rows, fmt="%.17g", **look))


def eigenpairs(
    shape: Shape | Operators | Any,
    k: int,
    *,
    mass: Any = None,
    shift: float | None = None,
    start: Any = None,
    progress: Progress = None,
) -> Eigenpairs:
    """Compute the k smallest eigenpairs of the Laplacian of a shape or of a matrix pencil, or those nearest to a number.

    Block shift-invert Lanczos with one Cholesky factor; small problems are solved densely. A pair that has not converged is never
    returned. The same input gives the same bits.

    Parameters
    ----------
    shape : TriangleMesh, PointCloud, Operators, or a sparse symmetric matrix (n, n)
        A matrix with negative eigenvalues needs a ``shift``.
    k : int
        How many, at most the number of vertices that have mass.
    mass : array_like (n,) or sparse matrix (n, n), optional
        For a matrix: the mass, diagonal or positive definite; the identity by default. Not allowed with a shape.
    shift : float, optional
        Find the k eigenvalues nearest to this number, wherever it lies, instead of the smallest ones. Inside the spectrum the
        factorization needs pivoting and is a few times slower; exactly at an eigenvalue it does not exist.
    start : array_like (n, w), optional
        Vectors close to the wanted ones, e.g. those of a similar shape with the same vertices, which save solves.
    progress : callable or True, optional
        Called with the share of work done, 0 to 1; returning False stops with :class:`Cancelled`. True draws a bar.

    Returns
    -------
    Eigenpairs

    Raises
    ------
    InputError
        k is out of range, or arrays do not fit.
    NumericalError
        The matrix has negative eigenvalues and no ``shift``, the mass is not positive definite, or numbers overflow.
    ConvergenceError
        A pair did not converge.

    References
    ----------
    Grimes, Lewis and Simon, A shifted block Lanczos algorithm for solving sparse symmetric generalized eigenproblems, 1994.

    Examples
    --------
    >>> import beltrami as bt
    >>> abs(bt.eigenpairs(bt.shapes.sphere(4), 4).values).round(2)
    array([0., 2., 2., 2.])
    """
    k = arrays.whole(k, "k", 1)
    if shift is not None:
        shift = arrays.number(shift, "shift")
    belongs: Shape | None = None
    coordinates: Floats | None = None
    if scipy.sparse.issparse(shape) or isinstance(shape, np.ndarray):
        matrix = arrays.csr_in(shape, "the matrix")
        n = matrix[0]
    else:
        if mass is not None:
            raise InputError("mass= goes with a matrix; a shape brings its own")
        ops = operators(shape)
        belongs, coordinates, n = ops.shape, ops.coordinates, len(ops.mass)
        matrix = arrays.csr_in(ops.stiffness, "the stiffness")
        mass = ops.mass
    first = None if start is None else arrays.floats(start, "start", (n, None))
    if k > n:
        raise InputError(f"k is {k}, the shape has {n} vertices; ask for at most {n} eigenpairs")
    arrays.room(6.0 * k * n, f"k = {k} eigenpairs of {n} unknowns", "ask for fewer")
    report = reporter(progress, "eigenpairs")
    if scipy.sparse.issparse(mass):
        found = _core.eigenpairs(matrix, None, arrays.csr_in(mass, "the mass matrix"), k, shift, coordinates, first, report)
    else:
        diagonal = np.ones(n) if mass is None else arrays.floats(mass, "mass", (n,))
        found = _core.eigenpairs(matrix, diagonal, None, k, shift, coordinates, first, report)
    return Eigenpairs(*found, belongs)
