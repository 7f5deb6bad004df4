"""Maps of clouds: with the simplices of their stars, then with those of the stars of their images; and the check of the genus."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import numpy.typing as npt
import scipy

from .. import _core, arrays
from ..arrays import Floats
from ..clouds import CloudOperators
from ..errors import InputError, TopologyError
from ..operators import Operators, operators
from ..shapes import PointCloud
from . import genus
from .iterations import Task, Trace
from .moebius import centred
from .result import SphericalMapResult, certified
from .surface import Faces, Surface, corner_angles, corner_cotangents, determinants, row_crosses, row_lengths, row_products, scaled


def map_cloud(cloud: PointCloud, given: Operators | None, check: bool, task: Task) -> SphericalMapResult:
    if cloud.dimension != 2:
        raise InputError(f"the cloud has dimension {cloud.dimension}; a surface (dimension 2) is needed")
    ops = given if isinstance(given, CloudOperators) else operators(cloud)
    if not isinstance(ops, CloudOperators):
        raise InputError("these operators have no simplices; bt.operators(cloud) makes them")
    components = int(ops.component_labels.max()) + 1
    faces = ops.simplices.astype(np.int64)
    facts = f"the triangles that all their corners' stars hold have Euler characteristic {_euler(faces[ops.votes == 3])}, a sphere has 2"
    if components > 1:
        raise TopologyError(f"the cloud falls into {components} components; {facts}. Map each alone")
    vertices, size = scaled(cloud.points)
    surface = Surface(vertices, faces, ops.votes / 3.0)
    s, trace = task.iterate(surface, ops.stiffness)
    notes = ops.notes
    if check:
        covered = float(np.abs(_solid_angles(s, faces)) @ ops.votes) / (12 * np.pi)
        agreed = float((ops.votes == 3).mean())
        findings = genus.Findings(covered, genus.mixed_share(s, faces), genus.bare_share(s), genus.largest_ring(ops), agreed)
        notes += findings.checked(ops, facts)
    surface, s, trace = _with_stars_of_the_image(ops, surface, s, trace, task)
    # Each simplex is oriented as its image is; the volume within tells inside from outside.
    faces, votes = surface.faces, np.rint(3 * surface.weights) if surface.weights is not None else np.zeros(0)
    turned = np.where(determinants(s, faces) < 0, -1.0, 1.0)
    if vertices.shape[1] == 3:
        p, q, r = (vertices[faces[:, k]] for k in range(3))
        if float((turned * votes * row_products(p, row_crosses(q, r))).sum()) < 0:
            s = centred(s * [1.0, 1.0, -1.0], surface.mass)
            turned = -turned
    wrong = _folded(ops, faces, votes, turned)
    task.report(1.0)
    return certified(cloud, surface, s, size, trace, notes, wrong)


_Star = tuple[Faces, npt.NDArray[np.bool_]]


def _with_stars_of_the_image(ops: CloudOperators, surface: Surface, s: Floats, trace: Trace, task: Task) -> tuple[Surface, Floats, Trace]:
    """The map of a cloud again, with the Delaunay stars of the images in place of those of the points.

    Where sheets are nearer to each other than the points, stars in space join them; their images lie far apart. A conformal map keeps
    Delaunay triangles, so the stars of the images are those of the surface, if the map is nearly right there. Points whose star of
    images reaches far in the cloud keep their own star. A pass is kept if it lowers the mean change of angle in the images' triangles.
    """
    n, points = surface.count, surface.vertices
    own: _Star = surface.faces, ops.held
    mass = surface.mass
    spacing = ops.point_spacing * float(np.sqrt(mass.sum() / ops.mass.sum()))
    stars, error, grown = _image_stars(s, points, mass)
    for _ in range(PASSES):
        if stars is None:
            break
        faces, held = stars
        far = ~(_circumradii(points, faces) <= 20 * np.median(spacing[faces], axis=1))
        if grown > 1.05:  # the images of several sheets are mixed: triangles between them
            near = genus.within_edges(own[0], n, 3, np.arange(n), faces, faces[:, [1, 2, 0]])
            far |= ~near.all(1)
        unfit = np.bincount(faces[held & far[:, None]], minlength=n) > 0
        unfit |= np.bincount(faces[held], minlength=n) == 0
        both = np.concatenate([faces, own[0]])
        counts = np.concatenate([(held & ~unfit[faces]).sum(1), (own[1] & unfit[own[0]]).sum(1)])
        both, place = np.unique(both, axis=0, return_inverse=True)
        votes = np.bincount(place.ravel(), counts).astype(np.uint8)
        both, votes = both[votes > 0], votes[votes > 0]
        trial = Surface(points, both, votes / 3.0)
        trial.mass = mass
        stiffness = arrays.csr_out(_core.local_stiffness((points, both.astype(np.int32), votes, None)), (n, n))
        if scipy.sparse.csgraph.connected_components(stiffness, directed=False)[0] > 1:
            break
        moved, steps = task.onward(trial, stiffness, s)
        found = _image_stars(moved, points, mass)
        if not found[1] < error:
            break
        done = found[1] > 0.98 * error
        stars, error, grown = found
        surface, s = trial, moved
        trace = Trace(trace.move + steps.move, trace.excess + steps.excess, steps.converged)
        if done:
            break
    return surface, s, trace


PASSES = 4


def _image_stars(s: Floats, points: Floats, mass: Floats) -> tuple[_Star | None, float, float]:
    """Simplices of the images' local mesh and which corners' stars hold them; mean change of angle, and their area over the cloud's."""
    try:
        ops = cast(CloudOperators, operators(PointCloud(s, dimension=2)))
        faces, held = ops.simplices.astype(np.int64), ops.held
    except InputError:  # images that round to one place
        return None, np.inf, np.inf
    weights = ops.votes / 3.0
    change = np.abs(corner_angles(s, faces) - corner_angles(points, faces)).mean(1)
    area = float(corner_cotangents(points, faces)[1] @ weights)
    return (faces, held), float(change @ weights / weights.sum()), area / float(mass.sum())


