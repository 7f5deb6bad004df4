"""Maps of meshes: their requirements, filled holes, the iteration, the repair."""

from __future__ import annotations

import numpy as np

from ..arrays import Floats
from ..errors import InputError, NumericalError, TopologyError
from ..operators import operators
from ..shapes import TriangleMesh
from .iterations import Task, Trace
from .moebius import centred
from .repair import repair
from .result import SphericalMapResult, certified
from .surface import Faces, Surface, row_crosses, scaled

CENTRED = 1e-12  # how far from the origin the centre may be


def _sphere_mesh(mesh: TriangleMesh) -> Faces:
    """The faces of a closed, connected, orientable mesh of genus 0, oriented consistently; or an error that says what it is instead."""
    n, euler = len(mesh.vertices), mesh.euler_characteristic
    facts = f"it has Euler characteristic {euler}"
    used = np.zeros(n, bool)
    used[mesh.faces.ravel()] = True
    if len(mesh.faces) == 0:
        raise TopologyError("the mesh has no triangles; a closed surface of genus 0 is needed")
    if not mesh.is_manifold:
        raise TopologyError(f"the mesh is not manifold: {mesh._topology.non_manifold}; {facts}, a sphere has 2. Repair it first")
    if mesh.components > 1:
        raise TopologyError(f"the mesh has {mesh.components} components; {facts}, a sphere has 2. Take mesh.largest_component()")
    if not mesh.is_closed:
        loops = mesh.boundary_loops
        holes = "hole" if loops == 1 else "holes"
        raise TopologyError(
            f"the mesh is not closed: {loops} {holes}; {facts}, a sphere has 2. fill_holes=True closes what is open for the map"
        )
    if euler != 2 or not mesh.is_orientable:
        what = f"genus {mesh.genus}" if mesh.is_orientable else "only one side"
        raise TopologyError(f"the mesh has {what}; {facts}, a sphere has 2. Only surfaces of genus 0 map to the sphere one to one")
    if not used.all():
        raise InputError(f"vertex {int(np.flatnonzero(~used)[0])} belongs to no triangle; remove it (mesh.largest_component() does)")
    oriented = mesh if mesh.is_oriented else mesh.oriented()
    return oriented.faces.astype(np.int64)


def _filled(mesh: TriangleMesh) -> tuple[Floats, Faces]:
    """The mesh with a cap on each boundary loop: rings that shrink to the loop's centre, and a fan. The mesh's own come first."""
    vertices, faces = [mesh.vertices], [mesh.faces.astype(np.int64)]
    count = len(mesh.vertices)
    heads = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]).astype(np.int64)
    directed = set((heads[:, 0] * count + heads[:, 1]).tolist())
    for loop in mesh.boundary_loop_vertices:
        ring = np.asarray(loop, np.int64)
        if int(ring[0]) * count + int(ring[1]) in directed:
            ring = ring[::-1]  # the cap runs against the triangles beside it
        corners = mesh.vertices[ring]
        centre, k = corners.mean(0), len(ring)
        ratio = 1 - 2 * np.pi / max(k, 12)  # triangles about as high as wide
        share, next_index = 1.0, count + sum(len(v) for v in vertices[1:])
        while k > 12 and share * ratio > 12 / k and share > 0.02:
            share *= ratio
            inner = np.arange(next_index, next_index + k)
            vertices.append(centre + share * (corners - centre))
            a, b, c, d = ring, np.roll(ring, -1), inner, np.roll(inner, -1)
            faces += [np.stack([a, b, d], 1), np.stack([a, d, c], 1)]
            ring, next_index = inner, next_index + k
        vertices.append(centre[None])
        faces.append(np.stack([ring, np.roll(ring, -1), np.full(k, next_index)], 1))
    return np.concatenate(vertices), np.concatenate(faces)


def _repaired(surface: Surface, s: Floats, task: Task) -> Floats:
    """Without flips as far as can be, and centred: which rounds anew, and may turn over what is 1e-11 of the sphere and thin."""

    def told(share: float) -> None:
        task.report(0.9 + 0.1 * share)

    s = centred(repair(surface, s, 8, told), surface.mass)
    again = repair(surface, s, 2, told)
    moved = surface.mass @ again / surface.mass.sum()
    return again if np.abs(moved).max() <= CENTRED and surface.flipped(again).sum() < surface.flipped(s).sum() else s


def map_mesh(mesh: TriangleMesh, fill: bool, task: Task) -> SphericalMapResult:
    notes: list[str] = []
    source = mesh if mesh.is_oriented or not mesh.is_orientable or not mesh.is_manifold else mesh.oriented()
    whole = source
    if fill and mesh.is_manifold and mesh.boundary_loops:
        points, triangles = _filled(source)
        whole = TriangleMesh(points, triangles.astype(np.int32))
        notes.append(f"{mesh.boundary_loops} hole{'s were' if mesh.boundary_loops > 1 else ' was'} filled for the map")
    faces = _sphere_mesh(whole)
    vertices, size = scaled(whole.vertices)
    if vertices.shape[1] == 3:
        p = vertices[faces[:, 0]]
        volume = float(np.einsum("ij,ij->", p, row_crosses(vertices[faces[:, 1]], vertices[faces[:, 2]])))
        if volume < 0:
            faces = np.ascontiguousarray(faces[:, [0, 2, 1]])
    surface = Surface(vertices, faces)
    work = TriangleMesh(vertices, faces.astype(np.int32))
    found: list[tuple[Floats, Trace]] = []
    regular = False
    try:
        found.append(task.iterate(surface, operators(work, laplacian="cotangent").stiffness))
    except (InputError, NumericalError) as error:
        notes.append(f"cotangents cannot be used ({error}); intrinsic Delaunay weights instead")
        surface.regularize()
        regular = True
    if not found or surface.flipped(found[0][0]).sum() > 0.01 * len(faces):
        found.append(task.iterate(surface, operators(work, laplacian="intrinsic_delaunay").stiffness, energy_only=True))
        if len(found) == 2:
            notes.append("more than 1 % of the triangles were flipped, so the map was made again with intrinsic Delaunay weights")
    s, trace = min(found, key=lambda one: int(surface.flipped(one[0]).sum()))
    before = int(surface.flipped(s).sum())
    if before:
        energy, area = surface.energy_and_area(s)
        s = _repaired(surface, s, task)
        excess, after = energy - area, float(np.subtract(*surface.energy_and_area(s)))
        heavy = ", at the price of larger changes of angle there" if after > 1.2 * excess + 1e-3 else ""
        gone = before - int(surface.flipped(s).sum())
        notes.append(f"{gone} of {before} flipped triangles were repaired: E - A {excess:.4g} before, {after:.4g} after{heavy}")
    if whole is not source:
        own = surface.faces[: len(mesh.faces)]
        surface = Surface(vertices[: len(mesh.vertices)], own)
        if not surface.mass.sum() > 0:
            raise InputError("no triangle of the surface has an area: only the holes that were filled have; give another shape")
        if regular:
            surface.regularize()
        s = centred(s[: len(mesh.vertices)], surface.mass)
    task.report(1.0)
    return certified(mesh, surface, s, size, trace, tuple(notes))
