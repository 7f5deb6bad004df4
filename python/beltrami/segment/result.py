"""The result of a segmentation."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import arrays
from ..arrays import Floats, Ints
from ..errors import InputError
from ..files import written
from ..results import save_result
from ..shapes import Shape
from ..view import Page, Picture, plot


@dataclass(frozen=True, eq=False, repr=False)
class SegmentationResult:
    """Regions of an image on a surface, and a bound on their distance from the optimum.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
    labels : ndarray (n,) of int32
        Region of each vertex. With two regions 1 is where ``phi > 1/2``, otherwise it is the largest of the memberships.
    phi : ndarray (n,), or (n, regions) for more than two
        Memberships, exactly from 0 to 1: the certified answer of the convex problem.
    means : ndarray (regions, channels)
        Area-weighted averages of the image over the labels, or those that were given.
    areas : ndarray (regions,)
        Area of each label, in squared units of length; they sum to the area of the shape.
    contours : list of ndarray (k, D)
        Polylines on the surface where phi is 1/2 (where a region's membership passes the others'), the greater side to the left;
        closed ones repeat their first point.
    contour_length : float
        Their total length; a boundary between two of many regions is counted once.
    primal, dual, gap : float
        Energy of the answer, a lower bound for all memberships, and ``(primal - dual) / |primal|``, for a surface of unit area.
    threshold_energy, excess : float
        Energy of the labels themselves (memberships 0 and 1), and ``(threshold_energy - dual) / |primal|``. With ``tv="edge"`` the
        excess tends to zero; with isotropic total variation a percent is usual, because triangles make the labels' outline jagged.
    dual_field : ndarray (m, D), (m, regions, D) for more than two, or (edges,) for ``tv="edge"``
        Tangent vectors of length at most 1 (1/2 for more than two regions) that prove the bound. On intrinsic triangulations in frames.
    fidelity : float
        The fidelity that was used.
    iterations : int
        Number of iterations.
    converged : bool
        Whether the gap reached the tolerance.
    history : dict of str to ndarray
        ``iteration``, ``primal``, ``dual``, ``gap`` at each certificate.
    """

    shape: Shape
    labels: Ints
    phi: Floats
    means: Floats
    areas: Floats
    contours: list[Floats]
    contour_length: float
    primal: float
    dual: float
    gap: float
    threshold_energy: float
    excess: float
    dual_field: Floats
    fidelity: float
    iterations: int
    converged: bool
    history: dict[str, npt.NDArray[Any]]

    def __repr__(self) -> str:
        state = "" if self.converged else ", NOT CONVERGED"
        return f"SegmentationResult({len(self.means)} regions, gap {self.gap:.1e} after {self.iterations} iterations{state})"

    @property
    def notes(self) -> tuple[str, ...]:
        """What was noticed: regions that are empty, because no part of the image is worth its boundary at this fidelity."""
        empty = np.flatnonzero(self.areas == 0)
        if not len(empty):
            return ()
        which = f"region {empty[0]} is" if len(empty) == 1 else f"regions {', '.join(map(str, empty))} are"
        return (
            f"{which} empty: at fidelity {self.fidelity:.4g} a boundary costs more than the image gains by it; try {4 * self.fidelity:.4g}",
        )

    def plot(self, image: Any = None, *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints the labels (or an image) with the contours over them; the options are those of :func:`beltrami.plot`."""
        drawn = {"lines": self.contours or None, **options}
        return plot(self.shape, self.labels if image is None else image, path=path, **drawn)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes everything to ``.npz``; the shape with labels and memberships to ``.ply``; a picture to ``.png`` or ``.html``;
        the contours to ``.obj`` (lines), or to ``.csv`` (line, closed, coordinates). :meth:`save_contours` writes them to ``.ply``.
        """
        kinds = {".obj": self.save_contours, ".csv": self.save_contours}
        return save_result(self, path, "a segmentation is", kinds, values=("labels", "phi"))

    def save_contours(self, path: str | os.PathLike[str]) -> Path:
        """Writes the contours: ``.obj`` with lines, ``.ply`` with vertices and edges, ``.csv`` with a point a row."""
        path = arrays.file(path, "path")
        suffix = path.suffix.lower()
        points, number = _stack(self), 0
        if suffix in (".obj", ".ply") and points.shape[1] > 3:
            raise InputError(f"{path}: {suffix} holds points of R^3, these lie in R^{points.shape[1]}; write .csv")
        out: list[str] = []
        if suffix == ".csv":
            out.append(",".join(["line", "closed", *(f"x{axis}" for axis in range(points.shape[1]))]))
            for at, line in enumerate(self.contours):
                closed = int(np.array_equal(line[0], line[-1]))
                out += [",".join([str(at), str(closed), *map(repr, row)]) for row in line.tolist()]
        elif suffix == ".obj":
            spatial = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
            out += [f"v {x!r} {y!r} {z!r}" for x, y, z in spatial.tolist()]
            for line in self.contours:
                out.append("l " + " ".join(str(number + k + 1) for k in range(len(line))))
                number += len(line)
        elif suffix == ".ply":
            spatial = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
            edges = len(points) - len(self.contours)
            out += ["ply", "format ascii 1.0", f"element vertex {len(points)}", *(f"property double {axis}" for axis in "xyz")]
            out += [f"element edge {edges}", "property int vertex1", "property int vertex2", "end_header"]
            out += [f"{x!r} {y!r} {z!r}" for x, y, z in spatial.tolist()]
            for line in self.contours:
                out += [f"{number + k} {number + k + 1}" for k in range(len(line) - 1)]
                number += len(line)
        else:
            raise InputError(f"{path}: contours are written to .obj, .ply or .csv")
        written(path, lambda stream: stream.write(("\n".join(out) + "\n").encode()))
        return path


def _stack(result: SegmentationResult) -> Floats:
    return np.concatenate([result.shape.coordinates[:0], *result.contours])
