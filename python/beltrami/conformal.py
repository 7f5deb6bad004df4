"""Conformal maps of closed surfaces of genus 0 to the unit sphere, and the Möbius maps of the sphere.

A map s of the vertices to the unit sphere has the Dirichlet energy E(s) = 1/2 tr(s^T L s) and its image polyhedron the signed area
A(s). E - A is never negative, and zero only where every triangle keeps its angles: that is what is minimized and reported, for E alone
is smallest where all vertices meet in one point. Möbius maps change neither E nor A in the limit of fine meshes; the one map that
is returned has its area-weighted centre at the origin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse

from . import arrays
from .arrays import Floats
from .errors import Cancelled, InputError, NumericalError, TopologyError
from .operators import Operators, operators
from .progress import Progress, reporter
from .shapes import Shape, TriangleMesh
from .solvers import Cholesky, plus_diagonal

Faces = npt.NDArray[np.int64]

__all__ = ["SphericalMapResult", "spherical_map"]


# --- the result ---------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class SphericalMapResult:
    """A map of a shape to the unit sphere, with what certifies it.

    Attributes
    ----------
    shape : TriangleMesh or PointCloud
        What was mapped.
    positions : ndarray (n, 3)
        Images of the vertices, unit vectors; their mean, weighted by the areas of the source, is zero.
    conformal_factor : ndarray (n,)
        Lumped area of the image over that of the source, in 1 / length².
    energy, area : float
        Dirichlet energy E by the mesh's own cotangents, and signed area A of the image polyhedron.
    flipped : int
        Triangles whose image is turned over.
    angle_error : ndarray (m,)
        Mean change of a triangle's three angles, in radians.
    dilatation : ndarray (m,)
        Ratio of the greater to the smaller stretch of each triangle: 1 where it is conformal.
    iterations : int
    converged : bool
    history : dict of str to ndarray
        ``move`` (root mean square move of each step) and ``excess`` (E - A before each step).
    notes : tuple of str
        What is worth knowing about how the map was found.
    """

    shape: Shape
    positions: Floats
    conformal_factor: Floats
    energy: float
    area: float
    flipped: int
    angle_error: Floats
    dilatation: Floats
    iterations: int
    converged: bool
    history: dict[str, Floats]
    notes: tuple[str, ...] = ()

    @property
    def excess(self) -> float:
        """E - A: zero only for a map that keeps all angles."""
        return self.energy - self.area

    def __repr__(self) -> str:
        return (
            f"SphericalMapResult({len(self.positions)} vertices, E - A = {self.excess:.4g}, mean angle error "
            f"{np.degrees(self.angle_error.mean()):.3g} degrees, {self.flipped} flipped)"
        )


# --- triangles ----------------------------------------------------------------------------------------------------------------------


def _corner_cotangents(vertices: Floats, faces: Faces) -> tuple[Floats, Floats]:
    """Cotangents (m, 3) of the corners, and areas (m,), of triangles in R^D."""
    p = [vertices[faces[:, k]] for k in range(3)]
    cotangents = np.empty((len(faces), 3))
    edges = [p[2] - p[1], p[0] - p[2], p[1] - p[0]]  # opposite to each corner
    u, v = edges[2], edges[1]
    if vertices.shape[1] == 3:
        double = np.linalg.norm(np.cross(u, v), axis=1)
    else:
        gram = (u * u).sum(1) * (v * v).sum(1) - (u * v).sum(1) ** 2
        double = np.sqrt(np.maximum(gram, 0.0))
    for k in range(3):
        with np.errstate(divide="ignore", invalid="ignore"):
            cotangents[:, k] = -(edges[(k + 1) % 3] * edges[(k + 2) % 3]).sum(1) / double
    return cotangents, 0.5 * double


def _corner_angles(vertices: Floats, faces: Faces) -> Floats:
    angles = np.empty((len(faces), 3))
    for k in range(3):
        a, b = vertices[faces[:, (k + 1) % 3]] - vertices[faces[:, k]], vertices[faces[:, (k + 2) % 3]] - vertices[faces[:, k]]
        dot = (a * b).sum(1)
        if vertices.shape[1] == 3:
            cross = np.linalg.norm(np.cross(a, b), axis=1)
        else:
            cross = np.sqrt(np.maximum((a * a).sum(1) * (b * b).sum(1) - dot**2, 0.0))
        angles[:, k] = np.arctan2(cross, dot)
    return angles


def _determinants(s: Floats, faces: Faces) -> Floats:
    """p . ((q - p) x (r - p)) of each image triangle: by differences, for p . (q x r) is rounding noise on small triangles."""
    p = s[faces[:, 0]]
    found: Floats = np.einsum("ij,ij->i", p, np.cross(s[faces[:, 1]] - p, s[faces[:, 2]] - p))
    return found


def _lumped(areas: Floats, faces: Faces, count: int) -> Floats:
    return np.bincount(faces.ravel(), weights=np.repeat(areas / 3, 3), minlength=count).astype(np.float64)


class _Surface:
    """A closed triangle mesh with faces that look outwards, and the two halves of E - A on it."""

    def __init__(self, vertices: Floats, faces: Faces) -> None:
        self.vertices, self.faces, self.count = vertices, faces, len(vertices)
        self.cotangents, self.areas = _corner_cotangents(vertices, faces)
        self.mass = _lumped(self.areas, faces, self.count)
        corners = faces.T.ravel()
        self._gather = sparse.csr_array((np.ones(len(corners)), (corners, np.arange(len(corners)))), (self.count, len(corners)))

    def energy_and_area(self, s: Floats) -> tuple[float, float]:
        """E by the mesh's own cotangents, A with the sign of each triangle's determinant."""
        p, q, r = (s[self.faces[:, k]] for k in range(3))
        e = (r - q, p - r, q - p)
        energy = 0.25 * sum(float((self.cotangents[:, k] * (e[k] * e[k]).sum(1)).sum()) for k in range(3))
        cross = np.cross(e[2], -e[1])
        area = 0.5 * float((np.linalg.norm(cross, axis=1) * np.sign((p * cross).sum(1))).sum())
        return energy, area

    def gradient(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """Gradient of E - A (n, 3), face by face from edge differences; lumped image areas; E - A of each face."""
        p, q, r = (s[self.faces[:, k]] for k in range(3))
        e = (r - q, p - r, q - p)
        cross = np.cross(e[2], -e[1])
        double = np.linalg.norm(cross, axis=1)
        sign = np.sign((p * cross).sum(1))
        normal = cross * np.divide(0.5 * sign, double, out=np.zeros_like(double), where=double > 0)[:, None]
        w = [0.5 * self.cotangents[:, k, None] * e[k] for k in range(3)]
        # Corner k is the end of edge k + 1 and the start of edge k + 2 (edge k lies opposite to it).
        parts = [w[(k + 1) % 3] - w[(k + 2) % 3] - np.cross(normal, e[k]) for k in range(3)]
        gradient: Floats = self._gather @ np.concatenate(parts)
        excess = 0.25 * sum(self.cotangents[:, k] * (e[k] * e[k]).sum(1) for k in range(3)) - 0.5 * sign * double
        return gradient, _lumped(0.5 * double, self.faces, self.count), excess

    def flipped(self, s: Floats) -> npt.NDArray[np.bool_]:
        """Which triangles are turned over, or have no area."""
        turned: npt.NDArray[np.bool_] = _determinants(s, self.faces) <= 0
        return turned


# --- Möbius maps --------------------------------------------------------------------------------------------------------------------


def _unit(s: Floats) -> Floats:
    """Rows of length 1."""
    norms = np.sqrt((s * s).sum(1))
    found: Floats = s / norms[:, None]
    return found


def _translated(s: Floats, c: Floats) -> Floats:
    """The Möbius map of the ball that takes -c to 0: (1 - |c|²) (s + c) / |s + c|² + c."""
    d = s + c
    return _unit(d * ((1 - c @ c) / (d * d).sum(1))[:, None] + c)


def _centred(s: Floats, mass: Floats, steps: int = 100) -> Floats:
    """The Möbius image whose mean, weighted by the mass, is zero (Baden, Crane and Kazhdan 2018): Newton's method with short steps."""
    weights = mass / mass.sum()
    mean = weights @ s
    best = float(np.linalg.norm(mean))
    for _ in range(steps):
        if best < 3e-16:
            break
        jacobian = 2 * (np.eye(3) - (s * weights[:, None]).T @ s)
        c = -np.linalg.solve(jacobian + 1e-14 * np.eye(3), mean)
        length = float(np.linalg.norm(c))
        c *= min(1.0, 0.75 / length) if length > 0 else 1.0
        for _ in range(30):
            moved = _translated(s, c)
            mean_moved = weights @ moved
            size = float(np.linalg.norm(mean_moved))
            if size < best:
                break
            c /= 2
        else:
            break
        done = best < 1e-13 and size > 0.25 * best
        s, mean, best = moved, mean_moved, size
        if done:
            break
    return s


