"""Repair of flipped triangles: patches of the map are freed and untangled."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import scipy

from ..arrays import Floats
from ..errors import NumericalError
from ..solvers import Cholesky, plus_diagonal
from .surface import Faces, Surface, determinants, row_crosses, row_products, unit_rows


class Patch:
    """Vertices that may move, the triangles around them, in a stereographic chart at the middle of the patch.

    The chart is made from differences and scaled to size 1, so that patches of any size down to rounding are treated alike.
    """

    def __init__(self, surface: Surface, s: Floats, free: Faces, triangles: Faces) -> None:
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
        z = 2 * (away @ self.frame.T) / (4 - row_products(away, away))[:, None]
        self.scale = float(np.sqrt(row_products(z, z).max()))
        self.z = z / self.scale

    def lifted(self, z: Floats) -> Floats:
        """Sphere positions minus the centre of the chart, over the scale."""
        square = self.scale**2 * row_products(z, z)
        found: Floats = (2 * (z @ self.frame) - (2 / self.scale * square)[:, None] * self.centre) / (1 + square)[:, None]
        return found

    def pulled(self, z: Floats, lifted: Floats, gradient: Floats) -> Floats:
        """A gradient by lifted positions as one by chart coordinates."""
        denominator = (1 + self.scale**2 * row_products(z, z))[:, None]
        along = -2 * self.scale**2 * row_products(gradient, lifted)[:, None] * z
        across = 2 * (gradient @ self.frame.T) - 4 * self.scale * (gradient @ self.centre)[:, None] * z
        found: Floats = (across + along) / denominator
        return found

    def measure(self, z: Floats) -> tuple[Floats, Floats, Floats, tuple[Floats, Floats, Floats]]:
        """Lifted positions, energy E_T and half the determinant d of each triangle, its edges."""
        x = self.lifted(z)
        p, q, r = (x[self.faces[:, k]] for k in range(3))
        e = (r - q, p - r, q - p)
        squares = np.stack([row_products(one, one) for one in e], axis=1)
        energy = 0.25 * row_products(self.cotangents, squares)
        base = self.centre + self.scale * p
        determinant = 0.5 * row_products(base, row_crosses(e[2], -e[1]))
        return x, energy, determinant, e

    def sizes(self, z: Floats) -> Floats:
        """Area of an equilateral triangle with the mean edge around each triangle's corners."""
        x = self.lifted(z)
        a, b = self.faces.ravel(), self.faces[:, [1, 2, 0]].ravel()
        length = np.sqrt(((x[a] - x[b]) ** 2).sum(1))
        total = np.bincount(a, length, len(x)) + np.bincount(b, length, len(x))
        mean = total / (np.bincount(a, minlength=len(x)) + np.bincount(b, minlength=len(x)))
        found: Floats = np.maximum(0.43 * mean[self.faces].mean(1) ** 2, 1e-24)
        return found

    def objective(self, z: Floats, epsilon: Floats) -> tuple[float, Floats, Floats]:
        """Sum of a_T E_T / χ(d_T), its gradient at the free vertices, and the d_T."""
        x, energy, d, e = self.measure(z)
        root = np.sqrt(epsilon**2 + d * d)
        chi = np.maximum(np.where(d > 0, 0.5 * (d + root), 0.5 * epsilon**2 / np.maximum(root - d, 1e-300)), 1e-150)
        value = float((self.shares * energy / chi).sum())
        by_energy = (0.5 * self.shares / chi)[:, None]
        by_determinant = (-self.shares * energy / chi / root)[:, None]
        w = [by_energy * self.cotangents[:, k, None] * e[k] for k in range(3)]
        p = self.centre + self.scale * x[self.faces[:, 0]]
        gradient = np.zeros_like(x)
        by_q, by_r = 0.5 * row_crosses(-e[1], p), 0.5 * row_crosses(p, e[2])
        area = [0.5 * self.scale * row_crosses(e[2], -e[1]) - by_q - by_r, by_q, by_r]
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
                factor = scipy.linalg.cho_factor(matrix)
                return lambda b: np.asarray(scipy.linalg.cho_solve(factor, b), np.float64)
            except np.linalg.LinAlgError:
                diagonal = np.maximum(np.diag(matrix), 1e-300)
                return lambda b: b / diagonal[:, None]
        whole = scipy.sparse.csr_array((w, (i, j)), (len(self.free),) * 2)
        whole = scipy.sparse.csr_array(0.5 * (whole + whole.T))
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
        graph = scipy.sparse.csr_array((np.ones(len(a)), (a, b)), (len(self.vertices),) * 2)[self.free]
        inner = scipy.sparse.csr_array(scipy.sparse.diags_array(graph.sum(axis=1)) - graph[:, self.free])
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
        with np.errstate(all="ignore"):  # what overflows is refused by the line search
            return self._untangle()

    def _untangle(self) -> bool:
        """Minimizes Σ a_T E_T / χ with ε that falls as the flips vanish (Garanzha et al. 2021), then with hardly any ε."""
        fewest, stalled = (int((self.measure(self.z)[2] <= 0).sum()), self.z), 0
        for _sweep in range(15):
            if fewest[0] == 0 or stalled == 4:
                break
            sizes = self.sizes(self.z)
            for floor, share in ((1e-4, 0.25), (1e-6, 0.04)):
                least = float((self.measure(self.z)[2] / sizes).min())
                self._minimize(np.sqrt(floor + share * min(least, 0.0) ** 2) * sizes, 60, guard=False)
            flips = int((self.measure(self.z)[2] <= 0).sum())
            stalled = 0 if flips < fewest[0] else stalled + 1
            if flips < fewest[0]:
                fewest = flips, self.z
        self.z = fewest[1]
        if (self.measure(self.z)[2] <= 0).any():
            return False
        for share in (1e-2, 1e-4, 1e-9):
            self._minimize(share * self.sizes(self.z), 60, guard=True)
        # Weighted by the areas of the image, Σ a_T (E_T / d_T - 1) is E - A: nothing else that the patch costs is left.
        d = self.measure(self.z)[2]
        self.shares = np.maximum(d, 1e-3 * d.mean())
        self.shares /= self.shares.sum()
        self._minimize(1e-9 * self.sizes(self.z), 120, guard=True)
        return True

    def place(self, s: Floats) -> None:
        """Writes the free vertices into sphere positions."""
        s[self.vertices[self.free]] = unit_rows(self.centre + self.scale * self.lifted(self.z)[self.free])


