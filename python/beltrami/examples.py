"""Example shapes: two that come with the package, and a cortex from the data of the nilearn package."""

from __future__ import annotations

from importlib import resources
from typing import Literal

import numpy as np

from .errors import DependencyError
from .files import load
from .shapes import TriangleMesh

__all__ = ["bob", "cortex", "spot"]


def _shipped(name: str) -> TriangleMesh:
    with resources.as_file(resources.files("beltrami").joinpath("examples_data", name)) as path:
        mesh = load(path)
    if not isinstance(mesh, TriangleMesh):  # the package's own files are meshes
        raise TypeError(name)
    return mesh


def spot() -> TriangleMesh:
    """Spot, a cow of 2,930 vertices, closed, genus 0, facing -z with y upwards; ``data["colors"]`` is its texture (Keenan Crane, CC0).

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.examples.spot()
    TriangleMesh(2930 vertices in R^3, 5856 faces)
    """
    return _shipped("spot.ply.gz")


def bob() -> TriangleMesh:
    """Bob, a swim ring with a duck's head, 334 vertices, closed, genus 1 (Keenan Crane, CC0).

    Examples
    --------
    >>> import beltrami as bt
    >>> bt.examples.bob().genus
    1
    """
    return _shipped("bob.ply.gz")


def cortex(
    surface: Literal["pial", "white", "infl", "sphere", "flat"] = "pial", *, hemisphere: Literal["left", "right"] = "left"
) -> TriangleMesh:
    """A hemisphere of the human cortex: FreeSurfer's average ``fsaverage5``, 10,242 vertices, from nilearn's package data (no network).

    ``data`` holds ``depth`` (sulcal depth), ``curvature`` and ``thickness`` (mm); coordinates are in mm, x to the right, y to the front, z
    upwards.

    Raises
    ------
    DependencyError
        nilearn or nibabel is missing (``pip install 'beltrami[examples]'``).
    """
    try:
        import nibabel

        folder = resources.files("nilearn").joinpath("datasets", "data", "fsaverage5")
    except ImportError as error:
        raise DependencyError(f"{error.name} is missing; pip install 'beltrami[examples]'") from None
    data = {}
    with resources.as_file(folder) as place:
        mesh = load(place / f"{surface}_{hemisphere}.gii.gz")
        for name, file in (("depth", "sulc"), ("curvature", "curv"), ("thickness", "thick")):
            values = nibabel.load(place / f"{file}_{hemisphere}.gii.gz").darrays[0].data
            data[name] = np.asarray(values, np.float64)
    if not isinstance(mesh, TriangleMesh):
        raise DependencyError(f"nilearn's {surface}_{hemisphere}.gii.gz holds no triangles; pip install --upgrade nilearn")
    return TriangleMesh(mesh.vertices, mesh.faces, data=data)