# --- the fast route -----------------------------------------------------------------------------------------------------------------


def _tangential(vectors: Floats, s: Floats) -> Floats:
    found: Floats = vectors - (vectors * s).sum(1)[:, None] * s
    return found


def _start(surface: _Surface, solve: Callable[[Floats], Floats]) -> Floats:
    """A linear map to the plane with its pole in one large and well-shaped triangle, and up to the sphere (Haker et al. 2000)."""
    v, f = surface.vertices, surface.faces
    corners = v[f]
    sides = ((corners - corners[:, [1, 2, 0]]) ** 2).sum((1, 2))
    shapely = np.divide(surface.areas, sides, out=np.zeros_like(sides), where=sides > 0)
    good = shapely >= 0.9 * np.quantile(shapely, 0.98)
    pole = int(np.flatnonzero(good)[np.argmax(surface.areas[good])])
    a, b, c = v[f[pole]]
    x = (b - a) / np.linalg.norm(b - a)
    y = (c - a) - ((c - a) @ x) * x
    p = np.array([0, np.linalg.norm(b - a), (c - a) @ x + 1j * np.linalg.norm(y)])
    right = np.zeros((surface.count, 2))
    for k in range(3):
        load = np.conj(1j * (p[(k + 2) % 3] - p[(k + 1) % 3]) / 2)
        right[f[pole, k]] += load.real, load.imag
    right /= np.abs(right).max()
    z = solve(right)
    z = z - np.median(z, axis=0)
    z = z / np.median(np.sqrt((z * z).sum(1)))
    square = (z * z).sum(1)
    s = np.column_stack([2 * z, square - 1]) / (1 + square)[:, None]
    if np.sign(_determinants(s, f)).sum() < 0:
        s[:, 1] *= -1
    return _unit(s)


