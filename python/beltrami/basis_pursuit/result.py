"""The result of a conformal registration."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Floats
from ..errors import InputError
from ..files import written
from ..results import save_result
from ..shapes import Shape
from ..view import Page, Picture, plot
from .surface import Indices


@dataclass(frozen=True, eq=False, repr=False)
class ConformalRegistrationResult:
    """A map between two shapes with the conformal factor and the bases that belong to it.

    Attributes
    ----------
    source, target : TriangleMesh or PointCloud
    point_map : ndarray (n_source,) of int64
        The vertex of the target for each vertex of the source.
    inverse_map : ndarray (n_target,) of int64
        The vertex of the source for each vertex of the target.
    log_factor : ndarray (n_target,)
        η = log w²: ``exp(η)`` times the target's mass is the source's; it adds up to the source's area.
    source_basis : ndarray (n_source, N)
        Φ: eigenfunctions of the source, orthonormal under its mass.
    basis : ndarray (n_target, N)
        Ψ: orthonormal under ``exp(η) m``; its rows are close to those of Φ where the map is correct.
    values : ndarray (N,)
        Eigenvalues of Φ.
    orthonormality_error : float
        Greatest entry of ``Ψ^T diag(exp(η) m) Ψ - I``.
    objective : float
        Equation 8.34 at the end, for shapes of unit area, with the smoothing of η.
    history : dict of str to ndarray
        ``objective`` after each block of the alternation and its ``level`` (size of the basis); it never rises within a level.
    roughness : dict of str to float
        Dirichlet energy of the factor, in both directions, of each map that was tried; the map with the least was chosen.
    landmarks : ndarray (k, 2) of int64
        The landmarks that were given and those that were found.
    coverage : float
        Share of the target's area that the point map reaches.
    confidence : ndarray (n_source,)
        From 0 to 1: exp(-d / 0.05), d the distance from a vertex to where the two maps take it, there and back, over sqrt(area).
    consistency : float
        Mean of d.
    start : str
        Which map was chosen.
    iterations : int
        Blocks of the alternation.
    converged : bool
        Whether the last level ended because nothing changed anymore.
    notes : tuple of str
        Remarks on the input and the answer.
    """

    source: Shape
    target: Shape
    point_map: Indices
    inverse_map: Indices
    log_factor: Floats
    source_basis: Floats
    basis: Floats
    values: Floats
    orthonormality_error: float
    objective: float
    history: dict[str, npt.NDArray[Any]]
    roughness: dict[str, float]
    landmarks: Indices
    coverage: float
    confidence: Floats
    consistency: float
    start: str
    iterations: int
    converged: bool
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        low, high = self.log_factor.min(), self.log_factor.max()
        return (
            f"ConformalRegistrationResult({len(self.point_map)} to {len(self.inverse_map)} vertices, {self.start}, coverage "
            f"{self.coverage:.0%}, log factor {low:.2f} to {high:.2f})"
        )

    def pull_back(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """Values (n_target,) or (n_target, c) of the target, at the source's vertices."""
        given = np.asarray(values)
        if given.shape[:1] != self.inverse_map.shape:
            raise InputError(f"values has {given.shape[:1]} rows, the target has {len(self.inverse_map)} vertices")
        return given[self.point_map]

    def push_forward(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """Values (n_source,) or (n_source, c) of the source, at the target's vertices."""
        given = np.asarray(values)
        if given.shape[:1] != self.point_map.shape:
            raise InputError(f"values has {given.shape[:1]} rows, the source has {len(self.point_map)} vertices")
        return given[self.inverse_map]

    def plot(self, values: Any = "log_factor", *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints the target.

        Parameters
        ----------
        values : str or array_like
            ``"log_factor"``; or values at the source's vertices, which the map brings over.
        path, **options
            As for :func:`beltrami.plot`.
        """
        if isinstance(values, str):
            if values != "log_factor":
                raise InputError(f"values is {values!r}; choose 'log_factor', or give an array of the source's vertices")
            most = float(np.abs(self.log_factor - np.median(self.log_factor)).max()) or 1.0
            middle = float(np.median(self.log_factor))
            return plot(self.target, self.log_factor, path=path, **{"label": "log w²", "limits": (middle - most, middle + most), **options})
        return plot(self.target, self.push_forward(values), path=path, **options)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``, the point map to ``.csv`` (source, target, confidence), a picture to ``.png`` or ``.html``."""
        return save_result(self, path, "a registration is", {".csv": self._save_map})

    def _save_map(self, path: Path) -> Path:
        rows = np.column_stack([np.arange(len(self.point_map)), self.point_map, self.confidence])
        look = {"delimiter": ",", "header": "source,target,confidence", "comments": ""}
        return written(path, lambda stream: np.savetxt(stream, rows, fmt=["%d", "%d", "%.6g"], **look))