def _circumradii(vertices: Floats, faces: Faces) -> Floats:
    p, q, r = (vertices[faces[:, k]] for k in range(3))
    product = row_lengths(q - r) * row_lengths(r - p) * row_lengths(p - q)
    with np.errstate(divide="ignore", invalid="ignore"):
        found: Floats = product / (4 * corner_cotangents(vertices, faces)[1])
    return found


def _euler(faces: Faces) -> int:
    """Vertices less edges plus triangles."""
    if len(faces) == 0:
        return 0
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    keys = pairs[:, 0] * (int(faces.max()) + 1) + pairs[:, 1]
    return len(np.unique(faces)) - len(np.unique(keys)) + len(faces)


def _solid_angles(s: Floats, faces: Faces) -> Floats:
    p, q, r = (s[faces[:, k]] for k in range(3))
    found: Floats = 2 * np.arctan2(determinants(s, faces), 1 + row_products(p, q) + row_products(q, r) + row_products(r, p))
    return found


def _folded(ops: Any, faces: Faces, counts: Floats, turned: Floats) -> npt.NDArray[np.bool_]:
    """Simplices, of those that all three stars hold, whose image is turned against most of its neighbours' around each corner."""
    frames, points = ops.frames, ops.shape.points
    against = np.zeros((len(faces), 3))
    for k in range(3):
        corner = faces[:, k]
        e = [points[faces[:, (k + j) % 3]] - points[corner] for j in (1, 2)]
        a, b = (np.einsum("tdj,tj->td", frames[corner], one) for one in e)
        against[:, k] = np.sign(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * turned
    sense = np.sign(np.bincount(faces.ravel(), against.ravel(), len(points)))
    votes = (against * sense[faces] < 0).sum(1)
    found: npt.NDArray[np.bool_] = (counts == 3) & (votes >= 2)
    return found