def _anderson(residuals: list[Floats], images: list[Floats], weights: Floats) -> Floats:
    """The mix of the last steps whose residual is least (Anderson 1965; Walker and Ni 2011)."""
    newest, image = residuals[-1], images[-1]
    if len(residuals) == 1:
        return image
    differences = [newest - r for r in residuals[:-1]]
    scale = [float(np.sqrt(np.einsum("i,ij,ij->", weights, d, d))) for d in differences]
    kept = [k for k, size in enumerate(scale) if size > 0]
    if not kept:
        return image
    columns = [differences[k] / scale[k] for k in kept]
    gram = np.array([[np.einsum("i,ij,ij->", weights, a, b) for b in columns] for a in columns])
    right = np.array([np.einsum("i,ij,ij->", weights, a, newest) for a in columns])
    values, vectors = np.linalg.eigh(gram)
    inverse = np.where(values > 1e-14 * values[-1], 1 / np.maximum(values, 1e-300), 0.0)
    shares = vectors @ (inverse * (vectors.T @ right))
    for k, share in zip(kept, shares, strict=True):
        image = image - share / scale[k] * (images[-1] - images[k])
    return image


@dataclass
class _Trace:
    move: list[float] = field(default_factory=list)
    excess: list[float] = field(default_factory=list)
    converged: bool = False


def _descend(
    surface: _Surface,
    solve: Callable[[Floats], Floats],
    gradient: Callable[[Floats], tuple[Floats, Floats, float]],
    s: Floats,
    tolerance: float,
    steps: int,
    report: Callable[[float], object],
) -> tuple[Floats, _Trace]:
    """Preconditioned descent of E - A with Anderson acceleration; the centre stays at the origin."""
    trace, weights = _Trace(), surface.mass / surface.mass.sum()
    residuals: list[Floats] = []
    images: list[Floats] = []
    for step in range(steps):
        g, image_areas, excess = gradient(s)
        g = _tangential(g, s)
        share = (image_areas / image_areas.sum())[:, None]
        g -= share * g.sum(0)
        d = solve(g)
        d -= (share * d).sum(0)
        image = _centred(_unit(s - _tangential(d, s)), surface.mass)
        residuals, images = [*residuals[-3:], image - s], [*images[-3:], image]
        move = float(np.sqrt(weights @ (residuals[-1] ** 2).sum(1)))
        trace.move.append(move)
        trace.excess.append(excess)
        s = _centred(_unit(_anderson(residuals, images, weights)), surface.mass)
        report((step + 1) / steps)
        if move < tolerance:
            trace.converged = True
            break
    return s, trace


