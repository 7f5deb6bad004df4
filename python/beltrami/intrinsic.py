"""Operators on intrinsic triangulations: for triangles too thin for cotangents, and for meshes that are not surfaces.

The intrinsic Delaunay triangulation joins the vertices of a mesh by geodesic edges on the same surface, chosen so that all
weights are of one sign; the tufted cover makes a surface of any mesh by taking each triangle twice.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import scipy

from . import _core, arrays
from .arrays import Floats, Ints
from .operators import Operators
from .progress import Progress, reporter
from .shapes import TriangleMesh

Thin = 1e-6  # twice the area over the longest edge's square, below which "auto" leaves cotangents: angles of a millionth


@dataclass(frozen=True, eq=False)
class IntrinsicTriangulation:
    """Triangles known by their edge lengths and their gluing; the vertices are those of the mesh.

    Attributes
    ----------
    faces : ndarray (m, 3) of int32
        Vertices of each triangle. A triangle can name a vertex twice, and two triangles can share two edges.
    twins : ndarray (m, 3) of int32
        Half-edge ``3 f + k`` runs from corner k of triangle f to the next; ``twins[f, k]`` is the one it is glued to, -1 at the boundary.
    lengths : ndarray (m, 3)
        Length of each half-edge.
    areas : ndarray (m,)
        Area that each triangle counts for; in a cover half of its own. They sum to the area of the surface.
    is_cover : bool
        Every triangle of the mesh is there twice (the tufted cover).
    flips, mollified, left_out : int
        Edges flipped; edges lengthened because a triangle was degenerate; faces that name a vertex twice, which are left out.
    """

    faces: Ints
    twins: Ints
    lengths: Floats
    areas: Floats
    is_cover: bool
    flips: int
    mollified: int
    left_out: int

    def __repr__(self) -> str:
        return f"IntrinsicTriangulation({len(self.faces)} triangles, {self.flips} edges flipped)"


@dataclass(frozen=True, eq=False, repr=False)
class IntrinsicOperators(Operators):
    """Operators on an intrinsic triangulation: ``triangulation`` has its triangles, m of them.

    Vector fields have two coordinates per triangle, (m, 2), in the frame whose first axis runs from its corner 0 to its corner 1.
    """

    shape: TriangleMesh
    triangulation: IntrinsicTriangulation = field(kw_only=True)

    @property
    def _arrays(self) -> tuple[int, Ints, Ints, Floats, bool]:
        found = self.triangulation
        return len(self.mass), found.faces, found.twins, found.lengths, found.is_cover

    @cached_property
    def gradient(self) -> scipy.sparse.csr_array:
        """G, (2 m, n): ``(G @ f).reshape(m, 2)`` has the gradient of ``f`` in the frame of each triangle."""
        return arrays.csr_out(_core.intrinsic_gradient(self._arrays), (2 * len(self.triangulation.faces), len(self.mass)))

    @cached_property
    def divergence(self) -> scipy.sparse.csr_array:
        """(n, 2 m): ``-diag(mass)^-1 G^T diag(area)``; empty rows where the mass is 0."""
        return arrays.csr_out(_core.intrinsic_divergence(self._arrays, self.mass), (len(self.mass), 2 * len(self.triangulation.faces)))

    @property
    def element_areas(self) -> Floats:
        """(m,): areas that the triangles count for."""
        return self.triangulation.areas


def build(
    mesh: TriangleMesh, kind: Literal["intrinsic_delaunay", "tufted"], *, voronoi: bool, progress: Progress, notes: tuple[str, ...] = ()
) -> IntrinsicOperators:
    """The operators of a mesh; :func:`beltrami.operators` is the door."""
    cover = kind == "tufted"
    parts, mass, tables, spacing, counts = _core.intrinsic_operators((mesh.vertices, mesh.faces), cover, voronoi, reporter(progress))
    flips, mollified, left_out = counts
    for array in (mass, *tables):
        array.flags.writeable = False
    for count, what in (
        (left_out, "faces name a vertex twice and are left out"),
        (mollified, "edges were lengthened a little because a triangle was degenerate (Sharp and Crane 2020)"),
        (flips, "edges were flipped"),
    ):
        if count:
            notes += (f"{count} {what}",)
    triangulation = IntrinsicTriangulation(*tables, is_cover=cover, flips=flips, mollified=mollified, left_out=left_out)
    n = len(mass)
    return IntrinsicOperators(mesh, kind, arrays.csr_out(parts, (n, n)), mass, spacing, notes=notes, triangulation=triangulation)


def choose(mesh: TriangleMesh) -> tuple[Literal["cotangent", "intrinsic_delaunay", "tufted"], tuple[str, ...]]:
    """What ``laplacian="auto"`` takes, and why: cotangents unless a triangle is too thin for them."""
    thinnest: Any = _core.thinnest_face((mesh.vertices, mesh.faces))
    if thinnest is None or thinnest[1] > Thin:
        return "cotangent", ()
    face, ratio = thinnest
    why = f"face {face} is degenerate" if not ratio > 1e-12 else f"face {face} is thin (height {ratio:.1e} of its longest edge)"
    manifold = mesh._topology.edge_manifold and mesh.is_orientable
    if manifold:
        return "intrinsic_delaunay", (f"laplacian='auto' took 'intrinsic_delaunay': {why}",)
    return "tufted", (f"laplacian='auto' took 'tufted': {why}, and the mesh is not manifold or has one side",)