def repair(surface: Surface, s: Floats, rounds: int, report: Callable[[float], object]) -> Floats:
    """Frees the surroundings of flipped triangles, patch by patch, and untangles each; kept only where flips become fewer."""
    faces, n = surface.faces, surface.count
    a, b = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    neighbours = scipy.sparse.csr_array((np.ones(len(a), np.int8), (a, b)), (n, n))
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
            patch = Patch(surface, s, patch_free, touched)
            if attempt >= 2:
                patch.tutte()
            patch.untangle()
            trial = s.copy()
            patch.place(trial)
            if int((determinants(trial, faces[touched]) <= 0).sum()) < before:
                s = trial
            report((attempt + 0.5) / rounds)
    return s


def _patches(neighbours: scipy.sparse.csr_array, s: Floats, seeds: npt.NDArray[np.bool_], attempt: int) -> list[Faces]:
    """Sets of vertices to free: rings around the flips at first, round caps later."""
    from scipy.sparse.csgraph import connected_components

    def grown(mask: npt.NDArray[np.bool_], rings: int) -> npt.NDArray[np.bool_]:
        for _ in range(rings):
            mask = mask | (neighbours @ mask.astype(np.int8) > 0)
        return mask

    def clusters(mask: npt.NDArray[np.bool_]) -> list[Faces]:
        index = np.flatnonzero(mask)
        labels = connected_components(neighbours[index][:, index], directed=False)[1]
        return [index[labels == label] for label in range(labels.max(initial=-1) + 1)]

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