# --- repair of what is still turned over ---------------------------------------------------------------------------------------------


class _Patch:
    """Vertices that may move, the triangles around them, in a stereographic chart at the middle of the patch.

    The chart is made from differences and scaled to size 1, so that patches of any size down to rounding are treated alike.
    """

    def __init__(self, surface: _Surface, s: Floats, free: Faces, triangles: Faces) -> None:
        faces = surface.faces[triangles]
        self.vertices, local = np.unique(faces, return_inverse=True)
        self.faces = local.reshape(-1, 3)
        self.free = np.searchsorted(self.vertices, free)
        self.cotangents = surface.cotangents[triangles]
        self.shares = surface.areas[triangles] / surface.areas.sum()
        self.shares = self.shares / self.shares.sum()
        here = s[self.vertices]
        rim = np.ones(len(here), bool)
        rim[self.free] = False
        centre = here[rim].mean(0)
        if np.linalg.norm(centre) < 1e-3:
            centre = here.mean(0)
        self.centre = centre / np.linalg.norm(centre)
        axis = np.eye(3)[np.argmin(np.abs(self.centre))]
        first = axis - (axis @ self.centre) * self.centre
        first /= np.linalg.norm(first)
        self.frame = np.stack([first, np.cross(self.centre, first)])
        away = here - self.centre
        z = 2 * (away @ self.frame.T) / (4 - (away * away).sum(1))[:, None]
        self.scale = float(np.sqrt((z * z).sum(1).max()))
        self.z = z / self.scale

    def lifted(self, z: Floats) -> Floats:
        """Sphere positions minus the centre of the chart, over the scale."""
        square = self.scale**2 * (z * z).sum(1)
        found: Floats = (2 * (z @ self.frame) - (2 / self.scale * square)[:, None] * self.centre) / (1 + square)[:, None]
        return found

    def pulled(self, z: Floats, lifted: Floats, gradient: Floats) -> Floats:
        """A gradient by lifted positions as one by chart coordinates."""
        denominator = (1 + self.scale**2 * (z * z).sum(1))[:, None]
        along = -2 * self.scale**2 * (gradient * lifted).sum(1)[:, None] * z
        across = 2 * (gradient @ self.frame.T) - 4 * self.scale * (gradient @ self.centre)[:, None] * z
        found: Floats = (across + along) / denominator
        return found

    def measure(self, z: Floats) -> tuple[Floats, Floats, Floats, tuple[Floats, Floats, Floats]]:
        """Lifted positions, energy E_T and half the determinant d of each triangle, its edges."""
        x = self.lifted(z)
        p, q, r = (x[self.faces[:, k]] for k in range(3))
        e = (r - q, p - r, q - p)
        energy = 0.25 * sum(self.cotangents[:, k] * (e[k] * e[k]).sum(1) for k in range(3))
        base = self.centre + self.scale * p
        determinant = 0.5 * (base * np.cross(e[2], -e[1])).sum(1)
        return x, energy, determinant, e

    def sizes(self, z: Floats) -> Floats:
        """Area of an equilateral triangle with the mean edge around each triangle's corners."""
        x = self.lifted(z)
        a, b = self.faces.ravel(), self.faces[:, [1, 2, 0]].ravel()
        length = np.sqrt(((x[a] - x[b]) ** 2).sum(1))
        total = np.bincount(a, length, len(x)) + np.bincount(b, length, len(x))
        mean = total / (np.bincount(a, minlength=len(x)) + np.bincount(b, minlength=len(x)))
        found: Floats = np.maximum(0.43 * mean[self.faces].mean(1) ** 2, 1e-300)
        return found

    def objective(self, z: Floats, epsilon: Floats) -> tuple[float, Floats, Floats]:
        """Sum of a_T E_T / χ(d_T), its gradient at the free vertices, and the d_T."""
        x, energy, d, e = self.measure(z)
        root = np.sqrt(epsilon**2 + d * d)
        chi = np.where(d > 0, 0.5 * (d + root), 0.5 * epsilon**2 / np.maximum(root - d, 1e-300))
        value = float((self.shares * energy / chi).sum())
        by_energy = (0.5 * self.shares / chi)[:, None]
        by_determinant = (-self.shares * energy / chi**2 * (chi / root))[:, None]
        w = [by_energy * self.cotangents[:, k, None] * e[k] for k in range(3)]
        p = self.centre + self.scale * x[self.faces[:, 0]]
        gradient = np.zeros_like(x)
        area = [None, 0.5 * np.cross(-e[1], p), 0.5 * np.cross(p, e[2])]
        area[0] = 0.5 * self.scale * np.cross(e[2], -e[1]) - area[1] - area[2]
        for k in range(3):
            here = w[(k + 1) % 3] - w[(k + 2) % 3] + by_determinant * area[k]
            for axis in range(3):
                gradient[:, axis] += np.bincount(self.faces[:, k], here[:, axis], len(x))
        return value, self.pulled(z, x, gradient)[self.free], d

    def preconditioner(self, weights: Floats) -> Callable[[Floats], Floats]:
        """Solves with the stiffness of the patch, each triangle weighted, the rim fixed."""
        index = np.full(len(self.vertices), -1)
        index[self.free] = np.arange(len(self.free))
        weights = weights / weights.max()
        matrix = np.zeros((len(self.free), len(self.free))) if len(self.free) <= 400 else None
        rows, columns, entries = [], [], []
        for k in range(3):
            a, b = index[self.faces[:, (k + 1) % 3]], index[self.faces[:, (k + 2) % 3]]
            value = 0.5 * weights * self.cotangents[:, k]
            for i, j, sign in ((a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)):
                inside = (i >= 0) & (j >= 0)
                rows.append(i[inside])
                columns.append(j[inside])
                entries.append(sign * value[inside])
        i, j, w = (np.concatenate(part) for part in (rows, columns, entries))
        if matrix is not None:
            np.add.at(matrix, (i, j), w)
            matrix += 1e-12 * np.diag(np.abs(np.diag(matrix)) + 1e-300)
            try:
                import scipy.linalg

                factor = scipy.linalg.cho_factor(matrix)
                return lambda b: np.asarray(scipy.linalg.cho_solve(factor, b), np.float64)
            except np.linalg.LinAlgError:
                diagonal = np.maximum(np.diag(matrix), 1e-300)
                return lambda b: b / diagonal[:, None]
        whole = sparse.csr_array((w, (i, j)), (len(self.free),) * 2)
        whole = sparse.csr_array(0.5 * (whole + whole.T))
        diagonal = np.maximum(whole.diagonal(), 1e-300)
        try:
            return Cholesky(plus_diagonal(whole, 1e-12 * diagonal)).solve
        except NumericalError:
            return lambda b: b / diagonal[:, None]

    def tutte(self) -> None:
        """Each free vertex in the mean of its neighbours: no triangle is turned over where the rim is convex."""
        index = np.full(len(self.vertices), -1)
        index[self.free] = np.arange(len(self.free))
        a, b = self.faces.ravel(), self.faces[:, [1, 2, 0]].ravel()
        a, b = np.concatenate([a, b]), np.concatenate([b, a])
        graph = sparse.csr_array((np.ones(len(a)), (a, b)), (len(self.vertices),) * 2)[self.free]
        inner = sparse.csr_array(sparse.diags_array(graph.sum(axis=1)) - graph[:, self.free])
        outer = self.z.copy()
        outer[self.free] = 0.0
        self.z[self.free] = Cholesky(inner).solve(graph @ outer)

    def _minimize(self, epsilon: Floats, steps: int, guard: bool) -> bool:
        """L-BFGS on the free vertices; with ``guard`` no step may turn a triangle over. Says whether anything moved."""
        value, g, d = self.objective(self.z, epsilon)
        solve = self.preconditioner(self.shares / np.sqrt(epsilon**2 + d * d))
        history: list[tuple[Floats, Floats, float]] = []
        moved = False
        for _ in range(steps):
            q, shares = g.copy(), []
            for dz, dg, rho in reversed(history):
                alpha = rho * float((dz * q).sum())
                shares.append(alpha)
                q -= alpha * dg
            direction = solve(q)
            if history:
                dz, dg, _rho = history[-1]
                direction *= float((dz * dg).sum()) / max(float((dg * solve(dg)).sum()), 1e-300)
            for (dz, dg, rho), alpha in zip(history, reversed(shares), strict=True):
                direction += (alpha - rho * float((dg * direction).sum())) * dz
            slope = -float((g * direction).sum())
            if not slope < 0:
                if not history:
                    break
                history = []
                continue
            length = min(1.0, 0.5 / max(float(np.abs(direction).max()), 1e-300))
            for _ in range(30):
                z = self.z.copy()
                z[self.free] -= length * direction
                new, new_g, new_d = self.objective(z, epsilon)
                if np.isfinite(new) and new <= value + 1e-4 * length * slope and not (guard and (new_d <= 0).any()):
                    break
                length *= 0.5
            else:
                break
            dz, dg = (z - self.z)[self.free], new_g - g
            curvature = float((dz * dg).sum())
            if curvature > 1e-14 * np.linalg.norm(dz) * np.linalg.norm(dg):
                history = [*history[-9:], (dz, dg, 1 / curvature)]
            small = value - new < 1e-7 * abs(value)
            self.z, value, g, moved = z, new, new_g, True
            if small:
                break
        return moved

    def untangle(self) -> bool:
        """Minimizes Σ a_T E_T / χ with ε that falls as the flips vanish (Garanzha et al. 2021), then with hardly any ε."""
        for _sweep in range(15):
            sizes = self.sizes(self.z)
            for floor, share in ((1e-4, 0.25), (1e-6, 0.04)):
                least = float((self.measure(self.z)[2] / sizes).min())
                self._minimize(np.sqrt(floor + share * min(least, 0.0) ** 2) * sizes, 60, guard=False)
            if (self.measure(self.z)[2] > 0).all():
                break
        else:
            return False
        self._minimize(1e-9 * self.sizes(self.z), 60, guard=True)
        return True

    def place(self, s: Floats) -> None:
        """Writes the free vertices into sphere positions."""
        s[self.vertices[self.free]] = _unit(self.centre + self.scale * self.lifted(self.z)[self.free])


