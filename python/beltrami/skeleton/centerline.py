"""From a Reeb graph to a curve along the middle: which contours become nodes, and where the middle of the shape is."""

from __future__ import annotations

import itertools
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .. import _core
from ..arrays import Floats, Ints
from ..near import intersect_rays, nearest_neighbors
from ..shapes import PointCloud, Shape, TriangleMesh
from .complexes import Complex, Indices
from .reeb import Limb, SimplifiedGraph

DIRECTIONS = 24  # of the rays that center a node
ROUNDS = 8  # tangents turn as nodes move
SETTLING = 12  # rounds more in which edges are centered too
FAT = 0.7  # a limb thinner than this share of another one at the joint ends at a body rather than at a tube


_TURN = np.linalg.qr(np.array([[2.0, 1.0, -3.0], [1.0, 4.0, 1.0], [5.0, -1.0, 2.0]]))[0]  # so that rays lie along no axis


@dataclass
class Drawing:
    """Nodes of one component: limbs are chains of node numbers, joints and tips included; a closed one repeats its first node."""

    nodes: Floats
    radii: Floats
    chains: list[list[int]]
    joints: dict[int, float]  # node: radius of the widest limb there
    node_of_group: Indices

    def is_ring(self, chain: list[int]) -> bool:
        """Whether a chain is a loop without a joint."""
        return chain[0] == chain[-1] and chain[0] not in self.joints


def draw(simple: SimplifiedGraph, spacing: float, is_open: bool) -> Drawing:
    """Chooses the contours that become nodes: not those bent by a joint, not those at the very tip, none too dense.

    Where a surface is open the last contours before its rim are arcs; they are much shorter than those that follow.
    """
    graph = simple.graph
    centers, radii = graph.centers, graph.radii
    degree = simple.degrees()
    at: dict[int, list[tuple[Limb, int]]] = defaultdict(list)
    for limb in simple.limbs:
        at[limb.ends[0]].append((limb, 0))
        at[limb.ends[1]].append((limb, -1))
    nodes: list[Floats] = []
    widths: list[float] = []
    number: dict[int, int] = {}
    joints: dict[int, float] = {}
    for joint in sorted(at):
        if degree[joint] > 2:
            near = [limb.groups[end] for limb, end in at[joint]]
            number[joint] = len(nodes)
            joints[len(nodes)] = max(_end_width(graph.radii[limb.groups], graph.centers[limb.groups], end) for limb, end in at[joint])
            widths.append(float(np.median(radii[near])))
            nodes.append(np.average(centers[near], axis=0, weights=graph.length[near]))
    node_of_group = np.full(len(centers), -1)
    chains = []
    for limb in simple.limbs:
        groups = np.asarray(limb.groups)
        degrees, ring = [degree[end] for end in limb.ends], limb.ends[0] == limb.ends[1]
        chosen = _chosen(centers[groups], radii[groups], graph.length[groups], degrees, ring, is_open, spacing)
        numbers = list(range(len(nodes), len(nodes) + len(chosen)))
        nodes += list(centers[groups[chosen]])
        widths += radii[groups[chosen]].tolist()
        nearest = np.abs(np.arange(len(groups))[:, None] - chosen).argmin(1)
        node_of_group[groups] = np.asarray(numbers)[nearest]
        lacking = 3 - len(chosen) if ring else 0
        if lacking > 0:  # a loop of one or two contours: points between the middle and the contour make it a polygon
            around = graph.points[graph.point_group == groups[chosen[-1]]]
            spread = around[np.linspace(0, len(around) - 1, lacking + 1).astype(np.int64)[1:]]
            numbers += range(len(nodes), len(nodes) + lacking)
            nodes += list((spread + centers[groups[chosen[-1]]]) / 2)
            widths += [float(radii[groups[chosen[-1]]])] * lacking
        first, last = ([number[end]] if end in number else [] for end in limb.ends)
        chain = first + numbers + last
        if limb.ends[0] == limb.ends[1] and limb.ends[0] not in number:
            chain.append(numbers[0])
        chains.append(chain)
    for joint, fallen in simple.fallen.items():
        home = number.get(joint)
        if home is None:  # the joint of a ring: the nearest end of its limb
            limb, end = at[joint][0]
            home = int(node_of_group[limb.groups[end]])
        node_of_group[np.asarray(fallen, np.int64)] = home
    for group, beside in simple.stray:
        node_of_group[group] = node_of_group[beside]
    return Drawing(np.array(nodes), np.array(widths), chains, joints, node_of_group)


