"""Candidates for the map: orthogonal matrices that preserve triple products of eigenfunctions, upsampled and compared by energy."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from .. import _core
from ..arrays import Floats, Ints
from .deformation import Fitting, Rigid, low_passed
from .sides import SAMPLES, TENSOR, Side


def _triple_products(side: Side, count: int) -> tuple[Floats, Floats]:
    """∫ φ_i φ_j φ_k, and ∫ φ_i dφ_j ∧ dφ_k, which a mirror image has with the other sign (0 without an orientation)."""
    functions = np.ascontiguousarray(side.functions[:, :count])
    even, odd = np.zeros((2, count, count, count))
    first, second = np.triu_indices(count)
    products = np.zeros((count, len(first)))
    for rows in _parts(len(functions)):
        some = functions[rows]
        products += (side.mass[rows, None] * some).T @ _pairs(some, some)
    even[:, first, second] = even[:, second, first] = products
    if side.faces is not None and side.dimension == 2:
        faces = side.faces[(side.mass[side.faces] > 0).all(1)]
        first, second = np.triu_indices(count, 1)
        products = np.zeros((count, len(first)))
        for rows in _parts(len(faces)):
            a, b, c = (functions[faces[rows, corner]] for corner in range(3))
            products += ((a + b + c) / 6).T @ (_pairs(b - a, c - a, 1) - _pairs(c - a, b - a, 1))
        odd[:, first, second], odd[:, second, first] = products, -products
        odd = (odd + odd.transpose(1, 2, 0) + odd.transpose(2, 0, 1)) / 3
    return even, odd


def _parts(count: int) -> list[slice]:
    """Rows that fit into a processor's cache with their products."""
    return [slice(start, start + 256) for start in range(0, count, 256)]


def _pairs(left: Floats, right: Floats, apart: int = 0) -> Floats:
    """Products of column i of the left and column j >= i + apart of the right."""
    count = left.shape[1]
    return np.concatenate([left[:, i, None] * right[:, i + apart :] for i in range(count)], 1)


@dataclass(eq=False)
class Products:
    """Triple products of both shapes, ready for any level: low frequencies weigh more, and each level has norm 1."""

    source: tuple[Floats, Floats]
    target: tuple[Floats, Floats]
    scales: tuple[Floats, Floats]
    linear: Floats

    def level(self, n: int, powers: tuple[float, float]) -> list[Floats]:
        out = []
        for tensors, scale in zip((self.source, self.target), self.scales, strict=True):
            for tensor, power in zip(tensors, powers, strict=True):
                weight = scale[:n] ** -power
                part = tensor[:n, :n, :n] * weight[:, None, None] * weight[None, :, None] * weight[None, None, :]
                norm = np.linalg.norm(part)
                out.append(np.ascontiguousarray(part / norm if norm > 0 else part))
        return out

    def ascend(self, maps: Floats, powers: tuple[float, float], weight: float, steps: int) -> tuple[Floats, Floats]:
        n = maps.shape[1]
        linear = np.ascontiguousarray(self.linear[:n, :n])
        norm = np.linalg.norm(linear)
        linear = 0.3 * linear / norm if norm > 0 else linear
        a, b, c, d = self.level(n, powers)
        return _core.ascend_triple_products(np.ascontiguousarray(maps), a, b, c, d, weight, linear, steps)


def _frequencies(side: Side) -> Floats:
    """Eigenvalues over the first that is not 0; those that are, as 1."""
    above = side.values > 1e-9 * side.values[-1]
    first = side.values[above][0] if above.any() else 1.0
    return np.maximum(side.values / first, 1.0)


def products_of(source: Side, target: Side) -> Products:
    count = min(TENSOR, source.modes, target.modes)
    linear = np.zeros((count, count))
    if source.descriptors.shape[1]:
        a, b = (side.functions[:, :count].T @ (side.mass[:, None] * side.descriptors) for side in (source, target))
        linear = a @ b.T
    return Products(
        _triple_products(source, count),
        _triple_products(target, count),
        (_frequencies(source)[:count], _frequencies(target)[:count]),
        linear,
    )


def distinct(maps: Floats, scores: Floats, width: int, alike: float, share: int = 4) -> npt.NDArray[np.int64]:
    """The best `width` maps, those left out that overlap with a better one, or share a leading block with `share` better ones."""
    n = maps.shape[1]
    lead = min(6, n)
    flat = maps.reshape(len(maps), -1)
    block = maps[:, :lead, :lead].reshape(len(maps), -1)
    block = block / np.maximum(np.linalg.norm(block, axis=1, keepdims=True), 1e-300)
    kept: list[int] = []
    for index in np.argsort(-scores, kind="stable").tolist():
        if kept and ((flat[kept] * flat[index]).sum(1).max() > alike * n or ((block[kept] * block[index]).sum(1) > 0.8).sum() >= share):
            continue
        kept.append(index)
        if len(kept) == width:
            break
    return np.array(kept)