def _repair(surface: _Surface, s: Floats, rounds: int, report: Callable[[float], object]) -> Floats:
    """Frees the surroundings of flipped triangles, patch by patch, and untangles each; kept only where flips become fewer."""
    faces, n = surface.faces, surface.count
    a, b = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    neighbours = sparse.csr_array((np.ones(len(a), np.int8), (a, b)), (n, n))
    for attempt in range(rounds):
        wrong = surface.flipped(s)
        if not wrong.any():
            break
        seeds = np.zeros(n, bool)
        seeds[faces[wrong].ravel()] = True
        for patch_free in _patches(neighbours, s, seeds, attempt):
            inside = np.zeros(n, bool)
            inside[patch_free] = True
            touched = np.flatnonzero(inside[faces].any(1))
            before = int(surface.flipped(s)[touched].sum())
            if before == 0 or len(touched) > 0.5 * len(faces):
                continue
            patch = _Patch(surface, s, patch_free, touched)
            if attempt >= 2:
                patch.tutte()
            patch.untangle()
            trial = s.copy()
            patch.place(trial)
            if int((_determinants(trial, faces[touched]) <= 0).sum()) < before:
                s = trial
            report((attempt + 0.5) / rounds)
    return s


def _patches(neighbours: sparse.csr_array, s: Floats, seeds: npt.NDArray[np.bool_], attempt: int) -> list[Faces]:
    """Sets of vertices to free: rings around the flips at first, round caps later."""
    from scipy.sparse.csgraph import connected_components

    def grown(mask: npt.NDArray[np.bool_], rings: int) -> npt.NDArray[np.bool_]:
        for _ in range(rings):
            mask = mask | (neighbours @ mask.astype(np.int8) > 0)
        return mask

    def clusters(mask: npt.NDArray[np.bool_]) -> list[Faces]:
        index = np.flatnonzero(mask)
        labels = connected_components(neighbours[index][:, index], directed=False)[1]
        return [index[labels == label] for label in range(labels.max() + 1)]

    if attempt < 2:
        return clusters(grown(seeds, 1 + 2 * attempt))
    found = []
    for cluster in clusters(grown(seeds, 1)):
        middle = s[cluster].mean(0)
        middle /= max(float(np.linalg.norm(middle)), 1e-300)
        radius = float(np.sqrt(((s[cluster] - middle) ** 2).sum(1).max()))
        reach = min(3.0 * 2.0 ** (attempt - 2) * radius, 1.0)
        cap = np.sqrt(((s - middle) ** 2).sum(1)) <= reach
        # Only the piece that holds the cluster, and what it encloses, so that the patch is a disc.
        pieces = [piece for piece in clusters(cap) if np.isin(cluster, piece).any()]
        if pieces:
            found.append(np.unique(np.concatenate([*pieces, cluster])))
    return found


