"""The result of a skeleton computation."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from .. import arrays
from ..arrays import Floats, Ints
from ..errors import DependencyError, InputError, TopologyError
from ..files import written
from ..near import nearest_neighbors
from ..results import save_result
from ..shapes import PointCloud, Shape
from ..view import Page, Picture, plot


@dataclass(frozen=True, eq=False, repr=False)
class SkeletonResult:
    """A graph along the middle of a shape, and what belongs to each node of it.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
    nodes : ndarray (k, D)
        Positions, in units of length.
    edges : ndarray (e, 2) of int32
        Pairs of nodes; no edge twice, none from a node to itself.
    radii : ndarray (k,)
        Mean distance of the surface from each node, across the skeleton.
    leaves, cycles : int
        The number of nodes with one edge, and of independent loops. On closed meshes the loops are exactly the handles.
    node_of_point : ndarray (n,) of int32
        The node that each vertex or point belongs to.
    limbs : list of ndarray of int32
        Chains of nodes from joint or tip to joint or tip; a closed loop repeats its first node.
    limb_of_node : ndarray (k,) of int32
        The limb that each node lies on; of a joint the first.
    components : ndarray (k,) of int32
        The connected piece of the shape that each node belongs to.
    contours : list of ndarray (c, D)
        Points of the level set that each node represents, in order around it; empty at some joints.
    function : ndarray (n,)
        The function whose level sets were used, read-only; values that were given are unchanged.
    eigenvalues : ndarray
        The first eigenvalues of the (first) piece if the function is made of eigenfunctions; else empty.
    critical : tuple of int
        Minima, saddles (with multiplicity) and maxima of the function. On closed meshes minima - saddles + maxima is the Euler
        characteristic; (0, 0, 0) for clouds.
    cut : ndarray
        For each limb that was cut, how many times longer than wide it was.
    cancelled : ndarray
        Height of each loop that was attributed to the sampling of a cloud, in units of length along the function.
    stability : tuple of float
        The greatest height of a cancelled loop and the least of one that is kept: the number of loops is the same for every
        threshold between. ``(0, inf)`` for trees in which nothing was cancelled.
    notes : tuple of str
        Remarks: components left out, noise, multiple eigenvalues.
    """

    shape: Shape
    nodes: Floats
    edges: Ints
    radii: Floats
    leaves: int
    cycles: int
    node_of_point: Ints
    limbs: list[Ints]
    limb_of_node: Ints
    components: Ints
    contours: list[Floats]
    function: Floats
    eigenvalues: Floats
    critical: tuple[int, int, int]
    cut: Floats
    cancelled: Floats
    stability: tuple[float, float]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"SkeletonResult({len(self.nodes)} nodes, {len(self.limbs)} limbs, {self.leaves} leaves, {self.cycles} cycles)"

    @property
    def degrees(self) -> Ints:
        """(k,): how many edges each node has."""
        return np.bincount(self.edges.ravel(), minlength=len(self.nodes)).astype(np.int32)

    @property
    def lengths(self) -> Floats:
        """Length of each limb along its nodes, in units of length."""
        return np.array([np.linalg.norm(np.diff(self.nodes[limb], axis=0), axis=1).sum() for limb in self.limbs])

    @property
    def limb_of_point(self) -> Ints:
        """(n,): the limb of each vertex or point: a segmentation of the shape."""
        return self.limb_of_node[self.node_of_point]

    def polylines(self, steps: int = 4) -> list[Floats]:
        """Each limb as a smooth curve through its nodes (Catmull-Rom splines), ``steps`` segments an edge.

        Examples
        --------
        >>> import beltrami as bt
        >>> [len(line) > 20 for line in bt.skeleton(bt.shapes.torus()).polylines()]
        [True]
        """
        steps = arrays.whole(steps, "steps", 1)
        arrays.room(4.0 * steps * (self.nodes.size + len(self.edges)), f"{steps} steps for each of {len(self.edges)} edges", "take fewer")
        share = (np.arange(steps) / steps)[None, :, None]
        lines = []
        for limb in self.limbs:
            x = self.nodes[limb]
            closed = limb[0] == limb[-1]
            before = np.concatenate([x[-2:-1] if closed else 2 * x[:1] - x[1:2], x[:-2]])[:, None]
            after = np.concatenate([x[2:], x[1:2] if closed else 2 * x[-1:] - x[-2:-1]])[:, None]
            a, b = x[:-1, None], x[1:, None]
            curve = a + 0.5 * share * (b - before + share * (2 * before - 5 * a + 4 * b - after + share * (3 * a - 3 * b + after - before)))
            lines.append(np.concatenate([curve.reshape(-1, x.shape[1]), x[-1:]]))
        return lines

    def to_networkx(self) -> Any:
        """A ``networkx.Graph``: nodes with ``position``, ``radius``, ``component``; edges with ``length``.

        Raises
        ------
        DependencyError
            networkx is not installed.
        """
        try:
            import networkx
        except ImportError:
            raise DependencyError("networkx is missing; pip install 'beltrami[networkx]'") from None
        graph = networkx.Graph()
        for node, (x, radius, piece) in enumerate(zip(self.nodes, self.radii, self.components, strict=True)):
            graph.add_node(node, position=tuple(x.tolist()), radius=float(radius), component=int(piece))
        lengths = np.linalg.norm(self.nodes[self.edges[:, 0]] - self.nodes[self.edges[:, 1]], axis=1)
        for (a, b), length in zip(self.edges.tolist(), lengths.tolist(), strict=True):
            graph.add_edge(a, b, length=length)
        return graph

    def drawn(self) -> dict[str, Any]:
        """Options of :func:`beltrami.plot` that show the skeleton: its curves, its joints and tips, a transparent shape."""
        special = self.degrees != 2
        options: dict[str, Any] = {"lines": self.polylines(), "transparency": 0.75, "color": "#b9c4d0"}
        if special.any():
            options["points"] = self.nodes[special]
        if isinstance(self.shape, PointCloud):
            sample = self.shape.points[:: max(1, len(self.shape.points) // 500)]
            spacing = float(np.median(nearest_neighbors(self.shape.points, sample, 7)[1][:, -1]))
            options |= {"radius": 0.1 * spacing, "transparency": 0.0, "line_width": 7.0}  # the curve is seen between the points
        return options

    def plot(self, *, path: str | os.PathLike[str] | None = None, **options: Any) -> Picture | Page:
        """Paints the skeleton inside the transparent shape; the options are those of :func:`beltrami.plot`."""
        return plot(self.shape, path=path, **{**self.drawn(), **options})

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the graph: ``.swc`` (trees), ``.obj`` with lines, ``.npz`` with everything; a picture to ``.png`` or ``.html``.

        Raises
        ------
        TopologyError
            A graph with loops cannot be written to SWC, which knows one parent a node.
        InputError
            The suffix is none of these, or points of R^D with D other than 3 are to go to ``.swc`` or ``.obj``.
        FileError
            The file cannot be written.
        """
        return save_result(self, path, "a skeleton is", {".swc": self._save_graph, ".obj": self._save_graph})

    def _save_graph(self, path: Path) -> Path:
        suffix = path.suffix.lower()
        if self.nodes.shape[1] != 3:
            raise InputError(f"{path}: {suffix} holds points of R^3, these lie in R^{self.nodes.shape[1]}; write .npz")
        text = "\n".join(self._swc(path) if suffix == ".swc" else self._obj()) + "\n"
        return written(path, lambda stream: stream.write(text.encode("ascii")))

    def _obj(self) -> list[str]:
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in self.nodes.tolist()]
        return lines + ["l " + " ".join(str(node + 1) for node in limb.tolist()) for limb in self.limbs]

    def _swc(self, path: Path) -> list[str]:
        if self.cycles:
            raise TopologyError(f"{path}: SWC holds trees and this skeleton has {self.cycles} cycles; write .obj or .npz")
        size = len(self.nodes)
        tree = scipy.sparse.coo_array((np.ones(len(self.edges)), (self.edges[:, 0], self.edges[:, 1])), shape=(size, size)).tocsr()
        lines, number = ["# id type x y z radius parent"], {-9999: -1}
        kinds = {1: 6, 2: 0}  # 6: end point, 5: fork point, 0: undefined
        for piece in np.unique(self.components):
            members = np.flatnonzero(self.components == piece)
            root = members[np.argmax(self.radii[members])]
            order, parents = scipy.sparse.csgraph.breadth_first_order(tree, root, directed=False)
            for node in order.tolist():
                number[node] = len(number)
                x, y, z = self.nodes[node].tolist()
                kind = kinds.get(int(self.degrees[node]), 5)
                lines.append(f"{number[node]} {kind} {x!r} {y!r} {z!r} {float(self.radii[node])!r} {number[int(parents[node])]}")
        return lines
