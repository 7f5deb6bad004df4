"""The result of a registration."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import Floats, Ints
from ..errors import InputError
from ..files import written
from ..maps import transfer
from ..results import save_result
from ..shapes import PointCloud, Shape, TriangleMesh
from ..view import Page, Picture, plot
from .candidates import RegistrationCandidate


@dataclass(frozen=True, eq=False, repr=False)
class RegistrationResult:
    """What :func:`register` found.

    Attributes
    ----------
    point_map : (n_source,) int32 array
        Index in the target of each source point.
    inverse_map : (n_target,) int32 array
        Index in the source of each target point. Not exactly the inverse: maps need not be one to one.
    functional_map : (k, k) array
        Orthogonal, between the eigenfunctions of both shapes scaled to unit area, the constant first:
        ``source_functions @ functional_map`` is close to ``target_functions[point_map]``.
    rotation : (n, n) array
        Of the eigenmaps ``λ_k^(-d/4) φ_k``, k = 1 ... n: orthogonal, the source's rows times it are close to the target's.
    distance : float
        The rotation-invariant sliced Wasserstein distance of the eigenmaps at this rotation; no unit.
    candidates : tuple of RegistrationCandidate
        All candidates that were fully refined, best first; the first one led to the answer.
    coverage : float
        Share of the target's area at points that are images.
    bijectivity : float
        Mean distance, divided by the square root of the area, between a source point and where the map and the map back take it.
    orientation : float
        Agreement of oriented triple products, at most 1; 0 if a shape has no orientation.
    mirror_decided : bool
        Whether orientation told left and right apart. A cloud has one if it samples a closed surface in R^3. False for other clouds and
        for faces that cannot be oriented: look at ``candidates``.
    extrinsic : bool
        Whether positions in R^3 were used (curvature, rigid deformation), and not only what bending preserves.
    positions : (n_source, 3) array or None
        The source deformed onto the target, in its position and size; None if not extrinsic.
    history : dict of str to array
        ``"levels"``: orders of the functional map; with ``method="rswd"`` also ``"distance"`` at each.
    notes : tuple of str
        Remarks on the input and the answer.
    source, target : TriangleMesh or PointCloud
    source_masses : (n_source,) array
        Shares of the source's area.
    """

    point_map: Ints
    inverse_map: Ints
    functional_map: Floats
    rotation: Floats
    distance: float
    candidates: tuple[RegistrationCandidate, ...]
    coverage: float
    bijectivity: float
    orientation: float
    mirror_decided: bool
    extrinsic: bool
    positions: Floats | None
    history: dict[str, Floats]
    notes: tuple[str, ...]
    source: Shape
    target: Shape
    source_masses: Floats

    def __repr__(self) -> str:
        side = "" if self.mirror_decided else ", left and right NOT told apart"
        return (
            f"RegistrationResult({len(self.point_map)} -> {len(self.inverse_map)} points, coverage {self.coverage:.0%}, "
            f"bijectivity {self.bijectivity:.4f}, {len(self.candidates)} candidates{side})"
        )

    def transfer(self, values: npt.ArrayLike, *, direction: Literal["to_source", "to_target"] = "to_source") -> npt.NDArray[Any]:
        """Carries values, colours or labels from one shape to the other; see :func:`beltrami.transfer`."""
        if direction == "to_source":
            count = len(self.target.coordinates)
            if np.ndim(values) and len(np.asarray(values)) != count:
                raise InputError(f"values has {len(np.asarray(values))} rows; the target has {count} points")
            return transfer(self.point_map, values)
        return transfer(self.point_map, values, direction=direction, target=self.target, weights=self.source_masses)

    def plot(self, values: Any = None, *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints source and target side by side, matching points in the same colour.

        Parameters
        ----------
        values : array, optional
            Numbers, labels or colours at the target's points; if left out, colours that tell places of the target apart.
        path, **options
            As for :func:`beltrami.plot`.
        """
        shape, colours = self.side_by_side(values)
        return plot(shape, colours, path=path, **{"views": ["front"], **options})

    def side_by_side(self, values: Any = None) -> tuple[Shape, npt.NDArray[Any]]:
        """Source and target as one shape, the source brought to the target's size, and the values of both: those of :meth:`plot`."""
        places = [self.source.coordinates, self.target.coordinates]
        if places[0].shape[1] != places[1].shape[1]:
            raise InputError(f"the source lies in R^{places[0].shape[1]}, the target in R^{places[1].shape[1]}: plot them one by one")
        if values is None:
            values = (places[1] - places[1].min(0)) / np.maximum(np.ptp(places[1], axis=0), 1e-300)
            values = 0.1 + 0.8 * np.pad(values[:, :3], ((0, 0), (0, max(0, 3 - values.shape[1]))), constant_values=0.5)
        table = np.asarray(values)
        joined = np.concatenate([self.transfer(table), table])
        scale = float(np.ptp(places[1], axis=0).max() / max(np.ptp(places[0], axis=0).max(), 1e-300))
        first = scale * (places[0] - places[0].mean(0))
        second = places[1] - places[1].mean(0)
        second[:, 0] += first[:, 0].max() - second[:, 0].min() + 0.1 * max(np.ptp(first[:, 0]), np.ptp(second[:, 0]))
        if isinstance(self.source, TriangleMesh) and isinstance(self.target, TriangleMesh):
            faces = np.concatenate([self.source.faces, self.target.faces + np.int32(len(first))])
            return TriangleMesh(np.concatenate([first, second]), faces), joined
        return PointCloud(np.concatenate([first, second]), dimension=2), joined

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``, the point map to ``.csv`` (source, target), a picture to ``.png`` or ``.html``."""
        return save_result(self, path, "a registration is", {".csv": self._save_map})

    def _save_map(self, path: Path) -> Path:
        rows = np.column_stack([np.arange(len(self.point_map)), self.point_map])
        return written(path, lambda stream: np.savetxt(stream, rows, fmt="%d", delimiter=",", header="source,target", comments=""))


def twins(candidates: list[RegistrationCandidate]) -> str:
    """Says it where another candidate is as good as the best but for a tenth."""
    close = [k for k, other in enumerate(candidates[1:], 1) if other.energy < 1.1 * candidates[0].energy]
    if not close:
        return ""
    energies = ", ".join(f"{candidates[k].energy:.4g}" for k in close)
    return f"; candidates {', '.join(map(str, close))} with energies {energies} nearly tie with the first ({candidates[0].energy:.4g})"