def beam(products: Products, top: int, powers: tuple[float, float], weight: float, width: int, keep: int) -> Floats:
    """Maps whose triple products agree: all signs of the first four modes, then mode after mode with either sign."""
    start = min(4, top)
    maps = np.array([np.diag(signs) for signs in itertools.product((1.0, -1.0), repeat=start)])
    for n in range(start, top + 1):
        if n > start:
            wider = np.zeros((2, len(maps), n, n))
            wider[:, :, :-1, :-1] = maps
            wider[0, :, -1, -1], wider[1, :, -1, -1] = 1.0, -1.0
            maps = wider.reshape(-1, n, n)
        maps, scores = products.ascend(maps, powers, weight, 6)
        total = scores[:, 0] + weight * scores[:, 1] + scores[:, 2]
        maps = maps[distinct(maps, total, width, 0.98)]
    return maps[:keep]


def grown(maps: Floats, levels: list[int], source: Side, target: Side, weight: float, samples: int = SAMPLES) -> Floats:
    """Two-way upsampling on some samples through `levels`."""
    chosen = [side.first(samples) for side in (source, target)]
    for k, following in itertools.pairwise([maps.shape[1], *levels]):
        a, b = (side.spectral(max(k, following), weight, some) for side, some in zip((source, target), chosen, strict=True))
        maps = _core.upsample_maps(np.ascontiguousarray(maps), following, a, b)
    return maps


@dataclass(frozen=True, eq=False, repr=False)
class RegistrationCandidate:
    """A map that was considered.

    Attributes
    ----------
    functional_map : (k, k) array
        Orthogonal, between the eigenfunctions, the constant first.
    point_map : (n,) int32 array
        Index in the target of each source point, by this map alone (not polished). Computed when it is asked for.
    energy : float
        What decides between candidates: the energy of deforming the source onto its image (surfaces in R^3), or else the mean squared
        distance of nearest rows. Only energies of one call can be compared.
    smoothness : float
        Agreement of the triple products of eigenfunctions, at most 1.
    orientation : float
        Agreement of their oriented triple products: negative for a mirror image; 0 where the shapes have no orientation.
    """

    functional_map: Floats
    energy: float
    smoothness: float
    orientation: float
    functions: tuple[Floats, Floats] = field(repr=False)

    @cached_property
    def point_map(self) -> Ints:
        k = len(self.functional_map) - 1
        source, target = self.functions
        return _core.nearest_rows(np.ascontiguousarray(target[:, :k]), source[:, :k] @ self.functional_map[1:, 1:])[0]

    def __repr__(self) -> str:
        return f"RegistrationCandidate(energy {self.energy:.4g}, smoothness {self.smoothness:.3f}, orientation {self.orientation:.3f})"


def point_maps(maps: Floats, source: Side, target: Side, weight: float) -> tuple[Ints, Ints]:
    k = len(maps)
    return _core.spectral_point_maps(np.ascontiguousarray(maps), source.spectral(k, weight), target.spectral(k, weight))


def sample_image(matrix: Floats, source: Side, target: Side, weight: float) -> tuple[Ints, Floats]:
    """Nearest target point of each source sample, and its distance."""
    k = len(matrix)
    functions, features, _ = source.spectral(k, weight, source.first(len(source.samples)))
    others, other_features, _ = target.spectral(k, weight)
    rows = np.concatenate([functions @ matrix / np.sqrt(k), features], 1)
    return _core.nearest_rows(np.concatenate([others / np.sqrt(k), other_features], 1), rows)


def judge(maps: Floats, products: Products, source: Side, target: Side, rigid: Rigid | None) -> list[RegistrationCandidate]:
    """Candidates with their energies, best first."""
    n = min(maps.shape[1], len(products.linear))
    _, scores = products.ascend(maps[:, :n, :n], (0.25, 0.5), 1.0, 0)
    energies = np.zeros(len(maps))
    for index, matrix in enumerate(maps):
        if rigid is None:
            _, distance = sample_image(matrix, source, target, 0.6)
            _, gap = sample_image(np.ascontiguousarray(matrix.T), target, source, 0.6)
            energies[index] = source.sample_masses @ distance**2 + target.sample_masses @ gap**2
    if rigid is not None:
        fitting = Fitting(source, target, rigid)
        places = [low_passed(matrix, source, target) for matrix in maps]
        for index in range(len(maps)):
            energies[index], places[index] = fitting.run(places[index], 3)
        for index in np.argsort(energies, kind="stable")[:4]:
            if energies[index] < 1.5 * energies.min():
                energies[index], places[index] = fitting.run(places[index], 3)
    return listed(maps, energies, scores, source, target)


def listed(maps: Floats, energies: Floats, scores: Floats, source: Side, target: Side) -> list[RegistrationCandidate]:
    """Candidates, best first. Mirror images are left out as long as there is another."""
    k = maps.shape[1]
    functions = (source.functions[:, :k].copy(), target.functions[:, :k].copy())
    found = [
        RegistrationCandidate(with_constant(matrix), float(energy), float(score[0]), float(score[1]), functions)
        for matrix, energy, score in zip(maps, energies, scores, strict=True)
    ]
    found.sort(key=lambda candidate: candidate.energy)
    return [candidate for candidate in found if candidate.orientation >= 0] or found


def with_constant(matrix: Floats) -> Floats:
    whole = np.zeros((len(matrix) + 1,) * 2)
    whole[0, 0] = 1.0
    whole[1:, 1:] = matrix
    return whole
