"""The group of Möbius maps of the unit sphere: its orientation-preserving conformal maps onto itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .. import _core, arrays
from ..arrays import Floats
from ..errors import InputError, NumericalError

Complex = npt.NDArray[np.complex128]

__all__ = ["Moebius"]


@dataclass(frozen=True, eq=False)
class Moebius:
    """A Möbius map: z -> (a z + b) / (c z + d) on the plane below the sphere's stereographic projection from (0, 0, 1).

    Parameters
    ----------
    matrix : (2, 2) array of complex
        [[a, b], [c, d]] with a determinant that is not zero; it is scaled to determinant 1.

    Raises
    ------
    InputError
        The determinant is zero or a number is not finite.

    Examples
    --------
    >>> import numpy as np, beltrami as bt
    >>> points = bt.shapes.sphere(2).vertices
    >>> map = bt.Moebius.translation([0.3, 0.1, -0.2])
    >>> bool(np.allclose((map @ map.inverse)(points), points))
    True
    """

    matrix: Complex

    def __post_init__(self) -> None:
        try:
            matrix = np.array(self.matrix, np.complex128)
        except (TypeError, ValueError):
            raise InputError(f"matrix is {self.matrix!r}; (2, 2) finite complex numbers are needed") from None
        if matrix.shape != (2, 2) or not np.isfinite(matrix).all():
            raise InputError(f"matrix has shape {matrix.shape}; (2, 2) finite complex numbers are needed")
        largest = np.abs(matrix).max()
        determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
        if not abs(determinant) > 1e-300 + 1e-15 * largest**2:
            raise InputError(f"matrix has determinant {determinant:.3g}; the map would not be one to one")
        matrix = matrix / np.sqrt(determinant)
        matrix.flags.writeable = False
        object.__setattr__(self, "matrix", matrix)

    def __call__(self, points: npt.ArrayLike) -> Floats:
        """Images (n, 3) of unit vectors (n, 3)."""
        up, down = _spinor(arrays.unit_vectors(points, "points"))
        return _from_spinor(self.matrix[0, 0] * up + self.matrix[0, 1] * down, self.matrix[1, 0] * up + self.matrix[1, 1] * down)

    def __matmul__(self, other: Moebius) -> Moebius:
        """The map that applies ``other`` first, then this one."""
        return Moebius(self.matrix @ other.matrix)

    @property
    def inverse(self) -> Moebius:
        """The map back."""
        (a, b), (c, d) = self.matrix
        return Moebius(np.array([[d, -b], [-c, a]]))

    @staticmethod
    def rotation(rotation: npt.ArrayLike) -> Moebius:
        """A rotation of the sphere, from its (3, 3) matrix.

        Raises
        ------
        InputError
            It is no rotation (orthogonal, determinant 1).
        """
        r = arrays.floats(rotation, "rotation", (3, 3))
        if np.abs(r @ r.T - np.eye(3)).max() > 1e-8 or np.linalg.det(r) < 0:
            raise InputError("rotation is not orthogonal with determinant 1")
        return Moebius.through(np.eye(3), r.T)

    @staticmethod
    def translation(center: npt.ArrayLike) -> Moebius:
        """The translation of hyperbolic space, seen on its boundary, that takes -center to the origin.

        Parameters
        ----------
        center : (3,) array
            Inside the unit ball.

        Raises
        ------
        InputError
            It is not inside the ball.
        """
        c = arrays.floats(center, "center", (3,))
        if not c @ c < 1:
            raise InputError(f"center has length {np.sqrt(c @ c):.6g}; it must lie inside the unit ball")
        # exp of half the rapidity along c, as a Hermitian matrix (a boost of spinors).
        length = float(np.sqrt(c @ c))
        direction = c / length if length > 0 else np.array([0.0, 0.0, 1.0])
        x, y, z = np.sinh(np.arctanh(length)) * direction
        plain = np.cosh(np.arctanh(length))
        return Moebius(np.array([[plain + z, x + 1j * y], [x - 1j * y, plain - z]]))

    @staticmethod
    def through(source: npt.ArrayLike, target: npt.ArrayLike) -> Moebius:
        """The map that takes three given points to three given points; there is exactly one.

        Parameters
        ----------
        source, target : (3, 3) array
            Three unit vectors each, in rows.

        Raises
        ------
        InputError
            Two of the points are the same.
        """
        to_base = []
        for points, name in ((source, "source"), (target, "target")):
            up, down = _spinor(arrays.unit_vectors(arrays.floats(points, name, (3, 3)), name))
            # In homogeneous coordinates: columns p, q scaled so that their sum is r.
            basis = np.array([up[:2], down[:2]])
            determinant = basis[0, 0] * basis[1, 1] - basis[0, 1] * basis[1, 0]
            scales = np.array([up[2] * basis[1, 1] - basis[0, 1] * down[2], basis[0, 0] * down[2] - up[2] * basis[1, 0]])
            if abs(determinant) < 1e-14 or np.abs(scales).min() < 1e-14:
                raise InputError(f"two of the points of {name} are the same")
            to_base.append(basis * (scales / determinant))
        return Moebius(to_base[1] @ np.linalg.inv(to_base[0]))

    @staticmethod
    def centering(points: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> Moebius:
        """The map that moves the weighted mean of the points to zero, without rotation (Baden, Crane and Kazhdan 2018).

        Parameters
        ----------
        points : (n, 3) array
            Unit vectors.
        weights : (n,) array, optional
            Positive.

        Raises
        ------
        InputError
            One point has half of all weight or more, so there is no such map.
        """
        p = arrays.unit_vectors(points, "points")
        w = np.ones(len(p)) if weights is None else arrays.floats(weights, "weights", (len(p),))
        if (w < 0).any() or not w.sum() > 0:
            raise InputError("weights must not be negative, and not all zero")
        if (w >= 0.5 * w.sum()).any():
            raise InputError(f"point {int(np.argmax(w))} has half of all weight or more, so no map centres the points")
        whole = Moebius(np.eye(2, dtype=np.complex128))
        steps, _ = centring_steps(p, w)
        for step in steps:
            whole = Moebius.translation(step) @ whole
        moved = whole(p)
        if np.linalg.norm(w @ moved) > 1e-6 * w.sum():
            raise NumericalError(f"the centring stopped at a mean of length {np.linalg.norm(w @ moved) / w.sum():.3g}")
        return whole


def _spinor(p: Floats) -> tuple[Complex, Complex]:
    """Homogeneous coordinates of z = (x + i y) / (1 - z): whichever of two forms has no cancellation."""
    upper = p[:, 2] > 0
    planar = p[:, 0] + 1j * p[:, 1]
    return np.where(upper, 1 + p[:, 2], planar), np.where(upper, planar.conj(), 1 - p[:, 2])


def _from_spinor(up: Complex, down: Complex) -> Floats:
    top, bottom = np.abs(up) ** 2, np.abs(down) ** 2
    planar = 2 * up * down.conj()
    p = np.column_stack([planar.real, planar.imag, top - bottom])
    found: Floats = p / np.sqrt((p * p).sum(1))[:, None]
    return found


def centring_steps(s: Floats, mass: Floats, most: int = 100) -> tuple[list[Floats], Floats]:
    """Translations whose product makes the mean, weighted by the mass, zero (Baden, Crane and Kazhdan 2018), and the centred points."""
    weights, s = mass / mass.sum(), np.ascontiguousarray(s)
    mean = np.einsum("i,ij->j", weights, s)
    best = float(np.linalg.norm(mean))
    steps: list[Floats] = []
    for _ in range(most):
        if best < 3e-16:
            break
        jacobian = 2 * (np.eye(3) - np.einsum("ij,ik->jk", s * weights[:, None], s))
        c = -np.linalg.solve(jacobian + 1e-14 * np.eye(3), mean)
        length = float(np.linalg.norm(c))
        c *= min(1.0, 0.75 / length) if length > 0 else 1.0
        for _ in range(30):
            moved, total = _core.moebius_translated(s, (float(c[0]), float(c[1]), float(c[2])), weights)
            mean_moved = np.array(total)
            size = float(np.linalg.norm(mean_moved))
            if size < best:
                break
            c /= 2
        else:
            break
        done = best < 1e-13 and size > 0.25 * best
        s, mean, best = moved, mean_moved, size
        steps.append(c)
        if done:
            break
    return steps, s


def centred(s: Floats, mass: Floats, most: int = 100) -> Floats:
    return centring_steps(s, mass, most)[1]