# --- the door -----------------------------------------------------------------------------------------------------------------------


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
            f"the mesh is not closed: {loops} {holes}; {facts}, a sphere has 2. Fill the holes first"
        )
    if euler != 2 or not mesh.is_orientable:
        what = f"genus {mesh.genus}" if mesh.is_orientable else "only one side"
        raise TopologyError(f"the mesh has {what}; {facts}, a sphere has 2. Only surfaces of genus 0 map to the sphere one to one")
    if not used.all():
        raise InputError(f"vertex {int(np.flatnonzero(~used)[0])} belongs to no triangle; remove it (mesh.largest_component() does)")
    oriented = mesh if mesh.is_oriented else mesh.oriented()
    return oriented.faces.astype(np.int64)


def _reporting(progress: Progress) -> Callable[[float], None]:
    call = reporter(progress, "spherical map")

    def report(share: float) -> None:
        if call is not None and call(share) is False:
            raise Cancelled("stopped on request before the work was done")

    return report


def _scaled(vertices: Floats) -> tuple[Floats, float]:
    """Vertices about the origin and of size 1, so that products of lengths stay in range; and the size they had."""
    middle = 0.5 * (vertices.max(0) + vertices.min(0))
    moved = vertices - middle
    size = float(np.abs(moved).max())
    if not size > 0 or not np.isfinite(size):
        raise InputError(f"the vertices span {size:g}; a surface is needed")
    return moved / size, size