def _travelled(x: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])


def _end_width(radii: Floats, x: Floats, end: int) -> float:
    """Radius of a limb near one of its ends (0 or -1): the median over the first three radii."""
    travelled = _travelled(x)
    ahead = travelled if end == 0 else travelled[-1] - travelled
    width = float(np.median(radii))
    for _ in range(3):
        width = float(np.median(radii[ahead <= 3 * width]))
    return width


def _chosen(x: Floats, radii: Floats, lengths: Floats, degrees: list[int], ring: bool, is_open: bool, spacing: float) -> Indices:
    """Places in a limb whose contours become nodes."""
    travelled = _travelled(x)
    total = float(travelled[-1])
    allowed = np.ones(len(x), bool)
    for end, degree in ((0, degrees[0]), (-1, degrees[1])):
        ahead = travelled if end == 0 else total - travelled
        width = _end_width(radii, x, end)
        if degree > 2:
            allowed &= ahead >= min(0.65 * width, 0.35 * total)
            allowed &= (ahead > 2 * width) | (radii < 1.4 * width)
        elif degree == 1:
            allowed &= ahead >= min(width, 0.4 * total)
            if is_open:
                near = np.arange(len(x)) < len(x) // 3
                short = lengths < 0.9 * float(np.median(lengths[lengths > 0.1 * lengths.max()]))
                allowed &= ~short | ~(near if end == 0 else near[::-1])
    need = 3 if ring else 2 if min(degrees) == 1 else 1
    if allowed.sum() < need:
        allowed[np.argsort(np.abs(travelled - total / 2), kind="stable")[:need]] = True
    places = np.flatnonzero(allowed)
    kept = [int(places[0])]
    for place in places[1:].tolist():
        if travelled[place] - travelled[kept[-1]] >= max(0.3 * radii[place], 0.5 * spacing):
            kept.append(place)
    if degrees[1] != 2 and kept[-1] != places[-1]:  # the last one stays, the one before it may go
        kept = [*(kept[:-1] if len(kept) > need else kept), int(places[-1])]
    if len(kept) < need:
        kept = places[np.unique(np.linspace(0, len(places) - 1, need).round().astype(np.int64))].tolist()
    return np.asarray(kept, np.int64)


# --- the middle ------------------------------------------------------------------------------------------------------------------------


def _smooth(x: Floats, widths: Floats, ring: bool, factor: float) -> tuple[Floats, Floats]:
    """Positions and unit tangents of a polyline by local quadratic fits with Gaussian weights, ``factor`` times the radius wide."""
    count = len(x)
    if count < 3:
        tangents = np.repeat((x[-1] - x[0])[None], count, axis=0)
        return x.copy(), tangents / max(float(np.linalg.norm(tangents[0])), 1e-300)
    travelled = _travelled(x)
    apart = travelled[None] - travelled[:, None]
    if ring:
        turn = travelled[-1] + float(np.linalg.norm(x[0] - x[-1]))
        apart = (apart + turn / 2) % turn - turn / 2
    near = np.sort(np.abs(apart), axis=1)[:, min(3, count - 1)]
    sigma = np.maximum(np.maximum(factor * widths, 0.7 * near), 1e-300)[:, None]
    scaled = apart / sigma
    weights = np.exp(-0.5 * scaled**2)
    terms = [weights]
    for _ in range(4):
        terms.append(terms[-1] * scaled)
    moments = np.stack([term.sum(1) for term in terms], 1)
    matrix = np.stack([moments[:, [0, 1, 2]], moments[:, [1, 2, 3]], moments[:, [2, 3, 4]]], 1) + 1e-9 * np.eye(3)
    right = np.stack([term @ x for term in terms[:3]], 1)
    fit = np.linalg.solve(matrix, right)
    slopes = right[:, 1] - (moments[:, 1] / moments[:, 0])[:, None] * right[:, 0]  # of linear fits: steadier at the ends
    slopes /= np.maximum(np.linalg.norm(slopes, axis=1), 1e-300)[:, None]
    return np.asarray(fit[:, 0], np.float64), np.asarray(slopes, np.float64)