def _solver(stiffness: sparse.csr_array, coordinates: Floats, progress: Progress) -> Callable[[Floats], Floats]:
    """Solves with the stiffness, one vertex pinned by a spring; exact for right-hand sides that add up to zero."""
    spring = np.zeros(stiffness.shape[0])
    spring[0] = stiffness.diagonal()[0]
    return Cholesky(plus_diagonal(stiffness, spring), coordinates, progress=progress).solve


def spherical_map(
    shape: Shape | Operators,
    *,
    tolerance: float = 1e-4,
    max_iterations: int = 20,
    progress: Progress = None,
) -> SphericalMapResult:
    """Maps a closed surface of genus 0 conformally to the unit sphere.

    Minimizes E - A, Dirichlet energy less signed image area, among the maps whose area-weighted centre is the origin: a linear map
    to start from, descent preconditioned by one Cholesky factorization with Anderson acceleration, and a repair of the triangles
    that are still turned over.

    Parameters
    ----------
    shape : TriangleMesh or Operators
        Closed, connected, manifold, of genus 0. The orientation is kept: seen from outside, the image is not mirrored.
    tolerance : float
        Root mean square move of a step, in radii of the sphere, at which to stop.
    max_iterations : int
    progress : callable or True, optional

    Returns
    -------
    SphericalMapResult

    Raises
    ------
    TopologyError
        The surface is not closed, connected, manifold or of genus 0; the message gives its Euler characteristic and what to do.
    NumericalError
        Parts of the image round away: the message says which.

    References
    ----------
    Lai, Wen, Yin, Gu and Lui, Folding-free global conformal mapping for genus-0 surfaces by harmonic energy minimization, 2014.
    Baden, Crane and Kazhdan, Möbius registration, 2018.

    Examples
    --------
    >>> import beltrami as bt
    >>> r = bt.spherical_map(bt.shapes.ellipsoid(1.0, 0.7, 0.5, level=3))
    >>> r.flipped, r.excess < 0.02
    (0, True)
    """
    tolerance = arrays.number(tolerance, "tolerance", above=0)
    max_iterations = arrays.whole(max_iterations, "max_iterations", 1)
    if isinstance(shape, Operators):
        shape = shape.shape
    if not isinstance(shape, TriangleMesh):
        raise InputError(f"shape is a {type(shape).__name__}; a TriangleMesh is needed")
    return _map_mesh(shape, tolerance, max_iterations, _reporting(progress))


def _map_mesh(mesh: TriangleMesh, tolerance: float, steps: int, report: Callable[[float], None]) -> SphericalMapResult:
    faces = _sphere_mesh(mesh)
    vertices, size = _scaled(mesh.vertices)
    if vertices.shape[1] == 3:
        p = vertices[faces[:, 0]]
        volume = float(np.einsum("ij,ij->", p, np.cross(vertices[faces[:, 1]], vertices[faces[:, 2]])))
        if volume < 0:
            faces = np.ascontiguousarray(faces[:, [0, 2, 1]])
    surface = _Surface(vertices, faces)
    notes: list[str] = []
    work = TriangleMesh(vertices, faces.astype(np.int32))
    found: list[tuple[Floats, _Trace]] = []
    try:
        stiffness = operators(work, laplacian="cotangent").stiffness
        solve = _solver(stiffness, vertices, lambda share: report(0.4 * share))

        def gradient(s: Floats) -> tuple[Floats, Floats, float]:
            g, areas, excess = surface.gradient(s)
            return g, areas, float(excess.sum())

        start = _centred(_start(surface, solve), surface.mass)
        found.append(_descend(surface, solve, gradient, start, tolerance, steps, lambda share: report(0.4 + 0.5 * share)))
    except (InputError, NumericalError) as error:
        notes.append(f"cotangents cannot be used ({error}); intrinsic Delaunay weights instead")
    if not found or surface.flipped(found[0][0]).sum() > 0.01 * len(faces):
        ops = operators(work, laplacian="intrinsic_delaunay")
        solve = _solver(ops.stiffness, vertices, None)

        def gradient_of_energy(s: Floats) -> tuple[Floats, Floats, float]:
            g = ops.stiffness @ s
            p, q, r = (s[faces[:, k]] for k in range(3))
            areas = 0.5 * np.linalg.norm(np.cross(q - p, r - p), axis=1)
            return g, _lumped(areas, faces, len(s)), float(0.5 * (s * g).sum() - areas.sum())

        start = _centred(_start(surface, solve), surface.mass)
        found.append(_descend(surface, solve, gradient_of_energy, start, tolerance, steps, lambda share: report(0.9)))
        if len(found) == 2:
            notes.append("more than 1 % of the triangles were flipped, so the map was made again with intrinsic Delaunay weights")
    s, trace = min(found, key=lambda one: int(surface.flipped(one[0]).sum()))
    before = int(surface.flipped(s).sum())
    if before:
        excess = np.subtract(*surface.energy_and_area(s))
        s = _centred(_repair(surface, s, 8, lambda share: report(0.9 + 0.1 * share)), surface.mass)
        energy, area = surface.energy_and_area(s)
        notes.append(f"{before} flipped triangles were repaired: E - A {excess:.4g} before, {energy - area:.4g} after")
    report(1.0)
    return _certified(mesh, surface, s, size, trace, tuple(notes))


def _certified(mesh: TriangleMesh, surface: _Surface, s: Floats, size: float, trace: _Trace, notes: tuple[str, ...]) -> SphericalMapResult:
    """The result with what is measured on it; an error where what is flipped has rounded away."""
    faces = surface.faces
    wrong = np.flatnonzero(surface.flipped(s))
    if len(wrong):
        corners = s[faces[wrong]]
        extent = np.sqrt(((corners - corners[:, [1, 2, 0]]) ** 2).sum(2)).max(1)
        if (extent < 1e-13).any():
            lost = wrong[extent < 1e-13]
            where = mesh.vertices[faces[lost].ravel()].mean(0)
            raise NumericalError(
                f"the images of {len(lost)} triangles round away (they are below 1e-13 of the sphere), around triangle {lost[0]}, "
                f"near ({', '.join(f'{x:.4g}' for x in where)}): a limb there is too long and thin for double precision; cut it off, "
                "or thicken it"
            )
        notes += (f"{len(wrong)} triangles are still flipped, the first is {wrong[0]}",)
    _, image = _corner_cotangents(s, faces)
    lumped = _lumped(image, faces, surface.count)
    energy, area = surface.energy_and_area(s)
    p, q, r = (s[faces[:, k]] for k in range(3))
    e = (r - q, p - r, q - p)
    each = 0.25 * sum(surface.cotangents[:, k] * (e[k] * e[k]).sum(1) for k in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.maximum(each / image, 1.0)
        dilatation = np.where(image > 0, ratio + np.sqrt(ratio * ratio - 1), np.inf)
    return SphericalMapResult(
        mesh,
        s,
        lumped / surface.mass / size / size,
        energy,
        area,
        len(wrong),
        np.abs(_corner_angles(s, faces) - _corner_angles(surface.vertices, faces)).mean(1),
        dilatation,
        len(trace.move),
        trace.converged and not len(wrong),
        {"move": np.array(trace.move), "excess": np.array(trace.excess)},
        notes,
    )