class Section:
    """Distances from nodes to the surface in the planes across the skeleton, in ``DIRECTIONS`` directions; NaN where there is none."""

    def __init__(self, complex_: Complex, drawing: Drawing, owners: Indices, shape: Shape) -> None:
        self.turn = np.linspace(0.0, 2 * np.pi, DIRECTIONS, endpoint=False)
        self.mesh = shape if isinstance(shape, TriangleMesh) else None
        self.spacing = complex_.spacing
        if self.mesh is not None:
            corners = self.mesh.vertices[self.mesh.faces]
            self.normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            middle = corners.reshape(-1, 3).mean(0)
            self.side = 1.0 if np.einsum("md,md->", self.normals, corners[:, 0] - middle) >= 0 else -1.0
        else:  # the points themselves, also those that were too noisy for the complex
            self.points = complex_.sources
            nearest = owners if len(owners) == len(self.points) else owners[nearest_neighbors(complex_.points, self.points, 1)[0][:, 0]]
            # the points of each limb, along the axis in which the shape is longest; those of a joint count for all of its limbs
            self.axis = int(np.argmax(np.ptp(self.points, axis=0)))
            order = np.lexsort((self.points[:, self.axis], nearest))
            bounds = np.searchsorted(nearest[order], np.arange(len(drawing.nodes) + 1))
            limbs = [np.concatenate([order[bounds[node] : bounds[node + 1]] for node in set(chain)]) for chain in drawing.chains]
            limbs = [limb[np.argsort(self.points[limb, self.axis], kind="stable")] for limb in limbs]
            self.starts = np.cumsum([0, *map(len, limbs)])
            self.grouped = np.ascontiguousarray(self.points[np.concatenate(limbs)])

    def holds(self, x: Floats) -> npt.NDArray[np.bool_]:
        """Which points lie inside the mesh: most rays in six directions leave it."""
        assert self.mesh is not None
        directions = np.tile(np.concatenate([np.eye(3), -np.eye(3)]) @ _TURN, (len(x), 1))
        hits = intersect_rays(self.mesh, np.repeat(x, 6, axis=0), directions)
        leaves = (hits.faces >= 0) & (self.side * np.einsum("rd,rd->r", self.normals[hits.faces], directions) > 0)
        inside: npt.NDArray[np.bool_] = leaves.reshape(-1, 6).sum(1) > 3
        return inside

    def frames(self, tangents: Floats) -> tuple[Floats, Floats]:
        """Two unit vectors across each tangent."""
        u = np.cross(tangents, np.eye(3)[np.abs(tangents).argmin(1)])
        u /= np.maximum(np.linalg.norm(u, axis=1), 1e-300)[:, None]
        return u, np.cross(tangents, u)

    def __call__(self, x: Floats, tangents: Floats, widths: Floats, chains: Ints) -> tuple[Floats, Floats, Floats]:
        """Distances (k, directions), and the two vectors that the directions turn from and to. ``chains``: the limb of each node."""
        tangents = np.where(tangents.any(axis=1, keepdims=True), tangents, np.eye(3)[:1])  # of nodes at one place: any
        u, v = self.frames(tangents)
        if self.mesh is None:
            # each direction sees the points of the limb near the plane, weighted by a bump of two sectors: contours have few points
            thickness = np.maximum(0.35 * widths, self.spacing)
            places = (np.ascontiguousarray(x), np.ascontiguousarray(tangents), u, v)
            found = _core.sectors(self.grouped, self.starts, self.axis, *places, 2.0 * widths, thickness, chains, DIRECTIONS)
            return np.where(found < 0, np.nan, found), u, v
        directions = np.cos(self.turn)[None, :, None] * u[:, None] + np.sin(self.turn)[None, :, None] * v[:, None]
        flat = directions.reshape(-1, 3)
        hits = intersect_rays(self.mesh, np.repeat(x, DIRECTIONS, axis=0), flat)
        outward = self.side * np.einsum("rd,rd->r", self.normals[hits.faces], flat) > 0
        return np.where((hits.faces >= 0) & outward, hits.distances, np.nan).reshape(len(x), DIRECTIONS), u, v


def center(drawing: Drawing, section: Section | None) -> None:
    """Moves nodes to the middle of the sections across the skeleton, and joints to where their limbs point.

    Where a thin limb meets a thick body its way from the surface to the middle of the body is long: nodes are put on it, and the joint
    is centered like a node of the body.
    """
    noisy, count = section is None or section.mesh is None, len(drawing.nodes)
    for round_ in range(ROUNDS // 2 if noisy else ROUNDS):
        _center_once(drawing, section, noisy)
        if round_ == 1:
            _fill(drawing)
    if noisy:
        for chain in drawing.chains:
            own = np.asarray([node for node in dict.fromkeys(chain) if node not in drawing.joints])
            if len(own) > 3:
                drawing.nodes[own] = _smooth(drawing.nodes[own], drawing.radii[own], drawing.is_ring(chain), 0.7)[0]
    _thin(drawing, count)
    if section is not None and section.mesh is not None:
        _settle(drawing, section)
        _measure(drawing, section, _inwards(drawing, section))


def _thin(drawing: Drawing, count: int) -> None:
    """Takes out those nodes from ``count`` on that came to lie in the core of a body, beside its joint."""
    kept = list(range(count))
    for at, chain in enumerate(drawing.chains):
        around = [joint for joint in (chain[0], chain[-1]) if joint in drawing.joints]
        far = [
            node < count or all(np.linalg.norm(drawing.nodes[node] - drawing.nodes[joint]) > 0.7 * drawing.radii[joint] for joint in around)
            for node in chain
        ]
        drawing.chains[at] = [node for node, stays in zip(chain, far, strict=True) if stays]
        kept += [node for node in drawing.chains[at] if node >= count]
    new = {node: number for number, node in enumerate(kept)}
    drawing.nodes, drawing.radii = drawing.nodes[kept], drawing.radii[kept]
    drawing.chains = [[new[node] for node in chain] for chain in drawing.chains]


def _settle(drawing: Drawing, section: Section) -> None:
    """Moves the inner nodes of limbs until the middles of the edges between them lie in the middle of the sections across them as well:
    where a limb bends, tangents say too little. The best of all rounds stays."""
    pairs = np.array([pair for chain in drawing.chains for pair in itertools.pairwise(chain)], np.int64).reshape(-1, 2)
    count = len(drawing.nodes)
    degree = np.bincount(pairs.ravel(), minlength=count)
    a, b = pairs[(degree[pairs] == 2).all(1)].T
    inner = np.flatnonzero(np.bincount(np.concatenate([a, b]), minlength=count))
    if len(inner) == 0:
        return
    beside = np.concatenate([pairs, pairs[:, ::-1]])
    beside = beside[np.argsort(beside[:, 0], kind="stable")]
    ends = beside[np.searchsorted(beside[:, 0], inner)[:, None] + [0, 1], 1]
    x, best, least = drawing.nodes, drawing.nodes, np.inf
    for _ in range(SETTLING):
        along = np.concatenate([x[b] - x[a], x[ends[:, 1]] - x[ends[:, 0]]])
        length = np.linalg.norm(along, axis=1)
        along = along / np.maximum(length, 1e-300)[:, None]
        places = np.concatenate([(x[a] + x[b]) / 2, x[inner]])
        distances, u, v = section(places, along, np.ones(len(places)), np.zeros(len(places), np.int32))
        shift, mean, good = _middle(distances, u, v, section.turn)
        shift[~good] = 0.0
        size = length[: len(a)]
        off = np.where(good, np.linalg.norm(shift, axis=1) / np.maximum(mean, 1e-300), 1.0)[: len(a)]
        if float(size @ off) < least * float(size.sum()):
            best, least = x, float(size @ off) / max(float(size.sum()), 1e-300)
        weight = np.bincount(a, size, count) + np.bincount(b, size, count)
        pull = [np.bincount(a, size * column, count) + np.bincount(b, size * column, count) for column in shift[: len(a)].T]
        moved = np.stack(pull, 1)[inner] / np.maximum(weight, 1e-300)[inner, None] + shift[len(a) :]
        x = x.copy()
        x[inner] += 0.25 * moved
    drawing.nodes = best


def _around(drawing: Drawing) -> list[list[int]]:
    """The neighbours of each node."""
    around: list[set[int]] = [set() for _ in drawing.nodes]
    for chain in drawing.chains:
        for a, b in itertools.pairwise(chain):
            around[a].add(b)
            around[b].add(a)
    return [sorted(others) for others in around]


def _inwards(drawing: Drawing, section: Section) -> Indices:
    """Nodes outside of a closed mesh move halfway to a neighbour that is inside, until they are inside too: those that moved."""
    around = _around(drawing)
    first = drawing.nodes.copy()
    outside = np.flatnonzero(~section.holds(drawing.nodes))
    for _ in range(8):
        if len(outside) == 0:
            break
        lost = set(outside.tolist())
        for node in outside.tolist():
            inside = [other for other in around[node] if other not in lost]
            if inside:
                drawing.nodes[node] = (drawing.nodes[node] + drawing.nodes[inside].mean(0)) / 2
        outside = outside[~section.holds(drawing.nodes[outside])]
    return np.flatnonzero((drawing.nodes != first).any(1))


def _measure(drawing: Drawing, section: Section, moved: Indices) -> None:
    """Radii where the nodes have come to lie: of those inside of limbs, and of those that were ``moved`` from outside."""
    around = _around(drawing)
    chosen = {*moved.tolist(), *(node for node, others in enumerate(around) if len(others) == 2)}
    ends = [(node, around[node][0], around[node][-1] if len(around[node]) > 1 else node) for node in sorted(chosen) if around[node]]
    if not ends:
        return
    nodes, first, last = np.array(ends).T
    along = drawing.nodes[last] - drawing.nodes[first]
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    distances, u, v = section(drawing.nodes[nodes], along, drawing.radii[nodes], np.zeros(len(nodes), np.int32))
    _, mean, good = _middle(distances, u, v, section.turn)
    drawing.radii[nodes[good]] = mean[good]


def _fill(drawing: Drawing) -> None:
    """Nodes a radius apart between joints and the thin limbs that end there, and 0.8 of one where long limbs have none."""
    new_nodes, new_radii = [drawing.nodes], [drawing.radii]
    count = len(drawing.nodes)
    for at, chain in enumerate(drawing.chains):
        filled = [chain[0]]
        long = drawing.is_ring(chain) or len(chain) > 6
        for a, b in itertools.pairwise(chain):
            joint, node = (a, b) if a in drawing.joints else (b, a)
            apart = float(drawing.radii[node])
            if joint not in drawing.joints:
                apart = 0.8 * max(float(drawing.radii[a]), float(drawing.radii[b])) if long else np.inf
            elif node in drawing.joints or apart >= FAT * drawing.joints[joint]:
                apart = np.inf
            steps = int(min(float(np.linalg.norm(drawing.nodes[a] - drawing.nodes[b])) / max(apart, 1e-300), 12.0))
            if steps > 0:
                share = (np.arange(1, steps + 1) / (steps + 1))[:, None]
                new_nodes.append(drawing.nodes[a] + share * (drawing.nodes[b] - drawing.nodes[a]))
                new_radii.append(np.full(steps, drawing.radii[node]))
                filled += range(count, count + steps)
                count += steps
            filled.append(b)
        drawing.chains[at] = filled
    drawing.nodes, drawing.radii = np.concatenate(new_nodes), np.concatenate(new_radii)


def _center_once(drawing: Drawing, section: Section | None, noisy: bool) -> None:
    ends: dict[int, list[list[int]]] = {joint: [] for joint in drawing.joints}
    numbers, starts, smooths, tangents, chains = [], [], [], [], []
    for at, chain in enumerate(drawing.chains):
        for way in (chain, chain[::-1]):
            if way[0] in ends:
                ends[way[0]].append(way)
        inner = [node for node in dict.fromkeys(chain) if node not in drawing.joints]
        if not inner:
            continue
        # where a limb is long its tangents do without the joints, which are placed by them
        used = np.asarray(inner if len(inner) > 3 or len(chain) == len(inner) else chain)
        free = np.isin(used, inner)
        smooth, along = _smooth(drawing.nodes[used], drawing.radii[used], drawing.is_ring(chain), 0.4)
        numbers.append(used[free])
        smooths.append(smooth[free])
        starts.append((smooth if noisy else drawing.nodes[used])[free])
        tangents.append(along[free])
        chains.append(np.full(int(free.sum()), at, np.int32))
    where, start, smooth = np.concatenate(numbers), np.concatenate(starts), np.concatenate(smooths)
    joints = [_Meeting(drawing, joint, limbs) for joint, limbs in ends.items()]
    if section is None:
        drawing.nodes[where] = smooth
        for joint in joints:
            drawing.nodes[joint.number] = joint.tries[0]
        return
    # one call for all nodes and joints: rays are quick, what they need is built anew each time
    x = np.concatenate([start, *(joint.tries for joint in joints)])
    along = np.concatenate([*tangents, *(joint.tangents for joint in joints)])
    widths = np.concatenate([drawing.radii[where], *(np.full(len(joint.tries), joint.width) for joint in joints)])
    limbs = np.concatenate([*chains, *(np.full(len(joint.tries), -1, np.int32) for joint in joints)])
    distances, u, v = section(x, along, widths, limbs)
    shift, mean, good = _middle(distances, u, v, section.turn)
    count = len(where)
    drawing.nodes[where] = np.where(good[:count, None], start + shift[:count], smooth)
    drawing.radii[where[good[:count]]] = mean[:count][good[:count]]
    for joint in joints:
        here = slice(count, count + len(joint.tries))
        count = here.stop
        drawing.nodes[joint.number] = joint.tries[0]
        if good[here].any():
            best = int(np.argmax(good[here]))
            drawing.nodes[joint.number] = joint.tries[best] + (shift[here][best] if joint.fat else 0.0)
            drawing.radii[joint.number] = mean[here][best]


class _Meeting:
    """Where a joint may be: nearest to the straight continuations of its limbs (least squares), not far from where wide ones end;
    should that lie outside of the shape, nearer to the widest. ``fat``: it belongs to a body, and to the middle of the section across."""

    def __init__(self, drawing: Drawing, joint: int, limbs: list[list[int]]) -> None:
        self.number, self.fat, self.width = joint, False, float(drawing.radii[joint])
        self.tries, self.tangents = drawing.nodes[[joint]], np.eye(3)[:1]
        matrix, right = np.zeros((3, 3)), np.zeros(3)
        firsts: list[int] = []
        for chain in limbs:
            near = np.asarray([node for node in chain[1:] if node not in drawing.joints])
            if len(near) == 0:
                continue
            firsts.append(int(near[0]))
            reach = np.linalg.norm(drawing.nodes[near] - drawing.nodes[near[0]], axis=1)
            points = drawing.nodes[near[: max(2, int((np.cumsum(reach > 2.0 * drawing.radii[near[0]]) == 0).sum()))]]
            if len(points) > 1:
                direction = np.linalg.svd(points - points.mean(0))[2][0]
                across = np.eye(3) - np.outer(direction, direction)
                matrix += across
                right += across @ points.mean(0)
        if not firsts:
            return
        firsts.sort(key=lambda node: (-drawing.radii[node], node))
        widths = drawing.radii[firsts]
        self.width = float(widths[0])
        self.fat = bool(widths[-1] < FAT * self.width)
        # lines that are nearly parallel say little: stay near the ends, of wide limbs above all
        trunk = np.average(drawing.nodes[firsts], axis=0, weights=(widths / max(self.width, 1e-300)) ** 4 + 1e-9)
        pull = 0.5 if self.fat else 0.03
        offset = np.linalg.solve(matrix + pull * np.eye(3), right + pull * trunk) - trunk
        place = trunk + offset * min(1.0, 1.5 * self.width / max(float(np.linalg.norm(offset)), 1e-300))
        along = drawing.nodes[firsts[0]] - drawing.nodes[firsts[-1 if len(firsts) == 1 else 1]]
        length = float(np.linalg.norm(along))
        shares = np.linspace(0, 1, 6 if length > 0 else 1)[:, None]
        self.tries = (1 - shares) * place + shares * drawing.nodes[firsts[0]]
        self.tangents = np.repeat((along / length if length > 0 else np.eye(3)[0])[None], len(self.tries), axis=0)


def _middle(distances: Floats, u: Floats, v: Floats, turn: Floats) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
    """Where the middle of each section lies from the node, its mean radius, and whether the node sees enough of the surface."""
    absent = np.isnan(distances).sum(1) / DIRECTIONS
    typical = np.asarray(np.nanmedian(np.where((absent == 1)[:, None], 0.0, distances), axis=1))
    bounded = np.minimum(distances, 1.9 * typical[:, None])  # rays may run into another limb
    bounded = np.where(np.isnan(bounded), typical[:, None], bounded)
    shift: Floats = ((bounded @ np.cos(turn))[:, None] * u + (bounded @ np.sin(turn))[:, None] * v) / DIRECTIONS
    good: npt.NDArray[np.bool_] = (absent < 0.4) & (typical > 0)
    return shift, bounded.mean(1), good


def descended(drawing: Drawing, points: Floats, owners: Indices) -> Indices:
    """Moves each point's node along the graph as long as that brings it nearer."""
    around = _around(drawing)
    width = max(map(len, around), default=0)
    table = np.array([[node, *others, *[node] * (width - len(others))] for node, others in enumerate(around)])
    owners = owners.copy()
    moving = np.arange(len(owners))
    while len(moving):
        options = table[owners[moving]]
        offset = points[moving, None] - drawing.nodes[options]
        best = np.einsum("nkd,nkd->nk", offset, offset).argmin(1)
        owners[moving] = options[np.arange(len(moving)), best]
        moving = moving[best > 0]
    return owners


def section_of(complex_: Complex, drawing: Drawing, owners: Indices, shape: Shape) -> Section | None:
    """What says where the middle is: rays in closed meshes, the points themselves in clouds, nothing on open meshes."""
    if isinstance(shape, PointCloud) or shape.is_closed:
        return Section(complex_, drawing, owners, shape)
    return None
